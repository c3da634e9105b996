"""Tasks of the library, written again in Python: their tests hold them to its programs."""

from functools import cached_property

import numpy as np
import omnidrones as od
from omnidrones import functions as f
from omnidrones import Setting

ANY_YAW = (0.0, 2.0 * np.pi)
LEVEL = [1.0, 0.0, 0.0, 0.0]

# what several of them share


class StartAttitude:
    """Attitudes that episodes start with."""

    start_tilt = Setting(0.2 * np.pi, "rad", "largest roll and pitch of starts", domain="not_negative")
    start_yaw = Setting(list(ANY_YAW), "rad", "yaw of starts, lowest and highest", domain="ordered")
    start_ease = Setting(1.0, "-", "share of these ranges at difficulty 0, about their middles", domain="share")

    def draw_attitude(self, start):
        share = eased(self.start_ease, start.difficulty)
        return start.attitude(share * self.start_tilt, narrowed(self.start_yaw, share))


class StartRange(StartAttitude):
    """Places and attitudes that episodes start with."""

    start_position = Setting([[-2.5, 2.5], [-2.5, 2.5], [1.0, 2.5]], "m, world",
                             "position of starts, lowest and highest per axis", domain="ordered")

    def draw(self, start):
        share = eased(self.start_ease, start.difficulty)
        return start.position(narrowed(self.start_position, share)), self.draw_attitude(start)


class PoseReward:
    """Weights of the terms that most rewards have."""

    reward_pose = Setting(1.0, "-", "weight of the term pose", domain="not_negative")
    reward_up = Setting(1.0, "-", "weight of the term up", domain="not_negative")
    reward_spin = Setting(1.0, "-", "weight of the term spin", domain="not_negative")
    reward_effort = Setting(0.1, "-", "weight of the term effort", domain="not_negative")

    def write_effort(self, view, terms):
        terms.term("effort", "{×reward_effort}e^{−e}", self.reward_effort, self.reward_effort * np.exp(-view.effort()))


class MotionLoss:
    """How training losses weigh distance and motion."""

    loss_radius = Setting(0.1, "m", "δ in the loss's distance √(d² + δ²)", domain="positive")
    loss_velocity = Setting(0.02, "s²/m", "weight of the velocity in the loss", domain="not_negative")
    loss_rate = Setting(0.005, "m s²/rad²", "weight of the angular velocity in the loss", domain="not_negative")


class PoseLoss(MotionLoss):
    """And axes."""

    loss_turn = Setting(0.3, "m", "weight of the squared errors of axes in the loss", domain="not_negative")


def eased(ease, difficulty):
    return 1.0 - (1.0 - ease) * (1.0 - difficulty)


def narrowed(range, share):
    low, high = range[..., 0], range[..., 1]
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * share
    return np.stack([middle - half, middle + half], axis=-1)


def nearer(x, limit):
    return f.squared_norm(x) < limit * limit


def farther(x, limit):
    return f.squared_norm(x) > limit * limit


def latch(flag, now):
    return np.where(now, 1.0, flag)


def along_the_course(start, along, begin, end, clear):
    """In the share `along` anywhere on the way, but no nearer than `clear` to the obstacles at x = 0."""
    if along == 0.0:
        return begin
    moves, share = start.reset.sometimes(along)
    there = begin + share * (end - begin)
    beside = np.where(there[0] < 0.0, -clear, clear)
    there[0] = np.where(np.abs(there[0]) < clear, beside, there[0])
    return np.where(moves, there, begin)


