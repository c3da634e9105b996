//! Parts that tasks of the library are made of, for those in Python: paths, gates, forests.

use super::begin::Start;
use crate::arrays::array;
use crate::control::data;
use crate::error::{OrRaise, unexpected};
use crate::number::{number, traces, truths, vector};
use crate::settings;
use omnidrones::autodiff::Trace;
use omnidrones::dynamics::scene;
use omnidrones::dynamics::shape::Pose;
use omnidrones::error::Error;
use omnidrones::tasks::settings::Settings;
use omnidrones::tasks::{self, Follow, Grove};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

/// A lemniscate that episodes draw: where tasks of the library that follow a path have theirs from. Its numbers stand in the goal.
///
/// Parameters
/// ----------
/// dt : float
///     Seconds per step: `self.dt` of a task.
/// **settings
///     Those of `omnidrones.PathSettings`. `TrackPath.of(task)` takes all of it from a task that has them.
#[pyclass(module = "omnidrones", frozen)]
pub struct TrackPath(tasks::TrackPath);

/// Key, default, unit, meaning and domain of a setting.
type Told = (String, Py<PyAny>, String, String, String);

/// Numbers of a path in a goal.
const PATH: usize = 9;

/// Numbers of a goal from where those of a path begin.
fn path_in(goal: &Bound<'_, PyAny>) -> PyResult<Vec<Trace>> {
    let own = traces("goal", goal, None)?;
    if own.len() < PATH {
        let remedy = "Give the goal from the path on: view.goal, or view.goal[n:] where n numbers stand before it.";
        return Err(Error::value("numbers of a goal", own.len(), format!("{PATH} or more"), remedy)).or_raise();
    }
    Ok(own)
}

#[pymethods]
impl TrackPath {
    #[new]
    #[pyo3(signature = (dt, /, **settings))]
    fn new(dt: f64, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let table = settings.map(|own| settings::table("", own.cast::<PyMapping>()?)).transpose()?;
        Ok(Self(tasks::TrackPath::new(&Follow::of(&table.unwrap_or_default()).or_raise()?, dt)))
    }

    /// Of a task with `PathSettings`.
    #[staticmethod]
    fn of(task: &Bound<'_, PyAny>) -> PyResult<Self> {
        let own = PyDict::new(task.py());
        for setting in Follow::default().list() {
            own.set_item(&setting.key, task.getattr(setting.key.as_str())?)?;
        }
        Self::new(task.getattr("dt")?.extract()?, Some(&own))
    }

    /// What `PathSettings` consists of: key, default, unit, meaning, domain.
    #[staticmethod]
    fn _settings(py: Python<'_>) -> PyResult<Vec<Told>> {
        let told = |own: omnidrones::tasks::Setting| {
            let domain = serde_json::to_value(own.domain).map_err(unexpected)?;
            let domain = domain.as_str().unwrap_or_default().to_string();
            Ok((own.key, settings::python(py, &own.default)?.unbind(), own.unit, own.meaning, domain))
        };
        Follow::default().list().into_iter().map(told).collect()
    }

    /// Draws a path, and writes it into the goal; where it begins, m, world, [3].
    fn draw<'py>(&self, py: Python<'py>, start: &Start) -> PyResult<Bound<'py, PyAny>> {
        let first = start.0.with(|start| Ok(self.0.draw(start)))?;
        number(py, &first, &[3])
    }

    /// Gives the root of tree 0 the velocity along the path, where the episode begins along it (`start_along`). `first` is the place of the
    /// path in the goal. With a `lever` (m) the root leans as it is held by its thrust along the path, the point that far below it.
    #[pyo3(signature = (start, first=0, *, lever=None))]
    fn join(&self, start: &Start, first: usize, lever: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let lever = lever.map(|own| traces("lever", own, Some(&[]))).transpose()?.map(|own| own[0]);
        start.0.with(|start| {
            if start.goal.len() < first + PATH {
                let limit = format!("{first} + {PATH}, as a path has");
                let remedy = "Draw the path first, and tell where in the goal it stands.";
                return Err(Error::value("numbers of the goal", start.goal.len(), limit, remedy)).or_raise();
            }
            self.0.join(start, first, lever);
            Ok(())
        })
    }

    /// The point of the path at a step, m, world, [3].
    fn at<'py>(
        &self,
        py: Python<'py>,
        goal: &Bound<'py, PyAny>,
        step: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (goal, step) = (path_in(goal)?, traces("step", step, Some(&[]))?[0]);
        number(py, &self.0.at(&goal, step), &[3])
    }

    /// Its velocity at a step, m/s, world, [3].
    fn velocity<'py>(
        &self,
        py: Python<'py>,
        goal: &Bound<'py, PyAny>,
        step: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (goal, step) = (path_in(goal)?, traces("step", step, Some(&[]))?[0]);
        number(py, &self.0.velocity(&goal, step), &[3])
    }

    /// Whether an error, m, is beyond the reset distance of the episode.
    fn far<'py>(
        &self,
        py: Python<'py>,
        goal: &Bound<'py, PyAny>,
        error: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (goal, error) = (path_in(goal)?, vector::<3>("error", error)?);
        truths(py, &[self.0.far(&goal, error)], &[])
    }
}

