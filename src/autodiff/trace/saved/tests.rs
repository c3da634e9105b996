use super::*;
use crate::custom::CustomFunction;
use crate::example::Quadrotor;
use crate::native::tests::number;
use crate::{BLOCK, Mask, Program, Scalar, System, Trace, TraceMask};
use rng::{Purpose, Stream};
use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

/// (a, b) → (a b, a − c b), where c is its data.
struct Pair(f64);
impl CustomFunction for Pair {
    fn n_input(&self) -> usize {
        2
    }
    fn n_output(&self) -> usize {
        2
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(&[x[0] * x[1], x[0] - self.0 * x[1]]);
    }
    fn forward(&self, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.copy_from_slice(&[x[1] * dx[0] + x[0] * dx[1], dx[0] - self.0 * dx[1]]);
    }
    fn reverse(&self, x: &[f64], y: &[f64], x_bar: &mut [f64]) {
        x_bar.copy_from_slice(&[x[1] * y[0] + y[1], x[0] * y[0] - self.0 * y[1]]);
    }
    fn saved(&self) -> Option<SavedFunction> {
        Some(SavedFunction { name: "pair".into(), data: self.0.to_le_bytes().into() })
    }
}

/// Without a name.
struct Nameless;
impl CustomFunction for Nameless {
    fn n_input(&self) -> usize {
        1
    }
    fn n_output(&self) -> usize {
        1
    }
    fn value(&self, x: &[f64], y: &mut [f64]) {
        y.copy_from_slice(x);
    }
    fn forward(&self, _: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.copy_from_slice(dx);
    }
    fn reverse(&self, _: &[f64], y: &[f64], x_bar: &mut [f64]) {
        x_bar.copy_from_slice(y);
    }
}

/// A caller's table: these two, whoever asks for them.
struct Table([Operation; 2]);

impl Table {
    fn new() -> Self {
        Self([1.0, 0.5].map(|c| Operation::new(Pair(c))))
    }

    fn find(&self, name: &str, data: &[u8]) -> Result<Operation> {
        let unknown = || Error::Unknown { kind: "operation", name: name.into(), known: vec!["pair".into()] };
        let wanted = Some(SavedFunction { name: name.into(), data: data.into() });
        self.0.iter().find(|operation| operation.function().saved() == wanted).cloned().ok_or_else(unknown)
    }

    fn load(&self, bytes: &[u8]) -> Result<Recording> {
        self.load_within(bytes, &SavedLimits::default())
    }

    fn load_within(&self, bytes: &[u8], limits: &SavedLimits) -> Result<Recording> {
        Recording::from_bytes(bytes, &|name, data| self.find(name, data), limits)
    }
}

/// Every kind of node at top level, functions in functions, custom operations in both.
fn everything(x: &[Trace], table: &Table) -> Vec<Trace> {
    let c = Trace::constant;
    let (a, b, d) = (x[0], x[1], x[2]);
    let (sine, cosine) = a.sin_cos();
    let is_less = a.lt(b);
    let mask = is_less.and(d.lt(a).not()).or(b.lt(d));
    let mut called = [a; 2];
    table.0[0].call(&[sine, d], &mut called);
    let long = |from: Trace, by: Trace| {
        let mut y = [from, by];
        Trace::function(&mut y, |y| {
            for k in 0..6 {
                y[0] = y[0].mul_add(y[1], c(0.25 * f64::from(k))).tanh();
                y[1] = Trace::select(mask, y[0], y[1] * cosine);
            }
            let mut inner = [y[0]; 2];
            table.0[1].call(&[y[1], b], &mut inner);
            y[0] = inner[1];
        });
        y[0] - y[1]
    };
    let mut outer = [called[0], called[1], c(f64::INFINITY)];
    Trace::function(&mut outer, |y| {
        y[0] = long(y[0], d) + long(y[1], a);
        y[1] = y[0].min(y[2]).atan2(y[1]);
        for _ in 0..10 {
            y[1] = y[1].exp().detach().ln() + y[0];
        }
    });
    vec![
        long(a, b) / long(d, outer[0]),
        outer[1].sqrt().recip() + (-b).mul_add(d, called[1]),
        Trace::select(mask, a.atan2(b.detach()), b.exp().ln()),
        mask.as_number(),
        Trace::select(TraceMask::of_number(d), c(-0.0), a.tanh()),
        outer[2],
    ]
}

