use omnidrones::controllers::optimal::*;
use std::time::Instant;
fn main() {
  for name in std::env::args().skip(1) {
    let course = if name.ends_with(".toml") { ProblemFile::open(&name) } else { ProblemFile::by_name(&name) }.unwrap();
    let mut ilqr = Ilqr::new(&course.problem).unwrap();
    for guess in ["hover", "line"] {
    let begin = |ilqr: &mut Ilqr| if guess == "hover" { ilqr.start_from_inputs(&course.problem, &course.guess.inputs).unwrap() } else { ilqr.start_from(&course.problem, &course.guess).unwrap() };
    begin(&mut ilqr);
    let report = ilqr.solve(&course.problem, &course.settings, |k, i| if std::env::var_os("V").is_some() { println!("{k:3} round {} cost {:.9} gap {:.2e} exp {:.2e} step {} reg {:.1e} newton {}", i.round, i.cost, i.gap, i.expected, i.step, i.regularisation, i.newton_steps) }).unwrap();
    println!("{name} {guess}: {:?} cost {:.12} gap {:.1e} violation {:.1e} iterations {}", report.status, report.cost, report.gap, report.violation, report.iterations.len());
    let mut best = f64::INFINITY; let n=20;
    for _ in 0..n { let t=Instant::now(); begin(&mut ilqr); ilqr.solve(&course.problem, &course.settings, |_,_|()).unwrap(); best = best.min(t.elapsed().as_secs_f64()); }
    println!("   best {:.3} ms, per iteration {:.1} us, newton {}", best*1e3, best*1e6/report.iterations.len() as f64, report.iterations.iter().map(|i| i.newton_steps).sum::<usize>());
    }
  }
}
