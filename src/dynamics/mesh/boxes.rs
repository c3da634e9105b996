//! A tree over boxes, built from the top: its work is n log n whatever lies where.
//!
//! A set is cut where the surface area heuristic says (Wald 2007, with bins). That may split off one box at a time: below
//! [`CUT_BY_AREA`] levels sets are cut in halves, so that a tree has at most that many levels and 20 more for a million boxes.

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;

/// Levels within which sets are cut by area.
const CUT_BY_AREA: usize = 40;
/// Bins along an axis.
const BINS: usize = 16;
/// Most boxes of a leaf.
const LEAF: usize = 4;

/// A box with its middle.
#[derive(Clone, Copy)]
struct Item {
    own: Aabb,
    middle: [f32; 3],
    number: u32,
}

/// The tree of `boxes`, which are finite.
pub(super) fn tree(boxes: &[Aabb]) -> Bvh2 {
    let item = |(number, own): (usize, &Aabb)| {
        let (low, high) = (own.min.to_array(), own.max.to_array());
        Item { own: *own, middle: [0, 1, 2].map(|k| 0.5 * (low[k] + high[k])), number: number as u32 }
    };
    let mut items: Vec<Item> = boxes.iter().enumerate().map(item).collect();
    let mut nodes = Vec::with_capacity(2 * items.len() / LEAF + 1);
    nodes.push(Bvh2Node::default());
    // node, its boxes, its level; a stack, since recursion has none to spare
    let mut open = vec![(0, 0..items.len(), 0)];
    while let Some((node, range, level)) = open.pop() {
        let own = &mut items[range.clone()];
        let bound = bound(own);
        let cut = if own.len() <= LEAF { None } else { cut(own, level) };
        let Some(cut) = cut else {
            nodes[node] = Bvh2Node::new(bound, own.len() as u32, range.start as u32);
            continue;
        };
        let (first, middle) = (nodes.len(), range.start + cut);
        nodes[node] = Bvh2Node::new(bound, 0, first as u32);
        nodes.extend([Bvh2Node::default(); 2]);
        open.push((first, range.start..middle, level + 1));
        open.push((first + 1, middle..range.end, level + 1));
    }
    Bvh2 { nodes, primitive_indices: items.iter().map(|item| item.number).collect(), ..Bvh2::default() }
}

fn bound(items: &[Item]) -> Aabb {
    items.iter().fold(Aabb::empty(), |all, item| all.union(&item.own))
}

/// Puts those of the first part in front; how many they are, above 0 and below all.
fn cut(items: &mut [Item], level: usize) -> Option<usize> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for item in items.iter() {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(item.middle[k]), high[k].max(item.middle[k]));
        }
    }
    let widths = [0, 1, 2].map(|k| high[k] - low[k]);
    if level < CUT_BY_AREA
        && let Some((axis, bin)) = by_area(items, low, widths)
    {
        let scale = BINS as f32 / widths[axis];
        return Some(partition(items, |item| bin_of(item, axis, low, scale) < bin));
    }
    // in halves along the widest axis, of middles in one place too
    let axis = (0..3).max_by(|a, b| widths[*a].total_cmp(&widths[*b])).unwrap_or(0);
    let half = items.len() / 2;
    let place = |item: &Item| (item.middle[axis], item.number);
    items.select_nth_unstable_by(half, |a, b| {
        let ((x, i), (y, j)) = (place(a), place(b));
        x.total_cmp(&y).then(i.cmp(&j))
    });
    Some(half)
}

fn bin_of(item: &Item, axis: usize, low: [f32; 3], scale: f32) -> usize {
    (((item.middle[axis] - low[axis]) * scale) as usize).min(BINS - 1)
}

/// The axis and the bin in front of which a cut leaves the least area times number on both sides; none where all middles are one.
fn by_area(items: &[Item], low: [f32; 3], widths: [f32; 3]) -> Option<(usize, usize)> {
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|k| widths[*k] > 1e-7) {
        let scale = BINS as f32 / widths[axis];
        let mut bins = [(Aabb::empty(), 0_u32); BINS];
        for item in items {
            let (own, n) = &mut bins[bin_of(item, axis, low, scale)];
            (*own, *n) = (own.union(&item.own), *n + 1);
        }
        let grown = |all: &mut (Aabb, u32), bin: &(Aabb, u32)| {
            *all = (all.0.union(&bin.0), all.1 + bin.1);
            Some(if all.1 == 0 { (0.0, 0) } else { (all.0.half_area() * all.1 as f32, all.1) })
        };
        let left: Vec<(f32, u32)> = bins.iter().scan((Aabb::empty(), 0), grown).collect();
        let mut right: Vec<(f32, u32)> = bins.iter().rev().scan((Aabb::empty(), 0), grown).collect();
        right.reverse();
        for bin in 1..BINS {
            let ((a, n), (b, m)) = (left[bin - 1], right[bin]);
            if n > 0 && m > 0 && best.is_none_or(|(least, ..)| a + b < least) {
                best = Some((a + b, axis, bin));
            }
        }
    }
    best.map(|(_, axis, bin)| (axis, bin))
}

/// Puts items for which it is so in front; how many they are.
fn partition(items: &mut [Item], is_first: impl Fn(&Item) -> bool) -> usize {
    let mut n = 0;
    for i in 0..items.len() {
        if is_first(&items[i]) {
            items.swap(n, i);
            n += 1;
        }
    }
    n
}
