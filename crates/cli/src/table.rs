//! Tables for people: aligned numbers, units in the header, bold headers on a terminal only.

use super::words::shown;
use comfy_table::{Attribute, Cell, CellAlignment, ContentArrangement, LineStyle, TableStyle};

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
}

impl Table {
    /// With headers between bars, each with its unit; `>` marks those of numbers: `vehicle | >RMSE [mm]`.
    pub fn new(headers: &str) -> Self {
        let column = |header: &str| match header.trim().strip_prefix('>') {
            Some(name) => (name.into(), Align::Right),
            None => (header.trim().into(), Align::Left),
        };
        Self { columns: headers.split('|').map(column).collect(), rows: Vec::new() }
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

    /// Appends a row; missing cells stay empty, surplus ones are dropped.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        let mut row: Vec<String> = cells.into_iter().map(Into::into).collect();
        row.resize(self.columns.len(), String::new());
        row.iter_mut().for_each(|cell| *cell = shown(cell));
        self.rows.push(row);
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

    /// The table as text, one line per row, indented like a list of facts; `terminal` allows bold headers and fitting the width of the terminal.
    pub fn render(&self, terminal: bool) -> String {
        let mut table = comfy_table::Table::new();
        table.load_style(TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─')));
        if terminal {
            table.set_content_arrangement(ContentArrangement::Dynamic);
            table.enforce_styling();
            if let Some(width) = table.width() {
                table.set_width(width.saturating_sub(1).max(20));
            }
        } else {
            table.set_content_arrangement(ContentArrangement::Disabled);
            table.force_no_tty();
        }
        let alignment = |align: Align| match align {
            Align::Left => CellAlignment::Left,
            Align::Right => CellAlignment::Right,
        };
        table.set_header(self.columns.iter().map(|(name, align)| {
            let cell = Cell::new(name).set_alignment(alignment(*align));
            if terminal { cell.add_attribute(Attribute::Bold) } else { cell }
        }));
        for row in &self.rows {
            let cells = row.iter().zip(&self.columns);
            table.add_row(cells.map(|(text, (_, align))| Cell::new(text).set_alignment(alignment(*align))));
        }
        table.trim_fmt().lines().map(|line| format!(" {line}\n")).collect()
    }
}

/// Columns of a terminal whose width is not known.
const USUAL: usize = 80;

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
        for v in [1e9, -1e9, 1e30, -1e308, f64::MAX, f64::MIN] {
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
        let text = table.render(false);
        assert!(!text.contains('\u{1b}'), "{text:?}");
        let ends: Vec<usize> = text
            .lines()
            .filter(|l| l.contains("9.0") || l.contains('–'))
            .map(|l| l.trim_end().chars().count())
            .collect();
        assert_eq!(ends.len(), 2, "{text}");
        assert_eq!(ends[0], ends[1], "{text}");
    }
}
