//! `omnidrones tasks`: the benchmark tasks as a list, or one of them with everything that a learner meets.

use super::environment::{self, EnvArguments, QUANTITIES, usual_vehicle};
use crate::prelude::*;
use omnidrones::controllers::cascade::Level;
use omnidrones::rl::load_policy;
use omnidrones::tasks::randomise::RandomisationOperation;
use omnidrones::tasks::registry::{self, REGISTRY, TaskEntry};
use omnidrones::tasks::robot::{DAMPING, MOTOR_TIME_CONSTANT};
use omnidrones::tasks::task_spec::{Field, total};
use omnidrones::tasks::{ActionSpace, Baseline, Env, EnvConfig, Space, Spec};

/// What the command is for.
pub const ABOUT: &str = "\
List the benchmark tasks, or print everything about one: what flies, where episodes start and what the goal is, when \
it counts as reached, what an agent sees and commands, how it is rewarded, the loss of training, when an episode \
ends, which settings there are, and a configuration file to start from. Options show the task as they would make it: \
another vehicle, control level, number of drones.";

const EXAMPLES: &str = "\
Examples:
  omnidrones tasks                              the list
  omnidrones tasks Hover                        one task in full
  omnidrones tasks runs/Hover-apg-s0            that of a run, which may be written in Python
  omnidrones tasks Hover --control rate         what changes if actions are body rates and thrust
  omnidrones tasks OverHover --set n_drone=6    with six drones
  omnidrones tasks Hover --toml > hover.toml    a file to edit, for --config
  omnidrones tasks Track --json                 for a program

Sizes count numbers. Best reward is the largest of one step: the sum of all terms' bounds. Memory is what one environment \
keeps between steps, without the arrays that a step writes. An episode is a success if it meets what the page calls so, and \
nothing terminated it.

The file of --toml is about environments; that of 'omnidrones train TASK --toml' has the settings of training too. Every \
command with --config reads both.

JSON: 'spec' holds sizes, names, units and bounds of the environment; the list is under \"tasks\".

Exit codes: 0 printed; 2 unusable input or arguments.";

/// Arguments of `tasks`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// A task (case does not matter), or the folder of a run for its task; without it, the list
    #[arg(value_name = "TASK")]
    task: Option<String>,
    #[command(flatten)]
    environment: EnvArguments,
    /// Print the configuration as a file that --config reads
    #[arg(long, requires = "task", conflicts_with = "json", help_heading = "Output")]
    toml: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// One environment is built to be asked; the configuration speaks of as many as it says.
fn build(entry: &TaskEntry, config: &EnvConfig) -> Result<Env> {
    entry.env(&EnvConfig { n_env: 1, ..config.clone() })
}

/// Prints.
pub fn run(a: &Arguments) -> Result<Report> {
    let (entry, usual) = match a.task.as_deref() {
        None => (None, EnvConfig::default()),
        Some(named) => named_task(named).map(|(entry, usual)| (Some(entry), usual))?,
    };
    let config = a.environment.config(&usual, entry)?;
    let Some(entry) = entry else { return list(&config, a.json) };
    let task = Described::of(entry, config)?;
    if a.toml {
        return Ok(Report::done(environment::file(task.entry, &task.env, &task.config)?));
    }
    Ok(if a.json { Report::json(&task.json()?, true) } else { Report::page(&task.page()?, true) })
}

/// A task by name, or that of a run, in the environments of the run.
fn named_task(named: &str) -> Result<(&'static TaskEntry, EnvConfig)> {
    let unknown = match registry::by_name(named) {
        Ok(entry) => return Ok((entry, EnvConfig::default())),
        Err(unknown) => unknown,
    };
    if !Path::new(named).is_dir() {
        return Err(unknown);
    }
    let saved = load_policy(named)?;
    Ok((registry::by_name(&saved.manifest.task)?, saved.config.seen_env()))
}

