"""Gradients: sweeps in float32 beside exact Jacobians, and these beside central differences, with NumPy alone."""

import numpy as np
import pytest
from conftest import near_hover

import omnidrones

TASKS = ["Hover", "PayloadTrack", "OverHover", "Formation"]


def chain(env, actions, arguments):
    """Arguments of every step of a rollout in float64 under these actions, from these arguments; and its mean loss."""
    at = env.jacobian(0, actions[0].tolist()).layout
    carried, every, total = arguments[at["carried"]], [], 0.0
    for t, action in enumerate(actions):
        z = arguments.copy()
        z[at["carried"]], z[at["action"]] = carried, action
        z[at["time"].start] += t
        y = env.evaluate(z.tolist())
        carried, total = y[at["carried"]], total + y[at["loss"]][0] + 0.3 * y[at["reward"]][0]
        every.append(z)
    return every, total


@pytest.mark.parametrize("name", ["Hover", "PayloadTrack"])
def test_jacobians_chained_through_twenty_steps_agree_with_differences(name, rng):
    env = omnidrones.make(name, 1, threads=1)
    env.reset(3)
    actions = near_hover(rng, env).reshape(1, -1).astype(float) + rng.uniform(-0.05, 0.05, (20, env.spec.n_agent * env.spec.n_action))
    first = env.jacobian(0, actions[0].tolist())
    at, arguments = first.layout, first.arguments
    every, _ = chain(env, actions, arguments)
    gradient, up = np.zeros_like(actions), np.zeros(at["carried"].stop)
    for t in reversed(range(20)):
        j = env.jacobian_at(every[t].tolist()).matrix
        down = up @ j[at["carried"]] + j[at["loss"]][0] + 0.3 * j[at["reward"]][0]
        gradient[t], up = down[at["action"]], down[at["carried"]]
    h, worst = 1e-6, 0.0
    for t in (0, 7, 19):
        for k in range(actions.shape[1]):
            moved = [actions.copy() for _ in range(2)]
            moved[0][t, k] += h
            moved[1][t, k] -= h
            up, down = (chain(env, own, arguments)[1] for own in moved)
            worst = max(worst, abs((up - down) / (2 * h) - gradient[t, k]) / (1.0 + abs(gradient[t, k])))
    assert worst < 1e-6, worst


@pytest.mark.parametrize("name", TASKS)
def test_a_sweep_agrees_with_the_jacobian(name, rng):
    env = omnidrones.make(name, 3, threads=1)
    env.reset(1)
    tape, sweep = env.tape(4), env.adjoint().sweep()
    for _ in range(2):
        env.step_recorded(near_hover(rng, env), tape)
    actions = near_hover(rng, env)
    exact = [env.jacobian(i, actions[i].reshape(-1).astype(float).tolist()) for i in range(3)]
    env.step_recorded(actions, tape)
    assert len(tape) == 3 and tape.horizon == 4 and tape.bytes > 0
    ones = np.ones(3, np.float32)
    for what in ("reward", "loss"):
        sweep.restart()
        got = sweep.pull(tape, 2, **{what: ones})
        wanted = np.array([j.matrix[j.layout[what], j.layout["action"]][0] for j in exact])
        assert np.abs(got - wanted).max() < 2e-6 * max(1.0, np.abs(wanted).max())
    assert sweep.dropped == 0
    assert sweep.carried().shape == (3, env.adjoint().n_carried)
    sweep.pull(tape, 1)
    with pytest.raises(ValueError, match="step of the sweep"):
        sweep.pull(tape, 1)
    sweep.add_carried(np.zeros_like(sweep.carried()))


def test_a_sweep_through_a_window_agrees_with_differences(rng):
    n_env, n_step = 4, 10
    env = omnidrones.make("Hover", n_env, seed=1, threads=1)
    env.reset()
    start, tape, sweep = env.save(), env.tape(n_step), env.adjoint().sweep()
    actions = [near_hover(rng, env) for _ in range(n_step)]

    def total(record=False):
        env.load(start)
        tape.clear()
        return sum(float(env.step_recorded(a, tape).reward.astype(float).sum()) for a in actions)

    total()
    gradients = [None] * n_step
    for t in reversed(range(n_step)):
        gradients[t] = sweep.pull(tape, t, reward=np.ones(n_env, np.float32))
    worst, h = 0.0, 3e-3
    for t in (0, 4, 9):
        for i in (0, 3):
            kept = actions[t][i, 0, 1]
            values = []
            for side in (h, -h):
                actions[t][i, 0, 1] = kept + side
                values.append(total())
            actions[t][i, 0, 1] = kept
            difference = (values[0] - values[1]) / (2 * h)
            worst = max(worst, abs(difference - gradients[t][i, 1]) / (abs(gradients[t][i, 1]) + 1e-2))
    assert worst < 2e-2, worst


def test_gradients_by_physical_numbers_come_with_the_adjoint_that_asks_for_them(rng):
    env = omnidrones.make("HoverRand", 2, threads=1)
    env.reset(0)
    tape, sweep = env.tape(1), env.adjoint(parameters=True).sweep()
    env.step_recorded(near_hover(rng, env), tape)
    sweep.pull(tape, 0, loss=np.ones(2, np.float32))
    assert sweep.parameters().shape == (2, env.spec.n_privileged) and np.abs(sweep.parameters()).max() > 0


def test_a_tape_that_is_full_or_of_another_environment_is_refused(hover, rng):
    tape = hover.tape(1)
    hover.step_recorded(near_hover(rng, hover), tape)
    with pytest.raises(ValueError, match="steps of the tape"):
        hover.step_recorded(near_hover(rng, hover), tape)
    other = omnidrones.make("Hover", 8, dt=0.01)
    other.reset(0)
    with pytest.raises(ValueError, match="another environment"):
        other.step_recorded(near_hover(rng, other), tape)
    with pytest.raises(ValueError, match="continuous"):
        omnidrones.make("Hover", 1, actions={"kind": "discrete", "levels": 2}).adjoint()
