use super::*;
use crate::learner::{Learner, saved};
use crate::nn::{Layers, Recurrence};
use crate::rollout::RolloutShape;
use crate::schedule::Schedule;
use autodiff::{Trace, TraceMask};
use dynamics::Effects;
use tasks::config::ActionSpace;
use tasks::probe::{CUT, Probe};
use tasks::{Ends, Env, EnvConfig, Robot, Start, Task, View, Writer};

fn hidden(n: usize, last: f64) -> Layers {
    Layers { hidden: vec![n, n], ..Layers::elu(last) }
}

fn small() -> PpoConfig {
    PpoConfig {
        n_env: 24,
        shard: 10,
        steps: 8,
        epochs: 2,
        minibatches: 3,
        updates: 10,
        discount: 0.99,
        lambda: 0.95.into(),
        normalise_observation: false,
        network: hidden(16, 0.5),
        critic: hidden(16, 1.0),
        ..PpoConfig::default()
    }
}

fn ppo(task: &str, env: &EnvConfig, config: PpoConfig, threads: usize) -> Ppo {
    Ppo::new(task, env, config, 5, Threads::new(threads).unwrap()).unwrap()
}

fn value_of(update: &Update, name: &str) -> f64 {
    update.extra.iter().find(|(k, _)| *k == name).unwrap().1
}

#[test]
fn before_the_first_step_the_ratio_is_one_and_the_divergence_nothing() {
    for actions in [ActionSpace::Continuous, ActionSpace::MultiDiscrete { levels: 3 }] {
        let mut ppo = ppo("Hover", &EnvConfig { actions, ..EnvConfig::default() }, small(), 1);
        ppo.collect().unwrap();
        ppo.estimate_advantages().unwrap();
        ppo.normalise_advantages();
        // rows in another order than they were flown in
        let mut rows = ppo.actor_rows.clone();
        rows.reverse();
        let [mut first, mut learnt] = [Metrics::default(), Metrics::default()];
        ppo.actor_step(0, &rows[..64], &mut first);
        assert_eq!((first.sums[sum::KL], first.sums[sum::CLIPPED], first.sums[sum::COUNT]), (0.0, 0.0, 64.0));
        ppo.actor_step(0, &rows[..64], &mut learnt);
        assert!(learnt.sums[sum::KL] > 1e-4, "{:?}", learnt.sums); // 0.1
    }
}

/// A rollout of nothing but what the actor's loss reads, every sign of A with ρ on all three sides of the clip.
fn invented(actor: &Actor, parameters: &[f32], stream: &mut Stream) -> (RolloutBatch, Vec<u32>) {
    let (n_in, n_action) = (actor.mlp.n_input(), actor.n_action());
    let shape = RolloutShape {
        steps: 5,
        n_agent: 2,
        n_value: 1,
        n_observation: n_in,
        n_central: 3,
        n_privileged: 0,
        n_action,
        n_state: 0,
    };
    let mut rollout = RolloutBatch::new(shape, 4);
    let mut memory = actor.mlp.memory(1);
    let (network, extra) = parameters.split_at(actor.mlp.n_parameter());
    let rows = 4 * 5 * 2;
    for row in 0..rows {
        let x = &mut rollout.observation[row * n_in..][..n_in];
        x.iter_mut().for_each(|x| *x = stream.normal() as f32);
        let output = actor.mlp.forward(network, x, 1, &mut memory);
        let action = &mut rollout.action[row * n_action..][..n_action];
        let log_prob = actor.head.sample(output.row(0), extra, stream, action);
        let ratio = [0.5, 0.93, 1.07, 1.8][row % 4] + 0.01 * stream.unit();
        rollout.log_prob[row] = log_prob - ratio.ln() as f32;
        rollout.advantage[row / 2] = stream.normal() as f32;
    }
    (rollout, (0..rows as u32).collect())
}

