//! Formation: free drones form a figure about a point, each facing +x, and keep apart in each other's downwash.
//!
//! - DIFFERENCE: total mass everywhere (defect 5).
//! - DIFFERENCE: no contact: drones that come closer than 0.23 m end the episode before they touch.

use super::assignment::{MOST, assign};
use super::team::{
    CROWD, apart, crowded, free_team, lowest, mean_throttle_difference, observe_others, squared_separation,
};
use super::{
    PoseLoss, StartAttitude, eased, less, made_of, more, nearer, rate_cost, speed_cost, starts_on_host, times,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Goal, Loss, Writer};
use crate::reward::{exponential_kernel, rational_kernel, smooth_norm};
use crate::robot::Robot;
use crate::settings;
use crate::start::{Start, StartScalar};
use crate::task::{BuiltIn, HostStart, Task, TaskReference, View};
use crate::task_spec::Success;
use autodiff::{Array, Mask, Scalar, Trace, TraceMask, safe};
use base::error::{Error, Result, finite};
use controllers::reference::{Reference, Tilt, Waypoint, Waypoints};
use dynamics::spatial::{Quat, Vec3, add, constants, scale, sub};
use serde::{Deserialize, Serialize};

/// When our controllers have every drone at its point, s.
const ARRIVAL: f64 = 4.0;

/// A figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Figure {
    /// By name.
    Named(NamedFigure),
    /// Points, m; only differences count.
    Points(Vec<[f64; 3]>),
}

/// A figure by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NamedFigure {
    /// Centre and corners of a hexagon of radius 2 m: 7 drones.
    Hexagon,
    /// Centre and corners of a square of 2 m: 5 drones.
    Tetragon,
}

