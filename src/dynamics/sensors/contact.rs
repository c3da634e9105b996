//! What touches the body that carries it.

use super::chain::{ErrorModel, Errors};
use super::context::SensorContext;
use super::device::{Device, KindSettings};
use super::limits::within;
use super::mount::Motion;
use crate::plant::Plant;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};

with_defaults! {
    /// Net force of all contacts on its body at the end of the step, N, mount axes; `touching` is 1 where it exceeds `threshold`, by
    /// itself, before errors.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Contact {
        /// N.
        pub threshold: f64 = 0.01,
        /// u is N.
        pub error: ErrorModel = ErrorModel::default(),
    }
}

impl KindSettings for Contact {
    const CHANNELS: &[(&'static str, &'static str)] =
        &[("force_x", "N"), ("force_y", "N"), ("force_z", "N"), ("touching", "-")];

    fn validate(&self, what: &str) -> Result<()> {
        within(&format!("{what}: threshold"), self.threshold, 0.0, 1e6)?;
        self.error.validate(&format!("{what}: error"), 3)
    }
}

/// Refuses a sensor of contact on a plant that touches nothing.
pub fn check_contact(place: &str, plant: &Plant) -> Result<()> {
    if plant.tree().is_some() && plant.physics().effects.contact {
        return Ok(());
    }
    let remedy = "Switch the effect contact on, of a vehicle alone with a scene, or take the sensor away.";
    Err(Error::value(place, "kind contact", "a plant with the effect contact", remedy))
}

#[derive(Debug, Clone)]
pub(crate) struct ContactDevice {
    threshold: f64,
    errors: Errors<3>,
}

impl ContactDevice {
    pub(crate) fn new(settings: &Contact, between: f64) -> Result<Self> {
        Ok(Self { threshold: settings.threshold, errors: Errors::new(&settings.error, between) })
    }
}

impl Device for ContactDevice {
    fn draw(&mut self, stream: &mut Stream) {
        self.errors.draw(stream);
    }

    fn sample(&mut self, at: &Motion, _: &mut SensorContext<'_>, stream: &mut Stream, out: &mut [f64]) {
        let force = at.contact_force;
        let size = force.iter().map(|f| f * f).sum::<f64>().sqrt();
        out[..3].copy_from_slice(&self.errors.apply(force, stream));
        out[3] = f64::from(u8::from(size > self.threshold));
    }

    fn each(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        self.errors.each(visit);
    }
}
