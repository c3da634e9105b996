//! A system and a cost, recorded: what a stage does, what it costs, and how both change with state and input.
//!
//! States change by errors δ ([`ErrorState`]): x ⊕ δ, of a quaternion q ⊗ [1 − ⅛|δ|², ½δ], which is exp(½δ) to second order. Derivatives
//! by δ are taken of the recording at x ⊕ δ, then δ is set to 0, and what folds to a constant is gone: of a quadrotor's 336
//! derivatives of a step a third is left. Eight stages are computed side by side.

use super::cost::{OptimalCost, StageInput, Terms};
use crate::design::ErrorState;
use autodiff::columns::LINE;
use autodiff::native::{Executable, RowLayout, Rows, Work};
use autodiff::trace::on_constants;
use autodiff::{Program, Recording, Scalar, System, Trace, Workspace};
use base::error::{Error, Result};

/// Lengths of what a stage reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lengths {
    pub n_state: usize,
    /// n.
    pub n_error: usize,
    pub n_input: usize,
    /// θ, then what the cost reads.
    pub n_parameter: usize,
    /// Conditions of a stage, and of the end.
    pub n_condition: [usize; 2],
    /// Of those, how many are of the kind g ≤ 0: they come first.
    pub n_at_most: [usize; 2],
}

impl Lengths {
    /// Of the arguments of a program: x, u, p, then shifts and weights of conditions.
    pub(super) fn n_argument(&self, is_end: bool) -> usize {
        let input = if is_end { 0 } else { self.n_input };
        self.n_state + input + self.n_parameter + 2 * self.n_condition[usize::from(is_end)]
    }
}

/// Which entry of a block each result of an expansion is; what is not here is zero.
#[derive(Debug, Clone, Default)]
pub(super) struct Entries {
    /// (row, column) of [A B], columns of x first.
    pub dynamics: Vec<(u32, u32)>,
    /// Of the gradient by [δ; u].
    pub slopes: Vec<u32>,
    /// (row, column) of the Hessian, row ≤ column.
    pub hessian: Vec<(u32, u32)>,
}

impl Entries {
    fn len(&self) -> usize {
        self.dynamics.len() + self.slopes.len() + self.hessian.len()
    }
}

/// A system and a cost, recorded; see the [module](self).
#[derive(Debug, Clone)]
pub struct StageModel {
    pub(super) errors: ErrorState,
    pub(super) lengths: Lengths,
    /// [x, u, p, shifts, weights] → [x⁺, ℓ, conditions].
    forward: Program,
    end: Program,
    /// → [x⁺, ℓ, conditions, entries].
    expansion: Executable<[f64; LINE]>,
    pub(super) entries: Entries,
    end_expansion: Executable<[f64; LINE]>,
    pub(super) end_entries: Entries,
    /// Exact curvatures, of a stage and of the end; made by [`with_curvature`](Self::with_curvature).
    pub(super) curvatures: Option<Box<[Curvature; 2]>>,
}

/// The exact Hessian of a stage's Lagrangian.
#[derive(Debug, Clone)]
pub(super) struct Curvature {
    /// [x, u, p, shifts, weights, λ] → entries.
    code: Executable<[f64; LINE]>,
    /// (row, column), row ≤ column, of [δ; u].
    pub entries: Vec<(u32, u32)>,
    /// [x, u, p, shifts, weights, λ, w, μ] → ∂/∂p of wᵀ∂L/∂[δ; u] + μᵀf: what a solution's derivative leaves at the parameters.
    pull: Program,
}

/// Room for evaluations; made once, reused without allocation.
#[derive(Debug, Clone)]
pub(super) struct StageWork {
    forward: Workspace,
    end: Workspace,
    expansion: Work<[f64; LINE]>,
    end_expansion: Work<[f64; LINE]>,
    curvatures: Vec<Work<[f64; LINE]>>,
    pub arguments: Vec<[f64; LINE]>,
    pub results: Vec<[f64; LINE]>,
    pub single: Vec<f64>,
    pub single_results: Vec<f64>,
}

