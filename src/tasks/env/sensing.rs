//! Sensors of the agents: what stands behind the task's own numbers in every observation.
//!
//! Every agent carries the sensors of the configuration, by default on its own drone. They read in `f64`, environment by
//! environment, after the physics of a step and where an episode begins; tasks do not see what they read. Gradients take it for
//! constants, unless a sensor has `gradient = "pose"`: then a recorded step keeps how readings change with the poses of the
//! bodies that carry such sensors.

use super::Env;
use super::block::{Columns, EnvBlock, take};
use super::core::Core;
use super::mask::lanes_of;
use super::stepper::Stepper;
use crate::config::EnvConfig;
use crate::task::Task;
use crate::task_spec::{Field, FieldLayout, Smoothness};
use autodiff::System;
use autodiff::program::BLOCK;
use base::error::{Error, Result};
use dynamics::frame::{FRAME, Frame};
use dynamics::sensors::cast::RayScene;
use dynamics::sensors::contact::check_contact;
use dynamics::sensors::solids::{Solids, Surroundings};
use dynamics::sensors::{self, GroundTruth, RayScratch, SensorConfig, SensorContext, SensorSet};
use dynamics::tree::contact_forces_with;

/// Most numbers that one agent's sensors read.
const MAX_READINGS: usize = 4096;

/// Sensors of one environment, and what they look at.
#[derive(Debug, Clone)]
pub(crate) struct Sensors {
    /// One set per agent.
    pub sets: Vec<SensorSet>,
    world: RayScene,
}

/// What all environments share of their sensors.
#[derive(Debug)]
pub(crate) struct SensorSetup {
    template: Sensors,
    around: Surroundings,
    solids: Solids,
    /// Frames that carry sensors.
    carriers: Vec<usize>,
    /// Whether forces of contact are read.
    feels: bool,
    /// Of one step of an environment, s.
    dt: f64,
    /// Numbers that one agent reads.
    pub n: usize,
    /// Readings of all agents that gradients follow.
    pub sloped: Vec<Sloped>,
    /// Frames whose poses these readings depend on.
    pub posed: Vec<usize>,
    /// What they are.
    pub fields: Vec<Field>,
}

/// A reading with a slope in the pose of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sloped {
    /// Its place among the readings of all agents.
    pub reading: usize,
    /// The body, as a place in [`SensorSetup::posed`].
    pub body: usize,
}

/// Numbers of a slope: per m along world axes, per rad about body axes.
pub(crate) const SLOPE: usize = 6;
/// Numbers of a pose: position, attitude.
pub(crate) const POSE: usize = 7;
/// Where the attitude stands in a frame.
const ATTITUDE: usize = 6;

/// What a worker needs to read sensors.
#[derive(Debug, Default)]
pub(crate) struct SensorScratch {
    /// Frames before the step.
    pub before: Columns,
    solids: Solids,
    eyes: RayScratch,
    truths: Vec<GroundTruth>,
    state: Vec<f64>,
    next: Vec<f64>,
    frames: Vec<f64>,
    numbers: Vec<f64>,
    goal: Vec<f64>,
    placement: Vec<f64>,
    /// Whether the step is recorded, and slopes are kept.
    pub records: bool,
    /// Of the [`SensorSetup::sloped`] readings, then the attitudes of the [`SensorSetup::posed`] frames, behind the step.
    pub slopes: Columns,
}

