"""A task of our own: a crane that flies. A ball on a bar is taken from place to place, and must not swing. NumPy alone.

python python/examples/payload_task.py [updates of APG] [figure.svg]

By default, seed 0: 99.9 % of 1024 unseen flights end with the ball within 0.15 m of its place and the bar within 0.1 rad of the vertical, 16 mm
off on average, after 27 s of processor time. The figure is a flight: how far the ball is off, and its swing.
"""

import sys

import numpy as np

import omnidrones
from omnidrones import Robot, Setting, Success, functions

LENGTH = 0.8


class Crane(omnidrones.Task):
    """Take a ball on a bar from place to place without a swing.

    q position of the ball, t where it is to be, s angle of the bar from the vertical. t jumps every {pause} steps on average.
    """

    horizon = 500
    reach = Setting([[-1.0, 1.0], [-1.0, 1.0], [0.8, 1.6]], "m, world", "where t is, lowest and highest per axis", domain="ordered")
    pause = Setting(160, "steps", "between jumps of t on average")
    success_rule = Success().below("ball_error", 0.15).below("swing", 0.1)

    def robot(self):
        robot = Robot.of_task("PayloadHover", length=[LENGTH, LENGTH], vehicle=self.vehicle)
        self.bar = robot.bodies.index("bar")
        return robot

    def ball(self, view):
        return view.body(self.bar).point([0.0, 0.0, -LENGTH])

    def way(self, view):
        return view.goal_field("target") - self.ball(view)[0]

    def lean(self, view):
        """sin of s along x and y."""
        return view.body(self.bar).up[:2]

    def place(self, start):
        """A new place, and when the next one comes: none in the last two seconds, so that it can be reached."""
        later = start.event_at + 0.5 * self.pause + start.task.below(self.pause)
        start.event_at = np.where(later < self.horizon - 125, later, -1.0)
        return start.task.uniform(*self.reach.T)

    def start(self, start):
        start.event_at = 0.0
        start.goal.field("target", "m, world", "t", self.place(start))
        position = start.position(self.reach)
        start.place(position + [0.0, 0.0, LENGTH], start.attitude(0.2))

    def event(self, start):
        start.goal[0:3] = self.place(start)

    def ideal(self, start):
        start.goal.field("target", "m, world", "t", [0.0, 0.0, 1.0])
        start.place([0.0, 0.0, 1.0 + LENGTH])

    def observe(self, view, agent, out):
        bar = view.body(self.bar)
        out.field("way", "m, world", "t - q", self.way(view))
        out.observe_drone(view)
        out.field("bar", "-, world", "axis of the bar", bar.up)
        out.field("swinging", "rad/s, world", "angular velocity of the bar", bar.angular_velocity)

    def reward(self, view, terms):
        near = functions.rational_kernel(1.5, functions.squared_norm(self.way(view)))
        calm = functions.rational_kernel(6.0, functions.squared_norm(self.lean(view)))
        terms.term("near", "1/(1 + (1.5 |t - q|)^2)", 1.0, near)
        terms.term("calm", "near/(1 + (6 sin s)^2)", 1.0, near * calm)

    def loss(self, view, loss):
        drone, (_, velocity) = view.drone(), self.ball(view)
        loss.add("|t - q|", functions.smooth_norm(self.way(view), 0.1))
        loss.add("0.05 |v_q|^2", 0.05 * functions.pseudo_huber(velocity, 5.0))
        loss.add("sin^2 s", 2.0 * functions.squared_norm(self.lean(view)))
        loss.add("0.005 |w|^2", 0.005 * functions.pseudo_huber(drone.angular_velocity, 10.0))

    def ends(self, view, ends):
        low = np.minimum(self.ball(view)[0][2], view.drone().position[2])
        ends.when("crash", "drone or ball below 0.2 m", low < 0.2)
        ends.when("far", "|t - q| > 5 m", functions.squared_norm(self.way(view)) > 25.0)

    def metrics(self, view, out):
        out.metric("ball_error", "m", functions.norm(self.way(view)))
        out.metric("swing", "rad", functions.safe_arccos(view.body(self.bar).up[2]))


updates = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
settings = {"updates": updates, "n_env": 64, "horizon": 96}
run = omnidrones.train(Crane, algorithm="apg", seed=0, threads=2, apg=settings)
told = run.evaluation
print(f"{run.seconds:.0f} s: {told['success']:.1%} of unseen flights end with the ball at its place, last error {told['final_error']:.3f} m")
if len(sys.argv) > 2:
    env = omnidrones.make(Crane, 1, seed=3, autoreset="disabled")
    env.reset()
    rows = []
    for _ in range(env.spec.horizon):
        env.step(run.policy(env.observation))
        rows.append([env.column("ball_error")[0], np.degrees(env.column("swing")[0])])
    time, (error, swing) = env.spec.dt * np.arange(1, len(rows) + 1), np.transpose(rows)
    curves = {"ball to its place [m]": (time, error), "swing [10 deg]": (time, swing / 10.0)}
    omnidrones.plot(curves, title="A crane that flies", x="time [s]").save(sys.argv[2])
