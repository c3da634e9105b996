use super::mixing::Mixing;
use super::*;
use crate::learner::{Learner, saved};
use crate::nn::Layers;
use crate::nn::elementwise::approach;
use crate::replay::ReplayConfig;
use crate::schedule::Schedule;
use rng::{Purpose, Stream};
use tasks::probe::Probe;
use tasks::{ActionSpace, Env, EnvConfig, Space};

fn small() -> DqnConfig {
    let usual = DqnConfig::default();
    DqnConfig {
        n_env: 12,
        shard: 5,
        steps: 8,
        updates: 20,
        gradient_steps: 4,
        batch: 100,
        replay: ReplayConfig { capacity: 2000, learning_starts: 96, n_step: 3.0.into(), ..ReplayConfig::default() },
        tau: 0.01,
        duelling: false,
        network: Layers { hidden: vec![16, 16], layer_norm: false, ..usual.network.clone() },
        ..usual
    }
}

fn of(task: &str, env: &EnvConfig, config: DqnConfig, threads: usize) -> Dqn {
    Dqn::with(&|own| Env::make(task, own), env, config, 5, Threads::new(threads).unwrap()).unwrap()
}

fn staggered() -> EnvConfig {
    EnvConfig { stagger: true, ..EnvConfig::default() }
}

const QMIX: ValueMixer = ValueMixer::Monotone { units: 16, hidden: 32 };

/// Every kind of value there is, and the task that it is tried on.
fn kinds() -> Vec<(&'static str, DqnConfig)> {
    let prioritised = ReplayConfig { priority: 0.6, ..small().replay };
    vec![
        ("Hover", small()),
        ("Hover", DqnConfig { duelling: true, double: false, replay: prioritised, ..small() }),
        ("Hover", DqnConfig { quantiles: 5, duelling: true, ..small() }),
        ("OverHover", DqnConfig { mixer: ValueMixer::Sum, ..small() }),
        ("OverHover", DqnConfig { mixer: QMIX, ..small() }),
        ("OverHover", DqnConfig { mixer: ValueMixer::Sum, duelling: true, separate_values: true, ..small() }),
        ("OverHover", DqnConfig { mixer: QMIX, separate_values: true, ..small() }),
    ]
}

/// What the network of agent `agent` says of `x`, by the parameters of all.
fn said_of(shapes: &Shapes, parameters: &[f32], agent: usize, x: &[f32]) -> Vec<f32> {
    let n = shapes.of_set.n_parameter();
    let set = agent % (parameters.len() / n);
    shapes.of_set.forward(&parameters[set * n..][..n], x, 1, &mut shapes.of_set.memory(1)).row(0).to_vec()
}

/// The loss of the batch that is drawn next, and its gradients.
fn descent(own: &mut Dqn) -> (f64, [Vec<f32>; 2]) {
    descent_but(own, |_| ())
}

/// Likewise, but for what `spoil` does to rows whose targets are known.
fn descent_but(own: &mut Dqn, spoil: fn(&mut ReplayBlock)) -> (f64, [Vec<f32>; 2]) {
    let Dqn { shapes, net, mixer, experience, config, step, work, value_norm, .. } = own;
    let unit = value_norm.unit();
    for (number, work) in work.iter_mut().enumerate() {
        experience.gather(&mut work.block, (*step, number), 0.0);
        work.td_targets(shapes, (net, mixer.as_ref()), config.double, unit);
        spoil(&mut work.block);
        work.loss_gradient(shapes, (net, mixer.as_ref()), config.huber as f32);
    }
    let fold = |of: &dyn Fn(&Work) -> &[f32]| {
        (0..of(&work[0]).len()).map(|k| work.iter().map(|w| of(w)[k]).sum()).collect::<Vec<f32>>()
    };
    let loss = work.iter().map(|w| w.sums[0]).sum::<f64>() / config.batch as f64;
    (loss, [fold(&|w| &w.gradient), fold(&|w| &w.mixer_gradient)])
}

