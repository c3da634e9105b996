//! A gate that slides sideways on a spring, fixed to the world.
//!
//! ```text
//!   world ══ mount ──(slide: y)── frame      opening in the y-z plane, two uprights and two crossbars
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | frame | 4 kg, inertia (0.01, 0.01, 0.0075) kg m², four capsules of radius 0.04 m at y = ±0.6, z = ±0.55 m | OmniDrones `gate_sliding.usd` |
//! | slide | along y, ±2 m, spring 3 N/m to the middle, no damping | same |
//! | scale | 1.1: opening of half sizes 0.66 × 0.605 m less the radius | its FlyThrough tasks |
//! | stops | natural rate 30 rad/s, dissipation 3 s/m | our assumption |
//! | slide at scale 1.1 | ±2.2 m; the mass stays | our assumption |
//!
//! The mount (0.1 kg) does not move, so its mass is nowhere. DIFFERENCE: an undamped gate swings through a whole episode
//! at √(3/4) = 0.87 rad/s, which nobody asked for (defect 20): `damping` is a parameter, 0 as published. Observations
//! should read the frame, not the mount (19): [`SlidingGateMap::frame`].

use super::configuration::Configuration;
use crate::assembly::{Assembly, JointKind, JointSpec, Placement, Solid, WORLD, rod};
use crate::shape::Shape;
use crate::vehicle::Inertia;
use base::defaults::with_defaults;
use base::error::{Error, Result};

with_defaults! {
    /// Parameters; `Default` is the paper's.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SlidingGate {
        /// Where it stands: the opening's middle, looking along x.
        pub place: Placement = Placement::IDENTITY,
        /// Half distance between the uprights' centre lines, m, before `scale`.
        pub half_width: f64 = 0.6,
        /// Half distance between the crossbars' centre lines, m, before `scale`.
        pub half_height: f64 = 0.55,
        /// Of the capsules, m, before `scale`.
        pub radius: f64 = 0.04,
        /// kg.
        pub mass: f64 = 4.0,
        /// About the frame's middle, kg m²; it does not turn, so it does not matter.
        pub inertia: Inertia = Inertia::diagonal(0.01, 0.01, 0.0075),
        /// Of all lengths.
        pub scale: f64 = 1.1,
        /// Either way from the middle, m, before `scale`.
        pub range: f64 = 2.0,
        /// N/m.
        pub stiffness: f64 = 3.0,
        /// N s/m.
        pub damping: f64 = 0.0,
    }
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlidingGateMap {
    /// What slides; its joint is `slide`.
    pub frame: usize,
}

impl SlidingGate {
    /// The model `gate`: one body with one degree of freedom. Group it with what flies through it
    /// ([`group`](crate::assembly::group())).
    ///
    /// # Errors
    /// As [`Assembly::model`].
    pub fn build(&self) -> Result<Configuration<SlidingGateMap>> {
        if !(self.scale > 0.0 && self.scale.is_finite()) {
            return Err(Error::value("gate: scale", self.scale, "> 0 and finite", "1 keeps the size."));
        }
        let frame = self.bars().into_iter().fold(Solid::explicit(self.mass, [0.0; 3], self.inertia), Solid::and);
        let range = self.scale * self.range;
        let mut robot = Assembly::new("gate");
        robot.part("frame", frame.scaled(self.scale));
        robot.join(
            JointSpec::new("slide", JointKind::Prismatic([0.0, 1.0, 0.0]), WORLD, "frame")
                .at(self.place)
                .range(-range, range)
                .spring(self.stiffness, 0.0)
                .damping(self.damping),
        );
        let model = robot.model()?;
        let map = SlidingGateMap { frame: model.body("frame")? };
        Ok(Configuration { model, map })
    }

    /// The bars after `place` and `scale`, world.
    pub(super) fn still_bars(&self) -> impl Iterator<Item = Shape> {
        let (place, scale) = (self.place, self.scale);
        self.bars().into_iter().map(move |bar| {
            let own = Placement { position: bar.position, rotation: bar.rotation }.scaled(scale);
            let outer = place.then(&own);
            Shape { geometry: bar.geometry.scaled(scale), position: outer.position, rotation: outer.rotation }
        })
    }

    /// Left and right upright, upper and lower crossbar.
    fn bars(&self) -> [Shape; 4] {
        let corner = |y: f64, z: f64| [0.0, y * self.half_width, z * self.half_height];
        let bar = |from, to| rod(from, to, self.radius);
        [
            bar(corner(1.0, -1.0), corner(1.0, 1.0)),
            bar(corner(-1.0, -1.0), corner(-1.0, 1.0)),
            bar(corner(-1.0, 1.0), corner(1.0, 1.0)),
            bar(corner(-1.0, -1.0), corner(1.0, -1.0)),
        ]
    }
}
