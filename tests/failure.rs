//! Rotors that fail: what is left by analysis, and that what is left flies.
use omnidrones::controllers::allocation::failure::{hover, problem};
use omnidrones::controllers::{Assessment, Axis, FailureTable, Capability, Failure, Flight, FlightPlan, Reference, fly, fly_from};
use omnidrones::dynamics::{Vehicle, vehicles};

#[test]
fn explore() {
    for vehicle in vehicles::all() {
        let t = FailureTable::of(&vehicle).unwrap();
        let w = hover(&vehicle)[2];
        println!("== {} weight {w:.3}  whole {:.3} / {:.3} lift {:.2}", vehicle.name, t.whole.steered.margin.distance, t.whole.without_yaw.margin.distance, t.whole.lift / w);
        for a in t.single.iter().chain(&t.double) {
            println!("  {:?} {:?} 4: {} | 3: {} lift {:.2}", a.broken(), a.capability, a.steered, a.without_yaw, a.lift / w);
        }
    }
    for vehicle in vehicles::all() {
        let t = FailureTable::of(&vehicle).unwrap();
        for a in t.single.iter().chain(&t.double).filter(|a| a.capability != Capability::None) {
            let failures = a.broken().iter().map(|r| Failure::lost(*r, 1.0)).collect();
            let plan = FlightPlan { reference: Reference::by_name("hover").unwrap(), duration: 21.0, failures, ..Default::default() };
            let start = std::time::Instant::now();
            let f = fly(&vehicle, &vehicle.gains(), &plan, &mut |_| {}).unwrap();
            let h = |s: &dyn Fn(&[f64; 3]) -> f64| f.log.tracking_error().iter().map(|e| s(e)).fold(0.0, f64::max);
            let yaw = f.log.angular_velocity.iter().fold(0.0_f64, |m, w| m.max(w[2].abs()));
            println!("{} {:?} {:?}: dz {:.3} dxy {:.3} tilt {:.1} yaw rate {:.2} end {:.2}, div {:?} in {:?}", vehicle.name, a.broken(), a.capability,
                h(&|e| e[2].abs()), h(&|e| e[0].hypot(e[1])), f.log.summary(0.0).max_tilt.unwrap().to_degrees(), yaw, f.log.angular_velocity.last().unwrap()[2], f.diverged_at, start.elapsed());
        }
    }
}
