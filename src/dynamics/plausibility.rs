//! What of a vehicle's numbers is probably not meant: sizes beyond whatever flies, with the unit that would explain them.
//!
//! | looked at | band | why |
//! |---|---|---|
//! | mass over arm³ | 0.01 to 8000 kg/m³ | from a hundredth of the air to steel: built-in vehicles have 91 to 441, an air taxi of 900 kg on arms of 4.6 m has 9, a human-powered quadrotor of 128 kg on arms of some 19 m has 0.02 |
//! | √(J/m) over arm | 0.05 to 4 | mass within the arms gives at most 1, built-in vehicles have 0.55 to 0.88 |
//! | equal moments that are a power of ten | a factor of 3 around m arm²/3 | what programs write where nobody gave an inertia; built-in vehicles have 0.3 to 0.8 m arm² |
//! | speed of blade tips | up to 340 m/s | sound; built-in vehicles have 54 to 194 |
//! | thrust over weight | 0.2 to 40 | built-in vehicles have 1.6 to 6.3, racers 15; an overloaded vehicle still lifts a part of itself |
//! | motor time constant | up to 1 s | the largest propellers take some tenths |
//! | centre of mass from the base origin | up to half an arm | controllers hold the origin, which swings about the centre; built-in vehicles have up to a tenth |
//! | mean thrust | within 60° of z | what lies on its side was not stood up |
//!
//! One cause is told once: inertia and rotors are looked at where mass and arms make sense.

use super::vehicle::{GRAVITY, Inertia, Rotor, Vehicle};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Something about a vehicle that is probably not what its author meant.
#[derive(Debug, Clone, PartialEq)]
pub struct VehicleWarning {
    /// The quantity: `mass`, `inertia`.
    pub what: String,
    /// What is odd, with the value and the band.
    pub rule: String,
    /// What to do, with the unit or factor that would make sense.
    pub remedy: String,
}

impl std::fmt::Display for VehicleWarning {
    /// One line: `what: rule. remedy`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}. {}", self.what, self.rule, self.remedy)
    }
}

/// kg/m³.
const DENSITY: [f64; 2] = [0.01, 8000.0];
/// Of √(J/m) over the arm.
const GYRATION: [f64; 2] = [0.05, 4.0];
/// Of J over m arm² of a usual vehicle.
const USUAL: f64 = 1.0 / 3.0;
/// By how much a placeholder of an inertia may miss the usual one.
const PLACEHOLDER: f64 = 3.0;
/// m/s.
const FASTEST_TIP: f64 = 340.0;
const LIFT: [f64; 2] = [0.2, 40.0];
/// s.
const SLOWEST_MOTOR: f64 = 1.0;
/// Cosine of 60°: between rotors that push up and ones that push to a side there are 45°.
const LEAST_UP: f64 = 0.5;
/// Distance of the centre of mass from the origin over the arm.
const FARTHEST_ORIGIN: f64 = 0.5;
/// Revolutions per minute in rad/s.
const RPM: f64 = TAU / 60.0;

