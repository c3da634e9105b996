//! Controllers at the limits of their rotors: the references of a published comparison, and starts from any attitude.

use omnidrones::controllers::reference::{Circle, Ellipse, Hover, Reference};
use omnidrones::controllers::registry::{Setup, controller};
use omnidrones::controllers::tracking::{Tracking, TrackingCondition, physics, quadrotor, rates};
use omnidrones::controllers::{ClosedLoop, FlightPlan, Outside, Rates, Target, fly, fly_from, start_on};
use omnidrones::dynamics::spatial::{exponential, multiply, to_euler};
use omnidrones::dynamics::{Disturbance, Physics, Plant, vehicles};
use omnidrones::parallel::Threads;
use std::f64::consts::PI;

#[test]
fn sixty_three_of_the_hundred_and_forty_four_references_are_within_the_rotors_limits() {
    let benchmark = Tracking::new(&Threads::default()).unwrap();
    let (cells, feasible): (Vec<_>, Vec<bool>) = benchmark.cells().iter().copied().unzip();
    let level = cells.iter().zip(&feasible).filter(|(cell, f)| !cell.standing && **f).count();
    println!("{} of {}, {level} of the level ones", feasible.iter().filter(|f| **f).count(), cells.len());
    assert_eq!((cells.len(), feasible.iter().filter(|f| **f).count(), level), (144, 63, 36));
    // by hand: a level circle of 10 m/s² at 20 m/s asks for √(10² + 9.81²) and drag of 7 m/s² with a thrust of 45
    assert!(feasible[9] && cells[9].speed == 20.0 && cells[9].ratio == 1.0);
    let fastest = cells.iter().position(|c| c.acceleration == 60.0 && c.ratio == 1.0).unwrap();
    assert!(!feasible[fastest], "60 m/s² are more than 45");
}

/// Published, over 76 references that the paper calls feasible and does not name: 0.084 m, with INDI 0.085 m; under the moment 4.949 m
/// without INDI.
#[test]
fn indi_tracks_what_the_rotors_can_fly_within_four_centimetres_and_a_moment_does_not_show() {
    let threads = Threads::default();
    let benchmark = Tracking::new(&threads).unwrap();
    let [nominal, pushed] = [TrackingCondition::Nominal, TrackingCondition::Moment]
        .map(|condition| benchmark.fly("indi", condition, &threads).unwrap());
    let feasible = [&nominal, &pushed].map(|row| row.mean_rmse(|f| f.feasible).unwrap());
    let crashed = [&nominal, &pushed].map(|row| (row.crashes(|f| f.feasible).0, row.crashes(|_| true).0));
    let all = nominal.mean_rmse(|_| true).unwrap();
    println!("{feasible:.4?} m, crashed {crashed:.3?}, all {all:.3} m");
    // measured: 0.038 and 0.041 m
    assert!(feasible[0] < 0.042 && feasible[1] < 0.046);
    assert_eq!([crashed[0].0, crashed[1].0], [0, 0], "of the feasible references none is lost");
    // measured: 1, and 0.680 m of the others
    assert!(crashed[0].1 <= 2 && all < 0.75, "{} of all crashed, {all} m", crashed[0].1);
}

#[test]
fn indi_follows_a_reference_that_falls_faster_than_a_stone() {
    // at the top of this loop the thrust points down: v²/r = 20 m/s² > g
    let (vehicle, radius) = (quadrotor(), 5.0);
    let reference = Reference::Ellipse(Ellipse {
        center: [0.0, 0.0, 20.0],
        half_axes: [radius, radius],
        rate: 2.0,
        spin_up: 4.0,
        standing: true,
        yaw: 0.0,
    });
    let plant = Plant::of_vehicle(&vehicle, physics()).unwrap();
    let plan = FlightPlan { reference, duration: 12.0, physics: physics(), rates: rates(), ..FlightPlan::default() };
    let rates = rates();
    let flown = |name: &str| {
        let mut law = controller(name, &plant, &Setup::new(None, &rates)).unwrap();
        fly(&plant, &mut law, &plan, &mut |_| {}).unwrap()
    };
    let flight = flown("indi");
    let rmse = flight.log.rmse(4.0).unwrap();
    let up = |q: &[f64; 4]| 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
    let lowest = flight.log.attitude.iter().map(up).fold(1.0, f64::min);
    println!(
        "{rmse:.3} m, body z at least {lowest:.2} upwards; under the cascade {:.2?} m",
        flown("cascade").log.rmse(4.0)
    );
    // measured: 0.036 m and −1.00
    assert!(rmse < 0.06 && lowest < -0.9, "{rmse} m, {lowest}");
}

