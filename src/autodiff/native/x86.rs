//! The encoder for x86-64: VEX and EVEX instructions of AVX2 with FMA, and of AVX-512 F, DQ and VL.
//!
//! Forms after Intel, Software Developer's Manual, volume 2, chapter 2. What is promised: no instruction outside those sets, no
//! register of the caller's changed that the System V convention keeps, no change of MXCSR, `vzeroupper` before every call and return.

use super::instruction::*;
use super::layout::{MAX_ARRAYS, RowLayout};
use super::lower::{Do, Element};
use super::memory::frame;
use std::collections::HashMap;

/// How numbers lie in registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Shape {
    pub(super) element: Element,
    /// Bytes of a register in use: 64, 32, or 8 for one `f64`.
    pub(super) width: usize,
    /// With AVX-512: 32 registers, registers of masks.
    pub(super) is_evex: bool,
}

impl Shape {
    pub(super) fn target(self) -> Target {
        let n_register = if self.is_evex { 32 } else { 16 };
        Target { n_register, has_masks: self.is_evex, is_single: self.is_single() }
    }

    fn is_single(self) -> bool {
        self.width == 8
    }

    pub(super) fn element_size(self) -> usize {
        if self.element == Element::F32 { 4 } else { 8 }
    }

    /// Bytes from one constant to the next: EVEX fills a register from one number.
    pub(super) fn constant_size(self) -> usize {
        if self.is_evex || self.is_single() { self.element_size() } else { self.width }
    }

    /// Bytes that the address of the constants stands behind their beginning: displacements of one byte are signed.
    pub(super) fn constant_bias(self) -> usize {
        128 * if self.is_evex { self.element_size() } else { 1 }
    }

    /// Likewise of the slots.
    pub(super) fn slot_bias(self) -> usize {
        128 * if self.is_evex { self.width } else { 1 }
    }
}

/// Registers for addresses, by their numbers.
const CONSTANTS: u8 = 0; // rax
const SLOTS: u8 = 1; // rcx
const FRAME: u8 = 7; // rdi
const ARRAYS: [u8; MAX_ARRAYS] = [2, 6, 8, 9, 10, 11]; // rdx, rsi, r8 to r11
/// Functions know no arrays.
const TAPE: u8 = ARRAYS[0];

/// Opcode maps and prefixes of vector instructions.
#[derive(Clone, Copy)]
struct Opcode {
    /// 1: 0F, 2: 0F 38, 3: 0F 3A.
    map: u8,
    /// 0: none, 1: 66, 2: F3, 3: F2.
    prefix: u8,
    /// W in EVEX; in VEX for those of map 2 alone.
    w: bool,
    code: u8,
}

/// The last operand of a vector instruction.
#[derive(Clone, Copy)]
enum Last {
    Reg(Reg),
    Memory { base: u8, displacement: i32, is_broadcast: bool },
}

/// What stands beside opcode and operands.
#[derive(Clone, Copy, Default)]
struct Extra {
    /// Register of masks, 0 for none.
    k: u8,
    /// 0 where the mask is not set, instead of what was there.
    zeroing: bool,
    immediate: Option<u8>,
    /// Bytes that a displacement of one byte counts in, in EVEX.
    scale: usize,
    /// No such form in VEX.
    is_evex_only: bool,
}

/// A program and its functions in bytes.
pub(super) struct Encoded {
    pub(super) bytes: Vec<u8>,
    /// Bits of the constants, most used first: a byte names them.
    pub(super) pool: Vec<u64>,
    /// Rows of slots, with those of calls before them.
    pub(super) n_row: usize,
}

