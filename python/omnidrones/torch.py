"""PyTorch: exact gradients through steps of environments, through closed loops and through allocations.

>>> env = omnidrones.make("Hover", 64, stagger=True)
>>> rollout = omnidrones.torch.Rollout(env, horizon=48)
>>> observation = torch.from_numpy(env.reset().copy())
>>> cost = 0.0
>>> for _ in range(48):
...     observation, reward, loss, *_ = rollout.step(network(observation))
...     cost = cost + loss.mean()
>>> cost.backward()

>>> loop = omnidrones.Loop("hummingbird")
>>> theta = torch.tensor(loop.parameters, requires_grad=True)
>>> states = trajectory(loop, loop.initial_state(), loop.inputs(1000), theta)     # [1001, state], float64
>>> states[-1, :3].square().sum().backward()
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from . import _core


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

    Parameters
    ----------
    env : omnidrones.VecEnv
        Its gradients are in float32. They are cut where an episode ends; with `autoreset="same_step"` the observation of such a row is
        the next episode's and has no gradient.
    horizon : int
        Most steps of a window.
    decay : float
        Factor per step on what is carried; 1 is the exact gradient.
    clip : float
        Largest norm of what is carried, per environment.
    """

    def __init__(self, env: _core.VecEnv, horizon: int, *, decay: float = 1.0, clip: float = math.inf) -> None:
        self.env = env
        self.tape = env.tape(horizon)
        self.sweep = env.adjoint().sweep(decay, clip)
        self.begin()

    def begin(self) -> None:
        """Begins a window where the environment stands; gradients do not reach behind it."""
        self.tape.clear()
        self.sweep.restart()
        # steps hand a token on, so that autograd pulls each after the one that followed it
        self._token = torch.zeros((), requires_grad=True)

    def step(self, action: torch.Tensor) -> RolloutStep:
        """One recorded step; `action` is [E, A, action] or [E, A * action], on the processor."""
        observation, reward, loss, self._token = _Step.apply(action, self._token, self)
        terminated, truncated = (torch.from_numpy(x.copy()) for x in (self.env.terminated, self.env.truncated))
        return RolloutStep(observation, reward, loss, terminated, truncated)


def _cotangent(gradient: torch.Tensor | None) -> NDArray[np.float32] | None:
    return None if gradient is None else np.ascontiguousarray(gradient.numpy(), np.float32)


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, action: torch.Tensor, token: torch.Tensor, rollout: Rollout) -> tuple[torch.Tensor, ...]:
        ctx.rollout, ctx.t, ctx.shape = rollout, len(rollout.tape), action.shape
        ctx.set_materialize_grads(False)
        step = rollout.env.step_recorded(np.ascontiguousarray(action.detach().numpy(), np.float32), rollout.tape)
        loss = rollout.env.column("loss")
        own = (torch.from_numpy(x.copy()) for x in (step.observation, step.reward, loss))
        return (*own, torch.zeros_like(token))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        observation, reward, loss, _ = gradients
        # agents share the reward of the team: their cotangents add up
        team = None if reward is None else reward.sum(1)
        down = ctx.rollout.sweep.pull(
            ctx.rollout.tape, ctx.t, observation=_cotangent(observation), reward=_cotangent(team), loss=_cotangent(loss)
        )
        return torch.from_numpy(down).reshape(ctx.shape), torch.zeros(()), None


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
    states: torch.Tensor = _Trajectory.apply(system, *map(_own, (state, inputs, theta)))
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


def _own(x: torch.Tensor | NDArray[np.float64]) -> torch.Tensor:
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
