//! The value of a team from those of its agents: their sum, or a network that is monotone in each.
//!
//! QMIX (Rashid et al. 2018): Q = Σᵤ |w₂ᵤ(s)| elu(Σᵢ |W₁ᵢᵤ(s)| qᵢ + b₁ᵤ(s)) + b₂(s). All of W₁, b₁, w₂ and b₂ are outputs of one
//! network of the state. As no weight is negative, the best action of each agent is the best of the team.

use super::config::ValueMixer;
use crate::nn::{Activation, Layers, Mlp};
use base::error::Result;

/// Shape of a mixer.
#[derive(Debug, Clone)]
pub struct Mixing {
    agents: usize,
    units: usize,
    /// From the state to weights; none for a sum.
    pub weights: Option<Mlp>,
}

impl Mixing {
    /// For `agents` agents and `n_state` numbers of the state; none where every agent learns for itself.
    ///
    /// # Errors
    /// As `Mlp::new`.
    pub fn new(mixer: ValueMixer, agents: usize, n_state: usize) -> Result<Option<Self>> {
        Ok(match mixer {
            ValueMixer::None => None,
            ValueMixer::Sum => Some(Self { agents, units: 0, weights: None }),
            ValueMixer::Monotone { units, hidden } => {
                let layers = Layers { hidden: vec![hidden], ..Layers::elu(0.5) };
                let n_output = agents * units + 2 * units + 1;
                let weights = Mlp::new(n_state, &layers, n_output, Activation::Identity)?;
                Some(Self { agents, units, weights: Some(weights) })
            }
        })
    }

    /// Weight of agent `i` in unit `u`, bias of the unit, its weight; then the bias of all.
    fn place(&self, u: usize) -> [usize; 3] {
        [self.agents * u, self.agents * self.units + u, (self.agents + 1) * self.units + u]
    }

    /// The team's value; `weights` are what the network of the state gave, empty for a sum.
    pub fn mix(&self, q: &[f32], weights: &[f32]) -> f32 {
        if weights.is_empty() {
            return q.iter().sum();
        }
        let mut total = weights[weights.len() - 1];
        for u in 0..self.units {
            let [first, bias, own] = self.place(u);
            let inner = (0..self.agents).fold(weights[bias], |sum, i| sum + weights[first + i].abs() * q[i]);
            total += weights[own].abs() * elu(inner);
        }
        total
    }

    /// What becomes of output `k` of the network of the state, by factor and shift, where the team's value is to be factor · Q +
    /// shift: the outer weights and the last bias bear it.
    pub fn moved(&self, k: usize, (factor, shift): (f32, f32)) -> (f32, f32) {
        let [_, _, outer] = self.place(0);
        match k {
            k if k < outer => (1.0, 0.0),
            k if k < outer + self.units => (factor, 0.0),
            _ => (factor, shift),
        }
    }

    /// ∂mix/∂q, and `up` · ∂mix/∂weights.
    pub fn pull(&self, q: &[f32], weights: &[f32], up: f32, grad_q: &mut [f32], grad_weights: &mut [f32]) {
        if weights.is_empty() {
            grad_q.fill(1.0);
            return;
        }
        grad_q.fill(0.0);
        grad_weights[weights.len() - 1] = up;
        for u in 0..self.units {
            let [first, bias, own] = self.place(u);
            let inner = (0..self.agents).fold(weights[bias], |sum, i| sum + weights[first + i].abs() * q[i]);
            let slope = weights[own].abs() * if inner > 0.0 { 1.0 } else { inner.exp() };
            grad_weights[own] = up * weights[own].signum() * elu(inner);
            grad_weights[bias] = up * slope;
            for i in 0..self.agents {
                grad_q[i] += slope * weights[first + i].abs();
                grad_weights[first + i] = up * slope * weights[first + i].signum() * q[i];
            }
        }
    }
}

/// x above 0, eˣ − 1 below.
fn elu(x: f32) -> f32 {
    if x > 0.0 { x } else { x.exp_m1() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    fn monotone() -> Mixing {
        Mixing::new(ValueMixer::Monotone { units: 5, hidden: 8 }, 3, 4).unwrap().unwrap()
    }

    #[test]
    fn a_monotone_mixer_rises_with_every_agent_and_its_gradients_are_those_of_differences() {
        let (mixing, mut stream) = (monotone(), Stream::new(1, 0, 0, Purpose::LEARNING));
        let n = mixing.weights.as_ref().unwrap().n_output();
        let (mut worst, mut least): (f32, f32) = (0.0, f32::INFINITY);
        for _ in 0..100 {
            let mut own = |n: usize| (0..n).map(|_| stream.normal() as f32).collect::<Vec<_>>();
            let (q, mut weights) = (own(3), own(n));
            // |w| has a kink, which a difference must not step over
            weights.iter_mut().for_each(|w| *w += 0.01 * w.signum());
            let (mut grad_q, mut grad_weights) = (vec![0.0; 3], vec![0.0; n]);
            mixing.pull(&q, &weights, 1.0, &mut grad_q, &mut grad_weights);
            let of = |x: &[f32]| mixing.mix(&x[..3], &x[3..]);
            let (x, got) = ([q, weights].concat(), [grad_q.clone(), grad_weights].concat());
            for k in 0..x.len() {
                let (mut up, mut down) = (x.clone(), x.clone());
                up[k] += 1e-3;
                down[k] -= 1e-3;
                let difference = (of(&up) - of(&down)) / (up[k] - down[k]);
                worst = worst.max((difference - got[k]).abs() / (1.0 + got[k].abs()));
            }
            least = grad_q.iter().fold(least, |least, g| least.min(*g));
        }
        // 3e-3 at most, the kink of elu within the step
        assert!(worst < 2e-2 && least >= 0.0, "{worst} {least}");
    }

    #[test]
    fn a_sum_is_a_sum() {
        let mixing = Mixing::new(ValueMixer::Sum, 3, 4).unwrap().unwrap();
        let mut grad = [0.0; 3];
        mixing.pull(&[1.0, 2.0, 3.0], &[], 0.5, &mut grad, &mut []);
        assert_eq!((mixing.mix(&[1.0, 2.0, 3.0], &[]), grad), (6.0, [1.0; 3]));
    }
}
