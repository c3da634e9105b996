//! NumPy arrays as rows: the only file that reaches into their memory. Every borrow is checked, so that an array which two
//! arguments share, that is read-only or lies in another order is an exception and never a wrong number. What no borrow sees is that
//! arrays without a common base may share memory (made by `np.frombuffer` or DLPack), and that another Python thread writes into what a
//! running call was given: whoever does that gets numbers of both.

use bytemuck::cast_slice_mut;
use numpy::{
    BorrowError, Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArray1, PyReadwriteArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use omnidrones::tasks::{Spec, StepOut};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PySlice, PyTuple};

/// Numbers that arrays hold.
pub trait Number: Element {
    /// As NumPy calls it.
    const NAME: &'static str;
}

impl Number for f32 {
    const NAME: &'static str = "float32";
}
impl Number for f64 {
    const NAME: &'static str = "float64";
}
impl Number for bool {
    const NAME: &'static str = "bool";
}
impl Number for i64 {
    const NAME: &'static str = "int64";
}
impl Number for u8 {
    const NAME: &'static str = "bool";
}

/// An array of the caller to read.
pub type Rows<'py, T> = PyReadonlyArrayDyn<'py, T>;
/// An array of the caller to write.
pub type RowsMut<'py, T> = PyReadwriteArrayDyn<'py, T>;

/// An argument as an array of this type and shape in C order. Axes of length 1 may be left out, the last two joined.
fn checked<'py, T: Number>(
    name: &str,
    given: &Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let Ok(array) = given.cast::<PyArrayDyn<T>>() else {
        let kind = match given.cast::<PyUntypedArray>() {
            Ok(array) => format!("an array of {}", array.dtype().typeobj().name()?),
            Err(_) => format!("a {}", given.get_type().name()?),
        };
        let wanted = T::NAME;
        return Err(PyTypeError::new_err(format!(
            "{name} is {kind}, but it must be a NumPy array of {wanted}. Pass np.asarray({name}, np.{wanted})."
        )));
    };
    if array.shape() != shape && !fits(array.shape(), shape) {
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {:?}, but it must be {shape:?}. Axes of length 1 may be left out, the last two joined.",
            array.shape()
        )));
    }
    if !array.is_c_contiguous() {
        return Err(PyValueError::new_err(format!(
            "{name} does not lie in C order, but rows must follow each other. Pass np.ascontiguousarray({name})."
        )));
    }
    Ok(array.clone())
}

fn fits(got: &[usize], wanted: &[usize]) -> bool {
    let long = |shape: &[usize]| shape.iter().copied().filter(|n| *n != 1).collect::<Vec<_>>();
    let joined = match wanted {
        [first @ .., a, b] => [first, &[a * b]].concat(),
        short => short.to_vec(),
    };
    long(got) == long(wanted) || long(got) == long(&joined)
}

/// The lengths of as many axes of an array, whatever it holds.
pub fn lengths<const N: usize>(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[usize; N]> {
    let Ok(shape) = given.getattr(intern!(given.py(), "shape")).and_then(|shape| shape.extract::<Vec<usize>>()) else {
        let kind = given.get_type().name()?;
        let wanted = "a NumPy array of float64";
        return Err(PyTypeError::new_err(format!(
            "{name} is a {kind}, but it must be {wanted}. Pass np.asarray({name}, np.float64)."
        )));
    };
    shape.as_slice().try_into().map_err(|_| {
        PyValueError::new_err(format!("{name} has the shape {shape:?}, but it must have {N} axes. Reshape it."))
    })
}

/// An argument to read.
///
/// What is no NumPy array but says by DLPack where its numbers are, is taken for one: tensors on this machine's memory.
pub fn read<'py, T: Number>(name: &str, given: &Bound<'py, PyAny>, shape: &[usize]) -> PyResult<Rows<'py, T>> {
    if !given.is_instance_of::<PyUntypedArray>() && given.hasattr(intern!(given.py(), "__dlpack__"))? {
        let array = given.py().import("numpy")?.call_method1("from_dlpack", (given,))?;
        return read(name, &array, shape);
    }
    checked(name, given, shape)?.try_readonly().map_err(|_| shared(name))
}

