//! Distances, gradients, passages and errors of scenes.

use super::*;
use crate::contact::distance::point_capsule;
use crate::spatial::{from_euler, rotate};
use autodiff::{Program, Recording, Trace};
use num_dual::Dual64;
use rng::{Purpose, Stream};

fn scene() -> Scene {
    let turned = from_euler(0.0, 0.0, 0.7);
    Scene {
        ground: Some(0.0),
        gates: vec![
            Gate { name: "first".into(), position: [2.0, 0.0, 2.0], ..Gate::default() },
            Gate {
                name: "second".into(),
                position: [5.0, 1.0, 2.0],
                rotation: turned,
                slide: Some(GateSlide::default()),
                ..Gate::default()
            },
        ],
        obstacles: vec![
            Obstacle {
                name: "pillar".into(),
                shape: Shape::new(Geometry::Capsule { radius: 0.2, length: 2.0 }).at([0.0, 2.0, 1.5]),
            },
            Obstacle {
                name: "crate".into(),
                shape: Shape::new(Geometry::Box { size: [0.5, 0.8, 0.6] }).at([-1.0, -1.0, 0.8]).turned(turned),
            },
        ],
        ..Scene::default()
    }
}

fn random(r: &mut Stream) -> Vec3<f64> {
    [r.uniform(-3.0, 7.0), r.uniform(-3.0, 3.0), r.uniform(0.0, 4.0)]
}

fn stream(index: u64) -> Stream {
    Stream::new(21, index, 0, Purpose::user(8))
}

#[test]
fn distances_have_their_closed_forms() {
    let scene = scene();
    let nominal = scene.nominal_placement();
    assert_eq!((nominal.len(), scene.n_placement()), (13, 13));
    for (p, element, want) in [
        ([3.0, -3.0, 0.3], Element::Ground, 0.3),
        // the bars' axes of the first gate are at y = ±0.66, z = 2 ± 0.605; their radius is 0.044
        ([2.0, 0.5, 2.0], Element::Gate(0), 0.16 - 0.044),
        ([2.3, 0.66, 2.0], Element::Gate(0), 0.3 - 0.044),
        ([2.0, 0.0, 2.5], Element::Gate(0), 0.105 - 0.044),
        ([2.0, -0.96, 3.005], Element::Gate(0), 0.5 - 0.044),
        ([0.0, 2.5, 1.7], Element::Obstacle(0), 0.3),
        ([0.3, 2.0, 2.9], Element::Obstacle(0), 0.5 - 0.2),
        ([-1.0, -1.0, 1.2], Element::Obstacle(1), 0.1),
    ] {
        let (nearest, d) = scene.nearest(&nominal, p).unwrap();
        assert_eq!(nearest, element, "{p:?}");
        assert!((d - want).abs() < 1e-12, "{p:?}: {d} against {want}");
        assert_eq!(scene.distance(&nominal, p), d);
    }
    assert_eq!(Scene::default().distance(&[], [0.0; 3]), FAR);
    assert_eq!(Scene::default().nearest(&[], [0.0; 3]), None);
}

#[test]
fn the_distance_to_a_gate_is_that_to_the_nearest_of_its_four_bars() {
    let scene = scene();
    let mut r = stream(0);
    let placement: Vec<f64> = (0..13).map(|_| r.uniform(-0.5, 0.5)).collect();
    for i in 0..2 {
        let pose = scene.gate_pose(&placement, i);
        let (gate, bars) = (&scene.gates[i], scene.gates[i].bars(&pose));
        for _ in 0..2000 {
            let p = random(&mut r);
            let want =
                bars.iter().fold(f64::INFINITY, |least, [a, b]| least.min(point_capsule(p, *a, *b, gate.bar_radius())));
            let have = gate.distance(&pose, p);
            assert!((have - want).abs() < 1e-14, "{p:?}: {have} against {want}");
        }
    }
}

