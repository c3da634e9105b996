//! What stands around what flies: read from `--scene`, told on the flight's page.

use super::Arguments;
use crate::arguments::is_path;
use crate::prelude::*;
use omnidrones::controllers::Flight;
use omnidrones::controllers::flight_check::nearest_still;
use omnidrones::dynamics::assembly::Member;
use omnidrones::dynamics::configurations::environment;
use omnidrones::dynamics::scene::{Generator, Scene};
use omnidrones::dynamics::tree::{Model, Multibody};

/// A scene and what it is called.
pub(super) struct Around {
    named: String,
    pub scene: Scene,
}

/// How near something came to what stands around it.
pub(super) struct Approach {
    named: String,
    /// Of an obstacle or a gate.
    part: String,
    /// m; negative in touch.
    distance: f64,
    /// s.
    time: f64,
    n_obstacle: usize,
    n_gate: usize,
}

impl Around {
    /// The scene of the arguments.
    pub fn of(a: &Arguments) -> Result<Option<Self>> {
        let Some(named) = a.scene.as_deref() else { return Ok(None) };
        let scene = match Generator::parse(named) {
            Err(_) if is_path(named) => Scene::from_toml_file(named)?,
            known => known?.scene()?,
        };
        if let Some(gate) = scene.gates.iter().find(|gate| gate.slide.is_some()) {
            let (what, rule) = (format!("--scene: gate '{}'", gate.name), "fixed where one flies alone");
            return Err(Error::value(what, "slides", rule, "Leave out its slide."));
        }
        Ok(Some(Self { named: named.into(), scene }))
    }

    /// A model in this scene, names and state as they were.
    pub fn with(&self, model: Model) -> Result<Model> {
        let name = model.name().to_string();
        environment(name, &[Member::new("", model, [0.0; 3])], &self.scene)
    }

    /// How near anything (shapes, and rotors as discs) came to an obstacle or gate; `None` where there is none.
    pub fn approach(&self, system: &Multibody, flight: &Flight) -> Option<Approach> {
        let shapes = system.model().shapes();
        let rows = flight.states.chunks_exact(system.rest_state().len()).zip(&flight.log.time);
        let mut nearest: Option<(usize, f64, f64)> = None;
        for (row, time) in rows {
            let least = nearest.map_or(f64::INFINITY, |(_, least, _)| least);
            nearest = nearest_still(system, row, least).map(|(still, near)| (still, near, *time)).or(nearest);
        }
        nearest.map(|(still, distance, time)| Approach {
            named: self.named.clone(),
            part: shapes[still].part.clone(),
            distance,
            time,
            n_obstacle: self.scene.obstacles.len(),
            n_gate: self.scene.gates.len(),
        })
    }
}

impl Approach {
    /// Into what it flew, and how deep.
    pub fn touch(&self) -> Option<String> {
        let deep = length(Some(-self.distance));
        (self.distance < 0.0).then(|| format!("it flew into '{}', {deep} deep at {} s", self.part, short(self.time, 3)))
    }

    pub fn fact(&self) -> Fact {
        let things: Vec<String> = [(self.n_obstacle, "obstacle"), (self.n_gate, "gate")]
            .into_iter()
            .filter(|(n, _)| *n > 0)
            .map(|(n, what)| counted(n, what))
            .collect();
        let (part, at) = (&self.part, short(self.time, 3));
        let near = if self.distance < 0.0 {
            format!("touched '{part}' at {at} s, {} deep", length(Some(-self.distance)))
        } else {
            format!("nearest {} from '{part}', at {at} s", length(Some(self.distance)))
        };
        Fact::new("scene", &self.named).note(format!("{}; {near}", things.join(", ")))
    }

    pub fn json(&self) -> Value {
        json!({
            "name": self.named,
            "obstacles": self.n_obstacle,
            "gates": self.n_gate,
            "nearest": { "part": self.part, "distance": self.distance, "time": self.time },
        })
    }
}
