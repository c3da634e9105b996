//! Drops: anything, rotors idle, onto the ground.

use super::Arguments;
use crate::prelude::*;
use crate::robot::Robot;
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::registry::steerable;
use omnidrones::controllers::start::{clearance, start_above};
use omnidrones::controllers::{Flight, Passive, fly_from};
use omnidrones::dynamics::configurations;
use omnidrones::dynamics::tree::{Multibody, check_contact};
use omnidrones::internals::{contact_forces, energies};
use omnidrones_plot::robot::{Fall, fall};
use std::fmt::Write;

/// Refuses arguments of a controller.
fn uncontrolled(a: &Arguments) -> Result<()> {
    let given = [
        ("--reference", a.flight.reference.is_some()),
        ("--gains", a.flight.gains.is_some()),
        ("--rates", a.flight.rates.is_some()),
        ("--max-rmse", a.max_rmse.is_some()),
    ];
    match given.into_iter().find(|(_, given)| *given) {
        None => Ok(()),
        Some((name, _)) => {
            let value = if a.drop.is_some() { "with --drop" } else { "for a configuration that nobody steers yet" };
            Err(Error::value(name, value, "left out: nothing is controlled", "It falls to the ground: leave it out."))
        }
    }
}

/// Drops it.
pub fn dropped(a: &Arguments, robot: &Robot) -> Result<Report> {
    uncontrolled(a)?;
    a.level()?;
    let height = a.drop.unwrap_or(1.0);
    if !(0.0..=1000.0).contains(&height) {
        return Err(Error::value("--drop", format!("{height} m"), "0 to 1000 m", "--drop alone means 1 m."));
    }
    let plant = super::model_plant(a, robot, true)?;
    let Some(system) = plant.tree() else {
        return Err(Error::value("what falls", plant.name(), "an articulated system", "Name a configuration."));
    };
    let start = start_above(system, height, a.seed)?;
    let mut plan = a.flight.plan(Some(a.duration.unwrap_or(3.0)), a.wind.clone(), a.seed)?;
    (plan.physics, plan.reference) = (*system.physics(), Reference::Hover(Hover::default()));
    let n_step = plan.n_step()?;
    let mut outputs = super::outputs(a, robot.model.name())?;
    let bar = progress::bar(n_step, "falling", a.output.json);
    let flight = fly_from(&plant, &mut Passive::new(&plant), &plan, &start, &mut |k| {
        if k % 64 == 0 {
            bar.set_position(k);
        }
    })?;
    bar.finish_and_clear();
    let fallen = Fallen::of(robot, system, &flight, height);
    outputs.draw("drop", || fall(system, fallen.drawn()).subtitle(fallen.subtitle()))?;
    if a.csv {
        outputs.text("drop.csv", fallen.csv())?;
    }
    if a.replay {
        let mut recording = omnidrones_viewer::fall(&plant, &flight);
        recording.remark = format!("falls {height} m, rotors idle");
        outputs.text(files::REPLAY, omnidrones_viewer::page(&format!("{}: a drop", plant.name()), &[recording]))?;
    }
    let written = outputs.done(super::is_picture)?;
    let success = flight.diverged_at.is_none() && !fallen.gained();
    Ok(Report::told(a.output.json, success, || fallen.json(&written), || fallen.page(&written)))
}

/// A fall and what it was like in every sample.
struct Fallen<'a> {
    robot: &'a Robot,
    system: &'a Multibody,
    flight: &'a Flight,
    height: f64,
    clearance: Vec<f64>,
    energy: Vec<f64>,
    /// Of the ground on everything, in weights.
    load: Vec<f64>,
    speed: f64,
}

impl<'a> Fallen<'a> {
    fn of(robot: &'a Robot, system: &'a Multibody, flight: &'a Flight, height: f64) -> Self {
        let rows: Vec<&[f64]> = flight.states.chunks_exact(system.rest_state().len()).collect();
        let weight = robot.model.mass() * robot.model.parts().gravity;
        let force = |row: &&[f64]| contact_forces(system, row).iter().map(|f| f[2]).sum::<f64>() / weight;
        let energies: Vec<[f64; 2]> = rows.iter().map(|row| energies(system, row)).collect();
        Self {
            robot,
            system,
            flight,
            height,
            clearance: rows.iter().map(|row| clearance(system, row).unwrap_or(f64::NAN)).collect(),
            energy: energies.iter().map(|[kinetic, potential]| kinetic + potential).collect(),
            load: rows.iter().map(force).collect(),
            speed: energies.last().map_or(f64::NAN, |[kinetic, _]| (2.0 * kinetic / robot.model.mass()).sqrt()),
        }
    }

