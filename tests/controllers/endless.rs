//! No vehicle, no gains and no latency make the search for margins run without end or panic.

use omnidrones::controllers::cascade::Rates;
use omnidrones::controllers::design::{AnalysisPoint, ErrorState, LoopModel, TrimTarget, trim};
use omnidrones::controllers::linear::{modes, unreachable};
use omnidrones::controllers::reference::{Hover, Reference};
use omnidrones::controllers::{ClosedLoop, Target};
use omnidrones::dynamics::{Disturbance, Gains, Physics, Plant, Vehicle, vehicles};
use omnidrones::error::Result;
use omnidrones::rng::{Purpose, Stream};
use std::sync::LazyLock;
use std::time::Instant;

/// A vehicle with another mass, inertia and lag, its gains with factors, some of them of any power of ten, and a latency in steps:
/// of every tenth more than ten.
fn drawn(episode: u64) -> (Vehicle, Gains, usize) {
    let mut stream = Stream::new(23, 0, episode, Purpose::PARAMETERS);
    let names = vehicles::names();
    let mut vehicle = vehicles::by_name(names[stream.below(names.len() as u64) as usize]).unwrap();
    let (mass, inertia) = (stream.uniform(0.5, 1.4), stream.uniform(0.3, 3.0));
    for part in &mut vehicle.parts {
        part.mass *= mass;
        let i = &mut part.inertia;
        [&mut i.xx, &mut i.yy, &mut i.zz, &mut i.xy, &mut i.xz, &mut i.yz].into_iter().for_each(|j| *j *= inertia);
    }
    let (lag, both) = (stream.uniform(0.2, 4.0), stream.unit() < 0.5);
    for rotor in &mut vehicle.rotors {
        rotor.time_constant_down *= lag;
        rotor.time_constant_up = if both { rotor.time_constant_down } else { rotor.time_constant_up * lag };
    }
    let wild = stream.unit() < 0.4;
    let mut factor = || match wild && stream.unit() < 0.3 {
        true => 10_f64.powf(stream.uniform(-300.0, 6.0)),
        false => stream.uniform(0.3, 2.0),
    };
    let gains = vehicle.gains();
    let each = |k: [f64; 3], factor: &mut dyn FnMut() -> f64| k.map(|k| k * factor());
    let gains = Gains {
        position: each(gains.position, &mut factor),
        velocity: each(gains.velocity, &mut factor),
        attitude: each(gains.attitude, &mut factor),
        rate: each(gains.rate, &mut factor),
        ..gains
    };
    let latency = stream.below(if episode.is_multiple_of(10) { 30 } else { 11 }) as usize
        + if episode.is_multiple_of(10) { 11 } else { 0 };
    (vehicle, gains, latency)
}

/// What `omnidrones design` asks, at all points or at two.
fn judged((vehicle, gains, latency): (Vehicle, Gains, usize), everywhere: bool) -> Result<bool> {
    let physics = Physics::default();
    let plant = Plant::of_vehicle(&vehicle, physics)?;
    let hover = trim(&plant, &TrimTarget::hover())?;
    let linear = ErrorState::of_plant(&plant)?.state_space(&plant, &hover.state, &hover.input, hover.yaw_rate)?;
    modes(&linear)?;
    unreachable(&linear)?;
    let closed = ClosedLoop::of_vehicle(&vehicle, physics, &gains, &Rates::default())?.with_latency(latency)?;
    let there = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let model = LoopModel::new(closed, Target::level(&there), &Disturbance::none(), &hover.state)?;
    let stable = model.stability()?.is_stable();
    let commands = (0..model.commands.len()).map(AnalysisPoint::Command);
    let points: Vec<AnalysisPoint> = commands.chain((0..12).map(AnalysisPoint::Measurement)).collect();
    for point in points.into_iter().step_by(if everywhere { 1 } else { 7 }) {
        let margins = model.margins(point)?;
        assert!(stable || !margins.stable, "{point:?}: {margins:?}");
    }
    model.disk_margin(AnalysisPoint::Commands, 0.0)?;
    Ok(stable)
}

/// Time that this thread has been computing, s, where the system tells it: a busy machine takes longer for the same. Else that of the clock.
fn seconds_of_a_core() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.as_deref().and_then(|line| line.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

/// Judges cases and tells the longest; an error is an answer.
fn all(cases: impl Iterator<Item = u64>, everywhere: bool) {
    let (mut longest, mut counts) = ((0.0, 0), [0; 3]);
    for episode in cases {
        let before = seconds_of_a_core();
        let found = judged(drawn(episode), everywhere);
        let time = seconds_of_a_core() - before;
        longest = if time > longest.0 { (time, episode) } else { longest };
        counts[match &found {
            Ok(true) => 0,
            Ok(false) => 1,
            Err(_) => 2,
        }] += 1;
        assert!(time < 90.0, "case {episode} took {time:.0} s: {found:?}");
    }
    println!("stable, not, refused: {counts:?}; longest {:.1} s, case {}", longest.0, longest.1);
    assert!(counts[0] > 0 && counts[1] > 0, "{counts:?}");
}

#[test]
fn random_vehicles_gains_and_latencies_have_an_answer_in_time() {
    all((0..24).map(|k| 41 * k), false);
}

#[test]
#[ignore = "half an hour: cargo test --test controllers a_thousand_random -- --ignored --nocapture"]
fn a_thousand_random_vehicles_gains_and_latencies_have_an_answer_in_time() {
    all(0..1000, true);
}

#[test]
fn motors_that_lag_as_long_both_ways_and_late_commands_have_an_answer() {
    let mut vehicle = vehicles::by_name("hummingbird").unwrap();
    vehicle.rotors.iter_mut().for_each(|rotor| rotor.time_constant_up = 0.025);
    let gains = vehicle.gains();
    judged((vehicle, gains, 20), false).unwrap();
}

#[test]
fn gains_down_to_the_smallest_number_have_an_answer() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    for tiny in [1e-100, 1e-160, 1e-300, f64::MIN_POSITIVE] {
        let all = [tiny; 3];
        let gains = Gains { position: all, velocity: all, attitude: all, rate: all, ..vehicle.gains() };
        let stable = judged((vehicle.clone(), gains, 0), false);
        assert!(!stable.unwrap_or(false), "{tiny:e}");
    }
}
