//! The extension module `omnidrones._core`: what Python needs of the library, without a decision of its own.
//!
//! | file | what |
//! |---|---|
//! | `arrays` | NumPy arrays as rows, the only file that reaches into their memory |
//! | `settings` | dicts, files and keywords as layers of settings |
//! | `error` | errors as exceptions; work that Python may interrupt |
//! | `batch` | many environments: `VecEnv` |
//! | `device` | many environments on a GPU: `DeviceEnv` |
//! | `gradient` | tapes, sweeps, Jacobians |
//! | `system` | loops and allocations that are differentiated through many steps |
//! | `law` | controllers written in Python, and the parts of the library's cascade |
//! | `learn` | training, evaluation, policies |
//! | `course` | references and winds written in Python |
//! | `design` | margins of the loop that flies, feedback of least cost |
//! | `optimal` | trajectories of least cost, model predictive control, programs of linked stages |
//! | `estimation` | filters of what sensors read, Kalman filters |
//! | `number` | numbers that record: what a task, a controller or a system written in Python is called with |
//! | `scatter` | one controller on thousands of plants, and from thousands of starts |
//! | `export` | what flies as C99, policies as ONNX |
//! | `task` | tasks in Python |
//! | `figure` | the library's plots, for notebooks |
//! | `control` | vehicles, flights, linear models, allocation, tuning |
//!
//! What makes environments those of Gymnasium, PettingZoo, Stable-Baselines3, TorchRL, PyTorch and Ray is written in Python, beside
//! it in `omnidrones/`.

mod arrays;
mod batch;
mod control;
mod course;
mod design;
mod device;
mod error;
mod estimation;
mod export;
mod figure;
mod gradient;
mod law;
mod learn;
mod number;
mod optimal;
mod scatter;
mod settings;
mod system;
mod task;

/// Compiled part of `omnidrones`.
#[pyo3::pymodule(gil_used = true)]
mod _core {
    use omnidrones::tasks::registry;
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::batch::{_restore, VecEnv};
    #[pymodule_export]
    use super::control::{
        Allocation, Flight, StateSpace, Trim, Vehicle, allocate, configuration_names, fly, linearise, tune,
        vehicle_names,
    };
    #[pymodule_export]
    use super::design::{Design, Regulator, design, lqr};
    #[pymodule_export]
    use super::device::{
        _give_back, _restore_on_device, DeviceAdjoint, DeviceArray, DeviceEnv, DeviceGraph, DeviceSweep, DeviceTape,
    };
    #[pymodule_export]
    use super::estimation::{
        Estimates, KalmanFilter, StateEstimator, StateEstimatorBatch, SteadyKalman, lqg, steady_kalman,
    };
    #[pymodule_export]
    use super::export::{CFunction, CModule, export_c, export_onnx};
    #[pymodule_export]
    use super::figure::{Figure, plot_curves};
    #[pymodule_export]
    use super::gradient::{Adjoint, Jacobian, Sweep, Tape};
    #[pymodule_export]
    use super::law::{CascadeParts, attitude_error};
    #[pymodule_export]
    use super::learn::{
        _evaluation, _fly_shard, _restore_policy, Controller, Policy, Progress, Run, evaluate, load_policy, recipes,
        train,
    };
    #[pymodule_export]
    use super::number::{_check_places, _compute, _constants, _is_recording, _record};
    #[pymodule_export]
    use super::optimal::{Mpc, OptimalTrajectory, StageQpSolution, optimise, solve_stage_qp};
    #[pymodule_export]
    use super::scatter::{MonteCarloRun, RecoveryMap, monte_carlo, recovery_map};
    #[pymodule_export]
    use super::system::{_restore_system, AllocationFunction, Certificate, Loop, System};

    #[pymodule_export]
    use super::task::{
        _carried, _register, _register_record, _setting_keys, _task_name, _task_spec, Draws, Ends, Forest, Gate, Goal,
        Loss, Motion, Part, PyRobot, Start, TrackPath, View, Writer,
    };

    #[expect(non_upper_case_globals, reason = "as Python calls it")]
    #[pymodule_export]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    /// Names of the tasks.
    #[pyfunction]
    fn tasks() -> Vec<&'static str> {
        registry::names()
    }
}
