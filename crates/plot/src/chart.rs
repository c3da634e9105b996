//! A two-dimensional chart: lines and markers over labelled axes, with bands and limits.

use super::axis::{Axis, drawable};
use super::canvas::{Anchor, Area, Canvas, Point};
use super::font;
use super::legend::{Entry, Header, Mark};
use super::shape;
use super::theme::{Colour, size};

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Shown in the legend; empty keeps it out.
    pub name: String,
    /// (x, y); a non-finite coordinate leaves a gap.
    pub points: Vec<(f64, f64)>,
    /// `None` takes the next colour of the palette.
    pub colour: Option<Colour>,
    /// Dashed instead of solid.
    pub dashed: bool,
    /// Line width in figure units (two pixels of a PNG).
    pub width: f64,
    /// A dot at every point.
    pub markers: bool,
}

impl Series {
    /// A solid line in the next colour of the palette.
    pub fn line(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, colour: None, dashed: false, width: size::LINE, markers: false }
    }

    /// With `colour`.
    pub fn colour(mut self, colour: Colour) -> Self {
        self.colour = Some(colour);
        self
    }

    /// Dashed.
    pub fn dashed(mut self) -> Self {
        self.dashed = true;
        self
    }

    /// With line width `width`.
    pub fn width(mut self, width: f64) -> Self {
        self.width = width;
        self
    }

    /// With a dot at every point, as for a history of few steps.
    pub fn markers(mut self) -> Self {
        self.markers = true;
        self
    }
}

/// A shaded interval of one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Shown in the legend; empty keeps it out.
    pub name: String,
    /// Interval of the axis.
    pub from: f64,
    /// Its end.
    pub to: f64,
    /// True: an interval of x, over the whole height.
    pub along_x: bool,
    /// Its colour.
    pub colour: Colour,
    /// 0 to 1.
    pub opacity: f64,
}

/// The room between two curves: a spread over many.
#[derive(Debug, Clone, PartialEq)]
pub struct Ribbon {
    /// Shown in the legend; empty keeps it out.
    pub name: String,
    /// (x, lower, upper) with x ascending; what is not drawable leaves a gap.
    pub points: Vec<(f64, f64, f64)>,
    /// Drawn pale.
    pub colour: Colour,
}

/// A straight line over the whole chart: a limit, a mean, an event.
#[derive(Debug, Clone, PartialEq)]
pub struct Rule {
    /// Shown in the legend; empty keeps it out.
    pub name: String,
    /// Where it crosses its axis.
    pub value: f64,
    /// True: at an x, upright.
    pub along_x: bool,
    /// Its colour.
    pub colour: Colour,
}

/// A chart with its title, labelled axes, curves, bands and limits. Labels carry their units: `time [s]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// Above the chart, at the left.
    pub title: String,
    /// Below the x axis.
    pub x_label: String,
    /// Beside the y axis.
    pub y_label: String,
    /// Painted in order.
    pub series: Vec<Series>,
    /// Painted below the curves.
    pub bands: Vec<Band>,
    /// Painted with the bands.
    pub ribbons: Vec<Ribbon>,
    /// Painted above the bands, below the curves.
    pub rules: Vec<Rule>,
    /// Fixed range of x instead of that of the data.
    pub x_range: Option<(f64, f64)>,
    /// Fixed range of y instead of that of the data.
    pub y_range: Option<(f64, f64)>,
    /// Least range of y that the data are drawn over: below it they are rounding.
    pub least_span: f64,
    /// Makes y start at zero when no value is negative.
    pub from_zero: bool,
    /// Logarithmic x; values ≤ 0 are gaps.
    pub log_x: bool,
    /// Logarithmic y; values ≤ 0 are gaps.
    pub log_y: bool,
}

