"""Trajectories of least cost, model predictive control, programs of linked stages."""

import numpy as np
import pytest

import omnidrones

THERE = {
    "vehicle": "hummingbird",
    "steps": 20,
    "dt": 0.05,
    "start": {"position": [0.0, 0.0, 1.0]},
    "goal": {"position": [1.0, 0.5, 1.2]},
    "stage": {"velocity": 0.1, "input": 1.0},
    "terminal": {"position": 1000.0, "velocity": 100.0, "attitude": 100.0, "angular_velocity": 10.0},
}
TOML = """
vehicle = "hummingbird"
steps = 20
dt = 0.05
start = { position = [0.0, 0.0, 1.0] }
goal = { position = [1.0, 0.5, 1.2] }
stage = { velocity = 0.1, input = 1.0 }
terminal = { position = 1000.0, velocity = 100.0, attitude = 100.0, angular_velocity = 10.0 }
"""


@pytest.fixture(scope="module")
def there():
    return omnidrones.optimise(THERE)


def test_a_trajectory_of_least_cost_goes_from_the_start_to_the_goal(there):
    assert there.solved and there.status == "solved" and there.gap < 1e-6 and there.violation == 0.0
    n, m, e = len(there.state_names), len(there.input_names), len(there.error_names)
    assert (n, m, e) == (17, 4, 16) and there.gains.shape == (20, m, e)
    assert there.states.shape == (21, n) and there.inputs.shape == (20, m)
    assert there.times[-1] == pytest.approx(1.0) and len(there.times) == 21
    assert there.state_names[0] == "position_x [m]" and there.state_names[13] == "rotor_0.speed [-]"
    assert there.error_names[6:9] == ["attitude_x [rad]", "attitude_y [rad]", "attitude_z [rad]"]
    assert np.array_equal(there.states[0, :3], [0.0, 0.0, 1.0])
    assert np.abs(there.states[-1, :3] - [1.0, 0.5, 1.2]).max() < 0.02
    assert np.abs(there.states[:, 13:]).max() <= 1.0 and (there.inputs > 0.0).all()
    told = there.iterations
    assert set(told) == {"cost", "gap", "step", "violation"} and {len(column) for column in told.values()} == {len(told["cost"])}
    assert told["cost"][-1] == pytest.approx(there.cost) and told["gap"][-1] < 1e-6


def test_a_problem_is_a_dict_a_text_or_a_file_and_begins_where_it_is_told(there, tmp_path):
    (tmp_path / "there.toml").write_text(TOML)
    for problem in (TOML, tmp_path / "there.toml", str(tmp_path / "there.toml")):
        assert omnidrones.optimise(problem, iterations=1).iterations["cost"][0] == there.iterations["cost"][0]
    again = omnidrones.optimise(THERE, guess=there)
    pair = omnidrones.optimise(THERE, guess=(there.states, there.inputs))
    flown = omnidrones.optimise(THERE, guess=there.inputs)
    for own in (again, pair, flown):
        assert own.solved and len(own.iterations["cost"]) < min(3, len(there.iterations["cost"]))
        assert own.cost == pytest.approx(there.cost, rel=1e-6)


def test_a_search_without_end_says_so_and_a_callback_hears_every_iteration(there):
    heard = []
    short = omnidrones.optimise("landing", iterations=2, progress=lambda *now: heard.append(now))
    assert short.status == "out_of_iterations" and not short.solved
    assert [k for k, *_ in heard] == [0, 1] and heard[1][1] == short.iterations["cost"][1]
    assert heard[1][3] == short.iterations["violation"][1]

    def refuse(*_):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        omnidrones.optimise(THERE, progress=refuse)


@pytest.mark.parametrize(
    ("problem", "more", "error", "words"),
    [
        ("slalon", {}, ValueError, "slalom"),
        (THERE | {"stepps": 3}, {}, ValueError, "steps"),
        (THERE | {"steps": 0}, {}, ValueError, "steps"),
        ("nowhere/there.toml", {}, FileNotFoundError, "nowhere"),
        (3, {}, TypeError, "problem must be"),
        (THERE, {"guess": np.zeros((20, 3))}, ValueError, "inputs of the guess"),
        (THERE, {"guess": np.zeros((20, 4), np.float32)}, TypeError, "float64"),
        (THERE, {"iterations": 0}, ValueError, "max_iterations"),
    ],
)
def test_mistakes_in_problems_are_told_with_their_names(problem, more, error, words):
    with pytest.raises(error, match=words):
        omnidrones.optimise(problem, **more)