/// Random operations on the last few numbers, parts of them functions.
fn random(seed: u64, x: &[Trace], table: &Table) -> Vec<Trace> {
    fn grow(r: &mut Stream, values: &mut Vec<Trace>, table: &Table, depth: u32) {
        for _ in 0..8 + r.below(12) {
            let n = values.len() as u64;
            let [a, b, d] = [(); 3].map(|()| values[(n - 1 - r.below(n.min(9))) as usize]);
            values.push(match r.below(17) {
                0 | 1 if depth > 0 => {
                    let (mut inner, part) = (values[values.len() - 3..].to_vec(), r.below(3));
                    let mut y = [a, b];
                    Trace::function(&mut y, |y| {
                        grow(&mut Stream::new(4, part, depth.into(), Purpose::user(4)), &mut inner, table, depth - 1);
                        y.copy_from_slice(&inner[inner.len() - 2..]);
                    });
                    y[0] + y[1]
                }
                2 => {
                    let mut y = [a; 2];
                    table.0[r.below(2) as usize].call(&[b, d], &mut y);
                    y[0] * y[1]
                }
                3 => Trace::select(a.lt(b).or(b.lt(d)).and(d.lt(a).not()), a, d),
                4 => a.sin_cos().0 * b.sin_cos().1,
                5 => a.mul_add(b, d),
                6 => a / b,
                7 => a - b,
                8 => -a,
                9 => a.sqrt().recip(),
                10 => a.exp(),
                11 => a.ln(),
                12 => a.atan2(b),
                13 => a.detach().tanh(),
                14 => a + Trace::constant(r.uniform(-2.0, 2.0)),
                15 => a.max(b).min(Trace::constant(f64::INFINITY)),
                _ => a * b,
            });
        }
    }
    let mut values = x.to_vec();
    grow(&mut Stream::new(3, seed, 0, Purpose::user(3)), &mut values, table, 2);
    values[values.len() - 4..].to_vec()
}

fn written(table: &Table) -> Recording {
    Recording::as_written(3, |x| everything(x, table))
}

/// Kernels that files are made of.
fn kernels(table: &Table) -> Vec<Recording> {
    let quadrotor = Quadrotor { is_loaded: true };
    let step = Recording::as_written(27, |x| {
        let mut next = x[..23].to_vec();
        quadrotor.step(&x[..23], &x[23..], &[], &mut next);
        next
    });
    let empty = Recording::as_written(0, |_| Vec::new());
    let mut kernels = vec![empty, step, written(table)];
    kernels.extend((0..40).map(|seed| Recording::as_written(3, |x| random(seed, x, table))));
    kernels
}

/// With those of functions.
fn all_nodes(recording: &Recording) -> Vec<Node> {
    let of_call = |call: &Call| match &call.callee {
        Callee::Custom(_) => Vec::new(),
        Callee::Function(function) => all_nodes(function.recording()),
    };
    recording.nodes.iter().copied().chain(recording.calls.iter().flat_map(of_call)).collect()
}

#[test]
fn what_is_loaded_is_what_was_saved_nodes_calls_functions_and_all() {
    let table = Table::new();
    let forms: HashSet<_> = all_nodes(&written(&table)).iter().map(discriminant).collect();
    assert!(FORMS.iter().all(|form| forms.contains(&discriminant(form))), "a kind of node is in no test");
    let mut n_function = 0;
    for (k, recording) in kernels(&table).iter().enumerate() {
        let bytes = recording.to_bytes().unwrap();
        let loaded = table.load(&bytes).unwrap();
        assert_eq!(loaded, *recording, "kernel {k}");
        assert_eq!(loaded.to_bytes().unwrap(), bytes, "kernel {k}");
        n_function += usize::from(recording.has_functions());
    }
    assert!(n_function > 20, "{n_function} kernels with functions");
}

#[test]
fn a_recording_that_another_thread_loaded_is_the_same() {
    let table = Table::new();
    let recording = written(&table);
    let bytes = recording.to_bytes().unwrap();
    // nobody there knows the functions
    let elsewhere = std::thread::scope(|scope| scope.spawn(|| table.load(&bytes).unwrap()).join().unwrap());
    assert_eq!(elsewhere, recording);
    assert_eq!(elsewhere.to_bytes().unwrap(), bytes);
}

