//! References: exact derivatives, golden values, files, refusals.

use omnidrones::controllers::reference::{
    Circle, Curve, Ellipse, Lemniscate, MAX_SAMPLES, MAX_WAYPOINTS, Reference, Sampled, Setpoint, Tilt, Waypoint,
    Waypoints, lemniscate_phase,
};
use omnidrones::dynamics::spatial::{Vec3, mat_mul, transpose};
use std::f64::consts::{PI, TAU};

#[test]
fn every_derivative_agrees_with_central_differences() {
    let h = 1e-4;
    for name in Reference::names() {
        let reference = Reference::by_name(name).unwrap();
        reference.validate().unwrap();
        assert_eq!(reference.name(), *name);
        let mut worst = 0.0_f64;
        for t in [0.3, 0.777, 1.5, 2.9, 5.21, 7.3] {
            let (a, b, c) = (reference.sample(t - h), reference.sample(t), reference.sample(t + h));
            let series = |s: &Setpoint<f64>| [s.position, s.velocity, s.acceleration, s.jerk, s.snap];
            let (a, exact, c) = (series(&a), series(&b), series(&c));
            for k in 0..4 {
                for i in 0..3 {
                    let difference = (c[k][i] - a[k][i]) / (2.0 * h);
                    worst = worst.max((difference - exact[k + 1][i]).abs() / (1.0 + difference.abs()));
                }
            }
        }
        println!("worst {name} {worst:.1e}");
        // measured: 1.5e-7 (lemniscate)
        assert!(worst < 1e-6, "{name}: {worst:e}");
    }
}

#[test]
fn before_its_start_every_shape_rests_at_its_start() {
    for name in Reference::names() {
        let reference = Reference::by_name(name).unwrap();
        let s = reference.sample(-0.5);
        assert_eq!(s.position, reference.sample(0.0).position);
        assert_eq!((s.velocity, s.acceleration, s.jerk, s.snap), ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]));
    }
}

#[test]
fn a_misspelt_name_is_answered_with_the_nearest() {
    let text = Reference::by_name("lemniscat").unwrap_err().to_string();
    assert!(text.starts_with("no reference is called 'lemniscat' (did you mean 'lemniscate'?)"), "{text}");
}

#[test]
fn references_survive_toml_and_unknown_keys_do_not() {
    for name in Reference::names() {
        let reference = Reference::by_name(name).unwrap();
        let text = toml::to_string(&reference).unwrap();
        assert_eq!(toml::from_str::<Reference>(&text).unwrap(), reference, "{text}");
    }
    let short: Reference = toml::from_str("kind = 'circle'\nradius = 3.0").unwrap();
    assert_eq!(short, Reference::Circle(Circle { radius: 3.0, ..Circle::default() }));
    assert!(toml::from_str::<Reference>("kind = 'circle'\nradios = 3.0").is_err());
}

#[test]
fn bad_numbers_are_named() {
    let bad = Reference::Circle(Circle { radius: f64::NAN, ..Circle::default() });
    assert!(bad.validate().unwrap_err().to_string().starts_with("circle.radius is NaN"));
    let bad = Reference::Lemniscate(Lemniscate { rate: 1e9, ..Lemniscate::default() });
    assert!(bad.validate().unwrap_err().to_string().starts_with("lemniscate.rate is 1000000000"));
}

#[test]
fn all_derivatives_up_to_snap_are_continuous_through_the_spin_up() {
    let circle = Reference::Circle(Circle::default());
    for t in [0.0, 2.0] {
        let (a, b) = (circle.sample(t - 1e-7), circle.sample(t + 1e-7));
        for i in 0..3 {
            println!("worst {t} {:.1e} {:.1e}", (a.snap[i] - b.snap[i]).abs(), (a.jerk[i] - b.jerk[i]).abs());
            // measured: 1.0e-5 and 3.4e-7, the slopes across 2e-7 s
            assert!((a.snap[i] - b.snap[i]).abs() < 1e-4, "t = {t}: {:?} {:?}", a.snap, b.snap);
            assert!((a.jerk[i] - b.jerk[i]).abs() < 1e-5);
        }
    }
}

