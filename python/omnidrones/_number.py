"""Numbers that record.

A task, a controller or a system written in Python is called once, with numbers that record what is done to them. What comes out is a
program that runs from then on without Python. A `Number` is an array of places in that recording: its shape, slices and joins are
NumPy's own, its arithmetic goes to the library one operation at a time.
"""

from __future__ import annotations

import linecache
import operator
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from . import _core

_OWN = str(Path(__file__).parent)
_NUMPY = str(Path(np.__file__).parent)
# of nested lists
_DEEPEST = 32

Places = NDArray[np.int64]


class RecordingError(TypeError):
    """Something was asked of a recorded number that only a known one can tell.

    The message begins with the line that asked and ends with what to write instead.
    """

    filename: str | None = None
    """File of the line that asked."""
    lineno: int | None = None
    """Its number."""
    what: str = ""
    """What is wrong, without the line."""
    remedy: str = ""
    """What to write instead."""


def _caller() -> tuple[str, int] | None:
    """The innermost line outside of this package and NumPy."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith((_OWN, _NUMPY, "<__array_function__", "<frozen")):
            return name, frame.f_lineno
        frame = frame.f_back  # type: ignore[assignment]
    return None


def _mistake(what: str, remedy: str) -> RecordingError:
    where, place = _caller(), ""
    if where is not None:
        line = linecache.getline(*where).strip()
        place = f"{where[0]}, line {where[1]}, `{line}`: " if line else f"{where[0]}, line {where[1]}: "
    error = RecordingError(f"{place}{what}. {remedy}")
    error.filename, error.lineno = where or (None, None)
    error.what, error.remedy = what, remedy
    return error


def _nothing_records() -> RecordingError:
    return _mistake(
        "a recorded number outside of any recording, or in another thread than the one that records",
        "Numbers live while the function that was given them runs: return what you need of them.",
    )


def _of_another_recording() -> RecordingError:
    return _mistake(
        "a number of another recording, or of one that has ended",
        "Do not keep numbers between calls: let the function return them, or carry them in the state.",
    )


def _hint(default: str) -> str:
    """A remedy for the line that asked."""
    where = _caller()
    line = linecache.getline(*where) if where else ""
    if name := re.search(r"\bmath\.(\w+)\(", line):
        own = {"fabs": "abs", "pow": "power", "atan2": "arctan2", "acos": "arccos", "asin": "arcsin", "atan": "arctan"}
        return f"Write np.{own.get(name[1], name[1])} in place of math.{name[1]}."
    if re.search(r"(?<![\w.])(max|min)\(", line):
        return "Write np.maximum(a, b) or np.minimum(a, b), of an array np.max or np.min."
    if re.search(r"(?<![\w.])sorted\(|\.sort\(", line):
        return "Numbers are not put in order; np.max, np.min and np.where pick."
    if re.search(r"\s(and|or)\s|\bnot\s", line):
        return "Write (a < b) & (c < d), | and ~ for and, or and not; np.where(mask, a, b) picks."
    if re.search(r"[^<>=!]<=?[^<>=]+<=?[^<>=]|[^<>=!]>=?[^<>=]+>=?[^<>=]", line):
        return "Write (a < x) & (x < b) for a < x < b; np.where(mask, a, b) picks."
    return default


def _told(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    if isinstance(value, (Number, Mask)):
        return f"a {type(value).__name__} of shape {value.shape}"
    return f"a {type(value).__name__}"


_WHERE = "Write np.where(mask, a, b) for a choice; of a task, ends.when(mask) ends an episode."
_Own = TypeVar("_Own", bound="_Recorded")


class _Recorded:
    """What numbers and truths share: an array of places."""

    __slots__ = ("_places",)
    _places: Places
    # what plain scalars of NumPy ask
    __array_priority__ = 1000.0

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        raise _mistake(
            f"a {cls.__name__} is not made so", "Use omnidrones.array(values), omnidrones.zeros(shape) or a comparison."
        )

    @classmethod
    def _at(cls: type[_Own], places: Any) -> _Own:
        own: _Own = object.__new__(cls)
        own._places = np.asarray(places, np.int64)
        return own

    @classmethod
    def _from(cls, value: Any) -> Any:
        """Of this kind, whatever was given."""
        raise NotImplementedError

    # shape

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return self._places.shape

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self._places.ndim

    @property
    def size(self) -> int:
        """How many there are."""
        return self._places.size

    @property
    def T(self: _Own) -> _Own:
        """With the axes in reverse."""
        return self._at(self._places.T)

    def __len__(self) -> int:
        if self.ndim == 0:
            raise TypeError(f"len() of a single {type(self).__name__}")
        return len(self._places)

    def __iter__(self: _Own) -> Iterator[_Own]:
        if self.ndim == 0:
            raise TypeError(f"iteration over a single {type(self).__name__}")
        return (self._at(own) for own in self._places)

    def __getitem__(self: _Own, index: Any) -> _Own:
        _check_index(index)
        return self._at(self._places[index])

    def __setitem__(self, index: Any, value: Any) -> None:
        if isinstance(index, Mask):
            # x[x < 0] = 0
            if index.shape != self.shape or np.ndim(value) != 0:
                raise _mistake(
                    "which numbers a mask picks is known only when the recording runs",
                    "Write x[:] = np.where(mask, value, x).",
                )
            index, value = ..., _where(index, value, self)
        _check_index(index)
        own = self._from(value)
        _core._check_places(np.ascontiguousarray(own._places).reshape(-1))
        self._places[index] = own._places

    def reshape(self: _Own, *shape: Any, order: Any = "C") -> _Own:
        """In another shape of as many."""
        _check_index(shape)
        return self._at(self._places.reshape(*shape, order=order))

    def ravel(self: _Own) -> _Own:
        """In one axis."""
        return self._at(self._places.ravel())

    def flatten(self: _Own) -> _Own:
        """In one axis, a copy."""
        return self._at(self._places.flatten())

    def copy(self: _Own) -> _Own:
        """To write into."""
        return self._at(self._places.copy())

    def transpose(self: _Own, *axes: Any) -> _Own:
        """With the axes in another order, in reverse by default."""
        return self._at(self._places.transpose(*axes))

    def swapaxes(self: _Own, first: int, second: int) -> _Own:
        """With two axes exchanged."""
        return self._at(self._places.swapaxes(first, second))

    def squeeze(self: _Own, axis: Any = None) -> _Own:
        """Without axes of length 1."""
        return self._at(self._places.squeeze(axis))

    def repeat(self: _Own, repeats: Any, axis: Any = None) -> _Own:
        """Each as many times."""
        _check_index(repeats)
        return self._at(self._places.repeat(repeats, axis))

    def take(self: _Own, indices: Any, axis: Any = None) -> _Own:
        """Those at constant indices."""
        _check_index(indices)
        return self._at(self._places.take(indices, axis))

    def diagonal(self: _Own, offset: int = 0, axis1: int = 0, axis2: int = 1) -> _Own:
        """Of a matrix."""
        return self._at(self._places.diagonal(offset, axis1, axis2))

    __copy__ = copy

    def __deepcopy__(self: _Own, memory: Any) -> _Own:
        return self.copy()

    # what needs a value

    def _refuse(self, what: str, remedy: str) -> NoReturn:
        raise _mistake(f"{what}, which is known only when the recording runs", _hint(remedy))

    def __bool__(self) -> bool:
        self._refuse("this asks whether a recorded number or mask is true", _WHERE)

    def __float__(self) -> float:
        self._refuse(
            "this asks for the value of a recorded number",
            "Keep it as it is; functions of NumPy take it. Write into an array of omnidrones.zeros(shape), not of np.zeros.",
        )

    def __int__(self) -> int:
        self._refuse("this asks for the value of a recorded number as an integer", "Keep it as it is, or use np.where.")

    def __complex__(self) -> complex:
        self._refuse("this asks for the value of a recorded number", "Keep it as it is; recorded numbers are real.")

    def __index__(self) -> int:
        self._refuse(
            "this takes a recorded number for an index or a count",
            "Use a constant, or pick a row by omnidrones.functions.take(table, index).",
        )

    def __round__(self, digits: Any = None) -> Any:
        self._refuse("this rounds a recorded number", "Write np.floor(x + 0.5): steps have no derivative.")

    def __trunc__(self) -> Any:
        self._refuse("this rounds a recorded number", "Write np.trunc, np.floor or np.ceil: steps have no derivative.")

    __floor__ = __trunc__
    __ceil__ = __trunc__

    def __hash__(self) -> int:
        self._refuse("this takes a recorded number for a key", "Use a constant as key, or id(x).")

    def __contains__(self, value: Any) -> bool:
        self._refuse(
            "this asks whether a recorded number equals another", "Compare with a tolerance: np.abs(a - b) < 1e-6."
        )

    def __eq__(self, other: object) -> Any:
        self._refuse(
            "this asks whether a recorded number equals another",
            "Compare with a tolerance, np.abs(a - b) < 1e-6; of masks write ~(a ^ b).",
        )

    def __ne__(self, other: object) -> Any:
        self._refuse(
            "this asks whether a recorded number differs from another",
            "Compare with a tolerance, np.abs(a - b) > 1e-6; of masks write a ^ b.",
        )

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        self._refuse(
            "this makes a plain array of recorded numbers",
            "Write np.stack or omnidrones.array in place of np.array, and write into omnidrones.zeros(shape).",
        )

    def item(self, *args: Any) -> Any:
        """Refused: a value is known only when the recording runs."""
        self._refuse("this asks for the value of a recorded number", "Keep it as it is.")

    def tolist(self) -> Any:
        """Lists of single ones, nested as the axes are."""
        return self[()] if self.ndim == 0 else [own.tolist() for own in self]

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise _mistake(
            "recorded numbers are not saved", "Save what the recording became: the task, controller or system."
        )

    def __repr__(self) -> str:
        shape = ", ".join(map(str, self.shape))
        return f"{type(self).__name__}({f'[{shape}]' if shape else 'one'}, recorded)"

    def __format__(self, spec: str) -> str:
        if spec:
            self._refuse(
                "this prints the value of a recorded number",
                "Print it without a format, or look at what the recording returns.",
            )
        return repr(self)

    # NumPy

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **how: Any) -> Any:
        from . import _numpy

        return _numpy.ufunc(ufunc, method, inputs, how)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        from . import _numpy

        return _numpy.function(function, args, kwargs)

    # truths

    def __lt__(self, other: Any) -> Mask:
        return _less(self, other)

    def __gt__(self, other: Any) -> Mask:
        return _less(other, self)

    def __le__(self, other: Any) -> Mask:
        return ~_less(other, self)

    def __ge__(self, other: Any) -> Mask:
        return ~_less(self, other)

    # numbers

    def __add__(self, other: Any) -> Number:
        return _on("add", self, other)

    def __radd__(self, other: Any) -> Number:
        return _on("add", other, self)

    def __sub__(self, other: Any) -> Number:
        return _on("subtract", self, other)

    def __rsub__(self, other: Any) -> Number:
        return _on("subtract", other, self)

    def __mul__(self, other: Any) -> Number:
        return _on("multiply", self, other)

    def __rmul__(self, other: Any) -> Number:
        return _on("multiply", other, self)

    def __truediv__(self, other: Any) -> Number:
        return _on("divide", self, other)

    def __rtruediv__(self, other: Any) -> Number:
        return _on("divide", other, self)

    def __matmul__(self, other: Any) -> Number:
        return _matmul(self, other)

    def __rmatmul__(self, other: Any) -> Number:
        return _matmul(other, self)

    def __pow__(self, exponent: Any, modulo: Any = None) -> Number:
        return _power(self, exponent)

    def __rpow__(self, base: Any) -> Number:
        return _power(base, self)

    def __neg__(self) -> Number:
        return _on("negative", self)

    def __pos__(self) -> Number:
        return _number(self)

    def __abs__(self) -> Number:
        return _on("absolute", self)

    def __floordiv__(self, other: Any) -> Number:
        return _floor_divide(self, other)

    def __rfloordiv__(self, other: Any) -> Number:
        return _floor_divide(other, self)

    def __mod__(self, other: Any) -> Number:
        return _remainder(self, other)

    def __rmod__(self, other: Any) -> Number:
        return _remainder(other, self)

    def __divmod__(self, other: Any) -> tuple[Number, Number]:
        return _floor_divide(self, other), _remainder(self, other)

    def __rdivmod__(self, other: Any) -> tuple[Number, Number]:
        return _floor_divide(other, self), _remainder(other, self)

    def sum(self, axis: Any = None, *, keepdims: bool = False) -> Number:
        """One behind the other."""
        return _fold("sum", self, axis, keepdims)

    def prod(self, axis: Any = None, *, keepdims: bool = False) -> Number:
        """One behind the other."""
        return _fold("product", self, axis, keepdims)

    def mean(self, axis: Any = None, *, keepdims: bool = False) -> Number:
        """Their sum divided by how many there are."""
        return _mean(self, axis, keepdims)

    def max(self, axis: Any = None, *, keepdims: bool = False) -> Number:
        """The largest; the first of equals."""
        return _fold("largest", self, axis, keepdims)

    def min(self, axis: Any = None, *, keepdims: bool = False) -> Number:
        """The smallest; the first of equals."""
        return _fold("smallest", self, axis, keepdims)

    def cumsum(self, axis: Any = None) -> Number:
        """Sums up to each."""
        return _cumulated("add", self, axis)

    def trace(self) -> Number:
        """The sum of a matrix' diagonal."""
        return _fold("sum", self.diagonal(), -1, False)

    def dot(self, other: Any) -> Number:
        """As np.dot."""
        return _dot(self, other)

    def astype(self, dtype: Any, copy: bool = True) -> Number:
        """Numbers are float already; truths become 1 and 0."""
        if np.dtype(dtype).kind != "f":
            self._refuse(f"this makes {np.dtype(dtype)} of recorded numbers", "Keep them as they are.")
        return _number(self).copy()


