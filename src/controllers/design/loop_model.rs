//! The linear model of a loop that is flown: sampled, of several rates, with its holds and its latency, open at any point.
//!
//! About a steady flight every step k of a period of N steps is x⁺ = A_k x + B_k d, y = C_k x + d, where d is added to commands
//! (or to measurements) and y is what then acts (or is seen). N steps together are one system without time, from the d of a
//! period to the y of a period: S, the sensitivity. Its inverse less the identity is the loop L, broken there while all other
//! paths stay closed. Factors on a path act in all steps alike: margins are of such factors.
//!
//! Source: Bittanti and Colaneri 2009, section 6.2 (lifting).

use super::error_state::ErrorState;
use crate::CascadeLaw;
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::law::{ControlLaw, LawController};
use crate::linear::dense::{Complexes, complex_spectral_radius};
use crate::linear::disk::{bound_at, disk_margin_of, folded_disk_margin_of};
use crate::linear::state_space::{beside, stacked};
use crate::linear::swept::Swept;
use crate::linear::{DiskMargin, Signal, StateSpace, eigenvalues, minimal, spectral_radius};
use autodiff::rollout::{StepCode, advance};
use autodiff::{Objective, Scalar, System, linearise};
use base::error::{Error, Result};
use dynamics::Disturbance;
use nalgebra::{Complex, ComplexField, DMatrix};
use num_dual::Dual64;
use serde::Serialize;
use std::f64::consts::PI;

/// Most steps that a loop may take until it is steady.
const SETTLE: u64 = 200_000;
/// Largest change of a state over a period that counts as none.
const STEADY: f64 = 1e-9;
/// Directions of the lifted model weaker than this are left out: they are neither reached nor seen.
const WEAK: f64 = 1e-9;

/// What a controller makes of a metre, a radian or their rates: below this, in its own SI units or shares of thrust, it is nothing.
const UNHEARD: f64 = 1e-12;

/// Where a loop is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AnalysisPoint {
    /// One command, by its number, between controller and plant: of a vehicle one rotor's. Where all turn one axis, open its measurement.
    Command(usize),
    /// All commands at once.
    Commands,
    /// One number of the error state that the controller sees: of a rigid vehicle position 0 to 2 and velocity 3 to 5 (world),
    /// rotation vector 6 to 8 and rate 9 to 11 (body).
    Measurement(usize),
}

/// A loop about a steady flight.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::controllers::design::{AnalysisPoint, LoopModel};
/// use omnidrones::controllers::{ClosedLoop, Rates, Reference, Target, start_on};
/// use omnidrones::dynamics::{Disturbance, Physics, vehicles};
///
/// let iris = vehicles::by_name("iris")?;
/// let closed = ClosedLoop::of_vehicle(&iris, Physics::default(), &iris.gains(), &Rates::default())?;
/// let hover = Reference::by_name("hover")?;
/// let start = start_on(closed.plant(), closed.controller(), &hover)?;
/// let model = LoopModel::of_vehicle(closed, Target::level(&hover), &Disturbance::none(), &start)?;
/// let pitch = model.margins(AnalysisPoint::Measurement(7))?; // rotation vector about body y
/// assert!(pitch.phase.to_degrees() > 30.0 && pitch.gain_up > 2.0);
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LoopModel {
    /// The time between two steps, s.
    pub dt: f64,
    /// Where it settled: the whole state of the [`ClosedLoop`] at the beginning of a period.
    pub state: Vec<f64>,
    /// Names of the commands.
    pub commands: Vec<Signal>,
    /// Names of the measurements.
    pub measurements: Vec<Signal>,
    pub(super) steps: Vec<Step>,
}

#[derive(Debug, Clone)]
pub(super) struct Step {
    /// n × n, of the error state of the loop.
    pub a: DMatrix<f64>,
    /// n × m: what is added to commands.
    pub by_command: DMatrix<f64>,
    /// m × n: what is commanded.
    pub commanded: DMatrix<f64>,
    /// n × p: what is added to measurements.
    pub by_measurement: DMatrix<f64>,
    /// p × n: what is measured.
    pub measured: DMatrix<f64>,
}

impl LoopModel {
    /// Most steps of delay that [`margins`](Self::margins) tries, a power of two.
    pub const MOST_DELAY: usize = 128;
    /// Most steps of a period of all rates: margins of all commands together are of matrices that grow with it.
    pub const MOST_PERIOD: usize = 128;

