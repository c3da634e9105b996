use super::super::trace::Trace;
use super::*;
use crate::Mask;
use crate::columns::LINE;
use crate::jet::Jet;
use crate::lanes::{InstructionSet, instruction_set, with_set};
use nalgebra::Const;
use num_dual::{Derivative, Dual64, DualSVec64, HyperDual64};
use rng::{Purpose, Stream};

fn compiled(n_input: usize, f: impl FnOnce(&[Trace]) -> Vec<Trace>) -> (Recording, Program) {
    let recording = Recording::of(n_input, f);
    let program = Program::compile(&recording).unwrap();
    (recording, program)
}

fn run_f64(program: &Program, inputs: &[f64]) -> Vec<f64> {
    let mut outputs = vec![f64::NAN; program.n_output()];
    program.evaluate(&mut program.workspace(), inputs, &mut outputs);
    outputs
}

fn ops(program: &Program) -> Vec<Op> {
    {
        let op = |i: &Instruction| if let InstructionKind::Op(op, _) = i.action { Some(op) } else { None };
        program.value_form().instructions().iter().filter_map(op).collect()
    }
}

#[test]
fn constants_are_folded_while_they_are_recorded() {
    let c = Trace::constant;
    let (_, program) = compiled(1, |z| {
        let two = c(0.5).mul_add(c(2.0), c(1.0));
        let (sine, cosine) = c(0.3).sin_cos();
        let unit = sine * sine + cosine * cosine;
        let folded = (two.sqrt() * c(4.0).recip()).exp().ln() + c(1.0).atan2(c(2.0)) - c(0.1).tanh();
        let picked = Trace::select(c(1.0).lt(c(2.0)), folded, z[0]);
        vec![picked + unit, z[0] * c(0.0), z[0] + c(0.0), z[0] * c(1.0), z[0] - c(0.0), z[0] / c(1.0), -(-z[0])]
    });
    assert!(program.is_empty(), "{:?}", ops(&program));
    let folded = (2.0_f64.sqrt() * 0.25).exp().ln() + 1.0_f64.atan2(2.0) - 0.1_f64.tanh();
    let unit = 0.3_f64.sin() * 0.3_f64.sin() + 0.3_f64.cos() * 0.3_f64.cos();
    assert_eq!(run_f64(&program, &[7.0]), [folded + unit, 0.0, 7.0, 7.0, 7.0, 7.0, 7.0]);
}

#[test]
fn equal_expressions_are_computed_once() {
    let (_, shared) = compiled(2, |z| vec![(z[0] + z[1]).sqrt() * z[0], (z[1] + z[0]).sqrt() / z[1]]);
    assert_eq!(ops(&shared), [Op::Add, Op::Sqrt, Op::Mul, Op::Div]);
    let (_, different) = compiled(2, |z| vec![(z[0] + z[1]).sqrt() * z[0], (z[1] - z[0]).sqrt() / z[1]]);
    assert_eq!(different.len(), 6, "the twin: different sums are not shared");
}

#[test]
fn what_no_result_needs_is_dropped() {
    let (recording, program) = compiled(3, |z| {
        let dead = (z[0] * z[1]).exp() / z[2].tanh();
        let _ = dead.sin_cos();
        vec![z[0] - z[1]]
    });
    assert!(recording.nodes.len() > 8);
    assert_eq!(ops(&program), [Op::Sub]);
    assert_eq!(
        (program.interpreter().body.inputs.len(), program.n_slot()),
        (2, 2),
        "not even the third input is loaded"
    );
    assert_eq!(run_f64(&program, &[5.0, 3.0, f64::NAN]), [2.0]);
}

