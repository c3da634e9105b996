//! Linear systems with named signals, and their connections.

use super::dense::{Complexes, ON_CIRCLE, ROUNDED};
use base::error::{Error, Result};
use base::names;
use nalgebra::{Complex, DMatrix};
use serde::{Deserialize, Serialize};

/// A number that a system holds, takes or gives.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signal {
    /// As `position.x`.
    pub name: String,
    /// As `m/s`; empty where there is none.
    pub unit: String,
}

impl Signal {
    /// A signal of that name and unit.
    pub fn new(name: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { name: name.into(), unit: unit.into() }
    }

    /// `x0`, `x1`, … without units.
    pub fn numbered(letter: &str, n: usize) -> Vec<Self> {
        (0..n).map(|i| Self::new(format!("{letter}{i}"), "")).collect()
    }
}

/// ẋ = A x + B u, y = C x + D u; or, with a sample time, x⁺ = A x + B u of every sample.
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    d: DMatrix<f64>,
    dt: Option<f64>,
    states: Vec<Signal>,
    inputs: Vec<Signal>,
    outputs: Vec<Signal>,
}

impl StateSpace {
    /// A system, continuous without `dt` (s). Signals are numbered until they are [named](Self::named).
    ///
    /// # Errors
    /// [`Error::Value`] where sizes do not fit (A n × n, B n × m, C p × n, D p × m; n may be 0, m and p not), a number is not
    /// finite or `dt` not positive.
    pub fn new(a: DMatrix<f64>, b: DMatrix<f64>, c: DMatrix<f64>, d: DMatrix<f64>, dt: Option<f64>) -> Result<Self> {
        let (n, m, p) = (a.nrows(), d.ncols(), d.nrows());
        if m == 0 || p == 0 {
            return Err(Error::value("size of D", format!("{p} × {m}"), "≥ 1 × 1", "Give inputs and outputs."));
        }
        for (name, matrix, size) in [("A", &a, (n, n)), ("B", &b, (n, m)), ("C", &c, (p, n))] {
            if matrix.shape() != size {
                let got = format!("{} × {}", matrix.nrows(), matrix.ncols());
                let remedy = "A is n × n, B n × m, C p × n and D p × m.";
                return Err(Error::value(format!("size of {name}"), got, format!("{} × {}", size.0, size.1), remedy));
            }
        }
        for (name, matrix) in [("A", &a), ("B", &b), ("C", &c), ("D", &d)] {
            if let Some(at) = matrix.iter().position(|v| !v.is_finite()) {
                let what = format!("{name}[{}, {}]", at % matrix.nrows(), at / matrix.nrows());
                return Err(Error::value(what, matrix[at], "a finite number", "Correct it at its source."));
            }
        }
        if let Some(dt) = dt.filter(|dt| !(*dt > 0.0 && dt.is_finite())) {
            return Err(Error::value("dt", dt, "> 0 s", "Give no dt for a continuous system."));
        }
        let [states, inputs, outputs] = [("x", n), ("u", m), ("y", p)].map(|(letter, n)| Signal::numbered(letter, n));
        Ok(Self { a, b, c, d, dt, states, inputs, outputs })
    }

