//! Scenes drawn from seeds: the same settings and seed give the same scene, to the bit, on every machine.
//!
//! | file | kind | what |
//! |---|---|---|
//! | `draw` | | what all of them draw with, and check |
//! | `forest` | `forest` | upright trunks across a corridor, never closer than a gap; a new forest per episode as a placement |
//! | `corridor` | `corridor` | two walls along a way with bends |
//! | `rooms` | `rooms` | rooms side by side, all of them joined by doors |
//! | `course` | `gates` | gates along a winding way |
//! | `rubble` | `rubble` | blocks, tilted and half sunk |
//! | `terrain` | `terrain` | smooth hills and hollows |
//!
//! What leads somewhere begins at x = 0 and leads along +x, y to the left; the ground is at z = 0, that of a terrain passes
//! through the origin.

mod corridor;
mod course;
mod draw;
mod forest;
mod rooms;
mod rubble;
mod terrain;

pub use corridor::Corridor;
pub use course::Course;
pub use forest::Forest;
pub use rooms::Rooms;
pub use rubble::Rubble;
pub use terrain::Terrain;

use super::Scene;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// One kind of scene with its settings; as TOML, a table with `kind = "forest"` and the keys of [`Forest`] that differ
/// from its defaults.
///
/// ```
/// use omnidrones::dynamics::scene::Generator;
/// let scene = Generator::parse("forest:3")?.scene()?;
/// assert_eq!(scene.obstacles.len(), 45);
/// # Ok::<(), omnidrones::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Generator {
    /// Trunks.
    Forest(Forest),
    /// Two walls.
    Corridor(Corridor),
    /// Walls with doors.
    Rooms(Rooms),
    /// Gates in order.
    Gates(Course),
    /// Blocks.
    Rubble(Rubble),
    /// Hills.
    Terrain(Terrain),
}

/// One line per kind: name and what it is.
pub const KINDS: [(&str, &str); 6] = [
    ("forest", "upright trunks across 24 m by 12 m"),
    ("corridor", "two walls along a way with bends"),
    ("rooms", "rooms side by side, joined by doors"),
    ("gates", "gates along a winding way"),
    ("rubble", "blocks, tilted and half sunk"),
    ("terrain", "smooth hills and hollows"),
];

impl Generator {
    /// `KIND` or `KIND:SEED` with the default settings, seed 0 where it is left out.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest kind; [`Error::Value`] for a seed that is no whole number.
    pub fn parse(text: &str) -> Result<Self> {
        let (kind, seed) = text.split_once(':').unwrap_or((text, "0"));
        let number = seed.parse::<u64>();
        let seed = number.map_err(|_| {
            let remedy = "Write it as forest:3, or leave it out for 0.";
            Error::value(
                format!("scene '{kind}': seed"),
                format!("'{seed}'"),
                "a whole number from 0 to 2^64 - 1",
                remedy,
            )
        });
        match kind {
            "forest" => Ok(Self::Forest(Forest { seed: seed?, ..Forest::default() })),
            "corridor" => Ok(Self::Corridor(Corridor { seed: seed?, ..Corridor::default() })),
            "rooms" => Ok(Self::Rooms(Rooms { seed: seed?, ..Rooms::default() })),
            "gates" => Ok(Self::Gates(Course { seed: seed?, ..Course::default() })),
            "rubble" => Ok(Self::Rubble(Rubble { seed: seed?, ..Rubble::default() })),
            "terrain" => Ok(Self::Terrain(Terrain { seed: seed?, ..Terrain::default() })),
            _ => Err(Error::Unknown {
                kind: "scene",
                name: kind.into(),
                known: KINDS.iter().map(|(name, _)| name.to_string()).collect(),
            }),
        }
    }

    /// As in a file: `forest`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Forest(_) => "forest",
            Self::Corridor(_) => "corridor",
            Self::Rooms(_) => "rooms",
            Self::Gates(_) => "gates",
            Self::Rubble(_) => "rubble",
            Self::Terrain(_) => "terrain",
        }
    }

    /// The scene of these settings.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for settings out of range, and for more than finds room.
    pub fn scene(&self) -> Result<Scene> {
        match self {
            Self::Forest(forest) => forest.scene(),
            Self::Corridor(corridor) => corridor.scene(),
            Self::Rooms(rooms) => rooms.scene(),
            Self::Gates(course) => course.scene(),
            Self::Rubble(rubble) => rubble.scene(),
            Self::Terrain(terrain) => terrain.scene(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_a_default_that_is_valid_and_depends_on_its_seed_alone() {
        for (kind, _) in KINDS {
            let drawn = |text: &str| Generator::parse(text).unwrap().scene().unwrap();
            let (zero, again, one) = (drawn(kind), drawn(&format!("{kind}:0")), drawn(&format!("{kind}:1")));
            zero.validate().unwrap();
            assert_eq!(zero, again, "{kind}");
            assert_ne!(zero, one, "{kind}");
            let things = zero.gates.len() + zero.obstacles.len();
            assert!(zero.relief.is_some() || (zero.ground == Some(0.0) && things > 7), "{kind}");
            assert_eq!(Generator::parse(kind).unwrap().kind(), kind);
        }
    }

    #[test]
    fn every_kind_leaves_the_start_free() {
        for (kind, _) in KINDS.iter().filter(|(kind, _)| !["rubble", "terrain"].contains(kind)) {
            for seed in 0..20 {
                let scene = Generator::parse(&format!("{kind}:{seed}")).unwrap().scene().unwrap();
                let gap = scene.distance(&scene.nominal_placement(), [0.5, 0.0, 1.0]);
                assert!(gap > 0.6, "{kind}:{seed}: {gap} m");
            }
        }
    }

    #[test]
    fn a_kind_nobody_knows_and_a_seed_that_is_none_are_errors_with_a_remedy() {
        let told = |text: &str| Generator::parse(text).unwrap_err().to_string();
        assert!(told("forrest:1").contains("did you mean 'forest'?"), "{}", told("forrest"));
        let text = told("forest:-1");
        assert!(text.starts_with("scene 'forest': seed is '-1', but it must be a whole number"), "{text}");
    }
}
