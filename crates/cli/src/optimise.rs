//! `omnidrones optimise`: a trajectory of least cost from a start to a goal, within bounds, as a reference to fly.

mod figures;
mod planned;
mod reference;
mod told;

use self::planned::Planned;
use super::arguments::{self, OutputArguments, is_path, one_of};
use crate::prelude::*;
use omnidrones::controllers::optimal::{CourseProblem, FirstGuess, Ilqr, IlqrReport, IlqrSettings, ProblemFile};
use std::time::{Duration, Instant};

/// What the command is for.
pub const ABOUT: &str = "\
Find the trajectory of least cost from a start to a goal: inputs within their bounds at every instant, gates passed at their times, \
obstacles kept clear of, soft bounds of the state. The plant is the model with the longer lag of its motors. Iterated linear-quadratic \
regulators with all bounds in one program find it (iLQR; an augmented Lagrangian for gates and obstacles). The result is a \
reference that 'fly' tracks, the trajectory as a table, and the gains of optimal feedback along it.";

const EXAMPLES: &str = "\
Examples:
  omnidrones optimise                          the problems that are built in
  omnidrones optimise slalom                   between pillars, to a point
  omnidrones fly hummingbird --reference out/slalom/reference.toml --controller mpc    what was planned, flown
  omnidrones optimise race --replay            through four gates, as a page for a browser
  omnidrones optimise landing --iterations 50 --guess hover   begun from hover, of 50 iterations at most
  omnidrones optimise flip --json --no-plots   for a program
  omnidrones optimise slalom --toml > my.toml  a problem to edit: omnidrones optimise my.toml

Files in --out: trajectory.csv (time, state and inputs, units in the header; inputs hold until the next line), reference.toml (what \
'fly --reference' tracks: path and yaw), gains.npz (for NumPy: states, inputs and the gains K of every stage, u = u* + \
K e, with e the error of the state, whose attitude is a rotation vector; speeds of rotors are shares of their largest there), problem.toml (the problem as it was solved), path, trajectory \
and descent (.png or .svg), and with --replay replay.html. They are written too where the search ends without a solution.

The reference asks for a path and a heading, and a flight along it begins at rest: a flip over the back is not tracked by it, and a plan \
that begins in motion is caught up with first. A plan with inputs at their bounds leaves a controller nothing to correct with: tighter \
'bounds' in the problem do.

JSON: SI units, radians; shares of 1; null where a number does not exist.

Exit codes: 0 solved; 1 not solved: out of iterations, no step that lowers the cost, or a condition that stays violated; 2 \
unusable input or arguments.";

/// Where searches begin, by name.
const GUESSES: [(&str, &str, FirstGuess); 2] = [
    ("hover", "Inputs of hover, and what follows from them", FirstGuess::Hover),
    ("line", "On lines over gates and waypoints, whether it flies or not", FirstGuess::Line),
];

/// Arguments of `optimise`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for what is written [default: out/PROBLEM]")))]
pub struct Arguments {
    /// A built-in problem, or a file FILE.toml (docs/control.md); without it, the list
    #[arg(value_name = "PROBLEM|FILE")]
    problem: Option<String>,
    /// Most iterations [default: as the problem says, else 200]
    #[arg(long, value_name = "N", requires = "problem", help_heading = "Search")]
    iterations: Option<usize>,
    /// Where the search begins [default: as the problem says, else line]
    #[arg(long, value_name = "GUESS", requires = "problem", value_parser = one_of(&GUESSES), help_heading = "Search")]
    guess: Option<FirstGuess>,
    /// Print the problem as a file to edit, and solve nothing
    #[arg(long, requires = "problem", conflicts_with = "json", help_heading = "Output")]
    toml: bool,
    #[command(flatten)]
    output: OutputArguments,
    /// Write replay.html: the trajectory in space, a page for any browser
    #[arg(long, requires = "problem", help_heading = "Output")]
    replay: bool,
}

/// A problem, where it comes from, and what it becomes with the arguments.
struct Source {
    /// As a title and a folder.
    name: String,
    /// `built in`, or its file.
    origin: String,
    /// What is solved.
    file: ProblemFile,
    /// Where its vehicle file is sought.
    folder: Option<PathBuf>,
}

impl Source {
    /// A name that is built in, else a file: names win.
    fn load(named: &str) -> Result<Self> {
        if let Some(text) = ProblemFile::text_of(named) {
            let file = ProblemFile::from_toml_str(text, named)?;
            return Ok(Self { name: named.into(), origin: "built in".into(), file, folder: None });
        }
        if !is_path(named) {
            let known = ProblemFile::built_in().map(|(name, _)| name.to_string()).collect();
            return Err(Error::Unknown { kind: "problem", name: named.into(), known });
        }
        let path = Path::new(named);
        let file = ProblemFile::from_toml_str(&files::read_text(path, files::MAX_CONFIG_BYTES)?, named)?;
        let name = path.file_stem().map_or_else(|| "problem".into(), |stem| stem.to_string_lossy().into_owned());
        Ok(Self { name, origin: format!("file {named}"), file, folder: path.parent().map(Path::to_path_buf) })
    }

