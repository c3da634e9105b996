//! A team of unlike agents: a drone of four rotors and one of six, each to its height; the second is told the time too.

use omnidrones::autodiff::{Mask, Trace, TraceMask};
use omnidrones::controllers::cascade::Level;
use omnidrones::dynamics::assembly::{Member, group, single};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::prelude::*;
use omnidrones::rl::algorithm;
use omnidrones::rl::checkpoint::Tensors;
use omnidrones::rl::{Learner, TrainConfig};
use omnidrones::tasks::task_spec::Success;
use omnidrones::tasks::{ActionSpace, Autoreset, Buffers, Delay, Evaluation, Spec, check_env, evaluate};

struct Pair {
    robot: Robot,
}

/// Of both drones, m.
const HEIGHTS: [f64; 2] = [1.5, 2.5];
const FEW: usize = 13;

fn off<S: Scalar>(view: &View<'_, S>, agent: usize) -> S {
    view.drone(agent).position[2] - S::constant(HEIGHTS[agent])
}

#[rustfmt::skip]
impl Task for Pair {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { 100 }
    fn start(&self, start: &mut Start<'_>) {
        for (i, z) in HEIGHTS.into_iter().enumerate() {
            let position = [(2.0 * i as f64).into(), Trace::zero(), z + start.reset.uniform(-0.5, 0.5)];
            start.place(i, position, [1.0, 0.0, 0.0, 0.0]);
        }
    }
    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        let own = view.drone(agent);
        out.field("off", "m, world", "z − z_t").number(off(view, agent));
        out.field("velocity", "m/s, world", "v").array(own.velocity);
        out.field("up", "-, world", "u").array(own.up());
        out.field("turning", "rad/s, world", "ω").array(own.angular_velocity);
        out.field("heading", "-, world", "h").array(own.heading());
        if agent == 1 {
            out.field("clock", "-", "k/T").number(view.clock);
        }
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        for (i, name) in ["low", "high"].into_iter().enumerate() {
            let off = off(view, i);
            terms.term(name, "½/(1 + 4 Δz²)", 0.5);
            terms.number(Trace::constant(0.5) / (Trace::one() + Trace::constant(4.0) * off * off));
        }
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        let far = |i| Trace::constant(1.2).lt(off(view, i).abs());
        ends.when("far", "|Δz| > 1.2 m", far(0).or(far(1)));
    }
    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("error", "m", off(view, 0).abs().max(off(view, 1).abs()));
    }
    fn success(&self, view: &View) -> TraceMask {
        off(view, 0).abs().max(off(view, 1).abs()).lt(Trace::constant(0.1))
    }
    fn success_rule(&self) -> Success { Success::below("error", 0.1) }
    fn ideal(&self, start: &mut Start<'_>) {
        HEIGHTS.into_iter().enumerate().for_each(|(i, z)| start.place(i, [2.0 * i as f64, 0.0, z], [1.0, 0.0, 0.0, 0.0]));
    }
}

fn make(config: &EnvConfig) -> Result<Env> {
    let drone = |name: &str| Ok(Member::new(name, single(&config.vehicle(name)?)?, [0.0; 3]));
    let model = group("pair", &[drone("hummingbird")?, drone("firefly")?])?;
    Env::of(Pair { robot: Robot::of_model(&model, config.physics(), None, |_| Vec::new())? }, "Pair", config)
}

