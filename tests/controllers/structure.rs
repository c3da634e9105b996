//! What inputs do not move and outputs do not show: the same in all coordinates and units, by the names of states.

use nalgebra::DMatrix;
use omnidrones::controllers::cascade::Rates;
use omnidrones::controllers::design::{AnalysisPoint, ErrorState, LoopModel, Stability, TrimTarget, bryson, lqr, trim};
use omnidrones::controllers::linear::{Signal, StateSpace, unobservable, unreachable};
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::{ClosedLoop, HoverFeedback, HoverWeights, Target};
use omnidrones::dynamics::{Disturbance, Physics, Plant, Rotor, Vehicle, vehicles};
use omnidrones::error::Result;
use omnidrones::rng::{Purpose, Stream};

type Matrix = DMatrix<f64>;

fn stream(episode: u64) -> Stream {
    Stream::new(11, 0, episode, Purpose::RESET)
}

fn random(rows: usize, columns: usize, stream: &mut Stream) -> Matrix {
    Matrix::from_fn(rows, columns, |_, _| stream.uniform(-1.0, 1.0))
}

/// A system with `reached` directions that inputs reach and others that they do not: on their own, or with integrators in a row.
struct Known {
    a: Matrix,
    b: Matrix,
    reached: usize,
}

impl Known {
    fn new(kind: u64, reached: usize, left: usize, stream: &mut Stream) -> Self {
        let (n, m) = (reached + left, 2);
        let mut a = random(n, n, stream) * (0.8 / (n as f64).sqrt());
        a.view_mut((reached, 0), (left, reached)).fill(0.0);
        let mut b = random(n, m, stream);
        b.rows_mut(reached, left).fill(0.0);
        let mut own = a.view_mut((reached, reached), (left, left));
        match kind {
            // one eigenvalue several times
            0 => own.copy_from(&(Matrix::identity(left, left) * 0.9)),
            // integrators in a row
            1 => own.copy_from(&Matrix::from_fn(left, left, |i, j| match j.wrapping_sub(i) {
                0 => 1.0,
                1 => 0.1,
                _ => 0.0,
            })),
            _ => (),
        }
        if kind == 2 {
            // the reached part in a row too, from the first input alone
            let mut own = a.view_mut((0, 0), (reached, reached));
            own.copy_from(&Matrix::from_fn(reached, reached, |i, j| match i.wrapping_sub(j) {
                0 => 1.0,
                1 => 0.1,
                _ => 0.0,
            }));
            b.view_mut((1, 0), (reached - 1, m)).fill(0.0);
        }
        Self { a, b, reached }
    }

    /// Turned at random, and with units of powers of ten up to 10^`most` either way.
    fn seen_otherwise(&self, most: f64, stream: &mut Stream) -> (Matrix, Matrix) {
        let n = self.a.nrows();
        let turn = random(n, n, stream).qr().q();
        let mut unit = || 10_f64.powf(stream.uniform(-most, most).round());
        let (states, inputs): (Vec<f64>, Vec<f64>) =
            ((0..n).map(|_| unit()).collect(), (0..self.b.ncols()).map(|_| unit()).collect());
        let (a, b) = (&turn * &self.a * turn.transpose(), &turn * &self.b);
        let a = Matrix::from_fn(n, n, |i, j| a[(i, j)] * states[j] / states[i]);
        (a, Matrix::from_fn(n, inputs.len(), |i, j| b[(i, j)] * inputs[j] / states[i]))
    }
}