impl StageModel {
    /// Records a system and a cost. Parameters of a stage are θ of the system, then those of the cost.
    ///
    /// # Errors
    /// [`Error::Value`] for an error state of another length, no inputs, or a weight that depends on state or input;
    /// [`Error::Limit`] where a recording is too large.
    pub fn new<F: System, C: OptimalCost>(system: &F, cost: &C, errors: ErrorState) -> Result<Self> {
        let (n_state, n_input) = (system.n_state(), system.n_input());
        if errors.n_state() != n_state {
            let rule = format!("{n_state}, as the system has");
            return Err(Error::value("states of the error state", errors.n_state(), rule, "Take that of the system."));
        }
        if n_input == 0 {
            return Err(Error::value("inputs of the system", 0, "≥ 1", "Optimise something that can be steered."));
        }
        let n_parameter = system.n_parameter() + cost.n_parameter();
        let stage = Stage { system, cost, errors: &errors, n_parameter };
        let counts = [false, true].map(|is_end| stage.counted(is_end));
        let lengths = Lengths {
            n_state,
            n_error: errors.n_error(),
            n_input,
            n_parameter,
            n_condition: counts.map(|c| c[0]),
            n_at_most: counts.map(|c| c[1]),
        };
        let compile = |is_end| {
            let forward = Program::compile(&stage.forward(&lengths, is_end))?;
            let (recording, entries) = stage.expansion(&lengths, is_end)?;
            let program = Program::compile(&recording)?;
            let layout = RowLayout::apart(program.n_input(), program.n_output());
            Ok::<_, Error>((forward, Executable::new(&program, layout)?, entries))
        };
        let (forward, expansion, entries) = compile(false)?;
        let (end, end_expansion, end_entries) = compile(true)?;
        let curvatures = None;
        Ok(Self { lengths, forward, end, expansion, entries, end_expansion, end_entries, curvatures, errors })
    }

    /// The same with exact curvatures: Hessians of ℓ + λᵀ(f(x ⊕ δ, u) ⊖ f(x, u)) by [δ; u]. A search then converges quadratically, and a
    /// solution can be differentiated. Their code is several times as long as all else.
    ///
    /// # Errors
    /// As [`new`](Self::new), of the same system and cost.
    pub fn with_curvature<F: System, C: OptimalCost>(mut self, system: &F, cost: &C) -> Result<Self> {
        let n_parameter = self.lengths.n_parameter;
        let stage = Stage { system, cost, errors: &self.errors, n_parameter };
        let compile = |is_end| {
            let (recording, entries) = stage.curvature(&self.lengths, is_end);
            let program = Program::compile(&recording)?;
            let layout = RowLayout::apart(program.n_input(), program.n_output());
            let pull = Program::compile(&stage.pull(&self.lengths, is_end))?;
            Ok::<_, Error>(Curvature { code: Executable::new(&program, layout)?, entries, pull })
        };
        let own = [compile(false)?, compile(true)?];
        self.curvatures = Some(Box::new(own));
        Ok(self)
    }

    /// Whether it has exact curvatures.
    pub fn has_curvature(&self) -> bool {
        self.curvatures.is_some()
    }

    /// Coordinates of errors of the state.
    pub fn errors(&self) -> &ErrorState {
        &self.errors
    }

    /// Numbers of a state.
    pub fn n_state(&self) -> usize {
        self.lengths.n_state
    }

    /// Numbers of an input.
    pub fn n_input(&self) -> usize {
        self.lengths.n_input
    }

    /// Numbers that a stage reads beside state and input: θ, then those of the cost.
    pub fn n_parameter(&self) -> usize {
        self.lengths.n_parameter
    }

    /// Conditions of a stage, and of the end.
    pub fn n_condition(&self) -> [usize; 2] {
        self.lengths.n_condition
    }

    /// Why expansions are interpreted; `None` where they are machine code.
    pub fn why_interpreted(&self) -> Option<autodiff::native::WhyInterpreted> {
        self.expansion.why_interpreted()
    }

    pub(super) fn work(&self) -> StageWork {
        let lengths = &self.lengths;
        let n_argument = lengths.n_argument(false).max(lengths.n_argument(true)) + lengths.n_error;
        let curvatures = self.curvatures.iter().flat_map(|own| own.iter());
        let n_curvature = curvatures.clone().map(|own| own.entries.len()).max().unwrap_or(0);
        let n_forward = lengths.n_state + 1 + lengths.n_condition[0].max(lengths.n_condition[1]);
        let n_result = (n_forward + self.entries.len().max(self.end_entries.len())).max(n_curvature);
        StageWork {
            forward: self.forward.workspace(),
            end: self.end.workspace(),
            expansion: self.expansion.work(),
            end_expansion: self.end_expansion.work(),
            curvatures: curvatures.map(|own| own.code.work()).collect(),
            arguments: vec![[0.0; LINE]; n_argument],
            results: vec![[0.0; LINE]; n_result],
            single: vec![0.0; n_argument],
            single_results: vec![0.0; n_forward],
        }
    }

