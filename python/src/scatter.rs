//! Many flights from Python: one controller on thousands of plants, and from thousands of starts.

use crate::arrays::array;
use crate::control::{data, gains_of, plant};
use crate::course::Courses;
use crate::error::{OrRaise, unexpected};
use crate::law::Choice;
use crate::settings;
use omnidrones::controllers::registry::Setup;
use omnidrones::controllers::{self, MonteCarloPlan, RecoveryPlan};
use omnidrones::dynamics::Physics;
use omnidrones::error::Error;
use omnidrones::parallel::Threads;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use toml::Table;

/// Many flights of one controller on plants that differ: columns of what each was flown with and of how it went.
#[pyclass(module = "omnidrones", frozen)]
pub struct MonteCarloRun(controllers::MonteCarloRun);

#[pymethods]
impl MonteCarloRun {
    /// Columns by name with unit, new arrays [flight]: what was drawn, then "rmse [m]" and "worst [m]" (distances from the reference
    /// behind the transient), "tilt [rad]" (the largest) and "lost_at [s]" (nan where it was not).
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (dict, n) = (PyDict::new(py), self.0.flights.len());
        for (name, unit, column) in &self.0.drawn {
            dict.set_item(format!("{name} [{unit}]"), array(py, column.clone(), &[n])?)?;
        }
        let of =
            |number: fn(&controllers::MonteCarloResult) -> f64| self.0.flights.iter().map(number).collect::<Vec<_>>();
        let told = [
            ("rmse [m]", of(|own| own.rmse)),
            ("worst [m]", of(|own| own.worst)),
            ("tilt [rad]", of(|own| own.tilt)),
            ("lost_at [s]", of(|own| own.lost_at.unwrap_or(f64::NAN))),
        ];
        for (name, column) in told {
            dict.set_item(name, array(py, column, &[n])?)?;
        }
        Ok(dict)
    }

    /// In a few numbers: "lost" ("hits" of "n", with "bounds" of the share), "median" and "percentile_95" of the RMSE (m) with bounds, and
    /// the "confidence" of all bounds.
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        settings::dict(py, &Table::try_from(self.0.summary).map_err(unexpected)?)
    }

    /// Flights.
    fn __len__(&self) -> usize {
        self.0.flights.len()
    }

    fn __repr__(&self) -> String {
        let lost = self.0.summary.lost;
        format!("MonteCarloRun({} flights, {} lost)", lost.n, lost.hits)
    }
}

/// Flies thousands of plants that differ, side by side, under one controller that believes the nominal one.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
/// controller : str or ControlLaw, optional
///     One that flies in lanes: "cascade" (default), "lqi", "lqr" of a vehicle, "formation" of a configuration, or one of your own.
/// gains : dict, optional
///     As `Vehicle.gains`.
/// **plan
///     `n=10000`, `vary={"mass": 0.2, "inertia": 0.2, "thrust_coefficient": 0.1}` (factors within 1 - 0.2 and 1 + 0.2: names of
///     `Loop.parameter_names`, or what several end in behind their point), `wind=0.0` (m/s at most, steady, from any side),
///     `position_spread=0.3` (m), `velocity_spread=0.3` (m/s), `tilt_spread=0.2` (rad), `duration=10.0` (s), `transient=2.0` (s),
///     `reference`, `rates`, `latency` (steps), `physics`, `seed=0`, `confidence=0.95`.
#[pyfunction]
#[pyo3(signature = (plant, /, *, controller=None, gains=None, **plan))]
pub fn monte_carlo(
    py: Python<'_>,
    plant: &Bound<'_, PyAny>,
    controller: Option<&Bound<'_, PyAny>>,
    gains: Option<&Bound<'_, PyMapping>>,
    plan: Option<&Bound<'_, PyDict>>,
) -> PyResult<MonteCarloRun> {
    let own = Courses::of(plan)?;
    let mut plan: MonteCarloPlan = data("plan", own.plan.as_ref())?;
    own.reference.into_iter().for_each(|reference| plan.reference = reference);
    if own.wind.is_some() {
        let remedy = "Give the largest speed of a steady wind, m/s.";
        return Err(Error::value("wind", "a function", "a number", remedy)).or_raise();
    }
    let plant = self::plant(plant, plan.air_physics())?;
    let (choice, gains) = (Choice::of(controller, &plant, gains.is_some())?, gains_of(gains)?);
    let flown = || {
        let own = choice.build(&plant, &Setup::new(gains.as_ref(), &plan.rates))?;
        let Some(law) = own.recorded(&plant)? else {
            let remedy = "Take another, as 'cascade', or fly it once with fly.";
            return Err(Error::value("controller", own.name(), "a law over any scalar", remedy));
        };
        plan.fly(&plant, law, &Threads::default())
    };
    Ok(MonteCarloRun(py.detach(flown).or_raise()?))
}

