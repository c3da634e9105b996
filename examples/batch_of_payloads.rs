//! Five hundred drones at once, each with a payload of another mass on its rope, in SIMD lanes: all get the command that
//! carries 0.3 kg, so light ones rise and heavy ones sink.
//!
//! `cargo run --release --example batch_of_payloads`

use omnidrones::dynamics::configurations::Payload;
use omnidrones::dynamics::{Physics, World};
use omnidrones::error::Result;
use omnidrones::rng::{Purpose, Stream};

const N: usize = 500;

fn main() -> Result<()> {
    let nominal = Payload::default().build()?;
    let mut world = World::of_model(&nominal.model, Physics::default(), N)?;
    let mut masses = Vec::new();
    for environment in 0..N {
        // The draw of an environment depends on its number alone.
        let mass = Stream::new(0, environment as u64, 0, Purpose::PARAMETERS).uniform(0.2, 0.4);
        let robot = Payload { payload_mass: mass, ..Payload::default() }.build()?;
        world.set_model(environment, &robot.model)?;
        masses.push(mass);
    }

    // Thrust (a + 1)/2 of the largest, shared by the rotors, balances the nominal weight.
    let rotors = nominal.model.rotors();
    let lift: f64 = rotors.iter().map(|r| r.rotor.max_thrust()).sum();
    let action = 2.0 * nominal.model.mass() * nominal.model.parts().gravity / lift - 1.0;
    let actions = vec![action as f32; N * rotors.len()];
    for _ in 0..400 {
        world.step(&actions)?;
    }

    for environment in 0..5 {
        let height = world.state(environment)?[2];
        println!("payload {:.3} kg: {height:+.3} m after 0.8 s", masses[environment]);
    }
    println!("{} environments stopped", world.failures().len());
    Ok(())
}
