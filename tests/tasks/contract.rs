//! The contract, bit for bit.

use crate::{config, count, everywhere};
use omnidrones::controllers::cascade::Level;
use omnidrones::dynamics::tree::body_poses;
use omnidrones::internals::check_env_for;
use omnidrones::parallel::Threads;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{ActionSpace, Autoreset, Baseline, Buffers, Delay, Env, EnvConfig, Spec, check_env, registry};

#[test]
fn every_task_keeps_the_contract_in_every_control_mode() {
    // three episodes each
    everywhere(70, 20, |name, make, config| {
        for finding in check_env_for(60, &|c| Ok(make(c)), config).unwrap() {
            assert_eq!(finding.objection, None, "{name}: {}", finding.claim);
        }
    });
}

#[test]
#[ignore = "STEPS=1000 cargo test --release --test tasks contract -- --ignored --nocapture: five minutes, as many steps"]
fn every_task_keeps_the_contract_in_every_control_mode_for_a_thousand_steps() {
    let steps = count("STEPS", 1000) as usize;
    everywhere(70, 40, |name, make, config| {
        for finding in check_env_for(steps, &|c| Ok(make(c)), config).unwrap() {
            assert_eq!(finding.objection, None, "{name}: {}", finding.claim);
        }
    });
}

/// The trail that `watch` draws, and what a user plots beside a target.
#[test]
fn what_a_reference_leads_is_the_load_and_not_its_drones() {
    for entry in registry::REGISTRY {
        let mut env = entry.env(&config(2, 40)).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let Some(led) = env.reference(0).unwrap().filter(|led| led.references.len() == 1) else { continue };
        let Some(system) = env.robot().plant().tree() else { continue };
        let at = led.follower.unwrap_or_else(|| panic!("{}: nothing is led", entry.name));
        let state: Vec<f64> = env.state(0).unwrap().iter().map(|x| f64::from(*x)).collect();
        let poses = body_poses(system, &state);
        for drone in env.robot().drones() {
            let [x, y, z] = poses[drone.frame].position;
            let apart = (x - at[0]).hypot(y - at[1]).hypot(z - at[2]);
            // a rod is 0.2 m at least; the Omav's base is what is led itself, the Dragon's mean lies between its links
            let own = ["Omav", "Dragon"].iter().any(|name| entry.name.starts_with(name));
            assert!(own || apart > 0.15, "{}: {apart}", entry.name);
        }
    }
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

/// Steps with random actions; all arrays of the last step.
fn run(env: &mut Env, steps: u64) -> Buffers {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    go_on(env, &mut out, 0..steps);
    out
}

/// Steps with the actions of these draws.
fn go_on(env: &mut Env, out: &mut Buffers, draws: std::ops::Range<u64>) {
    let mut actions = vec![0.0; env.spec().n_env * env.spec().n_agent * env.spec().action.len()];
    for t in draws {
        env.sample(t, &mut actions);
        env.step(&actions, &mut out.out()).unwrap();
    }
}

/// The arrays of `n` environments from `first` on.
fn part(out: &Buffers, spec: &Spec, first: usize, n: usize) -> Buffers {
    let cut = |rows: &[f32], each: usize| rows[first * each..(first + n) * each].to_vec();
    let flags = |rows: &[u8]| rows[first..first + n].to_vec();
    let seen = spec.n_agent * spec.n_observation;
    Buffers {
        observation: cut(&out.observation, seen),
        reward: cut(&out.reward, spec.n_agent),
        terminated: flags(&out.terminated),
        truncated: flags(&out.truncated),
        central: cut(&out.central, spec.n_central),
        privileged: cut(&out.privileged, spec.privileged.len()),
        final_observation: cut(&out.final_observation, seen),
        final_central: cut(&out.final_central, spec.n_central),
        info: cut(&out.info, spec.info.len()),
    }
}

/// Batches that differ in their threads alone, stepped side by side: the same arrays in every step, the same bytes behind the
/// last. Gives the first of them.
fn threads_change_no_bit(
    entry: &registry::TaskEntry,
    base: &EnvConfig,
    steps: u64,
    threads: &[usize],
) -> (Env, Buffers) {
    let batch = |threads: &usize| {
        let mut env = entry.env(base).unwrap();
        env.set_threads(Threads::new(*threads).unwrap());
        let out = run(&mut env, 0);
        (env, out)
    };
    let mut all: Vec<(Env, Buffers)> = threads.iter().map(batch).collect();
    for t in 0..steps {
        all.iter_mut().for_each(|(env, out)| go_on(env, out, t..t + 1));
        let other = all.iter().position(|(_, out)| *out != all[0].1).map(|k| threads[k]);
        assert_eq!(other, None, "{}, step {t}: so many threads give other bits", entry.name);
    }
    let saved = all[0].0.save();
    assert!(all.iter().all(|(env, _)| env.save() == saved), "{}", entry.name);
    all.swap_remove(0)
}

#[test]
#[ignore = "STEPS=1000 cargo test --release --test tasks contract -- --ignored --nocapture: ten minutes, as many steps"]
fn threads_change_no_bit_of_4096_environments_in_a_thousand_steps() {
    for entry in registry::REGISTRY {
        threads_change_no_bit(entry, &config(4096, 25), count("STEPS", 1000), &[1, 2, 3, 8, 16]);
    }
}

#[test]
fn threads_shards_and_places_in_the_batch_change_no_bit() {
    for entry in registry::REGISTRY {
        let light = ["Hover", "Track", "HoverRand", "TrackRand"].contains(&entry.name);
        let (n, steps) = if light { (4096, 60) } else { (512, 30) };
        let base = config(n, 25);
        let (whole, reference) = threads_change_no_bit(entry, &base, steps, &[1, 2, 8]);
        // four shards, and one that begins within a block
        let quarter = n / 4;
        for (first, count) in
            [(0, quarter), (quarter, quarter), (2 * quarter, quarter), (3 * quarter, quarter), (17, 70)]
        {
            let shard = EnvConfig { n_env: count, first_environment: first as u64, ..base.clone() };
            let own = run(&mut entry.env(&shard).unwrap(), steps);
            let spec = whole.spec();
            assert!(own == part(&reference, spec, first, count), "{} from {first}", entry.name);
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
            let out = run(&mut env, 30);
            env.update_normaliser();
            assert!(env.statistics().count > 30_000.0);
            let after = run(&mut env, 5);
            assert!(after != out);
            after
        })
        .collect();
    assert!(results[0] == results[1] && results[1] == results[2]);
}

#[test]
fn saved_bytes_restore_into_a_fresh_environment_of_every_task() {
    for entry in registry::REGISTRY {
        for transforms in [false, true] {
            let base = if transforms { transformed(&config(70, 25)) } else { config(70, 25) };
            let mut env = entry.env(&base).unwrap();
            let mut out = run(&mut env, 30);
            let mut fresh = entry.env(&base).unwrap();
            let empty = fresh.save();
            fresh.load(&env.save()).unwrap();
            let mut again = Buffers::new(fresh.spec());
            fresh.observe(&mut again.out()).unwrap();
            assert!(again.observation == out.observation && again.central == out.central, "{}", entry.name);
            assert!(again.privileged == out.privileged, "{}", entry.name);
            go_on(&mut env, &mut out, 30..60);
            again = out.clone();
            go_on(&mut fresh, &mut again, 30..60);
            assert!(again == out && fresh.save() == env.save(), "{}", entry.name);
            // bytes from before the first reset do not count as one
            fresh.load(&empty).unwrap();
            let actions = vec![0.0; fresh.spec().n_env * fresh.spec().n_agent * fresh.spec().action.len()];
            let error = fresh.step(&actions, &mut again.out()).unwrap_err().to_string();
            assert!(error.contains("environment 0") && error.contains("reset"), "{error}");
        }
    }
}

/// At so many random instants of a batch a fresh one takes its bytes and goes on beside it: arrays and bytes of 20 steps.
fn goes_on_from(instants: u64) {
    for entry in registry::REGISTRY {
        for base in [config(70, 25), transformed(&config(70, 25))] {
            let mut env = entry.env(&base).unwrap();
            let (mut out, mut at) = (run(&mut env, 0), 0);
            let mut stream = Stream::new(82, 0, 0, Purpose::user(82));
            for _ in 0..instants {
                let from = at + stream.below(40);
                go_on(&mut env, &mut out, at..from);
                env.update_normaliser();
                let (mut fresh, mut again) = (entry.env(&base).unwrap(), out.clone());
                fresh.load(&env.save()).unwrap();
                at = from + 20;
                for t in from..at {
                    go_on(&mut env, &mut out, t..t + 1);
                    go_on(&mut fresh, &mut again, t..t + 1);
                    assert!(again == out && fresh.save() == env.save(), "{} from {from}: step {t}", entry.name);
                }
            }
        }
    }
}

#[test]
fn saved_bytes_go_on_from_random_steps_of_every_task() {
    goes_on_from(2);
}

#[test]
#[ignore = "INSTANTS=100 cargo test --release --test tasks contract -- --ignored --nocapture: ten minutes, as many instants"]
fn saved_bytes_go_on_from_a_hundred_random_steps_of_every_task() {
    goes_on_from(count("INSTANTS", 100));
}

#[test]
fn saved_bytes_do_not_depend_on_threads() {
    let delay = Delay { min: 1, max: 2 };
    for control in [Level::Rotor, Level::Rate] {
        for base in
            [transformed(&EnvConfig { control, ..config(262, 25) }), EnvConfig { control, delay, ..config(262, 25) }]
        {
            for actions in [ActionSpace::Continuous, ActionSpace::MultiDiscrete { levels: 3 }] {
                let base = EnvConfig { actions, ..base.clone() };
                let saved = [1, 2].map(|threads| {
                    let mut env = Env::make("PayloadHover", &base).unwrap();
                    env.set_threads(Threads::new(threads).unwrap());
                    run(&mut env, 40);
                    env.save()
                });
                assert!(saved[0] == saved[1], "{control:?}, {actions:?}");
            }
        }
    }
}

#[test]
fn shards_collect_statistics_that_merge_to_those_of_the_whole() {
    let base = transformed(&config(256, 25));
    let mut whole = Env::make("Hover", &base).unwrap();
    run(&mut whole, 20);
    let mut merged = whole.statistics().clone();
    whole.update_normaliser();
    let mut shards: Vec<Env> = (0..2)
        .map(|k| Env::make("Hover", &EnvConfig { n_env: 128, first_environment: 128 * k, ..base.clone() }).unwrap())
        .collect();
    let mut outs: Vec<Buffers> = shards.iter_mut().map(|env| run(env, 20)).collect();
    let mut pending = shards[0].take_pending();
    pending.add(&shards[1].take_pending()).unwrap();
    merged.merge(pending.count, &pending.sums, &pending.squares);
    let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-9 * (1.0 + x.abs()));
    assert_eq!(merged.count, whole.statistics().count);
    assert!(close(&merged.mean, &whole.statistics().mean) && close(&merged.variance, &whole.statistics().variance));
    // observations in hand follow, and collecting goes on only when asked
    let before = outs[0].observation.clone();
    shards[0].set_statistics(merged.clone()).unwrap();
    shards[0].observe(&mut outs[0].out()).unwrap();
    assert!(outs[0].observation != before);
    let (shard, out) = (&mut shards[0], &mut outs[0]);
    go_on(shard, out, 20..25);
    assert_eq!(shard.take_pending().count, 0.0);
    shard.set_collecting(true);
    go_on(shard, out, 25..30);
    assert!(shard.take_pending().count >= 640.0);
}

