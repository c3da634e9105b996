//! Controllers written in Python: called once, with numbers that record, and flown as the library's own from then on. And what the
//! library's cascade is made of, for those who write theirs of its parts.

use crate::arrays::array;
use crate::control::{data, vehicle};
use crate::error::OrRaise;
use crate::number::{number, traces, truths};
use crate::system::Parameters;
use omnidrones::autodiff::{Scalar, Trace};
use omnidrones::controllers::attitude::{self, AttitudeCommand};
use omnidrones::controllers::closed_loop::command_places;
use omnidrones::controllers::law::LawInput;
use omnidrones::controllers::rate::{self, RateCommand};
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::velocity::{self, VelocityCommand};
use omnidrones::controllers::{
    CascadeModel, Controller, GainSet, Kinematics, LawController, LawDescription, WrittenLaw, default_controller,
};
use omnidrones::dynamics::spatial::{rotate, rotate_back, scale};
use omnidrones::dynamics::vehicle::MAX_ROTORS;
use omnidrones::dynamics::{self, Physics, Plant};
use omnidrones::error::Error;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

const PYTHON: &str = "omnidrones._law";

/// What Python raised, or the library answered.
pub struct Raised(PyErr);

impl From<Error> for Raised {
    fn from(error: Error) -> Self {
        Self(Err::<(), _>(error).or_raise().expect_err("an error"))
    }
}

impl From<Raised> for PyErr {
    fn from(raised: Raised) -> Self {
        raised.0
    }
}

impl From<PyErr> for Raised {
    fn from(raised: PyErr) -> Self {
        Self(raised)
    }
}

/// The controller of an argument.
pub enum Choice {
    /// The first that suits.
    Default,
    /// By its name in the registry.
    Named(String),
    /// Of Python.
    Written(Box<WrittenLaw>),
}

impl Choice {
    /// Of a name, a `ControlLaw`, or neither. One of Python has gains of its own: `has_gains` says whether there are others.
    pub fn of(given: Option<&Bound<'_, PyAny>>, plant: &Plant, has_gains: bool) -> PyResult<Self> {
        let Some(given) = given else { return Ok(Self::Default) };
        if let Ok(name) = given.extract::<String>() {
            return Ok(Self::Named(name));
        }
        if has_gains {
            let remedy = "Set them in the ControlLaw.";
            return Err(Error::value("gains", "given", "left out beside a controller of your own", remedy)).or_raise();
        }
        Ok(Self::Written(Box::new(written(given, plant)?)))
    }

    /// That of Python, where it is one.
    pub fn written(&self) -> Option<&WrittenLaw> {
        if let Self::Written(law) = self { Some(law) } else { None }
    }

    pub fn build(&self, plant: &Plant, setup: &Setup<'_>) -> Result<Box<dyn Controller>, Error> {
        match self {
            Self::Default => default_controller(plant, setup),
            Self::Named(name) => controller(name, plant, setup),
            Self::Written(law) => Ok(Box::new(LawController::of(WrittenLaw::clone(law)))),
        }
    }
}

/// What Python says of a law beside its tick.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Told<'py> {
    name: String,
    description: String,
    rate: Option<f64>,
    levels: Vec<(String, f64)>,
    gains: Bound<'py, PyAny>,
    memory: Option<Bound<'py, PyAny>>,
}

