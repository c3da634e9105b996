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
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// One kind of scene with its settings; as TOML, a table with `kind = "forest"` and the keys of [`Forest`] that differ
/// from its defaults.
///
/// ```
/// # use omnidrones_dynamics::omnidrones;
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
