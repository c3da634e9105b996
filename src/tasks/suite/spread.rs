//! Spread: drones share out targets, whoever takes which, and keep apart in each other's downwash.
//!
//! The published task is an idea of a pull request: its reward is given and nothing else. All else is ours, after
//! [Formation](super::formation).
//!
//! - DIFFERENCE: starts, targets, ends and success are ours; targets are at least `target_gap` apart.
//! - DIFFERENCE: no contact: drones that come closer than 0.5 m end the episode before they touch.

use super::assignment::MOST;
use super::formation::{StartGrid, places};
use super::team::{
    CROWD, TeamSettings, crowded, free_team, lowest, mean_throttle_difference, observe_others, squared_separation,
};
use super::{MotionLoss, less, made_of, more, rate_cost, speed_cost, starts_on_host, times};
use crate::config::EnvConfig;
use crate::declare::{Ends, Goal, Loss, Writer};
use crate::reward::{rational_kernel, smooth_norm};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::{BuiltIn, HostStart, Task, TaskReference, View};
use crate::task_spec::Success;
use autodiff::{Array, Scalar, Trace, TraceMask, safe};
use base::error::{Error, Result};
use controllers::reference::{Reference, Tilt, Waypoint, Waypoints};
use dynamics::spatial::{Vec3, constants, sub};
use rng::{Purpose, Stream};

/// When our controllers have every drone at its target, s.
const ARRIVAL: f64 = 3.5;

/// Cells as far apart as drones that share no air.
fn start_grid() -> StartGrid {
    StartGrid { first: [-1.5, -1.5, 1.0], step: [1.0, 1.0, 0.8], cells: [4, 4, 2], ..StartGrid::default() }
}

