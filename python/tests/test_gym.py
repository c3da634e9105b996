"""Gymnasium: its own checkers, and its own vector environment around our single ones as the witness of ours."""

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from conftest import Climb
from gymnasium.error import ClosedEnvironmentError
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import omnidrones
from omnidrones.gym import Env, VectorEnv


@pytest.mark.parametrize("name", omnidrones.tasks())
def test_gymnasiums_checker_passes_for_every_task(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"omnidrones:{name}-v0").unwrapped, skip_render_check=True)


@pytest.mark.parametrize("actions", [{"kind": "multi_discrete", "levels": 3}, {"kind": "discrete", "levels": 2}])
def test_gymnasiums_checker_passes_for_whole_numbers(actions):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # it would rather have numbers that are not whole
        warnings.filterwarnings("ignore", message=".*[Bb]ox action space")
        check_env(gymnasium.make("omnidrones:Hover-v0", actions=actions).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", ["Hover", "Formation"])
def test_a_batch_is_bit_equal_to_gymnasiums_own_vector_of_single_environments(name, mode, rng):
    n, n_step, how = 5, 260, {"horizon": 60}
    ours = gymnasium.make_vec(f"omnidrones:{name}-v0", num_envs=n, autoreset_mode=mode, **how)
    assert isinstance(ours, VectorEnv) and ours.metadata["autoreset_mode"] is mode
    singles = [lambda i=i: Env(name, first_environment=i, **how) for i in range(n)]
    theirs = SyncVectorEnv(singles, autoreset_mode=mode)
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    x, y = ours.reset(seed=[3] * n)[0], theirs.reset(seed=[3] * n)[0]
    assert x.tobytes() == y.tobytes()
    n_end = 0
    for _ in range(n_step):
        actions = (rng.uniform(-1, 1, ours.action_space.shape) * 0.2 - 0.41).astype(np.float32)
        x, y = ours.step(actions), theirs.step(actions)
        assert x[0].tobytes() == y[0].tobytes()
        assert all(np.array_equal(a, b) for a, b in zip(x[1:4], y[1:4], strict=True))
        over = x[2] | x[3]
        n_end += over.sum()
        if mode is AutoresetMode.SAME_STEP and over.any():
            assert np.array_equal(x[4]["_final_obs"], y[4]["_final_obs"])
            for i in np.flatnonzero(over):
                assert np.array_equal(x[4]["final_obs"][i], y[4]["final_obs"][i])
                assert x[4]["final_info"]["return"][i] == np.float32(y[4]["final_info"]["return"][i])
        if mode is AutoresetMode.DISABLED and over.any():
            again = {"reset_mask": over.copy()}
            a, b = ours.reset(options=again)[0], theirs.reset(options={"reset_mask": over.copy()})[0]
            assert np.array_equal(a[over], b[over])
    assert n_end > 5


def test_columns_are_told_for_every_environment_or_not_at_all(rng):
    env = VectorEnv("Hover", 3)
    env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    assert info["length"].tolist() == [1, 1, 1] and info["_length"].all()
    env = VectorEnv("Hover", 3, info="none")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[4] == {}
    with pytest.raises(ValueError, match="'columns' or 'none'"):
        VectorEnv("Hover", 3, info="all")


def test_arrays_are_the_callers_own_unless_told_otherwise():
    for copy in (True, False):
        env = VectorEnv("Hover", 3, copy=copy)
        env.reset(seed=0)
        observation = env.step(env.action_space.sample())[0]
        assert np.shares_memory(observation, env.batch.observation) is not copy


def test_wrappers_of_gymnasium_work():
    env = gymnasium.make_vec("omnidrones:Hover-v0", num_envs=4, max_episode_steps=50)
    wrapped = gymnasium.wrappers.vector
    env = wrapped.NormalizeObservation(wrapped.RecordEpisodeStatistics(env))
    env.reset(seed=0)
    lengths = []
    for _ in range(200):
        *_, info = env.step(env.action_space.sample())
        if "episode" in info:
            lengths.extend(info["episode"]["l"][info["_episode"]].tolist())
    assert lengths and max(lengths) <= 50
    env.close()


def test_a_closed_environment_says_so():
    for env in (Env("Hover"), VectorEnv("Hover", 2)):
        env.reset(seed=0)
        env.close()
        env.close()
        for call in (env.reset, lambda env=env: env.step(env.action_space.sample())):
            with pytest.raises(ClosedEnvironmentError):
                call()


@pytest.mark.parametrize(
    "first",
    [
        "gymnasium, omnidrones",
        "omnidrones, gymnasium",
        "gymnasium",
        "omnidrones, importlib.util; importlib.util.find_spec('gymnasium'); import gymnasium",
    ],
)
def test_ids_are_known_whichever_package_comes_first(first):
    code = f"import {first}; gymnasium.make('omnidrones:Hover-v0').reset(seed=0); print(gymnasium.make_vec('omnidrones:Track-v0', num_envs=2))"
    told = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert told.returncode == 0 and "VectorEnv" in told.stdout, told.stderr


def test_gymnasium_is_not_imported_for_its_ids():
    code = "import sys, omnidrones; sys.exit('gymnasium' in sys.modules or 'pettingzoo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_seed_among_the_settings_is_that_of_the_first_reset():
    for make in (lambda seed: VectorEnv("Hover", 4, seed=seed), lambda seed: Env("Hover", seed=seed)):
        first, again, other = (make(seed).reset()[0] for seed in (5, 5, 6))
        assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_a_class_of_ones_own_is_an_environment_by_its_id_and_as_it_is():
    omnidrones.register(Climb)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("omnidrones:Climb-v0").unwrapped, skip_render_check=True)
    rows = []
    for env in (gymnasium.make("omnidrones:Climb-v0", height=1.5), Env(Climb, height=1.5), Env("climb", height=1.5)):
        observation, _ = env.reset(seed=3)
        rows.append(np.append(observation, env.step(np.full(4, -0.4, np.float32))[0]))
    assert np.array_equal(rows[0], rows[1]) and np.array_equal(rows[0], rows[2])
    batches = [gymnasium.make_vec("omnidrones:Climb-v0", num_envs=3), VectorEnv(Climb, 3)]
    assert all(isinstance(env, VectorEnv) for env in batches)
    assert np.array_equal(batches[0].reset(seed=1)[0], batches[1].reset(seed=1)[0])


def test_functions_of_ones_own_go_through_an_id():
    def reward(view, terms):
        terms.term("high", "z/(1 + z)", 1.0, view.drone().position[2] / (1.0 + view.drone().position[2]), low=-1.0)

    env = gymnasium.make("omnidrones:Hover-v0", reward=reward)
    env.reset(seed=0)
    assert "reward_high" in env.step(np.full(4, -0.4, np.float32))[4]
    many = gymnasium.make_vec("omnidrones:Hover-v0", num_envs=2, reward=reward)
    many.reset(seed=0)
    assert "reward_high" in many.step(many.action_space.sample())[4]


@pytest.mark.parametrize("first", ["gymnasium", "omnidrones"])
def test_a_class_that_is_registered_before_or_behind_the_import_of_gymnasium_has_its_id(first):
    then = "omnidrones" if first == "gymnasium" else "gymnasium"
    imports = f"import {first}; import {then}; from conftest import Climb; omnidrones.register(Climb)"
    late = "import omnidrones; from conftest import Climb; omnidrones.register(Climb); import gymnasium"
    for begin in (imports, late):
        code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); {begin}; gymnasium.make('Climb-v0').reset(seed=0)"
        subprocess.run([sys.executable, "-c", code], check=True)
