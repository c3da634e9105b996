//! Formation: free drones form a figure about a point, each facing +x, and keep apart in each other's downwash.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `center` | 3 | m, world | p_c − p_i | smooth |
//! | `attitude` | 4 | -, body → world | unit quaternion, w ≥ 0 | non-smooth |
//! | `velocity` | 3 | m/s, world | v | smooth |
//! | `angular_velocity` | 3 | rad/s, world | ω | smooth |
//! | `heading` | 3 | -, world | h = R e_x | smooth |
//! | `up` | 3 | -, world | u = R e_z | smooth |
//! | `throttle` | 4 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | `others` | 84 | m, m, -, m/s, rad/s; world | p_i − p_j, ‖p_i − p_j‖, q_j, v_j, ω_j for every other j, ascending | non-smooth |
//! | *total* | 111 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `shape` | r_s r_f, r_f = 1/(1 + (1.6 H)²) | 1 | piecewise |
//! | `place` | r_s r_f e^{−c} | 1 | piecewise |
//! | `heading` | r_s r_f · mean h_x | 1 | piecewise |
//! | `center` | 0.4 r_s e^{−c} | 0.4 | piecewise |
//! | *sum* | | 3.4 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | min z_i < 0.2 m |
//! | `touch` | sep < 0.23 m |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `vehicle` | "hummingbird" | what flies |
//! | `formation` | "hexagon" | one drone per point: "hexagon" (7), "tetragon" (5) or a list of points, m |
//! | `horizon` | 600 | T, steps |
//!
//! p_i, v_i, ω_i drones (world), p̄ their mean place, f_i the figure's points, f̄ their mean, h_i headings, sep the
//! least distance of two drones, r_s = min((sep/0.4 m)², 1), k steps. H: the larger of max_i min_j
//! ‖(p_i − p̄) − (f_j − f̄)‖ and max_j min_i of the same: the Hausdorff distance of both figures, whoever takes which
//! place, neither turned nor scaled. C is their Chamfer distance, ½ mean_i √(min_j ‖·‖² + 0.1²) + ½ mean_j
//! √(min_i ‖·‖² + 0.1²). c = ‖p̄ − p_c‖ with the centre p_c = (0, 0, 1.5) m. Start: different cells of a grid over
//! ±2 × ±2 × [0.5, 2] m with steps of 0.5, 0.5 and 0.25 m, at their centres; roll and pitch within ±0.2π, any yaw, at
//! rest.
//!
//! - Success: `hausdorff` < 0.2 m and `center_error` < 0.2 m.
//! - Loss: C + √(c² + 0.1²) + (1 − min((sep/0.8 m)², 1))² + means over the drones
//!   of 0.02 ‖v_i‖², 0.005 ‖ω_i‖² and 0.3 (1 − h_i,x).
//!
//! - DIFFERENCE: total mass everywhere (defect 5).
//! - DIFFERENCE: no contact: drones that come closer than 0.23 m end the episode before they touch.

use super::team::{apart, lowest, mean_throttle_difference, observe_others, others_slice, squared_separation};
use super::{clock_slice, drone_slices};
use crate::autodiff::{Mask, Pen, Scalar, safe};
use crate::controllers::reference::{Reference, Tilt, Waypoint, Waypoints};
use crate::dynamics::assembly::{Member, group, single};
use crate::dynamics::spatial::{Vec3, add, constants, scale, sub};
use crate::error::{Error, Result, finite};
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{bell, smooth_norm, tip};
use crate::tasks::rig::Rig;
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Term, total};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};

/// p_c, m, world.
const CENTER: [f64; 3] = [0.0, 0.0, 1.5];
/// sep that ends an episode, m.
const TOUCH: f64 = 0.23;
/// sep at which r_s reaches 1, m.
const APART: f64 = 0.4;
/// Centre of the grid's first cell, m.
const FIRST_CELL: [f64; 3] = [-1.75, -1.75, 0.625];
/// Of the grid, m.
const CELL: [f64; 3] = [0.5, 0.5, 0.25];
/// Of the grid.
const CELLS: [u64; 3] = [8, 8, 6];
/// When our controllers have every drone at its point, s.
const ARRIVAL: f64 = 4.0;
/// Most drones: each sees all others.
const MOST: usize = 32;

/// A figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Figure {
    /// By name.
    Named(Named),
    /// Points, m; only differences count.
    Points(Vec<[f64; 3]>),
}

