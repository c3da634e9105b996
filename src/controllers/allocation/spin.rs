//! Hover of a vehicle that must turn to stay up, such as a quadrotor on three rotors.
//!
//! Thrusts that carry the weight without turning the body ever faster (no yaw moment) leave a moment M across body z. A body that
//! turns at Ω about an axis n beside body z needs just that to go on as it is, ω × Jω = M with ω = Ω n, so with principal axes
//!
//! ```text
//! n_x n_z = −M_y / ((J_z − J_x) Ω²),   n_y n_z = M_x / ((J_z − J_y) Ω²)
//! ```
//!
//! With products of inertia, n leans in the direction φ in which n × Jn points along M across z; about z it leaves what the rotors
//! have to make besides.
//!
//! n stays vertical; the thrust along body z turns around it, and its mean carries the weight: T n_z = m g. Turning slower, the body
//! needs less of M, the rotor that makes it pushes less, and the yaw moment that is then missing turns the body faster, and the other
//! way round: the rate holds itself.
//!
//! Source: Mueller and D'Andrea 2014 (relaxed hover solutions); rotors' own angular momentum and drag are left out.

use super::allocator::Allocator;
use super::attainable_wrench::{AttainableWrenches, WrenchMargin};
use super::problem::{Problem, WRENCH};
use base::error::Result;
use dynamics::spatial::Vec3;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Sine of the angle between n and body z.
const LEAN: f64 = 0.3;
/// Least difference of moments of inertia about z and across, and largest product of inertia in axes along the lean, as a share of the
/// moment about z. A Hummingbird with a product of 5.4 % is flown on, one with 8.3 % has a steady turn and is lost by our controller.
const LEAST_DIFFERENCE: f64 = 0.05;
/// Most turns of the axis until it and the thrusts belong together, and by what share the last changes it.
const TURNS: usize = 50;
const SETTLED: f64 = 1e-9;
/// Least room around its thrusts, as a share of the weight: what steers it must push both ways in every turn. A Crazyflie has half of
/// it and, at 47 rad/s behind motors of 20 ms, falls.
pub(super) const ROOM: f64 = 0.1;
/// Thrust and yaw balance before all else; what is left about x and y is least.
const BALANCE: [f64; WRENCH] = [1e-4, 1e-4, 100.0, 0.01, 0.01, 100.0];
/// Roll and pitch balance before thrust before yaw: what turns the body up to its rate.
const SPIN_UP: [f64; WRENCH] = [1e-4, 1e-4, 1.0, 100.0, 100.0, 1e-3];

/// A steady turn that carries the weight, in the axes in which the whole vehicle hovers level: the body's, but of one that leans.
#[derive(Debug, Clone, PartialEq)]
pub struct Spin {
    /// Ω n_z about z, rad/s, in the sense that the rotors start.
    pub rate: f64,
    /// n.
    pub axis: Vec3<f64>,
    /// Thrust of each rotor, N.
    pub thrusts: Vec<f64>,
}

impl Spin {
    /// For the wrench of `hover` and a body of inertia `j`; `three` are the thrusts, roll and pitch moments that are attainable in
    /// `problem`. `None` where there is no such turn to within `least` (N), or too little room around it.
    pub(super) fn of(
        problem: &Problem,
        three: &AttainableWrenches,
        hover: &[f64; WRENCH],
        j: &Matrix3<f64>,
        least: f64,
    ) -> Result<Option<Self>> {
        let weight = hover[2];
        let upright = (1.0 - LEAN * LEAN).sqrt();
        let lift = weight / upright;
        let (_, started) = best(problem, &SPIN_UP, hover)?;
        if !differs(j) {
            return Ok(None);
        }
        let Some(Turn { axis, squared, thrusts, made }) = steady(problem, lift, j)? else { return Ok(None) };
        let room = WrenchMargin::within(problem, three, &[0.0, 0.0, made[2], made[3], made[4], 0.0])?;
        let needed = squared * about(&axis, j).z;
        let balanced = (made[2] - lift).abs() < least && (made[5] - needed).abs() < 0.1 * started[5].abs();
        let can_start = started[2] > 0.99 * weight && started[3].hypot(started[4]) < least * three.length();
        if !(balanced && can_start && is_principal(&axis, j) && room.margin.distance > ROOM * weight) {
            return Ok(None);
        }
        Ok(Some(Self { rate: upright * squared.sqrt().copysign(started[5]), axis: axis.into(), thrusts }))
    }
}

