//! Many environments of one task on a device.

use crate::device::{Device, Kernels};
use crate::foreign::Graph;
use crate::memory::{Array, DeviceRows};
use crate::sweep::{DeviceAdjoint, DeviceTape};
use base::error::{Error, Result};
use std::ops::Range;
use std::sync::{Arc, Weak};
use tasks::env::{EnvKernel, EnvKernels, EnvRows, KernelArguments};
use tasks::{Buffers, Env, EnvConfig, PendingStatistics, Spec, Statistics};

/// Environments of a block of the host: those whose statistics are summed in order.
const BLOCK: usize = 64;

/// E environments of one task on a device: the episodes of an [`Env`] of the same configuration, to the bit.
///
/// Rows stay where they are: what a step tells is read where it lies, or copied to the host ([`DeviceEnv::buffers`]).
///
/// ```
/// # use omnidrones_gpu::omnidrones;
/// use omnidrones::gpu::{Device, DeviceEnv, DeviceKind};
/// use omnidrones::tasks::{Buffers, Env, EnvConfig};
///
/// # let Ok(_) = Device::new(DeviceKind::Emulated) else { return Ok(()) };
/// let config = EnvConfig { n_env: 100, ..EnvConfig::default() };
/// let mut env = DeviceEnv::make("Hover", &config, &Device::new(DeviceKind::Emulated)?)?;
/// env.reset(None, None)?;
/// env.step(&vec![-0.415; 100 * 4])?;
///
/// let mut host = Env::make("Hover", &config)?;
/// let mut buffers = Buffers::new(host.spec());
/// host.reset(None, None, &mut buffers.out())?;
/// host.step(&vec![-0.415; 100 * 4], &mut buffers.out())?;
/// assert_eq!(env.buffers()?.observation, buffers.observation);
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug)]
pub struct DeviceEnv {
    device: Device,
    kernels: EnvKernels,
    code: Kernels,
    rows: Rows,
    arguments: KernelArguments,
    /// The same on the host: what it is asked for beside steps, and what begins there.
    host: Env,
    /// Whether the host's rows are those of the device.
    is_mirrored: bool,
    started: Vec<bool>,
    /// Whether a step that was not recorded moved all of them since the last one that was.
    is_moved: bool,
    /// The tape that has the last step, and how many it had then.
    recorded: Option<(Weak<()>, usize)>,
    /// Whether a graph of another library has remembered steps: they may be done again without a word.
    is_remembered: bool,
    /// Which environments these are.
    identity: Arc<()>,
}

/// What a step tells, where it lies: see [`StepOut`](tasks::StepOut). E environments, A agents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceArray {
    /// `[E, A, observation]`
    Observation,
    /// `[E, A]`; all agents of an environment share one number.
    Reward,
    /// `[E]`, bytes.
    Terminated,
    /// `[E]`, bytes.
    Truncated,
    /// `[E, central]`
    Central,
    /// `[E, privileged]`
    Privileged,
    /// `[E, A, observation]`, where an episode ended.
    FinalObservation,
    /// `[E, central]`, where an episode ended.
    FinalCentral,
    /// `[E, info]`
    Info,
    /// `[E, A, action]`: what [`DeviceEnv::step_again`] steps with, and where actions of the host are brought.
    Action,
}

/// Steps of a [`DeviceEnv`] as one piece of work: see [`DeviceEnv::graph`].
#[derive(Debug)]
pub struct DeviceGraph {
    graph: Graph,
    /// Whose arrays it works on.
    of: Arc<()>,
    shared: (u64, u32),
    n: usize,
}

impl DeviceGraph {
    /// Steps.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Whether it steps nothing.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }
}

/// All arrays.
#[derive(Debug)]
struct Rows {
    stride: usize,
    plant: Array<f32>,
    kept: Array<f32>,
    work: Array<f32>,
    shared: Array<f32>,
    model: Array<f32>,
    seed: Array<u64>,
    episode: Array<u64>,
    action: Array<f32>,
    info: Array<f32>,
    final_observation: Array<f32>,
    final_central: Array<f32>,
    terminated: Array<u8>,
    truncated: Array<u8>,
    due: Array<u8>,
    restart: Array<u8>,
    seen: Array<u8>,
    sums: Array<f64>,
    mean: Array<f64>,
    moved: Array<u8>,
}

