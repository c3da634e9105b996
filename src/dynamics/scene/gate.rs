//! A gate: four bars around an opening, fixed or sliding on a spring.

use crate::contact::{ContactMaterial, force};
use crate::shape::{MAX_SIZE, MIN_SIZE, Pose, upright, validate_pose, within};
use crate::spatial::{Vec3, add, constants};
use autodiff::{Scalar, safe};
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

with_defaults! {
    /// A frame of four capsules in its local yz plane around the opening; one flies through along local x.
    ///
    /// The lengths are those before `scale`. The default is the frame of OmniDrones (`gate_sliding.usd`, used there at scale
    /// 1.1): bars of radius 0.04 m along y = ±0.6 m and z = ±0.55 m.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Gate {
        /// Unique in its scene; for messages.
        pub name: String = "gate".into(),
        /// Centre of the opening where the slide is at 0, world, m.
        pub position: [f64; 3] = [0.0; 3],
        /// Unit quaternion `[w, x, y, z]`, gate → world.
        pub rotation: [f64; 4] = upright(),
        /// y of the upright bars' axes, m.
        pub half_width: f64 = 0.6,
        /// z of the level bars' axes, m.
        pub half_height: f64 = 0.55,
        /// Of the bars, m.
        pub radius: f64 = 0.04,
        /// Factor on the three lengths.
        pub scale: f64 = 1.1,
        /// Where the frame slides along its local y; `None` for a fixed gate.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub slide: Option<GateSlide> = None,
    }
}

/// A frame that slides along its local y axis on a spring with rest at 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GateSlide {
    /// N/m.
    pub stiffness: f64,
    /// N s/m. OmniDrones has none: a displaced gate then swings for ever, at √(stiffness/mass) = 0.87 rad/s.
    pub damping: f64,
    /// The slide ends at ±range, m, in stops of the default [`ContactMaterial`].
    pub range: f64,
    /// Of the moving frame, kg.
    pub mass: f64,
}

impl Default for GateSlide {
    /// OmniDrones' frame: 4 kg on 3 N/m, undamped, ±2 m.
    fn default() -> Self {
        Self { stiffness: 3.0, damping: 0.0, range: 2.0, mass: 4.0 }
    }
}

impl GateSlide {
    /// Acceleration of the frame along its y axis, m/s², at `coordinate` s (m) and `speed` ṡ (m/s), pushed by `push` F (N) along y:
    /// s̈ = (F − k s − d ṡ − stops)/m.
    pub fn acceleration<S: Scalar>(&self, coordinate: S, speed: S, push: S) -> S {
        let stop = ContactMaterial::default().cast();
        let range = S::constant(self.range);
        let upper = force::normal_force(&stop, coordinate - range, speed);
        let lower = force::normal_force(&stop, -coordinate - range, -speed);
        let spring = S::constant(self.stiffness).mul_add(coordinate, S::constant(self.damping) * speed);
        (push - spring - upper + lower) * S::constant(1.0 / self.mass)
    }
}

/// How a straight step from a to b meets a gate; see [`Gate::passage`].
#[derive(Debug, Clone, Copy)]
pub struct Passage<S> {
    /// +1 where the step crosses the gate's plane along its x axis, −1 where it crosses against it, 0 where it does not
    /// cross. A point on the plane counts as beyond it: of steps that join end to end each crossing counts once.
    pub direction: S,
    /// How far inside the opening the crossing is, m: the distance to the nearest bar's surface in the plane, negative
    /// outside. Without a crossing, that of the step's end nearer to the plane.
    pub margin: S,
}

impl Gate {
    /// (half width, half height, radius) of the bars' axes after `scale`, m.
    #[inline]
    pub(super) fn lengths(&self) -> [f64; 3] {
        [self.scale * self.half_width, self.scale * self.half_height, self.scale * self.radius]
    }

    /// Half width and half height of the free opening, m.
    pub fn opening(&self) -> [f64; 2] {
        let [w, h, r] = self.lengths();
        [w - r, h - r]
    }

    /// Pose of the frame displaced by `offset` (world, m) and slid by `slide` along its own y axis, m.
    #[inline]
    pub fn pose<S: Scalar>(&self, offset: Vec3<S>, slide: S) -> Pose<S> {
        let mount = Pose { position: add(constants(self.position), offset), attitude: constants(self.rotation) };
        Pose { position: mount.point([S::zero(), slide, S::zero()]), attitude: mount.attitude }
    }

