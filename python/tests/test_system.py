"""Loops and allocations as systems, with NumPy alone: what flies, and what its adjoint says beside differences."""

import numpy as np
import pytest

import omnidrones


def test_a_loop_flies_what_fly_flies():
    loop = omnidrones.Loop("hummingbird", latency=1)
    states = loop.trajectory(loop.initial_state(), loop.inputs(500))
    flown = omnidrones.fly("hummingbird", duration=1.0, latency=1).states()
    assert states.shape == (501, loop.n_state) and np.array_equal(states[: len(flown), : flown.shape[1]], flown[:501])
    assert len(loop.parameter_names) == loop.n_parameter == len(loop.parameters) and "mass" in loop.parameter_names
    assert repr(loop) == "Loop('hummingbird', controller='cascade')"


def difference(loop, state, inputs, theta, up, argument, direction, h=1e-6):
    """Of the sum of the states by their cotangents, along a direction of one argument."""
    values = []
    for step in (h, -h):
        own = [state, inputs, theta]
        own[argument] = own[argument] + step * direction
        values.append((loop.trajectory(*own) * up).sum())
    return (values[0] - values[1]) / (2 * h)


@pytest.mark.parametrize("plant, how", [("hummingbird", {}), ("firefly", {"controller": "lqi"}), ("iris", {"controller": "indi"}), ("platform_2", {"controller": "formation"})])
def test_cotangents_of_a_loop_agree_with_differences(plant, how, rng):
    loop = omnidrones.Loop(plant, **how)
    state, inputs, theta = loop.initial_state(), loop.inputs(30), loop.parameters
    up = rng.normal(size=(31, loop.n_state))
    down = loop.pull(up, state, inputs, theta)
    assert [d.shape for d in down] == [state.shape, inputs.shape, theta.shape]
    n = min(6, loop.n_state)
    moved = [np.zeros_like(state), np.zeros_like(inputs), theta * rng.uniform(-0.1, 0.1, theta.shape)]
    moved[0][:n], moved[1][:, :3] = rng.normal(size=n), rng.normal(size=(30, 3))
    for argument, direction in enumerate(moved):
        wanted = difference(loop, state, inputs, theta, up, argument, direction)
        assert (down[argument] * direction).sum() == pytest.approx(wanted, rel=2e-5, abs=1e-6)


def test_an_allocation_function_answers_as_allocate_does(rng):
    function = omnidrones.AllocationFunction("firefly")
    rest = np.concatenate([own.reshape(-1) for own in function.numbers.values()])
    wrenches = rng.uniform(-1, 1, (4, 6)) * [0, 0, 3, 0.2, 0.2, 0.05] + [0, 0, 15, 0, 0, 0]
    thrusts = function.trajectory(np.zeros(6), np.array([np.concatenate([w, rest]) for w in wrenches]))[1:]
    for wrench, thrust in zip(wrenches, thrusts, strict=True):
        assert np.abs(thrust - omnidrones.allocate("firefly", wrench.tolist()).thrust).max() < 1e-9


def test_what_does_not_fit_a_system_is_refused_with_the_remedy():
    loop = omnidrones.Loop("hummingbird")
    state, inputs = loop.initial_state(), loop.inputs(3)
    for wrong, error, words in [
        ((state[1:], inputs), ValueError, "state has the shape"),
        ((state, inputs[:, 1:]), ValueError, "inputs has the shape"),
        ((state.astype(np.float32), inputs), TypeError, "float64"),
        ((state, inputs, np.zeros(2)), ValueError, "parameters has the shape"),
    ]:
        with pytest.raises(error, match=words):
            loop.trajectory(*wrong)
    with pytest.raises(ValueError, match="cotangents has the shape"):
        loop.pull(np.zeros((3, loop.n_state)), state, inputs)
    with pytest.raises(ValueError, match="law over any scalar"):
        omnidrones.Loop("payload")
    for how, words in [({"controller": "mpc"}, "lqi"), ({"latency": 10**6}, "latency"), ({"dtt": 1.0}, "dtt")]:
        with pytest.raises(ValueError, match=words):
            omnidrones.Loop("hummingbird", **how)
    for call, words in [(lambda: loop.inputs(10**12), "n_step"), (lambda: loop.inputs(3, wind=[1.0, 0.0, 0.0]), "disturbance")]:
        with pytest.raises(ValueError, match=words):
            call()
    assert loop.inputs(0).shape[0] == 0 and loop.trajectory(state, inputs[:0]).shape == (1, loop.n_state)


@pytest.mark.parametrize("reference", [{"kind": "hover", "yaw": np.nan}, {"kind": "circle", "radius": np.nan}])
def test_references_that_fly_refuses_are_refused(reference):
    loop = omnidrones.Loop("hummingbird")
    for refused in (loop.initial_state, lambda given: loop.inputs(2, given)):
        with pytest.raises(ValueError, match="NaN"):
            refused(reference)
    with pytest.raises(ValueError, match="wind"):
        loop.inputs(2, wind=[1.0, 0.0, np.nan])


def test_inputs_of_parts_are_those_of_the_whole():
    loop = omnidrones.Loop("hummingbird")
    assert np.array_equal(np.vstack([loop.inputs(30), loop.inputs(20, first=30)]), loop.inputs(50))


def test_a_trajectory_has_the_bits_of_its_parts(rng):
    loop = omnidrones.Loop("hummingbird")
    state, inputs = loop.initial_state(), loop.inputs(700)
    whole = loop.trajectory(state, inputs)
    for cut in rng.integers(1, 700, 3):
        parts = [loop.trajectory(state, inputs[:cut])]
        parts.append(loop.trajectory(parts[0][-1], inputs[cut:])[1:])
        assert np.array_equal(np.vstack(parts), whole)
