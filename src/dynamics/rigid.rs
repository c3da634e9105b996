//! The rigid multirotor in closed form: state, model, accelerations.
//!
//! At the centre of mass, with Tᵢ = k_f Ωᵢ² along nᵢ at rᵢ, spin σᵢ and H = Σ σᵢ I_p Ωᵢ nᵢ:
//!
//! ```text
//! m v̇ = R Σ Tᵢ nᵢ + m g + F
//! J ω̇ = Σ ((rᵢ − c) × Tᵢ nᵢ − σᵢ κᵢ Tᵢ nᵢ) − ω × Jω − Ḣ − ω × H + M
//! ```
//!
//! (Mahony, Kumar and Corke 2012, with the rotor's angular momentum). The state holds the base origin; a step moves to
//! the centre of mass, integrates there and moves back, so the centre of mass can be anywhere and be randomised.
//!
//! F and M are optional effects, each switched by one flag of [`Effects`]. Flags are plain settings: kernels branch on
//! them, and a caller that passes a constant [`Effects`] gets code without the effects it leaves out.

mod effects;
mod parameters;

pub use effects::Effects;
pub(crate) use parameters::at;
pub use parameters::{BODY_PARAMETERS, BodyParameter};
pub use parameters::{parameter_domains, parameter_names, parameter_vector, vehicle_of};

use super::rotor::{Lag, Motors, N_ROTOR_PARAMETER, RotorModel, commanded_speed};
use super::spatial::*;
use super::vehicle::Vehicle;
use autodiff::{Scalar, safe};

/// Position and velocity of the base origin (world), attitude (body → world), angular velocity (body), rotor speeds.
///
/// In a slice: `[position 3, velocity 3, attitude 4 (w, x, y, z), angular_velocity 3, rotor_speed R]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidState<S, const R: usize> {
    /// m, world.
    pub position: Vec3<S>,
    /// m/s, world.
    pub velocity: Vec3<S>,
    /// `[w, x, y, z]`, body → world.
    pub attitude: Quat<S>,
    /// rad/s, body.
    pub angular_velocity: Vec3<S>,
    /// rad/s, ≥ 0.
    pub rotor_speed: [S; R],
}

/// Entries of a rigid state before the rotor speeds.
pub const RIGID_DIM: usize = 13;

impl<S: Scalar, const R: usize> RigidState<S, R> {
    /// From a slice of 13 + n numbers, n ≤ R; rotors beyond n stand still.
    #[inline(always)]
    pub fn read(x: &[S]) -> Self {
        let mut rotor_speed = [S::zero(); R];
        let n = x.len() - RIGID_DIM;
        for i in 0..R {
            if i < n {
                rotor_speed[i] = x[RIGID_DIM + i];
            }
        }
        Self {
            position: [x[0], x[1], x[2]],
            velocity: [x[3], x[4], x[5]],
            attitude: [x[6], x[7], x[8], x[9]],
            angular_velocity: [x[10], x[11], x[12]],
            rotor_speed,
        }
    }

    /// Into a slice of 13 + n numbers, n ≤ R.
    #[inline(always)]
    pub fn write(&self, x: &mut [S]) {
        for i in 0..3 {
            x[i] = self.position[i];
            x[3 + i] = self.velocity[i];
            x[10 + i] = self.angular_velocity[i];
        }
        for i in 0..4 {
            x[6 + i] = self.attitude[i];
        }
        let n = x.len() - RIGID_DIM;
        for i in 0..R {
            if i < n {
                x[RIGID_DIM + i] = self.rotor_speed[i];
            }
        }
    }
}

/// Wind and whatever else pushes from outside, held during a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance<S> {
    /// Velocity of the air, m/s, world.
    pub wind: Vec3<S>,
    /// At the centre of mass, N, world.
    pub force: Vec3<S>,
    /// N m, body.
    pub moment: Vec3<S>,
}

impl<S: Scalar> Disturbance<S> {
    /// Entries in a slice: `[wind 3, force 3, moment 3]`.
    pub const DIM: usize = 9;

    /// Still air, no force, no moment.
    #[inline(always)]
    pub fn none() -> Self {
        let o = [S::zero(); 3];
        Self { wind: o, force: o, moment: o }
    }

    /// Into a slice in the order of [`Self::DIM`], as far as it reaches.
    #[inline(always)]
    pub fn write(&self, x: &mut [S]) {
        for (slot, value) in x.iter_mut().zip(self.wind.iter().chain(&self.force).chain(&self.moment)) {
            *slot = *value;
        }
    }

    /// From the first [`Self::DIM`] numbers of a slice.
    ///
    /// # Panics
    /// If there are fewer.
    #[inline(always)]
    pub fn read(x: &[S]) -> Self {
        Self { wind: [x[0], x[1], x[2]], force: [x[3], x[4], x[5]], moment: [x[6], x[7], x[8]] }
    }
}

