//! Parts joined into models: what merges, what follows from scaling, and that every bad assembly names its part.

use nalgebra::{Matrix3, Vector3};
use omnidrones::dynamics::assembly::*;
use omnidrones::dynamics::tree::*;
use omnidrones::dynamics::vehicles::hummingbird;
use omnidrones::dynamics::{Inertia, Physics};
use omnidrones::error::{Error, Result};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

fn ball() -> Solid {
    Solid::sphere(0.1).mass(1.0)
}

/// A root ball with an arm on a hinge: valid.
fn pair() -> Assembly {
    let mut a = Assembly::new("pair");
    a.part("base", ball());
    a.part("arm", Solid::bar([0.0; 3], [0.5, 0.0, 0.0], 0.01).mass(0.2));
    a.join(JointSpec::new("hinge", JointKind::Revolute(Y), "base", "arm"));
    a
}

fn refusal<T>(result: Result<T>) -> String {
    match result {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    }
}

#[track_caller]
fn says(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "'{word}' is missing in: {text}");
    }
}

fn close(got: &Matrix3<f64>, wanted: &Matrix3<f64>, tolerance: f64) {
    assert!((got - wanted).amax() <= tolerance * wanted.amax(), "{got} against {wanted}");
}

// ---------------------------------------------------------------------------------------------- merging and splitting

#[test]
fn welded_parts_have_the_inertia_computed_by_hand() {
    let mut a = Assembly::new("hammer");
    a.part("handle", Solid::cuboid([0.6, 0.04, 0.04]).mass(0.5));
    a.part("head", Solid::cuboid([0.3, 0.1, 0.1]).mass(1.5));
    // the head lies across the end of the handle: its x is the handle's y
    a.join(
        JointSpec::new("weld", JointKind::Fixed, "handle", "head")
            .at(Placement::from([0.3, 0.0, 0.0]).turned(Z, FRAC_PI_2)),
    );
    let model = a.model().unwrap();
    assert_eq!(model.bodies().len(), 1);
    let body = &model.bodies()[0];
    assert_eq!(body.mass, 2.0);
    // c = 1.5·0.3/2; J = Σ own + m d², handle 0.225 and head 0.075 from it
    let c = 0.225;
    assert!((body.center_of_mass[0] - c).abs() < 1e-15 && body.center_of_mass[1..] == [0.0, 0.0]);
    let xx = 0.5 / 12.0 * 2.0 * 0.0016 + 1.5 / 12.0 * (0.09 + 0.01);
    let yy = 0.5 / 12.0 * (0.36 + 0.0016) + 1.5 / 12.0 * 0.02 + 0.5 * 0.225 * 0.225 + 1.5 * 0.075 * 0.075;
    let zz = 0.5 / 12.0 * (0.36 + 0.0016) + 1.5 / 12.0 * (0.01 + 0.09) + 0.5 * 0.225 * 0.225 + 1.5 * 0.075 * 0.075;
    close(&body.inertia.matrix(), &Inertia::diagonal(xx, yy, zz).matrix(), 1e-14);
    assert_eq!((body.inertia.xy, body.inertia.xz, body.inertia.yz), (0.0, 0.0, 0.0), "rounding is cleaned away");
    let head = model.frame("head").unwrap();
    assert_eq!((head.body, head.position, head.rotation[0]), (0, [0.3, 0.0, 0.0], [0.0, -1.0, 0.0]));
}

