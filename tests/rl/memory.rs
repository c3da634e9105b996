//! Probes of networks: what must be remembered, and where the bright pixel is. Optima are known, with and without.

use omnidrones::dynamics::Effects;
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::prelude::*;
use omnidrones::rl::checkpoint::Tensors;
use omnidrones::rl::nn::{Encoder, Filter, Layers, Recurrence};
use omnidrones::rl::ppo::{Ppo, PpoConfig};
use omnidrones::rl::schedule::Schedule;
use omnidrones::tasks::{Autoreset, Evaluation, FieldLayout, GroupKind, evaluate};

/// A vehicle in free space whose rotors tell numbers.
fn teller(config: &EnvConfig) -> Result<Robot> {
    let physics = config.physics_with(|e| *e = Effects::none());
    Robot::of_vehicle(&config.vehicle("hummingbird")?, physics)
}

/// Mean throttle of the rotors from `first` on.
fn told<S: Scalar>(view: &View<'_, S>, first: usize, n: usize) -> S {
    let mut sum = S::zero();
    for i in first..first + n {
        sum += view.throttle(0, i);
    }
    sum * S::constant(1.0 / n as f64)
}

/// 1 in the last step, 0 before.
fn at_the_end<S: Scalar>(view: &View<'_, S>, steps: usize) -> S {
    S::select(S::constant(steps as f64 - 0.5).lt(view.step), S::one(), S::zero())
}

/// A sign that is shown at the start and asked for seven steps later: pays 1 − (Δ/0.2)² with Δ = s − 0.5 − 0.2 sign. Who
/// forgets it can do no better than to tell 0.5, which pays 0 on average.
struct Cue {
    robot: Robot,
}

const CUE_STEPS: usize = 8;

