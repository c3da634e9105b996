//! Contact between bodies: compliant, with friction, smooth enough to differentiate.
//!
//! | file | what |
//! |---|---|
//! | `material` | stiffness, dissipation, friction: as data and as numbers for kernels |
//! | `closest` | nearest points of segments, directions that survive coincident centres |
//! | `pairs` | where two bodies touch, along which normal, how deep |
//! | `force` | from there to forces, and their sum per body |
//! | `distance` | signed distance of every pair, those without a force included |
//!
//! Spheres and capsules push against plane, sphere and capsule; a box pushes with its eight corners against the plane. Other
//! pairs with a box have a signed distance here; in a [`Multibody`](crate::tree::Multibody) they push too, one of
//! the two by balls within it.
//!
//! The force in time is passive: what it gives back on the way out is at most what it took on the way in, and friction
//! always opposes slip. An integrator keeps that only while its step resolves the contact: see
//! [`ContactMaterial`] for the numbers. A [`Multibody`](crate::tree::Multibody) takes no more stiffness and damping
//! than that.
//!
//! **Derivatives.** In depth the normal force is continuously differentiable, touch included (δ^{3/2} leaves with zero
//! slope); its second derivative grows as δ^{−1/2} on the way to touch. It has a kink where a body leaves faster than
//! 2/(3d), and the force is held at 0 instead of pulling, and one where damping reaches what a step resolves. Friction is smooth in slip, with slope at most μ F_n/v_s. Contact
//! points and normals jump where the nearest point does: at coincident centres, and at a crossing of axes. They do not for
//! a capsule that lies flat (both ends push) nor for parallel capsules (the middle pushes). A gradient through an impact
//! is that of the resolved, compliant impact: finite, and as steep as its stiffness.

pub(crate) mod closest;
#[doc(hidden)]
pub mod distance;
#[doc(hidden)]
pub mod force;
pub(crate) mod material;
pub(crate) mod pairs;

pub use distance::{distance, ground_distance, plane_distance};
pub use material::{ContactMaterial, Material};
pub use pairs::{ContactPoint, Contacts, MAX_CONTACTS, between, with_plane};

#[cfg(test)]
mod tests;
