//! Networks as C99: weights that stay in flash, one small function per kind of layer, loops, no heap, nothing static that is written.
//!
//! The text computes what [`LayerGraph::evaluate`] does, operation by operation: with the same bits where the compiler does not contract
//! (`-ffp-contract=off`, or `-std=c99`) and elementary functions are those of Rust. gcc 12 at `-O3` fuses sums beside differences
//! all the same, where the processor can: `-O2`, or `-fno-tree-slp-vectorize`. Weights are `float` in both precisions,
//! as they were learnt; an `int` has 32 bits. Elementary functions are the caller's: [`NetworkText::needs`] names them.

use autodiff::emit::{Elementary, ExportPrecision};
use rl::nn::graph::{FIRST_NODE, LayerGraph, LayerKind, LayerNode, REMEMBERED, SEEN, ValueSpan};
use rl::nn::{Activation, Head, Pool};
use std::collections::BTreeSet;
use std::fmt::Write;

/// A network as C99.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkText {
    /// Functions and weights, all `static`; the last one is `void {prefix}network(const T *input, T *state, T *output)`, without `state`
    /// where nothing is remembered.
    pub text: String,
    /// Elementary functions of one number that it calls.
    pub needs: BTreeSet<Elementary>,
    /// Bytes of its local arrays, and of the frames of its functions but elementary ones.
    pub stack_bytes: usize,
    /// Bytes of its weights.
    pub flash_bytes: usize,
}

/// A network as C99; `prefix` begins all names of it, `elementary` those of elementary functions: `hover_od_` where it calls `hover_od_tanh`.
pub fn network_text(graph: &LayerGraph, prefix: &str, elementary: &str, precision: ExportPrecision) -> NetworkText {
    let mut text = Writer::new(graph, precision).write(prefix);
    text.text = text.text.replace('~', elementary);
    text
}

/// The most likely action of a network's outputs as C99, `int {prefix}action(const T *output, T *action)`: numbers within [−1, 1] as
/// environments clip them, whole numbers as the first of the largest outputs. It returns 1, or 0 where an output is not finite: then
/// environments fly their safe command. An action has `n_action` numbers; those behind the head's are 0.
pub fn action_text(head: Head, n_action: usize, prefix: &str, precision: ExportPrecision) -> String {
    let mut body = String::new();
    let n = head.n_action();
    let line = match head {
        Head::Gaussian { .. } => "action[i] = output[i] < -1.0$ ? -1.0$ : output[i] > 1.0$ ? 1.0$ : output[i];".into(),
        Head::Categorical { n: levels } | Head::MultiCategorical { levels, .. } => {
            format!("action[i] = (real)@largest(output + i * {levels}, {levels});")
        }
    };
    if !matches!(head, Head::Gaussian { .. }) {
        body += LARGEST;
        body += "\n";
    }
    body += FINITE;
    body += "\n/* the most likely action; 0 where it may not be flown, since an output is not finite */\n";
    let rest = if n_action > n {
        (n..n_action).map(|k| format!("    action[{k}] = 0.0$;\n")).collect()
    } else {
        String::new()
    };
    body += &format!(
        "static int @action(const real *output, real *action)\n{{\n    for (int i = 0; i < {n}; i++) {{\n        {line}\n    }}\n{rest}    \
         return @finite(output, {});\n}}\n",
        head.n_output(),
    );
    // a network of the same prefix has its own
    in_c(&body.replace("@finite", "@finite_output"), prefix, precision)
}

/// Where a value stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Input,
    State,
    Output,
    /// So many numbers into the working memory.
    Work(usize),
}

/// Bytes of the frames of a network's functions.
const FRAMES: usize = 256;

struct Writer<'a> {
    graph: &'a LayerGraph,
    precision: ExportPrecision,
    /// Of every value.
    places: Vec<Place>,
    /// Numbers of the working memory.
    n_work: usize,
    /// Names and text of the functions that are called, in the order in which they call each other.
    functions: Vec<[&'static str; 2]>,
    needs: BTreeSet<Elementary>,
    weights: String,
    n_weight: usize,
    body: String,
}

impl<'a> Writer<'a> {
    fn new(graph: &'a LayerGraph, precision: ExportPrecision) -> Self {
        let (places, n_work) = places(graph);
        Self {
            graph,
            precision,
            places,
            n_work,
            functions: Vec::new(),
            needs: BTreeSet::new(),
            weights: String::new(),
            n_weight: 0,
            body: String::new(),
        }
    }

