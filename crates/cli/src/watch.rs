//! `omnidrones watch`: a trained policy in flight, as a page for a browser, as one animated file and as a plot.

use super::arguments::OutputArguments;
use super::environment::EnvArguments;
use super::episodes::Seen;
use super::eval::Ready;
use super::rollout_files as out;
use super::shown::{MAX_SHOWN, check_number};
use crate::prelude::*;
use omnidrones::controllers::Reference;
use omnidrones::dynamics::tree::{Multibody, body_poses};
use omnidrones::parallel::Threads;
use omnidrones::tasks::{Env, EvaluationStep, Spec};
use omnidrones_plot::animation::save_gif;
use omnidrones_plot::{Colour, Drawing, Figure, Item, Panel, Series, model};
use omnidrones_viewer::{goal, page};

/// What the command is for.
pub const ABOUT: &str = "\
Show a trained policy in flight: a few episodes from held-out starts, in space and as errors over time, as one page for a \
browser to turn around and look at, and as a GIF, with a still of it and the plot of 'eval' beside it.";

const EXAMPLES: &str = "\
Examples:
  omnidrones watch runs/Hover-apg-s0                          four episodes, to runs/Hover-apg-s0/watch.gif
  omnidrones watch runs/Hover-apg-s0 --envs 1 --seed 8        one, from another start
  omnidrones watch runs/Hover-apg-s0 --out hover.gif          to another file
  omnidrones watch runs/Hover-apg-s0 --horizon 200            the first 200 steps of what it learnt
  omnidrones watch runs/Hover-apg-s0 --vehicle crazyflie      on a drone that it has not met

In the pictures single drones are drawn larger than they are; systems of bodies are at true scale. Each episode has a \
colour: the drone, the last 3 s of its way with its shadow, of the load where that is what the task leads, and a ball \
where the task wants it. The view closes in on what is still to come. Who has crashed turns grey.

Files: the GIF, and beside it, named after it, the page, the last picture and the plot of 'eval': watch.html, watch.png and \
watch-errors.png, or hover.html, hover.png and hover-errors.png with --out hover.gif. 'replay' makes the page alone.

Exit codes: 0 shown; 2 unusable input or arguments.";

/// Time between two pictures, about, s.
const BETWEEN: f64 = 0.05;
/// Most pictures.
const MAX_PICTURES: usize = 400;

/// Arguments of `watch`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(mut_arg("out", |out| out.value_name("FILE.gif").help("The animated file [default: RUN/watch.gif]").long_help("The animated file [default: RUN/watch.gif]")))]
pub struct Arguments {
    /// Folder of a run, or of one of its checkpoints
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Episodes shown at once, up to 16
    #[arg(long, value_name = "N", default_value_t = 4)]
    envs: usize,
    #[command(flatten)]
    environment: EnvArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// Shows.
pub fn run(a: &Arguments) -> Result<Report> {
    check_number(a.envs)?;
    let path = a.output.out.clone().unwrap_or_else(|| a.run.join("watch.gif"));
    if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("gif")) {
        let value = format!("'{}'", path.display());
        return Err(Error::value("animated file", value, "a name that ends in .gif", "Add .gif to it."));
    }
    let mut ready = Ready::new(&a.run, &a.environment, Some(a.envs), &Threads::default())?;
    let beside = if a.output.no_plots { Vec::new() } else { stills(&path, a.output.format).to_vec() };
    let web = path.with_extension("html");
    for file in [&web, &path].into_iter().chain(&beside) {
        files::check_new(file, a.output.force)?;
    }
    files::make_parent(&path)?;
    let mut replay = Replay::of(&ready)?;
    let mut seen = Seen::new(MAX_SHOWN);
    let flown = ready.fly(0, &mut |watched| {
        replay.see(watched);
        seen.see(watched);
    })?;
    replay.title = flown.title();
    files::replace(&web, page(&replay.title, &[seen.recording(&flown)?]).as_bytes())?;
    let n = replay.pictures.len();
    let bar = progress::bar(n as u64, "drawing", a.output.json);
    let scene = replay.scene();
    let apart = replay.stride as f64 * replay.spec.dt;
    save_gif(&path, n, apart, &|k| replay.figure(k, &scene), &mut |k| bar.set_position(k as u64))?;
    bar.finish_and_clear();
    let mut written = vec![web, path.clone()];
    if !a.output.no_plots {
        let [still, errors] = stills(&path, a.output.format);
        replay.figure(n - 1, &scene).save(&still)?;
        out::figure(&flown).save(&errors)?;
        written.extend([still, errors]);
    }
    let e = &flown.evaluation;
    if a.output.json {
        let value = json!({
            "command": "watch",
            "version": env!("CARGO_PKG_VERSION"),
            "task": replay.spec.task,
            "pictures": n,
            "seconds_apart": apart,
            "evaluation": e,
            "files": files::names(&written),
        });
        return Ok(Report::json(&value, true));
    }
    let mut page = Page::new();
    page.title(
        flown.task(),
        &format!("{}, seed {}, flown by {}", counted(a.envs, "episode"), replay.spec.config.seed, flown.controller),
    );
    page.line(format!(
        "  success {}, crashed {}, return {}",
        percent(e.success),
        percent(e.crashed),
        short(e.return_mean, 4)
    ));
    page.written(&written);
    Ok(Report::page(&page, true))
}

