//! Recorded functions say what environments say.

use super::*;
use crate::config::Autoreset;
use crate::env::{Buffers, Column};
use crate::observation::Statistics;
use crate::registry::names;
use crate::{Ends, Robot, Start, Task, View, Writer};
use autodiff::program::Workspace;
use autodiff::{Program, TraceMask};

/// Environments of a flight.
const N: usize = 3;

/// A function that is called, with its memory.
struct Called {
    function: NamedFunction,
    program: Program,
    work: Workspace,
    memory: Vec<f64>,
}

impl Called {
    fn new(function: &NamedFunction) -> Self {
        let program = Program::compile(&function.recording).unwrap();
        let n = |access: Access| {
            let own = function.arrays.iter().filter(|array| array.access == access || array.access == Access::Update);
            own.map(|array| array.numbers.len()).sum::<usize>()
        };
        assert_eq!((program.n_input(), program.n_output()), (n(Access::Read), n(Access::Write)), "{}", function.name);
        let mut own = Self { work: program.workspace(), program, function: function.clone(), memory: Vec::new() };
        own.begin();
        own
    }

    fn begin(&mut self) {
        self.memory = vec![0.0; self.numbers("memory").len()];
    }

    fn numbers(&self, array: &str) -> &[NamedNumber] {
        self.function.arrays.iter().find(|own| own.name == array).map_or(&[], |own| &own.numbers)
    }

    /// The arrays that are written.
    fn call(&mut self, given: &[(&str, &[f64])]) -> Vec<Vec<f64>> {
        let mut inputs = Vec::new();
        for array in self.function.arrays.iter().filter(|array| array.access != Access::Write) {
            let own = given.iter().find(|(name, _)| *name == array.name).map_or(&self.memory[..], |(_, x)| x);
            assert_eq!(own.len(), array.numbers.len(), "numbers of {}", array.name);
            inputs.extend_from_slice(own);
        }
        let mut outputs = vec![0.0; self.program.n_output()];
        self.program.evaluate(&mut self.work, &inputs, &mut outputs);
        let (memory, mut rest) = outputs.split_at(self.memory.len());
        self.memory.copy_from_slice(memory);
        let written = self.function.arrays.iter().filter(|array| array.access == Access::Write);
        let take = |array: &NamedArray| {
            let (own, behind) = rest.split_at(array.numbers.len());
            rest = behind;
            own.to_vec()
        };
        written.map(take).collect()
    }
}

/// The larger of a bound so far and of how far numbers of `f32` are from those of `f64`, in their size from 1 on.
fn off(worst: f64, own: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(own.len(), exact.len());
    own.iter().zip(exact).fold(worst, |worst, (a, b)| worst.max((f64::from(*a) - b).abs() / b.abs().max(1.0)))
}

fn exact(numbers: &[f32]) -> Vec<f64> {
    numbers.iter().map(|x| f64::from(*x)).collect()
}

/// Three environments that begin, with statistics of a normaliser.
fn begun(task: &str, text: &str) -> (Env, Buffers) {
    let mut config = EnvConfig { n_env: N, seed: 7, ..EnvConfig::from_toml(text, "text").unwrap() };
    config.autoreset = Autoreset::Disabled;
    config.task.entry("horizon").or_insert(50.into());
    let mut env = Env::make(task, &config).unwrap();
    let mut out = Buffers::new(env.spec());
    let all = |of: fn(usize) -> f64| (0..env.core.sizes.normalised).map(of).collect();
    let (mean, variance) = (all(|k| 0.1 * (k % 7) as f64), all(|k| 0.5 + 0.2 * (k % 5) as f64));
    env.set_statistics(Statistics { count: 100.0, mean, variance }).unwrap();
    env.reset(None, None, &mut out.out()).unwrap();
    (env, out)
}

/// Numbers of a clock.
const CLOCK: usize = 4;