#[test]
fn a_chain_of_welds_takes_rotors_and_shapes_along() {
    let mut a = Assembly::new("tower");
    a.part("foot", ball());
    a.part("mast", Solid::bar([0.0; 3], Z, 0.02).mass(0.3));
    a.part("drone", Solid::vehicle(&hummingbird()));
    a.join(JointSpec::new("second", JointKind::Fixed, "mast", "drone").at(Placement::from(Z).turned(X, FRAC_PI_2)));
    a.join(JointSpec::new("first", JointKind::Fixed, "foot", "mast").at([0.0, 0.0, 0.1]));
    let model = a.model().unwrap();
    assert_eq!((model.bodies().len(), model.bodies()[0].name.as_str()), (1, "foot"));
    assert!((model.mass() - (1.0 + 0.3 + 0.716)).abs() < 1e-12);
    // hub (0.17, 0, 0.01): turned about x, z goes to −y
    let rotor = &model.rotors()[model.rotor("drone/rotor_0").unwrap()].rotor;
    let wanted = [0.17, -0.01, 1.1];
    assert!((Vector3::from(rotor.position) - Vector3::from(wanted)).norm() < 1e-15, "{:?}", rotor.position);
    assert_eq!(rotor.axis, [0.0, -1.0, 0.0]);
    assert_eq!((model.drones()[0].name.as_str(), model.drones()[0].position), ("drone", [0.0, 0.0, 1.1]));
    assert_eq!(model.drones()[0].rotors, [0, 1, 2, 3]);
    let mast = model.shapes().iter().find(|s| s.part == "mast").unwrap();
    assert!((mast.shape.position[2] - 0.6).abs() < 1e-15);
    // quadratic drag (0.005, 0.005, 0.01) turned about x by a quarter
    let drag = model.bodies()[0].drag.quadratic;
    assert!((drag[1] - 0.01).abs() < 1e-17 && (drag[2] - 0.005).abs() < 1e-17, "{drag:?}");
}

#[test]
fn a_universal_joint_becomes_two_hinges_with_a_massless_cross() {
    let mut a = pair();
    a.part("tip", ball());
    a.join(
        JointSpec::new("knee", JointKind::Universal(Y, Z), "arm", "tip")
            .at([0.5, 0.0, 0.0])
            .damping(0.1)
            .range(-1.0, 2.0),
    );
    let model = a.model().unwrap();
    let cross = &model.bodies()[model.joint("knee.y").unwrap()];
    let tip = &model.bodies()[model.joint("knee.z").unwrap()];
    assert_eq!((cross.name.as_str(), cross.mass, tip.name.as_str()), ("knee.cross", 0.0, "tip"));
    assert_eq!((cross.joint.motion, tip.joint.motion), (Motion::Revolute(Y), Motion::Revolute(Z)));
    assert_eq!((cross.joint.position, tip.joint.position), ([0.5, 0.0, 0.0], [0.0; 3]));
    assert_eq!((cross.joint.damping, tip.joint.damping), (0.1, 0.1));
    assert_eq!(cross.joint.limits.unwrap().upper, 2.0);
}

#[test]
fn placements_on_both_sides_coincide_at_rest() {
    let (at, child_at) = (
        Placement::from([0.3, -0.2, 0.5]).turned([1.0, 1.0, 0.0], 0.8),
        Placement::from([-0.1, 0.4, 0.2]).turned([0.0, 1.0, 3.0], -1.1),
    );
    for kind in [
        JointKind::Fixed,
        JointKind::Revolute([1.0, 2.0, 2.0]),
        JointKind::Universal(X, Y),
        JointKind::Ball,
        JointKind::Prismatic(Z),
    ] {
        let mut a = Assembly::new("two");
        a.part("a", ball());
        a.part("b", Solid::cuboid([0.1, 0.2, 0.3]).mass(0.4));
        a.join(JointSpec::new("j", kind, "a", "b").at(at).child_at(child_at));
        let model = a.model().unwrap();
        let system = Multibody::new(&model, Physics::default()).unwrap();
        let pose = frame_pose(&system, &system.rest_state(), &model.frame("b").unwrap());
        let wanted = at.then(&child_at.inverse());
        assert!((Vector3::from(pose.position) - Vector3::from(wanted.position)).norm() < 1e-15, "{kind:?}");
        let x = Placement { position: [0.0; 3], ..wanted }.then(&Placement::from(X)).position;
        assert!((0..3).all(|k| (pose.rotation[k][0] - x[k]).abs() < 1e-15), "{kind:?}: {:?} {x:?}", pose.rotation);
    }
}

