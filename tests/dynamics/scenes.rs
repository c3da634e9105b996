//! Scenes from seeds.

use omnidrones::dynamics::contact::{distance, plane_distance};
use omnidrones::dynamics::scene::{Corridor, Course, Forest, Generator, KINDS, Rooms, Rubble, Scene, Terrain};
use omnidrones::dynamics::shape::{Geometry, Pose};
use omnidrones::rng::{Purpose, Stream};
use std::f64::consts::PI;

#[test]
fn every_kind_has_a_default_that_is_valid_and_depends_on_its_seed_alone() {
    for (kind, _) in KINDS {
        let drawn = |text: &str| Generator::parse(text).unwrap().scene().unwrap();
        let (zero, again, one) = (drawn(kind), drawn(&format!("{kind}:0")), drawn(&format!("{kind}:1")));
        zero.validate().unwrap();
        assert_eq!(zero, again, "{kind}");
        assert_ne!(zero, one, "{kind}");
        let things = zero.gates.len() + zero.obstacles.len();
        assert!(zero.relief.is_some() || (zero.ground == Some(0.0) && things > 7), "{kind}");
        assert_eq!(Generator::parse(kind).unwrap().kind(), kind);
    }
}

#[test]
fn every_kind_leaves_the_start_free() {
    for (kind, _) in KINDS.iter().filter(|(kind, _)| !["rubble", "terrain"].contains(kind)) {
        for seed in 0..20 {
            let scene = Generator::parse(&format!("{kind}:{seed}")).unwrap().scene().unwrap();
            let gap = scene.distance(&scene.nominal_placement(), [0.5, 0.0, 1.0]);
            assert!(gap > 0.6, "{kind}:{seed}: {gap} m");
        }
    }
}

#[test]
fn a_kind_nobody_knows_and_a_seed_that_is_none_are_errors_with_a_remedy() {
    let told = |text: &str| Generator::parse(text).unwrap_err().to_string();
    assert!(told("forrest:1").contains("did you mean 'forest'?"), "{}", told("forrest"));
    let text = told("forest:-1");
    assert!(text.starts_with("scene 'forest': seed is '-1', but it must be a whole number"), "{text}");
}

/// Points of the middle line, found from the walls: half way between the two of each piece.
fn middles(scene: &Scene) -> Vec<[f64; 3]> {
    let pairs = scene.obstacles.chunks_exact(2);
    pairs.map(|w| std::array::from_fn(|k| 0.5 * (w[0].shape.position[k] + w[1].shape.position[k]))).collect()
}

#[test]
fn the_way_is_free_and_its_walls_have_no_holes() {
    for seed in 0..50 {
        let corridor = Corridor { seed, ..Corridor::default() };
        let scene = corridor.scene().unwrap();
        let placement = scene.nominal_placement();
        let middles = middles(&scene);
        for p in &middles {
            let gap = scene.distance(&placement, [p[0], p[1], 1.4]);
            assert!(gap > 0.8, "seed {seed}: {gap} m");
        }
        // around a bend the outer faces touch: walking along them, a wall is always within a millimetre
        for side in 0..2 {
            for k in 0..corridor.pieces - 1 {
                let (a, b) = (&scene.obstacles[2 * k + side].shape, &scene.obstacles[2 * k + 2 + side].shape);
                let gap = distance(
                    &a.geometry,
                    &Pose { position: a.position, attitude: a.rotation },
                    &b.geometry,
                    &Pose { position: b.position, attitude: b.rotation },
                );
                assert!(gap < 1e-9, "seed {seed}: a hole of {gap} m");
            }
        }
    }
}

#[test]
fn bends_that_eat_a_wall_are_refused() {
    let text = Corridor { length: [1.0, 2.0], bend: 60.0, ..Corridor::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("corridor: length[0] is 1, but it must be above 1.732 m"), "{text}");
}

#[test]
fn gates_are_met_in_order_apart_and_within_their_heights() {
    for seed in 0..50 {
        let course = Course { seed, gates: 30, ..Course::default() };
        let scene = course.scene().unwrap();
        let placement = scene.nominal_placement();
        let mut from = [0.0, 0.0, scene.gates[0].position[2]];
        for (i, gate) in scene.gates.iter().enumerate() {
            let to = gate.position;
            let way = (0..3).map(|k| (to[k] - from[k]).powi(2)).sum::<f64>().sqrt();
            assert!((3.0 - 1e-9..=5.0 + 0.7).contains(&way), "seed {seed}, gate {i}: {way} m");
            assert!((1.2..=2.5).contains(&to[2]));
            // straight from gate to gate crosses each along its x axis, well inside
            let beyond: [f64; 3] = std::array::from_fn(|k| to[k] + 0.2 * (to[k] - from[k]));
            let passage = scene.passage(&placement, i, from, beyond);
            assert!(passage.direction == 1.0 && passage.margin > 0.5, "seed {seed}, gate {i}: {passage:?}");
            for other in &scene.gates[..i] {
                let apart = (0..3).map(|k| (to[k] - other.position[k]).powi(2)).sum::<f64>().sqrt();
                assert!(apart > 2.0, "seed {seed}: gates {apart} m apart");
            }
            from = to;
        }
    }
}