/// The files beside an animation, named after it: two animations in one folder do not share them.
fn stills(animation: &Path, extension: &str) -> [PathBuf; 2] {
    let stem = animation.file_stem().map_or("watch".into(), |stem| stem.to_string_lossy());
    ["", "-errors"].map(|what| animation.with_file_name(format!("{stem}{what}.{extension}")))
}

/// A few episodes, picture by picture.
struct Replay {
    title: String,
    spec: Spec,
    /// Articulated systems; none for a vehicle alone.
    system: Option<Multibody>,
    n_rotor: usize,
    /// Frames of the drones.
    frames: Vec<usize>,
    /// Name and unit of the task's error, and its column.
    error: Option<(String, String, usize)>,
    /// Steps between two pictures.
    stride: usize,
    wanted: Vec<Vec<Reference>>,
    pictures: Vec<Picture>,
}

struct Picture {
    time: f64,
    /// Of every environment.
    states: Vec<Vec<f64>>,
    errors: Vec<f64>,
    crashed: Vec<bool>,
    /// Where that is which a reference leads, if it is not the drones.
    followers: Vec<Option<[f64; 3]>>,
}

/// What is known of all pictures together.
struct Scene {
    /// What each picture shows: trails and all that is still to come, so that the view closes in as drones near their
    /// targets.
    rooms: Vec<[[f64; 3]; 2]>,
    most_error: f64,
    /// Places of what leaves trails, picture by picture, environment by environment.
    places: Vec<Vec<Vec<[f64; 3]>>>,
}

impl Scene {
    /// Half width of a drone in picture k, m.
    fn arm(&self, k: usize) -> f64 {
        let [lo, hi] = self.rooms[k];
        ARM * (0..3).map(|i| hi[i] - lo[i]).fold(0.0, f64::max)
    }
}

/// Half width of a drawn drone in lengths of the room.
const ARM: f64 = 0.04;
/// Shortest side of a room around single drones, m.
const CLOSEST: f64 = 1.0;
/// How long a trail is, s.
const TRAIL: f64 = 3.0;

impl Replay {
    fn of(ready: &Ready) -> Result<Self> {
        let env = &ready.env;
        let (spec, robot) = (env.spec().clone(), env.robot());
        let system = robot.model().map(|model| Multibody::new(model, *robot.physics())).transpose()?;
        let first = spec.metric_columns().start;
        let error = spec.info.get(first).map(|m| (m.name.replace('_', " "), m.unit.clone(), first));
        let least = spec.horizon.div_ceil(MAX_PICTURES);
        Ok(Self {
            title: String::new(),
            stride: ((BETWEEN / spec.dt).round() as usize).max(least).max(1),
            n_rotor: robot.drone().rotors.len(),
            frames: robot.drones().iter().map(|drone| drone.frame).collect(),
            system,
            error,
            wanted: Vec::new(),
            pictures: Vec::new(),
            spec,
        })
    }

