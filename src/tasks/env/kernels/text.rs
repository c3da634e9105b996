//! The kernels: programs of a batch as functions, and what the host does between them on a batch.

use super::draws::{NORMAL_WITHIN, drawn, number, whole};
use super::{EnvKernel, EnvKernels, rows};
use crate::config::Autoreset;
use crate::env::block::{beginning, episode_state, signal};
use crate::env::core::Core;
use crate::env::draw_plan::Plan;
use crate::env::layout::Part;
use crate::env::programs::{KEPT, WORK};
use crate::env::restart::{DELAY, EASIER, STAGGER, TRUNCATE};
use crate::env::transition::StepLayout;
use crate::start::{Episode, WORDS_OF_EVENT, purpose_of_event, purpose_of_start};
use autodiff::emit::{CText, ExportPrecision, literal};
use autodiff::native::{Place, RowLayout};
use autodiff::{Program, Recording};
use base::error::Result;
use dynamics::batch::STOPPED;
use rng::{Purpose, device_text};
use std::fmt::Write;
use std::ops::Range;

/// What functions of one environment take.
const OF_ONE: &str = "const od_env &e, const uint32_t i";

/// All of an environment's kernels.
pub(super) fn kernels(core: &Core) -> Result<EnvKernels> {
    let mut own = Writer { core, text: CText::cuda("od"), n_of_step: 0 };
    own.text.add(&device_text());
    own.text.add(NORMAL_WITHIN);
    own.programs()?;
    let mut kernels = vec![EnvKernel::Step];
    own.helpers();
    own.step();
    if core.programs().event.is_some() {
        own.event();
        kernels.push(EnvKernel::Event);
    }
    if core.sizes.normalised > 0 {
        own.collect();
        kernels.push(EnvKernel::Collect);
    }
    own.begin();
    own.observe();
    own.tape();
    kernels.extend([EnvKernel::Begin, EnvKernel::Observe, EnvKernel::Open, EnvKernel::Close]);
    Ok(EnvKernels::of(core, own.text.finished(), kernels))
}

/// Instructions of a step to which 128 registers suffice: four blocks of threads then run side by side on each processor of a card.
const SHORT: usize = 2000;

struct Writer<'a> {
    core: &'a Core,
    text: CText,
    /// Instructions of a step.
    n_of_step: usize,
}

fn float(x: f64) -> String {
    literal(x, ExportPrecision::Single)
}

/// A number of environment `i`.
fn at(array: &str, row: impl std::fmt::Display) -> String {
    format!("e.{array}[{row} * e.stride + i]")
}

/// A number of the actions of the caller.
fn action(k: usize) -> String {
    format!("e.action[(int64_t)i * e.action_environment + {k} * e.action_number]")
}

fn place(place: Place) -> String {
    let Place { array, row } = place;
    match array {
        0 => at("plant", row),
        KEPT => at("kept", row),
        WORK => at("work", row),
        3 => format!("e.shared[{row}]"),
        _ => at("model", row),
    }
}

