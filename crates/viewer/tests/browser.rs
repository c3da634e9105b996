//! Pages in a browser that no one here wrote: headless Chromium opens them with the network off, plays and scrubs them, and
//! says what it saw. Without a browser nothing is tested, and the test says so: `apt-get install chromium`, or
//! CHROMIUM=/path/to/it.
//!
//! `SCREENSHOTS=folder cargo test --release -p omnidrones-viewer --test browser` keeps pictures of all pages.

use omnidrones::controllers::reference::Lemniscate;
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::{
    ChainRamp, ChainShape, Controller, FlightPlan, Reference, RotorFailure, Vectored, default_controller, fly,
};
use omnidrones::dynamics::configurations::environment::vehicle_in;
use omnidrones::dynamics::scene::Generator;
use omnidrones::dynamics::{Effects, Physics, Plant, configurations, vehicles};
use omnidrones::tasks::{Autoreset, Baseline, Buffers, Env, EnvConfig, EvaluationStep, evaluate};
use omnidrones_viewer::{Episodes, Moment, Recording, Server, flight, page};
use serde_json::Value;
use std::cell::RefCell;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// The browser of this machine, if there is one.
fn browser() -> Option<PathBuf> {
    let own = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let places =
        std::env::split_paths(&paths).flat_map(|folder| ["chromium", "chromium-browser"].map(|n| folder.join(n)));
    let found = own.into_iter().chain(places).find(|path| path.is_file());
    if found.is_none() {
        eprintln!("NOT TESTED: no Chromium on this machine (apt-get install chromium, or CHROMIUM=/path/to/it)");
    }
    found
}

/// A browser without a network: names are not resolved, and what is asked for by number goes nowhere.
fn open(browser: &Path, home: &Path, address: &str, more: &[&str]) -> Command {
    let mut command = Command::new(browser);
    command
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic"])
        .args(["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1", "--window-size=1280,720"])
        .arg(format!("--user-data-dir={}", home.display()))
        .args(more)
        .arg(address)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .stdout(Stdio::piped());
    command
}

