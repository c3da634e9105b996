//! Gains of the cascade for any vehicle: the published ones, else derived from its inertia, motors and rotors.
//!
//! With e_R small and perfect motors, J ė̇ + K_ω ė + K_R e = 0, so K_R = J ω² and K_ω = 2ζ J ω give each axis the
//! bandwidth ω and damping ζ. What bounds ω:
//!
//! - **Motor lag.** ω ≤ ω_n = 1/(4τ), τ the slowest time constant of any rotor. With the lag, a loop of ζ = 1 has
//!   s³/4 + s² + 2s + 1 = 0 in units of ω_n: a real pole at −0.70 and a pair of damping 0.69, so ζ = 1 after the lag
//!   behaves as 0.7 would without; ζ = 0.7 would leave a pair of damping 0.64 closest to the axis.
//! - **Yaw** at half of that: nothing in the outer loops waits for it, and in saturation it should yield first.
//! - **Authority.** An error of `SATURATION_ANGLE` at rest should not ask for more moment M̄ than the rotors can give
//!   about that axis at hover: J ω² · angle ≤ M̄, with M̄ = Σ |B_i| min(T_h, T_max − T_h)_i, B_i the rotor's moment per
//!   thrust and T_h the even share of the weight (at least 5 % of T_max is counted). This is what slows yaw:
//!   B = κ is a tenth of an arm's length.
//!
//! The outer loop leaves the attitude loop time to follow: ω_p = ω/4, ω the slower of roll and pitch, K_p = ω_p²,
//! K_v = 2 ω_p. A motor of 25 ms so gives ω_n = 10 rad/s, K_p = 6.25, K_v = 5, close to Firefly's published 6 and 4.7.

use super::vehicle::{GRAVITY, Gains, Rotor, Vehicle};

/// Attitude error at which a derived gain asks for all of an axis's hover authority, rad.
pub const SATURATION_ANGLE: f64 = 1.0;
/// Damping ratio of the derived loops.
pub const DAMPING: f64 = 1.0;
/// Attitude bandwidth over position bandwidth.
pub const SEPARATION: f64 = 4.0;
/// Rates of integral action over attitude bandwidth.
const INTEGRAL: f64 = 0.5;

impl Vehicle {
    /// Gains that fly this vehicle: the published ones, else [`derived_gains`](Self::derived_gains).
    pub fn gains(&self) -> Gains {
        self.published_gains.unwrap_or_else(|| self.derived_gains())
    }

    /// 1/(4τ) with τ the slowest time constant of any rotor, rad/s: the fastest attitude loop its motors can carry.
    pub fn bandwidth_limit(&self) -> f64 {
        let slowest = |r: &Rotor| r.time_constant_up.max(r.time_constant_down);
        0.25 / self.rotors.iter().map(slowest).fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Gains from inertia, motor lag and authority.
    ///
    /// Attitude: K_R = J ω², K_ω = 2 J ω per axis, for the damping 1 of J ė̇ + K_ω ė + K_R e = 0. The bandwidth ω is at most
    /// [`bandwidth_limit`](Self::bandwidth_limit), half of it about yaw, and such that an error of 1 rad asks for no more moment than the
    /// rotors have to spare at hover. Position: ω_p = ω/4 of the slower of roll and pitch, K_p = ω_p², K_v = 2 ω_p.
    ///
    /// Axes are those in which it hovers level ([`Vehicle::upright`]). One about which no rotor has a moment gets zero gains: there is
    /// nothing to control it with.
    pub fn derived_gains(&self) -> Gains {
        let vehicle = self.upright();
        let total = vehicle.mass_properties();
        let limit = vehicle.bandwidth_limit();
        let authority = vehicle.hover_authority();
        let mut attitude = [0.0; 3];
        let mut rate = [0.0; 3];
        let mut bandwidth = [limit, limit, 0.5 * limit];
        for axis in 0..3 {
            let inertia = total.inertia[(axis, axis)];
            bandwidth[axis] = bandwidth[axis].min((authority[axis] / (inertia * SATURATION_ANGLE)).sqrt());
            attitude[axis] = inertia * bandwidth[axis] * bandwidth[axis];
            rate[axis] = 2.0 * DAMPING * inertia * bandwidth[axis];
        }
        let outer = bandwidth[0].min(bandwidth[1]) / SEPARATION;
        let integral = [INTEGRAL * bandwidth[0].min(bandwidth[1]); 2];
        Gains { position: [outer * outer; 3], velocity: [2.0 * DAMPING * outer; 3], attitude, rate, integral }
    }

    /// The moments the rotors can add about body x, y, z at hover, N m.
    fn hover_authority(&self) -> [f64; 3] {
        let allocation = self.allocation_matrix();
        let hover = self.mass_properties().mass * GRAVITY / self.n_rotor() as f64;
        let mut authority = [0.0; 3];
        for (i, rotor) in self.rotors.iter().enumerate() {
            let top = rotor.max_thrust();
            let margin = hover.min(top - hover).max(0.05 * top);
            for (axis, moment) in authority.iter_mut().enumerate() {
                *moment += allocation[(3 + axis, i)].abs() * margin;
            }
        }
        authority
    }
}

#[cfg(test)]
mod tests {
    use crate::vehicles;

    #[test]
    fn published_gains_are_used_where_they_exist() {
        let firefly = vehicles::by_name("firefly").unwrap().gains();
        assert_eq!(firefly.attitude, [3.0, 3.0, 0.15]);
        assert!(vehicles::by_name("crazyflie").unwrap().published_gains.is_none());
    }

    #[test]
    fn gains_of_every_vehicle_are_positive_and_within_the_bandwidth_of_its_motors() {
        for vehicle in vehicles::all() {
            let inertia = vehicle.mass_properties().inertia;
            for gains in [vehicle.gains(), vehicle.derived_gains()] {
                for axis in 0..3 {
                    let (k_r, k_w) = (gains.attitude[axis], gains.rate[axis]);
                    assert!(gains.position[axis] > 0.0 && gains.velocity[axis] > 0.0 && k_r > 0.0 && k_w > 0.0);
                    let bandwidth = (k_r / inertia[(axis, axis)]).sqrt();
                    // closest to its limit: the published hummingbird, 9.6 of 10 rad/s; crazyflie's derived ones reach it
                    let limit = vehicle.bandwidth_limit() * (1.0 + 1e-12);
                    assert!(bandwidth <= limit, "{} axis {axis}: {bandwidth} of {limit} rad/s", vehicle.name);
                    let damping = k_w / (2.0 * (k_r * inertia[(axis, axis)]).sqrt());
                    assert!(damping > 0.4, "{} axis {axis}: damping {damping}", vehicle.name);
                }
            }
        }
    }

    #[test]
    fn yaw_is_slower_than_roll_and_within_its_authority() {
        for vehicle in vehicles::all() {
            let inertia = vehicle.mass_properties().inertia;
            let gains = vehicle.derived_gains();
            let w = [0, 1, 2].map(|i| (gains.attitude[i] / inertia[(i, i)]).sqrt());
            // crazyflie (10, 10, 5), hummingbird (8.9, 8.9, 2.9), omav (9.3, 8.5, 1.5) rad/s
            assert!(w[2] <= 0.5 * w[0].min(w[1]) * (1.0 + 1e-12), "{}: {w:?}", vehicle.name);
            assert!(gains.attitude[2] <= vehicle.hover_authority()[2] * (1.0 + 1e-12), "{}", vehicle.name);
        }
    }
}
