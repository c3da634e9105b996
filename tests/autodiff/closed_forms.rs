//! Contract: duals through the articulated equations are the derivatives of closed forms, differentiated by hand.

use crate::common::measure::larger;
use crate::common::tree::{attitude, stream};
use nalgebra::{DMatrix, Matrix2, Matrix3, Vector2, Vector3};
use num_dual::Dual64;
use omnidrones::autodiff::System;
use omnidrones::dynamics::assembly::single;
use omnidrones::dynamics::tree::Multibody;
use omnidrones::dynamics::urdf::{ImportOptions, import_model_file};
use omnidrones::dynamics::{Effects, Inertia, Part, Physics, vehicles};

/// ∂ẋ/∂[x; u] by duals.
fn by_duals(system: &Multibody, x: &[f64], u: &[f64]) -> DMatrix<f64> {
    let (n, m) = (x.len(), u.len());
    let mut jacobian = DMatrix::zeros(n, n + m);
    let mut z: Vec<Dual64> = x.iter().chain(u).map(|v| Dual64::from(*v)).collect();
    let mut rate = vec![Dual64::from(0.0); n];
    for k in 0..n + m {
        z[k].eps = 1.0;
        system.derivative(&z[..n], &z[n..], &[], &mut rate);
        z[k].eps = 0.0;
        jacobian.column_mut(k).iter_mut().zip(&rate).for_each(|(entry, rate)| *entry = rate.eps);
    }
    jacobian
}

/// Largest |a − b| over the largest |b|.
fn gap(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

/// ∂q̈/∂(q, q̇) of the double pendulum of `tests/assets`, from M q̈ = r: M ∂q̈ = ∂r − ∂M q̈.
fn double_pendulum([q1, q2, v1, v2]: [f64; 4]) -> DMatrix<f64> {
    let (m1, c1, j1, l1, m2, c2, j2, g, damping) = (1.2, 0.25, 0.025, 0.5, 0.7, 0.2, 0.01, 9.81, 0.01);
    let (a, b, c) = (j1 + m1 * c1 * c1 + m2 * l1 * l1 + j2 + m2 * c2 * c2, m2 * l1 * c2, j2 + m2 * c2 * c2);
    let (sin, cos) = q2.sin_cos();
    let inverse = Matrix2::new(a + 2.0 * b * cos, c + b * cos, c + b * cos, c).try_inverse().unwrap();
    let (upper, lower) = ((m1 * c1 + m2 * l1) * g, m2 * c2 * g);
    let (falls, tips) = (lower * (q1 + q2).sin(), lower * (q1 + q2).cos());
    let r = Vector2::new(
        b * sin * (2.0 * v1 * v2 + v2 * v2) - upper * q1.sin() - falls - damping * v1,
        -b * sin * v1 * v1 - falls,
    );
    let mass_by_q2 = -b * sin * Matrix2::new(2.0, 1.0, 1.0, 0.0);
    let columns = [
        Vector2::new(-upper * q1.cos() - tips, -tips),
        Vector2::new(b * cos * (2.0 * v1 * v2 + v2 * v2) - tips, -b * cos * v1 * v1 - tips)
            - mass_by_q2 * (inverse * r),
        Vector2::new(2.0 * b * sin * v2 - damping, -2.0 * b * sin * v1),
        Vector2::new(2.0 * b * sin * (v1 + v2), 0.0),
    ];
    DMatrix::from_fn(2, 4, |i, k| (inverse * columns[k])[i])
}

#[test]
fn duals_of_a_double_pendulum_are_its_equation_differentiated_by_hand() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/assets/double_pendulum.urdf");
    let model = import_model_file(file, &ImportOptions::default()).unwrap().model;
    let system = Multibody::new(&model, Physics { effects: Effects::none(), ..Physics::default() }).unwrap();
    let (mut r, mut worst) = (stream(50, 0), 0.0_f64);
    for _ in 0..200 {
        // the elbow stops at 2.5 rad
        let x: [f64; 4] = [3.0, 2.0, 5.0, 5.0].map(|most| r.uniform(-most, most));
        let duals = by_duals(&system, &x, &[]).rows(2, 2).into_owned();
        worst = larger(worst, gap(&duals, &double_pendulum(x)));
        // twin: a state a millionth away
        let beside = double_pendulum([x[0], x[1] + 1e-6, x[2], x[3]]);
        assert!(gap(&duals, &beside) > 1e-10);
    }
    println!("double pendulum: {worst:.1e}"); // measured 4.6e-15
    assert!(worst <= 5e-13, "{worst:e}");
}

#[test]
fn duals_of_a_free_body_are_its_equations_differentiated_by_hand() {
    let mut vehicle = vehicles::by_name("hummingbird").unwrap();
    let inertia = Inertia { xx: 0.010, yy: 0.015, zz: 0.020, xy: 0.001, xz: -0.002, yz: 0.0015 };
    vehicle.parts = vec![Part::new("body", 0.7, [0.0; 3], inertia)];
    let effects = Effects { disturbance: true, ..Effects::none() };
    let system = Multibody::new(&single(&vehicle).unwrap(), Physics { effects, ..Physics::default() }).unwrap();
    let (j, n) = (inertia.matrix(), system.n_state());
    let inverse = j.try_inverse().unwrap();
    let force = n + system.layout().trees[0].disturbance.unwrap() + 3;
    let (mut r, mut worst) = (stream(51, 0), 0.0_f64);
    for _ in 0..200 {
        let (mut x, mut u) = (vec![0.0; n], vec![0.0; system.n_input()]);
        x[..6].fill_with(|| r.uniform(-2.0, 2.0));
        x[6..10].copy_from_slice(&attitude(&mut r));
        x[10..13].fill_with(|| r.uniform(-5.0, 5.0));
        u[force - n..].fill_with(|| r.uniform(-1.0, 1.0));
        let w = Vector3::new(x[10], x[11], x[12]);
        let duals = by_duals(&system, &x, &u);
        // J ω̇ = M − ω × Jω, m v̇ = F + m g
        let turning = inverse * ((j * w).cross_matrix() - w.cross_matrix() * j);
        let blocks = [(10, 10, turning), (10, force + 3, inverse), (3, force, Matrix3::identity() / 0.7)];
        for (row, column, wanted) in blocks {
            let block = duals.view((row, column), (3, 3));
            worst = larger(worst, (block - wanted).amax() / wanted.amax());
        }
    }
    println!("free body: {worst:.1e}"); // measured 5.7e-15
    assert!(worst <= 5e-13, "{worst:e}");
}
