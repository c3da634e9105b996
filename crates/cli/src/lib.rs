//! The `omnidrones` command line: arguments in, one page or one JSON object out, an exit code. `omnidrones --help`.
//!
//! | file | idea |
//! |---|---|
//! | `fly.rs`, `allocate.rs`, `show.rs`, `models.rs`, `import.rs`, `design.rs`, `linearise.rs`, `recover.rs`, `tune.rs`, `optimise.rs`, `tasks.rs`, `export.rs`, `rollout.rs`, `train.rs`, `train_all.rs`, `study.rs`, `eval.rs`, `watch.rs`, `report.rs`, `replay.rs`, `view.rs`, `bench.rs` | one command each |
//! | `arguments.rs` | arguments that commands share, how they are read, and the folder that they write into |
//! | `prelude.rs` | what every command speaks of |
//! | `environment.rs` | which environments: shared by `tasks`, `rollout`, `eval`, `watch` and `bench` |
//! | `episodes.rs` | episodes that were flown, by whomever: what is seen and told of them |
//! | `shown.rs` | whose episodes are shown: a run's policy's or a task's controller's |
//! | `baseline.rs` | our controller from the starts of a run, and figures beside each other |
//! | `rollout_all.rs` | `rollout --all`: every task, one line each |
//! | `rollout_files.rs` | which episodes are asked for; their plots and files |
//! | `train_plot.rs`, `train_all_plot.rs` | the learning curves of `train` and `train-all` |
//! | `fly/` | derivatives of what was flown; an earlier flight beside it; drops; verdicts; yaw meant in degrees |
//! | `optimise/` | a planned trajectory: its files, figures, reference, page |
//! | `design/` | the figures of `design`, its report |
//! | `export/` | what a name means that is to be exported |
//! | `report/` | `report` of single runs, and of folders of several |
//! | `run_table.rs` | rows of tables of runs, kept in files: what `train-all` and `study` train |
//! | `study/` | the curves of a study; what it compares is in `omnidrones-studies` |
//! | `source.rs` | a vehicle from a name, a TOML or a URDF |
//! | `robot.rs` | what flies: a vehicle, a configuration, or a vehicle as one body |
//! | `sheet.rs` | a vehicle's numbers as tables and JSON |
//! | `failure.rs` | rotors that fail: arguments, what is left |
//! | `files.rs` | reading and writing behind fences |
//! | `words.rs` | numbers and names in words |
//! | `page.rs`, `table.rs` | what a command tells: headings, facts, tables, drawings; as text |
//! | `html.rs` | the same for a browser, and as Markdown |
//! | `progress.rs` | bars while work goes on |
//! | `npz.rs`, `trajectories.rs` | logs for other programs |
//!
//! A command returns its whole [`Report`] before a line is printed: a broken pipe or a full disk then meets one write.
//! The program is [`main`] alone; a library stands behind it so that a fuzzer can call [`outcome`] in its own process.

#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod allocate;
mod arguments;
mod baseline;
mod bench;
mod benchmark;
mod design;
mod environment;
mod episodes;
mod eval;
mod export;
mod failure;
mod files;
mod filters;
mod fly;
mod html;
mod import;
mod linearise;
mod models;
mod npz;
mod optimise;
mod over_seeds;
mod page;
mod prelude;
mod progress;
mod recover;
mod replay;
mod report;
mod robot;
mod robustness;
mod rollout;
mod rollout_all;
mod rollout_files;
mod run_table;
mod sheet;
mod show;
mod shown;
mod source;
mod study;
mod table;
mod tasks;
mod train;
mod train_all;
mod train_all_plot;
mod train_plot;
mod train_search;
mod train_seeds;
mod trajectories;
mod tune;
mod tune_grid;
mod view;
mod watch;
mod words;

