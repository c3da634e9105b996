//! `omnidrones tune`: gains by gradients through closed-loop flights, judged on starts that the tuning never saw.

use super::arguments::{self, OutputArguments};
use super::robot::FlyerArguments;
use super::sheet::{self, KeyFigures};
use super::tune_grid::{self, GridArguments};
use crate::prelude::*;
use omnidrones::controllers::design::tune::{GainEvaluation, Iteration, TunePlan, Tuning, tune};
use omnidrones::controllers::design::{GridCell, LoopMargins, MarginGate, MarginReport};
use omnidrones::controllers::{Flight, FlightPlan, Proportion, Reference, fly_vehicle};
use omnidrones::dynamics::aero::wind::Wind;
use omnidrones::dynamics::{Gains, Plant, Vehicle};
use omnidrones_plot::{Bar, Bars, Colour, Figure, Panel, Series};
use std::fmt::Write;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// What the command is for.
pub const ABOUT: &str = "\
Tune all gains of a vehicle's position, velocity, attitude and rate controllers, and of their integral action. Many flights from random starts \
are simulated closed loop; the exact gradient of their mean squared tracking error comes back through every step \
(motor lag, saturation and sampled controllers included), and Adam follows it. The result is judged on held-out starts \
that the tuning never saw. Margins are measured before and after, and it warns where one falls by more than a tenth; with --margins a disk margin is held.";

const EXAMPLES: &str = "\
Examples:
  omnidrones tune hummingbird                               60 descent steps
  omnidrones tune firefly --iterations 30 --starts 64       shorter
  omnidrones tune drone.urdf --reference circle             your vehicle on another reference
  omnidrones tune hummingbird --gains derived --margins     a disk margin of 0.5, at every corner
  omnidrones tune iris --also circle --latency 5            on two references, commands 10 ms late
  omnidrones tune iris --gains derived --json --no-plots    from derived gains, for a program
  omnidrones tune hummingbird --grid --randomise 0.3        on circles and plants, judged on others

Files in --out: gains.toml where they are better, else one of before stays (fly with them: omnidrones fly VEHICLE --gains out/VEHICLE/gains.toml), and tune.png or \
tune.svg: the descent, and one flight before and after.

JSON: SI units; \"before\" and \"after\" are held-out flights: mean and worst RMSE (the start included; null where all were lost), and \"crashed\": how many were lost \
(diverged, or more than 5 m off; these flights know no ground).

The gate of --margins: the loop that flies, at hover and forward at 5 and 10 m/s, with mass, inertia and motor lag as believed and \
at both ends of ±30 %, keeps a disk margin of all commands at once (Seiler, Packard and Gahinet 2020) of at least --disk. Whether it bears 50 ms of \
latency at hover is told, too.

--grid tunes on circles of given accelerations and speeds, flown from the first instant at full speed: on every other cell of the grid, \
as on a chessboard, that the vehicle can fly, which is where its steady turn leaves every rotor a fifth of its thrust. The other half is judged alone, cell by cell. \
--randomise draws mass, inertia and motor lag of every flight's plant; held-out flights have plants of their own.

Exit codes: 0 better on the held-out starts and cells, none lost, and through the gate of --margins; 1 not so; 2 unusable input or arguments.";