/// An argument to read, nothing where it is left out.
pub fn read_or_none<'py, T: Number>(
    name: &str,
    given: Option<&Bound<'py, PyAny>>,
    shape: &[usize],
) -> PyResult<Option<Rows<'py, T>>> {
    given.map(|given| read(name, given, shape)).transpose()
}

/// An argument to write.
pub fn write<'py, T: Number>(name: &str, given: &Bound<'py, PyAny>, shape: &[usize]) -> PyResult<RowsMut<'py, T>> {
    checked::<T>(name, given, shape)?.try_readwrite().map_err(|error| match error {
        BorrowError::NotWriteable => PyValueError::new_err(format!(
            "{name} is read-only, but it is written to. Pass an array of your own, as {name}.copy()."
        )),
        _ => shared(name),
    })
}

/// An argument to write, nothing where it is left out.
pub fn write_or_none<'py, T: Number>(
    name: &str,
    given: Option<&Bound<'py, PyAny>>,
    shape: &[usize],
) -> PyResult<Option<RowsMut<'py, T>>> {
    given.map(|given| write(name, given, shape)).transpose()
}

/// Flags to read. NumPy's may be any byte, of which all but 0 are true.
pub fn flags(name: &str, given: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<bool>> {
    let flags = read::<bool>(name, given, &[n])?;
    let bytes = read::<u8>(name, &as_bytes(flags.as_any())?, &[n])?;
    Ok(slice(&bytes)?.iter().map(|byte| *byte != 0).collect())
}

/// Flags to write: an array of bool, or of uint8.
pub fn write_flags<'py>(name: &str, given: &Bound<'py, PyAny>, shape: &[usize]) -> PyResult<RowsMut<'py, u8>> {
    match given.cast::<PyArrayDyn<bool>>() {
        Ok(flags) => write(name, &as_bytes(flags.as_any())?, shape),
        Err(_) => write(name, given, shape),
    }
}

/// Flags as the bytes that they are.
fn as_bytes<'py>(flags: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    flags.call_method1(intern!(flags.py(), "view"), (intern!(flags.py(), "uint8"),))
}

fn shared(name: &str) -> PyErr {
    PyValueError::new_err(format!(
        "{name} shares memory with another argument or with arrays of the environment. Pass a copy, as {name}.copy()."
    ))
}

/// The numbers of an array, in order.
pub fn slice<'a, T: Element>(rows: &'a Rows<'_, T>) -> PyResult<&'a [T]> {
    rows.as_slice().map_err(|_| misaligned())
}

/// The numbers of an array that may be left out.
pub fn slice_or_none<'a, T: Element>(rows: &'a Option<Rows<'_, T>>) -> PyResult<&'a [T]> {
    rows.as_ref().map_or(Ok(&[]), slice)
}

/// The numbers of an array to write.
pub fn slice_mut<'a, T: Element>(rows: &'a mut RowsMut<'_, T>) -> PyResult<&'a mut [T]> {
    rows.as_slice_mut().map_err(|_| misaligned())
}

/// The numbers of an array to write that may be left out.
pub fn slice_mut_or_none<'a, T: Element>(rows: &'a mut Option<RowsMut<'_, T>>) -> PyResult<&'a mut [T]> {
    rows.as_mut().map_or(Ok(&mut []), slice_mut)
}

fn misaligned() -> PyErr {
    PyValueError::new_err("an array is not aligned to its numbers. Pass a copy of it.")
}

/// A new array.
pub fn array<'py, T: Element>(py: Python<'py>, numbers: Vec<T>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, numbers).reshape(shape)?.into_any())
}

/// Numbers of `float32` that begin a line of a cache.
const LINE: usize = 16;

