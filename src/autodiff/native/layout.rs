//! Where the arguments and results of a program lie, so that it works in place.

use base::error::{Error, Result};
use std::collections::HashSet;

/// Most arrays of a layout: as many as there are registers for their addresses.
#[doc(hidden)]
pub const MAX_ARRAYS: usize = 6;

/// Most rows of an array: code reaches two gibibytes from its beginning, and a row has 256 bytes at most.
#[doc(hidden)]
pub const MAX_ROWS: usize = 1 << 22;

/// A row of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Place {
    /// Number of the array, 0 to 5.
    pub array: u8,
    /// Number of the row in it, from 0.
    pub row: u32,
}

/// Rows of an array that a program works on.
#[derive(Debug)]
pub enum Rows<'a, R> {
    /// To read arguments.
    Read(&'a [R]),
    /// To write results, and to read arguments.
    Write(&'a mut [R]),
}

impl<R> Rows<'_, R> {
    /// To read.
    pub(super) fn rows(&self) -> &[R] {
        match self {
            Self::Read(rows) => rows,
            Self::Write(rows) => rows,
        }
    }
}

/// In which array and row each argument is read and each result is written.
///
/// A row is one number, or one of each environment. A result may be written over an argument: it is, when the argument is read for
/// the last time.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct RowLayout {
    /// Rows that an array has at least.
    n_row: Vec<u32>,
    /// Whether results are written to an array.
    is_written: Vec<bool>,
    arguments: Vec<Place>,
    results: Vec<Place>,
}

impl RowLayout {
    /// Arguments and results at these places.
    ///
    /// # Errors
    /// [`Error::Value`] where two results share a place, [`Error::Limit`] for an array above 5 and for a row of 2²² or above
    /// (`MAX_ROWS`).
    pub fn new(arguments: Vec<Place>, results: Vec<Place>) -> Result<Self> {
        let places = || arguments.iter().chain(&results);
        let n_array = places().map(|place| usize::from(place.array) + 1).max().unwrap_or(0);
        if n_array > MAX_ARRAYS {
            return Err(Error::limit(
                "number of arrays of a layout",
                n_array,
                MAX_ARRAYS,
                "Put rows together in one array.",
            ));
        }
        if let Some(row) = places().map(|place| place.row as usize).find(|row| *row >= MAX_ROWS) {
            return Err(Error::limit("row of a layout", row, MAX_ROWS - 1, "Put rows that are used close together."));
        }
        let mut taken = HashSet::with_capacity(results.len());
        if let Some((k, place)) = results.iter().enumerate().find(|(_, place)| !taken.insert(**place)) {
            let what = format!("place of result {k}");
            let value = format!("row {} of array {}, another result's", place.row, place.array);
            return Err(Error::value(what, value, "of one result alone", "Give every result a row of its own."));
        }
        let (mut n_row, mut is_written) = (vec![0; n_array], vec![false; n_array]);
        for place in places() {
            let rows: &mut u32 = &mut n_row[usize::from(place.array)];
            *rows = (*rows).max(place.row + 1);
        }
        results.iter().for_each(|place| is_written[usize::from(place.array)] = true);
        Ok(Self { n_row, is_written, arguments, results })
    }

    /// Arguments are the rows of array 0 in order, results those of array 1.
    pub fn apart(n_argument: usize, n_result: usize) -> Self {
        let rows = |array, n: usize| (0..n as u32).map(|row| Place { array, row }).collect();
        Self {
            n_row: vec![n_argument as u32, n_result as u32],
            is_written: vec![false, true],
            arguments: rows(0, n_argument),
            results: rows(1, n_result),
        }
    }

    /// Number of arrays.
    pub fn n_array(&self) -> usize {
        self.n_row.len()
    }

    /// Rows that an array has at least.
    ///
    /// # Panics
    /// If there is no such array.
    pub fn n_row(&self, array: usize) -> usize {
        self.n_row[array] as usize
    }

    /// Whether results are written to an array.
    ///
    /// # Panics
    /// If there is no such array.
    pub fn is_written(&self, array: usize) -> bool {
        self.is_written[array]
    }

    /// Where each argument is read, in the order of the program's inputs.
    pub fn arguments(&self) -> &[Place] {
        &self.arguments
    }

    /// Where each result is written, in the order of the program's results.
    pub fn results(&self) -> &[Place] {
        &self.results
    }
}
