//! Every form of every instruction, as bytes and as text. `forms.txt` holds both; a disassembler that knows nothing of the encoder
//! reads the bytes back (`.ci/nightly`).

use super::super::instruction::{Allocated, Form, Fused, Instruction, Mem, Reg, Relation, Rm, TapeAt};
use super::super::lower::{Do, Element};
use super::super::x86::{Shape, encode};
use super::*;
use std::process::Command;

const SHAPES: [(&str, Shape); 6] = [
    ("AVX-512 f32", Shape { element: Element::F32, width: 64, is_evex: true }),
    ("AVX-512 f64", Shape { element: Element::F64, width: 64, is_evex: true }),
    ("AVX2 f32", Shape { element: Element::F32, width: 32, is_evex: false }),
    ("AVX2 f64", Shape { element: Element::F64, width: 32, is_evex: false }),
    ("one f64, EVEX", Shape { element: Element::F64, width: 8, is_evex: true }),
    ("one f64, VEX", Shape { element: Element::F64, width: 8, is_evex: false }),
];

/// Bytes of a row.
fn stride(shape: Shape) -> usize {
    match (shape.element, shape.width) {
        (Element::F32, _) => 256,
        (_, 8) => 8,
        _ => 64,
    }
}

fn layout() -> RowLayout {
    let at = |array, row| Place { array, row };
    RowLayout::new((0..6).map(|k| at(k, 5)).collect(), vec![at(1, 1000)]).unwrap()
}

/// Memory near and far.
fn memories() -> Vec<Mem> {
    let row = |array, row| Mem::Row(Place { array, row });
    vec![
        Mem::Constant(0),
        Mem::Constant(128),
        Mem::Constant(3000),
        Mem::Slot(1),
        Mem::Slot(128),
        Mem::Slot(5000),
        Mem::Call(0),
        row(0, 0),
        row(1, 1),
        row(2, 700),
        row(3, 5),
        row(5, 3),
    ]
}

/// All forms of a shape.
fn forms(shape: Shape) -> Vec<Instruction> {
    let (has_masks, is_single, is_f32) = (shape.is_evex, shape.width == 8, shape.element == Element::F32);
    let registers: &[[Reg; 3]] = if has_masks {
        &[[1, 2, 3], [9, 7, 12], [17, 26, 31], [8, 16, 0]]
    } else {
        &[[1, 2, 3], [9, 7, 12], [0, 15, 8]]
    };
    let near = [Mem::Constant(1), Mem::Row(Place { array: 3, row: 5 })].map(Rm::Mem);
    let rms: Vec<Rm> =
        near.into_iter().chain([Rm::Reg(4), Rm::Reg(11)]).chain(has_masks.then_some(Rm::Reg(20))).collect();
    let mut all = Vec::new();
    for &[x, y, z] in registers {
        for m in memories() {
            all.push(Instruction::Load { d: x, m });
            all.push(Instruction::Two { what: Do::Add, d: x, a: y, b: Rm::Mem(m) });
            if !matches!(m, Mem::Constant(_)) {
                all.push(Instruction::Store { m, s: y });
            }
        }
        all.push(Instruction::Move { d: x, s: y });
        for &rm in &rms {
            for what in [Do::Add, Do::Sub, Do::Mul, Do::Div, Do::Min, Do::Max] {
                all.push(Instruction::Two { what, d: x, a: y, b: rm });
            }
            all.push(Instruction::Sqrt { d: x, a: rm });
            if is_f32 {
                for what in [Do::Xor, Do::And, Do::AddBits] {
                    all.push(Instruction::Two { what, d: x, a: y, b: rm });
                }
                for what in [Fused::MulAdd, Fused::NegMulAdd, Fused::MulSub] {
                    for form in [Form::F132, Form::F213, Form::F231] {
                        all.push(Instruction::Fused { what, form, d: x, v: y, rm });
                    }
                }
            }
            for relation in [Relation::Less, Relation::Greater, Relation::NotLess, Relation::NotGreater] {
                all.push(if has_masks {
                    Instruction::Compare { k: 3, a: y, b: rm, relation }
                } else {
                    Instruction::CompareInto { d: x, a: y, b: rm, relation }
                });
            }
            if has_masks {
                all.push(Instruction::Blend { d: x, k: 5, no: y, yes: rm });
                if is_f32 {
                    all.push(Instruction::Flip { d: x, b: y, c: rm });
                    all.extend([true, false].map(|share| Instruction::Test { k: 7, a: y, b: rm, share }));
                }
            } else if !(is_single && matches!(rm, Rm::Mem(_))) {
                all.push(Instruction::BlendBy { d: x, by: z, no: y, yes: rm });
            }
        }
        if has_masks {
            all.extend([0, 3000].map(|k| Instruction::Where { d: x, k: 6, m: Mem::Constant(k) }));
        }
        if is_f32 {
            all.extend([Instruction::Up { d: x, a: y, by: 31 }, Instruction::Down { d: x, a: y, by: 23 }]);
        }
    }
    all
}

