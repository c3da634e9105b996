//! A system that tests of this room differentiate: of the size of a vehicle's, and without one.

use crate::{Scalar, System, safe};

/// A quadrotor, four lagging rotors and all, with a load of 0.2 kg on a spring if `is_loaded`; a step is one of RK4.
///
/// x = [p, q, v, ω, Ω] and the load's [p, v]; u: rotor commands.
#[derive(Clone)]
pub(crate) struct Quadrotor {
    pub is_loaded: bool,
}

const DT: f64 = 0.002;

impl Quadrotor {
    /// At rest.
    pub fn rest(&self) -> Vec<f64> {
        let mut x = vec![0.0, -0.0, 1.0, 1.0, 0.0, -0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5];
        if self.is_loaded {
            x.extend([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]);
        }
        x
    }

    fn derivative<S: Scalar>(&self, x: &[S], u: &[S]) -> Vec<S> {
        let c = S::constant;
        let (q, v, w, speed) = (&x[3..7], &x[7..10], &x[10..13], &x[13..17]);
        let squared: Vec<S> = speed.iter().map(|s| s.square()).collect();
        let thrust = c(7.0) * (squared[0] + squared[1] + squared[2] + squared[3]);
        let up = [
            c(2.0) * (q[1] * q[3] + q[0] * q[2]),
            c(2.0) * (q[2] * q[3] - q[0] * q[1]),
            c(1.0) - c(2.0) * (q[1].square() + q[2].square()),
        ];
        let mut pull = [S::zero(); 3];
        if self.is_loaded {
            let to = [0, 1, 2].map(|k| x[17 + k] - x[k]);
            let length = safe::norm(to);
            pull = [0, 1, 2].map(|k| c(30.0) * (length - c(0.6)).max(S::zero()) * to[k] / (length + c(1e-3)));
        }
        let air = c(0.1) * safe::norm([v[0], v[1], v[2]]);
        let mut rate = v.to_vec();
        rate.extend([
            c(-0.5) * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]),
            c(0.5) * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]),
            c(0.5) * (q[0] * w[1] - q[1] * w[2] + q[3] * w[0]),
            c(0.5) * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]),
        ]);
        rate.extend((0..3).map(|k| {
            let weight = if k == 2 { c(-9.81) } else { S::zero() };
            thrust / c(0.7) * up[k] + pull[k] / c(0.7) + weight - air * v[k]
        }));
        rate.push(c(170.0) * (squared[1] - squared[3]) - c(0.7) * w[1] * w[2]);
        rate.push(c(170.0) * (squared[2] - squared[0]) + c(0.7) * w[2] * w[0]);
        rate.push(c(9.0) * (squared[0] - squared[1] + squared[2] - squared[3]));
        rate.extend((0..4).map(|k| {
            let gap = c(0.5) * (u[k].min(S::one()).max(c(-1.0)) + S::one()) - speed[k];
            gap * S::select(gap.lt(S::zero()), c(20.0), c(30.0))
        }));
        if self.is_loaded {
            rate.extend_from_slice(&x[20..23]);
            rate.extend((0..3).map(|k| if k == 2 { c(-9.81) } else { S::zero() } - pull[k] / c(0.2)));
        }
        rate
    }
}

impl System for Quadrotor {
    fn n_state(&self) -> usize {
        17 + if self.is_loaded { 6 } else { 0 }
    }
    fn n_input(&self) -> usize {
        4
    }
    fn step<S: Scalar>(&self, x: &[S], u: &[S], _: &[S], next: &mut [S]) {
        let moved =
            |rate: &[S], dt: f64| -> Vec<S> { x.iter().zip(rate).map(|(x, r)| *x + S::constant(dt) * *r).collect() };
        let k1 = self.derivative(x, u);
        let k2 = self.derivative(&moved(&k1, DT / 2.0), u);
        let k3 = self.derivative(&moved(&k2, DT / 2.0), u);
        let k4 = self.derivative(&moved(&k3, DT), u);
        for (k, next) in next.iter_mut().enumerate() {
            *next = x[k] + S::constant(DT / 6.0) * (k1[k] + S::constant(2.0) * (k2[k] + k3[k]) + k4[k]);
        }
        let norm = safe::norm([next[3], next[4], next[5], next[6]]);
        next[3..7].iter_mut().for_each(|q| *q = *q / norm);
    }
}
