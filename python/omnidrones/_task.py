"""Tasks of one's own: a class whose methods are called once, with numbers that record."""

from __future__ import annotations

import inspect
import json
import math
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from . import _core
from ._core import Ends, Forest, Gate, Loss, Robot, Start, TrackPath, View, Writer
from ._number import Mask, _vectors

_Class = TypeVar("_Class", bound="type[Task]")


class Setting:
    """A number of a task's configuration: `reach = Setting(2.0, "m", "how far targets are", domain="positive")`.

    Parameters
    ----------
    default
        A number, a text, a bool, or lists of these. What is given in its place must be alike.
    unit : str
        SI, with the frame where there is one; "" for what is no number.
    meaning : str
        What it is.
    domain : str
        What its numbers may be: "any", "positive", "not_negative", "share" (0 to 1), "ordered" or "positive_ordered" (pairs of lowest and
        highest).

    In methods of the task it is the value: `self.reach`; lists of numbers are NumPy arrays.
    """

    def __init__(self, default: Any, unit: str = "", meaning: str = "", *, domain: str = "any") -> None:
        self.default, self.unit, self.meaning, self.domain = default, unit, meaning, domain


class PathSettings:
    """Settings of tasks that follow a drawn path: what `omnidrones.TrackPath.of(self)` reads.

    >>> class Follow(omnidrones.Task, omnidrones.PathSettings):
    ...     reset_distance = 0.8  # another default
    """


for _key, *_own in TrackPath._settings():
    setattr(PathSettings, _key, Setting(*_own[:3], domain=_own[3]))


_ONE: tuple[int, ...] = ()
_VECTOR, _ALL = (3,), (10,)


class Inertial(NamedTuple):
    """Mass, centre of mass and inertia of a body: what `Start.inertial` gives and `Start.set_inertial(body, *inertial)` takes."""

    mass: Any
    """kg."""
    center_of_mass: Any
    """m, body, [3]."""
    inertia: Any
    """About the centre of mass, kg m^2, [6]: xx, yy, zz, xy, xz, yz."""

    @classmethod
    def _of(cls, numbers: Any) -> Inertial:
        return cls(numbers[0], numbers[1:4], numbers[4:])

    @classmethod
    def ball(cls, mass: Any, radius: float, center_of_mass: Any) -> Inertial:
        """A solid ball."""
        return cls._of(_vectors("inertial_ball", [mass, center_of_mass], [_ONE, _VECTOR], _ALL, [float(radius)]))

    @classmethod
    def cuboid(cls, mass: Any, size: Any, center_of_mass: Any) -> Inertial:
        """A solid box with edges `size`, m, [3]."""
        own = [float(edge) for edge in size]
        return cls._of(_vectors("inertial_cuboid", [mass, center_of_mass], [_ONE, _VECTOR], _ALL, own))

    @classmethod
    def capsule(cls, mass: Any, radius: float, length: Any, center_of_mass: Any) -> Inertial:
        """A solid capsule along z, `length` between the middles of its ends, m."""
        own = [mass, length, center_of_mass]
        return cls._of(_vectors("inertial_capsule", own, [_ONE, _ONE, _VECTOR], _ALL, [float(radius)]))

    def scaled(self, factor: Any) -> Inertial:
        """The same body `factor` times as heavy."""
        return self._of(_vectors("inertial_scaled", [factor, *self], [_ONE, _ONE, _VECTOR, (6,)], _ALL))

    def joined(self, other: Inertial) -> Inertial:
        """Two bodies welded together."""
        return self._of(_vectors("inertial_joined", [*self, *other], [_ONE, _VECTOR, (6,)] * 2, _ALL))