#[rustfmt::skip]
impl Task for Cue {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { CUE_STEPS }
    fn start(&self, start: &mut Start<'_>) {
        let sign = 2.0 * start.task.below(2) - 1.0;
        start.goal.field("sign", "-", "−1 or 1").number(sign);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        let shown = Trace::select(view.step.lt(Trace::constant(0.5)), view.goal[0], Trace::zero());
        out.field("cue", "-", "sign in the first step, else 0").within(-1.0, 1.0).number(shown);
        out.field("clock", "-", "k/T").within(0.0, 1.0).number(view.clock);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        let wanted = Trace::constant(0.2).mul_add(view.goal[0], Trace::constant(0.5));
        let pay = Trace::one() - (told(view, 0, 4) - wanted).square() * Trace::constant(25.0);
        terms.term("told", "1 − (Δ/0.2)² in the last step", 1.0).within(-11.25, 1.0);
        terms.number(pay * at_the_end(view, CUE_STEPS));
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask { Trace::one().lt(Trace::zero()) }
    fn ideal(&self, start: &mut Start<'_>) { start.goal.field("sign", "-", "−1 or 1").number(1.0); }
}

/// A picture with one bright pixel among dim ones: its row and column are to be told, in the last step, by two rotors each.
/// Pays 1 − (Δ_row² + Δ_column²)/0.2². Who does not look does best with the middle: 1 − 2 · 0.0187/0.04 = 0.07.
struct Bright {
    robot: Robot,
}

const SIDE: usize = 6;
const BRIGHT_STEPS: usize = 2;

impl Bright {
    fn draw(start: &mut Start<'_>, [row, column]: [Trace; 2]) {
        let places = [row, column].map(|at| 0.3 + at * (0.4 / (SIDE - 1) as f64));
        start.goal.field("place", "-", "row and column, 0.3 to 0.7").array(places);
        start.goal.field("picture", "-", "pixels");
        for at in 0..SIDE * SIDE {
            let dim = start.task.uniform(0.0, 0.5);
            let is_here = (row * SIDE as f64 + column - at as f64).abs().lt(0.5);
            start.goal.number(Trace::select(is_here, Trace::one(), dim));
        }
    }
}

#[rustfmt::skip]
impl Task for Bright {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { BRIGHT_STEPS }
    fn start(&self, start: &mut Start<'_>) {
        let place = [(); 2].map(|()| start.task.below(SIDE as u64));
        Self::draw(start, place);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("picture", "-", "brightness").within(0.0, 1.0).image(SIDE, SIDE, 1);
        for at in 0..SIDE * SIDE {
            out.number(view.goal[2 + at]);
        }
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        let [row, column] = [0, 1].map(|k| (told(view, 2 * k, 2) - view.goal[k]).square());
        let pay = Trace::one() - (row + column) * Trace::constant(25.0);
        terms.term("told", "1 − Δ²/0.2² in the last step", 1.0).within(-23.5, 1.0);
        terms.number(pay * at_the_end(view, BRIGHT_STEPS));
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask { Trace::one().lt(Trace::zero()) }
    fn ideal(&self, start: &mut Start<'_>) { Self::draw(start, [2.0, 3.0].map(Trace::from)); }
}

fn make_cue(config: &EnvConfig) -> Result<Env> {
    Env::of(Cue { robot: teller(config)? }, "Cue", config)
}

fn make_bright(config: &EnvConfig) -> Result<Env> {
    Env::of(Bright { robot: teller(config)? }, "Bright", config)
}

type Make = fn(&EnvConfig) -> Result<Env>;

/// Short episodes, a reward at their end.
fn config(network: Layers) -> PpoConfig {
    PpoConfig {
        n_env: 256,
        shard: 64,
        steps: CUE_STEPS,
        minibatches: 4,
        discount: 1.0,
        log_std: -1.0,
        entropy: Schedule::constant(0.0),
        learning_rate: Schedule::cosine(5e-3, 1e-4),
        normalise_observation: false,
        network: Layers { hidden: vec![32], ..network },
        critic: Layers { hidden: vec![32], ..PpoConfig::default().critic },
        ..PpoConfig::default()
    }
}

fn remembering(units: usize, window: usize) -> Layers {
    Layers { memory: Some(Recurrence::Gru { units, window }), ..PpoConfig::default().network }
}

fn learn(make: Make, config: PpoConfig, seed: u64, threads: usize) -> Ppo {
    let mut ppo = Ppo::with(&make, &EnvConfig::default(), config, seed, Threads::new(threads).unwrap()).unwrap();
    while ppo.n_update() < ppo.budget() {
        ppo.update().unwrap();
    }
    ppo
}

/// 512 starts that no training saw.
fn flown(make: Make, policy: &mut Policy) -> Evaluation {
    let own = EnvConfig { n_env: 512, seed: 77, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    policy.reset();
    let act =
        &mut |_: &Env, out: &omnidrones::tasks::Buffers, actions: &mut [f32]| policy.act(&out.observation, actions);
    evaluate(&mut make(&own).unwrap(), act, &mut |_| {}).unwrap()
}

#[test]
fn a_policy_with_memory_tells_at_the_end_what_it_saw_at_the_start_and_one_without_cannot() {
    for (units, window, seed) in [(16, 8, 1), (16, 8, 2)] {
        let own = PpoConfig { updates: 150, ..config(remembering(units, window)) };
        let told = flown(make_cue, &mut learn(make_cue, own, seed, 2).policy().unwrap()).return_mean;
        println!("with memory: {told:.4}");
        assert!(told > 0.95, "{told}"); // measured 0.997 and 0.989
    }
    let own = PpoConfig { updates: 150, ..config(PpoConfig::default().network) };
    let told = flown(make_cue, &mut learn(make_cue, own, 1, 2).policy().unwrap()).return_mean;
    println!("without: {told:.4}");
    // 0 is the best of those who do not know
    assert!(told < 0.05, "{told}"); // measured 0.004
}

#[test]
fn the_bright_pixel_is_found_by_convolutions() {
    let layers = vec![Filter { channels: 8, kernel: 3, stride: 1 }, Filter { channels: 8, kernel: 2, stride: 1 }];
    let encoder = vec![Encoder::Conv2d { group: "picture".into(), layers }];
    let network = Layers { encoder, ..PpoConfig::default().network };
    let own = PpoConfig { updates: 300, n_env: 1024, steps: BRIGHT_STEPS, log_std: -1.5, ..config(network) };
    let told = flown(make_bright, &mut learn(make_bright, own, 1, 2).policy().unwrap()).return_mean;
    println!("{told:.4}");
    assert!(told > 0.9, "{told}"); // measured 0.946
}

#[test]
fn an_image_is_a_group_of_the_observation() {
    let spec = make_bright(&EnvConfig::default()).unwrap().spec().clone();
    let picture = spec.group("picture").unwrap();
    assert_eq!((picture.kind, picture.columns, picture.shape), (GroupKind::Image, 0..SIDE * SIDE, vec![SIDE, SIDE, 1]));
    assert_eq!(spec.observation[0].layout, FieldLayout::Image { height: SIDE, width: SIDE, channels: 1 });
    let again = omnidrones::tasks::Spec::from_json(&spec.to_json()).unwrap();
    assert_eq!(again.observation, spec.observation);
}

/// A run with memory over episodes that end within its windows.
fn small(threads: usize) -> Ppo {
    let own = PpoConfig { n_env: 40, shard: 16, steps: 13, minibatches: 2, updates: 20, ..config(remembering(8, 5)) };
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    Ppo::with(&make_cue, &env, own, 3, Threads::new(threads).unwrap()).unwrap()
}

fn saved(ppo: &Ppo) -> (Tensors, Tensors) {
    let (mut policy, mut state) = (Tensors::new(), Tensors::new());
    ppo.save(&mut policy, &mut state).unwrap();
    (policy, state)
}

#[test]
fn a_run_with_memory_has_the_same_bits_for_any_number_of_threads_and_goes_on_with_them() {
    let run = |ppo: &mut Ppo, n: usize| (0..n).for_each(|_| drop(ppo.update().unwrap()));
    let (mut whole, mut other) = (small(1), small(3));
    run(&mut whole, 6);
    run(&mut other, 3);
    let (policy, state) = saved(&other);
    assert!(state.tensor("shard.2.memory").is_ok(), "what is remembered between rollouts is kept");
    let mut resumed = small(2);
    resumed.load(&policy, &state).unwrap();
    assert!(saved(&resumed) == (policy, state));
    run(&mut resumed, 3);
    assert!(saved(&resumed) == saved(&whole));
}

#[test]
fn a_policy_forgets_where_episodes_begin_and_rows_have_nothing_to_do_with_each_other() {
    let mut policy = small(1).policy().unwrap();
    let (n, rows) = (policy.actor().n_observation(), 70);
    assert_eq!(policy.n_state(), 8);
    let see = |k: usize| (0..rows * n).map(|i| (0.7 * i as f32 + k as f32).sin()).collect::<Vec<f32>>();
    let act = |policy: &mut Policy, x: &[f32]| {
        let mut actions = vec![0.0; x.len() / n * 4];
        policy.act(x, &mut actions).unwrap();
        actions
    };
    let (first, second) = (act(&mut policy, &see(0)), act(&mut policy, &see(1)));
    let mut begins = vec![0; rows];
    (begins[3], begins[66]) = (1, 1);
    policy.reset();
    assert_eq!(act(&mut policy, &see(0)), first, "anew");
    policy.forget(&begins).unwrap();
    let third = act(&mut policy, &see(1));
    for row in 0..rows {
        let same = third[row * 4..][..4] == second[row * 4..][..4];
        assert_eq!(same, begins[row] == 0, "row {row}");
    }
    // alone
    act(&mut policy, &see(0)[5 * n..6 * n]);
    assert_eq!(act(&mut policy, &see(1)[5 * n..6 * n]), second[20..24]);
    let told = policy.forget(&[0; 3]).unwrap_err().to_string();
    assert!(told.starts_with("environments is 3, but it must be a divisor of 1"), "{told}");
}

#[test]
fn settings_of_networks_are_typed_as_tables_and_wrong_ones_name_the_remedy() {
    let text = "algorithm = 'ppo'\n[ppo.network]\nhidden = [32]\n[ppo.network.memory]\nkind = 'gru'\nunits = 24\n\
                [[ppo.network.encoder]]\ngroup = 'history'\nkind = 'conv1d'\nlayers = [{ channels = 6, kernel = 2 }]\n\
                [env]\nobservation = [{ kind = 'history', steps = 4 }]";
    let of = |text: &str| omnidrones::rl::TrainConfig::for_task("Hover", None, Some((text, "my.toml")));
    let own = of(text).unwrap();
    let again = omnidrones::rl::TrainConfig::from_toml(&own.to_toml().unwrap(), "config.toml").unwrap();
    assert_eq!(own, again);
    let spec = Env::make("Hover", &EnvConfig { n_env: 1, ..own.seen_env() }).unwrap().spec().clone();
    let actor = own.algorithm.actor(&spec).unwrap();
    assert_eq!((actor.n_observation(), actor.mlp.n_state()), (spec.n_observation, 24));
    let told = |text: &str| {
        let own = of(text).unwrap();
        own.algorithm.actor(&spec).unwrap_err().to_string()
    };
    let apg = told("algorithm = 'apg'\napg.network.memory = { kind = 'gru', units = 24 }");
    assert!(apg.starts_with("network.memory is given, but it must be left out") && apg.contains("ppo"), "{apg}");
    let group = told("[[apg.network.encoder]]\ngroup = 'histori'\nkind = 'mlp'\nunits = [4]");
    assert!(group.contains("did you mean 'history'"), "{group}");
    let critic = of("algorithm = 'ppo'\nppo.critic.memory = { kind = 'gru', units = 24 }").unwrap_err().to_string();
    assert!(critic.starts_with("critic is with encoder or memory"), "{critic}");
    let sum = "apg.network.join = 'sum'\n[[apg.network.encoder]]\ngroup = 'up'\nkind = 'mlp'\nunits = [4]\n\
               [[apg.network.encoder]]\ngroup = 'velocity'\nkind = 'mlp'\nunits = [5]";
    assert!(told(sum).starts_with("numbers that an encoder gives is 5, but it must be 4"), "{}", told(sum));
}