fn list(config: &EnvConfig, as_json: bool) -> Result<Report> {
    let tasks: Vec<(&TaskEntry, Env)> = REGISTRY.iter().map(|e| Ok((e, build(e, config)?))).collect::<Result<_>>()?;
    if as_json {
        let rows: Vec<Value> = tasks.iter().map(|(entry, env)| summary(entry, env.spec())).collect();
        return Ok(Report::json(&json!({ "command": "tasks", "tasks": rows }), true));
    }
    let mut table = Table::new("task | >agents | >sees | >acts | >steps | >best | goal");
    let mut page = Page::new();
    let mut families: Vec<&str> = Vec::new();
    for (entry, _) in &tasks {
        if !families.contains(&entry.family) {
            families.push(entry.family);
        }
    }
    for family in families {
        if !table.is_empty() {
            table.row([""]);
        }
        for (entry, env) in tasks.iter().filter(|(entry, _)| entry.family == family) {
            let spec = env.spec();
            table.row([
                entry.name.to_string(),
                spec.n_agent.to_string(),
                spec.n_observation.to_string(),
                spec.action.len().to_string(),
                spec.horizon.to_string(),
                short(spec.reward_bound, 3),
                entry.description.to_string(),
            ]);
        }
    }
    page.table(table);
    page.prose(format!(
        "\n'sees' and 'acts' count the numbers of one agent's observation and action in a step of {} s, 'steps' those of \
         an episode; 'best' is the largest reward of a step, which all agents of a team share.\n",
        short(config.dt, 3)
    ));
    page.line("omnidrones tasks TASK prints one in full, omnidrones rollout TASK flies it.");
    Ok(Report::page(&page, true))
}

fn summary(entry: &TaskEntry, spec: &Spec) -> Value {
    json!({
        "name": entry.name,
        "description": entry.description,
        "family": entry.family,
        "n_agent": spec.n_agent,
        "n_observation": spec.n_observation,
        "n_action": spec.action.len(),
        "n_central": spec.n_central,
        "horizon": spec.horizon,
        "dt": spec.dt,
        "reward_floor": spec.reward_floor,
        "reward_bound": spec.reward_bound,
        "bytes_per_env": spec.bytes_per_env,
    })
}

/// A task as its configuration makes it.
struct Described {
    entry: &'static TaskEntry,
    config: EnvConfig,
    env: Env,
    /// Name of the controller that can fly it, or why none can.
    controller: std::result::Result<String, String>,
    levels: Vec<Level>,
}

impl Described {
    fn of(entry: &'static TaskEntry, config: EnvConfig) -> Result<Self> {
        let env = build(entry, &config)?;
        let at = |control| build(entry, &EnvConfig { control, ..config.clone() });
        let controller = at(Level::Rotor).and_then(|env| Ok(Baseline::new(&env)?.name().to_string()));
        let levels = Level::ALL.into_iter().filter(|level| at(*level).is_ok()).collect();
        Ok(Self { entry, env, controller: controller.map_err(|e| e.to_string()), levels, config })
    }

    fn page(&self) -> Result<Page> {
        let mut page = Page::new();
        let (spec, own) = (self.env.spec(), self.env.task_spec());
        page.title(self.entry.name, &self.entry.about()).facts(self.facts());
        page.heading("Goal, start, success, loss of training");
        page.prose(format!("  {}", self.about()));
        page.prose(format!("  Success: {} (not terminated; nothing else counts)", own.success.text()));
        page.prose(format!("  Loss: {}", own.loss_text()));
        match whole_numbers(spec) {
            None => page.heading("Action, each number clipped to [−1, 1]"),
            Some(how) => page.heading("Commands behind the action").line(format!("  {how}\n")),
        };
        page.table(self.meanings());
        page.heading("Observation").table(fields(&spec.observation));
        page.line("  Quaternions are [w, x, y, z], body → world.");
        if !spec.central.is_empty() {
            page.heading("Central state, for critics that see all").table(fields(&spec.central));
        }
        page.heading("Reward").table(self.reward());
        page.heading("Episode end").table(self.ends());
        page.heading("Told in every step").table(self.infos());
        page.heading("Configuration").table(self.settings());
        page.heading("What --randomise can draw for every episode").facts(quantities());
        if !own.task_state.is_empty() || !own.goal.is_empty() {
            let names = |fields: &[Field]| fields.iter().map(|s| s.name.clone()).collect::<Vec<_>>().join(", ");
            let kept = [("goal", names(&own.goal)), ("task state", names(&own.task_state))];
            let kept: Vec<Fact> =
                kept.into_iter().filter(|k| !k.1.is_empty()).map(|(n, what)| Fact::new(n, what)).collect();
            page.heading("What the task keeps through an episode").facts(kept);
        }
        page.heading("Configuration file, as --toml prints it");
        for line in environment::file(self.entry, &self.env, &self.config)?.lines() {
            page.line(if line.is_empty() { String::new() } else { format!("  {line}") });
        }
        Ok(page)
    }

