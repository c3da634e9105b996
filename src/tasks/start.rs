//! How an episode begins, and what an event changes: draws, and where they go.
//!
//! Starts and events are recorded as steps are: a task says once what becomes of numbers that the host draws. What it does with
//! them is a program's arithmetic, in `f32`; the draws are made in `f64` and rounded once. So nothing branches on a draw;
//! [`Scalar::select`] picks, and [`Start::again`] draws again what is not accepted. A task whose starts no recording can hold
//! (assignments, searches) begins on the host: [`HostStart`](super::HostStart).

use super::declare::Goal;
use super::grove::{Grove, MAX_TRUNKS};
use super::robot::Robot;
use autodiff::{Scalar, Trace, TraceMask};
use base::error::{Error, Result};
use dynamics::spatial::{Quat, Vec3, from_euler, rotate};
use rng::{Purpose, Stream, below, ln, normal, to_f32_below_one, unit};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::f64::consts::{PI, TAU};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f64 {}
    impl Sealed for autodiff::Trace {}
}

/// Numbers that starts are made of: recorded ones, or plain ones on the host.
pub trait StartScalar: Scalar + From<f64> + sealed::Sealed {
    /// Whether a truth holds that depends on no input of a recording.
    #[doc(hidden)]
    fn holds(mask: Self::Mask) -> bool;

    /// Its value, where it depends on no input of a recording.
    #[doc(hidden)]
    fn value(self) -> Option<f64>;
}

impl StartScalar for f64 {
    fn holds(mask: bool) -> bool {
        mask
    }
    fn value(self) -> Option<f64> {
        Some(self)
    }
}

impl StartScalar for Trace {
    fn holds(mask: TraceMask) -> bool {
        flag::<Self>(mask).known() == Some(1.0)
    }
    fn value(self) -> Option<f64> {
        self.known()
    }
}

/// What is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Draw {
    /// Uniform in [0, 1).
    Unit,
    /// Standard normal.
    Normal,
    /// Standard normal, drawn again while it is farther from zero than this.
    NormalWithin(f64),
    /// Uniform among the whole numbers below this one; 0 where it is 0.
    Below(u64),
    /// 1, 2, …, in the mean m ≥ 1: 1 + ⌊ln(1 − u)/ln(1 − 1/m)⌋ of a unit draw u.
    Geometric(f64),
}

/// A draw that may be left out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Drawing {
    pub draw: Draw,
    /// A unit draw comes before it; unless that is less than this, nothing is drawn.
    pub chance: Option<f64>,
}

/// What stands for a draw that was left out.
pub(crate) const LEFT_OUT: f64 = -1e30;

impl Draw {
    fn number(self, next: &mut impl FnMut() -> u64) -> f64 {
        match self {
            Self::Unit => unit(next()),
            Self::Normal => normal(next(), next()),
            Self::NormalWithin(bound) => {
                // of a bound that is none of [`Draw::check`]'s the thousandth is cut
                let mut z = normal(next(), next());
                for _ in 1..1000 {
                    if z.abs() <= bound {
                        break;
                    }
                    z = normal(next(), next());
                }
                z.max(-bound.abs()).min(bound.abs())
            }
            Self::Below(n) => below(next(), n) as f64,
            Self::Geometric(mean) => 1.0 + (ln(1.0 - unit(next())) / (1.0 - 1.0 / mean.max(1.0)).ln()).floor(),
        }
    }

    /// Refuses what is no distribution, or none of `f32`.
    ///
    /// # Errors
    /// [`Error::Value`] naming it.
    fn check(self) -> Result<()> {
        let (is_sound, limit, remedy) = match self {
            Self::Unit | Self::Normal => return Ok(()),
            Self::NormalWithin(bound) => (
                bound >= 0.1,
                "of a bound of 0.1 or more",
                "What is farther away is drawn again: ask for a narrower normal.",
            ),
            Self::Below(n) => {
                (n <= 1 << 24, "of 2^24 numbers at most", "Batches compute in f32: draw several, or on the host.")
            }
            Self::Geometric(mean) => ((1.0..1e9).contains(&mean), "of a mean from 1 to 1e9", "It counts steps."),
        };
        if is_sound { Ok(()) } else { Err(Error::value("draw", format!("{self:?}"), limit, remedy)) }
    }

