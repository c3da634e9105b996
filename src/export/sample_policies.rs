//! Policies of every kind with random weights, for tests.

use rl::policy::{Actor, Policy};
use rng::{Purpose, Stream};
use tasks::env::AgentWidths;
use tasks::{Env, EnvConfig, Spec, Statistics};

/// A policy and its environments.
pub(crate) struct Sample {
    pub name: &'static str,
    pub policy: Policy,
    pub spec: Spec,
}

const IMAGE: &str = "[[sensor]]\nname = 'depth'\nkind = 'camera'\nsize = [16, 12]\n";
const MASSES: &str = "randomise = [{ what = 'mass', range = [0.7, 1.3] }]\n";
const CONV: &str = "[{ channels = 5, kernel = 3 }, { channels = 3, kernel = 2, stride = 2 }]";

/// One of each kind.
pub(crate) fn samples() -> Vec<Sample> {
    settings().into_iter().enumerate().map(|(k, own)| sample(k, own)).collect()
}

/// One of them.
pub(crate) fn named(name: &str) -> Sample {
    let found = settings().into_iter().enumerate().find(|(_, own)| own.0 == name);
    found.map(|(k, own)| sample(k, own)).unwrap()
}

/// Names, tasks, settings of environments and of networks.
type Settings = (&'static str, &'static str, String, String);

fn settings() -> Vec<Settings> {
    let normal = "{ kind = 'normalise', clip = 2.0 }";
    let history = "{ kind = 'history', steps = 6 }";
    let observed = |stages: &[&str]| format!("observation = [{}]\n", stages.join(", "));
    let conv = |kind: &str, group: &str| {
        format!("hidden = [9]\nactivation = 'elu'\n[[encoder]]\nkind = '{kind}'\ngroup = '{group}'\nlayers = {CONV}\n")
    };
    let set = |pool: &str| format!("[[encoder]]\nkind = 'set'\ngroup = 'others'\nunits = [8, 6]\npool = '{pool}'\n");
    let gru = |hidden: &str| format!("hidden = {hidden}\nmemory = {{ kind = 'gru', units = 7 }}\n");
    let of = |kind: &str| format!("[[encoder]]\nkind = '{kind}'\ngroup = 'history'\nunits = [8, 6]\n");
    let sum = String::from("join = 'sum'\nhidden = [9]\n") + &of("mlp") + &of("set");
    let choice = |kind: &str| format!("actions = {{ kind = '{kind}', levels = 3 }}\n");
    vec![
        ("plain", "Hover", String::new(), String::new()),
        ("elu", "Hover", String::new(), "activation = 'elu'".into()),
        ("relu", "Hover", String::new(), "activation = 'relu'\nhidden = [10, 6, 7]".into()),
        ("leaky_relu", "Hover", String::new(), "activation = 'leaky_relu'".into()),
        ("linear", "Hover", String::new(), "activation = 'identity'\nhidden = []".into()),
        ("layer_norm", "Hover", String::new(), "layer_norm = true\nactivation = 'elu'".into()),
        ("normalised", "Hover", observed(&[normal]), String::new()),
        ("normalised_history", "Hover", observed(&[history, normal]), "hidden = [8]".into()),
        (
            "history_of_normalised",
            "Hover",
            observed(&[normal, history, "{ kind = 'noise', std = 0.1 }"]),
            "hidden = [8]".into(),
        ),
        ("privileged", "Hover", observed(&[normal, "{ kind = 'privileged' }"]) + MASSES, "hidden = [8]".into()),
        ("conv1d", "Hover", observed(&[history]), conv("conv1d", "history")),
        ("conv2d", "Hover", IMAGE.into(), conv("conv2d", "depth")),
        ("sum", "Hover", observed(&[history]), sum),
        ("set_mean", "Formation", String::new(), set("mean")),
        ("set_max", "Formation", observed(&[normal]), set("max")),
        ("gru", "Hover", observed(&[normal]), gru("[9]")),
        ("gru_behind_set", "Formation", String::new(), gru("[9]") + &set("max")),
        ("unlike_agents", "Formation", String::new(), String::new()),
        ("agents_apart", "Spread", observed(&[normal]), "hidden = [8]".into()),
        ("rate", "Hover", "control = 'rate'\n".into(), "hidden = [8]".into()),
        ("velocity", "Hover", "control = 'velocity'\n".into(), "hidden = [8]".into()),
        ("discrete", "Hover", choice("discrete"), String::new()),
        ("multi_discrete", "Hover", choice("multi_discrete"), gru("[9]")),
    ]
}

fn sample(k: usize, (name, task, env, layers): Settings) -> Sample {
    let mut stream = Stream::new(k as u64, 0, 0, Purpose::user(5));
    let config = EnvConfig { n_env: 8, ..EnvConfig::from_toml(&env, name).unwrap() };
    let mut env = Env::make(task, &config).unwrap();
    let n = env.statistics().mean.len();
    let mean = (0..n).map(|_| stream.normal()).collect();
    let variance = (0..n).map(|_| stream.uniform(0.2, 2.0)).collect();
    env.set_statistics(Statistics { count: 100.0, mean, variance }).unwrap();
    let (mut spec, unlike) = (env.spec().clone(), name == "unlike_agents");
    if unlike {
        let widths =
            (0..spec.n_agent).map(|agent| AgentWidths { observation: spec.n_observation, action: 4 - agent.min(1) });
        spec.unlike = widths.collect();
    }
    let actor = Actor::with_memory(&spec, &toml::from_str(&layers).unwrap(), k.is_multiple_of(2)).unwrap();
    let actor = actor.for_team(&spec, unlike || name == "agents_apart").unwrap();
    let sets = (0..actor.n_set()).flat_map(|_| drawn(&actor, &mut stream));
    let parameters = sets.collect();
    let statistics = (n > 0).then(|| env.statistics().clone());
    Sample { name, policy: Policy::new(actor, parameters, statistics, &spec).unwrap(), spec }
}

/// One set of parameters. What begins at 0 or 1 is learnt too, and last layers are not as small as they begin.
fn drawn(actor: &Actor, stream: &mut Stream) -> Vec<f32> {
    let mut parameters = actor.mlp.init(stream);
    let drawn = actor.mlp.parts(&parameters).into_iter().map(|part| {
        let by = if part.shape.len() == 1 { 0.3 } else { 0.15 };
        part.data.iter().map(|x| x + by * stream.normal() as f32).collect::<Vec<_>>()
    });
    let mut drawn = drawn.collect::<Vec<_>>().into_iter();
    parameters = actor.mlp.from_parts(&mut |_, _| Ok(drawn.next().unwrap())).unwrap();
    parameters.extend(vec![0.0; actor.head.n_extra()]);
    parameters
}

/// Standard normal rows.
pub(crate) fn rows(n: usize, seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, 0, 0, Purpose::user(6));
    (0..n).map(|_| stream.normal() as f32).collect()
}
