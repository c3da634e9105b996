use super::*;
use crate::learner::{Learner, saved};
use crate::nn::Layers;
use crate::replay::ReplayConfig;
use crate::sac::{Entropy, SacConfig};
use crate::schedule::Schedule;
use crate::state;
use crate::td3::{ActionNoise, Td3Config};
use crate::warm_start::WarmStart;
use rng::{Purpose, Stream};
use tasks::probe::Probe;
use tasks::{Env, EnvConfig, ObservationTransform};

fn small<E: Exploration>() -> ActorCriticConfig<E> {
    let layers = |own: Layers| Layers { hidden: vec![16, 16], ..own };
    let usual = ActorCriticConfig::<E>::default();
    ActorCriticConfig {
        n_env: 12,
        shard: 5,
        steps: 8,
        updates: 20,
        gradient_steps: 4,
        batch: 100,
        discount: 0.97,
        replay: ReplayConfig { capacity: 2000, learning_starts: 96, n_step: 3.0.into(), ..ReplayConfig::default() },
        network: layers(usual.network.clone()),
        critic: layers(usual.critic.clone()),
        ..usual
    }
}

fn of<E: Exploration>(task: &str, config: ActorCriticConfig<E>, threads: usize) -> ActorCritic<E> {
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    ActorCritic::with(&|own| Env::make(task, own), &env, config, 5, Threads::new(threads).unwrap()).unwrap()
}

/// A team whose agents have an actor each.
fn each_its_own() -> Td3Config {
    Td3Config { central_critic: true, separate_actors: true, ..small() }
}

/// What the critics and the actor of a batch minimise, with the noise that the batch was drawn with, and their gradients.
struct Gradients {
    losses: [f64; 2],
    gradients: [Vec<f32>; 2],
}

fn descent<E: Exploration>(own: &mut ActorCritic<E>, alpha: f64) -> Gradients {
    own.critic_gradients(0.0);
    let judged: Vec<[f64; 5]> = own.work.iter().map(|work| work.sums).collect();
    own.actor_gradient(0.0);
    let (batch, agents) = (own.config.batch as f64, (own.config.batch * own.shapes.agents) as f64);
    let sum = |k: usize| own.work.iter().map(|work| work.sums[k]).sum::<f64>();
    let std = f64::from(own.value_norm.unit().std);
    let fold = |of: &dyn Fn(&Work) -> Vec<f32>| {
        let all: Vec<Vec<f32>> = own.work.iter().map(of).collect();
        (0..all[0].len()).map(|k| all.iter().map(|g| g[k]).sum()).collect::<Vec<f32>>()
    };
    Gradients {
        losses: [
            judged.iter().map(|sums| sums[0]).sum::<f64>() / batch,
            (sum(3) + alpha / std * sum(2) + own.config.saturation_penalty.at(0.0) * sum(4)) / agents,
        ],
        gradients: [fold(&|work| work.gradients[0].clone()), fold(&|work| work.gradient.clone())],
    }
}

/// Largest difference of `gradient` from differences of `loss` by weights, as a share of its norm.
fn worst(gradient: &[f32], mut loss: impl FnMut(usize, f32) -> f64) -> f64 {
    let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
    let (h, mut worst) = (3e-3, 0.0_f64);
    for (k, g) in gradient.iter().enumerate().step_by(13) {
        let slope = (loss(k, h) - loss(k, -h)) / (2.0 * f64::from(h));
        worst = worst.max((slope - f64::from(*g)).abs());
    }
    assert!(norm > 1e-6, "nothing to go down");
    worst / norm
}

