"""NumPy's functions on numbers that record: shapes by NumPy itself on their places, arithmetic by the library."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ._number import (
    Mask,
    Number,
    _check_index,
    _clip,
    _constants,
    _cumulated,
    _dot,
    _dots,
    _few,
    _floor,
    _floor_divide,
    _fold,
    _fold_truths,
    _is_recorded,
    _less,
    _mask,
    _matmul,
    _mean,
    _mistake,
    _number,
    _on,
    _power,
    _Recorded,
    _remainder,
    _vectors,
    _where,
    zeros,
)


def _refused(what: str) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> Any:
        raise _mistake(
            f"this asks whether recorded numbers are equal ({what})", "Compare with a tolerance: np.abs(a - b) < 1e-6."
        )

    return refuse


def _invert(x: Any) -> Mask:
    return ~_mask(x)


def _not_equal_truths(a: Any, b: Any) -> Mask:
    return _mask(a) ^ _mask(b)


_UFUNCS: dict[Any, Callable[..., Any]] = {
    **{
        getattr(np, own): (lambda name: lambda *operands: _on(name, *operands))(name)
        for own, name in {
            "add": "add",
            "subtract": "subtract",
            "multiply": "multiply",
            "divide": "divide",
            "maximum": "maximum",
            "minimum": "minimum",
            "fmax": "maximum",
            "fmin": "minimum",
            "arctan2": "arctan2",
            "negative": "negative",
            "absolute": "absolute",
            "fabs": "absolute",
            "square": "square",
            "reciprocal": "reciprocal",
            "sqrt": "sqrt",
            "exp": "exp",
            "log": "log",
            "tanh": "tanh",
            "sin": "sin",
            "cos": "cos",
            "tan": "tan",
            "sign": "sign",
            "arccos": "safe_arccos",
            "arcsin": "safe_arcsin",
        }.items()
    },
    np.positive: _number,
    np.floor: _floor,
    np.ceil: lambda x: -_floor(-_number(x)),
    np.trunc: lambda x: _where(_less(x, 0.0), -_floor(-_number(x)), _floor(x)),
    np.floor_divide: _floor_divide,
    np.remainder: _remainder,
    np.arctan: lambda x: _on("arctan2", x, 1.0),
    np.hypot: lambda a, b: _vectors("norm", [_stacked([a, b])], [(-1,)], ()),
    np.deg2rad: lambda x: _on("multiply", x, np.pi / 180.0),
    np.radians: lambda x: _on("multiply", x, np.pi / 180.0),
    np.rad2deg: lambda x: _on("multiply", x, 180.0 / np.pi),
    np.degrees: lambda x: _on("multiply", x, 180.0 / np.pi),
    np.power: _power,
    np.float_power: _power,
    np.matmul: _matmul,
    np.less: _less,
    np.greater: lambda a, b: _less(b, a),
    np.less_equal: lambda a, b: ~_less(b, a),
    np.greater_equal: lambda a, b: ~_less(a, b),
    np.equal: _refused("np.equal"),
    np.not_equal: _refused("np.not_equal"),
    np.logical_and: lambda a, b: _mask(a) & _mask(b),
    np.logical_or: lambda a, b: _mask(a) | _mask(b),
    np.logical_xor: _not_equal_truths,
    np.logical_not: _invert,
    np.bitwise_and: lambda a, b: _mask(a) & _mask(b),
    np.bitwise_or: lambda a, b: _mask(a) | _mask(b),
    np.bitwise_xor: _not_equal_truths,
    np.invert: _invert,
}

_REDUCTIONS: dict[Any, Callable[..., Any]] = {
    np.add: lambda x, axis, keepdims: _fold("sum", x, axis, keepdims),
    np.multiply: lambda x, axis, keepdims: _fold("product", x, axis, keepdims),
    np.maximum: lambda x, axis, keepdims: _fold("largest", x, axis, keepdims),
    np.minimum: lambda x, axis, keepdims: _fold("smallest", x, axis, keepdims),
    np.logical_and: lambda x, axis, keepdims: _fold_truths("all", x, axis, keepdims),
    np.logical_or: lambda x, axis, keepdims: _fold_truths("any", x, axis, keepdims),
}


def ufunc(own: Any, method: str, inputs: Sequence[Any], how: dict[str, Any]) -> Any:
    """What `Number.__array_ufunc__` does."""
    name = f"np.{own.__name__}"
    _check_size(tuple(inputs))
    out = how.pop("out", None)
    if out is not None and any(target is not None for target in out):
        return _into(own, method, inputs, how, out[0])
    if method == "__call__" and own in _UFUNCS:
        if how:
            raise _mistake(f"{name} of recorded numbers takes no {', '.join(how)}", "Leave it out; np.where picks.")
        return _UFUNCS[own](*inputs)
    if method == "reduce" and own in _REDUCTIONS:
        axis, keepdims = how.pop("axis", 0), how.pop("keepdims", False)
        if how:
            raise _mistake(f"{name}.reduce of recorded numbers takes no {', '.join(how)}", "Leave it out.")
        return _REDUCTIONS[own](inputs[0], axis, keepdims)
    if method == "accumulate" and own in (np.add, np.multiply, np.maximum, np.minimum) and not set(how) - {"axis"}:
        named = {np.add: "add", np.multiply: "multiply", np.maximum: "maximum", np.minimum: "minimum"}
        return _cumulated(named[own], inputs[0], how.get("axis", 0))
    if method == "outer" and own in _UFUNCS and len(inputs) == 2 and not how:
        a, b = (x if isinstance(x, Mask) else _number(x) for x in inputs)
        return _UFUNCS[own](a.reshape(a.shape + (1,) * b.ndim), b)
    call = name if method == "__call__" else f"{name}.{method}"
    raise _unknown(call)


def _into(own: Any, method: str, inputs: Sequence[Any], how: dict[str, Any], target: Any) -> Any:
    if not isinstance(target, _Recorded):
        raise _mistake(
            "this writes recorded numbers into a plain array",
            "Make the array by omnidrones.zeros(shape), or write a = a + b for a += b.",
        )
    result = ufunc(own, method, inputs, how)
    if result.shape != target.shape:
        raise ValueError(f"a result of shape {result.shape} does not fit the array of shape {target.shape} for it")
    target[...] = result
    return target


def _unknown(name: str) -> Exception:
    able = sorted({f.__name__ for f in _UFUNCS} | {_name(f).removeprefix("np.") for f in _FUNCTIONS})
    return _mistake(f"{name} is not known to recorded numbers", f"These are: {', '.join(able)}. Write it by them.")


def _name(function: Any) -> str:
    module = str(getattr(function, "__module__", "numpy"))
    inner = "linalg." if module.startswith("numpy.linalg") else ""
    return f"np.{inner}{function.__name__}"


def function(own: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """What `Number.__array_function__` does."""
    handler = _FUNCTIONS.get(own)
    if handler is None:
        raise _unknown(_name(own))
    try:
        inspect.signature(handler).bind(*args, **kwargs)
    except TypeError as error:
        raise _mistake(f"{_name(own)} of recorded numbers: {error}", "Leave out what only plain arrays need.") from None
    _check_size((*args, *kwargs.values()))
    return handler(*args, **kwargs)


def _check_size(value: Any) -> None:
    """Refuses what only pretends to be so large: shapes are NumPy's own, and some of its functions would write all of it."""
    if isinstance(value, _Recorded):
        _few(value.size)
    elif isinstance(value, (list, tuple)):
        for own in value:
            _check_size(own)


