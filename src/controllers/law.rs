//! Straight-line controllers: written once over any scalar, run in `f64`, duals, recordings and batches.
//!
//! A solver inside a law is an [`Operation`](autodiff::Operation), such as an
//! [`AllocationFunction`](super::allocation::AllocationFunction): recordings then hold one call of it, with its derivative.

use super::cascade::RateDivisors;
use super::controller::{Controller, Measurement, Target, forward};
use super::filter::FilterSettings;
use super::kinematics::Kinematics;
use super::reference::Setpoint;
use super::written_law::{CompiledTick, RecordedLaw};
use autodiff::Scalar;
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
/// computes) reaches it as numbers, so that a closed loop around it is one differentiable [`System`](autodiff::System).
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
    /// Refuses a plant that it is not made for; by default it takes any.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) that names both.
    fn check_plant(&self, _plant: &Plant) -> Result<()> {
        Ok(())
    }
    /// Its tick in `f64` as a program, for one that is data; by default none.
    #[doc(hidden)]
    fn compiled(&self) -> Option<CompiledTick> {
        None
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
    compiled: Option<CompiledTick>,
}

impl<L> Clone for LawController<L> {
    fn clone(&self) -> Self {
        let [parameters, memory, target, ticks] =
            [&self.parameters, &self.memory, &self.target, &self.ticks].map(|v| v.to_vec());
        let compiled = self.compiled.clone();
        Self { law: self.law.clone(), parameters, memory, target, ticks, tick: self.tick, compiled }
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
            compiled: law.compiled(),
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
        fn check_plant(&self, plant: &Plant) -> Result<()>;
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
        match &mut self.compiled {
            Some(own) => own.tick(&now, &mut self.memory, commands),
            None => self.law.tick(&now, &mut self.memory, commands),
        }
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
