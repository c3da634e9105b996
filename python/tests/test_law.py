"""Controllers, references and winds written in Python, beside the library's own."""

import traceback

import numpy as np
import pytest

import omnidrones

RATES = {"velocity": 50.0, "attitude": 250.0, "rate": 500.0}


def own_gains(vehicle, integral=(0.0, 0.0)):
    return {**omnidrones.Vehicle(vehicle).gains, "integral": list(integral)}


class Cascade(omnidrones.ControlLaw):
    """The library's cascade, of its parts."""

    levels = RATES

    def __init__(self, vehicle="hummingbird"):
        self.parts = omnidrones.CascadeParts(vehicle)
        self.gains = {name: own_gains(vehicle)[name] for name in ("position", "velocity", "attitude", "rate")}
        self.memory = self.parts.memory

    def tick(self, now, held):
        parts, k, wanted = self.parts, now.gains, now.target
        attitude, turning = parts.upright(now.attitude, now.angular_velocity)
        ratio = omnidrones.functions.safe_divide(k["position"], k["velocity"], 1e-9)
        fresh = parts.attitude_command(
            k["velocity"],
            velocity=wanted.velocity + ratio * (wanted.position - now.position),
            acceleration=wanted.acceleration + parts.drag(attitude, wanted.velocity),
            jerk=wanted.jerk + parts.drag(attitude, wanted.acceleration),
            snap=wanted.snap + parts.drag(attitude, wanted.jerk),
            yaw=[wanted.yaw, wanted.yaw_rate, wanted.yaw_acceleration],
            attitude=attitude,
            measured=now.velocity,
        )
        command = np.where(now.due["velocity"], fresh, held["attitude"])
        fresh = parts.rate_command(k["attitude"], k["rate"], command, attitude, turning)
        rate = np.where(now.due["attitude"], fresh, held["rate"])
        wrench = parts.wrench(k["rate"], rate, attitude, now.velocity, turning)
        rotors = np.where(now.due["rate"], parts.actions(wrench), held["rotors"])
        return rotors, {"attitude": command, "rate": rate, "rotors": rotors}


@pytest.mark.parametrize("vehicle", ["hummingbird", "firefly"])
def test_a_cascade_of_its_parts_flies_with_the_bits_of_the_cascade(vehicle):
    plan = {"rates": RATES, "duration": 2.0, "reference": {"kind": "circle"}}
    own = omnidrones.fly(vehicle, controller=Cascade(vehicle), **plan)
    known = omnidrones.fly(vehicle, controller="cascade", gains=own_gains(vehicle), **plan)
    assert np.array_equal(own.states(), known.states()) and own.summary()["rmse"] == known.summary()["rmse"]


def test_a_loop_around_it_has_the_gradients_of_the_cascade(rng):
    own = omnidrones.Loop("hummingbird", controller=Cascade())
    known = omnidrones.Loop("hummingbird", gains=own_gains("hummingbird"), rates=RATES)
    assert (own.n_state, own.n_input, own.n_parameter) == (known.n_state, known.n_input, known.n_parameter)
    assert own.parameter_names[-12:-10] == ["gains.position[0]", "gains.position[1]"]
    states = [loop.trajectory(loop.initial_state(), loop.inputs(40)) for loop in (own, known)]
    assert np.array_equal(states[0][:, :17], states[1][:, :17])
    up = np.zeros((41, own.n_state))
    up[:, :17] = rng.normal(size=(41, 17))
    down = [loop.pull(up, loop.initial_state(), loop.inputs(40)) for loop in (own, known)]
    assert np.array_equal(down[0][2], down[1][2]) and np.array_equal(down[0][1], down[1][1])


def test_it_has_the_margins_of_the_cascade():
    own = omnidrones.design("hummingbird", controller=Cascade())
    known = omnidrones.design("hummingbird", gains=own_gains("hummingbird"), rates=RATES)
    assert own.stability == known.stability == "stable" and own.margins() == known.margins()


def test_its_gains_are_tuned_as_those_of_the_cascade():
    plan = {"iterations": 2, "duration": 0.4, "n_start": 2, "n_held_out": 2}
    heard = []
    own = omnidrones.tune("hummingbird", controller=Cascade(), watch=lambda i, error: heard.append(error), **plan)
    known = omnidrones.tune("hummingbird", gains=own_gains("hummingbird"), rates=RATES, **plan)
    assert own["before"] == known["before"] and own["after"] == known["after"] and len(heard) == 2
    assert all(np.array_equal(own["gains"][name], known["gains"][name]) for name in own["gains"])


