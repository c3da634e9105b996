//! `omnidrones export`: a vehicle, a controller, a policy, a task or a reference as C99; a policy as ONNX.

mod kind;

use self::kind::Kind;
use super::arguments::{self, FlightArguments, IntegratorName, VehicleArguments};
use super::environment::EnvArguments;
use super::filters::FilterArguments;
use super::{robot, source};
use crate::prelude::*;
use omnidrones::controllers::registry::{REGISTRY, Setup, controller};
use omnidrones::controllers::{Controller, Rates};
use omnidrones::dynamics::{Physics, Plant};
use omnidrones::export::{
    self, CModule, ExportOptions, ExportPrecision, compiler, controller_as_c, plant_as_c, reference_as_c,
    saved_policy_as_c, task_as_c,
};
use omnidrones::rl::checkpoint::SkippedCheckpoint;
use omnidrones::rl::{SavedPolicy, load_policy};
use omnidrones::tasks::{Env, EnvConfig, registry};

/// What the command is for.
pub const ABOUT: &str = "\
Write what flew here for a flight computer. 'c' writes a vehicle's step, a controller's tick, a policy with what it observes, a task's \
observation, reward and ends, or a reference, as C99: no heap, no globals that change, sizes and units in the header, golden \
vectors beside it. 'onnx' writes a policy for whoever runs ONNX, its normalisation inside.";

const EXAMPLES: &str = "\
Examples:
  omnidrones export c cascade --vehicle hummingbird   a controller
  omnidrones export c runs/Hover-apg-s0               a policy
  omnidrones export onnx runs/Hover-apg-s0            the same for whoever runs ONNX

'omnidrones export c --help' tells of C, 'omnidrones export onnx --help' of ONNX.";

/// Arguments of `export`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    format: Format,
}

#[derive(Debug, clap::Subcommand)]
enum Format {
    /// C99: NAME.h, NAME.c, NAME_test.c, NAME.md
    #[command(long_about = ABOUT_C)]
    C(Box<CArguments>),
    /// A policy as one ONNX file
    #[command(long_about = ABOUT_ONNX)]
    Onnx(OnnxArguments),
}

const ABOUT_C: &str = "\
Write something as C99 that compiles anywhere: header with sizes, indices and units, source, a test with golden vectors, and a page \
about it. What cannot be written so is refused with the reason.

A name says what it is: a vehicle or configuration ('omnidrones models', 'omnidrones show'), a controller ('omnidrones fly --help'), \
a task ('omnidrones tasks'), a reference; the folder of a run is a policy. --kind settles it where a name is several.";

const EXAMPLES_C: &str = "\
Examples:
  omnidrones export c hummingbird                        a step of the vehicle
  omnidrones export c cascade --vehicle hummingbird      its controller, with published gains
  omnidrones export c cascade --vehicle firefly --gains out/firefly/gains.toml   with tuned ones
  omnidrones export c indi --vehicle firefly --check     with its allocation; compiled and tested here
  omnidrones export c lqr --vehicle crazyflie --precision double
  omnidrones export c lemniscate                         where to be at a time
  omnidrones export c runs/Hover-apg-s0 --name hover     a policy: state and goal in, action out
  omnidrones export c Track --horizon 900                what the task observes, rewards and ends

Files in --out: NAME.h, NAME.c, NAME_test.c, NAME.md. Several modules may share a folder. An earlier export of the same \
thing is replaced, another module or file with --force alone.

JSON: functions with their prototypes, bytes of stack, operations; files.

Exit codes: 0 written, and good where --check asked; 1 --check failed; 2 unusable input or arguments, or nothing that can be \
written in C.";

/// Numbers of the text.
const PRECISIONS: [(&str, &str, ExportPrecision); 2] = [
    ("float", "32 bits, for processors that have no more", ExportPrecision::Single),
    ("double", "64 bits, with the bits that flew here", ExportPrecision::Double),
];

