//! What a command tells: headings, facts, tables, notes, drawings; written as text here, by `html.rs` for a browser.

use super::table::Table;
use super::words::{shown, shown_lines};
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

    /// One line, whatever names are in it; with empty ones above or below where the text begins or ends with line feeds.
    pub fn line(&mut self, text: impl Into<String>) -> &mut Self {
        let text = text.into();
        let own = text.trim_matches('\n');
        let [above, below] =
            [text.len() - text.trim_start_matches('\n').len(), text.len() - text.trim_end_matches('\n').len()];
        let below = if own.is_empty() { 0 } else { below };
        self.push(Block::Line("\n".repeat(above) + &shown(own) + &"\n".repeat(below)))
    }

    /// Lines of our own, which hold no names of files.
    pub fn paragraph(&mut self, text: impl Into<String>) -> &mut Self {
        self.push(Block::Line(text.into()))
    }

    /// Lines below a heading, if there are any.
    pub fn lines<S: Into<String>>(&mut self, heading: &str, texts: impl IntoIterator<Item = S>) -> &mut Self {
        let mut texts = texts.into_iter().peekable();
        if texts.peek().is_some() {
            self.heading(heading);
        }
        self.blocks.extend(texts.map(|text| Block::Line(format!("  {}", shown(&text.into())))));
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
                Block::Line(text) => writeln!(out, "{}", shown_lines(text)),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_of_several_lines_takes_one_on_every_part_of_a_page() {
        for feed in ["\n", "\r\n", "\u{2028}", "\n\nerror: "] {
            let evil = format!("a{feed}b\u{202e}");
            let table = Table::new("name").filled([[&evil]]);
            let mut page = Page::new();
            page.title(&evil, &evil).heading(&evil).subheading(&evil).line(&evil).lines("of", [&evil]).table(table);
            page.facts(vec![Fact::new(&evil, &evil).note(&evil)]).notes("note", &[evil.clone()], 3, "");
            let text = page.styled(false);
            // three headings have an empty line above
            assert_eq!(text.lines().filter(|line| !line.is_empty()).count(), 10, "{text}");
            assert!(!text.contains(['\r', '\u{2028}', '\u{202e}']), "{text}");
        }
        let mut page = Page::new();
        page.line("\nours").line("").line("ours\n").paragraph("one\ntwo");
        assert_eq!(page.styled(false), "\nours\n\nours\n\none\ntwo\n");
    }

    #[test]
    fn facts_are_aligned_whatever_letters_they_have() {
        let mut page = Page::new();
        page.facts(vec![Fact::new("motor τ", "12 ms").note("up"), Fact::new("mass", "0.7 kg").note("all")]);
        let columns: Vec<usize> =
            page.styled(false).lines().map(|l| l.chars().count() - if l.ends_with("up") { 2 } else { 3 }).collect();
        assert_eq!(columns[0], columns[1]);
    }
}
