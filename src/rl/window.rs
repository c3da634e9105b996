//! A window of steps under a deterministic policy, and the exact gradient of its cost: what APG and SHAC share.

use super::learner::Episodes;
use super::nn::elementwise::add;
use super::nn::{Memory, Pass, Scratch, Weights};
use super::policy::Actor;
use super::shards::{Shard, episodes, within_memory};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};
use tasks::{Adjoint, Column, Cotangents, Env, Seeds, StepOut, Sweep, SweepOptions, Tape};

/// What is minimised in every step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrainingObjective {
    /// The task's smooth training loss.
    #[default]
    Loss,
    /// The negative reward.
    Reward,
}

/// A shard with what its windows need; nothing is allocated after its making.
pub struct Window {
    /// The environments.
    pub shard: Shard,
    /// In the order of time.
    pub steps: Vec<WindowStep>,
    tape: Tape,
    sweep: Sweep,
    objective: TrainingObjective,
    /// Largest norm of the gradient of an environment's actions in a step; infinite for none.
    pub action_clip: f32,
    scratch: Scratch,
    d_action: Vec<f32>,
    d_reward: Vec<f32>,
    d_observation: Vec<f32>,
    gradient: Vec<f32>,
    /// Of the last window.
    pub stats: WindowStats,
}

/// One step of a window, E environments and A agents.
pub struct WindowStep {
    /// Before it, `[E, A, observation]`.
    pub observation: Vec<f32>,
    /// `[E, A, action]`.
    pub action: Vec<f32>,
    /// What is minimised, `[E]`; NaN where the state diverged.
    pub cost: Vec<f32>,
    /// Where episodes ended, `[E]`.
    pub terminated: Vec<u8>,
    /// Likewise, `[E]`.
    pub truncated: Vec<u8>,
    /// Where they did, what was seen last, `[E, A, observation]`.
    pub final_observation: Vec<f32>,
    /// The numbers of the step's episodes, `[E, privileged]`; empty without [`Window::see_privileged`].
    pub privileged: Vec<f32>,
    /// ∂L/∂cost, `[E]`.
    pub weight: Vec<f32>,
    /// ∂L/∂final_observation, or empty.
    pub d_final: Vec<f32>,
    /// Rows whose observation was not finite: they see zeros, and no gradient passes them.
    pub masked: Vec<usize>,
    memory: Memory,
}

/// Figures of one shard and window: sums over environments and steps, but for `saturated`, a share.
#[derive(Debug, Clone, Copy, Default)]
pub struct WindowStats {
    /// What is minimised; rows that diverged are left out.
    pub cost: f64,
    /// Of one agent per environment.
    pub reward: f64,
    /// Share of hidden units beyond ±0.99 in the last step.
    pub saturated: f64,
    /// Rows and gradients that were not finite.
    pub dropped: usize,
    /// Seconds.
    flying: f64,
    /// Those that ended.
    pub episodes: Episodes,
}

impl WindowStats {
    /// How much of the time of all windows, flown side by side, they flew rather than swept.
    pub fn time_flying(&self, windows: Duration) -> Duration {
        windows.mul_f64((self.flying / windows.as_secs_f64()).clamp(0.0, 1.0))
    }

    fn add(&mut self, other: &Self) {
        self.cost += other.cost;
        self.reward += other.reward;
        self.saturated += other.saturated;
        self.dropped += other.dropped;
        self.flying += other.flying;
        self.episodes.add(&other.episodes);
    }
}

/// Takes in what every window came to, in order: gradients are added up in `gradient`. `saturated` and `flying` become means
/// over the windows.
///
/// # Errors
/// The first that a window met.
pub fn gather<'a>(
    windows: impl ExactSizeIterator<Item = (&'a Window, Option<Error>)>,
    gradient: &mut [f32],
) -> Result<WindowStats> {
    let n = windows.len() as f64;
    let mut seen = WindowStats::default();
    gradient.fill(0.0);
    for (window, failed) in windows {
        if let Some(error) = failed {
            return Err(error);
        }
        add(gradient, &window.gradient);
        seen.add(&window.stats);
    }
    (seen.saturated, seen.flying) = (seen.saturated / n, seen.flying / n);
    Ok(seen)
}

