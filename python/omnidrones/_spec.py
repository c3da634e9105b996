"""What environments are, as data."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Step(NamedTuple):
    """What a step wrote, E environments of A agents: arrays of the environment, which later steps write again."""

    observation: NDArray[np.float32]
    """[E, A, observation]: what the next action answers to."""
    reward: NDArray[np.float32]
    """[E, A]; the agents of an environment share one."""
    terminated: NDArray[np.bool_]
    """[E]: the task ended the episode."""
    truncated: NDArray[np.bool_]
    """[E]: its time was over."""
    info: NDArray[np.float32]
    """[E, column]; `Spec.info` names the columns. Of the episode that the step belonged to."""


class Field(NamedTuple):
    """A named run of numbers."""

    name: str
    size: int
    unit: str
    """SI, with the frame where there is one: "m, world"."""
    meaning: str
    low: float
    """Least value of each number; -inf where there is none."""
    high: float
    """Largest value of each number; inf where there is none."""
    smoothness: str
    """"smooth", "piecewise" or "non_smooth": how far a gradient may be trusted."""


class Space(NamedTuple):
    """The numbers that an agent may answer."""

    kind: str
    """"box": `n` numbers within [low, high]; "discrete": one whole number below `levels`; "multi_discrete": `n` such."""
    n: int
    low: float
    high: float
    levels: int
    """Values of each number; 0 for a box."""


class Spec:
    """A batch of environments as data: sizes, names, units, bounds.

    Attributes
    ----------
    task : str
    num_envs, n_agent : int
        E and A.
    n_observation, n_action, n_central, n_privileged : int
        Numbers of one agent's observation and action, of the central state, and those that differ between environments.
    observation, central : tuple of Field
        In the order of the numbers.
    action : Space
    commands : tuple of str
        What one agent's actions become, in [-1, 1].
    privileged : dict
        Nominal values of the physical numbers that differ between environments, by name, SI.
    info : tuple of str
        Names of the columns of `Step.info`; the setting `info` names those that are told.
    ends : tuple of str
        Reasons to terminate; the column "reason" counts them from 1.
    reward_bound : float
        Largest reward of a step.
    horizon : int
        T, steps of an episode.
    dt : float
        Seconds per step.
    data : dict
        All of it, as the library writes it.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        self.data = data
        self.task: str = data["task"]
        self.num_envs: int = data["n_env"]
        self.n_agent: int = data["n_agent"]
        self.n_observation: int = data["n_observation"]
        self.n_central: int = data["n_central"]
        self.n_privileged: int = len(data["privileged"])
        self.observation: tuple[Field, ...] = tuple(map(_field, data["observation"]))
        self.central: tuple[Field, ...] = tuple(map(_field, data["central"]))
        self.action: Space = _space(data["action"])
        self.n_action: int = self.action.n
        self.commands: tuple[str, ...] = tuple(data["commands"])
        self.privileged: dict[str, float] = dict(data["privileged"])
        self.info: tuple[str, ...] = tuple(column["name"] for column in data["info"])
        self.ends: tuple[str, ...] = (*(end["name"] for end in data["ends"]), "diverged")
        self.reward_bound: float = data["reward_bound"]
        self.horizon: int = data["horizon"]
        self.dt: float = data["dt"]

    @classmethod
    def of_json(cls, text: str) -> Spec:
        """From what the library writes."""
        return cls(json.loads(text))

    def observation_slice(self, name: str) -> slice:
        """Place of a field in the observation."""
        at = 0
        for field in self.observation:
            if field.name == name:
                return slice(at, at + field.size)
            at += field.size
        known = ", ".join(field.name for field in self.observation)
        raise ValueError(f"no field of the observation is called '{name}'. Known: {known}")

    def observation_bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Least and largest value of every number of one agent's observation; infinite where there is none."""
        sizes = [field.size for field in self.observation]
        low = np.repeat([field.low for field in self.observation], sizes)
        high = np.repeat([field.high for field in self.observation], sizes)
        return low.astype(np.float32), high.astype(np.float32)

    def __repr__(self) -> str:
        return f"Spec(task='{self.task}', num_envs={self.num_envs}, n_agent={self.n_agent})"


def _field(data: dict[str, Any]) -> Field:
    low = -np.inf if data["low"] is None else data["low"]
    high = np.inf if data["high"] is None else data["high"]
    return Field(data["name"], data["size"], data["unit"], data["meaning"], low, high, data["smoothness"])


def _space(data: dict[str, Any]) -> Space:
    kind = data["kind"]
    if kind == "box":
        return Space(kind, data["n"], data["low"], data["high"], 0)
    if kind == "discrete":
        return Space(kind, 1, 0, data["n"] - 1, data["n"])
    return Space(kind, data["n"], 0, data["levels"] - 1, data["levels"])
