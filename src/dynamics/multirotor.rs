//! One rigid multirotor as a [`System`]: x⁺ = f(x, rotor actions), on any scalar.

use super::integrate::{Grid, Integrator, step};
use super::rigid::{BODY_PARAMETERS, Disturbance, Effects, RIGID_DIM, RigidModel, RigidState, parameter_vector};
use super::rotor::{N_ROTOR_PARAMETER, thrust_action};
use super::spatial::{Vec3, add, axpy, constants, rotate};
use super::vehicle::Vehicle;
use autodiff::compiled_once::{Arguments, CompiledOnce};
use autodiff::{Scalar, System};
use base::error::{Error, Result, finite};
use serde::{Deserialize, Serialize};

/// Time step, integrator and effects of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Physics {
    /// Seconds per step, 1e-9 to 1, default 0.002; commands are held within it.
    pub dt: f64,
    /// Integrator steps per step, 1 to 1000, default 1.
    pub substeps: usize,
    /// How each is integrated.
    pub integrator: Integrator,
    /// Optional effects.
    pub effects: Effects,
}

impl Default for Physics {
    /// RK4 at 2 ms with the default effects.
    fn default() -> Self {
        Self { dt: 0.002, substeps: 1, integrator: Integrator::default(), effects: Effects::default() }
    }
}

impl Physics {
    /// Shortest dt, s: no clock ticks as often, and time would not advance beside larger numbers.
    pub const SHORTEST: f64 = 1e-9;

    /// Checks dt in (0, 1] s, not below [`Physics::SHORTEST`], and 1 to 1000 substeps.
    ///
    /// # Errors
    /// [`Error::Value`] for dt, [`Error::Limit`] for the substeps.
    pub fn validate(&self) -> Result<()> {
        finite("dt", &[self.dt])?;
        let remedy = "2 ms suits control design, 16 ms the benchmark tasks.";
        if self.dt <= 0.0 || self.dt > 1.0 {
            return Err(Error::value("dt", self.dt, "in (0, 1] s", remedy));
        }
        if self.dt < Self::SHORTEST {
            return Err(Error::value("dt", self.dt, format!("at least {:e} s", Self::SHORTEST), remedy));
        }
        if self.substeps == 0 || self.substeps > 1000 {
            return Err(Error::limit("substeps", self.substeps, "1 to 1000", "Lower dt instead."));
        }
        Ok(())
    }

    #[doc(hidden)]
    pub fn grid(&self) -> Grid {
        Grid { integrator: self.integrator, substep: self.dt / self.substeps as f64, substeps: self.substeps }
    }
}

/// A model with rotor loops unrolled for up to four, or with loops for up to sixteen: two copies of the physics per scalar.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per simulation, and read on every step")]
pub(crate) enum AnyModel {
    Four(RigidModel<f64, 4>),
    Sixteen(RigidModel<f64, 16>),
}

impl AnyModel {
    pub(crate) fn new(vehicle: &Vehicle, substep: f64) -> Self {
        match vehicle.n_rotor() {
            0..=4 => Self::Four(RigidModel::new(vehicle, substep)),
            _ => Self::Sixteen(RigidModel::new(vehicle, substep)),
        }
    }

    pub(crate) fn effects_of(&self, effects: Effects) -> Effects {
        match self {
            Self::Four(m) => m.effects_of(effects),
            Self::Sixteen(m) => m.effects_of(effects),
        }
    }
}

/// One vehicle under given physics, in closed form (Mahony, Kumar and Corke 2012, with the rotors' angular momentum). At the centre of
/// mass c, with thrusts Tᵢ = k_f Ωᵢ² along nᵢ at rᵢ, H = Σ σᵢ I_p Ωᵢ nᵢ and the optional [`Effects`] F, M:
///
/// ```text
/// m v̇ = R Σ Tᵢ nᵢ + m g + F
/// J ω̇ = Σ ((rᵢ − c) × Tᵢ nᵢ − σᵢ κᵢ Tᵢ nᵢ) − ω × Jω − Ḣ − ω × H + M
/// Ω_cmd = Ω_max √max((a + 1)/2, 10⁻⁴)      Ω̇ = (Ω_cmd − Ω)/τ
/// ```
///
/// State: 13 + n numbers, see [`RigidState`]. Input: n rotor actions a in [−1, 1] (clipped), then the nine numbers of a
/// [`Disturbance`] if that effect is on. Parameters: none, or with [`Multirotor::with_parameters`] 20 + 16 n physical numbers, see
/// [`parameters`](Self::parameters).
#[derive(Debug, Clone)]
pub struct Multirotor {
    vehicle: Vehicle,
    physics: Physics,
    effects: Effects,
    model: AnyModel,
    radii: Vec<f64>,
    exposes_parameters: bool,
}

