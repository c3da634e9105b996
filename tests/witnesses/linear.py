"""Makes linear.json: sixty-one linear systems and what others find of them.

    pip install numpy scipy mpmath control slycot
    python3 tests/witnesses/linear.py

Poles, responses, hold equivalents and the solutions of Riccati and Lyapunov equations are computed with 50 digits (mpmath), from
the matrices as they stand in the file; norms by slycot's AB13DD, margins by python-control and polished with 50 digits, disk
margins of several loops by slycot's AB13MD and scipy. `condition` says how much a relative change of 1e-10 of the data moves the
answer: the largest of four random changes.
"""

import json
import pathlib
import warnings

import control
import mpmath as mp
import numpy as np
import scipy.linalg as la
import scipy.optimize as so
import slycot

warnings.filterwarnings("ignore")
mp.mp.dps = 50
HERE = pathlib.Path(__file__).parent
rng = np.random.default_rng(20261123)


def tf(num, den):
    system = control.tf2ss(control.tf(num, den))
    return [np.array(m, float) for m in (system.A, system.B, system.C, system.D)]


def zpk(zeros, poles, gain):
    return tf(gain * np.real(np.poly(zeros)), np.real(np.poly(poles)))


def stable(n, m, p, direct=False):
    a = rng.normal(size=(n, n))
    a -= (max(la.eigvals(a).real) + 0.1 + rng.random()) * np.eye(n)
    d = rng.normal(size=(p, m)) if direct else np.zeros((p, m))
    b, c = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    small = 0.9 / peak(a, b, c, d, None) if m == p > 1 and n % 2 == 0 else 1.0
    return [a, b, small * c, small * d]


def sampled(system, dt):
    a, b, c, d = system
    n, m = b.shape
    whole = la.expm(np.block([[a, b], [np.zeros((m, n + m))]]) * dt)
    return [whole[:n, :n], whole[:n, n:], c, d]


def delayed(system, k):
    """k samples later at the input."""
    a, b, c, d = system
    n, m = b.shape
    for _ in range(k):
        a = np.block([[a, b], [np.zeros((m, a.shape[1] + m))]])
        b = np.vstack([np.zeros((a.shape[0] - m, m)), np.eye(m)])
        c, d = np.hstack([c, d]), np.zeros_like(d)
    return [a, b, c, d]


def chain(n, lag):
    """n integrators behind a motor's lag."""
    a = np.diag(np.ones(n), 1)
    a[n, n] = -1 / lag
    b = np.zeros((n + 1, 1))
    b[n, 0] = 1 / lag
    return [a, b, np.eye(1, n + 1), np.zeros((1, 1))]


def controlled(n, lag, kind):
    """A chain with state feedback broken at the motor."""
    a, b, c, d = chain(n, lag)
    q = np.diag(np.append(10.0 ** rng.uniform(0, 2, n), 0.01))
    x = la.solve_continuous_are(a, b, q, [[0.1]])
    return [a, b, b.T @ x / 0.1, d]


def drone(dt):
    """Position and attitude of a quadrotor near hover with lagging rotors, by axis: 4 inputs, 16 states."""
    axes = [chain(4, 0.02), chain(4, 0.02), chain(2, 0.02), chain(2, 0.02)]
    system = [la.block_diag(*[axis[i] for axis in axes]) for i in range(4)]
    a, b, c, d = sampled(system, dt)
    x = la.solve_discrete_are(a, b, np.eye(len(a)), 0.1 * np.eye(4))
    gain = la.solve(0.1 * np.eye(4) + b.T @ x @ b, b.T @ x @ a)
    mixer = np.array([[1, 1, 1, 1], [1, -1, -1, 1], [1, 1, -1, -1], [1, -1, 1, -1]]) / 2
    return [a, b @ mixer, mixer.T @ gain, d]


def jordan(n, pole):
    return [pole * np.eye(n) + np.diag(np.ones(n - 1), 1), np.eye(n)[:, -1:], np.eye(1, n), np.zeros((1, 1))]