#[test]
fn an_axis_is_given_in_the_joints_frame_and_made_a_unit_vector() {
    let mut a = pair();
    a.part("tip", ball());
    // the joint's frame is turned by 60° about z on the child's side: its x is (½, √3/2, 0) there
    let joint = JointSpec::new("j", JointKind::Revolute([5.0, 0.0, 0.0]), "arm", "tip");
    a.join(joint.child_at(Placement::from([0.0, 0.0, 0.2]).turned(Z, FRAC_PI_3)));
    let model = a.model().unwrap();
    let body = &model.bodies()[model.body("tip").unwrap()];
    let Motion::Revolute(axis) = body.joint.motion else { panic!() };
    assert!((axis[0] - 0.5).abs() < 1e-15 && (axis[1] - 0.75_f64.sqrt()).abs() < 1e-15, "{axis:?}");
    assert_eq!(body.center_of_mass, [0.0, 0.0, -0.2], "the body's origin is at the joint");
    assert_eq!(model.frame("tip").unwrap().position, [0.0, 0.0, -0.2]);
}

#[test]
fn parents_come_first_whatever_the_order_of_parts() {
    let mut a = Assembly::new("chain");
    for i in (0..5).rev() {
        a.part(format!("link_{i}"), ball());
    }
    for i in [2, 0, 3, 1] {
        let join =
            JointSpec::new(format!("j_{i}"), JointKind::Revolute(Y), format!("link_{i}"), format!("link_{}", i + 1));
        a.join(join.at([0.0, 0.0, -0.3]));
    }
    let names: Vec<String> = a.model().unwrap().bodies().iter().map(|b| b.name.clone()).collect();
    assert_eq!(names, ["link_0", "link_1", "link_2", "link_3", "link_4"]);
}

#[test]
fn drones_welded_into_one_body_become_one_source_of_wakes() {
    let mut a = Assembly::new("twin");
    a.part("bar", Solid::bar([-1.0, 0.0, 0.0], X, 0.02).mass(0.2));
    for (name, x) in [("left", -1.0), ("right", 1.0)] {
        a.part(name, Solid::vehicle(&hummingbird()));
        a.join(JointSpec::new(format!("on_{name}"), JointKind::Fixed, "bar", name).at([x, 0.0, 0.0]));
    }
    let model = a.model().unwrap();
    let [drone] = model.drones() else { panic!("{:?}", model.drones()) };
    assert_eq!((drone.name.as_str(), drone.position, drone.rotors.len()), ("left", [0.0; 3], 8));
}

#[test]
fn what_is_fixed_to_the_world_is_an_obstacle_and_what_hangs_on_it_is_a_root() {
    let mut a = Assembly::new("crane");
    a.part("post", Solid::bar([0.0; 3], Z, 0.05).mass(10.0));
    a.part("arm", Solid::bar([0.0; 3], X, 0.02).mass(1.0));
    a.part("hook", ball());
    a.join(JointSpec::new("base", JointKind::Fixed, WORLD, "post").at([2.0, 0.0, 0.0]));
    a.join(JointSpec::new("slew", JointKind::Revolute(Z), "post", "arm").at([0.0, 0.0, 1.0]));
    a.join(JointSpec::new("rope", JointKind::Ball, "arm", "hook").at(X).child_at([0.0, 0.0, 0.5]));
    let model = a.model().unwrap();
    assert_eq!(model.bodies().len(), 2);
    assert_eq!((model.bodies()[0].parent, model.bodies()[0].joint.position), (None, [2.0, 0.0, 1.0]));
    let fixed: Vec<_> = model.shapes().iter().filter(|s| s.body.is_none()).collect();
    assert_eq!((fixed.len(), fixed[0].part.as_str(), fixed[0].shape.position), (1, "post", [2.0, 0.0, 0.5]));
}

// -------------------------------------------------------------------------------------------------- scaling, servos

