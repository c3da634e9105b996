//! Tasks of teams of single drones: Spread.

use omnidrones::tasks::{Buffers, Env, EnvConfig};

fn started(task: &str, text: &str) -> (Env, Buffers) {
    let mut env = Env::make(task, &EnvConfig::from_toml(text, "test").unwrap()).unwrap();
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    (env, out)
}

/// Distance of a drone of the state from a point.
fn distance(env: &Env, state: &[f32], drone: usize, point: &[f32]) -> f32 {
    let at = drone * state.len() / env.spec().n_agent;
    (0..3).map(|k| (state[at + k] - point[k]).powi(2)).sum::<f32>().sqrt()
}

#[test]
fn spread_pays_every_target_by_its_nearest_drone_whoever_that_is() {
    let (mut env, mut out) = started("Spread", "n_env = 64\n[task]\nobserve_place = true");
    let (n, width) = (3, env.spec().info.len());
    let error = env.spec().info_column("coverage_error").unwrap();
    env.step(&[f32::NAN; 64 * 12], &mut out.out()).unwrap();
    for i in 0..64 {
        let (state, goal) = (env.state(i).unwrap(), env.goal(i).unwrap());
        let nearest = |q: &[f32]| (0..n).map(|k| distance(&env, &state, k, q)).fold(f32::INFINITY, f32::min);
        let gaps: Vec<f32> = goal[..9].chunks(3).map(nearest).collect();
        let wanted: f32 = gaps.iter().map(|d| 1.0 / (1.0 + (1.6 * d).powi(2))).sum();
        let (paid, worst) = (out.reward[n * i], gaps.iter().copied().fold(0.0, f32::max));
        assert!((paid - wanted).abs() < 1e-5, "{paid} for {wanted}");
        assert!((out.info[i * width + error] - worst).abs() < 1e-5);
    }
}

#[test]
fn targets_of_spread_are_apart_and_every_drone_takes_one_that_it_sees_where_asked() {
    let (env, out) = started("Spread", "n_env = 256\n[task]\nn_drone = 5\nobserve_place = true");
    let (place, width) = (env.spec().observation_range("place").unwrap(), env.spec().n_observation);
    assert_eq!((env.spec().n_agent, width), (5, 15 + 20 + 3 + 4 + 4 * 14));
    for i in 0..256 {
        let (state, goal) = (env.state(i).unwrap(), env.goal(i).unwrap());
        let (targets, places): (Vec<&[f32]>, Vec<&[f32]>) =
            (goal[..15].chunks(3).collect(), goal[15..].chunks(3).collect());
        for k in 0..5 {
            assert_eq!(places.iter().filter(|q| **q == targets[k]).count(), 1);
            let apart = |q: &&[f32]| (0..3).map(|j| (q[j] - targets[k][j]).powi(2)).sum::<f32>().sqrt();
            assert!(targets[..k].iter().all(|q| apart(q) > 0.8 - 1e-5));
            let seen = &out.observation[(5 * i + k) * width..][place.clone()];
            let way = |j: usize| places[k][j] - state[k * state.len() / 5 + j];
            assert!((0..3).all(|j| (seen[j] - way(j)).abs() < 1e-5));
        }
    }
}
