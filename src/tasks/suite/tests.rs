//! What only shows from inside.

use super::load::{Load, LoadSettings, Side};
use super::transport_hover::TransportHover;
use super::*;
use crate::any_task::{Snapshot, declare};
use crate::env::episode_start::EpisodeStart;
use crate::robot::{Inertial, Robot};
use crate::task::BuiltIn;
use crate::task_spec::total;
use crate::{Ends, EnvConfig, Task, View, Writer};
use autodiff::{Scalar, Trace};
use dynamics::contact::distance;
use dynamics::shape::{Geometry, Pose, Shape};

fn config(n_env: usize, task: &str) -> EnvConfig {
    EnvConfig { n_env, task: toml::from_str(task).unwrap(), ..EnvConfig::default() }
}

#[test]
fn drawn_mass_properties_are_those_of_the_model_at_its_masses() {
    let c = config(1, "");
    for side in [Side::Hanging, Side::Standing] {
        let own = LoadSettings { vehicle: "iris".into(), length: [0.7; 2], bar_mass: [0.03; 2], ..Default::default() };
        let load = Load::new(&c, &own, side).unwrap();
        let bar = load.robot.model().unwrap().body("bar").unwrap();
        let built = Inertial::read(&load.robot.parameters(), bar);
        let drawn = load.inertial(0.7, 0.03, built.mass - 0.03);
        assert!((built.center_of_mass[2] - drawn.center_of_mass[2]).abs() < 1e-12, "{built:?}, {drawn:?}");
        let (a, b) = (&built.inertia, &drawn.inertia);
        let off = a.iter().zip(b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
        assert!(off < 1e-12, "{side:?}: {off:e}");
    }
}

/// Reward terms of a task at its ideal, and whether it ends there.
fn at_ideal(task: &impl Task) -> (Vec<f64>, bool) {
    let (robot, own) = (task.robot(), declare(task).unwrap());
    let EpisodeStart { state, numbers, goal, task_state, .. } =
        EpisodeStart::ideal(task, total(&own.goal), total(&own.task_state));
    let seen = Snapshot::of(robot, robot.plant(), &numbers, &state, &goal, task_state);
    seen.ask(robot, |view| {
        let kept = Writer::written(|out| task.remember(view, out)).numbers();
        let view = View { task_state: &kept[..], ..*view };
        let terms = Writer::written(|out| task.reward(&view, out)).numbers();
        let mut ends = Ends::default();
        task.ends(&view, &mut ends);
        let holds = |mask| Trace::select(mask, Trace::one(), Trace::zero()).known() == Some(1.0);
        let reached = Trace::select(task.success(&view), Trace::one(), Trace::zero()).known();
        assert_eq!(reached, Some(1.0), "{}", task.about());
        (terms.into_iter().map(|x| x.known().unwrap()).collect(), ends.masks.into_iter().any(holds))
    })
}

fn reaches_its_bounds(task: &impl Task) {
    let (terms, ended) = at_ideal(task);
    assert!(!ended);
    for (term, value) in declare(task).unwrap().reward.iter().zip(terms) {
        if term.name == "effort" {
            assert!(value > 0.0 && value < term.bound, "effort {value}");
        } else {
            assert!((value - term.bound).abs() < 1e-6, "{}: {value} of {}", term.name, term.bound);
        }
    }
}

#[test]
fn the_ideal_reaches_every_terms_bound() {
    let c = config(1, "");
    reaches_its_bounds(&over_hover::OverHover::new(&c).unwrap());
    reaches_its_bounds(&over_track::OverTrack::new(&c).unwrap());
    reaches_its_bounds(&over_fly_through::OverFlyThrough::new(&c).unwrap());
    reaches_its_bounds(&TransportHover::new(&c).unwrap());
    reaches_its_bounds(&TransportHover::new(&config(1, "n_drone = 6")).unwrap());
    reaches_its_bounds(&transport_track::TransportTrack::new(&c).unwrap());
    reaches_its_bounds(&transport_fly_through::TransportFlyThrough::new(&c).unwrap());
    reaches_its_bounds(&formation::Formation::new(&c).unwrap());
    reaches_its_bounds(&formation::Formation::new(&config(1, "formation = 'tetragon'")).unwrap());
    reaches_its_bounds(&dragon_hover::DragonHover::new(&c).unwrap());
    reaches_its_bounds(&spread::Spread::new(&c).unwrap());
    reaches_its_bounds(&gate_switch::GateSwitch::new(&c).unwrap());
}

#[test]
fn slats_fill_the_box_of_a_load() {
    for task in ["n_drone = 4", "n_drone = 6"] {
        let free = TransportHover::new(&config(1, task)).unwrap();
        let among = transport_fly_through::TransportFlyThrough::new(&config(1, task)).unwrap();
        let shapes = |robot: &Robot| -> Vec<Shape> {
            robot.model().unwrap().shapes().iter().filter(|s| s.body == Some(0)).map(|s| s.shape).collect()
        };
        let (whole, slats) = (shapes(free.robot()), shapes(among.robot()));
        let Geometry::Box { size } = whole[0].geometry else { panic!("the box is one") };
        let home = Pose { position: [0.0; 3], attitude: [1.0, 0.0, 0.0, 0.0] };
        let mut worst = 0.0_f64;
        for k in 0..27_u32 {
            // corners, and the middles of edges and faces
            let at = [k % 3, k / 3 % 3, k / 9].map(f64::from);
            let point = [0, 1, 2].map(|i| 0.5 * size[i] * (at[i] - 1.0));
            let gap = |s: &Shape| distance::point(point, &s.geometry, &s.pose(&home));
            worst = worst.max(slats.iter().map(gap).fold(f64::INFINITY, f64::min));
        }
        println!("{} slats leave {worst:.3} m of a corner", slats.len());
        // √3 − 1 of their radius
        assert!(slats.len() == 3 && (worst - 0.2 * (3.0_f64.sqrt() - 1.0)).abs() < 1e-9, "{worst}");
    }
}
