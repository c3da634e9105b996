//! A policy as a controller of a plain vehicle: physics without the disguise of its task.
//!
//! The policy sees what its task would show of the plant, moved so that the reference now stands at the task's goal. It
//! knows no more of the reference than that point, and ticks at the rate of its task. Yaw is the task's.

use super::evaluate::{Starts, eval_env};
use super::policy::Policy;
use super::policy_io::SavedPolicy;
use base::error::{Error, Result};
use base::parallel::Threads;
use controllers::cascade::Level;
use controllers::{Controller, Measurement, Reference, Target};
use dynamics::Plant;
use tasks::{Buffers, Env, EnvConfig, ObservationTransform};

/// A policy that was trained to hold a point, in command of a plant.
pub struct PolicyController {
    name: String,
    policy: Policy,
    env: Env,
    out: Buffers,
    actions: Vec<f32>,
    /// Places of the commands in the plant's input, action by action.
    places: Vec<usize>,
    /// Where the task wants its drone, m.
    goal: [f64; 3],
    sees_estimates: bool,
}

impl PolicyController {
    /// The policy of a run on a plant with the states and rotors of its task.
    ///
    /// # Errors
    /// As [`PolicyController::of`].
    pub fn new(saved: SavedPolicy, plant: &Plant) -> Result<Self> {
        Self::of(saved.policy, &saved.manifest.task, &saved.config.seen_env(), plant)
    }

    /// A policy of a task in environments like `env`.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant of another make, a task with several agents or without a fixed goal, and a policy that does
    /// not command rotors by what it sees at one moment.
    pub fn of(mut policy: Policy, task: &str, env: &EnvConfig, plant: &Plant) -> Result<Self> {
        let threads = Threads::new(1)?;
        policy.set_threads(threads.clone());
        let sees_estimates = sees_estimates(env, task)?;
        let mut env = eval_env(&policy, task, env, Starts { n_env: 1, seed: 0 }, &threads)?;
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out())?;
        fits(&env, plant)?;
        let goal = goal(&env)?;
        let places = env.robot().drone().commands().collect();
        let actions = vec![0.0; env.spec().action.len()];
        // what it is given is the estimate
        env.take_states_for_estimates();
        Ok(Self { name: format!("policy of {task}"), policy, env, out, actions, places, goal, sees_estimates })
    }

    /// What the policy was trained on, or the nominal one of what it was.
    pub fn trained_on(&self) -> &Plant {
        self.env.robot().plant()
    }

    /// Whether it was trained on estimates of the state: what it is given here is what the loop measures, the truth unless the loop has an
    /// estimator ([`ClosedLoop::with_estimator`](controllers::ClosedLoop::with_estimator)).
    pub fn sees_estimates(&self) -> bool {
        self.sees_estimates
    }

    /// Shows the moved state and acts; `None` for a state that is not finite.
    fn act(&mut self, state: &[f64], wanted: [f64; 3]) -> Option<()> {
        let mut seen: Vec<f32> = state.iter().map(|x| *x as f32).collect();
        for root in self.env.robot().roots() {
            for k in 0..3 {
                seen[root + k] = (state[root + k] - wanted[k] + self.goal[k]) as f32;
            }
        }
        self.env.set_state(0, &seen).ok()?;
        self.env.observe(&mut self.out.out()).ok()?;
        self.policy.act(&self.out.observation, &mut self.actions).ok()
    }
}

impl Controller for PolicyController {
    fn name(&self) -> &str {
        &self.name
    }

    fn why_no_law(&self) -> &'static str {
        "a policy, which is exported by the folder of its run"
    }

    fn description(&self) -> String {
        "what was learnt in the task, the reference in the place of its goal".into()
    }

    fn rate(&self) -> Option<f64> {
        Some(1.0 / self.env.spec().dt)
    }

    fn reset(&mut self) {
        self.policy.reset();
    }

    fn tick(&mut self, seen: Measurement<'_>, target: Target<'_>, commands: &mut [f64]) {
        if self.act(seen.state, target.sample(seen.time).position).is_some() {
            let own = self.places.iter().zip(&self.actions);
            own.for_each(|(place, action)| commands[*place] = f64::from(*action).clamp(-1.0, 1.0));
        }
    }
}

/// Whether a policy was trained on estimates.
fn sees_estimates(env: &EnvConfig, task: &str) -> Result<bool> {
    match env.observation.first() {
        Some(ObservationTransform::Estimate { readings: true, .. }) => {
            let what = format!("policy of {task}: observation");
            Err(Error::value(what, "readings of sensors", "of the state", "Fly it with 'eval'."))
        }
        first => Ok(matches!(first, Some(ObservationTransform::Estimate { .. }))),
    }
}

