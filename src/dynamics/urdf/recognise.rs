//! Which links look like rotors, and which way they would turn.

use super::bodies::Body;
use nalgebra::Vector3;

/// Words that mark a rotor, best first.
const WORDS: [&[&str]; 3] =
    [&["rotor", "rotors"], &["prop", "props", "propeller", "propellor", "propellers"], &["motor", "motors"]];

/// Words that mark something that only carries a rotor.
const CARRIERS: [&str; 12] =
    ["arm", "mount", "base", "guard", "support", "holder", "frame", "esc", "leg", "camera", "imu", "plate"];

/// Lower-case words of a name, split at anything but letters and before capitals: `frontLeft_prop0` → front left prop.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut lower = false;
    for c in name.chars() {
        if !c.is_alphabetic() || (c.is_uppercase() && lower) {
            words.push(String::new());
        }
        if c.is_alphabetic()
            && let Some(word) = words.last_mut()
        {
            word.extend(c.to_lowercase());
        }
        lower = c.is_lowercase();
    }
    words.retain(|w| !w.is_empty());
    words
}

fn says(name: &str, class: &[&str]) -> bool {
    let words = words(name);
    words.iter().any(|w| class.contains(&w.as_str())) && !words.iter().any(|w| CARRIERS.contains(&w.as_str()))
}

/// Bodies that look like rotors, in the order of the numbers in their names where all have one, else of the file.
/// The best class of words wins: with `rotor_0` beside `motor_0` only the rotors count.
pub(super) fn rotor_links(bodies: &[Body]) -> Vec<usize> {
    let child = |b: &Body| b.joint.is_some();
    for class in WORDS {
        let by_link = indices(bodies, |b| child(b) && says(&b.name, class));
        if !by_link.is_empty() {
            return by_link;
        }
        let by_joint = indices(bodies, |b| {
            b.joint.as_ref().is_some_and(|j| says(&j.name, class))
                && !words(&b.name).iter().any(|w| CARRIERS.contains(&w.as_str()))
        });
        if !by_joint.is_empty() {
            return by_joint;
        }
    }
    Vec::new()
}

fn indices(bodies: &[Body], test: impl Fn(&Body) -> bool) -> Vec<usize> {
    let mut found: Vec<(usize, Option<u64>)> =
        bodies.iter().enumerate().filter(|(_, b)| test(b)).map(|(i, b)| (i, number(&b.name))).collect();
    if found.iter().all(|(_, n)| n.is_some()) {
        found.sort_by_key(|(_, n)| *n);
    }
    found.into_iter().map(|(i, _)| i).collect()
}

/// The last number in a name.
fn number(name: &str) -> Option<u64> {
    name.split(|c: char| !c.is_ascii_digit()).rfind(|s| !s.is_empty()).and_then(|s| s.parse().ok())
}

/// Spins that alternate with the angle around the rotors' middle, so that equal thrusts give no yaw torque: the first
/// rotor at an angle in [0, 2π) from +x turns clockwise (a front-right rotor then counter-clockwise, as on the
/// Crazyflie). Rotors above one another turn against each other.
pub(super) fn alternating_spins(positions: &[Vector3<f64>]) -> Vec<f64> {
    let middle = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
    let angle = |p: &Vector3<f64>| (p.y - middle.y).atan2(p.x - middle.x).rem_euclid(std::f64::consts::TAU);
    let mut order: Vec<(usize, f64, &Vector3<f64>)> =
        positions.iter().enumerate().map(|(i, p)| (i, angle(p), p)).collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.2.z.total_cmp(&a.2.z)));
    let mut spins = vec![1.0; positions.len()];
    let (mut first, mut spin) = (1.0, 1.0);
    let mut previous: Option<&Vector3<f64>> = None;
    for (i, _, position) in order {
        let stacked = previous.is_some_and(|p| (p.xy() - position.xy()).norm() < 1e-3);
        if stacked {
            spin = -spin;
        } else {
            first = -first;
            spin = first;
        }
        if let Some(slot) = spins.get_mut(i) {
            *slot = spin;
        }
        previous = Some(position);
    }
    spins
}

/// Smallest distance between two hubs; `None` for fewer than two, or where two coincide in the plane.
pub(super) fn spacing(positions: &[Vector3<f64>]) -> Option<f64> {
    let pairs =
        positions.iter().enumerate().flat_map(|(i, a)| positions.iter().skip(i + 1).map(move |b| (a - b).xy().norm()));
    pairs.filter(|d| *d > 1e-3).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_split_at_separators_digits_and_capitals() {
        assert_eq!(words("iris__rotor_0"), ["iris", "rotor"]);
        assert_eq!(words("frontLeftProp2"), ["front", "left", "prop"]);
        assert!(says("motor_0", WORDS[2]) && !says("arm_motor_0", WORDS[2]) && !says("properties", WORDS[1]));
    }

    #[test]
    fn spins_of_a_cross_cancel_and_a_stacked_pair_turns_against_itself() {
        let x = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
        let cross = [x(0.1, -0.1, 0.0), x(-0.1, -0.1, 0.0), x(-0.1, 0.1, 0.0), x(0.1, 0.1, 0.0)];
        assert_eq!(alternating_spins(&cross), [1.0, -1.0, 1.0, -1.0]);
        let pair = [x(0.1, 0.0, 0.1), x(0.1, 0.0, -0.1), x(-0.1, 0.0, 0.1), x(-0.1, 0.0, -0.1)];
        let spins = alternating_spins(&pair);
        assert_eq!(spins[0], -spins[1]);
        assert_eq!(spins.iter().sum::<f64>(), 0.0);
    }
}