#[test]
fn the_gradient_of_the_loss_is_that_of_finite_differences() {
    for (seed, head) in
        [Head::Gaussian { n: 2 }, Head::Categorical { n: 3 }, Head::MultiCategorical { n: 2, levels: 3 }]
            .into_iter()
            .enumerate()
    {
        let mut stream = Stream::new(3, seed as u64, 0, Purpose::LEARNING);
        let mut spec = Env::make("Hover", &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap().spec().clone();
        spec.n_observation = 3;
        spec.action = match head {
            Head::Gaussian { n } => tasks::Space::Box { n, low: -1.0, high: 1.0 },
            Head::Categorical { n } => tasks::Space::Discrete { n },
            Head::MultiCategorical { n, levels } => tasks::Space::MultiDiscrete { n, levels },
        };
        let actor = Actor::new(&spec, &hidden(5, 1.0), false).unwrap();
        assert_eq!(actor.head, head);
        let mut parameters = actor.mlp.init(&mut stream);
        parameters.resize(actor.n_parameter(), -0.4);
        let (rollout, rows) = invented(&actor, &parameters, &mut stream);
        let advantage: Vec<f32> = (0..rows.len()).map(|row| rollout.advantage[rollout.shape.critic_row(row)]).collect();
        let mut batch = Minibatch::new(&actor.mlp, head.n_extra(), rows.len(), 1 << 30).unwrap();
        let threads = Threads::new(1).unwrap();
        let mut run = |parameters: &[f32]| {
            let (network, extra) = parameters.split_at(actor.mlp.n_parameter());
            let share = 1.0 / rows.len() as f64;
            let mut gaussians = Gaussians::of(head);
            gaussians.iter_mut().for_each(|g| g.set(extra));
            let gaussians = gaussians.as_ref();
            let loss = ActorLoss {
                head,
                gaussians,
                extra,
                rollout: &rollout,
                advantage: &advantage,
                clip_epsilon: 0.2,
                entropy: 0.05,
                share,
            };
            let mut transposed = Transposed::default();
            actor.mlp.transpose(network, &mut transposed);
            let net = Weights { parameters: network, transposed: &transposed };
            let sums = batch.gradient(&threads, &actor.mlp, net, &rollout.observation, &rows, &loss);
            (share * (sums[sum::SURROGATE] - 0.05 * sums[sum::ENTROPY]), sums, batch.gradient.clone())
        };
        let (_, sums, gradient) = run(&parameters);
        // the ratios are as they were invented: half of them outside the clip
        assert_eq!((sums[sum::CLIPPED], sums[sum::COUNT]), (20.0, 40.0));
        let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        let h = 2e-3;
        let mut worst = 0.0_f64;
        for k in 0..parameters.len() {
            let mut at = |by: f32| {
                let mut moved = parameters.clone();
                moved[k] += by;
                run(&moved).0
            };
            // padding has neither
            let slope = (at(h) - at(-h)) / (2.0 * f64::from(h));
            if gradient[k] != 0.0 {
                worst = worst.max((slope - f64::from(gradient[k])).abs());
            }
        }
        println!("{head:?}: {worst:.1e} of {norm:.3}");
        assert!(worst < 3e-4 * norm, "{head:?}: {worst:e} of {norm}"); // 1e-5, 2e-5, 5e-5 of it
    }
}

#[test]
fn results_are_the_same_bits_on_one_thread_and_on_two() {
    let run = |threads| {
        let config = PpoConfig { n_env: 150, shard: 32, normalise_observation: true, ..small() };
        let mut ppo = ppo("Hover", &EnvConfig::default(), config, threads);
        let told: Vec<Update> = (0..3).map(|_| Update { phases: Vec::new(), ..ppo.update().unwrap() }).collect();
        (saved(&ppo), told)
    };
    let (one, two) = (run(1), run(2));
    assert!(one == two);
    assert!(one.1[0] != one.1[1]);
}

#[test]
fn a_saved_run_goes_on_with_the_same_bits() {
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let config = PpoConfig { normalise_observation: true, ..small() };
    let fresh = || ppo("Hover", &env, config.clone(), 1);
    let mut whole = fresh();
    (0..2).for_each(|_| drop(whole.update().unwrap()));
    let (policy, state) = saved(&whole);
    let mut resumed = fresh();
    resumed.load(&policy, &state).unwrap();
    assert!(saved(&resumed) == (policy, state));
    for _ in 0..2 {
        let [a, b] = [&mut whole, &mut resumed].map(|p| Update { phases: Vec::new(), ..p.update().unwrap() });
        assert_eq!(a, b);
    }
    assert!(saved(&resumed) == saved(&whole));
    assert_eq!((resumed.n_update(), resumed.env_steps()), (4, 4 * 24 * 8));
}

/// V of the only state of [`Probe::forever`] after learning; with `as_death`, time that runs out is taken for an end.
fn learnt_value(make: &dyn Fn(&EnvConfig) -> Result<Env>, updates: usize, as_death: bool) -> f64 {
    let config = PpoConfig {
        n_env: 40,
        shard: 16,
        steps: CUT,
        minibatches: 1,
        value_beta: 0.5,
        critic_learning_rate: Schedule::constant(0.01),
        ..small()
    };
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let mut ppo = Ppo::with(make, &env, config, 1, Threads::new(1).unwrap()).unwrap();
    for _ in 0..updates {
        ppo.collect().unwrap();
        if as_death {
            for k in 0..ppo.rollout.terminated.len() {
                ppo.rollout.terminated[k] |= ppo.rollout.truncated[k];
            }
        }
        ppo.estimate_advantages().unwrap();
        ppo.normalise_advantages();
        ppo.optimise();
        ppo.update += 1;
    }
    let mut value = [0.0];
    ppo.critic.values(&ppo.threads, &[1.0], &mut value);
    ppo.value_norm.denormalise(&mut value);
    f64::from(value[0])
}

#[test]
fn time_that_runs_out_is_not_death_and_the_value_differs_tenfold() {
    let forever = |c: &EnvConfig| Env::of(Probe::forever(c)?, "forever", c);
    let right = learnt_value(&forever, 400, false);
    let wrong = learnt_value(&forever, 400, true);
    println!("{right} {wrong}");
    assert!((right - 100.0).abs() < 0.1, "{right}"); // 2e-4
    assert!((5.3..9.3).contains(&wrong), "{wrong}"); // 7.2
}

/// [`Probe::forever`] with whole episodes in which nothing is a number.
struct Broken {
    robot: Robot,
}

impl Task for Broken {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        CUT
    }
    fn start(&self, start: &mut Start<'_>) {
        let kind = Trace::select(start.task.below(4).lt(0.5), f64::NAN.into(), Trace::one());
        start.goal.field("kind", "-", "1 or NaN").number(kind);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("kind", "-", "1 or NaN").number(view.goal[0]);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("pay", "kind", 1.0).number(view.goal[0]);
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.field("kind", "-", "1 or NaN").number(1.0);
    }
}

