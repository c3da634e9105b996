//! The benchmark tasks, one file each; `load`, `team`, `over`, `transport` and `obstacles` hold what several share.
//! What each observes, rewards and ends on stands where it writes it, its numbers in its settings; `omnidrones tasks NAME`
//! prints both.
//!
//! - DIFFERENCE: metrics are those of the step; published ones are running means from 0, mostly 0.8 old + 0.2 new.

pub(crate) mod assignment;
mod clear_path;
pub mod dragon_hover;
pub mod fly_through;
pub mod forest;
pub mod formation;
pub mod gate_switch;
pub mod hover;
pub(crate) mod load;
pub(crate) mod obstacles;
pub(crate) mod over;
pub mod over_fly_through;
pub mod over_hover;
pub mod over_track;
pub mod payload_fly_through;
pub mod payload_hover;
pub mod payload_track;
pub mod pendulum_fly_through;
pub mod pendulum_hover;
pub mod pendulum_track;
pub mod pinball;
pub mod race;
pub mod spread;
pub(crate) mod team;
pub mod track;
pub(crate) mod transport;
pub mod transport_fly_through;
pub mod transport_hover;
pub mod transport_track;
pub(crate) mod variants;

#[cfg(test)]
mod tests;

use super::declare::Loss;
use super::reward::pseudo_huber;
use super::start::{ANY_YAW, Draw, START_TILT, Start, StartScalar, eased};
use super::task::View;
use crate::settings;
use autodiff::{Scalar, Trace, safe};
use dynamics::spatial::{Quat, Vec3};

settings! {
    /// Attitudes that episodes start with.
    pub(crate) struct StartAttitude {
        tilt: f64 = START_TILT => ("rad", "largest roll and pitch of starts", NotNegative);
        yaw: [f64; 2] = ANY_YAW => ("rad", "yaw of starts, lowest and highest", Ordered);
        ease: f64 = 1.0 => ("-", "share of these ranges at difficulty 0, about their middles", Share);
    }
}

impl StartAttitude {
    /// Roll, pitch and yaw, uniform.
    pub fn draw<S: StartScalar>(&self, start: &mut Start<'_, S>) -> Quat<S> {
        let share = self.share(start);
        start.attitude(share * S::from(self.tilt), narrowed(self.yaw, share))
    }

    fn share<S: StartScalar>(&self, start: &Start<'_, S>) -> S {
        eased(self.ease, start.difficulty)
    }
}

settings! {
    /// Places and attitudes that episodes start with.
    pub(crate) struct StartRange {
        position: [[f64; 2]; 3] = [[-2.5, 2.5], [-2.5, 2.5], [1.0, 2.5]]
            => ("m, world", "position of starts, lowest and highest per axis", Ordered);
        attitude: StartAttitude = StartAttitude::default() => flat;
    }
}

impl StartRange {
    /// Position, then roll, pitch and yaw, uniform.
    pub fn draw<S: StartScalar>(&self, start: &mut Start<'_, S>) -> (Vec3<S>, Quat<S>) {
        let share = self.attitude.share(start);
        (start.position(self.position.map(|range| narrowed(range, share))), self.attitude.draw(start))
    }
}

/// Where an episode begins that should begin at `from`: in the share `along` anywhere on the straight way to `to`, but no nearer
/// than `clear` to the obstacles at x = 0.
pub(crate) fn along_the_course<S: StartScalar>(
    start: &mut Start<'_, S>,
    along: f64,
    from: Vec3<S>,
    to: Vec3<S>,
    clear: f64,
) -> Vec3<S> {
    if along == 0.0 {
        return from;
    }
    let (moves, share) = start.reset.sometimes(along, Draw::Unit);
    let [x, y, z] = [0, 1, 2].map(|i| from[i] + share * (to[i] - from[i]));
    let clear = S::constant(clear);
    let beside = S::select(x.lt(S::zero()), -clear, clear);
    let there = [S::select(x.abs().lt(clear), beside, x), y, z];
    [0, 1, 2].map(|i| S::select(moves, there[i], from[i]))
}

/// A share of a range, about its middle.
fn narrowed<S: StartScalar>([low, high]: [f64; 2], share: S) -> [S; 2] {
    let (middle, half) = (S::from(0.5 * (low + high)), S::from(0.5 * (high - low)) * share);
    [middle - half, middle + half]
}

settings! {
    /// What a pose must be for a success.
    pub(crate) struct PoseSuccess {
        distance: f64 = 0.1 => ("m", "position error of a success", Positive);
        alignment: f64 = 0.95 => ("-", "cosine of the angle between asked and flown axes above which a success is", Any);
    }
}

settings! {
    /// What following a path must be for a success.
    pub(crate) struct PathSuccess {
        distance: f64 = 0.3 => ("m", "position error of a success", Positive);
        time: f64 = 2.0 => ("s", "for which the error of a success has been as small", NotNegative);
    }
}

settings! {
    /// Weights of the terms that most rewards have.
    pub(crate) struct PoseReward {
        pose: f64 = 1.0 => ("-", "weight of the term pose", NotNegative);
        up: f64 = 1.0 => ("-", "weight of the term up", NotNegative);
        spin: f64 = 1.0 => ("-", "weight of the term spin", NotNegative);
        effort: f64 = 0.1 => ("-", "weight of the term effort", NotNegative);
    }
}

