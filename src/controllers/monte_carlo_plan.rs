//! Many flights of one loop by a plan: which numbers vary, and how far.

use super::cascade::Rates;
use super::closed_loop::{ClosedLoop, check_latency};
use super::controller::Target;
use super::law::{ControlLaw, LawController};
use super::monte_carlo::{MonteCarlo, MonteCarloDraw, MonteCarloResult, MonteCarloSummary};
use super::reference::Reference;
use super::start::start_on;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::spatial::{exponential, multiply};
use dynamics::{Disturbance, Physics, Plant};
use rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Most flights of a plan.
pub const MAX_FLIGHTS: usize = 10_000_000;

/// What to fly many times, and what is drawn for each flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MonteCarloPlan {
    /// The reference of every flight. Default: the lemniscate.
    pub reference: Reference,
    /// Length of a flight, s; 1 to 5 million steps. Default 10.
    pub duration: f64,
    /// Errors count from here on, s. Default 2.
    pub transient: f64,
    /// Time step, integrator, effects; `disturbance` is switched on where there is wind.
    pub physics: Physics,
    /// How often each control level computes: what the controller was built for.
    pub rates: Rates,
    /// Steps by which commands act late, 0 to 1000. Default 0.
    pub latency: usize,
    /// Flights, 1 to 10 million. Default 10 000.
    pub n: usize,
    /// Numbers of the loop that vary, as [`ClosedLoop::parameter_names`] has them, each by a factor between 1 − spread and 1 + spread,
    /// with a spread in [0, 0.9]. A name without the part in front of its point stands for all that end so, each drawn for itself;
    /// `inertia` for the six of it, by one factor. Default none.
    pub vary: BTreeMap<String, f64>,
    /// Largest offset of a start from the reference, m per axis; [0, 100]. Default 0.3.
    pub position_spread: f64,
    /// Largest velocity of a start, m/s per axis; [0, 100]. Default 0.3.
    pub velocity_spread: f64,
    /// Largest roll and pitch of a start, rad; [0, 1.5]. Default 0.2.
    pub tilt_spread: f64,
    /// Largest wind, m/s, steady and level, from any side; [0, 100]. Default 0.
    pub wind: f64,
    /// Seed of the draws. Default 0.
    pub seed: u64,
    /// Confidence of the bounds, [0.5, 0.999999]. Default 0.95.
    pub confidence: f64,
}

impl Default for MonteCarloPlan {
    /// Ten thousand flights of ten seconds along the lemniscate, from starts within 0.3 m, 0.3 m/s and 0.2 rad.
    fn default() -> Self {
        Self {
            reference: Reference::Lemniscate(Default::default()),
            duration: 10.0,
            transient: 2.0,
            physics: Physics::default(),
            rates: Rates::default(),
            latency: 0,
            n: 10_000,
            vary: BTreeMap::new(),
            position_spread: 0.3,
            velocity_spread: 0.3,
            tilt_spread: 0.2,
            wind: 0.0,
            seed: 0,
            confidence: 0.95,
        }
    }
}

/// Many flights of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct MonteCarloRun {
    /// How each went, in their order.
    pub flights: Vec<MonteCarloResult>,
    /// What each was flown with: a column with name and unit per drawn number.
    pub drawn: Vec<(String, &'static str, Vec<f64>)>,
    /// All of them in a few numbers.
    pub summary: MonteCarloSummary,
}

impl MonteCarloPlan {
    /// Its physics, with the effect `disturbance` where there is wind.
    pub fn air_physics(&self) -> Physics {
        let mut physics = self.physics;
        physics.effects.disturbance |= self.wind > 0.0;
        physics
    }

    fn n_step(&self) -> Result<u64> {
        self.physics.validate()?;
        self.reference.validate()?;
        check_latency(self.latency)?;
        if !(1..=MAX_FLIGHTS).contains(&self.n) {
            return Err(Error::limit("n", self.n, format!("1 to {MAX_FLIGHTS} flights"), "10000 is usual."));
        }
        let rows = [
            ("position_spread", self.position_spread, 0.0..=100.0, "within [0, 100] m"),
            ("velocity_spread", self.velocity_spread, 0.0..=100.0, "within [0, 100] m/s"),
            ("tilt_spread", self.tilt_spread, 0.0..=1.5, "within [0, 1.5] rad"),
            ("wind", self.wind, 0.0..=100.0, "within [0, 100] m/s"),
            ("confidence", self.confidence, 0.5..=0.999_999, "within [0.5, 0.999999]"),
            ("transient", self.transient, 0.0..=self.duration, "within [0, duration] s"),
        ];
        for (what, value, range, rule) in rows {
            if !range.contains(&value) {
                return Err(Error::value(what, value, rule, "Leave it out for the default."));
            }
        }
        let steps = (self.duration / self.physics.dt).round();
        if !(1.0..=super::flight::MAX_STEPS).contains(&steps) {
            let (value, most) = (format!("{} s", self.duration), super::flight::MAX_STEPS);
            return Err(Error::limit("duration", value, format!("1 to {most} steps"), "Give seconds: 10 is usual."));
        }
        Ok(steps as u64)
    }