#[test]
fn a_product_read_by_one_sum_is_fused_into_it_and_one_read_twice_is_not() {
    let (_, sum) = compiled(3, |z| vec![z[0] * z[1] + z[2]]);
    let (_, from) = compiled(3, |z| vec![z[2] - z[0] * z[1]]);
    let (_, less) = compiled(3, |z| vec![z[0] * z[1] - z[2]]);
    assert_eq!((ops(&sum), ops(&from), ops(&less)), (vec![Op::MulAdd], vec![Op::NegMulAdd], vec![Op::MulSub]));
    for (program, want) in [(&sum, 11.0), (&from, -1.0), (&less, 1.0)] {
        assert_eq!(run_f64(program, &[2.0, 3.0, 5.0]), [want]);
    }
    let (_, shared) = compiled(3, |z| {
        let product = z[0] * z[1];
        vec![product + z[2], product]
    });
    assert_eq!(ops(&shared), [Op::Mul, Op::Add]);
    let (_, doubled) = compiled(2, |z| {
        let product = z[0] * z[1];
        vec![product + product]
    });
    assert_eq!((ops(&doubled), run_f64(&doubled, &[2.0, 3.0])), (vec![Op::Mul, Op::Add], vec![12.0]));
    let (_, both) = compiled(4, |z| vec![z[0] * z[1] + z[2] * z[3]]);
    assert_eq!((ops(&both), run_f64(&both, &[2.0, 3.0, 5.0, 7.0])), (vec![Op::TwoProducts], vec![41.0]));
    let (_, difference) = compiled(4, |z| vec![z[0] * z[1] - z[2] * z[3]]);
    let value = run_f64(&difference, &[2.0, 3.0, 5.0, 7.0]);
    assert_eq!((ops(&difference), value), (vec![Op::ProductDifference], vec![-29.0]));
    let (_, squared) = compiled(1, |z| vec![z[0] * z[0] + z[0]]);
    assert_eq!(run_f64(&squared, &[3.0]), [12.0]);
}

#[test]
fn a_comparison_read_by_one_selection_is_fused_into_it() {
    let (_, one) = compiled(3, |z| vec![Trace::select(z[0].lt(z[1]), z[2], z[0])]);
    assert_eq!(ops(&one), [Op::SelectLess]);
    let (_, two) = compiled(3, |z| {
        let mask = z[0].lt(z[1]);
        vec![Trace::select(mask, z[2], z[0]), Trace::select(mask.not(), z[2], z[1])]
    });
    assert_eq!(ops(&two), [Op::Less, Op::SelectLess, Op::Not, Op::Select]);
    assert_eq!(run_f64(&two, &[1.0, 2.0, 9.0]), [9.0, 2.0]);
    assert_eq!(run_f64(&two, &[2.0, 1.0, 9.0]), [2.0, 9.0]);
    assert_eq!(run_f64(&two, &[f64::NAN, 1.0, 9.0])[1], 9.0, "NaN is not less");
}

#[test]
fn sine_and_cosine_of_one_angle_are_one_instruction_also_alone_and_when_the_angle_dies_between() {
    let (s, c) = 1.1_f64.sin_cos();
    let (_, both) = compiled(1, |z| {
        let (s, c) = z[0].sin_cos();
        vec![s, c]
    });
    assert_eq!((ops(&both), run_f64(&both, &[1.1])), (vec![Op::SinCos], vec![s, c]));
    let (_, sine) = compiled(1, |z| vec![z[0].sin_cos().0]);
    assert_eq!((ops(&sine), run_f64(&sine, &[1.1])), (vec![Op::SinCos], vec![s]));
    let (_, cosine) = compiled(1, |z| vec![z[0].sin_cos().1]);
    assert_eq!((ops(&cosine), run_f64(&cosine, &[1.1])), (vec![Op::SinCos], vec![c]));

    // sine recorded, then slots come and go, then the cosine of the same angle is read
    let f = |z: &[Trace]| {
        let angle = z[0] + z[1];
        let sine = angle.sin_cos().0;
        let mut rest = sine.exp();
        for k in 0..5 {
            rest = (rest * z[1] + Trace::constant(f64::from(k))).tanh() + rest.sqrt();
        }
        vec![angle.sin_cos().1 * rest, rest, sine]
    };
    let (_, between) = compiled(2, f);
    assert_eq!(ops(&between).iter().filter(|op| **op == Op::SinCos).count(), 1);
    let (x, y) = (0.4_f64, 0.9_f64);
    let sine = (x + y).sin();
    let mut rest = sine.exp();
    for k in 0..5 {
        rest = (rest * y + f64::from(k)).tanh() + rest.sqrt();
    }
    assert_eq!(run_f64(&between, &[x, y]), [(x + y).cos() * rest, rest, sine]);
}

