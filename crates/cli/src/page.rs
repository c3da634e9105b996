//! What a command tells: headings, facts, tables, notes, drawings; written as text here, by [`html`](super::html) for a browser.

use super::table::Table;
use std::fmt::Write;
use std::io::IsTerminal;
use std::path::PathBuf;

/// A part of a page.
pub enum Block {
    /// A title, with a remark beside it.
    Title(String, String),
    Heading(String),
    /// A heading of less weight.
    Subheading(String),
    /// A line, or a paragraph.
    Line(String),
    /// Names, values and remarks in three columns.
    Facts(Vec<Fact>),
    Table(Table),
    /// A word before each line, which a terminal may colour.
    Notes(String, Vec<String>),
    /// A drawing as an SVG document, and the name of the file beside a text that holds it.
    Figure(String, String),
    /// A text of a file as it is, folded away behind a word.
    Folded(String, String),
    /// Another whole page within this one, whose scripts see nothing of it.
    Within(String, String),
}

/// Its parts from above.
#[derive(Default)]
pub struct Page {
    pub blocks: Vec<Block>,
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
    /// An empty page.
    pub fn new() -> Self {
        Self::default()
    }

    fn push(&mut self, block: Block) -> &mut Self {
        self.blocks.push(block);
        self
    }

    /// A title, with a remark beside it.
    pub fn title(&mut self, name: &str, remark: &str) -> &mut Self {
        self.push(Block::Title(name.into(), remark.into()))
    }

    /// A heading.
    pub fn heading(&mut self, name: &str) -> &mut Self {
        self.push(Block::Heading(name.into()))
    }

    /// A heading of less weight.
    pub fn subheading(&mut self, name: &str) -> &mut Self {
        self.push(Block::Subheading(name.into()))
    }

    /// One line.
    pub fn line(&mut self, text: impl Into<String>) -> &mut Self {
        self.push(Block::Line(text.into()))
    }

    /// Lines below a heading, if there are any.
    pub fn lines<S: Into<String>>(&mut self, heading: &str, texts: impl IntoIterator<Item = S>) -> &mut Self {
        let mut texts = texts.into_iter().peekable();
        if texts.peek().is_some() {
            self.heading(heading);
        }
        self.blocks.extend(texts.map(|text| Block::Line(format!("  {}", text.into()))));
        self
    }

    /// Which files were written, if any were.
    pub fn written(&mut self, files: &[PathBuf]) -> &mut Self {
        self.lines("Written", files.iter().map(|file| file.display().to_string()))
    }

    /// Names, values and remarks in three aligned columns.
    pub fn facts(&mut self, facts: Vec<Fact>) -> &mut Self {
        self.push(Block::Facts(facts))
    }

    /// A table.
    pub fn table(&mut self, table: Table) -> &mut Self {
        self.push(Block::Table(table))
    }

    /// `word: text` for each text, at most `most` of them, then how many more there are.
    pub fn notes(&mut self, word: &str, texts: &[String], most: usize, more: &str) -> &mut Self {
        let rest = texts.len().saturating_sub(most);
        let rest = (rest > 0).then(|| format!("… and {rest} more: {more}"));
        self.push(Block::Notes(word.into(), texts.iter().take(most).cloned().chain(rest).collect()))
    }

    /// A drawing: an SVG document as [`Figure::svg`](omnidrones_plot::Figure::svg) makes it.
    pub fn figure(&mut self, svg: String) -> &mut Self {
        self.push(Block::Figure(svg, String::new()))
    }

    /// A text of a file as it is, folded away behind a word.
    pub fn folded(&mut self, summary: &str, text: &str) -> &mut Self {
        self.push(Block::Folded(summary.into(), text.into()))
    }

    /// Another whole page within this one.
    pub fn within(&mut self, title: &str, page: String) -> &mut Self {
        self.push(Block::Within(title.into(), page))
    }

    /// As text for standard output: bold and dim on a terminal only, never with `NO_COLOR`.
    pub fn text(&self) -> String {
        let plain = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty())
            || std::env::var_os("TERM").is_some_and(|v| v == "dumb");
        self.styled(std::io::stdout().is_terminal() && !plain)
    }

    fn styled(&self, styled: bool) -> String {
        let paint = |code: &str, text: &str| {
            let text = shown(text);
            if styled { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text }
        };
        let mut out = String::new();
        for block in &self.blocks {
            let _ = match block {
                Block::Title(name, remark) if remark.is_empty() => writeln!(out, "{}", paint("1", name)),
                Block::Title(name, remark) => writeln!(out, "{} · {}", paint("1", name), shown(remark)),
                Block::Heading(name) | Block::Subheading(name) => writeln!(out, "\n{}", paint("1", name)),
                Block::Line(text) => writeln!(out, "{}", shown(text)),
                Block::Facts(facts) => aligned(&mut out, facts, &paint),
                Block::Table(table) => write!(out, "{}", table.render(styled)),
                Block::Notes(word, texts) => {
                    texts.iter().try_for_each(|text| writeln!(out, "  {} {}", paint("33", word), shown(text)))
                }
                // for a browser alone
                Block::Figure(..) | Block::Folded(..) | Block::Within(..) => Ok(()),
            };
        }
        out
    }
}

/// Facts in three columns.
fn aligned(out: &mut String, facts: &[Fact], paint: &dyn Fn(&str, &str) -> String) -> std::fmt::Result {
    let width = |text: fn(&Fact) -> &str| facts.iter().map(|f| text(f).chars().count()).max().unwrap_or(0);
    let (names, values) = (width(|f| &f.name), width(|f| &f.value));
    for fact in facts {
        let line = format!("  {:<names$}  {:<values$}", shown(&fact.name), shown(&fact.value));
        match fact.note.as_str() {
            "" => writeln!(out, "{}", line.trim_end())?,
            note => writeln!(out, "{line}   {}", paint("2", note))?,
        }
    }
    Ok(())
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

/// The share of `n` as people say it: a count where it is a few of many, `1 of 1024`.
pub fn share_of(share: f64, n: usize) -> String {
    let count = (share * n as f64).round();
    if count > 0.0 && share < 0.01 { format!("{count} of {n}") } else { percent(share) }
}

/// `97 %`.
pub fn percent(share: f64) -> String {
    format!("{} %", short(100.0 * share, 3))
}

/// `3.12 M`, `196 k`.
pub fn count(n: f64) -> String {
    match n {
        n if n >= 999.5e6 => format!("{} G", short(1e-9 * n, 3)),
        n if n >= 999.5e3 => format!("{} M", short(1e-6 * n, 3)),
        n if n >= 999.5 => format!("{} k", short(1e-3 * n, 3)),
        n => short(n, 3),
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
        let mut page = Page::new();
        page.facts(vec![Fact::new("motor τ", "12 ms").note("up"), Fact::new("mass", "0.7 kg").note("all")]);
        let columns: Vec<usize> =
            page.styled(false).lines().map(|l| l.chars().count() - if l.ends_with("up") { 2 } else { 3 }).collect();
        assert_eq!(columns[0], columns[1]);
    }

    #[test]
    fn a_few_of_many_are_counted() {
        assert_eq!([share_of(1.0 / 1024.0, 1024), share_of(0.0, 1024), share_of(0.5, 4)], ["1 of 1024", "0 %", "50 %"]);
    }
}
