//! Derivatives of what was flown: certificates at one step, the gradient of the error through all of them.

use crate::prelude::*;
use omnidrones::autodiff::{Certificate, CertificateBounds, JacobianScratch, System};
use omnidrones::controllers::design::{GainSensitivity, LoopModel, Stability, TrimTarget, gain_sensitivity, trim};
use omnidrones::controllers::reference::Hover;
use omnidrones::controllers::{ClosedLoop, Flight, FlightPlan, Reference, SmoothPoint, Target};
use omnidrones::dynamics::{Disturbance, Gains, Plant, Vehicle};
use omnidrones::internals::Certified;
use std::time::Instant;

/// What is said of a step that lies on a kink.
const KINK: &str = "  the flown step lies on a kink: motors at the speed they are commanded have one lag up and another down, or a command is at \
                    its limit; judged beside it, with speeds moved by 2 % of the largest";

/// One system's Jacobian at a point, derived three ways.
struct Row {
    what: &'static str,
    rows: usize,
    columns: usize,
    time: f64,
    certificate: Certificate,
}

/// Certificates at the point of the flight farthest from kinks, and the gradient of its error through all of it.
#[derive(Default)]
pub struct Derivatives {
    certificates: Vec<Row>,
    /// And the seconds it took.
    pub through: Option<(GainSensitivity, f64)>,
    /// What was left out, and why.
    pub left_out: Vec<String>,
    /// Whether the flown step lies on a kink, and the certificates beside it.
    beside_kink: bool,
}

impl Derivatives {
    /// Of a flight among obstacles: gradients would pass through whatever it touched.
    pub fn none() -> Self {
        let remark = "what was flown is not the vehicle alone: fly without --scene for derivatives";
        Self { left_out: vec![remark.into()], ..Self::default() }
    }

    /// Of a flight of a vehicle with these gains.
    pub fn of(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan, flight: &Flight) -> Result<Self> {
        let mut d = Self::default();
        if flight.diverged_at.is_some() {
            d.left_out.push("the flight diverged: there is no finite point to differentiate at".into());
            return Ok(d);
        }
        if !plan.failures.is_empty() {
            d.left_out.push("the control law switches at a failure: fly without --fail for derivatives".into());
            return Ok(d);
        }
        if plan.estimator.is_some() {
            d.left_out.push("all of them are of the loop on the true state: the estimator has no part in them".into());
        }
        if plan.latency > 0 {
            d.left_out.push("steps whose commands act late are not certified: fly without --latency".into());
            d.go_through(vehicle, gains, plan)?;
            return Ok(d);
        }
        if flight.smoothest.margin < 0.0 {
            d.left_out.push("no step lies away from every kink: there is no point to differentiate at".into());
            return Ok(d);
        }
        let system = ClosedLoop::of_vehicle(vehicle, plan.air_physics(), gains, &plan.rates)?
            .with_filters(&plan.filters)?
            .with_gains();
        let (plant, mut outside) = (system.plant(), vec![0.0; system.n_input()]);
        let beside = flight.smoothest.beside_kinks(plant);
        d.beside_kink = beside.is_some();
        let SmoothPoint { step, state, input, air, .. } = beside.as_ref().unwrap_or(&flight.smoothest);
        system.write_input(*step, Target { reference: &plan.reference, tilt: &plan.tilt }, air, &mut outside);
        let body = &state[..plant.n_state()];
        let step = d.small_enough(certified("one step of the vehicle", plant, [body, input, &[]]))?;
        let closed = certified("one step of the closed loop", &system, [state, &outside, &system.parameters()]);
        let closed = d.small_enough(closed)?;
        d.certificates.extend(step.into_iter().chain(closed));
        d.go_through(vehicle, gains, plan)?;
        Ok(d)
    }

    /// Finds the gradient through the whole flight.
    fn go_through(&mut self, vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan) -> Result<()> {
        if let Some(growth) = unstable(vehicle, gains, plan)? {
            self.left_out.push(format!(
                "the gradient through the flight: about hover the loop is not stable ({growth}), so that it tells nothing; \
                 'omnidrones design' says more"
            ));
            return Ok(());
        }
        let start = Instant::now();
        let through = self.small_enough(gain_sensitivity(vehicle, gains, plan))?;
        self.through = through.map(|s| (s, start.elapsed().as_secs_f64()));
        Ok(())
    }

