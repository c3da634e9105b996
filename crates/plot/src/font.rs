//! The one bundled font: a subset of Roboto (Apache-2.0, see `font`), so that figures need no system fonts.

use super::canvas::Anchor;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, FontTransform, IntoFont, RGBColor, TextStyle, register_font};
use std::sync::OnceLock;

/// The name under which the font is registered is also what an SVG file asks for: a list, so that a reader without
/// Roboto falls back to another plain face.
const FAMILY: &str = "Roboto, Helvetica Neue, Arial, sans-serif";
static BYTES: &[u8] = include_bytes!("../font/roboto-subset.ttf");

/// Ascent minus descent of the face, em: ab_glyph scales by this height, not by the em.
const BITMAP_HEIGHT: f64 = 2400.0 / 2048.0;
/// plotters' SVG back end writes `font-size = size / 1.24`.
const SVG_HEIGHT: f64 = 1.24;

/// Registers the font once. The bytes are part of the program and a test reads them, so a failure is not data.
pub(super) fn register() {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        let _ = register_font(FAMILY, FontStyle::Normal, BYTES);
    });
}

/// Width of `text` at font size `em`, in the unit of `em`.
pub(super) fn width(text: &str, em: f64) -> f64 {
    register();
    let measure = (FAMILY, 1000.0 * BITMAP_HEIGHT).into_font();
    measure.box_size(text).map_or(0.5 * em * text.chars().count() as f64, |(w, _)| f64::from(w) * em / 1000.0)
}

/// Smaller letters are not read, units.
const LEAST: f64 = 6.5;

/// A text and its size such that it takes no more than `room`: smaller, then cut with an ellipsis.
pub(super) fn fitted(text: String, em: f64, room: f64) -> (String, f64) {
    let own = width(&text, em);
    if own <= room || own <= 0.0 || room <= 0.0 {
        return (text, em);
    }
    let em = (em * room / own).max(em.min(LEAST));
    let (mut text, mut cut) = (text, false);
    while width(&text, em) + if cut { width("…", em) } else { 0.0 } > room && text.pop().is_some() {
        cut = true;
    }
    (if cut { text + "…" } else { text }, em)
}

/// A text in lines of at most `room`, broken between words; a word longer than that has a line of its own.
pub(super) fn lines(text: &str, em: f64, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    // several spaces set parts apart, unless a line ends there
    for part in text.split_inclusive(' ') {
        match lines.last_mut() {
            Some(last) if part == " " || width(format!("{last}{part}").trim_end(), em) <= room => *last += part,
            _ => lines.push(part.into()),
        }
    }
    lines.iter().map(|line| line.trim().to_string()).filter(|line| !line.is_empty()).collect()
}

/// plotters' style for text of size `em`, and how far its baseline lies below the given point (or to its right, when
/// `vertical`), in the unit of `em`.
pub(super) fn style(em: f64, colour: RGBColor, anchor: Anchor, vertical: bool, svg: bool) -> (TextStyle<'static>, f64) {
    let horizontal = match anchor {
        Anchor::Start => HPos::Left,
        Anchor::Middle => HPos::Center,
        Anchor::End => HPos::Right,
    };
    let (size, baseline) =
        if svg { (em * SVG_HEIGHT, 0.76 * em) } else { (em * BITMAP_HEIGHT, 0.5 * em * BITMAP_HEIGHT) };
    let font = (FAMILY, size).into_font();
    let font = if vertical { font.transform(FontTransform::Rotate270) } else { font };
    let mut style = TextStyle::from(font).pos(Pos::new(horizontal, VPos::Top));
    style.color = colour.to_backend_color();
    (style, baseline)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bundled_font_is_readable_and_small() {
        assert!(register_font("probe", FontStyle::Normal, BYTES).is_ok());
        assert!(BYTES.len() < 120_000, "{} bytes", BYTES.len());
        assert!(width("ω", 10.0) > 3.0);
    }

    #[test]
    fn a_text_is_made_to_fit_by_smaller_letters_before_it_is_cut() {
        let whole = "mean of three seeds with the interval".to_string();
        let own = width(&whole, 10.0);
        assert_eq!(fitted(whole.clone(), 10.0, own + 1.0), (whole.clone(), 10.0));
        let (text, em) = fitted(whole.clone(), 10.0, 0.8 * own);
        assert!(text == whole && em < 10.0 && width(&text, em) <= 0.8 * own + 1e-6, "{em}");
        for share in [0.5, 0.2, 0.01] {
            let (text, em) = fitted(whole.clone(), 10.0, share * own);
            assert!(
                text.ends_with('…') && em == LEAST && width(&text, em) <= (share * own).max(width("…", em)),
                "{text}"
            );
        }
    }

    #[test]
    fn lines_hold_every_word_and_none_is_longer_than_the_room() {
        let text = "RMSE 3.1 mm   ·   max error 5 mm   ·   rotors saturated 0.0 % of the time";
        for room in [60.0, 140.0, 1000.0] {
            let lines = lines(text, 10.0, room);
            assert!(lines.iter().all(|line| width(line, 10.0) <= room), "{lines:?}");
            let words = |s: &str| s.split_whitespace().map(String::from).collect::<Vec<_>>();
            assert_eq!(words(&lines.join(" ")), words(text));
        }
        assert_eq!(lines(text, 10.0, 1000.0), [text]);
    }
}
