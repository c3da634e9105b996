//! `omnidrones study`: a comparison of algorithms over tasks and seeds, as a report.

mod figure;

use super::arguments::{self, OutputArguments, Outputs, ThreadArguments, algorithms};
use super::baseline::compare;
use super::html::{html, markdown};
use super::over_seeds;
use super::over_seeds::{Failure, shown, spread};
use super::page::Block;
use super::run_table::{self, Row};
use crate::prelude::*;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::log::Line;
use omnidrones::rl::runs::SeedSummary;
use omnidrones::tasks::Evaluation;
use omnidrones::tasks::registry;
use omnidrones_studies::plan::{self, Cell, Claim, Plan};
use omnidrones_studies::verdict::Outcome;
use std::collections::BTreeMap;

/// What the command is for.
pub const ABOUT: &str = "\
Compare learning algorithms over tasks, control levels and seeds, and write a report: a table, learning curves, and what \
published statements come to. A row that is finished is kept, so a study that was killed goes on where it stopped, and one of \
hours can be made in parts.";

const EXAMPLES: &str = "\
Examples:
  omnidrones study paper                      all of it, 3 seeds a row: hours
  omnidrones study paper --tasks Hover        a part; the report tells all that is there
  omnidrones study paper --algos ppo,sac      another part
  omnidrones study paper --no-train           the report alone

A row is a task by an algorithm, each with the settings of its recipe and those of the study. Success and return beside ours are \
means over seeds, ± half the width of the 95 % confidence interval (Student's t), in brackets the least and the largest. Who keeps \
three quarters of what our controller returns from the first 256 of the same starts counts as flying the task.

Exit codes: 0 all that was asked for is trained; 1 something was not; 2 unusable input or arguments.

Files in --out: a row per task and algorithm (TASK-ALGO-uUPDATES.json), a folder per run, study.md and study.html (the report), \
study.json (what --json prints), curves (.png or .svg). A row holds its curves: the folders of its runs, of sac, td3 and dqn up to \
gigabytes each, may be removed.";

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
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = algorithms(), ignore_case = true)]
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
    row: Row,
    /// The course of every seed.
    curves: Vec<Vec<Line>>,
}

/// Our controllers by task.
type Controllers = BTreeMap<String, (String, Evaluation)>;

/// A whole study.
struct Study {
    name: String,
    plan: Plan,
    budget: f64,
    /// With so many a row is whole.
    seeds: u64,
    rows: Vec<Told>,
    controllers: Controllers,
    /// What was asked for and not trained, in words.
    failed: Vec<String>,
}

/// Trains what is asked for and missing, and tells all that is there.
pub fn run(a: &Arguments) -> Result<Report> {
    run_table::check_budget(a.budget)?;
    let threads = a.threads.threads()?;
    let plan = Plan::by_name(&a.name)?;
    let asked = plan.cells(&a.tasks, &a.algos, a.budget)?;
    let mut outputs = a.output.open(format!("runs/study-{}", a.name), true)?;
    let folder = outputs.folder.clone();
    let seeds = a.seeds.unwrap_or(plan.seeds);
    let mut failed = Vec::new();
    if !a.no_train {
        let bar = progress::bar(0, "training", a.output.json);
        failed = asked.iter().flat_map(|cell| train(cell, seeds, &folder, &threads, &bar)).collect();
        bar.finish_and_clear();
    }
    let study = Study { failed, ..Study::read(plan, &folder, a, seeds, &threads)? };
    study.write(&mut outputs)?;
    let success = study.failed.is_empty();
    Ok(Report::told(a.output.json, success, || study.value(), || study.page(&outputs.written)))
}

/// What failed of a row, in words.
fn train(cell: &Cell, seeds: u64, folder: &Path, threads: &Threads, bar: &indicatif::ProgressBar) -> Vec<String> {
    let name = format!("{} by {}", cell.config.task, cell.label());
    match run_table::train(&asked(cell, seeds), folder, threads, bar) {
        Err(error) => vec![format!("{name}: {error}")],
        Ok(row) => row.failed.iter().map(|Failure { seed, why }| format!("{name}, seed {seed}: {why}")).collect(),
    }
}

fn asked(cell: &Cell, seeds: u64) -> run_table::Asked<'_> {
    run_table::Asked { algorithm: &cell.algorithm, setting: &cell.setting, config: &cell.config, seeds }
}

