"""Vehicles, flights, linear models, allocation, tuning."""

import pickle
import warnings

import numpy as np
import pytest

import omnidrones


def test_vehicles_come_back_from_dicts_files_and_pickles(tmp_path):
    for name in omnidrones.vehicles():
        vehicle = omnidrones.Vehicle(name)
        assert omnidrones.Vehicle.from_dict(vehicle.to_dict()) == vehicle == pickle.loads(pickle.dumps(vehicle))
        assert vehicle.mass > 0 and vehicle.inertia.shape == (3, 3) and vehicle.n_rotor >= 3
    (tmp_path / "v.toml").write_text(vehicle.to_toml())
    assert omnidrones.Vehicle(tmp_path / "v.toml") == vehicle
    with pytest.raises(ValueError, match="mass"):
        omnidrones.Vehicle.from_dict(vehicle.to_dict() | {"parts": [vehicle.to_dict()["parts"][0] | {"mass": -1.0}]})


def test_what_is_odd_about_a_vehicle_of_a_file_is_a_warning(tmp_path):
    vehicle = omnidrones.Vehicle("hummingbird")
    for factor, told in [(1.0, False), (1e3, True), (1e-3, True)]:
        fields = vehicle.to_dict()
        fields["parts"] = [part | {"mass": factor * part["mass"]} for part in fields["parts"]]
        path = tmp_path / f"of_{factor:g}.toml"
        path.write_text(omnidrones.Vehicle.from_dict(fields).to_toml())
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            omnidrones.Vehicle(path)
        assert any("mass" in str(warning.message) for warning in caught) == told, (factor, caught)


def test_a_flight_is_columns_with_units_and_key_figures(tmp_path):
    flight = omnidrones.fly("hummingbird", duration=6.0)
    columns = flight.columns()
    assert columns["time [s]"][-1] == pytest.approx(6.0, abs=0.01) and len(flight) == len(columns["time [s]"])
    error = np.stack([columns[f"position_{a} [m]"] - columns[f"reference_position_{a} [m]"] for a in "xyz"])
    late = columns["time [s]"] >= 2.0
    rmse = np.sqrt((error[:, late] ** 2).sum(0).mean())
    assert flight.summary()["rmse"] == pytest.approx(rmse) and rmse < 0.1
    assert flight.states().shape[0] == len(flight) and flight.diverged_at is None
    assert flight.mishaps == [] and 0.5 < flight.lowest < 2.0 and flight.summary()["max_heading_error"] < 0.1
    buried = omnidrones.fly("hummingbird", duration=0.1, reference={"kind": "hover", "position": [0.0, 0.0, -5.0]})
    assert len(buried.mishaps) == 1 and "below the ground" in buried.mishaps[0] and buried.lowest < -5.0
    flight.write_csv(tmp_path / "flight.csv")
    names = (tmp_path / "flight.csv").read_text().splitlines()[0]
    assert names.split(",") == list(columns)
    indi = omnidrones.fly(omnidrones.Vehicle("hummingbird"), controller="indi", duration=6.0, wind={"kind": "constant", "velocity": [3.0, 0.0, 0.0]})
    assert indi.summary()["rmse"] < 0.3
    payload = omnidrones.fly("payload", duration=4.0)
    assert payload.diverged_at is None
    for wrong, words in [({"controller": "mpx"}, "cascade"), ({"duratoin": 1.0}, "duration"), ({"duration": -1.0}, "duration")]:
        with pytest.raises(ValueError, match=words):
            omnidrones.fly("hummingbird", **wrong)


