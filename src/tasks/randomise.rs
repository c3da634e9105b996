//! What differs between environments: masses, inertias, rotors, motors, drag, wind, hidden loads; at the start of a run or
//! of every episode.
//!
//! A [`Randomisation`] names a quantity, a distribution and a time. Draws belong to the environment and episode (see
//! [`rng`](rng)), so they do not depend on the size of the batch. Changes apply in the order given; thrust as a ratio
//! to weight uses the mass of that moment. What could leave the physical is refused when the environment is built; rotors
//! start at the speed that carries the weight drawn. A curriculum takes a share of every change
//! ([`Env::set_difficulty`](super::Env::set_difficulty)).

use super::mass_groups::{MOST_OF_OTHERS, MassGroup, flocks, settle};
use super::robot::{Inertial, Robot};
use super::start::{Draw, Draws, StartScalar};
use base::error::{Error, Result, finite};
use dynamics::domain::Domain;
use dynamics::rigid::BODY_PARAMETERS;
use dynamics::rotor::{N_ROTOR_PARAMETER, at};
use dynamics::tree::LINK_PARAMETERS;
use serde::{Deserialize, Serialize};

/// What changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RandomisedQuantity {
    /// Of every drone's body, with its inertia (density changes).
    Mass,
    /// Principal moments of every drone's body, mass unchanged; kept physical (none above the sum of the others).
    Inertia,
    /// Of every drone's body, per axis.
    CenterOfMass,
    /// k_f of every rotor.
    Thrust,
    /// k_f of every rotor, times the ratio of the drone's mass to its nominal one.
    ThrustToWeight,
    /// k_m/k_f of every rotor.
    MomentPerThrust,
    /// Motor time constants of every rotor, s.
    MotorTime,
    /// Linear drag of every drone's body.
    Drag,
    /// Angular drag of every drone's body.
    AngularDrag,
    /// Constant wind per axis, m/s, world; `set` only.
    Wind,
    /// A box of 0.1 × 0.1 × 0.15 m stuck to every drone, mass as a share of the drone's; `set` only.
    HiddenMass,
    /// The height at which the hidden mass sits, m, body z; `set` only, before `hidden_mass`.
    HiddenHeight,
    /// Any number of the robot by its name, see [`Robot::parameter_names`].
    Number(String),
}

/// How a drawn number acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RandomisationOperation {
    /// Times the nominal value.
    #[default]
    Scale,
    /// Added to it.
    Add,
    /// In its place.
    Set,
}

/// When it is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RandomisationTime {
    /// For every episode.
    #[default]
    Reset,
    /// Once per environment.
    Startup,
}

/// From what it is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// Uniform over the range.
    #[default]
    Uniform,
    /// Its logarithm uniform over that of the range: as often halved as doubled.
    LogUniform,
    /// Normal about the middle of the range, σ a quarter of its width; what falls outside is drawn again.
    Normal,
}

impl Distribution {
    fn is_uniform(&self) -> bool {
        *self == Self::Uniform
    }
}

/// One randomised quantity. In TOML:
///
/// ```toml
/// [[randomise]]
/// what = "thrust"
/// range = [0.8, 1.25]
/// distribution = "log_uniform"
/// each = true
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Randomisation {
    /// What changes.
    pub what: RandomisedQuantity,
    /// Lowest and highest: factors with `scale`, else in the unit of the quantity.
    pub range: [f64; 2],
    /// How it is spread between them. Default uniform.
    #[serde(default, skip_serializing_if = "Distribution::is_uniform")]
    pub distribution: Distribution,
    /// How a draw acts on the nominal value. Default `scale`.
    #[serde(default)]
    pub by: RandomisationOperation,
    /// When it is drawn. Default `reset`.
    #[serde(default)]
    pub when: RandomisationTime,
    /// Whether every rotor (axis, drone) has a draw of its own, or all one in common. Default false.
    #[serde(default)]
    pub each: bool,
}

