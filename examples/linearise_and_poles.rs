//! Linearises every built-in vehicle at hover and prints its slowest poles: open, where rotor drag above the
//! centre of mass can make it unstable, and closed, where all must lie left of the axis.
//!
//! `cargo run --release --example linearise_and_poles`

use nalgebra::DMatrix;
use omnidrones::controllers::reference::Hover;
use omnidrones::error::Result;
use omnidrones::prelude::*;

/// Eigenvalues λ of a discrete step as continuous poles s = ln(λ)/dt, rad/s, slowest first; |λ| < 1e-6 left out.
fn poles(step: &DMatrix<f64>, dt: f64) -> Vec<(f64, f64)> {
    let step = faer::Mat::from_fn(step.nrows(), step.ncols(), |i, j| step[(i, j)]);
    let eigenvalues = step.eigenvalues().expect("a finite matrix has eigenvalues");
    let all = eigenvalues.iter().map(|l| (l.re.hypot(l.im), l.im.atan2(l.re))).filter(|(size, _)| *size > 1e-6);
    let mut poles: Vec<(f64, f64)> = all.map(|(size, angle)| (size.ln() / dt, angle / dt)).collect();
    poles.sort_by(|a, b| b.0.total_cmp(&a.0));
    poles
}

fn main() -> Result<()> {
    let physics = Physics::default();
    for vehicle in vehicles::all() {
        let plant = Multirotor::new(&vehicle, physics)?;
        let hover = plant.hover_state([0.0, 0.0, 1.0])?;
        let open = poles(&linearise(&plant, &hover, &plant.hover_input()?, &[]).state, physics.dt);

        // Every level in every step, so that one step is the whole loop.
        let system = ClosedLoop::of_vehicle(&vehicle, physics, &vehicle.gains(), &Rates::every_step(physics.dt))?;
        let mut input = vec![0.0; 21];
        let point = Reference::Hover(Hover { position: [0.0, 0.0, 1.0], yaw: 0.0 });
        system.write_input(0, Target::level(&point), &Disturbance::none(), &mut input);
        let step = linearise(&system, &system.initial_state(&hover), &input, &[]).state;
        // The memory of the cascade is rewritten in each step: the vehicle's block is the loop.
        let n = hover.len();
        let closed = poles(&step.view((0, 0), (n, n)).into_owned(), physics.dt);

        println!("{}", vehicle.name);
        for (name, poles) in [("open", open), ("closed", closed)] {
            let text: Vec<String> = poles.iter().take(8).map(|(re, im)| format!("{re:.2}{im:+.2}i")).collect();
            println!("  {name:6} {} … 1/s", text.join("  "));
        }
    }
    Ok(())
}
