//! `omnidrones study`: a comparison of algorithms over tasks and seeds, as a report.

mod document;
mod figure;
mod plan;

use super::arguments::{self, OutputArguments, ThreadArguments};
use super::over_seeds::{Failure, shown, spread};
use super::page::{Page, duration, short};
use super::rollout_files::percent;
use super::rows::{self, Row};
use super::table::{Align, Table};
use super::train::{algorithms, compare, count};
use super::{Report, files, over_seeds, progress};
use document::Document;
use omnidrones::error::{Error, Result};
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::log::{self, Line};
use omnidrones::tasks::Evaluation;
use omnidrones::tasks::registry;
use plan::{Cell, Claim, Plan};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What the command is for.
pub const ABOUT: &str = "\
Compare learning algorithms over tasks, control levels and seeds, and write a report: a table, learning curves, and what \
published statements come to. A row that is finished is kept, so a study that was killed goes on where it stopped, and one of \
hours can be made in parts.";

const EXAMPLES: &str = "\
Examples:
  omnidrones study paper                              the comparison of the OmniDrones paper, 3 seeds a row: hours
  omnidrones study paper --tasks Hover --algos ppo,dqn    some of its rows; the report tells all that are there
  omnidrones study paper --no-train                   the report of what is there

A row is a task by an algorithm, each with the settings of its recipe and those of the study. A figure is the mean over seeds, ± \
half the width of its 95 % confidence interval (Student's t), in brackets the least and the largest. Who keeps three quarters of \
what our controller returns from the same starts counts as flying the task.

Exit codes: 0 all that was asked for is trained; 1 something was not; 2 unusable input or arguments.

Files in --out: a row per task and algorithm (TASK-ALGO-uUPDATES.json), a folder per run, study.md and study.html (the report), \
study.json (what --json prints), curves.svg.";

/// Arguments of `study`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder of the runs and of the report [default: runs/study-NAME]")))]
pub struct Arguments {
    /// What is compared
    #[arg(value_name = "NAME", value_parser = plan::names())]
    name: String,
    /// Train rows of these tasks alone, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Train rows of these algorithms alone, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = algorithms())]
    algos: Vec<String>,
    /// Seeds of each row [default: those of the study]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: Option<u64>,
    /// Updates, as a factor on those of the rows
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    budget: f64,
    /// Train nothing: tell what is there
    #[arg(long)]
    no_train: bool,
    #[command(flatten)]
    threads: ThreadArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// A row of the study and what is known of it.
pub struct Told {
    cell: Cell,
    row: std::result::Result<Row, String>,
    /// The log of every seed that is here.
    curves: Vec<Vec<Line>>,
}

/// Our controllers by task.
type Controllers = BTreeMap<String, (String, Evaluation)>;

/// A whole study.
struct Study {
    plan: Plan,
    rows: Vec<Told>,
    controllers: Controllers,
}

/// Trains what is asked for and missing, and tells all that is there.
pub fn run(a: &Arguments) -> Result<Report> {
    if !(a.budget.is_finite() && a.budget > 0.0) {
        return Err(Error::value("--budget", a.budget, "finite and > 0", "1 takes the updates of the study."));
    }
    let threads = a.threads.threads()?;
    let plan = Plan::by_name(&a.name)?;
    let asked = plan.cells(&a.tasks, &a.algos, a.budget)?;
    let folder = a.output.folder(format!("runs/study-{}", a.name))?;
    let seeds = a.seeds.unwrap_or(plan.seeds);
    let mut failed = Vec::new();
    if !a.no_train {
        let bar = progress::bar(0, "training", a.output.json);
        failed = asked.iter().flat_map(|cell| train(cell, seeds, &folder, &threads, &bar)).collect();
        bar.finish_and_clear();
    }
    let study = Study::read(plan, &folder, a, seeds, &threads)?;
    let written = study.write(&folder, a)?;
    let success = failed.is_empty();
    if a.output.json {
        return Ok(Report::json(&study.value(a, &failed), success));
    }
    Ok(Report { text: study.page(&failed, &written), success })
}

/// What failed of a row, in words.
fn train(cell: &Cell, seeds: u64, folder: &Path, threads: &Threads, bar: &indicatif::ProgressBar) -> Vec<String> {
    let name = format!("{} by {}", cell.config.task, cell.label());
    match rows::train(&cell.asked(seeds), folder, threads, bar) {
        Err(error) => vec![format!("{name}: {error}")],
        Ok(row) => row.failed.iter().map(|Failure { seed, why }| format!("{name}, seed {seed}: {why}")).collect(),
    }
}

impl Cell {
    fn asked(&self, seeds: u64) -> rows::Asked<'_> {
        rows::Asked { algorithm: &self.algorithm, setting: &self.setting, config: &self.config, seeds }
    }
}

impl Told {
    fn read(cell: Cell, folder: &Path, seeds: u64) -> Self {
        let row = rows::known(&cell.asked(seeds), folder).map_err(|error| error.to_string());
        let logs = row.iter().flat_map(|row| row.runs.iter().map(|run| row.run_folder(folder, run.seed)));
        let curves = logs.filter_map(|run| log::read(run).ok()).collect();
        Self { cell, row, curves }
    }

    fn runs(&self) -> &[over_seeds::Outcome] {
        self.row.as_ref().map_or(&[], |row| &row.runs)
    }

    /// Mean return as a share of that of our controller.
    fn beside(&self, controllers: &Controllers) -> Option<f64> {
        let (_, controller) = controllers.get(&self.cell.config.task)?;
        Some(spread(self.runs(), |run| run.evaluation.return_mean)?.mean / controller.return_mean)
    }
}

impl Study {
    /// All rows of the plan, as they are kept in `folder`.
    fn read(plan: Plan, folder: &Path, a: &Arguments, seeds: u64, threads: &Threads) -> Result<Self> {
        let cells = plan.cells(&[], &[], a.budget)?;
        let rows: Vec<Told> = cells.into_iter().map(|cell| Told::read(cell, folder, seeds)).collect();
        let mut controllers = Controllers::new();
        for task in rows.iter().filter(|row| !row.runs().is_empty()).map(|row| &row.cell.config.task) {
            if !controllers.contains_key(task) {
                let flown = compare(registry::by_name(task)?, &TrainConfig::for_task(task, None, None)?, threads);
                controllers.extend(flown.map(|flown| (task.clone(), flown)));
            }
        }
        Ok(Self { plan, rows, controllers })
    }

    fn write(&self, folder: &Path, a: &Arguments) -> Result<Vec<PathBuf>> {
        let file = |name: &str| folder.join(name);
        let drawn = if a.output.no_plots { None } else { figure::figure(&self.plan.title, &self.rows) };
        let drawn = drawn.map(|figure| figure.svg()).transpose()?;
        let mut written = Vec::new();
        let mut put = |name: &str, text: &str| {
            written.push(file(name));
            files::replace(&file(name), text)
        };
        if let Some(svg) = &drawn {
            put("curves.svg", svg)?;
        }
        let document = self.document(drawn);
        put("study.md", &document.markdown())?;
        put("study.html", &document.html())?;
        put("study.json", &format!("{:#}\n", self.value(a, &[])))?;
        Ok(written)
    }

    /// How much of it is there.
    fn made(&self) -> String {
        let done = self.rows.iter().filter(|row| !row.runs().is_empty()).count();
        format!("{done} of {} rows are trained.", self.rows.len())
    }

    fn document(&self, curves: Option<String>) -> Document {
        let remark = format!("{} omnidrones {}.", self.made(), env!("CARGO_PKG_VERSION"));
        let mut document = Document::new(&self.plan.title, &remark);
        document.heading("Statements").line(
            "What was published of each algorithm, and whether the rows below bear it out. A task counts as flown where the mean \
             return over seeds is three quarters of our controller's from the same starts.",
        );
        document.table(self.statements());
        for claim in self.plan.claims.iter().filter(|claim| !claim.why.is_empty()) {
            document.line(&format!("{} {}", claim.says, claim.why));
        }
        for part in &self.plan.parts {
            let table = self.table(&part.name);
            if !table.is_empty() {
                let mut name = part.name.clone();
                name[..1].make_ascii_uppercase();
                document.heading(&name).table(table);
            }
        }
        document.line(KEY);
        if let Some(svg) = curves {
            document.heading("Learning curves").figure(svg, "curves.svg");
        }
        document.heading("Where the rows come from").table(self.origins());
        document
    }

    /// A line per row of a part that has runs; our controller below those of a task.
    fn table(&self, part: &str) -> Table {
        let heads = ["success", "crashed", "return", "beside ours", "seeds", "time", "env steps"];
        let mut columns = vec![("task", Align::Left), ("by", Align::Left)];
        columns.extend(heads.map(|name| (name, Align::Right)));
        let mut table = Table::new(&columns);
        let own: Vec<&Told> = self.rows.iter().filter(|row| row.cell.part == part && !row.runs().is_empty()).collect();
        for (k, row) in own.iter().enumerate() {
            let (task, runs) = (&row.cell.config.task, row.runs());
            let mean = |of: fn(&over_seeds::Outcome) -> f64, show: &dyn Fn(f64) -> String| {
                spread(runs, of).map_or("–".into(), |all| show(all.mean))
            };
            table.row([
                task.clone(),
                row.cell.label(),
                shown(spread(runs, |run| run.evaluation.success), percent, 100.0),
                mean(|run| run.evaluation.crashed, &percent),
                mean(|run| run.evaluation.return_mean, &|x| short(x, 4)),
                row.beside(&self.controllers).map_or("–".into(), percent),
                runs.len().to_string(),
                mean(|run| run.seconds, &duration),
                mean(|run| run.env_steps as f64, &count),
            ]);
            let last = own.get(k + 1).is_none_or(|next| next.cell.config.task != *task);
            if let Some((name, e)) = self.controllers.get(task).filter(|_| last) {
                let (success, crashed) = (percent(e.success), percent(e.crashed));
                table.row([String::new(), name.clone(), success, crashed, short(e.return_mean, 4)]);
            }
        }
        table
    }

    /// What was said and what was found.
    fn statements(&self) -> Table {
        let heads = ["published", "here", "found"].map(|name| (name, Align::Left));
        let mut table = Table::new(&heads);
        for claim in &self.plan.claims {
            let (verdict, found) = self.judge(claim);
            table.row([claim.says.clone(), verdict.into(), found]);
        }
        table
    }

    /// Whether a statement holds, and on how many tasks each of its algorithms flies.
    fn judge(&self, claim: &Claim) -> (&'static str, String) {
        let own = |row: &&Told| row.cell.part == claim.part && claim.algorithms.contains(&row.cell.algorithm);
        let mut flown: Vec<(String, Vec<Option<f64>>)> = Vec::new();
        for row in self.rows.iter().filter(own) {
            let (label, share) = (row.cell.label(), row.beside(&self.controllers));
            match flown.iter_mut().find(|(name, _)| *name == label) {
                Some((_, shares)) => shares.push(share),
                None => flown.push((label, vec![share])),
            }
        }
        let count = |shares: &[Option<f64>]| shares.iter().flatten().filter(|share| **share >= self.plan.flies).count();
        let told = |(name, shares): &(String, Vec<Option<f64>>)| {
            format!("{name} flies {} of {}", count(shares), shares.iter().flatten().count())
        };
        let found = flown.iter().map(told).collect::<Vec<_>>().join("; ");
        if flown.iter().any(|(_, shares)| shares.iter().any(Option::is_none)) {
            return ("not decided: rows are missing", found);
        }
        let mut each = flown.iter().map(|(_, shares)| (count(shares), shares.len()));
        let holds = if claim.flies { each.all(|(n, of)| 2 * n > of) } else { each.all(|(n, _)| n == 0) };
        (if holds { "holds" } else { "does not hold" }, found)
    }

    fn origins(&self) -> Table {
        let heads = ["task", "by", "seeds", "commit", "hash of settings, task and physics"];
        let mut table = Table::new(&heads.map(|name| (name, Align::Left)));
        for (told, row) in self.rows.iter().filter_map(|told| Some((told, told.row.as_ref().ok()?))) {
            if !row.runs.is_empty() {
                let seeds: Vec<String> = row.runs.iter().map(|run| run.seed.to_string()).collect();
                let commit = row.commit.clone().unwrap_or("–".into());
                table.row([row.task.clone(), told.cell.label(), seeds.join(", "), commit, row.hash.clone()]);
            }
        }
        table
    }

    fn page(&self, failed: &[String], written: &[PathBuf]) -> String {
        let mut page = Page::new();
        page.title("Study", &self.plan.title);
        for part in &self.plan.parts {
            let table = self.table(&part.name);
            if !table.is_empty() {
                page.heading(&part.name).table(&table);
            }
        }
        page.line(format!("\n{KEY}\n{}", self.made()));
        page.heading("Statements");
        for claim in &self.plan.claims {
            let (verdict, found) = self.judge(claim);
            page.line(format!("  {}\n    {verdict}: {found}", claim.says));
        }
        if !failed.is_empty() {
            page.heading("Not trained");
            for words in failed {
                page.line(format!("  {words}"));
            }
        }
        page.heading("Written");
        for path in written {
            page.line(format!("  {}", path.display()));
        }
        page.finish()
    }

    fn value(&self, a: &Arguments, failed: &[String]) -> Value {
        let row = |told: &Told| {
            let (runs, failed) = told.row.as_ref().map_or((&[][..], &[][..]), |row| (&row.runs, &row.failed));
            let mut value = over_seeds::value(runs, failed);
            value["part"] = told.cell.part.as_str().into();
            value["task"] = told.cell.config.task.as_str().into();
            value["algorithm"] = told.cell.algorithm.as_str().into();
            value["setting"] = told.cell.setting.as_str().into();
            value["share_of_controller"] = json!(told.beside(&self.controllers));
            value
        };
        let claim = |claim: &Claim| {
            let (verdict, found) = self.judge(claim);
            json!({ "says": claim.says, "verdict": verdict, "found": found })
        };
        let controllers = self
            .controllers
            .iter()
            .map(|(task, (name, e))| (task.clone(), json!({ "flown_by": name, "evaluation": e })));
        json!({
            "command": "study",
            "version": env!("CARGO_PKG_VERSION"),
            "study": a.name,
            "budget": a.budget,
            "rows": self.rows.iter().map(row).collect::<Vec<_>>(),
            "controllers": controllers.collect::<serde_json::Map<_, _>>(),
            "claims": self.plan.claims.iter().map(claim).collect::<Vec<_>>(),
            "not_trained": failed,
        })
    }
}

/// What the numbers of the table are.
const KEY: &str = "\
Success and return: mean over seeds, from held-out starts; success ± half the width of its 95 % interval (least–largest).
Beside ours: return over that of our controller. Time: of training, on the threads that it had.";