#[test]
fn what_inputs_reach_has_as_many_directions_in_all_coordinates_and_units() {
    for episode in 0..120 {
        let mut stream = stream(episode);
        let (reached, left) = (2 + episode as usize % 5, episode as usize % 4);
        let known = Known::new(episode % 4, reached, left, &mut stream);
        let (a, b) = known.seen_otherwise(6.0, &mut stream);
        let n = a.nrows();
        let system = |a: &Matrix, b: &Matrix, c: &Matrix| {
            let d = Matrix::zeros(c.nrows(), b.ncols());
            StateSpace::new(a.clone(), b.clone(), c.clone(), d, Some(0.01)).unwrap()
        };
        let found = unreachable(&system(&a, &b, &Matrix::identity(n, n))).unwrap();
        let counts = (found.reached, found.directions.len(), found.poles.len());
        assert_eq!(counts, (known.reached, left, left), "kind {}, {reached} + {left}", episode % 4);
        // the same of outputs: the transposed system
        let shown = unobservable(&system(&a.transpose(), &Matrix::identity(n, n), &b.transpose())).unwrap();
        assert_eq!((shown.reached, shown.directions.len()), (known.reached, left), "outputs, kind {}", episode % 4);
        // a combination that is out of reach moves on its own: w B = 0 and w A of the span of all of them
        for direction in &found.directions {
            let mut w = Matrix::zeros(1, n);
            direction.iter().for_each(|(i, factor)| w[*i] = *factor);
            let moved = &w * &b;
            let reach = moved.iter().zip(b.column_iter()).map(|(x, column)| {
                let size = column.iter().zip(w.iter()).map(|(b, w)| (b * w).abs()).sum::<f64>();
                x.abs() / size.max(f64::MIN_POSITIVE)
            });
            let most = reach.fold(0.0, f64::max);
            // measured 1.7e-15
            assert!(most < 1e-12, "kind {}: {most:e}", episode % 4);
        }
    }
}

#[test]
fn what_does_not_decay_and_no_input_moves_is_refused_in_all_coordinates_and_units() {
    let (mut refused, mut found) = (0, 0);
    for episode in 0..60 {
        let mut stream = stream(1000 + episode);
        let (reached, left) = (3 + episode as usize % 3, 1 + episode as usize % 3);
        // kind 1 does not decay, kind 0 does
        let known = Known::new(episode % 2, reached, left, &mut stream);
        let (a, b) = known.seen_otherwise(3.0, &mut stream);
        let (q, r) = (Matrix::identity(a.nrows(), a.nrows()), Matrix::identity(2, 2));
        match lqr(&a, &b, &q, &r) {
            Ok(regulator) => {
                assert!(episode % 2 == 0 && regulator.poles[0].norm() < 1.0, "{episode}");
                found += 1;
            }
            Err(error) => {
                let text = error.to_string();
                assert!(episode % 2 == 1 && text.contains("reached by an input"), "{episode}: {text}");
                assert!(text.contains(&format!("{left} of {} directions", a.nrows())), "{text}");
                refused += 1;
            }
        }
    }
    assert_eq!((refused, found), (30, 30));
}

#[test]
fn a_direction_is_told_by_the_names_of_few_states() {
    // two integrators under one input in opposite senses: their sum stays
    let (a, b) = (Matrix::identity(3, 3), Matrix::from_column_slice(3, 1, &[2.0, -1.0, 0.0]));
    let system = StateSpace::new(a, b, Matrix::identity(3, 3), Matrix::zeros(3, 1), Some(0.1)).unwrap();
    let names = ["roll", "pitch", "yaw"].map(|name| Signal::new(name, "rad")).to_vec();
    let found = unreachable(&system).unwrap();
    assert_eq!(found.reached, 1);
    assert_eq!(found.names(&names), ["pitch + 0.5 roll", "yaw"]);
    assert_eq!(found.poles.len(), 2);
}

