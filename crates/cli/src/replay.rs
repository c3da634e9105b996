//! `omnidrones replay`: episodes as one page for a browser; and what every command records for such a page.

use super::arguments::PageArguments;
use super::environment::EnvArguments;
use super::episodes::{Flown, SHOWN, Seen};
use super::shown::{Flier, check_number};
use crate::prelude::*;
use omnidrones_viewer::{Recording, page};

/// What the command is for.
pub const ABOUT: &str = "\
Write flights as one page for a browser: a few episodes in space, with targets, ways, forces, and curves under a time line. \
The page is one file that opens from the disk and asks no network for anything. Two runs, or a run and our controller, are \
shown beside each other under one clock.";

const EXAMPLES: &str = "\
Examples:
  omnidrones replay runs/Hover-apg-s0                      a policy, to runs/Hover-apg-s0/replay.html
  omnidrones replay runs/Hover-apg-s0 Hover                beside our own controller, from its starts of seed 0
  omnidrones replay TransportHover --envs 1                our controller alone, to out/TransportHover/replay.html
  omnidrones replay runs/Hover-apg-s0 --out page.html      to another file

'fly', 'rollout', 'eval', 'train' and 'tune' have --replay, and 'watch' writes the page too.

On the page: drag to turn, wheel or two fingers to come nearer. Space plays, arrows step (with shift a second), 1 2 3 choose the \
camera (orbit, follow, on board), N the next drone, F shows forces, T ways, R targets, I what is flown, + and - the speed. \
#t=2.5&camera=follow&play=0 behind its address begins there. Discs of rotors are blue where they turn counter-clockwise, \
orange clockwise, red where they failed. Systems of bodies are drawn beside each other, single drones in one room.

Exit codes: 0 written; 2 unusable input or arguments.";

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| out.help("The page [default: replay.html in the run's folder, or in out/TASK]")))]
pub struct Arguments {
    /// Folder of a run, or a task flown by our controller; two of them beside each other
    #[arg(value_name = "RUN|TASK", required = true, num_args = 1..=2)]
    shown: Vec<String>,
    /// Episodes shown at once, up to 16
    #[arg(long, value_name = "N", default_value_t = SHOWN)]
    envs: usize,
    #[command(flatten)]
    environment: EnvArguments,
    #[command(flatten)]
    output: PageArguments,
}

/// Writes.
pub fn run(a: &Arguments) -> Result<Report> {
    check_number(a.envs)?;
    a.output.check()?;
    let flier = |named: &String, beside: Option<&Flier>| Flier::new(named, &a.environment, a.envs, beside);
    let mut fliers = a.shown.iter().map(|named| flier(named, None)).collect::<Result<Vec<_>>>()?;
    if let [one, other] = &fliers[..] {
        let beside = [flier(&a.shown[0], Some(other))?, flier(&a.shown[1], Some(one))?];
        fliers = beside.into();
    }
    let path = match &a.output.out {
        Some(path) => path.clone(),
        None => {
            let folder = fliers[0].folder(&a.shown[0]);
            if let Flier::Own(_) = fliers[0] {
                files::prepare(&folder, a.output.force)?;
            }
            folder.join(files::REPLAY)
        }
    };
    files::check_new(&path, a.output.force)?;
    files::make_parent(&path)?;
    let spinner = progress::spinner("flying", a.output.json);
    let flown: Vec<(Flown, Recording)> = fliers.iter_mut().map(|flier| one(flier, a.envs)).collect::<Result<_>>()?;
    spinner.finish_and_clear();
    let title = flown.iter().map(|(flown, _)| flown.title()).collect::<Vec<_>>().join(" beside ");
    let recordings: Vec<Recording> = flown.iter().map(|(_, recording)| recording.clone()).collect();
    let text = page(&title, &recordings);
    files::write_new(&path, &text, a.output.force)?;
    if a.output.json {
        let shown = |(flown, recording): &(Flown, Recording)| {
            json!({
                "task": flown.task(),
                "flown_by": flown.controller,
                "evaluation": flown.evaluation,
                "frames": recording.n_frame(),
                "seconds_apart": recording.interval,
            })
        };
        let value = json!({
            "command": "replay",
            "version": env!("CARGO_PKG_VERSION"),
            "flights": flown.iter().map(shown).collect::<Vec<_>>(),
            "bytes": text.len(),
            "files": files::names(&[path]),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    for (flown, _) in &flown {
        page.title(flown.task(), &format!("{}, flown by {}", counted(a.envs, "episode"), flown.controller));
        let e = &flown.evaluation;
        let [success, crashed] = [percent(e.success), percent(e.crashed)];
        page.line(format!("  success {success}, crashed {crashed}, return {}", short(e.return_mean, 4)));
    }
    page.heading("Written").line(format!("  {}   {} kB", path.display(), text.len() / 1000));
    Ok(Report::page(&page, true))
}

/// The page of the first episodes of a run's policy.
pub fn of_run(folder: &Path) -> Result<String> {
    let mut flier = Flier::new(&folder.display().to_string(), &EnvArguments::default(), SHOWN, None)?;
    let (flown, recording) = one(&mut flier, SHOWN)?;
    Ok(page(&flown.title(), &[recording]))
}

/// Flies and records.
fn one(flier: &mut Flier, envs: usize) -> Result<(Flown, Recording)> {
    let mut seen = Seen::new(envs);
    let flown = flier.fly(&mut |watched| seen.see(watched))?;
    let recording = seen.recording(&flown)?;
    Ok((flown, recording))
}
