//! A network of networks: encoders of parts of what is seen, a memory behind them, a perceptron on top.
//!
//! ```text
//! f  = [what no encoder reads, e₁, e₂, …]   joined by concatenation, or the same with e₁ + e₂ + …
//! h′ = GRU(f, h)                            where there is a memory
//! y  = MLP([f, h′])
//! ```

use super::aligned::Aligned;
use super::graph::{LayerGraph, LayerKind, ValueSpan};
use super::gru::Gru;
use super::mlp::Mlp;
use super::network::{Level, Memory, Network, Output, Pass, Scratch, Slot, Transposed, Weights};
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;

/// What becomes of the outputs of several encoders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Join {
    /// One behind the other.
    #[default]
    Concat,
    /// Added up; all are of one width.
    Sum,
}

impl Join {
    pub(super) fn is_concat(&self) -> bool {
        *self == Self::Concat
    }
}

/// The shape of encoders, memory and perceptron: rows `[x, h]` to rows `[y, h′]`.
#[derive(Debug, Clone)]
pub struct Stack {
    n_seen: usize,
    encoders: Vec<Encoded>,
    join: Join,
    /// Columns that no encoder reads.
    rest: Vec<Range<usize>>,
    memory: Option<Gru>,
    trunk: Mlp,
    /// Parameters of encoders, memory and perceptron.
    places: Vec<Range<usize>>,
}

/// Columns of what is seen, and who reads them.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// Of an input row.
    pub columns: Range<usize>,
    /// From these columns to an encoder's numbers.
    pub network: Arc<dyn Network>,
}

impl Stack {
    /// Of encoders over rows of `n_seen` numbers, a memory of `units` if there is one, and the perceptron that `trunk` makes
    /// for so many numbers in.
    ///
    /// # Errors
    /// [`Error::Value`] for rows or columns of nothing, for columns that are not there or of another width than the encoder's, for
    /// encoders with a memory of their own and for sums of unlike widths; otherwise as [`Gru::new`] and `trunk`.
    pub fn new(
        n_seen: usize,
        encoders: Vec<Encoded>,
        join: Join,
        units: Option<usize>,
        trunk: impl FnOnce(usize) -> Result<Mlp>,
    ) -> Result<Self> {
        for Encoded { columns, network } in &encoders {
            let fits = !columns.is_empty() && columns.end <= n_seen && columns.len() == network.n_input();
            if !fits || network.n_state() > 0 {
                let limit = format!("{} of the {n_seen} that are seen, without a state", network.n_input());
                return Err(Error::value("columns of an encoder", format!("{columns:?}"), limit, "Name a group."));
            }
        }
        if n_seen == 0 {
            return Err(Error::value("numbers that a network sees", n_seen, "≥ 1", "Show it something."));
        }
        let width = |encoded: &Encoded| encoded.network.n_output();
        if join == Join::Sum
            && let Some(odd) = encoders.iter().find(|own| width(own) != width(&encoders[0]))
        {
            let remedy = "Give all encoders as many units, or join = \"concat\".";
            let limit = format!("{}, as the first encoder's, to be added to it", width(&encoders[0]));
            return Err(Error::value("numbers that an encoder gives", width(odd), limit, remedy));
        }
        let mut read = vec![false; n_seen];
        encoders.iter().for_each(|own| read[own.columns.clone()].fill(true));
        let rest = runs(&read);
        let given = match join {
            Join::Concat => encoders.iter().map(width).sum::<usize>(),
            Join::Sum => encoders.first().map_or(0, width),
        };
        let n_feature = rest.iter().map(Range::len).sum::<usize>() + given;
        let memory = units.map(|units| Gru::new(n_feature, units)).transpose()?;
        let trunk = trunk(n_feature + units.unwrap_or(0))?;
        let mut own = Self { n_seen, encoders, join, rest, memory, trunk, places: Vec::new() };
        let mut at = 0;
        let places = own.within().map(|network| {
            at += network.n_parameter();
            at - network.n_parameter()..at
        });
        own.places = places.collect();
        Ok(own)
    }

    /// The encoders.
    pub fn encoders(&self) -> &[Encoded] {
        &self.encoders
    }

