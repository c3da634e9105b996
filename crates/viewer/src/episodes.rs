//! Recordings of the episodes of a task, filled while they are flown.

use super::flights::speeds;
use super::look::Look;
use super::recording::{Actor, BETWEEN, Ended, Event, MAX_FRAMES, Measure, Moment, Recording};
use omnidrones::controllers::Reference;
use omnidrones::controllers::reference::{Carried, LoadPath};
use omnidrones::dynamics::Plant;
use omnidrones::error::Result;
use omnidrones::tasks::{Column, Env, EvaluationStep, Spec};

/// Room between systems that are drawn beside each other, m.
const ROOM: f64 = 1.0;

/// The first few episodes of a batch.
#[derive(Debug)]
pub struct Episodes {
    spec: Spec,
    plant: Plant,
    n: usize,
    stride: usize,
    look: Look,
    /// Shapes of the robot's model that stand still; those of the task's scene are behind them.
    own_still: usize,
    wanted: Vec<Vec<Reference>>,
    error: Option<(Measure, usize)>,
    recording: Option<Recording>,
}

impl Episodes {
    /// Of the first `most` environments.
    ///
    /// # Errors
    /// As of [`Env::solids`].
    pub fn new(env: &Env, most: usize) -> Result<Self> {
        let spec = env.spec().clone();
        let plant = env.robot().plant().clone();
        let mut look = Look::of(&plant);
        let own_still = look.n_still();
        look.still.extend(env.solids(0)?);
        let first = spec.metric_columns().start;
        let measure = |m: &omnidrones::tasks::Info| Measure { name: m.name.replace('_', " "), unit: m.unit.clone() };
        let stride = ((BETWEEN / spec.dt).round() as usize).max(spec.horizon.div_ceil(MAX_FRAMES)).max(1);
        Ok(Self {
            n: spec.n_env.min(most),
            stride,
            look,
            own_still,
            wanted: Vec::new(),
            error: spec.info.get(first).map(|m| (measure(m), first)),
            recording: None,
            plant,
            spec,
        })
    }

    /// Time between two frames, s.
    pub fn interval(&self) -> f64 {
        self.stride as f64 * self.spec.dt
    }

    /// Sees a step of an evaluation; whether a frame came of it.
    ///
    /// # Errors
    /// As of [`Env::state`].
    pub fn see(&mut self, watched: &EvaluationStep<'_>) -> Result<bool> {
        if watched.step == 1 {
            self.begin(watched.env)?;
        }
        let over = |i: usize| watched.out.terminated[i] > 0;
        let due = watched.step % self.stride == 1 % self.stride;
        for i in (0..self.n).filter(|i| watched.flying[*i] && over(*i)) {
            self.end(i, watched);
        }
        if !due {
            return Ok(false);
        }
        let time = watched.step as f64 * self.spec.dt;
        let moments = (0..self.n).map(|i| self.moment(watched, i, time)).collect::<Result<Vec<Moment>>>()?;
        if let Some(recording) = &mut self.recording {
            recording.push(&moments);
        }
        Ok(true)
    }

    /// Targets and actors of episodes that begin.
    fn begin(&mut self, env: &Env) -> Result<()> {
        let references = |i| Ok(env.reference(i)?.map_or_else(Vec::new, |led| led.references));
        self.wanted = (0..self.n).map(references).collect::<Result<_>>()?;
        let still = (0..self.n).map(|i| self.still(env, i)).collect::<Result<Vec<_>>>()?;
        let offsets = self.offsets(env, &still)?;
        let goals = self.wanted.iter().map(Vec::len).max().unwrap_or(0);
        let actor = |(i, still): (usize, Vec<[f64; 3]>)| {
            Ok(Actor {
                name: format!("episode {i}"),
                look: 0,
                offset: offsets[i],
                still,
                goals,
                contact: self.plant.tree().is_some() && self.plant.physics().effects.contact,
                error: self.error.as_ref().map(|(measure, _)| measure.clone()),
                weight: self.look.weight,
                mounts: Vec::new(),
                ended: None,
            })
        };
        let actors = still.into_iter().enumerate().map(actor).collect::<Result<Vec<Actor>>>()?;
        let task = &self.spec.task;
        self.recording = Some(Recording::new(task, self.interval(), vec![self.look.clone()], actors));
        Ok(())
    }

    /// Where an episode's shapes stand that stand still: by the numbers of the model, then by the task's scene.
    fn still(&self, env: &Env, i: usize) -> Result<Vec<[f64; 3]>> {
        let numbers = env.parameters(i)?;
        let own = numbers[numbers.len() - 3 * self.own_still..].chunks_exact(3).map(|p| [p[0], p[1], p[2]]);
        Ok(own.chain(env.solids(i)?.into_iter().map(|solid| solid.position)).collect())
    }

    /// Single drones share their room, where the same things stand in it; others stand in a square, each with the room that all
    /// of them need.
    fn offsets(&self, env: &Env, still: &[Vec<[f64; 3]>]) -> Result<Vec<[f64; 3]>> {
        let alike = still.windows(2).all(|pair| pair[0] == pair[1]);
        if self.plant.tree().is_none() && alike || self.n == 1 {
            return Ok(vec![[0.0; 3]; self.n]);
        }
        let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for i in 0..self.n {
            let poses = self.look.poses(&self.plant, &self.state(env, i)?);
            let goals = self.wanted[i].iter().map(|r| goal(r, 0.0));
            let standing = still[i][self.own_still..].iter().copied();
            for place in poses.iter().map(|p| [p[0], p[1], p[2]]).chain(goals).chain(standing) {
                for k in (0..2).filter(|k| place[*k].is_finite()) {
                    (lo[k], hi[k]) = (lo[k].min(place[k]), hi[k].max(place[k]));
                }
            }
        }
        let side = (self.n as f64).sqrt().ceil() as usize;
        let apart = [0, 1].map(|k| hi[k] - lo[k] + ROOM);
        let at = |place: usize, k: usize| (place as f64 - 0.5 * (side - 1) as f64) * apart[k];
        Ok((0..self.n).map(|i| [at(i / side, 0), at(i % side, 1), 0.0]).collect())
    }

