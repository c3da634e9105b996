//! DragonHover: a chain of four links, rotors on gimbals, flies to a point and holds still there.
//!
//! | Observation | size | unit | meaning | |
//! |---|---|---|---|---|
//! | `target` | 3 | m, world | p_t − p̄ | smooth |
//! | `positions` | 12 | m, world | p_i − p_t of every link | smooth |
//! | `attitudes` | 16 | -, body → world | unit quaternions of every link, w ≥ 0 | non-smooth |
//! | `velocities` | 24 | m/s, rad/s, world | v_i, ω_i of every link | smooth |
//! | `headings` | 12 | -, world | R_i e_x of every link | smooth |
//! | `ups` | 12 | -, world | R_i e_z of every link | smooth |
//! | `throttle` | 8 | - | 2s − 1, s = Ω/Ω_max | smooth |
//! | `gimbals` | 8 | half turns | angles/π, x then y of every link | smooth |
//! | `bends` | 6 | half turns | angles/π, y then z of every joint | smooth |
//! | `heading_error` | 3 | -, world | h_t − h | smooth |
//! | `clock` | 4 | - | k/T, four times | smooth |
//! | *total* | 108 | | | |
//!
//! | Reward | term | at most | |
//! |---|---|---|---|
//! | `pose` | e^{−1.2 d} | 1 | piecewise |
//! | `joints` | 0.5 · mean e^{−|q̇|} | 0.5 | piecewise |
//! | *sum* | | 1.5 | |
//!
//! | Episode end | when |
//! |---|---|
//! | `crash` | min z_i < 0.2 m |
//! | `far` | d > 4 |
//! | `diverged` | a number of the state leaves ±1e8 |
//! | *truncated* | k ≥ `horizon` |
//!
//! | Configuration | default | meaning |
//! |---|---|---|
//! | `horizon` | 500 | T, steps |
//!
//! p_i link middles, v_i, ω_i velocities and angular velocities of the links (world), p̄ = ¼ Σ p_i, h = R_0 e_x heading
//! of link 0, q joints: eight gimbal and six bend angles. One agent with 22 actions: eight rotors, then gimbal rates
//! (x, y per link), then bend targets (y, z per joint). Target: (0, 0, 2) m, heading h_t at any yaw. Start: link 0
//! uniform in ±2.5 × ±2.5 × [1, 2.5] m, roll and pitch within ±0.2π, any yaw, joints straight, at rest.
//! d = ‖(p_t − p̄, h_t − h)‖.
//!
//! - Success: `position_error` < 0.1 m.
//! - Loss: √(‖p_t − p̄‖² + 0.1²) + 0.3 ‖h_t − h‖² + means of 0.02 ‖v_i‖² and 0.005 ‖ω_i‖² over the links and of 0.01
//!   q̇² over the joints.
//!
//! - DIFFERENCE: the whole body counts (defect 28): the mean of its links flies to the target, not link 0; Δs is that of
//!   all rotors and reported (published: always 0). The heading stays that of link 0, so the chain may bend as it likes.
//! - DIFFERENCE: starts with d > 3.8 are drawn again; 4 ends an episode.
//! - DIFFERENCE: links are observed relative to the target, so that nothing depends on where the world begins.

use super::clock_slice;
use crate::autodiff::{Pen, Scalar, safe};
use crate::dynamics::configurations::Dragon;
use crate::dynamics::frame::Frame;
use crate::dynamics::spatial::{Vec3, add, constants, dot, rotate, scale, sub, yawed};
use crate::error::Result;
use crate::tasks::config::EnvConfig;
use crate::tasks::reward::{both, smooth_norm, tip};
use crate::tasks::rig::{Rig, benchmark_motors};
use crate::tasks::sheet::{End, Metric, Setting, Sheet, Slice, Smoothness, Term};
use crate::tasks::task::{ANY_YAW, Ends, START_TILT, Start, Task, View, Wanted};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_PI;

