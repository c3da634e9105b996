"""PyTorch: environments as tensors, exact gradients through their steps, through closed loops and through allocations.

>>> env = omnidrones.torch.TensorEnv(omnidrones.make("Hover", 65536, device="cuda"))
>>> observation = env.reset()
>>> for _ in range(100):
...     observation, reward, terminated, truncated, info = env.step(network(observation))   # nothing leaves the card

>>> env = omnidrones.torch.TensorEnv(omnidrones.make("Hover", 64, stagger=True))
>>> rollout = omnidrones.torch.Rollout(env, horizon=48)
>>> observation = env.reset()
>>> for _ in range(800):
...     rollout.begin()
...     observation, cost = env.observation.clone(), 0.0
...     for _ in range(48):
...         observation, reward, loss, *_ = rollout.step(network(observation))
...         cost = cost + loss.mean()
...     optimiser.zero_grad()
...     cost.backward()
...     optimiser.step()

>>> loop = omnidrones.Loop("hummingbird")
>>> theta = torch.tensor(loop.parameters, requires_grad=True)
>>> states = trajectory(loop, loop.initial_state(), loop.inputs(1000), theta)     # [1001, state], float64
>>> states[-1, :3].square().sum().backward()
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from . import _core


class TensorStep(NamedTuple):
    """What a step wrote, E environments of A agents: views of memory that later steps write again."""

    observation: torch.Tensor
    """[E, A, observation]: what the next action answers to."""
    reward: torch.Tensor
    """[E, A]; the agents of an environment share one."""
    terminated: torch.Tensor
    """bool [E]: the task ended the episode."""
    truncated: torch.Tensor
    """bool [E]: its time was over."""
    info: torch.Tensor
    """[E, column]; `Spec.info` names the columns. Of the episode that the step belonged to."""


class TensorEnv:
    """A batch of environments whose arrays are tensors where they lie, on the host or on a device, without a copy.

    >>> env = TensorEnv(omnidrones.make("Hover", 4096, device="cuda"))

    Views hold until a later step writes them again: on a device the next one, on the host `ring - 1` further ones. What must stay is
    cloned, or copied into a buffer; autograd does not notice what a step writes. On a card, work goes to PyTorch's current stream. A
    `torch.cuda.graph` may have steps and resets, but no seeds, and no task that begins on the host (Formation).

    An episode that ends begins anew in the same step (the setting `autoreset`): `observation` is the next episode's first, and
    `final_observation` has the last of the one before in those rows. A value behind a step is
    `torch.where(truncated & ~terminated, V(final_observation), V(observation)) * ~terminated`.

    Parameters
    ----------
    env : omnidrones.VecEnv or omnidrones.DeviceEnv
        What is stepped.

    Attributes
    ----------
    env : omnidrones.VecEnv or omnidrones.DeviceEnv
        All else that it does: `save`, `update_normaliser`, `states`.
    spec : omnidrones.Spec
    num_envs : int
        E.
    device : torch.device
        Where the tensors are.
    """

    def __init__(self, env: _core.VecEnv | _core.DeviceEnv) -> None:
        if not isinstance(env, (_core.VecEnv, _core.DeviceEnv)):
            raise TypeError(f"env is a {type(env).__name__}, but it must be what omnidrones.make gives. Pass that.")
        self.env, self.spec, self.num_envs = env, env.spec, env.num_envs
        # arrays of the stand-in for a card are the host's
        self.device = torch.device("cpu" if env.device == "emulated" else env.device)
        self._follow()
        self._views: dict[str, torch.Tensor] = {}
        self._steps: list[tuple[Any, TensorStep]] = []

    def _follow(self) -> None:
        """Lets work go where PyTorch's goes."""
        if isinstance(self.env, _core.DeviceEnv) and self.device.type == "cuda":
            self.env.stream = torch.cuda.current_stream(self.device).cuda_stream

    def _here(self) -> AbstractContextManager[Any]:
        """Work goes where PyTorch's goes; PyTorch hands out tensors of its current card alone."""
        self._follow()
        return torch.cuda.device(self.device) if self.device.type == "cuda" else nullcontext()

    def _there(self, what: str, given: Any) -> torch.Tensor:
        if not isinstance(given, torch.Tensor):
            told = f"{what} is a {type(given).__name__}, but it must be a tensor on {self.device}."
            raise TypeError(f"{told} Pass torch.as_tensor({what}, device=env.device).")
        if given.device != self.device:
            raise ValueError(f"{what} is on {given.device}, but environments are on {self.device}. Move one of them.")
        return given.detach()

    def _given(self, action: torch.Tensor) -> Any:
        action = self._there("action", action)
        if self.spec.action.kind == "box" and not action.is_floating_point():
            raise TypeError(f"action is of {action.dtype}, but its space has numbers that are not whole. Pass floats.")
        action = action.to(torch.float32).contiguous()
        return action if isinstance(self.env, _core.DeviceEnv) else action.numpy()

    def reset(self, seed: int | list[int] | None = None, mask: torch.Tensor | None = None) -> torch.Tensor:
        """Begins episodes, of all or of those whose `mask`, bool [E] or [E, 1], is set, and returns the observations.

        `seed` is a whole number for all, or one each. Rows of the info of environments that begin are zero.
        """
        which: Any = None
        if mask is not None:
            which = self._there("mask", mask).to(torch.bool).reshape(-1).contiguous()
        with self._here():
            self.env.reset(seed, which if which is None or isinstance(self.env, _core.DeviceEnv) else which.numpy())
        return self.observation

    def step(self, action: torch.Tensor) -> TensorStep:
        """One step of every environment.

        `action` is [E, A, action] or [E, A * action], on the device of the environments, of any kind of float or, where the space is
        discrete, of whole numbers. Gradients end here: `Rollout` carries them.
        """
        with self._here():
            return self._seen(self.env.step(self._given(action)))

    def sample(self, draw: int) -> torch.Tensor:
        """Random actions within their space, [E, A, action]: the same for the same number `draw`."""
        return torch.from_numpy(self.env.sample(draw)).to(self.device)

    def step_recorded(self, action: torch.Tensor, tape: Any) -> TensorStep:
        """As `step`, remembered by a tape of the environments."""
        with self._here():
            return self._seen(self.env.step_recorded(self._given(action), tape))

    def _seen(self, step: Any) -> TensorStep:
        for known, seen in self._steps:
            if known is step:
                return seen
        seen = TensorStep(*map(_view, step))
        self._steps.append((step, seen))
        return seen

    def _array(self, name: str) -> torch.Tensor:
        if not isinstance(self.env, _core.DeviceEnv):
            return _view(getattr(self.env, name))
        if name not in self._views:
            with self._here():
                self._views[name] = _view(getattr(self.env, name))
        return self._views[name]

    def observe(self) -> torch.Tensor:
        """What the environments look like now; nothing moves on."""
        self._follow()
        self.env.observe()
        return self.observation

    @property
    def observation(self) -> torch.Tensor:
        """Of the last step or reset, [E, A, observation]."""
        return self._array("observation")

    @property
    def central(self) -> torch.Tensor:
        """State of the whole team for critics, [E, central]."""
        return self._array("central")

    @property
    def privileged(self) -> torch.Tensor:
        """The physical numbers that differ between environments, [E, number], SI."""
        return self._array("privileged")

    @property
    def final_observation(self) -> torch.Tensor:
        """The last observation of episodes that ended in the last step, [E, A, observation]; other rows hold older numbers."""
        return self._array("final_observation")

    @property
    def final_central(self) -> torch.Tensor:
        """The last central state of episodes that ended in the last step, [E, central]; other rows hold older numbers."""
        return self._array("final_central")

    def column(self, name: str) -> torch.Tensor:
        """One column of the information of the last step, [E]: "return", "success", "loss"."""
        if not isinstance(self.env, _core.DeviceEnv):
            return _view(self.env.column(name))
        if name not in self._views:
            with self._here():
                self._views[name] = _view(self.env.column(name))
        return self._views[name]