def nearly_unreachable(n, share):
    a, b, c, d = stable(n, 1, 1)
    values, vectors = la.eig(a.T)
    w = np.real(vectors[:, np.argmin(abs(values.imag))])
    b = b - np.outer(w, w @ b) / (w @ w) * (1 - share)
    return [a, b, c, d]


def systems():
    one = lambda name, system, dt=None: (name, system, dt)
    yield one("lag", tf([1], [1, 1]))
    yield one("lag with gain 4", tf([4], [1, 1]))
    yield one("resonance", tf([1], [1, 0.1, 1]))
    yield one("sharp resonance", tf([1], [1, 0.002, 1]))
    yield one("two resonances", tf([1, 0.02, 4], np.polymul([1, 0.01, 1], [1, 0.03, 9])))
    yield one("three lags, gain 4", tf([4], np.poly([-1, -1, -1])))
    yield one("three lags, gain 10", tf([10], np.poly([-1, -2, -3])))
    yield one("five equal lags", tf([2], np.poly([-1] * 5)))
    yield one("right zero", tf([-1, 1], [1, 3, 2]))
    yield one("right pole held", tf([6, 6], [1, 1, -2]))
    yield one("right pole, gain 2", tf([2], [1, -1]))
    yield one("conditionally stable", zpk([-1, -1], [-0.01, -0.02, -0.03, -40, -50], 2000.0))
    yield one("direct path", tf([2, 1], [1, 5]))
    yield one("direct path of one", tf([1, 2, 3], [1, 0.4, 5]))
    yield one("integrator and lag", tf([1], [1, 1, 0]))
    yield one("lead on two integrators", tf([4, 2], [0.05, 1, 0, 0]))
    yield one("fast and slow", tf([1e3], np.poly([-1e-2, -1, -1e3])))
    for n, lag in [(2, 0.02), (3, 0.03), (4, 0.05), (4, 0.01)]:
        yield one(f"{n} integrators, lag {lag}", controlled(n, lag, 0))
    for n, pole in [(2, -1.0), (3, -0.6), (4, -2.0)]:
        yield one(f"Jordan block {n} at {pole}", jordan(n, pole))
    for n, share in [(4, 1e-3), (5, 1e-5), (6, 1e-7)]:
        yield one(f"nearly unreachable {share}", nearly_unreachable(n, share))
    for n, m, direct in [(3, 2, False), (4, 2, True), (6, 2, False), (6, 3, True), (8, 3, False), (10, 4, True), (15, 4, False), (20, 2, False), (30, 2, False)]:
        yield one(f"stable {n} states, {m} loops{', direct' * direct}", stable(n, m, m, direct))
    unstable = stable(5, 2, 2)
    unstable[0] = unstable[0] + 0.8 * np.eye(5)
    yield one("unstable, 2 loops", unstable)
    yield one("2 inputs, 3 outputs", stable(5, 2, 3, True))
    yield one("4 inputs, 1 output", stable(6, 4, 1))
    dt = 0.002
    yield one("sampled lag", sampled(tf([5], [1, 5]), dt), dt)
    yield one("sampled resonance", sampled(tf([2500], [1, 1, 2500]), dt), dt)
    yield one("sampled integrator", sampled(tf([8], [1, 0]), dt), dt)
    for n, lag in [(1, 0.02), (2, 0.02), (3, 0.03), (4, 0.05)]:
        yield one(f"sampled {n} integrators, lag {lag}", sampled(controlled(n, lag, 0), dt), dt)
    for k in [1, 5, 12]:
        yield one(f"sampled lead, {k} samples late", delayed(sampled(tf([4, 2], [0.05, 1, 0, 0]), dt), k), dt)
        yield one(f"sampled lag, {k} samples late", delayed(sampled(tf([5], [1, 5]), 0.01), k), 0.01)
    yield one("drone at 2 ms", drone(dt), dt)
    yield one("drone at 10 ms, a sample late", delayed(drone(0.01), 1), 0.01)
    for n, m in [(4, 2), (7, 3), (12, 2)]:
        yield one(f"sampled {n} states, {m} loops", sampled(stable(n, m, m, True), 0.1), 0.1)
    yield one("sampled slow, 3 states", sampled(stable(3, 1, 1), 2.0), 2.0)
    yield one("deadbeat", [np.diag(np.ones(3), 1), np.eye(4)[:, -1:], np.array([[1.0, -0.5, 0.25, 0.1]]), np.zeros((1, 1))], 0.05)
    yield one("sampled unstable", sampled(unstable, 0.05), 0.05)
    yield one("sampled, 2 inputs, 3 outputs", sampled(stable(5, 2, 3, True), 0.02), 0.02)