#[test]
fn a_heading_along_the_path_follows_the_velocity() {
    for rate in [0.8, -1.3] {
        let circle = Reference::Circle(Circle { rate, along_path: true, ..Circle::default() });
        let s = circle.sample(3.7);
        let (sin, cos) = s.yaw.sin_cos();
        let speed = (s.velocity[0].powi(2) + s.velocity[1].powi(2)).sqrt();
        assert!((s.velocity[0] - speed * cos).abs() < 1e-12 && (s.velocity[1] - speed * sin).abs() < 1e-12);
        assert!((s.yaw_rate - rate).abs() < 1e-12 && s.yaw_acceleration.abs() < 1e-12);
    }
}

#[test]
fn a_circle_that_is_ahead_begins_at_its_full_speed_and_acceleration() {
    let circle = Reference::Circle(Circle { radius: 4.0, rate: 1.5, ahead: 2.0, ..Circle::default() });
    let size = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    for t in [0.0, 0.7] {
        let s = circle.sample(t);
        assert!((size(s.velocity) - 6.0).abs() < 1e-12 && (size(s.acceleration) - 9.0).abs() < 1e-12, "{s:?}");
    }
}

#[test]
fn at_full_rate_speed_and_acceleration_are_those_of_the_larger_half_axis() {
    for standing in [false, true] {
        let ellipse = Ellipse { half_axes: [3.0, 0.6], rate: 2.0, standing, yaw: 0.4, ..Ellipse::default() };
        let reference = Reference::Ellipse(ellipse);
        let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let at = |k: u32| reference.sample(2.0 + 1e-3 * f64::from(k));
        let speed = (0..4000).map(|k| norm(at(k).velocity)).fold(0.0, f64::max);
        let acceleration = (0..4000).map(|k| norm(at(k).acceleration)).fold(0.0, f64::max);
        println!("worst {:.1e} {:.1e}", (speed - 6.0).abs(), (acceleration - 12.0).abs());
        // measured: 2.3e-6 and 4.4e-6, the distance of a sample from the crest
        assert!((speed - 6.0).abs() < 1e-5 && (acceleration - 12.0).abs() < 1e-5);
        let along = [0.4_f64.cos(), 0.4_f64.sin()];
        let s = at(700).position;
        let ahead = s[0] * along[0] + s[1] * along[1];
        assert!(!standing || ahead.abs() < 1e-12, "it stands across the heading");
    }
}

#[test]
fn the_golden_values_of_the_paper_are_met() {
    let lemniscate = Lemniscate::default();
    let golden = [
        (0, 0.0, [0.0, 0.0, 2.36]),
        (5, 0.00592593, [-0.007407, -0.007407, 2.36]),
        (10, 0.02206897, [-0.027591, -0.027584, 2.36]),
        (15, 0.04645161, [-0.058106, -0.058044, 2.36]),
        (100, 0.98461538, [-1.594663, -0.882141, 2.304968]),
        (599, 8.67848224, [-1.102820, 0.809700, 1.656524]),
    ];
    for (step, phase, position) in golden {
        let t = 0.016 * f64::from(step);
        assert!((lemniscate_phase(1.0, t) - phase).abs() < 1e-8);
        let p = lemniscate.position(t);
        for i in 0..3 {
            // printed to six decimals, z of the first steps to two
            let tolerance = if i == 2 && step < 100 { 5e-3 } else { 6e-7 };
            println!("worst step {step} axis {i}: {:.1e}", (p[i] - position[i]).abs());
            assert!((p[i] - position[i]).abs() < tolerance, "step {step}: {p:?}");
        }
    }
}

