//! Tables for people: aligned numbers, units in the header, bold headers on a terminal only.

use super::words::{shown, wrapped};
use comfy_table::{Attribute, Cell, CellAlignment, ColumnConstraint, ContentArrangement, LineStyle, TableStyle, Width};
use std::io::IsTerminal;

/// How a column is aligned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Words.
    Left,
    /// Numbers.
    Right,
}

/// A table filled row by row.
#[derive(Debug, Clone)]
pub struct Table {
    columns: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
    has_sentences: bool,
}

impl Table {
    /// With headers between bars, each with its unit; `>` marks those of numbers: `vehicle | >RMSE [mm]`.
    pub fn new(headers: &str) -> Self {
        let column = |header: &str| match header.trim().strip_prefix('>') {
            Some(name) => (name.into(), Align::Right),
            None => (header.trim().into(), Align::Left),
        };
        Self { columns: headers.split('|').map(column).collect(), rows: Vec::new(), has_sentences: false }
    }

    /// With more columns, named by data.
    pub fn with<S: Into<String>>(mut self, align: Align, names: impl IntoIterator<Item = S>) -> Self {
        self.columns.extend(names.into_iter().map(|name| (shown(&name.into()), align)));
        self
    }

    /// With these rows.
    pub fn filled<S: Into<String>, R: IntoIterator<Item = S>>(mut self, rows: impl IntoIterator<Item = R>) -> Self {
        for row in rows {
            self.row(row);
        }
        self
    }

    /// Appends a row of cells of one line each; missing cells stay empty, surplus ones are dropped.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        let mut row: Vec<String> = cells.into_iter().map(|cell| shown(&cell.into())).collect();
        row.resize(self.columns.len(), String::new());
        self.rows.push(row);
        self
    }

    /// With sentences in its cells, which are broken where they are long.
    pub fn with_sentences(mut self) -> Self {
        self.has_sentences = true;
        self
    }

    /// Headers and how their columns are aligned.
    pub fn columns(&self) -> &[(String, Align)] {
        &self.columns
    }

    /// As many cells per row as there are columns.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// Whether it has no rows yet.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The table as text, one line per row, indented like a list of facts; `styled` has bold headers. Where `width` is known, cells are broken
    /// between words, and columns that do not fit then go below, behind the first again.
    pub fn render(&self, styled: bool, width: Option<usize>) -> String {
        let whole = self.arranged(styled, None);
        let Some(width) = width.filter(|width| whole.lines().any(|line| shown_width(line) > *width)) else {
            return whole;
        };
        let all: Vec<usize> = (0..self.columns.len()).collect();
        let mut out = String::new();
        for part in self.parts(&all, width) {
            let own = self.of(&part);
            if !out.is_empty() {
                out.push('\n');
            }
            out += &own.arranged(styled, Some(width));
        }
        out
    }

    /// As many columns at a time as fit with no word broken, each time behind the first.
    fn parts(&self, columns: &[usize], width: usize) -> Vec<Vec<usize>> {
        let least = |i: &usize| PADDING + self.longest_word(*i);
        let mut parts = Vec::new();
        let mut last: Vec<usize> = columns.first().copied().into_iter().collect();
        for i in columns.iter().skip(1) {
            let wide = INDENT + BETWEEN * last.len() + last.iter().chain([i]).map(least).sum::<usize>() > width;
            if last.len() > 1 && wide {
                parts.push(std::mem::replace(&mut last, vec![columns[0], *i]));
            } else {
                last.push(*i);
            }
        }
        parts.push(last);
        parts
    }

    /// With these columns alone.
    fn of(&self, columns: &[usize]) -> Self {
        let pick = |row: &Vec<String>| columns.iter().map(|i| row[*i].clone()).collect();
        Self {
            columns: columns.iter().map(|i| self.columns[*i].clone()).collect(),
            rows: self.rows.iter().map(pick).collect(),
            has_sentences: self.has_sentences,
        }
    }

    /// Of a column and its header, characters.
    fn longest_word(&self, column: usize) -> usize {
        let cells = self.rows.iter().map(|row| &row[column]).chain([&self.columns[column].0]);
        cells.flat_map(|cell| cell.split_whitespace()).map(|word| word.chars().count()).max().unwrap_or(0)
    }

    fn arranged(&self, styled: bool, width: Option<usize>) -> String {
        let mut table = comfy_table::Table::new();
        table.load_style(TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─')));
        table.force_no_tty();
        if styled {
            table.enforce_styling();
        }
        match width {
            Some(width) => {
                table.set_content_arrangement(ContentArrangement::Dynamic);
                table.set_width(u16::try_from(width.saturating_sub(INDENT)).unwrap_or(u16::MAX).max(20));
            }
            None => {
                table.set_content_arrangement(ContentArrangement::Disabled);
            }
        }
        let alignment = |align: Align| match align {
            Align::Left => CellAlignment::Left,
            Align::Right => CellAlignment::Right,
        };
        table.set_header(self.columns.iter().map(|(name, align)| {
            let cell = Cell::new(name).set_alignment(alignment(*align));
            if styled { cell.add_attribute(Attribute::Bold) } else { cell }
        }));
        let lines = |text: &String| match width {
            None if self.has_sentences => wrapped(text, SENTENCE, 0, 0),
            _ => text.clone(),
        };
        for row in &self.rows {
            let cells = row.iter().zip(&self.columns);
            table.add_row(cells.map(|(text, (_, align))| Cell::new(lines(text)).set_alignment(alignment(*align))));
        }
        for i in 0..self.columns.len() {
            let least = u16::try_from(PADDING + self.longest_word(i)).unwrap_or(u16::MAX);
            if let Some(column) = table.column_mut(i) {
                column.set_constraint(ColumnConstraint::LowerBoundary(Width::Fixed(least)));
            }
        }
        table.trim_fmt().lines().map(|line| format!(" {line}\n")).collect()
    }
}