/// The target, m, world.
const TARGET: [f64; 3] = [0.0, 0.0, 2.0];
/// Largest pose distance.
const FAR: f64 = 4.0;
/// Largest at the start.
const START_FAR: f64 = 3.8;
/// Links.
const LINKS: usize = 4;
/// From link 0 to the mean of a straight chain, m.
const MIDDLE: [f64; 3] = [0.45, 0.0, 0.0];
/// Drives: gimbals, then bends.
const DRIVES: usize = 14;

/// Settings of [`DragonHover`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DragonHoverSettings {
    /// T, steps.
    pub horizon: usize,
}

impl Default for DragonHoverSettings {
    fn default() -> Self {
        Self { horizon: 500 }
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct DragonHover {
    rig: Rig,
    settings: DragonHoverSettings,
    /// Bodies of the links, and their middles in them.
    links: [(usize, [f64; 3]); LINKS],
}

impl DragonHover {
    /// With the settings of a configuration.
    ///
    /// # Errors
    /// As [`EnvConfig::settings`] and [`Rig::of_model_as_one`].
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let built = Dragon { n_link: LINKS, ..Dragon::default() }.build()?;
        let model = benchmark_motors(&built.model)?;
        let of_links = &built.map.links;
        let gimbals = of_links.iter().flat_map(|l| l.gimbal);
        let drives: Vec<usize> = gimbals.chain(of_links.iter().filter_map(|l| l.bend).flatten()).collect();
        debug_assert_eq!(drives.len(), DRIVES);
        let mut links = [(0, [0.0; 3]); LINKS];
        for (i, link) in links.iter_mut().enumerate() {
            *link = (of_links[i].body, model.frame(&format!("link_{i}"))?.position);
        }
        let rig = Rig::of_model_as_one(&model, config.physics(), links[0].0, &drives)?;
        Ok(Self { rig, settings: config.settings()?, links })
    }

    /// Motion of the middle of a link.
    #[inline(always)]
    fn link<S: Scalar>(&self, view: &View<'_, S>, i: usize) -> Frame<S> {
        let (body, middle) = self.links[i];
        let frame = view.frame(body);
        let (position, velocity) = frame.point(constants(middle));
        Frame { position, velocity, ..frame }
    }

    /// p_t − p̄.
    #[inline(always)]
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        let mut sum = [S::zero(); 3];
        for i in 0..LINKS {
            sum = add(sum, self.link(view, i).position);
        }
        sub(constants(TARGET), scale(S::constant(1.0 / LINKS as f64), sum))
    }

    /// h_t − h.
    #[inline(always)]
    fn heading_error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.drone(0).heading())
    }

    /// q̇ of a joint.
    #[inline(always)]
    fn rate<S: Scalar>(view: &View<'_, S>, joint: usize) -> S {
        view.state.get(view.rig.drone().drives[joint].rate)
    }
}

impl Task for DragonHover {
    fn rig(&self) -> &Rig {
        &self.rig
    }

    fn horizon(&self) -> usize {
        self.settings.horizon
    }

