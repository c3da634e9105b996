//! Where episodes of a task in Python begin, and what events change.

use super::blocks::Forest;
use super::out::Lent;
use super::shown::{Body, joint_places, within};
use crate::error::OrRaise;
use crate::number::{mask, number, traces, vector};
use omnidrones::autodiff::{Array, Trace};
use omnidrones::error::Error;
use omnidrones::tasks::written::{MOST_AGAIN, StartPad};
use omnidrones::tasks::{self, Draw, Field, Inertial, ManyDraw, Robot};
use pyo3::prelude::*;
use pyo3::types::PySlice;
use std::sync::Arc;

/// What a start is written on.
pub struct Pad {
    pub robot: Arc<Robot>,
    /// Of the goal.
    pub fields: Arc<Vec<Field>>,
    pub is_event: bool,
    pub pad: Lent<StartPad>,
}

impl Pad {
    pub fn with<R>(&self, write: impl FnOnce(&mut tasks::Start<'_>) -> PyResult<R>) -> PyResult<R> {
        self.pad.with(|pad| pad.with(&self.robot, write))
    }
}

/// The start of an episode, or an event in one: draws, and where they go. Everything stands at rest, rotors at hover, until it is changed.
#[pyclass(module = "omnidrones", frozen)]
pub struct Start(pub Arc<Pad>);

/// Draws of one stream.
#[pyclass(module = "omnidrones", frozen)]
pub struct Draws {
    pad: Arc<Pad>,
    stream: usize,
}

impl Draws {
    fn with<R>(&self, draw: impl FnOnce(&mut tasks::Draws<'_>) -> R) -> PyResult<R> {
        self.pad.with(|start| {
            Ok(draw(match self.stream {
                0 => &mut start.reset,
                1 => &mut start.task,
                _ => &mut start.once,
            }))
        })
    }

    fn one<'py>(&self, py: Python<'py>, draw: Draw) -> PyResult<Bound<'py, PyAny>> {
        let drawn = self.with(|draws| draws.number(draw))?;
        number(py, &[drawn], &[])
    }
}

#[pymethods]
impl Draws {
    /// Uniform in [0, 1).
    fn unit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.one(py, Draw::Unit)
    }

    /// Uniform between two numbers, or between two arrays number by number.
    fn uniform<'py>(
        &self,
        py: Python<'py>,
        low: &Bound<'py, PyAny>,
        high: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (low, high) = (traces("low", low, None)?, traces("high", high, None)?);
        if low.len() != high.len() {
            let remedy = "Give as many lowest numbers as highest ones.";
            return Err(Error::value("numbers of high", high.len(), format!("{}, as low has", low.len()), remedy))
                .or_raise();
        }
        let pairs = low.into_iter().zip(high);
        let drawn: Vec<Trace> = self.with(|draws| pairs.map(|(low, high)| draws.uniform(low, high)).collect())?;
        if drawn.len() == 1 { number(py, &drawn, &[]) } else { number(py, &drawn, &[drawn.len()]) }
    }

    /// Standard normal.
    fn normal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.one(py, Draw::Normal)
    }

    /// Standard normal, drawn again while it is farther from zero than `bound`, 0.1 at least.
    fn normal_within<'py>(&self, py: Python<'py>, bound: f64) -> PyResult<Bound<'py, PyAny>> {
        self.one(py, Draw::NormalWithin(bound))
    }

    /// A whole number, uniform in 0..n; with `other_than` none of these numbers, of which there are fewer than n: drawn again while it is one.
    /// That is for tasks with `start_on_host = True`.
    #[pyo3(signature = (n, *, other_than=None))]
    fn below<'py>(
        &self,
        py: Python<'py>,
        n: u64,
        other_than: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let taken = other_than.map(|given| traces("other_than", given, None)).transpose()?.unwrap_or_default();
        if taken.is_empty() {
            return self.one(py, Draw::Below(n));
        }
        if taken.len() as u64 >= n {
            let remedy = "Ask for a larger number, or leave out fewer.";
            return Err(Error::value("numbers in other_than", taken.len(), format!("below {n}"), remedy)).or_raise();
        }
        let drawn = self.with(|draws| draws.below_other_than(n, &taken))?;
        number(py, &[drawn], &[])
    }

    /// Offsets of a forest's trunks from their nominal places, m, world, [trunk, 3], of which the first `standing` stand (the nearest whole
    /// number), the others far below. For tasks with `start_on_host = True`.
    fn trunks<'py>(
        &self,
        py: Python<'py>,
        forest: &Bound<'py, Forest>,
        standing: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (grove, standing) = (&forest.get().0, traces("standing", standing, Some(&[]))?);
        let n = grove.trunks().len();
        let drawing = ManyDraw::Forest(Box::new(grove.clone()));
        let offsets = self.with(|draws| {
            let mut offsets = vec![standing[0]; 3 * n];
            draws.many(&drawing, &standing, &mut offsets);
            offsets
        })?;
        number(py, &offsets, &[n, 3])
    }

    /// Steps until something happens that comes once in `mean` >= 1 steps: 1 or more.
    fn geometric<'py>(&self, py: Python<'py>, mean: f64) -> PyResult<Bound<'py, PyAny>> {
        self.one(py, Draw::Geometric(mean))
    }

    /// With this chance a mask that holds, and a unit draw that then means something.
    fn sometimes<'py>(&self, py: Python<'py>, chance: f64) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let (holds, drawn) = self.with(|draws| draws.sometimes(chance, Draw::Unit))?;
        Ok((crate::number::truths(py, &[holds], &[])?, number(py, &[drawn], &[])?))
    }
}

