//! How well a task can be flown at all: actions that are planned through the simulator itself.
//!
//! In every step, the actions of the next H steps of every environment go down the exact gradient of what those steps cost,
//! from the true state, with the true numbers of the episode and whatever is random in it; the first actions of the best plan
//! are flown, and the next plan begins from its rest (receding-horizon optimal control by single shooting; Mayne et al. 2000
//! for the scheme, the gradients are those of [`Env::adjoint`]).
//!
//! No policy knows as much, so what a planner flies is a mark for policies: episodes that it loses too need not be in reach
//! of anybody. It is no bound: plans are local optima, and what lies behind H steps they do not see. The defaults suit free
//! drones; what falls over by itself wants shorter plans and larger steps (64 and 0.02).

use super::checks::{check_counts, check_positive};
use super::nn::{Adam, AdamConfig};
use super::shards::within_memory;
use super::window::TrainingObjective;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use tasks::{Autoreset, Baseline, Buffers, Column, Cotangents, Env, Seeds, Sweep, SweepOptions, Tape};

/// How often the last step of a flight that is lost costs, beyond all steps of a plan.
const LOST: f32 = 1000.0;

with_defaults! {
    /// Settings; the defaults plan two seconds ahead in steps of 16 ms.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PlannerConfig {
        /// H, steps of a plan. 1 to 65 536; default 128.
        pub horizon: usize = 128,
        /// Steps down the gradient before the first action. 1 to 65 536; default 80.
        pub first_iterations: usize = 80,
        /// Steps down the gradient before every other action. 1 to 65 536; default 8.
        pub iterations: usize = 8,
        /// Learning rate of actions, whose range is [−1, 1]. > 0; default 0.005.
        pub learning_rate: f64 = 0.005,
        /// What is minimised. Default the task's loss.
        pub objective: TrainingObjective = TrainingObjective::Loss,
        /// Steps that the last one of a plan stands for: what comes behind it costs too. > 0; default 20.
        pub beyond: f32 = 20.0,
        /// Largest norm, per environment, of the gradient that is carried back: what tumbles would not be caught otherwise.
        /// > 0, infinite for none; default 100.
        pub adjoint_clip: f32 = 100.0,
    }
}

impl PlannerConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        let [first, more] = [self.first_iterations, self.iterations];
        check_counts(
            &[("first_iterations", first, 1 << 16), ("iterations", more, 1 << 16), ("horizon", self.horizon, 1 << 16)],
            "80, 8 and 128 are usual.",
        )?;
        let numbers = [("learning_rate", self.learning_rate), ("beyond", self.beyond.into())];
        check_positive(&numbers, "0.005 and 20 are usual.")?;
        if self.adjoint_clip.is_nan() || self.adjoint_clip <= 0.0 {
            return Err(Error::value("adjoint_clip", self.adjoint_clip, "> 0", "100 is usual."));
        }
        Ok(())
    }
}

/// Plans for one episode of every environment of a batch.
pub struct Planner {
    config: PlannerConfig,
    /// The batch in which plans are tried.
    twin: Env,
    out: Buffers,
    tape: Tape,
    sweep: Sweep,
    /// `[H, E, A, command]`.
    plan: Vec<f32>,
    /// The cheapest so far, environment by environment.
    best: Vec<f32>,
    least: Vec<f64>,
    adam: Adam,
    gradient: Vec<f32>,
    /// `[H, E]`: what a step costs, and how often it counts.
    weight: Vec<f32>,
    begun: bool,
}

impl Planner {
    /// For batches like `twin`, at the beginning of their episodes; `twin` itself is what plans are tried in.
    ///
    /// # Errors
    /// As [`PlannerConfig::validate`], [`Env::tape`] and [`Env::adjoint`]; [`Error::Limit`] for plans beyond
    /// [`EnvConfig::memory_limit`](tasks::EnvConfig::memory_limit); [`Error::Value`] for environments that restart by
    /// themselves or do not report losses and reasons.
    pub fn new(twin: Env, config: PlannerConfig) -> Result<Self> {
        config.validate()?;
        let spec = twin.spec();
        if spec.config.autoreset != Autoreset::Disabled {
            let remedy = "Build it with autoreset = 'disabled'.";
            return Err(Error::value("autoreset", "on", "'disabled' to plan", remedy));
        }
        spec.needed_column(Column::Loss)?;
        spec.needed_column(Column::Reason)?;
        let (n_env, n_action) = (spec.n_env, numbers_of_a_step(&twin));
        let of_step = 6 * n_action as u128 + n_env as u128 * (1 + twin.layout().n_kept()) as u128;
        let bytes = 4 * of_step * config.horizon as u128;
        within_memory("steps of a plan", config.horizon, bytes, spec.config.memory_limit)?;
        let n_step = n_action * config.horizon;
        let (reward, loss) =
            (config.objective == TrainingObjective::Reward, config.objective == TrainingObjective::Loss);
        let adjoint = twin.adjoint_of(false, Seeds { central: false, reward, loss })?;
        let options = SweepOptions { clip: config.adjoint_clip, ..SweepOptions::default() };
        let adam = AdamConfig { beta2: 0.99, ..AdamConfig::default() };
        Ok(Self {
            out: Buffers::new(spec),
            tape: twin.tape(config.horizon)?,
            sweep: adjoint.sweep(options),
            plan: vec![0.0; n_step],
            best: vec![0.0; n_step],
            least: vec![f64::INFINITY; n_env],
            adam: Adam::new(adam, n_step),
            gradient: vec![0.0; n_step],
            weight: vec![0.0; n_env * config.horizon],
            begun: false,
            twin,
            config,
        })
    }