    /// Numbers of θ that vary by one factor each: their name, places and spread.
    fn varied(&self, names: &[String]) -> Result<Vec<(String, Vec<usize>, f64)>> {
        let mut all = Vec::new();
        for (key, spread) in &self.vary {
            if !(0.0..=0.9).contains(spread) {
                return Err(Error::value(format!("vary '{key}'"), spread, "within [0, 0.9]", "0.2 is ±20 %."));
            }
            let places = |is: &dyn Fn(&str) -> bool| (0..names.len()).filter(|k| is(&names[*k])).collect::<Vec<_>>();
            let (own, behind) = (places(&|name| name == key), format!(".{key}"));
            if !own.is_empty() {
                all.push((key.clone(), own, *spread));
            } else if key == "inertia" {
                all.push((key.clone(), places(&|name| name.starts_with("inertia_")), *spread));
            } else {
                let each = places(&|name| name.ends_with(&behind));
                if each.is_empty() {
                    return Err(Error::Unknown {
                        kind: "parameter of the loop",
                        name: key.clone(),
                        known: names.into(),
                    });
                }
                all.extend(each.into_iter().map(|k| (names[k].clone(), vec![k], *spread)));
            }
        }
        Ok(all)
    }

    /// Flies a plant under a law so many times, in lanes: the law believes what it was built for.
    ///
    /// # Errors
    /// [`Error::Value`], [`Error::Limit`] or [`Error::Unknown`] if the plan is not valid; as [`ClosedLoop::new`],
    /// [`MonteCarlo::new`] and [`Plant::hover_state`].
    pub fn fly<L: ControlLaw>(&self, plant: &Plant, law: L, threads: &Threads) -> Result<MonteCarloRun> {
        let n_step = self.n_step()?;
        let closed = ClosedLoop::new(plant.clone(), LawController::of(law))?.with_latency(self.latency)?;
        let closed = closed.with_physics().with_gains();
        if self.wind > 0.0 && !closed.plant().physics().effects.disturbance {
            return Err(Error::value("effects.disturbance", "off", "on where there is wind", "Switch it on."));
        }
        let varied = self.varied(&closed.parameter_names())?;
        let (start, root) = (start_on(plant, closed.controller(), &self.reference)?, plant.roots()[0]);
        let draw = |stream: &mut Stream, own: &mut MonteCarloDraw| self.draw(stream, own, &varied, root);
        let many = MonteCarlo::new(&closed)?.after(self.transient).seeded(self.seed);
        let apply = |stream: &mut Stream, own: &mut MonteCarloDraw| drop(draw(stream, own));
        let flights = many.fly(Target::level(&self.reference), &start, (self.n, n_step), &apply, threads)?;
        let nominal = MonteCarloDraw { start, parameters: closed.parameters(), air: Disturbance::none() };
        let rows = threads
            .map(self.n, |i| draw(&mut Stream::new(self.seed, i as u64, 0, Purpose::RESET), &mut nominal.clone()));
        let begun =
            ["position_x", "position_y", "position_z", "velocity_x", "velocity_y", "velocity_z", "roll", "pitch"];
        let units = ["m", "m", "m", "m/s", "m/s", "m/s", "rad", "rad", "m/s", "m/s"];
        let names = begun.map(|name| format!("start_{name}")).into_iter().chain(["wind_x".into(), "wind_y".into()]);
        let names = names.zip(units).chain(varied.iter().map(|(name, ..)| (format!("{name} (factor)"), "-")));
        let drawn = names.enumerate().map(|(k, (name, unit))| (name, unit, rows.iter().map(|row| row[k]).collect()));
        let summary = MonteCarloSummary::of(&flights, self.confidence);
        Ok(MonteCarloRun { flights, drawn: drawn.collect(), summary })
    }

