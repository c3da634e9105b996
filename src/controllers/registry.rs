//! Which controller flies what: one row per controller, the first that suits a plant is its default.

use super::cascade::Rates;
use super::cascade_law::{CascadeLaw, with_drag_of};
use super::controller::Controller;
use super::fault_tolerant::FaultTolerant;
use super::filter::FilterSettings;
use super::formation::FormationController;
use super::hover_feedback::{HoverFeedback, HoverWeights};
use super::indi::IndiLaw;
use super::law::LawController;
use super::locked_joints::LockedJoints;
use super::optimal::{Mpc, MpcSettings, PlannedIndi};
use super::platform_controller::{self, PlatformController, is_platform};
use super::start::free;
use super::state_feedback::{Lqr, LqrWeights, suits};
use super::transport_controller::{TiltLimits, TransportController, is_transport};
use super::vectored::{Vectored, vectored};
use base::error::{Error, Result};
use dynamics::tree::{Model, Multibody};
use dynamics::{Gains, Multirotor, Plant, Vehicle, gains};

/// What a controller is built with.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Without, they are derived from what the controller flies.
    pub gains: Option<&'a Gains>,
    /// How often each level computes.
    pub rates: &'a Rates,
    /// A drone of the plant, where its loops are to be as swift as short episodes need: twice as fast as the derived ones.
    pub swift: Option<&'a Vehicle>,
    /// How `mpc` plans; without, as suits the plant.
    pub mpc: Option<&'a MpcSettings>,
    /// Of the measured angular velocity, first to last; of `cascade` alone.
    pub filters: &'a [FilterSettings],
}

impl<'a> Setup<'a> {
    /// With given gains or derived ones.
    pub fn new(gains: Option<&'a Gains>, rates: &'a Rates) -> Self {
        Self { gains, rates, swift: None, mpc: None, filters: &[] }
    }
}

/// One controller.
pub struct ControllerEntry {
    /// As on the command line.
    pub name: &'static str,
    /// What it flies, in words.
    pub flies: &'static str,
    /// What of it can be tuned, in words.
    pub tunes: &'static str,
    /// Whether it is straight-line, so that it runs in batches and is differentiated.
    pub is_batched: bool,
    /// Whether it is made for such a plant.
    suits: fn(&Plant) -> bool,
    /// Whether the next that suits takes over where it cannot be built.
    may_fail: bool,
    build: fn(&Plant, &Setup<'_>) -> Result<Box<dyn Controller>>,
}

impl ControllerEntry {
    /// Whether it is made for such a plant.
    pub fn suits(&self, plant: &Plant) -> bool {
        (self.suits)(plant)
    }

