//! From which starts controllers bring vehicles back.

use omnidrones::controllers::registry::controller;
use omnidrones::controllers::{Controller, Rates, RecoveryPlan, Setup, default_controller, recovery_map};
use omnidrones::dynamics::{Physics, Plant, configurations, vehicles};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use std::f64::consts::PI;

fn by<'a>(plant: &'a Plant, name: &'a str) -> impl Fn() -> Result<Box<dyn Controller>> + Sync + 'a {
    move || controller(name, plant, &Setup::new(None, &Rates::default()))
}

#[test]
fn every_vehicle_comes_back_from_every_tilt_at_rest() {
    let plan = RecoveryPlan { rate: (0.0, 1), n: 32, duration: 10.0, ..RecoveryPlan::default() };
    for vehicle in vehicles::all() {
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        for gains in [
            vehicle.gains(),
            omnidrones::dynamics::Gains { integral: [0.0; 2], ..vehicle.gains() },
            vehicle.derived_gains(),
        ] {
            let rates = Rates::default();
            let build = || controller("cascade", &plant, &Setup::new(Some(&gains), &rates));
            let plan = RecoveryPlan { tilt: (PI / 3.0, 6), ..plan };
            let map = recovery_map(&plant, &build, &plan, &Threads::default()).unwrap();
            println!("    {:?}", map.within(PI, 0.0));
        }
        let map = recovery_map(&plant, &by(&plant, "cascade"), &plan, &Threads::default()).unwrap();
        let [sixty, all] = [PI / 3.0, PI].map(|tilt| map.within(tilt, 0.0));
        println!(
            "{} (thrust over weight {:.2}): to 60° {}/{}, {:.2} m lost, {:.1} s; to 180° {}/{}, {:.2} m lost, {:.1} s",
            vehicle.name,
            vehicle.thrust_to_weight(),
            sixty.recovered,
            sixty.n,
            sixty.sunk,
            sixty.slowest,
            all.recovered,
            all.n,
            all.sunk,
            all.slowest
        );
    }
}

#[test]
fn lanes_recover_what_single_flights_do() {
    let plan = RecoveryPlan { tilt: (PI, 3), rate: (8.0, 2), n: 12, ..RecoveryPlan::default() };
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
    for name in ["cascade", "lqr", "lqi", "fault_tolerant"] {
        let map = recovery_map(&plant, &by(&plant, name), &plan, &Threads::default()).unwrap();
        println!("{name}: {:?}", map.cells.iter().map(|c| (c.recovered, c.sunk)).collect::<Vec<_>>());
    }
}

#[test]
fn loads_come_back_too() {
    for name in ["payload", "inverted_pendulum"] {
        let plant = Plant::of_model(&configurations::by_name(name).unwrap(), Physics::default()).unwrap();
        let build = || default_controller(&plant, &Setup::new(None, &Rates::default()));
        let plan =
            RecoveryPlan { tilt: (PI / 3.0, 2), rate: (0.0, 1), n: 4, duration: 10.0, ..RecoveryPlan::default() };
        let map = recovery_map(&plant, &build, &plan, &Threads::default()).unwrap();
        println!("{name}: {:?}", map.cells);
    }
}
