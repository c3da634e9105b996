//! A flight as a table of whole numbers, row by row, with what they mean.
//!
//! A row holds, actor by actor: position 3 and attitude 4 (w, x, y, z) of every visible body; the speed of every rotor as a
//! share of its largest; the place of every target 3; where contacts are simulated the force on every body 3; where there is
//! one the error. Numbers are whole multiples of [`STEPS`].

use super::look::Look;
use super::pack::{base64, pack};
use serde::Serialize;
use serde_json::{Value, json};

/// Most frames of one recording.
pub(crate) const MAX_FRAMES: usize = 1500;
/// Time between two frames, about, s.
pub(crate) const BETWEEN: f64 = 0.02;

/// What one unit of each kind of number means.
#[derive(Debug, Clone, Copy, Serialize)]
struct Steps {
    /// m.
    position: f64,
    /// Of a part of a unit quaternion.
    attitude: f64,
    /// Of a share of the largest speed.
    speed: f64,
    /// N.
    force: f64,
    /// In the unit of the error.
    error: f64,
}

const STEPS: Steps = Steps { position: 0.0005, attitude: 1.0 / 8192.0, speed: 0.002, force: 0.01, error: 0.0001 };

/// Who flies: one vehicle or one system of bodies.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Actor {
    /// For the reader.
    pub name: String,
    /// Number of its look.
    pub look: usize,
    /// Where it is drawn beside its own numbers, m, world: systems do not stand in one another.
    pub offset: [f64; 3],
    /// Where each of its look's still shapes stands, m.
    pub still: Vec<[f64; 3]>,
    /// Number of targets.
    pub goals: usize,
    /// Whether contacts are simulated.
    pub contact: bool,
    /// What its error is, if it has one.
    pub error: Option<Measure>,
    /// What forces are drawn against, N.
    pub weight: f64,
    /// Sensors on it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mounts: Vec<Mount>,
    /// Where it ended before the recording does.
    pub ended: Option<Ended>,
}

/// Where a sensor sits on a body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mount {
    /// As in the settings.
    pub name: String,
    /// Number of the visible body.
    pub body: usize,
    /// m, body.
    pub position: [f64; 3],
    /// Mount → body, `[w, x, y, z]`.
    pub rotation: [f64; 4],
    /// What it sees along −z of the mount, if it looks.
    pub view: Option<View>,
}

/// A cone or a pyramid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct View {
    /// Full angle across, rad.
    pub angle: f64,
    /// Of a picture 4, of a cone 0.
    pub corners: usize,
    /// m.
    pub reach: f64,
}

/// A name and a unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measure {
    /// `position error`.
    pub name: String,
    /// `m`.
    pub unit: String,
}

/// An end before the others'.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ended {
    /// Its last frame.
    pub frame: usize,
    /// `crashed: too low`.
    pub why: String,
}

/// Something that happens on the way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// s, from the first frame on.
    pub time: f64,
    /// For the reader.
    pub text: String,
    /// Whom it happens to.
    pub actor: usize,
    /// Which rotor it strikes.
    pub rotor: Option<usize>,
}

/// An actor at one time. What is not finite stays as it was.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Moment {
    /// As of [`Look::poses`].
    pub poses: Vec<[f64; 7]>,
    /// Ω/Ω_max of every rotor.
    pub speeds: Vec<f64>,
    /// World, m.
    pub goals: Vec<[f64; 3]>,
    /// As of [`Look::forces`].
    pub forces: Vec<[f64; 3]>,
    /// If there is one.
    pub error: f64,
}

/// A flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Above the picture.
    pub title: String,
    /// Below the title.
    pub remark: String,
    /// Names and values.
    pub facts: Vec<[String; 2]>,
    /// s between two frames.
    pub interval: f64,
    /// What actors look like.
    pub looks: Vec<Look>,
    /// Who flies.
    pub actors: Vec<Actor>,
    /// In any order.
    pub events: Vec<Event>,
    rows: Vec<i32>,
}

