"""PyTorch, Gymnasium and TorchRL on a device, through the stand-in: the tensors of the host."""

import gc
import shutil
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest

import omnidrones

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="not run: no C++ compiler for the stand-in")
EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(scope="module", autouse=True)
def kernels(tmp_path_factory):
    """Each kernel is compiled once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMNIDRONES_KERNELS", str(tmp_path_factory.mktemp("kernels")))
        yield


def beside(name, n, **settings):
    return [omnidrones.make(name, n, device=device, seed=3, **settings) for device in ("emulated", None)]


def test_tensors_of_a_device_are_views_with_the_bits_of_the_host():
    own, host = (omnidrones.torch.TensorEnv(env) for env in beside("Spread", 66, truncate_after=7))
    assert torch.equal(own.reset(5), host.reset(5)) and own.device == torch.device("cpu")
    seen, names = own.observation, ["central", "privileged", "final_observation", "final_central"]
    for t in range(20):
        action = torch.from_numpy(host.env.sample(t))
        a, b = own.step(action), host.step(action.double())
        assert all(map(torch.equal, a, b)), t
        assert a.observation.data_ptr() == own.observation.data_ptr() == seen.data_ptr(), "written in place"
        over = a.terminated | a.truncated
        for name in names:
            rows = over if name.startswith("final") else slice(None)
            assert torch.equal(getattr(own, name)[rows], getattr(host, name)[rows])
        mask = torch.arange(66) % 7 == t % 7
        assert torch.equal(own.reset(mask=mask), host.reset(mask=mask))
    assert torch.equal(own.column("return"), host.column("return")) and torch.equal(own.observe(), host.observe())
    assert torch.equal(own.reset(7, mask), host.reset(7, mask))
    assert torch.equal(own.reset(mask=mask[:, None].expand(66, 2)[:, :1]), host.reset(mask=mask))
    assert torch.equal(own.sample(3), host.sample(3)) and own.num_envs == 66
    for wrong, error, words in [
        (action.to("meta"), ValueError, "Move one"),
        (action.long(), TypeError, "floats"),
        (action.numpy(), TypeError, "as_tensor"),
        (None, TypeError, "NoneType"),
        (action.reshape(33, -1), ValueError, "66"),
    ]:
        for env in (own, host):
            with pytest.raises(error, match=words):
                env.step(wrong)
    with pytest.raises(TypeError, match="omnidrones.make"):
        omnidrones.torch.TensorEnv("Hover")


@pytest.mark.parametrize("name", ["Spread", "PayloadTrack"])
def test_autograd_through_a_window_on_a_device_has_the_bits_of_the_host(name):
    def gradients(env):
        rollout = omnidrones.torch.Rollout(env, 6, decay=0.99)
        env.reset(5)
        env.step(env.sample(9))
        actions = [torch.from_numpy(env.sample(t)).requires_grad_() for t in range(6)]
        for _ in range(2):
            rollout.begin()
            cost = torch.zeros(())
            for action in actions:
                step = rollout.step(action)
                weight = torch.linspace(-1, 1, step.observation.shape[-1])
                cost = cost + step.reward.sum() + 0.1 * step.loss.mean() + (step.observation * weight).sum()
            cost.backward()
        return [action.grad for action in actions]

    own, host = map(gradients, beside(name, 5))
    assert all(map(torch.equal, own, host)) and any(x.abs().max() > 0 for x in own)


@pytest.mark.parametrize("device", ["emulated", None])
def test_a_window_is_walked_back_once_before_the_next_begins(device):
    env = omnidrones.make("Hover", 3, device=device)
    env.reset(0)
    rollout = omnidrones.torch.Rollout(omnidrones.torch.TensorEnv(env), 3)
    actions = [torch.full((3, 4), -0.4, dtype=torch.float64, requires_grad=True) for _ in range(3)]
    losses = [rollout.step(action).loss.sum() for action in actions]
    with pytest.raises(RuntimeError, match="begin"):
        rollout.step(actions[0])
    losses[2].backward(retain_graph=True)
    assert actions[0].grad.dtype == torch.float64 and actions[0].grad.abs().max() > 0
    with pytest.raises(RuntimeError, match="walked back once"):
        losses[1].backward()
    rollout.begin()
    late = [rollout.step(action).loss.sum() for action in actions]
    rollout.begin()
    with pytest.raises(RuntimeError, match="forgotten"):
        sum(late).backward()


@pytest.mark.parametrize("device", ["emulated", None])
@pytest.mark.parametrize("walks", [False, True])
def test_a_rollout_that_nobody_has_holds_no_memory(device, walks):
    env = omnidrones.make("Hover", 3, device=device)
    env.reset(0)

    def ghost():
        rollout = omnidrones.torch.Rollout(env, 3)
        actions = [torch.full((3, 4), -0.4, requires_grad=True) for _ in range(3)]
        cost = sum(rollout.step(action).loss.sum() for action in actions)
        if walks:
            cost.backward()
        return weakref.ref(rollout._window)

    own = ghost()
    gc.collect()
    assert own() is None


def test_views_of_inference_may_be_learnt_from_later():
    env = omnidrones.torch.TensorEnv(omnidrones.make("Hover", 3, device="emulated"))
    with torch.inference_mode():
        env.reset(), env.step(env.sample(0))
    weight = torch.ones(env.spec.n_observation, requires_grad=True)
    (env.observation * weight).sum().backward()
    assert weight.grad is not None


def test_captured_work_is_the_work_itself_where_there_is_no_card():
    env = omnidrones.torch.TensorEnv(omnidrones.make("Hover", 2, device="emulated"))
    rollout = omnidrones.torch.Rollout(env, 1)
    for own in (env, env.env, rollout):
        assert omnidrones.torch.captured(env.observe, own) == env.observe
    with pytest.raises(TypeError, match="omnidrones.make"):
        omnidrones.torch.captured(env.observe, "cuda")


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
@pytest.mark.parametrize("name", ["Hover", "Spread"])
def test_gymnasiums_batches_on_a_device_are_those_of_the_host_as_tensors(name, mode):
    gymnasium = pytest.importorskip("gymnasium")
    mode = {own.name.lower(): own for own in gymnasium.vector.AutoresetMode}[mode]
    how = {"num_envs": 5, "autoreset_mode": mode, "max_episode_steps": 30}
    own, host = (gymnasium.make_vec(f"omnidrones:{name}-v0", device=device, **how) for device in ("emulated", None))
    assert torch.equal(own.reset(seed=3)[0], torch.from_numpy(host.reset(seed=3)[0]))
    host.action_space.seed(0)
    with pytest.raises(ValueError, match="5"):
        own.step(torch.zeros(4, 5 * host.single_action_space.shape[0] // 4))
    ends = 0
    for _ in range(70):
        actions = host.action_space.sample()
        a, b = own.step(torch.from_numpy(actions)), host.step(actions)
        for x, y in zip(a[:4], b[:4]):
            assert isinstance(x, torch.Tensor) and torch.equal(x, torch.from_numpy(y)) and x.is_contiguous()
        over = a[2] | a[3]
        ends += int(over.sum())
        for key, value in b[4].items():
            if key == "final_obs":
                assert torch.equal(a[4][key][over], torch.from_numpy(value)[over])
            elif key == "final_info":
                assert all(torch.equal(a[4][key][name], torch.from_numpy(value[name])) for name in value)
            else:
                assert torch.equal(a[4][key], torch.from_numpy(value)), key
        if mode.name == "DISABLED" and over.any():
            again = [env.reset(options={"reset_mask": which})[0] for env, which in ((own, over), (host, over.numpy()))]
            assert torch.equal(again[0], torch.from_numpy(again[1]))
    assert ends > 5
    own.close()
    lent = gymnasium.make_vec(f"omnidrones:{name}-v0", device="emulated", copy=False, **how)
    lent.reset(seed=3)
    first = lent.step(actions)[0]
    assert lent.step(actions)[0].data_ptr() == first.data_ptr()


@pytest.mark.parametrize("how", [{}, {"actions": {"kind": "multi_discrete", "levels": 3}}, {"actions": {"kind": "discrete", "levels": 2}}])
def test_torchrls_environment_on_a_device_is_that_of_the_host(how):
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    from omnidrones.torchrl import Env

    check_env_specs(Env("Hover", 4, device="emulated", **how))
    how |= {"horizon": 20, "seed": 5, "columns": ("success", "return")}
    own, host = (Env("Hover", 3, device=device, **how) for device in ("emulated", None))

    def acted(td):
        torch.manual_seed(int(td["observation"].abs().sum() * 1e3) % 2**31)
        return td.set("action", host.action_spec.rand())

    rows = [env.rollout(50, policy=acted, break_when_any_done=False) for env in (own, host)]
    assert rows[0]["next", "done"].any()
    for key in ["observation", ("next", "observation"), ("next", "success"), ("next", "return"), ("next", "reward"), ("next", "done"), ("next", "terminated")]:
        assert torch.equal(rows[0][key], rows[1][key]), key


def run(example, *arguments):
    program = [sys.executable, str(EXAMPLES / f"{example}.py"), *arguments]
    return subprocess.run(program, capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.parametrize(("example", "n"), [("apg_torch", "3"), ("ppo_torch", "70000")])
def test_examples_learn_the_same_on_a_device(example, n):
    own, host = (run(example, n, device) for device in ("emulated", "cpu"))
    told = [[line for line in lines if "per second" not in line] for lines in (own, host)]
    assert told[0] == told[1] and len(told[0]) >= 2


def test_ppo_written_in_pytorch_hovers():
    assert float(run("ppo_torch")[-1].split()[-1]) >= 0.9
