//! Real and own URDF files become vehicles that can hover, and survive the way out and back.

use omnidrones::dynamics::urdf::{
    Import, ImportOptions, InputLimits, RotorFile, draft_rotors, export, import_file, import_text,
};
use omnidrones::dynamics::vehicle::{Drag, Gains, Inertia, Part, Rotor, Vehicle};
use omnidrones::error::Error;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn own(name: &str) -> Import {
    import_file(root().join("assets/urdf").join(name), &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// Largest yaw moment at hover thrust shares, over thrust: 0 where spins cancel.
fn unbalance(vehicle: &Vehicle) -> f64 {
    vehicle.allocation_matrix().row(5).sum().abs() / vehicle.n_rotor() as f64
}

#[test]
fn package_paths_are_not_resolved_without_a_map_and_silent_with_one() {
    let mesh = |path: &str| format!("<visual><geometry><mesh filename=\"{path}\"/></geometry></visual><visual>");
    let text = std::fs::read_to_string(root().join("assets/urdf/plain_x.urdf")).unwrap();
    let file = std::fs::read_to_string(root().join("assets/urdf/plain_x.rotors.toml")).unwrap();
    let rotors = RotorFile::parse(&file, "v.rotors.toml").unwrap();
    let mut options = ImportOptions::default();
    let told = |path: &str, options: &ImportOptions| -> Vec<String> {
        let text = text.replacen("<visual>", &mesh(path), 1);
        let warnings = import_text(&text, "v.urdf", Some(&rotors), options).unwrap().warnings;
        warnings.iter().map(ToString::to_string).collect()
    };
    let [own, out] = ["package://airframes/hull.stl", "package://airframes/../../hull.stl"];
    let unresolved = |told: Vec<String>| told.len() == 1 && told[0].contains("'package://airframes' is not resolved");
    assert!(unresolved(told(own, &options)));
    options.packages.insert("engines".into(), "meshes".into());
    assert!(unresolved(told(own, &options)), "the map of another package");
    options.packages.insert("airframes".into(), "meshes".into());
    assert_eq!(told(own, &options), [""; 0]);
    let left = told(out, &options);
    assert!(left.len() == 1 && left[0].contains("leaves its package"), "{left:?}");
}

#[test]
fn every_own_file_imports_without_a_warning_and_can_hover() {
    let mut files = 0;
    for entry in std::fs::read_dir(root().join("assets/urdf")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "urdf") {
            let import = own(&path.file_name().unwrap().to_string_lossy());
            assert!(import.warnings.is_empty(), "{:#?}", import.warnings);
            assert!(import.vehicle.thrust_to_weight() > 1.6, "{}", path.display());
            files += 1;
        }
    }
    assert!(files >= 4);
}

#[test]
fn turned_inertials_and_joints_add_up_to_the_same_body_as_a_hand_computation() {
    let import = own("hexa_frames.urdf");
    let total = import.vehicle.mass_properties();
    assert!((total.mass - (1.3 + 0.06 + 0.02 + 0.4 + 6.0 * 0.018 + 0.08)).abs() < 1e-12);
    // The antenna hangs on the mast, whose joint is turned: R = Rz(0.7) Ry(-0.1) Rx(0.2), written out.
    let (r, p, y) = (0.2f64, -0.1f64, 0.7f64);
    let up = [
        y.cos() * p.sin() * r.cos() + y.sin() * r.sin(),
        y.sin() * p.sin() * r.cos() - y.cos() * r.sin(),
        p.cos() * r.cos(),
    ];
    let antenna = import.vehicle.parts.iter().find(|p| p.name == "antenna").unwrap();
    for k in 0..3 {
        let expected = [-0.05, 0.0, 0.03][k] + 0.13 * up[k];
        assert!((antenna.position[k] - expected).abs() < 1e-15, "{k}: {} {expected}", antenna.position[k]);
    }
    // The battery is turned by 45° about z: xx and yy mix, xy appears with their half difference.
    let battery = &import.vehicle.parts.iter().find(|p| p.name == "battery").unwrap().inertia;
    assert!((battery.xx - 0.00075).abs() < 1e-15 && (battery.xy + 0.00015).abs() < 1e-15, "{battery:?}");
    // The third rotor has its own values, the others the defaults.
    let rotors = &import.vehicle.rotors;
    assert_eq!(rotors[2].max_speed, 850.0);
    assert!((rotors[2].moment_per_thrust - 2.0e-7 / 1.2e-5).abs() < 1e-15);
    assert!((rotors[0].max_thrust() - 8.5).abs() < 1e-12);
    assert!(import.vehicle.published_gains.is_some());
}

fn assert_same(a: &Vehicle, b: &Vehicle) {
    let (p, q) = (a.mass_properties(), b.mass_properties());
    assert!((p.mass - q.mass).abs() <= 1e-12 * p.mass);
    assert!((p.center_of_mass - q.center_of_mass).norm() <= 1e-12);
    assert!((p.inertia - q.inertia).norm() <= 1e-12 * p.inertia.norm());
    assert_eq!(a.rotors, b.rotors);
    assert_eq!((&a.name, &a.source, a.drag, a.published_gains), (&b.name, &b.source, b.drag, b.published_gains));
}

/// Tilted rotors, products of inertia, an offset centre of mass; some rotors are parts, some are not.
fn hand_made(n: usize) -> Vehicle {
    let tensor =
        |s: f64| Inertia { xx: 0.011 * s, yy: 0.013 * s, zz: 0.019 * s, xy: 7e-4 * s, xz: -5e-4 * s, yz: 3e-4 * s };
    let mut parts = vec![
        Part::new("frame & <core>", 1.1 + 1.0 / 3.0, [0.013, -0.007, 0.021], tensor(1.0)),
        Part::new("battery", 0.3, [-0.02, 0.01, -0.04], tensor(0.01)),
    ];
    let mut rotors = Vec::new();
    for i in 0..n {
        let (sin, cos) = (i as f64 * std::f64::consts::TAU / n as f64 + 0.1).sin_cos();
        let tilt = 0.2 * (-1f64).powi(i as i32);
        let position = [0.23 * cos, 0.23 * sin, 0.017 * i as f64];
        let name = format!("rotor \"{i}\"");
        if i % 2 == 0 {
            parts.push(Part::new(name.clone(), 0.011, [position[0], position[1], position[2] + 0.002], tensor(1e-4)));
        }
        rotors.push(Rotor {
            name,
            position,
            axis: [-tilt.sin() * sin, tilt.sin() * cos, tilt.cos()],
            spin: (-1f64).powi(i as i32),
            thrust_coefficient: 1e-5 / 3.0 * (1.0 + 0.01 * i as f64),
            moment_per_thrust: 0.016,
            max_speed: 1234.5,
            time_constant_up: 0.0125,
            time_constant_down: 0.025,
            inertia: 1e-5 / 7.0,
            radius: 0.11,
            drag_coefficient: 8.06428e-5,
            axial_drag_coefficient: 1e-4,
            rolling_coefficient: 1e-6,
        });
    }
    let gains = Gains {
        position: [4.0, 4.1, 6.0],
        velocity: [2.2; 3],
        attitude: [0.7, 0.7, 0.035],
        rate: [0.1, 0.1, 0.025],
        integral: [0.0; 2],
    };
    let drag = Drag { linear: [0.1, 0.2, 0.3], quadratic: [0.01; 3], angular: [0.001; 3] };
    Vehicle {
        name: format!("hand_{n}"),
        source: "a \"test\"\nof two lines".into(),
        parts,
        rotors,
        drag,
        shapes: vec![],
        published_gains: Some(gains),
    }
}

#[test]
fn an_exported_vehicle_imports_as_the_same_vehicle() {
    for n in [4, 6] {
        let vehicle = hand_made(n);
        let (urdf, toml) = export(&vehicle).unwrap();
        let rotors = RotorFile::parse(&toml, "out.rotors.toml").unwrap();
        let import = import_text(&urdf, "out.urdf", Some(&rotors), &ImportOptions::default()).unwrap();
        assert!(import.warnings.is_empty(), "{:#?}", import.warnings);
        assert_same(&vehicle, &import.vehicle);
    }
}

#[test]
fn every_own_vehicle_survives_the_round_trip() {
    for name in ["plain_x", "hexa_frames", "pocket", "bare"] {
        let vehicle = own(&format!("{name}.urdf")).vehicle;
        let (urdf, toml) = export(&vehicle).unwrap();
        let rotors = RotorFile::parse(&toml, "out.rotors.toml").unwrap();
        assert_same(
            &vehicle,
            &import_text(&urdf, "out.urdf", Some(&rotors), &ImportOptions::default()).unwrap().vehicle,
        );
    }
}

#[test]
fn a_name_that_a_urdf_cannot_hold_is_refused_on_export() {
    let mut vehicle = hand_made(4);
    vehicle.parts[1].name = "a\u{1}b".into();
    assert!(export(&vehicle).unwrap_err().to_string().contains("cannot stand in a URDF"));
    vehicle.parts[1].name = vehicle.parts[0].name.clone();
    assert!(export(&vehicle).unwrap_err().to_string().contains("two parts are called"));
}

/// Drafts rotors for a file, and flies by them.
fn assert_drafted(path: &Path) {
    let text = std::fs::read_to_string(path).unwrap();
    let name = path.file_name().unwrap().to_string_lossy().into_owned();
    let draft = draft_rotors(&text, &name, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    println!("{}", draft.toml);
    assert!(draft.toml.contains("# assumed: ") && !draft.assumptions.is_empty(), "{name}");
    let rotors = RotorFile::parse(&draft.toml, "draft.toml").unwrap_or_else(|e| panic!("{e}\n{}", draft.toml));
    let vehicle =
        import_text(&text, &name, Some(&rotors), &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).vehicle;
    assert_eq!(vehicle.n_rotor(), if name.starts_with("hexa") { 6 } else { 4 }, "{name}");
    assert!(vehicle.thrust_to_weight() > 2.2, "{name}: {}", vehicle.thrust_to_weight());
    assert!(unbalance(&vehicle) < 1e-12, "{name}");
    assert!(vehicle.warnings().is_empty(), "{name}: {:?}", vehicle.warnings());
}

#[test]
fn a_draft_reads_back_hovers_and_marks_every_guess() {
    for name in ["plain_x", "hexa_frames", "pocket", "bare"] {
        assert_drafted(&root().join(format!("assets/urdf/{name}.urdf")));
    }
}

#[test]
fn a_file_nested_thirty_thousand_deep_is_refused_at_once_on_a_small_stack() {
    let text = format!("<robot name=\"deep\">{}", "<link>".repeat(30_000));
    assert!(text.len() > 180_000);
    let run = move || {
        let start = std::time::Instant::now();
        let error = import_text(&text, "deep.urdf", None, &ImportOptions::default()).unwrap_err();
        assert!(matches!(error, Error::Limit { .. }), "{error}");
        assert!(
            error.to_string().contains("deep.urdf: line 1: XML nesting depth is 65, over the limit of 64"),
            "{error}"
        );
        assert!(draft_rotors(&text, "deep.urdf", &ImportOptions::default()).is_err());
        assert!(start.elapsed().as_millis() < 500, "{:?}", start.elapsed()); // measured < 1 ms
    };
    std::thread::Builder::new().stack_size(2 << 20).spawn(run).unwrap().join().unwrap();
}

#[test]
fn the_deepest_allowed_file_passes_every_parser_on_a_small_stack() {
    let text = std::fs::read_to_string(root().join("assets/urdf/pocket.urdf")).unwrap();
    let deep = text.replace("</robot>", &format!("{}{}</robot>", "<gazebo>".repeat(255), "</gazebo>".repeat(255)));
    let run = move || {
        let options =
            ImportOptions { limits: InputLimits { depth: 256, ..InputLimits::default() }, ..Default::default() };
        import_text(&deep, "pocket.urdf", None, &options).unwrap();
    };
    std::thread::Builder::new().stack_size(2 << 20).spawn(run).unwrap().join().unwrap();
}

#[test]
fn files_at_the_limits_are_answered_in_seconds() {
    let text = std::fs::read_to_string(root().join("assets/urdf/pocket.urdf")).unwrap();
    let with = |inside: &str| text.replace("</robot>", &format!("{inside}</robot>"));
    let unknown: String = (0..90_000).map(|i| format!("<odd{i} a='1'/>\n{}", " ".repeat(100))).collect();
    let attributes: String = (0..255).map(|i| format!(" x{i}='0'")).collect();
    let visual = "<visual><geometry><sphere radius='0.1'/></geometry></visual>\n";
    let visuals = format!(
        "<link name='many'>{}</link><joint name='m' type='fixed'><parent link='base_link'/><child link='many'/></joint>",
        visual.repeat(30_000)
    );
    let links: String = (0..500)
        .map(|i| format!("<link name='l{i}'/><joint name='j{i}' type='fixed'><parent link='base_link'/><child link='l{i}'/></joint>\n"))
        .collect();
    let cases = [
        ("90 000 unknown elements", with(&unknown)),
        ("5 000 elements of 255 attributes", with(&format!("<gazebo{attributes}/>").repeat(5_000))),
        ("30 000 visuals", with(&visuals)),
        ("500 links behind 15 MiB of lines", with(&format!("<!--{}-->{links}", "\n".repeat(15 << 20)))),
        ("one name of 15 MiB", with(&format!("<link name='{}'/>", "n".repeat(15 << 20)))),
    ];
    for (name, text) in cases {
        let start = std::time::Instant::now();
        let result = import_text(&text, "pocket.urdf", None, &ImportOptions::default());
        println!("{name}: {} bytes, {:?}, accepted: {}", text.len(), start.elapsed(), result.is_ok());
        assert!(start.elapsed().as_secs() < 5, "{name}: {:?}", start.elapsed());
        assert!(result.is_err() || result.is_ok_and(|import| import.warnings.len() < 80), "{name}");
    }
}

#[test]
fn a_file_over_the_size_limit_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.urdf");
    std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
    let error = import_file(&path, &ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("huge.urdf is 1099511627776 bytes, over the limit of 16777216 bytes"), "{error}");
    assert!(import_file(folder.path(), &ImportOptions::default()).unwrap_err().to_string().contains("regular file"));
    assert!(matches!(import_file(folder.path().join("none.urdf"), &ImportOptions::default()), Err(Error::File { .. })));
}

#[test]
fn the_rotor_file_beside_the_urdf_is_found_and_a_named_one_wins() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["plain_x.urdf", "plain_x.rotors.toml"] {
        std::fs::copy(root().join("assets/urdf").join(name), at(name)).unwrap();
    }
    let beside = import_file(at("plain_x.urdf"), &ImportOptions::default()).unwrap().vehicle;
    assert_eq!(beside.rotors[0].max_speed, 830.0);
    let other = std::fs::read_to_string(at("plain_x.rotors.toml")).unwrap().replace("830", "900");
    std::fs::write(at("other.toml"), other).unwrap();
    let options = ImportOptions { rotors: Some(at("other.toml")), ..Default::default() };
    assert_eq!(import_file(at("plain_x.urdf"), &options).unwrap().vehicle.rotors[0].max_speed, 900.0);
}

