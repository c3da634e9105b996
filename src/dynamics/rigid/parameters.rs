//! The physics of a vehicle as one vector of numbers.

use crate::dynamics::vehicle::{GRAVITY, Inertia, Part, Vehicle};
use crate::error::{Error, Result};

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

/// The vehicle that a [`parameter_vector`] describes, as one part; names and whatever the vector leaves out are those of
/// `vehicle`. Gravity is [`GRAVITY`], whatever the vector says.
///
/// # Errors
/// [`Error::Value`] for another length; as [`Vehicle::validate`] for numbers that are no vehicle.
pub fn vehicle_of(vehicle: &Vehicle, parameters: &[f64]) -> Result<Vehicle> {
    let wanted = BODY_PARAMETERS.len() + ROTOR_PARAMETERS.len() * vehicle.n_rotor();
    if parameters.len() != wanted {
        let what = format!("vehicle '{}': number of parameters", vehicle.name);
        return Err(Error::value(what, parameters.len(), wanted.to_string(), "Take them from parameter_vector."));
    }
    let (body, rotors) = parameters.split_at(BODY_PARAMETERS.len());
    let three = |first: usize| [body[first], body[first + 1], body[first + 2]];
    let inertia = Inertia { xx: body[5], yy: body[6], zz: body[7], xy: body[8], xz: body[9], yz: body[10] };
    let mut own = vehicle.clone();
    own.parts = vec![Part::new("body", body[1], three(2), inertia)];
    (own.drag.linear, own.drag.quadratic, own.drag.angular) = (three(11), three(14), three(17));
    for (rotor, p) in own.rotors.iter_mut().zip(rotors.chunks_exact(ROTOR_PARAMETERS.len())) {
        (rotor.position, rotor.axis) = ([p[0], p[1], p[2]], [p[3], p[4], p[5]]);
        (rotor.spin, rotor.thrust_coefficient, rotor.moment_per_thrust, rotor.max_speed) = (p[6], p[7], p[8], p[9]);
        (rotor.time_constant_up, rotor.time_constant_down, rotor.inertia) = (p[10], p[11], p[12]);
        (rotor.drag_coefficient, rotor.axial_drag_coefficient, rotor.rolling_coefficient) = (p[13], p[14], p[15]);
    }
    own.validate()?;
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::vehicles;

    #[test]
    fn a_vehicle_of_other_numbers_has_those_numbers() {
        for name in vehicles::names() {
            let vehicle = vehicles::by_name(name).unwrap();
            let mut wanted = parameter_vector(&vehicle);
            wanted[1] *= 1.3;
            wanted[4] += 0.01;
            let thrust = BODY_PARAMETERS.len() + 7;
            wanted[thrust] *= 0.9;
            let own = vehicle_of(&vehicle, &wanted).unwrap();
            let off = parameter_vector(&own).iter().zip(&wanted).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(off < 1e-12, "{name}: {off:e}");
            assert!(vehicle_of(&vehicle, &wanted[1..]).is_err());
        }
    }
}