impl Panel {
    /// An empty chart.
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        Self { title: title.into(), x_label: x_label.into(), y_label: y_label.into(), ..Self::default() }
    }

    /// With one more curve.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// With a shaded interval of x.
    pub fn x_band(mut self, name: impl Into<String>, from: f64, to: f64, colour: Colour) -> Self {
        self.bands.push(Band { name: name.into(), from, to, along_x: true, colour, opacity: 0.45 });
        self
    }

    /// With a shaded interval of y.
    pub fn y_band(mut self, name: impl Into<String>, from: f64, to: f64, colour: Colour) -> Self {
        self.bands.push(Band { name: name.into(), from, to, along_x: false, colour, opacity: 0.22 });
        self
    }

    /// With the room between two curves shaded: (x, lower, upper).
    pub fn ribbon(mut self, name: impl Into<String>, points: Vec<(f64, f64, f64)>, colour: Colour) -> Self {
        self.ribbons.push(Ribbon { name: name.into(), points, colour });
        self
    }

    /// With a dashed level at `value` of y.
    pub fn level(mut self, name: impl Into<String>, value: f64, colour: Colour) -> Self {
        self.rules.push(Rule { name: name.into(), value, along_x: false, colour });
        self
    }

    /// With a dashed upright line at `value` of x.
    pub fn event(mut self, name: impl Into<String>, value: f64, colour: Colour) -> Self {
        self.rules.push(Rule { name: name.into(), value, along_x: true, colour });
        self
    }

    /// With a fixed range of y.
    pub fn y_range(mut self, lo: f64, hi: f64) -> Self {
        self.y_range = Some((lo, hi));
        self
    }

    /// With y over at least this range.
    pub fn least_span(mut self, span: f64) -> Self {
        self.least_span = span;
        self
    }

    /// With a fixed range of x.
    pub fn x_range(mut self, lo: f64, hi: f64) -> Self {
        self.x_range = Some((lo, hi));
        self
    }

    /// With y from zero where no value is negative.
    pub fn from_zero(mut self) -> Self {
        self.from_zero = true;
        self
    }

    /// With a logarithmic y axis.
    pub fn log_y(mut self) -> Self {
        self.log_y = true;
        self
    }

    /// With a logarithmic x axis.
    pub fn log_x(mut self) -> Self {
        self.log_x = true;
        self
    }

    fn entries(&self) -> Vec<Entry> {
        let line = |s: &Series, shape: Option<usize>| match (shape, s.width) {
            (Some(shape), width) if width > 0.0 => Mark::Shaped { shape, width },
            (None, width) if width > 0.0 => Mark::Line { dashed: s.dashed, width },
            _ => Mark::Dot,
        };
        let curves = self.series.iter().zip(self.shapes()).enumerate().map(|(i, (s, shape))| Entry {
            name: s.name.clone(),
            colour: s.colour.unwrap_or(Colour::nth(i)),
            mark: line(s, shape),
        });
        let rules = self.rules.iter().map(|r| Entry {
            name: r.name.clone(),
            colour: r.colour,
            mark: Mark::Line { dashed: true, width: 1.0 },
        });
        let bands = self.bands.iter().map(|b| Entry {
            name: b.name.clone(),
            colour: b.colour,
            mark: Mark::Band((b.opacity * 1.4).min(1.0)),
        });
        let ribbons =
            self.ribbons.iter().map(|r| Entry { name: r.name.clone(), colour: r.colour.tint(), mark: Mark::Band(1.0) });
        let mut entries: Vec<Entry> =
            curves.chain(ribbons).chain(rules).chain(bands).filter(|e| !e.name.is_empty()).collect();
        let mut seen = std::collections::HashSet::new();
        entries.retain(|e| seen.insert(e.name.clone()));
        entries
    }

    /// The shape of each curve's marks, where it has some: of whole lines that are named and not alone, one for each name.
    fn shapes(&self) -> Vec<Option<usize>> {
        let told = |s: &Series| !(s.name.is_empty() || s.dashed || s.width < TOLD || s.points.is_empty());
        let mut names: Vec<&str> = self.series.iter().filter(|s| told(s)).map(|s| s.name.as_str()).collect();
        let mut seen = std::collections::HashSet::new();
        names.retain(|name| seen.insert(*name));
        let place = |s: &Series| names.iter().position(|name| *name == s.name).filter(|_| told(s) && names.len() > 1);
        self.series.iter().map(place).collect()
    }

    /// Least and largest drawable value of x or y; the empty range is (∞, −∞).
    fn extent(&self, along_x: bool) -> (f64, f64) {
        let edges = self.ribbons.iter().flat_map(|r| &r.points).flat_map(|p| [(p.0, p.1), (p.0, p.2)]);
        let points = self.series.iter().flat_map(|s| s.points.iter().copied()).chain(edges);
        let both = points.filter(|p| drawable(p.0, self.log_x) && drawable(p.1, self.log_y));
        let values = both.map(|p| if along_x { p.0 } else { p.1 });
        let log = if along_x { self.log_x } else { self.log_y };
        let rules = self.rules.iter().filter(|r| r.along_x == along_x).map(|r| r.value);
        let all = values.chain(rules.filter(|v| drawable(*v, log)));
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
    }

    fn x_axis(&self, width: f64) -> Axis {
        let (lo, hi) = self.x_range.unwrap_or_else(|| self.extent(true));
        let markers = self.series.iter().any(|s| s.markers);
        // one place alone stands in the middle of what leads to it
        let (lo, hi) = if lo == hi && lo > 0.0 && !self.log_x { (0.0, 2.0 * hi) } else { (lo, hi) };
        Axis::fit(lo, hi, self.log_x, if markers { 0.03 } else { 0.0 }, ((width / 60.0) as usize).clamp(2, 10))
    }

    pub(super) fn y_axis(&self, height: f64) -> Axis {
        let wanted = ((height / 32.0) as usize).clamp(2, 8);
        if let Some((lo, hi)) = self.y_range {
            return Axis::fit(lo, hi, self.log_y, 0.0, wanted);
        }
        let (lo, hi) = self.extent(false);
        if self.from_zero && !self.log_y && lo >= 0.0 && hi > 0.0 && drawable(hi, false) {
            return Axis::fit(0.0, 1.06 * hi.max(self.least_span), false, 0.0, wanted);
        }
        let short = if self.log_y { 0.0 } else { (0.5 * (self.least_span - (hi - lo))).max(0.0) };
        Axis::fit(lo - short, hi + short, self.log_y, 0.06, wanted)
    }

    /// Decides everything that depends on the room: header, axes, margins.
    pub(super) fn layout(&self, area: Area) -> PanelLayout {
        // title and legend stand over the data, right of the axis
        let header = Header::new(&self.title, self.entries(), area.width() - AXIS_ROOM);
        let below = 14.0 + if self.x_label.is_empty() { 0.0 } else { 14.0 };
        let y_axis = self.y_axis(area.height() - header.height - below);
        let longest = y_axis.ticks.iter().map(|t| font::width(&t.1, size::TICK)).fold(0.0, f64::max);
        let left = longest + 7.0 + if self.y_label.is_empty() { 0.0 } else { 15.0 };
        PanelLayout { area, header, y_axis, left, below }
    }

    /// Paints the chart; `left` is the margin shared with the charts above and below.
    pub(super) fn draw(&self, canvas: &mut Canvas, layout: &PanelLayout, left: f64) {
        let area = layout.area;
        let plot = Area {
            x0: area.x0 + left,
            y0: area.y0 + layout.header.height,
            x1: area.x1 - 4.0,
            y1: area.y1 - layout.below,
        };
        if plot.width() < 20.0 || plot.height() < 20.0 {
            return;
        }
        let (x_axis, y_axis) = (self.x_axis(plot.width()), &layout.y_axis);
        layout.header.draw(canvas, area.x0 + left, plot.x1, area.y0);
        let at = |x: f64, y: f64| (plot.x0 + x * plot.width(), plot.y1 - y * plot.height());
        for band in &self.bands {
            let axis = if band.along_x { &x_axis } else { y_axis };
            let (a, b) = (axis.unit(band.from).clamp(0.0, 1.0), axis.unit(band.to).clamp(0.0, 1.0));
            let (from, to) = if band.along_x { (at(a, 1.0), at(b, 0.0)) } else { (at(0.0, b), at(1.0, a)) };
            if a.is_finite() && b.is_finite() {
                let shade = Area { x0: from.0, y0: from.1, x1: to.0, y1: to.1 };
                canvas.rectangle(shade, band.colour, band.opacity);
            }
        }
        for ribbon in &self.ribbons {
            draw_ribbon(canvas, ribbon, plot, |x, y| at(x_axis.unit(x), y_axis.unit(y)));
        }
        draw_grid(canvas, plot, &x_axis, y_axis);
        for rule in &self.rules {
            let u = if rule.along_x { x_axis.unit(rule.value) } else { y_axis.unit(rule.value) };
            if (0.0..=1.0).contains(&u) {
                let ends = if rule.along_x { [at(u, 0.0), at(u, 1.0)] } else { [at(0.0, u), at(1.0, u)] };
                canvas.dashed(&ends, rule.colour, 1.0, 4.4, 2.8);
            }
        }
        let mut drawn = false;
        let shapes = self.shapes();
        let n = 1 + shapes.iter().flatten().max().copied().unwrap_or(0);
        for (i, series) in self.series.iter().enumerate() {
            let colour = series.colour.unwrap_or(Colour::nth(i));
            let points: Vec<Point> = series.points.iter().map(|p| at(x_axis.unit(p.0), y_axis.unit(p.1))).collect();
            drawn |= points.iter().any(|p| p.0.is_finite() && p.1.is_finite());
            let marks = shapes[i].map(|shape| (shape, (shape as f64 + 0.5) / n as f64));
            draw_series(canvas, (series, marks), &points, colour, plot);
        }
        if !drawn {
            let middle = at(0.5, 0.5);
            canvas.text(middle, "no finite data", size::LABEL, Colour::GREY, Anchor::Middle, false);
        }
        let middle = at(0.5, 0.0);
        canvas.text((middle.0, area.y1 - 4.0), &self.x_label, size::LABEL, Colour::INK, Anchor::Middle, false);
        let side = (area.x0 + 9.0, 0.5 * (plot.y0 + plot.y1));
        canvas.text(side, &self.y_label, size::LABEL, Colour::INK, Anchor::Middle, true);
    }
}