    /// [`LoopModel::new`] of a vehicle under its cascade.
    ///
    /// # Errors
    /// As [`LoopModel::new`].
    pub fn of_vehicle(
        closed: ClosedLoop<LawController<CascadeLaw>>,
        target: Target<'_>,
        air: &Disturbance<f64>,
        start: &[f64],
    ) -> Result<Self> {
        Self::new(closed, target, air, start)
    }

    /// The model of a loop that holds a target that stands still, in steady air, from a state of the plant near that flight: the
    /// loop is flown until it is steady, then one period of all its rates is linearised by duals. Motors answer with the longer of
    /// their lags, up or down.
    ///
    /// # Errors
    /// [`Error::Value`] if it does not become steady, [`Error::Limit`] for rates that come round after more than
    /// [`MOST_PERIOD`](Self::MOST_PERIOD) steps.
    pub fn new<L: ControlLaw>(
        closed: ClosedLoop<LawController<L>>,
        target: Target<'_>,
        air: &Disturbance<f64>,
        start: &[f64],
    ) -> Result<Self> {
        closed.plant().check_state(start)?;
        let closed = closed.with_injections();
        let (dt, n) = (closed.plant().physics().dt, closed.n_state());
        let errors = ErrorState::of_plant(closed.plant())?;
        let own = errors.n_error();
        let whole = errors.clone().longer(n);
        let theta = closed.parameters();
        let input_at = |k: u64| {
            let mut input = vec![0.0; closed.n_input()];
            closed.write_input(k, target, air, &mut input);
            input
        };
        let inputs = one_period(&input_at, dt)?;
        let period = inputs.len();
        if period > Self::MOST_PERIOD {
            let remedy = "Raise the slowest rate, or let rates be whole parts of one another.";
            let most = format!("{} steps", Self::MOST_PERIOD);
            return Err(Error::limit("loop model: steps until all rates come round", period, most, remedy));
        }

        let mut x = closed.initial_state(start);
        let (mut k, mut code, mut asked) = (0, None, false);
        // a state and the one behind it, in turns
        let mut states = vec![0.0; 2 * n];
        loop {
            states[..n].copy_from_slice(&x);
            for input in &inputs {
                advance(&closed, &mut code, &mut states, input, &theta);
            }
            k += period as u64;
            let change = whole.difference(&states[..n], &x).amax();
            x.copy_from_slice(&states[..n]);
            if change <= STEADY * period as f64 * dt / 0.002 {
                break;
            }
            if k >= SHORT && !std::mem::replace(&mut asked, true) {
                code = StepCode::of(&closed, &Settling).for_steps(SETTLE);
            }
            if k >= SETTLE || !change.is_finite() {
                let value = format!("still moving by {change:.1e} per period after {:.0} s", k as f64 * dt);
                let remedy = "Start nearer, ask for a flight that the vehicle can hold, or mend the gains: this loop may be unstable.";
                return Err(Error::value(format!("loop of {}", closed.plant().name()), value, "steady", remedy));
            }
        }

        let (m, first) = (closed.n_command(), closed.n_input() - closed.n_command() - closed.plant().n_state());
        let mut state = x.clone();
        let mut steps = Vec::with_capacity(period);
        for input in &inputs {
            let here = state.clone();
            closed.plant().take_longer_lags(&mut state);
            let step = linearise(&closed, &state, input, &theta);
            let (a, b) = whole.reduce(&state, &step);
            let tangent = whole.tangent(&state);
            let seen = errors.tangent(&state[..closed.plant().n_state()]);
            let commanded = slope_of_commands(&closed, &state, input, &theta) * &tangent;
            steps.push(Step {
                by_measurement: b.columns(first + m, closed.plant().n_state()) * &seen,
                by_command: b.columns(first, m).into_owned(),
                measured: DMatrix::from_fn(own, whole.n_error(), |i, j| f64::from(u8::from(i == j))),
                commanded,
                a,
            });
            closed.step(&here, input, &theta, &mut state);
        }
        let commands = closed.command_names().into_iter().map(|name| Signal::new(name, "-")).collect();
        Ok(Self { dt, state: x, commands, measurements: errors.signals(closed.plant()), steps })
    }

    /// Steps of a period: the least common multiple of all rates.
    pub fn period(&self) -> usize {
        self.steps.len()
    }

    /// Poles of the closed loop over a period, largest modulus first: it is stable where all are below 1.
    ///
    /// # Errors
    /// [`Error::Value`] where eigenvalues are not found.
    pub fn poles(&self) -> Result<Vec<Complex<f64>>> {
        eigenvalues(&self.over_a_period())
    }