#[test]
fn the_format_is_that_of_version_1() {
    // FNV-1a; whoever changes the format counts the version up
    let bytes = written(&Table::new()).to_bytes().unwrap();
    let hash =
        bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01B3));
    assert_eq!((bytes.len(), format!("{hash:016x}")), (618, "7c44ecf9ec30c7ee".into()));
}

#[test]
fn functions_and_operations_are_saved_once_and_small() {
    let table = Table::new();
    let calls = |n: usize| {
        Recording::as_written(2, |x| {
            let mut y = x.to_vec();
            for _ in 0..n {
                // an equal operation of its own each time
                Operation::new(Pair(1.0)).call(&y.clone(), &mut y);
                Trace::function(&mut y, |y| (0..20).for_each(|_| y[0] = (y[0] * y[1]).tanh()));
            }
            y
        })
    };
    let [few, many] = [1, 1001].map(|n| calls(n).to_bytes().unwrap());
    assert_eq!(many[HEAD.len()], 2, "callees");
    assert_eq!(many.len() - few.len(), 8 * 1000 + 1, "bytes of a thousand calls of either");
    assert_eq!(table.load(&many).unwrap().to_bytes().unwrap(), many);
}

#[test]
fn what_cannot_be_saved_is_named() {
    let message = |recording: &Recording| recording.to_bytes().unwrap_err().to_string();
    let folded = message(&Recording::of(1, |x| x.to_vec()));
    assert!(folded.contains("a recording to be saved is folded") && folded.contains("as_written"), "{folded}");
    let nan = message(&Recording::as_written(1, |x| vec![x[0] + Trace::constant(f64::NAN)]));
    assert!(nan.contains("the constant of node 1 is NaN"), "{nan}");
    let nameless = message(&Recording::as_written(1, |x| {
        let mut y = [x[0] * x[0]];
        Operation::new(Nameless).call(&[y[0]], &mut y);
        y.to_vec()
    }));
    assert!(nameless.contains("node 2 is one of 1 inputs and 1 results that has no name"), "{nameless}");
    assert!(nameless.contains("Implement `CustomFunction::saved`"), "{nameless}");
}

#[test]
fn inputs_that_joined_later_are_loaded_where_the_limits_say_so() {
    let recording = Recording::as_written(2, |x| vec![x[0] + x[1] * Trace::input(6)]);
    let (bytes, table) = (recording.to_bytes().unwrap(), Table::new());
    let within = |n_late_input| table.load_within(&bytes, &SavedLimits { n_late_input, ..SavedLimits::default() });
    assert_eq!(within(7).unwrap(), recording);
    for n in [0, 6] {
        let message = within(n).unwrap_err().to_string();
        assert!(message.contains("there is no input 6 of 2"), "{message}");
    }
}

#[test]
fn truths_and_numbers_stand_for_each_other_as_in_a_walk() {
    let table = Table::new();
    // either way round: a sum of truths, a choice and a negation of numbers
    let recording = Recording::as_written(2, |x| {
        let truth = x[0].lt(x[1]);
        let chosen = Trace::select(TraceMask::of_number(x[0]), x[0], x[1]);
        vec![truth.as_number() + truth.as_number(), chosen, TraceMask::of_number(x[1]).not().as_number()]
    });
    let loaded = table.load(&recording.to_bytes().unwrap()).unwrap();
    let mut y = [0.0; 3];
    loaded.evaluate(&[0.3, 0.7], &mut y);
    assert_eq!(y, [2.0, 0.7, 0.0]);
    let program = Program::compile(&Recording::of(2, |x| walked(&loaded, x))).unwrap();
    program.evaluate(&mut program.workspace(), &[0.3, 0.7], &mut y);
    assert_eq!(y, [2.0, 0.7, 0.0]);
}

/// A file of callees and a body, each given by its bytes.
fn file(callees: &[&[u8]], body: &[u8]) -> Vec<u8> {
    [HEAD, &[callees.len() as u8][..], &callees.concat(), body].concat()
}