#[test]
fn rows_of_unlike_agents_are_as_wide_as_the_widest_and_zero_behind_their_own() {
    let mut env = make(&EnvConfig { n_env: 70, ..EnvConfig::default() }).unwrap();
    let spec = env.spec().clone();
    let widths: Vec<_> = spec.unlike.iter().map(|own| (own.observation, own.action)).collect();
    assert_eq!((widths, spec.n_observation, spec.action.len()), (vec![(FEW, 4), (FEW + 1, 6)], FEW + 1, 6));
    assert_eq!((spec.commands.len(), spec.n_action_of(0), spec.n_action_of(1)), (6, 4, 6));
    assert_eq!(env.safe_command().len(), 12);
    assert_eq!(Spec::from_json(&spec.to_json()).unwrap(), spec);
    let mut out = Buffers::new(&spec);
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.3; 70 * 12];
    for t in 0..5 {
        env.sample(t, &mut actions);
        env.step(&actions, &mut out.out()).unwrap();
        assert!(out.observation.chunks(2 * (FEW + 1)).all(|team| team[FEW] == 0.0 && team[2 * FEW + 1] > 0.0));
    }
}

#[test]
fn numbers_behind_an_agents_own_move_nothing() {
    let config = EnvConfig { n_env: 70, ..EnvConfig::default() };
    for actions in [ActionSpace::Continuous, ActionSpace::MultiDiscrete { levels: 3 }] {
        let config = EnvConfig { actions, ..config.clone() };
        let flown = |behind: f32| {
            let mut env = make(&config).unwrap();
            let mut out = Buffers::new(env.spec());
            env.reset(None, None, &mut out.out()).unwrap();
            let mut all = vec![0.0; 70 * 12];
            for t in 0..20 {
                env.sample(t, &mut all);
                all.chunks_mut(12).for_each(|team| team[4..6].fill(behind));
                env.step(&all, &mut out.out()).unwrap();
            }
            assert!((0..70).all(|i| out.info[i * env.spec().info.len() + 2] == 0.0), "nothing was clipped");
            (env.save(), out.observation, out.reward)
        };
        let wanted = flown(0.0);
        for behind in [1.0, -7.0, f32::NAN, f32::INFINITY] {
            assert!(flown(behind) == wanted, "{behind}");
        }
    }
    let one = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..config };
    let said = make(&one).unwrap_err().to_string();
    assert!(said.contains("[4, 6]") && said.contains("multi_discrete"), "{said}");
}

#[test]
fn a_team_of_unlike_agents_keeps_the_contract_of_environments_and_its_recording_is_the_step() {
    let config = EnvConfig { n_env: 70, ..EnvConfig::default() };
    for found in check_env(&|own| make(own), &config).unwrap() {
        assert!(found.objection.is_none(), "{}: {:?}", found.claim, found.objection);
    }
    let late = EnvConfig { n_env: 3, delay: Delay { min: 1, max: 1 }, ..config.clone() };
    let jacobian = started(&late).jacobian(1, &[0.3; 12]).unwrap();
    let line = &jacobian.value[jacobian.layout.line.clone()];
    assert!(line.chunks(12).all(|row| row[4..6] == [0.0; 2]) && line.contains(&0.3), "{line:?}");
    let mut env = started(&EnvConfig { n_env: 3, ..config });
    let mut out = Buffers::new(env.spec());
    let action: Vec<f32> = (0..12).map(|k| 0.1 * k as f32 - 0.5).collect();
    let wide: Vec<f64> = action.iter().map(|a| f64::from(*a)).collect();
    let jacobian = env.jacobian(1, &wide).unwrap();
    let column = |k: usize| jacobian.matrix.column(jacobian.layout.action.start + k).amax();
    for k in 0..12 {
        assert_eq!(column(k) == 0.0, k == 4 || k == 5, "{k}");
    }
    env.step(&action.repeat(3), &mut out.out()).unwrap();
    let seen = &jacobian.value[jacobian.layout.observation.clone()];
    let gap = seen.iter().zip(&out.observation[seen.len()..]).map(|(a, b)| (a - f64::from(*b)).abs());
    let gap = gap.fold(0.0, f64::max);
    println!("{gap:.1e}");
    assert!(gap < 1e-5, "{gap:e}"); // measured 1e-6 or less: f32 beside f64
}

fn started(config: &EnvConfig) -> Env {
    let mut env = make(config).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    env
}