/// Refuses more numbers in one array than kernels count: they do so in 32 bits.
fn check_size(n_env: usize, stride: usize, kernels: &EnvKernels) -> Result<()> {
    let widest = kernels.n_row.into_iter().chain([kernels.n_info, kernels.observation.len()]).max().unwrap_or(1);
    let most = (u32::MAX as usize / widest.max(1)) / BLOCK * BLOCK;
    if stride <= most {
        return Ok(());
    }
    Err(Error::limit(
        "n_env on a device",
        n_env,
        most,
        "Step fewer environments at once, or several batches side by side.",
    ))
}

/// One entry per environment, where there are any.
fn check_rows(what: &str, got: Option<usize>, n: usize) -> Result<()> {
    match got.filter(|got| *got != n) {
        None => Ok(()),
        Some(got) => {
            Err(Error::value(format!("length of {what}"), got, n.to_string(), "Give one entry per environment."))
        }
    }
}

impl DeviceEnv {
    /// The task of that name.
    ///
    /// # Errors
    /// As [`Env::make`] and [`DeviceEnv::new`].
    pub fn make(task: &str, config: &EnvConfig, device: &Device) -> Result<Self> {
        Self::new(Env::make(task, config)?, device)
    }

    /// The environments of a batch, as they are.
    ///
    /// # Errors
    /// [`Error::Value`] for what only the host can do: sensors, estimates, controllers that actions correct; for what the device refuses.
    pub fn new(host: Env, device: &Device) -> Result<Self> {
        let kernels = host.kernels()?;
        let code = device.kernels(&kernels.text, &kernels.kernels)?;
        let own = host.rows();
        let (stride, spec) = (own.stride, host.spec());
        check_size(spec.n_env, stride, &kernels)?;
        let row = |n: usize| device.zeros::<f32>(n * stride);
        let flags = || device.zeros::<u8>(stride);
        let rows = Rows {
            stride,
            plant: device.array(&own.plant)?,
            kept: device.array(&own.kept)?,
            work: row(kernels.n_row[2])?,
            shared: device.array(&host.shared_numbers())?,
            model: device.array(&own.model)?,
            seed: device.array(&own.seed)?,
            episode: device.array(&own.episode)?,
            action: device.zeros(spec.n_env * spec.n_agent * spec.action.len())?,
            info: row(kernels.n_info)?,
            final_observation: row(kernels.observation.len())?,
            final_central: row(kernels.central.len())?,
            terminated: flags()?,
            truncated: flags()?,
            due: flags()?,
            restart: flags()?,
            seen: flags()?,
            sums: device.array(&own.sums)?,
            mean: device.array(&host.statistics().mean)?,
            moved: flags()?,
        };
        let n_action = spec.n_agent * spec.action.len();
        let arguments = KernelArguments {
            plant: rows.plant.address(),
            kept: rows.kept.address(),
            work: rows.work.address(),
            shared: rows.shared.address(),
            model: rows.model.address(),
            seed: rows.seed.address(),
            episode: rows.episode.address(),
            action: rows.action.address(),
            info: rows.info.address(),
            final_observation: rows.final_observation.address(),
            final_central: rows.final_central.address(),
            terminated: rows.terminated.address(),
            truncated: rows.truncated.address(),
            due: rows.due.address(),
            restart: rows.restart.address(),
            seen: rows.seen.address(),
            sums: rows.sums.address(),
            mean: rows.mean.address(),
            tape: 0,
            tape_running: 0,
            tape_ended: 0,
            tape_moved: 0,
            moved: rows.moved.address(),
            action_environment: n_action as i64,
            action_number: 1,
            first_environment: spec.config.first_environment,
            difficulty: host.difficulty(),
            n: spec.n_env as u32,
            stride: stride as u32,
            collects: u32::from(host.is_collecting()),
            clears: 0,
            stops: 0,
            unused: 0,
        };
        let own = Self {
            device: device.clone(),
            kernels,
            code,
            rows,
            arguments,
            host,
            is_mirrored: true,
            started: own.started,
            is_moved: true,
            recorded: None,
            is_remembered: false,
            identity: Arc::default(),
        };
        own.look()?;
        // what is asked for on another stream finds them so
        own.device.settle()?;
        Ok(own)
    }