#[test]
fn a_rotated_lemniscate_is_the_same_curve_turned() {
    let plain = Lemniscate { scale: [3.0, 1.0, 1.2], origin: [0.0; 3], ..Lemniscate::default() };
    let turned = Lemniscate { rotation: 0.7, ..plain };
    let (p, q) = (plain.position(1.9), turned.position(1.9));
    let (s, c) = 0.7_f64.sin_cos();
    assert!((q[0] - (c * p[0] - s * p[1])).abs() < 1e-15 && (q[1] - (s * p[0] + c * p[1])).abs() < 1e-15);
}

#[test]
fn velocity_is_continuous_at_the_start_and_acceleration_jumps_to_a_known_value() {
    for rate in [1.3, -1.3] {
        let reference = Reference::Lemniscate(Lemniscate { rate, ..Lemniscate::default() });
        let start = reference.sample(0.0);
        assert_eq!(start.velocity, [0.0; 3]);
        // dL/dθ at π/2 is (−½, −½, 0), so a = 2w² S ∘ (−½, −½, 0) · sign(w).
        let expected = -1.3 * 1.3 * 2.5 * rate.signum();
        for i in 0..2 {
            assert!((start.acceleration[i] - expected).abs() < 1e-12, "{:?}", start.acceleration);
        }
        let soon = reference.sample(1e-6);
        println!("worst {:.1e}", (soon.acceleration[0] - start.acceleration[0]).abs());
        // measured: 1.6e-5
        assert!((soon.acceleration[0] - start.acceleration[0]).abs() < 1e-4);
    }
}

/// (RᵀṘ)^∨ by central differences.
fn turning(tilt: &Tilt, reference: &Reference, t: f64, h: f64) -> Vec3<f64> {
    let [a, r, b] = [t - h, t, t + h].map(|t| tilt.orientation(reference, t).attitude);
    let (back, ahead) = (mat_mul(transpose(r), a), mat_mul(transpose(r), b));
    [(2, 1), (0, 2), (1, 0)].map(|(i, j)| (ahead[i][j] - back[i][j]) / (2.0 * h))
}

#[test]
fn rates_and_accelerations_of_a_ramp_agree_with_central_differences() {
    let tilt = Tilt { roll: 1.1, pitch: -0.7, at: 0.4, ramp: 1.5 };
    let reference = Reference::Circle(Circle { along_path: true, ..Circle::default() });
    let h = 1e-4;
    let (mut worst, mut fastest) = (0.0_f64, 0.0_f64);
    for t in [0.2, 0.7, 1.1, 1.6, 1.85, 2.5] {
        let exact = tilt.orientation(&reference, t);
        let rates = turning(&tilt, &reference, t, h);
        let [a, b] = [t - h, t + h].map(|t| tilt.orientation(&reference, t).angular_velocity);
        for i in 0..3 {
            fastest = fastest.max(exact.angular_velocity[i].abs());
            worst = worst.max((rates[i] - exact.angular_velocity[i]).abs());
            worst = worst.max(((b[i] - a[i]) / (2.0 * h) - exact.angular_acceleration[i]).abs());
        }
    }
    println!("worst {worst:.1e}, fastest {fastest:.2}");
    // measured: 1.4e-7, the differences' own error, at rates up to 1.55 rad/s
    assert!(worst < 1e-6 && fastest > 1.0, "{worst:e}");
}

