//! Episodes step by step: states, observations, actions, rewards; as CSV, NPZ and MCAP.
//!
//! A row is a step: state and observation before it, the action, reward and ends that came of it. What an episode ended in
//! stands behind its steps.

use super::files::write_table;
use super::npz::Npz;
use crate::prelude::*;
use omnidrones::controllers::Reference;
#[cfg(feature = "mcap")]
use omnidrones::dynamics::Plant;
#[cfg(feature = "mcap")]
use omnidrones::internals::replace_with;
use omnidrones::tasks::{Buffers, Env, EvaluationStep, Field, Spec};
#[cfg(feature = "mcap")]
use omnidrones_viewer::{Recording, Track, goal, write_mcap};

/// Most numbers that are kept: 1 GiB.
const MAX_NUMBERS: usize = 1 << 28;

/// The first episodes of a batch.
#[derive(Debug)]
pub struct Trajectories {
    spec: Spec,
    #[cfg(feature = "mcap")]
    plant: Plant,
    state: Vec<String>,
    episodes: Vec<Episode>,
    refused: Option<Error>,
}

/// One of them; rows of steps one behind the other.
#[derive(Debug, Default)]
pub struct Episode {
    /// Rows of steps, and behind them the one in which it ended.
    pub state: Vec<f32>,
    pub observation: Vec<f32>,
    pub action: Vec<f32>,
    pub reward: Vec<f32>,
    pub info: Vec<f32>,
    pub terminated: bool,
    /// Steps.
    pub length: usize,
    /// Where the task wants what, if it does.
    pub wanted: Vec<Reference>,
    over: bool,
}

impl Trajectories {
    /// Of the first `most` environments.
    pub fn new(env: &Env, most: usize) -> Result<Self> {
        let spec = env.spec().clone();
        let n = spec.n_env.min(most);
        let quantities = env.robot().plant().state_quantities();
        let per_agent = spec.n_observation + spec.action.len() + 1;
        let width = quantities.len() + spec.n_agent * per_agent + spec.info.len();
        let numbers = n.saturating_mul(spec.horizon + 1).saturating_mul(width);
        if numbers > MAX_NUMBERS {
            let limit =
                format!("{MAX_NUMBERS} numbers in all, that is {} episodes", MAX_NUMBERS / (numbers / n.max(1)));
            return Err(Error::limit("--trajectories", n, limit, "Keep fewer of them, or fly shorter ones."));
        }
        Ok(Self {
            state: quantities.iter().map(|q| format!("{} [{}]", q.name, q.unit)).collect(),
            episodes: (0..n).map(|_| Episode::default()).collect(),
            #[cfg(feature = "mcap")]
            plant: env.robot().plant().clone(),
            refused: None,
            spec,
        })
    }

    /// What is there before a step, and what is done about it.
    pub fn before(&mut self, env: &Env, out: &Buffers, actions: &[f32]) {
        let Spec { n_agent, n_observation, action, .. } = &self.spec;
        let (seen, done) = (n_agent * n_observation, n_agent * action.len());
        for (i, episode) in self.episodes.iter_mut().enumerate().filter(|(_, e)| !e.over) {
            if episode.length == 0 {
                // drawn with the start of the episode
                episode.wanted = env.reference(i).ok().flatten().map_or_else(Vec::new, |led| led.references);
            }
            match env.state(i) {
                Ok(state) => episode.state.extend(state),
                Err(error) => self.refused = Some(error),
            }
            episode.observation.extend_from_slice(&out.observation[i * seen..(i + 1) * seen]);
            episode.action.extend_from_slice(&actions[i * done..(i + 1) * done]);
            episode.length += 1;
        }
    }

    /// What came of a step.
    pub fn after(&mut self, watched: &EvaluationStep<'_>) {
        let Spec { n_agent, n_observation, info, .. } = &self.spec;
        let (out, seen, told) = (watched.out, n_agent * n_observation, info.len());
        for (i, episode) in self.episodes.iter_mut().enumerate().filter(|(_, e)| !e.over) {
            episode.reward.extend_from_slice(&out.reward[i * n_agent..(i + 1) * n_agent]);
            episode.info.extend_from_slice(&out.info[i * told..(i + 1) * told]);
            if out.terminated[i] + out.truncated[i] > 0 {
                (episode.over, episode.terminated) = (true, out.terminated[i] > 0);
                episode.state.extend(watched.env.state(i).unwrap_or_default());
                episode.observation.extend_from_slice(&out.observation[i * seen..(i + 1) * seen]);
            }
        }
    }