    /// x⁺, ℓ and conditions of `work.single` into `work.single_results`; of the end ℓ and conditions.
    pub(super) fn evaluate(&self, work: &mut StageWork, is_end: bool) {
        let n_argument = self.lengths.n_argument(is_end);
        let (program, workspace) = if is_end { (&self.end, &mut work.end) } else { (&self.forward, &mut work.forward) };
        let results = &mut work.single_results[..program.n_output()];
        program.evaluate(workspace, &work.single[..n_argument], results);
    }

    /// Expansions of the first `n` stages in `work.arguments` into `work.results`: what [`evaluate`](Self::evaluate) gives, then entries.
    pub(super) fn expand(&self, work: &mut StageWork, n: usize, is_end: bool) {
        let (code, own, entries) = if is_end {
            (&self.end_expansion, &mut work.end_expansion, &self.end_entries)
        } else {
            (&self.expansion, &mut work.expansion, &self.entries)
        };
        let lengths = &self.lengths;
        let next = if is_end { 0 } else { lengths.n_state };
        let n_result = next + 1 + lengths.n_condition[usize::from(is_end)] + entries.len();
        let arguments = &work.arguments[..lengths.n_argument(is_end)];
        let arrays = &mut [Rows::Read(arguments), Rows::Write(&mut work.results[..n_result])];
        let is_run = code.run(own, arrays, n).is_ok();
        assert!(is_run, "rows of a stage");
    }
}

impl StageModel {
    /// Exact curvatures of the first `n` stages in `work.arguments`, with λ behind all else, into `work.results`.
    pub(super) fn curve(&self, work: &mut StageWork, n: usize, is_end: bool) {
        let Some(own) = &self.curvatures else { return };
        let Curvature { code, entries, .. } = &own[usize::from(is_end)];
        let n_argument = self.lengths.n_argument(is_end) + if is_end { 0 } else { self.lengths.n_error };
        let arguments = Rows::Read(&work.arguments[..n_argument]);
        let arrays = &mut [arguments, Rows::Write(&mut work.results[..entries.len()])];
        let is_run = code.run(&mut work.curvatures[usize::from(is_end)], arrays, n).is_ok();
        assert!(is_run, "rows of a stage");
    }
}

impl StageModel {
    /// What steps w and costates μ leave at the parameters of a stage, `[n_parameter]`, from `arguments` as [`Curvature::pull`] reads them.
    pub(super) fn pull(&self, is_end: bool, arguments: &[f64]) -> Vec<f64> {
        let Some(own) = &self.curvatures else { return vec![f64::NAN; self.lengths.n_parameter] };
        let program = &own[usize::from(is_end)].pull;
        let mut results = vec![0.0; program.n_output()];
        program.evaluate(&mut program.workspace(), arguments, &mut results);
        results
    }
}

/// What is recorded.
struct Stage<'a, F, C> {
    system: &'a F,
    cost: &'a C,
    errors: &'a ErrorState,
    n_parameter: usize,
}

/// Numbers of a recorded stage.
struct Numbers<'a> {
    state: &'a [Trace],
    input: &'a [Trace],
    parameters: &'a [Trace],
    /// Of conditions: what is added to each, and the weight of its square.
    shifts: &'a [Trace],
    weights: &'a [Trace],
}

impl<'a> Numbers<'a> {
    fn cut(z: &'a [Trace], lengths: &Lengths, is_end: bool) -> Self {
        let (state, z) = z.split_at(lengths.n_state);
        let (input, z) = z.split_at(if is_end { 0 } else { lengths.n_input });
        let (parameters, z) = z.split_at(lengths.n_parameter);
        let (shifts, weights) = z.split_at(lengths.n_condition[usize::from(is_end)]);
        Self { state, input, parameters, shifts, weights }
    }
}

