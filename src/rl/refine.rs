//! How much more an episode held than a policy took from it: its flight, refined through the simulator.
//!
//! Offsets δ of every action of whole episodes, u_t = π(o_t) + δ_t, climb the gradient of the return
//!
//!   ∂R/∂δ_t = ∂R/∂u_t, where what lies behind depends on u_t through physics, observation and π,
//!
//! with all that is random in the episode known in advance. It is cut where it explodes ([`RefineConfig::adjoint_clip`]), and
//! silent about what readings of sensors without a gradient and an earlier end of the episode change.
//!
//! The policy stays in the loop: it catches what an offset disturbs, so that gradients stay tame over hundreds of steps, where those of
//! bare actions explode. The best flight of every episode is kept; so no return is below the policy's own.
//!
//! What is found is in reach of one who knows the future, a local optimum: a mark from below for the best return there is, and
//! for a policy, which knows less, a mark from above in all but name.

use super::checks::{check_counts, check_positive};
use super::nn::{Adam, AdamConfig, Memory, Pass, Scratch, Transposed, Weights};
use super::policy::{Policy, ROWS};
use super::shards::within_memory;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use base::parallel::Threads;
use serde::{Deserialize, Serialize};
use tasks::{Autoreset, Buffers, Column, Cotangents, Env, Seeds, Sweep, SweepOptions, Tape};

with_defaults! {
    /// Settings; the defaults suit every task of the registry.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct RefineConfig {
        /// Steps up the gradient; each flies all episodes once more. 1 to 65 536; default 200.
        pub iterations: usize = 200,
        /// First learning rate of Adam, of actions whose range is [−1, 1]; it falls to a tenth. > 0; default 0.01.
        pub learning_rate: f64 = 0.01,
        /// Largest norm, per environment, of the gradient that is carried back. > 0, infinite for none; default 100.
        pub adjoint_clip: f32 = 100.0,
    }
}

impl RefineConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] with the number, the rule and the remedy.
    pub fn validate(&self) -> Result<()> {
        check_counts(&[("iterations", self.iterations, 1 << 16)], "200 are usual.")?;
        check_positive(&[("learning_rate", self.learning_rate)], "0.01 is usual.")?;
        if self.adjoint_clip.is_nan() || self.adjoint_clip <= 0.0 {
            return Err(Error::value("adjoint_clip", self.adjoint_clip, "> 0", "100 is usual."));
        }
        Ok(())
    }
}

/// What the episodes came to, one per environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Refined {
    /// Steps up the gradient.
    pub iterations: usize,
    /// Returns as the policy flew, `[E]`.
    pub flown: Vec<f64>,
    /// Returns of the best flight that was found, `[E]`.
    pub best: Vec<f64>,
    /// Whether that flight was a success, `[E]`.
    pub success: Vec<bool>,
}

impl Refined {
    /// Means over the episodes: as the policy flew, and of the best flights.
    pub fn means(&self) -> (f64, f64) {
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        (mean(&self.flown), mean(&self.best))
    }

    /// Share of the best flights that were a success.
    pub fn success(&self) -> f64 {
        self.success.iter().filter(|reached| **reached).count() as f64 / self.success.len() as f64
    }

    /// The policy's own mean over the mean of the best flights; none where one of them is negative or both are 0.
    pub fn share(&self) -> Option<f64> {
        let (flown, best) = self.means();
        (flown >= 0.0 && best > 0.0).then(|| flown / best)
    }
}

/// Refines the flight of `policy` in the next episode of every environment of `env`, the first of one that is new
/// ([`eval_env`](super::eval_env)); `watch` is called with the number of flights done.
///
/// # Errors
/// As [`RefineConfig::validate`], [`Policy::fits`], [`Env::adjoint`] and [`Env::tape`]; [`Error::Value`] for a policy with a
/// memory or of a network for each agent and for environments that restart by themselves or do not report successes; [`Error::Limit`] for
/// episodes beyond [`EnvConfig::memory_limit`](tasks::EnvConfig::memory_limit).
pub fn refine(
    policy: &Policy,
    env: &mut Env,
    threads: &Threads,
    config: &RefineConfig,
    watch: &mut dyn FnMut(usize),
) -> Result<Refined> {
    config.validate()?;
    let mut flights = Flights::new(policy, env, threads, config)?;
    for iteration in 0..=config.iterations {
        flights.fly(env)?;
        watch(iteration + 1);
        if iteration < config.iterations {
            let done = iteration as f64 / config.iterations as f64;
            flights.climb(config.learning_rate * (1.0 - 0.9 * done))?;
        }
    }
    let Flights { flown, best, success, .. } = flights;
    Ok(Refined { iterations: config.iterations, flown, best, success })
}

