//! Steps of a tape pulled backwards: what a sweep on the host does, one environment after the other.

use super::{EnvKernel, check};
use crate::config::Autoreset;
use crate::env::gradient::Adjoint;
use crate::env::{Env, StepLayout};
use autodiff::emit::CText;
use base::error::Result;

/// Rows of the caller: an address, 0 for none, and from an environment and from a number to the next.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Given {
    /// On the device.
    pub at: u64,
    /// In numbers.
    pub environment: i64,
    /// In numbers.
    pub number: i64,
}

/// The argument of [`EnvKernel::Pull`], as the prelude declares it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(C)]
pub struct SweepArguments {
    /// Rows of the tape's step.
    pub tape: u64,
    /// The normaliser's in that step, in `f32`.
    pub statistics: u64,
    /// Rows of what is carried from step to step.
    pub carried: u64,
    /// Rows of the actions' cotangents.
    pub action: u64,
    /// Rows of sums over all steps, where there are any.
    pub parameters: u64,
    /// Rows of work: cotangents of results.
    pub seeds: u64,
    /// Rows of work: those of arguments.
    pub results: u64,
    /// Flags of the step, a byte each.
    pub running: u64,
    /// Flags of the step, a byte each.
    pub ended: u64,
    /// Flags of the step behind it, a byte each; 0 for the last one.
    pub moved: u64,
    /// Gradients of each that were not finite, 64 bits.
    pub dropped: u64,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub observation: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub final_observation: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub central: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub final_central: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub final_carried: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub reward: Given,
    /// See [`Cotangents`](crate::env::Cotangents).
    pub loss: Given,
    /// See [`SweepOptions`](crate::env::SweepOptions).
    pub decay: f32,
    /// See [`SweepOptions`](crate::env::SweepOptions).
    pub clip: f32,
    /// Environments.
    pub n: u32,
    /// From a row to the next, in numbers.
    pub stride: u32,
}

impl Env {
    /// The text of the kernel [`EnvKernel::Pull`] behind the prelude, of an adjoint of these environments.
    ///
    /// # Errors
    /// As [`Env::kernels`].
    #[doc(hidden)]
    pub fn adjoint_kernel(&self, adjoint: &Adjoint) -> Result<String> {
        check(&self.core)?;
        let (p, program, mut text) = (adjoint.layout(), adjoint.program(), CText::cuda("od"));
        let own = |array: &str, row: usize| format!("e.{array}[{row} * e.stride + i]");
        let input = |row: usize| match row {
            row if p.statistics.contains(&row) => format!("e.statistics[{}]", row - p.statistics.start),
            row if row < p.n_argument() => own("tape", row),
            row => own("seeds", row - p.n_argument()),
        };
        let places =
            [(0..program.n_input()).map(input).collect(), (0..program.n_output()).map(|k| own("results", k)).collect()];
        text.function_over(program, "program_adjoint", "const od_sweep &e, const uint32_t i", places)?;
        let adds = self.core.mode != Autoreset::SameStep;
        let body = pull(p, program.n_output(), adds);
        let name = EnvKernel::Pull.name();
        text.add(&format!("OD_KERNEL({name}, od_sweep, od_pulled, 1)\n{{\n{body}}}\n"));
        Ok(text.finished())
    }
}

/// A step of one environment. Where an episode ended and the next one is shown, only what it ended with counts; else both do.
fn pull(p: &StepLayout, n_result: usize, adds: bool) -> String {
    let seen = |name: &str, first: usize, n: usize| {
        let both =
            if adds { format!("own + od_of(e.final_{name}, i, k)") } else { format!("od_of(e.final_{name}, i, k)") };
        format!(
            "    for (uint32_t k = 0; k < {n}u; k++) {{\n        const float own = od_of(e.{name}, i, k);\n        \
             e.seeds[({first}u + k) * e.stride + i] = !live ? 0.0f : ended ? {both} : own;\n    }}\n"
        )
    };
    let (carried, actions) = (p.n_carried(), p.action.clone());
    let parameters = n_result.saturating_sub(actions.end);
    format!(
        "    const int live = e.running[i], ended = e.ended[i], moved = e.moved && e.moved[i];
    for (uint32_t k = 0; k < {carried}u; k++) {{
        const float own = ended ? od_of(e.final_carried, i, k) : moved ? 0.0f : e.carried[k * e.stride + i];
        e.seeds[k * e.stride + i] = live ? own : 0.0f;
    }}
{observation}{central}    e.seeds[{reward}u * e.stride + i] = live ? od_of(e.reward, i, 0) : 0.0f;
    e.seeds[{loss}u * e.stride + i] = live ? od_of(e.loss, i, 0) : 0.0f;
    od_program_adjoint(e, i);
    float sound = 0.0f; /* 0 where all is finite, else NaN */
    for (uint32_t k = 0; k < {n_result}u; k++) sound += 0.0f * e.results[k * e.stride + i];
    const int counts = live && sound == 0.0f;
    if (live && !counts) e.dropped[i] += 1u;
    float square = 0.0f;
    for (uint32_t k = 0; k < {carried}u; k++) {{
        const float own = e.decay * (counts ? e.results[k * e.stride + i] : 0.0f);
        e.carried[k * e.stride + i] = own;
        square += own * own;
    }}
    for (uint32_t k = 0; k < {actions}u; k++) {{
        e.action[k * e.stride + i] = counts ? e.results[({action}u + k) * e.stride + i] : 0.0f;
    }}
    for (uint32_t k = 0; k < {parameters}u; k++) {{
        e.parameters[k * e.stride + i] += counts ? e.results[({end}u + k) * e.stride + i] : 0.0f;
    }}
    const float norm = __fsqrt_rn(square);
    if (fabsf(e.clip) <= {largest} && norm > e.clip) {{
        const float factor = e.clip / norm;
        for (uint32_t k = 0; k < {carried}u; k++) e.carried[k * e.stride + i] *= factor;
    }}
",
        observation = seen("observation", p.observation.start, p.observation.len()),
        central = seen("central", p.central.start, p.central.len()),
        reward = p.reward,
        loss = p.loss,
        actions = actions.len(),
        action = actions.start,
        end = actions.end,
        largest = "3.4028235e38f",
    )
}