/// A symmetric 3×3 matrix: xx, yy, zz, xy, xz, yz.
pub(crate) type Symmetric<S> = [S; 6];

/// What the kernels multiply with, derived once from the parameters of a vehicle with at most R rotors: see
/// [`Multirotor`](crate::Multirotor) for the equations.
#[derive(Debug, Clone, Copy)]
pub struct RigidModel<S, const R: usize> {
    pub(crate) gravity: S,
    pub(crate) mass: S,
    pub(crate) inverse_mass: S,
    pub(crate) center_of_mass: Vec3<S>,
    pub(crate) inertia: Symmetric<S>,
    pub(crate) inverse_inertia: Symmetric<S>,
    pub(crate) linear_drag: Vec3<S>,
    pub(crate) angular_drag: Vec3<S>,
    pub(crate) quadratic_drag: Vec3<S>,
    pub(crate) ground_height: S,
    /// Rotors in use; those behind are dead.
    pub(crate) n_rotor: usize,
    pub(crate) rotors: [RotorModel<S>; R],
    pub(crate) motors: [Motors<S>; R],
}

impl<const R: usize> RigidModel<f64, R> {
    /// The model of a vehicle for substeps of `substep` seconds; rotors beyond the vehicle's are dead (zero thrust).
    pub fn new(vehicle: &Vehicle, substep: f64) -> Self {
        let radii: Vec<f64> = vehicle.rotors.iter().map(|r| r.radius).collect();
        Self::from_parameters(&parameter_vector(vehicle), &radii, substep)
    }

    /// The same constants over another scalar.
    #[inline(always)]
    pub fn cast<S: Scalar>(&self) -> RigidModel<S, R> {
        let c = S::constant;
        let (mut rotors, mut motors) = ([RotorModel::dead(); R], [Motors::none(); R]);
        for i in 0..self.n_loop() {
            rotors[i] = self.rotors[i].cast();
            motors[i] = self.motors[i].cast();
        }
        RigidModel {
            gravity: c(self.gravity),
            mass: c(self.mass),
            inverse_mass: c(self.inverse_mass),
            center_of_mass: constants(self.center_of_mass),
            inertia: constants(self.inertia),
            inverse_inertia: constants(self.inverse_inertia),
            linear_drag: constants(self.linear_drag),
            angular_drag: constants(self.angular_drag),
            quadratic_drag: constants(self.quadratic_drag),
            ground_height: c(self.ground_height),
            n_rotor: self.n_rotor,
            rotors,
            motors,
        }
    }

    /// `effects` with the flags that the geometry needs: `tilted_rotors` and `products_of_inertia`.
    pub fn effects_of(&self, effects: Effects) -> Effects {
        let tilted = self.rotors.iter().any(|r| r.axis[0] != 0.0 || r.axis[1] != 0.0);
        let largest = self.inertia[..3].iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let products = self.inertia[3..].iter().any(|j| j.abs() > 1e-9 * largest);
        Effects {
            tilted_rotors: effects.tilted_rotors || tilted,
            products_of_inertia: effects.products_of_inertia || products,
            ..effects
        }
    }
}

impl<S: Scalar, const R: usize> RigidModel<S, R> {
    /// From the 20 + 16 n numbers `p` of [`Multirotor::parameters`](crate::Multirotor::parameters), so that derivatives reach every
    /// physical parameter, for substeps of `substep` seconds. Rotor `radii` (m, `[n]`, n ≤ R) are geometry, not parameters.
    ///
    /// # Panics
    /// If `p` has fewer numbers.
    #[inline(always)]
    pub fn from_parameters(p: &[S], radii: &[f64], substep: f64) -> Self {
        let three = |first: usize| [p[first], p[first + 1], p[first + 2]];
        let center_of_mass = three(at::center_of_mass_x);
        let inertia = std::array::from_fn(|k| p[at::inertia_xx + k]);
        let (mut rotors, mut motors) = ([RotorModel::dead(); R], [Motors::none(); R]);
        for i in 0..R {
            if i < radii.len() {
                let own = &p[BODY_PARAMETERS.len() + i * N_ROTOR_PARAMETER..];
                rotors[i] = RotorModel::new(own, center_of_mass, radii[i]);
                motors[i] = Motors::new(own, substep);
            }
        }
        Self {
            gravity: p[at::gravity],
            mass: p[at::mass],
            inverse_mass: p[at::mass].recip(),
            center_of_mass,
            inertia,
            inverse_inertia: symmetric(inverse(full(inertia))),
            linear_drag: three(at::linear_drag_x),
            quadratic_drag: three(at::quadratic_drag_x),
            angular_drag: three(at::angular_drag_x),
            ground_height: S::zero(),
            n_rotor: radii.len(),
            rotors,
            motors,
        }
    }
}