impl SensorSetup {
    /// The sensors of a configuration; `None` without any.
    ///
    /// # Errors
    /// As [`SensorSet::new`]; [`Error::Limit`] for more than [`MAX_READINGS`] numbers.
    pub(crate) fn of(config: &EnvConfig, task: &dyn Task) -> Result<Option<Self>> {
        let (configs, robot) = (config.sensors(), task.robot());
        if configs.is_empty() {
            return Ok(None);
        }
        let bodies = robot.plant().body_names();
        if let Some(lost) =
            configs.iter().find(|config| config.faults.iter().any(|f| f.kind == sensors::FaultKind::Lost))
        {
            let remedy = "Take 'stuck' or 'offset': observations are numbers.";
            return Err(Error::value(
                format!("{}: faults", lost.place()),
                "lost",
                "of a kind that reads numbers",
                remedy,
            ));
        }
        let own = |agent: usize| {
            let drone = &robot.drones()[agent.min(robot.drones().len() - 1)];
            let of_agent = |config: &SensorConfig| SensorConfig {
                // noise depends on the name, and no two agents hear the same
                name: if agent == 0 { config.name.clone() } else { format!("{}/{agent}", config.name) },
                on: config.on.clone().or_else(|| bodies.get(drone.frame).cloned()),
                ..config.clone()
            };
            SensorSet::new(&configs.iter().map(of_agent).collect::<Vec<_>>(), config.dt, &bodies)
        };
        let sets = (0..task.n_agent()).map(own).collect::<Result<Vec<_>>>()?;
        let n = sets[0].readings().len();
        if n > MAX_READINGS {
            let remedy = "Take fewer beams or pixels, or let a camera pool them.";
            return Err(Error::limit("sensor: numbers that one agent reads", n, MAX_READINGS, remedy));
        }
        let around = Surroundings::of(&task.scene(), robot.plant());
        let mut world = RayScene::default();
        world.fill(&around.scene, &around.scene.nominal_placement())?;
        let mut carriers: Vec<usize> = sets.iter().flat_map(|set| set.sensors().iter().map(|s| s.body())).collect();
        carriers.sort_unstable();
        carriers.dedup();
        let mut touching = configs.iter().filter(|config| matches!(config.model, sensors::SensorModel::Contact(_)));
        touching.clone().try_for_each(|config| check_contact(&config.place(), robot.plant()))?;
        let feels = touching.next().is_some();
        let fields = configs.iter().flat_map(fields).collect();
        let solids = Solids::of(robot.plant()).without_lone_body();
        let (sloped, posed) = sloped(&sets);
        let (template, dt) = (Sensors { sets, world }, config.dt);
        Ok(Some(Self { template, around, solids, carriers, feels, dt, n, sloped, posed, fields }))
    }

    /// Rows that a recorded step keeps of slopes.
    pub(crate) fn n_slope(&self) -> usize {
        SLOPE * self.sloped.len() + 4 * self.posed.len()
    }

    /// Of one environment, at the beginning of nothing.
    pub(crate) fn sensors(&self) -> Sensors {
        self.template.clone()
    }

    /// Numbers of the saved sensors of one environment.
    pub(crate) fn n_saved(&self) -> usize {
        self.template.sets.iter().map(SensorSet::n_saved).sum()
    }

    /// Memory of one environment, bytes, about.
    pub(crate) fn bytes(&self) -> usize {
        let samples = 3 * self.n_saved() * size_of::<f64>();
        let readings = self.template.sets.len() * self.n * size_of::<f32>();
        let slopes = self.sloped.len() * size_of::<sensors::RangeJacobian>();
        samples + readings + slopes + 96 * self.template.world.n_solid() + size_of::<Sensors>()
    }

