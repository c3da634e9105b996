//! Numbers that record, from Python: what is done to arrays of places in a recording, and how the library's numbers become
//! `omnidrones.Number` and come back.
//!
//! `omnidrones/_number.py` keeps places in arrays of NumPy, whose shapes are NumPy's business. An operation comes here as rows of places,
//! one result or a few for each. Numbers that record nothing take the same way in `f64`.

use crate::arrays::{array, lengths, read, slice};
use omnidrones::autodiff::trace::is_recording;
use omnidrones::autodiff::{Array, Mask, Recording, Scalar, Trace, TraceMask, floor, safe};
use omnidrones::dynamics::frame::Frame;
use omnidrones::dynamics::spatial;
use omnidrones::tasks::{Inertial, assignment, reward};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Most numbers that one operation takes: a recording is made for a few hundred.
const MOST: usize = 1 << 22;

const PYTHON: &str = "omnidrones._number";

/// The places as an array of Python keeps them.
fn bits(places: &[Trace]) -> Vec<i64> {
    places.iter().map(|x| x.to_bits() as i64).collect()
}

/// A `Number` of this shape.
pub fn number<'py>(py: Python<'py>, numbers: &[Trace], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    py.import(PYTHON)?.call_method1("_number_at", (array(py, bits(numbers), shape)?,))
}

/// A `Mask` of this shape.
pub fn truths<'py>(py: Python<'py>, masks: &[TraceMask], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let numbers: Vec<Trace> = masks.iter().map(|mask| mask.as_number()).collect();
    py.import(PYTHON)?.call_method1("_mask_at", (array(py, bits(&numbers), shape)?,))
}

/// What the user's code gave as numbers, in C order: a `Number`, plain numbers, arrays, lists of all of them. Axes of length 1 are free.
/// `what` begins the message of an error, as "the reward".
pub fn traces(what: &str, given: &Bound<'_, PyAny>, shape: Option<&[usize]>) -> PyResult<Vec<Trace>> {
    let places = given.py().import(PYTHON)?.call_method1("_numbers_of", (what, given, shape.map(<[usize]>::to_vec)))?;
    live(&places)
}

/// Likewise a truth: a `Mask` of one, a bool.
pub fn mask(what: &str, given: &Bound<'_, PyAny>) -> PyResult<TraceMask> {
    let places = given.py().import(PYTHON)?.call_method1("_truth_of", (what, given))?;
    match live(&places)?.as_slice() {
        [one] => Ok(TraceMask::of_number(*one)),
        _ => Err(PyValueError::new_err(format!("{what} must be one truth."))),
    }
}

/// Records what `f` does to `n_input` numbers, word for word. What it raised is raised.
///
/// `f` returns numbers that [`traces`] gave, made within it: others would panic.
pub fn record(n_input: usize, f: impl FnOnce(&[Trace]) -> PyResult<Vec<Trace>>) -> PyResult<Recording> {
    let mut raised = None;
    let recording = Recording::as_written(n_input, |inputs| {
        f(inputs).unwrap_or_else(|error| {
            raised = Some(error);
            Vec::new()
        })
    });
    raised.map_or(Ok(recording), |error| Err(Python::attach(|py| itself(py, error))))
}

/// A `RecordingError` that NumPy put a `ValueError` before, where a number was assigned into a plain array; any other error as it is.
fn itself(py: Python<'_>, error: PyErr) -> PyErr {
    let is_recording_error = |cause: &PyErr| -> PyResult<bool> {
        cause.value(py).is_instance(&py.import(PYTHON)?.getattr("RecordingError")?)
    };
    match error.cause(py) {
        Some(cause) if error.is_instance_of::<PyValueError>(py) && is_recording_error(&cause).unwrap_or(false) => {
            cause.set_traceback(py, error.traceback(py));
            cause
        }
        _ => error,
    }
}

/// Places that what is being recorded here may read.
fn live(places: &Bound<'_, PyAny>) -> PyResult<Vec<Trace>> {
    let py = places.py();
    let [n] = lengths("places", places)?;
    let own = read::<i64>("places", places, &[n])?;
    let own: Vec<Trace> = slice(&own)?.iter().map(|bits| Trace::from_bits(*bits as u64)).collect();
    if !is_recording() {
        return Err(mistake(py, "_nothing_records")?);
    }
    if !own.iter().all(|x| x.is_live()) {
        return Err(mistake(py, "_of_another_recording")?);
    }
    Ok(own)
}

/// An error that Python words.
fn mistake(py: Python<'_>, kind: &str) -> PyResult<PyErr> {
    Ok(PyErr::from_value(py.import(PYTHON)?.call_method0(kind)?))
}

/// Whether something is being recorded on this thread.
#[pyfunction]
pub fn _is_recording() -> bool {
    is_recording()
}

