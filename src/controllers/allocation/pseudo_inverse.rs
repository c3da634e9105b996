//! The mixer: least thrusts that make a wrench.

use super::{Authority, Axis};
use autodiff::Scalar;
use base::error::{Error, Result};
use dynamics::authority::{RANK_TOLERANCE, decompose};
use dynamics::rotor::thrust_action;
use dynamics::spatial::dot;
use dynamics::{GRAVITY, Vehicle};

/// Thrusts nearer than this share of T_max are the same: rounding differs by 1e-15.
const SAME: f64 = 1e-9;

/// P of T = P [F_z, M_x, M_y, M_z], one row per rotor, with what it can and cannot do.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixer {
    /// P, one row per rotor: thrust per force (–) and per roll, pitch and yaw moment (1/m).
    pub rows: Vec<[f64; 4]>,
    /// Rank, weakest direction, lost axes.
    pub authority: Authority,
}

impl Mixer {
    /// P = A⁺ of the true rotor geometry about the centre of mass, by singular values; directions below
    /// `RANK_TOLERANCE` are left out, never inverted. Where the six rows are independent enough, P also holds the
    /// lateral force at zero.
    ///
    /// Moments are divided by the characteristic length before the decomposition, so that rank does not depend on
    /// units; with full row rank P does not depend on that scaling.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle is not valid, or its geometry has no singular value decomposition.
    pub fn new(vehicle: &Vehicle) -> Result<Self> {
        vehicle.validate()?;
        let (rows, authority) = decompose(vehicle);
        let n_rotor = vehicle.n_rotor();
        let mut mixer = vec![[0.0; 4]; n_rotor];
        let (Some(u), Some(v_t)) = (&rows.svd.u, &rows.svd.v_t) else {
            return Err(Error::value(
                format!("vehicle '{}': rotor geometry", vehicle.name),
                "impossible to decompose",
                "of finite positions, axes and moments",
                "Check the rotor table for huge or tiny numbers.",
            ));
        };
        let floor = RANK_TOLERANCE * rows.largest();
        for (k, sigma) in rows.svd.singular_values.iter().enumerate().filter(|(_, s)| **s > floor) {
            for (column, axis) in Axis::STEERED.iter().enumerate() {
                let Some(row) = rows.axes.iter().position(|a| a == axis) else { continue };
                for (i, thrusts) in mixer.iter_mut().enumerate() {
                    thrusts[column] += v_t[(k, i)] * u[(row, k)] / (sigma * rows.scale[row]);
                }
            }
        }
        Ok(Self { rows: mixer, authority })
    }

    /// The same with thrust shared as in the hover of a vehicle that hovers level, T = T_hover F_z/(m g), where least thrusts do not hover:
    /// a load off the centre would ask some rotors for less than nothing.
    #[must_use]
    pub fn carrying(mut self, vehicle: &Vehicle) -> Self {
        let weight = vehicle.mass_properties().mass * GRAVITY;
        let Ok(hover) = vehicle.hover() else { return self };
        let other = |(i, thrust): (usize, &f64)| {
            (thrust - self.rows[i][0] * weight).abs() > SAME * vehicle.rotors[i].max_thrust()
        };
        if hover.thrusts.iter().enumerate().any(other) {
            self.rows.iter_mut().zip(&hover.thrusts).for_each(|(row, thrust)| row[0] = thrust / weight);
        }
        self
    }

    /// For a kernel of `R` rotors: the vehicle's rows first, zero rows behind them.
    ///
    /// # Errors
    /// [`Error::Limit`] for more than `R` rotors.
    pub fn padded<S: Scalar, const R: usize>(&self) -> Result<[[S; 4]; R]> {
        fits(self.rows.len(), R)?;
        let mut padded = [[S::zero(); 4]; R];
        for (row, values) in padded.iter_mut().zip(&self.rows) {
            *row = values.map(S::constant);
        }
        Ok(padded)
    }
}

/// Checks that `n_rotor` rotors fit a kernel of `slots`.
pub(crate) fn fits(n_rotor: usize, slots: usize) -> Result<()> {
    if n_rotor <= slots {
        return Ok(());
    }
    Err(Error::limit(
        "number of rotors",
        n_rotor,
        format!("{slots} of this kernel"),
        "Take the kernel for 4, 6, 8, 12 or 16 rotors.",
    ))
}

/// T = P w clipped to [0, T_max], N; w = [F_z, M_x, M_y, M_z] about the centre of mass, body.
#[inline]
pub fn allocate<S: Scalar, const R: usize>(mixer: &[[S; 4]; R], max_thrust: &[S; R], wrench: [S; 4]) -> [S; R] {
    let mut thrusts = *max_thrust;
    for i in 0..R {
        thrusts[i] = dot(mixer[i], wrench).clamp(S::zero(), max_thrust[i]);
    }
    thrusts
}