def _view(array: Any) -> torch.Tensor:
    """A tensor of the same memory, which autograd may keep, whenever it was made."""
    with torch.inference_mode(False):
        view: torch.Tensor = torch.from_numpy(array) if isinstance(array, np.ndarray) else torch.from_dlpack(array)
        return view


def _own(view: torch.Tensor) -> torch.Tensor:
    """A tensor that no step writes again, in the order of its axes."""
    return view.clone(memory_format=torch.contiguous_format)


def _tensors(env: Any) -> TensorEnv:
    """The tensors of what steps."""
    if isinstance(env, Rollout):
        return env.tensors
    return env if isinstance(env, TensorEnv) else TensorEnv(env)


def captured(work: Callable[[], Any], env: TensorEnv | Rollout | _core.VecEnv | _core.DeviceEnv) -> Callable[[], Any]:
    """`work` as one piece: on a card a graph of it, which asks for all its kernels at once; elsewhere `work` itself.

    What is returned gives what `work` gave when it was captured: the same tensors, written anew by each call. `work` steps
    environments, runs networks and may walk back through them; it reads tensors that stay where they are, takes no decision by their
    values, and does nothing that waits (`item`, `cpu`). It runs three times first, then once to be captured.
    """
    tensors = _tensors(env)
    if tensors.device.type != "cuda":
        return work
    side, graph = torch.cuda.Stream(tensors.device), torch.cuda.CUDAGraph()
    had_gc = gc.isenabled()
    try:
        with torch.cuda.device(tensors.device):
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                tensors._follow()
                for _ in range(3):
                    work()
            torch.cuda.current_stream().wait_stream(side)
            # what is freed while a graph is made would be part of it
            gc.collect()
            gc.disable()
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                tensors._follow()
                given = work()
    finally:
        tensors._follow()
        if had_gc:
            gc.enable()
    stepped: Any = tensors.env
    # what the graph works on stays as long as it may be replayed
    return partial(_replayed, tensors, graph, given, stepped._kept_by_graphs, (work, env))


