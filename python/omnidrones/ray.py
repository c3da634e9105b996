"""Ray: a batch of environments cut into shards, each with a process of its own, on one machine or many.

Environments keep their numbers, so that the shards together have the bits of one batch. A worker that is lost is replaced: the
driver keeps the state behind each call that was answered, and the call is made again.

>>> batch = omnidrones.ray.Shards("Hover", 65536, workers=16, seed=0)
>>> rows = batch.rollout(policy, 100)   # {"observation": [100, E, A, n], "action": ..., "reward": ..., ...}
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import ray
from numpy.typing import NDArray
from ray.exceptions import RayActorError

from . import _core

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class _Shard:
    """One shard. Every call returns its rows and the state behind them, which the driver fetches and keeps."""

    def __init__(self, name: str, num_envs: int, settings: dict[str, Any], state: bytes | None) -> None:
        self.env = _core.VecEnv(name, num_envs, **settings)
        if state is not None:
            self.env.load(state)
            self.env.observe()

    def reset(self, seed: int | None) -> tuple[NDArray[np.float32], bytes]:
        """Observations of first episodes."""
        return self.env.reset(seed).copy(), self.env.save()

    def rollout(self, act: Act, n_step: int) -> tuple[dict[str, NDArray[Any]], bytes]:
        """So many steps under a policy, [step, environment, ...]."""
        env, spec = self.env, self.env.spec
        e, a = spec.num_envs, spec.n_agent
        rows: dict[str, NDArray[Any]] = {
            "observation": np.empty((n_step, e, a, spec.n_observation), np.float32),
            "action": np.empty((n_step, e, a, spec.n_action), np.float32),
            "reward": np.empty((n_step, e, a), np.float32),
            "terminated": np.empty((n_step, e), np.bool_),
            "truncated": np.empty((n_step, e), np.bool_),
        }
        for t in range(n_step):
            rows["observation"][t] = env.observation
            rows["action"][t] = act(env.observation)
            step = env.step(rows["action"][t])
            rows["reward"][t], rows["terminated"][t], rows["truncated"][t] = step[1:4]
        rows["last_observation"] = env.observation.copy()
        return rows, env.save()


_REPLACEMENTS = 5
"""Workers of a shard that may be lost in one call."""

_Worker: Any = ray.remote(max_restarts=0)(_Shard)


class Shards:
    """A batch of environments in `workers` processes of Ray, with the bits of one batch.

    Parameters
    ----------
    name : str
        A task.
    num_envs : int
        Environments of all shards together.
    workers : int
        Processes.
    cpus : float
        Of each, for Ray's schedule; each steps on one thread unless `threads` says otherwise.
    **settings
        Those of `omnidrones.make`.
    """

    def __init__(self, name: str, num_envs: int, workers: int, *, cpus: float = 1, **settings: Any) -> None:
        if not 1 <= workers <= num_envs:
            raise ValueError(f"workers is {workers}, but it must be 1 to {num_envs}, the number of environments.")
        settings = {"threads": 1, "first_environment": 0} | settings
        first, self._made = settings["first_environment"], []
        for k in range(workers):
            begin, end = (num_envs * j // workers for j in (k, k + 1))
            self._made.append((name, end - begin, settings | {"first_environment": first + begin}))
        self._cpus = cpus
        self._states: list[Any] = [None] * workers
        self.workers = [self._worker(k) for k in range(workers)]
        self.replaced = 0
        """Workers that were lost and replaced so far."""

    def _worker(self, k: int) -> Any:
        return _Worker.options(num_cpus=self._cpus).remote(*self._made[k], self._states[k])

    def _call(self, method: str, arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
        """The answers of all workers; who is lost is replaced from its last state and asked again."""
        asked = list(arguments)
        call = lambda k: getattr(self.workers[k], method).options(num_returns=2).remote(*asked[k])  # noqa: E731
        pending = [call(k) for k in range(len(self.workers))]
        answers, failed = [], None
        for k, refs in enumerate(pending):
            try:
                answer, self._states[k] = self._answer(k, refs, call)
                answers.append(answer)
            except Exception as error:  # the others' states are kept first
                failed = failed or error
        if failed is not None:
            raise failed
        return answers

    def _answer(self, k: int, refs: Any, call: Callable[[int], Any]) -> Any:
        for left in reversed(range(_REPLACEMENTS + 1)):
            try:
                return ray.get(refs)
            except RayActorError as error:
                # what could not be made cannot be made again: its settings are wrong, or too large
                if getattr(error, "actor_init_failed", False) or left == 0:
                    raise
                self.replaced += 1
                self.workers[k] = self._worker(k)
                refs = call(k)

    def reset(self, seed: int | None = None) -> NDArray[np.float32]:
        """Begins episodes of all environments; observations [E, A, observation]."""
        return np.concatenate(self._call("reset", [(seed,)] * len(self.workers)))

    def rollout(self, policy: Act, n_step: int) -> dict[str, NDArray[Any]]:
        """So many steps under a policy that maps observations [e, A, observation] of a shard to actions [e, A, action].

        Returns "observation", "action", "reward", "terminated", "truncated", [step, E, ...], and "last_observation" [E, ...].
        """
        shared = ray.put(policy)
        parts = self._call("rollout", [(shared, n_step)] * len(self.workers))
        axis = {"last_observation": 0}
        return {name: np.concatenate([part[name] for part in parts], axis.get(name, 1)) for name in parts[0]}
