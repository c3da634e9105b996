"""What tests share."""

import numpy as np
import pytest

import omnidrones


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def near_hover(rng, env, spread=0.2):
    """Actions about those that carry a Hummingbird."""
    shape = (env.num_envs, env.spec.n_agent, env.spec.n_action)
    return (rng.uniform(-1, 1, shape) * spread - 0.41).astype(np.float32)


def flown(env, n_step, draw=0):
    """What so many steps of random actions tell, copied."""
    return [[x.copy() for x in env.step(env.sample(draw + t))] for t in range(n_step)]


def same(a, b):
    """Bit for bit."""
    return all(x.tobytes() == y.tobytes() for p, q in zip(a, b, strict=True) for x, y in zip(p, q, strict=True))


@pytest.fixture
def hover():
    env = omnidrones.make("Hover", 8, seed=0, threads=1)
    env.reset()
    return env


class Climb(omnidrones.Task):
    """Climb to a height: a task of one's own, for what takes tasks."""

    horizon = 60
    height = omnidrones.Setting(2.0, "m, world", "to climb to", domain="positive")
    success_rule = omnidrones.Success().below("left", 0.1)

    def left(self, view):
        return self.height - view.drone().position[2]

    def start(self, start):
        start.place(start.position([[-1.0, 1.0], [-1.0, 1.0], [1.0, 1.5]]))

    def ideal(self, start):
        start.place([0.0, 0.0, self.height])

    def observe(self, view, agent, out):
        out.field("left", "m, world", "to climb", self.left(view))
        out.observe_drone(view)

    def reward(self, view, terms):
        terms.term("near", "1/(1 + left^2)", 1.0, 1.0 / (1.0 + self.left(view) ** 2))

    def ends(self, view, ends):
        ends.when("crash", "z < 0.2 m", view.drone().position[2] < 0.2)

    def metrics(self, view, out):
        out.metric("left", "m", abs(self.left(view)))
