//! Names as C takes them.

use base::error::{Error, Result};

/// What files and functions of others may be called.
const RESERVED: [&str; 2] = ["main", "od"];

/// Longest name of a module.
const LONGEST: usize = 63;

/// Checks the name of a module.
///
/// # Errors
/// [`Error::Value`] for one that is no identifier of C.
pub(crate) fn checked(name: &str) -> Result<()> {
    let begins = name.starts_with(|c: char| c.is_ascii_lowercase());
    let goes_on = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if begins && goes_on && name.len() <= LONGEST && !RESERVED.contains(&name) && !name.ends_with("_test") {
        return Ok(());
    }
    let limit =
        format!("a letter, then letters, digits and _, all small, at most {LONGEST}, and not _test behind them");
    Err(Error::value("name of the module", format!("'{name}'"), limit, "Give another one."))
}

/// Words as a name: what is neither letter nor digit becomes `_`, a capital behind a small letter begins a word, and a name begins with
/// a letter.
pub(crate) fn of_words(words: &str) -> String {
    let mut name = String::new();
    let mut was_small = false;
    for c in words.chars() {
        if was_small && c.is_ascii_uppercase() {
            name.push('_');
        }
        was_small = c.is_ascii_lowercase();
        let c = c.to_ascii_lowercase();
        let own = if c.is_ascii_alphanumeric() { c } else { '_' };
        if !(own == '_' && name.ends_with('_')) {
            name.push(own);
        }
    }
    let name = name.trim_matches('_');
    if name.starts_with(|c: char| c.is_ascii_lowercase()) { name.into() } else { format!("n_{name}") }
}

/// As the name of a module, where nobody gave one.
pub(crate) fn of_module(words: &str) -> String {
    let name = of_words(words);
    name[..name.len().min(LONGEST)].trim_end_matches('_').into()
}

/// As a macro.
pub(crate) fn of_macro(words: &str) -> String {
    of_words(words).to_ascii_uppercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_something_is_called_becomes_a_name_of_c() {
        for (words, name) in [
            ("rotor_0.speed", "rotor_0_speed"),
            ("9 lives", "n_9_lives"),
            ("Über-Kopter", "ber_kopter"),
            ("...", "n_"),
            ("OverFlyThrough", "over_fly_through"),
        ] {
            assert_eq!(of_words(words), name);
        }
        assert_eq!(of_macro("hover.position x"), "HOVER_POSITION_X");
    }

    #[test]
    fn a_name_that_is_none_in_c_is_refused() {
        for bad in ["", "9x", "Hover", "a b", "main", "hover_test", &"x".repeat(64)] {
            let error = checked(bad).unwrap_err().to_string();
            assert!(error.contains("name of the module") && error.contains("Give another"), "{error}");
        }
        assert!(checked("hover_2").is_ok());
    }
}
