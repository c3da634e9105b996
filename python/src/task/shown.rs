//! What a task in Python sees: a view's numbers, and what the library makes of them.

use crate::number::{number, stale, traces, vector};
use omnidrones::autodiff::{Array, Trace};
use omnidrones::dynamics::frame::Frame;
use omnidrones::dynamics::tree::Motion as JointMotion;
use omnidrones::error::Error;
use omnidrones::tasks::{self, Field, Robot};
use pyo3::prelude::*;
use std::sync::Arc;

use crate::error::OrRaise;

/// What a task sees after a step. Numbers record: they have no values until environments run.
#[pyclass(module = "omnidrones", frozen)]
pub struct View {
    robot: Arc<Robot>,
    state: Vec<Trace>,
    frames: Vec<Trace>,
    speeds_before: Vec<Trace>,
    goal: Vec<Trace>,
    task_state: Vec<Trace>,
    step: Trace,
    clock: Trace,
    goal_fields: Arc<Vec<Field>>,
    /// None while it is not known yet what the task keeps.
    kept_fields: Option<Arc<Vec<Field>>>,
}

impl View {
    pub fn of(
        view: &tasks::View<'_>,
        robot: &Arc<Robot>,
        goal: &Arc<Vec<Field>>,
        kept: &Option<Arc<Vec<Field>>>,
    ) -> Self {
        Self {
            robot: robot.clone(),
            state: view.state.to_vec(),
            frames: view.frames.to_vec(),
            speeds_before: view.speeds_before.to_vec(),
            goal: view.goal.to_vec(),
            task_state: view.task_state.to_vec(),
            step: view.step,
            clock: view.clock,
            goal_fields: goal.clone(),
            kept_fields: kept.clone(),
        }
    }

    /// As the library has it, while what it is of is being recorded.
    pub fn get(&self) -> PyResult<tasks::View<'_>> {
        if !self.step.is_live() {
            return Err(stale());
        }
        Ok(tasks::View {
            robot: &self.robot,
            state: &self.state,
            frames: &self.frames,
            speeds_before: &self.speeds_before,
            goal: &self.goal,
            task_state: &self.task_state,
            step: self.step,
            clock: self.clock,
        })
    }

    fn drone_of(&self, drone: usize) -> PyResult<usize> {
        within("drone", drone, self.robot.drones().len())
    }

    fn named(&self, fields: &[Field], numbers: &[Trace], name: &str, kind: &'static str) -> PyResult<Vec<Trace>> {
        let mut at = 0;
        for field in fields {
            if field.name == name {
                return Ok(numbers[at..at + field.size].to_vec());
            }
            at += field.size;
        }
        if fields.is_empty() {
            let told = format!("'{name}'");
            let remedy = "Write it in 'start' and 'ideal' (goal.field), or in 'remember' (out.field).";
            return Err(Error::value(format!("a {kind}"), told, "one that is written: there is none", remedy))
                .or_raise();
        }
        let known = fields.iter().map(|field| field.name.clone()).collect();
        Err(Error::Unknown { kind, name: name.into(), known }).or_raise()
    }
}

/// Refuses a number that counts beyond what there is.
pub fn within(what: &str, k: usize, n: usize) -> PyResult<usize> {
    if k < n {
        return Ok(k);
    }
    Err(Error::limit(what, k, format!("0 to {}", n.saturating_sub(1)), "They count from 0.")).or_raise()
}

/// A body of what flies, by number or name.
#[derive(FromPyObject)]
pub enum Body {
    Number(usize),
    Name(String),
}

impl Body {
    /// Its number.
    pub fn of(&self, robot: &Robot) -> PyResult<usize> {
        match self {
            Self::Number(body) => within("body", *body, robot.n_frame()),
            Self::Name(name) => {
                let bodies = robot.model().map(|model| model.bodies()).unwrap_or_default();
                bodies.iter().position(|own| own.name == *name).map_or_else(
                    || {
                        let known = bodies.iter().map(|own| own.name.clone()).collect();
                        Err(Error::Unknown { kind: "body", name: name.clone(), known }).or_raise()
                    },
                    Ok,
                )
            }
        }
    }
}