    fn write(mut self, prefix: &str) -> NetworkText {
        for (k, node) in self.graph.nodes.iter().enumerate() {
            self.node(k, node);
        }
        let (output, state) = (&self.graph.output, &self.graph.state);
        if self.places[output.value] != Place::Output && !output.is_empty() {
            self.copy(output, "output");
        }
        let mut parameters = "const real *input, real *output";
        if self.graph.n_state > 0 {
            self.copy(state, "state");
            let (n_input, n_state) = (self.graph.n_input, self.graph.n_state);
            self.call("finite", FINITE);
            let _ = write!(
                self.body,
                "    /* one broken observation must not outlive its step */\n    if (!(@finite(state, {n_state}) && @finite(input, \
                 {n_input}))) {{\n        volatile real *own = state;\n        for (int i = 0; i < {n_state}; i++) {{\n            own[i] = 0.0$;\n        }}\n    }}\n"
            );
            parameters = "const real *input, real *state, real *output";
        }
        let Self { graph, precision, n_work, functions, needs, weights, n_weight, body, .. } = self;
        let about = format!("/* {} numbers in, {} out, {n_weight} weights. */\n", graph.n_input, graph.n_output());
        let functions: String = functions.into_iter().map(|[_, text]| text.to_string() + "\n").collect();
        let work = if n_work > 0 { format!("    real work[{n_work}];\n") } else { String::new() };
        let own = format!("{about}static void @network({parameters})\n{{\n{work}{body}}}\n");
        NetworkText {
            text: in_c(&format!("{weights}\n{functions}{own}"), prefix, precision),
            needs,
            stack_bytes: n_work * precision.bytes() + FRAMES,
            flash_bytes: n_weight * size_of::<f32>(),
        }
    }

    /// A function that is called from here on.
    fn call(&mut self, name: &'static str, text: &'static str) {
        if self.functions.iter().all(|[own, _]| *own != name) {
            self.functions.push([name, text]);
        }
    }

    fn copy(&mut self, from: &ValueSpan, to: &str) {
        self.call("copy", COPY);
        let _ = writeln!(self.body, "    @copy({}, {}, {to});", self.pointer(from), from.len());
    }

    /// An array of weights of node `k`; its name.
    fn weight(&mut self, k: usize, name: &str, data: &[f32]) -> String {
        let name = format!("@{name}{k}");
        let _ = write!(self.weights, "static const float {name}[] = {{");
        for (k, x) in data.iter().enumerate() {
            let _ = write!(self.weights, "{}{x:e}f,", if k % 8 == 0 { "\n    " } else { " " });
        }
        self.weights += "\n};\n";
        self.n_weight += data.len();
        name
    }

    fn pointer(&self, span: &ValueSpan) -> String {
        let (name, at) = match self.places[span.value] {
            Place::Input => ("input", span.columns.start),
            Place::State => ("state", span.columns.start),
            Place::Output => ("output", span.columns.start),
            Place::Work(first) => ("work", first + span.columns.start),
        };
        if at == 0 { name.into() } else { format!("{name} + {at}") }
    }

