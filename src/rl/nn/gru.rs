//! A gated recurrent unit (Cho et al. 2014), one step of it: what is seen and what is remembered in, what is remembered out.
//!
//! ```text
//! r = σ(W_r x + b_r + U_r h + c_r)
//! z = σ(W_z x + b_z + U_z h + c_z)
//! n = tanh(W_n x + b_n + r ∘ (U_n h + c_n))
//! h′ = (1 − z) ∘ n + z ∘ h
//! ```
//!
//! The reset gate stands behind the product with U_n, as in cuDNN and PyTorch: one product for all gates. Tensors have the
//! names, shapes and order of gates (r, z, n) that they have there.

use super::activation::tanh;
use super::aligned::Aligned;
use super::elementwise::add_rows;
use super::graph::{LayerGraph, LayerKind, ValueSpan};
use super::init::Init;
use super::network::{Level, Memory, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use super::product::{Begin, Left, padded, product};
use autodiff::lanes::{Kernel, Lanes, dispatch};
use base::error::{Error, Result};
use rng::Stream;
use std::ops::Range;

/// Most numbers that a memory sees.
const MAX_SEEN: usize = 1 << 20;
/// Most weights.
const MAX_WEIGHTS: usize = 1 << 25;
/// Most units of a memory.
pub(super) const MAX_UNITS: usize = 2048;

/// The shape of a gated recurrent unit: rows `[x, h]` to rows `[h′]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gru {
    /// Numbers that it sees.
    n_seen: usize,
    /// Numbers that it remembers.
    n_unit: usize,
}

/// Gates of a unit: r, z, n.
const GATES: usize = 3;

impl Gru {
    /// For `n_seen` numbers seen and `n_unit` remembered.
    ///
    /// # Errors
    /// [`Error::Limit`] unless there are 1 to 2048 units, and for more than 2²⁰ numbers seen or 2²⁵ weights.
    pub fn new(n_seen: usize, n_unit: usize) -> Result<Self> {
        if !(1..=MAX_UNITS).contains(&n_unit) {
            let limit = format!("1 to {MAX_UNITS}");
            return Err(Error::limit("memory.units", n_unit, limit, "32 to 256 are usual."));
        }
        if n_seen > MAX_SEEN {
            let remedy = "Put an encoder before the memory.";
            return Err(Error::limit("numbers that a memory sees", n_seen, MAX_SEEN, remedy));
        }
        let own = Self { n_seen, n_unit };
        if own.n_parameter() > MAX_WEIGHTS {
            let remedy = "Take fewer units, or put an encoder before the memory.";
            return Err(Error::limit("weights of a memory", own.n_parameter(), MAX_WEIGHTS, remedy));
        }
        Ok(own)
    }

    fn wide(&self) -> usize {
        padded(self.n_unit)
    }

    /// Width of the gates side by side.
    fn gates(&self) -> usize {
        GATES * self.wide()
    }

    /// Places of W, U, b and c.
    fn places(&self) -> [Range<usize>; 4] {
        let mut at = 0;
        [self.n_seen * self.gates(), self.n_unit * self.gates(), self.gates(), self.gates()].map(|n| {
            at += n;
            at - n..at
        })
    }

    /// Where unit `o` of all gates stands in a row.
    fn column(&self, o: usize) -> usize {
        o / self.n_unit * self.wide() + o % self.n_unit
    }
}

/// Levels of the memory: gates, the part of them that comes of h, h, h′.
const OWN: usize = 0;
const OF_STATE: usize = 1;
const STATE: usize = 2;
const NEXT: usize = 3;

impl Network for Gru {
    fn n_input(&self) -> usize {
        self.n_seen + self.n_unit
    }

    fn n_output(&self) -> usize {
        self.n_unit
    }

    fn n_state(&self) -> usize {
        self.n_unit
    }

    fn n_parameter(&self) -> usize {
        (self.n_seen + self.n_unit + 2) * self.gates()
    }