/// The episodes, their offsets, and what a flight and its gradient need.
struct Flights<'a> {
    policy: &'a Policy,
    threads: Threads,
    transposed: Transposed,
    /// State and observation at the start.
    from: (Vec<u8>, Vec<f32>),
    out: Buffers,
    tape: Tape,
    sweep: Sweep,
    /// Before every step, `[T, E, A, observation]`.
    observation: Vec<f32>,
    /// What the policy wants, `[E, A, action]`.
    wanted: Vec<f32>,
    actions: Vec<f32>,
    /// δ, `[T, E, A, action]`.
    offset: Vec<f32>,
    gradient: Vec<f32>,
    adam: Adam,
    /// Whether an episode went on before a step, `[T, E]`.
    flying: Vec<bool>,
    /// Of the last flight.
    n_step: usize,
    d_action: Vec<f32>,
    d_observation: Vec<f32>,
    /// A network's, for every [`ROWS`] rows.
    passes: Vec<(Memory, Scratch)>,
    flown: Vec<f64>,
    best: Vec<f64>,
    success: Vec<bool>,
}

impl<'a> Flights<'a> {
    fn new(policy: &'a Policy, env: &mut Env, threads: &Threads, config: &RefineConfig) -> Result<Self> {
        let spec = env.spec().clone();
        policy.fits(&spec)?;
        if policy.n_state() > 0 {
            let remedy = "Refine a policy that sees a history instead.";
            return Err(Error::value("numbers that the policy remembers", policy.n_state(), "0 to refine", remedy));
        }
        if policy.actor().n_set() > 1 {
            let (sets, remedy) = (policy.actor().n_set(), "Refine a policy that agents share.");
            return Err(Error::value("number of networks of the policy", sets, "1 to refine", remedy));
        }
        if spec.config.autoreset != Autoreset::Disabled {
            return Err(Error::value(
                "autoreset",
                "on",
                "'disabled' to refine",
                "Build it with autoreset = 'disabled'.",
            ));
        }
        spec.needed_column(Column::Success)?;
        let adjoint = env.adjoint_of(false, Seeds { central: false, reward: true, loss: false })?;
        let (horizon, rows) = (spec.horizon, spec.n_env * spec.n_agent);
        let (n_seen, n_action) = (rows * spec.n_observation, rows * spec.action.len());
        let bytes = 4 * (n_seen as u128 + 4 * n_action as u128 + spec.n_env as u128) * horizon as u128;
        within_memory("steps of an episode", horizon, bytes, spec.config.memory_limit)?;
        let actor = policy.actor();
        let mut transposed = Transposed::default();
        actor.mlp.transpose(&policy.parameters()[..actor.mlp.n_parameter()], &mut transposed);
        let mut out = Buffers::new(&spec);
        env.reset(None, None, &mut out.out())?;
        let options = SweepOptions { clip: config.adjoint_clip, ..SweepOptions::default() };
        Ok(Self {
            policy,
            threads: threads.clone(),
            transposed,
            from: (env.save(), out.observation.clone()),
            tape: env.tape(horizon)?,
            sweep: adjoint.sweep(options),
            observation: vec![0.0; horizon * n_seen],
            wanted: vec![0.0; n_action],
            actions: vec![0.0; n_action],
            offset: vec![0.0; horizon * n_action],
            gradient: vec![0.0; horizon * n_action],
            adam: Adam::new(AdamConfig { beta2: 0.99, ..AdamConfig::default() }, horizon * n_action),
            flying: vec![false; horizon * spec.n_env],
            n_step: 0,
            d_action: vec![0.0; n_action],
            d_observation: vec![0.0; n_seen],
            passes: (0..rows.div_ceil(ROWS)).map(|_| (actor.mlp.memory(ROWS), actor.mlp.scratch(ROWS))).collect(),
            flown: Vec::new(),
            best: vec![f64::NEG_INFINITY; spec.n_env],
            success: vec![false; spec.n_env],
            out,
        })
    }

