//! Hover: fly to a point and hold it, with a heading.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `target` | 3 | m, world | p_t − p | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `heading_error` | 3 | -, world | h_t − h | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 30 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | r_p = 1/(1 + (1.2 d)²) | 1 | smooth |
//! | `up` | r_p ((u_z + 1)/2)² | 1 | smooth |
//! | `spin` | r_p/(1 + ω_z²) | 1 | smooth |
//! | `effort` | 0.1 e^{−e} | 0.1 | smooth |
//! | *sum* | | 3.1 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | z < 0.2 m |
//! | `far` | d > 4 |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `horizon` | 500 | T, steps |
//!
//! p drone, v, ω velocity and angular velocity (world), h = R e_x heading, u = R e_z, e = Σ s effort, k steps. Target:
//! (0, 0, 2) m, heading h_t at a yaw drawn in [0, 2π). Start: p uniform in ±2.5 × ±2.5 × [1, 2.5] m, roll and pitch
//! within ±0.2π, any yaw, at rest. d = ‖(p_t − p, h_t − h)‖.
//!
//! - Success: `position_error` < 0.1 m.
//! - Loss: √(‖p_t − p‖² + 0.1²) + 0.02 ‖v‖² + 0.005 ‖ω‖² + 0.3 ‖h_t − h‖².
//!
//! - DIFFERENCE: starts with d > 4 are drawn again; published ones reach 4.18 and end at once (defect 26).
//! - DIFFERENCE: the spin term has ω_z², not ω_z⁴ (defect 14).
//! - DIFFERENCE: the default vehicle is the Hummingbird; the published one's is the Firefly (`vehicle = "firefly"`).
//! - DIFFERENCE: total mass everywhere; the published hover throttle counts the base link alone (defect 5).

use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::spatial::{constants, dot, rotate, sub, yawed};
use crate::error::Result;
use crate::tasks::config::{EnvConfig, SingleSettings};
use crate::tasks::reward::{bell, both, smooth_norm, still, upright};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term};
use crate::tasks::suite::{clock_slice, drone_slices};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};

/// The target, m, world.
const TARGET: [f64; 3] = [0.0, 0.0, 2.0];
/// Largest pose distance.
const FAR: f64 = 4.0;

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Hover {
    rig: Rig,
    settings: SingleSettings,
}

impl Hover {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`EnvConfig::single_rig`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: SingleSettings = config.settings()?;
        Ok(Self { rig: config.single_rig(&settings.vehicle)?, settings })
    }

    /// (p_t − p, h_t − h).
    #[inline(always)]
    fn error<S: Scalar>(view: &View<'_, S>) -> [S; 6] {
        let drone = view.drone(0);
        both(sub(constants(TARGET), drone.position), sub(view.goal.array(0), drone.heading()))
    }
}

impl Task for Hover {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Slice::new("target", 3, "m, world", "p_t − p")];
        observation.extend(drone_slices(self.rig.drone()));
        observation.push(Slice::new("heading_error", 3, "-, world", "h_t − h"));
        observation.push(clock_slice());
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![
                Term::smooth("pose", "r_p = 1/(1 + (1.2 d)²)", 1.0),
                Term::smooth("up", "r_p ((u_z + 1)/2)²", 1.0),
                Term::smooth("spin", "r_p/(1 + ω_z²)", 1.0),
                Term::smooth("effort", "0.1 e^{−e}", 0.1),
            ],
            ends: vec![End::new("crash", "z < 0.2 m"), End::new("far", "d > 4")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "heading_alignment", unit: "-" },
                Metric { name: "uprightness", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: vec![Slice::new("target_heading", 3, "-, world", "h_t")],
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies"),
                Setting::new("horizon", 500, "T, steps"),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        let yaw = start.task.uniform(ANY_YAW.0, ANY_YAW.1);
        let wanted = yawed(yaw);
        start.goal.copy_from_slice(&wanted);
        for _ in 0..100 {
            let position = start.position([-2.5, -2.5, 1.0], [2.5, 2.5, 2.5]);
            let attitude = start.attitude(START_TILT, ANY_YAW);
            start.place(0, position, attitude);
            let heading = rotate(attitude, [1.0, 0.0, 0.0]);
            if safe::norm(both(sub(TARGET, position), sub(wanted, heading))) <= FAR {
                break;
            }
        }
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        let error = Self::error(view);
        out.array([error[0], error[1], error[2]]);
        view.observe_drone(0, out);
        out.array([error[3], error[4], error[5]]);
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let drone = view.drone(0);
        let pose = bell(1.2, safe::squared_norm(Self::error(view)));
        terms.number(pose);
        terms.number(pose * upright(drone.up()));
        terms.number(pose * still(drone.angular_velocity));
        terms.number(S::constant(0.1) * (-view.effort(0)).exp());
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(view.drone(0).position[2].lt(S::constant(0.2)));
        ends.when(S::constant(FAR * FAR).lt(safe::squared_norm(Self::error(view))));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        let (error, drone) = (Self::error(view), view.drone(0));
        let heading = drone.heading();
        let wanted = view.goal.array::<3>(0);
        out.number(safe::norm([error[0], error[1], error[2]]));
        out.number(dot(heading, wanted));
        out.number(drone.up()[2]);
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        let error = Self::error(view);
        safe::squared_norm([error[0], error[1], error[2]]).lt(S::constant(0.01))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let (e, drone) = (Self::error(view), view.drone(0));
        let position = smooth_norm([e[0], e[1], e[2]], 0.1);
        let speed = S::constant(0.02) * safe::squared_norm(drone.velocity);
        let rate = S::constant(0.005) * safe::squared_norm(drone.angular_velocity);
        position + speed + rate + S::constant(0.3) * safe::squared_norm([e[3], e[4], e[5]])
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        Some(Wanted::way(&view.drone(0), TARGET, view.goal.get(1).atan2(view.goal.get(0)), 0.7))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.copy_from_slice(&[1.0, 0.0, 0.0]);
        start.place(0, TARGET, [1.0, 0.0, 0.0, 0.0]);
    }
}