impl Multirotor {
    /// Builds the model of a vehicle.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] when the vehicle or the physics are not valid.
    pub fn new(vehicle: &Vehicle, physics: Physics) -> Result<Self> {
        vehicle.validate()?;
        physics.validate()?;
        if physics.effects.contact {
            return Err(Error::value(
                "effects.contact",
                "on",
                "off in the closed form, which has no shapes",
                "Use tree::Multibody with assembly::single(&vehicle).",
            ));
        }
        let model = AnyModel::new(vehicle, physics.grid().substep);
        Ok(Self {
            effects: model.effects_of(physics.effects),
            radii: vehicle.rotors.iter().map(|r| r.radius).collect(),
            vehicle: vehicle.clone(),
            physics,
            model,
            exposes_parameters: false,
        })
    }

    /// The same system with its physical parameters as θ; pass [`Multirotor::parameters`] to `step`.
    pub fn with_parameters(mut self) -> Self {
        self.exposes_parameters = true;
        // a parameter that is zero now may be varied, so geometry may not be assumed
        self.effects.tilted_rotors = true;
        self.effects.products_of_inertia = true;
        self
    }

    /// Nominal physical parameters, `[20 + 16 n]` in SI units: gravity, mass, center_of_mass 3, inertia xx yy zz xy xz yz, linear,
    /// quadratic and angular drag 3 each, then sixteen per rotor (`parameter_vector`).
    pub fn parameters(&self) -> Vec<f64> {
        parameter_vector(&self.vehicle)
    }

