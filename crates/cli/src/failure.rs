//! Rotors that fail: how they are named, what they leave, as facts, tables and JSON.

use crate::prelude::*;
use clap::Args;
use omnidrones::controllers::allocation::WrenchMargin;
use omnidrones::controllers::allocation::failure::{LEAST_MARGIN, health};
use omnidrones::controllers::{Assessment, Capability, FailureTable, Flight, FlightPlan, RotorFailure};
use omnidrones::dynamics::{GRAVITY, Vehicle};

/// Which rotors fail, when, and who knows.
#[derive(Debug, Clone, Args)]
pub struct FailureArguments {
    /// A rotor that fails in flight: its number or name as in 'omnidrones models'; may be repeated
    ///
    /// ROTOR:SHARE weakens it to that share of its largest thrust: 1:0.6 leaves rotor 1 60 %. Its motor runs down with
    /// its own lag. The controller is told which rotor failed and how much is left, allocates within what is left, and
    /// gives up yaw where that alone can no longer be held. Of the configurations, tilting thrusters allocate anew too; other
    /// controllers fly on as before.
    #[arg(long, value_name = "ROTOR[:SHARE]", help_heading = "Failure")]
    pub fail: Vec<String>,
    /// When it fails [s]: once for all, or once for each --fail in order [default: 3]
    #[arg(long, value_name = "SECONDS", requires = "fail", help_heading = "Failure")]
    pub at: Vec<f64>,
    /// How long after a failure the controller knows of it [s]
    #[arg(long, value_name = "SECONDS", default_value_t = 0.05, help_heading = "Failure")]
    pub detection: f64,
}

impl FailureArguments {
    /// The failures of rotors of these names, checked.
    pub fn of(&self, rotors: &[String]) -> Result<Vec<RotorFailure>> {
        let times = match (self.at.len(), self.fail.len()) {
            (0, n) => vec![3.0; n],
            (1, n) => vec![self.at[0]; n],
            (times, n) if times == n => self.at.clone(),
            (times, n) => {
                let limit = format!("one, or {n} as of --fail");
                return Err(Error::value(
                    "--at: number of times",
                    times,
                    limit,
                    "Give --fail 1 --at 3 --fail 4 --at 5.",
                ));
            }
        };
        let one = |(text, at): (&String, f64)| {
            let (rotor, effectiveness) = named(text, rotors)?;
            let failure = RotorFailure { rotor, at, effectiveness };
            failure.validate(rotors.len())?;
            Ok(failure)
        };
        self.fail.iter().zip(times).map(one).collect()
    }
}

/// `1`, `rotor_1`, either with `:0.6`.
pub fn named(text: &str, rotors: &[String]) -> Result<(usize, f64)> {
    let index = |name: &str| {
        let by_name = rotors.iter().position(|r| r == name);
        by_name.or_else(|| name.parse().ok().filter(|i| *i < rotors.len()))
    };
    if let Some(rotor) = index(text) {
        return Ok((rotor, 0.0));
    }
    let (name, share) = match text.rsplit_once(':') {
        Some((name, share)) => (name, share),
        None => (text, "0"),
    };
    let Some(rotor) = index(name) else {
        let numbers = (0..rotors.len()).map(|i| i.to_string());
        let known = numbers.chain(rotors.iter().cloned()).collect();
        return Err(Error::Unknown { kind: "rotor", name: name.into(), known });
    };
    match share.parse() {
        Ok(share) => Ok((rotor, share)),
        Err(_) => Err(Error::value(
            "--fail: share of the thrust that is left",
            format!("'{share}'"),
            "a number in [0, 1)",
            "Give --fail 1:0.6 for 60 %.",
        )),
    }
}

/// What is left after each failure of a flight, in order of time.
pub struct Story {
    stages: Vec<(f64, Assessment)>,
    /// Largest |ω_z| from the first failure on, rad/s.
    yaw_rate: f64,
    /// Largest height error from the first failure on, m.
    height: f64,
    /// Largest horizontal error from the first failure on, m.
    sideways: f64,
    /// Largest tilt from the first failure on, rad.
    tilt: f64,
}