/// Whether windows of `horizon` steps fit for so many shards like this one.
///
/// # Errors
/// [`Error::Limit`] otherwise.
pub(crate) fn check_windows(shard: &Env, n_shard: usize, actor: &Actor, horizon: usize) -> Result<()> {
    let spec = shard.spec();
    let row = 3 * spec.n_observation + spec.action.len() + actor.mlp.n_activation();
    let tape = shard.layout().n_taped().div_ceil(spec.n_agent);
    let n_agent = spec.n_env as u128 * spec.n_agent as u128;
    let of_shard = (row + tape) as u128 * n_agent * horizon as u128 + actor.n_parameter() as u128;
    within_memory("window", horizon, 4 * n_shard as u128 * of_shard, spec.config.memory_limit)
}

/// Windows of `horizon` steps for all shards. Their adjoint program is derived once.
///
/// # Errors
/// [`Error::Limit`] for more memory than environments may take; otherwise as [`Env::adjoint`](tasks::Env::adjoint).
pub fn windows(
    shards: Vec<Shard>,
    actor: &Actor,
    horizon: usize,
    objective: TrainingObjective,
    options: SweepOptions,
) -> Result<Vec<Window>> {
    let mut adjoint: Option<(usize, Adjoint)> = None;
    if let Some(first) = shards.first() {
        check_windows(&first.env, shards.len(), actor, horizon)?;
    }
    let each = shards.into_iter().map(|shard| {
        let n = shard.env.spec().n_env;
        // all but the last are of one size
        let program = match adjoint.take() {
            Some((size, program)) if size == n => program,
            _ => {
                let (reward, loss) = (objective == TrainingObjective::Reward, objective == TrainingObjective::Loss);
                shard.env.adjoint_of(false, Seeds { central: false, reward, loss })?
            }
        };
        let window = Window::new(shard, &program, actor, horizon, objective, options);
        adjoint = Some((n, program));
        window
    });
    each.collect()
}

impl Window {
    fn new(
        shard: Shard,
        adjoint: &Adjoint,
        actor: &Actor,
        horizon: usize,
        objective: TrainingObjective,
        options: SweepOptions,
    ) -> Result<Self> {
        let spec = shard.env.spec();
        let (n_env, rows) = (spec.n_env, spec.n_env * spec.n_agent);
        let (n_seen, n_action) = (rows * spec.n_observation, rows * spec.action.len());
        let tape = shard.env.tape(horizon)?;
        let step = || WindowStep {
            observation: vec![0.0; n_seen],
            action: vec![0.0; n_action],
            cost: vec![0.0; n_env],
            terminated: vec![0; n_env],
            truncated: vec![0; n_env],
            final_observation: vec![0.0; n_seen],
            privileged: Vec::new(),
            weight: vec![0.0; n_env],
            d_final: Vec::new(),
            masked: Vec::with_capacity(rows),
            memory: actor.mlp.memory(rows),
        };
        Ok(Self {
            steps: (0..horizon).map(|_| step()).collect(),
            tape,
            sweep: adjoint.sweep(options),
            objective,
            action_clip: f32::INFINITY,
            scratch: actor.mlp.scratch(rows),
            d_action: vec![0.0; n_action],
            d_reward: vec![0.0; n_env],
            d_observation: vec![0.0; n_seen],
            gradient: vec![0.0; actor.n_parameter()],
            stats: WindowStats::default(),
            shard,
        })
    }

    /// Keeps the numbers that differ between environments, step by step.
    pub fn see_privileged(&mut self) {
        let n = self.shard.out.privileged.len();
        self.steps.iter_mut().for_each(|step| step.privileged.resize(n, 0.0));
    }

    /// Rows of a step: one per environment and agent.
    pub fn rows(&self) -> usize {
        self.shard.out.reward.len()
    }

