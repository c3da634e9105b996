"""Steps per second of every model in MuJoCo, on one core, beside which ours are measured.

    pip install mujoco
    cargo test --test dynamics -- --ignored export_models
    taskset -c 0 python crates/bench/benches/mujoco_steps.py target/tmp/models [--out mujoco.jsonl]

The same bodies, joints and rotors (built by tests/witnesses/engines.py): RK4 at 16 ms, damping and springs on. Rotors are
actuators at sites, thrust and reaction torque by their gear, with their commands held at hover. Left out, all to MuJoCo's
advantage: contacts (disabled), drag, stops, servos, the rotors' lag. Massless bodies are merged into the next.

Two figures per model: `mj_step(model, data, n)`, a loop in C without output; and `mujoco.rollout`, a loop in C over a
batch that stores every state. A run is long enough for 0.2 s; medians over repeats of wall and of processor time, which
agree on an idle machine and of which the latter counts on a busy one. Flight starts anew every 25 steps. A model whose
joints' damping is too stiff for explicit RK4 at this step diverges, and MuJoCo then resets or freezes it: it is measured
again without damping and gravity, which cost no less.
"""

import argparse
import json
import os
import pathlib
import statistics
import sys
import time

import mujoco
import numpy as np
from mujoco import rollout

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent / "tests/witnesses"))
from engines import Model, MuJoCo, kind  # noqa: E402

STEP = 0.016
BATCH, HORIZON = 1024, 25


def timed(run, steps, repeats):
    run()
    wall, cpu = [], []
    for _ in range(repeats):
        w, c = time.perf_counter(), time.process_time()
        run()
        cpu.append(steps / (time.process_time() - c))
        wall.append(steps / (time.perf_counter() - w))
    return {"wall": statistics.median(wall), "cpu": statistics.median(cpu), "cpu_low": min(cpu), "cpu_high": max(cpu)}


def start(model):
    """At rest, floating roots 2 m up, hinges slightly off zero so that nothing is trivially still."""
    x = np.zeros(model.n_state)
    for i, body in enumerate(model.bodies):
        at = model.position[i]
        if kind(body) == "floating":
            x[at + 2], x[at + 6] = 2, 1
        elif kind(body) == "ball":
            x[at] = 1
        else:
            x[at] = 0.05
    return x


def measure(path, integrator, repeats, tame=False):
    model = Model(path)
    engine = MuJoCo(model, sites=True, timestep=STEP, integrator=integrator)
    m, d = engine.m, engine.d
    if tame:
        # numbers of the model, not flags: the engine does the same work
        m.dof_damping[:], m.jnt_stiffness[:] = 1e-12, 0
        m.opt.gravity[:] = 0, 0, -1e-12
    engine.set(start(model))
    weight = float(m.body_mass.sum()) * -float(m.opt.gravity[2])
    hover = np.minimum(weight / max(m.nu, 1), m.actuator_ctrlrange[:, 1]) if m.nu else np.zeros(0)
    state = mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.zeros(mujoco.mj_stateSize(m, state))
    mujoco.mj_getState(m, d, first, state)

    def loop(n):
        mujoco.mj_resetData(m, d)
        # forgets flight: what diverges is slower or faster to step than what flies
        for _ in range(n // HORIZON):
            mujoco.mj_setState(m, d, first, state)
            d.ctrl[:] = hover
            mujoco.mj_step(m, d, HORIZON)

    mujoco.set_mju_user_warning(lambda text: None)
    n = 20 * HORIZON
    begin = time.perf_counter()
    loop(n)
    n = max(1, int(0.2 / (time.perf_counter() - begin) * n) // HORIZON) * HORIZON
    out = {"model": model.name, "nv": int(m.nv), "rotors": int(m.nu), "integrator": integrator}
    out["mj_step"] = timed(lambda: loop(n), n, repeats)
    firsts = np.repeat(first[None], BATCH, 0)
    controls = np.broadcast_to(hover, (BATCH, HORIZON, m.nu)).copy()
    states, sensors = np.zeros((BATCH, HORIZON, len(first))), np.zeros((BATCH, HORIZON, m.nsensordata))
    with rollout.Rollout(nthread=0) as batch:
        run = lambda: batch.rollout(m, d, firsts, controls if m.nu else None, state=states, sensordata=sensors)
        out["rollout"] = timed(run, BATCH * HORIZON, repeats)
    if not np.isfinite(states).all() or sum(w.number for w in d.warning):
        if tame:
            raise SystemExit(f"{model.name} diverges")
        return measure(path, integrator, repeats, tame=True)
    return out | {"damped": not tame}


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("models", type=pathlib.Path, help="folder of model files NAME.json")
    ask.add_argument("--only", nargs="*", help="names of models")
    ask.add_argument("--integrator", default="RK4", help="RK4, Euler, implicitfast")
    ask.add_argument("--repeats", type=int, default=7)
    ask.add_argument("--out", type=pathlib.Path, help="file of JSON lines to append to")
    given = ask.parse_args()
    print(f"MuJoCo {mujoco.__version__}, {given.integrator} at {STEP} s, one core of {sorted(os.sched_getaffinity(0))}, "
          "contacts disabled; steps/s, median of processor time")
    print(f"{'model':32} {'nv':>3} {'rotors':>6} {'mj_step':>10} {'rollout':>10}   us/step  cpu/wall")
    for path in sorted(given.models.glob("*.json")):
        if given.only and path.stem not in given.only:
            continue
        row = {"peer": "mujoco", "version": mujoco.__version__, "dt": STEP}
        row |= measure(path, given.integrator, given.repeats)
        fast = row["mj_step"]
        print(f"{row['model']:32} {row['nv']:3} {row['rotors']:6} {fast['cpu']:10.0f} {row['rollout']['cpu']:10.0f} "
              f"{1e6 / fast['cpu']:9.2f} {fast['wall'] / fast['cpu']:9.2f}"
              + ("" if row["damped"] else "  without damping and gravity"), flush=True)
        if given.out:
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