/// Thinner lines than this have no marks, units: they are a crowd or stand behind others.
const TOLD: f64 = 1.0;
/// Between two marks of a line, units.
const APART: f64 = 90.0;

/// Points of a line that bear a mark: the nearest to places that are [`APART`], the first after the share `lead` of that.
fn marked(points: &[Point], lead: f64, plot: Area) -> Vec<Point> {
    let mut places = (0..).map(|k| plot.x0 + APART * (f64::from(k) + lead)).take_while(|x| *x < plot.x1).peekable();
    let mut out = Vec::new();
    for pair in points.windows(2) {
        while let Some(x) = places.next_if(|x| *x <= pair[1].0) {
            let share = (x - pair[0].0) / (pair[1].0 - pair[0].0);
            let y = pair[0].1 + share * (pair[1].1 - pair[0].1);
            out.extend(Some((x, y)).filter(|p| share >= 0.0 && p.1.is_finite() && inside(*p, plot)));
        }
    }
    out
}

/// `marks` are the shape of the line's marks and where the first stands.
fn draw_series(
    canvas: &mut Canvas,
    (series, marks): (&Series, Option<(usize, f64)>),
    points: &[Point],
    colour: Colour,
    plot: Area,
) {
    if let Some((shape, lead)) = marks.filter(|_| !series.markers) {
        marked(points, lead, plot).into_iter().for_each(|p| shape::draw(canvas, shape, p, colour));
    }
    for run in points.split(|p| !(p.0.is_finite() && p.1.is_finite())) {
        let thin = decimate(run);
        if series.width > 0.0 {
            for piece in clip(&thin, plot) {
                if series.dashed {
                    canvas.dashed(&piece, colour, series.width, 5.0, 3.0);
                } else {
                    canvas.line(&piece, colour, series.width);
                }
            }
        }
        // A single sample has no line: without a dot it would vanish.
        if series.markers || run.len() == 1 {
            for p in thin.iter().filter(|p| inside(**p, plot)) {
                match marks {
                    Some((shape, _)) => shape::draw(canvas, shape, *p, colour),
                    None => canvas.disc(*p, series.width.max(1.0) * 1.9, colour),
                }
            }
        }
    }
}