class Number(_Recorded):
    """A number, or an array of numbers, that records what is done to it.

    Tasks, controllers and systems written in Python are called with them, once. Arithmetic, comparisons, slices and most functions of
    NumPy work as on an array of float64; with plain numbers, arrays and lists they mix.

    Nothing may depend on a value while it is recorded: `if`, `while`, `float(x)` and the like raise `RecordingError`, and
    `np.where(mask, a, b)` picks. Both sides of it are computed. Loops over a constant range are fine.

    Where it matters:

    - `np.linalg.norm`, `np.hypot` are held at 1e-9 or more, so that their derivative at zero is 0. `np.sqrt` and `np.arctan2` are the plain
      ones; guarded ones are in `omnidrones.functions`. `np.arccos` and `np.arcsin` hold their argument within [-1, 1].
    - Comparisons give a `Mask`. `a <= b` is `~(b < a)`, which of NaN is true where NumPy says false. `np.maximum(a, b)` is `a` where one
      of both is NaN. NaN itself is refused as a constant.
    - Sums run from the first to the last.
    - `np.floor`, `np.ceil`, `np.trunc`, `//` and `%` have derivative 0 (of `a % b` that of a), and are slow where all environments run them.
    - Slices are views: `x[0] = y` writes into what `x` is a slice of. `x += y` writes into an array, and makes a new single number.
    """

    __slots__ = ()

    @classmethod
    def _from(cls, value: Any) -> Number:
        return _number(value)

    def __iadd__(self, other: Any) -> Number:
        return self._written(_on("add", self, other))

    def __isub__(self, other: Any) -> Number:
        return self._written(_on("subtract", self, other))

    def __imul__(self, other: Any) -> Number:
        return self._written(_on("multiply", self, other))

    def __itruediv__(self, other: Any) -> Number:
        return self._written(_on("divide", self, other))

    def _written(self, result: Number) -> Number:
        if self.ndim == 0:
            return result
        self._places[...] = result._places
        return self

    def clip(self, min: Any = None, max: Any = None) -> Number:
        """Held within bounds."""
        return _clip(self, min, max)

    def _no_truth(self, *_: Any) -> NoReturn:
        raise _mistake("& | ^ ~ take masks, not numbers", "Compare first: (x > 0) & (y < 1).")

    __and__ = __rand__ = __or__ = __ror__ = __xor__ = __rxor__ = _no_truth

    def __invert__(self) -> NoReturn:
        self._no_truth()