/// What became of flights of random actions.
#[derive(Debug, Default)]
struct Flown {
    /// How far off what is observed, rewarded, reported is.
    seen: f64,
    rewarded: f64,
    reported: f64,
    /// Episodes by how they ended.
    terminated: usize,
    truncated: usize,
    /// Steps that were a success.
    success: usize,
    /// Of observe, judge and act.
    n_operation: [usize; 3],
    n_memory: [usize; 3],
}

/// Flies so many steps, and asks the functions in every one.
fn flown(task: &str, text: &str, n_step: u64) -> Flown {
    let (mut env, mut out) = begun(task, text);
    let functions = env.functions().unwrap();
    let [mut judges, mut observers] =
        [&functions.judge, &functions.observe].map(|function| [(); N].map(|()| Called::new(function)));
    let (spec, n_seen) = (env.spec().clone(), env.spec().n_agent * env.spec().n_observation);
    let [success, reason] = [Column::Success, Column::Reason].map(|column| spec.needed_column(column).unwrap());
    let (terms, metrics) = (spec.term_columns(), spec.metric_columns());
    let all = [&functions.observe, &functions.judge, &functions.act].map(Called::new);
    let mut worst = Flown {
        n_operation: all.each_ref().map(|own| own.program.len()),
        n_memory: all.each_ref().map(|own| own.memory.len()),
        ..Flown::default()
    };
    let (mut begins, mut is_new) = ([true; N], [true; N]);
    let (mut sums, mut goals) = (vec![vec![0.0; terms.len()]; N], vec![Vec::new(); N]);
    let mut actions = vec![0.0; N * env.core.sizes.action];
    for t in 0..n_step {
        if env.core.estimating.is_some() {
            env.take_states_for_estimates();
            env.observe(&mut out.out()).unwrap();
        }
        for lane in (0..N).filter(|lane| is_new[*lane]) {
            let (state, goal) = (exact(&env.state(lane).unwrap()), exact(&env.goal(lane).unwrap()));
            let ShownBeside { start, varied, readings } = env.shown_beside(lane).unwrap();
            if begins[lane] {
                judges[lane].begin();
                observers[lane].begin();
                sums[lane].fill(0.0);
                goals[lane].clone_from(&goal);
            }
            let mut given = [
                ("state", &state[..]),
                ("goal", &goals[lane]),
                ("start", &start),
                ("varied", &varied),
                ("readings", &readings),
            ];
            let told = &out.info[lane * spec.info.len()..][..spec.info.len()];
            // what diverged stands at rest
            if told[reason] as usize <= spec.ends.len() {
                let judged = judges[lane].call(&given);
                let [reward, own_terms, ends, reasons] = &judged[..4] else { panic!("written arrays") };
                let own = reasons.iter().position(|x| *x == 1.0).map_or(0, |k| k + 1);
                let flags = [out.terminated[lane].into(), out.truncated[lane].into(), told[success]].map(f64::from);
                assert_eq!((&ends[..], own), (&flags[..], told[reason] as usize), "{task} with {text}, step {t}");
                sums[lane].iter_mut().zip(own_terms).for_each(|(sum, x)| *sum += x);
                worst.rewarded = off(worst.rewarded, &out.reward[lane * spec.n_agent..][..1], reward);
                worst.rewarded = off(worst.rewarded, &told[terms.clone()], &sums[lane]);
                if !begins[lane] && !metrics.is_empty() {
                    worst.reported = off(worst.reported, &told[metrics.clone()], &judged[4]);
                }
                given[1].1 = &goal;
                let seen = observers[lane].call(&given);
                let shown = &out.observation[lane * n_seen..][..n_seen];
                if out.truncated[lane] == 0 {
                    worst.seen = off(worst.seen, shown, &seen[0]);
                } else {
                    // episodes of functions do not end: where the horizon ends them here, the clock there is a step behind
                    let n_behind =
                        shown.iter().zip(&seen[0]).filter(|(own, exact)| off(0.0, &[**own], &[**exact]) > 2e-5);
                    assert!(n_behind.count() <= spec.n_agent * CLOCK, "{task} with {text}, step {t}");
                }
            }
            worst.success += usize::from(told[success] > 0.5);
            worst.terminated += usize::from(out.terminated[lane] > 0);
            worst.truncated += usize::from(out.truncated[lane] > 0);
            begins[lane] = out.terminated[lane] + out.truncated[lane] > 0;
            goals[lane] = goal;
        }
        if begins.contains(&true) {
            env.reset(Some(&begins), None, &mut out.out()).unwrap();
            is_new = begins;
            continue;
        }
        is_new = [true; N];
        env.sample(t, &mut actions);
        env.step(&actions, &mut out.out()).unwrap();
    }
    worst
}

