//! What learning promises: the same bits, the right values, known optima, and nothing poisoned gets in.

use nalgebra::DVector;
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::actor_critic::{ActorCritic, ActorCriticConfig, Exploration};
use omnidrones::rl::algorithm;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::rl::checkpoint::Tensors;
use omnidrones::rl::dagger::{Dagger, DaggerConfig, ImitationTarget};
use omnidrones::rl::dqn::{Dqn, DqnConfig, ValueMixer};
use omnidrones::rl::nn::{AdamConfig, Encoder, Layers, Recurrence};
use omnidrones::rl::policy::Actor;
use omnidrones::rl::ppo::{Ppo, PpoConfig};
use omnidrones::rl::replay::ReplayConfig;
use omnidrones::rl::sac::{Entropy, Sac, SacConfig};
use omnidrones::rl::schedule::Schedule;
use omnidrones::rl::shac::{Shac, ShacConfig};
use omnidrones::rl::td3::{ActionNoise, Td3, Td3Config};
use omnidrones::rl::{Learner, Policy, TrainConfig};
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Env, EnvConfig, ObservationTransform, evaluate};
use std::time::{Duration, Instant};

const HOVER: &str = "Hover";

fn threads(n: usize) -> Threads {
    Threads::new(n).unwrap()
}

const MASSES: &str = "stagger = true\nrandomise = [{ what = 'mass', range = [0.9, 1.1] }]";

/// Critics see the masses.
fn env_of_masses() -> EnvConfig {
    EnvConfig::from_toml(MASSES, "small").unwrap()
}

/// Every algorithm, and every name for settings of one, with a budget of a blink; teams where it is for teams.
fn small(name: &str, n_thread: usize) -> Box<dyn Learner> {
    let (algorithm, memory) = (name.trim_end_matches(WITH_MEMORY), name.ends_with(WITH_MEMORY));
    match algorithm {
        "dagger" => return Box::new(imitator(&env_of_masses(), threads(n_thread))),
        "rma" => return Box::new(taught(&env_of_masses(), threads(n_thread))),
        _ => (),
    }
    let own = algorithm::base(algorithm);
    let budget = match own {
        "apg" | "shac" => "horizon = 8",
        "ppo" => "steps = 8\nminibatches = 2",
        "sac" | "td3" | "dqn" => "gradient_steps = 4\nbatch = 128\nreplay = { capacity = 4000, learning_starts = 320 }",
        _ => panic!("say how {own} is made small"),
    };
    let memory = if memory { "network.memory = { kind = 'gru', units = 8, window = 3 }" } else { "" };
    let text = format!("{MASSES}\n[{own}]\nn_env = 40\nshard = 16\nupdates = 20\n{budget}\n{memory}");
    let alone = !TEAMS.contains(&algorithm);
    let task = if alone { HOVER } else { "OverHover" };
    let config = TrainConfig::for_task(task, Some(algorithm), Some((&text, "small"))).unwrap();
    let make = |own: &EnvConfig| Env::make(task, own);
    config.algorithm.learner(&make, &config.env, 3, threads(n_thread)).unwrap()
}

/// Names for settings of teams.
const TEAMS: [&str; 6] = ["mappo", "happo", "maddpg", "matd3", "vdn", "qmix"];
const WITH_MEMORY: &str = " with memory";

/// Who does as our controller does.
fn imitator(env: &EnvConfig, threads: Threads) -> Dagger {
    let config =
        DaggerConfig { n_env: 40, shard: 16, steps: 8, updates: 20, minibatches: 2, ..DaggerConfig::default() };
    Dagger::with(&|own| Env::make(HOVER, own), env, config, 3, threads).unwrap()
}

/// Teachers are flown from the start of episodes on, wherever learners by rewards would begin and be cut.
#[test]
fn imitation_flies_whole_episodes() {
    let learnt = |env: EnvConfig| {
        let mut learner = imitator(&env, threads(1));
        (0..3).for_each(|_| drop(learner.update().unwrap()));
        learner.policy().unwrap().parameters().to_vec()
    };
    let whole = env_of_masses().whole_episodes();
    let cut = EnvConfig { stagger: true, truncate_after: 2, ..whole.clone() };
    assert!(learnt(whole) == learnt(cut));
}

