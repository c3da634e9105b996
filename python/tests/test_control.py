"""Vehicles, flights, linear models, allocation, tuning."""

import pickle

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


def test_a_flight_is_columns_with_units_and_key_figures(tmp_path):
    flight = omnidrones.fly("hummingbird", duration=6.0)
    columns = flight.columns()
    assert columns["time [s]"][-1] == pytest.approx(6.0, abs=0.01) and len(flight) == len(columns["time [s]"])
    error = np.stack([columns[f"position_{a} [m]"] - columns[f"reference_position_{a} [m]"] for a in "xyz"])
    late = columns["time [s]"] >= 2.0
    rmse = np.sqrt((error[:, late] ** 2).sum(0).mean())
    assert flight.summary()["rmse"] == pytest.approx(rmse) and rmse < 0.1
    assert flight.states().shape[0] == len(flight) and flight.diverged_at is None
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