/// Records a controller of Python for a plant.
pub fn written(given: &Bound<'_, PyAny>, plant: &Plant) -> PyResult<WrittenLaw> {
    let (py, python) = (given.py(), given.py().import(PYTHON)?);
    let told: Told<'_> = python.call_method1("_told", (given,))?.extract()?;
    let gains = Parameters::of("gains of the controller", &told.gains)?;
    let memory = told.memory.as_ref().map(|own| Parameters::of("memory of the controller", own)).transpose()?;
    let names = gains.names.iter().map(|name| format!("gains.{name}"));
    let about = LawDescription {
        gains: names.zip(gains.nominal.iter().copied()).collect(),
        memory: memory.as_ref().map_or_else(Vec::new, |memory| memory.nominal.clone()),
        levels: told.levels.iter().map(|(_, rate)| *rate).collect(),
        name: told.name,
        description: told.description,
        rate: told.rate,
    };
    let period = about.rate.map_or(plant.physics().dt, f64::recip);
    let n_command = command_places(plant).len();
    let speeds: Vec<usize> = plant.rotor_places().iter().map(|rotor| rotor.speed).collect();
    let tick = |now: &LawInput<'_, Trace>, held: &[Trace]| -> Result<(Vec<Trace>, Vec<Trace>), Raised> {
        let seen = PyDict::new(py);
        seen.set_item("state", number(py, now.state, &[now.state.len()])?)?;
        seen.set_item("root", plant.roots()[0])?;
        seen.set_item("speeds", &speeds)?;
        seen.set_item("target", number(py, now.target, &[now.target.len()])?)?;
        let due = PyDict::new(py);
        for ((name, _), tick) in told.levels.iter().zip(now.ticks) {
            due.set_item(name, truths(py, &[Trace::constant(0.5).lt(*tick)], &[])?)?;
        }
        seen.set_item("due", due)?;
        seen.set_item("gains", gains.passed(py, now.parameters)?)?;
        seen.set_item("period", period)?;
        let passed = memory.as_ref().map(|memory| memory.passed(py, held)).transpose()?;
        let (commands, new) = python.call_method1("_ticked", (given, seen, passed))?.extract()?;
        let commands: Bound<'_, PyAny> = commands;
        let new: Option<Bound<'_, PyAny>> = new;
        let commands = traces("what the tick commands", &commands, Some(&[n_command]))?;
        let new = match (&memory, new) {
            (Some(memory), Some(new)) => memory.read("the memory of the tick", &new)?,
            _ => Vec::new(),
        };
        Ok((new, commands))
    };
    WrittenLaw::new(about, plant, tick).map_err(|raised| raised.0)
}

/// Gains of a law of Python by the names that it gave them.
pub fn gains_as_given<'py>(law: &Bound<'py, PyAny>, values: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    let py = law.py();
    py.import(PYTHON)?.call_method1("_gains_of", (law, array(py, values.to_vec(), &[values.len()])?))
}

/// What the library's cascade believes of a vehicle, and its levels as functions of recorded numbers: for a `ControlLaw` that is made of
/// them.
///
/// Parameters
/// ----------
/// vehicle : Vehicle or str or path
/// **physics
///     `effects`: drag that is not simulated is not fed forward.
///
/// An attitude command is 16 numbers: thrust along body z (N), wanted attitude by rows (body to world), its angular velocity (rad/s) and
/// angular acceleration (rad/s^2) in its own axes. A rate command is 7: thrust, angular velocity, angular acceleration, body axes.
#[pyclass(module = "omnidrones", frozen)]
pub struct CascadeParts {
    model: CascadeModel<f64, MAX_ROTORS>,
    n_rotor: usize,
}

fn vector(what: &str, given: &Bound<'_, PyAny>) -> PyResult<[Trace; 3]> {
    fixed(what, given)
}

fn fixed<const N: usize>(what: &str, given: &Bound<'_, PyAny>) -> PyResult<[Trace; N]> {
    let own = traces(what, given, Some(&[N]))?;
    own.try_into().map_err(|_| PyTypeError::new_err(format!("{what} must be {N} numbers.")))
}

impl CascadeParts {
    fn traced(&self) -> CascadeModel<Trace, MAX_ROTORS> {
        CascadeModel::constant(&self.model)
    }

    /// Gains of two levels; the others play no part.
    fn gains(
        &self,
        velocity: Option<[Trace; 3]>,
        attitude: Option<[Trace; 3]>,
        rate: Option<[Trace; 3]>,
    ) -> GainSet<Trace> {
        let own = self.traced().gains;
        GainSet {
            velocity: velocity.unwrap_or(own.velocity),
            attitude: attitude.unwrap_or(own.attitude),
            rate: rate.unwrap_or(own.rate),
            ..own
        }
    }
}

fn square<'py>(py: Python<'py>, rows: [[f64; 3]; 3]) -> PyResult<Bound<'py, PyAny>> {
    array(py, rows.concat(), &[3, 3])
}

