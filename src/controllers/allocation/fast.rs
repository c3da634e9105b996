//! The fast paths of an [`Allocator`](super::Allocator): the closed form, and the active set in `f64`, warm from tick to
//! tick; and the gradient that uses their factorisation again.

use super::active_set::{BoxQp, FAR, Factor, Iterate, Tolerances};
use super::allocator::AllocatorSettings;
use super::problem::{Problem, Scales, WRENCH};
use super::variation::Variation;

/// Most inputs of the fast path.
pub(crate) const MAX_FAST: usize = 24;
/// Most steps of the active set; the most seen over 10⁵ random problems is 20.
pub(super) const MAX_STEPS: u32 = 100;

/// What the fast path prepares: H and the closed form in units of inputs and gradients.
pub(super) struct Fast {
    pub(super) program: BoxQp<f64, MAX_FAST>,
    /// BᵀW by rows of inputs, and ρ u_pref.
    pub(super) pull: Vec<[f64; WRENCH]>,
    pub(super) offset: Vec<f64>,
    /// u = K w + k where no bound acts.
    pub(super) gain: Vec<[f64; WRENCH]>,
    pub(super) rest: Vec<f64>,
    /// Of H whole: where no bound acts.
    whole: Factor<f64, MAX_FAST>,
    /// Of the active set of the last answer.
    factor: Factor<f64, MAX_FAST>,
    iterate: Iterate<f64, MAX_FAST>,
    /// Whether `iterate` is an answer to start from.
    pub(super) warm: bool,
    /// Of H, and of inputs.
    pub(super) cost: f64,
    unit: f64,
}

impl Fast {
    /// `None` for problems with cones, too many inputs, or settings that forbid it.
    pub(super) fn of(problem: &Problem, settings: AllocatorSettings) -> Option<Box<Self>> {
        let n = problem.n_input();
        if !settings.fast || !problem.cones.is_empty() || n > MAX_FAST {
            return None;
        }
        let program = BoxQp::empty();
        let mut fast = Box::new(Self {
            iterate: program.start(n, &[0.0; MAX_FAST]),
            program,
            pull: vec![[0.0; WRENCH]; n],
            offset: vec![0.0; n],
            gain: vec![[0.0; WRENCH]; n],
            rest: vec![0.0; n],
            whole: Factor::new(),
            factor: Factor::new(),
            warm: false,
            cost: 1.0,
            unit: 1.0,
        });
        fast.prepare(problem);
        Some(fast)
    }

    /// All that depends on geometry, weights, ρ and preference. No allocation.
    pub(super) fn prepare(&mut self, problem: &Problem) {
        let n = problem.n_input();
        let b = problem.geometry.as_slice();
        for j in 0..n {
            self.pull[j] = std::array::from_fn(|k| b[WRENCH * j + k] * problem.weights[k]);
            self.offset[j] = problem.regularisation * problem.preference[j];
        }
        let column = |j: usize| std::array::from_fn::<f64, WRENCH, _>(|k| b[WRENCH * j + k]);
        self.cost = (0..n).map(|j| dot(&self.pull[j], &column(j))).fold(0.0, f64::max) + problem.regularisation;
        for i in 0..n {
            for j in 0..n {
                let own = if i == j { problem.regularisation } else { 0.0 };
                self.program.hessian[i][j] = (dot(&self.pull[i], &column(j)) + own) / self.cost;
            }
        }
        self.whole.of(n, &self.program.hessian, &[0.0; MAX_FAST], Tolerances::DOUBLE);
        for k in 0..=WRENCH {
            let mut column = [0.0; MAX_FAST];
            for j in 0..n {
                column[j] = if k < WRENCH { self.pull[j][k] } else { self.offset[j] } / self.cost;
            }
            self.whole.solve(n, &mut column);
            for j in 0..n {
                *(if k < WRENCH { &mut self.gain[j][k] } else { &mut self.rest[j] }) = column[j];
            }
        }
    }

    /// Bounds and q of now, in units of the size of the inputs; returns the scales of residuals.
    pub(super) fn task(&mut self, problem: &Problem, wrench: &[f64; WRENCH]) -> Scales {
        let mut largest = 0.0_f64;
        let n = problem.n_input();
        for j in 0..n {
            let pulled = dot(&self.pull[j], wrench);
            largest = largest.max(pulled.abs());
            self.program.linear[j] = -(pulled + self.offset[j]);
        }
        let scales = problem.scales_of(self.cost, largest);
        let change = self.unit / scales.input;
        self.iterate.inputs.iter_mut().for_each(|u| *u *= change);
        self.unit = scales.input;
        for j in 0..n {
            self.program.linear[j] /= self.cost * self.unit;
            self.program.lower[j] = (problem.lower[j] / self.unit).clamp(-FAR, FAR);
            self.program.upper[j] = (problem.upper[j] / self.unit).clamp(-FAR, FAR);
        }
        scales
    }

