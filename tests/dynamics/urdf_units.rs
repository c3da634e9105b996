//! Files in grams, millimetres and other units, and models that lie on their side: told by an import, whatever the rotors come from.

use omnidrones::dynamics::urdf::{Import, ImportOptions, RotorFile, draft_rotors, import_text};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

/// A quadrotor whose numbers are given in units of these sizes, SI; its rotors push along z turned by `rpy`.
struct File {
    mass: f64,
    length: f64,
    moment: f64,
    rpy: [f64; 3],
    base: [f64; 3],
}

const SOUND: File = File { mass: 1.0, length: 1.0, moment: 1.0, rpy: [0.0; 3], base: [0.0; 3] };

impl File {
    fn urdf(&self) -> String {
        let Self { mass, length, moment, rpy: [r, p, y], base } = self;
        let mut text = format!(
            "<robot name='r'><link name='foot'/><joint name='stand' type='fixed'>\
             <origin rpy='{} {} {}'/><parent link='foot'/><child link='body'/></joint>\n\
             <link name='body'><inertial><mass value='{}'/>\
             <inertia ixx='{}' ixy='0' ixz='0' iyy='{}' iyz='0' izz='{}'/></inertial></link>\n",
            base[0],
            base[1],
            base[2],
            0.9 / mass,
            0.006 / moment,
            0.006 / moment,
            0.011 / moment
        );
        for (k, (x, side)) in [(0.16, -0.16), (0.16, 0.16), (-0.16, 0.16), (-0.16, -0.16)].into_iter().enumerate() {
            let turn = nalgebra::Rotation3::from_euler_angles(*r, *p, *y);
            let at = turn * nalgebra::Vector3::new(x, side, 0.02) / *length;
            let _ = writeln!(
                text,
                "<link name='rotor_{k}'/><joint name='j{k}' type='fixed'><origin xyz='{} {} {}' rpy='{r} {p} {y}'/>\
                 <parent link='body'/><child link='rotor_{k}'/></joint>",
                at.x, at.y, at.z
            );
        }
        text + "</robot>"
    }

    /// With rotors that were drafted from the same numbers.
    fn drafted(&self) -> Import {
        let text = self.urdf();
        let options = ImportOptions::default();
        let draft = draft_rotors(&text, "v.urdf", &options).unwrap_or_else(|e| panic!("{e}"));
        let rotors = RotorFile::parse(&draft.toml, "v.rotors.toml").unwrap();
        import_text(&text, "v.urdf", Some(&rotors), &options).unwrap_or_else(|e| panic!("{e}"))
    }

    /// What is told of the vehicle as a whole, which has no line.
    fn told(&self) -> Vec<String> {
        let warnings = self.drafted().warnings;
        warnings.iter().filter(|w| w.line.is_none()).map(ToString::to_string).collect()
    }
}

#[test]
fn an_import_tells_units_beside_rotors_that_were_drafted_from_the_same_numbers() {
    let sound = SOUND.told();
    assert!(sound.is_empty(), "{sound:?}");
    let all = [
        (File { mass: 1e-3, ..SOUND }, "v.urdf: mass: 900 kg on arms of 0.226 m make 77700 kg/m³", "as grams, 0.9 kg"),
        (
            File { length: 1e-3, ..SOUND },
            "v.urdf: lengths: 0.9 kg on arms of 226 m make",
            "as millimetres, arms of 0.226 m",
        ),
        (
            File { length: 1e-2, ..SOUND },
            "v.urdf: lengths: 0.9 kg on arms of 22.6 m make",
            "as centimetres, arms of 0.226 m",
        ),
        (
            File { moment: 1e-3, ..SOUND },
            "v.urdf: inertia: 7.67 kg m² (mean of the axes) of 0.9 kg",
            "as g m², 0.00767 kg m²",
        ),
        (File { moment: 1e-6, ..SOUND }, "v.urdf: inertia: 7670 kg m²", "as kg mm², 0.00767 kg m²"),
        (
            File { moment: 1e3, ..SOUND },
            "v.urdf: inertia: 7.67e-6 kg m²",
            "1000 times it, 0.00767 kg m², would be usual",
        ),
    ];
    for (file, rule, reading) in all {
        let told = file.told();
        assert!(told.len() == 1 && told[0].starts_with(rule) && told[0].contains(reading), "{rule}: {told:#?}");
    }
}

