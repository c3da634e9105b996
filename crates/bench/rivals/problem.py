"""Problem files, the vehicle behind them, and a plain numpy model: the judge of every rival's answer.

A problem file is described in README.md. Nothing here is shared with the models under test: Crocoddyl's comes from
Pinocchio, CasADi's from casadi_model.py.
"""

import dataclasses
import pathlib
import statistics
import time

import numpy as np
import tomllib

GRAVITY = 9.81
LEAST_THRUST = 1e-4
EFFECTS = {
    "body_drag": True,
    "quadratic_drag": True,
    "rotor_drag": True,
    "rolling_moment": False,
    "rotor_inertia": True,
}
BUILT_IN = pathlib.Path(__file__).resolve().parents[3] / "src/dynamics/vehicles"


class Vehicle:
    """Constants of the rigid body in SI units, about the centre of mass; rotors as arrays, `[n]` or `[n, 3]`."""

    def __init__(self, path):
        data = tomllib.loads(pathlib.Path(path).read_text())
        self.name = data["name"]
        parts, rotors = data["parts"], data["rotors"]
        place = lambda part: np.array(part.get("position", [0.0] * 3))
        self.mass = sum(p["mass"] for p in parts)
        self.center = sum(p["mass"] * place(p) for p in parts) / self.mass
        self.inertia = np.zeros((3, 3))
        for p in parts:
            j = p["inertia"]
            xy, xz, yz = (j.get(k, 0.0) for k in ("xy", "xz", "yz"))
            d = place(p) - self.center
            own = np.array([[j["xx"], xy, xz], [xy, j["yy"], yz], [xz, yz, j["zz"]]])
            self.inertia += own + p["mass"] * (d @ d * np.eye(3) - np.outer(d, d))
        drag = data.get("drag", {})
        self.linear, self.quadratic, self.angular = (
            np.array(drag.get(k, [0.0] * 3)) for k in ("linear", "quadratic", "angular")
        )
        number = lambda key, otherwise=None: np.array([r.get(key, otherwise) for r in rotors], dtype=float)
        self.hub = number("position")
        self.axis = number("axis", [0.0, 0.0, 1.0])
        self.spin = number("spin")
        self.k_f = number("thrust_coefficient")
        self.kappa = number("moment_per_thrust")
        self.max_speed = number("max_speed")
        self.tau_up, self.tau_down = number("time_constant_up"), number("time_constant_down")
        self.rotor_inertia = number("inertia", 0.0)
        self.k_d, self.k_z = number("drag_coefficient", 0.0), number("axial_drag_coefficient", 0.0)
        self.rolling = number("rolling_coefficient", 0.0)
        self.n = len(rotors)
        self.max_thrust = self.k_f * self.max_speed**2
        self.arm = self.hub - self.center
        # columns [n; (r − c) × n − σ κ n]: force and moment of a unit thrust
        self.allocation = np.vstack(
            [self.axis.T, (np.cross(self.arm, self.axis) - (self.spin * self.kappa)[:, None] * self.axis).T]
        )
        weight = np.array([0.0, 0.0, self.mass * GRAVITY, 0.0, 0.0, 0.0])
        self.hover_thrust = np.linalg.lstsq(self.allocation, weight, rcond=None)[0]
        if np.abs(self.allocation @ self.hover_thrust - weight).max() > 1e-9 * weight[2]:
            raise SystemExit(f"vehicle '{self.name}' does not hover level")
        self.hover_speed = np.sqrt(self.hover_thrust / self.k_f)