#[test]
fn given_masses_stay_and_masses_of_a_density_grow_with_the_volume() {
    for (solid, mass, moment) in [
        (Solid::cuboid([0.1, 0.2, 0.3]).mass(2.0), 1.0, 2.0_f64.powi(2)),
        (Solid::cuboid([0.1, 0.2, 0.3]).density(500.0), 8.0, 2.0_f64.powi(5)),
        (Solid::capsule(0.1, 0.4).density(500.0).and(rod(X, Y, 0.1)), 8.0, 2.0_f64.powi(5)),
        (Solid::vehicle(&hummingbird()), 1.0, 2.0_f64.powi(2)),
    ] {
        let (own, twice) = (solid.properties(), solid.clone().scaled(2.0).properties());
        assert!((twice.mass / own.mass - mass).abs() < 1e-14 * mass);
        close(&twice.inertia, &(own.inertia * moment), 1e-14);
        assert!((twice.center_of_mass - own.center_of_mass * 2.0).norm() < 1e-15);
    }
    let mut a = pair();
    a.part("sled", ball());
    a.join(JointSpec::new("slide", JointKind::Prismatic(X), "arm", "sled").at([0.5, 0.0, 0.0]).range(-0.1, 0.2));
    a.scale(3.0).unwrap();
    let model = a.model().unwrap();
    let sled = &model.bodies()[model.body("sled").unwrap()].joint;
    assert_eq!((sled.position[0], sled.limits.unwrap().upper), (1.5, 3.0 * 0.2));
}

#[test]
fn inertia_follows_a_mass_that_is_set() {
    for solid in [Solid::cuboid([0.1, 0.2, 0.3]).density(500.0), Solid::vehicle(&hummingbird())] {
        let own = solid.properties();
        let mut a = Assembly::new("one");
        a.part("it", solid);
        a.set_mass("it", 3.0 * own.mass).unwrap();
        let model = a.model().unwrap();
        let body = &model.bodies()[0];
        assert!((body.mass - 3.0 * own.mass).abs() < 1e-14);
        close(&body.inertia.matrix(), &(own.inertia * 3.0), 1e-14);
    }
}

#[test]
fn damping_by_rate_is_drag_in_proportion_to_mass_and_inertia() {
    let mut a = Assembly::new("box");
    a.part("box", Solid::cuboid([1.5, 1.0, 0.4]).mass(2.0).damping(0.1, 0.3));
    let model = a.model().unwrap();
    let body = &model.bodies()[0];
    assert_eq!(body.drag.linear, [0.2; 3]);
    for (drag, moment) in body.drag.angular.iter().zip([body.inertia.xx, body.inertia.yy, body.inertia.zz]) {
        assert!((drag - 0.3 * moment).abs() < 1e-16);
    }
}

#[test]
fn a_rate_servo_has_the_inertia_that_its_joint_feels_over_its_lag() {
    // two like bars hinged at their ends about z: a torque between them turns both and moves the hinge.
    // Each bar: J about its centre, m, half length l. The relative acceleration per torque, by symmetry of the free
    // pair: the hinge moves straight along y, each bar turns by ∓α with hinge acceleration l α, force 2 m l α… so
    // τ = (J + m l²) α − m l · l α = J α with the hinge's force 0: I = τ/(2 α) = J/2.
    let (mass, half) = (0.4, 0.25);
    let mut a = Assembly::new("nunchaku");
    for name in ["a", "b"] {
        a.part(name, Solid::bar([-half, 0.0, 0.0], [half, 0.0, 0.0], 0.01).mass(mass));
    }
    let servo = Servo::Rate { time_constant: 0.02, max_torque: 1.0, range: 3.0 };
    let hinge =
        JointSpec::new("hinge", JointKind::Revolute(Z), "a", "b").at([half, 0.0, 0.0]).child_at([-half, 0.0, 0.0]);
    a.join(hinge.servo(servo).range(-2.0, 2.0));
    let model = a.model().unwrap();
    let joint = &model.bodies()[1].joint;
    let system = Multibody::new(&model, Physics::default()).unwrap();
    let inverse = mass_matrix(&model, &system.rest_state()).unwrap().try_inverse().unwrap();
    let felt = 1.0 / inverse[(6, 6)];
    let drive = joint.drive.unwrap();
    assert!((drive.damping - felt / 0.02).abs() < 1e-12 * drive.damping, "{} {felt}", drive.damping);
    assert_eq!((drive.stiffness, drive.max_torque, drive.range), (0.0, 1.0, 3.0));
    let limits = joint.limits.unwrap();
    assert!((limits.stiffness - felt * 900.0).abs() < 1e-9 * limits.stiffness);
    assert_eq!(limits.dissipation, STOP_DISSIPATION);
    // straight: M⁻¹ of the pair by hand. Torque τ on b, −τ on a, hinge force f along y on b: τ − f l = J α_b,
    // f = m a_b, −τ − f l = J α_a, −f = m a_a, a_a + l α_a = a_b − l α_b
    let j = model.bodies()[0].inertia.zz;
    let per_force = 2.0 / mass + 2.0 * half * half / j;
    // f per τ: the τ terms of both sides cancel, so f = 0 and α_b − α_a = 2 τ/J
    assert!(per_force > 0.0 && (felt / (0.5 * j) - 1.0).abs() < 1e-12, "{felt} against {}", 0.5 * j);
}