/// Instructions, with constants of which each is used less than the one before.
fn part(instructions: Vec<Instruction>) -> Allocated {
    let constants = (0..3001).map(|k| (k, 3001 - k as u32)).collect();
    Allocated { instructions, constants, n_slot: 0, n_call: 1 }
}

fn encoded(parts: &[Allocated], shape: Shape, passed: &[usize]) -> Vec<u8> {
    encode(parts, shape, &layout(), stride(shape), 2, passed).bytes
}

/// The bytes of one instruction.
fn bytes(instruction: Instruction, shape: Shape) -> Vec<u8> {
    let code = |instructions| encoded(&[part(instructions)], shape, &[]);
    let (empty, whole) = (code(vec![]), code(vec![instruction]));
    let head = 4 * (2 + layout().n_array());
    whole[head..head + whole.len() - empty.len()].to_vec()
}

/// An instruction as a disassembler writes it.
struct Text(Shape);

impl Text {
    fn reg(&self, r: Reg) -> String {
        let name = match self.0.width {
            64 => "zmm",
            32 => "ymm",
            _ => "xmm",
        };
        format!("{name}{r}")
    }

    /// `size` bytes, or one number for all.
    fn mem(&self, m: Mem, size: usize, is_broadcast: bool) -> String {
        let shape = self.0;
        let (base, at) = match m {
            Mem::Constant(k) => ("rax", k as i64 * shape.constant_size() as i64 - shape.constant_bias() as i64),
            Mem::Call(k) => ("rcx", k as i64 * shape.width as i64 - shape.slot_bias() as i64),
            Mem::Slot(k) => ("rcx", (k as i64 + 2) * shape.width as i64 - shape.slot_bias() as i64),
            Mem::Passed(..) | Mem::Tape(_) => unreachable!("in whole programs alone"),
            Mem::Row(p) => {
                (["rdx", "rsi", "r8", "r9", "r10", "r11"][p.array as usize], p.row as i64 * stride(shape) as i64)
            }
        };
        let kind = match (is_broadcast, size) {
            (true, 4) => "DWORD BCST",
            (true, _) => "QWORD BCST",
            (_, 4) => "DWORD PTR",
            (_, 8) => "QWORD PTR",
            (_, 32) => "YMMWORD PTR",
            _ => "ZMMWORD PTR",
        };
        match at {
            0 => format!("{kind} [{base}]"),
            1.. => format!("{kind} [{base}+{at:#x}]"),
            _ => format!("{kind} [{base}-{:#x}]", -at),
        }
    }

    fn rm(&self, rm: Rm) -> String {
        match rm {
            Rm::Reg(r) => self.reg(r),
            Rm::Mem(m) => {
                let fills = matches!(m, Mem::Constant(_)) && self.0.is_evex && self.0.width > 8;
                let size = if fills { self.0.element_size() } else { self.0.width };
                self.mem(m, size, fills)
            }
        }
    }

