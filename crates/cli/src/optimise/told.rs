//! What is told of a planned trajectory: its page and JSON.

use super::planned::Planned;
use crate::prelude::*;
use omnidrones::controllers::optimal::{FirstGuess, IlqrStatus, PlannedInput};

impl Planned<'_> {
    /// Figures of the trajectory and of the search.
    pub fn facts(&self) -> Vec<Fact> {
        let (f, model) = (&self.figures, self.problem.problem.model());
        let file = &self.source.file;
        let inputs = match file.inputs {
            PlannedInput::Speed => "rotor speeds, with the lag of their motors",
            PlannedInput::Thrust => "thrusts, as if motors had no lag",
        };
        let begun = match file.guess {
            FirstGuess::Hover => "begun from hover",
            FirstGuess::Line => "begun on lines over what is on the way",
        };
        let rounds = match f.rounds {
            0 | 1 => String::new(),
            n => format!("; {n} rounds of multipliers for gates and obstacles"),
        };
        let each = duration(f.wall_time / f.iterations.max(1) as f64);
        let degrees = |angle: f64| format!("{}°", short(angle.to_degrees(), 3));
        let status = match self.report.status {
            IlqrStatus::Solved => "solved",
            IlqrStatus::OutOfIterations => "out of iterations",
            IlqrStatus::NoStep => "no step lowers the cost",
            IlqrStatus::Violated => "a condition stays violated",
        };
        let mut facts = vec![
            Fact::new("status", status).note(begun),
            Fact::new("cost", short(f.cost, 6)).note(match f.gap {
                gap if gap > self.problem.settings.tolerance * (1.0 + self.trajectory.states.len() as f64) => {
                    format!("stages lack {} to the dynamics", short(gap, 2))
                }
                _ => "every stage obeys the dynamics".into(),
            }),
            Fact::new("iterations", f.iterations.to_string())
                .note(format!("{} in all, {each} each{rounds}", duration(f.wall_time))),
            Fact::new("newton steps", f.newton_steps.to_string())
                .note("of the programs with bounds, over all iterations"),
            Fact::new("horizon", format!("{} s", short(f.duration, 4))).note(format!(
                "{} of {}, {} states, {} inputs: {inputs}",
                counted(file.steps, "step"),
                duration(file.dt),
                model.n_state(),
                model.n_input()
            )),
        ];
        let stands = [(self.problem.gates.len(), "gate"), (self.problem.obstacles.len(), "obstacle")];
        let stands: Vec<String> =
            stands.into_iter().filter(|(n, _)| *n > 0).map(|(n, what)| counted(n, what)).collect();
        if !stands.is_empty() {
            let note =
                format!("{}; of gates in m, of obstacles as a share of their radius squared", stands.join(" and "));
            facts.push(Fact::new("largest violation", short(f.violation.max(0.0), 2)).note(note));
        }
        if let Some(beyond) = f.beyond_soft_bounds {
            facts.push(
                Fact::new("beyond soft bounds", short(beyond, 2)).note("at most, in the unit of what is bounded"),
            );
        }
        let number = |v: Option<f64>, digits| v.map_or("–".into(), |v| short(v, digits));
        facts.extend([
            Fact::new("inputs at a bound", percent(f.at_bounds)).note("of all inputs of all steps"),
            Fact::new("at the end", format!("{} from the goal", length(f.end.distance))).note(format!(
                "at {} m/s, turned {} from its attitude",
                short(f.end.speed, 2),
                degrees(f.end.turned)
            )),
            Fact::new("length of the path", length(f.length)),
            Fact::new("top speed", format!("{} m/s", number(f.max_speed, 3))),
            Fact::new("largest tilt", f.max_tilt.map_or("–".into(), degrees)),
        ]);
        facts
    }

    /// The page; `unflown` says why there is no reference.
    pub fn page(&self, verdict: &std::result::Result<(), String>, unflown: Option<&str>, written: &[PathBuf]) -> Page {
        let mut page = Page::new();
        page.title(&self.source.name, &format!("{}; {} flies", self.source.origin, self.log.vehicle));
        page.heading("Trajectory of least cost").facts(self.facts());
        page.written(written);
        if let Some(why) = unflown {
            page.line(format!("\nWARNING: {why}"));
        }
        match verdict {
            Ok(()) => {
                let reference = written.iter().find(|path| path.ends_with("reference.toml"));
                if let (Some(path), Some(vehicle)) = (reference, self.flown_as()) {
                    let path = files::word(path);
                    page.line(format!("\nFly it: omnidrones fly {vehicle} --reference {path} --controller mpc"));
                }
            }
            Err(why) => {
                page.line(format!("\nFAILED: {why}. What is written is where the search ended."));
            }
        }
        page
    }

    /// What 'fly' calls the vehicle or configuration, where it is one for it.
    fn flown_as(&self) -> Option<String> {
        let file = &self.source.file;
        let named = file.vehicle.as_ref().or(file.configuration.as_ref())?;
        let path = self.source.folder.as_ref().map(|folder| folder.join(named));
        Some(match path.filter(|_| named.ends_with(".toml")) {
            Some(path) => files::word(&path),
            None => files::word(Path::new(named)),
        })
    }

    /// The same for programs.
    pub fn json(&self, verdict: &std::result::Result<(), String>, unflown: Option<&str>, written: &[PathBuf]) -> Value {
        let step = |step: &omnidrones::controllers::optimal::IlqrIteration| {
            json!({
                "cost": step.cost, "gap": step.gap, "expected": step.expected, "step": step.step,
                "regularisation": step.regularisation, "newton_steps": step.newton_steps, "round": step.round,
            })
        };
        let status = match self.report.status {
            IlqrStatus::Solved => "solved",
            IlqrStatus::OutOfIterations => "out_of_iterations",
            IlqrStatus::NoStep => "no_step",
            IlqrStatus::Violated => "violated",
        };
        json!({
            "command": "optimise",
            "version": env!("CARGO_PKG_VERSION"),
            "success": verdict.is_ok(),
            "failure": verdict.as_ref().err(),
            "problem": self.source.name,
            "source": self.source.origin,
            "flies": self.log.vehicle,
            "status": status,
            "figures": self.figures,
            "history": self.report.iterations.iter().map(step).collect::<Vec<_>>(),
            "definition": self.source.file,
            "warnings": unflown.into_iter().collect::<Vec<_>>(),
            "files": files::names(written),
        })
    }
}
