//! From the frames of flight controllers: north, east, down; forward, right, down.

use super::golden::{Golden, GoldenArray, GoldenKind};
use super::module::{Cost, ModuleBuilder};
use super::plant::wave;
use autodiff::emit::ExportPrecision;
use nalgebra::{UnitQuaternion, Vector3};
use std::fmt::Write;

/// Adds `NAME_state_from_ned`, where the state begins with the motion of one body.
pub(crate) fn add_state_from_ned(module: &mut ModuleBuilder, n_state: usize) {
    let real = module.real();
    let parameters = format!(
        "const {real} position[3], const {real} velocity[3], const {real} attitude[4], const {real} rates[3], {real} state[{n_state}]"
    );
    let body = "    state[0] = position[0];
    state[1] = -position[1];
    state[2] = -position[2];
    state[3] = velocity[0];
    state[4] = -velocity[1];
    state[5] = -velocity[2];
    state[6] = attitude[0];
    state[7] = attitude[1];
    state[8] = -attitude[2];
    state[9] = -attitude[3];
    state[10] = rates[0];
    state[11] = -rates[1];
    state[12] = -rates[2];
";
    let about = "Writes the first 13 numbers of a state from position (m) and velocity (m/s) north, east, down, the attitude \
        w, x, y, z from forward, right, down to north, east, down, and body rates (rad/s) forward, right, down. The world's x is \
        north then, its y west. Rotor speeds, and what else the state holds, are left.";
    module.composed("state_from_ned", about, &parameters, body, Cost::LITTLE);
    module.golden(golden_state(module.name(), n_state));
}

/// Adds `NAME_target_from_ned`, for targets of one setpoint.
pub(crate) fn add_target_from_ned(module: &mut ModuleBuilder, n_target: usize) {
    let real = module.real();
    let parameters = format!(
        "const {real} position[3], const {real} velocity[3], const {real} acceleration[3], {real} yaw, {real} yaw_rate, {real} target[{n_target}]"
    );
    let zero = if module.text.precision() == ExportPrecision::Double { "0.0" } else { "0.0f" };
    let mut body = String::new();
    for (block, name) in ["position", "velocity", "acceleration"].into_iter().enumerate() {
        for (k, sign) in ["", "-", "-"].into_iter().enumerate() {
            body += &format!("    target[{}] = {sign}{name}[{k}];\n", 3 * block + k);
        }
    }
    for k in (9..n_target).filter(|k| ![15, 16].contains(k)) {
        body += &format!("    target[{k}] = {zero};\n");
    }
    body += "    target[15] = -yaw;\n    target[16] = -yaw_rate;\n";
    let about = "Writes a target from position (m), velocity (m/s) and acceleration (m/s^2) north, east, down, and yaw (rad) and \
        its rate clockwise from north. Jerk, snap and the yaw's acceleration are zero.";
    module.composed("target_from_ned", about, &parameters, &body, Cost::LITTLE);
    module.golden(golden_target(module.name(), n_target));
}

/// Adds `NAME_aim`, of a task that wants a point of its own to be held.
pub(crate) fn add_aim(module: &mut ModuleBuilder, target: [f64; 3], n_state: usize) {
    let real = module.real();
    let parameters = format!("const {real} setpoint[3], const {real} state[{n_state}], {real} seen[{n_state}]");
    let mut body = format!("    for (int k = 3; k < {n_state}; k++) seen[k] = state[k];\n");
    for (k, x) in target.iter().enumerate() {
        let _ = writeln!(body, "    seen[{k}] = state[{k}] - setpoint[{k}] + ({});", module.number(*x));
    }
    let about = format!(
        "Writes the state that is seen where a setpoint (m, world) stands in the place of the task's target, ({}, {}, {}) m: for \
        policies that hold it.",
        target[0], target[1], target[2]
    );
    module.composed("aim", &about, &parameters, &body, Cost::LITTLE);
    let array = |name: &str, n, kind| GoldenArray::new(name, n, kind);
    let arrays = vec![
        array("setpoint", 3, GoldenKind::Read),
        array("state", n_state, GoldenKind::Read),
        array("seen", n_state, GoldenKind::Write(n_state)),
    ];
    let mut golden = Golden::new(format!("{}_aim", module.name()), false, arrays);
    for row in 0..ROWS {
        let (setpoint, state) = (waves(row, 3, 5.0), waves(row + 9, n_state, 3.0));
        let seen = (0..n_state).map(|k| if k < 3 { state[k] + (target[k] - setpoint[k]) } else { state[k] });
        golden.rows.push([&setpoint[..], &state, &seen.collect::<Vec<_>>()].concat());
    }
    module.golden(golden);
}

/// Rows of golden vectors.
const ROWS: usize = 8;

fn waves(row: usize, n: usize, size: f64) -> Vec<f64> {
    (0..n).map(|k| size * wave(row, k)).collect()
}

/// From north, east, down, and forward, right, down, by turning both half round about the first axis.
fn turned(v: &[f64]) -> [f64; 3] {
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    (half_turn * Vector3::new(v[0], v[1], v[2])).into()
}

/// Of `NAME_state_from_ned`: rotations are those of nalgebra.
fn golden_state(name: &str, n_state: usize) -> Golden {
    let array = |name: &str, n| GoldenArray::new(name, n, GoldenKind::Read);
    let mut arrays = vec![array("position", 3), array("velocity", 3), array("attitude", 4), array("rates", 3)];
    arrays.push(GoldenArray::new("state", 13, GoldenKind::Write(n_state)));
    let mut golden = Golden::new(format!("{name}_state_from_ned"), false, arrays);
    for row in 0..ROWS {
        let [position, velocity, rates] = [0, 20, 40].map(|k| waves(row + k, 3, 4.0));
        let (roll, pitch, yaw) = (wave(row, 1), 0.7 * wave(row, 2), 3.0 * wave(row, 3));
        let attitude = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let own = half_turn * attitude * half_turn.inverse();
        let numbers = |q: &UnitQuaternion<f64>| vec![q.w, q.i, q.j, q.k];
        // of the two quaternions of a rotation that whose real part has the sign of the one given
        let own = if own.w * attitude.w < 0.0 { numbers(&own).iter().map(|x| -x).collect() } else { numbers(&own) };
        let given = [&position[..], &velocity, &numbers(&attitude), &rates].concat();
        let state = [&turned(&position)[..], &turned(&velocity), &own, &turned(&rates)].concat();
        golden.rows.push([given, state].concat());
    }
    golden
}

/// Of `NAME_target_from_ned`.
fn golden_target(name: &str, n_target: usize) -> Golden {
    let array = |name: &str, n, kind| GoldenArray::new(name, n, kind);
    let mut arrays: Vec<_> =
        ["position", "velocity", "acceleration"].map(|name| array(name, 3, GoldenKind::Read)).into();
    arrays.extend(["yaw", "yaw_rate"].map(|name| array(name, 1, GoldenKind::ReadNumber)));
    arrays.push(array("target", n_target, GoldenKind::Write(n_target)));
    let mut golden = Golden::new(format!("{name}_target_from_ned"), false, arrays);
    for row in 0..ROWS {
        let given = waves(row, 11, 3.0);
        let mut target = vec![0.0; n_target];
        for block in 0..3 {
            target[3 * block..3 * block + 3].copy_from_slice(&turned(&given[3 * block..]));
        }
        // about down here, about up there
        (target[15], target[16]) = (-given[9], -given[10]);
        golden.rows.push([given, target].concat());
    }
    golden
}