class Problem:
    """A problem file, with every default filled in."""

    def __init__(self, path):
        path = pathlib.Path(path)
        data = tomllib.loads(path.read_text())
        self.name = path.stem
        built_in = BUILT_IN / f"{data['vehicle']}.toml"
        self.vehicle = v = Vehicle(built_in if built_in.exists() else path.parent / data["vehicle"])
        self.speed = {"thrust": False, "speed": True}[data["inputs"]]
        self.steps, self.dt = data["steps"], data["dt"]
        self.substeps = data.get("substeps", 1)
        if data.get("integrator", "rk4") != "rk4":
            raise SystemExit(f"{path}: integrator '{data['integrator']}', but the rivals have rk4 alone")
        given = data.get("effects", {})
        unknown = [k for k, on in given.items() if on and k not in EFFECTS]
        if unknown:
            raise SystemExit(f"{path}: effects {unknown}, but the rivals have {list(EFFECTS)} alone")
        self.effects = EFFECTS | given
        self.n_input = v.n
        self.hover_input = v.hover_speed / v.max_speed if self.speed else v.hover_thrust
        reference = data.get("input_reference")
        self.input_reference = self.hover_input if reference is None else np.full(v.n, float(reference))
        least, most = (np.full(v.n, 0.01), np.ones(v.n)) if self.speed else (LEAST_THRUST * v.max_thrust, v.max_thrust)
        bounds = data.get("bounds")
        if bounds == "free":
            least, most = np.full(v.n, -np.inf), np.full(v.n, np.inf)
        elif bounds is not None:
            least, most = (np.full(v.n, float(b)) for b in bounds)
        self.least, self.most = least, most
        self.free = bounds == "free"
        self.start, self.goal = (self._state(data.get(key, {})) for key in ("start", "goal"))
        self.stage, self.terminal = (_weights(data.get(key, {})) for key in ("stage", "terminal"))

    @property
    def n_state(self):
        return 13 + (self.vehicle.n if self.speed else 0)

    def _state(self, given):
        at = lambda key, otherwise: np.array(given.get(key, otherwise), dtype=float)
        q = at("attitude", [1.0, 0.0, 0.0, 0.0])
        o = [0.0] * 3
        rotors = self.vehicle.hover_speed if self.speed else []
        return np.concatenate(
            [at("position", o), at("velocity", o), q / np.linalg.norm(q), at("angular_velocity", o), rotors]
        )

    def error(self, x):
        """`[12]`: position and velocity (world), rotation vector (body), angular velocity (body), from the goal."""
        goal = self.goal
        q = multiply(conjugate(goal[6:10]), x[6:10])
        return np.concatenate([x[:6] - goal[:6], logarithm(q), x[10:13] - goal[10:13]])

    def running(self, x, u):
        """Cost per second."""
        d = u - self.input_reference
        return 0.5 * (self.stage["state"] @ self.error(x) ** 2 + self.stage["input"] * (d @ d))

    def cost(self, xs, us):
        """Σ dt · ½ (…) + ½ (…) of states `[N + 1, n]` and inputs `[N, m]`."""
        end = 0.5 * self.terminal["state"] @ self.error(xs[-1]) ** 2
        return self.dt * sum(self.running(x, u) for x, u in zip(xs, us)) + end

    def rollout(self, us):
        xs = [self.start]
        for u in us:
            xs.append(self.step(xs[-1], u))
        return np.array(xs)

    def defect(self, xs, us):
        """Largest entry of f(x, u) − x⁺ over the stages."""
        return max(np.abs(self.step(x, u) - y).max() for x, u, y in zip(xs, us, xs[1:]))

    def step(self, x, u, dt=None, substeps=None):
        """One stage: RK4 of the motion of the centre of mass; rotor speeds by the closed form of their lag."""
        v, substeps = self.vehicle, substeps or self.substeps
        h = (dt or self.dt) / substeps
        p, velocity, q, w = x[:3], x[3:6], x[6:10], x[10:13]
        m = np.concatenate([p + rotate(q, v.center), velocity + rotate(q, np.cross(w, v.center)), q, w])
        if self.speed:
            speed, target = x[13:], v.max_speed * np.maximum(u, 0.01)
        else:
            speed = target = np.sqrt(np.maximum(u, 0.0) / v.k_f)
        thrust = None if self.speed else u
        for _ in range(substeps):
            tau = np.where(target > speed, v.tau_up, v.tau_down)
            gap, decay = speed - target, np.exp(-0.5 * h / tau)
            path = [speed, target + gap * decay, target + gap * decay * decay]
            rates = [(target - s) / tau for s in path]
            stages, k = [], np.zeros(13)
            for ahead, at in ((0.0, 0), (0.5, 1), (0.5, 1), (1.0, 2)):
                k = self._rate(m + ahead * h * k, path[at], rates[at], thrust)
                stages.append(k)
            m = m + h / 6 * (stages[0] + 2 * stages[1] + 2 * stages[2] + stages[3])
            m[6:10] /= np.linalg.norm(m[6:10])
            speed = path[2]
        q, w = m[6:10], m[10:13]
        own = [m[:3] - rotate(q, v.center), m[3:6] - rotate(q, np.cross(w, v.center)), q, w]
        return np.concatenate(own + ([speed] if self.speed else []))

    def _rate(self, m, speed, speed_rate, thrust):
        v, on = self.vehicle, self.effects
        velocity, q, w = m[3:6], m[6:10], m[10:13]
        thrust = v.k_f * speed**2 if thrust is None else thrust
        wrench = v.allocation @ thrust
        force, moment = wrench[:3], wrench[3:]
        air = rotate_scaled(conjugate(q), velocity)
        if on["body_drag"]:
            force = force - v.linear * air
            moment = moment - v.angular * w
        if on["quadratic_drag"]:
            force = force - np.linalg.norm(air) * v.quadratic * air
        for i in range(v.n):
            hub = air + np.cross(w, v.arm[i])
            along = (hub @ v.axis[i]) * v.axis[i]
            if on["rotor_drag"]:
                drag = -speed[i] * (v.k_d[i] * (hub - along) + v.k_z[i] * along)
                force, moment = force + drag, moment + np.cross(v.arm[i], drag)
            if on["rolling_moment"]:
                moment = moment - v.spin[i] * v.rolling[i] * speed[i] * (hub - along)
        momentum = v.inertia @ w
        if on["rotor_inertia"]:
            spinning = (v.spin * v.rotor_inertia)[:, None] * v.axis
            momentum = momentum + speed @ spinning
            moment = moment - (speed_rate @ spinning if self.speed else 0.0)
        drags = on["body_drag"] or on["quadratic_drag"] or on["rotor_drag"] or on["rolling_moment"]
        # stages leave the unit sphere; what a force does there is part of the definition of the step
        turned = rotate_scaled(q, force) if drags or v.axis[:, :2].any() else force[2] * up(q)
        acceleration = turned / v.mass - np.array([0.0, 0.0, GRAVITY])
        spin = np.linalg.solve(v.inertia, moment - np.cross(w, momentum))
        return np.concatenate([velocity, acceleration, 0.5 * multiply(q, np.concatenate([[0.0], w])), spin])


