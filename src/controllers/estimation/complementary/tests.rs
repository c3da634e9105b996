//! The complementary filter against closed forms.

use super::*;
use num_dual::Dual64;

const DT: f64 = 0.002;
const GRAVITY: f64 = 9.81;

fn still() -> ComplementaryState<f64> {
    ComplementaryState {
        position: [0.0; 3],
        velocity: [0.0; 3],
        attitude: [1.0, 0.0, 0.0, 0.0],
        read_rate: [0.0; 3],
        gyroscope_bias: [0.0; 3],
    }
}

/// What an accelerometer at rest reads in an attitude.
fn at_rest(attitude: Quat<f64>) -> Vec3<f64> {
    rotate_back(attitude, [0.0, 0.0, GRAVITY])
}

/// The turn from one attitude to another, rad, axes of the first.
fn turn(from: Quat<f64>, to: Quat<f64>) -> Vec3<f64> {
    let off = multiply(conjugate(from), to);
    [1, 2, 3].map(|k| 2.0 * off[k] * off[0].signum())
}

#[test]
fn a_turn_at_a_constant_rate_is_that_of_its_closed_form_and_of_its_slope() {
    let rate = [0.7, -1.3, 2.1];
    let mut own = ComplementaryState { read_rate: rate, ..still() };
    (0..500).for_each(|_| own.predict([[0.0; 3], rate], [0.0; 2], [DT, GRAVITY]));
    let off = turn(exponential(rate), own.attitude);
    println!("{off:?}");
    assert!(off.iter().all(|x| x.abs() < 1e-12), "{off:?}");
    // half a second of free fall besides
    assert!((own.velocity[2] + GRAVITY).abs() < 1e-12 && (own.position[2] + 0.5 * GRAVITY).abs() < 1e-10);
    // over duals: the angle of a turn about z, by its rate
    let dual = |x: f64| Dual64::from(x);
    let rate = [dual(0.0), dual(0.0), Dual64::new(0.9, 1.0)];
    let mut own = ComplementaryState::<Dual64> {
        position: [dual(0.0); 3],
        velocity: [dual(0.0); 3],
        attitude: [1.0, 0.0, 0.0, 0.0].map(dual),
        read_rate: rate,
        gyroscope_bias: [dual(0.0); 3],
    };
    (0..500).for_each(|_| own.predict([[dual(0.0); 3], rate], [0.0; 2], [DT, GRAVITY]));
    let half: f64 = 0.45;
    assert!((own.attitude[3].re - half.sin()).abs() < 1e-12 && (own.attitude[3].eps - 0.5 * half.cos()).abs() < 1e-12);
}

#[test]
fn a_tilt_at_rest_fades_with_the_time_constant_of_its_gain() {
    for gain in [0.3, 2.0] {
        let truth = exponential([0.4, -0.2, 0.0]);
        let mut own = ComplementaryState { attitude: multiply(truth, exponential([1e-3, 0.0, 0.0])), ..still() };
        let before = turn(truth, own.attitude);
        // after one time constant
        let n = (1.0 / gain / DT).round() as i32;
        (0..n).for_each(|_| own.predict([at_rest(truth), [0.0; 3]], [gain, 0.0], [DT, GRAVITY]));
        // what turns about the vertical no accelerometer sees
        let up = at_rest(truth).map(|x| x / GRAVITY);
        let across = |v: Vec3<f64>| {
            let along: f64 = (0..3).map(|k| v[k] * up[k]).sum();
            (0..3).map(|k| (v[k] - along * up[k]).powi(2)).sum::<f64>().sqrt()
        };
        let left = across(turn(truth, own.attitude)) / across(before);
        let wanted = (-gain * f64::from(n) * DT).exp();
        println!("{gain} 1/s: {left:.8} of the tilt is left, exp(−k t) is {wanted:.8}");
        assert!((left - wanted).abs() < 1e-5 * wanted);
    }
}

#[test]
fn a_bias_of_the_gyroscope_is_found() {
    let bias = [0.02, -0.01, 0.015];
    let rate = [10.0, 0.05];
    let mut own = ComplementaryState { read_rate: bias, ..still() };
    // e' = −k e − b, b' = k k_b e: of the slow pole, what is left of a bias after 1/k_b
    let seconds = 1.0 / rate[1];
    for k in 0..(seconds / DT) as usize {
        own.predict([[0.0, 0.0, GRAVITY], bias], [0.0; 2], [DT, GRAVITY]);
        if k % 5 == 4 {
            let missing = rotate(own.attitude, turn(own.attitude, [1.0, 0.0, 0.0, 0.0]));
            own.correct(FixKind::Attitude, missing, [rate[0], rate[1], 5.0 * DT]);
        }
    }
    for axis in 0..3 {
        let left = 1.0 - own.gyroscope_bias[axis] / bias[axis];
        println!("axis {axis}: {left:.4} of the bias is left after 1/k_b, exp(−1) is {:.4}", (-1.0_f64).exp());
        assert!((left - (-1.0_f64).exp()).abs() < 0.01);
    }
}

