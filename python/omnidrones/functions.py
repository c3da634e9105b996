"""Functions of numbers, recorded or plain: roots and angles that stay finite, rotations, shapes of rewards.

Each is the library's own, so that a task written in Python has the bits of one written in Rust. All take `Number`, plain numbers, arrays
and lists; with plain ones alone they give plain results, so that a formula can be tried at once. Axes in front are kept, as with NumPy's
functions: `rotate(q, v)` of [..., 4] and [..., 3] is [..., 3].

Quaternions are [w, x, y, z], Hamilton, body to world. Angles are in rad.

>>> omnidrones.functions.rotate([1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3])
array([0.1, 0.2, 0.3])
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ._number import _is_recorded, _mistake, _number, _plain, _vectors
from ._numpy import _stacked

__all__ = [
    "assign",
    "conjugate",
    "detach",
    "exponential_kernel",
    "from_euler",
    "from_rotation_matrix",
    "from_rotation_vector",
    "heading_axis",
    "multiply_add",
    "multiply_quaternions",
    "norm",
    "normalise",
    "observed_attitude",
    "pseudo_huber",
    "quaternion_rate",
    "rational_kernel",
    "rotate",
    "rotate_back",
    "rotation_matrix",
    "safe_arccos",
    "safe_arcsin",
    "safe_arctan2",
    "safe_divide",
    "safe_sinc",
    "safe_sqrt",
    "smooth_norm",
    "squared_norm",
    "still",
    "take",
    "to_euler",
    "unit_quaternion",
    "up_axis",
    "upright",
    "yaw",
]

_ONE: tuple[int, ...] = ()
_ANY = (-1,)
_VECTOR = (3,)
_QUATERNION = (4,)
_MATRIX = (3, 3)


def _array(value: Any) -> Any:
    return _number(value) if _is_recorded(value) else _plain(value)


def _setting(name: str, value: float) -> float:
    if _is_recorded(value):
        raise _mistake(f"{name} is a recorded number", "Give a plain number.")
    own = float(value)
    if not (0.0 < own < float("inf")):
        raise ValueError(f"{name} is {value}, but it must be positive and finite.")
    return own


# guarded


def safe_sqrt(x: Any, floor: float = 1e-18) -> Any:
    """Root of max(x, floor): below the floor a constant, so that its derivative is 0 there and not infinite."""
    return _vectors("safe_sqrt", [x], [_ONE], _ONE, [_setting("floor", floor)])


def safe_arctan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y), value and derivative 0 closer than 1e-9 to the origin."""
    return _vectors("safe_arctan2", [y, x], [_ONE, _ONE], _ONE)


def safe_arccos(x: Any) -> Any:
    """Arccos of x held within [-1, 1]; derivative 0 within 1e-12 of either end. `np.arccos` of recorded numbers is this one."""
    return _vectors("safe_arccos", [x], [_ONE], _ONE)


def safe_arcsin(x: Any) -> Any:
    """Arcsin of x held within [-1, 1]; derivative 0 within 1e-12 of either end. `np.arcsin` of recorded numbers is this one."""
    return _vectors("safe_arcsin", [x], [_ONE], _ONE)


def safe_divide(a: Any, b: Any, floor: float) -> Any:
    """a / b with |b| held at `floor` or more, its sign kept."""
    return _vectors("safe_divide", [a, b], [_ONE, _ONE], _ONE, [_setting("floor", floor)])


def safe_sinc(x: Any) -> Any:
    """sin(x) / x, smooth through 0. Not that of NumPy, which has pi in it."""
    return _vectors("safe_sinc", [x], [_ONE], _ONE)


def norm(v: Any) -> Any:
    """Length of vectors [..., n], held at 1e-9 or more: derivative 0 below. `np.linalg.norm` of recorded numbers is this one."""
    return _vectors("norm", [v], [_ANY], _ONE)


def squared_norm(v: Any) -> Any:
    """Square of the length of vectors [..., n]."""
    return _vectors("squared_norm", [v], [_ANY], _ONE)


def normalise(v: Any) -> Any:
    """v / max(|v|, 1e-9) of vectors [..., n]: zero stays zero."""
    return _vectors("normalise", [v], [_ANY], _ANY)


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """a b + c, in one rounding where the machine has it."""
    return _vectors("multiply_add", [a, b, c], [_ONE, _ONE, _ONE], _ONE)


def assign(costs: Any) -> Any:
    """Which column each row takes such that the sum of the costs [n, n] is least, [n]; n is 32 at most. Derivatives are 0.

    Slow where many environments run it in every step: a place for it is a start on the host (`start_on_host`).
    """
    own = _array(costs)
    if own.ndim != 2 or own.shape[0] != own.shape[1] or not 1 <= len(own) <= 32:
        raise ValueError(f"assign takes costs of shape [n, n] with n from 1 to 32, not {list(own.shape)}.")
    return _vectors("assign", [own.reshape(-1)], [_ANY], (len(own),))


