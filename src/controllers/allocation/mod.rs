//! Allocation: a wanted wrench → rotor thrusts and thrust vectors.
//!
//! | file | idea |
//! |---|---|
//! | `articulated`: [`composite_inertia()`], [`resistance()`] | what the rotors of a system of many bodies can do in its present shape |
//! | `pseudo_inverse`: [`Mixer`], [`allocate()`] | the mixer: least thrusts, clipped, yaw last |
//! | `problem`: [`Problem`], [`Affine`] | the bounded problem: quadratic cost, bounds, cones |
//! | `allocator`: [`Allocator`], [`AllocationSolution`] | its solvers behind one interface, with certificate, fallback and counts |
//! | `fast` | its fast paths and their gradient |
//! | `side_by_side` | the same for eight wrenches at once, as machine code |
//! | `c_text` | the same as C text |
//! | `active_set` | bounds: exact and fast, branch-free |
//! | `conic` | cones: clarabel |
//! | `function`: [`AllocationFunction`] | an answer with its derivative, called by kernels of any scalar |
//! | `batch`: [`BatchAllocator`], [`BatchReport`] | many environments in lanes |
//! | `prioritised`: [`PrioritisedAllocator`], [`PrioritisedCounts`] | priorities without weights |
//! | `null_space`: [`NullSpaceAllocator`] | of all inputs that make a wrench, those nearest to a goal |
//! | `residual` | the certificate |
//! | `gradient`, `variation` | exact derivatives of an answer with respect to every number |
//! | `attainable_wrench`: [`AttainableWrenches`], [`Facet`] | how far a wrench lies inside what bounded inputs can deliver |
//! | `failure`: [`Assessment`], [`Capability`] | what is left of a vehicle after each loss of a rotor |
//! | `spin`: [`Spin`] | the steady turn that carries what cannot hover at rest |

#[doc(hidden)]
pub mod active_set;
pub(crate) mod allocator;
pub(crate) mod articulated;
#[doc(hidden)]
pub mod attainable_wrench;
#[doc(hidden)]
pub mod batch;
mod c_text;
#[doc(hidden)]
pub mod conic;
#[doc(hidden)]
pub mod failure;
pub(crate) mod fast;
#[doc(hidden)]
pub mod function;
#[doc(hidden)]
pub mod gradient;
#[doc(hidden)]
pub mod null_space;
#[doc(hidden)]
pub mod prioritised;
#[doc(hidden)]
pub mod problem;
#[doc(hidden)]
pub mod pseudo_inverse;
#[doc(hidden)]
pub mod residual;
mod side_by_side;
pub(crate) mod spin;
pub(crate) mod variation;

pub use allocator::{AllocationSolution, Allocator, AllocatorSettings, Counts, HoldReason, Solver};
pub use articulated::{composite_inertia, resistance, wrench_matrix};
pub use attainable_wrench::{AttainableWrenches, Facet, Margin, WrenchMargin};
pub use batch::{BatchAllocator, BatchReport};
pub use dynamics::authority::{Authority, Axis, characteristic_length};
pub use failure::{Assessment, Capability, FailureTable, RotorFailure};
pub use function::AllocationFunction;
pub use gradient::AllocationSensitivity;
pub use null_space::NullSpaceAllocator;
pub use prioritised::{PrioritisedAllocator, PrioritisedCounts, PrioritisedSolution};
pub use problem::{Affine, Cone, Problem, Scales, rate_window};
pub use pseudo_inverse::{Mixer, allocate, allocate_yaw_last, thrust_to_command};
pub use spin::Spin;
pub use variation::{RowVariation, Variation};