def exact(m):
    return mp.matrix(m.tolist())


def number(v):
    return float(v)


def complexes(values):
    return [[float(mp.re(v)), float(mp.im(v))] for v in values]


def rows(m):
    return [[float(m[i, j]) for j in range(m.cols)] for i in range(m.rows)]


def eigenvalues(a):
    return list(mp.eig(a, left=False, right=False)) if a.rows > 1 else [a[0, 0]]


def matched(one, other):
    """The largest distance between two sets of poles."""
    cost = np.array([[abs(complex(x - y)) for y in other] for x in one])
    i, j = so.linear_sum_assignment(cost)
    return cost[i, j].max()


def moved(m, size=1e-10):
    change = rng.normal(size=(m.rows, m.cols))
    change *= size * float(mp.norm(m, 2) if m.rows == 1 or m.cols == 1 else mp.mnorm(m, "f")) / max(la.norm(change), 1e-300)
    return m + exact(change)


def response(a, b, c, d, s):
    n = a.rows
    return c * (mp.inverse(s * mp.eye(n) - a) * b) + d if n else d


def riccati(a, b, q, r, start, dt):
    """Newton's iteration with 50 digits from a solution in doubles."""
    x = exact(start)
    n = a.rows
    eye = mp.eye(n)
    for _ in range(3):
        if dt is None:
            k = mp.inverse(r) * (b.T * x)
            loop = a - b * k
            x = lyapunov(loop, q + k.T * r * k, None)
        else:
            k = mp.inverse(r + b.T * x * b) * (b.T * x * a)
            loop = a - b * k
            x = lyapunov(loop, q + k.T * r * k, dt)
    return x


def lyapunov(a, q, dt):
    """By iterative refinement of a solution in doubles, the residual with 50 digits."""
    solve = la.solve_discrete_lyapunov if dt else lambda m, c: la.solve_continuous_lyapunov(m, -c)
    numeric = lambda m: np.array(m.tolist(), dtype=float)
    x = mp.zeros(a.rows)
    for _ in range(12):
        left = q + (a.T * x * a - x if dt else a.T * x + x * a)
        size = mp.mnorm(left, "f")
        if size < mp.mpf(10) ** -40 * mp.mnorm(q, "f"):
            break
        x += exact(solve(numeric(a).T, numeric(left / size))) * size
    return (x + x.T) / 2


def norm(x):
    return mp.mnorm(x, "f")


def condition(f, base, size):
    return max(float(norm(f() - base) / size) for _ in range(4)) / 1e-10


def polished(f, start):
    """The root beside a start; none where python-control's rational functions showed one that is not there."""
    try:
        w = mp.findroot(f, mp.mpf(float(start)), tol=1e-60, verify=False)
    except ZeroDivisionError:
        return None
    return w if mp.im(w) == 0 and abs(w / start - 1) < 1e-2 and abs(f(w)) < 1e-30 else None


def apart(crossings):
    """Each once."""
    found = []
    for crossing in sorted(crossings):
        if not found or crossing[0] > found[-1][0] * (1 + 1e-9):
            found.append(crossing)
    return found