#[test]
fn a_policy_fits_environments_of_equal_hash() {
    let base = config(8, 25);
    let hash = |text: &str| {
        let own = EnvConfig::from_toml(text, "hash").unwrap();
        Env::make("Hover", &EnvConfig { task: base.task.clone(), ..own }).unwrap().spec().hash()
    };
    let plain = hash("n_env = 8");
    assert_eq!(plain, hash("n_env = 16\nseed = 3"));
    let others = [
        "observation = [{ kind = 'normalise' }]",
        "observation = [{ kind = 'noise', std = 0.1 }]",
        "observation = [{ kind = 'noise', std = 0.2 }]",
        "observation = [{ kind = 'history', steps = 2 }]",
        "actions = { kind = 'multi_discrete', levels = 3 }",
        "control = 'rate'",
    ];
    let mut all: Vec<u64> = others.iter().map(|text| hash(&format!("n_env = 8\n{text}"))).chain([plain]).collect();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), others.len() + 1);
    let mut spec = Env::make("Hover", &base).unwrap().spec().clone();
    spec.observation[0].meaning.push_str(", in other words");
    assert_eq!(spec.hash(), plain);
}

#[test]
fn a_diverged_step_is_worth_nothing() {
    let mut env = Env::make("Hover", &EnvConfig { autoreset: Autoreset::Disabled, ..config(3, 25) }).unwrap();
    let mut out = run(&mut env, 1);
    let mut state = env.state(1).unwrap();
    state[3] = 1e18;
    env.set_state(1, &state).unwrap();
    go_on(&mut env, &mut out, 1..2);
    let width = env.spec().info.len();
    let told = |name: &str, i: usize| out.info[i * width + env.spec().info_column(name).unwrap()];
    assert_eq!((out.terminated[1], out.reward[1], told("loss", 1), told("success", 1)), (1, 0.0, 0.0, 0.0));
    assert!(told("loss", 0) != 0.0);
}