/// Places of angle or way and of rate of a hinge or slide in the state.
pub fn joint_places(robot: &Robot, name: &str) -> PyResult<[usize; 2]> {
    let Some(tree) = robot.plant().tree() else {
        return Err(Error::Unknown { kind: "joint", name: name.into(), known: Vec::new() }).or_raise();
    };
    let body = tree.model().joint(name).or_raise()?;
    if !matches!(tree.model().bodies()[body].joint.motion, JointMotion::Revolute(_) | JointMotion::Prismatic(_)) {
        let remedy = "Read or write the numbers of the state; Robot.state_names tells where they stand.";
        return Err(Error::value("joint", name, "a hinge or a slide", remedy)).or_raise();
    }
    let own = &tree.layout().bodies[body];
    Ok([own.position, own.velocity])
}

#[pymethods]
impl View {
    /// Angle (rad) or way (m) of a hinge or slide, by name, and its rate, [2].
    fn joint<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let own = joint_places(&self.robot, name)?.map(|at| self.state[at]);
        number(py, &own, &[2])
    }

    /// State of the physics, SI, in the robot's layout; `omnidrones.Robot.state_names` names the numbers.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.state, &[self.state.len()])
    }

    /// Rotor speeds before the step, rad/s, of all drones.
    #[getter]
    fn speeds_before<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.speeds_before, &[self.speeds_before.len()])
    }

    /// What stays through the episode: all numbers of the goal, in the order in which they were written.
    #[getter]
    fn goal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.goal, &[self.goal.len()])
    }

    /// What the task keeps from step to step, in the order of `remember`; zeros where an episode begins.
    #[getter]
    fn task_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.task_state, &[self.task_state.len()])
    }

    /// A field of the goal, by the name that it was written with: a number, or an array of its numbers.
    fn goal_field<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        one_or_many(py, &self.named(&self.goal_fields, &self.goal, name, "field of the goal")?)
    }

    /// A field of the task state, by the name that `remember` writes it with.
    fn kept<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let Some(fields) = &self.kept_fields else {
            // of the first call of `remember`, which tells what there is
            self.get()?;
            return number(py, &[Trace::from(0.0)], &[]);
        };
        one_or_many(py, &self.named(fields, &self.task_state, name, "field of the task state")?)
    }

    /// Steps since the episode began, k.
    #[getter]
    fn step<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.step], &[])
    }

    /// Share of the time that is over, k/T.
    #[getter]
    fn clock<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.clock], &[])
    }

    /// Drones.
    #[getter]
    fn n_drone(&self) -> usize {
        self.robot.drones().len()
    }

    /// Motion of a drone.
    #[pyo3(signature = (drone=0))]
    fn drone(&self, drone: usize) -> PyResult<Motion> {
        let drone = self.drone_of(drone)?;
        Ok(Motion(self.get()?.drone(drone)))
    }

    /// Motion of a body of what flies, by number or name.
    fn body(&self, body: Body) -> PyResult<Motion> {
        let body = body.of(&self.robot)?;
        Ok(Motion(self.get()?.frame(body)))
    }

    /// Least distance of the shapes of a tree (a drone of a team, what flies else) that touch to capsules of `radius` (m) around segments,
    /// [n, 2, 3], m, world: negative where they overlap. `Gate.bars` gives those of a gate.
    #[pyo3(signature = (segments, radius, *, tree=0))]
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        segments: &Bound<'py, PyAny>,
        radius: f64,
        tree: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let ends = traces("segments", segments, None)?;
        if !ends.len().is_multiple_of(6) {
            let remedy = "Give both ends of every segment.";
            return Err(Error::value("numbers of segments", ends.len(), "those of [n, 2, 3]", remedy)).or_raise();
        }
        let axes: Vec<_> = ends.chunks_exact(6).map(|own| [own.array(0), own.array(3)]).collect();
        let Some(least) = self.get()?.clearance(tree, &axes, radius) else {
            let remedy = "Fly a model with contact, as Robot.of_task('FlyThrough') does, or use clearance_to_columns.";
            return Err(Error::value("clearance of tree", tree, "of a model that has it", remedy)).or_raise();
        };
        number(py, &[least], &[])
    }

    /// Least distance of a drone, propellers included, to upright columns at `places` (x, y), [n, 2], m, world, that are higher than it flies,
    /// up to `most` (m); `radii` (m), [n], are constants.
    #[pyo3(signature = (places, radii, *, most=10.0, drone=0))]
    fn clearance_to_columns<'py>(
        &self,
        py: Python<'py>,
        places: &Bound<'py, PyAny>,
        radii: Vec<f64>,
        most: f64,
        drone: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let drone = self.drone_of(drone)?;
        let places = traces("places", places, Some(&[radii.len(), 2]))?;
        let places: Vec<[Trace; 2]> = places.chunks_exact(2).map(|own| own.array(0)).collect();
        let Some(least) = self.get()?.clearance_to_columns(drone, &places, &radii, most) else {
            let remedy = "Fly a vehicle, or a team of it.";
            return Err(Error::value("clearance of drone", drone, "of a drone that is a vehicle", remedy)).or_raise();
        };
        number(py, &[least], &[])
    }

    /// Speeds of a drone's rotors as shares of the largest, s, [rotor].
    #[pyo3(signature = (drone=0))]
    fn throttle<'py>(&self, py: Python<'py>, drone: usize) -> PyResult<Bound<'py, PyAny>> {
        let (drone, view) = (self.drone_of(drone)?, self.get()?);
        let all: Vec<Trace> =
            (0..self.robot.drones()[drone].rotors.len()).map(|rotor| view.throttle(drone, rotor)).collect();
        number(py, &all, &[all.len()])
    }

    /// The sum of `throttle`, e.
    #[pyo3(signature = (drone=0))]
    fn effort<'py>(&self, py: Python<'py>, drone: usize) -> PyResult<Bound<'py, PyAny>> {
        let drone = self.drone_of(drone)?;
        number(py, &[self.get()?.effort(drone)], &[])
    }

    /// The mean of exp(-e) over the drones.
    fn mean_effort_reward<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.get()?.mean_effort_reward()], &[])
    }

    /// By how much `throttle` differs from that before the step: the norm over a drone's rotors.
    #[pyo3(signature = (drone=0))]
    fn throttle_difference<'py>(&self, py: Python<'py>, drone: usize) -> PyResult<Bound<'py, PyAny>> {
        let drone = self.drone_of(drone)?;
        number(py, &[self.get()?.throttle_difference(drone)], &[])
    }
}

