//! How well a policy flies from starts that training never sees.

use super::policy::Policy;
use base::error::Result;
use base::parallel::Threads;
use tasks::{self, Autoreset, Env, EnvConfig, Evaluation, EvaluationStep};

/// Which episodes are flown: the first ones of `n_env` environments of this seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Starts {
    /// Environments, one episode each.
    pub n_env: usize,
    /// Seed of their starts.
    pub seed: u64,
}

/// Environments of `task` at these starts in which `policy` can fly: as `env` but for number and seed, all beginning at
/// time 0, each for one episode, behind the statistics that the policy was trained with.
///
/// # Errors
/// As [`Policy::fits`] and [`Env::make`].
pub fn eval_env(policy: &Policy, task: &str, env: &EnvConfig, starts: Starts, threads: &Threads) -> Result<Env> {
    let config = EnvConfig {
        n_env: starts.n_env,
        seed: starts.seed,
        first_environment: 0,
        autoreset: Autoreset::Disabled,
        ..env.clone().whole_episodes()
    };
    let mut env = Env::make(task, &config)?;
    policy.fits(env.spec())?;
    env.set_threads(threads.clone());
    if let Some(statistics) = policy.statistics() {
        env.set_statistics(statistics.clone())?;
    }
    Ok(env)
}

/// Flies one episode of every environment; `watch` sees every step.
///
/// # Errors
/// As [`eval_env`] and [`tasks::evaluate()`].
pub fn evaluate(
    policy: &mut Policy,
    task: &str,
    env: &EnvConfig,
    starts: Starts,
    threads: &Threads,
    watch: &mut dyn FnMut(&EvaluationStep<'_>),
) -> Result<Evaluation> {
    let mut env = eval_env(policy, task, env, starts, threads)?;
    policy.set_threads(threads.clone());
    policy.reset();
    tasks::evaluate(&mut env, &mut |_, out, actions| policy.act(&out.observation, actions), watch)
}

#[cfg(test)]
mod tests {
    use super::super::nn::Layers;
    use super::super::policy::Actor;
    use super::*;
    use tasks::{ObservationTransform, Statistics};

    const STARTS: Starts = Starts { n_env: 70, seed: 5 };

    /// Weights alternate about 0; the last layer's biases hold the drone up for a while.
    fn policy(env: &EnvConfig, statistics: Option<Statistics>) -> Policy {
        let spec = Env::make("Hover", &EnvConfig { n_env: 1, ..env.clone() }).unwrap().spec().clone();
        let actor = Actor::new(&spec, &Layers { hidden: vec![8], ..Layers::default() }, true).unwrap();
        let parameters = (0..actor.n_parameter()).map(|i| 0.05 * ((i * i % 13) as f32 - 6.0)).collect();
        Policy::new(actor, parameters, statistics, &spec).unwrap()
    }

    fn short() -> EnvConfig {
        EnvConfig::from_toml("stagger = true\ntruncate_after = 10\ntask.horizon = 40", "short").unwrap()
    }

    #[test]
    fn episodes_begin_at_the_start_whatever_the_training_does_and_threads_do_not_count() {
        let fly = |env: &EnvConfig, n: usize| {
            let mut steps = 0;
            let threads = Threads::new(n).unwrap();
            let told = evaluate(&mut policy(env, None), "Hover", env, STARTS, &threads, &mut |_| steps += 1).unwrap();
            (told, steps)
        };
        let (told, steps) = fly(&short(), 1);
        assert_eq!((told.n_episode, steps), (70, 40));
        assert!(told.length > 5.0 && told.return_mean.is_finite());
        assert_eq!(
            fly(&EnvConfig { seed: 9, n_env: 3, first_environment: 7, truncate_after: 0, ..short() }, 2),
            (told, 40)
        );
    }

    #[test]
    fn other_environments_are_refused() {
        let other = EnvConfig { dt: 0.01, ..short() };
        let refused = eval_env(&policy(&short(), None), "Hover", &other, STARTS, &Threads::default());
        assert!(refused.err().unwrap().to_string().starts_with("hash of the environment is"));
    }

    #[test]
    fn a_policy_refuses_rows_that_are_not_its_own() {
        let mut own = policy(&short(), None);
        let n = own.actor().mlp.n_input();
        let mut act = |seen: usize, done: usize| own.act(&vec![0.0; seen], &mut vec![0.0; done]);
        assert!(act(2 * n, 8).is_ok() && act(0, 0).is_ok());
        for (seen, done, what) in [(2 * n, 4, "actions"), (n, 7, "actions"), (2 * n + 1, 8, "observations")] {
            let error = act(seen, done).unwrap_err().to_string();
            assert!(error.starts_with(&format!("length of {what} is ")), "{error}");
        }
    }

    #[test]
    fn statistics_of_the_policy_are_in_force_and_stay() {
        let env = EnvConfig { observation: vec![ObservationTransform::Normalise { clip: 10.0 }], ..short() };
        let n = policy(&env, None).actor().mlp.n_input();
        let known = Statistics { count: 10.0, mean: vec![0.5; n], variance: vec![4.0; n] };
        let mut own = policy(&env, Some(known.clone()));
        let mut stage = eval_env(&own, "Hover", &env, STARTS, &Threads::default()).unwrap();
        let act = &mut |_: &Env, out: &tasks::Buffers, actions: &mut [f32]| own.act(&out.observation, actions);
        let with = tasks::evaluate(&mut stage, act, &mut |_| {}).unwrap();
        assert_eq!(stage.statistics(), &known);
        let without =
            evaluate(&mut policy(&env, None), "Hover", &env, STARTS, &Threads::default(), &mut |_| {}).unwrap();
        assert_ne!(with.return_mean, without.return_mean);
    }
}