impl<F: System, C: OptimalCost> Stage<'_, F, C> {
    fn terms(&self, state: &[Trace], input: &[Trace], parameters: &[Trace], is_end: bool) -> Terms<Trace> {
        let mut terms = Terms::none();
        let now = StageInput { state, input, parameters: &parameters[self.system.n_parameter()..] };
        if is_end {
            self.cost.terminal(now, &mut terms)
        } else {
            self.cost.stage(now, &mut terms)
        }
        terms
    }

    /// How many conditions there are, and how many of them are g ≤ 0.
    fn counted(&self, is_end: bool) -> [usize; 2] {
        on_constants(|| {
            let numbers = |n: usize| vec![Trace::one(); n];
            let input = numbers(if is_end { 0 } else { self.system.n_input() });
            let terms = self.terms(&numbers(self.system.n_state()), &input, &numbers(self.n_parameter), is_end);
            [terms.n_condition(), terms.at_most.len()]
        })
    }

    fn next(&self, state: &[Trace], input: &[Trace], parameters: &[Trace]) -> Vec<Trace> {
        let mut next = vec![Trace::zero(); state.len()];
        self.system.step(state, input, &parameters[..self.system.n_parameter()], &mut next);
        next
    }

    fn forward(&self, lengths: &Lengths, is_end: bool) -> Recording {
        Recording::of(lengths.n_argument(is_end), |z| {
            let z = Numbers::cut(z, lengths, is_end);
            let mut results = if is_end { Vec::new() } else { self.next(z.state, z.input, z.parameters) };
            results.extend(self.valued(&z, is_end));
            results
        })
    }

    /// ℓ with the squares of conditions, then the conditions.
    fn valued(&self, z: &Numbers<'_>, is_end: bool) -> Vec<Trace> {
        let mut terms = self.terms(z.state, z.input, z.parameters, is_end);
        let conditions: Vec<Trace> = terms.at_most.iter().chain(&terms.zeros).copied().collect();
        terms.enforce(z.shifts, z.weights);
        let half = Trace::constant(0.5);
        let squares = terms.squares.iter().map(|(w, r)| half * *w * r.square());
        let cost = squares.fold(terms.sum, |sum, square| sum + square);
        [vec![cost], conditions].concat()
    }

    /// [δ, u; x, p, …] → [x ⊕ δ, u, p, …].
    fn moved(&self, z: &[Trace], lengths: &Lengths, n_input: usize) -> Vec<Trace> {
        let (error, rest) = z.split_at(lengths.n_error);
        let (input, rest) = rest.split_at(n_input);
        let (state, rest) = rest.split_at(lengths.n_state);
        [&moved(self.errors, state, error), input, rest].concat()
    }

    /// The Hessian of the Lagrangian, its upper triangle, with the entries that are not zero.
    fn curvature(&self, lengths: &Lengths, is_end: bool) -> (Recording, Vec<(u32, u32)>) {
        let n_input = if is_end { 0 } else { lengths.n_input };
        let (n_z, n_own) = (lengths.n_error + n_input, lengths.n_argument(is_end));
        let n_costate = if is_end { 0 } else { lengths.n_error };
        let own = self.lagrangian(lengths, is_end);
        let lagrangian = Recording::of(own.n_input(), |z| {
            let mut results = vec![Trace::zero(); own.n_output()];
            own.evaluate(z, &mut results);
            results[..1].to_vec()
        });
        let hessian = lagrangian.jacobian(0..n_z).jacobian(0..n_z);
        let mut entries = Vec::new();
        let recording = Recording::of(n_own + n_costate, |z| {
            let at = self.unmoved(z, lengths, n_input);
            let mut all = vec![Trace::zero(); n_z * n_z];
            hessian.evaluate(&at, &mut all);
            let mut results = Vec::new();
            for column in 0..n_z {
                for row in 0..=column {
                    let own = all[column * n_z + row];
                    if own.known() != Some(0.0) {
                        entries.push((row as u32, column as u32));
                        results.push(own);
                    }
                }
            }
            results
        });
        (recording, entries)
    }

    /// The Lagrangian over [δ, u; x, p, shifts, weights; λ], and what follows the state behind it.
    fn lagrangian(&self, lengths: &Lengths, is_end: bool) -> Recording {
        let n_input = if is_end { 0 } else { lengths.n_input };
        let n_own = lengths.n_argument(is_end);
        let n_costate = if is_end { 0 } else { lengths.n_error };
        Recording::of(lengths.n_error + n_own + n_costate, |z| {
            let z = self.moved(z, lengths, n_input);
            let (z, costates) = z.split_at(n_own);
            let z = Numbers::cut(z, lengths, is_end);
            let mut sum = self.valued(&z, is_end)[0];
            let next =
                if is_end { Vec::new() } else { errors_of(self.errors, &self.next(z.state, z.input, z.parameters)) };
            sum = next.iter().zip(costates).fold(sum, |sum, (e, costate)| sum + *e * *costate);
            [vec![sum], next].concat()
        })
    }

    /// See [`Curvature::pull`].
    fn pull(&self, lengths: &Lengths, is_end: bool) -> Recording {
        let n_input = if is_end { 0 } else { lengths.n_input };
        let (n_z, n_own) = (lengths.n_error + n_input, lengths.n_argument(is_end));
        let n_costate = if is_end { 0 } else { lengths.n_error };
        let own = self.lagrangian(lengths, is_end);
        let n_all = own.n_input();
        let alone = Recording::of(n_all, |z| {
            let mut results = vec![Trace::zero(); own.n_output()];
            own.evaluate(z, &mut results);
            results[..1].to_vec()
        });
        let slopes = alone.jacobian(0..n_z);
        let sum = Recording::of(n_all + n_z + n_costate, |z| {
            let (z, weights) = z.split_at(n_all);
            let (steps, costates) = weights.split_at(n_z);
            let (mut by_z, mut results) = (vec![Trace::zero(); n_z], vec![Trace::zero(); own.n_output()]);
            slopes.evaluate(z, &mut by_z);
            own.evaluate(z, &mut results);
            let terms = by_z.iter().zip(steps).chain(results[1..].iter().zip(costates));
            vec![terms.fold(Trace::zero(), |sum, (a, b)| sum + *a * *b)]
        });
        let first = n_z + lengths.n_state;
        let pulled = sum.jacobian(first..first + lengths.n_parameter);
        Recording::of(n_own + n_costate + n_z + n_costate, |z| {
            let at = self.unmoved(z, lengths, n_input);
            let mut results = vec![Trace::zero(); lengths.n_parameter];
            pulled.evaluate(&at, &mut results);
            results
        })
    }

    /// [x, u, p, …] → [0, u; x, p, …].
    fn unmoved(&self, z: &[Trace], lengths: &Lengths, n_input: usize) -> Vec<Trace> {
        let mut at = vec![Trace::zero(); lengths.n_error];
        at.extend_from_slice(&z[lengths.n_state..lengths.n_state + n_input]);
        at.extend_from_slice(&z[..lengths.n_state]);
        at.extend_from_slice(&z[lengths.n_state + n_input..]);
        at
    }

    /// Values and derivatives, with the entries that are not zero.
    fn expansion(&self, lengths: &Lengths, is_end: bool) -> Result<(Recording, Entries)> {
        let n_input = if is_end { 0 } else { lengths.n_input };
        let n_z = lengths.n_error + n_input;
        let (n_argument, n_all) = (lengths.n_argument(is_end), n_z + lengths.n_argument(is_end) - n_input);
        let moved = |z: &[Trace]| self.moved(z, lengths, n_input);
        let step = (!is_end).then(|| {
            Recording::of(n_all, |z| {
                let z = moved(z);
                let z = Numbers::cut(&z, lengths, is_end);
                errors_of(self.errors, &self.next(z.state, z.input, z.parameters))
            })
        });
        let (mut n_square, mut is_fixed) = (0, true);
        let squares = Recording::of(n_all, |z| {
            let z = moved(z);
            let z = Numbers::cut(&z, lengths, is_end);
            let mut terms = self.terms(z.state, z.input, z.parameters, is_end);
            terms.enforce(z.shifts, z.weights);
            n_square = terms.squares.len();
            terms.squares.iter().map(|s| s.1).chain(terms.squares.iter().map(|s| s.0)).collect()
        });
        let by_squares = squares.jacobian(0..n_z);
        let sum = Recording::of(n_all, |z| {
            let z = moved(z);
            let z = Numbers::cut(&z, lengths, is_end);
            vec![self.terms(z.state, z.input, z.parameters, is_end).sum]
        });
        let by_sum = sum.jacobian(0..n_z);
        let curvature = by_sum.jacobian(0..n_z);
        let mut entries = Entries::default();
        let recording = Recording::of(n_argument, |z| {
            let at = self.unmoved(z, lengths, n_input);
            let evaluated = |recording: &Recording| {
                let mut results = vec![Trace::zero(); recording.n_output()];
                recording.evaluate(&at, &mut results);
                results
            };
            let cut = Numbers::cut(z, lengths, is_end);
            let mut results = if is_end { Vec::new() } else { self.next(cut.state, cut.input, cut.parameters) };
            results.extend(self.valued(&cut, is_end));
            let mut keep = |value: Trace| {
                let is_kept = value.known() != Some(0.0);
                is_kept.then(|| results.push(value)).is_some()
            };
            if let Some(step) = &step {
                for (k, value) in evaluated(&step.jacobian(0..n_z)).into_iter().enumerate() {
                    let place = ((k % lengths.n_error) as u32, (k / lengths.n_error) as u32);
                    if keep(value) {
                        entries.dynamics.push(place);
                    }
                }
            }
            let (values, slopes) = (evaluated(&squares), evaluated(&by_squares));
            let slope = |square: usize, z: usize| slopes[z * 2 * n_square + square];
            let is_fixed_weight = |square: usize| (0..n_z).all(|z| slope(n_square + square, z).known() == Some(0.0));
            is_fixed = (0..n_square).all(is_fixed_weight);
            let (by_sum, curvature) = (evaluated(&by_sum), evaluated(&curvature));
            for z in 0..n_z {
                let own = (0..n_square).map(|s| values[n_square + s] * values[s] * slope(s, z));
                if keep(own.fold(by_sum[z], |sum, term| sum + term)) {
                    entries.slopes.push(z as u32);
                }
            }
            for column in 0..n_z {
                for row in 0..=column {
                    let own = (0..n_square).map(|s| values[n_square + s] * (slope(s, row) * slope(s, column)));
                    if keep(own.fold(curvature[column * n_z + row], |sum, term| sum + term)) {
                        entries.hessian.push((row as u32, column as u32));
                    }
                }
            }
            results
        });
        if is_fixed {
            return Ok((recording, entries));
        }
        let remedy = "Weigh by numbers and parameters, or give the cost by Terms::add.";
        Err(Error::value("weight of a square", "of state or input", "of parameters alone", remedy))
    }
}