impl Told {
    fn read(cell: Cell, folder: &Path, seeds: u64) -> Result<Self> {
        let row = run_table::known(&asked(&cell, seeds), folder)?;
        let curves = row.curves(folder);
        Ok(Self { cell, row, curves })
    }

    /// Return as a share of that of our controller.
    fn beside(&self, controllers: &Controllers) -> Option<SeedSummary> {
        let (_, controller) = controllers.get(&self.cell.config.task)?;
        spread(&self.row.runs, |run| run.evaluation.return_mean / controller.return_mean)
    }
}

impl Study {
    /// All rows of the plan, as they are kept in `folder`.
    fn read(plan: Plan, folder: &Path, a: &Arguments, seeds: u64, threads: &Threads) -> Result<Self> {
        let cells = plan.cells(&[], &[], a.budget)?;
        let rows = cells.into_iter().map(|cell| Told::read(cell, folder, seeds)).collect::<Result<Vec<_>>>()?;
        let mut controllers = Controllers::new();
        for task in rows.iter().filter(|row| !row.row.runs.is_empty()).map(|row| &row.cell.config.task) {
            if !controllers.contains_key(task) {
                let flown = compare(registry::by_name(task)?, &TrainConfig::for_task(task, None, None)?, threads);
                controllers.extend(flown.map(|flown| (task.clone(), flown)));
            }
        }
        Ok(Self { name: a.name.clone(), plan, budget: a.budget, seeds, rows, controllers, failed: Vec::new() })
    }

    fn write(&self, outputs: &mut Outputs) -> Result<()> {
        let drawn = outputs.plots.and_then(|kind| Some((figure::figure(&self.plan.title, &self.rows)?, kind)));
        let curves = drawn.as_ref().map(|(figure, kind)| Ok((figure.svg()?, format!("curves.{kind}")))).transpose()?;
        if let Some((figure, _)) = drawn {
            outputs.draw("curves", || figure)?;
        }
        let document = self.document(curves);
        outputs.text("study.md", markdown(&document))?;
        outputs.text("study.html", html(&document))?;
        outputs.text("study.json", format!("{:#}\n", self.value()))
    }

    /// Whether all seeds of a row are there.
    fn is_whole(&self, row: &Told) -> bool {
        row.row.runs.len() as u64 >= self.seeds
    }

    /// How much of it is there.
    fn made(&self) -> String {
        let (done, all) = (self.rows.iter().filter(|row| self.is_whole(row)).count(), self.rows.len());
        let budget = if self.budget == 1.0 { String::new() } else { format!(", updates × {}", short(self.budget, 3)) };
        format!("{done} of {all} rows are trained ({} seeds each{budget}).", self.seeds)
    }

    fn document(&self, curves: Option<(String, String)>) -> Page {
        let remark = format!("{} omnidrones {}.", self.made(), env!("CARGO_PKG_VERSION"));
        let mut document = Page::new();
        document.title(&self.plan.title, &remark);
        document.heading("Statements").line(
            "What was published of each algorithm, and whether the rows below bear it out. A task counts as flown where the mean \
             return over seeds is three quarters of our controller's from the first 256 of the same starts. Budgets and recipes \
             differ: who had fewer steps than another that flies the task is not said to fail.",
        );
        document.table(self.statements());
        for claim in self.plan.claims.iter().filter(|claim| !claim.why.is_empty()) {
            document.line(format!("{} {}", claim.says, claim.why));
        }
        for part in &self.plan.parts {
            let table = self.table(&part.name);
            if !table.is_empty() {
                document.heading(&part.name).table(table);
            }
        }
        document.line(KEY);
        if let Some((svg, file)) = curves {
            let trained = self.rows.iter().filter(|told| !told.row.runs.is_empty()).count();
            let drawn = self.rows.iter().filter(|told| !told.curves.is_empty()).count();
            document.heading("Learning curves");
            if drawn < trained {
                document.line(format!("Of the {drawn} rows whose curves were kept."));
            }
            document.blocks.push(Block::Figure(svg, file));
        }
        document.lines("Not trained", &self.failed);
        document.heading("Where the rows come from").table(self.origins());
        document
    }