    fn n_activation(&self) -> usize {
        2 * (self.gates() + self.wide())
    }

    fn slots(&self) -> Vec<Slot> {
        let n = GATES * self.n_unit;
        let shapes = [vec![n, self.n_seen], vec![n, self.n_unit], vec![n], vec![n]];
        let named = ["weight_ih", "weight_hh", "bias_ih", "bias_hh"].into_iter().zip(shapes).zip(self.places());
        named.map(|((name, shape), at)| Slot::new(name, shape, at.start, self.n_unit)).collect()
    }

    /// Orthonormal weights of each gate; biases are zero.
    fn init(&self, stream: &mut Stream) -> Vec<f32> {
        let mut parameters = vec![0.0; self.n_parameter()];
        let unit = Init::Orthogonal { hidden: 1.0, last: 1.0 };
        for (slot, n_in) in self.slots().iter().zip([self.n_seen, self.n_unit]) {
            let each = (0..GATES).flat_map(|_| unit.draw(self.n_unit, n_in, false, stream));
            slot.fill(each, &mut parameters);
        }
        parameters
    }

    fn memory(&self, rows: usize) -> Memory {
        let sizes = [self.gates(), self.gates(), self.wide(), self.wide()];
        Memory { levels: sizes.map(|n| Level::of(rows * n)).into(), parts: Vec::new() }
    }

    fn scratch(&self, rows: usize) -> Scratch {
        let [d, before] = [(); 2].map(|()| Aligned::zeros(rows * self.gates()));
        let widest = padded(self.n_seen).max(self.wide());
        Scratch {
            d,
            before,
            more: [widest, self.wide()].map(|n| Aligned::zeros(rows * n)).into(),
            ..Scratch::default()
        }
    }

    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        let [own, of_state, ..] = self.places();
        for (l, (at, n_in)) in [(own, self.n_seen), (of_state, self.n_unit)].into_iter().enumerate() {
            let shape = (n_in, GATES * self.n_unit, self.gates());
            transposed.put(l, &parameters[at], shape, |o| self.column(o));
        }
    }

    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        let (n, wide, gates, stride) = (self.n_unit, self.wide(), self.gates(), self.n_input());
        let [w, u, b, c] = self.places().map(|at| &parameters[at]);
        let [own, of_state, state, next] = &mut memory.levels[..] else {
            unreachable!("the memory of another network")
        };
        for (h, row) in state.y.chunks_exact_mut(wide).zip(x.chunks_exact(stride)).take(rows) {
            h[..n].copy_from_slice(&row[self.n_seen..]);
        }
        product(Left::Rows(x, stride), w, Begin::With(b), &mut own.y[..rows * gates], (rows, self.n_seen, gates));
        product(Left::Rows(&state.y, wide), u, Begin::With(c), &mut of_state.y[..rows * gates], (rows, n, gates));
        let (own, of_state) = (&mut own.y[..rows * gates], &of_state.y);
        dispatch(Step { own, of_state, state: &state.y, next: &mut next.y, wide });
        Output::new(&memory.levels[NEXT].y[..rows * wide], n, wide)
    }

    fn backward(&self, net: Weights<'_>, x: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        let (n, wide, gates, stride) = (self.n_unit, self.wide(), self.gates(), self.n_input());
        let Scratch { d, before, more, .. } = pass.scratch;
        let [grad_seen, grad_state] = &mut more[..] else { unreachable!("the scratch of another network") };
        for (to, own) in grad_state.chunks_exact_mut(wide).zip(grad_output.chunks_exact(n)).take(rows) {
            to[..n].copy_from_slice(own);
            to[n..].fill(0.0);
        }
        let [own, of_state, state] = [OWN, OF_STATE, STATE].map(|l| &memory.levels[l].y);
        let (d, d_state) = (&mut d[..rows * gates], &mut before[..rows * gates]);
        dispatch(Pull { own, of_state, state, d, d_state, grad: grad_state, wide });
        if !pass.gradient.is_empty() {
            let [w, u, b, c] = self.places();
            add_rows(&mut pass.gradient[b], d, rows);
            add_rows(&mut pass.gradient[c], d_state, rows);
            product(Left::Columns(x, stride), d, Begin::Add, &mut pass.gradient[w], (self.n_seen, rows, gates));
            product(Left::Columns(state, wide), d_state, Begin::Add, &mut pass.gradient[u], (n, rows, gates));
        }
        if pass.grad_input.is_empty() {
            return;
        }
        // gates stand without gaps where weights are transposed
        let tall = padded(self.n_seen);
        for gate in 0..GATES {
            let begin = if gate == 0 { Begin::Zero } else { Begin::Add };
            let of = |l: usize, tall: usize| &net.transposed[l][gate * n * tall..];
            product(Left::Rows(&d[gate * wide..], gates), of(0, tall), begin, grad_seen, (rows, n, tall));
            product(Left::Rows(&d_state[gate * wide..], gates), of(1, wide), Begin::Add, grad_state, (rows, n, wide));
        }
        for (k, to) in pass.grad_input.chunks_exact_mut(stride).enumerate().take(rows) {
            let (seen, kept) = to.split_at_mut(self.n_seen);
            seen.copy_from_slice(&grad_seen[k * tall..][..self.n_seen]);
            kept.copy_from_slice(&grad_state[k * wide..][..n]);
        }
    }

    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, h: &ValueSpan) -> [ValueSpan; 2] {
        let mut tensors = self.parts(parameters).into_iter().map(|tensor| tensor.data);
        let [weight_ih, weight_hh, bias_ih, bias_hh] = [(); 4].map(|()| tensors.next().unwrap_or_default());
        let kind = LayerKind::Gru { weight_ih, weight_hh, bias_ih, bias_hh };
        [ValueSpan::NONE, graph.add(kind, 1, self.n_unit, vec![x.clone(), h.clone()])]
    }
}

