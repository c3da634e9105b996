//! Contract: two independent engines give the same accelerations, MuJoCo and Pinocchio.
//!
//! `tests/witnesses/golden` holds random states of every model with both engines' answers, made by
//! `tests/witnesses/make.py`, which says how. Two gaps are bounded:
//!
//! - in accelerations, relative to the largest of the state: 1e-12, or κ ε where that is more, with κ the condition of the
//!   mass matrix, by which any rounding of the state or on the way grows. Thin bars that turn about their own axis beside
//!   drones at a metre reach κ = 1e6, where MuJoCo and Pinocchio differ by up to 3e-11 from each other: the two-drone
//!   platform, transport and Dragon, and the Crazyflie with a load. Measured 0.28 of this on the golden files, 0.54 live.
//! - in forces, M (a − b) relative to the largest Σ |M| |b|: 1e-12 everywhere; measured 1.9e-14 on the golden files, 1.8e-13 live.

use super::common::*;
use super::models;
use crate::common::measure::larger;
use nalgebra::{DMatrix, DVector};
use omnidrones::dynamics::tree::{Model, Motion, mass_matrix};
use std::path::{Path, PathBuf};
use std::process::Command;

const REMEDY: &str = "cargo test --test dynamics -- --ignored export_models && \
    python tests/witnesses/make.py target/tmp/models tests/witnesses/golden";
const BOUND: f64 = 1e-12;

/// Largest gaps over the states of a file.
#[derive(Clone, Copy, Default)]
struct Gaps {
    acceleration: f64,
    /// Over what the condition of the mass matrix allows.
    share: f64,
    force: f64,
}

impl Gaps {
    fn take(&mut self, mass: &DMatrix<f64>, ours: &[f64], wanted: &[f64]) {
        let values = mass.clone().symmetric_eigenvalues();
        let allowed = (f64::EPSILON * values.max() / values.min()).max(BOUND);
        let acceleration = gap(ours, wanted);
        let apart = mass * (DVector::from_column_slice(ours) - DVector::from_column_slice(wanted));
        let force = apart.amax() / (mass.abs() * DVector::from_column_slice(wanted).abs()).amax();
        self.acceleration = larger(self.acceleration, acceleration);
        self.share = larger(self.share, acceleration / allowed);
        self.force = larger(self.force, force);
    }

    #[track_caller]
    fn hold(&self, what: &str) {
        at_most(&format!("{what} (gap {:.1e}), share of what is allowed", self.acceleration), self.share, 1.0);
        at_most(&format!("{what}, in forces"), self.force, BOUND);
    }
}

/// States with accelerations by MuJoCo and by Pinocchio.
struct Golden {
    physics: Vec<f64>,
    n_state: usize,
    n_velocity: usize,
    rows: Vec<Vec<f64>>,
}

impl Golden {
    fn read(path: &Path) -> Option<Self> {
        let bytes = std::fs::read(path).ok()?;
        assert_eq!(&bytes[..8], b"OMNITREE", "{}", path.display());
        let size = |k: usize| u32::from_le_bytes(bytes[8 + 4 * k..12 + 4 * k].try_into().unwrap()) as usize;
        let (n_physics, n_state, n_velocity, n_row) = (size(0), size(1), size(2), size(3));
        let numbers: Vec<f64> = bytes[24..].as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let width = n_state + 2 * n_velocity;
        assert_eq!(numbers.len(), n_physics + n_row * width, "{}", path.display());
        let rows = numbers[n_physics..].chunks_exact(width).map(<[f64]>::to_vec).collect();
        Some(Self { physics: numbers[..n_physics].to_vec(), n_state, n_velocity, rows })
    }

    /// Largest gaps against MuJoCo and against Pinocchio.
    fn gaps(&self, model: &Model) -> [Gaps; 2] {
        let system = bare(model);
        assert_eq!((system.layout().n_state(), system.layout().n_velocity()), (self.n_state, self.n_velocity));
        let mut worst = [Gaps::default(); 2];
        for row in &self.rows {
            let (x, answers) = row.split_at(self.n_state);
            let ours = accelerations(&system, &derivative(&system, x));
            let mass = mass_matrix(system.model(), x).unwrap();
            for (k, wanted) in answers.chunks_exact(self.n_velocity).enumerate() {
                worst[k].take(&mass, &ours, wanted);
            }
        }
        worst
    }
}

/// The numbers that accelerations depend on, in the order of `Model.physics` in `tests/witnesses/engines.py`.
fn physics(model: &Model) -> Vec<f64> {
    let mut out = vec![model.parts().gravity];
    for b in model.bodies() {
        let (kind, axis) = match b.joint.motion {
            Motion::Floating => (0.0, [0.0; 3]),
            Motion::Revolute(axis) => (1.0, axis),
            Motion::Prismatic(axis) => (2.0, axis),
            Motion::Ball => (3.0, [0.0; 3]),
        };
        let (i, j) = (&b.inertia, &b.joint);
        out.extend([b.parent.map_or(-1.0, |p| p as f64), kind]);
        out.extend(axis.iter().chain(&j.position).chain(j.rotation.as_flattened()));
        out.extend([j.damping, j.stiffness, j.rest, j.armature, b.mass]);
        out.extend(b.center_of_mass);
        out.extend([i.xx, i.yy, i.zz, i.xy, i.xz, i.yz]);
    }
    for mounted in model.rotors() {
        let r = &mounted.rotor;
        out.push(mounted.body as f64);
        out.extend(r.position.iter().chain(&r.axis));
        out.extend([r.spin, r.thrust_coefficient, r.moment_per_thrust, r.max_speed]);
    }
    out
}