    fn see(&mut self, watched: &EvaluationStep<'_>) {
        let (env, n) = (watched.env, self.spec.n_env);
        if watched.step == 1 {
            let references = |env: &Env, i| env.reference(i).ok().flatten().map_or_else(Vec::new, |w| w.references);
            self.wanted = (0..n).map(|i| references(env, i)).collect();
        }
        let over = (0..n).all(|i| !watched.flying[i] || watched.out.terminated[i] + watched.out.truncated[i] > 0);
        if watched.step % self.stride != 1 % self.stride && !over {
            return;
        }
        let state = |i| env.state(i).unwrap_or_default().iter().map(|x| f64::from(*x)).collect();
        let width = self.spec.info.len();
        let error = |i: usize| self.error.as_ref().map_or(0.0, |(.., k)| f64::from(watched.out.info[i * width + k]));
        let before = self.pictures.last();
        let stood = |i: usize| before.is_some_and(|p| p.crashed[i]);
        let picture = Picture {
            time: watched.step as f64 * self.spec.dt,
            states: (0..n).map(state).collect(),
            errors: (0..n).map(|i| if watched.flying[i] { error(i) } else { f64::NAN }).collect(),
            followers: (0..n).map(|i| env.reference(i).ok().flatten().and_then(|led| led.follower)).collect(),
            crashed: (0..n).map(|i| stood(i) || watched.out.terminated[i] > 0 || !watched.flying[i]).collect(),
        };
        self.pictures.push(picture);
    }

    /// Where the drones are in a state.
    fn drones(&self, state: &[f64]) -> Vec<[f64; 3]> {
        match &self.system {
            None => vec![[state[0], state[1], state[2]]],
            Some(system) => {
                let poses = body_poses(system, state);
                self.frames.iter().map(|body| poses[*body].position).collect()
            }
        }
    }

    fn scene(&self) -> Scene {
        let of = |p: &Picture| -> Vec<Vec<[f64; 3]>> { p.states.iter().map(|s| self.drones(s)).collect() };
        let drones: Vec<_> = self.pictures.iter().map(of).collect();
        // of all pictures or of none: a trail does not jump from a load to its drone
        let led = |i: usize| self.pictures.iter().all(|p| p.followers[i].is_some());
        let place = |p: usize, i: usize| match self.pictures[p].followers[i] {
            Some(at) if led(i) => vec![at],
            _ => drones[p][i].clone(),
        };
        let places: Vec<Vec<_>> =
            (0..self.pictures.len()).map(|p| (0..self.spec.n_env).map(|i| place(p, i)).collect()).collect();
        let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let (reach, least) = if self.system.is_some() { (1.2, 0.0) } else { (0.3, CLOSEST) };
        let all_lost = self.pictures.last().is_some_and(|last| last.crashed.iter().all(|lost| *lost));
        let mut rooms = Vec::with_capacity(self.pictures.len());
        for (k, picture) in self.pictures.iter().enumerate().rev() {
            let flying = |i: &usize| !picture.crashed[*i] || all_lost && k + 1 == self.pictures.len();
            let seen = (0..self.spec.n_env).filter(flying);
            let own = seen.flat_map(|i| drones[k][i].iter().chain(&places[k][i]).copied().collect::<Vec<_>>());
            for point in own.chain(self.targets(picture.time).into_iter().map(|(_, at)| at)) {
                for i in (0..3).filter(|i| point[*i].is_finite()) {
                    (lo[i], hi[i]) = (lo[i].min(point[i].max(-FARTHEST)), hi[i].max(point[i].min(FARTHEST)));
                }
            }
            rooms.push(room(lo, hi, reach, least));
        }
        rooms.reverse();
        // the trail behind the drones is shown too
        let rooms = (0..rooms.len()).map(|k| rooms[k.saturating_sub(self.trail_pictures())]).collect();
        let errors = self.pictures.iter().flat_map(|p| p.errors.iter().copied()).filter(|e| e.is_finite());
        Scene { rooms, most_error: errors.fold(1e-3, f64::max), places }
    }

    /// Where the task wants what, at a time, by environment.
    fn targets(&self, time: f64) -> Vec<(usize, [f64; 3])> {
        let of = |(i, references): (usize, &Vec<Reference>)| {
            references.iter().map(move |r| (i, goal(r, time))).collect::<Vec<(usize, [f64; 3])>>()
        };
        self.wanted.iter().enumerate().flat_map(of).collect()
    }

