//! Command lines that nobody means well by. Options are taken from the help of every command, so that a new one is attacked on
//! arrival.

use super::command::{command, exits, temporary};
use serde_json::Value;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest that a command may take, s.
const LONGEST: u64 = 10;

/// SplitMix64 (Steele, Lea & Flood 2014): the seed is all there is to repeat a line.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn of<'a, T: ?Sized>(&mut self, all: &[&'a T]) -> &'a T {
        all[self.next() as usize % all.len()]
    }
}

/// What is given where a value is asked for.
const VALUES: &[&str] = &[
    "",
    "0",
    "-1",
    "1",
    "2.5",
    "1e300",
    "-1e300",
    "1e-320",
    "NaN",
    "inf",
    "-inf",
    "18446744073709551616",
    "0x10",
    "..",
    "../../etc",
    "/dev/zero",
    "/dev/full",
    "/proc/self/mem",
    "pipe",
    "loop",
    "folder",
    "user",
    "user/config.toml",
    "torn.toml",
    "deep.toml",
    "bomb.urdf",
    "no such",
    "Hover",
    "hummingbird",
    "rotor",
    "rate",
    "apg",
    "ppo",
    "rk4",
    "png",
    "svg",
    "hover",
    "mass:0:0",
    "mass:1:0.5",
    "wind:-1e9:1e9",
    "what:",
    ":::",
    "a=b",
    "=",
    "apg.updates=-1",
    "ppo.n_env=1e18",
    "task.horizon=0",
    "network.hidden=[]",
    "dt=1e-300",
    "0,0,0",
    "1,2,3,4,5,6,7",
    "\u{1b}[2J\u{7}",
    "名前",
    "''",
    "\"",
    "[",
    "{}",
    "%s%n",
    "--help",
    "-",
    "9:0.5",
    "0:2",
];

/// A line that does what it says, and soon.
fn sound(command: &str) -> &'static [&'static str] {
    match command {
        "train" => &["Hover", "--updates", "1", "--no-baseline", "--no-plots"],
        "train-all" => &["--budget", "1e-9", "--tasks", "Hover", "--algo", "apg", "--seeds", "1", "--no-plots"],
        "study" => &["paper", "--budget", "1e-9", "--tasks", "Hover", "--algos", "dqn", "--seeds", "1", "--no-plots"],
        "rollout" => &["Hover", "--envs", "2", "--horizon", "3", "--no-plots"],
        // what it measures takes its time: it is only refused here
        "bench" => &["Hover", "--envs", "-1"],
        "benchmark" => &["tracking", "--controllers", "nobody"],
        "tune" => &[
            "hummingbird",
            "--iterations",
            "1",
            "--starts",
            "1",
            "--duration",
            "0.05",
            "--held-out",
            "1",
            "--no-plots",
        ],
        "optimise" => &["landing", "--iterations", "9", "--no-plots"],
        "watch" | "replay" => &["Hover", "--envs", "1", "--horizon", "3"],
        "view" => &["Hover", "--envs", "1", "--horizon", "3", "--duration", "0.01"],
        "eval" => &["user", "--envs", "2", "--no-plots"],
        "fly" => &["hummingbird", "--duration", "0.1", "--no-plots"],
        "import" => &["bomb.urdf"],
        "show" | "models" | "design" | "linearise" => &["hummingbird"],
        "recover" => &["iris", "--cells", "1,1", "--starts", "1", "--duration", "0.5"],
        "allocate" => &["firefly"],
        "tasks" => &["Hover"],
        "export c" => &["hummingbird"],
        "export onnx" => &["user"],
        _ => &[],
    }
}

/// Options of a command, as its help names them, and whether they take a value.
fn options(folder: &Path, name: &str) -> Vec<(String, bool)> {
    let help = exits(0, folder, &name.split(' ').chain(["--help"]).collect::<Vec<_>>()).0;
    let lines = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    let option = |line: &str| {
        let at = line.find("--")?;
        let word: String = line[at..].chars().take_while(|c| !c.is_whitespace() && *c != '[').collect();
        Some((word.clone(), line[at + word.len()..].trim_start().starts_with(['<', '['])))
    };
    let mut all: Vec<_> = lines.filter_map(option).collect();
    all.sort();
    all.dedup();
    // dozens of margins take their time: they are refused or judged in tests of their own
    all.retain(|(option, _)| name != "tune" || option != "--margins");
    all
}

