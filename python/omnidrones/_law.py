"""Controllers written in Python."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np

from ._number import Mask, Number


class Setpoint:
    """Where to be: world frame, SI, rad."""

    __slots__ = ("_row",)

    def __init__(self, row: Number) -> None:
        self._row = row

    @property
    def position(self) -> Number:
        """[3], m."""
        return self._row[0:3]

    @property
    def velocity(self) -> Number:
        """[3], m/s."""
        return self._row[3:6]

    @property
    def acceleration(self) -> Number:
        """[3], m/s^2."""
        return self._row[6:9]

    @property
    def jerk(self) -> Number:
        """[3], m/s^3."""
        return self._row[9:12]

    @property
    def snap(self) -> Number:
        """[3], m/s^4."""
        return self._row[12:15]

    @property
    def yaw(self) -> Number:
        """rad."""
        return self._row[15]

    @property
    def yaw_rate(self) -> Number:
        """rad/s."""
        return self._row[16]

    @property
    def yaw_acceleration(self) -> Number:
        """rad/s^2."""
        return self._row[17]


class LawInput:
    """What a `ControlLaw` is given in a tick."""

    __slots__ = ("_root", "_speeds", "due", "gains", "period", "state", "target")

    state: Number
    """Of the whole plant, [state]."""
    target: Setpoint
    """Where to be now."""
    gains: dict[str, Number]
    """By the names of `ControlLaw.gains`, in their shapes."""
    due: dict[str, Mask]
    """Which of `ControlLaw.levels` compute now, and do not hold what they said last."""
    period: float
    """Between two ticks, s."""

    def __init__(self, seen: Mapping[str, Any]) -> None:
        self.state, self.gains, self.due, self.period = seen["state"], seen["gains"], seen["due"], seen["period"]
        self.target, self._root, self._speeds = Setpoint(seen["target"]), seen["root"], seen["speeds"]

    def _body(self, first: int, n: int) -> Number:
        return self.state[self._root + first : self._root + first + n]

    @property
    def position(self) -> Number:
        """Of the root, [3], m, world."""
        return self._body(0, 3)

    @property
    def velocity(self) -> Number:
        """Of the root, [3], m/s, world."""
        return self._body(3, 3)

    @property
    def attitude(self) -> Number:
        """Of the root, [w, x, y, z], body to world."""
        return self._body(6, 4)

    @property
    def angular_velocity(self) -> Number:
        """Of the root, [3], rad/s, body."""
        return self._body(10, 3)

    @property
    def rotor_speeds(self) -> Number:
        """[rotor], rad/s."""
        return self.state[np.asarray(self._speeds, np.intp)]


class ControlLaw:
    """A controller of one's own.

    Its `tick` is called once per plant, with numbers that record; from then on it flies without Python, as the library's own do, in
    `fly`, `Loop`, `design`, `tune`, `monte_carlo`, `recovery_map` and `Controller`.

    >>> class Climb(omnidrones.ControlLaw):
    ...     gains = {"k": 0.5}
    ...
    ...     def tick(self, now, memory):
    ...         error = now.target.position[2] - now.position[2]
    ...         return np.clip(now.gains["k"] * error, -1.0, 1.0) * np.ones(4)
    >>> omnidrones.fly("hummingbird", controller=Climb(), duration=1.0)

    What differs from case to case is computed by `np.where`: a tick that asks a recorded number whether it is positive raises a
    `RecordingError` with the line and what to write instead.
    """

    rate: float | None = None
    """How often it ticks, Hz; must divide 1/dt. None: in every step."""
    levels: Mapping[str, float] = {}
    """How often its levels compute, Hz, by name: `now.due` tells which do."""
    gains: Any = {}
    """Numbers that may be tuned, by name, of any shape: `Loop` differentiates by them, `tune` descends on them."""
    memory: Any = None
    """What it remembers before its first tick: an array, or arrays by name."""

    @property
    def name(self) -> str:
        """In tables."""
        return type(self).__name__

    def tick(self, now: LawInput, memory: Any) -> Any:
        """Commands in [-1, 1], one per rotor and drive; of a law with memory a tuple of them and the new memory.

        Parameters
        ----------
        now : LawInput
            What is measured and wanted.
        memory
            What it returned in the last tick, in the shape of `memory`; None without one, where `tick(self, now)` will do.
        """
        raise NotImplementedError(f"{type(self).__name__} has no tick")


def _told(law: Any) -> dict[str, Any]:
    if isinstance(law, type) and issubclass(law, ControlLaw):
        name = law.__name__
        raise TypeError(f"controller is the class {name}, but it must be one of its objects. Write {name}().")
    if not isinstance(law, ControlLaw):
        kind = type(law).__name__
        remedy = "Derive from omnidrones.ControlLaw."
        raise TypeError(f"controller is a {kind}, but it must be a name or a ControlLaw. {remedy}")
    about = (type(law).__doc__ or "").strip()
    return {
        "name": str(law.name),
        "description": about.splitlines()[0] if type(law) is not ControlLaw and about else "",
        "rate": None if law.rate is None else float(law.rate),
        "levels": [(str(name), float(rate)) for name, rate in law.levels.items()],
        "gains": law.gains,
        "memory": law.memory,
    }


def _ticked(law: ControlLaw, seen: Mapping[str, Any], memory: Any) -> tuple[Any, Any]:
    tick: Any = law.tick
    if memory is None and len(inspect.signature(tick).parameters) == 1:
        return tick(LawInput(seen)), None
    told = tick(LawInput(seen), memory)
    if memory is None:
        if isinstance(told, tuple) and len(told) == 2 and told[1] is None:
            return told[0], None
        return told, None
    if not (isinstance(told, tuple) and len(told) == 2):
        raise TypeError(f"{type(law).__name__}.tick must return (commands, memory): it has a memory.")
    return told


def _gains_of(law: ControlLaw, flat: Any) -> Any:
    """Numbers in the shapes of the law's gains."""
    if not isinstance(law.gains, Mapping):
        return flat
    own: dict[str, Any] = {}
    at = 0
    for name, value in law.gains.items():
        shape = np.shape(value)
        n = int(np.prod(shape, dtype=np.int64))
        part = flat[at : at + n]
        own[name] = float(part[0]) if shape == () else part.reshape(shape)
        at += n
    return own