/// Raises unless all places, int64 [n], may be read here.
#[pyfunction]
pub fn _check_places(places: &Bound<'_, PyAny>) -> PyResult<()> {
    live(places).map(|_| ())
}

/// Places of constants, float64 [n] to int64 [n].
#[pyfunction]
pub fn _constants<'py>(py: Python<'py>, values: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let [n] = lengths("values", values)?;
    if !is_recording() {
        return Err(mistake(py, "_nothing_records")?);
    }
    few(n, 1)?;
    let own = read::<f64>("values", values, &[n])?;
    let places: Vec<Trace> = slice(&own)?.iter().map(|x| Trace::constant(*x)).collect();
    array(py, bits(&places), &[n])
}

/// Records an operation on rows of places, int64 [n, operand] to int64 [n, result].
#[pyfunction]
#[pyo3(signature = (name, rows, settings=Vec::new()))]
pub fn _record<'py>(
    py: Python<'py>,
    name: &str,
    rows: &Bound<'py, PyAny>,
    settings: Vec<f64>,
) -> PyResult<Bound<'py, PyAny>> {
    let [n, width] = lengths("rows", rows)?;
    few(n, width)?;
    let operands = live(&rows.call_method1("reshape", (n * width,))?)?;
    let results = of_rows(name, n, width, &operands, &settings, |row, out| {
        with_truths(name, row, out).or_else(|| call(name, &settings, row, out))
    })?;
    let n_result = results.len() / n.max(1);
    array(py, bits(&results), &[n, n_result])
}

/// The same operation on plain numbers, float64 [n, operand] to float64 [n, result].
#[pyfunction]
#[pyo3(signature = (name, rows, settings=Vec::new()))]
pub fn _compute<'py>(
    py: Python<'py>,
    name: &str,
    rows: &Bound<'py, PyAny>,
    settings: Vec<f64>,
) -> PyResult<Bound<'py, PyAny>> {
    let [n, width] = lengths("rows", rows)?;
    let own = read::<f64>("rows", rows, &[n, width])?;
    let results = of_rows(name, n, width, slice(&own)?, &settings, |row, out| call(name, &settings, row, out))?;
    let n_result = results.len() / n.max(1);
    array(py, results, &[n, n_result])
}

fn few(n: usize, width: usize) -> PyResult<()> {
    if n.saturating_mul(width) > MOST {
        let size = n.saturating_mul(width);
        return Err(PyValueError::new_err(format!(
            "an operation on {size} recorded numbers: at most {MOST} are taken. Record what happens to one, and run it for many."
        )));
    }
    Ok(())
}

/// The results of all rows, one behind the other.
fn of_rows<S: Scalar>(
    name: &str,
    n: usize,
    width: usize,
    operands: &[S],
    settings: &[f64],
    mut apply: impl FnMut(&[S], &mut Vec<S>) -> Option<()>,
) -> PyResult<Vec<S>> {
    let mut results = Vec::new();
    for k in 0..n {
        apply(&operands[k * width..(k + 1) * width], &mut results).ok_or_else(|| {
            let settings = settings.len();
            PyValueError::new_err(format!("no operation {name} of {width} numbers and {settings} settings."))
        })?;
    }
    Ok(results)
}

/// Operations on truths, whose places are those of numbers.
fn with_truths(name: &str, row: &[Trace], out: &mut Vec<Trace>) -> Option<()> {
    let truth = TraceMask::of_number;
    out.push(match (name, row) {
        ("less", [a, b]) => a.lt(*b).as_number(),
        ("not", [a]) => Mask::not(truth(*a)).as_number(),
        ("all", [first, rest @ ..]) => rest.iter().fold(truth(*first), |all, one| all.and(truth(*one))).as_number(),
        ("any", [first, rest @ ..]) => rest.iter().fold(truth(*first), |any, one| any.or(truth(*one))).as_number(),
        ("select", [mask, yes, no]) => Trace::select(truth(*mask), *yes, *no),
        ("as_number", [mask]) => Trace::select(truth(*mask), Trace::one(), Trace::zero()),
        _ => return None,
    });
    Some(())
}