    /// The closed form; whether it is within all bounds, with room.
    pub(super) fn free(&self, problem: &Problem, wrench: &[f64; WRENCH], inputs: &mut [f64]) -> bool {
        let mut inside = true;
        for (j, u) in inputs.iter_mut().enumerate() {
            *u = dot(&self.gain[j], wrench) + self.rest[j];
            let (lower, upper) = (problem.lower[j], problem.upper[j]);
            inside &= lower < upper && lower <= *u && *u <= upper;
        }
        inside
    }

    /// The active set from the last one, else from the clipped closed form in `inputs`: the number of steps, and whether
    /// the last one changed nothing.
    pub(super) fn search(&mut self, problem: &Problem, warm: bool, inputs: &mut [f64]) -> (u32, bool) {
        let n = inputs.len();
        let near = warm && self.warm;
        self.iterate = if near {
            self.program.restart(n, &self.iterate)
        } else {
            let mut from = [0.0; MAX_FAST];
            for (slot, u) in from.iter_mut().zip(&*inputs) {
                *slot = u / self.unit;
            }
            self.program.start(n, &from)
        };
        let mut steps = 0;
        while steps < MAX_STEPS && (steps == 0 || self.iterate.done < 0.5) {
            let many = steps < MAX_STEPS / 4;
            self.program.step(n, &mut self.iterate, &mut self.factor, many, Tolerances::DOUBLE);
            steps += 1;
        }
        if !near {
            // from afar the last step is long, and so is its rounding
            self.program.step(n, &mut self.iterate, &mut self.factor, false, Tolerances::DOUBLE);
            steps += 1;
        }
        for (j, u) in inputs.iter_mut().enumerate() {
            // a held input is its bound to the bit
            *u = match self.iterate.status[j] {
                s if s < -0.5 => problem.lower[j],
                s if s > 0.5 => problem.upper[j],
                _ => (self.iterate.inputs[j] * self.unit).max(problem.lower[j]).min(problem.upper[j]),
            };
        }
        (steps, self.iterate.done > 0.5)
    }

    /// y = H_FF⁻¹ ū_F and what follows from it, see [`super::gradient`]; the margin.
    pub(super) fn reverse(
        &self,
        problem: &Problem,
        wrench: &[f64; WRENCH],
        inputs: &[f64],
        closed: bool,
        cotangent: &[f64],
        out: &mut Variation,
    ) -> f64 {
        let n = inputs.len();
        let mut y = [0.0; MAX_FAST];
        for i in 0..n {
            let free = closed || self.iterate.status[i] == 0.0;
            y[i] = if free { cotangent[i] / self.cost } else { 0.0 };
        }
        if closed { &self.whole } else { &self.factor }.solve(n, &mut y);
        let b = problem.geometry.as_slice();
        let miss = problem.miss(wrench, inputs);
        let force = force(problem, &miss);
        let mut pulled = [0.0; WRENCH];
        for j in 0..n {
            for k in 0..WRENCH {
                pulled[k] += b[WRENCH * j + k] * y[j];
            }
        }
        for k in 0..WRENCH {
            out.weights[k] = -pulled[k] * miss[k];
            pulled[k] *= problem.weights[k];
            out.wrench[k] = pulled[k];
        }
        out.regularisation = 0.0;
        let geometry = out.geometry.as_mut_slice();
        for j in 0..n {
            for k in 0..WRENCH {
                geometry[WRENCH * j + k] = -(y[j] * force[k] + pulled[k] * inputs[j]);
            }
            out.regularisation -= y[j] * (inputs[j] - problem.preference[j]);
            out.preference[j] = problem.regularisation * y[j];
            // a held input has y = 0, so that H y there is Bᵀ W B y alone
            let mut through = cotangent[j];
            for k in 0..WRENCH {
                through -= b[WRENCH * j + k] * pulled[k];
            }
            let status = self.held(problem, &force, inputs, closed, j);
            out.lower[j] = if status < 0.0 { through } else { 0.0 };
            out.upper[j] = if status > 0.0 { through } else { 0.0 };
        }
        self.margin(problem, inputs, closed)
    }