    fn node(&mut self, k: usize, node: &LayerNode) {
        let weights: Vec<String> =
            node.kind.weights().into_iter().map(|(name, data)| self.weight(k, name, data)).collect();
        let y = self.pointer(&ValueSpan { value: FIRST_NODE + k, columns: 0..node.n_output() });
        let x = self.pointer(&node.inputs[0]);
        let (rows, n, n_in) = (node.rows, node.width, node.inputs[0].len() / node.rows);
        // what works in place begins with a copy where it may not take over what it reads
        if is_in_place(&node.kind) && x != y {
            self.copy(&node.inputs[0], &y);
        }
        match &node.kind {
            LayerKind::Dense { .. } => {
                self.call("dense", DENSE);
                let rest = format!("{n_in}, {}, {}, {n}", weights[0], weights[1]);
                self.each(rows, |row| format!("@dense({}, {rest}, {})", step(&x, n_in, row), step(&y, n, row)));
            }
            LayerKind::LayerNorm { epsilon, .. } => {
                self.call("layer_norm", LAYER_NORM);
                self.needs.insert(Elementary::Sqrt);
                let epsilon = match self.precision {
                    ExportPrecision::Single => format!("{epsilon:e}f"),
                    ExportPrecision::Double => format!("{:e}", f64::from(*epsilon)),
                };
                let rest = format!("{n}, {}, {}, {epsilon}", weights[0], weights[1]);
                self.each(rows, |row| format!("@layer_norm({}, {rest})", step(&y, n, row)));
            }
            LayerKind::Activation(kind) => {
                let (name, text, need) = match kind {
                    Activation::Tanh => ("tanh", TANH, Some(Elementary::Tanh)),
                    Activation::Elu => ("elu", ELU, Some(Elementary::Exp)),
                    Activation::Relu => ("relu", RELU, None),
                    Activation::LeakyRelu => ("leaky_relu", LEAKY_RELU, None),
                    Activation::Identity => return,
                };
                self.call(name, text);
                self.needs.extend(need);
                let _ = writeln!(self.body, "    @{name}({y}, {});", node.n_output());
            }
            LayerKind::Gru { .. } => {
                self.call("dot", DOT);
                self.call("gate", GATE);
                self.call("gru", GRU);
                self.needs.insert(Elementary::Tanh);
                let h = self.pointer(&node.inputs[1]);
                let _ = writeln!(self.body, "    @gru({x}, {n_in}, {h}, {n}, {}, {y});", weights.join(", "));
            }
            LayerKind::Conv { shape, .. } => {
                self.call("conv", CONV);
                let ([_, width, channels], [height, across, filters]) = (shape.from, shape.to);
                let [down, along] = shape.kernel;
                let (own, stride) = (weights.join(", "), shape.stride);
                let sizes = format!("{width}, {channels}, {down}, {along}, {stride}, {height}, {across}, {filters}");
                let _ = writeln!(self.body, "    @conv({x}, {sizes}, {own}, {y});");
            }
            LayerKind::Pool(kind) => {
                let (name, text) = match kind {
                    Pool::Mean => ("mean", MEAN),
                    Pool::Max => ("largest_of_each", LARGEST_OF_EACH),
                };
                self.call(name, text);
                let _ = writeln!(self.body, "    @{name}({x}, {rows}, {n}, {y});");
            }
            LayerKind::Concat => {
                let mut at = 0;
                for span in &node.inputs {
                    let to = ValueSpan { value: FIRST_NODE + k, columns: at..at + span.len() };
                    self.copy(span, &self.pointer(&to));
                    at += span.len();
                }
            }
            LayerKind::Sum => {
                self.copy(&node.inputs[0], &y);
                self.call("add", ADD);
                for span in &node.inputs[1..] {
                    let _ = writeln!(self.body, "    @add({}, {n}, {y});", self.pointer(span));
                }
            }
        }
    }

    /// A call for each of several rows; `call` is told which.
    fn each(&mut self, rows: usize, call: impl Fn(&str) -> String) {
        let _ = match rows {
            1 => writeln!(self.body, "    {};", call("0")),
            _ => write!(self.body, "    for (int k = 0; k < {rows}; k++) {{\n        {};\n    }}\n", call("k")),
        };
    }
}

/// `row` times `n` numbers behind a pointer.
fn step(pointer: &str, n: usize, row: &str) -> String {
    if row == "0" { pointer.into() } else { format!("{pointer} + {row} * {n}") }
}

fn is_in_place(kind: &LayerKind) -> bool {
    matches!(kind, LayerKind::Activation(_) | LayerKind::LayerNorm { .. })
}

