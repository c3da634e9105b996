//! Rotors that fail: what the certificate of reach says is left, and that what is left flies.

use nalgebra::DMatrix;
use omnidrones::autodiff::System;
use omnidrones::controllers::allocation::failure::{LEAST_MARGIN, damaged, hover};
use omnidrones::controllers::allocation::{
    Allocator, AttainableWrenches, Problem, Solver, WrenchMargin, problem::balanced_weights,
};
use omnidrones::controllers::design::{TrimTarget, trim_damaged};
use omnidrones::controllers::registry::controller;
use omnidrones::controllers::{
    Assessment, AttitudeCommand, Axis, Capability, FailureTable, FaultTolerant, Flight, FlightPlan, Kinematics,
    RateCommand, Rates, Reference, RotorFailure, Setup, VelocityCommand, fly_from, fly_vehicle,
};
use omnidrones::dynamics::spatial::from_euler;
use omnidrones::dynamics::{Gains, Multirotor, Physics, Plant, Vehicle, vehicles};
use omnidrones::rng::{Purpose, Stream};
use std::f64::consts::FRAC_PI_4;

const THREE: [Axis; 3] = [Axis::Thrust, Axis::Roll, Axis::Pitch];

/// A problem of n random columns with bounds [0, 1 to 6] and the weights of the rows that count.
fn random_problem(rng: &mut Stream, n: usize, axes: &[Axis]) -> Problem {
    let geometry = DMatrix::from_fn(6, n, |row, _| rng.uniform(-1.0, 1.0) * if row < 3 { 1.0 } else { 0.3 });
    let upper = (0..n).map(|_| rng.uniform(1.0, 6.0)).collect();
    let mut problem = Problem::boxed(geometry, [1.0; 6], upper).unwrap();
    let length = AttainableWrenches::of(&problem, axes).unwrap().length();
    let weights = balanced_weights(length);
    problem.weights = std::array::from_fn(|i| if axes.contains(&Axis::ALL[i]) { weights[i] } else { 0.0 });
    problem.regularisation *= 1e-4;
    problem
}