    /// Symbols, target and start, and what a variant has of its own.
    fn about(&self) -> String {
        format!("{} {}", self.env.task_spec().about, self.entry.own).trim_end().to_string()
    }

    /// What flies, in a few words.
    fn craft(&self) -> (String, String) {
        let robot = self.env.robot();
        let vehicle = usual_vehicle(self.env.task_spec());
        let drone = robot.drone();
        let drives = match drone.drives.len() {
            0 => String::new(),
            n => format!(" and {n} drives"),
        };
        let each = if robot.drones().len() == 1 { "" } else { " each" };
        let parts = format!("{}{drives}{each}", counted(drone.rotors.len(), "rotor"));
        match (robot.model(), vehicle) {
            (None, vehicle) => (vehicle.unwrap_or_else(|| "a vehicle".into()), parts),
            (Some(model), Some(vehicle)) => {
                let count = robot.drones().len();
                let times = if count == 1 { String::new() } else { format!("{count} × ") };
                (
                    format!("{times}{vehicle}"),
                    format!("{parts}; {} bodies, {} kg", model.bodies().len(), short(model.mass(), 4)),
                )
            }
            (Some(model), None) => (
                model.name().into(),
                format!("{parts}; {} bodies, {} kg", model.bodies().len(), short(model.mass(), 4)),
            ),
        }
    }

    fn facts(&self) -> Vec<Fact> {
        let (spec, (craft, parts)) = (self.env.spec(), self.craft());
        let physics = self.env.robot().physics();
        let seconds = spec.horizon as f64 * spec.dt;
        let levels: Vec<&str> = self.levels.iter().map(|l| l.name()).collect();
        let n = self.config.n_env;
        let together =
            format!("{n} environments keep {} MiB", short((n * spec.bytes_per_env) as f64 / f64::from(1 << 20), 3));
        let share = if spec.n_agent == 1 { "" } else { "one per drone, they share the reward" };
        let mut facts = vec![
            Fact::new("what flies", craft).note(parts),
            Fact::new("agents", spec.n_agent.to_string()).note(share),
            Fact::new("action", action(&spec.action)).note(commands(&spec.commands)),
            Fact::new("control", spec.config.control.name()).note(format!("possible: {}", levels.join(", "))),
            Fact::new("observation", format!("{} numbers", spec.n_observation)).note("of each agent"),
        ];
        facts.push(
            Fact::new("motors and drag", format!("lag {} ms, fades at {DAMPING} 1/s", 1e3 * MOTOR_TIME_CONSTANT))
                .note("the benchmark's; mass, inertia and rotors are the vehicle's own"),
        );
        facts.extend(lean(self.env.robot().hover_lean(), spec));
        if spec.n_central > 0 {
            facts.push(Fact::new("central state", format!("{} numbers", spec.n_central)));
        }
        facts.extend([
            Fact::new("episode", format!("{} steps", spec.horizon)).note(format!("{} s", short(seconds, 3))),
            Fact::new("step", format!("{} s", short(spec.dt, 4))).note(integration(physics, &self.config)),
            Fact::new("best reward", short(spec.reward_bound, 4))
                .note(format!("per step; {} per episode", short(spec.reward_bound * spec.horizon as f64, 5))),
            Fact::new("memory", format!("{} bytes", spec.bytes_per_env)).note(together),
        ]);
        if !spec.privileged.is_empty() {
            let owner = |name: &str| name.rsplit_once('.').map_or(name, |(owner, _)| owner).to_string();
            let mut owners: Vec<String> = spec.privileged.iter().map(|(name, _)| owner(name)).collect();
            owners.dedup();
            let what = format!("per episode, of {}", some(&owners, 2));
            facts.push(Fact::new("drawn", format!("{} numbers", spec.privileged.len())).note(what));
        }
        facts.push(match &self.controller {
            Ok(name) => Fact::new("controller", name).note("'omnidrones rollout' flies it"),
            Err(_) => Fact::new("controller", "none").note("no reference says what this task wants"),
        });
        facts
    }

    /// What −1 … 1 of every command means.
    fn meanings(&self) -> Table {
        Table::new("command | −1 … 1 means")
            .filled(commands_of(&self.env).into_iter().map(|(names, meaning)| [commands(&names), meaning]))
    }

    fn reward(&self) -> Table {
        let mut table = Table::new("term | >at least | >at most | gradient | is");
        for t in &self.env.task_spec().reward {
            table.row([
                t.name.to_string(),
                short(t.low, 4),
                short(t.bound, 4),
                t.smoothness.name().into(),
                t.formula.clone(),
            ]);
        }
        let spec = self.env.spec();
        table.row(["sum".into(), short(spec.reward_floor, 4), short(spec.reward_bound, 4)]);
        table
    }

