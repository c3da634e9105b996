"""PyTorch: gradcheck in float64, a window in float32 beside the sweep, APG that learns to hover."""

import numpy as np
import pytest
from conftest import near_hover

import omnidrones

torch = pytest.importorskip("torch")


@pytest.mark.parametrize("name", ["Hover", "PayloadTrack"])
def test_gradcheck_through_twenty_exact_steps(name, rng):
    env = omnidrones.make(name, 1, threads=1)
    env.reset(3)
    n = env.spec.n_agent * env.spec.n_action
    base = near_hover(rng, env).reshape(-1).astype(float)
    start = env.jacobian(0, base.tolist())
    actions = torch.tensor(base + rng.uniform(-0.05, 0.05, (20, n)), requires_grad=True)

    def total(actions):
        carried, cost, z = torch.tensor(start.arguments[env.layout["carried"]]), 0.0, start.arguments.copy()
        for action in actions:
            step = omnidrones.torch.exact_step(env, z, carried, action)
            carried, cost = step.carried, cost + step.loss + 0.3 * step.reward + 0.01 * step.observation.square().sum()
            z[env.layout["time"].start] += 1
        return cost

    assert torch.autograd.gradcheck(total, (actions,), eps=1e-6, atol=1e-6, rtol=1e-5)


def test_autograd_through_a_window_is_the_sweep(rng):
    env = omnidrones.make("Hover", 4, seed=1, threads=1)
    env.reset()
    saved, n_step = env.save(), 6
    actions = [near_hover(rng, env) for _ in range(n_step)]
    rollout = omnidrones.torch.Rollout(env, n_step)
    tensors = [torch.from_numpy(a.copy()).requires_grad_() for a in actions]
    cost = sum(rollout.step(a).reward.sum() for a in tensors)
    cost.backward()
    env.load(saved)
    tape, sweep = env.tape(n_step), env.adjoint().sweep()
    for a in actions:
        env.step_recorded(a, tape)
    for t in reversed(range(n_step)):
        wanted = sweep.pull(tape, t, reward=np.ones(4, np.float32))
        assert np.array_equal(tensors[t].grad.numpy().reshape(4, -1), wanted)


def test_a_window_whose_last_steps_nobody_asks_about_and_tensors_as_actions(rng):
    env = omnidrones.make("Hover", 4, seed=1)
    env.reset()
    rollout = omnidrones.torch.Rollout(env, 3)
    actions = [torch.from_numpy(near_hover(rng, env)).requires_grad_() for _ in range(3)]
    losses = [rollout.step(a).loss for a in actions]
    losses[1].sum().backward()
    assert actions[0].grad is not None and actions[1].grad is not None and actions[2].grad is None
    env.step(torch.zeros(4, 1, 4))
    with pytest.raises((ValueError, TypeError, BufferError, RuntimeError)):
        env.step(torch.zeros(4, 1, 4, requires_grad=True))
