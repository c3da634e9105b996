//! Whether an environment keeps its contract: what learners rely on, checked on any task, also one's own.

use super::{Buffers, Column, Env, Space};
use crate::config::{Autoreset, EnvConfig};
use base::error::Result;

/// One claim about an environment, and a counterexample where there is one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What should hold.
    pub claim: &'static str,
    /// The first case where it does not; `None` where it holds in all.
    pub objection: Option<String>,
}

/// Steps that every claim is tried over.
const STEPS: usize = 120;
/// Not a multiple of a block: the last one is padded.
const N_ENV: usize = 70;

/// Checks the contract of the environment that `make` builds from a configuration, with random actions.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::{Env, EnvConfig, check_env};
/// let findings = check_env(&|config| Env::make("Hover", config), &EnvConfig::default())?;
/// assert!(findings.iter().all(|f| f.objection.is_none()));
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
///
/// # Errors
/// As `make`.
pub fn check_env(make: &dyn Fn(&EnvConfig) -> Result<Env>, config: &EnvConfig) -> Result<Vec<Finding>> {
    check_env_for(STEPS, make, config)
}

/// As [`check_env`] over another number of steps.
///
/// # Errors
/// As `make`.
pub fn check_env_for(
    steps: usize,
    make: &dyn Fn(&EnvConfig) -> Result<Env>,
    config: &EnvConfig,
) -> Result<Vec<Finding>> {
    let config = EnvConfig { n_env: N_ENV, ..config.clone().whole_episodes() };
    let maker = Maker { steps, make, config };
    type Check = fn(&Maker<'_>) -> Result<Option<String>>;
    let checks: [(&'static str, Check); 9] = [
        ("numbers are finite and rewards within their bounds", finite_and_bounded),
        ("a seed decides everything, and seeds differ where starts do", seeded),
        ("episodes begin in bounds: safe commands survive a step", begins_alive),
        ("the three autoreset modes tell the same episodes", modes_agree),
        ("the final observation is that of an environment that does not restart", final_observation),
        ("time is over after `horizon` steps, not before", truncates),
        ("the return is the sum of rewards, length the number of steps", accounts),
        ("a saved environment continues with the same bits", continues),
        ("hostile actions are counted and do no harm", survives),
    ];
    let mut findings = Vec::new();
    for (claim, check) in checks {
        findings.push(Finding { claim, objection: check(&maker)? });
    }
    Ok(findings)
}

struct Maker<'a> {
    steps: usize,
    make: &'a dyn Fn(&EnvConfig) -> Result<Env>,
    config: EnvConfig,
}

/// An environment with its arrays.
struct Bench {
    env: Env,
    out: Buffers,
    actions: Vec<f32>,
}

impl Maker<'_> {
    fn bench(&self, mode: Autoreset) -> Result<Bench> {
        let env = (self.make)(&EnvConfig { autoreset: mode, ..self.config.clone() })?;
        let spec = env.spec();
        let n_action = spec.n_env * spec.n_agent * spec.action.len();
        let mut bench = Bench { out: Buffers::new(spec), actions: vec![0.0; n_action], env };
        bench.env.reset(None, None, &mut bench.out.out())?;
        Ok(bench)
    }
}

impl Bench {
    fn random(&mut self, draw: usize) -> Result<()> {
        self.env.sample(draw as u64, &mut self.actions);
        self.env.step(&self.actions, &mut self.out.out())
    }

    fn ended(&self) -> Vec<bool> {
        self.out.terminated.iter().zip(&self.out.truncated).map(|(a, b)| a | b == 1).collect()
    }

    /// Numbers of one environment's observations.
    fn row(&self) -> usize {
        self.out.observation.len() / self.env.spec().n_env
    }

    fn observed(&self, i: usize) -> &[f32] {
        &self.out.observation[i * self.row()..(i + 1) * self.row()]
    }

    fn last_observed(&self, i: usize) -> &[f32] {
        &self.out.final_observation[i * self.row()..(i + 1) * self.row()]
    }
}

fn finite_and_bounded(maker: &Maker<'_>) -> Result<Option<String>> {
    let mut b = maker.bench(Autoreset::SameStep)?;
    let bound = b.env.spec().reward_bound as f32 * (1.0 + 1e-6);
    // a diverged step is worth 0
    let floor = (b.env.spec().reward_floor as f32 * (1.0 + 1e-6)).min(0.0);
    for t in 0..maker.steps {
        b.random(t)?;
        let arrays = [&b.out.observation, &b.out.reward, &b.out.central, &b.out.privileged, &b.out.info];
        let names = ["observation", "reward", "central", "privileged", "info"];
        for (name, array) in names.iter().zip(arrays) {
            if let Some(i) = array.iter().position(|x| !x.is_finite()) {
                return Ok(Some(format!("{name}[{i}] is {} in step {t}", array[i])));
            }
        }
        if let Some(i) = b.out.reward.iter().position(|r| !(floor..=bound).contains(r)) {
            return Ok(Some(format!("reward {} of agent {i} in step {t}, not in {floor} … {bound}", b.out.reward[i])));
        }
    }
    Ok(None)
}