    /// Memory for `horizon` recorded steps, on the device.
    ///
    /// # Errors
    /// As [`Env::tape`]; [`Error::Value`] where the device has no room.
    pub fn tape(&self, horizon: usize) -> Result<DeviceTape> {
        self.host.check_tape(horizon)?;
        let tape = DeviceTape::new(&self.device, self.host.layout(), horizon, self.spec().n_env, self.rows.stride)?;
        self.device.settle()?;
        Ok(tape)
    }

    /// The adjoint of a step on the device: see [`Env::adjoint`].
    ///
    /// # Errors
    /// As [`Env::adjoint`]; [`Error::Value`] for what the device refuses.
    pub fn adjoint(&self, parameters: bool) -> Result<DeviceAdjoint> {
        DeviceAdjoint::new(&self.device, &self.host, parameters, self.rows.stride)
    }

    /// Kernels of steps and gradients of these environments for cards of this architecture, `sm_90`, into the folder that
    /// `OMNIDRONES_KERNELS` names: who steps them there needs no compiler. Says how many bytes they have.
    ///
    /// # Errors
    /// As [`DeviceEnv::new`]; [`Error::Value`] where there is no NVRTC.
    #[cfg(feature = "cuda")]
    pub fn compile_for(env: &Env, target: &str) -> Result<usize> {
        let mut bytes = crate::compile::ahead(&env.kernels()?.text, target)?;
        if env.spec().config.actions == tasks::ActionSpace::Continuous {
            bytes += crate::compile::ahead(&env.adjoint_kernel(&env.adjoint(true)?)?, target)?;
        }
        Ok(bytes)
    }

    /// Where it runs.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Names, sizes, units and bounds of all arrays.
    pub fn spec(&self) -> &Spec {
        self.host.spec()
    }

    /// As [`Env::reset`]; what it tells is told on the device.
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length.
    pub fn reset(&mut self, which: Option<&[bool]>, seeds: Option<&[u64]>) -> Result<()> {
        let n = self.spec().n_env;
        check_rows("which", which.map(<[bool]>::len), n)?;
        check_rows("seeds", seeds.map(<[u64]>::len), n)?;
        let is_chosen = |i: usize| which.is_none_or(|which| which[i]);
        if let Some(seeds) = seeds {
            let (mut seed, mut episode) = (self.rows.seed.read()?, self.rows.episode.read()?);
            for (i, own) in seeds.iter().enumerate().filter(|(i, _)| is_chosen(*i)) {
                (seed[i], episode[i]) = (*own, 0);
            }
            self.rows.seed.write(&seed)?;
            self.rows.episode.write(&episode)?;
        }
        match which {
            // which a graph may have
            None => self.rows.restart.fill(1)?,
            Some(which) => {
                let restart: Vec<u8> = which.iter().map(|own| u8::from(*own)).collect();
                self.rows.restart.write(&restart)?;
            }
        }
        self.is_mirrored = false;
        self.begin(true, false)?;
        self.started.iter_mut().take(n).enumerate().for_each(|(i, own)| *own |= is_chosen(i));
        Ok(())
    }

    /// As [`DeviceEnv::reset`] of those whose flags, bool `[E]` on the device, are set. Where all have begun before and no seeds are given,
    /// nothing of it waits for the device.
    ///
    /// # Errors
    /// As [`DeviceEnv::reset`]; [`Error::Value`] for flags of another device or shape.
    pub fn reset_on(&mut self, which: &DeviceRows, seeds: Option<&[u64]>) -> Result<()> {
        let n = self.spec().n_env;
        let at = which.flags("mask", self.device.kind(), n)?;
        check_rows("seeds", seeds.map(<[u64]>::len), n)?;
        self.rows.restart.copy_at(0, at, n)?;
        if seeds.is_some() || self.check_started().is_err() {
            let marked: Vec<bool> = self.rows.restart.read_at(0, n)?.iter().map(|own| *own != 0).collect();
            return self.reset(Some(&marked), seeds);
        }
        self.is_mirrored = false;
        self.begin(true, false)
    }

