//! The step over the scalars that cost most to compile, at one rotor count for all vehicles (the rest are dead).
//! Plain, dual, traced and lane steps of the public system are compared in `tests/autodiff/one_source.rs`.

use super::*;
use crate::{Vehicle, vehicles};
use autodiff::jet::Jet;
use num_dual::{Derivative, Dual64, DualSVec64, DualVec, HyperDual64};
use rng::{Purpose, Stream};

/// Enough for every built-in vehicle.
const R: usize = 12;
/// Position to rotor speeds, actions, disturbance.
const N: usize = 13 + R + R + 9;

struct Case {
    name: String,
    model: RigidModel<f64, R>,
    effects: Effects,
    grid: Grid,
    points: Vec<[f64; N]>,
}

fn cases(seed: u64) -> Vec<Case> {
    let mut list = Vec::new();
    for vehicle in vehicles::all() {
        for integrator in [Integrator::RungeKutta4, Integrator::SemiImplicit] {
            for effects in [Effects::none(), Effects::lean(), Effects::default(), Effects::all()] {
                let grid = Grid { integrator, substep: 0.002, substeps: 1 };
                let model = RigidModel::new(&vehicle, grid.substep);
                let mut r = Stream::new(seed, list.len() as u64, 0, Purpose::user(70));
                list.push(Case {
                    name: format!("{} {integrator:?} {effects:?}, seed {seed}", vehicle.name),
                    effects: model.effects_of(effects),
                    points: (0..50).map(|_| point(&vehicle, &mut r)).collect(),
                    model,
                    grid,
                });
            }
        }
    }
    list
}

fn point(vehicle: &Vehicle, r: &mut Stream) -> [f64; N] {
    let mut z = [0.0; N];
    for (k, z) in z.iter_mut().enumerate() {
        *z = match k {
            2 => r.uniform(1.0, 4.0),
            0..6 | 10..13 => r.uniform(-3.0, 3.0),
            6..10 => r.normal(),
            k if k < 13 + vehicle.n_rotor() => vehicle.rotors[k - 13].max_speed * r.uniform(0.1, 0.95),
            k if k < 13 + R => 0.0,
            k if k < 13 + 2 * R => r.uniform(-0.95, 0.95),
            _ => 0.01 * r.uniform(-1.0, 1.0),
        };
    }
    let norm = z[6..10].iter().map(|q| q * q).sum::<f64>().sqrt();
    z[6..10].iter_mut().for_each(|q| *q /= norm);
    z
}

impl Case {
    /// One step over any scalar, numbers lifted by `lift`.
    fn step<S: Scalar>(&self, z: &[f64; N], lift: impl Fn(usize, f64) -> S) -> Vec<S> {
        let z: Vec<S> = z.iter().enumerate().map(|(k, v)| lift(k, *v)).collect();
        let mut action = [S::zero(); R];
        action.copy_from_slice(&z[13 + R..13 + 2 * R]);
        let (x, air) = (RigidState::read(&z[..13 + R]), Disturbance::read(&z[13 + 2 * R..]));
        let mut next = vec![S::zero(); 13 + R];
        step::<S, R>(&self.model.cast(), self.effects, self.grid, &x, &action, &air).write(&mut next);
        next
    }

    fn plain(&self, z: &[f64; N]) -> Vec<f64> {
        self.step(z, |_, v| v)
    }
}

fn largest(a: impl Iterator<Item = f64>, b: &[f64]) -> f64 {
    let scale = b.iter().fold(1.0, |s: f64, x| s.max(x.abs()));
    a.zip(b).map(|(x, y)| (x - y).abs() / scale).fold(0.0, |m, e| if e.is_nan() { f64::INFINITY } else { m.max(e) })
}

fn slope(k: usize, direction: usize) -> f64 {
    (1.3 * k as f64 + 0.7 * direction as f64).cos()
}

#[test]
fn a_dual_step_of_three_directions_has_the_plain_value_bit_for_bit_and_the_slopes_of_single_duals() {
    let mut worst = 0.0_f64;
    for case in cases(11) {
        for z in &case.points {
            let wide: Vec<DualSVec64<3>> = case.step(z, |k, v| {
                DualVec::new(v, Derivative::some(nalgebra::vector![slope(k, 0), slope(k, 1), slope(k, 2)]))
            });
            assert!(wide.iter().map(|d| d.re).eq(case.plain(z)), "{}", case.name);
            let columns = wide.iter().map(|d| d.eps.unwrap_generic(nalgebra::Const::<3>, nalgebra::U1));
            let columns: Vec<_> = columns.collect();
            for d in 0..3 {
                let single = case.step(z, |k, v| Dual64::new(v, slope(k, d)));
                let single: Vec<f64> = single.iter().map(|n| n.eps).collect();
                worst = worst.max(largest(columns.iter().map(|c| c[d]), &single));
            }
        }
    }
    println!("wide against single: {worst:.1e}");
    assert!(worst <= 1e-13, "{worst:e}"); // measured 0
}

#[test]
fn a_hyperdual_step_has_the_plain_value_bit_for_bit_and_second_derivatives_that_differenced_duals_confirm() {
    let mut worst = 0.0_f64;
    for case in cases(12) {
        for z in &case.points {
            let size = |k: usize| if (13..13 + R).contains(&k) { 10.0 } else { 0.3 };
            let (a, b) = (|k: usize| slope(k, 0) * size(k), |k: usize| slope(k, 1) * size(k));
            let hyper = case.step(z, |k, v| HyperDual64::new(v, a(k), b(k), 0.0));
            assert!(hyper.iter().map(|d| d.re).eq(case.plain(z)), "{}", case.name);
            let h = 1e-5;
            let first = |h: f64| case.step(z, |k, v| Dual64::new(v + h * b(k), a(k)));
            let second = first(h).into_iter().zip(first(-h)).map(|(p, m)| (p.eps - m.eps) / (2.0 * h));
            let exact: Vec<f64> = hyper.iter().map(|d| d.eps1eps2).collect();
            let error = largest(second, &exact);
            worst = worst.max(error);
            assert!(error <= 1e-6, "{}: {error:e}", case.name);
        }
    }
    println!("hyperdual against differenced dual: {worst:.1e}"); // measured 2.2e-9
}

#[test]
fn the_head_of_a_taylor_series_is_the_plain_step_bit_for_bit_and_its_coefficients_are_derivatives() {
    let mut worst = [0.0_f64; 2];
    for case in cases(13) {
        for z in &case.points {
            let jet = case.step(z, |k, v| Jet::<f64, 3> { coefficients: [v, slope(k, 0), 0.0] });
            assert!(jet.iter().map(Jet::value).eq(case.plain(z)), "{}", case.name);
            let hyper = case.step(z, |k, v| HyperDual64::new(v, slope(k, 0), slope(k, 0), 0.0));
            let first: Vec<f64> = hyper.iter().map(|d| d.eps1).collect();
            let second: Vec<f64> = hyper.iter().map(|d| d.eps1eps2).collect();
            worst[0] = worst[0].max(largest(jet.iter().map(|j| j.derivative(1)), &first));
            worst[1] = worst[1].max(largest(jet.iter().map(|j| j.derivative(2)), &second));
        }
    }
    println!("jet against hyperdual: {:.1e}, {:.1e}", worst[0], worst[1]);
    assert!(worst[0] <= 1e-13 && worst[1] <= 1e-12, "{worst:?}"); // measured 3.2e-15, 4.6e-15
}