    fn of(&self, instruction: &Instruction) -> String {
        use Instruction::{
            Blend, BlendBy, Call, Compare, CompareInto, Down, Flip, Invoke, Load, Move, Sqrt, Store, Test, Two, Up,
            Where,
        };
        let shape = self.0;
        let (is_f32, is_single) = (shape.element == Element::F32, shape.width == 8);
        let packed = if is_f32 { "ps" } else { "pd" };
        let own = if is_single { "sd" } else { packed };
        let word = if shape.is_evex { "d" } else { "" };
        let r = |r| self.reg(r);
        let moving = if is_single { "vmovsd".to_string() } else { format!("vmovu{packed}") };
        match *instruction {
            Load { d, m } => match self.rm(Rm::Mem(m)) {
                text if text.contains("BCST") => {
                    format!("vbroadcasts{} {},{}", &packed[1..], r(d), text.replace("BCST", "PTR"))
                }
                text => format!("{moving} {},{text}", r(d)),
            },
            Store { m, s } => format!("{moving} {},{}", self.mem(m, shape.width, false), r(s)),
            Move { d, s } => format!("vmova{packed} {},{}", r(d), r(s)),
            Two { what, d, a, b } => {
                let name = match what {
                    Do::Xor => format!("vxor{packed}"),
                    Do::And => format!("vand{packed}"),
                    Do::AddBits => "vpaddd".into(),
                    what => format!("v{}{own}", format!("{what:?}").to_lowercase()),
                };
                format!("{name} {},{},{}", r(d), r(a), self.rm(b))
            }
            Sqrt { d, a } if is_single => {
                let second = if let Rm::Reg(a) = a { a } else { d };
                format!("vsqrtsd {},{},{}", r(d), r(second), self.rm(a))
            }
            Sqrt { d, a } => format!("vsqrt{packed} {},{}", r(d), self.rm(a)),
            Up { d, a, by } => format!("vpslld {},{},{by:#x}", r(d), r(a)),
            Down { d, a, by } => format!("vpsrld {},{},{by:#x}", r(d), r(a)),
            Instruction::Fused { what, form, d, v, rm } => {
                let name = match what {
                    Fused::MulAdd => "vfmadd",
                    Fused::NegMulAdd => "vfnmadd",
                    Fused::MulSub => "vfmsub",
                };
                format!("{name}{}{packed} {},{},{}", &format!("{form:?}")[1..], r(d), r(v), self.rm(rm))
            }
            Compare { k, a, b, relation } => {
                format!("vcmp{}{own} k{k},{},{}", relation_name(relation), r(a), self.rm(b))
            }
            CompareInto { d, a, b, relation } => {
                format!("vcmp{}{own} {},{},{}", relation_name(relation), r(d), r(a), self.rm(b))
            }
            Test { k, a, b, share } => format!("vptest{}md k{k},{},{}", if share { "" } else { "n" }, r(a), self.rm(b)),
            Blend { d, k, no, yes } => {
                let yes = match yes {
                    Rm::Mem(m) if is_single => self.mem(m, 8, true),
                    yes => self.rm(yes),
                };
                format!("vblendm{packed} {}{{k{k}}},{},{yes}", r(d), r(no))
            }
            Where { d, k, m } if is_single => format!("vmovsd {}{{k{k}}}{{z}},{}", r(d), self.mem(m, 8, false)),
            Where { d, k, m } => {
                format!(
                    "vbroadcasts{} {}{{k{k}}}{{z}},{}",
                    &packed[1..],
                    r(d),
                    self.mem(m, shape.element_size(), false)
                )
            }
            Flip { d, b, c } => format!("vpternlog{word} {},{},{},0x78", r(d), r(b), self.rm(c)),
            BlendBy { d, by, no, yes } => format!("vblendv{packed} {},{},{},{}", r(d), r(no), self.rm(yes), r(by)),
            Call { .. } | Invoke { .. } => unreachable!("in whole programs alone"),
        }
    }
}

fn relation_name(relation: Relation) -> &'static str {
    match relation {
        Relation::Less => "lt_oq",
        Relation::Greater => "gt_oq",
        Relation::NotLess => "nlt_uq",
        Relation::NotGreater => "ngt_uq",
    }
}

/// A whole program of six arrays: addresses, a call of a function, the loop, the way back; behind it the function, which calls one
/// that is not the program's, and with tapes another one. A line each instruction.
fn whole(shape: Shape) -> Vec<String> {
    let load = |base: &str, at: usize| format!("mov {base},QWORD PTR [rdi+{at:#x}]");
    let arrays = || ["rdx", "rsi", "r8", "r9", "r10", "r11"].into_iter().zip((32..).step_by(8));
    let both = || [load("rax", 0), load("rcx", 8)];
    let all = || arrays().map(|(base, at)| load(base, at));
    let lines = |text: &str| text.lines().map(String::from).collect::<Vec<_>>();
    let (room, give) = ("sub rsp,0x8", "add rsp,0x8");
    let row = |k: usize| format!("{:#x}", k * shape.width);
    let mut text =
        [both().to_vec(), all().collect(), lines(&format!("lea rdx,[rcx+{}]\ncall +0", row(2 + 1)))].concat();
    text.extend(all());
    if shape.width > 8 {
        text.extend(arrays().map(|(_, at)| format!("add QWORD PTR [rdi+{at:#x}],{:#x}", shape.width)));
        text.extend(lines("dec QWORD PTR [rdi+0x18]\njne 0x0"));
    }
    text.extend(lines(&format!("vzeroupper\nret\n{room}")));
    // a call that is not the program's
    text.extend(lines(&format!("vzeroupper\npush rdx\n{room}\npush rdi\nmov esi,0x8\ncall QWORD PTR [rdi+0x10]")));
    text.extend(lines(&format!("pop rdi\n{give}\npop rdx")));
    text.extend(both());
    // tapes: a part of its own, and slots, which stand behind what both functions are passed
    text.extend(lines(&format!("add rdx,{0}\ncall +1\nsub rdx,{0}", row(2))));
    text.extend(lines(&format!("push rdx\n{room}\nlea rdx,[rcx+{}]\ncall +1\n{give}\npop rdx", row(2 + 9 + 3 + 3))));
    text.extend(lines(&format!("call +1\n{give}\nret")));
    text.extend(lines(&format!("{room}\n{give}\nret")));
    text
}

