//! A task of one's own, learnt: climb two metres and stay. `cargo run --release --example learn_own_task`

use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::tasks::Loss;
use omnidrones::tasks::reward::{rational_kernel, smooth_norm};

struct Climb {
    robot: Robot,
}

/// Height still to go, m.
fn left(view: &View) -> Trace {
    2.0 - view.drone(0).position[2]
}

impl Task for Climb {
    fn robot(&self) -> &Robot {
        &self.robot
    }
    fn horizon(&self) -> usize {
        200
    }
    fn start(&self, start: &mut Start<'_>) {
        let position = start.position([[0.0, 0.0], [0.0, 0.0], [0.5, 1.5]]);
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }
    fn observe(&self, view: &View, _: usize, out: &mut Writer) {
        let drone = view.drone(0);
        out.field("left", "m", "2 − z").number(left(view));
        out.field("velocity", "m/s, world", "v").array(drone.velocity);
        out.field("up", "-, world", "u").within(-1.0, 1.0).array(drone.up());
        out.field("angular_velocity", "rad/s, world", "ω").array(drone.angular_velocity);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        terms.term("near", "1/(1 + left²)", 1.0).number(rational_kernel(1.0, left(view).square()));
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("fast", "|v| > 5 m/s", safe::squared_norm(view.drone(0).velocity).gt(25.0));
    }
    fn success(&self, view: &View) -> TraceMask {
        left(view).abs().lt(0.1)
    }
    fn loss(&self, view: &View, loss: &mut Loss) {
        let drone = view.drone(0);
        let restless = safe::squared_norm(drone.velocity) + safe::squared_norm(drone.angular_velocity);
        loss.add("√(left² + 0.1²)", smooth_norm([left(view)], 0.1));
        loss.add("0.02 (‖v‖² + ‖ω‖²)", 0.02 * restless);
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn main() -> Result<()> {
    let make = |config: &EnvConfig| Env::of(Climb { robot: config.single_robot("hummingbird")? }, "Climb", config);
    let config = ApgConfig { updates: 400, ..ApgConfig::default() };
    let mut apg =
        Apg::with(&make, &EnvConfig { stagger: true, ..EnvConfig::default() }, config, 1, Threads::default())?;
    let losses = (0..400).map(|_| Ok(apg.update()?.loss)).collect::<Result<Vec<_>>>()?;
    println!("loss of a step: {:.3} before, {:.3} after {} updates", losses[0], losses[399], apg.n_update());
    assert!(losses[399] < 0.5 * losses[0]);
    Ok(())
}