#[test]
fn an_import_tells_an_inertia_that_nobody_gave() {
    let ones = SOUND.urdf().replace("ixx='0.006'", "ixx='1'").replace("iyy='0.006'", "iyy='1'").replace("0.011", "1");
    let options = ImportOptions::default();
    let rotors = RotorFile::parse(&draft_rotors(&ones, "v.urdf", &options).unwrap().toml, "v.rotors.toml").unwrap();
    let told = import_text(&ones, "v.urdf", Some(&rotors), &options).unwrap().warnings[0].to_string();
    let rule =
        "v.urdf: inertia: part 'body' has 1 kg m² about every axis, which programs write where nobody gave an inertia.";
    assert!(told.starts_with(rule) && told.contains("0.9 kg on arms of 0.226 m have about 0.0154 kg m²"), "{told}");
}

#[test]
fn a_model_that_lies_on_its_side_is_told_how_to_stand_up_and_stands_by_that() {
    for (rpy, along) in [
        ([-FRAC_PI_2, 0.0, 0.0], "along y "),
        ([FRAC_PI_2, 0.0, 0.0], "along −y "),
        ([0.0, FRAC_PI_2, 0.0], "along x "),
        ([0.0, -FRAC_PI_2, 0.0], "along −x "),
        ([2.0 * FRAC_PI_2, 0.0, 0.0], "along −z "),
    ] {
        let lying = File { rpy, ..SOUND };
        let told = lying.told();
        assert!(told.len() == 1 && told[0].contains(along), "{told:?}");
        let angles: Vec<f64> =
            told[0].split('"').nth(1).unwrap().split(' ').map(|word| word.parse().unwrap()).collect();
        let stood = File { base: angles.clone().try_into().unwrap(), ..lying };
        let import = stood.drafted();
        assert!(import.warnings.iter().all(|w| w.line.is_some()), "{:?}", import.warnings);
        // roundings of two turns alone
        assert!(import.vehicle.rotors.iter().all(|r| (r.axis[2] - 1.0).abs() < 1e-12), "{:?}", import.vehicle.rotors);
        assert_eq!(import.vehicle.rotors.iter().map(|r| r.spin).sum::<f64>(), 0.0);
        // rounded to four digits, or by a tenth of a degree: nothing to tell
        for wrong in [3.7e-6, 1e-3, 1.7e-3] {
            let base = [angles[0] + wrong, angles[1], angles[2]];
            let told = File { base, rpy, ..SOUND }.told();
            assert!(told.is_empty(), "{told:?}");
        }
    }
}

#[test]
fn drafted_spins_of_a_ring_of_pairs_cancel_and_what_does_not_cancel_is_counted() {
    let hexa = |n: usize, high: usize, noise: f64| {
        let mut text = String::from(
            "<robot name='r'><link name='body'><inertial><mass value='3'/>\
             <inertia ixx='0.05' ixy='0' ixz='0' iyy='0.05' iyz='0' izz='0.09'/></inertial></link>",
        );
        for k in 0..n * high {
            let angle = std::f64::consts::TAU * (k % n) as f64 / n as f64;
            let off = noise * (1.3 * k as f64).sin();
            let _ = write!(
                text,
                "<link name='rotor_{k}'/><joint name='j{k}' type='fixed'><origin xyz='{} {} {}'/><parent link='body'/>\
                 <child link='rotor_{k}'/></joint>",
                0.4 * angle.cos() + off,
                0.4 * angle.sin() - off,
                -0.1 * (k / n) as f64
            );
        }
        draft_rotors(&(text + "</robot>"), "v.urdf", &ImportOptions::default()).unwrap()
    };
    for n in [4, 6, 8] {
        for noise in [0.0, 1e-17, 1e-12, 4e-7] {
            let draft = hexa(n, 2, noise);
            let rotors = RotorFile::parse(&draft.toml, "v.rotors.toml").unwrap().rotors;
            let spin = |k: usize| rotors[k].spin.unwrap();
            assert!((0..n).all(|k| spin(k) == -spin(k + n) && spin(k) == -spin((k + 1) % n)), "{n}, {noise}");
            assert!(!draft.assumptions.iter().any(|a| a.contains("do not cancel")), "{:?}", draft.assumptions);
        }
    }
    let said = "The spins do not cancel: 2 of 5 rotors turn counter-clockwise and 3 clockwise, so that equal thrusts turn the \
                vehicle.";
    assert!(hexa(5, 1, 0.0).assumptions.iter().any(|a| a == said));
}
