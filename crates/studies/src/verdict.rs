//! Whether what was published of algorithms holds here.

use crate::plan::{Cell, Claim, Plan};

/// What is known of a row.
pub struct Outcome<'a> {
    /// Which row.
    pub cell: &'a Cell,
    /// Mean return as a share of that of our controller; none while seeds are missing.
    pub share: Option<f64>,
    /// Mean of the steps that it was trained for.
    pub steps: f64,
}

/// How a row did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    Flies,
    Fails,
    /// By fewer steps than another row had that flies the task.
    FailsEarly,
}

impl Plan {
    /// Whether a statement holds, and on how many tasks each of its algorithms flies.
    pub fn judge(&self, claim: &Claim, rows: &[Outcome<'_>]) -> (&'static str, String) {
        let own =
            |row: &&Outcome<'_>| claim.parts.contains(&row.cell.part) && claim.algorithms.contains(&row.cell.algorithm);
        let mut found: Vec<(String, Vec<Option<Found>>)> = Vec::new();
        for row in rows.iter().filter(own) {
            let label = row.cell.label();
            match found.iter_mut().find(|(name, _)| *name == label) {
                Some((_, all)) => all.push(self.found(row, rows)),
                None => found.push((label, vec![self.found(row, rows)])),
            }
        }
        let count = |all: &[Option<Found>], what: Found| all.iter().flatten().filter(|own| **own == what).count();
        let told = |(name, all): &(String, Vec<Option<Found>>)| {
            let early = match count(all, Found::FailsEarly) {
                0 => String::new(),
                n => format!(" ({n} of the others by fewer steps than a row that does)"),
            };
            format!("{name} flies {} of {}{early}", count(all, Found::Flies), all.iter().flatten().count())
        };
        let words = found.iter().map(told).collect::<Vec<_>>().join("; ");
        if found.iter().any(|(_, all)| all.contains(&None)) {
            return ("not decided: rows or our controllers are missing", words);
        }
        let holds = |of_early: usize| {
            let flown = |all: &[Option<Found>]| count(all, Found::Flies) + of_early * count(all, Found::FailsEarly);
            let mut each = found.iter().map(|(_, all)| (flown(all), all.len()));
            if claim.flies { each.all(|(n, of)| 2 * n > of) } else { each.all(|(n, _)| n == 0) }
        };
        let verdict = match (holds(0), holds(1)) {
            (true, true) => "holds",
            (false, false) => "does not hold",
            _ => "not decided: others that fly had more steps",
        };
        (verdict, words)
    }

    /// How a whole row with our controller beside it did; a failure is known to be one when all rows of the task are whole.
    fn found(&self, row: &Outcome<'_>, rows: &[Outcome<'_>]) -> Option<Found> {
        let flies = |row: &Outcome<'_>| Some(row.share? >= self.flies);
        if flies(row)? {
            return Some(Found::Flies);
        }
        let place = |row: &Outcome<'_>| (row.cell.part.clone(), row.cell.config.task.clone());
        let mut later = false;
        for other in rows.iter().filter(|other| place(other) == place(row)) {
            later |= flies(other)? && other.steps > row.steps;
        }
        Some(if later { Found::FailsEarly } else { Found::Fails })
    }
}
