"""Filters of what sensors read, one, many, in flights and environments; Kalman filters of linear models."""

import numpy as np
import pytest

import omnidrones

ROOM = "imu:bmi088,motion_capture:optical"
FAST = dict.fromkeys(["velocity", "attitude", "rate"], 500.0)
#: as ROOM, with nothing late
PROMPT = [
    {"name": "imu", "kind": "imu", "preset": "bmi088"},
    {"name": "cameras", "kind": "motion_capture", "preset": "optical", "every": 5, "latency": 0},
]


def motion(state):
    """A state as `begin` takes it."""
    return [np.ascontiguousarray(state[..., at:end]) for at, end in [(0, 3), (3, 6), (6, 10), (10, 13)]]


def multiply(p, q):
    (a, u), (b, v) = (p[0], p[1:]), (q[0], q[1:])
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])


def mounted(faults):
    return [PROMPT[0], PROMPT[1] | {"faults": faults}]


def flown(sensors=ROOM, duration=2.0, **more):
    return omnidrones.fly("hummingbird", sensors=sensors, duration=duration, **more)


@pytest.fixture(scope="module")
def aboard():
    """A flight on estimates."""
    return flown(duration=3.0, estimator="ekf", rates=FAST)


def test_a_flight_on_estimates_has_them_with_how_good_they_were(aboard):
    own = aboard.estimates
    n = len(aboard)
    assert len(own) == n and own.position.shape == own.velocity.shape == (n, 3) and own.attitude.shape == (n, 4)
    off = own.position - aboard.states()[:, :3]
    assert own.rms["position"] == pytest.approx(np.sqrt((off**2).sum(1).mean()))
    # 0.6 mm, 7 mm/s, 0.9 mrad
    assert own.rms["position"] < 2e-3 and own.rms["velocity"] < 2e-2 and own.rms["attitude"] < 3e-3
    late = slice(500, None)
    assert (np.abs(off) < 4 * own.deviations[:, :3])[late].mean() > 0.99
    assert own.deviations.shape == (n, 9) and 4 < own.nees < 16 and own.share_within > 0.8
    assert own.angular_velocity is own.biases is own.errors is own.squared_errors is None
    for record in own.records:
        assert record["name"].startswith("motion_capture.") and record["lost"] == record["believed_again"] == 0
        assert record["n"] == 300 and 0.8 < record["mean"] < 1.2 and record["left_out"] < 3
    assert own.saturated == 0 and "NEES" in repr(own)
    assert flown(duration=0.01).estimates is None


def test_a_recorded_flight_is_filtered_whole_as_by_the_filter_on_board(aboard):
    states, readings = aboard.states(), aboard.readings()
    filter = omnidrones.StateEstimator(ROOM, 0.002)
    columns = aboard.columns()
    assert aboard.reading_names == filter.reading_names
    assert np.array_equal(readings, np.stack([columns[name] for name in filter.reading_names], axis=1))
    filter.begin(*motion(states[0]))
    whole = filter.run(readings, truth=states)
    # that on board began off the truth by what it believed; both forget it
    for name, most in [("position", 1e-3), ("velocity", 1e-2), ("attitude", 1e-3), ("deviations", 1e-3)]:
        assert np.abs(getattr(whole, name) - getattr(aboard.estimates, name))[1000:].max() < most, name
    assert whole.nees == pytest.approx(whole.squared_errors.mean()) and 0 < aboard.estimates.nees < 20
    assert whole.records == filter.records and [own["name"] for own in whole.records] == [own["name"] for own in aboard.estimates.records]
    assert whole.share_within == pytest.approx(((whole.squared_errors > 2.7004) & (whole.squared_errors < 19.0228)).mean())
    # 19 mrad/s, beside rates of 1.6 rad/s
    assert np.abs(whole.angular_velocity - states[:, 10:13])[500:].max() < 0.05
    assert np.abs(whole.errors[:, :3] + whole.position - states[:, :3]).max() < 1e-12

    filter.begin(*motion(states[0]))
    for row in readings:
        filter.step(row)
    for name in ("position", "velocity", "attitude", "angular_velocity"):
        assert np.array_equal(getattr(filter, name), getattr(whole, name)[-1]), name
    assert filter.squared_error(*motion(states[-1])) == whole.squared_errors[-1]
    assert filter.biases == {name: column[-1] for name, column in whole.biases.items()}
    known = np.concatenate([whole.deviations[-1], [column[-1] for column in whole.bias_deviations.values()]])
    assert np.array_equal(filter.deviations, known) and np.array_equal(np.sqrt(np.diag(filter.covariance)), known)
    assert np.array_equal(filter.covariance, filter.covariance.T)
    assert len(filter.error_names) == len(known) and filter.error_names[3] == "velocity_x [m/s]"
    blind = omnidrones.StateEstimator(ROOM, 0.002).run(readings[:3])
    assert blind.nees is blind.errors is blind.rms is blind.share_within is None


