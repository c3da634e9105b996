//! What settings of several algorithms are asked for.

use base::error::{Error, Result};

/// Refuses a count of 0, or above the most that stands beside it. The remedy says which are usual.
///
/// # Errors
/// [`Error::Limit`] with the count, the limit and the remedy.
pub(crate) fn check_counts(counts: &[(&str, usize, usize)], remedy: &str) -> Result<()> {
    match counts.iter().find(|(_, n, most)| n == &0 || n > most) {
        None => Ok(()),
        Some((what, n, most)) => Err(Error::limit(*what, n, format!("1 to {most}"), remedy)),
    }
}

/// Refuses a number that is not finite and above 0. The remedy says which are usual.
///
/// # Errors
/// [`Error::Value`] with the number, the rule and the remedy.
pub(crate) fn check_positive(numbers: &[(&str, f64)], remedy: &str) -> Result<()> {
    match numbers.iter().find(|(_, x)| !(x.is_finite() && *x > 0.0)) {
        None => Ok(()),
        Some((what, x)) => Err(Error::value(*what, x, "finite and > 0", remedy)),
    }
}