// -------------------------------------------------------------------------------------------------------- group

#[test]
fn a_group_keeps_names_by_prefix_and_moves_what_hangs_on_the_world() {
    let drone = pair().model().unwrap();
    let mut crane = Assembly::new("crane");
    crane.part("arm", Solid::bar([0.0; 3], X, 0.02).mass(1.0));
    crane.join(JointSpec::new("slew", JointKind::Revolute(Z), WORLD, "arm").at([0.0, 0.0, 1.0]));
    let crane = crane.model().unwrap();
    let members = [
        Member::new("left", drone.clone(), [0.0, 1.0, 2.0]),
        Member::new("crane", crane, Placement::from([5.0, 0.0, 0.0]).turned(Z, PI)),
        Member::new("right", drone.clone(), [0.0, -1.0, 2.0]),
    ];
    let model = group("yard", &members).unwrap();
    assert_eq!(model.layout().trees.len(), 3);
    assert_eq!(model.layout().n_state(), 2 * drone.layout().n_state() + 2);
    let arm = &model.bodies()[model.body("crane/arm").unwrap()];
    assert_eq!((arm.joint.position, arm.joint.rotation[0]), ([5.0, 0.0, 1.0], [-1.0, 0.0, 0.0]));
    let right = model.body("right/arm").unwrap();
    assert_eq!(model.bodies()[right].parent, Some(model.body("right/base").unwrap()));
    assert_eq!(model.bodies()[model.body("left/base").unwrap()].joint.position, [0.0, 1.0, 2.0]);

    let twice = [members[0].clone(), members[0].clone()];
    says(&refusal(group("yard", &twice)), &["yard", "'left' twice"]);
    says(&refusal(group("yard", &[])), &["yard", "number of members"]);
}

// ------------------------------------------------------------------------------------------------ bad assemblies

#[test]
fn an_unknown_part_is_named_with_the_nearest() {
    let mut a = pair();
    a.join(JointSpec::new("j", JointKind::Fixed, "arn", "base"));
    assert!(matches!(a.model(), Err(Error::Unknown { .. })));
    says(&refusal(a.model()), &["no part is called 'arn'", "did you mean 'arm'?"]);
    says(&refusal(pair().set_mass("bsae", 1.0)), &["no part is called 'bsae'", "'base'"]);
}

#[test]
fn a_part_carried_twice_is_a_loop() {
    let mut a = pair();
    a.part("rod", ball());
    a.join(JointSpec::new("one", JointKind::Revolute(Y), "base", "rod"));
    a.join(JointSpec::new("two", JointKind::Revolute(Y), "arm", "rod"));
    says(&refusal(a.model()), &["part 'rod'", "'one' and 'two'", "loop"]);
}