    /// A of all steps of a period together.
    pub(super) fn over_a_period(&self) -> DMatrix<f64> {
        let n = self.n_state();
        self.steps.iter().fold(DMatrix::identity(n, n), |all, step| &step.a * all)
    }

    /// The vehicle in its first step, in which all levels of the controller compute: its inputs are all that acts on it, commands and
    /// memory; its outputs all that is made of it.
    pub(super) fn vehicle(&self) -> Result<StateSpace> {
        let (step, own, n) = (&self.steps[0], self.measurements.len(), self.n_state());
        let a = step.a.view((0, 0), (own, own)).into_owned();
        let b = beside(&step.a.view((0, own), (own, n - own)).into_owned(), &step.by_command.rows(0, own).into_owned());
        let c =
            stacked(&step.a.view((own, 0), (n - own, own)).into_owned(), &step.commanded.columns(0, own).into_owned());
        let c = c.map(|v| if v.abs() < UNHEARD { 0.0 } else { v });
        let d = DMatrix::zeros(c.nrows(), b.ncols());
        StateSpace::new(a, b, c, d, Some(self.dt))
    }

    /// Numbers of the state of the loop's error.
    pub(super) fn n_state(&self) -> usize {
        self.steps[0].a.nrows()
    }

    /// S = (I + L)⁻¹ at a point, over a period, sampled every `dt` · [`period`](Self::period): inputs and outputs of every step, one
    /// step after the other. What is neither reached nor seen there is left out.
    ///
    /// # Errors
    /// [`Error::Value`] for a point that the loop does not have, or where singular values are not found.
    pub fn sensitivity(&self, point: AnalysisPoint) -> Result<StateSpace> {
        let (n, signals) = (self.n_state(), self.signals(point)?);
        let width = signals.len();
        let all = width * self.period();
        let (mut a, mut b) = (DMatrix::identity(n, n), DMatrix::zeros(n, all));
        let (mut c, mut d) = (DMatrix::zeros(all, n), DMatrix::identity(all, all));
        for (k, step) in self.steps.iter().enumerate() {
            let (by, seen) = match point {
                AnalysisPoint::Command(i) => {
                    (step.by_command.columns(i, 1).into_owned(), step.commanded.rows(i, 1).into_owned())
                }
                AnalysisPoint::Commands => (step.by_command.clone(), step.commanded.clone()),
                AnalysisPoint::Measurement(i) => {
                    (step.by_measurement.columns(i, 1).into_owned(), step.measured.rows(i, 1).into_owned())
                }
            };
            c.rows_mut(k * width, width).copy_from(&(&seen * &a));
            let earlier = &seen * b.columns(0, k * width);
            d.view_mut((k * width, 0), (width, k * width)).copy_from(&earlier);
            b = &step.a * b;
            b.columns_mut(k * width, width).copy_from(&by);
            a = &step.a * a;
        }
        let lifted = StateSpace::new(a, b, c, d, Some(self.dt * self.period() as f64))?;
        let names: Vec<Signal> = (0..self.period())
            .flat_map(|k| signals.iter().map(move |s| (k, s)))
            .map(
                |(k, s)| {
                    if self.period() > 1 { Signal::new(format!("{}@{k}", s.name), s.unit.clone()) } else { s.clone() }
                },
            )
            .collect();
        minimal(&lifted.named(Signal::numbered("x", n), names.clone(), names)?, WEAK)
    }

    /// L at a point, over a period, to be closed with −1 (−I): S⁻¹ − I.
    ///
    /// # Errors
    /// As [`sensitivity`](Self::sensitivity).
    pub fn open(&self, point: AnalysisPoint) -> Result<StateSpace> {
        let s = self.sensitivity(point)?;
        let remedy = "Report this as a bug.";
        let Some(back) = s.d().clone().try_inverse() else {
            return Err(Error::value("D of a sensitivity", "singular", "lower triangular with ones", remedy));
        };
        let (b, c) = (s.b() * &back, -(&back * s.c()));
        let a = s.a() + s.b() * &c;
        let d = back - DMatrix::identity(s.n_output(), s.n_output());
        StateSpace::new(a, b, c, d, s.dt())?.named(s.states().to_vec(), s.inputs().to_vec(), s.outputs().to_vec())
    }