#[test]
fn every_wrong_file_is_refused_with_place_rule_and_remedy() {
    let table = Table::new();
    let (input, constant, call, add) = (0, 1, 2, 3);
    let one = 1f64.to_le_bytes();
    let [c0, c1, c2, c3, c4, c5, c6, c7] = one;
    let pair = |n: u8, m: u8| [&[0, 4][..], b"pair", &[8], &one, &[n, m]].concat();
    let function = [1, 1, 2, input, 0, 7, 1, 1, 1]; // −x
    let good = file(&[&pair(2, 2), &function], &[1, 3, input, 0, call, 0, 1, 1, call, 1, 1, 2, 1, 4]);
    assert_eq!(table.load(&good).unwrap().n_node(), 6);
    let wrong: &[(Vec<u8>, &str)] = &[
        (Vec::new(), "8 bytes should follow, and 0 do"),
        (b"omnirex\x01\0\0\0\0".to_vec(), "does not begin as a saved recording"),
        (b"omnirec\x02\0\0\0\0".to_vec(), "version 2 of the format, and this reads 1"),
        (file(&[], &[0, 0, 0, 0]), "bytes follow behind the end"),
        (file(&[], &[1, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F]), "4294967295 nodes should follow in 0 bytes"),
        (file(&[], &[1, 0xFF, 0xFF, 0xFF, 0xFF, 0x1F]), "a number of more than 32 bits"),
        (file(&[], &[1, 0x80, 0x80, 0x80, 0x80, 0x80, 0]), "a number of more than 32 bits"),
        (file(&[], &[1, 1, input, 0, 9]), "9 results should follow in 0 bytes"),
        (file(&[], &[1, 1, input, 1, 1, 1]), "there is no input 1 of 1"),
        (file(&[], &[1, 1, 23, 1, 1, 1]), "no node has the form 23"),
        (file(&[], &[1, 2, input, 0, add, 1, 2, 1, 1]), "nothing to read stands 2 before node 1"),
        (file(&[], &[1, 2, input, 0, add, 1, 0, 1, 1]), "nothing to read stands 0 before node 1"),
        (file(&[], &[1, 1, input, 0, 1, 0]), "nothing to read stands 0 before node 1"),
        (file(&[], &[1, 1, input, 0, 1, 2]), "nothing to read stands 2 before node 1"),
        (file(&[], &[0, 1, constant, 0, 0, 0, 0, 0, 0, 0xF8, 0x7F, 1, 1]), "a constant is NaN"),
        (file(&[], &[0, 1, constant, 0, 0]), "8 bytes should follow, and 2 do"),
        (file(&[], &[1, 2, input, 0, call, 0, 1, 1, 0]), "nothing that is called has number 0"),
        // of a call itself, and of more operands than there are
        (file(&[&pair(2, 2)], &[1, 2, input, 0, call, 0, 1, 1, 1, 3]), "nothing to read stands 3 before node 4"),
        (file(&[&pair(2, 2)], &[1, 2, input, 0, call, 0, 1]), "1 bytes should follow, and 0 do"),
        // itself, and what comes later
        (file(&[&[1, 1, 2, input, 0, call, 0, 1, 1, 1]], &[0, 0, 0]), "nothing that is called has number 0"),
        (file(&[&[1, 1, 2, input, 0, call, 1, 1, 1, 1], &function], &[0, 0, 0]), "nothing that is called has number 1"),
        (file(&[&[2]], &[0, 0, 0]), "a callee is an operation (0) or a function (1), and not 2"),
        (
            file(&[&pair(2, 1)], &[0, 0, 0]),
            "operation pair has 2 inputs and 2 results, and here 2 inputs and 1 results",
        ),
        (file(&[&[0, 2, 0xFF, 0xFF, 0, 1, 1]], &[0, 0, 0]), "the name of an operation is no text"),
        (file(&[&[0, 4, b'p', b'a']], &[]), "4 bytes of a name should follow in 2 bytes"),
        (file(&[&[0, 1, b'x', 8, c0, c1, c2, c3, c4, c5, c6, c7, 2, 2]], &[0, 0, 0]), "no operation is called 'x'"),
    ];
    for (bytes, rule) in wrong {
        let message = table.load(bytes).unwrap_err().to_string();
        assert!(message.contains(rule), "{bytes:?}: {message}, not {rule}");
        assert!(message.contains("Record and save it again") || message.contains("Known: pair"), "{message}");
    }
    for end in 0..good.len() {
        assert!(table.load(&good[..end]).is_err(), "of its first {end} bytes");
    }
}