/// Arguments of `tune`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| arguments::out(out, "Folder for what is written [default: out/VEHICLE]")))]
pub struct Arguments {
    #[command(flatten)]
    flyer: FlyerArguments,
    /// Length of each training flight [s] [default: 6, with --grid 3]
    #[arg(long, value_name = "SECONDS", help_heading = "Flight")]
    duration: Option<f64>,
    /// Descent steps
    #[arg(long, value_name = "N", default_value_t = TunePlan::default().iterations, help_heading = "Tuning")]
    iterations: usize,
    /// Random starts to tune on; multiples of 64 fill the SIMD lanes
    #[arg(long, value_name = "N", default_value_t = TunePlan::default().n_start, help_heading = "Tuning")]
    starts: usize,
    /// Random starts to judge on, along each reference [default: 256, with --grid 32]
    #[arg(long, value_name = "N", help_heading = "Tuning")]
    held_out: Option<usize>,
    /// Relative change of a gain per step, at first
    #[arg(long, value_name = "SHARE", default_value_t = TunePlan::default().learning_rate,
          help_heading = "Tuning")]
    learning_rate: f64,
    /// Seed of the starts
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Tuning")]
    seed: u64,
    /// Further references to tune on, separated by commas: as --reference
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Tuning")]
    also: Vec<String>,
    /// Steps by which commands act late
    #[arg(long, value_name = "STEPS", default_value_t = 0, help_heading = "Tuning")]
    latency: usize,
    /// Fly plants whose mass, inertia and motor lag are drawn within 1 ± SHARE of what is believed
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, help_heading = "Tuning")]
    randomise: f64,
    #[command(flatten)]
    grid: GridArguments,
    /// Hold a disk margin, to 10 m/s and over ±30 % of mass, inertia and motor lag
    #[arg(long, help_heading = "Margins")]
    margins: bool,
    /// The least disk margin of all commands at once
    #[arg(long, value_name = "ALPHA", default_value_t = MarginGate::default().disk, requires = "margins",
          help_heading = "Margins")]
    disk: f64,
    #[command(flatten)]
    output: OutputArguments,
    /// Write replay.html: the nominal flight before and after, beside each other, a page for any browser
    #[arg(long, help_heading = "Output")]
    replay: bool,
}

/// Tunes.
pub fn run(a: &Arguments) -> Result<Report> {
    a.flyer.flight.check()?;
    let source = a.flyer.source()?;
    let vehicle = &source.vehicle;
    let (gains, gains_name) = a.flyer.flight.gains(vehicle)?;
    let cells = a.grid.cells(vehicle, &a.flyer.flight.physics())?;
    let plan = plan(a, &cells)?;
    let mut outputs = a.output.open(files::default_folder(&vehicle.name), true)?;

    let bar = progress::bar(a.iterations as u64, "judging, then tuning", a.output.json);
    bar.enable_steady_tick(Duration::from_millis(200));
    let start = Instant::now();
    let tuning = tune(vehicle, &gains, &plan, &mut |step| {
        bar.set_position(step.iteration as u64 + 1);
        bar.set_message(format!("RMSE {}", length(step.rmse)));
        ControlFlow::Continue(())
    })?;
    let wall_time = start.elapsed().as_secs_f64();
    bar.finish_and_clear();

    let passes = tuning.judged.as_ref().is_none_or(|[_, after]| after.passes);
    let held_out = !tuning.is_worse_held_out() && tuning.held_out.is_none_or(|[_, after]| after.crashed == 0);
    let better = passes && held_out && tuning.after.crashed == 0 && tuning.after.rmse < tuning.before.rmse;
    // gains of before, which may be better, are not written over by a tuning that failed
    if better {
        outputs.put("gains.toml", |path| write_gains(path, &plan, vehicle, &gains_name, &tuning))?;
    }
    if a.replay || !a.output.no_plots {
        let flight = |gains: &Gains| fly_vehicle(vehicle, gains, &nominal(&plan), &mut |_| {});
        let [before, after] = [flight(&gains)?, flight(&tuning.gains)?];
        outputs.draw("tune", || figure(&vehicle.name, &tuning, &gains, &before, &after))?;
        if a.replay {
            outputs.text(files::REPLAY, replay(vehicle, &plan, [("before", &before), ("after", &after)])?)?;
        }
    }
    let written = outputs.done(|name| name == "tune")?;
    if a.output.json {
        let value = json!({
            "command": "tune",
            "version": env!("CARGO_PKG_VERSION"),
            "success": better,
            "vehicle": KeyFigures::of(vehicle).json(vehicle),
            "source": source.json(),
            "plan": plan,
            "gains_before": gains,
            "gains": tuning.gains,
            "history": tuning.history,
            "before": tuning.before,
            "after": tuning.after,
            "margins_before": tuning.margins[0],
            "margins_after": tuning.margins[1],
            "judged_before": tuning.judged.as_ref().map(|j| &j[0]),
            "judged_after": tuning.judged.as_ref().map(|j| &j[1]),
            "references": tuning.references,
            "held_out_before": tuning.held_out.map(|both| both[0]),
            "held_out_after": tuning.held_out.map(|both| both[1]),
            "grid": cells,
            "crashed_after": Proportion::counted(tuning.after.crashed, tuning.after.n, CONFIDENCE),
            "warnings": warnings(&tuning),
            "elsewhere_before": tuning.elsewhere_before,
            "elsewhere_after": tuning.elsewhere_after,
            "less_robust": tuning.is_less_robust(),
            "improvement": 1.0 - tuning.after.rmse / tuning.before.rmse,
            "wall_time": wall_time,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, better));
    }

    let mut page = Page::new();
    source.describe(&mut page);
    page.heading("Tuning").facts(facts(&plan, &tuning, wall_time));
    if !cells.is_empty() {
        page.heading("Cells").table(tune_grid::table(&cells, &tuning));
    }
    page.heading("Gains").table(sheet::gains_table(vehicle, &[(&gains_name, gains), ("tuned", tuning.gains)]));
    page.written(&written);
    page.line("");
    for warning in warnings(&tuning) {
        page.line(format!("WARNING: {warning}"));
    }
    if better {
        let gains = written.first().map_or_else(String::new, |p| p.display().to_string());
        page.line(format!("Fly with them: omnidrones fly {} --gains {gains}", a.flyer.vehicle));
    } else {
        page.line(format!(
            "\nFAILED: {}; no gains.toml is written, and one of before is left. {}",
            why(&tuning),
            if passes { "Try more --starts, or a smaller --learning-rate" } else { "Try a smaller --disk" }
        ));
    }
    Ok(Report::page(&page, better))
}