/// Operations on any scalar: the library's own, by the names that they have in Python.
fn call<S: Scalar>(name: &str, settings: &[f64], row: &[S], out: &mut Vec<S>) -> Option<()> {
    let one = match (name, row, settings) {
        ("add", [a, b], []) => *a + *b,
        ("subtract", [a, b], []) => *a - *b,
        ("multiply", [a, b], []) => *a * *b,
        ("divide", [a, b], []) => *a / *b,
        ("maximum", [a, b], []) => a.max(*b),
        ("minimum", [a, b], []) => a.min(*b),
        ("arctan2", [y, x], []) => y.atan2(*x),
        ("floor", [x], []) => floor(*x),
        ("multiply_add", [a, b, c], []) => a.mul_add(*b, *c),
        ("clip", [x, low, high], []) => x.clamp(*low, *high),
        ("negative", [x], []) => -*x,
        ("absolute", [x], []) => x.abs(),
        ("square", [x], []) => x.square(),
        ("reciprocal", [x], []) => x.recip(),
        ("sqrt", [x], []) => x.sqrt(),
        ("exp", [x], []) => x.exp(),
        ("log", [x], []) => x.ln(),
        ("tanh", [x], []) => x.tanh(),
        ("sin", [x], []) => x.sin_cos().0,
        ("cos", [x], []) => x.sin_cos().1,
        ("tan", [x], []) => {
            let (sin, cos) = x.sin_cos();
            sin / cos
        }
        ("sign", [x], []) => {
            let up = S::select(S::zero().lt(*x), S::one(), S::zero());
            S::select(x.lt(S::zero()), S::constant(-1.0), up)
        }
        ("power", [x], [exponent]) => power(*x, *exponent)?,
        ("detach", [x], []) => x.detach(),

        ("take", [index, first, rest @ ..], []) => rest
            .iter()
            .enumerate()
            .fold(*first, |taken, (k, x)| S::select(S::constant(k as f64 + 0.5).lt(*index), *x, taken)),

        ("sum", [first, rest @ ..], []) => rest.iter().fold(*first, |sum, x| sum + *x),
        ("product", [first, rest @ ..], []) => rest.iter().fold(*first, |product, x| product * *x),
        ("largest", [first, rest @ ..], []) => rest.iter().fold(*first, |most, x| most.max(*x)),
        ("smallest", [first, rest @ ..], []) => rest.iter().fold(*first, |least, x| least.min(*x)),
        ("dot", row, []) if !row.is_empty() && row.len().is_multiple_of(2) => {
            let (a, b) = row.split_at(row.len() / 2);
            dot(a, b)
        }
        ("squared_norm", row @ [_, ..], []) => dot(row, row),
        ("norm", row @ [_, ..], []) => safe::sqrt(dot(row, row), safe::SQUARED_NORM_FLOOR),

        ("safe_sqrt", [x], [floor]) => safe::sqrt(*x, *floor),
        ("safe_recip_sqrt", [x], [floor]) => safe::recip_sqrt(*x, *floor),
        ("safe_arctan2", [y, x], []) => safe::atan2(*y, *x),
        ("safe_arccos", [x], []) => safe::acos(*x),
        ("safe_arcsin", [x], []) => safe::asin(*x),
        ("safe_divide", [a, b], [floor]) => safe::div(*a, *b, *floor),
        ("safe_sinc", [x], []) => safe::sinc(*x),

        ("rational_kernel", [squared], [a]) => reward::rational_kernel(*a, *squared),
        ("exponential_kernel", row @ [_, ..], [a]) => reward::exponential_kernel_of(*a, dot(row, row)),
        ("smooth_norm", row @ [_, ..], [delta]) => reward::smooth_norm_of(dot(row, row), *delta),
        ("pseudo_huber", row @ [_, ..], [c]) => reward::pseudo_huber_of(dot(row, row), *c),
        ("yaw", [w, x, y, z], []) => frame([*w, *x, *y, *z]).yaw(),

        ("upright", [x, y, z], []) => reward::upright([*x, *y, *z]),
        ("still", [x, y, z], []) => reward::still([*x, *y, *z]),
        _ => return several(name, settings, row, out),
    };
    out.push(one);
    Some(())
}

