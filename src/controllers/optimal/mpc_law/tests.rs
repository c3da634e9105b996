use super::*;
use crate::closed_loop::ClosedLoop;
use crate::law::LawController;
use crate::reference::{Circle, Lemniscate, Reference};
use crate::start_on;
use autodiff::{Objective, Rollout};
use dynamics::{Disturbance, Physics, vehicles};

/// Square of the distance from the reference, whose positions begin the law's target.
struct Distance;

impl Objective for Distance {
    fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
        (0..3).fold(S::zero(), |sum, k| sum + (x[k] - u[k]).square())
    }
}

type Loop = ClosedLoop<LawController<MpcLaw>>;

fn closed(settings: &MpcSettings) -> Loop {
    let physics = Physics { dt: 0.01, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let law = MpcLaw::new(&plant, settings).unwrap();
    ClosedLoop::new(plant, LawController::of(law)).unwrap().with_gains()
}

/// Start and inputs of so many steps along a reference.
fn along(system: &Loop, reference: &Reference, steps: usize) -> (Vec<f64>, Vec<f64>) {
    let start = system.initial_state(&start_on(system.plant(), system.controller(), reference).unwrap());
    let mut inputs = vec![0.0; steps * system.n_input()];
    for (k, row) in inputs.chunks_exact_mut(system.n_input()).enumerate() {
        system.write_input(k as u64, Target::level(reference), &Disturbance::none(), row);
    }
    (start, inputs)
}

fn short() -> MpcSettings {
    MpcSettings { stages: 8, ..MpcSettings::default() }
}

#[test]
fn gradients_of_a_flight_by_weights_are_those_of_differences() {
    let system = closed(&short());
    let reference = Reference::Lemniscate(Lemniscate { rate: 2.0, ..Lemniscate::default() });
    let (start, inputs) = along(&system, &reference, 25);
    let weights = system.parameters();
    let rollout = Rollout::new(system, Distance).unwrap();
    let (cost, gradient) = rollout.gradient(&start, &inputs, &weights);
    let size = gradient.parameters.iter().zip(&weights).fold(0.0, |most: f64, (g, w)| most.max((g * w).abs()));
    assert!(cost > 0.0 && size > 0.0);
    let mut worst: f64 = 0.0;
    for k in (0..weights.len()).filter(|k| weights[*k] > 0.0) {
        let at = |share: f64| {
            let mut other = weights.clone();
            other[k] *= 1.0 + share;
            rollout.gradient(&start, &inputs, &other).0
        };
        let found = (at(1e-4) - at(-1e-4)) / 2e-4;
        worst = worst.max((found - gradient.parameters[k] * weights[k]).abs() / size);
    }
    println!("worst {worst:.1e} of the largest");
    // measured: 4e-9
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn a_tick_has_the_same_derivatives_forward_and_in_reverse() {
    let physics = Physics { dt: 0.01, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), physics).unwrap();
    let law = MpcLaw::new(&plant, &short()).unwrap();
    let function = Shared(law.inner.clone());
    let reference = Reference::Lemniscate(Lemniscate { rate: 2.0, ..Lemniscate::default() });
    let mut x = law.inner.cost.hover().to_vec();
    let first = x.len();
    x.resize(function.n_input(), 0.0);
    law.write_target(Target::level(&reference), 0.3, &mut x[first..first + law.n_target()]);
    x[first + law.n_target()..].copy_from_slice(&law.parameters());
    let along = |salt: f64, n: usize| -> Vec<f64> { (0..n).map(|i| (salt * (i + 1) as f64).sin()).collect() };
    let (dx, y_bar) = (along(0.7, x.len()), along(1.3, function.n_output()));
    let (mut dy, mut x_bar) = (vec![0.0; y_bar.len()], vec![0.0; x.len()]);
    function.forward(&x, &dx, &mut dy);
    function.reverse(&x, &y_bar, &mut x_bar);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (forward, reverse) = (dot(&y_bar, &dy), dot(&x_bar, &dx));
    let moved = |h: f64| -> Vec<f64> {
        let mut y = vec![0.0; y_bar.len()];
        function.value(&x.iter().zip(&dx).map(|(x, d)| x + h * d).collect::<Vec<_>>(), &mut y);
        y
    };
    let found = (dot(&y_bar, &moved(1e-5)) - dot(&y_bar, &moved(-1e-5))) / 2e-5;
    println!("{forward} forward, {reverse} in reverse, {found} by differences");
    // measured: 1e-15 and 1e-9 of it
    assert!((forward - reverse).abs() < 1e-10 * forward.abs() && (forward - found).abs() < 1e-6 * forward.abs());
}

/// Descent on ln w, so that weights stay positive: the same step of all, by the sign of their slopes.
#[test]
fn weights_tuned_by_gradients_track_better_where_they_were_not_tuned() {
    let system = closed(&MpcSettings { stages: 10, ..MpcSettings::default() });
    let lemniscate = |rate| Reference::Lemniscate(Lemniscate { rate, ..Lemniscate::default() });
    let circle = Reference::Circle(Circle::default());
    let tuned_on = along(&system, &lemniscate(2.2), 60);
    let held_out = [along(&system, &lemniscate(1.6), 60), along(&system, &circle, 60)];
    let mut weights = system.parameters();
    let rollout = Rollout::new(system, Distance).unwrap();
    let judged =
        |weights: &[f64]| held_out.each_ref().map(|(start, inputs)| rollout.gradient(start, inputs, weights).0);
    let (before, mut costs) = (judged(&weights), Vec::new());
    for _ in 0..4 {
        let (cost, gradient) = rollout.gradient(&tuned_on.0, &tuned_on.1, &weights);
        costs.push(cost);
        for (w, g) in weights.iter_mut().zip(&gradient.parameters) {
            // inputs keep their weight, so that what is tuned is the shares of the others
            *w *= (-0.3 * g.signum()).exp();
        }
    }
    let after = judged(&weights);
    println!("tuned on {costs:.6?}; held out {before:.6?}, then {after:.6?}");
    assert!(costs[3] < costs[0]);
    assert!(before.iter().zip(&after).all(|(before, after)| after < before), "{before:?}, {after:?}");
}
