//! `rollout --all`: every task that a controller can fly, one line each.

use super::rollout::{Arguments, ControllerName, Ready};
use crate::prelude::*;
use omnidrones::parallel::Threads;
use omnidrones::tasks::registry::{REGISTRY, TaskEntry};
use omnidrones::tasks::{EnvConfig, Evaluation};
use omnidrones_plot::{Bar, Bars, Colour, Figure};

/// A task: its figures, or why it was not flown.
pub struct Line {
    pub name: &'static str,
    pub flown: std::result::Result<Evaluation, String>,
    controller: String,
    error: (String, String),
}

/// Flies every task.
pub fn run(a: &Arguments, config: &EnvConfig, threads: &Threads) -> Result<Report> {
    // refused once, not by every task
    let plan = if a.controller == ControllerName::Planner { Some(a.plan.config()?) } else { None };
    let mut outputs = a.episodes.output.open("out/tasks", false)?;
    let bar = progress::bar(REGISTRY.len() as u64, "", a.episodes.output.json);
    let mut lines = Vec::new();
    for entry in REGISTRY {
        bar.set_message(format!("flying {}", entry.name));
        lines.push(line(entry, config, threads, a));
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(Line { flown: Err(reason), .. }) = lines.first().filter(|_| lines.iter().all(|l| l.flown.is_err())) {
        let remedy = "Try one task alone: omnidrones rollout TASK.";
        return Err(Error::value("number of tasks flown", format!("0 ({reason})"), "1 or more", remedy));
    }
    outputs.draw("tasks", || figure(&lines, a.controller))?;
    let written = outputs.written;
    if a.episodes.output.json {
        let tasks: Vec<Value> = lines.iter().map(Line::json).collect();
        let value = json!({
            "command": "rollout",
            "version": env!("CARGO_PKG_VERSION"),
            "controller": a.controller.name(),
            "plan": plan,
            "config": config,
            "tasks": tasks,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    Ok(Report::page(&all_page(&lines, config, &written), true))
}

fn line(entry: &'static TaskEntry, config: &EnvConfig, threads: &Threads, a: &Arguments) -> Line {
    match Ready::new(entry, config, threads, (a.controller, &a.plan, None))
        .and_then(|mut ready| ready.fly(0, &mut |_| ()))
    {
        Ok(flown) => {
            let error = &flown.record.spec().info[flown.record.first_metric()];
            let error = (error.name.clone(), error.unit.clone());
            Line { name: entry.name, flown: Ok(flown.evaluation), controller: flown.controller, error }
        }
        Err(reason) => Line {
            name: entry.name,
            flown: Err(reason.to_string()),
            controller: "–".into(),
            error: (String::new(), String::new()),
        },
    }
}

impl Line {
    fn json(&self) -> Value {
        json!({
            "task": self.name,
            "flown_by": self.flown.is_ok().then_some(&self.controller),
            "error": self.error.0,
            "evaluation": self.flown.as_ref().ok(),
            "left_out": self.flown.as_ref().err(),
        })
    }
}

/// What errors are, of tasks and the names of theirs; no name where it is not known.
pub fn told_errors<'a>(errors: impl Iterator<Item = (&'a str, &'a str)>) -> String {
    let others = errors.filter(|(_, name)| !name.is_empty() && *name != "position_error");
    let others: Vec<String> = others.map(|(task, name)| format!("{task} ({name})")).collect();
    let but = if others.is_empty() { String::new() } else { format!(", but for {}", others.join(", ")) };
    format!("Error: the task's position_error{but}")
}

fn all_page(lines: &[Line], config: &EnvConfig, written: &[PathBuf]) -> Page {
    let mut table = Table::new(
        "task | flown by | >return | >of bound | >success | >crashed | >steps | >mean error [m] | >last [m] | >Δ command",
    );
    // tasks by the reason for which they were not flown
    let mut left_out: Vec<(String, Vec<&str>)> = Vec::new();
    for line in lines {
        match &line.flown {
            Ok(e) => {
                table.row([
                    line.name.to_string(),
                    line.controller.clone(),
                    format!("{} ± {}", short(e.return_mean, 4), short(e.return_std, 3)),
                    percent(e.share_of_bound),
                    percent(e.success),
                    percent(e.crashed),
                    number(e.length, 0),
                    short(e.mean_error, 3),
                    short(e.final_error, 3),
                    short(e.command_change(), 2),
                ]);
            }
            Err(reason) => {
                let reason = reason.replace(&format!("task {}: ", line.name), "");
                match left_out.iter_mut().find(|(known, _)| *known == reason) {
                    Some((_, names)) => names.push(line.name),
                    None => left_out.push((reason, vec![line.name])),
                }
            }
        }
    }
    let mut page = Page::new();
    page.title("Baselines", &format!("{} episodes of every task, seed {}", config.n_env, config.seed));
    page.table(table);
    let told = told_errors(lines.iter().map(|l| (l.name, l.error.0.as_str())));
    page.line(format!("\n{told}; 'last' is its mean in the last step, crashed episodes included."));
    if !left_out.is_empty() {
        page.heading("Not flown");
        for (reason, names) in &left_out {
            page.line(format!("  {reason}"));
            for some in names.chunks(5) {
                page.line(format!("    {}", some.join(", ")));
            }
        }
    }
    page.written(written);
    page
}

/// The tasks that were flown, side by side.
fn figure(lines: &[Line], controller: ControllerName) -> Figure {
    let by = match controller {
        ControllerName::Default => "our controllers",
        ControllerName::Random => "random actions",
        ControllerName::Planner => "plans",
        ControllerName::Named(name) => name,
    };
    let mut bars = Bars::new("Mean return", "share of the bound: best reward of a step × steps [%]");
    for (line, e) in lines.iter().filter_map(|line| Some((line, line.flown.as_ref().ok()?))) {
        let note = format!("%   {} success, {} crashed", percent(e.success), percent(e.crashed));
        let colour = if e.crashed > CRASHES { Colour::VERMILLION } else { Colour::BLUE };
        bars = bars.bar(Bar::new(line.name, 100.0 * e.share_of_bound).note(note).colour(colour));
    }
    let height = 100.0 + 24.0 * bars.bars.len() as f64;
    Figure::new(format!("The benchmark tasks under {by}"))
        .subtitle(format!("vermillion: more than {} of the episodes crashed", percent(CRASHES)))
        .size(900.0, height)
        .chart(bars)
}

/// Share of crashes that colours a bar.
const CRASHES: f64 = 0.05;
