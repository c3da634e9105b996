//! Exact gradients of steps, from Python: tapes and sweeps in `float32` for batches, Jacobians in `float64` for one.

use crate::arrays::{array, read, read_or_none, slice, slice_mut, slice_or_none, write};
use crate::error::OrRaise;
use omnidrones::tasks::{self, Cotangents, StepLayout, SweepOptions};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};
use std::ops::Range;

/// What `VecEnv.step_recorded` remembers of up to so many steps.
#[pyclass(module = "omnidrones")]
pub struct Tape(pub tasks::Tape);

#[pymethods]
impl Tape {
    /// Steps recorded.
    fn __len__(&self) -> usize {
        self.0.len()
    }

    /// Steps that fit.
    #[getter]
    fn horizon(&self) -> usize {
        self.0.horizon()
    }

    /// Of memory.
    #[getter]
    fn bytes(&self) -> u64 {
        self.0.bytes()
    }

    /// Forgets all steps and keeps the memory.
    fn clear(&mut self) {
        self.0.clear();
    }
}

/// The adjoint of one step of a task, compiled: `VecEnv.adjoint` makes it.
#[pyclass(module = "omnidrones", frozen)]
pub struct Adjoint {
    pub adjoint: tasks::Adjoint,
    pub n_env: usize,
}

#[pymethods]
impl Adjoint {
    /// Numbers that go from step to step: physics, memory of the task, delay line, history.
    #[getter]
    fn n_carried(&self) -> usize {
        self.adjoint.n_carried()
    }

    /// A sweep that begins behind any step of a tape, with nothing carried.
    ///
    /// `decay` is a factor per step on what is carried, 1 the exact gradient; `clip` the largest norm of it, per environment.
    #[pyo3(signature = (decay=1.0, clip=f32::INFINITY))]
    fn sweep(&self, decay: f32, clip: f32) -> Sweep {
        Sweep {
            sweep: self.adjoint.sweep(SweepOptions { decay, clip }),
            adjoint: self.adjoint.clone(),
            n_env: self.n_env,
        }
    }
}

/// A reverse sweep over a tape, step by step from the last to the first.
#[pyclass(module = "omnidrones")]
pub struct Sweep {
    sweep: tasks::Sweep,
    adjoint: tasks::Adjoint,
    n_env: usize,
}

#[pymethods]
impl Sweep {
    /// Begins again behind any step, with nothing carried.
    fn restart(&mut self) {
        self.sweep.restart();
    }

