//! What is seen of several alike, whichever of them comes first: φ of each, then their mean or largest (Zaheer et al. 2017).

use super::aligned::Aligned;
use super::graph::{LayerGraph, LayerKind, ValueSpan};
use super::mlp::Mlp;
use super::network::{Level, Memory, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use super::product::padded;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// What is kept of all members.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pool {
    /// The mean of each number.
    #[default]
    Mean,
    /// The largest of each number.
    Max,
}

/// Most members.
const MAX_MEMBERS: usize = 4096;

/// The shape of an encoder of sets: rows `[members, n]` to rows of φ's numbers, the same for any order of the members.
#[derive(Debug, Clone, PartialEq)]
pub struct Set {
    phi: Mlp,
    n_member: usize,
    pool: Pool,
}

impl Set {
    /// Of `n_member` members, each through `phi`.
    ///
    /// # Errors
    /// [`Error::Limit`] unless there are 1 to 4096 members.
    pub fn new(n_member: usize, phi: Mlp, pool: Pool) -> Result<Self> {
        if !(1..=MAX_MEMBERS).contains(&n_member) {
            let limit = format!("1 to {MAX_MEMBERS}");
            return Err(Error::limit("members of a set", n_member, limit, "Give the number of the others."));
        }
        Ok(Self { phi, n_member, pool })
    }

    fn wide(&self) -> usize {
        padded(self.phi.n_output())
    }
}

impl Network for Set {
    fn n_input(&self) -> usize {
        self.n_member * self.phi.n_input()
    }

    fn n_output(&self) -> usize {
        self.phi.n_output()
    }

    fn n_parameter(&self) -> usize {
        self.phi.n_parameter()
    }

    fn n_activation(&self) -> usize {
        self.n_member * self.phi.n_activation() + self.wide()
    }

    fn slots(&self) -> Vec<Slot> {
        self.phi.slots()
    }

    fn init(&self, stream: &mut Stream) -> Vec<f32> {
        self.phi.init(stream)
    }

    fn memory(&self, rows: usize) -> Memory {
        Memory { levels: vec![Level::of(rows * self.wide())], parts: vec![self.phi.memory(rows * self.n_member)] }
    }

    fn scratch(&self, rows: usize) -> Scratch {
        let rows = rows * self.n_member;
        let up = Aligned::zeros(rows * self.phi.n_output());
        Scratch { d: up, parts: vec![self.phi.scratch(rows)], ..Scratch::default() }
    }

    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        self.phi.transpose(parameters, transposed);
    }

    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, _: &ValueSpan) -> [ValueSpan; 2] {
        let all = self.phi.describe_rows(parameters, graph, self.n_member, x);
        [graph.add(LayerKind::Pool(self.pool), self.n_member, self.phi.n_output(), vec![all]), ValueSpan::NONE]
    }

    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        let (n, wide) = (self.phi.n_output(), self.wide());
        let all = self.phi.forward(parameters, x, rows * self.n_member, &mut memory.parts[0]);
        for (k, to) in memory.levels[0].y.chunks_exact_mut(wide).enumerate().take(rows) {
            let to = &mut to[..n];
            to.copy_from_slice(all.row(k * self.n_member));
            for member in 1..self.n_member {
                let own = all.row(k * self.n_member + member);
                match self.pool {
                    Pool::Mean => to.iter_mut().zip(own).for_each(|(to, own)| *to += own),
                    Pool::Max => to.iter_mut().zip(own).for_each(|(to, own)| *to = to.max(*own)),
                }
            }
            if self.pool == Pool::Mean {
                let share = 1.0 / self.n_member as f32;
                to.iter_mut().for_each(|to| *to *= share);
            }
        }
        Output::new(&memory.levels[0].y[..rows * wide], n, wide)
    }

    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        let (n, wide, members) = (self.phi.n_output(), self.wide(), self.n_member);
        let Scratch { d, parts, .. } = pass.scratch;
        let given = Output::new(memory.parts[0].levels.last().map_or(&[][..], |level| &level.y), n, wide);
        for (k, up) in grad_output.chunks_exact(n).enumerate().take(rows) {
            let own = &mut d[k * members * n..][..members * n];
            match self.pool {
                Pool::Mean => {
                    let share = 1.0 / members as f32;
                    own.chunks_exact_mut(n).for_each(|d| d.iter_mut().zip(up).for_each(|(d, up)| *d = share * up));
                }
                Pool::Max => {
                    own.fill(0.0);
                    for i in 0..n {
                        let of = |member: usize| given.row(k * members + member)[i];
                        // the first of the largest
                        let first = (1..members).fold(0, |most, m| if of(m) > of(most) { m } else { most });
                        own[first * n + i] = up[i];
                    }
                }
            }
        }
        let all = rows * members;
        let pass = Pass { gradient: pass.gradient, grad_input: pass.grad_input, scratch: &mut parts[0] };
        self.phi.backward(net, x, all, &memory.parts[0], &d[..all * n], pass);
    }
}