    /// Frames, shapes, targets and all numbers of the episodes, for Foxglove and rerun; `recording` tells who they are.
    #[cfg(feature = "mcap")]
    pub fn write_mcap(&self, path: &Path, recording: &Recording) -> Result<()> {
        let n = self.state.len();
        let track = |episode: &Episode| {
            let times: Vec<f64> = (0..episode.length).map(|t| t as f64 * self.spec.dt).collect();
            let wide = |row: &[f32]| row.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
            Track {
                states: episode.state.chunks_exact(n).map(wide).collect(),
                goals: times.iter().map(|t| episode.wanted.iter().map(|r| goal(r, *t)).collect()).collect(),
                numbers: (0..episode.length).map(|t| wide(&self.row(episode, t))).collect(),
                times,
            }
        };
        let tracks: Vec<Track> = self.episodes.iter().map(track).collect();
        mcap(path, &self.plant, recording, &self.columns(), &tracks)
    }

    /// An error of the record is told.
    pub fn checked(self) -> Result<Self> {
        match self.refused {
            Some(error) => Err(error),
            None => Ok(self),
        }
    }

    fn observation_columns(&self) -> Vec<String> {
        flat(&self.spec.observation)
    }

    fn action_columns(&self) -> Vec<String> {
        let (n, commands) = (self.spec.action.len(), &self.spec.commands);
        (0..n).map(|k| if n == commands.len() { format!("{} [-]", commands[k]) } else { format!("{k} [-]") }).collect()
    }

    fn info_columns(&self) -> Vec<String> {
        self.spec.info.iter().map(|info| format!("{} [{}]", info.name, info.unit)).collect()
    }

    /// Names of the numbers of a step in an order of their own; agents have theirs one after the other.
    pub fn columns(&self) -> Vec<String> {
        let many = self.spec.n_agent > 1;
        let of = |kind: &str, names: &[String]| -> Vec<String> {
            let agent = |a: usize| if many { format!("{kind}.{a}.") } else { format!("{kind}.") };
            (0..self.spec.n_agent).flat_map(|a| names.iter().map(move |name| agent(a) + name)).collect()
        };
        let mut all: Vec<String> = self.state.iter().map(|name| format!("state.{name}")).collect();
        all.extend(of("observation", &self.observation_columns()));
        all.extend(of("action", &self.action_columns()));
        all.push("reward [-]".into());
        all.extend(self.info_columns().iter().map(|name| format!("info.{name}")));
        all
    }

    /// The numbers of step `t` of an episode in the order of [`columns`](Self::columns); of the row in which it ended those
    /// that there are, then NaN.
    pub fn row(&self, episode: &Episode, t: usize) -> Vec<f32> {
        let agents = self.spec.n_agent;
        let mut row = Vec::new();
        let mut add = |numbers: &[f32], width: usize| match numbers.get(t * width..(t + 1) * width) {
            Some(own) => row.extend_from_slice(own),
            None => row.extend(std::iter::repeat_n(f32::NAN, width)),
        };
        add(&episode.state, self.state.len());
        add(&episode.observation, agents * self.spec.n_observation);
        add(&episode.action, agents * self.spec.action.len());
        // all agents of an environment share one
        let rewards: Vec<f32> = episode.reward.iter().step_by(agents.max(1)).copied().collect();
        add(&rewards, 1);
        add(&episode.info, self.spec.info.len());
        row
    }