class Mask(_Recorded):
    """A truth, or an array of truths, that is known when the recording runs: what comparisons of `Number` give.

    `&`, `|`, `^`, `~` and NumPy's logical functions combine them, `np.where` and `np.select` pick by them. In arithmetic they are 1 and 0.
    """

    __slots__ = ()

    @classmethod
    def _from(cls, value: Any) -> Mask:
        return _mask(value)

    def __and__(self, other: Any) -> Mask:
        return _truths("all", self, other)

    def __or__(self, other: Any) -> Mask:
        return _truths("any", self, other)

    def __xor__(self, other: Any) -> Mask:
        a, b = _mask(self), _mask(other)
        return (a | b) & ~(a & b)

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __invert__(self) -> Mask:
        return _truths("not", self)

    def any(self, axis: Any = None, *, keepdims: bool = False) -> Mask:
        """Whether one holds."""
        return _fold_truths("any", self, axis, keepdims)

    def all(self, axis: Any = None, *, keepdims: bool = False) -> Mask:
        """Whether all hold."""
        return _fold_truths("all", self, axis, keepdims)


def _is_recorded(value: Any, depth: int = 0) -> bool:
    """Whether recorded numbers are in it."""
    if isinstance(value, _Recorded):
        return True
    if isinstance(value, (list, tuple)):
        if depth > _DEEPEST:
            raise _mistake("lists in lists without end", "Give an array.")
        return any(_is_recorded(own, depth + 1) for own in value)
    if isinstance(value, np.ndarray) and value.dtype == object:
        return any(isinstance(own, _Recorded) for own in value.flat)
    return False


