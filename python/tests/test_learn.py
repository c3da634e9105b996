"""Training, evaluation, policies."""

import copy

import numpy as np
import pytest
from conftest import flown

import omnidrones

SMALL = {"evaluate": {"envs": 16}, "apg": {"n_env": 16, "horizon": 8, "updates": 6}, "horizon": 40, "log_every": 1}


def test_a_policy_hovers_after_a_training_from_random_weights():
    run = omnidrones.train("Hover", seed=101)
    assert run.evaluation["success"] >= 0.98 and not run.stopped and run.updates == len(run.curve["update"]) * 10
    again = omnidrones.evaluate(run.policy)
    assert again == run.evaluation

    weights = run.policy.weights()

    def by_numpy(observation):
        x = observation
        for k in range(3):
            x = x @ weights[f"{k}.weight"].T + weights[f"{k}.bias"]
            x = np.tanh(x) if k == 2 else ELU(x) if run_activation == "elu" else np.tanh(x)
        return x

    ELU, run_activation = (lambda x: np.where(x > 0, x, np.expm1(x))), "tanh"
    x = np.zeros((2, 1, 30), np.float32)
    assert run.policy(x).shape == (2, 1, 4)
    figures = omnidrones.evaluate(lambda seen: run.policy(seen), "Hover", config=run.policy.config)
    assert figures["success"] == run.evaluation["success"]


@pytest.mark.parametrize("algorithm, settings", [
    ("matd3", {"td3": {"separate_actors": True}}),
    ("qmix", {"dqn": {"separate_values": True}}),
])
def test_weights_of_agents_with_a_network_each_have_names_of_their_own(algorithm, settings):
    settings = {name: {"n_env": 16, "shard": 16, "updates": 1, **own} for name, own in settings.items()}
    run = omnidrones.train("OverHover", algorithm=algorithm, seed=1, evaluate={"envs": 16}, **settings)
    weights = run.policy.weights()
    heads = {name.split(".")[0] for name in weights}
    assert heads == {"agent0", "agent1", "agent2", "agent3"}
    first, second = weights["agent0.0.weight"], weights["agent1.0.weight"]
    assert first.shape == second.shape and not np.array_equal(first, second)


def test_watchers_see_every_update_and_may_stop():
    seen = []
    run = omnidrones.train("Hover", watch=lambda p: seen.append((p.update, p.budget, p.loss)) or p.update < 3, **SMALL)
    assert [update for update, *_ in seen] == [1, 2, 3] and run.stopped and run.updates == 3
    assert all(budget == 6 and np.isfinite(loss) for _, budget, loss in seen)


def test_a_run_in_a_folder_goes_on_to_the_same_bits(tmp_path):
    whole = omnidrones.train("Hover", folder=tmp_path / "a", **SMALL)
    part = omnidrones.train("Hover", folder=tmp_path / "b", watch=lambda p: p.update < 3, **SMALL)
    rest = omnidrones.train("Hover", folder=tmp_path / "b", resume=True, **SMALL)
    assert part.stopped and not rest.stopped
    assert np.array_equal(whole.policy.parameters(), rest.policy.parameters())
    for path in (tmp_path / "b", rest.checkpoint):
        saved = omnidrones.load_policy(path)
        assert saved.task == "Hover" and np.array_equal(saved.parameters(), whole.policy.parameters())
    with pytest.raises(ValueError, match="holds a run already"):
        omnidrones.train("Hover", folder=tmp_path / "b", **SMALL)


def test_settings_of_runs_and_of_environments_are_keywords_and_mistakes_have_names():
    run = omnidrones.train("Hover", algorithm="ppo", ppo={"updates": 1, "n_env": 16}, dt=0.01, evaluate={"envs": 4})
    assert run.updates == 1 and run.policy.config["dt"] == 0.01
    for wrong, words in [({"algorithm": "pp"}, "ppo"), ({"apg": {"update": 1}}, "updates"), ({"horizn": 3}, "horizon")]:
        with pytest.raises(ValueError, match=words):
            omnidrones.train("Hover", **wrong)


def test_a_policy_refuses_what_is_not_its_own():
    policy = omnidrones.train("Hover", **SMALL).policy
    assert policy(np.zeros(30, np.float32)).shape == (4,) and policy(np.zeros((0, 1, 30), np.float32)).shape == (0, 1, 4)
    with pytest.raises(ValueError, match="shape of observation"):
        policy(np.zeros((2, 29), np.float32))
    with pytest.raises(TypeError, match="float32"):
        policy(np.zeros((2, 30)))
    with pytest.raises(ValueError, match="observation"):
        omnidrones.evaluate(policy, "PayloadHover", num_envs=2)
    with pytest.raises(TypeError, match="name is missing"):
        omnidrones.evaluate(lambda x: x)


def test_the_librarys_controller_flies_a_batch():
    env = omnidrones.make("Hover", 4, autoreset="disabled", horizon=200)
    env.reset(1)
    controller = omnidrones.Controller(env)
    for _ in range(200):
        env.step(controller(env))
    assert controller.name and (env.column("position_error") < 0.3).all()
    with pytest.raises(ValueError, match="environment of a baseline"):
        controller(omnidrones.make("Hover", 5))


def test_a_controller_of_the_table_flies_a_batch_with_the_same_bits_on_any_threads():
    def flown(threads):
        env = omnidrones.make("PayloadHover", 3, autoreset="disabled", horizon=5, threads=threads)
        env.reset(1)
        controller = omnidrones.Controller(env, name="mpc")
        assert controller.name == "mpc"
        actions = [controller(env)]
        env.step(actions[0])
        return np.concatenate([*actions, controller(env)])

    assert np.array_equal(flown(1), flown(2))
    env = omnidrones.make("PayloadHover", 1)
    for name, words in [("mpx", "did you mean 'mpc'"), ("cascade", "take one that flies it: lqr, formation, mpc")]:
        with pytest.raises(ValueError, match=words):
            omnidrones.Controller(env, name)


def test_recipes_name_the_algorithms_of_a_task():
    assert omnidrones.recipes("hover") == ["apg", "shac", "ppo", "sac", "td3", "dqn", "qmix"]
    with pytest.raises(ValueError, match="Hover"):
        omnidrones.recipes("Hovr")


def test_episodes_of_shards_are_judged_as_those_of_the_whole():
    def held(observation):
        return np.clip(observation[..., :4] * np.float32(0.01) - np.float32(0.44), -1, 1)

    shards = [omnidrones._core._fly_shard(held, "Hover", n, first) for n, first in ((60, 0), (40, 60))]
    whole = omnidrones.evaluate(held, "Hover", num_envs=100)
    assert omnidrones._core._evaluation(shards, held, "Hover") == whole and whole["crashed"] > 0
    with pytest.raises(ValueError, match="info has the shape"):
        omnidrones._core._evaluation(shards, held, "FlyThrough")
