//! The physics of a vehicle as one vector of numbers.

use crate::dynamics::vehicle::{GRAVITY, Vehicle};

/// Physical parameters of one rotor in the parameter vector, in order.
pub const ROTOR_PARAMETERS: [&str; 16] = [
    "position_x",
    "position_y",
    "position_z",
    "axis_x",
    "axis_y",
    "axis_z",
    "spin",
    "thrust_coefficient",
    "moment_per_thrust",
    "max_speed",
    "time_constant_up",
    "time_constant_down",
    "inertia",
    "drag_coefficient",
    "axial_drag_coefficient",
    "rolling_coefficient",
];

/// Physical parameters of the airframe in the parameter vector, in order; the rotors' follow.
pub const BODY_PARAMETERS: [&str; 20] = [
    "gravity",
    "mass",
    "center_of_mass_x",
    "center_of_mass_y",
    "center_of_mass_z",
    "inertia_xx",
    "inertia_yy",
    "inertia_zz",
    "inertia_xy",
    "inertia_xz",
    "inertia_yz",
    "linear_drag_x",
    "linear_drag_y",
    "linear_drag_z",
    "quadratic_drag_x",
    "quadratic_drag_y",
    "quadratic_drag_z",
    "angular_drag_x",
    "angular_drag_y",
    "angular_drag_z",
];

/// Physical parameters of a vehicle as one vector, [`BODY_PARAMETERS`] then [`ROTOR_PARAMETERS`] per rotor: what
/// derivatives with respect to physics are taken of, and what randomisation scales.
pub fn parameter_vector(vehicle: &Vehicle) -> Vec<f64> {
    let total = vehicle.mass_properties();
    let (c, j) = (total.center_of_mass, total.inertia);
    let drag = &vehicle.drag;
    let mut p = vec![GRAVITY, total.mass, c.x, c.y, c.z];
    p.extend([j[(0, 0)], j[(1, 1)], j[(2, 2)], j[(0, 1)], j[(0, 2)], j[(1, 2)]]);
    p.extend(drag.linear.iter().chain(&drag.quadratic).chain(&drag.angular));
    for r in &vehicle.rotors {
        p.extend(r.position.iter().chain(&r.axis));
        p.extend([r.spin, r.thrust_coefficient, r.moment_per_thrust, r.max_speed]);
        p.extend([r.time_constant_up, r.time_constant_down, r.inertia]);
        p.extend([r.drag_coefficient, r.axial_drag_coefficient, r.rolling_coefficient]);
    }
    p
}

/// Names of the entries of [`parameter_vector`].
pub fn parameter_names(vehicle: &Vehicle) -> Vec<String> {
    let body = BODY_PARAMETERS.iter().map(|n| n.to_string());
    let rotors = vehicle.rotors.iter().flat_map(|r| ROTOR_PARAMETERS.iter().map(|n| format!("{}.{n}", r.name)));
    body.chain(rotors).collect()
}