#[test]
fn a_step_is_level_before_and_still_after() {
    let (tilt, hover) = (Tilt { roll: 0.5, ..Tilt::default() }, Reference::Hover(Default::default()));
    let (before, after) = (tilt.orientation(&hover, 0.999), tilt.orientation(&hover, 1.0));
    assert_eq!(before.attitude, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert!((after.attitude[2][1] - 0.5_f64.sin()).abs() < 1e-15);
    assert_eq!((after.angular_velocity, after.angular_acceleration), ([0.0; 3], [0.0; 3]));
}

#[test]
fn bad_tilts_are_named() {
    let text = Tilt { pitch: 1.7, ..Tilt::default() }.validate().unwrap_err().to_string();
    assert!(text.starts_with("tilt.pitch is 1.7"), "{text}");
    assert!(Tilt { ramp: -1.0, ..Tilt::default() }.validate().is_err());
}

fn uneven() -> Waypoints {
    let rows = [
        (0.5, [0.0, 0.0, 1.0], 0.0),
        (1.1, [1.0, 0.5, 2.0], 0.4),
        (3.6, [-1.0, 2.0, 1.5], 3.0),
        (4.0, [-1.2, 2.1, 1.4], 3.1),
    ];
    Waypoints::new(rows.map(|(time, position, yaw)| Waypoint { time, position, yaw }).into()).unwrap()
}

#[test]
fn the_path_passes_every_point_with_continuous_snap_and_rests_at_both_ends() {
    let path = uneven();
    let reference = Reference::Waypoints(path.clone());
    for (i, point) in path.points().iter().enumerate() {
        let (a, b) = (reference.sample(point.time - 1e-9), reference.sample(point.time));
        for axis in 0..3 {
            println!("worst position {:.1e}", (b.position[axis] - point.position[axis]).abs());
            // measured: 4e-16
            assert!((b.position[axis] - point.position[axis]).abs() < 1e-12);
            if i > 0 && i < 3 {
                println!("worst snap {:.1e} of {:.1e}", (a.snap[axis] - b.snap[axis]).abs(), a.snap[axis]);
                // measured: 5.3e-7 of up to 120, across 1 ns
                assert!((a.snap[axis] - b.snap[axis]).abs() < 1e-4, "point {i}: {:?} {:?}", a.snap, b.snap);
            } else {
                let rest = b.velocity[axis].abs().max(b.acceleration[axis].abs()).max(b.jerk[axis].abs());
                println!("worst rest {rest:.1e}");
                // measured: 2.5e-14
                assert!(rest < 1e-8, "point {i}: {rest:e}");
            }
        }
        assert!((b.yaw - point.yaw).abs() < 1e-12);
    }
    assert_eq!(reference.duration(), Some(4.0));
    assert_eq!(reference.sample(9.0).velocity, [0.0; 3]);
}

/// (largest change of yaw over the path, yaw at its end less that at its start), rad.
fn turned(yaws: &[f64], turns: bool) -> [f64; 2] {
    let point =
        |(i, yaw): (usize, &f64)| format!("{{ time = {:?}, position = [{i}, 0, 1], yaw = {yaw:?} }}", 1.5 * i as f64);
    let points: Vec<String> = yaws.iter().enumerate().map(point).collect();
    let text = format!("kind = 'waypoints'\nturns = {turns}\npoints = [{}]", points.join(", "));
    let path: Reference = toml::from_str(&text).unwrap();
    let at = |k: usize| path.sample(path.duration().unwrap() * k as f64 / 600.0).yaw;
    let range = (0..=600).map(at).fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], yaw| [a.min(yaw), b.max(yaw)]);
    [range[1] - range[0], at(600) - at(0)]
}

