//! Flights, bodies, random states, and the energies and momenta that the claims are about.

use crate::common::measure::larger;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use omnidrones::autodiff::System;
use omnidrones::dynamics::{Drag, Effects, Inertia, Integrator, Multirotor, Part, Physics, Vehicle, vehicles};
use omnidrones::rng::{Purpose, Stream};

pub use crate::common::measure::{at_most, near};

/// Constants of a vehicle as the physics textbook has them, summed from its parts.
pub struct Body {
    pub mass: f64,
    pub center_of_mass: Vector3<f64>,
    pub inertia: Matrix3<f64>,
}

impl Body {
    pub fn of(vehicle: &Vehicle) -> Self {
        let total = vehicle.mass_properties();
        Self { mass: total.mass, center_of_mass: total.center_of_mass, inertia: total.inertia }
    }

    /// Of the centre of mass, world.
    pub fn position(&self, x: &[f64]) -> Vector3<f64> {
        vector(x, 0) + attitude(x) * self.center_of_mass
    }

    /// Of the centre of mass, world.
    pub fn velocity(&self, x: &[f64]) -> Vector3<f64> {
        vector(x, 3) + attitude(x) * vector(x, 10).cross(&self.center_of_mass)
    }

    pub fn rotational_energy(&self, x: &[f64]) -> f64 {
        let w = vector(x, 10);
        0.5 * w.dot(&(self.inertia * w))
    }

    pub fn translational_energy(&self, x: &[f64]) -> f64 {
        0.5 * self.mass * self.velocity(x).norm_squared()
    }

    /// R (Jω + H) about the centre of mass, world, with the rotors' momentum H in the body.
    pub fn angular_momentum(&self, x: &[f64], rotors: Vector3<f64>) -> Vector3<f64> {
        attitude(x) * (self.inertia * vector(x, 10) + rotors)
    }
}

pub fn vector(x: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

pub fn attitude(x: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(x[6], x[7], x[8], x[9]))
}

pub fn set<const N: usize>(x: &mut [f64], at: usize, values: [f64; N]) {
    x[at..at + N].copy_from_slice(&values);
}

/// H = Σ σ I_p Ω n, body.
pub fn rotor_momentum(vehicle: &Vehicle, x: &[f64]) -> Vector3<f64> {
    vehicle.rotors.iter().zip(&x[13..]).map(|(r, speed)| Vector3::from(r.axis) * (r.spin * r.inertia * speed)).sum()
}

/// A vehicle in flight: its system and the parameters that go with it.
pub struct Flight {
    pub system: Multirotor,
    pub parameters: Vec<f64>,
}

impl Flight {
    pub fn new(vehicle: &Vehicle, physics: Physics) -> Self {
        Self { system: Multirotor::new(vehicle, physics).unwrap(), parameters: Vec::new() }
    }

    pub fn without_gravity(vehicle: &Vehicle, physics: Physics) -> Self {
        let system = Multirotor::new(vehicle, physics).unwrap().with_parameters();
        let mut parameters = system.parameters();
        parameters[0] = 0.0;
        Self { system, parameters }
    }

    pub fn step(&self, x: &[f64], u: &[f64]) -> Vec<f64> {
        let mut next = vec![0.0; x.len()];
        self.system.step::<f64>(x, u, &self.parameters, &mut next);
        next
    }

    pub fn after(&self, x: &[f64], u: &[f64], steps: usize) -> Vec<f64> {
        (0..steps).fold(x.to_vec(), |x, _| self.step(&x, u))
    }

    pub fn derivative(&self, x: &[f64], u: &[f64]) -> Vec<f64> {
        let mut rate = vec![0.0; x.len()];
        self.system.derivative::<f64>(x, u, &self.parameters, &mut rate);
        rate
    }
}

pub fn physics(dt: f64, integrator: Integrator, effects: Effects) -> Physics {
    Physics { dt, substeps: 1, integrator, effects }
}

pub fn rk4(dt: f64, effects: Effects) -> Physics {
    physics(dt, Integrator::RungeKutta4, effects)
}

/// One rigid part carrying rotors that neither push, turn nor drag: the Hummingbird's, with k_f = 1e-30.
pub fn inert(mass: f64, center_of_mass: [f64; 3], inertia: Inertia) -> Vehicle {
    let mut vehicle = vehicles::by_name("hummingbird").unwrap();
    vehicle.parts = vec![Part::new("body", mass, center_of_mass, inertia)];
    vehicle.drag = Drag::default();
    silence(&mut vehicle);
    for rotor in &mut vehicle.rotors {
        rotor.inertia = 0.0;
    }
    vehicle
}