def loop_margins(a, b, c, d, dt):
    """Crossovers of python-control, polished with 50 digits on the response."""
    system = control.ss(a, b, c, d) if dt is None else control.ss(a, b, c, d, dt)
    gm, pm, _, wg, wp, _ = control.stability_margins(system, returnall=True, epsw=1e-8)
    ea, eb, ec, ed = map(exact, (a, b, c, d))
    axis = (lambda w: mp.mpc(0, w)) if dt is None else (lambda w: mp.expj(w * mp.mpf(dt)))
    at = lambda w: response(ea, eb, ec, ed, axis(w))[0, 0]
    gains, phases = [], []
    top = np.pi / dt * (1 - 1e-6) if dt else np.inf
    # python-control's rational functions lose crossovers of fast sampling: where signs change along a grid are starts too
    grid = np.geomspace(1e-4, min(top, 1e5), 4000)
    l = np.array([(c @ la.solve((np.exp(1j * w * dt) if dt else 1j * w) * np.eye(len(a)) - a, b) + d)[0, 0] for w in grid])
    wg = np.append(wg, grid[:-1][np.diff(np.sign(l.imag)) != 0])
    wp = np.append(wp, grid[:-1][np.diff(np.sign(np.log(abs(l)))) != 0])
    for w in filter(None, (polished(lambda w: mp.im(at(w)) / abs(at(w)), w) for w in wg if 1e-6 < w < top)):
        if mp.re(at(w)) < 0:
            gains.append([float(w), float(-1 / mp.re(at(w)))])
    for w in filter(None, (polished(lambda w: mp.log(abs(at(w))), w) for w in wp if 1e-6 < w < top)):
        phases.append([float(w), float(mp.arg(-at(w)))])
    return apart(gains), apart(phases)


def peak(a, b, c, d, dt):
    """sigma_max over frequency: slycot's AB13DD, and where that stops short of a grid, the grid's best, refined."""
    n, m, p = len(a), b.shape[1], c.shape[0]
    if n == 0:
        return float(la.norm(d, 2))
    found = float(slycot.ab13dd("D" if dt else "C", "I", "S", "D", n, m, p, a, np.eye(n), b, c, d, tol=1e-12)[0])
    gain = lambda w: la.norm(c @ la.solve((np.exp(1j * w * dt) if dt else 1j * w) * np.eye(n) - a, b) + d, 2)
    rates = np.log(la.eigvals(a).astype(complex)) / dt if dt else la.eigvals(a)
    rates = abs(rates[(abs(rates) > 1e-6) & (abs(rates) < 1e6)])
    high = np.pi / dt if dt else 100 * max(rates, default=1.0)
    grid = np.unique(np.append(np.geomspace(min(rates, default=1.0) / 100, high, 2000), rates[rates < high]))
    best = int(np.argmax([gain(w) for w in grid]))
    low, up = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    refined = so.minimize_scalar(lambda w: -gain(w), bounds=(low, up), method="bounded", options={"xatol": 1e-13 * up})
    return max(found, -float(refined.fun)) if -refined.fun > found * (1 + 1e-9) else found


def closed(a, b, c, d):
    """(I + L)^-1."""
    m = len(d)
    e = la.inv(np.eye(m) + d)
    return a - b @ e @ c, b @ e, -e @ c, e


def several(a, b, c, d, dt):
    """1 / sup mu of S - 1/2, AB13MD at each frequency."""
    sa, sb, sc, sd = closed(a, b, c, d)
    m = len(d)
    sd = sd - 0.5 * np.eye(m)

    def mu(w):
        s = 1j * w if dt is None else np.exp(1j * w * dt)
        g = sc @ la.solve(s * np.eye(len(sa)) - sa, sb) + sd
        return slycot.ab13md(g, np.ones(m, int), 2 * np.ones(m, int))[0]

    poles = la.eigvals(sa)
    rates = abs(np.log(poles.astype(complex)) / dt) if dt else abs(poles)
    rates = rates[(rates > 1e-6) & (rates < 1e6)]
    high = np.pi / dt if dt else rates.max() * 100
    grid = np.append(np.geomspace(rates.min() / 100, high, 3000), 1e-9)
    values = [mu(w) for w in grid]
    best = int(np.argmax(values))
    w = grid[best]
    low, up = grid[max(best - 1, 0)] if w > 1e-8 else 0, grid[min(best + 1, len(grid) - 2)] if w > 1e-8 else 1e-9
    found = so.minimize_scalar(lambda w: -mu(w), bounds=(low, up), method="bounded", options={"xatol": 1e-12 * max(up, 1e-6)})
    return 1 / max(max(values), -found.fun)


