"""A trajectory of least cost and its feedback, and model predictive control in a loop of our own: NumPy alone."""

import numpy as np

import omnidrones

there = omnidrones.optimise(
    {
        "vehicle": "hummingbird",
        "steps": 40,
        "dt": 0.025,
        "goal": {"position": [1.0, 0.0, 0.5]},
        "stage": {"velocity": 0.1, "input": 1.0},
        "terminal": {"position": 1000.0, "velocity": 100.0, "attitude": 100.0},
        "gate": [{"time": 0.5, "position": [0.5, 0.3, 0.4]}],
    }
)
print(there, there.states[-1, :3], f"{len(there.iterations['cost'])} iterations, gains {there.gains.shape}")

env = omnidrones.make("Hover", 1, seed=0, control="rotor")
env.reset()
mpc = omnidrones.Mpc("hummingbird", env.spec.dt, stages=15)
reference = {"kind": "hover", "position": [1.0, 0.0, 2.0]}
for t in range(100):
    commands = mpc.tick(env.states()[0].astype(np.float64), reference, t * env.spec.dt)
    env.step(commands.astype(np.float32).reshape(1, 1, 4))
told = mpc.report()
print(mpc, f"at {env.states()[0, :3]} after {told['ticks']} plans, {1e3 * np.median(told['times']):.2f} ms each")