/// One polygon per run of drawable points, cut to the height of the chart.
fn draw_ribbon(canvas: &mut Canvas, ribbon: &Ribbon, plot: Area, place: impl Fn(f64, f64) -> Point) {
    let edges: Vec<(Point, Point)> = ribbon.points.iter().map(|p| (place(p.0, p.1), place(p.0, p.2))).collect();
    let finite = |p: Point| p.0.is_finite() && p.1.is_finite() && (plot.x0 - 0.01..=plot.x1 + 0.01).contains(&p.0);
    let cut = |p: &Point| (p.0, p.1.clamp(plot.y0, plot.y1));
    for run in edges.split(|(low, high)| !(finite(*low) && finite(*high))) {
        let edge =
            |of: fn(&(Point, Point)) -> &Point| decimate(&run.iter().map(|e| cut(of(e))).collect::<Vec<Point>>());
        let (lower, upper) = (edge(|e| &e.0), edge(|e| &e.1));
        canvas.polygon(lower.into_iter().chain(upper.into_iter().rev()).collect(), ribbon.colour.tint());
    }
}

fn inside(p: Point, area: Area) -> bool {
    (area.x0 - 0.01..=area.x1 + 0.01).contains(&p.0) && (area.y0 - 0.01..=area.y1 + 0.01).contains(&p.1)
}

