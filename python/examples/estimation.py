"""Fly on what sensors read, filter the log again with other settings, and see whether the filter knows how far it is off: NumPy alone.

`python estimation.py error.svg` draws it.
"""

import sys

import numpy as np

import omnidrones

SENSORS = [
    {"name": "imu", "kind": "imu", "preset": "bmi088"},
    {
        "name": "cameras",
        "kind": "motion_capture",
        "preset": "optical",
        "faults": [
            {"kind": "lost", "from": 2.0, "until": 3.0},
            {"kind": "offset", "from": 4.0, "until": 4.2, "by": [0.5]},
        ],
    },
]

flight = omnidrones.fly("hummingbird", duration=6.0, sensors=SENSORS, estimator="ekf")
on_board = flight.estimates
print(on_board, {name: f"{value:.2e}" for name, value in on_board.rms.items()}, on_board.records[0])

# a log is rows of readings, `dt` apart; this one knows the truth
states, readings = flight.states(), flight.readings()
filter = omnidrones.StateEstimator(SENSORS, 0.002, position=0.01, velocity=0.01)
filter.begin(states[0, :3], states[0, 3:6], states[0, 6:10], states[0, 10:13])
again = filter.run(readings, truth=states)
print(filter, again, {name: f"{value:.1e}" for name, value in filter.biases.items()})

time, error, known = flight.columns()["time [s]"], again.errors[:, 0], 3 * again.deviations[:, 0]
print(f"within 3 sigma {(np.abs(error) <= known).mean():.1%}, sigma {known.min() / 3:.1e} m, without cameras up to {known.max() / 3:.1e} m")
if len(sys.argv) > 1:
    curves = {"error": (time, error), "+3 sigma": (time, known), "-3 sigma": (time, -known)}
    omnidrones.plot(curves, title="x: error and what the filter knows", x="time [s]", y="[m]").save(sys.argv[1])