def _check_index(index: Any) -> None:
    if not _is_recorded(index):
        return
    if isinstance(index, Mask):
        raise _mistake(
            "which numbers a mask picks is known only when the recording runs",
            "Write np.where(mask, x, other), which keeps the shape.",
        )
    raise _mistake(
        "an index, a count or a shape is a recorded number",
        "Use a constant, or pick a row by omnidrones.functions.take(table, index).",
    )


def _plain(value: Any) -> NDArray[np.float64]:
    """Plain numbers."""
    remedy = "Give numbers, arrays of float or int, or lists of them."
    if isinstance(value, np.ndarray) and value.dtype == object and _is_recorded(value):
        raise _mistake("an array of objects with recorded numbers in it", "Write np.stack or omnidrones.array.")
    try:
        own = np.asarray(value)
        if own.dtype.kind == "O" and isinstance(value, int):
            own = np.asarray(float(value))
    except RecordingError:
        raise
    except Exception as error:
        raise _mistake(f"{_told(value)} is no number or array of numbers ({error})", remedy) from None
    if own.dtype.kind not in "biuf":
        raise _mistake(f"{_told(value)} is no number or array of numbers", remedy)
    with np.errstate(all="ignore"):
        return own if own.dtype == np.float64 else own.astype(np.float64)


