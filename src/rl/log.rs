//! The course of a run: one line of numbers now and then, as JSON and as CSV of the same texts.
//!
//! ```text
//! <run>/log.jsonl    {"update":10,"env_steps":61440,"seconds":0.11,"loss":3.2,...}
//! <run>/curve.csv    update,env_steps,seconds,loss,...
//! ```
//!
//! A number that does not exist or is not finite is `null` in the one and empty in the other. A line is written as a whole
//! and flushed; a run that goes on from a checkpoint first cuts both files back to it.

use super::tensorboard::Events;
use base::error::{Error, Result};
use base::file_gate;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// File of the lines as JSON objects.
pub const JSON: &str = "log.jsonl";
/// File of the lines as a table.
pub const CSV: &str = "curve.csv";

/// Numbers by name, in order. The first is `update`. Two that do not exist are equal.
#[derive(Debug, Clone, Default)]
pub struct Line(Vec<(String, f64)>);

impl PartialEq for Line {
    fn eq(&self, other: &Self) -> bool {
        self.json() == other.json()
    }
}

impl Line {
    /// A line of this update.
    pub fn new(update: u64) -> Self {
        Self(vec![("update".into(), update as f64)])
    }

    /// With one more number; NaN for one that does not exist.
    pub fn put(&mut self, name: impl Into<String>, value: f64) {
        self.0.push((name.into(), value));
    }

    /// The number of that name, if there is one and it is finite.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.0.iter().find(|(own, _)| own == name).map(|(_, x)| *x).filter(|x| x.is_finite())
    }

    /// All names and numbers.
    pub fn iter(&self) -> impl Iterator<Item = (&str, f64)> {
        self.0.iter().map(|(name, x)| (name.as_str(), *x))
    }

    /// As a JSON object without line breaks.
    pub fn json(&self) -> String {
        let field = |(name, x): &(String, f64)| format!("{}:{}", serde_json::Value::from(name.as_str()), text(*x));
        format!("{{{}}}", self.0.iter().map(field).collect::<Vec<_>>().join(","))
    }

    fn cells(&self, names: &[String]) -> String {
        let cell = |name: &String| self.get(name).map_or(String::new(), text);
        names.iter().map(cell).collect::<Vec<_>>().join(",")
    }

    fn of_cells(names: &[String], cells: &str) -> Self {
        let number = |cell: &str| cell.parse().unwrap_or(f64::NAN);
        Self(names.iter().cloned().zip(cells.split(',').map(number)).collect())
    }
}

/// A number in the fewest digits that give it back; what is whole without a point.
fn text(x: f64) -> String {
    match x {
        x if !x.is_finite() => "null".into(),
        x if x.fract() == 0.0 && x.abs() < 9e15 => format!("{}", x as i64),
        x => serde_json::Value::from(x).to_string(),
    }
}

/// Most lines of a run that are kept in memory.
pub const CURVE: usize = 4096;

/// The course of a run in memory that does not grow for ever: every line at first, later every 2nd, 4th, … of those with an
/// evaluation and of those without, and the newest.
#[derive(Debug, Clone, Default)]
pub(crate) struct Curve {
    lines: Vec<Line>,
    /// Of lines without an evaluation and with one: how many there were, and how often they were halved.
    kinds: [(usize, u32); 2],
    /// Whether the newest line is there for that alone.
    passing: bool,
}

impl Curve {
    /// Adds a line.
    pub fn push(&mut self, line: Line) {
        if self.passing {
            self.lines.pop();
        }
        self.kinds[kind(&line)].0 += 1;
        self.lines.push(line);
        if self.lines.len() > CURVE {
            self.halve();
        }
        self.passing = self.lines.last().is_some_and(|last| {
            let (n, halvings) = self.kinds[kind(last)];
            !(n - 1).is_multiple_of(1 << halvings)
        });
    }