    /// One step of every environment, with actions of the host: row-major `[E, A, action]`, as [`Env::step`].
    ///
    /// # Errors
    /// [`Error::Value`] for a slice of the wrong length, or where an environment was never reset.
    pub fn step(&mut self, actions: &[f32]) -> Result<()> {
        self.bring_actions(actions)?;
        self.step_on_device(None)
    }

    /// One step with the actions that lie in [`DeviceArray::Action`]: those of the host's last step, or what others wrote there.
    ///
    /// # Errors
    /// As [`DeviceEnv::step`].
    pub fn step_again(&mut self) -> Result<()> {
        self.take_own_actions();
        self.step_on_device(None)
    }

    /// As [`DeviceEnv::step_again`], remembered by the tape.
    ///
    /// # Errors
    /// As [`DeviceEnv::step_recorded`].
    pub fn step_recorded_again(&mut self, tape: &mut DeviceTape) -> Result<()> {
        self.take_own_actions();
        self.step_on_device(Some(tape))
    }

    /// `n` times [`DeviceEnv::step_again`] as one piece of work for [`DeviceEnv::replay`]; nothing is stepped yet. Small batches take less
    /// time to step than their kernels to be asked for.
    ///
    /// # Errors
    /// As [`DeviceEnv::step`]; [`Error::Value`] for a task that begins on the host.
    pub fn graph(&mut self, n: usize) -> Result<DeviceGraph> {
        self.check_started()?;
        if self.kernels.draft.is_some() {
            let remedy = "Step it one by one.";
            let task = &self.spec().task;
            return Err(Error::value("task of a graph", task, "one whose episodes begin on the device", remedy));
        }
        let (device, before) = (self.device.clone(), (self.is_mirrored, self.is_moved, self.is_remembered));
        let graph = device.graph(|| (0..n).try_for_each(|_| self.step_again()));
        (self.is_mirrored, self.is_moved, self.is_remembered) = before;
        let graph = graph?;
        Ok(DeviceGraph { graph, of: self.identity.clone(), shared: self.shared_by_steps(), n })
    }

    /// Steps as a graph of these environments does, with what lies in [`DeviceArray::Action`].
    ///
    /// # Errors
    /// [`Error::Value`] for a graph of other environments, or from before what steps share was set: difficulty, collecting.
    pub fn replay(&mut self, graph: &DeviceGraph) -> Result<()> {
        self.check_started()?;
        if !Arc::ptr_eq(&graph.of, &self.identity) || graph.shared != self.shared_by_steps() {
            let remedy = "Make another one with env.graph(n).";
            let limit = "of these environments, with their difficulty and collecting";
            return Err(Error::value("the graph", "of others", limit, remedy));
        }
        (self.is_mirrored, self.is_moved) = (false, true);
        self.is_remembered |= self.device.is_remembered();
        graph.graph.launch()
    }

    /// What steps are told beside their arrays, as a graph keeps it: difficulty, and whether they collect.
    #[doc(hidden)]
    pub fn shared_by_steps(&self) -> (u64, u32) {
        (self.arguments.difficulty.to_bits(), self.arguments.collects)
    }

    /// One step with actions that lie on the device, `[E, A, action]`.
    ///
    /// # Errors
    /// As [`DeviceEnv::step`]; [`Error::Value`] for numbers of another device or shape.
    pub fn step_on(&mut self, actions: &DeviceRows) -> Result<()> {
        self.take_actions(actions)?;
        self.step_on_device(None)
    }

    /// As [`DeviceEnv::step_on`], remembered by the tape.
    ///
    /// # Errors
    /// As [`DeviceEnv::step_on`] and [`DeviceEnv::step_recorded`].
    pub fn step_recorded_on(&mut self, actions: &DeviceRows, tape: &mut DeviceTape) -> Result<()> {
        self.take_actions(actions)?;
        self.step_on_device(Some(tape))
    }

    fn take_actions(&mut self, actions: &DeviceRows) -> Result<()> {
        let spec = self.host.spec();
        let each = spec.n_agent * spec.action.len();
        let given = actions.given("actions", self.device.kind(), spec.n_env, each)?;
        (self.arguments.action, self.arguments.action_environment) = (given.at, given.environment);
        self.arguments.action_number = given.number;
        Ok(())
    }

