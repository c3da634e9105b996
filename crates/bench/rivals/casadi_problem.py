"""A problem in CasADi by multiple shooting, solved by IPOPT and by fatrop: the optimum to twelve digits, and times.

    OMP_NUM_THREADS=1 taskset -c 1 python casadi_problem.py problems/*point*.toml problems/*speed*.toml

Functions and their derivatives are generated as C and compiled (gcc -O3 -march=native), as users do who want speed;
what is timed is a whole solve from the guess `start repeated, hover inputs`. The last line per problem, `optimum`, is
for cost alone: inputs at a bound are fixed there and the rest is solved without bounds, so that no barrier is left in
it; where the step has kinks it is `smoothed lag` instead, an upper bound.
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

import casadi as ca
import numpy as np

import casadi_model
from problem import Problem, digits, timed

REPEATS = 20
GCC = ["gcc", "-O3", "-march=native", "-ffp-contract=fast", "-shared", "-fPIC"]


class Shooting:
    """Variables x₀ u₀ x₁ u₁ … x_N; constraints x₀ = start, then a defect per stage."""

    def __init__(self, problem, blend=None, functions=None):
        self.problem = problem
        n, m, steps = problem.n_state, problem.n_input, problem.steps
        step, stage, terminal = functions or casadi_model.functions(problem, blend)
        xs = [ca.MX.sym(f"x{k}", n) for k in range(steps + 1)]
        us = [ca.MX.sym(f"u{k}", m) for k in range(steps)]
        start = ca.MX.sym("start", n)
        next_states = step.map(steps)(ca.horzcat(*xs[:-1]), ca.horzcat(*us))
        cost = ca.sum2(stage.map(steps)(ca.horzcat(*xs[:-1]), ca.horzcat(*us))) + terminal(xs[-1])
        # fatrop reads the structure of the stages from this order
        defects = [xs[k + 1] - next_states[:, k] for k in range(steps)]
        constraints = [defects[0], xs[0] - start, *defects[1:]]
        variables = [v for pair in zip(xs, us) for v in pair] + [xs[-1]]
        self.nlp = {
            "x": ca.vertcat(*variables),
            "p": start,
            "f": cost,
            "g": ca.vertcat(*constraints),
        }
        free_state = np.full(n, np.inf)
        self.least = np.concatenate([np.concatenate([-free_state, problem.least])] * steps + [-free_state])
        self.most = np.concatenate([np.concatenate([free_state, problem.most])] * steps + [free_state])
        one = np.concatenate([problem.start, problem.hover_input])
        self.guess = np.concatenate([one] * steps + [problem.start])

    def split(self, z):
        n, m, steps = self.problem.n_state, self.problem.n_input, self.problem.steps
        rows = z[: steps * (n + m)].reshape(steps, n + m)
        return np.vstack([rows[:, :n], z[None, steps * (n + m) :]]), rows[:, n:]

    def inputs(self):
        n, m, steps = self.problem.n_state, self.problem.n_input, self.problem.steps
        return (np.arange(steps)[:, None] * (n + m) + n + np.arange(m)).ravel()


def compiled(plugin, nlp, options, folder):
    """The solver with its functions and derivatives as compiled C."""
    source, library = folder / f"{plugin}.c", folder / f"{plugin}.so"
    ca.nlpsol("solver", plugin, nlp, options).generate_dependencies(source.name)
    os.replace(source.name, source)
    subprocess.run([*GCC, str(source), "-o", str(library)], check=True)
    return ca.nlpsol("solver", plugin, str(library), options)


def options_of(plugin, shooting, tolerance=1e-10, **more):
    quiet = {"print_time": False, "calc_multipliers": False}
    if plugin == "ipopt":
        own = {"print_level": 0, "sb": "yes", "tol": tolerance, "bound_relax_factor": 0.0, "max_iter": 1000} | more
        return quiet | {"ipopt": own}
    equal = [True] * shooting.nlp["g"].numel()
    own = {"print_level": 0, "tol": tolerance, "max_iter": 1000} | more
    return quiet | {"structure_detection": "auto", "equality": equal, "fatrop": own}


def solve(shooting, solver, guess=None, least=None, most=None):
    return solver(
        x0=shooting.guess if guess is None else guess,
        p=shooting.problem.start,
        lbx=shooting.least if least is None else least,
        ubx=shooting.most if most is None else most,
        lbg=0,
        ubg=0,
    )


def report(shooting, tool, answer, solver, times=None, **more):
    problem = shooting.problem
    z = np.array(answer["x"]).ravel()
    xs, us = shooting.split(z)
    stats = solver.stats()
    iterations = int(stats.get("iter_count", stats.get("iterations_count", -1)))
    line = {
        "tool": f"casadi {ca.__version__} {tool}",
        "problem": problem.name,
        "cost": float(answer["f"]),
        "cost_ours": problem.cost(problem.rollout(us), us),
        "iterations": iterations,
        "converged": bool(stats["success"]),
        "status": stats.get("unified_return_status", stats.get("return_status")),
    }
    if times:
        line |= {
            "seconds_solve": times.json(),
            "seconds_per_iteration": {k: digits(t / iterations) for k, t in times.json().items()},
            "cpu_over_wall": digits(times.cpu_over_wall, 3),
        }
    line |= {"gap": digits(problem.defect(xs, us), 2), "outside_bounds": digits(outside(problem, us), 2)} | more
    print(json.dumps(line), flush=True)
    return z


def outside(problem, us):
    return max(0.0, (problem.least - us).max(), (us - problem.most).max())


def optimum(shooting, answer, tool="optimum"):
    """Newton to rounding, with inputs held at the bounds that matter: an active set, begun where the barrier ended."""
    z, at = np.array(answer["x"]).ravel(), shooting.inputs()
    low, high = shooting.least[at], shooting.most[at]
    near = 1e-3 * np.where(np.isfinite(high - low), high - low, 1.0)
    side = np.where(z[at] - low < near, -1, np.where(high - z[at] < near, 1, 0))
    tight = 1e-13 * max(0.1, float(answer["f"]))
    options = options_of("ipopt", shooting, tight, dual_inf_tol=tight, constr_viol_tol=tight, acceptable_iter=0)
    solver = ca.nlpsol("solver", "ipopt", shooting.nlp, options)
    for _ in range(50):
        least, most = np.full(z.size, -np.inf), np.full(z.size, np.inf)
        held = np.where(side < 0, low, high)
        least[at[side != 0]] = most[at[side != 0]] = held[side != 0]
        polished = solve(shooting, solver, z, least, most)
        z, price = np.array(polished["x"]).ravel(), np.array(polished["lam_x"]).ravel()[at]
        wrong = side * price < 0
        beyond = np.where((side == 0) & (z[at] < low), -1, np.where((side == 0) & (z[at] > high), 1, 0))
        if not wrong.any() and not beyond.any():
            break
        side = np.where(wrong, 0, side + beyond)
    settled = not wrong.any() and not beyond.any()
    report(shooting, tool, polished, solver, inputs_at_bounds=int((side != 0).sum()), active_set_settled=bool(settled))


def smoothed(problem):
    """Where motors speed up and slow down with different lags, the step has kinks, and Newton's method ends at one. The
    answer of a smoothed lag, sharpened in steps, is an upper bound: read `cost_ours`, of the true step."""
    guess, best = None, None
    for blend in (300, 100, 30, 10, 3, 1, 0.3, 0.1):
        shooting = Shooting(problem, blend)
        solver = ca.nlpsol("solver", "ipopt", shooting.nlp, options_of("ipopt", shooting, 1e-9))
        answer = solve(shooting, solver, guess)
        guess = np.array(answer["x"]).ravel()
        us = shooting.split(guess)[1]
        cost = problem.cost(problem.rollout(us), us)
        if best is None or cost < best[0]:
            best = (cost, shooting, answer, solver, blend)
    _, shooting, answer, solver, blend = best
    report(shooting, "smoothed lag", answer, solver, blend_rad_s=blend)


def of_crocoddyl(problem):
    """The optimum in Crocoddyl's definition, to set its `cost` against; here `gap` is the defect from our step."""
    shooting = Shooting(problem, functions=casadi_model.tangent_functions(problem))
    solver = ca.nlpsol("solver", "ipopt", shooting.nlp, options_of("ipopt", shooting))
    optimum(shooting, solve(shooting, solver), "optimum of crocoddyl's definition")


def measure(shooting, plugin, folder):
    solver = compiled(plugin, shooting.nlp, options_of(plugin, shooting), folder)
    answer = solve(shooting, solver)
    report(shooting, plugin, answer, solver, timed(lambda: solve(shooting, solver), REPEATS))
    return answer


def main():
    for path in sys.argv[1:]:
        problem = Problem(path)
        shooting = Shooting(problem)
        with tempfile.TemporaryDirectory() as folder:
            answers = [measure(shooting, k, pathlib.Path(folder)) for k in ("ipopt", "fatrop") if ca.has_nlpsol(k)]
        lags = problem.vehicle
        if problem.speed and not np.array_equal(lags.tau_up, lags.tau_down):
            smoothed(problem)
        else:
            optimum(shooting, answers[0])
        if not problem.speed and not any(problem.effects.values()):
            of_crocoddyl(problem)


if __name__ == "__main__":
    main()