def test_ticks_by_hand_have_the_bits_of_a_flight_under_mpc():
    circle = {"kind": "circle", "radius": 1.0, "rate": 1.0}
    flight = omnidrones.fly("hummingbird", controller="mpc", duration=0.25, reference=circle)
    mpc = omnidrones.Mpc("hummingbird", 0.002)
    states, columns = flight.states(), flight.columns()
    assert mpc.plant_state_names == omnidrones.make("Hover", 1).state_names and mpc.fallback == "cascade"
    commands = np.array([mpc.tick(state, circle, 0.002 * k) for k, state in enumerate(states)])
    told = mpc.report()
    assert commands.shape == (126, 4) and told["ticks"] == 26 and told["kept"] == told["fallen_back"] == 0
    assert told["last"]["status"] == "solved" and len(told["times"]) == 26
    most = omnidrones.Vehicle("hummingbird").to_dict()["rotors"][0]["max_speed"]
    flown = np.array([columns[f"rotor_command_{k} [rad/s]"] for k in range(4)]).T
    assert np.abs(most * np.sqrt((commands + 1) / 2) - flown).max() < 1e-9
    planned, inputs = mpc.plan()
    assert planned.shape == (21, len(mpc.state_names)) and inputs.shape == (20, len(mpc.input_names))
    mpc.reset()
    assert mpc.report()["last"] is None and np.array_equal(mpc.tick(states[0], circle, 0.0), commands[0])


def test_samples_of_a_reference_are_tracked_as_their_shape():
    mpc = omnidrones.Mpc("hummingbird", 0.01, stages=10)
    loop = omnidrones.Loop("hummingbird", dt=0.05, rates=dict.fromkeys(["velocity", "attitude", "rate"], 20.0))
    circle = {"kind": "circle", "radius": 1.0, "rate": 1.0}
    rows = np.ascontiguousarray(loop.inputs(11, circle)[:, :18])
    by_shape = mpc.tick(mpc.hover, circle, 0.0)
    mpc.reset()
    by_rows = mpc.tick(mpc.hover, rows, 0.0)
    assert np.abs(by_rows - by_shape).max() < 1e-9
    mpc.reset()
    held = mpc.tick(mpc.hover, np.zeros((1, 3)), 0.0)
    mpc.reset()
    assert np.abs(held - mpc.tick(mpc.hover, {"kind": "hover", "position": [0.0, 0.0, 0.0]}, 0.0)).max() < 1e-9
    for wrong, error, words in [
        ("cirle", ValueError, "circle"),
        ({"kind": "circle", "radiusz": 1.0}, ValueError, "radius"),
        (np.zeros((3, 4)), ValueError, "by threes"),
        (np.zeros(3), ValueError, "2 axes"),
        (np.full((2, 3), np.nan), ValueError, "finite"),
        (None, TypeError, "NoneType"),
    ]:
        with pytest.raises(error, match=words):
            mpc.tick(mpc.hover, wrong, 0.0)
    with pytest.raises(ValueError, match="state"):
        mpc.tick(np.full(17, np.nan), circle, 0.0)


def test_settings_of_mpc_are_keywords_over_those_of_its_plant():
    mpc = omnidrones.Mpc("payload", 0.01, weights={"position": [1.0, 2.0, 3.0]}, stages=5)
    assert mpc.settings["weights"]["position"] == [1.0, 2.0, 3.0] and mpc.settings["weights"]["joint_rate"] == 1.0
    assert mpc.settings["stages"] == 5 and "payload" in repr(mpc)
    for wrong, words in [
        ({"stagess": 5}, "stages"),
        ({"weights": {"input": 0.0}}, "input"),
        ({"tracked": "nobody"}, "nobody"),
        ({"rate": -1.0}, "rate"),
    ]:
        with pytest.raises(ValueError, match=words):
            omnidrones.Mpc("hummingbird", 0.01, **wrong)
    with pytest.raises(ValueError, match="dt"):
        omnidrones.Mpc("hummingbird", 0.0)


def program(rng, n_stage=6, n=3, m=2):
    square = rng.normal(size=(n_stage + 1, n + m, n + m))
    hessian = square @ square.transpose(0, 2, 1) + 0.1 * np.eye(n + m)
    cut = lambda rows: np.ascontiguousarray(rows)  # noqa: E731
    return {
        "A": 0.6 * rng.normal(size=(n_stage, n, n)),
        "B": rng.normal(size=(n_stage, n, m)),
        "c": rng.normal(size=(n_stage, n)),
        "Q": cut(hessian[:, :n, :n]),
        "S": cut(hessian[:-1, n:, :n]),
        "R": cut(hessian[:-1, n:, n:]),
        "q": rng.normal(size=(n_stage + 1, n)),
        "r": rng.normal(size=(n_stage, m)),
        "x0": rng.normal(size=n),
    }


