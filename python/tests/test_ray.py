"""Ray: two workers give the bits of one batch, also where one of them is killed."""

import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from conftest import Climb, same

import omnidrones

ray = pytest.importorskip("ray")

N_ENV, N_STEP = 512, 40


class Linear:
    """A policy that looks at what it sees."""

    def __init__(self, seconds=0.0):
        self.seconds = seconds
        self.weights = (np.random.default_rng(0).normal(size=(30, 4)) * 0.02).astype(np.float32)

    def __call__(self, observation):
        time.sleep(self.seconds)
        return np.tanh(observation @ self.weights - np.float32(0.44))


@pytest.fixture(scope="module", autouse=True)
def cluster():
    # workers do not see the folder of the tests
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    yield
    ray.shutdown()


@pytest.fixture
def whole():
    """The rows of two rollouts in one process."""
    env, act = omnidrones.make("Hover", N_ENV, seed=11), Linear()
    env.reset()
    rollouts = []
    for _ in range(2):
        rows = {name: [] for name in ("observation", "action", "reward", "terminated", "truncated")}
        for _ in range(N_STEP):
            actions = act(env.observation)
            rows["observation"].append(env.observation.copy())
            rows["action"].append(actions)
            step = env.step(actions)
            for name in ("reward", "terminated", "truncated"):
                rows[name].append(getattr(step, name).copy())
        rollouts.append({name: np.stack(own) for name, own in rows.items()})
    return rollouts


def equal(rows, expected):
    return all(same([[rows[name]]], [[own]]) for name, own in expected.items())


def test_two_workers_give_the_bits_of_one_batch(whole):
    shards = omnidrones.ray.Shards("Hover", N_ENV, workers=2, seed=11)
    assert np.array_equal(shards.reset(), whole[0]["observation"][0])
    for expected in whole:
        assert equal(shards.rollout(Linear(), N_STEP), expected)
    assert shards.replaced == 0


def test_a_worker_that_is_killed_in_the_middle_is_replaced_and_nothing_is_lost(whole):
    shards = omnidrones.ray.Shards("Hover", N_ENV, workers=2, seed=11)
    shards.reset()
    assert equal(shards.rollout(Linear(), N_STEP), whole[0])
    threading.Timer(0.5, lambda: ray.kill(shards.workers[1])).start()
    assert equal(shards.rollout(Linear(seconds=0.03), N_STEP), whole[1])
    assert shards.replaced == 1


def test_a_policy_of_ours_travels():
    policy = omnidrones.train("Hover", apg={"updates": 2, "n_env": 16, "horizon": 8}, evaluate={"envs": 4}).policy
    rows = omnidrones.ray.Shards("Hover", 16, workers=2, seed=1)
    rows.reset()
    rollout = rows.rollout(policy, 3)
    assert np.array_equal(rollout["action"][0], policy(rollout["observation"][0]))
    with pytest.raises(ValueError, match="workers is 0"):
        omnidrones.ray.Shards("Hover", 16, workers=0)


def test_a_worker_that_cannot_be_made_is_told_of_and_not_made_again():
    shards = omnidrones.ray.Shards("Hover", 16, workers=2, dt=-1.0)
    with pytest.raises(ray.exceptions.RayActorError, match="dt"):
        shards.reset()
    assert shards.replaced == 0


def test_an_evaluation_in_parts_tells_what_one_process_tells():
    policy = omnidrones.train("Hover", apg={"updates": 40}, evaluate={"envs": 4}).policy
    whole = omnidrones.evaluate(policy, num_envs=200)
    assert omnidrones.ray.evaluate(policy, num_envs=200, workers=3) == whole and 0 < whole["crashed"]
    act = Held()
    assert omnidrones.ray.evaluate(act, "Track", num_envs=50, workers=2, horizon=60, seed=3) == omnidrones.evaluate(
        act, "Track", num_envs=50, horizon=60, seed=3
    )
    with pytest.raises(ValueError, match="workers is 0"):
        omnidrones.ray.evaluate(policy, workers=0)


class Held:
    """A policy whose rows do not depend on those beside."""

    def __call__(self, observation):
        return np.clip(observation[..., :4] * np.float32(0.01) - np.float32(0.44), -1, 1)


SMALL = {"apg": {"n_env": 16, "horizon": 8, "updates": 12}, "evaluate": {"envs": 16}, "horizon": 40}


class DieOnce:
    """A watcher that kills its own worker in the middle of a run, once, and keeps the numbers of all updates that it saw."""

    def __init__(self, marker):
        self.marker, self.seen = marker, marker.with_name("seen")

    def __call__(self, progress):
        with open(self.seen, "a") as file:
            file.write(f"{progress.update}\n")
        if progress.update == 7 and not self.marker.exists():
            self.marker.write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)