#[cfg(test)]
mod tests {
    use super::super::activation::Activation;
    use super::super::exact::{Exact, draw, gradients_are_differences};
    use super::super::mlp::Layers;
    use super::*;

    fn set(pool: Pool) -> Set {
        let layers = Layers { hidden: vec![9], ..Layers::default() };
        Set::new(4, Mlp::new(5, &layers, 6, Activation::Tanh).unwrap(), pool).unwrap()
    }

    fn exact(parts: &Exact, x: &[f64], pool: Pool) -> Vec<f64> {
        let layer = |l: usize, x: &[f64]| -> Vec<f64> {
            let (w, b) = (&parts[2 * l].1, &parts[2 * l + 1].1);
            let sum = |o: usize| b[o] + (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
            (0..b.len()).map(|o| sum(o).tanh()).collect()
        };
        let each: Vec<Vec<f64>> = x.chunks_exact(5).map(|x| layer(1, &layer(0, x))).collect();
        let of = |i: usize| match pool {
            Pool::Mean => each.iter().map(|y| y[i]).sum::<f64>() / 4.0,
            Pool::Max => each.iter().map(|y| y[i]).fold(f64::NEG_INFINITY, f64::max),
        };
        (0..6).map(of).collect()
    }

    #[test]
    fn gradients_are_differences_of_the_same_set_in_f64() {
        for pool in [Pool::Mean, Pool::Max] {
            let worst = gradients_are_differences(&set(pool), 3, &|parts, x| exact(parts, x, pool));
            println!("{pool:?}: {worst:?}");
            assert!(worst[0] < 1e-6 && worst[1] < 2e-6, "{worst:?}"); // measured at most 1.3e-7, 2.6e-7
        }
    }

    #[test]
    fn the_order_of_members_changes_nothing_but_the_rounding_of_their_sum() {
        for (pool, bound) in [(Pool::Mean, 1e-7), (Pool::Max, 0.0)] {
            let set = set(pool);
            let (p, x) = (draw(set.n_parameter(), 1), draw(set.n_input(), 2));
            let mut memory = set.memory(1);
            let first = set.forward(&p, &x, 1, &mut memory).row(0).to_vec();
            let mut orders = 0;
            for order in [[1, 0, 2, 3], [3, 2, 1, 0], [2, 3, 0, 1]] {
                let moved: Vec<f32> = order.iter().flat_map(|m| x[m * 5..][..5].to_vec()).collect();
                let other = set.forward(&p, &moved, 1, &mut memory).row(0);
                let far = first.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(far <= bound, "{pool:?} {order:?}: {far:e}"); // measured at most 6e-8, 0
                orders += 1;
            }
            let mut other = x.clone();
            other[0] += 1.0;
            assert!(
                set.forward(&p, &other, 1, &mut memory).row(0) != &first[..] && orders == 3,
                "and it looks at them"
            );
        }
    }

    #[test]
    fn a_set_of_none_is_refused() {
        let phi = Mlp::new(5, &Layers::default(), 6, Activation::Tanh).unwrap();
        assert!(Set::new(0, phi, Pool::Mean).unwrap_err().to_string().starts_with("members of a set is 0"));
    }
}
