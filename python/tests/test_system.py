"""Loops and allocations as systems, with NumPy alone: what flies, and what its adjoint says beside differences."""

import pickle

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


def pendulum(x, u, theta):
    return [x[1], (u[0] - theta["damping"] * x[1]) / theta["mass"] - theta["gravity"][2] * np.sin(x[0])]


PENDULUM = {
    "states": ["angle [rad]", "rate [rad/s]"],
    "inputs": ["torque [N m]"],
    "parameters": {"mass": 1.2, "damping": 0.1, "gravity": [0.0, 0.0, 9.81]},
    "dt": 0.01,
    "continuous": True,
}


def by_hand(x, u, theta, dt):
    rate = lambda x: np.array(pendulum(x, u, theta))  # noqa: E731
    a = rate(x)
    b = rate(x + dt / 2 * a)
    c = rate(x + dt / 2 * b)
    return x + dt / 6 * (a + 2 * b + 2 * c + rate(x + dt * c))


def test_a_function_of_python_becomes_a_system_that_is_integrated(rng):
    system = omnidrones.System.of(pendulum, **PENDULUM)
    theta, x, inputs = PENDULUM["parameters"], np.array([0.3, -0.2]), rng.normal(size=(50, 1))
    states = [x]
    for u in inputs:
        states.append(by_hand(states[-1], u, theta, 0.01))
    np.testing.assert_allclose(system.trajectory(x, inputs), states, rtol=1e-13, atol=1e-13)
    assert (system.n_state, system.n_input, system.n_parameter, system.dt) == (2, 1, 5, 0.01)
    assert system.parameter_names == ["mass", "damping", "gravity[0]", "gravity[1]", "gravity[2]"]
    assert system.parameters.tolist() == [1.2, 0.1, 0.0, 0.0, 9.81]
    assert system.state_names == PENDULUM["states"] and system.input_names == PENDULUM["inputs"]
    assert repr(system) == "System(2 states, 1 inputs, 5 parameters)"
    halves = omnidrones.System.of(pendulum, **PENDULUM, substeps=2)
    twice = omnidrones.System.of(pendulum, **(PENDULUM | {"dt": 0.005}))
    np.testing.assert_allclose(halves.trajectory(x, inputs)[1], twice.trajectory(x, inputs[[0, 0]])[2], rtol=1e-14, atol=1e-14)


def test_a_step_in_python_is_taken_as_it_is(rng):
    def step(x, u, theta):
        assert x.shape == (3,) and u.shape == (2,) and theta.shape == (4,)
        return np.where(x > 0, x * theta[0], x) + np.array([1.0, 0.5, 0.0]) * u[0] * u[1] + np.linalg.norm(theta[1:])

    system = omnidrones.System.of(step, states=3, inputs=2, parameters=np.arange(4.0))
    x, u = rng.normal(size=3), rng.normal(size=(1, 2))
    wanted = np.where(x > 0, 0.0, x) + np.array([1.0, 0.5, 0.0]) * u[0, 0] * u[0, 1] + np.sqrt(14.0)
    np.testing.assert_allclose(system.trajectory(x, u)[1], wanted, rtol=1e-14)
    assert system.parameter_names == ["p1", "p2", "p3", "p4"] and system.state_names == ["x1", "x2", "x3"] and system.dt is None
    free = omnidrones.System.of(lambda x, u: x + len(u), states=1)
    assert free.n_input == 0 and free.trajectory(np.zeros(1), np.zeros((3, 0)))[:, 0].tolist() == [0, 0, 0, 0]


def test_cotangents_and_jacobians_of_a_function_of_python_agree_with_differences(rng):
    system = omnidrones.System.of(pendulum, **PENDULUM)
    state, inputs, theta = np.array([0.3, -0.2]), rng.normal(size=(30, 1)), system.parameters
    up = rng.normal(size=(31, 2))
    down = system.pull(up, state, inputs, theta)
    for argument, direction in enumerate([rng.normal(size=2), rng.normal(size=(30, 1)), rng.normal(size=5)]):
        wanted = difference(system, state, inputs, theta, up, argument, direction)
        assert (down[argument] * direction).sum() == pytest.approx(wanted, rel=1e-6)
    blocks = system.jacobians(state, inputs[0])
    assert [block.shape for block in blocks] == [(2, 2), (2, 1), (2, 5)]
    for k in range(2):
        one = np.zeros((2, 2))
        one[1, k] = 1.0
        rows = system.pull(one, state, inputs[:1], theta)
        for block, row in zip(blocks, rows, strict=True):
            np.testing.assert_allclose(block[k], np.ravel(row), rtol=1e-12, atol=1e-15)


