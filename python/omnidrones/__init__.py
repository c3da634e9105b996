"""Batched drone environments with exact gradients, learners and control design, compiled from Rust.

Needs NumPy alone; what adapts to other packages is imported when it is asked for:

=====================  =============================================================
`omnidrones.gym`       Gymnasium: `Env`, `VectorEnv`, ids such as "omnidrones:Hover-v0"
`omnidrones.pettingzoo`  PettingZoo: `parallel_env`
`omnidrones.sb3`       Stable-Baselines3: `VecEnv`
`omnidrones.torchrl`   TorchRL: `Env`
`omnidrones.torch`     PyTorch: gradients through steps
`omnidrones.ray`       Ray: shards of a batch on many machines
=====================  =============================================================

>>> import omnidrones
>>> env = omnidrones.make("Hover", 64, seed=0)
>>> observation = env.reset()
>>> step = env.step(env.sample(0))
>>> step.reward.shape
(64, 1)
"""

from __future__ import annotations

from . import _when_gymnasium
from ._core import (
    Adjoint,
    Allocation,
    AllocationFunction,
    CFunction,
    CModule,
    Controller,
    Design,
    Estimates,
    Figure,
    Flight,
    Jacobian,
    KalmanFilter,
    Loop,
    Mpc,
    OptimalTrajectory,
    Policy,
    Progress,
    Regulator,
    Run,
    StageQpSolution,
    StateEstimator,
    StateEstimatorBatch,
    StateSpace,
    SteadyKalman,
    Sweep,
    System,
    Tape,
    Trim,
    VecEnv,
    Vehicle,
    __version__,
    allocate,
    configurations,
    design,
    evaluate,
    export_c,
    export_onnx,
    fly,
    linearise,
    load_policy,
    lqg,
    lqr,
    optimise,
    plot,
    recipes,
    solve_stage_qp,
    steady_kalman,
    tasks,
    train,
    tune,
    vehicles,
)
from ._spec import Field, Space, Spec, Step

make = VecEnv

__all__ = [
    "Adjoint",
    "Allocation",
    "AllocationFunction",
    "CFunction",
    "CModule",
    "Controller",
    "Design",
    "Estimates",
    "Field",
    "Figure",
    "Flight",
    "Jacobian",
    "KalmanFilter",
    "Loop",
    "Mpc",
    "OptimalTrajectory",
    "Policy",
    "Progress",
    "Regulator",
    "Run",
    "Space",
    "Spec",
    "StageQpSolution",
    "StateEstimator",
    "StateEstimatorBatch",
    "StateSpace",
    "SteadyKalman",
    "Step",
    "Sweep",
    "System",
    "Tape",
    "Trim",
    "VecEnv",
    "Vehicle",
    "__version__",
    "allocate",
    "configurations",
    "design",
    "evaluate",
    "export_c",
    "export_onnx",
    "fly",
    "linearise",
    "load_policy",
    "lqg",
    "lqr",
    "make",
    "optimise",
    "plot",
    "recipes",
    "solve_stage_qp",
    "steady_kalman",
    "tasks",
    "train",
    "tune",
    "vehicles",
]

_ADAPTERS = ("gym", "pettingzoo", "ray", "sb3", "torch", "torchrl")


def __getattr__(name: str) -> object:
    if name in _ADAPTERS:
        import importlib

        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*__all__, *_ADAPTERS])


_when_gymnasium.register()