class Hover(od.Task, StartRange, PoseReward, PoseLoss):
    """Fly to a point and hold it, with a heading."""

    target = Setting([0.0, 0.0, 2.0], "m, world", "p_t")
    min_height = Setting(0.2, "m", "lower is a crash")
    max_distance = Setting(4.0, "-", "largest d", domain="positive")
    success_distance = Setting(0.1, "m", "position error of a success", domain="positive")
    success_alignment = Setting(0.95, "-", "cosine of the angle between asked and flown axes above which a success is")
    pose_scale = Setting(1.2, "1/m", "how steeply r_p falls", domain="not_negative")
    loss_up = Setting(0.0, "m", "weight of the squared error of u in the loss", domain="not_negative")
    loss_drives = Setting(0.01, "m s²/rad²", "weight of the rates of drives in the loss", domain="not_negative")
    about = (
        "p drone, v, ω velocity and angular velocity (world), h = R e_x heading, u = R e_z, e = Σ s effort, k steps. Target: p_t = {target} m, "
        "heading h_t at any yaw. Start: p uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, "
        "at rest, d ≤ {max_distance}. d = ‖(p_t − p, h_t − h)‖."
    )

    def error(self, view):
        return self.target - view.drone().position

    def heading_error(self, view):
        return view.goal_field("target_heading") - view.drone().heading

    def both(self, view):
        return np.concatenate([self.error(view), self.heading_error(view)])

    def set_heading(self, start, heading):
        start.goal.field("target_heading", "-, world", "h_t", heading, low=-1.0, high=1.0)

    def start(self, start):
        yaw = start.task.uniform(*ANY_YAW)
        heading = np.stack([np.cos(yaw), np.sin(yaw), 0.0])
        self.set_heading(start, heading)

        def attempt():
            position, attitude = self.draw(start)
            start.place(position, attitude)
            h = f.rotate(attitude, [1.0, 0.0, 0.0])
            return ~farther(np.concatenate([self.target - position, heading - h]), self.max_distance)

        start.again(100, attempt)

    def ideal(self, start):
        self.set_heading(start, [1.0, 0.0, 0.0])
        start.place(self.target)

    def observe(self, view, agent, out):
        out.field("target", "m, world", "p_t − p", self.error(view))
        out.observe_drone(view)
        out.field("heading_error", "-, world", "h_t − h", self.heading_error(view), low=-2.0, high=2.0)
        out.observe_clock(view)

    def reward(self, view, terms):
        drone = view.drone()
        pose = f.rational_kernel(self.pose_scale, f.squared_norm(self.both(view)))
        terms.term("pose", "{×reward_pose}r_p, r_p = 1/(1 + ({×pose_scale}d)²)", self.reward_pose, self.reward_pose * pose)
        terms.term("up", "{×reward_up}r_p ((u_z + 1)/2)²", self.reward_up, self.reward_up * pose * f.upright(drone.up))
        spin = self.reward_spin * pose * f.still(drone.angular_velocity)
        terms.term("spin", "{×reward_spin}r_p/(1 + ω_z²)", self.reward_spin, spin)
        self.write_effort(view, terms)

    def ends(self, view, ends):
        ends.when("crash", "z < {min_height} m", view.drone().position[2] < self.min_height)
        ends.when("far", "d > {max_distance}", farther(self.both(view), self.max_distance))

    def metrics(self, view, out):
        drone = view.drone()
        out.metric("position_error", "m", f.norm(self.error(view)))
        out.metric("heading_alignment", "-", drone.heading @ view.goal[0:3])
        out.metric("uprightness", "-", drone.up[2])
        out.metric("throttle_difference", "-", view.throttle_difference())

    def success(self, view):
        drone, alignment = view.drone(), self.success_alignment
        near = nearer(self.error(view), self.success_distance)
        return near & (alignment < drone.heading @ view.goal[0:3]) & (alignment < drone.up[2])

    def success_rule(self):
        rule = od.Success().below("position_error", self.success_distance)
        return rule.above("heading_alignment", self.success_alignment).above("uprightness", self.success_alignment)

    def loss(self, view, loss):
        drone = view.drone()
        loss.add("√(‖p_t − p‖² + {loss_radius}²)", f.smooth_norm(self.error(view), self.loss_radius))
        loss.add("{×loss_velocity}h₅(v)", self.loss_velocity * f.pseudo_huber(drone.velocity, 5.0))
        loss.add("{×loss_rate}h₁₀(ω)", self.loss_rate * f.pseudo_huber(drone.angular_velocity, 10.0))
        loss.add("{×loss_turn}‖h_t − h‖²", self.loss_turn * f.squared_norm(self.heading_error(view)))


