"""Numbers that record: what NumPy says of plain ones, what Rust says of the library's functions, and every mistake with its line."""

import copy
import math
import pickle
import threading
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import omnidrones
from omnidrones import Mask, Number, RecordingError, functions

SIZE = 96


def run(f, *inputs):
    """What a recorded function of arrays comes to, with the shape and kind that it had while it was recorded."""
    inputs = [np.asarray(x, np.float64) for x in inputs]
    seen = {}

    def step(x, u):
        parts, at = [], 0
        for given_ in inputs:
            parts.append(u[at : at + given_.size].reshape(given_.shape))
            at += given_.size
        y = f(*parts)
        assert isinstance(y, (Number, Mask)), type(y)
        seen["shape"], seen["kind"] = y.shape, type(y)
        out = omnidrones.zeros(SIZE)
        out[: y.size] = y.ravel()
        return out

    system = omnidrones.System.of(step, states=SIZE, inputs=sum(x.size for x in inputs))
    flat = np.concatenate([x.ravel() for x in inputs])
    value = system.trajectory(np.zeros(SIZE), flat[None])[1]
    result = value[: int(np.prod(seen["shape"]))].reshape(seen["shape"])
    return result.astype(bool) if seen["kind"] is Mask else result


def agrees(f, *inputs, plain=None):
    wanted = (plain or f)(*(np.asarray(x, np.float64) for x in inputs))
    got = run(f, *inputs)
    assert got.shape == np.shape(wanted)
    assert got.dtype == np.asarray(wanted).dtype or got.dtype == np.float64
    np.testing.assert_allclose(got.astype(np.float64), np.asarray(wanted, np.float64), rtol=1e-13, atol=1e-14)


def within(f, n=3):
    """Calls f(x) while something is recorded, and gives back what it returned."""
    seen = []

    def step(x, u):
        seen.append(f(x))
        return x

    omnidrones.System.of(step, states=n)
    return seen[0]


UNARY = [
    np.sin, np.cos, np.tan, np.exp, np.tanh, np.square, np.abs, np.absolute, np.fabs, np.negative, np.positive, np.sign, np.reciprocal,
    np.arctan, np.deg2rad, np.radians, np.rad2deg, np.degrees, abs, lambda x: -x, lambda x: +x,
    lambda x: np.sqrt(np.abs(x)), lambda x: np.log(np.abs(x)), lambda x: np.arccos(np.tanh(x)), lambda x: np.arcsin(np.tanh(x)),
]  # fmt: skip


@pytest.mark.parametrize("f", UNARY)
@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3)])
def test_functions_of_one_number_are_those_of_numpy(f, shape, rng):
    agrees(f, rng.normal(size=shape))


BINARY = [
    np.add, np.subtract, np.multiply, np.divide, np.true_divide, np.maximum, np.minimum, np.fmax, np.fmin, np.arctan2, np.hypot,
    lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: np.where(a < b, a, 2.0),
    lambda a, b: a < b, lambda a, b: a > b, lambda a, b: a <= b, lambda a, b: a >= b,
    np.less, np.greater, np.less_equal, np.greater_equal,
]  # fmt: skip


@pytest.mark.parametrize("f", BINARY)
def test_functions_of_two_numbers_broadcast_and_mix_with_plain_ones(f, rng):
    a, b, c = rng.normal(size=(2, 3)), rng.normal(size=3), rng.normal(size=(2, 1))
    for x, y in [(a, b), (b, a), (c, b), (a, rng.normal())]:
        agrees(f, x, y)
        agrees(lambda x, y=y: f(x, y), x)
        agrees(lambda y, x=x: f(x, y), y)
    for plain in (2, 2.5, np.float32(1.5), np.int64(3), True, [1.0, 2.0, 3.0], (1, 2, 3), np.arange(1, 4), np.array([True, True, True])):
        if not isinstance(plain, (list, tuple)) or f in (np.add, np.hypot):
            agrees(lambda x, plain=plain: f(x, plain), b, plain=lambda x, plain=plain: f(x, np.asarray(plain, np.float64)))
            if not (f is np.divide or f is np.true_divide):
                agrees(lambda x, plain=plain: f(plain, x), b, plain=lambda x, plain=plain: f(np.asarray(plain, np.float64), x))


@pytest.mark.parametrize("exponent", [0, 1, 2, 3, 4, 5, 7, 10, -1, -2, -3, 0.5, -0.5, 2.0, np.float64(3)])
def test_powers_are_products_roots_and_their_reciprocals(exponent, rng):
    agrees(lambda x: x**exponent, rng.uniform(0.5, 2, 3))
    agrees(lambda x: np.power(x, exponent), rng.uniform(0.5, 2, (2, 2)))
    if float(exponent).is_integer():
        agrees(lambda x: x**exponent, -rng.uniform(0.5, 2, 3), plain=lambda x: x ** float(exponent))


def test_powers_go_by_arrays_of_exponents(rng):
    agrees(lambda x: x ** np.array([0.0, 2.0, -1.0]), rng.uniform(0.5, 2, (2, 3)))


