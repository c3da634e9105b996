//! Colours and sizes of every figure: the Okabe–Ito palette (safe for colour-blind readers), light grid, dark text.

/// An sRGB colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour(
    /// Red.
    pub u8,
    /// Green.
    pub u8,
    /// Blue.
    pub u8,
);

impl Colour {
    /// Okabe–Ito blue.
    pub const BLUE: Self = Self(0, 114, 178);
    /// Okabe–Ito vermillion.
    pub const VERMILLION: Self = Self(213, 94, 0);
    /// Okabe–Ito bluish green.
    pub const GREEN: Self = Self(0, 158, 115);
    /// Okabe–Ito reddish purple.
    pub const PURPLE: Self = Self(204, 121, 167);
    /// Okabe–Ito orange.
    pub const ORANGE: Self = Self(230, 159, 0);
    /// Okabe–Ito sky blue.
    pub const SKY: Self = Self(86, 180, 233);
    /// Near black, for text and the most important line.
    pub const INK: Self = Self(33, 37, 41);
    /// Mid grey, for references, limits and secondary text.
    pub const GREY: Self = Self(110, 117, 125);
    /// Light grey, for shading.
    pub const PALE: Self = Self(222, 226, 230);
    pub(super) const GRID: Self = Self(231, 234, 237);
    pub(super) const FRAME: Self = Self(173, 181, 189);
    pub(super) const SHADOW: Self = Self(214, 218, 222);

    /// Mixed with much white, for surfaces.
    pub(super) fn tint(self) -> Self {
        let pale = |v: u8| (0.22 * f64::from(v) + 0.78 * 255.0).round() as u8;
        Self(pale(self.0), pale(self.1), pale(self.2))
    }

    /// For the edges of a surface of this colour.
    pub(super) fn darker(self) -> Self {
        self.times(0.55)
    }

    /// Brighter or darker by a factor, up to white.
    pub(super) fn times(self, factor: f64) -> Self {
        let of = |v: u8| (factor * f64::from(v)).clamp(0.0, 255.0) as u8;
        Self(of(self.0), of(self.1), of(self.2))
    }

    /// The `i`-th colour of a chart whose series name none; repeats after seven.
    pub fn nth(i: usize) -> Self {
        const ORDER: [Colour; 7] =
            [Colour::BLUE, Colour::VERMILLION, Colour::GREEN, Colour::PURPLE, Colour::ORANGE, Colour::SKY, Colour::INK];
        ORDER[i % ORDER.len()]
    }

    /// Dark violet to yellow for `t` in [0, 1], evenly bright steps (viridis, by linear interpolation of its stops).
    pub fn heat(t: f64) -> Self {
        const STOPS: [[f64; 3]; 9] = [
            [68.0, 1.0, 84.0],
            [71.0, 44.0, 122.0],
            [59.0, 81.0, 139.0],
            [44.0, 113.0, 142.0],
            [33.0, 144.0, 141.0],
            [39.0, 173.0, 129.0],
            [92.0, 200.0, 99.0],
            [170.0, 220.0, 50.0],
            [241.0, 220.0, 30.0],
        ];
        let x = if t.is_finite() { t.clamp(0.0, 1.0) * 8.0 } else { 0.0 };
        let i = (x as usize).min(7);
        let mix = |c: usize| (STOPS[i][c] + (x - i as f64) * (STOPS[i + 1][c] - STOPS[i][c])).round() as u8;
        Self(mix(0), mix(1), mix(2))
    }
}

/// Font sizes and gaps in figure units (one unit is two pixels of a PNG).
pub(super) mod size {
    pub const FIGURE_TITLE: f64 = 16.0;
    pub const SUBTITLE: f64 = 10.5;
    pub const TITLE: f64 = 11.5;
    pub const LABEL: f64 = 10.0;
    pub const TICK: f64 = 9.0;
    pub const LEGEND: f64 = 9.5;
    pub const LINE: f64 = 1.4;
    pub const MARGIN: f64 = 14.0;
    pub const GAP: f64 = 16.0;
}