#[pymethods]
impl Start {
    /// Draws of initial states.
    #[getter]
    fn reset(&self) -> Draws {
        Draws { pad: self.0.clone(), stream: 0 }
    }

    /// Draws of goals.
    #[getter]
    fn task(&self) -> Draws {
        Draws { pad: self.0.clone(), stream: 1 }
    }

    /// Draws that are the same at the start of every episode of an environment: geometry.
    #[getter]
    fn once(&self) -> Draws {
        Draws { pad: self.0.clone(), stream: 2 }
    }

    /// Share of a curriculum, 0 to 1.
    #[getter]
    fn difficulty<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.0.with(|start| Ok(start.difficulty))?], &[])
    }

    /// Step behind which `event` is called; never, unless it is set. In an event it is the step of now, and no next one comes unless it is
    /// put ahead.
    #[getter]
    fn event_at<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.0.with(|start| Ok(start.event_at))?], &[])
    }

    #[setter]
    fn set_event_at(&self, step: &Bound<'_, PyAny>) -> PyResult<()> {
        let step = traces("event_at", step, Some(&[]))?;
        self.0.with(|start| {
            start.event_at = step[0];
            Ok(())
        })
    }

    /// What stays through the episode: written by name where an episode begins, changed by place in events.
    #[getter]
    fn goal(&self) -> Goal {
        Goal(self.0.clone())
    }

    /// Numbers of the physics, SI: read and written by place.
    #[getter]
    fn state(&self) -> Part {
        Part { pad: self.0.clone(), which: Which::State }
    }

    /// What the task keeps from step to step; zeros until changed.
    #[getter]
    fn task_state(&self) -> Part {
        Part { pad: self.0.clone(), which: Which::TaskState }
    }

    /// Physical numbers of what flies, the nominal ones until changed. A change counts where the robot says that the number varies.
    #[getter]
    fn numbers(&self) -> Part {
        Part { pad: self.0.clone(), which: Which::Numbers }
    }

    /// Puts the root of a tree (a drone of a team, what flies else) at a place, m, world, with an attitude, w x y z; level without.
    #[pyo3(signature = (position, attitude=None, *, tree=0))]
    fn place(&self, position: &Bound<'_, PyAny>, attitude: Option<&Bound<'_, PyAny>>, tree: usize) -> PyResult<()> {
        let tree = within("tree", tree, self.0.robot.roots().len())?;
        let position = vector::<3>("position", position)?;
        let attitude = attitude.map(|given| vector::<4>("attitude", given)).transpose()?;
        self.0.with(|start| {
            match attitude {
                Some(attitude) => start.place(tree, position, attitude),
                None => start.place(tree, position, [1.0, 0.0, 0.0, 0.0]),
            }
            Ok(())
        })
    }

    /// Sets the velocity of the root of a tree, m/s, world.
    #[pyo3(signature = (velocity, *, tree=0))]
    fn move_at(&self, velocity: &Bound<'_, PyAny>, tree: usize) -> PyResult<()> {
        let at = self.0.robot.roots()[within("tree", tree, self.0.robot.roots().len())?];
        let velocity = vector::<3>("velocity", velocity)?;
        self.0.with(|start| {
            start.state[at + 3..at + 6].copy_from_slice(&velocity);
            Ok(())
        })
    }

    /// Uniform in a box, lowest and highest per axis, [3, 2], m, world: drawn from `reset`, [3].
    fn position<'py>(&self, py: Python<'py>, range: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let range = traces("range", range, Some(&[3, 2]))?;
        let range = [0, 1, 2].map(|i| range.array::<2>(2 * i));
        let drawn = self.0.with(|start| Ok(start.position(range)))?;
        number(py, &drawn, &[3])
    }

    /// An attitude with roll and pitch uniform within `tilt` and yaw uniform within `yaw`, rad: drawn from `reset`, w x y z.
    #[pyo3(signature = (tilt, yaw=None))]
    fn attitude<'py>(
        &self,
        py: Python<'py>,
        tilt: &Bound<'py, PyAny>,
        yaw: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let tilt = traces("tilt", tilt, Some(&[]))?[0];
        let yaw = yaw.map(|given| vector::<2>("yaw", given)).transpose()?;
        let drawn = self.0.with(|start| {
            let yaw = yaw.unwrap_or_else(|| tasks::ANY_YAW.map(Trace::from));
            Ok(start.attitude(tilt, yaw))
        })?;
        number(py, &drawn, &[4])
    }

    /// Calls `attempt()` until the mask that it returns holds, `most` times at most: what it draws is drawn again. Once in a start.
    fn again(&self, most: usize, attempt: &Bound<'_, PyAny>) -> PyResult<()> {
        if !(1..=MOST_AGAIN).contains(&most) {
            let remedy = "The last attempt stays as it is.";
            return Err(Error::limit("attempts of a start", most, format!("1 to {MOST_AGAIN}"), remedy)).or_raise();
        }
        self.0.pad.with(|pad| {
            pad.begin_again(most);
            Ok(())
        })?;
        let accepted = mask("what 'attempt' returns", &attempt.call0()?)?;
        self.0.pad.with(|pad| {
            pad.accept(accepted);
            Ok(())
        })
    }

    /// Sets angle (rad) or way (m) of a hinge or slide, by name, and its rate.
    #[pyo3(signature = (name, position, rate=None))]
    fn set_joint(&self, name: &str, position: &Bound<'_, PyAny>, rate: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let [at, rate_at] = joint_places(&self.0.robot, name)?;
        let position = traces("position", position, Some(&[]))?[0];
        let rate = rate.map(|given| traces("rate", given, Some(&[]))).transpose()?;
        self.0.with(|start| {
            start.state[at] = position;
            rate.into_iter().flatten().for_each(|rate| start.state[rate_at] = rate);
            Ok(())
        })
    }

    /// Lets all rotors turn `factor` times as fast as they do, no faster than they can: where something heavier hovers.
    fn spin_up(&self, factor: &Bound<'_, PyAny>) -> PyResult<()> {
        let factor = traces("factor", factor, Some(&[]))?[0];
        self.0.with(|start| {
            start.spin_up(factor);
            Ok(())
        })
    }

    /// Mass (kg), centre of mass (m, body) and inertia about it (kg m²: xx, yy, zz, xy, xz, yz) of a body, by number or name, as
    /// `omnidrones.Inertial`: numbers that may be changed where `Robot.varying_inertial` names the body.
    fn inertial<'py>(&self, py: Python<'py>, body: Body) -> PyResult<Bound<'py, PyAny>> {
        let body = body.of(&self.0.robot)?;
        let own = self.0.with(|start| Ok(Inertial::read(start.numbers, body)))?;
        let parts =
            (number(py, &[own.mass], &[])?, number(py, &own.center_of_mass, &[3])?, number(py, &own.inertia, &[6])?);
        py.import("omnidrones._task")?.getattr("Inertial")?.call1(parts)
    }

    /// Changes them: `start.set_inertial(body, *inertial)`.
    fn set_inertial(
        &self,
        body: Body,
        mass: &Bound<'_, PyAny>,
        center_of_mass: &Bound<'_, PyAny>,
        inertia: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let body = body.of(&self.0.robot)?;
        let own = Inertial {
            mass: traces("mass", mass, Some(&[]))?[0],
            center_of_mass: vector::<3>("center_of_mass", center_of_mass)?,
            inertia: vector::<6>("inertia", inertia)?,
        };
        self.0.with(|start| {
            own.write(start.numbers, body);
            Ok(())
        })
    }
}

