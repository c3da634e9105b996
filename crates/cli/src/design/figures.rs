//! What `design` draws: the loop over frequency, near the critical point and in the z-plane, and a step of the position.

use super::{Findings, degrees};
use crate::prelude::*;
use nalgebra::Complex;
use omnidrones::controllers::design::{AnalysisPoint, LoopMargins};
use omnidrones::controllers::linear::DiskMargin;
use omnidrones::controllers::linear::response::unwrapped;
use omnidrones::flight::FlightLog;
use omnidrones_plot::{Colour, Figure, Panel, Series};
use std::f64::consts::{PI, TAU};

/// Frequencies of a curve.
const POINTS: u32 = 400;
/// Lowest frequency drawn, rad/s.
const SLOWEST: f64 = 0.1;

/// L(jω) of the loop broken at a command of this number, at frequencies in rad/s.
type Response<'a> = dyn Fn(usize, &[f64]) -> Result<Vec<Complex<f64>>> + 'a;

/// The loop broken at every command: (name, L(jω)) along common frequencies.
pub struct Loops {
    omega: Vec<f64>,
    open: Vec<(String, Vec<Complex<f64>>)>,
    /// The command that bears the least disk, with its margin; none where the loop is not stable.
    least: Option<(usize, DiskMargin)>,
}

impl Loops {
    /// Of a cascade.
    pub fn of(found: &Findings) -> Result<Self> {
        let names: Vec<&str> = found.model.commands.iter().map(|command| command.name.as_str()).collect();
        Self::broken_at(&names, found.model.dt, &found.rows, &|i, omega| {
            let s = found.model.response(AnalysisPoint::Command(i), omega)?;
            Ok(s.iter().map(|s| s.inv() - 1.0).collect())
        })
    }

    /// Broken at commands of these names, up to the Nyquist frequency of steps of `dt`; the first of `rows` are their margins.
    pub fn broken_at(names: &[&str], dt: f64, rows: &[(String, LoopMargins)], response: &Response<'_>) -> Result<Self> {
        let nyquist = PI / dt;
        let share = |k: u32| f64::from(k) / f64::from(POINTS - 1);
        let omega: Vec<f64> = (0..POINTS).map(|k| SLOWEST * (nyquist / SLOWEST).powf(share(k))).collect();
        let open = names.iter().enumerate().map(|(i, name)| Ok((name.to_string(), response(i, &omega)?)));
        let open = open.collect::<Result<Vec<_>>>()?;
        Ok(Self { least: least_disk(&rows[..names.len().min(rows.len())]), open, omega })
    }

    /// Loop and sensitivity at every command over frequency, the margins of the command that bears least marked.
    pub fn bode(&self, name: &str) -> Figure {
        let mut panels = ["Loop: gain [dB]", "Loop: phase [°]", "Sensitivity: gain [dB]"]
            .map(|title| Panel::new(title, "frequency [rad/s]", "").log_x());
        let [gain, phase, sensitivity] = &mut panels;
        for (i, (command, open)) in self.open.iter().enumerate() {
            let curve = |values: Vec<f64>| {
                let points = self.omega.iter().copied().zip(values).collect();
                Series::line(command, points).colour(Colour::nth(i))
            };
            gain.series.push(curve(open.iter().map(|l| decibel(*l)).collect()));
            phase.series.push(curve(phases(open)));
            sensitivity.series.push(curve(open.iter().map(|l| decibel((l + 1.0).inv())).collect()));
        }
        for (panel, level) in [(&mut *gain, 0.0), (&mut *phase, -180.0), (sensitivity, 0.0)] {
            *panel = std::mem::take(panel).level("", level, Colour::GREY);
        }
        if let Some((worst, _)) = &self.least {
            let marks = Marks::of(&self.omega, &self.open[*worst].1);
            if let Some((omega, at)) = marks.gain {
                gain.series.push(mark(
                    format!("gain margin {} dB", number(-at, 1).replace('-', "−")),
                    omega,
                    [0.0, at],
                ));
            }
            if let Some((omega, at, line)) = marks.phase {
                let name = format!("phase margin {}°", number((at - line).abs(), 1));
                phase.series.push(mark(name, omega, [line, at]));
            }
        }
        let figure =
            Figure::new(format!("{name}: the loop broken at one command")).size(1000.0, 900.0).grid(&[1.0], &[1.0; 3]);
        panels.into_iter().enumerate().fold(figure, |figure, (row, panel)| figure.place((0, row), (1, 1), panel))
    }