impl Randomisation {
    /// Uniform factors on a quantity, drawn for every episode.
    pub fn scale(what: RandomisedQuantity, low: f64, high: f64) -> Self {
        let (distribution, by, when) = Default::default();
        Self { what, range: [low, high], distribution, by, when, each: false }
    }

    /// Checks the range.
    ///
    /// # Errors
    /// [`Error::Value`] naming the quantity.
    pub fn validate(&self) -> Result<()> {
        let what = format!("randomise.{:?}.range", self.what);
        finite(&what, &self.range)?;
        let [low, high] = self.range;
        if let Some(large) = self.range.iter().find(|x| x.abs() > MOST) {
            return Err(Error::value(what, large, format!("within ±{MOST:e}"), "Batches compute in f32."));
        }
        if low > high {
            return Err(Error::value(what, format!("[{low}, {high}]"), "ordered", "Give the lower end first."));
        }
        // of a number by its name, and of what is added to, the robot decides
        self.keeps(match &self.what {
            RandomisedQuantity::CenterOfMass
            | RandomisedQuantity::Wind
            | RandomisedQuantity::HiddenHeight
            | RandomisedQuantity::Number(_) => Domain::AnySign,
            RandomisedQuantity::Drag
            | RandomisedQuantity::AngularDrag
            | RandomisedQuantity::HiddenMass
            | RandomisedQuantity::MomentPerThrust => Domain::NonNegative,
            _ => Domain::Positive,
        })?;
        if self.distribution == Distribution::LogUniform && low <= 0.0 {
            return Err(Error::value(what, low, "> 0 for log_uniform", "Use uniform where values may be negative."));
        }
        let only_set = matches!(
            self.what,
            RandomisedQuantity::Wind | RandomisedQuantity::HiddenMass | RandomisedQuantity::HiddenHeight
        );
        if only_set && self.by != RandomisationOperation::Set {
            let what = format!("randomise.{:?}.by", self.what);
            return Err(Error::value(what, format!("{:?}", self.by), "set", "Nominally it is zero."));
        }
        Ok(())
    }

    /// Refuses factors and values that a number of this domain may not have.
    fn keeps(&self, domain: Domain) -> Result<()> {
        let (what, low) = (format!("randomise.{:?}.range", self.what), self.range[0]);
        if domain == Domain::Spin {
            let remedy = "A rotor turns one way or the other: build the vehicle that you mean.";
            return Err(Error::value(what, low, "of a number that may vary", remedy));
        }
        if self.by != RandomisationOperation::Add && !domain.allows(low) {
            return Err(Error::value(what, low, domain.rule(), "Factors and values of it do not change its sign."));
        }
        Ok(())
    }

    /// Whether it makes wind.
    pub fn blows(&self) -> bool {
        self.what == RandomisedQuantity::Wind
    }
}

/// A change with the places of its numbers.
#[derive(Debug, Clone)]
struct Prepared {
    change: Randomisation,
    /// Groups that share a draw unless `each`.
    places: Vec<usize>,
}

/// All changes, prepared for a robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Randomiser {
    changes: Vec<Prepared>,
    /// Bodies of the drones.
    bodies: Vec<usize>,
    /// Rotors of each drone, and where its numbers begin.
    rotors: Vec<Vec<usize>>,
    nominal: Vec<f64>,
    /// Trees whose weight or lift changes.
    flocks: Vec<MassGroup>,
    /// Where inertias begin that could become unphysical.
    inertias: Vec<usize>,
}

