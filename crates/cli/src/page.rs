//! A page of text: headings, facts, tables, notes. Bold and dim on a terminal only, never with `NO_COLOR`.

use super::table::Table;
use std::fmt::Write;
use std::io::IsTerminal;

/// What a command prints.
pub struct Page {
    text: String,
    styled: bool,
}

/// One line of a list of facts: name, value, unit, remark.
pub struct Fact {
    name: String,
    value: String,
    note: String,
}

impl Fact {
    /// `name` has this value, unit included.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into(), note: String::new() }
    }

    /// With a remark behind it.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    /// Name, value, remark.
    pub fn parts(&self) -> [&str; 3] {
        [&self.name, &self.value, &self.note]
    }
}

/// Names with their values and remarks as plain text.
pub fn plain_facts(facts: &[Fact]) -> Vec<[String; 2]> {
    let plain = |fact: &Fact| {
        let note = if fact.note.is_empty() { String::new() } else { format!(" ({})", fact.note) };
        [fact.name.clone(), format!("{}{note}", fact.value)]
    };
    facts.iter().map(plain).collect()
}

impl Page {
    /// An empty page for standard output.
    pub fn new() -> Self {
        let plain = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty())
            || std::env::var_os("TERM").is_some_and(|v| v == "dumb");
        Self { text: String::new(), styled: std::io::stdout().is_terminal() && !plain }
    }

    /// A title, with a remark beside it.
    pub fn title(&mut self, name: &str, remark: &str) -> &mut Self {
        let (on, off) = self.code("1");
        let (name, remark) = (shown(name), shown(remark));
        let _ = writeln!(self.text, "{on}{name}{off}{}{remark}", if remark.is_empty() { "" } else { " · " });
        self
    }

    /// A heading with a blank line above.
    pub fn heading(&mut self, name: &str) -> &mut Self {
        let (on, off) = self.code("1");
        let _ = writeln!(self.text, "\n{on}{name}{off}");
        self
    }

    /// One line.
    pub fn line(&mut self, text: impl AsRef<str>) -> &mut Self {
        let _ = writeln!(self.text, "{}", shown(text.as_ref()));
        self
    }

    /// Names, values and remarks in three aligned columns.
    pub fn facts(&mut self, facts: &[Fact]) -> &mut Self {
        let width = |text: fn(&Fact) -> &str| facts.iter().map(|f| text(f).chars().count()).max().unwrap_or(0);
        let (names, values) = (width(|f| &f.name), width(|f| &f.value));
        let (on, off) = self.code("2");
        for fact in facts {
            let line = format!("  {:<names$}  {:<values$}", shown(&fact.name), shown(&fact.value));
            let note = if fact.note.is_empty() { String::new() } else { format!("   {on}{}{off}", shown(&fact.note)) };
            let _ = writeln!(self.text, "{}{note}", if note.is_empty() { line.trim_end() } else { &line });
        }
        self
    }

    /// A table.
    pub fn table(&mut self, table: &Table) -> &mut Self {
        self.text += &table.render(self.styled);
        self
    }

    /// `word: text` for each text, at most `most` of them, then how many more there are.
    pub fn notes(&mut self, word: &str, texts: &[String], most: usize, more: &str) -> &mut Self {
        let (on, off) = self.code("33");
        for text in texts.iter().take(most) {
            let _ = writeln!(self.text, "  {on}{word}{off} {}", shown(text));
        }
        if texts.len() > most {
            let _ = writeln!(self.text, "  {on}{word}{off} … and {} more: {more}", texts.len() - most);
        }
        self
    }

    /// The text.
    pub fn finish(self) -> String {
        self.text
    }

    fn code(&self, code: &str) -> (String, &'static str) {
        if self.styled { (format!("\u{1b}[{code}m"), "\u{1b}[0m") } else { (String::new(), "") }
    }
}

/// Longest text shown at one place, characters.
const LONGEST: usize = 4000;

/// A text without what steers a terminal, and not endless: names come from files of anybody.
pub fn shown(text: &str) -> String {
    let plain = |c: char| if c.is_control() && c != '\n' { '·' } else { c };
    let mut out: String = text.chars().take(LONGEST).map(plain).collect();
    if text.chars().nth(LONGEST).is_some() {
        out.push('…');
    }
    out
}

/// `v` to `digits` significant digits: plain from 0.001 to 99999, else with an exponent; a dash where not finite.
pub fn short(v: f64, digits: usize) -> String {
    if !v.is_finite() {
        return "–".into();
    }
    if v == 0.0 {
        return "0".into();
    }
    let scientific = format!("{v:.*e}", digits.saturating_sub(1));
    let Some((mantissa, exponent)) = scientific.split_once('e') else { return scientific };
    let magnitude: i32 = exponent.parse().unwrap_or(0);
    if !(-3..5).contains(&magnitude) {
        let mantissa =
            if mantissa.contains('.') { mantissa.trim_end_matches('0').trim_end_matches('.') } else { mantissa };
        return format!("{mantissa}e{exponent}");
    }
    let decimals = usize::try_from(digits as i32 - 1 - magnitude).unwrap_or(0);
    let plain = format!("{v:.decimals$}");
    if plain.contains('.') { plain.trim_end_matches('0').trim_end_matches('.').to_string() } else { plain }
}

/// Metres as a person would say them.
pub fn length(metres: impl Into<Option<f64>>) -> String {
    match metres.into() {
        Some(m) if m.is_finite() && m < 0.1 => format!("{:.1} mm", 1e3 * m),
        Some(m) if m.is_finite() => format!("{} m", short(m, 3)),
        _ => "–".into(),
    }
}

/// Seconds as a person would say them.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 1e-3 => format!("{} µs", short(1e6 * s, 3)),
        s if s < 1.0 => format!("{} ms", short(1e3 * s, 3)),
        s => format!("{} s", short(s, 3)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_cannot_steer_a_terminal_and_is_not_endless() {
        assert_eq!(shown("a\u{1b}[31mb\u{7}"), "a·[31mb·");
        assert_eq!(shown(&"x".repeat(400_000)).chars().count(), LONGEST + 1);
    }

    #[test]
    fn numbers_keep_their_significant_digits_and_no_more() {
        for (v, text) in [
            (8.54858e-6, "8.549e-6"),
            (0.0125, "0.0125"),
            (838.0, "838"),
            (1.0, "1"),
            (0.0, "0"),
            (-2.5e9, "-2.5e9"),
            (99999.0, "1e5"),
            (12345.6, "12346"),
            (f64::NAN, "–"),
            (0.1 + 0.2, "0.3"),
        ] {
            assert_eq!(short(v, 4), text);
        }
    }

    #[test]
    fn facts_are_aligned_whatever_letters_they_have() {
        let mut page = Page { text: String::new(), styled: false };
        page.facts(&[Fact::new("motor τ", "12 ms").note("up"), Fact::new("mass", "0.7 kg").note("all")]);
        let columns: Vec<usize> =
            page.finish().lines().map(|l| l.chars().count() - if l.ends_with("up") { 2 } else { 3 }).collect();
        assert_eq!(columns[0], columns[1]);
    }
}