def _constant(value: Any) -> NDArray[np.float64]:
    """Numbers that may stand in a recording."""
    own = _plain(value)
    if np.isnan(own).any():
        raise _mistake("NaN among the constants", "Leave it out: nothing that is computed with it is a number.")
    return own


def _constants(values: NDArray[np.float64]) -> Places:
    # of one that is broadcast, too
    _few(values.size)
    places = _core._constants(np.ascontiguousarray(values).reshape(-1))
    return places.reshape(values.shape)


def _number(value: Any) -> Number:
    """Numbers of whatever was given."""
    if isinstance(value, Number):
        return value
    if isinstance(value, Mask):
        return Number._at(_rows("as_number", [value._places]))
    if isinstance(value, (list, tuple)) and _is_recorded(value):
        return Number._at(_joined([_number(own)._places for own in value]))
    return Number._at(_constants(_constant(value)))


def _mask(value: Any) -> Mask:
    """Truths of whatever was given."""
    if isinstance(value, Mask):
        return value
    if isinstance(value, (list, tuple)) and _is_recorded(value):
        return Mask._at(_joined([_mask(own)._places for own in value]))
    if not isinstance(value, Number):
        try:
            own = np.asarray(value)
        except Exception:
            own = np.asarray(None)
        if own.dtype == bool:
            return Mask._at(_constants(own.astype(np.float64)))
    raise _mistake(f"{_told(value)} is no mask", "Compare first, as in x > 0; & | ^ ~ combine masks.")


def _joined(parts: list[Places]) -> Places:
    if len({own.shape for own in parts}) > 1:
        shapes = ", ".join(sorted({str(own.shape) for own in parts}))
        raise _mistake(
            f"a list of numbers of different shapes, {shapes}", "Write np.concatenate for vectors of different lengths."
        )
    return np.stack(parts)


