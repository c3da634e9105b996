//! The contract, bit for bit.

use crate::{config, everywhere};
use omnidrones::controllers::cascade::Level;
use omnidrones::parallel::Threads;
use omnidrones::tasks::{ActionSpace, Buffers, Delay, Env, EnvConfig, check_env, registry};

#[test]
fn every_task_keeps_the_contract_in_every_control_mode() {
    everywhere(70, 40, |name, make, config| {
        for finding in check_env(&|c| Ok(make(c)), config).unwrap() {
            assert_eq!(finding.objection, None, "{name}: {}", finding.claim);
        }
    });
}

/// Everything that transforms: a delay that differs, history, noise, normalisation, privileged numbers, randomisation.
pub(crate) fn transformed(base: &EnvConfig) -> EnvConfig {
    let text = "
        delay = { min = 0, max = 3 }
        observation = [
            { kind = 'noise', std = 0.02 },
            { kind = 'history', steps = 3 },
            { kind = 'normalise' },
            { kind = 'privileged' },
        ]
        [[randomise]]
        what = 'mass'
        range = [0.8, 1.2]
        [[randomise]]
        what = 'inertia'
        range = [0.5, 1.5]
        each = true
        [[randomise]]
        what = 'thrust'
        range = [0.9, 1.1]
        each = true
        [[randomise]]
        what = 'wind'
        range = [-1.0, 1.0]
        by = 'set'
        [[randomise]]
        what = 'motor_time'
        range = [0.8, 1.2]
        when = 'startup'
    ";
    let own = EnvConfig::from_toml(text, "transformed").unwrap();
    EnvConfig { n_env: base.n_env, task: base.task.clone(), control: base.control, ..own }
}

#[test]
fn transforms_delays_and_randomisation_keep_the_contract() {
    for task in ["Hover", "Track"] {
        for control in [Level::Rotor, Level::Rate] {
            let config = transformed(&EnvConfig { control, ..config(70, 40) });
            for finding in check_env(&|c| Env::make(task, c), &config).unwrap() {
                assert_eq!(finding.objection, None, "{task}: {}", finding.claim);
            }
        }
    }
}

#[test]
fn discrete_actions_keep_the_contract() {
    for actions in [ActionSpace::Discrete { levels: 2 }, ActionSpace::MultiDiscrete { levels: 5 }] {
        let config = EnvConfig { actions, delay: Delay { min: 1, max: 1 }, ..config(70, 40) };
        for finding in check_env(&|c| Env::make("Hover", c), &config).unwrap() {
            assert_eq!(finding.objection, None, "{}", finding.claim);
        }
    }
}

/// Steps with random actions; all arrays of the last step, and the sum of all rewards.
fn run(env: &mut Env, first: usize, total: usize, steps: u64) -> (Buffers, f64) {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let per_env = env.spec().n_agent * env.spec().action.len();
    // drawn for the whole batch, of which this may be a part
    let mut all = vec![0.0; total * per_env];
    let mut rewards = 0.0;
    let n_env = env.spec().n_env;
    let whole = Env::make(&env.spec().task, &EnvConfig { n_env: 1, ..env.spec().config.clone() });
    let sampler = EnvConfig { first_environment: 0, n_env: 1, ..whole.unwrap().spec().config.clone() };
    let sampler = Env::make(&env.spec().task, &sampler).unwrap();
    for t in 0..steps {
        sampler.sample(t, &mut all);
        env.step(&all[first * per_env..(first + n_env) * per_env], &mut out.out()).unwrap();
        rewards += out.reward.iter().map(|r| f64::from(*r)).sum::<f64>();
    }
    (out, rewards)
}