def test_certificates_hold_where_a_function_is_smooth_and_tell_of_kinks():
    system = omnidrones.System.of(pendulum, **PENDULUM)
    certificate = system.certificate(np.array([0.3, -0.2]), np.ones(1))
    assert certificate.holds and certificate.n_entry == 16 and "duals against central difference" in str(certificate)
    assert certificate.adjoint_error <= 1e-10 and certificate.taylor_order == pytest.approx(2, abs=0.1) and certificate.value_error <= 1e-12
    kink = omnidrones.System.of(lambda x, u: np.abs(x), states=1).certificate(np.zeros(1), np.zeros(0))
    assert kink.kinks == 1 and not kink.holds
    loop = omnidrones.Loop("hummingbird")
    state, inputs = loop.trajectory(loop.initial_state(), loop.inputs(20))[-1], loop.inputs(1, first=20)
    a, b, by_gain = loop.jacobians(state, inputs[0])
    assert a.shape == (loop.n_state,) * 2 and b.shape == (loop.n_state, loop.n_input) and by_gain.shape == (loop.n_state, loop.n_parameter)


def test_linear_models_have_names_and_are_those_of_the_point():
    system = omnidrones.System.of(pendulum, **PENDULUM)
    hanging = np.zeros(2), np.zeros(1)
    model, rate = system.linear_model(*hanging), system.linear_model(*hanging, continuous=True)
    assert model.states == model.outputs == PENDULUM["states"] and model.inputs == PENDULUM["inputs"] and model.dt == 0.01
    np.testing.assert_allclose(rate.A, [[0, 1], [-9.81, -0.1 / 1.2]], rtol=1e-14)
    np.testing.assert_allclose(rate.B, [[0], [1 / 1.2]], rtol=1e-14)
    assert rate.dt is None and np.array_equal(model.A, system.jacobians(*hanging)[0]) and np.array_equal(model.C, np.eye(2))
    step = 0.01 * rate.A
    np.testing.assert_allclose(model.A, np.eye(2) + step + step @ step / 2 + step @ step @ step / 6, atol=1e-7)
    light = system.linear_model(*hanging, np.array([0.6, 0.1, 0, 0, 9.81]), continuous=True)
    np.testing.assert_allclose(light.B, [[0], [1 / 0.6]], rtol=1e-14)


