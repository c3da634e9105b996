//! Gradients through steps on a device: a tape of what was stepped, and its reverse sweep.

use crate::device::{Device, DeviceKind, Kernels};
use crate::memory::{Array, DeviceRows};
use base::error::{Error, Result};
use std::sync::{Arc, Weak};
use tasks::Env;
use tasks::env::{Adjoint, Cotangents, EnvKernel, Given, KernelArguments, StepLayout, SweepArguments, SweepOptions};

/// What [`DeviceEnv::step_recorded`](crate::DeviceEnv::step_recorded) remembers of up to `horizon` steps, on the device.
#[derive(Debug)]
pub struct DeviceTape {
    identity: Arc<()>,
    device: DeviceKind,
    layout: StepLayout,
    n_env: usize,
    stride: usize,
    horizon: usize,
    rows: Array<f32>,
    running: Array<u8>,
    ended: Array<u8>,
    moved: Array<u8>,
    statistics: Array<f32>,
    pub(crate) n_step: usize,
}

impl DeviceTape {
    pub(crate) fn new(
        device: &Device,
        layout: StepLayout,
        horizon: usize,
        n_env: usize,
        stride: usize,
    ) -> Result<Self> {
        let most = u32::MAX as usize / layout.n_kept().max(layout.n_result()).max(1);
        if stride > most {
            return Err(Error::limit("n_env of a tape on a device", stride, most, "Step fewer environments at once."));
        }
        let flags = || device.zeros(horizon * stride);
        Ok(Self {
            rows: device.zeros(horizon * layout.n_kept() * stride)?,
            running: flags()?,
            ended: flags()?,
            moved: flags()?,
            statistics: device.zeros(horizon * layout.statistics.len())?,
            n_step: 0,
            identity: Arc::default(),
            device: device.kind(),
            layout,
            n_env,
            stride,
            horizon,
        })
    }

    /// Steps recorded.
    pub fn len(&self) -> usize {
        self.n_step
    }

    /// Whether nothing is recorded.
    pub fn is_empty(&self) -> bool {
        self.n_step == 0
    }

    /// Steps that fit.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Forgets all steps and keeps the memory.
    pub fn clear(&mut self) {
        self.n_step = 0;
    }

    fn check(&self, device: &Device, layout: &StepLayout, n_env: usize) -> Result<()> {
        if self.layout == *layout && self.n_env == n_env && self.device == device.kind() {
            return Ok(());
        }
        let remedy = "Make tape and adjoint of the environment that is stepped.";
        let limit = "of the same device, task, configuration and size";
        Err(Error::value("the tape", "of another environment", limit, remedy))
    }

    /// Where the next step is kept.
    pub(crate) fn place(
        &self,
        device: &Device,
        layout: StepLayout,
        n_env: usize,
        arguments: &mut KernelArguments,
    ) -> Result<()> {
        self.check(device, &layout, n_env)?;
        if self.n_step == self.horizon {
            let remedy = "Clear it, or make a longer one with env.tape(horizon).";
            return Err(Error::limit("steps of the tape", self.n_step + 1, self.horizon, remedy));
        }
        let row = (self.n_step * self.stride) as u64;
        arguments.tape = self.rows.address() + row * (size_of::<f32>() * self.layout.n_kept()) as u64;
        arguments.tape_running = self.running.address() + row;
        arguments.tape_ended = self.ended.address() + row;
        arguments.tape_moved = self.moved.address() + row;
        Ok(())
    }

    /// Which tape, and how many steps it has.
    pub(crate) fn last(&self) -> (Weak<()>, usize) {
        (Arc::downgrade(&self.identity), self.n_step)
    }

    /// Whether the next step comes behind the last one that was recorded anywhere.
    pub(crate) fn follows(&self, last: Option<&(Weak<()>, usize)>) -> bool {
        last.is_some_and(|(identity, n)| *n == self.n_step && Weak::ptr_eq(identity, &Arc::downgrade(&self.identity)))
    }