/// σ(x) = ½ + ½ tanh(x/2).
#[inline(always)]
fn sigmoid<L: Lanes>(x: L) -> L {
    let half = L::constant(0.5);
    half.mul_add(tanh(x * half), half)
}

/// Gates and h′ of every row.
struct Step<'a> {
    own: &'a mut [f32],
    of_state: &'a [f32],
    state: &'a [f32],
    next: &'a mut [f32],
    wide: usize,
}

impl Kernel for Step<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { own, of_state, state, next, wide } = self;
        for (k, own) in own.chunks_exact_mut(GATES * wide).enumerate() {
            let (of_state, row) = (&of_state[k * GATES * wide..], k * wide);
            for at in (0..wide).step_by(L::WIDTH) {
                let gate = |g: usize, own: &[f32]| L::load(&own[g * wide + at..]);
                let reset = sigmoid(gate(0, own) + gate(0, of_state));
                let keep = sigmoid(gate(1, own) + gate(1, of_state));
                let new = tanh(reset.mul_add(gate(2, of_state), gate(2, own)));
                let h = L::load(&state[row + at..]);
                keep.mul_add(h - new, new).store(&mut next[row + at..]);
                reset.store(&mut own[at..]);
                keep.store(&mut own[wide + at..]);
                new.store(&mut own[2 * wide + at..]);
            }
        }
    }
}

/// Gradients of the gates before their functions, in x's part and in h's, and of h where it passes the gates by.
struct Pull<'a> {
    own: &'a [f32],
    of_state: &'a [f32],
    state: &'a [f32],
    d: &'a mut [f32],
    d_state: &'a mut [f32],
    /// That of h′, then that of h.
    grad: &'a mut [f32],
    wide: usize,
}