/// A history that learns to say what a random encoder of the masses says.
fn taught(env: &EnvConfig, threads: Threads) -> Dagger {
    let make = |own: &EnvConfig| Env::make(HOVER, own);
    let reads = |group: &str, units| Layers {
        encoder: vec![Encoder::Mlp { group: group.into(), units }],
        hidden: vec![16],
        ..Layers::default()
    };
    let config = DaggerConfig {
        n_env: 40,
        shard: 16,
        steps: 8,
        updates: 20,
        minibatches: 2,
        imitate: ImitationTarget::Latent,
        teacher_share: Schedule::constant(0.2),
        network: reads("past", vec![12, 3]),
        ..DaggerConfig::default()
    };
    let own = EnvConfig { observation: vec![ObservationTransform::History { steps: 3 }], ..env.clone() };
    let mut student = Dagger::with(&make, &own, config, 3, threads).unwrap();
    let seen = EnvConfig { n_env: 1, observation: vec![ObservationTransform::Privileged {}], ..env.clone() };
    let of = make(&seen).unwrap().spec().clone();
    let actor = Actor::new(&of, &reads("parameters", vec![8, 3]), true).unwrap();
    let mut weights = actor.mlp.init(&mut Stream::new(9, 0, 0, Purpose::LEARNING));
    weights.resize(actor.n_parameter(), 0.0);
    student.teach(Policy::new(actor, weights, None, &of).unwrap(), &of, &make).unwrap();
    student
}

/// The encoder that learns comes to say what the teacher's does; all that it took over stays, to the last bit.
#[test]
fn rapid_motor_adaptation_learns_the_latent_and_leaves_the_rest_alone() {
    let mut student = taught(&env_of_masses(), threads(2));
    let named = |student: &Dagger| {
        let policy = student.policy().unwrap();
        policy.actor().mlp.parts(policy.parameters())
    };
    let before = named(&student);
    let losses: Vec<f64> = (0..20).map(|_| student.update().unwrap().loss).collect();
    println!("{:.2e} to {:.2e}", losses[0], losses[19]);
    for (then, now) in before.iter().zip(named(&student)) {
        assert_eq!(then.data != now.data, now.name.starts_with("encoder.0."), "{}", now.name);
    }
    assert!(losses[19] < 0.1 * losses[0], "{losses:?}"); // 0.054
}