    /// Encoder `k` of a network of `net`: its own numbers.
    ///
    /// # Panics
    /// Unless there are so many encoders.
    pub fn encoder_weights<'a>(&self, net: Weights<'a>, k: usize) -> Weights<'a> {
        let (parameters, transposed) = (&net.parameters[self.places[k].clone()], &net.transposed.parts[k]);
        Weights { parameters, transposed }
    }

    /// Where the parameters of encoder `k` stand among all.
    ///
    /// # Panics
    /// Unless there are so many encoders.
    pub fn encoder_place(&self, k: usize) -> Range<usize> {
        self.places[k].clone()
    }

    /// Whether it is the same function as `other` but for what the last encoder reads and how, whatever their weights: `column`
    /// says where a column stands there.
    pub(crate) fn is_alike_but_for_the_last_encoder(
        &self,
        other: &Self,
        column: impl Fn(usize) -> Option<usize>,
    ) -> bool {
        let there = |columns: &Range<usize>| columns.clone().map(&column).collect::<Vec<_>>();
        let here = |columns: &Range<usize>| columns.clone().map(Some).collect::<Vec<_>>();
        let same = |(a, b): (&Encoded, &Encoded)| {
            there(&a.columns) == here(&b.columns) && format!("{:?}", a.network) == format!("{:?}", b.network)
        };
        let (n, memories) = (self.encoders.len(), [self, other].map(Network::n_state));
        n == other.encoders.len()
            && (self.join, memories[0]) == (other.join, memories[1])
            && self.encoders.iter().zip(&other.encoders).take(n.saturating_sub(1)).all(same)
            && self.rest.iter().flat_map(there).eq(other.rest.iter().flat_map(here))
            && self.trunk.has_layers_of(&other.trunk)
    }

    /// Numbers that encoders and what they leave give.
    fn n_feature(&self) -> usize {
        self.trunk.n_input() - self.n_state()
    }

    fn n_rest(&self) -> usize {
        self.rest.iter().map(Range::len).sum()
    }

    /// The networks within: encoders, memory, perceptron.
    fn within(&self) -> impl Iterator<Item = &dyn Network> {
        let encoders = self.encoders.iter().map(|own| &*own.network);
        let memory = self.memory.iter().map(|own| own as &dyn Network);
        encoders.chain(memory).chain([&self.trunk as &dyn Network])
    }

    /// Where the numbers of encoder `k` stand among the features.
    fn place(&self, k: usize) -> usize {
        let before = match self.join {
            Join::Concat => self.encoders[..k].iter().map(|own| own.network.n_output()).sum(),
            Join::Sum => 0,
        };
        self.n_rest() + before
    }
}

/// A network of networks, and which of its encoders is the last.
///
/// # Errors
/// [`Error::Value`] for a network without encoders.
pub(crate) fn last_encoder(network: &dyn Network) -> Result<(&Stack, usize)> {
    let stack = network.as_stack().filter(|stack| !stack.encoders.is_empty());
    let remedy =
        "Give teacher and student network.encoder: the teacher's last reads 'parameters', the student's 'past'.";
    let stack = stack.ok_or_else(|| Error::value("encoders of a policy whose latent is imitated", 0, "≥ 1", remedy))?;
    Ok((stack, stack.encoders.len() - 1))
}

/// Runs of columns that nobody read.
fn runs(read: &[bool]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for at in (0..read.len()).filter(|at| !read[*at]) {
        match runs.last_mut() {
            Some(run) if run.end == at => run.end += 1,
            _ => runs.push(at..at + 1),
        }
    }
    runs
}

/// Levels of the memory: what the perceptron sees, what the GRU sees, what comes out; behind them what each encoder sees.
const TRUNK: usize = 0;
const RECALL: usize = 1;
const OUT: usize = 2;
const ENCODER: usize = 3;

impl Network for Stack {
    fn n_input(&self) -> usize {
        self.n_seen + self.n_state()
    }

    fn n_output(&self) -> usize {
        self.trunk.n_output() + self.n_state()
    }

    fn n_state(&self) -> usize {
        self.memory.as_ref().map_or(0, Network::n_state)
    }

    fn n_parameter(&self) -> usize {
        self.within().map(Network::n_parameter).sum()
    }

    fn n_activation(&self) -> usize {
        let copies = 2 * self.trunk.n_input() + self.n_output() + self.n_seen;
        self.within().map(Network::n_activation).sum::<usize>() + copies
    }

