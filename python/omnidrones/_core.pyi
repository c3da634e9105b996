"""
Compiled part of `omnidrones`.
"""

from _typeshed import SupportsGetItem, SupportsLenAndGetItem
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Final, SupportsFloat, SupportsIndex, final
from typing_extensions import disjoint_base

__all__ = ["__version__", "Adjoint", "Allocation", "AllocationFunction", "CFunction", "CModule", "CascadeParts", "Certificate", "Controller", "Design", "DeviceAdjoint", "DeviceArray", "DeviceEnv", "DeviceGraph", "DeviceSweep", "DeviceTape", "Draws", "Ends", "Estimates", "Figure", "Flight", "Forest", "Gate", "Goal", "Jacobian", "KalmanFilter", "Loop", "Loss", "MonteCarloRun", "Motion", "Mpc", "OptimalTrajectory", "Part", "Policy", "Progress", "RecoveryMap", "Regulator", "Robot", "Run", "StageQpSolution", "Start", "StateEstimator", "StateEstimatorBatch", "StateSpace", "SteadyKalman", "Sweep", "System", "Tape", "TrackPath", "Trim", "VecEnv", "Vehicle", "View", "Writer", "_carried", "_check_places", "_compute", "_constants", "_evaluation", "_fly_shard", "_give_back", "_is_recording", "_record", "_register", "_register_record", "_restore", "_restore_on_device", "_restore_policy", "_restore_system", "_setting_keys", "_task_name", "_task_spec", "allocate", "attitude_error", "configurations", "design", "evaluate", "export_c", "export_onnx", "fly", "linearise", "load_policy", "lqg", "lqr", "monte_carlo", "optimise", "plot", "recipes", "recovery_map", "solve_stage_qp", "steady_kalman", "tasks", "train", "tune", "vehicles"]

__version__: Final[str]

@final
class Adjoint:
    """
    The adjoint of one step of a task, compiled: `VecEnv.adjoint` makes it.
    """
    @property
    def n_carried(self, /) -> int:
        """
        Numbers that go from step to step: physics, memory of the task, delay line, history.
        """
    def sweep(self, /, decay: SupportsFloat | SupportsIndex = 1.0, clip: SupportsFloat | SupportsIndex = ...) -> Sweep:
        """
        A sweep that begins behind any step of a tape, with nothing carried.

        `decay` is a factor per step on what is carried, 1 the exact gradient; `clip` the largest norm of it, per environment.
        """

@final
class Allocation:
    """
    Which rotor thrusts make a wrench.
    """
    @property
    def delivered(self, /) -> Any:
        """
        The wrench that they make, float64 [6]: force (N), moment about the centre of mass (N m), body axes.
        """
    @property
    def residual(self, /) -> float:
        """
        Largest violation of the optimality conditions, recomputed and scaled.
        """
    @property
    def solved(self, /) -> bool:
        """
        Whether that is small enough to act on; if not, `thrust` is the preferred one within its limits.
        """
    @property
    def thrust(self, /) -> Any:
        """
        float64 [rotor], N.
        """

@final
class AllocationFunction(System):
    """
    The allocation of a vehicle as a differentiable system, of which every step answers another problem: inputs are the wrench (6), then
    `numbers` in their order; the state behind the step is the rotors' thrusts, N. What cannot be certified is NaN.

    Minimised is (B u - w)' W (B u - w) / 2 + rho |u - u_pref|^2 / 2 within lower <= u <= upper: the library's quadratic programme, whose
    derivative is that of its optimality conditions.
    """
    def __new__(cls, /, vehicle: Any) -> AllocationFunction:
        """
        Of a `Vehicle`, its name or file.
        """
    @property
    def numbers(self, /) -> dict:
        """
        Nominal numbers behind the wrench, new float64 arrays by name: "weights" [6] (W), "regularisation" [1] (rho), "geometry" [rotor, 6]
        (the columns of B), "preference", "lower" and "upper" [rotor] (N).
        """

@final
class CFunction:
    """
    A function of a module that callers see.
    """
    def __repr__(self, /) -> str: ...
    @property
    def about(self, /) -> str:
        """
        What it computes.
        """
    @property
    def name(self, /) -> str:
        """
        "hover_policy_step".
        """
    @property
    def operations(self, /) -> int:
        """
        Of one call; a loop that ends early counts once.
        """
    @property
    def operations_at_most(self, /) -> int:
        """
        Of one call at most.
        """
    @property
    def prototype(self, /) -> str:
        """
        As the header declares it.
        """
    @property
    def stack(self, /) -> int:
        """
        Bytes of stack at most; compilers need less.
        """

@final
class CModule:
    """
    Something as C99: a header, a source, a test with golden vectors and a description. `export_c` makes it.
    """
    def __repr__(self, /) -> str: ...
    def check(self, /) -> str:
        """
        Compiles it with the machine's C compiler (`$CC`, or `cc`), all warnings errors, runs its test and returns what that said. Raises
        `ValueError` with what compiler or test said where one fails, `FileNotFoundError` where there is no compiler.
        """
    @property
    def files(self, /) -> dict:
        """
        The text of its files by name.
        """
    @property
    def functions(self, /) -> list[CFunction]:
        """
        What callers see, a list of `CFunction`.
        """
    @property
    def memory(self, /) -> int:
        """
        Bytes that a caller keeps from call to call; 0 where nothing is.
        """
    @property
    def name(self, /) -> str:
        """
        What its files and functions begin with.
        """
    @property
    def precision(self, /) -> str:
        """
        Of its numbers: "float" or "double".
        """
    @property
    def tables(self, /) -> int:
        """
        Bytes of constant tables.
        """
    @property
    def title(self, /) -> str:
        """
        What it is, in a line.
        """
    def write(self, /, folder: str | PathLike[str], force: bool = False) -> list[Path]:
        """
        Writes its files into a folder, which is made where it is missing, and returns their paths. Raises `ValueError` where a file is
        there and is another, unless `force`.
        """

@final
class CascadeParts:
    """
    What the library's cascade believes of a vehicle, and its levels as functions of recorded numbers: for a `ControlLaw` that is made of
    them.

    Parameters
    ----------
    vehicle : Vehicle or str or path
    **physics
        `effects`: drag that is not simulated is not fed forward.

    An attitude command is 16 numbers: thrust along body z (N), wanted attitude by rows (body to world), its angular velocity (rad/s) and
    angular acceleration (rad/s^2) in its own axes. A rate command is 7: thrust, angular velocity, angular acceleration, body axes.
    """
    def __new__(cls, vehicle: Any, /, **physics) -> CascadeParts: ...
    def __repr__(self, /) -> str: ...
    def actions(self, /, wrench: Any) -> Any:
        """
        Rotor actions in [-1, 1] for a wrench [F_z, M_x, M_y, M_z] (N, N m; body); yaw gives way first.
        """
    def attitude_command(self, /, gains: Any, *, velocity: Any, acceleration: Any, jerk: Any, snap: Any, yaw: Any, attitude: Any, measured: Any) -> Any:
        """
        The attitude command [16] that follows a velocity command: `velocity` (m/s), feed-forward `acceleration`, `jerk` and `snap` [3],
        world, and `yaw` with its rate and acceleration [3], at the measured `attitude` and `measured` velocity, with gains [3] of velocity.
        """
    def drag(self, /, attitude: Any, velocity: Any) -> Any:
        """
        The acceleration that balances linear drag at a velocity [3], m/s, world, or its derivatives at those of the velocity.
        """
    @property
    def gravity(self, /) -> float:
        """
        m/s^2.
        """
    @property
    def inertia(self, /) -> Any:
        """
        About the centre of mass, axes in which it hovers level, float64 [3, 3], kg m^2.
        """
    @property
    def mass(self, /) -> float:
        """
        kg.
        """
    @property
    def max_thrust(self, /) -> Any:
        """
        Largest thrust per rotor, float64 [rotor], N.
        """
    @property
    def memory(self, /) -> dict:
        """
        The memory of the cascade before its first tick, by name: "attitude" [16], "rate" [7], "rotors" [rotor].
        """
    @property
    def mixer(self, /) -> Any:
        """
        Thrusts per [F_z, M_x, M_y, M_z], float64 [rotor, 4]: what `actions` distributes by.
        """
    def rate_command(self, /, attitude_gains: Any, rate_gains: Any, command: Any, attitude: Any, angular_velocity: Any) -> Any:
        """
        The rate command [7] that follows an attitude command [16], with gains [3] of attitude and of rate.
        """
    def upright(self, /, attitude: Any, angular_velocity: Any) -> tuple[Any, Any]:
        """
        Attitude [4] and angular velocity [3] of the axes in which the vehicle hovers level, of those of its body.
        """
    def wrench(self, /, rate_gains: Any, command: Any, attitude: Any, velocity: Any, angular_velocity: Any) -> Any:
        """
        Force along body z and moments [4] that follow a rate command [7], with gains [3] of rate.
        """

@final
class Certificate:
    """
    How well three derivations of a step's Jacobian agree at a point: the adjoint (reverse), duals (forward) and central differences.
    `print` shows it.
    """
    def __repr__(self, /) -> str: ...
    @property
    def adjoint_error(self, /) -> float:
        """
        Largest |adjoint - dual|, relative to the column; bound 1e-10.
        """
    @property
    def difference_error(self, /) -> float:
        """
        Largest |dual - central difference|, likewise; bound 1e-7.
        """
    @property
    def holds(self, /) -> bool:
        """
        Whether all are within their bounds.
        """
    @property
    def kinks(self, /) -> int:
        """
        Columns along which two smooth pieces meet at the point: certify beside it.
        """
    @property
    def n_entry(self, /) -> int:
        """
        Entries compared.
        """
    @property
    def taylor_order(self, /) -> float | None:
        """
        Order of the Taylor remainder, 2 within 0.1 where the Jacobian is right; None where the step is affine.
        """
    @property
    def value_error(self, /) -> float:
        """
        Largest |program - direct step|, relative to the state; bound 1e-12.
        """

@final
class Controller:
    """
    The library's own controllers as a policy: what learners have to beat. One per environment in rotor mode, which sees the true
    state; `controller(env)` gives actions [E, A, action]. With a `name` of the table of controllers, as "mpc", that one flies in place
    of the usual one, where it is made for what flies; or a `ControlLaw`, which knows the nominal numbers of what flies. All environments are flown at once on the environment's threads.
    """
    def __call__(self, /, env: VecEnv) -> Any:
        """
        Actions of all agents for the state as it is, a new float32 array [E, A, action]. `reset` of an environment needs a new
        controller, or `forget`.
        """
    def __new__(cls, /, env: VecEnv, name: Any | None = None) -> Controller: ...
    def forget(self, /, environment: SupportsIndex) -> None:
        """
        Makes a new controller for one environment at the next call: where an episode began.
        """
    @property
    def name(self, /) -> str:
        """
        What flies, in one word.
        """

@final
class Design:
    """
    The control loop of a vehicle about hover, sampled, with all its rates, holds and latency, and what it bears.
    """
    def __repr__(self, /) -> str: ...
    def margins(self, /, point: str | None = None) -> dict:
        """
        What the loop bears at a point, by name: "stable", "gain_up" and "gain_down" (factors), "phase" (rad), "delay" (s) and "disk"
        ("alpha", "omega" in rad/s, "gain", "phase"). Without a point the disk margin of all commands at once.
        """
    def open(self, /, point: str) -> StateSpace:
        """
        The loop opened at a point, over a period: a system of as many inputs and outputs as it has steps, to be closed with -1.
        """
    @property
    def period(self, /) -> int:
        """
        Steps of that period.
        """
    @property
    def points(self, /) -> list[str]:
        """
        Where the loop may be opened: commands, then numbers that the controller sees.
        """
    @property
    def poles(self, /) -> Any:
        """
        Poles of the closed loop over a period of all its rates, largest first, complex128 [pole]: stable within the unit circle.
        """
    def sensitivity(self, /, point: str, frequencies: Any) -> Any:
        """
        The sensitivity at a point over frequencies (rad/s, up to pi/dt), complex128 [frequency]: S = 1/(1 + L), so the loop is 1/S - 1.
        """
    @property
    def stability(self, /) -> str:
        """
        Whether it settles: "stable", "marginal: ..." with the combinations of states that commands do not settle, or "unstable: ...".
        """
    @property
    def trim(self, /) -> Trim:
        """
        The steady flight, and the linear model of the plant alone.
        """

@final
class DeviceAdjoint:
    """
    The adjoint of one step of a task on a device: `DeviceEnv.adjoint` makes it.
    """
    @property
    def n_carried(self, /) -> int:
        """
        Numbers that go from step to step: physics, memory of the task, delay line, history.
        """
    def sweep(self, /, decay: SupportsFloat | SupportsIndex = 1.0, clip: SupportsFloat | SupportsIndex = ...) -> DeviceSweep:
        """
        A sweep that begins behind any step of a tape, with nothing carried: see `Adjoint.sweep`.
        """

@final
class DeviceArray:
    """
    Numbers of an environment where they lie on its device; the next step writes them anew.

    `torch.from_dlpack(array)`, `cupy.from_dlpack(array)` and `jax.dlpack.from_dlpack(array)` are views of the same memory, which stays as
    long as one of them does. NVIDIA's array interface is there for CuPy and Numba. `array.numpy()` is a copy on the host.
    """
    def __array__(self, /, dtype: Any | None = None, copy: bool | None = None) -> Any:
        """
        As `numpy`.
        """
    @property
    def __cuda_array_interface__(self, /) -> dict:
        """
        NVIDIA's array interface, version 3; arrays of the stand-in have none.
        """
    def __dlpack__(self, /, *, stream: SupportsIndex | None = None, max_version: tuple[SupportsIndex, SupportsIndex] | None = None, dl_device: tuple[SupportsIndex, SupportsIndex] | None = None, copy: bool | None = None) -> Any:
        """
        A capsule of DLPack. Work of `stream`, the consumer's, waits for what was asked for so far; later steps do not wait for it.
        """
    def __dlpack_device__(self, /) -> tuple[int, int]:
        """
        Kind and number of the device, as DLPack counts them; for the stand-in those of the host.
        """
    def __len__(self, /) -> int: ...
    def __repr__(self, /) -> str: ...
    @property
    def device(self, /) -> str:
        """
        Where it lies: "cuda:0"; "emulated" is the host in place of a card.
        """
    @property
    def dtype(self, /) -> Any:
        """
        A `numpy.dtype`: float32, or bool.
        """
    def numpy(self, /) -> Any:
        """
        A copy on the host, when what was asked for before is done.
        """
    @property
    def shape(self, /) -> tuple:
        """
        Numbers along each axis.
        """
    @property
    def strides(self, /) -> tuple:
        """
        From one number to the next along each axis, in numbers.
        """

