//! Networks: Adam, encoders, a network for each agent.

use omnidrones::rl::nn::{
    Activation, Adam, AdamConfig, Layers, Mlp, Network, Pass, PerAgent, Recurrence, Transposed, Weights, clip_norm,
};
use omnidrones::rng::{Purpose, Stream};
use std::sync::Arc;

#[test]
fn steps_follow_the_published_formula_in_f64() {
    let config = AdamConfig { beta1: 0.9, beta2: 0.99, epsilon: 1e-5, weight_decay: 0.02 };
    let mut adam = Adam::new(config, 3);
    let mut w = vec![0.5_f32, -1.0, 2.0];
    let (mut exact, mut m, mut v) = ([0.5_f64, -1.0, 2.0], [0.0; 3], [0.0; 3]);
    let mut worst: f64 = 0.0;
    for t in 1..=300 {
        let rate = 0.01 / f64::from(t);
        let g: Vec<f32> = (0..3).map(|i| ((t * (i + 2)) as f32 * 0.37).sin()).collect();
        adam.descend(&mut w, &g, rate);
        for i in 0..3 {
            let g = f64::from(g[i]);
            m[i] = 0.9 * m[i] + 0.1 * g;
            v[i] = 0.99 * v[i] + 0.01 * g * g;
            let (mean, square) = (m[i] / (1.0 - 0.9_f64.powi(t)), v[i] / (1.0 - 0.99_f64.powi(t)));
            exact[i] -= rate * (mean / (square.sqrt() + 1e-5) + 0.02 * exact[i]);
            worst = worst.max((f64::from(w[i]) - exact[i]).abs());
        }
    }
    println!("{worst:.1e}");
    assert!(worst < 1e-5, "{worst:e}"); // measured 4.5e-6
}

#[test]
fn an_epsilon_that_rounds_to_zero_is_refused() {
    for epsilon in [0.0, 1e-60, -1.0, f64::NAN] {
        assert!(AdamConfig { epsilon, ..AdamConfig::default() }.validate().is_err(), "{epsilon}");
    }
    AdamConfig::default().validate().unwrap();
}

#[test]
fn clipping_keeps_the_direction_and_drops_what_is_not_finite() {
    let mut g = vec![3.0, 4.0, 0.0];
    assert_eq!(clip_norm(&mut g, 10.0), 5.0);
    assert_eq!(g, [3.0, 4.0, 0.0]);
    assert_eq!(clip_norm(&mut g, 1.0), 5.0);
    assert!((g[0] - 0.6).abs() < 1e-7 && (g[1] - 0.8).abs() < 1e-7);
    let mut g = vec![f32::NAN, 1.0];
    assert!(clip_norm(&mut g, 1.0).is_nan());
    assert_eq!(g, [0.0, 0.0]);
}

fn layers(text: &str) -> Layers {
    toml::from_str(text).unwrap()
}

#[test]
fn settings_survive_their_text_and_name_what_cannot_be_meant() {
    let text = "join = 'sum'\nmemory = { kind = 'gru', units = 8 }\n\
                [[encoder]]\nkind = 'set'\ngroup = 'others'\nunits = [16, 8]\npool = 'max'\n\
                [[encoder]]\nkind = 'conv1d'\ngroup = 'history'\nlayers = [{ channels = 4, kernel = 3 }]";
    let own = layers(text);
    own.validate().unwrap();
    assert_eq!(layers(&toml::to_string(&own).unwrap()), own);
    assert_eq!(own.memory.as_ref().map(Recurrence::window), Some(16));
    assert!(!toml::to_string(&Layers::default()).unwrap().contains("encoder"), "what is not there is not written");
    for (text, what) in [
        ("memory = { kind = 'gru', units = 0 }", "memory.units is 0"),
        ("memory = { kind = 'gru', units = 8, window = 0 }", "memory.window is 0"),
        ("encoder = [{ kind = 'mlp', group = 'a', units = [] }]", "layers of the encoder of 'a' is 0"),
        ("encoder = [{ kind = 'conv2d', group = 'a', layers = [] }]", "layers of the encoder of 'a' is 0"),
        ("encoder = [{ kind = 'set', group = 'a', units = [0] }]", "units of hidden is 0"),
    ] {
        let told = layers(text).validate().unwrap_err().to_string();
        assert!(told.starts_with(what), "{told}");
    }
    let told = toml::from_str::<Layers>("memory = { kind = 'gru', unit = 8 }").unwrap_err().to_string();
    assert!(told.contains("unknown field `unit`"), "{told}");
}

