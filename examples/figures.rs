//! Every kind of figure from synthetic data: `cargo run --release --example figures -- [FOLDER] [png|svg]`.
//!
//! The flight is made up (a lemniscate with a decaying start error and noise): this shows the plots, not the physics.

use omnidrones::dynamics::spatial::from_euler;
use omnidrones::error::Result;
use omnidrones::flight::{FlightLog, FlightSample};
use omnidrones_plot::flight::FlightFigures;
use omnidrones_plot::{Bar, Bars, Colour, Figure, Panel, Series};
use std::path::Path;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().unwrap_or_else(|| "out/figures".to_string());
    let extension = arguments.next().unwrap_or_else(|| "png".to_string());
    let folder = Path::new(&folder);
    for path in FlightFigures::new(&lemniscate(4, 20.0)?, 2.0).save(folder, &extension)? {
        println!("{}", path.display());
    }
    FlightFigures::new(&lemniscate(6, 8.0)?, 2.0).save(folder.join("hexarotor"), &extension)?;
    tuning_history().save(folder.join(format!("tune.{extension}")))?;
    ratios().save(folder.join(format!("bench.{extension}")))?;
    certificate().save(folder.join(format!("certificate.{extension}")))
}

/// A flight of `duration` seconds sampled at 100 Hz.
fn lemniscate(n_rotor: usize, duration: f64) -> Result<FlightLog> {
    let limit = 838.0;
    let mut log = FlightLog::new("Hummingbird", &vec![limit; n_rotor]);
    for i in 0..=(100.0 * duration) as usize {
        let t = 0.01 * i as f64;
        let noise = |k: f64| 0.006 * (17.0 * t + k).sin() * (5.3 * t + 2.0 * k).cos();
        let fade = (-2.2 * t).exp();
        let reference = [2.5 * t.sin(), 1.25 * (2.0 * t).sin(), 1.5 + 0.6 * (0.5 * t).sin()];
        let velocity = [2.5 * t.cos(), 2.5 * (2.0 * t).cos(), 0.3 * (0.5 * t).cos()];
        let acceleration = [-2.5 * t.sin(), -5.0 * (2.0 * t).sin(), -0.15 * (0.5 * t).sin()];
        let sway = [0.5 * fade, -0.35 * fade * (3.0 * t).cos(), -0.7 * fade];
        let lag = [-0.02 * velocity[0], -0.015 * velocity[1], 0.0];
        let position = [0, 1, 2].map(|k| reference[k] + sway[k] + lag[k] + noise(k as f64));
        let roll = -acceleration[1] / 9.81 + 2.0 * noise(4.0) + 0.3 * fade;
        let pitch = acceleration[0] / 9.81 + 2.0 * noise(5.0);
        let command = |r: usize| {
            let swing = 38.0 * (2.0 * t + 1.6 * r as f64).sin() + 900.0 * noise(r as f64) + 420.0 * fade;
            (430.0 + swing).clamp(0.01 * limit, limit)
        };
        let commands: Vec<f64> = (0..n_rotor).map(command).collect();
        let speeds: Vec<f64> = commands.iter().map(|c| 0.97 * c + 11.0).collect();
        let thrusts: Vec<f64> = speeds.iter().map(|s| 8.55e-6 * s * s).collect();
        log.push(FlightSample {
            time: t,
            position,
            velocity: [0, 1, 2].map(|k| velocity[k] * (1.0 - fade)),
            attitude: from_euler(roll, pitch, 0.03 * t.sin()),
            angular_velocity: [0.0; 3],
            reference_position: reference,
            reference_velocity: velocity,
            reference_acceleration: acceleration,
            reference_yaw: 0.0,
            rotor_speed: &speeds,
            rotor_command: &commands,
            thrust: &thrusts,
            wind: [0.0; 3],
        })?;
    }
    Ok(log)
}

fn tuning_history() -> Figure {
    let history = |rate: f64, floor: f64| (0..40).map(|i| (i as f64, floor + 6.0 * (-rate * i as f64).exp())).collect();
    let panel = Panel::new("Tracking RMSE while tuning", "iteration [-]", "RMSE [cm]")
        .from_zero()
        .series(Series::line("training starts", history(0.11, 3.1)).markers())
        .series(Series::line("held-out starts", history(0.10, 3.4)).markers())
        .level("published gains", 9.4, Colour::GREY);
    Figure::new("Hummingbird: gains by reverse-mode gradients").size(800.0, 400.0).chart(panel)
}

fn ratios() -> Figure {
    let bars = Bars::new("RK4 step, Hummingbird", "environment steps per second, relative to the plain f32 loop [-]")
        .bar(Bar::new("plain f32 loop", 1.0).colour(Colour::GREY))
        .bar(Bar::new("plain f64 loop", 0.41).note("×"))
        .bar(Bar::new("lanes, f32x8 (AVX2)", 2.9).note("×"))
        .bar(Bar::new("lanes, f32x16 (AVX-512)", 4.4).note("×").colour(Colour::VERMILLION))
        .bar(Bar::new("not measured", f64::NAN))
        .baseline("plain f32 loop", 1.0);
    let speed = Bars::new("Whole operations", "time [µs]")
        .log()
        .bar(Bar::new("f64 step", 0.2).note("µs"))
        .bar(Bar::new("adjoint of a step", 0.55).note("µs"))
        .bar(Bar::new("17×21 Jacobian", 5.3).note("µs"))
        .bar(Bar::new("gradient of 500 steps", 420.0).note("µs").colour(Colour::GREEN));
    Figure::new("Benches").subtitle("two cores, synthetic numbers").chart(bars).chart(speed)
}

fn certificate() -> Figure {
    let error = |order: i32, floor: f64| {
        (0..60).map(|i| 10f64.powf(-8.0 + 0.12 * f64::from(i))).map(|h| (h, h.powi(order) + floor / h)).collect()
    };
    let panel = Panel::new("Gradient certificate", "step of the difference [-]", "relative error [-]")
        .log_x()
        .log_y()
        .series(Series::line("central differences", error(2, 1e-16)))
        .series(Series::line("one-sided differences", error(1, 1e-16)))
        .level("adjoint against duals", 3e-13, Colour::GREEN);
    Figure::new("Taylor test").size(640.0, 400.0).chart(panel)
}