#[test]
fn errors_of_a_place_have_both_poles_where_the_gain_says() {
    let (rate, every) = (6.0, 5);
    let between = f64::from(every) * DT;
    let r = (-rate * between).exp();
    let mut own = ComplementaryState { position: [1.0, 0.0, 0.0], ..still() };
    let mut worst: f64 = 0.0;
    for n in 0..200 {
        let wanted = (1.0 + (1.0 - 1.0 / r) * f64::from(n)) * r.powi(n);
        worst = worst.max((own.position[0] - wanted).abs());
        let missing = [-own.position[0], 0.0, 0.0];
        own.correct(FixKind::Position, missing, [rate, 0.0, between]);
        (0..every).for_each(|_| own.predict([[0.0, 0.0, GRAVITY], [0.0; 3]], [0.0; 2], [DT, GRAVITY]));
    }
    println!("place off by {worst:.1e} m of 1 m");
    assert!(worst < 1e-12);
}

#[test]
fn readings_tell_what_is_missing() {
    use super::super::aiding::{Aid, AidKind};
    use dynamics::sensors::Barometer;
    let truth = Frame {
        position: [0.3, -0.2, 1.7],
        velocity: [0.5, 0.1, -0.2],
        attitude: multiply(exponential([0.0, 0.0, 0.8]), exponential([0.2, -0.1, 0.0])),
        angular_velocity: [0.3, 0.6, -0.4],
    };
    let off = [0.001, -0.002, 0.0015];
    let estimate = Frame {
        position: sub(truth.position, off),
        velocity: sub(truth.velocity, off),
        attitude: multiply(exponential(scale(-1.0, off)), truth.attitude),
        ..truth
    };
    let mount = exponential([0.3, 0.0, -0.4]);
    let lever = [0.1, 0.05, -0.02];
    let (place, swift) = truth.point(lever);
    let field = [21.5, 4.0, -43.0];
    let barometer = Barometer { altitude: 300.0, ..Barometer::default() };
    let axis = rotate(multiply(truth.attitude, mount), [0.0, 0.0, 1.0])[2];
    for (kind, reading, wanted) in [
        (AidKind::Position, place.to_vec(), off),
        (AidKind::Velocity, swift.to_vec(), off),
        (AidKind::Attitude, multiply(truth.attitude, mount).to_vec(), off),
        // tilt that is off turns it a little: the field is steep
        (AidKind::Field(field), rotate_back(multiply(truth.attitude, mount), field).to_vec(), [off[2], 0.0, 0.0]),
        (AidKind::Pressure(barometer.clone()), vec![barometer.pressure_at(place[2])[0]], [off[2], 0.0, 0.0]),
        (
            AidKind::Distance { ground: 0.4, half_cone: 0.0, growth: None },
            vec![(place[2] - 0.4) / axis],
            [off[2], 0.0, 0.0],
        ),
    ] {
        let aid = Aid { kind: kind.clone(), lever, rotation: mount, variance: vec![1.0; 3], bias: None };
        let found = innovation(&aid, &estimate, &reading);
        // the lever and the tilt add what the attitude is off by: 2e-3 rad of 0.1 m, of 2 m and of a steep field
        let bound = match kind {
            AidKind::Attitude => 1e-6,
            AidKind::Field(_) => 6e-3,
            AidKind::Distance { .. } => 2e-3,
            _ => 5e-4,
        };
        println!("{kind:?}: {found:?} {wanted:?}");
        assert!((0..3).all(|k| (found[k] - wanted[k]).abs() < bound), "{kind:?}: {found:?} {wanted:?}");
    }
}

#[test]
fn gains_out_of_their_range_are_refused_by_name() {
    for (settings, name) in [
        (ComplementarySettings { attitude: -1.0, ..Default::default() }, "attitude"),
        (ComplementarySettings { height: f64::NAN, ..Default::default() }, "height"),
        (ComplementarySettings { gnss: 2e3, ..Default::default() }, "gnss"),
    ] {
        let error = settings.validate().unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
    assert!(ComplementarySettings { accelerometer: 0.0, ..Default::default() }.validate().is_ok());
}
