"""The step and the cost of a problem as CasADi expressions: this rival's own model, checked against numpy by its users.

The step has no branch that a derivative could not follow: the motor's time constant is chosen once per substep, as in
the library, and norms have a floor.
"""

import casadi as ca
import numpy as np

from problem import GRAVITY


def cross(a, b):
    return ca.cross(a, b)


def multiply(a, b):
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:4], b[1:4]), a[0] * b[1:4] + b[0] * a[1:4] + cross(a[1:4], b[1:4]))


def conjugate(q):
    return ca.vertcat(q[0], -q[1:4])


def rotate(q, v, n=1):
    """n v + …: ‖q‖² R v where n is ‖q‖²."""
    t = 2 * cross(q[1:4], v)
    return n * v + q[0] * t + cross(q[1:4], t)


def logarithm(q):
    """Rotation vector of the shorter way; smooth at no rotation, and the same for every length of q."""
    q = ca.if_else(q[0] < 0, -q, q)
    w, v = q[0], q[1:4]
    t = ca.dot(v, v) / (w * w)
    small = t < 1e-4
    root = ca.sqrt(ca.if_else(small, 1.0, ca.dot(v, v)))
    near = 2 / w * (1 - t * (1 / 3 - t * (1 / 5 - t * (1 / 7 - t / 9))))
    return ca.if_else(small, near, 2 * ca.atan2(root, w) / root) * v


def step(problem, x, u, dt, substeps, blend=None):
    """x⁺ of a stage of `dt` seconds, an expression. With `blend` (rad/s) the lag turns over a span of rotor speeds."""
    v, h = problem.vehicle, dt / substeps
    center = ca.DM(v.center)
    q, w = x[6:10], x[10:13]
    m = ca.vertcat(x[0:3] + rotate(q, center), x[3:6] + rotate(q, cross(w, center)), q, w)
    if problem.speed:
        speed, target, thrust = x[13:], v.max_speed * u, None
    else:
        speed, target, thrust = None, None, u
        if problem.effects["rotor_drag"] or problem.effects["rolling_moment"] or problem.effects["rotor_inertia"]:
            speed = target = ca.sqrt(u / v.k_f)
    for _ in range(substeps):
        path, rates = [speed] * 3, [0] * 3
        if problem.speed:
            if np.array_equal(v.tau_up, v.tau_down):
                tau, decay = ca.DM(v.tau_up), ca.DM(np.exp(-0.5 * h / v.tau_up))
            else:
                share = target > speed if blend is None else (1 + ca.tanh((target - speed) / blend)) / 2
                decay = _between(np.exp(-0.5 * h / v.tau_down), np.exp(-0.5 * h / v.tau_up), share)
                tau = 1 / _between(1 / v.tau_down, 1 / v.tau_up, share)
            gap = speed - target
            path = [speed, target + gap * decay, target + gap * decay * decay]
            rates = [(target - s) / tau for s in path]
        k1 = _rate(problem, m, path[0], rates[0], thrust)
        k2 = _rate(problem, m + h / 2 * k1, path[1], rates[1], thrust)
        k3 = _rate(problem, m + h / 2 * k2, path[1], rates[1], thrust)
        k4 = _rate(problem, m + h * k3, path[2], rates[2], thrust)
        m = m + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        m = ca.vertcat(m[0:6], m[6:10] / ca.norm_2(m[6:10]), m[10:13])
        speed = path[2]
    q, w = m[6:10], m[10:13]
    own = [m[0:3] - rotate(q, center), m[3:6] - rotate(q, cross(w, center)), q, w]
    return ca.vertcat(*own, *([speed] if problem.speed else []))


def _between(a, b, share):
    return ca.DM(a) + share * ca.DM(b - a)