/// A number alone, or an array.
fn one_or_many<'py>(py: Python<'py>, numbers: &[Trace]) -> PyResult<Bound<'py, PyAny>> {
    if numbers.len() == 1 { number(py, numbers, &[]) } else { number(py, numbers, &[numbers.len()]) }
}

/// Motion of a body along world axes. Numbers record.
#[pyclass(module = "omnidrones", frozen)]
pub struct Motion(Frame<Trace>);

impl Motion {
    /// While it is being recorded.
    fn live(&self) -> PyResult<&Frame<Trace>> {
        if self.0.position[0].is_live() { Ok(&self.0) } else { Err(stale()) }
    }
}

#[pymethods]
impl Motion {
    /// Of its origin, m, world, [3].
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.0.position, &[3])
    }

    /// m/s, world, [3].
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.0.velocity, &[3])
    }

    /// Unit quaternion w, x, y, z, body to world, [4].
    #[getter]
    fn attitude<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.0.attitude, &[4])
    }

    /// rad/s, along world axes, [3].
    #[getter]
    fn angular_velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.0.angular_velocity, &[3])
    }

    /// Body x along world axes, [3].
    #[getter]
    fn heading<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.live()?.heading(), &[3])
    }

    /// Body z along world axes, [3].
    #[getter]
    fn up<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.live()?.up(), &[3])
    }

    /// Angle of the heading in the world's xy plane, rad.
    #[getter]
    fn yaw<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &[self.live()?.yaw()], &[])
    }

    /// The attitude with w >= 0, as it is observed, [4].
    #[getter]
    fn observed_attitude<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        number(py, &self.live()?.observed_attitude(), &[4])
    }

    /// Place (m) and velocity (m/s) of a point that is fixed in the body (m, body), world: two arrays [3].
    fn point<'py>(
        &self,
        py: Python<'py>,
        local: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let local = vector::<3>("local", local)?;
        let (place, velocity) = self.live()?.point(local);
        Ok((number(py, &place, &[3])?, number(py, &velocity, &[3])?))
    }
}