    /// Words that it takes, the least.
    fn words(self) -> u64 {
        if matches!(self, Self::Normal | Self::NormalWithin(_)) { 4 } else { 2 }
    }
}

impl Drawing {
    /// As [`Draw::check`], with a chance that is one.
    ///
    /// # Errors
    /// [`Error::Value`] naming it.
    pub(crate) fn check(self) -> Result<()> {
        if let Some(chance) = self.chance.filter(|chance| !(0.0..=1.0).contains(chance)) {
            return Err(Error::value("chance of a draw", chance, "from 0 to 1", "It is a share of episodes."));
        }
        self.draw.check()
    }

    /// Words that it takes, the least.
    pub(crate) fn words(self) -> u64 {
        self.draw.words() + if self.chance.is_some() { 2 } else { 0 }
    }

    /// From the next words of a stream.
    pub(crate) fn number(self, mut next: impl FnMut() -> u64) -> f64 {
        match self.chance {
            Some(chance) if unit(next()) >= chance => LEFT_OUT,
            _ => self.draw.number(&mut next),
        }
    }

    /// Likewise, rounded once to `f32`, and never to the open end of its range.
    #[inline]
    pub(crate) fn rounded(self, mut next: impl FnMut() -> u64) -> f32 {
        // nearly all are of this kind
        if let Self { draw: Draw::Unit, chance: None } = self {
            return to_f32_below_one(unit(next()));
        }
        let number = self.number(next);
        if self.draw == Draw::Unit { to_f32_below_one(number) } else { number as f32 }
    }
}

/// Draws of many numbers at once, by what makes them: on the host, since how many words they take depends on numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum ManyDraw {
    /// Where the trunks of a forest stand, of which the operand says how many do: [`Grove::place`].
    Forest(Box<Grove>),
}

impl ManyDraw {
    /// Most numbers of one.
    const MOST: usize = 3 * MAX_TRUNKS;
    const MOST_OPERANDS: usize = 1;

    /// Numbers that it depends on.
    pub fn n_operand(&self) -> usize {
        match self {
            Self::Forest(_) => 1,
        }
    }

    /// Numbers that it draws.
    pub fn n_drawn(&self) -> usize {
        match self {
            Self::Forest(grove) => 3 * grove.trunks().len(),
        }
    }

    fn draw(&self, operands: &[f64], stream: &mut Stream, drawn: &mut [f64]) {
        match self {
            Self::Forest(grove) => grove.place(operands[0], stream, drawn),
        }
    }
}

/// Where numbers come from.
pub(crate) trait Source<S: Scalar> {
    /// The next of a stream.
    fn draw(&mut self, stream: usize, drawing: Drawing) -> S;

    /// A whole number below `n` that is none of `taken`.
    fn draw_other(&mut self, stream: usize, n: u64, taken: &[S]) -> S;

    /// Many at once, into `drawn`.
    fn draw_many(&mut self, stream: usize, drawing: &ManyDraw, operands: &[S], drawn: &mut [S]);

    /// What follows may be drawn again, until it was drawn `most` times.
    fn begin_again(&mut self, most: usize);

    /// Whether what was drawn stays.
    fn stays(&mut self, accepted: S::Mask, is_last: bool) -> bool;

    /// A stream, where draws are made at once.
    fn stream(&mut self, _stream: usize) -> Option<&mut Stream> {
        None
    }
}

/// How often a number is drawn again that is taken: with one of 32 free, all such draws fail once in e⁵⁰ times.
const MOST_DRAWN: usize = 1600;

/// Draws by streams, in `f64`: for starts on the host, and for recordings of which only constants are asked.
pub(crate) struct Streams<const N: usize>([Stream; N]);

