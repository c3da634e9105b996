//! Which links look like rotors, and which way they would turn.

use super::bodies::Body;
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::TAU;

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

/// Hubs nearer to one another than this share of the arm, seen along the thrust, are one above the other; in radians, such
/// angles are one direction. Of sixteen hubs on a ring, neighbours are 0.39 arms apart.
const ALIKE: f64 = 0.1;
/// Where angles begin, rad: no usual layout has a rotor there, so that rounding errors take none from the first place to the last.
const FIRST: f64 = -0.1;

/// Hubs as seen along the thrust `up`, about their middle: z is along it.
pub(super) fn seen_along(up: &Vector3<f64>, positions: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let middle = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
    let turn = Rotation3::rotation_between(up, &Vector3::z()).unwrap_or_else(Rotation3::identity);
    positions.iter().map(|p| turn * (p - middle)).collect()
}

/// Whether two hubs of [`seen_along`] are one above the other.
fn stacked(seen: &[Vector3<f64>]) -> impl Fn(&Vector3<f64>, &Vector3<f64>) -> bool {
    let near = ALIKE * seen.iter().map(Vector3::norm).fold(0.0, f64::max);
    move |a, b| (a - b).xy().norm() <= near
}

/// The angle of hubs above one another, and which they are.
type Tower<'a> = (f64, Vec<(usize, &'a Vector3<f64>)>);

/// Spins of the hubs of [`seen_along`] that alternate with the angle around their middle, so that equal thrusts give no yaw
/// torque: the first rotor from +x on turns clockwise (a front-right rotor then counter-clockwise, as on the Crazyflie). Rotors
/// above one another turn against each other.
pub(super) fn alternating_spins(seen: &[Vector3<f64>]) -> Vec<f64> {
    let stacked = stacked(seen);
    let mut towers: Vec<Tower<'_>> = Vec::new();
    for (i, hub) in seen.iter().enumerate() {
        match towers.iter_mut().find(|(_, tower)| tower.iter().any(|(_, other)| stacked(other, hub))) {
            Some((_, tower)) => tower.push((i, hub)),
            // one in the middle has no angle: it is the first
            None if stacked(hub, &Vector3::zeros()) => towers.push((f64::NEG_INFINITY, vec![(i, hub)])),
            None => towers.push(((hub.y.atan2(hub.x) - FIRST).rem_euclid(TAU), vec![(i, hub)])),
        }
    }
    towers.sort_by(|a, b| a.0.total_cmp(&b.0));
    let far = |tower: &Tower<'_>| tower.1.iter().map(|(_, p)| p.xy().norm()).sum::<f64>();
    for same in towers.chunk_by_mut(|a, b| b.0 - a.0 < ALIKE) {
        same.sort_by(|a, b| far(b).total_cmp(&far(a)));
    }
    let mut spins = vec![1.0; seen.len()];
    let mut first = 1.0;
    for (_, mut tower) in towers {
        tower.sort_by(|a, b| b.1.z.total_cmp(&a.1.z));
        first = -first;
        let mut spin = first;
        for (i, _) in tower {
            spins.get_mut(i).into_iter().for_each(|slot| *slot = spin);
            spin = -spin;
        }
    }
    spins
}