    /// `encoder.0.…`, `memory.…`, and those of the perceptron as if it were alone.
    fn slots(&self) -> Vec<Slot> {
        let n = self.encoders.len();
        let each = self.within().zip(&self.places).enumerate().flat_map(|(k, (own, at))| {
            let name = match k {
                k if k < n => format!("encoder.{k}."),
                k if k + 1 < self.places.len() => "memory.".into(),
                _ => String::new(),
            };
            own.slots().into_iter().map(move |slot| slot.of(&name, at.start))
        });
        each.collect()
    }

    fn init(&self, stream: &mut Stream) -> Vec<f32> {
        self.within().flat_map(|own| own.init(stream)).collect()
    }

    fn memory(&self, rows: usize) -> Memory {
        let recalls = if self.memory.is_some() { [self.trunk.n_input(), self.n_output()] } else { [0; 2] };
        let sizes = [self.trunk.n_input()].into_iter().chain(recalls);
        let sizes = sizes.chain(self.encoders.iter().map(|own| own.columns.len()));
        let levels = sizes.map(|n| Level::of(rows * n)).collect();
        Memory { levels, parts: self.within().map(|own| own.memory(rows)).collect() }
    }

    fn scratch(&self, rows: usize) -> Scratch {
        let widest = |of: fn(&Encoded) -> usize| self.encoders.iter().map(of).max().unwrap_or(0);
        let (given, read) = (widest(|own| own.network.n_output()), widest(|own| own.columns.len()));
        let n = self.trunk.n_input();
        let sizes = [n, n, self.trunk.n_output(), self.n_state(), given, read];
        let more = sizes.map(|n| Aligned::zeros(rows * n)).into();
        Scratch { more, parts: self.within().map(|own| own.scratch(rows)).collect(), ..Scratch::default() }
    }

    fn transpose(&self, parameters: &[f32], transposed: &mut Transposed) {
        transposed.parts.resize_with(self.places.len(), Transposed::default);
        for ((own, at), transposed) in self.within().zip(&self.places).zip(&mut transposed.parts) {
            own.transpose(&parameters[at.clone()], transposed);
        }
    }

    fn describe(&self, parameters: &[f32], graph: &mut LayerGraph, x: &ValueSpan, h: &ValueSpan) -> [ValueSpan; 2] {
        let of = |k: usize| &parameters[self.places[k].clone()];
        let last = self.places.len() - 1;
        let given = self.encoders.iter().enumerate().map(|(k, Encoded { columns, network })| {
            let [given, _] = network.describe(of(k), graph, &x.part(columns.clone()), &ValueSpan::NONE);
            given
        });
        let mut given: Vec<ValueSpan> = given.collect();
        if self.join == Join::Sum && given.len() > 1 {
            given = vec![graph.add(LayerKind::Sum, 1, given[0].len(), given)];
        }
        let features = self.rest.iter().map(|run| x.part(run.clone())).chain(given).collect();
        let features = graph.concat(features);
        let Some(gru) = &self.memory else {
            return self.trunk.describe(of(last), graph, &features, &ValueSpan::NONE);
        };
        let [_, next] = gru.describe(of(last - 1), graph, &features, h);
        let seen = graph.concat(vec![features, next.clone()]);
        let [y, _] = self.trunk.describe(of(last), graph, &seen, &ValueSpan::NONE);
        [y, next]
    }

