//! Linear systems against others: sixty-one of them, with poles, responses, equations, norms and margins that
//! `tests/witnesses/linear.py` computed by mpmath (50 digits), slycot, scipy and python-control.

use nalgebra::{Complex, DMatrix};
use omnidrones::controllers::design::riccati;
use omnidrones::controllers::linear::margins::sensitivity;
use omnidrones::controllers::linear::{
    Hold, StateSpace, disk_margin, frequency_response, h_infinity, margins, multiloop_disk_margin, poles, zeros,
};
use serde::Deserialize;

type Rows = Vec<Vec<f64>>;

#[derive(Deserialize)]
struct Case {
    name: String,
    dt: Option<f64>,
    a: Rows,
    b: Rows,
    c: Rows,
    d: Rows,
    poles: Vec<[f64; 2]>,
    poles_condition: f64,
    omega: Vec<f64>,
    response: Vec<Vec<[f64; 2]>>,
    held: Option<Rows>,
    q: Rows,
    riccati: Rows,
    riccati_condition: f64,
    lyapunov: Option<Rows>,
    lyapunov_condition: Option<f64>,
    peak: Option<f64>,
    gains: Option<Vec<[f64; 2]>>,
    phases: Option<Vec<[f64; 2]>>,
    holds: Option<bool>,
    sensitivity: Option<f64>,
    disk: Option<f64>,
}

#[derive(Deserialize)]
struct File {
    systems: Vec<Case>,
}

fn matrix(rows: &Rows) -> DMatrix<f64> {
    let columns = rows.first().map_or(0, Vec::len);
    DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j])
}

impl Case {
    fn system(&self) -> StateSpace {
        StateSpace::new(matrix(&self.a), matrix(&self.b), matrix(&self.c), matrix(&self.d), self.dt).unwrap()
    }
}

fn cases() -> Vec<Case> {
    let file: File = serde_json::from_str(include_str!("../witnesses/linear.json")).unwrap();
    assert_eq!(file.systems.len(), 61);
    file.systems
}

/// The largest of a quantity over the cases that have it, by `f`, with its name; asserts that it is within `bound`, and prints it.
fn all_within(what: &str, bound: f64, f: impl Fn(&Case, &StateSpace) -> Option<f64>) {
    let (mut worst, mut n) = ((0.0, String::new()), 0);
    for case in cases() {
        if let Some(error) = f(&case, &case.system()) {
            n += 1;
            assert!(error <= bound, "{what} of {}: {error:.2e}", case.name);
            worst = if error >= worst.0 { (error, case.name) } else { worst };
        }
    }
    println!("{what}: {n} systems, worst {:.2e} ({})", worst.0, worst.1);
    assert!(n >= 20, "{what}: {n} systems");
}

/// The largest distance between two lists without order.
fn apart(one: &[Complex<f64>], other: &[[f64; 2]]) -> f64 {
    let mut left: Vec<_> = other.iter().map(|v| Complex::new(v[0], v[1])).collect();
    assert_eq!(one.len(), left.len());
    let mut most = 0.0_f64;
    for value in one {
        let distance = |v: &Complex<f64>| (v - value).norm();
        let at = (0..left.len()).min_by(|a, b| distance(&left[*a]).total_cmp(&distance(&left[*b]))).unwrap();
        most = most.max(distance(&left.swap_remove(at)));
    }
    most
}

#[test]
fn poles_are_those_of_fifty_digits() {
    // measured 2.2e-12
    all_within("poles, over their condition and the matrix", 2e-10, |case, system| {
        let size = case.poles_condition.max(1.0) * system.a().norm().max(1.0);
        Some(apart(&poles(system).unwrap(), &case.poles) / size)
    });
}

