//! Starts and events that are recorded are those of plain numbers: the same draws, the same decisions.

use omnidrones::autodiff::{Array, Mask, Scalar, Trace, TraceMask};
use omnidrones::error::Result;
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{
    Buffers, Draw, Ends, Env, EnvConfig, HostStart, Robot, Start, StartScalar, Task, View, Writer,
};

/// Draws before, in and behind a part that is drawn again, all from one stream; then an event that draws likewise.
struct Drawing {
    robot: Robot,
    on_host: bool,
}

/// Of a task with a goal of seven numbers and an event every few steps.
fn begin<S: StartScalar>(start: &mut Start<'_, S>) {
    let before = start.task.uniform(-1.0, 1.0);
    let (moves, share) = start.task.sometimes(0.3, Draw::Unit);
    let once = start.once.below(10);
    start.goal.field("before", "-", "drawn before").number(before);
    start.goal.field("moved", "-", "drawn sometimes, else −1").number(S::select(moves, share, -S::one()));
    start.goal.field("once", "-", "drawn once per environment").number(once);
    start.again(5, |start| {
        let place = [0, 1, 2].map(|_| start.task.uniform(-1.0, 1.0));
        start.place(0, place, [1.0, 0.0, 0.0, 0.0]);
        // a third is accepted
        (place[0] + place[1]).lt(S::from(-0.33))
    });
    let behind = start.task.number(Draw::NormalWithin(1.0));
    start.goal.field("behind", "-", "drawn behind").number(behind);
    start.goal.field("hard", "-", "difficulty").number(start.difficulty);
    start.goal.field("jumped", "-", "drawn in events").number(S::zero());
    start.goal.field("mass", "kg", "of the drone").number(start.numbers[1]);
    // some never have an event, and say so in either way
    let (kind, wait) = (start.task.unit(), start.task.geometric(4.0));
    let never = S::select(kind.lt(S::from(0.1)), S::from(f64::NAN), S::from(f64::INFINITY));
    start.event_at = S::select(kind.lt(S::from(0.2)), never, wait);
}

fn jump<S: StartScalar>(start: &mut Start<'_, S>) {
    start.again(3, |start| {
        start.goal[5] = start.reset.normal();
        start.goal[5].lt(S::zero())
    });
    start.task_state[0] += S::one();
    // in a third of them the mass stays
    let (kind, factor) = (start.task.unit(), start.task.uniform(0.9, 1.1));
    start.numbers[1] *= S::select(kind.lt(S::from(0.33)), S::one(), factor);
    start.goal[6] = start.numbers[1];
    start.event_at += start.task.geometric(4.0);
}

impl HostStart for Drawing {
    fn start(&self, start: &mut Start<'_, f64>) {
        begin(start);
    }
    fn event(&self, start: &mut Start<'_, f64>) {
        jump(start);
    }
}

