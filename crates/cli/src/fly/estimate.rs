//! What a filter made of a flight's sensors: table, figure, CSV and JSON.

use crate::arguments;
use crate::prelude::*;
use omnidrones::controllers::FlightEstimates;
use omnidrones::controllers::estimation::{ESTIMATORS, EstimatorSettings, InnovationRecord};
use omnidrones::dynamics::sensors::SensorConfig;
use omnidrones::flight::FlightLog;
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::fmt::Write;

/// Rows of the figure: a band of more points is not seen.
const DRAWN: usize = 2000;

/// When an estimate has settled, s, and by how much more than what is then is shown of it.
const SETTLED: f64 = 1.0;
const SHOWN: f64 = 1.5;

/// The settings of --estimator: a kind, or a file.
pub fn settings(named: &str, sensors: &[SensorConfig]) -> Result<EstimatorSettings> {
    if sensors.is_empty() {
        let remedy = "Add --sensors imu:bmi088,motion_capture:optical, or others.";
        return Err(Error::value(
            "--estimator",
            named,
            "given with --sensors: it estimates from what they read",
            remedy,
        ));
    }
    let settings = match EstimatorSettings::by_name(named) {
        Err(_) if arguments::is_path(named) => EstimatorSettings::of(files::read_toml(Path::new(named))?, named)?,
        Err(Error::Unknown { kind, name, mut known }) => {
            known.push("FILE.toml".into());
            return Err(Error::Unknown { kind, name, known });
        }
        settings => settings?,
    };
    settings.validate()?;
    Ok(settings)
}

/// What an estimator of these sensors cannot know, and which it does not listen to.
pub fn warnings(sensors: &[SensorConfig], kind: &str) -> Vec<String> {
    let is = |kinds: &[&str]| {
        sensors.iter().filter(|own| kinds.contains(&own.model.kind())).map(|own| own.name.clone()).collect::<Vec<_>>()
    };
    let mut all = Vec::new();
    if is(&["gnss", "motion_capture"]).is_empty() {
        all.push("no sensor tells the place (gnss, motion_capture): the estimate of it wanders".into());
    }
    let deaf: &[&str] =
        if kind == "ekf" { &["lidar", "camera", "contact"] } else { &["lidar", "camera", "contact", "flow"] };
    let unheard = is(deaf);
    if !unheard.is_empty() {
        all.push(format!("{} tells an estimator of kind '{kind}' nothing", unheard.join(", ")));
    }
    all
}

/// What is told of an estimate.
pub fn facts(found: &FlightEstimates) -> Vec<Fact> {
    let [position, velocity, attitude] = found.tally.rms();
    let about = ESTIMATORS.iter().find(|entry| entry.name == found.kind).map_or("", |entry| entry.about);
    let mut facts = vec![
        Fact::new("estimator", found.kind).note(format!("{about}; the controller flew on its estimate")),
        Fact::new("estimate", format!("{} off, rms", length(Some(position)))).note(format!(
            "velocity {} m/s, attitude {}°",
            short(velocity, 3),
            short(attitude.to_degrees(), 3)
        )),
    ];
    if found.has_covariance() {
        facts.push(Fact::new("consistency", format!("NEES {}", short(found.tally.mean(), 3))).note(format!(
            "9 where errors are as large as the filter says; {} % of the steps within the 95 % bounds of χ²",
            number(Some(100.0 * found.tally.share_within()), 1)
        )));
    }
    if found.begun_anew > 0 {
        facts.push(
            Fact::new("filter", format!("began anew {} times", found.begun_anew))
                .note("readings made no sense for long: it knew nothing any more"),
        );
    }
    if found.saturated > 0 {
        facts.push(
            Fact::new("inertial unit", counted(found.saturated as usize, "sample"))
                .note("at a limit or no number: the filter trusted them less"),
        );
    }
    facts
}

/// How readings agreed with what was expected of them.
pub fn table(found: &FlightEstimates) -> Table {
    Table::new("sensor | >readings | >lost | >left out | >believed again | >mean ν²/S").filled(
        found.records.iter().map(|own| {
            let InnovationRecord { name, n, lost, left_out, believed_again, .. } = own;
            let mean = own.mean();
            let mean = if mean.is_finite() { short(mean, 3) } else { "–".into() };
            [name.clone(), n.to_string(), lost.to_string(), left_out.to_string(), believed_again.to_string(), mean]
        }),
    )
}

pub fn json(found: &FlightEstimates) -> Value {
    let tally = &found.tally;
    let [position, velocity, attitude] = tally.rms();
    let record = |own: &InnovationRecord| {
        json!({
            "sensor": own.name, "readings": own.n, "lost": own.lost, "left_out": own.left_out, "believed_again": own.believed_again,
            "mean_squared_innovation": own.mean(),
        })
    };
    let within = found.has_covariance().then(|| tally.share_within());
    json!({
        "kind": found.kind, "position": position, "velocity": velocity, "attitude": attitude, "nees": tally.mean(), "within": within,
        "saturated": found.saturated, "begun_anew": found.begun_anew, "innovations": found.records.iter().map(record).collect::<Vec<_>>(),
    })
}