/// A folder with everything that a stranger may leave about.
fn traps(folder: &Path) {
    let file = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    for name in ["folder", "user"] {
        std::fs::create_dir(folder.join(name)).unwrap();
    }
    for name in SENTINELS {
        file(name, "the user's own\n");
    }
    file("torn.toml", "name = 'x'\n[[rotors]]\nposition = [0, 0");
    file("deep.toml", &format!("x = {}", "[".repeat(5000)));
    file("bomb.urdf", "<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;&a;'>]><robot name='&b;'/>");
    #[cfg(unix)]
    {
        assert!(Command::new("mkfifo").arg(folder.join("pipe")).status().unwrap().success());
        std::os::unix::fs::symlink("loop", folder.join("loop")).unwrap();
    }
}

/// Files that no command may touch.
const SENTINELS: [&str; 4] = ["user/config.toml", "user/curve.csv", "user/result.json", "user/notes.txt"];

/// Files whose names only unfinished ones have, anywhere below.
fn left_over(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        if name.starts_with(".omnidrones-") {
            found.push(path.display().to_string());
        }
        if entry.file_type().unwrap().is_dir() {
            found.extend(left_over(&path));
        }
    }
    found
}

/// All that comes, read beside the process, which must not wait for its reader.
fn told(mut from: impl Read + Send + 'static) -> std::thread::JoinHandle<String> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        let _ = from.read_to_end(&mut bytes);
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Exit code, standard output and error; none if it had to be stopped.
fn ended(mut command: Command) -> Option<(Option<i32>, String, String)> {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (out, err) = (told(child.stdout.take().unwrap()), told(child.stderr.take().unwrap()));
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return Some((status.code(), out.join().unwrap(), err.join().unwrap()));
        }
        if begun.elapsed() > Duration::from_secs(LONGEST) {
            let _ = child.kill();
            let _ = child.wait();
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// So many hostile lines from a seed: none panics, aborts, hangs, touches a foreign file or leaves one behind.
fn attack(seed: u64, n: usize) {
    let folder = temporary();
    traps(folder.path());
    let names: Vec<String> = {
        let help = exits(0, folder.path(), &["--help"]).0;
        let commands = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
        let commands = commands.map_while(|line| line.split_whitespace().next().map(String::from));
        let own = commands.filter(|name| name != "help" && name != "export");
        own.chain(["export c", "export onnx"].map(String::from)).collect()
    };
    assert!(names.len() >= 12, "{names:?}");
    let all: Vec<_> = names.iter().map(|name| (name, options(folder.path(), name))).collect();
    assert!(all.iter().all(|(name, options)| options.len() > 2 || panic!("{name}: {options:?}")));
    let (mut longest, mut codes) = ((0.0, String::new()), [0; 3]);
    for k in 0..n {
        let own = seed.wrapping_add(k as u64);
        let mut draws = Draws(own);
        let (name, options) = &all[draws.next() as usize % all.len()];
        let mut line: Vec<String> = name.split(' ').map(String::from).collect();
        let wild = draws.next().is_multiple_of(4);
        for _ in 0..if wild { draws.next() % 3 } else { 0 } {
            line.push(draws.of(VALUES).into());
        }
        let own_words = || sound(name).iter().map(|word| word.to_string());
        if !wild {
            line.extend(own_words());
        }
        for _ in 0..draws.next() % if wild { 5 } else { 3 } {
            let (option, takes) = &options[draws.next() as usize % options.len()];
            if option == "--force" || option == "--all" {
                continue; // what a user asks for
            }
            // in the place of the line's own
            if let Some(at) = line.iter().position(|word| word == option) {
                line.drain(at..line.len().min(at + 1 + usize::from(*takes)));
            }
            line.push(option.clone());
            if *takes {
                line.push(draws.of(VALUES).into());
            }
        }
        if wild {
            line.extend(own_words().skip_while(|word| !word.starts_with('-')));
        }
        let words: Vec<&str> = line.iter().map(String::as_str).collect();
        let begun = Instant::now();
        let told = format!("seed {own}: {words:?}");
        let Some((code, out, err)) = ended(command(folder.path(), &words)) else { panic!("{told}: hangs") };
        let Some(code @ 0..=2) = code else { panic!("{told}: {code:?}\n{err}") };
        codes[code as usize] += 1;
        assert!(!err.contains("panicked at") && !out.contains("panicked at"), "{told}\n{err}");
        assert!(!out.contains('\u{1b}') && !err.contains('\u{1b}'), "{told}: steers the terminal\n{err}");
        if words.contains(&"--json") && !words.contains(&"--help") && !words.contains(&"-h") {
            assert!(serde_json::from_str::<Value>(&out).is_ok(), "{told}: no JSON\n{out}\n{err}");
        }
        for name in SENTINELS {
            let text = std::fs::read_to_string(folder.path().join(name)).unwrap_or_default();
            assert_eq!(text, "the user's own\n", "{told}: {name} is not the user's any more");
        }
        assert_eq!(left_over(folder.path()), [""; 0], "{told}");
        let took = begun.elapsed().as_secs_f64();
        if took > longest.0 {
            longest = (took, told);
        }
    }
    println!(
        "{n} lines from seed {seed}, exits 0, 1, 2: {codes:?}; the longest took {:.2} s: {}",
        longest.0, longest.1
    );
    assert!(codes[0] > n / 20 && codes[2] > n / 20, "{codes:?}: an attack that does not reach far");
}

#[test]
fn hostile_command_lines_neither_panic_nor_hang_nor_touch_foreign_files() {
    attack(1, 150);
}

#[test]
#[ignore = "HOSTILE=2000 cargo test --release -p omnidrones-cli --test command_line hostile -- --ignored --nocapture: 3 min"]
fn many_hostile_command_lines() {
    let n = std::env::var("HOSTILE").ok().and_then(|n| n.parse().ok()).unwrap_or(2000);
    let seed = std::env::var("SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(1_000_000);
    attack(seed, n);
}

#[test]
fn errors_with_json_are_json() {
    let folder = temporary();
    for line in
        [&["fly", "nothing", "--json"][..], &["train", "Hover", "--json", "--updates", "x"], &["rollout", "--json"]]
    {
        let (out, err) = exits(2, folder.path(), line);
        let told: Value = serde_json::from_str(&out).unwrap_or_else(|e| panic!("{line:?}: {e}\n{out}"));
        let text = told["error"].as_str().unwrap();
        assert!(err.contains(text.lines().next().unwrap()), "{line:?}: {text}\n{err}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn where_memory_is_short_a_batch_is_refused_and_nothing_aborts() {
    let folder = temporary();
    let line = "ulimit -v 4000000; exec \"$0\" \"$@\"";
    let flown = |arguments: &[&str]| {
        let mut shell = Command::new("sh");
        shell.args(["-c", line, env!("CARGO_BIN_EXE_omnidrones")]).args(arguments).current_dir(folder.path());
        let output = shell.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for arguments in
        [&["bench", "Hover", "--quick", "--envs", "8000000"][..], &["fly", "--duration", "9999", "--no-plots"]]
    {
        let (code, err) = flown(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
        assert!(err.contains("this machine has"), "{arguments:?}: {err}");
    }
}

#[cfg(unix)]
#[test]
fn an_import_starts_no_program() {
    use std::os::unix::fs::PermissionsExt;
    let folder = temporary();
    let programs = folder.path().join("programs");
    std::fs::create_dir(&programs).unwrap();
    for name in ["rospack", "rosrun", "xacro", "ros2", "python", "python3", "sh"] {
        let path = programs.join(name);
        std::fs::write(&path, format!("#!/bin/sh\necho started > '{}/started'\n", folder.path().display())).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let link = "<link name='a'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>\
                <visual><geometry><mesh filename='package://nobody/a.stl'/></geometry></visual></link>";
    for name in ["a.urdf", "a.xacro", "a.urdf.xacro"] {
        std::fs::write(folder.path().join(name), format!("<robot name='a'>{link}</robot>")).unwrap();
        for verb in ["import", "show", "fly"] {
            let mut command = command(folder.path(), &[verb, name]);
            let output = command.env("PATH", &programs).output().unwrap();
            assert!(output.status.code().is_some(), "{verb} {name}");
        }
    }
    assert!(!folder.path().join("started").exists());
}

/// Seconds that a process has computed: others on its processors take none of them.
#[cfg(target_os = "linux")]
fn computed(process: u32) -> f64 {
    let about = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    let numbers = about.rsplit(')').next().unwrap().split_whitespace();
    numbers.skip(11).take(2).map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
}

/// A process that does not outlive the test.
#[cfg(target_os = "linux")]
struct Ended(Child);

#[cfg(target_os = "linux")]
impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Memory of a process, KiB, and its open files.
#[cfg(target_os = "linux")]
fn taken(process: u32) -> Option<(f64, usize)> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let files = std::fs::read_dir(format!("/proc/{process}/fd")).ok()?.count();
    Some((resident.split_whitespace().next()?.parse().ok()?, files))
}

#[cfg(target_os = "linux")]
#[test]
#[ignore = "SOAK=1800 cargo test --release -p omnidrones-cli --test command_line soak -- --ignored --nocapture: as many seconds, 600 unless told"]
fn a_soak_of_training_takes_no_more_memory_and_no_more_files() {
    let seconds: f64 = std::env::var("SOAK").ok().and_then(|s| s.parse().ok()).unwrap_or(600.0);
    let folder = temporary();
    // a line of the log, an evaluation and a checkpoint every few updates: an hour of these is a week of others
    let arguments = [
        "train",
        "Hover",
        "--algo",
        "apg",
        "--updates",
        "100000000",
        "--threads",
        "1",
        "--no-plots",
        "--set",
        "apg.n_env=64",
        "--set",
        "apg.horizon=4",
        "--set",
        "log_every=1",
        "--set",
        "evaluate.every=20",
        "--set",
        "evaluate.envs=8",
        "--set",
        "env.randomise=[{what='mass',range=[0.9,1.1]}]",
    ];
    let fresh_folder = temporary();
    let begin = |folder: &Path| {
        Ended(command(folder, &arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap())
    };
    // seconds computed, lines written
    let mark = |folder: &Path, child: &Ended| {
        let run = std::fs::read_dir(folder.join("runs")).unwrap().flatten().next().unwrap().path();
        let lines = std::fs::read_to_string(run.join("curve.csv")).unwrap().lines().count();
        [computed(child.0.id()), lines as f64]
    };
    let (mut child, mut fresh, mut marks) = (begin(folder.path()), None, None);
    let begun = Instant::now();
    let mut samples: Vec<(f64, f64)> = Vec::new();
    let mut files = Vec::new();
    while begun.elapsed().as_secs_f64() < seconds {
        std::thread::sleep(Duration::from_millis(500));
        let passed = begun.elapsed().as_secs_f64();
        let Some((resident, open)) = taken(child.0.id()) else {
            panic!("it ended: {}", told(child.0.stderr.take().unwrap()).join().unwrap());
        };
        // the first third warms up
        if passed > seconds / 3.0 {
            samples.push((passed / 3600.0, resident / 1024.0));
            files.push(open);
        }
        // machines are not as fast in one hour as in the next: beside the old run a new one, in the last third
        if passed > seconds * 0.7 && seconds >= 1800.0 {
            let fresh = fresh.get_or_insert_with(|| begin(fresh_folder.path()));
            if passed > seconds * 0.75 && marks.is_none() {
                marks = Some([mark(folder.path(), &child), mark(fresh_folder.path(), fresh)]);
            }
        }
    }
    let now = fresh.as_ref().map(|fresh| [mark(folder.path(), &child), mark(fresh_folder.path(), fresh)]);
    drop((child, fresh));
    let n = samples.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| samples.iter().map(of).sum::<f64>() / n;
    let (t, m) = (mean(|s| s.0), mean(|s| s.1));
    let (mut up, mut down) = (0.0, 0.0);
    for (x, y) in &samples {
        up += (x - t) * (y - m);
        down += (x - t) * (x - t);
    }
    let grown = samples.last().unwrap().1 - samples[0].1;
    let slope = up / down;
    let slower = marks.zip(now).map(|(from, to)| {
        let rate = |k: usize| (to[k][1] - from[k][1]) / (to[k][0] - from[k][0]);
        rate(1) / rate(0) - 1.0
    });
    println!(
        "{seconds} s: {m:.1} MiB, slope {slope:.2} MiB/h, grown by {grown:.2} MiB, slower than a new run by {slower:.4?}, files {}",
        files[0]
    );
    assert!(grown < 1.0, "memory grew by {grown} MiB");
    // a page more or less is a slope where minutes are few
    if seconds >= 1800.0 {
        assert!(slope <= 1.0, "memory grows by {slope} MiB/h"); // measured 0.88 in 900 s
        assert!(slower.is_some_and(|s| s <= 0.02), "it was slower than a new run beside it by {slower:?}");
    }
    assert!(files.iter().max().unwrap() - files.iter().min().unwrap() <= 3, "{files:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_command_that_is_told_to_end_leaves_nothing_half_written() {
    let folder = temporary();
    let line = ["train", "Hover", "--updates", "100000", "--no-plots", "--no-baseline", "--out", "run"];
    // whoever runs the tests in the background ignores signals, and so would the command
    let mut own = Command::new("env");
    own.args(["--default-signal=INT,HUP,TERM", env!("CARGO_BIN_EXE_omnidrones")]).args(line).current_dir(folder.path());
    let mut child = own.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let within = |seconds: u64, is: &mut dyn FnMut() -> bool| {
        let begun = Instant::now();
        while !is() && begun.elapsed() < Duration::from_secs(seconds) {
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let log = folder.path().join("run/log.jsonl");
    within(60, &mut || std::fs::metadata(&log).is_ok_and(|about| about.len() > 0));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    within(20, &mut || child.try_wait().unwrap().is_some());
    let _ = child.kill();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(left_over(folder.path()), [""; 0]);
}

#[cfg(target_os = "linux")]
#[test]
fn every_long_command_ends_within_a_second_of_a_signal_and_says_that_nothing_was_saved() {
    let plants = ["design", "firefly", "--spread", "0.3", "--samples", "1000", "--report", "report.html"];
    let lines: [(&[&str], &str); 6] = [
        (&["tune", "hummingbird", "--iterations", "100000", "--no-plots"], "INT"),
        (&["tune", "firefly", "--margins", "--iterations", "100000", "--no-plots"], "TERM"),
        (&plants, "INT"),
        (&["recover", "hummingbird", "--plot", "map.png"], "HUP"),
        (&["fly", "dragon", "--duration", "5000", "--csv", "--no-plots"], "INT"),
        (&["rollout", "TransportHover", "--envs", "4096", "--csv", "--no-plots"], "TERM"),
    ];
    for (i, (line, signal)) in lines.into_iter().enumerate() {
        let folder = temporary();
        let mut own = Command::new("env");
        own.args(["--default-signal=INT,HUP,TERM", env!("CARGO_BIN_EXE_omnidrones")]).args(line);
        own.current_dir(folder.path()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = own.spawn().unwrap();
        // while it reads, and while it computes
        std::thread::sleep(Duration::from_millis(300 + 400 * (i as u64 % 3)));
        assert!(child.try_wait().unwrap().is_none(), "{line:?} was over before its signal");
        let pid = child.id().to_string();
        let told = Instant::now();
        assert!(Command::new("kill").args([&format!("-{signal}"), &pid]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        let took = told.elapsed();
        let err = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(130), "{line:?}: {err}");
        assert!(took < Duration::from_secs(1), "{line:?} took {took:?}");
        assert!(err.contains("stopped: no result was saved"), "{line:?}: {err}");
        assert_eq!(left_over(folder.path()), [""; 0], "{line:?}");
    }
}