impl Story {
    /// `None` for a flight without failures.
    pub fn of(vehicle: &Vehicle, plan: &FlightPlan, flight: &Flight) -> Result<Option<Self>> {
        let mut times: Vec<f64> = plan.failures.iter().map(|f| f.at).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let Some(first) = times.first().copied() else { return Ok(None) };
        let n = vehicle.n_rotor();
        let stage = |at: f64| Ok((at, Assessment::of(vehicle, &health(n, &plan.failures, at))?));
        let log = &flight.log;
        let from = log.time.iter().position(|t| *t >= first).unwrap_or(log.len());
        let largest = |values: &mut dyn Iterator<Item = f64>| values.skip(from).fold(0.0, f64::max);
        let errors = log.tracking_error();
        Ok(Some(Self {
            stages: times.into_iter().map(stage).collect::<Result<_>>()?,
            yaw_rate: largest(&mut log.angular_velocity.iter().map(|w| w[2].abs())),
            height: largest(&mut errors.iter().map(|e| e[2].abs())),
            sideways: largest(&mut errors.iter().map(|e| e[0].hypot(e[1]))),
            tilt: largest(&mut log.tilt().into_iter()),
        }))
    }

    /// What the rotors that are left can hold, in words.
    pub fn left(&self) -> String {
        let left = self.stages.last().map_or("", |(_, a)| a.capability.name());
        format!("the rotors that are left: {left}")
    }

    /// The section of a page.
    pub fn page(&self, page: &mut Page, vehicle: &Vehicle, plan: &FlightPlan) {
        let weight = vehicle.mass_properties().mass * GRAVITY;
        let mut facts = Vec::new();
        for (at, left) in &self.stages {
            for failure in plan.failures.iter().filter(|f| f.at == *at) {
                let what = match failure.effectiveness {
                    0.0 => "lost".to_string(),
                    e => format!("{} % left", short(100.0 * e, 3)),
                };
                let name = &vehicle.rotors[failure.rotor].name;
                let delay = duration(plan.detection_delay);
                let known = format!("the controller knew {delay} later; curve {} of the plots", failure.rotor);
                facts.push(Fact::new(name, format!("{what} at {} s", short(*at, 4))).note(known));
            }
            facts.push(Fact::new("what is left", left.capability.name()).note(explanation(left)));
            facts.push(
                Fact::new("most lift", format!("{} × weight", number(left.lift / weight, 2)))
                    .note("without roll and pitch moment"),
            );
        }
        facts.push(Fact::new("from then on", format!("{} in height", length(self.height))).note(format!(
            "largest errors; {} sideways; tilt up to {}°",
            length(self.sideways),
            number(self.tilt.to_degrees(), 1)
        )));
        let turns = number(self.yaw_rate / std::f64::consts::TAU, 2);
        facts.push(
            Fact::new("yaw rate", format!("{} rad/s", short(self.yaw_rate, 3)))
                .note(format!("at most; {turns} turns per second")),
        );
        page.heading("Failure").facts(facts);
    }

    /// For JSON.
    pub fn json(&self, vehicle: &Vehicle) -> Value {
        let stages: Vec<Value> = self
            .stages
            .iter()
            .map(|(at, left)| {
                let mut value = assessment_json(vehicle, left);
                value["at"] = json!(at);
                value
            })
            .collect();
        json!({
            "stages": stages,
            "largest_yaw_rate": self.yaw_rate,
            "largest_height_error": self.height,
            "largest_horizontal_error": self.sideways,
            "largest_tilt": self.tilt,
        })
    }

    /// Times and names for plots.
    pub fn events(&self) -> Vec<(f64, String)> {
        self.stages.iter().enumerate().map(|(i, (at, _))| (*at, if i == 0 { "failure" } else { "" }.into())).collect()
    }
}

