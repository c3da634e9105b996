"""What a step costs from Python beside the same loop in Rust, in one process: python python/benches/overhead.py [environments,...]

Subjects take turns for several rounds; of each the least of repeats of about a millisecond counts. One thread, Hover, rotors. What
is not installed is left out. `--peers` has EnvPool's CartPole beside it, whose cost per call is its own.
"""

import sys
import time

import numpy as np

import omnidrones

SETS, ROUNDS, BUDGET = 8, 6, 0.15


def least(call):
    """Least seconds per call within the budget."""
    now = time.perf_counter
    call(0)
    t = now()
    call(1)
    n = max(1, int(1e-3 / max(now() - t, 1e-9)))
    best, end = np.inf, now() + BUDGET
    while now() < end:
        t = now()
        for k in range(n):
            call(k & (SETS - 1))
        best = min(best, (now() - t) / n)
    return best


def rust(env, actions):
    """Least seconds per step of the loop without Python."""
    now = time.perf_counter
    env._steps(actions, 8)
    t = now()
    env._steps(actions, 8)
    n = max(8, int(1e-3 / ((now() - t) / 8)))
    best, end = np.inf, now() + BUDGET
    while now() < end:
        t = now()
        env._steps(actions, n)
        best = min(best, (now() - t) / n)
    return best


def subjects(n_env):
    """What is measured, by name."""
    how = dict(threads=1, stagger=True)
    env = omnidrones.make("Hover", n_env, seed=0, ring=1, **how)
    env.reset()
    rng = np.random.default_rng(0)
    actions = (rng.uniform(-0.1, 0.1, (SETS, n_env, 1, 4)) - 0.415).astype(np.float32)
    each, none, twos = list(actions), actions[:1], omnidrones.make("Hover", n_env, seed=0, ring=2, **how)
    twos.reset()
    yield "rust", lambda: rust(env, actions)
    yield "crossing", lambda: least(lambda k: env._steps(none, 0))
    yield "step, ring of 1", lambda: least(lambda k: env.step(each[k]))
    yield "step, ring of 2", lambda: least(lambda k: twos.step(each[k]))
    spec = env.spec
    own = dict(
        observation=np.empty((n_env, 1, spec.n_observation), np.float32),
        reward=np.empty((n_env, 1), np.float32),
        terminated=np.empty(n_env, bool),
        truncated=np.empty(n_env, bool),
        info=np.empty((n_env, len(spec.info)), np.float32),
    )
    yield "step_into", lambda: least(lambda k: env.step_into(each[k], **own))
    try:
        from omnidrones.gym import VectorEnv
    except ImportError:
        return
    flat = [np.ascontiguousarray(a.reshape(n_env, -1)) for a in actions]
    for copy in (False, True):
        for info in ("none", "columns"):
            vec = VectorEnv("Hover", n_env, autoreset_mode="SameStep", copy=copy, info=info, **how)
            vec.reset(seed=0)
            yield f"gymnasium, copy={copy}, info={info}", lambda vec=vec: least(lambda k: vec.step(flat[k]))


def envpool(n_env):
    """EnvPool's cost per call, one worker thread."""
    import envpool

    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=n_env, num_threads=1)
    env.reset()
    actions = np.zeros(n_env, np.int32)
    return least(lambda k: env.step(actions))


if __name__ == "__main__":
    sizes = [int(n) for a in sys.argv[1:] if a[0].isdigit() for n in a.split(",")] or [1, 1024, 4096]
    for n_env in sizes:
        measured = dict.fromkeys((all_subjects := dict(subjects(n_env))), np.inf)
        for _ in range(ROUNDS):
            for name, measure in all_subjects.items():
                measured[name] = min(measured[name], measure())
        base = measured["rust"]
        print(f"\n{n_env} environments                      us per call   beyond Rust [us]   share of Rust   M steps/s")
        for name, t in measured.items():
            print(f"  {name:36} {1e6 * t:12.2f} {1e6 * (t - base):18.2f} {base / t:15.3f} {n_env / t / 1e6:11.2f}")
        if "--peers" in sys.argv:
            t = min(envpool(n_env) for _ in range(ROUNDS))
            print(f"  {'EnvPool, CartPole':36} {1e6 * t:12.2f} {'':18} {'':15} {n_env / t / 1e6:11.2f}")