#[test]
fn indi_brings_every_vehicle_back_from_every_tilt_at_rest() {
    let physics = Physics::default();
    for vehicle in vehicles::all() {
        let plant = Plant::of_vehicle(&vehicle, physics).unwrap();
        let reference = Reference::Hover(Hover { position: [0.0, 0.0, 50.0], yaw: 0.0 });
        let plan = FlightPlan { reference: reference.clone(), duration: 15.0, ..FlightPlan::default() };
        let mut worst = 0.0_f64;
        let (mut sunk, mut turned_away) = (0.0_f64, 0.0_f64);
        for (k, tilt) in [60.0, 120.0, 180.0].into_iter().enumerate() {
            let mut law = controller("indi", &plant, &Setup::new(None, &Rates::default())).unwrap();
            let mut start = start_on(&plant, &law, &reference).unwrap();
            // about x, a diagonal and y, and turned to the left, not, and to the right
            let axis = [[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 1.0, 0.0]][k];
            let turned = exponential([0.0, 0.0, [2.0, 0.0, -2.0][k]]);
            let tilted = exponential(axis.map(|a| a * tilt / 180.0 * PI));
            start[6..10].copy_from_slice(&multiply(turned, tilted));
            let flight = fly_from(&plant, &mut law, &plan, &start, &mut |_| {}).unwrap();
            let left = flight.log.error_norm().last().copied().unwrap();
            worst = worst.max(left);
            let heading = to_euler(*flight.log.attitude.last().unwrap())[2];
            turned_away = turned_away.max(heading.abs());
            if tilt == 60.0 {
                sunk = flight.log.position.iter().map(|p| 50.0 - p[2]).fold(0.0, f64::max);
            }
        }
        println!("{}: {worst:.1e} m, {turned_away:.1e} rad left, from 60° {sunk:.2} m lost", vehicle.name);
        // measured: 1.0e-4 m (neo11), 9.6e-7 rad (hummingbird)
        assert!(worst < 1e-3 && turned_away < 3e-5, "{}: {worst} m, {turned_away} rad", vehicle.name);
    }
}

#[test]
fn indi_holds_under_a_moment_without_integral_action_where_the_cascade_does_not() {
    let mut physics = Physics::default();
    physics.effects.disturbance = true;
    let reference = Reference::Circle(Circle { rate: 0.0, ..Circle::default() });
    for vehicle in vehicles::all().into_iter().filter(|v| v.thrust_to_weight() > 1.8) {
        let plant = Plant::of_vehicle(&vehicle, physics).unwrap();
        let arm = vehicle.rotors.iter().map(|r| r.position[0].hypot(r.position[1])).fold(0.0, f64::max);
        let moment = [0.05 * vehicle.max_thrust() * arm, 0.0, 0.0];
        let air = Disturbance { moment, ..Disturbance::none() };
        let mut gains = vehicle.gains();
        gains.integral = [0.0; 2];
        let after = |name: &str, gains: &omnidrones::dynamics::Gains| {
            let law = controller(name, &plant, &Setup::new(Some(gains), &Rates::default())).unwrap();
            let mut state = start_on(&plant, &law, &reference).unwrap();
            let mut next = state.clone();
            let mut system = ClosedLoop::new(plant.clone(), law).unwrap();
            for _ in 0..2500 {
                system.advance(&state, Target::level(&reference), &Outside::air(air), &mut next).unwrap();
                std::mem::swap(&mut state, &mut next);
            }
            let wanted = reference.sample(5.0).position;
            (0..3).map(|k| (state[k] - wanted[k]).powi(2)).sum::<f64>().sqrt()
        };
        let [held, plain] = ["indi", "cascade"].map(|name| after(name, &gains));
        println!("{}: {:.1} mm under indi, {:.1} mm under the cascade", vehicle.name, 1e3 * held, 1e3 * plain);
        // measured: 0.5 mm of 384 mm (neo11), 0.1 mm and less elsewhere
        assert!(held < 0.001 && held < 0.01 * plain, "{}: {held} {plain}", vehicle.name);
    }
}