    /// A line per row of a part that has runs; our controller below those of a task.
    fn table(&self, part: &str) -> Table {
        let mut table =
            Table::new("task | by | >success | >crashed | >return | >beside ours | >seeds | >time | >env steps");
        let own: Vec<&Told> =
            self.rows.iter().filter(|row| row.cell.part == part && !row.row.runs.is_empty()).collect();
        for (k, row) in own.iter().enumerate() {
            let (task, runs) = (&row.cell.config.task, &row.row.runs);
            let mean = |of: fn(&over_seeds::Outcome) -> f64, show: &dyn Fn(f64) -> String| {
                spread(runs, of).map_or("–".into(), |all| show(all.mean))
            };
            table.row([
                task.clone(),
                row.cell.label(),
                shown(spread(runs, |run| run.evaluation.success), percent, 100.0),
                mean(|run| run.evaluation.crashed, &percent),
                mean(|run| run.evaluation.return_mean, &|x| short(x, 4)),
                shown(row.beside(&self.controllers), percent, 100.0),
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
        Table::new("published | here | found").filled(self.plan.claims.iter().map(|claim| {
            let (verdict, found) = self.plan.judge(claim, &self.outcomes());
            [claim.says.clone(), verdict.into(), found]
        }))
    }

    /// What the plan's statements are judged by.
    fn outcomes(&self) -> Vec<Outcome<'_>> {
        let of = self.rows.iter().map(|told| {
            let share = told.beside(&self.controllers).filter(|_| self.is_whole(told)).map(|share| share.mean);
            let steps = spread(&told.row.runs, |run| run.env_steps as f64).map_or(0.0, |all| all.mean);
            Outcome { cell: &told.cell, share, steps }
        });
        of.collect()
    }

    fn origins(&self) -> Table {
        let rows = self.rows.iter().map(|told| &told.row).filter(|row| !row.runs.is_empty());
        Table::new("task | by | seeds | commit | hash of settings, task and physics").filled(rows.map(Row::origin))
    }

    fn page(&self, written: &[PathBuf]) -> Page {
        let mut page = Page::new();
        page.title("Study", &self.plan.title);
        for part in &self.plan.parts {
            let table = self.table(&part.name);
            if !table.is_empty() {
                page.heading(&part.name).table(table);
            }
        }
        page.paragraph(format!("\n{KEY}\n{}", self.made()));
        page.heading("Statements");
        for claim in &self.plan.claims {
            let (verdict, found) = self.plan.judge(claim, &self.outcomes());
            page.paragraph(format!("  {}\n    {verdict}: {found}", claim.says));
        }
        page.lines("Not trained", &self.failed).written(written);
        page
    }

    fn value(&self) -> Value {
        let row = |told: &Told| {
            let mut value = over_seeds::value(&told.row.runs, &told.row.failed);
            value["part"] = told.cell.part.as_str().into();
            value["task"] = told.cell.config.task.as_str().into();
            value["algorithm"] = told.cell.algorithm.as_str().into();
            value["setting"] = told.cell.setting.as_str().into();
            value["share_of_controller"] = json!(told.beside(&self.controllers));
            value
        };
        let claim = |claim: &Claim| {
            let (verdict, found) = self.plan.judge(claim, &self.outcomes());
            json!({ "says": claim.says, "verdict": verdict, "found": found })
        };
        let controllers = self
            .controllers
            .iter()
            .map(|(task, (name, e))| (task.clone(), json!({ "flown_by": name, "evaluation": e })));
        json!({
            "command": "study",
            "version": env!("CARGO_PKG_VERSION"),
            "study": self.name,
            "budget": self.budget,
            "seeds": self.seeds,
            "rows": self.rows.iter().map(row).collect::<Vec<_>>(),
            "controllers": controllers.collect::<serde_json::Map<_, _>>(),
            "claims": self.plan.claims.iter().map(claim).collect::<Vec<_>>(),
            "not_trained": self.failed,
        })
    }
}

/// What the numbers of the table are.
const KEY: &str = "\
Success and return: mean over seeds, from held-out starts; success ± half the width of its 95 % interval (least–largest).
Beside ours: return over that of our controller. Time: of training, on the threads that it had.";

#[cfg(test)]
mod tests {
    use super::*;

    /// The study with rows of these algorithms, whose returns are that share of our controller's, after a step.
    fn study(shares: &[(&str, f64)], seeds: u64) -> Study {
        let after_a_step: Vec<(&str, f64, u64)> = shares.iter().map(|(name, share)| (*name, *share, 1)).collect();
        study_of(&after_a_step, seeds)
    }

    /// Likewise, after so many steps.
    fn study_of(shares: &[(&str, f64, u64)], seeds: u64) -> Study {
        let plan = Plan::by_name("paper").unwrap();
        let told = |return_mean: f64| Evaluation { return_mean, ..serde_json::from_str(FLOWN).unwrap() };
        let row = |cell: Cell| {
            let share =
                shares.iter().find(|(name, ..)| *name == cell.algorithm).map(|(_, share, n)| (100.0 * share, *n));
            let run = |seed: u64, (share, steps)| over_seeds::Outcome {
                seed,
                commit: None,
                evaluation: told(share),
                seconds: 1.0,
                env_steps: steps,
                updates: 1,
                curve: vec![(1, 1, share)],
            };
            let runs = share.into_iter().flat_map(|share| (0..seeds).map(move |seed| run(seed, share))).collect();
            let row = Row {
                task: cell.config.task.clone(),
                algorithm: cell.algorithm.clone(),
                setting: cell.setting.clone(),
                hash: String::new(),
                runs,
                failed: Vec::new(),
            };
            let curves = row.curves(Path::new("no-folder"));
            Told { cell, row, curves }
        };
        let rows: Vec<Told> = plan.cells(&[], &[], 1.0).unwrap().into_iter().map(row).collect();
        let tasks = rows.iter().map(|row| row.cell.config.task.clone());
        let controllers = tasks.map(|task| (task, ("ours".to_string(), told(100.0)))).collect();
        Study { name: "paper".into(), plan, budget: 1.0, seeds: 3, rows, controllers, failed: Vec::new() }
    }

    const FLOWN: &str = r#"{"n_episode": 1, "return_mean": 0, "return_std": 0, "share_of_bound": 0, "terms": [], "success": 0,
        "success_interval": [0, 0], "success_by_last_error": 0, "crashed": 0, "length": 0, "final_metrics": [],
        "final_error": 0, "mean_error": 0, "ends": []}"#;

    fn verdict(study: &Study, begins: &str) -> &'static str {
        let claim = study.plan.claims.iter().find(|claim| claim.says.starts_with(begins)).unwrap();
        study.plan.judge(claim, &study.outcomes()).0
    }