def test_what_makes_no_system_is_refused_with_the_remedy():
    of = omnidrones.System.of
    good = {"states": 2, "inputs": 1}
    for wrong, error, words in [
        ({"states": 0}, ValueError, "Give a state"),
        ({"states": 10**12}, ValueError, "states"),
        ({"states": -1}, (TypeError, OverflowError), "states"),
        ({"states": "ab"}, TypeError, "states"),
        ({"states": 2.5}, TypeError, "states"),
        ({"states": ["a", "a"]}, ValueError, "names that differ"),
        (good | {"dt": 0.0}, ValueError, "dt"),
        (good | {"dt": np.nan}, ValueError, "dt"),
        (good | {"continuous": True}, ValueError, "dt=0.01"),
        (good | {"substeps": 2}, ValueError, "substeps"),
        (good | {"continuous": True, "dt": 1.0, "substeps": 0}, ValueError, "substeps"),
        (good | {"continuous": True, "dt": 1.0, "substeps": 10**9}, ValueError, "substeps"),
        (good | {"parameters": {"a": np.nan}}, ValueError, "parameters"),
        (good | {"parameters": {"a": "b"}}, ValueError, "parameters: a"),
        (good | {"parameters": {1: 2.0}}, TypeError, "names"),
        (good | {"parameters": np.broadcast_to(1.0, 10**9)}, ValueError, "parameters"),
        (good | {"parameters": 3}, TypeError, "dict"),
    ]:
        with pytest.raises(error, match=words):
            of(lambda x, u, *theta: x, **wrong)
    with pytest.raises(TypeError):
        of(None, states=1)
    with pytest.raises(TypeError, match="positional argument"):
        of(lambda x: x, states=1)
    system = of(lambda x, u: x * u, **good)
    for call, words in [
        (lambda: system.linear_model(np.ones(2), np.ones(1)), "dt"),
        (lambda: system.linear_model(np.ones(2), np.ones(1), continuous=True), "continuous"),
        (lambda: system.jacobians(np.ones(3), np.ones(1)), "state has the shape"),
        (lambda: system.jacobians(np.ones(2), np.full(1, np.nan)), "point"),
        (lambda: system.certificate(np.ones(2), np.full(1, np.inf)), "point"),
        (lambda: of(lambda x, u: x, states=1, dt=1.0).linear_model(np.ones(1), np.ones(0)), "inputs"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()


def test_a_linear_quadratic_problem_has_the_gains_of_its_riccati_recursion(rng):
    a, b, q, r = np.eye(3) + 0.1 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), np.diag([1.0, 2.0, 0.5]), np.diag([0.5, 1.0])
    system = omnidrones.System.of(lambda x, u: a @ x + b @ u, states=3, inputs=2, dt=0.1)
    half = lambda x, weight: 0.5 * x @ (weight @ x)  # noqa: E731
    start = rng.normal(size=3)
    found = system.optimise(lambda x, u: half(x, q) + half(u, r), lambda x: half(x, 3 * q), start=start, stages=12)
    p, gains = 3 * q, []
    for _ in range(12):
        gains.insert(0, -np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a))
        p = q + a.T @ p @ (a + b @ gains[0])
    assert found.solved and found.status == "solved" and repr(found).startswith("OptimalTrajectory(12 stages")
    np.testing.assert_allclose(found.gains, gains, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.cost, 0.5 * start @ p @ start, rtol=1e-9)
    np.testing.assert_allclose(system.trajectory(start, np.ascontiguousarray(found.inputs)), found.states, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.times, np.arange(13) * 0.1)


def test_a_pendulum_swings_up_within_bounds_and_follows_references():
    how = PENDULUM | {"dt": 0.05}
    system = omnidrones.System.of(pendulum, **how)
    told = []
    found = system.optimise(
        lambda x, u, theta: 1e-2 * u[0] ** 2 + 0.0 * theta["mass"],
        lambda x, theta: 200.0 * (1.0 + np.cos(x[0])) + 10.0 * x[1] ** 2,
        start=np.zeros(2), stages=60, lower=np.array([-6.0]), upper=np.array([6.0]), guess=np.full((60, 1), 0.5),
        progress=lambda *now: told.append(now), iterations=300,
    )  # fmt: skip
    assert abs(abs(found.states[-1, 0]) - np.pi) < 0.1 and np.abs(found.inputs).max() <= 6.0 and len(told) > 1
    assert found.state_names == PENDULUM["states"] and found.input_names == PENDULUM["inputs"]

    integrator = omnidrones.System.of(lambda x, u: x + 0.1 * u, states=1, inputs=1)
    aims = np.concatenate([np.linspace(0.0, 1.0, 11)[:, None], np.full((11, 1), 0.05)], 1)
    aims[0, 0] = 0.0
    track = lambda x, u, r: 100.0 * (x[0] - r[0]) ** 2 + 1e-3 * u[0] ** 2  # noqa: E731
    last = lambda x, r: 100.0 * (x[0] - r[0]) ** 2  # noqa: E731
    free = integrator.optimise(track, last, start=np.zeros(1), stages=10, references=aims)
    assert np.abs(free.states[:, 0] - aims[:, 0]).max() < 0.02 and free.times[-1] == 10
    held = integrator.optimise(track, last, start=np.zeros(1), stages=10, references=aims, conditions=lambda x, u, r: [u[0] - 0.8, -u[0] - 0.8])
    assert held.solved and held.inputs.max() <= 0.8 + 1e-5 < free.inputs.max() and held.violation < 1e-5