    fn ends(&self) -> Table {
        let mut table = Table::new("reason | flag | when");
        for e in &self.env.task_spec().ends {
            table.row([&e.name, "terminated", &e.condition]);
        }
        let diverged = self.env.spec().diverged();
        table.row([&diverged.name, "terminated", &diverged.condition]);
        table.row(["time", "truncated", &format!("{} steps are over", self.env.spec().horizon)]);
        table
    }

    fn infos(&self) -> Table {
        Table::new("info | unit | meaning")
            .filled(self.env.spec().info.iter().map(|info| [&info.name, &info.unit, &info.meaning]))
    }

    fn settings(&self) -> Table {
        let mut table = Table::new("key in [task] | default | meaning").with_sentences();
        let defaults = self.entry.default_config().map(|c| c.task).unwrap_or_default();
        for s in &self.env.task_spec().settings {
            let default = defaults.get(&s.key).unwrap_or(&s.default).to_string();
            table.row([&s.key, &default, &s.text()]);
        }
        table
    }

    fn json(&self) -> Result<Value> {
        let mut spec = self.env.spec().clone();
        (spec.n_env, spec.config.n_env) = (self.config.n_env, self.config.n_env);
        let quantities: Vec<String> = QUANTITIES.iter().map(|(what, ..)| environment::quantity_name(what)).collect();
        let mut value = summary(self.entry, &spec);
        value["command"] = json!("tasks");
        value["what_flies"] = json!(self.craft().0);
        value["control_levels"] = json!(self.levels);
        value["setting"] = json!(self.about());
        value["success"] = json!(self.env.spec().success.text());
        value["loss"] = json!(self.env.task_spec().loss_text());
        let meanings = commands_of(&self.env);
        value["actions"] = meanings.iter().map(|(names, means)| json!({ "commands": names, "means": means })).collect();
        value["controller"] = json!(self.controller.as_ref().ok());
        value["task_spec"] = json!(self.env.task_spec());
        value["randomise"] = json!(quantities);
        value["spec"] = json!(spec);
        value["toml"] = json!(environment::file(self.entry, &self.env, &self.config)?);
        Ok(value)
    }
}

/// Commands of one agent that mean the same, and what that is.
fn commands_of(env: &Env) -> Vec<(Vec<String>, String)> {
    let (spec, scale) = (env.spec(), env.spec().config.action_scale);
    let by = |k: f64, what: &str| format!("{} … {} {what}", short(-k, 4), short(k, 4));
    let thrust = || "0 … the largest thrust of all rotors, along body z".to_string();
    let three = |k: f64, what: &str| (3, by(k, what));
    let groups: Vec<(usize, String)> = match spec.config.control {
        Level::Rotor => {
            let rotors = env.robot().drone().rotors.len();
            let throttle =
                "throttle: 0 … largest thrust, linear in thrust; the rotor follows with the lag of its motor";
            [(rotors, throttle.to_string())].into_iter().chain(drives(env)).collect()
        }
        Level::Rate => vec![three(scale.rate, "rad/s, body"), (1, thrust())],
        Level::Attitude => {
            vec![(1, thrust()), (1, by(scale.yaw_rate, "rad/s")), (2, by(scale.tilt, "rad about the present heading"))]
        }
        Level::Velocity => vec![three(scale.velocity, "m/s, world"), (1, by(scale.yaw, "rad, world"))],
        Level::Position => {
            vec![three(scale.position, "m from where the drone is, world"), (1, by(scale.yaw, "rad, world"))]
        }
    };
    let mut names = spec.commands.iter().cloned();
    groups.into_iter().map(|(n, meaning)| (names.by_ref().take(n).collect(), meaning)).collect()
}

/// Drives of one drone in groups of the same target.
fn drives(env: &Env) -> Vec<(usize, String)> {
    let Some(model) = env.robot().model() else { return Vec::new() };
    let layout = model.layout();
    let target = |command: usize| {
        let body = layout.drive.iter().position(|at| *at == Some(command))?;
        let drive = model.bodies()[body].joint.drive?;
        let ends = [drive.center - drive.range, drive.center + drive.range].map(|x| short(x, 4));
        let of = if drive.stiffness == 0.0 { "rad/s, wanted rate of a joint" } else { "rad, wanted angle of a joint" };
        Some(format!("{} … {} {of}", ends[0], ends[1]))
    };
    let all: Vec<String> = env.robot().drone().drives.iter().filter_map(|d| target(d.command)).collect();
    all.chunk_by(|a, b| a == b).map(|group| (group.len(), group[0].clone())).collect()
}

