"""Gymnasium: one environment (`Env`), many (`VectorEnv`), and their ids: `gymnasium.make_vec("omnidrones:Hover-v0", 4096)`.

A team is seen and acts as one: observations and actions of its agents follow each other, [A * observation] and [A * action].
`omnidrones.pettingzoo` keeps them apart. With `device="cuda"` all arrays of a `VectorEnv` are tensors of PyTorch on that card.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import _core
from ._make import make
from ._spec import Spec
from ._task import Task

HAS_BATCHES = hasattr(gymnasium.vector, "AutoresetMode")
"""Gymnasium before 1.1 has environments one by one alone."""

NO_BOUND = 1e8
"""In place of an infinite bound, SI units: a simulation that comes there has exploded, and has ended long before."""


def agent_spaces(spec: Spec) -> tuple[spaces.Box, spaces.Space[Any]]:
    """What one agent sees, and what it may answer."""
    low, high = (np.clip(bound, -NO_BOUND, NO_BOUND) for bound in spec.observation_bounds())
    action = spec.action
    if action.kind == "box":
        return spaces.Box(low, high, dtype=np.float32), spaces.Box(action.low, action.high, (action.n,), np.float32)
    if action.kind == "discrete":
        return spaces.Box(low, high, dtype=np.float32), spaces.Discrete(action.levels)
    return spaces.Box(low, high, dtype=np.float32), spaces.MultiDiscrete(np.full(action.n, action.levels))


def team_spaces(spec: Spec) -> tuple[spaces.Box, spaces.Space[Any]]:
    """What all agents see, and what they may answer."""
    observation, action = agent_spaces(spec)
    if spec.n_agent == 1:
        return observation, action
    n = spec.n_agent
    seen = spaces.Box(np.tile(observation.low, n), np.tile(observation.high, n), dtype=np.float32)
    if isinstance(action, spaces.Box):
        return seen, spaces.Box(np.tile(action.low, n), np.tile(action.high, n), dtype=np.float32)
    return seen, spaces.MultiDiscrete(np.full(n * spec.n_action, spec.action.levels))


class Env(gymnasium.Env[NDArray[np.float32], Any]):
    """One environment of a task, by its name or class. Settings are those of `omnidrones.make`."""

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, name: str | type[Task], render_mode: None = None, **settings: Any) -> None:
        self.batch = _core.VecEnv(name, 1, autoreset="disabled", threads=1, ring=1, **settings)
        self.observation_space: spaces.Space[Any]
        self.observation_space, self.action_space = team_spaces(self.batch.spec)
        self.render_mode = render_mode
        self._action = np.zeros((1, self.batch.spec.n_agent * self.batch.spec.n_action), np.float32)
        self._columns = self.batch.spec.info
        self._seeded, self._closed = settings.get("seed") is not None, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode; without a seed the next one of those that the seed before draws."""
        super().reset(seed=seed)
        self._check_open()
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**63))
        self._seeded = True
        return self.batch.reset(seed).reshape(-1).copy(), {}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One step; the info has the columns of `Spec.info` by name."""
        self._check_open()
        self._action[0] = action
        step = self.batch.step(self._action)
        info = dict(zip(self._columns, step.info[0].tolist()))
        observation = step.observation.reshape(-1).copy()
        return observation, float(step.reward[0, 0]), bool(step.terminated[0]), bool(step.truncated[0]), info

    def close(self) -> None:
        """Later calls raise `ClosedEnvironmentError`."""
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("the environment is closed. Make a new one.")


if HAS_BATCHES:
    from gymnasium.vector import AutoresetMode

    _SETTING = {
        AutoresetMode.NEXT_STEP: "next_step",
        AutoresetMode.SAME_STEP: "same_step",
        AutoresetMode.DISABLED: "disabled",
    }

    class VectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
        """Many environments of a task, under all three of Gymnasium's autoreset modes.

        Parameters
        ----------
        name : str or Task
            A task: its name, or a class of one's own.
        num_envs : int
        autoreset_mode : AutoresetMode or str
            What a done environment does; Gymnasium's default, "NextStep".
        copy : bool
            Whether what is returned is the caller's own. Without, arrays are those of the library, which the step after the next one
            writes again: 1.2 to 1.5 times as fast from thousands of environments on.
        info : "columns" or "none"
            Whether infos have the columns of `Spec.info`.
        max_episode_steps : int, optional
            The task's `horizon`.
        device : str, optional
            "cuda": the environments are on that card, and what is returned are tensors of PyTorch there, actions and `reset_mask` too.
            `final_obs` and `final_info` are told in every step then, ended or not. Gymnasium's own wrappers are for arrays of NumPy.
        **settings
            Those of `omnidrones.make`.
        """

        def __init__(
            self,
            name: str | type[Task],
            num_envs: int = 1,
            autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
            copy: bool = True,
            info: str = "columns",
            render_mode: None = None,
            max_episode_steps: int | None = None,
            device: Any = None,
            **settings: Any,
        ) -> None:
            if info not in ("columns", "none"):
                raise ValueError(f"info is '{info}', but it must be 'columns' or 'none'.")
            mode = AutoresetMode(autoreset_mode)
            if max_episode_steps is not None:
                settings["horizon"] = max_episode_steps
            self.num_envs = num_envs
            self.batch = make(name, num_envs, device=device, autoreset=_SETTING[mode], **settings)
            spec = self.batch.spec
            # on a device tensors, else arrays of NumPy
            self._tensors: Any = None
            if isinstance(self.batch, _core.DeviceEnv):
                from .torch import TensorEnv

                self._tensors = TensorEnv(self.batch)
            self.autoreset_mode = mode
            self.metadata = {"render_modes": [], "autoreset_mode": mode}
            self.render_mode, self.copy = render_mode, copy
            self.single_observation_space, self.single_action_space = team_spaces(spec)
            self.observation_space = batch_space(self.single_observation_space, num_envs)
            self.action_space = batch_space(self.single_action_space, num_envs)
            self._action = np.zeros((num_envs, spec.n_agent * spec.n_action), np.float32)
            self._names = spec.info if info == "columns" else ()
            self._told: dict[str, Any] = {"_" + column: self._all() for column in self._names}
            self._seen: list[tuple[Any, tuple[Any, ...]]] = []
            self._seeded = settings.get("seed") is not None

        def reset(
            self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
        ) -> tuple[NDArray[np.float32], dict[str, Any]]:
            """Begins episodes: all, or those of the bool array `options["reset_mask"]`.

            A whole number seeds the batch, whose environments draw differently by their place; a list each of them.
            """
            self._check_open()
            super().reset(seed=seed if isinstance(seed, int) else None)
            if isinstance(seed, list):
                seed = None if seed == [None] * self.num_envs else seed
            if seed is None and not self._seeded:
                seed = int(self.np_random.integers(2**63))
            self._seeded = True
            arrays = self._tensors or self.batch
            observation = arrays.reset(seed, (options or {}).get("reset_mask")).reshape(self.num_envs, -1)
            return (self._own(observation) if self.copy else observation), {}

        def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
            """One step of every environment."""
            self._check_open()
            step = self._stepped_there(actions) if self._tensors else self.batch.step(self._as_rows(actions))
            observation, reward, terminated, truncated, final, info, infos = self._views(step)
            if self.copy:
                observation, reward = self._own(observation), self._own(reward)
                terminated, truncated = self._own(terminated), self._own(truncated)
                infos = self._told | dict(zip(self._names, self._own(info)))
            else:
                infos = infos.copy()
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                over = terminated | truncated
                # to ask a card would be to wait for it
                if self._tensors or over.any():
                    told = {name: infos[name] for name in self._names} | dict.fromkeys(self._told, over)
                    infos |= {"final_obs": self._own(final) if self.copy else final, "_final_obs": over}
                    infos |= {"final_info": told, "_final_info": over}
            return observation, reward, terminated, truncated, infos

        def _own(self, view: Any) -> Any:
            """The caller's own."""
            if not self._tensors:
                return view.copy()
            import torch

            return view.clone(memory_format=torch.contiguous_format)

        def _all(self) -> Any:
            """True for every environment."""
            if not self._tensors:
                return np.ones(self.num_envs, np.bool_)
            import torch

            return torch.ones(self.num_envs, dtype=torch.bool, device=self._tensors.device)

        def _as_rows(self, actions: Any) -> NDArray[np.float32]:
            if type(actions) is np.ndarray and actions.dtype == np.float32 and actions.flags.c_contiguous:
                return actions
            self._action[:] = np.asarray(actions).reshape(self._action.shape)
            return self._action

        def _stepped_there(self, actions: Any) -> Any:
            import torch

            if not isinstance(actions, torch.Tensor):
                actions = torch.as_tensor(np.asarray(actions, np.float32), device=self._tensors.device)
            return self._tensors.step(actions)

        def _views(self, step: Any) -> tuple[Any, ...]:
            """Arrays of a step as Gymnasium has them, made once for each of those that take turns."""
            for kept, views in self._seen:
                if kept is step:
                    return views
            info = step.info.T[: len(self._names)]
            views = (
                step.observation.reshape(self.num_envs, -1),
                step.reward[:, 0],
                step.terminated,
                step.truncated,
                (self._tensors or self.batch).final_observation.reshape(self.num_envs, -1),
                info,
                self._told | dict(zip(self._names, info)),
            )
            self._seen.append((step, views))
            return views

        def close_extras(self, **kwargs: Any) -> None:
            """Nothing is kept that Python does not free."""

        def _check_open(self) -> None:
            if self.closed:
                raise ClosedEnvironmentError("the environment is closed. Make a new one.")


def register() -> None:
    """Ids of all tasks: "Hover-v0" and so on, for Gymnasium's `make` and `make_vec`."""
    many: dict[str, Any] = {"vector_entry_point": "omnidrones.gym:VectorEnv"} if HAS_BATCHES else {}
    for name in _core.tasks():
        id = f"{name}-v0"
        if id not in gymnasium.registry:
            gymnasium.register(id, entry_point="omnidrones.gym:Env", kwargs={"name": name}, **many)


register()