    /// Flies all episodes with the offsets as they are, which are first cut to what the range of actions leaves.
    fn fly(&mut self, env: &mut Env) -> Result<()> {
        env.load(&self.from.0)?;
        self.tape.clear();
        self.out.observation.copy_from_slice(&self.from.1);
        let (n_env, n_agent) = (env.spec().n_env, env.spec().n_agent);
        let (n_seen, n_action) = (self.d_observation.len(), self.d_action.len());
        let (n_info, reached) = (env.spec().info.len(), env.spec().needed_column(Column::Success)?);
        let (mut total, mut ended, mut success) = (vec![0.0_f64; n_env], vec![false; n_env], vec![false; n_env]);
        self.n_step = 0;
        for t in 0..env.spec().horizon {
            self.observation[t * n_seen..][..n_seen].copy_from_slice(&self.out.observation);
            self.act(t);
            let offset = &mut self.offset[t * n_action..][..n_action];
            for ((u, delta), wanted) in self.actions.iter_mut().zip(offset).zip(&self.wanted) {
                let within = wanted.clamp(-1.0, 1.0);
                *u = (within + *delta).clamp(-1.0, 1.0);
                *delta = *u - within;
            }
            env.step_recorded(&self.actions, &mut self.out.out(), &mut self.tape)?;
            for i in 0..n_env {
                self.flying[t * n_env + i] = !ended[i];
                if !ended[i] {
                    total[i] += f64::from(self.out.reward[i * n_agent]);
                    success[i] = self.out.terminated[i] == 0 && self.out.info[i * n_info + reached] > 0.5;
                    ended[i] = self.out.terminated[i] == 1 || self.out.truncated[i] == 1;
                }
            }
            self.n_step = t + 1;
            if !ended.contains(&false) {
                break;
            }
        }
        if self.flown.is_empty() {
            self.flown.clone_from(&total);
        }
        for i in 0..n_env {
            // a NaN is no maximum
            if total[i] > self.best[i] {
                (self.best[i], self.success[i]) = (total[i], success[i]);
            }
        }
        Ok(())
    }

    /// What the policy wants in step `t`.
    fn act(&mut self, t: usize) {
        let (actor, n_seen) = (self.policy.actor(), self.d_observation.len());
        let (n_in, n_out) = (actor.n_observation(), actor.n_action());
        let network = &self.policy.parameters()[..actor.mlp.n_parameter()];
        let rows = self.observation[t * n_seen..][..n_seen].chunks(ROWS * n_in);
        let mut parts: Vec<_> = rows.zip(self.wanted.chunks_mut(ROWS * n_out)).zip(&mut self.passes).collect();
        self.threads.for_each(&mut parts, |_, ((x, wanted), (memory, _))| {
            actor.mlp.forward(network, x, x.len() / n_in, memory).write(wanted);
        });
    }

    /// One step of Adam up the gradient of the returns of the flight that was flown last.
    fn climb(&mut self, rate: f64) -> Result<()> {
        self.sweep.restart();
        self.d_observation.fill(0.0);
        self.gradient.fill(0.0);
        let (n_env, n_action) = (self.best.len(), self.d_action.len());
        for t in (0..self.n_step).rev() {
            // downwards, as Adam goes
            let reward: Vec<f32> = self.flying[t * n_env..][..n_env].iter().map(|on| -f32::from(*on)).collect();
            let up = Cotangents { observation: &self.d_observation, reward: &reward, ..Cotangents::default() };
            self.sweep.pull(&self.tape, t, &up, &mut self.d_action)?;
            self.gradient[t * n_action..][..n_action].copy_from_slice(&self.d_action);
            self.pull_policy(t);
        }
        self.adam.descend(&mut self.offset, &self.gradient, rate);
        Ok(())
    }