#[test]
fn slots_of_angles_are_given_back_so_a_long_chain_of_rotations_needs_few() {
    let (_, program) = compiled(1, |z| {
        let mut angle = z[0];
        for _ in 0..200 {
            let (s, c) = angle.sin_cos();
            angle = s - c;
        }
        vec![angle]
    });
    assert_eq!(program.len(), 400);
    assert!(program.n_slot() <= 4, "{}", program.n_slot()); // measured 3; 202 when angles were never given back
    let mut angle = 0.3_f64;
    for _ in 0..200 {
        angle = angle.sin() - angle.cos();
    }
    assert_eq!(run_f64(&program, &[0.3]), [angle]);
}

#[test]
fn a_workspace_used_before_gives_the_same_bits_again() {
    let (_, program) = compiled(3, |z| vec![(z[0] * z[1]).sin_cos().1 + z[2].exp(), z[0]]);
    let mut workspace = program.interpreter_workspace();
    let (mut first, mut other, mut again) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    program.evaluate(&mut workspace, &[0.1, 0.2, 0.3], &mut first);
    program.evaluate(&mut workspace, &[f64::NAN, f64::INFINITY, -3.0], &mut other);
    program.evaluate(&mut workspace, &[0.1, 0.2, 0.3], &mut again);
    assert_eq!(first, again);
}

#[test]
#[should_panic(expected = "slots of the program")]
fn a_workspace_with_too_few_slots_is_refused_not_folded_onto_itself() {
    let many = |z: &[Trace]| (0..5000).map(|k| z[0] + Trace::constant(f64::from(k) + 0.5)).collect();
    let (_, large) = compiled(1, many);
    let (_, small) = compiled(1, |z| vec![z[0] * z[0]]);
    let mut outputs = vec![0.0; large.n_output()];
    large.evaluate(&mut small.interpreter_workspace(), &[1.0], &mut outputs);
}

/// A random expression graph over any scalar: the same for every scalar and seed. Values stay within about [−4, 4].
///
/// `smooth` leaves out what has kinks.
fn random_graph<S: Scalar>(seed: u64, inputs: &[S], smooth: bool) -> Vec<S> {
    let mut r = Stream::new(60, seed, 0, Purpose::user(60));
    let mut values = inputs.to_vec();
    let size = 5 + r.below(60);
    let c = S::constant;
    for _ in 0..size {
        let mut pick = || values[r.below(values.len() as u64) as usize];
        let (x, y, z, w) = (pick(), pick(), pick(), pick());
        let number = c(r.uniform(-2.0, 2.0));
        let positive = |v: S| v * v + c(0.25);
        // halved and squashed where they could grow
        let new = match r.below(if smooth { 17 } else { 24 }) {
            0 => (x + y) * c(0.5),
            1 => (x - y) * c(0.5),
            2 => (x * y + z) * c(0.2),
            3 => (x - y * z) * c(0.2),
            4 => (x * y - z) * c(0.2),
            5 => x * positive(y).recip() * c(0.2),
            6 => (x / positive(y)) * c(0.2),
            7 => -x,
            8 => positive(x).sqrt(),
            9 => x.sin_cos().0,
            10 => x.sin_cos().1,
            11 => {
                let (s, k) = x.sin_cos();
                s * y * c(0.5) + k
            }
            12 => (x * c(0.25)).exp(),
            13 => positive(x).ln(),
            14 => x.tanh(),
            15 => x.atan2(positive(y)),
            16 => x * number * c(0.5) + number,
            17 => S::select(x.lt(y), z, w),
            18 => S::select(x.lt(y).and(z.lt(w)), z, w),
            19 => S::select(x.lt(y).or(z.lt(w).not()), x, w),
            20 => x.max(y),
            21 => x.min(y).abs(),
            22 => x.clamp(c(-1.0), number.abs()),
            _ => {
                let mask = x.lt(number);
                S::select(mask, y, z) * c(0.5) - S::select(mask.not(), w, z) * c(0.5)
            }
        };
        values.push(new);
    }
    let n = values.len();
    let mut results: Vec<S> = values[n - 3..].to_vec();
    results.push(values[inputs.len() + r.below(size) as usize]);
    results.push(values[r.below(n as u64) as usize]);
    results
}