    fn state(&self, env: &Env, i: usize) -> Result<Vec<f64>> {
        Ok(env.state(i)?.iter().map(|x| f64::from(*x)).collect())
    }

    fn moment(&self, watched: &EvaluationStep<'_>, i: usize, time: f64) -> Result<Moment> {
        let state = self.state(watched.env, i)?;
        let width = self.spec.info.len();
        let goals = self.recording.as_ref().map_or(0, |r| r.actors[i].goals);
        let mut places: Vec<[f64; 3]> = self.wanted[i].iter().map(|r| goal(r, time)).collect();
        let last = places.last().copied().unwrap_or_default();
        places.resize(goals, last);
        Ok(Moment {
            poses: self.look.poses(&self.plant, &state),
            speeds: speeds(&self.plant, &state),
            goals: places,
            forces: self.look.forces(&self.plant, &state),
            error: self.error.as_ref().map_or(0.0, |(_, k)| f64::from(watched.out.info[i * width + k])),
        })
    }

    /// Tells why an episode ended early.
    fn end(&mut self, i: usize, watched: &EvaluationStep<'_>) {
        let Some(recording) = &mut self.recording else { return };
        let Some(reason) = self.spec.column(Column::Reason) else { return };
        let reason = watched.out.info[i * self.spec.info.len() + reason] as usize;
        let name =
            reason.checked_sub(1).and_then(|k| self.spec.ends.get(k)).map_or("diverged", |end| end.name.as_str());
        let why = format!("episode {i} ended: {}", name.replace('_', " "));
        let frame = recording.n_frame();
        let time = frame as f64 * recording.interval;
        recording.actors[i].ended = Some(Ended { frame, why: why.clone() });
        recording.events.push(Event { time, text: why, actor: i, rotor: None });
    }

    /// What was recorded so far.
    pub fn so_far(&self) -> Option<&Recording> {
        self.recording.as_ref()
    }

    /// What was recorded; none before the first step.
    pub fn recording(self) -> Option<Recording> {
        self.recording
    }
}

/// Where a reference leads at a time: on a path its point, on a way to a point that point, of a load its own place.
pub fn goal(reference: &Reference, time: f64) -> [f64; 3] {
    let whole = |reference: Reference| reference.sample(reference.duration().unwrap_or(time)).position;
    match reference {
        Reference::Waypoints(_) => whole(reference.clone()),
        Reference::Carried(Carried { path: LoadPath::Waypoints(way), .. }) => whole(Reference::Waypoints(way.clone())),
        Reference::Carried(Carried { path: LoadPath::Lemniscate(path), .. }) => {
            Reference::Lemniscate(*path).sample(time).position
        }
        other => other.sample(time).position,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first frame of two episodes.
    fn begun(task: &str) -> Recording {
        use omnidrones::tasks::{Autoreset, Buffers, EnvConfig, evaluate};
        let config = EnvConfig { n_env: 2, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
        let mut config =
            omnidrones::tasks::registry::by_name(task).unwrap().env(&config).unwrap().spec().config.clone();
        config.task.insert("horizon".into(), 2.into());
        let mut env = Env::make(task, &config).unwrap();
        let mut seen = Episodes::new(&env, 2).unwrap();
        let mut rest = |_: &Env, _: &Buffers, actions: &mut [f32]| {
            actions.fill(0.0);
            Ok(())
        };
        evaluate(&mut env, &mut rest, &mut |watched| assert!(seen.see(watched).is_ok())).unwrap();
        seen.recording().unwrap()
    }

    #[test]
    fn trunks_and_gates_stand_where_each_episode_has_them_and_episodes_beside_each_other() {
        for (task, solids) in [("Forest", 45), ("Race", 4 * 7)] {
            let recording = begun(task);
            let [one, other] = &recording.actors[..] else { panic!("two actors") };
            assert!(one.still.len() == solids && other.still.len() == solids, "{task}: {}", one.still.len());
            assert!(one.still != other.still && one.offset != other.offset, "{task}");
            assert_eq!(recording.looks[0].n_still(), solids, "{task}");
        }
        let recording = begun("Hover");
        assert!(recording.actors.iter().all(|actor| actor.still.is_empty() && actor.offset == [0.0; 3]));
    }

    #[test]
    fn a_target_is_where_the_task_wants_it_not_where_the_controller_is_on_its_way() {
        use omnidrones::controllers::reference::{Waypoint, Waypoints};
        let at = |time, x| Waypoint { time, position: [x, 0.0, 2.0], yaw: 0.0 };
        let way = Waypoints::new(vec![at(0.0, -2.0), at(3.0, 1.0)]).unwrap();
        assert!((Reference::Waypoints(way.clone()).sample(0.0).position[0] + 2.0).abs() < 1e-9);
        assert!((goal(&Reference::Waypoints(way), 0.0)[0] - 1.0).abs() < 1e-9);
    }
}