    /// Flies on from where the last window stopped.
    ///
    /// # Errors
    /// As [`Env::step_recorded`](tasks::Env::step_recorded).
    pub fn fly(&mut self, actor: &Actor, net: Weights<'_>) -> Result<()> {
        let begun = Instant::now();
        let (rows, objective) = (self.rows(), self.objective);
        let Shard { env, out } = &mut self.shard;
        let (loss, reason) = (env.spec().needed_column(Column::Loss)?, env.spec().needed_column(Column::Reason)?);
        let diverged = (env.spec().ends.len() + 1) as f32;
        let (n_info, n_agent) = (env.spec().info.len(), env.spec().n_agent);
        self.stats = WindowStats::default();
        self.tape.clear();
        for step in &mut self.steps {
            step.observation.copy_from_slice(&out.observation);
            mask_nonfinite(&mut step.observation, rows, &mut step.masked);
            actor.mlp.forward(net.parameters, &step.observation, rows, &mut step.memory).write(&mut step.action);
            let n_known = step.privileged.len();
            step.privileged.copy_from_slice(&out.privileged[..n_known]);
            let mut to = StepOut { central: &mut [], final_central: &mut [], ..out.out() };
            if n_known == 0 {
                to.privileged = &mut [];
            }
            env.step_recorded(&step.action, &mut to, &mut self.tape)?;
            for (i, cost) in step.cost.iter_mut().enumerate() {
                let info = &out.info[i * n_info..][..n_info];
                *cost = match objective {
                    // a state that diverged has no loss: 0 would make it the best of ends
                    TrainingObjective::Loss if info[reason] == diverged => f32::NAN,
                    TrainingObjective::Loss => info[loss],
                    TrainingObjective::Reward => -out.reward[i * n_agent],
                };
            }
            step.terminated.copy_from_slice(&out.terminated);
            step.truncated.copy_from_slice(&out.truncated);
            if out.terminated.contains(&1) || out.truncated.contains(&1) {
                step.final_observation.copy_from_slice(&out.final_observation);
            }
            self.stats.cost += step.cost.iter().filter(|x| x.is_finite()).map(|x| f64::from(*x)).sum::<f64>();
            self.stats.dropped += step.masked.len();
            self.stats.reward += out.reward.iter().step_by(n_agent).map(|x| f64::from(*x)).sum::<f64>();
            self.stats.episodes.add(&episodes(env.spec(), out)?);
        }
        if let Some(step) = self.steps.last() {
            self.stats.saturated = actor.mlp.saturated(&step.memory, rows, 0.99);
        }
        self.stats.flying = begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// The gradient of L with respect to the actor's parameters, from the weights of the steps, their `d_final`, and
    /// ∂L/∂(the observation behind the window), which may be empty.
    ///
    /// # Errors
    /// As [`Sweep::pull`].
    pub fn sweep(&mut self, actor: &Actor, net: Weights<'_>, d_last: &[f32]) -> Result<&[f32]> {
        let rows = self.rows();
        self.sweep.restart();
        self.gradient.fill(0.0);
        self.d_observation.fill(0.0);
        self.d_observation[..d_last.len()].copy_from_slice(d_last);
        let n_action = self.d_action.len() / rows;
        let (gradient, _) = self.gradient.split_at_mut(actor.mlp.n_parameter());
        for (t, step) in self.steps.iter_mut().enumerate().rev() {
            let (loss, reward): (&[f32], &[f32]) = match self.objective {
                TrainingObjective::Loss => (&step.weight, &[]),
                TrainingObjective::Reward => {
                    self.d_reward.iter_mut().zip(&step.weight).for_each(|(reward, weight)| *reward = -weight);
                    (&[], &self.d_reward)
                }
            };
            let (observation, final_observation) = (&self.d_observation, &step.d_final);
            let up = Cotangents { observation, final_observation, loss, reward, ..Cotangents::default() };
            self.sweep.pull(&self.tape, t, &up, &mut self.d_action)?;
            step.masked.iter().for_each(|row| self.d_action[row * n_action..][..n_action].fill(0.0));
            clip_each(&mut self.d_action, step.weight.len(), self.action_clip);
            let grad_input = &mut self.d_observation;
            let pass = Pass { gradient: &mut *gradient, grad_input, scratch: &mut self.scratch };
            actor.mlp.backward(net, &step.observation, rows, &step.memory, &self.d_action, pass);
        }
        self.stats.dropped += self.sweep.dropped();
        Ok(&self.gradient)
    }
}

/// Cuts each of `n` equal parts of `x` to the norm `most`, where that is finite.
fn clip_each(x: &mut [f32], n: usize, most: f32) {
    if most.is_infinite() {
        return;
    }
    let each = x.len() / n;
    for own in x.chunks_exact_mut(each) {
        let norm = own.iter().map(|x| x * x).sum::<f32>().sqrt();
        if norm > most {
            own.iter_mut().for_each(|x| *x *= most / norm);
        }
    }
}

/// Zeros in rows with a number that is not finite, whose places `masked` gets.
pub(crate) fn mask_nonfinite(x: &mut [f32], rows: usize, masked: &mut Vec<usize>) {
    masked.clear();
    let n = x.len() / rows;
    for (k, row) in x.chunks_exact_mut(n).enumerate() {
        // 0 where all is finite, else NaN
        if row.iter().map(|x| 0.0 * x).sum::<f32>().is_nan() {
            row.fill(0.0);
            masked.push(k);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Layers, Transposed};
    use crate::shards::shards;
    use rng::{Purpose, Stream};
    use tasks::{Env, EnvConfig};

    /// Σ cost · weight of a window from a saved state.
    fn cost(window: &mut Window, actor: &Actor, parameters: &[f32], from: &(Vec<u8>, Vec<f32>)) -> f64 {
        window.shard.env.load(&from.0).unwrap();
        window.shard.out.observation.copy_from_slice(&from.1);
        window.fly(actor, Weights { parameters, transposed: &Transposed::default() }).unwrap();
        let of = |s: &WindowStep| s.cost.iter().zip(&s.weight).map(|(c, w)| f64::from(*c) * f64::from(*w)).sum::<f64>();
        window.steps.iter().map(of).sum()
    }

    #[test]
    fn the_gradient_of_a_window_is_that_of_differences_along_random_directions() {
        for (task, objective) in [
            ("Hover", TrainingObjective::Loss),
            ("Hover", TrainingObjective::Reward),
            ("Track", TrainingObjective::Loss),
        ] {
            let config = EnvConfig { n_env: 16, seed: 5, ..EnvConfig::default() };
            let shard = shards(&|config| Env::make(task, config), &config, 16).unwrap().remove(0);
            let actor = Actor::new(shard.env.spec(), &Layers { hidden: vec![16], ..Layers::default() }, true).unwrap();
            let mut stream = Stream::new(9, 0, 0, Purpose::LEARNING);
            let mut p = actor.mlp.init(&mut stream);
            p.resize(actor.n_parameter(), 0.0);
            let mut window = windows(vec![shard], &actor, 12, objective, SweepOptions::default()).unwrap().remove(0);
            window.steps.iter_mut().for_each(|step| step.weight.fill(1.0 / 192.0));
            let from = (window.shard.env.save(), window.shard.out.observation.clone());
            let mut transposed = Transposed::default();
            actor.mlp.transpose(&p, &mut transposed);
            cost(&mut window, &actor, &p, &from);
            let gradient =
                window.sweep(&actor, Weights { parameters: &p, transposed: &transposed }, &[]).unwrap().to_vec();
            assert!(gradient.iter().any(|g| g.abs() > 1e-4));
            for direction in 0..4 {
                // along the gradient itself first, then random
                let d: Vec<f32> = if direction == 0 {
                    gradient.clone()
                } else {
                    gradient.iter().map(|g| g + (0.02 * stream.normal()) as f32 * f32::from(*g != 0.0)).collect()
                };
                let size = d.iter().map(|d| f64::from(*d).powi(2)).sum::<f64>().sqrt();
                let h = 3e-3 / size;
                let mut at = |h: f64| {
                    let moved: Vec<f32> = p.iter().zip(&d).map(|(p, d)| p + (h * f64::from(*d)) as f32).collect();
                    cost(&mut window, &actor, &moved, &from)
                };
                let differences = (at(h) - at(-h)) / (2.0 * h);
                let exact: f64 = gradient.iter().zip(&d).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
                let off = (differences - exact).abs() / exact.abs();
                println!("{task} {objective:?} {exact:.4e} {off:.1e}");
                // in f32, along directions in which the cost is curved
                assert!(off < 2e-2, "{task}: {exact} against {differences}"); // measured at most 5.4e-3
            }
        }
    }

    #[test]
    fn what_is_cut_keeps_its_direction_and_its_neighbours() {
        let mut x = [3.0, 4.0, 0.25, 0.5, -6.0, 8.0];
        clip_each(&mut x, 3, 2.5);
        assert_eq!(x, [1.5, 2.0, 0.25, 0.5, -1.5, 2.0]);
        clip_each(&mut x, 3, f32::INFINITY);
        assert_eq!(x[0], 1.5);
    }

    #[test]
    fn rows_that_are_not_finite_are_seen_as_zeros() {
        let mut x = vec![1.0, 2.0, f32::NAN, 4.0, f32::INFINITY, 6.0, 7.0, 8.0];
        let mut masked = Vec::new();
        mask_nonfinite(&mut x, 4, &mut masked);
        assert_eq!(x, [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 7.0, 8.0]);
        assert_eq!(masked, [1, 2]);
    }
}
