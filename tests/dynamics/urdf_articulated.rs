//! URDF files whose joints move become models through the same assembly as built-in configurations.

use nalgebra::{Rotation3, Vector3};
use omnidrones::dynamics::Physics;
use omnidrones::dynamics::tree::*;
use omnidrones::dynamics::urdf::{ImportOptions, ModelImport, import_file, import_model_file, import_model_text};
use std::path::PathBuf;

fn asset(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/assets").join(name)
}

fn import(name: &str) -> ModelImport {
    import_model_file(asset(name), &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn text(name: &str) -> String {
    std::fs::read_to_string(asset(name)).unwrap()
}

fn refusal(text: &str) -> String {
    match import_model_text(text, "a.urdf", None, &ImportOptions::default()) {
        Ok(_) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_gimbal_moves_and_the_rest_is_the_rigid_import() {
    let ModelImport { model, warnings, assumptions } = import("camera_drone.urdf");
    let names: Vec<&str> = model.bodies().iter().map(|b| b.name.as_str()).collect();
    assert_eq!(names, ["hull", "yoke", "camera"]);
    let rigid = import_file(asset("camera_drone.urdf"), &ImportOptions::default()).unwrap().vehicle;
    let own = rigid.mass_properties();
    let system = Multibody::new(&model, Physics::default()).unwrap();
    let rest = system.rest_state();
    assert!((model.mass() - own.mass).abs() < 1e-14);
    assert!((Vector3::from(center_of_mass(&system, &rest)) - own.center_of_mass).norm() < 1e-15);
    // both about the base origin: J + m (c² − c cᵀ)
    let c = own.center_of_mass;
    let about = own.inertia + (nalgebra::Matrix3::identity() * c.norm_squared() - c * c.transpose()) * own.mass;
    let mass = mass_matrix(&model, &rest).unwrap();
    assert!((mass.fixed_view::<3, 3>(3, 3) - about).amax() < 1e-16);
    assert_eq!(model.rotors().len(), 4);
    for (mounted, wanted) in model.rotors().iter().zip(&rigid.rotors) {
        assert_eq!((mounted.body, &mounted.rotor.name), (0, &wanted.name), "the order is that of the rotor file");
        assert_eq!((mounted.rotor.position, mounted.rotor.axis), (wanted.position, wanted.axis));
    }
    assert_eq!((model.drones()[0].body, model.drones()[0].rotors.as_slice()), (0, &[0, 1, 2, 3][..]));
    assert_eq!(model.bodies()[0].drag.linear, [0.1, 0.1, 0.15]);
    let said: Vec<String> = warnings.iter().map(ToString::to_string).chain(assumptions).collect();
    for word in ["friction of 0.01", "cylinders", "'pan', 'pitch' are passive"] {
        assert!(said.iter().any(|s| s.contains(word)), "{word}: {said:?}");
    }
}

#[test]
fn axes_ranges_damping_and_frames_are_those_of_the_file() {
    let model = import("camera_drone.urdf").model;
    let pan = &model.bodies()[model.joint("pan").unwrap()].joint;
    assert_eq!((pan.motion, pan.damping, pan.limits), (Motion::Revolute([0.0, 0.0, 1.0]), 0.002, None));
    assert_eq!(pan.rotation, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], "half a turn, exact");
    let pitch = &model.bodies()[model.joint("pitch").unwrap()].joint;
    let limits = pitch.limits.unwrap();
    assert_eq!((limits.lower, limits.upper, pitch.damping), (-0.5, 1.6, 0.001));
    let mast = model.frame("mast").unwrap();
    assert_eq!((mast.body, mast.position), (0, [0.0, 0.0, 0.04]));
    let parts: Vec<(&str, Option<usize>)> = model.shapes().iter().map(|s| (s.part.as_str(), s.body)).collect();
    // a cylinder is two boxes and a capsule
    let mast = ("mast", Some(0));
    assert_eq!(parts, [("hull", Some(0)), mast, mast, mast, ("camera", Some(2))]);
    // camera after panning by 0.7 (about −z of the hull) and pitching by 0.3: by hand
    let system = Multibody::new(&model, Physics::default()).unwrap();
    let mut x = system.rest_state();
    x[model.layout().bodies[1].position] = 0.7;
    x[model.layout().bodies[2].position] = 0.3;
    let pose = frame_pose(&system, &x, &model.frame("camera").unwrap());
    let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        * Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), 0.3);
    assert!((Vector3::from(pose.position) - Vector3::new(0.05, 0.0, -0.1)).norm() < 1e-15, "{:?}", pose.position);
    for (i, row) in pose.rotation.iter().enumerate() {
        for (j, got) in row.iter().enumerate() {
            assert!((got - turn[(i, j)]).abs() < 1e-15);
        }
    }
}

#[test]
fn a_double_pendulum_hangs_on_the_world_and_obeys_its_equation() {
    let ModelImport { model, assumptions, .. } = import("double_pendulum.urdf");
    assert!(model.rotors().is_empty() && model.drones().is_empty());
    assert!(assumptions.iter().any(|a| a.contains("no rotors")));
    assert_eq!((model.layout().n_state(), model.layout().n_input()), (4, 0));
    assert_eq!((model.bodies()[0].parent, model.bodies()[0].joint.position), (None, [0.0, 0.0, 2.0]));
    let system = Multibody::new(&model, Physics::default()).unwrap();
    // from rest at (q, −q) the lower rod hangs straight. M q̈ = −dV/dq, in closed form
    let q = 0.4_f64;
    let mut rate = [0.0; 4];
    system.derivative(&[q, -q, 0.0, 0.0], &[], &[], &mut rate);
    let (m1, c1, j1, l1, m2, c2, j2, g) = (1.2, 0.25, 0.025, 0.5, 0.7, 0.2, 0.01, 9.81);
    let coupling = m2 * l1 * c2 * q.cos();
    let m22 = j2 + m2 * c2 * c2;
    let m12 = m22 + coupling;
    let m11 = j1 + m1 * c1 * c1 + m2 * l1 * l1 + m22 + 2.0 * coupling;
    let force = [-(m1 * c1 + m2 * l1) * g * q.sin(), 0.0];
    let det = m11 * m22 - m12 * m12;
    let wanted = [(m22 * force[0] - m12 * force[1]) / det, (m11 * force[1] - m12 * force[0]) / det];
    for k in 0..2 {
        assert!((rate[2 + k] - wanted[k]).abs() < 1e-12 * wanted[k].abs(), "{rate:?} against {wanted:?}");
    }
}

#[test]
fn joints_without_counterpart_and_bad_numbers_name_their_place() {
    let file = text("double_pendulum.urdf");
    let planar = refusal(&file.replace("name=\"elbow\" type=\"revolute\"", "name=\"elbow\" type=\"planar\""));
    assert!(planar.contains("joint 'elbow'") && planar.contains("planar"), "{planar}");
    let floating = refusal(&file.replace("name=\"elbow\" type=\"revolute\"", "name=\"elbow\" type=\"floating\""));
    assert!(floating.contains("joint 'elbow'") && floating.contains("floating"), "{floating}");
    let crossed = refusal(&file.replace("lower=\"-2.5\"", "lower=\"3.5\""));
    assert!(crossed.contains("joint 'elbow'") && crossed.contains("lower"), "{crossed}");
    let damping = refusal(&file.replace("damping=\"0.01\"", "damping=\"-0.01\""));
    assert!(damping.contains("joint 'shoulder'") && damping.contains("damping"), "{damping}");
    let light =
        file.replace("mass value=\"0.7\"", "mass value=\"0\"").replace("\"0.01\" iyy=\"0.01\"", "\"0\" iyy=\"0\"");
    let light = refusal(&light.replace("izz=\"0.0001\"", "izz=\"0\""));
    assert!(light.contains("'lower'") && light.contains("mass"), "{light}");
    let still =
        refusal(&file.replace("type=\"continuous\"", "type=\"fixed\"").replace("type=\"revolute\"", "type=\"fixed\""));
    assert!(still.contains("fixed to the world"), "{still}");
}

#[test]
fn a_floating_joint_under_world_frees_its_child() {
    let file = text("double_pendulum.urdf").replace("type=\"fixed\"", "type=\"floating\"");
    let file = file.replace(
        "<link name=\"post\"/>",
        "<link name=\"post\"><inertial><mass value=\"1\"/>\
         <inertia ixx=\"0.1\" iyy=\"0.1\" izz=\"0.1\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>",
    );
    let model = import_model_text(&file, "a.urdf", None, &ImportOptions::default()).unwrap().model;
    assert_eq!(model.bodies()[0].joint.motion, Motion::Floating);
    assert_eq!(model.layout().n_velocity(), 8);
}