def work(name, system, dt):
    a, b, c, d = [np.ascontiguousarray(m, float) for m in system]
    n, m, p = len(a), b.shape[1], c.shape[0]
    ea, eb, ec, ed = map(exact, (a, b, c, d))
    entry = {"name": name, "dt": dt, "a": a.tolist(), "b": b.tolist(), "c": c.tolist(), "d": d.tolist()}
    poles = eigenvalues(ea)
    stable = all((abs(v) < 1) if dt else (mp.re(v) < 0) for v in poles)
    entry["poles"] = complexes(poles)
    # numbers, because AB13DD balances: a pole that many changes move alike
    entry["poles_condition"] = max(matched(poles, eigenvalues(moved(ea))) for _ in range(4)) / (1e-10 * float(norm(ea)))
    omega = [0.01, 0.3, 1.7, 9.0, 60.0] if not dt else [f * np.pi / dt for f in (0.001, 0.03, 0.2, 0.6, 0.97)]
    axis = (lambda w: mp.mpc(0, w)) if dt is None else (lambda w: mp.expj(mp.mpf(w) * mp.mpf(dt)))
    values = [response(ea, eb, ec, ed, axis(w)) for w in omega]
    entry["omega"] = omega
    entry["response"] = [complexes([g[i, j] for i in range(p) for j in range(m)]) for g in values]
    if dt is None:
        whole = mp.zeros(n + m)
        whole[:n, :n] = ea
        whole[:n, n:] = eb
        held = mp.expm(whole * mp.mpf(0.05), method="taylor")
        entry["held"] = rows(held[:n, :])
    q, r = ec.T * ec + mp.eye(n) / 100, mp.eye(m)
    nq, nr = np.array(q.tolist(), float), np.eye(m)
    q = exact(nq)
    start = la.solve_discrete_are(a, b, nq, nr) if dt else la.solve_continuous_are(a, b, nq, nr)
    x = riccati(ea, eb, q, r, start, dt)
    entry["q"] = nq.tolist()
    entry["riccati"] = rows(x)
    entry["riccati_condition"] = condition(lambda: riccati(moved(ea), moved(eb), q, r, start, dt), x, norm(x)) if n <= 20 else 1e4
    if stable:
        y = lyapunov(ea, q, dt)
        entry["lyapunov"] = rows(y)
        entry["lyapunov_condition"] = condition(lambda: lyapunov(moved(ea), q, dt), y, norm(y)) if n <= 20 else 1e4
        entry["peak"] = peak(a, b, c, d, dt)
    if m == p:
        sa, sb, sc, sd = closed(a, b, c, d)
        values = la.eigvals(sa)
        holds = all(abs(values) < 1) if dt else all(values.real < 0)
        entry["holds"] = bool(holds)
        if m == 1:
            entry["gains"], entry["phases"] = loop_margins(a, b, c, d, dt)
        if holds:
            half = 0.5 * np.eye(m)
            entry["sensitivity"] = peak(sa, sb, sc, sd, dt)
            if m == 1:
                entry["disk"] = 1 / peak(sa, sb, sc, sd - half, dt)
            elif m <= 4:
                entry["disk"] = several(a, b, c, d, dt)
    return entry


def main():
    entries = []
    for name, system, dt in systems():
        entries.append(work(name, system, dt))
        print(len(entries), name, {k: entries[-1].get(k) for k in ("holds", "peak", "disk", "riccati_condition")}, flush=True)
    about = {"control": control.__version__, "scipy": __import__("scipy").__version__, "slycot": slycot.__version__, "mpmath": mp.__version__}
    lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in entries)
    (HERE / "linear.json").write_text(f'{{"made_with":{json.dumps(about)},"systems":[\n{lines}\n]}}\n')


main()