def _replayed(tensors: TensorEnv, graph: torch.cuda.CUDAGraph, given: Any, kept: Any, _held: Any) -> Any:
    stepped: Any = tensors.env
    if stepped._kept_by_graphs != kept:
        raise RuntimeError("difficulty or collecting of the environments changed. Capture the work again.")
    # what is asked for next comes behind it
    tensors._follow()
    graph.replay()
    return given


class RolloutStep(NamedTuple):
    """What a step gave: tensors of their own; the first three have gradients."""

    observation: torch.Tensor
    """[E, A, observation]."""
    reward: torch.Tensor
    """[E, A]."""
    loss: torch.Tensor
    """[E], the task's training loss: smooth where the reward is not."""
    terminated: torch.Tensor
    """bool [E]."""
    truncated: torch.Tensor
    """bool [E]."""


class Rollout:
    """Steps of an environment that autograd walks back through, up to `horizon` of them between two calls of `begin`.

    Tensors are on the device of the environments, and nothing leaves it. A `torch.cuda.graph` may capture `begin`, the steps and
    `backward`. A window is walked back once, before the next `begin`: losses are summed first, and there are no second derivatives.

    Gradients are cut where an episode ends, and wherever something else moves the environments between two steps of the window: a step
    that is not the rollout's, `reset`, `load`, `set_state`, `replay`. With `autoreset="same_step"` the observation of a row that ended is
    the next episode's and has no gradient.

    Parameters
    ----------
    env : omnidrones.VecEnv, omnidrones.DeviceEnv or TensorEnv
        Its gradients are in float32.
    horizon : int
        Most steps of a window.
    decay : float
        Factor per step on what is carried; 1 is the exact gradient.
    clip : float
        Largest norm of what is carried, per environment.

    Attributes
    ----------
    tensors : TensorEnv
        The environments as tensors: `rollout.tensors.observation` is where a window begins.
    """

    def __init__(
        self,
        env: _core.VecEnv | _core.DeviceEnv | TensorEnv,
        horizon: int,
        *,
        decay: float = 1.0,
        clip: float = math.inf,
    ) -> None:
        self._window = _Window(_tensors(env), horizon, decay, clip)
        self.tensors = self._window.tensors
        self.env, self.tape, self.sweep = self.tensors.env, self._window.tape, self._window.sweep
        self.begin()

    def begin(self) -> None:
        """Begins a window where the environment stands; gradients do not reach behind it, and the window before is forgotten."""
        self._window.begin()
        # steps hand a token on, so that autograd pulls each after the one that followed it
        self._token = torch.zeros((), device=self.tensors.device, requires_grad=True)

    def step(self, action: torch.Tensor) -> RolloutStep:
        """One recorded step; `action` is as that of `TensorEnv.step`."""
        if len(self.tape) == self.tape.horizon:
            told = f"the window has its {self.tape.horizon} steps."
            raise RuntimeError(f"{told} Call rollout.begin() behind its backward pass, or make Rollout(env, horizon) longer.")
        if not isinstance(action, torch.Tensor):
            self.tensors._there("action", action)
        observation, reward, loss, terminated, truncated, self._token = _Step.apply(action, self._token, self._window)
        return RolloutStep(observation, reward, loss, terminated, truncated)


