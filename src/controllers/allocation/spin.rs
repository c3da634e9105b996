//! Hover of a vehicle that must turn to stay up, such as a quadrotor on three rotors.
//!
//! Thrusts that carry the weight without turning the body ever faster (no yaw moment) leave a moment M across body z. A body that
//! turns at Ω about an axis n beside body z needs just that to go on as it is, ω × Jω = M with ω = Ω n, so with principal axes
//!
//! ```text
//! n_x n_z = −M_y / ((J_z − J_x) Ω²),   n_y n_z = M_x / ((J_z − J_y) Ω²)
//! ```
//!
//! n stays vertical; the thrust along body z turns around it, and its mean carries the weight: T n_z = m g. Turning slower, the body
//! needs less of M, the rotor that makes it pushes less, and the yaw moment that is then missing turns the body faster, and the other
//! way round: the rate holds itself.
//!
//! Source: Mueller and D'Andrea 2014 (relaxed hover solutions); rotors' own angular momentum and drag are left out.

use super::allocator::Allocator;
use super::attainable_wrench::{AttainableWrenches, WrenchMargin};
use super::problem::{Problem, WRENCH};
use crate::dynamics::spatial::Vec3;
use crate::error::Result;
use nalgebra::Matrix3;

/// Sine of the angle between n and body z.
const LEAN: f64 = 0.3;
/// Least difference of moments of inertia about z and across, and largest product of inertia, as a share of the moment about z.
const LEAST_DIFFERENCE: f64 = 0.05;
/// Least room around its thrusts, as a share of the weight: what steers it must push both ways in every turn. A Crazyflie has half of
/// it and, at 47 rad/s behind motors of 20 ms, falls.
const ROOM: f64 = 0.1;
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
        let difference = [0, 1].map(|k| j[(2, 2)] - j[(k, k)]);
        let upright = (1.0 - LEAN * LEAN).sqrt();
        let wanted = [0.0, 0.0, weight / upright, 0.0, 0.0, 0.0];
        let (thrusts, made) = best(problem, &BALANCE, &wanted)?;
        let (_, started) = best(problem, &SPIN_UP, hover)?;
        let room = WrenchMargin::within(problem, three, &[0.0, 0.0, made[2], made[3], made[4], 0.0])?;
        let balanced = (made[2] - wanted[2]).abs() < least && made[5].abs() < 0.1 * started[5].abs();
        let can_start = started[2] > 0.99 * weight && started[3].hypot(started[4]) < least * three.length();
        let small = LEAST_DIFFERENCE * j[(2, 2)];
        let principal = [(0, 1), (0, 2), (1, 2)].iter().all(|place| j[*place].abs() < small);
        let differs = principal && difference.iter().all(|d| d.abs() > small);
        if !(balanced && can_start && differs && room.margin.distance > ROOM * weight) {
            return Ok(None);
        }
        let across = [-made[4] / difference[0], made[3] / difference[1]];
        let size = across[0].hypot(across[1]);
        let squared = size * upright / LEAN;
        let axis = [LEAN * across[0] / size, LEAN * across[1] / size, upright];
        Ok(Some(Self { rate: squared.sqrt().copysign(started[5]), axis, thrusts }))
    }
}

/// Thrusts and the wrench they make.
fn best(problem: &Problem, priorities: &[f64; WRENCH], wanted: &[f64; WRENCH]) -> Result<(Vec<f64>, [f64; WRENCH])> {
    let mut allocator = Allocator::new(problem.clone().with_priorities(priorities))?;
    allocator.solve(wanted);
    let thrusts = allocator.solution().inputs.clone();
    let made = problem.delivered(&thrusts);
    Ok((thrusts, made))
}