impl Randomiser {
    /// The robot with all numbers that the changes touch varying, and what changes them.
    pub(crate) fn new(changes: &[Randomisation], robot: &Robot) -> Result<Self> {
        let (names, domains) = (robot.parameter_names(), robot.parameter_domains());
        let (bodies, rotors) = places(robot);
        let nominal = robot.parameters();
        let mut least = nominal.clone();
        let mut own = Self { changes: Vec::new(), bodies, rotors, nominal, flocks: Vec::new(), inertias: Vec::new() };
        for change in changes {
            change.validate()?;
            let places = own.touched(change, &names)?;
            own.check(change, &places, (&names, &domains), &mut least)?;
            own.changes.push(Prepared { change: change.clone(), places });
        }
        let flocks = flocks(robot);
        if own.varied().any(|k| flocks.iter().any(|f| f.depends_on(k))) {
            own.flocks = flocks;
        }
        own.inertias = (0..robot.n_frame())
            .map(|body| Inertial::place(body) + 4)
            .filter(|at| {
                let own = own
                    .changes
                    .iter()
                    .filter(|c| matches!(c.change.what, RandomisedQuantity::Inertia | RandomisedQuantity::Number(_)));
                own.flat_map(|c| &c.places).any(|k| (*at..at + 6).contains(k))
            })
            .collect();
        Ok(own)
    }

    /// Refuses what could leave the physical, whatever is drawn; `least` are the smallest values before and behind the
    /// change. What interpolates between two values that are physical is so too.
    fn check(
        &self,
        change: &Randomisation,
        places: &[usize],
        known: (&[String], &[Domain]),
        least: &mut [f64],
    ) -> Result<()> {
        let (names, domains) = known;
        let low = change.range[0];
        for k in places {
            // a mass takes its inertia along, at a ratio that stays positive as the mass does
            let is_mass =
                change.what != RandomisedQuantity::Mass || self.bodies.iter().any(|b| Inertial::place(*b) == *k);
            let domain = domains[*k];
            if matches!(change.what, RandomisedQuantity::Number(_)) {
                change.keeps(domain)?;
            }
            if !domain.keeps_sign() || !is_mass {
                continue;
            }
            let mut full = change.applied(least[*k], low, 1.0);
            if change.what == RandomisedQuantity::ThrustToWeight {
                full *= self.heavier(*k, least);
            }
            if !domain.allows(full) {
                let what = format!("randomise.{:?}.range", change.what);
                let rule = format!("such that {} ≥ {:.3e} stays {}", names[*k], least[*k], domain.rule());
                return Err(Error::value(what, low, rule, "Raise the lower end."));
            }
            least[*k] = least[*k].min(full);
            if change.what == RandomisedQuantity::Mass && change.by != RandomisationOperation::Scale {
                let ratio = (full / self.nominal[*k]).min(1.0);
                least[k + 4..k + 7].iter_mut().for_each(|moment| *moment *= ratio);
            } else if change.what == RandomisedQuantity::Mass {
                least[k + 4..k + 7].iter_mut().for_each(|moment| *moment *= low.min(1.0));
            }
        }
        Ok(())
    }