/// Arguments of `export c`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES_C)]
#[command(mut_arg("vehicle", |a| a.help("Whose controller it is, or what flies in a task: a vehicle, a configuration or a file").value_name("NAME|FILE")))]
#[command(mut_arg("dt", |a| a.help("Time of a step [s] [default: 0.002; tasks 0.016]")))]
#[command(mut_arg("seed", |a| a.hide(true)), mut_arg("randomise", |a| a.hide(true)))]
struct CArguments {
    /// A vehicle, a configuration, a controller, a task, a reference, a file, or the folder of a run
    #[arg(value_name = "MODEL|CONTROLLER|POLICY|TASK|REFERENCE")]
    what: String,
    /// What the name means, where it may mean several
    #[arg(long, value_name = "KIND", value_parser = arguments::one_of(&Kind::NAMES))]
    kind: Option<Kind>,
    /// Its numbers
    #[arg(long, value_name = "TYPE", default_value = "float", value_parser = arguments::one_of(&PRECISIONS))]
    precision: ExportPrecision,
    #[command(flatten)]
    env: EnvArguments,
    #[command(flatten)]
    rotors: VehicleArguments,
    /// How often the levels of a controller compute [Hz]; each must divide 1/dt [default: 500,250,100]
    #[arg(long, value_name = "RATE,ATTITUDE,VELOCITY", value_parser = arguments::rates, allow_hyphen_values = true,
          help_heading = "Controller")]
    rates: Option<Rates>,
    /// Gains of a controller: published, derived, or a TOML file ('omnidrones tune' writes one)
    #[arg(long, value_name = "NAME|FILE.toml", help_heading = "Controller")]
    gains: Option<String>,
    #[command(flatten)]
    filters: FilterArguments,
    /// What files and functions begin with [default: after what it is]
    #[arg(long, value_name = "NAME", help_heading = "Output")]
    name: Option<String>,
    /// Folder for what is written [default: out/c]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Compile it with the C compiler of this machine ($CC, or cc) and run its test
    #[arg(long, help_heading = "Output")]
    check: bool,
    /// Replace other modules and files of others too
    #[arg(long, help_heading = "Output")]
    force: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

const ABOUT_ONNX: &str = "\
Write the policy of a run as ONNX (opset 17): input 'observation' [batch, numbers] as environments show it before it is normalised, \
output 'action' [batch, numbers], the most likely one; of a network with memory also 'memory' and 'memory_next'. Names, sizes and \
units of what is observed stand in the file's metadata.";

const EXAMPLES_ONNX: &str = "\
Examples:
  omnidrones export onnx runs/Hover-apg-s0                       writes out/onnx/Hover.onnx
  omnidrones export onnx runs/Hover-apg-s0 --out hover.onnx

In Python: onnxruntime.InferenceSession('hover.onnx').run(None, {'observation': rows}); of a network with memory also \
'memory': zeros [batch, numbers], then what came back as 'memory_next'.

Exit codes: 0 written; 2 unusable input or arguments.";