    /// The gradient of actions in step `t`, through the policy to what it saw.
    fn pull_policy(&mut self, t: usize) {
        self.act(t);
        self.d_action.iter_mut().zip(&self.wanted).filter(|(_, u)| u.abs() > 1.0).for_each(|(d, _)| *d = 0.0);
        let (actor, n_seen) = (self.policy.actor(), self.d_observation.len());
        let (n_in, n_out) = (actor.n_observation(), actor.n_action());
        let parameters = &self.policy.parameters()[..actor.mlp.n_parameter()];
        let net = Weights { parameters, transposed: &self.transposed };
        let rows = self.observation[t * n_seen..][..n_seen].chunks(ROWS * n_in);
        let up = self.d_action.chunks(ROWS * n_out).zip(self.d_observation.chunks_mut(ROWS * n_in));
        let mut parts: Vec<_> = rows.zip(up).zip(&mut self.passes).collect();
        self.threads.for_each(&mut parts, |_, ((x, (d_action, grad_input)), (memory, scratch))| {
            let pass = Pass { gradient: &mut [], grad_input, scratch };
            actor.mlp.backward(net, x, x.len() / n_in, memory, d_action, pass);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::nn::Layers;
    use super::super::policy::Actor;
    use super::*;
    use rng::{Purpose, Stream};
    use tasks::{EnvConfig, evaluate};

    const N_ENV: usize = 3;

    fn env(task: &str, more: &str) -> Env {
        let config = EnvConfig::from_toml(&format!("autoreset = 'disabled'\n{more}"), "test").unwrap();
        Env::make(task, &EnvConfig { n_env: N_ENV, seed: 3, ..config }).unwrap()
    }

    /// Random weights about the safe command.
    fn policy(env: &Env, layers: &Layers) -> Policy {
        let actor = Actor::with_memory(env.spec(), layers, false).unwrap();
        let mut stream = Stream::new(9, 0, 0, Purpose::LEARNING);
        let mut parameters = actor.mlp.init(&mut stream);
        parameters.resize(actor.n_parameter(), 0.0);
        Policy::of(&actor, &parameters, env).unwrap()
    }

    fn small() -> Layers {
        Layers { hidden: vec![16], ..Layers::default() }
    }

    #[test]
    fn returns_rise_and_begin_at_those_of_the_policy() {
        for task in ["Hover", "Track", "PayloadHover"] {
            let (mut env, mut again) = (env(task, "task.horizon = 60"), env(task, "task.horizon = 60"));
            let mut own = policy(&env, &small());
            let config = RefineConfig { iterations: 40, ..RefineConfig::default() };
            let told = refine(&own, &mut env, &Threads::new(1).unwrap(), &config, &mut |_| {}).unwrap();
            let seen = evaluate(&mut again, &mut |_, out, actions| own.act(&out.observation, actions), &mut |_| {});
            let (flown, best) = told.means();
            println!("{task} {flown} {best}");
            assert!((flown - seen.unwrap().return_mean).abs() < 1e-4 * flown.abs());
            assert_eq!(told.success.len(), N_ENV);
            assert!(told.flown.iter().zip(&told.best).all(|(flown, best)| best > flown));
            assert!(told.share().is_some_and(|share| share < 0.98), "{task}: {:?}", told.share());
        }
    }

    #[test]
    fn the_gradient_of_offsets_is_that_of_differences_with_the_policy_in_the_loop() {
        let mut env = env("Hover", "task.horizon = 30");
        let own = policy(&env, &small());
        let threads = Threads::new(1).unwrap();
        let config = RefineConfig { adjoint_clip: f32::INFINITY, ..RefineConfig::default() };
        let mut flights = Flights::new(&own, &mut env, &threads, &config).unwrap();
        flights.fly(&mut env).unwrap();
        assert!(flights.flying.iter().all(|on| *on), "no flight may end within a difference");
        flights.climb(0.0).unwrap();
        let gradient = flights.gradient.clone();
        let size = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        let mut at = |h: f64| {
            let moved = gradient.iter().map(|g| (h / size * f64::from(*g)) as f32);
            flights.offset.iter_mut().zip(moved).for_each(|(offset, moved)| *offset = moved);
            flights.best.fill(f64::NEG_INFINITY);
            flights.fly(&mut env).unwrap();
            flights.best.iter().sum::<f64>()
        };
        let slope = (at(0.02) - at(-0.02)) / 0.04;
        let off = (slope + size).abs() / size;
        println!("{slope} {size} {off:.1e}");
        assert!(off < 4e-3, "{slope} against {size}"); // measured 4.1e-4
    }

    #[test]
    fn threads_change_no_bit_and_offsets_stay_within_the_range_of_actions() {
        // three blocks of environments, three parts of rows
        let fly = |n: usize| {
            let config = EnvConfig::from_toml("autoreset = 'disabled'\ntask.horizon = 20", "test").unwrap();
            let mut env = Env::make("Track", &EnvConfig { n_env: 130, seed: 3, ..config }).unwrap();
            let (own, threads) = (policy(&env, &small()), Threads::new(n).unwrap());
            env.set_threads(threads.clone());
            let config = RefineConfig { iterations: 5, learning_rate: 1.0, ..RefineConfig::default() };
            let mut flights = Flights::new(&own, &mut env, &threads, &config).unwrap();
            for _ in 0..4 {
                flights.fly(&mut env).unwrap();
                assert!(flights.actions.iter().all(|u| u.abs() <= 1.0));
                flights.climb(1.0).unwrap();
            }
            flights.best
        };
        assert_eq!(fly(1), fly(2));
    }

    #[test]
    fn what_cannot_be_refined_is_refused() {
        let threads = Threads::new(1).unwrap();
        let told = |env: &mut Env, layers: &Layers, config: RefineConfig| {
            let own = policy(env, layers);
            refine(&own, env, &threads, &config, &mut |_| {}).unwrap_err().to_string()
        };
        let usual = RefineConfig::default;
        let mut hover = env("Hover", "");
        assert!(told(&mut hover, &small(), RefineConfig { iterations: 0, ..usual() }).starts_with("iterations is 0"));
        let slow = RefineConfig { learning_rate: f64::NAN, ..usual() };
        assert!(told(&mut hover, &small(), slow).starts_with("learning_rate is NaN"));
        let memory: Layers = toml::from_str("memory = { kind = 'gru', units = 8 }").unwrap();
        assert!(told(&mut hover, &memory, usual()).starts_with("numbers that the policy remembers is 8"));
        let mut restarting = Env::make("Hover", &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        assert!(told(&mut restarting, &small(), usual()).starts_with("autoreset is on"));
    }
}