/// Machine code of a program over rows of `stride` bytes, with its functions behind it. `passed` says how many
/// numbers each function takes and gives.
pub(super) fn encode(
    parts: &[Allocated],
    shape: Shape,
    layout: &RowLayout,
    stride: usize,
    call_rows: usize,
    passed: &[usize],
) -> Encoded {
    let (pool, places) = pooled(parts);
    let code = Vec::with_capacity(parts.iter().map(|part| part.instructions.len() * 9 + 128).sum());
    let mut encoder = Encoder {
        code,
        shape,
        stride,
        n_array: layout.n_array(),
        constants: &[],
        slots: call_rows,
        passed: Vec::with_capacity(passed.len()),
        first_call: 0,
        is_function: false,
        invoked: Vec::new(),
    };
    let mut n_row = call_rows + parts[0].n_slot;
    for (n, part) in passed.iter().zip(&parts[1..]) {
        encoder.passed.push(n_row);
        n_row += n + part.n_slot;
    }
    let mut starts = Vec::with_capacity(passed.len());
    for (k, (part, constants)) in parts.iter().zip(&places).enumerate() {
        encoder.constants = constants;
        match k.checked_sub(1) {
            None => {
                let top = encoder.load_addresses();
                part.instructions.iter().for_each(|instruction| encoder.instruction(instruction));
                encoder.next_registers(top);
            }
            Some(number) => {
                encoder.is_function = true;
                starts.push(encoder.code.len());
                encoder.slots = encoder.passed[number] + passed[number];
                encoder.function(&part.instructions);
            }
        }
        encoder.first_call += part.n_call;
    }
    encoder.link(&starts);
    Encoded { bytes: encoder.code, pool, n_row }
}

/// The constants of all parts, and where they are for each.
fn pooled(parts: &[Allocated]) -> (Vec<u64>, Vec<Vec<u32>>) {
    let mut n_use: HashMap<u64, u32> = HashMap::new();
    let mut pool: Vec<u64> = Vec::new();
    for (bits, n) in parts.iter().flat_map(|part| &part.constants) {
        *n_use.entry(*bits).or_insert_with(|| {
            pool.push(*bits);
            0
        }) += n;
    }
    pool.sort_by_key(|bits| std::cmp::Reverse(n_use[bits]));
    let place: HashMap<u64, u32> = pool.iter().copied().zip(0..).collect();
    let places = parts.iter().map(|part| part.constants.iter().map(|(bits, _)| place[bits]).collect());
    (pool, places.collect())
}

struct Encoder<'a> {
    code: Vec<u8>,
    shape: Shape,
    stride: usize,
    n_array: usize,
    /// Of the part that is encoded: where its constants are in the pool, which row its slots begin at, and the number of its first
    /// call.
    constants: &'a [u32],
    slots: usize,
    first_call: u32,
    is_function: bool,
    /// The row at which what each function is passed begins.
    passed: Vec<usize>,
    /// Where functions are called, and which.
    invoked: Vec<(usize, u32)>,
}