fn check_gradients<E: Exploration>(task: &str, config: ActorCriticConfig<E>, alpha: f64) {
    let name = E::NAME;
    let mut own = of(task, ActorCriticConfig { critics: 2, huber: f64::INFINITY, ..config }, 1);
    (0..3).for_each(|_| drop(own.update().unwrap()));
    let Gradients { gradients: [of_critic, of_actor], .. } = descent(&mut own, alpha);
    let first = own.critics[1].parameters.clone();
    let critic = worst(&of_critic, |k, h| {
        let before = own.critics[0].parameters[k];
        own.critics[0].parameters[k] += h;
        let loss = descent(&mut own, alpha).losses[0];
        own.critics[0].parameters[k] = before;
        loss
    });
    assert_eq!(own.critics[1].parameters, first);
    let actor = worst(&of_actor, |k, h| {
        let before = own.actor.parameters[k];
        own.actor.parameters[k] += h;
        let loss = descent(&mut own, alpha).losses[1];
        own.actor.parameters[k] = before;
        loss
    });
    println!("{name} on {task}: critic {critic:.1e}, actor {actor:.1e} of the norm");
    assert!(critic < 2e-3 && actor < 5e-3, "{name} on {task}: {critic:e} {actor:e}");
}

/// Where no temperature moves, −Q + α ln π + c · mean square before tanh is what the actor goes down, and half the squared error what
/// critics do.
#[test]
fn gradients_of_actor_and_critics_are_those_of_differences_alone_and_in_teams() {
    let still = Entropy { temperature: 0.3, learning_rate: 0.0, ..Entropy::default() };
    check_gradients("Hover", SacConfig { exploration: still.clone(), ..small() }, 0.3);
    check_gradients("Hover", Td3Config { ..small() }, 0.0);
    check_gradients("Hover", SacConfig { exploration: still.clone(), saturation_penalty: 5.0.into(), ..small() }, 0.3);
    check_gradients("OverHover", SacConfig { exploration: still, central_critic: true, ..small() }, 0.3);
    check_gradients("OverHover", Td3Config { central_critic: true, ..small() }, 0.0);
    check_gradients("OverHover", each_its_own(), 0.0);
    check_gradients("Hover", Td3Config { quantiles: 5, ..small() }, 0.0);
    check_gradients("OverHover", Td3Config { saturation_penalty: 5.0.into(), ..each_its_own() }, 0.0);
}

/// y = r + γᵏ (minᵢ Q̄ᵢ(o', a') + b) by one row at a time, for steps that go on and that end; `next` writes a' and gives b. Of critics
/// that tell quantiles, those of the one with the least mean.
fn check_targets<E: Exploration>(
    task: &str,
    config: ActorCriticConfig<E>,
    next: impl Fn(&[f32], &mut Stream, &mut [f32]) -> f64,
) {
    let mut own = of(task, ActorCriticConfig { critics: 2, ..config }, 1);
    (0..18).for_each(|_| drop(own.update().unwrap()));
    own.critic_gradients(0.0);
    let ActorCritic { kind, shapes, actor, critics, experience, work, value_norm, step, .. } = &mut own;
    let follows = if kind.has_target_actor() { &actor.following } else { &actor.parameters };
    let (mut of_actor, mut of_critic) = (shapes.of_set.memory(1), shapes.critic.memory(1));
    let sets: Vec<&[f32]> = follows.chunks_exact(shapes.of_set.n_parameter()).collect();
    let (n, n_base, unit) = (shapes.widths.n_observation, shapes.n_base, value_norm.unit());
    let (mut ended, mut seconds, mut most) = (0, 0, 0.0_f64);
    for (number, Work { block, target, .. }) in work.iter_mut().enumerate() {
        // the same rows, and their stream as it was
        experience.gather(block, (*step, number), 0.0);
        for k in 0..block.rows {
            let (mut x, mut added) = (Vec::new(), 0.0);
            let base = if shapes.widths.n_state > 0 { &block.next_state } else { &block.next };
            x.extend_from_slice(&base[k * n_base..][..n_base]);
            for agent in k * shapes.agents..(k + 1) * shapes.agents {
                let seen = &block.next[agent * n..][..n];
                let own = sets[agent % sets.len()];
                let output = shapes.of_set.forward(own, seen, 1, &mut of_actor).row(0).to_vec();
                let mut action = vec![0.0; shapes.widths.n_action];
                added += next(&output, &mut block.stream, &mut action);
                x.extend(action);
            }
            let mut said =
                |net: &NetWithTarget| shapes.critic.forward(&net.following, &x, 1, &mut of_critic).row(0).to_vec();
            let both = [said(&critics[0]), said(&critics[1])];
            let [first, second] = both.each_ref().map(|own| own.iter().sum::<f32>());
            for (got, least) in target[k * shapes.quantiles..].iter().zip(&both[usize::from(second < first)]) {
                let later = f64::from(unit.denormalise(*least)) + added;
                let wanted = f64::from(block.reward[k]) + f64::from(block.discount[k]) * later;
                let got = f64::from(unit.denormalise(*got));
                most = most.max((got - wanted).abs() / (1.0 + wanted.abs()));
            }
            seconds += usize::from(second < first);
            ended += usize::from(block.discount[k] == 0.0);
        }
    }
    println!("{} on {task}: {most:.1e}, {ended} ended", E::NAME);
    assert!(seconds > 0 && seconds < shapes.batch, "{seconds}: one critic is always the least");
    assert!(most < 1e-4 && ended > 0, "{} on {task}: {most:e}, {ended} ended", E::NAME);
}

