use super::*;
use rng::{Purpose, Stream};
use tasks::{Env, EnvConfig};

const WIDTHS: Widths = Widths { n_agent: 2, n_observation: 3, n_action: 1, n_state: 2 };
const ENVS: usize = 3;

/// What one environment did, step by step, as nobody would keep it.
#[derive(Clone)]
struct Told {
    seen: Vec<f32>,
    state: Vec<f32>,
    action: Vec<f32>,
    reward: Vec<f32>,
    terminated: bool,
    truncated: bool,
    last: Vec<f32>,
    last_state: Vec<f32>,
}

/// Buffers of the widths above, of which the ring reads what a step writes.
fn buffers() -> Buffers {
    let mut out = Buffers::new(Env::make("Hover", &EnvConfig { n_env: ENVS, ..EnvConfig::default() }).unwrap().spec());
    for (own, width) in [
        (&mut out.observation, WIDTHS.seen()),
        (&mut out.final_observation, WIDTHS.seen()),
        (&mut out.central, WIDTHS.n_state),
        (&mut out.final_central, WIDTHS.n_state),
        (&mut out.reward, WIDTHS.n_agent),
    ] {
        *own = vec![0.0; ENVS * width];
    }
    out
}

/// What all agents of an environment saw.
fn seen(ring: &Ring, slot: usize, env: usize) -> Vec<f32> {
    let mut all = vec![0.0; WIDTHS.seen()];
    ring.observation(slot, env, &(0..WIDTHS.n_agent), &mut all);
    all
}

/// A ring that went round some times, and all that happened to each environment.
fn flown(slots: usize, steps: usize) -> (Ring, Vec<Vec<Told>>) {
    let (mut ring, mut out) = (Ring::new(WIDTHS, ReplayCode::plain(3), ENVS, slots), buffers());
    let mut stream = Stream::new(7, 0, 0, Purpose::LEARNING);
    let mut draw = |x: &mut [f32]| x.iter_mut().for_each(|x| *x = stream.normal() as f32);
    draw(&mut out.observation);
    draw(&mut out.central);
    ring.begin(&out);
    let mut dice = Stream::new(8, 0, 0, Purpose::LEARNING);
    let mut all = vec![Vec::new(); ENVS];
    for _ in 0..steps {
        let (seen, state) = (out.observation.clone(), out.central.clone());
        draw(ring.actions_mut());
        let done = ring.actions().to_vec();
        [&mut out.observation, &mut out.central, &mut out.reward].into_iter().for_each(|own| draw(own));
        draw(&mut out.final_observation);
        draw(&mut out.final_central);
        for i in 0..ENVS {
            // both at once: the end by the task wins
            (out.terminated[i], out.truncated[i]) =
                [(0, 0), (0, 0), (0, 0), (1, 0), (0, 1), (1, 1)][dice.below(6) as usize];
            let row = |x: &[f32], width: usize| x[i * width..(i + 1) * width].to_vec();
            all[i].push(Told {
                seen: row(&seen, 6),
                state: row(&state, 2),
                action: row(&done, 2),
                reward: row(&out.reward, 2),
                terminated: out.terminated[i] == 1,
                truncated: out.truncated[i] == 1,
                last: row(&out.final_observation, 6),
                last_state: row(&out.final_central, 2),
            });
        }
        ring.push(&out);
    }
    (ring, all)
}