impl<const N: usize> Streams<N> {
    /// By the key of each, from this word on.
    fn new(key: impl Fn(usize) -> [u64; 4], position: u64) -> Self {
        Self(std::array::from_fn(|k| Stream::restore(key(k), position)))
    }
}

impl Streams<STREAMS> {
    /// Where an episode begins.
    pub(crate) fn of_start(key: [u64; 3]) -> RefCell<Self> {
        RefCell::new(Self::new(|stream| key_of_start(key, stream), 0))
    }
}

impl Streams<3> {
    /// Of the event in a step.
    pub(crate) fn of_event(key: [u64; 3], step: f32) -> RefCell<Self> {
        RefCell::new(Self::new(|stream| key_of_event(key, stream), position_of_event(step)))
    }
}

impl<S: StartScalar, const N: usize> Source<S> for Streams<N> {
    fn draw(&mut self, stream: usize, drawing: Drawing) -> S {
        S::from(drawing.number(|| self.0[stream].next_u64()))
    }

    fn draw_other(&mut self, stream: usize, n: u64, taken: &[S]) -> S {
        let mut drawn = below(self.0[stream].next_u64(), n) as f64;
        for _ in 1..MOST_DRAWN {
            if !taken.iter().any(|own| own.value() == Some(drawn)) {
                break;
            }
            drawn = below(self.0[stream].next_u64(), n) as f64;
        }
        S::from(drawn)
    }

    fn draw_many(&mut self, stream: usize, drawing: &ManyDraw, operands: &[S], drawn: &mut [S]) {
        let (mut known, mut numbers) = ([0.0; ManyDraw::MOST_OPERANDS], [0.0; ManyDraw::MOST]);
        known.iter_mut().zip(operands).for_each(|(known, own)| *known = own.value().unwrap_or(f64::NAN));
        let numbers = &mut numbers[..drawn.len()];
        drawing.draw(&known[..operands.len()], &mut self.0[stream], numbers);
        drawn.iter_mut().zip(numbers).for_each(|(own, number)| *own = S::from(*number));
    }

    fn begin_again(&mut self, _most: usize) {}

    fn stays(&mut self, accepted: S::Mask, is_last: bool) -> bool {
        S::holds(accepted) || is_last
    }

    fn stream(&mut self, stream: usize) -> Option<&mut Stream> {
        Some(&mut self.0[stream])
    }
}

/// A stream of draws that belongs to an environment and an episode: see [`rng`](rng).
pub struct Draws<'a, S = Trace> {
    source: &'a RefCell<dyn Source<S> + 'a>,
    stream: usize,
}

impl<'a, S: StartScalar> Draws<'a, S> {
    pub(crate) fn new(source: &'a RefCell<dyn Source<S> + 'a>, stream: usize) -> Self {
        Self { source, stream }
    }

    /// The next number.
    pub fn number(&mut self, draw: Draw) -> S {
        self.source.borrow_mut().draw(self.stream, Drawing { draw, chance: None })
    }