#[test]
fn yaw_turns_the_short_way_wherever_it_begins_and_mirrored() {
    for begin in [0.0, 0.3, -2.0, PI] {
        for side in [1.0, -1.0] {
            for full in [-9.0, -1.0, 0.0, 1.0, 5.0] {
                for (change, short) in
                    [(0.2, 0.2), (6.2, 6.2 - TAU), (3.5, 3.5 - TAU), (TAU, 0.0), (PI, PI), (1e-8, 1e-8)]
                {
                    let to = begin + side * change + full * TAU;
                    let [_, end] = turned(&[begin, to], false);
                    // a half turn from elsewhere is on either side of rounding, and either way is as short
                    let apart = if change == PI { end.abs() - PI } else { end - side * short };
                    // measured: 5e-14
                    assert!(apart.abs() < 1e-12, "{begin} {side} {full} {change}: {end}");
                }
            }
        }
    }
    // as it was reported: 3.1 to -3.1 took 355°
    let [range, end] = turned(&[3.0, 3.1, -3.1, -3.0], false);
    println!("range {range:.3}, end {end:.3}");
    // measured: 0.283 of 0.2832 rad
    assert!(range < 0.3 && (end - (TAU - 6.0)).abs() < 1e-12, "{range} {end}");
    let half = [turned(&[0.0, PI], false)[1], turned(&[0.0, -PI], false)[1]];
    assert!((half[0] - PI).abs() < 1e-12 && (half[1] + PI).abs() < 1e-12, "{half:?}");
}

#[test]
fn turns_that_are_asked_for_are_taken_and_survive_a_file() {
    for [given, end] in [[TAU, TAU], [-3.0 * TAU, -3.0 * TAU], [6.2, 6.2]] {
        assert!((turned(&[0.0, given], true)[1] - end).abs() < 1e-12, "{given}");
    }
    let text = "kind = 'waypoints'\nturns = true\npoints = [{ time = 0, position = [0, 0, 1] }, \
                { time = 4, position = [0, 0, 1], yaw = 6.283185307179586 }]";
    let path: Reference = toml::from_str(text).unwrap();
    assert!((path.sample(4.0).yaw - TAU).abs() < 1e-12);
    assert_eq!(toml::from_str::<Reference>(&toml::to_string(&path).unwrap()).unwrap(), path);
    let short: Reference = toml::from_str(&text.replace("turns = true", "")).unwrap();
    assert!(short.sample(4.0).yaw.abs() < 1e-12);
}

#[test]
fn the_largest_path_is_solved() {
    let points = (0..MAX_WAYPOINTS)
        .map(|i| {
            let x = i as f64;
            Waypoint { time: x + 0.3 * (x * 1.7).sin(), position: [x.sin(), x.cos(), 0.1 * x], yaw: 0.0 }
        })
        .map(|p| Waypoint { time: p.time + 1.0, ..p })
        .collect();
    let path = Waypoints::new(points).unwrap();
    for point in path.points() {
        let p = Reference::Waypoints(path.clone()).sample(point.time).position;
        for axis in 0..3 {
            println!("worst {:.1e}", (p[axis] - point.position[axis]).abs());
            // measured: 9e-16
            assert!((p[axis] - point.position[axis]).abs() < 1e-10);
        }
    }
}

#[test]
fn paths_that_cannot_be_flown_are_refused_with_a_reason() {
    let at = |time: f64| Waypoint { time, position: [time, 0.0, 1.0], yaw: 0.0 };
    let text = |points: Vec<Waypoint>| Waypoints::new(points).unwrap_err().to_string();
    assert!(text(vec![at(0.0)]).starts_with("number of waypoints is 1, below the limit of 2 to 64"));
    assert!(text(vec![at(0.0), at(1.0), at(1.0)]).starts_with("waypoint 2: time is 1, but it must be at least"));
    assert!(text(vec![at(0.0), at(f64::NAN)]).starts_with("waypoint 1: time is NaN"));
    assert!(text(vec![at(0.0), at(1.0), at(500.0)]).contains("within a factor of 100"));
    let nan = Waypoint { position: [0.0, f64::INFINITY, 0.0], ..at(2.0) };
    assert!(text(vec![at(0.0), nan]).starts_with("waypoint 1: position[1] is inf"));
}