fn seeded(maker: &Maker<'_>) -> Result<Option<String>> {
    let (mut a, mut b) = (maker.bench(Autoreset::SameStep)?, maker.bench(Autoreset::SameStep)?);
    let first = a.out.observation.clone();
    for t in 0..maker.steps {
        a.random(t)?;
        b.random(t)?;
        if a.out != b.out {
            return Ok(Some(format!("two runs of one seed differ in step {t}")));
        }
    }
    let seeds = vec![maker.config.seed; a.env.spec().n_env];
    a.env.reset(None, Some(&seeds), &mut a.out.out())?;
    if a.out.observation != first {
        return Ok(Some("a reset with the seed does not give the first observation again".into()));
    }
    let others = vec![maker.config.seed + 1; a.env.spec().n_env];
    a.env.reset(None, Some(&others), &mut a.out.out())?;
    // a task may begin every episode alike
    let drawn = (1..maker.config.n_env).any(|i| first[..a.row()] != first[i * a.row()..(i + 1) * a.row()]);
    Ok((drawn && a.out.observation == first).then(|| "another seed gives the same start".into()))
}

fn begins_alive(maker: &Maker<'_>) -> Result<Option<String>> {
    let mut b = maker.bench(Autoreset::SameStep)?;
    for t in 0..20 {
        let all = vec![true; b.env.spec().n_env];
        b.env.reset(Some(&all), None, &mut b.out.out())?;
        b.actions.fill(f32::NAN);
        b.env.step(&b.actions, &mut b.out.out())?;
        if let Some(i) = b.out.terminated.iter().position(|x| *x == 1) {
            return Ok(Some(format!("environment {i} of start {t} ended in its first step")));
        }
    }
    Ok(None)
}

/// What `NextStep` should tell is what `SameStep` told, with a step put in at every end.
fn modes_agree(maker: &Maker<'_>) -> Result<Option<String>> {
    let (mut a, mut c) = (maker.bench(Autoreset::SameStep)?, maker.bench(Autoreset::NextStep)?);
    let n = a.env.spec().n_env;
    let per_env = a.actions.len() / n;
    // per environment and step: observation, reward, whether it ended, last observation
    type Told = (Vec<f32>, f32, bool, Vec<f32>);
    let mut told: Vec<Vec<Told>> = vec![Vec::new(); n];
    for t in 0..maker.steps {
        a.random(t)?;
        let ended = a.ended();
        for i in 0..n {
            let agent = i * a.env.spec().n_agent;
            told[i].push((a.observed(i).to_vec(), a.out.reward[agent], ended[i], a.last_observed(i).to_vec()));
        }
    }
    let (mut counts, mut pending) = (vec![0; n], vec![false; n]);
    for t in 0..maker.steps {
        for (i, own) in c.actions.chunks_mut(per_env).enumerate() {
            c.env.sample_one(counts[i] as u64, i, own);
        }
        c.env.step(&c.actions, &mut c.out.out())?;
        let ended = c.ended();
        for i in 0..n {
            let reward = c.out.reward[i * c.env.spec().n_agent];
            let of = |k: usize| &told[i][k];
            if pending[i] {
                let (first, ..) = of(counts[i] - 1);
                if ended[i] || reward != 0.0 || c.observed(i) != &first[..] {
                    return Ok(Some(format!("environment {i}, call {t}: not a clean restart in the next step")));
                }
                pending[i] = false;
                continue;
            }
            let (seen, wanted, end, last) = of(counts[i]);
            let shown = if *end { last } else { seen };
            if (reward, ended[i]) != (*wanted, *end) || c.observed(i) != &shown[..] {
                return Ok(Some(format!("environment {i}, call {t}: another step than in the same-step mode")));
            }
            (counts[i], pending[i]) = (counts[i] + 1, *end);
        }
    }
    Ok(None)
}

fn final_observation(maker: &Maker<'_>) -> Result<Option<String>> {
    let (mut a, mut b) = (maker.bench(Autoreset::SameStep)?, maker.bench(Autoreset::Disabled)?);
    let mut ends = 0;
    for t in 0..maker.steps {
        a.random(t)?;
        b.random(t)?;
        let (ended, same) = (a.ended(), b.ended());
        if ended != same || a.out.reward != b.out.reward {
            return Ok(Some(format!("other ends or rewards in step {t}")));
        }
        for i in (0..ended.len()).filter(|i| ended[*i]) {
            ends += 1;
            if a.last_observed(i) != b.observed(i) {
                return Ok(Some(format!("another final observation of environment {i} in step {t}")));
            }
        }
        b.env.reset(Some(&ended), None, &mut b.out.out())?;
        if a.out.observation != b.out.observation {
            return Ok(Some(format!("other observations behind step {t}")));
        }
    }
    // a longer episode may survive them all
    let must = a.env.spec().horizon <= maker.steps;
    Ok((must && ends == 0)
        .then(|| format!("no episode ended in {} steps, at most {} long", maker.steps, a.env.spec().horizon)))
}