/// A unit that may have been meant, and the size of one of it in SI.
type Unit = (&'static str, f64);

const LENGTHS: [Unit; 3] = [("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)];
const INERTIAS: [Unit; 5] = [("g m²", 1e-3), ("kg cm²", 1e-4), ("kg mm²", 1e-6), ("g cm²", 1e-7), ("g mm²", 1e-9)];

fn within([least, most]: [f64; 2], x: f64) -> bool {
    (least..=most).contains(&x)
}

/// Three digits.
fn short(x: f64) -> String {
    let rounded: f64 = format!("{x:.2e}").parse().unwrap_or(x);
    if rounded == 0.0 || within([1e-4, 1e6], rounded.abs()) { rounded.to_string() } else { format!("{rounded:e}") }
}

/// `Read as grams, …; as millimetres, …. ` for each unit that fits, else empty.
fn read_as(fitting: impl Iterator<Item = (&'static str, String)>) -> String {
    let all: Vec<String> = fitting.map(|(unit, gives)| format!("as {unit}, {gives}")).collect();
    if all.is_empty() { String::new() } else { format!("Read {}. ", all.join("; ")) }
}

impl Vehicle {
    /// What of a valid vehicle is probably not meant: mass, lengths, inertia, rotor speeds or times in other units than SI,
    /// an inertia that nobody gave, rotors that do not push up. Empty for whatever resembles a vehicle that flies.
    ///
    /// Bands: m/arm³ 0.01 to 8000 kg/m³; √(J/m)/arm 0.05 to 4; blade tips up to 340 m/s; thrust over weight 0.2 to 40; time constants up
    /// to 1 s; centre of mass within half an arm of the base origin; mean thrust within 60° of z.
    ///
    /// ```
    /// # use omnidrones_dynamics::omnidrones;
    /// let mut vehicle = omnidrones::dynamics::vehicles::by_name("iris")?;
    /// assert!(vehicle.warnings().is_empty());
    /// vehicle.parts.iter_mut().for_each(|part| part.mass *= 1000.0);
    /// assert!(vehicle.warnings()[0].remedy.starts_with("Read as grams, 1.52 kg."));
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    pub fn warnings(&self) -> Vec<VehicleWarning> {
        let mut found = Vec::new();
        match (arm(self), size(self)) {
            (_, Some(odd)) => found.push(odd),
            (arm, None) => {
                found.extend(arm.and_then(|arm| inertia(self, arm)));
                found.extend(rotors(self));
            }
        }
        found.extend(time_constants(self));
        found.extend(direction(self));
        found.extend(arm(self).and_then(|arm| origin(self, arm)));
        found
    }
}

/// Largest distance of a hub from the middle of all, m; of one or two rotors, which may be above one another, not below their
/// radius. `None` where that says nothing.
fn arm(vehicle: &Vehicle) -> Option<f64> {
    let hubs = || vehicle.rotors.iter().map(|r| Vector3::from(r.position));
    let middle = hubs().sum::<Vector3<f64>>() / vehicle.n_rotor() as f64;
    let arm = hubs().map(|hub| (hub - middle).norm()).fold(0.0, f64::max);
    let radius = vehicle.rotors.iter().map(|r| r.radius).fold(0.0, f64::max);
    let arm = match vehicle.n_rotor() {
        1 | 2 if radius > 0.0 => arm.max(radius),
        1 | 2 => 0.0,
        _ => arm,
    };
    (arm > 0.0).then_some(arm)
}

/// The origin that is flown, against the centre that moves.
fn origin(vehicle: &Vehicle, arm: f64) -> Option<VehicleWarning> {
    let away = vehicle.mass_properties().center_of_mass.norm();
    (away > FARTHEST_ORIGIN * arm).then(|| VehicleWarning {
        what: "origin".into(),
        rule: format!(
            "{} m from the centre of mass, on arms of {} m: it is the origin that controllers hold, and it swings about the centre",
            short(away),
            short(arm)
        ),
        remedy: "Put the origin of the base near the centre of mass, not on the ground or on a stand".into(),
    })
}

/// Mass and arm against each other.
fn size(vehicle: &Vehicle) -> Option<VehicleWarning> {
    let (arm, mass) = (arm(vehicle)?, vehicle.mass_properties().mass);
    let density = mass / arm.powi(3);
    if within(DENSITY, density) {
        return None;
    }
    let usual = |mass: f64, arm: f64| {
        within([3.0, 3000.0], mass / arm.powi(3)) && within([0.001, 1000.0], mass) && within([0.01, 5.0], arm)
    };
    let grams = [("grams", 1e-3, 1.0), ("grams and millimetres", 1e-3, 1e-3)];
    let all = grams.into_iter().chain(LENGTHS.map(|(name, length)| (name, 1.0, length)));
    let fitting = all.map(|(name, m, l)| (name, mass * m, arm * l)).filter(|(_, mass, arm)| usual(*mass, *arm));
    let remedy = read_as(fitting.map(|(name, new_mass, new_arm)| {
        let numbers = match (new_mass != mass, new_arm != arm) {
            (true, false) => format!("{} kg", short(new_mass)),
            (false, _) => format!("arms of {} m", short(new_arm)),
            _ => format!("{} kg on arms of {} m", short(new_mass), short(new_arm)),
        };
        (name, numbers)
    }));
    let (what, beyond) = if density > DENSITY[1] {
        ("mass", format!("above {} (steel)", DENSITY[1]))
    } else {
        ("lengths", format!("below {} (a hundredth of the air)", DENSITY[0]))
    };
    Some(VehicleWarning {
        what: what.into(),
        rule: format!(
            "{} kg on arms of {} m make {} kg/m³ over the cube of the arm, {beyond}",
            short(mass),
            short(arm),
            short(density)
        ),
        remedy: remedy + "Write kilograms and metres.",
    })
}

/// The moments of inertia against mass and arm.
fn inertia(vehicle: &Vehicle, arm: f64) -> Option<VehicleWarning> {
    let total = vehicle.mass_properties();
    let usual = USUAL * total.mass * arm * arm;
    if let Some((name, moment)) = placeholder(vehicle, usual) {
        return Some(VehicleWarning {
            what: "inertia".into(),
            rule: format!(
                "part '{name}' has {moment} kg m² about every axis, which programs write where nobody gave an inertia"
            ),
            remedy: format!(
                "{} kg on arms of {} m have about {} kg m² (m arm²/3): take it from the CAD model with its masses.",
                short(total.mass),
                short(arm),
                short(usual)
            ),
        });
    }
    let mean = total.inertia.trace() / 3.0;
    let share = (mean / total.mass).sqrt() / arm;
    if within(GYRATION, share) {
        return None;
    }
    let fitting = INERTIAS.iter().filter(|(_, unit)| within([0.3, 6.0], mean * unit / usual));
    let mut remedy = read_as(fitting.map(|(name, unit)| (*name, format!("{} kg m²", short(mean * unit)))));
    if remedy.is_empty() {
        let factor = 10_f64.powf((usual / mean).log10().round());
        let word = if factor > 1.0 { "times" } else { "of" };
        remedy = format!("{} {word} it, {} kg m², would be usual. ", short(factor), short(mean * factor));
    }
    let [least, most] = GYRATION;
    Some(VehicleWarning {
        what: "inertia".into(),
        rule: format!(
            "{} kg m² (mean of the axes) of {} kg is a radius of gyration of {} arms, outside of {least} to {most}",
            short(mean),
            short(total.mass),
            short(share)
        ),
        remedy: remedy + "Write kg m².",
    })
}

/// The part with most of the mass, where its moments are one power of ten far from the usual moment.
fn placeholder(vehicle: &Vehicle, usual: f64) -> Option<(&str, f64)> {
    let part = vehicle.parts.iter().max_by(|a, b| a.mass.total_cmp(&b.mass))?;
    let Inertia { xx, yy, zz, .. } = part.inertia;
    let power = 10_f64.powf(xx.log10().round());
    let alike = [xx, yy, zz].iter().all(|moment| (moment / power - 1.0).abs() < 1e-9);
    let off = power / usual;
    (alike && !within([1.0 / PLACEHOLDER, PLACEHOLDER], off)).then_some((part.name.as_str(), power))
}

/// Speeds of blade tips, then thrust over weight.
fn rotors(vehicle: &Vehicle) -> Option<VehicleWarning> {
    let tip = |rotor: &Rotor| rotor.radius * rotor.max_speed;
    let rotor = first_most(vehicle, tip)?;
    let (speed, radius) = (rotor.max_speed, rotor.radius);
    if tip(rotor) <= FASTEST_TIP {
        return lift(vehicle);
    }
    let fits = |unit: f64| within([20.0, 300.0], tip(rotor) * unit);
    // blades far beyond the arms are not so long
    let remedy = if arm(vehicle).is_some_and(|arm| radius > 2.0 * arm) {
        let units = LENGTHS.into_iter().filter(|(_, unit)| fits(*unit));
        read_as(units.map(|(name, unit)| (name, format!("a radius of {} m", short(radius * unit)))))
    } else {
        let units = [("rev/min", RPM)].into_iter().filter(|(_, unit)| fits(*unit));
        read_as(units.map(|(name, unit)| (name, format!("{} rad/s", short(speed * unit)))))
    };
    Some(VehicleWarning {
        what: format!("rotor '{}'", rotor.name),
        rule: format!(
            "its blade tips turn at {} m/s ({} rad/s at a radius of {} m), faster than sound ({FASTEST_TIP})",
            short(tip(rotor)),
            short(speed),
            short(radius)
        ),
        remedy: remedy + "Write max_speed in rad/s and radius in m.",
    })
}

/// The first of the rotors that have most of something.
fn first_most(vehicle: &Vehicle, of: impl Fn(&Rotor) -> f64) -> Option<&Rotor> {
    vehicle.rotors.iter().rev().max_by(|a, b| of(a).total_cmp(&of(b)))
}

/// Thrust over weight.
fn lift(vehicle: &Vehicle) -> Option<VehicleWarning> {
    let ratio = vehicle.thrust_to_weight();
    if within(LIFT, ratio) {
        return None;
    }
    let units: [Unit; 4] = [
        ("a max_speed in rev/min", RPM * RPM),
        ("a largest thrust in grams", 1e-3 * GRAVITY),
        ("a max_speed in rev/s", TAU * TAU),
        ("a thrust_coefficient in N/(rev/min)²", 1.0 / (RPM * RPM)),
    ];
    let fitting = units.into_iter().filter(|(_, unit)| within([1.2, 15.0], ratio * unit));
    let remedy = read_as(fitting.map(|(name, unit)| (name, format!("{} times the weight", short(ratio * unit)))));
    let [least, most] = LIFT;
    Some(VehicleWarning {
        what: "thrust".into(),
        rule: format!("the rotors lift {} times the weight, outside of {least} to {most}", short(ratio)),
        remedy: remedy + "Write thrust_coefficient in N s²/rad², max_speed in rad/s and the mass in kg.",
    })
}

/// The slowest motor.
fn time_constants(vehicle: &Vehicle) -> Option<VehicleWarning> {
    let slow = |rotor: &Rotor| rotor.time_constant_up.max(rotor.time_constant_down);
    let rotor = first_most(vehicle, slow)?;
    let seconds = slow(rotor);
    (seconds > SLOWEST_MOTOR).then(|| VehicleWarning {
        what: format!("rotor '{}'", rotor.name),
        rule: format!("its motor has a time constant of {} s, above {SLOWEST_MOTOR}", short(seconds)),
        remedy: format!("Read as milliseconds, {} s. Write seconds.", short(1e-3 * seconds)),
    })
}

/// Rotors that push to a side or down.
fn direction(vehicle: &Vehicle) -> Option<VehicleWarning> {
    let all = || vehicle.rotors.iter().map(|r| Vector3::from(r.axis) * r.max_thrust());
    let thrust = all().sum::<Vector3<f64>>() / all().map(|t| t.norm()).sum::<f64>();
    let [x, y, z] = (thrust / thrust.norm()).into();
    // thrusts that cancel have no direction
    if thrust.norm() < 0.1 || z > LEAST_UP {
        return None;
    }
    let axes = [("x", x), ("y", y), ("z", z)];
    let along = axes.iter().find(|(_, share)| share.abs() > 0.999);
    let along = along.map_or_else(
        || format!("({}, {}, {})", short(x), short(y), short(z)),
        |(name, share)| format!("{}{name}", if *share < 0.0 { "−" } else { "" }),
    );
    // R = Ry(pitch) Rx(roll) takes the thrust to z; sums leave rounding errors and negative zeros
    let [y, z, x] = [y, z, x].map(|share| if share.abs() < 1e-12 { 0.0 } else { share });
    let (roll, pitch) = (y.atan2(z), -x.atan2(y.hypot(z)));
    Some(VehicleWarning {
        what: "thrust".into(),
        rule: format!("the rotors push along {along} of the base, not along z, which is up"),
        remedy: format!(
            "To stand it up, hang it on a new root link by a fixed joint with rpy=\"{} {} 0\".",
            roll,
            pitch + 0.0
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::super::vehicles;
    use super::*;
    use nalgebra::Rotation3;

    /// A vehicle whose masses, lengths and moments are given in other units.
    fn scaled(vehicle: &Vehicle, mass: f64, length: f64, moment: f64) -> Vehicle {
        let mut vehicle = vehicle.clone();
        for part in &mut vehicle.parts {
            part.mass *= mass;
            part.position = part.position.map(|x| x * length);
            part.inertia = Inertia::from_matrix(&(part.inertia.matrix() * moment));
        }
        for rotor in &mut vehicle.rotors {
            rotor.position = rotor.position.map(|x| x * length);
            rotor.radius *= length;
        }
        vehicle
    }

    /// The built-in vehicles as one part, so that a scaled inertia is that of all.
    fn merged() -> Vec<Vehicle> {
        let whole = |mut vehicle: Vehicle| {
            let total = vehicle.mass_properties();
            let part = &mut vehicle.parts[0];
            (part.mass, part.position) = (total.mass, total.center_of_mass.into());
            part.inertia = Inertia::from_matrix(&total.inertia);
            vehicle.parts.truncate(1);
            vehicle
        };
        vehicles::all().into_iter().map(whole).collect()
    }

    /// The one oddity.
    fn only(vehicle: &Vehicle) -> VehicleWarning {
        let found = vehicle.warnings();
        assert!(found.len() == 1, "{}: {found:#?}", vehicle.name);
        found[0].clone()
    }

    #[test]
    fn no_built_in_vehicle_is_odd() {
        for vehicle in vehicles::all().iter().chain(&merged()) {
            assert!(vehicle.warnings().is_empty(), "{}: {:?}", vehicle.name, vehicle.warnings());
        }
    }

    #[test]
    fn masses_in_grams_are_told_with_the_mass_in_kilograms() {
        for vehicle in vehicles::all().iter().chain(&merged()) {
            let kilograms = short(vehicle.mass_properties().mass);
            for moment in [1.0, 1e3] {
                let odd = only(&scaled(vehicle, 1e3, 1.0, moment));
                assert_eq!(odd.what, "mass");
                assert!(odd.remedy.starts_with(&format!("Read as grams, {kilograms} kg. ")), "{}: {odd}", vehicle.name);
            }
        }
    }

    #[test]
    fn lengths_in_millimetres_and_centimetres_are_told_with_the_arm_in_metres() {
        for vehicle in vehicles::all().iter().chain(&merged()) {
            let metres = format!("arms of {} m", short(arm(vehicle).unwrap()));
            for (name, factor) in [("millimetres", 1e3), ("centimetres", 1e2)] {
                for moment in [1.0, factor * factor] {
                    let odd = only(&scaled(vehicle, 1.0, factor, moment));
                    assert_eq!(odd.what, "lengths");
                    assert!(odd.remedy.contains(&format!("as {name}, {metres}")), "{}: {odd}", vehicle.name);
                }
            }
            // CAD in grams and millimetres
            let odd = only(&scaled(vehicle, 1e3, 1e3, 1e9));
            assert!(odd.remedy.contains("as grams and millimetres, "), "{}: {odd}", vehicle.name);
        }
    }

    #[test]
    fn moments_in_other_units_are_told_with_the_unit_or_the_factor() {
        for vehicle in merged() {
            let mean = vehicle.mass_properties().inertia.trace() / 3.0;
            for (unit, factor) in [("g m²", 1e3), ("kg mm²", 1e6), ("g mm²", 1e9)] {
                let odd = only(&scaled(&vehicle, 1.0, 1.0, factor));
                let reading = format!("as {unit}, {} kg m²", short(mean));
                assert!(odd.what == "inertia" && odd.remedy.contains(&reading), "{}: {odd}", vehicle.name);
            }
            for factor in [1e3, 1e6] {
                let odd = only(&scaled(&vehicle, 1.0, 1.0, 1.0 / factor));
                let usual = format!("{} times it, {} kg m², would be usual. ", short(factor), short(mean));
                assert!(odd.remedy.starts_with(&usual), "{}: {odd}", vehicle.name);
            }
        }
    }

    #[test]
    fn moments_of_one_power_of_ten_are_told_where_they_are_far_off() {
        for vehicle in merged() {
            let usual = USUAL * vehicle.mass_properties().mass * arm(&vehicle).unwrap().powi(2);
            for exponent in -6..=2 {
                let moment = 10_f64.powi(exponent);
                let mut made_up = vehicle.clone();
                made_up.parts[0].inertia = Inertia::diagonal(moment, moment, moment);
                let near = within([1.0 / PLACEHOLDER, PLACEHOLDER], moment / usual);
                let told = made_up.warnings().iter().any(|odd| odd.rule.contains("where nobody gave an inertia"));
                assert_eq!(told, !near, "{}: {moment} for {usual}", vehicle.name);
            }
        }
    }

    #[test]
    fn rotor_numbers_in_other_units_are_told() {
        for vehicle in vehicles::all() {
            let changed = |change: fn(&mut Rotor)| {
                let mut vehicle = vehicle.clone();
                vehicle.rotors.iter_mut().for_each(change);
                only(&vehicle).to_string()
            };
            let rotor = &vehicle.rotors[0];
            let (speed, radius) = (short(rotor.max_speed), short(rotor.radius));
            let slow = short(rotor.time_constant_up.max(rotor.time_constant_down));
            for (told, words) in [
                (changed(|r| r.max_speed /= RPM), format!("as rev/min, {speed} rad/s")),
                (changed(|r| r.radius *= 1e3), format!("as millimetres, a radius of {radius} m")),
                (changed(|r| (r.max_speed, r.radius) = (r.max_speed / RPM, 0.0)), "a max_speed in rev/min, ".into()),
                (changed(|r| r.thrust_coefficient *= RPM * RPM), "a thrust_coefficient in N/(rev/min)², ".into()),
                (
                    changed(|r| {
                        r.time_constant_up *= 1e3;
                        r.time_constant_down *= 1e3;
                    }),
                    format!("Read as milliseconds, {slow} s"),
                ),
            ] {
                assert!(told.contains(&words), "{}: {words}\n{told}", vehicle.name);
            }
        }
    }

    #[test]
    fn rotors_that_do_not_push_up_are_told_with_the_angles_that_stand_them_up() {
        let right = "1.5707963267948966";
        for vehicle in vehicles::all() {
            for (axis, along, rpy) in [
                ([0.0, 1.0, 0.0], "along y ", format!("{right} 0 0")),
                ([0.0, -1.0, 0.0], "along −y ", format!("-{right} 0 0")),
                ([1.0, 0.0, 0.0], "along x ", format!("0 -{right} 0")),
                ([-1.0, 0.0, 0.0], "along −x ", format!("0 {right} 0")),
                ([0.0, 0.0, -1.0], "along −z ", "3.141592653589793 0 0".to_string()),
            ] {
                let mut turned = vehicle.clone();
                turned.rotors.iter_mut().for_each(|r| r.axis = axis);
                let odd = only(&turned);
                assert!(odd.rule.contains(along) && odd.remedy.contains(&format!("rpy=\"{rpy}\"")), "{odd}");
            }
        }
    }

    #[test]
    fn the_angles_that_are_told_stand_up_what_lies_at_any_angle() {
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        for (roll, pitch) in (-6..=6).flat_map(|i| (-3..=3).map(move |j| (0.5 * f64::from(i), 0.5 * f64::from(j)))) {
            let turn = Rotation3::from_euler_angles(roll, pitch, 0.4);
            let mut lying = vehicle.clone();
            for rotor in &mut lying.rotors {
                rotor.axis = (turn * Vector3::from(rotor.axis)).into();
                rotor.position = (turn * Vector3::from(rotor.position)).into();
            }
            let up = turn * Vector3::z();
            let told = lying.warnings().into_iter().find(|odd| odd.rule.starts_with("the rotors push along"));
            assert_eq!(told.is_some(), up.z <= LEAST_UP, "{up:?}");
            let Some(told) = told else { continue };
            let angles = told.remedy.split('"').nth(1).unwrap().split(' ').map(|word| word.parse::<f64>().unwrap());
            let [roll, pitch, yaw] = angles.collect::<Vec<_>>().try_into().unwrap();
            let stood = Rotation3::from_euler_angles(roll, pitch, yaw) * up;
            // measured: 2.5e-16
            assert!((stood - Vector3::z()).norm() < 1e-12, "{stood:?}");
        }
    }
}