/// SAC adds α times the entropy of what it draws: −α ln π(a'), of a Gaussian behind tanh (Haarnoja et al. 2018, appendix C). TD3
/// adds nothing, and its slow actor is off by a little (Fujimoto et al. 2018).
#[test]
fn targets_are_what_a_row_by_itself_is_worth() {
    const ALPHA: f64 = 0.3;
    fn soft(output: &[f32], stream: &mut Stream, action: &mut [f32]) -> f64 {
        let n = action.len();
        let mut log_prob = 0.0;
        for (i, a) in action.iter_mut().enumerate() {
            let log_std = -5.0 + 3.5 * (1.0 + f64::from(output[n + i]).tanh());
            let noise = f64::from(stream.normal() as f32);
            let drawn = (f64::from(output[i]) + log_std.exp() * noise).tanh();
            *a = drawn as f32;
            log_prob -= 0.5 * (noise * noise + std::f64::consts::TAU.ln()) + log_std + (1.0 - drawn * drawn).ln();
        }
        -ALPHA * log_prob
    }
    fn slow(output: &[f32], stream: &mut Stream, action: &mut [f32]) -> f64 {
        for (a, y) in action.iter_mut().zip(output) {
            *a = (y.tanh() + (0.2 * stream.normal() as f32).clamp(-0.3, 0.3)).clamp(-1.0, 1.0);
        }
        0.0
    }
    let entropy = Entropy { temperature: ALPHA, learning_rate: 0.0, ..Entropy::default() };
    let noise = ActionNoise { target_noise: 0.2, noise_clip: 0.3, ..ActionNoise::default() };
    for (task, central_critic) in [("Hover", false), ("OverHover", true)] {
        check_targets(task, SacConfig { exploration: entropy.clone(), central_critic, ..small() }, soft);
        check_targets(task, Td3Config { exploration: noise.clone(), central_critic, ..small() }, slow);
    }
    check_targets("OverHover", Td3Config { exploration: noise.clone(), ..each_its_own() }, slow);
    check_targets("Hover", Td3Config { exploration: noise, quantiles: 5, ..small() }, slow);
    check_targets("Hover", SacConfig { exploration: entropy.clone(), quantiles: 5, ..small() }, soft);
    check_targets("OverHover", SacConfig { exploration: entropy, central_critic: true, quantiles: 3, ..small() }, soft);
}

