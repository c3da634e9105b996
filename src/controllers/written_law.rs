//! Laws that are data: one tick, recorded for a plant as it was written, and computed again over any scalar.
//!
//! A [`WrittenLaw`] is made of a closure that is called once, with numbers that record: where what commands is not known when this
//! crate is compiled, as a function of another language. A [`RecordedLaw`] is any other law in the same form: one type for all of them.
//!
//! Recordings are as written ([`Recording::as_written`]), so that a loop around one records what it would around the law itself: lanes,
//! gradients and margins have the same bits. Flights in `f64` run a tick as a program of its own.

use super::cascade::RateDivisors;
use super::closed_loop::command_places;
use super::controller::{Target, forward};
use super::filter::FilterSettings;
use super::kinematics::Kinematics;
use super::law::{ControlLaw, LawInput};
use super::reference::Setpoint;
use autodiff::program::Workspace;
use autodiff::trace::{Recording, Walk};
use autodiff::{Program, Scalar, System, Trace};
use base::error::{Error, Result};
use dynamics::Plant;
use flight::Commanded;
use std::fmt;
use std::sync::Arc;

/// A tick as it was written.
#[derive(Debug)]
struct WrittenTick {
    /// State, target, ticks, parameters and memory in; memory and commands out.
    recording: Recording,
    /// Of the same.
    program: Program,
    /// How many numbers each of the five has.
    sizes: [usize; 5],
    /// Where commands stand in the plant's input.
    places: Vec<usize>,
    n_input: usize,
}

/// Five slices, one behind the other.
fn cut<'z, S>(mut z: &'z [S], sizes: &[usize; 5]) -> [&'z [S]; 5] {
    sizes.map(|n| {
        let (own, rest) = z.split_at(n);
        z = rest;
        own
    })
}

impl WrittenTick {
    /// Records `tick` for a plant: target, ticks, parameters and memory have these sizes.
    fn record<E: From<Error>>(
        plant: &Plant,
        sizes: [usize; 4],
        tick: impl FnOnce(&LawInput<'_, Trace>, &[Trace]) -> std::result::Result<Vec<Trace>, E>,
    ) -> std::result::Result<Self, E> {
        let [n_target, n_tick, n_parameter, n_memory] = sizes;
        let sizes = [plant.n_state(), n_target, n_tick, n_parameter, n_memory];
        let mut failed = None;
        let recording = Recording::as_written(sizes.iter().sum(), |z| {
            let [state, target, ticks, parameters, memory] = cut(z, &sizes);
            tick(&LawInput { state, target, ticks, parameters }, memory).unwrap_or_else(|error| {
                failed = Some(error);
                Vec::new()
            })
        });
        if let Some(error) = failed {
            return Err(error);
        }
        let program = Program::compile(&Recording::of(recording.n_input(), |z| {
            let mut results = vec![Trace::zero(); recording.n_output()];
            recording.evaluate(z, &mut results);
            results
        }))?;
        Ok(Self { recording, program, sizes, places: command_places(plant), n_input: plant.n_input() })
    }

    /// One tick, with `nominal` parameters where the input has none.
    fn tick<S: Scalar>(&self, nominal: &[f64], now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        let mut inputs = [now.state, now.target, now.ticks].concat();
        if now.parameters.is_empty() {
            inputs.extend(nominal.iter().map(|p| S::constant(*p)));
        } else {
            inputs.extend_from_slice(now.parameters);
        }
        inputs.extend_from_slice(memory);
        assert_eq!(inputs.len(), self.recording.n_input(), "state, target, ticks, parameters and memory of the law");
        let mut walk = Walk::new(&self.recording);
        walk.run(&mut |_, k| inputs[k]);
        for (k, own) in memory.iter_mut().enumerate() {
            *own = walk.output(k);
        }
        for (place, k) in self.places.iter().zip(memory.len()..) {
            commands[*place] = walk.output(k);
        }
    }

    /// Refuses a plant of other sizes than that it was recorded for.
    fn check(&self, name: &str, plant: &Plant) -> Result<()> {
        let (n, places) = (plant.n_state(), command_places(plant));
        if n == self.sizes[0] && places == self.places {
            return Ok(());
        }
        let told = |n_state: usize, n: usize| format!("{n_state} numbers of state and {n} commands");
        let what = format!("plant '{}' under controller '{name}'", plant.name());
        let rule = format!("{}, for which it was recorded", told(self.sizes[0], self.places.len()));
        Err(Error::value(what, told(n, places.len()), rule, "Record the controller for this plant."))
    }
}

/// A tick in `f64`, with its place to work.
#[doc(hidden)]
#[derive(Clone)]
pub struct CompiledTick {
    tick: Arc<WrittenTick>,
    nominal: Vec<f64>,
    inputs: Vec<f64>,
    results: Vec<f64>,
    /// Made in the first tick: whoever flies in lanes needs none.
    work: Option<Workspace>,
}

impl fmt::Debug for CompiledTick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CompiledTick({} instructions)", self.tick.program.len())
    }
}