/// One sentence about margins.
fn explanation(left: &Assessment) -> String {
    let newtons_of = |v: f64| format!("{} N", signed(v));
    let newtons = |reach: &WrenchMargin| newtons_of(reach.margin.distance);
    let (four, three) = (&left.steered, &left.without_yaw);
    match left.capability {
        Capability::Full => format!("hover is {} inside the limits; nearest is {}", newtons(four), four.weakest()),
        Capability::YawSacrificed if four.margin.distance < 0.0 && newtons(four) != newtons_of(0.0) => format!(
            "hover is {} inside the limits of thrust, roll and pitch, but leaves a yaw moment: it spins up",
            newtons(three)
        ),
        Capability::YawSacrificed => format!(
            "hover is {} inside the limits of thrust, roll and pitch; with yaw {} ({})",
            newtons(three),
            newtons(four),
            four.weakest()
        ),
        Capability::Spinning => left.spin.as_ref().map_or_else(String::new, |spin| {
            format!(
                "the rotors that are left could carry it while it spins, at {} rad/s (reckoned without drag) about an axis {}° \
                 from its thrust",
                number((spin.rate / spin.axis[2]).abs(), 1),
                number(spin.axis[2].acos().to_degrees(), 0)
            )
        }),
        Capability::None if three.margin.distance > 0.0 => {
            format!("hover is {} inside the limits of thrust, roll and pitch, too little to steer", newtons(three))
        }
        Capability::None => format!(
            "hover is {} outside the limits of thrust, roll and pitch ({}), and no turn that carries it was found",
            newtons_of(-three.margin.distance),
            three.weakest()
        ),
    }
}

/// Newtons to a hundredth, without a negative zero.
fn signed(v: f64) -> String {
    let tidy = if v.abs() < 5e-3 { 0.0 } else { v };
    number(tidy, 2)
}

/// Every single loss as a table, every double one counted.
pub fn sheet(page: &mut Page, vehicle: &Vehicle) -> Result<()> {
    let table = FailureTable::of(vehicle)?;
    let weight = vehicle.mass_properties().mass * GRAVITY;
    let mut rows =
        Table::new("lost | what is left | >margin [N] | >without yaw [N] | >most lift / weight | nearest limit");
    let mut row = |name: String, a: &Assessment| {
        let deciding = if a.spin.is_some() || a.capability == Capability::None { &a.without_yaw } else { &a.steered };
        rows.row([
            name,
            a.capability.name().to_string(),
            signed(a.steered.margin.distance),
            signed(a.without_yaw.margin.distance),
            number(a.lift / weight, 2),
            deciding.weakest(),
        ]);
    };
    row("nothing".into(), &table.whole);
    for (rotor, a) in vehicle.rotors.iter().zip(&table.single) {
        row(rotor.name.clone(), a);
    }
    page.heading("When a rotor is lost").table(rows);
    for capability in Capability::ALL {
        let pairs: Vec<String> = (table.double.iter().filter(|a| a.capability == capability))
            .map(|a| a.broken().iter().map(usize::to_string).collect::<Vec<_>>().join("+"))
            .collect();
        if !pairs.is_empty() {
            let (n, all) = (pairs.len(), table.double.len());
            let which = if n == all { String::new() } else { format!(" ({})", pairs.join(", ")) };
            page.line(format!("  {n} of {all} pairs lost together: {}{which}", capability.name()));
        }
    }
    page.prose(format!(
        "  margin: distance of hover to the edge of what the rotors can make in thrust, roll, pitch and yaw, moments \
         divided by {} m; less than {} % of the weight counts as none. 'omnidrones fly {} --fail 0' shows what becomes of it.",
        short(table.whole.steered.length, 3),
        short(100.0 * LEAST_MARGIN, 2),
        shown(&vehicle.name)
    ));
    Ok(())
}

/// One line per loss for JSON.
pub fn json(vehicle: &Vehicle) -> Result<Value> {
    let table = FailureTable::of(vehicle)?;
    let rows = |list: &[Assessment]| list.iter().map(|a| assessment_json(vehicle, a)).collect::<Vec<_>>();
    Ok(json!({
        "whole": assessment_json(vehicle, &table.whole),
        "single": rows(&table.single),
        "double": rows(&table.double),
    }))
}

fn assessment_json(vehicle: &Vehicle, a: &Assessment) -> Value {
    json!({
        "effectiveness": a.health,
        "broken": a.broken(),
        "capability": a.capability,
        "margin": a.steered.margin.distance,
        "margin_without_yaw": a.without_yaw.margin.distance,
        "lift_over_weight": a.lift / (vehicle.mass_properties().mass * GRAVITY),
        "rank": a.steered.rank,
    })
}