/// Lowe et al. 2017: unlike first weights, unlike steps, and a policy that says of each row what its agent's actor does.
#[test]
fn agents_with_an_actor_each_fly_as_theirs_says() {
    let mut own = of("OverHover", each_its_own(), 2);
    let first = own.actor.parameters.clone();
    (0..4).for_each(|_| drop(own.update().unwrap()));
    let (shapes, n) = (&own.shapes, own.shapes.of_set.n_parameter());
    let steps: Vec<f32> = own.actor.parameters.iter().zip(&first).map(|(now, then)| now - then).collect();
    let moved = steps.chunks_exact(n).all(|own| own.iter().any(|x| *x != 0.0));
    assert!(moved && first[..n] != first[n..2 * n] && steps[..n] != steps[n..2 * n]);
    let sets: Vec<&[f32]> = own.mean.chunks_exact(n).collect();
    assert_eq!(sets.len(), 4);
    let (n_seen, n_action, rows) = (shapes.widths.n_observation, shapes.widths.n_action, 8);
    let seen: Vec<f32> = (0..rows * n_seen).map(|k| (0.37 * k as f32).sin()).collect();
    let mut actions = vec![f32::NAN; rows * n_action];
    own.policy().unwrap().act(&seen, &mut actions).unwrap();
    let mut memory = shapes.of_set.memory(1);
    for row in 0..rows {
        let said = shapes.of_set.forward(sets[row % 4], &seen[row * n_seen..][..n_seen], 1, &mut memory);
        let of_row = &actions[row * n_action..][..n_action];
        assert!(said.row(0).iter().zip(of_row).all(|(y, a)| (y.tanh() - a).abs() < 1e-6), "row {row}");
    }
    // seven do not divide what goes through a network together
    let mut seven = of("Formation", Td3Config { shard: 12, ..each_its_own() }, 1);
    (0..3).for_each(|_| drop(seven.update().unwrap()));
    let refused = Td3Config { central_critic: false, ..each_its_own() }.validate().unwrap_err().to_string();
    assert!(refused.contains("separate_actors") && refused.contains("central_critic = true"), "{refused}");
}

/// Where tanh is 1 to the last bit: by −Q alone an actor stays there for ever. Measured: 12.000 and 1.622.
#[test]
fn a_saturated_actor_is_led_back_by_the_penalty_alone() {
    let before_tanh = |saturation_penalty: f64| {
        let config = Td3Config {
            saturation_penalty: saturation_penalty.into(),
            central_critic: true,
            learning_rate: 0.1.into(),
            ..small()
        };
        let mut own = of("OverHover", config, 1);
        let shapes = &own.shapes;
        let mut first = shapes.actor.parts(&own.actor.parameters).into_iter();
        let corner = shapes.actor.from_parts(&mut |_, shape| {
            let known = first.next().unwrap().data;
            Ok(if shape == [shapes.widths.n_action] { vec![12.0; shapes.widths.n_action] } else { known })
        });
        own.actor.begin(&shapes.actor, corner.unwrap());
        let update = (0..18).map(|_| own.update().unwrap()).last().unwrap();
        update.extra.iter().find(|(name, _)| *name == "before_tanh").unwrap().1
    };
    let [stays, returns] = [0.0, 0.1].map(before_tanh);
    println!("{stays:.3} and {returns:.3}");
    assert!((stays - 12.0).abs() < 0.2 && returns < 4.0, "{stays} {returns}");
}

#[test]
fn a_penalty_that_drives_into_the_corner_is_refused_behind_a_warm_up_too() {
    for (from, to, warm_up) in [(-0.1, 0.1, 0.0), (-1e-10, 0.1, 0.2), (0.1, -0.1, 0.0), (0.1, 1001.0, 0.0)] {
        let saturation_penalty = Schedule::Linear { from, to, warm_up };
        let refused = Td3Config { saturation_penalty, ..small() }.validate().unwrap_err().to_string();
        let told = if from < 0.0 { from } else { to };
        assert!(
            refused.contains(&format!("saturation_penalty is {told}")) && refused.contains("[0, 1000]"),
            "{refused}"
        );
    }
}