impl CompiledTick {
    fn of(tick: &Arc<WrittenTick>, nominal: &[f64]) -> Self {
        let (inputs, results) = (Vec::new(), vec![0.0; tick.program.n_output()]);
        Self { tick: tick.clone(), nominal: nominal.to_vec(), inputs, results, work: None }
    }

    /// As [`ControlLaw::tick`], to the same bits.
    pub(super) fn tick(&mut self, now: &LawInput<'_, f64>, memory: &mut [f64], commands: &mut [f64]) {
        let Self { tick, nominal, inputs, results, work } = self;
        let parameters = if now.parameters.is_empty() { nominal } else { now.parameters };
        inputs.clear();
        [now.state, now.target, now.ticks, parameters, memory].iter().for_each(|own| inputs.extend_from_slice(own));
        tick.program.evaluate(work.get_or_insert_with(|| tick.program.workspace()), inputs, results);
        let (new, given) = results.split_at(memory.len());
        memory.copy_from_slice(new);
        tick.places.iter().zip(given).for_each(|(place, command)| commands[*place] = *command);
    }
}

/// Any straight-line law, recorded for a plant: one type for all of them, computed over any scalar as the law itself would be.
#[derive(Clone)]
pub struct RecordedLaw {
    law: Arc<dyn ControlLaw>,
    tick: Arc<WrittenTick>,
    parameters: Vec<f64>,
}

impl fmt::Debug for RecordedLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RecordedLaw('{}', {} instructions)", self.law.name(), self.len())
    }
}

impl RecordedLaw {
    /// Records a law, with these numbers in place of its parameters unless there are none.
    ///
    /// # Errors
    /// [`Error::Limit`] where the recording is too large; as [`ControlLaw::check_plant`].
    pub(super) fn of<L: ControlLaw>(law: Arc<L>, plant: &Plant, parameters: &[f64]) -> Result<Self> {
        law.check_plant(plant)?;
        let parameters = if parameters.is_empty() { law.parameters() } else { parameters.to_vec() };
        let sizes = [law.n_target(), law.n_tick(), parameters.len(), law.memory().len()];
        let tick = WrittenTick::record::<Error>(plant, sizes, |now, memory| {
            let (mut memory, mut commands) = (memory.to_vec(), vec![Trace::zero(); plant.n_input()]);
            law.tick(now, &mut memory, &mut commands);
            memory.extend(command_places(plant).into_iter().map(|k| commands[k]));
            Ok(memory)
        })?;
        Ok(Self { law, tick: Arc::new(tick), parameters })
    }

    /// A tick with its parameters as constants: state, target, ticks and memory in, memory and the plant's input out.
    #[doc(hidden)]
    pub fn recording(&self) -> Recording {
        let [n_state, n_target, n_tick, _, n_memory] = self.tick.sizes;
        let sizes = [n_state, n_target, n_tick, 0, n_memory];
        Recording::of(sizes.iter().sum(), |z| {
            let [state, target, ticks, parameters, memory] = cut(z, &sizes);
            let (mut memory, mut commands) = (memory.to_vec(), vec![Trace::zero(); self.tick.n_input]);
            self.tick(&LawInput { state, target, ticks, parameters }, &mut memory, &mut commands);
            memory.append(&mut commands);
            memory
        })
    }

    /// Instructions of one tick.
    pub fn len(&self) -> usize {
        self.tick.program.len()
    }

    /// Whether there is nothing to compute.
    pub fn is_empty(&self) -> bool {
        self.tick.program.is_empty()
    }
}