/// Controllers and control modes are those of one vehicle.
#[test]
fn a_vehicle_that_not_every_drone_is_is_refused() {
    let config = EnvConfig::default();
    let drone = |name: &str| Member::new(name, single(&config.vehicle(name).unwrap()).unwrap(), [0.0; 3]);
    let model = group("pair", &[drone("hummingbird"), drone("firefly")]).unwrap();
    let vehicle = config.vehicle("hummingbird").unwrap();
    let said = Robot::of_model(&model, config.physics(), Some(&vehicle), |_| Vec::new()).unwrap_err().to_string();
    assert!(said.contains("rotors of the vehicle is 4") && said.contains("6, as of every drone"), "{said}");
    let said = make(&EnvConfig { control: Level::Rate, ..config }).unwrap_err().to_string();
    assert!(said.contains("control = 'rotor'"), "{said}");
}

type Learning = Box<dyn Learner>;

fn begun(algorithm: &str, settings: &str, threads: usize) -> Result<(Learning, EnvConfig)> {
    let config = TrainConfig::for_task("Hover", Some(algorithm), Some((settings, "own")))?;
    let env = EnvConfig { actions: config.env.actions, ..EnvConfig::default() };
    let seen = config.algorithm.seen(&env);
    let threads = Threads::new(threads)?;
    Ok((config.algorithm.learner(&|own| make(own), &env, 3, threads)?, seen))
}

fn learnt(learner: &mut Learning) {
    while learner.progress().update < learner.progress().budget {
        learner.update().unwrap();
    }
}

/// 256 starts that no training saw.
fn flown(learner: &Learning, seen: &EnvConfig) -> Evaluation {
    let mut policy = learner.policy().unwrap();
    let own = EnvConfig { n_env: 256, seed: 77, autoreset: Autoreset::Disabled, ..seen.clone() };
    let mut env = make(&own).unwrap();
    if let Some(statistics) = policy.statistics() {
        env.set_statistics(statistics.clone()).unwrap();
    }
    let act = &mut |_: &Env, out: &Buffers, actions: &mut [f32]| policy.act(&out.observation, actions);
    evaluate(&mut env, act, &mut |_| {}).unwrap()
}

/// What learns with a policy for each agent, and what shares one and needs no probabilities.
const LEARNERS: [(&str, &str); 8] = [
    ("happo", "ppo = { n_env = 64, shard = 32, steps = 32, updates = 60, epochs = 4, minibatches = 4 }"),
    (
        "ppo",
        "ppo = { team = 'separate', n_env = 64, shard = 32, steps = 32, updates = 60, epochs = 4, minibatches = 4 }",
    ),
    (
        "matd3",
        "td3 = { separate_actors = true, saturation_penalty = 0.001, n_env = 64, shard = 32, updates = 200, batch = 128, network.hidden = [32, 32], critic.hidden = [64, 64] }",
    ),
    (
        "sac",
        "sac = { central_critic = true, separate_actors = true, saturation_penalty = 0.001, n_env = 64, shard = 32, updates = 150, batch = 128, network.hidden = [32, 32], critic.hidden = [64, 64] }",
    ),
    (
        "happo",
        "env.actions = { kind = 'multi_discrete', levels = 5 }\nppo = { n_env = 64, shard = 32, steps = 32, updates = 60 }",
    ),
    ("apg", "apg = { n_env = 64, shard = 32, updates = 150 }"),
    (
        "vdn",
        "env.actions = { kind = 'multi_discrete', levels = 5 }\ndqn = { separate_values = true, n_env = 64, shard = 32, updates = 300, batch = 128, network.hidden = [32, 32] }",
    ),
    (
        "qmix",
        "env.actions = { kind = 'multi_discrete', levels = 5 }\ndqn = { separate_values = true, n_env = 64, shard = 32, updates = 300, batch = 128, network.hidden = [32, 32] }",
    ),
];