    #[test]
    fn curves_are_drawn_of_rows_whose_logs_are_elsewhere() {
        let some = study(&[("ppo", 0.9), ("sac", 0.8)], 2);
        let svg = figure::figure("Title", &some.rows).expect("two rows a task").svg().unwrap();
        assert!(["Hover: single drones", "ppo", "sac"].iter().all(|name| svg.contains(name)), "{svg}");
        assert!(figure::figure("Title", &study(&[], 2).rows).is_none());
    }

    #[test]
    fn statements_are_judged_by_whole_rows_of_their_algorithms() {
        let well = study(&[("ppo", 0.9), ("sac", 0.8), ("td3", 0.76), ("dqn", 0.7), ("ddpg", 0.1)], 3);
        assert_eq!((verdict(&well, "PPO, SAC"), verdict(&well, "DQN")), ("holds", "holds"));
        let ill = study(&[("ppo", 0.9), ("sac", 0.74), ("td3", 0.8), ("dqn", 0.8), ("ddpg", 0.1)], 3);
        assert_eq!((verdict(&ill, "PPO, SAC"), verdict(&ill, "DQN")), ("does not hold", "does not hold"));
        assert!(verdict(&well, "QMIX").starts_with("not decided"));
        let half = study(&[("ppo", 0.9), ("sac", 0.8), ("td3", 0.76)], 2);
        assert!(verdict(&half, "PPO, SAC").starts_with("not decided"), "two seeds of three");
    }

    #[test]
    fn who_had_fewer_steps_than_another_that_flies_is_not_said_to_fail() {
        let others = ["happo", "ppo", "sac", "td3", "maddpg", "matd3", "dqn", "vdn"].map(|name| (name, 0.1, 1));
        let of = |own: &[(&'static str, f64, u64)]| verdict(&study_of(&[own, &others].concat(), 3), "QMIX");
        assert_eq!(of(&[("mappo", 0.9, 16), ("qmix", 0.6, 4)]), "not decided: others that fly had more steps");
        assert_eq!(of(&[("mappo", 0.9, 16), ("qmix", 0.6, 16)]), "holds");
        assert_eq!(of(&[("mappo", 0.7, 16), ("qmix", 0.6, 4)]), "holds");
        assert_eq!(of(&[("qmix", 0.6, 4)]), "not decided: rows or our controllers are missing");
        assert_eq!(of(&[("qmix", 0.8, 4)]), "does not hold", "who flies needs nobody beside it");
    }
}
