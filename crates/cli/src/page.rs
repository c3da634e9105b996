//! What a command tells: headings, facts, tables, notes, drawings; written as text here, by `html.rs` for a browser.

use super::table::{Table, window};
use super::words::{fitting, shown, shown_lines, wrapped};
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
    /// Sentences, in lines as long as there is room.
    Prose(String),
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

    /// Sentences of our own in one line, broken between words.
    pub fn prose(&mut self, text: impl Into<String>) -> &mut Self {
        self.push(Block::Prose(text.into()))
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
        self.styled(std::io::stdout().is_terminal() && !crate::plain(), window())
    }

    /// With styles or not, and lines broken between words where `width` columns are to hold them.
    fn styled(&self, styled: bool, width: Option<usize>) -> String {
        let painted = |code: &str, text: &str| {
            if styled { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text.to_string() }
        };
        let paint = |code: &str, text: &str| painted(code, &shown(text));
        let broken = |text: String, first: usize, hang: usize| match width {
            Some(width) => wrapped(&text, width, first, hang),
            None => text,
        };
        let within = |text: &str, first: usize, hang: usize| broken(shown(text), first, hang);
        let mut out = String::new();
        for block in &self.blocks {
            let _ = match block {
                Block::Title(name, remark) if remark.is_empty() => writeln!(out, "{}", paint("1", name)),
                Block::Title(name, remark) => {
                    let remark = within(remark, name.chars().count() + 3, 2);
                    writeln!(out, "{} · {remark}", paint("1", name))
                }
                Block::Heading(name) | Block::Subheading(name) => writeln!(out, "\n{}", paint("1", name)),
                Block::Line(text) => match text.strip_prefix("\nFAILED") {
                    Some(why) => writeln!(out, "\n{}{}", painted("1;31", "FAILED"), broken(shown_lines(why), 6, 2)),
                    None => {
                        writeln!(out, "{}", width.map_or(shown_lines(text), |own| fitting(&shown_lines(text), own)))
                    }
                },
                Block::Prose(text) => {
                    writeln!(out, "{}", wrapped(&shown_lines(text), width.unwrap_or(USUAL), 0, 0))
                }
                Block::Facts(facts) => aligned(&mut out, facts, width, &painted),
                Block::Table(table) => write!(out, "{}", table.render(styled, width)),
                Block::Notes(word, texts) => texts.iter().try_for_each(|text| {
                    let text = within(text, 3 + word.chars().count(), 4);
                    writeln!(out, "  {} {text}", paint("33", word))
                }),
                // for a browser alone
                Block::Figure(..) | Block::Folded(..) | Block::Within(..) => Ok(()),
            };
        }
        out
    }
}

/// Columns of sentences where nobody knows how many there are.
const USUAL: usize = 110;

/// A remark in fewer columns is read word by word: it goes below what it remarks on.
const NARROW: usize = 28;

/// Facts in three columns; remarks that do not fit behind go below.
fn aligned(
    out: &mut String,
    facts: &[Fact],
    width: Option<usize>,
    painted: &dyn Fn(&str, &str) -> String,
) -> std::fmt::Result {
    let widest = |text: fn(&Fact) -> &str| facts.iter().map(|f| text(f).chars().count()).max().unwrap_or(0);
    let (names, values) = (widest(|f| &f.name), widest(|f| &f.value));
    let behind = names + values + 7;
    let below = width.is_some_and(|width| behind + NARROW > width);
    for fact in facts {
        let (name, value, note) = (shown(&fact.name), shown(&fact.value), shown(&fact.note));
        let value = width.map_or(value.clone(), |width| wrapped(&value, width, names + 4, names + 4));
        if note.is_empty() {
            writeln!(out, "{}", format!("  {name:<names$}  {value}").trim_end())?;
        } else if below {
            let note = width.map_or(note.clone(), |width| wrapped(&note, width, names + 4, names + 4));
            let indent = " ".repeat(names + 4);
            writeln!(out, "  {name:<names$}  {value}\n{indent}{}", painted("2", &note))?;
        } else {
            let note = width.map_or(note.clone(), |width| wrapped(&note, width, behind, behind));
            writeln!(out, "  {name:<names$}  {value:<values$}   {}", painted("2", &note))?;
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
            page.facts(vec![Fact::new(&evil, &evil).note(&evil)]).notes("note", std::slice::from_ref(&evil), 3, "");
            let text = page.styled(false, None);
            // three headings have an empty line above
            assert_eq!(text.lines().filter(|line| !line.is_empty()).count(), 11, "{text}");
            assert!(!text.contains(['\r', '\u{2028}', '\u{202e}']), "{text}");
        }
        let mut page = Page::new();
        page.line("\nours").line("").line("ours\n").paragraph("one\ntwo");
        assert_eq!(page.styled(false, None), "\nours\n\nours\n\none\ntwo\n");
    }

    #[test]
    fn facts_are_aligned_whatever_letters_they_have() {
        let mut page = Page::new();
        page.facts(vec![Fact::new("motor τ", "12 ms").note("up"), Fact::new("mass", "0.7 kg").note("all")]);
        let columns: Vec<usize> = page
            .styled(false, None)
            .lines()
            .map(|l| l.chars().count() - if l.ends_with("up") { 2 } else { 3 })
            .collect();
        assert_eq!(columns[0], columns[1]);
    }

    #[test]
    fn a_page_fits_its_window_and_loses_no_word() {
        let mut page = Page::new();
        page.title("hummingbird", "built in; Furrer, Burri, Achtelik and Siegwart 2016, AscTec Hummingbird");
        page.heading("Flight").facts(vec![
            Fact::new("controller", "cascade")
                .note("Lee, Leok and McClamroch 2010, with flatness feed-forward and integral action"),
            Fact::new("simulated", "15 s").note("7500 steps of 2 ms"),
            Fact::new("warning", "").note("short"),
        ]);
        page.prose("  away from rest; of a universal joint both hinges together, each by its own angle");
        page.notes(
            "warning:",
            &["the policy was trained on 'iris' of 1.52 kg; it flies another one".to_string()],
            8,
            "",
        );
        page.line("\nFAILED: the tracking RMSE of 0.31 m is above the 0.1 m of --max-rmse, and it fell to the ground");
        let words = |text: &str| text.split_whitespace().map(String::from).collect::<Vec<_>>();
        let whole = page.styled(false, None);
        for width in [40, 60, 80, 100] {
            let text = page.styled(false, Some(width));
            assert!(text.lines().all(|line| line.chars().count() <= width), "{width}\n{text}");
            assert_eq!(words(&text), words(&whole), "{width}");
        }
        assert_eq!(page.styled(false, Some(400)), whole);
        assert!(page.styled(true, None).contains("\u{1b}[1;31mFAILED\u{1b}[0m: the tracking"));
    }
}
