//! Frames and loads under several drones: what their controllers hold, track and keep clear of.
//!
//! Nominal physics, RK4 at 2 ms unless a test says otherwise.

use omnidrones::controllers::allocation::{Axis, Solver};
use omnidrones::controllers::platform_controller::Directions;
use omnidrones::controllers::position::velocity_command;
use omnidrones::controllers::reference::{Hover, Lemniscate, Step};
use omnidrones::controllers::{
    self, Controller, Flight, FlightPlan, FormationController, PlatformController, Rates, Reference, Setup, Tilt,
    TransportController, default_controller,
};
use omnidrones::dynamics::spatial::{dot, from_euler, mat_mul, matrix, scale, sub, transpose};
use omnidrones::dynamics::tree::{Multibody, body_poses};
use omnidrones::dynamics::{Gains, Physics, configurations};
use omnidrones::rng::{Purpose, Stream};

fn system(name: &str) -> Multibody {
    Multibody::new(&configurations::by_name(name).unwrap(), Physics::default()).unwrap()
}

fn start_on(system: &Multibody, controller: &dyn Controller, reference: &Reference) -> Vec<f64> {
    controllers::start_on(&system.clone().into(), controller, reference).unwrap()
}

fn controller_for(system: &Multibody, rates: &Rates) -> Box<dyn Controller> {
    default_controller(&system.clone().into(), &Setup::new(None, rates)).unwrap()
}

fn platform(system: &Multibody) -> PlatformController {
    PlatformController::new(system, None, &Rates::default()).unwrap()
}

fn transport(system: &Multibody) -> TransportController {
    TransportController::new(system, None, &Rates::default()).unwrap()
}

fn formation(system: &Multibody) -> FormationController {
    FormationController::new(system, None, &Rates::default()).unwrap()
}

fn hover(yaw: f64) -> Reference {
    Reference::Hover(Hover { position: [0.0, 0.0, 3.0], yaw })
}

/// Of the size and pace that `omnidrones fly` takes for configurations.
fn lemniscate() -> Reference {
    Reference::Lemniscate(Lemniscate { rate: 0.5, origin: [0.0, 0.0, 3.0], ..Lemniscate::default() })
}

/// Degrees, from 1 s to 2 s.
fn tilted(roll: f64, pitch: f64) -> Tilt {
    Tilt { roll: roll.to_radians(), pitch: pitch.to_radians(), at: 1.0, ramp: 1.0 }
}

/// A flight with its errors of position (m) and attitude (rad, the whole angle) at every step.
struct Flown {
    flight: Flight,
    errors: Vec<[f64; 2]>,
}

fn fly(system: &Multibody, controller: &mut dyn Controller, reference: &Reference, tilt: Tilt, duration: f64) -> Flown {
    let start = start_on(system, controller, reference);
    fly_from(system, controller, reference, tilt, duration, &start)
}

fn fly_from(
    system: &Multibody,
    controller: &mut dyn Controller,
    reference: &Reference,
    tilt: Tilt,
    duration: f64,
    start: &[f64],
) -> Flown {
    let plan =
        FlightPlan { reference: reference.clone(), tilt, duration, physics: *system.physics(), ..Default::default() };
    let flight = controllers::fly_from(&system.clone().into(), controller, &plan, start, &mut |_| {}).unwrap();
    assert_eq!(flight.diverged_at, None);
    let log = &flight.log;
    let error = |k: usize| {
        let wanted = tilt.orientation(reference, log.time[k]).attitude;
        let e = mat_mul(transpose(wanted), matrix(log.attitude[k]));
        let angle = (0.5 * (e[0][0] + e[1][1] + e[2][2] - 1.0)).clamp(-1.0, 1.0).acos();
        let miss = sub(log.position[k], log.reference_position[k]);
        [dot(miss, miss).sqrt(), angle]
    };
    let errors = (0..log.time.len()).map(error).collect();
    Flown { flight, errors }
}

impl Flown {
    /// Largest and root mean square error of position after `from` seconds, mm.
    fn position(&self, from: f64) -> [f64; 2] {
        self.after(from, 0).map(|e| 1e3 * e)
    }

    /// Likewise of attitude, degrees.
    fn attitude(&self, from: f64) -> [f64; 2] {
        self.after(from, 1).map(f64::to_degrees)
    }