/// Arguments of `export onnx`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES_ONNX)]
struct OnnxArguments {
    /// The folder of a run, or of one of its checkpoints
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Of this agent, where agents have networks of their own
    #[arg(long, value_name = "N", default_value_t = 0)]
    agent: usize,
    /// The file [default: out/onnx/TASK.onnx]
    #[arg(long, value_name = "FILE.onnx", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long, help_heading = "Output")]
    force: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// Exports.
pub fn run(a: &Arguments) -> Result<Report> {
    match &a.format {
        Format::C(own) => as_c(own),
        Format::Onnx(own) => as_onnx(own),
    }
}

fn as_c(a: &CArguments) -> Result<Report> {
    let kind = a.kind.map_or_else(|| Kind::of(&a.what), Ok)?;
    a.refuse(kind)?;
    let spinner = progress::spinner("writing", a.json);
    let module = a.module(kind)?;
    let said = if a.check { Some(checked(&module)?) } else { None };
    spinner.finish_and_clear();
    let folder = a.out.clone().unwrap_or_else(|| "out/c".into());
    let written = module.write(&folder, a.force)?;
    let good = said.as_ref().is_none_or(std::result::Result::is_ok);
    let said = said.map(|said| said.unwrap_or_else(|said| said));
    if a.json {
        return Ok(Report::json(&json_of(&module, said.as_deref(), good, &written), good));
    }
    Ok(Report::page(&page_of(&module, said.as_deref(), &written), good))
}

/// The words that were typed.
fn command_line() -> String {
    let word = |word: String| if word.contains(char::is_whitespace) { format!("'{word}'") } else { word };
    ["omnidrones".to_string()].into_iter().chain(std::env::args().skip(1).map(word)).collect::<Vec<_>>().join(" ")
}

/// Says where an older checkpoint is exported than the newest.
fn tell_of_damage(saved: &SavedPolicy) {
    for SkippedCheckpoint { folder, why } in &saved.skipped {
        eprintln!(
            "warning: an older checkpoint is exported: {} is damaged ({why})",
            shown(&folder.display().to_string())
        );
    }
}

/// What the test said, good or not.
fn checked(module: &CModule) -> Result<std::result::Result<String, String>> {
    if !compiler::has_compiler() {
        let remedy = "Install one, name it in $CC, or leave --check out.";
        let value = format!("'{}', which cannot be run", compiler::compiler());
        return Err(Error::value("C compiler of --check", value, "one that runs", remedy));
    }
    Ok(compiler::checked(module, &["-O2"]).map_err(|error| error.to_string()))
}

impl CArguments {
    /// Refuses options that such a thing does not take.
    fn refuse(&self, kind: Kind) -> Result<()> {
        use Kind::{Controller, Model, Policy, Reference, Task};
        let filters = self.filters.given().is_some();
        let takes = [
            ("--vehicle", self.env.vehicle().is_some(), &[Controller, Task][..]),
            ("--rates", self.rates.is_some(), &[Controller]),
            ("--gains", self.gains.is_some(), &[Controller]),
            ("--filters", filters, &[Controller]),
            (
                "--rotors or --package",
                self.rotors.rotors.is_some() || !self.rotors.package.is_empty(),
                &[Controller, Model],
            ),
            ("--dt or --integrator", self.env.has_physics(), &[Controller, Model, Task]),
            ("--config, --set, --control, --horizon or --randomise", self.env.has_settings(), &[Task]),
            ("--seed", self.env.seed().is_some(), &[]),
        ];
        let name = |kind: &Kind| kind.name();
        match takes.into_iter().find(|(_, given, kinds)| *given && !kinds.contains(&kind)) {
            None => Ok(()),
            Some((option, _, kinds)) => {
                let of = kinds.iter().map(name).collect::<Vec<_>>().join(", ");
                let value = format!("given with a {}", kind.name());
                if kinds.is_empty() {
                    let remedy = "Leave it out: nothing is drawn.";
                    return Err(Error::value(option, value, "left out of exports", remedy));
                }
                let remedy = match kind {
                    Policy | Reference => "It has all its numbers.",
                    _ => "Leave it out.",
                };
                Err(Error::value(option, value, format!("an option of {of}"), remedy))
            }
        }
    }

    fn module(&self, kind: Kind) -> Result<CModule> {
        let origin = Some(command_line());
        let options = ExportOptions { name: self.name.clone(), precision: self.precision, origin };
        match kind {
            Kind::Model => plant_as_c(&self.plant(&self.what)?.0, &options),
            Kind::Controller => {
                let (plant, own) = self.controller()?;
                controller_as_c(&*own, &plant, &options)
            }
            Kind::Policy => {
                let saved = load_policy(&self.what)?;
                tell_of_damage(&saved);
                saved_policy_as_c(&saved, &options)
            }
            Kind::Reference => reference_as_c(&arguments::reference(&self.what)?, &options),
            Kind::Task => {
                let entry = registry::by_name(&self.what)?;
                let usual = EnvConfig { n_env: 1, ..EnvConfig::default() };
                task_as_c(entry.name, &self.env.config(&usual, Some(entry))?, &options)
            }
        }
    }

    fn flight(&self) -> FlightArguments {
        FlightArguments {
            reference: None,
            dt: self.env.dt().unwrap_or(Physics::default().dt),
            substeps: 1,
            integrator: self.env.integrator_name().unwrap_or(IntegratorName::Rk4),
            effects: None,
            no_effects: false,
            rates: self.rates,
            gains: self.gains.clone(),
        }
    }

    /// What is named, and the vehicle that it is, if it is one.
    fn plant(&self, named: &str) -> Result<(Plant, Option<source::Source>)> {
        let flight = self.flight();
        flight.check()?;
        robot::known(named)?;
        if robot::configuration(named).is_some() {
            return Ok((Plant::of_model(&robot::load(named, &self.rotors)?.model, flight.physics())?, None));
        }
        let load = if self.json { source::load } else { source::to_use };
        let source = load(Some(named), &self.rotors)?;
        Ok((Plant::of_vehicle(&source.vehicle, flight.physics())?, Some(source)))
    }