def _rate(problem, m, speed, speed_rate, thrust):
    v, on = problem.vehicle, problem.effects
    velocity, q, w = m[3:6], m[6:10], m[10:13]
    n = ca.dot(q, q)
    wrench = ca.DM(v.allocation) @ (ca.DM(v.k_f) * speed**2 if thrust is None else thrust)
    force, moment = wrench[0:3], wrench[3:6]
    air = rotate(conjugate(q), velocity, n)
    if on["body_drag"]:
        force = force - ca.DM(v.linear) * air
        moment = moment - ca.DM(v.angular) * w
    if on["quadratic_drag"] and v.quadratic.any():
        force = force - ca.sqrt(ca.fmax(ca.dot(air, air), 1e-18)) * ca.DM(v.quadratic) * air
    for i in range(v.n):
        arm, axis = ca.DM(v.arm[i]), ca.DM(v.axis[i])
        if not (on["rotor_drag"] or on["rolling_moment"]):
            break
        hub = air + cross(w, arm)
        along = ca.dot(hub, axis) * axis
        if on["rotor_drag"]:
            drag = -speed[i] * (v.k_d[i] * (hub - along) + v.k_z[i] * along)
            force, moment = force + drag, moment + cross(arm, drag)
        if on["rolling_moment"]:
            moment = moment - v.spin[i] * v.rolling[i] * speed[i] * (hub - along)
    momentum = ca.DM(v.inertia) @ w
    if on["rotor_inertia"]:
        spinning = ca.DM((v.spin * v.rotor_inertia)[:, None] * v.axis).T
        momentum = momentum + spinning @ speed
        if problem.speed:
            moment = moment - spinning @ speed_rate
    drags = on["body_drag"] or on["quadratic_drag"] or on["rotor_drag"] or on["rolling_moment"]
    if drags or v.axis[:, :2].any():
        turned = rotate(q, force, n)
    else:
        a, b, c, d = ca.vertsplit(q)
        turned = force[2] * ca.vertcat(2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c))
    acceleration = turned / v.mass - ca.DM([0, 0, GRAVITY])
    spin = ca.DM(np.linalg.inv(v.inertia)) @ (moment - cross(w, momentum))
    return ca.vertcat(velocity, acceleration, multiply(q, ca.vertcat(0, w)) / 2, spin)


def error(x, goal):
    """As `Problem.error`, from any goal of at least 13 numbers."""
    turn = logarithm(multiply(conjugate(goal[6:10]), x[6:10]))
    return ca.vertcat(x[0:6] - goal[0:6], turn, x[10:13] - goal[10:13])


def functions(problem, blend=None):
    """Step, cost of a stage and of the end, as functions of (x, u)."""
    x, u = ca.SX.sym("x", problem.n_state), ca.SX.sym("u", problem.n_input)
    e, d, goal = error(x, ca.DM(problem.goal)), u - problem.input_reference, problem
    half = lambda weights: ca.dot(ca.DM(weights), e * e) / 2
    stage = problem.dt * (half(goal.stage["state"]) + problem.stage["input"] * ca.dot(d, d) / 2)
    return (
        ca.Function("step", [x, u], [step(problem, x, u, problem.dt, problem.substeps, blend)]),
        ca.Function("stage", [x, u], [stage]),
        ca.Function("terminal", [x], [half(problem.terminal["state"])]),
    )


def tangent_functions(problem):
    """As `functions`, in Crocoddyl's definition: RK4 on the tangent space of SE(3), velocities in body axes, and the
    cost of a stage by the same quadrature. For thrusts as inputs, without effects."""
    x, u = ca.SX.sym("x", 13), ca.SX.sym("u", problem.n_input)
    q, h = x[6:10], problem.dt
    twist = ca.vertcat(rotate(conjugate(q), x[3:6]), x[10:13])

    def moved(d, dtwist):
        """The state after a twist d of the pose and a change of the velocities."""
        rho, phi = d[0:3], d[3:6]
        t = ca.dot(phi, phi)
        small = t < 1e-4
        angle = ca.sqrt(ca.if_else(small, 1.0, t))
        b = ca.if_else(small, 1 / 2 - t / 24 * (1 - t / 30), (1 - ca.cos(angle)) / (angle * angle))
        c = ca.if_else(small, 1 / 6 - t / 120 * (1 - t / 42), (angle - ca.sin(angle)) / angle**3)
        half = ca.if_else(small, 1 / 2 - t / 48 * (1 - t / 80), ca.sin(angle / 2) / angle)
        whole = ca.if_else(small, 1 - t / 8 * (1 - t / 48), ca.cos(angle / 2))
        turned = multiply(q, ca.vertcat(whole, half * phi))
        p = x[0:3] + rotate(q, rho + b * cross(phi, rho) + c * cross(phi, cross(phi, rho)))
        own = twist + dtwist
        return ca.vertcat(p, rotate(turned, own[0:3]), turned, own[3:6])

    def rate(y):
        m = _rate(problem, y, None, None, u)
        v = rotate(conjugate(y[6:10]), y[3:6])
        change = rotate(conjugate(y[6:10]), m[3:6]) - cross(y[10:13], v)
        return ca.vertcat(v, y[10:13]), ca.vertcat(change, m[10:13]), stage(y, u)

    _, stage, terminal = functions(problem)
    d1, t1, c1 = rate(x)
    d2, t2, c2 = rate(moved(h / 2 * d1, h / 2 * t1))
    d3, t3, c3 = rate(moved(h / 2 * d2, h / 2 * t2))
    d4, t4, c4 = rate(moved(h * d3, h * t3))
    after = moved(h / 6 * (d1 + 2 * d2 + 2 * d3 + d4), h / 6 * (t1 + 2 * t2 + 2 * t3 + t4))
    return (
        ca.Function("step", [x, u], [after]),
        ca.Function("stage", [x, u], [(c1 + 2 * c2 + 2 * c3 + c4) / 6]),
        terminal,
    )
