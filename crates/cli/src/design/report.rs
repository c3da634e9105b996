//! The report of `design` as one page for a browser or a printer.

use super::figures::{self, Loops};
use super::{Arguments, Findings, loop_facts, margins_table, modes_table, reach, trim_facts};
use crate::html::html;
use crate::prelude::*;
use crate::robustness;
use crate::sheet::{gains_table, key_facts};
use crate::source::Source;
use omnidrones::controllers::design::Robustness;
use omnidrones::controllers::linear::step_figures;
use omnidrones::controllers::reference::Step;
use omnidrones::controllers::{FlightPlan, Reference, fly_vehicle};
use omnidrones::dynamics::Gains;
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::flight::FlightLog;
use omnidrones_plot::Figure;

/// When the position is told to jump, s: by then the start from rest is over.
const JUMP: f64 = 4.0;
/// How long the step is watched, s.
const WATCHED: f64 = 6.0;
/// How far it jumps, m.
const WAY: f64 = 1.0;

/// What a report is of.
pub struct Subject<'a> {
    pub arguments: &'a Arguments,
    pub source: &'a Source,
    pub gains: &'a Gains,
    /// How the gains are called.
    pub gains_name: &'a str,
    pub found: &'a Findings,
    pub loops: &'a Loops,
    pub plants: Option<&'a Robustness>,
    pub stable: bool,
}

impl Subject<'_> {
    /// The page.
    pub fn html(&self) -> Result<String> {
        let Self { arguments: a, source, found, loops, .. } = self;
        let vehicle = &source.vehicle;
        let title = format!("{}: design of the control loop", vehicle.name);
        let mut page = Page::new();
        page.title(&title, &format!("{}; omnidrones {}", source.origin, env!("CARGO_PKG_VERSION")));
        page.heading("Vehicle").facts(key_facts(vehicle));
        page.heading("Steady flight").facts(trim_facts(a, found));
        page.heading("Modes of the vehicle alone")
            .table(modes_table(&found.modes, &found.plant))
            .line(reach(&found.hidden, &found.plant));
        page.heading("Gains").table(gains_table(vehicle, &[(self.gains_name, *self.gains)]));
        page.heading("Control loop").facts(loop_facts(self.gains_name, a, found, self.stable));
        if self.stable {
            page.heading("Margins").table(margins_table(found)).line(
                "Each of the loop broken at one point while all other paths stay closed. A disk margin is a change of gain and \
                 phase at once: 0.5 stands for a factor of 0.6 to 1.67 or 28°.",
            );
        }
        if let Some(noise) = &found.noise {
            noise.tell(&mut page);
        }
        if let Some(plants) = self.plants {
            robustness::tell(&mut page, plants);
        }
        let plane = Figure::new("").size(1000.0, 500.0).grid(&[1.0, 1.0], &[1.0]);
        let poles = figures::poles(&found.poles, found.model.dt * found.model.period() as f64);
        let plane = plane.place((0, 0), (1, 1), loops.nyquist()).place((1, 0), (1, 1), poles);
        page.heading("Stability").figure(plane.svg()?);
        steps(&mut page, &self.plan(), &mut |plan| {
            Ok(fly_vehicle(&self.source.vehicle, self.gains, plan, &mut |_| {})?.log)
        })?;
        page.heading("Loop and sensitivity").figure(loops.bode(&vehicle.name).svg()?);
        Ok(html(&page))
    }

    /// How the steps are flown.
    fn plan(&self) -> FlightPlan {
        let a = self.arguments;
        let wind = match a.wind.as_deref() {
            Some(&[x, y, z]) => Wind::Constant { velocity: [x, y, z] },
            _ => Wind::Calm,
        };
        FlightPlan {
            physics: a.flyer.flight.physics(),
            rates: a.flyer.flight.rates(),
            latency: a.latency,
            wind,
            filters: self.found.filters.clone(),
            ..FlightPlan::default()
        }
    }
}

/// Steps of the position along the way and upwards from rest, flown by the whole model.
pub fn steps(page: &mut Page, plan: &FlightPlan, fly: &mut dyn FnMut(&FlightPlan) -> Result<FlightLog>) -> Result<()> {
    let mut figure = Figure::new("").size(1000.0, 300.0).grid(&[1.0, 1.0], &[1.0]);
    let mut facts = Vec::new();
    for (column, (axis, way)) in [(0, "forward"), (2, "upward")].into_iter().enumerate() {
        let mut step = Step { time: JUMP, ..Step::default() };
        step.to = step.from;
        step.to[axis] += WAY;
        let log = fly(&FlightPlan { reference: Reference::Step(step), duration: JUMP + WATCHED, ..plan.clone() })?;
        let title = format!("A step of {WAY} m {way}");
        facts.push(figures_of(&title, &log, axis));
        figure = figure.place((column, 0), (1, 1), figures::step(&title, &log, axis, JUMP));
    }
    page.heading("Step of the position").figure(figure.svg()?).facts(facts);
    page.line("Flown by the whole model, with limits of rotors and tilt; the margins are of its linear form.");
    Ok(())
}

/// Rise, settling and overshoot, as of the last value flown.
fn figures_of(title: &str, log: &FlightLog, axis: usize) -> Fact {
    let after = log.time.iter().zip(&log.position).filter(|(t, _)| **t >= JUMP);
    let (times, values): (Vec<f64>, Vec<f64>) = after.map(|(t, p)| (t - JUMP, p[axis])).unzip();
    let start = values.first().copied().unwrap_or_default();
    let Ok(step) = step_figures(&times, &values, start) else { return Fact::new(title, "–").note("was not flown") };
    let seconds = |t: f64| if t.is_finite() { format!("{} s", short(t, 3)) } else { "never".into() };
    Fact::new(title, format!("{} to rise", seconds(step.rise_time))).note(format!(
        "10 to 90 % of the way; within 2 % of its end after {}, overshoot {} %",
        seconds(step.settling_time),
        number(100.0 * step.overshoot, 1)
    ))
}
