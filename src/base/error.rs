//! The one error type of the library. Every message names the value, the limit it broke and the remedy.

use std::path::{Path, PathBuf};

/// `std::result::Result` with the library's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// What can go wrong with data: files, configurations, sizes, names.
///
/// Numerical procedures report outcomes (solved, stalled, …) in their own types; this is for input that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value that is not finite, not physical or outside its range.
    #[error("{} is {}, but it must be {}. {remedy}", middle(.what), middle(.value), clause(.limit))]
    Value {
        /// The quantity, with its place: `rotor 2: thrust_coefficient`.
        what: String,
        /// The value as given.
        value: String,
        /// The rule it broke: `> 0`.
        limit: String,
        /// What to do about it.
        remedy: String,
    },
    /// A request beyond a fence set before the work starts.
    #[error("{} is {}, {} the limit of {}. {remedy}", middle(.what), middle(.value), side(.value, .limit), clause(.limit))]
    Limit {
        /// The quantity.
        what: String,
        /// The value as given.
        value: String,
        /// The fence.
        limit: String,
        /// How to stay below it or raise it.
        remedy: String,
    },
    /// A name that is in no registry.
    #[error("no {kind} is called '{}'{}. Known: {}", cut(.name), suggestion(.name, .known), .known.join(", "))]
    Unknown {
        /// What was looked up: `vehicle`, `reference`.
        kind: &'static str,
        /// The name as given.
        name: String,
        /// Every name that would have worked.
        known: Vec<String>,
    },
    /// A file that could not be read or written.
    #[error("{}: {source}", middle(&.path.to_string_lossy()))]
    File {
        /// The file.
        path: PathBuf,
        /// The operating system's answer.
        source: std::io::Error,
    },
    /// A file whose text breaks a rule of its format.
    #[error("{}: {}: {}. {remedy}", middle(.file), middle(.place), clause(.rule))]
    Format {
        /// The file, or `<text>` where the text came from memory.
        file: String,
        /// Element, key or line.
        place: String,
        /// The rule that was broken, with the value.
        rule: String,
        /// What to do about it.
        remedy: String,
    },
    /// A folder that holds no trained policy.
    #[error(
        "run is '{}', {lacks}, but it must be the folder of a run or of one of its checkpoints. {remedy}",
        middle(&.path.to_string_lossy())
    )]
    NoRun {
        /// The folder as given.
        path: PathBuf,
        /// What it lacks.
        lacks: &'static str,
        /// What to do about it.
        remedy: String,
    },
}

/// What kind it is, for who answers to one kind and passes the others on.
///
/// ```
/// # use omnidrones_base::omnidrones;
/// use omnidrones::layers::Layer;
/// assert!(Layer::of_text("dt 0.01", "my.toml").is_err_and(|error| error.is_format()));
/// ```
impl Error {
    /// A value that is not finite, not physical or outside its range.
    pub fn is_value(&self) -> bool {
        matches!(self, Self::Value { .. })
    }

    /// A request beyond a fence, below its least or above its most.
    pub fn is_limit(&self) -> bool {
        matches!(self, Self::Limit { .. })
    }

    /// A name that is in no registry.
    pub fn is_unknown_name(&self) -> bool {
        matches!(self, Self::Unknown { .. })
    }

    /// A file that the operating system would not read or write.
    pub fn is_file(&self) -> bool {
        matches!(self, Self::File { .. })
    }

    /// A text or table that breaks a rule of its format.
    pub fn is_format(&self) -> bool {
        matches!(self, Self::Format { .. })
    }

    /// A folder that holds no trained policy.
    pub fn is_no_run(&self) -> bool {
        matches!(self, Self::NoRun { .. })
    }
}

impl Error {
    /// A [`Error::Value`] from parts that can be displayed.
    pub fn value(
        what: impl Into<String>,
        value: impl ToString,
        limit: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Value { what: what.into(), value: short(value.to_string()), limit: limit.into(), remedy: remedy.into() }
    }

    /// A [`Error::Limit`] from parts that can be displayed.
    pub fn limit(
        what: impl Into<String>,
        value: impl ToString,
        limit: impl ToString,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Limit {
            what: what.into(),
            value: short(value.to_string()),
            limit: limit.to_string(),
            remedy: remedy.into(),
        }
    }

    /// A key of `file` that is none of those `known`.
    #[doc(hidden)]
    pub fn unknown_key(file: &str, key: &str, known: &[String]) -> Self {
        let list = known.iter().map(|k| format!("`{k}`")).collect::<Vec<_>>().join(", ");
        let rule = format!("unknown field `{key}`, expected one of {list}");
        let remedy = unknown_key_remedy(&rule).unwrap_or_default();
        Self::Format { file: file.into(), place: key.into(), rule, remedy }
    }