/// n × J n.
fn about(n: &Vector3<f64>, j: &Matrix3<f64>) -> Vector3<f64> {
    n.cross(&(j * n))
}

/// Whether the moment about z differs from those across: else no axis beside z holds a moment.
fn differs(j: &Matrix3<f64>) -> bool {
    let across = j.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues();
    across.iter().all(|moment| (j[(2, 2)] - moment).abs() > LEAST_DIFFERENCE * j[(2, 2)])
}

/// Whether axes along the lean of n, across it and z are principal ones, nearly.
fn is_principal(n: &Vector3<f64>, j: &Matrix3<f64>) -> bool {
    let along = Vector3::new(n.x, n.y, 0.0).normalize();
    let (across, up) = (Vector3::z().cross(&along), Vector3::z());
    let products = [along.dot(&(j * across)), along.dot(&(j * up)), across.dot(&(j * up))];
    products.iter().all(|product| product.abs() < LEAST_DIFFERENCE * j[(2, 2)])
}

/// A turn that goes on as it is.
struct Turn {
    /// n.
    axis: Vector3<f64>,
    /// Ω², rad²/s².
    squared: f64,
    /// Of each rotor, N.
    thrusts: Vec<f64>,
    /// What they make.
    made: [f64; WRENCH],
}

/// Axis, rate and thrusts that belong together: each turn of the axis has the thrusts whose moment about z the axis before needs.
fn steady(problem: &Problem, lift: f64, j: &Matrix3<f64>) -> Result<Option<Turn>> {
    let upright = (1.0 - LEAN * LEAN).sqrt();
    let moments = j.fixed_view::<2, 2>(0, 0);
    let Some(inverse) = (Matrix2::from_diagonal_element(j[(2, 2)]) - moments).try_inverse() else { return Ok(None) };
    let products = Vector2::new(j[(0, 2)], j[(1, 2)]);
    // Ω² times the direction of the lean, and what products of inertia with z add to n × Jn
    let (mut scaled, mut yaw) = (Vector2::zeros(), 0.0);
    for _ in 0..TURNS {
        let (thrusts, made) = best(problem, &BALANCE, &[0.0, 0.0, lift, 0.0, 0.0, yaw])?;
        let e = scaled.try_normalize(0.0).unwrap_or_else(Vector2::zeros);
        let (flat, tall) = (LEAN * LEAN * products.dot(&e), upright * upright);
        let added = Vector2::new(e.y * flat - tall * products.y, tall * products.x - e.x * flat) * scaled.norm();
        let wanted = Vector2::new(added.y - made[4], made[3] - added.x);
        let before = std::mem::replace(&mut scaled, inverse * wanted / (LEAN * upright));
        let squared = scaled.norm();
        if !(squared > 0.0 && squared.is_finite()) {
            return Ok(None);
        }
        let axis = Vector3::new(LEAN * scaled.x / squared, LEAN * scaled.y / squared, upright);
        yaw = squared * about(&axis, j).z;
        if (scaled - before).norm() < SETTLED * squared {
            return Ok(Some(Turn { axis, squared, thrusts, made }));
        }
    }
    Ok(None)
}

/// Thrusts and the wrench they make.
fn best(problem: &Problem, priorities: &[f64; WRENCH], wanted: &[f64; WRENCH]) -> Result<(Vec<f64>, [f64; WRENCH])> {
    let mut allocator = Allocator::new(problem.clone().with_priorities(priorities))?;
    allocator.solve(wanted);
    let thrusts = allocator.solution().inputs.clone();
    let made = problem.delivered(&thrusts);
    Ok((thrusts, made))
}