def costs(p, inputs):
    """Of many rows of inputs at once, by the definition: [..., N, m]."""
    x, total = np.broadcast_to(p["x0"], (*inputs.shape[:-2], len(p["x0"]))), 0.0
    square = lambda a, h, b: np.einsum("...i,ij,...j->...", a, h, b)  # noqa: E731
    for k in range(inputs.shape[-2]):
        u = inputs[..., k, :]
        total = total + 0.5 * square(x, p["Q"][k], x) + square(u, p["S"][k], x) + 0.5 * square(u, p["R"][k], u)
        total = total + x @ p["q"][k] + u @ p["r"][k]
        x = x @ p["A"][k].T + u @ p["B"][k].T + p["c"][k]
    return total + 0.5 * square(x, p["Q"][-1], x) + x @ p["q"][-1]


def test_a_program_of_stages_has_its_least_cost_within_the_bounds(rng):
    for half in (np.inf, 0.3):
        p = program(rng)
        bound = np.full((6, 2), half)
        own = omnidrones.solve_stage_qp(**p, lower=-bound, upper=bound)
        assert own.solved and own.residual <= 1e-9 and own.iterations >= 1
        assert own.cost == pytest.approx(costs(p, own.inputs))
        assert np.abs(own.inputs).max() <= half
        # slopes by every input, exact for squares
        step = np.eye(12).reshape(12, 6, 2)
        slope = ((costs(p, own.inputs + step) - costs(p, own.inputs - step)) / 2).reshape(6, 2)
        assert np.abs(slope - own.multipliers).max() < 1e-9 * (1 + np.abs(slope).max())
        free = np.abs(own.inputs) < half
        assert np.abs(own.multipliers[free]).max() < 1e-9 and free.any() and free.all() == np.isinf(half)
        assert (own.multipliers[own.inputs == half] <= 0).all() and (own.multipliers[own.inputs == -half] >= 0).all()
        k = 3
        after = p["A"][k] @ own.states[k] + p["B"][k] @ own.inputs[k] + p["c"][k]
        assert np.abs(after - own.states[k + 1]).max() < 1e-12
        # gains are the answer to another start
        moved = omnidrones.solve_stage_qp(**(p | {"x0": p["x0"] + 1e-6}), lower=-bound, upper=bound)
        assert np.abs(own.inputs[0] + own.gains[0] @ np.full(3, 1e-6) - moved.inputs[0]).max() < 1e-11


def test_the_gain_of_a_program_that_ends_with_the_cost_of_lqr_is_that_of_lqr():
    model = omnidrones.linearise("hummingbird").model
    Q, R = np.eye(16), np.eye(4)
    lqr = omnidrones.lqr(model, Q, R)
    many = lambda rows, n: np.repeat(rows[None], n, axis=0)  # noqa: E731
    ends = np.concatenate([many(Q, 5), lqr.cost[None]])
    ends = (ends + ends.transpose(0, 2, 1)) / 2
    own = omnidrones.solve_stage_qp(many(model.A, 5), many(model.B, 5), None, ends, None, many(R, 5), None, None, None, None, np.zeros(16))
    assert own.solved and np.abs(own.gains + lqr.gain).max() < 1e-6 * np.abs(lqr.gain).max()
    assert own.cost == 0.0 and not own.inputs.any()


def test_a_program_that_is_none_is_refused_with_the_remedy(rng):
    p = program(rng) | {"lower": None, "upper": None}
    for wrong, error, words in [
        ({"R": -p["R"]}, ValueError, "stage"),
        ({"Q": p["Q"][:-1]}, ValueError, "Q has the shape"),
        ({"A": p["A"].tolist()}, TypeError, "A is a list"),
        ({"B": 3}, TypeError, "B is a int"),
        ({"B": p["B"][0]}, ValueError, "3 axes"),
        ({"x0": np.full(3, np.inf)}, ValueError, "x0"),
        ({"lower": np.ones((6, 2)), "upper": np.zeros((6, 2))}, ValueError, "lower"),
        ({"tolerance": 0.0}, ValueError, "tolerance"),
    ]:
        with pytest.raises(error, match=words):
            omnidrones.solve_stage_qp(**(p | wrong))