settings! {
    /// Settings of [`Spread`].
    pub(crate) struct SpreadSettings {
        team: TeamSettings = TeamSettings { n_drone: 3, ..TeamSettings::default() } => flat;
        horizon: usize = 500 => ("steps", "T", Any);
        observe_place: bool = false => ("", "whether each drone sees the way to the target that it takes", Any);
        target: [[f64; 2]; 3] = [[-2.0, 2.0], [-2.0, 2.0], [1.0, 2.5]]
            => ("m, world", "q_k, lowest and highest per axis", Ordered);
        target_gap: f64 = 0.8 => ("m", "least distance of two targets", NotNegative);
        start: StartGrid = start_grid() => group;
        center: [f64; 3] = [0.0, 0.0, 1.5] => ("m, world", "p_c", Any);
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        min_separation: f64 = 0.5 => ("m", "closer drones touch", Positive);
        max_distance: f64 = 6.0 => ("m", "a drone farther from p_c ends the episode", Positive);
        success_distance: f64 = 0.2 => ("m", "of every target from its nearest drone, for a success", Positive);
        cover_scale: f64 = 1.6 => ("1/m", "how steeply the term cover falls", NotNegative);
        reward_cover: f64 = 1.0 => ("-", "weight of the term cover, of every target", NotNegative);
        loss: MotionLoss = MotionLoss::default() => group;
        loss_crowd: f64 = 1.0 => ("m", "weight of drones too close to each other in the loss", NotNegative);
        loss_separation: f64 = 0.9 => ("m", "least distance of two drones that costs nothing in the loss", Positive);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Spread {
    robot: Robot,
    settings: SpreadSettings,
}

impl BuiltIn for Spread {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: SpreadSettings = config.settings()?;
        let n = settings.team.n_drone;
        if !(2..=MOST).contains(&n) {
            let limit = format!("2 to {MOST} drones");
            return Err(Error::limit("task.n_drone", n, limit, "Use Hover for a single drone."));
        }
        settings.start.check(n)?;
        if !draw_targets(&settings, &mut Stream::new(0, 0, 0, Purpose(0))).1 {
            let limit = format!("so little that {n} targets find their places in task.target");
            let remedy = "Ask for less, or for a larger task.target.";
            return Err(Error::value("task.target_gap", settings.target_gap, limit, remedy));
        }
        let robot = free_team("spread", config, &settings.team.vehicle, n)?;
        Ok(Self { robot, settings })
    }
}

/// Targets, each drawn again while it is too near to one before it, and whether a thousand draws of each were enough.
fn draw_targets(own: &SpreadSettings, stream: &mut Stream) -> ([Vec3<f64>; MOST], bool) {
    let (mut targets, mut apart) = ([[0.0; 3]; MOST], true);
    for k in 0..own.team.n_drone {
        apart &= (0..1000).any(|_| {
            targets[k] = own.target.map(|[low, high]| stream.uniform(low, high));
            targets[..k].iter().all(|q| safe::norm(sub(*q, targets[k])) >= own.target_gap)
        });
    }
    (targets, apart)
}

impl Spread {
    fn n(&self) -> usize {
        self.settings.team.n_drone
    }

    /// q_k − p_i.
    fn way<S: Scalar>(view: &View<'_, S>, i: usize, k: usize) -> Vec3<S> {
        sub(view.goal.array(3 * k), view.drone(i).position)
    }

    /// To the target that drone i takes.
    fn own_way<S: Scalar>(&self, view: &View<'_, S>, i: usize) -> Vec3<S> {
        sub(view.goal.array(3 * (self.n() + i)), view.drone(i).position)
    }

    /// D_k².
    fn squared_gap<S: Scalar>(&self, view: &View<'_, S>, k: usize) -> S {
        let mut least = safe::squared_norm(Self::way(view, 0, k));
        for i in 1..self.n() {
            least = least.min(safe::squared_norm(Self::way(view, i, k)));
        }
        least
    }

    /// max D_k².
    fn squared_error<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut most = S::zero();
        for k in 0..self.n() {
            most = most.max(self.squared_gap(view, k));
        }
        most
    }

    /// max ‖p_i − p_c‖².
    fn squared_distance<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut most = S::zero();
        for i in 0..self.n() {
            most = most.max(safe::squared_norm(sub(view.drone(i).position, constants(self.settings.center))));
        }
        most
    }

    /// Keeps the targets, and which of them each drone takes from here, and says where those are.
    fn set_goal<S: StartScalar>(
        &self,
        goal: &mut Goal<'_, S>,
        targets: &[Vec3<f64>],
        from: &[Vec3<f64>],
    ) -> [Vec3<f64>; MOST] {
        goal.field("targets", "m, world", "q of every target");
        targets.iter().for_each(|q| goal.array(*q));
        let to = places(from, targets).map(|k| targets[k]);
        goal.field("places", "m, world", "q of the target that each drone takes");
        to[..from.len()].iter().for_each(|place| goal.array(*place));
        to
    }

    /// ŝ and the ways to all targets of a drone.
    fn observe_own(&self, view: &View, i: usize, out: &mut Writer) {
        out.field("targets", "m, world", "q_k − p_i for every target").members(self.n());
        for k in 0..self.n() {
            out.array(Self::way(view, i, k));
        }
        view.observe_drone(i, out);
    }
}

impl HostStart for Spread {
    fn start(&self, start: &mut Start<'_, f64>) {
        let targets = start.task.stream(|stream| draw_targets(&self.settings, stream)).0;
        let n = self.n();
        let (from, attitudes) = self.settings.start.draw(start, n);
        let to = self.set_goal(&mut start.goal, &targets[..n], &from[..n]);
        self.settings.start.place(start, &from[..n], &attitudes, &to);
    }
}