def _broadcast(arrays: Sequence[Any]) -> list[Any]:
    try:
        return list(np.broadcast_arrays(*arrays))
    except ValueError:
        shapes = " ".join(str(own.shape) for own in arrays)
        raise ValueError(f"operands could not be broadcast together with shapes {shapes}") from None


# an operation takes no more, and a broadcast array may pretend to be of any size
_MOST = 1 << 22


def _few(size: int) -> None:
    if size > _MOST:
        raise _mistake(
            f"an operation on {size} recorded numbers, of which at most {_MOST} are taken",
            "Record what happens to one, and run it for many.",
        )


def _rows(name: str, operands: Sequence[Places], settings: Sequence[float] = ()) -> Places:
    """An operation on each of single operands."""
    own = _broadcast(operands)
    shape, size = own[0].shape, own[0].size
    _few(size * len(own))
    if size == 0:
        return np.zeros(shape, np.int64)
    rows = np.stack([places.reshape(-1) for places in own], 1)
    return _core._record(name, rows, list(settings)).reshape(shape)


def _on(name: str, *operands: Any, settings: Sequence[float] = ()) -> Number:
    return Number._at(_rows(name, [_number(own)._places for own in operands], settings))


def _truths(name: str, *operands: Any) -> Mask:
    return Mask._at(_rows(name, [_mask(own)._places for own in operands]))


def _less(a: Any, b: Any) -> Mask:
    return Mask._at(_rows("less", [_number(a)._places, _number(b)._places]))


def _where(mask: Any, yes: Any, no: Any) -> Any:
    if isinstance(yes, Mask) and isinstance(no, Mask):
        chosen = _mask(mask)
        return (chosen & yes) | (~chosen & no)
    chosen = _mask(mask)
    return Number._at(_rows("select", [chosen._places, _number(yes)._places, _number(no)._places]))


def _power(base: Any, exponent: Any) -> Number:
    remedy = "Write np.exp(y * np.log(x)), for x > 0."
    if isinstance(exponent, _Recorded):
        raise _mistake("an exponent is a recorded number", remedy)
    exponents = _constant(exponent)
    if exponents.ndim == 0:
        return _one_power(base, float(exponents), remedy)
    own, exponents = _broadcast([_number(base)._places, exponents])
    result = np.zeros(own.shape, np.int64)
    for value in set(exponents.reshape(-1).tolist()):
        at = exponents == value
        result[at] = _one_power(Number._at(own[at]), value, remedy)._places
    return Number._at(result)


def _one_power(base: Any, exponent: float, remedy: str) -> Number:
    if abs(exponent) != 0.5 and not (exponent.is_integer() and abs(exponent) <= 1 << 20):
        raise _mistake(f"an exponent is {exponent}, neither whole nor 0.5", remedy)
    return _on("power", base, settings=[exponent])


def _floor(x: Any) -> Number:
    return _on("floor", x)


def _floor_divide(a: Any, b: Any) -> Number:
    return _floor(_on("divide", a, b))


def _remainder(a: Any, b: Any) -> Number:
    return _on("subtract", a, _on("multiply", _floor_divide(a, b), b))


def _clip(x: Any, low: Any, high: Any) -> Any:
    if low is None and high is None:
        return _number(x).copy()
    if low is None:
        return _on("minimum", x, high)
    if high is None:
        return _on("maximum", x, low)
    return _on("clip", x, low, high)


def _axes(axis: Any, n: int) -> tuple[int, ...]:
    """Axes that are folded."""
    if axis is None:
        return tuple(range(n))
    _check_index(axis)
    given = axis if isinstance(axis, tuple) else (axis,)
    own = tuple(operator.index(a) for a in given)
    if not all(-n <= a < n for a in own):
        raise np.exceptions.AxisError(f"axis {axis} of an array of {n} axes")
    own = tuple(a % n for a in own)
    if len(set(own)) < len(own):
        raise ValueError("duplicate value in 'axis'")
    return own