#[test]
fn a_cycle_is_named_with_its_parts() {
    let mut a = pair();
    for name in ["p", "q", "r"] {
        a.part(name, ball());
    }
    for (name, parent, child) in [("a", "p", "q"), ("b", "q", "r"), ("c", "r", "p")] {
        a.join(JointSpec::new(name, JointKind::Revolute(Y), parent, child));
    }
    let text = refusal(a.model());
    says(&text, &["its own ancestor", "p", "q", "r", "cycle"]);
    assert!(!text.contains("base"), "{text}");
    let mut a = pair();
    a.join(JointSpec::new("self", JointKind::Revolute(Y), "base", "base"));
    says(&refusal(a.model()), &["part 'base'", "its own ancestor"]);
}

#[test]
fn a_second_root_is_named_with_the_first() {
    let mut a = pair();
    a.part("stray", ball());
    says(&refusal(a.model()), &["part 'stray'", "'base' is a root already"]);
    let mut a = pair();
    a.part("held", ball());
    a.join(JointSpec::new("pin", JointKind::Revolute(Y), WORLD, "held"));
    says(&refusal(a.model()), &["part 'base'", "'held' is held by the world"]);
}

#[test]
fn an_axis_without_direction_names_its_joint() {
    for (kind, which) in [
        (JointKind::Revolute([0.0; 3]), "axis"),
        (JointKind::Prismatic([0.0; 3]), "axis"),
        (JointKind::Universal(X, [0.0; 3]), "second axis"),
        (JointKind::Universal(X, [2.0, 0.0, 0.0]), "second axis"),
        (JointKind::Revolute([0.0, f64::NAN, 1.0]), "axis"),
    ] {
        let mut a = pair();
        a.part("tip", ball());
        a.join(JointSpec::new("knee", kind, "arm", "tip"));
        says(&refusal(a.model()), &["joint 'knee'", which]);
    }
}

#[test]
fn no_mass_at_a_leaf_names_the_part() {
    let mut a = pair();
    a.part("tip", Solid::sphere(0.1));
    a.join(JointSpec::new("knee", JointKind::Revolute(Y), "arm", "tip"));
    says(&refusal(a.model()), &["'tip'", "mass"]);
    let mut a = pair();
    a.part("point", Solid::explicit(0.1, [0.0; 3], Inertia::zero()));
    a.join(JointSpec::new("knee", JointKind::Revolute(Y), "arm", "point"));
    says(&refusal(a.model()), &["'point'", "inertia"]);
}

#[test]
fn ranges_that_cross_name_the_joint() {
    let mut a = pair();
    a.part("tip", ball());
    a.join(JointSpec::new("knee", JointKind::Revolute(Y), "arm", "tip").range(1.0, -1.0));
    says(&refusal(a.model()), &["joint 'knee'", "lower", "-1"]);
}

#[test]
fn a_servo_without_bound_names_the_joint() {
    for max_torque in [0.0, -1.0, f64::INFINITY, f64::NAN] {
        for servo in [
            Servo::Rate { time_constant: 0.02, max_torque, range: 1.0 },
            Servo::Position { stiffness: 1.0, damping: 1.0, max_torque, center: 0.0, range: 1.0 },
        ] {
            let mut a = pair();
            a.part("tip", ball());
            a.join(JointSpec::new("knee", JointKind::Revolute(Y), "arm", "tip").servo(servo));
            says(&refusal(a.model()), &["joint 'knee'", "max_torque"]);
        }
    }
    let mut a = pair();
    a.part("tip", ball());
    let servo = Servo::Rate { time_constant: 0.0, max_torque: 1.0, range: 1.0 };
    a.join(JointSpec::new("knee", JointKind::Revolute(Y), "arm", "tip").servo(servo));
    says(&refusal(a.model()), &["joint 'knee'", "time_constant"]);
}

#[test]
fn repeated_and_reserved_names_are_refused() {
    let mut a = pair();
    a.part("arm", ball());
    says(&refusal(a.model()), &["part 'arm'", "twice"]);
    let mut a = pair();
    a.part("tip", ball());
    a.join(JointSpec::new("hinge", JointKind::Revolute(Y), "arm", "tip"));
    says(&refusal(a.model()), &["joint 'hinge'", "twice"]);
    let mut a = pair();
    a.part(WORLD, ball());
    says(&refusal(a.model()), &["'world'"]);
}