def test_filters_of_a_flight_are_those_of_its_controller():
    slow = omnidrones.fly("hummingbird", duration=0.5, filters=[{"kind": "low_pass", "frequency": 20.0}])
    assert slow.diverged_at is None
    assert not np.array_equal(slow.states(), omnidrones.fly("hummingbird", duration=0.5).states())
    for wrong, words in [
        ({"filters": [{"kind": "low_pas", "frequency": 20.0}]}, "low_pass"),
        ({"filters": [{"kind": "low_pass", "frequency": -1.0}]}, "frequency"),
        ({"filters": [{"kind": "low_pass", "frequency": 20.0}], "controller": "lqr"}, "filters"),
    ]:
        with pytest.raises(ValueError, match=words):
            omnidrones.fly("hummingbird", duration=0.1, **wrong)


def test_a_linear_model_steps_as_the_plant_and_converts():
    trim = omnidrones.linearise("hummingbird", velocity=[5.0, 0.0, 1.0])
    model = trim.model
    assert trim.residual < 1e-8 and model.A.shape == (16, 16) and model.B.shape == (16, 4) and model.dt == 0.002
    assert len(model.states) == 16 and len(model.inputs) == 4 and trim.state.shape == (17,)
    dx = model.continuous()
    assert dx.dt is None
    half = 0.001 * dx.A
    assert np.abs(np.linalg.solve(np.eye(16) - half, np.eye(16) + half) - model.A).max() < 1e-9
    pytest.importorskip("scipy")
    assert np.abs(model.to_scipy().A - model.A).max() == 0 and model.to_scipy().dt == 0.002
    payload = omnidrones.linearise("payload")
    assert payload.model.A.shape[0] > 16
    with pytest.raises(ValueError):
        omnidrones.linearise("hummingbird", velocity=[500.0, 0.0, 0.0])


def test_a_linear_model_is_one_of_python_control():
    control = pytest.importorskip("control")
    model = omnidrones.linearise("hummingbird").model
    system = model.to_control()
    assert system.nstates == 16 and system.dt == 0.002
    assert np.abs(np.sort_complex(control.poles(system)) - np.sort_complex(np.linalg.eigvals(model.A))).max() < 1e-6


def test_allocation_makes_the_wrench_within_the_limits():
    vehicle = omnidrones.Vehicle("firefly")
    wrench = [0.0, 0.0, vehicle.mass * 9.81, 0.05, 0.0, 0.0]
    whole = omnidrones.allocate(vehicle, wrench)
    assert whole.solved and np.abs(whole.delivered - wrench).max() < 1e-3 and (whole.thrust >= 0).all()
    lost = omnidrones.allocate(vehicle, wrench, effectiveness=[1, 0, 1, 1, 1, 1], yaw_last=True)
    assert lost.thrust[1] == 0 and np.abs(lost.delivered - wrench)[2:5].max() < 1e-2
    for wrong in ({"effectiveness": [1, 1]}, {"effectiveness": [2] * 6}):
        with pytest.raises(ValueError, match="effectiveness"):
            omnidrones.allocate(vehicle, wrench, **wrong)
    with pytest.raises(ValueError, match="finite"):
        omnidrones.allocate(vehicle, [np.nan] * 6)


def test_tuned_gains_track_better_on_starts_that_tuning_did_not_see():
    steps = []
    plan = dict(duration=2.0, n_start=16, n_held_out=32, iterations=8)
    tuned = omnidrones.tune("hummingbird", watch=lambda k, error: steps.append((k, error)), **plan)
    assert tuned["after"]["rmse"] < tuned["before"]["rmse"] and tuned["after"]["crashed"] == 0
    assert [k for k, _ in steps] == list(range(8))
    flown = omnidrones.fly("hummingbird", gains=tuned["gains"], duration=4.0)
    assert flown.diverged_at is None