/// Smallest distance between two hubs of [`seen_along`] that are not above one another; `None` where there are no two.
pub(super) fn spacing(seen: &[Vector3<f64>]) -> Option<f64> {
    let stacked = stacked(seen);
    let pairs = seen.iter().enumerate().flat_map(|(i, a)| seen.iter().skip(i + 1).map(move |b| (a, b)));
    pairs.filter(|(a, b)| !stacked(a, b)).map(|(a, b)| (a - b).xy().norm()).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    #[test]
    fn names_are_split_at_separators_digits_and_capitals() {
        assert_eq!(words("iris__rotor_0"), ["iris", "rotor"]);
        assert_eq!(words("frontLeftProp2"), ["front", "left", "prop"]);
        assert!(says("motor_0", WORDS[2]) && !says("arm_motor_0", WORDS[2]) && !says("properties", WORDS[1]));
    }

    /// Spins of hubs whose rotors push up.
    fn spins(hubs: &[Vector3<f64>]) -> Vec<f64> {
        alternating_spins(&seen_along(&Vector3::z(), hubs))
    }

    #[test]
    fn spins_of_a_cross_cancel_and_a_stacked_pair_turns_against_itself() {
        let x = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
        let cross = [x(0.1, -0.1, 0.0), x(-0.1, -0.1, 0.0), x(-0.1, 0.1, 0.0), x(0.1, 0.1, 0.0)];
        assert_eq!(spins(&cross), [1.0, -1.0, 1.0, -1.0]);
        let pair = [x(0.1, 0.0, 0.1), x(0.1, 0.0, -0.1), x(-0.1, 0.0, 0.1), x(-0.1, 0.0, -0.1)];
        assert_eq!(spins(&pair), [-1.0, 1.0, 1.0, -1.0]);
        assert_eq!(spins(&pair[..2]), [-1.0, 1.0]);
        // one in the middle leaves the ring as it is
        let five = [&cross[..], &[x(1e-17, -1e-17, 0.0)]].concat();
        assert_eq!(spins(&five), [-1.0, 1.0, -1.0, 1.0, -1.0]);
    }

    /// `n` arms, `high` rotors on each, turned by an angle, every coordinate off by up to `noise`; mirrored if told so.
    fn ring(n: usize, high: usize, turn: f64, noise: f64, mirrored: bool) -> Vec<Vector3<f64>> {
        let mut stream = Stream::new(n as u64, turn.to_bits(), high as u64, Purpose::user(0));
        let place = |k: usize| {
            let angle = turn + TAU * (k % n) as f64 / n as f64;
            let y = if mirrored { -angle.sin() } else { angle.sin() };
            Vector3::new(angle.cos(), y, -0.1 * (k / n) as f64)
        };
        (0..n * high).map(|k| 0.4 * (place(k) + Vector3::from_fn(|_, _| stream.uniform(-noise, noise)))).collect()
    }

    #[test]
    fn rings_alternate_and_pairs_turn_against_themselves_at_every_angle_whatever_the_last_digits() {
        for n in [2, 4, 6, 8] {
            for (high, mirrored) in [(1, false), (1, true), (2, false), (2, true)] {
                for turn in (0..48).map(|k| f64::from(k) * TAU / 48.0).chain([1e-17, -1e-17, 0.123, 3.0]) {
                    for noise in [0.0, 1e-17, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3] {
                        let hubs = ring(n, high, turn, noise, mirrored);
                        let spins = spins(&hubs);
                        let what =
                            format!("{n} × {high}, turned by {turn}, noise {noise}, mirrored {mirrored}: {spins:?}");
                        assert!((0..n).all(|k| spins[k] == -spins[(k + 1) % n]), "{what}");
                        assert!((n..n * high).all(|k| spins[k] == -spins[k - n]), "{what}");
                        // rotors of whatever size: the same distance
                        let gap = spacing(&seen_along(&Vector3::z(), &hubs)).unwrap();
                        assert!((gap - 0.8 * (0.5 * TAU / n as f64).sin()).abs() < 0.01, "{what}: {gap}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_vehicle_on_its_side_has_the_spins_of_one_that_stands() {
        let standing = ring(6, 2, 0.2, 1e-9, false);
        let turn = Rotation3::from_euler_angles(0.5 * std::f64::consts::PI, 0.0, 0.0);
        let lying: Vec<Vector3<f64>> = standing.iter().map(|p| turn.inverse() * p).collect();
        let seen = seen_along(&(turn.inverse() * Vector3::z()), &lying);
        assert_eq!(alternating_spins(&seen), spins(&standing));
    }
}