#[test]
fn solids_of_a_placement_are_as_far_from_a_point_as_the_scene() {
    let scene = Scene { ground: None, ..scene() };
    let mut r = stream(11);
    let point = Geometry::Sphere { radius: 0.0 };
    let mut worst = 0.0f64;
    for _ in 0..200 {
        let placement: Vec<f64> = (0..13).map(|_| r.uniform(-0.5, 0.5)).collect();
        let (solids, p) = (scene.solids(&placement), random(&mut r));
        assert_eq!(solids.len(), 2 * 4 + 2);
        let at = Pose { position: p, attitude: [1.0, 0.0, 0.0, 0.0] };
        let far = |solid: &Shape| {
            let pose = Pose { position: solid.position, attitude: solid.rotation };
            distance::distance(&point, &at, &solid.geometry, &pose)
        };
        let least = solids.iter().map(far).fold(f64::INFINITY, f64::min);
        worst = worst.max((least - scene.distance(&placement, p)).abs());
    }
    // inside of boxes and bars too
    assert!(worst < 1e-12, "{worst:e}");
}

#[test]
fn a_placement_moves_what_it_names_and_a_slide_goes_along_the_gates_own_y() {
    let scene = scene();
    let mut r = stream(1);
    for element in [Element::Gate(0), Element::Gate(1), Element::Obstacle(0), Element::Obstacle(1)] {
        let at = scene.placement_index(element).unwrap();
        let mut placement = scene.nominal_placement();
        let offset = random(&mut r);
        placement[at..at + 3].copy_from_slice(&offset);
        let position = |placement: &[f64]| match element {
            Element::Gate(i) => scene.gate_pose(placement, i).position,
            Element::Obstacle(i) => scene.obstacle_pose(placement, i).position,
            Element::Ground | Element::Mesh(_) => unreachable!(),
        };
        let (moved, still) = (position(&placement), position(&scene.nominal_placement()));
        for k in 0..3 {
            assert!((moved[k] - still[k] - offset[k]).abs() < 1e-14, "{element:?}");
        }
    }
    let mut placement = scene.nominal_placement();
    placement[scene.placement_index(Element::Gate(1)).unwrap() + 3] = 0.9;
    let (moved, along) = (scene.gate_pose(&placement, 1).position, rotate(scene.gates[1].rotation, [0.0, 0.9, 0.0]));
    for k in 0..3 {
        assert!((moved[k] - scene.gates[1].position[k] - along[k]).abs() < 1e-14);
    }
    assert_eq!(scene.placement_index(Element::Ground), None);
}

#[test]
#[should_panic(expected = "a placement of 3 numbers for a scene of 13")]
fn a_placement_of_the_wrong_length_panics() {
    scene().distance(&[0.0; 3], [0.0; 3]);
}

#[test]
fn the_gradient_in_the_point_has_unit_norm_and_is_that_of_differences() {
    let scene = scene();
    let mut r = stream(2);
    let placement: Vec<f64> = (0..13).map(|_| r.uniform(-0.3, 0.3)).collect();
    let lifted: Vec<Dual64> = placement.iter().map(|x| Dual64::from(*x)).collect();
    let (mut worst, mut at_kinks) = (0.0_f64, 0);
    for _ in 0..3000 {
        let p = random(&mut r);
        let mut squared = 0.0;
        for k in 0..3 {
            let mut x = p.map(Dual64::from);
            x[k].eps = 1.0;
            let exact = scene.distance(&lifted, x).eps;
            let at = |h: f64| {
                let mut p = p;
                p[k] += h;
                scene.distance(&placement, p)
            };
            let central = (at(1e-6) - at(-1e-6)) / 2e-6;
            let error = (exact - central).abs();
            if error > 1e-5 {
                at_kinks += 1; // the step reaches over the medial axis
            } else {
                worst = worst.max(error);
            }
            squared += exact * exact;
        }
        assert!((squared - 1.0).abs() < 1e-12, "{p:?}: {squared}");
    }
    println!("largest difference {worst:.1e}; {at_kinks} of 9000 across the medial axis");
    assert!(at_kinks < 10);
}

#[test]
fn gradients_in_the_placement_are_finite_and_push_the_other_way() {
    let scene = scene();
    let p = [2.3, 0.5, 2.2].map(Dual64::from);
    for k in 0..13 {
        let mut placement = vec![Dual64::from(0.0); 13];
        placement[k].eps = 1.0;
        let d = scene.distance(&placement, p).eps;
        let want = if k < 3 {
            let mut x = p;
            x[k].eps = 1.0;
            -scene.distance(&[Dual64::from(0.0); 13], x).eps
        } else {
            0.0
        };
        assert!((d - want).abs() < 1e-14, "{k}: {d} against {want}");
    }
    // on a bar's axis, where every direction is out
    for k in 0..3 {
        let mut x = [2.0, 0.66, 2.1].map(Dual64::from);
        x[k].eps = 1.0;
        let d = scene.distance(&[Dual64::from(0.0); 13], x);
        assert!(d.eps.is_finite() && d.eps.abs() <= 1.0 && (d.re + 0.044).abs() < 2e-9, "{d:?}");
    }
}

