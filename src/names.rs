//! Names out of files of anybody, where people and other programs read them.

/// Whether a character steers a terminal, ends a line, or turns the order of letters around (Unicode Standard Annex 9).
pub fn steers(c: char) -> bool {
    let turns = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || turns || matches!(c, '\u{2028}' | '\u{2029}')
}

/// A name as a cell of a table that a spreadsheet may open: one that would be taken for a formula gets an apostrophe in front
/// (OWASP, CSV injection). Numbers stay as they are.
pub fn cell(name: &str) -> String {
    let one_line: String = name.chars().map(|c| if c != '\t' && steers(c) { '·' } else { c }).collect();
    let formula = name.starts_with(['=', '+', '-', '@', '\t', '\r', '\n', '＝', '＋', '－', '＠']);
    if formula && name.trim().parse::<f64>().is_err() { format!("'{one_line}") } else { one_line }
}

/// The same between commas.
pub fn quoted_cell(name: &str) -> String {
    let text = cell(name);
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_is_a_formula_and_no_number_changes() {
        for name in ["=1+1", "+a", "-a", "@sum(a)", "\t=1", "\r=1", "\n=1", "-", "+", "=", "-1a", "＝1", "-1,2"] {
            let cell = cell(name);
            assert!(cell.starts_with('\'') && !cell.contains(['\n', '\r']), "{name:?}: {cell}");
        }
        for text in ["-1", "+1.5e-3", "-inf", "-NaN", "", "0", "a=b", "rotor_0", "x [m/s]", "é", "1-2"] {
            assert_eq!(cell(text), text);
        }
        assert_eq!(quoted_cell("=a,\"b\""), "\"'=a,\"\"b\"\"\"");
    }
}
