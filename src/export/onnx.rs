//! Policies as ONNX (operators of version 17): from the observation that a user has to the action that is flown.
//!
//! | name | shape | what |
//! |---|---|---|
//! | `observation` | `[batch, n]` | one agent's, before the stage `normalise` |
//! | `memory` | `[batch, units]` | what a policy with memory remembers; zeros where an episode begins |
//! | `action` | `[batch, n]` | the most likely one, within [−1, 1]; whole numbers (`int64`) of discrete actions |
//! | `memory_next` | `[batch, units]` | what it remembers next; zeros where a number of the observation or of the memory is not finite |
//!
//! The stage `normalise` stands inside, with its clip. Stages before it are the user's: a history holds raw observations, newest first, and
//! zeros before an episode began. Of stages behind it a history is the user's too, of raw observations, since statistics stand still in
//! flight: before an episode began it holds the means (key `absent` of the metadata), which become zeros. Noise is left out, and
//! privileged numbers are the last of the observation, as they are.

mod message;

use base::error::{Error, Result};
use message::{
    ATTRIBUTE_FLOAT, ATTRIBUTE_INT, ATTRIBUTE_INTS, FLOAT, INT64, OnnxAttribute, OnnxAxis, OnnxEntry, OnnxGraph,
    OnnxModel, OnnxNode, OnnxOperators, OnnxShape, OnnxTensor, OnnxTensorType, OnnxType, OnnxValue,
};
use prost::Message;
use rl::nn::graph::{FIRST_NODE, LayerGraph, LayerKind, LayerNode, SEEN, ValueSpan};
use rl::nn::{Activation, Head, Pool};
use rl::policy::Policy;
use serde_json::json;
use std::collections::HashMap;
use tasks::env::VARIANCE_FLOOR;
use tasks::{Field, ObservationTransform, Spec};

const IR_VERSION: i64 = 8;
const OPERATORS: i64 = 17;