def take(table: Any, index: Any) -> Any:
    """Row `index` of a table [n, ...]: the nearest to a number that may be recorded, the first or last where there is none. [...] of
    indices give [..., ...].
    """
    rows, k = _array(table), _array(index)
    if rows.ndim == 0 or len(rows) == 0:
        raise ValueError("take takes a table with rows.")
    shape = k.shape + rows.shape[1:]
    columns = rows.reshape(len(rows), -1).T
    columns = np.broadcast_to(columns, k.shape + columns.shape)
    k = np.broadcast_to(k.reshape((*k.shape, 1, 1)), (*columns.shape[:-1], 1))
    return _vectors("take", [k, columns], [(1,), _ANY], _ONE).reshape(shape)[()]


def detach(x: Any) -> Any:
    """The same value with derivative 0."""
    return _vectors("detach", [x], [_ONE], _ONE)


# rotations


def rotate(q: Any, v: Any) -> Any:
    """Body to world: R(q) v."""
    return _vectors("rotate", [q, v], [_QUATERNION, _VECTOR], _VECTOR)


def rotate_back(q: Any, v: Any) -> Any:
    """World to body: the transpose of R(q) times v."""
    return _vectors("rotate_back", [q, v], [_QUATERNION, _VECTOR], _VECTOR)


def multiply_quaternions(a: Any, b: Any) -> Any:
    """First b, then a."""
    return _vectors("multiply_quaternions", [a, b], [_QUATERNION, _QUATERNION], _QUATERNION)


def conjugate(q: Any) -> Any:
    """The opposite rotation of a unit quaternion."""
    return _vectors("conjugate", [q], [_QUATERNION], _QUATERNION)


def unit_quaternion(q: Any) -> Any:
    """q / |q|, the squared norm held at 1e-12 or more."""
    return _vectors("unit_quaternion", [q], [_QUATERNION], _QUATERNION)


def observed_attitude(q: Any) -> Any:
    """q or -q, whichever has w >= 0: both are one attitude."""
    return _vectors("observed_attitude", [q], [_QUATERNION], _QUATERNION)


def quaternion_rate(q: Any, angular_velocity: Any) -> Any:
    """dq/dt of an angular velocity in the body frame, rad/s."""
    return _vectors("quaternion_rate", [q, angular_velocity], [_QUATERNION, _VECTOR], _QUATERNION)


def rotation_matrix(q: Any) -> Any:
    """R(q), [..., 3, 3]: its columns are the body axes in the world."""
    return _vectors("rotation_matrix", [q], [_QUATERNION], _MATRIX)


def from_rotation_matrix(matrix: Any) -> Any:
    """The quaternion of a rotation matrix [..., 3, 3], w >= 0."""
    return _vectors("from_rotation_matrix", [matrix], [_MATRIX], _QUATERNION)


def from_rotation_vector(v: Any) -> Any:
    """The quaternion of a rotation vector (axis times angle), smooth through zero."""
    return _vectors("from_rotation_vector", [v], [_VECTOR], _QUATERNION)


def from_euler(roll: Any, pitch: Any, yaw: Any) -> Any:
    """The quaternion of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    angles = [roll, pitch, yaw]
    together = _stacked(angles) if _is_recorded(angles) else np.stack(np.broadcast_arrays(*map(_plain, angles)), -1)
    return _vectors("from_euler", [together], [_VECTOR], _QUATERNION)


def to_euler(q: Any) -> Any:
    """(roll, pitch, yaw) of R = Rz(yaw) Ry(pitch) Rx(roll), [..., 3]; to be looked at, not for control."""
    return _vectors("to_euler", [q], [_QUATERNION], _VECTOR)


def up_axis(q: Any) -> Any:
    """Body z in the world."""
    return _vectors("up_axis", [q], [_QUATERNION], _VECTOR)


def heading_axis(q: Any) -> Any:
    """Body x in the world."""
    return _vectors("heading_axis", [q], [_QUATERNION], _VECTOR)


def yaw(q: Any) -> Any:
    """Angle of body x in the world's xy plane, in (-pi, pi]; 0 where it is vertical."""
    return _vectors("yaw", [q], [_QUATERNION], _ONE)


# rewards


def rational_kernel(a: float, squared: Any) -> Any:
    """1 / (1 + a^2 squared), of the square of a norm: smooth, also at zero."""
    return _vectors("rational_kernel", [squared], [_ONE], _ONE, [_setting("a", a)])


def exponential_kernel(a: float, v: Any) -> Any:
    """exp(-a |v|) of vectors [..., n]: a tip at zero."""
    return _vectors("exponential_kernel", [v], [_ANY], _ONE, [_setting("a", a)])


def upright(up: Any) -> Any:
    """((u_z + 1) / 2)^2 of `up_axis(q)`: 1 upright, 0 upside down."""
    return _vectors("upright", [up], [_VECTOR], _ONE)


def still(angular_velocity: Any) -> Any:
    """1 / (1 + w_z^2), angular velocity in world axes, rad/s."""
    return _vectors("still", [angular_velocity], [_VECTOR], _ONE)


def smooth_norm(v: Any, delta: float) -> Any:
    """Root of |v|^2 + delta^2 of vectors [..., n]: a norm without a tip, for training losses."""
    return _vectors("smooth_norm", [v], [_ANY], _ONE, [_setting("delta", delta)])


def pseudo_huber(v: Any, c: float) -> Any:
    """|v|^2 near zero and 2 c |v| far away, smooth, of vectors [..., n]."""
    return _vectors("pseudo_huber", [v], [_ANY], _ONE, [_setting("c", c)])