#[pymethods]
impl CascadeParts {
    #[new]
    #[pyo3(signature = (vehicle, /, **physics))]
    fn new(vehicle: &Bound<'_, PyAny>, physics: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let (vehicle, physics): (dynamics::Vehicle, Physics) = (self::vehicle(vehicle)?, data("physics", physics)?);
        let law = omnidrones::controllers::CascadeLaw::new(&vehicle, &physics, &vehicle.gains(), &Default::default());
        Ok(Self { model: *law.or_raise()?.model(), n_rotor: vehicle.n_rotor() })
    }

    /// kg.
    #[getter]
    fn mass(&self) -> f64 {
        self.model.body.mass
    }

    /// m/s^2.
    #[getter]
    fn gravity(&self) -> f64 {
        self.model.body.gravity
    }

    /// About the centre of mass, axes in which it hovers level, float64 [3, 3], kg m^2.
    #[getter]
    fn inertia<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        square(py, self.model.body.inertia)
    }

    /// Largest thrust per rotor, float64 [rotor], N.
    #[getter]
    fn max_thrust<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.model.max_thrust[..self.n_rotor].to_vec(), &[self.n_rotor])
    }

    /// Thrusts per [F_z, M_x, M_y, M_z], float64 [rotor, 4]: what `actions` distributes by.
    #[getter]
    fn mixer<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.model.mixer[..self.n_rotor].concat(), &[self.n_rotor, 4])
    }

    /// The memory of the cascade before its first tick, by name: "attitude" [16], "rate" [7], "rotors" [rotor].
    #[getter]
    fn memory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (held, dict) = (self.model.initial(), PyDict::new(py));
        let (mut attitude, mut rate) = ([0.0; 16], [0.0; 7]);
        held.attitude.write(&mut attitude);
        held.rate.write(&mut rate);
        dict.set_item("attitude", array(py, attitude.to_vec(), &[16])?)?;
        dict.set_item("rate", array(py, rate.to_vec(), &[7])?)?;
        dict.set_item("rotors", array(py, held.rotors[..self.n_rotor].to_vec(), &[self.n_rotor])?)?;
        Ok(dict)
    }

    /// Attitude [4] and angular velocity [3] of the axes in which the vehicle hovers level, of those of its body.
    fn upright<'py>(
        &self,
        py: Python<'py>,
        attitude: &Bound<'py, PyAny>,
        angular_velocity: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let still = Kinematics::at_rest([Trace::zero(); 3]);
        let (attitude, angular_velocity) =
            (fixed("attitude", attitude)?, vector("angular_velocity", angular_velocity)?);
        let own = self.traced().own(&Kinematics { attitude, angular_velocity, ..still });
        Ok((number(py, &own.attitude, &[4])?, number(py, &own.angular_velocity, &[3])?))
    }

    /// The acceleration that balances linear drag at a velocity [3], m/s, world, or its derivatives at those of the velocity.
    fn drag<'py>(
        &self,
        py: Python<'py>,
        attitude: &Bound<'py, PyAny>,
        velocity: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (q, v): ([Trace; 4], _) = (fixed("attitude", attitude)?, vector("velocity", velocity)?);
        let body = self.traced().body;
        let (per_mass, turned) = (scale(body.mass.recip(), body.drag), rotate_back(q, v));
        number(py, &rotate(q, [0, 1, 2].map(|k| per_mass[k] * turned[k])), &[3])
    }

    /// The attitude command [16] that follows a velocity command: `velocity` (m/s), feed-forward `acceleration`, `jerk` and `snap` [3],
    /// world, and `yaw` with its rate and acceleration [3], at the measured `attitude` and `measured` velocity, with gains [3] of velocity.
    #[pyo3(signature = (gains, *, velocity, acceleration, jerk, snap, yaw, attitude, measured))]
    #[expect(clippy::too_many_arguments, reason = "by name in Python")]
    fn attitude_command<'py>(
        &self,
        py: Python<'py>,
        gains: &Bound<'py, PyAny>,
        velocity: &Bound<'py, PyAny>,
        acceleration: &Bound<'py, PyAny>,
        jerk: &Bound<'py, PyAny>,
        snap: &Bound<'py, PyAny>,
        yaw: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        measured: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let [yaw, yaw_rate, yaw_acceleration] = vector("yaw", yaw)?;
        let command = VelocityCommand {
            velocity: vector("velocity", velocity)?,
            acceleration: vector("acceleration", acceleration)?,
            jerk: vector("jerk", jerk)?,
            snap: vector("snap", snap)?,
            yaw,
            yaw_rate,
            yaw_acceleration,
        };
        let still = Kinematics::at_rest([Trace::zero(); 3]);
        let state =
            Kinematics { attitude: fixed("attitude", attitude)?, velocity: vector("measured", measured)?, ..still };
        let (model, gains) = (self.traced(), self.gains(Some(vector("gains", gains)?), None, None));
        let found = velocity::attitude_command(&gains, &model.body, &model.limits, &command, &state);
        let mut flat = [Trace::zero(); 16];
        found.write(&mut flat);
        number(py, &flat, &[16])
    }

    /// The rate command [7] that follows an attitude command [16], with gains [3] of attitude and of rate.
    fn rate_command<'py>(
        &self,
        py: Python<'py>,
        attitude_gains: &Bound<'py, PyAny>,
        rate_gains: &Bound<'py, PyAny>,
        command: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        angular_velocity: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let own = [vector("attitude_gains", attitude_gains)?, vector("rate_gains", rate_gains)?];
        let gains = self.gains(None, Some(own[0]), Some(own[1]));
        let command = AttitudeCommand::read(&fixed::<16>("command", command)?);
        let (q, w) = (fixed("attitude", attitude)?, vector("angular_velocity", angular_velocity)?);
        let mut flat = [Trace::zero(); 7];
        attitude::rate_command(&gains, &command, q, w).write(&mut flat);
        number(py, &flat, &[7])
    }

    /// Force along body z and moments [4] that follow a rate command [7], with gains [3] of rate.
    fn wrench<'py>(
        &self,
        py: Python<'py>,
        rate_gains: &Bound<'py, PyAny>,
        command: &Bound<'py, PyAny>,
        attitude: &Bound<'py, PyAny>,
        velocity: &Bound<'py, PyAny>,
        angular_velocity: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let gains = self.gains(None, None, Some(vector("rate_gains", rate_gains)?));
        let (command, model) = (RateCommand::read(&fixed::<7>("command", command)?), self.traced());
        let w = vector("angular_velocity", angular_velocity)?;
        let m = rate::moment(&gains, model.body.inertia, &command, w);
        let turned = rotate_back(fixed("attitude", attitude)?, vector("velocity", velocity)?);
        let drag = dynamics::spatial::mat_vec(model.body.drag_moment, turned);
        let m = dynamics::spatial::add(m, drag);
        number(py, &[command.thrust, m[0], m[1], m[2]], &[4])
    }

    /// Rotor actions in [-1, 1] for a wrench [F_z, M_x, M_y, M_z] (N, N m; body); yaw gives way first.
    fn actions<'py>(&self, py: Python<'py>, wrench: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let actions = self.traced().actions(fixed("wrench", wrench)?);
        number(py, &actions[..self.n_rotor], &[self.n_rotor])
    }

    fn __repr__(&self) -> String {
        format!("CascadeParts({} rotors, {} kg)", self.n_rotor, self.model.body.mass)
    }
}

/// The sine of the angle between a wanted and a measured attitude, body to world [3, 3], times its axis, body [3]; beyond 90 degrees
/// the axis.
#[pyfunction]
pub fn attitude_error<'py>(
    py: Python<'py>,
    desired: &Bound<'py, PyAny>,
    actual: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let read = |what: &str, given: &Bound<'py, PyAny>| -> PyResult<[[Trace; 3]; 3]> {
        let own = traces(what, given, Some(&[3, 3]))?;
        Ok([0, 1, 2].map(|i| [0, 1, 2].map(|j| own[3 * i + j])))
    };
    let error = attitude::attitude_error(read("desired", desired)?, read("actual", actual)?);
    number(py, &error, &[3])
}