fn draw_grid(canvas: &mut Canvas, plot: Area, x_axis: &Axis, y_axis: &Axis) {
    let inner = |u: f64| (-1e-9..=1.0 + 1e-9).contains(&u);
    let mut occupied = f64::NEG_INFINITY;
    for (u, label) in x_axis.ticks.iter().filter(|t| inner(t.0)) {
        let x = plot.x0 + u * plot.width();
        canvas.line(&[(x, plot.y0), (x, plot.y1)], Colour::GRID, 0.7);
        let half = 0.5 * font::width(label, size::TICK);
        if x - half > occupied {
            canvas.text((x, plot.y1 + 11.5), label, size::TICK, Colour::GREY, Anchor::Middle, false);
            occupied = x + half + 4.0;
        }
    }
    for (u, label) in y_axis.ticks.iter().filter(|t| inner(t.0)) {
        let y = plot.y1 - u * plot.height();
        canvas.line(&[(plot.x0, y), (plot.x1, y)], Colour::GRID, 0.7);
        let at = (plot.x0 - 5.0, y + 0.36 * size::TICK);
        canvas.text(at, label, size::TICK, Colour::GREY, Anchor::End, false);
    }
    canvas.line(&[(plot.x0, plot.y0), (plot.x0, plot.y1), (plot.x1, plot.y1)], Colour::FRAME, 0.9);
    let beside = (plot.x0 + 4.0, plot.y0 + 8.0);
    canvas.text(beside, &y_axis.multiplier, size::TICK, Colour::GREY, Anchor::Start, false);
    let under = (plot.x1, plot.y1 + 23.5);
    canvas.text(under, &x_axis.multiplier, size::TICK, Colour::GREY, Anchor::End, false);
}

/// Room that labels and ticks of a y axis take, at most in most charts, figure units.
const AXIS_ROOM: f64 = 56.0;

/// What [`Panel::layout`] decided.
#[derive(Debug, Clone)]
pub(super) struct PanelLayout {
    area: Area,
    header: Header,
    y_axis: Axis,
    /// Room for y label and tick labels.
    pub left: f64,
    below: f64,
}

/// Fewer points for the same picture. Where x never falls, every column of half a unit keeps its first, lowest,
/// highest and last point, so no extreme is lost; elsewhere points closer than a fifth of a unit to the last kept one
/// are dropped.
pub(super) fn decimate(points: &[Point]) -> Vec<Point> {
    if points.len() < 600 {
        return points.to_vec();
    }
    if points.windows(2).any(|w| w[1].0 < w[0].0) {
        return thin_by_distance(points);
    }
    let column = |p: &Point| (p.0 * 2.0).floor();
    let mut out: Vec<Point> = Vec::new();
    for group in points.chunk_by(|a, b| column(a) == column(b)) {
        let lowest = (0..group.len()).min_by(|a, b| group[*a].1.total_cmp(&group[*b].1)).unwrap_or(0);
        let highest = (0..group.len()).max_by(|a, b| group[*a].1.total_cmp(&group[*b].1)).unwrap_or(0);
        let mut keep = [0, lowest, highest, group.len() - 1];
        keep.sort_unstable();
        let mut last = usize::MAX;
        for i in keep {
            if i != last {
                out.push(group[i]);
                last = i;
            }
        }
    }
    out
}

