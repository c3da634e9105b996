//! What is said of a file.

use base::error::Error;

/// An [`Error::Format`] from parts.
pub(super) fn fault(file: &str, place: impl Into<String>, rule: impl Into<String>, remedy: impl Into<String>) -> Error {
    Error::Format { file: file.to_string(), place: place.into(), rule: rule.into(), remedy: remedy.into() }
}

/// Turns a value error of [`Vehicle::validate`](super::Vehicle::validate) and its parts into one that names the file.
pub(super) fn in_file(error: Error, file: &str, place: &str) -> Error {
    match error {
        Error::Value { what, value, limit, remedy } | Error::Limit { what, value, limit, remedy } => {
            fault(file, place, format!("{what} is {value}, but it must be {limit}"), remedy)
        }
        other => other,
    }
}

/// A name from a file made fit for one line of text: control characters blanked, at most 64 characters.
pub(super) fn clean(name: &str) -> String {
    let mut text: String = name.chars().take(64).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.len() < name.len() {
        text.push('…');
    }
    text
}

/// `link 'a', 'b', 'c' and 5 more`-style list of at most three names.
pub(super) fn few(names: &[&str]) -> String {
    let mut text = names.iter().take(3).map(|n| format!("'{}'", clean(n))).collect::<Vec<_>>().join(", ");
    if names.len() > 3 {
        text.push_str(&format!(" and {} more", names.len() - 3));
    }
    text
}