def test_attitudes_are_optimised_along_rotations():
    turn = omnidrones.functions

    def step(q, u):
        return turn.multiply_quaternions(q, turn.from_rotation_vector(0.1 * u))

    system = omnidrones.System.of(step, states=["w", "x", "y", "z"], inputs=3)
    aim = turn.from_euler(0.2, -0.3, 1.0)
    off = lambda q: turn.squared_norm(turn.multiply_quaternions(turn.conjugate(aim), q)[1:])  # noqa: E731
    found = system.optimise(
        lambda q, u: 1e-3 * (u @ u), lambda q: 100.0 * off(q), start=np.array([1.0, 0, 0, 0]), stages=10, quaternions=[0]
    )
    assert found.solved and abs(found.states[-1] @ aim) > 1 - 1e-4 and found.gains.shape == (10, 3, 3)
    assert found.error_names == ["rotation_x [rad]", "rotation_y [rad]", "rotation_z [rad]"]
    np.testing.assert_allclose(found.inputs, np.tile(found.inputs[0], (10, 1)), rtol=1e-4, atol=1e-6)


def test_what_is_no_problem_is_refused_with_the_remedy():
    system = omnidrones.System.of(lambda x, u: x + u[0], states=2, inputs=1)
    good = {"start": np.zeros(2), "stages": 3}
    cost = lambda x, u: x @ x + u @ u  # noqa: E731
    for wrong, error, words in [
        ({"start": np.zeros(3)}, ValueError, "start has the shape"),
        ({"stages": 0}, ValueError, "stages"),
        ({"stages": 10**12}, ValueError, "numbers of all stages"),
        ({"lower": np.ones(1), "upper": np.zeros(1)}, ValueError, "bound"),
        ({"lower": np.ones(2)}, ValueError, "lower has the shape"),
        ({"references": np.ones((3, 1))}, ValueError, "references has the shape"),
        ({"references": np.ones(3)}, ValueError, "references"),
        ({"guess": np.ones((2, 1))}, ValueError, "guess has the shape"),
        ({"guess": np.full((3, 1), np.nan)}, ValueError, "inputs"),
        ({"quaternions": [0]}, ValueError, "quaternions"),
        ({"conditions": lambda x, u: None}, TypeError, "'conditions' returns is None"),
        ({"conditions": lambda x: x}, TypeError, "positional argument"),
    ]:
        with pytest.raises(error, match=words):
            system.optimise(cost, **(good | wrong))
    for wrong, words in [(lambda x, u: x, "single number"), (lambda x, u: x[0] < 1 and 1, "np.where|& and"), (lambda x, u: np.nan, "NaN")]:
        with pytest.raises(omnidrones.RecordingError, match=words):
            system.optimise(wrong, **good)
    with pytest.raises(ValueError, match="inputs"):
        omnidrones.System.of(lambda x, u: x, states=2).optimise(lambda x: x @ x, **good)
    with pytest.raises(ValueError, match="made by System.of"):
        omnidrones.Loop("hummingbird").optimise(cost, **good)

    class Own(Exception):
        pass

    def stop(*_):
        raise Own

    with pytest.raises(Own):
        system.optimise(cost, **(good | {"start": np.ones(2)}), progress=stop)


def test_a_system_of_a_function_is_pickled_by_value():
    def f(x, u, theta):
        return [x[0] + 0.1 * x[1], x[1] + 0.1 * (u[0] - theta["k"] * np.sin(x[0]))]

    system = omnidrones.System.of(f, states=["a", "b"], inputs=1, parameters={"k": 2.0}, dt=0.1)
    again = pickle.loads(pickle.dumps(system))
    state, inputs = np.array([0.3, -0.2]), np.ones((20, 1))
    assert np.array_equal(system.trajectory(state, inputs), again.trajectory(state, inputs))
    assert again.state_names == ["a", "b"] and again.parameter_names == system.parameter_names and again.dt == 0.1
    with pytest.raises(TypeError, match="make it anew"):
        pickle.dumps(omnidrones.Loop("hummingbird"))