    pub(crate) fn keep_statistics(&self, shared: &Array<f32>) -> Result<()> {
        let n = self.layout.statistics.len();
        if n == 0 { Ok(()) } else { self.statistics.copy_at(self.n_step * n, shared.address(), n) }
    }
}

/// Cotangents of what one step told that lie on the device, nothing where there are none: see [`Cotangents`].
#[derive(Debug, Clone, Default)]
pub struct DeviceCotangents {
    /// `[E, A, observation]`
    pub observation: Option<DeviceRows>,
    /// `[E, A, observation]`, where an episode ended.
    pub final_observation: Option<DeviceRows>,
    /// `[E, central]`
    pub central: Option<DeviceRows>,
    /// `[E, central]`, where an episode ended.
    pub final_central: Option<DeviceRows>,
    /// `[E, carried]`, where an episode ended.
    pub final_carried: Option<DeviceRows>,
    /// `[E]`, of the team.
    pub reward: Option<DeviceRows>,
    /// `[E]`
    pub loss: Option<DeviceRows>,
}

/// The adjoint of one step on a device; clones share it.
#[derive(Debug, Clone)]
pub struct DeviceAdjoint(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    device: Device,
    host: Adjoint,
    code: Kernels,
    n_env: usize,
    stride: usize,
    n_parameter: usize,
}

impl DeviceAdjoint {
    pub(crate) fn new(device: &Device, env: &Env, parameters: bool, stride: usize) -> Result<Self> {
        let host = env.adjoint(parameters)?;
        let code = device.kernels(&env.adjoint_kernel(&host)?, &[EnvKernel::Pull])?;
        let n_parameter = if parameters { host.layout().parameters.len() } else { 0 };
        let (device, n_env) = (device.clone(), env.spec().n_env);
        Ok(Self(Arc::new(Shared { device, host, code, n_env, stride, n_parameter })))
    }

    /// What is where among its arguments and results.
    pub fn layout(&self) -> &StepLayout {
        self.0.host.layout()
    }

    /// A sweep that begins behind any step of a tape, with nothing carried.
    ///
    /// # Errors
    /// [`Error::Value`] where the device has no room.
    pub fn sweep(&self, options: SweepOptions) -> Result<DeviceSweep> {
        let (own, p) = (&self.0, self.layout());
        let rows = |n: usize| own.device.zeros::<f32>(n * own.stride);
        let sweep = DeviceSweep {
            carried: rows(p.n_carried())?,
            action: rows(p.action.len())?,
            parameters: rows(own.n_parameter)?,
            seeds: rows(p.n_result())?,
            results: rows(own.host.program().n_output())?,
            dropped: own.device.zeros(own.stride)?,
            given: Vec::new(),
            up: [Given::default(); 7],
            adjoint: self.clone(),
            options,
            last: None,
        };
        own.device.settle()?;
        Ok(sweep)
    }
}

/// A reverse sweep over a tape, on the device: the numbers of [`Sweep`](tasks::env::Sweep), to the bit.
#[derive(Debug)]
pub struct DeviceSweep {
    adjoint: DeviceAdjoint,
    options: SweepOptions,
    carried: Array<f32>,
    action: Array<f32>,
    parameters: Array<f32>,
    seeds: Array<f32>,
    results: Array<f32>,
    dropped: Array<u64>,
    /// Cotangents of the host, one array for each kind.
    given: Vec<Array<f32>>,
    /// Where those of the last pull lie.
    up: [Given; 7],
    last: Option<usize>,
}