/// A knot of sines, sampled every `step` s over 2 s from 0.3 s on.
fn knot(step: f64) -> Sampled {
    let point = |t: f64| Waypoint {
        time: t,
        position: [t.sin(), (1.5 * t).cos(), 2.0 + 0.3 * (2.0 * t).sin()],
        yaw: 0.5 * t.sin(),
    };
    let velocity = |t: f64| [t.cos(), -1.5 * (1.5 * t).sin(), 0.6 * (2.0 * t).cos()];
    let n = (2.0 / step).round() as usize;
    let points = (0..=n).map(|k| point(0.3 + k as f64 * step)).collect();
    Sampled::with_velocities(points, [velocity(0.3), velocity(2.3)]).unwrap()
}

#[test]
fn a_sampled_curve_passes_its_points_with_all_derivatives_up_to_snap_on_both_sides() {
    for step in [0.1, 2.0, 1.0] {
        let curve = knot(step);
        let reference = Reference::Sampled(curve.clone());
        let points = curve.points();
        let close = |a: f64, b: f64, bound: f64| assert!((a - b).abs() < bound, "{step}: {a} {b}");
        for (k, own) in points.iter().enumerate() {
            let is_end = k + 1 == points.len();
            let at = reference.sample(if is_end { own.time - 1e-12 } else { own.time });
            (0..3).for_each(|i| close(at.position[i], own.position[i], 1e-11));
            close(at.yaw, own.yaw, 1e-11);
            if k == 0 || is_end {
                let t: f64 = own.time;
                close(at.velocity[1], -1.5 * (1.5 * t).sin(), 1e-10);
                close(at.yaw_rate, 0.0, 1e-10);
                (0..3).for_each(|i| close(at.jerk[i], 0.0, 1e-7));
                continue;
            }
            let before = reference.sample(own.time - 1e-9);
            for i in 0..3 {
                // measured: 6e-7, the slopes across 1 ns and rounding
                close(before.acceleration[i], at.acceleration[i], 1e-6);
                close(before.jerk[i], at.jerk[i], 1e-5);
                close(before.snap[i], at.snap[i], 1e-4);
            }
        }
        assert_eq!(reference.duration(), Some(points[points.len() - 1].time));
    }
}

#[test]
fn a_sampled_curve_has_exact_derivatives_and_rests_before_and_behind_its_points() {
    let reference = Reference::Sampled(knot(0.1));
    let h = 1e-5;
    for t in [0.345, 0.72, 1.555, 2.26] {
        let [a, b, c] = [t - h, t, t + h].map(|t| reference.sample(t));
        let series = |s: &Setpoint<f64>| [s.position, s.velocity, s.acceleration, s.jerk, s.snap];
        for k in 0..4 {
            for i in 0..3 {
                let difference = (series(&c)[k][i] - series(&a)[k][i]) / (2.0 * h);
                let exact = series(&b)[k + 1][i];
                assert!((difference - exact).abs() < 1e-6 * (1.0 + exact.abs()), "{t} {k} {i}: {difference} {exact}");
            }
        }
        assert!(((c.yaw_rate - a.yaw_rate) / (2.0 * h) - b.yaw_acceleration).abs() < 1e-6);
    }
    for (t, end) in [(-1.0, 0.3), (0.29, 0.3), (2.31, 2.3), (1e9, 2.3), (-1e300, 0.3)] {
        let (s, wanted) = (reference.sample(t), [f64::sin(end), f64::cos(1.5 * end), 2.0 + 0.3 * f64::sin(2.0 * end)]);
        assert!((0..3).all(|i| (s.position[i] - wanted[i]).abs() < 1e-12), "{t}");
        assert_eq!(
            (s.velocity, s.acceleration, s.jerk, s.snap, s.yaw_rate),
            ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], 0.0)
        );
    }
}

#[test]
fn a_sampled_curve_comes_nearer_to_what_was_sampled_with_the_sixth_power_of_the_step() {
    let error = |step: f64| {
        let reference = Reference::Sampled(knot(step));
        // away from the ends, where the jerk is made zero
        let times = (0..400).map(|k| 0.9 + 0.002 * f64::from(k));
        times.map(|t| (reference.sample(t).position[1] - (1.5 * t).cos()).abs()).fold(0.0, f64::max)
    };
    let [coarse, fine] = [0.1, 0.05].map(error);
    println!("{coarse:.1e} {fine:.1e}, factor {}", coarse / fine);
    assert!(coarse < 1e-7 && coarse / fine > 32.0, "{coarse} {fine}");
}