impl Encoder<'_> {
    /// A function. The stack stands as it does in the program.
    fn function(&mut self, instructions: &[Instruction]) {
        self.code.extend(MAKE_ROOM);
        instructions.iter().for_each(|instruction| self.instruction(instruction));
        self.code.extend(GIVE_ROOM);
        self.code.push(0xC3); // ret
    }

    /// A call of a function, which changes addresses of arrays alone, and keeps that of its tape.
    fn invoke(&mut self, function: u32, tape: Option<TapeAt>) {
        let own = self.is_function && matches!(tape, Some(TapeAt::Slot(_)));
        if own {
            self.code.push(0x50 | TAPE); // push
            self.code.extend(MAKE_ROOM);
        }
        let by = |k: u32| (k as usize * self.shape.width) as i32;
        let moved = match tape {
            // lea tape, [slots + displacement]
            Some(TapeAt::Slot(k)) => Some(([0x48, 0x8D, 0x80 | TAPE << 3 | SLOTS], by(self.slots as u32 + k))),
            // add tape, displacement
            Some(TapeAt::Own(k)) => Some(([0x48, 0x81, 0xC0 | TAPE], by(k))),
            None => None,
        };
        if let Some((head, displacement)) = moved {
            self.code.extend(head);
            self.code.extend(displacement.to_le_bytes());
        }
        self.code.push(0xE8); // call, to a place that is known later
        self.invoked.push((self.code.len(), function));
        self.code.extend([0; 4]);
        match (self.is_function, tape) {
            (false, _) => self.load_arrays(),
            (true, Some(TapeAt::Slot(_))) => {
                self.code.extend(GIVE_ROOM);
                self.code.push(0x58 | TAPE); // pop
            }
            (true, Some(TapeAt::Own(k))) => {
                self.code.extend([0x48, 0x81, 0xE8 | TAPE]); // sub tape, displacement
                self.code.extend(by(k).to_le_bytes());
            }
            (true, None) => {}
        }
    }

    /// Writes where functions begin into their calls.
    fn link(&mut self, starts: &[usize]) {
        for (at, function) in &self.invoked {
            let distance = starts[*function as usize] as i32 - (*at as i32 + 4);
            self.code[*at..*at + 4].copy_from_slice(&distance.to_le_bytes());
        }
    }

    /// Addresses from the frame into registers; returns where that begins.
    fn load_addresses(&mut self) -> usize {
        let at = self.code.len();
        self.load_address(CONSTANTS, frame::CONSTANTS);
        self.load_address(SLOTS, frame::SLOTS);
        if !self.is_function {
            self.load_arrays();
        }
        at
    }

    fn load_arrays(&mut self) {
        for k in 0..self.n_array {
            self.load_address(ARRAYS[k], frame::ARRAYS + 8 * k);
        }
    }

    /// mov register, [frame + offset]
    fn load_address(&mut self, register: u8, offset: usize) {
        self.code.extend([0x48 | (register >> 3) << 2, 0x8B, 0x40 | (register & 7) << 3 | FRAME, offset as u8]);
    }

    /// On to the next register of every row, while there is one; then back to the caller.
    fn next_registers(&mut self, top: usize) {
        if !self.shape.is_single() {
            for k in 0..self.n_array {
                // add qword [frame + offset], width
                self.code.extend([0x48, 0x83, 0x40 | FRAME, (frame::ARRAYS + 8 * k) as u8, self.shape.width as u8]);
            }
            // dec qword [frame + offset]; jnz top
            self.code.extend([0x48, 0xFF, 0x48 | FRAME, frame::REMAINING as u8, 0x0F, 0x85]);
            let distance = top as i32 - (self.code.len() as i32 + 4);
            self.code.extend(distance.to_le_bytes());
        }
        self.code.extend(VZEROUPPER);
        self.code.push(0xC3); // ret
    }

    /// What the function of calls is told: the frame, which it has already, and the number. The stack is at a multiple of 16 there.
    fn call(&mut self, number: u32) {
        self.code.extend(VZEROUPPER);
        if self.is_function {
            self.code.push(0x50 | TAPE); // push
            self.code.extend(MAKE_ROOM);
        }
        self.code.push(0x57); // push rdi
        self.code.push(0xBE); // mov esi, number
        self.code.extend((self.first_call + number).to_le_bytes());
        self.code.extend([0xFF, 0x50 | FRAME, frame::CALL as u8]); // call [rdi + offset]
        self.code.push(0x5F); // pop rdi
        if self.is_function {
            self.code.extend(GIVE_ROOM);
            self.code.push(0x58 | TAPE); // pop
        }
        self.load_addresses();
    }

    fn instruction(&mut self, instruction: &Instruction) {
        use Instruction::*;
        let Shape { element, .. } = self.shape;
        let packed_prefix = u8::from(element == Element::F64);
        match *instruction {
            Load { d, m } => self.load(d, m),
            Store { m, s } => {
                let last = self.memory(m);
                let opcode = self.arithmetic(0x11);
                self.vector(opcode, s, 0, last, self.whole());
            }
            Move { d, s } => {
                let opcode = self.arithmetic_packed(packed_prefix, 0x28);
                self.vector(opcode, d, 0, Last::Reg(s), self.whole());
            }
            Two { what, d, a, b } => {
                let last = self.last(b);
                let opcode = match what {
                    Do::Add => self.arithmetic(0x58),
                    Do::Mul => self.arithmetic(0x59),
                    Do::Sub => self.arithmetic(0x5C),
                    Do::Min => self.arithmetic(0x5D),
                    Do::Div => self.arithmetic(0x5E),
                    Do::Max => self.arithmetic(0x5F),
                    Do::Xor => self.arithmetic_packed(packed_prefix, 0x57),
                    Do::And => self.arithmetic_packed(packed_prefix, 0x54),
                    _ => Opcode { map: 1, prefix: 1, w: false, code: 0xFE },
                };
                self.vector(opcode, d, a, last, self.scaled(last));
            }
            Sqrt { d, a } => {
                let last = self.last(a);
                // one number takes the rest of the register from the second operand
                let second = if self.shape.is_single() { if let Rm::Reg(r) = a { r } else { d } } else { 0 };
                self.vector(self.arithmetic(0x51), d, second, last, self.scaled(last));
            }
            Up { d, a, by } => self.shift(6, d, a, by),
            Down { d, a, by } => self.shift(2, d, a, by),
            Instruction::Fused { what, form, d, v, rm } => self.fused(what, form, d, v, rm),
            Compare { k, a, b, relation } => {
                let last = self.last(b);
                let extra = Extra { immediate: Some(predicate(relation)), is_evex_only: true, ..self.scaled(last) };
                self.vector(self.arithmetic(0xC2), k, a, last, extra);
            }
            Test { k, a, b, share } => {
                let last = self.last(b);
                let opcode = Opcode { map: 2, prefix: if share { 1 } else { 2 }, w: false, code: 0x27 };
                self.vector(opcode, k, a, last, Extra { is_evex_only: true, ..self.scaled(last) });
            }
            Blend { d, k, no, yes } => {
                let last = self.last_packed(yes);
                let opcode = Opcode { map: 2, prefix: 1, w: element == Element::F64, code: 0x65 };
                self.vector(opcode, d, no, last, Extra { k, is_evex_only: true, ..self.scaled(last) });
            }
            Where { d, k, m } => {
                let extra = Extra {
                    k,
                    zeroing: true,
                    is_evex_only: true,
                    scale: self.shape.element_size(),
                    ..Extra::default()
                };
                let opcode = if self.shape.is_single() { self.arithmetic(0x10) } else { self.broadcast() };
                let last = self.unbroadcast(m);
                self.vector(opcode, d, 0, last, extra);
            }
            Flip { d, b, c } => {
                let last = self.last(c);
                let opcode = Opcode { map: 3, prefix: 1, w: false, code: 0x25 };
                // the truth table of a ^ (b & c)
                let extra = Extra { immediate: Some(0x78), is_evex_only: true, ..self.scaled(last) };
                self.vector(opcode, d, b, last, extra);
            }
            CompareInto { d, a, b, relation } => {
                let last = self.last(b);
                let extra = Extra { immediate: Some(predicate(relation)), ..self.scaled(last) };
                self.vector(self.arithmetic(0xC2), d, a, last, extra);
            }
            BlendBy { d, by, no, yes } => {
                let last = self.last(yes);
                let code = if element == Element::F64 { 0x4B } else { 0x4A };
                let opcode = Opcode { map: 3, prefix: 1, w: false, code };
                self.vector(opcode, d, no, last, Extra { immediate: Some(by << 4), ..self.scaled(last) });
            }
            Call { number } => self.call(number),
            Invoke { function, tape } => self.invoke(function, tape),
        }
    }

    fn load(&mut self, d: Reg, m: Mem) {
        let is_broadcast = matches!(m, Mem::Constant(_)) && self.shape.is_evex && !self.shape.is_single();
        if is_broadcast {
            let extra = Extra { scale: self.shape.element_size(), is_evex_only: true, ..Extra::default() };
            let last = self.unbroadcast(m);
            return self.vector(self.broadcast(), d, 0, last, extra);
        }
        let last = self.memory(m);
        let opcode = self.arithmetic(0x10);
        self.vector(opcode, d, 0, last, self.whole());
    }

    fn fused(&mut self, what: Fused, form: Form, d: Reg, v: Reg, rm: Rm) {
        let order = match form {
            Form::F132 => 0x90,
            Form::F213 => 0xA0,
            Form::F231 => 0xB0,
        };
        let code = order
            | match what {
                Fused::MulAdd => 0x8,
                Fused::MulSub => 0xA,
                Fused::NegMulAdd => 0xC,
            };
        let last = self.last(rm);
        let w = self.shape.element == Element::F64;
        self.vector(Opcode { map: 2, prefix: 1, w, code }, d, v, last, self.scaled(last));
    }

    /// The number of the instruction stands where others have their target.
    fn shift(&mut self, number: u8, d: Reg, a: Reg, by: u8) {
        let opcode = Opcode { map: 1, prefix: 1, w: false, code: 0x72 };
        self.vector(opcode, number, d, Last::Reg(a), Extra { immediate: Some(by), ..self.whole() });
    }

    /// Of as many numbers as a register has in use.
    fn arithmetic(&self, code: u8) -> Opcode {
        let packed = u8::from(self.shape.element == Element::F64);
        let prefix = if self.shape.is_single() { 3 } else { packed };
        Opcode { map: 1, prefix, w: self.shape.element == Element::F64, code }
    }

    /// Of whole registers.
    fn arithmetic_packed(&self, prefix: u8, code: u8) -> Opcode {
        Opcode { map: 1, prefix, w: self.shape.element == Element::F64, code }
    }

    /// One number into all of a register.
    fn broadcast(&self) -> Opcode {
        let is_double = self.shape.element == Element::F64;
        Opcode { map: 2, prefix: 1, w: is_double, code: if is_double { 0x19 } else { 0x18 } }
    }

    fn whole(&self) -> Extra {
        Extra { scale: self.shape.width, ..Extra::default() }
    }

    fn scaled(&self, last: Last) -> Extra {
        let is_broadcast = matches!(last, Last::Memory { is_broadcast: true, .. });
        Extra { scale: if is_broadcast { self.shape.element_size() } else { self.shape.width }, ..Extra::default() }
    }

    fn last(&self, rm: Rm) -> Last {
        match rm {
            Rm::Reg(r) => Last::Reg(r),
            Rm::Mem(m) => self.memory(m),
        }
    }

    /// For an instruction that reads whole registers also where one number is in use.
    fn last_packed(&self, rm: Rm) -> Last {
        match self.last(rm) {
            Last::Memory { base, displacement, .. } if self.shape.is_single() => {
                Last::Memory { base, displacement, is_broadcast: true }
            }
            last => last,
        }
    }

    /// For an instruction that reads one number anyway.
    fn unbroadcast(&self, m: Mem) -> Last {
        match self.memory(m) {
            Last::Memory { base, displacement, .. } => Last::Memory { base, displacement, is_broadcast: false },
            last => last,
        }
    }

    fn memory(&self, m: Mem) -> Last {
        let shape = self.shape;
        let slot = |k: usize| (k * shape.width) as i32 - shape.slot_bias() as i32;
        let (base, displacement, is_broadcast) = match m {
            Mem::Constant(k) => {
                let at =
                    (self.constants[k as usize] as usize * shape.constant_size()) as i32 - shape.constant_bias() as i32;
                (CONSTANTS, at, shape.is_evex && !shape.is_single())
            }
            Mem::Call(k) => (SLOTS, slot(k as usize), false),
            Mem::Slot(k) => (SLOTS, slot(self.slots + k as usize), false),
            Mem::Passed(function, k) => (SLOTS, slot(self.passed[function as usize] + k as usize), false),
            Mem::Tape(k) => (TAPE, slot(k as usize), false),
            Mem::Row(place) => (ARRAYS[usize::from(place.array)], (place.row as usize * self.stride) as i32, false),
        };
        Last::Memory { base, displacement, is_broadcast }
    }

    /// One vector instruction, in the shorter of its forms.
    fn vector(&mut self, opcode: Opcode, first: Reg, second: Reg, last: Last, extra: Extra) {
        let is_high = first > 15 || second > 15 || matches!(last, Last::Reg(r) if r > 15);
        let is_broadcast = matches!(last, Last::Memory { is_broadcast: true, .. });
        let is_evex = self.shape.is_evex
            && (self.shape.width == 64 || extra.is_evex_only || is_high || is_broadcast || {
                let vex = vex_length(opcode, last) + displacement_length(last, 1);
                vex > 5 + displacement_length(last, extra.scale)
            });
        if is_evex {
            self.evex(opcode, first, second, last, extra);
        } else {
            self.vex(opcode, first, second, last);
        }
        self.operands(first, last, if is_evex { extra.scale } else { 1 });
        self.code.extend(extra.immediate);
    }

    fn evex(&mut self, opcode: Opcode, first: Reg, second: Reg, last: Last, extra: Extra) {
        let (x, b, is_broadcast) = match last {
            Last::Reg(r) => (r >> 4 & 1, r >> 3 & 1, false),
            Last::Memory { base, is_broadcast, .. } => (0, base >> 3 & 1, is_broadcast),
        };
        let inverted = |bit: u8| (bit & 1) ^ 1;
        let length = match self.shape.width {
            64 => 2,
            32 => 1,
            _ => 0,
        };
        self.code.extend([
            0x62,
            inverted(first >> 3) << 7 | inverted(x) << 6 | inverted(b) << 5 | inverted(first >> 4) << 4 | opcode.map,
            u8::from(opcode.w) << 7 | (!second & 15) << 3 | 4 | opcode.prefix,
            u8::from(extra.zeroing) << 7
                | length << 5
                | u8::from(is_broadcast) << 4
                | inverted(second >> 4) << 3
                | extra.k,
            opcode.code,
        ]);
    }

    fn vex(&mut self, opcode: Opcode, first: Reg, second: Reg, last: Last) {
        let length = u8::from(self.shape.width == 32);
        let tail = (!second & 15) << 3 | length << 2 | opcode.prefix;
        let first_inverted = ((first >> 3 & 1) ^ 1) << 7;
        if vex_length(opcode, last) == 3 {
            self.code.extend([0xC5, first_inverted | tail, opcode.code]);
        } else {
            let b = (last.high_bit() ^ 1) << 5;
            let w = u8::from(opcode.w && opcode.map == 2) << 7;
            self.code.extend([0xC4, first_inverted | 1 << 6 | b | opcode.map, w | tail, opcode.code]);
        }
    }

    /// ModRM and displacement.
    fn operands(&mut self, first: Reg, last: Last, scale: usize) {
        let reg = (first & 7) << 3;
        match last {
            Last::Reg(r) => self.code.push(0xC0 | reg | (r & 7)),
            Last::Memory { base, displacement, .. } => match displacement_length(last, scale) {
                0 => self.code.push(reg | (base & 7)),
                1 => self.code.extend([0x40 | reg | (base & 7), (displacement / scale as i32) as i8 as u8]),
                _ => {
                    self.code.push(0x80 | reg | (base & 7));
                    self.code.extend(displacement.to_le_bytes());
                }
            },
        }
    }
}

