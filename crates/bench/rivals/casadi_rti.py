"""Model predictive control by the real-time iteration in CasADi, along our lemniscate: times per tick, tracking error.

    OMP_NUM_THREADS=1 taskset -c 1 python casadi_rti.py problems/hummingbird_speed.toml

Horizon, weights and bounds are the problem's; its start and goal are not used. One tick, at 100 Hz, is one Gauss–Newton
step of SQP: all stages are linearised about the last answer, with the measured state first, then one QP is solved to
the end and its step taken whole. States are 16 numbers of an error (rotation vector for attitude), so that no
quaternion is in the QP. Linearisation, costs and the update are C from CasADi (gcc -O3 -march=native), QPs the solvers
that CasADi ships, and HPIPM itself (hpipm_direct.py). The plant is the same model at 2 ms, RK4.
"""

import argparse
import json
import multiprocessing
import os
import pathlib
import subprocess
import tempfile
import time

import casadi as ca
import numpy as np

import casadi_model
from casadi_model import conjugate, multiply
from hpipm_direct import Direct, install
from problem import GRAVITY, Problem, digits, logarithm
from problem import conjugate as np_conjugate
from problem import multiply as np_multiply

TICK, PLANT_STEP = 0.01, 0.002
SETTLED = 2.0
GCC = ["gcc", "-O3", "-march=native", "-shared", "-fPIC"]
TOLERANCE = 1e-6

HPIPM = {"iter_max": 50} | {f"res_{k}_max": TOLERANCE for k in "gbdm"}
SOLVERS = {
    # mode, warm start, blocks
    "hpipm direct": ("direct", ("speed", 0, None)),
    "hpipm direct balance": ("direct", ("balance", 0, None)),
    "hpipm direct warm": ("direct", ("speed", 2, None)),
    "hpipm direct warm, 5 blocks": ("direct", ("speed", 2, 5)),
    "hpipm direct warm, 2 blocks": ("direct", ("speed", 2, 2)),
    "hpipm speed": ("hpipm", {"hpipm": HPIPM | {"mode": "speed"}}),
    "hpipm balance": ("hpipm", {"hpipm": HPIPM | {"mode": "balance"}}),
    "osqp": ("osqp", {"osqp": {"verbose": False, "eps_abs": TOLERANCE, "eps_rel": TOLERANCE, "max_iter": 20000}}),
    "qrqp": ("qrqp", {"print_iter": False, "print_header": False, "print_info": False}),
    "proxqp": ("proxqp", {}),
    "piqp": ("piqp", {}),
}


class Lemniscate:
    """p = (0, 0, 2) + (2.5, 2.5, 1.2) ∘ (cos θ, sin θ cos θ, 0.6 sin θ)/(1 + sin² θ), θ = π/2 + w|w| t²/(1 + |w| t)."""

    def __init__(self, rate):
        t = ca.SX.sym("t")
        x = abs(rate) * t
        phase = ca.pi / 2 + rate * t * x / (1 + x)
        s, c = ca.sin(phase), ca.cos(phase)
        p = ca.vertcat(0, 0, 2) + ca.vertcat(2.5 * c, 2.5 * s * c, 1.2 * 0.6 * s) / (1 + s * s)
        v = ca.jacobian(p, t)
        self.sample = ca.Function("sample", [t], [p, v, ca.jacobian(v, t)])

    def state(self, t):
        """`[13]`: position, velocity, attitude by flatness at yaw 0 without drag, angular velocity by difference."""
        p, v, q = self._place(t)
        ahead = 1e-5
        turn = logarithm(np_multiply(np_conjugate(q), self._place(t + ahead)[2])) / ahead
        return np.concatenate([p, v, q, turn])

    def _place(self, t):
        p, v, a = (np.array(y).ravel() for y in self.sample(t))
        z = a + np.array([0.0, 0.0, GRAVITY])
        z /= np.linalg.norm(z)
        y = np.cross(z, [1.0, 0.0, 0.0])
        y /= np.linalg.norm(y)
        x = np.cross(y, z)
        r = np.column_stack([x, y, z])
        w = 0.5 * np.sqrt(max(1 + np.trace(r), 1e-12))
        q = np.array([w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w))])
        return p, v, q


