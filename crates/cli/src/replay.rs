//! `omnidrones replay`: episodes as one page for a browser; and what every command records for such a page.

use super::environment::EnvArguments;
use super::page::{Page, percent, plain_facts, short};
use super::rollout::Flown;
use super::shown::{Flier, check_number};
use super::{Report, files, progress};
use omnidrones::error::{Error, Result};
use omnidrones::tasks::Watched;
use omnidrones_viewer::{Episodes, Recording, page};
use serde_json::json;
use std::path::{Path, PathBuf};

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

/// Episodes that other commands show.
pub const SHOWN: usize = 4;

/// Arguments of `replay`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Folder of a run, or a task flown by our controller; two of them beside each other
    #[arg(value_name = "RUN|TASK", required = true, num_args = 1..=2)]
    shown: Vec<String>,
    /// Episodes shown at once, up to 16
    #[arg(long, value_name = "N", default_value_t = SHOWN)]
    envs: usize,
    #[command(flatten)]
    environment: EnvArguments,
    /// The page [default: replay.html in the run's folder, or in out/TASK]
    #[arg(long, value_name = "FILE.html", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Replace a file that exists
    #[arg(long, help_heading = "Output")]
    force: bool,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// Writes.
pub fn run(a: &Arguments) -> Result<Report> {
    check_number(a.envs)?;
    if let Some(path) = a.out.as_ref().filter(|p| p.extension().is_none_or(|e| !e.eq_ignore_ascii_case("html"))) {
        let value = format!("'{}'", path.display());
        return Err(Error::value("page", value, "a name that ends in .html", "Add .html to it."));
    }
    let flier = |named: &String, beside: Option<&Flier>| Flier::new(named, &a.environment, a.envs, beside);
    let mut fliers = a.shown.iter().map(|named| flier(named, None)).collect::<Result<Vec<_>>>()?;
    if let [one, other] = &fliers[..] {
        let beside = [flier(&a.shown[0], Some(other))?, flier(&a.shown[1], Some(one))?];
        fliers = beside.into();
    }
    let path = match &a.out {
        Some(path) => path.clone(),
        None => {
            let folder = fliers[0].folder(&a.shown[0]);
            if let Flier::Own(_) = fliers[0] {
                files::prepare(&folder, a.force)?;
            }
            folder.join("replay.html")
        }
    };
    files::check_new(&path, a.force)?;
    files::make_parent(&path)?;
    let spinner = progress::spinner("flying", a.json);
    let flown: Vec<(Flown, Recording)> = fliers.iter_mut().map(|flier| one(flier, a.envs)).collect::<Result<_>>()?;
    spinner.finish_and_clear();
    let title = flown.iter().map(|(flown, _)| flown.title()).collect::<Vec<_>>().join(" beside ");
    let recordings: Vec<Recording> = flown.iter().map(|(_, recording)| recording.clone()).collect();
    let text = page(&title, &recordings);
    files::write_new(&path, &text, a.force)?;
    if a.json {
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
        page.title(flown.task(), &format!("{} episodes, flown by {}", a.envs, flown.controller));
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

/// What is recorded of episodes while they are flown.
pub struct Seen {
    most: usize,
    episodes: Option<Episodes>,
    refused: Option<Error>,
}

impl Seen {
    /// Of the first `most` environments; of none, nothing is done.
    pub fn new(most: usize) -> Self {
        Self { most, episodes: None, refused: None }
    }

    /// Sees a step; whether a frame came of it.
    pub fn see(&mut self, watched: &Watched<'_>) {
        let _ = self.frame(watched);
    }

    /// As [`see`](Self::see), and whether a frame came of it.
    pub fn frame(&mut self, watched: &Watched<'_>) -> bool {
        if self.most == 0 || self.refused.is_some() {
            return false;
        }
        self.seen(watched).unwrap_or_else(|error| {
            self.refused = Some(error);
            false
        })
    }

    fn seen(&mut self, watched: &Watched<'_>) -> Result<bool> {
        if watched.step == 1 {
            self.episodes = Some(Episodes::new(watched.env, self.most)?);
        }
        self.episodes.as_mut().map_or(Ok(false), |episodes| episodes.see(watched))
    }

    /// What was recorded up to now.
    pub fn so_far(&self) -> Option<&Recording> {
        self.episodes.as_ref().and_then(Episodes::so_far)
    }

    /// The recording, with who flew and how well.
    pub fn recording(self, flown: &Flown) -> Result<Recording> {
        if let Some(error) = self.refused {
            return Err(error);
        }
        let Some(mut recording) = self.episodes.and_then(Episodes::recording) else {
            return Err(Error::value("recording", "empty", "at least one step", "Fly longer episodes."));
        };
        recording.title = flown.title();
        recording.remark = flown.headline();
        recording.facts = plain_facts(&flown.facts());
        Ok(recording)
    }
}