def _folded(name: str, places: Places, axis: Any, keepdims: bool, empty: Callable[[], Places] | None) -> Places:
    axes = _axes(axis, places.ndim)
    kept = [a for a in range(places.ndim) if a not in axes]
    shape = tuple(places.shape[a] for a in kept)
    own = places.transpose(*kept, *sorted(axes))
    n = int(np.prod([places.shape[a] for a in axes], dtype=np.int64))
    _few(own.size)
    size = int(np.prod(shape, dtype=np.int64))
    if size == 0:
        result = np.zeros(shape, np.int64)
    elif n == 0:
        if empty is None:
            raise ValueError("the largest or smallest of no numbers")
        result = np.broadcast_to(empty(), shape).copy()
    else:
        result = _core._record(name, np.ascontiguousarray(own).reshape(size, n)).reshape(shape)
    return np.expand_dims(result, tuple(sorted(axes))) if keepdims else result


_EMPTY: dict[str, float] = {"sum": 0.0, "product": 1.0, "all": 1.0, "any": 0.0, "norm": 0.0}


def _fold(name: str, x: Any, axis: Any = None, keepdims: bool = False) -> Number:
    value = _EMPTY.get(name)
    empty = None if value is None else lambda: _constants(np.asarray(value, np.float64))
    return Number._at(_folded(name, _number(x)._places, axis, keepdims, empty))


def _fold_truths(name: str, x: Any, axis: Any = None, keepdims: bool = False) -> Mask:
    return Mask._at(
        _folded(name, _mask(x)._places, axis, keepdims, lambda: _constants(np.asarray(_EMPTY[name], np.float64)))
    )


def _mean(x: Any, axis: Any = None, keepdims: bool = False) -> Number:
    own = _number(x)
    n = int(np.prod([own.shape[a] for a in _axes(axis, own.ndim)], dtype=np.int64))
    if n == 0:
        raise ValueError("the mean of no numbers")
    return _fold("sum", own, axis, keepdims) / float(n)


def _cumulated(name: str, x: Any, axis: Any = None) -> Number:
    own = _number(x)
    if axis is None:
        own, axis = own.ravel(), 0
    (axis,) = _axes(axis, own.ndim)
    places = np.moveaxis(own._places, axis, 0).copy()
    for k in range(1, len(places)):
        places[k] = _rows(name, [places[k - 1], places[k]])
    return Number._at(np.moveaxis(places, 0, axis))


def _dots(a: Places, b: Places) -> Number:
    """Products of vectors along the last axis, which both have in the same length."""
    a, b = _broadcast([a, b])
    shape, n = a.shape[:-1], a.shape[-1]
    size = int(np.prod(shape, dtype=np.int64))
    _few(2 * a.size)
    if n == 0:
        return Number._at(np.broadcast_to(_constants(np.zeros(())), shape).copy())
    if size == 0:
        return Number._at(np.zeros(shape, np.int64))
    rows = np.concatenate([a.reshape(size, n), b.reshape(size, n)], 1)
    return Number._at(_core._record("dot", rows).reshape(shape))


def _matmul(left: Any, right: Any) -> Number:
    a, b = _number(left)._places, _number(right)._places
    if a.ndim == 0 or b.ndim == 0:
        raise ValueError("@ takes vectors and matrices. Write * for products with single numbers.")
    inner = b.shape[-2] if b.ndim > 1 else b.shape[0]
    if a.shape[-1] != inner:
        raise ValueError(f"@ of shapes {a.shape} and {b.shape}: {a.shape[-1]} numbers beside {inner}")
    rows = a[None, :] if a.ndim == 1 else a
    columns = b[None, :] if b.ndim == 1 else np.swapaxes(b, -1, -2)
    own = _dots(rows[..., :, None, :], columns[..., None, :, :])._places
    if b.ndim == 1:
        own = own[..., 0]
    if a.ndim == 1:
        own = own[..., 0] if b.ndim == 1 else own[..., 0, :]
    return Number._at(own)


def _dot(left: Any, right: Any) -> Number:
    a, b = _number(left), _number(right)
    if a.ndim == 0 or b.ndim == 0:
        return a * b
    if a.ndim > 2 or b.ndim > 2:
        raise _mistake("np.dot of more than two axes", "Write a @ b, or np.einsum.")
    return _matmul(a, b)


