use super::*;
use crate::nn::{Activation, AdamConfig, Init, Layers, Transposed, Weights};
use crate::policy::Actor;
use crate::policy_optimiser::MAX_RESTARTS;
use crate::schedule::Schedule;
use crate::shards::shards;
use crate::window::windows;
use tasks::SweepOptions;
use tasks::probe::Probe;

/// What the module's documentation says L is, in f64, from a window as it was flown.
fn cost(window: &Window, own: &WindowValue, critic: &mut Critic, weights: CostWeights) -> f64 {
    let Window { steps, shard, .. } = window;
    let n_env = shard.env.spec().n_env;
    let [discount, w] = [weights.discount, weights.critic].map(f64::from);
    let n_known = own.privileged.len() / (n_env * (steps.len() + 1));
    let mut value = |x: &[f32], t: usize| {
        let rows = x.chunks_exact(x.len() / n_env).zip(0..);
        let known = |i: usize| own.privileged[(t * n_env + i) * n_known..][..n_known].iter();
        let x: Vec<f32> = rows.flat_map(|(own, i)| own.iter().chain(known(i))).copied().collect();
        let mut values = vec![0.0; n_env];
        critic.values(&Threads::new(1).unwrap(), &x, &mut values);
        values.into_iter().map(|v| w * f64::from(v) / (1.0 - discount)).collect::<Vec<_>>()
    };
    let (mut sum, mut power) = (0.0, vec![1.0; n_env]);
    for (t, step) in steps.iter().enumerate() {
        let left = (steps.len() - 1 - t) as i32;
        let last = value(&step.final_observation, t);
        for i in 0..n_env {
            let (lost, late) = (step.terminated[i] == 1, step.truncated[i] == 1);
            let inside: f64 = (1..=left).map(|k| discount.powi(k)).sum();
            let behind = w * discount.powi(left + 1) / (1.0 - discount);
            let lasting = if lost && weights.lasting { inside + behind } else { 0.0 };
            sum += power[i] * f64::from(step.cost[i]) * (1.0 + lasting);
            sum += if late && !lost { power[i] * discount * last[i] } else { 0.0 };
            power[i] = if lost || late { 1.0 } else { power[i] * discount };
        }
    }
    let behind = value(&shard.out.observation, steps.len());
    sum += power.iter().zip(behind).map(|(power, v)| power * v).sum::<f64>();
    f64::from(weights.loss_scale) * sum
}

fn flags(window: &Window) -> Vec<u8> {
    window.steps.iter().flat_map(|s| [&s.terminated[..], &s.truncated]).flatten().copied().collect()
}

#[test]
fn the_gradient_of_a_window_with_ends_and_a_critic_is_that_of_differences() {
    let hidden = "\nrandomise = [{ what = 'mass', range = [0.9, 1.1] }]";
    for (objective, hidden) in
        [(TrainingObjective::Loss, ""), (TrainingObjective::Reward, ""), (TrainingObjective::Loss, hidden)]
    {
        let text = "n_env = 24\nseed = 5\nstagger = true\ntask.horizon = 40\ntask.reset_distance = 0.15";
        let config = EnvConfig::from_toml(&format!("{text}{hidden}"), "test").unwrap();
        let shard = shards(&|config| Env::make("Track", config), &config, 24).unwrap().remove(0);
        let spec = shard.env.spec().clone();
        let actor = Actor::new(&spec, &Layers { hidden: vec![16], ..Layers::default() }, true).unwrap();
        let mut stream = Stream::new(9, 0, 0, Purpose::LEARNING);
        let mut p = actor.mlp.init(&mut stream);
        p.resize(actor.n_parameter(), 0.0);
        // an even value would hide a wrong sign, a small one the whole critic
        let wide = Layers { hidden: vec![16], activation: Activation::Elu, ..Layers::default() };
        let n_known = spec.privileged.len();
        assert_eq!(n_known > 0, !hidden.is_empty());
        let n_in = spec.n_observation + n_known;
        let mut critic = Critic::new(n_in, &wide, AdamConfig::default(), (24, 1 << 30), &mut stream).unwrap();
        critic.scale_for_test(3.0);
        let mut window = windows(vec![shard], &actor, 12, objective, SweepOptions::default()).unwrap().remove(0);
        if n_known > 0 {
            window.see_privileged();
        }
        let mut value = WindowValue::new(&window, &critic);
        let lasting = objective == TrainingObjective::Loss;
        let weights = CostWeights { loss_scale: 1.0 / 288.0, discount: 0.9, critic: 0.7, lasting };
        let out = &window.shard.out;
        let from = (window.shard.env.save(), out.observation.clone(), out.privileged.clone());
        let fly = |window: &mut Window, value: &mut WindowValue, critic: &mut Critic, p: &[f32]| {
            window.shard.env.load(&from.0).unwrap();
            window.shard.out.observation.copy_from_slice(&from.1);
            window.shard.out.privileged.copy_from_slice(&from.2);
            window.fly(&actor, Weights { parameters: p, transposed: &Transposed::default() }).unwrap();
            value.see_privileged(window);
            cost(window, value, critic, weights)
        };
        fly(&mut window, &mut value, &mut critic, &p);
        let ends = flags(&window);
        let count = |late: usize| ends.chunks(24).skip(late).step_by(2).flatten().filter(|x| **x == 1).count();
        assert!(count(0) > 2 && count(1) > 2, "{} lost, {} late", count(0), count(1));
        value.weigh_costs(&mut window, &critic, weights);
        let mut transposed = Transposed::default();
        actor.mlp.transpose(&p, &mut transposed);
        let net = Weights { parameters: &p, transposed: &transposed };
        let gradient = window.sweep(&actor, net, &value.d_last).unwrap().to_vec();
        for direction in 0..4 {
            // along the gradient itself first, then random
            let noise = if direction == 0 { 0.0 } else { 0.02 };
            let d: Vec<f32> =
                gradient.iter().map(|g| g + (noise * stream.normal()) as f32 * f32::from(*g != 0.0)).collect();
            let size = d.iter().map(|d| f64::from(*d).powi(2)).sum::<f64>().sqrt();
            let h = 2e-3 / size;
            let mut at = |h: f64| {
                let moved: Vec<f32> = p.iter().zip(&d).map(|(p, d)| p + (h * f64::from(*d)) as f32).collect();
                let cost = fly(&mut window, &mut value, &mut critic, &moved);
                assert_eq!(flags(&window), ends, "an end moved: choose another seed");
                cost
            };
            let differences = (at(h) - at(-h)) / (2.0 * h);
            let exact: f64 = gradient.iter().zip(&d).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
            let off = (differences - exact).abs() / exact.abs();
            println!("{objective:?} {exact:.4e} {off:.1e}");
            assert!(off < 1e-3, "{objective:?}: {exact} against {differences}"); // measured at most 1.7e-4
        }
    }
}