impl Figure {
    /// Its points relative to their mean, m.
    ///
    /// # Errors
    /// [`Error::Limit`] unless there are 2 to 32; [`Error::Value`] for one that is not finite.
    fn points(&self) -> Result<Vec<[f64; 3]>> {
        // √3: corners every 60°
        let s = 3.0_f64.sqrt();
        let points = match self {
            Self::Points(points) => points.clone(),
            Self::Named(NamedFigure::Tetragon) => {
                flat(&[[0.0, 0.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
            }
            Self::Named(NamedFigure::Hexagon) => {
                flat(&[[0.0, 0.0], [s, -1.0], [0.0, -2.0], [-s, -1.0], [-s, 1.0], [0.0, 2.0], [s, 1.0]])
            }
        };
        if !(2..=MOST).contains(&points.len()) {
            let limit = format!("2 to {MOST} points");
            return Err(Error::limit("task.formation", points.len(), limit, "Use Hover for a single drone."));
        }
        for point in &points {
            finite("task.formation", point)?;
        }
        let mean = [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64);
        Ok(points.into_iter().map(|p| sub(p, mean)).collect())
    }
}

fn flat(points: &[[f64; 2]]) -> Vec<[f64; 3]> {
    points.iter().map(|[x, y]| [*x, *y, 0.0]).collect()
}

/// Which point each drone takes: the assignment of the least sum of squared ways. On straight ways of that sum, flown together,
/// drones that begin and end apart stay apart (Turpin, Michael and Kumar 2014, theorem 3.1).
pub(super) fn places(from: &[Vec3<f64>], to: &[Vec3<f64>]) -> [usize; MOST] {
    assign(from.len(), |i, j| safe::squared_norm(sub(to[j], from[i])))
}

settings! {
    /// The grid that drones start on, in cells of their own, at their centres.
    pub(crate) struct StartGrid {
        first: [f64; 3] = [-1.75, -1.75, 0.625] => ("m, world", "centre of the first cell that drones start in", Any);
        step: [f64; 3] = [0.5, 0.5, 0.25] => ("m", "from cell to cell", Positive);
        cells: [u64; 3] = [8, 8, 6] => ("", "cells per axis", Positive);
        way_ease: f64 = 1.0
            => ("-", "share of the way from a drone's place to its cell at which it starts at difficulty 0", Share);
        attitude: StartAttitude = StartAttitude::default() => flat;
    }
}

impl StartGrid {
    /// Refuses fewer cells than drones.
    pub fn check(&self, n_drone: usize) -> Result<()> {
        let cells = self.cells.into_iter().fold(1, u64::saturating_mul);
        if cells >= n_drone as u64 {
            return Ok(());
        }
        let limit = format!("{n_drone} or more, one per drone");
        Err(Error::value("task.start_cells", format!("{cells} in all"), limit, "Give more cells."))
    }

    /// Different cells and attitudes for drones: the first `n_drone` count.
    pub fn draw(&self, start: &mut Start<'_, f64>, n_drone: usize) -> ([Vec3<f64>; MOST], [Quat<f64>; MOST]) {
        let [nx, ny, nz] = self.cells;
        let (mut taken, mut from) = ([0.0; MOST], [[0.0; 3]; MOST]);
        let mut attitudes = [Quat::default(); MOST];
        for i in 0..n_drone {
            taken[i] = start.reset.below_other_than(nx * ny * nz, &taken[..i]);
            let cell = taken[i] as u64;
            let index = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            from[i] = [0, 1, 2].map(|k| self.first[k] + self.step[k] * index[k] as f64);
            attitudes[i] = self.attitude.draw(start);
        }
        (from, attitudes)
    }

    /// Puts drone i at `from[i]`, or where a curriculum makes that easier on the straight way to its place `to[i]`.
    pub fn place(&self, start: &mut Start<'_, f64>, from: &[Vec3<f64>], attitudes: &[Quat<f64>], to: &[Vec3<f64>]) {
        let gone = 1.0 - eased(self.way_ease, start.difficulty);
        for (i, ((from, attitude), to)) in from.iter().zip(attitudes).zip(to).enumerate() {
            start.place(i, add(*from, scale(gone, sub(*to, *from))), *attitude);
        }
    }
}

settings! {
    /// Weights of the reward.
    pub(crate) struct FormationReward {
        shape: f64 = 1.0 => ("-", "weight of the term shape", NotNegative);
        place: f64 = 1.0 => ("-", "weight of the term place", NotNegative);
        heading: f64 = 1.0 => ("-", "weight of the term heading", NotNegative);
        center: f64 = 0.4 => ("-", "weight of the term center", NotNegative);
    }
}

settings! {
    /// Settings of [`Formation`].
    pub(crate) struct FormationSettings {
        vehicle: String = "hummingbird".into() => ("", "what flies", Any);
        formation: Figure = Figure::Named(NamedFigure::Hexagon)
            => ("m", "one drone per point: \"hexagon\" (7), \"tetragon\" (5) or a list of points", Any);
        observe_place: bool = false => ("", "whether each drone, and the state of all, is told the way to the point that it takes", Any);
        horizon: usize = 600 => ("steps", "T", Any);
        center: [f64; 3] = [0.0, 0.0, 1.5] => ("m, world", "p_c", Any);
        start: StartGrid = StartGrid::default() => group;
        min_height: f64 = 0.2 => ("m", "a lower drone is a crash", Any);
        min_separation: f64 = 0.23 => ("m", "closer drones touch", Positive);
        separation: f64 = 0.4 => ("m", "least distance of two drones at which r_s reaches 1", Positive);
        success_distance: f64 = 0.2 => ("m", "H and c of a success", Positive);
        success_alignment: f64 = 0.95 => ("-", "mean h_x above which a success is", Any);
        shape_scale: f64 = 1.6 => ("1/m", "how steeply r_f falls", NotNegative);
        reward: FormationReward = FormationReward::default() => group;
        loss: PoseLoss = PoseLoss::default() => group;
        loss_crowd: f64 = 1.0 => ("m", "weight of drones too close to each other in the loss", NotNegative);
        loss_separation: f64 = 0.8 => ("m", "least distance of two drones that costs nothing in the loss", Positive);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Formation {
    robot: Robot,
    settings: FormationSettings,
    /// f_i − f̄.
    figure: Vec<[f64; 3]>,
}

impl BuiltIn for Formation {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: FormationSettings = config.settings()?;
        let figure = settings.formation.points()?;
        settings.start.check(figure.len())?;
        let robot = free_team("formation", config, &settings.vehicle, figure.len())?;
        Ok(Self { robot, settings, figure })
    }
}

impl Formation {
    /// p̄.
    fn mean<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        let mut sum = [S::zero(); 3];
        for i in 0..self.figure.len() {
            sum = add(sum, view.drone(i).position);
        }
        scale(S::constant(1.0 / self.figure.len() as f64), sum)
    }

    /// p̄ − p_c.
    fn offset<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.mean(view), constants(self.settings.center))
    }

    /// ‖(p_i − p̄) − (f_j − f̄)‖².
    fn squared_gap<S: Scalar>(&self, view: &View<'_, S>, mean: Vec3<S>, i: usize, j: usize) -> S {
        safe::squared_norm(sub(sub(view.drone(i).position, mean), constants(self.figure[j])))
    }

    /// Of drone i the squared gap to the nearest point, of point i that to the nearest drone.
    fn nearest<S: Scalar>(&self, view: &View<'_, S>, mean: Vec3<S>, i: usize) -> (S, S) {
        let mut of_drone = self.squared_gap(view, mean, i, 0);
        let mut of_point = self.squared_gap(view, mean, 0, i);
        for j in 1..self.figure.len() {
            of_drone = of_drone.min(self.squared_gap(view, mean, i, j));
            of_point = of_point.min(self.squared_gap(view, mean, j, i));
        }
        (of_drone, of_point)
    }

    /// H².
    fn squared_hausdorff<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let (n, mean) = (self.figure.len(), self.mean(view));
        let mut most = S::zero();
        for i in 0..n {
            let (of_drone, of_point) = self.nearest(view, mean, i);
            most = most.max(of_drone).max(of_point);
        }
        most
    }