def shifted(x, d):
    """x ⊕ δ, with the rotation vector's exponential."""
    theta = d[6:9]
    s = ca.dot(theta, theta) / 4
    small = s < 1e-8
    root = ca.sqrt(ca.if_else(small, 1.0, s))
    sinc = ca.if_else(small, 1 - s / 6, ca.sin(root) / root)
    turn = ca.vertcat(ca.if_else(small, 1 - s / 2, ca.cos(root)), sinc * theta / 2)
    q = multiply(x[6:10], turn)
    return ca.vertcat(x[0:6] + d[0:6], q / ca.norm_2(q), x[10:] + d[9:])


def nudged(x, d):
    """x ⊕ δ to first order."""
    q = x[6:10] + multiply(x[6:10], ca.vertcat(0, d[6:9] / 2))
    return ca.vertcat(x[0:6] + d[0:6], q, x[10:] + d[9:])


class Controller:
    """What a tick computes, as two compiled functions and a QP."""

    def __init__(self, problem, folder):
        self.problem, self.folder = problem, folder
        n, m, steps = problem.n_state, problem.n_input, problem.steps
        e = n - 1
        x, u, after, goal = (ca.SX.sym(k, i) for k, i in (("x", n), ("u", m), ("after", n), ("goal", 13)))
        d, w = ca.SX.sym("d", e), ca.SX.sym("w", m)
        zero = lambda f: ca.substitute(f, ca.vertcat(d, w), ca.DM.zeros(e + m))
        moved = casadi_model.step(problem, nudged(x, d), u + w, problem.dt, problem.substeps)
        turn = multiply(conjugate(after[6:10]), moved[6:10])
        gap = ca.vertcat(moved[0:6] - after[0:6], casadi_model.logarithm(turn), moved[10:] - after[10:])
        A, B, c = zero(ca.jacobian(gap, d)), zero(ca.jacobian(gap, w)), zero(gap)
        error = casadi_model.error(nudged(x, d), goal)
        J, r = zero(ca.jacobian(error, d)), zero(error)

        def cost(weights, dt):
            W = ca.DM(dt * weights["state"])
            return J.T @ ca.diag(W) @ J + 1e-8 * dt * ca.DM.eye(e), ca.densify(J.T @ (W * r))

        Q, q = cost(problem.stage, problem.dt)
        R = problem.dt * problem.stage["input"] * ca.SX(ca.DM.eye(m))
        s = problem.dt * problem.stage["input"] * (u - problem.input_reference)
        stage = ca.Function("stage", [x, u, after, goal], [A, B, ca.densify(c), Q, q, R, ca.densify(s)])
        end = ca.Function("end", [x, goal], list(cost(problem.terminal, 1.0)))

        X, U, G = ca.MX.sym("X", n, steps + 1), ca.MX.sym("U", m, steps), ca.MX.sym("G", 13, steps + 1)
        blocks = stage.map(steps)(X[:, :-1], U, X[:, 1:], G[:, :-1])
        widths = [e, m, 1, e, 1, m, 1]
        As, Bs, cs, Qs, qs, Rs, ss = (ca.horzsplit(b, k) for b, k in zip(blocks, widths))
        QN, qN = end(X[:, -1], G[:, -1])
        # the first state is measured and no variable: u₀ x₁ u₁ x₂ …
        H = ca.diagcat(*[b for k in range(steps) for b in ([Qs[k]] if k else []) + [Rs[k]]], QN)
        g = ca.vertcat(*[b for k in range(steps) for b in ([qs[k]] if k else []) + [ss[k]]], qN)
        columns = []
        for k in range(steps):
            left = [ca.MX(e, e) for _ in range(steps)]
            right = [ca.MX(e, m) for _ in range(steps)]
            if k:
                left[k - 1], left[k] = ca.MX(-ca.DM.eye(e)), As[k]
                columns.append(ca.vertcat(*left))
            right[k] = Bs[k]
            columns.append(ca.vertcat(*right))
        columns.append(ca.vertcat(*[ca.MX(e, e)] * (steps - 1), ca.MX(-ca.DM.eye(e))))
        A = ca.horzcat(*columns)
        b = -ca.vertcat(*cs)
        limit = lambda bound, k: bound[:, None].repeat(steps, 1) if k is None else bound
        low, high = ca.DM(limit(problem.least, None)) - U, ca.DM(limit(problem.most, None)) - U
        bound = lambda side, far: ca.vertcat(
            *[p for k in range(steps) for p in ([ca.DM(np.full(e, far))] if k else []) + [side[:, k]]],
            ca.DM(np.full(e, far)),
        )
        bounds = [ca.densify(bound(low, -np.inf)), ca.densify(bound(high, np.inf))]
        linearise = ca.Function("linearise", [X, U, G], [H, ca.densify(g), A, ca.densify(b), *bounds])

        # the answer of a QP, taken whole
        z = ca.MX.sym("z", g.numel())
        sizes = np.cumsum([0] + [k for _ in range(steps) for k in (m, e)])
        parts = ca.vertsplit(z, [int(k) for k in sizes])
        new_u = ca.horzcat(*[U[:, k] + parts[2 * k] for k in range(steps)])
        take = ca.Function("take", [x, d], [shifted(x, d)]).map(steps)
        new_x = ca.horzcat(X[:, 0], take(X[:, 1:], ca.horzcat(*parts[1::2])))
        update = ca.Function("update", [X, U, z], [new_x, new_u])
        # what HPIPM itself wants, dense
        dense = [ca.densify(y) for y in (*blocks, QN, qN)] + [ca.densify(low), ca.densify(high)]
        alone = ca.Function("stages", [X, U, G], dense)

        plant = ca.Function("plant", [x, u], [casadi_model.step(problem, x, u, PLANT_STEP, 1)])
        generator = ca.CodeGenerator("rti.c")
        for f in (linearise, update, plant, alone):
            generator.add(f)
        generator.generate(str(folder) + os.sep)
        library = folder / "rti.so"
        subprocess.run([*GCC, str(folder / "rti.c"), "-o", str(library)], check=True)
        self.linearise, self.update, self.plant, self.alone = (
            Call(ca.external(k, str(library))) for k in ("linearise", "update", "plant", "stages")
        )
        self.patterns = {"h": H.sparsity(), "a": A.sparsity()}
        self.shape = {"N": steps, "nx": [0] + [e] * steps, "nu": [m] * steps + [0], "ng": [0] * (steps + 1)}

    def qp(self, plugin, options):
        if plugin == "direct":
            mode, warm, blocks = options
            n, m = self.problem.n_state - 1, self.problem.n_input
            return Direct(self.folder, self.problem.steps, n, m, mode, TOLERANCE, warm, blocks)
        structured = plugin == "hpipm"
        own = dict(options) | (self.shape if structured else {}) | {"error_on_fail": False}
        return Call(ca.conic("qp", plugin, self.patterns, own))


