"""Stable-Baselines3: a `VecEnv` that makes dictionaries for ended episodes alone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common import vec_env

from . import _core
from ._task import Task
from .gym import team_spaces


class VecEnv(vec_env.VecEnv):
    """Many environments of a task, by its name or class, for Stable-Baselines3. Settings are those of `omnidrones.make`.

    Infos of ended episodes have `terminal_observation`, `TimeLimit.truncated`, `episode` (return, length, seconds) and the task's
    figures by name; those of others are empty.
    """

    def __init__(self, name: str | type[Task], num_envs: int, **settings: Any) -> None:
        if settings.get("info") is not None:
            # of every episode that ends these two are told
            settings["info"] = [*settings["info"], "return", "length"]
        self.batch = _core.VecEnv(name, num_envs, autoreset="same_step", **settings)
        self.render_mode = None
        super().__init__(num_envs, *team_spaces(self.batch.spec))
        spec = self.batch.spec
        self._action = np.zeros((num_envs, spec.n_agent * spec.n_action), np.float32)
        self._began = time.monotonic()
        self._seeded = settings.get("seed") is not None

    def reset(self) -> NDArray[np.float32]:
        """Begins episodes of all environments, with the seed that `seed` was given, the first time without one with one of NumPy's."""
        seeds = self._seeds
        given: int | list[int | None] | None = None if any(seed is None for seed in seeds) else seeds
        if given is None and not self._seeded:
            # of the generator that its `set_random_seed` seeds
            given = int(np.random.randint(0, np.iinfo(np.uint32).max, dtype=np.uint32))
        self._seeded = True
        self._reset_seeds()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return self.batch.reset(given).reshape(self.num_envs, -1).copy()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keeps the actions for `step_wait`."""
        self._action[:] = np.asarray(actions).reshape(self._action.shape)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One step of every environment."""
        step = self.batch.step(self._action)
        over = step.terminated | step.truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over):
            told = dict(zip(self.batch.spec.info, step.info[i].tolist()))
            episode = {"r": told["return"], "l": int(told["length"]), "t": time.monotonic() - self._began}
            infos[i] = {
                **told,
                "terminal_observation": self.batch.final_observation[i].reshape(-1).copy(),
                "TimeLimit.truncated": bool(step.truncated[i] and not step.terminated[i]),
                "episode": episode,
            }
        return step.observation.reshape(self.num_envs, -1).copy(), step.reward[:, 0].copy(), over, infos

    def close(self) -> None:
        """Nothing is kept that Python does not free."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same for all environments."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """For all environments."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """A method of the batch, called once."""
        return [getattr(self.batch, method_name)(*args, **kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """None is."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """None are drawn."""
        return [None] * self.num_envs