def _either(value: Any) -> Any:
    """Truths if all that is given are, else numbers."""
    if isinstance(value, _Recorded):
        return value
    if isinstance(value, (list, tuple)):
        return _number(value) if not _all_truths(value) else _mask(value)
    return _mask(value) if np.asarray(value).dtype == bool else _number(value)


def _all_truths(value: Any) -> bool:
    if isinstance(value, _Recorded):
        return isinstance(value, Mask)
    if isinstance(value, (list, tuple)):
        return bool(value) and all(map(_all_truths, value))
    return bool(np.asarray(value).dtype == bool)


def _together(arrays: Any) -> tuple[type[_Recorded], list[Any]]:
    """Arrays that are joined: all of one kind, and their places."""
    if isinstance(arrays, _Recorded):
        arrays = list(arrays)
    given = list(arrays)
    kind: type[_Recorded] = Mask if given and all(map(_all_truths, given)) else Number
    return kind, [kind._from(own)._places for own in given]


def _stacked(arrays: Sequence[Any]) -> Number:
    own = np.broadcast_arrays(*(_number(x)._places for x in arrays))
    return Number._at(np.stack(own, -1))


def _wrapped(kind: type[_Recorded], result: Any) -> Any:
    if isinstance(result, (list, tuple)):
        return type(result)(_wrapped(kind, own) for own in result)
    return kind._at(result)


