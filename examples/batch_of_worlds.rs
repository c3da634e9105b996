//! A thousand Hummingbirds at once, each with a payload of its own, under the same command: the heavy ones sink.
//! Then one is given a NaN action: it stops with a reason, the others do not notice.
//!
//! `cargo run --release --example batch_of_worlds`

use omnidrones::dynamics::{Inertia, Part};
use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::rng::Purpose;

const N: usize = 1000;

fn main() -> Result<()> {
    let vehicle = vehicles::by_name("hummingbird")?;
    let mut world = World::new(&vehicle, Physics::default(), N)?;
    let mut payload = Vec::new();
    for environment in 0..N {
        // The draw of an environment depends on its number alone, not on the size of the batch.
        let mass = Stream::new(0, environment as u64, 0, Purpose::PARAMETERS).uniform(0.0, 0.2);
        let mut loaded = vehicle.clone();
        loaded.parts.push(Part::new("payload", mass, [0.0, 0.0, -0.05], Inertia::zero()));
        world.set_vehicle(environment, &loaded)?;
        payload.push(mass);
    }

    // The command that carries a payload of 0.1 kg: thrust grows with the weight.
    let hover = Multirotor::new(&vehicle, Physics::default())?.hover_input()?;
    let ratio = 1.0 + 0.1 / vehicle.mass_properties().mass;
    let mut actions: Vec<f32> = hover.iter().map(|a| ((a + 1.0) * ratio - 1.0) as f32).collect::<Vec<_>>().repeat(N);
    for _ in 0..500 {
        world.step(&actions)?;
    }
    for environment in [0, 1, 2, 3] {
        let height = world.state(environment)?[2];
        println!("payload {:.3} kg: {height:+.3} m after one second", payload[environment]);
    }

    actions[7 * 4] = f32::NAN;
    world.step(&actions)?;
    println!("{:?}", world.failures());
    Ok(())
}