    /// Memory of one worker.
    pub(crate) fn senses(&self, core: &Core) -> SensorScratch {
        let robot = core.robot();
        let frames = robot.n_frame() * FRAME;
        let still = Frame {
            position: [0.0; 3],
            velocity: [0.0; 3],
            attitude: [1.0, 0.0, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        };
        SensorScratch {
            before: Columns::zeros(frames),
            solids: self.solids.clone(),
            eyes: RayScratch::default(),
            truths: vec![GroundTruth::at(&still, [0.0; 3], [0.0; 3], 0.0); robot.n_frame()],
            state: vec![0.0; robot.n_state()],
            next: vec![0.0; robot.n_state()],
            frames: vec![0.0; frames],
            numbers: core.nominal.clone(),
            goal: vec![0.0; core.sizes.goal],
            placement: Vec::with_capacity(self.around.scene.n_placement()),
            records: false,
            slopes: Columns::zeros(self.n_slope()),
        }
    }

    /// Reads all sensors of one environment, of whose bodies it is known how they move.
    fn read(
        &self,
        core: &Core,
        block: &mut EnvBlock,
        senses: &mut SensorScratch,
        frames: &[[f32; BLOCK]],
        lane: usize,
    ) {
        if let Some(system) = core.parametric_plant.tree().filter(|_| self.feels) {
            take(&block.plant.rows, lane, &mut senses.state);
            core.numbers_of(block, lane, &mut senses.numbers);
            let forces = contact_forces_with(system, &senses.numbers, &senses.state);
            senses.truths.iter_mut().zip(forces).for_each(|(truth, force)| truth.contact_force = force);
        }
        let sensors = &mut block.sensors[lane];
        let solids = senses.solids.at(|body| frame(frames, body, lane));
        let mut context = SensorContext::new(&mut sensors.world, solids, &mut senses.eyes);
        if !senses.records {
            context = context.without_slopes();
        }
        for set in &mut sensors.sets {
            set.step(&senses.truths, &mut context);
        }
        if senses.records {
            self.keep_slopes(&sensors.sets, frames, lane, &mut senses.slopes);
        }
        block.keep_readings(core, lane);
    }

    /// How one environment's readings change with poses, and the attitudes that turns are taken from.
    fn keep_slopes(&self, sets: &[SensorSet], frames: &[[f32; BLOCK]], lane: usize, rows: &mut [[f32; BLOCK]]) {
        let (slopes, attitudes) = rows.split_at_mut(SLOPE * self.sloped.len());
        let all = sets.iter().flat_map(SensorSet::sensors).flat_map(|sensor| sensor.slopes());
        for (rows, slope) in slopes.chunks_exact_mut(SLOPE).zip(all) {
            let numbers = slope.position.iter().chain(&slope.attitude);
            rows.iter_mut().zip(numbers).for_each(|(row, x)| row[lane] = *x as f32);
        }
        for (rows, body) in attitudes.chunks_exact_mut(4).zip(&self.posed) {
            let attitude = &frames[body * FRAME + ATTITUDE..][..4];
            rows.iter_mut().zip(attitude).for_each(|(row, x)| row[lane] = x[lane]);
        }
    }

    /// The poses of all frames that readings depend on, of one environment's `frames`.
    pub(crate) fn write_poses<S: Copy>(&self, frames: &[S], poses: &mut [S]) {
        for (pose, body) in poses.chunks_exact_mut(POSE).zip(&self.posed) {
            let frame = &frames[body * FRAME..][..FRAME];
            pose[..3].copy_from_slice(&frame[..3]);
            pose[3..].copy_from_slice(&frame[ATTITUDE..][..4]);
        }
    }
}

/// The readings that gradients follow, in order, and the bodies that they depend on.
fn sloped(sets: &[SensorSet]) -> (Vec<Sloped>, Vec<usize>) {
    let (mut sloped, mut posed, mut first) = (Vec::new(), Vec::new(), 0);
    for sensor in sets.iter().flat_map(SensorSet::sensors) {
        if !sensor.slopes().is_empty() {
            let body = posed.iter().position(|body| *body == sensor.body()).unwrap_or_else(|| {
                posed.push(sensor.body());
                posed.len() - 1
            });
            sloped.extend((0..sensor.slopes().len()).map(|i| Sloped { reading: first + i, body }));
        }
        first += sensor.channels().len();
    }
    (sloped, posed)
}

/// Motion of a body in one lane.
pub(super) fn frame(frames: &[[f32; BLOCK]], body: usize, lane: usize) -> Frame<f64> {
    let mut numbers = [0.0; FRAME];
    take(&frames[body * FRAME..][..FRAME], lane, &mut numbers);
    Frame::read(&numbers)
}

/// What a sensor reads, as fields of the observation: an image or scan is one, other numbers are one per quantity.
fn fields(config: &SensorConfig) -> Vec<Field> {
    let (channels, about) = (config.model.channels(), format!("read by the sensor '{}'", config.name));
    let [low, high] = config.model.bounds();
    let field = |name: String, size: usize, unit: &str, layout: FieldLayout| Field {
        name,
        size,
        unit: unit.into(),
        meaning: about.clone(),
        low,
        high,
        smoothness: Smoothness::NonSmooth,
        layout,
    };
    let whole = match config.model.layout() {
        sensors::ReadingLayout::Vector => {
            let mut fields: Vec<Field> = Vec::new();
            for (name, unit) in &channels {
                let name = format!("{}.{}", config.name, quantity(name));
                match fields.last_mut() {
                    Some(last) if last.name == name => last.size += 1,
                    _ => fields.push(field(name, 1, unit, FieldLayout::Vector)),
                }
            }
            return fields;
        }
        sensors::ReadingLayout::Image { height, width, channels } => FieldLayout::Image { height, width, channels },
        sensors::ReadingLayout::Lidar { rows, columns } => FieldLayout::Lidar { rows, columns },
    };
    vec![field(config.name.clone(), channels.len(), channels.first().map_or("-", |c| c.1), whole)]
}

/// `accelerometer` of `accelerometer_x`.
fn quantity(channel: &str) -> &str {
    match channel.rsplit_once('_') {
        Some((name, "w" | "x" | "y" | "z")) => name,
        _ => channel,
    }
}

impl Stepper<'_> {
    /// Keeps where bodies are before a step, as accelerations are means over it; and slopes in it, if it is recorded.
    pub(crate) fn keep_frames(&mut self, records: bool) {
        if self.work.senses.is_none() {
            return;
        }
        self.find_frames(u64::MAX);
        let frames = self.core.layout.work.frames.of(&self.work.rows);
        if let Some(senses) = &mut self.work.senses {
            senses.records = records;
            senses.before.copy_from_slice(frames);
        }
        self.estimate_anew();
    }