    fn after(&self, from: f64, row: usize) -> [f64; 2] {
        let late = self.flight.log.time.iter().zip(&self.errors).filter(|(t, _)| **t >= from).map(|(_, e)| e[row]);
        let (n, most, squares) = late.fold((0.0, 0.0_f64, 0.0), |(n, m, s), e| (n + 1.0, m.max(e), s + e * e));
        [most, (squares / f64::max(n, 1.0)).sqrt()]
    }

    /// When the position error was last above `limit` (m), s.
    fn settled(&self, limit: f64) -> f64 {
        self.errors.iter().rposition(|e| e[0] > limit).map_or(0.0, |k| self.flight.log.time[k])
    }
}

#[test]
fn platforms_hold_a_tilt_of_20_degrees_in_place() {
    for name in ["platform", "platform_6"] {
        let system = system(name);
        for (roll, pitch) in [(20.0, 0.0), (0.0, -20.0), (14.0, 14.0)] {
            for ramp in [0.0, 1.0] {
                let tilt = Tilt { ramp, ..tilted(roll, pitch) };
                let flown = fly(&system, &mut platform(&system), &hover(0.0), tilt, 10.0);
                let ([drift, _], [angle, _]) = (flown.position(6.0), flown.attitude(6.0));
                let on_the_way = flown.position(0.0)[0];
                println!(
                    "worst {name} {roll} {pitch} {ramp}: {drift:.2} mm {angle:.3}°, on the way {on_the_way:.1} mm"
                );
                // measured: 0.08 mm and 0.037° (steps; ramps 0.003°), 7.3 mm on the way (platform, both axes, ramp)
                assert!(drift < 0.2 && angle < 0.1 && on_the_way < 20.0, "{name}: {drift} {angle} {on_the_way}");
            }
        }
    }
}

#[test]
fn platforms_turn_about_the_vertical_and_settle() {
    for name in ["platform_2", "platform", "platform_6"] {
        let system = system(name);
        for degrees in [45.0_f64, 90.0] {
            let mut controller = platform(&system);
            let start = start_on(&system, &controller, &hover(0.0));
            let flown = fly_from(&system, &mut controller, &hover(degrees.to_radians()), Tilt::LEVEL, 10.0, &start);
            let ([drift, _], [angle, _]) = (flown.position(0.0), flown.attitude(6.0));
            println!("worst {name} yaw {degrees}: {drift:.1} mm over all, {angle:.3}° after 6 s");
            // measured: 14.0 mm (platform_6, 90°), 0.24° (all, 90°; 0.08° at 45°)
            assert!(drift < 40.0 && angle < 0.5, "{name}: {drift} {angle}");
        }
    }
}

#[test]
fn platforms_track_a_lemniscate_level_and_tilted() {
    for name in ["platform", "platform_6"] {
        let system = system(name);
        for degrees in [0.0, 15.0] {
            let flown = fly(&system, &mut platform(&system), &lemniscate(), tilted(degrees, 0.0), 20.0);
            let ([_, rmse], [angle, _]) = (flown.position(2.0), flown.attitude(3.0));
            println!("worst {name} lemniscate at {degrees}°: RMSE {rmse:.1} mm, {angle:.2}°");
            // measured: 9.6 mm and 0.05° level, 12.9 mm and 0.08° at 15° (platform_6; platform within 0.2 mm of it)
            assert!(rmse < 25.0 && angle < 0.2, "{name}: {rmse} {angle}");
        }
    }
}

#[test]
fn two_drones_hold_all_but_the_angle_about_their_line() {
    let system = system("platform_2");
    let mut controller = platform(&system);
    assert_eq!(controller.lost(), [Axis::Roll]);
    assert!(platform(&self::system("platform")).lost().is_empty());
    let flown = fly(&system, &mut controller, &hover(0.0), tilted(0.0, 20.0), 10.0);
    let ([drift, _], [angle, _]) = (flown.position(6.0), flown.attitude(6.0));
    println!("worst platform_2 pitch 20: {drift:.2} mm {angle:.3}°");
    // measured: 0.09 mm, 0.003°
    assert!(drift < 0.2 && angle < 0.006, "{drift} {angle}");
    // a bar along x follows its drones about x: they roll to fly along y
    let flown = fly(&system, &mut platform(&system), &lemniscate(), Tilt::LEVEL, 15.0);
    let ([_, rmse], [angle, _]) = (flown.position(2.0), flown.attitude(2.0));
    println!("worst platform_2 lemniscate: RMSE {rmse:.1} mm, {angle:.1}°");
    // measured: 7.8 mm, 8.0°
    assert!(rmse < 25.0 && angle < 16.0, "{rmse} {angle}");
}