#[test]
fn functions_of_every_task_say_what_its_environments_say() {
    let history = "observation = [{ kind = 'history', steps = 3 }, { kind = 'normalise' }, { kind = 'privileged' }]";
    let normal = "throttle_change = 0.2\nobservation = [{ kind = 'normalise' }, { kind = 'history', steps = 2 }]";
    let mut n_end = [0; 2];
    for (i, task) in names().into_iter().enumerate() {
        let text = ["", history, normal][i % 3];
        let own = flown(task, text, 120);
        let (Flown { seen, rewarded, reported, .. }, ended) = (&own, (own.terminated, own.truncated, own.success));
        println!(
            "{task}: off by {seen:.1e}, {rewarded:.1e}, {reported:.1e} in {ended:?} ends and successes; {:?} operations, {:?} remembered",
            own.n_operation, own.n_memory
        );
        // 6.8e-6, 1.7e-6, 5.9e-7
        assert!(own.seen < 2e-5 && own.rewarded < 5e-6 && own.reported < 5e-6, "{task} with {text}: {own:?}");
        n_end = [n_end[0] + own.terminated, n_end[1] + own.truncated];
    }
    assert!(n_end[0] > 40 && n_end[1] > 40, "{n_end:?} episodes terminated and truncated");
}

#[test]
fn pushes_successes_sensors_and_estimates_are_said_as_environments_say_them() {
    let easy = "[task]\nsuccess_distance = 1e3\nsuccess_alignment = -1.0";
    let holds = "task = { success_distance = 1e3, success_time = 0.1 }";
    let imu = "[[sensor]]\nname = 'imu'\nkind = 'imu'\npreset = 'bmi088'\n";
    let sensed = format!("observation = [{{ kind = 'history', steps = 2 }}]\n{imu}");
    let estimated = format!(
        "observation = [{{ kind = 'estimate', readings = true }}, {{ kind = 'normalise' }}]\n{imu}\
         [[sensor]]\nname = 'cameras'\nkind = 'motion_capture'\npreset = 'optical'\nevery = 1\n"
    );
    for (task, text) in [
        ("PayloadHover", "task = { calm = 0.1 }"),
        ("Hover", easy),
        ("Track", holds),
        ("Hover", &sensed),
        ("Formation", &sensed),
        ("Hover", &estimated),
        ("Spread", &estimated),
    ] {
        let own = flown(task, text, 80);
        println!("{task}: {own:?}");
        // 3.2e-6, 4.4e-7, 4.6e-7
        assert!(own.seen < 1e-5 && own.rewarded < 2e-6 && own.reported < 2e-6, "{task} with {text}: {own:?}");
        assert!(own.success > 20 || ![easy, holds].contains(&text), "{own:?}");
    }
}

#[test]
fn a_state_beyond_its_bounds_is_worth_nothing_and_ends_the_episode() {
    let (env, _) = begun("Hover", "");
    let mut judge = Called::new(&env.functions().unwrap().judge);
    let (state, goal) = (exact(&env.state(0).unwrap()), exact(&env.goal(0).unwrap()));
    let names: Vec<String> = judge.numbers("reasons").iter().map(|own| own.name.clone()).collect();
    assert_eq!(names, ["crash", "far", "diverged"]);
    for (broken, within) in [(1e9, false), (f64::NAN, false), (state[3], true)] {
        judge.begin();
        let first = judge.call(&[("state", &state), ("goal", &goal)]);
        assert_eq!((first[0][0], &first[2][..]), (0.0, &[0.0; 3][..]));
        let mut next = state.clone();
        next[3] = broken;
        let [reward, terms, ends, reasons, _] = &judge.call(&[("state", &next), ("goal", &goal)])[..] else { panic!() };
        assert_eq!(ends[0] == 0.0, within);
        assert_eq!(reasons[2] == 0.0, within);
        assert_eq!(reward[0] > 0.0 && terms.iter().sum::<f64>() == reward[0], within);
    }
}