#[test]
fn gradients_of_every_kind_of_value_are_those_of_differences() {
    for (task, config) in kinds() {
        let name = format!("{task}, {:?}, {} quantiles", config.mixer, config.quantiles);
        // greedy choices of the learnt network would jump with its weights
        let mut own = of(task, &staggered(), DqnConfig { double: false, ..config }, 1);
        (0..3).for_each(|_| drop(own.update().unwrap()));
        let (_, gradients) = descent(&mut own);
        for (which, gradient) in gradients.iter().enumerate() {
            let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
            let (h, mut worst) = (2e-3_f32, 0.0_f64);
            for (k, g) in gradient.iter().enumerate().step_by(11) {
                let mut at = |by: f32| {
                    let moved = |own: &mut Dqn, by: f32| match which {
                        0 => own.net.parameters[k] += by,
                        _ => own.mixer.as_mut().unwrap().parameters[k] += by,
                    };
                    moved(&mut own, by);
                    let loss = descent(&mut own).0;
                    moved(&mut own, -by);
                    loss
                };
                let slope = (at(h) - at(-h)) / (2.0 * f64::from(h));
                worst = worst.max((slope - f64::from(*g)).abs());
            }
            println!("{name}: {:.1e} of the norm", worst / norm.max(1e-12));
            assert!(gradient.is_empty() || norm > 1e-6, "{name}: nothing to go down");
            assert!(worst <= 5e-3 * norm, "{name}: {worst:e} of {norm}");
        }
    }
}

#[test]
fn results_are_the_same_bits_for_any_number_of_threads_and_go_on_with_them() {
    for (task, config) in kinds() {
        let run = |threads, updates| {
            let mut own = of(task, &staggered(), config.clone(), threads);
            (0..updates).for_each(|_| drop(own.update().unwrap()));
            own
        };
        let whole = saved(&run(1, 9));
        assert!(whole == saved(&run(2, 9)), "{task}");
        let (policy, state) = saved(&run(1, 5));
        let mut resumed = of(task, &staggered(), config.clone(), 2);
        resumed.load(&policy, &state).unwrap();
        (0..4).for_each(|_| drop(resumed.update().unwrap()));
        assert!(whole == saved(&resumed), "{task}, resumed");
    }
}

/// What flies says of an observation what the network that follows does: the mean of each action's quantiles.
#[test]
fn what_flies_gives_the_values_that_were_learnt() {
    for (task, config) in kinds() {
        let mut own = of(task, &staggered(), config, 1);
        (0..6).for_each(|_| drop(own.update().unwrap()));
        let flown = own.flown_parameters().unwrap();
        let x = vec![0.3; own.shapes.network.n_input()];
        let mut memory = own.flown.mlp.memory(1);
        let values = own.shapes.values;
        assert_eq!(flown.len(), own.flown.n_parameter());
        for (agent, flown) in flown.chunks_exact(own.flown.mlp.n_parameter()).enumerate() {
            let output = said_of(&own.shapes, &own.net.following, agent, &x);
            for (k, q) in own.flown.mlp.forward(flown, &x, 1, &mut memory).row(0).iter().enumerate() {
                let learnt = values.value(&output, k / values.levels, k % values.levels);
                assert!((q - learnt).abs() < 1e-4, "{q} {learnt}");
            }
        }
    }
}

/// The double target: chosen by the learnt network, valued by the target network.
#[test]
fn double_targets_value_what_the_learnt_network_chooses() {
    for double in [false, true] {
        let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..staggered() };
        let mut own = of("Hover", &env, DqnConfig { double, ..small() }, 1);
        (0..12).for_each(|_| drop(own.update().unwrap()));
        descent(&mut own);
        let (n, values, unit) = (own.shapes.widths.n_observation, own.shapes.values, own.value_norm.unit());
        let (mut memory, mut differ) = (own.shapes.network.memory(1), 0);
        for work in &own.work {
            for k in 0..work.block.rows {
                let mut said = |parameters: &[f32]| {
                    let next = &work.block.next[k * n..][..n];
                    own.shapes.network.forward(parameters, next, 1, &mut memory).row(0).to_vec()
                };
                let (learnt, target) = (said(&own.net.parameters), said(&own.net.following));
                let by = if double { &learnt } else { &target };
                let next = unit.denormalise(target[values.best(by, 0)]);
                let wanted = work.block.reward[k] + work.block.discount[k] * next;
                assert!((unit.denormalise(work.target[k]) - wanted).abs() < 1e-3);
                differ += usize::from(values.best(&learnt, 0) != values.best(&target, 0));
            }
        }
        assert!(differ > 0, "both networks choose alike");
    }
}