    /// A system without memory, y = D u, D p × m.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn gain(d: DMatrix<f64>, dt: Option<f64>) -> Result<Self> {
        let (p, m) = d.shape();
        Self::new(DMatrix::zeros(0, 0), DMatrix::zeros(0, m), DMatrix::zeros(p, 0), d, dt)
    }

    /// `samples` sample times of delay on each of `n` signals: z⁻ᵏ I.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn delay(n: usize, samples: usize, dt: f64) -> Result<Self> {
        let size = n * samples;
        let eye = |r: usize, c: usize, low: usize| DMatrix::from_fn(r, c, |i, j| f64::from(u8::from(i == j + low)));
        if samples == 0 {
            return Self::gain(eye(n, n, 0), Some(dt));
        }
        let c = DMatrix::from_fn(n, size, |i, j| f64::from(u8::from(j == i + size - n)));
        Self::new(eye(size, size, n), eye(size, n, 0), c, DMatrix::zeros(n, n), Some(dt))
    }

    /// The same with these signals.
    ///
    /// # Errors
    /// [`Error::Value`] if one list is not as long as what it names.
    pub fn named(mut self, states: Vec<Signal>, inputs: Vec<Signal>, outputs: Vec<Signal>) -> Result<Self> {
        let of = [
            ("states", &states, self.n_state()),
            ("inputs", &inputs, self.n_input()),
            ("outputs", &outputs, self.n_output()),
        ];
        if let Some((what, list, n)) = of.into_iter().find(|(_, list, n)| list.len() != *n) {
            return Err(Error::value(format!("names of {what}"), list.len(), n.to_string(), "Name each of them once."));
        }
        (self.states, self.inputs, self.outputs) = (states, inputs, outputs);
        Ok(self)
    }

    /// A, n × n.
    pub fn a(&self) -> &DMatrix<f64> {
        &self.a
    }

    /// B, n × m.
    pub fn b(&self) -> &DMatrix<f64> {
        &self.b
    }

    /// C, p × n.
    pub fn c(&self) -> &DMatrix<f64> {
        &self.c
    }

    /// D, p × m.
    pub fn d(&self) -> &DMatrix<f64> {
        &self.d
    }

    /// The sample time, s; none for a continuous system.
    pub fn dt(&self) -> Option<f64> {
        self.dt
    }

    /// The states' names.
    pub fn states(&self) -> &[Signal] {
        &self.states
    }

    /// The inputs' names.
    pub fn inputs(&self) -> &[Signal] {
        &self.inputs
    }

    /// The outputs' names.
    pub fn outputs(&self) -> &[Signal] {
        &self.outputs
    }

    /// Numbers of the state.
    pub fn n_state(&self) -> usize {
        self.a.nrows()
    }

    /// Inputs.
    pub fn n_input(&self) -> usize {
        self.d.ncols()
    }

    /// Outputs.
    pub fn n_output(&self) -> usize {
        self.d.nrows()
    }

    /// The inputs and outputs of these names alone, in their order.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a name that the system does not have.
    pub fn select(&self, inputs: &[&str], outputs: &[&str]) -> Result<Self> {
        let places = |kind: &'static str, all: &[Signal], names: &[&str]| -> Result<Vec<usize>> {
            let known = || all.iter().map(|s| s.name.clone()).collect();
            let place = |name: &&str| {
                let at = all.iter().position(|s| s.name == *name);
                at.ok_or_else(|| Error::Unknown { kind, name: (*name).into(), known: known() })
            };
            names.iter().map(place).collect()
        };
        let (ins, outs) = (places("input", &self.inputs, inputs)?, places("output", &self.outputs, outputs)?);
        Self::new(
            self.a.clone(),
            self.b.select_columns(&ins),
            self.c.select_rows(&outs),
            self.d.select_columns(&ins).select_rows(&outs),
            self.dt,
        )?
        .named(
            self.states.clone(),
            ins.iter().map(|i| self.inputs[*i].clone()).collect(),
            outs.iter().map(|i| self.outputs[*i].clone()).collect(),
        )
    }

    /// What `next` makes of this system's outputs: `next` · self.
    ///
    /// # Errors
    /// [`Error::Value`] where numbers of signals or sample times differ.
    pub fn series(&self, next: &Self) -> Result<Self> {
        self.sampled_alike(next)?;
        fits("inputs of the second system", next.n_input(), self.n_output())?;
        let a = blocks(&self.a, &DMatrix::zeros(self.n_state(), next.n_state()), &(&next.b * &self.c), &next.a);
        let b = stacked(&self.b, &(&next.b * &self.d));
        let c = beside(&(&next.d * &self.c), &next.c);
        Self::new(a, b, c, &next.d * &self.d, self.dt)?.named(
            joined(&self.states, &next.states),
            self.inputs.clone(),
            next.outputs.clone(),
        )
    }

    /// The sum of both outputs under the same inputs.
    ///
    /// # Errors
    /// As [`series`](Self::series).
    pub fn parallel(&self, other: &Self) -> Result<Self> {
        self.sampled_alike(other)?;
        fits("inputs of the second system", other.n_input(), self.n_input())?;
        fits("outputs of the second system", other.n_output(), self.n_output())?;
        let zeros = |r: &Self, c: &Self| DMatrix::zeros(r.n_state(), c.n_state());
        let a = blocks(&self.a, &zeros(self, other), &zeros(other, self), &other.a);
        let (b, c) = (stacked(&self.b, &other.b), beside(&self.c, &other.c));
        Self::new(a, b, c, &self.d + &other.d, self.dt)?.named(
            joined(&self.states, &other.states),
            self.inputs.clone(),
            self.outputs.clone(),
        )
    }

    /// Both systems with inputs and outputs of their own.
    ///
    /// # Errors
    /// As [`series`](Self::series).
    pub fn append(&self, other: &Self) -> Result<Self> {
        self.sampled_alike(other)?;
        let diagonal = |x: &DMatrix<f64>, y: &DMatrix<f64>| {
            blocks(x, &DMatrix::zeros(x.nrows(), y.ncols()), &DMatrix::zeros(y.nrows(), x.ncols()), y)
        };
        let system = Self::new(
            diagonal(&self.a, &other.a),
            diagonal(&self.b, &other.b),
            diagonal(&self.c, &other.c),
            diagonal(&self.d, &other.d),
            self.dt,
        )?;
        system.named(
            joined(&self.states, &other.states),
            joined(&self.inputs, &other.inputs),
            joined(&self.outputs, &other.outputs),
        )
    }

    /// y = self (r − back y): negative feedback; positive with −back.
    ///
    /// # Errors
    /// As [`series`](Self::series), and where I + D₂ D₁ cannot be inverted: both act at once and on each other.
    pub fn feedback(&self, back: &Self) -> Result<Self> {
        self.sampled_alike(back)?;
        fits("inputs of the feedback", back.n_input(), self.n_output())?;
        fits("outputs of the feedback", back.n_output(), self.n_input())?;
        let direct = DMatrix::identity(self.n_input(), self.n_input()) + &back.d * &self.d;
        let Some(e) = direct.try_inverse().filter(|e| e.iter().all(|v| v.is_finite())) else {
            let remedy = "Let one of them act a sample later, or without a direct path.";
            return Err(Error::value("I + D₂ D₁ of the loop", "singular", "invertible", remedy));
        };
        // u₁ = e (r − C₂ x₂ − D₂ C₁ x₁), y = C₁ x₁ + D₁ u₁
        let from_self = -(&e * &back.d * &self.c);
        let from_back = -(&e * &back.c);
        let (y_self, y_back, y_in) = (&self.c + &self.d * &from_self, &self.d * &from_back, &self.d * &e);
        let a = blocks(
            &(&self.a + &self.b * &from_self),
            &(&self.b * &from_back),
            &(&back.b * &y_self),
            &(&back.a + &back.b * &y_back),
        );
        let b = stacked(&(&self.b * &e), &(&back.b * &y_in));
        Self::new(a, b, beside(&y_self, &y_back), y_in, self.dt)?.named(
            joined(&self.states, &back.states),
            self.inputs.clone(),
            self.outputs.clone(),
        )
    }

    /// The system times a number.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { c: &self.c * factor, d: &self.d * factor, ..self.clone() }
    }

    /// C (s I − A)⁻¹ B + D, p × m, at a complex s, or z for a sampled system; NaN at a pole.
    pub fn at(&self, s: Complex<f64>) -> Complexes {
        if self.n_state() == 0 {
            return self.d.map(|v| Complex::new(v, 0.0));
        }
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex::new(v, 0.0));
        let mut pencil = -complex(&self.a);
        for i in 0..self.n_state() {
            pencil[(i, i)] += s;
        }
        match pencil.lu().solve(&complex(&self.b)) {
            Some(through) => complex(&self.c) * through + complex(&self.d),
            None => complex(&self.d).map(|_| Complex::new(f64::NAN, f64::NAN)),
        }
    }

    /// s = jω, or z = exp(jω dt), where the response to ω (rad/s) is read.
    pub fn on_axis(&self, omega: f64) -> Complex<f64> {
        match self.dt {
            None => Complex::new(0.0, omega),
            Some(dt) => Complex::from_polar(1.0, omega * dt),
        }
    }

    /// What constant inputs lead to, p × m: the response at s = 0 or z = 1.
    pub fn dc_gain(&self) -> DMatrix<f64> {
        self.at(self.on_axis(0.0)).map(|v| v.re)
    }

    /// Whether all poles lie within the left half plane, or the unit circle, by more than rounding and
    /// [`ON_CIRCLE`] of it.
    ///
    /// # Errors
    /// [`Error::Value`] where eigenvalues are not found.
    pub fn is_stable(&self) -> Result<bool> {
        let poles = super::dense::eigenvalues(&self.a)?;
        let near = poles.first().map_or(0.0, |p| p.norm()) * ROUNDED;
        Ok(poles.iter().all(|p| if self.dt.is_some() { p.norm() < 1.0 - ON_CIRCLE } else { p.re < -near }))
    }

    /// Matrices, names, units and sample time as JSON; rows of numbers.
    pub fn to_json(&self) -> serde_json::Value {
        let rows = |m: &DMatrix<f64>| m.row_iter().map(|r| r.iter().copied().collect::<Vec<_>>()).collect::<Vec<_>>();
        serde_json::json!({
            "A": rows(&self.a), "B": rows(&self.b), "C": rows(&self.c), "D": rows(&self.d), "dt": self.dt,
            "states": self.states, "inputs": self.inputs, "outputs": self.outputs,
        })
    }

    /// One table `[A B; C D]` with names: columns are states and inputs, rows derivatives (or next states) and outputs.
    pub fn to_csv(&self) -> String {
        let head: Vec<String> = self.states.iter().chain(&self.inputs).map(heading).collect();
        let mut text = format!("row,{}\n", head.join(","));
        let whole = blocks(&self.a, &self.b, &self.c, &self.d);
        for (signal, row) in self.states.iter().chain(&self.outputs).zip(whole.row_iter()) {
            let numbers: Vec<String> = row.iter().map(|v| format!("{v:e}")).collect();
            text += &format!("{},{}\n", heading(signal), numbers.join(","));
        }
        text
    }

    pub(super) fn sampled_alike(&self, other: &Self) -> Result<()> {
        let told = |dt: Option<f64>| dt.map_or("continuous".into(), |dt| format!("{dt} s"));
        if self.dt == other.dt {
            return Ok(());
        }
        let remedy = "Sample one of them first.";
        Err(Error::value("sample time of the second system", told(other.dt), told(self.dt), remedy))
    }

    /// The same signals around other matrices of the same sizes, with numbered states where there are more or fewer.
    pub(super) fn with(
        &self,
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
        dt: Option<f64>,
    ) -> Result<Self> {
        let states = if a.nrows() == self.n_state() { self.states.clone() } else { Signal::numbered("x", a.nrows()) };
        Self::new(a, b, c, d, dt)?.named(states, self.inputs.clone(), self.outputs.clone())
    }
}