/// Whether a golden was made for this model; libraries of other machines may round its numbers differently.
fn is_of(golden: &Golden, model: &Model) -> bool {
    let now = physics(model);
    now.len() == golden.physics.len()
        && now.iter().zip(&golden.physics).all(|(a, b)| (a - b).abs() <= 1e-14 * b.abs().max(1.0))
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn accelerations_are_those_of_mujoco_and_pinocchio_for_every_model() {
    let folder = root().join("tests/witnesses/golden");
    for model in models::all() {
        let name = model.name();
        let golden = Golden::read(&folder.join(format!("{name}.bin")));
        let golden = golden.unwrap_or_else(|| panic!("'{name}' has no golden file: {REMEDY}"));
        assert!(is_of(&golden, &model), "'{name}' has changed since its golden file was made: {REMEDY}");
        assert!(golden.rows.len() >= 100, "'{name}' has {} states", golden.rows.len());
        let [mujoco, pinocchio] = golden.gaps(&model);
        mujoco.hold(&format!("{name}: against MuJoCo"));
        pinocchio.hold(&format!("{name}: against Pinocchio"));
    }
}

#[test]
fn golden_files_are_of_models_that_exist_and_small() {
    let names: Vec<String> = models::all().iter().map(|m| format!("{}.bin", m.name())).collect();
    let mut total = 0;
    for entry in std::fs::read_dir(root().join("tests/witnesses/golden")).unwrap() {
        let entry = entry.unwrap();
        total += entry.metadata().unwrap().len();
        let file = entry.file_name().into_string().unwrap();
        assert!(file == "provenance.json" || names.contains(&file), "{file} belongs to no model: delete it");
    }
    assert!(total <= 2_000_000, "{total} bytes");
}

#[test]
fn a_wrong_sign_a_lost_bias_or_a_tilted_axis_would_show() {
    let folder = root().join("tests/witnesses/golden");
    let golden = Golden::read(&folder.join("every_joint.bin")).expect(REMEDY);
    let model = models::all().into_iter().find(|m| m.name() == "every_joint").unwrap();
    let twin = |change: &dyn Fn(&mut omnidrones::dynamics::tree::ModelParts)| {
        let mut parts = model.parts().clone();
        change(&mut parts);
        let [mujoco, pinocchio] = golden.gaps(&Model::new(parts).unwrap());
        mujoco.acceleration.min(pinocchio.acceleration)
    };
    assert!(twin(&|_| ()) <= BOUND);
    let flipped = twin(&|p| p.rotors[0].rotor.spin = -p.rotors[0].rotor.spin);
    let tilted = twin(&|p| p.bodies[4].joint.motion = Motion::Revolute([(1.0 - 1e-12_f64).sqrt(), 1e-6, 0.0]));
    let heavier = twin(&|p| p.bodies[6].mass *= 1.0 + 1e-6);
    let undamped = twin(&|p| p.bodies[2].joint.damping = 0.0);
    for (what, defect) in [("spin", flipped), ("axis", tilted), ("mass", heavier), ("damping", undamped)] {
        assert!(defect > 1e-8, "{what}: {defect:.3e}");
    }
}

fn write_models(folder: &Path, models: &[Model]) {
    std::fs::create_dir_all(folder).unwrap();
    for entry in std::fs::read_dir(folder).unwrap() {
        std::fs::remove_file(entry.unwrap().path()).unwrap();
    }
    for model in models {
        let text = serde_json::to_string_pretty(model.parts()).unwrap();
        std::fs::write(folder.join(format!("{}.json", model.name())), text).unwrap();
    }
}

/// Writes what the scripts read.
#[test]
#[ignore = "cargo test --test dynamics -- --ignored export_models: for tests/witnesses/make.py and crates/bench/benches/mujoco_steps.py"]
fn export_models() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("models");
    write_models(&folder, &models::all());
    println!("{}", folder.display());
}

/// `OMNIDRONES_PYTHON` or `python3`, with both engines.
fn python() -> String {
    let name = std::env::var("OMNIDRONES_PYTHON").unwrap_or_else(|_| "python3".into());
    let probe = Command::new(&name).args(["-c", "import mujoco, pinocchio"]).output();
    let has_both = probe.is_ok_and(|p| p.status.success());
    assert!(has_both, "no mujoco and pin in {name}: pip install mujoco pin, or name a Python in OMNIDRONES_PYTHON");
    name
}

/// 2 000 fresh states per model and per pair of configuration and vehicle.
#[test]
#[ignore = "cargo test --test dynamics -- --ignored engines_beside_us: needs a python3, or OMNIDRONES_PYTHON, with mujoco and pin"]
fn accelerations_are_those_of_the_engines_beside_us() {
    let python = python();
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let seed = std::env::var("OMNIDRONES_SEED").unwrap_or_else(|_| now.as_secs().to_string());
    let base: PathBuf = Path::new(env!("CARGO_TARGET_TMPDIR")).join("live");
    let (folder, out) = (base.join("models"), base.join("answers"));
    let models = [models::all(), models::combined()].concat();
    write_models(&folder, &models);
    let script = root().join("tests/witnesses/make.py");
    let mut command = Command::new(python);
    let made = command.arg(script).args([&folder, &out]).args(["--states", "2000", "--seed", &seed]).output().unwrap();
    let text = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "OMNIDRONES_SEED={seed}\n{}{text}", String::from_utf8_lossy(&made.stdout));
    for model in &models {
        let live = Golden::read(&out.join(format!("{}.bin", model.name()))).unwrap();
        let [mujoco, pinocchio] = live.gaps(model);
        let what = format!("{}, OMNIDRONES_SEED={seed}, live", model.name());
        mujoco.hold(&format!("{what}: against MuJoCo"));
        pinocchio.hold(&format!("{what}: against Pinocchio"));
    }
}