    fn figure(&self, k: usize, scene: &Scene) -> Figure {
        let (picture, room) = (&self.pictures[k], scene.rooms[k]);
        let mut figure = Figure::new(&self.title)
            .subtitle(format!("t = {:.2} s   ·   {}", picture.time, self.told(picture)))
            .size(720.0, 600.0)
            .grid(&[1.0], &[2.7, 1.0])
            .place((0, 0), (1, 1), Drawing::new("", self.items(k, scene)).room(room).floor(room[0][2]));
        if let Some(panel) = self.error_panel(k, scene) {
            figure = figure.place((0, 1), (1, 1), panel);
        }
        figure
    }

    fn told(&self, picture: &Picture) -> String {
        let crashed = picture.crashed.iter().filter(|c| **c).count();
        let flying: Vec<f64> = picture.errors.iter().copied().filter(|e| e.is_finite()).collect();
        let mut parts = Vec::new();
        if let (Some((name, unit, _)), false) = (&self.error, flying.is_empty()) {
            let mean = flying.iter().sum::<f64>() / flying.len() as f64;
            parts.push(format!("mean {name} {mean:.3} {unit}"));
        }
        if crashed > 0 {
            parts.push(format!("{crashed} of {} crashed", picture.crashed.len()));
        }
        parts.join("   ·   ")
    }

    fn error_panel(&self, k: usize, scene: &Scene) -> Option<Panel> {
        let (name, unit, _) = self.error.as_ref()?;
        let end = self.pictures.last()?.time;
        let mut panel = Panel::new("", "time [s]", format!("{name} [{unit}]"))
            .x_range(0.0, end)
            .y_range(0.0, 1.05 * scene.most_error);
        for i in 0..self.spec.n_env {
            let points = self.pictures[..=k].iter().map(|p| (p.time, p.errors[i])).collect();
            panel = panel.series(Series::line("", points).colour(Colour::nth(i)).width(1.4));
        }
        Some(panel)
    }

    fn items(&self, k: usize, scene: &Scene) -> Vec<Item> {
        let (picture, arm) = (&self.pictures[k], scene.arm(k));
        let mut items = Vec::new();
        for (i, at) in self.targets(picture.time) {
            items.push(Item::Ball { at, radius: 0.28 * arm, colour: Colour::nth(i) });
        }
        for (i, state) in picture.states.iter().enumerate().filter(|(_, s)| s.iter().all(|x| x.is_finite())) {
            let colour = if picture.crashed[i] { Colour::GREY } else { Colour::nth(i) };
            self.trail(k, i, scene, &mut items);
            match &self.system {
                None => glyph(state, self.n_rotor, arm, colour, &mut items),
                Some(system) => {
                    items.extend(model::items(system, state).into_iter().flat_map(|item| plain(item, colour)))
                }
            }
        }
        items
    }

    /// Pictures that a trail goes back.
    fn trail_pictures(&self) -> usize {
        (TRAIL / (self.stride as f64 * self.spec.dt)).ceil() as usize
    }

    /// The last of environment i's way before picture k, as far as the picture shows it.
    fn trail(&self, k: usize, i: usize, scene: &Scene, items: &mut Vec<Item>) {
        let [lo, hi] = scene.rooms[k];
        let inside = |p: &[f64; 3]| (0..3).all(|i| p[i].is_finite() && (lo[i]..=hi[i]).contains(&p[i]));
        let recent = &scene.places[k.saturating_sub(self.trail_pictures())..=k];
        for body in 0..recent[0][i].len() {
            for pair in recent.windows(2) {
                let [from, to] = [pair[0][i][body], pair[1][i][body]];
                if inside(&from) && inside(&to) {
                    let on_floor = |p: [f64; 3]| [p[0], p[1], lo[2]];
                    items.push(Item::Stick { from: on_floor(from), to: on_floor(to), colour: Colour::PALE });
                    items.push(Item::Stick { from, to, colour: Colour::nth(i) });
                }
            }
        }
    }
}

/// The room around points from `lo` to `hi`, down to the ground where that is near, no side shorter than `least`, m.
fn room(mut lo: [f64; 3], mut hi: [f64; 3], reach: f64, least: f64) -> [[f64; 3]; 2] {
    for i in 0..3 {
        let more = (0.5 * (least - (hi[i] - lo[i]))).max(reach);
        (lo[i], hi[i]) = (lo[i] - more, hi[i] + more);
    }
    if lo[2] < hi[2] - lo[2] {
        lo[2] = lo[2].min(0.0);
    }
    [lo, hi]
}