const GRAPHS: u64 = 2000;
const INPUTS: usize = 5;

fn random_inputs(seed: u64) -> Vec<f64> {
    let mut r = Stream::new(61, seed, 0, Purpose::user(61));
    (0..INPUTS).map(|_| r.uniform(-2.0, 2.0)).collect()
}

#[test]
fn a_thousand_random_graphs_and_more_compute_the_bits_of_direct_evaluation() {
    let mut seen = std::collections::HashSet::new();
    for seed in 0..GRAPHS {
        let (_, program) = compiled(INPUTS, |z| random_graph(seed, z, false));
        seen.extend(ops(&program).into_iter().map(|op| op as u8));
        let mut workspace = program.workspace();
        let mut got = vec![0.0; program.n_output()];
        for k in 0..3 {
            let inputs = random_inputs(3 * seed + k);
            program.evaluate(&mut workspace, &inputs, &mut got);
            let want = random_graph(seed, &inputs, false);
            assert_eq!(got, want, "graph {seed}, inputs {k}");
        }
    }
    assert_eq!(seen.len(), 23, "every instruction must occur");
}

#[test]
fn a_thousand_random_graphs_and_more_compute_the_same_in_blocks_of_lanes() {
    let mut worst = 0.0_f64;
    for seed in 0..GRAPHS {
        // smooth ones: rounding may fall on the other side of a comparison
        let (_, program) = compiled(INPUTS, |z| random_graph(seed, z, true));
        let mut inputs = vec![[0.0_f32; BLOCK]; INPUTS];
        for lane in 0..BLOCK {
            for (row, x) in inputs.iter_mut().zip(random_inputs(1000 * seed + lane as u64)) {
                row[lane] = x as f32;
            }
        }
        let mut outputs = vec![[0.0; BLOCK]; program.n_output()];
        program.evaluate_block(&mut program.block_workspace(), &inputs, &mut outputs);
        for lane in [0, 1, 17, 62, 63] {
            let x: Vec<f64> = inputs.iter().map(|row| f64::from(row[lane])).collect();
            for (row, want) in outputs.iter().zip(random_graph(seed, &x, true)) {
                let error = (f64::from(row[lane]) - want).abs() / want.abs().max(1.0);
                worst = worst.max(error);
                assert!(error <= 1e-4, "graph {seed}, lane {lane}: {error:e}");
            }
        }
    }
    println!("lanes against f64: {worst:.1e}"); // measured 3.1e-7
}

#[test]
fn the_block_evaluator_runs_comparisons_and_masks_like_scalar_f32() {
    for seed in 0..GRAPHS {
        let (_, program) = compiled(INPUTS, |z| {
            let masks = [z[0].lt(z[1]), z[1].lt(z[2]).not(), z[3].lt(z[4])];
            let pick = masks[(seed % 3) as usize].and(masks[0].or(masks[2]));
            vec![Trace::select(pick, z[3], z[4]), z[0].max(z[1]).min(z[2]), Trace::select(masks[1], z[0], z[2])]
        });
        let x: Vec<f32> = random_inputs(seed).iter().map(|x| *x as f32).collect();
        let inputs: Vec<_> = x.iter().map(|x| [*x; BLOCK]).collect();
        let mut outputs = vec![[0.0; BLOCK]; 3];
        program.evaluate_block(&mut program.block_workspace(), &inputs, &mut outputs);
        let masks = [x[0] < x[1], x[1] >= x[2], x[3] < x[4]];
        let pick = masks[(seed % 3) as usize] && (masks[0] || masks[2]);
        let want = [
            if pick { x[3] } else { x[4] },
            Scalar::min(Scalar::max(x[0], x[1]), x[2]),
            if masks[1] { x[0] } else { x[2] },
        ];
        for (row, want) in outputs.iter().zip(want) {
            assert_eq!(*row, [want; BLOCK], "seed {seed}");
        }
    }
}