    /// A [`Error::File`] for `path`.
    pub fn file(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::File { path: path.as_ref().to_path_buf(), source }
    }
}

/// On which side of a limit such as `1 to 16` a value lies.
fn side(value: &str, limit: &str) -> &'static str {
    let least = limit.split_once(" to ").and_then(|(least, _)| least.trim().parse::<f64>().ok());
    let below = least.zip(value.parse::<f64>().ok()).is_some_and(|(least, value)| value < least);
    if below { "below" } else { "over" }
}

/// serde says: unknown field `x`, expected one of `a`, `b`.
#[doc(hidden)]
pub fn unknown_key_remedy(message: &str) -> Option<String> {
    let mut quoted = message.strip_prefix("unknown field ")?.split('`').skip(1).step_by(2);
    let key = quoted.next()?;
    Some(match nearest(key, quoted) {
        Some(known) => format!("Did you mean `{known}`?"),
        None => "Remove the key: it has no meaning there.".into(),
    })
}

/// What the parser says with Rust's names of types, in those of numbers, and without the full stop that the sentence gets.
#[doc(hidden)]
pub fn in_words(said: &str) -> String {
    let whole = ["usize", "u64", "u32", "u16", "u8"].map(|kind| (kind, "a whole number from 0"));
    let real = ["f64", "f32"].map(|kind| (kind, "a number"));
    let named = whole.into_iter().chain(real).find(|(kind, _)| said.ends_with(&format!("expected {kind}")));
    match named {
        Some((kind, words)) => format!("{}{words}", said.trim_end_matches(kind)),
        None => said.trim_end_matches('.').into(),
    }
}

/// Most letters of a name that is not known in a message.
const LONGEST_NAME: usize = 200;

/// The beginning of a name that is endless.
fn cut(name: &str) -> String {
    match name.char_indices().nth(LONGEST_NAME) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.into(),
    }
}

/// Most letters of a part of a message that may hold what a file or an option says: the remedy stands behind it.
const LONGEST_PART: usize = 600;

/// The beginning and the end of a text that is endless.
#[doc(hidden)]
pub fn middle(text: &str) -> String {
    let n = text.chars().count();
    if n <= LONGEST_PART {
        return text.into();
    }
    let half = LONGEST_PART / 2;
    let (begin, end): (String, String) = (text.chars().take(half).collect(), text.chars().skip(n - half).collect());
    format!("{begin} … {end}")
}

/// A part of a message that the message ends with a stop, which it may bring along.
fn clause(text: &str) -> String {
    middle(text.strip_suffix('.').unwrap_or(text))
}

/// A number of hundreds of digits in scientific notation; any other text as it is.
fn short(text: String) -> String {
    match text.parse::<f64>() {
        Ok(number) if text.len() > 24 => format!("{number:e}"),
        _ => text,
    }
}

/// Checks that every number of `values` is finite; `what` names the first that is not.
#[doc(hidden)]
pub fn finite(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(i) => {
            let name = if values.len() == 1 { what.to_string() } else { format!("{what}[{i}]") };
            Err(Error::value(name, values[i], "a finite number", "Correct it at its source."))
        }
    }
}

/// ` (did you mean 'x'?)` for the [`nearest`] known name, else nothing.
#[doc(hidden)]
pub fn suggestion(name: &str, known: &[String]) -> String {
    nearest(name, known.iter().map(String::as_str)).map_or(String::new(), |k| format!(" (did you mean '{k}'?)"))
}

/// The known name that is fewest edits away, at most half of either's letters; else the shortest that `name` begins, from three
/// letters on; else the one whose words begin with its letters: `lr` for `learning_rate`.
fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    // one letter more than could be near anything
    let known: Vec<(String, &str)> = known.map(|k| (k.to_lowercase(), k)).collect();
    let longest = known.iter().map(|(own, _)| own.chars().count()).max()?;
    let name: String = name.chars().take(longest + longest / 2 + 1).flat_map(char::to_lowercase).collect();
    let letters = name.chars().count();
    let ranked: Vec<_> = known.iter().map(|(own, k)| (edit_distance(&name, own), *k)).collect();
    let near = ranked.iter().filter(|(edits, k)| 2 * edits <= letters.min(k.chars().count())).min();
    let begun = || ranked.iter().filter(|(_, k)| letters >= 3 && k.to_lowercase().starts_with(&name)).min();
    let initials = |own: &str| own.split('_').filter_map(|word| word.chars().next()).collect::<String>();
    let short = || known.iter().find(|(own, _)| letters >= 2 && initials(own) == name).map(|(_, k)| *k);
    near.or_else(begun).map(|(_, k)| *k).or_else(short)
}

