//! Words of comments, in letters and lines that every compiler takes.

/// What compilers may not read, in letters that they do.
const SPELT: [(char, &str); 59] = [
    ('→', "->"),
    ('²', "^2"),
    ('³', "^3"),
    ('−', "-"),
    ('–', "-"),
    ('·', "*"),
    ('×', "x"),
    ('±', "+-"),
    ('≥', ">="),
    ('≤', "<="),
    ('≠', "!="),
    ('≈', "~"),
    ('∈', "in"),
    ('∉', "not in"),
    ('‖', "|"),
    ('√', "sqrt"),
    ('Σ', "sum"),
    ('∠', "angle"),
    ('∞', "infinity"),
    ('°', " degrees"),
    ('′', "'"),
    ('…', "..."),
    ('ω', "omega"),
    ('Ω', "Omega"),
    ('ψ', "psi"),
    ('θ', "theta"),
    ('φ', "phi"),
    ('α', "alpha"),
    ('κ', "kappa"),
    ('τ', "tau"),
    ('σ', "sigma"),
    ('μ', "mu"),
    ('π', "pi"),
    ('Δ', "Delta"),
    ('δ', "delta"),
    ('λ', "lambda"),
    ('₁', "_1"),
    ('₂', "_2"),
    ('₊', "+"),
    ('ⱼ', "_j"),
    ('ᵢ', "_i"),
    ('₀', "_0"),
    ('₅', "_5"),
    ('⁴', "^4"),
    ('⁵', "^5"),
    ('⁶', "^6"),
    ('⁻', "^-"),
    ('⁺', "+"),
    ('ᵀ', "^T"),
    ('\u{307}', "'"),
    ('\u{308}', "''"),
    ('\u{302}', "^"),
    ('\u{304}', "-"),
    ('½', "1/2"),
    ('¼', "1/4"),
    ('∂', "d"),
    ('γ', "gamma"),
    ('ζ', "zeta"),
    ('ŝ', "s^"),
];

/// Words of others for a comment: in letters that every compiler reads, without what ends or begins one.
pub(crate) fn plain(text: &str) -> String {
    ascii(text).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace(['\n', '\r', '\\'], " ")
}

/// In letters that every compiler reads.
fn ascii(text: &str) -> String {
    let mut own = String::with_capacity(text.len());
    for c in text.chars() {
        match SPELT.iter().find(|(letter, _)| *letter == c) {
            _ if c.is_ascii() => own.push(c),
            Some((_, spelt)) => own += spelt,
            None => own.push('?'),
        }
    }
    own
}

/// Words on lines of a comment.
pub(crate) fn comment(text: &mut String, words: &str) {
    let words = plain(words);
    let mut line = String::from(" *");
    for word in words.split_whitespace() {
        if line.len() + word.len() > 110 {
            text.push_str(&line);
            text.push('\n');
            line = " *".into();
        }
        line.push(' ');
        line += word;
    }
    text.push_str(&line);
    text.push('\n');
}