settings! {
    /// How training losses weigh distance and motion.
    pub(crate) struct MotionLoss {
        radius: f64 = 0.1 => ("m", "δ in the loss's distance √(d² + δ²)", Positive);
        velocity: f64 = 0.02 => ("s²/m", "weight of the velocity in the loss", NotNegative);
        rate: f64 = 0.005 => ("m s²/rad²", "weight of the angular velocity in the loss", NotNegative);
    }
}

settings! {
    /// How training losses weigh distance, axes and motion.
    pub(crate) struct PoseLoss {
        motion: MotionLoss = MotionLoss::default() => flat;
        turn: f64 = 0.3 => ("m", "weight of the squared errors of axes in the loss", NotNegative);
    }
}

/// w x.
pub(crate) fn times<S: Scalar>(weight: f64, x: S) -> S {
    S::constant(weight) * x
}

/// w ‖x‖².
pub(crate) fn squared<S: Scalar, const N: usize>(weight: f64, x: [S; N]) -> S {
    times(weight, safe::squared_norm(x))
}

/// Where the costs of velocities and of angular velocities go over from squares to lines: beyond what useful flights need.
const FAST: f64 = 5.0;
const SPINNING: f64 = 10.0;

/// w h₅(v) of a velocity.
pub(crate) fn speed_cost<S: Scalar, const N: usize>(weight: f64, velocity: [S; N]) -> S {
    times(weight, pseudo_huber(velocity, FAST))
}

/// w h₁₀(ω) of an angular velocity or the rates of joints.
pub(crate) fn rate_cost<S: Scalar, const N: usize>(weight: f64, rate: [S; N]) -> S {
    times(weight, pseudo_huber(rate, SPINNING))
}

/// Adds w mean h₁₀(q̇) over the drives of the only drone, where it has any.
pub(crate) fn drive_loss(weight: f64, view: &View, loss: &mut Loss) {
    let drives = &view.robot.drone().drives;
    if drives.is_empty() {
        return;
    }
    let mut sum = Trace::zero();
    for i in 0..drives.len() {
        sum += rate_cost(weight / drives.len() as f64, [view.state[drives[i].rate]]);
    }
    loss.add("{×loss_drives}mean h₁₀(q̇) over the drives", sum);
}

/// ‖x‖ < `limit`.
pub(crate) fn nearer<S: Scalar, const N: usize>(x: [S; N], limit: f64) -> S::Mask {
    safe::squared_norm(x).lt(S::constant(limit * limit))
}

/// ‖x‖ > `limit`.
pub(crate) fn farther<S: Scalar, const N: usize>(x: [S; N], limit: f64) -> S::Mask {
    S::constant(limit * limit).lt(safe::squared_norm(x))
}

/// x < `limit`.
pub(crate) fn less<S: Scalar>(x: S, limit: f64) -> S::Mask {
    x.lt(S::constant(limit))
}

/// x > `limit`.
pub(crate) fn more<S: Scalar>(x: S, limit: f64) -> S::Mask {
    S::constant(limit).lt(x)
}

/// w e^{−e} of the only drone.
pub(crate) fn ease_of_flight<S: Scalar>(weight: f64, view: &View<'_, S>) -> S {
    times(weight, (-view.effort(0)).exp())
}

/// A flag of the task state that stays 1 once the mask held.
pub(crate) fn latch<S: Scalar>(flag: S, now: S::Mask) -> S {
    S::select(now, S::one(), flag)
}

/// What a task is built with: robot, horizon and settings, from the fields that hold them.
macro_rules! made_of {
    ($own:ident: $robot:expr, $settings:expr) => {
        fn robot(&$own) -> &crate::Robot {
            &$robot
        }
        fn horizon(&$own) -> usize {
            $settings.horizon
        }
        fn settings(&$own) -> Vec<crate::Setting> {
            crate::Settings::list(&$settings)
        }
    };
}
pub(crate) use made_of;

/// Episodes that begin on the host: [`HostStart`](crate::HostStart).
macro_rules! starts_on_host {
    () => {
        fn start(&self, _: &mut crate::Start<'_>) {}
        fn start_on_host(&self) -> Option<&dyn crate::HostStart> {
            Some(self)
        }
    };
}
pub(crate) use starts_on_host;

/// A success by an error within a limit, `position_error`, and by alignments above theirs; in the last step, or held for a
/// while: what is asked and what is said of it.
macro_rules! succeeds_within {
    ($own:ident, $view:ident: $error:expr, $limit:expr $(, $metric:literal: $aligned:expr, $least:expr)* $(; held $held:expr)?) => {
        fn success(&$own, $view: &$crate::View<'_>) -> autodiff::TraceMask {
            crate::suite::nearer($error, $limit)$(.and(crate::suite::more($aligned, $least)))*
        }
        fn success_rule(&$own) -> crate::Success {
            crate::Success::below("position_error", $limit)$(.above($metric, $least))*$(.held($held))?
        }
    };
}
pub(crate) use succeeds_within;

/// A success in any step by a flag of the task state and an error within a limit.
macro_rules! succeeds_once {
    ($own:ident, $view:ident: $flag:expr, $limit:expr $(, $metric:literal: $least:expr)* $(; $also:expr)?) => {
        fn success(&$own, $view: &$crate::View<'_>) -> autodiff::TraceMask {
            crate::suite::more($flag, 0.5)
        }
        fn success_rule(&$own) -> crate::Success {
            crate::Success::below("position_error", $limit)$(.above($metric, $least))*$(.also($also))?.once()
        }
    };
}
pub(crate) use succeeds_once;