REDUCTIONS = [
    (np.sum, (2, 3)), (np.prod, (2, 3)), (np.mean, (2, 3)), (np.max, (2, 3)), (np.min, (2, 3)), (np.amax, (2, 3)), (np.var, (2, 3)),
    (lambda x, **how: x.sum(**how), (2, 3)), (lambda x, **how: x.mean(**how), (2, 3)), (lambda x, **how: x.max(**how), (2, 3)),
    (lambda x, **how: x.min(**how), (2, 3)), (lambda x, **how: x.prod(**how), (2, 3)), (np.linalg.norm, (2, 3)),
    (np.add.reduce, (2, 3)), (np.multiply.reduce, (2, 3)), (np.maximum.reduce, (2, 3)), (np.minimum.reduce, (2, 3)),
    (lambda x, **how: np.any(x > 0, **how), (2, 3)), (lambda x, **how: np.all(x > 0, **how), (2, 3)),
    (lambda x, **how: (x > 0).any(**how), (2, 3)), (lambda x, **how: (x > 0).all(**how), (2, 3)),
    (lambda x, **how: np.logical_and.reduce(x > 0, **how), (2, 3)), (lambda x, **how: np.logical_or.reduce(x > 0, **how), (2, 3)),
    (lambda x, **how: np.sum(x > 0, **how), (2, 3)), (lambda x, **how: np.mean(x > 0, **how), (2, 3)),
]  # fmt: skip


@pytest.mark.parametrize(("f", "shape"), REDUCTIONS)
def test_reductions_are_those_of_numpy_over_any_axes(f, shape, rng):
    x = rng.normal(size=shape)
    agrees(f, x)
    for axis in (0, 1, -1, (0, 1)):
        for keepdims in (False, True):
            agrees(lambda x, axis=axis, keepdims=keepdims: f(x, axis=axis, keepdims=keepdims), x)
    with pytest.raises(np.exceptions.AxisError):
        run(lambda x: f(x, axis=2), x)


PRODUCTS = [
    (lambda a, b: a @ b, (3,), (3,)), (lambda a, b: a @ b, (2, 3), (3,)), (lambda a, b: a @ b, (3,), (3, 2)),
    (lambda a, b: a @ b, (2, 3), (3, 4)), (lambda a, b: a @ b, (2, 2, 3), (3, 2)), (lambda a, b: a @ b, (2, 1, 3), (2, 3, 2)),
    (lambda a, b: a @ b, (3,), (2, 3, 2)), (np.matmul, (2, 3), (3, 2)),
    (np.dot, (3,), (3,)), (np.dot, (2, 3), (3,)), (np.dot, (2, 3), (3, 2)), (np.dot, (), (3,)), (np.inner, (3,), (3,)),
    (np.inner, (2, 3), (4, 3)), (np.vdot, (2, 3), (2, 3)), (np.outer, (2,), (3,)), (np.outer, (2, 2), (3,)), (np.cross, (3,), (3,)),
    (np.cross, (2, 3), (3,)), (np.multiply.outer, (2,), (2, 2)), (np.subtract.outer, (2,), (3,)),
    (lambda a, b: np.cross(a, b, axis=0), (3, 2), (3, 2)),
    (lambda a, b: np.einsum("ij,j->i", a, b), (2, 3), (3,)), (lambda a, b: np.einsum("ij,jk", a, b), (2, 3), (3, 2)),
    (lambda a, b: np.einsum("ij,kj->ik", a, b), (2, 3), (4, 3)), (lambda a, b: np.einsum("ij,ij", a, b), (2, 3), (2, 3)),
    (lambda a, b: np.einsum("i,j->ij", a, b), (2,), (3,)), (lambda a, b: np.einsum("ii,i->i", a, b), (3, 3), (3,)),
    (lambda a, b: np.einsum("kij,kj->ki", a, b), (2, 3, 3), (2, 3)), (lambda a, b: np.einsum("ij,k->k", a, b), (2, 3), (3,)),
    (lambda a, b: np.einsum("ij->ji", a) + np.einsum("i->", b), (2, 3), (3,)), (lambda a, b: np.einsum("ii", a) * b, (3, 3), (3,)),
]  # fmt: skip


@pytest.mark.parametrize(("f", "left", "right"), PRODUCTS)
def test_products_are_those_of_numpy(f, left, right, rng):
    a, b = rng.normal(size=left), rng.normal(size=right)
    agrees(f, a, b)
    agrees(lambda a: f(a, b), a)
    agrees(lambda b: f(a, b), b)