/// Why tuned gains are not to be flown: all that speaks against them.
fn why(tuning: &Tuning) -> String {
    let (before, after) = (&tuning.before, &tuning.after);
    if tuning.judged.as_ref().is_some_and(|[_, after]| !after.passes) {
        return "no gains on the way bear what --margins asks for, so those it started from are kept".into();
    }
    let (mut all, lower) = (Vec::new(), after.rmse < before.rmse);
    if after.crashed > 0 {
        all.push(format!("{} of {} held-out flights are lost", after.crashed, after.n));
    }
    // an error of flights that were all lost is no number
    if !lower && after.crashed < after.n {
        all.push(format!(
            "the held-out RMSE is {}, no less than the {} before",
            length(after.rmse),
            length(before.rmse)
        ));
    }
    if let Some([first, last]) = &tuning.held_out {
        if last.crashed > 0 {
            all.push(format!(
                "{} of {} flights on the cells held out are lost, {} before",
                last.crashed, last.n, first.crashed
            ));
        } else if tuning.is_worse_held_out() {
            let both = [first, last].map(|e| length(e.rmse));
            all.push(format!("on the cells held out the RMSE is {}, {} before", both[1], both[0]));
        }
    }
    all.join("; ")
}

/// What is tuned on: the reference, unless there are cells alone; further ones; half of the cells.
fn plan(a: &Arguments, cells: &[GridCell]) -> Result<TunePlan> {
    let of = |held_out| cells.iter().filter(move |c| c.flyable && c.held_out == held_out).map(GridCell::reference);
    let own = cells.is_empty() || a.flyer.flight.reference.is_some();
    let mut references = if own { vec![a.flyer.flight.reference()?] } else { Vec::new() };
    for name in &a.also {
        references.push(arguments::reference(name)?);
    }
    references.extend(of(false));
    let default = if cells.is_empty() {
        TunePlan::default()
    } else {
        TunePlan { duration: 3.0, n_held_out: 32, ..TunePlan::default() }
    };
    Ok(TunePlan {
        reference: references.remove(0),
        also: references,
        held_out: of(true).collect(),
        plant_spread: a.randomise,
        duration: a.duration.unwrap_or(default.duration),
        physics: a.flyer.flight.physics(),
        rates: a.flyer.flight.rates(),
        n_start: a.starts,
        n_held_out: a.held_out.unwrap_or(default.n_held_out),
        iterations: a.iterations,
        learning_rate: a.learning_rate,
        seed: a.seed,
        latency: a.latency,
        margins: a.margins.then(|| MarginGate { disk: a.disk, ..MarginGate::default() }),
        ..default
    })
}