    /// Actions are those that lie in its own array.
    fn take_own_actions(&mut self) {
        self.arguments.action = self.rows.action.address();
        self.arguments.action_environment = (self.rows.action.len() / self.spec().n_env) as i64;
        self.arguments.action_number = 1;
    }

    /// Actions of the host, to where its own lie.
    fn bring_actions(&mut self, actions: &[f32]) -> Result<()> {
        let wanted = self.rows.action.len();
        if actions.len() != wanted {
            let remedy = "Rows are [environment, agent, action], row-major.";
            return Err(Error::value("length of actions", actions.len(), wanted.to_string(), remedy));
        }
        self.take_own_actions();
        self.rows.action.write(actions)
    }

    /// Where an array of the last step or reset lies. It changes with the next one.
    pub fn array(&self, which: DeviceArray) -> DeviceRows {
        let (spec, kernels, rows) = (self.host.spec(), &self.kernels, &self.rows);
        let (e, a, stride) = (spec.n_env, spec.n_agent, rows.stride as i64);
        let device = self.device.kind();
        let floats = |array: &Array<f32>, row: usize, shape: Vec<usize>, strides: Vec<i64>| {
            array.lent(device, row * rows.stride, shape, strides)
        };
        let flags = |array: &Array<u8>| array.lent(device, 0, vec![e], vec![1]);
        let seen = |array, first| {
            let n = spec.n_observation;
            floats(array, first, vec![e, a, n], vec![1, n as i64 * stride, stride])
        };
        let plain = |array, rows: &Range<usize>| floats(array, rows.start, vec![e, rows.len()], vec![1, stride]);
        match which {
            DeviceArray::Observation => seen(&rows.work, kernels.observation.start),
            DeviceArray::FinalObservation => seen(&rows.final_observation, 0),
            DeviceArray::Reward => floats(&rows.work, kernels.reward, vec![e, a], vec![1, 0]),
            DeviceArray::Terminated => flags(&rows.terminated),
            DeviceArray::Truncated => flags(&rows.truncated),
            DeviceArray::Central => plain(&rows.work, &kernels.central),
            DeviceArray::FinalCentral => plain(&rows.final_central, &(0..kernels.central.len())),
            DeviceArray::Privileged => plain(&rows.kept, &kernels.privileged),
            DeviceArray::Info => plain(&rows.info, &(0..kernels.n_info)),
            DeviceArray::Action => {
                let n = spec.action.len();
                let strides = vec![(a * n) as i64, n as i64, 1];
                floats(&rows.action, 0, vec![e, a, n], strides)
            }
        }
    }

    /// As [`DeviceEnv::step`], remembered by the tape.
    ///
    /// # Errors
    /// As [`DeviceEnv::step`]; [`Error::Limit`] if the tape is full, [`Error::Value`] if it is of another environment.
    pub fn step_recorded(&mut self, actions: &[f32], tape: &mut DeviceTape) -> Result<()> {
        self.bring_actions(actions)?;
        self.step_on_device(Some(tape))
    }

    fn step_on_device(&mut self, tape: Option<&mut DeviceTape>) -> Result<()> {
        self.check_started()?;
        self.is_mirrored = false;
        match &tape {
            Some(tape) => {
                tape.place(&self.device, self.host.layout(), self.host.spec().n_env, &mut self.arguments)?;
                tape.keep_statistics(&self.rows.shared)?;
                // steps of another tape lie between, or of none
                if std::mem::take(&mut self.is_moved) || !tape.follows(self.recorded.as_ref()) {
                    self.rows.moved.fill(1)?;
                }
                self.launch(EnvKernel::Open)?;
            }
            None => self.is_moved = true,
        }
        self.launch(EnvKernel::Step)?;
        if self.kernels.kernels.contains(&EnvKernel::Event) {
            self.draft(&self.rows.due.read_if(self.kernels.draft.is_some())?, true)?;
            self.launch(EnvKernel::Event)?;
        }
        if let Some(tape) = tape {
            self.launch(EnvKernel::Close)?;
            tape.n_step += 1;
            self.recorded = Some(tape.last());
        }
        self.collect()?;
        self.begin(self.spec().config.autoreset == tasks::Autoreset::NextStep, true)
    }

