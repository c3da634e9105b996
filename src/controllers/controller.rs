//! What a controller is: a measurement and a target in, commands out, once per tick.

use super::attitude::Orientation;
use super::cascade::RateDivisors;
use super::filter::FilterSettings;
use super::kinematics::Kinematics;
use super::reference::{Reference, Setpoint, Tilt};
use super::written_law::RecordedLaw;
use autodiff::System;
use base::error::Result;
use dynamics::Plant;
use flight::Commanded;

/// What a controller may see.
#[derive(Debug, Clone, Copy)]
pub struct Measurement<'a> {
    /// Time since the start, s.
    pub time: f64,
    /// State of the whole plant, `[n_state]`, in its layout: the truth, unless a [`ClosedLoop`](super::ClosedLoop) puts something
    /// between.
    pub state: &'a [f64],
    /// What the sensors of the loop read, in the order of their channels; empty without any.
    pub readings: &'a [f64],
}

/// What a controller is to do: all of the reference, so that it may look ahead.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// What to track.
    pub reference: &'a Reference,
    /// Roll and pitch to hold beside it.
    pub tilt: &'a Tilt,
}

impl<'a> Target<'a> {
    /// A reference, level.
    pub fn level(reference: &'a Reference) -> Self {
        Self { reference, tilt: &Tilt::LEVEL }
    }

    /// The reference at a time, s.
    pub fn sample(&self, time: f64) -> Setpoint<f64> {
        self.reference.sample(time)
    }

    /// The wanted attitude at a time, s, for what holds it apart from the force.
    pub fn orientation(&self, time: f64) -> Orientation<f64> {
        self.tilt.orientation(self.reference, time)
    }
}

/// Something a controller says about itself after a flight.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// What.
    pub name: String,
    /// How much, with unit.
    pub value: String,
    /// The rest.
    pub note: String,
}

impl Note {
    /// From its three parts.
    pub fn new(name: impl Into<String>, value: impl Into<String>, note: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into(), note: note.into() }
    }
}

/// A controller of a [`Plant`] in `f64`, with its memory.
///
/// One that is written without branches on values is better written as a [`ControlLaw`](super::ControlLaw), which
/// [`LawController`](super::LawController) makes a controller: it can then also be differentiated and run in batches. Those with a
/// solver inside implement this trait alone.
pub trait Controller: Send {
    /// One word.
    fn name(&self) -> &str;
    /// What it does, for tables.
    fn description(&self) -> String {
        String::new()
    }
    /// How often it ticks, Hz; must divide 1/dt. `None`: in every step. Between ticks its commands are held.
    fn rate(&self) -> Option<f64> {
        None
    }
    /// The schedule of its levels, where it was built for one.
    fn schedule(&self) -> Option<RateDivisors> {
        None
    }
    /// Filters of the measured angular velocity that it was built with; by default none.
    fn filters(&self) -> &[FilterSettings] {
        &[]
    }
    /// Whether it holds a [`Tilt`] beside the reference.
    fn holds_tilt(&self) -> bool {
        false
    }
    /// What follows the reference: by default the root of the plant.
    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        Kinematics::read(state)
    }
    /// Refuses a plant that it is not made for; by default it takes any.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) that names both.
    fn check_plant(&self, _plant: &Plant) -> Result<()> {
        Ok(())
    }
    /// Forgets: the next tick is the first.
    fn reset(&mut self);
    /// Writes rotor actions and drive commands, in [−1, 1], at their places in the plant's input, `[n_input]`.
    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]);
    /// Learns what is left of each rotor, `[n_rotor]`, 0 to 1, 1 for whole ones. A controller that knows no failures flies on as
    /// before.
    ///
    /// # Errors
    /// As the allocation of what is left.
    fn tell(&mut self, _effectiveness: &[f64]) -> Result<()> {
        Ok(())
    }
    /// Whether its commands depend on earlier ticks, and not on time, state and target alone.
    fn remembers(&self) -> bool {
        true
    }
    /// Its memory as a flat vector, where it has such a form.
    fn memory(&self) -> &[f64] {
        &[]
    }
    /// What its levels asked of the next ones in the last tick; `None` for one without such levels.
    fn commanded(&self) -> Option<Commanded> {
        None
    }
    /// Whether it runs in batches: it is straight-line, without a solver inside.
    fn is_batched(&self) -> bool {
        false
    }
    /// Its form for a plant that runs on any scalar, behind one type; `None` for one that is no law.
    ///
    /// # Errors
    /// [`Error::Limit`](base::error::Error::Limit) where the recording is too large.
    fn recorded(&self, _plant: &Plant) -> Result<Option<RecordedLaw>> {
        Ok(None)
    }
    /// Why it has no such form, in words that go on after its name.
    #[doc(hidden)]
    fn why_no_law(&self) -> &'static str {
        "a program that branches on what it meets"
    }
    /// How it fared, for tables.
    fn notes(&self) -> Vec<Note> {
        Vec::new()
    }
}

/// Methods that say what the value inside says.
macro_rules! forward {
    ($inner:expr; $(fn $name:ident(&$($own:ident)+ $(, $argument:ident: $kind:ty)*) $(-> $out:ty)?;)*) => {$(
        fn $name(&$($own)+ $(, $argument: $kind)*) $(-> $out)? {
            $inner.$name($($argument),*)
        }
    )*};
}
pub(super) use forward;

/// Whoever holds a controller is one.
macro_rules! delegate {
    ($($holder:ty),*) => {$(
        impl<C: Controller + ?Sized> Controller for $holder {
            forward! { (**self);
                fn name(&self) -> &str;
                fn description(&self) -> String;
                fn rate(&self) -> Option<f64>;
                fn schedule(&self) -> Option<RateDivisors>;
                fn filters(&self) -> &[FilterSettings];
                fn holds_tilt(&self) -> bool;
                fn tracked(&self, state: &[f64]) -> Kinematics<f64>;
                fn check_plant(&self, plant: &Plant) -> Result<()>;
                fn reset(&mut self);
                fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]);
                fn tell(&mut self, effectiveness: &[f64]) -> Result<()>;
                fn remembers(&self) -> bool;
                fn memory(&self) -> &[f64];
                fn commanded(&self) -> Option<Commanded>;
                fn is_batched(&self) -> bool;
                fn recorded(&self, plant: &Plant) -> Result<Option<RecordedLaw>>;
                fn why_no_law(&self) -> &'static str;
                fn notes(&self) -> Vec<Note>;
            }
        }
    )*};
}

delegate!(&mut C, Box<C>);

/// Rotors idle and servos rest.
#[derive(Debug, Clone)]
pub struct Passive {
    rest: Vec<f64>,
}

impl Passive {
    /// For a plant.
    pub fn new(plant: &Plant) -> Self {
        let mut rest = vec![0.0; plant.n_input()];
        plant.rotor_places().iter().for_each(|rotor| rest[rotor.action] = -1.0);
        Self { rest }
    }
}

impl Controller for Passive {
    fn name(&self) -> &str {
        "none"
    }

    fn why_no_law(&self) -> &'static str {
        "nothing: its commands are constants"
    }

    fn description(&self) -> String {
        "rotors idle, servos rest".into()
    }

    fn reset(&mut self) {}

    fn tick(&mut self, _: Measurement<'_>, _: Target<'_>, commands: &mut [f64]) {
        commands.copy_from_slice(&self.rest);
    }
}
