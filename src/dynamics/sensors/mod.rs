//! Sensors: what a part on a body reads, from the truth to the number on the bus.
//!
//! ```text
//! truth at the mount → scale, misalignment, bias, noise → limits → resolution → rate → latency
//! ```
//!
//! | file | what |
//! |---|---|
//! | `mount` | where a sensor sits, what happens there |
//! | `chain` | the errors, the rate, the latency, dropouts |
//! | `fault` | what happens to a sensor, from when until when |
//! | `device` | what every kind of sensor does |
//! | `inertial` | accelerometer and gyroscope |
//! | `magnetometer_barometer` | magnetometer, barometer |
//! | `gnss` | satellite receiver, motion capture |
//! | `range_flow` | range finder, and optical flow over level ground |
//! | `contact` | forces of contact |
//! | `lidar` | beams, in a grid or scattered |
//! | `camera` | depth, what is seen, surfaces, colours; stereo's noise and holes |
//! | `shade` | colours of what a camera sees |
//! | `reading` | how distances are encoded |
//! | `sample_noise` | noise of many pixels |
//! | `gradient` | how readings change with the pose of their body |
//! | `context` | what looks, from where, at what |
//! | `solids` | bodies, and what stands around them, as rays hit them |
//! | `kinds` | the kinds, one line each |
//! | `presets` | real parts |
//! | `limits`, `settings` | what numbers may be; `[[sensor]]` tables |
//! | `onboard` | sensors on the bodies of a plant |
//! | [`cast`] | rays: distances to a scene, pixel by pixel or beam by beam |
//!
//! A sensor draws from streams of its own, found from (seed, environment, episode, its name): what it reads depends on these,
//! on its settings and on the truth, not on threads, on the place in a batch or on other sensors. Stepping allocates nothing.
//! All is in `f64`. Readings of rays have derivatives by the pose of their body where [`SensorGradient::Pose`] asks for them, others none.
//!
//! ```
//! # use omnidrones_dynamics::omnidrones;
//! use omnidrones::dynamics::sensors::cast::RayScene;
//! use omnidrones::dynamics::sensors::{RayScratch, SensorConfig, SensorSet, SensorContext, GroundTruth};
//! use omnidrones::dynamics::Frame;
//!
//! let list = SensorConfig::parse_list("imu,barometer:px4")?;
//! let mut sensors = SensorSet::new(&list, 0.002, &["drone".to_string()])?;
//! sensors.reset(7, 0, 1);
//! let still = Frame { position: [0.0; 3], velocity: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0], angular_velocity: [0.0; 3] };
//! let (mut world, mut eyes) = (RayScene::default(), RayScratch::default()); // nothing in sight
//! let truths = [GroundTruth::at(&still, [0.0; 3], [0.0; 3], 9.81)];
//! let readings = sensors.step(&truths, &mut SensorContext::new(&mut world, &[], &mut eyes));
//! assert_eq!(readings[2], 9.81); // at rest an accelerometer reads +g upwards
//! assert_eq!(sensors.channels()[2].name, "imu.accelerometer_z");
//! # Ok::<(), omnidrones::error::Error>(())
//! ```

mod camera;
pub mod cast;
mod chain;
#[doc(hidden)]
pub mod contact;
mod context;
mod device;
mod fault;
mod gnss;
mod gradient;
mod inertial;
mod kinds;
mod lidar;
mod limits;
mod magnetometer_barometer;
mod mount;
mod onboard;
#[doc(hidden)]
pub mod presets;
mod range_flow;
mod reading;
mod sample_noise;
mod settings;
mod shade;
#[doc(hidden)]
pub mod solids;

pub use camera::{Camera, ImageType, Stereo};
pub use cast::normal::RangeJacobian;
pub use chain::{ErrorModel, PerAxis};
pub use contact::Contact;
pub use context::{RayScratch, SensorContext};
pub use device::{Channel, ReadingLayout};
pub use fault::{FaultKind, SensorFault};
pub use gnss::{Gnss, MotionCapture};
pub use gradient::SensorGradient;
pub use inertial::Imu;
pub use kinds::{KINDS, SensorKind, SensorModel};
pub use lidar::{Lidar, Pattern};
pub use magnetometer_barometer::{Barometer, Magnetometer};
pub use mount::GroundTruth;
pub use onboard::OnboardSensors;
pub use presets::{Preset, preset};
pub use range_flow::{Flow, NoiseGrowth, Range};
pub use reading::DistanceEncoding;
pub use settings::{SensorConfig, SensorFile};
pub use solids::PosedShape;