JOINS = [
    lambda a, b: np.stack([a, b]), lambda a, b: np.stack([a, b], axis=-1), lambda a, b: np.concatenate([a, b]),
    lambda a, b: np.concatenate([a, b[:1]], axis=0), lambda a, b: np.concatenate((a, [1.0, 2.0])), lambda a, b: np.hstack([a, b]),
    lambda a, b: np.vstack([a, b, [0, 1, 2]]), lambda a, b: np.column_stack([a, b]), lambda a, b: np.dstack([a, b]),
    lambda a, b: np.append(a, 3.0), lambda a, b: np.append(a, b), lambda a, b: np.stack([a[0], 1.0, b[2]]),
    lambda a, b: np.stack(np.broadcast_arrays(a, b[0])), lambda a, b: np.stack([a < b, b < a]), lambda a, b: np.stack([a < b, [True, False, True]]),
    lambda a, b: np.concatenate([np.atleast_1d(a[0]), b]), lambda a, b: np.stack(np.atleast_1d(a, b)),
]  # fmt: skip


@pytest.mark.parametrize("f", JOINS)
def test_joins_are_those_of_numpy(f, rng):
    agrees(f, rng.normal(size=3), rng.normal(size=3))


SHAPES = [
    np.ravel, np.transpose, np.squeeze, np.flip, np.flipud, np.fliplr, np.rot90, np.copy, np.atleast_1d, np.atleast_2d, np.atleast_3d,
    np.diag, np.diagonal, np.trace, np.tril, np.triu, np.diff, np.cumsum, np.cumprod, np.zeros_like, np.ones_like,
    lambda x: x.T, lambda x: x.reshape(-1), lambda x: x.reshape(1, -1), lambda x: x.reshape((-1, 1)), lambda x: x.ravel(), lambda x: x.flatten(),
    lambda x: x.transpose(1, 0), lambda x: x.swapaxes(0, 1), lambda x: x.copy(), lambda x: x.cumsum(), lambda x: x.cumsum(axis=1),
    lambda x: np.reshape(x, (-1,)), lambda x: np.moveaxis(x, 0, 1), lambda x: np.swapaxes(x, 0, 1), lambda x: np.expand_dims(x, 1),
    lambda x: np.broadcast_to(x, (2, *x.shape)), lambda x: np.roll(x, 1), lambda x: np.roll(x, -1, axis=1), lambda x: np.repeat(x, 2, axis=0),
    lambda x: np.repeat(x, 2), lambda x: x.repeat(2), lambda x: np.tile(x, (2, 1)), lambda x: np.take(x, [1, 0], axis=0), lambda x: x.take([1, 2]),
    lambda x: np.delete(x, 1, axis=1), lambda x: np.diag(x[0]), lambda x: np.diag(x[0], -1), lambda x: np.diff(x, axis=0), lambda x: np.diff(x, 2),
    lambda x: np.concatenate(np.split(x, [1], axis=1), axis=1), lambda x: np.stack(np.array_split(x, 2, axis=0)), lambda x: np.stack(np.hsplit(x, 3)),
    lambda x: np.full_like(x, 2.5), lambda x: np.full_like(x[:, 0], x[0, 1]) if isinstance(x, Number) else np.full(2, x[0, 1]),
    lambda x: np.cumsum(x, axis=0), lambda x: np.add.accumulate(x, axis=1), lambda x: np.stack([row.sum() for row in x]),
    lambda x: np.clip(x, -0.5, 0.5), lambda x: np.clip(x, None, 0.1), lambda x: np.clip(x, 0.0, None), lambda x: x.clip(-0.1, np.inf),
    lambda x: np.clip(x, x[0] * 0 - 0.3, 0.3), lambda x: np.select([x < -0.5, x < 0.5], [-1.0, x], 1.0), lambda x: np.select([x < 0], [x]),
    lambda x: np.where([[True], [False]], x, 0.0), lambda x: np.where(x[0] < 0, x, -x), lambda x: np.where(x < 0, 1, 2), lambda x: np.where(x < 0, x > -1, x > 1),
    lambda x: (x > 0) & (x < 1), lambda x: (x > 0) | (x < -1), lambda x: ~(x > 0), lambda x: (x > 0) ^ (x > 1), lambda x: (x > 0) & True,
    lambda x: np.array([True, False, True]) | (x > 0), lambda x: np.logical_and(x > 0, x < 1), lambda x: np.logical_or(x > 1, x < 0),
    lambda x: np.logical_not(x > 0), lambda x: np.logical_xor(x > 0, x > 1), lambda x: np.invert(x > 0), lambda x: (x > 0) * x,
    lambda x: (x > 0).astype(float) * 2, lambda x: x.astype(np.float64), lambda x: 1.0 - (x > 0), lambda x: x + np.ndim(x) + np.size(x) + np.shape(x)[1] + len(x),
    lambda x: sum(x), lambda x: sum(x[0]) * 2, lambda x: x.trace(), lambda x: x.dot(x.T), lambda x: x.squeeze(), lambda x: np.linalg.norm(x, axis=-1),
]  # fmt: skip


@pytest.mark.parametrize("f", SHAPES)
def test_shapes_and_choices_are_those_of_numpy(f, rng):
    agrees(f, rng.normal(size=(2, 3)))