#[test]
fn actions_become_the_commands_of_every_computation() {
    for (task, text, n_act) in [
        ("Hover", "", 1),
        ("Hover", "control_rate = 3", 1),
        ("Hover", "control = 'rate'", 4),
        ("Hover", "control = 'attitude'", 4),
        ("Track", "control = 'velocity'\ncontrol_rate = 1", 1),
        ("Track", "control = 'velocity'", 4),
        ("Formation", "control = 'position'\ncontrol_rate = 3", 3),
        ("OmavHover", "", 1),
    ] {
        let (mut env, mut out) = begun(task, text);
        let functions = env.functions().unwrap();
        assert_eq!((functions.n_act, functions.act_period), (n_act, 0.016 / n_act as f64), "{task} with {text}");
        let words = Words::of(&env.core, &env.spec.config).unwrap();
        let mut act = Called::new(&functions.act);
        let mut actions = vec![0.0; N * env.core.sizes.action];
        let mut worst = 0.0_f64;
        for t in 0..6 {
            env.sample(t, &mut actions);
            // what is no number and what is too large
            (actions[0], actions[1]) = if t == 3 { (f32::NAN, 3.0) } else { (actions[0], actions[1]) };
            let own = exact(&actions[..env.core.sizes.action]);
            let mut computed = Vec::new();
            env.inside_step(0, &own, |step| {
                step.act();
                for k in 0..step.n_computation() {
                    let state = step.state();
                    step.steer(k);
                    computed.push((state, step.inputs()));
                    step.physics();
                }
            })
            .unwrap();
            for (state, input) in &computed[..n_act] {
                let commands = act.call(&[("action", &own), ("state", state)]);
                let exact: Vec<f64> = words.places.iter().map(|k| input[*k]).collect();
                worst = commands[0].iter().zip(&exact).fold(worst, |worst, (a, b)| worst.max((a - b).abs()));
            }
            assert!(act.memory.first().is_none_or(|computation| *computation == 0.0), "a step is over");
            env.step(&actions, &mut out.out()).unwrap();
        }
        println!("{task} with {text}: {worst:.1e}, {:?}", act.numbers("memory").len());
        assert!(worst == 0.0, "{task} with {text}: {worst:e}");
    }
}

#[test]
fn whole_numbers_become_the_commands_that_environments_make_of_them() {
    for (text, n) in [("discrete', levels = 3", 81), ("discrete', levels = 4", 256), ("multi_discrete', levels = 7", 7)]
    {
        let (env, _) = begun("Hover", &format!("actions = {{ kind = '{text} }}"));
        let mut act = Called::new(&env.functions().unwrap().act);
        let (control, beyond) = (&env.core.control, [-3.0, 1.49, 2.5, 1e6, f32::NAN, f32::INFINITY]);
        for x in (0..n).map(|k| k as f32).chain(beyond) {
            let own: Vec<f32> = (0..control.n_action()).map(|k| if k == 2 { 6.0 - x } else { x }).collect();
            let mut columns = vec![[0.0; BLOCK]; 4];
            control.decode(control.levels().unwrap(), &own, &mut columns);
            let commands = act.call(&[("action", &exact(&own))]);
            let host: Vec<f32> = columns.iter().map(|column| column[0]).collect();
            assert!(off(0.0, &host, &commands[0]) < 1e-7, "{x} of {text}: {host:?}, not {:?}", commands[0]);
        }
    }
}