#[test]
fn observations_stay_within_the_bounds_that_they_declare() {
    for entry in registry::REGISTRY {
        let mut env = entry.env(&config(64, 40)).unwrap();
        let (low, high) = env.spec().observation_bounds();
        assert!(low.iter().zip(&high).any(|(a, b)| (*a, *b) == (-1.0, 1.0)), "{}: attitudes have bounds", entry.name);
        assert_eq!(env.spec().observation.last().map(|f| f.low > f.high), Some(false));
        let out = run(&mut env, 60);
        for row in out.observation.chunks_exact(low.len()).chain(out.final_observation.chunks_exact(low.len())) {
            for (k, x) in row.iter().enumerate() {
                // a unit vector may be longer by rounding
                let slack = 1e-5;
                assert!((low[k] - slack..=high[k] + slack).contains(x), "{}: number {k} is {x}", entry.name);
            }
        }
    }
}

#[test]
fn every_key_and_field_of_a_task_has_a_name_of_its_own() {
    for entry in registry::REGISTRY {
        let env = entry.env(&EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap();
        let own = env.task_spec();
        let keys: Vec<&str> = own.settings.iter().map(|s| s.key.as_str()).collect();
        for names in [keys, own.observation.iter().map(|f| f.name.as_str()).collect()] {
            let twice = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name));
            assert_eq!(twice, None, "{}", entry.name);
        }
    }
}