/// Place, velocity and attitude as estimated, with standard deviations where there are such, one line per step.
pub fn csv(found: &FlightEstimates, log: &FlightLog) -> String {
    let mut text = String::from("time [s]");
    for (name, unit, axes) in [
        ("position", "m", &["x", "y", "z"][..]),
        ("velocity", "m/s", &["x", "y", "z"]),
        ("attitude", "-", &["w", "x", "y", "z"]),
        ("position_deviation", "m", &["x", "y", "z"]),
        ("velocity_deviation", "m/s", &["x", "y", "z"]),
        ("attitude_deviation", "rad", &["x", "y", "z"]),
    ]
    .into_iter()
    .take(if found.has_covariance() { 6 } else { 3 })
    {
        axes.iter().for_each(|axis| {
            let _ = write!(text, ",{name}_{axis} [{unit}]");
        });
    }
    text.push('\n');
    for (time, row) in log.time.iter().zip(found.rows.chunks_exact(found.width())) {
        let _ = write!(text, "{time}");
        row.iter().for_each(|x| {
            let _ = write!(text, ",{x}");
        });
        text.push('\n');
    }
    text
}

/// Errors of place, velocity and attitude over time, within three standard deviations where there are such.
pub fn figure(found: &FlightEstimates, log: &FlightLog) -> Figure {
    let rows: Vec<&[f64]> = found.rows.chunks_exact(found.width()).collect();
    let every = rows.len().div_ceil(DRAWN).max(1);
    let taken: Vec<usize> = (0..rows.len().min(log.len())).step_by(every).collect();
    let mut panels = Vec::new();
    for (title, of, scale) in [("place [mm]", 0, 1e3), ("velocity [cm/s]", 3, 1e2), ("attitude [mrad]", 6, 1e3)] {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let error = |k: usize| match of {
                0 => rows[k][axis] - log.position[k][axis],
                3 => rows[k][3 + axis] - log.velocity[k][axis],
                _ => turned(&rows[k][6..10], &log.attitude[k])[axis],
            };
            let deviation = |k: usize| if found.has_covariance() { 3.0 * scale * rows[k][10 + of + axis] } else { 0.0 };
            // how it is once it has settled: what a flight begins with is off the picture
            let settled = taken.iter().filter(|k| log.time[**k] >= SETTLED.min(0.5 * log.time[log.len() - 1]));
            let mut sizes: Vec<f64> = settled.map(|k| deviation(*k).max((scale * error(*k)).abs())).collect();
            sizes.sort_by(f64::total_cmp);
            // a moment that is lost does not hide the others
            let most = sizes.get(sizes.len() * 49 / 50).map_or(1e-9, |most| most.clamp(1e-9, 1e9));
            let shown = |x: f64| x.clamp(-SHOWN * most, SHOWN * most);
            let curve = taken.iter().map(|k| (log.time[*k], shown(scale * error(*k)))).collect();
            let mut panel = Panel::new(format!("{letter}: error of {title}"), "time [s]", "");
            if found.has_covariance() {
                let band = |k: usize| (log.time[k], shown(-deviation(k)), shown(deviation(k)));
                let name = if axis == 0 { "±3σ" } else { "" };
                panel = panel.ribbon(name, taken.iter().map(|k| band(*k)).collect(), Colour::GREY);
            }
            panel = panel.y_range(-SHOWN * most, SHOWN * most);
            panels.push(panel.series(Series::line(if axis == 0 { "error" } else { "" }, curve).colour(Colour::BLUE)));
        }
    }
    let figure = Figure::new(format!("{}: the estimate", log.vehicle)).size(1100.0, 760.0).grid(&[1.0; 3], &[1.0; 3]);
    panels.into_iter().enumerate().fold(figure, |figure, (k, panel)| figure.place((k % 3, k / 3), (1, 1), panel))
}

/// The turn from the truth to an estimate, rad, about body axes.
fn turned(estimate: &[f64], truth: &[f64; 4]) -> [f64; 3] {
    let [w, x, y, z] = *truth;
    let e: [f64; 4] = std::array::from_fn(|k| estimate[k]);
    // q_t* ⊗ q_e
    let off = [
        w * e[0] + x * e[1] + y * e[2] + z * e[3],
        w * e[1] - x * e[0] - y * e[3] + z * e[2],
        w * e[2] + x * e[3] - y * e[0] - z * e[1],
        w * e[3] - x * e[2] + y * e[1] - z * e[0],
    ];
    let side = if off[0] < 0.0 { -2.0 } else { 2.0 };
    [off[1] * side, off[2] * side, off[3] * side]
}