#[test]
fn responses_are_those_of_fifty_digits() {
    // measured 1.9e-13
    all_within("response", 5e-12, |case, system| {
        let found = frequency_response(system, &case.omega);
        let errors = found.values.iter().zip(&case.response).map(|(got, want)| {
            let want =
                DMatrix::from_row_iterator(got.nrows(), got.ncols(), want.iter().map(|v| Complex::new(v[0], v[1])));
            (got - &want).norm() / want.norm()
        });
        Some(errors.fold(0.0, f64::max))
    });
}

#[test]
fn held_inputs_give_the_steps_of_fifty_digits_and_tustin_comes_back() {
    // measured 2.1e-15
    all_within("steps under held inputs", 2e-13, |case, system| {
        let held = case.held.as_ref().map(matrix)?;
        let sampled = system.sampled(0.05, Hold::Zero).unwrap();
        let n = system.n_state();
        let error =
            (sampled.a() - held.columns(0, n)).norm() + (sampled.b() - held.columns(n, system.n_input())).norm();
        Some(error / held.norm())
    });
    // measured 2.8e-14
    all_within("there and back by Tustin", 2e-12, |case, system| {
        let there = if case.dt.is_some() { system.continuous() } else { system.sampled(0.05, Hold::Tustin) }.ok()?;
        let back = if let Some(dt) = case.dt { there.sampled(dt, Hold::Tustin) } else { there.continuous() }.ok()?;
        let response = |s: &StateSpace| frequency_response(s, &case.omega[1..2]).values[0].clone();
        Some((response(system) - response(&back)).norm() / response(system).norm())
    });
}

#[test]
fn riccati_and_lyapunov_solutions_are_those_of_fifty_digits() {
    // measured 3.2e-15
    all_within("Riccati, over its condition", 3e-13, |case, system| {
        let (q, r) = (matrix(&case.q), DMatrix::identity(system.n_input(), system.n_input()));
        let solve = if case.dt.is_some() { riccati::discrete } else { riccati::continuous };
        let (x, want) = (solve(system.a(), system.b(), &q, &r).unwrap().matrix, matrix(&case.riccati));
        Some((x - &want).norm() / want.norm() / case.riccati_condition.max(1.0))
    });
    // measured 3.6e-16
    all_within("Lyapunov, over its condition", 3e-14, |case, system| {
        let (q, want) = (matrix(&case.q), case.lyapunov.as_ref().map(matrix)?);
        let solve = if case.dt.is_some() { riccati::lyapunov } else { riccati::continuous_lyapunov };
        let x = solve(system.a(), &q).unwrap().matrix;
        Some((x - &want).norm() / want.norm() / case.lyapunov_condition?.max(1.0))
    });
}

#[test]
fn peaks_over_frequency_are_those_of_slycot() {
    // measured 1.6e-14
    all_within("peak", 1e-12, |case, system| {
        let (got, want) = (h_infinity(system).unwrap().gain, case.peak?);
        Some((got / want - 1.0).abs())
    });
    // measured 4.3e-13
    all_within("peak of the sensitivity", 4e-11, |case, system| {
        let want = case.sensitivity?;
        let got = h_infinity(&sensitivity(system).unwrap()).unwrap().gain;
        Some((got / want - 1.0).abs())
    });
}

#[test]
fn margins_are_those_of_python_control() {
    // measured 6.6e-15
    all_within("gain and phase margins", 6e-13, |case, system| {
        let (gains, phases) = (case.gains.as_ref()?, case.phases.as_ref()?);
        let found = margins(system).unwrap();
        assert_eq!(Some(found.stable), case.holds, "{}", case.name);
        let top = system.nyquist() * (1.0 - 1e-6);
        let pairs = |list: &[omnidrones::controllers::linear::Crossing]| -> Vec<[f64; 2]> {
            list.iter().filter(|c| c.omega > 1e-6 && c.omega < top).map(|c| [c.omega, c.margin]).collect()
        };
        let worst = |got: Vec<[f64; 2]>, want: &[[f64; 2]]| {
            assert_eq!(got.len(), want.len(), "{}: {got:?} against {want:?}", case.name);
            let error = |(g, w): (&[f64; 2], &[f64; 2])| {
                (g[0] / w[0] - 1.0).abs().max((g[1] - w[1]).abs() / w[1].abs().max(1.0))
            };
            got.iter().zip(want).map(error).fold(0.0, f64::max)
        };
        Some(worst(pairs(&found.gains), gains).max(worst(pairs(&found.phases), phases)))
    });
}