impl ControlLaw for RecordedLaw {
    forward! { self.law;
        fn name(&self) -> &str;
        fn description(&self) -> String;
        fn rate(&self) -> Option<f64>;
        fn is_batched(&self) -> bool;
        fn schedule(&self) -> Option<RateDivisors>;
        fn filters(&self) -> &[FilterSettings];
        fn tracked(&self, state: &[f64]) -> Kinematics<f64>;
        fn n_target(&self) -> usize;
        fn write_target(&self, target: Target<'_>, time: f64, row: &mut [f64]);
        fn n_tick(&self) -> usize;
        fn write_ticks(&self, tick: u64, ticks: &mut [f64]);
        fn memory(&self) -> Vec<f64>;
        fn commanded(&self, memory: &[f64]) -> Option<Commanded>;
        fn parameter_names(&self) -> Vec<String>;
    }

    fn parameters(&self) -> Vec<f64> {
        self.parameters.clone()
    }
    fn check_plant(&self, plant: &Plant) -> Result<()> {
        self.tick.check(self.name(), plant)
    }
    fn compiled(&self) -> Option<CompiledTick> {
        Some(CompiledTick::of(&self.tick, &self.parameters))
    }
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        self.tick.tick(&self.parameters, now, memory, commands);
    }
}

/// What a written law is beside its tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LawDescription {
    /// One word.
    pub name: String,
    /// What it does, for tables.
    pub description: String,
    /// How often it ticks, Hz; must divide 1/dt. `None`: in every step.
    pub rate: Option<f64>,
    /// How often each of its levels computes, Hz, each a whole part of how often it ticks: one number of [`LawInput::ticks`] each.
    pub levels: Vec<f64>,
    /// The memory before the first tick.
    pub memory: Vec<f64>,
    /// Numbers that may be tuned and differentiated, by their names.
    pub gains: Vec<(String, f64)>,
}

/// A law of one's own as data: a closure, called once with numbers that record, is what it computes.
///
/// - Target: a [`Setpoint`]. Ticks: a number per level, 1 where it computes. Parameters: its gains.
///
/// ```
/// # use omnidrones_controllers::omnidrones;
/// use omnidrones::autodiff::{Scalar, Trace};
/// use omnidrones::controllers::{ClosedLoop, LawController, LawDescription, WrittenLaw};
/// use omnidrones::dynamics::{Physics, Plant, vehicles};
/// use omnidrones::error::Error;
///
/// let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird")?, Physics::default())?;
/// let about = LawDescription { name: "climb".into(), gains: vec![("k".into(), 0.5)], ..LawDescription::default() };
/// let law = WrittenLaw::new(about, &plant, |now, _| {
///     let error = now.sample().position[2] - now.kinematics().position[2];
///     let action = (now.parameters[0] * error).clamp(-Trace::one(), Trace::one());
///     Ok::<_, Error>((Vec::new(), vec![action; 4]))
/// })?;
/// let closed = ClosedLoop::new(plant, LawController::of(law))?.with_gains();
/// assert_eq!(closed.parameter_names(), ["k"]);
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct WrittenLaw {
    about: LawDescription,
    /// Ticks between two computations of each level.
    every: Vec<u64>,
    tick: Arc<WrittenTick>,
    nominal: Vec<f64>,
}

