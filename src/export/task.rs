//! Tasks as C: what is observed, what a step was worth, what ends an episode, and from actions to commands.

use super::episode::Episode;
use super::frames;
use super::module::{CModule, ExportOptions, ModuleBuilder};
use super::plant::{add_period, begins_with_body, wave};
use autodiff::System;
use autodiff::emit::Access;
use base::error::Result;
use tasks::{Buffers, Env, EnvConfig, TaskFunctions};

/// The functions of a task in such environments: `observe`, `judge` and `commands`, as [`TaskFunctions`] tells, with what they remember in a
/// struct of the caller.
///
/// # Errors
/// [`Error::Value`](base::error::Error::Value) for a name that is none in C; otherwise as [`Env::make`] and [`Env::functions`].
pub fn task_as_c(task: &str, config: &EnvConfig, options: &ExportOptions) -> Result<CModule> {
    let config = EnvConfig { n_env: 1, ..config.clone().whole_episodes() };
    let env = Env::make(task, &config)?;
    let functions = env.functions()?;
    let mut module = ModuleBuilder::new(task, format!("the task {task}"), options)?;
    describe(&mut module, &env, &functions);
    module.remembering(&functions.observe, "observe", &first_computation(&functions))?;
    module.remembering(&functions.judge, "judge", "")?;
    module.remembering(&functions.act, "commands", "")?;
    let mut episode = Episode::of(env, &module, &functions)?;
    episode.fly(&mut |_, n| (0..n).map(|k| wave(k, 3)).collect())?;
    episode.golden.into_iter().for_each(|golden| module.golden(golden));
    Ok(module.finished())
}

/// What is observed begins a step: the computation of commands that follows is the first.
pub(crate) fn first_computation(functions: &TaskFunctions) -> String {
    let memory = functions.act.arrays.iter().find(|array| array.access == Access::Update);
    let place = memory.and_then(|memory| memory.numbers.iter().position(|own| own.name == "computation"));
    place.map_or_else(String::new, |place| format!("    memory->commands[{place}] = 0;\n"))
}

/// What a caller needs to know of when to call what.
pub(crate) fn describe(module: &mut ModuleBuilder, env: &Env, functions: &TaskFunctions) {
    let (dt, n_act) = (functions.dt, functions.n_act);
    add_period(module, dt);
    module.define("horizon", functions.horizon.to_string(), "steps of an episode");
    module.define("agents", functions.n_agent.to_string(), "whose numbers stand one behind the other");
    module.define("commands_per_step", n_act.to_string(), "calls of commands in a step");
    let period = module.number(functions.act_period);
    module.define("commands_period", period, "s from call to call of commands");
    module.about.push(format!(
        "Of the task {}: a step is {dt} s. What is observed and judged is the state after a step. Both are shown the first state right after reset too; what is said of its worth does not count. {}",
        env.spec().task,
        if n_act > 1 {
            format!("Commands are computed {n_act} times in a step, with the same action: exactly as often behind what is observed.")
        } else {
            "Commands are computed once in a step.".into()
        }
    ));
    let about = env.task_spec().about.split_whitespace().collect::<Vec<_>>().join(" ");
    if !about.is_empty() {
        module.about.push(about);
    }
    if functions.sees_estimates {
        module.about.push("The state that is observed is meant to be an estimate.".into());
    }
    if begins_with_body(env.robot().plant()) {
        frames::add_state_from_ned(module, env.robot().plant().n_state());
    }
    if env.task_spec().goal.iter().any(|field| field.name.contains("heading")) {
        module.about.push(
            "A heading is a unit vector of the world, (cos yaw, sin yaw, 0); from yaw clockwise from north (cos yaw, -sin yaw, 0)."
                .into(),
        );
    }
    let reads =
        |name: &str| functions.observe.arrays.iter().any(|array| array.name == name && !array.numbers.is_empty());
    if reads("start") {
        module.about.push(
            "`start` is what the task keeps where an episode begins; it is read in the first call behind reset alone."
                .into(),
        );
    }
    if reads("readings") {
        module.about.push(
            "`readings` are those of the sensors that the task simulates, in their order, units and ranges (docs/sensors.md): real \
            ones take their place, and nothing here casts rays."
                .into(),
        );
    }
}

/// The point that a task wants to be held, where it is the same in every episode.
pub(crate) fn fixed_target(env: &mut Env) -> Result<Option<[f64; 3]>> {
    let mut targets = Vec::new();
    let mut out = Buffers::new(env.spec());
    for seed in 0..EPISODES {
        env.reset(None, Some(&[seed]), &mut out.out())?;
        targets.push(rl::policy_controller::goal(env).ok());
    }
    let is_same = targets.iter().all(|target| *target == targets[0]);
    Ok(targets[0].filter(|_| is_same))
}

/// Episodes in which a target that is drawn shows that it is.
const EPISODES: u64 = 4;