use super::plant::Quantity;
use base::error::{Error, Result};
use chain::DelayLine;
use kinds::SensorInstance;
use mount::Mount;
use rng::{Purpose, Stream};

/// Most sensors of one set.
const MAX_SENSORS: usize = 256;
/// Numbers of a saved sensor before its samples: step, position of its stream, seed, environment, episode in halves.
const HEAD: usize = 8;

/// One sensor with its state.
#[derive(Debug, Clone)]
pub struct Sensor {
    channels: Vec<Quantity>,
    body: usize,
    purpose: Purpose,
    mount: Mount,
    device: SensorInstance,
    line: DelayLine,
    stream: Stream,
    /// As sampled last; what waits for its latency is in the line.
    sample: Vec<f64>,
    faults: Vec<SensorFault>,
    /// The sample as it is read, where there are faults.
    faulty: Vec<f64>,
    dt: f64,
    /// Of the readings of the last step, one each where they are asked for.
    slopes: Vec<RangeJacobian>,
    /// Numbers of a saved state.
    n_saved: usize,
}

impl Sensor {
    /// A sensor of a simulation with steps of `dt` seconds and these bodies, at the beginning of episode 0 of environment 0 of
    /// seed 0.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a body that is not there; [`Error::Value`] and [`Error::Limit`] for settings that no sensor has.
    pub fn new(config: &SensorConfig, dt: f64, bodies: &[String]) -> Result<Self> {
        config.check_name()?;
        let place = config.place();
        limits::within("dt", dt, 1e-9, 1e3)?;
        config.model.validate(&place)?;
        let (every, latency) = (config.steps_between(dt)?, config.steps_late(dt)?);
        config.check_gradient(every, latency)?;
        let named = config.model.channels();
        let width = named.len();
        config.faults.iter().try_for_each(|fault| fault.validate(&place, width))?;
        let channel = |(name, unit)| Quantity { name: format!("{}.{name}", config.name), unit };
        let channels = named.into_iter().map(channel).collect();
        let purpose = Purpose::sensor(&config.name);
        let mut sensor = Self {
            channels,
            body: body(config, bodies)?,
            purpose,
            mount: Mount::new(&place, config.position, config.rotation)?,
            device: config.model.at_work(dt * every as f64)?,
            line: DelayLine::new(&place, every, latency, width)?,
            stream: Stream::new(0, 0, 0, purpose),
            sample: vec![0.0; width],
            faulty: vec![0.0; if config.faults.is_empty() { 0 } else { width }],
            faults: config.faults.clone(),
            dt,
            slopes: vec![RangeJacobian::default(); if config.gradient == SensorGradient::Pose { width } else { 0 }],
            n_saved: HEAD,
        };
        let mut n_saved = HEAD;
        sensor.each(&mut |_| n_saved += 1);
        sensor.n_saved = n_saved;
        sensor.reset(0, 0, 0);
        Ok(sensor)
    }

    /// Begins an episode: draws what stays in it. The next step is its first and takes a sample.
    pub fn reset(&mut self, seed: u64, environment: u64, episode: u64) {
        self.stream = Stream::new(seed, environment, episode, self.purpose);
        self.device.device().draw(&mut self.stream);
        self.line.restart();
        self.sample.fill(0.0);
        self.faulty.fill(0.0);
    }

    /// Reads after a step, or at the beginning of the episode, what [`channels`](Self::channels) names, in their units: from the motion
    /// `truth` of its body, and by rays from what stands in `context`.
    pub fn step(&mut self, truth: &GroundTruth, context: &mut SensorContext<'_>) -> &[f64] {
        if self.line.is_due() {
            let motion = self.mount.motion(truth);
            context.look_from(self.body);
            let tells = context.begin(!self.slopes.is_empty());
            self.device.device().sample(&motion, context, &mut self.stream, &mut self.sample);
            self.slopes.fill(RangeJacobian::default());
            if tells {
                let (mount, body) = (self.mount.pose(), truth.pose());
                let each = self.slopes.iter_mut().zip(context.met());
                each.for_each(|(slope, met)| *slope = met.slope(context.world(), &mount, &body));
            }
            self.read_faulty();
        }
        self.line.advance(if self.faults.is_empty() { &self.sample } else { &self.faulty });
        self.line.reading()
    }

