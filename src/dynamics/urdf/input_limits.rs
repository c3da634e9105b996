//! Fences: sizes checked before the work starts, because a stack overflow or a failed allocation cannot be caught.
//!
//! [`check`] counts depth and elements with a loop over bytes that cannot recurse. On well-formed text its counts are
//! exact; on malformed text they are exact up to the place where the first real parser stops.

use super::fault::fault;
use base::defaults::with_defaults;
use base::error::{Error, Result};
use base::file_gate;
use std::path::Path;

with_defaults! {
    /// Largest sizes of a URDF or rotor file that an import accepts.
    #[derive(Debug, Clone, PartialEq)]
    pub struct InputLimits {
        /// Bytes of one file; default 16 MiB.
        pub file_bytes: usize = 16 << 20,
        /// Nesting depth of XML elements; default 64, at most 256 (deeper text would overflow a small thread's stack).
        pub depth: usize = 64,
        /// XML elements; default 100 000.
        pub elements: usize = 100_000,
        /// Attributes of one element; default 256 (XML parsers compare them pairwise).
        pub attributes: usize = 256,
        /// Bytes of one name; default 256.
        pub name_bytes: usize = 256,
        /// Links; default 512.
        pub bodies: usize = 512,
    }
}

/// Deepest nesting that any setting of [`InputLimits::depth`] allows.
const DEEPEST: usize = 256;

/// Reads a text file of a size within the limits.
pub(super) fn read(path: &Path, limits: &InputLimits) -> Result<String> {
    file_gate::read_text(path, limits.file_bytes as u64)
}

fn check_bytes(file: &str, bytes: u64, limits: &InputLimits) -> Result<()> {
    if bytes <= limits.file_bytes as u64 {
        return Ok(());
    }
    Err(Error::limit(
        format!("{file}: file size"),
        format!("{bytes} bytes"),
        format!("{} bytes", limits.file_bytes),
        "Leave out what is not a vehicle, or raise InputLimits::file_bytes.",
    ))
}

/// Counts bytes, depth, elements and attributes of `text` and refuses document types and entities.
pub(super) fn check(text: &str, file: &str, limits: &InputLimits) -> Result<()> {
    check_bytes(file, text.len() as u64, limits)?;
    let mut scanner = Scanner { text: text.as_bytes(), at: 0 };
    let (mut depth, mut elements) = (0usize, 0usize);
    while scanner.skip_past(b"<") {
        match scanner.markup() {
            Markup::Skipped => {}
            Markup::Unfinished(what) => {
                let place = format!("line {}", scanner.line());
                return Err(fault(
                    file,
                    place,
                    format!("{what} is not closed"),
                    "Close it, or restore the file's end.",
                ));
            }
            Markup::DocumentType => {
                return Err(fault(
                    file,
                    format!("line {}", scanner.line()),
                    "document types and entities (<!…>) are refused",
                    "Remove the <!DOCTYPE …> and write the values out.",
                ));
            }
            Markup::Close => depth = depth.saturating_sub(1),
            Markup::Open { attributes, empty } => {
                elements += 1;
                let here = depth + 1;
                depth += usize::from(!empty);
                check_open(file, &scanner, [here, elements, attributes], limits)?;
            }
        }
    }
    Ok(())
}

/// `counts`: depth, elements so far, attributes of this element.
fn check_open(file: &str, scanner: &Scanner, counts: [usize; 3], limits: &InputLimits) -> Result<()> {
    let [depth, elements, attributes] = counts;
    let rows = [
        (
            "XML nesting depth",
            depth,
            limits.depth.min(DEEPEST),
            "A URDF nests 5 deep: is this one? See InputLimits::depth.",
        ),
        ("number of XML elements", elements, limits.elements, "Split the file, or raise InputLimits::elements."),
        (
            "number of attributes of one element",
            attributes,
            limits.attributes,
            "Remove them; see InputLimits::attributes.",
        ),
    ];
    match rows.into_iter().find(|(_, value, limit, _)| value > limit) {
        None => Ok(()),
        Some((what, value, limit, remedy)) => {
            Err(Error::limit(format!("{file}: line {}: {what}", scanner.line()), value, limit, remedy))
        }
    }
}