def _by_shape(own: Callable[..., Any]) -> Callable[..., Any]:
    """A function that moves numbers and computes none."""

    def handler(*args: Any, **kwargs: Any) -> Any:
        if args:
            first, args = args[0], args[1:]
        else:
            first = kwargs.pop(next(iter(kwargs)))
        _check_index(list(args) + list(kwargs.values()))
        if kwargs.get("out") is not None:
            raise _mistake(f"{_name(own)} of recorded numbers takes no out", "Assign into a slice: out[...] = result.")
        value = _either(first)
        return _wrapped(type(value), own(value._places, *args, **kwargs))

    return handler


def _by_join(own: Callable[..., Any]) -> Callable[..., Any]:
    def handler(arrays: Any, *args: Any, **kwargs: Any) -> Any:
        kind, places = _together(arrays)
        if set(kwargs) - {"axis"}:
            raise _mistake(f"{_name(own)} of recorded numbers takes no {', '.join(kwargs)}", "Leave it out.")
        _check_index(list(args) + list(kwargs.values()))
        return kind._at(own(places, *args, **kwargs))

    return handler


def _append(arr: Any, values: Any, axis: Any = None) -> Any:
    kind, (a, b) = _together([arr, values])
    return kind._at(np.append(a, b, axis))


def _broadcast_arrays(*arrays: Any) -> Any:
    return tuple(own._at(places) for own, places in zip(*_each(arrays), strict=True))


def _each(arrays: Any) -> tuple[list[Any], list[Any]]:
    own = [_either(x) for x in arrays]
    return own, list(np.broadcast_arrays(*(x._places for x in own)))


def _atleast(own: Callable[..., Any]) -> Callable[..., Any]:
    def handler(*arrays: Any) -> Any:
        given = [_either(x) for x in arrays]
        results = tuple(x._at(own(x._places)) for x in given)
        return results[0] if len(results) == 1 else results

    return handler


def _choose(condition: Any, x: Any = None, y: Any = None) -> Any:
    if x is None or y is None:
        raise _mistake("where a mask holds is known only when the recording runs", "Write np.where(mask, a, b).")
    if _all_truths(x) and _all_truths(y):
        x, y = _mask(x), _mask(y)
    if isinstance(condition, _Recorded) or _is_recorded(condition):
        return _where(condition, x, y)
    kind: Any = Mask if isinstance(x, Mask) and isinstance(y, Mask) else Number
    return kind._at(np.where(np.asarray(condition), kind._from(x)._places, kind._from(y)._places))


def _select(condlist: Any, choicelist: Any, default: Any = 0) -> Any:
    if len(condlist) != len(choicelist) or not len(condlist):
        raise ValueError("np.select takes as many masks as choices, at least one")
    result = default
    for mask, choice in reversed(list(zip(condlist, choicelist, strict=True))):
        result = _choose(mask, choice, result)
    return result


def _like(value: float | None) -> Callable[..., Any]:
    def handler(a: Any, dtype: Any = None, order: Any = "K", subok: bool = True, shape: Any = None) -> Any:
        _only_float(dtype)
        own = zeros(_number(a).shape if shape is None else shape)
        if value:
            own[...] = value
        return own

    return handler


def _full_like(
    a: Any, fill_value: Any, dtype: Any = None, order: Any = "K", subok: bool = True, shape: Any = None
) -> Any:
    _only_float(dtype)
    own = zeros(np.shape(a) if shape is None else shape)
    own[...] = fill_value
    return own


def _only_float(dtype: Any) -> None:
    if dtype is not None and np.dtype(dtype).kind != "f":
        raise _mistake(f"recorded numbers are float, not {np.dtype(dtype)}", "Leave dtype out.")


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Number:
    own = _number(x)
    axes = tuple(range(own.ndim)) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    if ord not in (None, 2) and not (ord == "fro" and len(axes) == 2) or (ord == 2 and len(axes) == 2):
        raise _mistake(
            f"np.linalg.norm of order {ord}",
            "Leave it out; |x| summed is np.sum(np.abs(x)), the largest np.max(np.abs(x)).",
        )
    return _fold("norm", own, axes, keepdims)


