//! Upright trunks across a corridor, and new places for them in every episode.

use super::draw::{count, range, stream};
use crate::scene::{Obstacle, Scene};
use crate::shape::{Geometry, MAX_SIZE, Shape, within};
use base::error::{Error, Result};
use rng::Stream;
use serde::{Deserialize, Serialize};

/// How far below the ground a trunk lies that does not stand in an episode, m.
const SUNK: f64 = 1000.0;

/// A forest: `trunks` capsules between x = `clear[0]` and `length` − `clear[1]`, |y| ≤ `width`/2.
///
/// They stand in columns across the way, one after another in x with a jitter within each column's share, and in each column
/// where uniform draws put them in y: of all ways to keep the gap within a column each is equally likely. Any two trunks
/// leave `gap` between their surfaces, and there is no straight lane along x by construction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Forest {
    /// Another seed, another forest.
    pub seed: u64,
    /// Along x, m.
    pub length: f64,
    /// Along y, m.
    pub width: f64,
    /// Without a trunk at the beginning and at the end, m.
    pub clear: [f64; 2],
    /// How many; see [`density`](Self::density).
    pub trunks: usize,
    /// Least and largest radius of a trunk, m.
    pub radius: [f64; 2],
    /// Of the trunks, m.
    pub height: f64,
    /// Least way between two trunks, m.
    pub gap: f64,
}

impl Default for Forest {
    /// 45 trunks of radius 0.2 to 0.3 m on 24 m × 12 m (0.16 per m²), 0.8 m apart, 5 m high, 2 m free at the start.
    fn default() -> Self {
        Self {
            seed: 0,
            length: 24.0,
            width: 12.0,
            clear: [2.0, 1.0],
            trunks: 45,
            radius: [0.2, 0.3],
            height: 5.0,
            gap: 0.8,
        }
    }
}

impl Forest {
    /// Trunks per m² of the whole corridor.
    pub fn density(&self) -> f64 {
        self.trunks as f64 / (self.length * self.width)
    }

    /// The forest of its seed: trunks named `trunk 0` and so on, in no order of place.
    ///
    /// # Errors
    /// As [`validate`](Self::validate).
    pub fn scene(&self) -> Result<Scene> {
        self.validate()?;
        let mut stream = stream(self.seed);
        let trunk = |i: usize, stream: &mut Stream| {
            let radius = stream.uniform(self.radius[0], self.radius[1]);
            let shape = Shape::new(Geometry::Capsule { radius, length: self.height });
            Obstacle { name: format!("trunk {i}"), shape: shape.at([0.0, 0.0, 0.5 * self.height]) }
        };
        let mut obstacles: Vec<Obstacle> = (0..self.trunks).map(|i| trunk(i, &mut stream)).collect();
        let mut places = vec![0.0; 3 * self.trunks];
        self.place(&obstacles, self.trunks, &mut stream, &mut places);
        for (obstacle, place) in obstacles.iter_mut().zip(places.chunks_exact(3)) {
            (obstacle.shape.position[0], obstacle.shape.position[1]) = (place[0], place[1]);
        }
        Ok(Scene { obstacles, ..Scene::grounded() })
    }