/// y = r + γᵏ Q̄(s', a') of a team by one row at a time: each agent chooses by the learnt network, target networks say what that is
/// worth alone and together.
#[test]
fn targets_of_a_team_are_what_its_target_networks_say_of_what_its_agents_choose() {
    for (mixer, separate_values) in [(ValueMixer::Sum, false), (QMIX, false), (ValueMixer::Sum, true), (QMIX, true)] {
        let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..staggered() };
        let mut own = of("OverHover", &env, DqnConfig { mixer, separate_values, tau: 0.05, ..small() }, 1);
        (0..18).for_each(|_| drop(own.update().unwrap()));
        descent(&mut own);
        let Dqn { shapes, net, mixer: of_team, work, value_norm, .. } = &own;
        let (values, widths, unit) = (shapes.values, shapes.widths, value_norm.unit());
        let (n, agents, n_state) = (widths.n_observation, shapes.agents, widths.n_state);
        let (mut ended, mut most, mut learnt) = (0, 0.0_f32, 0.0_f32);
        for Work { block, target, .. } in work {
            for k in 0..block.rows {
                let said = |parameters: &[f32], agent: usize| {
                    said_of(shapes, parameters, agent, &block.next[(k * agents + agent) * n..][..n])
                };
                let worth = |agent: usize| {
                    let best = values.best(&said(&net.parameters, agent), 0);
                    values.value(&said(&net.following, agent), 0, best)
                };
                let q: Vec<f32> = (0..agents).map(worth).collect();
                let together = |parameters: fn(&NetWithTarget) -> &[f32]| match (of_team, shapes.mixer()) {
                    (Some(net), Some(mlp)) => {
                        let (seen, width) =
                            if n_state > 0 { (&block.next_state, n_state) } else { (&block.next, agents * n) };
                        let mut memory = mlp.memory(1);
                        let weights = mlp.forward(parameters(net), &seen[k * width..][..width], 1, &mut memory);
                        shapes.mixing.as_ref().unwrap().mix(&q, weights.row(0))
                    }
                    _ => q.iter().sum(),
                };
                let of = |team: f32| block.reward[k] + block.discount[k] * unit.denormalise(team);
                let (wanted, got) = (of(together(|net| &net.following)), unit.denormalise(target[k]));
                most = most.max((wanted - got).abs() / (1.0 + wanted.abs()));
                learnt = learnt.max((of(together(|net| &net.parameters)) - got).abs());
                ended += usize::from(block.discount[k] == 0.0);
            }
        }
        println!("{mixer:?}: {most:.1e}, {learnt:.1e} by the mixer that learns, {ended} ended");
        assert!(most < 1e-3 && ended > 0, "{mixer:?}: {most:e}, {ended} ended");
        assert!(mixer == ValueMixer::Sum || learnt > 1e-2, "both mixers say the same");
    }
}

#[test]
fn time_that_runs_out_is_not_death() {
    let config = DqnConfig {
        discount: 0.99,
        tau: 0.2,
        normalise_observation: false, // of the one that there is nothing would be left
        gradient_steps: 32,
        updates: 400,
        batch: 32,
        learning_rate: Schedule::cosine(3e-3, 1e-5),
        network: Layers { hidden: vec![], ..small().network },
        ..small()
    };
    let make = |c: &EnvConfig| Env::of(Probe::forever(c)?, "forever", c);
    let mut own = Dqn::with(&make, &staggered(), config, 1, Threads::new(1).unwrap()).unwrap();
    (0..400).for_each(|_| drop(own.update().unwrap()));
    descent(&mut own);
    let worth = own.value_norm.unit().denormalise(own.work[0].target[0]);
    println!("{worth}");
    assert!((worth - 100.0).abs() < 1.0, "{worth}");
}