#[test]
fn every_limit_is_held_before_more_is_made() {
    let table = Table::new();
    let bytes = written(&table).to_bytes().unwrap();
    let all = || SavedLimits { n_input: 20, n_output: 20, n_node: 400, n_operation: 1000, depth: 2, n_late_input: 0 };
    table.load_within(&bytes, &all()).unwrap();
    for (limits, what) in [
        (SavedLimits { n_input: 2, ..all() }, "number of inputs"),
        (SavedLimits { n_output: 1, ..all() }, "number of results"),
        (SavedLimits { n_node: 60, ..all() }, "number of nodes"),
        (SavedLimits { n_operation: 150, ..all() }, "number of operations"),
        (SavedLimits { depth: 1, ..all() }, "depth of functions"),
    ] {
        let error = table.load_within(&bytes, &limits).unwrap_err();
        assert!(error.is_limit() && error.to_string().contains(what), "{error}");
    }
}

/// 10ᵏ operations in some 30 k bytes, more than any number counts from the 20th on.
fn chain(n: u8, n_call: usize) -> Vec<u8> {
    let first: &[u8] = &[1, 1, 2, 0, 0, 7, 1, 1, 1];
    let next = |k: u8| [&[1, 1, 1 + n_call as u8, 0, 0][..], &[2, k, 1].repeat(n_call), &[1, 1]].concat();
    let callees: Vec<Vec<u8>> = std::iter::once(first.to_vec()).chain((0..n).map(next)).collect();
    file(&callees.iter().map(Vec::as_slice).collect::<Vec<_>>(), &[1, 2, 0, 0, 2, n, 1, 1, 1])
}

#[test]
fn functions_as_deep_as_the_limit_take_little_stack() {
    let most = SavedLimits::default().depth as u8;
    let run = move || {
        let loaded = Table::new().load(&chain(most - 1, 1)).unwrap();
        assert_eq!(walked(&loaded, &[3.0]), [-3.0]);
        assert_eq!(
            Recording::of(1, |x| walked(&loaded, x)).n_node(),
            3,
            "an input, its negative and the zero of `walked`"
        );
    };
    std::thread::Builder::new().stack_size(1 << 19).spawn(run).unwrap().join().unwrap();
    let error = Table::new().load(&chain(most, 1)).unwrap_err().to_string();
    assert!(error.contains("depth of functions of a saved recording is 17, over the limit of 16"), "{error}");
}

#[test]
fn functions_that_call_each_other_ten_times_are_counted_as_often_as_they_are_called() {
    let table = Table::new();
    let limits = SavedLimits { depth: 100, ..SavedLimits::default() };
    let loaded = table.load_within(&chain(4, 10), &limits).unwrap();
    let mut y = [0.0];
    loaded.evaluate(&[3.0], &mut y);
    assert_eq!(y, [3.0], "negated ten thousand times");
    let start = Instant::now();
    for n in [7, 30, 90] {
        let error = table.load_within(&chain(n, 10), &limits).unwrap_err();
        assert!(error.is_limit() && error.to_string().contains("number of operations"), "{error}");
    }
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
}

fn walked<S: Scalar>(recording: &Recording, x: &[S]) -> Vec<S> {
    let mut y = vec![S::zero(); recording.n_output()];
    recording.evaluate(x, &mut y);
    y
}

fn mutated(r: &mut Stream, files: &[Vec<u8>]) -> Vec<u8> {
    let any = |r: &mut Stream| &files[r.below(files.len() as u64) as usize];
    let mut bytes = any(r).clone();
    // most one change: more are seldom accepted
    for _ in 0..=r.below(6) / 4 {
        // what begins otherwise is refused at once
        let first = if r.below(50) == 0 { 0 } else { HEAD.len().min(bytes.len()) };
        let at = first + r.below((bytes.len() - first) as u64 + 1) as usize;
        let end = (at + 1 + r.below(8) as usize).min(bytes.len());
        match r.below(16) {
            0 => bytes.truncate(at),
            1 => drop(bytes.splice(at..end, [])),
            2 => bytes.insert(at, r.below(256) as u8),
            3 => drop(bytes.splice(at..end.min(at + 1), [0xFF, 0xFF, 0xFF, 0xFF, 0x0F])),
            4 => {
                let other = any(r);
                let from = r.below(other.len() as u64) as usize;
                let to = (from + 1 + r.below(40) as usize).min(other.len());
                drop(bytes.splice(at..end.min(at + to - from), other[from..to].iter().copied()));
            }
            kind => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = match kind {
                        5..8 => *byte ^ 1 << r.below(8),
                        8 => r.below(24) as u8,
                        9..12 => 1 + r.below(9) as u8,
                        12 | 13 => byte.wrapping_add(1),
                        _ => byte.wrapping_sub(1),
                    };
                }
            }
        }
    }
    bytes
}