/// Where every value stands, and the numbers of the working memory: each takes the first gap that is free while it is needed.
fn places(graph: &LayerGraph) -> (Vec<Place>, usize) {
    let n = graph.nodes.len();
    // the node behind the last that reads a value
    let mut end = vec![0; FIRST_NODE + n];
    for (k, node) in graph.nodes.iter().enumerate() {
        node.inputs.iter().for_each(|span| end[span.value] = k + 1);
    }
    for span in [&graph.output, &graph.state] {
        end[span.value] = n + 1;
    }
    // which value's place a value takes over
    let mut root: Vec<usize> = (0..FIRST_NODE + n).collect();
    for (k, node) in graph.nodes.iter().enumerate().filter(|(_, node)| is_in_place(&node.kind)) {
        let span = &node.inputs[0];
        let whole = span.value >= FIRST_NODE && span.len() == graph.n_value(span.value);
        if whole && end[span.value] == k + 1 {
            root[FIRST_NODE + k] = root[span.value];
        }
    }
    for value in FIRST_NODE..FIRST_NODE + n {
        end[root[value]] = end[root[value]].max(end[value]);
    }
    let mut places = vec![Place::Work(0); FIRST_NODE + n];
    (places[SEEN], places[REMEMBERED]) = (Place::Input, Place::State);
    let is_whole = graph.output.value >= FIRST_NODE && graph.output.len() == graph.n_value(graph.output.value);
    let shared = graph.output.value == graph.state.value;
    let given = (is_whole && !shared).then(|| root[graph.output.value]);
    let mut n_work = 0;
    // first number, numbers and end of those that are placed
    let mut taken: Vec<[usize; 3]> = Vec::new();
    for k in 0..n {
        let value = FIRST_NODE + k;
        if root[value] != value {
            places[value] = places[root[value]];
            continue;
        }
        if Some(value) == given {
            places[value] = Place::Output;
            continue;
        }
        taken.retain(|[.., end]| *end > k);
        taken.sort_unstable();
        let (mut at, size) = (0, graph.n_value(value));
        for [first, n, _] in &taken {
            if at + size <= *first {
                break;
            }
            at = at.max(first + n);
        }
        taken.push([at, size, end[value]]);
        places[value] = Place::Work(at);
        n_work = n_work.max(at + size);
    }
    (places, n_work)
}

/// Text in which `real` is the type, `@` begins names, `~` those of elementary functions, and `$` ends numbers.
fn in_c(text: &str, prefix: &str, precision: ExportPrecision) -> String {
    let suffix = if precision == ExportPrecision::Single { "f" } else { "" };
    text.replace("real", precision.c_type()).replace('@', prefix).replace('$', suffix)
}

/// Four sums side by side, so that none waits for the one before; each goes over its inputs in order.
const DENSE: &str = "\
/* y = b + W x */
static void @dense(const real *x, int n, const float *w, const float *b, int m, real *y)
{
    int o = 0;
    for (; o + 4 <= m; o += 4) {
        const float *v[4] = {w, w + n, w + 2 * n, w + 3 * n};
        real s0 = (real)b[o], s1 = (real)b[o + 1], s2 = (real)b[o + 2], s3 = (real)b[o + 3];
        for (int i = 0; i < n; i++) {
            s0 += (real)v[0][i] * x[i];
            s1 += (real)v[1][i] * x[i];
            s2 += (real)v[2][i] * x[i];
            s3 += (real)v[3][i] * x[i];
        }
        y[o] = s0;
        y[o + 1] = s1;
        y[o + 2] = s2;
        y[o + 3] = s3;
        w += 4 * n;
    }
    for (; o < m; o++) {
        real s = (real)b[o];
        for (int i = 0; i < n; i++) {
            s += (real)w[i] * x[i];
        }
        y[o] = s;
        w += n;
    }
}
";

const LAYER_NORM: &str = "\
/* gain (x - mean)/deviation + shift */
static void @layer_norm(real *x, int n, const float *gain, const float *shift, real epsilon)
{
    real mean = 0.0$, variance = 0.0$, scale;
    for (int i = 0; i < n; i++) {
        mean += x[i];
    }
    mean /= (real)n;
    for (int i = 0; i < n; i++) {
        x[i] -= mean;
        variance += x[i] * x[i];
    }
    scale = 1.0$ / ~sqrt(variance / (real)n + epsilon);
    for (int i = 0; i < n; i++) {
        x[i] = (real)gain[i] * (x[i] * scale) + (real)shift[i];
    }
}
";

const TANH: &str = "\
/* tanh x */
static void @tanh(real *x, int n)
{
    for (int i = 0; i < n; i++) {
        x[i] = ~tanh(x[i]);
    }
}
";

const ELU: &str = "\
/* x above zero, exp x - 1 below */
static void @elu(real *x, int n)
{
    for (int i = 0; i < n; i++) {
        x[i] = x[i] < 0.0$ ? ~exp(x[i]) - 1.0$ : x[i];
    }
}
";