/// Levenshtein distance, by one row of the usual table.
#[doc(hidden)]
pub fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substitute = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substitute.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_name_suggests_the_nearest_known_one() {
        let known = vec!["hummingbird".to_string(), "firefly".to_string()];
        let text = Error::Unknown { kind: "vehicle", name: "humingbird".into(), known }.to_string();
        assert_eq!(
            text,
            "no vehicle is called 'humingbird' (did you mean 'hummingbird'?). Known: hummingbird, firefly"
        );
    }

    #[test]
    fn a_remedy_stays_behind_what_is_endless_and_no_stop_is_doubled() {
        for n in [1, 600, 601, 5000, 1_000_000] {
            let text = "é".repeat(n);
            let format = |file: &str, place: &str, rule: &str| {
                let (file, place, rule) = (file.into(), place.into(), rule.into());
                Error::Format { file, place, rule, remedy: "Mend it.".into() }
            };
            let all = [
                Error::value("mass", &text, "> 0.", "Mend it."),
                Error::value(&text, 1, &text, "Mend it."),
                Error::limit(&text, &text, &text, "Mend it."),
                format(&text, &text, &text),
                format("a.toml", "mass", &format!("{text}.")),
                Error::NoRun { path: text.clone().into(), lacks: "which lacks all", remedy: "Mend it.".into() },
            ];
            for error in all {
                let told = error.to_string();
                assert!(told.ends_with(". Mend it.") && !told.contains(".. "), "{n}: {told}");
                assert!(told.chars().count() < 2000, "{n}: {}", told.chars().count());
            }
        }
        assert_eq!(middle("short"), "short");
    }

    #[test]
    fn a_beginning_is_suggested_whole_and_a_letter_is_no_name() {
        let known = ["learning_rate", "updates", "0", "Hover", "HoverRand"].map(String::from);
        assert_eq!(suggestion("learn", &known), " (did you mean 'learning_rate'?)");
        assert_eq!(suggestion("hoverr", &known), " (did you mean 'Hover'?)");
        assert_eq!(suggestion("Udpates", &known), " (did you mean 'updates'?)");
        assert_eq!(suggestion("x", &known), "");
        assert_eq!(suggestion("up", &known), "");
    }

    #[test]
    fn initials_are_suggested_whole() {
        let known = ["learning_rate", "updates", "n_env", "max_grad_norm"].map(String::from);
        for (name, word) in
            [("lr", "learning_rate"), ("LR", "learning_rate"), ("ne", "n_env"), ("mgn", "max_grad_norm")]
        {
            assert_eq!(suggestion(name, &known), format!(" (did you mean '{word}'?)"));
        }
        assert_eq!(suggestion("l", &known), "");
    }

    #[test]
    fn a_word_near_a_name_is_a_suggestion() {
        assert_eq!(suggestion("fireflyes", &["hummingbird".into(), "firefly".into()]), " (did you mean 'firefly'?)");
    }

    #[test]
    fn the_parser_speaks_of_numbers_not_of_types() {
        #[derive(Debug, serde::Deserialize)]
        struct Settings {
            #[expect(dead_code)]
            updates: usize,
        }
        let text = "updates = 'many'";
        let said = crate::reader::of_toml::<Settings>(text, "my.toml").unwrap_err().to_string();
        assert!(said.contains("expected a whole number from 0. Correct it there."), "{said}");
        assert_eq!(in_words("it has no rotors."), "it has no rotors");
    }

    #[test]
    fn a_limit_is_broken_on_the_side_where_it_is() {
        let told = |n: usize| Error::limit("envs", n, "1 to 16", "").to_string();
        assert!(told(0).starts_with("envs is 0, below the limit of 1 to 16"));
        assert!(told(17).starts_with("envs is 17, over the limit of 1 to 16"));
        assert!(Error::limit("size", "20 bytes", "16 bytes", "").to_string().contains("over the limit of 16 bytes"));
    }

    #[test]
    fn kinds_can_be_told_apart_without_reading_the_message() {
        let limit = Error::limit("envs", 0, "1 to 16", "");
        assert!(limit.is_limit() && !limit.is_value() && !limit.is_file() && !limit.is_format());
        let unknown = Error::Unknown { kind: "task", name: "Hovr".into(), known: Vec::new() };
        assert!(unknown.is_unknown_name() && !unknown.is_no_run());
    }

    #[test]
    fn a_non_finite_entry_is_named_with_its_index() {
        let text = finite("mass", &[1.0, f64::NAN]).unwrap_err().to_string();
        assert!(text.starts_with("mass[1] is NaN"), "{text}");
    }
}