    /// With this chance true and a number, else false and one that means nothing: a unit draw that is less than the chance, and behind
    /// it the number.
    pub fn sometimes(&mut self, chance: f64, draw: Draw) -> (S::Mask, S) {
        let number = self.source.borrow_mut().draw(self.stream, Drawing { draw, chance: Some(chance) });
        (S::constant(0.5 * LEFT_OUT).lt(number), number)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> S {
        self.number(Draw::Unit)
    }

    /// `low` + (`high` − `low`) u of a unit draw u: uniform in [`low`, `high`], which rounding may leave by a last bit.
    pub fn uniform(&mut self, low: impl Into<S>, high: impl Into<S>) -> S {
        let (low, high) = (low.into(), high.into());
        low + (high - low) * self.unit()
    }

    /// A whole number, uniform in 0..`n`; exact to 2²⁴.
    pub fn below(&mut self, n: u64) -> S {
        self.number(Draw::Below(n))
    }

    /// A whole number, uniform among those of 0..`n` that are none of `taken`, of which there are fewer: drawn again while it is. Only
    /// where episodes begin on the host ([`HostStart`](super::HostStart)).
    pub fn below_other_than(&mut self, n: u64, taken: &[S]) -> S {
        self.source.borrow_mut().draw_other(self.stream, n, taken)
    }

    /// Many numbers at once into `drawn`, [`n_drawn`](ManyDraw::n_drawn) of them. Only where episodes begin on the host.
    ///
    /// # Panics
    /// For another number of operands or drawn numbers.
    pub fn many(&mut self, drawing: &ManyDraw, operands: &[S], drawn: &mut [S]) {
        let sizes = (drawing.n_operand(), drawing.n_drawn());
        assert_eq!((operands.len(), drawn.len()), sizes, "operands and numbers of a draw");
        self.source.borrow_mut().draw_many(self.stream, drawing, operands, drawn);
    }

    /// Standard normal.
    pub fn normal(&mut self) -> S {
        self.number(Draw::Normal)
    }

    /// Steps until something happens that comes once in `mean` ≥ 1 steps: 1 or more.
    pub fn geometric(&mut self, mean: f64) -> S {
        self.number(Draw::Geometric(mean))
    }
}

impl Draws<'_, f64> {
    /// The stream itself, for what draws from one.
    ///
    /// # Panics
    /// Never: on the host, draws are made at once.
    pub fn stream<R>(&mut self, draw: impl FnOnce(&mut Stream) -> R) -> R {
        draw(self.source.borrow_mut().stream(self.stream).expect("draws on the host are of streams"))
    }
}

/// The start of an episode or an event in one: draws, and where they go. In an event goal, task state and numbers are those in force,
/// and the goal is changed by place.
///
/// ```
/// # use omnidrones_tasks::omnidrones;
/// use omnidrones::tasks::Start;
/// use omnidrones::tasks::robot::Inertial;
///
/// /// Another mass in every episode, of a robot that is `varying_inertial(0)`; a height to hold.
/// fn start(start: &mut Start) {
///     let factor = start.task.uniform(0.8, 1.2);
///     Inertial::read(start.numbers, 0).scaled(factor).write(start.numbers, 0);
///     let height = start.task.uniform(1.0, 3.0);
///     start.goal.field("height", "m, world", "to hold").number(height);
///     start.event_at = start.task.geometric(100.0);
/// }
///
/// /// Another height, every hundred steps on average.
/// fn event(start: &mut Start) {
///     start.goal[0] = start.task.uniform(1.0, 3.0);
///     start.event_at += start.task.geometric(100.0);
/// }
/// ```
pub struct Start<'a, S = Trace> {
    /// What flies.
    pub robot: &'a Robot,
    /// Of the physics; [`Robot::rest`] until changed. An event sees it and changes nothing.
    pub state: &'a mut [S],
    /// What stays through the episode.
    pub goal: Goal<'a, S>,
    /// What the task keeps from step to step; zeros until changed.
    pub task_state: &'a mut [S],
    /// Physical numbers as in [`Robot::parameters`]: the nominal ones until changed. A change counts where [`Robot::varied`]
    /// names the number.
    pub numbers: &'a mut [S],
    /// Initial states.
    pub reset: Draws<'a, S>,
    /// Goals.
    pub task: Draws<'a, S>,
    /// The same at the start of every episode of an environment: geometry.
    pub once: Draws<'a, S>,
    /// Step behind which [`Task::event`](super::Task::event) is called, the first that is no less; never if it is not finite. In an event
    /// it is the step of now until changed, and no next one comes unless it is put behind.
    pub event_at: S,
    /// Of a curriculum, 0 to 1 ([`Env::set_difficulty`](super::Env::set_difficulty)): what a task makes of it is its own
    /// affair.
    pub difficulty: S,
    source: &'a RefCell<dyn Source<S> + 'a>,
}

