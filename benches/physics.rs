//! `cargo bench`: the rows of `omnidrones bench`, without the plots.

fn main() -> omnidrones::error::Result<()> {
    let rows = omnidrones::bench::run(&omnidrones::bench::BenchPlan::default(), &mut |_| {})?;
    print!("{}", omnidrones::bench::text(&rows));
    Ok(())
}