use self::page::Page;
use clap::error::{ContextKind, ContextValue};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use omnidrones::internals;
use serde_json::{Value, json};
use std::ffi::OsString;
use std::io::{ErrorKind, IsTerminal, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// What a command leaves behind.
pub struct Report {
    /// For standard output: a page, or one JSON object.
    pub text: String,
    /// Whether it did what was asked: exit code 0 or 1.
    pub success: bool,
}

impl Report {
    /// A command that did what was asked.
    pub fn done(text: String) -> Self {
        Self { text, success: true }
    }

    /// `value` as JSON, readable by people too.
    pub fn json(value: &Value, success: bool) -> Self {
        Self { text: format!("{value:#}\n"), success }
    }

    /// A page.
    pub fn page(page: &Page, success: bool) -> Self {
        Self { text: page.text(), success }
    }

    /// JSON where that is asked for, else a page.
    fn told(as_json: bool, success: bool, json: impl FnOnce() -> Value, page: impl FnOnce() -> Page) -> Self {
        if as_json { Self::json(&json(), success) } else { Self::page(&page(), success) }
    }
}

const LONG_ABOUT: &str = "\
A differentiable multirotor simulator. One definition of the physics flies a vehicle closed loop, gives its exact \
derivatives, tunes its controller by gradients through whole flights, and trains policies for the tasks of a benchmark.

Vehicles are built in, or come from your URDF or TOML file. Every quantity is in SI units and radians unless a unit \
is written beside it; world z points up.";

const AFTER_HELP: &str = "\
Examples:
  omnidrones fly                            fly a quadrotor read from URDF, write plots
  omnidrones fly firefly --wind 4,0,0       a built-in vehicle in 4 m/s of wind
  omnidrones fly drone.urdf                 your own vehicle
  omnidrones import drone.urdf              what is in a URDF, and what had to be assumed
  omnidrones fly transport                  four drones carry a box
  omnidrones show payload --plot robot.svg    the tree of an articulated system, drawn
  omnidrones models                         the built-in vehicles
  omnidrones allocate firefly --fail 2      which thrusts hold hover without rotor 2
  omnidrones design hummingbird             modes and margins of its control loop
  omnidrones linearise payload              its exact linear model, modes and files
  omnidrones recover hummingbird            from which tilts and rates it comes back
  omnidrones tune hummingbird               better gains, by gradients through flights
  omnidrones optimise slalom                a trajectory of least cost between pillars, to fly
  omnidrones tasks                          the benchmark tasks for learners
  omnidrones tasks Hover                    what an agent sees, commands and is rewarded for
  omnidrones rollout Hover                  256 episodes flown by our controller, with plots
  omnidrones train Hover                    a policy from random weights, in seconds
  omnidrones study paper                    learning algorithms beside each other, in hours
  omnidrones eval runs/Hover-apg-s0         fly it from held-out starts, with plots
  omnidrones report runs/Hover-apg-s0       how it learnt and flies, as one page
  omnidrones replay runs/Hover-apg-s0       see it fly: one page for any browser
  omnidrones view Hover                     the same live, while it flies
  omnidrones watch runs/Hover-apg-s0        the same as a GIF
  omnidrones export c runs/Hover-apg-s0     what flew here, as C for a flight computer
  omnidrones export onnx runs/Hover-apg-s0  the policy alone, as ONNX
  omnidrones benchmark tracking --quick     controllers at the limits of their rotors, as published
  omnidrones bench --quick                  how fast this machine steps and differentiates
  omnidrones bench Hover --quick            how fast it steps thousands of environments of a task

'omnidrones COMMAND --help' tells each command's options, files and units.

Output: a folder must be new, empty or made by omnidrones, which then replaces its earlier output there; a file that \
exists elsewhere is kept. Pictures and pages of an earlier flight there go. --force writes into a folder of other files, or over a file. A training run is replaced with \
--force alone; --resume goes on with it.

Exit codes: 0 done; 1 ran, but the flight, the tuning, a search or a training failed; 2 unusable input or arguments.";

#[derive(Debug, Parser)]
#[command(name = "omnidrones", version, about = "A differentiable multirotor simulator", long_about = LONG_ABOUT,
          after_help = AFTER_HELP, max_term_width = HELP_COLUMNS as usize, subcommand_required = true, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly a vehicle along a reference, differentiate it, write plots
    #[command(long_about = fly::ABOUT)]
    Fly(Box<fly::Arguments>),
    /// Show an articulated system: its tree, rotors, servos, totals; draw it
    #[command(long_about = show::ABOUT)]
    Show(show::Arguments),
    /// List the built-in vehicles, or print everything about one
    #[command(long_about = models::ABOUT)]
    Models(models::Arguments),
    /// Read a URDF: its bodies, what is odd, what had to be assumed; draft its rotor file
    #[command(long_about = import::ABOUT)]
    Import(import::Arguments),
    /// Find the rotor thrusts that make a wrench within limits, and explain the answer
    #[command(long_about = allocate::ABOUT)]
    Allocate(Box<allocate::Arguments>),
    /// Report a vehicle's steady flight, its modes, and the margins of its control loop
    #[command(long_about = design::ABOUT)]
    Design(Box<design::Arguments>),
    /// Linearise about a steady flight: A and B for other tools, modes
    #[command(long_about = linearise::ABOUT)]
    Linearise(Box<linearise::Arguments>),
    /// Count from which tilts and rates a controller brings a vehicle back
    #[command(long_about = recover::ABOUT)]
    Recover(Box<recover::Arguments>),
    /// Tune a vehicle's gains by gradients through closed-loop flights
    #[command(long_about = tune::ABOUT)]
    Tune(Box<tune::Arguments>),
    /// Find the trajectory of least cost within bounds, gates and obstacles, as a reference to fly
    #[command(long_about = optimise::ABOUT)]
    Optimise(Box<optimise::Arguments>),
    /// List the benchmark tasks, or print everything about one
    #[command(long_about = tasks::ABOUT)]
    Tasks(Box<tasks::Arguments>),
    /// Fly the episodes of a task with a controller: returns, errors, crashes, plots
    #[command(long_about = rollout::ABOUT)]
    Rollout(Box<rollout::Arguments>),
    /// Train a policy for a task from random weights, evaluate it, draw how it learnt
    #[command(long_about = train::ABOUT)]
    Train(Box<train::Arguments>),
    /// Train every task by its recipe: one table beside our controllers
    #[command(long_about = train_all::ABOUT)]
    TrainAll(Box<train_all::Arguments>),
    /// Compare algorithms over tasks and seeds: a report
    #[command(long_about = study::ABOUT)]
    Study(Box<study::Arguments>),
    /// Fly a trained policy from held-out starts: returns, errors, crashes, plots
    #[command(long_about = eval::ABOUT)]
    Eval(Box<eval::Arguments>),
    /// Write what was learnt as one page: settings, curves, tables, a replay
    #[command(long_about = report::ABOUT)]
    Report(Box<report::Arguments>),
    /// Write flights as one page for a browser
    #[command(long_about = replay::ABOUT)]
    Replay(Box<replay::Arguments>),
    /// Show flights live in a browser of this machine
    #[command(long_about = view::ABOUT)]
    View(Box<view::Arguments>),
    /// Show a trained policy in flight: a page, a GIF and plots
    #[command(long_about = watch::ABOUT)]
    Watch(Box<watch::Arguments>),
    /// Write vehicles, controllers, policies and tasks as C99, policies as ONNX
    #[command(long_about = export::ABOUT)]
    Export(Box<export::Arguments>),
    /// Fly a published comparison of controllers, beside its figures
    #[command(long_about = benchmark::ABOUT)]
    Benchmark(Box<benchmark::Arguments>),
    /// Measure how fast this machine steps and differentiates
    #[command(long_about = bench::ABOUT)]
    Bench(Box<bench::Arguments>),
}