    /// L(jω) about −1, with the disk that the least disk margin of one command keeps free.
    pub fn nyquist(&self) -> Panel {
        // of a disk that reaches farther its near side is what matters
        const FARTHEST: f64 = 5.0;
        let mut panel = Panel::new("Nyquist curves of the loop broken at one command", "real part", "imaginary part");
        panel.series.push(Series::line("unit circle", circle(0.0, 1.0)).colour(Colour::GREY).width(0.7));
        let mut left = -2.0_f64;
        if let Some((_, disk)) = &self.least {
            // the factors that the loop bears are the disk's ends on the real axis
            let [near, far] = [disk.gain.1.recip(), disk.gain.0.recip()];
            let circle = circle(-0.5 * (near + far), 0.5 * (far - near));
            panel.series.push(Series::line("free by the disk margin", circle).colour(Colour::GREY).dashed());
            left = left.min(-far.min(FARTHEST));
        }
        for (i, (command, open)) in self.open.iter().enumerate() {
            let points = open.iter().map(|l| (l.re, l.im)).collect();
            panel.series.push(Series::line(command, points).colour(Colour::nth(i)));
        }
        // both circles whole, one scale for both axes
        let (lo, hi) = (left - 0.25, 1.25);
        let half = 0.5 * (hi - lo);
        panel.series(dots("−1", vec![(-1.0, 0.0)], Colour::INK)).x_range(lo, hi).y_range(-half, half)
    }
}

fn decibel(v: Complex<f64>) -> f64 {
    20.0 * v.norm().log10()
}

fn least_disk(rows: &[(String, LoopMargins)]) -> Option<(usize, DiskMargin)> {
    let disks = rows.iter().map(|(_, margins)| margins.disk).enumerate();
    disks.filter(|(_, disk)| disk.alpha > 0.0).min_by(|a, b| a.1.alpha.total_cmp(&b.1.alpha))
}

/// Phases without jumps, °, that where the gain falls through 1 for the last time in (−360, 0]: a loop of two integrators
/// begins near −180°, not at +180°.
fn phases(open: &[Complex<f64>]) -> Vec<f64> {
    let mut phases: Vec<f64> = unwrapped(open).into_iter().map(degrees).collect();
    let largest = || (0..open.len()).max_by(|a, b| open[*a].norm().total_cmp(&open[*b].norm()));
    let falls = (1..open.len()).rev().find(|k| open[*k - 1].norm() >= 1.0 && open[*k].norm() < 1.0);
    if let Some(at) = falls.or_else(largest) {
        let turns = (phases[at] / 360.0).ceil();
        phases.iter_mut().for_each(|phase| *phase -= 360.0 * turns);
    }
    phases
}

/// Where a loop is nearest to −1 in gain alone and in phase alone.
struct Marks {
    /// rad/s, and the gain there, dB.
    gain: Option<(f64, f64)>,
    /// rad/s, the phase there, and the odd multiple of 180° next to it.
    phase: Option<(f64, f64, f64)>,
}