/// Columns of a sentence in a cell where there is room for it.
const SENTENCE: usize = 48;
/// Around the text of a cell, between two cells, and before every line, characters.
const PADDING: usize = 2;
const BETWEEN: usize = 1;
const INDENT: usize = 1;

/// Characters of a line that are seen: none of what styles it.
fn shown_width(line: &str) -> usize {
    let mut styles = false;
    line.chars()
        .filter(|c| {
            let seen = !styles && *c != '\u{1b}';
            styles = *c == '\u{1b}' || (styles && *c != 'm');
            seen
        })
        .count()
}

/// Columns of a terminal whose width is not known.
const USUAL: usize = 80;

/// Width of the terminal behind standard output, columns; none where there is no terminal.
pub fn window() -> Option<usize> {
    std::io::stdout().is_terminal().then(|| comfy_table::Table::new().width().map_or(USUAL, usize::from))
}

/// Width of the terminal behind standard error, columns.
pub fn columns() -> usize {
    comfy_table::Table::new().use_stderr().width().map_or(USUAL, usize::from)
}

/// From here on a number has an exponent: all its digits would make a table too wide.
const WIDE: f64 = 1e9;

/// `v` with `decimals` digits; a dash for what is missing or not finite.
pub fn number(v: impl Into<Option<f64>>, decimals: usize) -> String {
    match v.into() {
        Some(v) if v.is_finite() && v.abs() >= WIDE => format!("{v:.decimals$e}"),
        Some(v) if v.is_finite() => format!("{v:.decimals$}"),
        _ => "–".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_number_is_wider_than_a_column() {
        for v in [1e9, -1e9, 1e30, -1e308, 1.7e308] {
            assert!(
                number(v, 3).len() <= 12 && number(v, 3).parse::<f64>().is_ok_and(|w| (w / v - 1.0).abs() < 1e-3),
                "{v}"
            );
        }
        assert_eq!((number(999_999_999.4, 0), number(-12.5, 3)), ("999999999".into(), "-12.500".into()));
    }

    #[test]
    fn a_table_outside_a_terminal_has_no_escape_codes_and_right_aligned_numbers() {
        let mut table = Table::new("vehicle | >RMSE [mm]");
        table.row(["hummingbird".to_string(), number(9.04, 1)]).row(["firefly".to_string(), number(f64::NAN, 1)]);
        let text = table.render(false, None);
        assert!(!text.contains('\u{1b}'), "{text:?}");
        let ends: Vec<usize> = text
            .lines()
            .filter(|l| l.contains("9.0") || l.contains('–'))
            .map(|l| l.trim_end().chars().count())
            .collect();
        assert_eq!(ends.len(), 2, "{text}");
        assert_eq!(ends[0], ends[1], "{text}");
    }

    #[test]
    fn a_narrow_window_breaks_between_words_and_then_puts_columns_below() {
        let mut table = Table::new("derivative | of vehicle and air | >largest difference | >order | verdict");
        table.row(["Jacobian of a step", "hummingbird, still", "1.2e-9", "2.000", "certified"]);
        table.row(["through the flight", "hummingbird, gusty", "3.4e-8", "1.998", "certified beside a kink"]);
        let words = |text: &str| -> Vec<String> { text.split_whitespace().map(String::from).collect() };
        for width in [30, 40, 60, 80, 120] {
            for styled in [false, true] {
                let text = table.render(styled, Some(width));
                assert!(text.lines().all(|line| shown_width(line) <= width), "{width}\n{text}");
                if styled {
                    continue;
                }
                let told = words(&text);
                for (name, _) in table.columns() {
                    assert!(words(name).iter().all(|word| told.contains(word)), "{width}: {name}\n{text}");
                }
                for cell in table.rows().iter().flatten() {
                    assert!(words(cell).iter().all(|word| told.contains(word)), "{width}: {cell}\n{text}");
                }
            }
        }
        assert_eq!(table.render(false, Some(200)), table.render(false, None));
    }
}