/// Part of the arrays that belongs to environments `first` ….
fn part(
    out: &Buffers,
    spec: &omnidrones::tasks::Spec,
    first: usize,
    n: usize,
) -> (Vec<f32>, Vec<f32>, Vec<u8>, Vec<f32>) {
    let (a, o, i) = (spec.n_agent, spec.n_agent * spec.n_observation, spec.info.len());
    (
        out.observation[first * o..(first + n) * o].to_vec(),
        out.reward[first * a..(first + n) * a].to_vec(),
        out.terminated[first..first + n].to_vec(),
        out.info[first * i..(first + n) * i].to_vec(),
    )
}

#[test]
fn threads_shards_and_places_in_the_batch_change_no_bit() {
    for entry in registry::REGISTRY {
        let light = ["Hover", "Track", "HoverRand", "TrackRand"].contains(&entry.name);
        let (n, steps) = if light { (4096, 60) } else { (512, 30) };
        let base = config(n, 25);
        let make = |c: &EnvConfig| entry.env(c).unwrap();
        let mut whole = make(&base);
        whole.set_threads(Threads::new(1).unwrap());
        let (reference, _) = run(&mut whole, 0, n, steps);
        for threads in [2, 8] {
            let mut env = make(&base);
            env.set_threads(Threads::new(threads).unwrap());
            assert!(run(&mut env, 0, n, steps).0 == reference, "{} on {threads} threads", entry.name);
        }
        // four shards, and one that begins within a block
        let quarter = n / 4;
        for (first, count) in
            [(0, quarter), (quarter, quarter), (2 * quarter, quarter), (3 * quarter, quarter), (17, 70)]
        {
            let shard = EnvConfig { n_env: count, first_environment: first as u64, ..base.clone() };
            let (own, _) = run(&mut make(&shard), first, n, steps);
            let spec = whole.spec();
            assert!(part(&own, spec, 0, count) == part(&reference, spec, first, count), "{} from {first}", entry.name);
        }
    }
}

#[test]
fn configurations_with_transforms_do_not_depend_on_threads_either() {
    let base = transformed(&config(1024, 25));
    let results: Vec<Buffers> = [1, 2, 8]
        .into_iter()
        .map(|threads| {
            let mut env = Env::make("Hover", &base).unwrap();
            env.set_threads(Threads::new(threads).unwrap());
            let out = run(&mut env, 0, 1024, 30).0;
            env.update_normaliser();
            assert!(env.statistics().count > 30_000.0);
            let after = run(&mut env, 0, 1024, 5).0;
            assert!(after != out);
            after
        })
        .collect();
    assert!(results[0] == results[1] && results[1] == results[2]);
}

#[test]
fn tables_in_the_documentation_are_those_of_the_code() {
    for entry in registry::REGISTRY.iter().filter(|e| e.defaults.is_empty()) {
        let env = entry.env(&EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        let tables = env.sheet().tables();
        let documented: Vec<&str> = entry
            .source
            .lines()
            .map_while(|l| l.strip_prefix("//!"))
            .map(|l| l.strip_prefix(' ').unwrap_or(l))
            .collect();
        let missing = tables.lines().find(|line| !line.is_empty() && !documented.contains(line));
        if std::env::var_os("PRINT_TABLES").is_some() {
            println!("=== {}\n{tables}", entry.name);
        } else {
            assert_eq!(missing, None, "{}: run with PRINT_TABLES=1 and paste", entry.name);
        }
    }
}

#[test]
fn the_ideal_state_reaches_the_bound_of_the_reward() {
    for entry in registry::REGISTRY {
        let env = entry.env(&EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        for (term, value) in env.spec().reward.iter().zip(env.ideal_terms()) {
            let off = (term.bound - value).abs();
            assert!(term.name == "effort" || off < 1e-6, "{} {}: {value} of {}", entry.name, term.name, term.bound);
        }
    }
}

#[test]
fn every_entry_reads_its_defaults_and_has_a_name_of_its_own() {
    let names = registry::names();
    for entry in registry::REGISTRY {
        entry.default_config().unwrap();
        assert_eq!(names.iter().filter(|n| n.eq_ignore_ascii_case(entry.name)).count(), 1);
    }
}
