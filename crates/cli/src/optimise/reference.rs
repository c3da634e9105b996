//! A planned trajectory as a reference: the path and the heading of the tracked body.

use super::planned::Planned;
use crate::arguments::Outputs;
use crate::prelude::*;
use omnidrones::controllers::reference::{MAX_SAMPLES, Sampled, Waypoint};
use omnidrones::dynamics::spatial::{conjugate, multiply, rotate};
use std::f64::consts::TAU;
use std::fmt::Write;

/// Where body z leans more than this from the vertical, a heading says little: it goes on evenly there.
const LEANS: f64 = 0.5; // cosine
/// Shortest time between two samples, s.
const SHORTEST: f64 = 1e-3;

impl Planned<'_> {
    /// Writes what 'fly' tracks; where there can be no such file, why.
    pub fn write_reference(&self, outputs: &mut Outputs) -> Result<Option<String>> {
        let (points, velocities) = (self.points(), [self.log.velocity[0], self.log.velocity[self.log.len() - 1]]);
        let sampled = match Sampled::with_velocities(points, velocities) {
            Err(error) => return Ok(Some(format!("no reference.toml is written: {error}"))),
            Ok(sampled) => sampled,
        };
        let [start, end] = velocities;
        let (planned, flies) = (shown(&self.source.name), shown(&self.log.vehicle));
        let mut text = format!(
            "# Planned by 'omnidrones optimise' ({planned}). Fly it: omnidrones fly {flies} --reference FILE\n\
             kind = \"sampled\"\nstart_velocity = {start:?}\nend_velocity = {end:?}\npoints = [\n"
        );
        for p in sampled.points() {
            let (time, position, yaw) = (p.time, p.position, p.yaw);
            let _ = writeln!(text, "  {{ time = {time:?}, position = {position:?}, yaw = {yaw:?} }},");
        }
        outputs.text("reference.toml", text + "]\n")?;
        Ok(None)
    }

    /// As many stages as a reference takes, the first and the last among them.
    fn points(&self) -> Vec<Waypoint> {
        let (last, dt) = (self.log.len() - 1, self.source.file.dt);
        let stride = last.div_ceil(MAX_SAMPLES - 1).max((SHORTEST / dt).ceil() as usize).max(1);
        let headings = self.headings();
        let point = |k: usize| Waypoint { time: self.log.time[k], position: self.log.position[k], yaw: headings[k] };
        // none is nearer to the end than half a stride
        let inner = (0..last).step_by(stride).filter(|k| 2 * (last - k) > stride || *k == 0);
        inner.chain([last]).map(point).collect()
    }

    /// Yaw in every stage: with which the attitude has its body z and its heading, b₂ along b₃ × (cos ψ, sin ψ, 0).
    fn headings(&self) -> Vec<f64> {
        let back = self.log.hover_attitude.map(conjugate);
        let mut known: Vec<(usize, f64)> = Vec::new();
        for (k, body) in self.log.attitude.iter().enumerate() {
            let q = back.map_or(*body, |back| multiply(*body, back));
            if rotate(q, [0.0, 0.0, 1.0])[2] < LEANS {
                continue;
            }
            let left = rotate(q, [0.0, 1.0, 0.0]);
            let yaw = (-left[0]).atan2(left[1]);
            // the short way from the one before
            let before = known.last().map_or(0.0, |own| own.1);
            known.push((k, yaw + TAU * ((before - yaw) / TAU).round()));
        }
        let (Some(first), Some(last)) = (known.first().copied(), known.last().copied()) else {
            return vec![0.0; self.log.len()];
        };
        let mut all = vec![first.1; first.0];
        for pair in known.windows(2) {
            let ((from, a), (to, b)) = (pair[0], pair[1]);
            all.extend((0..to - from).map(|k| a + (b - a) * k as f64 / (to - from) as f64));
        }
        all.resize(self.log.len(), last.1);
        all
    }
}
