//! A processor in plain Rust: what allocated instructions compute, whatever this processor has.

use super::super::allocate::allocate;
use super::super::instruction::{Allocated, Form, Fused, Instruction, Mem, Reg, Relation, Rm, TapeAt, Target};
use super::super::lower::{CallSite, Callee, Do, Element, lower};
use super::*;

const LANES: usize = 4;

/// Bits of the numbers of a register.
type Register = [u64; LANES];

struct Processor<'a> {
    element: Element,
    registers: [Register; 32],
    masks: [[bool; LANES]; 8],
    /// The part that runs: its constants and slots.
    part: usize,
    slots: Vec<Register>,
    calls: Vec<Register>,
    arrays: Vec<Vec<Register>>,
    /// What each function is passed.
    passed: Vec<Vec<Register>>,
    tape: Vec<Register>,
    /// How long the tapes of functions are.
    tapes: &'a [usize],
    parts: &'a [Allocated],
    callees: &'a [Vec<(Callee, usize)>],
}

impl Processor<'_> {
    fn number(&self, bits: u64) -> f64 {
        match self.element {
            Element::F32 => f64::from(f32::from_bits(bits as u32)),
            Element::F64 => f64::from_bits(bits),
        }
    }

    fn read(&self, m: Mem) -> Register {
        match m {
            Mem::Constant(k) => [self.parts[self.part].constants[k as usize].0; LANES],
            Mem::Slot(k) => self.slots[k as usize],
            Mem::Call(k) => self.calls[k as usize],
            Mem::Passed(function, k) => self.passed[function as usize][k as usize],
            Mem::Tape(k) => self.tape[k as usize],
            Mem::Row(place) => self.arrays[place.array as usize][place.row as usize],
        }
    }

    fn write(&mut self, m: Mem, value: Register) {
        match m {
            Mem::Constant(_) => panic!("a constant is written"),
            Mem::Slot(k) => self.slots[k as usize] = value,
            Mem::Call(k) => self.calls[k as usize] = value,
            Mem::Passed(function, k) => self.passed[function as usize][k as usize] = value,
            Mem::Tape(k) => self.tape[k as usize] = value,
            Mem::Row(place) => self.arrays[place.array as usize][place.row as usize] = value,
        }
    }

    fn get(&self, rm: Rm) -> Register {
        match rm {
            Rm::Reg(r) => self.registers[r as usize],
            Rm::Mem(m) => self.read(m),
        }
    }

    fn zip(&mut self, d: Reg, a: Register, b: Register, f: impl Fn(u64, u64) -> u64) {
        self.registers[d as usize] = std::array::from_fn(|l| f(a[l], b[l]));
    }

    fn holds(&self, a: u64, b: u64, relation: Relation) -> bool {
        let (a, b) = (self.number(a), self.number(b));
        match relation {
            Relation::Less => a < b,
            Relation::Greater => a > b,
            Relation::NotLess => a >= b || a.is_nan() || b.is_nan(),
            Relation::NotGreater => a <= b || a.is_nan() || b.is_nan(),
        }
    }

    fn two(&self, what: Do, a: u64, b: u64) -> u64 {
        let bits = |x: f32| u64::from(x.to_bits());
        let (x, y) = (f32::from_bits(a as u32), f32::from_bits(b as u32));
        let (u, v) = (f64::from_bits(a), f64::from_bits(b));
        match (what, self.element) {
            (Do::Xor, _) => a ^ b,
            (Do::And, _) => a & b,
            (Do::AddBits, _) => u64::from((a as u32).wrapping_add(b as u32)),
            (Do::Add, Element::F32) => bits(x + y),
            (Do::Sub, Element::F32) => bits(x - y),
            (Do::Mul, Element::F32) => bits(x * y),
            (Do::Div, Element::F32) => bits(x / y),
            (Do::Add, _) => (u + v).to_bits(),
            (Do::Sub, _) => (u - v).to_bits(),
            (Do::Mul, _) => (u * v).to_bits(),
            (Do::Div, _) => (u / v).to_bits(),
            (Do::Min, _) => {
                if self.number(a) < self.number(b) {
                    a
                } else {
                    b
                }
            }
            (Do::Max, _) => {
                if self.number(a) > self.number(b) {
                    a
                } else {
                    b
                }
            }
            _ => panic!("{what:?} has not two operands"),
        }
    }

    fn step(&mut self, instruction: &Instruction) {
        use Instruction::{
            Blend, BlendBy, Call, Compare, CompareInto, Down, Flip, Invoke, Load, Move, Sqrt, Store, Test, Two, Up,
            Where,
        };
        let width = if self.element == Element::F32 { u64::from(u32::MAX) } else { u64::MAX };
        match *instruction {
            Load { d, m } => self.registers[d as usize] = self.read(m),
            Store { m, s } => self.write(m, self.registers[s as usize]),
            Move { d, s } => self.registers[d as usize] = self.registers[s as usize],
            Two { what, d, a, b } => {
                let (a, b) = (self.registers[a as usize], self.get(b));
                self.registers[d as usize] = std::array::from_fn(|l| self.two(what, a[l], b[l]));
            }
            Sqrt { d, a } => {
                let (a, element) = (self.get(a), self.element);
                self.zip(d, a, a, |a, _| match element {
                    Element::F32 => u64::from(f32::from_bits(a as u32).sqrt().to_bits()),
                    Element::F64 => f64::from_bits(a).sqrt().to_bits(),
                });
            }
            Up { d, a, by } => self.zip(d, self.registers[a as usize], [0; LANES], |a, _| a << by & width),
            Down { d, a, by } => self.zip(d, self.registers[a as usize], [0; LANES], |a, _| a >> by),
            Instruction::Fused { what, form, d, v, rm } => {
                let (d_in, v, rm) = (self.registers[d as usize], self.registers[v as usize], self.get(rm));
                let (a, b, c) = match form {
                    Form::F132 => (d_in, rm, v),
                    Form::F213 => (v, d_in, rm),
                    Form::F231 => (v, rm, d_in),
                };
                let x = |bits: u64| f32::from_bits(bits as u32);
                self.registers[d as usize] = std::array::from_fn(|l| {
                    let (a, b, c) = (x(a[l]), x(b[l]), x(c[l]));
                    u64::from(
                        match what {
                            Fused::MulAdd => a.mul_add(b, c),
                            Fused::NegMulAdd => (-a).mul_add(b, c),
                            Fused::MulSub => a.mul_add(b, -c),
                        }
                        .to_bits(),
                    )
                });
            }
            Compare { k, a, b, relation } => {
                let (a, b) = (self.registers[a as usize], self.get(b));
                self.masks[k as usize] = std::array::from_fn(|l| self.holds(a[l], b[l], relation));
            }
            Test { k, a, b, share } => {
                let (a, b) = (self.registers[a as usize], self.get(b));
                self.masks[k as usize] = std::array::from_fn(|l| (a[l] & b[l] != 0) == share);
            }
            Blend { d, k, no, yes } => {
                let (no, yes, mask) = (self.registers[no as usize], self.get(yes), self.masks[k as usize]);
                self.registers[d as usize] = std::array::from_fn(|l| if mask[l] { yes[l] } else { no[l] });
            }
            Where { d, k, m } => {
                let (yes, mask) = (self.read(m), self.masks[k as usize]);
                self.registers[d as usize] = std::array::from_fn(|l| if mask[l] { yes[l] } else { 0 });
            }
            Flip { d, b, c } => {
                let (a, b, c) = (self.registers[d as usize], self.registers[b as usize], self.get(c));
                self.registers[d as usize] = std::array::from_fn(|l| a[l] ^ (b[l] & c[l]));
            }
            CompareInto { d, a, b, relation } => {
                let (a, b) = (self.registers[a as usize], self.get(b));
                self.registers[d as usize] =
                    std::array::from_fn(|l| if self.holds(a[l], b[l], relation) { width } else { 0 });
            }
            BlendBy { d, by, no, yes } => {
                let (by, no, yes) = (self.registers[by as usize], self.registers[no as usize], self.get(yes));
                let top = width ^ (width >> 1);
                self.registers[d as usize] = std::array::from_fn(|l| if by[l] & top != 0 { yes[l] } else { no[l] });
            }
            Call { number } => self.call(&self.callees[self.part][number as usize]),
            Invoke { function, tape } => self.invoke(function as usize, tape),
        }
    }

    /// The program, or one of its functions behind it.
    fn run(&mut self, part: usize) {
        self.part = part;
        self.slots = vec![[0xBAD; LANES]; self.parts[part].n_slot];
        self.parts[part].instructions.iter().for_each(|instruction| self.step(instruction));
    }

    /// A function works on a copy of its tape.
    fn invoke(&mut self, function: usize, at: Option<TapeAt>) {
        let n = self.tapes[function];
        let (part, slots, tape) = (self.part, std::mem::take(&mut self.slots), std::mem::take(&mut self.tape));
        match at {
            Some(TapeAt::Slot(first)) => self.tape.extend(&slots[first as usize..first as usize + n]),
            Some(TapeAt::Own(first)) => self.tape.extend(&tape[first as usize..first as usize + n]),
            None => {}
        }
        self.run(function + 1);
        (self.part, self.slots) = (part, slots);
        let written = std::mem::replace(&mut self.tape, tape);
        match at {
            Some(TapeAt::Slot(first)) => self.slots[first as usize..first as usize + n].copy_from_slice(&written),
            Some(TapeAt::Own(first)) => self.tape[first as usize..first as usize + n].copy_from_slice(&written),
            None => {}
        }
        self.lose_registers();
    }

    fn lose_registers(&mut self) {
        self.registers = [[0xDEAD_BEEF; LANES]; 32];
        self.masks = [[true; LANES]; 8];
    }

    fn call(&mut self, (callee, n_operand): &(Callee, usize)) {
        self.lose_registers();
        for l in 0..LANES {
            let x: Vec<f64> = (0..*n_operand).map(|k| self.number(self.calls[k][l])).collect();
            let mut y = vec![0.0; callee.n_output()];
            match callee {
                Callee::Custom(operation) => operation.function().value(&x, &mut y),
                Callee::Elementary(Op::SinCos) => (y[0], y[1]) = x[0].sin_cos(),
                Callee::Elementary(Op::Exp) => y[0] = x[0].exp(),
                Callee::Elementary(Op::Ln) => y[0] = x[0].ln(),
                Callee::Elementary(Op::Tanh) => y[0] = x[0].tanh(),
                Callee::Elementary(_) => y[0] = x[0].atan2(x[1]),
                Callee::Function(..) => panic!("a function is no call"),
            }
            for (k, y) in y.iter().enumerate() {
                self.calls[k][l] = match self.element {
                    Element::F32 => u64::from((*y as f32).to_bits()),
                    Element::F64 => y.to_bits(),
                };
            }
        }
    }
}