/// Σ γ^t c of the only state of [`Probe::forever`] after learning; with `as_death`, time that runs out is taken for an end.
fn learnt_cost(as_death: bool) -> f32 {
    let make = |config: &EnvConfig| Env::of(Probe::forever(config)?, "forever", config);
    let config = ShacConfig {
        n_env: 16,
        horizon: 16,
        updates: 400,
        discount: 0.99,
        critic_learning_rate: Schedule::cosine(0.01, 1e-4),
        objective: TrainingObjective::Reward,
        ..ShacConfig::default()
    };
    let mut shac = Shac::with(&make, &EnvConfig::default(), config, 1, Threads::new(1).unwrap()).unwrap();
    for update in 0..400 {
        shac.policy_gradient(1.0).unwrap();
        for worker in &mut shac.run.workers {
            for step in worker.window.steps.iter_mut().filter(|_| as_death) {
                step.terminated.copy_from_slice(&step.truncated);
            }
        }
        shac.estimate_targets();
        shac.fit_critic(f64::from(update) / 400.0);
        shac.run.update += 1;
    }
    shac.cost_to_go(&[1.0])[0]
}

#[test]
fn time_that_runs_out_is_not_death_and_the_value_differs_tenfold() {
    let (right, wrong) = (learnt_cost(false), learnt_cost(true));
    println!("{right} {wrong}");
    assert!((right + 100.0).abs() < 0.1, "{right}"); // -100.02
    assert!((-9.3..-5.3).contains(&wrong), "{wrong}"); // -6.1
}

#[test]
fn a_run_that_began_again_goes_on_from_its_tensors_with_the_same_bits() {
    // weights as large as these saturate in every update
    let network = Layers { init: Init::Orthogonal { hidden: 50.0, last: 0.01 }, ..Layers::default() };
    let config =
        ShacConfig { n_env: 8, shard: 8, horizon: 4, updates: 3, saturation: 0.25, network, ..ShacConfig::default() };
    let fresh = || Shac::new("Hover", &EnvConfig::default(), config.clone(), 1, Threads::new(1).unwrap()).unwrap();
    let (mut whole, mut policy, mut state) = (fresh(), Tensors::new(), Tensors::new());
    (0..2).for_each(|_| drop(whole.update().unwrap()));
    assert_eq!((whole.run.optimiser.restarts, whole.n_update()), (2, 0));
    assert_eq!(whole.critic.parameters, whole.target_critic, "the critic began again, its slow copy did not");
    whole.save(&mut policy, &mut state).unwrap();
    let mut resumed = fresh();
    resumed.load(&policy, &state).unwrap();
    for learner in [&mut whole, &mut resumed] {
        while learner.n_update() < learner.budget() {
            learner.update().unwrap();
        }
    }
    assert_eq!(whole.run.optimiser.restarts, MAX_RESTARTS);
    assert_eq!(whole.policy().unwrap().parameters(), resumed.policy().unwrap().parameters());
    assert_eq!(whole.critic.parameters, resumed.critic.parameters);
}
