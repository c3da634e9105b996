"""The batch API: shapes, settings, the same bits however it is cut."""

import copy
import pickle
import tracemalloc
import warnings

import numpy as np
import pytest
from conftest import flown, near_hover, same

import omnidrones


@pytest.mark.parametrize("name", omnidrones.tasks())
def test_every_task_steps_in_the_shapes_that_its_spec_tells(name):
    env = omnidrones.make(name, 3, threads=1)
    spec = env.spec
    assert env.reset(0).shape == (3, spec.n_agent, spec.n_observation)
    step = env.step(env.sample(0))
    shapes = [x.shape for x in step]
    assert shapes == [(3, spec.n_agent, spec.n_observation), (3, spec.n_agent), (3,), (3,), (3, len(spec.info))]
    assert [x.dtype.name for x in step] == ["float32", "float32", "bool", "bool", "float32"]
    assert env.central.shape == (3, spec.n_central) and env.privileged.shape == (3, spec.n_privileged)
    assert sum(field.size for field in spec.observation) == spec.n_observation
    assert env.states().shape == (3, len(env.state_names))
    assert env.parameters().shape == (3, len(env.parameter_names))
    low, high = spec.observation_bounds()
    assert (step.observation >= low).all() and (step.observation <= high).all()


def test_settings_come_as_keywords_dicts_toml_and_files_to_the_same_environments(tmp_path):
    file = tmp_path / "mine.toml"
    text = "dt = 0.01\n[task]\nhorizon = 70\n"
    file.write_text(text)
    ways = [{"dt": 0.01, "horizon": 70}, {"config": {"dt": 0.01, "task": {"horizon": 70}}}]
    ways += [{"config": text}, {"config": file}, {"config": str(file)}, {"config": {"dt": 0.5}, "dt": 0.01, "horizon": 70}]
    envs = [omnidrones.make("Hover", 2, seed=3, **way) for way in ways]
    assert {(env.spec.dt, env.spec.horizon, env.num_envs) for env in envs} == {(0.01, 70, 2)}
    for env in envs:
        env.reset()
    first, *others = (flown(env, 3) for env in envs)
    assert all(same(first, other) for other in others)


def test_a_setting_that_equals_its_default_counts_and_none_leaves_it_out():
    assert len(omnidrones.make("HoverRand", 1).config["randomise"]) == 9
    assert omnidrones.make("HoverRand", 1, randomise=[]).config["randomise"] == []
    assert len(omnidrones.make("HoverRand", 1, randomise=None).config["randomise"]) == 9


def test_columns_of_information_are_chosen_by_name():
    env, none = (omnidrones.make("Hover", 2, info=info) for info in (["position_error", "return"], []))
    assert env.spec.info == ("return", "position_error") and none.spec.info == ()
    env.reset(), none.reset()
    assert env.step(env.sample(0)).info.shape == (2, 2) and none.step(none.sample(0)).info.shape == (2, 0)


def test_numpy_numbers_arrays_and_paths_are_settings():
    env = omnidrones.make("Hover", np.int64(2), seed=np.uint64(2**63 + 5), dt=np.float32(0.0078125), horizon=np.int32(40))
    assert (env.num_envs, env.spec.dt, env.spec.horizon) == (2, 0.0078125, 40)
    changes = [{"what": "mass", "range": np.array([0.8, 1.2])}]
    assert omnidrones.make("Hover", 1, randomise=changes).config["randomise"][0]["range"] == [0.8, 1.2]