    /// The transpose of [`reverse`](Self::reverse): du for a change of all numbers,
    /// du_A = d(bound)_A, du_F = −H_FF⁻¹ (∂(Bᵀ W (B u − w) + ρ (u − u_pref))_F + H_FA du_A); the margin.
    pub(super) fn forward(
        &self,
        problem: &Problem,
        wrench: &[f64; WRENCH],
        inputs: &[f64],
        closed: bool,
        change: &Variation,
        du: &mut [f64],
    ) -> f64 {
        let n = inputs.len();
        let (b, db) = (problem.geometry.as_slice(), change.geometry.as_slice());
        let miss = problem.miss(wrench, inputs);
        let force = force(problem, &miss);
        // change of W (B u − w), held inputs with their bounds
        let mut pull = change.wrench.map(|w| -w);
        for j in 0..n {
            let status = self.held(problem, &force, inputs, closed, j);
            du[j] = match status {
                s if s < 0.0 => change.lower[j],
                s if s > 0.0 => change.upper[j],
                _ => 0.0,
            };
            for k in 0..WRENCH {
                pull[k] += b[WRENCH * j + k] * du[j] + db[WRENCH * j + k] * inputs[j];
            }
        }
        for k in 0..WRENCH {
            pull[k] = problem.weights[k] * pull[k] + change.weights[k] * miss[k];
        }
        let mut y = [0.0; MAX_FAST];
        for j in 0..n {
            if closed || self.iterate.status[j] == 0.0 {
                let away = change.regularisation * (inputs[j] - problem.preference[j]);
                let mut slope = away - problem.regularisation * change.preference[j];
                for k in 0..WRENCH {
                    slope += b[WRENCH * j + k] * pull[k] + db[WRENCH * j + k] * force[k];
                }
                y[j] = -slope / self.cost;
            }
        }
        if closed { &self.whole } else { &self.factor }.solve(n, &mut y);
        for j in 0..n {
            if closed || self.iterate.status[j] == 0.0 {
                du[j] = y[j];
            }
        }
        self.margin(problem, inputs, closed)
    }

    /// −1 where input j is its lower bound, 1 where the upper, else 0. Where both are one, it is the bound that the gradient
    /// pushes to.
    fn held(&self, problem: &Problem, force: &[f64; WRENCH], inputs: &[f64], closed: bool, j: usize) -> f64 {
        if problem.lower[j] == problem.upper[j] {
            let b = problem.geometry.as_slice();
            let push: f64 = (0..WRENCH).map(|k| b[WRENCH * j + k] * force[k]).sum();
            let push = push + problem.regularisation * (inputs[j] - problem.preference[j]);
            return if push > 0.0 { -1.0 } else { 1.0 };
        }
        if closed { 0.0 } else { self.iterate.status[j] }
    }

    /// Least of max(slack, multiplier) over all bounds, scaled as in [`AllocationSensitivity::margin`].
    fn margin(&self, problem: &Problem, inputs: &[f64], closed: bool) -> f64 {
        let mut margin = f64::INFINITY;
        for j in 0..inputs.len() {
            let (lower, upper) = (problem.lower[j], problem.upper[j]);
            if lower == upper {
                continue;
            }
            let room = (inputs[j] - lower).min(upper - inputs[j]) / self.unit;
            let held = !closed && self.iterate.status[j] != 0.0;
            margin = margin.min(if held { self.push(problem, j) } else { room });
        }
        margin
    }

    /// Size of the multiplier that holds input j, over that of gradients.
    fn push(&self, problem: &Problem, j: usize) -> f64 {
        let n = problem.n_input();
        let mut g = self.program.linear[j];
        let mut size = 1.0_f64;
        for i in 0..n {
            g += self.program.hessian[j][i] * self.iterate.inputs[i];
            size = size.max(self.program.linear[i].abs());
        }
        g.abs() / size
    }
}

/// W (B u − w).
fn force(problem: &Problem, miss: &[f64; WRENCH]) -> [f64; WRENCH] {
    let mut force = *miss;
    force.iter_mut().zip(&problem.weights).for_each(|(f, w)| *f *= w);
    force
}

fn dot(a: &[f64; WRENCH], b: &[f64; WRENCH]) -> f64 {
    let mut sum = 0.0;
    for i in 0..WRENCH {
        sum += a[i] * b[i];
    }
    sum
}