#[test]
fn gates_in_the_ground_or_in_each_other_are_refused() {
    let text = Course { height: [0.5, 2.0], ..Course::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("gates: height[0] is 0.5, but it must be above 0.649 m"), "{text}");
    let text = Course { spacing: [1.0, 2.0], ..Course::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("gates: spacing[0] is 1, but it must be above 2.008 m"), "{text}");
}

/// Checks gaps and edges of the first `standing` trunks of a placement.
fn check(forest: &Forest, scene: &Scene, placement: &[f64], standing: usize) -> f64 {
    let places: Vec<_> = (0..standing).map(|i| scene.obstacle_pose(placement, i).position).collect();
    let radius = |i: usize| match scene.obstacles[i].shape.geometry {
        Geometry::Capsule { radius, .. } => radius,
        _ => unreachable!("trunks are capsules"),
    };
    let mut least = f64::INFINITY;
    for i in 0..standing {
        let ([x, y, z], r) = (places[i], radius(i));
        assert!(x - r >= forest.clear[0] - 1e-12 && x + r <= forest.length - forest.clear[1] + 1e-12, "x {x}");
        assert!(y.abs() + r <= 0.5 * forest.width + 1e-12 && z == 0.5 * forest.height, "y {y}, z {z}");
        for k in 0..i {
            least = least.min((x - places[k][0]).hypot(y - places[k][1]) - r - radius(k));
        }
    }
    assert!(least >= forest.gap - 1e-12, "a gap of {least} m");
    least
}

#[test]
fn trunks_keep_their_gap_and_the_start_free_in_every_forest_and_placement() {
    let full = Forest { trunks: 135, ..Forest::default() };
    for forest in [Forest::default(), full, Forest { trunks: 1, ..full }, Forest { gap: 0.0, trunks: 300, ..full }] {
        let scene = forest.scene().unwrap();
        let mut placement = scene.nominal_placement();
        check(&forest, &scene, &placement, forest.trunks);
        let mut least = f64::INFINITY;
        for episode in 0..200 {
            let standing = forest.trunks - (episode as usize * forest.trunks) / 250;
            let mut stream = Stream::new(5, 3, episode, Purpose::TASK);
            forest.place(&scene.obstacles, standing, &mut stream, &mut placement);
            least = least.min(check(&forest, &scene, &placement, standing));
            for i in standing..forest.trunks {
                assert!(scene.obstacle_pose(&placement, i).position[2] < -900.0);
            }
        }
        println!("{} trunks, {:.3} per m²: least gap {least:.3} m", forest.trunks, forest.density());
    }
}

#[test]
fn no_straight_lane_is_free_in_every_forest() {
    // in how many of 200 forests a ball of 0.3 m radius gets through along a line y = constant
    let forest = Forest::default();
    let scene = forest.scene().unwrap();
    let mut placement = scene.nominal_placement();
    let mut free = [0; 41];
    for episode in 0..200 {
        forest.place(&scene.obstacles, 45, &mut Stream::new(2, 0, episode, Purpose::TASK), &mut placement);
        for (k, free) in free.iter_mut().enumerate() {
            let y = -5.0 + 0.25 * k as f64;
            let hit = (0..45).any(|i| {
                let pose = scene.obstacle_pose(&placement, i);
                (pose.position[1] - y).abs() < 0.3 + 0.25
            });
            *free += usize::from(!hit);
        }
    }
    let most = free.iter().max().unwrap();
    // measured 9 of 200
    println!("the freest lane is free in {most} of 200 forests");
    assert!(*most < 20, "{free:?}");
}

#[test]
fn placements_are_those_of_their_stream_and_every_trunk_gets_everywhere() {
    let forest = Forest::default();
    let scene = forest.scene().unwrap();
    let (mut a, mut b) = (scene.nominal_placement(), scene.nominal_placement());
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for episode in 0..100 {
        for out in [&mut a, &mut b] {
            forest.place(&scene.obstacles, 45, &mut Stream::new(2, 0, episode, Purpose::TASK), out);
        }
        assert_eq!(a, b);
        let x = scene.obstacle_pose(&a, 7).position[0];
        (least, most) = (least.min(x), most.max(x));
    }
    // measured 2.3 to 22.5 m
    println!("trunk 7 from {least:.1} to {most:.1} m");
    assert!(least < 4.0 && most > 20.0);
}

#[test]
fn a_density_that_cannot_be_placed_is_refused_with_the_number_that_can() {
    let text = Forest { trunks: 136, ..Forest::default() }.scene().unwrap_err().to_string();
    let want = "forest: trunks is 136, over the limit of 135 with radius 0.3 m and a gap of 0.8 m on 20.4 m by 11.4 m";
    assert!(text.starts_with(want), "{text}");
    let text = Forest { clear: [20.0, 5.0], ..Forest::default() }.scene().unwrap_err().to_string();
    assert!(text.contains("over the limit of 0 with"), "{text}");
    let text = Forest { radius: [0.3, 0.2], ..Forest::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("forest: radius is [0.3, 0.2], but it must be [least, most]"), "{text}");
}