#[test]
fn sizes_masses_and_places_that_are_no_numbers_name_the_part() {
    for (solid, word) in [
        (Solid::sphere(f64::NAN).mass(1.0), "radius"),
        (Solid::sphere(0.0).mass(1.0), "radius"),
        (Solid::cuboid([0.1, -0.1, 0.1]).mass(1.0), "size"),
        (Solid::sphere(0.1).mass(f64::NAN), "mass"),
        (Solid::sphere(0.1).mass(-1.0), "mass"),
        (Solid::sphere(0.1).density(f64::INFINITY), "density"),
        (Solid::of([]).mass(1.0), "number of shapes"),
        (Solid::explicit(1.0, [f64::NAN, 0.0, 0.0], Inertia::diagonal(1.0, 1.0, 1.0)), "centre of mass"),
        (Solid::explicit(1.0, [0.0; 3], Inertia::diagonal(1.0, 1.0, 3.0)), "inertia"),
        (ball().damping(-0.1, 0.0), "linear damping"),
    ] {
        let mut a = pair();
        a.part("odd", solid);
        a.join(JointSpec::new("j", JointKind::Revolute(Y), "arm", "odd"));
        says(&refusal(a.model()), &["part 'odd'", word]);
    }
    let mut a = pair();
    a.part("tip", ball());
    a.join(JointSpec::new("knee", JointKind::Fixed, "arm", "tip").at([f64::NAN, 0.0, 0.0]));
    says(&refusal(a.model()), &["joint 'knee'", "place in the parent"]);
    says(&refusal(pair().scale(0.0)), &["assembly 'pair'", "scale"]);
    says(&refusal(pair().set_mass("arm", f64::NAN)), &["'arm'", "mass"]);
    says(&refusal(pair().set_mass("arm", -1.0)), &["'arm'", "mass"]);
}

#[test]
fn what_cannot_hold_on_a_joint_is_refused_by_name() {
    let servo = Servo::Rate { time_constant: 0.02, max_torque: 1.0, range: 1.0 };
    let base = |kind| JointSpec::new("knee", kind, "arm", "tip");
    for (join, word) in [
        (base(JointKind::Ball).range(-1.0, 1.0), "range"),
        (base(JointKind::Fixed).servo(servo), "servo"),
        (base(JointKind::Floating), "parent"),
    ] {
        let mut a = pair();
        a.part("tip", ball());
        a.join(join);
        says(&refusal(a.model()), &["joint 'knee'", word]);
    }
    let mut a = Assembly::new("stuck");
    a.part("it", ball());
    a.join(JointSpec::new("weld", JointKind::Fixed, WORLD, "it"));
    says(&refusal(a.model()), &["'stuck'", "fixed to the world"]);
    says(&refusal(Assembly::new("nothing").model()), &["'nothing'", "number of parts"]);
    let mut a = Assembly::new("pole");
    a.part("drone", Solid::vehicle(&hummingbird()));
    a.part("flag", ball());
    a.join(JointSpec::new("weld", JointKind::Fixed, WORLD, "drone"));
    a.join(JointSpec::new("hinge", JointKind::Revolute(Z), "drone", "flag"));
    says(&refusal(a.model()), &["part 'drone'", "rotors"]);
}

#[test]
fn the_order_of_rotors_is_as_said_and_complete() {
    let drone = || {
        let mut a = Assembly::new("one");
        a.part("d", Solid::vehicle(&hummingbird()));
        a
    };
    let names = |order: &[usize]| order.iter().map(|i| format!("d/rotor_{i}")).collect::<Vec<_>>();
    let mut a = drone();
    a.rotor_order(names(&[3, 1, 0, 2]));
    assert_eq!(a.model().unwrap().rotor("d/rotor_0").unwrap(), 2);
    let mut a = drone();
    a.rotor_order(names(&[0, 1, 2]));
    says(&refusal(a.model()), &["d/rotor_3", "missing"]);
    let mut a = drone();
    a.rotor_order(names(&[0, 1, 2, 4]));
    says(&refusal(a.model()), &["no rotor is called 'd/rotor_4'"]);
}
