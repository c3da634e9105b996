//! References as C: from time to the target of a controller.

use super::golden::{Golden, Twin};
use super::module::{CModule, ExportOptions, ModuleBuilder, array};
use autodiff::emit::{Access, ExportPrecision, NamedFunction};
use base::error::{Error, Result};
use controllers::reference::{Reference, Setpoint};

/// Rows of golden vectors, and seconds between two.
const ROWS: usize = 24;
const SECONDS: f64 = 0.37;

/// The setpoint of a reference at any time, with derivatives up to snap.
///
/// # Errors
/// [`Error::Value`] for a reference that is looked up, and for a name that is none in C; otherwise as [`Reference::validate`].
pub fn reference_as_c(reference: &Reference, options: &ExportOptions) -> Result<CModule> {
    reference.validate()?;
    let Some(recording) = reference.recording() else {
        let what = format!("reference '{}'", reference.name());
        return Err(Error::value(what, "a table", "a curve written over any scalar", "Export a shape, or waypoints."));
    };
    let mut module = ModuleBuilder::new(reference.name(), format!("the reference '{}'", reference.name()), options)?;
    module.about.push(format!("{}.", reference.description()));
    if let Ok(numbers) = serde_json::to_string(reference) {
        module.about.push(format!("Its numbers: {numbers}."));
    }
    if options.precision == ExportPrecision::Single {
        module.about.push(
            "A time is a float here: beyond 1000 s it counts in steps of 0.1 ms, beyond a day it stands still for controllers. Begin \
            it anew, or export in double."
                .into(),
        );
        // of snap; measured 3.1e-5
        module.tolerance = 2e-4;
    }
    let names = Setpoint::<f64>::NUMBERS;
    let function = NamedFunction {
        name: "target".into(),
        about: "Where to be at a time, with derivatives.".into(),
        arrays: vec![
            array("time", "the time", Access::Read, [("time", "s")].into_iter()),
            array("target", "where to be", Access::Write, names.into_iter()),
        ],
        recording,
    };
    module.public(&function)?;
    let mut golden =
        Golden::of_function(format!("{}_target", module.name()), false, &function.arrays.iter().collect::<Vec<_>>());
    let mut twin = Twin::of(&function)?;
    for row in 0..ROWS {
        let time = row as f64 * SECONDS;
        golden.rows.push([vec![time], twin.call(&[time])].concat());
    }
    module.golden(golden);
    let (name, real) = (module.name(), module.real());
    module.example = format!(
        "static {real} target[{n}]; /* position, velocity, acceleration, jerk, snap, then yaw: as controllers take it */

void run({real} seconds)
{{
    const {real} time[1] = {{seconds}};
    {name}_target(time, target);
}}
",
        n = names.len(),
    );
    Ok(module.finished())
}