    /// What faults make of the sample: the device goes on from its own.
    fn read_faulty(&mut self) {
        if self.faults.is_empty() {
            return;
        }
        let time = self.line.steps() as f64 * self.dt;
        let is_acting = |kind: FaultKind| self.faults.iter().any(|fault| fault.kind == kind && fault.is_acting(time));
        let (is_lost, is_stuck) = (is_acting(FaultKind::Lost), is_acting(FaultKind::Stuck));
        if is_lost || is_stuck {
            // neither depends on the pose
            self.slopes.fill(RangeJacobian::default());
        }
        if is_lost {
            self.faulty.fill(f64::NAN);
        } else if !is_stuck {
            self.faulty.copy_from_slice(&self.sample);
            self.faults.iter().filter(|fault| fault.is_acting(time)).for_each(|fault| fault.add_to(&mut self.faulty));
        }
    }

    /// As the last step returned it.
    pub fn reading(&self) -> &[f64] {
        self.line.reading()
    }

    /// How the readings of the last step change with the pose of the body, reading by reading: ∂/∂position per m along world
    /// axes, ∂/∂attitude per rad about the body's own. Empty without [`SensorGradient::Pose`]; zeros after a step in a context
    /// [without slopes](SensorContext::without_slopes). Not part of a saved state.
    pub fn slopes(&self) -> &[RangeJacobian] {
        &self.slopes
    }

    /// Whether the last step's reading is a sample that was not read before.
    pub fn is_new(&self) -> bool {
        self.line.is_new()
    }

    /// Names and units of its readings: `imu.accelerometer_x`, m/s^2.
    pub fn channels(&self) -> &[Quantity] {
        &self.channels
    }

    /// Number of the body that carries it.
    pub fn body(&self) -> usize {
        self.body
    }

    /// Steps from one sample to the next.
    pub fn every(&self) -> u64 {
        self.line.every()
    }

    /// Steps from a sample to its reading.
    pub fn latency(&self) -> u64 {
        self.line.latency()
    }

    /// Visits every number of the state but for the head.
    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.device.device().each(visit);
        self.sample.iter_mut().chain(&mut self.faulty).for_each(&mut *visit);
        self.line.each(visit);
    }

    /// Numbers of a saved state.
    pub fn n_saved(&self) -> usize {
        self.n_saved
    }

    /// Writes all that later readings depend on. Whole numbers up to 2⁵³ are exact in `f64`; the three of the stream's key are
    /// written in halves.
    ///
    /// # Panics
    /// On a slice of another length than [`n_saved`](Self::n_saved).
    pub fn save(&self, saved: &mut [f64]) {
        assert!(saved.len() == self.n_saved, "{} numbers for a state of {}", saved.len(), self.n_saved);
        let [seed, environment, episode, _] = self.stream.key();
        saved[0] = self.line.steps() as f64;
        saved[1] = self.stream.position() as f64;
        for (pair, word) in saved[2..HEAD].chunks_exact_mut(2).zip([seed, environment, episode]) {
            pair.copy_from_slice(&[(word >> 32) as f64, (word & 0xffff_ffff) as f64]);
        }
        let mut at = HEAD;
        // one visit serves reading and writing: here of a copy
        self.clone().each(&mut |x| {
            saved[at] = *x;
            at += 1;
        });
    }

    /// Goes on from a state of [`save`](Self::save), of a sensor with the same settings, with the same bits.
    ///
    /// # Errors
    /// [`Error::Value`] for another length and for counters that are no whole numbers; the sensor is then as it was.
    pub fn restore(&mut self, saved: &[f64]) -> Result<()> {
        let n = self.n_saved;
        let remedy = "Restore what a sensor with the same settings saved.";
        if saved.len() != n {
            let limit = format!("{n}, as Sensor::n_saved says");
            return Err(Error::value("saved sensor: length", saved.len(), limit, remedy));
        }
        let mut head = [0; HEAD];
        for (i, (whole, x)) in head.iter_mut().zip(saved).enumerate() {
            let most = if i < 2 { 9_007_199_254_740_992.0 } else { 4_294_967_295.0 };
            if !((0.0..=most).contains(x) && x.fract() == 0.0) {
                let what = format!("saved sensor: number {i}");
                return Err(Error::value(what, x, format!("a whole number, 0 to {most}"), remedy));
            }
            *whole = *x as u64;
        }
        let word = |i: usize| head[i] << 32 | head[i + 1];
        let key = [word(2), word(4), word(6), self.purpose.0];
        // what an episode begins with is drawn again, then stands what changed since
        self.reset(key[0], key[1], key[2]);
        self.stream = Stream::restore(key, head[1]);
        self.line.set_steps(head[0]);
        let mut at = HEAD;
        self.each(&mut |x| {
            *x = saved[at];
            at += 1;
        });
        Ok(())
    }
}

