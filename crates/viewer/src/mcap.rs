//! Flights as MCAP, for Foxglove, rerun and whatever else reads the format: frames and shapes by the schemas that these know, all
//! numbers of a step by one of its own.
//!
//! | topic | schema | holds |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | every body in the frame of its actor, that in `world` |
//! | `/scene` | `foxglove.SceneUpdate` | what bodies look like, once |
//! | `/ACTOR/target` | `foxglove.PoseInFrame` | where it is wanted; several targets have topics of their own |
//! | `/ACTOR/step` | `omnidrones.Step` | the numbers of a sample by name; their units stand in the channel's metadata |
//! | `/log` | `foxglove.Log` | what happened |
//!
//! Times are those of the flight, from 0 on.

use super::foxglove::{self, Value, bytes, nanoseconds, numbers, pose, quaternion, time};
use super::look::{BodyLook, RotorLook, turned};
use super::recording::{Actor, Recording};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use omnidrones::dynamics::Plant;
use omnidrones::dynamics::shape::{Geometry, Shape};
use omnidrones_plot::Colour;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// What an actor of a recording did, sample by sample.
#[derive(Debug, Clone, Default)]
pub struct Track {
    /// s.
    pub times: Vec<f64>,
    /// The plant's, of every sample.
    pub states: Vec<Vec<f64>>,
    /// Where it is wanted, world, m, of every sample.
    pub goals: Vec<Vec<[f64; 3]>>,
    /// Of every sample, in the order of the columns.
    pub numbers: Vec<Vec<f64>>,
}

/// Writes one track per actor of the recording, whose looks, places and events are told; `columns` are names of the tracks'
/// numbers with their units, `position_x [m]`.
///
/// # Errors
/// Those of the sink.
pub fn write_mcap(
    sink: impl Write + Seek,
    plant: &Plant,
    recording: &Recording,
    columns: &[String],
    tracks: &[Track],
) -> std::io::Result<()> {
    let told = || {
        let mut log = Log::new(sink, columns)?;
        log.begin(recording)?;
        let most = tracks.iter().map(|track| track.times.len()).max().unwrap_or(0);
        for k in 0..most {
            for (actor, track) in recording.actors.iter().zip(tracks).filter(|(_, track)| k < track.times.len()) {
                log.sample(plant, recording, actor, track, k)?;
            }
        }
        for event in &recording.events {
            log.event(event.time, &event.text, &recording.actors[event.actor].name)?;
        }
        log.writer.finish().map(drop)
    };
    told().map_err(|error: McapError| match error {
        McapError::Io(error) => error,
        other => std::io::Error::other(other),
    })
}

struct Log<W: Write + Seek> {
    writer: Writer<W>,
    schemas: BTreeMap<&'static str, u16>,
    sequence: u32,
    /// Units by the names of the fields.
    units: BTreeMap<String, String>,
}

/// Names of fields, and units by them.
fn fields(columns: &[String]) -> (Vec<String>, BTreeMap<String, String>) {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let split = |column: &String| {
        let (name, unit) = column.split_once(" [").unwrap_or((column, "-]"));
        (name.chars().map(plain).collect::<String>(), unit.trim_end_matches(']').to_string())
    };
    let all: Vec<(String, String)> = columns.iter().map(split).collect();
    (all.iter().map(|(name, _)| name.clone()).collect(), all.into_iter().collect())
}

/// A name as part of a topic or frame.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

impl<W: Write + Seek> Log<W> {
    fn new(sink: W, columns: &[String]) -> Result<Self, McapError> {
        let library = format!("omnidrones {}", env!("CARGO_PKG_VERSION"));
        let mut writer = WriteOptions::new().compression(None).library(library).create(sink)?;
        let (names, units) = fields(columns);
        let mut schemas = BTreeMap::new();
        let common = foxglove::schema();
        for name in ["foxglove.FrameTransforms", "foxglove.SceneUpdate", "foxglove.PoseInFrame", "foxglove.Log"] {
            schemas.insert(name, writer.add_schema(name, "protobuf", &common)?);
        }
        let own = foxglove::schema_of_numbers("Step", &names);
        schemas.insert("omnidrones.Step", writer.add_schema("omnidrones.Step", "protobuf", &own)?);
        Ok(Self { writer, schemas, sequence: 0, units })
    }

