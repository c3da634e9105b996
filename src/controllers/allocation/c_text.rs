//! An allocation as C text: the closed form, the active set and its certificate, of one problem, for any wrench.
//!
//! The parts are those that answer [side by side](super::side_by_side), with the numbers of the problem as constants: most of a
//! geometry's zeros vanish. The search has as many steps at most as anywhere, and works in an array of its own.

use super::AllocatorSettings;
use super::active_set::Tolerances;
use super::batch::LANE_TOLERANCE;
use super::fast::{Fast, MAX_STEPS};
use super::problem::Problem;
use super::side_by_side::{Numbers, Places, begin, end, numbers, step};
use autodiff::emit::{
    Access, CFunction, CText, ExportPrecision, Linkage, NamedArray, NamedFunction, NamedNumber, literal,
};
use autodiff::{Recording, Scalar, Trace};
use base::error::{Error, Result};

/// The text of `problem`, of the numbers of a wrench that are not known; `None` for cones, or too many inputs.
///
/// In `float`, where bounds act and the free inputs still make the wrench in many ways, rounding decides which of them is taken: the
/// wrench is right, the inputs need not be those that are preferred.
///
/// # Errors
/// As [`Problem::validate`].
pub(super) fn allocation_text(
    text: &mut CText,
    name: &str,
    problem: Problem,
    wrench: &[Option<f64>],
) -> Result<Option<CFunction>> {
    problem.validate()?;
    let settings = AllocatorSettings::default();
    let Some(fast) = Fast::of(&problem, settings) else { return Ok(None) };
    let (tolerances, tolerance) = match text.precision() {
        ExportPrecision::Double => (Tolerances::DOUBLE, settings.tolerance),
        ExportPrecision::Single => (Tolerances::SINGLE, LANE_TOLERANCE),
    };
    let all: Vec<f64> = numbers(&problem, &fast, tolerance).collect();
    let own = Parts { n: problem.n_input(), all, wrench: wrench.to_vec(), name: own_name(text, name)? };
    let parts = own.add(text, tolerances)?;
    Ok(Some(own.add_search(text, name, &problem, &parts)))
}

/// What the names of its parts begin with, behind the prefix of the text.
fn own_name(text: &CText, name: &str) -> Result<String> {
    let own = name.strip_prefix(text.prefix()).and_then(|name| name.strip_prefix('_'));
    own.map(str::to_string).ok_or_else(|| {
        Error::value(
            "name of a custom function",
            name,
            format!("one that begins with {}_", text.prefix()),
            "Name it so.",
        )
    })
}

/// Bytes of the frame of the search, beside its numbers.
const FRAME: usize = 160;

struct Parts {
    n: usize,
    /// Of the problem, in the order of [`Numbers`].
    all: Vec<f64>,
    wrench: Vec<Option<f64>>,
    name: String,
}

impl Parts {
    fn part(
        &self,
        name: &str,
        arrays: Vec<NamedArray>,
        part: impl FnOnce(&Numbers<Trace>, &[Trace]) -> Vec<Trace>,
    ) -> NamedFunction {
        let n_read = |array: &NamedArray| if array.access == Access::Write { 0 } else { array.numbers.len() };
        let recording = Recording::of(arrays.iter().map(n_read).sum(), |z| {
            let constants: Vec<Trace> = self.all.iter().map(|x| Trace::constant(*x)).collect();
            part(&Numbers::of(self.n, &constants), z)
        });
        NamedFunction { name: format!("{}_{name}", self.name), about: String::new(), arrays, recording }
    }

    /// The wrench, of which some numbers are read.
    fn wrench(&self, open: &[Trace]) -> Vec<Trace> {
        let mut open = open.iter();
        let own = |known: &Option<f64>| known.map(Trace::constant).or_else(|| open.next().copied());
        self.wrench.iter().map(own).map(|w| w.unwrap_or(Trace::zero())).collect()
    }

    fn n_open(&self) -> usize {
        self.wrench.iter().filter(|known| known.is_none()).count()
    }

    /// Begin, both kinds of steps, end.
    fn add(&self, text: &mut CText, tolerances: Tolerances) -> Result<Vec<CFunction>> {
        let (n, at) = (self.n, Places::of(self.n));
        let wrench = || array("wrench", Access::Read, self.n_open());
        let state = |access| array("state", access, at.answer.end);
        let mut parts =
            vec![self.part("begin", vec![wrench(), state(Access::Write)], |of, z| begin(n, of, &self.wrench(z)))];
        for (name, many) in [("many", true), ("one", false)] {
            let arrays =
                vec![array("iterate", Access::Update, at.iterate.len()), array("task", Access::Read, at.task.len())];
            parts.push(self.part(name, arrays, |of, z| step(n, of, z, many, tolerances)));
        }
        parts.push(self.part(
            "end",
            vec![wrench(), state(Access::Read), array("inputs", Access::Write, n)],
            |of, z| {
                let (open, state) = z.split_at(self.n_open());
                end(n, of, &self.wrench(open), state, tolerances)[n..2 * n].to_vec()
            },
        ));
        parts.iter().map(|part| text.function(part, Linkage::Static)).collect()
    }

    fn add_search(&self, text: &mut CText, name: &str, problem: &Problem, parts: &[CFunction]) -> CFunction {
        let (n, at, real) = (self.n, Places::of(self.n), text.precision().c_type());
        let prototype = format!("{}void {name}(const {real} *x, {real} *y)", text.dialect().own());
        let number = |x: f64| literal(x, text.precision());
        let (done, answer) = (at.iterate.end - 1, at.answer.start);
        let preference: Vec<String> = problem.preference.iter().map(|x| number(*x)).collect();
        let body = format!(
            "{prototype}
{{
    static const {real} preference[{n}] = {{{preference}}};
    {real} state[{all}];
    int k;
{unread}    {name}_begin({x}state);
    if (!({half} < state[{done}])) {{
        for (k = 0; k < {MAX_STEPS} && !({half} < state[{done}]); k++) {{
            if (k < {many}) {{
                {name}_many(state, state + {task});
            }} else {{
                {name}_one(state, state + {task});
            }}
        }}
        {name}_end({x}state, state + {answer});
    }}
    for (k = 0; k < {n}; k++) {{
        /* of a wrench that is not finite: what is preferred */
        y[k] = state[{answer} + k] - state[{answer} + k] == {zero} ? state[{answer} + k] : preference[k];
    }}
}}
",
            preference = preference.join(", "),
            all = at.answer.end,
            unread = if self.n_open() == 0 { "    (void)x;\n" } else { "" },
            x = if self.n_open() == 0 { "" } else { "x, " },
            half = number(0.5),
            zero = number(0.0),
            many = MAX_STEPS / 4,
            task = at.task.start,
        );
        text.add(&body);
        let below = parts.iter().map(|part| part.stack).max().unwrap_or(0);
        let once: usize = parts.iter().map(|part| part.n_instruction).sum();
        let longest = parts.iter().map(|part| part.n_instruction).max().unwrap_or(0);
        CFunction {
            name: name.into(),
            prototype,
            stack: at.answer.end * text.precision().bytes() + below + FRAME,
            n_instruction: once,
            n_most: once + longest * MAX_STEPS as usize,
        }
    }
}

fn array(name: &str, access: Access, n: usize) -> NamedArray {
    let number = |k| NamedNumber { name: format!("{name}_{k}"), unit: "-".into() };
    NamedArray { name: name.into(), about: String::new(), access, numbers: (0..n).map(number).collect() }
}