/// What allocated code makes of arrays.
fn simulate(form: &ValueForm, element: Element, layout: &RowLayout, target: Target, arrays: &mut Vec<Vec<Register>>) {
    let mut lowered = lower(form, element).unwrap();
    let parts = allocate(&mut lowered, layout, target);
    let callee = |site: &CallSite| (site.callee.clone(), site.operands.len());
    let callees: Vec<Vec<_>> = lowered.iter().map(|part| part.calls.iter().map(callee).collect()).collect();
    let n_call = callees.iter().flatten().map(|(callee, n)| callee.n_output().max(*n)).max().unwrap_or(0);
    let passed = lowered[1..].iter().map(|part| vec![[0xBAD; LANES]; part.n_passed()]).collect();
    let tapes: Vec<usize> = lowered[1..].iter().map(|part| part.tape.n_input() + part.tape.n_result()).collect();
    let mut processor = Processor {
        element,
        registers: [[0xBAD; LANES]; 32],
        masks: [[true; LANES]; 8],
        part: 0,
        slots: Vec::new(),
        calls: vec![[0xBAD; LANES]; n_call],
        arrays: std::mem::take(arrays),
        passed,
        tape: Vec::new(),
        tapes: &tapes,
        parts: &parts,
        callees: &callees,
    };
    processor.run(0);
    *arrays = processor.arrays;
}

