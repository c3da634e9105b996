//! Numbers and names in words.

use omnidrones::internals::steers;

/// Longest text shown at one place, characters.
const LONGEST: usize = 4000;

/// A text in one line without what steers a terminal or turns the order of letters around, and not endless: names come from files
/// of anybody.
pub fn shown(text: &str) -> String {
    let plain = |c: char| if steers(c) { '·' } else { c };
    let n = text.chars().count();
    if n <= LONGEST {
        return text.chars().map(plain).collect();
    }
    // an error ends with what to do about it
    let (begin, end) = (text.chars().take(LONGEST / 2), text.chars().skip(n - LONGEST / 2));
    begin.chain(" … ".chars()).chain(end).map(plain).collect()
}

/// The same of a text whose lines are its own.
pub fn shown_lines(text: &str) -> String {
    text.split('\n').map(shown).collect::<Vec<_>>().join("\n")
}

/// A text in lines of at most `width` characters, broken between words, each as far in as it was and those that it is broken into `hang` in
/// at least. `first` characters stand before its first line already.
pub fn wrapped(text: &str, width: usize, first: usize, hang: usize) -> String {
    let mut out = String::new();
    let mut at = first;
    for (i, line) in text.split('\n').enumerate() {
        if i > 0 {
            out.push('\n');
            at = 0;
        }
        let words = line.trim_start_matches(' ');
        let indent = line.len() - words.len();
        out += &line[..indent];
        at += indent;
        let (hang, mut gap, mut begun) = (hang.max(indent), 0, false);
        for word in words.split(' ') {
            let long = word.chars().count();
            if begun && long > 0 && at + gap + long > width && hang < at {
                out.push('\n');
                out.push_str(&" ".repeat(hang));
                at = hang;
            } else if begun && long > 0 {
                out.push_str(&" ".repeat(gap));
                at += gap;
            }
            out += word;
            at += long;
            gap = if long > 0 { 1 } else { gap + 1 };
            begun = true;
        }
    }
    out
}

/// A remark in fewer columns is read word by word: it goes below its command.
const NARROW: usize = 24;

/// Lines of our own in `width` columns: remarks behind commands and settings stay in their column, and comments stay comments.
pub fn fitting(text: &str, width: usize) -> String {
    text.split('\n').map(|line| fitting_line(line, width)).collect::<Vec<_>>().join("\n")
}

fn fitting_line(line: &str, width: usize) -> String {
    if line.chars().count() <= width {
        return line.to_string();
    }
    let indent = " ".repeat(line.len() - line.trim_start_matches(' ').len());
    let comment = |text: &str, lead: &str| {
        let lines = wrapped(text, width.saturating_sub(lead.chars().count() + 2), 0, 0);
        lines.split('\n').map(|own| format!("{lead}# {own}")).collect::<Vec<_>>().join("\n")
    };
    if let Some(text) = line.trim_start_matches(' ').strip_prefix("# ") {
        return comment(text, &indent);
    }
    if let Some((setting, text)) = line.split_once("  # ").filter(|(setting, _)| setting.contains(" = ")) {
        let setting = setting.trim_end_matches(' ');
        return format!("{}\n{setting}", comment(text, &indent));
    }
    let Some((command, remark)) = example(line) else {
        return wrapped(line, width, 0, if line.starts_with("  omnidrones ") { 4 } else { 0 });
    };
    let column = line.chars().count() - remark.chars().count();
    if column + NARROW <= width {
        return wrapped(line, width, 0, column);
    }
    format!("{}\n{}", wrapped(command, width, 0, 4), wrapped(&format!("      {remark}"), width, 0, 6))
}