    /// All numbers that changes touch.
    pub(crate) fn varied(&self) -> impl Iterator<Item = usize> + '_ {
        let inertial = self.changes.iter().any(|c| c.change.what == RandomisedQuantity::HiddenMass);
        let bodies = self.bodies.iter().filter(move |_| inertial).flat_map(|b| {
            let place = Inertial::place(*b);
            place..place + 10
        });
        self.changes.iter().flat_map(|c| c.places.iter().copied()).chain(bodies)
    }

    /// Whether there is a wind among them.
    pub(crate) fn blows(&self) -> bool {
        self.changes.iter().any(|c| c.change.blows())
    }

    fn touched(&self, change: &Randomisation, names: &[String]) -> Result<Vec<usize>> {
        let of_bodies = |range: std::ops::Range<usize>| {
            self.bodies.iter().flat_map(|b| range.clone().map(|k| Inertial::place(*b) + k)).collect()
        };
        let of_rotors =
            |which: &[usize]| self.rotors.iter().flatten().flat_map(|at| which.iter().map(move |k| at + k)).collect();
        Ok(match &change.what {
            RandomisedQuantity::Mass => of_bodies(0..10),
            RandomisedQuantity::Inertia => of_bodies(4..10),
            RandomisedQuantity::CenterOfMass => of_bodies(1..4),
            RandomisedQuantity::Drag => of_bodies(DRAG..DRAG + 3),
            RandomisedQuantity::AngularDrag => of_bodies(ANGULAR_DRAG..ANGULAR_DRAG + 3),
            RandomisedQuantity::Thrust | RandomisedQuantity::ThrustToWeight => of_rotors(&[at::thrust_coefficient]),
            RandomisedQuantity::MomentPerThrust => of_rotors(&[at::moment_per_thrust]),
            RandomisedQuantity::MotorTime => of_rotors(&[at::time_constant_up, at::time_constant_down]),
            RandomisedQuantity::Wind | RandomisedQuantity::HiddenMass | RandomisedQuantity::HiddenHeight => Vec::new(),
            RandomisedQuantity::Number(name) => match names.iter().position(|n| n == name) {
                Some(k) => vec![k],
                None => {
                    return Err(Error::Unknown { kind: "physical number", name: name.clone(), known: names.to_vec() });
                }
            },
        })
    }

    /// Draws everything of one episode into `numbers` and `wind`, `share` of every change: from the draws of that episode and those
    /// that stay for a run.
    pub(crate) fn apply<S: StartScalar>(
        &self,
        [mut now, mut once]: [Draws<'_, S>; 2],
        share: S,
        numbers: &mut [S],
        wind: &mut [S; 3],
    ) {
        let mut height = S::zero();
        for prepared in &self.changes {
            let change = &prepared.change;
            let draws = if change.when == RandomisationTime::Reset { &mut now } else { &mut once };
            match change.what {
                RandomisedQuantity::Wind => *wind = [0, 1, 2].map(|_| share * change.draw(draws)),
                RandomisedQuantity::HiddenHeight => height = share * change.draw(draws),
                RandomisedQuantity::HiddenMass => self.hide(change, (draws, share), height, numbers),
                RandomisedQuantity::Mass => self.weigh(change, (draws, share), numbers),
                RandomisedQuantity::Inertia => self.spread(change, (draws, share), numbers),
                _ => self.vary(prepared, (draws, share), numbers),
            }
        }
        self.inertias.iter().for_each(|at| settle(&mut numbers[*at..at + 6]));
    }

    /// Rotors that a task left at rest speed in `state` turn such that each tree carries the weight that was drawn, all its
    /// rotors at the same share of their largest thrust.
    pub(crate) fn hover<S: StartScalar>(&self, rest: &[f64], numbers: &[S], state: &mut [S]) {
        self.flocks.iter().for_each(|flock| flock.hover(rest, &self.nominal, numbers, state));
    }

    fn vary<S: StartScalar>(&self, prepared: &Prepared, (draws, share): (&mut Draws<'_, S>, S), numbers: &mut [S]) {
        let change = &prepared.change;
        let mut drawn = change.draw(draws);
        for (i, k) in prepared.places.iter().enumerate() {
            if change.each && i > 0 {
                drawn = change.draw(draws);
            }
            let mut value = change.applied(numbers[*k], drawn, share);
            if change.what == RandomisedQuantity::ThrustToWeight {
                value *= self.heavier(*k, numbers);
            }
            numbers[*k] = value;
        }
    }

    /// Mass over nominal mass of the drone that carries the rotor with a number at `k`.
    fn heavier<S: StartScalar>(&self, k: usize, numbers: &[S]) -> S {
        let n = N_ROTOR_PARAMETER;
        let owner = self.rotors.iter().position(|own| own.iter().any(|at| (*at..at + n).contains(&k)));
        let place = Inertial::place(self.bodies[owner.unwrap_or(0)]);
        numbers[place] * S::from(1.0 / self.nominal[place])
    }

    fn weigh<S: StartScalar>(&self, change: &Randomisation, (draws, share): (&mut Draws<'_, S>, S), numbers: &mut [S]) {
        let mut drawn = change.draw(draws);
        for (i, body) in self.bodies.iter().enumerate() {
            if change.each && i > 0 {
                drawn = change.draw(draws);
            }
            let own = Inertial::read(numbers, *body);
            let mass = change.applied(own.mass, drawn, share);
            own.scaled(mass / own.mass).write(numbers, *body);
        }
    }

    fn spread<S: StartScalar>(
        &self,
        change: &Randomisation,
        (draws, share): (&mut Draws<'_, S>, S),
        numbers: &mut [S],
    ) {
        for body in &self.bodies {
            let place = Inertial::place(*body) + 4;
            let common = change.draw(draws);
            let mut factors = [common; 3];
            if change.each {
                factors = [common, change.draw(draws), change.draw(draws)];
            }
            let mut moments = [0, 1, 2].map(|i| change.applied(numbers[place + i], factors[i], share));
            for i in 0..3 {
                let others = moments[(i + 1) % 3] + moments[(i + 2) % 3];
                moments[i] = moments[i].min(S::from(MOST_OF_OTHERS) * others);
            }
            // products stay below what the smaller of their axes can carry
            for (k, (a, b)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
                let nominal = &self.nominal[place..];
                let share = nominal[3 + k] / (nominal[a] * nominal[b]).sqrt();
                numbers[place + 3 + k] = S::from(share) * moments[a].sqrt() * moments[b].sqrt();
            }
            numbers[place..place + 3].copy_from_slice(&moments);
        }
    }

    fn hide<S: StartScalar>(
        &self,
        change: &Randomisation,
        (draws, share): (&mut Draws<'_, S>, S),
        height: S,
        numbers: &mut [S],
    ) {
        let mut drawn = change.draw(draws);
        for (i, body) in self.bodies.iter().enumerate() {
            if change.each && i > 0 {
                drawn = change.draw(draws);
            }
            let own = Inertial::read(numbers, *body);
            let mass = share * drawn * S::from(self.nominal[Inertial::place(*body)]);
            own.and(&Inertial::cuboid(mass, HIDDEN_BOX, [S::zero(), S::zero(), height])).write(numbers, *body);
        }
    }
}

/// Largest number of a range.
const MOST: f64 = 1e9;
/// Edges of the hidden load, m.
const HIDDEN_BOX: [f64; 3] = [0.1, 0.1, 0.15];
const DRAG: usize = 10;
const ANGULAR_DRAG: usize = 16;

/// Bodies of the drones, and where the numbers of their rotors begin.
fn places(robot: &Robot) -> (Vec<usize>, Vec<Vec<usize>>) {
    let n_body = robot.n_frame();
    let begin = |r: usize| match robot.model() {
        None => BODY_PARAMETERS.len() + r * N_ROTOR_PARAMETER,
        Some(_) => 1 + n_body * LINK_PARAMETERS.len() + r * N_ROTOR_PARAMETER,
    };
    match robot.model() {
        None => (vec![0], vec![(0..robot.drone().rotors.len()).map(begin).collect()]),
        Some(m) => (
            m.drones().iter().map(|d| d.body).collect(),
            m.drones().iter().map(|d| d.rotors.iter().map(|r| begin(*r)).collect()).collect(),
        ),
    }
}

impl Randomisation {
    fn draw<S: StartScalar>(&self, draws: &mut Draws<'_, S>) -> S {
        let [low, high] = self.range;
        match self.distribution {
            Distribution::Uniform => draws.uniform(low, high),
            Distribution::LogUniform => draws.uniform(low.ln(), high.ln()).exp().max(low.into()).min(high.into()),
            // ±2σ: one draw in twenty-two is repeated
            Distribution::Normal => {
                draws.number(Draw::NormalWithin(2.0)) * S::from(0.25 * (high - low)) + S::from(0.5 * (low + high))
            }
        }
    }

    /// The value that a draw makes of another, at this share of the change.
    fn applied<S: StartScalar>(&self, value: S, drawn: S, share: S) -> S {
        let full = match self.by {
            RandomisationOperation::Scale => value * drawn,
            RandomisationOperation::Add => value + drawn,
            RandomisationOperation::Set => drawn,
        };
        // exact at either end
        (S::one() - share) * value + share * full
    }
}