/// Standard output of a browser, which is stopped after two minutes.
fn said(mut command: Command) -> String {
    let mut child: Child = command.spawn().expect("the browser starts");
    let out = child.stdout.take().expect("piped");
    let err = child.stderr.take().expect("piped");
    let read = |mut pipe: Box<dyn std::io::Read + Send>| {
        std::thread::spawn(move || {
            let mut text = Vec::new();
            let _ = pipe.read_to_end(&mut text);
            String::from_utf8_lossy(&text).into_owned()
        })
    };
    let (out, err) = (read(Box::new(out)), read(Box::new(err)));
    let begun = Instant::now();
    while child.try_wait().expect("waited for").is_none() {
        if begun.elapsed() > Duration::from_secs(120) {
            let _ = child.kill();
            panic!("the browser did not end: {}", err.join().expect("read"));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(err);
    out.join().expect("read")
}

/// Before the page's scripts: everything that goes wrong is kept.
const LISTEN: &str = "<script>
window.wrong = [];
addEventListener('error', (e) => wrong.push('error: ' + e.message));
addEventListener('unhandledrejection', (e) => wrong.push('rejected: ' + e.reason));
addEventListener('securitypolicyviolation', (e) => wrong.push('asked for ' + e.blockedURI));
for (const kind of ['error', 'warn']) console[kind] = (...words) => wrong.push(kind + ': ' + words.join(' '));
</script>";

/// Behind them: draws at several times, uses the time line, tells.
const TELL: &str = "<script>
const told = { wrong, pictures: [], times: [] };
try {
  const v = window.viewer;
  v.play(false);
  const picture = (time) => {
    v.seek(time);
    v.draw(0);
    const gl = v.renderer.getContext();
    const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const bytes = new Uint8Array(4 * w * h);
    gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    const words = new Uint32Array(bytes.buffer);
    let hash = 0;
    for (const word of words) hash = (Math.imul(hash, 31) + word) | 0;
    return { hash, colours: new Set(words).size, pixels: words.length };
  };
  const slider = document.getElementById('time');
  told.duration = v.duration;
  for (const share of [0, 0.4, 1]) told.pictures.push(picture(share * v.duration));
  slider.value = 0.5;
  slider.dispatchEvent(new Event('input'));
  told.times.push(v.time);
  const press = (key) => dispatchEvent(new KeyboardEvent('keydown', { key }));
  press('Home');
  told.times.push(v.time);
  press('ArrowRight');
  told.times.push(v.time);
  press(' ');
  told.plays = v.playing;
  press(' ');
  const chart = document.querySelector('#charts canvas').getBoundingClientRect();
  const at = { clientX: chart.right - 8, clientY: chart.top + 30, pointerId: 1, buttons: 1, bubbles: true };
  const canvas = document.querySelector('#charts canvas');
  canvas.setPointerCapture = () => {};
  canvas.dispatchEvent(new PointerEvent('pointerdown', at));
  told.times.push(v.time);
  canvas.dispatchEvent(new PointerEvent('pointerup', at));
  for (const key of ['2', '3', '1', 'f', 't', 'r', 'i', 'n', 'c', '+']) { press(key); v.draw(0.01); }
  told.speed = v.speed;
  told.requests = performance.getEntriesByType('resource').map((entry) => entry.name);
} catch (error) {
  wrong.push('probe: ' + error.stack);
}
const pre = document.createElement('pre');
pre.id = 'told';
pre.textContent = JSON.stringify(told);
document.body.append(pre);
</script>";

/// Opens a page and demands what every page must do; what it told.
fn shown(name: &str, html: &str) -> Option<Value> {
    let browser = browser()?;
    let folder = tempfile::tempdir().expect("a folder");
    let probed = html.replacen("<script type", &format!("{LISTEN}<script type"), 1);
    let probed = probed.replacen("</body>", &format!("{TELL}</body>"), 1);
    let file = folder.path().join("page.html");
    std::fs::write(&file, probed).expect("written");
    let address = format!("file://{}", file.display());
    let dom = said(open(&browser, &folder.path().join("home"), &address, &["--dump-dom"]));
    let (_, rest) = dom.split_once("<pre id=\"told\">").unwrap_or_else(|| panic!("{name}: the page died: {dom:.2000}"));
    let text = rest.split("</pre>").next().unwrap_or_default();
    let text = text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    let told: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{name}: {e}: {text}"));
    screenshots(&browser, name, html, folder.path());
    assert_eq!(told["wrong"], serde_json::json!([]), "{name}: the console");
    assert_eq!(told["requests"], serde_json::json!([]), "{name}: it asks for something");
    let pictures = told["pictures"].as_array().expect("drawn");
    for picture in pictures {
        assert!(picture["colours"].as_u64() > Some(200), "{name}: an empty canvas: {picture}");
    }
    assert!(
        pictures[0]["hash"] != pictures[1]["hash"] && pictures[1]["hash"] != pictures[2]["hash"],
        "{name}: it stands"
    );
    let duration = told["duration"].as_f64().expect("a number");
    let times: Vec<f64> = told["times"].as_array().expect("times").iter().filter_map(Value::as_f64).collect();
    assert!((times[0] / duration - 0.5).abs() < 1e-3, "{name}: the slider at half: {times:?} of {duration}");
    assert!(times[1] == 0.0 && times[2] > 0.0 && times[2] < 0.1, "{name}: Home and an arrow: {times:?}");
    assert!((times[3] / duration - 1.0).abs() < 0.02, "{name}: the end of a curve: {times:?} of {duration}");
    assert_eq!((&told["plays"], &told["speed"]), (&true.into(), &2.into()), "{name}: space, and +");
    Some(told)
}

/// Pictures to look at, where SCREENSHOTS names a folder.
fn screenshots(browser: &Path, name: &str, html: &str, folder: &Path) {
    let Some(to) = std::env::var_os("SCREENSHOTS").map(PathBuf::from) else { return };
    std::fs::create_dir_all(&to).expect("made");
    std::fs::write(to.join(format!("{name}.html")), html).expect("written");
    for (kind, words) in [("start", "t=0&play=0"), ("later", "t=4&play=0"), ("board", "t=3&play=0&camera=on board")] {
        let picture = format!("--screenshot={}", to.join(format!("{name}-{kind}.png")).display());
        let address = format!("file://{}#{words}", to.join(format!("{name}.html")).display());
        let home = folder.join(kind);
        said(open(browser, &home, &address, &[&picture, "--virtual-time-budget=3000"]));
    }
}

fn episodes(task: &str, n: usize, horizon: u32) -> Recording {
    let config = EnvConfig { n_env: n, autoreset: Autoreset::Disabled, ..EnvConfig::default() };
    let mut config = omnidrones::tasks::registry::by_name(task).unwrap().env(&config).unwrap().spec().config.clone();
    config.task.insert("horizon".into(), horizon.into());
    let mut env = Env::make(task, &config).unwrap();
    let mut seen = Episodes::new(&env, n).unwrap();
    let mut see = |watched: &EvaluationStep<'_>| assert!(seen.see(watched).is_ok());
    // what no controller of ours can fly is left to chance
    let mut chance = |env: &Env, _: &Buffers, actions: &mut [f32]| {
        env.sample(7, actions);
        Ok(())
    };
    match Baseline::new(&env) {
        Ok(mut own) => evaluate(&mut env, &mut own.policy(), &mut see).unwrap(),
        Err(_) => evaluate(&mut env, &mut chance, &mut see).unwrap(),
    };
    seen.recording().unwrap()
}

/// A configuration on a slow path; a chain bends on its way.
fn configuration(name: &str, seconds: f64) -> Recording {
    let model = (configurations::REGISTRY.iter().find(|e| e.name == name).unwrap().build)().unwrap();
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    let path = Lemniscate { rate: 0.5, origin: [0.0, 0.0, 3.0], ..Lemniscate::default() };
    let plan = FlightPlan { reference: Reference::Lemniscate(path), duration: seconds, ..FlightPlan::default() };
    let system = plant.tree().unwrap();
    let mut own: Box<dyn Controller> = if name == "dragon" {
        let chain = ChainRamp::new(system.model(), ChainShape::parse("arc:30").unwrap(), 0.5).unwrap();
        Box::new(Vectored::new(system, None, &plan.rates).unwrap().with_chain(chain))
    } else {
        default_controller(&plant, &Setup::new(None, &plan.rates)).unwrap()
    };
    let flown = fly(&plant, &mut own, &plan, &mut |_| {}).unwrap();
    assert_eq!(flown.lost(), None, "{name}");
    flight(&plant, &flown, &plan)
}

fn failure() -> Recording {
    let vehicle = vehicles::by_name("firefly").unwrap();
    let failures = vec![RotorFailure { rotor: 1, at: 2.0, effectiveness: 0.0 }];
    let plan = FlightPlan { duration: 6.0, failures, ..FlightPlan::default() };
    let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
    let gains = vehicle.gains();
    let mut own = controller("fault_tolerant", &plant, &Setup::new(Some(&gains), &plan.rates)).unwrap();
    let flown = fly(&plant, &mut own, &plan, &mut |_| {}).unwrap();
    flight(&plant, &flown, &plan)
}

/// Bytes of the flights in a page.
fn data(html: &str) -> usize {
    let (_, rest) = html.split_once("id=\"flights\">").unwrap();
    rest.split_once("</script>").unwrap().0.len()
}

#[test]
fn four_drones_hover_in_sixty_kilobytes() {
    let recording = episodes("Hover", 4, 500);
    assert_eq!((recording.n_frame(), recording.actors.len()), (500, 4));
    let html = page("Hover", &[recording]);
    println!("500 frames of 4 drones: {} bytes of data in {}", data(&html), html.len());
    assert!(data(&html) < 60_000, "{}", data(&html));
    assert!(html.len() - data(&html) < 900_000, "{}", html.len());
    shown("hover", &html);
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("page.html");
    std::fs::write(&file, html).expect("written");
    let mut window = Window::new(&browser, folder.path(), &format!("file://{}", file.display()), &mut || ());
    let size = serde_json::json!({ "width": 1280, "height": 720, "deviceScaleFactor": 1, "mobile": false });
    window.ask("Emulation.setDeviceMetricsOverride", size, &mut || ());
    window.until("window.viewer?.time > 0.3", &mut || ());
    let count = "window.n = 0; window.since = performance.now(); const own = viewer.draw.bind(viewer);
                 viewer.draw = (s) => { window.n += 1; own(s) }; viewer.play(true)";
    window.value(count, &mut || ());
    window.until("performance.now() - since > 4000", &mut || ());
    let rate = window.value("1000 * n / (performance.now() - since)", &mut || ()).as_f64().expect("a rate");
    let how = window.value("JSON.stringify([innerWidth, innerHeight, !!viewer.plain])", &mut || ());
    println!("{rate:.1} pictures per second drawn by software; width, height, coarser: {how}");
    // 30 and more on a machine that does nothing else; here others may work
    assert!(rate > 3.0, "{rate} pictures per second");
}

#[test]
fn four_drones_on_a_path_take_sixty_kilobytes_too() {
    let html = page("Track", &[episodes("Track", 4, 500)]);
    println!("500 frames of 4 drones behind moving targets: {} bytes of data", data(&html));
    assert!(data(&html) < 60_000, "{}", data(&html));
    shown("track", &html);
}

#[test]
fn a_dragon_flies_in_a_browser() {
    shown("dragon", &page("Dragon", &[configuration("dragon", 8.0)]));
}

#[test]
fn a_transport_flies_in_a_browser() {
    shown("transport", &page("Transport", &[configuration("transport", 8.0)]));
}

#[test]
fn a_rotor_fails_in_a_browser() {
    let recording = failure();
    assert_eq!(recording.events[0].text, "rotor_1 is lost at 2 s");
    shown("failure", &page("A failure", &[recording]));
}

#[test]
fn a_team_in_formation_and_gates_fly_in_a_browser() {
    shown("formation", &page("Formation", &[episodes("Formation", 1, 400)]));
    shown("transports", &page("TransportFlyThrough", &[episodes("TransportFlyThrough", 2, 200)]));
}

#[test]
fn two_flights_beside_each_other_have_one_clock() {
    let Some(told) = shown("beside", &page("Two", &[episodes("Hover", 2, 200), failure()])) else { return };
    assert!((told["duration"].as_f64().unwrap() - 6.0).abs() < 0.1, "the longer one's: {told}");
}

/// In a page: every text that charts draw from now on, by its canvas, as a box.
const WATCH_TEXTS: &str = "window.texts = new Map();
const own = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y, most) {
  const wide = Math.min(this.measureText(text).width, most ?? Infinity);
  const left = this.textAlign === 'right' ? x - wide : this.textAlign === 'center' ? x - wide / 2 : x;
  const all = window.texts.get(this.canvas) ?? [];
  all.push({ text: String(text), left, right: left + wide, top: y - 9, bottom: y + 2 });
  window.texts.set(this.canvas, all);
  return own.call(this, text, x, y, most);
}";

/// Draws all charts once and tells what lies over something else, or outside of its page or panel.
const OVERPRINTED: &str = "(() => {
const wrong = [];
const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top;
window.texts.clear();
for (const chart of viewer.charts) {
  chart.redraw();
  chart.show(viewer.time);
  const drawn = [...(window.texts.get(chart.still) ?? []), ...(window.texts.get(chart.canvas) ?? [])];
  const { clientWidth, clientHeight } = chart.canvas;
  if (!clientWidth) continue;
  drawn.forEach((a, i) => {
    if (a.left < -0.5 || a.right > clientWidth + 0.5 || a.top < -1 || a.bottom > clientHeight + 1) wrong.push(`${a.text}: outside`);
    for (const b of drawn.slice(i + 1)) if (!apart(a, b)) wrong.push(`${a.text} over ${b.text}`);
  });
}
const boxes = [...document.querySelectorAll('header section, nav button:not([hidden])')].map((e) => [e, e.getBoundingClientRect()]);
boxes.forEach(([a, p], i) => {
  if (p.left < 0 || p.right > innerWidth) wrong.push(`${a.textContent}: outside`);
  for (const [b, q] of boxes.slice(i + 1)) if (!apart(p, q)) wrong.push(`${a.textContent} over ${b.textContent}`);
});
if (document.scrollingElement.scrollWidth > innerWidth) wrong.push('the page is wider than its window');
return wrong;
})()";