    /// Its settings.
    pub fn config(&self) -> &PlannerConfig {
        &self.config
    }

    /// Actions of all environments, `[E, A, action]` in [−1, 1], for the state as it is.
    ///
    /// # Errors
    /// [`Error::Format`] for an environment of another configuration; [`Error::Value`] for actions of the wrong length;
    /// otherwise as [`Env::step`].
    pub fn act(&mut self, env: &Env, actions: &mut [f32]) -> Result<()> {
        let n = numbers_of_a_step(&self.twin);
        if actions.len() != n {
            let remedy = "Rows are [environment, agent, action], row-major.";
            return Err(Error::value("length of actions", actions.len(), n.to_string(), remedy));
        }
        let from = env.save();
        let iterations = if self.begun { self.config.iterations } else { self.config.first_iterations };
        if self.begun {
            self.shift(n);
        } else {
            self.begin(&from)?;
        }
        self.least.fill(f64::INFINITY);
        for iteration in 0..=iterations {
            self.fly(&from)?;
            if iteration < iterations {
                self.descend()?;
            }
        }
        self.plan.copy_from_slice(&self.best);
        actions.copy_from_slice(&self.best[..n]);
        Ok(())
    }

    /// The flight of our controller, where it has one and acts on what policies act on; otherwise all at the safe command.
    fn begin(&mut self, from: &[u8]) -> Result<()> {
        self.twin.load(from)?;
        self.begun = true;
        let n = numbers_of_a_step(&self.twin);
        let Ok(mut controller) = Baseline::new(&self.twin) else {
            let safe = self.twin.safe_command().iter().cycle();
            self.plan.iter_mut().zip(safe).for_each(|(a, safe)| *a = *safe as f32);
            return Ok(());
        };
        for actions in self.plan.chunks_exact_mut(n) {
            controller.act(&self.twin, actions)?;
            self.twin.step(actions, &mut self.out.out())?;
        }
        Ok(())
    }

    /// One step on: the last actions stay.
    fn shift(&mut self, n: usize) {
        for row in [&mut self.plan, &mut self.adam.mean, &mut self.adam.square] {
            row.copy_within(n.., 0);
            let last = row.len() - n;
            if last >= n {
                row.copy_within(last - n..last, last);
            }
        }
    }

    /// Flies the plan, weighs its steps, and keeps it for the environments for which it is the cheapest.
    fn fly(&mut self, from: &[u8]) -> Result<()> {
        let Self { config, twin, out, tape, plan, best, least, weight, .. } = self;
        twin.load(from)?;
        tape.clear();
        let spec = twin.spec();
        let (n_env, n_agent, n_info) = (spec.n_env, spec.n_agent, spec.info.len());
        let (loss, reason) = (spec.needed_column(Column::Loss)?, spec.needed_column(Column::Reason)?);
        let diverged = (spec.ends.len() + 1) as f32;
        let n = plan.len() / config.horizon;
        let (mut total, mut ended) = (vec![0.0_f64; n_env], vec![false; n_env]);
        for (t, actions) in plan.chunks_exact(n).enumerate() {
            twin.step_recorded(actions, &mut out.out(), tape)?;
            let behind = if t + 1 == config.horizon { config.beyond } else { 1.0 };
            for i in 0..n_env {
                let weight = &mut weight[t * n_env + i];
                *weight = 0.0;
                if ended[i] {
                    continue;
                }
                let info = &out.info[i * n_info..][..n_info];
                let lost = out.terminated[i] == 1;
                let cost = match config.objective {
                    TrainingObjective::Loss if info[reason] == diverged => f32::INFINITY,
                    TrainingObjective::Loss => info[loss],
                    TrainingObjective::Reward => -out.reward[i * n_agent],
                };
                // rewards just end
                *weight = match config.objective {
                    TrainingObjective::Loss if lost => LOST + config.horizon as f32 + config.beyond,
                    TrainingObjective::Reward if lost => 1.0,
                    _ => behind,
                };
                total[i] += f64::from(*weight * cost);
                ended[i] = lost || out.truncated[i] == 1;
            }
        }
        let each = n / n_env;
        for (i, total) in total.into_iter().enumerate() {
            // NaN is worse than all
            if total < least[i] || least[i].is_infinite() {
                least[i] = if total.is_nan() { f64::INFINITY } else { total };
                for t in 0..config.horizon {
                    let own = t * n + i * each..t * n + (i + 1) * each;
                    best[own.clone()].copy_from_slice(&plan[own]);
                }
            }
        }
        Ok(())
    }

