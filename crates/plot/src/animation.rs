//! Figures one after the other as one GIF file.
//!
//! All frames share one palette of 255 colours, the most frequent ones; the 256th stands for a pixel that stays as it was,
//! which makes frames small.

use super::Figure;
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use omnidrones::error::{Error, Result};
use omnidrones::internals::replace_with;
use omnidrones::parallel::Threads;
use std::collections::HashMap;
use std::path::Path;

/// Most frames of a file.
pub const MAX_FRAMES: usize = 2000;
/// Frames painted side by side: what is in memory at once.
const BATCH: usize = 16;
/// Colour of a palette that leaves a pixel as it was.
const STAYS: u8 = 255;

/// Writes `n` figures of equal size, `seconds` apart (whole hundredths, 0.02 or more), as a GIF that repeats for ever;
/// one pixel per figure unit. `seen` is told how many are painted.
///
/// # Errors
/// [`Error::Limit`] for more than [`MAX_FRAMES`] or none, [`Error::Value`] for frames of another size, and as
/// [`Figure::save`].
pub fn save_gif(
    path: impl AsRef<Path>,
    n: usize,
    seconds: f64,
    figure: &(impl Fn(usize) -> Figure + Sync),
    seen: &mut dyn FnMut(usize),
) -> Result<()> {
    let path = path.as_ref();
    if n == 0 || n > MAX_FRAMES {
        return Err(Error::limit("frames of an animation", n, format!("1 to {MAX_FRAMES}"), "Draw every second one."));
    }
    let paint = |k: usize| figure(k).paint()?.pixels(1, path);
    let (w, h, first) = paint(0)?;
    let middle = paint(n / 2)?.2;
    let last = paint(n - 1)?.2;
    let palette = Palette::of(&[&first, &middle, &last]);
    let (Ok(width), Ok(height)) = (u16::try_from(w), u16::try_from(h)) else {
        return Err(Error::limit("size of an animation", format!("{w} × {h}"), u16::MAX, "Give a smaller figure."));
    };
    let delay = (100.0 * seconds).round().clamp(2.0, 6000.0) as u16;
    let threads = Threads::default();
    replace_with(path, |file| {
        let refused = |e: gif::EncodingError| Error::file(path, std::io::Error::other(e));
        let mut encoder =
            Encoder::new(std::io::BufWriter::new(file), width, height, &palette.bytes()).map_err(refused)?;
        encoder.set_repeat(Repeat::Infinite).map_err(refused)?;
        let mut before: Vec<u8> = Vec::new();
        for begin in (0..n).step_by(BATCH) {
            let painted = threads.map(BATCH.min(n - begin), |k| {
                let (own_w, own_h, pixels) = paint(begin + k)?;
                if (own_w, own_h) != (w, h) {
                    let (size, wanted) = (format!("{own_w} × {own_h}"), format!("{w} × {h}, as the first"));
                    return Err(Error::value(format!("size of frame {}", begin + k), size, wanted, "Fix it."));
                }
                Ok(palette.indices(&pixels))
            });
            for (k, indices) in painted.into_iter().enumerate() {
                let indices = indices?;
                let mut frame = changes(&before, &indices, w);
                // the last one stays for a while
                frame.delay = if begin + k + 1 == n { delay.max(150) } else { delay };
                encoder.write_frame(&frame).map_err(refused)?;
                before = indices;
                seen(begin + k + 1);
            }
        }
        let mut file = encoder.into_inner().map_err(refused)?;
        std::io::Write::flush(&mut file).map_err(|e| Error::file(path, e))
    })
}

/// The rectangle in which a picture differs from the one before, what is equal in it left out.
fn changes(before: &[u8], now: &[u8], width: usize) -> Frame<'static> {
    let height = now.len() / width;
    if before.is_empty() {
        return Frame { width: width as u16, height: height as u16, buffer: now.to_vec().into(), ..Frame::default() };
    }
    let differs = |at: &usize| before[*at] != now[*at];
    let of_row = |y: usize| y * width..(y + 1) * width;
    let rows: Vec<usize> = (0..height).filter(|y| before[of_row(*y)] != now[of_row(*y)]).collect();
    // a picture without any change is one pixel that stays
    let (top, bottom) = (rows.first().copied().unwrap_or(0), rows.last().copied().unwrap_or(0));
    let places = || rows.iter().flat_map(|y| of_row(*y)).filter(differs).map(|at| at % width);
    let (left, right) = (places().min().unwrap_or(0), places().max().unwrap_or(0));
    let row = |y: usize| (y * width + left..=y * width + right).map(|at| if differs(&at) { now[at] } else { STAYS });
    Frame {
        left: left as u16,
        top: top as u16,
        width: (right - left + 1) as u16,
        height: (bottom - top + 1) as u16,
        transparent: Some(STAYS),
        dispose: DisposalMethod::Keep,
        buffer: (top..=bottom).flat_map(row).collect::<Vec<u8>>().into(),
        ..Frame::default()
    }
}