/// A window of a page of these flights.
fn window(browser: &Path, folder: &Path, flights: &[Recording]) -> Window {
    std::fs::create_dir_all(folder).expect("made");
    let file = folder.join("page.html");
    std::fs::write(&file, page("A page", flights)).expect("written");
    let mut window =
        Window::new(browser, &folder.join("home"), &format!("file://{}#play=0", file.display()), &mut || ());
    window.until("!!window.viewer", &mut || ());
    window
}

impl Window {
    fn resize(&mut self, width: u32) {
        let size = serde_json::json!({ "width": width, "height": 720, "deviceScaleFactor": 1, "mobile": false });
        self.ask("Emulation.setDeviceMetricsOverride", size, &mut || ());
        self.until(&format!("innerWidth === {width}"), &mut || ());
        // a canvas that is asked for its size has that of the new window
        self.value("viewer.resize(); viewer.draw(0)", &mut || ());
    }

    /// Of the page as it is, where SCREENSHOTS names a folder.
    fn keep(&mut self, name: &str) {
        let Some(to) = std::env::var_os("SCREENSHOTS").map(PathBuf::from) else { return };
        let shot = self.ask("Page.captureScreenshot", serde_json::json!({}), &mut || ());
        let (text, mut bytes, mut bits, mut n) = (shot["data"].as_str().expect("a picture"), Vec::new(), 0_u32, 0);
        for letter in text.bytes().filter(|b| *b != b'=') {
            const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
            let six = LETTERS.iter().position(|b| *b == letter).expect("base64") as u32;
            (bits, n) = (bits << 6 | six, n + 6);
            if n >= 8 {
                n -= 8;
                bytes.push((bits >> n) as u8);
                bits &= (1 << n) - 1;
            }
        }
        std::fs::create_dir_all(&to).expect("made");
        std::fs::write(to.join(format!("{name}.png")), bytes).expect("written");
    }
}