impl Terms<Trace> {
    /// Squares in place of conditions: ½ w max(0, g + s)², ½ w (h + s)².
    fn enforce(&mut self, shifts: &[Trace], weights: &[Trace]) {
        let n_at_most = self.at_most.len();
        let conditions: Vec<Trace> = self.at_most.drain(..).chain(self.zeros.drain(..)).collect();
        for (k, ((condition, shift), weight)) in conditions.into_iter().zip(shifts).zip(weights).enumerate() {
            let shifted = condition + *shift;
            self.square(*weight, if k < n_at_most { Scalar::max(shifted, Trace::zero()) } else { shifted });
        }
    }
}

/// Hamilton product.
fn product(a: &[Trace], b: &[Trace]) -> [Trace; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// x ⊕ δ, to second order.
fn moved(errors: &ErrorState, state: &[Trace], error: &[Trace]) -> Vec<Trace> {
    let c = Trace::constant;
    let mut all = Vec::with_capacity(state.len());
    errors.each(|at, to, turns| {
        if turns {
            let half = [0, 1, 2].map(|k| error[to + k] * c(0.5));
            let w = c(1.0) - half.iter().fold(c(0.0), |sum, h| sum + h.square()) * c(0.5);
            all.extend(product(&state[at..at + 4], &[w, half[0], half[1], half[2]]));
        } else {
            all.push(state[at] + error[to]);
        }
    });
    all
}

/// x ⊖ x₀ about its own value x₀: 0, with derivatives.
fn errors_of(errors: &ErrorState, state: &[Trace]) -> Vec<Trace> {
    let mut all = Vec::with_capacity(errors.n_error());
    errors.each(|at, _, turns| {
        if turns {
            let own = &state[at..at + 4];
            let back = [own[0].detach(), -own[1].detach(), -own[2].detach(), -own[3].detach()];
            all.extend(product(&back, own)[1..].iter().map(|v| *v * Trace::constant(2.0)));
        } else {
            all.push(state[at]);
        }
    });
    all
}

#[cfg(test)]
mod tests;