fn truncates(maker: &Maker<'_>) -> Result<Option<String>> {
    let mut b = maker.bench(Autoreset::SameStep)?;
    let spec = b.env.spec().clone();
    let (length, width) = (spec.needed_column(Column::Length)?, spec.info.len());
    for t in 0..maker.steps {
        b.random(t)?;
        for i in 0..spec.n_env {
            let steps = b.out.info[i * width + length] as usize;
            if (b.out.truncated[i] == 1) != (steps >= spec.horizon) {
                return Ok(Some(format!("environment {i} after {steps} steps: truncated {}", b.out.truncated[i])));
            }
        }
    }
    Ok(None)
}

fn accounts(maker: &Maker<'_>) -> Result<Option<String>> {
    let mut b = maker.bench(Autoreset::SameStep)?;
    let spec = b.env.spec().clone();
    let (total, length) = (spec.needed_column(Column::Return)?, spec.needed_column(Column::Length)?);
    let width = spec.info.len();
    let (mut returns, mut lengths) = (vec![0.0_f32; spec.n_env], vec![0.0_f32; spec.n_env]);
    for t in 0..maker.steps {
        b.random(t)?;
        let ended = b.ended();
        for i in 0..spec.n_env {
            returns[i] += b.out.reward[i * spec.n_agent];
            lengths[i] += 1.0;
            let row = &b.out.info[i * width..];
            let (told, wanted) = ((row[total], row[length]), (returns[i], lengths[i]));
            if told != wanted {
                return Ok(Some(format!("environment {i}, step {t}: {told:?} told, not {wanted:?}")));
            }
            if ended[i] {
                (returns[i], lengths[i]) = (0.0, 0.0);
            }
        }
    }
    Ok(None)
}

fn continues(maker: &Maker<'_>) -> Result<Option<String>> {
    let (mut a, mut b) = (maker.bench(Autoreset::SameStep)?, maker.bench(Autoreset::SameStep)?);
    for t in 0..maker.steps / 3 {
        a.random(t)?;
    }
    b.random(0)?;
    let (saved, seen) = (a.env.save(), a.out.clone());
    b.env.load(&saved)?;
    // one that was never reset
    let env = (maker.make)(&EnvConfig { autoreset: Autoreset::SameStep, ..maker.config.clone() })?;
    let mut fresh = Bench { out: Buffers::new(env.spec()), actions: a.actions.clone(), env };
    if let Err(error) = fresh.env.load(&saved) {
        return Ok(Some(format!("a fresh environment does not take the bytes: {error}")));
    }
    fresh.env.observe(&mut fresh.out.out())?;
    if fresh.out.privileged != seen.privileged {
        return Ok(Some("other physical numbers behind the restore".into()));
    }
    for t in maker.steps / 3..maker.steps {
        a.random(t)?;
        let saved = a.env.save();
        for (other, name) in [(&mut b, "one that was stepped"), (&mut fresh, "a fresh one")] {
            other.random(t)?;
            let (x, y) = (&a.out, &other.out);
            let same = x.observation == y.observation && x.reward == y.reward && x.central == y.central;
            let same = same && x.info == y.info && x.privileged == y.privileged && saved == other.env.save();
            if !same {
                return Ok(Some(format!("{name} differs {} steps after the restore", t + 1 - maker.steps / 3)));
            }
        }
    }
    Ok(None)
}

fn survives(maker: &Maker<'_>) -> Result<Option<String>> {
    let mut b = maker.bench(Autoreset::SameStep)?;
    let hostile = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-40, 7.0, -7.0];
    let spec = b.env.spec().clone();
    let (clipped, width) = (spec.needed_column(Column::Clipped)?, spec.info.len());
    let n = b.actions.len() / spec.n_env;
    let fits = |a: &f32| match spec.action {
        Space::Box { low, high, .. } => (low..=high).contains(a),
        Space::Discrete { n } | Space::MultiDiscrete { levels: n, .. } => Space::Discrete { n }.contains(&[*a]),
    };
    for t in 0..maker.steps {
        for (k, a) in b.actions.iter_mut().enumerate() {
            *a = hostile[(k + t) % hostile.len()];
        }
        b.env.step(&b.actions, &mut b.out.out())?;
        let arrays = [&b.out.observation, &b.out.reward, &b.out.central, &b.out.info];
        if arrays.into_iter().flatten().any(|x| !x.is_finite()) {
            return Ok(Some(format!("a number that is not finite in step {t}")));
        }
        let ended = b.ended();
        for (i, own) in b.actions.chunks(n).enumerate() {
            let agents = own.chunks(spec.action.len()).enumerate();
            let moving = agents.flat_map(|(agent, own)| &own[..spec.n_action_of(agent)]);
            let wanted = moving.filter(|a| !fits(a)).count();
            let counted = b.out.info[i * width + clipped] as usize;
            if counted != wanted {
                let when = if ended[i] { "an episode\'s last step" } else { "a step" };
                return Ok(Some(format!("environment {i}: {counted} clips counted of {wanted} in {when}")));
            }
        }
    }
    Ok(None)
}