/// All that is done with recordings.
fn make_everything_of(recording: &Recording, table: &Table, limits: &SavedLimits, r: &mut Stream) {
    let n = recording.n_input();
    assert!(recording.n_operation() <= limits.n_operation);
    assert_eq!(table.load_within(&recording.to_bytes().unwrap(), limits).unwrap(), *recording);
    let x: Vec<f64> = (0..n).map(|_| number(r)).collect();
    walked(recording, &x);
    // nobody should compile it itself
    let program = Program::compile(recording).unwrap();
    program.evaluate(&mut program.interpreter_workspace(), &x, &mut vec![0.0; recording.n_output()]);
    let program = Program::compile(&Recording::of(n, |x| walked(recording, x))).unwrap();
    let mut y = vec![0.0; program.n_output()];
    program.evaluate(&mut program.interpreter_workspace(), &x, &mut y);
    let lanes = Program::compile(&Recording::of_lanes(n, |x| walked(recording, x))).unwrap();
    let (x, mut y) = (vec![[x.first().map_or(0.0, |x| *x as f32); BLOCK]; n], vec![[0.0; BLOCK]; y.len()]);
    lanes.evaluate_block(&mut lanes.interpreter_block_workspace(), &x, &mut y);
    // code is made of few: it takes a page each
    if r.below(16) == 0 {
        lanes.evaluate_block(&mut lanes.block_workspace(), &x, &mut y);
    }
}

fn mutants(count: u64, seed: u64) {
    let table = Table::new();
    let files: Vec<Vec<u8>> = kernels(&table).iter().map(|recording| recording.to_bytes().unwrap()).collect();
    let limits =
        SavedLimits { n_input: 64, n_output: 64, n_node: 4_000, n_operation: 20_000, depth: 6, n_late_input: 0 };
    let (mut accepted, mut refused, mut slowest) = (0, [0; 3], Duration::ZERO);
    for case in 0..count {
        let r = &mut Stream::new(seed, case, 0, Purpose::user(5));
        let bytes = mutated(r, &files);
        let place = format!("FUZZ_SEED={seed}, case {case}");
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            let recording = table.load_within(&bytes, &limits)?;
            make_everything_of(&recording, &table, &limits, r);
            Ok::<(), Error>(())
        }));
        match outcome {
            Err(_) => panic!("{place}: panic"),
            Ok(Ok(())) => accepted += 1,
            Ok(Err(error)) => match (error.is_format(), error.is_limit(), error.is_unknown_name()) {
                (true, ..) => refused[0] += 1,
                (_, true, _) => refused[1] += 1,
                (.., true) => refused[2] += 1,
                _ => panic!("{place}: {error}"),
            },
        }
        slowest = slowest.max(start.elapsed());
    }
    println!("{accepted} of {count} accepted, slowest {slowest:?}; refused: {refused:?} (format, limit, unknown)");
    assert!(accepted > count / 10 && refused.iter().all(|n| *n > 0), "{accepted} accepted, refused {refused:?}");
    assert!(slowest < Duration::from_secs(5), "{slowest:?}");
}

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |n| n.parse().unwrap())
}

#[test]
fn ten_thousand_mutated_recordings_are_refused_or_do_no_harm() {
    mutants(10_000, from_environment("FUZZ_SEED", 20_260_103));
}

#[test]
#[ignore = "FUZZ_N=1000000 cargo test --release -p omnidrones-autodiff --lib mutated_recordings -- --ignored --nocapture"]
fn a_million_mutated_recordings_are_refused_or_do_no_harm() {
    mutants(from_environment("FUZZ_N", 1_000_000), from_environment("FUZZ_SEED", 1));
}