/// A figure by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Named {
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
            Self::Named(Named::Tetragon) => flat(&[[0.0, 0.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]),
            Self::Named(Named::Hexagon) => {
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

/// Which point each drone takes: swaps of two no longer shorten the sum of squared ways. On straight ways of the least sum,
/// flown together, drones that begin and end apart stay apart (Turpin, Michael and Kumar 2014, theorem 3.1).
fn places(from: &[Vec3<f64>], to: &[Vec3<f64>]) -> Vec<usize> {
    let cost = |i: usize, j: usize| safe::squared_norm(sub(to[j], from[i]));
    let mut places: Vec<usize> = (0..from.len()).collect();
    let mut better = true;
    while better {
        better = false;
        for i in 0..places.len() {
            for k in 0..i {
                let (a, b) = (places[i], places[k]);
                if cost(i, b) + cost(k, a) < cost(i, a) + cost(k, b) - 1e-9 {
                    places.swap(i, k);
                    better = true;
                }
            }
        }
    }
    places
}

/// Settings of [`Formation`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FormationSettings {
    /// What flies.
    pub vehicle: String,
    /// The figure, one drone per point.
    pub formation: Figure,
    /// T, steps.
    pub horizon: usize,
}

impl Default for FormationSettings {
    fn default() -> Self {
        Self { vehicle: "hummingbird".into(), formation: Figure::Named(Named::Hexagon), horizon: 600 }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Formation {
    rig: Rig,
    settings: FormationSettings,
    /// f_i − f̄.
    figure: Vec<[f64; 3]>,
}

impl Formation {
    /// With the vehicle and settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`], [`EnvConfig::vehicle`] and [`group()`]; [`Error::Limit`] for fewer than 2 or more than
    /// 32 points.
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let settings: FormationSettings = config.settings()?;
        let figure = settings.formation.points()?;
        let vehicle = config.vehicle(&settings.vehicle)?;
        let drone = single(&vehicle)?;
        let members: Vec<Member> =
            (0..figure.len()).map(|i| Member::new(format!("drone_{i}"), drone.clone(), [0.0; 3])).collect();
        let physics = config.physics_with(|e| e.downwash = true);
        let rig = Rig::of_model(&group("formation", &members)?, physics, Some(&vehicle), |_| Vec::new())?;
        Ok(Self { rig, settings, figure })
    }

    /// p̄.
    #[inline(always)]
    fn mean<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        let mut sum = [S::zero(); 3];
        for i in 0..self.figure.len() {
            sum = add(sum, view.drone(i).position);
        }
        scale(S::constant(1.0 / self.figure.len() as f64), sum)
    }

    /// p̄ − p_c.
    #[inline(always)]
    fn offset<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        sub(self.mean(view), constants(CENTER))
    }

    /// ‖(p_i − p̄) − (f_j − f̄)‖².
    #[inline(always)]
    fn squared_gap<S: Scalar>(&self, view: &View<'_, S>, mean: Vec3<S>, i: usize, j: usize) -> S {
        safe::squared_norm(sub(sub(view.drone(i).position, mean), constants(self.figure[j])))
    }

    /// Of drone i the squared gap to the nearest point, of point i that to the nearest drone.
    #[inline(always)]
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
    #[inline(always)]
    fn squared_hausdorff<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let (n, mean) = (self.figure.len(), self.mean(view));
        let mut most = S::zero();
        for i in 0..n {
            let (of_drone, of_point) = self.nearest(view, mean, i);
            most = most.max(of_drone).max(of_point);
        }
        most
    }

    /// C: the Chamfer distance of both figures, smooth at 0. Unlike H it says to every drone where to go.
    #[inline(always)]
    fn chamfer<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let (n, mean) = (self.figure.len(), self.mean(view));
        let smooth = |squared: S| (squared + S::constant(0.01)).sqrt();
        let mut sum = S::zero();
        for i in 0..n {
            let (of_drone, of_point) = self.nearest(view, mean, i);
            sum += smooth(of_drone) + smooth(of_point);
        }
        sum * S::constant(0.5 / n as f64)
    }

    /// Mean of h_x.
    #[inline(always)]
    fn facing<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut sum = S::zero();
        for i in 0..self.figure.len() {
            sum += view.drone(i).heading()[0];
        }
        sum * S::constant(1.0 / self.figure.len() as f64)
    }

    /// p_c − p_i and ŝ of a drone.
    #[inline(always)]
    fn observe_own<S: Scalar>(view: &View<'_, S>, i: usize, out: &mut Pen<'_, S>) {
        out.array(sub(constants(CENTER), view.drone(i).position));
        view.observe_drone(i, out);
    }
}