#[test]
fn the_adjoint_of_random_smooth_graphs_is_their_dual_gradient() {
    let mut worst = 0.0_f64;
    for seed in 0..GRAPHS {
        let recording = Recording::of(INPUTS, |z| random_graph(seed, z, true));
        let adjoint = Program::compile(&recording.adjoint(0..INPUTS)).unwrap();
        let x = random_inputs(seed);
        let seeds: Vec<f64> = (0..recording.n_output()).map(|k| (1.0 + k as f64).cos()).collect();
        let got = run_f64(&adjoint, &[&x[..], &seeds].concat());
        for k in 0..INPUTS {
            let lifted: Vec<Dual64> =
                x.iter().enumerate().map(|(i, v)| Dual64::new(*v, if i == k { 1.0 } else { 0.0 })).collect();
            let want: f64 = random_graph(seed, &lifted, true).iter().zip(&seeds).map(|(y, s)| y.eps * s).sum();
            let error = (got[k] - want).abs() / want.abs().max(1.0);
            worst = worst.max(error);
            assert!(error <= 1e-11, "graph {seed}, input {k}: {error:e}");
        }
    }
    println!("adjoint against duals: {worst:.1e}"); // measured 8.5e-16
}

#[test]
fn programs_without_calls_have_the_instructions_and_slots_they_had_before_there_were_calls() {
    let (mut forward, mut backward, mut slots) = (0, 0, 0);
    for seed in 0..GRAPHS {
        let (recording, program) = compiled(INPUTS, |z| random_graph(seed, z, false));
        let adjoint = Program::compile(&recording.adjoint(0..INPUTS)).unwrap();
        forward += program.len();
        backward += adjoint.len();
        slots += program.n_slot() + adjoint.n_slot();
    }
    assert_eq!((forward, backward, slots), (75_461, 172_623, 100_382)); // counted before there were calls; sixteen masks less since constant ones are folded
}

/// √a by Newton's iteration on detached numbers, made differentiable by one live step.
fn implicit_root<S: Scalar>(a: S) -> S {
    let step = |y: S, a: S| y - (y.square() - a) * (y + y).detach().recip();
    let mut y = S::one();
    for _ in 0..8 {
        y = step(y, a.detach());
    }
    step(y.detach(), a)
}

#[test]
fn a_detached_number_has_its_value_and_no_derivative_in_every_scalar() {
    fn f<S: Scalar>(x: S) -> S {
        x.detach() * x + (x * x).detach().exp()
    }
    let (x, value) = (0.7, 0.7 * 0.7 + (0.7_f64 * 0.7).exp());
    assert_eq!((f(x), f(x as f32)), (value, (x as f32) * (x as f32) + ((x as f32) * (x as f32)).exp()));
    let dual = f(Dual64::new(x, 1.0));
    assert_eq!((dual.re, dual.eps), (value, x));
    let wide = f(DualSVec64::<2>::new(x, Derivative::some([1.0, 3.0].into())));
    assert_eq!((wide.re, wide.eps.unwrap_generic(Const::<2>, Const::<1>)), (value, [x, 3.0 * x].into()));
    let hyper = f(HyperDual64::new(x, 1.0, 2.0, 5.0));
    assert_eq!((hyper.re, hyper.eps1, hyper.eps2, hyper.eps1eps2), (value, x, 2.0 * x, 5.0 * x));
    let jet = f(Jet::<f64, 4> { coefficients: [x, 1.0, 2.0, 3.0] });
    assert_eq!(jet.coefficients, [value, x, 2.0 * x, 3.0 * x]);
    let within = Jet::<Dual64, 2>::variable(Dual64::new(x, 1.0)).detach();
    assert_eq!(within.coefficients, [Dual64::from(x), Dual64::from(0.0)], "inner derivatives too");

    let (recording, program) = compiled(1, |z| vec![f(z[0])]);
    assert_eq!(run_f64(&program, &[x]), [value]);
    let adjoint = Program::compile(&recording.adjoint(0..1)).unwrap();
    assert_eq!(run_f64(&adjoint, &[x, 1.0]), [x]);
    let jacobian = Program::compile(&recording.jacobian(0..1)).unwrap();
    assert_eq!(run_f64(&jacobian, &[x]), [x]);
}