    fn forward<'m>(&self, parameters: &[f32], x: &[f32], rows: usize, memory: &'m mut Memory) -> Output<'m> {
        let (stride, seen, n) = (self.n_input(), self.n_feature(), self.trunk.n_input());
        let Memory { levels, parts } = memory;
        let own = |k: usize| &parameters[self.places[k].clone()];
        for (x, to) in x.chunks_exact(stride).zip(levels[TRUNK].y.chunks_exact_mut(n)).take(rows) {
            let mut at = 0;
            for run in &self.rest {
                to[at..at + run.len()].copy_from_slice(&x[run.clone()]);
                at += run.len();
            }
        }
        for (k, Encoded { columns, network }) in self.encoders.iter().enumerate() {
            let (before, read) = levels.split_at_mut(ENCODER + k);
            let (joined, read, n_read) = (&mut before[TRUNK].y, &mut read[0].y, columns.len());
            for (x, to) in x.chunks_exact(stride).zip(read.chunks_exact_mut(n_read)).take(rows) {
                to.copy_from_slice(&x[columns.clone()]);
            }
            let given = network.forward(own(k), &read[..rows * n_read], rows, &mut parts[k]);
            let (place, width, adds) = (self.place(k), network.n_output(), k > 0 && self.join == Join::Sum);
            for (row, to) in joined.chunks_exact_mut(n).enumerate().take(rows) {
                let to = &mut to[place..place + width];
                if adds {
                    to.iter_mut().zip(given.row(row)).for_each(|(to, x)| *to += x);
                } else {
                    to.copy_from_slice(given.row(row));
                }
            }
        }
        let last = parts.len() - 1;
        let Some(gru) = &self.memory else {
            return self.trunk.forward(own(last), &levels[TRUNK].y[..rows * n], rows, &mut parts[last]);
        };
        let [joined, recall, out, ..] = &mut levels[..] else { unreachable!("the memory of another network") };
        for ((x, joined), to) in
            x.chunks_exact(stride).zip(joined.y.chunks_exact(n)).zip(recall.y.chunks_exact_mut(n)).take(rows)
        {
            to[..seen].copy_from_slice(&joined[..seen]);
            to[seen..].copy_from_slice(&x[self.n_seen..]);
        }
        let (n_out, n_y) = (self.n_output(), self.trunk.n_output());
        let next = gru.forward(own(last - 1), &recall.y[..rows * n], rows, &mut parts[last - 1]);
        for (row, (to, out)) in joined.y.chunks_exact_mut(n).zip(out.y.chunks_exact_mut(n_out)).enumerate().take(rows) {
            to[seen..].copy_from_slice(next.row(row));
            out[n_y..].copy_from_slice(next.row(row));
        }
        let y = self.trunk.forward(own(last), &joined.y[..rows * n], rows, &mut parts[last]);
        for (row, out) in out.y.chunks_exact_mut(n_out).enumerate().take(rows) {
            out[..n_y].copy_from_slice(y.row(row));
        }
        Output::new(&levels[OUT].y[..rows * n_out], n_out, n_out)
    }

    fn backward(&self, net: Weights<'_>, _: &[f32], rows: usize, memory: &Memory, grad_output: &[f32], pass: Pass<'_>) {
        let Pass { gradient, grad_input, scratch: Scratch { more, parts, .. } } = pass;
        let [joined, recalled, d_y, d_next, given, read] = &mut more[..] else {
            unreachable!("the scratch of another network")
        };
        let (stride, seen, n, last) = (self.n_input(), self.n_feature(), self.trunk.n_input(), parts.len() - 1);
        let own = |k: usize| Weights {
            parameters: &net.parameters[self.places[k].clone()],
            transposed: &net.transposed.parts[k],
        };
        let learns = !gradient.is_empty();
        let place = |k: usize| if learns { self.places[k].clone() } else { 0..0 };
        let (n_y, n_out) = (self.trunk.n_output(), self.n_output());
        for (row, up) in grad_output.chunks_exact(n_out).enumerate().take(rows) {
            d_y[row * n_y..][..n_y].copy_from_slice(&up[..n_y]);
            d_next[row * (n_out - n_y)..][..n_out - n_y].copy_from_slice(&up[n_y..]);
        }
        let pass = Pass {
            gradient: &mut gradient[place(last)],
            grad_input: &mut joined[..rows * n],
            scratch: &mut parts[last],
        };
        self.trunk.backward(
            own(last),
            &memory.levels[TRUNK].y[..rows * n],
            rows,
            &memory.parts[last],
            &d_y[..rows * n_y],
            pass,
        );
        if let Some(gru) = &self.memory {
            let units = n - seen;
            for (d_next, joined) in d_next.chunks_exact_mut(units).zip(joined.chunks_exact(n)).take(rows) {
                d_next.iter_mut().zip(&joined[seen..]).for_each(|(d, own)| *d += own);
            }
            let scratch = &mut parts[last - 1];
            let pass =
                Pass { gradient: &mut gradient[place(last - 1)], grad_input: &mut recalled[..rows * n], scratch };
            let (x, memory) = (&memory.levels[RECALL].y[..rows * n], &memory.parts[last - 1]);
            gru.backward(own(last - 1), x, rows, memory, &d_next[..rows * units], pass);
            for (joined, recalled) in joined.chunks_exact_mut(n).zip(recalled.chunks_exact(n)).take(rows) {
                joined[..seen].iter_mut().zip(recalled).for_each(|(d, own)| *d += own);
            }
        }
        let wanted = !grad_input.is_empty();
        if wanted {
            for (k, to) in grad_input.chunks_exact_mut(stride).enumerate().take(rows) {
                to[..self.n_seen].fill(0.0);
                to[self.n_seen..].copy_from_slice(&recalled[k * n..][..n][seen..][..stride - self.n_seen]);
                let mut at = k * n;
                for run in &self.rest {
                    to[run.clone()].copy_from_slice(&joined[at..at + run.len()]);
                    at += run.len();
                }
            }
        }
        for (k, Encoded { columns, network }) in self.encoders.iter().enumerate() {
            let (first, width, n_read) = (self.place(k), network.n_output(), columns.len());
            for (to, joined) in given.chunks_exact_mut(width).zip(joined.chunks_exact(n)).take(rows) {
                to.copy_from_slice(&joined[first..first + width]);
            }
            let (x, memory) = (&memory.levels[ENCODER + k].y[..rows * n_read], &memory.parts[k]);
            let read = &mut read[..if wanted { rows * n_read } else { 0 }];
            let pass = Pass { gradient: &mut gradient[place(k)], grad_input: read, scratch: &mut parts[k] };
            network.backward(own(k), x, rows, memory, &given[..rows * width], pass);
            for (to, read) in grad_input.chunks_exact_mut(stride).zip(read.chunks_exact(n_read)) {
                to[columns.clone()].iter_mut().zip(read).for_each(|(to, d)| *to += d);
            }
        }
    }

    fn as_stack(&self) -> Option<&Self> {
        Some(self)
    }

    fn saturated(&self, memory: &Memory, rows: usize, limit: f32) -> f64 {
        self.trunk.saturated(&memory.parts[memory.parts.len() - 1], rows, limit)
    }

    fn bias_for(&self, y: f64) -> f64 {
        self.trunk.bias_for(y)
    }
}

