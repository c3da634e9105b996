//! Which elements, attributes and numbers URDF has (the ROS wiki's XML specification, and `urdfdom`'s additions).

/// What an attribute holds.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Kind {
    /// A name or path; checked for length.
    Text,
    /// This many numbers, finite and at most [`LARGEST`] in size.
    Numbers(usize),
    /// One number without physical meaning here (joint limits of ±1e16 are common); only finiteness is checked.
    Loose,
}

/// Whether and how often.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Times {
    /// At most once.
    Optional,
    /// Exactly once.
    Once,
    /// Any number of times.
    Many,
    /// Known, but not used by this import; its content is not looked at.
    Unused,
}

/// Largest magnitude of a length, mass, inertia or angle, in SI units: nothing that flies needs more.
pub(super) const LARGEST: f64 = 1e9;

/// One element.
pub(super) struct Rule {
    /// Tag name.
    pub element: &'static str,
    /// Name, content, and whether it is required.
    pub attributes: &'static [(&'static str, Kind, bool)],
    /// Tag name and how often.
    pub children: &'static [(&'static str, Times)],
}

use Kind::{Loose, Numbers, Text};
use Times::{Many, Once, Optional, Unused};

const fn rule(
    element: &'static str,
    attributes: &'static [(&'static str, Kind, bool)],
    children: &'static [(&'static str, Times)],
) -> Rule {
    Rule { element, attributes, children }
}

/// The table; the first row is the root element.
pub(super) const SCHEMA: &[Rule] = &[
    rule(
        "robot",
        &[("name", Text, false), ("version", Text, false)],
        &[
            ("link", Many),
            ("joint", Many),
            ("material", Many),
            ("properties", Optional),
            ("transmission", Unused),
            ("gazebo", Unused),
            ("sensor", Unused),
        ],
    ),
    rule("properties", &[], &[]),
    rule(
        "link",
        &[("name", Text, true), ("type", Text, false)],
        &[("inertial", Optional), ("visual", Many), ("collision", Many)],
    ),
    rule("inertial", &[], &[("origin", Optional), ("mass", Once), ("inertia", Once)]),
    rule("origin", &[("xyz", Numbers(3), false), ("rpy", Numbers(3), false), ("quat_xyzw", Numbers(4), false)], &[]),
    rule("mass", &[("value", Numbers(1), true)], &[]),
    rule(
        "inertia",
        &[
            ("ixx", Numbers(1), true),
            ("ixy", Numbers(1), true),
            ("ixz", Numbers(1), true),
            ("iyy", Numbers(1), true),
            ("iyz", Numbers(1), true),
            ("izz", Numbers(1), true),
        ],
        &[],
    ),
    rule("visual", &[("name", Text, false)], &[("origin", Optional), ("geometry", Once), ("material", Optional)]),
    rule("collision", &[("name", Text, false)], &[("origin", Optional), ("geometry", Once), ("verbose", Unused)]),
    rule(
        "geometry",
        &[],
        &[("box", Optional), ("cylinder", Optional), ("capsule", Optional), ("sphere", Optional), ("mesh", Optional)],
    ),
    rule("box", &[("size", Numbers(3), true)], &[]),
    rule("cylinder", &[("radius", Numbers(1), true), ("length", Numbers(1), true)], &[]),
    rule("capsule", &[("radius", Numbers(1), true), ("length", Numbers(1), true)], &[]),
    rule("sphere", &[("radius", Numbers(1), true)], &[]),
    rule("mesh", &[("filename", Text, true), ("scale", Numbers(3), false)], &[]),
    rule("material", &[("name", Text, true)], &[("color", Optional), ("texture", Optional)]),
    rule("color", &[("rgba", Numbers(4), true)], &[]),
    rule("texture", &[("filename", Text, true)], &[]),
    rule(
        "joint",
        &[("name", Text, true), ("type", Text, true)],
        &[
            ("parent", Once),
            ("child", Once),
            ("origin", Optional),
            ("axis", Optional),
            ("limit", Optional),
            ("calibration", Optional),
            ("dynamics", Optional),
            ("mimic", Optional),
            ("safety_controller", Optional),
        ],
    ),
    rule("parent", &[("link", Text, true)], &[]),
    rule("child", &[("link", Text, true)], &[]),
    rule("axis", &[("xyz", Numbers(3), true)], &[]),
    rule(
        "limit",
        &[
            ("lower", Loose, false),
            ("upper", Loose, false),
            ("effort", Loose, false),
            ("velocity", Loose, false),
            ("acceleration", Loose, false),
            ("deceleration", Loose, false),
            ("jerk", Loose, false),
        ],
        &[],
    ),
    rule("calibration", &[("rising", Loose, false), ("falling", Loose, false)], &[]),
    rule("dynamics", &[("damping", Loose, false), ("friction", Loose, false)], &[]),
    rule("mimic", &[("joint", Text, true), ("multiplier", Loose, false), ("offset", Loose, false)], &[]),
    rule(
        "safety_controller",
        &[
            ("soft_lower_limit", Loose, false),
            ("soft_upper_limit", Loose, false),
            ("k_position", Loose, false),
            ("k_velocity", Loose, true),
        ],
        &[],
    ),
];

/// The row of an element.
pub(super) fn find(element: &str) -> Option<&'static Rule> {
    SCHEMA.iter().find(|rule| rule.element == element)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_child_that_is_looked_into_has_a_row() {
        for rule in SCHEMA {
            for (child, times) in rule.children {
                assert!(*times == Unused || find(child).is_some(), "<{child}> in <{}>", rule.element);
            }
        }
    }
}