class Call:
    """A CasADi function on arrays that it reads and writes in place, without conversions."""

    def __init__(self, function):
        self.function = function
        self.inputs = {function.name_in(i): np.zeros(function.nnz_in(i)) for i in range(function.n_in())}
        self.outputs = {function.name_out(i): np.zeros(function.nnz_out(i)) for i in range(function.n_out())}
        self.buffer, self.run = function.buffer()
        for i, array in enumerate(self.inputs.values()):
            self.buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self.outputs.values()):
            self.buffer.set_res(i, memoryview(array))

    def into(self, name, array):
        self.inputs[name] = array
        self.buffer.set_arg(list(self.inputs).index(name), memoryview(array))

    def restore(self):
        """The HPIPM interface of CasADi 3.8 overwrites the addresses of results."""
        for i, array in enumerate(self.outputs.values()):
            self.buffer.set_res(i, memoryview(array))


def references(curve, ticks, problem, rates):
    """`[tick, stage, 13]`: stages are whole numbers of ticks apart."""
    apart = round(problem.dt / TICK)
    assert abs(apart * TICK - problem.dt) < 1e-12, "stages must be whole ticks apart"
    points = np.array([curve.state(k * TICK) for k in range(ticks + apart * problem.steps + 1)])
    if not rates:
        points[:, 10:13] = 0.0
    rows = np.arange(ticks)[:, None] + apart * np.arange(problem.steps + 1)[None, :]
    return points, points[rows]