/// By its end a penalty that fades to 0 is none; at the beginning it is that of its first number. Of SAC it holds means alone, not
/// deviations, and the log tells the root of their mean square.
#[test]
fn the_penalty_follows_its_schedule_and_holds_the_means_of_sac_alone() {
    let mut own = of("Hover", SacConfig { ..small() }, 1);
    (0..3).for_each(|_| drop(own.update().unwrap()));
    let n = own.shapes.widths.n_action;
    let mut gradient = |penalty: Schedule, progress: f64| {
        own.config.saturation_penalty = penalty;
        own.critic_gradients(0.0);
        own.actor_gradient(progress);
        let (mut squares, mut rows) = (0.0, 0.0);
        for Work { block, .. } in &own.work {
            let mut memory = own.shapes.actor.memory(block.rows);
            let output = own.shapes.actor.forward(&own.actor.parameters, &block.observation, block.rows, &mut memory);
            for k in (0..block.rows).filter(|k| block.weight[*k] > 0.0) {
                squares += output.row(k)[..n].iter().map(|y| f64::from(y * y)).sum::<f64>() / n as f64;
                rows += 1.0;
            }
        }
        let told: f64 = own.work.iter().map(|work| work.sums[4]).sum();
        assert!((told - squares).abs() < 1e-4 * squares && rows > 50.0, "{told} {squares} of {rows}");
        own.work.iter().map(|work| work.gradient.clone()).collect::<Vec<_>>()
    };
    let fades = Schedule::Linear { from: 5.0, to: 0.0, warm_up: 0.0 };
    let [none, five] = [0.0, 5.0].map(|penalty| gradient(penalty.into(), 0.5));
    assert!(none != five);
    assert_eq!(gradient(fades, 1.0), none);
    assert_eq!(gradient(fades, 0.0), five);
}

/// Fujimoto et al. 2018, section 5.2.
#[test]
fn the_actor_of_td3_and_all_that_follows_wait_for_every_second_step() {
    let mut own = of("Hover", Td3Config { actor_delay: 2, tau: 0.1, ..small() }, 1);
    (0..3).for_each(|_| drop(own.update().unwrap()));
    for _ in 0..4 {
        let all = |own: &ActorCritic<ActionNoise>| {
            let critic = &own.critics[0];
            [&own.actor.parameters, &own.actor.following, &critic.following, &critic.parameters].map(Vec::clone)
        };
        let before = all(&own);
        own.gradient_step(&mut Metrics::default());
        let climbs = own.step.is_multiple_of(2);
        let moved: Vec<bool> = before.iter().zip(&all(&own)).map(|(then, now)| then != now).collect();
        assert_eq!(moved, [climbs, climbs, climbs, true], "step {}", own.step);
    }
}

/// What is saved is what flies, and a run that begins from it flies likewise: of SAC the half of the outputs that is an action.
#[test]
fn policies_with_an_actor_for_each_agent_are_saved_and_begun_from() {
    fn check<E: Exploration>(config: ActorCriticConfig<E>) {
        let mut own = of("OverHover", config.clone(), 1);
        (0..4).for_each(|_| drop(own.update().unwrap()));
        let (saved, policy) = (saved(&own).0, own.policy().unwrap());
        assert_eq!(state::actor(&saved, &own.flown).unwrap(), policy.parameters(), "{}", E::NAME);
        let mut begun = of("OverHover", config, 1);
        let spec = own.experience.env().spec();
        begun.warm_start(&WarmStart::new(&policy, spec, &begun.flown, spec).unwrap()).unwrap();
        assert_eq!(begun.policy().unwrap().parameters(), policy.parameters(), "{}", E::NAME);
    }
    check(each_its_own());
    check(SacConfig { central_critic: true, separate_actors: true, ..small() });
}