    /// p_c + f_i − p_i: what drone i has to go to its place.
    fn way<S: Scalar>(&self, view: &View<'_, S>, i: usize) -> Vec3<S> {
        let place = add(constants(self.settings.center), view.goal.array(3 * i));
        sub(place, view.drone(i).position)
    }

    /// Keeps the point of the figure that each drone takes from here, and says where those are.
    fn take_places<S: StartScalar>(&self, goal: &mut Goal<'_, S>, from: &[Vec3<f64>]) -> [Vec3<f64>; MOST] {
        let mut points = [[0.0; 3]; MOST];
        points.iter_mut().zip(&self.figure).for_each(|(point, f)| *point = add(self.settings.center, *f));
        let taken = places(from, &points[..from.len()]);
        goal.field("places", "m", "f of the point that each drone takes, less the figure's mean");
        (0..from.len()).for_each(|i| goal.array(self.figure[taken[i]]));
        taken.map(|point| points[point])
    }

    /// Mean of h_x.
    fn facing<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut sum = S::zero();
        for i in 0..self.figure.len() {
            sum += view.drone(i).heading()[0];
        }
        sum * S::constant(1.0 / self.figure.len() as f64)
    }

    /// p_c − p_i and ŝ of a drone, and the way to its place where that is told.
    fn observe_own(&self, view: &View, i: usize, out: &mut Writer) {
        let to_center = sub(constants(self.settings.center), view.drone(i).position);
        out.field("center", "m, world", "p_c − p_i").array(to_center);
        view.observe_drone(i, out);
        if self.settings.observe_place {
            out.field("place", "m, world", "p_c + f_i − p_i of the point that it takes").array(self.way(view, i));
        }
    }
}

impl HostStart for Formation {
    fn start(&self, start: &mut Start<'_, f64>) {
        let n = self.figure.len();
        let (from, attitudes) = self.settings.start.draw(start, n);
        let to = self.take_places(&mut start.goal, &from[..n]);
        self.settings.start.place(start, &from[..n], &attitudes, &to);
    }
}