fn heading(signal: &Signal) -> String {
    let text = if signal.unit.is_empty() { signal.name.clone() } else { format!("{} ({})", signal.name, signal.unit) };
    names::quoted_cell(&text)
}

fn fits(what: &str, got: usize, want: usize) -> Result<()> {
    if got == want {
        Ok(())
    } else {
        Err(Error::value(what, got, want.to_string(), "Select the signals that belong together."))
    }
}

fn joined(first: &[Signal], second: &[Signal]) -> Vec<Signal> {
    first.iter().chain(second).cloned().collect()
}

pub(crate) fn blocks(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
    stacked(&beside(a, b), &beside(c, d))
}

pub(crate) fn stacked(above: &DMatrix<f64>, below: &DMatrix<f64>) -> DMatrix<f64> {
    let n = above.nrows();
    DMatrix::from_fn(n + below.nrows(), above.ncols(), |i, j| if i < n { above[(i, j)] } else { below[(i - n, j)] })
}

pub(super) fn one_loop(system: &StateSpace) -> Result<()> {
    if (system.n_input(), system.n_output()) == (1, 1) {
        return Ok(());
    }
    let got = format!("{} inputs, {} outputs", system.n_input(), system.n_output());
    Err(Error::value("the loop", got, "one input and one output", "Select one channel, or ask for a disk margin."))
}

pub(crate) fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let n = left.ncols();
    DMatrix::from_fn(left.nrows(), n + right.ncols(), |i, j| if j < n { left[(i, j)] } else { right[(i, j - n)] })
}