/// What the tuned gains lose.
fn warnings(tuning: &Tuning) -> Vec<String> {
    let mut all: Vec<String> = tuning
        .fallen()
        .into_iter()
        .map(|(name, before, after)| {
            format!("{name} of all commands at hover: {} → {}", short(before, 3), short(after, 3))
        })
        .collect();
    if !tuning.margins[1].stable {
        all.push("the loop of the tuned gains is not stable at hover, with the latency that is asked for: 'design' tells more".into());
    }
    if tuning.is_worse_held_out() {
        all.push("on the cells that were held out the tuned gains do worse than those they started from".into());
    }
    let (before, after) = (&tuning.elsewhere_before, &tuning.elsewhere_after);
    let mut worse = Vec::new();
    if after.crashed > before.crashed {
        worse
            .push(format!("lose {} of {} flights, those they started from {}", after.crashed, after.n, before.crashed));
    }
    if after.worst > before.worst {
        worse.push(format!(
            "err by {} at the worst, those they started from by {}",
            length(after.worst),
            length(before.worst)
        ));
    }
    if tuning.is_worse_elsewhere() {
        let place = "elsewhere (another reference, commands 10 ms late, other masses, rotors and motors)";
        all.push(format!("{place} the tuned gains {}", worse.join(", and ")));
    }
    all
}

/// The flight that the plot shows: the plan's, from its very start.
fn nominal(plan: &TunePlan) -> FlightPlan {
    FlightPlan {
        reference: plan.reference.clone(),
        duration: plan.duration,
        physics: plan.physics,
        rates: plan.rates,
        latency: plan.latency,
        wind: Wind::Calm,
        ..FlightPlan::default()
    }
}

/// References that are tuned on, each name once.
fn names(plan: &TunePlan) -> String {
    let mut names: Vec<(&str, usize)> = Vec::new();
    for name in plan.references().map(Reference::name) {
        match names.iter_mut().find(|(known, _)| *known == name) {
            Some((_, n)) => *n += 1,
            None => names.push((name, 1)),
        }
    }
    let told = |(name, n): (&str, usize)| if n > 1 { format!("{name} × {n}") } else { name.into() };
    names.into_iter().map(told).collect::<Vec<String>>().join(", ")
}

/// Of the bounds of crash rates.
const CONFIDENCE: f64 = 0.95;

/// By how much the error fell, in words where one of them is of no flight that was kept.
fn gained(before: &GainEvaluation, after: &GainEvaluation) -> String {
    let share = 1.0 - after.rmse / before.rmse;
    if share.is_finite() { format!("{:.1} %", 100.0 * share) } else { "by no number (all lost)".into() }
}