    /// Every 2nd line of the kind of which there are more, and the newest.
    fn halve(&mut self) {
        let evaluated = self.lines.iter().filter(|line| kind(line) == 1).count();
        let more = usize::from(2 * evaluated > self.lines.len());
        let (mut even, last) = (false, self.lines.pop());
        self.lines.retain(|line| {
            even ^= kind(line) == more;
            kind(line) != more || even
        });
        self.lines.extend(last);
        self.kinds[more].1 += 1;
    }

    /// What is kept, in order.
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// The last one that was added.
    pub fn newest(&self) -> Option<&Line> {
        self.lines.last()
    }
}

/// 1 for a line with an evaluation.
fn kind(line: &Line) -> usize {
    usize::from(line.get("eval_success").is_some())
}

impl FromIterator<Line> for Curve {
    fn from_iter<I: IntoIterator<Item = Line>>(lines: I) -> Self {
        let mut curve = Self::default();
        lines.into_iter().for_each(|line| curve.push(line));
        curve
    }
}

/// Both files, at their ends.
#[derive(Debug)]
pub(crate) struct Log {
    json: (File, PathBuf),
    csv: (File, PathBuf),
    /// Columns of the table; none before the first line.
    names: Vec<String>,
    events: Option<Events>,
}

impl Log {
    /// The files in `folder`, cut back to lines of updates up to `update`, and those lines; with `tensorboard`, events beside
    /// them.
    ///
    /// # Errors
    /// [`Error::File`] if they cannot be read or written.
    pub fn open(folder: &Path, update: u64, tensorboard: bool) -> Result<(Self, Curve)> {
        let (json, csv) = (folder.join(JSON), folder.join(CSV));
        let of_json = |line: &str| serde_json::from_str::<serde_json::Value>(line).ok()?["update"].as_u64();
        let of_csv = |line: &str| line.split(',').next()?.parse::<u64>().ok();
        cut(&json, 0, |line| of_json(line).is_some_and(|u| u <= update))?;
        let table = cut(&csv, 1, |line| of_csv(line).is_some_and(|u| u <= update))?;
        let (names, lines) = rows(&table, &csv)?;
        let events = tensorboard.then(|| Events::open(folder, update)).transpose()?;
        Ok((
            Self { json: (file_gate::append(&json)?, json), csv: (file_gate::append(&csv)?, csv), names, events },
            lines,
        ))
    }

    /// Adds a line to all.
    ///
    /// # Errors
    /// [`Error::File`] if the disk refuses.
    pub fn write(&mut self, line: &Line) -> Result<()> {
        let mut table = String::new();
        if self.names.is_empty() {
            self.names = line.iter().map(|(name, _)| name.to_string()).collect();
            table = self.names.join(",") + "\n";
        }
        table += &(line.cells(&self.names) + "\n");
        write(&mut self.json, &(line.json() + "\n"))?;
        write(&mut self.csv, &table)?;
        self.events.as_mut().map_or(Ok(()), |events| events.write(line))
    }

    /// Down to the medium.
    ///
    /// # Errors
    /// [`Error::File`] if the disk refuses.
    pub fn sync(&self) -> Result<()> {
        [&self.json, &self.csv]
            .into_iter()
            .try_for_each(|(file, path)| file.sync_data().map_err(|e| Error::file(path, e)))
    }
}

fn write((file, path): &mut (File, PathBuf), text: &str) -> Result<()> {
    file.write_all(text.as_bytes()).and_then(|()| file.flush()).map_err(|e| Error::file(path, e))
}

/// Leaves the first `head` lines and those behind them as long as they are whole and `keep` them; gives what is left.
fn cut(path: &Path, head: usize, keep: impl Fn(&str) -> bool) -> Result<String> {
    let bytes = file_gate::read_own(path, file_gate::MAX_LOG)?;
    let mut text = String::from_utf8_lossy(&bytes).into_owned();
    let whole = text.split_inclusive('\n').map_while(|line| line.strip_suffix('\n')).enumerate();
    let kept = whole.take_while(|(i, line)| *i < head || keep(line));
    let (n, length) = kept.fold((0, 0), |(n, length), (_, line)| (n + 1, length + line.len() + 1));
    // a head alone would fix the columns before the first line does
    text.truncate(if n <= head { 0 } else { length });
    if text.as_bytes() != bytes {
        file_gate::replace(path, &text)?;
    }
    Ok(text)
}

