//! `omnidrones view`: episodes live in a browser, served on loopback while they are flown.

use super::environment::EnvArguments;
use super::episodes::{SHOWN, Seen};
use super::shown::{Flier, check_number};
use crate::prelude::*;
use omnidrones_viewer::Server;
use std::io::Write;
use std::time::{Duration, Instant};

/// What the command is for.
pub const ABOUT: &str = "\
Show episodes live: the page of 'replay', which follows the flight while it is simulated in real time, episode after episode, \
until the command is stopped. It is served to this machine alone (127.0.0.1); any number of windows may look, and one that is \
loaded again sees the episode from its start.";

const EXAMPLES: &str = "\
Examples:
  omnidrones view Hover                          our controller, on a port that is free
  omnidrones view runs/Hover-apg-s0 --envs 2     what was learnt
  omnidrones view DragonHover --envs 1 --port 8765
  omnidrones view Hover --duration 5             for five seconds

The address stands on standard error; --json is silent there: name --port with it. On another machine: \
ssh -L 8765:127.0.0.1:8765 MACHINE, then the same address.

Exit codes: 0 shown until --duration was over; 2 unusable input or arguments; 130 stopped.";

/// Between two looks at who asks for what.
const BREATH: Duration = Duration::from_millis(3);

/// Arguments of `view`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Folder of a run, or a task flown by our controller
    #[arg(value_name = "RUN|TASK")]
    shown: String,
    /// Episodes shown at once, up to 16
    #[arg(long, value_name = "N", default_value_t = SHOWN)]
    envs: usize,
    /// Port on 127.0.0.1; 0 takes one that is free
    #[arg(long, value_name = "N", default_value_t = 0)]
    port: u16,
    /// End after this long [s] [default: when it is stopped]
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    #[command(flatten)]
    environment: EnvArguments,
    /// Print one JSON object and nothing else
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// Shows.
pub fn run(a: &Arguments) -> Result<Report> {
    check_number(a.envs)?;
    if let Some(seconds) = a.duration.filter(|s| !(*s >= 0.0 && *s < 1e9)) {
        return Err(Error::value("--duration", seconds, "0 to 1e9 s", "Leave it out to show it until it is stopped."));
    }
    let mut flier = Flier::new(&a.shown, &a.environment, a.envs, None)?;
    let mut server = Server::new(a.port)?;
    if !a.json {
        let _ = writeln!(std::io::stderr(), "{} at {}   Ctrl-C ends it", shown(&a.shown), server.address());
    }
    let begun = Instant::now();
    let over = || a.duration.is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds);
    let (mut episodes, mut frames, mut most) = (0, 0_u64, 0);
    while !over() {
        let (mut seen, from) = (Seen::new(a.envs), Instant::now());
        let flown = flier.fly(&mut |watched| {
            let due = seen.frame(watched);
            let Some(recording) = seen.so_far().filter(|_| due && !over()) else { return };
            if watched.step == 1 {
                server.begin(recording);
            } else {
                server.frame(recording);
            }
            frames += 1;
            let next = Duration::from_secs_f64(watched.step as f64 * watched.env.spec().dt);
            while from.elapsed() < next && !over() {
                server.pump(Some(recording));
                std::thread::sleep(BREATH);
            }
            server.pump(Some(recording));
            most = most.max(server.viewers());
        })?;
        // an error of the recording is told, not shown as a standstill
        seen.recording(&flown)?;
        episodes += 1;
    }
    let lasted = begun.elapsed().as_secs_f64();
    if a.json {
        let value = json!({
            "command": "view",
            "version": env!("CARGO_PKG_VERSION"),
            "address": server.address(),
            "rounds": episodes,
            "frames": frames,
            "viewers": most,
            "wall_time": lasted,
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.title(&a.shown, &format!("shown for {}, to at most {most} at once", duration(lasted)));
    Ok(Report::page(&page, true))
}
