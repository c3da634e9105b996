//! Draws of a start or an event as text: those of [`BlockDraws`](crate::env::draws), one environment after the other.

use crate::env::draw_plan::Plan;
use crate::start::{Draw, Drawing, LEFT_OUT};
use std::fmt::Write;

/// An expression of `uint64_t`.
pub(super) fn whole(x: u64) -> String {
    format!("(uint64_t){x:#x}u")
}

/// How the streams of a plan are named, `w[0]` on, by their places among those drawn from.
fn stream(place: usize) -> String {
    format!("&w[{place}]")
}

impl Draw {
    /// In `double`.
    fn expression(self, w: &str) -> String {
        match self {
            Self::Unit => format!("od_unit({w})"),
            Self::Normal => format!("od_normal({w})"),
            Self::NormalWithin(bound) => format!("od_normal_within({w}, {})", number(bound)),
            Self::Below(n) => format!("(double)od_below({w}, {})", whole(n)),
            Self::Geometric(mean) => {
                let scale = (1.0 - 1.0 / mean.max(1.0)).ln();
                format!("1.0 + floor(od_ln(1.0 - od_unit({w})) / {})", number(scale))
            }
        }
    }
}

/// A `double` that may be infinite.
pub(super) fn number(x: f64) -> String {
    if x.is_infinite() { format!("{}(double)INFINITY", if x < 0.0 { "-" } else { "" }) } else { format!("({x:?})") }
}

impl Drawing {
    /// In `float`, as [`Drawing::rounded`].
    fn rounded_expression(self, w: &str) -> String {
        let drawn = self.draw.expression(w);
        let drawn = match self.chance {
            Some(chance) => format!("(od_unit({w}) >= {chance:?} ? {LEFT_OUT:?} : {drawn})"),
            None => drawn,
        };
        if self.draw == Draw::Unit { format!("od_unit_float({drawn})") } else { format!("(float)({drawn})") }
    }
}

/// Statements that open the streams of a plan, draw, and run a program until what was drawn is accepted. `key` tells a stream's episode and
/// purpose, `row` the place of a draw, `which` that of whether it is the last time, `accepted` whether to end.
pub(super) fn drawn(
    plan: &Plan,
    key: impl Fn(usize) -> [String; 2],
    position: &str,
    row: impl Fn(usize) -> String,
    run: &str,
    [which, accepted]: [&str; 2],
) -> String {
    let mut text = String::new();
    let (streams, again, n) = (plan.streams(), plan.again(), plan.draws.len());
    if !streams.is_empty() {
        let _ = writeln!(text, "    od_words w[{}];", streams.len());
    }
    for (place, own) in streams.iter().enumerate() {
        let [episode, purpose] = key(*own);
        let w = stream(place);
        let _ = writeln!(text, "    od_open({w}, seed, environment, {episode}, {purpose}, {position});");
    }
    let draw = |k: usize| {
        let (place, drawing) = plan.draws[k];
        format!("    {} = {};\n", row(k), drawing.rounded_expression(&stream(place)))
    };
    (0..again.start).for_each(|k| text += &draw(k));
    let _ = writeln!(text, "    for (int time = 1; time <= {}; time++) {{", plan.most);
    again.clone().for_each(|k| text += &draw(k));
    // what is drawn again goes on where it ended, whatever was drawn behind
    let goes_back = again.end < n && plan.most > 1;
    if goes_back {
        let _ = writeln!(text, "    uint64_t ends[{}];", streams.len());
        (0..streams.len()).for_each(|k| text += &format!("    ends[{k}] = w[{k}].position;\n"));
    }
    (again.end..n).for_each(|k| text += &draw(k));
    if goes_back {
        (0..streams.len()).for_each(|k| text += &format!("    w[{k}].position = ends[{k}];\n"));
    }
    let _ = writeln!(text, "    {which} = time == {} ? 2.0f : 1.0f;", plan.most);
    let _ = writeln!(text, "    {run}(e, i);");
    let _ = writeln!(text, "    if ({accepted} > 0.5f) break;\n    }}");
    text
}

/// Draws again what is too far from zero.
pub(super) const NORMAL_WITHIN: &str = "\
od_own double od_normal_within(od_words *own, double bound)
{
    double z = od_normal(own);
    for (int time = 1; time < 1000 && !(fabs(z) <= bound); time++) z = od_normal(own);
    return z > bound ? bound : z < -bound ? -bound : z;
}
";
