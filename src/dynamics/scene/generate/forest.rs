//! Upright trunks across a corridor, and new places for them in every episode.

use super::draw::{count, range, stream};
use crate::dynamics::scene::{Obstacle, Scene};
use crate::dynamics::shape::{Geometry, MAX_SIZE, Shape, within};
use crate::error::{Error, Result};
use crate::rng::Stream;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    /// Checks gaps and edges of the first `standing` trunks of a placement.
    fn check(forest: &Forest, scene: &Scene, placement: &[f64], standing: usize) -> f64 {
        let places: Vec<_> = (0..standing).map(|i| scene.obstacle_pose(placement, i).position).collect();
        let radius = |i: usize| match scene.obstacles[i].shape.geometry {
            Geometry::Capsule { radius, .. } => radius,
            _ => unreachable!("trunks are capsules"),
        };
        let mut least = f64::INFINITY;
        for i in 0..standing {
            let ([x, y, z], r) = (places[i], radius(i));
            assert!(x - r >= forest.clear[0] - 1e-12 && x + r <= forest.length - forest.clear[1] + 1e-12, "x {x}");
            assert!(y.abs() + r <= 0.5 * forest.width + 1e-12 && z == 0.5 * forest.height, "y {y}, z {z}");
            for k in 0..i {
                least = least.min((x - places[k][0]).hypot(y - places[k][1]) - r - radius(k));
            }
        }
        assert!(least >= forest.gap - 1e-12, "a gap of {least} m");
        least
    }

    #[test]
    fn trunks_keep_their_gap_and_the_start_free_in_every_forest_and_placement() {
        let full = Forest { trunks: 135, ..Forest::default() };
        for forest in [Forest::default(), full, Forest { trunks: 1, ..full }, Forest { gap: 0.0, trunks: 300, ..full }]
        {
            let scene = forest.scene().unwrap();
            let mut placement = scene.nominal_placement();
            check(&forest, &scene, &placement, forest.trunks);
            let mut least = f64::INFINITY;
            for episode in 0..200 {
                let standing = forest.trunks - (episode as usize * forest.trunks) / 250;
                let mut stream = Stream::new(5, 3, episode, Purpose::TASK);
                forest.place(&scene.obstacles, standing, &mut stream, &mut placement);
                least = least.min(check(&forest, &scene, &placement, standing));
                for i in standing..forest.trunks {
                    assert!(scene.obstacle_pose(&placement, i).position[2] < -900.0);
                }
            }
            println!("{} trunks, {:.3} per m²: least gap {least:.3} m", forest.trunks, forest.density());
        }
    }

    #[test]
    fn no_straight_lane_is_free_in_every_forest() {
        // in how many of 200 forests a ball of 0.3 m radius gets through along a line y = constant
        let forest = Forest::default();
        let scene = forest.scene().unwrap();
        let mut placement = scene.nominal_placement();
        let mut free = [0; 41];
        for episode in 0..200 {
            forest.place(&scene.obstacles, 45, &mut Stream::new(2, 0, episode, Purpose::TASK), &mut placement);
            for (k, free) in free.iter_mut().enumerate() {
                let y = -5.0 + 0.25 * k as f64;
                let hit = (0..45).any(|i| {
                    let pose = scene.obstacle_pose(&placement, i);
                    (pose.position[1] - y).abs() < 0.3 + 0.25
                });
                *free += usize::from(!hit);
            }
        }
        let most = free.iter().max().unwrap();
        // measured 9 of 200
        println!("the freest lane is free in {most} of 200 forests");
        assert!(*most < 20, "{free:?}");
    }

    #[test]
    fn placements_are_those_of_their_stream_and_every_trunk_gets_everywhere() {
        let forest = Forest::default();
        let scene = forest.scene().unwrap();
        let (mut a, mut b) = (scene.nominal_placement(), scene.nominal_placement());
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for episode in 0..100 {
            for out in [&mut a, &mut b] {
                forest.place(&scene.obstacles, 45, &mut Stream::new(2, 0, episode, Purpose::TASK), out);
            }
            assert_eq!(a, b);
            let x = scene.obstacle_pose(&a, 7).position[0];
            (least, most) = (least.min(x), most.max(x));
        }
        // measured 2.3 to 22.5 m
        println!("trunk 7 from {least:.1} to {most:.1} m");
        assert!(least < 4.0 && most > 20.0);
    }

    #[test]
    fn a_density_that_cannot_be_placed_is_refused_with_the_number_that_can() {
        let text = Forest { trunks: 136, ..Forest::default() }.scene().unwrap_err().to_string();
        let want =
            "forest: trunks is 136, over the limit of 135 with radius 0.3 m and a gap of 0.8 m on 20.4 m by 11.4 m";
        assert!(text.starts_with(want), "{text}");
        let text = Forest { clear: [20.0, 5.0], ..Forest::default() }.scene().unwrap_err().to_string();
        assert!(text.contains("over the limit of 0 with"), "{text}");
        let text = Forest { radius: [0.3, 0.2], ..Forest::default() }.scene().unwrap_err().to_string();
        assert!(text.starts_with("forest: radius is [0.3, 0.2], but it must be [least, most]"), "{text}");
    }
}