/// Takes thrust, reaction torque and drag away from the rotors and leaves them their angular momentum.
pub fn silence(vehicle: &mut Vehicle) {
    for rotor in &mut vehicle.rotors {
        rotor.thrust_coefficient = 1e-30;
        rotor.moment_per_thrust = 0.0;
        rotor.drag_coefficient = 0.0;
        rotor.axial_drag_coefficient = 0.0;
        rotor.rolling_coefficient = 0.0;
    }
}

/// A copy with every coefficient of drag and rotor inertia in use, scaled to the vehicle's mass, and its centre of mass
/// off the base origin.
pub fn with_everything(vehicle: &Vehicle) -> Vehicle {
    let mut vehicle = vehicle.clone();
    let body = Body::of(&vehicle);
    let (m, j) = (body.mass, body.inertia);
    vehicle.drag = Drag {
        linear: [0.10 * m, 0.13 * m, 0.17 * m],
        quadratic: [0.02 * m, 0.03 * m, 0.05 * m],
        angular: [0.2 * j[(0, 0)], 0.3 * j[(1, 1)], 0.4 * j[(2, 2)]],
    };
    let arm = vehicle.rotors.iter().map(|r| Vector3::from(r.position).norm()).fold(0.0, larger);
    let ballast = Inertia::diagonal(0.01 * j[(0, 0)], 0.01 * j[(1, 1)], 0.01 * j[(2, 2)]);
    vehicle.parts.push(Part::new("ballast", 0.1 * m, [0.3 * arm, -0.2 * arm, 0.1 * arm], ballast));
    for rotor in &mut vehicle.rotors {
        rotor.axial_drag_coefficient = 0.5 * rotor.drag_coefficient;
        rotor.rolling_coefficient = 0.02 * rotor.drag_coefficient * arm;
    }
    vehicle
}

/// Every effect that obeys the laws of still air: all but the rolling moment and outside disturbances.
pub fn still_air() -> Effects {
    Effects { disturbance: false, rolling_moment: false, ..Effects::all() }
}

pub fn stream(seed: u64) -> Stream {
    Stream::new(seed, 0, 0, Purpose(0x7068_7973))
}

pub fn random<const N: usize>(random: &mut Stream, size: f64) -> [f64; N] {
    std::array::from_fn(|_| random.uniform(-size, size))
}

/// Anywhere up to 5 m away and above the ground, 5 m/s, any attitude, 5 rad/s, rotors between 10 and 100 %.
pub fn random_state(vehicle: &Vehicle, stream: &mut Stream) -> Vec<f64> {
    let mut x = vec![0.0; 13 + vehicle.n_rotor()];
    set(&mut x, 0, random::<3>(stream, 5.0));
    x[2] = stream.uniform(0.1, 5.0);
    set(&mut x, 3, random::<3>(stream, 5.0));
    let q = UnitQuaternion::new_normalize(Quaternion::new(
        stream.normal(),
        stream.normal(),
        stream.normal(),
        stream.normal(),
    ));
    set(&mut x, 6, [q.w, q.i, q.j, q.k]);
    set(&mut x, 10, random::<3>(stream, 5.0));
    for (speed, rotor) in x[13..].iter_mut().zip(&vehicle.rotors) {
        *speed = rotor.max_speed * stream.uniform(0.1, 1.0);
    }
    x
}

/// Rotor actions in [−1, 1], then wind up to 3 m/s, a force and a moment if the system takes them.
pub fn random_input(system: &Multirotor, stream: &mut Stream) -> Vec<f64> {
    let n = system.vehicle().n_rotor();
    let mut u: Vec<f64> = (0..n).map(|_| stream.uniform(-1.0, 1.0)).collect();
    if system.n_input() > n {
        let weight = 9.81 * Body::of(system.vehicle()).mass;
        u.extend(random::<3>(stream, 3.0));
        u.extend(random::<3>(stream, 0.2 * weight));
        u.extend(random::<3>(stream, 0.01 * weight));
    }
    u
}

/// Largest |a − b| / max(1, |a|).
pub fn difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / a.abs().max(1.0)).fold(0.0, larger)
}

/// Defect for twins: free rotation by the usual explicit form ω⁺ = ω − h J⁻¹ (ω × Jω).
pub fn explicit_rotation(inertia: &Matrix3<f64>, mut w: Vector3<f64>, dt: f64, steps: usize) -> Vector3<f64> {
    let inverse = inertia.try_inverse().unwrap();
    for _ in 0..steps {
        w -= inverse * w.cross(&(inertia * w)) * dt;
    }
    w
}