/// Four bars around an opening, in the yz plane of the frame; one flies through along x.
///
/// Parameters
/// ----------
/// **settings
///     `position`, `rotation` (w x y z), `half_width`, `half_height`, `radius`, `scale` of the three lengths, `slide` (a dict), `name`.
#[pyclass(module = "omnidrones", frozen)]
pub struct Gate(scene::Gate);

/// A frame's place and attitude.
fn pose(position: &Bound<'_, PyAny>, attitude: &Bound<'_, PyAny>) -> PyResult<Pose<Trace>> {
    Ok(Pose { position: vector::<3>("position", position)?, attitude: vector::<4>("attitude", attitude)? })
}

#[pymethods]
impl Gate {
    #[new]
    #[pyo3(signature = (**settings))]
    fn new(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let own: scene::Gate = data("gate", settings)?;
        own.validate("gate").or_raise()?;
        Ok(Self(own))
    }

    /// As scenes have it.
    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &toml::Table::try_from(&self.0).map_err(unexpected)?)
    }

    /// Radius of the bars, m.
    #[getter]
    fn radius(&self) -> f64 {
        self.0.bar_radius()
    }

    /// Half width and half height of the free opening, m.
    #[getter]
    fn opening(&self) -> [f64; 2] {
        self.0.opening()
    }

    /// Ends of the axes of the four bars for a frame that is there, m, world, [4, 2, 3].
    fn bars<'py>(
        &self,
        py: Python<'py>,
        position: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let bars = self.0.bars(&pose(position, attitude)?);
        number(py, bars.as_flattened().as_flattened(), &[4, 2, 3])
    }

    /// Distance of a point (m, world) to the bars of a frame that is there, m.
    fn distance<'py>(
        &self,
        py: Python<'py>,
        position: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        point: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.0.distance(&pose(position, attitude)?, vector::<3>("point", point)?)], &[])
    }

    /// How a straight step between two points (m, world) meets the opening of a frame that is there: its direction, 1 along x, -1 against it,
    /// 0 where it does not cross the plane, and how far inside the opening it crosses, m.
    fn passage<'py>(
        &self,
        py: Python<'py>,
        position: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        before: &Bound<'py, PyAny>,
        after: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let (before, after) = (vector::<3>("before", before)?, vector::<3>("after", after)?);
        let own = self.0.passage(&pose(position, attitude)?, before, after);
        Ok((number(py, &[own.direction], &[])?, number(py, &[own.margin], &[])?))
    }
}

/// Upright trunks in a corridor along x, that stand elsewhere in every episode: `Draws.trunks` draws where.
///
/// Parameters
/// ----------
/// **settings
///     `length` and `width` of the corridor (m), `clear` at its beginning and end (m), `trunks` (how many), `radius` (least and largest, m),
///     `height` (m), `gap` between two trunks (m), `seed` of the nominal places.
#[pyclass(module = "omnidrones", frozen)]
pub struct Forest(pub Grove);

#[pymethods]
impl Forest {
    #[new]
    #[pyo3(signature = (**settings))]
    fn new(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Ok(Self(Grove::new(data("forest", settings)?).or_raise()?))
    }

    /// The scene with its trunks at their nominal places: what a task gives as `scene`.
    #[getter]
    fn scene<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &toml::Table::try_from(self.0.scene()).map_err(unexpected)?)
    }

    /// Nominal places, m, world, float64 [trunk, 3].
    #[getter]
    fn places<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let places: Vec<f64> = self.0.trunks().iter().flat_map(|trunk| trunk.shape.position).collect();
        let n = places.len() / 3;
        array(py, places, &[n, 3])
    }

    /// Radii of the trunks, m, float64 [trunk].
    #[getter]
    fn radii<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let radii = self.0.radii();
        let n = radii.len();
        array(py, radii, &[n])
    }
}
