//! What a trajectory is to keep small, and what is to hold along it.

use autodiff::Scalar;

/// Numbers of a stage.
#[derive(Debug, Clone, Copy)]
pub struct StageInput<'a, S> {
    /// x, `[n_state]` of the system.
    pub state: &'a [S],
    /// u, `[n_input]`; empty at the end.
    pub input: &'a [S],
    /// What the problem says of this stage, [`OptimalCost::n_parameter`] numbers: references, weights.
    pub parameters: &'a [S],
}

/// What a trajectory costs, stage by stage: Σₖ ℓ(xₖ, uₖ, pₖ) + ℓ_N(x_N, p_N), and what is to hold in every stage.
///
/// It is written once, over any scalar and without branches on values, like a [`System`](autodiff::System). It is recorded once, and its
/// gradient and Hessian are derived from the recording: exact, in the error coordinates of the state. As many terms and conditions are
/// given in every stage; one that is to count in some stages alone has a weight or a bound among the parameters.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::Scalar;
/// use omnidrones::controllers::optimal::{OptimalCost, StageInput, Terms};
///
/// /// To a place, gently, above the ground.
/// struct Arrive;
/// impl OptimalCost for Arrive {
///     fn n_parameter(&self) -> usize {
///         3
///     }
///     fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>) {
///         now.input.iter().for_each(|u| terms.square(S::constant(0.1), *u));
///         terms.at_most_zero(-now.state[2]);
///     }
///     fn terminal<S: Scalar>(&self, end: StageInput<'_, S>, terms: &mut Terms<S>) {
///         (0..3).for_each(|k| terms.square(S::constant(100.0), end.state[k] - end.parameters[k]));
///     }
/// }
/// ```
pub trait OptimalCost: Sync {
    /// Numbers of a stage that it reads beside state and input; by default none.
    fn n_parameter(&self) -> usize {
        0
    }
    /// Terms of a stage.
    fn stage<S: Scalar>(&self, now: StageInput<'_, S>, terms: &mut Terms<S>);
    /// Terms of the end; by default none.
    fn terminal<S: Scalar>(&self, _end: StageInput<'_, S>, _terms: &mut Terms<S>) {}
}

/// Where a cost puts its terms.
#[derive(Debug, Clone)]
pub struct Terms<S> {
    /// (w, r) of ½ w r².
    pub(super) squares: Vec<(S, S)>,
    pub(super) sum: S,
    /// g ≤ 0.
    pub(super) at_most: Vec<S>,
    /// h = 0.
    pub(super) zeros: Vec<S>,
}

impl<S: Scalar> Terms<S> {
    /// None yet.
    pub(super) fn none() -> Self {
        Self { squares: Vec::new(), sum: S::zero(), at_most: Vec::new(), zeros: Vec::new() }
    }

    /// ½ w r². Its curvature is taken as w r'r'ᵀ (Gauss and Newton), which is never negative; the weight may depend on parameters alone.
    pub fn square(&mut self, weight: S, residual: S) {
        self.squares.push((weight, residual));
    }

    /// Any other cost, with its exact curvature. Where that is negative in the inputs, what the future costs has to outweigh it.
    pub fn add(&mut self, cost: S) {
        self.sum += cost;
    }

    /// A condition g ≤ 0.
    pub fn at_most_zero(&mut self, g: S) {
        self.at_most.push(g);
    }

    /// A condition h = 0.
    pub fn zero(&mut self, h: S) {
        self.zeros.push(h);
    }

    pub(super) fn n_condition(&self) -> usize {
        self.at_most.len() + self.zeros.len()
    }
}