    /// The vehicle.
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicle
    }

    /// Time step, integrator and effects.
    pub fn physics(&self) -> &Physics {
        &self.physics
    }

    /// Hover with the base origin at `position` (m, world) and yaw 0: attitude and rotor speeds of [`Vehicle::hover`], `[13 + n]`.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle cannot hover.
    pub fn hover_state(&self, position: [f64; 3]) -> Result<Vec<f64>> {
        let hover = self.vehicle.hover()?;
        let mut x = vec![0.0; self.n_state()];
        x[..3].copy_from_slice(&position);
        x[6..10].copy_from_slice(&hover.attitude);
        for ((speed, thrust), rotor) in x[RIGID_DIM..].iter_mut().zip(hover.thrusts).zip(&self.vehicle.rotors) {
            *speed = (thrust / rotor.thrust_coefficient).sqrt();
        }
        Ok(x)
    }

    /// Rotor actions in [−1, 1] that hold hover, with no disturbance, `[n_input]`.
    ///
    /// # Errors
    /// [`Error::Value`] if the vehicle cannot hover.
    pub fn hover_input(&self) -> Result<Vec<f64>> {
        let thrusts = self.vehicle.hover()?.thrusts;
        let rotors = thrusts.iter().zip(&self.vehicle.rotors);
        let mut u: Vec<f64> = rotors.map(|(t, r)| thrust_action(t / r.max_thrust())).collect();
        u.resize(self.n_input(), 0.0);
        Ok(u)
    }

    /// What a step of one compiled rotor count needs: model, state, actions padded to R, air.
    #[inline(always)]
    fn padded<S: Scalar, const R: usize>(
        &self,
        nominal: &RigidModel<f64, R>,
        state: &[S],
        input: &[S],
        parameters: &[S],
    ) -> (RigidModel<S, R>, RigidState<S, R>, [S; R], Disturbance<S>) {
        let model = if self.exposes_parameters {
            RigidModel::from_parameters(parameters, &self.radii, self.physics.grid().substep)
        } else {
            nominal.cast()
        };
        let n = self.radii.len();
        let mut action = [-S::one(); R];
        for i in 0..R {
            if i < n {
                action[i] = input[i];
            }
        }
        let air = if self.effects.disturbance { Disturbance::read(&input[n..]) } else { Disturbance::none() };
        (model, RigidState::read(state), action, air)
    }

    #[inline(always)]
    fn step_padded<S: Scalar, const R: usize>(
        &self,
        nominal: &RigidModel<f64, R>,
        state: &[S],
        input: &[S],
        parameters: &[S],
        push: Option<Vec3<S>>,
        next: &mut [S],
    ) {
        let (model, x, action, mut air) = self.padded(nominal, state, input, parameters);
        let mut effects = self.effects;
        if let Some(force) = push {
            effects.disturbance = true;
            air.force = add(air.force, force);
        }
        step(&model, effects, self.physics.grid(), &x, &action, &air).write(next);
    }

    /// ẋ = f(x, u, θ) in continuous time: what a step integrates. `rate` has the layout and length of the state, in its units per second.
    pub fn derivative<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], rate: &mut [S]) {
        match &self.model {
            AnyModel::Four(m) => self.derivative_padded(m, state, input, parameters, rate),
            AnyModel::Sixteen(m) => self.derivative_padded(m, state, input, parameters, rate),
        }
    }

    fn derivative_padded<S: Scalar, const R: usize>(
        &self,
        nominal: &RigidModel<f64, R>,
        state: &[S],
        input: &[S],
        parameters: &[S],
        rate: &mut [S],
    ) {
        let (model, x, action, air) = self.padded(nominal, state, input, parameters);
        model.derivative(&x, &action, &air, self.effects).write(rate);
    }

    /// Drag of airframe and rotors in a state, `[force; moment]` about the centre of mass, N and N m, body frame: of the effects that
    /// are on, the rolling moment among them.
    pub fn drag_wrench<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S]) -> [S; 6] {
        match &self.model {
            AnyModel::Four(m) => self.drag_padded(m, state, input, parameters),
            AnyModel::Sixteen(m) => self.drag_padded(m, state, input, parameters),
        }
    }

    fn drag_padded<S: Scalar, const R: usize>(
        &self,
        nominal: &RigidModel<f64, R>,
        state: &[S],
        input: &[S],
        parameters: &[S],
    ) -> [S; 6] {
        let (model, x, _, air) = self.padded(nominal, state, input, parameters);
        let drag = model.drag_wrench(&model.center_of_mass_motion(&x), &x.rotor_speed, &air, self.effects);
        let (f, m) = (drag.force, drag.moment);
        [f[0], f[1], f[2], m[0], m[1], m[2]]
    }

    /// [`step_any`](Self::step_any) where it is compiled once.
    #[inline(never)]
    fn step_here(&self, arguments: CompiledOnce<'_>) {
        match arguments {
            CompiledOnce::Plain(a) => self.step_any(a.state, a.input, a.parameters, None, a.result),
            CompiledOnce::Dual(a) => self.step_any(a.state, a.input, a.parameters, None, a.result),
            CompiledOnce::Trace(a) => self.step_any(a.state, a.input, a.parameters, None, a.result),
        }
    }

    fn step_any<S: Scalar>(&self, state: &[S], input: &[S], theta: &[S], push: Option<Vec3<S>>, next: &mut [S]) {
        match &self.model {
            AnyModel::Four(m) => self.step_padded(m, state, input, theta, push, next),
            AnyModel::Sixteen(m) => self.step_padded(m, state, input, theta, push, next),
        }
    }

    /// As [`System::step`] without parameters, with one more force at the centre of mass (N, world) held in the step.
    pub(crate) fn step_pushed<S: Scalar>(&self, state: &[S], input: &[S], force: Vec3<S>, next: &mut [S]) {
        self.step_any(state, input, &[], Some(force), next);
    }

    /// Σ k_f Ωᵢ² nᵢ of a state in the world, N: the rotors' thrust in free air.
    pub(crate) fn thrust<S: Scalar>(&self, state: &[S]) -> Vec3<S> {
        let mut force = [S::zero(); 3];
        for (rotor, speed) in self.vehicle.rotors.iter().zip(&state[RIGID_DIM..]) {
            let squared = S::constant(rotor.thrust_coefficient) * speed.square();
            force = axpy(force, squared, constants(rotor.axis));
        }
        rotate([state[6], state[7], state[8], state[9]], force)
    }
}

impl System for Multirotor {
    fn n_state(&self) -> usize {
        RIGID_DIM + self.radii.len()
    }
    fn n_input(&self) -> usize {
        self.radii.len() + if self.effects.disturbance { Disturbance::<f64>::DIM } else { 0 }
    }
    fn n_parameter(&self) -> usize {
        if self.exposes_parameters { BODY_PARAMETERS.len() + self.radii.len() * N_ROTOR_PARAMETER } else { 0 }
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], parameters: &[S], next: &mut [S]) {
        if const { S::IS_COMPILED_ONCE } {
            self.step_here(S::compiled_once(Arguments { state, input, parameters, result: next }));
        } else {
            self.step_any(state, input, parameters, None, next);
        }
    }
}
