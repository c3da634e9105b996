//! The rotor file: a small TOML beside the URDF (`quad.urdf` → `quad.rotors.toml`) for what URDF cannot say.
//!
//! ```toml
//! source = "data sheet of the motor, 2024"
//!
//! [defaults]                       # any rotor value; each rotor may override it
//! thrust_coefficient = 8.54858e-6  # N s²/rad²
//! moment_per_thrust = 0.016        # m; or torque_coefficient, N m s²/rad²
//! max_speed = 838.0                # rad/s; or max_thrust, N
//! time_constant_up = 0.0125        # s; or time_constant for both ways
//! time_constant_down = 0.025
//!
//! [[rotors]]
//! link = "rotor_0"                 # or joint = "…" (its child), or position = [x, y, z] alone
//! spin = 1                         # +1 turns counter-clockwise seen from +axis, -1 clockwise
//! ```
//!
//! Further tables: `[[parts]]` (extra masses, as [`Part`]), `[drag]` ([`Drag`]) and `[gains]` ([`Gains`]).

use super::fault::{clean, fault, in_file};
use super::schema::LARGEST;
use crate::vehicle::{Drag, Gains, MAX_ROTORS, Part};
use base::error::{Error, Result, suggestion};
use base::reader::{self, Mistake};
use serde::{Deserialize, Serialize};

/// Largest rotor file, bytes.
const LARGEST_FILE: usize = 1 << 20;

/// What URDF cannot say about a vehicle: a small TOML beside it (`quad.urdf` → `quad.rotors.toml`).
///
/// ```toml
/// source = "data sheet of the motor, 2024"
///
/// [defaults]                       # any rotor value; each rotor may override it
/// thrust_coefficient = 8.54858e-6  # N s²/rad²
/// moment_per_thrust = 0.016        # m; or torque_coefficient, N m s²/rad²
/// max_speed = 838.0                # rad/s; or max_thrust, N
/// time_constant_up = 0.0125        # s; or time_constant for both ways
/// time_constant_down = 0.025
///
/// [[rotors]]
/// link = "rotor_0"                 # or joint = "…" (its child), or position = [x, y, z] alone
/// spin = 1                         # +1 turns counter-clockwise seen from +axis, -1 clockwise
/// ```
///
/// Further tables: `[[parts]]` (extra masses, as [`Part`]), `[drag]` ([`Drag`]) and `[gains]` ([`Gains`]).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorFile {
    /// Where it was read from, for messages; not part of the text.
    #[serde(skip)]
    pub file: String,
    /// Name of the vehicle; without it the URDF's file name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Where the numbers come from.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
    /// Values that every rotor has unless it says otherwise; `name`, `link`, `joint` and `position` are not allowed.
    #[serde(default, skip_serializing_if = "is_default")]
    pub defaults: RotorEntry,
    /// The rotors, in the order of the action vector.
    #[serde(default)]
    pub rotors: Vec<RotorEntry>,
    /// Masses that the URDF leaves out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Part>,
    /// Drag of the airframe.
    #[serde(default, skip_serializing_if = "is_default")]
    pub drag: Drag,
    /// Gains of the cascade, where they are published.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gains: Option<Gains>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// One rotor, or the `[defaults]` of all. Units are those of [`Rotor`](crate::vehicle::Rotor).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorEntry {
    /// Unique name; without it the link's name, or `rotor_0`, `rotor_1`, ….
    pub name: Option<String>,
    /// The link that is this rotor.
    pub link: Option<String>,
    /// The joint whose child link is this rotor.
    pub joint: Option<String>,
    /// Hub in the base frame, m; without a link or joint it is required, with one it overrides.
    pub position: Option<[f64; 3]>,
    /// Thrust direction in the base frame, of any length; without it the joint's axis or the link's z.
    pub axis: Option<[f64; 3]>,
    /// +1 turns counter-clockwise seen from +axis, −1 clockwise.
    pub spin: Option<f64>,
    /// k_f, N s²/rad².
    pub thrust_coefficient: Option<f64>,
    /// κ = k_m/k_f, m.
    pub moment_per_thrust: Option<f64>,
    /// k_m, N m s²/rad², instead of `moment_per_thrust`.
    pub torque_coefficient: Option<f64>,
    /// Ω_max, rad/s.
    pub max_speed: Option<f64>,
    /// k_f Ω_max², N, instead of `max_speed`.
    pub max_thrust: Option<f64>,
    /// Motor time constant both ways, s.
    pub time_constant: Option<f64>,
    /// Motor time constant while speeding up, s.
    pub time_constant_up: Option<f64>,
    /// Motor time constant while slowing down, s.
    pub time_constant_down: Option<f64>,
    /// Moment of inertia about the axis, kg m²; 0 leaves its torques out.
    pub inertia: Option<f64>,
    /// Blade tip radius, m; 0 leaves the ground effect out.
    pub radius: Option<f64>,
    /// Rotor drag across the axis, N s²/(m rad).
    pub drag_coefficient: Option<f64>,
    /// Rotor drag along the axis, N s²/(m rad).
    pub axial_drag_coefficient: Option<f64>,
    /// Rolling moment, N s²/rad.
    pub rolling_coefficient: Option<f64>,
}