fn facts(plan: &TunePlan, tuning: &Tuning, wall_time: f64) -> Vec<Fact> {
    let judged = |e: &GainEvaluation| {
        let [low, high] = Proportion::counted(e.crashed, e.n, CONFIDENCE).bounds.map(|share| short(100.0 * share, 2));
        let share = format!("{low} to {high} % with {} % confidence", 100.0 * CONFIDENCE);
        // a flight that was lost has no error to tell
        let note = match e.crashed {
            0 => format!("worst {}, none of {} lost ({share})", length(e.worst), e.n),
            all if all == e.n => format!("all {} lost ({share})", e.n),
            lost => format!("worst {} of those kept, {lost} of {} lost ({share})", length(e.worst), e.n),
        };
        (length(e.rmse), note)
    };
    let ((before, before_note), (after, after_note)) = (judged(&tuning.before), judged(&tuning.after));
    let (elsewhere, elsewhere_after) = (judged(&tuning.elsewhere_before), judged(&tuning.elsewhere_after));
    let best = tuning.history.iter().map(|i| i.rmse).fold(f64::INFINITY, f64::min);
    let first = tuning.history.first().map_or(f64::NAN, |i| i.rmse);
    let steps = tuning.history.len();
    let per_step = duration(wall_time / steps.max(1) as f64);
    let mut facts = vec![
        Fact::new("reference", names(plan))
            .note(format!("{} s from {} random starts, {} held out", plan.duration, plan.n_start, plan.n_held_out)),
        Fact::new("descent", format!("{steps} steps")).note(format!("{} in all, {per_step} each", duration(wall_time))),
        Fact::new("training RMSE", format!("{} → {}", length(first), length(best))),
        Fact::new("held-out RMSE before", before).note(before_note),
        Fact::new("held-out RMSE after", after).note(after_note),
        Fact::new("elsewhere before", elsewhere.0).note(elsewhere.1),
        Fact::new("elsewhere after", elsewhere_after.0).note(elsewhere_after.1),
        Fact::new("improvement", gained(&tuning.before, &tuning.after)).note("of the held-out RMSE"),
    ];
    if plan.plant_spread > 0.0 {
        let note = "mass, inertia and motor lag; held-out flights have plants of their own";
        facts.push(Fact::new("plants", format!("± {} %", short(100.0 * plan.plant_spread, 3))).note(note));
    }
    if let Some([first, last]) = &tuning.held_out {
        facts.push(
            Fact::new("held-out cells", format!("{} → {}", length(first.rmse), length(last.rmse))).note(format!(
                "{} better in the mean; {}",
                gained(first, last),
                judged(last).1
            )),
        );
    }
    let [first, last] = &tuning.margins;
    let arrow = |of: &dyn Fn(&LoopMargins) -> f64, unit: &str| {
        format!("{} → {}{unit}", short(of(first), 3), short(of(last), 3))
    };
    facts.push(Fact::new("disk margin at hover", arrow(&|m| m.disk.alpha, "")).note(format!(
        "of all commands; phase {}, delay {}",
        arrow(&|m| m.phase.to_degrees(), "°"),
        arrow(&|m| 1e3 * m.delay, " ms")
    )));
    if let Some([first, last]) = &tuning.judged {
        let place = |at: usize| {
            let c = last.corners[at].0;
            format!("{} m/s, mass × {}, inertia × {}, lag × {}", c.speed, c.mass, c.inertia, c.lag)
        };
        facts.push(
            Fact::new("least disk margin", format!("{} → {}", short(first.least(), 3), short(last.least(), 3)))
                .note(format!("over {} corners, at {}", last.corners.len(), place(last.worst))),
        );
        if let Some((at, flaw)) = last.flaws.first() {
            let (n, of) = (last.flaws.len(), last.corners.len());
            facts.push(
                Fact::new("without a margin", format!("{n} of {of} corners")).note(format!("{}: {flaw}", place(*at))),
            );
        }
        let passes = |j: &MarginReport| if j.passes { "passed" } else { "failed" };
        let (disk, latency) = plan.margins.as_ref().map_or((0.0, 0.0), |gate| (gate.disk, 1e3 * gate.latency));
        facts.push(
            Fact::new("gate", format!("{} → {}", passes(first), passes(last)))
                .note(format!("a disk margin of {disk} is asked for in every corner")),
        );
        let borne = if last.delay.is_finite() { format!("{} ms", short(1e3 * last.delay, 3)) } else { "none".into() };
        let late = if last.bears_latency { "bears" } else { "does not bear" };
        facts.push(
            Fact::new("latency that ends stability", borne)
                .note(format!("at hover, which {late} {latency} ms; the gate does not ask for it")),
        );
    }
    facts
}

fn write_gains(path: &Path, plan: &TunePlan, vehicle: &Vehicle, from: &str, tuning: &Tuning) -> Result<()> {
    let mut text = format!("# Tuned for {:?} by 'omnidrones tune', from gains {from:?}.\n", vehicle.name);
    let _ = writeln!(
        text,
        "# Held-out RMSE {} before, {} after ({} flights of {}, {} s each).",
        length(tuning.before.rmse),
        length(tuning.after.rmse),
        tuning.after.n,
        names(plan),
        plan.duration
    );
    text += &toml::to_string(&tuning.gains).map_err(|e| Error::Format {
        file: path.display().to_string(),
        place: "the gains".into(),
        rule: e.to_string(),
        remedy: "Report this as a bug.".into(),
    })?;
    files::replace(path, text.as_bytes())
}