/// From which attitudes and body rates a controller brings a plant back: a cell per interval of both.
#[pyclass(module = "omnidrones", frozen)]
pub struct RecoveryMap(controllers::RecoveryMap);

#[pymethods]
impl RecoveryMap {
    /// Arrays [tilt, rate] by name: "recovered" of "n" starts, "low" and "high" bounds of the share, "sunk [m]" (the most height lost by
    /// those that came back) and "slowest [s]"; "tilt [rad]" and "rate [rad/s]" are where cells begin and end, [tilt + 1] and [rate + 1].
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (dict, plan, cells) = (PyDict::new(py), &self.0.plan, &self.0.cells);
        let shape = [plan.tilt.1, plan.rate.1];
        let of = |number: fn(&controllers::RecoveryCell) -> f64| cells.iter().map(number).collect::<Vec<_>>();
        let told = [
            ("recovered", of(|cell| cell.recovered as f64)),
            ("n", of(|cell| cell.n as f64)),
            ("low", of(|cell| cell.bounds[0])),
            ("high", of(|cell| cell.bounds[1])),
            ("sunk [m]", of(|cell| cell.sunk)),
            ("slowest [s]", of(|cell| cell.slowest)),
        ];
        for (name, column) in told {
            dict.set_item(name, array(py, column, &shape)?)?;
        }
        for (name, (most, n)) in [("tilt [rad]", plan.tilt), ("rate [rad/s]", plan.rate)] {
            let edges = (0..=n).map(|k| most * k as f64 / n as f64).collect();
            dict.set_item(name, array(py, edges, &[n + 1])?)?;
        }
        Ok(dict)
    }

    /// The share of starts within a tilt (rad) and a body rate (rad/s) that came back, with its bounds: (share, low, high).
    fn within(&self, tilt: f64, rate: f64) -> (f64, f64, f64) {
        let all = self.0.within(tilt, rate);
        (all.recovered as f64 / all.n.max(1) as f64, all.bounds[0], all.bounds[1])
    }

    /// Whether starts flew side by side, in lanes.
    #[getter]
    fn batched(&self) -> bool {
        self.0.batched
    }

    fn __repr__(&self) -> String {
        let plan = &self.0.plan;
        format!("RecoveryMap({} x {} cells of {} starts)", plan.tilt.1, plan.rate.1, plan.n)
    }
}

/// Flies a plant from starts of all tilts and body rates, and counts which a controller brings back within half a metre of where it was
/// let go.
///
/// Parameters
/// ----------
/// plant : Vehicle or str or path
/// controller : str or ControlLaw, optional
///     The first that suits by default.
/// gains, rates : dict, optional
///     As of `fly`.
/// tilt, rate : tuple of float and int
///     The largest tilt (rad) and body rate (rad/s), and in how many intervals from zero.
/// speed : float
///     Of a start, at most, m/s.
/// n : int
///     Starts per cell.
/// duration : float
///     Of a flight, at most, s.
/// confidence : float
///     Of the bounds.
/// seed : int
///     Of the starts.
/// **physics
///     `dt=0.002` (s), `substeps`, `integrator`, `effects`.
#[pyfunction]
#[pyo3(signature = (
    plant, /, *, controller=None, gains=None, rates=None, tilt=(std::f64::consts::PI, 18), rate=(12.0, 6), speed=0.0, n=64, duration=6.0,
    confidence=0.95, seed=0, **physics
))]
#[expect(clippy::too_many_arguments, reason = "by name in Python")]
pub fn recovery_map(
    py: Python<'_>,
    plant: &Bound<'_, PyAny>,
    controller: Option<&Bound<'_, PyAny>>,
    gains: Option<&Bound<'_, PyMapping>>,
    rates: Option<&Bound<'_, PyDict>>,
    tilt: (f64, usize),
    rate: (f64, usize),
    speed: f64,
    n: usize,
    duration: f64,
    confidence: f64,
    seed: u64,
    physics: Option<&Bound<'_, PyDict>>,
) -> PyResult<RecoveryMap> {
    let physics: Physics = data("physics", physics)?;
    let (plant, rates) = (self::plant(plant, physics)?, data("rates", rates)?);
    let (choice, gains) = (Choice::of(controller, &plant, gains.is_some())?, gains_of(gains)?);
    let plan = RecoveryPlan { tilt, rate, speed, n, duration, confidence, seed };
    let build = || choice.build(&plant, &Setup::new(gains.as_ref(), &rates));
    let map = py.detach(|| controllers::recovery_map(&plant, &build, &plan, &Threads::default()));
    Ok(RecoveryMap(map.or_raise()?))
}
