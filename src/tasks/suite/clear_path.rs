//! A way among upright trunks, for controllers that know where they stand: A* over a grid (Hart, Nilsson and Raphael 1968), cut
//! short where the view is free.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Edge of a cell, m.
const CELL: f64 = 0.25;
/// No finer than this are ways told, m, and by no more parts than these, turns aside.
const STRIDE: f64 = 1.0;
const PARTS: f64 = 30.0;
/// What a step costs where nothing but the least distance is kept, per metre, more than where there is `WIDE` more of it.
const NARROW: f64 = 2.0;
/// m.
const WIDE: f64 = 0.4;

/// Corners that are looked ahead at once.
const AHEAD: usize = 24;

/// A circle that is to be kept away from: x, y, and the least distance from there, m.
pub(super) type Circle = [f64; 3];

/// From one point of the plane to another within [`low`, `high`] and outside of all circles: corners a metre apart at most,
/// both ends included. `None` where there is no such way.
pub(super) fn clear_path(
    from: [f64; 2],
    to: [f64; 2],
    bounds: [[f64; 2]; 2],
    circles: &[Circle],
) -> Option<Vec<[f64; 2]>> {
    let grid = Grid::new(bounds, circles);
    let mut corners = grid.search(from, to)?;
    (corners[0], *corners.last_mut()?) = (from, to);
    Some(subdivided(&shortened(&corners, circles)))
}

struct Grid {
    low: [f64; 2],
    n: [usize; 2],
    /// Per cell: what a metre costs there; infinite where nobody may be.
    cost: Vec<f64>,
}

/// A cell that may be gone on from; the cheapest is the greatest.
struct Open {
    estimate: f64,
    cell: usize,
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Open {}
impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.estimate.total_cmp(&self.estimate).then(other.cell.cmp(&self.cell))
    }
}

impl Grid {
    fn new([low, high]: [[f64; 2]; 2], circles: &[Circle]) -> Self {
        let n = [0, 1].map(|k| ((high[k] - low[k]) / CELL).clamp(0.0, 4000.0) as usize + 1);
        let mut grid = Self { low, n, cost: Vec::new() };
        grid.cost = (0..n[0] * n[1])
            .map(|cell| {
                let free = clearance(grid.place(cell), circles);
                if free < 0.0 { f64::INFINITY } else { 1.0 + NARROW * (1.0 - free / WIDE).max(0.0) }
            })
            .collect();
        grid
    }

    fn place(&self, cell: usize) -> [f64; 2] {
        let at = [cell % self.n[0], cell / self.n[0]];
        [0, 1].map(|k| self.low[k] + CELL * at[k] as f64)
    }

    fn cell(&self, place: [f64; 2]) -> usize {
        let at = [0, 1].map(|k| (((place[k] - self.low[k]) / CELL).round().max(0.0) as usize).min(self.n[k] - 1));
        at[0] + at[1] * self.n[0]
    }

    /// Cells beside one, with their distances.
    fn beside(&self, cell: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let (x, y) = ((cell % self.n[0]) as isize, (cell / self.n[0]) as isize);
        let steps = (-1..=1).flat_map(|i| (-1..=1).map(move |k| (i, k))).filter(|step| *step != (0, 0));
        steps.filter_map(move |(i, k)| {
            let (x, y) = (usize::try_from(x + i).ok()?, usize::try_from(y + k).ok()?);
            let inside = x < self.n[0] && y < self.n[1];
            inside.then(|| (x + y * self.n[0], CELL * f64::from((i * i + k * k) as i32).sqrt()))
        })
    }

