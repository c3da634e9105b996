//! What stands before the hidden layers, as settings: readers of groups, and a memory.
//!
//! ```toml
//! [[ppo.network.encoder]]
//! group = "history"
//! kind = "conv1d"
//! layers = [{ channels = 16, kernel = 3 }, { channels = 8, kernel = 3, stride = 2 }]
//!
//! [ppo.network.memory]
//! kind = "gru"
//! units = 64
//! ```

use super::conv::{Conv, Filter};
use super::gru::Gru;
use super::mlp::{Layers, Mlp};
use super::network::Network;
use super::set::{Pool, Set};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A network that reads one group of the observation: a group or a field by its name. What no encoder reads goes to the
/// hidden layers as it is. Activations and first weights are those of the network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum Encoder {
    /// Fully connected layers.
    Mlp {
        /// What it reads.
        group: String,
        /// Units of its layers; it gives as many numbers as the last has.
        units: Vec<usize>,
    },
    /// Convolutions along the first axis of `[steps, n]`: the group `history`, a field of several members.
    Conv1d {
        /// What it reads.
        group: String,
        /// One after the other.
        layers: Vec<Filter>,
    },
    /// Convolutions over `[height, width, channels]`: an image.
    Conv2d {
        /// What it reads.
        group: String,
        /// One after the other.
        layers: Vec<Filter>,
    },
    /// The same layers for every member of `[members, n]`, then their mean or largest: the order of members does not count.
    Set {
        /// What it reads.
        group: String,
        /// Units of the layers of a member.
        units: Vec<usize>,
        /// `mean` or `max`.
        #[serde(default)]
        pool: Pool,
    },
}

impl Encoder {
    /// What it reads.
    pub fn group(&self) -> &str {
        match self {
            Self::Mlp { group, .. } | Self::Conv1d { group, .. } | Self::Conv2d { group, .. } => group,
            Self::Set { group, .. } => group,
        }
    }

    /// Checks what can be checked without the group's shape.
    ///
    /// # Errors
    /// [`Error::Limit`] for no layers or units out of range.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Mlp { units, .. } | Self::Set { units, .. } => {
                if units.is_empty() {
                    let remedy = "One or two layers of 32 to 128 units are usual.";
                    return Err(Error::limit(
                        format!("layers of the encoder of '{}'", self.group()),
                        0,
                        "1 to 33",
                        remedy,
                    ));
                }
                Layers { hidden: units.clone(), ..Layers::default() }.validate()
            }
            Self::Conv1d { layers, .. } | Self::Conv2d { layers, .. } if layers.is_empty() => {
                let remedy = "Two layers are usual: [{ channels = 16, kernel = 3 }, { channels = 8, kernel = 3 }].";
                Err(Error::limit(format!("layers of the encoder of '{}'", self.group()), 0, "1 to 16", remedy))
            }
            Self::Conv1d { .. } | Self::Conv2d { .. } => Ok(()),
        }
    }

    /// The network over a group of `shape`, in the style of `layers`.
    ///
    /// # Errors
    /// [`Error::Value`] for a group of another number of axes; otherwise as `Mlp::new`, `Conv::along` and `Set::new`.
    pub fn network(&self, shape: &[usize], layers: &Layers) -> Result<Arc<dyn Network>> {
        let mlp = |n_in: usize, units: &[usize]| {
            let (last, hidden) = units.split_last().unwrap_or((&0, &[]));
            let init = layers.init.inner(hidden.last().copied().unwrap_or(n_in));
            let own = Layers { hidden: hidden.into(), init, ..layers.plain() };
            Mlp::new(n_in, &own, *last, layers.activation)
        };
        let (activation, init) = (layers.activation, layers.init);
        match (self, shape) {
            (Self::Mlp { units, .. }, shape) => Ok(Arc::new(mlp(shape.iter().product(), units)?)),
            (Self::Conv1d { layers, .. }, [steps, n]) => {
                Ok(Arc::new(Conv::along(*steps, *n, layers, activation, init)?))
            }
            (Self::Conv2d { layers, .. }, [height, width, channels]) => {
                Ok(Arc::new(Conv::over([*height, *width, *channels], layers, activation, init)?))
            }
            (Self::Set { units, pool, .. }, [members, n]) => Ok(Arc::new(Set::new(*members, mlp(*n, units)?, *pool)?)),
            (own, shape) => {
                let (limit, remedy) = match own {
                    Self::Conv2d { .. } => ("[height, width, channels]", "Read an image, or take kind = \"mlp\"."),
                    Self::Set { .. } => ("[members, n]", "Read a field of several members, or take kind = \"mlp\"."),
                    _ => ("[steps, n]", "Add a stage `history` and read the group 'history', or take kind = \"mlp\"."),
                };
                Err(Error::value(format!("shape of the group '{}'", own.group()), format!("{shape:?}"), limit, remedy))
            }
        }
    }
}

/// What a policy remembers from step to step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum Recurrence {
    /// A gated recurrent unit (`Gru`).
    Gru {
        /// Numbers that it remembers.
        units: usize,
        /// Steps through which gradients flow back.
        #[serde(default = "usual_window")]
        window: usize,
    },
}

fn usual_window() -> usize {
    16
}

/// Most steps through which gradients flow back.
const MAX_WINDOW: usize = 4096;

impl Recurrence {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Limit`] for units or windows out of range.
    pub fn validate(&self) -> Result<()> {
        let Self::Gru { units, window } = self;
        if !(1..=MAX_WINDOW).contains(window) {
            let limit = format!("1 to {MAX_WINDOW}");
            return Err(Error::limit("memory.window", window, limit, "16 to 64 steps are usual."));
        }
        Gru::new(0, *units).map(drop)
    }

    /// Numbers that are remembered.
    pub fn units(&self) -> usize {
        let Self::Gru { units, .. } = self;
        *units
    }

    /// Steps through which gradients flow back.
    pub fn window(&self) -> usize {
        let Self::Gru { window, .. } = self;
        *window
    }
}