    fn drawn(&self) -> Fall<'_> {
        Fall {
            log: &self.flight.log,
            states: &self.flight.states,
            clearance: &self.clearance,
            energy: &self.energy,
            load: &self.load,
        }
    }

    /// When something first touched the ground, s.
    fn touched(&self) -> Option<f64> {
        self.clearance.iter().position(|c| *c < 0.0).map(|i| self.flight.log.time[i])
    }

    fn deepest(&self) -> f64 {
        self.clearance.iter().fold(0.0_f64, |m, c| m.max(-c))
    }

    fn hardest(&self) -> f64 {
        self.load.iter().fold(0.0, |m: f64, v| m.max(*v))
    }

    fn lost(&self) -> [f64; 2] {
        [self.energy.first(), self.energy.last()].map(|e| e.copied().unwrap_or(f64::NAN))
    }

    /// Whether energy came from nowhere, which a step too long for the ground's stiffness does.
    fn gained(&self) -> bool {
        let [most, least] = [f64::max, f64::min].map(|of| self.energy.iter().copied().fold(self.lost()[0], of));
        // of what was there or was lost, wherever the energy's zero is
        let first = self.lost()[0];
        most > first + 0.01 * first.abs().max(first - least) + 1e-6
    }

    fn subtitle(&self) -> String {
        let when = self.touched().map_or("no touch".into(), |t| format!("touches the ground at {} s", short(t, 3)));
        format!(
            "from {} m, rotors idle   ·   {when}   ·   at most {} weights   ·   sinks in by {} at most",
            short(self.height, 3),
            short(self.hardest(), 3),
            length(self.deepest())
        )
    }

    fn page(&self, written: &[PathBuf]) -> Page {
        let [first, last] = self.lost();
        let mut page = Page::new();
        page.title(self.robot.model.name(), &self.robot.origin);
        let mut facts = vec![
            Fact::new("height", format!("{} m", short(self.height, 4))).note("of the lowest point, rotors idle"),
            Fact::new("first touch", self.touched().map_or("never".into(), |t| format!("{} s", short(t, 4)))).note(
                format!("in free fall {} s", short((2.0 * self.height / self.robot.model.parts().gravity).sqrt(), 4)),
            ),
            Fact::new("hardest push", format!("{} weights", short(self.hardest(), 3))).note("upwards, of the ground"),
            Fact::new("deepest", length(self.deepest())).note("into the ground, which is compliant"),
            Fact::new("energy", format!("{} J", short(last, 4))).note(format!("{} J at the start", short(first, 4))),
            Fact::new("speed at the end", format!("{} m/s", short(self.speed, 2))).note("of all masses, rms"),
        ];
        let ghosts = self.robot.model.shapes().iter().filter(|s| !s.collides).count();
        if ghosts > 0 {
            let all = self.robot.model.shapes().len();
            facts.push(Fact::new("untouchable", format!("{ghosts} of {all}")).note("shapes pass through the ground"));
        }
        if let Err(e) = check_contact(self.system) {
            facts.push(Fact::new("softened", "contact").note(e.to_string()));
        }
        if self.gained() {
            let note = "energy came from nowhere: the step is too long for the ground, try --dt 0.002 or less";
            facts.push(Fact::new("wrong", "energy gained").note(note));
        }
        if let Some(t) = self.flight.diverged_at {
            facts.push(Fact::new("diverged", format!("{} s", short(t, 4))).note("a smaller --dt may help"));
        }
        if !steerable(&self.robot.model) {
            page.line("  nobody steers it yet: it falls, rotors idle");
        }
        page.heading("Drop").facts(facts);
        page.written(written);
        page
    }

    fn csv(&self) -> String {
        let mut text = String::from("time [s],lowest_point [m],energy [J],ground_force [weights]\n");
        let rows = self.flight.log.time.iter().zip(&self.clearance).zip(&self.energy).zip(&self.load);
        for (((time, clearance), energy), load) in rows {
            let _ = writeln!(text, "{time},{clearance},{energy},{load}");
        }
        text
    }

    fn json(&self, written: &[PathBuf]) -> Value {
        let [first, last] = self.lost();
        json!({
            "command": "fly",
            "version": env!("CARGO_PKG_VERSION"),
            "success": self.flight.diverged_at.is_none(),
            "dropped": self.robot.model.name(),
            "configuration": configurations::names().contains(&self.robot.model.name()),
            "height": self.height,
            "first_touch": self.touched(),
            "largest_ground_force": self.hardest(),
            "deepest": self.deepest(),
            "energy_start": first,
            "energy_end": last,
            "speed_end": self.speed,
            "diverged_at": self.flight.diverged_at,
            "files": files::names(written),
        })
    }
}