    /// Begins episodes where they are marked; behind a step, stops those that ended in it.
    fn begin(&mut self, clears: bool, is_step: bool) -> Result<()> {
        self.is_remembered |= self.device.is_remembered();
        (self.arguments.clears, self.arguments.stops) = (u32::from(clears), u32::from(is_step));
        self.draft(&self.rows.restart.read_if(self.kernels.draft.is_some())?, false)?;
        self.launch(EnvKernel::Begin)?;
        self.collect()
    }

    /// Adds what was seen to the statistics.
    fn collect(&self) -> Result<()> {
        if self.arguments.collects == 1 && self.kernels.kernels.contains(&EnvKernel::Collect) {
            self.launch(EnvKernel::Collect)?;
        }
        Ok(())
    }

    fn launch(&self, kernel: EnvKernel) -> Result<()> {
        let n = self.spec().n_env;
        let n = if kernel == EnvKernel::Collect { n.div_ceil(BLOCK) * self.kernels.n_normalised } else { n };
        self.code.launch(kernel, n, &self.arguments)
    }

    /// Lets the host draft what begins where a task begins on it.
    fn draft(&mut self, marked: &[u8], is_event: bool) -> Result<()> {
        let Some(draws) = self.kernels.draft.clone() else { return Ok(()) };
        let chosen: Vec<usize> = (0..marked.len()).filter(|i| marked[*i] == 1).collect();
        if chosen.is_empty() {
            return Ok(());
        }
        self.mirror()?;
        self.is_mirrored = false;
        for i in chosen {
            let own = self.host.drafted(i, is_event);
            for (row, x) in draws.clone().zip(own) {
                self.rows.work.write_at(row * self.rows.stride + i, &[x])?;
            }
        }
        Ok(())
    }

    /// Brings the host's environments to where those of the device are.
    fn mirror(&mut self) -> Result<()> {
        if self.is_mirrored && !self.is_remembered {
            return Ok(());
        }
        let rows = EnvRows {
            stride: self.rows.stride,
            plant: self.rows.plant.read()?,
            kept: self.rows.kept.read()?,
            model: self.rows.model.read()?,
            seed: self.rows.seed.read()?,
            episode: self.rows.episode.read()?,
            started: self.started.clone(),
            sums: self.rows.sums.read()?,
        };
        self.host.set_rows(&rows);
        self.is_mirrored = true;
        Ok(())
    }

    /// As [`Env::observe`]: what the environments look like now; nothing moves on.
    ///
    /// # Errors
    /// As [`DeviceEnv::step`].
    pub fn observe(&mut self) -> Result<()> {
        self.check_started()?;
        self.launch(EnvKernel::Observe)
    }

    /// Shows environments that have begun elsewhere.
    fn look(&self) -> Result<()> {
        if self.check_started().is_ok() { self.launch(EnvKernel::Observe) } else { Ok(()) }
    }

    /// As [`Env::update_normaliser`].
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn update_normaliser(&mut self) -> Result<()> {
        self.mirror()?;
        self.host.update_normaliser();
        self.share()
    }

    /// As [`Env::set_statistics`].
    ///
    /// # Errors
    /// As there.
    pub fn set_statistics(&mut self, statistics: Statistics) -> Result<()> {
        self.mirror()?;
        self.host.set_statistics(statistics)?;
        self.share()
    }

    /// As [`Env::set_collecting`].
    pub fn set_collecting(&mut self, collects: bool) {
        self.host.set_collecting(collects);
        self.arguments.collects = u32::from(collects);
    }

    /// As [`Env::set_difficulty`].
    ///
    /// # Errors
    /// As there.
    pub fn set_difficulty(&mut self, share: f64) -> Result<()> {
        self.host.set_difficulty(share)?;
        self.arguments.difficulty = share;
        Ok(())
    }

    /// As [`Env::take_pending`].
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn take_pending(&mut self) -> Result<PendingStatistics> {
        self.mirror()?;
        self.rows.sums.write(&vec![0.0; self.rows.sums.len()])?;
        Ok(self.host.take_pending())
    }

    /// As [`Env::seed`].
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn seed(&mut self, seed: u64) -> Result<()> {
        self.rows.seed.write(&vec![seed; self.rows.stride])?;
        self.is_mirrored = false;
        self.rows.episode.write(&vec![0; self.rows.stride])
    }

