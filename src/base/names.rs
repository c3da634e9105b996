//! Names out of files of anybody, where people and other programs read them.

/// Whether a character steers a terminal, ends a line, turns the order of letters around (Unicode Standard Annex 9), or stands there
/// unseen, so that two names look alike.
pub fn steers(c: char) -> bool {
    c.is_control() || is_format(c) || matches!(c, '\u{2028}' | '\u{2029}')
}

/// General category Cf of Unicode 16.0, and what is reserved between its characters.
fn is_format(c: char) -> bool {
    matches!(
        c,
        '\u{ad}'
            | '\u{600}'..='\u{605}'
            | '\u{61c}'
            | '\u{6dd}'
            | '\u{70f}'
            | '\u{890}'..='\u{891}'
            | '\u{8e2}'
            | '\u{180e}'
            | '\u{200b}'..='\u{200f}'
            | '\u{202a}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}'
            | '\u{feff}'
            | '\u{fff9}'..='\u{fffb}'
            | '\u{110bd}'
            | '\u{110cd}'
            | '\u{13430}'..='\u{1343f}'
            | '\u{1bca0}'..='\u{1bca3}'
            | '\u{1d173}'..='\u{1d17a}'
            | '\u{e0001}'
            | '\u{e0020}'..='\u{e007f}'
    )
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
    fn no_character_that_is_unseen_is_shown_and_letters_are() {
        let ends = [
            [0xad, 0xad],
            [0x600, 0x605],
            [0x61c, 0x61c],
            [0x180e, 0x180e],
            [0x200b, 0x200f],
            [0x202a, 0x202e],
            [0x2060, 0x2064],
            [0x2066, 0x206f],
            [0xfeff, 0xfeff],
            [0xfff9, 0xfffb],
            [0x13430, 0x1343f],
            [0xe0001, 0xe0001],
            [0xe0020, 0xe007f],
            [0, 0x1f],
            [0x7f, 0x9f],
            [0x2028, 0x2029],
        ];
        for c in ends.iter().flat_map(|[a, b]| *a..=*b).filter_map(char::from_u32) {
            assert_eq!(cell(&format!("a{c}b")), if c == '\t' { "a\tb" } else { "a·b" }, "{:x}", u32::from(c));
        }
        let seen = [
            'a', 'é', 'ß', '中', '→', '°', ' ', '\u{a0}', '\u{ac}', '\u{ae}', '\u{200a}', '\u{2010}', '\u{fffc}', '🚁',
        ];
        seen.iter().for_each(|c| assert!(!steers(*c), "{:x}", u32::from(*c)));
    }

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