/// Windows of a phone, of half a screen, of two usual screens.
const WIDTHS: [u32; 4] = [400, 900, 1280, 1440];

#[test]
fn nothing_is_printed_over_something_else_in_any_window() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    for (name, flights) in [
        ("one", vec![failure()]),
        ("two", vec![failure(), episodes("Hover", 2, 200)]),
        ("three", vec![failure(), episodes("Hover", 1, 100), configuration("transport", 1.0)]),
    ] {
        let mut window = window(&browser, &folder.path().join(name), &flights);
        window.value(WATCH_TEXTS, &mut || ());
        for width in WIDTHS {
            window.resize(width);
            window.value("viewer.seek(0.4 * viewer.duration); viewer.draw(0)", &mut || ());
            window.keep(&format!("{name}-{width}"));
            let wrong = window.value(OVERPRINTED, &mut || ());
            assert_eq!(wrong, serde_json::json!([]), "{name}, {width} px");
        }
    }
}

#[test]
fn every_rotor_has_its_readout_and_flights_beside_each_other_one_scale() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let mut one = window(&browser, &folder.path().join("one"), &[failure()]);
    one.resize(1280);
    let told = one.value("viewer.charts[1].readouts(1).map(([, text]) => text)", &mut || ());
    let told: Vec<f64> = told.as_array().expect("readouts").iter().filter_map(|t| t.as_str()?.parse().ok()).collect();
    assert!(told.len() == 6 && told.iter().all(|thrust| *thrust > 1.0), "{told:?} N of six rotors");
    let mut two = window(&browser, &folder.path().join("two"), &[failure(), configuration("payload", 3.0)]);
    two.resize(1280);
    let scale = |window: &mut Window, k: usize| window.value(&format!("viewer.charts[{k}].top"), &mut || ());
    let own = [0, 2].map(|k| two.value(&format!("viewer.charts[{k}].most()"), &mut || ()).as_f64().expect("m"));
    assert!((own[0] - own[1]).abs() > 1e-3, "flights of different errors: {own:?}");
    assert_eq!(scale(&mut two, 0), scale(&mut two, 2), "errors");
    assert!(scale(&mut two, 0).as_f64() >= own.iter().copied().reduce(f64::max));
}