class Success:
    """When an episode is a success, by figures of the task: `Success().below("distance", 0.1).held(1.0)`."""

    def __init__(self) -> None:
        self._limits: list[dict[str, Any]] = []
        self._also, self._once, self._held = "", False, 0.0

    @staticmethod
    def _number(what: str, number: float) -> float:
        if not math.isfinite(number):
            raise ValueError(f"{what} is {number}, but it must be finite. Leave it out where there is none.")
        return float(number)

    def below(self, metric: str, limit: float) -> Success:
        """And a figure below a limit."""
        self._limits.append({"metric": metric, "above": None, "below": self._number("the limit", limit), "unit": ""})
        return self

    def above(self, metric: str, limit: float) -> Success:
        """And a figure above a limit."""
        self._limits.append({"metric": metric, "above": self._number("the limit", limit), "below": None, "unit": ""})
        return self

    def also(self, words: str) -> Success:
        """And what else `success` asks in the same step, in words."""
        self._also = words
        return self

    def held(self, seconds: float) -> Success:
        """All of it through the last `seconds`."""
        self._held = self._number("the time", seconds)
        return self

    def once(self) -> Success:
        """In any step of an episode, not its last."""
        self._once = True
        return self

    def _json(self) -> str:
        return json.dumps({"limits": self._limits, "also": self._also, "once": self._once, "held": self._held})


class Task:
    """A task: what flies, where an episode begins, what is seen, rewarded and forbidden.

    A subclass is a task. Its methods are called once, when environments are made, with numbers that record (`omnidrones.Number`); what
    they computed is what all environments run, and what gradients are taken of. So nothing branches on a number: `np.where` picks.

    >>> class Rise(omnidrones.Task):
    ...     height = omnidrones.Setting(3.0, "m, world", "to rise to", domain="positive")
    ...     success_rule = omnidrones.Success().below("height_error", 0.1)
    ...     def left(self, view): return self.height - view.drone().position[2]
    ...     def start(self, start): start.place([0.0, 0.0, start.reset.uniform(1.0, 2.0)])
    ...     def ideal(self, start): start.place([0.0, 0.0, self.height])
    ...     def observe(self, view, agent, out):
    ...         out.field("left", "m, world", "to rise", self.left(view))
    ...         out.observe_drone(view)
    ...     def reward(self, view, terms): terms.term("near", "1/(1 + h²)", 1.0, 1.0 / (1.0 + self.left(view) ** 2))
    ...     def ends(self, view, ends): ends.when("crash", "z < 0.2 m", view.drone().position[2] < 0.2)
    ...     def metrics(self, view, out): out.metric("height_error", "m", abs(self.left(view)))
    >>> env = omnidrones.make(Rise, 64, height=2.5)

    Class attributes: `name` (the class's, unless given), `description` and `about` (from the docstring, unless given), `defaults` (of the
    environment: `{"dt": 0.02}`), `success_rule`, `scene` (a dict), `start_on_host` (episodes begin in plain float64, one after the other).
    """

    name: ClassVar[str]
    description: ClassVar[str] = ""
    about: ClassVar[str] = ""
    defaults: ClassVar[dict[str, Any]] = {}

    vehicle: Any = Setting("hummingbird", "", "what flies")
    horizon: Any = Setting(500, "steps", "T")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "name" not in cls.__dict__:
            cls.name = cls.__name__
        head, _, rest = (inspect.cleandoc(cls.__dict__.get("__doc__") or "")).partition("\n")
        if "description" not in cls.__dict__ and head:
            cls.description = head.rstrip(".")
        if "about" not in cls.__dict__ and rest.strip():
            cls.about = " ".join(rest.split())

    def robot(self) -> Robot:
        """What flies: one drone, `self.vehicle`."""
        return Robot(self.vehicle)

    @classmethod
    def _settings(cls) -> list[tuple[str, Any, str, str, str]]:
        own: dict[str, Setting] = {}
        for base in reversed(cls.__mro__):
            for key, value in vars(base).items():
                if isinstance(value, Setting):
                    own[key] = value
                elif key in own:
                    known = own[key]
                    own[key] = Setting(value, known.unit, known.meaning, domain=known.domain)
        for key in own:
            if key in _TAKEN:
                raise ValueError(f"'{key}' is a setting of {cls.__name__}, but it is one of environments. Name it otherwise.")
        return [(key, value.default, value.unit, value.meaning, value.domain) for key, value in own.items()]


_NEEDED = {
    "start": "def start(self, start): start.place(start.position(self.box))",
    "ideal": "def ideal(self, start): start.place(...): a state and goal in which the reward is largest",
    "observe": 'def observe(self, view, agent, out): out.field("way", "m, world", "to the target", ...); out.observe_drone(view)',
    "reward": 'def reward(self, view, terms): terms.term("near", "1/(1 + d²)", 1.0, ...)',
    "ends": 'def ends(self, view, ends): ends.when("crash", "z < 0.2 m", view.drone().position[2] < 0.2), or pass if nothing ends it',
}