/// Fields with their places.
fn fields(fields: &[Field]) -> Table {
    let mut table = Table::new(">place | name | >size | unit, frame | meaning").with_sentences();
    let mut at = 0;
    for s in fields {
        let place = if s.size == 1 { at.to_string() } else { format!("{at}–{}", (at + s.size).saturating_sub(1)) };
        at += s.size;
        table.row([&place, &s.name, &s.size.to_string(), &s.unit, &s.meaning]);
    }
    table.row(["", "all", &total(fields).to_string()]);
    table
}

fn quantities() -> Vec<Fact> {
    let how = |action: RandomisationOperation| match action {
        RandomisationOperation::Scale => "times",
        RandomisationOperation::Add => "plus",
        RandomisationOperation::Set => "is",
    };
    let fact = |(what, action, meaning): &(_, RandomisationOperation, &str)| {
        Fact::new(environment::quantity_name(what), how(*action)).note(*meaning)
    };
    QUANTITIES.iter().map(fact).collect()
}

/// By how much a vehicle leans in hover, and what that costs: reward, and success where it asks for more uprightness.
pub fn lean(lean: f64, spec: &Spec) -> Option<Fact> {
    if lean <= 0.0 {
        return None;
    }
    let up = lean.cos();
    let mut note = format!(
        "in hover, where episodes start: what is rewarded for body z upright is {} of its most",
        short(0.25 * (1.0 + up).powi(2), 4)
    );
    if let Some(limit) = spec.success.limits.iter().find(|l| l.metric == "uprightness" && !l.holds(up)) {
        note += &format!(
            "; a success asks for an uprightness above {}, and hover has {}: none is in reach at rest. Lower success.alignment, \
             or change the vehicle",
            short(limit.above, 4),
            short(up, 4)
        );
    }
    Some(Fact::new("leans", format!("{}°", short(lean.to_degrees(), 3))).note(note))
}

fn action(space: &Space) -> String {
    match space {
        Space::Box { n, low, high } => format!("{n} numbers in [{low}, {high}]"),
        Space::Discrete { n } => format!("one of {n} values"),
        Space::MultiDiscrete { n, levels } => format!("{n} numbers of {levels} values"),
    }
}

/// How the whole numbers of an action become commands; none where the action is the commands.
fn whole_numbers(spec: &Spec) -> Option<String> {
    match spec.config.actions {
        ActionSpace::Continuous => None,
        ActionSpace::MultiDiscrete { levels } => {
            let most = levels - 1;
            Some(format!("A whole number k from 0 to {most} for each command, which is then 2k/{most} − 1."))
        }
        ActionSpace::Discrete { levels } => {
            let (n, most) = (spec.commands.len(), levels - 1);
            Some(format!(
                "One whole number. Its {n} digits to the base {levels}, the highest first, stand for the commands: \
                 digit k for 2k/{most} − 1."
            ))
        }
    }
}

/// `rotor_0 … rotor_3, drive_0 … drive_5`: runs of numbered names by their ends.
fn commands(names: &[String]) -> String {
    let stem = |name: &str| name.trim_end_matches(|c: char| c.is_ascii_digit()).to_string();
    let runs = names.chunk_by(|a, b| stem(a) == stem(b) && stem(a) != *a);
    let run = |run: &[String]| match run {
        [one] => one.clone(),
        [first, .., last] => format!("{first} … {last}"),
        [] => String::new(),
    };
    runs.map(run).collect::<Vec<_>>().join(", ")
}

/// The first `most`, and how many more there are.
fn some(names: &[String], most: usize) -> String {
    let shown = names.iter().take(most).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > most { format!("{shown} … and {} more", names.len() - most) } else { shown }
}

fn integration(physics: &omnidrones::dynamics::Physics, config: &EnvConfig) -> String {
    use omnidrones::dynamics::Integrator;
    let name = match physics.integrator {
        Integrator::RungeKutta4 => "Runge–Kutta 4",
        Integrator::SemiImplicit => "semi-implicit",
    };
    let steps = config.control_steps() * physics.substeps;
    format!("{name}, {}", if steps == 1 { "one integrator step".into() } else { format!("{steps} integrator steps") })
}
