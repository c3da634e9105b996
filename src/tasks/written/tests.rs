use super::*;
use crate::env::{Buffers, Env};
use crate::grove::Grove;
use crate::registry::REGISTRY;
use crate::start::{ManyDraw, StartScalar};
use autodiff::floor;
use dynamics::scene::Forest;

/// A task that is asked as it is.
struct Asked<'a>(&'a dyn Task);

impl TaskAuthor for Asked<'_> {
    type Fault = Error;
    fn task(&self) -> &dyn Task {
        self.0
    }
}

/// The task of an entry, written down.
fn record(task: &dyn Task, name: &str, config: &EnvConfig) -> Arc<TaskRecord> {
    Arc::new(TaskRecord::of(&Asked(task), name, Base::Task(name.into()), config).unwrap())
}

#[test]
fn a_written_task_is_recorded_as_the_task_itself_before_and_behind_a_file() {
    for entry in REGISTRY {
        let config = EnvConfig { n_env: 2, ..entry.default_config().unwrap() };
        let task = entry.task(&config).unwrap();
        let record = record(&*task, entry.name, &config);
        let read = Arc::new(TaskRecord::from_bytes(&record.to_bytes().unwrap()).unwrap());
        assert_eq!((&record.phases, record.sizes), (&read.phases, read.sizes), "{}", entry.name);
        let written = read.task(&config).unwrap();
        let own = Env::of_task(task, entry.name, &config).unwrap();
        let again = Env::of_task(Box::new(written), entry.name, &config).unwrap();
        assert_eq!(own.spec(), again.spec(), "{}", entry.name);
        assert_eq!(own.task_spec(), again.task_spec(), "{}", entry.name);
        assert!(own.is_recorded_alike(&again), "{}", entry.name);
    }
}

#[test]
fn a_written_task_refuses_what_it_was_not_written_down_with() {
    let entry = crate::registry::by_name("Hover").unwrap();
    let config = EnvConfig { n_env: 1, ..EnvConfig::default() };
    let record = record(&*entry.task(&config).unwrap(), "Hover", &config);
    let other = EnvConfig::from_toml("task.vehicle = 'firefly'", "test").unwrap();
    let told = record.task(&other).err().unwrap().to_string();
    assert!(
        told.contains("numbers of the state of what flies is 19") && told.contains("17, as written down"),
        "{told}"
    );
}

/// Begins by draws that depend on drawn numbers.
struct Picks {
    robot: Robot,
    trunks: ManyDraw,
    is_on_host: bool,
}

/// Trunks of its forest.
const TRUNKS: usize = 4;

impl Picks {
    fn new(is_on_host: bool) -> Self {
        let forest = Forest { trunks: TRUNKS, ..Forest::default() };
        let trunks = ManyDraw::Forest(Box::new(Grove::new(forest).unwrap()));
        Self { robot: EnvConfig::default().single_robot("hummingbird").unwrap(), trunks, is_on_host }
    }

    /// Three numbers below five, all different, and trunks, of which as many stand as the first of them says; then one number below 0.1.
    fn begin<S: StartScalar>(&self, start: &mut Start<'_, S>) {
        let first = start.reset.below(5);
        let second = start.reset.below_other_than(5, &[first]);
        let third = start.reset.below_other_than(5, &[second, first]);
        let mut offsets = [S::zero(); 3 * TRUNKS];
        start.task.many(&self.trunks, &[floor(first + S::constant(0.25))], &mut offsets);
        start.goal.field("picks", "", "different").array([first, second, third]);
        start.goal.field("trunks", "m", "offsets").array(offsets);
        let mut low = S::zero();
        start.again(200, |start| {
            low = start.reset.unit();
            low.lt(S::constant(0.1))
        });
        start.goal.field("low", "", "below 0.1").number(low);
    }
}

impl HostStart for Picks {
    fn start(&self, start: &mut Start<'_, f64>) {
        self.begin(start);
    }
}

