//! How environments are ruined in tests of containment.

use omnidrones::dynamics::batch::StopReason;

/// Ways to ruin an environment, and what is reported.
#[derive(Debug, Clone, Copy)]
pub enum Poison {
    NanAction,
    /// 1e7 m/s and 1e7 rad/s, which the step squares.
    HugeState,
    /// Over-stiff in every way.
    StiffParameters,
    /// A push of 1e38 N.
    Push,
}

impl Poison {
    pub const ALL: [Self; 4] = [Self::NanAction, Self::HugeState, Self::StiffParameters, Self::Push];

    pub fn reason(self) -> StopReason {
        if matches!(self, Self::NanAction) { StopReason::NonFiniteAction } else { StopReason::Diverged }
    }
}