/// Files of other projects, which are not in this repository.
mod by_others {
    use super::*;

    fn folder() -> PathBuf {
        let folder =
            std::env::var_os("OMNIDRONES_URDF_DIR").map_or_else(|| root().join("../shared/data/urdf"), PathBuf::from);
        assert!(folder.is_dir(), "no folder {}: name one in OMNIDRONES_URDF_DIR", folder.display());
        folder
    }

    fn read(path: &Path) -> Import {
        let options = ImportOptions { rotors: Some(root().join("assets/rotors")), ..Default::default() };
        import_file(path, &options).unwrap_or_else(|e| panic!("{e}"))
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn all_seven_files_import_with_their_mass_rotors_and_enough_thrust_to_hover() {
        // mass kg, hub of rotor 0 m, thrust to weight
        let table: [(&str, f64, [f64; 3], f64); 7] = [
            ("cf2x", 0.027, [0.028, -0.028, 0.0], 2.25),
            ("cf2p", 0.027, [0.0397, 0.0, 0.0], 2.25),
            ("racer", 0.830, [0.085, 0.0675, 0.0], 4.17),
            ("aerialgym_quad", 0.25, [0.13, -0.13, 0.0], 3.2620),
            ("hector_quadrotor", 1.477, [0.1525, 0.0, 0.0], 2.0705),
            ("iris", 1.535, [0.13, -0.22, 0.023], 1.8771),
            ("x500", 1.656, [0.174, -0.174, 0.0], 2.1048),
        ];
        for (name, mass, hub, thrust_to_weight) in table {
            let import = read(&folder().join(format!("{name}.urdf")));
            let vehicle = &import.vehicle;
            for line in import.warnings.iter().map(ToString::to_string).chain(import.assumptions.iter().cloned()) {
                assert!(!line.contains('\n'), "{name}: {line}");
                println!("{line}");
            }
            assert!(vehicle.warnings().is_empty(), "{name}: {:?}", vehicle.warnings());
            assert_eq!(vehicle.name, name);
            assert_eq!(vehicle.n_rotor(), 4, "{name}");
            assert!(
                (vehicle.mass_properties().mass - mass).abs() < 1e-12,
                "{name}: {}",
                vehicle.mass_properties().mass
            );
            assert_eq!(vehicle.rotors[0].position, hub, "{name}");
            assert!(
                (vehicle.thrust_to_weight() - thrust_to_weight).abs() < 1e-3,
                "{name}: {}",
                vehicle.thrust_to_weight()
            );
            assert!(vehicle.thrust_to_weight() > 1.2, "{name}");
            assert!(unbalance(vehicle) < 1e-12, "{name}: spins do not cancel");
            assert!(vehicle.rotors.iter().all(|r| r.axis == [0.0, 0.0, 1.0]), "{name}");
            let (again, toml) = export(vehicle).unwrap();
            let rotors = RotorFile::parse(&toml, "again.rotors.toml").unwrap();
            let back = import_text(&again, "again.urdf", Some(&rotors), &ImportOptions::default()).unwrap().vehicle;
            assert_same(vehicle, &back);
        }
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn the_crazyflie_properties_give_the_constants_of_its_simulator_in_radians_per_second() {
        let import = read(&folder().join("cf2x.urdf"));
        let rotor = &import.vehicle.rotors[0];
        let per_rpm = 60.0 / std::f64::consts::TAU;
        assert!((rotor.thrust_coefficient / (3.16e-10 * per_rpm * per_rpm) - 1.0).abs() < 1e-14);
        assert!((rotor.moment_per_thrust - 7.94e-12 / 3.16e-10).abs() < 1e-15);
        // gym-pybullet-drones prints 21 702.6 rev/min with g = 9.8; ours is 9.81.
        let rpm = rotor.max_speed * per_rpm;
        assert!((rpm / 21_702.64 - (9.81f64 / 9.8).sqrt()).abs() < 1e-6, "{rpm}");
        assert_eq!(import.vehicle.rotors.iter().map(|r| r.spin).collect::<Vec<_>>(), [1.0, -1.0, 1.0, -1.0]);
        let said = import.assumptions.join(" ");
        for words in ["<inertial><origin>", "time constant", "0.0555", "(rev/min)²"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        let warned = import.warnings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
        assert!(warned.contains("2π") & warned.contains("5 links without mass"), "{warned}");
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn the_racer_says_what_is_odd_in_its_numbers() {
        let import = read(&folder().join("racer.urdf"));
        let said = import.assumptions.join(" ");
        for words in ["diameter", "propeller radii", "one moment of inertia"] {
            assert!(said.contains(words), "{words}: {said}");
        }
        assert_eq!(import.vehicle.rotors[0].radius, 0.0635);
        assert_eq!(import.vehicle.rotors[0].spin, -1.0);
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn unknown_attributes_are_warned_about_once_per_kind_with_their_count() {
        let warnings = read(&folder().join("aerialgym_quad.urdf")).warnings;
        let of = |element: &str| warnings.iter().filter(|w| w.element == element).collect::<Vec<_>>();
        assert_eq!(of("<inertia iyx>").len(), 1);
        assert!(of("<inertia iyx>")[0].rule.contains("9 times"), "{}", of("<inertia iyx>")[0]);
        assert!(of("<joint dont_collapse>")[0].rule.contains("8 times"));
        assert!(warnings.iter().any(|w| w.rule.contains("4 links with mass but no inertia")));
        assert!(warnings.len() <= 8, "{warnings:#?}");
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn a_draft_takes_the_motors_and_not_the_arms_that_carry_them() {
        let text = std::fs::read_to_string(folder().join("aerialgym_quad.urdf")).unwrap();
        let draft = draft_rotors(&text, "aerialgym_quad.urdf", &ImportOptions::default()).unwrap();
        let rotors = RotorFile::parse(&draft.toml, "draft.toml").unwrap();
        let links: Vec<_> = rotors.rotors.iter().filter_map(|r| r.link.as_deref()).collect();
        assert_eq!(links, ["motor_0", "motor_1", "motor_2", "motor_3"]);
    }

    #[test]
    #[ignore = "cargo test --test dynamics -- --ignored by_others: needs seven files of others in OMNIDRONES_URDF_DIR"]
    fn a_draft_reads_back_hovers_and_marks_every_guess() {
        for name in ["iris", "x500", "aerialgym_quad", "hector_quadrotor", "cf2x"] {
            assert_drafted(&folder().join(format!("{name}.urdf")));
        }
    }
}
