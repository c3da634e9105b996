//! `omnidrones bench`: how fast this machine steps and differentiates, against a plain loop in the same run.

use super::arguments::FormatName;
use super::page::{Page, short};
use super::table::{Align, Table, number};
use super::{Report, files, progress};
use omnidrones::autodiff::lane_width;
use omnidrones::bench::{self, BenchPlan, BenchRow};
use omnidrones::error::{Error, Result};
use omnidrones::plot::{Bar, Bars, Colour, Figure};
use serde_json::json;
use std::path::PathBuf;

const ABOUT: &str = "\
Measure how fast this machine steps and differentiates a multirotor: single steps on each kind of number, batches on \
one and more threads, Jacobians, adjoints, rollout gradients. Each figure is set against a plain loop measured in the \
same run, so that ratios hold where absolute figures depend on the machine.";

const EXAMPLES: &str = "\
Examples:
  omnidrones bench --quick               a first impression, in seconds
  omnidrones bench                       steadier figures
  omnidrones bench --threads 1,2,4       batch throughput on these numbers of threads
  omnidrones bench --json --no-plots     for a program

Files in --out: bench.png or bench.svg, the ratios as bars. Close other programs: figures fall with their load.

Exit codes: 0 measured; 2 unusable arguments.";

/// Arguments of `bench`.
#[derive(Debug, clap::Args)]
#[command(long_about = ABOUT, after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Short runs: seconds instead of about a minute, and less steady figures
    #[arg(long)]
    quick: bool,
    /// Numbers of threads for the batch rows, each 1 to 1024 [default: 1 and all cores]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    threads: Vec<usize>,
    /// Folder for the plot
    #[arg(long, value_name = "DIR", default_value = "out/bench")]
    out: PathBuf,
    /// File type of the plot
    #[arg(long, value_name = "TYPE", default_value = "png")]
    format: FormatName,
    /// Draw nothing
    #[arg(long)]
    no_plots: bool,
    /// Print one JSON object and nothing else
    #[arg(long)]
    json: bool,
}

/// Measures.
pub fn run(a: &Arguments) -> Result<Report> {
    if let Some(n) = a.threads.iter().find(|n| !(1..=1024).contains(*n)) {
        return Err(Error::limit("--threads", n, "1 to 1024 each", "Use as many as there are cores."));
    }
    if !a.no_plots {
        files::prepare_folder(&a.out)?;
    }
    let spinner = progress::spinner("measuring", a.json);
    let plan = BenchPlan { quick: a.quick, threads: a.threads.clone() };
    let rows = bench::run(&plan, |what| spinner.set_message(format!("measuring {what}")))?;
    spinner.finish_and_clear();

    let mut written = Vec::new();
    if !a.no_plots {
        let path = a.out.join(format!("bench.{}", a.format.extension()));
        figure(&rows).save(&path)?;
        written.push(path);
    }
    if a.json {
        let value = json!({
            "command": "bench",
            "version": env!("CARGO_PKG_VERSION"),
            "quick": a.quick,
            "lane_width": lane_width(),
            "rows": rows,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.line(machine());
    let mut table = Table::new(&[
        ("what", Align::Left),
        ("", Align::Left),
        ("figure", Align::Right),
        ("unit", Align::Left),
        ("ratio", Align::Right),
        ("against", Align::Left),
    ]);
    let mut group = "";
    for row in &rows {
        let first = if row.group == group { "" } else { row.group };
        group = row.group;
        let (ratio, against) = match row.ratio {
            Some(r) => (format!("{} ×", number(r, if r < 10.0 { 2 } else { 1 })), row.baseline),
            None => (String::new(), ""),
        };
        table.row([first, &row.name, &short(row.value, 4), row.unit, &ratio, against].map(str::to_string));
    }
    page.table(&table);
    for path in &written {
        page.line(format!("written {}", path.display()));
    }
    Ok(Report::done(page.finish()))
}

/// What it ran on.
fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{threads} threads, {} lanes of f32 per SIMD register", lane_width())
}

/// The ratios, one colour per group.
fn figure(rows: &[BenchRow]) -> Figure {
    let mut bars = Bars::new("", "ratio to the plain loop of the same run").baseline("plain loop", 1.0).log();
    let mut groups: Vec<&str> = Vec::new();
    for row in rows {
        let Some(ratio) = row.ratio else { continue };
        if !groups.contains(&row.group) {
            groups.push(row.group);
        }
        let bar = Bar::new(format!("{}: {}", row.group, row.name), ratio);
        bars = bars.bar(
            bar.note(format!("× · {} {}", short(row.value, 3), row.unit))
                .colour(Colour::nth(groups.len().saturating_sub(1))),
        );
    }
    let height = 110.0 + 24.0 * bars.bars.len() as f64;
    Figure::new("Speed of steps and derivatives").subtitle(machine()).size(900.0, height.min(3000.0)).chart(bars)
}