#[cfg(test)]
mod tests {
    use super::super::activation::Activation;
    use super::super::conv::{Conv, Filter};
    use super::super::exact::{draw, gradients_are_differences};
    use super::super::init::Init;
    use super::super::mlp::Layers;
    use super::super::set::{Pool, Set};
    use super::*;

    fn mlp(n_in: usize, hidden: &[usize], n_out: usize) -> Mlp {
        let layers = Layers { hidden: hidden.into(), ..Layers::default() };
        Mlp::new(n_in, &layers, n_out, Activation::Tanh).unwrap()
    }

    /// A history of 4 steps of 3, then two numbers, a set of 3 members of 2, one number more.
    fn stack(join: Join, units: Option<usize>) -> Stack {
        let filter = Filter { channels: if join == Join::Sum { 2 } else { 5 }, kernel: 3, stride: 1 };
        let conv = Conv::along(4, 3, &[filter], Activation::Tanh, Init::default()).unwrap();
        let set = Set::new(3, mlp(2, &[6], 4), Pool::Mean).unwrap();
        let encoders = vec![
            Encoded { columns: 0..12, network: Arc::new(conv) },
            Encoded { columns: 14..20, network: Arc::new(set) },
        ];
        Stack::new(21, encoders, join, units, |n| Ok(mlp(n, &[8], 3))).unwrap()
    }

