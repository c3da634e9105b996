//! The gradient of a sum over some rows of experience, for any network and any loss.
//!
//! Rows are cut into parts of fixed size; each part goes through the network block by block on one thread and has a
//! gradient of its own; parts are folded in order. So a result is the same bits for any number of threads.

use super::nn::elementwise::add;
use super::nn::{Memory, Network, Output, Pass, Scratch, Weights};
use super::policy::ROWS;
use super::shards::within_memory;
use base::error::Result;
use base::parallel::Threads;

/// Rows of a part.
const PART: usize = 4 * ROWS;

/// Figures that a loss may sum up beside its gradient.
pub type Sums = [f64; 8];

/// A loss over a block of up to [`ROWS`] rows.
pub trait BlockLoss: Sync {
    /// For these rows and what the network gave for them: writes ∂loss/∂output (`[rows, n_output]`, zeros before), adds to
    /// the gradient of the extra parameters and to the sums.
    fn block(&self, rows: &[u32], output: Output<'_>, grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums);
}

/// A loss of single rows: (row, output, ∂loss/∂output to be written, gradient of the extra parameters to be added to, sums).
impl<F: Fn(usize, &[f32], &mut [f32], &mut [f32], &mut Sums) + Sync> BlockLoss for F {
    fn block(&self, rows: &[u32], output: Output<'_>, grad_output: &mut [f32], d_extra: &mut [f32], sums: &mut Sums) {
        let n_output = grad_output.len() / rows.len().max(1);
        for (k, row) in rows.iter().enumerate() {
            self(*row as usize, output.row(k), &mut grad_output[k * n_output..][..n_output], d_extra, sums);
        }
    }
}

/// Minibatch `k` of `n`: all differ by one row at most, so that networks with more and with fewer rows take as many steps.
pub fn minibatch(rows: &[u32], k: usize, n: usize) -> &[u32] {
    &rows[k * rows.len() / n..(k + 1) * rows.len() / n]
}

/// Gradients and sums of parts, added up in order.
pub fn fold<'a>(gradient: &mut [f32], parts: impl Iterator<Item = (&'a [f32], Sums)>) -> Sums {
    let mut total = Sums::default();
    gradient.fill(0.0);
    for (own, sums) in parts {
        add(gradient, own);
        total.iter_mut().zip(sums).for_each(|(sum, x)| *sum += x);
    }
    total
}

/// Memory for minibatches of one network.
pub struct Minibatch {
    parts: Vec<NamedTensor>,
    /// The last one's: of the network, then of `n_extra` parameters more.
    pub gradient: Vec<f32>,
}

struct NamedTensor {
    memory: Memory,
    scratch: Scratch,
    x: Vec<f32>,
    grad_output: Vec<f32>,
    gradient: Vec<f32>,
    sums: Sums,
}

impl Minibatch {
    /// For up to `rows` rows.
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) for more than `limit` bytes: every part has a gradient of its own.
    pub fn new(mlp: &dyn Network, n_extra: usize, rows: usize, limit: u64) -> Result<Self> {
        let n = mlp.n_parameter() + n_extra;
        let of_part = n + ROWS * (mlp.n_input() + mlp.n_output() + 2 * mlp.n_activation());
        within_memory("rows of a minibatch", rows, 4 * of_part as u128 * rows.div_ceil(PART) as u128, limit)?;
        let part = || NamedTensor {
            memory: mlp.memory(ROWS),
            scratch: mlp.scratch(ROWS),
            x: vec![0.0; ROWS * mlp.n_input()],
            grad_output: vec![0.0; ROWS * mlp.n_output()],
            gradient: vec![0.0; n],
            sums: Sums::default(),
        };
        Ok(Self { parts: (0..rows.div_ceil(PART)).map(|_| part()).collect(), gradient: vec![0.0; n] })
    }

    /// Σ over the rows `chosen` of `x` (`[_, n_input]`) of ∂loss/∂parameters, into [`Minibatch::gradient`].
    pub fn gradient(
        &mut self,
        threads: &Threads,
        mlp: &dyn Network,
        net: Weights<'_>,
        x: &[f32],
        chosen: &[u32],
        loss: &impl BlockLoss,
    ) -> Sums {
        let n_part = chosen.len().div_ceil(PART);
        threads.for_each(&mut self.parts[..n_part], |k, part| {
            let own = &chosen[k * PART..chosen.len().min((k + 1) * PART)];
            part.gradient.fill(0.0);
            part.sums = Sums::default();
            own.chunks(ROWS).for_each(|rows| part.block(mlp, net, x, rows, loss));
        });
        fold(&mut self.gradient, self.parts[..n_part].iter().map(|part| (&part.gradient[..], part.sums)))
    }
}

impl NamedTensor {
    fn block(&mut self, mlp: &dyn Network, net: Weights<'_>, x: &[f32], rows: &[u32], loss: &impl BlockLoss) {
        let (n_in, n_out, n) = (mlp.n_input(), mlp.n_output(), rows.len());
        for (to, row) in self.x.chunks_exact_mut(n_in).zip(rows) {
            to.copy_from_slice(&x[*row as usize * n_in..][..n_in]);
        }
        let (own, extra) = self.gradient.split_at_mut(mlp.n_parameter());
        let output = mlp.forward(net.parameters, &self.x, n, &mut self.memory);
        let grad_output = &mut self.grad_output[..n * n_out];
        grad_output.fill(0.0);
        loss.block(rows, output, grad_output, extra, &mut self.sums);
        let pass = Pass { gradient: own, grad_input: &mut [], scratch: &mut self.scratch };
        mlp.backward(net, &self.x, n, &self.memory, &self.grad_output, pass);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minibatches_take_every_row_once_and_differ_by_one_at_most() {
        for n_row in [0_u32, 1, 5, 8, 130] {
            let rows: Vec<u32> = (0..n_row).collect();
            for n in [1, 4, 7, 16] {
                let parts: Vec<&[u32]> = (0..n).map(|k| minibatch(&rows, k, n)).collect();
                assert_eq!(parts.concat(), rows);
                let (least, most) = (rows.len() / n, rows.len().div_ceil(n));
                assert!(parts.iter().all(|p| (least..=most).contains(&p.len())), "{n_row} rows in {n}");
            }
        }
    }
}
