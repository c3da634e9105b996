//! What rotors are told: activity of commands in evaluations, and the weight on the change of throttle.

use crate::{config, everywhere};
use omnidrones::controllers::cascade::Level;
use omnidrones::tasks::{Autoreset, Buffers, Env, EnvConfig, evaluate, registry};

/// s = Ω/Ω_max of the rotors of every drone.
fn throttles(env: &Env, environment: usize) -> Vec<Vec<f64>> {
    let state = env.state(environment).unwrap();
    let drones = env.robot().drones().iter();
    drones.map(|d| d.rotors.iter().map(|r| f64::from(state[r.speed]) / r.max_speed).collect()).collect()
}

fn mean_squared_change(before: &[Vec<f64>], now: &[Vec<f64>]) -> f64 {
    let squares = before.iter().flatten().zip(now.iter().flatten()).map(|(b, s)| (s - b).powi(2));
    squares.sum::<f64>() / now.len() as f64
}

#[test]
fn a_weight_on_the_change_of_throttle_is_taken_off_the_reward_and_added_to_the_loss_of_every_task() {
    const WEIGHT: f64 = 0.7;
    everywhere(2, 400, |name, make, config| {
        let (mut plain, mut calm) = (make(config), make(&EnvConfig { throttle_change: WEIGHT, ..config.clone() }));
        let (mut out, mut own) = (Buffers::new(plain.spec()), Buffers::new(calm.spec()));
        plain.reset(None, None, &mut out.out()).unwrap();
        calm.reset(None, None, &mut own.out()).unwrap();
        let (before, after) = (plain.task_spec(), calm.task_spec());
        let term = after.reward.last().unwrap();
        assert!(term.name == "throttle_change" && term.bound == 0.0, "{name}: {term:?}");
        assert_eq!((after.reward.len(), after.loss.len()), (before.reward.len() + 1, before.loss.len() + 1), "{name}");
        assert_eq!(calm.spec().reward_bound, plain.spec().reward_bound, "{name}");
        let agents = plain.spec().n_agent;
        let mut actions = vec![0.0; 2 * agents * plain.spec().action.len()];
        for t in 0..4 {
            let before = [throttles(&calm, 0), throttles(&calm, 1)];
            plain.sample(t, &mut actions);
            let action: Vec<f64> = actions[..actions.len() / 2].iter().map(|a| f64::from(*a)).collect();
            let recorded = (t == 3).then(|| [&plain, &calm].map(|env| env.jacobian(0, &action).unwrap().value));
            plain.step(&actions, &mut out.out()).unwrap();
            calm.step(&actions, &mut own.out()).unwrap();
            for (i, before) in before.iter().enumerate().filter(|(i, _)| own.terminated[*i] == 0) {
                let cost = WEIGHT * mean_squared_change(before, &throttles(&calm, i));
                let (reward, wanted) = (f64::from(own.reward[i * agents]), f64::from(out.reward[i * agents]) - cost);
                assert!((reward - wanted).abs() < 1e-5, "{name}: {reward} for {wanted}"); // rounding of f32
                if let (Some([without, with]), 0, p) = (&recorded, i, calm.layout()) {
                    let gains = [(with[p.reward], reward), (with[p.loss], without[p.loss] + cost)];
                    for (own, wanted) in gains {
                        assert!((own - wanted).abs() < 1e-3 * wanted.abs().max(1.0), "{name}: {own} for {wanted}");
                    }
                }
            }
        }
    });
}

#[test]
fn settings_without_a_weight_are_written_as_before_it_was() {
    let text = toml::to_string(&EnvConfig::default()).unwrap();
    assert!(!text.contains("throttle_change"), "{text}");
    assert!(EnvConfig::keys().contains(&"throttle_change".to_string()));
    for wrong in ["-1", "nan", "1e7"] {
        let error = EnvConfig::from_toml(&format!("throttle_change = {wrong}"), "own")
            .and_then(|own| own.validate().map(|()| own));
        let text = error.unwrap_err().to_string();
        assert!(text.contains("throttle_change"), "{text}");
    }
}

/// Evaluations of policies that are known: one holds its commands still, one lets them jump in every step.
#[test]
fn every_evaluation_tells_what_its_rotors_were_told() {
    for entry in registry::REGISTRY {
        let own = EnvConfig { autoreset: Autoreset::Disabled, ..config(3, 60) };
        for (jump, change) in [(0.0_f32, 0.0), (0.1, 0.2)] {
            let mut env = entry.env(&own).unwrap();
            let mut step = 0;
            let told = evaluate(
                &mut env,
                &mut |_, _, actions| {
                    step += 1;
                    actions.fill(if step % 2 == 0 { -0.2 - jump } else { -0.2 + jump });
                    Ok(())
                },
                &mut |_| {},
            )
            .unwrap();
            let activity = told.activity.unwrap();
            assert!((activity.change - change).abs() < 1e-6, "{}: {activity:?}", entry.name);
            assert!((activity.last_second - change).abs() < 1e-6, "{}: {activity:?}", entry.name);
            assert!(activity.fast == 0.0 || activity.fast > 0.98, "{}: {activity:?}", entry.name);
        }
    }
}

/// Whatever actions mean, a rotor is told a number of [−1, 1], and its speed follows it.
#[test]
fn rotors_are_told_what_their_speeds_follow_in_every_control_mode() {
    for control in Level::ALL {
        let own = EnvConfig { control, ..config(5, 400) };
        let mut env = Env::make("Hover", &own).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let n = env.n_rotor();
        let mut told = vec![f32::NAN; 5 * n];
        for t in 0..30 {
            let before: Vec<_> = (0..5).map(|i| throttles(&env, i).concat()).collect();
            let mut actions = vec![0.0; 5 * env.spec().action.len()];
            env.sample(t, &mut actions);
            env.step(&actions, &mut out.out()).unwrap();
            env.rotor_commands_into(&mut told).unwrap();
            assert!(told.iter().all(|c| (-1.0..=1.0).contains(c)), "{}: {told:?}", control.name());
            if control == Level::Rotor {
                assert_eq!(told, actions);
                for i in 0..5 {
                    let now = throttles(&env, i).concat();
                    for k in 0..n {
                        // the command of a thrust: s = √((c + 1)/2)
                        let wanted = ((f64::from(told[i * n + k]) + 1.0) / 2.0).sqrt();
                        let (left, came) = (wanted - before[i][k], now[k] - before[i][k]);
                        assert!(left * came >= -1e-9 && came.abs() <= left.abs() + 1e-6, "{left} {came}");
                    }
                }
            }
        }
        let error = env.rotor_commands_into(&mut told[1..]).unwrap_err().to_string();
        assert!(error.contains("rotor commands"), "{error}");
    }
}