/// What a start writes.
pub(crate) struct StartOutput<'a, S> {
    pub robot: &'a Robot,
    pub state: &'a mut [S],
    pub goal: Goal<'a, S>,
    pub task_state: &'a mut [S],
    pub numbers: &'a mut [S],
}

impl<'a, S: StartScalar> Start<'a, S> {
    /// With draws from the first three streams of a source.
    pub(crate) fn new(
        own: StartOutput<'a, S>,
        source: &'a RefCell<dyn Source<S> + 'a>,
        event_at: S,
        difficulty: S,
    ) -> Self {
        let StartOutput { robot, state, goal, task_state, numbers } = own;
        let [reset, task, once] = [0, 1, 2].map(|stream| Draws::new(source, stream));
        Self { robot, state, goal, task_state, numbers, reset, task, once, event_at, difficulty, source }
    }

    /// From a stream, by number.
    pub(crate) fn draw(&mut self, stream: usize, drawing: Drawing) -> S {
        self.source.borrow_mut().draw(stream, drawing)
    }

    /// See [`Draws::below_other_than`].
    pub(crate) fn draw_other(&mut self, stream: usize, n: u64, taken: &[S]) -> S {
        self.source.borrow_mut().draw_other(stream, n, taken)
    }

    /// See [`Draws::many`].
    pub(crate) fn draw_many(&mut self, stream: usize, drawing: &ManyDraw, operands: &[S], drawn: &mut [S]) {
        self.source.borrow_mut().draw_many(stream, drawing, operands, drawn);
    }

    /// Draws again and again until what was drawn is accepted, once at least and `most` times at most: the last stays as it is. One
    /// such part in a recorded start and one in an event, whose streams have 256 words for every step, a uniform number two of them
    /// and a normal one four; what an attempt changes must not depend on what the one before it did.
    ///
    /// ```
    /// # use omnidrones_tasks::omnidrones;
    /// use omnidrones::tasks::Start;
    ///
    /// /// Somewhere in a cylinder.
    /// fn place(start: &mut Start) {
    ///     start.again(100, |start| {
    ///         let [x, y, z] = start.position([[-1.0, 1.0], [-1.0, 1.0], [1.0, 2.0]]);
    ///         start.place(0, [x, y, z], [1.0, 0.0, 0.0, 0.0]);
    ///         (x * x + y * y).lt(1.0)
    ///     });
    /// }
    /// ```
    pub fn again(&mut self, most: usize, mut attempt: impl FnMut(&mut Self) -> S::Mask) {
        self.source.borrow_mut().begin_again(most);
        for time in 1.. {
            let accepted = attempt(self);
            if self.source.borrow_mut().stays(accepted, time >= most) {
                return;
            }
        }
    }

    /// Moves the root of tree `tree`: position, world, m, and attitude, of the axes in which it hovers level
    /// ([`Vehicle::upright`](dynamics::Vehicle::upright)): a vehicle that leans in hover leans so from there.
    ///
    /// # Panics
    /// If there is no such tree.
    pub fn place(&mut self, tree: usize, position: [impl Into<S>; 3], attitude: [impl Into<S>; 4]) {
        let at = self.robot.roots()[tree];
        let attitude = self.robot.attitude_of_body(tree, attitude.map(Into::into));
        self.state[at..at + 3].copy_from_slice(&position.map(Into::into));
        self.state[at + 6..at + 10].copy_from_slice(&attitude);
    }

    /// Lets all rotors turn `factor` times as fast as they do, no faster than they can.
    pub fn spin_up(&mut self, factor: impl Into<S>) {
        let factor = factor.into();
        for rotor in self.robot.drones().iter().flat_map(|drone| &drone.rotors) {
            self.state[rotor.speed] = (factor * self.state[rotor.speed]).min(rotor.max_speed.into());
        }
    }