/// A start at hover, disturbed: 0.5 m, 0.5 m/s, 0.3 rad, 0.5 rad/s, joints 0.3 rad.
fn disturbed(system: &Multibody, controller: &dyn Controller, seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(seed, 0, 0, Purpose::RESET);
    let mut within = |size: f64| size * (2.0 * stream.uniform(0.0, 1.0) - 1.0);
    let mut state = start_on(system, controller, &hover(0.0));
    let layout = system.layout();
    let root = layout.bodies[0].position;
    (0..3).for_each(|k| state[root + k] += within(0.5));
    (3..6).for_each(|k| state[root + k] += within(0.5));
    let q = from_euler(within(0.3), within(0.3), within(0.3));
    state[root + 6..root + 10].copy_from_slice(&q);
    (10..13).for_each(|k| state[root + k] += within(0.5));
    layout.bodies[1..].iter().for_each(|b| state[b.position] += within(0.3));
    state
}

#[test]
fn twenty_disturbed_starts_all_settle() {
    for name in ["platform", "platform_6", "transport", "transport_6"] {
        let system = system(name);
        let (mut drift, mut angle) = (0.0_f64, 0.0_f64);
        for seed in 0..20 {
            let mut controller = controller_for(&system, &Rates::default());
            let start = disturbed(&system, controller.as_ref(), seed);
            let flown = fly_from(&system, controller.as_mut(), &hover(0.0), Tilt::LEVEL, 8.0, &start);
            drift = drift.max(flown.position(7.0)[0]);
            angle = angle.max(flown.attitude(7.0)[0]);
        }
        println!("worst {name} of 20 starts: {drift:.2} mm {angle:.3}° after 7 s");
        // measured: platforms 0.22 mm and 0.009°, loads 0.02 mm and 0.004°
        assert!(drift < 0.5 && angle < 0.02, "{name}: {drift} {angle}");
    }
}

/// Least angle between any drone's wake and the way to any other drone, degrees, after `from` seconds.
fn clearest(system: &Multibody, flown: &Flown, from: f64) -> f64 {
    let n = system.rest_state().len();
    let late = flown.flight.log.time.iter().zip(flown.flight.states.chunks_exact(n)).filter(|(t, _)| **t >= from);
    let mut least = f64::INFINITY;
    for (_, state) in late.step_by(20) {
        let poses = body_poses(system, state);
        let drones: Vec<_> = system.model().drones().iter().map(|d| &poses[d.body]).collect();
        for a in &drones {
            let wake = [0, 1, 2].map(|k| -a.rotation[k][2]);
            for b in drones.iter().filter(|b| b.position != a.position) {
                let way = sub(b.position, a.position);
                let cosine = dot(wake, scale(1.0 / dot(way, way).sqrt(), way));
                least = least.min(cosine.clamp(-1.0, 1.0).acos().to_degrees());
            }
        }
    }
    least
}

#[test]
fn drones_of_a_steep_platform_stay_out_of_each_others_wakes() {
    let system = system("platform");
    let flight = |wake: f64| {
        let directions = Directions { wake: wake.to_radians(), ..Directions::default() };
        let mut controller = PlatformController::with_directions(&system, None, &Rates::default(), directions).unwrap();
        let flown = fly(&system, &mut controller, &hover(0.0), tilted(0.0, 55.0), 10.0);
        let drift = flown.position(6.0)[0];
        (clearest(&system, &flown, 6.0), drift, controller.allocation().counts())
    };
    // forces that hold a frame at 55° straight up point wakes 35° past the drones below
    let (careless, _, (free, _)) = flight(10.0);
    let (clear, drift, (_, counts)) = flight(45.0);
    println!("worst wakes: {careless:.2}° without, {clear:.2}° with the condition; {drift:.2} mm; {counts:?}");
    // measured: 35.00°; 45.06° and 0.25 mm, 841 cone programs
    assert!(free > 900 && (careless - 35.0).abs() < 0.5, "{free} {careless}");
    assert!(counts.of(Solver::Clarabel) > 500 && counts.of(Solver::Held) == 0, "{counts:?}");
    assert!(clear > 44.5 && drift < 0.5, "{clear} {drift}");
}