impl Writer<'_> {
    fn kept(&self, row: usize) -> String {
        at("kept", self.core.layout.kept.episode_state.range().start + row)
    }

    fn signal(&self, row: usize) -> String {
        at("work", self.core.layout.work.signals.range().start + row)
    }

    fn beginning(&self, row: usize) -> String {
        at("work", self.core.layout.work.beginning.range().start + row)
    }

    fn alive(&self) -> String {
        at("plant", self.core.plant.alive_row())
    }

    /// A function of one environment.
    fn function(&mut self, name: &str, body: &str) {
        self.text.add(&format!("od_own void od_{name}({OF_ONE})\n{{\n{body}}}\n"));
    }

    fn kernel(&mut self, kernel: EnvKernel, body: &str) {
        let count = if kernel == EnvKernel::Collect { "od_collected" } else { "od_environments" };
        // steps alone run all the time
        let is_short = kernel == EnvKernel::Step && self.n_of_step <= SHORT;
        let blocks = if is_short { 4 } else { 1 };
        self.text.add(&format!("OD_KERNEL({}, od_env, {count}, {blocks})\n{{\n{body}}}\n", kernel.name()));
    }

    /// The programs that a batch runs, in place.
    fn programs(&mut self) -> Result<()> {
        let programs = self.core.programs();
        // actions are read where the caller has them
        let (actions, is_whole) = (self.core.layout.work.action.range(), self.core.control.levels().is_some());
        let of_caller = |own: Place| {
            let k = (own.row as usize).checked_sub(actions.start).filter(|k| own.array == WORK && *k < actions.len());
            match k {
                Some(k) if !is_whole => action(k),
                _ => place(own),
            }
        };
        let (recording, layout) = programs.step.recorded();
        self.n_of_step = self.program("program_step", recording, layout, of_caller)?;
        for (name, program) in [
            ("program_observe", Some(&programs.observe)),
            ("program_start", Some(&programs.start)),
            ("program_event", programs.event.as_ref()),
        ] {
            if let Some(program) = program {
                let (recording, layout) = program.recorded();
                self.program(name, recording, layout, place)?;
            }
        }
        if let Some(stages) = &programs.transform {
            let (recording, layout) = stages.recorded();
            let of_agent = |own: Place| self.core.place_of_stage(own, "agent");
            let places = [layout.arguments(), layout.results()].map(|own| own.iter().copied().map(of_agent).collect());
            let parameters = format!("{OF_ONE}, const uint32_t agent");
            self.text.function_over(&Program::compile(recording)?, "stages", &parameters, places)?;
        }
        Ok(())
    }

    fn program(
        &mut self,
        name: &str,
        recording: &Recording,
        layout: &RowLayout,
        place: impl Fn(Place) -> String,
    ) -> Result<usize> {
        let places = [layout.arguments(), layout.results()].map(|own| own.iter().copied().map(&place).collect());
        let own = self.text.function_over(&Program::compile(recording)?, name, OF_ONE, places)?;
        Ok(own.n_instruction)
    }

    fn helpers(&mut self) {
        let (core, layout) = (self.core, &self.core.layout);
        let mut stages = String::from("    (void)e, (void)i, (void)moved, (void)fresh;\n");
        if !core.pipeline.is_empty() {
            stages = self.transformed();
        }
        let parameters = format!("{OF_ONE}, const float moved, const float fresh");
        self.text.add(&format!("od_own void od_transformed({parameters})\n{{\n{stages}}}\n"));

        let mut clear = String::from("    e.terminated[i] = 0, e.truncated[i] = 0;\n");
        let _ = writeln!(clear, "    {} = 0.0f;", self.signal(signal::REWARD));
        (0..core.sizes.info).for_each(|k| clear += &format!("    {} = 0.0f;\n", at("info", k)));
        self.function("clear", &clear);

        let mut difficulty = String::from("    double difficulty = e.difficulty;\n");
        if core.easier != 0.0 {
            let open = opened(EASIER);
            let _ = writeln!(
                difficulty,
                "{open}    const double share = od_unit(&own) / {:?};\n    difficulty *= share < 1.0 ? share : 1.0;",
                core.easier
            );
        }
        let _ = writeln!(difficulty, "    {} = (float)difficulty;", self.beginning(beginning::DIFFICULTY));
        difficulty += "    (void)seed, (void)environment, (void)episode;\n";
        let keys = "const uint64_t seed, const uint64_t environment, const uint64_t episode";
        self.text.add(&format!("od_own void od_difficulty({OF_ONE}, {keys})\n{{\n{difficulty}}}\n"));

        let speeds: String = rows(layout.work.speeds)
            .zip(&core.speed_rows)
            .map(|(row, speed)| format!("    {} = {};\n", at("work", row), at("plant", speed)))
            .collect();
        self.function("keep_speeds", &speeds);
    }

    /// Observations through their stages.
    fn transformed(&self) -> String {
        let (core, s, layout) = (self.core, &self.core.sizes, &self.core.layout);
        let mut text = String::new();
        let common = rows(layout.work.common);
        let _ = writeln!(text, "    {} = moved, {} = fresh;", at("work", common.start), at("work", common.start + 1));
        for (row, theta) in common.skip(2).zip(rows(layout.kept.theta)) {
            let _ = writeln!(text, "    {} = {};", at("work", row), at("kept", theta));
        }
        let noise = rows(layout.work.noise);
        if !noise.is_empty() {
            let position = format!("{} * (uint64_t){}", 4 * noise.len(), self.kept(episode_state::STEP));
            let _ = writeln!(
                text,
                "    od_words own;\n    od_open(&own, e.seed[i], e.first_environment + i, e.episode[i], {}, {position});",
                whole(Purpose::SENSORS.0)
            );
            let row = at("work", format!("({} + k)", noise.start));
            let _ =
                writeln!(text, "    for (uint32_t k = 0; k < {}; k++) {row} = (float)od_normal(&own);", noise.len());
        }
        let (raw, shown) = (rows(layout.work.raw).start, rows(layout.work.observation).start);
        let from = at("work", format!("({raw} + agent * {} + k)", s.raw));
        let to = at("work", format!("({shown} + agent * {} + k)", s.observation));
        let _ = writeln!(
            text,
            "    for (uint32_t agent = 0; agent < {}; agent++) {{\n        for (uint32_t k = 0; k < {}; k++) {to} = {from};\n        \
             od_stages(e, i, agent);\n    }}",
            s.agent, s.raw
        );
        let seen = rows(layout.work.seen);
        if !seen.is_empty() {
            let row = at("work", format!("({} + k)", seen.start));
            let _ = writeln!(
                text,
                "    float sound = 0.0f; /* 0 where all is finite, else NaN */\n    \
                 for (uint32_t k = 0; k < {}; k++) sound += 0.0f * {row};\n    \
                 e.seen[i] = e.collects != 0u && moved > 0.5f && sound == 0.0f;",
                seen.len()
            );
        }
        let _ = core;
        text
    }

    fn step(&mut self) {
        let (core, layout) = (self.core, &self.core.layout);
        let mut text = format!("    const int running = {} > 0.5f;\n", self.kept(episode_state::RUNNING));
        text += &self.decoded();
        text += "    od_program_step(e, i);\n";
        let rest = core.robot().rest().iter().enumerate();
        let rest: String = rest.map(|(k, x)| format!("        {} = {};\n", at("plant", k), float(*x))).collect();
        let _ = writeln!(text, "    if (running && !({} > 0.5f)) {{\n{rest}    }}", self.alive());
        let _ = writeln!(
            text,
            "    const int terminated = {} > 0.5f, truncated = {} > 0.5f;",
            self.signal(signal::TERMINATED),
            self.signal(signal::TRUNCATED)
        );
        text += "    const int ended = running && (terminated || truncated);\n";
        let _ = writeln!(text, "    const int due = running && !ended && {} > 0.5f;", self.signal(signal::DUE));
        text += "    e.terminated[i] = (uint8_t)terminated, e.truncated[i] = (uint8_t)truncated, e.due[i] = (uint8_t)due;\n";
        let restart = match core.mode {
            Autoreset::SameStep => "ended",
            Autoreset::NextStep => "!running",
            Autoreset::Disabled => "0",
        };
        let _ = writeln!(text, "    e.restart[i] = (uint8_t)({restart});");
        for (k, own) in core.told.places().iter().enumerate() {
            let _ = writeln!(text, "    {} = {};", at("info", k), place(*own));
        }
        let is_due = if core.programs().event.is_some() { "due" } else { "0" };
        let _ = writeln!(text, "    if (!{is_due}) od_transformed(e, i, running ? 1.0f : 0.0f, 0.0f);");
        let shown = if core.pipeline.is_empty() { layout.work.raw } else { layout.work.observation };
        let ends: String = [(shown, "final_observation"), (layout.work.central, "final_central")]
            .into_iter()
            .map(|(part, name)| copied(part, name))
            .collect();
        let _ = writeln!(text, "    if (ended) {{\n{ends}    }}");
        self.kernel(EnvKernel::Step, &text);
    }

    /// Whole numbers into commands.
    fn decoded(&self) -> String {
        let (core, control) = (self.core, &self.core.control);
        let Some(levels) = control.levels() else { return String::new() };
        let (n, n_action) = (control.n_command, control.n_action());
        let joint = n_action == 1 && n > 1;
        let most = if joint { levels.pow(n as u32) } else { levels } - 1;
        let command = rows(core.layout.work.command).start;
        let mut text = String::from("    float changed = 0.0f;\n");
        for agent in 0..control.n_command_of.len() {
            for k in 0..n_action.min(control.n_command_of[agent]) {
                let _ = writeln!(
                    text,
                    "    {{\n        const float own = {};\n        \
                     float whole = roundf(own);\n        whole = whole < 0.0f ? 0.0f : whole > {most} ? {most} : whole;\n        \
                     changed += own != whole ? 1.0f : 0.0f;\n        const int finite = fabsf(own) <= {largest};\n        \
                     uint32_t rest = finite ? (uint32_t)whole : 0u;",
                    action(agent * n_action + k),
                    most = float(most as f64),
                    largest = float(f64::from(f32::MAX)),
                );
                let of_one: Vec<usize> = if joint { (0..n).rev().collect() } else { vec![k] };
                for digit in of_one {
                    let row = at("work", command + agent * n + digit);
                    let safe = float(control.safe[agent * n + digit]);
                    let _ = writeln!(
                        text,
                        "        {row} = finite ? 2.0f * (float)(rest % {levels}u) / {} - 1.0f : {safe};\n        rest /= {levels}u;",
                        float((levels - 1) as f64)
                    );
                }
                text += "    }\n";
            }
        }
        let _ = writeln!(text, "    {} = changed;", self.kept(episode_state::CLIPPED));
        text
    }

    fn event(&mut self) {
        let core = self.core;
        let mut text = String::from("    if (!e.due[i]) return;\n");
        text += KEYS;
        if core.task.start_on_host().is_some() {
            let _ = writeln!(text, "    {} = 2.0f;\n    od_program_event(e, i);", self.beginning(beginning::WHERE));
        } else {
            text += "    od_difficulty(e, i, seed, environment, episode);\n";
            let position = format!("{WORDS_OF_EVENT} * (uint64_t){}", self.kept(episode_state::STEP));
            let key = |stream| ["episode".into(), whole(purpose_of_event(stream).0)];
            text += &self.drawn(&core.plans.event, key, &position, "od_program_event");
        }
        text += "    od_transformed(e, i, 1.0f, 0.0f);\n";
        self.kernel(EnvKernel::Event, &text);
    }

    fn drawn(&self, plan: &Plan, key: impl Fn(usize) -> [String; 2], position: &str, run: &str) -> String {
        let draws = rows(self.core.layout.work.draws).start;
        let places = [self.beginning(beginning::WHERE), self.beginning(beginning::ACCEPTED)];
        drawn(plan, key, position, |k| at("work", draws + k), run, [&places[0], &places[1]])
    }

    fn begin(&mut self) {
        let (core, layout) = (self.core, &self.core.layout);
        let mut text = String::new();
        if core.mode != Autoreset::SameStep {
            // behind what a tape keeps of the step
            let (running, alive, stopped) =
                (self.kept(episode_state::RUNNING), self.alive(), float(f64::from(STOPPED)));
            let _ = writeln!(
                text,
                "    if (e.stops && {running} > 0.5f && (e.terminated[i] || e.truncated[i])) {running} = 0.0f, {alive} = {stopped};"
            );
        }
        text += "    if (!e.restart[i]) {\n";
        text += if core.sizes.normalised > 0 { "        e.seen[i] = 0;\n" } else { "" };
        // a caller's reset, which no gradient crosses
        text += "        return;\n    }\n    if (!e.stops) e.moved[i] = 1;\n    e.episode[i] += 1u;\n";
        text += KEYS;
        text += &self.counted();
        for row in rows(layout.kept.history) {
            let _ = writeln!(text, "    {} = 0.0f;", at("kept", row));
        }
        if core.task.start_on_host().is_some() {
            let _ = writeln!(text, "    {} = 2.0f;\n    od_program_start(e, i);", self.beginning(beginning::WHERE));
        } else {
            text += "    od_difficulty(e, i, seed, environment, episode);\n";
            let key = |stream| {
                let (episode, purpose) = purpose_of_start(stream);
                let episode = match episode {
                    Episode::Own => "episode".into(),
                    Episode::Fixed(number) => whole(number),
                };
                [episode, whole(purpose.0)]
            };
            text += &self.drawn(&core.plans.start, key, "0", "od_program_start");
        }
        text += "    od_transformed(e, i, 1.0f, 1.0f);\n    if (e.clears) od_clear(e, i);\n";
        self.kernel(EnvKernel::Begin, &text);
    }

    /// What an episode has in whole numbers of steps.
    fn counted(&self) -> String {
        let core = self.core;
        let horizon = core.task.horizon();
        let (offset, last) = (self.kept(episode_state::OFFSET), self.kept(episode_state::LAST));
        let mut text = format!("    {offset} = 0.0f;\n");
        if core.stagger {
            let draw = format!("(float)od_below(&own, {})", whole(horizon as u64));
            let _ = writeln!(text, "    if (episode == 1u) {{\n{}    {offset} = {draw};\n    }}", opened(STAGGER));
        }
        let _ = writeln!(text, "    {last} = {} - {offset};", float(horizon as f64));
        if core.truncate_after != 0 {
            let scale = number((-1.0 / core.truncate_after as f64).ln_1p());
            let _ = writeln!(
                text,
                "    {{\n{}    const double left = {last}, drawn = ceil(od_ln(1.0 - od_unit(&own)) / {scale});\n    \
                 {last} = (float)(drawn < 1.0 ? 1.0 : drawn > left ? left : drawn);\n    }}",
                opened(TRUNCATE)
            );
        }
        let (delay, (least, most)) = (self.kept(episode_state::DELAY), core.delay);
        if least == most {
            let _ = writeln!(text, "    {delay} = {};", float(least as f64));
        } else {
            let draw = format!("(float)({least}u + od_below(&own, {}))", whole((most - least) as u64 + 1));
            let _ = writeln!(text, "    {{\n{}    {delay} = {draw};\n    }}", opened(DELAY));
        }
        text
    }

    fn observe(&mut self) {
        let text = "    od_keep_speeds(e, i);\n    od_program_observe(e, i);\n    od_transformed(e, i, 0.0f, 0.0f);\n";
        self.kernel(EnvKernel::Observe, text);
    }

    /// What a tape keeps of a step: before it, and behind it.
    fn tape(&mut self) {
        let (core, p) = (self.core, StepLayout::of(self.core));
        let (kept, work) = (&core.layout.kept, &core.layout.work);
        let copy = |text: &mut String, to: &Range<usize>, from: &dyn Fn(usize) -> String| {
            to.clone().zip(0..).for_each(|(row, k)| *text += &format!("    {} = {};\n", at("tape", row), from(k)));
        };
        let mut text = String::new();
        let _ = writeln!(
            text,
            "    e.tape_running[i] = {} > 0.5f, e.tape_moved[i] = e.moved[i], e.moved[i] = 0;",
            self.kept(episode_state::RUNNING)
        );
        copy(&mut text, &p.state, &|k| at("plant", k));
        for (place, part) in p.of_kept(kept) {
            copy(&mut text, &place, &|k| at("kept", rows(part).start + k));
        }
        copy(&mut text, &p.time, &|k| self.kept(StepLayout::CLOCK[k]));
        self.kernel(EnvKernel::Open, &text);

        let mut text = String::new();
        let _ = writeln!(
            text,
            "    e.tape_ended[i] = e.tape_running[i] && (e.terminated[i] || e.truncated[i]);\n    \
             e.tape_running[i] = e.tape_running[i] && {} > 0.5f;",
            self.alive()
        );
        copy(&mut text, &p.action, &action);
        for (place, name, part) in [
            (&p.next_goal, "kept", kept.goal),
            (&p.readings, "kept", kept.readings),
            (&p.estimate, "kept", kept.estimate),
            (&p.noise, "work", work.noise),
        ] {
            copy(&mut text, place, &|k| at(name, rows(part).start + k));
        }
        self.kernel(EnvKernel::Close, &text);
    }

    /// One thread for each block and number, in the order of the host.
    fn collect(&mut self) {
        let (s, n) = (&self.core.sizes, self.core.sizes.normalised);
        let seen = rows(self.core.layout.work.seen).start;
        self.text
            .add(&format!("od_own uint32_t od_collected(const od_env &e) {{ return (e.n + 63u) / 64u * {n}u; }}\n"));
        let row = format!("e.work[({seen} + agent * {n} + k) * e.stride + j]");
        let text = format!(
            "    const uint32_t block = i / {n}u, k = i % {n}u, end = e.n < 64u * block + 64u ? e.n : 64u * block + 64u;
    double *const own = e.sums + block * {width}u;
    double sum = own[1u + 2u * k], square = own[2u + 2u * k], count = 0.0;
    for (uint32_t agent = 0; agent < {agents}u; agent++) {{
        for (uint32_t j = 64u * block; j < end; j++) {{
            if (!e.seen[j]) continue;
            const double x = (double){row} - e.mean[k];
            sum += x, square += x * x, count += 1.0;
        }}
    }}
    own[1u + 2u * k] = sum, own[2u + 2u * k] = square;
    if (k == 0u) own[0] += count;
",
            width = 1 + 2 * n,
            agents = s.agent,
        );
        self.kernel(EnvKernel::Collect, &text);
    }
}