_registered: dict[str, Any] = {}
"""By lower-case name: a class, or what changes a task."""

_TAKEN = frozenset(_core._setting_keys())


def register(task: _Class) -> _Class:
    """Makes a class of tasks known by its name: to `make`, `train`, `evaluate`, Gymnasium ids and all else that takes a name.

    A class of the same name takes the place of an earlier one. A decorator too: `@omnidrones.register`.

    Raises
    ------
    ValueError
        For the name of a task of the library, and for a class that lacks a method.
    """
    if not (inspect.isclass(task) and issubclass(task, Task) and task is not Task):
        raise TypeError(f"{task!r} is no subclass of omnidrones.Task. Write class MyTask(omnidrones.Task).")
    for method, example in _NEEDED.items():
        if not callable(getattr(task, method, None)):
            raise TypeError(f"{task.__name__} has no '{method}'. Write {example}.")
    rule = getattr(task, "success_rule", None)
    if rule is None or (isinstance(rule, Success) and not rule._limits and not hasattr(task, "success")):
        remedy = 'success_rule = omnidrones.Success().below("error", 0.1), by a figure of metrics'
        raise TypeError(f"{task.__name__} has no 'success_rule' with a limit. Write {remedy}.")
    task.name = _core._register(task.name, task)
    _registered[task.name.lower()] = task
    from ._when_gymnasium import again

    again()
    return task


def _name_of(given: Any) -> str:
    """The name of a task that a call means."""
    if inspect.isclass(given) and issubclass(given, Task) and given is not Task:
        if _registered.get(given.name.lower()) is not given:
            register(given)
        return given.name
    if isinstance(given, Task):
        raise TypeError(f"{given!r} is an object. Pass the class, and its settings by name: make({type(given).__name__}, 64).")
    raise TypeError(f"{given!r} is no task. Pass a name, as omnidrones.tasks() lists them, or a class of omnidrones.Task.")


def _changed(base: str, phases: dict[str, Any]) -> str:
    """A task with functions for some of its phases; its name."""
    base = _core._task_name(base)
    own = _registered.get(base.lower())
    if isinstance(own, _Changed):
        base, phases = own.base, own.phases | phases
        own = _registered.get(base.lower())
    if "reward" in phases and "loss" not in phases and own is not None:
        phases = phases | {"loss": None}
    name = base + "-" + "-".join(sorted(key for key in phases if phases[key] is not None))
    known = _registered.get(name.lower())
    if isinstance(known, _Changed) and known.phases == phases and known.of is own:
        return name
    change = _Changed(base, phases, own)
    if own is None:
        _core._register(name, change, base)
    else:
        changes = {key: function and staticmethod(function) for key, function in phases.items()}
        _core._register(name, type(name, (own,), changes | {"name": name}))
    _registered[name.lower()] = change
    return name


class _Changed:
    """A task of which functions take the place of phases."""

    def __init__(self, base: str, phases: dict[str, Any], of: Any) -> None:
        self.base, self.phases, self.of = base, phases, of
        told = ", ".join(sorted(key for key in phases if phases[key] is not None))
        self.description = f"{base} with {told} of one's own"
        for key, function in phases.items():
            if function is not None:
                setattr(self, key, function)


def _as_attribute(value: Any) -> Any:
    """The value of a setting as methods see it: lists of numbers are arrays."""
    if not isinstance(value, list):
        return value
    array = np.asarray(value) if _is_regular(value) else None
    return value if array is None or array.dtype.kind not in "fiu" else array.astype(np.float64)


def _is_regular(value: Any) -> bool:
    try:
        np.asarray(value)
    except ValueError:
        return False
    return True


__all__ = [
    "Ends",
    "Forest",
    "Gate",
    "Inertial",
    "Loss",
    "Mask",
    "PathSettings",
    "Robot",
    "Setting",
    "Start",
    "Success",
    "Task",
    "TrackPath",
    "View",
    "Writer",
    "register",
]