impl Kernel for Pull<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { own, of_state, state, d, d_state, grad, wide } = self;
        for (k, d) in d.chunks_exact_mut(GATES * wide).enumerate() {
            let (first, row) = (k * GATES * wide, k * wide);
            for at in (0..wide).step_by(L::WIDTH) {
                let gate = |g: usize| L::load(&own[first + g * wide + at..]);
                let (reset, keep, new, one) = (gate(0), gate(1), gate(2), L::one());
                let (up, h) = (L::load(&grad[row + at..]), L::load(&state[row + at..]));
                let d_new = up * (one - keep) * (-new).mul_add(new, one);
                let d_keep = up * (h - new) * keep * (one - keep);
                let d_reset = d_new * L::load(&of_state[first + 2 * wide + at..]) * reset * (one - reset);
                d_reset.store(&mut d[at..]);
                d_keep.store(&mut d[wide + at..]);
                d_new.store(&mut d[2 * wide + at..]);
                d_reset.store(&mut d_state[first + at..]);
                d_keep.store(&mut d_state[first + wide + at..]);
                (d_new * reset).store(&mut d_state[first + 2 * wide + at..]);
                (up * keep).store(&mut grad[row + at..]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::exact::{draw, gradients_are_differences};
    use super::*;

    /// h′ in f64, from the named parts, by the formulas above.
    fn exact(parts: &[(String, Vec<f64>)], x: &[f64], n_seen: usize, n: usize) -> Vec<f64> {
        let of = |name: &str| &parts.iter().find(|part| part.0 == name).unwrap().1;
        let (seen, h) = x.split_at(n_seen);
        let sum = |w: &[f64], o: usize, x: &[f64]| (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
        let own = |o: usize| sum(of("weight_ih"), o, seen) + of("bias_ih")[o];
        let kept = |o: usize| sum(of("weight_hh"), o, h) + of("bias_hh")[o];
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let next = |i: usize| {
            let (r, z) = (sigmoid(own(i) + kept(i)), sigmoid(own(n + i) + kept(n + i)));
            let new = (own(2 * n + i) + r * kept(2 * n + i)).tanh();
            (1.0 - z) * new + z * h[i]
        };
        (0..n).map(next).collect()
    }

    #[test]
    fn gradients_of_a_step_are_differences_of_the_same_unit_in_f64() {
        for (n_seen, n, rows) in [(5, 7, 6), (3, 16, 13), (18, 20, 3)] {
            let gru = Gru::new(n_seen, n).unwrap();
            let worst = gradients_are_differences(&gru, rows, &|parts, x| exact(parts, x, n_seen, n));
            println!("{n_seen} {n}: {worst:?}");
            assert!(worst[0] < 1e-6 && worst[1] < 2e-6, "{worst:?}"); // measured at most 2.2e-7, 4.2e-7
        }
    }

    #[test]
    fn rows_do_not_depend_on_their_number_and_what_is_remembered_stays_within_one() {
        let (gru, rows) = (Gru::new(9, 12).unwrap(), 33);
        let (p, x) = (draw(gru.n_parameter(), 1), draw(rows * gru.n_input(), 2));
        let x: Vec<f32> = x.iter().map(|x| x.clamp(-1.0, 1.0)).collect();
        let mut memory = gru.memory(rows);
        let mut all = vec![0.0; rows * 12];
        gru.forward(&p, &x, rows, &mut memory).write(&mut all);
        for r in 0..rows {
            let one = gru.forward(&p, &x[r * 21..][..21], 1, &mut memory);
            assert_eq!(one.row(0), &all[r * 12..][..12], "row {r}");
        }
        assert!(all.iter().all(|h| h.abs() <= 1.0));
    }

    #[test]
    fn a_memory_of_no_units_and_of_too_many_is_refused() {
        for (n, side) in [(0, "below"), (MAX_UNITS + 1, "over")] {
            let error = Gru::new(4, n).unwrap_err().to_string();
            assert!(error.starts_with(&format!("memory.units is {n}, {side} the limit of 1 to 2048")), "{error}");
        }
    }
}