@pytest.mark.parametrize(
    "sensors", [ROOM, "imu:adis16448,gnss:single_point,magnetometer:pegasus,barometer:ms5611"], ids=["room", "survey"]
)
def test_a_filter_knows_how_far_it_is_off(sensors, rng):
    squared, innovations = [], []
    for seed in range(12):
        flight = flown(sensors, seed=seed, duration=4.0)
        filter = omnidrones.StateEstimator(sensors, 0.002)
        position, velocity, attitude, rate = motion(flight.states()[0])
        turn = rng.normal(0, 0.02, 3)
        begins = multiply(attitude, np.array([1.0, *(turn / 2)]))
        filter.begin(
            position + rng.normal(0, 0.1, 3), velocity + rng.normal(0, 0.1, 3), begins / np.linalg.norm(begins), rate
        )
        squared.append(filter.run(flight.readings(), truth=flight.states()).squared_errors[[0, 1000, 2000]])
        innovations.append([record["mean"] for record in filter.records])
    # 99.9 % of the mean of twelve of chi-squared with nine degrees of freedom; 7.7 to 11.2
    assert all(5.5 < mean < 13.5 for mean in np.mean(squared, axis=0)), np.mean(squared, axis=0)
    assert (np.abs(np.mean(innovations, axis=0) - 1) < 0.15).all(), np.mean(innovations, axis=0)


def test_settings_are_keywords_and_those_of_a_flight_a_dict():
    flight = flown(estimator={"position": 0.5, "gate": 10.0}, duration=0.1)
    filter = omnidrones.StateEstimator(ROOM, 0.002, position=0.5, gate=10.0)
    assert filter.deviations[0] == 0.5
    filter.begin(*motion(flight.states()[0]))
    assert np.allclose(filter.run(flight.readings()).deviations, flight.estimates.deviations, rtol=0.1)
    floating = omnidrones.StateEstimator("imu:bmi088", 0.01, gravity=0.0)
    floating.run(np.zeros((100, 6)))
    assert np.array_equal(floating.position, np.zeros(3))
    falling = omnidrones.StateEstimator("imu:bmi088", 0.01, gravity=1.62)
    falling.run(np.zeros((101, 6)))
    assert falling.position[2] == pytest.approx(-0.5 * 1.62) and falling.velocity[2] == pytest.approx(-1.62)


def test_every_kind_of_estimator_flies_and_tells_what_it_knows():
    hover = {"kind": "hover", "position": [0.0, 0.0, 1.0]}
    how = {"rates": FAST, "reference": hover, "duration": 2.0}
    for kind, knows in [("ekf", True), ("complementary", False), ("kalman", True)]:
        flight = flown(estimator=kind, **how)
        own, same = flight.estimates, flown(estimator={"kind": kind}, **how).estimates
        assert flight.diverged_at is None and flight.summary(1.0)["rmse"] < 0.05
        assert own.rms["position"] < 0.02 and own.rms == same.rms and own.position.shape == (1001, 3)
        if knows:
            assert own.deviations.shape == (1001, 9) and own.nees > 0 and own.records
            assert 0 < own.share_within <= 1
        else:
            assert own.deviations is own.nees is own.share_within is None and own.records == []
    mild = flown(estimator={"kind": "complementary", "attitude": 0.5}, **how)
    assert mild.estimates.rms != flown(estimator="complementary", **how).estimates.rms