    /// As [`Start::place`] such that the point `local` (m, root axes) of the root comes to `point` (m, world).
    ///
    /// # Panics
    /// If there is no such tree.
    pub fn place_point(
        &mut self,
        tree: usize,
        local: Vec3<f64>,
        point: [impl Into<S>; 3],
        attitude: [impl Into<S>; 4],
    ) {
        let attitude = attitude.map(Into::into);
        let lever = rotate(self.robot.attitude_of_body(tree, attitude), local.map(S::from));
        let point = point.map(Into::into);
        self.place(tree, [0, 1, 2].map(|i| point[i] - lever[i]), attitude);
    }

    /// Uniform in a box: lowest and highest per axis, m, world.
    pub fn position(&mut self, range: [[impl Into<S>; 2]; 3]) -> Vec3<S> {
        range.map(|[low, high]| self.reset.uniform(low, high))
    }

    /// Attitude with roll and pitch uniform within ±`tilt` and yaw uniform within `yaw`, rad; `[w, x, y, z]`.
    pub fn attitude(&mut self, tilt: impl Into<S>, yaw: [impl Into<S>; 2]) -> Quat<S> {
        let (tilt, [low, high]) = (tilt.into(), yaw);
        let (roll, pitch) = (self.reset.uniform(-tilt, tilt), self.reset.uniform(-tilt, tilt));
        from_euler(roll, pitch, self.reset.uniform(low, high))
    }
}

/// A factor of a curriculum that is `ease` at difficulty 0 and 1 at difficulty 1.
pub(crate) fn eased<S: Scalar>(ease: f64, difficulty: S) -> S {
    S::one() - S::constant(1.0 - ease) * (S::one() - difficulty)
}

/// A truth as 1 or 0.
pub(crate) fn flag<S: Scalar>(mask: S::Mask) -> S {
    S::select(mask, S::one(), S::zero())
}

/// Any yaw.
pub const ANY_YAW: [f64; 2] = [0.0, TAU];
/// Roll and pitch of most starts, rad.
pub const START_TILT: f64 = 0.2 * PI;

/// Of a stream of one episode: those of [`Start`] first, then those of what is randomised.
pub(crate) fn key_of_start([seed, environment, episode]: [u64; 3], stream: usize) -> [u64; 4] {
    let (of, purpose) = purpose_of_start(stream);
    let episode = match of {
        Episode::Own => episode,
        Episode::Fixed(number) => number,
    };
    [seed, environment, episode, purpose.0]
}

/// The episode that a stream is keyed by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Episode {
    /// Its own.
    Own,
    /// The same in all of them.
    Fixed(u64),
}

/// What a stream of a start is keyed by beside seed and environment.
pub(crate) fn purpose_of_start(stream: usize) -> (Episode, Purpose) {
    match stream {
        0 => (Episode::Own, Purpose::RESET),
        1 => (Episode::Own, Purpose::TASK),
        2 => (Episode::Fixed(u64::MAX), Purpose::PARAMETERS),
        EVERY_EPISODE => (Episode::Own, Purpose::PARAMETERS),
        _ => (Episode::Fixed(0), STARTUP),
    }
}

/// Streams of an episode.
pub(crate) const STREAMS: usize = 5;
/// The stream of what is randomised for every episode.
pub(crate) const EVERY_EPISODE: usize = 3;
/// The stream of what is randomised once.
pub(crate) const ONCE: usize = 4;
/// Draws that stay for a run.
const STARTUP: Purpose = Purpose::user(0x5712);

/// Of a stream of an event.
pub(crate) fn key_of_event([seed, environment, episode]: [u64; 3], stream: usize) -> [u64; 4] {
    [seed, environment, episode, purpose_of_event(stream).0]
}

/// What a stream of an event is keyed by beside seed, environment and episode.
pub(crate) fn purpose_of_event(stream: usize) -> Purpose {
    [Purpose::user(0x0e11), Purpose::DISTURBANCE, Purpose::user(0x0e12)][stream]
}

/// Words of every stream that the event of one step may draw.
pub(crate) const WORDS_OF_EVENT: u64 = 256;

/// The first of them.
pub(crate) fn position_of_event(step: f32) -> u64 {
    WORDS_OF_EVENT * step as u64
}