impl Last {
    /// The fourth bit of its register.
    fn high_bit(self) -> u8 {
        match self {
            Self::Reg(register) | Self::Memory { base: register, .. } => register >> 3 & 1,
        }
    }
}

const VZEROUPPER: [u8; 3] = [0xC5, 0xF8, 0x77];

/// sub rsp, 8: calls find the stack at a multiple of 16.
const MAKE_ROOM: [u8; 4] = [0x48, 0x83, 0xEC, 8];
/// add rsp, 8
const GIVE_ROOM: [u8; 4] = [0x48, 0x83, 0xC4, 8];

/// Prefix and opcode.
fn vex_length(opcode: Opcode, last: Last) -> usize {
    if opcode.map == 1 && last.high_bit() == 0 { 3 } else { 4 }
}

fn displacement_length(last: Last, scale: usize) -> usize {
    match last {
        Last::Reg(_) | Last::Memory { displacement: 0, .. } => 0,
        Last::Memory { displacement, .. } => {
            let scale = scale as i32;
            let is_short = displacement % scale == 0 && i8::try_from(displacement / scale).is_ok();
            if is_short { 1 } else { 4 }
        }
    }
}

fn predicate(relation: Relation) -> u8 {
    match relation {
        Relation::Less => 17,
        Relation::Greater => 30,
        Relation::NotLess => 21,
        Relation::NotGreater => 26,
    }
}