impl Recording {
    /// Without frames.
    pub fn new(title: impl Into<String>, interval: f64, looks: Vec<Look>, actors: Vec<Actor>) -> Self {
        Self {
            title: title.into(),
            remark: String::new(),
            facts: Vec::new(),
            interval,
            looks,
            actors,
            events: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Numbers of a row.
    fn width(&self) -> usize {
        let of = |actor: &Actor| {
            let look = &self.looks[actor.look];
            let per_body = if actor.contact { 10 } else { 7 };
            per_body * look.n_body() + look.rotors + 3 * actor.goals + usize::from(actor.error.is_some())
        };
        self.actors.iter().map(of).sum()
    }

    /// Frames so far.
    pub fn n_frame(&self) -> usize {
        self.rows.len() / self.width().max(1)
    }

    /// Takes a frame in: one moment per actor, in their order.
    ///
    /// # Panics
    /// On moments of other sizes than the actors say: a mistake of the program.
    pub fn push(&mut self, moments: &[Moment]) {
        assert_eq!(moments.len(), self.actors.len(), "one moment per actor");
        let (width, start) = (self.width(), self.rows.len());
        for (actor, moment) in self.actors.iter().zip(moments) {
            for pose in &moment.poses {
                let (position, attitude) = pose.split_at(3);
                put(&mut self.rows, width, position, STEPS.position);
                let sign = continued(&self.rows, width, attitude);
                let attitude = [0, 1, 2, 3].map(|k| sign * attitude[k]);
                put(&mut self.rows, width, &attitude, STEPS.attitude);
            }
            put(&mut self.rows, width, &moment.speeds, STEPS.speed);
            moment.goals.iter().for_each(|goal| put(&mut self.rows, width, goal, STEPS.position));
            moment.forces.iter().for_each(|force| put(&mut self.rows, width, force, STEPS.force));
            if actor.error.is_some() {
                put(&mut self.rows, width, &[moment.error], STEPS.error);
            }
        }
        assert_eq!(self.rows.len() - start, width, "a row of the actors' sizes");
    }

    /// The last row as JSON: an array of whole numbers.
    pub fn last_row(&self) -> String {
        let row = self.rows.chunks_exact(self.width().max(1)).next_back().unwrap_or(&[]);
        json!(row).to_string()
    }

    /// Everything, for the page.
    pub fn to_json(&self) -> Value {
        let (width, frames) = (self.width(), self.n_frame());
        let column = |k: usize| (0..frames).map(|t| self.rows[t * width + k]).collect::<Vec<i32>>();
        json!({
            "format": 1,
            "title": self.title,
            "remark": self.remark,
            "facts": self.facts,
            "interval": self.interval,
            "steps": STEPS,
            "looks": self.looks,
            "actors": self.actors,
            "events": self.events,
            "frames": frames,
            "data": base64(&pack((0..width).map(column))),
        })
    }
}

/// Appends numbers as whole steps; one that is not finite as it was a row before.
fn put(rows: &mut Vec<i32>, width: usize, numbers: &[f64], step: f64) {
    for number in numbers {
        let before = rows.len().checked_sub(width).map_or(0, |at| rows[at]);
        let steps = (number / step).round();
        // i32 ends far beyond where anything flies
        rows.push(if steps.is_finite() { steps.clamp(-1e9, 1e9) as i32 } else { before });
    }
}

/// +1 or −1: the sign of a quaternion with which it goes on from the row before.
fn continued(rows: &[i32], width: usize, attitude: &[f64]) -> f64 {
    let Some(before) = rows.len().checked_sub(width) else { return 1.0 };
    let along: f64 = attitude.iter().zip(&rows[before..]).map(|(x, b)| x * f64::from(*b)).sum();
    if along < 0.0 { -1.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::dynamics::{Physics, Plant, vehicles};

    fn one() -> Recording {
        let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics::default()).unwrap();
        let look = Look::of(&plant);
        let actor = Actor {
            name: "one".into(),
            look: 0,
            offset: [0.0; 3],
            still: Vec::new(),
            goals: 1,
            contact: false,
            error: None,
            weight: look.weight,
            mounts: Vec::new(),
            ended: None,
        };
        Recording::new("one", 0.02, vec![look], vec![actor])
    }

    fn moment(pose: [f64; 7]) -> Moment {
        Moment { poses: vec![pose], speeds: vec![0.5; 4], goals: vec![[0.0; 3]], ..Moment::default() }
    }

    #[test]
    fn a_quaternion_goes_on_with_the_sign_it_had() {
        let mut recording = one();
        recording.push(&[moment([0.0, 0.0, 0.0, 0.6, 0.8, 0.0, 0.0])]);
        recording.push(&[moment([0.0, 0.0, 0.0, -0.61, -0.79, 0.0, 0.0])]);
        let width = recording.width();
        assert!(recording.rows[width + 3] > 0 && recording.rows[width + 4] > 0, "{:?}", recording.rows);
    }

    #[test]
    fn what_is_not_finite_stays_as_it_was() {
        let mut recording = one();
        recording.push(&[moment([1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0])]);
        recording.push(&[moment([f64::NAN, f64::INFINITY, 3.5, f64::NAN, f64::NAN, f64::NAN, f64::NAN])]);
        let (first, second) = recording.rows.split_at(recording.width());
        assert_eq!(first[..2], second[..2]);
        assert_eq!(second[2], 7000);
        assert_eq!(first[3..7], second[3..7]);
    }
}