class PayloadTrack(od.Task, od.PathSettings, StartAttitude, PoseReward, MotionLoss):
    """Lead a slung ball along a lemniscate."""

    length = Setting([1.0, 1.0], "m", "L of the bar, lowest and highest; drawn once per environment", domain="positive_ordered")
    ball_share = Setting([0.2, 0.3], "-", "m_q over the vehicle's mass, lowest and highest", domain="positive_ordered")
    bar_mass = Setting([0.001, 0.001], "kg", "of the bar, lowest and highest", domain="positive_ordered")
    reset_distance = 0.8
    path_rate = [0.7, 1.0]
    start_tilt = 0.1 * np.pi
    success_distance = Setting(0.3, "m", "position error of a success", domain="positive")
    success_time = Setting(2.0, "s", "for which the error of a success has been as small", domain="not_negative")
    pose_scale = Setting(1.6, "1/m", "how steeply r_p falls", domain="not_negative")
    horizon = 600
    min_height = Setting(0.1, "m", "lower is a crash")
    reward_up = reward_spin = 0.5
    about = (
        "p drone, q ball, u = R e_z, ω angular velocity of the drone (world), e = Σ s effort, k steps, v_q = q̇, ω_b angular velocity of the "
        "bar, p_ref(k) the path, a lemniscate of vertical part c within ±{path_vertical}, scale S within {path_scale} m and rate |w| within "
        "{path_rate} rad/s about {path_origin} m, d = ‖p_ref(k) − q‖. Ball {ball_share} of the vehicle's mass, bar {bar_mass} kg. Start: p one "
        "bar above the path, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, the bar along the drone's −z, at rest."
    )
    # numbers of the load in the goal, which the path follows
    LOAD = 2

    @cached_property
    def path(self):
        return od.TrackPath.of(self)

    def robot(self):
        return od.Robot.of_task("PayloadTrack", vehicle=self.vehicle, length=self.length, ball_share=self.ball_share, bar_mass=self.bar_mass)

    def draw_load(self, start):
        vehicle = od.Vehicle(self.vehicle).mass
        length = start.once.uniform(*self.length)
        ball = start.task.uniform(*self.ball_share) * vehicle
        bar = start.task.uniform(*self.bar_mass)
        nominal = start.inertial("bar").mass
        middle, end = np.stack([0.0, 0.0, -0.5 * length]), np.stack([0.0, 0.0, -1.0 * length])
        load = od.Inertial.capsule(bar, 0.01, length, middle).joined(od.Inertial.ball(ball, 0.04, end))
        start.set_inertial("bar", *load)
        start.spin_up(np.sqrt((vehicle + load.mass) / (vehicle + nominal)))
        start.goal.field("length", "m", "L", length)
        start.goal.field("ball_mass", "kg", "m_q", ball)
        return self.path.draw(start)

    def drone_of(self, start, ball):
        return np.stack([ball[0], ball[1], ball[2] - start.goal[0] * -1.0])

    def start(self, start):
        first = self.draw_load(start)
        position = self.drone_of(start, first)

        def attempt():
            attitude = self.draw_attitude(start)
            start.place(position, attitude)
            ball = position + f.rotate(attitude, np.stack([0.0, 0.0, start.goal[0] * -1.0]))
            return nearer(first - ball, self.reset_distance)

        start.again(100, attempt)
        self.path.join(start, self.LOAD, lever=start.goal[0] * 1.0)

    def ideal(self, start):
        start.place(self.drone_of(start, self.draw_load(start)))

    def ball(self, view):
        """Place and velocity."""
        end = np.stack([0.0, 0.0, -1.0 * view.goal[0]])
        return view.body("bar").point(end)

    def error(self, view):
        return self.path.at(view.goal[self.LOAD :], view.step) - self.ball(view)[0]

    def observe(self, view, agent, out):
        ball, velocity = self.ball(view)
        out.field("drone_from_ball", "m, world", "p − q", view.drone().position - ball)
        out.field("path", "m, world", "p_ref(k + 5i) − q for i = 0 … 5")
        for i in range(6):
            out.write(self.path.at(view.goal[self.LOAD :], view.step + 5.0 * i) - ball)
        out.observe_drone(view)
        out.field("ball_velocity", "m/s, world", "v_q = q̇", velocity)
        out.field("bar_angular_velocity", "rad/s, world", "ω_b", view.body("bar").angular_velocity)
        out.observe_clock(view)

    def reward(self, view, terms):
        drone = view.drone()
        pose = f.exponential_kernel(self.pose_scale, self.error(view))
        formula = "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}"
        terms.term("pose", formula, self.reward_pose, self.reward_pose * pose, smoothness="piecewise")
        up = self.reward_up * pose * f.rational_kernel(1.0, np.square(1.0 - drone.up[2]))
        terms.term("up", "{×reward_up}r_p/(1 + (1 − u_z)²)", self.reward_up, up, smoothness="piecewise")
        spin = self.reward_spin * pose * f.still(drone.angular_velocity)
        terms.term("spin", "{×reward_spin}r_p/(1 + ω_z²)", self.reward_spin, spin, smoothness="piecewise")
        self.write_effort(view, terms)

    def ends(self, view, ends):
        ends.when("crash", "z < {min_height} m", view.drone().position[2] < self.min_height)
        ends.when("far", "d > {reset_distance} m", self.path.far(view.goal[self.LOAD :], self.error(view)))

    def metrics(self, view, out):
        out.metric("position_error", "m", f.norm(self.error(view)))
        out.metric("uprightness", "-", view.drone().up[2])
        out.metric("throttle_difference", "-", view.throttle_difference())

    def success(self, view):
        return nearer(self.error(view), self.success_distance)

    def success_rule(self):
        return od.Success().below("position_error", self.success_distance).held(self.success_time)

    def loss(self, view, loss):
        slip = self.path.velocity(view.goal[self.LOAD :], view.step) - self.ball(view)[1]
        loss.add("√(d² + {loss_radius}²)", f.smooth_norm(self.error(view), self.loss_radius))
        loss.add("{×loss_velocity}h₅(ṗ_ref − v_q)", self.loss_velocity * f.pseudo_huber(slip, 5.0))
        loss.add("{×loss_rate}h₁₀(ω)", self.loss_rate * f.pseudo_huber(view.drone().angular_velocity, 10.0))