def _weights(given):
    three = lambda key: np.broadcast_to(np.asarray(given.get(key, 0.0), dtype=float), (3,))
    names = ("position", "velocity", "attitude", "angular_velocity")
    unknown = set(given) - {*names, "input"}
    if unknown:
        raise SystemExit(f"unknown weights {sorted(unknown)}")
    return {"state": np.concatenate([three(n) for n in names]), "input": float(given.get("input", 0.0))} | {
        n: three(n) for n in names
    }


def multiply(a, b):
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.concatenate([[w], v])


def conjugate(q):
    return np.concatenate([q[:1], -q[1:]])


def rotate(q, v):
    t = 2 * np.cross(q[1:], v)
    return v + q[0] * t + np.cross(q[1:], t)


def rotate_scaled(q, v):
    t = 2 * np.cross(q[1:], v)
    return q @ q * v + q[0] * t + np.cross(q[1:], t)


def up(q):
    w, x, y, z = q
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def logarithm(q):
    """Rotation vector of the shorter way."""
    q = -q if q[0] < 0 else q
    n = np.linalg.norm(q[1:])
    return 2 * q[1:] if n < 1e-12 else 2 * np.arctan2(n, q[0]) / n * q[1:]


@dataclasses.dataclass
class Times:
    """Seconds of a run, of many: wall, and the median of processor time, which counts on a busy machine."""

    median: float
    p99: float
    cpu: float
    cpu_over_wall: float

    def json(self):
        return {"median": digits(self.median), "p99": digits(self.p99), "cpu_median": digits(self.cpu)}


def timed(run, repeats, before=lambda: None):
    """Wall and processor time of `run`, after one run that is not counted; `before` is not counted either."""
    walls, cpus = [], []
    for k in range(repeats + 1):
        before()
        c, w = time.process_time(), time.perf_counter()
        run()
        w, c = time.perf_counter() - w, time.process_time() - c
        if k:
            walls.append(w)
            cpus.append(c)
    return Times(
        statistics.median(walls), float(np.quantile(walls, 0.99)), statistics.median(cpus), sum(cpus) / sum(walls)
    )


def digits(number, n=4):
    """Rounded to n digits that count, for print."""
    return float(f"{number:.{n - 1}e}")