#[rustfmt::skip]
impl Task for Drawing {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { 25 }
    fn start(&self, start: &mut Start<'_>) { begin(start); }
    fn event(&self, start: &mut Start<'_>) { jump(start); }
    fn start_on_host(&self) -> Option<&dyn HostStart> { self.on_host.then_some(self) }
    fn remember(&self, view: &View, out: &mut Writer) { out.field("jumps", "-", "so far").number(view.task_state[0]); }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("goal", "-", "as it is").array(view.goal.array::<7>(0));
        out.field("position", "m", "p").array(view.drone(0).position);
        out.field("jumps", "-", "so far").number(view.task_state[0]);
    }
    fn reward(&self, _: &View, terms: &mut Writer) { terms.term("alive", "1", 1.0).number(Trace::one()); }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask { Trace::one().lt(Trace::zero()) }
    fn ideal(&self, start: &mut Start<'_>) { begin(start); }
}

fn drawing(on_host: bool, config: &EnvConfig) -> Result<Env> {
    let mass = 1;
    Env::of(Drawing { robot: config.single_robot("hummingbird")?.varying([mass]), on_host }, "drawing", config)
}

/// What is seen in all steps of some episodes.
fn seen(mut env: Env) -> Vec<f32> {
    let mut out = Buffers::new(env.spec());
    env.reset(None, None, &mut out.out()).unwrap();
    let mut seen = out.observation.clone();
    // no command moves rotors enough in 25 steps for rounding to grow
    let actions = vec![0.0; env.spec().n_env * 4];
    for _ in 0..60 {
        env.step(&actions, &mut out.out()).unwrap();
        seen.extend(&out.observation);
    }
    seen
}

#[test]
fn what_begins_on_the_host_and_what_is_recorded_draw_and_decide_alike() {
    let text = "n_env = 500\nseed = 7\neasier = 0.4\ndifficulty = 0.9";
    let randomised = "\n[[randomise]]\nwhat = 'thrust'\nrange = [0.9, 1.1]\ndistribution = 'normal'\neach = true";
    for text in [text.to_string(), format!("{text}{randomised}")] {
        let config = EnvConfig::from_toml(&text, "text").unwrap();
        let [recorded, plain] = [false, true].map(|on_host| seen(drawing(on_host, &config).unwrap()));
        let off = recorded.iter().zip(&plain).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f32::max);
        println!("{off:e} over {} numbers", plain.len());
        assert!(off < 1e-6, "{off:e}"); // 2.4e-7
        // a third of the events leaves the mass: the others' bits are in the physics
        let jumps = plain.chunks_exact(11).map(|seen| seen[10]).fold(0.0, f32::max);
        assert!(jumps > 5.0, "events come again and again: {jumps}");
    }
}

#[test]
fn what_is_drawn_again_meets_what_is_asked_or_was_drawn_as_often_as_is_allowed() {
    let config = EnvConfig { n_env: 1000, ..EnvConfig::default() };
    for on_host in [false, true] {
        let mut env = drawing(on_host, &config).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let accepted = (0..1000).filter(|i| {
            let state = env.state(*i).unwrap();
            state[0] + state[1] < -0.33
        });
        // P = (2 − 0.33)²/8 = 0.349 each time, 1 − (1 − P)⁵ = 0.883 in five
        let accepted = accepted.count();
        assert!((883 - 40..=883 + 40).contains(&accepted), "{accepted}"); // four standard errors of 10
    }
}

/// A task that starts and goes on as it is told to.
struct Told<F> {
    robot: Robot,
    event: bool,
    tell: F,
}

#[rustfmt::skip]
impl<F: Fn(&mut Start<'_>) + Send + Sync> Task for Told<F> {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { 50 }
    fn start(&self, start: &mut Start<'_>) { if self.event { start.event_at = 1.0.into(); } else { (self.tell)(start); } }
    fn event(&self, start: &mut Start<'_>) { if self.event { (self.tell)(start); } }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) { out.field("z", "m", "height").number(view.drone(0).position[2]); }
    fn reward(&self, _: &View, terms: &mut Writer) { terms.term("alive", "1", 1.0).number(Trace::one()); }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, view: &View) -> TraceMask { view.step.lt(0.0).and(view.step.gt(0.0)) }
    fn ideal(&self, _: &mut Start<'_>) {}
}

fn told(event: bool, tell: impl Fn(&mut Start<'_>) + Send + Sync + 'static) -> Result<Env> {
    let config = EnvConfig::default();
    Env::of(Told { robot: config.single_robot("hummingbird")?, event, tell }, "told", &config)
}

#[test]
fn what_cannot_be_drawn_is_refused_when_an_environment_is_made() {
    let draw = |draw: Draw| move |start: &mut Start<'_>| _ = start.task.number(draw);
    let refusals = [
        told(false, |start| (0..2).for_each(|_| start.again(9, |start| start.reset.unit().lt(0.5)))),
        told(false, draw(Draw::NormalWithin(0.0))),
        told(false, draw(Draw::NormalWithin(f64::NAN))),
        told(false, draw(Draw::Below((1 << 24) + 1))),
        told(false, draw(Draw::Geometric(0.5))),
        told(false, |start| _ = start.task.sometimes(f64::NAN, Draw::Unit)),
        told(false, |start| start.numbers[1] = start.task.uniform(0.5, 1.0)),
        told(true, |start| start.goal.number(1.0)),
        told(true, draw(Draw::Geometric(f64::INFINITY))),
        told(true, |start| start.again(100, |start| start.reset.normal().lt(0.0))),
    ];
    let wanted = ["one part", "0.1", "0.1", "2^24", "from 1", "chance", "Robot::varying", "by place", "from 1", "256"];
    for (refusal, wanted) in refusals.into_iter().zip(wanted) {
        let text = refusal.expect_err(wanted).to_string();
        assert!(text.contains(wanted), "{text}");
    }
    assert!(told(true, |start| start.again(60, |start| start.reset.normal().lt(0.0))).is_ok());
    assert!(told(false, draw(Draw::Below(1 << 24))).is_ok());
}

#[test]
fn a_start_that_answers_otherwise_when_it_is_asked_again_is_refused() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    // more draws, other draws, a longer goal
    for kind in 0..3 {
        let asked = AtomicUsize::new(0);
        let refusal = told(false, move |start| {
            // the third time it is recorded
            let is_changed = asked.fetch_add(1, Ordering::Relaxed) >= 2;
            match (kind, is_changed) {
                (0, true) => (0..9).for_each(|_| _ = start.task.unit()),
                (1, true) => _ = start.task.normal(),
                (2, true) => {
                    _ = start.task.unit();
                    start.goal.field("more", "-", "than before").number(1.0);
                }
                _ => _ = start.task.unit(),
            }
        });
        let text = refusal.expect_err("another start").to_string();
        let wanted = if kind == 2 { "as of the ideal" } else { "those of the first time" };
        assert!(text.contains("start") && text.contains(wanted), "{text}");
    }
}

#[test]
fn the_attempt_that_is_accepted_is_followed_by_what_is_drawn_behind() {
    let tell = |start: &mut Start<'_>| {
        start.again(100, |start| {
            start.state[0] = start.task.unit();
            start.state[0].lt(0.25)
        });
        start.state[1] = start.task.unit();
    };
    let mut env = told(false, tell).unwrap();
    env.reset(None, None, &mut Buffers::new(env.spec()).out()).unwrap();
    for i in 0..env.spec().n_env {
        let mut stream = Stream::new(0, i as u64, 1, Purpose::TASK);
        let accepted = (0..100).map(|_| stream.unit()).find(|x| *x < 0.25).unwrap();
        let state = env.state(i).unwrap();
        assert_eq!(state[..2], [accepted as f32, stream.unit() as f32], "{i}");
    }
}

#[test]
fn starts_are_those_of_the_table_of_when_they_were_computed_in_f64() {
    for row in include_str!("../assets/starts.txt").lines().skip(1) {
        let [task, text, environment, numbers] = row.split('|').collect::<Vec<_>>()[..] else { panic!("{row}") };
        let config = EnvConfig { n_env: 70, ..EnvConfig::from_toml(&text.replace("\\n", "\n"), "text").unwrap() };
        let mut env = Env::make(task, &config).unwrap();
        let mut out = Buffers::new(env.spec());
        (0..2).for_each(|_| env.reset(None, None, &mut out.out()).unwrap());
        let i: usize = environment.parse().unwrap();
        let now = [env.state(i).unwrap(), env.goal(i).unwrap()].concat();
        let then: Vec<f32> = numbers.split(' ').map(|x| x.parse().unwrap()).collect();
        assert_eq!(now.len(), then.len(), "{task}");
        let off = now.iter().zip(&then).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f32::max);
        assert!(off < 1e-6, "{task} {text} {i}: {off:e}"); // 5e-7
    }
}

/// Counts its events, one in every step, and leaves the mass, which may vary.
struct Counting {
    robot: Robot,
    on_host: bool,
}

fn count<S: StartScalar>(start: &mut Start<'_, S>) {
    start.goal[0] += S::one();
    start.task_state[0] += S::one();
    start.event_at += S::one();
}

impl HostStart for Counting {
    fn start(&self, start: &mut Start<'_, f64>) {
        start.goal.field("count", "-", "of events").number(0.0);
        start.event_at = 1.0;
    }
    fn event(&self, start: &mut Start<'_, f64>) {
        count(start);
    }
}

#[rustfmt::skip]
impl Task for Counting {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { 50 }
    fn start(&self, start: &mut Start<'_>) {
        start.goal.field("count", "-", "of events").number(0.0);
        start.event_at = 1.0.into();
    }
    fn event(&self, start: &mut Start<'_>) { count(start); }
    fn start_on_host(&self) -> Option<&dyn HostStart> { self.on_host.then_some(self) }
    fn remember(&self, view: &View, out: &mut Writer) { out.field("count", "-", "of events").number(view.task_state[0]); }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("count", "-", "of events").number(view.goal[0]);
        out.field("kept", "-", "count that is kept").number(view.task_state[0]);
    }
    fn reward(&self, _: &View, terms: &mut Writer) { terms.term("alive", "1", 1.0).number(Trace::one()); }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, view: &View) -> TraceMask { view.step.lt(0.0).and(view.step.gt(0.0)) }
    fn ideal(&self, start: &mut Start<'_>) { Task::start(self, start); }
}

#[test]
fn events_change_the_goal_whether_or_not_they_change_a_number_that_varies() {
    let config = EnvConfig { n_env: 70, ..EnvConfig::default() };
    for (on_host, varies) in [(false, false), (false, true), (true, false), (true, true)] {
        let robot = config.single_robot("hummingbird").unwrap();
        let robot = if varies { robot.varying([1]) } else { robot };
        let mut env = Env::of(Counting { robot, on_host }, "counting", &config).unwrap();
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        for step in 1..20 {
            env.step(&[0.0; 4 * 70], &mut out.out()).unwrap();
            assert!(out.observation.iter().all(|count| *count == step as f32), "{on_host} {varies} {step}");
        }
    }
}