fn broken(config: &EnvConfig) -> Result<Env> {
    let physics = config.physics_with(|e| *e = Effects::none());
    let robot = Robot::of_vehicle(&config.vehicle("hummingbird")?, physics)?;
    Env::of(Broken { robot }, "broken", config)
}

#[test]
fn environments_of_nothing_but_nan_are_left_out_and_the_others_learnt_from() {
    for normalise_observation in [false, true] {
        let config = PpoConfig { normalise_observation, ..small() };
        let mut ppo = Ppo::with(&broken, &EnvConfig::default(), config, 1, Threads::new(1).unwrap()).unwrap();
        let updates: Vec<Update> = (0..4).map(|_| ppo.update().unwrap()).collect();
        assert!(ppo.parameters.iter().chain(&ppo.critic.parameters).all(|x| x.is_finite()));
        assert!(ppo.value_norm.mean().is_finite() && ppo.value_norm.save()[3] == 0.0);
        let statistics = ppo.collectors[0].shard.env.statistics();
        assert!(statistics.mean.iter().chain(&statistics.variance).all(|x| x.is_finite()), "{statistics:?}");
        for update in updates {
            let left_out = value_of(&update, "rows_left_out");
            println!("{left_out}");
            assert!((20.0..90.0).contains(&left_out), "{left_out}"); // of 192
            assert!(update.reward.is_finite() && update.loss.is_finite() && update.gradient_norm.is_finite());
        }
    }
    let value = learnt_value(&broken, 400, false);
    assert!((value - 100.0).abs() < 1.0, "{value}");
}

