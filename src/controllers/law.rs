//! Straight-line controllers: written once over any scalar, run in `f64`, duals, recordings and batches.
//!
//! A solver inside a law is an [`Operation`](autodiff::Operation), such as an
//! [`AllocationFunction`](super::allocation::AllocationFunction): recordings then hold one call of it, with its derivative.

use super::cascade::RateDivisors;
use super::controller::{Controller, Measurement, Target, forward};
use super::filter::FilterSettings;
use super::kinematics::Kinematics;
use super::reference::Setpoint;
use autodiff::trace::Recording;
use autodiff::{Program, Scalar, System, Trace};
use base::error::Result;
use dynamics::Plant;
use flight::Commanded;
use std::sync::Arc;

/// What a law gets in a tick.
#[derive(Debug, Clone, Copy)]
pub struct LawInput<'a, S> {
    /// What is measured: the state of the whole plant, `[n_state]`, in its layout.
    pub state: &'a [S],
    /// What [`ControlLaw::write_target`] wrote.
    pub target: &'a [S],
    /// What [`ControlLaw::write_ticks`] wrote.
    pub ticks: &'a [S],
    /// In place of [`ControlLaw::parameters`]; empty where those hold.
    pub parameters: &'a [S],
}

impl<S: Scalar> LawInput<'_, S> {
    /// Motion of the plant's root.
    #[inline]
    pub fn kinematics(&self) -> Kinematics<S> {
        Kinematics::read(self.state)
    }

    /// The reference now, of a law that keeps the usual target.
    #[inline]
    pub fn sample(&self) -> Setpoint<S> {
        Setpoint::read(self.target)
    }
}

/// A controller without branches on values (see [`Scalar`]). Whatever depends on time alone (the reference, which level
/// computes) reaches it as numbers, so that a closed loop around it is one differentiable [`System`].
pub trait ControlLaw: Send + Sync + 'static {
    /// One word.
    fn name(&self) -> &str {
        "own"
    }
    /// What it does, for tables.
    fn description(&self) -> String {
        String::new()
    }
    /// How often it ticks, Hz; must divide 1/dt. `None`: in every step.
    fn rate(&self) -> Option<f64> {
        None
    }
    /// Whether flights side by side run it in lanes. A law that calls an [`Operation`](autodiff::Operation) is no
    /// longer batched: a recording holds one call of it, and lanes make theirs one after the other.
    fn is_batched(&self) -> bool {
        true
    }
    /// The schedule of its levels, where it was built for one.
    fn schedule(&self) -> Option<RateDivisors> {
        None
    }
    /// Filters of the measured angular velocity that it was built with; by default none.
    fn filters(&self) -> &[FilterSettings] {
        &[]
    }
    /// What follows the reference: by default the root of the plant.
    fn tracked(&self, state: &[f64]) -> Kinematics<f64> {
        Kinematics::read(state)
    }
    /// Numbers of a target: by default those of a [`Setpoint`].
    fn n_target(&self) -> usize {
        Setpoint::<f64>::DIM
    }
    /// Writes the target at a time, s, into `row`, `[n_target]`.
    fn write_target(&self, target: Target<'_>, time: f64, row: &mut [f64]) {
        target.sample(time).write(row);
    }
    /// How many numbers say which of its levels compute; by default none.
    fn n_tick(&self) -> usize {
        0
    }
    /// Writes them for a tick, counted from 0, `[n_tick]`: 1 compute, 0 hold.
    fn write_ticks(&self, _tick: u64, _ticks: &mut [f64]) {}
    /// The memory before the first tick; by default none.
    fn memory(&self) -> Vec<f64> {
        Vec::new()
    }
    /// What its levels asked of the next ones, out of its memory; `None` for one without such levels.
    fn commanded(&self, _memory: &[f64]) -> Option<Commanded> {
        None
    }
    /// Numbers that may be tuned and differentiated; by default none.
    fn parameters(&self) -> Vec<f64> {
        Vec::new()
    }
    /// Names of the parameters, in their order.
    fn parameter_names(&self) -> Vec<String> {
        Vec::new()
    }
    /// One tick: the new memory over the old, commands in [−1, 1] at their places in the plant's input.
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S])
    where
        Self: Sized;
}

/// A law with its memory and its clock: a [`Controller`].
#[derive(Debug)]
pub struct LawController<L> {
    law: Arc<L>,
    parameters: Vec<f64>,
    memory: Vec<f64>,
    target: Vec<f64>,
    ticks: Vec<f64>,
    tick: u64,
}

impl<L> Clone for LawController<L> {
    fn clone(&self) -> Self {
        let [parameters, memory, target, ticks] =
            [&self.parameters, &self.memory, &self.target, &self.ticks].map(|v| v.to_vec());
        Self { law: self.law.clone(), parameters, memory, target, ticks, tick: self.tick }
    }
}

impl<L: ControlLaw> LawController<L> {
    /// Before its first tick.
    pub fn of(law: L) -> Self {
        Self {
            parameters: Vec::new(),
            memory: law.memory(),
            target: vec![0.0; law.n_target()],
            ticks: vec![0.0; law.n_tick()],
            tick: 0,
            law: Arc::new(law),
        }
    }

