//! Drones that carry a ball on cables, which go slack.
//!
//! ```text
//!   drone_0   drone_1        one drone carries it straight below
//!        ╲     ╱
//!        payload             cables end at its centre
//! ```
//!
//! | constant | value | source |
//! |---|---|---|
//! | payload | ball of radius 0.04 m, 0.3 kg | OmniDrones `envs/payload/utils.py`, as the payload on a bar |
//! | cable | 1 m, without mass | its bar's length |
//! | cable | 2 kN/m (1.5 mm under the ball), dissipation 1 s/m | our assumption |
//! | drone | Hummingbird | the paper's |
//!
//! Unlike the bar of [`Payload`](super::Payload), a cable pulls and never pushes, and lets the drone turn freely.

use super::configuration::{Configuration, DroneMap};
use crate::GRAVITY;
use crate::assembly::{Assembly, Member, Solid, group, single};
use crate::tree::{CABLE_ROUND, Cable, CableEnd};
use crate::vehicle::Vehicle;
use crate::vehicles::hummingbird;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Most drones on one load.
const MAX_DRONES: usize = 8;

with_defaults! {
    /// Parameters; `Default` is one drone.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SlungLoad {
        /// What carries it, at every cable.
        pub drone: Vehicle = hummingbird(),
        /// How many of them, on a circle.
        pub n_drone: usize = 1,
        /// Of the cables, from a drone's origin to the ball's centre, m.
        pub length: f64 = 1.0,
        /// Of the cables at rest from the vertical, rad; one alone hangs straight.
        pub spread: f64 = 0.6,
        /// k, N/m.
        pub stiffness: f64 = 2000.0,
        /// d, s/m.
        pub dissipation: f64 = 1.0,
        /// Of the ball, m.
        pub payload_radius: f64 = 0.04,
        /// kg.
        pub payload_mass: f64 = 0.3,
    }
}

/// Names as numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlungLoadMap {
    /// The vehicles, each the root of a tree.
    pub drones: Vec<DroneMap>,
    /// Body of the ball, root of the last tree.
    pub payload: usize,
}

impl SlungLoad {
    /// The model `slung_load`, or `slung_load_3` with three: drones `drone_0` …, then the `payload`, with `cable_0` … between them. At rest
    /// the ball hangs as it does in hover.
    ///
    /// # Errors
    /// [`Error::Limit`] for no drone or more than 8; [`Error::Value`] for a spread of 90° or more; otherwise as
    /// [`Assembly::model`] and [`Model::with_cables`](crate::tree::Model::with_cables).
    pub fn build(&self) -> Result<Configuration<SlungLoadMap>> {
        let n = self.n_drone;
        if n == 0 || n > MAX_DRONES {
            let remedy = "More do not find room at one point.";
            return Err(Error::limit("slung load: number of drones", n, format!("1 to {MAX_DRONES}"), remedy));
        }
        if !(0.0..FRAC_PI_2).contains(&self.spread) {
            let remedy = "Cables hang down from the drones.";
            return Err(Error::value("slung load: spread", self.spread, "within 0 to 90°, in rad", remedy));
        }
        let spread = if n == 1 { 0.0 } else { self.spread };
        let drone = single(&self.drone)?;
        let taut = self.length + self.stretch(GRAVITY * self.payload_mass / (n as f64 * spread.cos()));
        let at = |i: usize| {
            let (s, c) = (TAU * i as f64 / n as f64).sin_cos();
            [taut * spread.sin() * c, taut * spread.sin() * s, taut * (spread.cos() - 1.0)]
        };
        let mut members: Vec<_> = (0..n).map(|i| Member::new(format!("drone_{i}"), drone.clone(), at(i))).collect();
        let ball = Solid::sphere(self.payload_radius).mass(self.payload_mass);
        let ball = Assembly::new("payload").part("payload", ball).model()?;
        members.push(Member::new("", ball, [0.0, 0.0, -taut]));
        let name = if n == 1 { "slung_load".into() } else { format!("slung_load_{n}") };
        let apart = group(name, &members)?;
        let payload = apart.body("payload")?;
        let end = |body: usize| CableEnd { body: Some(body), point: [0.0; 3] };
        let (stiffness, dissipation) = (self.stiffness, self.dissipation);
        let cable = |(i, drone): (usize, &crate::tree::Drone)| {
            let ends = [end(drone.body), end(payload)];
            Cable { name: format!("cable_{i}"), ends, length: self.length, stiffness, dissipation }
        };
        let model = apart.with_cables(apart.drones().iter().enumerate().map(cable))?;
        let map = |drone: &crate::tree::Drone| DroneMap { body: drone.body, rotors: drone.rotors.clone() };
        let drones = model.drones().iter().map(map).collect();
        Ok(Configuration { model, map: SlungLoadMap { drones, payload } })
    }