/// Nothing farther away is drawn, m.
const FARTHEST: f64 = 50.0;

/// A multirotor as lines: arms, and a ring per rotor; the first arm points forward left.
fn glyph(state: &[f64], n_rotor: usize, arm: f64, colour: Colour, items: &mut Vec<Item>) {
    // behind position and velocity
    let [w, x, y, z] = [state[6], state[7], state[8], state[9]];
    let turned = |[a, b, c]: [f64; 3]| {
        // v + 2 q × (q × v + w v)
        let t = [2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)];
        [a + w * t[0] + y * t[2] - z * t[1], b + w * t[1] + z * t[0] - x * t[2], c + w * t[2] + x * t[1] - y * t[0]]
    };
    let at = |body: [f64; 3]| {
        let p = turned(body);
        [state[0] + p[0], state[1] + p[1], state[2] + p[2]]
    };
    let turn = std::f64::consts::TAU;
    for rotor in 0..n_rotor {
        let (s, c) = (turn * (rotor as f64 + 0.5) / n_rotor as f64).sin_cos();
        let tip = [arm * c, arm * s, 0.0];
        items.push(Item::Stick { from: at([0.0; 3]), to: at(tip), colour: Colour::INK });
        let radius = (0.52 * arm).min(2.4 * arm / n_rotor as f64);
        let rim = |k: usize| {
            let (s, c) = (turn * k as f64 / 14.0).sin_cos();
            at([tip[0] + radius * c, tip[1] + radius * s, 0.0])
        };
        items.extend((0..14).map(|k| Item::Stick { from: rim(k), to: rim(k + 1), colour }));
    }
    items.push(Item::Stick { from: at([0.0; 3]), to: at([0.0, 0.0, 0.9 * arm]), colour: Colour::INK });
}

/// A part of a system as it is drawn small: rotors as rings, without the marks of joints.
fn plain(item: Item, colour: Colour) -> Vec<Item> {
    match item {
        Item::Hinge { .. } | Item::Slide { .. } | Item::Pivot { .. } => Vec::new(),
        Item::Rotor { hub, axis, radius, .. } => model::rotor_ring(hub, axis, radius)
            .into_iter()
            .map(|[from, to]| Item::Stick { from, to, colour })
            .collect(),
        other => vec![other],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drone_is_drawn_by_its_attitude_and_in_its_size_however_fast_it_is() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // rolled by 90 degrees, at 13 m/s
        let state = [1.0, 2.0, 3.0, 12.0, -5.0, 0.0, half, half, 0.0, 0.0];
        let mut items = Vec::new();
        glyph(&state, 4, 0.5, Colour::BLUE, &mut items);
        let Some(Item::Stick { from, to, .. }) = items.last() else { panic!("{items:?}") };
        let up = [0, 1, 2].map(|i| (to[i] - from[i]) / (0.9 * 0.5));
        assert!((up[0]).hypot(up[1] + 1.0).hypot(up[2]) < 1e-12, "{up:?}");
        let far = items.iter().filter_map(|item| match item {
            Item::Stick { to, .. } => Some((to[0] - 1.0).hypot(to[1] - 2.0).hypot(to[2] - 3.0)),
            _ => None,
        });
        assert!(far.fold(0.0, f64::max) < 2.0 * 0.5);
    }

    #[test]
    fn a_room_is_never_smaller_than_what_a_drone_needs() {
        let [lo, hi] = room([0.0, 0.0, 2.0], [0.1, 0.1, 2.1], 0.3, 1.0);
        assert!((0..3).all(|i| hi[i] - lo[i] >= 1.0 - 1e-9) && lo[2] > 1.0, "{lo:?} {hi:?}");
    }

    #[test]
    fn stills_stand_beside_the_animation_and_bear_its_name() {
        let names = |animation: &str| stills(Path::new(animation), "png").map(|path| path.display().to_string());
        assert_eq!(names("runs/a/watch.gif"), ["runs/a/watch.png", "runs/a/watch-errors.png"]);
        assert_eq!(names("v1.2.GIF"), ["v1.2.png", "v1.2-errors.png"]);
    }
}