impl RotorFile {
    /// Reads the TOML; `file` is named in messages.
    ///
    /// # Errors
    /// [`Error::Limit`] above 1 MiB; [`Error::Format`] for what is no TOML, an unknown key (with the nearest known one), no rotor or too
    /// many, two keys for one quantity, and numbers beyond all sizes.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        if text.len() > LARGEST_FILE {
            let (value, limit) = (format!("{} bytes", text.len()), format!("{LARGEST_FILE} bytes"));
            return Err(Error::limit(
                format!("{file}: file size"),
                value,
                limit,
                "A rotor file has a few dozen lines.",
            ));
        }
        let mut parsed: Self = reader::of_text(text).map_err(|e| syntax(&e, text, file))?;
        parsed.file = file.to_string();
        parsed.check()?;
        Ok(parsed)
    }

    /// As TOML; [`RotorFile::parse`] reads it back equal, bit for bit.
    ///
    /// # Errors
    /// [`Error::Format`] for what TOML cannot hold; there is no such rotor file.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            fault(&self.file, "rotor file", format!("it cannot be written as TOML ({e})"), "Report this as a bug.")
        })
    }

    fn check(&self) -> Result<()> {
        let at = |rule: String, remedy: &str| Err(fault(&self.file, "[[rotors]]", rule, remedy));
        if self.rotors.is_empty() {
            return at(
                "there is no rotor".into(),
                "List each rotor under [[rotors]] with its link or position and spin.",
            );
        }
        if self.rotors.len() > MAX_ROTORS {
            return at(
                format!("there are {} rotors, over the limit of {MAX_ROTORS}", self.rotors.len()),
                "List fewer.",
            );
        }
        let defaults = &self.defaults;
        if defaults.name.is_some() || defaults.link.is_some() || defaults.joint.is_some() || defaults.position.is_some()
        {
            let rule = "it gives every rotor the same name, link, joint or position";
            return Err(fault(&self.file, "[defaults]", rule, "Move it into each [[rotors]]."));
        }
        defaults.check_pairs(&self.file, "[defaults]")?;
        self.rotors.iter().enumerate().try_for_each(|(i, rotor)| rotor.check_pairs(&self.file, &rotor.place(i)))?;
        self.check_numbers()
    }

    /// Extra parts, drag and gains: sizes that cannot overflow the sums made of them.
    fn check_numbers(&self) -> Result<()> {
        for (i, rotor) in self.rotors.iter().enumerate() {
            let place = rotor.place(i);
            check_size(&self.file, &place, "position", &rotor.position.unwrap_or_default(), -LARGEST)?;
            check_size(&self.file, &place, "axis", &rotor.axis.unwrap_or_default(), -LARGEST)?;
        }
        for (i, part) in self.parts.iter().enumerate() {
            let place = format!("[[parts]] {i} ('{}')", clean(&part.name));
            let tensor = part.inertia;
            check_size(&self.file, &place, "mass", &[part.mass], 0.0)?;
            check_size(&self.file, &place, "position", &part.position, -LARGEST)?;
            check_size(&self.file, &place, "inertia", &[tensor.xx, tensor.yy, tensor.zz], 0.0)?;
            check_size(&self.file, &place, "product of inertia", &[tensor.xy, tensor.xz, tensor.yz], -LARGEST)?;
            tensor.validate("it").map_err(|e| in_file(e, &self.file, &place))?;
        }
        let Drag { linear, quadratic, angular } = self.drag;
        for (name, values) in [("linear", linear), ("quadratic", quadratic), ("angular", angular)] {
            check_size(&self.file, "[drag]", name, &values, 0.0)?;
        }
        let Some(Gains { position, velocity, attitude, rate, integral }) = self.gains else { return Ok(()) };
        for (name, values) in [("position", position), ("velocity", velocity), ("attitude", attitude), ("rate", rate)] {
            check_size(&self.file, "[gains]", name, &values, 0.0)?;
        }
        check_size(&self.file, "[gains]", "integral", &integral, 0.0)?;
        Ok(())
    }
}

