//! A Jacobian as one machine code over lanes, of which each is a row.

use super::Sweep;
use crate::columns::{LINE, Lines};
use crate::lanes::{Kernel, Lanes, dispatch, lane_width};
use crate::native::policy::MAX_WHOLE;
use crate::native::{Code, Place, RowLayout, Rows, availability, code};
use crate::program::{Program, Value, ValueForm};
use crate::trace::chain::{Chain, Head};
use base::error::Result;
use std::sync::Arc;

/// Machine code, and the rows that it works on: x, the same in every lane; a seed per lane; then what it makes.
#[derive(Debug, Clone)]
pub(super) struct Whole {
    code: Code,
    slots: Lines,
    rows: Lines,
    n_input: usize,
    /// Rows of the Jacobian side by side.
    width: usize,
    parts: Parts,
}

/// What stands in the rows behind the seeds, and where it belongs in the Jacobian.
#[derive(Debug, Clone, Default)]
struct Parts {
    /// From where a register goes, in ascending order.
    columns: Vec<u32>,
    /// To where the number of any lane goes.
    entries: Vec<u32>,
}

/// Swept results that follow each other.
struct Group {
    first: u32,
    n: usize,
}

impl Whole {
    /// Nothing where no code may be made, or it would be larger than [`MAX_WHOLE`].
    pub(super) fn of(sweep: &Sweep, chain: &Chain) -> Result<Option<Self>> {
        let width = lane_width() / 2;
        let groups = groups(&sweep.rows, width);
        let n_most = sweep.values.len() + groups.len() * sweep.edges.by_slot.len();
        if availability().is_err() || n_most > MAX_WHOLE {
            return Ok(None);
        }
        let n_input = chain.values.n_input;
        let (form, parts) = form_of(sweep, chain, &groups, width)?;
        let n_row = n_input + width + form.results.len();
        let places = |rows: std::ops::Range<usize>| rows.map(|row| Place { array: 0, row: row as u32 }).collect();
        let layout = RowLayout::new(places(0..n_input + width), places(n_input + width..n_row))?;
        let Ok(code) = code::<[f64; LINE]>(&Arc::new(form), &layout) else { return Ok(None) };
        let mut rows = Lines::zeros(n_row);
        rows[n_input..n_input + width].iter_mut().enumerate().for_each(|(lane, row)| row[lane] = 1.0);
        Ok(Some(Self { slots: code.slots(), code, rows, n_input, width, parts }))
    }

    /// As [`Sweep::jacobian`].
    pub(super) fn jacobian(&mut self, x: &[f64], jacobian: &mut [f64]) {
        assert_eq!(x.len(), self.n_input, "inputs of the recording");
        for (row, x) in self.rows.iter_mut().zip(x) {
            *row = [*x; LINE];
        }
        let is_run = self.code.run(&mut self.slots, &mut [Rows::Write(&mut self.rows)], self.width);
        assert!(is_run, "rows of the code");
        dispatch(Write {
            parts: &self.parts,
            width: self.width,
            rows: &self.rows[self.n_input + self.width..],
            jacobian,
        });
    }
}

/// From rows into the Jacobian. Sums of the sweep begin with 0, which turns −0 into 0.
struct Write<'a> {
    parts: &'a Parts,
    width: usize,
    rows: &'a [[f64; LINE]],
    jacobian: &'a mut [f64],
}

impl Kernel for Write<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { parts: Parts { columns, entries }, width, rows, jacobian } = self;
        jacobian.fill(0.0);
        let (n, zero, one) = (columns.len(), L::splat(0.0), L::splat(1.0));
        for k in 0..n {
            let (at, row) = (columns[k] as usize, &rows[k]);
            // whole registers where they fit: lanes without a row are zeros, which the next part is written over
            if at + width <= jacobian.len() {
                L::wide_mut(&mut jacobian[at..at + width])[0] = L::add_product(zero, one, L::wide(row)[0]);
            } else {
                for lane in 0..jacobian.len() - at {
                    jacobian[at + lane] = 0.0 + row[lane];
                }
            }
        }
        for k in 0..entries.len() {
            jacobian[entries[k] as usize] = 0.0 + rows[n + k][0];
        }
    }
}

/// As few as there can be.
fn groups(rows: &[u32], width: usize) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for row in rows {
        match groups.last_mut() {
            Some(group) if group.n < width && group.first + group.n as u32 == *row => group.n += 1,
            _ => groups.push(Group { first: *row, n: 1 }),
        }
    }
    groups
}

/// x, seeds → per input and group the sum, then the weights that are entries.
fn form_of(sweep: &Sweep, chain: &Chain, groups: &[Group], width: usize) -> Result<(ValueForm, Parts)> {
    let n_input = chain.values.n_input;
    let mut weights = sweep.weights.clone();
    weights.n_input += width;
    let mut form = Program::code_form(&weights)?;
    let weights = std::mem::take(&mut form.results);
    let weight = |number: u32| weights[number as usize - sweep.n_result];
    let mut sums: Vec<Vec<Option<Value>>> = Vec::with_capacity(chain.vertices.len());
    let mut columns: Vec<(u32, Value)> = Vec::new();
    for vertex in &chain.vertices {
        let mut own = vec![None; groups.len()];
        for (head, number) in &vertex.edges {
            for (k, (sum, group)) in own.iter_mut().zip(groups).enumerate() {
                let from = match head {
                    Head::Vertex(before) => sums[*before as usize][k],
                    Head::Result(result) => result
                        .checked_sub(group.first)
                        .filter(|lane| (*lane as usize) < group.n)
                        .map(|lane| Value(n_input as u32 + lane)),
                };
                if let Some(from) = from {
                    *sum = Some(form.add_product(*sum, weight(*number), from));
                }
            }
        }
        if let Some(input) = vertex.input {
            for (group, sum) in groups.iter().zip(&own) {
                let at = input * sweep.n_result as u32 + group.first;
                columns.extend(sum.map(|sum| (at, sum)));
            }
        }
        sums.push(own);
    }
    columns.sort_by_key(|(at, _)| *at);
    let entries = sweep.direct.iter().map(|d| d.input * sweep.n_result as u32 + d.result).collect();
    form.results.extend(columns.iter().map(|(_, sum)| *sum));
    form.results.extend(sweep.direct.iter().map(|d| weights[usize::from(d.weight)]));
    Ok((form, Parts { columns: columns.into_iter().map(|(at, _)| at).collect(), entries }))
}