/// What stays through an episode.
#[pyclass(module = "omnidrones", frozen)]
pub struct Goal(Arc<Pad>);

#[pymethods]
impl Goal {
    /// The next field where an episode begins: its name, unit (with the frame), meaning and numbers.
    #[pyo3(signature = (name, unit, meaning, numbers, *, low=f64::NEG_INFINITY, high=f64::INFINITY))]
    fn field(
        &self,
        name: String,
        unit: String,
        meaning: String,
        numbers: &Bound<'_, PyAny>,
        low: f64,
        high: f64,
    ) -> PyResult<()> {
        if self.0.is_event {
            let told = format!("'{name}' written anew");
            let remedy = format!("Write start.goal['{name}'] = numbers.");
            return Err(Error::value("the goal in an event", told, "changed by name or place", remedy)).or_raise();
        }
        let numbers = traces(&format!("'{name}'"), numbers, None)?;
        self.0.with(|start| {
            start.goal.field(name, unit, meaning).within(low, high).array(numbers);
            Ok(())
        })
    }

    fn __getitem__<'py>(&self, py: Python<'py>, at: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        self.part().__getitem__(py, at)
    }

    fn __setitem__(&self, at: &Bound<'_, PyAny>, numbers: &Bound<'_, PyAny>) -> PyResult<()> {
        self.part().__setitem__(at, numbers)
    }

    fn __len__(&self) -> PyResult<usize> {
        self.part().__len__()
    }
}

