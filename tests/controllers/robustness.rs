//! A loop over a box of plants: the share of stable ones, and the least margin in it.

use omnidrones::controllers::design::robustness::robustness;
use omnidrones::controllers::design::{MarginFailure, MarginGate, PlantUncertainty, Robustness};
use omnidrones::controllers::{MonteCarloResult, MonteCarloSummary, Rates};
use omnidrones::dynamics::{Disturbance, Physics, vehicles};
use omnidrones::parallel::Threads;

fn judged(name: &str, latency: usize, plants: &PlantUncertainty, threads: usize) -> Robustness {
    let vehicle = vehicles::by_name(name).unwrap();
    let flown = (&Physics::default(), &Rates::default(), &[][..]);
    let threads = Threads::new(threads).unwrap();
    robustness(&vehicle, &vehicle.gains(), flown, (latency, &Disturbance::none()), plants, &threads).unwrap()
}

#[test]
fn a_box_of_plants_has_a_share_of_stable_ones_and_a_least_margin_whatever_the_threads() {
    let plants = PlantUncertainty { samples: 20, ..PlantUncertainty::default() };
    let found = judged("hummingbird", 0, &plants, 2);
    println!("{found:?}");
    assert_eq!(found, judged("hummingbird", 0, &plants, 1));
    assert_eq!((found.stable.hits, found.stable.n, found.stable.bounds[1]), (20, 20, 1.0));
    assert!((found.stable.bounds[0] - 0.025_f64.powf(0.05)).abs() < 1e-9, "20 of 20: (α/2)^(1/n) from below");
    assert!(found.worst.disk <= found.corner.disk && found.corner.disk < found.nominal.disk);
    // the corners are those of the gate
    let gate = MarginGate { speeds: vec![0.0], ..MarginGate::default() };
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let by_gate =
        gate.judge(&vehicle, &vehicle.gains(), &Physics::default(), &Rates::default(), &Threads::default()).unwrap();
    assert_eq!((by_gate.corners[by_gate.worst].0, by_gate.least()), (found.corner.plant, found.corner.disk));
    assert!(by_gate.flaws.is_empty());
}

#[test]
fn plants_that_are_not_stable_are_counted_and_named_with_what_is_wrong() {
    // 44 ms late: what the believed plant just does not bear
    let found = judged("hummingbird", 22, &PlantUncertainty { samples: 12, ..PlantUncertainty::default() }, 2);
    println!("{:?}\n{:?}\n{:?}", found.stable, found.unstable, found.worst);
    let one = found.unstable.unwrap();
    assert!(found.stable.hits < 12 && one.disk == 0.0 && found.worst.disk == 0.0);
    assert!(
        matches!(one.flaw, Some(MarginFailure::Unstable { growth, frequency }) if growth > 0.0 && frequency > 0.0),
        "{one:?}"
    );
}

#[test]
fn a_centre_of_mass_that_lies_off_takes_margin() {
    let still = PlantUncertainty { spread: 0.0, samples: 1, ..PlantUncertainty::default() };
    let [at, off] = [0.0, 0.03].map(|shift| judged("hummingbird", 0, &PlantUncertainty { shift, ..still }, 2));
    println!("{:.4} → {:.4} at {:?}", at.worst.disk, off.worst.disk, off.worst.plant);
    assert_eq!(at.n_judged, 2);
    assert!(off.worst.disk < at.worst.disk && off.worst.plant.shift != [0.0; 2]);
}

#[test]
fn a_summary_of_many_flights_bounds_the_share_that_was_lost() {
    let flight = |i: usize| MonteCarloResult {
        flight: i,
        rmse: i as f64,
        worst: 0.0,
        tilt: 0.0,
        lost_at: (i >= 98).then_some(1.0),
    };
    let all = MonteCarloSummary::of(&(0..100).map(flight).collect::<Vec<_>>(), 0.95);
    println!("{all:?}");
    assert_eq!((all.lost.hits, all.lost.n), (2, 100));
    // scipy.stats.beta.ppf(0.025, 2, 99), beta.ppf(0.975, 3, 98)
    assert!((all.lost.bounds[0] - 0.002_431_3).abs() < 1e-6 && (all.lost.bounds[1] - 0.070_383_9).abs() < 1e-6);
    assert_eq!((all.median.value, all.median.bounds), (49.0, [39.0, 60.0]));
    assert!(all.percentile_95.value == 94.0 && all.percentile_95.bounds[1].is_infinite());
}