#[test]
fn a_detached_number_costs_nothing_once_compiled() {
    let (recording, program) = compiled(2, |z| vec![z[0].detach() * z[1] + (z[0] * z[1]).detach().tanh()]);
    let (_, plain) = compiled(2, |z| vec![z[0] * z[1] + (z[0] * z[1]).tanh()]);
    assert_eq!(ops(&program), ops(&plain), "and what it hid is shared");
    assert_eq!(ops(&program), [Op::Mul, Op::Tanh, Op::Add]);
    let adjoint = Program::compile(&recording.adjoint(0..2)).unwrap();
    assert_eq!(ops(&adjoint), [Op::Mul], "ȳ z₀ for the second input, 0 for the first");
    let (_, folded) = compiled(1, |z| vec![Trace::constant(2.0).detach() * Trace::constant(3.0), z[0].detach()]);
    assert!(folded.is_empty());
    assert_eq!(run_f64(&folded, &[5.0]), [6.0, 5.0]);
}

#[test]
fn detached_iterations_and_one_live_step_have_the_exact_derivative_by_all_routes() {
    let recording = Recording::of(1, |z| vec![implicit_root(z[0])]);
    let adjoint = Program::compile(&recording.adjoint(0..1)).unwrap();
    let mut worst = 0.0_f64;
    for a in [0.3, 1.0, 2.0, 7.5] {
        let exact = [f64::sqrt(a), 0.5 / f64::sqrt(a)];
        let dual = implicit_root(Dual64::new(a, 1.0));
        let wide = implicit_root(DualSVec64::<1>::new(a, Derivative::some([1.0].into())));
        let jet = implicit_root(Jet::<f64, 2>::variable(a));
        for got in [
            [implicit_root(a), run_f64(&adjoint, &[a, 1.0])[0]],
            [dual.re, dual.eps],
            [wide.re, wide.eps.unwrap_generic(Const::<1>, Const::<1>)[0]],
            jet.coefficients,
        ] {
            worst = worst.max((got[0] - exact[0]).abs()).max((got[1] - exact[1]).abs());
        }
    }
    println!("worst {worst:.1e}");
    assert!(worst <= 1e-15, "{worst:e}"); // measured 5.6e-17
    // differentiated step by step: 113 instructions, against 33
    let (undetached, _) = compiled(1, |z| {
        let mut y = Trace::one();
        for _ in 0..9 {
            y = y - (y.square() - z[0]) * (y + y).recip();
        }
        vec![y]
    });
    let full = Program::compile(&undetached.adjoint(0..1)).unwrap();
    println!("{} instructions, {} undetached", adjoint.len(), full.len());
    assert!(adjoint.len() < full.len() / 2);
}

/// Every operation, of numbers that differ in sign and size.
fn all_operations(z: &[Trace]) -> Vec<Trace> {
    let c = Trace::constant;
    let (sine, cosine) = (z[0] * z[1]).sin_cos();
    let sums = [z[0] + z[1], z[0] - z[1], z[0] * z[1], -z[2], z[0].mul_add(z[1], z[2]), z[2] - z[0] * z[1]];
    let more = [z[0] * z[1] - z[2], z[0] * z[1] + z[2] * z[3], z[2] * z[3] - z[0] * z[1], c(0.0) * z[0]];
    let size = (z[3] * z[3] + c(0.1)).sqrt();
    let rare = [size.recip(), size.ln(), z[0].tanh(), (-size).exp(), z[0].atan2(z[1]), z[0] / size, sine, cosine];
    let masks = [z[0].lt(z[1]), z[1].lt(z[2]).and(z[0].lt(z[3])), z[1].lt(z[0]).or(z[2].lt(z[3])).not()];
    let picked = masks.map(|mask| Trace::select(mask, z[0], z[3]));
    sums.into_iter().chain(more).chain(rare).chain(picked).collect()
}

