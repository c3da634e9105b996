"""A problem in Crocoddyl: its C++ models of a free-flyer with thrusters, RK4, SolverFDDP and SolverBoxFDDP.

    OMP_NUM_THREADS=1 taskset -c 1 python crocoddyl_problem.py problems/point_to_point_free.toml

One JSON line per solver and stop threshold. Crocoddyl's discretisation is not ours: its RK4 acts on the tangent
space of SE(3) with velocities in body axes, and integrates the cost of a stage over the four RK4 nodes. So there are
two costs: `cost` is Crocoddyl's own, `cost_ours` that of its inputs rolled out by the numpy model in our definition.
That our reading of its definition is right is checked by `cost_check`: the relative difference of `cost` from the same
sum over the same trajectory, computed in numpy from our accelerations.
"""

import json
import sys

import crocoddyl
import numpy as np
import pinocchio as pin

from problem import GRAVITY, Problem, digits, timed

REPEATS = 100
WARM_REPEATS = 1000


def urdf(vehicle):
    j = vehicle.inertia
    x, y, z = vehicle.center
    return f"""<robot name="{vehicle.name}"><link name="base_link"><inertial>
<origin xyz="{x!r} {y!r} {z!r}" rpy="0 0 0"/><mass value="{vehicle.mass!r}"/>
<inertia ixx="{j[0, 0]!r}" iyy="{j[1, 1]!r}" izz="{j[2, 2]!r}" ixy="{j[0, 1]!r}" ixz="{j[0, 2]!r}" iyz="{j[1, 2]!r}"/>
</inertial></link></robot>""".replace("np.float64(", "").replace(")", "")


class Rival:
    """The shooting problem, and how its numbers relate to ours."""

    def __init__(self, problem):
        if problem.speed:
            raise SystemExit(f"{problem.name}: inputs 'speed', but Crocoddyl has no motors; only 'thrust' can be built")
        if any(problem.effects.values()):
            raise SystemExit(f"{problem.name}: effects {problem.effects}, but Crocoddyl has none; switch them off")
        if problem.substeps != 1:
            raise SystemExit(f"{problem.name}: {problem.substeps} substeps, but Crocoddyl takes one")
        self.problem = problem
        v = problem.vehicle
        self.model = model = pin.buildModelFromXML(urdf(v), pin.JointModelFreeFlyer())
        model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        self.state = state = crocoddyl.StateMultibody(model)
        thrusters = crocoddyl.StdVec_Thruster()
        for i in range(v.n):
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), v.axis[i]).matrix()
            kind = crocoddyl.ThrusterType.CW if v.spin[i] < 0 else crocoddyl.ThrusterType.CCW
            thrusters.append(crocoddyl.Thruster(pin.SE3(turn, v.hub[i]), v.kappa[i], kind))
        self.actuation = crocoddyl.ActuationModelFloatingBaseThrusters(state, thrusters)
        frame = model.getFrameId("base_link")
        self.running = self._action(frame, problem.stage, problem.dt)
        self.end = self._action(frame, problem.terminal, 0.0)
        self.running.u_lb, self.running.u_ub = problem.least, problem.most
        self.start = self.theirs(problem.start)
        self.shooting = crocoddyl.ShootingProblem(self.start, [self.running] * problem.steps, self.end)

    def _action(self, frame, weights, dt):
        goal, state, nu = self.problem.goal, self.state, self.actuation.nu
        costs = crocoddyl.CostModelSum(state, nu)

        def add(name, residual, weight):
            activation = crocoddyl.ActivationModelWeightedQuad(np.asarray(weight, dtype=float))
            costs.addCost(name, crocoddyl.CostModelResidual(state, activation, residual), 1.0)

        turn = pin.Quaternion(*goal[6:10]).matrix()
        if weights["position"].any():
            add("position", crocoddyl.ResidualModelFrameTranslation(state, frame, goal[:3], nu), weights["position"])
        if weights["attitude"].any():
            add("attitude", crocoddyl.ResidualModelFrameRotation(state, frame, turn, nu), weights["attitude"])
        linear, angular = weights["velocity"], weights["angular_velocity"]
        if linear.any() or angular.any():
            # in body axes: the same length, so the same cost where weights are equal and the goal is at rest
            if np.ptp(linear) > 0 or goal[3:6].any():
                raise SystemExit("weights of velocity must be equal and the goal at rest: Crocoddyl's is in body axes")
            add(
                "rates",
                crocoddyl.ResidualModelState(state, self.theirs(goal), nu),
                np.concatenate([np.zeros(6), linear, angular]),
            )
        if weights["input"]:
            residual = crocoddyl.ResidualModelControl(state, self.problem.input_reference)
            add("input", residual, np.full(nu, weights["input"]))
        free = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, self.actuation, costs)
        return crocoddyl.IntegratedActionModelRK(free, crocoddyl.RKType.four, dt)

    def theirs(self, x):
        """Position, quaternion x y z w; linear velocity of the origin in body axes, angular velocity."""
        w, *v = x[6:10]
        turn = pin.Quaternion(w, *v).matrix()
        return np.concatenate([x[:3], v, [w], turn.T @ x[3:6], x[10:13]])

    def ours(self, x):
        q = np.array([x[6], x[3], x[4], x[5]])
        q = q / np.linalg.norm(q)
        return np.concatenate([x[:3], pin.Quaternion(*q).matrix() @ x[7:10], q, x[10:13]])

    def numpy_stage(self, x, u):
        """x⁺ and cost of a stage in Crocoddyl's definition, from our accelerations and our cost."""
        p, h = self.problem, self.problem.dt

        def rate(x):
            ours = self.ours(x)
            center = p.vehicle.center
            assert not center.any(), "written for a centre of mass at the origin"
            motion = p._rate(ours.copy(), None, None, u)
            turn = pin.Quaternion(*ours[6:10]).matrix()
            body = turn.T @ motion[3:6] - np.cross(x[10:13], x[7:10])
            return np.concatenate([x[7:13], body, motion[10:13]]), p.running(ours, u)

        move = lambda d: np.concatenate([pin.integrate(self.state.pinocchio, x[:7], d[:6]), x[7:] + d[6:]])
        k1, c1 = rate(x)
        k2, c2 = rate(move(h / 2 * k1))
        k3, c3 = rate(move(h / 2 * k2))
        k4, c4 = rate(move(h * k3))
        return move(h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)), h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)

    def check(self, xs, us):
        """Cost in Crocoddyl's definition over its own states, and the largest defect of those."""
        cost, defect = 0.0, 0.0
        for x, u, after in zip(xs, us, list(xs)[1:]):
            y, c = self.numpy_stage(np.array(x), np.array(u))
            cost += c
            defect = max(defect, np.abs(self.ours(y) - self.ours(after)).max())
        end = self.problem.terminal["state"] @ self.problem.error(self.ours(xs[-1])) ** 2
        return cost + 0.5 * end, defect