/// Most columns of a table that is read.
const MAX_COLUMNS: usize = 1000;

/// The columns of a table, and of its whole lines as many as a [`Curve`] keeps.
fn rows(text: &str, path: &Path) -> Result<(Vec<String>, Curve)> {
    let mut lines = text.split_inclusive('\n').map_while(|line| line.strip_suffix('\n'));
    let names = lines.next().map_or_else(Vec::new, |head| head.split(',').take(MAX_COLUMNS + 1).collect());
    if names.len() > MAX_COLUMNS {
        let what = format!("{}: number of columns", path.display());
        return Err(Error::limit(what, "more", MAX_COLUMNS, "It is no curve of a run: move it elsewhere."));
    }
    let names: Vec<String> = names.into_iter().map(String::from).collect();
    let curve = lines.map(|row| Line::of_cells(&names, row)).collect();
    Ok((names, curve))
}

/// The lines of a run: all, or of more than [`CURVE`] evenly spaced ones and the newest.
///
/// # Errors
/// [`Error::File`] if there is no such table in the folder, [`Error::Limit`] for one of more than 1 GiB or a thousand columns.
pub fn read(run: impl AsRef<Path>) -> Result<Vec<Line>> {
    let path = run.as_ref().join(CSV);
    let text = file_gate::read_text(&path, file_gate::MAX_LOG)?;
    let (_, curve) = rows(&text, &path)?;
    Ok(curve.lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(update: u64) -> Line {
        let mut line = Line::new(update);
        line.put("loss", 0.1 * update as f64);
        line.put("poisoned", f64::NAN);
        line.put("rate", 1e-7);
        line
    }

    #[test]
    fn a_forged_table_costs_no_memory_and_one_of_endless_columns_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let write = |text: &str| std::fs::write(folder.path().join(CSV), text).unwrap();
        let table = |columns: usize, lines: usize| {
            let head = (1..columns).map(|k| format!(",c{k}")).collect::<String>();
            let row = |k: usize| format!("{k}{}\n", ",0.5".repeat(columns - 1));
            format!("update{head}\n{}", (1..=lines).map(row).collect::<String>())
        };
        for (columns, lines) in [(1, 0), (1, 20_000), (3, CURVE), (MAX_COLUMNS, 2)] {
            write(&table(columns, lines));
            let all = read(folder.path()).unwrap();
            assert_eq!((all.len() == lines, all.len() <= CURVE), (lines <= CURVE, true), "{columns} {lines}");
            assert!(all.last().is_none_or(|last| last.get("update") == Some(lines as f64)));
            let (_, curve) = Log::open(folder.path(), u64::MAX, false).unwrap();
            assert_eq!(curve.lines(), all);
        }
        for columns in [MAX_COLUMNS + 1, 300_000] {
            write(&table(columns, 1));
            let refused = [read(folder.path()).map(drop), Log::open(folder.path(), u64::MAX, false).map(drop)];
            for refused in refused {
                let text = refused.unwrap_err().to_string();
                assert!(text.contains("number of columns is more, over the limit of 1000"), "{text}");
            }
        }
    }

    #[test]
    fn a_curve_of_a_million_lines_keeps_four_thousand_evenly_spaced_and_the_newest() {
        let mut curve = Curve::default();
        for k in 0..1_000_000_u64 {
            curve.push(Line::new(k));
            assert!(curve.lines().len() <= CURVE);
            if k % 9973 == 0 {
                assert_eq!(curve.newest().unwrap().get("update"), Some(k as f64));
            }
        }
        let at: Vec<f64> = curve.lines().iter().map(|line| line.get("update").unwrap()).collect();
        assert!(at.len() > CURVE / 2, "{}", at.len());
        let (even, newest) = at.split_at(at.len() - 1);
        assert_eq!((even[0], newest), (0.0, &[999_999.0][..]));
        assert!(even.windows(2).all(|pair| pair[1] - pair[0] == 256.0), "{:?}", &even[..4]);
    }

    #[test]
    fn a_thinned_curve_keeps_its_evaluations() {
        let mut curve = Curve::default();
        for k in 1..=100_000_u64 {
            let mut line = Line::new(k);
            if k % 10 == 0 {
                line.put("eval_success", 0.5);
            }
            curve.push(line);
            assert_eq!(curve.newest().unwrap().get("update"), Some(k as f64));
        }
        let all = curve.lines();
        let evaluated = all.iter().filter(|line| kind(line) == 1).count();
        println!("{} lines, {evaluated} of them with an evaluation", all.len());
        assert!(all.len() > CURVE / 3 && evaluated > CURVE / 8, "{} {evaluated}", all.len());
        assert!(all.windows(2).all(|pair| pair[0].get("update") < pair[1].get("update")));
    }

    #[test]
    fn both_files_hold_the_same_texts_and_give_the_lines_back() {
        let folder = tempfile::tempdir().unwrap();
        let (mut log, kept) = Log::open(folder.path(), u64::MAX, true).unwrap();
        assert!(kept.lines().is_empty());
        (1..4).for_each(|k| log.write(&line(k)).unwrap());
        log.sync().unwrap();
        let json = std::fs::read_to_string(folder.path().join(JSON)).unwrap();
        let csv = std::fs::read_to_string(folder.path().join(CSV)).unwrap();
        assert!(json.starts_with("{\"update\":1,\"loss\":0.1,\"poisoned\":null,\"rate\":1e-7}\n"), "{json}");
        assert!(csv.starts_with("update,loss,poisoned,rate\n1,0.1,,1e-7\n"), "{csv}");
        let back = read(folder.path()).unwrap();
        assert_eq!(back.len(), 3);
        assert_eq!((back[2].get("loss"), back[2].get("poisoned")), (Some(0.1 * 3.0), None));
    }

    #[test]
    fn a_log_is_cut_back_to_an_update_and_torn_lines_go() {
        let folder = tempfile::tempdir().unwrap();
        let (mut log, _) = Log::open(folder.path(), 0, true).unwrap();
        (1..6).for_each(|k| log.write(&line(k)).unwrap());
        drop(log);
        for (file, torn) in [(JSON, "{\"update\":3,\"lo"), (CSV, "3,0.")] {
            file_gate::append(&folder.path().join(file)).unwrap().write_all(torn.as_bytes()).unwrap();
        }
        let (mut log, kept) = Log::open(folder.path(), 3, true).unwrap();
        assert_eq!(kept.lines().iter().map(|l| l.get("update")).collect::<Vec<_>>(), [1.0, 2.0, 3.0].map(Some));
        log.write(&line(4)).unwrap();
        drop(log);
        let (_, kept) = Log::open(folder.path(), 9, true).unwrap();
        assert_eq!(kept.lines().len(), 4);
        let json = std::fs::read_to_string(folder.path().join(JSON)).unwrap();
        assert_eq!(json.lines().count(), 4);
        let (_, kept) = Log::open(folder.path(), 0, true).unwrap();
        assert!(kept.lines().is_empty() && std::fs::read(folder.path().join(CSV)).unwrap().is_empty());
    }

    #[test]
    fn lines_of_no_update_end_what_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (mut log, _) = Log::open(folder.path(), 0, true).unwrap();
        log.write(&line(1)).unwrap();
        file_gate::append(&folder.path().join(JSON)).unwrap().write_all(b"\xff\xfe\n[]\n").unwrap();
        log.write(&line(2)).unwrap();
        Log::open(folder.path(), 9, true).unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join(JSON)).unwrap().lines().count(), 1);
    }
}