fn check(ring: &Ring, all: &[Vec<Told>], n: usize) -> usize {
    let (steps, gamma) = (all[0].len(), 0.9_f64);
    let mut asides = 0;
    for (env, told) in all.iter().enumerate() {
        for k in 0..ring.kept() {
            let (slot, from) = (ring.slot(k), steps - ring.kept() + k);
            let own = &told[from];
            assert_eq!((seen(ring, slot, env), ring.state(slot, env)), (own.seen.clone(), &own.state[..]));
            assert_eq!(ring.action(slot, env), own.action);
            let mut reward = [0.0_f32; 2];
            let path = ring.path(slot, env, n, gamma, &mut reward);
            let (mut wanted, mut weight, mut at) = ([0.0_f64; 2], 1.0, from);
            let next = loop {
                let step = &told[at];
                (0..2).for_each(|a| wanted[a] += weight * f64::from(step.reward[a]));
                weight *= gamma;
                at += 1;
                if step.terminated {
                    break None;
                }
                if step.truncated {
                    asides += 1;
                    break Some((step.last.clone(), step.last_state.clone()));
                }
                if at - from == n || at == steps {
                    break told
                        .get(at)
                        .map_or(Some(last_seen(ring, env)), |next| Some((next.seen.clone(), next.state.clone())));
                }
            };
            assert_eq!(path.steps, at - from);
            (0..2).for_each(|a| assert!((f64::from(reward[a]) - wanted[a]).abs() < 1e-6));
            match next {
                None => assert_eq!(path.discount, 0.0),
                Some((seen, state)) => {
                    assert!((f64::from(path.discount) - weight).abs() < 1e-7);
                    let mut next = vec![0.0; 6];
                    assert_eq!(ring.next(path.next, env, &(0..2), &mut next), &state[..]);
                    assert_eq!(next, seen);
                    assert_eq!(ring.next(path.next, env, &(1..2), &mut next[3..]), &state[..]);
                    assert_eq!(next, seen, "of one agent alone");
                }
            }
        }
    }
    asides
}

/// What is seen now.
fn last_seen(ring: &Ring, env: usize) -> (Vec<f32>, Vec<f32>) {
    (seen(ring, ring.head(), env), ring.state(ring.head(), env).to_vec())
}

#[test]
fn paths_are_those_of_who_keeps_everything_round_and_round_the_ring() {
    for (slots, steps) in [(50, 20), (16, 15), (16, 16), (16, 100), (7, 60)] {
        let (ring, all) = flown(slots, steps);
        assert_eq!(ring.kept(), steps.min(slots - 1));
        for n in [1, 2, 3, 5, 40] {
            assert!(check(&ring, &all, n) > 0, "no episode ran out of time");
        }
    }
}

#[test]
fn what_is_kept_aside_takes_no_more_room_than_the_ring_holds_of_it() {
    let (ring, _) = flown(16, 2000);
    assert!(ring.lasts.len() <= 16 * ENVS * 8, "{}", ring.lasts.len());
}

#[test]
fn a_ring_that_was_saved_goes_on_alike_and_one_that_was_forged_is_refused() {
    let (ring, all) = flown(16, 100);
    let mut tensors = Tensors::new();
    ring.save(3, &mut tensors).unwrap();
    let mut other = Ring::new(WIDTHS, ReplayCode::plain(3), ENVS, 16);
    other.load(3, &tensors).unwrap();
    check(&other, &all, 3);
    assert_eq!((other.lasts, other.free), (ring.lasts.clone(), ring.free.clone()));
    for (head, len) in [(16, 3), (0, 16), (1 << 40, 1)] {
        let mut forged = Tensors::new();
        let own = Ring { head, len, ..ring.clone() };
        own.save(3, &mut forged).unwrap();
        let refused = Ring::new(WIDTHS, ReplayCode::plain(3), ENVS, 16).load(3, &forged).unwrap_err().to_string();
        assert!(refused.contains("within the ring"), "{refused}");
    }
    let mut forged = Tensors::new();
    let place = ring.free.first().copied().unwrap_or(0);
    Ring { free: vec![place; 3], ..ring.clone() }.save(3, &mut forged).unwrap();
    assert!(Ring::new(WIDTHS, ReplayCode::plain(3), ENVS, 16).load(3, &forged).is_err(), "one place twice");
    let mut forged = Tensors::new();
    Ring { lasts: Vec::new(), free: Vec::new(), ..ring }.save(3, &mut forged).unwrap();
    assert!(
        Ring::new(WIDTHS, ReplayCode::plain(3), ENVS, 16).load(3, &forged).is_err(),
        "an observation that is not there"
    );
}

#[test]
fn settings_that_hold_no_path_are_refused() {
    let of = |capacity, n_step: f64| ReplayConfig {
        capacity,
        n_step: n_step.into(),
        learning_starts: 0,
        ..ReplayConfig::default()
    };
    assert!(of(1000, 3.0).validate_for(64).is_ok());
    for (config, says) in [(of(1000, 9.0), "1216"), (of(1, 1.0), "capacity"), (of(1000, 65.0), "n_step")] {
        let refused = config.validate_for(64).unwrap_err().to_string();
        assert!(refused.contains(says), "{refused}");
    }
}