/// Returns of −1 and of 1, by the toss of a coin: half of the quantiles are to be found at each, and their mean between.
#[test]
fn quantiles_of_a_coin_are_its_two_sides() {
    let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..staggered() };
    let config = DqnConfig {
        n_env: 40,
        shard: 20,
        quantiles: 6,
        discount: 0.0,
        epsilon: Schedule::constant(1.0),
        updates: 3000,
        learning_rate: Schedule::cosine(5e-3, 1e-5),
        replay: ReplayConfig { n_step: 1.0.into(), ..small().replay },
        network: Layers { hidden: vec![8], ..small().network },
        ..small()
    };
    let mut own = of("Hover", &env, config, 1);
    (0..40).for_each(|_| drop(own.update().unwrap()));
    let mut coin = Stream::new(4, 0, 0, Purpose::LEARNING);
    own.experience.retell(|_, seen, _| {
        seen.fill(1.0);
        (if coin.below(2) == 0 { -1.0 } else { 1.0 }, true)
    });
    for update in 0..3000 {
        own.update = update;
        own.gradient_step(&mut Metrics::default());
    }
    let mut memory = own.shapes.network.memory(1);
    let x = vec![1.0; own.shapes.network.n_input()];
    let output = own.shapes.network.forward(&own.net.parameters, &x, 1, &mut memory).row(0).to_vec();
    let (values, unit) = (own.shapes.values, own.value_norm.unit());
    for action in 0..values.levels {
        let sides: Vec<f32> = (0..6).map(|q| unit.denormalise(values.quantile(&output, 0, action, q))).collect();
        println!("{sides:?}");
        assert!(sides[..2].iter().all(|x| (x + 1.0).abs() < 0.1) && sides[4..].iter().all(|x| (x - 1.0).abs() < 0.1));
    }
}

/// A corridor of five cells: left or right, 1 for its end on the right, 0.3 for that on the left. How far the values that 4000
/// times `learn` lead to are from those of its table.
fn values_of_a_corridor(learn: fn(&mut Dqn)) -> f64 {
    const CELLS: usize = 5;
    let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..staggered() };
    let config = DqnConfig {
        n_env: 40,
        shard: 20,
        discount: 0.9,
        epsilon: Schedule::constant(1.0),
        tau: 0.05,
        updates: 3000,
        learning_rate: Schedule::cosine(3e-3, 1e-5),
        replay: ReplayConfig { n_step: 1.0.into(), ..small().replay },
        network: Layers { hidden: vec![32], ..small().network },
        ..small()
    };
    let mut own = of("Hover", &env, config, 1);
    (0..40).for_each(|_| drop(own.update().unwrap()));
    let mut cells = vec![2; 40];
    own.experience.retell(|env, seen, done| {
        let cell: &mut usize = &mut cells[env];
        seen.fill(0.0);
        seen[*cell] = 1.0;
        let right = done[0] >= 8.0;
        let (reward, ended) = match (*cell, right) {
            (0, false) => (0.3, true),
            (4, true) => (1.0, true),
            _ => (0.0, false),
        };
        *cell = if ended {
            2
        } else if right {
            *cell + 1
        } else {
            *cell - 1
        };
        (reward, ended)
    });
    // value iteration, [cell][right]
    let mut table = [[0.0_f64; 2]; CELLS];
    for _ in 0..200 {
        let best = |cell: usize| table[cell][0].max(table[cell][1]);
        let left = |cell: usize| if cell == 0 { 0.3 } else { 0.9 * best(cell - 1) };
        let right = |cell: usize| if cell == CELLS - 1 { 1.0 } else { 0.9 * best(cell + 1) };
        table = std::array::from_fn(|cell| [left(cell), right(cell)]);
    }
    (0..4000).for_each(|_| learn(&mut own));
    let mut memory = own.shapes.network.memory(1);
    let mut worst = 0.0_f64;
    for (cell, wanted) in table.iter().enumerate() {
        let mut x = vec![0.0; own.shapes.network.n_input()];
        x[cell] = 1.0;
        let said = own.shapes.network.forward(&own.net.parameters, &x, 1, &mut memory).row(0).to_vec();
        for action in 0..16 {
            worst = worst.max(
                (f64::from(own.value_norm.unit().denormalise(said[action])) - wanted[usize::from(action >= 8)]).abs(),
            );
        }
    }
    worst
}

#[test]
fn values_of_a_corridor_are_those_of_its_table() {
    let worst = values_of_a_corridor(improve);
    println!("{worst}");
    assert!(worst < 0.02, "{worst}");
}

/// The published DQN takes Q of the next observation for that of this one: what an action is worth is nowhere learnt.
#[test]
fn dqn_that_fits_the_value_of_the_next_observation_learns_no_values() {
    let worst = values_of_a_corridor(|own| {
        let (_, [gradient, _]) = descent_but(own, |block| block.observation.copy_from_slice(&block.next));
        let Dqn { net, shapes, config, step, .. } = own;
        let rate = config.learning_rate.at(0.0);
        let stride = Stride { clip: config.max_grad_norm, rate, tau: config.tau };
        net.descend(&shapes.network, [&gradient[..]].into_iter(), stride);
        *step += 1;
    });
    println!("{worst}");
    assert!(worst > 0.5, "{worst}");
}

