//! DragonHover: a chain of four links, rotors on gimbals, flies to a point and holds still there.
//!
//! - DIFFERENCE: the whole body counts (defect 28): the mean of its links flies to the target, not link 0; Δs is that of
//!   all rotors and reported (published: always 0). The heading stays that of link 0, so the chain may bend as it likes.
//! - DIFFERENCE: starts with d > 3.8 are drawn again; 4 ends an episode.
//! - DIFFERENCE: joints are observed by cosine and sine, alike after whole turns; published ones by angles/π.
//! - DIFFERENCE: links are observed relative to the target, so that nothing depends on where the world begins.

use super::hover::set_heading;
use super::{
    PoseLoss, PoseSuccess, StartRange, farther, less, made_of, rate_cost, speed_cost, squared, succeeds_within,
};
use crate::config::EnvConfig;
use crate::declare::{Ends, Loss, Writer};
use crate::reward::{both, exponential_kernel, smooth_norm};
use crate::robot::{Robot, benchmark_motors};
use crate::settings;
use crate::start::{ANY_YAW, Start};
use crate::task::{BuiltIn, Task, TaskReference, View};
use autodiff::{Array, Mask, Scalar, Trace, safe};
use base::error::Result;
use dynamics::configurations::Dragon;
use dynamics::frame::Frame;
use dynamics::spatial::{Vec3, add, constants, dot, rotate, scale, sub, yawed};

/// Links.
const LINKS: usize = 4;
/// From link 0 to the mean of a straight chain, m.
const MIDDLE: [f64; 3] = [0.45, 0.0, 0.0];
/// Drives: gimbals, then bends.
const DRIVES: usize = 14;
/// The first of them.
const GIMBALS: usize = 2 * LINKS;

