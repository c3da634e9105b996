//! What fails a flight however small its errors are: the ground, and a load that turned over; and what does not.

use omnidrones::controllers::flight_check::{FlightCheck, GRAZE, Mishap, check_flight};
use omnidrones::controllers::reference::{Hover, Tilt, Waypoint, Waypoints};
use omnidrones::controllers::{Flight, FlightPlan, Reference, Setup, default_controller, fly};
use omnidrones::dynamics::spatial::{exponential, multiply};
use omnidrones::dynamics::{Physics, Plant, configurations, vehicles};

fn plants() -> Vec<Plant> {
    let rigid = vehicles::all().into_iter().map(|v| Plant::of_vehicle(&v, Physics::default()).unwrap());
    rigid.chain(configurations()).collect()
}

fn configurations() -> impl Iterator<Item = Plant> {
    let flying = configurations::REGISTRY.iter().filter(|entry| entry.name != "gate");
    flying.map(|entry| Plant::of_model(&(entry.build)().unwrap(), Physics::default()).unwrap())
}

fn flown(plant: &Plant, reference: Reference, duration: f64) -> Flight {
    let plan = FlightPlan { reference, duration, physics: *plant.physics(), ..FlightPlan::default() };
    let mut controller = default_controller(plant, &Setup::new(None, &plan.rates)).unwrap();
    fly(plant, &mut *controller, &plan, &mut |_| {}).unwrap()
}

/// Two steps of a hover.
fn still(plant: &Plant, height: f64, yaw: f64) -> Flight {
    flown(plant, Reference::Hover(Hover { position: [0.5, -1.0, height], yaw }), 2.0 * plant.physics().dt)
}

fn judged(plant: &Plant, flight: &Flight) -> FlightCheck {
    check_flight(plant, flight, true).unwrap()
}

/// The flight with its last state, of every root, lowered by `by`, while the reference stays.
fn lowered(plant: &Plant, flight: &Flight, by: f64) -> Flight {
    let mut lowered = flight.clone();
    let n = flight.states.len() / flight.log.len();
    let last = flight.states.len() - n;
    plant.roots().iter().for_each(|root| lowered.states[last + root + 2] -= by);
    lowered
}

#[test]
fn below_the_ground_by_more_than_a_graze_fails_whatever_flies_and_however_it_is_turned() {
    for plant in plants() {
        for yaw in [0.0, 2.0, -2.0] {
            let flight = still(&plant, 4.0, yaw);
            let clear = judged(&plant, &flight);
            assert!(
                clear.mishaps.is_empty() && clear.lowest > 0.5 && clear.lowest < 4.0,
                "{}: {clear:?}",
                plant.name()
            );
            for below in [1e-8, 0.9 * GRAZE, 1.1 * GRAZE, 0.1, 3.4, 1e3] {
                let sunk = judged(&plant, &lowered(&plant, &flight, clear.lowest + below));
                assert!((sunk.lowest + below).abs() < 1e-6 * (1.0 + below), "{}: {sunk:?}", plant.name());
                match sunk.mishaps.as_slice() {
                    [] => assert!(below < GRAZE, "{}: {below}", plant.name()),
                    [Mishap::Ground { height, time }] => {
                        assert!(below > GRAZE && *height == sunk.lowest && *time == 2.0 * plant.physics().dt);
                    }
                    other => panic!("{}: {other:?}", plant.name()),
                }
            }
            assert!(check_flight(&plant, &lowered(&plant, &flight, 50.0), false).unwrap().mishaps.is_empty());
        }
    }
}

#[test]
fn a_vehicle_may_begin_and_end_on_the_ground_wherever_its_origin_is() {
    for vehicle in vehicles::all() {
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        for height in [0.0, 1e-8, 0.01, 0.2] {
            let flight = still(&plant, height, 0.3);
            assert_eq!(judged(&plant, &flight).mishaps, [], "{} at {height} m", vehicle.name);
            // from there it may not sink
            let least = judged(&plant, &flight).lowest;
            let sunk = judged(&plant, &lowered(&plant, &flight, least.max(0.0) + 2.0 * GRAZE));
            assert!(matches!(sunk.mishaps[..], [Mishap::Ground { .. }]), "{} at {height} m: {sunk:?}", vehicle.name);
        }
    }
    let [low, high] = [0.0, 1.0];
    let point = |time, z| Waypoint { time, position: [0.0, 0.0, z], yaw: 0.0 };
    let plant = Plant::of_vehicle(&vehicles::by_name("iris").unwrap(), Physics::default()).unwrap();
    for points in [vec![point(0.0, low), point(3.0, high)], vec![point(0.0, high), point(3.0, low)]] {
        let flight = flown(&plant, Reference::Waypoints(Waypoints::new(points).unwrap()), 3.5);
        assert_eq!(judged(&plant, &flight).mishaps, []);
    }
}