def test_a_vehicle_that_lost_a_rotor_has_its_steady_turn():
    spin = omnidrones.linearise("hummingbird", fail={1: 0.0})
    assert spin.residual < 1e-8 and abs(spin.yaw_rate) > 10 and spin.model.A.shape == (16, 16)
    weak = omnidrones.linearise("hummingbird", fail={"rotor_2": 0.6})
    assert weak.yaw_rate == 0.0 and np.abs(weak.input[2] - weak.input[0]) > 0.05
    for name, fail, words in [
        ("firefly", {1: 0.0}, "turns faster until its drag"),
        ("crazyflie", {1: 0.0}, "Leave the lost rotor a share"),
        ("hummingbird", {7: 0.0}, "no rotor is called"),
        ("hummingbird", {1: 2.0}, "effectiveness is 2"),
    ]:
        with pytest.raises(ValueError, match=words):
            omnidrones.linearise(name, fail=fail)
    with pytest.raises(ValueError, match="must spin to stay up"):
        omnidrones.linearise("hummingbird", fail={1: 0.0}, velocity=[1.0, 0.0, 0.0])


def test_margins_are_those_of_the_loop_that_flies():
    loop = omnidrones.design("hummingbird")
    told = loop.margins("rotor_0.action")
    assert told["stable"] and np.abs(loop.poles).max() < 1 and loop.period == 10
    late = omnidrones.design("hummingbird", latency=round(told["delay"] / 0.002) - 6)
    assert late.margins("rotor_0.action")["delay"] < told["delay"] and late.margins()["alpha"] < loop.margins()["alpha"]
    # S at one frequency of the lifted loop, by its matrices
    w = np.array([3.0, 30.0, 300.0])
    opened = loop.open("rotor_0.action")
    n, identity = loop.period, np.eye(loop.period)
    for omega, s in zip(w, loop.sensitivity("rotor_0.action", w), strict=True):
        z = np.exp(1j * omega * opened.dt)
        response = opened.C @ np.linalg.solve(z * np.eye(len(opened.A)) - opened.A, opened.B) + opened.D
        wave = np.exp(1j * omega * 0.002 * np.arange(n))
        assert s == pytest.approx(wave.conj() @ np.linalg.solve(identity + response, wave) / n, rel=1e-6)
    assert omnidrones.design("hummingbird", wind=[8.0, 0.0, 0.0]).trim.state[7:9].any()
    with pytest.raises(ValueError, match="rotor_0.action"):
        loop.margins("rotor_9")


def test_feedback_of_least_cost_is_that_of_python_control():
    control = pytest.importorskip("control")
    model = omnidrones.linearise("iris").model
    Q, R = np.diag(np.linspace(1.0, 2.0, 16)), np.eye(4)
    own = omnidrones.lqr(model, Q, R)
    gain, cost, poles = control.dlqr(model.A, model.B, Q, R)
    assert np.abs(own.gain - gain).max() < 1e-7 * np.abs(gain).max()
    assert np.abs(own.cost - cost).max() < 1e-7 * np.abs(cost).max()
    assert np.abs(np.sort(np.abs(own.poles)) - np.sort(np.abs(poles))).max() < 1e-7
    with pytest.raises(ValueError, match="sampled"):
        omnidrones.lqr(model.continuous(), Q, R)
    with pytest.raises(ValueError, match="R has the shape"):
        omnidrones.lqr(model, Q, np.eye(3))


def test_figures_are_those_of_the_library(tmp_path):
    flight = omnidrones.fly("hummingbird", duration=3.0)
    assert flight._repr_svg_() == flight.plot().svg()
    for name in ("path", "error", "rotors", "attitude", "rates"):
        assert flight.plot(name)._repr_svg_().startswith("<svg")
    with pytest.raises(ValueError, match="overview"):
        flight.plot("pth")
    figure = omnidrones.plot({"a": ([1, 2, 3], [1.0, np.nan, 3.0])}, title="T", x="x [m]", y="y [m]", log_y=True)
    figure.save(tmp_path / "curve.png")
    figure.save(tmp_path / "curve.svg")
    assert (tmp_path / "curve.png").read_bytes()[:4] == b"\x89PNG" and (tmp_path / "curve.svg").read_text() == figure.svg()
    with pytest.raises(ValueError, match="y of a has the shape"):
        omnidrones.plot({"a": ([1.0, 2.0], [1.0])})