    /// By how much a cable is stretched under a tension (N), m.
    fn stretch(&self, tension: f64) -> f64 {
        let (round, straight) = (CABLE_ROUND * self.length, tension / self.stiffness);
        if straight > 0.5 * round { straight + 0.5 * round } else { (2.0 * round * straight).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::free_motion::{energy, run};
    use crate::tree::{Multibody, cable_tensions, check_cables, model_parameter_names, momentum};
    use crate::{Effects, Integrator, Physics, World};
    use autodiff::certificate::CertificateBounds;
    use autodiff::{System, certify};

    const RK4: Integrator = Integrator::RungeKutta4;
    const SEMI: Integrator = Integrator::SemiImplicit;

    fn system(load: &SlungLoad, dt: f64, integrator: Integrator) -> Multibody {
        let physics = Physics { dt, substeps: 1, integrator, effects: Effects::none() };
        Multibody::new(&load.build().unwrap().model, physics).unwrap()
    }

    /// A ball tied to the world at a height, alone.
    fn pendulum(dissipation: f64, dt: f64, integrator: Integrator) -> Multibody {
        let ball = Assembly::new("ball").part("ball", Solid::sphere(0.04).mass(0.3)).model().unwrap();
        let ends = [CableEnd { body: None, point: [0.0; 3] }, CableEnd { body: Some(0), point: [0.0; 3] }];
        let cable = Cable { name: "cable".into(), ends, length: 1.0, stiffness: 2000.0, dissipation };
        let model = ball.with_cables([cable]).unwrap();
        Multibody::new(&model, Physics { dt, substeps: 1, integrator, effects: Effects::none() }).unwrap()
    }

    #[test]
    fn a_cable_carries_the_weight_when_taut_and_nothing_when_slack() {
        for integrator in [RK4, SEMI] {
            let system = pendulum(1.0, 0.002, integrator);
            let mut x = system.rest_state();
            x[2] = -1.0;
            run(&system, &mut x, 5.0, &mut |_| {});
            let (tension, weight) = (cable_tensions(&system, &x)[0], 0.3 * 9.81);
            // m g/k beyond half of the 2 mm over which it goes taut
            let stretch = weight / 2000.0 + 1e-3;
            println!(
                "{integrator:?}: {tension:.6} N of {weight:.6} N, stretched by {:.6} of {stretch:.6} m",
                -1.0 - x[2]
            );
            assert!((tension / weight - 1.0).abs() < 1e-4, "{tension} N against {weight} N");
            assert!((-1.0 - x[2] - stretch).abs() < 1e-6, "{}", x[2]);
            x[2] = -0.6;
            assert_eq!(cable_tensions(&system, &x), [0.0]);
        }
    }

    #[test]
    fn a_thrown_ball_flies_freely_until_its_cable_is_taut_and_then_swings_at_its_length() {
        let system = pendulum(1.0, 0.001, RK4);
        let mut x = system.rest_state();
        // from the anchor, sideways at 2 m/s: ‖(2 t, −g t²/2)‖ = 1 at the first pull
        x[3] = 2.0;
        let mut time = 0.0;
        let (mut pulled, mut longest) = (None, 0.0_f64);
        run(&system, &mut x, 6.0, &mut |x| {
            time += 0.001;
            let away = (x[0] * x[0] + x[1] * x[1] + x[2] * x[2]).sqrt();
            longest = longest.max(away);
            if pulled.is_none() {
                if cable_tensions(&system, x)[0] > 0.0 {
                    pulled = Some(time);
                } else {
                    assert!((x[0] - 2.0 * time).abs() < 1e-9 && (x[2] + 4.905 * time * time).abs() < 1e-9, "{x:?}");
                }
            }
        });
        // 4 t² + 24.06 t⁴ = 1: t = 0.3549 s
        let want = ((-4.0 + (16.0 + 4.0 * 24.059_f64).sqrt()) / (2.0 * 24.059)).sqrt();
        println!("pulled at {pulled:?} s of {want:.4} s, at most {longest:.4} m away");
        assert!((pulled.unwrap() - want).abs() < 2e-3, "{pulled:?} against {want}");
        // measured 1.0278
        assert!(longest < 1.04, "{longest}");
    }

    #[test]
    fn a_cable_without_dissipation_keeps_energy_and_one_with_it_loses_it() {
        let drift = |dt: f64| {
            let system = pendulum(0.0, dt, RK4);
            let mut x = system.rest_state();
            (x[0], x[2], x[4]) = (0.6, -0.8005, 1.0);
            let (first, mut worst) = (energy(&system, &x), 0.0_f64);
            run(&system, &mut x, 2.0, &mut |x| worst = worst.max((energy(&system, x) - first).abs()));
            worst
        };
        let (coarse, fine) = (drift(0.002), drift(0.0005));
        println!("drift {coarse:.1e} J at 2 ms, {fine:.1e} J at 0.5 ms");
        // measured 6.1e-7 and 5.8e-9: a quarter of the step, a hundredth of the error
        assert!(coarse < 2e-6 && fine < 2e-8, "{coarse}, {fine}");
        for (dt, integrator) in [(0.002, RK4), (0.004, RK4), (0.002, SEMI), (0.004, SEMI)] {
            let system = pendulum(1.0, dt, integrator);
            for speed in [0.0, 1.0, 3.0, 5.0] {
                let mut x = system.rest_state();
                (x[0], x[2], x[3]) = (0.3, 0.4, speed);
                // from one time without tension to the next: a step of first order misstates what springs store
                let (first, mut least, mut gain) = (energy(&system, &x), f64::INFINITY, f64::NEG_INFINITY);
                run(&system, &mut x, 4.0, &mut |x| {
                    if cable_tensions(&system, x)[0] == 0.0 {
                        let now = energy(&system, x);
                        gain = gain.max(now - least);
                        least = least.min(now);
                    }
                });
                assert!(gain < 2e-3, "{dt} s, {integrator:?}, {speed} m/s: gains {gain} J above {first} J");
            }
        }
    }

    #[test]
    fn cables_pull_both_ends_alike() {
        let load = SlungLoad { n_drone: 3, ..SlungLoad::default() };
        let system = system(&load, 0.002, RK4);
        let mut x = system.rest_state();
        // thrown about, without rotors: momentum changes by weight alone
        for k in 0..4 {
            x[17 * k + 3..17 * k + 6].copy_from_slice(&[1.0 - k as f64, 0.5 * k as f64, 2.0 - 2.0 * k as f64]);
        }
        x[13..17].fill(0.0);
        x[30..34].fill(0.0);
        x[47..51].fill(0.0);
        let at_first = momentum(&system, &x).linear;
        run(&system, &mut x, 1.0, &mut |_| {});
        let at_last = momentum(&system, &x).linear;
        let fall = -9.81 * system.model().mass();
        for (k, want) in [0.0, 0.0, fall].into_iter().enumerate() {
            let change = at_last[k] - at_first[k];
            assert!((change - want).abs() < 0.02, "axis {k}: {change} against {want}");
        }
    }

    #[test]
    fn the_gradient_certificate_holds_with_taut_and_slack_cables_and_their_numbers() {
        for n_drone in [1, 3] {
            let load = SlungLoad { n_drone, ..SlungLoad::default() };
            for integrator in [RK4, SEMI] {
                for lift in [0.0, 0.05] {
                    let system = system(&load, 0.002, integrator);
                    let mut x = system.rest_state();
                    let ball = 17 * n_drone;
                    (x[ball + 2], x[ball + 3]) = (x[ball + 2] + lift, 0.3);
                    let certificate = certify(&system, &x, &vec![0.2; system.n_input()], &[]).unwrap();
                    assert!(
                        certificate.holds(CertificateBounds::default()),
                        "{n_drone} drones, {integrator:?}, lifted by {lift}: {certificate:?}"
                    );
                }
            }
        }
        let names = model_parameter_names(&SlungLoad::default().build().unwrap().model);
        assert_eq!(names[names.len() - 3..], ["cable_0.length", "cable_0.stiffness", "cable_0.dissipation"]);
    }

    #[test]
    fn lanes_pull_as_single_numbers_do() {
        let system = system(&SlungLoad::default(), 0.002, RK4);
        let mut world = World::of_model(system.model(), *system.physics(), 3).unwrap();
        let mut x = system.rest_state();
        // up, so that it goes slack and taut again
        (x[20], x[22]) = (0.5, 1.5);
        let start: Vec<f32> = x.iter().map(|x| *x as f32).collect();
        (0..3).for_each(|at| world.set_state(at, &start).unwrap());
        let mut next = x.clone();
        let (mut slack, mut taut) = (0, 0);
        for _ in 0..300 {
            world.step(&[0.1; 12]).unwrap();
            system.step(&x, &[0.1; 4], &[], &mut next);
            std::mem::swap(&mut x, &mut next);
            let pulls = cable_tensions(&system, &x)[0] > 0.0;
            (slack, taut) = (slack + usize::from(!pulls), taut + usize::from(pulls));
        }
        let lane = world.state(2).unwrap();
        let worst = (0..x.len()).map(|k| (f64::from(lane[k]) - x[k]).abs() / x[k].abs().max(1.0));
        let worst = worst.fold(0.0, f64::max);
        println!("{slack} steps slack, {taut} taut, lanes off by {worst:.1e}");
        // measured 2.9e-6
        assert!(worst < 3e-5 && slack > 20 && taut > 20, "{worst}, {slack}, {taut}");
    }

    #[test]
    fn a_slung_load_hovers_where_it_is_put() {
        for n_drone in [1, 3] {
            let load = SlungLoad { n_drone, ..SlungLoad::default() };
            let system = system(&load, 0.002, RK4);
            let x = system.rest_state();
            let lift: f64 = cable_tensions(&system, &x)
                .iter()
                .map(|t| t * if n_drone == 1 { 1.0 } else { load.spread.cos() })
                .sum();
            assert!((lift / (9.81 * load.payload_mass) - 1.0).abs() < 1e-9, "{n_drone} drones: {lift} N");
        }
    }

    #[test]
    fn cables_that_cannot_be_and_steps_that_do_not_resolve_them_are_told() {
        let text = |load: &SlungLoad| load.build().unwrap_err().to_string();
        let usual = SlungLoad::default;
        assert!(text(&SlungLoad { n_drone: 0, ..usual() }).contains("number of drones is 0"));
        let long = text(&SlungLoad { length: 0.0, ..usual() });
        assert!(long.contains("cable 'cable_0': length is 0, but it must be between 0.001 and 1000"), "{long}");
        let steep = text(&SlungLoad { n_drone: 2, spread: 2.0, ..usual() });
        assert!(steep.contains("spread is 2"), "{steep}");
        let model = usual().build().unwrap().model;
        let end = CableEnd { body: Some(0), point: [0.0; 3] };
        let mut cable = model.cables()[0].clone();
        cable.name = "loop".into();
        cable.ends = [end; 2];
        let text = model.with_cables([cable.clone()]).unwrap_err().to_string();
        assert!(text.contains("cable 'loop': ends is on one body"), "{text}");
        cable.ends[1].body = Some(9);
        let text = model.with_cables([cable]).unwrap_err().to_string();
        assert!(text.contains("cable 'loop': body is 9, but it must be below 2"), "{text}");
        check_cables(&system(&usual(), 0.002, RK4)).unwrap();
        let stiff = system(&SlungLoad { stiffness: 1e6, ..usual() }, 0.004, RK4);
        let text = check_cables(&stiff).unwrap_err().to_string();
        assert!(text.starts_with("cable 'cable_0': stiffness is 1.000e6 N/m") && text.contains("0.004 s"), "{text}");
    }
}