/// The published DQN moves its target network in three of four steps where one was meant: this alone spoils no value.
#[test]
fn dqn_whose_target_moves_in_three_of_four_steps_or_in_one_finds_the_same_values() {
    fn improve_but(own: &mut Dqn, moves: impl Fn(u64) -> bool) {
        let held = own.net.following.clone();
        own.gradient_step(&mut Metrics::default());
        if !moves(own.step) {
            own.net.following = held;
        }
    }
    let three = values_of_a_corridor(|own| improve_but(own, |step| !step.is_multiple_of(4)));
    let one = values_of_a_corridor(|own| improve_but(own, |step| step.is_multiple_of(4)));
    println!("{three} {one}");
    assert!(three < 0.02 && one < 0.02, "{three} {one}");
}

/// A game of one step for the first two agents of a team with `payoff`: the joint action that they settle on, and its value, after
/// 4000 times `learn`.
fn settle(mixer: ValueMixer, payoff: [[f32; 3]; 3], learn: fn(&mut Dqn)) -> ((usize, usize), f32) {
    let env = EnvConfig { actions: ActionSpace::Discrete { levels: 2 }, ..staggered() };
    let config = DqnConfig {
        n_env: 40,
        shard: 20,
        mixer,
        discount: 0.0,
        huber: f64::INFINITY,
        epsilon: Schedule::constant(1.0),
        updates: 4000,
        learning_rate: Schedule::cosine(5e-3, 1e-5),
        replay: ReplayConfig { n_step: 1.0.into(), ..small().replay },
        network: Layers { hidden: vec![16], ..small().network },
        ..small()
    };
    let mut own = of("OverHover", &env, config, 1);
    (0..40).for_each(|_| drop(own.update().unwrap()));
    // sixteen actions of each agent stand for three
    own.experience.retell(|_, seen, done| {
        let n = seen.len() / done.len();
        seen.fill(0.0);
        (0..done.len()).for_each(|agent| seen[agent * n + agent] = 1.0);
        (payoff[done[0] as usize % 3][done[1] as usize % 3], true)
    });
    for update in 0..own.config.updates {
        own.update = update;
        learn(&mut own);
    }
    let mut memory = own.shapes.network.memory(1);
    let (n, agents) = (own.shapes.network.n_input(), own.shapes.agents);
    let mut said = |agent: usize| {
        let mut x = vec![0.0; n];
        x[agent] = 1.0;
        own.shapes.network.forward(&own.net.parameters, &x, 1, &mut memory).row(0).to_vec()
    };
    let values = own.shapes.values;
    let outputs: Vec<Vec<f32>> = (0..agents).map(&mut said).collect();
    let best: Vec<usize> = outputs.iter().map(|own| values.best(own, 0)).collect();
    let q: Vec<f32> = outputs.iter().zip(&best).map(|(own, best)| values.value(own, 0, *best)).collect();
    let mixing = own.shapes.mixing.as_ref().unwrap();
    let worth = match (&own.mixer, own.shapes.mixer()) {
        (Some(net), Some(mlp)) => {
            let mut memory = mlp.memory(1);
            let state = &own.work[0].block.state[..own.shapes.widths.n_state];
            let state = if state.is_empty() { &own.work[0].block.observation[..mlp.n_input()] } else { state };
            mixing.mix(&q, mlp.forward(&net.parameters, state, 1, &mut memory).row(0))
        }
        _ => mixing.mix(&q, &[]),
    };
    ((best[0] % 3, best[1] % 3), own.value_norm.unit().denormalise(worth))
}

fn improve(own: &mut Dqn) {
    own.gradient_step(&mut Metrics::default());
}

/// Worth more where both do the last, and monotone in each.
const TOGETHER: [[f32; 3]; 3] = [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 8.0]];

/// Where the best of each is the best of both, QMIX finds the optimum and what it is worth; a sum finds it, but not its worth
/// where the two are worth more together (Rashid et al. 2018, their two-step game).
#[test]
fn teams_settle_on_the_optimum_of_games_that_are_monotone() {
    let (choice, worth) = settle(QMIX, TOGETHER, improve);
    println!("QMIX {choice:?} {worth}");
    assert!(choice == (2, 2) && (worth - 8.0).abs() < 0.2, "{choice:?} {worth}");
    let (choice, worth) = settle(ValueMixer::Sum, TOGETHER, improve);
    println!("VDN {choice:?} {worth}");
    assert!(choice == (2, 2) && worth < 7.0, "{choice:?} {worth}");
}