#[test]
fn no_curve_through_the_same_points_has_less_jerk_than_a_sampled_one() {
    let reference = Reference::Sampled(knot(0.5));
    let times: Vec<f64> = (0..2000).map(|k| 0.3005 + 0.001 * f64::from(k)).collect();
    // a bump that is zero at all points, and at rest at the ends
    let jerk_of_bump = |t: f64| {
        let h = 1e-3;
        let bump = |t: f64| (TAU * (t - 0.3)).sin().powi(2) * (t - 0.3) * (2.3 - t);
        (bump(t + 2.0 * h) - 2.0 * bump(t + h) + 2.0 * bump(t - h) - bump(t - 2.0 * h)) / (2.0 * h.powi(3))
    };
    let cost = |share: f64| -> f64 {
        times.iter().map(|t| 1e-3 * (reference.sample(*t).jerk[0] + share * jerk_of_bump(*t)).powi(2)).sum()
    };
    let [less, own, more] = [-1e-3, 0.0, 1e-3].map(cost);
    // the first variation vanishes: what is left is the square of the bump's jerk
    println!("{} of {own}, beside {}", 0.5 * (more - less), 0.5 * (more + less) - own);
    assert!(own < less && own < more, "{less} {own} {more}");
}

#[test]
fn points_that_make_no_sampled_curve_are_named_and_files_of_them_read_back() {
    let good = knot(0.5).points().to_vec();
    let text = |change: &dyn Fn(&mut Vec<Waypoint>)| {
        let mut points = good.clone();
        change(&mut points);
        Sampled::new(points).unwrap_err().to_string()
    };
    for (told, words) in [
        (text(&|p| p.truncate(1)), "is 1, below the limit of 2 to 4000"),
        (text(&|p| p.clear()), "is 0, below the limit of 2 to 4000"),
        (text(&|p| p[1].time = 0.3), "waypoint 1: time is 0.3"),
        (text(&|p| p[0].time = -1.0), "waypoint 0: time"),
        (text(&|p| p[2].position[1] = f64::NAN), "waypoint 2: position"),
        (text(&|p| p[3].yaw = f64::INFINITY), "waypoint 3: yaw"),
    ] {
        assert!(told.contains(words), "{told}");
    }
    let fast = Sampled::with_velocities(good.clone(), [[0.0; 3], [0.0, f64::NAN, 0.0]]).unwrap_err();
    assert!(fast.to_string().contains("end_velocity"), "{fast}");
    let many = (0..=MAX_SAMPLES).map(|k| Waypoint { time: k as f64, ..good[0] }).collect();
    assert!(Sampled::new(many).unwrap_err().to_string().contains("2 to 4000"));
    let reference = Reference::Sampled(knot(0.5));
    let written = toml::to_string(&reference).unwrap();
    assert_eq!(toml::from_str::<Reference>(&written).unwrap(), reference, "{written}");
    let short = "kind = 'sampled'\n[[points]]\ntime = 0.0\nposition = [0, 0, 1]\n";
    let again = "[[points]]\ntime = 2.0\nposition = [1, 0, 1]\n";
    let read: Reference = toml::from_str(&format!("{short}{again}")).unwrap();
    assert!((read.sample(1.0).position[0] - 0.5).abs() < 1e-12 && read.sample(0.0).velocity == [0.0; 3]);
    for bad in [short.to_string(), format!("{short}{again}yawn = 1.0"), format!("{short}{again}yaw = nan")] {
        assert!(toml::from_str::<Reference>(&bad).is_err(), "{bad}");
    }
}
