//! Several multirotors as one [`System`], each pushed by the wakes of the others.
//!
//! The coupling is the downwash of [`aero::downwash`](super::aero::downwash) alone; vehicles do not collide. Its forces
//! are taken from the state at the start of a step and held in it, as commands are, so the coupling is first order in dt
//! whatever the integrator: at 2 ms a wake lags its source by 2 ms.

use super::aero::downwash;
use super::multirotor::{Multirotor, Physics};
use super::spatial::{Vec3, add, sub};
use super::vehicle::Vehicle;
use autodiff::{Scalar, System};
use base::error::{Error, Result, finite};
use serde::{Deserialize, Serialize};

/// Most vehicles of one fleet: each feels every other.
pub(crate) const MAX_VEHICLES: usize = 256;

/// Shape of the wakes, after OmniDrones.
///
/// A source with thrust vector T (N, world; direction T̂) pushes a vehicle by F = −a T. With d = p_source − p_vehicle (m, world), z = d·T̂
/// and r = ‖d − z T̂‖, a = exp(−½ (k_r r/z)²)/(1 + k_z z)² below the source, fades out close to it, and is 0 above.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Downwash {
    /// k_r ≥ 0: how narrow the cone is; default 2.
    pub radial: f64,
    /// k_z ≥ 0, 1/m: how fast the wake weakens; default 0.3.
    pub axial: f64,
}

impl Default for Downwash {
    /// OmniDrones' 2 and 0.3/m.
    fn default() -> Self {
        Self { radial: downwash::DEFAULT_RADIAL, axial: downwash::DEFAULT_AXIAL }
    }
}

/// Vehicles that step together.
///
/// State and input are those of each vehicle, one after the other (see [`Multirotor`]); there are no parameters. A wake
/// carries the source's thrust in free air, along its direction, from base origin to base origin.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
/// use omnidrones::autodiff::System;
/// use omnidrones::dynamics::{Downwash, Fleet, Physics, vehicles};
/// let vehicle = vehicles::by_name("hummingbird")?;
/// let fleet = Fleet::copies(&vehicle, 2, Physics::default(), Some(Downwash::default()))?;
/// let x = fleet.hover_state(&[[0.0, 0.0, 2.0], [0.0, 0.0, 1.0]])?;
/// let u = fleet.hover_input()?;
/// let mut next = x.clone();
/// fleet.step(&x, &u, &[], &mut next);
/// assert!(next[17 + 5] < -0.01); // the lower one sinks
/// assert!(next[5].abs() < 1e-12); // the upper one stays
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Fleet {
    members: Vec<Multirotor>,
    downwash: Option<Downwash>,
}

impl Fleet {
    /// `n` copies of a vehicle; `None` leaves the downwash out.
    ///
    /// # Errors
    /// As [`Fleet::new`].
    pub fn copies(vehicle: &Vehicle, n: usize, physics: Physics, downwash: Option<Downwash>) -> Result<Self> {
        Self::check_count(n)?;
        Self::new(&vec![vehicle.clone(); n], physics, downwash)
    }

    /// These vehicles; `None` leaves the downwash out.
    ///
    /// # Errors
    /// [`Error::Limit`] for no vehicle or more than 256; [`Error::Value`] when a vehicle, the physics or the
    /// downwash are not valid.
    pub fn new(vehicles: &[Vehicle], physics: Physics, downwash: Option<Downwash>) -> Result<Self> {
        Self::check_count(vehicles.len())?;
        if let Some(wake) = &downwash {
            for (what, value) in [("downwash.radial", wake.radial), ("downwash.axial", wake.axial)] {
                finite(what, &[value])?;
                if value < 0.0 {
                    return Err(Error::value(what, value, "≥ 0", "A wake widens and weakens: check the sign."));
                }
            }
        }
        let members = vehicles.iter().map(|v| Multirotor::new(v, physics)).collect::<Result<_>>()?;
        Ok(Self { members, downwash })
    }

    fn check_count(n: usize) -> Result<()> {
        if n == 0 || n > MAX_VEHICLES {
            let limit = format!("1 to {MAX_VEHICLES}");
            return Err(Error::limit("number of vehicles in a fleet", n, limit, "Use a World for independent ones."));
        }
        Ok(())
    }

    /// The vehicles, in the order of the state.
    pub fn members(&self) -> &[Multirotor] {
        &self.members
    }

    /// Shape of the wakes, if they are felt.
    pub fn downwash(&self) -> Option<Downwash> {
        self.downwash
    }

    /// Hover of each vehicle at its position (m, world), vehicle by vehicle, see [`Multirotor::hover_state`].
    ///
    /// # Errors
    /// [`Error::Value`] if a vehicle cannot hover or there is not one position per vehicle.
    pub fn hover_state(&self, positions: &[[f64; 3]]) -> Result<Vec<f64>> {
        if positions.len() != self.members.len() {
            let wanted = format!("{}, one per vehicle", self.members.len());
            return Err(Error::value("number of positions", positions.len(), wanted, "Give each vehicle its place."));
        }
        let states: Result<Vec<_>> = self.members.iter().zip(positions).map(|(m, p)| m.hover_state(*p)).collect();
        Ok(states?.concat())
    }

    /// Rotor actions that hold each vehicle's hover in undisturbed air, vehicle by vehicle as the input of the fleet.
    ///
    /// # Errors
    /// [`Error::Value`] if a vehicle cannot hover.
    pub fn hover_input(&self) -> Result<Vec<f64>> {
        let inputs: Result<Vec<_>> = self.members.iter().map(Multirotor::hover_input).collect();
        Ok(inputs?.concat())
    }

    /// Sum of the wakes of all vehicles but the one at number `affected`, whose state begins at `own`; N, world.
    fn push<S: Scalar>(&self, wake: &Downwash, affected: usize, own: usize, state: &[S]) -> Vec3<S> {
        let here = [state[own], state[own + 1], state[own + 2]];
        let (k_r, k_z) = (S::constant(wake.radial), S::constant(wake.axial));
        let mut force = [S::zero(); 3];
        let mut at = 0;
        for j in 0..self.members.len() {
            let x = &state[at..at + self.members[j].n_state()];
            if j != affected {
                let separation = sub([x[0], x[1], x[2]], here);
                force = add(force, downwash::force(separation, self.members[j].thrust(x), k_r, k_z));
            }
            at += x.len();
        }
        force
    }
}

impl System for Fleet {
    fn n_state(&self) -> usize {
        self.members.iter().map(System::n_state).sum()
    }
    fn n_input(&self) -> usize {
        self.members.iter().map(System::n_input).sum()
    }
    fn step<S: Scalar>(&self, state: &[S], input: &[S], _parameters: &[S], next: &mut [S]) {
        let (mut at, mut from) = (0, 0);
        for i in 0..self.members.len() {
            let member = &self.members[i];
            let (n, m) = (member.n_state(), member.n_input());
            let (x, u) = (&state[at..at + n], &input[from..from + m]);
            S::begin_function();
            match &self.downwash {
                Some(wake) => member.step_pushed(x, u, self.push(wake, i, at, state), &mut next[at..at + n]),
                None => member.step(x, u, &[], &mut next[at..at + n]),
            }
            S::end_function(&mut next[at..at + n]);
            (at, from) = (at + n, from + m);
        }
    }
}