    /// S over frequency (rad/s, to π/dt) at a point of one signal: what answers at the frequency of a sinusoid there. L = 1/S − 1.
    ///
    /// # Errors
    /// As [`sensitivity`](Self::sensitivity); [`Error::Value`] for all commands at once.
    pub fn response(&self, point: AnalysisPoint, omega: &[f64]) -> Result<Vec<Complex<f64>>> {
        let s = self.sensitivity(point)?;
        if self.signals(point)?.len() > 1 {
            let remedy = "Ask for one command, or for singular values of the sensitivity.";
            return Err(Error::value("the point of a response", "of many signals", "one signal", remedy));
        }
        let (n, swept) = (self.period(), Swept::of(&s));
        let at = |w: f64| {
            let wave = Complexes::from_fn(n, 1, |k, _| Complex::from_polar(1.0, w * k as f64 * self.dt));
            (wave.adjoint() * swept.driven(s.on_axis(w), &wave))[(0, 0)] / n as f64
        };
        Ok(omega.iter().map(|w| at(*w)).collect())
    }

    /// How much the loop bears at one point; no margin at all, without a search, where it is not stable.
    ///
    /// # Errors
    /// As [`sensitivity`](Self::sensitivity).
    pub fn margins(&self, point: AnalysisPoint) -> Result<LoopMargins> {
        let open = self.open(point)?;
        if !self.stability()?.is_stable() || excess(&open, Complex::ONE) >= 0.0 {
            return Ok(LoopMargins::NONE);
        }
        // what the disk bears need not be searched
        let disk = self.disk_margin(point, 0.0)?;
        let [borne_up, borne_down] = [disk.gain.1.ln(), -disk.gain.0.ln()].map(|t| KNOWN * t);
        // factors from 1 up to 100 and down to 0, by their logarithms
        let real = |factor: f64| excess(&open, Complex::new(factor, 0.0));
        let up = first_failure(&|t| real(t.exp()), (borne_up, 100.0_f64.ln()), 80).map_or(f64::INFINITY, f64::exp);
        let down = first_failure(&|t| real((-t).exp()), (borne_down, 1000.0_f64.ln()), 80).map_or(0.0, |t| (-t).exp());
        let turned = |angle: f64| excess(&open, Complex::from_polar(1.0, angle));
        let lag = first_failure(&|t| turned(-t), (KNOWN * disk.phase, PI), 80);
        // what leads further than the lag that is found does not count
        let steps = lag.map_or(80, |t| (t / PI * 80.0).ceil() as u32);
        let lead = first_failure(&|t| turned(t), (KNOWN * disk.phase, PI / 80.0 * f64::from(steps)), steps);
        Ok(LoopMargins {
            stable: true,
            gain_up: up,
            gain_down: down,
            phase: lag.unwrap_or(f64::INFINITY).min(lead.unwrap_or(f64::INFINITY)),
            delay: self.delay(&open)?,
            disk,
        })
    }

    /// The disk margin at a point; of all commands at once each has a factor of its own, which in loops of several rates may differ
    /// between the steps of a period: their margin is then a bound from below, a few percent less than it might be. At a point of one
    /// signal the factor is that of a filter, the same in all steps.
    ///
    /// # Errors
    /// As [`sensitivity`](Self::sensitivity).
    pub fn disk_margin(&self, point: AnalysisPoint, skew: f64) -> Result<DiskMargin> {
        let s = self.sensitivity(point)?;
        if !self.stability()?.is_stable() {
            return Ok(DiskMargin::NONE);
        }
        let (width, period) = (self.signals(point)?.len(), self.period());
        if width == 1 && period > 1 {
            return folded_disk_margin_of(&s, period, skew);
        }
        let block: Vec<usize> = (0..s.n_input()).map(|k| k % width).collect();
        disk_margin_of(&s, &block, skew, period == 1)
    }

    /// The disk margin of all commands at once without what sampling folds from one frequency to others: S is what answers at
    /// the frequency of a sinusoid, over [`GRID`] frequencies. For loops of several rates more than
    /// [`disk_margin`](Self::disk_margin), smooth in the gains, and found tens of times faster. 0 where the loop is not stable.
    ///
    /// # Errors
    /// As [`sensitivity`](Self::sensitivity).
    pub(super) fn unfolded_disk_margin(&self) -> Result<f64> {
        if !self.stability()?.is_stable() {
            return Ok(0.0);
        }
        let s = self.sensitivity(AnalysisPoint::Commands)?;
        let (m, period, swept) = (self.commands.len(), self.period(), Swept::of(&s));
        let top = PI / self.dt;
        let bound = |k: usize| {
            let w = SLOWEST * (top / SLOWEST).powf(k as f64 / (GRID - 1) as f64);
            let turn = |k: usize| Complex::from_polar(1.0, w * k as f64 * self.dt);
            let wave = Complexes::from_fn(m * period, m, |i, j| if i % m == j { turn(i / m) } else { Complex::ZERO });
            bound_at(wave.adjoint() * swept.driven(turn(period), &wave) / Complex::new(period as f64, 0.0), 0.0)
        };
        let mut most = 0.0_f64;
        for k in 0..GRID {
            let size = bound(k);
            if !size.is_finite() {
                // a pole on the axis
                return Ok(0.0);
            }
            most = most.max(size);
        }
        Ok(1.0 / most)
    }