#[test]
fn a_load_is_tracked_better_than_by_a_formation() {
    let step = Reference::Step(Step { from: [0.0, 0.0, 3.0], to: [1.0, 1.0, 3.5], time: 1.0, yaw: 0.0 });
    for name in ["transport", "transport_6"] {
        let system = system(name);
        let pair = |reference: &Reference, duration: f64| {
            let old = fly(&system, &mut formation(&system), reference, Tilt::LEVEL, duration);
            let new = fly(&system, &mut transport(&system), reference, Tilt::LEVEL, duration);
            [old, new]
        };
        let [old, new] = pair(&hover(0.0), 6.0).map(|f| f.position(0.0)[0]);
        println!("worst {name} hover: {old:.3} mm, now {new:.3} mm");
        // measured: both 0.000 mm: they start on it
        assert!(new < 0.01, "{new}");
        let [old, new] = pair(&lemniscate(), 20.0);
        let ([_, was], [_, rmse]) = (old.position(2.0), new.position(2.0));
        let ([_, swung], [_, swings]) = (old.attitude(2.0), new.attitude(2.0));
        println!("worst {name} lemniscate: RMSE {was:.1} mm {swung:.2}°, now {rmse:.1} mm {swings:.2}°");
        // measured: 152.3 mm and 1.20° to 9.3 mm and 0.13°; with six drones 150.6 mm and 0.94° to 9.4 mm and 0.12°
        assert!(rmse < 20.0 && 7.0 * rmse < was && swings < swung, "{was} {rmse}");
        let [old, new] = pair(&step, 15.0);
        let ([_, was], [_, rmse]) = (old.position(1.0), new.position(1.0));
        let (rang, settled) = (old.settled(0.03) - 1.0, new.settled(0.03) - 1.0);
        println!(
            "worst {name} step: RMSE {was:.0} mm, within 30 mm after {rang:.2} s; now {rmse:.0} mm, {settled:.2} s"
        );
        // measured: 363 mm and 6.64 s to 360 mm and 1.86 s; with six drones 366 mm and 7.35 s to 369 mm and 1.91 s: the start
        // of a step is as slow, but the load does not swing after it
        assert!(rmse < 1.05 * was && settled < 0.5 * rang, "{was} {rmse} {rang} {settled}");
    }
}

#[test]
fn a_load_turns_by_45_degrees_without_leaving_its_place() {
    for name in ["transport", "transport_6"] {
        let system = system(name);
        let turn = |mut controller: Box<dyn Controller>| {
            let start = start_on(&system, controller.as_ref(), &hover(0.0));
            fly_from(&system, controller.as_mut(), &hover(std::f64::consts::FRAC_PI_4), Tilt::LEVEL, 10.0, &start)
        };
        let [old, new] = [turn(Box::new(formation(&system))), turn(Box::new(transport(&system)))];
        let [(was_off, was_late), (off, late)] = [old, new].map(|f| (f.position(0.0)[0], f.attitude(5.0)[0]));
        println!("worst {name} turn: {was_off:.1} mm {was_late:.2}° after 5 s, now {off:.1} mm {late:.3}°");
        // measured: 12.4 mm and 1.09° to 4.2 mm and 0.03°; with six drones 19.1 mm and 0.82° to 7.8 mm and 0.01°
        assert!(off < 0.6 * was_off && late < 0.2 * was_late, "{was_off} {off} {was_late} {late}");
    }
}

#[test]
fn a_longer_step_and_wind_are_borne() {
    use omnidrones::dynamics::Effects;
    use omnidrones::dynamics::aero::wind::Wind;
    for name in ["platform", "transport"] {
        let model = configurations::by_name(name).unwrap();
        let effects = Effects { disturbance: true, ..Effects::default() };
        let physics = Physics { dt: 0.004, effects, ..Physics::default() };
        let system = Multibody::new(&model, physics).unwrap();
        let rates = Rates { rate: 250.0, attitude: 250.0, velocity: 125.0 };
        let mut controller = controller_for(&system, &rates);
        let start = start_on(&system, controller.as_ref(), &lemniscate());
        let wind = Wind::Constant { velocity: [3.0, 0.0, 0.0] };
        let plan = FlightPlan { reference: lemniscate(), duration: 20.0, physics, rates, wind, ..Default::default() };
        let flight =
            controllers::fly_from(&system.clone().into(), controller.as_mut(), &plan, &start, &mut |_| {}).unwrap();
        assert_eq!(flight.diverged_at, None);
        let rmse = 1e3 * flight.log.summary(2.0).rmse.unwrap();
        println!("worst {name} in 3 m/s at 4 ms: RMSE {rmse:.0} mm");
        // measured: platform 216 mm, transport 139 mm: nothing integrates
        assert!(rmse < 400.0, "{name}: {rmse}");
    }
}