/// T = P [F_z, M_x, M_y, M'] clipped to [0, T_max], N, with the yaw moment M' nearest to M_z that keeps every rotor within its
/// bounds: yaw, the weakest axis, gives way, beyond zero where it must, before clipping falsifies thrust, roll and pitch.
/// Inside the bounds M' = M_z and this is [`allocate`]; where no yaw moment makes room for the others, M' is the middle of the
/// bounds that contradict each other, which clips least where all rotors yaw alike.
///
/// Source: the order of PX4's mixer (yaw last); one scale for all rotors, so that yaw brings no other moment with it.
pub fn allocate_yaw_last<S: Scalar, const R: usize>(
    mixer: &[[S; 4]; R],
    max_thrust: &[S; R],
    wrench: [S; 4],
) -> [S; R] {
    let mut base = *max_thrust;
    let (mut low, mut high) = (S::constant(-1e9), S::constant(1e9));
    for i in 0..R {
        let row = mixer[i];
        base[i] = dot([row[0], row[1], row[2]], [wrench[0], wrench[1], wrench[2]]);
        // a rotor that does not yaw sets no bound
        let yaws = S::constant(1e-6).lt(row[3].abs());
        let per_thrust = S::select(yaws, row[3], S::one()).recip();
        let (empty, full) = (-base[i] * per_thrust, (max_thrust[i] - base[i]) * per_thrust);
        low = S::select(yaws, low.max(empty.min(full)), low);
        high = S::select(yaws, high.min(empty.max(full)), high);
    }
    let middle = S::constant(0.5) * (low + high);
    let yaw = wrench[3].clamp(low.min(middle), high.max(middle));
    let mut thrusts = *max_thrust;
    for i in 0..R {
        thrusts[i] = mixer[i][3].mul_add(yaw, base[i]).clamp(S::zero(), max_thrust[i]);
    }
    thrusts
}

