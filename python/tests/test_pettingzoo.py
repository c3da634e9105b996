"""PettingZoo: its own checkers."""

import warnings

import numpy as np
import pytest
from conftest import Climb
from pettingzoo.test import parallel_api_test, parallel_seed_test

import omnidrones
from omnidrones.pettingzoo import parallel_env

TEAMS = [name for name in omnidrones.tasks() if omnidrones.make(name, 1).spec.n_agent > 1]


@pytest.mark.parametrize("name", omnidrones.tasks())
def test_pettingzoos_checkers_pass_for_every_task(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(parallel_env(name, horizon=30), num_cycles=80)
        parallel_seed_test(lambda: parallel_env(name, horizon=30), num_cycles=30)


@pytest.mark.parametrize("name", TEAMS)
def test_agents_see_and_do_what_the_batch_does(name, rng):
    env, batch = parallel_env(name), omnidrones.make(name, 1, autoreset="disabled")
    seen, _ = env.reset(seed=4)
    rows = batch.reset(4)[0]
    for _ in range(10):
        assert all(np.array_equal(seen[agent], rows[k]) for k, agent in enumerate(env.possible_agents))
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        seen, reward, *_ = env.step(actions)
        step = batch.step(np.stack([[actions[agent] for agent in env.possible_agents]]))
        rows = step.observation[0]
        assert list(reward.values()) == step.reward[0].tolist()
        assert np.array_equal(env.state(), batch.central[0])


def test_what_one_agent_is_told_is_not_what_another_is_told():
    env = parallel_env("Formation")
    env.reset(seed=0)
    *_, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    first, *others = env.possible_agents
    told = dict(infos[first])
    infos[first]["mine"] = 1
    assert all(infos[other] == told for other in others)


def test_an_action_of_an_episode_before_is_not_repeated():
    for level in (0.7, -0.9):
        used, fresh = parallel_env("Formation"), parallel_env("Formation")
        used.reset(seed=1)
        used.step({agent: np.full(used.action_space(agent).shape, level, np.float32) for agent in used.agents})
        rows = []
        for env in (used, fresh):
            env.reset(seed=2)
            rows.append(env.step({})[0])
        assert all(np.array_equal(rows[0][agent], rows[1][agent]) for agent in used.possible_agents)


def test_an_episode_that_is_over_takes_no_step():
    env = parallel_env("Formation", horizon=2)
    env.reset(seed=0)
    for _ in range(2):
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert env.agents == []
    with pytest.raises(RuntimeError, match="reset"):
        env.step({})


class Pair(Climb):
    """Two that climb."""

    def robot(self):
        return omnidrones.Robot.team(self.vehicle, 2)

    def start(self, start):
        for tree, y in enumerate((-1.0, 1.0)):
            start.place(np.stack([0.0, y, start.reset.uniform(1.0, 1.5)]), tree=tree)

    def ideal(self, start):
        for tree, y in enumerate((-1.0, 1.0)):
            start.place([0.0, y, self.height], tree=tree)

    def observe(self, view, agent, out):
        out.field("left", "m, world", "to climb", self.height - view.drone(agent).position[2])
        out.observe_drone(view, agent)


def test_a_class_of_ones_own_is_a_team():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(parallel_env(Pair, horizon=30), num_cycles=80)
    named, own = parallel_env("Pair"), parallel_env(Pair)
    assert own.possible_agents == ["drone_0", "drone_1"]
    seen, again = named.reset(seed=2)[0], own.reset(seed=2)[0]
    assert all(np.array_equal(seen[agent], again[agent]) for agent in own.possible_agents)
    assert not np.array_equal(seen["drone_0"], seen["drone_1"])