#[test]
fn results_are_the_same_bits_for_any_number_of_threads_and_go_on_with_them() {
    fn check<E: Exploration>(task: &str, config: ActorCriticConfig<E>) {
        let run = |threads, updates| {
            let mut own = of(task, config.clone(), threads);
            (0..updates).for_each(|_| drop(own.update().unwrap()));
            own
        };
        let whole = saved(&run(1, 9));
        assert!(whole == saved(&run(2, 9)), "{task}");
        let (policy, state) = saved(&run(1, 5));
        let mut resumed = of(task, config.clone(), 2);
        resumed.load(&policy, &state).unwrap();
        (0..4).for_each(|_| drop(resumed.update().unwrap()));
        assert!(whole == saved(&resumed), "{task}, resumed");
    }
    let prioritised = ReplayConfig { priority: 0.6, ..small::<Entropy>().replay };
    check("Hover", SacConfig { replay: prioritised, ..small() });
    check("Hover", Td3Config { ..small() });
    check("Hover", Td3Config { quantiles: 5, ..small() });
    check("OverHover", Td3Config { central_critic: true, ..small() });
    check("OverHover", each_its_own());
}

/// Of the one state there is, with reward 1 for ever and episodes that are cut short: 100 at γ = 0.99. Unless cuts are kept as deaths.
fn worth_of_forever<E: Exploration>(exploration: E, n_step: f64, cuts_are_deaths: bool) -> f64 {
    let linear = |own: &Layers| Layers { hidden: vec![], ..own.clone() };
    let usual = small::<E>();
    let config = ActorCriticConfig {
        exploration,
        discount: 0.99,
        tau: 0.1,
        normalise_observation: false, // of the one that there is nothing would be left
        gradient_steps: 32,
        updates: 1000,
        batch: 32,
        critic_learning_rate: Schedule::cosine(5e-3, 1e-5),
        // an actor that climbs finds actions after which few rows of a story that repeats happen to end
        learning_rate: if cuts_are_deaths { Schedule::constant(1e-9) } else { usual.learning_rate },
        max_grad_norm: f64::INFINITY,
        network: linear(&usual.network),
        critic: linear(&usual.critic),
        replay: ReplayConfig { n_step: n_step.into(), ..usual.replay.clone() },
        ..usual
    };
    let env = EnvConfig { stagger: true, ..EnvConfig::default() };
    let make = |c: &EnvConfig| Env::of(Probe::forever(c)?, "forever", c);
    let mut own = ActorCritic::with(&make, &env, config, 1, Threads::new(1).unwrap()).unwrap();
    let truthful = if cuts_are_deaths { 20 } else { 1000 };
    (0..truthful).for_each(|_| drop(own.update().unwrap()));
    if cuts_are_deaths {
        let mut steps = [0; 12];
        own.experience.retell(|env, _, _| {
            steps[env] += 1;
            (1.0, steps[env] % 10 == 0)
        });
    }
    for update in truthful..1000 {
        own.update = update;
        (0..32).for_each(|_| own.gradient_step(&mut Metrics::default()));
        own.rescale_critics().unwrap();
    }
    own.critic_gradients(0.0);
    let of_living = own.work[0].block.discount.iter().position(|g| *g > 0.0).unwrap();
    f64::from(own.value_norm.unit().denormalise(own.work[0].target[of_living]))
}

#[test]
fn time_that_runs_out_is_not_death() {
    let cold = Entropy { temperature: 1e-6, learning_rate: 0.0, ..Entropy::default() };
    for n_step in [1.0, 4.0] {
        let of = |cuts_are_deaths| {
            [
                worth_of_forever(cold.clone(), n_step, cuts_are_deaths),
                worth_of_forever(ActionNoise::default(), n_step, cuts_are_deaths),
            ]
        };
        let found = of(false);
        println!("n = {n_step}: {found:?}");
        for worth in found {
            assert!((worth - 100.0).abs() < 1.0, "n = {n_step}: {worth}");
        }
        // the published MADDPG keeps them so
        let found = of(true);
        println!("cuts as deaths, n = {n_step}: {found:?}");
        assert!(found.iter().all(|worth| (5.0..12.0).contains(worth)), "{found:?}");
    }
}

