//! Sensors on the bodies of a plant, read from its states.

use super::cast::RayScene;
use super::contact::check_contact;
use super::solids::{Solids, Surroundings};
use super::{GroundTruth, RayScratch, SensorConfig, SensorContext, SensorModel, SensorSet};
use crate::frame::{FRAME, Frame};
use crate::plant::{Plant, Quantity};
use crate::scene::Scene;
use crate::tree::contact_forces;
use base::error::Result;

/// A [`SensorSet`] that finds the truth in the states of a [`Plant`].
#[derive(Debug, Clone)]
pub struct OnboardSensors {
    plant: Plant,
    /// The plant's physical numbers; gravity is the first.
    parameters: Vec<f64>,
    set: SensorSet,
    /// Of every body, as `Plant::write_frames` writes them: of the state now, and of that beside it.
    now: Vec<f64>,
    beside: Vec<f64>,
    truths: Vec<GroundTruth>,
    world: RayScene,
    solids: Solids,
    eyes: RayScratch,
    /// Whether forces of contact are read.
    feels: bool,
    is_first: bool,
}

impl OnboardSensors {
    /// Sensors on the bodies that [`Plant::body_names`] lists, at the beginning of episode 0 of environment 0 of seed 0. They
    /// see the plant's ground, what stands still in it, and the shapes of all bodies but their own.
    ///
    /// # Errors
    /// As [`SensorSet::new`] and [`RayScene::fill`]; [`Error::Value`](base::error::Error::Value) for a sensor of contact where nothing touches.
    pub fn new(configs: &[SensorConfig], plant: &Plant) -> Result<Self> {
        let set = SensorSet::new(configs, plant.physics().dt, &plant.body_names())?;
        let (plant, parameters) = (plant.clone(), plant.parameters());
        let frames = vec![0.0; FRAME * plant.n_frame()];
        let truths = Vec::with_capacity(plant.n_frame());
        let scene = Surroundings::of(&Scene { ground: ground(&plant), ..Scene::default() }, &plant).scene;
        let mut world = RayScene::default();
        world.fill(&scene, &scene.nominal_placement())?;
        let touching = || configs.iter().filter(|config| matches!(config.model, SensorModel::Contact(_)));
        touching().try_for_each(|config| check_contact(&config.place(), &plant))?;
        let (solids, eyes, feels) = (Solids::of(&plant), RayScratch::default(), touching().next().is_some());
        let (now, beside) = (frames.clone(), frames);
        Ok(Self { plant, parameters, set, now, beside, truths, world, solids, eyes, feels, is_first: true })
    }

    /// Begins an episode.
    pub fn reset(&mut self, seed: u64, environment: u64, episode: u64) {
        self.set.reset(seed, environment, episode);
        self.is_first = true;
    }

    /// Reads all in `state`. Accelerations are means over the step from the state read before; of the first of an episode, over
    /// the step to `next`.
    ///
    /// # Panics
    /// On states of another length than the plant's.
    pub fn read(&mut self, state: &[f64], next: &[f64]) -> &[f64] {
        if self.set.sensors().is_empty() {
            return &[];
        }
        std::mem::swap(&mut self.now, &mut self.beside);
        self.plant.write_frames(&self.parameters, state, &mut self.now);
        let truth = if self.is_first {
            self.plant.write_frames(&self.parameters, next, &mut self.beside);
            GroundTruth::ahead
        } else {
            after
        };
        let (dt, gravity) = (self.plant.physics().dt, self.parameters[0]);
        let pairs = self.now.chunks_exact(FRAME).zip(self.beside.chunks_exact(FRAME));
        self.truths.clear();
        self.truths.extend(pairs.map(|(now, beside)| truth(&frame(now), &frame(beside), dt, gravity)));
        self.is_first = false;
        if let Some(system) = self.plant.tree().filter(|_| self.feels) {
            let forces = contact_forces(system, state);
            self.truths.iter_mut().zip(forces).for_each(|(truth, force)| truth.contact_force = force);
        }
        let now = &self.now;
        let solids = self.solids.at(|body| frame(&now[body * FRAME..]));
        self.set.step(&self.truths, &mut SensorContext::new(&mut self.world, solids, &mut self.eyes))
    }

    /// What was read last, in the order of the [`channels`](Self::channels).
    pub fn readings(&self) -> &[f64] {
        self.set.readings()
    }

    /// The sensors.
    pub fn set(&self) -> &SensorSet {
        &self.set
    }

    /// Names and units of all readings, in order.
    pub fn channels(&self) -> Vec<Quantity> {
        self.set.channels()
    }
}

/// Height of the plane that a plant touches, m; a vehicle that touches nothing flies over one at z = 0.
fn ground(plant: &Plant) -> Option<f64> {
    plant.tree().map_or(Some(0.0), |own| own.model().parts().contact.ground)
}

/// [`GroundTruth::between`], the later frame first.
fn after(now: &Frame<f64>, before: &Frame<f64>, dt: f64, gravity: f64) -> GroundTruth {
    GroundTruth::between(before, now, dt, gravity)
}

/// From 13 numbers.
fn frame(numbers: &[f64]) -> Frame<f64> {
    Frame::read(numbers)
}
