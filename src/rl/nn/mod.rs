//! Small networks on the processor: forward, backward, first weights, Adam.
//!
//! | file | what |
//! |---|---|
//! | `network` | what all networks have in common: forward, backward, named parts |
//! | `mlp`, `layer_norm` | layers one behind the other, and what is between them |
//! | `gru` | what is remembered from step to step |
//! | `conv` | convolutions over histories and images |
//! | `set` | several alike, in any order |
//! | `stack` | encoders, memory and layers as one network |
//! | `per_agent` | one of a shape for each agent of a team |
//! | `encoder` | encoders and memory as settings |
//! | `product`, `aligned` | the one matrix product behind them, and where its numbers stand |
//! | `elementwise` | sums of arrays, exponentials |
//! | `activation` | between layers |
//! | `init` | first weights |
//! | `adam` | the optimiser |
//! | `head`, `gaussian` | distributions of actions over outputs; Gaussians of many rows at once |
//! | `tanh_gaussian` | Gaussians behind tanh, drawn so that gradients pass |
//! | `fold` | a network with fewer outputs, sums of another's |
//! | `graph` | a network as a list of layers, for other languages |

pub(crate) mod activation;
pub(crate) mod adam;
pub mod aligned;
pub(crate) mod conv;
pub(crate) mod elementwise;
pub(crate) mod encoder;
#[cfg(test)]
pub(crate) mod exact;
pub(crate) mod fold;
pub(crate) mod gaussian;
pub mod graph;
pub(crate) mod gru;
pub(crate) mod head;
pub(crate) mod init;
mod layer_norm;
pub(crate) mod mlp;
pub(crate) mod network;
pub(crate) mod per_agent;
pub mod product;
pub(crate) mod set;
pub(crate) mod stack;
pub(crate) mod tanh_gaussian;

pub use activation::Activation;
pub use adam::{Adam, AdamConfig, clip_norm};
pub use conv::{Conv, Filter};
pub use encoder::{Encoder, Recurrence};
pub use gru::Gru;
pub use head::Head;
pub use init::Init;
pub use mlp::{Layers, Mlp};
pub use network::{Memory, Named, NamedTensor, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
pub use per_agent::PerAgent;
pub use set::{Pool, Set};
pub(crate) use stack::last_encoder;
pub use stack::{Encoded, Join, Stack};