def _outer(a: Any, b: Any) -> Number:
    return _number(a).ravel()[:, None] * _number(b).ravel()[None, :]


def _inner(a: Any, b: Any) -> Number:
    x, y = _number(a), _number(b)
    if x.ndim == 0 or y.ndim == 0:
        return x * y
    if x.shape[-1] != y.shape[-1]:
        raise ValueError(f"np.inner of shapes {x.shape} and {y.shape}: their last axes differ")
    return _dots(x._places.reshape(x.shape[:-1] + (1,) * (y.ndim - 1) + x.shape[-1:]), y._places)


def _vdot(a: Any, b: Any) -> Number:
    return _inner(_number(a).ravel(), _number(b).ravel())


def _cross(a: Any, b: Any, axisa: int = -1, axisb: int = -1, axisc: int = -1, axis: Any = None) -> Number:
    if axis is not None:
        axisa = axisb = axisc = axis
    x, y = (np.moveaxis(_number(v)._places, k, -1) for v, k in ((a, axisa), (b, axisb)))
    own = _vectors("cross", [Number._at(x), Number._at(y)], [(3,), (3,)], (3,))
    return Number._at(np.moveaxis(own._places, -1, axisc))


def _diag(v: Any, k: int = 0) -> Any:
    own = _number(v)
    _check_index(k)
    if own.ndim != 1:
        return Number._at(np.diag(own._places, k))
    n = len(own) + abs(k)
    matrix = zeros((n, n))
    at = np.arange(len(own))
    matrix[at + max(0, -k), at + max(0, k)] = own
    return matrix


def _triangle(own: Callable[..., Any]) -> Callable[..., Any]:
    def handler(m: Any, k: int = 0) -> Number:
        x = _number(m)
        return Number._at(np.where(own(np.ones(x.shape, bool), k), x._places, _constants(np.zeros(()))))

    return handler


def _trace(a: Any, offset: int = 0, axis1: int = 0, axis2: int = 1) -> Number:
    return _fold("sum", _number(a).diagonal(offset, axis1, axis2), -1)


def _diff(a: Any, n: int = 1, axis: int = -1) -> Number:
    own = Number._at(np.moveaxis(_number(a)._places, axis, -1))
    for _ in range(n):
        own = own[..., 1:] - own[..., :-1]
    return Number._at(np.moveaxis(own._places, -1, axis))


def _einsum(subscripts: Any, *operands: Any) -> Number:
    """Of one or two operands."""
    if not isinstance(subscripts, str) or "." in subscripts or len(operands) not in (1, 2):
        raise _mistake(
            "np.einsum of recorded numbers takes one or two operands, and letters", "Write it in parts, or by @."
        )
    given, arrow, result = subscripts.replace(" ", "").partition("->")
    letters = given.split(",")
    if not arrow:
        every = "".join(letters)
        result = "".join(sorted(c for c in set(every) if every.count(c) == 1))
    own = [_number(x)._places for x in operands]
    # NumPy's own says what is wrong with the letters or the shapes
    np.einsum(f"{given}->{result}", *(np.broadcast_to(np.float64(0.0), x.shape) for x in own))
    parts = []
    for word, places in zip(letters, own, strict=True):
        single = "".join(dict.fromkeys(word))
        parts.append((single, np.einsum(f"{word}->{single}", places) if single != word else places))
    summed = [c for c in dict.fromkeys("".join(letters)) if c not in result]
    axes = [*result, *summed]
    length: dict[str, int] = {}
    for word, places in parts:
        for c, n in zip(word, places.shape, strict=True):
            length[c] = n if length.get(c, 1) == 1 else length[c]
    aligned = []
    for word, places in parts:
        order = [word.index(c) for c in axes if c in word]
        at = tuple(slice(None) if c in word else None for c in axes)
        aligned.append(np.broadcast_to(places.transpose(order)[at], [length[c] for c in axes]))
    front = tuple(length[c] for c in result)
    n = int(np.prod([length[c] for c in summed], dtype=np.int64))
    if len(aligned) == 1:
        flat = Number._at(aligned[0])
        return _fold("sum", flat, tuple(range(len(front), flat.ndim))) if summed else flat.copy()
    if not summed:
        return _on("multiply", *map(Number._at, aligned))
    _few(2 * aligned[0].size)
    return _dots(*(x.reshape((*front, n)) for x in aligned))


