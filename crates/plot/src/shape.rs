//! Marks that tell lines apart where colours do not: in grey, in print, for the colour-blind.

use super::canvas::{Canvas, Point};
use super::theme::Colour;

/// Number of shapes.
pub(super) const SHAPES: usize = 7;
/// Half the width of a mark on a line, units.
pub(super) const SIZE: f64 = 3.0;

/// Draws the `i`-th shape about a point: disc, square, triangle, diamond, triangle upside down, cross, plus.
pub(super) fn draw(canvas: &mut Canvas, i: usize, (x, y): Point, colour: Colour) {
    let at = |points: &[(f64, f64)]| points.iter().map(|(u, v)| (x + SIZE * u, y - SIZE * v)).collect::<Vec<Point>>();
    let mut strokes = |ends: [[(f64, f64); 2]; 2]| ends.iter().for_each(|line| canvas.line(&at(line), colour, 1.3));
    match i % SHAPES {
        0 => canvas.disc((x, y), 0.85 * SIZE, colour),
        1 => canvas.polygon(at(&[(-0.8, -0.8), (0.8, -0.8), (0.8, 0.8), (-0.8, 0.8)]), colour),
        2 => canvas.polygon(at(&[(-1.0, -0.75), (1.0, -0.75), (0.0, 1.05)]), colour),
        3 => canvas.polygon(at(&[(0.0, -1.15), (1.15, 0.0), (0.0, 1.15), (-1.15, 0.0)]), colour),
        4 => canvas.polygon(at(&[(-1.0, 0.75), (1.0, 0.75), (0.0, -1.05)]), colour),
        5 => strokes([[(-0.9, -0.9), (0.9, 0.9)], [(-0.9, 0.9), (0.9, -0.9)]]),
        _ => strokes([[(-1.1, 0.0), (1.1, 0.0)], [(0.0, -1.1), (0.0, 1.1)]]),
    }
}
