//! An episode that is flown for golden vectors: what environments show, what functions say of it.

use super::golden::{Golden, GoldenPreset, Twin};
use super::module::ModuleBuilder;
use autodiff::emit::{Access, NamedArray, NamedFunction};
use base::error::Result;
use tasks::{Buffers, Env, TaskFunctions};

/// Steps, at most.
const STEPS: usize = 24;

/// A function that remembers, in `f64`.
pub(crate) struct Remembering {
    function: NamedFunction,
    twin: Twin,
    memory: Vec<f64>,
}

impl Remembering {
    pub fn of(function: &NamedFunction) -> Result<Self> {
        let n =
            function.arrays.iter().find(|array| array.access == Access::Update).map_or(0, |array| array.numbers.len());
        Ok(Self { function: function.clone(), twin: Twin::of(function)?, memory: vec![0.0; n] })
    }

    /// The arrays that it reads, by `given`, and those that it writes, one behind the other.
    pub fn call(&mut self, given: &[(&str, &[f64])]) -> (Vec<f64>, Vec<f64>) {
        let (mut inputs, mut seen) = (Vec::new(), Vec::new());
        for array in self.function.arrays.iter().filter(|array| array.access != Access::Write) {
            match given.iter().find(|(name, _)| *name == array.name) {
                Some((_, own)) => {
                    inputs.extend_from_slice(own);
                    seen.extend_from_slice(own);
                }
                None => inputs.extend_from_slice(&self.memory),
            }
        }
        let outputs = self.twin.call(&inputs);
        let (memory, written) = outputs.split_at(self.memory.len());
        self.memory.copy_from_slice(memory);
        (seen, written.to_vec())
    }

    /// Its golden vectors, before there are any.
    fn golden(&self, module: &ModuleBuilder, short: &str) -> Golden {
        let arrays: Vec<&NamedArray> =
            self.function.arrays.iter().filter(|array| array.access != Access::Update).collect();
        Golden::of_function(format!("{}_{short}", module.name()), module.takes_memory(short), &arrays)
    }

    /// Sets a number that it remembers, and tells golden vectors to do so before their next row.
    fn set(&mut self, field: &str, number: &str, value: f64, golden: &mut Golden) {
        let memory = self.function.arrays.iter().find(|array| array.access == Access::Update);
        let Some(k) = memory.and_then(|memory| memory.numbers.iter().position(|own| own.name == number)) else {
            return;
        };
        self.memory[k] = value;
        golden.presets.push(GoldenPreset { row: golden.rows.len(), place: format!("{field}[{k}]"), value });
    }
}

/// One environment with the functions of its task.
pub(crate) struct Episode {
    env: Env,
    out: Buffers,
    observe: Remembering,
    judge: Remembering,
    act: Remembering,
    n_act: usize,
    /// Of observe, judge and act.
    pub golden: [Golden; 3],
}

/// What acts on what is observed: given the observation and how many numbers it gives.
pub(crate) type Acting<'a> = dyn FnMut(&[f64], usize) -> Vec<f64> + 'a;

impl Episode {
    pub fn of(env: Env, module: &ModuleBuilder, functions: &TaskFunctions) -> Result<Self> {
        let [observe, judge, act] = [&functions.observe, &functions.judge, &functions.act].map(Remembering::of);
        let (observe, judge, act) = (observe?, judge?, act?);
        let golden = [observe.golden(module, "observe"), judge.golden(module, "judge"), act.golden(module, "commands")];
        let out = Buffers::new(env.spec());
        Ok(Self { env, out, observe, judge, act, n_act: functions.n_act, golden })
    }