    /// Ends of the axes of the four bars (y = +w, y = −w, z = +h, z = −h), world, for the frame at `pose`; their radius is
    /// [`Gate::bar_radius`].
    pub fn bars<S: Scalar>(&self, pose: &Pose<S>) -> [[Vec3<S>; 2]; 4] {
        let [w, h, _] = self.lengths();
        let o = S::zero();
        let (w, h) = (S::constant(w), S::constant(h));
        let (a, b) = (pose.point([o, w, h]), pose.point([o, w, -h]));
        let (c, d) = (pose.point([o, -w, h]), pose.point([o, -w, -h]));
        [[a, b], [c, d], [a, c], [b, d]]
    }

    /// Radius of the bars after `scale`, m.
    pub fn bar_radius(&self) -> f64 {
        self.lengths()[2]
    }

    /// Signed distance of a world point to the bars of the frame at `pose`, m. Exact outside; in the corners, where two
    /// bars overlap, the depth is that in the nearer one.
    pub fn distance<S: Scalar>(&self, pose: &Pose<S>, point: Vec3<S>) -> S {
        let [w, h, radius] = self.lengths();
        let (w, h, zero) = (S::constant(w), S::constant(h), S::zero());
        let p = pose.local(point);
        // by symmetry the nearest bar lies on the point's side of both axes
        let (y, z) = (p[1].abs(), p[2].abs());
        let upright = [p[0], y - w, (z - h).max(zero)];
        let level = [p[0], (y - w).max(zero), z - h];
        let squared = safe::squared_norm(upright).min(safe::squared_norm(level));
        safe::sqrt(squared, safe::SQUARED_NORM_FLOOR) - S::constant(radius)
    }

    /// How the step from `from` to `to` (world, m) meets the opening of the frame at `pose`.
    pub fn passage<S: Scalar>(&self, pose: &Pose<S>, from: Vec3<S>, to: Vec3<S>) -> Passage<S> {
        let [w, h, radius] = self.lengths();
        let (zero, one) = (S::zero(), S::one());
        let (a, b) = (pose.local(from), pose.local(to));
        let before = S::select(a[0].lt(zero), zero, one);
        let direction = S::select(b[0].lt(zero), zero, one) - before;
        let t = safe::div(a[0], a[0] - b[0], 1e-9).clamp(zero, one);
        let y = t.mul_add(b[1] - a[1], a[1]);
        let z = t.mul_add(b[2] - a[2], a[2]);
        let margin = (S::constant(w - radius) - y.abs()).min(S::constant(h - radius) - z.abs());
        Passage { direction, margin }
    }

    /// Checks every number; `what` names the gate in the error.
    ///
    /// # Errors
    /// [`Error::Value`] for lengths (m) or a scale outside 1e-6 to 1e4; bars so thick that nothing fits through; a pose as
    /// [`Shape::validate`](crate::shape::Shape::validate) refuses; a slide without mass or range.
    pub fn validate(&self, what: &str) -> Result<()> {
        validate_pose(what, &self.position, &self.rotation)?;
        for (name, value) in [
            ("half_width", self.half_width),
            ("half_height", self.half_height),
            ("radius", self.radius),
            ("scale", self.scale),
        ] {
            within(&format!("{what}: {name}"), value, MIN_SIZE, MAX_SIZE)?;
        }
        let least = self.half_width.min(self.half_height);
        if self.radius >= least {
            return Err(Error::value(
                format!("{what}: radius"),
                self.radius,
                format!("below {least}, the lesser of half_width and half_height"),
                "Thinner bars or a larger frame leave an opening.",
            ));
        }
        if let Some(slide) = &self.slide {
            within(&format!("{what}: slide.stiffness"), slide.stiffness, 0.0, 1e9)?;
            within(&format!("{what}: slide.damping"), slide.damping, 0.0, 1e9)?;
            within(&format!("{what}: slide.range"), slide.range, 0.0, MAX_SIZE)?;
            within(&format!("{what}: slide.mass"), slide.mass, 1e-6, 1e6)?;
        }
        Ok(())
    }
}