INDICES = [
    0, -1, (0, 1), slice(1, None), (slice(None), 1), (slice(None), slice(None, None, -1)), ..., (..., 0), (0, ...), None, (None, 0), (..., None),
    (slice(None), None, 1), [1, 0], ([0, 1], [2, 0]), np.array([True, False]), (slice(None), np.array([True, False, True])),
    np.array([[True, False, True], [False, True, False]]), (np.array([[0], [1]]), np.array([0, 2])), (), np.int64(1), slice(0, 0), [], True,
]  # fmt: skip


@pytest.mark.parametrize("index", INDICES, ids=str)
def test_indices_are_those_of_numpy_to_read_and_to_write(index, rng):
    agrees(lambda x: x[index], rng.normal(size=(2, 3)))
    agrees(lambda x: (x > 0)[index], rng.normal(size=(2, 3)))

    def written(x, y):
        own = x.copy()
        own[index] = y
        own[index] += 1.0
        return own

    agrees(written, rng.normal(size=(2, 3)), rng.normal())


def test_slices_are_views_and_single_numbers_are_values(rng):
    def f(x):
        y = x.copy()
        first = y[0]
        first += 1.0
        row = y[1:]
        row *= 2.0
        row[0] = 7.0
        row -= x[1:] / 4
        row /= 2.0
        return np.stack([first, *y])

    agrees(f, rng.normal(size=4))


def test_masks_pick_where_numbers_are_written(rng):
    def f(x):
        y = x.copy()
        y[x < 0] = 0.0
        y[x > 1] = x[0]
        return y

    agrees(f, rng.normal(size=8) * 2)