    /// One step of Adam down the gradient of the plan that was flown last; actions stay within their range.
    fn descend(&mut self) -> Result<()> {
        let Self { config, tape, sweep, plan, adam, gradient, weight, .. } = self;
        sweep.restart();
        let (n_env, n) = (weight.len() / config.horizon, plan.len() / config.horizon);
        let mut d_reward = vec![0.0; n_env];
        for t in (0..config.horizon).rev() {
            let weight = &weight[t * n_env..][..n_env];
            d_reward.iter_mut().zip(weight).for_each(|(d, w)| *d = -w);
            let up = match config.objective {
                TrainingObjective::Loss => Cotangents { loss: weight, ..Cotangents::default() },
                TrainingObjective::Reward => Cotangents { reward: &d_reward, ..Cotangents::default() },
            };
            sweep.pull(tape, t, &up, &mut gradient[t * n..][..n])?;
        }
        adam.descend(plan, gradient, config.learning_rate);
        plan.iter_mut().for_each(|a| *a = a.clamp(-1.0, 1.0));
        Ok(())
    }
}

/// Of all actions together.
fn numbers_of_a_step(env: &Env) -> usize {
    let spec = env.spec();
    spec.n_env * spec.n_agent * spec.action.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tasks::{Autoreset, EnvConfig, evaluate};

    fn fresh(task: &str, n_env: usize) -> Env {
        let config = EnvConfig { n_env, seed: 3, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
        Env::make(task, &config).unwrap()
    }

    fn env(task: &str, n_env: usize) -> Env {
        let mut env = fresh(task, n_env);
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        env
    }

    fn planner(task: &str, n_env: usize, config: PlannerConfig) -> Planner {
        Planner::new(env(task, n_env), config).unwrap()
    }

    #[test]
    fn plans_cost_less_than_the_flight_they_begin_from() {
        for (task, objective) in [
            ("Hover", TrainingObjective::Loss),
            ("Hover", TrainingObjective::Reward),
            ("PayloadHover", TrainingObjective::Loss),
        ] {
            let config = PlannerConfig { horizon: 24, first_iterations: 12, objective, ..PlannerConfig::default() };
            let (own, mut planner) = (env(task, 3), planner(task, 3, config));
            let before = own.save();
            planner.begin(&before).unwrap();
            planner.fly(&before).unwrap();
            let begun = planner.least.clone();
            (planner.begun, planner.least) = (false, vec![f64::INFINITY; 3]);
            let mut actions = vec![0.0; 3 * 4];
            planner.act(&own, &mut actions).unwrap();
            assert!(actions.iter().all(|a| (-1.0..=1.0).contains(a)));
            for (least, begun) in planner.least.iter().zip(&begun) {
                // PayloadHover's plans know the push that the controller does not
                assert!(least < begun, "{task} {objective:?}: {least} from {begun}");
            }
        }
    }

    #[test]
    fn a_planner_that_looks_far_enough_ahead_flies_hover() {
        let config = PlannerConfig { first_iterations: 40, iterations: 4, ..PlannerConfig::default() };
        let (mut own, mut planner) = (fresh("Hover", 4), planner("Hover", 4, config));
        let told = evaluate(&mut own, &mut |env, _, actions| planner.act(env, actions), &mut |_| {}).unwrap();
        println!("{told:?}");
        assert_eq!((told.crashed, told.success), (0.0, 1.0));
    }

    #[test]
    fn what_cannot_be_planned_for_is_refused() {
        let told = |config: PlannerConfig| Planner::new(env("Hover", 1), config).err().unwrap().to_string();
        let usual = PlannerConfig::default;
        assert!(told(PlannerConfig { horizon: 0, ..usual() }).starts_with("horizon is 0"));
        assert!(told(PlannerConfig { learning_rate: 0.0, ..usual() }).starts_with("learning_rate is 0"));
        assert!(told(PlannerConfig { beyond: f32::NAN, ..usual() }).starts_with("beyond is NaN"));
        let restarting = Env::make("Hover", &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        assert!(Planner::new(restarting, usual()).err().unwrap().to_string().starts_with("autoreset is on"));
        let (mut one, other) = (planner("Hover", 1, usual()), env("Track", 1));
        assert!(one.act(&other, &mut [0.0; 4]).unwrap_err().to_string().contains("configuration"));
        assert!(one.act(&other, &mut [0.0; 3]).unwrap_err().to_string().starts_with("length of actions is 3"));
    }
}