/// Whether a door lies between two neighbours: a point at half the doors' height goes through somewhere.
fn open(rooms: &Rooms, scene: &Scene, a: [usize; 2], b: [usize; 2]) -> bool {
    let middle: [f64; 2] = std::array::from_fn(|k| 0.5 * (a[k] + b[k]) as f64 * rooms.size[k]);
    let axis = usize::from(a[0] == b[0]);
    (0..100).any(|i| {
        let mut p = [middle[0], middle[1], 1.0];
        p[1 - axis] += rooms.size[1 - axis] * (f64::from(i) / 100.0 - 0.495);
        scene.distance(&scene.nominal_placement(), p) > 0.45
    })
}

#[test]
fn every_room_can_be_reached_and_nothing_leads_outside() {
    for seed in 0..30 {
        let rooms = Rooms { seed, rooms: [4, 3], loops: if seed < 15 { 0.0 } else { 0.3 }, ..Rooms::default() };
        let scene = rooms.scene().unwrap();
        let mut reached = [[false; 3]; 4];
        let (mut way, mut doors) = (vec![[0_usize, 0]], 0);
        reached[0][0] = true;
        while let Some([i, k]) = way.pop() {
            for [a, b] in [[i + 1, k], [i, k + 1], [i.wrapping_sub(1), k], [i, k.wrapping_sub(1)]] {
                if a < 4 && b < 3 && open(&rooms, &scene, [i, k], [a, b]) {
                    doors += 1;
                    if !reached[a][b] {
                        reached[a][b] = true;
                        way.push([a, b]);
                    }
                }
            }
        }
        assert!(reached.iter().flatten().all(|r| *r), "seed {seed}: {reached:?}");
        // a tree of twelve rooms has eleven doors, seen from both sides
        assert!(doors == 22 || (seed >= 15 && doors > 22), "seed {seed}: {doors}");
        for k in 0..3 {
            assert!(!open(&rooms, &scene, [3, k], [4, k]), "seed {seed}: open to +x");
        }
    }
}

#[test]
fn a_door_wider_than_its_wall_is_refused() {
    let text = Rooms { door: [3.95, 2.0], ..Rooms::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("rooms: door[0] is 3.95, but it must be below 3.9 m"), "{text}");
}

#[test]
fn blocks_reach_above_the_ground_within_the_heap_and_leave_the_circle_free() {
    for seed in 0..20 {
        let rubble = Rubble { seed, clear: 0.8, ..Rubble::default() };
        let scene = rubble.scene().unwrap();
        let mut highest = 0.0_f64;
        for obstacle in &scene.obstacles {
            let shape = &obstacle.shape;
            let Geometry::Box { size } = shape.geometry else { unreachable!("blocks are boxes") };
            assert!(size.iter().all(|edge| (0.15..=0.5).contains(edge)));
            assert!(shape.position[0].abs() <= 2.0 && shape.position[1].abs() <= 2.0);
            let pose = Pose { position: shape.position, attitude: shape.rotation };
            assert!(plane_distance(&shape.geometry, &pose, 0.0) <= 0.0, "hangs in the air");
            highest = highest.max(pose.position[2] + shape.geometry.reach());
        }
        let free = Scene { ground: None, ..scene.clone() };
        for k in 0..16 {
            let angle = f64::from(k) * PI / 8.0;
            let p = [0.79 * angle.cos(), 0.79 * angle.sin(), 0.3];
            assert!(free.distance(&free.nominal_placement(), p) > 0.0);
        }
        assert!(highest > 0.2 && highest < 1.0, "{highest}");
    }
}

#[test]
fn a_circle_as_large_as_the_heap_is_refused() {
    let text = Rubble { clear: 1.9, ..Rubble::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("rubble: clear is 1.9, but it must be at most 1.567 m"), "{text}");
}

#[test]
fn hills_are_as_steep_as_asked_and_pass_through_the_origin() {
    let mut steepest = 0.0_f64;
    for seed in 0..20 {
        let scene = Terrain { seed, ..Terrain::default() }.scene().unwrap();
        let relief = scene.relief.as_ref().unwrap();
        assert!(scene.distance(&[], [0.0_f64; 3]).abs() < 1e-12);
        for i in 0..2000 {
            let (_, [sx, sy]) = relief.rise(0.1 * f64::from(i) - 100.0, 0.07 * f64::from(i * 31 % 1997));
            steepest = steepest.max(sx.hypot(sy));
        }
    }
    // measured 17.3 of 25 degrees: waves seldom add up
    println!("steepest {:.1} degrees", steepest.atan().to_degrees());
    assert!(steepest < 25.0_f64.to_radians().tan() && steepest > 10.0_f64.to_radians().tan());
}

#[test]
fn an_incline_that_is_too_steep_with_its_hills_is_refused() {
    let text = Terrain { incline: 60.0, ..Terrain::default() }.scene().unwrap_err().to_string();
    assert!(text.starts_with("scene: relief: steepest place is"), "{text}");
}