impl Task for Spread {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p_i, v_i, ω_i drones (world), q_k as many targets, D_k = min_i ‖q_k − p_i‖ the distance of a target from its nearest \
         drone, sep the least distance of two drones, p_c = {center} m, k steps. Targets: uniform in {target} m, at least \
         {target_gap} m apart. Start: different cells of a grid of {start_cells} cells from {start_first} m on in steps of \
         {start_step} m, at their centres; roll and pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest. There \
         the drones take targets by the least sum of squared ways, t_i for drone i: the loss asks for those, reward and \
         success for any. At difficulty d of a curriculum drones begin the share 1 − (1 − {start_way_ease})(1 − d) of the way from \
         their targets to those cells."
    }

    starts_on_host!();

    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        self.observe_own(view, agent, out);
        if self.settings.observe_place {
            out.field("place", "m, world", "t_i − p_i of the target that it takes").array(self.own_way(view, agent));
        }
        view.observe_clock(out);
        observe_others(view, agent, true, out);
    }

    fn central(&self, view: &View, out: &mut Writer) {
        out.field("drones", "as observed", "targets … throttle of every drone");
        for i in 0..self.n() {
            out.unnamed(|out| self.observe_own(view, i, out));
        }
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let own = &self.settings;
        let mut sum = Trace::zero();
        for k in 0..self.n() {
            sum += rational_kernel(own.cover_scale, self.squared_gap(view, k));
        }
        let most = own.reward_cover * self.n() as f64;
        terms.term("cover", "{×reward_cover}Σ_k 1/(1 + ({×cover_scale}D_k)²)", most).piecewise();
        terms.number(times(own.reward_cover, sum));
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let own = &self.settings;
        let (least, most) = (own.min_separation, own.max_distance);
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), own.min_height));
        ends.when("touch", "sep < {min_separation} m", less(squared_separation(view), least * least));
        ends.when("far", "max ‖p_i − p_c‖ > {max_distance} m", more(self.squared_distance(view), most * most));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let floor = safe::SQUARED_NORM_FLOOR;
        out.metric("coverage_error", "m", safe::sqrt(self.squared_error(view), floor));
        out.metric("separation", "m", safe::sqrt(squared_separation(view), floor));
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    fn success(&self, view: &View) -> TraceMask {
        let most = self.settings.success_distance;
        less(self.squared_error(view), most * most)
    }

    fn success_rule(&self) -> Success {
        Success::below("coverage_error", self.settings.success_distance)
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (own, w) = (&self.settings, &self.settings.loss);
        let mut sum = Trace::zero();
        for i in 0..self.n() {
            let drone = view.drone(i);
            sum += smooth_norm(self.own_way(view, i), w.radius);
            sum += speed_cost(w.velocity, drone.velocity);
            sum += rate_cost(w.rate, drone.angular_velocity);
        }
        let formula = "mean(√(‖t_i − p_i‖² + {loss_radius}²) + {×loss_velocity}h₅(v_i) + {×loss_rate}h₁₀(ω_i))";
        loss.add(formula, Trace::constant(1.0 / self.n() as f64) * sum);
        loss.add(CROWD, crowded(own.loss_crowd, view, own.loss_separation));
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let way = |i: usize| {
            let (drone, target) = (view.drone(i), view.goal.array(3 * (self.n() + i)));
            let start = Waypoint { time: 0.0, position: drone.position, yaw: drone.yaw() };
            let end = Waypoint { time: ARRIVAL, position: target, yaw: drone.yaw() };
            Waypoints::new(vec![start, end]).ok().map(Reference::Waypoints)
        };
        let references = (0..self.n()).map(way).collect::<Option<Vec<_>>>()?;
        Some(TaskReference { references, tilt: Tilt::LEVEL, follower: None })
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let (n, mut targets) = (self.n(), [[0.0; 3]; MOST]);
        for k in 0..n {
            targets[k] = [k as f64 - 0.5 * (n - 1) as f64, 0.0, 1.5];
            start.place(k, targets[k], [1.0, 0.0, 0.0, 0.0]);
        }
        self.set_goal(&mut start.goal, &targets[..n], &targets[..n]);
    }
}
