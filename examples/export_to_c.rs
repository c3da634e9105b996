//! A controller leaves as C: `cargo run --release --example export_to_c`.
//!
//! Writes the cascade of a Hummingbird into out/c and, where there is a C compiler, lets it test itself.

use omnidrones::controllers::CascadeLaw;
use omnidrones::error::Result;
use omnidrones::export::{ExportOptions, ExportPrecision, compiler, controller_as_c};
use omnidrones::prelude::*;

fn main() -> Result<()> {
    let hummingbird = vehicles::by_name("hummingbird")?;
    let physics = Physics::default();
    let plant = Plant::of_vehicle(&hummingbird, physics)?;
    let cascade = CascadeLaw::new(&hummingbird, &physics, &hummingbird.gains(), &Rates::default())?.running();
    let options = ExportOptions { precision: ExportPrecision::Single, ..ExportOptions::default() };
    let module = controller_as_c(&cascade, &plant, &options)?;
    for function in &module.functions {
        println!("{};  stack {} bytes, {} operations", function.prototype, function.stack, function.n_instruction);
    }
    module.write("out/c", false)?;
    if compiler::has_compiler() {
        print!("{}", compiler::checked(&module, &["-O2"])?);
    }
    Ok(())
}