/// A policy as the bytes of an ONNX file; of agent `agent`, where agents have networks of their own.
///
/// ```
/// # use omnidrones_export::omnidrones;
/// use omnidrones::export::onnx::onnx;
/// use omnidrones::rl::{Actor, Layers, Policy};
/// use omnidrones::tasks::{Env, EnvConfig};
///
/// let env = Env::make("Hover", &EnvConfig::default())?;
/// let actor = Actor::new(env.spec(), &Layers::default(), true)?; // or load_policy(FOLDER)?.policy
/// let policy = Policy::of(&actor, &vec![0.01; actor.n_parameter()], &env)?;
/// let bytes = onnx(&policy, env.spec(), 0)?;
/// assert!(bytes.len() > 4 * actor.mlp.n_weight());
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::Value`] for a policy of other environments than `spec` is of, and for an agent that is not there.
pub fn onnx(policy: &Policy, spec: &Spec, agent: usize) -> Result<Vec<u8>> {
    Ok(onnx_model(policy, spec, agent)?.encode_to_vec())
}

/// The same before it becomes bytes.
fn onnx_model(policy: &Policy, spec: &Spec, agent: usize) -> Result<OnnxModel> {
    policy.fits(spec)?;
    if agent >= spec.n_agent {
        let limit = format!("0 to {}", spec.n_agent - 1);
        return Err(Error::value("agent", agent, limit, "Agents count from 0."));
    }
    let actor = policy.actor();
    let set = if actor.n_set() > 1 { agent } else { 0 };
    let graph = LayerGraph::of(&*actor.mlp, actor.set(policy.parameters(), set).0, set);
    let normaliser = InputNormaliser::of(policy, spec)?;
    let mut writer = Writer::new(&graph);
    writer.normalise(normaliser.as_ref());
    graph.nodes.iter().enumerate().for_each(|(k, node)| writer.layer(k, node));
    let (n_action, head) = (actor.n_action(), actor.head_of(set));
    let output = writer.span(&graph.output.part(0..head.n_output()));
    let whole = !matches!(head, Head::Gaussian { .. });
    writer.action(&output, head, n_action);
    if graph.n_state > 0 {
        writer.remember(&graph.state);
    }
    let fields = field_lines(&spec.observation);
    let absent = normaliser.as_ref().filter(|own| own.is_repeated).map(|own| json!(own.mean).to_string());
    let observed: Vec<_> =
        spec.observation.iter().map(|f| json!({ "name": f.name, "size": f.size, "unit": f.unit })).collect();
    let metadata = [
        ("task", Some(spec.task.clone())),
        ("dt", Some(spec.dt.to_string())),
        ("observation", Some(json!(observed).to_string())),
        ("action", Some(json!(spec.commands).to_string())),
        ("absent", absent),
    ];
    let entries = metadata.into_iter().filter_map(|(key, value)| Some(OnnxEntry { key: key.into(), value: value? }));
    let Writer { nodes, constants, .. } = writer;
    let mut input = vec![tensor("observation", FLOAT, graph.n_input, &format!("Before it is normalised: {fields}."))];
    let about = if whole { "Whole numbers, from 0 on." } else { "Commands within [-1, 1]." };
    let kind = if whole { INT64 } else { FLOAT };
    let mut output = vec![tensor("action", kind, n_action, about)];
    if graph.n_state > 0 {
        input.push(tensor("memory", FLOAT, graph.n_state, "What it remembers; zeros where an episode begins."));
        output.push(tensor("memory_next", FLOAT, graph.n_state, "What it remembers next."));
    }
    let graph = OnnxGraph { node: nodes, name: "policy".into(), initializer: constants, input, output };
    Ok(OnnxModel {
        ir_version: IR_VERSION,
        producer_name: "omnidrones".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        doc_string: format!("A policy of the task {}, which acts every {} s.", spec.task, spec.dt),
        graph: Some(graph),
        opset_import: vec![OnnxOperators { domain: String::new(), version: OPERATORS }],
        metadata_props: entries.collect(),
    })
}

/// Names, sizes and units of fields.
fn field_lines(fields: &[Field]) -> String {
    let each = fields.iter().map(|f| {
        let size = if f.size > 1 { format!(" [{}]", f.size) } else { String::new() };
        if f.unit.is_empty() { format!("{}{size}", f.name) } else { format!("{}{size} in {}", f.name, f.unit) }
    });
    each.collect::<Vec<_>>().join("; ")
}

fn tensor(name: &str, kind: i32, n: usize, about: &str) -> OnnxValue {
    let batch = OnnxAxis { dim_value: None, dim_param: Some("batch".into()) };
    let width = OnnxAxis { dim_value: Some(n as i64), dim_param: None };
    let tensor = OnnxTensorType { elem_type: kind, shape: Some(OnnxShape { dim: vec![batch, width] }) };
    OnnxValue { name: name.into(), r#type: Some(OnnxType { tensor_type: Some(tensor) }), doc_string: about.into() }
}

/// The stage `normalise`, moved to what the user shows: ((x − mean) · scale) within ± clip, number by number.
#[derive(Debug, Clone, PartialEq)]
struct InputNormaliser {
    /// Of each number.
    mean: Vec<f32>,
    /// 1/deviation of each number.
    scale: Vec<f32>,
    /// Of each number; ∞ where there is none.
    clip: Vec<f32>,
    /// Whether a history stands behind it.
    is_repeated: bool,
}

impl InputNormaliser {
    /// Of a policy's observation; `None` where nothing is normalised.
    ///
    /// # Errors
    /// [`Error::Value`] where statistics are missing or of another number of entries.
    fn of(policy: &Policy, spec: &Spec) -> Result<Option<Self>> {
        let stages = &spec.config.observation;
        let found = stages.iter().enumerate().find_map(|(k, stage)| match stage {
            ObservationTransform::Normalise { clip } => Some((k, *clip)),
            _ => None,
        });
        let Some((at, clip)) = found else { return Ok(None) };
        let remedy = "Load a policy that was trained with the stage 'normalise'.";
        let Some(statistics) = policy.statistics() else {
            return Err(Error::value("statistics of the policy", "none", "those of its normaliser", remedy));
        };
        let inverse = statistics.variance.iter().map(|v| (1.0 / (v + VARIANCE_FLOOR).sqrt()) as f32);
        let mut own = Self {
            mean: statistics.mean.iter().map(|x| *x as f32).collect(),
            scale: inverse.collect(),
            clip: vec![clip as f32; statistics.mean.len()],
            is_repeated: false,
        };
        for stage in &stages[at + 1..] {
            match stage {
                ObservationTransform::History { steps } => {
                    for own in [&mut own.mean, &mut own.scale, &mut own.clip] {
                        *own = own.repeat(*steps);
                    }
                    own.is_repeated = true;
                }
                ObservationTransform::Privileged {} => {
                    let n = own.mean.len() + spec.privileged.len();
                    own.mean.resize(n, 0.0);
                    own.scale.resize(n, 1.0);
                    own.clip.resize(n, f32::INFINITY);
                }
                ObservationTransform::Noise { .. }
                | ObservationTransform::Estimate { .. }
                | ObservationTransform::Normalise { .. } => (),
            }
        }
        if own.mean.len() != spec.n_observation {
            let limit = format!("{}, those of an observation", spec.n_observation);
            return Err(Error::value("entries of the statistics", own.mean.len(), limit, remedy));
        }
        Ok(Some(own))
    }
}

/// Axes behind the batch's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axes {
    Flat,
    /// Rows, and numbers of a row.
    Rows(usize, usize),
}

struct Writer<'a> {
    graph: &'a LayerGraph,
    nodes: Vec<OnnxNode>,
    constants: Vec<OnnxTensor>,
    /// Name and axes of every value.
    values: Vec<(String, Axes)>,
    /// Names of spans, and of values without rows.
    spans: HashMap<ValueSpan, String>,
}

impl<'a> Writer<'a> {
    fn new(graph: &'a LayerGraph) -> Self {
        let values = ["observation", "memory"].map(|name| (name.to_string(), Axes::Flat)).into();
        Self { graph, nodes: Vec::new(), constants: Vec::new(), values, spans: HashMap::new() }
    }

    /// Adds an operation of one result, which is named after `name`.
    fn operation(&mut self, kind: &str, name: &str, inputs: &[&str], attributes: Vec<OnnxAttribute>) -> String {
        self.nodes.push(OnnxNode {
            input: inputs.iter().map(|name| (*name).into()).collect(),
            output: vec![name.into()],
            name: format!("{name}/{kind}"),
            op_type: kind.into(),
            attribute: attributes,
        });
        name.into()
    }

    fn floats(&mut self, name: &str, dims: &[usize], data: &[f32]) -> String {
        let raw_data = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.constant(name, dims, FLOAT, raw_data)
    }

    fn ints(&mut self, name: &str, data: &[i64]) -> String {
        let raw_data = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.constant(name, &[data.len()], INT64, raw_data)
    }

    /// One of a name.
    fn constant(&mut self, name: &str, dims: &[usize], data_type: i32, raw_data: Vec<u8>) -> String {
        if self.constants.iter().all(|own| own.name != name) {
            let dims = dims.iter().map(|n| *n as i64).collect();
            self.constants.push(OnnxTensor { dims, data_type, name: name.into(), raw_data });
        }
        name.into()
    }

    fn normalise(&mut self, normaliser: Option<&InputNormaliser>) {
        let Some(InputNormaliser { mean, scale, clip, .. }) = normaliser else { return };
        let n = mean.len();
        let [mean, scale] = [("mean", mean), ("scale", scale)]
            .map(|(name, data)| self.floats(&format!("normalise.{name}"), &[n], data));
        let centred = self.operation("Sub", "centred", &["observation", &mean], vec![]);
        let scaled = self.operation("Mul", "scaled", &[&centred, &scale], vec![]);
        let name = "normalised";
        if clip.iter().all(|x| *x == clip[0]) {
            let [low, high] = [("low", -clip[0]), ("high", clip[0])]
                .map(|(name, x)| self.floats(&format!("normalise.{name}"), &[], &[x]));
            self.operation("Clip", name, &[&scaled, &low, &high], vec![]);
        } else {
            let high = self.floats("normalise.high", &[n], clip);
            let low = self.floats("normalise.low", &[n], &clip.iter().map(|x| -x).collect::<Vec<_>>());
            let above = self.operation("Max", "above", &[&scaled, &low], vec![]);
            self.operation("Min", name, &[&above, &high], vec![]);
        }
        self.values[SEEN].0 = name.into();
    }

    /// A span as `[batch, n]`.
    fn span(&mut self, span: &ValueSpan) -> String {
        let whole = ValueSpan { value: span.value, columns: 0..self.graph.n_value(span.value) };
        let (name, axes) = self.values[span.value].clone();
        let flat = match (self.spans.get(&whole), axes) {
            (Some(name), _) => name.clone(),
            (None, Axes::Flat) => name,
            (None, Axes::Rows(..)) => self.reshape(&name, &format!("{name}.flat"), &[whole.len()]),
        };
        self.spans.insert(whole.clone(), flat.clone());
        if *span == whole {
            return flat;
        }
        if let Some(name) = self.spans.get(span) {
            return name.clone();
        }
        let name = format!("{flat}[{}:{}]", span.columns.start, span.columns.end);
        let [starts, ends] = [span.columns.start, span.columns.end].map(|k| self.ints(&format!("at {k}"), &[k as i64]));
        let axes = self.ints("at 1", &[1]);
        self.operation("Slice", &name, &[&flat, &starts, &ends, &axes], vec![]);
        self.spans.insert(span.clone(), name.clone());
        name
    }

    /// The batch's axis, then these.
    fn reshape(&mut self, x: &str, name: &str, axes: &[usize]) -> String {
        let sizes: Vec<i64> = [0].into_iter().chain(axes.iter().map(|n| *n as i64)).collect();
        let shape = self.ints(&format!("shape {sizes:?}"), &sizes);
        self.operation("Reshape", name, &[x, &shape], vec![])
    }

    /// A span as `[batch, n]`, or as `[batch, rows, n]` where there are several.
    fn rows(&mut self, span: &ValueSpan, rows: usize) -> String {
        let (name, axes) = self.values[span.value].clone();
        if rows == 1 {
            return self.span(span);
        }
        let wanted = Axes::Rows(rows, span.len() / rows);
        if span.len() == self.graph.n_value(span.value) && axes == wanted {
            return name;
        }
        let flat = self.span(span);
        self.reshape(&flat, &format!("{flat}.rows"), &[rows, span.len() / rows])
    }

    fn layer(&mut self, k: usize, node: &LayerNode) {
        let name = format!("layer{k}");
        let (rows, n) = (node.rows, node.width);
        let x = self.rows(&node.inputs[0], rows);
        let n_in = node.inputs[0].len() / rows;
        let mut axes = if rows == 1 { Axes::Flat } else { Axes::Rows(rows, n) };
        match &node.kind {
            LayerKind::Dense { weight, bias } => {
                let b = self.floats(&format!("{name}.bias"), &[n], bias);
                if rows == 1 {
                    let w = self.floats(&format!("{name}.weight"), &[n, n_in], weight);
                    self.operation("Gemm", &name, &[&x, &w, &b], vec![int("transB", 1)]);
                } else {
                    let turned: Vec<f32> = (0..n_in * n).map(|at| weight[at % n * n_in + at / n]).collect();
                    let w = self.floats(&format!("{name}.weight"), &[n_in, n], &turned);
                    let product = self.operation("MatMul", &format!("{name}.product"), &[&x, &w], vec![]);
                    self.operation("Add", &name, &[&product, &b], vec![]);
                }
            }
            LayerKind::LayerNorm { gain, shift, epsilon } => {
                let [gain, shift] = [("gain", gain), ("shift", shift)]
                    .map(|(part, data)| self.floats(&format!("{name}.{part}"), &[n], data));
                let settings = vec![int("axis", -1), float("epsilon", *epsilon)];
                self.operation("LayerNormalization", &name, &[&x, &gain, &shift], settings);
            }
            LayerKind::Activation(kind) => {
                let (kind, settings) = match kind {
                    Activation::Tanh => ("Tanh", vec![]),
                    Activation::Elu => ("Elu", vec![]),
                    Activation::Relu => ("Relu", vec![]),
                    Activation::LeakyRelu => ("LeakyRelu", vec![float("alpha", 0.01)]),
                    Activation::Identity => ("Identity", vec![]),
                };
                self.operation(kind, &name, &[&x], settings);
            }
            LayerKind::Gru { .. } => self.gru(&name, &x, node),
            LayerKind::Conv { .. } => self.conv(&name, &x, node),
            LayerKind::Pool(kind) => {
                let kind = match kind {
                    Pool::Mean => "ReduceMean",
                    Pool::Max => "ReduceMax",
                };
                // a single row has no axis of its own
                let x = if rows == 1 { self.reshape(&x, &format!("{x}.rows"), &[1, n]) } else { x };
                self.operation(kind, &name, &[&x], vec![ints("axes", &[1]), int("keepdims", 0)]);
                axes = Axes::Flat;
            }
            LayerKind::Concat | LayerKind::Sum => {
                let inputs: Vec<String> = node.inputs.iter().map(|span| self.span(span)).collect();
                let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
                let (kind, settings) = match node.kind {
                    LayerKind::Concat => ("Concat", vec![int("axis", 1)]),
                    _ => ("Sum", vec![]),
                };
                self.operation(kind, &name, &inputs, settings);
            }
        }
        debug_assert_eq!(self.values.len(), FIRST_NODE + k);
        self.values.push((name, axes));
    }

    /// Gates stand in the order z, r, n there.
    fn gru(&mut self, name: &str, x: &str, node: &LayerNode) {
        let LayerKind::Gru { weight_ih, weight_hh, bias_ih, bias_hh } = &node.kind else { return };
        let (n, n_in) = (node.width, node.inputs[0].len());
        let turned = |data: &[f32]| {
            let of = |gate: usize| &data[gate * data.len() / 3..(gate + 1) * data.len() / 3];
            [of(1), of(0), of(2)].concat()
        };
        let w = self.floats(&format!("{name}.weight_ih"), &[1, 3 * n, n_in], &turned(weight_ih));
        let u = self.floats(&format!("{name}.weight_hh"), &[1, 3 * n, n], &turned(weight_hh));
        let b = self.floats(&format!("{name}.bias"), &[1, 6 * n], &[turned(bias_ih), turned(bias_hh)].concat());
        let h = self.span(&node.inputs[1]);
        let first = self.ints("at 0", &[0]);
        let x = self.operation("Unsqueeze", &format!("{name}.seen"), &[x, &first], vec![]);
        let h = self.operation("Unsqueeze", &format!("{name}.before"), &[&h, &first], vec![]);
        let next = format!("{name}.after");
        self.nodes.push(OnnxNode {
            input: [&x, &w, &u, &b, "", &h].map(Into::into).into(),
            output: vec![String::new(), next.clone()],
            name: format!("{name}/GRU"),
            op_type: "GRU".into(),
            attribute: vec![int("hidden_size", n as i64), int("linear_before_reset", 1)],
        });
        self.operation("Squeeze", name, &[&next, &first], vec![]);
    }

    /// Channels stand before pixels there. What is one pixel high is a line.
    fn conv(&mut self, name: &str, x: &str, node: &LayerNode) {
        let LayerKind::Conv { shape, weight, bias } = &node.kind else { return };
        let ([height, width, channels], [_, _, filters]) = (shape.from, shape.to);
        let [down, along] = shape.kernel;
        let is_line = height == 1 && down == 1;
        let (seen, kernel, there, back): (_, _, &[i64], &[i64]) = if is_line {
            (vec![width, channels], vec![along], &[0, 2, 1], &[0, 2, 1])
        } else {
            (vec![height, width, channels], vec![down, along], &[0, 3, 1, 2], &[0, 2, 3, 1])
        };
        let (patch, n) = (down * along, shape.n_patch());
        let at = |k: usize| k / n * n + (k % patch) * channels + k % n / patch;
        let turned: Vec<f32> = (0..weight.len()).map(|k| weight[at(k)]).collect();
        let dims = [&[filters, channels], &kernel[..]].concat();
        let w = self.floats(&format!("{name}.weight"), &dims, &turned);
        let b = self.floats(&format!("{name}.bias"), &[filters], bias);
        let x = self.reshape(x, &format!("{name}.pixels"), &seen);
        let x = self.operation("Transpose", &format!("{name}.planes"), &[&x], vec![ints("perm", there)]);
        let sizes = |of: &dyn Fn(usize) -> usize| kernel.iter().map(|k| of(*k) as i64).collect::<Vec<_>>();
        let settings = vec![ints("kernel_shape", &sizes(&|k| k)), ints("strides", &sizes(&|_| shape.stride))];
        let y = self.operation("Conv", &format!("{name}.filtered"), &[&x, &w, &b], settings);
        let y = self.operation("Transpose", &format!("{name}.turned"), &[&y], vec![ints("perm", back)]);
        self.reshape(&y, name, &[node.n_output()]);
    }

    fn action(&mut self, output: &str, head: Head, n_action: usize) {
        let n = head.n_action();
        let name = if n_action > n { "acted" } else { "action" };
        match head {
            Head::Gaussian { .. } => {
                let [low, high] =
                    [("least", -1.0), ("most", 1.0)].map(|(part, x)| self.floats(&format!("action.{part}"), &[], &[x]));
                self.operation("Clip", name, &[output, &low, &high], vec![]);
            }
            Head::Categorical { .. } => {
                self.operation("ArgMax", name, &[output], vec![int("axis", 1), int("keepdims", 1)]);
            }
            Head::MultiCategorical { levels, .. } => {
                let choices = self.reshape(output, "choices", &[n, levels]);
                self.operation("ArgMax", name, &[&choices], vec![int("axis", 2), int("keepdims", 0)]);
            }
        }
        if n_action > n {
            let pads = self.ints("action.more", &[0, 0, 0, (n_action - n) as i64]);
            self.operation("Pad", "action", &[name, &pads], vec![]);
        }
    }

    /// One broken observation must not outlive its step: 0 · x is no number where x is not finite.
    fn remember(&mut self, state: &ValueSpan) {
        let next = self.span(state);
        let all = self.operation("Concat", "memory.all", &["observation", &next], vec![int("axis", 1)]);
        let zero = self.floats("memory.zero", &[], &[0.0]);
        let zeros = self.operation("Mul", "memory.zeros", &[&all, &zero], vec![]);
        let axes = self.ints("at 1", &[1]);
        let sum = self.operation("ReduceSum", "memory.sum", &[&zeros, &axes], vec![int("keepdims", 1)]);
        let whole = self.operation("Equal", "memory.whole", &[&sum, &zero], vec![]);
        self.operation("Where", "memory_next", &[&whole, &next, &zero], vec![]);
    }
}

fn int(name: &str, i: i64) -> OnnxAttribute {
    OnnxAttribute { name: name.into(), i: Some(i), r#type: ATTRIBUTE_INT, ..OnnxAttribute::default() }
}

fn float(name: &str, f: f32) -> OnnxAttribute {
    OnnxAttribute { name: name.into(), f: Some(f), r#type: ATTRIBUTE_FLOAT, ..OnnxAttribute::default() }
}

fn ints(name: &str, ints: &[i64]) -> OnnxAttribute {
    OnnxAttribute { name: name.into(), ints: ints.into(), r#type: ATTRIBUTE_INTS, ..OnnxAttribute::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_policies::{Sample, named, rows, samples};
    use std::collections::BTreeSet;
    use tasks::{Buffers, Env, EnvConfig};

    fn model(sample: &Sample, agent: usize) -> OnnxModel {
        let bytes = onnx(&sample.policy, &sample.spec, agent).unwrap();
        OnnxModel::decode(&bytes[..]).unwrap()
    }

    fn width(value: &OnnxValue) -> (String, i32, i64) {
        let tensor = value.r#type.as_ref().and_then(|own| own.tensor_type.as_ref()).unwrap();
        let axes = &tensor.shape.as_ref().unwrap().dim;
        assert_eq!((axes.len(), axes[0].dim_param.as_deref()), (2, Some("batch")));
        (value.name.clone(), tensor.elem_type, axes[1].dim_value.unwrap())
    }

    #[test]
    fn every_policy_survives_its_bytes_and_reads_only_what_is_there() {
        let all = samples();
        for (sample, agent) in all.iter().flat_map(|own| (0..own.spec.n_agent).map(move |agent| (own, agent))) {
            let (own, spec) = (model(sample, agent), &sample.spec);
            assert_eq!(own, onnx_model(&sample.policy, spec, agent).unwrap());
            assert_eq!((own.ir_version, own.opset_import[0].version), (IR_VERSION, OPERATORS));
            let graph = own.graph.unwrap();
            let whole = !matches!(sample.policy.actor().head, Head::Gaussian { .. });
            let n_state = sample.policy.n_state() as i64;
            let mut want = vec![
                ("observation".to_string(), FLOAT, spec.n_observation as i64),
                ("action".to_string(), if whole { INT64 } else { FLOAT }, spec.action.len() as i64),
            ];
            if n_state > 0 {
                want.extend([("memory".to_string(), FLOAT, n_state), ("memory_next".to_string(), FLOAT, n_state)]);
            }
            let got: BTreeSet<_> = graph.input.iter().chain(&graph.output).map(width).collect();
            assert_eq!(got, want.into_iter().collect(), "{}", sample.name);
            let mut known: BTreeSet<String> = graph.input.iter().map(|own| own.name.clone()).collect();
            known.extend(graph.initializer.iter().map(|own| own.name.clone()));
            for node in &graph.node {
                assert!(node.input.iter().all(|x| x.is_empty() || known.contains(x)), "{}: {node:?}", sample.name);
                for y in node.output.iter().filter(|y| !y.is_empty()) {
                    assert!(known.insert(y.clone()), "{}: {y} twice", sample.name);
                }
            }
            assert!(graph.output.iter().all(|y| known.contains(&y.name)));
            for tensor in &graph.initializer {
                let n: i64 = tensor.dims.iter().product();
                let bytes = if tensor.data_type == FLOAT { 4 } else { 8 };
                assert_eq!(tensor.raw_data.len() as i64, n * bytes, "{}", tensor.name);
            }
        }
    }

    #[test]
    fn layers_become_the_operators_of_their_names() {
        for (name, wanted) in [
            ("plain", &["Gemm", "Tanh", "Clip"][..]),
            ("layer_norm", &["LayerNormalization", "Elu"]),
            ("relu", &["Relu"]),
            ("leaky_relu", &["LeakyRelu"]),
            ("normalised", &["Sub", "Mul", "Clip"]),
            ("conv1d", &["Transpose", "Conv"]),
            ("conv2d", &["Slice", "Transpose", "Conv", "Concat"]),
            ("sum", &["Sum", "ReduceMean"]),
            ("set_mean", &["MatMul", "ReduceMean"]),
            ("set_max", &["MatMul", "ReduceMax"]),
            ("gru", &["GRU", "Where"]),
            ("discrete", &["ArgMax"]),
            ("multi_discrete", &["ArgMax", "GRU"]),
            ("privileged", &["Max", "Min"]),
            ("unlike_agents", &["Clip", "Pad"]),
        ] {
            let sample = named(name);
            let graph = model(&sample, sample.spec.n_agent - 1).graph.unwrap();
            let operators: BTreeSet<&str> = graph.node.iter().map(|node| node.op_type.as_str()).collect();
            assert!(wanted.iter().all(|kind| operators.contains(kind)), "{name}: {operators:?}");
        }
    }

    #[test]
    fn what_is_observed_is_named_with_its_units() {
        let own = model(&named("plain"), 0);
        let of = |key: &str| &own.metadata_props.iter().find(|entry| entry.key == key).unwrap().value;
        let fields: serde_json::Value = serde_json::from_str(of("observation")).unwrap();
        let n: u64 = fields.as_array().unwrap().iter().map(|field| field["size"].as_u64().unwrap()).sum();
        assert_eq!((of("task").as_str(), n), ("Hover", named("plain").spec.n_observation as u64));
        assert!(fields[0]["unit"].as_str().is_some_and(|unit| unit.contains('m')), "{fields}");
        assert!(own.graph.unwrap().input[0].doc_string.contains(fields[0]["name"].as_str().unwrap()));
    }

    /// Observations of a flight of environments with these stages.
    fn flown(stages: &str, of: &Sample) -> Vec<f32> {
        let config = EnvConfig::from_toml(&format!("n_env = 8\nobservation = [{stages}]"), "test").unwrap();
        let mut env = Env::make("Hover", &config).unwrap();
        if !env.statistics().mean.is_empty() {
            env.set_statistics(of.policy.statistics().unwrap().clone()).unwrap();
        }
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let mut all = Vec::new();
        for step in 0..9 {
            all.extend_from_slice(&out.observation);
            env.step(&rows(8 * env.spec().action.len(), step), &mut out.out()).unwrap();
        }
        all
    }

    #[test]
    fn normalising_what_a_user_shows_gives_the_observation_of_the_environment() {
        let (normal, history) = ("{ kind = 'normalise', clip = 2.0 }", "{ kind = 'history', steps = 6 }");
        for (name, stages, shown) in [
            ("normalised", vec![normal], String::new()),
            ("normalised_history", vec![history, normal], history.into()),
            ("history_of_normalised", vec![normal, history], history.into()),
        ] {
            let sample = named(name);
            let own = InputNormaliser::of(&sample.policy, &sample.spec).unwrap().unwrap();
            let told = onnx_model(&sample.policy, &sample.spec, 0).unwrap().metadata_props;
            assert_eq!(told.iter().any(|entry| entry.key == "absent"), name == "history_of_normalised");
            let (wanted, mut given) = (flown(&stages.join(", "), &sample), flown(&shown, &sample));
            let n = own.mean.len();
            if own.is_repeated {
                // before an episode began the user shows the means
                for (step, all) in given.chunks_exact_mut(8 * n).enumerate() {
                    for row in all.chunks_exact_mut(n) {
                        let began = n / 6 * (step + 1).min(6);
                        row[began..].copy_from_slice(&own.mean[began..]);
                    }
                }
            }
            let mut clipped = 0;
            for (row, wanted) in given.chunks_exact(n).zip(wanted.chunks_exact(n)) {
                for k in 0..n {
                    let x = ((row[k] - own.mean[k]) * own.scale[k]).clamp(-own.clip[k], own.clip[k]);
                    assert_eq!(x, wanted[k], "{name}: number {k}");
                    clipped += usize::from(x.abs() == own.clip[k]);
                }
            }
            assert!(clipped > 0, "{name}");
        }
    }

    #[test]
    fn policies_of_other_environments_and_agents_that_are_not_there_are_refused() {
        let sample = named("plain");
        let told = onnx(&sample.policy, &sample.spec, 1).unwrap_err().to_string();
        assert!(told.starts_with("agent is 1"), "{told}");
        assert!(onnx(&sample.policy, &named("normalised").spec, 0).is_err());
    }
}