def test_a_vehicle_of_ones_own_flies_as_an_object_a_file_and_a_name(tmp_path):
    fields = omnidrones.Vehicle("hummingbird").to_dict()
    fields["name"] = "mine"
    own = omnidrones.Vehicle.from_dict(fields)
    (tmp_path / "mine.toml").write_text(own.to_toml())
    envs = [omnidrones.make("Hover", 2, seed=1, vehicle=v) for v in (own, str(tmp_path / "mine.toml"), "hummingbird")]
    for env in envs:
        env.reset()
    first, *others = (flown(env, 5) for env in envs)
    assert all(same(first, other) for other in others)


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        (lambda: omnidrones.make("Hovr"), ValueError, "did you mean 'Hover'"),
        (lambda: omnidrones.make("Hover", contrl="rate"), ValueError, "control"),
        (lambda: omnidrones.make("Hover", task={"vehicl": "iris"}), ValueError, "Did you mean `vehicle`?"),
        (lambda: omnidrones.make("Hover", vehicle="humingbird"), ValueError, "hummingbird"),
        (lambda: omnidrones.make("Hover", 10**12), ValueError, "memory"),
        (lambda: omnidrones.make("Hover", 0), ValueError, "whole number from 1 on"),
        (lambda: omnidrones.make("Hover", -1), OverflowError, "negative"),
        (lambda: omnidrones.make("Hover", 2, threads=0), ValueError, "number of threads is 0"),
        (lambda: omnidrones.make("Hover", 2, ring=0), ValueError, "ring is 0"),
        (lambda: omnidrones.make("Hover", 2, seed=-1), ValueError, "seed is -1"),
        (lambda: omnidrones.make("Hover", 2, dt=float("nan")), ValueError, "dt"),
        (lambda: omnidrones.make("Hover", 2, dt=object()), TypeError, "dt is a object"),
        (lambda: omnidrones.make("Hover", 2, horizon=2**70), ValueError, "horizon"),
        (lambda: omnidrones.make("Hover", 2, config="none.toml"), FileNotFoundError, "none.toml"),
        (lambda: omnidrones.make("Hover", 2, config="dt = long"), ValueError, "line 1, column 6"),
        (lambda: omnidrones.make("Hover", 2, config=3), TypeError, "config must be"),
        (lambda: omnidrones.make("Hover", 2, config={1: 2}), TypeError, "keys must be texts"),
        (lambda: omnidrones.make("Hover", 2).step(np.zeros((2, 1, 4), np.float32)), ValueError, "reset"),
        (lambda: omnidrones.make("Hover", 2).column("retrun"), ValueError, "did you mean 'return'"),
        (lambda: omnidrones.make("Hover", 2, info=["retrun"]), ValueError, "did you mean 'return'"),
        (lambda: omnidrones.make("Hover", 2, info=["loss"]).column("return"), ValueError, "Known: loss"),
        (lambda: omnidrones.load_policy("nowhere"), FileNotFoundError, "does not exist"),
        (lambda: omnidrones.Vehicle("none.urdf"), FileNotFoundError, "none.urdf"),
    ],
)
def test_a_mistake_is_an_exception_with_the_words_of_the_library(wrong, error, words):
    with pytest.raises(error) as raised:
        wrong()
    assert words in str(raised.value)


def test_threads_shards_copies_and_saved_states_give_the_same_bits():
    whole = omnidrones.make("Hover", 200, seed=7, threads=2)
    whole.reset()
    rows = flown(whole, 60)
    one = omnidrones.make("Hover", 200, seed=7, threads=1, ring=1)
    one.reset()
    assert same(rows, flown(one, 60))
    shards = [omnidrones.make("Hover", n, seed=7, first_environment=first) for first, n in ((0, 90), (90, 110))]
    for shard in shards:
        shard.reset()
    parts = [flown(shard, 60) for shard in shards]
    assert same(rows, [[np.concatenate(pair) for pair in zip(*step, strict=True)] for step in zip(*parts, strict=True)])
    twins = [pickle.loads(pickle.dumps(whole)), copy.deepcopy(whole)]
    assert all((twin.observation == whole.observation).all() for twin in twins)
    saved = whole.save()
    ahead = flown(whole, 20, 900)
    assert all(same(ahead, flown(twin, 20, 900)) for twin in twins)
    whole.load(saved)
    assert whole.observe().shape == (200, 1, 30)
    assert same(ahead, flown(whole, 20, 900))
    with pytest.raises(ValueError, match="omnienv|bytes|state"):
        whole.load(saved[:-1])


def test_seeds_masks_and_draws():
    env = omnidrones.make("Hover", 4, threads=1)
    first = env.reset(5).copy()
    assert not np.array_equal(first[0], first[1])
    assert np.array_equal(env.reset([5, 5, 5, 5]), first) and np.array_equal(env.reset(np.full(4, 5)), first)
    before = env.observation.copy()
    env.step(env.sample(0))
    moved = env.observation.copy()
    mask = np.array([True, False, False, True])
    after = env.reset(5, mask)
    assert np.array_equal(after[mask], before[mask]) and np.array_equal(after[~mask], moved[~mask])
    assert np.array_equal(env.sample(3), env.sample(3, out=np.empty((4, 1, 4), np.float32)))


def test_the_final_observation_is_the_one_that_environments_which_stand_still_show():
    goes, stands = (omnidrones.make("Hover", 64, seed=3, autoreset=mode) for mode in ("same_step", "disabled"))
    goes.reset(), stands.reset()
    going, seen = np.ones(64, bool), 0
    for t in range(500):
        actions = goes.sample(t)
        x, y = goes.step(actions), stands.step(actions)
        over = (x.terminated | x.truncated) & going
        assert np.array_equal(goes.final_observation[over], y.observation[over])
        seen, going = seen + over.sum(), going & ~over
    assert seen == 64