#[test]
fn a_poisoned_row_changes_no_bit_of_what_is_learnt_from_the_others() {
    let config = small();
    let run = |spoil: &dyn Fn(&mut Ppo)| {
        let mut ppo = ppo("Hover", &EnvConfig::default(), config.clone(), 1);
        ppo.collect().unwrap();
        ppo.estimate_advantages().unwrap();
        spoil(&mut ppo);
        ppo.normalise_advantages();
        ppo.optimise();
        let left_out = 24 * 8 - ppo.actor_rows.len();
        let numbers = ppo.parameters.iter().chain(&ppo.critic.parameters).chain(&ppo.optimisers[0].adam.mean);
        let bits: Vec<u32> = numbers.map(|x| x.to_bits()).collect();
        (bits, ppo.value_norm.save(), left_out)
    };
    // (observation, reward) of rows: steps 3 and 5 of environments 7 and 2 of the first shard
    let (seen, paid) = (3 * 10 + 7, 5 * 10 + 2);
    let poisoned = run(&|ppo| {
        let n = ppo.rollout.shape.n_observation;
        ppo.rollout.observation[seen * n + 4] = f32::NAN;
        ppo.rollout.reward[paid] = f32::INFINITY;
        ppo.estimate_advantages().unwrap();
    });
    let without = run(&|ppo| {
        // a reward reaches back to where its episode began; none ended in so short a time
        assert!(ppo.rollout.terminated.iter().chain(&ppo.rollout.truncated).all(|x| *x == 0));
        for row in (0..6).map(|t| t * 10 + 2).chain([seen]) {
            let r = &mut ppo.rollout;
            (r.log_prob[row], r.advantage[row], r.target[row]) = (f32::NAN, f32::NAN, f32::NAN);
        }
    });
    let clean = run(&|_| ());
    assert_eq!((poisoned.2, without.2, clean.2), (7, 7, 0));
    assert!(poisoned == without);
    assert!(poisoned.0 != clean.0);
}

#[test]
fn whole_numbers_are_learnt_within_their_space() {
    for actions in [ActionSpace::Discrete { levels: 2 }, ActionSpace::MultiDiscrete { levels: 3 }] {
        let mut ppo = ppo("Hover", &EnvConfig { actions, ..EnvConfig::default() }, small(), 1);
        let update = ppo.update().unwrap();
        assert_eq!(value_of(&update, "rows_left_out"), 0.0);
        let n = ppo.rollout.shape.n_action;
        let flown = 10 * 8 * n;
        assert!(ppo.rollout.action[..flown].chunks(n).all(|a| ppo.spec.action.contains(a)));
        let mut policy = ppo.policy().unwrap();
        let mut action = vec![f32::NAN; n];
        policy.act(&vec![0.1; ppo.spec.n_observation], &mut action).unwrap();
        assert!(ppo.spec.action.contains(&action), "{action:?}");
        let before = saved(&ppo);
        let (policy, state) = &before;
        ppo.load(policy, state).unwrap();
        assert!(saved(&ppo) == before);
    }
}

#[test]
fn a_team_shares_its_policy_and_a_critic_of_its_central_state() {
    let run = |central_critic| {
        let mut ppo = ppo("Formation", &EnvConfig::default(), PpoConfig { central_critic, ..small() }, 1);
        let update = ppo.update().unwrap();
        assert_eq!(value_of(&update, "rows_left_out"), 0.0);
        assert_eq!(ppo.actor_rows.len(), 24 * 8 * ppo.spec.n_agent);
        (
            ppo.spec.n_agent,
            ppo.spec.n_central,
            ppo.rollout.shape.n_value,
            ppo.critic.mlp.n_input(),
            ppo.critic_rows.len(),
        )
    };
    let (agents, central, judged, inputs, rows) = run(true);
    assert!(agents > 1 && central > 0);
    assert_eq!((judged, inputs, rows), (1, central, 24 * 8));
    let (_, _, judged, inputs, rows) = run(false);
    assert_eq!((judged, rows), (agents, 24 * 8 * agents));
    assert!(inputs != central);
}

