//! An earlier flight beside the one that was flown: read from its file, drawn, compared.

use crate::prelude::*;
use omnidrones::flight::{FlightLog, FlightSummary};
use omnidrones_plot::Figure;
use omnidrones_plot::compare_flights::{Named, beside};

/// What the new flight is called.
const NEW: &str = "this flight";
/// Longest name of an earlier one in a legend, characters.
const LONGEST: usize = 40;

/// An earlier flight.
pub(super) struct Beside {
    file: PathBuf,
    log: FlightLog,
}

/// What two flights compare.
pub(super) struct Comparison {
    file: PathBuf,
    name: String,
    /// The earlier one.
    earlier: FlightSummary,
    /// By how much the references are apart where both flights have a sample, m.
    apart: f64,
}

impl Beside {
    /// Reads a file that `fly --csv` wrote.
    pub fn read(file: &Path) -> Result<Self> {
        files::check_there(file)?;
        let end = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if let Some(end) = end.filter(|end| matches!(end.as_str(), "npz" | "mcap")) {
            return Err(Error::Format {
                file: file.display().to_string(),
                place: "the file".into(),
                rule: format!("is {end}, not CSV"),
                remedy: "Name a flight.csv: omnidrones fly --csv writes what is read.".into(),
            });
        }
        Ok(Self { file: file.to_path_buf(), log: FlightLog::read_csv(file)? })
    }

    /// Both flights in one figure.
    pub fn figure(&self, log: &FlightLog) -> Figure {
        beside(Named { name: NEW, log }, Named { name: &self.name(), log: &self.log })
    }

    /// Against the key figures of `log` over t ≥ `after`, s.
    pub fn compare(self, log: &FlightLog, after: f64) -> Comparison {
        Comparison {
            name: self.name(),
            earlier: self.log.summary(after),
            apart: apart(log, &self.log),
            file: self.file,
        }
    }

    /// Its folder and its name: files of flights are all called alike.
    fn name(&self) -> String {
        let mut parts: Vec<String> =
            self.file.components().rev().take(2).map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
        parts.reverse();
        let name = parts.join("/");
        let surplus = name.chars().count().saturating_sub(LONGEST);
        if surplus > 0 { format!("…{}", name.chars().skip(surplus).collect::<String>()) } else { name }
    }
}

/// Largest distance between the references at the times that both flights have, m.
fn apart(a: &FlightLog, b: &FlightLog) -> f64 {
    let mut most = 0.0_f64;
    for (time, here) in b.time.iter().zip(&b.reference_position) {
        let at = a.time.partition_point(|t| *t < time - 1e-9);
        if a.time.get(at).is_some_and(|t| (t - time).abs() < 1e-9) {
            let there = a.reference_position[at];
            most = most.max((0..3).map(|k| (here[k] - there[k]).powi(2)).sum::<f64>().sqrt());
        }
    }
    most
}

impl Comparison {
    pub fn page(&self, page: &mut Page, flight: &FlightSummary) {
        let mut table = Table::new("flight | >tracking RMSE | >largest error | >largest tilt");
        for (name, s) in [(NEW, flight), (self.name.as_str(), &self.earlier)] {
            let tilt = format!("{}°", number(s.max_tilt.map(f64::to_degrees), 1));
            table.row([name.to_string(), length(s.rmse), length(s.max_error), tilt]);
        }
        let change = |new: Option<f64>, old: Option<f64>| match (new, old) {
            (Some(new), Some(old)) if old > 0.0 => format!("{:+.1} %", 100.0 * (new / old - 1.0)),
            _ => "–".into(),
        };
        let e = &self.earlier;
        let changes = [(flight.rmse, e.rmse), (flight.max_error, e.max_error), (flight.max_tilt, e.max_tilt)]
            .map(|(a, b)| change(a, b));
        table.row(std::iter::once("change".to_string()).chain(changes));
        page.heading("Beside an earlier flight").table(table);
        if flight.rmse_after > 0.0 {
            page.line(format!("  errors after the first {} s of each", flight.rmse_after));
        }
        if self.apart > 1e-6 {
            let far = length(self.apart);
            page.line(format!("  their references differ, by up to {far}: each error is against its own"));
        }
        if e.duration != flight.duration {
            page.line(format!("  the earlier one took {} s", short(e.duration, 4)));
        }
    }

    pub fn json(&self) -> Value {
        json!({ "file": self.file.display().to_string(), "flight": self.earlier, "references_apart": self.apart })
    }
}