#[test]
fn a_reference_below_the_ground_is_told_as_such() {
    for plant in plants() {
        for height in [-1e-3, -0.5, -5.0, -1e5] {
            match &judged(&plant, &still(&plant, height, 1.0)).mishaps[..] {
                [Mishap::ReferenceBelowGround { height: told, time }] => {
                    assert!(*told <= height + 1e-9 && *time == 0.0, "{}: {told} of {height}", plant.name());
                }
                other => panic!("{} at {height}: {other:?}", plant.name()),
            }
        }
    }
    // what hangs a metre below its drone is in the ground before the drone is
    let payload = Plant::of_model(&configurations::by_name("payload").unwrap(), Physics::default()).unwrap();
    let mishaps = judged(&payload, &still(&payload, 0.5, 0.0)).mishaps;
    assert!(matches!(mishaps[..], [Mishap::ReferenceBelowGround { height, .. }] if height < -0.4), "{mishaps:?}");
}

/// The flight with its last root turned by `angle` about `axis`.
fn turned(plant: &Plant, flight: &Flight, axis: [f64; 3], angle: f64) -> Flight {
    let mut turned = flight.clone();
    let n = flight.states.len() / flight.log.len();
    let at = flight.states.len() - n + plant.roots()[0] + 6;
    let q = [0, 1, 2, 3].map(|k| flight.states[at + k]);
    let norm = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
    let q = multiply(exponential(axis.map(|a| a * angle / norm)), q);
    turned.states[at..at + 4].copy_from_slice(&q);
    turned
}

#[test]
fn a_load_that_leans_by_more_than_a_right_angle_has_turned_over_whichever_way() {
    for name in ["transport", "transport_6", "platform"] {
        let plant = Plant::of_model(&configurations::by_name(name).unwrap(), Physics::default()).unwrap();
        let root = plant.tree().unwrap().model().bodies()[0].name.clone();
        for yaw in [0.0, 0.7] {
            let flight = still(&plant, 9.0, yaw);
            for axis in [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, -0.9, 0.0]] {
                for degrees in [0.0, 45.0, 89.9, 90.1, 108.0, 180.0_f64] {
                    let told = judged(&plant, &turned(&plant, &flight, axis, degrees.to_radians())).mishaps;
                    let own = told.iter().find_map(|mishap| match mishap {
                        Mishap::TurnedOver { body, angle, .. } if *body == root => Some(angle.to_degrees()),
                        _ => None,
                    });
                    assert_eq!(own.is_some(), degrees > 90.0, "{name} {axis:?} {degrees}: {told:?}");
                    assert!(own.is_none_or(|angle| (angle - degrees).abs() < 1e-3), "{name} {degrees}: {own:?}");
                }
            }
            let spun = turned(&plant, &flight, [0.0, 0.0, 1.0], 3.0);
            assert_eq!(judged(&plant, &spun).mishaps, [], "{name}");
        }
    }
}

#[test]
fn a_frame_that_was_asked_to_hang_upside_down_has_not_turned_over() {
    let plant = Plant::of_model(&configurations::by_name("platform").unwrap(), Physics::default()).unwrap();
    for side in [1.0, -1.0] {
        let mut flight = turned(&plant, &still(&plant, 9.0, 0.0), [1.0, 0.0, 0.0], side * 2.5);
        assert!(!judged(&plant, &flight).mishaps.is_empty());
        let last = flight.log.len() - 1;
        flight.log.asked_angles[last] = [side * 2.6, 0.0, 0.0];
        assert_eq!(judged(&plant, &flight).mishaps, [], "{side}");
        // nor on its way there, when the tilt was asked at once
        for angle in [0.3, 1.0, 1.5, 2.0] {
            let mut begun = turned(&plant, &still(&plant, 9.0, 0.0), [1.0, 0.0, 0.0], side * angle);
            begun.log.asked_angles[last] = [side * 2.6, 0.0, 0.0];
            assert_eq!(judged(&plant, &begun).mishaps, [], "{angle}");
        }
    }
}

#[test]
fn mishaps_come_in_order_of_time_and_say_what_where_and_when() {
    let plant = Plant::of_model(&configurations::by_name("transport").unwrap(), Physics::default()).unwrap();
    let flight = still(&plant, 9.0, 0.0);
    let fallen = turned(&plant, &lowered(&plant, &flight, 9.5), [1.0, 0.0, 0.0], 2.0);
    let told: Vec<String> = judged(&plant, &fallen).mishaps.iter().map(ToString::to_string).collect();
    let all = told.join("; ");
    assert!(all.contains("went below the ground at 0.00 s") && all.contains("turned over"), "{all}");
}

/// Roll and pitch that meet at a right angle leave one of three angles unknown: what was asked has to come back from what is logged.
#[test]
fn a_platform_held_with_its_nose_up_has_not_turned_over() {
    let model = omnidrones::dynamics::configurations::by_name("omav_tilting").unwrap();
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    for (roll, pitch) in [(90.0_f64, 90.0_f64), (180.0, 90.0), (90.0, -90.0), (100.0, 89.0)] {
        let tilt = Tilt { roll: roll.to_radians(), pitch: pitch.to_radians(), ..Tilt::LEVEL };
        let reference = Reference::Hover(Hover { position: [0.0, 0.0, 3.0], yaw: 0.0 });
        let plan = FlightPlan { reference, duration: 6.0, tilt, physics: *plant.physics(), ..FlightPlan::default() };
        let mut own = default_controller(&plant, &Setup::new(None, &plan.rates)).unwrap();
        let flight = fly(&plant, &mut *own, &plan, &mut |_| {}).unwrap();
        let found = judged(&plant, &flight);
        assert!(found.mishaps.is_empty(), "{roll} {pitch}: {:?}", found.mishaps);
    }
}