/// Parses, runs, prints; every outcome is an exit code.
pub fn main() -> ExitCode {
    // who is to outlive a signal (nohup) goes on to
    let _ = ctrlc::try_set_handler(told_to_end);
    match outcome(std::env::args_os()) {
        Ok(Ok(report)) => print(&report),
        Ok(Err(error)) => fail(&words::shown(&error.to_string())),
        // help and version come this way too, with code 0; a disk that is full is a failure of theirs too
        Err(error) if error.use_stderr() && asked_for_json() => {
            fail(error.to_string().trim_start_matches("error: ").trim_end())
        }
        Err(error) => match error.print().and_then(|()| std::io::stdout().flush()) {
            Err(refused) if refused.kind() != ErrorKind::BrokenPipe => fail(&format!("standard output: {refused}")),
            _ => ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2)),
        },
    }
}

/// What a signal does: trainings save behind their update, then the process ends; at once with the second one.
fn told_to_end() {
    static TWICE: AtomicBool = AtomicBool::new(false);
    let again = TWICE.swap(true, Ordering::SeqCst);
    let at_work = internals::ask_to_end();
    if again || at_work == 0 {
        end(if again { vec!["what was saved before is there".into()] } else { Vec::new() });
    }
    let _ =
        writeln!(std::io::stderr(), "\nstopping: the training is saved behind this update; once more ends it at once");
    std::thread::spawn(|| {
        end(internals::wait_to_end().iter().map(left).collect());
    });
}

/// What became of a training, for whoever ended it.
fn left(of: &internals::RunLeft) -> String {
    match of {
        internals::RunLeft::Saved(folder, update) => {
            format!("{} is saved at update {update}; --resume goes on from there", folder.display())
        }
        internals::RunLeft::Lost(why) => format!("nothing was saved: {why}"),
    }
}

/// Ends the process. Half a file is nobody's.
fn end(told: Vec<String>) -> ! {
    let _writes_end = internals::remove_unfinished();
    for line in if told.is_empty() { vec![files::saved_so_far()] } else { told } {
        let _ = writeln!(std::io::stderr(), "stopped: {}", words::shown(&line));
    }
    std::process::exit(130);
}

/// Most columns of a help text.
const HELP_COLUMNS: u16 = 100;

