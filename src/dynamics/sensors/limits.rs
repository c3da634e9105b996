//! What numbers of sensors may be.

use base::error::{Error, Result, finite};

/// Farthest place of a sensor from the origin of its body, m.
pub(crate) const MAX_LEVER: f64 = 100.0;
/// Largest distance and height, m.
pub(crate) const MAX_DISTANCE: f64 = 1e5;

/// Checks that a finite `value` lies in [`least`, `most`].
pub(crate) fn within(what: &str, value: f64, least: f64, most: f64) -> Result<()> {
    finite(what, &[value])?;
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let limit = format!("between {least:e} and {most:e} in SI units");
    Err(Error::value(what, value, limit, "Check its sign and units."))
}

/// Checks that `value` is above 0; it may be infinite.
pub(crate) fn positive(what: &str, value: f64, remedy: &str) -> Result<()> {
    if value > 0.0 { Ok(()) } else { Err(Error::value(what, value, "> 0", remedy)) }
}