class FlyThrough(od.Task, StartRange, PoseReward, MotionLoss):
    """Fly through a gate that slides sideways."""

    gate_position = Setting([0.0, 0.0, 2.0], "m, world", "of the gate at rest")
    gate_offset = Setting(1.0, "m", "largest offset of the gate at the start, along y", domain="not_negative")
    gate_ease = Setting(1.0, "-", "factor of that offset at difficulty 0", domain="not_negative")
    gate_damping = Setting(1.0, "N s/m", "of the gate's slide", domain="not_negative")
    gate_aperture = Setting(0.5, "m", "farther beside the gate's middle along y or z it is missed", domain="positive")
    reset_on_collision = Setting(False, "", "whether touch ends the episode")
    target = Setting([[1.5, 2.5], [-1.0, 1.0], [1.5, 2.5]], "m, world", "p_t, lowest and highest per axis", domain="ordered")
    start_position = [[-2.5, -2.0], [-1.5, 1.5], [1.5, 2.5]]
    start_yaw = [0.0, 0.0]
    start_along = Setting(0.0, "-", "share of episodes that begin anywhere on the way to the target", domain="share")
    min_height = Setting(0.2, "m", "lower is a crash")
    max_height = Setting(2.5, "m", "higher ends the episode")
    max_side = Setting(2.0, "m", "farther along y ends the episode", domain="positive")
    max_distance = Setting(6.0, "m", "farther from the target ends the episode", domain="positive")
    success_distance = Setting(0.2, "m", "position error of a success", domain="positive")
    pose_scale = Setting(1.0, "1/m", "how steeply r_p falls", domain="not_negative")
    pose_floor = Setting(0.3, "-", "what up and spin are worth far from the target", domain="not_negative")
    reward_up = reward_spin = 0.5
    reward_gate = Setting(0.5, "-", "weight of the term gate", domain="not_negative")
    loss_gate = Setting(1.0, "1/m", "weight of the way to the gate's middle in the loss", domain="not_negative")
    loss_clearance = Setting(0.5, "m", "weight of the clearance in the loss", domain="not_negative")
    about = (
        "p drone, g, v_g the gate's middle and its velocity, v, ω velocity and angular velocity of the drone (world), u = R e_z, e = Σ s "
        "effort, k steps, d = ‖p_t − p‖. The gate stands at {gate_position} m, its opening has half sizes of 0.616 × 0.561 m; it starts within "
        "±{gate_offset} m along y and swings back on a spring (4 kg, 3 N/m). Target: p_t uniform in {target} m. Start: p uniform in "
        "{start_position} m, roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest."
    )
    # farther beside its middle the term gate falls no further
    FAR_BESIDE = 5.0

    @cached_property
    def gate(self):
        return od.Gate(position=self.gate_position)

    def robot(self):
        return od.Robot.of_task("FlyThrough", vehicle=self.vehicle, gate_position=self.gate_position, gate_damping=self.gate_damping)

    def frame(self, view):
        return view.body("gate/frame")

    def way(self, view):
        return self.frame(view).position - view.drone().position

    def error(self, view):
        return view.goal[0:3] - view.drone().position

    def clearance(self, view):
        frame = self.frame(view)
        return view.clearance(self.gate.bars(frame.position, frame.attitude), self.gate.radius)

    def set_target(self, start, target):
        start.goal.field("target", "m, world", "p_t", target)

    def start(self, start):
        target = start.task.uniform(self.target[:, 0], self.target[:, 1])
        self.set_target(start, target)
        offset = start.task.uniform(-self.gate_offset, self.gate_offset)
        start.set_joint("gate/slide", eased(self.gate_ease, start.difficulty) * offset)
        position, attitude = self.draw(start)
        position = along_the_course(start, self.start_along, position, target, 0.5)
        start.place(position, attitude)
        # what begins behind the gate has crossed it
        start.task_state[0] = np.where(position[0] > self.gate_position[0], 1.0, 0.0)

    def ideal(self, start):
        target = 0.5 * (self.target[:, 0] + self.target[:, 1])
        self.set_target(start, target)
        start.place(target)

    def remember(self, view, out):
        way, crossed = self.way(view), view.task_state[0]
        beyond = way[0] < 0.0
        inside = (np.abs(way[1]) < self.gate_aperture) & (np.abs(way[2]) < self.gate_aperture)
        missed = beyond & ~inside & (crossed < 0.5)
        out.field("crossed", "-", "1 once x > 0", latch(crossed, beyond))
        out.field("missed", "-", "1 in the first step with x > 0 beside the gate", np.where(missed, 1.0, 0.0))
        reached = latch(view.task_state[2], nearer(self.error(view), self.success_distance))
        out.field("reached", "-", "1 once d < {success_distance} m", reached)

    def observe(self, view, agent, out):
        out.observe_drone(view)
        out.field("target", "m, world", "p_t − p", self.error(view))
        out.field("gate_velocity", "m/s, world", "v_g", self.frame(view).velocity)
        out.field("gate", "m, world", "g − p", self.way(view))
        out.observe_clock(view)

    def reward(self, view, terms):
        drone, way = view.drone(), self.way(view)
        pose = f.exponential_kernel(self.pose_scale, self.error(view))
        before, ahead = way[0] > 0.0, np.maximum(way[0], 0.0)
        beside = np.minimum(np.abs(way[1]) + np.abs(way[2]), self.FAR_BESIDE)
        middle = (0.8 - beside) * np.exp(-ahead)
        kept, most = pose + self.pose_floor, 1.0 + self.pose_floor
        formula = "{×reward_pose}r_p, r_p = e^{−{×pose_scale}d}"
        terms.term("pose", formula, self.reward_pose, self.reward_pose * pose, smoothness="piecewise")
        formula = "{×reward_gate}(0.8 − min(|g_y − y| + |g_z − z|, 5 m)) e^{x} for x < 0, else {reward_gate}"
        gate, low = self.reward_gate * np.where(before, middle, 1.0), self.reward_gate * (0.8 - self.FAR_BESIDE)
        terms.term("gate", formula, self.reward_gate, gate, low=low, smoothness="non_smooth")
        up = self.reward_up * kept * f.upright(drone.up)
        terms.term("up", "{×reward_up}(r_p + {pose_floor}) ((u_z + 1)/2)²", self.reward_up * most, up, smoothness="piecewise")
        spin = self.reward_spin * kept * f.still(drone.angular_velocity)
        terms.term("spin", "{×reward_spin}(r_p + {pose_floor})/(1 + ω_z²)", self.reward_spin * most, spin, smoothness="piecewise")
        self.write_effort(view, terms)

    def ends(self, view, ends):
        position = view.drone().position
        ends.when("crash", "z < {min_height} m", position[2] < self.min_height)
        ends.when("high", "z > {max_height} m", position[2] > self.max_height)
        ends.when("wide", "|y| > {max_side} m", np.abs(position[1]) > self.max_side)
        ends.when("far", "d > {max_distance} m", farther(self.error(view), self.max_distance))
        missed = "not |g_y − y| < {gate_aperture} m and |g_z − z| < {gate_aperture} m in the first step with x > 0"
        ends.when("missed", missed, view.task_state[1] > 0.5)
        contact = self.clearance(view) < 0.0
        if not self.reset_on_collision:
            contact = contact & ~contact
        ends.when("contact", "touches the frame, if reset_on_collision", contact)

    def metrics(self, view, out):
        out.metric("position_error", "m", f.norm(self.error(view)))
        out.metric("uprightness", "-", view.drone().up[2])
        out.metric("clearance", "m", self.clearance(view))
        out.metric("throttle_difference", "-", view.throttle_difference())

    def success(self, view):
        return view.task_state[2] > 0.5

    def success_rule(self):
        return od.Success().below("position_error", self.success_distance).once()

    def loss(self, view, loss):
        drone, way = view.drone(), self.way(view)
        loss.add("√(d² + {loss_radius}²)", f.smooth_norm(self.error(view), self.loss_radius))
        # the middle of the opening counts near its plane
        aside = self.loss_gate * f.pseudo_huber(way[1:], 5.0) * f.rational_kernel(2.0, np.square(way[0]))
        loss.add("{×loss_gate}h₅(b, c)/(1 + 4a²) with (a, b, c) = g − p", aside)
        loss.add("{×loss_velocity}h₅(v)", self.loss_velocity * f.pseudo_huber(drone.velocity, 5.0))
        loss.add("{×loss_rate}h₁₀(ω)", self.loss_rate * f.pseudo_huber(drone.angular_velocity, 10.0))
        nearness = self.loss_clearance * np.exp(-10.0 * np.maximum(self.clearance(view), -0.2))
        loss.add("{×loss_clearance}e^{−10 max(clearance, −0.2 m)}", nearness)