    /// Reads the sensors of these lanes behind a step, and lets filters take in what is read.
    pub(crate) fn sense_after(&mut self, lanes: u64) {
        let core = self.core;
        let (Some(sensing), Some(senses)) = (&core.sensing, &mut self.work.senses) else { return };
        let frames = core.layout.work.frames.of(&self.work.rows);
        for lane in lanes_of(lanes) {
            let gravity = core.gravity(self.block, lane);
            for body in &sensing.carriers {
                let (before, after) = (frame(&senses.before, *body, lane), frame(frames, *body, lane));
                senses.truths[*body] = GroundTruth::between(&before, &after, sensing.dt, gravity);
            }
            sensing.read(core, self.block, senses, frames, lane);
        }
        self.estimate_after(lanes);
    }

    /// Begins an episode of the sensors of these lanes, and reads them at rest in its first state: with the accelerations of a
    /// step in which rotors hold their speeds.
    pub(crate) fn sense_first(&mut self, lanes: u64) {
        let core = self.core;
        let Some(sensing) = &core.sensing else { return };
        self.find_frames(lanes);
        for lane in lanes_of(lanes) {
            self.look_around(lane);
            let [seed, environment, episode] = self.key(lane);
            let Some(senses) = &mut self.work.senses else { return };
            let frames = core.layout.work.frames.of(&self.work.rows);
            // no gradient goes back over a beginning
            senses.records = false;
            let theta = if core.varied.is_empty() { &[] } else { &senses.numbers[..] };
            core.parametric_plant.step(&senses.state, &core.hover_input, theta, &mut senses.next);
            core.parametric_plant.write_frames(&senses.numbers, &senses.next, &mut senses.frames);
            let (dt, gravity) = (core.parametric_plant.physics().dt, senses.numbers[0]);
            for body in &sensing.carriers {
                let now = frame(frames, *body, lane);
                let next = Frame::read(&senses.frames[body * FRAME..][..FRAME]);
                senses.truths[*body] = GroundTruth::ahead(&now, &next, dt, gravity);
            }
            let own = &mut self.block.sensors[lane];
            own.sets.iter_mut().for_each(|set| set.reset(seed, environment, episode));
            sensing.read(core, self.block, senses, frames, lane);
        }
        self.estimate_first(lanes);
    }

    /// Finds out anew what stands around one environment: where an episode began, its goal changed, or it was loaded. From what
    /// a block holds and not from what was drawn, so that a restored environment sees the same bits.
    pub(crate) fn look_around(&mut self, lane: usize) {
        let core = self.core;
        let (Some(sensing), Some(senses)) = (&core.sensing, &mut self.work.senses) else { return };
        take(&self.block.plant.rows, lane, &mut senses.state);
        take(core.layout.kept.goal.of(&self.block.kept), lane, &mut senses.goal);
        core.numbers_of(self.block, lane, &mut senses.numbers);
        let SensorScratch { numbers, goal, placement, .. } = senses;
        sensing.around.place(numbers, placement, |own| core.task.place_scene(goal, own));
        // as many solids as were taken when the environment was made
        let _ = self.block.sensors[lane].world.fill(&sensing.around.scene, placement);
    }
}

impl Env {
    /// Finds out anew what stands around every environment.
    pub(crate) fn look_around(&mut self) {
        if self.core.sensing.is_none() {
            return;
        }
        let (core, mut own) = (&self.core, self.core.workspace());
        for (i, block) in self.blocks.iter_mut().enumerate() {
            let (work, first) = (&mut own, i * BLOCK);
            let mut stepper = Stepper::new(core, block, work, first, &[]);
            (0..stepper.n()).for_each(|lane| stepper.look_around(lane));
        }
    }
}

impl EnvBlock {
    /// What one environment's sensors read, into its rows.
    fn keep_readings(&mut self, core: &Core, lane: usize) {
        let n = core.sizes.reading;
        let readings = core.layout.kept.readings.of_mut(&mut self.kept);
        for (agent, set) in self.sensors[lane].sets.iter().enumerate() {
            let rows = &mut readings[agent * n..][..n];
            rows.iter_mut().zip(set.readings()).for_each(|(row, x)| row[lane] = *x as f32);
        }
    }
}

impl Core {
    /// All physical numbers of one environment.
    fn numbers_of(&self, block: &EnvBlock, lane: usize, numbers: &mut [f64]) {
        numbers.copy_from_slice(&self.nominal);
        for (row, k) in self.layout.kept.theta.of(&block.kept).iter().zip(&self.varied) {
            numbers[*k] = f64::from(row[lane]);
        }
    }

    /// That of one environment, m/s².
    fn gravity(&self, block: &EnvBlock, lane: usize) -> f64 {
        match self.varied.first() {
            Some(0) => f64::from(self.layout.kept.theta.of(&block.kept)[0][lane]),
            _ => self.nominal[0],
        }
    }
}