    /// With these numbers, as many, in place of [`ControlLaw::parameters`].
    #[must_use]
    pub fn with_parameters(mut self, parameters: &[f64]) -> Self {
        self.parameters = parameters.to_vec();
        self
    }

    /// The law.
    pub fn law(&self) -> &L {
        &self.law
    }
}

impl<L: ControlLaw> Controller for LawController<L> {
    forward! { self.law;
        fn name(&self) -> &str;
        fn description(&self) -> String;
        fn rate(&self) -> Option<f64>;
        fn schedule(&self) -> Option<RateDivisors>;
        fn filters(&self) -> &[FilterSettings];
        fn tracked(&self, state: &[f64]) -> Kinematics<f64>;
        fn is_batched(&self) -> bool;
    }

    fn reset(&mut self) {
        (self.memory, self.tick) = (self.law.memory(), 0);
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        self.law.write_target(target, seen.time, &mut self.target);
        self.law.write_ticks(self.tick, &mut self.ticks);
        self.tick += 1;
        let now =
            LawInput { state: seen.state, target: &self.target, ticks: &self.ticks, parameters: &self.parameters };
        self.law.tick(&now, &mut self.memory, commands);
    }

    fn memory(&self) -> &[f64] {
        &self.memory
    }

    fn commanded(&self) -> Option<Commanded> {
        self.law.commanded(&self.memory)
    }

    fn recorded(&self, plant: &Plant) -> Result<Option<RecordedLaw>> {
        RecordedLaw::of(self.law.clone(), plant, &self.parameters).map(Some)
    }
}

/// Records a tick with these numbers for parameters.
type RecordWith = dyn Fn(&[f64]) -> Recording + Send + Sync;

/// Any straight-line law, recorded for a plant: one type for all of them, run on any scalar by an interpreter.
#[derive(Clone)]
pub struct RecordedLaw {
    law: Arc<dyn ControlLaw>,
    program: Arc<Program>,
    parameters: Vec<f64>,
    record: Arc<RecordWith>,
}

/// State, target, ticks, parameters and memory in, memory and commands out. Parameters are inputs where they are not `known`.
fn record<L: ControlLaw>(law: &L, [n_state, n_input]: [usize; 2], known: Option<&[f64]>) -> Recording {
    let n_parameter = if known.is_some() { 0 } else { law.parameters().len() };
    let cuts = [n_state, law.n_target(), law.n_tick(), n_parameter];
    Recording::of(cuts.iter().sum::<usize>() + law.memory().len(), |z| {
        let (state, z) = z.split_at(cuts[0]);
        let (target, z) = z.split_at(cuts[1]);
        let (ticks, z) = z.split_at(cuts[2]);
        let (parameters, memory) = z.split_at(cuts[3]);
        let known: Option<Vec<Trace>> = known.map(|known| known.iter().map(|x| Scalar::constant(*x)).collect());
        let parameters = known.as_deref().unwrap_or(parameters);
        let mut memory = memory.to_vec();
        let mut commands = vec![Scalar::zero(); n_input];
        law.tick(&LawInput { state, target, ticks, parameters }, &mut memory, &mut commands);
        memory.append(&mut commands);
        memory
    })
}

impl RecordedLaw {
    fn of<L: ControlLaw>(law: Arc<L>, plant: &Plant, parameters: &[f64]) -> Result<Self> {
        let parameters = if parameters.is_empty() { law.parameters() } else { parameters.to_vec() };
        let sizes = [plant.n_state(), plant.n_input()];
        let program = Arc::new(Program::compile(&record(&*law, sizes, None))?);
        let own = law.clone();
        let record = Arc::new(move |known: &[f64]| record(&*own, sizes, Some(known)));
        Ok(Self { law, program, parameters, record })
    }

    /// A tick with its parameters as constants: state, target, ticks and memory in, memory and the plant's input out.
    #[doc(hidden)]
    pub fn recording(&self) -> Recording {
        (self.record)(&self.parameters)
    }

    /// Instructions of one tick.
    pub fn len(&self) -> usize {
        self.program.len()
    }

    /// Whether there is nothing to compute.
    pub fn is_empty(&self) -> bool {
        self.program.is_empty()
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
    fn tick<S: Scalar>(&self, now: &LawInput<'_, S>, memory: &mut [S], commands: &mut [S]) {
        let mut inputs = [now.state, now.target, now.ticks].concat();
        if now.parameters.is_empty() {
            inputs.extend(self.parameters.iter().map(|p| S::constant(*p)));
        } else {
            inputs.extend_from_slice(now.parameters);
        }
        inputs.extend_from_slice(memory);
        let mut results = vec![S::zero(); memory.len() + commands.len()];
        self.program.evaluate_over(&inputs, &mut results);
        let (new, given) = results.split_at(memory.len());
        memory.copy_from_slice(new);
        commands.copy_from_slice(given);
    }
}