    /// Draws new places for `trunks` of a forest with these settings: offsets from where they stand in the scene, three per
    /// trunk, as the scene's placement wants them from [`placement_index`](Scene::placement_index) on. The first `standing`
    /// of them stand (all at most), the others lie out of the way, deep below the ground. Guarantees are those of
    /// [`scene`](Self::scene). Allocates nothing.
    ///
    /// ```
    /// # use omnidrones_dynamics::omnidrones;
    /// use omnidrones::dynamics::scene::Forest;
    /// use omnidrones::rng::{Purpose, Stream};
    /// let forest = Forest::default();
    /// let scene = forest.scene()?;
    /// let mut placement = scene.nominal_placement();
    /// forest.place(&scene.obstacles, 40, &mut Stream::new(1, 0, 7, Purpose::TASK), &mut placement);
    /// assert!(scene.distance(&placement, [1.0, 0.0, 2.0]) > 1.0);
    /// # Ok::<(), omnidrones::error::Error>(())
    /// ```
    ///
    /// # Panics
    /// On a slice that has not three numbers per trunk, and on settings that [`validate`](Self::validate) refuses.
    pub fn place(&self, trunks: &[Obstacle], standing: usize, stream: &mut Stream, offsets: &mut [f64]) {
        assert!(offsets.len() == 3 * trunks.len(), "{} numbers for {} trunks", offsets.len(), trunks.len());
        let n = standing.min(trunks.len());
        let spacing = self.spacing();
        let [length, width] = self.room();
        let columns = self.columns(n);
        let pitch = (length + spacing) / columns as f64;
        // which trunk stands where is drawn too, or each would keep to its column
        let shift = stream.below(n.max(1) as u64) as usize;
        let at = |slot: usize| 3 * ((slot + shift) % n);
        for column in 0..columns {
            let (first, end) = ((column * n).div_ceil(columns), ((column + 1) * n).div_ceil(columns));
            let free = width - (end - first).saturating_sub(1) as f64 * spacing;
            let begin = self.clear[0] + self.radius[1] + pitch * column as f64;
            for slot in first..end {
                offsets[at(slot)] = begin + stream.uniform(0.0, pitch - spacing);
                let y = stream.uniform(0.0, free);
                let mut k = slot;
                while k > first && offsets[at(k - 1) + 1] > y {
                    offsets[at(k) + 1] = offsets[at(k - 1) + 1];
                    k -= 1;
                }
                offsets[at(k) + 1] = y;
            }
            for slot in first..end {
                offsets[at(slot) + 1] += (slot - first) as f64 * spacing - 0.5 * width;
            }
        }
        for (i, (trunk, offset)) in trunks.iter().zip(offsets.chunks_exact_mut(3)).enumerate() {
            let [x, y, _] = trunk.shape.position;
            if i < n {
                offset.copy_from_slice(&[offset[0] - x, offset[1] - y, 0.0]);
            } else {
                offset.copy_from_slice(&[0.0, 0.0, -SUNK]);
            }
        }
    }

    /// Least distance of two axes, m.
    fn spacing(&self) -> f64 {
        2.0 * self.radius[1] + self.gap
    }

    /// Where axes may stand, m.
    fn room(&self) -> [f64; 2] {
        let wall = 2.0 * self.radius[1];
        [self.length - self.clear[0] - self.clear[1] - wall, self.width - wall]
    }

    /// How many columns at most, and trunks in each.
    fn capacity(&self) -> [usize; 2] {
        self.room().map(|room| if room < 0.0 { 0 } else { (room / self.spacing()) as usize + 1 })
    }

    /// Of `n` trunks: as many as make their shares square.
    fn columns(&self, n: usize) -> usize {
        let [length, width] = self.room().map(|room| room + self.spacing());
        let [most, rows] = self.capacity();
        let even = (n as f64 * length / width).sqrt().round() as usize;
        even.clamp(n.div_ceil(rows).max(1), most)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Value`] for a size out of range; [`Error::Limit`] for more trunks than find room with the gap asked for.
    pub fn validate(&self) -> Result<()> {
        within("forest: length", self.length, 1.0, MAX_SIZE)?;
        within("forest: width", self.width, 0.5, MAX_SIZE)?;
        within("forest: clear[0]", self.clear[0], 0.0, MAX_SIZE)?;
        within("forest: clear[1]", self.clear[1], 0.0, MAX_SIZE)?;
        range("forest: radius", self.radius, 0.01, 10.0)?;
        within("forest: height", self.height, 0.1, 1000.0)?;
        within("forest: gap", self.gap, 0.0, 1000.0)?;
        count("forest: trunks", self.trunks)?;
        let [columns, rows] = self.capacity();
        if self.trunks <= columns * rows {
            return Ok(());
        }
        let [length, width] = self.room().map(|x| x.max(0.0));
        let what = "forest: trunks";
        let limit = format!(
            "{} with radius {} m and a gap of {} m on {length:.1} m by {width:.1} m",
            columns * rows,
            self.radius[1],
            self.gap
        );
        Err(Error::limit(what, self.trunks, limit, "Ask for fewer trunks, a smaller gap or a larger forest."))
    }
}