def test_sensors_are_a_text_tables_or_a_file(tmp_path):
    text = "".join(
        f"[[sensor]]\n{''.join(f'{key} = {value!r}' + chr(10) for key, value in table.items())}" for table in PROMPT
    )
    (tmp_path / "room.toml").write_text(text)
    names = omnidrones.StateEstimator(PROMPT, 0.002).reading_names
    for sensors in (text, tmp_path / "room.toml", str(tmp_path / "room.toml"), {"sensor": PROMPT}):
        assert omnidrones.StateEstimator(sensors, 0.002).reading_names == names
        assert flown(sensors, duration=0.01).reading_names == names


def test_a_fault_is_left_out_and_counted_and_the_unit_at_its_limit_is_told():
    faults = [
        {"kind": "offset", "from": 0.5, "until": 0.6, "by": [5.0]},
        {"kind": "lost", "from": 1.0, "until": 1.2},
        {"kind": "offset", "from": 1.5, "until": 9.0, "by": [0.0, 2.0]},
    ]
    flight = flown(mounted(faults), duration=3.0)
    filter = omnidrones.StateEstimator(PROMPT, 0.002, patience=0.5)
    filter.begin(*motion(flight.states()[0]))
    own = filter.run(flight.readings(), truth=flight.states())
    place = filter.records[0]
    # ten jumps, fifty without patience; one reading in ten milliseconds
    assert place["lost"] == 20 and 55 <= place["left_out"] <= 65 and place["believed_again"] == 1
    assert np.abs(own.errors[:700, :3]).max() < 0.02
    # a sensor that tells the same for long is believed
    assert abs(own.errors[-1, 1] + 2.0) < 0.1
    hit = flight.readings()
    hit[100:105, 0] = 1e3
    hit[200, 3] = np.nan
    filter.begin(*motion(flight.states()[0]))
    assert filter.run(hit[:300]).saturated == filter.saturated == 6
    filter.begin()
    assert filter.saturated == 0 and all(record["n"] == 0 and record["mean"] is None for record in filter.records)


