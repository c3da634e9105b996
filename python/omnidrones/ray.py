"""Ray: environments, evaluations and trainings in processes of their own, on one machine or many.

Environments keep their numbers, so that the shards of a batch together have the bits of one batch. A worker that is lost is replaced:
the driver keeps the state behind each call that was answered, and the call is made again; a training goes on from its newest checkpoint.
RLlib needs nothing of this: its own runners make our batches by their Gymnasium ids.

>>> batch = omnidrones.ray.Shards("Hover", 65536, workers=16, seed=0)
>>> rows = batch.rollout(policy, 100)   # {"observation": [100, E, A, n], "action": ..., "reward": ..., ...}
>>> evaluate(policy, num_envs=65536, workers=16)["success"]
>>> rows = train_all(["Hover", "Track"], seeds=5, folder="/shared/runs")   # pandas.DataFrame(rows)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import ray
from numpy.typing import NDArray
from ray.exceptions import RayActorError

from . import _core
from ._task import Task

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]


def _cut(num_envs: int, workers: int) -> list[tuple[int, int]]:
    """The first environment of every worker, and how many it has."""
    if not 1 <= workers <= num_envs:
        raise ValueError(f"workers is {workers}, but it must be 1 to {num_envs}, the number of environments.")
    ends = [num_envs * k // workers for k in range(workers + 1)]
    return [(begin, end - begin) for begin, end in zip(ends, ends[1:])]


def _known(record: bytes | None) -> None:
    """Makes a task of one's own known in a worker, which has no class of it."""
    if record is not None:
        _core._register_record(record)


class _Shard:
    """One shard. Every call returns its rows and the state behind them, which the driver fetches and keeps."""

    def __init__(
        self, name: str, num_envs: int, settings: dict[str, Any], record: bytes | None, state: bytes | None
    ) -> None:
        _known(record)
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
    name : str or Task
        A task; a class of your own goes to the workers as what was recorded of it.
    num_envs : int
        Environments of all shards together.
    workers : int
        Processes.
    cpus : float
        Of each, for Ray's schedule; each steps on one thread unless `threads` says otherwise.
    **settings
        Those of `omnidrones.make`.
    """

    def __init__(self, name: str | type[Task], num_envs: int, workers: int, *, cpus: float = 1, **settings: Any) -> None:
        name, record, settings = _core._carried(name, settings)
        settings = {"threads": 1, "first_environment": 0} | settings
        first, self._made = settings["first_environment"], []
        for begin, n in _cut(num_envs, workers):
            self._made.append((name, n, settings | {"first_environment": first + begin}, record))
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


def evaluate(
    policy: _core.Policy | Act,
    name: str | type[Task] | None = None,
    *,
    num_envs: int = 1024,
    workers: int,
    cpus: float = 1,
    **how: Any,
) -> dict[str, Any]:
    """As `omnidrones.evaluate`, its starts divided over processes: the same figures.

    Parameters
    ----------
    policy, name, num_envs, **how
        Those of `omnidrones.evaluate`. A callable must answer each row alike whichever stand beside it.
    workers : int
        Parts of the starts, each an episode per start on one thread.
    cpus : float
        Of each part, for Ray's schedule. A part that is lost is flown again.
    """
    record = None
    if name is not None:
        name, record, how = _core._carried(name, how)
    shared, own = ray.put(policy), {"threads": 1} | how
    fly = _fly.options(num_cpus=cpus, max_retries=_REPLACEMENTS)
    rows = ray.get([fly.remote(shared, name, n, first, own, record) for first, n in _cut(num_envs, workers)])
    environments = {key: value for key, value in own.items() if key not in ("threads", "seed")}
    return _core._evaluation(rows, policy, name, **environments)


@ray.remote
def _fly(
    policy: Any, name: str | None, num_envs: int, first: int, how: dict[str, Any], record: bytes | None
) -> Any:
    _known(record)
    return _core._fly_shard(policy, name, num_envs, first, **how)


def train_all(
    tasks: str | type[Task] | Iterable[str | type[Task]] | None = None,
    *,
    seeds: int = 5,
    folder: str | os.PathLike[str],
    cpus: float = 1,
    **settings: Any,
) -> list[dict[str, Any]]:
    """Trains every task by its recipe with several seeds, a run per process of Ray.

    A run that a lost worker took with it goes on elsewhere from its newest checkpoint, to the same bits; so do, with the next call, those
    that were not finished when this one ended. What is finished is only evaluated.

    Parameters
    ----------
    tasks : str or Task, or iterable of them, optional
        All by default.
    seeds : int
        Runs of each task, of the seeds 0 to seeds - 1.
    folder : path
        Of the runs, each in TASK-SEED; seen by all machines of the cluster, or a lost run begins again.
    cpus : float
        Of each run; it trains on so many threads.
    **settings
        Those of `omnidrones.train`, for all of them.

    Returns
    -------
    list of dict
        A row per run: "task", "seed", "updates", "env_steps", "seconds" and the figures of its evaluation by name.

    Raises
    ------
    RuntimeError
        At the end, for runs that failed by themselves; the others are kept.
    """
    given = list(_core.tasks() if tasks is None else [tasks] if isinstance(tasks, (str, type)) else tasks)
    told = [_core._carried(task, settings, training=True) for task in given]
    names, carried = [name for name, _, _ in told], {name: (record, rest) for name, record, rest in told}
    if len(set(names)) < len(names):
        raise ValueError(f"tasks are {names}, but each may stand once. Take more seeds for more runs.")
    runs = [(task, seed) for task in names for seed in range(seeds)]
    train = _train.options(num_cpus=cpus, max_retries=_REPLACEMENTS)
    pending = []
    for task, seed in runs:
        record, rest = carried[task]
        own = {"threads": max(1, int(cpus))} | rest
        pending.append(train.remote(task, seed, str(Path(folder).absolute() / f"{task}-{seed}"), own, record))
    rows, failed = [], []
    try:
        for (task, seed), row in zip(runs, pending):
            try:
                rows.append(ray.get(row))
            except Exception as error:  # the other rows go on
                failed.append(f"{task}, seed {seed}: {error}")
    except BaseException:  # interrupted: a run that went on would hold its folder against the next call
        for row in pending:
            ray.cancel(row, force=True)
        raise
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(runs)} runs failed. " + " ".join(failed))
    return rows


@ray.remote
def _train(task: str, seed: int, folder: str, settings: dict[str, Any], record: bytes | None) -> dict[str, Any]:
    """What is in the folder is gone on with: a run that lost its worker."""
    _known(record)
    run = _core.train(task, seed=seed, folder=folder, resume=True, **settings)
    told = {"task": task, "seed": seed, "updates": run.updates, "env_steps": run.env_steps, "seconds": run.seconds}
    return told | run.evaluation