def _vectors(
    name: str,
    operands: Sequence[Any],
    shapes: Sequence[tuple[int, ...]],
    result: tuple[int, ...],
    settings: Sequence[float] = (),
) -> Any:
    """A function of small arrays, for all axes in front of them. Plain numbers give plain numbers.

    A length of -1 is free, and the same in all of them.
    """
    recorded = any(_is_recorded(own) for own in operands)
    arrays: list[Any] = [_number(own)._places if recorded else _plain(own) for own in operands]
    free: set[int] = set()
    for own, shape in zip(arrays, shapes, strict=True):
        core = own.shape[own.ndim - len(shape) :] if own.ndim >= len(shape) else None
        if core is None or any(n not in (-1, m) for n, m in zip(shape, core, strict=True)):
            wanted = ", ".join("n" if n < 0 else str(n) for n in shape)
            raise ValueError(f"{name} takes arrays of shape [..., {wanted}], not {list(own.shape)}.")
        free |= {m for n, m in zip(shape, core, strict=True) if n < 0}
    if len(free) > 1 or free == {0}:
        raise ValueError(f"{name} takes vectors of one length, at least 1, not {sorted(free)}.")
    length = free.pop() if free else 1
    result = tuple(length if n < 0 else n for n in result)
    fronts = [own.shape[: own.ndim - len(shape)] for own, shape in zip(arrays, shapes, strict=True)]
    try:
        front = np.broadcast_shapes(*fronts)
    except ValueError:
        raise ValueError(f"{name}: axes in front, {' '.join(map(str, fronts))}, do not go together.") from None
    size = int(np.prod(front, dtype=np.int64))
    if size == 0:
        empty = np.zeros(front + result, np.int64 if recorded else np.float64)
        return Number._at(empty) if recorded else empty
    parts = []
    for own, shape in zip(arrays, shapes, strict=True):
        core = own.shape[own.ndim - len(shape) :]
        if recorded:
            _few(size * int(np.prod(core, dtype=np.int64)))
        parts.append(np.broadcast_to(own, front + core).reshape(size, -1))
    rows = np.ascontiguousarray(np.concatenate(parts, 1))
    if recorded:
        return Number._at(_core._record(name, rows, list(settings)).reshape(front + result))
    return _core._compute(name, rows, list(settings)).reshape(front + result)[()]


@overload
def array(values: Mask) -> Mask: ...
@overload
def array(values: Any) -> Any: ...
def array(values: Any) -> Any:
    """A new array to write into: of recorded numbers, plain ones, arrays, and nested lists of all of them.

    >>> omnidrones.array([[x[0], 1.0], [0.0, x[1]]])
    """
    return (_mask(values) if isinstance(values, Mask) else _number(values)).copy()


def zeros(shape: Any) -> Number:
    """An array of constant zeros to write recorded numbers into, as np.zeros is for plain ones."""
    _check_index(shape)
    own = np.broadcast_to(np.zeros(()), shape)
    _few(own.size)
    return Number._at(np.broadcast_to(_constants(np.zeros(())), own.shape).copy())


# for the extension: how its numbers come here and go back


def _number_at(places: Places) -> Number:
    return Number._at(places)


def _mask_at(places: Places) -> Mask:
    return Mask._at(places)


def _numbers_of(what: str, given: Any, shape: list[int] | None) -> Places:
    """Places of what the user's code gave, in one axis."""
    if given is None:
        raise _mistake(f"{what} is None", "Return it.")
    try:
        places = _number(given)._places
    except RecordingError as error:
        raise _mistake(f"{what} is {_told(given)}: {error.what}", error.remedy) from None
    if shape is not None and [n for n in places.shape if n != 1] != [n for n in shape if n != 1]:
        wanted = "a single number" if not shape else f"of shape {tuple(shape)}"
        raise _mistake(f"{what} has the shape {places.shape}, but it must be {wanted}", "Reshape or join it.")
    return np.ascontiguousarray(places).reshape(-1)


def _truth_of(what: str, given: Any) -> Places:
    if isinstance(given, Number):
        raise _mistake(f"{what} is a number, but it must be a mask", "Compare it, as in x > 0.")
    try:
        own = _mask(given)
    except RecordingError:
        raise _mistake(
            f"{what} is {_told(given)}, but it must be a mask or a bool", "Compare numbers, as in x > 0."
        ) from None
    if own.size != 1:
        raise _mistake(
            f"{what} has the shape {own.shape}, but it must be one mask", "Write np.any(mask) or np.all(mask)."
        )
    return np.ascontiguousarray(own._places).reshape(-1)