#[test]
fn idle_rotors_and_rounding_lie_at_the_bottom_of_their_axes() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let flown = failure();
    let actor = flown.actors[0].clone();
    let still = |k: usize| Moment {
        poses: vec![[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]],
        // a hundredth of the speed is a ten-thousandth of the thrust
        speeds: vec![0.01; flown.looks[0].rotors],
        goals: vec![[0.0, 0.0, 1.0]; actor.goals],
        error: if k.is_multiple_of(2) { 0.0 } else { 1e-4 },
        ..Moment::default()
    };
    let mut idle = Recording::new("idle", 0.02, flown.looks.clone(), vec![actor.clone()]);
    (0..50).for_each(|k| idle.push(&[still(k)]));
    let mut window = window(&browser, folder.path(), &[idle]);
    window.resize(1280);
    for chart in [0, 1] {
        let share =
            format!("(() => {{ const c = viewer.charts[{chart}]; return c.panel.lines[0].value(1) / c.top }})()");
        let share = window.value(&share, &mut || ()).as_f64().expect("a number");
        assert!((0.0..0.2).contains(&share), "chart {chart}: {share} of its axis");
    }
    window.value(WATCH_TEXTS, &mut || ());
    assert_eq!(window.value(OVERPRINTED, &mut || ()), serde_json::json!([]));
}

