//! A report that is written twice: as a page for a browser, and as Markdown.

use crate::html::Html;
use crate::page::shown;
use crate::table::{Align, Table};
use std::fmt::Write;

enum Block {
    Heading(String),
    Line(String),
    Table(Table),
    /// An SVG document; in Markdown the file of that name.
    Figure(String, String),
}

/// Its parts from above.
pub struct Document {
    title: String,
    remark: String,
    blocks: Vec<Block>,
}

impl Document {
    /// With a title, and a remark below it.
    pub fn new(title: &str, remark: &str) -> Self {
        Self { title: title.into(), remark: remark.into(), blocks: Vec::new() }
    }

    /// A heading.
    pub fn heading(&mut self, name: &str) -> &mut Self {
        self.blocks.push(Block::Heading(name.into()));
        self
    }

    /// A paragraph.
    pub fn line(&mut self, text: &str) -> &mut Self {
        self.blocks.push(Block::Line(text.into()));
        self
    }

    /// A table.
    pub fn table(&mut self, table: Table) -> &mut Self {
        self.blocks.push(Block::Table(table));
        self
    }

    /// A drawing, which stands beside the Markdown as `file`.
    pub fn figure(&mut self, svg: String, file: &str) -> &mut Self {
        self.blocks.push(Block::Figure(svg, file.into()));
        self
    }

    /// As a page.
    pub fn html(&self) -> String {
        let mut html = Html::new(&self.title, &self.remark);
        for block in &self.blocks {
            match block {
                Block::Heading(name) => html.heading(name),
                Block::Line(text) => html.line(text),
                Block::Table(table) => html.table(table),
                Block::Figure(svg, _) => html.figure(svg),
            };
        }
        html.finish()
    }

    /// As Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n", plain(&self.title), plain(&self.remark));
        for block in &self.blocks {
            text.push('\n');
            match block {
                Block::Heading(name) => text += &format!("## {}\n", plain(name)),
                Block::Line(line) => text += &format!("{}\n", plain(line)),
                Block::Table(table) => rows(&mut text, table),
                Block::Figure(_, file) => text += &format!("![{}]({file})\n", plain(&self.title)),
            }
        }
        text
    }
}

fn rows(text: &mut String, table: &Table) {
    let mut line = |cells: &mut dyn Iterator<Item = String>| {
        let _ = writeln!(text, "| {} |", cells.collect::<Vec<_>>().join(" | "));
    };
    line(&mut table.columns().iter().map(|(name, _)| plain(name)));
    let rule = |align: &Align| if *align == Align::Right { "--:" } else { "---" };
    line(&mut table.columns().iter().map(|(_, align)| rule(align).to_string()));
    table.rows().iter().for_each(|row| line(&mut row.iter().map(|cell| plain(cell))));
}

/// Without what Markdown would read as more than text.
fn plain(text: &str) -> String {
    shown(text).replace('|', "\\|").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_writings_hold_every_part_and_neither_takes_text_for_marks() {
        let mut table = Table::new(&[("task", Align::Left), ("success", Align::Right)]);
        table.row(["a|b", "<1 %"]);
        let mut document = Document::new("Title", "remark");
        document.heading("Part").line("A line.").table(table).figure("<svg></svg>".into(), "curves.svg");
        let (html, markdown) = (document.html(), document.markdown());
        assert_eq!(
            markdown,
            "# Title\n\nremark\n\n## Part\n\nA line.\n\n| task | success |\n| --- | --: |\n| a\\|b | &lt;1 % |\n\n![Title](curves.svg)\n"
        );
        for part in ["<h1>Title</h1>", "<h2>Part</h2>", "<p>A line.</p>", "&lt;1 %", "<svg></svg>"] {
            assert!(html.contains(part), "{part}: {html}");
        }
    }
}
