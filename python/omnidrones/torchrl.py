"""TorchRL: an `EnvBase` over a batch of environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, MultiCategorical, Unbounded
from torchrl.envs import EnvBase

from . import _core
from ._task import Task


class Env(EnvBase):
    """Many environments of a task, by its name or class, batch size [E]. Settings are those of `omnidrones.make`.

    Agents of a team follow each other in "observation" [E, A * observation] and "action" [E, A * action]; "reward" is that of the
    team, [E, 1]. TorchRL resets what is done, so that the last observation of an episode is seen.
    """

    def __init__(self, name: str | type[Task], num_envs: int, **settings: Any) -> None:
        self.batch = _core.VecEnv(name, num_envs, autoreset="disabled", **settings)
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([num_envs]))
        spec, e = self.batch.spec, num_envs
        low, high = (torch.from_numpy(np.tile(bound, (e, spec.n_agent))) for bound in spec.observation_bounds())
        self.observation_spec = Composite(
            observation=Bounded(low=low, high=high, shape=low.shape, dtype=torch.float32), shape=(e,)
        )
        n, action = spec.n_agent * spec.n_action, spec.action
        if action.kind == "box":
            self.action_spec = Bounded(action.low, action.high, (e, n), dtype=torch.float32)
        elif n == 1:
            self.action_spec = Categorical(action.levels, (e, 1), dtype=torch.int64)
        else:
            self.action_spec = MultiCategorical([action.levels] * n, (e, n), dtype=torch.int64)
        self.reward_spec = Unbounded((e, 1), dtype=torch.float32)
        flag = Categorical(2, (e, 1), dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(e,))
        self._next_seed: int | None = None
        self._seeded = settings.get("seed") is not None

    def _observed(self) -> torch.Tensor:
        return torch.from_numpy(self.batch.observation.reshape(self.batch.num_envs, -1).copy())

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        which = None if tensordict is None else tensordict.get("_reset", None)
        seed, self._next_seed = self._next_seed, None
        if seed is None and not self._seeded:
            # of the generator that `torch.manual_seed` seeds
            seed = int(torch.randint(2**63 - 1, ()))
        self._seeded = True
        mask = None if which is None or seed is not None else which.reshape(-1).numpy()
        self.batch.reset(seed, mask)
        done = torch.zeros(self.batch.num_envs, 1, dtype=torch.bool)
        told = {"observation": self._observed(), "done": done, "terminated": done.clone(), "truncated": done.clone()}
        return TensorDict(told, self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].detach().to(torch.float32).contiguous().numpy()
        step = self.batch.step(action.reshape(self.batch.num_envs, -1))
        terminated, truncated = (torch.from_numpy(x.copy())[:, None] for x in (step.terminated, step.truncated))
        reward = torch.from_numpy(step.reward[:, :1].copy())
        told = {"observation": self._observed(), "reward": reward, "done": terminated | truncated}
        told |= {"terminated": terminated, "truncated": truncated}
        return TensorDict(told, tensordict.shape, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._next_seed = seed