    /// Flies until something ends.
    pub fn fly(&mut self, acting: &mut Acting<'_>) -> Result<()> {
        self.env.reset(None, None, &mut self.out.out())?;
        let start = self.env.shown_beside(0)?;
        let n_action = self.env.spec().n_agent * self.env.spec().action.len();
        for step in 0..STEPS {
            let exact = |numbers: Vec<f32>| numbers.into_iter().map(f64::from).collect::<Vec<_>>();
            let (state, goal) = (exact(self.env.state(0)?), exact(self.env.goal(0)?));
            let readings = if start.readings.is_empty() { Vec::new() } else { self.env.shown_beside(0)?.readings };
            let given = [
                ("state", &state[..]),
                ("goal", &goal),
                ("start", &start.start),
                ("varied", &start.varied),
                ("readings", &readings),
            ];
            self.judged(&given);
            let observed = self.observed(&given);
            let action = acting(&observed, n_action);
            let led = vec![0.1; self.env.robot().n_input()];
            for _ in 0..self.n_act {
                self.acted(&action, &state, &start.varied, &led);
            }
            let actions: Vec<f32> = action.iter().map(|x| *x as f32).collect();
            self.env.step(&actions, &mut self.out.out())?;
            if step + 1 == STEPS || self.out.terminated[0] + self.out.truncated[0] > 0 {
                self.corners(&given, &action, &led);
                break;
            }
        }
        Ok(())
    }

    fn observed(&mut self, given: &[(&str, &[f64])]) -> Vec<f64> {
        let (seen, observed) = self.observe.call(given);
        self.golden[0].rows.push([seen, observed.clone()].concat());
        observed
    }

    fn judged(&mut self, given: &[(&str, &[f64])]) {
        let (seen, judged) = self.judge.call(given);
        self.golden[1].rows.push([seen, judged].concat());
    }

    fn acted(&mut self, action: &[f64], state: &[f64], varied: &[f64], led: &[f64]) {
        let led = &led[..self.act.n_of("controller")];
        let given = [("action", action), ("state", state), ("varied", varied), ("controller", led)];
        let (seen, commands) = self.act.call(&given);
        self.golden[2].rows.push([seen, commands].concat());
    }

    /// Actions beyond their bounds and such that are none, the end of time, and a state that is lost.
    fn corners(&mut self, given: &[(&str, &[f64])], action: &[f64], led: &[f64]) {
        let of = |name: &str| given.iter().find(|(own, _)| *own == name).map_or(&[][..], |(_, own)| *own);
        let (state, varied) = (of("state").to_vec(), of("varied").to_vec());
        let outside = |(k, x): (usize, &f64)| if k % 2 == 0 { x.abs() + 2.5 } else { -x.abs() - 2.5 };
        let mut beyond: Vec<f64> = action.iter().enumerate().map(outside).collect();
        for _ in 0..self.n_act {
            self.acted(&beyond, &state, &varied, led);
        }
        beyond[0] = f64::NAN;
        for _ in 0..self.n_act {
            self.acted(&beyond, &state, &varied, led);
        }
        let horizon = self.env.spec().horizon as f64;
        self.judge.set("judge", "step", horizon - 2.0, &mut self.golden[1]);
        self.observe.set("observe", "step", horizon - 2.0, &mut self.golden[0]);
        for _ in 0..3 {
            self.judged(given);
            self.observed(given);
        }
        let moved = |by: [f64; 3]| {
            let mut state = state.clone();
            for root in self.env.robot().roots() {
                // one that does not float has fewer
                state.iter_mut().skip(*root).zip(by).for_each(|(x, by)| *x += by);
            }
            state
        };
        let [far, low] = [[6.0, 0.0, 0.0], [0.0, 0.0, -4.0]].map(moved);
        let lost: Vec<f64> = state.iter().map(|x| 40.0 * x + 30.0).collect();
        for state in [far, low, lost] {
            let mut given = given.to_vec();
            given.iter_mut().filter(|(name, _)| *name == "state").for_each(|(_, own)| *own = &state);
            self.judged(&given);
        }
    }
}

impl Remembering {
    fn n_of(&self, array: &str) -> usize {
        self.function.arrays.iter().find(|own| own.name == array).map_or(0, |own| own.numbers.len())
    }
}