/// A quadrotor with rotors at the corners, first front right, and their senses.
fn quadrotor(spins: [f64; 4], mass: f64, inertia: [f64; 3]) -> Vehicle {
    let mut vehicle = vehicles::by_name("hummingbird").unwrap();
    let places = [[0.15, -0.15], [-0.15, 0.15], [0.15, 0.15], [-0.15, -0.15]];
    let like = Rotor {
        axis: [0.0, 0.0, 1.0],
        inertia: 0.0,
        drag_coefficient: 0.0,
        axial_drag_coefficient: 0.0,
        rolling_coefficient: 0.0,
        ..vehicle.rotors[0].clone()
    };
    vehicle.rotors = (0..4)
        .map(|k| Rotor {
            name: format!("m{k}"),
            position: [places[k][0], places[k][1], 0.0],
            spin: spins[k],
            ..like.clone()
        })
        .collect();
    vehicle.parts.truncate(1);
    vehicle.parts[0].mass = mass;
    vehicle.parts[0].position = [0.0; 3];
    let i = &mut vehicle.parts[0].inertia;
    (i.xx, i.yy, i.zz, i.xy, i.xz, i.yz) = (inertia[0], inertia[1], inertia[2], 0.0, 0.0, 0.0);
    vehicle.published_gains = None;
    vehicle
}

fn feedbacks(vehicle: &Vehicle) -> [Result<HoverFeedback>; 2] {
    let plant = Plant::of_vehicle(vehicle, Physics::default()).unwrap();
    let (rates, weights) = (Rates::default(), HoverWeights::default());
    [HoverFeedback::lqr(&plant, &rates, &weights), HoverFeedback::lqi(&plant, &rates, &weights)]
}

fn linear(vehicle: &Vehicle) -> StateSpace {
    let plant = Plant::of_vehicle(vehicle, Physics::default()).unwrap();
    let hover = trim(&plant, &TrimTarget::hover()).unwrap();
    ErrorState::of_plant(&plant).unwrap().state_space(&plant, &hover.state, &hover.input, 0.0).unwrap()
}

#[test]
fn axes_that_commands_do_not_turn_apart_are_named_by_lqr_and_lqi_alike() {
    let pairs =
        [([1.0, 1.0, -1.0, -1.0], None), ([1.0, -1.0, -1.0, 1.0], Some("_x")), ([1.0, -1.0, 1.0, -1.0], Some("_y"))];
    for (spins, with_yaw) in pairs {
        for (mass, inertia) in
            [(1.0, [0.008, 0.008, 0.014]), (1.3, [0.0081, 0.0093, 0.0141]), (0.03, [2e-5, 2e-5, 3e-5])]
        {
            for way in [1.0, -1.0] {
                let vehicle = quadrotor(spins.map(|s| way * s), mass, inertia);
                let reach = unreachable(&linear(&vehicle)).unwrap();
                let Some(axis) = with_yaw else {
                    assert_eq!((reach.reached, reach.directions.len()), (16, 0));
                    assert!(feedbacks(&vehicle).iter().all(Result::is_ok));
                    continue;
                };
                assert_eq!((reach.reached, reach.directions.len()), (14, 2), "{spins:?} {mass}");
                for found in feedbacks(&vehicle) {
                    let text = found.expect_err("not reached").to_string();
                    // of the vehicle, before anything is computed
                    let axes = if axis == "_x" { "roll and yaw only together" } else { "pitch and yaw only together" };
                    assert!(text.contains(axes), "{spins:?} {mass}: {text}");
                }
            }
        }
    }
}

/// The same vehicle, by a map of vectors that keeps lengths and changes the sense of turning by `sense`.
fn moved(vehicle: &Vehicle, map: [[f64; 3]; 3], sense: f64) -> Vehicle {
    let vector = |v: [f64; 3]| [0, 1, 2].map(|i| (0..3).map(|j| map[i][j] * v[j]).sum());
    let mut other = vehicle.clone();
    for part in &mut other.parts {
        part.position = vector(part.position);
        let i = part.inertia;
        let old = [[i.xx, i.xy, i.xz], [i.xy, i.yy, i.yz], [i.xz, i.yz, i.zz]];
        let half: [[f64; 3]; 3] = old.map(vector);
        let new = [0, 1, 2].map(|k| vector([half[0][k], half[1][k], half[2][k]]));
        let j = &mut part.inertia;
        (j.xx, j.yy, j.zz, j.xy, j.xz, j.yz) = (new[0][0], new[1][1], new[2][2], new[0][1], new[0][2], new[1][2]);
    }
    for rotor in &mut other.rotors {
        (rotor.position, rotor.axis, rotor.spin) = (vector(rotor.position), vector(rotor.axis), sense * rotor.spin);
    }
    other.published_gains = None;
    other
}