#[test]
fn a_group_of_another_shape_is_refused_with_what_would_do() {
    let own = layers("encoder = [{ kind = 'conv1d', group = 'up', layers = [{ channels = 4, kernel = 3 }] }]");
    let told = own.encoder[0].network(&[9], &own).unwrap_err().to_string();
    assert!(told.starts_with("shape of the group 'up' is [9], but it must be [steps, n]"), "{told}");
    assert_eq!(own.encoder[0].network(&[9, 2], &own).unwrap().n_output(), 7 * 4);
}

#[test]
fn plain_networks_refuse_what_stands_before_hidden_layers() {
    let own = layers("memory = { kind = 'gru', units = 8 }");
    let told = Mlp::new(4, &own, 2, Activation::Tanh).unwrap_err().to_string();
    assert!(told.starts_with("network is with encoder or memory"), "{told}");
}

/// Three agents, two teams: as if each agent's rows went through a perceptron of its own, forwards and backwards.
#[test]
fn every_row_goes_through_its_own_agents_network_there_and_back() {
    let mlp = Arc::new(Mlp::new(5, &Layers { hidden: vec![7], ..Layers::default() }, 2, Activation::Tanh).unwrap());
    let (agents, rows) = (3, 6);
    let team = PerAgent::new(mlp.clone(), agents).unwrap();
    let mut stream = Stream::new(3, 0, 0, Purpose::LEARNING);
    let parameters = team.init(&mut stream);
    let mut drawn = |n: usize| (0..n).map(|_| stream.normal() as f32).collect::<Vec<_>>();
    let (x, up) = (drawn(rows * 5), drawn(rows * 2));
    let n = mlp.n_parameter();
    assert!(parameters[..n] != parameters[n..2 * n] && team.n_parameter() == 3 * n);

    let (mut memory, mut scratch, mut transposed) = (team.memory(rows), team.scratch(rows), Transposed::default());
    let mut given = vec![0.0; rows * 2];
    team.forward(&parameters, &x, rows, &mut memory).write(&mut given);
    team.transpose(&parameters, &mut transposed);
    let (mut gradient, mut grad_x) = (vec![0.0; team.n_parameter()], vec![0.0; rows * 5]);
    let pass = Pass { gradient: &mut gradient, grad_input: &mut grad_x, scratch: &mut scratch };
    let weights = Weights { parameters: &parameters, transposed: &transposed };
    team.backward(weights, &x, rows, &memory, &up, pass);

    let mut alone = vec![0.0; team.n_parameter()];
    for row in 0..rows {
        let own = row % agents * n..(row % agents + 1) * n;
        let (mut memory, mut scratch, mut transposed) = (mlp.memory(1), mlp.scratch(1), Transposed::default());
        let x = &x[row * 5..][..5];
        assert_eq!(mlp.forward(&parameters[own.clone()], x, 1, &mut memory).row(0), &given[row * 2..][..2]);
        mlp.transpose(&parameters[own.clone()], &mut transposed);
        let mut grad = vec![0.0; 5];
        let pass = Pass { gradient: &mut alone[own.clone()], grad_input: &mut grad, scratch: &mut scratch };
        let weights = Weights { parameters: &parameters[own], transposed: &transposed };
        Network::backward(&*mlp, weights, x, 1, &memory, &up[row * 2..][..2], pass);
        assert!(grad.iter().zip(&grad_x[row * 5..]).all(|(a, b)| (a - b).abs() < 1e-6), "row {row}");
    }
    let worst = alone.iter().zip(&gradient).fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(worst < 1e-5, "{worst}");
    let names: Vec<String> = team.parts(&parameters).into_iter().map(|part| part.name).collect();
    assert!(names[0] == "agent0.0.weight" && names.last().unwrap().starts_with("agent2."), "{names:?}");
}
