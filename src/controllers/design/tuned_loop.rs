//! The flights of [`tune`](mod@super::tune): the loop over ln K, its starts and what is asked of it.
//!
//! Where plants are drawn, mass, inertia and motor lag of a flight are factors that stand behind its state, so that flights of one
//! block fly plants of their own under the same gains.

use super::margin_gate::Corner;
use super::tune_plan::TunePlan;
use crate::cascade_law::CascadeLaw;
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::hover_axes::HoverAxes;
use crate::law::{ControlLaw, LawController};
use crate::reference::{Reference, Setpoint};
use crate::start::start_on;
use autodiff::{Objective, Scalar, System};
use base::error::Result;
use dynamics::spatial::{add, cross, dot, exponential, from_euler, multiply, rotate_back, scale};
use dynamics::{Disturbance, GRAVITY, Gains, Vehicle};
use rng::{Purpose, Stream};

/// ‖p − p_ref‖²/T per step.
pub(super) struct MeanSquaredError {
    per_step: f64,
}

impl MeanSquaredError {
    pub fn over(steps: usize) -> Self {
        Self { per_step: 1.0 / steps as f64 }
    }
}

impl Objective for MeanSquaredError {
    #[inline]
    fn stage<S: Scalar>(&self, state: &[S], input: &[S], _: &[S]) -> S {
        let mut sum = S::zero();
        for i in 0..3 {
            sum += (state[i] - input[i]).square();
        }
        S::constant(self.per_step) * sum
    }
}

/// A vehicle under a law.
pub(super) type LoopOf<L> = ClosedLoop<LawController<L>>;

/// A vehicle under its cascade.
pub(super) type VehicleLoop = LoopOf<CascadeLaw>;

/// The closed loop with θ = ln K.
pub(super) struct LogGains<L> {
    pub closed: LoopOf<L>,
    drawn: Option<DrawnPlants>,
    n_gain: usize,
}

/// The physical parameters as believed, and which of them the factors of mass, inertia and motor lag act on.
struct DrawnPlants {
    nominal: Vec<f64>,
    scaled: [Vec<usize>; N_FACTOR],
}

/// Mass, inertia, motor lag.
const N_FACTOR: usize = 3;

impl<L: ControlLaw> LogGains<L> {
    /// Of the plant as it is.
    pub fn new(closed: LoopOf<L>) -> Self {
        let n_gain = closed.law().parameters().len();
        Self { closed: closed.with_gains(), drawn: None, n_gain }
    }

    /// Of plants whose factors stand behind the state.
    pub fn of_drawn_plants(closed: LoopOf<L>, vehicle: &Vehicle) -> Result<Self> {
        let n_gain = closed.law().parameters().len();
        let closed = closed.with_physics();
        let inertia = closed.parameter("inertia_xx")?;
        let lags = vehicle
            .rotors
            .iter()
            .flat_map(|r| ["time_constant_up", "time_constant_down"].map(|what| format!("{}.{what}", r.name)))
            .map(|name| closed.parameter(&name))
            .collect::<Result<_>>()?;
        let scaled = [vec![closed.parameter("mass")?], (inertia..inertia + 6).collect(), lags];
        let drawn = Some(DrawnPlants { nominal: closed.parameters(), scaled });
        Ok(Self { closed: closed.with_gains(), drawn, n_gain })
    }

    /// The gains of the loop.
    pub fn gains(&self) -> Vec<f64> {
        self.closed.law().parameters()
    }
}

impl<L: ControlLaw> System for LogGains<L> {
    fn n_state(&self) -> usize {
        self.closed.n_state() + if self.drawn.is_some() { N_FACTOR } else { 0 }
    }
    fn n_input(&self) -> usize {
        self.closed.n_input()
    }
    fn n_parameter(&self) -> usize {
        self.n_gain
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        // this step is recorded, not run: it may allocate
        let gains: Vec<S> = parameters.iter().map(|log| log.exp()).collect();
        let (n, mut theta) = (self.closed.n_state(), Vec::new());
        if let Some(drawn) = &self.drawn {
            theta.extend(drawn.nominal.iter().map(|v| S::constant(*v)));
            for (places, factor) in drawn.scaled.iter().zip(&state[n..]) {
                places.iter().for_each(|k| theta[*k] *= *factor);
            }
            theta.extend_from_slice(&gains);
        }
        // one call: the whole step is inlined into it
        let all = if self.drawn.is_some() { &theta } else { &gains };
        self.closed.step(&state[..n], input, all, &mut next[..n]);
        next[n..].copy_from_slice(&state[n..]);
    }
}

/// Gains of their logarithms.
pub(super) fn gains_of(theta: &[f64]) -> Gains {
    Gains::from_flat(&theta.iter().map(|log| log.exp()).collect::<Vec<_>>())
}

/// Inputs of the closed loop along a reference, row-major `[T, m]`.
pub(super) fn inputs<L: ControlLaw>(system: &LoopOf<L>, reference: &Reference, n_step: usize) -> Vec<f64> {
    let m = system.n_input();
    let mut rows = vec![0.0; n_step * m];
    for (k, row) in rows.chunks_exact_mut(m).enumerate() {
        system.write_input(k as u64, Target::level(reference), &Disturbance::none(), row);
    }
    rows
}

/// Training and held-out starts come from streams that never meet.
pub(super) const TRAINING: u64 = 0;
pub(super) const HELD_OUT: u64 = 1;

/// The plant of flight `i` along reference number `of` of a plan.
pub(super) fn plant_of(plan: &TunePlan, set: u64, of: usize, i: usize) -> Corner {
    let mut stream = Stream::new(plan.seed, i as u64, set + 2 * of as u64, Purpose::PARAMETERS);
    Corner::drawn(&mut stream, 0.0, plan.plant_spread, 0.0)
}

