"""A batch under our own controller, a training from random weights, a flight and its linear model: NumPy alone."""

import omnidrones

env = omnidrones.make("Hover", 64, seed=0, autoreset="disabled", horizon=200)
env.reset()
controller = omnidrones.Controller(env)
for _ in range(200):
    env.step(controller(env))
print(f"our controller ends {env.column('position_error').mean():.3f} m from the point")

run = omnidrones.train("Hover", watch=lambda p: p.update % 200 or print(f"update {p.update}: loss {p.loss:.3f}"))
print(f"learnt in {run.seconds:.1f} s: {run.evaluation['success']:.1%} of unseen starts")

flight = omnidrones.fly("hummingbird", duration=10.0)
print(f"a lemniscate within {1e3 * flight.summary()['rmse']:.0f} mm RMSE")

model = omnidrones.linearise("hummingbird", velocity=[5.0, 0.0, 0.0]).model
print(model, model.states[:3], model.inputs)