    /// As [`Env::sample`].
    pub fn sample(&self, draw: u64, actions: &mut [f32]) {
        self.host.sample(draw, actions);
    }

    /// As [`Env::set_state`].
    ///
    /// # Errors
    /// As there.
    pub fn set_state(&mut self, environment: usize, state: &[f32]) -> Result<()> {
        self.mirror()?;
        self.host.set_state(environment, state)?;
        for (row, x) in state.iter().enumerate() {
            self.rows.plant.write_at(row * self.rows.stride + environment, &[*x])?;
        }
        self.rows.moved.write_at(environment, &[1])
    }

    /// What the host's environments share, to the device, with sums that begin anew.
    fn share(&mut self) -> Result<()> {
        self.rows.shared.write(&self.host.shared_numbers())?;
        self.rows.mean.write(&self.host.statistics().mean)?;
        self.rows.sums.write(&vec![0.0; self.rows.sums.len()])?;
        self.arguments.collects = u32::from(self.host.is_collecting());
        Ok(())
    }

    /// Continues from bytes of [`Env::save`].
    ///
    /// # Errors
    /// As [`Env::load`].
    pub fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.host.load(bytes)?;
        let own = self.host.rows();
        self.rows.plant.write(&own.plant)?;
        self.rows.kept.write(&own.kept)?;
        self.rows.model.write(&own.model)?;
        self.rows.seed.write(&own.seed)?;
        self.rows.episode.write(&own.episode)?;
        self.share()?;
        self.rows.sums.write(&own.sums)?;
        self.is_moved = true;
        self.arguments.difficulty = self.host.difficulty();
        (self.is_mirrored, self.started) = (true, own.started);
        self.look()?;
        self.device.settle()
    }

    fn check_started(&self) -> Result<()> {
        match self.started[..self.spec().n_env].iter().position(|own| !own) {
            None => Ok(()),
            Some(i) => {
                let remedy = "Reset all of them once.";
                Err(Error::value(format!("environment {i}"), "not started", "reset before the first step", remedy))
            }
        }
    }

    /// The same environments on the host, as they are now: states, goals, parameters, saving. What broke where one diverged
    /// ([`Env::breach`]) a device does not keep.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn on_host(&mut self) -> Result<&Env> {
        self.mirror()?;
        Ok(&self.host)
    }

    /// What the last step or reset told, on the host. Optional arrays are filled.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn buffers(&self) -> Result<Buffers> {
        let (spec, kernels) = (self.host.spec(), &self.kernels);
        let (n, rows, stride) = (spec.n_env, &self.rows, self.rows.stride);
        let (seen, central) = (kernels.observation.len(), kernels.central.len());
        let mut buffers = Buffers::new(spec);
        self.to_rows(&rows.work, kernels.observation.clone(), &mut buffers.observation)?;
        self.to_rows(&rows.work, kernels.central.clone(), &mut buffers.central)?;
        self.to_rows(&rows.kept, kernels.privileged.clone(), &mut buffers.privileged)?;
        self.to_rows(&rows.info, 0..kernels.n_info, &mut buffers.info)?;
        self.to_rows(&rows.final_observation, 0..seen, &mut buffers.final_observation)?;
        self.to_rows(&rows.final_central, 0..central, &mut buffers.final_central)?;
        let reward = &rows.work.read_at(kernels.reward * stride, n)?;
        buffers.reward.chunks_exact_mut(spec.n_agent).zip(reward).for_each(|(row, reward)| row.fill(*reward));
        buffers.terminated.copy_from_slice(&self.rows.terminated.read_at(0, n)?);
        buffers.truncated.copy_from_slice(&self.rows.truncated.read_at(0, n)?);
        Ok(buffers)
    }

    fn to_rows(&self, columns: &Array<f32>, rows: Range<usize>, to: &mut [f32]) -> Result<()> {
        let (stride, width) = (self.rows.stride, rows.len());
        let columns = columns.read_at(rows.start * stride, width * stride)?;
        for (i, own) in to.chunks_exact_mut(width.max(1)).enumerate() {
            own.iter_mut().enumerate().for_each(|(k, x)| *x = columns[k * stride + i]);
        }
        Ok(())
    }
}
