//! Figures, as notebooks show them: the library's own plots, no other package.

use crate::arrays::{read, slice};
use crate::error::OrRaise;
use omnidrones_plot::{self as plot, Panel, Series};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// A figure: a notebook shows it, `save` writes it.
#[pyclass(module = "omnidrones", frozen)]
pub struct Figure(pub plot::Figure);

#[pymethods]
impl Figure {
    /// As an SVG document.
    pub fn svg(&self, py: Python<'_>) -> PyResult<String> {
        py.detach(|| self.0.svg()).or_raise()
    }

    fn _repr_svg_(&self, py: Python<'_>) -> PyResult<String> {
        self.svg(py)
    }

    /// Writes it as PNG or SVG, by the extension of the path; a file that is there is replaced.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.0.save(path)).or_raise()
    }
}

/// Curves in one chart.
///
/// Parameters
/// ----------
/// curves : dict
///     By the name in the legend, (x, y): two arrays [point] or what NumPy makes some of; what is not finite leaves a gap.
/// title, x, y : str
///     Above the chart and at its axes, with units: "time [s]".
/// log_x, log_y : bool
///     Logarithmic axes; what is not positive leaves a gap there.
#[pyfunction(name = "plot")]
#[pyo3(signature = (curves, /, *, title="", x="", y="", log_x=false, log_y=false))]
pub fn plot_curves(
    curves: &Bound<'_, PyDict>,
    title: &str,
    x: &str,
    y: &str,
    log_x: bool,
    log_y: bool,
) -> PyResult<Figure> {
    let mut panel = Panel { log_x, log_y, ..Panel::new("", x, y) };
    for (name, pair) in curves {
        let (name, (x, y)): (String, (Bound<'_, PyAny>, Bound<'_, PyAny>)) = (name.extract()?, pair.extract()?);
        let (x, y) = (numbers(&format!("x of {name}"), &x, x.len()?)?, numbers(&format!("y of {name}"), &y, x.len()?)?);
        let points = x.into_iter().zip(y).collect();
        panel = panel.series(Series::line(name, points));
    }
    Ok(Figure(plot::Figure::new(title).chart(panel)))
}

/// So many numbers of an array or a list, in whatever order and precision.
fn numbers(name: &str, given: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<f64>> {
    let own = given.py().import("numpy")?.call_method1("ascontiguousarray", (given, "float64"))?;
    Ok(slice(&read::<f64>(name, &own, &[n])?)?.to_vec())
}
