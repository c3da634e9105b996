//! The student: the part of a policy that imitates.

use super::ImitationTarget;
use crate::nn::{Network, Weights, last_encoder};
use crate::policy::Actor;
use base::error::Result;
use std::ops::Range;
use std::sync::Arc;

/// All of it, or its last encoder.
pub(super) struct Student {
    /// What learns.
    pub network: Arc<dyn Network>,
    /// What it reads of an observation.
    pub columns: Range<usize>,
    /// Its parameters among the policy's.
    pub place: Range<usize>,
    /// Which encoder it is; none if it is the whole policy.
    encoder: Option<usize>,
}

impl Student {
    /// # Errors
    /// As [`last_encoder`], where that learns.
    pub(super) fn new(actor: &Actor, imitate: ImitationTarget) -> Result<Self> {
        let network = &actor.mlp;
        if imitate == ImitationTarget::Action {
            let (columns, place) = (0..network.n_input(), 0..network.n_parameter());
            return Ok(Self { network: network.clone(), columns, place, encoder: None });
        }
        let (stack, last) = last_encoder(&**network)?;
        let own = &stack.encoders()[last];
        let (network, columns, place) = (own.network.clone(), own.columns.clone(), stack.encoder_place(last));
        Ok(Self { network, columns, place, encoder: Some(last) })
    }

    /// Its numbers, of those of the whole policy.
    pub(super) fn weights<'a>(&self, actor: &Actor, net: Weights<'a>) -> Weights<'a> {
        match (self.encoder, actor.mlp.as_stack()) {
            (Some(k), Some(stack)) => stack.encoder_weights(net, k),
            _ => net,
        }
    }
}