def measure(rival, name, make, threshold, rolled_out):
    problem, shooting = rival.problem, rival.shooting
    us = [problem.hover_input] * problem.steps
    xs = list(shooting.rollout(us)) if rolled_out else [rival.start] * (problem.steps + 1)
    box = "Box" in name
    most = 1000
    found = {}

    def fresh():
        found["solver"] = make(shooting)
        found["solver"].th_stop = threshold

    def solve():
        found["converged"] = found["solver"].solve(xs, us, most, rolled_out, 1e-9)

    times = timed(solve, REPEATS, before=fresh)
    solver, converged = found["solver"], found["converged"]
    inputs = [np.array(u) for u in solver.us]
    outside = max(max((problem.least - u).max(), (u - problem.most).max()) for u in inputs)
    check, own_gap = rival.check(solver.xs, inputs)
    states = problem.rollout(inputs)
    # derivatives, backward pass, rollout: all in C++, at the solution; a step of length 0 does the work of any other
    # and leaves the derivatives' point where it is
    warm = timed(lambda: (solver.computeDirection(True), solver.tryStep(0.0)), WARM_REPEATS)
    parts = {
        "derivatives": timed(solver.calcDiff, WARM_REPEATS).cpu,
        "backward": timed(solver.backwardPass, WARM_REPEATS).cpu,
        "forward": timed(lambda: solver.tryStep(0.0), WARM_REPEATS).cpu,
    }
    iterations = solver.iter + (1 if converged else 0)
    return {
        "tool": f"crocoddyl {crocoddyl.__version__} {name}",
        "problem": problem.name,
        "cost": solver.cost,
        "cost_ours": problem.cost(states, inputs),
        "cost_check": digits(abs(check - solver.cost) / solver.cost, 2),
        "iterations": iterations,
        "converged": bool(converged),
        "stop": digits(solver.stop, 2),
        "threshold": threshold,
        "guess": "rolled out" if rolled_out else "start repeated",
        "seconds_solve": times.json(),
        "seconds_per_iteration": warm.json(),
        "seconds_parts": {k: digits(s, 3) for k, s in parts.items()},
        "cpu_over_wall": digits(times.cpu_over_wall, 3),
        "gap": digits(own_gap, 2),
        "outside_bounds": digits(max(outside, 0.0), 2) if box else None,
    }


def main():
    for path in sys.argv[1:]:
        rival = Rival(Problem(path))
        for name, make in (("SolverFDDP", crocoddyl.SolverFDDP), ("SolverBoxFDDP", crocoddyl.SolverBoxFDDP)):
            if name == "SolverFDDP" and not rival.problem.free:
                continue  # it knows no bounds
            for threshold in (1e-9, 1e-6):
                for rolled_out in (False, True):
                    print(json.dumps(measure(rival, name, make, threshold, rolled_out)), flush=True)


if __name__ == "__main__":
    main()