const TARGETS: [(&str, Target); 4] = [
    ("AVX-512", Target { n_register: 32, has_masks: true, is_single: false }),
    ("AVX2", Target { n_register: 16, has_masks: false, is_single: false }),
    ("one number, EVEX", Target { n_register: 32, has_masks: true, is_single: true }),
    ("one number, VEX", Target { n_register: 16, has_masks: false, is_single: true }),
];

fn compare_simulated(seed: u64, name: &str, element: Element, target: Target) {
    let program = Program::of_calls(random_form(seed));
    let layout = random_layout(seed, program.n_input(), program.n_output());
    let mut r = draws(seed ^ 0xABCD);
    let mut any = || {
        let number = number(&mut r);
        if element == Element::F32 { u64::from((number as f32).to_bits()) } else { number.to_bits() }
    };
    let mut arrays: Vec<Vec<Register>> =
        (0..layout.n_array()).map(|k| (0..layout.n_row(k)).map(|_| std::array::from_fn(|_| any())).collect()).collect();
    let inputs: Vec<Register> = layout.arguments().iter().map(|p| arrays[p.array as usize][p.row as usize]).collect();
    simulate(program.value_form(), element, &layout, target, &mut arrays);
    for lane in 0..LANES {
        let want: Vec<f64> = match element {
            Element::F64 => {
                f64::interpreter(&program, &inputs.iter().map(|x| f64::from_bits(x[lane])).collect::<Vec<_>>(), 1)
            }
            Element::F32 => {
                let inputs: Vec<_> = inputs.iter().map(|x| [f32::from_bits(x[lane] as u32); BLOCK]).collect();
                <[f32; BLOCK]>::interpreter(&program, &inputs, 1).iter().map(|y| f64::from(y[0])).collect()
            }
        };
        for (k, (want, place)) in want.iter().zip(layout.results()).enumerate() {
            let bits = arrays[place.array as usize][place.row as usize][lane];
            let got =
                if element == Element::F32 { f64::from(f32::from_bits(bits as u32)) } else { f64::from_bits(bits) };
            let form = program.value_form();
            assert!(
                want.differs(&got, 1).is_none(),
                "seed {seed}, {name} {element:?}: result {k}: {got:?}, not {want:?} of\n{form}"
            );
        }
    }
}

#[test]
fn registers_are_given_right_for_every_processor_also_those_that_are_not_here() {
    // lanes without fused products have other bits than machine code, which is not made there
    if matches!(availability(), Err(WhyInterpreted::Processor)) {
        return;
    }
    for (name, target) in TARGETS {
        for seed in 0..n_program() / 40 {
            if !target.is_single {
                compare_simulated(seed, name, Element::F32, target);
            }
            compare_simulated(seed, name, Element::F64, target);
        }
    }
}

/// A result that overwrites an argument which is read later waits; a slot that an instruction frees is not written by it.
#[test]
fn few_registers_change_no_bit() {
    for n_register in [6, 7, 9, 12] {
        for has_masks in [true, false] {
            let target = Target { n_register, has_masks, is_single: false };
            (0..n_program() / 80).for_each(|seed| compare_simulated(seed, "few registers", Element::F64, target));
        }
    }
}