#[test]
fn commands_enter_at_every_level_with_the_same_result() {
    let system = system("platform");
    let tilt = tilted(10.0, 5.0).orientation(&hover(0.2), 3.0);
    let state = disturbed(&system, &platform(&system), 5);
    let sample = lemniscate().sample(1.3);
    let mut rows = vec![vec![0.0; system.layout().n_input()]; 4];
    let mut pilots: Vec<_> = (0..4).map(|_| platform(&system)).collect();
    pilots[0].position(&state, &sample, &tilt, &mut rows[0]);
    let (law, own) = (*pilots[0].law(), pilots[0].tracked(&state));
    let command = velocity_command(&law.gains, &sample, &own);
    pilots[1].velocity(&state, &command, &tilt, &mut rows[1]);
    let force = law.force(&own, &pilots[2].early(&command));
    pilots[2].attitude(&state, force, &tilt, &mut rows[2]);
    pilots[3].wrench(&state, &law.attitude(&own, force, &tilt), &mut rows[3]);
    assert!(rows[0].iter().any(|a| a.abs() > 0.01));
    for row in &rows[1..] {
        assert_eq!(row, &rows[0]);
    }
    let system = self::system("transport");
    let sample = hover(0.0).sample(0.0);
    let state = disturbed(&system, &transport(&system), 5);
    let mut rows = vec![vec![0.0; system.layout().n_input()]; 4];
    let mut pilots: Vec<_> = (0..4).map(|_| transport(&system)).collect();
    let (law, own) = (*pilots[0].law(), pilots[0].tracked(&state));
    let command = velocity_command(&law.gains, &sample, &own);
    pilots[0].position(&state, &sample, &tilt, &mut rows[0]);
    pilots[1].velocity(&state, &command, &tilt, &mut rows[1]);
    let force = law.force(&own, &command);
    pilots[2].attitude(&state, force, &tilt, &mut rows[2]);
    pilots[3].wrench(&state, &law.attitude(&own, force, &tilt), &mut rows[3]);
    for row in &rows[1..] {
        assert_eq!(row, &rows[0]);
    }
}

#[test]
fn pilots_are_found_by_structure_and_refuse_what_cannot_work() {
    for (name, controller) in [
        ("platform_2", "platform"),
        ("platform", "platform"),
        ("platform_6", "platform"),
        ("transport", "transport"),
        ("transport_6", "transport"),
        ("payload", "lqr"),
        ("inverted_pendulum", "lqr"),
    ] {
        assert_eq!(controller_for(&system(name), &Rates::default()).name(), controller, "{name}");
    }
    let refusal = |name: &str| {
        PlatformController::new(&system(name), None, &Rates::default()).map(|_| ()).unwrap_err().to_string()
    };
    assert!(refusal("transport").contains("a frame under two or more drones"), "{}", refusal("transport"));
    let hummingbird = omnidrones::dynamics::vehicles::by_name("hummingbird").unwrap().gains();
    let hasty = Gains { position: [9.0; 3], velocity: [6.0; 3], ..hummingbird };
    let text = PlatformController::new(&system("platform"), Some(&hasty), &Rates::default())
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(text.contains("bandwidth of the drones over that of the frame") && text.contains("Lower"), "{text}");
    // 1.78 and 8.90 rad/s
    let [frame, drones] = platform(&system("platform")).bandwidths();
    assert!((drones / frame - 5.0).abs() < 1e-12);
    let heavy = configurations::Transport { box_mass: 8.0, ..configurations::Transport::four() }.build().unwrap();
    let heavy = Multibody::new(&heavy.model, Physics::default()).unwrap();
    let text = TransportController::new(&heavy, None, &Rates::default()).map(|_| ()).unwrap_err().to_string();
    assert!(text.contains("weight per drone"), "{text}");
}
