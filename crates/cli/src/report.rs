//! `omnidrones report`: trained policies as one page: settings, how they learnt, how they fly beside our controllers, a replay.

mod runs;
mod several;

use super::arguments::PageArguments;
use super::baseline::compare;
use super::html::html;
use super::train_all;
use crate::prelude::*;
use omnidrones::parallel::Threads;
use omnidrones::rl::TrainConfig;
use omnidrones::tasks::Evaluation;
use omnidrones::tasks::registry::TaskEntry;

/// What the command is for.
pub const ABOUT: &str = "\
Write what was learnt as one page for a browser or a printer: settings, learning curves, a table beside our controllers, errors \
over time, and the policy in flight to turn around and look at. Several runs stand side by side. Folders of 'train --seeds', \
'train --search' and 'train-all' are told as a whole. The page is one file that asks no network for anything.";

const EXAMPLES: &str = "\
Examples:
  omnidrones report runs/Hover-apg-s0                      a run, to runs/Hover-apg-s0/report.html
  omnidrones report runs/Hover-apg-s0 --out mine.html      to another file
  omnidrones report runs/Hover-apg-s0 --no-replay          without the flight: a small file

A folder of 'train' is a run; two or more are compared: their curves in the same panels, the settings that differ, and up to four \
flown beside each other under one clock. A folder of 'train --seeds' is told with means and intervals over seeds, one of \
'train --search' candidate by candidate, one of 'train-all' (or of its rows alone) task by task.

Policies fly now, with the physics of this program, from the starts of their evaluations; our controllers from the first 256 of \
these. Rows of 'train-all' are told as they were kept, with the commits that trained them.

Exit codes: 0 written; 2 unusable input or arguments.";

/// Arguments of `report`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| out.help("The page [default: report.html in the folder of the run, of several reports.html in that of the first]")))]
pub struct Arguments {
    /// Folders of 'train', 'train --seeds', 'train --search', 'train-all'
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Do not fly our controllers for comparison
    #[arg(long)]
    no_baseline: bool,
    /// Leave the flight in space out
    #[arg(long)]
    no_replay: bool,
    #[command(flatten)]
    output: PageArguments,
}

/// What a folder is of.
enum Kind {
    Run,
    Seeds,
    Search,
    All,
}

impl Kind {
    fn of(folder: &Path) -> Self {
        let holds = |name: &str| folder.join(name).is_file();
        match () {
            () if holds("seeds.json") => Self::Seeds,
            () if holds("search.json") => Self::Search,
            () if holds("table.json") || !folder.join("checkpoints").is_dir() && train_all::has_rows(folder) => {
                Self::All
            }
            // what is no run at all is told so by who opens it
            () => Self::Run,
        }
    }
}

/// Writes.
pub fn run(a: &Arguments) -> Result<Report> {
    let path = place(a)?;
    let spinner = progress::spinner("flying", a.output.json);
    let telling = Telling { threads: Threads::default(), baselines: !a.no_baseline, replays: !a.no_replay };
    let kinds: Vec<Kind> = a.runs.iter().map(|folder| Kind::of(folder)).collect();
    let origins = a.runs.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ");
    let remark = format!("{origins}; omnidrones {}", env!("CARGO_PKG_VERSION"));
    let mut told = Page::new();
    if kinds.iter().all(|kind| matches!(kind, Kind::Run)) {
        let mut flown = a.runs.iter().map(|folder| runs::Told::of(folder, &telling)).collect::<Result<Vec<_>>>()?;
        runs::tell_apart(&mut flown);
        told.title(&runs::title(&flown), &remark);
        runs::tell(&mut told, &flown)?;
    } else {
        told.title("What was learnt", &remark);
        for (folder, kind) in a.runs.iter().zip(&kinds) {
            several::tell(&mut told, folder, kind, &telling)?;
        }
    }
    let text = html(&told);
    spinner.finish_and_clear();
    files::write_new(&path, &text, a.output.force)?;
    if a.output.json {
        let value = json!({
            "command": "report",
            "version": env!("CARGO_PKG_VERSION"),
            "runs": files::names(&a.runs),
            "bytes": text.len(),
            "files": files::names(&[path]),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.title("Report", &origins);
    page.heading("Written").line(format!("  {}   {} kB", path.display(), text.len() / 1000));
    Ok(Report::page(&page, true))
}

/// Where the page goes; refused before any work where it cannot.
fn place(a: &Arguments) -> Result<PathBuf> {
    a.output.check()?;
    let name = if a.runs.len() == 1 { "report.html" } else { "reports.html" };
    let path = a.output.out.clone().unwrap_or_else(|| a.runs[0].join(name));
    files::check_new(&path, a.output.force)?;
    Ok(path)
}

/// How it is told.
struct Telling {
    threads: Threads,
    baselines: bool,
    replays: bool,
}

impl Telling {
    /// Our controller from the first of the same starts, if it is asked for.
    fn baseline(&self, entry: &TaskEntry, config: &TrainConfig) -> Option<(String, Evaluation)> {
        self.baselines.then(|| compare(entry, config, &self.threads)).flatten()
    }
}