/// Those of more than one result.
fn several<S: Scalar>(name: &str, settings: &[f64], row: &[S], out: &mut Vec<S>) -> Option<()> {
    let solid = match (name, row, settings) {
        ("inertial_ball", [mass, x, y, z], [radius]) => Some(Inertial::ball(*mass, *radius, [*x, *y, *z])),
        ("inertial_cuboid", [mass, x, y, z], [a, b, c]) => Some(Inertial::cuboid(*mass, [*a, *b, *c], [*x, *y, *z])),
        ("inertial_capsule", [mass, length, x, y, z], [radius]) => {
            Some(Inertial::capsule(*mass, *radius, *length, [*x, *y, *z]))
        }
        _ => None,
    };
    if let Some(solid) = solid {
        out.extend(flat(&solid));
        return Some(());
    }
    if !settings.is_empty() {
        return None;
    }
    let quaternion = |q: [S; 4]| -> Vec<S> { q.to_vec() };
    let vector = |v: [S; 3]| -> Vec<S> { v.to_vec() };
    let results = match (name, row) {
        ("normalise", row @ [_, ..]) => {
            let scale = safe::recip_sqrt(dot(row, row), safe::SQUARED_NORM_FLOOR);
            row.iter().map(|x| *x * scale).collect()
        }
        ("assign", row @ [_, ..]) => assignment(row).ok()?,
        ("inertial_scaled", [factor, own @ ..]) => flat(&inertial(own)?.scaled(*factor)),
        ("inertial_joined", row) if row.len() == 20 => flat(&inertial(&row[..10])?.and(&inertial(&row[10..])?)),
        ("cross", [a, b, c, d, e, f]) => vector(spatial::cross([*a, *b, *c], [*d, *e, *f])),
        ("rotate", [w, x, y, z, a, b, c]) => vector(spatial::rotate([*w, *x, *y, *z], [*a, *b, *c])),
        ("rotate_back", [w, x, y, z, a, b, c]) => vector(spatial::rotate_back([*w, *x, *y, *z], [*a, *b, *c])),
        ("quaternion_rate", [w, x, y, z, a, b, c]) => quaternion(spatial::derivative([*w, *x, *y, *z], [*a, *b, *c])),
        ("multiply_quaternions", [a, b, c, d, e, f, g, h]) => {
            quaternion(spatial::multiply([*a, *b, *c, *d], [*e, *f, *g, *h]))
        }
        ("conjugate", [w, x, y, z]) => quaternion(spatial::conjugate([*w, *x, *y, *z])),
        ("unit_quaternion", [w, x, y, z]) => quaternion(spatial::unit([*w, *x, *y, *z])),
        ("rotation_matrix", [w, x, y, z]) => spatial::matrix([*w, *x, *y, *z]).concat(),
        ("up_axis", [w, x, y, z]) => vector(spatial::up_axis([*w, *x, *y, *z])),
        ("heading_axis", [w, x, y, z]) => vector(frame([*w, *x, *y, *z]).heading()),
        ("observed_attitude", [w, x, y, z]) => quaternion(frame([*w, *x, *y, *z]).observed_attitude()),
        ("to_euler", [w, x, y, z]) => vector(spatial::to_euler([*w, *x, *y, *z])),
        ("from_euler", [roll, pitch, yaw]) => quaternion(spatial::from_euler(*roll, *pitch, *yaw)),
        ("from_rotation_vector", [x, y, z]) => quaternion(spatial::exponential([*x, *y, *z])),
        ("from_rotation_matrix", [a, b, c, d, e, f, g, h, i]) => {
            quaternion(spatial::from_matrix([[*a, *b, *c], [*d, *e, *f], [*g, *h, *i]]))
        }
        _ => return None,
    };
    out.extend(results);
    Some(())
}

/// Mass, centre of mass and inertia, one behind the other.
fn flat<S: Scalar>(own: &Inertial<S>) -> Vec<S> {
    [&[own.mass][..], &own.center_of_mass, &own.inertia].concat()
}

fn inertial<S: Scalar>(row: &[S]) -> Option<Inertial<S>> {
    (row.len() == 10).then(|| Inertial { mass: row[0], center_of_mass: row.array(1), inertia: row.array(4) })
}

/// At rest in the origin.
fn frame<S: Scalar>(attitude: [S; 4]) -> Frame<S> {
    let zero = [S::zero(); 3];
    Frame { position: zero, attitude, velocity: zero, angular_velocity: zero }
}

/// Of at least one number: as `spatial::dot` and `safe::squared_norm` sum, for any length.
fn dot<S: Scalar>(a: &[S], b: &[S]) -> S {
    (1..a.len()).fold(a[0] * b[0], |sum, i| a[i].mul_add(b[i], sum))
}

/// x to a whole exponent by squares, the reciprocal of that for a negative one, and √x for ½.
fn power<S: Scalar>(x: S, exponent: f64) -> Option<S> {
    let size = exponent.abs();
    let of_size = if size == 0.5 {
        x.sqrt()
    } else if size == 0.0 {
        S::one()
    } else if size.fract() == 0.0 && size <= f64::from(1 << 20) {
        let whole = size as u32;
        (0..whole.ilog2()).rev().fold(x, |power, bit| {
            let square = power * power;
            if whole >> bit & 1 == 1 { square * x } else { square }
        })
    } else {
        return None;
    };
    Some(if exponent < 0.0 { of_size.recip() } else { of_size })
}

/// As [`traces`] of `N` numbers.
pub fn vector<const N: usize>(what: &str, given: &Bound<'_, PyAny>) -> PyResult<[Trace; N]> {
    Ok(traces(what, given, Some(&[N]))?.array(0))
}

/// Whether it records.
pub fn is_number(given: &Bound<'_, PyAny>) -> PyResult<bool> {
    given.is_instance(&given.py().import(PYTHON)?.getattr("Number")?)
}

/// What is raised for numbers of a recording that is over, or of another thread.
pub fn stale() -> PyErr {
    Python::attach(|py| mistake(py, "_of_another_recording").unwrap_or_else(|error| error))
}
