//! Model predictive control about hover, where no bound acts: a linear feedback, with its poles and margins.
//!
//! There the first input of a plan is u = u₀ + K (x ⊖ x₀), with K of the first stage of the Riccati recursion. The plant answers in
//! steps of a tick, δ⁺ = A δ + B v, so that the poles are those of A + B K, the loop cut at all inputs is L(z) = −K (zI − A)⁻¹ B, and cut
//! at input i Lᵢ(z) = −Kᵢ (zI − A − Σⱼ≠ᵢ Bⱼ Kⱼ)⁻¹ Bᵢ. Estimate and latency are left out: the plan begins where commands act.

use super::mpc::{Mpc, with_disturbance};
use super::planned_plant::PlannedPlant;
use super::qp_solver::QpStatus;
use super::tracking_cost::TrackingWeights;
use crate::kinematics::Kinematics;
use crate::linear::{Margins, Signal, StateSpace, eigenvalues, margins};
use autodiff::{System, linearise};
use base::error::{Error, Result};
use dynamics::{Physics, Plant};
use nalgebra::{Complex, DMatrix};

/// Largest step of a plan that stays at hover.
const AT_REST: f64 = 1e-6;

/// An [`Mpc`] about hover.
#[derive(Debug, Clone)]
pub struct LinearMpc {
    /// K, n_input × n_error: from errors of the planned state to planned inputs.
    pub gain: DMatrix<f64>,
    /// δ⁺ = A δ + B v of a tick, inputs and errors named.
    pub plant: StateSpace,
    /// Of the closed loop per tick, largest modulus first.
    pub poles: Vec<Complex<f64>>,
    /// Of the loop cut at each input, the others closed, with its name.
    pub margins: Vec<(String, Margins)>,
    /// Of a tick, s.
    pub period: f64,
}

impl Mpc {
    /// The feedback about hover.
    ///
    /// # Errors
    /// As [`margins`], and as the plant under the tick's period; [`Error::Value`] where a plan at hover does not stay there, or a bound
    /// acts on it.
    pub fn linear(&self) -> Result<LinearMpc> {
        let (planned, period) = (self.planned(), self.period());
        let (hover, inputs) = planned.hover()?;
        let mut iteration = self.iteration().clone();
        let stages = iteration.problem().n_stage();
        let mut row = vec![0.0; iteration.problem().model().n_parameter()];
        let (first, none) = (planned.n_parameter(), TrackingWeights::zero());
        // place and velocity of what is tracked, attitude and rates of the root
        let Kinematics { position, velocity, .. } = self.cost().tracked(&hover);
        let held = Kinematics { position, velocity, ..Kinematics::read(&hover) };
        for stage in 0..=stages {
            let is_free = stage == stages && self.settings().endless;
            let weights = if is_free { &none } else { &self.settings().weights };
            self.cost().write_parameters(&held, &inputs, weights, &mut row[first..]);
            iteration.problem_mut().set_parameters(stage, &row)?;
        }
        iteration.begin_at_rest(&hover, &inputs)?;
        let report = iteration.tick(&hover, 3, 0.0);
        let at_bound = (0..inputs.len()).filter(|i| iteration.solver().gain(0).row(*i).amax() == 0.0).count();
        if report.qp.status != QpStatus::Solved || report.step > AT_REST || at_bound > 0 {
            let (status, step) = (report.qp.status, report.step);
            let told = format!("{status:?}, {step:.1e} away, {at_bound} inputs at a bound");
            let remedy = "Give it weights and bounds under which hover is the best plan.";
            return Err(Error::value("plan at hover", told, "solved, at hover, free", remedy));
        }
        let gain = iteration.solver().gain(0);
        let plant = sampled(planned, self.believed(), period)?;
        let mut poles = eigenvalues(&(plant.a() + plant.b() * &gain))?;
        poles.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
        let mut linear = LinearMpc { gain, plant, poles, margins: Vec::new(), period };
        for (i, (name, _)) in planned.input_names().into_iter().enumerate() {
            linear.margins.push((name, margins(&linear.cut_at(i)?)?));
        }
        Ok(linear)
    }
}

impl LinearMpc {
    /// L of the loop cut at all inputs, closed with −I.
    ///
    /// # Errors
    /// As [`StateSpace::new`].
    pub fn cut(&self) -> Result<StateSpace> {
        let (a, b, m) = (self.plant.a().clone(), self.plant.b().clone(), self.gain.nrows());
        StateSpace::new(a, b, -self.gain.clone(), DMatrix::zeros(m, m), Some(self.period))
    }

    /// L of the loop cut at one input while the others stay closed, closed with −1.
    ///
    /// # Errors
    /// As [`StateSpace::new`], and [`Error::Value`] for an input that it does not have.
    pub fn cut_at(&self, input: usize) -> Result<StateSpace> {
        let (b, m) = (self.plant.b(), self.gain.nrows());
        if input >= m {
            return Err(Error::value("input of the loop", input, format!("below {m}"), "Count from 0."));
        }
        let others = self.plant.a() + b * &self.gain - b.column(input) * self.gain.row(input);
        let (b, c) = (b.columns(input, 1).into_owned(), -self.gain.rows(input, 1).into_owned());
        StateSpace::new(others, b, c, DMatrix::zeros(1, 1), Some(self.period))
    }

