//! What tables tell of every task, and whether it is so.

use omnidrones::layers::Layer;
use omnidrones::tasks::registry::{REGISTRY, by_name};
use omnidrones::tasks::{Autoreset, Baseline, Env, EnvConfig, EvaluationStep, Success, evaluate};

fn one(name: &str) -> Env {
    Env::make(name, &EnvConfig { n_env: 1, ..EnvConfig::default() }).unwrap()
}

#[test]
fn a_list_that_is_given_empty_is_empty_and_one_that_is_not_given_is_the_tasks_own() {
    let entry = by_name("HoverRand").unwrap();
    let changes = |config: &EnvConfig| {
        entry.env(&EnvConfig { n_env: 1, ..config.clone() }).unwrap().spec().config.changes().len()
    };
    let of = |text: &str| EnvConfig::from_toml(text, "my.toml").unwrap();
    assert_eq!((changes(&of("")), changes(&of("randomise = []"))), (9, 0));
    assert_eq!(changes(&EnvConfig { randomise: Some(Vec::new()), ..EnvConfig::default() }), 0);
    let over = |text: &str| changes(&entry.config(&[Layer::of_text(text, "my.toml").unwrap()]).unwrap());
    assert_eq!((over("dt = 0.016"), over("randomise = []")), (9, 0));
}

#[test]
fn the_defaults_of_a_task_are_changes_and_settings_of_the_task() {
    for entry in REGISTRY {
        let table = toml::from_str::<toml::Table>(entry.defaults).unwrap();
        assert!(
            table.keys().all(|key| ["randomise", "sensor", "task"].contains(&key.as_str())),
            "{}: {table}",
            entry.name
        );
    }
}

#[test]
fn every_task_tells_its_start_its_success_and_its_loss() {
    for entry in REGISTRY {
        let env = one(entry.name);
        let own = env.task_spec();
        let (success, loss) = (own.success.text(), own.loss_text());
        assert!(own.about.contains("Start: "), "{}: {}", entry.name, own.about);
        assert!(success.contains(" < 0.") && loss.contains("√("), "{}: {success}; {loss}", entry.name);
        let fields = own.observation.iter().chain(&own.central).chain(&own.goal).chain(&own.task_state);
        let formulas = own.reward.iter().map(|t| &t.formula).chain(own.ends.iter().map(|e| &e.condition));
        let texts = [&own.about, &success, &loss].into_iter().chain(formulas);
        for text in texts.chain(fields.map(|f| &f.meaning)) {
            // e^{−x} is a formula, {key} a setting that there is not
            let holes = text.replace("e^{", "").matches('{').count();
            assert!(holes == 0 && !text.is_empty(), "{}: {text}", entry.name);
        }
    }
    let success = one("OmavHover").task_spec().success.text();
    let pose = "position_error < 0.1 m and heading_alignment > 0.95 and uprightness > 0.95 in the last step";
    assert_eq!(success, pose);
    assert_eq!(one("Track").task_spec().success.text(), "position_error < 0.3 m through the last 2 s");
    for (name, own) in [("OmavTrack", "tilt"), ("HoverRand", "are drawn"), ("TrackRand", "every motor are drawn")] {
        assert!(by_name(name).unwrap().own.contains(own), "{name}");
    }
    assert!(one("FlyThrough").task_spec().success.once && !one("Hover").task_spec().success.once);
}

#[test]
fn the_words_of_a_task_follow_its_settings() {
    let text = "[task]\nreward_effort = 0.25\nmax_distance = 3.5\nsuccess_distance = 0.05";
    let config = EnvConfig { n_env: 1, ..EnvConfig::from_toml(text, "own").unwrap() };
    let env = Env::make("Hover", &config).unwrap();
    let own = env.task_spec();
    assert_eq!((own.reward[3].formula.as_str(), own.reward[3].bound), ("0.25 e^{−e}", 0.25));
    assert_eq!((own.ends[1].condition.as_str(), own.success.limits[0].below), ("d > 3.5", 0.05));
    assert_eq!(env.spec().reward_bound, 3.25);
}

const N: usize = 4;

/// What flights of 4.8 s need not show: a success (true) or a step without one (false), and why.
const UNSEEN: &[(&str, bool, &str)] = &[
    ("InvPendulumHover", true, "the ball may be under way for longer"),
    ("PayloadHover", true, "the ball is pushed"),
    ("OverHover", true, "the platform may be under way for longer"),
    ("OverTrack", true, "our controller takes four seconds to turn the frame, and a success lasts two"),
    ("TransportHover", true, "the box may be under way for longer"),
    ("DragonHover", true, "the chain may be under way for longer"),
    ("Forest", true, "the way to the other side takes longer"),
    ("Race", true, "the course takes longer"),
    ("Formation", true, "the drones may be under way for longer"),
    ("GateSwitch", true, "the second drone waits for its turn"),
];

#[test]
fn success_is_what_it_is_said_to_be() {
    for entry in REGISTRY {
        let mut config = EnvConfig { n_env: N, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
        config.task.insert("horizon".into(), 300.into());
        let mut env = entry.env(&config).unwrap();
        let Ok(mut own) = Baseline::new(&env) else { continue };
        let spec = env.spec().clone();
        let Success { limits, also, once, held } = spec.success.clone();
        let hold = (held / spec.dt).round().max(1.0) as usize;
        // steps in a row with all limits kept, and since one that is too near to tell
        let (mut row, mut clear) = ([0; N], [hold; N]);
        let (mut before, mut seen) = ([false; N], [false; 2]);
        let mut watch = |watched: &EvaluationStep<'_>| {
            let told = |i: usize, name: &str| {
                f64::from(watched.out.info[i * spec.info.len() + spec.info_column(name).unwrap()])
            };
            for i in (0..N).filter(|i| watched.flying[*i] && watched.out.terminated[*i] == 0) {
                let near = limits
                    .iter()
                    .any(|l| [l.below, l.above].iter().any(|limit| (told(i, &l.metric) - limit).abs() < 1e-4));
                clear[i] = if near { 0 } else { clear[i] + 1 };
                row[i] = if limits.iter().all(|l| l.holds(told(i, &l.metric))) { row[i] + 1 } else { 0 };
                before[i] = row[i] >= hold || once && before[i];
                let success = told(i, "success") > 0.5;
                seen[usize::from(success)] = true;
                assert!(
                    clear[i] < hold || success == before[i] || !also.is_empty() && !success,
                    "{}, step {}",
                    entry.name,
                    watched.step
                );
            }
        };
        evaluate(&mut env, &mut own.policy(), &mut watch).unwrap();
        for success in [false, true] {
            let excused = UNSEEN.iter().any(|(name, what, _)| (*name, *what) == (entry.name, success));
            assert!(excused || seen[usize::from(success)], "{}: no step with success {success}", entry.name);
        }
    }
}
