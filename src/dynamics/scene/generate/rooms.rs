//! Rooms side by side, all of them joined by doors.

use super::draw::{block, count, stream};
use crate::scene::{Obstacle, Scene};
use crate::shape::within;
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// Rooms on a grid, the first about the origin, the others towards +x and +y. A random tree of doors joins all of them; of
/// the other inner walls each has a door with the probability `loops`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rooms {
    /// Another seed, other doors.
    pub seed: u64,
    /// Along x and along y.
    pub rooms: [usize; 2],
    /// Of one room from the middle of a wall to that of the opposite one, m.
    pub size: [f64; 2],
    /// Of the walls, m.
    pub height: f64,
    /// Of the walls, m.
    pub thickness: f64,
    /// Width and height of a door, m.
    pub door: [f64; 2],
    /// Share of the other inner walls with a door, 0 to 1.
    pub loops: f64,
}

impl Default for Rooms {
    /// 3 × 2 rooms of 4 m × 4 m, walls 2.5 m high, doors 1 m × 2 m, a fifth more of them than needed.
    fn default() -> Self {
        Self { seed: 0, rooms: [3, 2], size: [4.0; 2], height: 2.5, thickness: 0.1, door: [1.0, 2.0], loops: 0.2 }
    }
}

/// Most rooms along one axis.
const MOST: usize = 30;

impl Rooms {
    /// The rooms of its seed.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let joined = self.tree(&mut stream);
        let mut scene = Scene::grounded();
        let [nx, ny] = self.rooms;
        for axis in 0..2 {
            // walls across `axis`: one more than rooms along it
            let (lines, rows) = if axis == 0 { (nx, ny) } else { (ny, nx) };
            for line in 0..=lines {
                for row in 0..rows {
                    let inner = (1..lines).contains(&line);
                    let cell = |k: usize| if axis == 0 { k + row * nx } else { row + k * nx };
                    let has_door =
                        inner && (joined.contains(&[cell(line - 1), cell(line)]) || stream.unit() < self.loops);
                    self.wall(axis, [line, row], has_door.then(|| stream.unit()), &mut scene.obstacles);
                }
            }
        }
        Ok(scene)
    }

    /// Pairs of rooms that doors must join so that all can be reached: a random tree, grown room by room.
    fn tree(&self, stream: &mut Stream) -> Vec<[usize; 2]> {
        let [nx, ny] = self.rooms;
        let (mut reached, mut joined) = (vec![false; nx * ny], Vec::new());
        reached[0] = true;
        let mut way = vec![0_usize];
        while let Some(here) = way.last().copied() {
            let (i, k) = (here % nx, here / nx);
            let mut next = Vec::new();
            next.extend((i > 0).then(|| here - 1));
            next.extend((i + 1 < nx).then(|| here + 1));
            next.extend((k > 0).then(|| here - nx));
            next.extend((k + 1 < ny).then(|| here + nx));
            next.retain(|room| !reached[*room]);
            if next.is_empty() {
                way.pop();
                continue;
            }
            let there = next[stream.below(next.len() as u64) as usize];
            reached[there] = true;
            joined.push([here.min(there), here.max(there)]);
            way.push(there);
        }
        joined
    }

    /// The wall across `axis` on a grid line and in a row: whole, or beside and above a door that stands at a share of what
    /// the wall leaves free.
    fn wall(&self, axis: usize, [line, row]: [usize; 2], door: Option<f64>, walls: &mut Vec<Obstacle>) {
        let (across, along) = (self.size[axis], self.size[1 - axis]);
        let [x, y] = [(line as f64 - 0.5) * across, row as f64 * along];
        let name = |part: &str| format!("{part} {}{line}.{row}", ["x", "y"][axis]);
        let mut put = |name: String, [from, to]: [f64; 2], [low, high]: [f64; 2]| {
            let (center, size) = ([x, y + 0.5 * (from + to)], [self.thickness, to - from]);
            let turn = |[a, b]: [f64; 2], z: f64| if axis == 0 { [a, b, z] } else { [b, a, z] };
            walls.push(block(name, turn(center, 0.5 * (low + high)), turn(size, high - low), 0.0));
        };
        // corners are closed by walls that reach through each other
        let end = 0.5 * (along + self.thickness);
        let Some(share) = door else {
            put(name("wall"), [-end, end], [0.0, self.height]);
            return;
        };
        let [width, height] = self.door;
        let room = along - self.thickness - width;
        let from = 0.5 * (self.thickness - along) + share * room;
        put(name("wall before"), [-end, from], [0.0, self.height]);
        put(name("wall behind"), [from + width, end], [0.0, self.height]);
        if height < self.height {
            put(name("lintel"), [from, from + width], [height, self.height]);
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] or [`Error::Limit`] for a size out of range, and for doors that do not fit into their walls.
    pub fn validate(&self) -> Result<()> {
        for n in self.rooms {
            if !(1..=MOST).contains(&n) {
                return Err(Error::limit("rooms: rooms", n, format!("1 to {MOST} along an axis"), "Ask for fewer."));
            }
        }
        let [nx, ny] = self.rooms;
        count("rooms: walls", 3 * ((nx + 1) * ny + (ny + 1) * nx))?;
        for k in 0..2 {
            within(&format!("rooms: size[{k}]"), self.size[k], 0.2, 1000.0)?;
            within(&format!("rooms: door[{k}]"), self.door[k], 0.05, 1000.0)?;
        }
        within("rooms: height", self.height, 0.1, 1000.0)?;
        within("rooms: thickness", self.thickness, 0.001, 10.0)?;
        within("rooms: loops", self.loops, 0.0, 1.0)?;
        let widest = self.size[0].min(self.size[1]) - self.thickness;
        if self.door[0] >= widest {
            let limit = format!("below {widest} m, the free width of a wall");
            return Err(Error::value("rooms: door[0]", self.door[0], limit, "Ask for narrower doors or larger rooms."));
        }
        Ok(())
    }
}
