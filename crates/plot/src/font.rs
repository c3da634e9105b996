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
}