/// A command of ours and the remark behind it.
fn example(line: &str) -> Option<(&str, &str)> {
    let command = line.strip_prefix("  omnidrones ")?;
    let at = line.len() - command.len() + command.find("  ")?;
    Some((&line[..at], line[at..].trim_start()))
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

/// `1 rotor`, `4 rotors`.
pub fn counted(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
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
        for c in
            "\n\r\t\u{85}\u{2028}\u{2029}\u{202a}\u{202e}\u{2066}\u{2069}\u{200b}\u{200d}\u{200f}\u{2060}\u{feff}\u{ad}"
                .chars()
        {
            assert_eq!(shown(&format!("a{c}b")), "a·b", "{c:?}");
        }
        assert_eq!(shown("名前 ä\u{301}"), "名前 ä\u{301}", "letters of all scripts stay");
        assert_eq!(shown_lines("a\nb\u{202e}"), "a\nb·");
        let endless = shown(&format!("{}. The remedy.", "x".repeat(400_000)));
        assert!(endless.ends_with("xx. The remedy.") && endless.chars().count() == LONGEST + 3);
    }

    #[test]
    fn lines_are_broken_between_words_and_keep_every_word_and_their_indentation() {
        let text = "  a rule of several words,  and two spaces\n\n    next: out/firefly/gains.toml";
        assert_eq!(wrapped(text, 200, 0, 4), text);
        for width in [9, 20, 33] {
            let narrow = wrapped(text, width, 0, 4);
            let words = |s: &str| s.split_whitespace().map(String::from).collect::<Vec<_>>();
            assert_eq!(words(&narrow), words(text));
            let longest = |line: &str| line.trim().chars().count();
            assert!(narrow.lines().all(|l| l.chars().count() <= width || !l.trim().contains(' ')), "{narrow}");
            assert!(narrow.lines().filter(|l| longest(l) > 0).all(|l| l.starts_with("  ")), "{narrow}");
        }
        assert_eq!(wrapped("ab cd ef", 10, 6, 6), "ab\n      cd\n      ef");
    }

    #[test]
    fn a_remark_stays_in_its_column_or_goes_below_its_command() {
        let text = "Examples:\n  omnidrones fly iris        with a remark of seven words and more\n  omnidrones tune iris       short\n\nprose";
        assert_eq!(fitting(text, 100), text);
        for width in [36, 44, 52, 60, 64] {
            let narrow = fitting(text, width);
            assert!(narrow.lines().all(|line| line.chars().count() <= width), "{width}\n{narrow}");
            let words = |s: &str| s.split_whitespace().map(String::from).collect::<Vec<_>>();
            assert_eq!(words(&narrow), words(text));
            assert!(narrow.lines().filter(|l| l.starts_with("  o")).count() == 2, "{width}\n{narrow}");
            let second = narrow.lines().nth(2).unwrap();
            let indent = second.len() - second.trim_start().len();
            assert!(width >= 63 || indent == if 29 + NARROW <= width { 29 } else { 6 }, "{width}\n{narrow}");
        }
    }

    #[test]
    fn a_long_command_goes_on_behind_its_beginning() {
        let text = "  omnidrones train Hover --search apg.n_env=32,64 --search seed=1,2";
        assert_eq!(fitting(text, 56), text.replace(" --search seed", "\n    --search seed"));
        assert_eq!(fitting(text, 80), text);
    }

    #[test]
    fn settings_stay_a_file_in_every_width() {
        let text = "  # what a comment says, in more words than a narrow window has columns\n  \
                    rate = 300.0        # largest angular velocity of the vehicle, rad/s\n  short = 1    # yes";
        let parsed = |text: &str| text.parse::<toml::Table>().unwrap();
        for width in [24, 40, 60, 80, 200] {
            let narrow = fitting(text, width);
            assert!(narrow.lines().all(|line| line.chars().count() <= width), "{width}\n{narrow}");
            assert_eq!(parsed(&narrow), parsed(text), "{width}");
            for word in ["columns", "vehicle,", "rad/s", "yes"] {
                assert!(narrow.contains(word), "{width}: {word}\n{narrow}");
            }
        }
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
    fn a_few_of_many_are_counted() {
        assert_eq!([share_of(1.0 / 1024.0, 1024), share_of(0.0, 1024), share_of(0.5, 4)], ["1 of 1024", "0 %", "50 %"]);
    }
}