    /// One line per step, and one behind each episode for what it ended in.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        let mut header =
            ["episode [-]", "step [-]", "time [s]", "terminated [-]", "truncated [-]"].map(String::from).to_vec();
        header.extend(self.columns());
        let line = |i: usize, episode: &Episode, t: usize| {
            let last = t + 1 == episode.length;
            let ends = [last && episode.terminated, last && !episode.terminated].map(|end| u8::from(end).to_string());
            let place = [i.to_string(), t.to_string(), (t as f64 * self.spec.dt).to_string()];
            let cell = |x: f32| if x.is_nan() && t >= episode.length { String::new() } else { x.to_string() };
            place.into_iter().chain(ends).chain(self.row(episode, t).into_iter().map(cell)).collect()
        };
        let lines = self.episodes.iter().enumerate();
        write_table(path, header, lines.flat_map(|(i, e)| (0..=e.length).map(move |t| line(i, e, t))))
    }

    /// Arrays of all steps, episode after episode, and what these ended in.
    pub fn write_npz(&self, path: &Path) -> Result<()> {
        let Spec { n_agent: a, n_observation: o, action, info, dt, task, .. } = &self.spec;
        let (s, u) = (self.state.len(), action.len());
        let lengths: Vec<i64> = self.episodes.iter().map(|e| e.length as i64).collect();
        let (e, n) = (lengths.len(), lengths.iter().sum::<i64>() as usize);
        // all rows of all episodes, or the last ones
        let steps = |of: fn(&Episode) -> &[f32], width: usize| -> Vec<f32> {
            self.episodes.iter().flat_map(|e| &of(e)[..e.length * width]).copied().collect()
        };
        let last = |of: fn(&Episode) -> &[f32], width: usize| -> Vec<f32> {
            self.episodes.iter().flat_map(|e| &of(e)[e.length * width..]).copied().collect()
        };
        let each = |of: &dyn Fn(usize, &Episode, usize) -> f64| -> Vec<f64> {
            let own = self.episodes.iter().enumerate();
            own.flat_map(|(i, e)| (0..e.length).map(move |t| of(i, e, t))).collect()
        };
        let ends = |terminated: bool| -> Vec<bool> {
            let end = |_: usize, e: &Episode, t: usize| f64::from(t + 1 == e.length && e.terminated == terminated);
            each(&end).into_iter().map(|x| x > 0.0).collect()
        };
        let whole = |values: Vec<f64>| -> Vec<i64> { values.into_iter().map(|x| x as i64).collect() };
        Npz::write(path, |npz| {
            npz.texts("task", &[], &[task])?;
            npz.numbers("dt", &[], &[*dt])?;
            npz.numbers("length", &[e], &lengths)?;
            npz.numbers("episode", &[n], &whole(each(&|i, _, _| i as f64)))?;
            npz.numbers("step", &[n], &whole(each(&|_, _, t| t as f64)))?;
            npz.numbers("time", &[n], &each(&|_, _, t| t as f64 * dt))?;
            npz.numbers("state", &[n, s], &steps(|e| &e.state, s))?;
            npz.numbers("observation", &[n, *a, *o], &steps(|e| &e.observation, a * o))?;
            npz.numbers("action", &[n, *a, u], &steps(|e| &e.action, a * u))?;
            npz.numbers("reward", &[n, *a], &steps(|e| &e.reward, *a))?;
            npz.numbers("terminated", &[n], &ends(true))?;
            npz.numbers("truncated", &[n], &ends(false))?;
            npz.numbers("info", &[n, info.len()], &steps(|e| &e.info, info.len()))?;
            npz.numbers("final_state", &[e, s], &last(|e| &e.state, s))?;
            npz.numbers("final_observation", &[e, *a, *o], &last(|e| &e.observation, a * o))?;
            npz.texts("state_columns", &[s], &self.state)?;
            npz.texts("observation_columns", &[*o], &self.observation_columns())?;
            npz.texts("action_columns", &[u], &self.action_columns())?;
            npz.texts("info_columns", &[info.len()], &self.info_columns())
        })
    }
}

/// Writes a log for Foxglove and rerun.
#[cfg(feature = "mcap")]
pub fn mcap(path: &Path, plant: &Plant, recording: &Recording, columns: &[String], tracks: &[Track]) -> Result<()> {
    replace_with(path, |file| {
        let sink = std::io::BufWriter::new(file);
        write_mcap(sink, plant, recording, columns, tracks).map_err(|error| Error::file(path, error))
    })
}

/// A name for every number of fields.
fn flat(fields: &[Field]) -> Vec<String> {
    let name =
        |field: &Field, k: usize| if field.size == 1 { field.name.clone() } else { format!("{}_{k}", field.name) };
    fields.iter().flat_map(|f| (0..f.size).map(move |k| format!("{} [{}]", name(f, k), f.unit))).collect()
}