/// Random starts around that of reference number `of` of a plan, one state of the loop after the other.
pub(super) fn starts<L: ControlLaw>(
    system: &LoopOf<L>,
    plan: &TunePlan,
    reference: &Reference,
    (set, of): (u64, usize),
    n: usize,
) -> Result<Vec<Vec<f64>>> {
    let wanted = reference.sample(0.0);
    let hover = start_on(system.plant(), system.controller(), reference)?;
    let (lean, turning) = along(&wanted);
    let axes = HoverAxes::of_plant(system.plant());
    let one = |i: usize| {
        let mut stream = Stream::new(plan.seed, i as u64, set + 2 * of as u64, Purpose::RESET);
        let mut state = hover.clone();
        let mut draw = |spread: f64| if spread > 0.0 { stream.uniform(-spread, spread) } else { 0.0 };
        for k in 0..3 {
            state[k] += draw(plan.position_spread);
            state[3 + k] = wanted.velocity[k] + draw(plan.velocity_spread);
        }
        let (roll, pitch) = (draw(plan.tilt_spread), draw(plan.tilt_spread));
        let yaw = wanted.yaw + draw(2.0 * plan.tilt_spread);
        let attitude = axes.attitude(multiply(lean, from_euler(roll, pitch, yaw)));
        state[6..10].copy_from_slice(&attitude);
        state[10..13].copy_from_slice(&rotate_back(attitude, turning));
        system.initial_state(&state)
    };
    Ok((0..n).map(one).collect())
}

/// How a vehicle on a reference that already moves leans and turns, world: its thrust along a + g e_z. Level and at rest on others.
fn along(wanted: &Setpoint<f64>) -> ([f64; 4], [f64; 3]) {
    if wanted.velocity == [0.0; 3] {
        return ([1.0, 0.0, 0.0, 0.0], [0.0; 3]);
    }
    let force = add(wanted.acceleration, [0.0, 0.0, GRAVITY]);
    let size = dot(force, force).sqrt();
    let up = scale(1.0 / size, force);
    let axis = cross([0.0, 0.0, 1.0], up);
    let sine = dot(axis, axis).sqrt();
    let angle = sine.atan2(up[2]);
    let turn = if sine > 0.0 { angle / sine } else { 0.0 };
    (exponential(scale(turn, axis)), cross(up, scale(1.0 / size, wanted.jerk)))
}

#[cfg(test)]
mod tests {
    use super::super::margin_gate::truth;
    use super::*;
    use crate::cascade::Rates;
    use crate::design::FlightGrid;
    use dynamics::{Physics, Plant, vehicles};

    #[test]
    fn a_plant_of_factors_behind_the_state_moves_as_the_vehicle_that_is_so() {
        let vehicle = vehicles::by_name("firefly").unwrap();
        let (physics, rates, gains) = (Physics::default(), Rates::default(), vehicle.gains());
        let believed = || ClosedLoop::of_vehicle(&vehicle, physics, &gains, &rates).unwrap();
        let drawn = LogGains::of_drawn_plants(believed(), &vehicle).unwrap();
        let plan = TunePlan { plant_spread: 0.3, ..TunePlan::default() };
        let plant = plant_of(&plan, TRAINING, 0, 3);
        assert!(plant != plant_of(&plan, HELD_OUT, 0, 3) && plant != plant_of(&plan, TRAINING, 1, 3));
        let law = CascadeLaw::new(&vehicle, &physics, &gains, &rates).unwrap();
        let own =
            ClosedLoop::new(Plant::of_vehicle(&truth(&vehicle, &plant), physics).unwrap(), law.running()).unwrap();

        let reference = Reference::by_name("lemniscate").unwrap();
        let start = starts(&believed(), &plan, &reference, (TRAINING, 0), 1).unwrap().remove(0);
        let theta: Vec<f64> = drawn.gains().iter().map(|k| k.ln()).collect();
        let (mut x, mut y) = ([&start[..], &[plant.mass, plant.inertia, plant.lag]].concat(), start.clone());
        let (mut next_x, mut next_y) = (x.clone(), y.clone());
        for input in inputs(&own, &reference, 200).chunks_exact(own.n_input()) {
            drawn.step(&x, input, &theta, &mut next_x);
            own.step(&y, input, &[], &mut next_y);
            (x, y) = (next_x.clone(), next_y.clone());
        }
        let apart = x.iter().zip(&y).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())).fold(0.0, f64::max);
        println!("apart by {apart:.1e} after 0.4 s");
        assert!(apart < 1e-9, "{apart:e}");
    }

    #[test]
    fn a_start_on_a_circle_moves_leans_and_turns_with_it() {
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        let closed = ClosedLoop::of_vehicle(&vehicle, Physics::default(), &vehicle.gains(), &Rates::default()).unwrap();
        let still = TunePlan { position_spread: 0.0, velocity_spread: 0.0, tilt_spread: 0.0, ..TunePlan::default() };
        for cell in FlightGrid::default().cells(&vehicle, &Physics::default()).unwrap() {
            let wanted = cell.reference().sample(0.0);
            let start = starts(&closed, &still, &cell.reference(), (TRAINING, 0), 1).unwrap().remove(0);
            let up = dynamics::spatial::up_axis([6, 7, 8, 9].map(|k| start[k]));
            let lean = (cell.acceleration / 9.81).atan();
            assert!((up[2] - lean.cos()).abs() < 1e-12 && start[3..6] == wanted.velocity, "{cell:?}");
            let turning = start[10..13].iter().map(|w| w * w).sum::<f64>().sqrt();
            assert!((turning - lean.sin() * cell.acceleration / cell.speed).abs() < 1e-12, "{cell:?}");
        }
    }
}