/// The full matrix.
#[inline(always)]
pub(crate) fn full<S: Scalar>(s: Symmetric<S>) -> Mat3<S> {
    [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]]
}

/// The upper triangle of a symmetric matrix.
#[inline(always)]
pub(crate) fn symmetric<S: Scalar>(m: Mat3<S>) -> Symmetric<S> {
    [m[0][0], m[1][1], m[2][2], m[0][1], m[0][2], m[1][2]]
}

/// M v, leaving the products out where the model has none.
#[inline(always)]
pub(crate) fn symmetric_times<S: Scalar>(m: &Symmetric<S>, v: Vec3<S>, effects: Effects) -> Vec3<S> {
    if effects.products_of_inertia { mat_vec(full(*m), v) } else { hadamard([m[0], m[1], m[2]], v) }
}

/// Motion of the centre of mass and the body: what an integrator advances.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<S> {
    pub position: Vec3<S>,
    pub velocity: Vec3<S>,
    pub attitude: Quat<S>,
    pub angular_velocity: Vec3<S>,
}

/// Rotor speeds at the start, middle and end of a substep, from the closed form of the first-order lag.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RotorPath<S, const R: usize> {
    pub start: [S; R],
    pub middle: [S; R],
    pub end: [S; R],
    pub lag: [Lag<S>; R],
}

impl<S, const R: usize> RigidModel<S, R> {
    /// Rotors to loop over: all slots of a small model, so that loops unroll, else those in use.
    #[inline(always)]
    fn n_loop(&self) -> usize {
        if R <= 8 { R } else { self.n_rotor }
    }
}

impl<S: Scalar, const R: usize> RigidModel<S, R> {
    /// Ω_cmd of rotor actions.
    #[inline(always)]
    pub(crate) fn target_speed(&self, action: &[S; R]) -> [S; R] {
        let mut target = [S::zero(); R];
        for i in 0..self.n_loop() {
            target[i] = commanded_speed(self.rotors[i].max_speed, action[i]);
        }
        target
    }

    /// Speeds over one substep.
    #[inline(always)]
    pub(crate) fn rotor_path(&self, start: [S; R], target: [S; R]) -> RotorPath<S, R> {
        let mut path = RotorPath { start, middle: start, end: start, lag: [Lag::none(); R] };
        for i in 0..self.n_loop() {
            let lag = &mut path.lag[i];
            *lag = Lag::new(self.motors[i].towards(start[i], target[i]), start[i], target[i]);
            path.middle[i] = lag.advance();
            path.end[i] = lag.advance();
        }
        path
    }

    /// Base origin → centre of mass: p + R c, v + R (ω × c).
    #[inline(always)]
    pub(crate) fn center_of_mass_motion(&self, x: &RigidState<S, R>) -> Motion<S> {
        let (q, w) = (x.attitude, x.angular_velocity);
        Motion {
            position: add(x.position, rotate(q, self.center_of_mass)),
            velocity: add(x.velocity, rotate(q, cross(w, self.center_of_mass))),
            attitude: q,
            angular_velocity: w,
        }
    }

    /// Centre of mass → base origin.
    #[inline(always)]
    pub(crate) fn base_origin_state(&self, m: &Motion<S>, rotor_speed: [S; R]) -> RigidState<S, R> {
        let (q, w) = (m.attitude, m.angular_velocity);
        RigidState {
            position: sub(m.position, rotate(q, self.center_of_mass)),
            velocity: sub(m.velocity, rotate(q, cross(w, self.center_of_mass))),
            attitude: q,
            angular_velocity: w,
            rotor_speed,
        }
    }

    /// Rotor thrusts and reaction torques about the centre of mass, body frame.
    #[inline(always)]
    fn rotor_wrench(&self, m: &Motion<S>, speed: &[S; R], effects: Effects) -> Wrench<S> {
        let mut sum = Wrench::zero();
        for i in 0..self.n_loop() {
            let rotor = &self.rotors[i];
            let mut height = None;
            if effects.ground_effect {
                let hub = add(m.position, rotate(m.attitude, rotor.hub));
                height = Some(hub[2] - self.ground_height);
            }
            rotor.add_thrust(speed[i], height, effects.tilted_rotors, &mut sum);
        }
        sum
    }