impl Task for Picks {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        10
    }
    fn start(&self, start: &mut Start<'_>) {
        self.begin(start);
    }
    fn start_on_host(&self) -> Option<&dyn HostStart> {
        self.is_on_host.then_some(self)
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        out.field("goal", "", "all of it").array(view.goal.to_vec());
    }
    fn reward(&self, _: &View, terms: &mut Writer) {
        terms.term("alive", "1", 1.0).number(Trace::one());
    }
    fn ends(&self, _: &View, _: &mut Ends) {}
    fn success(&self, _: &View) -> TraceMask {
        Trace::one().lt(Trace::zero())
    }
    fn ideal(&self, start: &mut Start<'_>) {
        self.begin(start);
    }
}

/// Writes a task down that begins on the host, or says that it does not.
struct Author<'a>(&'a Picks, bool);

impl TaskAuthor for Author<'_> {
    type Fault = Error;
    fn task(&self) -> &dyn Task {
        self.0
    }
    fn begin(&self, phase: &str, mut pad: StartPad) -> StartPad {
        if phase == "event" {
            return pad;
        }
        // `again` is no part of what a pad does at once
        pad.with(&self.0.robot, |start| {
            let first = start.reset.below(5);
            let second = start.reset.below_other_than(5, &[first]);
            let third = start.reset.below_other_than(5, &[second, first]);
            let mut offsets = [Trace::zero(); 3 * TRUNKS];
            start.task.many(&self.0.trunks, &[floor(first + 0.25)], &mut offsets);
            start.goal.field("picks", "", "different").array([first, second, third]);
            start.goal.field("trunks", "m", "offsets").array(offsets);
        });
        pad.begin_again(200);
        let low = pad.with(&self.0.robot, |start| start.reset.unit());
        pad.accept(low.lt(0.1));
        pad.with(&self.0.robot, |start| start.goal.field("low", "", "below 0.1").number(low));
        pad
    }
    fn starts_on_host(&self) -> bool {
        self.1
    }
}

fn goals_after_three_resets(task: Box<dyn Task>) -> Vec<Vec<f32>> {
    let mut env = Env::of_task(task, "Picks", &EnvConfig { n_env: 70, ..EnvConfig::default() }).unwrap();
    let mut buffers = Buffers::new(env.spec());
    (0..3).for_each(|_| env.reset(None, None, &mut buffers.out()).unwrap());
    (0..70).map(|i| env.goal(i).unwrap()).collect()
}

/// [`Picks`], written down whole.
fn picks() -> TaskRecord {
    let own = OwnTask {
        robot: RobotSource::Vehicle { vehicle: "hummingbird".into(), disturbance: false },
        varied: Vec::new(),
        about: String::new(),
        horizon: 10,
        settings: Vec::new(),
        success_rule: Success::default(),
        scene: Scene::grounded(),
    };
    TaskRecord::of(&Author(&Picks::new(false), true), "Picks", Base::Own(Box::new(own)), &EnvConfig::default()).unwrap()
}

#[test]
fn a_recorded_start_on_the_host_draws_the_bits_of_the_start_itself() {
    let direct = goals_after_three_resets(Box::new(Picks::new(true)));
    let record = picks();
    // as it comes out of a file
    let record = Arc::new(TaskRecord::from_bytes(&record.to_bytes().unwrap()).unwrap());
    let written = goals_after_three_resets(Box::new(record.task(&EnvConfig::default()).unwrap()));
    assert_eq!(direct, written);
    for goal in &direct {
        assert!(goal[0] != goal[1] && goal[0] != goal[2] && goal[1] != goal[2] && goal[..3].iter().all(|x| *x < 5.0));
        let standing = (0..TRUNKS).filter(|i| goal[3 + 3 * i + 2] == 0.0).count();
        assert!(standing == goal[0] as usize || goal[0] == 0.0, "{goal:?}");
        assert!(*goal.last().unwrap() < 0.1);
    }
    assert!(direct.iter().any(|goal| goal[..3] != direct[0][..3]), "not all are alike");
}