#[test]
fn disk_margins_are_those_of_slycot() {
    // measured 8.6e-11
    all_within("disk margin", 5e-9, |case, system| {
        let want = case.disk?;
        let got = if system.n_input() == 1 { disk_margin(system, 0.0) } else { multiloop_disk_margin(system, 0.0) };
        Some((got.unwrap().alpha / want - 1.0).abs())
    });
}

/// Stages (s + z)/(s + p) in a row and an integrator: as many zeros as stages, known to the last one. Above 31 stages none was found.
#[test]
fn zeros_of_a_chain_are_those_of_its_stages_whatever_their_number() {
    let scalar = |a: f64, b: f64, c: f64, d: f64| {
        let [a, b, c, d] = [a, b, c, d].map(|v| DMatrix::from_element(1, 1, v));
        StateSpace::new(a, b, c, d, None).unwrap()
    };
    for n in [3, 10, 15, 16, 30, 31, 32, 33, 40] {
        let places: Vec<f64> = (0..n).map(|k| 10.0_f64.powf(k as f64 / n as f64)).collect();
        let mut chain = scalar(0.0, 1.0, 1.0, 0.0);
        for (k, z) in places.iter().enumerate() {
            let p = 1.1 * places[(k * 7) % n];
            chain = chain.series(&scalar(-p, 1.0, z - p, 1.0)).unwrap();
        }
        let found = zeros(&chain).unwrap();
        let nearest = |z: &f64| found.iter().map(|own| (own + z).norm() / z).fold(f64::INFINITY, f64::min);
        let worst = places.iter().map(nearest).fold(0.0, f64::max);
        println!("{n}: {} found, {worst:.1e}", found.len());
        // they are as ill conditioned as that; measured 1.9e-5 of 40
        assert!(found.len() == n && worst < 1e-2, "{n}: {} found, {worst:e}: {found:?}", found.len());
    }
}

/// Notches (s² + 2ζωs + ω²)/(s + p)² in a row and an integrator: pairs of zeros, known to the last one. They came out some hundredths off.
#[test]
fn zeros_of_notches_are_their_pairs() {
    let matrix = |rows, columns, values: &[f64]| DMatrix::from_row_slice(rows, columns, values);
    for n in [1, 2, 4, 8] {
        let notches: Vec<(f64, f64)> = (0..n).map(|k| (1.0 + 0.7 * k as f64, 0.05 + 0.1 * k as f64)).collect();
        let one = |v| matrix(1, 1, &[v]);
        let mut chain = StateSpace::new(one(0.0), one(1.0), one(1.0), one(0.0), None).unwrap();
        for (w, zeta) in &notches {
            let p = 1.5 * w;
            let a = matrix(2, 2, &[0.0, 1.0, -p * p, -2.0 * p]);
            let c = matrix(1, 2, &[w * w - p * p, 2.0 * zeta * w - 2.0 * p]);
            chain = chain.series(&StateSpace::new(a, matrix(2, 1, &[0.0, 1.0]), c, one(1.0), None).unwrap()).unwrap();
        }
        let found = zeros(&chain).unwrap();
        assert_eq!(found.len(), 2 * n, "{found:?}");
        for (w, zeta) in &notches {
            for sign in [1.0, -1.0] {
                let wanted = Complex::new(-zeta * w, sign * w * (1.0 - zeta * zeta).sqrt());
                let off = found.iter().map(|own| (own - wanted).norm()).fold(f64::INFINITY, f64::min);
                // measured: 2e-11 of eight
                assert!(off < 1e-8 * w, "{n}: {wanted} missed by {off:e}: {found:?}");
            }
        }
    }
}