    /// Drag of airframe and rotors; never feeds power in still air, the rolling moment aside.
    #[inline(always)]
    pub(crate) fn drag_wrench(
        &self,
        m: &Motion<S>,
        speed: &[S; R],
        air: &Disturbance<S>,
        effects: Effects,
    ) -> Wrench<S> {
        let relative = if effects.disturbance { sub(m.velocity, air.wind) } else { m.velocity };
        let velocity = rotate_scaled(conjugate(m.attitude), relative);
        let w = m.angular_velocity;
        let mut drag = Wrench::zero();
        if effects.body_drag {
            drag.force = neg(hadamard(self.linear_drag, velocity));
            drag.moment = neg(hadamard(self.angular_drag, w));
        }
        if effects.quadratic_drag {
            let speed = safe::norm(velocity);
            drag.force = axpy(drag.force, -speed, hadamard(self.quadratic_drag, velocity));
        }
        if effects.rotor_air() {
            for i in 0..self.n_loop() {
                self.rotors[i].add_drag(speed[i], velocity, w, effects, &mut drag);
            }
        }
        drag
    }

    /// Angular momentum H of the rotors and its rate, body frame.
    #[inline(always)]
    pub(crate) fn rotor_momentum(&self, speed: &[S; R], path: &RotorPath<S, R>) -> (Vec3<S>, Vec3<S>) {
        let mut momentum = [S::zero(); 3];
        let mut rate = [S::zero(); 3];
        for i in 0..self.n_loop() {
            let acceleration = path.lag[i].acceleration(speed[i]);
            self.rotors[i].add_momentum(speed[i], acceleration, &mut momentum, &mut rate);
        }
        (momentum, rate)
    }

    /// All forces and moments but ω × (Jω + H), which integrators treat each in their way: the acceleration of the
    /// centre of mass (world), the moment (body) and H (body).
    #[inline(always)]
    pub(crate) fn loads(
        &self,
        m: &Motion<S>,
        speed: &[S; R],
        path: &RotorPath<S, R>,
        air: &Disturbance<S>,
        effects: Effects,
    ) -> (Vec3<S>, Vec3<S>, Vec3<S>) {
        let rotors = self.rotor_wrench(m, speed, effects);
        let (mut force, mut moment) = (rotors.force, rotors.moment);
        if effects.body_drag || effects.quadratic_drag || effects.rotor_air() {
            let drag = self.drag_wrench(m, speed, air, effects);
            if effects.tilted_rotors {
                force = add(force, drag.force);
            } else {
                force = [drag.force[0], drag.force[1], force[2] + drag.force[2]];
            }
            moment = add(moment, drag.moment);
        }
        let mut momentum = [S::zero(); 3];
        if effects.rotor_inertia {
            let (h, rate) = self.rotor_momentum(speed, path);
            momentum = h;
            moment = sub(moment, rate);
        }
        let mut world = if effects.tilted_rotors || effects.body_drag || effects.quadratic_drag || effects.rotor_air() {
            rotate_scaled(m.attitude, force)
        } else {
            scale(force[2], up_axis(m.attitude))
        };
        if effects.disturbance {
            world = add(world, air.force);
            moment = add(moment, air.moment);
        }
        let mut acceleration = scale(self.inverse_mass, world);
        acceleration[2] -= self.gravity;
        (acceleration, moment, momentum)
    }

    /// ω̇ = J⁻¹ (M − ω × (Jω + H)).
    #[inline(always)]
    pub(crate) fn angular_acceleration(
        &self,
        w: Vec3<S>,
        moment: Vec3<S>,
        momentum: Vec3<S>,
        effects: Effects,
    ) -> Vec3<S> {
        let mut total = symmetric_times(&self.inertia, w, effects);
        if effects.rotor_inertia {
            total = add(total, momentum);
        }
        symmetric_times(&self.inverse_inertia, sub(moment, cross(w, total)), effects)
    }

    /// ẋ in continuous time: [`Self::loads`] at the centre of mass, v̇ taken to the base origin, Ω̇ = (Ω_cmd − Ω)/τ.
    pub(crate) fn derivative(
        &self,
        x: &RigidState<S, R>,
        action: &[S; R],
        air: &Disturbance<S>,
        effects: Effects,
    ) -> RigidState<S, R> {
        let path = self.rotor_path(x.rotor_speed, self.target_speed(action));
        let (m, w, c) = (self.center_of_mass_motion(x), x.angular_velocity, self.center_of_mass);
        let (acceleration, moment, momentum) = self.loads(&m, &x.rotor_speed, &path, air, effects);
        let spin = self.angular_acceleration(w, moment, momentum, effects);
        // v = v_c − R (ω × c), hence v̇ = v̇_c − R (ω̇ × c + ω × (ω × c))
        let lever = add(cross(spin, c), cross(w, cross(w, c)));
        let mut rotor_speed = x.rotor_speed;
        for i in 0..R {
            rotor_speed[i] = path.lag[i].acceleration(x.rotor_speed[i]);
        }
        RigidState {
            position: x.velocity,
            velocity: sub(acceleration, rotate(x.attitude, lever)),
            attitude: derivative(x.attitude, w),
            angular_velocity: spin,
            rotor_speed,
        }
    }
}