#[test]
fn teams_explore_by_the_stream_of_their_environment_agent_after_agent() {
    for of in [Team::Shared, Team::Separate] {
        let mut ppo = ppo("Formation", &EnvConfig::default(), PpoConfig { team: of, ..small() }, 1);
        // every mean is 0, every deviation 1
        ppo.parameters.fill(0.0);
        ppo.collect().unwrap();
        let (s, mut at, mut first) = (ppo.rollout.shape, 0, 0);
        let n = s.n_agent * s.n_action;
        for collector in &ppo.collectors {
            let n_env = collector.shard.env.spec().n_env;
            let own = |i: usize| Stream::new(5, (first + i) as u64, 0, Purpose::POLICY);
            let mut streams: Vec<_> = (0..n_env).map(own).collect();
            for t in 0..s.steps {
                for (i, stream) in streams.iter_mut().enumerate() {
                    let wanted: Vec<_> = (0..n).map(|_| stream.normal() as f32).collect();
                    assert_eq!(ppo.rollout.action[at..at + n], wanted, "{of:?}: step {t} of environment {}", first + i);
                    at += n;
                }
            }
            first += n_env;
            // no action stands behind the last step
            at += n_env * n;
        }
        assert_eq!((at, first), (ppo.rollout.action.len(), 24));
    }
}

fn team(team: Team, config: PpoConfig) -> Ppo {
    let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..EnvConfig::default() };
    ppo("OverHover", &env, PpoConfig { team, ..config }, 1)
}

/// ln π(a|o) of a row as the parameters of its agent are now.
fn log_prob_now(ppo: &Ppo, row: usize) -> f32 {
    let (network, extra) = ppo.actor.set(&ppo.parameters, row % ppo.actor.n_set());
    let (n_seen, n_action) = (ppo.rollout.shape.n_observation, ppo.rollout.shape.n_action);
    let mut memory = ppo.actor.mlp.memory(1);
    let x = &ppo.rollout.observation[row * n_seen..][..n_seen];
    let output = ppo.actor.mlp.forward(network, x, 1, &mut memory);
    ppo.actor.head.log_prob(output.row(0), extra, &ppo.rollout.action[row * n_action..][..n_action])
}

/// Kuba et al. 2022, algorithm 4: ratios of behind the update, not of before it, where they would all be 1.
#[test]
fn who_learns_later_learns_from_advantages_times_the_ratios_that_those_before_came_to() {
    let mut ppo = team(Team::Sequential, small());
    ppo.collect().unwrap();
    ppo.estimate_advantages().unwrap();
    ppo.normalise_advantages();
    let before = ppo.advantage.clone();
    ppo.optimise();
    let agents = ppo.actor.n_set();
    assert_eq!((agents, ppo.spec.n_agent, ppo.optimisers.len()), (4, 4, 4));
    let mut moved = 0.0_f32;
    for row in ppo.actor_rows.iter().map(|row| *row as usize) {
        let (slot, place) =
            (row - row % agents, ppo.set_order.iter().position(|own| *own as usize == row % agents).unwrap());
        let earlier = ppo.set_order[..place].iter().map(|own| slot + *own as usize);
        let ratio: f32 = earlier.map(|row| (log_prob_now(&ppo, row) - ppo.rollout.log_prob[row]).exp()).product();
        let (wanted, found) = (before[row] * ratio, ppo.advantage[row]);
        assert!((wanted - found).abs() < 1e-5 * (1.0 + wanted.abs()), "row {row}, turn {place}: {wanted} {found}");
        moved = moved.max((ratio - 1.0).abs());
    }
    println!("ratios up to 1 ± {moved}");
    assert!(moved > 0.05, "{moved}"); // 0.41
}

#[test]
fn agents_of_their_own_learn_from_their_own_rows_alone_and_fly_as_they_learnt() {
    let mut ppo = team(Team::Separate, small());
    ppo.collect().unwrap();
    ppo.estimate_advantages().unwrap();
    ppo.normalise_advantages();
    let n = ppo.actor.n_parameter_of_set();
    let before = ppo.parameters.clone();
    assert!(before[..n] != before[n..2 * n]);
    // the third agent is told nothing
    (0..ppo.rollout.log_prob.len()).filter(|row| row % 4 == 2).for_each(|row| ppo.advantage[row] = 0.0);
    ppo.config.entropy = Schedule::constant(0.0);
    ppo.optimise();
    for k in 0..4 {
        let same = before[k * n..(k + 1) * n] == ppo.parameters[k * n..(k + 1) * n];
        assert_eq!(same, k == 2, "agent {k}");
    }
    let (n_seen, env) = (ppo.spec.n_observation, 3);
    let seen: Vec<f32> = (0..env * 4 * n_seen).map(|k| (0.37 * k as f32).sin()).collect();
    let mut actions = vec![f32::NAN; env * 4];
    ppo.policy().unwrap().act(&seen, &mut actions).unwrap();
    let mut memory = ppo.actor.mlp.memory(1);
    for row in 0..env * 4 {
        let (network, extra) = ppo.actor.set(&ppo.parameters, row % 4);
        let output = ppo.actor.mlp.forward(network, &seen[row * n_seen..][..n_seen], 1, &mut memory);
        let mut own = [f32::NAN];
        ppo.actor.head.mode(output.row(0), extra, &mut own);
        assert_eq!(own[0], actions[row], "row {row}");
    }
    let told = ppo.policy().unwrap().act(&seen[..3 * n_seen], &mut actions[..3]).unwrap_err().to_string();
    assert!(told.contains("a multiple of 4"), "{told}");
}