class _Window:
    """What autograd's steps hold: without their token, whose graph holds them."""

    def __init__(self, tensors: TensorEnv, horizon: int, decay: float, clip: float) -> None:
        self.tensors, self.number = tensors, 0
        with tensors._here():
            self.tape: Any = tensors.env.tape(horizon)
            self.sweep: Any = tensors.env.adjoint().sweep(decay, clip)
        self._down: torch.Tensor | None = None
        self._pulled_to: int | None = None

    def begin(self) -> None:
        with self.tensors._here():
            self.tape.clear()
            self.sweep.restart()
        self.number += 1
        self._pulled_to = None

    def pulled(self, number: int, t: int, cotangents: dict[str, torch.Tensor | None]) -> torch.Tensor:
        """Cotangents of the actions of a step."""
        if number != self.number:
            raise RuntimeError("this window was forgotten by rollout.begin(). Call backward before it.")
        if self._pulled_to is not None and t != self._pulled_to - 1:
            raise RuntimeError("a window is walked back once. Sum its losses and call backward once, or record it again.")
        self._pulled_to = t
        up = {name: x.to(torch.float32).contiguous() for name, x in cotangents.items() if x is not None}
        if isinstance(self.tensors.env, _core.VecEnv):
            return torch.from_numpy(self.sweep.pull(self.tape, t, **{name: x.numpy() for name, x in up.items()}))
        with self.tensors._here():
            down = self.sweep.pull(self.tape, t, **up)
            if self._down is None:
                self._down = _view(down)
            return _own(self._down)


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, action: torch.Tensor, token: torch.Tensor, window: _Window) -> tuple[torch.Tensor, ...]:
        ctx.window, ctx.number, ctx.t = window, window.number, len(window.tape)
        ctx.shape, ctx.dtype = action.shape, action.dtype
        ctx.set_materialize_grads(False)
        step = window.tensors.step_recorded(action, window.tape)
        loss = window.tensors.column("loss")
        told = [_own(x) for x in (step.observation, step.reward, loss, step.terminated, step.truncated)]
        ctx.mark_non_differentiable(*told[3:])
        return (*told, torch.zeros_like(token))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        observation, reward, loss, *_ = gradients
        # agents share the reward of the team: their cotangents add up
        team = None if reward is None else reward.sum(1)
        down = ctx.window.pulled(ctx.number, ctx.t, {"observation": observation, "reward": team, "loss": loss})
        return down.reshape(ctx.shape).to(ctx.dtype), torch.zeros((), device=down.device), None


class ExactStep(NamedTuple):
    """Results of a step in float64, with gradients."""

    carried: torch.Tensor
    """What goes from step to step: physics first."""
    observation: torch.Tensor
    reward: torch.Tensor
    loss: torch.Tensor


