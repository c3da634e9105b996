"""Ray: two workers give the bits of one batch, also where one of them is killed."""

import sys
import threading
import time

import numpy as np
import pytest
from conftest import same

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
    policy = omnidrones.train("Hover", apg={"updates": 2, "n_env": 16, "window": 8}, evaluate={"envs": 4}).policy
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
