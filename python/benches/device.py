"""What a card does through PyTorch, and crazyflow on the same card where it is installed: `.ci/device` runs this.

python python/benches/device.py [cuda] [seconds]     # `emulated` runs the same on the host
"""

import enum
import runpy
import sys
import time
import types
from pathlib import Path

import numpy as np
import torch

import omnidrones
from omnidrones.torch import Rollout, TensorEnv, captured

device = sys.argv[1] if len(sys.argv) > 1 else "cuda"
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 0.5
is_card = device.startswith("cuda")
EXAMPLES = Path(__file__).parent.parent / "examples"


def wait():
    if is_card:
        torch.cuda.synchronize()


def rate(work, n):
    """Of `n` things that each call does, per second."""
    work()
    wait()
    began, calls = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        work()
        calls += 1
        if calls % 10 == 0:
            wait()
    wait()
    return n * calls / (time.perf_counter() - began)


def bits_off(name, n_env=130, n_step=16, n_call=6):
    """Numbers of a captured window, its gradients and the states behind it that are not the host's: of all, and how many there are."""
    env, host = (omnidrones.make(name, n_env, device=where, seed=3, stagger=True) for where in (device, None))
    here = [Rollout(own, n_step, decay=0.99) for own in (env, host)]
    actions = [torch.from_numpy(host.sample(t)) for t in range(n_step)]
    own = [[a.to(rollout.tensors.device).requires_grad_() for a in actions] for rollout in here]

    def window(rollout, actions):
        rollout.begin()
        cost, told = torch.zeros((), device=rollout.tensors.device), []
        for action in actions:
            step = rollout.step(action)
            cost = cost + step.loss.sum() + step.reward.sum() + step.observation.sum()
            told += [step.observation, step.reward, step.loss]
        return [*told, *torch.autograd.grad(cost, actions)]

    env.reset(), host.reset()
    there = captured(lambda: window(here[0], own[0]), here[0].tensors)
    # a capture runs its work three times first, which the host does here
    for _ in range(3 if is_card else 0):
        window(here[1], own[1])
    off = n = 0
    for _ in range(n_call):
        a, b = there(), window(here[1], own[1])
        off += sum(int((x.cpu() != y).sum()) for x, y in zip(a, b))
        n += sum(x.numel() for x in b)
    return off + int((env.states() != host.states()).sum()), n + host.states().size


def steps(n_env):
    """Whole steps of Hover per second: asked for one by one with a tensor of actions, with graphs of one and of 32 steps."""
    env = TensorEnv(omnidrones.make("Hover", n_env, device=device, stagger=True))
    env.reset()
    action = torch.full((n_env, 1, 4), -0.41, device=env.device)
    one, many = env.env.graph(1), env.env.graph(32)
    return (
        rate(lambda: env.step(action), n_env),
        rate(lambda: env.env.replay(one), n_env),
        rate(lambda: env.env.replay(many), 32 * n_env),
    )


def learnt(example, argument, update):
    """Hover by an example, and the share of an update's time that kernels of the environments take."""
    sys.argv = [example, argument, device]
    began = time.perf_counter()
    ran = runpy.run_path(str(EXAMPLES / f"{example}.py"))
    print(f"  {example}: {time.perf_counter() - began:.1f} s with imports, kernels and capture")
    if is_card:
        from torch.profiler import ProfilerActivity, profile

        with profile(activities=[ProfilerActivity.CUDA]) as told:
            began = time.perf_counter()
            for _ in range(3):
                ran[update]()
            wait()
            taken = time.perf_counter() - began
        own = sum(row.self_device_time_total for row in told.key_averages() if row.key.startswith("od_")) / 1e6
        print(f"  of {taken / 3 * 1e3:.1f} ms of an update {100 * own / taken:.1f} % are kernels of the environments")


class Absent(types.ModuleType):
    """In place of a package in which another only writes formulas down while it is imported."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __call__(self, *_, **__):
        return self

    def __setitem__(self, *_):
        pass

    def __iter__(self):
        return iter(())

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __call__
    __pow__ = __matmul__ = __rmatmul__ = __neg__ = __lt__ = __gt__ = __le__ = __ge__ = __getitem__ = __call__


def crazyflow(dynamics, n_env, n_step=200):
    """Steps per second of crazyflow, fused in one scan: no observation, no reward, no restart."""
    try:
        import casadi  # noqa: F401
    except ImportError:
        sys.modules["casadi"] = Absent("casadi")
    if sys.version_info < (3, 12):  # it asks whether a text is in an enumeration
        known = enum.EnumType.__contains__
        enum.EnumType.__contains__ = lambda own, x: known(own, x) if isinstance(x, enum.Enum) else x in own._value2member_map_
    import jax
    from crazyflow.control import Control
    from crazyflow.sim import Dynamics, Sim
    from crazyflow.sim.functional import attitude_control

    where = "gpu" if is_card else "cpu"
    sim = Sim(n_worlds=n_env, n_drones=1, dynamics=Dynamics(dynamics), control=Control("attitude"), freq=500, device=where)
    sim.reset()
    command = jax.numpy.asarray(np.tile(np.array([0, 0, 0, 0.35], np.float32), (n_env, 1, 1)))
    step = sim.build_step_fn()
    return rate(lambda: jax.block_until_ready(step(attitude_control(sim.data, command), n_step).states.pos), n_env * n_step)


print(f"{torch.cuda.get_device_name() if is_card else device}, PyTorch {torch.__version__}")
print("\nbits that are not the processor's, a captured window of 16 steps with its gradients, six times")
for name in ("Hover", "HoverRand", "PayloadHover", "Spread"):
    off, n = bits_off(name)
    print(f"  {name:<14} {off} of {n:,}")
print(f"\nwhole steps of Hover per second\n  {'batch':>9} {'step(tensor)':>14} {'graph of 1':>14} {'graph of 32':>14}")
for n_env in (64, 1024, 4096, 65_536, 1 << 20) if is_card else (64, 1024):
    print(f"  {n_env:>9} " + " ".join(f"{x:>14.3e}" for x in steps(n_env)))
print("\nHover learnt by examples, the clock beginning with the first update")
for example, argument, update in (("apg_torch", "800" if is_card else "3", "descend"), ("ppo_torch", "3e7" if is_card else "7e4", "train")):
    learnt(example, argument, update)
print("\ncrazyflow's steps per second, 200 in one scan, without observations, rewards and restarts")
for dynamics in ("first_principles", "so_rpy"):
    for n_env in (4096, 65_536, 1 << 20) if is_card else (4096,):
        try:
            print(f"  {dynamics:<18} {n_env:>9} {crazyflow(dynamics, n_env):>14.3e}")
        except ImportError as error:
            print(f"  not run: {error}")
