//! Time that runs out is not death: a critic that uses the arrays as documented finds the value, its defective twins do
//! not.

use omnidrones::tasks::probe::Probe;
use omnidrones::tasks::{Autoreset, Buffers, Env, EnvConfig, Record, evaluate};

const DISCOUNT: f64 = 0.99;

/// One step of the probe: what was seen, the reward, what is seen next, and how it ended.
struct Step {
    before: usize,
    reward: f64,
    after: usize,
    terminated: bool,
    truncated: bool,
}

/// Transitions as the contract describes them: the next observation is the final one where an episode ended.
fn collect(env: &mut Env, steps: usize, honest: bool) -> Vec<Vec<Step>> {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let n = env.spec().n_env;
    let mut seen: Vec<usize> = out.observation.iter().map(|x| *x as usize).collect();
    let mut told: Vec<Vec<Step>> = (0..n).map(|_| Vec::new()).collect();
    for _ in 0..steps {
        env.step(&vec![0.0; n * 4], &mut out.out()).unwrap();
        for i in 0..n {
            let (terminated, truncated) = (out.terminated[i] == 1, out.truncated[i] == 1);
            let last = if terminated || truncated { out.final_observation[i] } else { out.observation[i] };
            let (before, after, reward) = (seen[i], last as usize, f64::from(out.reward[i]));
            // the defective twin takes the cut for an end
            told[i].push(Step { before, reward, after, terminated: terminated || (!honest && truncated), truncated });
            seen[i] = out.observation[i] as usize;
        }
    }
    told
}

fn forever(n_env: usize) -> Env {
    let config = EnvConfig { n_env, autoreset: Autoreset::SameStep, ..EnvConfig::default() };
    Env::of(Probe::forever(&config).unwrap(), "forever", &config).unwrap()
}

fn either_or(n_env: usize) -> Env {
    let config = EnvConfig { n_env, autoreset: Autoreset::SameStep, ..EnvConfig::default() };
    Env::of(Probe::either_or(&config).unwrap(), "either_or", &config).unwrap()
}

/// Fixed point of one-step targets for the value of each kind.
fn one_step_value(told: &[Vec<Step>]) -> [f64; 2] {
    let mut value = [0.0; 2];
    for _ in 0..5000 {
        let (mut sum, mut count) = ([0.0; 2], [0.0; 2]);
        for step in told.iter().flatten() {
            let next = if step.terminated { 0.0 } else { value[step.after] };
            sum[step.before] += step.reward + DISCOUNT * next;
            count[step.before] += 1.0;
        }
        for kind in 0..2 {
            value[kind] = if count[kind] > 0.0 { sum[kind] / count[kind] } else { 0.0 };
        }
    }
    value
}

#[test]
fn a_cut_is_not_an_end_and_the_value_differs_tenfold() {
    let value = one_step_value(&collect(&mut forever(8), 200, true))[1];
    let defective = one_step_value(&collect(&mut forever(8), 200, false))[1];
    println!("value {value:.6}, of the twin {defective:.3}");
    assert!((value - 100.0).abs() < 1e-6); // measured 100.000000
    assert!((defective - 1.0 / (1.0 - 0.9 * DISCOUNT)).abs() < 1e-6); // 9.174
}

/// Generalised advantages (Schulman et al. 2016) of one environment, from its last step back.
fn advantages(told: &[Step], value: [f64; 2], cuts_trace: bool) -> Vec<f64> {
    let mut advantage = 0.0;
    let mut all: Vec<f64> = told
        .iter()
        .rev()
        .map(|step| {
            let next = if step.terminated { 0.0 } else { value[step.after] };
            let error = step.reward + DISCOUNT * next - value[step.before];
            let over = step.terminated || (cuts_trace && step.truncated);
            advantage = error + if over { 0.0 } else { DISCOUNT * 0.95 * advantage };
            advantage
        })
        .collect();
    all.reverse();
    all
}

#[test]
fn an_advantage_holds_no_reward_of_the_next_episode() {
    let told = collect(&mut either_or(64), 100, true);
    let value = one_step_value(&told);
    assert!(value[0].abs() < 1e-9 && (value[1] - 100.0).abs() < 1e-6, "{value:?}");
    // values of nothing: what is left in an advantage is rewards
    let of = |cuts| told.iter().map(move |own| (own, advantages(own, [0.0; 2], cuts)));
    let leak = |cuts| {
        let unpaid = of(cuts)
            .flat_map(|(own, a)| own.iter().zip(a).filter(|(s, _)| s.before == 0).map(|(_, a)| a).collect::<Vec<_>>());
        unpaid.fold(0.0_f64, |most, a| most.max(a.abs()))
    };
    println!("leak {:.3}, of the twin {:.3}", leak(true), leak(false));
    assert_eq!(leak(true), 0.0);
    assert!(leak(false) > 5.0); // measured 15.4
}

#[test]
fn a_task_without_metrics_is_evaluated_and_recorded() {
    let config = EnvConfig { n_env: 70, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    let mut env = Env::of(Probe::forever(&config).unwrap(), "forever", &config).unwrap();
    let mut record = Record::new(&env, 2);
    let still = &mut |_: &Env, _: &Buffers, actions: &mut [f32]| {
        actions.fill(0.0);
        Ok(())
    };
    let result = evaluate(&mut env, still, &mut |step| record.see(step)).unwrap();
    assert_eq!((result.return_mean, result.length), (10.0, 10.0));
    assert_eq!((result.final_error, result.mean_error, result.final_metrics.len()), (0.0, 0.0, 0));
    assert_eq!(record.lines, vec![vec![0.0; 10]; 2]);
}
