//! `cargo bench`: the rows of `omnidrones bench`, without the plots.

fn main() -> omnidrones::error::Result<()> {
    let rows = omnidrones_bench::run(&omnidrones_bench::BenchPlan::default(), &mut |_| {})?;
    print!("{}", omnidrones_bench::text(&rows));
    Ok(())
}