def test_ten_thousand_plants_fly_under_it_as_under_the_cascade():
    plan = {"n": 200, "duration": 1.0, "transient": 0.2, "vary": {"mass": 0.2, "inertia": 0.2}, "wind": 2.0}
    own = omnidrones.monte_carlo("hummingbird", controller=Cascade(), **plan)
    known = omnidrones.monte_carlo("hummingbird", gains=own_gains("hummingbird"), rates=RATES, **plan)
    assert len(own) == 200 and own.summary() == known.summary() and own.summary()["lost"]["hits"] == 0
    columns = [run.columns() for run in (own, known)]
    assert list(columns[0]) == list(columns[1]) and {"rmse [m]", "mass (factor) [-]", "wind_x [m/s]"} <= set(columns[0])
    assert all(np.array_equal(columns[0][name], columns[1][name], equal_nan=True) for name in columns[0])
    assert abs(columns[0]["mass (factor) [-]"] - 1).max() < 0.2


def test_it_comes_back_from_the_starts_that_the_cascade_comes_back_from():
    plan = {"tilt": (3.0, 3), "rate": (6.0, 2), "n": 24, "duration": 2.0}
    own = omnidrones.recovery_map("hummingbird", controller=Cascade(), **plan)
    known = omnidrones.recovery_map("hummingbird", gains=own_gains("hummingbird"), rates=RATES, **plan)
    columns = [told.columns() for told in (own, known)]
    assert own.batched and all(np.array_equal(columns[0][name], columns[1][name]) for name in columns[1])
    assert columns[0]["recovered"].shape == (3, 2) and 0.0 < own.within(3.0, 6.0)[0] < 1.0


class Hold(omnidrones.ControlLaw):
    gains = {"height": 0.3, "speed": 0.4}
    memory = [0.0]
    rate = 250.0

    def tick(self, now, memory):
        error = now.target.position[2] - now.position[2]
        action = -0.41 + now.gains["height"] * error - now.gains["speed"] * now.velocity[2] + 0.1 * memory[0]
        return np.clip(action, -1.0, 1.0) * np.ones(4), memory + now.period * error


def test_a_law_of_a_rate_and_a_memory_of_its_own_remembers():
    reference = {"kind": "step", "from": [0, 0, 0], "to": [0, 0, 1]}
    flight = omnidrones.fly("hummingbird", controller=Hold(), duration=4.0, reference=reference)
    heights = flight.states()[:, 2]
    assert abs(heights[-1] - 1.0) < 0.2 and heights.max() < 1.6
    assert omnidrones.Loop("hummingbird", controller=Hold()).n_state == 17 + 1 + 4


def test_python_is_called_once_for_a_flight():
    calls = []

    class Counted(Hold):
        def tick(self, now, memory):
            calls.append(now.state.shape)
            return super().tick(now, memory)

    omnidrones.fly("hummingbird", controller=Counted(), duration=0.5)
    assert calls == [(17,)]


class Own(omnidrones.ControlLaw):
    """One of a test."""

    def __init__(self, tick, **how):
        self.own = tick
        for name, value in how.items():
            setattr(self, name, value)

    def tick(self, now, memory):
        return self.own(now, memory)


def branches(now, memory):
    if now.position[2] > 0:
        return np.zeros(4)
    return np.ones(4)


def fails(now, memory):
    raise KeyError("of the user")