/// A team of four that sees nothing.
#[derive(Default)]
struct Blind {
    /// What it is paid in the mean after learning, and was in every update.
    paid: f64,
    course: Vec<f64>,
    /// How random it is, nats.
    nats: f64,
}

/// How it learns.
struct Blindly {
    seed: u64,
    entropy: f64,
    rate: f64,
    clip_epsilon: f64,
    epochs: usize,
    updates: u64,
}

const GENTLY: Blindly = Blindly { seed: 9, entropy: 0.01, rate: 5e-3, clip_epsilon: 0.2, epochs: 4, updates: 300 };

/// After learning by `pays` for four choices of two. Where nothing pays, nothing is better than anything else.
fn blind(of: Team, how: &Blindly, pays: Option<fn([usize; 4]) -> f32>) -> Blind {
    let config = PpoConfig {
        n_env: 32,
        minibatches: 1,
        epochs: how.epochs,
        clip_epsilon: how.clip_epsilon,
        discount: 0.0,
        learning_rate: Schedule::constant(how.rate),
        ..small()
    };
    let mut ppo = team(of, config);
    ppo.config.entropy = Schedule::constant(how.entropy);
    let Blind { mut paid, mut course, mut nats } = Blind::default();
    for update in 0..how.updates {
        ppo.update = update;
        ppo.collect().unwrap();
        let mut stream = Stream::new(how.seed, update, 0, Purpose::LEARNING);
        let r = &mut ppo.rollout;
        r.observation.fill(1.0);
        let mut memory = ppo.actor.mlp.memory(1);
        let n = r.log_prob.len();
        nats = 0.0;
        for row in 0..n {
            let (network, extra) = ppo.actor.set(&ppo.parameters, row % ppo.actor.n_set());
            let x = &r.observation[..r.shape.n_observation];
            let output = ppo.actor.mlp.forward(network, x, 1, &mut memory);
            r.log_prob[row] = ppo.actor.head.sample(output.row(0), extra, &mut stream, &mut r.action[row..=row]);
            nats += f64::from(ppo.actor.head.entropy(output.row(0), extra)) / n as f64;
        }
        // sixteen actions stand for two
        for (reward, actions) in r.reward.iter_mut().zip(r.action.chunks_exact(4)) {
            *reward = pays.map_or(0.0, |pays| pays(std::array::from_fn(|agent| actions[agent] as usize % 2)));
        }
        ppo.estimate_advantages().unwrap();
        paid = ppo.rollout.reward.iter().map(|x| f64::from(*x)).sum::<f64>() / ppo.rollout.reward.len() as f64;
        course.push(paid);
        ppo.normalise_advantages();
        if pays.is_none() {
            ppo.advantage.fill(0.0);
        }
        ppo.optimise();
    }
    Blind { paid, course, nats }
}

/// 1 where two and two act otherwise, agents 0 and 1 alike and 2 and 3 alike.
fn two_halves(choices: [usize; 4]) -> f32 {
    f32::from(u8::from([[0, 0, 1, 1], [1, 1, 0, 0]].contains(&choices)))
}

