//! Which number broke where an environment stopped: looked for there and then, and nowhere else.

use super::kernel::{ALIVE, DIVERGED_ABOVE, REPORTED, UNCHECKED};
use super::plant::{BatchPlant, PlantBlock, Rows};
use crate::plant::Quantity;
use autodiff::program::BLOCK;
use std::fmt;

/// The number that stopped an environment.
#[derive(Debug, Clone, PartialEq)]
pub struct Breach {
    /// What it is of which body, joint or rotor: `rate of joint 'elbow'`.
    pub quantity: String,
    /// SI; `-` for a pure number.
    pub unit: &'static str,
    /// What it came to.
    pub value: f32,
    /// Its largest healthy magnitude.
    pub limit: f32,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { quantity, unit, value, limit } = self;
        let unit = if *unit == "-" { String::new() } else { format!(" {unit}") };
        // of numbers that exploded nobody reads forty digits
        let number = |x: f32| if x.abs() < 1e5 { x.to_string() } else { format!("{x:.3e}") };
        if value.is_finite() {
            write!(f, "{quantity} is {}{unit}, beyond ±{}{unit}", number(*value), number(*limit))
        } else {
            write!(f, "{quantity} is {value}, not a finite number")
        }
    }
}

/// A [`Breach`] before it is put into words: the place among [`BatchPlant::words`], value and limit.
#[derive(Debug, Clone, Copy)]
pub struct RawBreach {
    pub place: u32,
    pub value: f32,
    pub limit: f32,
}

impl RawBreach {
    /// The number farthest beyond its limit. Infinity is farther than any, and what is no number at all follows from one
    /// that is none: it counts where nothing else broke, by what it was `before`.
    #[doc(hidden)]
    pub fn of(
        limits: impl Iterator<Item = (usize, f32)>,
        before: &[[f32; BLOCK]],
        after: &[[f32; BLOCK]],
        lane: usize,
    ) -> Option<Self> {
        let mut worst = None;
        for (row, limit) in limits {
            let (was, is) = (before[row][lane], after[row][lane]);
            if is.abs() < limit {
                continue;
            }
            let rank = if is.is_nan() { (false, was.abs() / limit) } else { (true, is.abs() / limit) };
            if worst.is_none_or(|(most, _)| rank > most) {
                worst = Some((rank, Self { place: row as u32, value: is, limit }));
            }
        }
        worst.map(|(_, culprit)| culprit)
    }

    #[doc(hidden)]
    pub fn in_words(self, words: &[Quantity]) -> Breach {
        let Quantity { name, unit } = &words[self.place as usize];
        Breach { quantity: name.clone(), unit, value: self.value, limit: self.limit }
    }
}

impl BatchPlant {
    /// What the step that stopped these lanes of a block would have led to, into `after`; the block is as it was.
    #[doc(hidden)]
    pub fn follow(&self, block: &mut PlantBlock, lanes: u64, after: &mut Rows) {
        after.copy_from_slice(&block.rows);
        for (lane, alive) in block.rows[self.alive_row()].iter_mut().enumerate() {
            *alive = if lanes >> lane & 1 == 1 { UNCHECKED } else { REPORTED };
        }
        self.step(std::slice::from_mut(block));
        std::mem::swap(&mut block.rows, after);
    }

    /// The number of a lane that is not what a healthy state of any plant holds.
    #[doc(hidden)]
    pub fn exploded(&self, before: &Rows, after: &Rows, lane: usize) -> Option<RawBreach> {
        RawBreach::of((0..self.n_state()).map(|row| (row, DIVERGED_ABOVE as f32)), before, after, lane)
    }

    /// The action that is no number.
    pub(crate) fn wrong_action(&self, actions: &[f32]) -> Option<RawBreach> {
        let k = actions.iter().position(|a| a.is_nan())?;
        Some(RawBreach { place: (self.n_state() + k) as u32, value: actions[k], limit: ALIVE })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_farthest_beyond_is_to_blame_and_what_is_no_number_only_alone() {
        let rows = |numbers: [f32; 3]| numbers.map(|x| [x; BLOCK]);
        let of = |before, after| {
            let limits = [(0, 200.0), (1, 50.0), (2, 300.0)].into_iter();
            RawBreach::of(limits, &rows(before), &rows(after), 3).map(|c| c.place)
        };
        assert_eq!(of([0.0; 3], [199.0, -49.0, 299.0]), None);
        assert_eq!(of([0.0; 3], [300.0, -400.0, 600.0]), Some(1));
        assert_eq!(of([0.0; 3], [f32::NAN, 51.0, f32::NEG_INFINITY]), Some(2));
        assert_eq!(of([1.0, 2.0, 290.0], [f32::NAN; 3]), Some(2));
    }

    #[test]
    fn a_breach_names_quantity_value_and_limit() {
        let breach = |value, unit| Breach { quantity: "rate of joint 'elbow'".into(), unit, value, limit: 300.0 };
        assert_eq!(breach(-412.5, "rad/s").to_string(), "rate of joint 'elbow' is -412.5 rad/s, beyond ±300 rad/s");
        assert_eq!(breach(3e9, "-").to_string(), "rate of joint 'elbow' is 3.000e9, beyond ±300");
        assert_eq!(breach(f32::NAN, "m").to_string(), "rate of joint 'elbow' is NaN, not a finite number");
    }
}