impl Goal {
    fn part(&self) -> Part {
        Part { pad: self.0.clone(), which: Which::Goal }
    }
}

/// Numbers of a start, by place.
#[pyclass(module = "omnidrones", frozen)]
pub struct Part {
    pad: Arc<Pad>,
    which: Which,
}

#[derive(Clone, Copy)]
enum Which {
    State,
    Goal,
    TaskState,
    Numbers,
}

impl Part {
    fn with<R>(&self, work: impl FnOnce(&mut [Trace]) -> PyResult<R>) -> PyResult<R> {
        self.pad.pad.with(|pad| {
            let parts = pad.parts();
            work(match self.which {
                Which::State => parts.state,
                Which::Goal => parts.goal,
                Which::TaskState => parts.task_state,
                Which::Numbers => parts.numbers,
            })
        })
    }

    /// The places that an index means.
    fn places(&self, at: &Bound<'_, PyAny>) -> PyResult<(Vec<usize>, bool)> {
        let n = self.__len__()?;
        if let (Which::Goal, Ok(name)) = (self.which, at.extract::<String>()) {
            let mut first = 0;
            for field in self.pad.fields.iter() {
                if field.name == name {
                    return Ok(((first..first + field.size).collect(), field.size > 1));
                }
                first += field.size;
            }
            let known = self.pad.fields.iter().map(|field| field.name.clone()).collect();
            return Err(Error::Unknown { kind: "field of the goal", name, known }).or_raise();
        }
        if let Ok(slice) = at.cast::<PySlice>() {
            let own = slice.indices(isize::try_from(n).unwrap_or(isize::MAX))?;
            let place = |k: usize| (own.start + own.step * k as isize) as usize;
            return Ok(((0..own.slicelength).map(place).collect(), true));
        }
        let k: isize = at.extract()?;
        let place = if k < 0 { k + n as isize } else { k };
        Ok((vec![within("place", usize::try_from(place).unwrap_or(usize::MAX), n)?], false))
    }
}

#[pymethods]
impl Part {
    fn __getitem__<'py>(&self, py: Python<'py>, at: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let (places, many) = self.places(at)?;
        let own: Vec<Trace> = self.with(|all| Ok(places.iter().map(|k| all[*k]).collect()))?;
        if many { number(py, &own, &[own.len()]) } else { number(py, &own, &[]) }
    }

    fn __setitem__(&self, at: &Bound<'_, PyAny>, numbers: &Bound<'_, PyAny>) -> PyResult<()> {
        let (places, _) = self.places(at)?;
        let numbers = traces("numbers", numbers, None)?;
        if numbers.len() != places.len() && numbers.len() != 1 {
            let limit = format!("{}, as there are places", places.len());
            return Err(Error::value("numbers to write", numbers.len(), limit, "Write one per place, or one for all."))
                .or_raise();
        }
        self.with(|all| {
            places.iter().enumerate().for_each(|(i, k)| all[*k] = numbers[if numbers.len() == 1 { 0 } else { i }]);
            Ok(())
        })
    }

    fn __len__(&self) -> PyResult<usize> {
        self.with(|all| Ok(all.len()))
    }
}