/// The descent, the relative change of each gain, and one flight with either set of gains.
/// Flights of the nominal vehicle beside each other.
fn replay(vehicle: &Vehicle, plan: &TunePlan, flights: [(&str, &Flight); 2]) -> Result<String> {
    let nominal = nominal(plan);
    let plant = Plant::of_vehicle(vehicle, nominal.physics)?;
    let recordings = flights.map(|(when, flight)| {
        let mut recording = omnidrones_viewer::flight(&plant, flight, &nominal);
        recording.title = format!("{} {when} tuning", vehicle.name);
        recording
    });
    Ok(omnidrones_viewer::page(&format!("{}: gains before and after", vehicle.name), &recordings))
}

fn figure(name: &str, tuning: &Tuning, gains: &Gains, before: &Flight, after: &Flight) -> Figure {
    let history = |of: fn(&Iteration) -> f64, scale: f64| {
        tuning.history.iter().map(|i| (i.iteration as f64, scale * of(i))).collect::<Vec<_>>()
    };
    let marked = |series: Series| if tuning.history.len() <= 40 { series.markers() } else { series };
    let descent = Panel::new("RMSE of the training flights", "descent step", "RMSE [cm]")
        .series(marked(Series::line("", history(|i| i.rmse, 100.0)).colour(Colour::BLUE)));
    let gradient = Panel::new("Gradient of the training RMSE", "descent step", "norm over ln K [cm]")
        .series(marked(Series::line("", history(|i| i.gradient_norm, 100.0)).colour(Colour::VERMILLION)))
        .from_zero();
    let error = |flight: &Flight| -> Vec<(f64, f64)> {
        flight.log.time.iter().copied().zip(flight.log.error_norm().into_iter().map(|e| 100.0 * e)).collect()
    };
    let flights = Panel::new("Flight from the start of the reference", "time [s]", "error [cm]")
        .series(Series::line("before", error(before)).colour(Colour::GREY))
        .series(Series::line("tuned", error(after)).colour(Colour::GREEN))
        .from_zero();
    let change = [
        ("K_p", gains.position, tuning.gains.position),
        ("K_v", gains.velocity, tuning.gains.velocity),
        ("K_R", gains.attitude, tuning.gains.attitude),
        ("K_ω", gains.rate, tuning.gains.rate),
    ];
    let mut bars = Bars::new("Tuned gains", "tuned / before").baseline("unchanged", 1.0);
    for (group, (level, old, new)) in change.into_iter().enumerate() {
        for (axis, letter) in ["x", "y", "z"].iter().enumerate() {
            let bar = Bar::new(format!("{level} {letter}"), new[axis] / old[axis]);
            bars = bars.bar(bar.note("×").colour(Colour::nth(group)));
        }
    }
    for (k, what) in ["L force", "L moment"].iter().enumerate().filter(|(k, _)| gains.integral[*k] > 0.0) {
        let bar = Bar::new(*what, tuning.gains.integral[k] / gains.integral[k]);
        bars = bars.bar(bar.note("×").colour(Colour::nth(4)));
    }
    let (b, a) = (&tuning.before, &tuning.after);
    Figure::new(format!("{name}: gains tuned by gradients through closed-loop flights"))
        .subtitle(format!(
            "RMSE on {} held-out starts: {} before, {} tuned ({} lower)   ·   worst {} before, {} tuned   ·   lost {} before, {} tuned",
            a.n,
            length(b.rmse),
            length(a.rmse),
            gained(b, a),
            length(b.worst),
            length(a.worst),
            b.crashed,
            a.crashed
        ))
        .size(1000.0, 550.0)
        .grid(&[1.0, 1.0], &[1.0, 1.0])
        .place((0, 0), (1, 1), descent)
        .place((1, 0), (1, 1), flights)
        .place((0, 1), (1, 1), gradient)
        .place((1, 1), (1, 1), bars)
}