#[test]
fn a_teacher_that_sees_other_things_is_refused_with_the_remedy() {
    let make = |own: &EnvConfig| Env::make(HOVER, own);
    let mut student = taught(&env_of_masses(), threads(1));
    let of = make(&EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap().spec().clone();
    let actor = Actor::new(&of, &Layers::default(), true).unwrap();
    let weights = vec![0.0; actor.n_parameter()];
    let told = student.teach(Policy::new(actor, weights, None, &of).unwrap(), &of, &make).unwrap_err().to_string();
    assert!(told.contains("encoders of a policy") && told.contains("'parameters'"), "{told}");
}

/// All that are registered, by every name that they have.
fn algorithms() -> Vec<String> {
    let variants = algorithm::VARIANTS.iter().map(|own| own.name.to_string());
    let known = algorithm::names().into_iter().map(String::from).chain(variants);
    known.chain([format!("ppo{WITH_MEMORY}")]).collect()
}

fn bits(learner: &dyn Learner) -> Vec<u32> {
    learner.policy().unwrap().parameters().iter().map(|x| x.to_bits()).collect()
}

fn run(learner: &mut dyn Learner, updates: u64) {
    for _ in 0..updates {
        learner.update().unwrap();
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_for_any_number_of_threads() {
    for algorithm in algorithms() {
        let of = |n| {
            let mut learner = small(&algorithm, n);
            run(&mut *learner, 20);
            bits(&*learner)
        };
        let one = of(1);
        assert_eq!(one, of(1), "{algorithm}, twice");
        assert_eq!(one, of(2), "{algorithm}, 2 threads");
        assert_eq!(one, of(8), "{algorithm}, 8 threads");
    }
}

#[test]
fn a_run_goes_on_from_saved_tensors_with_the_same_bits() {
    for algorithm in algorithms() {
        let mut whole = small(&algorithm, 2);
        run(&mut *whole, 5);
        let (mut policy, mut state) = (Tensors::new(), Tensors::new());
        whole.save(&mut policy, &mut state).unwrap();
        run(&mut *whole, 7);
        let mut resumed = small(&algorithm, 1);
        resumed.load(&policy, &state).unwrap();
        assert_eq!(resumed.n_update(), 5);
        run(&mut *resumed, 7);
        assert_eq!(bits(&*whole), bits(&*resumed), "{algorithm}");
        assert_eq!(whole.env_steps(), resumed.env_steps());
        let other = small(if algorithm == "apg" { "shac" } else { "apg" }, 1).load(&policy, &Tensors::new());
        assert!(other.is_err(), "{algorithm}: a state of nothing is loaded");
    }
}

#[test]
fn what_is_not_finite_reaches_no_weight_and_learning_goes_on() {
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let network = Layers { hidden: Vec::new(), ..Layers::default() };
    let (n_env, horizon, updates, max_grad_norm) = (64, 32, 200, 1.0);
    let apg = ApgConfig { n_env, horizon, updates, max_grad_norm, network: network.clone(), ..ApgConfig::default() };
    let shac = ShacConfig { n_env, horizon, updates, max_grad_norm, network, ..ShacConfig::default() };
    let ppo = PpoConfig {
        n_env: 64,
        shard: 32,
        updates: 200,
        minibatches: 4,
        normalise_observation: false,
        ..PpoConfig::default()
    };
    let memory = Some(Recurrence::Gru { units: 16, window: 16 });
    let remembers = PpoConfig { network: Layers { memory, ..ppo.network.clone() }, ..ppo.clone() };
    let make = &crate::regulate::make_poisoned;
    let values = |mixer| DqnConfig { levels: 9, mixer, ..regulating_values() };
    let mixed = values(ValueMixer::Monotone { units: 8, hidden: 16 });
    let learners: [(&str, Box<dyn Learner>); 8] = [
        ("apg", Box::new(Apg::with(make, &env, apg, 1, threads(2)).unwrap())),
        ("shac", Box::new(Shac::with(make, &env, shac, 1, threads(2)).unwrap())),
        ("ppo", Box::new(Ppo::with(make, &env, ppo, 1, threads(2)).unwrap())),
        ("ppo with memory", Box::new(Ppo::with(make, &env, remembers, 1, threads(2)).unwrap())),
        ("sac", Box::new(Sac::with(make, &env, regulating_sac(), 1, threads(2)).unwrap())),
        ("td3", Box::new(Td3::with(make, &env, regulating_td3(), 1, threads(2)).unwrap())),
        ("dqn", Box::new(Dqn::with(make, &env, values(ValueMixer::None), 1, threads(2)).unwrap())),
        ("qmix", Box::new(Dqn::with(make, &env, mixed, 1, threads(2)).unwrap())),
    ];
    for (name, mut learner) in learners {
        let paid = |learner: &dyn Learner| {
            let mut policy = learner.policy().expect("weights are finite");
            costs(0.97, &mut |x, actions| policy.act(x, actions).unwrap()).0
        };
        let (mut late, before, mut left_out) = (Vec::new(), paid(&*learner), 0.0);
        for update in 0..200 {
            let told = learner.update().unwrap();
            let bounded = told.extra.iter().all(|(_, x)| x.is_finite());
            assert!(told.reward.is_finite() && bounded, "{name}: reward or figures in update {update}");
            let counted = told.extra.iter().find(|(k, _)| ["gradients_dropped", "rows_left_out"].contains(k)).unwrap();
            left_out += counted.1;
            if update == 150 {
                late = bits(&*learner);
            }
        }
        let after = paid(&*learner);
        println!("{name}: cost {before:.0}, then {after:.0}; {left_out} rows left out");
        assert!(left_out > 1000.0, "{name}: nothing was poisoned");
        // nine levels for each rotor are too coarse to come near: that values go on learning is what is asked of them
        let learnt = if ["dqn", "qmix"].contains(&name) { bits(&*learner) != late } else { after < 0.5 * before };
        assert!(learnt, "{name} did not learn: {before} {after}");
    }
}

/// Mean discounted cost of a policy over 64 starts, and of the optimum by the Riccati equation.
fn costs(discount: f64, act: &mut dyn FnMut(&[f32], &mut [f32])) -> (f64, f64) {
    let config = EnvConfig { n_env: 64, seed: 99, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    let mut env = crate::regulate::make(&config).unwrap();
    let (_, p, _) = crate::regulate::optimum(discount);
    let column = env.spec().info_column("loss").unwrap();
    let width = env.spec().info.len();
    let (mut total, mut optimum) = (0.0, 0.0);
    let mut step = 0;
    evaluate(
        &mut env,
        &mut |_, out, actions| {
            if step == 0 {
                for x in out.observation.chunks_exact(crate::regulate::N) {
                    let x = DVector::from_iterator(crate::regulate::N, x.iter().map(|x| f64::from(*x)));
                    let now: f64 = (0..crate::regulate::N).map(|i| crate::regulate::weight(i) * x[i] * x[i]).sum();
                    // costs count from the state behind the first step
                    optimum += ((x.transpose() * &p * &x)[0] - now) / discount / 64.0;
                }
            }
            step += 1;
            act(&out.observation, actions);
            Ok(())
        },
        &mut |watched| {
            let now: f64 = watched.out.info.iter().skip(column).step_by(width).map(|x| f64::from(*x)).sum();
            total += discount.powi(watched.step as i32 - 1) * now / 64.0;
        },
    )
    .unwrap();
    (total, optimum)
}

#[test]
fn the_linear_regulator_costs_what_the_riccati_equation_says() {
    for discount in [1.0, 0.97] {
        let (gain, _, hover) = crate::regulate::optimum(discount);
        let (cost, optimum) = costs(discount, &mut |x, actions| {
            for (x, a) in x.chunks_exact(crate::regulate::N).zip(actions.chunks_exact_mut(4)) {
                let x = DVector::from_iterator(crate::regulate::N, x.iter().map(|x| f64::from(*x)));
                let u = &gain * x;
                a.iter_mut().enumerate().for_each(|(k, a)| *a = (hover[k] - u[k]) as f32);
            }
        });
        println!("γ = {discount}: {cost:.5} against {optimum:.5}");
        assert!((cost / optimum - 1.0).abs() < 3e-3, "{cost} {optimum}");
    }
}

fn check_against_riccati(name: &str, policy: &mut Policy, discount: f64, most: f64) {
    let (cost, optimum) = costs(discount, &mut |x, actions| policy.act(x, actions).unwrap());
    println!("{name}: {cost:.5} is {:+.2} % from the optimum {optimum:.5}", 100.0 * (cost / optimum - 1.0));
    assert!(cost / optimum < 1.0 + most, "{name}: {cost} against {optimum}");
}

fn apg_regulates(seed: u64, most: f64) {
    // one window is one episode, so nothing is cut off
    let config = ApgConfig {
        n_env: 32,
        shard: 16,
        horizon: crate::regulate::STEPS,
        updates: 1500,
        learning_rate: Schedule::cosine(0.01, 1e-5),
        max_grad_norm: 1.0,
        network: Layers { hidden: Vec::new(), ..Layers::default() },
        ..ApgConfig::default()
    };
    let mut apg = Apg::with(&crate::regulate::make, &EnvConfig::default(), config, seed, Threads::default()).unwrap();
    run(&mut apg, 1500);
    check_against_riccati("APG", &mut apg.policy().unwrap(), 1.0, most);
}

fn shac_regulates(seed: u64, most: f64) {
    let config = ShacConfig {
        n_env: 32,
        shard: 16,
        horizon: 60,
        updates: 2000,
        discount: 0.97,
        learning_rate: Schedule::cosine(0.01, 1e-5),
        critic_learning_rate: Schedule::cosine(0.005, 1e-4),
        critic_epochs: 4,
        max_grad_norm: 1.0,
        network: Layers { hidden: Vec::new(), ..Layers::default() },
        adam: AdamConfig::default(),
        ..ShacConfig::default()
    };
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let mut shac = Shac::with(&crate::regulate::make, &env, config, seed, Threads::default()).unwrap();
    run(&mut shac, 2000);
    check_against_riccati("SHAC", &mut shac.policy().unwrap(), 0.97, most);
}

fn ppo_regulates(seed: u64, most: f64) {
    // many small batches: a quarter of the time of fewer large ones, and half as far off
    let config = PpoConfig {
        n_env: 32,
        shard: 16,
        steps: 32,
        minibatches: 4,
        updates: 5000,
        discount: 0.97,
        lambda: 0.95.into(),
        log_std: -1.5,
        normalise_observation: false,
        entropy: Schedule::constant(0.0),
        network: Layers { hidden: Vec::new(), ..PpoConfig::default().network },
        ..PpoConfig::default()
    };
    let updates = config.updates;
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let mut ppo = Ppo::with(&crate::regulate::make, &env, config, seed, Threads::default()).unwrap();
    run(&mut ppo, updates);
    check_against_riccati("PPO", &mut ppo.policy().unwrap(), 0.97, most);
}

fn regulating<E: Exploration>(usual: ActorCriticConfig<E>) -> ActorCriticConfig<E> {
    let network = Layers { hidden: Vec::new(), ..usual.network.clone() };
    let critic = Layers { hidden: vec![64; 2], layer_norm: false, ..usual.critic.clone() };
    let replay = ReplayConfig { n_step: 1.0.into(), learning_starts: 512, ..usual.replay.clone() };
    ActorCriticConfig {
        n_env: 64,
        shard: 32,
        batch: 256,
        discount: 0.97,
        updates: 200,
        tau: 0.02,
        normalise_observation: false,
        learning_rate: Schedule::constant(3e-3),
        critic_learning_rate: Schedule::constant(3e-3),
        network,
        critic,
        replay,
        ..usual
    }
}

fn regulating_values() -> DqnConfig {
    let usual = DqnConfig::default();
    DqnConfig {
        n_env: 64,
        shard: 32,
        updates: 200,
        batch: 128,
        normalise_observation: false,
        network: Layers { hidden: vec![32; 2], ..usual.network.clone() },
        replay: ReplayConfig { n_step: 1.0.into(), learning_starts: 512, ..usual.replay.clone() },
        ..usual
    }
}

fn regulating_sac() -> SacConfig {
    // less and less random: the optimum is not
    let exploration = Entropy { target: -3.0, ..Entropy::default() };
    SacConfig { exploration, ..regulating(SacConfig::default()) }
}

fn regulating_td3() -> Td3Config {
    let exploration = ActionNoise { noise: [0.02, 0.2], target_noise: 0.05, noise_clip: 0.1 };
    Td3Config { exploration, ..regulating(Td3Config::default()) }
}

/// Targets of six steps, and a ring that forgets what flew before: costs of a policy that falls are a thousand times the optimum's.
fn kept_briefly<E: Exploration>(usual: ActorCriticConfig<E>, rate: f64) -> ActorCriticConfig<E> {
    ActorCriticConfig {
        updates: 3000,
        learning_rate: Schedule::cosine(rate, 1e-5),
        critic_learning_rate: Schedule::cosine(rate, 1e-5),
        replay: ReplayConfig { capacity: 30_000, n_step: 6.0.into(), ..usual.replay.clone() },
        ..usual
    }
}

fn kept_regulates<E: Exploration>(config: ActorCriticConfig<E>, seed: u64, most: f64) {
    let (env, updates) = (EnvConfig { stagger: true, ..EnvConfig::default() }, config.updates);
    let make = &crate::regulate::make;
    let mut own = ActorCritic::with(make, &env, config, seed, Threads::default()).unwrap();
    run(&mut own, updates);
    check_against_riccati(E::NAME, &mut own.policy().unwrap(), 0.97, most);
}

fn sac_regulates(seed: u64, most: f64) {
    // a temperature that follows fast: what it pays for randomness is no cost of the regulator's
    let exploration = Entropy { target: -3.0, learning_rate: 5e-3, ..Entropy::default() };
    let config = SacConfig { exploration, batch: 512, ..kept_briefly(regulating_sac(), 5e-3) };
    kept_regulates(config, seed, most);
}

fn td3_regulates(seed: u64, most: f64) {
    let exploration = ActionNoise { noise: [0.01, 0.1], target_noise: 0.02, noise_clip: 0.05 };
    kept_regulates(Td3Config { exploration, ..kept_briefly(regulating_td3(), 1e-3) }, seed, most);
}

/// The optimum of who imitates is what is imitated: our controller.
fn dagger_imitates(seed: u64, most: f64) {
    let make = |own: &EnvConfig| Env::make(HOVER, own);
    let mut dagger =
        Dagger::with(&make, &EnvConfig::default(), DaggerConfig::default(), seed, Threads::default()).unwrap();
    run(&mut dagger, DaggerConfig::default().updates);
    let own = held_out(&mut dagger.policy().unwrap(), HOVER, "").unwrap().return_mean;
    let mut env = unseen(HOVER, "").unwrap();
    let mut teacher = Baseline::new(&env).unwrap();
    let optimum = evaluate(&mut env, &mut teacher.policy(), &mut |_| {}).unwrap().return_mean;
    println!("DAgger: a return of {own:.0} is {:+.2} % from the teacher's {optimum:.0}", 100.0 * (own / optimum - 1.0));
    assert!(own > (1.0 - most) * optimum, "{own} against {optimum}");
}

#[test]
fn apg_finds_the_linear_regulator() {
    apg_regulates(1, 0.01);
}

#[test]
fn shac_finds_the_linear_regulator() {
    shac_regulates(1, 0.01); // 0.3 %
}

#[test]
fn ppo_finds_the_linear_regulator() {
    ppo_regulates(1, 0.03); // 1.5 %
}

#[test]
#[ignore = "cargo test --release --test rl learning -- --ignored --nocapture: minutes"]
fn every_algorithm_finds_what_is_known_from_each_of_five_seeds_within_a_minute() {
    let mut slowest = Duration::ZERO;
    for learn in [apg_regulates, shac_regulates, ppo_regulates, dagger_imitates] {
        for seed in 1..=5 {
            let begun = Instant::now();
            // measured at most: APG 4.6 %, SHAC 0.4 %, PPO 1.5 %, DAgger 4.8 %
            learn(seed, 0.05);
            println!("    seed {seed}: {:?}", begun.elapsed());
            slowest = slowest.max(begun.elapsed());
        }
    }
    assert!(slowest < Duration::from_secs(60), "{slowest:?}");
}

#[test]
#[ignore = "cargo test --release --test rl learning -- --ignored --nocapture: minutes"]
fn sac_and_td3_come_near_the_linear_regulator_from_each_of_three_seeds() {
    for seed in 1..=3 {
        sac_regulates(seed, 0.15); // 14.7, 3.2, 8.5 %
        td3_regulates(seed, 0.05); // 1.0, 1.2, 2.5 %
    }
}

/// 1024 starts that no training saw.
fn unseen(task: &str, config: &str) -> Result<Env> {
    let own = EnvConfig::from_toml(config, "test")?;
    Env::make(task, &EnvConfig { n_env: 1024, seed: 77, autoreset: Autoreset::Disabled, ..own })
}

fn held_out(policy: &mut Policy, task: &str, config: &str) -> Result<omnidrones::tasks::Evaluation> {
    evaluate(
        &mut unseen(task, config)?,
        &mut |_, out: &Buffers, actions| policy.act(&out.observation, actions),
        &mut |_| {},
    )
}

#[test]
fn hover_is_learnt_from_random_weights_with_the_defaults() {
    for seed in [11, 12] {
        let env = EnvConfig { stagger: true, ..EnvConfig::default() };
        let mut apg = Apg::new(HOVER, &env, ApgConfig::default(), seed, Threads::default()).unwrap();
        while apg.n_update() < apg.budget() {
            apg.update().unwrap();
        }
        let result = held_out(&mut apg.policy().unwrap(), HOVER, "").unwrap();
        println!("seed {seed}: success {:.4}, error {:.4} m", result.success, result.final_error);
        assert!(result.success >= 0.99, "seed {seed}: {}", result.success);
    }
}

#[test]
fn hover_is_learnt_from_estimates() {
    let text = "observation = [{ kind = 'estimate' }]\n\
                [[sensor]]\nname = 'imu'\nkind = 'imu'\npreset = 'bmi088'\n\
                [[sensor]]\nname = 'cameras'\nkind = 'motion_capture'\npreset = 'optical'\nevery = 1\n";
    let env = EnvConfig { stagger: true, ..EnvConfig::from_toml(text, "test").unwrap() };
    let mut apg = Apg::new(HOVER, &env, ApgConfig::default(), 11, Threads::default()).unwrap();
    while apg.n_update() < apg.budget() {
        apg.update().unwrap();
    }
    let result = held_out(&mut apg.policy().unwrap(), HOVER, text).unwrap();
    println!("on estimates: success {:.4}, error {:.4} m", result.success, result.final_error);
    // 0.998 with seed 0
    assert!(result.success >= 0.98, "{}", result.success);
}

#[test]
fn rates_beyond_the_cliff_are_noticed_and_halved() {
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let config = ApgConfig { learning_rate: Schedule::cosine(0.05, 1e-4), updates: 300, ..ApgConfig::default() };
    let mut apg = Apg::new(HOVER, &env, config, 5, Threads::default()).unwrap();
    let mut restarts: f64 = 0.0;
    for _ in 0..900 {
        if apg.n_update() >= apg.budget() {
            break;
        }
        let update = apg.update().unwrap();
        restarts = update.extra.iter().find(|(name, _)| *name == "restarts").unwrap().1;
    }
    assert!(restarts >= 1.0, "0.05 flew without a restart");
}