    /// Pulls cotangents back through step `t` of a tape and returns those of its actions, [E, A * command].
    ///
    /// Cotangents are float32 arrays of what the step wrote: observation and final_observation [E, A, observation], central and
    /// final_central [E, central], final_carried [E, carried], reward [E] (of the team's one), loss [E]. Those left out are zero. The
    /// first step pulled may be any, then each is the one before.
    #[pyo3(signature = (
        tape, t, *, observation=None, reward=None, loss=None, central=None, final_observation=None, final_central=None,
        final_carried=None, out=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn pull<'py>(
        &mut self,
        py: Python<'py>,
        tape: &Tape,
        t: usize,
        observation: Option<&Bound<'py, PyAny>>,
        reward: Option<&Bound<'py, PyAny>>,
        loss: Option<&Bound<'py, PyAny>>,
        central: Option<&Bound<'py, PyAny>>,
        final_observation: Option<&Bound<'py, PyAny>>,
        final_central: Option<&Bound<'py, PyAny>>,
        final_carried: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (p, e) = (self.adjoint.layout(), self.n_env);
        let rows = |name: &str, given: Option<&Bound<'py, PyAny>>, n: usize| {
            // the axes of agents and numbers are one here
            let flat =
                |given: &Bound<'py, PyAny>| given.call_method1("reshape", (e, n)).unwrap_or_else(|_| given.clone());
            read_or_none::<f32>(name, given.map(flat).as_ref(), &[e, n])
        };
        let observation = rows("observation", observation, p.observation.len())?;
        let final_observation = rows("final_observation", final_observation, p.observation.len())?;
        let central = rows("central", central, p.central.len())?;
        let final_central = rows("final_central", final_central, p.central.len())?;
        let final_carried = rows("final_carried", final_carried, p.n_carried())?;
        let reward = read_or_none("reward", reward, &[e])?;
        let loss = read_or_none("loss", loss, &[e])?;
        let up = Cotangents {
            observation: slice_or_none(&observation)?,
            final_observation: slice_or_none(&final_observation)?,
            central: slice_or_none(&central)?,
            final_central: slice_or_none(&final_central)?,
            final_carried: slice_or_none(&final_carried)?,
            reward: slice_or_none(&reward)?,
            loss: slice_or_none(&loss)?,
        };
        let shape = [e, p.action.len()];
        let fresh = || array(py, vec![0.0_f32; shape.iter().product()], &shape);
        let out = out.map_or_else(fresh, |out| Ok(out.clone()))?;
        let mut rows = write("out", &out, &shape)?;
        let (sweep, tape, action) = (&mut self.sweep, &tape.0, slice_mut(&mut rows)?);
        py.detach(|| sweep.pull(tape, t, &up, action)).or_raise()?;
        Ok(out)
    }

    /// Cotangents of what the environments carried into the last step pulled, a new array [E, carried]: physics first.
    fn carried<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.rows(py, self.sweep.carried())
    }

    /// Adds to what is carried, [E, carried], between pulls: the gradient of a cost on the state there.
    fn add_carried(&mut self, cotangents: &Bound<'_, PyAny>) -> PyResult<()> {
        let rows = read::<f32>("cotangents", cotangents, &[self.n_env, self.adjoint.n_carried()])?;
        self.sweep.add_carried(slice(&rows)?).or_raise()
    }

    /// Gradients by the physical numbers that differ between environments, summed over all steps pulled, a new array
    /// [E, number]; no columns unless the adjoint was made with parameters.
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.rows(py, self.sweep.parameters())
    }

    /// Gradients that were not finite and became zero, environments times steps.
    #[getter]
    fn dropped(&self) -> usize {
        self.sweep.dropped()
    }
}

impl Sweep {
    fn rows<'py>(&self, py: Python<'py>, numbers: Vec<f32>) -> PyResult<Bound<'py, PyAny>> {
        let width = numbers.len() / self.n_env;
        array(py, numbers, &[self.n_env, width])
    }
}

/// Exact derivatives of one step of one environment, float64.
#[pyclass(module = "omnidrones", frozen)]
pub struct Jacobian(pub tasks::Jacobian);

#[pymethods]
impl Jacobian {
    /// What went into the step, [argument]: `layout` says what is where.
    #[getter]
    fn arguments<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.arguments.clone(), &[self.0.arguments.len()])
    }

    /// What came out of it, [result].
    #[getter]
    fn value<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.value.clone(), &[self.0.value.len()])
    }

    /// Derivatives of the results by the arguments up to the parameters, [result, argument].
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (n_row, n_column) = self.0.matrix.shape();
        array(py, self.0.matrix.transpose().as_slice().to_vec(), &[n_row, n_column])
    }

    /// Places by name, as slices: of arguments and results `state`, `task_state`, `line`, `history`; of arguments `action`,
    /// `parameters`, `time`, `goal`, `next_goal`, `wind`, `readings`, `noise`, `statistics`; of results `observation`, `central`, `reward`, `loss`, `poses`.
    #[getter]
    fn layout<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        places(py, &self.0.layout)
    }
}

/// Places by name, as slices.
pub fn places<'py>(py: Python<'py>, p: &StepLayout) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let put = |name: &str, r: Range<usize>| dict.set_item(name, PySlice::new(py, r.start as isize, r.end as isize, 1));
    for (name, range) in [
        ("state", &p.state),
        ("task_state", &p.task_state),
        ("line", &p.line),
        ("history", &p.history),
        ("action", &p.action),
        ("parameters", &p.parameters),
        ("time", &p.time),
        ("goal", &p.goal),
        ("next_goal", &p.next_goal),
        ("wind", &p.wind),
        ("readings", &p.readings),
        ("noise", &p.noise),
        ("statistics", &p.statistics),
        ("observation", &p.observation),
        ("central", &p.central),
    ] {
        put(name, range.clone())?;
    }
    put("carried", 0..p.n_carried())?;
    put("reward", p.reward..p.reward + 1)?;
    put("loss", p.loss..p.loss + 1)?;
    put("poses", p.poses.clone())?;
    Ok(dict)
}