/// Shares of the picture at which the flier and the nearest obstacle ahead of it are, and how much fog hides the flier.
const IN_VIEW: &str = "(() => {
const [stage] = viewer.stages;
const camera = viewer.cameras.of(0, viewer.canvas.clientWidth / viewer.canvas.clientHeight / viewer.stages.length);
camera.updateMatrixWorld();
const seen = (v) => { const p = v.clone().project(camera); return Math.abs(p.x) < 1 && Math.abs(p.y) < 1 && p.z < 1 };
const middle = viewer.cameras.controls.target;
const at = stage.obstacles.map((o) => o.getWorldPosition(middle.clone()));
const { near } = stage.scene.fog;
return {
  flier: seen(middle),
  obstacles: at.filter(seen).length,
  clear: camera.position.distanceTo(middle) < near,
};
})()";

#[test]
fn the_first_view_shows_the_flier_and_what_stands_around_it() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    for (name, flights) in [
        ("forest-task", vec![episodes("Forest", 4, 60)]),
        ("race-task", vec![episodes("Race", 2, 60)]),
        ("forest-two", vec![episodes("Forest", 1, 60), episodes("Forest", 1, 60)]),
        ("forest-scene", vec![among_trunks()]),
    ] {
        let mut window = window(&browser, &folder.path().join(name), &flights);
        for width in WIDTHS {
            window.resize(width);
            window.value("viewer.cameras.home(); viewer.seek(0); viewer.draw(0)", &mut || ());
            window.keep(&format!("{name}-{width}"));
            let view = window.value(IN_VIEW, &mut || ());
            assert!(view["flier"] == true && view["clear"] == true, "{name}, {width} px: {view}");
            assert!(view["obstacles"].as_u64() >= Some(2), "{name}, {width} px: {view}");
        }
    }
}

/// A flight among the trunks of a scene.
fn among_trunks() -> Recording {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let scene = Generator::parse("forest:3").unwrap().scene().unwrap();
    let plan = FlightPlan { duration: 2.0, ..FlightPlan::default() };
    let physics = Physics { effects: Effects { contact: true, ..plan.physics.effects }, ..plan.physics };
    let believed = Plant::of_vehicle(&vehicle, plan.physics).unwrap();
    let plant = Plant::of_model(&vehicle_in(&vehicle, &scene).unwrap(), physics).unwrap();
    let plan = FlightPlan { physics, ..plan };
    let mut own = controller("cascade", &believed, &Setup::new(None, &plan.rates)).unwrap();
    let flown = fly(&plant, &mut own, &plan, &mut |_| {}).unwrap();
    flight(&plant, &flown, &plan)
}

/// A browser that stays open and is asked through pipes, by its DevTools protocol.
struct Window {
    child: Child,
    to: std::fs::File,
    answers: Receiver<Value>,
    asked: u64,
    session: Option<String>,
}

