//! Several vehicles in each other's downwash.

use crate::common::measure::larger;
use omnidrones::autodiff::{CertificateBounds, System, certify, linearise};
use omnidrones::dynamics::{Downwash, Effects, Fleet, GRAVITY, Multirotor, Physics, vehicles};

const N: usize = 17;

fn bare() -> Physics {
    Physics { effects: Effects::none(), ..Physics::default() }
}

fn pair(downwash: Option<Downwash>) -> Fleet {
    Fleet::copies(&vehicles::by_name("hummingbird").unwrap(), 2, bare(), downwash).unwrap()
}

#[test]
fn a_drone_a_metre_under_another_loses_height_by_the_closed_form_force() {
    let fleet = pair(Some(Downwash::default()));
    let mut x = fleet.hover_state(&[[0.3, -0.2, 2.0], [0.3, -0.2, 1.0]]).unwrap();
    let u = fleet.hover_input().unwrap();
    let mut next = x.clone();
    let dt = bare().dt;
    // both weigh the same: the upper thrust is m g, so the lower one falls with g/(1 + 0.3 d)², held for dt at a time
    let (mut height, mut velocity) = (1.0_f64, 0.0);
    let mut worst = 0.0_f64;
    for _ in 0..250 {
        let acceleration = -GRAVITY / (1.0 + 0.3 * (2.0 - height)).powi(2);
        height += velocity * dt + 0.5 * acceleration * dt * dt;
        velocity += acceleration * dt;
        fleet.step(&x, &u, &[], &mut next);
        std::mem::swap(&mut x, &mut next);
        worst = larger(larger(worst, (x[N + 2] - height).abs()), (x[N + 5] - velocity).abs());
    }
    assert!(worst < 1e-12, "{worst:e}"); // measured 2.7e-15
    assert!(height < 0.5, "half a second under a wake costs more than half a metre: {height}");
    let upper = (x[2] - 2.0).abs().max(x[5].abs());
    assert!(upper < 1e-12, "the upper one must not notice: {upper:e}"); // measured 1.8e-15
}

#[test]
fn without_downwash_each_drone_flies_bit_for_bit_as_if_alone() {
    for vehicle in vehicles::all() {
        let physics = Physics::default();
        let fleet = Fleet::copies(&vehicle, 3, physics, None).unwrap();
        let alone = Multirotor::new(&vehicle, physics).unwrap();
        let mut r = crate::common::stream(1, 0);
        let states: Vec<Vec<f64>> = (0..3).map(|_| crate::common::state(&vehicle, &mut r)).collect();
        let inputs: Vec<Vec<f64>> = (0..3).map(|_| crate::common::input(&vehicle, &physics, &mut r)).collect();
        let mut together = states.concat();
        fleet.step(&states.concat(), &inputs.concat(), &[], &mut together);
        for (k, got) in together.chunks(alone.n_state()).enumerate() {
            let mut want = states[k].clone();
            alone.step(&states[k], &inputs[k], &[], &mut want);
            assert_eq!(got, want, "{} number {k}", vehicle.name);
        }
    }
}

#[test]
fn with_downwash_the_same_drones_do_not_fly_as_if_alone() {
    // the twin of the test above: the coupling is there
    let (on, off) = (pair(Some(Downwash::default())), pair(None));
    let x = on.hover_state(&[[0.0, 0.0, 2.0], [0.0, 0.0, 1.0]]).unwrap();
    let u = on.hover_input().unwrap();
    let (mut a, mut b) = (x.clone(), x.clone());
    on.step(&x, &u, &[], &mut a);
    off.step(&x, &u, &[], &mut b);
    assert!(a[N + 5] < b[N + 5] - 0.01, "{} against {}", a[N + 5], b[N + 5]);
}

#[test]
fn coincident_drones_have_finite_values_and_gradients() {
    let fleet = pair(Some(Downwash::default()));
    let mut still = fleet.hover_state(&[[0.0; 3]; 2]).unwrap();
    let hovering = still.clone();
    for k in 0..2 {
        still[k * N + 13..(k + 1) * N].fill(0.0);
    }
    let u = fleet.hover_input().unwrap();
    for x in [hovering, still] {
        let l = linearise(&fleet, &x, &u, &[]);
        let all = l.next.iter().chain(l.state.iter()).chain(l.input.iter());
        assert!(all.copied().all(f64::is_finite));
        let certificate = certify(&fleet, &x, &u, &[]).unwrap();
        assert!(certificate.adjoint_error <= 1e-12, "{certificate}"); // measured 9.5e-16
    }
}

#[test]
fn the_gradient_certificate_holds_for_three_drones_of_each_kind_in_each_others_wakes() {
    let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
    for (case, vehicle) in vehicles::all().iter().enumerate() {
        for integrator in crate::common::INTEGRATORS {
            let physics = Physics { integrator, ..Physics::default() };
            let fleet = Fleet::copies(vehicle, 3, physics, Some(Downwash::default())).unwrap();
            let mut r = crate::common::stream(2, case as u64);
            let mut x = Vec::new();
            let mut u = Vec::new();
            for k in 0..3 {
                let mut own = crate::common::state(vehicle, &mut r);
                let place = [0.1 * f64::from(k), -0.05 * f64::from(k), 2.0 + 0.6 * f64::from(k)];
                own[..3].copy_from_slice(&place);
                own[6..10].copy_from_slice(&[0.98, 0.1, -0.13, 0.1068]);
                x.extend(own);
                u.extend(crate::common::input(vehicle, &physics, &mut r));
            }
            let c = certify(&fleet, &x, &u, &[]).unwrap();
            assert!(c.holds(CertificateBounds::default()), "{} {integrator:?}: {c}", vehicle.name);
            worst.0 = worst.0.max(c.adjoint_error);
            worst.1 = worst.1.max(c.difference_error);
            worst.2 = worst.2.max(c.taylor_order.map_or(0.0, |order| (order - 2.0).abs()));
        }
    }
    println!("adjoint {:.1e}, difference {:.1e}, Taylor order off by {:.3}", worst.0, worst.1, worst.2);
    // measured: adjoint 1.9e-15 (bound 1e-10), difference 4.9e-8 (1e-6), Taylor order off by 0.019 (0.1)
}

#[test]
fn a_fleet_that_cannot_be_is_an_error() {
    let vehicle = vehicles::by_name("crazyflie").unwrap();
    assert!(Fleet::copies(&vehicle, 0, bare(), None).is_err());
    assert!(Fleet::copies(&vehicle, usize::MAX, bare(), None).is_err());
    assert!(Fleet::copies(&vehicle, 2, bare(), Some(Downwash { radial: f64::NAN, axial: 0.3 })).is_err());
    assert!(Fleet::copies(&vehicle, 2, bare(), Some(Downwash { radial: 2.0, axial: -0.3 })).is_err());
    let fleet = Fleet::copies(&vehicle, 2, bare(), None).unwrap();
    assert!(fleet.hover_state(&[[0.0; 3]]).is_err());
}