#[test]
fn what_only_the_host_draws_is_refused_where_starts_are_recorded() {
    let remedy = "Begin episodes on the host";
    let task = Picks::new(false);
    let told = TaskRecord::of(&Author(&task, false), "Picks", Base::Task("Hover".into()), &EnvConfig::default());
    let told = told.err().unwrap().to_string();
    assert!(told.contains(remedy), "{told}");
    let told = Env::of_task(Box::new(task), "Picks", &EnvConfig { n_env: 1, ..EnvConfig::default() });
    let told = told.err().unwrap().to_string();
    assert!(told.contains(remedy), "{told}");
}

/// A task of one's own, as a class in another language is one: whole.
fn whole() -> TaskRecord {
    let config = EnvConfig::default();
    let task = crate::registry::by_name("Hover").unwrap().task(&config).unwrap();
    let own = OwnTask {
        robot: RobotSource::Vehicle { vehicle: "hummingbird".into(), disturbance: false },
        varied: Vec::new(),
        about: task.about().into(),
        horizon: task.horizon(),
        settings: task.settings(),
        success_rule: task.success_rule(),
        scene: task.scene(),
    };
    TaskRecord::of(&Asked(&*task), "Again", Base::Own(Box::new(own)), &config).unwrap()
}

#[test]
fn a_whole_record_needs_no_task_and_refuses_other_settings() {
    let record = Arc::new(TaskRecord::from_bytes(&whole().to_bytes().unwrap()).unwrap());
    let config = EnvConfig { n_env: 2, ..EnvConfig::default() };
    let own = Env::of_task(Box::new(record.task(&config).unwrap()), "Hover", &config).unwrap();
    assert!(own.is_recorded_alike(&Env::make("Hover", &config).unwrap()));
    let other = EnvConfig::from_toml("task.min_height = 0.3", "test").unwrap();
    let told = record.task(&other).err().unwrap().to_string();
    assert!(told.contains("task.min_height is 0.3, but it must be 0.2, with which Again was written down"), "{told}");
}

#[test]
fn a_record_is_found_by_its_name_and_settings() {
    let record = Arc::new(TaskRecord { name: "FoundByName".into(), ..whole() });
    register_record(&record).unwrap();
    let config = EnvConfig { n_env: 2, ..EnvConfig::default() };
    assert!(Env::make("foundbyname", &config).unwrap().is_recorded_alike(&Env::make("Hover", &config).unwrap()));
    let other = EnvConfig::from_toml("task.horizn = 3", "test").unwrap();
    let told = Env::make("FoundByName", &other).unwrap_err().to_string();
    assert!(told.contains("Did you mean `horizon`?"), "{told}");
    let taken = register_record(&Arc::new(TaskRecord { name: "Track".into(), ..whole() })).unwrap_err().to_string();
    assert!(taken.contains("one that is not taken"), "{taken}");
}

/// Changes bytes of a file, lengths, or cuts it.
fn with_other_bytes(bytes: &[u8], random: &mut rng::Stream) -> Vec<u8> {
    let mut own = bytes.to_vec();
    for _ in 0..1 + random.below(4) {
        let at = random.below(own.len() as u64) as usize;
        match random.below(5) {
            0 => own[at] ^= 1 << random.below(8),
            1 => own[at] = random.below(256) as u8,
            2 => own.truncate(at.max(1)),
            3 => own.insert(at, random.below(256) as u8),
            _ => {
                let from = random.below(own.len() as u64) as usize;
                own[at] = own[from];
            }
        }
    }
    own
}

/// Changes what the file says: a number, a text, an entry that is gone or moved.
fn with_other_words(bytes: &[u8], random: &mut rng::Stream) -> Vec<u8> {
    let n = u32::from_le_bytes(bytes[9..13].try_into().unwrap()) as usize;
    let mut json: serde_json::Value = serde_json::from_slice(&bytes[13..13 + n]).unwrap();
    for _ in 0..1 + random.below(2) {
        change(&mut json, random);
    }
    let text = serde_json::to_vec(&json).unwrap();
    [&bytes[..9], &(text.len() as u32).to_le_bytes(), &text, &bytes[13 + n..]].concat()
}

