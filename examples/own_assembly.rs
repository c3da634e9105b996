//! A system of your own: a Hummingbird with two lanterns on ropes below its sides, built from parts, looked at, flown.
//!
//! `cargo run --release --example own_assembly`

use omnidrones::controllers::reference::Circle;
use omnidrones::controllers::{Setup, default_controller};
use omnidrones::dynamics::assembly::{Assembly, JointKind, JointSpec, Solid};
use omnidrones::dynamics::tree::{Multibody, frame_pose};
use omnidrones::error::Result;
use omnidrones::prelude::*;

fn main() -> Result<()> {
    let mut robot = Assembly::new("lanterns");
    robot.part("drone", Solid::vehicle(&vehicles::by_name("hummingbird")?));
    for (side, y) in [("left", 0.1), ("right", -0.1)] {
        let (rope, lamp) = (format!("rope_{side}"), format!("lamp_{side}"));
        robot.part(&rope, Solid::bar([0.0; 3], [0.0, 0.0, -0.4], 0.004).mass(0.005));
        robot.part(&lamp, Solid::sphere(0.03).mass(0.05));
        let cardan = JointKind::Universal([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        robot.join(JointSpec::new(format!("swing_{side}"), cardan, "drone", &rope).at([0.0, y, -0.05]).damping(2e-4));
        robot.join(JointSpec::new(format!("knot_{side}"), JointKind::Fixed, rope, lamp).at([0.0, 0.0, -0.4]));
    }
    let model = robot.model()?;
    println!(
        "{} bodies, {} kg, {} degrees of freedom",
        model.bodies().len(),
        model.mass(),
        model.layout().n_velocity()
    );

    // The drone's cascade, fed with the mass of all, along a slow circle.
    let system = Multibody::new(&model, Physics::default())?;
    let reference = Reference::Circle(Circle { rate: 0.8, ..Circle::default() });
    let plan = FlightPlan { reference, duration: 8.0, ..FlightPlan::default() };
    let plant = Plant::from(system.clone());
    let mut controller = default_controller(&plant, &Setup::new(None, &plan.rates))?;
    let flight = fly(&plant, &mut controller, &plan, &mut |_| {})?;

    let end = &flight.states[flight.states.len() - plant.n_state()..];
    let lamp = frame_pose(&system, end, &model.frame("lamp_left")?);
    println!(
        "tracking RMSE {:.3} m; the left lamp ends at {:.2?} m",
        flight.log.rmse(2.0).unwrap_or(f64::NAN),
        lamp.position
    );
    Ok(())
}