    /// A delay, in whole steps, at which the loop is no longer stable though it is with one step less, s: the least if stability
    /// does not come back in between. Infinite beyond [`Self::MOST_DELAY`] steps.
    fn delay(&self, open: &StateSpace) -> Result<f64> {
        let width = open.n_input() / self.period();
        let holds = |steps: usize| -> Result<bool> {
            let late = open.series(&lifted_delay(width, self.period(), steps, open.dt())?)?;
            Ok(excess(&late, Complex::ONE) < 0.0)
        };
        let (mut low, mut high) = (0, 1);
        while holds(high)? {
            if high >= Self::MOST_DELAY {
                return Ok(f64::INFINITY);
            }
            (low, high) = (high, 2 * high);
        }
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if holds(middle)? { low = middle } else { high = middle }
        }
        Ok(high as f64 * self.dt)
    }

    fn signals(&self, point: AnalysisPoint) -> Result<Vec<Signal>> {
        let one = |all: &[Signal], i: usize, what: &str| match all.get(i) {
            Some(signal) => Ok(vec![signal.clone()]),
            None => Err(Error::value(what, i, format!("below {}", all.len()), "They count from 0.")),
        };
        match point {
            AnalysisPoint::Command(i) => one(&self.commands, i, "command"),
            AnalysisPoint::Measurement(i) => one(&self.measurements, i, "measurement"),
            AnalysisPoint::Commands => Ok(self.commands.clone()),
        }
    }
}

/// Steps that are flown before there is code of one: what is not steady then takes many more.
const SHORT: u64 = 1000;

/// Nothing is asked of a loop that settles.
struct Settling;

impl Objective for Settling {
    fn stage<S: Scalar>(&self, _: &[S], _: &[S], _: &[S]) -> S {
        S::zero()
    }
}

/// Frequencies of a disk margin without folding, and the lowest of them, rad/s.
const GRID: usize = 96;
const SLOWEST: f64 = 0.2;

/// What a loop bears at one point, all other paths closed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopMargins {
    /// Whether it is stable as it is.
    pub stable: bool,
    /// Largest factor on the gain; infinite from 100 on.
    pub gain_up: f64,
    /// Least factor on the gain; 0 below 0.001.
    pub gain_down: f64,
    /// Phase, rad, the lesser of both directions; infinite where none ends stability.
    pub phase: f64,
    /// Least delay that ends stability, in whole steps of the loop but told in s; infinite beyond 128 steps.
    pub delay: f64,
    /// Gain and phase at once.
    pub disk: DiskMargin,
}

impl LoopMargins {
    /// What a loop that is not stable bears.
    const NONE: Self =
        Self { stable: false, gain_up: 1.0, gain_down: 1.0, phase: 0.0, delay: 0.0, disk: DiskMargin::NONE };
}

/// Inputs of the steps of one period: as many as it takes until they come again, up to the slowest rate of 1 Hz.
fn one_period(input_at: &dyn Fn(u64) -> Vec<f64>, dt: f64) -> Result<Vec<Vec<f64>>> {
    let most = (1.0 / dt).ceil() as u64;
    let all: Vec<Vec<f64>> = (0..2 * most).map(input_at).collect();
    let n = most as usize;
    match (1..=n).find(|p| (0..2 * n - p).all(|k| all[k] == all[k + p])) {
        Some(period) => Ok(all[..period].to_vec()),
        None => {
            let remedy = "Take a target that stands still, as Reference::Hover.";
            Err(Error::value("the target of a loop model", "moving", "constant", remedy))
        }
    }
}