/// Changes something at any depth.
fn change(json: &mut serde_json::Value, random: &mut rng::Stream) {
    use serde_json::Value;
    let inner = match json {
        Value::Object(all) if !all.is_empty() => {
            let key = all.keys().nth(random.below(all.len() as u64) as usize).unwrap().clone();
            if random.below(12) == 0 {
                all.remove(&key);
                return;
            }
            if random.below(12) == 0 {
                let other = all.values().nth(random.below(all.len() as u64) as usize).unwrap().clone();
                all.insert(key, other);
                return;
            }
            all.get_mut(&key)
        }
        Value::Array(all) if !all.is_empty() => {
            let at = random.below(all.len() as u64) as usize;
            match random.below(12) {
                0 => return drop(all.remove(at)),
                1 => return all.push(all[at].clone()),
                _ => all.get_mut(at),
            }
        }
        _ => None,
    };
    let Some(inner) = inner else {
        let numbers = [0, 1, 2, 3, 17, 1 << 20, 1 << 32, u64::MAX];
        let k = random.below(12) as usize;
        *json = match numbers.get(k) {
            Some(n) => Value::from(*n),
            None if k == 8 => Value::from(-1),
            None if k == 9 => Value::from(1e300),
            None if k == 10 => Value::from("Hover"),
            None => Value::Null,
        };
        return;
    };
    change(inner, random);
}

/// Records of every kind.
fn records() -> Vec<Vec<u8>> {
    let config = EnvConfig::default();
    let of = |name: &str| {
        let entry = crate::registry::by_name(name).unwrap();
        record(&*entry.task(&config).unwrap(), name, &config).to_bytes().unwrap()
    };
    let mut all = vec![whole().to_bytes().unwrap(), picks().to_bytes().unwrap()];
    // a part that is drawn again; an event; what is kept
    all.extend(["Hover", "PayloadHover", "FlyThrough"].map(of));
    all
}

/// Every mutant is refused, or is a task: environments of it step, or cannot be made.
fn mutants(n: usize, seed: u64) {
    let records = records();
    let mut random = rng::Stream::new(seed, 0, 0, rng::Purpose::user(66));
    let config = EnvConfig { n_env: 2, memory_limit: 1 << 28, ..EnvConfig::default() };
    let mut accepted = 0;
    for k in 0..n {
        let bytes = &records[k % records.len()];
        let bytes =
            if k % 2 == 0 { with_other_bytes(bytes, &mut random) } else { with_other_words(bytes, &mut random) };
        let Ok(record) = TaskRecord::from_bytes(&bytes) else { continue };
        let Ok(task) = Arc::new(record).task(&config) else { continue };
        let Ok(mut env) = Env::of_task(Box::new(task), "Mutant", &config) else { continue };
        accepted += 1;
        let mut out = Buffers::new(env.spec());
        env.reset(None, None, &mut out.out()).unwrap();
        let actions = vec![0.1; 2 * env.spec().n_agent * env.spec().action.len()];
        (0..3).for_each(|_| env.step(&actions, &mut out.out()).unwrap());
    }
    assert!(accepted > n / 100, "{accepted} of {n} mutants were tasks: hardly anything was tried");
}

#[test]
fn mutated_records_are_refused_or_harmless() {
    mutants(1_000, 1);
}

/// `cargo test --release -p omnidrones-tasks --lib mutated_records_at_length -- --ignored`
#[test]
#[ignore = "two minutes: .ci/nightly mutants"]
fn mutated_records_at_length_are_refused_or_harmless() {
    let n = std::env::var("FUZZ_N").ok().and_then(|n| n.parse().ok());
    mutants(n.unwrap_or(1_000_000), 2);
}