    fn sheet(&self) -> Sheet {
        let observation = vec![
            Slice::new("target", 3, "m, world", "p_t − p̄"),
            Slice::new("positions", 3 * LINKS, "m, world", "p_i − p_t of every link"),
            Slice::new("attitudes", 4 * LINKS, "-, body → world", "unit quaternions of every link, w ≥ 0")
                .but(Smoothness::NonSmooth),
            Slice::new("velocities", 6 * LINKS, "m/s, rad/s, world", "v_i, ω_i of every link"),
            Slice::new("headings", 3 * LINKS, "-, world", "R_i e_x of every link"),
            Slice::new("ups", 3 * LINKS, "-, world", "R_i e_z of every link"),
            Slice::new("throttle", 2 * LINKS, "-", "2s − 1, s = Ω/Ω_max"),
            Slice::new("gimbals", 2 * LINKS, "half turns", "angles/π, x then y of every link"),
            Slice::new("bends", 2 * (LINKS - 1), "half turns", "angles/π, y then z of every joint"),
            Slice::new("heading_error", 3, "-, world", "h_t − h"),
            clock_slice(),
        ];
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![
                Term::piecewise("pose", "e^{−1.2 d}", 1.0),
                Term::piecewise("joints", "0.5 · mean e^{−|q̇|}", 0.5),
            ],
            ends: vec![End::new("crash", "min z_i < 0.2 m"), End::new("far", "d > 4")],
            metrics: vec![
                Metric { name: "position_error", unit: "m" },
                Metric { name: "heading_alignment", unit: "-" },
                Metric { name: "throttle_difference", unit: "-" },
            ],
            goal: vec![Slice::new("target_heading", 3, "-, world", "h_t")],
            memo: Vec::new(),
            settings: vec![Setting::new("horizon", 500, "T, steps")],
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
            let middle = add(position, rotate(attitude, MIDDLE));
            let heading = rotate(attitude, [1.0, 0.0, 0.0]);
            if safe::norm(both(sub(TARGET, middle), sub(wanted, heading))) <= START_FAR {
                break;
            }
        }
    }

    #[inline(always)]
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        out.array(self.error(view));
        for i in 0..LINKS {
            out.array(sub(self.link(view, i).position, constants(TARGET)));
        }
        for i in 0..LINKS {
            out.array(self.link(view, i).observed_attitude());
        }
        for i in 0..LINKS {
            let link = self.link(view, i);
            out.array(link.velocity);
            out.array(link.angular_velocity);
        }
        for i in 0..LINKS {
            out.array(self.link(view, i).heading());
        }
        for i in 0..LINKS {
            out.array(self.link(view, i).up());
        }
        for i in 0..2 * LINKS {
            out.number(S::constant(2.0).mul_add(view.throttle(0, i), -S::one()));
        }
        for i in 0..DRIVES {
            out.number(view.state.get(view.rig.drone().drives[i].angle) * S::constant(FRAC_1_PI));
        }
        out.array(Self::heading_error(view));
        view.observe_clock(out);
    }

    #[inline(always)]
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        terms.number(tip(1.2, both(self.error(view), Self::heading_error(view))));
        let mut calm = S::zero();
        for i in 0..DRIVES {
            calm += (-Self::rate(view, i).abs()).exp();
        }
        terms.number(S::constant(0.5 / DRIVES as f64) * calm);
    }

    #[inline(always)]
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        let mut lowest = self.link(view, 0).position[2];
        for i in 1..LINKS {
            lowest = lowest.min(self.link(view, i).position[2]);
        }
        ends.when(lowest.lt(S::constant(0.2)));
        let error = both(self.error(view), Self::heading_error(view));
        ends.when(S::constant(FAR * FAR).lt(safe::squared_norm(error)));
    }

    #[inline(always)]
    fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(self.error(view)));
        out.number(dot(view.drone(0).heading(), view.goal.array(0)));
        out.number(view.throttle_difference(0));
    }

    #[inline(always)]
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(self.error(view)).lt(S::constant(0.01))
    }

    #[inline(always)]
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let mut motion = S::zero();
        for i in 0..LINKS {
            let link = self.link(view, i);
            motion += S::constant(0.02 / LINKS as f64) * safe::squared_norm(link.velocity);
            motion += S::constant(0.005 / LINKS as f64) * safe::squared_norm(link.angular_velocity);
        }
        for i in 0..DRIVES {
            motion += S::constant(0.01 / DRIVES as f64) * Self::rate(view, i).square();
        }
        let heading = S::constant(0.3) * safe::squared_norm(Self::heading_error(view));
        smooth_norm(self.error(view), 0.1) + heading + motion
    }

    fn wanted(&self, view: &View<'_, f64>) -> Option<Wanted> {
        let mean = Frame { position: sub(constants(TARGET), self.error(view)), ..view.drone(0) };
        Some(Wanted::way(&mean, TARGET, view.goal.get(1).atan2(view.goal.get(0)), 1.9))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.copy_from_slice(&[1.0, 0.0, 0.0]);
        start.place_point(0, MIDDLE, TARGET, [1.0, 0.0, 0.0, 0.0]);
    }
}