    fn write(&mut self, topic: &str, schema: &str, at: f64, message: &[Value]) -> Result<(), McapError> {
        let none = BTreeMap::new();
        let units = if schema == "omnidrones.Step" { &self.units } else { &none };
        let channel_id = self.writer.add_channel(self.schemas[schema], topic, "protobuf", units)?;
        let log_time = nanoseconds(at);
        self.sequence += 1;
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, &bytes(message))
    }

    /// Frames of actors, and what they look like.
    fn begin(&mut self, recording: &Recording) -> Result<(), McapError> {
        let (mut frames, mut entities) = (Vec::new(), Vec::new());
        for (i, actor) in recording.actors.iter().enumerate() {
            let (own, look) = (plain(&actor.name), &recording.looks[actor.look]);
            frames.push(frame(0.0, "world", &own, actor.offset, [1.0, 0.0, 0.0, 0.0]));
            for body in &look.bodies {
                let name = format!("{own}/{}", plain(&body.name));
                entities.push(entity(&name, &drawn(body, Colour::nth(i))));
            }
            let mut still = Primitives::default();
            for (shape, at) in look.still.iter().zip(&actor.still) {
                still.solid(&Shape { position: *at, ..*shape }, Colour::GREY);
            }
            if !look.still.is_empty() {
                entities.push(entity(&own, &still));
            }
        }
        self.write("/tf", "foxglove.FrameTransforms", 0.0, &[Value::Messages(frames)])?;
        self.write("/scene", "foxglove.SceneUpdate", 0.0, &[Value::Nothing, Value::Messages(entities)])
    }

    fn sample(
        &mut self,
        plant: &Plant,
        recording: &Recording,
        actor: &Actor,
        track: &Track,
        k: usize,
    ) -> Result<(), McapError> {
        let (at, own, look) = (track.times[k], plain(&actor.name), &recording.looks[actor.look]);
        let poses = look.poses(plant, &track.states[k]);
        let body = |(body, [x, y, z, w, i, j, l]): (&BodyLook, [f64; 7])| {
            frame(at, &own, &format!("{own}/{}", plain(&body.name)), [x, y, z], [w, i, j, l])
        };
        let frames = look.bodies.iter().zip(poses).map(body).collect();
        self.write("/tf", "foxglove.FrameTransforms", at, &[Value::Messages(frames)])?;
        for (g, goal) in track.goals.get(k).into_iter().flatten().enumerate() {
            let topic = if track.goals[k].len() == 1 { format!("/{own}/target") } else { format!("/{own}/target_{g}") };
            let message = [time(at), Value::Text(own.clone()), pose(*goal, [1.0, 0.0, 0.0, 0.0])];
            self.write(&topic, "foxglove.PoseInFrame", at, &message)?;
        }
        let step: Vec<Value> = track.numbers[k].iter().map(|x| Value::Number(*x)).collect();
        self.write(&format!("/{own}/step"), "omnidrones.Step", at, &step)
    }

    fn event(&mut self, at: f64, text: &str, actor: &str) -> Result<(), McapError> {
        const WARNING: u64 = 3;
        let message = [time(at), Value::Whole(WARNING), Value::Text(text.into()), Value::Text(actor.into())];
        self.write("/log", "foxglove.Log", at, &message)
    }
}

fn frame(at: f64, parent: &str, child: &str, position: [f64; 3], attitude: [f64; 4]) -> Vec<u8> {
    let [parent, child] = [parent, child].map(|name| Value::Text(name.into()));
    bytes(&[time(at), parent, child, numbers(position), quaternion(attitude)])
}

/// Shapes of an entity by their kinds.
#[derive(Default)]
struct Primitives {
    arrows: Vec<Vec<u8>>,
    cubes: Vec<Vec<u8>>,
    spheres: Vec<Vec<u8>>,
    cylinders: Vec<Vec<u8>>,
    lines: Vec<Vec<u8>>,
}

/// An entity that moves with its frame.
fn entity(frame: &str, own: &Primitives) -> Vec<u8> {
    let [id, frame] = [frame, frame].map(|name| Value::Text(name.into()));
    let many = |all: &Vec<Vec<u8>>| Value::Messages(all.clone());
    bytes(&[
        time(0.0),
        frame,
        id,
        Value::Nothing,
        Value::Whole(1),
        Value::Nothing,
        many(&own.arrows),
        many(&own.cubes),
        many(&own.spheres),
        many(&own.cylinders),
        many(&own.lines),
    ])
}

fn paint(colour: Colour, opacity: f64) -> Value {
    let of = |v: u8| f64::from(v) / 255.0;
    numbers([of(colour.0), of(colour.1), of(colour.2), opacity])
}