def test_a_sweep_survives_the_death_of_a_worker_and_goes_on_to_the_same_bits(tmp_path):
    alone = [omnidrones.train("Hover", seed=seed, **SMALL) for seed in (0, 1)]
    settings = SMALL | {"checkpoint": {"every": 2}, "watch": DieOnce(tmp_path / "died")}
    rows = omnidrones.ray.train_all(["Hover", "Track"], seeds=2, folder=tmp_path / "runs", **settings)
    assert (tmp_path / "died").exists()
    seen = (tmp_path / "seen").read_text().split()
    assert seen.count("1") == 4, "who lost its worker goes on, it does not begin again"
    assert seen.count("7") == 5
    assert [(r["task"], r["seed"]) for r in rows] == [("Hover", 0), ("Hover", 1), ("Track", 0), ("Track", 1)]
    assert all(row["updates"] == 12 for row in rows)
    for seed, run in enumerate(alone):
        kept = omnidrones.load_policy(tmp_path / "runs" / f"Hover-{seed}")
        assert np.array_equal(kept.parameters(), run.policy.parameters())
        assert {name: rows[seed][name] for name in run.evaluation} == run.evaluation
    again = omnidrones.ray.train_all(["Hover", "Track"], seeds=2, folder=tmp_path / "runs", **settings)
    told = lambda rows: [{name: x for name, x in row.items() if name != "seconds"} for row in rows]  # noqa: E731
    assert told(again) == told(rows)
    assert (tmp_path / "seen").read_text().split() == seen, "what is finished is only evaluated"
    with pytest.raises(ValueError, match="each may stand once"):
        omnidrones.ray.train_all(["Hover", "Hover"], folder=tmp_path / "runs", **settings)
    with pytest.raises(RuntimeError, match="settings"):
        omnidrones.ray.train_all(["Hover"], seeds=1, folder=tmp_path / "runs", **settings | {"horizon": 50})


def test_a_run_that_fails_by_itself_is_told_of_and_the_others_are_kept(tmp_path):
    (tmp_path / "Track-0").write_text("a file where a folder should be")
    with pytest.raises(RuntimeError, match="1 of 2 runs failed. Track, seed 0"):
        omnidrones.ray.train_all(["Hover", "Track"], seeds=1, folder=tmp_path, **SMALL)
    assert omnidrones.load_policy(tmp_path / "Hover-0").task == "Hover"


def test_an_unknown_task_is_told_of_before_anything_is_trained(tmp_path):
    with pytest.raises(ValueError, match="no task is called 'Nobody'"):
        omnidrones.ray.train_all(["Hover", "Nobody"], seeds=1, folder=tmp_path, **SMALL)
    assert not any(tmp_path.iterdir())


class Upward:
    """A policy whose rows do not depend on those beside."""

    def __call__(self, observation):
        return np.clip(observation[..., :1] * np.float32(0.1) - np.float32([0.43, 0.42, 0.41, 0.4]), -1, 1)


def test_two_workers_give_the_bits_of_one_batch_of_a_class_of_ones_own():
    how = {"seed": 5, "height": 1.7}
    env, act = omnidrones.make(Climb, 64, **how), Upward()
    shards = omnidrones.ray.Shards(Climb, 64, workers=2, **how)
    assert np.array_equal(shards.reset(), env.reset())
    rows = shards.rollout(act, 80)
    for t in range(80):
        assert np.array_equal(rows["observation"][t], env.observation)
        step = env.step(act(env.observation))
        assert np.array_equal(rows["reward"][t], step.reward) and np.array_equal(rows["terminated"][t], step.terminated)
    assert rows["truncated"].any() or rows["terminated"].any()


def test_parts_of_an_evaluation_of_a_class_of_ones_own_tell_what_the_whole_tells():
    act = Upward()
    whole = omnidrones.evaluate(act, Climb, num_envs=50, seed=3)
    assert omnidrones.ray.evaluate(act, Climb, num_envs=50, workers=2, seed=3) == whole


def test_a_worker_of_a_class_of_ones_own_is_replaced():
    shards = omnidrones.ray.Shards(Climb, 16, workers=2, seed=5)
    env, act = omnidrones.make(Climb, 16, seed=5), Upward()
    assert np.array_equal(shards.reset(), env.reset())
    ray.kill(shards.workers[0])
    rows = shards.rollout(act, 10)
    for t in range(10):
        assert np.array_equal(rows["observation"][t], env.observation)
        env.step(act(env.observation))
    assert shards.replaced == 1


def test_a_sweep_trains_a_class_of_ones_own(tmp_path):
    alone = omnidrones.train(Climb, seed=0, algorithm="apg", **SMALL)
    rows = omnidrones.ray.train_all([Climb, "Hover"], seeds=1, folder=tmp_path, algorithm="apg", **SMALL)
    assert [row["task"] for row in rows] == ["Climb", "Hover"]
    assert {name: rows[0][name] for name in alone.evaluation} == alone.evaluation
    kept = omnidrones.load_policy(tmp_path / "Climb-0")
    assert np.array_equal(kept.parameters(), alone.policy.parameters())


def test_rllibs_runners_step_our_batches_and_its_ppo_trains():
    pytest.importorskip("ray.rllib", reason="not run: RLlib's own packages are not here (ray[rllib])")
    from ray.rllib.algorithms.ppo import PPOConfig

    config = (
        PPOConfig()
        .environment("omnidrones:Hover-v0", env_config={"threads": 1, "stagger": True})
        .env_runners(
            num_env_runners=1,
            num_envs_per_env_runner=32,
            rollout_fragment_length=16,
            gym_env_vectorize_mode="vector_entry_point",
        )
        .training(train_batch_size_per_learner=512, minibatch_size=256, num_epochs=1)
    )
    algorithm = config.build_algo()
    try:
        told = [algorithm.train() for _ in range(8)]
        kinds = algorithm.env_runner_group.foreach_env_runner(lambda runner: type(runner.env.unwrapped).__name__, local_env_runner=False)
    finally:
        algorithm.stop()
    assert told[-1]["num_env_steps_sampled_lifetime"] >= 8 * 512 and "VectorEnv" in kinds
    returns = [row["env_runners"]["episode_return_mean"] for row in told if "episode_return_mean" in row["env_runners"]]
    assert np.isfinite(returns).all() and returns