impl WrittenLaw {
    /// Records `tick` for a plant. It is given state, target, ticks and parameters, and the memory; it gives the new memory, of the same
    /// length, and one command in [−1, 1] per rotor and drive, in the order of the plant's input.
    ///
    /// # Errors
    /// That of `tick`; [`Error::Value`] for a memory or commands of another length, for numbers that it kept from another recording, for
    /// levels that do not divide the rate, and for gains without a name, of one name, or not finite. [`Error::Limit`] where the
    /// recording is too large.
    pub fn new<E: From<Error>>(
        about: LawDescription,
        plant: &Plant,
        tick: impl FnOnce(&LawInput<'_, Trace>, &[Trace]) -> std::result::Result<(Vec<Trace>, Vec<Trace>), E>,
    ) -> std::result::Result<Self, E> {
        let every = about.ticks_of_levels(plant.physics().dt)?;
        about.check()?;
        let (n_memory, n_command) = (about.memory.len(), command_places(plant).len());
        let sizes = [Setpoint::<f64>::DIM, every.len(), about.gains.len(), n_memory];
        let tick = WrittenTick::record::<E>(plant, sizes, |now, memory| {
            let (mut memory, mut commands) = tick(now, memory)?;
            let counts = [("memory", memory.len(), n_memory), ("commands", commands.len(), n_command)];
            for (what, got, wanted) in counts {
                if got != wanted {
                    let what = format!("controller '{}': {what} of a tick", about.name);
                    let rule = format!("{wanted} of '{}'", plant.name());
                    return Err(Error::value(what, got, rule, "Return as many numbers as there are.").into());
                }
            }
            memory.append(&mut commands);
            if !memory.iter().all(|number| number.is_live()) {
                let what = format!("controller '{}': a number that a tick returns", about.name);
                let remedy = "Compute it of what the tick is given; what lasts belongs into the memory.";
                return Err(Error::value(what, "of another recording", "of this tick", remedy).into());
            }
            Ok(memory)
        })?;
        let nominal = about.gains.iter().map(|(_, value)| *value).collect();
        Ok(Self { about, every, tick: Arc::new(tick), nominal })
    }

    /// What it is beside its tick.
    pub fn about(&self) -> &LawDescription {
        &self.about
    }

    /// The same law with other nominal gains, as many.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of them, or one that is not finite.
    pub fn with_gains(mut self, gains: &[f64]) -> Result<Self> {
        if gains.len() != self.nominal.len() {
            let what = format!("controller '{}': number of gains", self.about.name);
            return Err(Error::value(what, gains.len(), self.nominal.len().to_string(), "Give one for each name."));
        }
        self.about.gains.iter_mut().zip(gains).for_each(|((_, own), new)| *own = *new);
        self.about.check()?;
        self.nominal = gains.to_vec();
        Ok(self)
    }
}

impl LawDescription {
    fn check(&self) -> Result<()> {
        let of = |what: &str| format!("controller '{}': {what}", self.name);
        if let Some(k) = self.memory.iter().position(|x| !x.is_finite()) {
            return Err(Error::value(of(&format!("memory[{k}]")), self.memory[k], "finite", "Begin with numbers."));
        }
        for (k, (name, value)) in self.gains.iter().enumerate() {
            if !value.is_finite() {
                return Err(Error::value(of(&format!("gain '{name}'")), value, "finite", "Give its nominal value."));
            }
            if name.is_empty() || self.gains[..k].iter().any(|(other, _)| other == name) {
                let remedy = "Give each gain a name of its own.";
                return Err(Error::value(of(&format!("name of gain {k}")), format!("'{name}'"), "its own", remedy));
            }
        }
        Ok(())
    }

    /// Ticks between two computations of each level, of a law in steps of `dt` seconds.
    fn ticks_of_levels(&self, dt: f64) -> Result<Vec<u64>> {
        let own = self.rate.unwrap_or(1.0 / dt);
        let every = |level: &f64| {
            let ratio = own / level;
            let whole = ratio.round();
            if *level > 0.0 && (1.0..=1e6).contains(&whole) && (ratio - whole).abs() <= 1e-6 * whole {
                return Ok(whole as u64);
            }
            let what = format!("controller '{}': rate of a level", self.name);
            let rule = format!("{own:.6} Hz, as the controller ticks, divided by a whole number");
            Err(Error::value(what, format!("{level} Hz"), rule, "Change the rate of the level or of the controller."))
        };
        self.levels.iter().map(every).collect()
    }
}

impl ControlLaw for WrittenLaw {
    fn name(&self) -> &str {
        &self.about.name
    }
    fn description(&self) -> String {
        self.about.description.clone()
    }
    fn rate(&self) -> Option<f64> {
        self.about.rate
    }
    fn is_batched(&self) -> bool {
        !self.tick.recording.has_operations()
    }
    fn n_tick(&self) -> usize {
        self.every.len()
    }
    fn write_ticks(&self, tick: u64, ticks: &mut [f64]) {
        ticks.iter_mut().zip(&self.every).for_each(|(own, every)| *own = f64::from(tick.is_multiple_of(*every)));
    }
    fn memory(&self) -> Vec<f64> {
        self.about.memory.clone()
    }
    fn parameters(&self) -> Vec<f64> {
        self.nominal.clone()
    }
    fn parameter_names(&self) -> Vec<String> {
        self.about.gains.iter().map(|(name, _)| name.clone()).collect()
    }
    fn check_plant(&self, plant: &Plant) -> Result<()> {
        self.tick.check(&self.about.name, plant)
    }
    fn compiled(&self) -> Option<CompiledTick> {
        Some(CompiledTick::of(&self.tick, &self.nominal))
    }
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        self.tick.tick(&self.nominal, now, memory, commands);
    }
}

#[cfg(test)]
mod tests;
