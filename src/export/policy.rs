//! Policies as C: from a state and a goal to an action, with what is observed, the network and its memory.

mod example;

use super::episode::Episode;
use super::frames;
use super::golden::{Golden, GoldenArray, GoldenKind};
use super::identifier;
use super::module::{CModule, Cost, ExportOptions, MemoryField, ModuleBuilder};
use super::network::{NetworkText, action_text, network_text};
use super::plant::{add_rotors, begins_with_body};
use super::task::{describe, first_computation, fixed_target};
use autodiff::System;
use autodiff::emit::{Access, CFunction, NamedArray};
use base::error::Result;
use base::parallel::Threads;
use rl::nn::Head;
use rl::nn::graph::{LayerGraph, LayerKind, LayerNode};
use rl::{Policy, SavedPolicy, Starts};
use std::fmt::Write;
use tasks::{Env, EnvConfig};

/// The policy of a run as it flies: see [`policy_as_c`].
///
/// # Errors
/// As there.
pub fn saved_policy_as_c(saved: &SavedPolicy, options: &ExportOptions) -> Result<CModule> {
    let own = &saved.manifest;
    let run = format!("{}, seed {}, update {} ({})", own.algorithm, own.seed, own.update, saved.folder.display());
    let origin = options.origin.as_ref().map_or(run.clone(), |origin| format!("{origin}: {run}"));
    let options = ExportOptions { origin: Some(origin), ..options.clone() };
    policy_as_c(&saved.policy, &own.task, &saved.config.seen_env(), &options)
}

/// A policy of a task in environments like `env`:
///
/// - `step` from state and goal to an action: what the environment would show, with histories, normalisation and what the task keeps; then
///   the network, with what it remembers;
/// - `commands` from an action to the inputs of what flies, as often as the task's controllers compute;
/// - `aim`, where the task wants a fixed point to be held: the state that is seen where a setpoint is to be that point.
///
/// Actions are the most likely ones. Episodes do not end: where the task shows a clock, it stays at the horizon's last step.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) for a name that is none in C; otherwise as [`rl::evaluate::eval_env`] and
/// [`Env::functions`].
pub fn policy_as_c(policy: &Policy, task: &str, env: &EnvConfig, options: &ExportOptions) -> Result<CModule> {
    let mut env = rl::evaluate::eval_env(policy, task, env, Starts { n_env: 1, seed: 0 }, &Threads::new(1)?)?;
    let functions = env.functions()?;
    let default_name = format!("{} policy", identifier::of_words(task));
    let mut module = ModuleBuilder::new(&default_name, format!("a policy of the task {task}"), options)?;
    describe(&mut module, &env, &functions);
    let target = fixed_target(&mut env)?;
    let plant = env.robot().plant().clone();
    if let Some(target) = target.filter(|_| begins_with_body(&plant)) {
        frames::add_aim(&mut module, target, plant.n_state());
    }
    let observe = module.inner_remembering(&functions.observe, "observe")?;
    let networks = Networks::of(policy, &env);
    let costs = networks.add(&mut module);
    let first = first_computation(&functions);
    let arrays = (&functions.observe.arrays[..], action(&functions.act.arrays));
    networks.add_step(&mut module, arrays, &observe, &costs, &first, begins_with_body(&plant));
    module.remembering(&functions.act, "commands", "")?;
    let steps = (functions.act_period / plant.physics().dt).round().max(1.0) as usize;
    add_rotors(&mut module, &plant, steps)?;
    module.about.push(KNOWN.into());
    module.about.push("Rotors and drag are those of the task: another motor has other lags.".into());
    module.describe_rotors(&plant);
    let step = Golden::new(format!("{}_step", module.name()), module.has_memory(), Vec::new()).answering();
    let mut episode = Episode::of(env, &module, &functions)?;
    let mut running = networks.running();
    let mut said = Vec::new();
    episode.fly(&mut |observation, _| {
        let action = running.act(observation);
        said.push(action.clone());
        action
    })?;
    let [observed, _, commanded] = episode.golden;
    module.example = example::example(&module, &plant, &functions, &observed, target.is_some());
    let step = with_actions(step, &observed, action(&functions.act.arrays), said);
    [step, commanded].into_iter().for_each(|golden| module.golden(golden));
    Ok(module.finished())
}

/// What nobody may forget.
const KNOWN: &str = "A policy knows the states of its training alone: far outside it may fall, and step returns 1 all the same. Bring a \
    distant setpoint step by step, within the range where episodes of the task begin (omnidrones tasks); give it goals as the task draws \
    them, a heading of length 1 above all.";

fn action(arrays: &[NamedArray]) -> &NamedArray {
    arrays.iter().find(|array| array.name == "action").expect("commands are of an action")
}