def test_steps_are_those_of_numpy(rng):
    def f(x):
        return np.concatenate([np.floor(x), np.ceil(x), np.trunc(x), x // 2.0, 7.0 // x, x % 4.0, np.mod(x, -4.0), *divmod(x, 0.5)])

    agrees(f, rng.normal(size=8) * 5)
    assert run(lambda x: np.floor(x), [2.0, -0.5, 1e20]).tolist() == [2.0, -1.0, 1e20]


def test_rows_are_taken_by_recorded_numbers(rng):
    table = rng.normal(size=(4, 2, 3))
    take = functions.take
    indices = np.array([[0.0, 3.0], [1.2, -7.0]])
    wanted = table[[[0, 3], [1, 0]]]
    assert np.array_equal(take(table, indices), wanted) and np.array_equal(take(table, 9), table[3])
    assert np.array_equal(run(lambda x: take(table, x.reshape(2, 2)), indices.ravel()), wanted)
    assert np.array_equal(run(lambda x: take(x.reshape(4, 2, 3), 2.0), table.ravel()), table[2])
    with pytest.raises(ValueError, match="rows"):
        take(np.zeros((0, 2)), 1)


def test_an_assignment_costs_least():
    costs = np.array([[3.0, 1.0, 2.0], [1.0, 9.0, 9.0], [4.0, 4.0, 1.0]])
    assert functions.assign(costs).tolist() == [1.0, 0.0, 2.0]
    assert run(lambda x: functions.assign(x.reshape(3, 3)), costs.ravel()).tolist() == [1.0, 0.0, 2.0]
    for wrong in (np.zeros((2, 3)), np.zeros((33, 33)), np.zeros(4)):
        with pytest.raises(ValueError, match="assign takes costs"):
            functions.assign(wrong)


def test_arrays_of_constants_are_written_into():
    def f(x):
        own = omnidrones.zeros((2, 2))
        own[0, 0], own[1] = x[0], [x[1], 3.0]
        return own + omnidrones.array([[x[0], 1.0], [0.0, x[1]]])

    assert np.array_equal(run(f, [5.0, 6.0]), [[10.0, 1.0], [6.0, 9.0]])
    assert run(lambda x: omnidrones.array(np.arange(3)) * x, [2.0, 2.0, 2.0]).tolist() == [0.0, 2.0, 4.0]
    assert run(lambda x: omnidrones.array(x > 0) & True, [2.0, -2.0]).tolist() == [True, False]


def test_empty_arrays_are_those_of_numpy(rng):
    def f(x):
        empty = x[:0]
        assert (empty + 1.0).shape == (0,) and np.sin(empty).shape == (0,) and (empty < 1.0).shape == (0,)
        assert np.concatenate([empty, empty]).shape == (0,) and np.cumsum(empty).shape == (0,)
        for wrong in (np.max, np.min, np.mean):
            with pytest.raises(ValueError):
                wrong(empty)
        return np.stack([np.sum(empty), np.prod(empty), empty @ empty, np.sum(np.any(empty < 0)), np.sum(np.all(empty < 0))])

    assert run(f, rng.normal(size=3)).tolist() == [0.0, 1.0, 0.0, 0.0, 1.0]


def test_what_is_not_a_number_compares_as_the_class_says():
    nan_of = lambda x: np.sqrt(x)  # noqa: E731
    assert run(lambda x: np.stack([nan_of(x) <= 1.0, nan_of(x) >= 1.0, nan_of(x) < 1.0, nan_of(x) > 1.0]), -1.0).tolist() == [True, True, False, False]
    assert run(lambda x: np.maximum(1.0, nan_of(x)), -1.0) == 1.0


def test_shapes_are_asked_as_of_arrays():
    def f(x):
        y = x.reshape(2, 3)
        assert (y.shape, y.ndim, y.size, len(y), y.T.shape) == ((2, 3), 2, 6, 2, (3, 2))
        assert np.shape(y) == (2, 3) and np.ndim(y) == 2 and np.size(y) == 6 and np.iscomplexobj(y) is False
        assert [row.shape for row in y] == [(3,), (3,)] and [[v.shape for v in row] for row in y.tolist()] == [[()] * 3] * 2
        assert repr(y) == "Number([2, 3], recorded)" and f"{y[0, 0]}" == "Number(one, recorded)" and str(y > 0) == "Mask([2, 3], recorded)"
        with pytest.raises(TypeError):
            len(y[0, 0])
        with pytest.raises(TypeError):
            iter(y[0, 0])
        for wrong in (lambda: y[2], lambda: y[0, 0, 0], lambda: y[0.5]):
            with pytest.raises(IndexError):
                wrong()
        for wrong in (lambda: y.reshape(4), lambda: y + x[:2], lambda: y @ y, lambda: np.stack([x, y]), lambda: np.cross(x, x)):
            with pytest.raises(ValueError):
                wrong()
        assert copy.copy(y).shape == copy.deepcopy([y])[0].shape == (2, 3)
        first, second = y
        return first + second

    assert within(f, 6).shape == (3,)


def formula(q, v, w):
    """Every function of the library, in one row."""
    f = functions
    up = f.up_axis(q)
    return [
        f.safe_sqrt(v[0]), f.safe_sqrt(v[1], floor=0.5), f.safe_arctan2(v[0], v[1]), f.safe_arccos(v[2]), f.safe_arcsin(v[2]),
        f.safe_divide(v[0], v[1], 0.3), f.safe_sinc(v), f.norm(v), f.squared_norm(v), f.normalise(v), f.detach(v), f.rotate(q, v),
        f.rotate_back(q, v), f.multiply_quaternions(q, f.conjugate(q)), f.unit_quaternion(q), f.observed_attitude(q),
        f.quaternion_rate(q, w), f.rotation_matrix(q), f.from_rotation_matrix(f.rotation_matrix(q)), f.from_rotation_vector(v),
        f.from_euler(v[0], v[1], 0.3), f.to_euler(q), up, f.heading_axis(q), f.yaw(q), f.rational_kernel(1.5, f.squared_norm(v)),
        f.exponential_kernel(2.0, v), f.upright(up), f.still(w), f.smooth_norm(v, 0.1), f.pseudo_huber(w, 0.5),
        f.multiply_add(v, w, 1.0), f.assign(np.stack([v, w, v + w])), f.take(np.stack([v, w]), v[0]),
    ]  # fmt: skip


def test_functions_of_the_library_record_what_they_compute(rng):
    q = rng.normal(size=4)
    q, v, w = q / np.linalg.norm(q), rng.normal(size=3), rng.normal(size=3)
    plain = formula(q, v, w)
    assert all(isinstance(x, (np.ndarray, np.float64)) for x in plain)
    wanted = np.concatenate([np.ravel(x) for x in plain])
    got = run(lambda q, v, w: np.concatenate([x.ravel() for x in formula(q, v, w)]), q, v, w)
    assert got.tobytes() == wanted.tobytes()
    assert {name for name in dir(functions) if not name.startswith("_")} >= set(functions.__all__)
    used = {name for name in formula.__code__.co_names}
    assert used >= set(functions.__all__)


def test_functions_of_the_library_are_what_their_words_say(rng):
    f = functions
    q, v = f.unit_quaternion(rng.normal(size=4)), rng.normal(size=3)
    matrix = f.rotation_matrix(q)
    close = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)  # noqa: E731
    close(matrix @ matrix.T, np.eye(3))
    close(f.rotate(q, v), matrix @ v)
    close(f.rotate_back(q, v), matrix.T @ v)
    close(f.up_axis(q), matrix[:, 2])
    close(f.heading_axis(q), matrix[:, 0])
    close(f.yaw(q), np.arctan2(matrix[1, 0], matrix[0, 0]))
    close(f.from_euler(*f.to_euler(q)), np.sign((f.from_euler(*f.to_euler(q)) @ q)) * q)
    close(f.rotation_matrix(f.multiply_quaternions(q, q)), matrix @ matrix)
    close(f.from_rotation_matrix(matrix), f.observed_attitude(q))
    close(f.rotation_matrix(f.from_rotation_vector([0.0, 0.0, 0.3]))[:2, :2], [[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    close([f.rational_kernel(2.0, 0.25), f.exponential_kernel(2.0, [0.3, 0.4]), f.smooth_norm([3.0, 4.0], 12.0)], [0.5, np.exp(-1.0), 13.0])
    close([f.upright([0.0, 0.0, 1.0]), f.upright([0.0, 0.0, -1.0]), f.still([9.0, 9.0, 1.0])], [1.0, 0.0, 0.5])
    close(f.pseudo_huber([1e-4], 1.0), 1e-8)
    assert f.norm([0.0, 0.0]) == 1e-9 and f.safe_sqrt(-1.0, 4.0) == 2.0 and f.safe_arctan2(0.0, 0.0) == 0.0 and f.safe_sinc(0.0) == 1.0
    assert f.rotate(np.tile(q, (2, 5, 1)), rng.normal(size=(5, 3))).shape == (2, 5, 3) and f.rotation_matrix(np.zeros((0, 4))).shape == (0, 3, 3)
    assert np.isnan(f.norm([np.nan, 0.0]))
    for wrong in (lambda: f.rotate([1.0, 0.0], v), lambda: f.norm([]), lambda: f.norm(1.0), lambda: f.rotate(np.ones((2, 4)), np.ones((3, 3)))):
        with pytest.raises(ValueError):
            wrong()
    for setting in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="positive"):
            f.rational_kernel(setting, 1.0)
    with pytest.raises(TypeError):
        f.norm(["a"])


def test_norms_have_a_derivative_at_zero_and_plain_roots_have_none():
    norm = omnidrones.System.of(lambda x, u: np.linalg.norm(x) + x * 0, states=2)
    root = omnidrones.System.of(lambda x, u: np.sqrt(x), states=1)
    assert norm.jacobians(np.zeros(2), np.zeros(0))[0].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert not np.isfinite(root.jacobians(np.zeros(1), np.zeros(0))[0]).all()
    safe = omnidrones.System.of(lambda x, u: functions.safe_sqrt(x), states=1)
    assert safe.jacobians(np.zeros(1), np.zeros(0))[0] == 0.0
    detached = omnidrones.System.of(lambda x, u: functions.detach(x) * x, states=1)
    assert detached.jacobians(np.full(1, 3.0), np.zeros(0))[0] == 3.0


PLAIN = np.zeros(3)


def _if(x):
    if x[0] < 0.5:
        return x
    return -x


def _while(x):
    while x[0] < 0.5:
        x = x + 1


def _and(x):
    return x[0] < 1 and x[1] < 1


def _not(x):
    return not x[0]


def _chain(x):
    return 0 < x[0] < 1


def _max(x):
    return max(x[0], x[1])


def _sorted(x):
    return sorted([x[0], x[1]])


def _float(x):
    return float(x[0])


def _math(x):
    return math.sin(x[0])


def _int(x):
    return int(x[0])


def _round(x):
    return round(x[0])


def _floor(x):
    return math.floor(x[0])


def _equal(x):
    return x[0] == 0.0


def _differs(x):
    return x != 0.0


def _in(x):
    return 1.0 in x


def _key(x):
    return {x[0]: 1}


def _array(x):
    return np.array([x[0], 1.0])


def _asarray(x):
    return np.asarray(x)


def _range(x):
    return range(x[0])


def _index(x):
    return PLAIN[x[0]]


def _own_index(x):
    return x[x[0]]


def _mask_index(x):
    return x[x > 0]


def _plain_by_mask(x):
    return PLAIN[x > 0]


def _into_plain(x):
    PLAIN[:] = x


def _one_into_plain(x):
    PLAIN[0] = x[0]


def _add_to_plain(x):
    plain = np.zeros(3)
    plain += x


def _format(x):
    return f"{x[0]:.3f}"


def _sort(x):
    return np.sort(x)


def _argmax(x):
    return np.argmax(x)


def _inverse(x):
    return np.linalg.inv(x[:, None] * x)


def _where_of_one(x):
    return np.where(x > 0)


def _dtype(x):
    return np.sum(x, dtype=np.float32)


def _order(x):
    return np.linalg.norm(x, 1)


def _power(x):
    return x**1.5


def _exponent(x):
    return 2.0**x


def _nan(x):
    return x + np.nan


def _word(x):
    return x + "a"


def _none(x):
    return x * None


def _complex(x):
    return x * 1j


def _objects(x):
    return x + np.array([None, 1, 2])


def _masks_by_numbers(x):
    return x & (x > 0)


def _mask_of_number(x):
    return np.where(x, 1.0, 2.0)


def _saved(x):
    return pickle.dumps(x)


def _huge(x):
    return np.broadcast_to(x[0], (10**6, 10**6)) + 1


def _huge_zeros(x):
    return omnidrones.zeros((10**6, 10**6))


def _endless(x):
    own = [x[0]]
    own[0] = own
    return x + [own, x[0]]


def _ragged(x):
    return omnidrones.array([[x[0]], [x[0], x[1]]])


def _item(x):
    return x[0].item()


def _setting(x):
    return functions.exponential_kernel(x[0], x)


def _made(x):
    return Number(3.0)


def _out(x):
    return np.add(x, 1.0, out=PLAIN)


def _at(x):
    return np.add.at(PLAIN, [0], x[0])


def _full(x):
    return np.full(3, x[0])


def _as_int(x):
    return x.astype(int)


MISTAKES = [
    (_if, "np.where(mask, a, b)"), (_while, "np.where(mask, a, b)"), (_and, "(a < b) & (c < d)"), (_not, "~"), (_chain, "(a < x) & (x < b)"),
    (_max, "np.maximum"), (_sorted, "np.where pick"), (_float, "omnidrones.zeros"), (_math, "np.sin in place of math.sin"), (_int, "np.where"),
    (_round, "no derivative"), (_floor, "np.floor"), (_equal, "tolerance"), (_differs, "tolerance"), (_in, "tolerance"), (_key, "constant as key"),
    (_array, "np.stack"), (_asarray, "np.stack"), (_range, "constant"), (_index, "np.stack"), (_own_index, "functions.take"), (_mask_index, "np.where"),
    (_plain_by_mask, "np.stack"), (_into_plain, "omnidrones.zeros"), (_one_into_plain, "omnidrones.zeros"), (_add_to_plain, "omnidrones.zeros"),
    (_format, "without a format"), (_sort, "np.sort is not known"), (_argmax, "np.argmax is not known"), (_inverse, "np.linalg.inv is not known"),
    (_where_of_one, "np.where(mask, a, b)"), (_dtype, "dtype"), (_order, "np.sum(np.abs(x))"), (_power, "np.exp(y * np.log(x))"),
    (_exponent, "np.exp(y * np.log(x))"), (_nan, "NaN among the constants"), (_word, "a str is no number"),
    (_none, "a NoneType is no number"), (_complex, "a complex is no number"), (_objects, "object is no number"), (_masks_by_numbers, "Compare first"),
    (_mask_of_number, "Compare first"), (_saved, "not saved"), (_huge, "at most"), (_huge_zeros, "at most"), (_endless, "without end"),
    (_ragged, "different shapes"), (_item, "Keep it"), (_setting, "plain number"), (_made, "omnidrones.array"), (_out, "omnidrones.zeros"),
    (_at, "not known"), (_full, "omnidrones.zeros"), (_as_int, "Keep them"),
]  # fmt: skip


@pytest.mark.parametrize(("f", "remedy"), MISTAKES, ids=lambda own: getattr(own, "__name__", ""))
def test_a_mistake_is_told_with_its_line_and_what_to_write(f, remedy):
    with pytest.raises(RecordingError) as raised:
        within(f)
    error = raised.value
    lines = range(f.__code__.co_firstlineno + 1, f.__code__.co_firstlineno + 5)
    assert error.filename == __file__ and error.lineno in lines
    assert f"test_number.py, line {error.lineno}, `" in str(error) and remedy in str(error)
    assert not omnidrones._core._is_recording()


def test_what_a_function_returns_must_be_its_numbers():
    for wrong, words in [
        (lambda x, u: None, "is None"),
        (lambda x, u: x[:2], "has the shape (2,), but it must be of shape (3,)"),
        (lambda x, u: {"x": x}, "is a dict"),
        (lambda x, u: "abc", "is a str"),
        (lambda x, u: np.zeros(4), "shape (4,)"),
        (lambda x, u: [x[0], "a", 1.0], "is a list: a str is no number"),
        (lambda x, u: (own for own in x), "is a generator"),
        (lambda x, u: [np.nan] * 3, "NaN"),
    ]:
        with pytest.raises(RecordingError) as raised:
            omnidrones.System.of(wrong, states=3)
        assert words in str(raised.value), str(raised.value)
    # axes of length 1 are free
    for right in (lambda x, u: x[None, :], lambda x, u: [x[0], 1, True], lambda x, u: (x[0], 1.0, x[1]), lambda x, u: np.zeros(3)):
        omnidrones.System.of(right, states=3)


def test_numbers_live_while_their_recording_does():
    kept = within(lambda x: x)
    calls = [lambda: kept + 1.0, lambda: np.sin(kept), lambda: np.stack([kept, kept]) + 0.0, lambda: kept @ kept, lambda: functions.norm(kept), lambda: kept < 1]
    for call in calls:
        with pytest.raises(RecordingError, match="outside of any recording"):
            call()
        with pytest.raises(RecordingError, match="another recording"):
            within(lambda x, call=call: call())
    for call in (lambda: omnidrones.zeros(3), lambda: omnidrones.array([1.0])):
        with pytest.raises(RecordingError, match="outside of any recording"):
            call()

    def write(x):
        x[0] = kept[0]

    with pytest.raises(RecordingError, match="another recording"):
        within(write)
    with pytest.raises(RecordingError, match="another recording"):
        omnidrones.System.of(lambda x, u: kept, states=3)


def test_a_recording_within_another_does_not_read_its_numbers():
    def outer(x):
        inner = omnidrones.System.of(lambda y, u: 2.0 * y, states=1)
        with pytest.raises(RecordingError, match="another recording"):
            omnidrones.System.of(lambda y, u: y + x[0], states=1)
        return x * inner.trajectory(np.ones(1), np.zeros((1, 0)))[1]

    assert run(outer, [1.0, 2.0]).tolist() == [2.0, 4.0]


def test_another_thread_does_not_write_into_the_recording():
    def f(x):
        raised = []

        def work():
            try:
                x + 1.0
            except RecordingError as error:
                raised.append(str(error))
            raised.append(within(lambda y: y.shape))

        worker = threading.Thread(target=work)
        worker.start()
        worker.join()
        return raised

    words, shape = within(f)
    assert "another thread" in words and shape == (3,)


def test_what_a_function_raises_is_raised_and_nothing_is_left():
    class Own(Exception):
        pass

    def f(x, u):
        omnidrones.System.of(lambda y, u: y, states=1)
        raise Own("mine")

    for _ in range(3):
        with pytest.raises(Own, match="mine") as raised:
            omnidrones.System.of(f, states=1)
        assert raised.traceback[-1].name == "f"
        assert not omnidrones._core._is_recording()
    for wild in (KeyboardInterrupt, SystemExit, MemoryError, RecursionError):

        def raising(x, u, wild=wild):
            raise wild

        with pytest.raises(wild):
            omnidrones.System.of(raising, states=1)


def test_the_extension_refuses_operations_that_are_none():
    def f(x):
        own = np.zeros((2, 2), np.int64)
        for name, rows in [("add", x._places.reshape(1, 3)), ("nothing", x._places.reshape(3, 1)), ("dot", x._places.reshape(1, 3)), ("rotate", x._places.reshape(1, 3))]:
            with pytest.raises(ValueError, match="no operation"):
                omnidrones._core._record(name, rows)
        for wrong in (own.astype(float), own[:, ::-1], own[0], None, [[1, 2]]):
            with pytest.raises((TypeError, ValueError)):
                omnidrones._core._record("add", wrong)
        with pytest.raises(RecordingError):
            omnidrones._core._record("add", own - 1)
        with pytest.raises(ValueError, match="no operation"):
            omnidrones._core._compute("less", np.zeros((1, 2)))
        with pytest.raises(ValueError, match="no operation"):
            omnidrones._core._compute("power", np.zeros((1, 1)), [1.5])

    within(f)


LEAVES = st.sampled_from(["x", "y", "m", "plain", "one", "mask", "word", "none", "index", "list", "empty", "slice", "huge"])
CALLS = sorted(
    {name for name in dir(np) if callable(getattr(np, name)) and not isinstance(getattr(np, name), type) and not name.startswith("_")}
    - {"save", "savez", "savez_compressed", "savetxt", "test", "info", "show_config", "show_runtime", "fromfile", "loadtxt", "genfromtxt", "load", "setbufsize",
       "seterr", "seterrcall", "set_printoptions", "fromregex", "memmap", "get_include", "printoptions", "errstate", "lookfor", "source", "disp", "bartlett",
       "blackman", "hamming", "hanning", "kaiser", "tri", "eye", "identity", "ones", "zeros", "empty", "full", "indices", "arange", "linspace"}
)  # fmt: skip
METHODS = ["sum", "reshape", "__getitem__", "__setitem__", "__add__", "__pow__", "__matmul__", "clip", "dot", "take", "repeat", "mean", "cumsum", "transpose", "astype"]


def leaf(name, x):
    m = x[:4].reshape(2, 2)
    return {
        "x": x, "y": x[::-1][:3], "m": m, "plain": np.arange(6.0), "one": x[0], "mask": x > 0, "word": "abc", "none": None, "index": 1,
        "list": [x[0], 1.0, x[1]], "empty": x[:0], "slice": slice(0, 2), "huge": np.broadcast_to(x[0], (10**5, 10**5)),
    }[name]  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_no_function_writes_an_array_that_only_pretends_to_be_large(name):
    def f(x):
        for leaves in (["huge"], ["huge", "index"], ["huge", "x"], ["x", "huge"], ["mask", "huge", "x"], ["huge", "huge", "huge"]):
            own = [leaf(each, x) for each in leaves]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    getattr(np, name)(*own)
                except MemoryError:
                    raise AssertionError(f"np.{name}({', '.join(leaves)}) asked for memory") from None
                except Exception:
                    pass

    within(f, 6)


@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.sampled_from(CALLS + METHODS), st.lists(LEAVES, min_size=1, max_size=3)), min_size=1, max_size=4))
def test_whatever_is_called_with_numbers_raises_or_works(calls):
    def f(x):
        for name, leaves in calls:
            own = [leaf(each, x) for each in leaves]
            if "huge" in leaves and (name in ("copy", "sum", "reshape") or name in METHODS):
                continue
            try:
                result = getattr(own[0], name)(*own[1:]) if name in METHODS else getattr(np, name)(*own)
            except Exception as error:
                assert type(error).__name__ != "PanicException"
                continue
            if isinstance(result, Number) and result.size and result.size < 100:
                (result + 1.0).sum()

    within(f, 6)
    assert not omnidrones._core._is_recording()