/// Help whose examples fit the window.
fn with_examples(command: clap::Command) -> clap::Command {
    let columns = table::window().map_or(usize::from(HELP_COLUMNS), |own| own.min(HELP_COLUMNS.into()));
    let [below, long] = [command.get_after_help(), command.get_after_long_help()]
        .map(|text| text.map(|text| words::fitting(&text.to_string(), columns)));
    let command = below.into_iter().fold(command, clap::Command::after_help);
    long.into_iter().fold(command, clap::Command::after_long_help)
}

/// The commands, whose options take negative numbers: what is below its range is then named with its limits, not as an unknown option.
fn command() -> clap::Command {
    fn open(command: clap::Command) -> clap::Command {
        let takes = |arg: &clap::Arg| arg.get_action().takes_values() && !arg.is_positional();
        let command = with_examples(command);
        command.mut_args(|arg| if takes(&arg) { arg.allow_negative_numbers(true) } else { arg }).mut_subcommands(open)
    }
    open(Cli::command())
}

/// With a word of what is asked for, where a number has its unit behind it or may not be negative.
fn with_tip(mut error: clap::Error) -> clap::Error {
    let Some(ContextValue::String(value)) = error.get(ContextKind::InvalidValue) else { return error };
    let number = value.trim_end_matches(|c: char| c.is_alphabetic() || "°/²".contains(c));
    let source = std::error::Error::source(&error);
    let whole = source.is_some_and(|e| e.is::<std::num::ParseIntError>());
    let real = source.is_some_and(|e| e.is::<std::num::ParseFloatError>());
    let tip = match () {
        () if (whole || real) && number != value && number.parse::<f64>().is_ok() => {
            "leave the unit out, and give the number in the unit that --help names"
        }
        () if whole && value.parse::<i64>().is_ok_and(|n| n < 0) => "it counts: no number below 0",
        () => return error,
    };
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    error
}

/// What the command line `words`, the program's name first, leads to: a report, or an error with which it exits.
///
/// # Errors
/// What clap says of words that it cannot read, and of those that ask for help or the version.
pub fn outcome(words: impl IntoIterator<Item = OsString>) -> Result<omnidrones::error::Result<Report>, clap::Error> {
    Ok(match &Cli::from_arg_matches(&command().try_get_matches_from(words).map_err(with_tip)?)?.command {
        Command::Fly(arguments) => fly::run(arguments),
        Command::Show(arguments) => show::run(arguments),
        Command::Models(arguments) => models::run(arguments),
        Command::Import(arguments) => import::run(arguments),
        Command::Allocate(arguments) => allocate::run(arguments),
        Command::Design(arguments) => design::run(arguments),
        Command::Linearise(arguments) => linearise::run(arguments),
        Command::Recover(arguments) => recover::run(arguments),
        Command::Tune(arguments) => tune::run(arguments),
        Command::Optimise(arguments) => optimise::run(arguments),
        Command::Tasks(arguments) => tasks::run(arguments),
        Command::Rollout(arguments) => rollout::run(arguments),
        Command::Train(arguments) => train::run(arguments),
        Command::TrainAll(arguments) => train_all::run(arguments),
        Command::Study(arguments) => study::run(arguments),
        Command::Eval(arguments) => eval::run(arguments),
        Command::Report(arguments) => report::run(arguments),
        Command::Replay(arguments) => replay::run(arguments),
        Command::View(arguments) => view::run(arguments),
        Command::Watch(arguments) => watch::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Export(arguments) => export::run(arguments),
        Command::Benchmark(arguments) => benchmark::run(arguments),
    })
}

/// Whether styles are not wanted.
fn plain() -> bool {
    std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty()) || std::env::var_os("TERM").is_some_and(|v| v == "dumb")
}

fn print(report: &Report) -> ExitCode {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(report.text.as_bytes()).and_then(|()| stdout.flush()) {
        // a reader that has seen enough (`| head`) is no failure
        Err(error) if error.kind() != ErrorKind::BrokenPipe => fail(&format!("standard output: {error}")),
        _ => ExitCode::from(u8::from(!report.success)),
    }
}

/// Whether what reads standard output reads JSON, known before the arguments are.
fn asked_for_json() -> bool {
    std::env::args_os().take_while(|a| a != "--").any(|a| a == "--json")
}

fn fail(message: &str) -> ExitCode {
    let message = words::shown_lines(message);
    let mut stderr = std::io::stderr();
    let _ = if stderr.is_terminal() {
        let told = words::wrapped(&message, table::columns(), 7, 2);
        let word = if plain() { "error:" } else { "\u{1b}[1;31merror:\u{1b}[0m" };
        writeln!(stderr, "{word} {told}")
    } else {
        writeln!(stderr, "error: {message}")
    };
    if asked_for_json() {
        let _ = writeln!(std::io::stdout(), "{:#}", json!({ "format": 1, "error": message }));
    }
    ExitCode::from(2)
}