def _folds(name: str) -> Callable[..., Any]:
    def handler(a: Any, axis: Any = None, *, keepdims: bool = False) -> Any:
        return _fold(name, a, axis, keepdims)

    return handler


def _truth_folds(name: str) -> Callable[..., Any]:
    def handler(a: Any, axis: Any = None, *, keepdims: bool = False) -> Any:
        return _fold_truths(name, a, axis, keepdims)

    return handler


def _mean_of(a: Any, axis: Any = None, *, keepdims: bool = False) -> Number:
    return _mean(a, axis, keepdims)


def _variance(a: Any, axis: Any = None, *, keepdims: bool = False) -> Number:
    own = _number(a)
    return _mean(_on("square", own - _mean(own, axis, True)), axis, keepdims)


def _clip_of(a: Any, a_min: Any = None, a_max: Any = None, *, min: Any = None, max: Any = None) -> Any:
    low, high = (a_min if min is None else min), (a_max if max is None else max)
    return _clip(a, low, high)


def _known(own: Callable[..., Any]) -> Callable[..., Any]:
    """What shapes tell."""

    def handler(a: Any, *args: Any) -> Any:
        return own(_number(a)._places, *args)

    return handler


def _of_dtype(*_: Any, **__: Any) -> Any:
    return np.dtype(np.float64)


def _copy_into(dst: Any, src: Any, casting: str = "same_kind") -> None:
    if not isinstance(dst, _Recorded):
        raise _mistake("this writes recorded numbers into a plain array", "Make the array by omnidrones.zeros(shape).")
    dst[...] = src


_SHAPES = (
    "reshape ravel transpose moveaxis swapaxes rollaxis expand_dims squeeze broadcast_to flip flipud fliplr rot90 roll repeat "
    "tile take take_along_axis diagonal split array_split hsplit vsplit dsplit copy delete resize unstack matrix_transpose permute_dims"
)
_JOINS = "stack concatenate concat hstack vstack dstack column_stack"


def _named(names: str) -> list[Any]:
    """Those of this version."""
    return [getattr(np, name) for name in names.split() if hasattr(np, name)]


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    **{own: _by_shape(own) for own in _named(_SHAPES)},
    **{own: _by_join(own) for own in _named(_JOINS)},
    **{own: _atleast(own) for own in (np.atleast_1d, np.atleast_2d, np.atleast_3d)},
    **{own: _known(own) for own in (np.shape, np.ndim, np.size)},
    np.append: _append,
    np.broadcast_arrays: _broadcast_arrays,
    np.where: _choose,
    np.select: _select,
    np.clip: _clip_of,
    np.zeros_like: _like(None),
    np.empty_like: _like(None),
    np.ones_like: _like(1.0),
    np.full_like: _full_like,
    np.linalg.norm: _norm,
    np.dot: _dot,
    np.vdot: _vdot,
    np.inner: _inner,
    np.outer: _outer,
    np.cross: _cross,
    np.trace: _trace,
    np.diag: _diag,
    np.tril: _triangle(np.tril),
    np.triu: _triangle(np.triu),
    np.diff: _diff,
    np.einsum: _einsum,
    np.sum: _folds("sum"),
    np.prod: _folds("product"),
    np.max: _folds("largest"),
    np.min: _folds("smallest"),
    np.amax: _folds("largest"),
    np.amin: _folds("smallest"),
    np.any: _truth_folds("any"),
    np.all: _truth_folds("all"),
    np.mean: _mean_of,
    np.var: _variance,
    np.cumsum: lambda a, axis=None: _cumulated("add", a, axis),
    np.cumprod: lambda a, axis=None: _cumulated("multiply", a, axis),
    np.copyto: _copy_into,
    np.result_type: _of_dtype,
    np.iscomplexobj: lambda x: False,
    np.isrealobj: lambda x: True,
}