    /// Draws one flight; what was drawn, in the order of the columns.
    fn draw(
        &self,
        stream: &mut Stream,
        own: &mut MonteCarloDraw,
        varied: &[(String, Vec<usize>, f64)],
        root: usize,
    ) -> Vec<f64> {
        let mut within = |most: f64| if most > 0.0 { stream.uniform(-most, most) } else { 0.0 };
        let spreads = [self.position_spread, self.velocity_spread];
        let mut drawn: Vec<f64> = spreads.into_iter().flat_map(|most| [most; 3]).map(&mut within).collect();
        drawn.extend([within(self.tilt_spread), within(self.tilt_spread)]);
        let (side, share) = (within(PI), 0.5 * (within(1.0) + 1.0));
        drawn.extend([self.wind * share * side.cos(), self.wind * share * side.sin()]);
        own.start[root..root + 6].iter_mut().zip(&drawn).for_each(|(x, off)| *x += off);
        let attitude = [6, 7, 8, 9].map(|k| own.start[root + k]);
        let leant = multiply(attitude, exponential([drawn[6], drawn[7], 0.0]));
        own.start[root + 6..root + 10].copy_from_slice(&leant);
        own.air.wind = [drawn[8], drawn[9], 0.0];
        for (_, places, spread) in varied {
            let factor = 1.0 + within(*spread);
            places.iter().for_each(|k| own.parameters[*k] *= factor);
            drawn.push(factor);
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade_law::CascadeLaw;
    use autodiff::System;
    use dynamics::vehicles;

    #[test]
    fn flights_of_a_plan_are_flown_with_what_its_columns_say() {
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        let vary = [("mass", 0.2), ("inertia", 0.3), ("time_constant_up", 0.1)].map(|(name, x)| (name.to_string(), x));
        let plan = MonteCarloPlan { n: 70, duration: 0.5, transient: 0.1, wind: 3.0, ..MonteCarloPlan::default() };
        let plan = MonteCarloPlan { vary: vary.into(), ..plan };
        let plant = Plant::of_vehicle(&vehicle, plan.air_physics()).unwrap();
        let law = || CascadeLaw::new(&vehicle, plant.physics(), &vehicle.gains(), &plan.rates).unwrap();
        let run = plan.fly(&plant, law(), &Threads::new(1).unwrap()).unwrap();
        assert_eq!((run.flights.len(), run.summary.lost.n), (70, 70));
        let column = |name: &str| &run.drawn.iter().find(|(own, ..)| own == name).unwrap().2;
        assert_eq!(run.drawn.len(), 8 + 2 + 1 + 1 + 4);
        let wind = |i: usize| column("wind_x")[i].hypot(column("wind_y")[i]);
        assert!((0..70).all(|i| wind(i) <= 3.0) && (0..70).any(|i| wind(i) > 2.0));
        assert!(column("mass (factor)").iter().all(|x| (0.8..1.2).contains(x)));
        // one of them, flown alone
        let i = 66;
        let closed = ClosedLoop::new(plant.clone(), law().running()).unwrap().with_physics().with_gains();
        let mut theta = closed.parameters();
        theta[closed.parameter("mass").unwrap()] *= column("mass (factor)")[i];
        let inertia = closed.parameter("inertia_xx").unwrap();
        theta[inertia..inertia + 6].iter_mut().for_each(|j| *j *= column("inertia (factor)")[i]);
        for rotor in &vehicle.rotors {
            let name = format!("{}.time_constant_up", rotor.name);
            theta[closed.parameter(&name).unwrap()] *= column(&format!("{name} (factor)"))[i];
        }
        let mut start = start_on(&plant, closed.controller(), &plan.reference).unwrap();
        let names = ["position_x", "position_y", "position_z", "velocity_x", "velocity_y", "velocity_z"];
        names.iter().enumerate().for_each(|(k, name)| start[k] += column(&format!("start_{name}"))[i]);
        let [roll, pitch] = ["start_roll", "start_pitch"].map(|name| column(name)[i]);
        let leant = multiply([6, 7, 8, 9].map(|k| start[k]), exponential([roll, pitch, 0.0]));
        start[6..10].copy_from_slice(&leant);
        let air = Disturbance { wind: [column("wind_x")[i], column("wind_y")[i], 0.0], ..Disturbance::none() };
        let (mut x, mut next) = (closed.initial_state(&start), vec![0.0; closed.n_state()]);
        let (mut input, mut sum, mut n) = (vec![0.0; closed.n_input()], 0.0, 0);
        for k in 0..=250 {
            let wanted = plan.reference.sample(k as f64 * 0.002).position;
            if k >= 50 {
                (sum, n) = (sum + (0..3).map(|a| (x[a] - wanted[a]).powi(2)).sum::<f64>(), n + 1);
            }
            closed.write_input(k, Target::level(&plan.reference), &air, &mut input);
            closed.step(&x, &input, &theta, &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        let alone = (sum / f64::from(n)).sqrt();
        assert!((run.flights[i].rmse - alone).abs() < 1e-4 * alone, "{} and {alone}", run.flights[i].rmse);
    }

    #[test]
    fn what_does_not_vary_is_named() {
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        let refused = |plan: MonteCarloPlan| {
            let law = CascadeLaw::new(&vehicle, plant.physics(), &vehicle.gains(), &plan.rates).unwrap();
            plan.fly(&plant, law, &Threads::default()).unwrap_err().to_string()
        };
        let of = |name: &str, spread: f64| MonteCarloPlan {
            n: 1,
            vary: [(name.to_string(), spread)].into(),
            ..MonteCarloPlan::default()
        };
        assert!(refused(of("mas", 0.1)).contains("did you mean 'mass'"));
        assert!(refused(of("mass", 1.1)).contains("vary 'mass' is 1.1"));
        assert!(refused(MonteCarloPlan { n: 0, ..MonteCarloPlan::default() }).contains("n is 0"));
        assert!(refused(MonteCarloPlan { wind: 1.0, ..MonteCarloPlan::default() }).contains("disturbance"));
    }
}