#[test]
fn the_order_of_instructions_and_steps_side_by_side_change_no_bit() {
    let recording = Recording::of(4, all_operations);
    let (plain, single) = (Program::compile(&recording).unwrap(), Program::compile_single(&recording).unwrap());
    let mut r = Stream::new(51, 0, 0, Purpose::user(51));
    let special = [0.0, -0.0, 1e-310, f64::INFINITY, f64::NAN, -1.0];
    let bits = |x: f64| if x.is_nan() { u64::MAX } else { x.to_bits() };
    for round in 0..50 {
        let mut draw = || if round > 25 { r.uniform(-3.0, 3.0) } else { special[r.below(6) as usize] };
        let points: Vec<[f64; LINE]> = (0..4).map(|_| std::array::from_fn(|_| draw())).collect();
        for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane] {
            let mut slots = single.step_slots();
            with_set(set, || single.evaluate_steps(LINE, &mut slots, &points));
            for step in 0..LINE {
                let z: Vec<f64> = points.iter().map(|row| row[step]).collect();
                let (one, other) = (run_f64(&plain, &z), run_f64(&single, &z));
                let direct: Vec<f64> = recording_value(&z);
                for k in 0..one.len() {
                    let beside = slots[single.place(k) as usize][step];
                    let all = [one[k], other[k], beside].map(bits);
                    assert_eq!(all, [bits(direct[k]); 3], "result {k} of {z:?} with {set:?}");
                }
            }
        }
    }
}

/// As [`all_operations`] in `f64`.
fn recording_value(z: &[f64]) -> Vec<f64> {
    let mut sums = vec![z[0] + z[1], z[0] - z[1], z[0] * z[1], -z[2], z[0] * z[1] + z[2], z[2] - z[0] * z[1]];
    sums.extend([z[0] * z[1] - z[2], z[0] * z[1] + z[2] * z[3], z[2] * z[3] - z[0] * z[1], 0.0]);
    let size = (z[3] * z[3] + 0.1).sqrt();
    let (sine, cosine) = (z[0] * z[1]).sin_cos();
    sums.extend([1.0 / size, size.ln(), z[0].tanh(), (-size).exp(), z[0].atan2(z[1]), z[0] / size, sine, cosine]);
    let masks = [z[0] < z[1], z[1] < z[2] && z[0] < z[3], !(z[1] < z[0] || z[2] < z[3])];
    sums.extend(masks.map(|mask| if mask { z[0] } else { z[3] }));
    sums
}

/// Sums as blocks compute them, one product fused where the processor does.
fn sums_in_f32(z: [f32; 4], is_fused: bool) -> [f32; 9] {
    let [a, b, c, d] = z;
    let fused = |x: f32, y: f32, sum: f32| if is_fused { x.mul_add(y, sum) } else { x * y + sum };
    let products = [fused(a, b, c), fused(-a, b, c), fused(a, b, -c), fused(c, d, a * b), fused(-a, b, c * d)];
    let [add, from, less, two, difference] = products;
    [a + b, a - b, a * b, -c, add, from, less, two, difference]
}

#[test]
fn sums_of_blocks_are_the_operations_of_f32_to_the_bit() {
    // alone, so that products are fused into the sum that reads them
    let programs: [Program; 9] = std::array::from_fn(|k| compiled(4, |z| vec![all_operations(z)[k]]).1);
    let mut r = Stream::new(52, 0, 0, Purpose::user(52));
    let special = [0.0, -0.0, 1e-40, f32::INFINITY, f32::NAN, -1.0];
    let bits = |x: f32| if x.is_nan() { u32::MAX } else { x.to_bits() };
    for round in 0..50 {
        let mut draw = || if round > 25 { r.uniform(-3.0, 3.0) as f32 } else { special[r.below(6) as usize] };
        let z: [[f32; BLOCK]; 4] = std::array::from_fn(|_| std::array::from_fn(|_| draw()));
        for (set, n) in
            [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane].into_iter().zip([BLOCK, 17, BLOCK])
        {
            let mut got = [[0.0; BLOCK]; 9];
            let mut is_fused = false;
            for (program, row) in programs.iter().zip(got.chunks_mut(1)) {
                with_set(set, || {
                    is_fused = instruction_set() != "scalar";
                    program.evaluate_lanes(n, &mut program.block_workspace(), &z, row);
                });
            }
            for lane in 0..n {
                let want = sums_in_f32(z.map(|row| row[lane]), is_fused);
                assert_eq!(got.map(|row| bits(row[lane])), want.map(bits), "{set:?}, {:?}", z.map(|row| row[lane]));
            }
        }
    }
}