#[test]
fn a_vehicle_that_is_turned_or_mirrored_is_reached_and_held_as_before() {
    let turned = |angle: f64| {
        let (s, c) = angle.to_radians().sin_cos();
        [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    };
    let mirrored = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    for name in vehicles::names() {
        let vehicle = vehicles::by_name(name).unwrap();
        let all = unreachable(&linear(&vehicle)).unwrap();
        assert_eq!(all.directions.len(), 12 + vehicle.n_rotor() - all.reached, "{name}");
        for (map, sense) in [(turned(90.0), 1.0), (turned(45.0), 1.0), (turned(1e-7), 1.0), (mirrored, -1.0)] {
            let other = moved(&vehicle, map, sense);
            assert_eq!(unreachable(&linear(&other)).unwrap().reached, all.reached, "{name} {map:?}");
            assert!(feedbacks(&other).iter().all(Result::is_ok), "{name} {map:?}");
        }
    }
}

fn hovering(vehicle: &Vehicle, gains: &omnidrones::dynamics::Gains) -> LoopModel {
    let physics = Physics::default();
    let state = trim(&Plant::of_vehicle(vehicle, physics).unwrap(), &TrimTarget::hover()).unwrap().state;
    let closed = ClosedLoop::of_vehicle(vehicle, physics, gains, &Rates::default()).unwrap();
    let there = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    LoopModel::new(closed, Target::level(&there), &Disturbance::none(), &state).unwrap()
}

#[test]
fn a_loop_whose_gains_all_but_leave_out_a_direction_is_marginal_and_named_so() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let gains = vehicle.gains();
    let stability = |gains| hovering(&vehicle, gains).stability().unwrap();
    assert_eq!(stability(&gains), Stability::Stable);
    for tiny in [1e-300, 1e-160, 1e-30, 1e-13] {
        let mut weak = gains;
        weak.position[2] = tiny;
        let model = hovering(&vehicle, &weak);
        assert_eq!(model.stability().unwrap(), Stability::Marginal(vec!["position_z".into()]), "{tiny:e}");
        let margins = model.margins(AnalysisPoint::Command(0)).unwrap();
        assert!(!margins.stable && margins.disk.alpha == 0.0, "{tiny:e}: {margins:?}");
        assert_eq!(model.disk_margin(AnalysisPoint::Commands, 0.0).unwrap().alpha, 0.0);
    }
}

#[test]
fn what_q_does_not_see_is_named_too() {
    let (a, b) = (Matrix::from_row_slice(2, 2, &[1.0, 0.1, 0.0, 1.0]), Matrix::from_column_slice(2, 1, &[0.0, 0.1]));
    let q = bryson(&[f64::INFINITY, 1.0]).unwrap();
    let text = lqr(&a, &b, &q, &Matrix::identity(1, 1)).expect_err("unseen").to_string();
    assert!(text.contains("x0") && text.contains("seen by Q"), "{text}");
}

#[test]
fn no_loop_is_built_of_axes_that_commands_do_not_turn_apart() {
    let vehicle = quadrotor([1.0, -1.0, -1.0, 1.0], 1.0, [0.008, 0.008, 0.014]);
    let refused = ClosedLoop::of_vehicle(&vehicle, Physics::default(), &vehicle.gains(), &Rates::default());
    let Err(error) = refused else { panic!("it cannot be steered") };
    assert!(error.to_string().contains("roll and yaw only together"), "{error}");
}
