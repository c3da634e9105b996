//! A problem whose optimum is known: hold a Hummingbird near its hover at a quadratic cost.

use nalgebra::{DMatrix, DVector};
use omnidrones::autodiff::{Scalar, Trace, TraceMask, safe};
use omnidrones::controllers::design::riccati;
use omnidrones::error::Result;
use omnidrones::tasks::{Ends, Env, EnvConfig, Loss, Robot, Start, Task, View, Writer};

/// Steps of an episode: three times as long as the slowest mode takes to settle.
pub const STEPS: usize = 120;
/// Weights of position, velocity, twice the vector part of the attitude, angular velocity, and of throttles' distance
/// from hover.
pub const WEIGHTS: [f64; 5] = [400.0, 40.0, 100.0, 2.0, 200.0];
const BONUS: f64 = 20.0;
const TARGET: [f64; 3] = [0.0, 0.0, 2.0];
/// Numbers of the deviation: all of the state but w of the quaternion.
pub const N: usize = 16;

/// What is seen is so many times the deviation: numbers of order one learn best.
const SCALE: f64 = 20.0;

/// Weight of number `i` of what is seen.
pub fn weight(i: usize) -> f64 {
    WEIGHTS[(i / 3).min(4)] / (SCALE * SCALE)
}

/// Fly to a point that is near.
pub struct Regulate {
    robot: Robot,
    hover: f64,
    /// Share of episodes in which nothing finite is seen.
    poison: f64,
}

impl Regulate {
    pub fn new(config: &EnvConfig) -> Result<Self> {
        let robot = config.single_robot("hummingbird")?;
        let hover = (0.5 * (robot.hover_input()[0] + 1.0)).sqrt();
        Ok(Self { robot, hover, poison: 0.0 })
    }

    /// Deviations from hover, in the order of the state.
    fn deviation(&self, view: &View, out: &mut Writer) {
        out.field("deviation", "SI", "state less hover");
        let (drone, scale) = (view.drone(0), Trace::constant(SCALE));
        // 0, or NaN
        let poison = Trace::zero() / (Trace::one() - view.goal[0]);
        for i in 0..3 {
            out.number(poison + scale * (drone.position[i] - Trace::constant(TARGET[i])));
        }
        for i in 0..3 {
            out.number(scale * drone.velocity[i]);
        }
        for i in 1..4 {
            out.number(scale * Trace::constant(2.0) * drone.attitude[i]);
        }
        for i in 0..3 {
            out.number(scale * drone.angular_velocity[i]);
        }
        for rotor in 0..4 {
            out.number(scale * (view.throttle(0, rotor) - Trace::constant(self.hover)));
        }
    }

    fn cost<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let drone = view.drone(0);
        let error = [0, 1, 2].map(|i| drone.position[i] - S::constant(TARGET[i]));
        let tilt = [1, 2, 3].map(|i| S::constant(2.0) * drone.attitude[i]);
        let throttle = [0, 1, 2, 3].map(|rotor| view.throttle(0, rotor) - S::constant(self.hover));
        let [p, v, q, w, s] = WEIGHTS.map(S::constant);
        p * safe::squared_norm(error)
            + v * safe::squared_norm(drone.velocity)
            + q * safe::squared_norm(tilt)
            + w * safe::squared_norm(drone.angular_velocity)
            + s * safe::squared_norm(throttle)
    }
}

fn set_poison(start: &mut Start<'_>, poison: impl Into<Trace>) {
    start.goal.field("poison", "-", "1 where what is seen is not finite").number(poison);
}

impl Task for Regulate {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        STEPS
    }
    fn start(&self, start: &mut Start<'_>) {
        let poison = Trace::select(start.task.unit().lt(self.poison), Trace::one(), Trace::zero());
        set_poison(start, poison);
        let position = start.position([[-0.03, 0.03], [-0.03, 0.03], [1.97, 2.03]]);
        let attitude = start.attitude(0.02, [-0.02, 0.02]);
        start.place(0, position, attitude);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        self.deviation(view, out);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        // an end must not be worth seeking
        terms
            .term("cost", "20 − xᵀQx", BONUS)
            .within(f64::NEG_INFINITY, BONUS)
            .number(Trace::constant(BONUS) - self.cost(view));
    }
    fn loss(&self, view: &View, loss: &mut Loss) {
        loss.add("xᵀQx", self.cost(view));
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        let position = view.drone(0).position;
        let error = [0, 1, 2].map(|i| position[i] - Trace::constant(TARGET[i]));
        ends.when("far", "|p − p_t| > 0.5 m", Trace::constant(0.25).lt(safe::squared_norm(error)));
    }
    fn success(&self, view: &View) -> TraceMask {
        self.cost(view).lt(Trace::constant(1.0))
    }
    fn ideal(&self, start: &mut Start<'_>) {
        set_poison(start, 0.0);
        start.place(0, TARGET, [1.0, 0.0, 0.0, 0.0]);
    }
}

pub fn make(config: &EnvConfig) -> Result<Env> {
    Env::of(Regulate::new(config)?, "regulate", config)
}

/// With a tenth of all episodes poisoned.
pub fn make_poisoned(config: &EnvConfig) -> Result<Env> {
    Env::of(Regulate { poison: 0.1, ..Regulate::new(config)? }, "regulate", config)
}

/// The optimum of Σ γ^t xᵀQx over the linearised step: gains K of a = a₀ − K x and the cost to go P, x as observed.
pub fn optimum(discount: f64) -> (DMatrix<f64>, DMatrix<f64>, Vec<f64>) {
    let config = EnvConfig { n_env: 1, ..EnvConfig::default() };
    let mut env = make(&config).unwrap();
    let mut out = omnidrones::tasks::Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let z = env.ideal_arguments();
    let action: Vec<f64> = z[env.layout().action.clone()].to_vec();
    let state: Vec<f32> = z[env.layout().state.clone()].iter().map(|x| *x as f32).collect();
    env.set_state(0, &state).unwrap();
    let jacobian = env.jacobian(0, &action).unwrap();
    let (full_a, full_b) = (jacobian.state(), jacobian.action());
    let seen = jacobian.observation_state();
    let next = jacobian.observation_action();
    // the observation follows the step: x⁺ = C(A x_state + B a); state columns without w of the quaternion
    let columns: Vec<usize> = (0..full_a.nrows()).filter(|k| *k != 6).collect();
    // scale from state to observation at hover: diagonal
    let scale: Vec<f64> = columns.iter().enumerate().map(|(i, _)| observed_per_state(i, &env)).collect();
    let a = DMatrix::from_fn(N, N, |i, j| seen[(i, columns[j])] / scale[j]);
    let b = DMatrix::from_fn(N, full_b.ncols(), |i, j| next[(i, j)]);
    let q = DMatrix::from_diagonal(&DVector::from_fn(N, |i, _| weight(i)));
    let r = DMatrix::identity(4, 4) * 1e-4;
    let root = discount.sqrt();
    let p = riccati::discrete(&(&a * root), &(&b * root), &q, &r).unwrap().matrix;
    let gain = (&r + b.transpose() * &p * &b * discount).lu().solve(&(b.transpose() * &p * &a * discount)).unwrap();
    (gain, p, action)
}

/// ∂(number i as observed)/∂(state) at hover: 2 for the attitude, 1/Ω_max for rotors, else 1.
fn observed_per_state(i: usize, env: &Env) -> f64 {
    SCALE
        * match i {
            6..=8 => 2.0,
            12.. => 1.0 / env.robot().drone().rotors[i - 12].max_speed,
            _ => 1.0,
        }
}