def exact_step(
    env: _core.VecEnv, arguments: NDArray[np.float64], carried: torch.Tensor, action: torch.Tensor
) -> ExactStep:
    """One step of one environment in float64, for `gradcheck` and small problems; without noise, events and ends.

    Parameters
    ----------
    env : omnidrones.VecEnv
        Says the task and its settings; it is not stepped.
    arguments : array
        `env.jacobian(environment, action).arguments`: goal, time and numbers of the environment there.
    carried, action : tensors
        In place of those among the arguments.
    """
    n = carried.numel()
    value = _ExactStep.apply(carried, action, env, np.asarray(arguments, np.float64))
    at = env.layout
    return ExactStep(value[:n], value[at["observation"]], value[at["reward"]][0], value[at["loss"]][0])


class _ExactStep(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, carried: torch.Tensor, action: torch.Tensor, env: _core.VecEnv, arguments: NDArray[np.float64]
    ) -> torch.Tensor:
        z, at = arguments.copy(), env.layout
        z[at["carried"]], z[at["action"]] = carried.detach().numpy(), action.detach().reshape(-1).numpy()
        ctx.env, ctx.z, ctx.shape = env, z, action.shape
        return torch.from_numpy(env.evaluate(z))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        at = ctx.env.layout
        down = torch.from_numpy(gradients[0].numpy() @ ctx.env.jacobian_at(ctx.z).matrix)
        return down[at["carried"]], down[at["action"]].reshape(ctx.shape), None, None


def trajectory(
    system: _core.System,
    state: torch.Tensor | NDArray[np.float64],
    inputs: torch.Tensor | NDArray[np.float64],
    parameters: torch.Tensor | NDArray[np.float64] | None = None,
) -> torch.Tensor:
    """The states of a system, [T + 1, state], in float64, with gradients by all three arguments.

    Parameters
    ----------
    system : omnidrones.System
        An `omnidrones.Loop` or another.
    state : tensor or array [state]
        Where it begins.
    inputs : tensor or array [T, input]
        As `Loop.inputs` gives them.
    parameters : tensor or array [parameter], optional
        Nominal ones unless given.
    """
    theta = system.parameters if parameters is None else parameters
    states: torch.Tensor = _Trajectory.apply(system, *map(_given, (state, inputs, theta)))
    return states


class _Trajectory(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, system: _core.System, *arguments: torch.Tensor) -> torch.Tensor:
        ctx.system = system
        ctx.save_for_backward(*arguments)
        return torch.from_numpy(system.trajectory(*map(_rows, arguments)))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        down = ctx.system.pull(_rows(gradients[0]), *map(_rows, ctx.saved_tensors))
        return None, *(torch.from_numpy(x).reshape(to.shape) for x, to in zip(down, ctx.saved_tensors))


def _given(x: torch.Tensor | NDArray[np.float64]) -> torch.Tensor:
    """A copy of what is no tensor: autograd does not see it written to before the backward pass."""
    return x if isinstance(x, torch.Tensor) else torch.tensor(x)


def _rows(tensor: torch.Tensor) -> NDArray[np.float64]:
    return np.ascontiguousarray(tensor.detach().numpy())


def allocate(
    allocation: _core.AllocationFunction, wrench: torch.Tensor, **numbers: torch.Tensor | NDArray[np.float64]
) -> torch.Tensor:
    """Rotor thrusts [..., rotor], N, that answer wrenches, in float64, with gradients by all that is a tensor.

    Parameters
    ----------
    allocation : omnidrones.AllocationFunction
    wrench : tensor [..., 6]
        Force (N) and moment about the centre of mass (N m), body axes.
    **numbers : tensors or arrays
        In place of those of `allocation.numbers`, of their shape or with the axes of `wrench` in front.
    """
    known = allocation.numbers
    if unknown := set(numbers) - set(known):
        raise ValueError(f"numbers of an allocation are {', '.join(known)}, not {', '.join(sorted(unknown))}.")
    front = wrench.shape[:-1]
    own = {name: torch.as_tensor(numbers.get(name, nominal)) for name, nominal in known.items()}
    parts = [own[name].expand(*front, *known[name].shape).reshape(*front, known[name].size) for name in known]
    inputs = torch.cat([wrench, *parts], -1).reshape(-1, allocation.n_input)
    thrusts = trajectory(allocation, torch.zeros(allocation.n_state, dtype=torch.float64), inputs)[1:]
    return thrusts.reshape(*front, allocation.n_state)