def test_arrays_take_turns_and_are_the_same_objects(hover):
    kept = hover.observation
    before = kept.copy()
    a = hover.step(hover.sample(0))
    assert np.array_equal(kept, before) and not np.shares_memory(kept, a.observation)
    b = hover.step(hover.sample(1))
    assert hover.step(hover.sample(2)) is a and hover.step(hover.sample(3)) is b
    assert hover.observation is b.observation and hover.column("length")[0] == 4


def test_a_step_into_rows_of_a_buffer_writes_what_a_step_returns(hover, rng):
    twin = copy.deepcopy(hover)
    n_step, spec = 5, hover.spec
    observation = np.empty((n_step, 8, 1, spec.n_observation), np.float32)
    reward, info = np.empty((n_step, 8), np.float32), np.empty((n_step, 8, len(spec.info)), np.float32)
    ended, cut = np.empty((n_step, 8), bool), np.empty((n_step, 8), np.uint8)
    for t in range(n_step):
        actions = near_hover(rng, hover)
        into = dict(observation=observation[t], reward=reward[t], terminated=ended[t], truncated=cut[t], info=info[t])
        assert hover.step_into(actions, **into) is None
        step = twin.step(actions)
        assert np.array_equal(step.observation, observation[t]) and np.array_equal(step.reward[:, 0], reward[t])
        assert np.array_equal(step.info, info[t]) and np.array_equal(step.terminated, ended[t])


def test_actions_come_in_joined_axes_and_by_dlpack(hover, rng):
    class Foreign:
        """An array of another package."""

        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **how):
            return self.array.__dlpack__(**how)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    actions = near_hover(rng, hover)
    twins = [copy.deepcopy(hover) for _ in range(3)]
    rows = [twin.step(given).observation for twin, given in zip(twins, (actions, actions.reshape(8, 4), Foreign(actions)))]
    assert np.array_equal(rows[0], rows[1]) and np.array_equal(rows[0], rows[2])
    assert np.array_equal(np.from_dlpack(rows[0]), rows[0])


def test_states_difficulty_and_statistics():
    env = omnidrones.make("HoverRand", 3, observation=[{"kind": "normalise", "clip": 10.0}], autoreset="disabled")
    env.reset(0)
    env.set_difficulty(0.5)
    with pytest.raises(ValueError, match="difficulty"):
        env.set_difficulty(1.5)
    state = env.states()
    state[1, 2] += 0.5
    env.set_state(1, state[1])
    assert np.array_equal(env.states(), state)
    count, mean, variance = env.statistics
    assert count == 0 and mean.shape == variance.shape
    for t in range(20):
        env.step(env.sample(t))
    env.update_normaliser()
    count, mean, variance = env.statistics
    assert count > 0
    twin = omnidrones.make("HoverRand", 3, config=env.config)
    twin.set_statistics(count, mean.tolist(), variance.tolist())
    assert np.array_equal(twin.statistics[1], mean)
    assert env.breach(0) is None and env.safe_command.shape == (4,) and env.goals().shape[0] == 3
    with pytest.raises(ValueError, match="environment is 3"):
        env.breach(3)


def test_a_step_allocates_nothing(hover, rng):
    actions = near_hover(rng, hover)
    for _ in range(10):
        hover.step(actions)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(1000):
        hover.step(actions)
    now, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert now - before < 1000 and peak - before < 4000, (before, now, peak)


def test_nothing_warns():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = omnidrones.make("Hover", 2)
        env.reset(0)
        env.step(env.sample(0))
        assert "Hover" in repr(env) and "Hover" in repr(env.spec)


def test_sensors_of_a_configuration_stand_behind_the_observation():
    plain = omnidrones.make("Hover", 3)
    seen = omnidrones.make("Hover", 3, sensor=[{"name": "imu", "kind": "imu"}])
    assert seen.spec.n_observation == plain.spec.n_observation + 6
    assert omnidrones.make("Forest", 1).config["sensor"][0]["kind"] == "lidar"
    assert omnidrones.make("Forest", 1, sensor=[]).config["sensor"] == []


@pytest.mark.parametrize("name", ["Hover", "Forest", "Formation"])
def test_a_batch_that_was_not_reset_is_copied_and_pickled(name):
    env = omnidrones.make(name, 3, seed=7)
    twins = [copy.copy(env), copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for twin in twins:
        with pytest.raises(ValueError, match="not started"):
            twin.step(twin.sample(0))
    first = env.reset().copy()
    assert all(np.array_equal(twin.reset(), first) for twin in twins)
    assert np.array_equal(copy.deepcopy(env).observation, first)
