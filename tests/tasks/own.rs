//! Tasks of one's own that say something unusual.

use omnidrones::prelude::*;
use omnidrones::tasks::EnvConfig;

/// Floats, with as many agents as it is told, and keeps the last three heights.
struct Floats {
    robot: Robot,
    n_agent: usize,
}

impl Task for Floats {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        20
    }
    fn n_agent(&self) -> usize {
        self.n_agent
    }
    fn start(&self, start: &mut Start<'_>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
    fn remember(&self, view: &View, kept: &mut Writer) {
        let height = view.drone(0).position[2];
        let before = view.task_state.iter().copied().take(2);
        kept.field("heights", "m, world", "newest first").array(std::iter::once(height).chain(before));
    }
    fn observe(&self, view: &View, agent: usize, out: &mut Writer) {
        out.field("heights", "m, world", "newest first").array(view.task_state.iter().copied());
        out.field("agent", "-", "which").number((agent as f64).into());
    }
    fn central(&self, view: &View, out: &mut Writer) {
        out.field("mean", "m, world", "height")
            .number(view.task_state.iter().fold(Trace::zero(), |sum, z| sum + *z) / 3.0);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("high", "1 above 1 m", 1.0).number(Trace::select(
            view.drone(0).position[2].gt(1.0),
            Trace::one(),
            Trace::zero(),
        ));
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        let height = view.drone(0).position[2];
        ends.when("crash", "z < 0.2 m or z > 9 m", height.lt(0.2) | height.gt(9.0));
    }
    fn success(&self, view: &View) -> TraceMask {
        !view.drone(0).position[2].lt(1.0) & view.step.gt(5.5)
    }
    fn ideal(&self, start: &mut Start<'_>) {
        self.start(start);
    }
}

fn floats(n_agent: usize, text: &str) -> omnidrones::error::Result<Env> {
    let config = EnvConfig::from_toml(&format!("n_env = 3\n{text}"), "t")?;
    Env::of(Floats { robot: config.single_robot("hummingbird")?, n_agent }, "Floats", &config)
}

#[test]
fn what_a_task_keeps_is_as_long_wherever_it_looks_at_it() {
    let mut env = floats(1, "").unwrap();
    assert_eq!((env.spec().n_observation, env.spec().n_central), (4, 1));
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    assert_eq!(out.observation[..4], [0.0; 4]);
    for _ in 0..3 {
        env.step(&[-0.4; 12], &mut out.out()).unwrap();
    }
    let heights = &out.observation[..3];
    assert!(heights.iter().all(|z| (z - 2.0).abs() < 0.01) && heights[0] != heights[2], "{heights:?}");
    assert!((out.central[0] - heights.iter().sum::<f32>() / 3.0).abs() < 1e-6);
}

#[test]
fn an_agent_without_a_drone_sees_and_moves_nothing() {
    let (mut alone, mut two) = (floats(1, "").unwrap(), floats(2, "").unwrap());
    assert_eq!(two.spec().n_agent, 2);
    let (mut a, mut b) = (Buffers::new(alone.spec()), Buffers::new(two.spec()));
    alone.reset(None, None, &mut a.out()).unwrap();
    two.reset(None, None, &mut b.out()).unwrap();
    for t in 0..5 {
        let own = [0.1 * t as f32 - 0.6; 4];
        alone.step(&own.repeat(3), &mut a.out()).unwrap();
        two.step(&[own, [0.9, f32::NAN, -3.0, 1.0]].concat().repeat(3), &mut b.out()).unwrap();
        assert_eq!(alone.state(1).unwrap(), two.state(1).unwrap());
        assert_eq!((b.observation[3], b.observation[7]), (0.0, 1.0));
    }
}

#[test]
fn drones_that_nobody_commands_are_refused() {
    let refusal = floats(0, "").unwrap_err().to_string();
    assert!(refusal.contains("agents of the task") && refusal.contains("at least 1"), "{refusal}");
}

#[test]
fn whole_numbers_have_no_tape() {
    for kind in ["discrete", "multi_discrete"] {
        let env = floats(1, &format!("actions = {{ kind = '{kind}', levels = 3 }}")).unwrap();
        let refusal = env.tape(1).unwrap_err().to_string();
        assert!(refusal.contains("continuous for gradients"), "{refusal}");
    }
}