impl Window {
    /// Opens a page; `folder` is its own.
    fn new(browser: &Path, folder: &Path, address: &str, meanwhile: &mut dyn FnMut()) -> Self {
        std::fs::create_dir_all(folder).expect("made");
        let pipes = ["to", "from"].map(|name| folder.join(name));
        assert!(Command::new("mkfifo").args(&pipes).status().expect("mkfifo").success());
        let plain = open(browser, &folder.join("home"), address, &["--remote-debugging-pipe"]);
        let child = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<\"$TO\" 4>\"$FROM\"", "sh"])
            .arg(browser)
            .args(plain.get_args())
            .env("TO", &pipes[0])
            .env("FROM", &pipes[1])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the browser starts");
        let to = std::fs::File::options().write(true).open(&pipes[0]).expect("opened");
        let from = BufReader::new(std::fs::File::open(&pipes[1]).expect("opened"));
        let (send, answers) = channel();
        std::thread::spawn(move || {
            for message in from.split(0).map_while(std::io::Result::ok) {
                let _ = send.send(serde_json::from_slice(&message).unwrap_or_default());
            }
        });
        let mut window = Self { child, to, answers, asked: 0, session: None };
        let all = window.ask("Target.getTargets", serde_json::json!({}), meanwhile);
        let tabs = all["targetInfos"].as_array().expect("targets");
        let tab = tabs.iter().find(|t| t["type"] == "page").expect("a tab");
        let attach = serde_json::json!({ "targetId": tab["targetId"], "flatten": true });
        let session = window.ask("Target.attachToTarget", attach, meanwhile)["sessionId"].clone();
        window.session = session.as_str().map(String::from);
        window
    }

    /// Sends a command and goes on with `meanwhile` until it is answered.
    fn ask(&mut self, method: &str, parameters: Value, meanwhile: &mut dyn FnMut()) -> Value {
        self.asked += 1;
        let mut command = serde_json::json!({ "id": self.asked, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            command["sessionId"] = session.as_str().into();
        }
        self.to.write_all(format!("{command}\0").as_bytes()).expect("sent");
        let begun = Instant::now();
        loop {
            meanwhile();
            match self.answers.recv_timeout(Duration::from_millis(3)) {
                Ok(answer) if answer["id"] == self.asked => return answer["result"].clone(),
                _ => assert!(begun.elapsed() < Duration::from_secs(60), "{method}: no answer"),
            }
        }
    }

    fn value(&mut self, expression: &str, meanwhile: &mut dyn FnMut()) -> Value {
        let ask = serde_json::json!({ "expression": expression, "returnByValue": true });
        self.ask("Runtime.evaluate", ask, meanwhile)["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    fn until(&mut self, expression: &str, meanwhile: &mut dyn FnMut()) {
        let begun = Instant::now();
        while self.value(expression, meanwhile) != true {
            if begun.elapsed() > Duration::from_secs(60) {
                let all = "JSON.stringify([document.body.innerText, document.visibilityState, window.viewer?.time])";
                panic!("{expression}: never, {}", self.value(all, meanwhile));
            }
        }
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page that is served follows the flight; a second window sees it too; one that is loaded again sees it from its start;
/// and the page says when the command has ended.
#[test]
fn a_live_page_follows_the_flight_in_two_windows_and_after_it_is_loaded_again() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let server = RefCell::new(Some(Server::new(0).unwrap()));
    let address = server.borrow().as_ref().unwrap().address();
    let whole = episodes("Hover", 1, 100);
    let mut growing = Recording::new(&whole.title, whole.interval, whole.looks.clone(), whole.actors.clone());
    let moment = |k: u64| Moment {
        poses: vec![[0.01 * k as f64, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]],
        speeds: vec![0.5; whole.looks[0].rotors],
        goals: vec![[0.0, 0.0, 1.0]; whole.actors[0].goals],
        error: 0.01 * k as f64,
        ..Moment::default()
    };
    growing.push(&[moment(0)]);
    let (begun, mut k) = (Instant::now(), 0);
    let mut fly = || {
        let mut own = server.borrow_mut();
        let Some(server) = own.as_mut() else { return };
        if begun.elapsed() > Duration::from_millis(20 * k) {
            k += 1;
            growing.push(&[moment(k)]);
            server.frame(&growing);
        }
        server.pump(Some(&growing));
    };
    let runs = "window.viewer?.flights[0].frames > 20 && viewer.time > 0.1 && document.getElementById('state').textContent == 'live'";
    let mut first = Window::new(&browser, &folder.path().join("first"), &address, &mut fly);
    first.until(runs, &mut fly);
    let mut second = Window::new(&browser, &folder.path().join("second"), &address, &mut fly);
    second.until(runs, &mut fly);
    assert_eq!(server.borrow().as_ref().unwrap().viewers(), 2, "both listen");
    let seen = first.value("viewer.flights[0].frames", &mut fly).as_u64().expect("frames");
    first.ask("Page.reload", serde_json::json!({}), &mut fly);
    first.until(runs, &mut fly);
    let again = first.value("viewer.flights[0].frames", &mut fly).as_u64().expect("frames");
    assert!(again >= seen, "{again} frames after {seen}: it begins at the start");
    server.borrow_mut().take();
    second.until("document.getElementById('state').textContent == 'the command has ended'", &mut || ());
}