#[test]
fn clearance_of_a_small_ball_is_the_distance_and_that_of_a_box_tells_hits_from_misses() {
    let scene = scene();
    let nominal = scene.nominal_placement();
    let mut r = stream(3);
    let size = [0.3, 0.2, 0.1];
    let (mut hits, mut misses) = (0, 0);
    for _ in 0..2000 {
        let pose = Pose {
            position: random(&mut r),
            attitude: from_euler(r.uniform(-3.0, 3.0), r.uniform(-1.0, 1.0), r.uniform(-3.0, 3.0)),
        };
        let ball = scene.clearance(&nominal, &Geometry::Sphere { radius: 0.1 }, &pose);
        let point = scene.distance(&nominal, pose.position);
        assert!((ball - point + 0.1).abs() < 1e-12, "{ball} {point}");
        let capsule = scene.clearance(&nominal, &Geometry::Capsule { radius: 0.1, length: 0.0 }, &pose);
        assert!((capsule - ball).abs() < 2e-9, "{capsule} {ball}");
        let block = scene.clearance(&nominal, &Geometry::Box { size }, &pose);
        let (inner, outer) = (point - 0.05, point - Geometry::Box { size }.reach());
        assert!(block <= inner + 1e-6, "{block}: the inscribed ball has {inner}");
        hits += usize::from(block < 0.0);
        misses += usize::from(block > 0.0);
        if outer > 0.0 {
            assert!(block > 0.0, "{block}: the ball around it has {outer}");
        }
    }
    assert!(hits > 50 && misses > 500, "{hits} {misses}");
}

#[test]
fn a_step_through_the_opening_counts_once_with_its_margin() {
    let scene = scene();
    let nominal = scene.nominal_placement();
    let meet = |from, to| {
        let passage = scene.passage(&nominal, 0, from, to);
        (passage.direction, passage.margin)
    };
    // free half width 0.616, half height 0.561
    for (from, to, direction, margin) in [
        ([1.0, 0.0, 2.0], [3.0, 0.0, 2.0], 1.0, 0.561),
        ([3.0, 0.0, 2.0], [1.0, 0.0, 2.0], -1.0, 0.561),
        ([1.0, 0.2, 2.0], [3.0, 0.6, 2.0], 1.0, 0.216),
        ([1.0, 1.0, 2.0], [3.0, 1.0, 2.0], 1.0, -0.384),
        ([1.0, 0.0, 2.0], [1.9, 0.5, 2.0], 0.0, 0.116),
        ([2.5, 0.0, 2.0], [2.1, 0.5, 2.0], 0.0, 0.116),
    ] {
        let (d, m) = meet(from, to);
        assert!(d == direction && (m - margin).abs() < 1e-12, "{from:?} to {to:?}: {d}, {m}");
    }
    // end to end through the plane, with a stop on it
    let xs = [1.0, 1.5, 2.0, 2.0, 2.5, 3.0];
    let sum: f64 = xs.windows(2).map(|x| meet([x[0], 0.0, 2.0], [x[1], 0.0, 2.0]).0).sum();
    assert_eq!(sum, 1.0);
    let back: f64 = xs.windows(2).rev().map(|x| meet([x[1], 0.0, 2.0], [x[0], 0.0, 2.0]).0).sum();
    assert_eq!(back, -1.0);
    // the slid gate takes its opening along
    let mut placement = nominal.clone();
    placement[6] = 1.5;
    let gate = scene.gate_pose(&placement, 1);
    let through = scene.passage(&placement, 1, gate.point([-0.5, 0.1, 0.0]), gate.point([0.5, 0.1, 0.0]));
    assert!(through.direction == 1.0 && (through.margin - 0.516).abs() < 1e-12, "{through:?}");
    // a step within the plane has finite slopes
    for k in 0..3 {
        let mut to = [2.0, 0.1, 2.0].map(Dual64::from);
        to[k].eps = 1.0;
        let p = scene.passage(&[Dual64::from(0.0); 13], 0, [2.0, 0.0, 2.0].map(Dual64::from), to);
        assert!(p.margin.eps.is_finite() && p.margin.eps.abs() <= 1.0, "{p:?}");
    }
}

