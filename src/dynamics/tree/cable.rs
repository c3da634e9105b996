//! Cables: they pull where they are taut, and hang slack otherwise.
//!
//! Between two points ℓ apart, with e = ℓ − L beyond the cable's own length L and w = [`ROUND`] L,
//!
//! T = (k ψ(e) (1 + d ℓ̇))₊, ψ(e) = 0 for e ≤ 0, e²/(2w) up to w, e − w/2 beyond,
//!
//! along the line between them. A slack cable weighs nothing and exerts nothing. T is continuously differentiable in ℓ, so that
//! gradients pass where it goes taut; the elastic part stores k ∫ψ, the rest takes power k ψ d ℓ̇² out. As with contacts, k and
//! the slope k ψ d are held at what a substep resolves: [`check_cables`](super::check_cables) tells.

use base::error::{Error, Result, finite};
use serde::{Deserialize, Serialize};

/// Share of its length over which a cable goes taut.
#[doc(hidden)]
pub const ROUND: f64 = 2e-3;

/// Where a cable ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CableEnd {
    /// Number of the body; `None` for the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<usize>,
    /// In the body's frame or in the world, m.
    pub point: [f64; 3],
}

/// A cable without mass that pulls its ends together where they are farther apart than it is long, and never pushes.
///
/// Its tension (N) over the distance ℓ of its ends is T = (k ψ(ℓ − L) (1 + d ℓ̇))₊ with ψ(e) = 0 for e ≤ 0, e²/(2w) up to w = 0.002 L and
/// e − w/2 beyond: continuously differentiable where it goes taut. k and the damping are held at what a substep resolves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cable {
    /// Unique within the model.
    pub name: String,
    /// Two points of different bodies, or of one and the world.
    pub ends: [CableEnd; 2],
    /// L, m, > 0.
    pub length: f64,
    /// k, N/m, > 0.
    pub stiffness: f64,
    /// d, s/m, ≥ 0.
    pub dissipation: f64,
}

impl Cable {
    /// Checks numbers and ends; `what` names the model in the error.
    pub(super) fn validate(&self, what: &str, n_body: usize) -> Result<()> {
        let what = format!("{what}cable '{}'", self.name);
        for end in &self.ends {
            finite(&format!("{what}: point"), &end.point)?;
            if let Some(body) = end.body.filter(|b| *b >= n_body) {
                let rule = format!("below {n_body}");
                return Err(Error::value(format!("{what}: body"), body, rule, "Bodies count from 0."));
            }
        }
        if self.ends[0].body == self.ends[1].body {
            let remedy = "It would pull on nothing: tie one of them elsewhere.";
            return Err(Error::value(
                format!("{what}: ends"),
                "on one body",
                "on two, or on one and the world",
                remedy,
            ));
        }
        finite(&format!("{what}: length, stiffness, dissipation"), &[self.length, self.stiffness, self.dissipation])?;
        let bounds = [("length", self.length, 1e-3, 1e3), ("stiffness", self.stiffness, 1e-6, 1e9)];
        for (name, value, least, most) in bounds.into_iter().chain([("dissipation", self.dissipation, 0.0, 1e3)]) {
            if !(least..=most).contains(&value) {
                let rule = format!("between {least} and {most}");
                return Err(Error::value(format!("{what}: {name}"), value, rule, "In m, N/m and s/m."));
            }
        }
        Ok(())
    }
}