/// The body that a sensor sits on.
fn body(config: &SensorConfig, bodies: &[String]) -> Result<usize> {
    let unknown = |name: &str| Error::Unknown { kind: "body", name: name.into(), known: bodies.to_vec() };
    match &config.on {
        None if bodies.is_empty() => Err(unknown("")),
        None => Ok(0),
        Some(name) => bodies.iter().position(|body| body == name).ok_or_else(|| unknown(name)),
    }
}

/// Several sensors, read together.
#[derive(Debug, Clone)]
pub struct SensorSet {
    sensors: Vec<Sensor>,
    readings: Vec<f64>,
}

impl SensorSet {
    /// Sensors of one simulation, in order.
    ///
    /// # Errors
    /// As [`Sensor::new`]; [`Error::Value`] for a name used twice, [`Error::Limit`] for more than 256.
    pub fn new(configs: &[SensorConfig], dt: f64, bodies: &[String]) -> Result<Self> {
        if configs.len() > MAX_SENSORS {
            let remedy = "Leave out what nobody reads.";
            return Err(Error::limit("number of sensors", configs.len(), MAX_SENSORS, remedy));
        }
        for (i, config) in configs.iter().enumerate() {
            if configs[..i].iter().any(|other| other.name == config.name) {
                let value = format!("'{}' twice", config.name);
                return Err(Error::value(
                    "sensor: name",
                    value,
                    "unique",
                    "Rename one, in a file of [[sensor]] tables: noise depends on it.",
                ));
            }
        }
        let sensors = configs.iter().map(|config| Sensor::new(config, dt, bodies)).collect::<Result<Vec<_>>>()?;
        let readings = vec![0.0; sensors.iter().map(|sensor| sensor.channels.len()).sum()];
        Ok(Self { sensors, readings })
    }

    /// Begins an episode of all.
    pub fn reset(&mut self, seed: u64, environment: u64, episode: u64) {
        self.sensors.iter_mut().for_each(|sensor| sensor.reset(seed, environment, episode));
        self.readings.fill(0.0);
    }

    /// Reads all, sensor by sensor, in the order of [`channels`](Self::channels); `truths` are body by body.
    ///
    /// # Panics
    /// On fewer truths than there were bodies.
    pub fn step(&mut self, truths: &[GroundTruth], context: &mut SensorContext<'_>) -> &[f64] {
        let mut at = 0;
        for sensor in &mut self.sensors {
            let reading = sensor.step(&truths[sensor.body], context);
            self.readings[at..at + reading.len()].copy_from_slice(reading);
            at += reading.len();
        }
        &self.readings
    }

    /// As the last step returned them.
    pub fn readings(&self) -> &[f64] {
        &self.readings
    }

    /// Names and units of all readings, in order.
    pub fn channels(&self) -> Vec<Quantity> {
        self.sensors.iter().flat_map(|sensor| sensor.channels.iter().cloned()).collect()
    }

    /// Sensor by sensor.
    pub fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    /// Numbers of a saved state.
    pub fn n_saved(&self) -> usize {
        self.sensors.iter().map(Sensor::n_saved).sum()
    }

    /// Sensor by sensor, as [`Sensor::save`].
    ///
    /// # Panics
    /// On a slice of another length than [`n_saved`](Self::n_saved).
    pub fn save(&self, saved: &mut [f64]) {
        let mut rest = saved;
        for sensor in &self.sensors {
            let (own, others) = rest.split_at_mut(sensor.n_saved());
            sensor.save(own);
            rest = others;
        }
        assert!(rest.is_empty(), "as long as n_saved says");
    }

    /// As [`Sensor::restore`], sensor by sensor.
    ///
    /// # Errors
    /// As there; sensors before the first that cannot be restored are then restored.
    pub fn restore(&mut self, saved: &[f64]) -> Result<()> {
        let n = self.n_saved();
        if saved.len() != n {
            let remedy = "Restore what sensors with the same settings saved.";
            let limit = format!("{n}, as SensorSet::n_saved says");
            return Err(Error::value("saved sensors: length", saved.len(), limit, remedy));
        }
        let (mut rest, mut at) = (saved, 0);
        for sensor in &mut self.sensors {
            let (own, others) = rest.split_at(sensor.n_saved());
            sensor.restore(own)?;
            rest = others;
            let reading = sensor.line.reading();
            self.readings[at..at + reading.len()].copy_from_slice(reading);
            at += reading.len();
        }
        Ok(())
    }
}

#[cfg(test)]
mod ray_sensor_tests;
#[cfg(test)]
mod tests;
