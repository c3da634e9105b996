"""PyTorch: gradcheck in float64, a window in float32 beside the sweep, APG that learns to hover."""

import subprocess
import sys
from pathlib import Path

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


def test_gradcheck_through_a_closed_loop_by_start_reference_gains_and_physics():
    loop = omnidrones.Loop("hummingbird", latency=2)
    state, theta = (torch.tensor(x) for x in (loop.initial_state(), loop.parameters))
    inputs = torch.tensor(loop.inputs(60))
    place = loop.parameter_names.index
    asked = [place(name) for name in ("mass", "inertia_xx", "rotor_0.thrust_coefficient", "gains.position_x", "gains.rate_z")]
    scale = theta[asked].abs()

    def states(start, target, shares):
        moved = torch.cat([state[:6] + start, state[6:]])
        aim = torch.cat([inputs[:, :3] + target, inputs[:, 3:]], 1)
        own = theta.clone().scatter(0, torch.tensor(asked), scale * shares)
        return omnidrones.torch.trajectory(loop, moved, aim, own)[::20, :10]

    start = torch.tensor([0.01, -0.02, 0.03, 0.1, 0.0, -0.1], dtype=torch.float64, requires_grad=True)
    target = torch.full((60, 3), 0.02, dtype=torch.float64, requires_grad=True)
    shares = torch.tensor([1.1, 1.05, 0.95, 0.9, 1.2], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(states, (start, target, shares), eps=1e-6, atol=1e-6, rtol=1e-4)


def test_gradcheck_through_a_function_of_python():
    def pendulum(x, u, theta):
        return [x[1], (u[0] - theta["damping"] * x[1]) / theta["mass"] - 9.81 * np.sin(x[0])]

    how = {"states": 2, "inputs": 1, "parameters": {"mass": 1.2, "damping": 0.1}, "dt": 0.01, "continuous": True}
    system = omnidrones.System.of(pendulum, **how)
    state = torch.tensor([0.3, -0.2], dtype=torch.float64, requires_grad=True)
    inputs = torch.full((20, 1), 0.1, dtype=torch.float64, requires_grad=True)
    theta = torch.tensor(system.parameters, requires_grad=True)
    states = lambda *own: omnidrones.torch.trajectory(system, *own)  # noqa: E731
    assert torch.autograd.gradcheck(states, (state, inputs, theta), eps=1e-6, atol=1e-7, rtol=1e-5)


def test_gradcheck_through_allocations_by_their_wrenches_and_numbers(rng):
    function = omnidrones.AllocationFunction("firefly")
    weight = 9.81 * omnidrones.Vehicle("firefly").mass
    wrenches = torch.tensor(np.array([0, 0, weight, 0, 0, 0]) + rng.uniform(-1, 1, (5, 6)) * [0, 0, 3, 0.2, 0.2, 0.05])
    wrenches[4, 2] = 10 * weight  # more than there is
    upper = torch.tensor(function.numbers["upper"] * rng.uniform(0.7, 1.0, 6), requires_grad=True)
    geometry = torch.tensor(function.numbers["geometry"], requires_grad=True)

    def thrusts(wrench, upper, geometry):
        return omnidrones.torch.allocate(function, wrench, upper=upper, geometry=geometry)

    given = wrenches.clone().requires_grad_(), upper, geometry
    # the little that is asked of their size, 2e-6, leaves differences of smaller steps to rounding
    assert torch.autograd.gradcheck(thrusts, given, eps=5e-5, atol=2e-5, rtol=1e-4)
    full = thrusts(*given)[4]
    assert torch.equal(full, upper), "every rotor at its limit"
    with pytest.raises(ValueError, match="uper"):
        omnidrones.torch.allocate(function, wrenches, uper=upper)


def test_gains_learn_to_track_by_gradients_through_the_loop():
    loop = omnidrones.Loop("hummingbird")
    state, inputs, nominal = (torch.tensor(x) for x in (loop.initial_state(), loop.inputs(1000), loop.parameters))
    gains = torch.tensor([n.startswith(("gains.position", "gains.velocity")) for n in loop.parameter_names])
    factor = torch.zeros(len(nominal), dtype=torch.float64, requires_grad=True)
    optimiser, errors = torch.optim.Adam([factor], 0.1), []
    for _ in range(8):
        theta = nominal * torch.where(gains, factor, 0.0).exp()
        states = omnidrones.torch.trajectory(loop, state, inputs, theta)
        error = (states[1:, :3] - inputs[:, :3]).square().sum(1).mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        errors.append(error.item())
    assert errors[-1] < 0.8 * errors[0], errors


def test_apg_written_in_pytorch_hovers():
    example = Path(__file__).parent.parent / "examples" / "apg_torch.py"
    ran = subprocess.run([sys.executable, str(example)], capture_output=True, text=True, check=True)
    success = float(ran.stdout.split()[-1])
    assert success >= 0.99, ran.stdout  # measured: 1.000, with seed 1 0.998
