"""Stable-Baselines3: its checker, its wrappers, and a PPO that learns."""

import warnings

import numpy as np
import pytest
from conftest import Climb

import omnidrones

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.utils import set_random_seed  # noqa: E402
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor, VecNormalize  # noqa: E402

from omnidrones.sb3 import VecEnv  # noqa: E402


@pytest.mark.parametrize("name", ["Hover", "PayloadTrack", "Formation"])
def test_its_checker_passes(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(omnidrones.gym.Env(name))


def test_ended_episodes_have_their_last_observation_and_say_why():
    env = VecEnv("Hover", 8, stagger=True, horizon=80)
    env.seed(0)
    env.reset()
    rng, cut, ended = np.random.default_rng(0), 0, 0
    for _ in range(300):
        actions = (rng.uniform(-1, 1, (8, 4)) * 0.02 - 0.415).astype(np.float32)
        observation, _, done, infos = env.step(actions)
        for i in np.flatnonzero(done):
            assert infos[i]["terminal_observation"].shape == observation[i].shape
            assert infos[i]["episode"]["l"] <= 80
            cut += infos[i]["TimeLimit.truncated"]
            ended += not infos[i]["TimeLimit.truncated"]
    assert cut and ended
    assert env.env_is_wrapped(VecMonitor) == [False] * 8 and len(env.env_method("states")) == 8
    VecNormalize(VecCheckNan(VecMonitor(env))).reset()


def test_an_ended_episode_says_its_return_and_length_whatever_columns_are_chosen():
    env = VecEnv("Hover", 2, horizon=3, info=["success"])
    env.reset()
    ended = [info for _ in range(3) for info in env.step(np.full((2, 4), -0.415, np.float32))[3] if info]
    assert [info["episode"]["l"] for info in ended] == [3, 3] and "success" in ended[0] and "loss" not in ended[0]


def test_its_seed_is_ours():
    rows = []
    for _ in range(2):
        env = VecEnv("Hover", 4)
        env.seed(3)
        rows.append(env.reset())
    assert np.array_equal(*rows)


def test_without_a_seed_it_draws_one_and_goes_on_from_it():
    def begun(seed=None):
        if seed is not None:
            set_random_seed(seed)
        env = VecEnv("Hover", 4)
        return env.reset(), env.reset()

    starts = [begun()[0] for _ in range(3)]
    assert not any(np.array_equal(a, b) for a in starts for b in starts if a is not b)
    (first, second), (again, _), (third, _) = (begun(seed) for seed in (5, 5, 6))
    assert np.array_equal(first, again) and not np.array_equal(first, second) and not np.array_equal(first, third)
    for seed in (0, 3):
        own = omnidrones.make("Hover", 4, seed=seed).reset().reshape(4, -1)
        assert np.array_equal(VecEnv("Hover", 4, seed=seed).reset(), own)


def test_ppo_runs_unchanged():
    model = PPO("MlpPolicy", VecEnv("Hover", 16), n_steps=32, batch_size=128, n_epochs=1, device="cpu")
    model.learn(2048)
    assert np.isfinite(model.predict(np.zeros((16, 30), np.float32))[0]).all()


def test_a_class_of_ones_own_is_trained():
    env, named = VecEnv(Climb, 4, seed=1), VecEnv("Climb", 4, seed=1)
    assert np.array_equal(env.reset(), named.reset())
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=64, n_epochs=1, seed=0, device="cpu")
    model.learn(128)
    assert model.num_timesteps == 128