class Formation(od.Task, StartAttitude, PoseLoss):
    """Form a figure in each other's downwash."""

    formation = Setting("hexagon", "m", 'one drone per point: "hexagon" (7), "tetragon" (5) or a list of points')
    observe_place = Setting(False, "", "whether each drone, and the state of all, is told the way to the point that it takes")
    horizon = 600
    center = Setting([0.0, 0.0, 1.5], "m, world", "p_c")
    start_first = Setting([-1.75, -1.75, 0.625], "m, world", "centre of the first cell that drones start in")
    start_step = Setting([0.5, 0.5, 0.25], "m", "from cell to cell", domain="positive")
    start_cells = Setting([8, 8, 6], "", "cells per axis", domain="positive")
    start_way_ease = Setting(1.0, "-", "share of the way from a drone's place to its cell at which it starts at difficulty 0", domain="share")
    min_height = Setting(0.2, "m", "a lower drone is a crash")
    min_separation = Setting(0.23, "m", "closer drones touch", domain="positive")
    separation = Setting(0.4, "m", "least distance of two drones at which r_s reaches 1", domain="positive")
    success_distance = Setting(0.2, "m", "H and c of a success", domain="positive")
    success_alignment = Setting(0.95, "-", "mean h_x above which a success is")
    shape_scale = Setting(1.6, "1/m", "how steeply r_f falls", domain="not_negative")
    reward_shape = Setting(1.0, "-", "weight of the term shape", domain="not_negative")
    reward_place = Setting(1.0, "-", "weight of the term place", domain="not_negative")
    reward_heading = Setting(1.0, "-", "weight of the term heading", domain="not_negative")
    reward_center = Setting(0.4, "-", "weight of the term center", domain="not_negative")
    loss_crowd = Setting(1.0, "m", "weight of drones too close to each other in the loss", domain="not_negative")
    loss_separation = Setting(0.8, "m", "least distance of two drones that costs nothing in the loss", domain="positive")
    about = (
        "p_i, v_i, ω_i drones (world), p̄ their mean place, f_i the figure's points, f̄ their mean, h_i headings, sep the least distance of two "
        "drones, r_s = min((sep/{separation} m)², 1), k steps. H: the larger of max_i min_j ‖(p_i − p̄) − (f_j − f̄)‖ and max_j min_i of the "
        "same: the Hausdorff distance of both figures, whoever takes which place, neither turned nor scaled. c = ‖p̄ − p_c‖ with the centre "
        "p_c = {center} m. Start: different cells of a grid of {start_cells} cells from {start_first} m on in steps of {start_step} m, at their "
        "centres; roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest. There the drones take points by the least sum "
        "of squared ways, f_i for drone i: the loss asks for those, reward and success for any. At difficulty d of a curriculum drones begin "
        "the share 1 − (1 − {start_way_ease})(1 − d) of the way from their points to those cells."
    )
    start_on_host = True
    HEXAGON = np.array([[0, 0], [3**0.5, -1], [0, -2], [-(3**0.5), -1], [-(3**0.5), 1], [0, 2], [3**0.5, 1]])

    @cached_property
    def figure(self):
        """Points about their mean."""
        points = np.pad(self.HEXAGON, ((0, 0), (0, 1))) if self.formation == "hexagon" else np.asarray(self.formation)
        return points - points.mean(0)

    @property
    def n(self):
        return len(self.figure)

    def robot(self):
        return od.Robot.team(self.vehicle, self.n)

    def start(self, start):
        nx, ny, nz = (int(n) for n in self.start_cells)
        cells, begin, attitudes = [], [], []
        for _ in range(self.n):
            cell = start.reset.below(nx * ny * nz, other_than=cells)
            cells.append(cell)
            index = np.stack([cell % nx, cell // nx % ny, cell // (nx * ny)])
            begin.append(self.start_first + self.start_step * index)
            attitudes.append(self.draw_attitude(start))
        gone = 1.0 - eased(self.start_way_ease, start.difficulty)
        for i, end in enumerate(self.take_places(start, begin)):
            start.place(begin[i] + gone * (end - begin[i]), attitudes[i], tree=i)

    def ideal(self, start):
        begin = self.center + self.figure
        for i in range(self.n):
            start.place(begin[i], tree=i)
        self.take_places(start, begin)

    def take_places(self, start, begin):
        points = self.center + self.figure
        taken = f.assign(f.squared_norm(points - od.array(begin)[:, None]))
        start.goal.field("places", "m", "f of the point that each drone takes, less the figure's mean", f.take(self.figure, taken))
        return f.take(points, taken)

    # what all drones are

    def mean(self, view):
        return sum(view.drone(i).position for i in range(self.n)) * (1.0 / self.n)

    def offset(self, view):
        return self.mean(view) - self.center

    def facing(self, view):
        return sum(view.drone(i).heading[0] for i in range(self.n)) * (1.0 / self.n)

    def way(self, view, i):
        return self.center + view.goal[3 * i : 3 * i + 3] - view.drone(i).position

    def squared_hausdorff(self, view):
        mean, most = self.mean(view), 0.0

        def gap(i, j):
            return f.squared_norm(view.drone(i).position - mean - self.figure[j])

        for i in range(self.n):
            drone, point = gap(i, 0), gap(0, i)
            for j in range(1, self.n):
                drone, point = np.minimum(drone, gap(i, j)), np.minimum(point, gap(j, i))
            most = np.maximum(np.maximum(most, drone), point)
        return most

    def squared_separation(self, view):
        least = 1e12
        for i in range(1, self.n):
            for j in range(i):
                least = np.minimum(least, f.squared_norm(view.drone(i).position - view.drone(j).position))
        return least

    def apart(self, view, wanted):
        return np.minimum(self.squared_separation(view) * (1.0 / (wanted * wanted)), 1.0)

    def lowest(self, view):
        least = view.drone(0).position[2]
        for i in range(1, self.n):
            least = np.minimum(least, view.drone(i).position[2])
        return least

    # phases

    def observe_own(self, view, i, out):
        out.field("center", "m, world", "p_c − p_i", self.center - view.drone(i).position)
        out.observe_drone(view, i)
        if self.observe_place:
            out.field("place", "m, world", "p_c + f_i − p_i of the point that it takes", self.way(view, i))

    def observe(self, view, agent, out):
        self.observe_own(view, agent, out)
        out.observe_clock(view)
        meaning = "p_i − p_j, ‖p_i − p_j‖, q_j, v_j, ω_j for every other j, ascending"
        layout = ("members", self.n - 1)
        out.field("others", "m, m, -, m/s, rad/s; world", meaning, smoothness="non_smooth", layout=layout)
        for j in range(self.n):
            if j != agent:
                other = view.drone(j)
                between = view.drone(agent).position - other.position
                out.write(between)
                out.write(f.norm(between))
                out.write(other.observed_attitude)
                out.write(other.velocity)
                out.write(other.angular_velocity)

    def central(self, view, out):
        out.field("drones", "as observed", "center … of every drone")
        for i in range(self.n):
            out.unnamed(lambda out, i=i: self.observe_own(view, i, out))

    def reward(self, view, terms):
        near, place = self.apart(view, self.separation), f.exponential_kernel(1.0, self.offset(view))
        shape = near * f.rational_kernel(self.shape_scale, self.squared_hausdorff(view))
        formula = "{×reward_shape}r_s r_f, r_f = 1/(1 + ({×shape_scale}H)²)"
        terms.term("shape", formula, self.reward_shape, self.reward_shape * shape, smoothness="piecewise")
        own = self.reward_place * shape * place
        terms.term("place", "{×reward_place}r_s r_f e^{−c}", self.reward_place, own, smoothness="piecewise")
        own, least = self.reward_heading * shape * self.facing(view), -self.reward_heading
        terms.term("heading", "{×reward_heading}r_s r_f · mean h_x", self.reward_heading, own, low=least, smoothness="piecewise")
        own = near * self.reward_center * place
        terms.term("center", "{×reward_center}r_s e^{−c}", self.reward_center, own, smoothness="piecewise")

    def ends(self, view, ends):
        ends.when("crash", "min z_i < {min_height} m", self.lowest(view) < self.min_height)
        ends.when("touch", "sep < {min_separation} m", self.squared_separation(view) < self.min_separation * self.min_separation)

    def metrics(self, view, out):
        out.metric("hausdorff", "m", f.safe_sqrt(self.squared_hausdorff(view)))
        out.metric("center_error", "m", f.norm(self.offset(view)))
        out.metric("heading_alignment", "-", self.facing(view))
        out.metric("separation", "m", f.safe_sqrt(self.squared_separation(view)))
        mean = sum(view.throttle_difference(i) for i in range(self.n)) * (1.0 / self.n)
        out.metric("throttle_difference", "-", mean)

    def success(self, view):
        most, facing = self.success_distance, self.facing(view) > self.success_alignment
        return (self.squared_hausdorff(view) < most * most) & nearer(self.offset(view), most) & facing

    def success_rule(self):
        rule = od.Success().below("hausdorff", self.success_distance).below("center_error", self.success_distance)
        return rule.above("heading_alignment", self.success_alignment)

    def loss(self, view, loss):
        own = 0.0
        for i in range(self.n):
            drone = view.drone(i)
            own += self.loss_velocity * f.pseudo_huber(drone.velocity, 5.0)
            own += self.loss_rate * f.pseudo_huber(drone.angular_velocity, 10.0)
            own += self.loss_turn * (1.0 - drone.heading[0])
            own += f.smooth_norm(self.way(view, i), self.loss_radius)
        mean = (1.0 / self.n) * own
        crowd = self.loss_crowd * np.square(1.0 - self.apart(view, self.loss_separation))
        loss.add("{×loss_crowd}(1 − min((sep/{loss_separation} m)², 1))²", crowd)
        formula = (
            "mean(√(‖p_c + f_i − p_i‖² + {loss_radius}²) + {×loss_velocity}h₅(v_i) + {×loss_rate}h₁₀(ω_i) + {×loss_turn}(1 − h_i,x))"
        )
        loss.add(formula, mean)


class Forest(od.Task, StartRange):
    """Cross a forest, another one in every episode."""

    horizon = 1000
    length = Setting(24.0, "m", "of the corridor along x", domain="positive")
    width = Setting(12.0, "m", "of the corridor along y", domain="positive")
    trunks = Setting(45, "", "trunks in the corridor")
    trunks_ease = Setting(1.0, "-", "share of the trunks at difficulty 0", domain="share")
    radius = Setting([0.2, 0.3], "m", "of trunks, least and largest", domain="positive_ordered")
    gap = Setting(0.8, "m", "least way between two trunks", domain="not_negative")
    clear = Setting([2.0, 1.0], "m", "without trunks at the beginning and at the end")
    target = Setting([[24.0, 24.0], [-4.0, 4.0], [2.0, 2.0]], "m, world", "p_t, lowest and highest per axis", domain="ordered")
    start_position = [[0.0, 0.5], [-4.0, 4.0], [1.8, 2.2]]
    start_along = Setting(0.0, "-", "share of episodes that begin anywhere on the way to the target", domain="share")
    speed = Setting(2.0, "m/s", "beyond which haste is worth no more", domain="positive")
    max_speed = Setting(2.5, "m/s", "faster ends the episode", domain="positive")
    min_height = Setting(0.2, "m", "lower is a crash")
    max_height = Setting(4.0, "m", "higher ends the episode")
    success_distance = Setting(0.5, "m", "position error of a success", domain="positive")
    reward_progress = Setting(1.0, "s/m", "weight of the term progress", domain="not_negative")
    reward_up = Setting(1.0, "-", "weight of the term up", domain="not_negative")
    reward_alive = Setting(1.0, "-", "of every step that does not end", domain="not_negative")
    reward_safety = Setting(0.2, "-", "weight of the term safety", domain="not_negative")
    loss_speed = Setting(1.8, "m/s", "that the loss asks for", domain="positive")
    loss_pace = Setting(0.3, "s²/m", "weight of the error of the velocity in the loss", domain="not_negative")
    loss_clearance = Setting(4.0, "m", "weight of the clearance in the loss", domain="not_negative")
    loss_reach = Setting(0.3, "m", "over which it falls by e", domain="positive")
    loss_heading = Setting(0.3, "m", "weight of ‖h − n‖² in the loss: beams ahead then look where it goes", domain="not_negative")
    loss_up = Setting(0.1, "m", "weight of ‖e_z − u‖² in the loss", domain="not_negative")
    loss_rate = Setting(0.005, "m s²/rad²", "weight of the angular velocity in the loss", domain="not_negative")
    about = (
        "p drone, v, ω velocity and angular velocity (world), h = R e_x, u = R e_z, c least distance between trunks and drone, propellers "
        "included, up to 10 m, d = ‖p_t − p‖, n = (p_t − p)/d. {trunks} trunks of radius {radius} m stand in a corridor of {length} m × {width} "
        "m, {gap} m or more apart. Target: p_t uniform in {target} m. Start: p uniform in {start_position} m, roll and pitch within "
        "±{start_tilt} rad, yaw within {start_yaw} rad, at rest."
    )
    defaults = {"sensor": [{"name": "lidar", "kind": "lidar", "preset": "omnidrones"}]}
    start_on_host = True
    MARGIN = 2.0
    SAFETY = (0.05, 4.0)

    @cached_property
    def forest(self):
        return od.Forest(
            length=self.length, width=self.width, clear=self.clear, trunks=self.trunks, radius=self.radius, height=self.max_height + 1.0, gap=self.gap
        )

    @property
    def scene(self):
        return self.forest.scene

    def place_scene(self, goal):
        offsets = goal[3:].reshape(-1, 2) - self.forest.places[:, :2]
        return np.concatenate([offsets, np.zeros((len(offsets), 1))], axis=1).ravel()

    def set_goal(self, start, target, places):
        start.goal.field("target", "m, world", "p_t", target)
        start.goal.field("trunks", "m, world", "(x, y) of every trunk", places)

    def start(self, start):
        target = start.task.uniform(self.target[:, 0], self.target[:, 1])
        standing = eased(self.trunks_ease, start.difficulty) * float(self.trunks)
        offsets = start.task.trunks(self.forest, standing)
        stands = np.arange(self.trunks) + 0.5 < np.floor(standing + 0.5)
        places = np.where(stands[:, None], self.forest.places[:, :2] + offsets[:, :2], [-1000.0, 0.0])
        self.set_goal(start, target, places)
        position, attitude = self.draw(start)
        start.place(self.along(start, position, target, places), attitude)

    def along(self, start, begin, end, trunks):
        """In a share of episodes anywhere on the way where nothing is near."""
        if self.start_along == 0.0:
            return begin
        moves, place = start.reset.unit() < self.start_along, [begin]

        def attempt():
            there = begin + start.reset.unit() * (end - begin)
            free = np.all(np.hypot(trunks[:, 0] - there[0], trunks[:, 1] - there[1]) > self.forest.radii + 0.6)
            place[0] = np.where(moves & free, there, begin)
            return free | ~moves

        start.again(20, attempt)
        return place[0]

    def ideal(self, start):
        self.set_goal(start, [self.length, 0.0, 2.0], np.tile([-1000.0, 0.0], (self.trunks, 1)))
        start.place([0.5 * self.length, 0.0, 2.0])
        start.move_at([self.speed, 0.0, 0.0])

    def error(self, view):
        return view.goal[0:3] - view.drone().position

    def clearance(self, view):
        return view.clearance_to_columns(view.goal[3:].reshape(-1, 2), self.forest.radii)

    def remember(self, view, out):
        reached = latch(view.task_state[0], nearer(self.error(view), self.success_distance))
        out.field("reached", "-", "1 once d < {success_distance} m", reached)

    def observe(self, view, agent, out):
        error = self.error(view)
        out.field("direction", "-, world", "n", f.normalise(error), low=-1.0, high=1.0)
        out.observe_drone(view)
        out.field("height", "m, world", "z", view.drone().position[2])
        out.field("distance", "m", "d", f.norm(error))

    def reward(self, view, terms):
        drone = view.drone()
        n, v = f.normalise(self.error(view)), drone.velocity
        towards = np.maximum(np.minimum(n[::-1] @ v[::-1], self.speed), -self.speed)
        most = self.reward_progress * self.speed
        formula = "{×reward_progress}min(v·n, {speed} m/s), no less than −{speed} m/s"
        terms.term("progress", formula, most, self.reward_progress * towards, low=-most, smoothness="piecewise")
        terms.term("up", "{×reward_up}((u_z + 1)/2)²", self.reward_up, self.reward_up * f.upright(drone.up))
        terms.term("alive", "{×reward_alive}1", self.reward_alive, self.reward_alive)
        clearance = np.minimum(np.maximum(self.clearance(view), self.SAFETY[0]), self.SAFETY[1])
        low, high = (self.reward_safety * np.log(c) for c in self.SAFETY)
        formula = "{×reward_safety}ln(c/m), c held within 0.05 to 4 m"
        terms.term("safety", formula, high, self.reward_safety * np.log(clearance), low=low, smoothness="piecewise")

    def ends(self, view, ends):
        drone = view.drone()
        x, y, z = drone.position
        ends.when("crash", "z < {min_height} m", z < self.min_height)
        ends.when("high", "z > {max_height} m", z > self.max_height)
        ends.when("fast", "‖v‖ > {max_speed} m/s", farther(drone.velocity, self.max_speed))
        beyond = (x < -self.MARGIN) | (x > self.length + self.MARGIN)
        outside = (np.abs(y) > 0.5 * self.width) | beyond
        ends.when("corridor", "2 m before or behind the corridor of {length} m, or beside its {width} m", outside)
        ends.when("contact", "c < 0", self.clearance(view) < 0.0)

    def metrics(self, view, out):
        out.metric("position_error", "m", f.norm(self.error(view)))
        out.metric("uprightness", "-", view.drone().up[2])
        out.metric("clearance", "m", self.clearance(view))
        out.metric("speed", "m/s", f.norm(view.drone().velocity))

    def success(self, view):
        return view.task_state[0] > 0.5

    def success_rule(self):
        return od.Success().below("position_error", self.success_distance).once()

    def loss(self, view, loss):
        drone, error = view.drone(), self.error(view)
        # a second before the target it slows down
        pace = self.loss_speed * np.reciprocal(np.sqrt(f.squared_norm(error) + self.loss_speed * self.loss_speed))
        formula = "{×loss_pace}h₅(v − v_t), v_t = {loss_speed} m/s (p_t − p)/√(d² + ({loss_speed} m)²)"
        loss.add(formula, self.loss_pace * f.pseudo_huber(drone.velocity - pace * error, 5.0))
        clearance = np.maximum(self.clearance(view), -0.2)
        near = np.exp((-1.0 / self.loss_reach) * clearance)
        loss.add("{×loss_clearance}e^{−max(c, −0.2 m)/{loss_reach} m}", self.loss_clearance * near)
        turn = drone.heading - f.normalise(error)
        loss.add("{×loss_heading}‖h − n‖²", self.loss_heading * f.squared_norm(turn))
        loss.add("{×loss_up}‖e_z − u‖²", self.loss_up * f.squared_norm([0.0, 0.0, 1.0] - drone.up))
        loss.add("{×loss_rate}h₁₀(ω)", self.loss_rate * f.pseudo_huber(drone.angular_velocity, 10.0))


TASKS = (Hover, PayloadTrack, FlyThrough, Formation, Forest)