    fn search(&self, from: [f64; 2], to: [f64; 2]) -> Option<Vec<[f64; 2]>> {
        let (start, goal) = (self.cell(from), self.cell(to));
        let (mut spent, mut before) = (vec![f64::INFINITY; self.cost.len()], vec![usize::MAX; self.cost.len()]);
        let mut open = BinaryHeap::from([Open { estimate: 0.0, cell: start }]);
        spent[start] = 0.0;
        while let Some(Open { cell, .. }) = open.pop() {
            if cell == goal {
                let mut cells = vec![goal];
                while *cells.last()? != start {
                    cells.push(before[*cells.last()?]);
                }
                return Some(cells.iter().rev().map(|cell| self.place(*cell)).collect());
            }
            for (next, distance) in self.beside(cell) {
                let cost = spent[cell] + distance * self.cost[next];
                if cost < spent[next] {
                    (spent[next], before[next]) = (cost, cell);
                    let left = distance_of(self.place(next), self.place(goal));
                    open.push(Open { estimate: cost + left, cell: next });
                }
            }
        }
        None
    }
}

fn distance_of(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Least distance to what is to be kept away from, m; negative where one is too near.
fn clearance(at: [f64; 2], circles: &[Circle]) -> f64 {
    circles.iter().fold(f64::INFINITY, |least, c| least.min(distance_of(at, [c[0], c[1]]) - c[2]))
}

/// Least [`clearance`] of a straight way.
fn clearance_between(a: [f64; 2], b: [f64; 2], circles: &[Circle]) -> f64 {
    let n = (distance_of(a, b) / (0.5 * CELL)).ceil().max(1.0) as usize;
    let at = |i: usize| [0, 1].map(|k| a[k] + (b[k] - a[k]) * i as f64 / n as f64);
    (0..=n).fold(f64::INFINITY, |least, i| least.min(clearance(at(i), circles)))
}

/// Without corners that a straight way as free as theirs leaves out.
fn shortened(corners: &[[f64; 2]], circles: &[Circle]) -> Vec<[f64; 2]> {
    let mut kept = vec![corners[0]];
    let mut at = 0;
    while at + 1 < corners.len() {
        let least = |to: usize| {
            let own = corners[at..=to].iter().fold(f64::INFINITY, |least, c| least.min(clearance(*c, circles)));
            own.clamp(0.0, 0.5 * WIDE)
        };
        let straight = |to: &usize| clearance_between(corners[at], corners[*to], circles) >= least(*to);
        at = (at + 1..corners.len()).take(AHEAD).take_while(straight).last().unwrap_or(at + 1);
        kept.push(corners[at]);
    }
    kept
}

/// With corners between those that are more than a stride apart.
fn subdivided(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let length: f64 = corners.windows(2).map(|pair| distance_of(pair[0], pair[1])).sum();
    let stride = STRIDE.max(length / PARTS);
    let mut all = vec![corners[0]];
    for pair in corners.windows(2) {
        let n = (distance_of(pair[0], pair[1]) / stride).ceil().max(1.0) as usize;
        all.extend((1..=n).map(|i| [0, 1].map(|k| pair[0][k] + (pair[1][k] - pair[0][k]) * i as f64 / n as f64)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_keeps_away_from_all_circles_or_is_none() {
        let circles: Vec<Circle> =
            (0..40).map(|i| [2.0 + 0.5 * f64::from(i), 3.0 * (1.7 * f64::from(i)).sin(), 0.7]).collect();
        let bounds = [[0.0, -6.0], [24.0, 6.0]];
        let path = clear_path([0.0, 0.0], [24.0, 1.0], bounds, &circles).unwrap();
        assert_eq!((path[0], *path.last().unwrap()), ([0.0, 0.0], [24.0, 1.0]));
        for pair in path.windows(2) {
            assert!(distance_of(pair[0], pair[1]) <= STRIDE + 1e-9);
            // cells are tested at their middles: what lies between loses an eighth of a cell at most
            assert!(clearance_between(pair[0], pair[1], &circles) > -0.05, "{pair:?}");
        }
        let far = clear_path([0.0, 0.0], [200.0, 1.0], [[0.0, -6.0], [200.0, 6.0]], &circles).unwrap();
        assert!(far.len() <= 60, "a controller's path takes 64 points, not {}", far.len()); // 38
        let wall: Vec<Circle> = (0..30).map(|i| [12.0, -6.0 + 0.4 * f64::from(i), 0.5]).collect();
        assert!(clear_path([0.0, 0.0], [24.0, 0.0], bounds, &wall).is_none());
    }
}