const RELU: &str = "\
/* x above zero, 0 below */
static void @relu(real *x, int n)
{
    for (int i = 0; i < n; i++) {
        x[i] = x[i] < 0.0$ ? 0.0$ : x[i];
    }
}
";

const LEAKY_RELU: &str = "\
/* x above zero, 0.01 x below */
static void @leaky_relu(real *x, int n)
{
    for (int i = 0; i < n; i++) {
        x[i] = x[i] < 0.0$ ? 0.01$ * x[i] : x[i];
    }
}
";

const DOT: &str = "\
/* b + w . x */
static real @dot(const real *x, int n, const float *w, float b)
{
    real s = (real)b;
    for (int i = 0; i < n; i++) {
        s += (real)w[i] * x[i];
    }
    return s;
}
";

const GATE: &str = "\
/* 1/(1 + exp -x) */
static real @gate(real x)
{
    return 0.5$ + 0.5$ * ~tanh(0.5$ * x);
}
";

const GRU: &str = "\
/* a gated recurrent unit behind x and h: gates r, z, n */
static void @gru(const real *x, int n, const real *h, int m, const float *w, const float *u, const float *b, const float *c,
                 real *next)
{
    for (int o = 0; o < m; o++) {
        int z = m + o, g = 2 * m + o;
        real reset = @gate(@dot(x, n, w + o * n, b[o]) + @dot(h, m, u + o * m, c[o]));
        real keep = @gate(@dot(x, n, w + z * n, b[z]) + @dot(h, m, u + z * m, c[z]));
        real fresh = ~tanh(@dot(x, n, w + g * n, b[g]) + reset * @dot(h, m, u + g * m, c[g]));
        next[o] = fresh + keep * (h[o] - fresh);
    }
}
";

const CONV: &str = "\
/* y[i][j][o] = b[o] + sum over p, q, c of w[o][p][q][c] x[stride i + p][stride j + q][c] */
static void @conv(const real *x, int width, int channels, int down, int along, int stride, int height, int across, int filters,
                  const float *weight, const float *bias, real *y)
{
    for (int i = 0; i < height; i++) {
        for (int j = 0; j < across; j++) {
            const float *w = weight;
            for (int o = 0; o < filters; o++) {
                real s = (real)bias[o];
                for (int p = 0; p < down; p++) {
                    const real *patch = x + ((i * stride + p) * width + j * stride) * channels;
                    for (int k = 0; k < along * channels; k++) {
                        s += (real)*w++ * patch[k];
                    }
                }
                *y++ = s;
            }
        }
    }
}
";

const MEAN: &str = "\
/* the mean of each number over the rows */
static void @mean(const real *x, int rows, int n, real *y)
{
    for (int i = 0; i < n; i++) {
        real s = x[i];
        for (int k = 1; k < rows; k++) {
            s += x[k * n + i];
        }
        y[i] = s / (real)rows;
    }
}
";

const LARGEST_OF_EACH: &str = "\
/* the largest of each number over the rows */
static void @largest_of_each(const real *x, int rows, int n, real *y)
{
    for (int i = 0; i < n; i++) {
        real s = x[i];
        for (int k = 1; k < rows; k++) {
            s = s < x[k * n + i] ? x[k * n + i] : s;
        }
        y[i] = s;
    }
}
";

const COPY: &str = "\
/* y = x; through volatile, for which no compiler calls memcpy */
static void @copy(const real *x, int n, real *y)
{
    volatile real *own = y;
    for (int i = 0; i < n; i++) {
        own[i] = x[i];
    }
}
";

const ADD: &str = "\
/* y = y + x */
static void @add(const real *x, int n, real *y)
{
    for (int i = 0; i < n; i++) {
        y[i] += x[i];
    }
}
";

const FINITE: &str = "\
/* whether all numbers are finite */
static int @finite(const real *x, int n)
{
    for (int i = 0; i < n; i++) {
        if (!(x[i] * 0.0$ < 1.0$)) {
            return 0;
        }
    }
    return 1;
}
";