    /// With what the arguments say instead.
    fn with(mut self, a: &Arguments) -> Self {
        if let Some(iterations) = a.iterations {
            self.file.settings = IlqrSettings { max_iterations: iterations, ..self.file.settings };
        }
        self.file.guess = a.guess.unwrap_or(self.file.guess);
        self
    }

    /// As a file that can be solved from anywhere: a vehicle file is named with its folder.
    fn text(&self) -> Result<String> {
        let mut file = self.file.clone();
        if let (Some(folder), Some(vehicle)) = (&self.folder, file.vehicle.as_mut().filter(|v| v.ends_with(".toml"))) {
            let path = folder.join(&*vehicle);
            *vehicle = path.canonicalize().unwrap_or(path).display().to_string();
        }
        toml::to_string(&file).map_err(|error| Error::Format {
            file: "problem.toml".into(),
            place: "the problem".into(),
            rule: error.to_string(),
            remedy: "Report this as a bug.".into(),
        })
    }
}

/// Optimises.
pub fn run(a: &Arguments) -> Result<Report> {
    let Some(named) = &a.problem else { return list(a.output.json) };
    let source = Source::load(named)?.with(a);
    if a.toml {
        let own = ProblemFile::text_of(named).filter(|_| a.iterations.is_none() && a.guess.is_none());
        return Ok(Report::done(own.map_or_else(|| source.text(), |text| Ok(text.into()))?));
    }
    let spinner = progress::spinner("recording the problem", a.output.json);
    let problem = source.file.problem(source.folder.as_deref());
    spinner.finish_and_clear();
    let problem = problem?;
    let mut outputs = a.output.open(files::default_folder(&source.name), true)?;
    let clock = Instant::now();
    let (search, report) = search(&problem, a.output.json)?;
    let planned = Planned::new(&source, problem, &search, report, clock.elapsed().as_secs_f64())?;
    planned.write(&mut outputs)?;
    outputs.text("problem.toml", source.text()?)?;
    let unflown = planned.write_reference(&mut outputs)?;
    for (name, figure) in ["path", "trajectory", "descent"].into_iter().zip(planned.figures()) {
        outputs.draw(name, || figure)?;
    }
    if a.replay {
        outputs.text(files::REPLAY, planned.replay()?)?;
    }
    let written = outputs.done(|name| ["path", "trajectory", "descent"].contains(&name))?;
    let solved = planned.verdict();
    let success = solved.is_ok();
    Ok(Report::told(
        a.output.json,
        success,
        || planned.json(&solved, unflown.as_deref(), &written),
        || planned.page(&solved, unflown.as_deref(), &written),
    ))
}

/// Searches from the problem's guess.
fn search(problem: &CourseProblem, quiet: bool) -> Result<(Ilqr, IlqrReport)> {
    let mut search = Ilqr::new(&problem.problem)?;
    match problem.first {
        FirstGuess::Hover => search.start_from_inputs(&problem.problem, &problem.guess.inputs)?,
        FirstGuess::Line => search.start_from(&problem.problem, &problem.guess)?,
    }
    let bar = progress::bar(problem.settings.max_iterations as u64, "optimising", quiet);
    bar.enable_steady_tick(Duration::from_millis(200));
    let report = search.solve(&problem.problem, &problem.settings, |n, step| {
        bar.set_position(n as u64 + 1);
        progress::say(
            &bar,
            &format!("cost {} · gap {} · round {}", short(step.cost, 4), short(step.gap, 2), step.round + 1),
        );
    })?;
    bar.finish_and_clear();
    Ok((search, report))
}

/// What is built in.
fn list(as_json: bool) -> Result<Report> {
    let mut table = Table::new("name | vehicle | >length [s] | >steps | >gates | >obstacles | what");
    let mut rows = Vec::new();
    for (name, what) in ProblemFile::built_in() {
        let Source { file, .. } = Source::load(name)?;
        let flies = file.vehicle.clone().or_else(|| file.configuration.clone()).unwrap_or_default();
        let length = file.steps as f64 * file.dt;
        rows.push(json!({
            "name": name, "description": what, "flies": flies, "duration": length, "steps": file.steps,
            "gates": file.gates.len(), "obstacles": file.obstacles.len(),
        }));
        let counts = [file.steps, file.gates.len(), file.obstacles.len()].map(|n| n.to_string());
        let [steps, gates, obstacles] = counts;
        table.row([name.to_string(), flies, short(length, 4), steps, gates, obstacles, what.to_string()]);
    }
    if as_json {
        return Ok(Report::json(&json!({ "command": "optimise", "problems": rows }), true));
    }
    let mut page = Page::new();
    page.table(table);
    page.line("\nomnidrones optimise NAME solves one, omnidrones optimise NAME --toml prints it as a file to edit.");
    Ok(Report::page(&page, true))
}