/// Refuses what cannot fly the plant.
fn fits(env: &Env, plant: &Plant) -> Result<()> {
    let (spec, own) = (env.spec(), env.robot().plant());
    let refuse = |what: &str, value: String, rule: &str, remedy: &str| {
        Err(Error::value(format!("policy of {}: {what}", spec.task), value, rule, remedy))
    };
    let speeds = |p: &Plant| p.state_quantities().iter().map(|q| q.unit).collect::<Vec<_>>();
    if speeds(own) != speeds(plant) {
        let rule = format!("one with the states of '{}'", own.name());
        return refuse("plant", format!("'{}'", plant.name()), &rule, "Fly what the policy was trained on.");
    }
    if spec.n_agent != 1 || env.robot().roots().len() != 1 {
        return refuse("agents", spec.n_agent.to_string(), "one, of one drone", "Fly it with 'eval'.");
    }
    if spec.config.control != Level::Rotor || spec.config.actions != EnvConfig::default().actions {
        return refuse("actions", spec.config.control.name().into(), "continuous, of rotors", "Fly it with 'eval'.");
    }
    if spec.config.residual > 0.0 {
        return refuse("residual", spec.config.residual.to_string(), "0, of rotors alone", "Fly it with 'eval'.");
    }
    if spec.config.observation.iter().any(|stage| matches!(stage, ObservationTransform::History { .. })) {
        return refuse("observation", "a history".into(), "of one moment", "Fly it with 'eval'.");
    }
    Ok(())
}

/// The point that the task wants to be held.
///
/// # Errors
/// [`Error::Value`] for a task that wants another thing.
pub fn goal(env: &Env) -> Result<[f64; 3]> {
    let wanted = env.reference(0)?;
    match wanted.as_ref().map(|w| &w.references[..]) {
        Some([Reference::Hover(point)]) => Ok(point.position),
        Some([way @ Reference::Waypoints(_)]) => Ok(way.sample(way.duration().unwrap_or(0.0)).position),
        _ => {
            let what = format!("policy of {}: goal", env.spec().task);
            Err(Error::value(what, "a path of its own", "a point to hold", "Take one that was trained to hover."))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::nn::Layers;
    use super::super::policy::Actor;
    use super::*;
    use controllers::{FlightPlan, fly};
    use dynamics::{Physics, vehicles};

    const ESTIMATED: &str = "observation = [{ kind = 'estimate' }]
        [[sensor]]
        name = 'imu'
        kind = 'imu'
        preset = 'bmi088'
        [[sensor]]
        name = 'cameras'
        kind = 'motion_capture'
        preset = 'optical'
        every = 1";

    fn flown(vehicle: &str) -> Result<controllers::Flight> {
        flown_of(vehicle, "", &FlightPlan { duration: 0.4, ..FlightPlan::default() })
    }

    fn flown_of(vehicle: &str, text: &str, plan: &FlightPlan) -> Result<controllers::Flight> {
        let env = EnvConfig { n_env: 1, ..EnvConfig::from_toml(text, "test")? };
        let spec = Env::make("Hover", &env)?.spec().clone();
        let actor = Actor::new(&spec, &Layers { hidden: vec![8], ..Layers::default() }, true)?;
        let parameters = (0..actor.n_parameter()).map(|i| 0.05 * ((i * i % 13) as f32 - 6.0)).collect();
        let plant = Plant::of_vehicle(&vehicles::by_name(vehicle)?, Physics::default())?;
        let mut own = PolicyController::of(Policy::new(actor, parameters, None, &spec)?, "Hover", &env, &plant)?;
        assert_eq!(own.sees_estimates(), !text.is_empty());
        fly(&plant, &mut own, plan, &mut |_| {})
    }

    #[test]
    fn a_policy_of_estimates_flies_on_the_state_that_it_is_given() {
        let plan = FlightPlan { duration: 0.4, ..FlightPlan::default() };
        let [truth, other] = [ESTIMATED, ""].map(|text| flown_of("hummingbird", text, &plan).unwrap().log);
        let off = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // the truth, where no estimator is, but for rounding: 4.5e-5 rad/s
        assert!(off(&truth.rotor_command, &other.rotor_command) < 1e-3);
        let sensors = dynamics::sensors::SensorConfig::parse_list("imu:bmi088,motion_capture:optical").unwrap();
        let plan =
            FlightPlan { sensors, estimator: Some(controllers::estimation::EstimatorSettings::default()), ..plan };
        let estimated = flown_of("hummingbird", ESTIMATED, &plan).unwrap();
        assert!(estimated.estimates.unwrap().tally.rms()[0] > 0.0);
        assert!(off(&estimated.log.rotor_command, &other.rotor_command) > 0.1);
        let read = ESTIMATED.replace("'estimate'", "'estimate', readings = true");
        let error = flown_of("hummingbird", &read, &plan).unwrap_err().to_string();
        assert!(error.contains("readings of sensors"), "{error}");
    }

    #[test]
    fn a_policy_commands_the_plain_vehicle_at_the_rate_of_its_task() {
        let log = flown("hummingbird").unwrap().log;
        let rows: Vec<&[f64]> = log.rotor_command.chunks_exact(4).collect();
        // a step of the task is eight of the plant
        assert!(rows[..200].chunks_exact(8).all(|held| held.iter().all(|row| *row == held[0])));
        assert!(rows[..200].chunks_exact(8).any(|held| held[0] != rows[0]), "it reacts");
        let error = flown("firefly").unwrap_err().to_string();
        assert!(error.contains("one with the states of 'hummingbird'"), "{error}");
    }
}
