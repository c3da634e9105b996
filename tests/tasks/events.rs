//! Goals that jump in mid-episode: what is seen, and what stays with whom.

use omnidrones::autodiff::{Scalar, Trace, TraceMask};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::tasks::{Autoreset, Buffers, Ends, Env, EnvConfig, Robot, Start, Task, View, Writer};

/// A number that jumps every few steps, observed as it is; an episode ends a step after it jumped above 0.8. The jumps are
/// counted, and change the mass.
struct Jumping {
    robot: Robot,
}

impl Jumping {
    fn new(config: &EnvConfig) -> Result<Self> {
        let mass = 1;
        Ok(Self { robot: config.single_robot("hummingbird")?.varying([mass]) })
    }
}

impl Task for Jumping {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn horizon(&self) -> usize {
        40
    }

    fn start(&self, start: &mut Start<'_>) {
        let target = start.task.uniform(0.0, 0.8);
        start.goal.field("target", "-", "jumps").number(target);
        start.event_at = 1.0 + start.task.below(5);
    }

    fn event(&self, start: &mut Start<'_>) {
        start.goal[0] = start.task.unit();
        start.task_state[0] += Trace::one();
        start.numbers[1] = 0.5 + start.goal[0];
        start.event_at += 1.0 + start.task.below(5);
    }

    fn remember(&self, view: &View, task_state: &mut Writer) {
        task_state.field("jumps", "-", "so far").number(view.task_state[0]);
    }

    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("target", "-", "jumps").number(view.goal[0]);
        out.field("jumps", "-", "so far").number(view.task_state[0]);
        out.field("step", "-", "k").number(view.step);
    }

    fn central(&self, view: &View, out: &mut Writer) {
        out.field("target", "-", "jumps").number(view.goal[0]);
    }

    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("target", "target", 1.0).number(view.goal[0]);
    }

    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("high", "target > 0.8", Trace::constant(0.8).lt(view.goal[0]));
    }

    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }

    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.field("target", "-", "jumps").number(1.0);
    }
}

fn jumping(config: &EnvConfig) -> Env {
    Env::of(Jumping::new(config).unwrap(), "jumping", config).unwrap()
}

/// All arrays of every step.
fn run(mut env: Env, threads: usize) -> Vec<Buffers> {
    env.set_threads(Threads::new(threads).unwrap());
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut actions = vec![0.0; env.spec().n_env * 4];
    (0..60)
        .map(|t| {
            env.sample(t, &mut actions);
            env.step(&actions, &mut out.out()).unwrap();
            out.clone()
        })
        .collect()
}

#[test]
fn an_observation_does_not_depend_on_whether_a_neighbour_restarts() {
    for history in ["", "observation = [{ kind = 'history', steps = 3 }, { kind = 'noise', std = 0.01 }]"] {
        for autoreset in Autoreset::ALL {
            let base = EnvConfig { n_env: 256, autoreset, ..EnvConfig::from_toml(history, "events").unwrap() };
            let whole = run(jumping(&base), 1);
            assert!(run(jumping(&base), 2) == whole);
            for (first, n) in [(0, 64), (5, 1), (17, 30), (100, 156)] {
                let shard = EnvConfig { n_env: n, first_environment: first as u64, ..base.clone() };
                let width = jumping(&shard).spec().n_observation;
                for (t, (own, all)) in run(jumping(&shard), 1).iter().zip(&whole).enumerate() {
                    let of = |rows: &[f32], each: usize| rows[first * each..(first + n) * each].to_vec();
                    assert_eq!(own.observation, of(&all.observation, width), "{first}, step {t}");
                    assert_eq!(own.final_observation, of(&all.final_observation, width), "{first}, step {t}");
                    assert_eq!(own.central, of(&all.central, 1), "{first}, step {t}");
                    assert_eq!(own.privileged, of(&all.privileged, 1), "{first}, step {t}");
                    assert_eq!(own.reward, of(&all.reward, 1), "{first}, step {t}");
                }
            }
        }
    }
}

#[test]
fn an_event_shows_in_its_own_step_and_what_it_writes_stays() {
    let config = EnvConfig { n_env: 70, autoreset: Autoreset::SameStep, ..EnvConfig::default() };
    let mut env = jumping(&config);
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut jumps = 0;
    for _ in 0..50 {
        let before = out.clone();
        env.step(&[0.0; 280], &mut out.out()).unwrap();
        for i in 0..70 {
            let (old, new) = (&before.observation[3 * i..3 * i + 3], &out.observation[3 * i..3 * i + 3]);
            // the reward is for the goal that the action was for
            assert_eq!(out.reward[i], old[0]);
            assert_eq!((new[0], new[0]), (env.goal(i).unwrap()[0], out.central[i]));
            if new[1] == old[1] + 1.0 {
                jumps += 1;
                assert!(new[0] != old[0] && (out.privileged[i] - (0.5 + new[0])).abs() < 1e-6);
                assert!((env.parameters(i).unwrap()[1] - f64::from(out.privileged[i])).abs() < 1e-6);
            } else if new[2] > 0.0 {
                assert_eq!(new[0], old[0]);
            }
        }
    }
    assert!(jumps > 500, "{jumps}");
}
