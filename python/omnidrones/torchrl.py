"""TorchRL: an `EnvBase` over a batch of environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, Unbounded
from torchrl.envs import EnvBase

from ._make import make
from ._task import Task
from .torch import TensorEnv, _own


class Env(EnvBase):
    """Many environments of a task, by its name or class, batch size [E]. Settings are those of `omnidrones.make`.

    Agents of a team follow each other in "observation" [E, A * observation] and "action" [E, A * action]; "reward" is that of the
    team, [E, 1]. TorchRL resets what is done, so that the last observation of an episode is seen. With `device="cuda"` environments and
    tensors are on that card. `columns=("success", "return")` tells columns of the information beside the observation, [E, 1] each.
    """

    def __init__(
        self,
        name: str | type[Task],
        num_envs: int,
        *,
        device: Any = None,
        columns: Sequence[str] = (),
        **settings: Any,
    ) -> None:
        self.batch = make(name, num_envs, device=device, autoreset="disabled", **settings)
        self.tensors = TensorEnv(self.batch)
        there = self.tensors.device
        super().__init__(device=there, batch_size=torch.Size([num_envs]))
        spec, e = self.batch.spec, num_envs
        bounds = spec.observation_bounds()
        low, high = (torch.from_numpy(np.tile(bound, (e, spec.n_agent))).to(there) for bound in bounds)
        self.observation_spec = Composite(
            observation=Bounded(low=low, high=high, shape=low.shape, dtype=torch.float32, device=there), shape=(e,), device=there
        )
        self._columns = tuple(columns)
        for column in self._columns:
            self.batch.column(column)  # refuses one that is not there
            self.observation_spec[column] = Unbounded((e, 1), dtype=torch.float32, device=there)
        n, action = spec.n_agent * spec.n_action, spec.action
        if action.kind == "box":
            self.action_spec = Bounded(action.low, action.high, (e, n), dtype=torch.float32, device=there)
        elif n == 1:
            self.action_spec = Categorical(action.levels, (e, 1), dtype=torch.int64, device=there)
        else:
            self.action_spec = MultiCategorical([action.levels] * n, (e, n), dtype=torch.int64, device=there)
        self.reward_spec = Unbounded((e, 1), dtype=torch.float32, device=there)
        flag = Categorical(2, (e, 1), dtype=torch.bool, device=there)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(e,), device=there)
        self._next_seed: int | None = None
        self._seeded = settings.get("seed") is not None

    def _observed(self) -> dict[str, torch.Tensor]:
        told = {column: _own(self.tensors.column(column))[:, None] for column in self._columns}
        return {"observation": _own(self.tensors.observation.reshape(self.batch.num_envs, -1)), **told}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        which = None if tensordict is None else tensordict.get("_reset", None)
        seed, self._next_seed = self._next_seed, None
        if seed is None and not self._seeded:
            # of the generator that `torch.manual_seed` seeds
            seed = int(torch.randint(2**63 - 1, ()))
        self._seeded = True
        self.tensors.reset(seed, None if which is None or seed is not None else which.reshape(-1))
        done = torch.zeros(self.batch.num_envs, 1, dtype=torch.bool, device=self.device)
        flags = {"done": done, "terminated": done.clone(), "truncated": done.clone()}
        return TensorDict(self._observed() | flags, self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        step = self.tensors.step(tensordict["action"].reshape(self.batch.num_envs, -1))
        terminated, truncated = (x.clone()[:, None] for x in (step.terminated, step.truncated))
        reward = _own(step.reward[:, :1])
        told = {"reward": reward, "done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        return TensorDict(self._observed() | told, tensordict.shape, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed
