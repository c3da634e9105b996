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