#[test]
fn actions_that_correct_controllers_are_added_to_what_these_command() {
    let commanded = |action: f32| {
        let (mut env, mut out) = begun("Hover", "residual = 0.4");
        let mut actions = vec![0.0; 4 * N];
        env.sample(3, &mut actions);
        actions.iter_mut().for_each(|x| *x *= action);
        env.step(&actions, &mut out.out()).unwrap();
        let mut commands = vec![0.0; 4 * N];
        env.rotor_commands_into(&mut commands).unwrap();
        (env.functions().unwrap().act, actions, commands)
    };
    let ((act, _, controller), (_, actions, commands)) = (commanded(0.0), commanded(1.0));
    let own = Called::new(&act).call(&[("action", &exact(&actions[..4])), ("controller", &exact(&controller[..4]))]);
    assert!(off(0.0, &commands[..4], &own[0]) < 1e-6 && commands != controller, "{commands:?}, not {own:?}");
}

/// Counts events where no function sees them.
struct Counting(Robot);

impl Task for Counting {
    fn robot(&self) -> &Robot {
        &self.0
    }
    fn horizon(&self) -> usize {
        50
    }
    fn start(&self, start: &mut Start<'_>) {
        start.event_at = 3.0.into();
    }
    fn event(&self, start: &mut Start<'_>) {
        start.task_state[1] += Trace::one();
    }
    fn remember(&self, view: &View, task_state: &mut Writer) {
        task_state.field("counts", "-", "of nothing, and of events").array([view.task_state[0], view.task_state[1]]);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("velocity", "m/s, world", "v").array(view.drone(0).velocity);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("count", "c", 1.0).number(view.task_state[1]);
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, view: &View) -> TraceMask {
        view.step.lt(Trace::zero())
    }
    fn ideal(&self, _: &mut Start<'_>) {}
}

#[test]
fn events_that_no_function_sees_are_refused() {
    let config = EnvConfig::default();
    let env = Env::of(Counting(config.single_robot("hummingbird").unwrap()), "Counting", &config).unwrap();
    assert_eq!(
        env.functions().unwrap_err().to_string(),
        "an event of the task is one that changes 'counts_1', but it must be one that changes the goal alone. \
         Let events change the goal, which functions are given, and let the task keep what follows from it."
    );
}

#[test]
fn memory_holds_what_is_needed_and_every_number_has_a_name_of_its_own() {
    let names_of = |task: &str, text: &str| {
        let (env, _) = begun(task, text);
        let functions = env.functions().unwrap();
        for function in [&functions.observe, &functions.judge, &functions.act] {
            for array in &function.arrays {
                let mut names: Vec<&str> = array.numbers.iter().map(|own| own.name.as_str()).collect();
                let n = names.len();
                names.sort_unstable();
                names.dedup();
                assert_eq!((names.len(), n > 0), (n, true), "{task}: {} of {}", array.name, function.name);
            }
        }
        let observe = Called::new(&functions.observe);
        let names = |array: &str| observe.numbers(array).iter().map(|own| own.name.clone()).collect::<Vec<_>>();
        (names("memory"), names("observation"))
    };
    let twice = "observation = [{ kind = 'history', steps = 2 }, { kind = 'history', steps = 2 }]";
    for task in names() {
        names_of(task, if task == "Track" { twice } else { "" });
    }
    assert_eq!(names_of("Forest", "").0.len(), 0);
    assert_eq!(names_of("Hover", "").0, ["running", "step"]);
    let race = ["running", "position_x", "position_y", "position_z", "next"];
    assert_eq!(names_of("Race", "").0, race);
    let (memory, observation) = names_of("Formation", "observation = [{ kind = 'history', steps = 2 }]");
    for name in ["agent_0.attitude_w", "agent_2.velocity_1_ago_y", "agent_1.throttle_3"] {
        assert!(observation.iter().any(|own| own == name), "{name} among {observation:?}");
    }
    assert!(memory.contains(&"agent_1.velocity_1_ago_z".into()), "{memory:?}");
}