    /// `None` with a remark where something is too large to record, or a gain is zero.
    fn small_enough<T>(&mut self, result: Result<T>) -> Result<Option<T>> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(e @ (Error::Limit { .. } | Error::Value { .. })) => {
                let reason = e.to_string();
                if !self.left_out.contains(&reason) {
                    self.left_out.push(reason);
                }
                Ok(None)
            }
            Err(e) => Err(e),
        }
    }

    /// The gain whose relative change moves the RMSE most, in words.
    fn gradient_line(&self) -> Option<String> {
        let (s, time) = self.through.as_ref()?;
        let g = &s.gradient;
        let named = [("position", g.position), ("velocity", g.velocity), ("attitude", g.attitude), ("rate", g.rate)];
        let levels = named.iter().flat_map(|(n, v)| ["x", "y", "z"].into_iter().zip(v).map(move |(a, x)| (*n, a, *x)));
        let learnt = ["of force", "of moment"].into_iter().zip(g.integral).map(|(of, x)| ("integral", of, x));
        let all = levels.chain(learnt);
        let (name, axis, most) = all.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))?;
        Some(format!(
            "  gradient of the RMSE of the whole flight, its start included, over {} gains, backwards through {} closed-loop steps: {}\n  \
             most felt: {name} gain {axis}, {:+.2} mm for 10 % more",
            g.flat().len(),
            s.steps,
            duration(*time),
            most * 1.1_f64.ln() * 1e3
        ))
    }

    /// The section of a page.
    pub fn page(&self, page: &mut Page) {
        page.heading("Derivatives of what was flown");
        if !self.certificates.is_empty() {
            page.table(self.table());
            page.line(self.remark());
            if self.beside_kink {
                page.prose(KINK);
            }
        }
        if let Some(line) = self.gradient_line() {
            page.paragraph(&line);
        }
        for remark in &self.left_out {
            page.line(format!("  left out: {remark}"));
        }
    }

    fn table(&self) -> Table {
        Table::new("Jacobian of | >size | >time | >adjoint − duals | >duals − differences | >Taylor order | ").filled(
            self.certificates.iter().map(|row| {
                let c = &row.certificate;
                let order = c.taylor_order.map_or_else(|| "affine".into(), |order| number(order, 3));
                [
                    row.what.to_string(),
                    format!("{} × {}", row.rows, row.columns),
                    duration(row.time),
                    format!("{:.0e}", c.adjoint_error),
                    format!("{:.0e}", c.difference_error),
                    order,
                    if c.holds(CertificateBounds::default()) { "certified".into() } else { "NOT HELD".to_string() },
                ]
            }),
        )
    }

    fn remark(&self) -> String {
        let broken = || self.certificates.iter().filter(|r| !r.certificate.holds(CertificateBounds::default()));
        match (broken().next(), broken().find(|r| r.certificate.kinks > 0)) {
            (None, _) => {
                "  reverse adjoint, forward duals and finite differences agree (relative); order 2 is exact".into()
            }
            (_, Some(row)) => format!(
                "  not held: {} of {} columns meet a kink here, where there is no derivative (a limit, a switch): fly another reference",
                row.certificate.kinks, row.columns
            ),
            _ => "  not held: a derivative is wrong".into(),
        }
    }

    /// For JSON.
    pub fn json(&self) -> Value {
        let row = |r: &Row| {
            json!({
                "of": r.what,
                "rows": r.rows,
                "columns": r.columns,
                "time": r.time,
                "adjoint_error": r.certificate.adjoint_error,
                "difference_error": r.certificate.difference_error,
                "taylor_order": r.certificate.taylor_order,
                "value_error": r.certificate.value_error,
                "kinks": r.certificate.kinks,
                "beside_kink": self.beside_kink,
                "holds": r.certificate.holds(CertificateBounds::default()),
            })
        };
        self.certificates.iter().map(row).collect()
    }
}

/// How a loop that is not stable about hover behaves there: gradients through it grow as it does.
fn unstable(vehicle: &Vehicle, gains: &Gains, plan: &FlightPlan) -> Result<Option<String>> {
    let physics = plan.air_physics();
    let Ok(trim) = trim(&Plant::of_vehicle(vehicle, physics)?, &TrimTarget::hover()) else { return Ok(None) };
    let hover = Reference::Hover(Hover { position: [0, 1, 2].map(|k| trim.state[k]), yaw: 0.0 });
    let closed = ClosedLoop::of_vehicle(vehicle, physics, gains, &plan.rates)?
        .with_filters(&plan.filters)?
        .with_latency(plan.latency)?;
    let model = match LoopModel::of_vehicle(closed, Target::level(&hover), &Disturbance::none(), &trim.state) {
        Ok(model) => model,
        Err(Error::Value { value, .. }) => return Ok(Some(value)),
        Err(e) => return Err(e),
    };
    Ok(match model.stability()? {
        Stability::Unstable { growth, .. } => Some(format!("it grows by e in {} s", short(growth.recip(), 3))),
        Stability::Stable | Stability::Marginal(_) => None,
    })
}

fn certified<F: Certified>(what: &'static str, system: &F, point: [&[f64]; 3]) -> Result<Row> {
    let certificate = system.certify(point)?;
    let (rows, columns) = (system.n_state(), point.iter().map(|part| part.len()).sum());
    let mut scratch = JacobianScratch::new(system);
    let mut entries = vec![0.0; rows * columns];
    // the best of a few: other work on the machine only adds
    let mut time = f64::INFINITY;
    for _ in 0..50 {
        let start = Instant::now();
        system.jacobian(point, &mut scratch, &mut entries);
        time = time.min(start.elapsed().as_secs_f64());
    }
    Ok(Row { what, rows, columns, time, certificate })
}
