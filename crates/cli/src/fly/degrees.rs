//! Yaw that was probably meant in degrees.

use omnidrones::controllers::Reference;
use omnidrones::controllers::reference::{Ellipse, Hover, Pointed};
use std::f64::consts::TAU;

/// Degrees that people write are whole multiples of this.
const USUAL: f64 = 5.0;

/// A hint where angles of a reference are beyond 2π and such as people write in degrees.
pub(super) fn hint(reference: &Reference) -> Option<String> {
    let all: Vec<(String, f64)> = match reference {
        Reference::Hover(Hover { yaw, .. }) | Reference::Ellipse(Ellipse { yaw, .. }) => vec![("yaw".into(), *yaw)],
        Reference::Step(r) => vec![("yaw".into(), r.yaw)],
        Reference::Circle(r) => vec![("yaw".into(), r.yaw)],
        Reference::Pointed(Pointed { path: r, .. }) | Reference::Lemniscate(r) => vec![("yaw".into(), r.yaw)],
        Reference::Waypoints(r) => {
            r.points().iter().enumerate().map(|(i, p)| (format!("points[{i}].yaw"), p.yaw)).collect()
        }
        Reference::Sampled(r) => {
            r.points().iter().enumerate().map(|(i, p)| (format!("points[{i}].yaw"), p.yaw)).collect()
        }
        Reference::Carried(_) | Reference::Own(_) => Vec::new(),
    };
    let odd: Vec<&(String, f64)> = all.iter().filter(|(_, yaw)| yaw.abs() > TAU && yaw % USUAL == 0.0).collect();
    let (name, yaw) = odd.first()?;
    let more = if odd.len() > 1 { format!(", and {} more", odd.len() - 1) } else { String::new() };
    Some(format!(
        "--reference: {name} = {yaw}: an angle beyond 2π{more}: angles are radians: if these are degrees, convert them \
         ({yaw}° are {:.4} rad). Read as radians.",
        yaw.to_radians()
    ))
}
