"""Environments on a device, through the stand-in that runs a card's kernels on the host: the episodes and bits of `VecEnv`."""

import copy
import gc
import importlib
import os
import pickle
import shutil
import sys
import threading
import weakref

import numpy as np
import pytest
from conftest import Climb, near_hover

import omnidrones
from omnidrones import _device

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="not run: no C++ compiler for the stand-in")


@pytest.fixture(scope="module", autouse=True)
def kernels(tmp_path_factory):
    """Each kernel is compiled once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMNIDRONES_KERNELS", str(tmp_path_factory.mktemp("kernels")))
        yield


def beside(name, n, **settings):
    """The same environments on the stand-in and on the host, begun."""
    own, host = (omnidrones.make(name, n, device=device, seed=3, **settings) for device in ("emulated", None))
    assert np.array_equal(own.reset().numpy(), host.reset())
    return own, host


def alike(own, host):
    """Whether what the last step told has the bits of the host; of ended rows alone what they ended with."""
    names = ["observation", "reward", "terminated", "truncated", "central", "privileged", "info"]
    over = host.terminated | host.truncated
    ended = [(getattr(own, name).numpy()[over], getattr(host, name)[over]) for name in ("final_observation", "final_central")]
    all_of = [(getattr(own, name).numpy(), getattr(host, name)) for name in names]
    return all(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in all_of + ended)


@pytest.mark.parametrize("name", ["Hover", "Spread", "Formation"])
def test_steps_have_the_bits_of_the_host(name):
    own, host = beside(name, 66, truncate_after=8)
    ends = 0
    for t in range(20):
        actions = host.sample(t)
        assert np.array_equal(own.sample(t), actions)
        host.step(actions), own.step(actions)
        assert alike(own, host), t
        ends += int((host.terminated | host.truncated).sum())
    assert ends > 0
    assert np.array_equal(own.states(), host.states()) and np.array_equal(own.goals(), host.goals())
    assert own.state_names == host.state_names and own.layout == host.layout
    assert np.array_equal(own.column("return").numpy(), host.column("return"))
    assert np.array_equal(own.safe_command, host.safe_command)


def test_a_class_of_ones_own_steps_with_the_bits_of_the_host():
    own, host = beside(Climb, 5)
    for t in range(70):
        host.step(host.sample(t)), own.step(host.sample(t))
        assert alike(own, host), t
    changed = {"reward": lambda view, terms: terms.term("low", "-z", 1.0, -view.drone().position[2])}
    own, host = beside("Hover", 5, **changed)
    host.step(host.sample(0)), own.step(host.sample(0))
    assert alike(own, host)


def test_make_takes_devices_by_name_and_tells_what_is_not_there():
    assert isinstance(omnidrones.make("Hover", 2), omnidrones.VecEnv)
    assert isinstance(omnidrones.make("Hover", 2, device="cpu"), omnidrones.VecEnv)
    env = omnidrones.make("Hover", 2, device="emulated", horizon=30)
    assert repr(env) == "DeviceEnv('Hover', 2, device='emulated')" and env.spec.horizon == 30
    assert "host" in env.device_name and env.num_envs == 2 and env.config["seed"] == 0 and env.stream == 0
    env.stream = 0
    env.synchronise()
    with pytest.raises(ValueError, match="cuda:99"):
        omnidrones.make("Hover", 2, device="cuda:99")
    with pytest.raises(ValueError, match="no device is called 'gpu'"):
        omnidrones.make("Hover", 2, device="gpu")
    with pytest.raises(ValueError, match="sensor"):
        omnidrones.make("Forest", 2, device="emulated")
    with pytest.raises(ValueError, match="ring"):
        omnidrones.make("Hover", 2, device="emulated", ring=2)
    with pytest.raises(ValueError, match="reset"):
        env.step()
    for elsewhere in (omnidrones.VecEnv, omnidrones.train, lambda *own, **how: omnidrones.evaluate(np.asarray, *own, **how)):
        with pytest.raises(ValueError, match="take a device"):
            elsewhere("Hover", device="cuda")


def test_nvidias_compiler_is_found_among_pythons_packages(tmp_path, monkeypatch):
    from omnidrones._make import name_compiler

    library = tmp_path / "nvidia" / "cu13" / "lib" / "libnvrtc.so.13"
    library.parent.mkdir(parents=True)
    library.touch()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    importlib.invalidate_caches()
    monkeypatch.setenv("OMNIDRONES_NVRTC", "mine")
    name_compiler()
    assert os.environ["OMNIDRONES_NVRTC"] == "mine"
    monkeypatch.setenv("OMNIDRONES_NVRTC", "")
    name_compiler()
    assert os.environ["OMNIDRONES_NVRTC"] == str(library)


def test_arrays_are_views_by_dlpack_the_same_objects_always():
    own, host = beside("Spread", 6)
    views = [np.from_dlpack(array) for array in (own.observation, own.reward, own.terminated, own.info)]
    assert own.observation is own.observation and own.step(host.sample(0)) is own.step(host.sample(1))
    step = host.step(host.sample(0)), host.step(host.sample(1))
    assert all(np.array_equal(a, b) for a, b in zip(views, (step[1].observation, step[1].reward, step[1].terminated, step[1].info)))
    array = own.observation
    assert array.shape == views[0].shape and [4 * n for n in array.strides] == list(views[0].strides)
    assert (array.dtype, own.terminated.dtype, array.device, len(array)) == (np.float32, np.bool_, "emulated", 6)
    assert repr(array) == f"DeviceArray(float32 {list(array.shape)} on emulated)" and array.__dlpack_device__() == (1, 0)
    assert np.asarray(array, np.float64).dtype == np.float64 and not hasattr(array, "__cuda_array_interface__")
    with pytest.raises(ValueError, match="copy"):
        array.__array__(copy=False)
    with pytest.raises(BufferError, match="lent"):
        array.__dlpack__(copy=True)
    for stream in (0, -5):
        with pytest.raises(ValueError, match="default one"):
            array.__dlpack__(stream=stream)
    with pytest.raises(BufferError, match="lie on emulated"):
        array.__dlpack__(dl_device=(2, 0))


def test_views_outlive_their_environment_and_capsules_that_nobody_takes_hold_nothing():
    own, host = beside("Hover", 4)
    view, ghost = np.from_dlpack(own.observation), weakref.ref(own)
    capsules = [own.reward.__dlpack__() for _ in range(3)]
    del own
    gc.collect()
    assert ghost() is None and np.array_equal(view, host.observation)
    assert len(_device._made) >= 3
    _device._forget()
    assert len(_device._made) >= 3, "somebody may take them"
    capsules.clear()
    host.reset()
    _device._forget()
    assert _device._made == []


def test_capsules_of_many_threads_are_given_back_once(monkeypatch):
    own, _ = beside("Hover", 2)
    back, take = [], omnidrones._core._give_back
    monkeypatch.setattr(omnidrones._core, "_give_back", lambda address: (back.append(address), take(address)))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        made = [[] for _ in range(4)]

        def work(own_made):
            for _ in range(500):
                capsule = own.reward.__dlpack__()
                own_made.append(_device.address_of(capsule))
                del capsule

        threads = [threading.Thread(target=work, args=(own_made,)) for own_made in made]
        [thread.start() for thread in threads], [thread.join() for thread in threads]
    finally:
        sys.setswitchinterval(interval)
    _device._forget()
    assert len(back) == sum(map(len, made)) and _device._made == []


def test_actions_lie_on_the_device_or_come_from_numpy():
    own, host = beside("Spread", 6)
    actions = host.sample(4)

    class Elsewhere:
        """What speaks DLPack, in an order of its own."""

        def __init__(self, array):
            self.array = array
            self.__dlpack_device__ = array.__dlpack_device__

        def __dlpack__(self, **how):
            return self.array.__dlpack__()

    columns = np.asfortranarray(actions.reshape(6, -1))
    for given in (actions, Elsewhere(actions), Elsewhere(columns), own.action):
        host.step(actions), own.step(given)
        assert alike(own, host)
    host.step(actions), own.step()
    assert alike(own, host)
    assert np.array_equal(own.action.numpy(), actions)
    for wrong, error, words in [
        (actions.astype(np.float64), TypeError, "float32"),
        (Elsewhere(actions.astype(np.int32)), TypeError, "holds int32"),
        (Elsewhere(actions[:5].copy()), ValueError, r"\[6, …\]"),
        (Elsewhere(np.zeros((6, 1), np.bool_)), ValueError, "of bool"),
        ([0.0], TypeError, "list"),
    ]:
        with pytest.raises(error, match=words):
            own.step(wrong)
    elsewhere = Elsewhere(actions)
    elsewhere.__dlpack_device__ = lambda: (2, 0)
    with pytest.raises(ValueError, match="must lie on emulated"):
        own.step(elsewhere)


def test_resets_take_seeds_and_masks_of_both_places():
    own, host = beside("Hover", 6)
    mask = np.arange(6) % 2 == 0
    for seed, which in [(7, None), ([5, 4, 3, 2, 1, 0], None), (None, mask), (9, mask)]:
        assert np.array_equal(own.reset(seed, which).numpy(), host.reset(seed, which))
    host.step(host.sample(0)), own.step(host.sample(0))
    over = np.asarray(own.terminated)
    assert np.array_equal(own.reset(mask=own.terminated).numpy(), host.reset(mask=over))
    with pytest.raises(ValueError, match="mask"):
        own.reset(mask=np.ones(5, np.bool_))
    with pytest.raises(ValueError, match="mask"):
        own.reset(mask=own.reward)


def test_graphs_replay_steps():
    own, host = beside("Hover", 6)
    actions = host.sample(2)
    own.step(actions), host.step(actions)
    graph = own.graph(3)
    assert len(graph) == 3
    for _ in range(2):
        own.replay(graph)
        for _ in range(3):
            host.step(actions)
        assert alike(own, host) and np.array_equal(own.states(), host.states())
    other, _ = beside("Hover", 6)
    with pytest.raises(ValueError, match="of others"):
        other.replay(graph)


def test_sweeps_have_the_bits_of_the_host(rng):
    own, host = beside("PayloadHover", 5)
    n = 6
    tapes, adjoints = [env.tape(n) for env in (own, host)], [env.adjoint(True) for env in (own, host)]
    for _ in range(n):
        actions = near_hover(rng, host)
        for env, tape in zip((own, host), tapes):
            env.step_recorded(actions, tape)
    own.step_recorded(None, own.tape(1)), host.step(actions)
    assert (len(tapes[0]), tapes[0].horizon, adjoints[0].n_carried) == (n, n, adjoints[1].n_carried)
    sweeps = [adjoint.sweep(0.97, 20.0) for adjoint in adjoints]
    seen = rng.normal(size=(5, own.spec.n_observation)).astype(np.float32)
    loss = np.ones(5, np.float32)
    for t in reversed(range(n)):
        downs = [sweep.pull(tape, t, observation=seen, loss=loss) for sweep, tape in zip(sweeps, tapes)]
        assert np.array_equal(downs[0].numpy(), downs[1])
        added = rng.normal(size=(5, adjoints[1].n_carried)).astype(np.float32)
        for sweep in sweeps:
            sweep.add_carried(added)
        assert np.array_equal(sweeps[0].carried(), sweeps[1].carried())
    assert np.array_equal(sweeps[0].parameters(), sweeps[1].parameters()) and sweeps[0].dropped == sweeps[1].dropped
    with pytest.raises(ValueError, match="step of the sweep"):
        sweeps[0].pull(tapes[0], 0)
    sweeps[0].restart(), tapes[0].clear()
    assert not sweeps[0].carried().any() and len(tapes[0]) == 0
    for t in range(2):
        own.step_recorded(actions, tapes[0])
        if t == 0:
            own.graph(2)  # which steps nothing, and cuts nothing
    sweeps[0].pull(tapes[0], 1, loss=loss)
    assert sweeps[0].pull(tapes[0], 0).numpy().any()
    sweeps[0].restart(), tapes[0].clear()
    with pytest.raises(ValueError, match="carried"):
        sweeps[0].add_carried(added[:, 1:].copy())


def test_environments_move_between_host_and_device_by_their_exact_state():
    settings = {"observation": [{"kind": "normalise", "clip": 3.0}]}
    own, host = beside("Hover", 5, **settings)
    for t in range(4):
        own.step(host.sample(t)), host.step(host.sample(t))
    own.update_normaliser(), host.update_normaliser()
    assert all(np.array_equal(a, b) for a, b in zip(own.statistics, host.statistics))
    own.set_difficulty(0.5), host.set_difficulty(0.5)
    state = host.states()[2] + np.float32(0.25) * (np.arange(host.states().shape[1]) < 3)
    own.set_state(2, state), host.set_state(2, state)
    assert own.save() == host.save()
    own.step(host.sample(9)), host.step(host.sample(9))
    assert alike(own, host)
    for same in (own.on_host(), copy.deepcopy(own), pickle.loads(pickle.dumps(own))):
        assert np.array_equal(np.asarray(same.observation), host.observation)
        assert same.save() == host.save()
    own.reset(1)
    own.load(host.save())
    assert np.array_equal(own.observation.numpy(), host.observation)
    own.set_statistics(*host.statistics), host.set_statistics(*host.statistics)
    assert np.array_equal(own.observe().numpy(), host.observe())


def test_pickles_of_a_class_of_ones_own_go_on():
    own, host = beside(Climb, 3)
    again = pickle.loads(pickle.dumps(own))
    host.step(host.sample(0)), again.step(host.sample(0))
    assert alike(again, host)