impl Task for Formation {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let mut observation = vec![Slice::new("center", 3, "m, world", "p_c − p_i")];
        observation.extend(drone_slices(self.rig.drone()));
        let n = total(&observation) * self.figure.len();
        let central = vec![Slice::new("drones", n, "as observed", "center … throttle of every drone")];
        observation.push(clock_slice());
        observation.push(others_slice(&self.rig, true));
        Sheet {
            observation,
            central,
            reward: vec![
                Term::piecewise("shape", "r_s r_f, r_f = 1/(1 + (1.6 H)²)", 1.0),
                Term::piecewise("place", "r_s r_f e^{−c}", 1.0),
                Term::piecewise("heading", "r_s r_f · mean h_x", 1.0),
                Term::piecewise("center", "0.4 r_s e^{−c}", 0.4),
            ],
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("touch", "sep < 0.23 m")],
            metrics: vec![
                Metric { name: "hausdorff", unit: "m" },
                Metric { name: "center_error", unit: "m" },
                Metric { name: "heading_alignment", unit: "-" },
                Metric { name: "separation", unit: "m" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: Vec::new(),
            memo: Vec::new(),
            settings: vec![
                Setting::new("vehicle", "\"hummingbird\"", "what flies"),
                Setting::new(
                    "formation",
                    "\"hexagon\"",
                    "one drone per point: \"hexagon\" (7), \"tetragon\" (5) or a list of points, m",
                ),
                Setting::new("horizon", 600, "T, steps"),
            ],
        }
    }

    fn start(&self, start: &mut Start<'_>) {
        let mut taken = [u64::MAX; MOST];
        for i in 0..self.figure.len() {
            let mut cell = start.reset.below(CELLS[0] * CELLS[1] * CELLS[2]);
            while taken[..i].contains(&cell) {
                cell = start.reset.below(CELLS[0] * CELLS[1] * CELLS[2]);
            }
            taken[i] = cell;
            let index = [cell % CELLS[0], cell / CELLS[0] % CELLS[1], cell / (CELLS[0] * CELLS[1])];
            let position = [0, 1, 2].map(|k| FIRST_CELL[k] + CELL[k] * index[k] as f64);
            let attitude = start.attitude(START_TILT, ANY_YAW);
            start.place(i, position, attitude);
        }
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, agent: usize, out: &mut Pen<'_, S>) {
        Self::observe_own(view, agent, out);
        view.observe_clock(out);
        observe_others(view, agent, true, out);
    }

    #[inline(always)]
    fn central<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        for i in 0..self.figure.len() {
            Self::observe_own(view, i, out);
        }
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        let (near, place) = (apart(view, APART), tip(1.0, self.offset(view)));
        let shape = near * bell(1.6, self.squared_hausdorff(view));
        terms.number(shape);
        terms.number(shape * place);
        terms.number(shape * self.facing(view));
        terms.number(near * S::constant(0.4) * place);
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(lowest(view).lt(S::constant(0.2)));
        ends.when(squared_separation(view).lt(S::constant(TOUCH * TOUCH)));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::sqrt(self.squared_hausdorff(view), safe::SQUARED_NORM_FLOOR));
        out.number(safe::norm(self.offset(view)));
        out.number(self.facing(view));
        out.number(safe::sqrt(squared_separation(view), safe::SQUARED_NORM_FLOOR));
        out.number(mean_throttle_difference(view));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        let limit = S::constant(0.04);
        self.squared_hausdorff(view).lt(limit).and(safe::squared_norm(self.offset(view)).lt(limit))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let missing = (S::one() - apart(view, 2.0 * APART)).square();
        let mut own = S::zero();
        for i in 0..self.figure.len() {
            let drone = view.drone(i);
            own += S::constant(0.02) * safe::squared_norm(drone.velocity);
            own += S::constant(0.005) * safe::squared_norm(drone.angular_velocity);
            own += S::constant(0.3) * (S::one() - drone.heading()[0]);
        }
        let mean = S::constant(1.0 / self.figure.len() as f64) * own;
        self.chamfer(view) + smooth_norm(self.offset(view), 0.1) + missing + mean
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        let from: Vec<Vec3<f64>> = (0..self.figure.len()).map(|i| view.drone(i).position).collect();
        let to: Vec<Vec3<f64>> = self.figure.iter().map(|f| add(CENTER, *f)).collect();
        let way = |(i, place): (usize, usize)| {
            let start = Waypoint { time: 0.0, position: from[i], yaw: view.drone(i).yaw() };
            let end = Waypoint { time: ARRIVAL, position: to[place], yaw: 0.0 };
            Waypoints::new(vec![start, end]).ok().map(Reference::Waypoints)
        };
        let references = places(&from, &to).into_iter().enumerate().map(way).collect::<Option<Vec<_>>>()?;
        Some(Wanted { references, tilt: Tilt::LEVEL })
    }

    fn ideal(&self, start: &mut Start<'_>) {
        for i in 0..self.figure.len() {
            start.place(i, add(CENTER, self.figure[i]), [1.0, 0.0, 0.0, 0.0]);
        }
    }
}