/// Kuba et al. 2022, proposition 1, with four agents: who shares a policy and sees nothing is paid 2/2⁴ at most.
#[test]
fn a_team_that_shares_its_policy_cannot_split_in_two_and_one_that_learns_in_turn_does() {
    let [shared, in_turn] = [Team::Shared, Team::Sequential].map(|of| blind(of, &GENTLY, Some(two_halves)).paid);
    println!("shared {shared}, in turn {in_turn}");
    assert!(shared < 0.2, "{shared}"); // 0.132: 0.125 and what chance adds
    assert!(in_turn > 0.9, "{in_turn}"); // 1
}

/// 1 where one acts and the others leave it to that one.
fn one_leads(choices: [usize; 4]) -> f32 {
    f32::from(u8::from(choices.iter().sum::<usize>() == 1))
}

/// The published HAPPO weighs by ratios of before the update, which are all 1: agents then learn at once (`Team::Separate`), each as if
/// the others stayed. At first it is worth little to act, for three others may; all leave it then, and nobody is paid. Steps are as long
/// as they can be: clipped ones hide it, and in the end those at once come to the same.
#[test]
fn ratios_of_before_the_update_let_agents_leave_the_same_thing_together() {
    let boldly = |seed| Blindly { seed, entropy: 0.0, rate: 2e-2, clip_epsilon: 0.9, epochs: 20, updates: 5 };
    let mean = |of| {
        let each = (1..=4).map(|seed| blind(of, &boldly(seed), Some(one_leads)).course);
        let all: Vec<f64> = each.inspect(|course| println!("{of:?} {course:.2?}")).flatten().collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    let [in_turn, at_once] = [Team::Sequential, Team::Separate].map(mean);
    println!("paid in five updates: in turn {in_turn:.3}, at once {at_once:.3}");
    assert!(in_turn > at_once + 0.1, "{in_turn} {at_once}"); // measured 0.692 and 0.468
}

/// The published HAPPO takes the entropy with the wrong sign: who is paid for nothing stays random, and by that sign does not.
#[test]
fn the_wrong_sign_of_the_entropy_settles_on_an_action_that_nothing_speaks_for() {
    let [right, wrong] =
        [0.01, -0.01].map(|entropy| blind(Team::Sequential, &Blindly { entropy, ..GENTLY }, None).nats);
    println!("{right} and {wrong} of ln 16 = {} nats", 16.0_f64.ln());
    assert!(right > 0.99 * 16.0_f64.ln() && wrong < 0.1 * 16.0_f64.ln(), "{right} {wrong}");
}

#[test]
fn a_memory_is_refused_where_every_agent_has_its_own_network() {
    let mut config = PpoConfig { team: Team::Sequential, ..small() };
    config.network.memory = Some(Recurrence::Gru { units: 8, window: 4 });
    let threads = Threads::new(1).unwrap();
    let told = Ppo::new("OverHover", &EnvConfig::default(), config, 1, threads).err().unwrap().to_string();
    assert!(told.contains("network.memory") && told.contains("history"), "{told}");
}

#[test]
fn a_critic_knows_the_numbers_of_the_episode_that_each_row_belongs_to() {
    let text = "stagger = true\ntask.horizon = 12\nrandomise = [{ what = 'mass', range = [0.5, 1.5] }]";
    let env = EnvConfig::from_toml(text, "test").unwrap();
    for (task, central) in [("Hover", false), ("OverHover", true)] {
        let mut ppo = ppo(task, &env, small(), 2);
        assert_eq!(ppo.spec.n_central > 0, central);
        (0..2).for_each(|_| drop(ppo.update().unwrap()));
        // on no scale, to be read
        ppo.critic.inputs = None;
        ppo.collect().unwrap();
        let (r, shape) = (&ppo.rollout, ppo.rollout.shape);
        let (n, n_known) = (shape.n_critic(), shape.n_privileged);
        assert!(n_known > 0 && n_known == ppo.spec.privileged.len());
        let n_env = ppo.collectors[0].shard.env.spec().n_env;
        let known = |t: usize, i: usize| &r.apart[((t * n_env + i) * shape.n_value + 1) * n - n_known..][..n_known];
        let (mut same, mut other) = (0, 0);
        for (t, i) in (0..shape.steps).flat_map(|t| (0..n_env).map(move |i| (t, i))) {
            let ended = r.terminated[t * n_env + i] | r.truncated[t * n_env + i] == 1;
            assert_eq!(known(t, i) == known(t + 1, i), !ended, "{task}: step {t} of environment {i}");
            (same, other) = (same + usize::from(!ended), other + usize::from(ended));
        }
        assert!(same > 20 && other > 2, "{same} {other}");
        // what a time-out is worth is asked of the episode that ended, not of the one that follows in its place
        let one = &ppo.collectors[0];
        for (seen, row) in one.ends.chunks(n).zip(&one.end_rows) {
            let tail = |row: usize| &r.apart[(row + 1) * n - n_known..][..n_known];
            assert_eq!(&seen[n - n_known..], tail(*row), "{task}: row {row}");
            assert_ne!(&seen[n - n_known..], tail(row + n_env * shape.n_value), "{task}: row {row}");
        }
        assert!(!one.end_rows.is_empty());
        let own = ppo.collectors[0].shard.env.parameters(3).unwrap();
        for (x, (name, nominal)) in known(shape.steps, 3).iter().zip(&ppo.spec.privileged) {
            let wanted =
                |p: &f64| (p / nominal - 1.0 - f64::from(*x)).abs() < 1e-6 || *nominal == 0.0 && p.abs() < 1e-6;
            assert!(own.iter().any(wanted), "{name}: {x}");
        }
        if !central {
            let seen = &r.observation[shape.n_observation..][..shape.n_observation];
            assert_eq!(&r.apart[n..2 * n - n_known], seen, "what agents see stands before it");
        }
    }
}

#[test]
fn the_rate_follows_the_divergence() {
    let mut ppo = ppo(
        "Hover",
        &EnvConfig::default(),
        PpoConfig { learning_rate: 1e-3.into(), target_kl: Some(0.01.into()), ..small() },
        1,
    );
    let target = 0.01;
    assert_eq!(ppo.learning_rate(0, 0.0, target), 1e-3);
    assert_eq!(ppo.learning_rate(0, 0.0, 3.0 * target), 1e-3 / 1.5);
    assert_eq!(ppo.learning_rate(0, 0.0, f64::NAN), 1e-3 / 1.5);
    for _ in 0..100 {
        ppo.learning_rate(0, 0.0, 0.0);
    }
    assert_eq!(ppo.learning_rate(0, 0.0, target), 0.01);
    ppo.config.target_kl = Some(Schedule::cosine(target, 1e-3));
    assert_eq!(ppo.learning_rate(0, 0.0, target), 0.01);
    assert_eq!(ppo.learning_rate(0, 1.0, target), 1e-3 * (10.0 / 1.5));
    ppo.config.target_kl = None;
    assert_eq!(ppo.learning_rate(0, 0.0, 3.0 * target), 1e-3);
}

#[test]
fn settings_survive_their_text_and_what_cannot_be_meant_is_named() {
    let text = toml::to_string(&PpoConfig::default()).unwrap();
    assert_eq!(toml::from_str::<PpoConfig>(&text).unwrap(), PpoConfig::default());
    assert!(toml::from_str::<PpoConfig>("clipp = 0.1").unwrap_err().to_string().contains("unknown field `clipp`"));
    let told = |text: &str| {
        let config: PpoConfig = toml::from_str(text).unwrap();
        let threads = Threads::new(1).unwrap();
        Ppo::new("Hover", &EnvConfig::default(), config, 1, threads).err().unwrap().to_string()
    };
    for (text, what) in [
        ("shard = 0", "shard is 0"),
        ("n_env = 100000000000", "n_env is 100000000000, over the limit of 1 to 16777216"),
        ("minibatches = 0", "minibatches is 0"),
        ("clip_epsilon = 0.0", "clip_epsilon is 0"),
        ("huber = nan", "huber is NaN"),
        ("lambda = 1.5", "lambda is 1.5"),
        ("lambda = { kind = 'linear', from = 0.9, to = 1.1 }", "lambda is 1.1"),
        ("log_std = 9.0", "log_std is 9"),
        ("target_kl = -1.0", "target_kl is -1"),
        ("target_kl = { kind = 'linear', from = 0.01, to = 0.0 }", "target_kl is 0"),
        ("value_beta = 1.0", "beta of the value norm is 1"),
        ("n_env = 2048\nsteps = 65536", "rows of a rollout is "),
    ] {
        let told = told(text);
        assert!(told.starts_with(what), "{told}");
    }
}