#[test]
fn actions_of_whole_numbers_and_batches_beyond_memory_are_refused() {
    use tasks::ActionSpace;
    let make = |own: &EnvConfig| Env::make("Hover", own);
    let refused = |env: EnvConfig, config: SacConfig| {
        ActorCritic::with(&make, &env, config, 0, Threads::new(1).unwrap()).map(drop).unwrap_err().to_string()
    };
    let levels = EnvConfig { actions: ActionSpace::MultiDiscrete { levels: 3 }, ..EnvConfig::default() };
    assert!(refused(levels, small()).contains("dqn"));
    let little = EnvConfig { memory_limit: 50 << 20, ..EnvConfig::default() };
    let replay = ReplayConfig { capacity: 1 << 27, ..ReplayConfig::default() };
    assert!(refused(little.clone(), SacConfig { replay, ..small() }).contains("replay.capacity"));
    assert!(refused(little, SacConfig { batch: 1 << 20, ..small() }).contains("batch"));
    let stages = vec![ObservationTransform::Normalise { clip: 10.0 }, ObservationTransform::History { steps: 2 }];
    assert!(refused(EnvConfig { observation: stages, ..EnvConfig::default() }, small()).contains("behind normalise"));
    let team = ReplayConfig { priority: 0.5, ..small::<Entropy>().replay };
    let central = SacConfig { central_critic: true, replay: team, ..small() };
    assert!(refused(EnvConfig::default(), central).contains("central critic"));
}

/// What is held is that of an agent and an update, and ρ is the correlation of two steps.
#[test]
fn noise_lasts_for_an_update_as_its_correlation_says() {
    let rho = 0.8;
    let drawn = |environment: u64, update: u64, step: u64| {
        let mut own = Stream::new(3, environment, 100 * update + step, Purpose::POLICY);
        let held = Stream::new(3, environment, update, Purpose::EXPLORATION);
        f64::from(Noise { stream: &mut own, held: Some((held, rho)) }.normal())
    };
    let n = 20_000;
    let mean = |of: &dyn Fn(u64) -> f64| (0..n).map(of).sum::<f64>() / n as f64;
    let same = mean(&|i| drawn(i, 0, 0) * drawn(i, 0, 1));
    let later = mean(&|i| drawn(i, 0, 0) * drawn(i, 1, 0));
    let square = mean(&|i| drawn(i, 0, 0).powi(2));
    println!("correlation {same:.3} in an update, {later:.3} of two, variance {square:.3}");
    assert!((same - rho).abs() < 0.03 && later.abs() < 0.03 && (square - 1.0).abs() < 0.03, "{same} {later} {square}");
}

#[test]
fn what_is_flown_keeps_its_noise_for_an_update() {
    let wander = |correlation: f64| {
        let exploration = ActionNoise { noise: [0.2, 0.2], ..ActionNoise::default() };
        let mut own = of("Hover", Td3Config { correlation, exploration, ..small() }, 1);
        (0..2).for_each(|_| drop(own.update().unwrap())); // the first with actions drawn evenly
        let mut done = vec![Vec::new(); 12];
        own.experience.retell(|env, _, action| {
            done[env].push(action.to_vec());
            (0.0, false)
        });
        let steps = done.iter().flat_map(|own| own[own.len() - 9..own.len() - 1].windows(2));
        let (n, sum) = steps.fold((0, 0.0), |(n, sum), pair| (n + 1, sum + f64::from((pair[1][0] - pair[0][0]).abs())));
        sum / f64::from(n)
    };
    let (fresh, held) = (wander(0.0), wander(1.0));
    println!("an action moves by {fresh:.3} a step, by {held:.3} with noise that is held"); // 0.199, 0.001
    assert!(held < 0.25 * fresh, "{held} {fresh}");
}