/// What `step` is shown is what `observe` is; it writes actions.
fn with_actions(step: Golden, observed: &Golden, action: &NamedArray, said: Vec<Vec<f64>>) -> Golden {
    let is_read = |array: &&GoldenArray| matches!(array.kind, GoldenKind::Read);
    let mut arrays: Vec<GoldenArray> = observed.arrays.iter().filter(is_read).cloned().collect();
    let (n, n_action) = (arrays.iter().map(|array| array.n).sum::<usize>(), action.numbers.len());
    arrays.push(GoldenArray::new(&action.name, n_action, GoldenKind::Write(n_action)));
    let rows = observed.rows.iter().zip(said).map(|(row, said)| [&row[..n], &said].concat());
    Golden { arrays, rows: rows.collect(), ..step }
}

/// The networks of a policy: one, or one for each agent.
pub(crate) struct Networks {
    graphs: Vec<LayerGraph>,
    heads: Vec<Head>,
    /// Numbers of an agent's observation and action.
    n_observation: usize,
    n_action: usize,
    n_agent: usize,
}

impl Networks {
    pub fn of(policy: &Policy, env: &Env) -> Self {
        let actor = policy.actor();
        let graph = |set: usize| LayerGraph::of(&*actor.mlp, actor.set(policy.parameters(), set).0, set);
        Self {
            graphs: (0..actor.n_set()).map(graph).collect(),
            heads: (0..actor.n_set()).map(|set| actor.head_of(set)).collect(),
            n_observation: actor.n_observation(),
            n_action: actor.n_action(),
            n_agent: env.spec().n_agent,
        }
    }

    /// Bytes of stack and operations of the deepest and of all.
    fn add(&self, module: &mut ModuleBuilder) -> CFunction {
        let (precision, name) = (module.text.precision(), module.name().to_string());
        let mut all =
            CFunction { name: String::new(), prototype: String::new(), stack: 0, n_instruction: 0, n_most: 0 };
        for (k, (graph, head)) in self.graphs.iter().zip(&self.heads).enumerate() {
            let prefix = self.prefix(&name, k);
            let NetworkText { text, needs, stack_bytes, flash_bytes } =
                network_text(graph, &prefix, &format!("{name}_od_"), precision);
            for need in needs {
                module.text.need(need);
                all.stack = all.stack.max(stack_bytes + need.stack(precision));
            }
            module.text.add(&text);
            module.text.add(&action_text(*head, self.n_action, &prefix, precision));
            module.add_tables(flash_bytes);
            all.stack = all.stack.max(stack_bytes);
            all.n_instruction += n_product(graph) * self.n_agent / self.graphs.len();
        }
        all.n_most = all.n_instruction;
        all
    }

    fn prefix(&self, name: &str, set: usize) -> String {
        if self.graphs.len() == 1 { format!("{name}_") } else { format!("{name}_agent_{set}_") }
    }