/// The published QMIX exchanges the arguments of its soft update: targets stay at the first weights, and what learns is pulled
/// to them.
#[test]
fn qmix_whose_targets_pull_the_learnt_weights_finds_no_worth() {
    let (choice, worth) = settle(QMIX, TOGETHER, |own| {
        let held = [&own.net, own.mixer.as_ref().unwrap()].map(|net| net.following.clone());
        own.gradient_step(&mut Metrics::default());
        let Dqn { net, mixer, shapes, config, .. } = own;
        let mlp = shapes.mixer().unwrap();
        let nets: [(&mut NetWithTarget, &dyn Network); 2] = [(net, &shapes.network), (mixer.as_mut().unwrap(), mlp)];
        for ((net, network), held) in nets.into_iter().zip(held) {
            let mut pulled = net.parameters.clone();
            approach(&mut pulled, &held, config.tau as f32);
            net.begin(network, pulled);
            net.following = held;
        }
    });
    println!("{choice:?} {worth}");
    assert!((worth - 8.0).abs() > 3.0, "{choice:?} {worth}");
}

/// The best of both, 4, stands among −12. Of all tables that are monotone in both agents the nearest in the mean square has
/// the other action as the best of each (sums of squares 205 with it, 247 with one of them, 288 without): QMIX must miss 4.
#[test]
fn qmix_misses_what_is_best_together_where_it_is_bad_alone() {
    let alone = [[4.0, -12.0, -12.0], [-12.0, 0.0, 0.0], [-12.0, 0.0, 0.0]];
    let (choice, worth) = settle(QMIX, alone, improve);
    println!("{choice:?} {worth}");
    assert!(choice.0 != 0 && choice.1 != 0, "{choice:?} {worth}");
}

/// When the unit of the targets moves, values are what they were; those of a team too, else targets of values in a unit that grows
/// by them grow beyond all bounds.
#[test]
fn values_say_the_same_in_another_unit() {
    for (task, config) in kinds() {
        let mut own = of(task, &staggered(), config, 1);
        (0..3).for_each(|_| drop(own.update().unwrap()));
        descent(&mut own);
        let x = vec![0.3; own.shapes.network.n_input()];
        let told = |own: &Dqn| {
            let of = |agent| own.shapes.values.value(&said_of(&own.shapes, &own.net.parameters, agent, &x), 1, 2);
            let all: Vec<f32> = (0..own.shapes.agents).map(of).collect();
            let together = |mixing: &Mixing| {
                let (Some(net), Some(mlp)) = (&own.mixer, own.shapes.mixer()) else { return mixing.mix(&all, &[]) };
                let state = vec![0.2; mlp.n_input()];
                mixing.mix(&all, mlp.forward(&net.parameters, &state, 1, &mut mlp.memory(1)).row(0))
            };
            own.value_norm.unit().denormalise(own.shapes.mixing.as_ref().map_or(all[0], together))
        };
        let (before, unit) = (told(&own), own.value_norm.unit());
        own.work[0].target.fill(50.0);
        own.rescale_values().unwrap();
        let off = (told(&own) - before).abs() / (1.0 + before.abs());
        assert!(own.value_norm.unit() != unit && off < 1e-3, "{task}: {before} {}", told(&own));
    }
}

#[test]
fn mixers_take_no_quantiles_and_continuous_actions_get_levels() {
    let refused = |config: DqnConfig| config.validate().unwrap_err().to_string();
    assert!(refused(DqnConfig { mixer: QMIX, quantiles: 5, ..small() }).contains("quantiles"));
    let priority = ReplayConfig { priority: 0.5, ..small().replay };
    assert!(refused(DqnConfig { mixer: QMIX, replay: priority, ..small() }).contains("priority"));
    assert!(refused(DqnConfig { separate_values: true, ..small() }).contains("separate_values"));
    let own = of("Hover", &EnvConfig::default(), DqnConfig { levels: 5, ..small() }, 1);
    assert_eq!(own.experience.env().spec().action, Space::MultiDiscrete { n: 4, levels: 5 });
}