impl Primitives {
    fn solid(&mut self, shape: &Shape, colour: Colour) {
        let (at, attitude) = (shape.position, shape.rotation);
        let own = |size: [f64; 3]| bytes(&[pose(at, attitude), numbers(size), paint(colour, 1.0)]);
        match shape.geometry {
            Geometry::Box { size } => self.cubes.push(own(size)),
            Geometry::Sphere { radius } => self.spheres.push(own([2.0 * radius; 3])),
            Geometry::Capsule { radius, length } => {
                let body = [2.0 * radius, 2.0 * radius, length];
                self.cylinder(at, attitude, body, paint(colour, 1.0));
                for end in [-0.5, 0.5] {
                    let [x, y, z] = at;
                    let [w, i, j, k] = attitude;
                    let place = turned(&[x, y, z, w, i, j, k], [0.0, 0.0, end * length]);
                    let ball = [pose(place, attitude), numbers([2.0 * radius; 3]), paint(colour, 1.0)];
                    self.spheres.push(bytes(&ball));
                }
            }
        }
    }

    fn cylinder(&mut self, at: [f64; 3], attitude: [f64; 4], size: [f64; 3], colour: Value) {
        let straight = Value::Number(1.0);
        self.cylinders.push(bytes(&[pose(at, attitude), numbers(size), straight.clone(), straight, colour]));
    }

    fn rotor(&mut self, rotor: &RotorLook) {
        let colour = if rotor.spin > 0.0 { Colour::BLUE } else { Colour::ORANGE };
        let size = [2.0 * rotor.radius, 2.0 * rotor.radius, 0.06 * rotor.radius];
        self.cylinder(rotor.position, from_z(rotor.axis), size, paint(colour, 0.5));
    }

    /// Pairs of points with lines between them.
    fn lines(&mut self, pairs: &[[[f64; 3]; 2]], thickness: f64, colour: Colour) {
        const LINE_LIST: u64 = 2;
        if pairs.is_empty() {
            return;
        }
        let points = pairs.as_flattened().iter().map(|p| bytes(&p.map(Value::Number))).collect();
        let here = pose([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
        let line = [
            Value::Whole(LINE_LIST),
            here,
            Value::Number(thickness),
            Value::Nothing,
            Value::Messages(points),
            paint(colour, 1.0),
        ];
        self.lines.push(bytes(&line));
    }
}

/// A body: discs of rotors, arms in its colour, an arrow forward where it flies; other shapes as they are.
fn drawn(body: &BodyLook, colour: Colour) -> Primitives {
    let mut own = Primitives::default();
    body.rotors.iter().for_each(|rotor| own.rotor(rotor));
    let flies = body.rotors.len() >= 3;
    if flies {
        let n = body.rotors.len() as f64;
        let middle = [0, 1, 2].map(|k| body.rotors.iter().map(|r| r.position[k]).sum::<f64>() / n);
        let arms: Vec<_> = body.rotors.iter().map(|rotor| [middle, rotor.position]).collect();
        let radius = body.rotors[0].radius;
        own.lines(&arms, 0.15 * radius, colour);
        let [shaft, head] = [(0.8, 0.12), (0.4, 0.3)].map(|(long, thick)| [long * radius, thick * radius]);
        let [a, b, c, d] = [shaft[0], shaft[1], head[0], head[1]].map(Value::Number);
        own.arrows.push(bytes(&[pose(middle, [1.0, 0.0, 0.0, 0.0]), a, b, c, d, paint(colour, 1.0)]));
    } else {
        own.lines(&body.struts, 0.02, Colour::INK);
    }
    // what collides of a drone is inside the frame that is drawn
    let outside = |shape: &&Shape| !flies || matches!(shape.geometry, Geometry::Capsule { .. });
    body.solids.iter().filter(outside).for_each(|shape| own.solid(shape, if flies { colour } else { Colour::GREY }));
    own
}

/// The shortest turn of z onto a unit vector, `[w, x, y, z]`.
fn from_z([x, y, z]: [f64; 3]) -> [f64; 4] {
    let w = 1.0 + z;
    if w < 1e-9 {
        return [0.0, 1.0, 0.0, 0.0];
    }
    let scale = 1.0 / (w * w + x * x + y * y).sqrt();
    [w * scale, -y * scale, x * scale, 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_stands_across_its_axis() {
        for axis in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, -1.0, 0.0]] {
            let [w, x, y, z] = from_z(axis);
            let told = turned(&[0.0, 0.0, 0.0, w, x, y, z], [0.0, 0.0, 1.0]);
            assert!((0..3).all(|k| (told[k] - axis[k]).abs() < 1e-12), "{axis:?}: {told:?}");
        }
    }

    #[test]
    fn a_column_is_a_field_with_its_unit_beside_it() {
        let (names, units) = fields(&["state.rotor_0.speed [rad/s]".into(), "reward [-]".into()]);
        assert_eq!(names, ["state_rotor_0_speed", "reward"]);
        assert_eq!(units["state_rotor_0_speed"], "rad/s");
    }
}