/// Seed, number and episode of an environment.
const KEYS: &str =
    "    const uint64_t seed = e.seed[i], environment = e.first_environment + i, episode = e.episode[i];\n";

/// A stream of a purpose alone, `own`.
fn opened(purpose: Purpose) -> String {
    format!("    od_words own;\n    od_open(&own, seed, environment, episode, {}, 0);\n", whole(purpose.0))
}

/// Rows of work into those of another array.
fn copied(part: Part, name: &str) -> String {
    rows(part).enumerate().map(|(k, row)| format!("        {} = {};\n", at(name, k), at("work", row))).collect()
}

impl Core {
    /// A number of a stage, of an agent: arrays are those of [`StageProgram`](crate::env::programs::StageProgram).
    fn place_of_stage(&self, own: Place, agent: &str) -> String {
        let (s, layout) = (&self.sizes, &self.layout);
        let (array, part, n) = match own.array {
            0 => ("work", layout.work.observation, s.observation),
            1 => ("kept", layout.kept.history, self.pipeline.memory),
            2 => ("work", layout.work.seen, s.normalised),
            3 => ("work", layout.work.noise, s.noise),
            4 => ("work", layout.work.common, 0),
            _ => return format!("e.shared[{}]", own.row),
        };
        let first = rows(part).start + own.row as usize;
        at(array, if n == 0 { format!("{first}") } else { format!("({first} + {agent} * {n})") })
    }
}