/// Its bytes.
fn whole_bytes(shape: Shape) -> Vec<u8> {
    let invoke = |function, tape| Instruction::Invoke { function, tape };
    let slots = |instructions, n_slot| Allocated { n_slot, ..part(instructions) };
    let program = slots(vec![invoke(0, Some(TapeAt::Slot(1)))], 9);
    let tapes = [Some(TapeAt::Own(2)), Some(TapeAt::Slot(3)), None].map(|tape| invoke(1, tape));
    let first = slots([&[Instruction::Call { number: 7 }], &tapes[..]].concat(), 10);
    encoded(&[program, first, slots(vec![], 0)], shape, &[3, 4])
}

/// All forms of all shapes, a line each.
fn all_forms() -> String {
    let mut text = String::new();
    for (name, shape) in SHAPES {
        text += &format!("# {name}\n");
        for instruction in forms(shape) {
            let hex: String = bytes(instruction, shape).iter().map(|byte| format!("{byte:02x}")).collect();
            text += &format!("{hex} {}\n", Text(shape).of(&instruction));
        }
        let hex: String = whole_bytes(shape).iter().map(|byte| format!("{byte:02x}")).collect();
        text += &format!("# whole: {hex}\n");
    }
    text
}

#[test]
fn every_form_of_every_instruction_has_its_bytes() {
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("native/tests/forms.txt");
    let now = all_forms();
    if std::env::var_os("OMNIDRONES_WRITE_GOLDEN").is_some() {
        std::fs::write(&golden, &now).unwrap();
    }
    let text = std::fs::read_to_string(&golden).unwrap();
    for (now, golden) in now.lines().zip(text.lines()) {
        assert_eq!(now, golden);
    }
    assert_eq!(now.lines().count(), text.lines().count(), "forms");
}

/// Run by `.ci/nightly`: objdump reads the bytes back as what the text says.
#[test]
#[ignore = "needs objdump: cargo test -p omnidrones-autodiff --lib a_disassembler_reads -- --ignored"]
fn a_disassembler_reads_what_the_encoder_meant() {
    let forms = all_forms();
    let forms: Vec<(&str, &str)> =
        forms.lines().filter(|line| !line.starts_with('#')).map(|line| line.split_once(' ').unwrap()).collect();
    let byte = |hex: &str| u8::from_str_radix(hex, 16).unwrap();
    let code: Vec<u8> =
        forms.iter().flat_map(|(hex, _)| (0..hex.len() / 2).map(move |k| byte(&hex[2 * k..2 * k + 2]))).collect();
    let read = disassembled(&code);
    for ((hex, meant), read) in forms.iter().zip(&read) {
        assert_eq!(meant, read, "{hex}");
    }
    assert_eq!(forms.len(), read.len(), "instructions");
    for (name, shape) in SHAPES {
        let (code, text) = (whole_bytes(shape), whole(shape));
        let starts = functions(&code);
        let meant = |line: &str| match line.strip_prefix("call +") {
            Some(number) => format!("call {:#x}", starts[number.parse::<usize>().unwrap()]),
            None => line.to_string(),
        };
        assert_eq!(disassembled(&code), text.iter().map(|line| meant(line)).collect::<Vec<_>>(), "{name}");
    }
}

/// Where functions begin: behind a way back, with room on the stack.
fn functions(code: &[u8]) -> Vec<usize> {
    let begin = [0xC3, 0x48, 0x83, 0xEC, 8];
    code.windows(begin.len()).enumerate().filter(|(_, bytes)| **bytes == begin).map(|(at, _)| at + 1).collect()
}

/// What objdump reads, an instruction each.
fn disassembled(code: &[u8]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("code");
    std::fs::write(&file, code).unwrap();
    let arguments = ["-D", "-b", "binary", "-m", "i386:x86-64", "-M", "intel", "--no-show-raw-insn"];
    let output = Command::new("objdump").args(arguments).arg(&file).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let instruction = |line: &str| {
        let (address, text) = line.split_once(":\t")?;
        let words = text.split_whitespace().filter(|word| *word != "{evex}").collect::<Vec<_>>().join(" ");
        address.trim().chars().all(|c| c.is_ascii_hexdigit()).then_some(words)
    };
    text.lines().filter_map(instruction).collect()
}