impl Marks {
    fn of(omega: &[f64], open: &[Complex<f64>]) -> Self {
        let gains: Vec<f64> = open.iter().map(|l| decibel(*l)).collect();
        let phases = phases(open);
        let odd = |phase: f64| 360.0 * (phase / 360.0).floor() + 180.0;
        // where a curve runs through a level, and what another is there
        let through = |values: &[f64], level: f64, other: &[f64]| -> Vec<(f64, f64)> {
            let cut = |k: usize| {
                let (a, b) = (values[k] - level, values[k + 1] - level);
                let share = (a * b <= 0.0 && a != b).then(|| a / (a - b))?;
                let at = omega[k] * (omega[k + 1] / omega[k]).powf(share);
                Some((at, other[k] + share * (other[k + 1] - other[k])))
            };
            (0..values.len().saturating_sub(1)).filter_map(cut).collect()
        };
        let least = |a: f64, b: f64| a.abs().total_cmp(&b.abs());
        let (low, high) = phases.iter().fold((0.0_f64, 0.0_f64), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let levels = (odd(low) as i64..=odd(high) as i64).step_by(360).map(|level| level as f64);
        let gain = levels.flat_map(|level| through(&phases, level, &gains));
        let phase = through(&gains, 0.0, &phases).into_iter().map(|(omega, phase)| (omega, phase, odd(phase)));
        Self { gain: gain.min_by(|a, b| least(a.1, b.1)), phase: phase.min_by(|a, b| least(a.1 - a.2, b.1 - b.2)) }
    }
}

/// An upright line between two values at a frequency.
fn mark(name: String, omega: f64, values: [f64; 2]) -> Series {
    Series::line(name, values.map(|v| (omega, v)).to_vec()).colour(Colour::INK).width(0.95)
}

/// Poles of the whole loop over its period of so many seconds, within the unit circle where it is stable.
pub fn poles(poles: &[Complex<f64>], seconds: f64) -> Panel {
    let points: Vec<(f64, f64)> = poles.iter().map(|p| (p.re, p.im)).collect();
    let reach = poles.iter().fold(1.0_f64, |most, p| most.max(p.re.abs()).max(p.im.abs()));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Loops of two integrators, a lag and a delay over frequency, by the gain at which they cross.
    fn open(lag: f64, delay: f64, gain: f64) -> (Vec<f64>, Vec<Complex<f64>>) {
        let omega: Vec<f64> = (0..400).map(|k| 0.1 * 1e4_f64.powf(f64::from(k) / 399.0)).collect();
        let j = Complex::i();
        // a zero lifts the phase at the crossover
        let at =
            |w: &f64| gain * (j * *w * 0.2 + 1.0) / (j * *w).powi(2) / (j * *w * lag + 1.0) * (-j * *w * delay).exp();
        let open = omega.iter().map(at).collect();
        (omega, open)
    }

    #[test]
    fn the_phase_of_two_integrators_begins_at_minus_180_and_crosses_within_a_turn() {
        for (lag, delay) in [(0.01, 0.0), (0.05, 0.002), (0.002, 0.02)] {
            for sign in [1.0, 1.0 + 1e-3] {
                let (omega, open) = open(lag, delay, 30.0 * sign);
                let phases = phases(&open);
                assert!((phases[0] + 180.0).abs() < 3.0, "{}", phases[0]);
                let cross = open.iter().position(|l| l.norm() < 1.0).unwrap();
                let w = omega[cross];
                let own = -180.0 + degrees((0.2 * w).atan() - (lag * w).atan() - delay * w);
                assert!((phases[cross] - own).abs() < 1e-6 && (-360.0..=0.0).contains(&own), "{} {own}", phases[cross]);
            }
        }
    }

    #[test]
    fn marks_stand_where_the_loop_is_nearest_to_minus_one() {
        for (lag, delay, gain) in [(0.01, 0.01, 30.0), (0.02, 0.005, 10.0)] {
            let (omega, open) = open(lag, delay, gain);
            let marks = Marks::of(&omega, &open);
            let by = |w: f64| {
                let phase = -180.0 + degrees((0.2 * w).atan() - (lag * w).atan() - delay * w);
                let size = gain * (0.2 * w).hypot(1.0) / (w * w * (lag * w).hypot(1.0));
                (20.0 * size.log10(), phase)
            };
            let (w, at) = marks.gain.unwrap();
            assert!((by(w).1 + 180.0).abs() < 0.1 && (by(w).0 - at).abs() < 0.05, "{w} {at} {:?}", by(w));
            let (w, at, line) = marks.phase.unwrap();
            assert!(
                by(w).0.abs() < 0.05 && (by(w).1 - at).abs() < 0.2 && line == -180.0,
                "{w} {at} {line} {:?}",
                by(w)
            );
        }
    }
}
