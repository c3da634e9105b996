//! Small networks on the processor: forward, backward, first weights, Adam.
//!
//! | file | what |
//! |---|---|
//! | `mlp` | layers, forward, backward, named parts |
//! | `product`, `aligned` | the one matrix product behind them, and where its numbers stand |
//! | `elementwise` | sums of arrays, exponentials |
//! | `activation` | between layers |
//! | `init` | first weights |
//! | `adam` | the optimiser |
//! | `head`, `gaussian` | distributions of actions over outputs; Gaussians of many rows at once |
//! | `tanh_gaussian` | Gaussians behind tanh, drawn so that gradients pass |
//! | `fold` | a network with fewer outputs, sums of another's |

pub(crate) mod activation;
pub(crate) mod adam;
pub(crate) mod aligned;
pub(crate) mod elementwise;
pub(crate) mod fold;
pub(crate) mod gaussian;
pub(crate) mod head;
pub(crate) mod init;
pub(crate) mod mlp;
pub(crate) mod product;
pub(crate) mod tanh_gaussian;

pub use activation::Activation;
pub use adam::{Adam, AdamConfig, clip_norm};
pub use head::Head;
pub use init::Init;
pub use mlp::{Layers, Memory, Mlp, Output, Part, Pass, Scratch, Transposed, Weights};