def test_filters_side_by_side_are_those_alone(rng):
    flights = [flown(PROMPT, seed=seed, duration=0.5) for seed in range(11)]
    readings = np.stack([flight.readings() for flight in flights])
    states = np.stack([flight.states() for flight in flights])
    many = omnidrones.StateEstimatorBatch(PROMPT, 11, 0.002)
    assert len(many) == 11 and many.late == 0
    many.begin(*motion(states[:, 0]))
    n_step = readings.shape[1]
    # every third rests in the second half
    goes_on = np.arange(11) % 3 > 0
    for t in range(n_step):
        many.step(np.ascontiguousarray(readings[:, t]), goes_on if t > n_step // 2 else None)
    squared = many.squared_error(*motion(states[:, -1]))
    counts = np.zeros(2)
    for k in range(11):
        one = omnidrones.StateEstimator(PROMPT, 0.002)
        one.begin(*motion(states[k, 0]))
        one.run(readings[k] if goes_on[k] else readings[k, : n_step // 2 + 1].copy())
        for name in ("position", "velocity", "attitude", "angular_velocity", "covariance", "deviations"):
            assert np.abs(getattr(many, name)[k] - getattr(one, name)).max() < 1e-12, (k, name)
        assert one.biases == pytest.approx({name: column[k] for name, column in many.biases.items()}, abs=1e-12)
        assert squared[k] == pytest.approx(one.squared_error(*motion(states[k, -1])), rel=1e-6)
        counts += [record["n"] for record in one.records]
    assert [record["n"] for record in many.records] == list(counts) and many.saturated == 0
    assert many.reading_names == one.reading_names and many.error_names == one.error_names
    before = many.position
    anew = np.arange(11) == 4
    many.begin(np.full((11, 3), 7.0), mask=anew)
    assert (many.position[anew] == 7.0).all() and np.array_equal(many.position[~anew], before[~anew])


def test_filters_side_by_side_stand_behind_what_is_late_and_tell_the_present():
    flight = flown(duration=2.0)
    states = flight.states()
    many = omnidrones.StateEstimatorBatch(ROOM, 2, 0.002)
    assert many.late == 5
    many.begin(*motion(np.stack([states[0]] * 2)))
    for row in flight.readings():
        many.step(np.stack([row, row]))
    assert np.array_equal(many.position[0], many.position[1])
    # at present it is right to half a millimetre, while the vehicle moves by more in the steps between
    assert np.abs(many.position[0] - states[-1, :3]).max() < 2e-3
    then = states[-1 - many.late]
    assert (many.squared_error(*motion(np.stack([then] * 2))) < 30).all()
    assert (many.squared_error(*motion(np.stack([states[-1]] * 2))) > 1000).all()


def test_agents_see_estimates_and_learn_from_them():
    how = {"sensor": PROMPT, "observation": [{"kind": "estimate"}], "seed": 3}
    plain, seen = omnidrones.make("Hover", 64, seed=3), omnidrones.make("Hover", 64, **how)
    assert seen.spec.n_observation == plain.spec.n_observation and seen.config["observation"] == [how["observation"][0] | seen.config["observation"][0]]
    for env in (plain, seen):
        env.reset()
    for t in range(20):
        actions = (0.1 * plain.sample(t) - 0.4).astype(np.float32)
        truth, estimate = plain.step(actions), seen.step(actions)
        assert np.array_equal(truth.reward, estimate.reward), "rewards are of the truth"
    off = np.abs(truth.observation - estimate.observation)[:, 0, :3]
    # they begin off by a decimetre; 1.9 mm
    assert 0 < off.max() < 0.01
    short = omnidrones.make("Hover", 4, sensor=[PROMPT[0], {"name": "barometer", "kind": "barometer", "preset": "px4", "every": 1}], observation=[{"kind": "estimate"}])
    assert [own["name"] for own in short.config["sensor"]] == ["imu", "barometer"]
    run = omnidrones.train(
        "Hover", sensor=PROMPT, observation=how["observation"], horizon=40, log_every=1,
        evaluate={"envs": 16}, apg={"n_env": 16, "horizon": 8, "updates": 3},
    )  # fmt: skip
    assert run.updates == 3 and np.isfinite(run.curve["loss"]).all() and 0 <= run.evaluation["success"] <= 1
    for wrong, words in [
        ({"observation": [{"kind": "estimate"}]}, "imu"),
        (how | {"observation": [{"kind": "estimate", "settings": {"gate": -1.0}}]}, "gate"),
        (how | {"sensor": "imu:bmi08"}, "bmi088"),
    ]:
        with pytest.raises(ValueError, match=words):
            omnidrones.make("Hover", 4, **wrong)


def test_a_flight_that_cannot_be_estimated_is_refused_with_what_it_takes():
    for wrong, error, words in [
        ({"estimator": "ekf"}, ValueError, "imu"),
        ({"estimator": "ekf", "sensors": "gnss"}, ValueError, "imu"),
        ({"estimator": "ekv", "sensors": ROOM}, ValueError, "ekf"),
        ({"estimator": {"gatee": 1.0}, "sensors": ROOM}, ValueError, "gate"),
        ({"estimator": {"kind": "ekv"}, "sensors": ROOM}, ValueError, "ekf"),
        ({"estimator": {"kind": 3}, "sensors": ROOM}, ValueError, "kind"),
        ({"estimator": {"kind": "complementary", "gate": 3.0}, "sensors": ROOM}, ValueError, "gate"),
        ({"estimator": {"gate": 0.0}, "sensors": ROOM}, ValueError, "gate"),
        ({"estimator": 3, "sensors": ROOM}, TypeError, "estimator is a int"),
        ({"sensors": "imu:bmi08"}, ValueError, "bmi088"),
        ({"sensors": 3}, TypeError, "sensors is a int"),
        ({"sensors": mounted([{"kind": "lost", "from": 2.0, "until": 1.0}])}, ValueError, "until"),
    ]:
        with pytest.raises(error, match=words):
            omnidrones.fly("hummingbird", duration=0.1, **wrong)
    with pytest.raises(ValueError, match="rigid"):
        omnidrones.fly("payload", duration=0.1, sensors=ROOM, estimator="ekf")


@pytest.mark.parametrize(
    ("sensors", "more", "error", "words"),
    [
        ("gnss", {}, ValueError, "imu"),
        ("", {}, ValueError, "kind of sensor"),
        ([], {}, ValueError, "imu"),
        ([1], {}, ValueError, "sensor"),
        ({"sensors": []}, {}, ValueError, "sensor"),
        (None, {}, TypeError, "sensors is a NoneType"),
        (object(), {}, TypeError, "sensors is a object"),
        ("nowhere/room.toml", {}, FileNotFoundError, "nowhere"),
        ([PROMPT[0], PROMPT[0]], {}, ValueError, "twice"),
        ([PROMPT[0] | {"accelerometer": {"density": np.nan}}], {}, ValueError, "density"),
        ([PROMPT[0] | {"rotation": [2.0, 0.0, 0.0, 0.0]}], {}, ValueError, "rotation"),
        ([PROMPT[0] | {"on": "arm"}, PROMPT[1]], {}, ValueError, "one body"),
        ([PROMPT[0], PROMPT[1] | {"latency": 10**6}], {}, ValueError, "latency"),
        (ROOM, {"dt": 0.0}, ValueError, "dt"),
        (ROOM, {"dt": np.nan}, ValueError, "dt"),
        (ROOM, {"dt": "a"}, TypeError, "number"),
        (ROOM, {"gravity": np.inf}, ValueError, "gravity"),
        (ROOM, {"gate": -1.0}, ValueError, "gate"),
        (ROOM, {"patiense": 1.0}, ValueError, "patience"),
        (ROOM, {"position": [1.0, 1.0, 1.0]}, ValueError, "position"),
    ],
)
def test_filters_of_what_is_none_are_refused(sensors, more, error, words):
    with pytest.raises(error, match=words):
        omnidrones.StateEstimator(sensors, **({"dt": 0.002} | more))
    with pytest.raises(error, match=words):
        omnidrones.StateEstimatorBatch(sensors, 3, **({"dt": 0.002} | more))


def test_what_does_not_fit_a_filter_is_refused_and_leaves_it_as_it_was():
    one, many = omnidrones.StateEstimator(PROMPT, 0.002), omnidrones.StateEstimatorBatch(PROMPT, 3, 0.002)
    good = np.zeros(14)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    truth = np.tile([0.0] * 6 + [1.0] + [0.0] * 10, (3, 1))
    spoilt = truth.copy()
    spoilt[2, 4] = np.nan
    before = one.covariance, many.covariance
    for call, error, words in [
        (lambda: one.step(good[:13]), ValueError, r"\[14\]"),
        (lambda: one.step(good.astype(np.float32)), TypeError, "float64"),
        (lambda: one.step(good.tolist()), TypeError, "readings is a list"),
        (lambda: one.step("readings"), TypeError, "readings is a str"),
        (lambda: one.step(np.zeros(28)[::2]), ValueError, "C order"),
        (lambda: one.begin([1.0, 2.0]), ValueError, "position has 2 numbers"),
        (lambda: one.begin("abc"), TypeError, "position is a str"),
        (lambda: one.begin([0.0, 0.0, np.nan]), ValueError, "position is NaN"),
        (lambda: one.begin([0.0, 0.0, 1e300]), ValueError, "position"),
        (lambda: one.begin(attitude=[1.0, 1.0, 1.0, 1.0]), ValueError, "length of attitude is 2"),
        (lambda: one.run(good), ValueError, "2 axes"),
        (lambda: one.run(np.zeros((3, 13))), ValueError, r"\[3, 14\]"),
        (lambda: one.run("abc"), TypeError, "readings is a str"),
        (lambda: one.run(np.zeros((3, 14)), truth=truth[:2]), ValueError, "truth has the shape"),
        (lambda: one.run(np.zeros((3, 14)), truth=truth[:, :12].copy()), ValueError, "width of truth"),
        (lambda: one.run(np.zeros((3, 14)), truth=spoilt), ValueError, r"truth\[2\]: velocity"),
        (lambda: one.squared_error([0.0] * 3, [0.0] * 3, [1.0] * 3), ValueError, "attitude"),
        (lambda: many.step(good), ValueError, r"\[3, 14\]"),
        (lambda: many.step(np.zeros((3, 14)), [True] * 3), TypeError, "mask is a list"),
        (lambda: many.step(np.zeros((3, 14)), np.ones(2, bool)), ValueError, "mask has the shape"),
        (lambda: many.begin(np.zeros((3, 2))), ValueError, r"\[3, 3\]"),
        (lambda: many.begin([0.0] * 3), TypeError, "position is a list"),
        (lambda: many.begin(attitude=level * np.array([[1.0], [1.0], [3.0]])), ValueError, "body 2: attitude"),
        (lambda: omnidrones.StateEstimatorBatch(PROMPT, 0, 0.002), ValueError, "1 or more"),
        (lambda: omnidrones.StateEstimatorBatch(PROMPT, -1, 0.002), OverflowError, "negative"),
        (lambda: omnidrones.StateEstimatorBatch(PROMPT, 2**62, 0.002), ValueError, "number of estimators"),
    ]:
        with pytest.raises(error, match=words):
            call()
    assert np.array_equal(one.covariance, before[0]) and np.array_equal(many.covariance, before[1])
    # numbers of those that do not begin are not looked at
    many.begin(attitude=level * np.array([[1.0], [1.0], [np.nan]]), mask=np.array([True, True, False]))
    for wild in (np.nan, np.inf, -np.inf, 1e308):
        one.run(np.full((50, 14), wild))
        for _ in range(50):
            many.step(np.full((3, 14), wild))
    for own in (one, many):
        assert np.isfinite(own.position).all() and np.isfinite(own.covariance).all() and own.saturated > 0
    assert len(one.run(np.zeros((0, 14)))) == 0


def doubled(dt=0.1):
    """Masses at rest on lines: places are measured."""
    A = np.array([[1.0, dt, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, dt], [0.0, 0.0, -0.3, 0.9]])
    B = np.array([[0.0, 0.0], [dt, 0.0], [0.0, 0.0], [0.0, dt]])
    C = np.array([[1.0, 0.0, 0.2, 0.0], [0.0, 0.0, 1.0, 0.0]])
    return A, B, C, np.diag([1e-4, 1e-2, 1e-4, 2e-2]), np.array([[0.1, 0.02], [0.02, 0.3]])


def test_the_steady_filter_solves_the_equation_that_scipy_solves():
    linalg = pytest.importorskip("scipy.linalg")
    A, B, C, W, V = doubled()
    own = omnidrones.steady_kalman(omnidrones.StateSpace(A, B, C, dt=0.1), W, V)
    P = linalg.solve_discrete_are(A.T, C.T, W, V)
    L = P @ C.T @ np.linalg.inv(C @ P @ C.T + V)
    assert np.abs(own.covariance - P).max() < 1e-12 and np.abs(own.gain - L).max() < 1e-10 and own.residual < 1e-12
    assert np.abs(own.corrected - (np.eye(4) - L @ C) @ P).max() < 1e-12
    assert np.abs(np.sort_complex(own.poles) - np.sort_complex(np.linalg.eigvals(A - A @ L @ C))).max() < 1e-9
    # dx/dt, densities
    F = np.array([[0.0, 1.0], [-2.0, -0.1]])
    H = np.array([[1.0, 0.0]])
    own = omnidrones.steady_kalman(omnidrones.StateSpace(F, C=H), np.diag([0.0, 0.5]), np.eye(1))
    P = linalg.solve_continuous_are(F.T, H.T, np.diag([0.0, 0.5]), np.eye(1))
    assert np.abs(own.covariance - P).max() < 1e-12 and np.abs(own.gain - P @ H.T).max() < 1e-12
    assert np.array_equal(own.covariance, own.corrected)


def test_a_filter_whose_covariance_goes_along_comes_to_the_steady_one(rng):
    A, B, C, W, V = doubled()
    steady = omnidrones.steady_kalman(omnidrones.StateSpace(A, B, C, dt=0.1), W, V)
    filter = omnidrones.KalmanFilter(np.zeros(4), np.eye(4))
    x, squared, innovations = rng.normal(size=4), [], []
    for k in range(600):
        u = np.array([np.sin(0.1 * k), 1.0])
        filter.predict(A, W, B=B, u=u)
        x = A @ x + B @ u + rng.multivariate_normal(np.zeros(4), W)
        if k == 599:
            assert np.abs(filter.covariance - steady.covariance).max() < 1e-10
        y = C @ x + rng.multivariate_normal(np.zeros(2), V)
        told = filter.correct(y, C, V)
        assert set(told) == {"value", "covariance", "squared"}
        squared.append(filter.squared_error(x))
        innovations.append(told["squared"])
        assert told["squared"] == pytest.approx(told["value"] @ np.linalg.solve(told["covariance"], told["value"]))
    assert np.abs(filter.covariance - steady.corrected).max() < 1e-10
    # chi-squared with four degrees of freedom, of errors that last, and with two, of white ones; 4.5 and 2.1
    assert 2.5 < np.mean(squared) < 5.5 and 1.7 < np.mean(innovations) < 2.3
    seen = omnidrones.KalmanFilter(np.zeros(4), np.eye(4))
    seen.correct(np.array([3.0, 0.0]), C, V, D=np.array([[3.0], [0.0]]), u=np.ones(1))
    assert np.array_equal(seen.state, np.zeros(4))


def test_the_loop_of_lqg_has_the_poles_of_feedback_and_of_filter():
    A, B, C, W, V = doubled()
    model = omnidrones.StateSpace(A, B, C, dt=0.1, states=["a [m]", "b", "c", "d"], inputs=["u", "v [N]"])
    feedback, kalman = omnidrones.lqr(model, np.eye(4), np.eye(2)), omnidrones.steady_kalman(model, W, V)
    own = omnidrones.lqg(model, kalman, feedback)
    assert np.array_equal(own.A, omnidrones.lqg(model, kalman, feedback.gain).A)
    assert own.states == model.states == ["a [m]", "b", "c", "d"] and own.outputs == model.inputs == ["u", "v [N]"]
    closed = np.block([[A + B @ own.D @ C, B @ own.C], [own.B @ C, own.A]])
    poles = np.concatenate([feedback.poles, kalman.poles])
    assert np.abs(np.sort_complex(np.linalg.eigvals(closed)) - np.sort_complex(poles)).max() < 1e-8
    assert np.abs(np.linalg.eigvals(closed)).max() < 1
    # a vehicle, of which place and attitude are measured
    hover = omnidrones.linearise("hummingbird").model
    C = np.eye(16)[[0, 1, 2, 6, 7, 8]]
    model = omnidrones.StateSpace(hover.A, hover.B, C, dt=hover.dt, states=hover.states, inputs=hover.inputs)
    kalman = omnidrones.steady_kalman(model, 1e-6 * np.eye(16), 1e-4 * np.eye(6))
    own = omnidrones.lqg(model, kalman, omnidrones.lqr(model, np.eye(16), np.eye(4)))
    assert own.outputs == hover.inputs and np.abs(kalman.poles).max() < 1


def test_a_system_of_ones_own_has_what_was_left_out():
    A = np.array([[0.5, 0.1], [0.0, 0.9]])
    own = omnidrones.StateSpace(A, dt=0.1)
    assert np.array_equal(own.A, A) and np.array_equal(own.C, np.eye(2)) and not own.B.any() and own.D.shape == (2, 1)
    assert own.dt == 0.1 and omnidrones.StateSpace(A).dt is None and own.states == ["x0", "x1"]


def test_models_and_matrices_that_are_none_are_refused_with_their_names():
    A, B, C, W, V = doubled()
    model = omnidrones.StateSpace(A, B, C, dt=0.1)
    kalman = omnidrones.steady_kalman(model, W, V)
    filter = omnidrones.KalmanFilter(np.zeros(4), np.eye(4))
    none = np.full((4, 4), np.nan)
    for call, error, words in [
        (lambda: omnidrones.StateSpace(A[:3]), ValueError, "size of A"),
        (lambda: omnidrones.StateSpace(A, B[:3]), ValueError, "size of B"),
        (lambda: omnidrones.StateSpace(A, B, C, np.zeros((1, 2))), ValueError, "size of [CD]"),
        (lambda: omnidrones.StateSpace(none), ValueError, r"A\[0, 0\]"),
        (lambda: omnidrones.StateSpace(np.zeros((0, 0))), ValueError, "size of A"),
        (lambda: omnidrones.StateSpace("A"), TypeError, "A is a str"),
        (lambda: omnidrones.StateSpace(A.tolist()), TypeError, "A is a list"),
        (lambda: omnidrones.StateSpace(A, dt=-0.1), ValueError, "dt"),
        (lambda: omnidrones.StateSpace(A, states=["a"]), ValueError, "names of states"),
        (lambda: omnidrones.steady_kalman(model, W[:3, :3].copy(), V), ValueError, "W has the shape"),
        (lambda: omnidrones.steady_kalman(model, none, V), ValueError, "W"),
        (lambda: omnidrones.steady_kalman(model, W, -V), ValueError, "covariance V"),
        (lambda: omnidrones.steady_kalman(model, W, V + [[0.0, 1.0], [0.0, 0.0]]), ValueError, "symmetric"),
        (lambda: omnidrones.steady_kalman(model, "W", V), TypeError, "W is a str"),
        (lambda: omnidrones.steady_kalman("model", W, V), TypeError, "StateSpace"),
        (lambda: omnidrones.steady_kalman(omnidrones.StateSpace(A, B, C[1:], dt=0.1), W, V[1:, 1:].copy()), ValueError, "x0"),
        (lambda: omnidrones.lqg(model, kalman, np.zeros((2, 3))), ValueError, "gain has the shape"),
        (lambda: omnidrones.lqg(model, kalman, "K"), TypeError, "gain is a str"),
        (lambda: omnidrones.lqg(omnidrones.StateSpace(A[:2, :2].copy(), dt=0.1), kalman, np.zeros((1, 2))), ValueError, "filter"),
        (lambda: omnidrones.lqg(omnidrones.StateSpace(A, B, C, np.ones((2, 2)), dt=0.1), kalman, np.zeros((2, 4))), ValueError, "D"),
        (lambda: omnidrones.KalmanFilter(np.zeros(3), np.eye(4)), ValueError, "covariance has the shape"),
        (lambda: omnidrones.KalmanFilter(np.full(4, np.nan), np.eye(4)), ValueError, "state"),
        (lambda: omnidrones.KalmanFilter(np.zeros(4), -np.eye(4)), ValueError, "covariance P"),
        (lambda: filter.predict(A, none), ValueError, "W"),
        (lambda: filter.predict(A, W, B=B), ValueError, "together"),
        (lambda: filter.predict(A, W, B=B, u=np.zeros(3)), ValueError, "B has the shape"),
        (lambda: filter.correct(np.zeros(3), C, V), ValueError, "C has the shape"),
        (lambda: filter.correct(np.full(2, np.nan), C, V), ValueError, "y"),
        (lambda: filter.correct(np.zeros(2), C, -10 * np.eye(2)), ValueError, "positive definite"),
        (lambda: filter.correct("y", C, V), TypeError, "y is a str"),
        (lambda: filter.squared_error(np.zeros(3)), ValueError, "truth has the shape"),
    ]:
        with pytest.raises(error, match=words):
            call()
    assert np.array_equal(filter.state, np.zeros(4)) and np.array_equal(filter.covariance, np.eye(4))