    /// `step`, which observes and acts.
    fn add_step(
        &self,
        module: &mut ModuleBuilder,
        (arrays, action): (&[NamedArray], &NamedArray),
        observe: &CFunction,
        networks: &CFunction,
        first: &str,
        of_body: bool,
    ) {
        let (n_state, n_output) = (self.graphs[0].n_state, self.heads.iter().map(Head::n_output).max().unwrap_or(0));
        let about = "what the network remembers, agent by agent".into();
        let initial = vec![0.0; self.n_agent * n_state];
        module.keep(vec![MemoryField { name: "network".into(), about, initial }], false);
        module.describe(action);
        let (real, name) = (module.real(), module.name().to_string());
        module.need_finite();
        let mut parameters = if module.has_memory() { vec![format!("{name}_memory *memory")] } else { Vec::new() };
        let (mut arguments, mut checks) = (Vec::new(), Vec::new());
        for array in arrays.iter().filter(|array| !array.numbers.is_empty()) {
            match array.access {
                Access::Update => arguments.push("memory->observe".into()),
                Access::Write => arguments.push(array.name.clone()),
                Access::Read => {
                    module.describe(array);
                    parameters.push(format!("const {real} {}[{}]", array.name, array.numbers.len()));
                    let turned =
                        if of_body && array.name == "state" { module.is_turned("state") } else { String::new() };
                    checks.push(format!("{name}_all_finite({}, {}){turned}", array.name, array.numbers.len()));
                    arguments.push(array.name.clone());
                }
            }
        }
        let check =
            if checks.is_empty() { String::new() } else { format!("    if (!({})) return 0;\n", checks.join(" && ")) };
        parameters.push(format!("{real} action[{}]", action.numbers.len()));
        let n_graph_output = self.graphs.iter().map(LayerGraph::n_output).max().unwrap_or(0);
        let mut body = format!(
            "    {real} observation[{}];\n    {real} output[{}];\n{check}{first}    {}({});\n",
            self.n_agent * self.n_observation,
            n_graph_output.max(n_output),
            observe.name,
            arguments.join(", ")
        );
        let n_agent = self.n_agent;
        let one = |body: &mut String, set: usize, indent: &str, agent: &str| {
            let (prefix, n_action) = (self.prefix(&name, set), self.n_action);
            let of = |array: &str, n: usize| {
                if n_agent == 1 { array.to_string() } else { format!("{array} + {agent} * {n}") }
            };
            let state = if n_state > 0 { format!(", {}", of("memory->network", n_state)) } else { String::new() };
            let _ = write!(
                body,
                "{indent}{prefix}network({}{state}, output);\n\
                 {indent}/* what is no number is answered by the safe command */\n\
                 {indent}if (!{prefix}action(output, {own})) {{\n\
                 {indent}    for (int k = 0; k < {n_action}; k++) ({own})[k] = {nan};\n{indent}}}\n",
                of("observation", self.n_observation),
                own = of("action", n_action),
                nan = module.number(f64::NAN),
            );
        };
        if self.graphs.len() > 1 {
            (0..self.n_agent).for_each(|agent| one(&mut body, agent, "    ", &agent.to_string()));
        } else if self.n_agent > 1 {
            let _ = writeln!(body, "    for (int agent = 0; agent < {}; agent++) {{", self.n_agent);
            one(&mut body, 0, "        ", "agent");
            body += "    }\n";
        } else {
            one(&mut body, 0, "    ", "0");
        }
        body += "    return 1;\n";
        let about = "The action for a state and a goal, once per step. Returns 1; where a number of them is not finite, or an \
            attitude no unit quaternion, 0, and leaves memory and action as they were.";
        let own = (self.n_agent * self.n_observation + n_graph_output) * module.text.precision().bytes();
        let mut cost = Cost::calling(own, &[observe, networks]);
        cost.stack += FRAMES;
        module.composed_of("int", "step", about, &parameters.join(", "), &body, cost);
    }

    /// In `f64`, before the first step.
    pub fn running(&self) -> RunningNetworks<'_> {
        RunningNetworks { of: self, states: vec![vec![0.0; self.graphs[0].n_state]; self.n_agent] }
    }
}

/// Products of a network, which are most of its operations.
fn n_product(graph: &LayerGraph) -> usize {
    let of_node = |node: &LayerNode| {
        let weights: usize = node.kind.weights().into_iter().map(|(_, data)| data.len()).sum();
        match &node.kind {
            LayerKind::Conv { shape, .. } => weights * shape.n_patch(),
            _ => weights * node.rows,
        }
    };
    graph.nodes.iter().map(of_node).sum()
}

/// Bytes of the frame of `step`, beside its arrays.
const FRAMES: usize = 160;

/// Networks in `f64`, and what they remember.
pub(crate) struct RunningNetworks<'a> {
    of: &'a Networks,
    states: Vec<Vec<f64>>,
}

impl RunningNetworks<'_> {
    /// The most likely action of all agents.
    pub fn act(&mut self, observation: &[f64]) -> Vec<f64> {
        let Networks { graphs, heads, n_observation, n_action, .. } = self.of;
        let mut actions = Vec::new();
        for (agent, state) in self.states.iter_mut().enumerate() {
            let set = if graphs.len() == 1 { 0 } else { agent };
            let mut output = vec![0.0; graphs[set].n_output()];
            graphs[set].evaluate(&observation[agent * n_observation..][..*n_observation], state, &mut output);
            let mut action = most_likely(heads[set], &output);
            action.resize(*n_action, 0.0);
            if !output[..heads[set].n_output()].iter().all(|x| x.is_finite()) {
                action.fill(f64::NAN);
            }
            actions.extend(action);
        }
        actions
    }
}

/// As [`Head::mode`], in `f64`, as environments clip it.
fn most_likely(head: Head, output: &[f64]) -> Vec<f64> {
    let largest = |logits: &[f64]| {
        let first = |best: usize, k: usize| if logits[k] > logits[best] { k } else { best };
        (1..logits.len()).fold(0, first) as f64
    };
    match head {
        Head::Gaussian { n } => output[..n].iter().map(|x| x.clamp(-1.0, 1.0)).collect(),
        Head::Categorical { n } => vec![largest(&output[..n])],
        Head::MultiCategorical { n, levels } => output[..n * levels].chunks_exact(levels).map(largest).collect(),
    }
}