impl RotorEntry {
    /// `[[rotors]] 3 (link 'x')`, counted from 0 as the action vector is.
    pub(super) fn place(&self, index: usize) -> String {
        let tag = match (&self.name, &self.link, &self.joint) {
            (_, Some(link), _) => format!(" (link '{}')", clean(link)),
            (_, _, Some(joint)) => format!(" (joint '{}')", clean(joint)),
            (Some(name), _, _) => format!(" ('{}')", clean(name)),
            _ => String::new(),
        };
        format!("[[rotors]] {index}{tag}")
    }

    /// Two keys for one quantity contradict each other sooner or later.
    fn check_pairs(&self, file: &str, place: &str) -> Result<()> {
        let ways = self.time_constant_up.is_some() || self.time_constant_down.is_some();
        let moment = self.moment_per_thrust.is_some() && self.torque_coefficient.is_some();
        let pairs = [
            ("link", "joint", self.link.is_some() && self.joint.is_some()),
            ("moment_per_thrust", "torque_coefficient", moment),
            ("max_speed", "max_thrust", self.max_speed.is_some() && self.max_thrust.is_some()),
            ("time_constant", "time_constant_up or _down", self.time_constant.is_some() && ways),
        ];
        match pairs.into_iter().find(|pair| pair.2) {
            None => Ok(()),
            Some((a, b, _)) => {
                Err(fault(file, place, format!("both {a} and {b} are given"), "Keep one: they say the same thing."))
            }
        }
    }
}

/// Every value between `least` and [`LARGEST`]; NaN is not.
fn check_size(file: &str, place: &str, name: &str, values: &[f64], least: f64) -> Result<()> {
    match values.iter().find(|x| !(least..=LARGEST).contains(*x)) {
        None => Ok(()),
        Some(x) => {
            let sign = if least < 0.0 {
                format!("between -{LARGEST:e} and {LARGEST:e}")
            } else {
                format!("≥ 0 and at most {LARGEST:e}")
            };
            Err(fault(
                file,
                place,
                format!("{name} is {x:?}, but it must be finite, {sign}"),
                "Check sign and SI units.",
            ))
        }
    }
}

/// A TOML error with its line; an unknown key gets the nearest known one suggested.
fn syntax(error: &Mistake, text: &str, file: &str) -> Error {
    let place = match &error.span {
        None => "rotor file".to_string(),
        Some(span) => {
            let before = text.as_bytes().get(..span.start).unwrap_or_default();
            format!("line {}", 1 + before.iter().filter(|b| **b == b'\n').count())
        }
    };
    let message: String = error.message.chars().take(600).map(|c| if c.is_control() { ' ' } else { c }).collect();
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match quoted.split_first() {
        Some((name, known)) if message.starts_with("unknown field") => {
            let known: Vec<String> = known.iter().map(|s| s.to_string()).collect();
            let near = suggestion(name, &known);
            let remedy = format!("Known: {}.", known.join(", "));
            fault(file, place, format!("key '{}' is unknown{near}", clean(name)), remedy)
        }
        _ => fault(file, place, format!("it does not read as a rotor file: {message}"), "Correct this line."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: &str = "[defaults]\nmax_speed = 800\n[[rotors]]\nlink = 'a'\nspin = 1\n";

    #[test]
    fn whole_numbers_are_accepted_where_a_real_is_meant() {
        let file = RotorFile::parse(SHORT, "a.rotors.toml").unwrap();
        assert_eq!(file.defaults.max_speed, Some(800.0));
        assert_eq!(file.rotors[0].spin, Some(1.0));
    }

    #[test]
    fn an_unknown_key_names_its_line_and_the_nearest_known_key() {
        let text = SHORT.replace("max_speed", "max_sped");
        let error = RotorFile::parse(&text, "a.rotors.toml").unwrap_err().to_string();
        assert!(
            error.starts_with("a.rotors.toml: line 2: key 'max_sped' is unknown (did you mean 'max_speed'?)"),
            "{error}"
        );
    }

    #[test]
    fn two_keys_for_one_quantity_are_refused() {
        let text = SHORT.replace("spin = 1", "spin = 1\ntorque_coefficient = 1e-7\nmoment_per_thrust = 0.01");
        let error = RotorFile::parse(&text, "a.rotors.toml").unwrap_err().to_string();
        assert!(error.contains("[[rotors]] 0 (link 'a'): both moment_per_thrust and torque_coefficient"), "{error}");
    }

    #[test]
    fn a_rotor_file_survives_writing_and_reading_bit_for_bit() {
        let mut file = RotorFile::parse(SHORT, "f").unwrap();
        file.rotors[0].position = Some([0.1 + 0.2, -1.0 / 3.0, f64::MIN_POSITIVE]);
        file.rotors[0].thrust_coefficient = Some(8.54858e-6);
        file.source = "a \"quoted\"\nsource".into();
        assert_eq!(RotorFile::parse(&file.to_toml().unwrap(), "f").unwrap(), file);
    }
}