/// ∂commands/∂state, m × n, by duals.
fn slope_of_commands<L: ControlLaw>(
    closed: &ClosedLoop<LawController<L>>,
    x: &[f64],
    input: &[f64],
    theta: &[f64],
) -> DMatrix<f64> {
    let dual = |values: &[f64]| values.iter().map(|v| Dual64::from(*v)).collect::<Vec<_>>();
    let (mut state, input, theta) = (dual(x), dual(input), dual(theta));
    let mut slope = DMatrix::zeros(closed.n_command(), x.len());
    for j in 0..x.len() {
        state[j].eps = 1.0;
        let commands = closed.commanded(&state, &input, &theta);
        state[j].eps = 0.0;
        commands.iter().enumerate().for_each(|(i, value)| slope[(i, j)] = value.eps);
    }
    slope
}

/// By how much the largest eigenvalue of the loop around `open` with a factor in it lies outside the unit circle: below 0 it is stable.
fn excess(open: &StateSpace, factor: Complex<f64>) -> f64 {
    let radius = if factor.im == 0.0 {
        // of real matrices they are found sooner
        closed_with(open, factor.re).and_then(|a| spectral_radius(&a).ok())
    } else {
        closed_with(open, factor).map(|a| complex_spectral_radius(&a))
    };
    radius.map_or(f64::INFINITY, |size| size - 1.0)
}

/// The matrix A of the loop around `open` with a factor in it; none where the loop has no solution.
fn closed_with<T: ComplexField<RealField = f64> + Copy>(open: &StateSpace, factor: T) -> Option<DMatrix<T>> {
    let of = |m: &DMatrix<f64>| m.map(T::from_real);
    let n = open.n_input();
    let back = (DMatrix::identity(n, n) + of(open.d()) * factor).try_inverse()?;
    Some(of(open.a()) - of(open.b()) * factor * back * of(open.c()))
}

/// Share of what a disk bears that is taken as known.
const KNOWN: f64 = 0.9;

/// How far along a path, from 0, stability lasts: `excess` is below 0 there, as is known up to a first place. Found in `n` equal
/// steps and between two of them to a billionth of the path; none if it lasts up to the end.
fn first_failure(excess: &dyn Fn(f64) -> f64, (known, end): (f64, f64), n: u32) -> Option<f64> {
    let place = |k: u32| end * f64::from(k) / f64::from(n);
    // infinite where a disk bears every factor
    let first = (0..n).rev().find(|k| place(*k) <= known).unwrap_or(0);
    let mut low = (place(first), -1.0);
    for k in first + 1..=n {
        let t = place(k);
        let there = (t, excess(t));
        if there.1 < 0.0 {
            low = there;
            continue;
        }
        return Some(crossing(excess, low, there, 1e-9 * end));
    }
    None
}

/// Where `value` becomes 0 between a place below and one above, by secants that take no more steps than bisection and one.
///
/// Source: Oliveira and Takahashi 2020 (ITP).
fn crossing(value: &dyn Fn(f64) -> f64, mut low: (f64, f64), mut high: (f64, f64), width: f64) -> f64 {
    let most = ((high.0 - low.0) / width).log2().ceil().max(0.0) + 1.0;
    let narrow = 0.2 / (high.0 - low.0);
    let mut slack = width * most.exp2();
    while high.0 - low.0 > width {
        let (middle, half) = (f64::midpoint(low.0, high.0), 0.5 * (high.0 - low.0));
        let secant = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
        let secant = if secant.is_finite() { secant } else { middle };
        let (way, off) = ((middle - secant).signum(), (middle - secant).abs());
        let pushed = off.min(narrow * (2.0 * half).powi(2));
        let near = secant + way * pushed;
        let reach = (0.5 * slack - half).max(0.0);
        let t = if (near - middle).abs() <= reach { near } else { middle - way * reach };
        let there = (t, value(t));
        *(if there.1 < 0.0 { &mut low } else { &mut high }) = there;
        slack *= 0.5;
    }
    high.0
}

/// `steps` steps of delay on `width` signals, seen over a period.
fn lifted_delay(width: usize, period: usize, steps: usize, dt: Option<f64>) -> Result<StateSpace> {
    // the state holds the last `steps` values, oldest first
    let one = |r: usize, c: usize, f: &dyn Fn(usize, usize) -> bool| {
        DMatrix::from_fn(r, c, |i, j| f64::from(u8::from(f(i, j))))
    };
    let (held, new) = (width * steps, width * period);
    let a = one(held, held, &|i, j| j == i + new);
    let b = one(held, new, &|i, j| j + held == i + new);
    let c = one(new, held, &|i, j| i == j);
    let d = one(new, new, &|i, j| i == j + held);
    StateSpace::new(a, b, c, d, dt)
}