/// Up to 255 colours, and which of them is nearest to each of 32 768 shades.
struct Palette {
    colours: Vec<[u8; 3]>,
    nearest: Vec<u8>,
}

/// The place of a colour among the shades: five bits of each channel.
fn shade(rgb: &[u8]) -> usize {
    rgb.iter().fold(0, |place, v| place << 5 | usize::from(v >> 3))
}

impl Palette {
    /// The most frequent shades of some pictures, each by its most frequent colour.
    fn of(pictures: &[&Vec<u8>]) -> Self {
        let mut counts: HashMap<[u8; 3], usize> = HashMap::new();
        for rgb in pictures.iter().flat_map(|p| p.as_chunks::<3>().0) {
            *counts.entry(*rgb).or_default() += 1;
        }
        let mut colours: Vec<([u8; 3], usize)> = counts.into_iter().collect();
        // equal counts in the order of the colours: the same pictures make the same file
        colours.sort_by_key(|(rgb, n)| (std::cmp::Reverse(*n), *rgb));
        let mut taken = vec![false; 1 << 15];
        colours.retain(|(rgb, _)| !std::mem::replace(&mut taken[shade(rgb)], true));
        colours.truncate(usize::from(STAYS));
        let colours: Vec<[u8; 3]> = colours.into_iter().map(|(rgb, _)| rgb).collect();
        let distance = |a: [u8; 3], b: [u8; 3]| (0..3).map(|i| a[i].abs_diff(b[i]) as u32).map(|d| d * d).sum::<u32>();
        let nearest = (0..1usize << 15).map(|place| {
            let middle = [10, 5, 0].map(|bits| ((place >> bits & 31) << 3 | 4) as u8);
            let own = colours.iter().position(|rgb| shade(rgb) == place);
            let best = || (0..colours.len()).min_by_key(|k| distance(colours[*k], middle)).unwrap_or(0);
            own.unwrap_or_else(best) as u8
        });
        Self { nearest: nearest.collect(), colours }
    }

    fn bytes(&self) -> Vec<u8> {
        // the last place is never shown
        let mut bytes = self.colours.concat();
        bytes.resize(3 * 256, 0);
        bytes
    }

    fn indices(&self, pixels: &[u8]) -> Vec<u8> {
        pixels.as_chunks::<3>().0.iter().map(|rgb| self.nearest[shade(rgb)]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Colour, Panel, Series};
    use super::*;

    fn wave(k: usize) -> Figure {
        let points = (0..=k).map(|i| (i as f64, (0.5 * i as f64).sin())).collect();
        let panel = Panel::new("", "time [s]", "x [m]").x_range(0.0, 9.0).y_range(-1.0, 1.0);
        Figure::new("Wave").size(200.0, 120.0).chart(panel.series(Series::line("", points).colour(Colour::BLUE)))
    }

    #[test]
    fn the_frames_of_a_file_are_the_figures_but_for_their_palette() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wave.gif");
        let mut told = Vec::new();
        save_gif(&path, 10, 0.05, &wave, &mut |k| told.push(k)).unwrap();
        assert_eq!(told, (1..=10).collect::<Vec<_>>());
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(std::fs::File::open(&path).unwrap()).unwrap();
        let (w, mut shown, mut n) = (usize::from(decoder.width()), vec![0u8; 200 * 120 * 3], 0);
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            for (i, pixel) in frame.buffer.chunks_exact(4).enumerate().filter(|(_, p)| p[3] > 0) {
                let (x, y) = (i % usize::from(frame.width), i / usize::from(frame.width));
                let at = 3 * ((usize::from(frame.top) + y) * w + usize::from(frame.left) + x);
                shown[at..at + 3].copy_from_slice(&pixel[..3]);
            }
            let (_, _, wanted) = wave(n).paint().unwrap().pixels(1, &path).unwrap();
            let worst = shown.iter().zip(&wanted).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(worst <= 24, "frame {n}: {worst}"); // 7
            n += 1;
        }
        assert_eq!(n, 10);
        // 10 frames of 72 kB of pixels
        assert!(std::fs::metadata(&path).unwrap().len() < 20_000); // 3 046
    }

    #[test]
    fn the_same_figures_are_the_same_file_and_none_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a.gif", "b.gif"].map(|name| {
            save_gif(folder.path().join(name), 20, 0.05, &wave, &mut |_| {}).unwrap();
            std::fs::read(folder.path().join(name)).unwrap()
        });
        assert_eq!(a, b);
        for n in [0, MAX_FRAMES + 1] {
            let path = folder.path().join("c.gif");
            assert!(save_gif(&path, n, 0.05, &wave, &mut |_| {}).is_err() && !path.exists());
        }
    }
}