/// Where the arrays of a step lie in one allocation: one checked borrow per step.
#[derive(Debug, Clone)]
pub struct Layout {
    /// Names, places and shapes of the numbers.
    numbers: [(&'static str, usize, Vec<usize>); 7],
    /// Environments, each with two flags of one byte.
    n_env: usize,
    flags: usize,
    size: usize,
}

impl Layout {
    /// For environments like these.
    pub fn of(spec: &Spec) -> Self {
        let (e, a) = (spec.n_env, spec.n_agent);
        let mut at = 0;
        let mut next = |name, shape: Vec<usize>| {
            let from = at;
            at += shape.iter().product::<usize>().next_multiple_of(LINE);
            (name, from, shape)
        };
        let numbers = [
            next("observation", vec![e, a, spec.n_observation]),
            next("reward", vec![e, a]),
            next("central", vec![e, spec.n_central]),
            next("privileged", vec![e, spec.privileged.len()]),
            next("final_observation", vec![e, a, spec.n_observation]),
            next("final_central", vec![e, spec.n_central]),
            next("info", vec![e, spec.info.len()]),
        ];
        let line = LINE * size_of::<f32>();
        Self { numbers, n_env: e, flags: at, size: at + 2 * e.next_multiple_of(line) / size_of::<f32>() }
    }

    /// The shape of an array of a step.
    pub fn shape(&self, name: &str) -> &[usize] {
        self.numbers.iter().find(|(own, ..)| *own == name).map_or(&[], |(.., shape)| shape)
    }

    /// The arrays of a step in their memory.
    pub fn out<'a>(&self, memory: &'a mut [f32]) -> StepOut<'a> {
        let (mut rest, flags) = memory.split_at_mut(self.flags);
        let mut next = |k: usize| {
            let n: usize = self.numbers[k].2.iter().product();
            let (own, behind) = std::mem::take(&mut rest).split_at_mut(n.next_multiple_of(LINE));
            rest = behind;
            &mut own[..n]
        };
        let [observation, reward, central, privileged] = [0, 1, 2, 3].map(&mut next);
        let [final_observation, final_central, info] = [4, 5, 6].map(&mut next);
        let flags: &mut [u8] = cast_slice_mut(flags);
        let (terminated, truncated) = flags.split_at_mut(flags.len() / 2);
        let (terminated, truncated) = (&mut terminated[..self.n_env], &mut truncated[..self.n_env]);
        StepOut {
            observation,
            reward,
            terminated,
            truncated,
            central,
            privileged,
            final_observation,
            final_central,
            info,
        }
    }
}

/// The arrays of a step, which NumPy owns.
pub struct Slab(Py<PyArray1<f32>>);

impl Slab {
    /// All zeros.
    pub fn new(py: Python<'_>, layout: &Layout) -> PyResult<Self> {
        // by NumPy's own function, which raises MemoryError where ours would panic
        let zeros = py.import("numpy")?.call_method1("zeros", (layout.size, "float32"))?;
        Ok(Self(zeros.cast_into::<PyArray1<f32>>()?.unbind()))
    }

    /// To write.
    pub fn lend<'py>(&self, py: Python<'py>) -> PyResult<PyReadwriteArray1<'py, f32>> {
        self.0.bind(py).try_readwrite().map_err(|_| shared("actions"))
    }

    /// The array of this name: a view.
    pub fn view<'py>(&self, py: Python<'py>, layout: &Layout, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let memory = self.0.bind(py);
        let part = |from: usize, n: usize| memory.get_item(PySlice::new(py, from as isize, (from + n) as isize, 1));
        if let Some((_, from, shape)) = layout.numbers.iter().find(|(own, ..)| *own == name) {
            return part(*from, shape.iter().product())?.call_method1("reshape", (PyTuple::new(py, shape)?,));
        }
        let half = (layout.size - layout.flags) / 2;
        let from = layout.flags + if name == "truncated" { half } else { 0 };
        let flags = part(from, half)?.call_method1("view", ("bool",))?;
        flags.get_item(PySlice::new(py, 0, layout.n_env as isize, 1))
    }
}