impl DeviceSweep {
    /// Begins again behind any step, with nothing carried; keeps the memory.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn restart(&mut self) -> Result<()> {
        for rows in [&self.carried, &self.parameters] {
            rows.clear()?;
        }
        self.dropped.clear()?;
        self.last = None;
        Ok(())
    }

    /// Pulls cotangents of the host back through step `t` of a tape; `action` (`[E, A, command]`) gets those of its actions: see
    /// [`Sweep::pull`](tasks::env::Sweep::pull).
    ///
    /// # Errors
    /// [`Error::Value`] for a tape of another task, a step out of order, a slice of the wrong length; [`Error::Limit`] if the tape has no
    /// such step. Nothing is changed then.
    pub fn pull(&mut self, tape: &DeviceTape, t: usize, up: &Cotangents<'_>, action: &mut [f32]) -> Result<()> {
        let (n_env, n_action) = (self.adjoint.0.n_env, self.adjoint.layout().action.len());
        self.check_step(tape, t)?;
        let p = self.adjoint.layout().clone();
        let all: [(&str, &[f32], usize); 7] = [
            ("observation", up.observation, p.observation.len()),
            ("final_observation", up.final_observation, p.observation.len()),
            ("central", up.central, p.central.len()),
            ("final_central", up.final_central, p.central.len()),
            ("final_carried", up.final_carried, p.n_carried()),
            ("reward", up.reward, 1),
            ("loss", up.loss, 1),
        ];
        for (what, got, each) in all.iter().map(|(what, own, each)| (*what, own.len(), *each)) {
            if got != 0 && got != n_env * each {
                let wanted = (n_env * each).to_string();
                return Err(Error::value(format!("length of {what}"), got, wanted, "Rows are environments."));
            }
        }
        if action.len() != n_env * n_action {
            let wanted = (n_env * n_action).to_string();
            return Err(Error::value("length of action", action.len(), wanted, "Rows are environments."));
        }
        if self.given.is_empty() {
            let own = &self.adjoint.0.device;
            self.given = all.iter().map(|(_, _, each)| own.zeros(n_env * each)).collect::<Result<_>>()?;
        }
        let mut given = [Given::default(); 7];
        for ((given, array), (_, own, each)) in given.iter_mut().zip(&self.given).zip(all) {
            if !own.is_empty() {
                array.write(own)?;
                *given = Given { at: array.address(), environment: each as i64, number: 1 };
            }
        }
        self.up = given;
        self.pull_given(tape, t, given)?;
        let stride = self.adjoint.0.stride;
        let columns = self.action.read()?;
        for (i, row) in action.chunks_exact_mut(n_action.max(1)).enumerate() {
            row.iter_mut().enumerate().for_each(|(k, x)| *x = columns[k * stride + i]);
        }
        Ok(())
    }

    /// Pulls cotangents that lie on the device back through step `t`; those of the actions, `[E, A, command]`, stay there and change with the
    /// next pull.
    ///
    /// # Errors
    /// As [`DeviceSweep::pull`]; [`Error::Value`] for numbers of another device or shape.
    pub fn pull_on(&mut self, tape: &DeviceTape, t: usize, up: &DeviceCotangents) -> Result<DeviceRows> {
        self.check_step(tape, t)?;
        let (own, p) = (&self.adjoint.0, self.adjoint.layout());
        let given = |what, rows: &Option<DeviceRows>, each| match rows {
            Some(rows) => rows.given(what, own.device.kind(), own.n_env, each),
            None => Ok(Given::default()),
        };
        let (seen, central) = (p.observation.len(), p.central.len());
        let all = [
            given("observation", &up.observation, seen)?,
            given("final_observation", &up.final_observation, seen)?,
            given("central", &up.central, central)?,
            given("final_central", &up.final_central, central)?,
            given("final_carried", &up.final_carried, p.n_carried())?,
            given("reward", &up.reward, 1)?,
            given("loss", &up.loss, 1)?,
        ];
        self.pull_given(tape, t, all)?;
        self.up = all;
        let (own, n) = (&self.adjoint.0, self.adjoint.layout().action.len());
        Ok(self.action.lent(own.device.kind(), 0, vec![own.n_env, n], vec![1, own.stride as i64]))
    }

    /// Pulls back through step `t` with the cotangents of the last pull, which lie on the device; those of actions stay there.
    ///
    /// # Errors
    /// As [`DeviceSweep::pull`].
    pub fn pull_again(&mut self, tape: &DeviceTape, t: usize) -> Result<()> {
        self.check_step(tape, t)?;
        self.pull_given(tape, t, self.up)
    }

    fn check_step(&self, tape: &DeviceTape, t: usize) -> Result<()> {
        let own = &self.adjoint.0;
        tape.check(&own.device, own.host.layout(), own.n_env)?;
        if t >= tape.n_step {
            return Err(Error::limit("step of the tape", t, tape.n_step.saturating_sub(1), "Steps count from 0."));
        }
        if let Some(last) = self.last.filter(|last| t + 1 != *last || *last >= tape.n_step) {
            let wanted =
                if last == 0 { "none, as all are pulled".into() } else { format!("{} of that tape", last - 1) };
            let remedy = "Pull each step once, from the last to the first; sweep.restart() begins again.";
            return Err(Error::value("step of the sweep", t, wanted, remedy));
        }
        Ok(())
    }

    /// With cotangents that lie on the device.
    fn pull_given(&mut self, tape: &DeviceTape, t: usize, given: [Given; 7]) -> Result<()> {
        let (own, p) = (&self.adjoint.0, self.adjoint.layout());
        let flags = |array: &Array<u8>, t: usize| array.address() + (t * own.stride) as u64;
        let floats = |array: &Array<f32>, first: usize| array.address() + (size_of::<f32>() * first) as u64;
        let [observation, final_observation, central, final_central, final_carried, reward, loss] = given;
        let arguments = SweepArguments {
            tape: floats(&tape.rows, t * p.n_kept() * own.stride),
            statistics: floats(&tape.statistics, t * p.statistics.len()),
            carried: self.carried.address(),
            action: self.action.address(),
            parameters: self.parameters.address(),
            seeds: self.seeds.address(),
            results: self.results.address(),
            running: flags(&tape.running, t),
            ended: flags(&tape.ended, t),
            moved: self.last.map_or(0, |behind| flags(&tape.moved, behind)),
            dropped: self.dropped.address(),
            observation,
            final_observation,
            central,
            final_central,
            final_carried,
            reward,
            loss,
            decay: self.options.decay,
            clip: self.options.clip,
            n: own.n_env as u32,
            stride: own.stride as u32,
        };
        own.code.launch(EnvKernel::Pull, own.n_env, &arguments)?;
        self.last = Some(t);
        Ok(())
    }

    fn rows(&self, columns: &Array<f32>) -> Result<Vec<f32>> {
        let (n_env, stride) = (self.adjoint.0.n_env, self.adjoint.0.stride);
        let (columns, n) = (columns.read()?, columns.len() / stride);
        Ok((0..n_env).flat_map(|i| (0..n).map(move |k| (i, k))).map(|(i, k)| columns[k * stride + i]).collect())
    }

    /// Cotangents of what the environments carried into the last step pulled, `[E, carried]`: physics first.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn carried(&self) -> Result<Vec<f32>> {
        self.rows(&self.carried)
    }

    /// Gradients with respect to the numbers that differ between environments, summed over all steps pulled, `[E, parameter]`.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn parameters(&self) -> Result<Vec<f32>> {
        self.rows(&self.parameters)
    }

    /// Adds to what is carried, `[E, carried]`: see [`Sweep::add_carried`](tasks::env::Sweep::add_carried).
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn add_carried(&mut self, cotangents: &[f32]) -> Result<()> {
        let (n, stride, n_env) = (self.adjoint.layout().n_carried(), self.adjoint.0.stride, self.adjoint.0.n_env);
        if cotangents.len() != n * n_env {
            let (got, wanted) = (cotangents.len(), (n * n_env).to_string());
            return Err(Error::value("length of carried", got, wanted, "Rows are environments."));
        }
        let mut columns = self.carried.read()?;
        for (i, row) in cotangents.chunks_exact(n.max(1)).enumerate() {
            row.iter().enumerate().for_each(|(k, x)| columns[k * stride + i] += x);
        }
        self.carried.write(&columns)
    }

    /// Gradients that were not finite and became zero, environments times steps.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn dropped(&self) -> Result<usize> {
        Ok(self.dropped.read()?.iter().sum::<u64>() as usize)
    }
}