@final
class DeviceEnv:
    """
    Many environments of one task on a device: E environments of A agents, with the episodes and the bits of a `VecEnv` of the same settings.

    `make(name, num_envs, device="cuda")` makes them; settings are those of `VecEnv`. Arrays stay on the device and are the same objects
    always: `DeviceArray`s, which others see by DLPack. A step is asked for and not waited for. Work goes to the default stream of the
    card, or to `stream`; whoever reads arrays on another one orders the two.

    Raises
    ------
    ValueError
        For what `VecEnv` refuses; where there is no driver, no card or no compiler; for tasks with sensors, estimates and controllers that
        actions correct, which the host alone has.
    """
    def __new__(cls, name: Any, /, num_envs: SupportsIndex | None = None, *, device: str = "cuda", config: Any | None = None, seed: Any | None = None, threads: SupportsIndex | None = None, **settings) -> DeviceEnv: ...
    def __reduce__(self, /) -> tuple[Any, tuple]:
        """
        Pickles and copies are of the settings, the device's name and the exact state, with its observations.
        """
    def __repr__(self, /) -> str: ...
    @property
    def _kept_by_graphs(self, /) -> tuple[int, int]:
        """
        What a graph of PyTorch's keeps of these environments beside arrays, and later settings do not reach.
        """
    @property
    def action(self, /) -> DeviceArray:
        """
        Actions that `step()` and graphs step with, [E, A, action]: write there.
        """
    def adjoint(self, /, parameters: bool = False) -> DeviceAdjoint:
        """
        The adjoint of a step as a kernel; with `parameters`, sweeps also give gradients by the physical numbers that differ between
        environments.
        """
    @property
    def central(self, /) -> DeviceArray:
        """
        State of the whole team for critics, [E, central].
        """
    def column(self, /, name: str) -> DeviceArray:
        """
        One column of `info`, [E]: "return", "success", "position_error".
        """
    @property
    def config(self, /) -> dict:
        """
        All settings as a dict.
        """
    @property
    def device(self, /) -> str:
        """
        Where they are: "cuda:0"; "emulated" is the host in place of a card.
        """
    @property
    def device_name(self, /) -> str:
        """
        What the device calls itself.
        """
    @property
    def final_central(self, /) -> DeviceArray:
        """
        The last central state of episodes that ended in the last step, [E, central]; other rows hold older numbers.
        """
    @property
    def final_observation(self, /) -> DeviceArray:
        """
        The last observation of episodes that ended in the last step, [E, A, observation]; other rows hold older numbers.
        """
    def goals(self, /) -> Any:
        """
        The goal of every environment, a new NumPy array [E, goal].
        """
    def graph(self, /, n: SupportsIndex = 1) -> DeviceGraph:
        """
        `n` steps with what lies in `action`, as one piece of work for `replay`: small batches take less time to step than their kernels to be
        asked for.
        """
    @property
    def info(self, /) -> DeviceArray:
        """
        What the last step told of every episode, [E, column]; `spec.info` names the columns.
        """
    @property
    def layout(self, /) -> dict:
        """
        Places among the arguments and results of a step by name, as slices: see `Jacobian.layout`.
        """
    def load(self, /, state: bytes) -> None:
        """
        Goes on from what `save` gave, here or on the host, to environments of the same settings.
        """
    @property
    def num_envs(self, /) -> int:
        """
        Environments, E.
        """
    @property
    def observation(self, /) -> DeviceArray:
        """
        Of the last step or reset, [E, A, observation].
        """
    def observe(self, /) -> DeviceArray:
        """
        Writes what the environments look like now and returns the observations; nothing moves on.
        """
    def on_host(self, /) -> VecEnv:
        """
        The same environments on the host, as they are now: a `VecEnv` that goes its own way from here.
        """
    @property
    def privileged(self, /) -> DeviceArray:
        """
        The physical numbers that differ between environments, [E, number], SI; `spec.privileged` names them.
        """
    def replay(self, /, graph: DeviceGraph) -> Any:
        """
        Steps as a graph does.
        """
    def reset(self, /, seed: Any | None = None, mask: Any | None = None) -> DeviceArray:
        """
        Begins episodes and returns the observations, [E, A, observation].

        `seed` is one whole number or one per environment; `mask` chooses environments, bool [E], of NumPy or on the device. A mask on the device
        waits for nothing, unless seeds are given, some have never begun, or steps are being recorded.
        """
    @property
    def reward(self, /) -> DeviceArray:
        """
        Of the last step, [E, A]; the agents of an environment share one number.
        """
    @property
    def safe_command(self, /) -> Any:
        """
        The command that an action stands for which is no number, a NumPy array [A * command].
        """
    def sample(self, /, draw: SupportsIndex, out: Any | None = None) -> Any:
        """
        Random actions within their space, a NumPy array [E, A, action]: those of a `VecEnv` for the same draw.
        """
    def save(self, /) -> bytes:
        """
        The exact state of all environments as bytes, as those of `VecEnv.save`.
        """
    def set_difficulty(self, /, share: SupportsFloat | SupportsIndex) -> None:
        """
        From the next restarts on, episodes take this share of all randomisation, 0 to 1.
        """
    def set_state(self, /, environment: SupportsIndex, state: Any) -> None:
        """
        Overwrites the physical state of one environment, a NumPy array [state]; its episode goes on.
        """
    def set_statistics(self, /, count: SupportsFloat | SupportsIndex, mean: SupportsGetItem[int, SupportsFloat | SupportsIndex], variance: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> None:
        """
        Freezes other statistics, and collects none from now on.
        """
    @property
    def spec(self, /) -> Any:
        """
        Names, sizes, units and bounds: a `Spec`.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the columns of `states()`, with units.
        """
    def states(self, /) -> Any:
        """
        The physical state of every environment, a new NumPy array [E, state]; `state_names` names the columns.
        """
    @property
    def statistics(self, /) -> tuple[float, Any, Any]:
        """
        Of the stage `normalise`: (count, mean, variance), without one of no numbers.
        """
    def step(self, /, actions: Any | None = None) -> Any:
        """
        One step of every environment; returns a `Step` of `DeviceArray`s, the same objects always.

        `actions` are float32 [E, A, action] or [E, A * action]: on the device, where they are read in place, or of NumPy. Without, they are
        what lies in `action`.
        """
    def step_recorded(self, /, actions: Any | None, tape: DeviceTape) -> Any:
        """
        As `step`, remembered by the tape.
        """
    @property
    def stream(self, /) -> int:
        """
        The stream of the driver that work goes to, a handle: `torch.cuda.current_stream().cuda_stream`; 0 is the default one. It must live as
        long as work goes to it.
        """
    @stream.setter
    def stream(self, /, stream: SupportsIndex) -> None: ...
    def synchronise(self, /) -> None:
        """
        Waits until all that was asked for is done.
        """
    def tape(self, /, horizon: SupportsIndex) -> DeviceTape:
        """
        Memory on the device for so many recorded steps.
        """
    @property
    def terminated(self, /) -> DeviceArray:
        """
        Whether the task ended the episode in the last step, bool [E].
        """
    @property
    def truncated(self, /) -> DeviceArray:
        """
        Whether the time of the episode was over in the last step, bool [E].
        """
    def update_normaliser(self, /) -> None:
        """
        Takes the statistics of all observations since the last call into the stage `normalise`, and freezes them.
        """

@final
class DeviceGraph:
    """
    Steps of a `DeviceEnv` as one piece of work: `DeviceEnv.graph` makes it.
    """
    def __len__(self, /) -> int:
        """
        Steps.
        """

@final
class DeviceSweep:
    """
    A reverse sweep over a tape on a device, step by step from the last to the first.
    """
    def add_carried(self, /, cotangents: Any) -> None:
        """
        Adds to what is carried, a NumPy array [E, carried], between pulls.
        """
    def carried(self, /) -> Any:
        """
        Cotangents of what the environments carried into the last step pulled, a new NumPy array [E, carried]: physics first.
        """
    @property
    def dropped(self, /) -> int:
        """
        Gradients that were not finite and became zero, environments times steps.
        """
    def parameters(self, /) -> Any:
        """
        Gradients by the physical numbers that differ between environments, summed over all steps pulled, a new NumPy array [E, number]; no
        columns unless the adjoint was made with parameters.
        """
    def pull(self, /, tape: DeviceTape, t: SupportsIndex, *, observation: Any | None = None, reward: Any | None = None, loss: Any | None = None, central: Any | None = None, final_observation: Any | None = None, final_central: Any | None = None, final_carried: Any | None = None) -> DeviceArray:
        """
        Pulls cotangents on the device back through step `t` of a tape and returns those of its actions, [E, A * command], which lie there and
        change with the next pull. What they are: see `Sweep.pull`.
        """
    def restart(self, /) -> None:
        """
        Begins again behind any step, with nothing carried.
        """

@final
class DeviceTape:
    """
    What `DeviceEnv.step_recorded` remembers of up to so many steps, on the device.
    """
    def __len__(self, /) -> int:
        """
        Steps recorded.
        """
    def clear(self, /) -> None:
        """
        Forgets all steps and keeps the memory.
        """
    @property
    def horizon(self, /) -> int:
        """
        Steps that fit.
        """

@final
class Draws:
    """
    Draws of one stream.
    """
    def below(self, /, n: SupportsIndex, *, other_than: Any | None = None) -> Any:
        """
        A whole number, uniform in 0..n; with `other_than` none of these numbers, of which there are fewer than n: drawn again while it is one.
        That is for tasks with `start_on_host = True`.
        """
    def geometric(self, /, mean: SupportsFloat | SupportsIndex) -> Any:
        """
        Steps until something happens that comes once in `mean` >= 1 steps: 1 or more.
        """
    def normal(self, /) -> Any:
        """
        Standard normal.
        """
    def normal_within(self, /, bound: SupportsFloat | SupportsIndex) -> Any:
        """
        Standard normal, drawn again while it is farther from zero than `bound`, 0.1 at least.
        """
    def sometimes(self, /, chance: SupportsFloat | SupportsIndex) -> tuple[Any, Any]:
        """
        With this chance a mask that holds, and a unit draw that then means something.
        """
    def trunks(self, /, forest: Forest, standing: Any) -> Any:
        """
        Offsets of a forest's trunks from their nominal places, m, world, [trunk, 3], of which the first `standing` stand (the nearest whole
        number), the others far below. For tasks with `start_on_host = True`.
        """
    def uniform(self, /, low: Any, high: Any) -> Any:
        """
        Uniform between two numbers, or between two arrays number by number.
        """
    def unit(self, /) -> Any:
        """
        Uniform in [0, 1).
        """

@final
class Ends:
    """
    Takes reasons to terminate, and when each holds.
    """
    def when(self, /, name: str, condition: str, mask: Any) -> None:
        """
        The next reason: its name, its condition in words, and the mask that holds it.
        """

@final
class Estimates:
    """
    What a filter made of readings, sample by sample.
    """
    def __len__(self, /) -> int:
        """
        Samples.
        """
    def __repr__(self, /) -> str: ...
    @property
    def angular_velocity(self, /) -> Any | None:
        """
        rad/s, body axes, float64 [sample, 3]; None of a flight.
        """
    @property
    def attitude(self, /) -> Any:
        """
        Body to world, [w, x, y, z], float64 [sample, 4].
        """
    @property
    def bias_deviations(self, /) -> dict | None:
        """
        Their standard deviations, likewise.
        """
    @property
    def biases(self, /) -> dict | None:
        """
        Biases of sensors, float64 arrays [sample] by name; None of a flight.
        """
    @property
    def deviations(self, /) -> Any | None:
        """
        Standard deviations of position (m), velocity (m/s) and attitude (rad, about the axes of the inertial unit), float64 [sample, 9];
        None of an estimator that does not know how good it is.
        """
    @property
    def errors(self, /) -> Any | None:
        """
        By how much the truth differs: position, velocity, attitude as in `deviations`, float64 [sample, 9]; None where `run` was told no
        truth, and of a flight.
        """
    @property
    def nees(self, /) -> float | None:
        """
        Mean of the squared errors (NEES): 9 where the filter is consistent; None without a truth or deviations, as the next one.
        """
    @property
    def position(self, /) -> Any:
        """
        m, world, float64 [sample, 3].
        """
    @property
    def records(self, /) -> list:
        """
        How readings agreed with what was expected, sensor by sensor and quantity by quantity: a dict of "name", "n" (readings that came),
        of those "left_out" (beyond the gate) and "lost" (no numbers, or not valid), "believed_again" (after its patience) and "mean" (squared
        innovation per number of those taken in: 1 where all is consistent).
        """
    @property
    def rms(self, /) -> dict | None:
        """
        Root mean square errors by name: "position" (m), "velocity" (m/s), "attitude" (rad); None without a truth.
        """
    @property
    def saturated(self, /) -> int:
        """
        Samples of the inertial unit at a limit, or no numbers.
        """
    @property
    def share_within(self, /) -> float | None:
        """
        Share of samples whose squared error is within the 95 % bounds of chi-squared, 2.70 to 19.02.
        """
    @property
    def squared_errors(self, /) -> Any | None:
        """
        e' P^-1 e over these nine numbers, float64 [sample]: chi-squared with nine degrees of freedom where the filter is consistent.
        """
    @property
    def velocity(self, /) -> Any:
        """
        m/s, world, float64 [sample, 3].
        """

@final
class Figure:
    """
    A figure: a notebook shows it, `save` writes it.
    """
    def _repr_svg_(self, /) -> str: ...
    def save(self, /, path: str | PathLike[str]) -> None:
        """
        Writes it as PNG or SVG, by the extension of the path; a file that is there is replaced.
        """
    def svg(self, /) -> str:
        """
        As an SVG document.
        """

@final
class Flight:
    """
    A flight: columns of what was, of what was wanted, of what the rotors did.
    """
    def __len__(self, /) -> int:
        """
        Samples.
        """
    def __repr__(self, /) -> str: ...
    def _repr_svg_(self, /) -> str:
        """
        What notebooks show: the overview.
        """
    def columns(self, /) -> dict:
        """
        Columns by name with unit, new float64 arrays [sample], as in the files of the command line: what `pandas.DataFrame` takes.
        """
    @property
    def diverged_at(self, /) -> float | None:
        """
        When the state exploded, s; None for a whole flight.
        """
    @property
    def estimates(self, /) -> Estimates | None:
        """
        What the estimator made of the sensors, a row per sample; None for a flight on the true state.
        """
    @property
    def lowest(self, /) -> float:
        """
        Least height of the lowest point of all bodies and rotors above the ground, m.
        """
    @property
    def mishaps(self, /) -> list[str]:
        """
        What befell it however small its errors are, in order of time: below the ground at z = 0 (of a configuration its own), a load
        that turned over. Empty for a flight that is one.
        """
    def plot(self, /, what: str = "overview", *, after: SupportsFloat | SupportsIndex = 2.0) -> Figure:
        """
        A figure of it: "overview", "path", "error", "rotors", "attitude" or "rates"; the first `after` seconds are left out of the RMSE.
        """
    @property
    def reading_names(self, /) -> list[str]:
        """
        Names of these readings with units.
        """
    def readings(self, /) -> Any:
        """
        What sensors read but for cameras and lidars, a new float64 array [sample, reading], as `reading_names` says.
        """
    def states(self, /) -> Any:
        """
        The plant's state, a new float64 array [sample, state].
        """
    def summary(self, /, after: SupportsFloat | SupportsIndex = 2.0) -> dict:
        """
        Key figures by name from `after` (s) on: "rmse" and "max_error" (m), "heading_rmse", "max_heading_error" and "max_tilt" (rad),
        "max_speed" (m/s), "saturation" (share of rotor commands at a limit) and more. What does not exist is left out.
        """
    def write_csv(self, /, path: str | PathLike[str]) -> None:
        """
        Writes the columns as CSV; a file that is there is replaced.
        """

@final
class Forest:
    """
    Upright trunks in a corridor along x, that stand elsewhere in every episode: `Draws.trunks` draws where.

    Parameters
    ----------
    **settings
        `length` and `width` of the corridor (m), `clear` at its beginning and end (m), `trunks` (how many), `radius` (least and largest, m),
        `height` (m), `gap` between two trunks (m), `seed` of the nominal places.
    """
    def __new__(cls, /, **settings) -> Forest: ...
    @property
    def places(self, /) -> Any:
        """
        Nominal places, m, world, float64 [trunk, 3].
        """
    @property
    def radii(self, /) -> Any:
        """
        Radii of the trunks, m, float64 [trunk].
        """
    @property
    def scene(self, /) -> dict:
        """
        The scene with its trunks at their nominal places: what a task gives as `scene`.
        """

@final
class Gate:
    """
    Four bars around an opening, in the yz plane of the frame; one flies through along x.

    Parameters
    ----------
    **settings
        `position`, `rotation` (w x y z), `half_width`, `half_height`, `radius`, `scale` of the three lengths, `slide` (a dict), `name`.
    """
    def __new__(cls, /, **settings) -> Gate: ...
    def bars(self, /, position: Any, attitude: Any) -> Any:
        """
        Ends of the axes of the four bars for a frame that is there, m, world, [4, 2, 3].
        """
    @property
    def data(self, /) -> dict:
        """
        As scenes have it.
        """
    def distance(self, /, position: Any, attitude: Any, point: Any) -> Any:
        """
        Distance of a point (m, world) to the bars of a frame that is there, m.
        """
    @property
    def opening(self, /) -> list[float]:
        """
        Half width and half height of the free opening, m.
        """
    def passage(self, /, position: Any, attitude: Any, before: Any, after: Any) -> tuple[Any, Any]:
        """
        How a straight step between two points (m, world) meets the opening of a frame that is there: its direction, 1 along x, -1 against it,
        0 where it does not cross the plane, and how far inside the opening it crosses, m.
        """
    @property
    def radius(self, /) -> float:
        """
        Radius of the bars, m.
        """

@final
class Goal:
    """
    What stays through an episode.
    """
    def __getitem__(self, at: Any, /) -> Any: ...
    def __len__(self, /) -> int: ...
    def __setitem__(self, at: Any, numbers: Any, /) -> None: ...
    def field(self, /, name: str, unit: str, meaning: str, numbers: Any, *, low: SupportsFloat | SupportsIndex = ..., high: SupportsFloat | SupportsIndex = ...) -> None:
        """
        The next field where an episode begins: its name, unit (with the frame), meaning and numbers.
        """

@final
class Jacobian:
    """
    Exact derivatives of one step of one environment, float64.
    """
    @property
    def arguments(self, /) -> Any:
        """
        What went into the step, [argument]: `layout` says what is where.
        """
    @property
    def layout(self, /) -> dict:
        """
        Places by name, as slices: of arguments and results `state`, `task_state`, `line`, `history`; of arguments `action`,
        `parameters`, `time`, `goal`, `next_goal`, `wind`, `readings`, `noise`, `statistics`; of results `observation`, `central`, `reward`, `loss`, `poses`.
        """
    @property
    def matrix(self, /) -> Any:
        """
        Derivatives of the results by the arguments up to the parameters, [result, argument].
        """
    @property
    def value(self, /) -> Any:
        """
        What came out of it, [result].
        """

@final
class KalmanFilter:
    """
    A Kalman filter of a linear model that may differ from step to step: `predict`, then `correct` with what was measured.

    Parameters
    ----------
    state : array [state]
        Where it begins, float64.
    covariance : array [state, state]
        How well that is known, float64, symmetric, positive semi-definite.
    """
    def __new__(cls, /, state: Any, covariance: Any) -> KalmanFilter: ...
    def __repr__(self, /) -> str: ...
    def correct(self, /, y: Any, C: Any, V: Any, *, D: Any | None = None, u: Any | None = None) -> dict:
        """
        Takes in a measurement y = C x + D u + v. What it told is returned by name: "value" (y less what was expected, float64 [output]),
        its "covariance" S, and "squared", value' S^-1 value: chi-squared with as many degrees of freedom as outputs where the model is
        right.

        Parameters
        ----------
        y : array [output]
        C : array [output, state]
        V : array [output, output]
            Covariance of v.
        D : array [output, input], optional
        u : array [input], optional

        All are float64; D and u are given together. A measurement that is refused leaves the filter as it was.
        """
    @property
    def covariance(self, /) -> Any:
        """
        P, a new float64 array [state, state].
        """
    def predict(self, /, A: Any, W: Any, *, B: Any | None = None, u: Any | None = None) -> None:
        """
        A step further: x+ = A x + B u + w.

        Parameters
        ----------
        A : array [state, state]
        W : array [state, state]
            Covariance of w.
        B : array [state, input], optional
        u : array [input], optional

        All are float64; B and u are given together.
        """
    def squared_error(self, /, truth: Any) -> float:
        """
        e' P^-1 e of a true state, float64 [state] (NEES): chi-squared with as many degrees of freedom where the filter is consistent.
        """
    @property
    def state(self, /) -> Any:
        """
        What is estimated, a new float64 array [state].
        """

@final
class Loop(System):
    """
    A plant under a controller as one differentiable system: what `fly` flies, without events.

    Parameters
    ----------
    plant : Vehicle or str or path
        A vehicle, its name or file, or a configuration.
    controller : str or ControlLaw, optional
        A law over any scalar: "cascade" (default), "indi", "lqi" or "lqr" of a vehicle, "formation" of a configuration of drones, or one
        of your own.
    gains : dict, optional
        As `Vehicle.gains`; of the controller as it is built.
    rates : dict, optional
        How often each level computes, Hz: "velocity", "attitude", "rate".
    latency : int
        Steps by which commands act late.
    **physics
        `dt=0.002` (s), `substeps`, `integrator`, `effects`.

    The state is the plant's, then the controller's memory and its commands under way; parameters are the plant's physical numbers (SI),
    then the controller's gains: `parameter_names`. The controller goes on believing the nominal physical numbers.
    """
    def __new__(cls, plant: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, rates: dict | None = None, latency: SupportsIndex = 0, **physics) -> Loop: ...
    def __repr__(self, /) -> str: ...
    def initial_state(self, /, reference: Any | None = None) -> Any:
        """
        At rest on a reference (that of `fly` by default) at its beginning, the controller before its first tick, a new float64 array
        [state]; the plant's state stands in front.
        """
    def inputs(self, /, n_step: SupportsIndex, reference: Any | None = None, *, first: SupportsIndex = 0, wind: SupportsLenAndGetItem[SupportsFloat | SupportsIndex] = ...) -> Any:
        """
        The inputs of so many steps along a reference, as `fly` takes it, from step `first` on, in still air unless a `wind` blows (m/s,
        world), a new float64 array [n_step, input].

        Of `cascade` and `lqi` the first 18 are the reference's position, velocity, acceleration, jerk, snap, yaw and its rates.
        """
    @property
    def parameter_names(self, /) -> list[str]:
        """
        Of theta, in its order: "mass", "rotor_0.thrust_coefficient", "gains.position_x".
        """

@final
class Loss:
    """
    Takes the summands of a training loss.
    """
    def add(self, /, formula: str, number: Any) -> None:
        """
        The next summand: its formula, and the number.
        """

@final
class MonteCarloRun:
    """
    Many flights of one controller on plants that differ: columns of what each was flown with and of how it went.
    """
    def __len__(self, /) -> int:
        """
        Flights.
        """
    def __repr__(self, /) -> str: ...
    def columns(self, /) -> dict:
        """
        Columns by name with unit, new arrays [flight]: what was drawn, then "rmse [m]" and "worst [m]" (distances from the reference
        behind the transient), "tilt [rad]" (the largest) and "lost_at [s]" (nan where it was not).
        """
    def summary(self, /) -> dict:
        """
        In a few numbers: "lost" ("hits" of "n", with "bounds" of the share), "median" and "percentile_95" of the RMSE (m) with bounds, and
        the "confidence" of all bounds.
        """

@final
class Motion:
    """
    Motion of a body along world axes. Numbers record.
    """
    @property
    def angular_velocity(self, /) -> Any:
        """
        rad/s, along world axes, [3].
        """
    @property
    def attitude(self, /) -> Any:
        """
        Unit quaternion w, x, y, z, body to world, [4].
        """
    @property
    def heading(self, /) -> Any:
        """
        Body x along world axes, [3].
        """
    @property
    def observed_attitude(self, /) -> Any:
        """
        The attitude with w >= 0, as it is observed, [4].
        """
    def point(self, /, local: Any) -> tuple[Any, Any]:
        """
        Place (m) and velocity (m/s) of a point that is fixed in the body (m, body), world: two arrays [3].
        """
    @property
    def position(self, /) -> Any:
        """
        Of its origin, m, world, [3].
        """
    @property
    def up(self, /) -> Any:
        """
        Body z along world axes, [3].
        """
    @property
    def velocity(self, /) -> Any:
        """
        m/s, world, [3].
        """
    @property
    def yaw(self, /) -> Any:
        """
        Angle of the heading in the world's xy plane, rad.
        """

@final
class Mpc:
    """
    Model predictive control: in every tick the plan of least cost from the measured state along the reference, of which the first
    inputs are flown.

    Parameters
    ----------
    plant : Vehicle or str or path
        What it believes to fly: a vehicle, its name or file, or a configuration.
    dt : float
        Between two calls of `tick`, s. It plans in as many of them as `rate` allows and holds its commands between.
    physics : dict, optional
        Of its model: `integrator`, `effects`.
    **settings
        `stages=20`, `stage=0.05` (s of each), `rate=100.0` (plans a second at most, Hz), `iterations=1` (programs a plan), `weights` (a dict:
        "position", "velocity", "attitude", "angular_velocity", three numbers each, "joint", "joint_rate", "input"), `endless=True` (the plan
        ends with the cost of an endless flight), `state_bound=[{"state": "velocity_x", "lower": -2.0, "upper": 2.0, "weight": 1e3}]`, `tracked`
        (name of a body), `estimate=10.0` (rate of the disturbance estimate, 1/s; 0 for none), `latency` (ticks by which commands act late),
        `substeps`, `exact_lags`.

    Ticks whose program fails fly on with the last plan; after ten of them the default controller of `fly` flies until a plan is found.
    """
    def __new__(cls, plant: Any, /, dt: SupportsFloat | SupportsIndex, *, physics: dict | None = None, **settings) -> Mpc: ...
    def __repr__(self, /) -> str: ...
    @property
    def command_names(self, /) -> list[str]:
        """
        Names of the commands, with units.
        """
    @property
    def fallback(self, /) -> str | None:
        """
        What flies while no plan is found; None where nothing does, then commands are those of hover.
        """
    @property
    def hover(self, /) -> Any:
        """
        The plant's state in hover at the origin, a new float64 array [plant state].
        """
    @property
    def input_names(self, /) -> list[str]:
        """
        Names of the columns of the plan's inputs, with units.
        """
    def plan(self, /) -> tuple[Any, Any]:
        """
        The plan that stands, new float64 arrays: states [stages + 1, state] and inputs [stages, input], as `state_names` and `input_names`
        say, a `stage` apart.
        """
    @property
    def plant_state_names(self, /) -> list[str]:
        """
        Names of the numbers of a measured state, with units.
        """
    def report(self, /) -> dict:
        """
        What it has done since it was reset, by name: "ticks" that planned, of them "kept" (flew on with the last plan) and "fallen_back",
        "recursions" of all, largest "residual" of a solved program, "times" (of ticks, s, float32 [tick]), the estimated disturbance "force"
        (N, world, [3]) and "moment" (N m, body, [3]), and "last": None before the first tick, else "status" ("solved", "stopped",
        "not_convex", "not_finite"), "recursions", "residual", "cost", "gap" and "step" of its program.
        """
    def reset(self, /) -> None:
        """
        Forgets: the next tick is the first.
        """
    @property
    def settings(self, /) -> dict:
        """
        All its settings as a dict.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the columns of the plan's states, with units: speeds of rotors are shares of their largest.
        """
    def tick(self, /, state: Any, reference: Any, time: SupportsFloat | SupportsIndex) -> Any:
        """
        The commands of a tick, a new float64 array [command] in [-1, 1], as `command_names` says.

        Parameters
        ----------
        state : array
            What is measured, float64, as `plant_state_names` says: SI, speeds of rotors in rad/s.
        reference : str or dict or array
            A shape by its name or as `fly` takes it; or samples of what is wanted when commands of this tick act and each `stage` later,
            float64 [sample, number]: position, velocity, acceleration, jerk, snap (three numbers each), yaw and its two rates. Numbers
            that are left out at the end of all rows are 0; the last row holds on.
        time : float
            Since the start of the reference, s.
        """

@final
class OptimalTrajectory:
    """
    A trajectory of least cost, and the search that found it.
    """
    def __repr__(self, /) -> str: ...
    @property
    def cost(self, /) -> float:
        """
        Of the trajectory.
        """
    @property
    def error_names(self, /) -> list[str]:
        """
        What `gains` multiply, with units: a rotation vector (body axes) stands where the state has its quaternion.
        """
    @property
    def gains(self, /) -> Any:
        """
        K, float64 [N, input, error]: inputs + K @ error is the optimal answer to small errors of the state, 0 for inputs at a bound.
        """
    @property
    def gap(self, /) -> float:
        """
        Sum of |x+ - f(x, u)| over all stages: 0 for a flight.
        """
    @property
    def input_names(self, /) -> list[str]:
        """
        Names of the columns of `inputs`, with units.
        """
    @property
    def inputs(self, /) -> Any:
        """
        float64 [N, input], as `input_names` says.
        """
    @property
    def iterations(self, /) -> dict:
        """
        What every iteration came to, float64 arrays [iteration]: "cost" (with squares of violations), "gap", "step" (share of it that was
        taken, 0 for none), "violation".
        """
    @property
    def solved(self, /) -> bool:
        """
        Whether it is within the tolerances of its problem.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the columns of `states`, with units.
        """
    @property
    def states(self, /) -> Any:
        """
        float64 [N + 1, state], as `state_names` says: speeds of rotors are shares of their largest.
        """
    @property
    def status(self, /) -> str:
        """
        "solved", "out_of_iterations", "no_step" (none lowers the cost any more) or "violated" (a gate or an obstacle is).
        """
    @property
    def times(self, /) -> Any:
        """
        Of the states, s, float64 [N + 1].
        """
    @property
    def violation(self, /) -> float:
        """
        Largest violation of a gate or an obstacle, m.
        """

@final
class Part:
    """
    Numbers of a start, by place.
    """
    def __getitem__(self, at: Any, /) -> Any: ...
    def __len__(self, /) -> int: ...
    def __setitem__(self, at: Any, numbers: Any, /) -> None: ...

@final
class Policy:
    """
    What was learnt: a network over one agent's observation. Actions are the most likely ones.
    """
    def __call__(self, /, observation: Any, out: Any | None = None) -> Any:
        """
        Actions for observations: float32 arrays [..., observation] to [..., action].
        """
    def __reduce__(self, /) -> tuple[Any, tuple]:
        """
        Pickles hold parameters, statistics and settings.
        """
    def __repr__(self, /) -> str: ...
    @property
    def config(self, /) -> dict:
        """
        Settings of the environments that it was trained in: `make(policy.task, 1, config=policy.config, stagger=False)` shows what it
        expects. Learners stagger first episodes, which then end early.
        """
    def parameters(self, /) -> Any:
        """
        All parameters, a new float32 array: those of the network, then those of the distribution over its outputs.
        """
    def reset(self, /, begins: SupportsGetItem[int, bool] | None = None) -> None:
        """
        Episodes begin anew: what a policy with memory remembers of the rows of its last call is forgotten, or of the environments for
        which `begins` is true.
        """
    @property
    def task(self, /) -> str:
        """
        The task that it was trained for.
        """
    def weights(self, /) -> dict:
        """
        Weights by name, new float32 arrays: "0.weight" [out, in], "0.bias" [out], per layer, as PyTorch has them; "log_std" where
        actions are continuous and drawn. Where every agent has its own, "agent0." and so on stands before the name.
        """

@final
class Progress:
    """
    How far a run is, after an update: what `watch` of `train` sees.
    """
    @property
    def budget(self, /) -> int:
        """
        Updates after which it ends.
        """
    @property
    def env_steps(self, /) -> int:
        """
        Steps of environments.
        """
    @property
    def evaluation(self, /) -> dict | None:
        """
        The newest evaluation by name, or None.
        """
    @property
    def line(self, /) -> dict | None:
        """
        The newest line of the log by name, or None.
        """
    @property
    def loss(self, /) -> float:
        """
        What was minimised, before the update.
        """
    @property
    def reward(self, /) -> float:
        """
        Mean reward of a step.
        """
    @property
    def seconds(self, /) -> float:
        """
        Time spent training, s.
        """
    @property
    def update(self, /) -> int:
        """
        Updates done.
        """

@final
class RecoveryMap:
    """
    From which attitudes and body rates a controller brings a plant back: a cell per interval of both.
    """
    def __repr__(self, /) -> str: ...
    @property
    def batched(self, /) -> bool:
        """
        Whether starts flew side by side, in lanes.
        """
    def columns(self, /) -> dict:
        """
        Arrays [tilt, rate] by name: "recovered" of "n" starts, "low" and "high" bounds of the share, "sunk [m]" (the most height lost by
        those that came back) and "slowest [s]"; "tilt [rad]" and "rate [rad/s]" are where cells begin and end, [tilt + 1] and [rate + 1].
        """
    def within(self, /, tilt: SupportsFloat | SupportsIndex, rate: SupportsFloat | SupportsIndex) -> tuple[float, float, float]:
        """
        The share of starts within a tilt (rad) and a body rate (rad/s) that came back, with its bounds: (share, low, high).
        """

@final
class Regulator:
    """
    An optimal feedback u = -K x.
    """
    @property
    def cost(self, /) -> Any:
        """
        X, float64 [state, state]: x' X x is the cost from x on.
        """
    @property
    def gain(self, /) -> Any:
        """
        K, float64 [input, state].
        """
    @property
    def poles(self, /) -> Any:
        """
        Eigenvalues of A - B K, complex128 [state], largest first.
        """

@final
class Robot:
    """
    What flies in a task: one drone by name, `Robot.team`, `Robot.of_task`, `Robot.of_configuration`.

    Parameters
    ----------
    vehicle : str
        A built-in vehicle, or that of the configuration (`vehicle=`), as the benchmark flies it.
    disturbance : bool
        Whether winds, forces and moments may act on it.
    """
    def __new__(cls, /, vehicle: str, *, disturbance: bool = False) -> Robot: ...
    @property
    def bodies(self, /) -> list[str]:
        """
        Names of its bodies, in the order of `View.body`; that of a vehicle alone.
        """
    @property
    def mass(self, /) -> float:
        """
        Total mass, kg.
        """
    @staticmethod
    def of_configuration(configuration: str, *, vehicle: str | None = None, drives: SupportsGetItem[int, SupportsGetItem[int, str]] = ..., contact: bool = False, downwash: bool = False, disturbance: bool = False) -> Robot:
        """
        A built-in configuration by name. `vehicle` is what every drone is, if they are alike. `drives` names,
        per drone, the joints that its further actions drive. `contact`: whether bodies touch. `downwash`: whether drones feel each other.
        """
    @staticmethod
    def of_task(task: str, /, **settings) -> Robot:
        """
        What flies in a built-in task, with that task's settings: `Robot.of_task("PayloadTrack", length=[1.0, 1.0])`.
        """
    @property
    def parameter_names(self, /) -> list[str]:
        """
        Names of the physical numbers.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the numbers of the state, with units.
        """
    @staticmethod
    def team(vehicle: str, n_drone: SupportsIndex, *, disturbance: bool = False) -> Robot:
        """
        `n_drone` drones that are free of each other but for their wakes; agent i flies drone i.
        """
    def varying(self, /, *names) -> Robot:
        """
        The same robot with physical numbers that differ between environments, by name; `parameter_names` lists them.
        """
    def varying_inertial(self, /, body: SupportsIndex) -> Robot:
        """
        The same robot with mass, centre of mass and inertia of a body that differ between environments.
        """

@final
class Run:
    """
    What a training run came to.
    """
    def __repr__(self, /) -> str: ...
    @property
    def checkpoint(self, /) -> Path | None:
        """
        The newest checkpoint; None for a run without a folder.
        """
    @property
    def curve(self, /) -> dict:
        """
        Columns of the log by name, float64 arrays [line]; what a line lacks is NaN.
        """
    @property
    def env_steps(self, /) -> int:
        """
        Steps of environments.
        """
    @property
    def evaluation(self, /) -> dict:
        """
        Of the policy, by name: "success", "return_mean", "crashed", "final_error".
        """
    @property
    def policy(self, /) -> Policy:
        """
        Ready to fly.
        """
    @property
    def seconds(self, /) -> float:
        """
        Time spent training, s, without evaluations.
        """
    @property
    def stopped(self, /) -> bool:
        """
        Whether `watch` stopped it before its end.
        """
    @property
    def updates(self, /) -> int:
        """
        Updates done.
        """

@final
class StageQpSolution:
    """
    The solution of a program of linked stages.
    """
    def __repr__(self, /) -> str: ...
    @property
    def cost(self, /) -> float:
        """
        Of the solution.
        """
    @property
    def costates(self, /) -> Any:
        """
        Slopes of the cost by the states from each on, with everything behind it, float64 [N + 1, state]: multipliers of the dynamics.
        """
    @property
    def gains(self, /) -> Any:
        """
        K, float64 [N, input, state]: inputs + K @ dx is the solution for a state beside its own by dx, as long as the same bounds act.
        """
    @property
    def inputs(self, /) -> Any:
        """
        float64 [N, input].
        """
    @property
    def iterations(self, /) -> int:
        """
        Riccati recursions.
        """
    @property
    def multipliers(self, /) -> Any:
        """
        Slopes of the cost by the inputs with what follows from them, float64 [N, input]: multipliers of their bounds, positive at the lower
        one, negative at the upper one, 0 between.
        """
    @property
    def residual(self, /) -> float:
        """
        Largest violation of the optimality conditions: by how much a projected step would still move an input, as a share of the range
        between its bounds.
        """
    @property
    def solved(self, /) -> bool:
        """
        Whether the residual is within the tolerance.
        """
    @property
    def states(self, /) -> Any:
        """
        float64 [N + 1, state], x0 first.
        """
    @property
    def status(self, /) -> str:
        """
        "solved", or "stopped": out of iterations, within the bounds.
        """

@final
class Start:
    """
    The start of an episode, or an event in one: draws, and where they go. Everything stands at rest, rotors at hover, until it is changed.
    """
    def again(self, /, most: SupportsIndex, attempt: Any) -> None:
        """
        Calls `attempt()` until the mask that it returns holds, `most` times at most: what it draws is drawn again. Once in a start.
        """
    def attitude(self, /, tilt: Any, yaw: Any | None = None) -> Any:
        """
        An attitude with roll and pitch uniform within `tilt` and yaw uniform within `yaw`, rad: drawn from `reset`, w x y z.
        """
    @property
    def difficulty(self, /) -> Any:
        """
        Share of a curriculum, 0 to 1.
        """
    @property
    def event_at(self, /) -> Any:
        """
        Step behind which `event` is called; never, unless it is set. In an event it is the step of now, and no next one comes unless it is
        put ahead.
        """
    @event_at.setter
    def event_at(self, /, step: Any) -> None: ...
    @property
    def goal(self, /) -> Goal:
        """
        What stays through the episode: written by name where an episode begins, changed by place in events.
        """
    def inertial(self, /, body: SupportsIndex | str) -> Any:
        """
        Mass (kg), centre of mass (m, body) and inertia about it (kg m²: xx, yy, zz, xy, xz, yz) of a body, by number or name, as
        `omnidrones.Inertial`: numbers that may be changed where `Robot.varying_inertial` names the body.
        """
    def move_at(self, /, velocity: Any, *, tree: SupportsIndex = 0) -> None:
        """
        Sets the velocity of the root of a tree, m/s, world.
        """
    @property
    def numbers(self, /) -> Part:
        """
        Physical numbers of what flies, the nominal ones until changed. A change counts where the robot says that the number varies.
        """
    @property
    def once(self, /) -> Draws:
        """
        Draws that are the same at the start of every episode of an environment: geometry.
        """
    def place(self, /, position: Any, attitude: Any | None = None, *, tree: SupportsIndex = 0) -> None:
        """
        Puts the root of a tree (a drone of a team, what flies else) at a place, m, world, with an attitude, w x y z; level without.
        """
    def position(self, /, range: Any) -> Any:
        """
        Uniform in a box, lowest and highest per axis, [3, 2], m, world: drawn from `reset`, [3].
        """
    @property
    def reset(self, /) -> Draws:
        """
        Draws of initial states.
        """
    def set_inertial(self, /, body: SupportsIndex | str, mass: Any, center_of_mass: Any, inertia: Any) -> None:
        """
        Changes them: `start.set_inertial(body, *inertial)`.
        """
    def set_joint(self, /, name: str, position: Any, rate: Any | None = None) -> None:
        """
        Sets angle (rad) or way (m) of a hinge or slide, by name, and its rate.
        """
    def spin_up(self, /, factor: Any) -> None:
        """
        Lets all rotors turn `factor` times as fast as they do, no faster than they can: where something heavier hovers.
        """
    @property
    def state(self, /) -> Part:
        """
        Numbers of the physics, SI: read and written by place.
        """
    @property
    def task(self, /) -> Draws:
        """
        Draws of goals.
        """
    @property
    def task_state(self, /) -> Part:
        """
        What the task keeps from step to step; zeros until changed.
        """

@final
class StateEstimator:
    """
    A Kalman filter of what a vehicle's sensors read: its motion and the biases of the sensors, with how well they are known. Readings may
    come late; those that disagree are left out.

    Parameters
    ----------
    sensors : str or list of dict or path
        An inertial unit and what aids it: a text as "imu:bmi088,motion_capture:optical", a list of the tables that `fly` and environments
        take, or a TOML file of `[[sensor]]` tables.
    dt : float
        Between two calls of `step`, s.
    gravity : float
        m/s^2, along -z.
    **settings
        Standard deviations at the beginning, `position=0.1` (m), `velocity=0.1` (m/s), `attitude=0.02` (rad); `gate=30.0`, the largest
        squared innovation per number that is taken in; `patience=1.0`, how long a sensor is left out before it is believed again, s;
        `beyond_accelerometer=50.0` (m/s^2) and `beyond_gyroscope=10.0` (rad/s), what a unit at its limit may miss.
    """
    def __new__(cls, sensors: Any, /, dt: SupportsFloat | SupportsIndex, *, gravity: SupportsFloat | SupportsIndex = 9.81, **settings) -> StateEstimator: ...
    def __repr__(self, /) -> str: ...
    @property
    def angular_velocity(self, /) -> Any:
        """
        rad/s, body axes, [3].
        """
    @property
    def attitude(self, /) -> Any:
        """
        Body to world, [w, x, y, z].
        """
    def begin(self, /, position: Any | None = None, velocity: Any | None = None, attitude: Any | None = None, angular_velocity: Any | None = None) -> None:
        """
        Begins a flight where the body is known to be, to the deviations of the settings; at rest at the origin by default.

        Parameters
        ----------
        position, velocity : three floats, optional
            m and m/s, world.
        attitude : four floats, optional
            Unit quaternion [w, x, y, z], body to world.
        angular_velocity : three floats, optional
            rad/s, body axes.
        """
    @property
    def biases(self, /) -> dict:
        """
        Biases of the sensors by name, in their units: of the accelerometer m/s^2, of the gyroscope rad/s.
        """
    @property
    def covariance(self, /) -> Any:
        """
        P, float64 [error, error], as `error_names` says: attitude errors are about the axes of the inertial unit.
        """
    @property
    def deviations(self, /) -> Any:
        """
        Standard deviations, the roots of the diagonal of P, float64 [error].
        """
    @property
    def error_names(self, /) -> list[str]:
        """
        Names of the rows of P, with units where they are not the sensor's.
        """
    @property
    def position(self, /) -> Any:
        """
        m, world, a new float64 array [3], as all that follow.
        """
    @property
    def reading_names(self, /) -> list[str]:
        """
        Names of the readings of a step with units, as `Flight.columns` has them.
        """
    @property
    def records(self, /) -> list:
        """
        How readings agreed with what was expected since the flight began, sensor by sensor: as `Estimates.records`.
        """
    def run(self, readings: Any, /, *, truth: Any | None = None) -> Estimates:
        """
        Goes on over a recorded flight: as many calls of `step`, with what was estimated behind each.

        Parameters
        ----------
        readings : array
            float64 [sample, reading], a row every `dt`.
        truth : array, optional
            float64 [sample, >= 13], as `Flight.states` gives it: position, velocity, attitude, angular velocity (body axes). With it the
            estimates have `errors`, `rms`, `nees` and `share_within`.
        """
    @property
    def saturated(self, /) -> int:
        """
        Samples of the inertial unit at a limit, or no numbers.
        """
    def squared_error(self, /, position: Any, velocity: Any, attitude: Any, angular_velocity: Any | None = None) -> float:
        """
        e' P^-1 e of what is estimated (NEES) where the body is in truth there, arguments as of `begin`: chi-squared with nine degrees of
        freedom where the estimate is consistent.
        """
    def step(self, /, readings: Any) -> None:
        """
        Takes in what is new among the readings of a step, float64 [reading], as `reading_names` says. What is held is not taken twice;
        numbers that are none count as lost.
        """
    @property
    def velocity(self, /) -> Any:
        """
        m/s, world, [3].
        """

@final
class StateEstimatorBatch:
    """
    Many filters of the same sensors side by side, each of a body of its own, as environments show estimates.

    Where readings come late, a filter stands `late` steps behind the present, where all of a sample is known; what it estimates of the
    present goes on from there by the inertial unit. Where none do, each is a `StateEstimator`.

    Parameters
    ----------
    sensors : str or list of dict or path
        As `StateEstimator` takes them.
    n : int
        How many.
    dt : float
        Between two calls of `step`, s.
    gravity : float
        m/s^2, along -z.
    **settings
        As of `StateEstimator`.
    """
    def __len__(self, /) -> int:
        """
        Filters.
        """
    def __new__(cls, sensors: Any, /, n: SupportsIndex, dt: SupportsFloat | SupportsIndex, *, gravity: SupportsFloat | SupportsIndex = 9.81, **settings) -> StateEstimatorBatch: ...
    def __repr__(self, /) -> str: ...
    @property
    def angular_velocity(self, /) -> Any:
        """
        rad/s, body axes, [n, 3].
        """
    @property
    def attitude(self, /) -> Any:
        """
        Body to world, [w, x, y, z], [n, 4].
        """
    def begin(self, /, position: Any | None = None, velocity: Any | None = None, attitude: Any | None = None, angular_velocity: Any | None = None, *, mask: Any | None = None) -> None:
        """
        Begins where the bodies are known to be, to the deviations of the settings; at rest at the origin by default.

        Parameters
        ----------
        position, velocity : array, optional
            float64 [n, 3], m and m/s, world.
        attitude : array, optional
            float64 [n, 4], unit quaternions [w, x, y, z], body to world.
        angular_velocity : array, optional
            float64 [n, 3], rad/s, body axes.
        mask : array, optional
            bool [n]: those that begin; all by default. Numbers of the others are not looked at.
        """
    @property
    def biases(self, /) -> dict:
        """
        Biases of the sensors by name, float64 arrays [n], `late` steps ago.
        """
    @property
    def covariance(self, /) -> Any:
        """
        P of every filter, float64 [n, error, error], as `error_names` says, `late` steps ago.
        """
    @property
    def deviations(self, /) -> Any:
        """
        Standard deviations, float64 [n, error], `late` steps ago.
        """
    @property
    def error_names(self, /) -> list[str]:
        """
        Names of the rows of P, with units where they are not the sensor's.
        """
    @property
    def late(self, /) -> int:
        """
        Steps that the filters stand behind: the largest latency of the sensors.
        """
    @property
    def position(self, /) -> Any:
        """
        m, world, at present, a new float64 array [n, 3], as all that follow.
        """
    @property
    def reading_names(self, /) -> list[str]:
        """
        Names of the readings of a step with units, as `Flight.columns` has them.
        """
    @property
    def records(self, /) -> list:
        """
        How readings of all bodies agreed with what was expected, sensor by sensor: as `Estimates.records`.
        """
    @property
    def saturated(self, /) -> int:
        """
        Samples of inertial units at a limit, or no numbers.
        """
    def squared_error(self, /, position: Any, velocity: Any, attitude: Any, angular_velocity: Any | None = None) -> Any:
        """
        e' P^-1 e (NEES) of every filter, float64 [n], where the bodies in truth were there `late` steps ago; arguments as of `begin`.
        """
    def step(self, /, readings: Any, mask: Any | None = None) -> None:
        """
        Takes in what the sensors of every body read in a step.

        Parameters
        ----------
        readings : array
            float64 [n, reading], as `reading_names` says.
        mask : array, optional
            bool [n]: those that go on; all by default.
        """
    @property
    def velocity(self, /) -> Any:
        """
        m/s, world, [n, 3].
        """

@final
class StateSpace:
    """
    A linear system with named signals: x+ = A x + B u of every sample, or dx/dt where `dt` is None; y = C x + D u.
    """
    @property
    def A(self, /) -> Any:
        """
        float64 [state, state].
        """
    @property
    def B(self, /) -> Any:
        """
        float64 [state, input].
        """
    @property
    def C(self, /) -> Any:
        """
        float64 [output, state].
        """
    @property
    def D(self, /) -> Any:
        """
        float64 [output, input].
        """
    def __new__(cls, /, A: Any, B: Any | None = None, C: Any | None = None, D: Any | None = None, *, dt: SupportsFloat | SupportsIndex | None = None, states: SupportsGetItem[int, str] | None = None, inputs: SupportsGetItem[int, str] | None = None, outputs: SupportsGetItem[int, str] | None = None) -> StateSpace:
        """
        A system of one's own.

        Parameters
        ----------
        A : array [state, state]
        B : array [state, input], optional
            One input that moves nothing by default.
        C : array [output, state], optional
            All states by default.
        D : array [output, input], optional
            Zeros by default.
        dt : float, optional
            Of a sample, s; dx/dt without it.
        states, inputs, outputs : list of str, optional
            Names, with units behind them in brackets.

        Arrays are float64.
        """
    def __repr__(self, /) -> str: ...
    def continuous(self, /) -> StateSpace:
        """
        The system in dx/dt whose Tustin equivalent this is: the same stability, margins and largest gain.
        """
    @property
    def dt(self, /) -> float | None:
        """
        Of a sample, s; None for dx/dt.
        """
    @property
    def inputs(self, /) -> list[str]:
        """
        Names with units.
        """
    @property
    def outputs(self, /) -> list[str]:
        """
        Names with units.
        """
    @property
    def states(self, /) -> list[str]:
        """
        Names with units.
        """
    def to_control(self, /) -> Any:
        """
        As `control.StateSpace` of python-control, with the names of all signals.
        """
    def to_scipy(self, /) -> Any:
        """
        As `scipy.signal.StateSpace`, without names.
        """
    def unobservable(self, /) -> list[str]:
        """
        Combinations of states that no output shows, by their names; none where outputs show them all.
        """
    def unreachable(self, /) -> list[str]:
        """
        Combinations of states that no input moves, by their names; none where inputs reach them all.
        """

@final
class SteadyKalman:
    """
    The filter that a Kalman filter of a model that does not change comes to.
    """
    def __repr__(self, /) -> str: ...
    @property
    def corrected(self, /) -> Any:
        """
        P once it is, likewise.
        """
    @property
    def covariance(self, /) -> Any:
        """
        P before a measurement is known, float64 [state, state]; for dx/dt the only one.
        """
    @property
    def gain(self, /) -> Any:
        """
        L, float64 [state, output]: of x = xp + L (y - C xp) for a sampled model, of dx/dt = A x + B u + L (y - C x) for dx/dt.
        """
    @property
    def poles(self, /) -> Any:
        """
        Poles of the error, complex128 [state], largest first: of A - A L C, for dx/dt of A - L C.
        """
    @property
    def residual(self, /) -> float:
        """
        Of the Riccati equation, relative.
        """

@final
class Sweep:
    """
    A reverse sweep over a tape, step by step from the last to the first.
    """
    def add_carried(self, /, cotangents: Any) -> None:
        """
        Adds to what is carried, [E, carried], between pulls: the gradient of a cost on the state there.
        """
    def carried(self, /) -> Any:
        """
        Cotangents of what the environments carried into the last step pulled, a new array [E, carried]: physics first.
        """
    @property
    def dropped(self, /) -> int:
        """
        Gradients that were not finite and became zero, environments times steps.
        """
    def parameters(self, /) -> Any:
        """
        Gradients by the physical numbers that differ between environments, summed over all steps pulled, a new array
        [E, number]; no columns unless the adjoint was made with parameters.
        """
    def pull(self, /, tape: Tape, t: SupportsIndex, *, observation: Any | None = None, reward: Any | None = None, loss: Any | None = None, central: Any | None = None, final_observation: Any | None = None, final_central: Any | None = None, final_carried: Any | None = None, out: Any | None = None) -> Any:
        """
        Pulls cotangents back through step `t` of a tape and returns those of its actions, [E, A * command].

        Cotangents are float32 arrays of what the step wrote: observation and final_observation [E, A, observation], central and
        final_central [E, central], final_carried [E, carried], reward [E] (of the team's one), loss [E]. Those left out are zero. The
        first step pulled may be any, then each is the one before.
        """
    def restart(self, /) -> None:
        """
        Begins again behind any step, with nothing carried.
        """

@disjoint_base
class System:
    """
    A discrete system x+ = f(x, u, theta) in float64 that is differentiated through any number of steps: `System.of` makes one of a
    function, `Loop` and `AllocationFunction` are others.
    """
    def __reduce__(self, /) -> tuple[Any, tuple]:
        """
        Pickles are of what was recorded, without the function; other systems are made anew.
        """
    def __repr__(self, /) -> str: ...
    def certificate(self, /, state: Any, input: Any, parameters: Any | None = None) -> Certificate:
        """
        How well three derivations of a step's Jacobian by state, input and parameters agree at a point.
        """
    @property
    def dt(self, /) -> float | None:
        """
        Of a step, s; None where it was not said.
        """
    @property
    def input_names(self, /) -> list[str]:
        """
        Names of the inputs: "u1" and so on where none were given.
        """
    def jacobians(self, /, state: Any, input: Any, parameters: Any | None = None) -> tuple[Any, Any, Any]:
        """
        A = dx+/dx, B = dx+/du and dx+/dtheta of a step at a point, by dual numbers: new float64 arrays [state, state], [state, input]
        and [state, parameter].
        """
    def linear_model(self, /, state: Any, input: Any, parameters: Any | None = None, *, continuous: bool = False) -> StateSpace:
        """
        The linear model about a point, with the names of its signals: small changes of the states, all of which are outputs, under small
        changes of the inputs. Of a step of `dt`; of dx/dt if `continuous`, which the system must be.
        """
    @property
    def n_input(self, /) -> int:
        """
        Numbers of the input u.
        """
    @property
    def n_parameter(self, /) -> int:
        """
        Numbers of the parameters theta.
        """
    @property
    def n_state(self, /) -> int:
        """
        Numbers of the state x.
        """
    @staticmethod
    def of(f: Any, /, *, states: SupportsIndex | SupportsGetItem[int, str], inputs: SupportsIndex | SupportsGetItem[int, str] | None = None, parameters: Any | None = None, dt: SupportsFloat | SupportsIndex | None = None, continuous: bool = False, substeps: SupportsIndex = 1) -> System:
        """
        The system that a function of Python says.

        Parameters
        ----------
        f : callable
            Called once, with `Number` arrays: f(x, u), or f(x, u, theta) with parameters. Returns x+ or, if `continuous`, dx/dt.
        states, inputs : int or list of str
            How many, or their names, with units behind them in brackets. No inputs by default.
        parameters : dict or array, optional
            Nominal values. Of a dict of numbers and arrays theta is such a dict, of an array an array.
        dt : float, optional
            Of a step, s. Needed if `continuous`; else for linear models alone.
        continuous : bool
            Whether f gives dx/dt. A step is then one of Runge and Kutta's classical method, or `substeps` of it, u constant within.
        substeps : int
            Of the integrator.

        f may not depend on values while it is recorded: see `Number`. What it raises is raised.

        >>> def pendulum(x, u, theta):
        ...     return [x[1], (u[0] - theta["damping"] * x[1]) / theta["mass"] - 9.81 * np.sin(x[0])]
        >>> system = omnidrones.System.of(pendulum, states=["angle [rad]", "rate [rad/s]"], inputs=["torque [N m]"],
        ...                               parameters={"mass": 1.0, "damping": 0.1}, dt=0.01, continuous=True)
        >>> A, B, by_parameters = system.jacobians(np.zeros(2), np.zeros(1))
        """
    def optimise(self, /, cost: Any, last: Any | None = None, *, start: Any, stages: SupportsIndex, conditions: Any | None = None, references: Any | None = None, lower: Any | None = None, upper: Any | None = None, quaternions: SupportsGetItem[int, SupportsIndex] = ..., guess: Any | None = None, parameters: Any | None = None, iterations: SupportsIndex | None = None, progress: Any | None = None) -> OptimalTrajectory:
        """
        The trajectory of least cost of a system that `System.of` made, with gains along it, by a search of Newton's kind (iLQR).

        Parameters
        ----------
        cost : callable
            Of a stage, a single number: cost(x, u), with theta behind them if the system has parameters, and the stage's row of `references`
            if there are any. Called once, with numbers that record. Where it is not convex the search may end early.
        last : callable, optional
            Of the last state likewise, without u.
        start : array [state]
            Where it begins.
        stages : int
            Steps.
        conditions : callable, optional
            Called as `cost`: numbers that must not be above 0 in any stage.
        references : array [stages + 1, number], optional
            What changes from stage to stage: a target, a weight.
        lower, upper : array [input], optional
            Bounds of the inputs; they have none by default.
        quaternions : list of int
            Places in the state where unit quaternions begin.
        guess : array [stages, input], optional
            Inputs that the search begins with, zeros by default.
        parameters : array [parameter], optional
            Nominal ones by default.
        iterations : int, optional
            Most of them.
        progress : callable, optional
            Called with (iteration, cost, gap, violation) of every iteration. An exception ends the search and is raised.

        All arrays are float64. A search that ends before the tolerances are met raises nothing: look at `solved` or `status`. Times of a
        system without `dt` count steps.
        """
    @property
    def parameter_names(self, /) -> list[str]:
        """
        Names of the parameters, in the order of theta: "p1" and so on where none were given.
        """
    @property
    def parameters(self, /) -> Any:
        """
        Nominal theta, a new float64 array [parameter].
        """
    def pull(self, /, cotangents: Any, state: Any, inputs: Any, parameters: Any | None = None) -> tuple[Any, Any, Any]:
        """
        Cotangents of `state`, `inputs` and `parameters`, in this order, for `cotangents` [T + 1, state] of their trajectory: one reverse
        sweep for all, new float64 arrays.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the states: "x1" and so on where none were given.
        """
    def trajectory(self, /, state: Any, inputs: Any, parameters: Any | None = None) -> Any:
        """
        The states from `state` [state] on under `inputs` [T, input], a new float64 array [T + 1, state]; with nominal parameters
        unless others [parameter] are given.
        """

@final
class Tape:
    """
    What `VecEnv.step_recorded` remembers of up to so many steps.
    """
    def __len__(self, /) -> int:
        """
        Steps recorded.
        """
    @property
    def bytes(self, /) -> int:
        """
        Of memory.
        """
    def clear(self, /) -> None:
        """
        Forgets all steps and keeps the memory.
        """
    @property
    def horizon(self, /) -> int:
        """
        Steps that fit.
        """

@final
class TrackPath:
    """
    A lemniscate that episodes draw: where tasks of the library that follow a path have theirs from. Its numbers stand in the goal.

    Parameters
    ----------
    dt : float
        Seconds per step: `self.dt` of a task.
    **settings
        Those of `omnidrones.PathSettings`. `TrackPath.of(task)` takes all of it from a task that has them.
    """
    def __new__(cls, dt: SupportsFloat | SupportsIndex, /, **settings) -> TrackPath: ...
    @staticmethod
    def _settings() -> list[tuple[str, Any, str, str, str]]:
        """
        What `PathSettings` consists of: key, default, unit, meaning, domain.
        """
    def at(self, /, goal: Any, step: Any) -> Any:
        """
        The point of the path at a step, m, world, [3].
        """
    def draw(self, /, start: Start) -> Any:
        """
        Draws a path, and writes it into the goal; where it begins, m, world, [3].
        """
    def far(self, /, goal: Any, error: Any) -> Any:
        """
        Whether an error, m, is beyond the reset distance of the episode.
        """
    def join(self, /, start: Start, first: SupportsIndex = 0, *, lever: Any | None = None) -> None:
        """
        Gives the root of tree 0 the velocity along the path, where the episode begins along it (`start_along`). `first` is the place of the
        path in the goal. With a `lever` (m) the root leans as it is held by its thrust along the path, the point that far below it.
        """
    @staticmethod
    def of(task: Any) -> TrackPath:
        """
        Of a task with `PathSettings`.
        """
    def velocity(self, /, goal: Any, step: Any) -> Any:
        """
        Its velocity at a step, m/s, world, [3].
        """

@final
class Trim:
    """
    A steady flight and its exact linear model.
    """
    @property
    def input(self, /) -> Any:
        """
        The plant's input, float64 [input].
        """
    @property
    def limited(self, /) -> list[int]:
        """
        Places of inputs that stand at a limit.
        """
    @property
    def model(self, /) -> StateSpace:
        """
        One step about it, of the error state: a rotation counts three numbers.
        """
    @property
    def residual(self, /) -> float:
        """
        The largest rate of change that is left, SI.
        """
    @property
    def state(self, /) -> Any:
        """
        The plant's state, float64 [state].
        """
    @property
    def yaw_rate(self, /) -> float:
        """
        About the vertical, rad/s.
        """

@final
class VecEnv:
    """
    Many environments of one task, stepped together: E environments of A agents.

    Parameters
    ----------
    name : str or Task
        A task, as `omnidrones.tasks()` lists them; case does not matter. Or a class of your own, `omnidrones.Task`.
    num_envs : int, optional
        E; 4096 unless `config` says otherwise.
    config : dict or path or str, optional
        Settings: a dict, a TOML file, or TOML itself (a text with `=`). Tables are merged over the task's own defaults.
    seed : int, optional
        Of all that is drawn, 0 to 2^64 - 1.
    threads : int, optional
        1 runs on the caller's; by default all cores are shared by all environments of the process. The bits do not depend on it.
    ring : int
        Sets of arrays that take turns: arrays of a step stay as they are for `ring - 1` further steps.
    **settings
        Settings by name, over `config`: `dt=0.01`, `control="rate"`, `autoreset="disabled"`, and those of the task: `horizon=200`.
        `vehicle` is a name, a `Vehicle`, or the path of a TOML or URDF file. None leaves a setting out. Functions called `reward`,
        `observe`, `ends`, ... take the place of the task's own.

    Arrays are `float32` and row-major (flags `bool`), SI units; the library owns and reuses them. `env.spec` names every
    number with its unit.

    Raises
    ------
    ValueError
        For names, settings and sizes that do not fit, with the value, the limit and the remedy.
    OSError
        For files that cannot be read.
    """
    def __new__(cls, name: Any, /, num_envs: SupportsIndex | None = None, *, config: Any | None = None, seed: Any | None = None, threads: SupportsIndex | None = None, ring: SupportsIndex = 2, **settings) -> VecEnv: ...
    def __reduce__(self, /) -> tuple[Any, tuple]:
        """
        Pickles and copies are of the settings and the exact state, with its observations.
        """
    def __repr__(self, /) -> str: ...
    def _is_recorded_alike(self, /, other: VecEnv) -> bool:
        """
        Whether another batch runs the very programs of this one, gradients too.
        """
    def _printed(self, /) -> list[tuple[str, str]]:
        """
        What was recorded for it, printed, by name.
        """
    def _steps(self, /, actions: Any, n: SupportsIndex) -> Any:
        """
        `n` steps in a loop without Python, through the rows of `actions` [set, E, A, action] in turn: what the benchmark sets the
        same loop in Python against. None is the crossing alone.
        """
    def adjoint(self, /, parameters: bool = False) -> Adjoint:
        """
        The adjoint of a step, recorded and compiled: milliseconds for a vehicle, up to seconds for a team. With `parameters`,
        sweeps also give gradients by the physical numbers that differ between environments.
        """
    def breach(self, /, environment: SupportsIndex) -> str | None:
        """
        What broke where the simulation of one environment last diverged, in words; None where none has.
        """
    @property
    def central(self, /) -> Any:
        """
        State of the whole team for critics, [E, central]; no columns where the task has none.
        """
    def column(self, /, name: str) -> Any:
        """
        One column of `info`, [E]: "return", "success", "position_error".
        """
    @property
    def config(self, /) -> dict:
        """
        All settings as a dict: what another environment is made of, `make(env.spec.task, config=env.config)`.
        """
    @property
    def device(self, /) -> str:
        """
        Where they are: "cpu". `DeviceEnv` is elsewhere.
        """
    def evaluate(self, /, arguments: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> Any:
        """
        The results of one step in float64, [result], for arguments as in `Jacobian.arguments`.
        """
    @property
    def final_central(self, /) -> Any:
        """
        The last central state of episodes that ended in the last step, [E, central]; other rows hold older numbers.
        """
    @property
    def final_observation(self, /) -> Any:
        """
        The last observation of episodes that ended in the last step, [E, A, observation]; other rows hold older numbers.
        """
    def goals(self, /) -> Any:
        """
        The goal of every environment, a new array [E, goal].
        """
    @property
    def info(self, /) -> Any:
        """
        What the last step told of every episode, [E, column]; `spec.info` names the columns.
        """
    def jacobian(self, /, environment: SupportsIndex, action: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> Jacobian:
        """
        Exact derivatives of one step of one environment as it stands, for an action float64 [A * command]; without noise of
        sensors and without events.
        """
    def jacobian_at(self, /, arguments: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> Jacobian:
        """
        The same where the arguments are given, float64 [argument]: along a rollout through `evaluate`.
        """
    @property
    def layout(self, /) -> dict:
        """
        Places among the arguments and results of a step by name, as slices: see `Jacobian.layout`.
        """
    def load(self, /, state: bytes) -> None:
        """
        Goes on from what `save` gave to environments of the same settings, and shows what they look like.
        """
    @property
    def num_envs(self, /) -> int:
        """
        Environments, E.
        """
    @property
    def observation(self, /) -> Any:
        """
        Of the last step or reset, [E, A, observation].
        """
    def observe(self, /) -> Any:
        """
        Writes what the environments look like now and returns the observations; nothing moves on. For observations behind
        `set_state`, `set_statistics` and `update_normaliser`.
        """
    @property
    def parameter_names(self, /) -> list[str]:
        """
        Names of the columns of `parameters()`.
        """
    def parameters(self, /) -> Any:
        """
        The physical numbers in force in every environment, a new float64 array [E, number].
        """
    @property
    def privileged(self, /) -> Any:
        """
        The physical numbers that differ between environments, [E, number], SI; `spec.privileged` names them.
        """
    def reset(self, /, seed: Any | None = None, mask: Any | None = None) -> Any:
        """
        Begins episodes and returns the observations, [E, A, observation].

        Parameters
        ----------
        seed : int or sequence of int, optional
            A whole number for all environments, whose draws still differ by their place; or one per environment, [E]. With a
            seed, episodes count from their first again.
        mask : bool array [E], optional
            Environments to reset; the rows of others stay as they are.
        """
    @property
    def reward(self, /) -> Any:
        """
        Of the last step, [E, A]; the agents of an environment share one.
        """
    @property
    def safe_command(self, /) -> Any:
        """
        The command that an action stands for which is no number, [A * command]: rotors carry the weight, all else rests.
        """
    def sample(self, /, draw: SupportsIndex, out: Any | None = None) -> Any:
        """
        Random actions within their space, [E, A, action]: the same for the same draw, whatever the shard.
        """
    def save(self, /) -> bytes:
        """
        The exact state of all environments as bytes: what follows `load` has the bits of what follows this.
        """
    def set_difficulty(self, /, share: SupportsFloat | SupportsIndex) -> None:
        """
        From the next restarts on, episodes take this share of all randomisation, 0 to 1.
        """
    def set_state(self, /, environment: SupportsIndex, state: Any) -> None:
        """
        Overwrites the physical state of one environment, a float32 array [state]; its episode goes on.
        """
    def set_statistics(self, /, count: SupportsFloat | SupportsIndex, mean: SupportsGetItem[int, SupportsFloat | SupportsIndex], variance: SupportsGetItem[int, SupportsFloat | SupportsIndex]) -> None:
        """
        Freezes other statistics, and collects none from now on.
        """
    def set_threads(self, /, n: SupportsIndex | None) -> None:
        """
        Steps on so many threads from now on; None for those that all share.
        """
    @property
    def spec(self, /) -> Any:
        """
        Names, sizes, units and bounds: a `Spec`.
        """
    @property
    def state_names(self, /) -> list[str]:
        """
        Names of the columns of `states()`, with units.
        """
    def states(self, /) -> Any:
        """
        The physical state of every environment, a new array [E, state]; `state_names` names the columns.
        """
    @property
    def statistics(self, /) -> tuple[float, Any, Any]:
        """
        Of the stage `normalise`: (count, mean, variance), without one of no numbers.
        """
    def step(self, /, actions: Any) -> Any:
        """
        One step of every environment.

        Parameters
        ----------
        actions : float32 array [E, A, action] or [E, A * action]
            Numbers outside of the space are clipped; one that is no number acts as the task's safe command. Both are counted in
            the column `clipped`.

        Returns
        -------
        Step
            observation [E, A, observation], reward [E, A], terminated [E], truncated [E], info [E, column]: the same objects
            every `ring` steps. How episodes go on is the setting `autoreset`: "same_step" unless told otherwise.
        """
    def step_into(self, /, actions: Any, *, observation: Any, reward: Any, terminated: Any, truncated: Any, central: Any | None = None, privileged: Any | None = None, final_observation: Any | None = None, final_central: Any | None = None, info: Any | None = None) -> None:
        """
        One step into arrays of the caller: rows of a rollout's buffer. Those left out are not computed.

        Arrays are C-ordered `float32` in the shapes of `step`; flags are `bool` or `uint8`. `final_observation` and
        `final_central` are written in rows whose episode ended in this step.
        """
    def step_recorded(self, /, actions: Any, tape: Tape) -> Any:
        """
        As `step`, remembered by the tape.
        """
    def tape(self, /, horizon: SupportsIndex) -> Tape:
        """
        Memory for so many recorded steps.
        """
    @property
    def terminated(self, /) -> Any:
        """
        Whether the task ended the episode in the last step, bool [E].
        """
    @property
    def truncated(self, /) -> Any:
        """
        Whether the time of the episode was over in the last step, bool [E].
        """
    def update_normaliser(self, /) -> None:
        """
        Takes the statistics of all observations since the last call into the stage `normalise`, and freezes them.
        """

@final
class Vehicle:
    """
    A multirotor: a built-in one by name, or from a TOML or URDF file.
    """
    def __eq__(self, value: object, /) -> bool: ...
    def __ne__(self, value: object, /) -> bool: ...
    def __new__(cls, /, source: str | PathLike[str]) -> Vehicle:
        """
        A built-in name, as `vehicles()` lists them, or the path of a `.toml` or `.urdf` file.
        """
    def __reduce__(self, /) -> tuple[Any, tuple[dict]]: ...
    def __repr__(self, /) -> str: ...
    def check_steerable(self, /) -> None:
        """
        Refuses what cannot be steered: raises `ValueError` that names the axes that its rotors do not turn apart.
        """
    @staticmethod
    def from_dict(fields: Mapping) -> Vehicle:
        """
        From what `to_dict` gave, changed or not: SI units, checked.
        """
    @property
    def gains(self, /) -> dict:
        """
        Gains that fly it, published or derived: position, velocity (world), attitude, rate (body), 3 each, integral 2.
        """
    def hover(self, /) -> dict:
        """
        The attitude and the thrusts at which force and moment vanish: `attitude` [w, x, y, z] body to world, `thrusts` N, `lean` rad from
        the vertical, `reserve` the least share of its largest thrust that a rotor keeps to either limit, `tightest` that rotor.
        Raises `ValueError` with the row that cannot be met where there is none.
        """
    @property
    def inertia(self, /) -> Any:
        """
        About the centre of mass, body axes, float64 [3, 3], kg m^2.
        """
    @property
    def mass(self, /) -> float:
        """
        Of all parts, kg.
        """
    @property
    def n_rotor(self, /) -> int:
        """
        How many.
        """
    @property
    def name(self, /) -> str:
        """
        As in tables and messages.
        """
    def to_dict(self, /) -> dict:
        """
        All its numbers by the names of its file, SI units.
        """
    def to_toml(self, /) -> str:
        """
        As TOML that `Vehicle` reads back bit for bit.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What of its numbers is probably not meant: other units, an inertia that nobody gave, rotors that do not push up.
        """

@final
class View:
    """
    What a task sees after a step. Numbers record: they have no values until environments run.
    """
    def body(self, /, body: SupportsIndex | str) -> Motion:
        """
        Motion of a body of what flies, by number or name.
        """
    def clearance(self, /, segments: Any, radius: SupportsFloat | SupportsIndex, *, tree: SupportsIndex = 0) -> Any:
        """
        Least distance of the shapes of a tree (a drone of a team, what flies else) that touch to capsules of `radius` (m) around segments,
        [n, 2, 3], m, world: negative where they overlap. `Gate.bars` gives those of a gate.
        """
    def clearance_to_columns(self, /, places: Any, radii: SupportsGetItem[int, SupportsFloat | SupportsIndex], *, most: SupportsFloat | SupportsIndex = 10.0, drone: SupportsIndex = 0) -> Any:
        """
        Least distance of a drone, propellers included, to upright columns at `places` (x, y), [n, 2], m, world, that are higher than it flies,
        up to `most` (m); `radii` (m), [n], are constants.
        """
    @property
    def clock(self, /) -> Any:
        """
        Share of the time that is over, k/T.
        """
    def drone(self, /, drone: SupportsIndex = 0) -> Motion:
        """
        Motion of a drone.
        """
    def effort(self, /, drone: SupportsIndex = 0) -> Any:
        """
        The sum of `throttle`, e.
        """
    @property
    def goal(self, /) -> Any:
        """
        What stays through the episode: all numbers of the goal, in the order in which they were written.
        """
    def goal_field(self, /, name: str) -> Any:
        """
        A field of the goal, by the name that it was written with: a number, or an array of its numbers.
        """
    def joint(self, /, name: str) -> Any:
        """
        Angle (rad) or way (m) of a hinge or slide, by name, and its rate, [2].
        """
    def kept(self, /, name: str) -> Any:
        """
        A field of the task state, by the name that `remember` writes it with.
        """
    def mean_effort_reward(self, /) -> Any:
        """
        The mean of exp(-e) over the drones.
        """
    @property
    def n_drone(self, /) -> int:
        """
        Drones.
        """
    @property
    def speeds_before(self, /) -> Any:
        """
        Rotor speeds before the step, rad/s, of all drones.
        """
    @property
    def state(self, /) -> Any:
        """
        State of the physics, SI, in the robot's layout; `omnidrones.Robot.state_names` names the numbers.
        """
    @property
    def step(self, /) -> Any:
        """
        Steps since the episode began, k.
        """
    @property
    def task_state(self, /) -> Any:
        """
        What the task keeps from step to step, in the order of `remember`; zeros where an episode begins.
        """
    def throttle(self, /, drone: SupportsIndex = 0) -> Any:
        """
        Speeds of a drone's rotors as shares of the largest, s, [rotor].
        """
    def throttle_difference(self, /, drone: SupportsIndex = 0) -> Any:
        """
        By how much `throttle` differs from that before the step: the norm over a drone's rotors.
        """

@final
class Writer:
    """
    Takes numbers one after the other, and what they are called.
    """
    def field(self, /, name: str, unit: str, meaning: str, numbers: Any | None = None, *, low: SupportsFloat | SupportsIndex = ..., high: SupportsFloat | SupportsIndex = ..., smoothness: str = "smooth", layout: Any | None = None) -> None:
        """
        A field of an observation, a state or a memory: its name, unit (with the frame), meaning, and its numbers.

        Each number lies within [`low`, `high`], where these are given. `smoothness` says how far gradients may be trusted: "smooth",
        "piecewise", "non_smooth". `layout` says how they are arranged: ("members", n), ("image", height, width, channels),
        ("lidar", rows, columns). Numbers may be left out and follow by `write`.
        """
    def metric(self, /, name: str, unit: str, number: Any) -> None:
        """
        A figure that is reported in every step, in this unit; the first is the error, as a rule.
        """
    def observe_clock(self, /, view: View) -> None:
        """
        The share of the time that is over, four times: a network hears it.
        """
    def observe_drone(self, /, view: View, drone: SupportsIndex = 0) -> None:
        """
        The part of a drone's observation that all tasks share: attitude (w >= 0), velocity, angular velocity, heading, up, throttle
        2s - 1 per rotor, then direction and rate of every drive.
        """
    def term(self, /, name: str, formula: str, bound: SupportsFloat | SupportsIndex, number: Any, *, low: SupportsFloat | SupportsIndex = 0.0, smoothness: str = "smooth") -> None:
        """
        A summand of the reward: its name, formula, the largest value that it may have in a step, and the number. Its least value is `low`.
        """
    def unnamed(self, /, write: Any) -> None:
        """
        What `write` writes, as parts of the field that is open, whatever names it gives them: `write` is called with this writer.
        """
    def write(self, /, numbers: Any) -> None:
        """
        More numbers of the field that is open.
        """

def _carried(name: Any, settings: dict, *, training: bool = False) -> tuple[str, bytes | None, dict]:
    """
    A task and its settings for another process: its name, bytes for `_register_record` there (None for a task of the library), and the
    settings that are left.
    """

def _check_places(places: Any) -> None:
    """
    Raises unless all places, int64 [n], may be read here.
    """

def _compute(name: str, rows: Any, settings: SupportsGetItem[int, SupportsFloat | SupportsIndex] = ...) -> Any:
    """
    The same operation on plain numbers, float64 [n, operand] to float64 [n, result].
    """

def _constants(values: Any) -> Any:
    """
    Places of constants, float64 [n] to int64 [n].
    """

def _evaluation(shards: SupportsGetItem[int, tuple[Any, Any, Any, Any, Any]], policy: Any, name: Any | None = None, *, config: Any | None = None, **settings) -> dict:
    """
    What `evaluate` tells, of shards in the order of their environments.
    """

def _fly_shard(policy: Any, name: Any | None, num_envs: SupportsIndex, first_environment: SupportsIndex, *, seed: SupportsIndex = 1000003, threads: SupportsIndex | None = None, config: Any | None = None, **settings) -> tuple[Any, Any, Any, Any, Any]:
    """
    The episodes of a shard of an evaluation, for `_evaluation`.
    """

def _give_back(address: SupportsIndex) -> None:
    """
    Gives back what a capsule of `DeviceArray.__dlpack__` held that nobody took.
    """

def _is_recording() -> bool:
    """
    Whether something is being recorded on this thread.
    """

def _record(name: str, rows: Any, settings: SupportsGetItem[int, SupportsFloat | SupportsIndex] = ...) -> Any:
    """
    Records an operation on rows of places, int64 [n, operand] to int64 [n, result].
    """

def _register(name: str, task: Any, base: str | None = None) -> str:
    """
    Makes a class known by a name; with a `base`, an object whose methods take the place of that task's. Its name.
    """

def _register_record(record: bytes) -> str:
    """
    Makes the task of a record known by its name, unless a class of that name is; its name.
    """

def _restore(task: str, config: str, seed: SupportsIndex, threads: SupportsIndex | None, ring: SupportsIndex, state: bytes, record: bytes | None = None) -> VecEnv:
    """
    What `VecEnv.__reduce__` took apart.
    """

def _restore_on_device(task: str, config: str, seed: SupportsIndex, device: str, state: bytes, record: bytes | None = None) -> DeviceEnv:
    """
    What `DeviceEnv.__reduce__` took apart.
    """

def _restore_policy(task: str, config: str, parameters: Any, statistics: tuple[SupportsFloat | SupportsIndex, SupportsGetItem[int, SupportsFloat | SupportsIndex], SupportsGetItem[int, SupportsFloat | SupportsIndex]] | None, record: bytes | None = None) -> Policy:
    """
    What `Policy.__reduce__` took apart.
    """

def _restore_system(recording: bytes, states: SupportsGetItem[int, str], inputs: SupportsGetItem[int, str], theta: tuple[SupportsGetItem[int, str], SupportsGetItem[int, SupportsFloat | SupportsIndex], SupportsGetItem[int, tuple[str, SupportsGetItem[int, SupportsIndex]]] | None] | None, integrated: tuple[SupportsIndex, SupportsFloat | SupportsIndex] | None, dt: SupportsFloat | SupportsIndex | None) -> System:
    """
    What `System.__reduce__` took apart.
    """

def _setting_keys() -> list[str]:
    """
    Keys of environments and of training: no settings of tasks.
    """

def _task_name(name: str) -> str:
    """
    The name of a task as the registry has it.
    """

def _task_spec(name: str) -> str:
    """
    What a task says of itself, as JSON: everything that is named where it is written.
    """

def allocate(vehicle: Any, wrench: SupportsLenAndGetItem[SupportsFloat | SupportsIndex], /, *, effectiveness: SupportsGetItem[int, SupportsFloat | SupportsIndex] | None = None, yaw_last: bool = False) -> Allocation:
    """
    Rotor thrusts within their limits that make a wrench as nearly as can be.

    Parameters
    ----------
    vehicle : Vehicle or str or path
    wrench : six floats
        Force (N) and moment about the centre of mass (N m), body axes.
    effectiveness : sequence of float, optional
        What is left of each rotor's largest thrust, 0 (lost) to 1.
    yaw_last : bool
        Thrust, roll and pitch first; side forces and yaw with what is left.
    """

def attitude_error(desired: Any, actual: Any) -> Any:
    """
    The sine of the angle between a wanted and a measured attitude, body to world [3, 3], times its axis, body [3]; beyond 90 degrees
    the axis.
    """

def configurations() -> list[str]:
    """
    Names of the built-in systems of bodies.
    """

def design(vehicle: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, rates: dict | None = None, latency: SupportsIndex = 0, wind: SupportsLenAndGetItem[SupportsFloat | SupportsIndex] | None = None, **physics) -> Design:
    """
    What a vehicle's control loop bears about hover, as `omnidrones design` reports it.

    Parameters
    ----------
    vehicle : Vehicle or str or path
    controller : str or ControlLaw, optional
        As "lqi", or one of your own, in place of the cascade.
    gains : dict, optional
        Of the cascade, as `Vehicle.gains`, which are the default.
    rates : dict, optional
        How often each level computes, Hz: "velocity", "attitude", "rate".
    latency : int
        Steps by which commands act late.
    wind : three floats, optional
        In which it holds its place, m/s, world.
    **physics
        `dt=0.002` (s), `substeps`, `integrator`, `effects`.
    """

def evaluate(policy: Any, name: Any | None = None, *, num_envs: SupportsIndex = 1024, seed: SupportsIndex = 1000003, threads: SupportsIndex | None = None, config: Any | None = None, **settings) -> dict:
    """
    Flies one episode from each of so many starts and tells how well: by name "success" with "success_interval" (95 %, Wilson),
    "crashed", "return_mean", "final_error", "ends", "activity" of the commands of rotors, and more.

    Parameters
    ----------
    policy : Policy or callable
        A callable gets the observations, a float32 array [E, A, observation] that is reused, and returns actions
        [E, A, action].
    name : str, optional
        A task; that of a `Policy` by default, in the environments that it was trained in.
    num_envs : int
        Starts, one episode each.
    seed : int
        Of the starts; 1000003 are those that `train` evaluates on.
    config, **settings
        Of the environments, as in `make`.
    """

def export_c(what: Any, /, folder: str | PathLike[str] | None = None, *, controller: str | None = None, gains: Mapping | None = None, rates: Mapping | None = None, filters: Any | None = None, name: str | None = None, precision: str = "float", force: bool = False, **physics) -> CModule:
    """
    A vehicle, a controller, a reference, a task or a policy as C99 without allocation, libraries or global state.

    Parameters
    ----------
    what : Vehicle or str or path or dict or VecEnv or Policy
        - a vehicle or a configuration, its name or file, as `fly` takes it: one step of it; with a `controller`, a tick of that;
        - a reference, as `fly` takes it: `{"kind": "circle"}`, the target of a controller by time;
        - environments: what their task observes, rewards and ends;
        - a policy, or the folder of a run: from state and goal to the action.
    folder : path, optional
        Where its files are written, as `CModule.write` does.
    controller : str, optional
        Of the plant, as "indi".
    gains : dict, optional
        Of the controller, as `Vehicle.gains`.
    rates : dict, optional
        How often each of its levels computes, Hz: "velocity", "attitude", "rate".
    filters : list of dict, optional
        Of the measured angular velocity, as `fly` takes them.
    name : str, optional
        What files and functions begin with; by default after what is exported.
    precision : str
        Of its numbers: "float" or "double".
    force : bool
        Whether files that are there are replaced.
    **physics
        Of a plant: `dt=0.002` (s), `substeps`, `integrator`, `effects`.
    """

def export_onnx(policy: Any, /, path: str | PathLike[str] | None = None, *, agent: SupportsIndex = 0, force: bool = False) -> bytes:
    """
    A policy as ONNX (operators of version 17), from the observation that a user has, before it is normalised, to the action.

    Inputs are `observation` [batch, observation] of one agent and, of a policy with memory, `memory` [batch, unit], zeros where an
    episode begins; outputs are `action` [batch, action], the most likely one, and `memory_next`. All are float32 but for discrete
    actions, int64. The file's metadata name every number.

    Parameters
    ----------
    policy : Policy or str or path
        A policy, or the folder of a run.
    path : path, optional
        The file to write. One that is there and is another is left with `FileExistsError`, unless `force`.
    agent : int
        Whose network, where agents have their own.
    force : bool
        Whether a file that is there is replaced.
    """

def fly(plant: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, sensors: Any | None = None, estimator: Any | None = None, **plan) -> Flight:
    """
    Flies a vehicle or a configuration along a reference under a controller.

    Parameters
    ----------
    plant : Vehicle or str or path
        A vehicle, its name or file, or a configuration as `configurations()` lists them.
    controller : str or ControlLaw, optional
        As "indi", or one of your own; the first that suits the plant by default.
    gains : dict, optional
        As `Vehicle.gains`.
    sensors : str or list of dict or path, optional
        What reads along: a text as "imu:bmi088,motion_capture:optical", a list of tables, or a TOML file of `[[sensor]]` tables.
    estimator : str or dict, optional
        What makes a state of these readings, which the controller is given in place of the truth: "ekf" (a `StateEstimator`),
        "complementary" (fixed gains) or "kalman" (a steady filter about hover, driven by commands); or a dict of settings, with "kind"
        beside them, by default those of `StateEstimator`.
    **plan
        `duration=15.0` (s), `reference={"kind": "circle", ...}`, `physics={"dt": 0.002}`, `rates`, `wind`, `failures`, `latency` (steps),
        `detection_delay` (s), `seed`, `tilt`, `filters=[{"kind": "low_pass", "frequency": 80.0}]` (of the measured angular velocity): the
        fields of a flight plan. `reference` may be a function of the time (s), called once, with a number that records, that returns a
        position [3] (m), or a tuple of it and a yaw (rad): derivatives up to snap are exact. `wind` may be one that returns a velocity of
        the air [3], m/s, world.
    """

def linearise(plant: Any, /, *, velocity: SupportsLenAndGetItem[SupportsFloat | SupportsIndex] = ..., yaw_rate: SupportsFloat | SupportsIndex = 0.0, roll: SupportsFloat | SupportsIndex | None = None, pitch: SupportsFloat | SupportsIndex | None = None, wind: SupportsLenAndGetItem[SupportsFloat | SupportsIndex] | None = None, fail: dict | None = None, **physics) -> Trim:
    """
    A steady flight of a vehicle or a configuration (hover, forward, climbing, turning, leaning) and the exact linear model of one
    step about it.

    Parameters
    ----------
    plant : Vehicle or str or path
    velocity : three floats
        Forward, left, up, m/s.
    yaw_rate : float
        rad/s.
    roll, pitch : float, optional
        To hold, rad; found where they are not given.
    wind : three floats, optional
        World, m/s.
    fail : dict, optional
        What is left of rotors, by number or name: `{1: 0.0}` lost one, `{"rotor_2": 0.6}` weakened one. A vehicle that must spin to stay
        up is found in its turn.
    **physics
        `dt=0.002` (s), `substeps`, `integrator`, `effects`.
    """

def load_policy(path: str | PathLike[str]) -> Policy:
    """
    The policy of a run's folder, or of one of its checkpoints.

    Raises `FileNotFoundError` where there is none, `ValueError` for damaged files.
    """

def lqg(model: StateSpace, kalman: SteadyKalman, gain: Any, /) -> StateSpace:
    """
    The controller from y to u that feeds back what a steady filter estimates, u = -K x: least quadratic cost under white noise (LQG).
    Close the loop with positive sign, the minus is inside. Of a sampled model the measurement of a sample counts in its command.

    Parameters
    ----------
    model : StateSpace
        That of the filter.
    kalman : SteadyKalman
    gain : Regulator or array [input, state]
        As `lqr` gives it.
    """

def lqr(model: StateSpace, Q: Any, R: Any, /) -> Regulator:
    """
    The feedback of least sum of x' Q x + u' R u for a sampled model.

    Parameters
    ----------
    model : StateSpace
        As `linearise` gives it.
    Q : array [state, state]
        float64, symmetric.
    R : array [input, input]
        float64, symmetric, positive definite.
    """

def monte_carlo(plant: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, **plan) -> MonteCarloRun:
    """
    Flies thousands of plants that differ, side by side, under one controller that believes the nominal one.

    Parameters
    ----------
    plant : Vehicle or str or path
    controller : str or ControlLaw, optional
        One that flies in lanes: "cascade" (default), "lqi", "lqr" of a vehicle, "formation" of a configuration, or one of your own.
    gains : dict, optional
        As `Vehicle.gains`.
    **plan
        `n=10000`, `vary={"mass": 0.2, "inertia": 0.2, "thrust_coefficient": 0.1}` (factors within 1 - 0.2 and 1 + 0.2: names of
        `Loop.parameter_names`, or what several end in behind their point), `wind=0.0` (m/s at most, steady, from any side),
        `position_spread=0.3` (m), `velocity_spread=0.3` (m/s), `tilt_spread=0.2` (rad), `duration=10.0` (s), `transient=2.0` (s),
        `reference`, `rates`, `latency` (steps), `physics`, `seed=0`, `confidence=0.95`.
    """

def optimise(problem: Any, /, *, guess: Any | None = None, iterations: SupportsIndex | None = None, progress: Any | None = None) -> OptimalTrajectory:
    """
    The trajectory of least cost of a problem: a vehicle or a configuration, a start and a goal, gates and obstacles on the way.

    Parameters
    ----------
    problem : str or path or dict
        A built-in name ("flip", "slalom", "landing", "race"), the path of a TOML file, or what stands in one: TOML (a text with `=`) or a
        dict.
    guess : OptimalTrajectory or (states, inputs) or inputs, optional
        Where the search begins, float64 arrays [N + 1, state] and [N, input]; states need not follow from the inputs. Inputs alone are
        flown from the start. By default as the problem says.
    iterations : int, optional
        Most of them; by default as the problem says.
    progress : callable, optional
        Called with (iteration, cost, gap, violation) of every iteration. An exception ends the search and is raised.

    A search that ends before the tolerances are met raises nothing: look at `solved` or `status`.
    """

def plot(curves: dict, /, *, title: str = "", x: str = "", y: str = "", log_x: bool = False, log_y: bool = False) -> Figure:
    """
    Curves in one chart.

    Parameters
    ----------
    curves : dict
        By the name in the legend, (x, y): two arrays [point] or what NumPy makes some of; what is not finite leaves a gap.
    title, x, y : str
        Above the chart and at its axes, with units: "time [s]".
    log_x, log_y : bool
        Logarithmic axes; what is not positive leaves a gap there.
    """

def recipes(task: Any) -> list[str]:
    """
    Names of the algorithms that have a recipe for a task, the usual one first.
    """

def recovery_map(plant: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, rates: dict | None = None, tilt: tuple[SupportsFloat | SupportsIndex, SupportsIndex] = ..., rate: tuple[SupportsFloat | SupportsIndex, SupportsIndex] = ..., speed: SupportsFloat | SupportsIndex = 0.0, n: SupportsIndex = 64, duration: SupportsFloat | SupportsIndex = 6.0, confidence: SupportsFloat | SupportsIndex = 0.95, seed: SupportsIndex = 0, **physics) -> RecoveryMap:
    """
    Flies a plant from starts of all tilts and body rates, and counts which a controller brings back within half a metre of where it was
    let go.

    Parameters
    ----------
    plant : Vehicle or str or path
    controller : str or ControlLaw, optional
        The first that suits by default.
    gains, rates : dict, optional
        As of `fly`.
    tilt, rate : tuple of float and int
        The largest tilt (rad) and body rate (rad/s), and in how many intervals from zero.
    speed : float
        Of a start, at most, m/s.
    n : int
        Starts per cell.
    duration : float
        Of a flight, at most, s.
    confidence : float
        Of the bounds.
    seed : int
        Of the starts.
    **physics
        `dt=0.002` (s), `substeps`, `integrator`, `effects`.
    """

def solve_stage_qp(A: Any, B: Any, c: Any | None, Q: Any, S: Any | None, R: Any, q: Any | None, r: Any | None, lower: Any | None, upper: Any | None, x0: Any, *, tolerance: SupportsFloat | SupportsIndex = 1e-9, iterations: SupportsIndex = 60) -> StageQpSolution:
    """
    Solves a convex quadratic program over N stages that linear dynamics link, with bounds on every input, in time linear in N:

    least sum of x' Q x / 2 + u' S x + u' R u / 2 + q' x + r' u, with x+ = A x + B u + c from x0 on and lower <= u <= upper.

    Parameters
    ----------
    A : array [N, state, state]
    B : array [N, state, input]
    c : array [N, state], optional
    Q : array [N + 1, state, state]
        Symmetric; the last is that of the end.
    S : array [N, input, state], optional
    R : array [N, input, input]
        Symmetric.
    q : array [N + 1, state], optional
    r : array [N, input], optional
    lower, upper : array [N, input], optional
        -inf and inf where an input has none.
    x0 : array [state]
    tolerance : float
        Largest `residual` of a solution.
    iterations : int
        Most recursions.

    All arrays are float64; None stands for zeros, or for no bounds. Raises `ValueError` with the stage where the cost is not convex in the
    inputs.
    """

def steady_kalman(model: StateSpace, W: Any, V: Any, /) -> SteadyKalman:
    """
    The steady Kalman filter of a model x+ = A x + B u + w, y = C x + D u + v with white noise: by the Riccati equation of its error.

    Parameters
    ----------
    model : StateSpace
        As `linearise` gives it, or `StateSpace(A, B, C, dt=dt)`: what C shows is measured.
    W : array [state, state]
        Covariance of w, float64; for dx/dt a density.
    V : array [output, output]
        Covariance of v, float64, positive definite; for dx/dt a density.

    Raises `ValueError` that names the states where something that does not decay is seen by no output, or moved by no noise.
    """

def tasks() -> list[str]:
    """
    Names of the tasks.
    """

def train(name: Any, /, config: Any | None = None, *, algorithm: str | None = None, seed: SupportsIndex | None = None, threads: SupportsIndex | None = None, folder: str | PathLike[str] | None = None, resume: bool = False, watch: Any | None = None, **settings) -> Run:
    """
    Trains a policy for a task, from random weights or from where a folder stopped, and evaluates it on starts that training
    never saw.

    Parameters
    ----------
    name : str or Task
        A task, or a class of your own.
    config : dict or path or str, optional
        Settings of the run over the task's recipe, as `omnidrones train TASK --toml` prints them: a dict, a TOML file, or TOML.
    algorithm : str, optional
        "apg", "shac", "ppo", "sac", "td3", "dqn", "dagger" or a variant such as "qmix"; the task's recipe knows which by default.
    seed : int, optional
        Of all that is drawn, up to 2^63 - 1.
    threads : int, optional
        All cores by default. The bits do not depend on it.
    folder : path, optional
        Where the run is kept; with `resume` it goes on from the newest whole checkpoint there, to the same bits.
    watch : callable, optional
        Called with a `Progress` after every update; False stops the run behind it. An exception ends it and is raised.
    **settings
        As in `config`, by name: `evaluate={"envs": 64}`, `apg={"updates": 100}`, and those of the environment: `dt=0.01`, `horizon=200`.
    """

def tune(vehicle: Any, /, *, controller: Any | None = None, gains: Mapping | None = None, watch: Any | None = None, **plan) -> dict:
    """
    Tunes the gains of a vehicle's cascade, or of a controller of one's own, by gradients through closed-loop flights, and judges them on
    starts that tuning did not see: a dict with "gains", "before" and "after" (held-out flights: "rmse", "worst" in m, "crashed").

    Parameters
    ----------
    vehicle : Vehicle or str or path
    controller : ControlLaw, optional
        Whose gains are tuned, from their own values: all of them must be positive.
    gains : dict, optional
        Of the cascade, to begin from; the vehicle's own by default.
    watch : callable, optional
        Called with (iteration, error in m) of every step.
    **plan
        `iterations=60`, `duration=6.0` (s), `reference`, `n_start`, `n_held_out`, `latency` (steps) and more.
    """

def vehicles() -> list[str]:
    """
    Names of the built-in vehicles.
    """
