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

from . import _when_gymnasium, functions
from ._core import (
    Adjoint,
    Allocation,
    AllocationFunction,
    CFunction,
    CModule,
    CascadeParts,
    Certificate,
    Controller,
    Design,
    DeviceAdjoint,
    DeviceArray,
    DeviceEnv,
    DeviceGraph,
    DeviceSweep,
    DeviceTape,
    Estimates,
    Figure,
    Flight,
    Jacobian,
    KalmanFilter,
    Loop,
    MonteCarloRun,
    Mpc,
    OptimalTrajectory,
    Policy,
    Progress,
    RecoveryMap,
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
    attitude_error,
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
    monte_carlo,
    optimise,
    plot,
    recipes,
    recovery_map,
    solve_stage_qp,
    steady_kalman,
    tasks,
    train,
    tune,
    vehicles,
)
from ._law import ControlLaw, LawInput, Setpoint
from ._make import make
from ._number import Mask, Number, RecordingError, array, zeros
from ._spec import Field, Space, Spec, Step
from ._task import (
    Ends,
    Forest,
    Gate,
    Inertial,
    Loss,
    PathSettings,
    Robot,
    Setting,
    Start,
    Success,
    Task,
    TrackPath,
    View,
    Writer,
    register,
)

__all__ = [
    "Adjoint",
    "Allocation",
    "AllocationFunction",
    "CFunction",
    "CModule",
    "CascadeParts",
    "Certificate",
    "ControlLaw",
    "Controller",
    "Design",
    "DeviceAdjoint",
    "DeviceArray",
    "DeviceEnv",
    "DeviceGraph",
    "DeviceSweep",
    "DeviceTape",
    "Ends",
    "Estimates",
    "Field",
    "Figure",
    "Flight",
    "Forest",
    "Gate",
    "Inertial",
    "Jacobian",
    "KalmanFilter",
    "LawInput",
    "Loop",
    "Loss",
    "Mask",
    "MonteCarloRun",
    "Mpc",
    "Number",
    "OptimalTrajectory",
    "PathSettings",
    "Policy",
    "Progress",
    "RecordingError",
    "RecoveryMap",
    "Regulator",
    "Robot",
    "Run",
    "Setting",
    "Setpoint",
    "Space",
    "Spec",
    "StageQpSolution",
    "Start",
    "StateEstimator",
    "StateEstimatorBatch",
    "StateSpace",
    "SteadyKalman",
    "Step",
    "Success",
    "Sweep",
    "System",
    "Tape",
    "Task",
    "TrackPath",
    "Trim",
    "VecEnv",
    "Vehicle",
    "View",
    "Writer",
    "__version__",
    "allocate",
    "array",
    "attitude_error",
    "configurations",
    "design",
    "evaluate",
    "export_c",
    "export_onnx",
    "fly",
    "functions",
    "linearise",
    "load_policy",
    "lqg",
    "lqr",
    "monte_carlo",
    "make",
    "optimise",
    "plot",
    "recipes",
    "register",
    "recovery_map",
    "solve_stage_qp",
    "steady_kalman",
    "tasks",
    "train",
    "tune",
    "vehicles",
    "zeros",
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