settings! {
    /// Settings of [`DragonHover`].
    pub(crate) struct DragonHoverSettings {
        horizon: usize = 500 => ("steps", "T", Any);
        target: [f64; 3] = [0.0, 0.0, 2.0] => ("m, world", "p_t", Any);
        start: StartRange = StartRange::default() => group;
        start_distance: f64 = 3.8 => ("-", "largest d of a start", Positive);
        min_height: f64 = 0.2 => ("m", "a lower link is a crash", Any);
        max_distance: f64 = 4.0 => ("-", "largest d", Positive);
        success: PoseSuccess = PoseSuccess::default() => group;
        pose_scale: f64 = 1.2 => ("1/m", "how steeply the term pose falls", NotNegative);
        reward_pose: f64 = 1.0 => ("-", "weight of the term pose", NotNegative);
        reward_joints: f64 = 0.5 => ("-", "weight of the term joints", NotNegative);
        loss: PoseLoss = PoseLoss::default() => group;
        loss_joints: f64 = 0.01 => ("m s²/rad²", "weight of the rates of joints in the loss", NotNegative);
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct DragonHover {
    robot: Robot,
    settings: DragonHoverSettings,
    /// Bodies of the links, and their middles in them.
    links: [(usize, [f64; 3]); LINKS],
}

impl BuiltIn for DragonHover {
    fn new(config: &EnvConfig) -> Result<Self> {
        let settings: DragonHoverSettings = config.settings()?;
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
        let robot = Robot::of_model_as_one(&model, config.physics(), links[0].0, &drives)?;
        Ok(Self { robot, settings, links })
    }
}

impl DragonHover {
    /// Motion of the middle of a link.
    fn link<S: Scalar>(&self, view: &View<'_, S>, i: usize) -> Frame<S> {
        let (body, middle) = self.links[i];
        let frame = view.frame(body);
        let (position, velocity) = frame.point(constants(middle));
        Frame { position, velocity, ..frame }
    }

    /// p_t − p̄.
    fn error<S: Scalar>(&self, view: &View<'_, S>) -> Vec3<S> {
        let mut sum = [S::zero(); 3];
        for i in 0..LINKS {
            sum = add(sum, self.link(view, i).position);
        }
        sub(constants(self.settings.target), scale(S::constant(1.0 / LINKS as f64), sum))
    }

    /// h_t − h.
    fn heading_error<S: Scalar>(view: &View<'_, S>) -> Vec3<S> {
        sub(view.goal.array(0), view.drone(0).heading())
    }

    /// q̇ of a joint.
    fn rate<S: Scalar>(view: &View<'_, S>, joint: usize) -> S {
        view.state[view.robot.drone().drives[joint].rate]
    }
}

impl Task for DragonHover {
    made_of!(self: self.robot, self.settings);

    fn about(&self) -> &'static str {
        "p_i link middles, v_i, ω_i velocities and angular velocities of the links (world), p̄ = ¼ Σ p_i, h = R_0 e_x \
         heading of link 0, q joints: eight gimbal and six bend angles. One agent with 22 actions: eight rotors, then \
         gimbal rates (x, y per link), then bend targets (y, z per joint). Target: {target} m, heading h_t at any \
         yaw. Start: link 0 uniform in {start_position} m, roll and pitch within ±{start_tilt} rad, yaw within \
         {start_yaw} rad, joints straight, at rest, d ≤ {start_distance}. d = ‖(p_t − p̄, h_t − h)‖."
    }

    fn start(&self, start: &mut Start<'_>) {
        let own = &self.settings;
        let target_heading = yawed(start.task.uniform(ANY_YAW[0], ANY_YAW[1]));
        set_heading(start, target_heading);
        start.again(100, |start| {
            let (position, attitude) = own.start.draw(start);
            start.place(0, position, attitude);
            let middle = add(position, rotate(attitude, constants(MIDDLE)));
            let heading = rotate(attitude, constants([1.0, 0.0, 0.0]));
            let error = both(sub(constants(own.target), middle), sub(target_heading, heading));
            farther(error, own.start_distance).not()
        });
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("target", "m, world", "p_t − p̄").array(self.error(view));
        out.field("positions", "m, world", "p_i − p_t of every link");
        for i in 0..LINKS {
            out.array(sub(self.link(view, i).position, constants(self.settings.target)));
        }
        out.field("attitudes", "-, body → world", "unit quaternions of every link, w ≥ 0")
            .within(-1.0, 1.0)
            .non_smooth();
        for i in 0..LINKS {
            out.array(self.link(view, i).observed_attitude());
        }
        out.field("velocities", "m/s, rad/s, world", "v_i, ω_i of every link");
        for i in 0..LINKS {
            let link = self.link(view, i);
            out.array(link.velocity);
            out.array(link.angular_velocity);
        }
        out.field("headings", "-, world", "R_i e_x of every link").within(-1.0, 1.0);
        for i in 0..LINKS {
            out.array(self.link(view, i).heading());
        }
        out.field("ups", "-, world", "R_i e_z of every link").within(-1.0, 1.0);
        for i in 0..LINKS {
            out.array(self.link(view, i).up());
        }
        view.observe_throttle(0, out);
        out.field("gimbals", "-", "(cos, sin) of the angles, x then y of every link").within(-1.0, 1.0);
        for i in 0..DRIVES {
            if i == GIMBALS {
                out.field("bends", "-", "(cos, sin) of the angles, y then z of every joint").within(-1.0, 1.0);
            }
            out.array(view.turned(view.robot.drone().drives[i].angle));
        }
        out.field("heading_error", "-, world", "h_t − h").within(-2.0, 2.0).array(Self::heading_error(view));
        view.observe_clock(out);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        let own = &self.settings;
        let pose = exponential_kernel(own.pose_scale, both(self.error(view), Self::heading_error(view)));
        terms.term("pose", "{×reward_pose}e^{−{×pose_scale}d}", own.reward_pose).piecewise();
        terms.number(Trace::constant(own.reward_pose) * pose);
        let mut calm = Trace::zero();
        for i in 0..DRIVES {
            calm += (-Self::rate(view, i).abs()).exp();
        }
        terms.term("joints", "{×reward_joints}mean e^{−|q̇|}", own.reward_joints).piecewise();
        terms.number(Trace::constant(own.reward_joints / DRIVES as f64) * calm);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        let mut lowest = self.link(view, 0).position[2];
        for i in 1..LINKS {
            lowest = lowest.min(self.link(view, i).position[2]);
        }
        ends.when("crash", "min z_i < {min_height} m", less(lowest, self.settings.min_height));
        let error = both(self.error(view), Self::heading_error(view));
        ends.when("far", "d > {max_distance}", farther(error, self.settings.max_distance));
    }

    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("position_error", "m", safe::norm(self.error(view)));
        out.metric("heading_alignment", "-", dot(view.drone(0).heading(), view.goal.array(0)));
        out.metric("throttle_difference", "-", view.throttle_difference(0));
    }

    succeeds_within!(
        self, view: self.error(view), self.settings.success.distance,
        "heading_alignment": dot(view.drone(0).heading(), view.goal.array(0)), self.settings.success.alignment
    );

    fn loss(&self, view: &View, loss: &mut Loss) {
        let (own, w) = (&self.settings, &self.settings.loss);
        let mut motion = Trace::zero();
        for i in 0..LINKS {
            let link = self.link(view, i);
            motion += speed_cost(w.motion.velocity / LINKS as f64, link.velocity);
            motion += rate_cost(w.motion.rate / LINKS as f64, link.angular_velocity);
        }
        for i in 0..DRIVES {
            motion += rate_cost(own.loss_joints / DRIVES as f64, [Self::rate(view, i)]);
        }
        loss.add("√(‖p_t − p̄‖² + {loss_radius}²)", smooth_norm(self.error(view), w.motion.radius));
        loss.add("{×loss_turn}‖h_t − h‖²", squared(w.turn, Self::heading_error(view)));
        let formula = "mean({×loss_velocity}h₅(v_i) + {×loss_rate}h₁₀(ω_i)) over the links + mean {×loss_joints}h₁₀(q̇) over the joints";
        loss.add(formula, motion);
    }

    fn reference(&self, view: &View<'_, f64>) -> Option<TaskReference> {
        let target = self.settings.target;
        let mean = Frame { position: sub(target, self.error(view)), ..view.drone(0) };
        Some(TaskReference::way(&mean, target, view.goal[1].atan2(view.goal[0]), 1.9))
    }

    fn ideal(&self, start: &mut Start<'_>) {
        set_heading(start, [1.0, 0.0, 0.0]);
        start.place_point(0, MIDDLE, self.settings.target, [1.0, 0.0, 0.0, 0.0]);
    }
}