    /// The controller for a plant that is believed to be so.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant that it is not made for; as the controller.
    pub fn build(&self, plant: &Plant, setup: &Setup<'_>) -> Result<Box<dyn Controller>> {
        if !setup.filters.is_empty() && self.name != "cascade" {
            let what = format!("filters with controller '{}'", self.name);
            let value = setup.filters.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
            let remedy = "Leave them out, or fly one vehicle with controller 'cascade'.";
            return Err(Error::value(what, value, "none: the cascade of one vehicle alone has filters", remedy));
        }
        if self.suits(plant) {
            return (self.build)(plant, setup);
        }
        let what = format!("controller '{}' for '{}'", self.name, plant.name());
        let others = REGISTRY.iter().filter(|entry| entry.suits(plant)).map(|entry| entry.name);
        let remedy = format!("Leave it out, or take one that flies it: {}.", others.collect::<Vec<_>>().join(", "));
        Err(Error::value(what, "of another make", self.flies, remedy))
    }
}

/// All controllers, the most special first.
pub const REGISTRY: [ControllerEntry; 12] = [
    ControllerEntry {
        name: "cascade",
        flies: "one rigid vehicle",
        tunes: "12 gains, 2 rates of integral action",
        is_batched: true,
        suits: |plant| plant.tree().is_none(),
        may_fail: false,
        build: |plant, setup| {
            let vehicle = rigid(plant)?;
            let gains = setup.gains.copied().unwrap_or_else(|| vehicle.vehicle().gains());
            let law = CascadeLaw::new(vehicle.vehicle(), plant.physics(), &gains, setup.rates)?;
            Ok(Box::new(law.with_filters(setup.filters)?.running()))
        },
    },
    ControllerEntry {
        name: "fault_tolerant",
        flies: "one rigid vehicle that may lose rotors",
        tunes: "12 gains",
        is_batched: false,
        suits: |plant| plant.tree().is_none(),
        may_fail: false,
        build: |plant, setup| {
            let (vehicle, physics) = (rigid(plant)?.vehicle(), plant.physics());
            let gains = setup.gains.copied().unwrap_or_else(|| vehicle.gains());
            let believed = with_drag_of(vehicle, physics.effects);
            Ok(Box::new(FaultTolerant::new(&believed, &gains, setup.rates, physics.dt)?))
        },
    },
    ControllerEntry {
        name: "indi",
        flies: "one rigid vehicle, at the limits of its rotors",
        tunes: "12 gains",
        is_batched: false,
        suits: |plant| plant.tree().is_none(),
        may_fail: false,
        build: |plant, setup| {
            let vehicle = rigid(plant)?.vehicle();
            let gains = setup.gains.copied().unwrap_or_else(|| vehicle.gains());
            Ok(Box::new(LawController::of(IndiLaw::new(vehicle, plant.physics(), &gains, setup.rates)?)))
        },
    },
    ControllerEntry {
        name: "vectored",
        flies: "machines whose rotors all sit on tilting servos",
        tunes: "12 gains",
        is_batched: false,
        suits: |plant| plant.tree().is_some_and(|m| vectored(m.model())),
        may_fail: false,
        build: |plant, setup| Ok(Box::new(Vectored::new(tree(plant)?, setup.gains, setup.rates)?)),
    },
    ControllerEntry {
        name: "frozen",
        flies: "other machines with servos, which it holds at rest",
        tunes: "12 gains",
        is_batched: false,
        suits: |plant| plant.tree().is_some_and(|m| has_servos(m.model())),
        may_fail: false,
        build: |plant, setup| Ok(Box::new(LockedJoints::new(tree(plant)?, setup.gains, setup.rates)?)),
    },
    ControllerEntry {
        name: "lqi",
        flies: "one rigid vehicle, about hover",
        tunes: "9 weights",
        is_batched: true,
        suits: |plant| plant.tree().is_none(),
        may_fail: false,
        build: |plant, setup| {
            Ok(Box::new(LawController::of(HoverFeedback::lqi(plant, setup.rates, &HoverWeights::default())?)))
        },
    },
    ControllerEntry {
        name: "lqr",
        flies: "one drone with one chain of passive joints; one rigid vehicle, about hover",
        tunes: "5 weights, 12 gains of the levels inside; of a rigid vehicle 7 weights",
        is_batched: false,
        suits: |plant| plant.tree().is_none_or(|m| suits(m.model())),
        may_fail: true,
        build: |plant, setup| {
            let Some(system) = plant.tree() else {
                return Ok(Box::new(LawController::of(HoverFeedback::lqr(
                    plant,
                    setup.rates,
                    &HoverWeights::default(),
                )?)));
            };
            let Some(vehicle) = setup.swift else { return Ok(Box::new(Lqr::new(system, setup.gains, setup.rates)?)) };
            let standing = system.model().bodies().iter().skip(1).any(|b| b.center_of_mass[2] > 0.0);
            let weights = if standing { STANDING } else { LqrWeights::default() };
            Ok(Box::new(Lqr::with_weights(system, Some(&swift(vehicle, 2.0)), setup.rates, &weights)?))
        },
    },
    ControllerEntry {
        name: "platform",
        flies: "a frame under drones on cardan joints",
        tunes: "12 gains: position and velocity of the frame, attitude and rate of the drones",
        is_batched: false,
        suits: |plant| plant.tree().is_some_and(|m| is_platform(m.model())),
        may_fail: false,
        build: |plant, setup| {
            let system = tree(plant)?;
            let gains = setup.swift.map(|vehicle| {
                let mut gains = swift(vehicle, 2.3);
                let pole = gains.position[0].sqrt() * gains::SEPARATION / SEPARATION_OF_FRAMES;
                (gains.position, gains.velocity) = ([pole * pole; 3], [2.0 * pole; 3]);
                gains
            });
            Ok(Box::new(PlatformController::new(system, gains.as_ref().or(setup.gains), setup.rates)?))
        },
    },
    ControllerEntry {
        name: "transport",
        flies: "a load under drones on bars",
        tunes: "12 gains: attitude and rate of the drones",
        is_batched: false,
        suits: |plant| plant.tree().is_some_and(|m| is_transport(m.model())),
        may_fail: false,
        build: |plant, setup| {
            let tilt_limits = if setup.swift.is_some() { TiltLimits::STEEP } else { TiltLimits::default() };
            Ok(Box::new(TransportController::with_tilt_limits(tree(plant)?, setup.gains, setup.rates, tilt_limits)?))
        },
    },
    ControllerEntry {
        name: "formation",
        flies: "everything else, by its drones",
        tunes: "12 gains per drone",
        is_batched: true,
        suits: |plant| plant.tree().is_some_and(|m| !m.model().drones().is_empty()),
        may_fail: false,
        build: |plant, setup| Ok(Box::new(FormationController::new(tree(plant)?, setup.gains, setup.rates)?)),
    },
    ControllerEntry {
        name: "mpc",
        flies: "one vehicle, or one tree of bodies that floats, by planning ahead",
        tunes: "15 weights",
        is_batched: false,
        suits: |plant| plant.tree().is_none_or(|m| free(m.model()).is_ok() && !m.model().rotors().is_empty()),
        may_fail: false,
        build: |plant, setup| {
            let settings = setup.mpc.cloned().unwrap_or_else(|| MpcSettings::for_plant(plant));
            let fallback = default_controller(plant, setup)?;
            Ok(Box::new(Mpc::new(plant, &settings)?.with_fallback(fallback)))
        },
    },
    ControllerEntry {
        name: "mpc_indi",
        flies: "one rigid vehicle, by planning ahead, whatever turns it beside its rotors",
        tunes: "15 weights",
        is_batched: false,
        suits: |plant| plant.tree().is_none(),
        may_fail: false,
        build: |plant, setup| {
            let settings = setup.mpc.cloned().unwrap_or_else(|| MpcSettings::for_plant(plant));
            let fallback = default_controller(plant, setup)?;
            Ok(Box::new(PlannedIndi::new(plant, &settings, setup.rates)?.with_fallback(fallback)))
        },
    },
];

/// A load that stands is led gently: it has to lean before it can follow.
const STANDING: LqrWeights =
    LqrWeights { position: 0.7, swing: 4.0, acceleration: 4.0, preview: Some(0.0), reach: 0.4 };
/// A little more than the platform asks for.
const SEPARATION_OF_FRAMES: f64 = 1.01 * platform_controller::SEPARATION;

/// [`Vehicle::derived_gains`] with all poles `factor` times as fast.
#[doc(hidden)]
pub fn swift(vehicle: &Vehicle, factor: f64) -> Gains {
    let derived = vehicle.derived_gains();
    let [once, twice] = [factor, factor * factor];
    Gains {
        position: derived.position.map(|k| k * twice),
        velocity: derived.velocity.map(|k| k * once),
        attitude: derived.attitude.map(|k| k * twice),
        rate: derived.rate.map(|k| k * once),
        integral: derived.integral.map(|l| l * once),
    }
}

fn rigid(plant: &Plant) -> Result<&Multirotor> {
    match plant {
        Plant::Rigid(m) => Ok(m),
        Plant::Tree(_) => Err(of_another_make(plant, "one rigid vehicle")),
    }
}

fn tree(plant: &Plant) -> Result<&Multibody> {
    plant.tree().ok_or_else(|| of_another_make(plant, "articulated"))
}

fn of_another_make(plant: &Plant, rule: &str) -> Error {
    Error::value(format!("plant '{}'", plant.name()), "of another make", rule, "Choose another controller.")
}

/// The controller of a name for a plant.
///
/// # Errors
/// [`Error::Unknown`] with the nearest name; as [`ControllerEntry::build`].
pub fn controller(name: &str, plant: &Plant, setup: &Setup<'_>) -> Result<Box<dyn Controller>> {
    let entry = REGISTRY.iter().find(|entry| entry.name == name).ok_or_else(|| Error::Unknown {
        kind: "controller",
        name: name.into(),
        known: REGISTRY.map(|entry| entry.name.to_string()).into(),
    })?;
    entry.build(plant, setup)
}

/// The controller that suits a plant by its make: the first of [`REGISTRY`] that is made for it.
///
/// # Errors
/// [`Error::Value`] for a model that nothing lifts, that is fixed to the world, or whose drones nobody steers; otherwise as
/// the controllers.
pub fn default_controller(plant: &Plant, setup: &Setup<'_>) -> Result<Box<dyn Controller>> {
    if let Some(system) = plant.tree() {
        flyable(system.model())?;
    }
    for entry in REGISTRY.iter().filter(|entry| entry.suits(plant)) {
        match entry.build(plant, setup) {
            Err(_) if entry.may_fail && setup.swift.is_none() => {}
            built => return built,
        }
    }
    Err(of_another_make(plant, "flown by a controller of the registry"))
}

/// Refuses models that no controller steers.
fn flyable(model: &Model) -> Result<()> {
    free(model)?;
    if model.drones().is_empty() {
        let what = format!("model '{}': number of drones", model.name());
        return Err(Error::value(what, 0, "≥ 1 to fly", "Drop it instead."));
    }
    if !steerable(model) {
        let what = format!("model '{}': drones", model.name());
        let rule = "on the root, or without servos between them";
        return Err(Error::value(what, "on gimbals along a chain", rule, "Nobody steers it yet: drop it instead."));
    }
    Ok(())
}

fn has_servos(model: &Model) -> bool {
    model.bodies().iter().any(|b| b.joint.drive.is_some())
}

/// Whether there is a controller: drones that sit on servos, away from the root, have none unless all their rotors tilt.
pub fn steerable(model: &Model) -> bool {
    !model.drones().is_empty() && (!has_servos(model) || vectored(model) || model.drones().iter().all(|d| d.body == 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynamics::{Physics, configurations, vehicles};

    #[test]
    fn every_plant_that_can_be_flown_has_a_controller_that_says_whether_it_is_batched() {
        let physics = Physics::default();
        let mut plants: Vec<Plant> = vec![Plant::of_vehicle(&vehicles::by_name("firefly").unwrap(), physics).unwrap()];
        for name in configurations::names() {
            let model = configurations::by_name(name).unwrap();
            if steerable(&model) && free(&model).is_ok() {
                plants.push(Plant::of_model(&model, physics).unwrap());
            }
        }
        for plant in plants {
            let own = default_controller(&plant, &Setup::new(None, &Rates::default())).unwrap();
            let entry = REGISTRY.iter().find(|e| e.suits(&plant)).unwrap();
            println!("{}: {} ({})", plant.name(), own.name(), entry.name);
            assert_eq!(own.is_batched(), entry.is_batched, "{}", plant.name());
            assert_eq!(own.recorded(&plant).unwrap().is_some(), entry.is_batched);
        }
    }
}