#[test]
fn an_undamped_slide_swings_at_its_natural_period_and_its_stops_hold_it() {
    let slide = GateSlide::default();
    let dt = 1e-3;
    let swing = |mut y: f64, mut v: f64, steps: usize| {
        let mut farthest = 0.0_f64;
        for _ in 0..steps {
            // leapfrog
            v += 0.5 * dt * slide.acceleration(y, v, 0.0);
            y += dt * v;
            v += 0.5 * dt * slide.acceleration(y, v, 0.0);
            farthest = farthest.max(y.abs());
        }
        (y, v, farthest)
    };
    let period = std::f64::consts::TAU / 0.75_f64.sqrt();
    let (y, _, _) = swing(1.0, 0.0, (period / dt) as usize);
    assert!((y - 1.0).abs() < 1e-5, "{y}");
    let (_, _, farthest) = swing(1.9, 3.0, 5000);
    // 4 kg at 3 m/s: 2.1 cm into the stop
    assert!(farthest > 2.0 && farthest < 2.1, "{farthest}");
}

#[test]
fn a_recorded_distance_is_the_distance_and_its_adjoint_the_gradient() {
    let scene = scene();
    let recording = Recording::of(16, |z| {
        let p: [Trace; 3] = std::array::from_fn(|k| z[13 + k]);
        vec![scene.distance(&z[..13], p)]
    });
    let program = Program::compile(&recording).unwrap();
    let adjoint = Program::compile(&recording.adjoint(0..16)).unwrap();
    let mut r = stream(4);
    for _ in 0..100 {
        let mut z: Vec<f64> = (0..13).map(|_| r.uniform(-0.3, 0.3)).collect();
        z.extend(random(&mut r));
        let mut d = [0.0];
        program.evaluate(&mut program.workspace(), &z, &mut d);
        assert!((d[0] - scene.distance(&z[..13], [z[13], z[14], z[15]])).abs() < 1e-14);
        let mut gradient = [0.0; 16];
        adjoint.evaluate(&mut adjoint.workspace(), &[&z[..], &[1.0]].concat(), &mut gradient);
        let squared: f64 = gradient[13..].iter().map(|g| g * g).sum();
        assert!((squared - 1.0).abs() < 1e-12, "{gradient:?}");
    }
}

#[test]
fn scenes_are_toml_with_defaults_and_errors_name_the_element() {
    let scene = scene();
    scene.validate().unwrap();
    let text = toml::to_string(&scene).unwrap();
    assert_eq!(toml::from_str::<Scene>(&text).unwrap(), scene, "{text}");
    let least: Scene = toml::from_str("[[gates]]\nposition = [0, 0, 2]\nslide = {}").unwrap();
    assert_eq!(least.gates[0].slide, Some(GateSlide::default()));
    assert_eq!(least.gates[0].opening(), [1.1 * 0.6 - 1.1 * 0.04, 1.1 * 0.55 - 1.1 * 0.04]);
    assert!(toml::from_str::<Scene>("[[gates]]\ncolour = 1").is_err());

    let broken = |change: fn(&mut Scene), start: &str| {
        let mut scene = scene.clone();
        change(&mut scene);
        let text = scene.validate().unwrap_err().to_string();
        assert!(text.starts_with(start), "{text}");
    };
    broken(|s| s.ground = Some(f64::NAN), "scene: ground is NaN");
    broken(|s| s.gates[1].radius = 0.56, "gate 'second': radius is 0.56, but it must be below 0.55");
    broken(|s| s.gates[0].rotation = [0.0; 4], "gate 'first': rotation is a quaternion of length 0");
    broken(|s| s.gates[1].slide.as_mut().unwrap().mass = 0.0, "gate 'second': slide.mass is 0");
    broken(|s| s.gates[1].name = "first".into(), "scene: gate name is 'first' twice, but it must be unique");
    broken(
        |s| s.obstacles[0].shape.geometry = Geometry::Sphere { radius: 0.0 },
        "obstacle 'pillar': radius is 0, but it must be between",
    );
    broken(|s| s.obstacles[1].name = "pillar".into(), "scene: obstacle name is 'pillar' twice");
}