#[test]
fn a_spec_reads_back_from_its_text() {
    for entry in registry::REGISTRY {
        let text = "observation = [{ kind = 'history', steps = 2 }, { kind = 'noise', std = 0.1 }]\ndelay.max = 2";
        let config = EnvConfig { n_env: 3, ..EnvConfig::from_toml(text, "own").unwrap() };
        let spec = entry.env(&config).unwrap().spec().clone();
        assert_eq!(Spec::from_json(&spec.to_json()).unwrap(), spec, "{}", entry.name);
    }
    let error = Spec::from_json("{}").unwrap_err().to_string();
    assert!(error.contains("line 1") && error.contains("task"), "{error}");
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

#[test]
fn arrays_of_the_wrong_size_are_errors_and_no_panics() {
    let config = EnvConfig { n_env: 3, ..EnvConfig::default() };
    let [env, track] = ["Hover", "Track"].map(|task| Env::make(task, &config).unwrap());
    let mut baseline = Baseline::new(&env).unwrap();
    let act = |baseline: &mut Baseline, env: &Env, n: usize| baseline.act(env, &mut vec![0.0; n]).map(|()| n);
    assert_eq!(act(&mut baseline, &env, 12).unwrap(), 12);
    for (env, n, told) in [
        (&env, 11, "length of actions is 11, but it must be 12."),
        (&track, 12, "environment of a baseline is Env(3 × Track)"),
    ] {
        let error = act(&mut baseline, env, n).unwrap_err().to_string();
        assert!(error.starts_with(told), "{error}");
    }
    let jacobian = env.jacobian(0, &[0.0; 4]).unwrap();
    let (n_row, n_column) = jacobian.matrix.shape();
    assert_eq!(jacobian.part(&(0..n_row), &(0..n_column)).unwrap(), jacobian.matrix);
    for (rows, columns) in [(0..n_row + 1, 0..1), (0..1, n_column..n_column + 1), (n_row..2, 0..1)] {
        assert!(jacobian.part(&rows, &columns).unwrap_err().to_string().contains(" of a Jacobian is "));
    }
}

#[test]
fn arrays_of_all_environments_are_those_of_each() {
    let base = EnvConfig { n_env: 70, ..EnvConfig::default() };
    for task in ["Hover", "PayloadTrack", "Formation"] {
        let mut env = Env::make(task, &transformed(&base)).unwrap();
        env.reset(None, None, &mut Buffers::new(env.spec()).out()).unwrap();
        let each = |of: &dyn Fn(usize) -> Vec<f64>| (0..70).flat_map(of).collect::<Vec<f64>>();
        let exact = |row: Vec<f32>| row.into_iter().map(f64::from).collect::<Vec<f64>>();
        let states = each(&|i| exact(env.state(i).unwrap()));
        let goals = each(&|i| exact(env.goal(i).unwrap()));
        let numbers = each(&|i| env.parameters(i).unwrap());
        let [mut all_states, mut all_goals] = [&states, &goals].map(|x| vec![f32::NAN; x.len()]);
        let mut all_numbers = vec![f64::NAN; numbers.len()];
        env.states_into(&mut all_states).unwrap();
        env.goals_into(&mut all_goals).unwrap();
        env.parameters_into(&mut all_numbers).unwrap();
        assert_eq!((exact(all_states), exact(all_goals), all_numbers), (states, goals, numbers), "{task}");
        let error = env.states_into(&mut [0.0; 3]).unwrap_err().to_string();
        assert!(error.starts_with("length of states is 3, but it must be "), "{error}");
        assert!(env.goals_into(&mut [0.0; 3]).is_err() && env.parameters_into(&mut [0.0; 3]).is_err());
    }
}