#[test]
fn unlike_agents_learn_with_a_policy_each_or_along_gradients() {
    for (algorithm, settings) in LEARNERS {
        let (mut learner, seen) = begun(algorithm, settings, 2).unwrap();
        let before = flown(&learner, &seen).return_mean;
        learnt(&mut learner);
        let after = flown(&learner, &seen).return_mean;
        println!("{algorithm}: {before:.1} {after:.1}");
        // measured 27 to 28 and 94.9 to 97.6 of 100
        assert!(before < 40.0 && after > 90.0, "{algorithm}: {before} {after}");
    }
}

/// Outputs that an agent has no command for have neither probability nor entropy nor slope.
#[test]
fn weights_of_what_an_agent_cannot_do_stay_as_they_began() {
    for (algorithm, settings) in &LEARNERS[..5] {
        let (mut learner, _) = begun(algorithm, settings, 2).unwrap();
        // of off-policy learners what learns, not the half of it that flies
        let of_first = |learner: &Learning| {
            let (mut policy, mut state) = (Tensors::new(), Tensors::new());
            learner.save(&mut policy, &mut state).unwrap();
            let learns = state.tensor("learner.agent0.0.weight").is_ok();
            let (all, prefix) = if learns { (&state, "learner.agent0") } else { (&policy, "actor.agent0") };
            let numbers = |name: &str| {
                let tensor = all.tensor(name).unwrap();
                (tensor.shape().to_vec(), all.get::<f32>(name, tensor.shape()).unwrap().to_vec())
            };
            let layers = (0..).take_while(|k| all.tensor(&format!("{prefix}.{k}.weight")).is_ok()).count();
            let mut own = vec![("weight", numbers(&format!("{prefix}.{}.weight", layers - 1)))];
            own.push(("bias", numbers(&format!("{prefix}.{}.bias", layers - 1))));
            let log_std = format!("{prefix}.log_std");
            own.extend(all.tensor(&log_std).is_ok().then(|| ("log_std", numbers(&log_std))));
            own
        };
        let before = of_first(&learner);
        (0..20).for_each(|_| drop(learner.update().unwrap()));
        for ((what, (shape, was)), (_, (_, is))) in before.into_iter().zip(of_first(&learner)) {
            // one, two (means and deviations) or five numbers (levels) for each of six
            let (rows, width) = (shape[0], was.len() / shape[0]);
            let (halves, of_number) = if *algorithm == "sac" { (2, 1) } else { (1, rows / 6) };
            for row in 0..rows {
                let number = row % (rows / halves) / of_number;
                let same = was[row * width..][..width] == is[row * width..][..width];
                assert_eq!(same, number >= 4, "{algorithm}, {what}: number {number} of row {row}");
            }
        }
    }
}

#[test]
fn unlike_teams_have_the_same_bits_for_any_number_of_threads() {
    for (algorithm, settings) in LEARNERS {
        let run = |threads| {
            let (mut learner, _) = begun(algorithm, settings, threads).unwrap();
            (0..12).for_each(|_| drop(learner.update().unwrap()));
            let (mut policy, mut state) = (Tensors::new(), Tensors::new());
            learner.save(&mut policy, &mut state).unwrap();
            (policy, state)
        };
        assert!(run(1) == run(2), "{algorithm}");
    }
}

#[test]
fn unlike_agents_that_share_a_policy_are_refused_where_probabilities_or_values_of_actions_count() {
    let levels = "env.actions = { kind = 'multi_discrete', levels = 3 }";
    for algorithm in ["ppo", "mappo", "sac", "td3", "matd3", "fasttd3", "dqn", "vdn", "qmix"] {
        let settings = if algorithm::base(algorithm) == "dqn" { levels } else { "" };
        let said = begun(algorithm, settings, 1).err().expect(algorithm).to_string();
        assert!(said.contains("[4, 6]") && said.contains("apg"), "{algorithm}: {said}");
    }
}