    fn layer(w: &[f64], b: &[f64], x: &[f64]) -> Vec<f64> {
        let sum = |o: usize| b[o] + (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
        (0..b.len()).map(|o| sum(o).tanh()).collect()
    }

    /// In f64, from the named parts.
    fn exact(parts: &[(String, Vec<f64>)], x: &[f64], join: Join, units: usize) -> Vec<f64> {
        let of = |name: &str| &parts.iter().find(|part| part.0 == name).unwrap().1[..];
        let mut f = vec![x[12], x[13], x[20]];
        let conv: Vec<f64> =
            (0..2).flat_map(|i| layer(of("encoder.0.0.weight"), of("encoder.0.0.bias"), &x[3 * i..][..9])).collect();
        let phi = |x: &[f64]| {
            layer(
                of("encoder.1.1.weight"),
                of("encoder.1.1.bias"),
                &layer(of("encoder.1.0.weight"), of("encoder.1.0.bias"), x),
            )
        };
        let each: Vec<Vec<f64>> = x[14..20].chunks(2).map(phi).collect();
        let set: Vec<f64> = (0..4).map(|i| each.iter().map(|y| y[i]).sum::<f64>() / 3.0).collect();
        match join {
            Join::Concat => f.extend(conv.iter().chain(&set)),
            Join::Sum => f.extend(conv.iter().zip(&set).map(|(a, b)| a + b)),
        }
        let h = &x[21..];
        let dot = |w: &[f64], o: usize, x: &[f64]| (0..x.len()).map(|i| w[o * x.len() + i] * x[i]).sum::<f64>();
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let next: Vec<f64> = (0..units)
            .map(|i| {
                let own = |o: usize| dot(of("memory.weight_ih"), o, &f) + of("memory.bias_ih")[o];
                let kept = |o: usize| dot(of("memory.weight_hh"), o, h) + of("memory.bias_hh")[o];
                let (r, z) = (sigmoid(own(i) + kept(i)), sigmoid(own(units + i) + kept(units + i)));
                (1.0 - z) * (own(2 * units + i) + r * kept(2 * units + i)).tanh() + z * h[i]
            })
            .collect();
        f.extend(&next);
        let y = layer(of("1.weight"), of("1.bias"), &layer(of("0.weight"), of("0.bias"), &f));
        y.into_iter().chain(next).collect()
    }

    #[test]
    fn gradients_are_differences_of_the_same_networks_in_f64() {
        for (join, units) in [(Join::Concat, None), (Join::Sum, None), (Join::Concat, Some(7)), (Join::Sum, Some(5))] {
            let n = units.unwrap_or(0);
            let worst = gradients_are_differences(&stack(join, units), 5, &|parts, x| exact(parts, x, join, n));
            println!("{join:?} {units:?}: {worst:?}");
            assert!(worst[0] < 1e-6 && worst[1] < 3e-6, "{worst:?}"); // measured at most 1.8e-7, 7.1e-7
        }
    }

    #[test]
    fn a_memory_alone_sees_all_columns_and_rows_do_not_depend_on_their_number() {
        let stack = Stack::new(6, Vec::new(), Join::Concat, Some(4), |n| Ok(mlp(n, &[8], 3))).unwrap();
        assert_eq!((stack.n_input(), stack.n_output(), stack.n_state()), (10, 7, 4));
        let (p, x) = (draw(stack.n_parameter(), 1), draw(9 * 10, 2));
        let mut memory = stack.memory(9);
        let mut all = vec![0.0; 9 * 7];
        stack.forward(&p, &x, 9, &mut memory).write(&mut all);
        for (r, want) in all.chunks_exact(7).enumerate() {
            assert_eq!(stack.forward(&p, &x[r * 10..][..10], 1, &mut memory).row(0), want, "row {r}");
        }
    }

    #[test]
    fn columns_that_are_not_there_and_sums_of_unlike_widths_are_refused() {
        let of = |columns: Range<usize>, n: usize, join| {
            let own =
                |columns: Range<usize>, n_out| Encoded { network: Arc::new(mlp(columns.len(), &[4], n_out)), columns };
            let told = Stack::new(8, vec![own(0..3, 4), own(columns, n)], join, None, |n| Ok(mlp(n, &[4], 2)));
            told.map(drop).map_err(|e| e.to_string())
        };
        assert!(of(2..8, 4, Join::Sum).is_ok() && of(2..8, 5, Join::Concat).is_ok());
        let told = of(2..8, 5, Join::Sum).unwrap_err();
        assert!(told.starts_with("numbers that an encoder gives is 5, but it must be 4"), "{told}");
        for columns in [6..9, 3..3] {
            let told = of(columns.clone(), 4, Join::Concat).unwrap_err();
            assert!(told.starts_with(&format!("columns of an encoder is {columns:?}")), "{told}");
        }
    }
}