fn thin_by_distance(points: &[Point]) -> Vec<Point> {
    let mut out: Vec<Point> = Vec::new();
    for (i, p) in points.iter().enumerate() {
        let far = out.last().is_none_or(|q| (p.0 - q.0).hypot(p.1 - q.1) > 0.2);
        if far || i + 1 == points.len() {
            out.push(*p);
        }
    }
    out
}

/// The parts of a polyline inside `area` (Liang–Barsky per segment).
fn clip(points: &[Point], area: Area) -> Vec<Vec<Point>> {
    if points.iter().all(|p| inside(*p, area)) {
        return vec![points.to_vec()];
    }
    let mut out: Vec<Vec<Point>> = Vec::new();
    let mut joined = false;
    for pair in points.windows(2) {
        match clip_segment(pair[0], pair[1], area) {
            Some((a, b)) => {
                if !joined {
                    out.push(vec![a]);
                }
                if let Some(run) = out.last_mut() {
                    run.push(b);
                }
                joined = b == pair[1];
            }
            None => joined = false,
        }
    }
    out
}

fn clip_segment(a: Point, b: Point, area: Area) -> Option<(Point, Point)> {
    let d = (b.0 - a.0, b.1 - a.1);
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    let sides = [(-d.0, a.0 - area.x0), (d.0, area.x1 - a.0), (-d.1, a.1 - area.y0), (d.1, area.y1 - a.1)];
    for (p, q) in sides {
        if p == 0.0 && q < 0.0 {
            return None;
        }
        if p < 0.0 {
            enter = enter.max(q / p);
        } else if p > 0.0 {
            leave = leave.min(q / p);
        }
    }
    let at = |t: f64| (a.0 + t * d.0, a.1 + t * d.1);
    let start = if enter == 0.0 { a } else { at(enter) };
    let end = if leave == 1.0 { b } else { at(leave) };
    (enter <= leave).then_some((start, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimation_keeps_the_first_last_lowest_and_highest_point() {
        let mut points: Vec<Point> = (0..50_000).map(|i| (i as f64 * 0.01, (i as f64 * 0.3).sin())).collect();
        points[31_007].1 = 9.0;
        points[31_008].1 = -7.0;
        let thin = decimate(&points);
        assert!(thin.len() <= 4 * 1001, "{}", thin.len());
        assert_eq!((thin[0], thin[thin.len() - 1]), (points[0], points[49_999]));
        assert!(thin.contains(&points[31_007]) && thin.contains(&points[31_008]));
    }

    #[test]
    fn clipped_lines_stay_inside_and_touch_the_border() {
        let area = Area { x0: 0.0, y0: 0.0, x1: 10.0, y1: 10.0 };
        let pieces = clip(&[(-5.0, 5.0), (5.0, 5.0), (5.0, 50.0), (20.0, 50.0), (8.0, 2.0)], area);
        assert_eq!(pieces[0], vec![(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)]);
        assert!(pieces.iter().flatten().all(|p| inside(*p, area)), "{pieces:?}");
    }

    #[test]
    fn one_place_alone_stands_on_an_axis_from_zero() {
        for x in [1.0, 60.0, 4e5] {
            let axis = Panel::new("", "", "").series(Series::line("", vec![(x, 0.4)]).markers()).x_axis(400.0);
            assert!(axis.unit(0.0) >= 0.0 && axis.unit(0.0) < 0.05 && (axis.unit(x) - 0.5).abs() < 0.01, "{x}");
        }
        let axis = Panel::new("", "", "").series(Series::line("", vec![(54.0, 1.0), (66.0, 2.0)])).x_axis(400.0);
        assert!(axis.unit(54.0).abs() < 1e-9, "a range keeps its ends");
    }
}
