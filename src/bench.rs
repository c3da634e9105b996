//! Stand-in until the bench harness is merged.

/// What to measure.
#[derive(Debug, Clone, Default)]
pub struct BenchPlan {
    /// Shorter runs.
    pub quick: bool,
    /// Threads of the batch rows.
    pub threads: Vec<usize>,
}

/// One measurement.
#[derive(Debug, Clone, serde::Serialize)]
pub struct BenchRow {
    /// What kind.
    pub group: &'static str,
    /// Of what.
    pub name: String,
    /// How much.
    pub value: f64,
    /// In this unit.
    pub unit: &'static str,
    /// Against the baseline.
    pub ratio: Option<f64>,
    /// What the ratio is against.
    pub baseline: &'static str,
}

/// Runs everything.
pub fn run(_plan: &BenchPlan, mut progress: impl FnMut(&str)) -> crate::error::Result<Vec<BenchRow>> {
    progress("step");
    let row = |group, name: &str, value, unit, ratio| BenchRow {
        group,
        name: name.into(),
        value,
        unit,
        ratio,
        baseline: "plain f64 loop",
    };
    Ok(vec![
        row("step", "f64", 5.0, "M steps/s", Some(1.0)),
        row("step", "f32x16 lanes", 65.0, "M steps/s", Some(13.0)),
        row("gradient", "Jacobian 17 × 21", 5.3, "µs", None),
    ])
}
