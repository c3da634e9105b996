"""PettingZoo: the agents of one environment of a team, each with its own observation and action."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from . import _core
from ._task import Task
from .gym import NO_BOUND, agent_spaces


class parallel_env(ParallelEnv):
    """One environment of a task, by its name or class, as PettingZoo's parallel API has it. Settings are those of `omnidrones.make`.

    Agents are called "drone_0" and so on, share the reward of the team, and end together. `state()` is the central state.
    """

    metadata: dict[str, Any] = {"name": "omnidrones", "render_modes": [], "is_parallelizable": True}

    def __init__(self, name: str | type[Task], render_mode: None = None, **settings: Any) -> None:
        self.batch = _core.VecEnv(name, 1, autoreset="disabled", threads=1, ring=1, **settings)
        spec = self.batch.spec
        self.render_mode = render_mode
        self.possible_agents = [f"drone_{k}" for k in range(spec.n_agent)]
        self.agents: list[str] = []
        self._row = {agent: k for k, agent in enumerate(self.possible_agents)}
        # one space per agent: each draws samples of its own
        self._spaces = {agent: agent_spaces(spec) for agent in self.possible_agents}
        self._action = np.zeros((1, spec.n_agent, spec.n_action), np.float32)
        self._seeded = settings.get("seed") is not None
        if spec.n_central:
            self.state_space = spaces.Box(-NO_BOUND, NO_BOUND, (spec.n_central,), np.float32)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What this agent sees."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What this agent may answer."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Begins an episode; without a seed the next one of those that the seed before draws."""
        if seed is None and not self._seeded:
            seed = int(np.random.default_rng().integers(2**63))
        self._seeded = True
        self._action[:] = 0
        observation = self.batch.reset(seed)[0]
        self.agents = list(self.possible_agents)
        return {a: observation[k].copy() for a, k in self._row.items()}, {a: {} for a in self.agents}

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        """One step of all agents; one that gives no action repeats its last of this episode, zeros before its first."""
        if not self.agents:
            raise RuntimeError("the episode is over. Call reset().")
        for agent, action in actions.items():
            self._action[0, self._row[agent]] = action
        step = self.batch.step(self._action)
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        info = dict(zip(self.batch.spec.info, step.info[0].tolist()))
        agents = self.agents
        if terminated or truncated:
            self.agents = []
        return (
            {a: step.observation[0, self._row[a]].copy() for a in agents},
            {a: float(step.reward[0, self._row[a]]) for a in agents},
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {a: info.copy() for a in agents},
        )

    def state(self) -> NDArray[np.float32]:
        """Of the whole team, [central]."""
        return self.batch.central[0].copy()

    def render(self) -> None:
        """Nothing is drawn here: `omnidrones watch` and `rollout` of the command line are for that."""

    def close(self) -> None:
        """Nothing is kept that Python does not free."""
