//! A grid of heights as a closed mesh: two triangles per cell, walls at the border, a floor.

use super::check::{Triangles, check_count};
use crate::shape::within;
use base::error::{Error, Result, finite};

/// How far the floor is below the lowest height, m.
const FLOOR: f64 = 1.0;

/// The mesh of `heights[i][j]` at x = j `spacing[0]`, y = i `spacing[1]`.
pub(super) fn closed(what: &str, heights: &[Vec<f64>], spacing: [f64; 2]) -> Result<Triangles> {
    let (rows, columns) = (heights.len(), heights.first().map_or(0, Vec::len));
    check(what, heights, spacing)?;
    let at = |i: usize, j: usize| (i * columns + j) as u32;
    let place = |i: usize, j: usize, z: f64| [j as f64 * spacing[0], i as f64 * spacing[1], z];
    let mut vertices = Vec::with_capacity(rows * columns + 2 * (rows + columns));
    for (i, row) in heights.iter().enumerate() {
        vertices.extend(row.iter().enumerate().map(|(j, z)| place(i, j, *z)));
    }
    let mut triangles = Vec::with_capacity(count(rows, columns));
    for i in 0..rows - 1 {
        for j in 0..columns - 1 {
            let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let border = border(rows, columns);
    let floor = heights.iter().flatten().fold(f64::INFINITY, |low, z| low.min(*z)) - FLOOR;
    let first = vertices.len() as u32;
    vertices.extend(border.iter().map(|[i, j]| place(*i, *j, floor)));
    let middle = vertices.len() as u32;
    vertices.push([0.5 * (columns - 1) as f64 * spacing[0], 0.5 * (rows - 1) as f64 * spacing[1], floor]);
    for (k, [i, j]) in border.iter().enumerate() {
        let next = (k + 1) % border.len();
        let (top, top_next) = (at(*i, *j), at(border[next][0], border[next][1]));
        let (low, low_next) = (first + k as u32, first + next as u32);
        triangles.extend([[top_next, top, low], [top_next, low, low_next], [low_next, low, middle]]);
    }
    Ok(Triangles { vertices, triangles })
}

/// How many triangles it comes to.
fn count(rows: usize, columns: usize) -> usize {
    let cells = (rows - 1).saturating_mul(columns - 1);
    cells.saturating_mul(2).saturating_add(6 * (rows + columns - 2))
}

/// Rows and columns of the border, counter-clockwise seen from above, each once.
fn border(rows: usize, columns: usize) -> Vec<[usize; 2]> {
    let (last_row, last_column) = (rows - 1, columns - 1);
    let ahead = (0..last_column).map(|j| [0, j]);
    let left = (0..last_row).map(|i| [i, last_column]);
    let back = (1..=last_column).rev().map(|j| [last_row, j]);
    let right = (1..=last_row).rev().map(|i| [i, 0]);
    ahead.chain(left).chain(back).chain(right).collect()
}

fn check(what: &str, heights: &[Vec<f64>], spacing: [f64; 2]) -> Result<()> {
    let (rows, columns) = (heights.len(), heights.first().map_or(0, Vec::len));
    if rows < 2 || columns < 2 {
        let limit = "2 x 2 or more";
        return Err(Error::value(
            format!("{what}: heights"),
            format!("{rows} x {columns}"),
            limit,
            "Give a row per y.",
        ));
    }
    for (i, row) in heights.iter().enumerate() {
        if row.len() != columns {
            let limit = format!("{columns}, as of the first row");
            return Err(Error::value(format!("{what}: length of heights[{i}]"), row.len(), limit, "Fill it up."));
        }
        finite(&format!("{what}: heights[{i}]"), row)?;
    }
    for k in 0..2 {
        within(&format!("{what}: spacing[{k}]"), spacing[k], 1e-6, 1e4)?;
    }
    check_count(what, count(rows, columns))
}