@pytest.mark.parametrize(
    "law, error, words",
    [
        (Own(branches), omnidrones.RecordingError, "np.where"),
        (Own(fails), KeyError, "of the user"),
        (Own(lambda now, memory: np.zeros(3)), omnidrones.RecordingError, "shape"),
        (Own(lambda now, memory: None), omnidrones.RecordingError, "is None"),
        (Own(lambda now, memory: np.zeros(4), memory=[0.0]), TypeError, "must return (commands, memory)"),
        (Own(lambda now, memory: (np.zeros(4), np.zeros(2)), memory=[0.0]), omnidrones.RecordingError, "memory"),
        (Own(lambda now, memory: (np.zeros(4), {}), memory={"a": 0.0}), TypeError, "a dict of a"),
        (Own(lambda now, memory: np.zeros(4), gains={"k": "much"}), ValueError, "gains of the controller: k is a str"),
        (Own(lambda now, memory: np.zeros(4), levels={"slow": 70.0}), ValueError, "70 Hz"),
        (Own(lambda now, memory: np.zeros(4), gains={"k": np.nan}), ValueError, "gains.k"),
        (Own(lambda now, memory: np.zeros(4), rate=300.0), ValueError, "300 Hz"),
        (Hold, TypeError, "Hold()"),
        (3.0, TypeError, "ControlLaw"),
        ("cascad", ValueError, "did you mean 'cascade'"),
    ],
)
def test_what_is_no_law_is_refused_with_the_remedy(law, error, words):
    with pytest.raises(error) as raised:
        omnidrones.fly("hummingbird", controller=law, duration=0.1)
    assert words in str(raised.value)
    # and the next one flies
    assert len(omnidrones.fly("hummingbird", controller=Hold(), duration=0.1)) == 51


def test_an_error_of_a_tick_keeps_its_traceback():
    with pytest.raises(KeyError) as raised:
        omnidrones.Loop("hummingbird", controller=Own(fails))
    assert "raise KeyError" in "".join(traceback.format_exception(raised.value))


def test_gains_are_not_given_twice_and_a_gain_that_is_not_positive_is_not_tuned():
    with pytest.raises(ValueError, match="gains is given"):
        omnidrones.fly("hummingbird", controller=Hold(), gains=own_gains("hummingbird"))
    law = Hold()
    law.gains = {"height": -0.3, "speed": 0.4}
    with pytest.raises(ValueError, match="gains.height"):
        omnidrones.tune("hummingbird", controller=law)


def test_a_number_kept_from_another_tick_is_refused():
    kept = []

    def keeps(now, memory):
        kept.append(now.position[2])
        return kept[0] * np.ones(4)

    omnidrones.Loop("hummingbird", controller=Own(keeps))
    with pytest.raises(omnidrones.RecordingError):
        omnidrones.Loop("hummingbird", controller=Own(keeps))


def test_a_reference_that_is_a_function_has_exact_derivatives():
    def path(t):
        return np.stack([np.cos(t), np.sin(t), 1.0 + 0.1 * t]), 0.3 * t

    row = omnidrones.Loop("hummingbird").inputs(3, path, first=100)[0]
    t = 0.2
    wanted = [np.cos(t), np.sin(t), 1.02, -np.sin(t), np.cos(t), 0.1, -np.cos(t), -np.sin(t), 0.0]
    wanted += [np.sin(t), -np.cos(t), 0.0, np.cos(t), np.sin(t), 0.0, 0.06, 0.3, 0.0]
    assert np.abs(row[:18] - wanted).max() < 1e-14
    flight = omnidrones.fly("hummingbird", reference=path, duration=5.0)
    assert flight.summary()["rmse"] < 0.05
    with pytest.raises(omnidrones.RecordingError, match="position of the reference"):
        omnidrones.fly("hummingbird", reference=lambda t: t)
    with pytest.raises(ValueError, match="reference at 0 s"):
        omnidrones.fly("hummingbird", reference=lambda t: np.stack([np.log(t), t, t]))


def test_a_wind_that_is_a_function_blows_as_the_one_of_a_file():
    steady = {"kind": "constant", "velocity": [3.0, -1.0, 0.0]}
    own = omnidrones.fly("hummingbird", wind=lambda t: np.array([3.0, -1.0, 0.0]), duration=1.0)
    known = omnidrones.fly("hummingbird", wind=steady, duration=1.0)
    assert np.array_equal(own.states(), known.states())
    gusty = omnidrones.fly("hummingbird", wind=lambda t: np.stack([3.0 + np.sin(5.0 * t), -1.0, 0.0 * t]), duration=1.0)
    assert not np.array_equal(gusty.states(), known.states())


def test_a_task_is_flown_by_it_as_a_baseline():
    class Slow(Hold):
        rate = 10.0

    env = omnidrones.make("Hover", 4, seed=0, threads=1)
    env.reset()
    law = Cascade()
    law.levels = dict.fromkeys(RATES, 1.0 / env.spec.dt)
    own = omnidrones.Controller(env, law)
    for _ in range(300):
        env.step(own(env))
    assert own.name == "Cascade" and env.column("position_error").max() < 0.1
    with pytest.raises(ValueError, match="rate of controller 'Slow'"):
        omnidrones.Controller(env, Slow())