/// a = 2T/T_max − 1, the rotor action in [−1, 1] that holds thrust T (N).
#[inline]
pub fn thrust_to_command<S: Scalar, const R: usize>(thrusts: &[S; R], max_thrust: &[S; R]) -> [S; R] {
    let mut commands = *thrusts;
    for i in 0..R {
        commands[i] = thrust_action(thrusts[i] * max_thrust[i].recip());
    }
    commands
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade::tests::{crazyflie, firefly, hummingbird, rotor};

    fn assert_mixer(vehicle: &Vehicle, golden: &[[f64; 4]]) {
        let mixer = Mixer::new(vehicle).unwrap();
        assert_eq!(mixer.authority.rank, 4);
        assert!(mixer.authority.is_complete() && !mixer.authority.full);
        let mut worst = 0.0_f64;
        for (row, expected) in mixer.rows.iter().zip(golden) {
            let got = [row[1], row[2], row[3], row[0]];
            for (a, b) in got.iter().zip(expected) {
                worst = worst.max((a - b).abs());
            }
        }
        println!("worst {worst:.1e}");
        // the golden values are printed to six decimals; measured: 9.3e-7
        assert!(worst < 1e-6, "{}: {:?}", vehicle.name, mixer.rows);
    }

    #[test]
    fn the_mixers_of_the_paper_come_out_of_its_geometry() {
        let q = 0.25;
        let h = 2.941176;
        assert_mixer(
            &hummingbird(),
            &[[0.0, -h, 15.625, q], [h, 0.0, -15.625, q], [0.0, h, 15.625, q], [-h, 0.0, -15.625, q]],
        );
        let (c, y) = (8.222172, 9.944751);
        assert_mixer(&crazyflie(), &[[c, -c, y, q], [c, c, -y, q], [-c, c, y, q], [-c, -c, -y, q]]);
        let (a, b, d, y, s) = (0.775194, 1.342675, 1.550388, 10.416666, 1.0 / 6.0);
        assert_mixer(
            &firefly(),
            &[[a, -b, -y, s], [d, 0.0, y, s], [a, b, -y, s], [-a, b, y, s], [-d, 0.0, -y, s], [-a, -b, y, s]],
        );
    }

    #[test]
    fn a_fully_actuated_hexarotor_is_allocated_with_zero_lateral_force() {
        // Neo11: six rotors tilted by 5°.
        let (c, r) = (0.9962_f64, 0.2895);
        let mut vehicle = firefly();
        for (i, rotor) in vehicle.rotors.iter_mut().enumerate() {
            let angle = std::f64::consts::FRAC_PI_6 + i as f64 * std::f64::consts::FRAC_PI_3;
            let (s, side) = ((1.0 - c * c).sqrt(), if i % 2 == 0 { 1.0 } else { -1.0 });
            rotor.position = [r * angle.cos(), r * angle.sin(), 0.028];
            rotor.axis = [side * s * angle.sin(), -side * s * angle.cos(), c];
        }
        let mixer = Mixer::new(&vehicle).unwrap();
        let a = &mixer.authority;
        println!("{a:?}");
        assert!(a.full && a.rank == 6 && a.is_complete());
        let matrix = vehicle.allocation_matrix();
        for column in 0..4 {
            let thrusts = nalgebra::DVector::from_fn(6, |i, _| mixer.rows[i][column]);
            let mut expected = nalgebra::DVector::zeros(6);
            expected[2 + column] = 1.0;
            let error = (&matrix * thrusts - expected).amax();
            println!("worst {error:.1e}");
            // measured: 9e-16
            assert!(error < 1e-12, "column {column}: {error:e}");
        }
    }

    #[test]
    fn a_vehicle_without_yaw_loses_yaw_and_nothing_blows_up() {
        let mut vehicle = hummingbird();
        for rotor in &mut vehicle.rotors {
            rotor.moment_per_thrust = 1e-9;
        }
        let mixer = Mixer::new(&vehicle).unwrap();
        assert_eq!((mixer.authority.rank, mixer.authority.dropped.as_slice()), (3, [Axis::Yaw].as_slice()));
        let largest = mixer.rows.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
        assert!((largest - 1.0 / 0.34).abs() < 1e-9, "{largest}: the roll entry, not 1/κ");
    }

    #[test]
    fn two_rotors_are_reported_as_the_two_directions_they_are() {
        let mut vehicle = hummingbird();
        vehicle.rotors = vec![rotor("left", [0.0, 0.2, 0.0], -1.0), rotor("right", [0.0, -0.2, 0.0], 1.0)];
        let mixer = Mixer::new(&vehicle).unwrap();
        // Thrust is free; roll and yaw come only together; pitch not at all.
        assert_eq!(mixer.authority.rank, 2);
        assert_eq!(mixer.authority.dropped, [Axis::Roll, Axis::Pitch, Axis::Yaw]);
        assert_eq!(mixer.authority.smallest_singular_value, 0.0);
    }

    #[test]
    fn thrusts_are_clipped_to_what_a_rotor_can_do_and_dead_slots_stay_at_rest() {
        let mixer: [[f64; 4]; 6] = Mixer::new(&hummingbird()).unwrap().padded().unwrap();
        let most = [6.0, 6.0, 6.0, 6.0, 1.0, 1.0];
        let thrusts = allocate(&mixer, &most, [12.0, 3.0, 0.0, 0.0]);
        for (thrust, expected) in thrusts.iter().zip([3.0, 6.0, 3.0, 0.0, 0.0, 0.0]) {
            assert!((thrust - expected).abs() < 1e-12, "{thrusts:?}");
        }
        assert_eq!(thrusts[1..].iter().filter(|t| **t == 6.0 || **t == 0.0).count(), 4, "clipped exactly");
        assert_eq!(thrust_to_command(&[3.0, 6.0, 0.0], &[6.0, 6.0, 1.0]), [0.0, 1.0, -1.0]);
        let error = Mixer::new(&firefly()).unwrap().padded::<f64, 4>().unwrap_err().to_string();
        assert!(error.starts_with("number of rotors is 6, over the limit of 4 of this kernel"), "{error}");
    }

    #[test]
    fn a_yaw_moment_beyond_the_rotors_leaves_thrust_roll_and_pitch_exact() {
        let vehicle = firefly();
        let mixer: [[f64; 4]; 8] = Mixer::new(&vehicle).unwrap().padded().unwrap();
        let mut most = [1.0; 8];
        most[..6].fill(vehicle.rotors[0].max_thrust());
        let wrench = [15.0, 0.4, -0.3, 2.0];
        let thrusts = allocate_yaw_last(&mixer, &most, wrench);
        let got = vehicle.allocation_matrix() * nalgebra::DVector::from_column_slice(&thrusts[..6]);
        for (axis, wanted) in [(2, 15.0), (3, 0.4), (4, -0.3)] {
            // measured: 5.5e-9
            println!("worst {:.1e}", (got[axis] - wanted).abs());
            assert!((got[axis] - wanted).abs() < 1e-7, "{got}");
        }
        assert!(got[5] > 0.1 && got[5] < 0.3, "yaw {}", got[5]);
        assert_eq!(thrusts[6..], [0.0; 2]);
        let gentle = [15.0, 0.4, -0.3, 0.05];
        for (a, b) in allocate_yaw_last(&mixer, &most, gentle).iter().zip(allocate(&mixer, &most, gentle)) {
            assert!((a - b).abs() < 1e-14);
        }
    }

    /// With yaw at zero instead, clipping makes 0.25 of 0.3 N m of roll, and 2.7 N for 2.4.
    #[test]
    fn yaw_of_the_other_sign_makes_room_for_roll_where_thrust_is_low() {
        let vehicle = hummingbird();
        let (mixer, most): ([[f64; 4]; 4], _) =
            (Mixer::new(&vehicle).unwrap().padded().unwrap(), [vehicle.rotors[0].max_thrust(); 4]);
        for (force, roll, pitch, yaw) in [(2.4, 0.3, 0.0, 0.0), (2.4, 0.3, 0.0, 0.02), (2.4, 0.0, -0.35, -0.02)] {
            let thrusts = allocate_yaw_last(&mixer, &most, [force, roll, pitch, yaw]);
            let got = vehicle.allocation_matrix() * nalgebra::DVector::from_column_slice(&thrusts);
            for (axis, wanted) in [(2, force), (3, roll), (4, pitch)] {
                // measured: 4e-16
                assert!((got[axis] - wanted).abs() < 1e-12, "{got}");
            }
            assert!((got[5] - yaw).abs() > 0.01, "yaw gave way: {got}");
        }
    }
}