/// Distance (N) by which the best allocation misses a wrench given in scaled rows.
fn miss(allocator: &mut Allocator, set: &AttainableWrenches, scaled: &[f64]) -> f64 {
    let mut wrench = [0.0; 6];
    for (axis, value) in set.axes().iter().zip(scaled) {
        wrench[*axis as usize] = value * if axis.is_moment() { set.length() } else { 1.0 };
    }
    let solution = allocator.solve(&wrench);
    assert_ne!(solution.solver, Solver::Held);
    let reached = set.scaled(&allocator.problem().delivered(&allocator.solution().inputs));
    scaled.iter().zip(reached).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn the_margin_is_the_radius_of_the_largest_ball_that_the_allocator_reaches() {
    let mut rng = Stream::new(1, 0, 0, Purpose::RESET);
    let (mut worst_inside, mut least_outside) = (0.0_f64, f64::INFINITY);
    for case in 0..60 {
        let axes: &[Axis] = [&THREE[..], &Axis::STEERED[..], &Axis::ALL[..]][case % 3];
        let problem = random_problem(&mut rng, axes.len() + 1 + case % 4, axes);
        let middle: Vec<f64> = problem.upper.iter().map(|u| u * rng.uniform(0.3, 0.7)).collect();
        let wrench = problem.delivered(&middle);
        let set = AttainableWrenches::of(&problem, axes).unwrap();
        let margin = set.margin(&wrench);
        assert!(margin.distance > 0.0, "{margin:?}");
        let center = set.scaled(&wrench);
        let mut allocator = Allocator::new(problem).unwrap();
        for _ in 0..40 {
            let mut way: Vec<f64> = (0..axes.len()).map(|_| rng.normal()).collect();
            let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
            way.iter_mut().zip(center).for_each(|(v, c)| *v = c + margin.distance * *v / length);
            worst_inside = worst_inside.max(miss(&mut allocator, &set, &way) / margin.distance);
        }
        let beyond: Vec<f64> =
            (0..axes.len()).map(|k| center[k] + 1.05 * margin.distance * margin.direction[k]).collect();
        least_outside = least_outside.min(miss(&mut allocator, &set, &beyond) / margin.distance);
    }
    // 5 % beyond the weakest direction is missed by 5 % exactly
    // measured: 5.9e-8 within the ball, 0.0500 beyond it
    println!("measured: miss within the ball {worst_inside:.1e}, 5 % beyond it {least_outside:.4} of the margin");
    assert!(worst_inside < 1e-6 && (least_outside - 0.05).abs() < 1e-4);
}

#[test]
fn every_facet_touches_a_vertex_and_leaves_none_outside() {
    let mut rng = Stream::new(2, 0, 0, Purpose::RESET);
    let mut worst = 0.0_f64;
    for case in 0..30 {
        let axes: &[Axis] = [&THREE[..], &Axis::STEERED[..], &Axis::ALL[..]][case % 3];
        let problem = random_problem(&mut rng, 4 + case % 5, axes);
        let n = problem.n_input();
        let corner = |bits: usize| -> Vec<f64> {
            (0..n).map(|i| if bits >> i & 1 == 1 { problem.upper[i] } else { problem.lower[i] }).collect()
        };
        let set = AttainableWrenches::of(&problem, axes).unwrap();
        let vertices: Vec<[f64; 6]> = (0..1 << n).map(|b| set.scaled(&problem.delivered(&corner(b)))).collect();
        for facet in set.facets() {
            let reach = |y: &[f64; 6]| facet.normal.iter().zip(y).map(|(a, b)| a * b).sum::<f64>();
            let support = vertices.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
            worst = worst.max((support - facet.offset).abs());
        }
    }
    // measured: 3.6e-15
    println!("worst {worst:.1e} N");
    assert!(worst < 1e-13);
}

/// A hexarotor of Du et al. (2015), table 2: 1.535 kg, arms 0.275 m, 6.125 N per rotor, κ 0.1 m; spins by letter.
fn hexarotor(spins: &str) -> (Problem, [f64; 6]) {
    let geometry = DMatrix::from_fn(6, 6, |row, i| {
        let (s, c) = (std::f64::consts::FRAC_PI_3 * i as f64).sin_cos();
        let spin = if spins.as_bytes()[i] == b'P' { 1.0 } else { -1.0 };
        [0.0, 0.0, 1.0, 0.275 * s, -0.275 * c, 0.1 * spin][row]
    });
    (Problem::boxed(geometry, [1.0; 6], vec![6.125; 6]).unwrap(), [0.0, 0.0, 1.535 * 9.8, 0.0, 0.0, 0.0])
}

fn authority_index(spins: &str, lost: Option<usize>) -> f64 {
    let (mut problem, weight) = hexarotor(spins);
    if let Some(i) = lost {
        problem.upper[i] = 0.0;
    }
    AttainableWrenches::with_length(&problem, &Axis::STEERED, 1.0).unwrap().margin(&weight).distance
}

#[test]
fn the_authority_index_of_two_hexarotors_is_the_published_one() {
    // Du et al. (2015), tables 3 and 4; they print 0 for what is not controllable
    assert!((authority_index("PNPNPN", None) - 1.4861).abs() < 5e-5);
    for i in 0..6 {
        assert!(authority_index("PNPNPN", Some(i)).abs() < 1e-12, "rotor {i}");
    }
    assert!((authority_index("PPNNPN", None) - 1.1295).abs() < 5e-5);
    for (i, index) in [0.7221, 0.4510, 0.4510, 0.7221].into_iter().enumerate() {
        let found = authority_index("PPNNPN", Some(i));
        assert!((found - index).abs() < 5e-5, "rotor {i}: {found}");
    }
    for i in [4, 5] {
        // measured: −0.2133
        assert!(authority_index("PPNNPN", Some(i)) < -0.2, "rotor {i}");
    }
}

#[test]
fn losses_end_as_the_textbooks_say() {
    for vehicle in vehicles::all() {
        let table = FailureTable::of(&vehicle).unwrap();
        assert_eq!(table.whole.capability, Capability::Full, "{}", vehicle.name);
        let strength = vehicle.max_thrust() / hover(&vehicle)[2];
        let expected = match vehicle.n_rotor() {
            // two rotors carry it, or the one across from the lost one half of it: twice the share of the weight either way
            4 if strength > 2.5 => Some(Capability::Spinning),
            4 => Some(Capability::None),
            12 => Some(Capability::Full),
            _ => None,
        };
        for a in &table.single {
            println!("{} {:?}: {:?} {:.3} {:.3}", vehicle.name, a.broken(), a.capability, a.steered, a.without_yaw);
            assert!(expected.is_none_or(|e| a.capability == e), "{} {:?}", vehicle.name, a.broken());
        }
    }
    let firefly = FailureTable::of(&vehicles::by_name("firefly").unwrap()).unwrap();
    assert_eq!(FailureTable::counts(&firefly.single), [0, 6, 0, 0]);
}

#[test]
fn a_loss_never_adds_reach() {
    for vehicle in vehicles::all() {
        let table = FailureTable::of(&vehicle).unwrap();
        let margins = |a: &Assessment| [a.steered.margin.distance, a.without_yaw.margin.distance];
        for double in &table.double {
            for i in double.broken() {
                let (both, one) = (margins(double), margins(&table.single[i]));
                let whole = margins(&table.whole);
                assert!((0..2).all(|k| both[k] <= one[k] + 1e-9 && one[k] <= whole[k] + 1e-9), "{}", vehicle.name);
            }
        }
    }
}

#[test]
fn a_flat_set_has_no_margin_and_names_the_axes_it_lost() {
    let (mut problem, weight) = hexarotor("PPPPPP");
    for j in 0..6 {
        problem.geometry[(5, j)] = 0.0;
    }
    let reach = WrenchMargin::of(&problem, &Axis::STEERED, &weight).unwrap();
    assert_eq!((reach.rank, reach.dropped.as_slice()), (3, [Axis::Yaw].as_slice()));
    assert!(reach.margin.distance.abs() < 1e-12 && reach.weakest().ends_with("yaw"), "{reach}");
    let mut twisted = weight;
    twisted[5] = 0.1;
    let beyond = WrenchMargin::of(&problem, &Axis::STEERED, &twisted).unwrap();
    assert!((beyond.margin.distance + 0.1 / beyond.length).abs() < 1e-12, "{beyond}");
    // all rotors lost: a point
    problem.upper.fill(0.0);
    let nothing = WrenchMargin::of(&problem, &Axis::STEERED, &weight).unwrap();
    assert_eq!(nothing.rank, 0);
    assert!((nothing.margin.distance + weight[2]).abs() < 1e-12, "{nothing}");
}

#[test]
fn what_cannot_be_certified_is_refused_with_a_reason() {
    let (problem, weight) = hexarotor("PNPNPN");
    let refusal = |problem: &Problem, axes: &[Axis]| AttainableWrenches::of(problem, axes).unwrap_err().to_string();
    assert!(refusal(&problem, &[]).contains("one to six different"));
    assert!(refusal(&problem, &[Axis::Yaw, Axis::Yaw]).contains("different"));
    let mut endless = problem.clone();
    endless.lower[2] = f64::NEG_INFINITY;
    assert!(refusal(&endless, &Axis::STEERED).contains("bounds of input 2"));
    let many = random_problem(&mut Stream::new(4, 0, 0, Purpose::RESET), 40, &Axis::STEERED);
    assert!(refusal(&many, &Axis::ALL).contains("over the limit of 100000"));
    assert!(WrenchMargin::of(&problem, &Axis::STEERED, &[f64::NAN; 6]).is_err());
    assert!(problem.n_input() == 6 && weight[2] > 0.0);
    let vehicle = vehicles::by_name("firefly").unwrap();
    for (failure, words) in [
        (RotorFailure::lost(6, 1.0), "0 to 5"),
        (RotorFailure::lost(0, -1.0), "≥ 0 s"),
        (RotorFailure { rotor: 0, at: 1.0, effectiveness: 1.0 }, "in [0, 1)"),
    ] {
        let plan = FlightPlan { failures: vec![failure], ..Default::default() };
        let error = fly_vehicle(&vehicle, &vehicle.gains(), &plan, &mut |_| {}).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// A hover of 20 s after the failures.
fn hovering(failures: Vec<RotorFailure>) -> FlightPlan {
    let from = failures.iter().map(|f| f.at).fold(0.0, f64::max);
    FlightPlan {
        reference: Reference::by_name("hover").unwrap(),
        duration: from + 20.0,
        failures,
        ..Default::default()
    }
}

/// Largest errors in height and across (m), tilt (°) and yaw rate (rad/s) of a flight that ended whole.
#[derive(Debug, Clone, Copy)]
struct Worst {
    height: f64,
    across: f64,
    tilt: f64,
    yaw_rate: f64,
}

impl Worst {
    fn none() -> Self {
        Self { height: 0.0, across: 0.0, tilt: 0.0, yaw_rate: 0.0 }
    }

    fn of(flight: &Flight) -> Self {
        assert_eq!(flight.diverged_at, None);
        let (log, mut w) = (&flight.log, Self::none());
        for ((e, tilt), rate) in log.tracking_error().iter().zip(log.tilt()).zip(&log.angular_velocity) {
            let now =
                Self { height: e[2].abs(), across: e[0].hypot(e[1]), tilt: tilt.to_degrees(), yaw_rate: rate[2].abs() };
            w = w.and(now);
        }
        w
    }

    fn and(self, b: Self) -> Self {
        Self {
            height: self.height.max(b.height),
            across: self.across.max(b.across),
            tilt: self.tilt.max(b.tilt),
            yaw_rate: self.yaw_rate.max(b.yaw_rate),
        }
    }

    fn is_kept(&self) -> bool {
        self.is_within(0.5, 2.0, 45.0)
    }

    /// m, m, °.
    fn is_within(&self, height: f64, across: f64, tilt: f64) -> bool {
        self.height < height && self.across < across && self.tilt < tilt
    }
}

fn flown(vehicle: &Vehicle, plan: &FlightPlan) -> Flight {
    fly_vehicle(vehicle, &vehicle.gains(), plan, &mut |_| {}).unwrap()
}

fn flown_from(vehicle: &Vehicle, plan: &FlightPlan, start: &[f64]) -> Flight {
    let plant = Plant::of_vehicle(vehicle, plan.physics).unwrap();
    let gains = vehicle.gains();
    let mut own = controller("fault_tolerant", &plant, &Setup::new(Some(&gains), &plan.rates)).unwrap();
    fly_from(&plant, &mut own, plan, start, &mut |_| {}).unwrap()
}

#[test]
fn the_firefly_hovers_on_any_five_rotors() {
    let vehicle = vehicles::by_name("firefly").unwrap();
    // measured, worst of six: 0.013 m in height, 0.027 m across, 2.5° of tilt, 0.09 rad/s of yaw
    for rotor in 0..6 {
        let worst = Worst::of(&flown(&vehicle, &hovering(vec![RotorFailure::lost(rotor, 1.0)])));
        println!("rotor {rotor}: {worst:.3?}");
        assert!(worst.is_within(0.02, 0.05, 5.0) && worst.yaw_rate < 0.15, "rotor {rotor}: {worst:?}");
    }
}

/// A start at most `size` times (0.3 m, 0.5 m/s, 20°, 1 rad/s) away from hover in each number.
fn disturbed(vehicle: &Vehicle, rng: &mut Stream, size: f64) -> Vec<f64> {
    let at = Reference::by_name("hover").unwrap().sample(0.0).position;
    let mut x = Multirotor::new(vehicle, Physics::default()).unwrap().hover_state(at).unwrap();
    for i in 0..3 {
        x[i] += size * rng.uniform(-0.3, 0.3);
        x[3 + i] += size * rng.uniform(-0.5, 0.5);
        x[10 + i] += size * rng.uniform(-1.0, 1.0);
    }
    let angles: Vec<f64> = (0..3).map(|_| size * rng.uniform(-0.35, 0.35)).collect();
    x[6..10].copy_from_slice(&omnidrones::dynamics::spatial::from_euler(angles[0], angles[1], angles[2]));
    x
}

/// A hundred starts, `size` times disturbed, a rotor lost at once and known of after `delay`: the worst of all, how many
/// kept within half a metre of height, two metres and 45°, and how many ended within half a metre of the reference.
fn hundred(vehicle: &Vehicle, size: f64, delay: f64) -> (Worst, usize, usize) {
    let mut rng = Stream::new(3, 0, 0, Purpose::RESET);
    let (mut worst, mut kept, mut back) = (Worst::none(), 0, 0);
    for _ in 0..100 {
        let start = disturbed(vehicle, &mut rng, size);
        let failures = vec![RotorFailure::lost(rng.below(vehicle.n_rotor() as u64) as usize, 0.0)];
        let plan = FlightPlan { detection_delay: delay, ..hovering(failures) };
        let flight = flown_from(vehicle, &plan, &start);
        let one = Worst::of(&flight);
        kept += usize::from(one.is_kept());
        back += usize::from(flight.log.error_norm().last().is_some_and(|e| *e < 0.5));
        worst = worst.and(one);
    }
    println!("{} {size} × disturbed, {delay} s: kept {kept}, back {back}, {worst:.3?}", vehicle.name);
    (worst, kept, back)
}

#[test]
fn a_hundred_disturbed_starts_survive_the_loss_of_a_rotor() {
    // measured, worst of a hundred, starts included: firefly 0.299 m in height, 0.581 m across, 27.4° of tilt, 1.09 rad/s of
    // yaw; neo11 0.30 m, 0.67 m, 30.4°, 1.33 rad/s; omav 0.30 m, 0.60 m, 27.4°, 0.99 rad/s
    for name in ["firefly", "neo11", "omav"] {
        let (worst, kept, back) = hundred(&vehicles::by_name(name).unwrap(), 1.0, 0.05);
        assert!(kept == 100 && back == 100, "{name}: {worst:?}");
    }
    let firefly = vehicles::by_name("firefly").unwrap();
    // known of only after 0.2 s, measured: 0.41 m, 0.60 m, 34.1°
    let (worst, kept, _) = hundred(&firefly, 1.0, 0.2);
    assert!(kept == 100, "{worst:?}");
    // three times as disturbed (60° about each axis, 3 rad/s), measured: 2.23 m, 3.42 m, 79.0°, and all come back
    let (worst, _, back) = hundred(&firefly, 3.0, 0.05);
    assert!(back == 100 && worst.height < 3.0, "{worst:?}");
}

/// Whether it holds thrust, roll and pitch at rest.
fn holds(left: &Assessment) -> bool {
    matches!(left.capability, Capability::Full | Capability::YawSacrificed)
}

#[test]
fn every_vehicle_flies_after_every_loss_that_leaves_it_capable() {
    // measured, worst of single and double losses: firefly 0.034 m in height, 0.033 m across, 2.6°, neo11 0.036 m, 0.120 m,
    // 6.2° (two rotors of one spin lost: yaw at 13.3 and 13.4 rad/s), omav 0.014 m, 0.042 m, 3.3°
    for vehicle in vehicles::all() {
        let table = FailureTable::of(&vehicle).unwrap();
        let mut worst = Worst::none();
        for a in table.single.iter().chain(&table.double).filter(|a| holds(a)) {
            let failures = a.broken().into_iter().map(|rotor| RotorFailure::lost(rotor, 1.0)).collect();
            let flight = flown(&vehicle, &hovering(failures));
            let one = Worst::of(&flight);
            println!("{} {:?} {:?}: {one:.3?}", vehicle.name, a.broken(), a.capability);
            assert!(one.is_within(0.06, 0.2, 10.0), "{} without {:?}: {one:?}", vehicle.name, a.broken());
            worst = worst.and(one);
        }
        println!("{}: {worst:.3?}", vehicle.name);
    }
}

#[test]
fn a_hexarotor_with_paired_spins_keeps_its_yaw() {
    let mut vehicle = vehicles::by_name("firefly").unwrap();
    for (rotor, spin) in vehicle.rotors.iter_mut().zip([1.0, 1.0, -1.0, -1.0, 1.0, -1.0]) {
        rotor.spin = spin;
    }
    let table = FailureTable::of(&vehicle).unwrap();
    let kept: Vec<bool> = table.single.iter().map(|a| a.capability == Capability::Full).collect();
    assert_eq!(kept, [true, true, true, true, false, false]);
    // measured, worst of four: heading off by 0.014 rad, 1.9e-4 rad after 20 s; 0.012 m in height, 0.027 m across, 2.6°
    for a in table.single.iter().filter(|a| a.capability == Capability::Full) {
        let plan = hovering(vec![RotorFailure::lost(a.broken()[0], 1.0)]);
        let flight = flown(&vehicle, &plan);
        let yaw = flight.log.euler_angles().iter().map(|e| e[2].abs()).fold(0.0, f64::max);
        let last = flight.log.euler_angles().last().unwrap()[2];
        let worst = Worst::of(&flight);
        println!("{:?}: {worst:.3?}, heading off by {yaw:.3} rad, at the end {last:.1e}", a.broken());
        assert!(worst.is_within(0.02, 0.05, 5.0) && yaw < 0.03 && last.abs() < 4e-4, "{:?}", a.broken());
    }
}

#[test]
fn a_quadrotor_with_a_rotor_at_sixty_per_cent_flies_where_that_carries_it() {
    // measured: crazyflie 0.011 m in height, 0.072 m across and 8.1°, hummingbird 0.025 m across, both with their heading;
    // iris has not the thrust for it (3.60 N of 3.73 N) and gives up yaw: 0.026 m, 0.63 rad/s
    for vehicle in vehicles::all().into_iter().filter(|v| v.n_rotor() == 4) {
        for rotor in 0..4 {
            let mut health = [1.0; 4];
            health[rotor] = 0.6;
            let left = Assessment::of(&vehicle, &health).unwrap();
            if !holds(&left) {
                println!("{} {rotor}: cannot hover", vehicle.name);
                continue;
            }
            let plan = hovering(vec![RotorFailure { rotor, at: 1.0, effectiveness: 0.6 }]);
            let flight = flown(&vehicle, &plan);
            let (worst, heading) = (Worst::of(&flight), flight.log.euler_angles().last().unwrap()[2]);
            println!("{} {rotor} {:?}: {worst:.3?}, heading {heading:.1e}", vehicle.name, left.capability);
            assert!(worst.is_within(0.02, 0.1, 15.0), "{} {rotor}: {worst:?}", vehicle.name);
        }
    }
}

#[test]
fn the_lemniscate_is_flown_on_without_a_rotor() {
    let vehicle = vehicles::by_name("firefly").unwrap();
    let plan = FlightPlan { duration: 20.0, failures: vec![RotorFailure::lost(1, 3.0)], ..Default::default() };
    let flight = flown(&vehicle, &plan);
    let rmse = flight.log.rmse(5.0).unwrap();
    // measured: 0.042 m, against 0.014 m with all six
    println!("RMSE {rmse:.4} m, {:.3?}", Worst::of(&flight));
    assert!(rmse < 0.1, "{rmse}");
}

#[test]
fn the_square_is_flown_on_without_any_rotor_whose_loss_leaves_a_vehicle_capable() {
    let reference = Reference::by_name("waypoints").unwrap();
    // measured, worst of every rotor: firefly 0.018 m in height, 0.029 m across, 16.7°; neo11 0.016 m, 0.139 m, 19.8°; omav
    // 0.010 m, 0.022 m, 16.2°
    let mut flights = 0;
    for vehicle in vehicles::all() {
        let table = FailureTable::of(&vehicle).unwrap();
        for rotor in (0..vehicle.n_rotor()).filter(|i| holds(&table.single[*i])) {
            let failures = vec![RotorFailure::lost(rotor, 3.0)];
            let plan = FlightPlan { reference: reference.clone(), failures, ..Default::default() };
            let worst = Worst::of(&flown(&vehicle, &plan));
            println!("{} without {rotor}: {worst:.3?}", vehicle.name);
            assert!(worst.is_within(0.03, 0.2, 30.0), "{} without {rotor}: {worst:?}", vehicle.name);
            flights += 1;
        }
    }
    println!("{flights} flights");
    assert!(flights >= 12, "{flights}");
}

#[test]
fn until_the_failure_the_flight_is_that_of_the_whole_vehicle_and_then_the_thrust_is_gone() {
    for vehicle in vehicles::all() {
        let whole = FlightPlan { duration: 2.0, ..Default::default() };
        let plan = FlightPlan { failures: vec![RotorFailure::lost(0, 1.0)], ..whole.clone() };
        // who flies on with what is left learns nothing on the way
        let gains = Gains { integral: [0.0; 2], ..vehicle.gains() };
        let fly = |plan| fly_vehicle(&vehicle, &gains, plan, &mut |_| {}).unwrap().log;
        let (a, b) = (fly(&whole), fly(&plan));
        // the state at the failure is still common
        assert!(a.position[..=500] == b.position[..=500] && a.rotor_speed[..=500] == b.rotor_speed[..=500]);
        assert_ne!(a.position.last(), b.position.last(), "{}", vehicle.name);
        let (n, tau) = (vehicle.n_rotor(), vehicle.rotors[0].time_constant_down);
        let thrust = |time: f64| b.thrust[(time / 0.002).round() as usize * n];
        // with the lag of the motor: e⁻² of the thrust after one time constant, nothing after ten
        let left = thrust(1.0 + tau) / thrust(1.0);
        // measured: 0.125 to 0.139; the step's grid and the command in force move it from e⁻² = 0.135
        println!("{}: {left:.3} of the thrust after τ", vehicle.name);
        assert!(left > 0.08 && left < 0.25 && thrust(1.0 + 10.0 * tau) < 2e-4 * vehicle.rotors[0].max_thrust());
    }
}

#[test]
fn every_level_of_control_carries_on() {
    let vehicle = vehicles::by_name("firefly").unwrap();
    let mut health = vec![1.0; 6];
    health[2] = 0.0;
    let whole = Multirotor::new(&vehicle, Physics::default()).unwrap();
    let plant = Multirotor::new(&damaged(&vehicle, &health), Physics::default()).unwrap();
    let weight = hover(&vehicle)[2];
    for level in ["velocity", "attitude", "rate"] {
        let mut controller = FaultTolerant::new(&vehicle, &vehicle.gains(), &Rates::default(), 0.002).unwrap();
        controller.tell(&health).unwrap();
        let mut x = whole.hover_state([0.0, 0.0, 10.0]).unwrap();
        x[10] = 0.5;
        let mut next = x.clone();
        for _ in 0..1000 {
            let seen = Kinematics::read(&x);
            let actions = match level {
                "velocity" => controller.velocity(&seen, &VelocityCommand::constant([0.5, 0.0, 0.0], 0.0)),
                "attitude" => controller.attitude(&seen, &AttitudeCommand::level(weight)),
                _ => controller.rate(&seen, &RateCommand::constant(weight, [0.0; 3])),
            };
            plant.step(&x, &actions[..6], &[], &mut next);
            std::mem::swap(&mut x, &mut next);
        }
        let tilt = omnidrones::dynamics::spatial::up_axis([x[6], x[7], x[8], x[9]])[2].acos();
        println!("{level}: velocity {:.3?}, tilt {tilt:.4}, rates {:.4?}", &x[3..6], &x[10..13]);
        // measured: 0.506 m/s of 0.5; tilt below 5e-5; rates of 0.0015 rad/s at a tilt of 0.032
        let good = match level {
            "velocity" => (x[3] - 0.5).abs() < 0.012 && x[4].abs() < 0.012 && x[5].abs() < 0.012,
            "attitude" => tilt < 2e-4,
            _ => x[10].hypot(x[11]) < 0.004 && tilt < 0.06,
        };
        assert!(good, "{level}: {x:?}");
        let counts = controller.counts().unwrap();
        assert_eq!((counts.of(Solver::Held), counts.of(Solver::Clarabel)), (0, 0), "{counts:?}");
    }
}

#[test]
fn the_thrust_is_steered_while_the_body_spins() {
    let vehicle = vehicles::by_name("firefly").unwrap();
    // measured: 8.3 to 8.5° of tilt, 0.022 m in height, never farther than the start; 1.3 rad/s are left of 15 after 20 s.
    // Without the lead for the motors' lag 15 rad/s end 76 m low, without the turning of the rate command 9 m low
    for spin in [5.0, 10.0, 15.0] {
        let at = Reference::by_name("hover").unwrap().sample(0.0).position;
        let mut x =
            Multirotor::new(&vehicle, Physics::default()).unwrap().hover_state([at[0] + 0.5, at[1], at[2]]).unwrap();
        x[12] = spin;
        let plan = hovering(vec![RotorFailure::lost(0, 0.0)]);
        let flight = flown_from(&vehicle, &plan, &x);
        let worst = Worst::of(&flight);
        let last = flight.log.angular_velocity.last().unwrap()[2];
        println!("{spin} rad/s: {worst:.3?}, {last:.2} rad/s after 20 s");
        assert!(worst.is_within(0.04, 0.55, 15.0), "{spin} rad/s: {worst:?}");
    }
}

#[test]
fn a_quadrotor_flies_on_three_rotors() {
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    for rotor in 0..4 {
        let flight = flown(&vehicle, &hovering(vec![RotorFailure::lost(rotor, 1.0)]));
        let (worst, left) = (Worst::of(&flight), flight.log.error_norm());
        let (last, lap) = (*left.last().unwrap(), flight.log.angular_velocity.last().unwrap()[2]);
        println!("without {rotor}: {worst:.3?}, at last {last:.4} m off, {lap:.2} rad/s");
        // measured: 0.78 m in height and 1.08 m across while it gathers its rate, 41°; 9 mm off at last, at 15.9 rad/s
        assert!(worst.height < 1.0 && worst.across < 1.5 && worst.tilt < 50.0, "without {rotor}: {worst:?}");
        assert!(last < 0.02 && (lap.abs() - 15.9).abs() < 0.5, "without {rotor}: {last} m, {lap} rad/s");
    }
}

#[test]
fn what_is_said_to_fly_while_it_spins_does() {
    let mut n = 0;
    for vehicle in vehicles::all() {
        let table = FailureTable::of(&vehicle).unwrap();
        for left in table.single.iter().chain(&table.double).filter(|a| a.spin.is_some()) {
            let failures = left.broken().into_iter().map(|rotor| RotorFailure::lost(rotor, 1.0)).collect();
            let flight = flown(&vehicle, &hovering(failures));
            let off = *flight.log.error_norm().last().unwrap();
            println!("{} without {:?}: {off:.4} m off at last", vehicle.name, left.broken());
            // measured: 9 mm
            assert!(off < 0.02, "{} without {:?}: {off} m", vehicle.name, left.broken());
            n += 1;
        }
    }
    assert!(n >= 4, "{n}");
}

/// A body whose moments across z are unlike has products of inertia in axes that are turned about z.
#[test]
fn a_spin_does_not_depend_on_the_axes_in_which_a_body_is_described() {
    for (x, y) in [(0.0056, 0.007), (0.006, 0.008), (0.008, 0.006), (0.005, 0.009)] {
        let mut own = vehicles::by_name("hummingbird").unwrap();
        (own.parts[0].inertia.xx, own.parts[0].inertia.yy) = (x, y);
        for lost in [0, 1] {
            let health: Vec<f64> = (0..4).map(|i| f64::from(u8::from(i != lost))).collect();
            let spin = |vehicle: &Vehicle| Assessment::of(vehicle, &health).unwrap().spin.expect("a spin");
            let level = spin(&own);
            for yaw in [0.1, FRAC_PI_4, 2.0] {
                let turned = own.turned(from_euler(0.0, 0.0, yaw));
                let off = (spin(&turned).rate / level.rate - 1.0).abs();
                // measured: 3e-7, the accuracy of a cone program
                assert!(off < 1e-5, "{x} {y} without {lost}, turned by {yaw}: {off:e}");
                if yaw == FRAC_PI_4 {
                    let (_, trim) = trim_damaged(&turned, Physics::default(), &health, &TrimTarget::hover()).unwrap();
                    assert!(trim.residual < 1e-8, "{trim:?}");
                    let flight = flown(&turned, &hovering(vec![RotorFailure::lost(lost, 1.0)]));
                    let off = *flight.log.error_norm().last().unwrap();
                    // measured: 14 mm
                    assert!(off < 0.02, "{x} {y} without {lost}: {off} m");
                }
            }
        }
    }
}

/// What is told to carry it does, wherever the load is: upright with next to no room, a Hummingbird whose load is 5 mm off was lost.
#[test]
fn a_load_off_the_centre_is_flown_on_three_rotors_where_a_way_is_told() {
    let mut told = 0;
    for millimetres in [0.0, 2.0, 5.0, 10.0, 20.0] {
        let mut vehicle = vehicles::by_name("hummingbird").unwrap();
        vehicle.parts[0].position[0] += 1e-3 * millimetres;
        for lost in [0, 1, 2] {
            let health: Vec<f64> = (0..4).map(|i| f64::from(u8::from(i != lost))).collect();
            let left = Assessment::of(&vehicle, &health).unwrap();
            let flight = flown(&vehicle, &hovering(vec![RotorFailure::lost(lost, 1.0)]));
            let off = *flight.log.error_norm().last().unwrap();
            println!("{millimetres} mm, without {lost}: {:?}, {:.3}, {off:.3} m", left.capability, left.without_yaw);
            if left.capability != Capability::None {
                told += 1;
                assert!(off < 0.1, "{millimetres} mm, without {lost}: {:?} {off} m", left.capability);
            }
        }
    }
    assert!(told >= 8, "{told}");
}

#[test]
fn a_quadrotor_on_three_rotors_comes_back_from_disturbed_starts() {
    let (worst, _, back) = hundred(&vehicles::by_name("hummingbird").unwrap(), 1.0, 0.05);
    // measured: all, having lost 3.8 m of height and gone 2.3 m aside at most
    assert!(back >= 98 && worst.height < 6.0, "{back} of 100, {worst:?}");
}

#[test]
fn where_hover_is_impossible_the_flight_still_ends_in_order() {
    let iris = vehicles::by_name("iris").unwrap();
    let left = Assessment::of(&iris, &[0.0, 1.0, 1.0, 1.0]).unwrap();
    assert_eq!((left.capability, left.lift), (Capability::None, 0.0));
    // measured: −2.24 N of a weight of 14.9 N
    assert!(left.without_yaw.margin.distance < -LEAST_MARGIN * hover(&iris)[2]);
    // it falls: no error, no panic
    let flight = flown(&iris, &hovering(vec![RotorFailure::lost(0, 1.0)]));
    assert!(flight.log.len() > 500);
}