def fly(controller, name, curve, ticks, rates):
    problem, plugin_options = controller.problem, SOLVERS[name]
    n, m, steps = problem.n_state, problem.n_input, problem.steps
    linearise, update, plant = controller.linearise, controller.update, controller.plant
    qp = controller.qp(*plugin_options)
    points, goals = references(curve, ticks, problem, rates)
    goals = np.ascontiguousarray(goals)
    # what linearisation writes, the QP reads
    direct = isinstance(qp, Direct)
    if direct:
        linearise = controller.alone
        qp.read_from(list(linearise.outputs.values()))
        answer = qp.answer
    else:
        for k, name_in in enumerate(("h", "g", "a", "lba", "lbx", "ubx")):
            array = linearise.outputs[linearise.function.name_out(k)]
            qp.into(name_in, array)
            if name_in == "lba":
                qp.into("uba", array)
        answer = qp.outputs["x"]
    X, U, G = (linearise.inputs[k] for k in linearise.inputs)
    for array, key in zip((X, U), list(update.inputs)):
        update.into(key, array)
    update.into(list(update.inputs)[2], answer)
    new_x, new_u = update.outputs.values()
    x = np.concatenate([points[0][:3], np.zeros(3), [1.0, 0, 0, 0], np.zeros(3), problem.vehicle.hover_speed])
    X[:] = np.tile(x, steps + 1)
    U[:] = np.tile(problem.hover_input, steps)
    state, action = plant.inputs.values()
    (next_state,) = plant.outputs.values()
    squared, iterations, times, cpu, failed = [], [], np.zeros((ticks, 3)), np.zeros((ticks, 3)), 0
    wall, process = time.perf_counter, time.process_time
    for k in range(ticks):
        X[:n] = x
        G[:] = goals[k].ravel()
        if not direct:
            qp.restore()
            # the step is taken, so its best guess is 0; multipliers stay
            qp.inputs["lam_x0"][:], qp.inputs["lam_a0"][:] = qp.outputs["lam_x"], qp.outputs["lam_a"]
        c0, t0 = process(), wall()
        linearise.run()
        c1, t1 = process(), wall()
        qp.run()
        c2, t2 = process(), wall()
        update.run()
        c3, t3 = process(), wall()
        times[k] = t1 - t0, t2 - t1, t3 - t2
        cpu[k] = c1 - c0, c2 - c1, c3 - c2
        X[:], U[:] = new_x, new_u
        if direct:
            iterations.append(qp.iterations.value)
        outside = max((np.tile(problem.least, steps) - U).max(), (U - np.tile(problem.most, steps)).max())
        if not np.isfinite(answer).all() or outside > 1e-3:
            failed += 1
        action[:] = np.clip(U[:m], problem.least, problem.most)
        if k * TICK >= SETTLED:
            squared.append(((x[:3] - points[k][:3]) ** 2).sum())
        for _ in range(round(TICK / PLANT_STEP)):
            state[:] = x
            plant.run()
            x = next_state.copy()
        if not np.isfinite(x).all() or np.abs(x[:3]).max() > 100:
            failed += ticks - k
            break
    done = slice(1, k + 1)
    two = lambda columns: {
        "median": digits(np.median(times[done, columns].sum(axis=1))),
        "p99": digits(np.quantile(times[done, columns].sum(axis=1), 0.99)),
        "cpu_median": digits(np.median(cpu[done, columns].sum(axis=1))),
    }
    print(
        json.dumps(
            {
                "tool": f"casadi {ca.__version__} rti {name}",
                "problem": problem.name,
                "ticks": ticks,
                "reference_rates": rates,
                "iterations": 1,
                "qp_iterations": digits(np.mean(iterations), 3) if iterations else None,
                "qp_failed": failed,
                "rmse_m": digits(np.sqrt(np.mean(squared)), 6) if squared else None,
                "seconds_linearisation": two([0]),
                "seconds_qp": two([1]),
                "seconds_update": two([2]),
                "seconds_tick": two([0, 1, 2]),
                "cpu_over_wall": digits(cpu[done].sum() / times[done].sum(), 3),
            }
        ),
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem")
    parser.add_argument("--rate", type=float, default=1.5, help="of the lemniscate, rad/s")
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument(
        "--no-rates", action="store_true", help="reference of angular velocity 0 instead of the curve's"
    )
    parser.add_argument("--solvers", nargs="*", default=list(SOLVERS), help=", ".join(SOLVERS))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        controller = Controller(Problem(arguments.problem), pathlib.Path(folder))
        for name in arguments.solvers:
            plugin = SOLVERS[name][0]
            if install() if plugin == "direct" else ca.has_conic(plugin):
                # a process each: two libraries are called libhpipm.so
                job = (controller, name, Lemniscate(arguments.rate), arguments.ticks, not arguments.no_rates)
                flight = multiprocessing.get_context("fork").Process(target=fly, args=job)
                flight.start()
                flight.join()


if __name__ == "__main__":
    main()