    fn controller(&self) -> Result<(Plant, Box<dyn Controller>)> {
        if !REGISTRY.iter().any(|entry| entry.name == self.what) {
            let known = REGISTRY.iter().map(|entry| entry.name.into()).collect();
            return Err(Error::Unknown { kind: "controller", name: self.what.clone(), known });
        }
        let Some(named) = self.env.vehicle() else {
            let what = format!("--vehicle of controller '{}'", self.what);
            return Err(Error::value(what, "left out", "given", "Say what it flies: --vehicle hummingbird."));
        };
        let (plant, source) = self.plant(named)?;
        let flight = self.flight();
        arguments::check_gains(&flight, Some(&self.what), source.is_some())?;
        let gains = match &source {
            Some(source) => Some(flight.gains(&source.vehicle)?.0),
            None => flight.own_gains()?,
        };
        let (filters, rates) = (self.filters.settings()?, flight.rates());
        let setup = Setup { filters: &filters, ..Setup::new(gains.as_ref(), &rates) };
        let own = controller(&self.what, &plant, &setup)?;
        Ok((plant, own))
    }
}

fn json_of(module: &CModule, said: Option<&str>, good: bool, written: &[PathBuf]) -> Value {
    let function = |own: &export::ExportedFunction| {
        json!({
            "name": own.name,
            "prototype": own.prototype,
            "about": own.about,
            "stack_bytes": own.stack,
            "operations": own.n_instruction,
            "operations_at_most": own.n_most,
        })
    };
    json!({
        "command": "export c",
        "name": module.name,
        "title": module.title,
        "precision": module.precision.c_type(),
        "functions": module.functions.iter().map(function).collect::<Vec<_>>(),
        "memory_bytes": module.memory,
        "table_bytes": module.tables,
        "check": said.map(|said| json!({ "good": good, "said": said.trim() })),
        "files": files::names(written),
    })
}

fn page_of(module: &CModule, said: Option<&str>, written: &[PathBuf]) -> Page {
    let mut page = Page::new();
    page.title(&module.name, &format!("{}, in {}", module.title, module.precision.c_type()));
    let mut facts = vec![Fact::new("kept by the caller", format!("{} bytes", module.memory))];
    if module.tables > 0 {
        facts.push(Fact::new("tables", format!("{} bytes of constants", module.tables)));
    }
    page.line("").facts(facts);
    let mut table = Table::new("function | >stack [bytes], at most | >operations | >at most");
    for own in &module.functions {
        let numbers = [own.stack, own.n_instruction, own.n_most].map(|n| n.to_string());
        table.row([own.name.clone()].into_iter().chain(numbers));
    }
    page.heading("Functions").table(table);
    if let Some(said) = said {
        page.heading("Test").line("");
        said.lines().filter(|line| !line.trim().is_empty()).for_each(|line| _ = page.line(format!("  {line}")));
    }
    page.written(written);
    page
}

fn as_onnx(a: &OnnxArguments) -> Result<Report> {
    let saved = load_policy(&a.run)?;
    tell_of_damage(&saved);
    let env = Env::make(&saved.manifest.task, &EnvConfig { n_env: 1, ..saved.config.seen_env() })?;
    let bytes = export::onnx::onnx(&saved.policy, env.spec(), a.agent)?;
    let path = a.out.clone().unwrap_or_else(|| format!("out/onnx/{}.onnx", saved.manifest.task).into());
    if path.extension().is_none_or(|e| e != "onnx") {
        let value = format!("'{}'", path.display());
        return Err(Error::value("--out", value, "a file that ends in .onnx", "Name it so: others know it by that."));
    }
    files::write_new(&path, &bytes, a.force)?;
    let (spec, written) = (env.spec(), vec![path]);
    let memory = saved.policy.n_state();
    if a.json {
        let value = json!({
            "command": "export onnx",
            "task": spec.task,
            "observation": spec.n_observation,
            "action": spec.action.len(),
            "memory": memory,
            "bytes": bytes.len(),
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.title(&spec.task, "a policy as ONNX");
    let mut facts = vec![
        Fact::new("observation", format!("{} numbers, not normalised", spec.n_observation)),
        Fact::new("action", format!("{} numbers: {}", spec.action.len(), spec.commands.join(", "))),
    ];
    if memory > 0 {
        facts.push(Fact::new("memory", format!("{memory} numbers, zeros where an episode begins")));
    }
    facts.push(Fact::new("size", format!("{} bytes", count(bytes.len() as f64))));
    page.line("").facts(facts);
    page.written(&written);
    Ok(Report::page(&page, true))
}