const LARGEST: &str = "\
/* the first of the largest */
static int @largest(const real *x, int n)
{
    int best = 0;
    for (int k = 1; k < n; k++) {
        if (x[k] > x[best]) {
            best = k;
        }
    }
    return best;
}
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_policies::{Sample, named, rows, samples};
    use autodiff::Scalar;
    use std::process::Command;

    const ROWS: usize = 1000;
    /// A row with a number that is none.
    const BROKEN: usize = 500;
    const SILENT: [&str; 9] = [
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wdouble-promotion",
        "-Wshadow",
        "-Werror",
        "-O2",
    ];

    /// A number of a driver's files.
    trait Number: Scalar + Into<f64> {
        const PRECISION: ExportPrecision;
        fn bytes(self) -> Vec<u8>;
        fn read(bytes: &[u8]) -> Vec<Self>;
    }

    impl Number for f32 {
        const PRECISION: ExportPrecision = ExportPrecision::Single;
        fn bytes(self) -> Vec<u8> {
            self.to_le_bytes().into()
        }
        fn read(bytes: &[u8]) -> Vec<Self> {
            bytes.as_chunks().0.iter().map(|x| Self::from_le_bytes(*x)).collect()
        }
    }

    impl Number for f64 {
        const PRECISION: ExportPrecision = ExportPrecision::Double;
        fn bytes(self) -> Vec<u8> {
            self.to_le_bytes().into()
        }
        fn read(bytes: &[u8]) -> Vec<Self> {
            bytes.as_chunks().0.iter().map(|x| Self::from_le_bytes(*x)).collect()
        }
    }

    /// A policy's network, that of the last agent where each has its own.
    fn graph(sample: &Sample) -> LayerGraph {
        let actor = sample.policy.actor();
        LayerGraph::of(&*actor.mlp, actor.set(sample.policy.parameters(), actor.n_set() - 1).0, 0)
    }

    fn head(sample: &Sample) -> Head {
        let actor = sample.policy.actor();
        actor.head_of(actor.n_set() - 1)
    }

    fn inputs<S: Number>(n: usize, seed: usize) -> Vec<S> {
        let mut x: Vec<S> = rows(ROWS * n, seed as u64).into_iter().map(|x| S::constant(f64::from(x))).collect();
        x[BROKEN * n] = S::constant(f64::NAN);
        x
    }

    /// Outputs, states and actions of every row, and whether the action may be flown, as the definition has them.
    fn defined<S: Number>(sample: &Sample, seed: usize) -> Vec<S> {
        let (graph, actor) = (graph(sample), sample.policy.actor());
        let mut state = vec![S::zero(); graph.n_state];
        let mut all = Vec::new();
        for x in inputs::<S>(graph.n_input, seed).chunks_exact(graph.n_input) {
            let mut output = vec![S::zero(); graph.n_output()];
            graph.evaluate(x, &mut state, &mut output);
            let single: Vec<f32> = output.iter().map(|y| (*y).into() as f32).collect();
            let mut action = vec![0.0; actor.n_action()];
            let action: Vec<S> = if let Head::Gaussian { n } = head(sample) {
                let own = output[..n].iter().map(|y| y.clamp(-S::one(), S::one()));
                own.chain(action[n..].iter().map(|_| S::zero())).collect()
            } else {
                head(sample).mode(&single, &[], &mut action);
                action.iter().map(|a| S::constant(f64::from(*a))).collect()
            };
            let flies = output[..head(sample).n_output()].iter().all(|y| (*y).into().is_finite());
            all.extend(output.into_iter().chain(state.clone()).chain(action));
            all.push(if flies { S::one() } else { S::zero() });
        }
        all
    }

    /// Networks and heads of all samples, and a program that runs them on their inputs.
    fn program<S: Number>(samples: &[Sample]) -> String {
        let precision = S::PRECISION;
        let names = ["exp", "tanh", "sqrt"];
        let suffix = if precision == ExportPrecision::Single { "f" } else { "" };
        let mut text = String::from("#include <math.h>\n#include <stdio.h>\n");
        names.iter().for_each(|name| text += &format!("#define od_{name} {name}{suffix}\n"));
        let mut main = String::new();
        for (k, sample) in samples.iter().enumerate() {
            let (own, actor, prefix) = (graph(sample), sample.policy.actor(), format!("policy{k}_"));
            let network = network_text(&own, &prefix, "od_", precision);
            text += &network.text;
            text += &action_text(head(sample), actor.n_action(), &prefix, precision);
            let (state, zero) = match own.n_state {
                0 => ("", String::new()),
                n => ("state, ", format!("for (int i = 0; i < {n}; i++) state[i] = 0;")),
            };
            main += &format!(
                "    {zero}\n    for (int row = 0; row < {ROWS}; row++) {{\n        number flies;\n\
                 if (fread(input, sizeof(number), {}, stdin) != {}) return 1;\n\
                 {prefix}network(input, {state}output);\n\
                 flies = (number){prefix}action(output, action);\n\
                 fwrite(output, sizeof(number), {}, stdout);\n\
                 fwrite(state, sizeof(number), {}, stdout);\n\
                 fwrite(action, sizeof(number), {}, stdout);\n\
                 fwrite(&flies, sizeof(number), 1, stdout);\n    }}\n",
                own.n_input,
                own.n_input,
                own.n_output(),
                own.n_state,
                actor.n_action()
            );
        }
        let number = precision.c_type();
        format!(
            "{text}typedef {number} number;\nint main(void)\n{{\n    static number input[1000], state[100], output[100], action[100];\n\
             {main}    return 0;\n}}\n"
        )
    }

    /// What the compiled program gives; `None` where there is no compiler.
    fn run<S: Number>(samples: &[Sample]) -> Option<Vec<S>> {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("networks.c"), program::<S>(samples)).unwrap();
        let mut compiled = Command::new("cc");
        compiled.args(SILENT).arg(at("networks.c")).arg("-o").arg(at("networks")).arg("-lm");
        let Ok(told) = compiled.output() else {
            println!("skipped: there is no cc");
            return None;
        };
        assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
        let each = samples.iter().enumerate().flat_map(|(k, sample)| inputs::<S>(graph(sample).n_input, k));
        std::fs::write(at("inputs"), each.flat_map(Number::bytes).collect::<Vec<_>>()).unwrap();
        let ran = Command::new(at("networks")).stdin(std::fs::File::open(at("inputs")).unwrap()).output().unwrap();
        assert!(ran.status.success());
        Some(S::read(&ran.stdout))
    }

    /// Of each sample the largest distance of the program from the definition.
    fn far<S: Number>() -> Option<Vec<(&'static str, f64)>> {
        let samples = samples();
        let got = run::<S>(&samples)?;
        let mut at = 0;
        let each = samples.iter().enumerate().map(|(k, sample)| {
            let want = defined::<S>(sample, k);
            let own = &got[at..at + want.len()];
            at += want.len();
            let (mut worst, mut broken) = (0.0_f64, 0);
            for (got, want) in own.iter().zip(&want) {
                let (got, want): (f64, f64) = ((*got).into(), (*want).into());
                assert_eq!(got.is_nan(), want.is_nan(), "{}: {got} against {want}", sample.name);
                broken += usize::from(want.is_nan());
                worst = if want.is_nan() { worst } else { worst.max((got - want).abs()) };
            }
            assert!(broken > 0, "{}: the broken row shows", sample.name);
            (sample.name, worst)
        });
        let each = each.collect();
        assert_eq!(at, got.len());
        Some(each)
    }

    #[test]
    fn every_network_and_action_has_the_bits_of_its_definition_with_memory_carried_on() {
        for (name, far) in [far::<f64>(), far::<f32>()].into_iter().flatten().flatten() {
            assert_eq!(far, 0.0, "{name}");
        }
    }

    #[test]
    fn text_holds_only_what_is_called_and_says_what_it_takes() {
        let text = |name: &str| {
            let sample = named(name);
            (network_text(&graph(&sample), "p_", "od_", ExportPrecision::Single), sample.policy.actor().mlp.n_weight())
        };
        let (plain, n_weight) = text("plain");
        assert_eq!((plain.stack_bytes, plain.flash_bytes), (4 * 2 * 64 + FRAMES, 4 * n_weight));
        assert_eq!(plain.needs, [Elementary::Tanh].into());
        assert_eq!(plain.text.matches("\nstatic void ").count(), 3, "dense, tanh and the network");
        let (norm, _) = text("layer_norm");
        assert_eq!(norm.needs, [Elementary::Sqrt, Elementary::Exp].into());
        assert!(!norm.text.contains("p_gru") && norm.stack_bytes == plain.stack_bytes, "in place");
        let arrays = |text: &str| text.matches("[] = {").count();
        assert_eq!(arrays(&norm.text), norm.text.matches("static const float ").count());
    }
}