    /// The closed loop, δ⁺ = (A + B K) δ + B v, with what is added to each input as v and the errors as outputs.
    ///
    /// # Errors
    /// As [`StateSpace::new`].
    pub fn closed(&self) -> Result<StateSpace> {
        let (plant, gain) = (&self.plant, &self.gain);
        let a = plant.a() + plant.b() * gain;
        let closed = StateSpace::new(a, plant.b().clone(), plant.c().clone(), plant.d().clone(), Some(self.period))?;
        closed.named(plant.states().to_vec(), plant.inputs().to_vec(), plant.outputs().to_vec())
    }
}

/// A step of a tick about hover, of states and inputs as plans have them.
fn sampled(planned: &PlannedPlant, believed: &Plant, period: f64) -> Result<StateSpace> {
    let physics = *believed.physics();
    let substeps = ((period / physics.dt).round() as usize).max(1) * physics.substeps;
    let physics = Physics { dt: period, substeps, ..physics };
    let plant = with_disturbance(believed, physics)?.with_longer_lags()?;
    let step = PlannedPlant::new(plant, planned.input())?;
    let (hover, inputs) = step.hover()?;
    let errors = step.errors()?;
    let (a, b) = errors.reduce(&hover, &linearise(&step, &hover, &inputs, &vec![0.0; step.n_parameter()]));
    let (n, m) = (a.nrows(), b.ncols());
    let names: Vec<Signal> = step.input_names().into_iter().map(|(name, unit)| Signal::new(name, unit)).collect();
    let states: Vec<Signal> = step.error_names()?.into_iter().map(|(name, unit)| Signal::new(name, unit)).collect();
    StateSpace::new(a, b, DMatrix::identity(n, n), DMatrix::zeros(n, m), Some(period))?.named(
        states.clone(),
        names,
        states,
    )
}

#[cfg(test)]
mod tests {
    use super::super::{Mpc, MpcSettings};
    use super::*;
    use crate::design::riccati;
    use dynamics::vehicles;

    #[test]
    fn about_hover_the_first_input_is_the_optimal_feedback_of_its_stages() {
        let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
        let mpc = Mpc::new(&plant, &MpcSettings::default()).unwrap();
        let linear = mpc.linear().unwrap();
        let (planned, settings) = (mpc.planned(), mpc.settings());
        let (hover, inputs) = planned.hover().unwrap();
        let theta = vec![0.0; planned.n_parameter()];
        let (a, b) = planned.errors().unwrap().reduce(&hover, &linearise(planned, &hover, &inputs, &theta));
        let (q, r) = mpc.cost().hessian_at_hover(&settings.weights);
        let x = riccati::discrete(&a, &b, &q, &r).unwrap().matrix;
        let wanted = -(r + b.tr_mul(&(&x * &b))).cholesky().unwrap().solve(&b.tr_mul(&(&x * &a)));
        let error = (&linear.gain - &wanted).amax() / wanted.amax();
        let slowest = -linear.period / linear.poles[0].norm().ln();
        println!("K off by {error:.1e}, slowest pole after {slowest:.3} s");
        // measured: 2e-15
        assert!(error < 1e-12 && linear.poles[0].norm() < 1.0);
        for (name, margins) in &linear.margins {
            let phase = margins.phase.to_degrees();
            println!(
                "{name}: gain up {:.2}, down {:.2}, phase {phase:.1}°, modulus {:.2}",
                margins.gain_up, margins.gain_down, margins.modulus
            );
            assert!(margins.stable && margins.gain_up > 1.5 && margins.modulus > 0.4);
        }
    }

    #[test]
    fn a_command_that_is_its_gain_margin_stronger_leaves_a_pole_on_the_unit_circle() {
        let plant = Plant::of_vehicle(&vehicles::by_name("iris").unwrap(), Physics::default()).unwrap();
        let linear = Mpc::new(&plant, &MpcSettings::default()).unwrap().linear().unwrap();
        let (a, b) = (linear.plant.a(), linear.plant.b());
        let largest = |k: &DMatrix<f64>| {
            eigenvalues(&(a + b * k)).unwrap().iter().fold(0.0, |most: f64, pole| most.max(pole.norm()))
        };
        for (i, (name, margins)) in linear.margins.iter().enumerate() {
            let mut stronger = linear.gain.clone();
            stronger.row_mut(i).scale_mut(margins.gain_up);
            println!("{name}: {:.1e} off the circle", (largest(&stronger) - 1.0).abs());
            assert!((largest(&stronger) - 1.0).abs() < 1e-8);
        }
        let closed = eigenvalues(linear.closed().unwrap().a()).unwrap();
        let most = closed.iter().fold(0.0, |most: f64, pole| most.max(pole.norm()));
        assert!((most - linear.poles[0].norm()).abs() < 1e-12);
        // L of all commands closed with −I has the same poles
        let cut = linear.cut().unwrap();
        assert_eq!(cut.a() - cut.b() * cut.c(), a + b * &linear.gain);
        assert!(linear.cut_at(linear.margins.len()).is_err());
    }
}