/// What followed a `<`.
enum Markup {
    Skipped,
    Unfinished(&'static str),
    DocumentType,
    Open { attributes: usize, empty: bool },
    Close,
}

struct Scanner<'a> {
    text: &'a [u8],
    at: usize,
}

impl Scanner<'_> {
    fn rest(&self) -> &[u8] {
        self.text.get(self.at..).unwrap_or_default()
    }

    /// Moves past the next `needle`; at the end of the text where there is none, and then answers false.
    fn skip_past(&mut self, needle: &[u8]) -> bool {
        match self.rest().windows(needle.len()).position(|w| w == needle) {
            Some(offset) => {
                self.at += offset + needle.len();
                true
            }
            None => {
                self.at = self.text.len();
                false
            }
        }
    }

    fn markup(&mut self) -> Markup {
        let enclosed = [
            (&b"!--"[..], &b"-->"[..], "a comment (<!--)"),
            (&b"![CDATA["[..], &b"]]>"[..], "a CDATA section"),
            (&b"?"[..], &b"?>"[..], "a processing instruction (<?)"),
        ];
        for (open, close, what) in enclosed {
            if self.rest().starts_with(open) {
                self.at += open.len();
                let start = self.at;
                if self.skip_past(close) {
                    return Markup::Skipped;
                }
                self.at = start;
                return Markup::Unfinished(what);
            }
        }
        match self.rest().first() {
            Some(b'!') => Markup::DocumentType,
            Some(b'/') => {
                if self.skip_past(b">") {
                    Markup::Close
                } else {
                    Markup::Unfinished("an end tag (</)")
                }
            }
            _ => self.tag(),
        }
    }

    /// A start tag up to its `>`; quoted values may hold any character.
    fn tag(&mut self) -> Markup {
        let (mut attributes, mut quote, mut last) = (0, None, b' ');
        for (offset, &byte) in self.rest().iter().enumerate() {
            match (quote, byte) {
                (Some(open), _) if open == byte => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => attributes += 1,
                (None, b'>') => {
                    self.at += offset + 1;
                    return Markup::Open { attributes, empty: last == b'/' };
                }
                (None, b'<') => break,
                (None, _) => {}
            }
            last = byte;
        }
        Markup::Unfinished("a tag (or a quoted value in it)")
    }

    /// 1-based line of the present place.
    fn line(&self) -> usize {
        1 + self.text.iter().take(self.at).filter(|b| **b == b'\n').count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        check(text, "f.urdf", &InputLimits::default()).unwrap_err().to_string()
    }

    #[test]
    fn comments_quotes_cdata_and_instructions_do_not_count_as_elements() {
        let limits = InputLimits { depth: 2, elements: 2, ..InputLimits::default() };
        let text = "<?xml version='1.0'?><!-- <a><b><c> --><a x=\"<d><e>\" y='\">'><![CDATA[<f><g>]]><b/></a>";
        check(text, "f.urdf", &limits).unwrap();
    }

    #[test]
    fn depth_elements_and_attributes_over_the_limit_are_named_with_their_line() {
        let deep = format!("<a>\n{}", "<b>".repeat(64));
        assert!(message(&deep).starts_with("f.urdf: line 2: XML nesting depth is 65, over the limit of 64."));
        assert!(message(&"<a/>".repeat(100_001)).contains("number of XML elements is 100001"));
        assert!(
            message(&format!("<a {}/>", "x='' ".repeat(257))).contains("number of attributes of one element is 257")
        );
    }

    #[test]
    fn a_document_type_is_refused_and_an_open_comment_is_named() {
        assert!(message("<!DOCTYPE a [<!ENTITY b 'c'>]><a/>").contains("document types and entities"));
        assert!(message("<a><!-- b").contains("a comment (<!--) is not closed"));
        assert!(message("<a b='c").contains("not closed"));
    }

    #[test]
    fn a_depth_limit_above_what_a_stack_holds_is_capped() {
        let limits = InputLimits { depth: usize::MAX, ..InputLimits::default() };
        assert!(check(&"<a>".repeat(257), "f", &limits).is_err());
    }
}
