//! What `design` draws: the loop over frequency, near the critical point and in the z-plane, and a step of the position.

use super::{Findings, degrees};
use crate::prelude::*;
use nalgebra::Complex;
use omnidrones::controllers::design::Point;
use omnidrones::controllers::linear::response::unwrapped;
use omnidrones::flight::FlightLog;
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::f64::consts::{PI, TAU};

/// Frequencies of a curve.
const POINTS: u32 = 400;
/// Lowest frequency drawn, rad/s.
const SLOWEST: f64 = 0.1;

/// The loop broken at every command: (name, L(jω)) along common frequencies.
pub struct Loops {
    omega: Vec<f64>,
    open: Vec<(String, Vec<Complex<f64>>)>,
}

impl Loops {
    /// Up to the Nyquist frequency.
    pub fn of(found: &Findings) -> Result<Self> {
        let nyquist = PI / found.model.dt;
        let share = |k: u32| f64::from(k) / f64::from(POINTS - 1);
        let omega: Vec<f64> = (0..POINTS).map(|k| SLOWEST * (nyquist / SLOWEST).powf(share(k))).collect();
        let broken = found.model.commands.iter().enumerate().map(|(i, command)| {
            let s = found.model.response(Point::Command(i), &omega)?;
            Ok((command.name.clone(), s.iter().map(|s| s.inv() - 1.0).collect()))
        });
        Ok(Self { open: broken.collect::<Result<_>>()?, omega })
    }

    /// Loop and sensitivity at every command over frequency.
    pub fn bode(&self, name: &str) -> Figure {
        let mut panels = ["Loop: gain [dB]", "Loop: phase [°]", "Sensitivity: gain [dB]"]
            .map(|title| Panel::new(title, "frequency [rad/s]", "").log_x());
        for (i, (command, open)) in self.open.iter().enumerate() {
            let decibel = |v: Complex<f64>| 20.0 * v.norm().log10();
            let gain = open.iter().map(|l| decibel(*l)).collect();
            let phase = unwrapped(open).into_iter().map(degrees).collect();
            let sensitivity = open.iter().map(|l| decibel((l + 1.0).inv())).collect();
            let all: [Vec<f64>; 3] = [gain, phase, sensitivity];
            for (panel, values) in panels.iter_mut().zip(all) {
                let points = self.omega.iter().copied().zip(values).collect();
                *panel = panel.clone().series(Series::line(command, points).colour(Colour::nth(i)));
            }
        }
        let figure =
            Figure::new(format!("{name}: the loop broken at one command")).size(1000.0, 900.0).grid(&[1.0], &[1.0; 3]);
        panels.into_iter().enumerate().fold(figure, |figure, (row, panel)| figure.place((0, row), (1, 1), panel))
    }

    /// L(jω) about −1, with the disk that the least disk margin of one command keeps free.
    pub fn nyquist(&self, found: &Findings) -> Panel {
        let mut panel = Panel::new("Nyquist curves of the loop broken at one command", "real part", "imaginary part")
            .x_range(-2.6, 1.4)
            .y_range(-2.0, 2.0);
        let margins = found.rows.iter().take(self.open.len()).map(|(_, margins)| &margins.disk);
        if let Some(disk) = margins.min_by(|a, b| a.alpha.total_cmp(&b.alpha)).filter(|disk| disk.alpha > 0.0) {
            // the factors that the loop bears are the disk's ends on the real axis
            let [near, far] = [disk.gain.1.recip(), disk.gain.0.recip()];
            let circle = circle(-0.5 * (near + far), 0.5 * (far - near));
            panel = panel.series(Series::line("free by the disk margin", circle).colour(Colour::GREY).dashed());
        }
        for (i, (command, open)) in self.open.iter().enumerate() {
            let points = open.iter().map(|l| (l.re, l.im)).collect();
            panel = panel.series(Series::line(command, points).colour(Colour::nth(i)));
        }
        panel.series(dots("−1", vec![(-1.0, 0.0)], Colour::INK))
    }
}

/// Poles of the whole loop over its period, within the unit circle where it is stable.
pub fn poles(found: &Findings) -> Panel {
    let seconds = found.model.dt * found.model.period() as f64;
    let points: Vec<(f64, f64)> = found.poles.iter().map(|p| (p.re, p.im)).collect();
    let reach = found.poles.iter().fold(1.0_f64, |most, p| most.max(p.re.abs()).max(p.im.abs()));
    let reach = 1.15 * reach.min(10.0);
    Panel::new(format!("Poles of the closed loop over {} ms", 1e3 * seconds), "real part", "imaginary part")
        .x_range(-reach, reach)
        .y_range(-reach, reach)
        .series(Series::line("unit circle", circle(0.0, 1.0)).colour(Colour::GREY).dashed())
        .series(dots("poles", points, Colour::BLUE))
}

fn circle(centre: f64, radius: f64) -> Vec<(f64, f64)> {
    let at = |k: u32| TAU * f64::from(k) / 180.0;
    (0..=180).map(|k| (centre + radius * at(k).cos(), radius * at(k).sin())).collect()
}

fn dots(name: &str, points: Vec<(f64, f64)>, colour: Colour) -> Series {
    Series::line(name, points).colour(colour).width(0.0).markers()
}

/// Where a flight is along an axis, from the time `from` on, with its reference.
pub fn step(title: &str, log: &FlightLog, axis: usize, from: f64) -> Panel {
    let of = |rows: &[[f64; 3]]| -> Vec<(f64, f64)> {
        let all = log.time.iter().zip(rows).map(|(t, p)| (t - from, p[axis]));
        all.filter(|(t, _)| *t >= -0.5).collect()
    };
    Panel::new(title, "time since the step [s]", "position [m]")
        .series(Series::line("reference", of(&log.reference_position)).colour(Colour::INK).dashed().width(1.0))
        .series(Series::line("flown", of(&log.position)).colour(Colour::nth(axis)))
}