impl Task for Formation {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p_i, v_i, ω_i drones (world), p̄ their mean place, f_i the figure's points, f̄ their mean, h_i headings, sep \
         the least distance of two drones, r_s = min((sep/{separation} m)², 1), k steps. H: the larger of max_i min_j \
         ‖(p_i − p̄) − (f_j − f̄)‖ and max_j min_i of the same: the Hausdorff distance of both figures, whoever takes \
         which place, neither turned nor scaled. c = ‖p̄ − p_c‖ with the centre p_c = {center} m. Start: different cells of a \
         grid of {start_cells} cells from {start_first} m on in steps of {start_step} m, at their centres; roll and \
         pitch within ±{start_tilt} rad, yaw within {start_yaw} rad, at rest. There the drones take points by the least \
         sum of squared ways, f_i for drone i: the loss asks for those, reward and success for any. At difficulty d of a \
         curriculum drones begin the share 1 − (1 − {start_way_ease})(1 − d) of the way from their points to those cells."
    }

    starts_on_host!();

    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        self.observe_own(view, agent, out);
        view.observe_clock(out);
        observe_others(view, agent, true, out);
    }

    fn central(&self, view: &View, out: &mut Writer) {
        out.field("drones", "as observed", "center … of every drone");
        for i in 0..self.figure.len() {
            out.unnamed(|out| self.observe_own(view, i, out));
        }
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let (own, w) = (&self.settings, &self.settings.reward);
        let (near, place) = (apart(view, own.separation), exponential_kernel(1.0, self.offset(view)));
        let shape = near * rational_kernel(own.shape_scale, self.squared_hausdorff(view));
        terms.term("shape", "{×reward_shape}r_s r_f, r_f = 1/(1 + ({×shape_scale}H)²)", w.shape).piecewise();
        terms.number(times(w.shape, shape));
        terms.term("place", "{×reward_place}r_s r_f e^{−c}", w.place).piecewise();
        terms.number(times(w.place, shape) * place);
        terms
            .term("heading", "{×reward_heading}r_s r_f · mean h_x", w.heading)
            .within(-w.heading, w.heading)
            .piecewise();
        terms.number(times(w.heading, shape) * self.facing(view));
        terms.term("center", "{×reward_center}r_s e^{−c}", w.center).piecewise();
        terms.number(near * Trace::constant(w.center) * place);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let least = self.settings.min_separation;
        ends.when("crash", "min z_i < {min_height} m", less(lowest(view), self.settings.min_height));
        ends.when("touch", "sep < {min_separation} m", less(squared_separation(view), least * least));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        let floor = safe::SQUARED_NORM_FLOOR;
        out.metric("hausdorff", "m", safe::sqrt(self.squared_hausdorff(view), floor));
        out.metric("center_error", "m", safe::norm(self.offset(view)));
        out.metric("heading_alignment", "-", self.facing(view));
        out.metric("separation", "m", safe::sqrt(squared_separation(view), floor));
        out.metric("throttle_difference", "-", mean_throttle_difference(view));
    }

    fn success(&self, view: &View) -> TraceMask {
        let most = self.settings.success_distance;
        let facing = more(self.facing(view), self.settings.success_alignment);
        less(self.squared_hausdorff(view), most * most).and(nearer(self.offset(view), most)).and(facing)
    }

    fn success_rule(&self) -> Success {
        let most = self.settings.success_distance;
        let rule = Success::below("hausdorff", most).and("center_error", most);
        rule.above("heading_alignment", self.settings.success_alignment)
    }

    fn loss(&self, view: &View, loss: &mut Loss) {
        let w = &self.settings.loss;
        let mut own = Trace::zero();
        for i in 0..self.figure.len() {
            let drone = view.drone(i);
            own += speed_cost(w.motion.velocity, drone.velocity);
            own += rate_cost(w.motion.rate, drone.angular_velocity);
            own += times(w.turn, Trace::one() - drone.heading()[0]);
            own += smooth_norm(self.way(view, i), w.motion.radius);
        }
        let mean = Trace::constant(1.0 / self.figure.len() as f64) * own;
        loss.add(CROWD, crowded(self.settings.loss_crowd, view, self.settings.loss_separation));
        let formula = "mean(√(‖p_c + f_i − p_i‖² + {loss_radius}²) + {×loss_velocity}h₅(v_i) + {×loss_rate}h₁₀(ω_i) + \
             {×loss_turn}(1 − h_i,x))";
        loss.add(formula, mean);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let from: Vec<Vec3<f64>> = (0..self.figure.len()).map(|i| view.drone(i).position).collect();
        let to: Vec<Vec3<f64>> = self.figure.iter().map(|f| add(self.settings.center, *f)).collect();
        let way = |(i, place): (usize, usize)| {
            let start = Waypoint { time: 0.0, position: from[i], yaw: view.drone(i).yaw() };
            let end = Waypoint { time: ARRIVAL, position: to[place], yaw: 0.0 };
            Waypoints::new(vec![start, end]).ok().map(Reference::Waypoints)
        };
        let references =
            places(&from, &to)[..from.len()].iter().copied().enumerate().map(way).collect::<Option<Vec<_>>>()?;
        Some(TaskReference { references, tilt: Tilt::LEVEL, follower: None })
    }

    fn ideal(&self, start: &mut Start<'_>) {
        let mut from = [[0.0; 3]; MOST];
        for i in 0..self.figure.len() {
            from[i] = add(self.settings.center, self.figure[i]);
            start.place(i, from[i], [1.0, 0.0, 0.0, 0.0]);
        }
        self.take_places(&mut start.goal, &from[..self.figure.len()]);
    }
}
