//! A task of one's own: fly to a beacon that is drawn anew in every episode; and the check of all that learners rely on.
//! What it writes it names in the same breath; what `[task]` may set stands in one line each.
//!
//! `cargo run --release --example own_task`

use omnidrones::dynamics::spatial::sub;
use omnidrones::error::Result;
use omnidrones::prelude::*;
use omnidrones::tasks::{ANY_YAW, reward::rational_kernel};
use omnidrones::tasks::{Setting, Settings, Success, check_env};

omnidrones::settings! {
    /// Of the beacon.
    struct BeaconSettings {
        vehicle: String = "crazyflie".into() => ("", "what flies", Any);
        horizon: usize = 100 => ("steps", "T", Any);
        beacon: [[f64; 2]; 3] = [[-2.0, 2.0], [-2.0, 2.0], [1.0, 5.0]]
            => ("m, world", "where it stands, lowest and highest per axis", Ordered);
        reward_near: f64 = 1.0 => ("-", "weight of the term near", NotNegative);
    }
}

struct Beacon {
    robot: Robot,
    settings: BeaconSettings,
}

/// From the drone to the beacon, m, world.
fn way(view: &View) -> [Trace; 3] {
    sub(view.goal.array(0), view.drone(0).position)
}

fn set_beacon(start: &mut Start<'_>, beacon: [impl Into<Trace>; 3]) {
    start.goal.field("beacon", "m, world", "where it stands").array(beacon);
}

#[rustfmt::skip]
impl Task for Beacon {
    fn robot(&self) -> &Robot { &self.robot }
    fn horizon(&self) -> usize { self.settings.horizon }
    fn settings(&self) -> Vec<Setting> { self.settings.list() }
    fn start(&self, start: &mut Start<'_>) {
        let beacon = self.settings.beacon.map(|[low, high]| start.task.uniform(low, high));
        set_beacon(start, beacon);
        let attitude = start.attitude(0.3, ANY_YAW);
        start.place(0, [0.0, 0.0, 2.0], attitude);
    }
    fn observe(&self, view: &View, _agent: usize, out: &mut Writer) {
        out.field("way", "m, world", "to the beacon").array(way(view));
        view.observe_drone(0, out);
    }
    fn reward(&self, view: &View, terms: &mut Writer) {
        let weight = self.settings.reward_near;
        let near = weight * rational_kernel(1.0, safe::squared_norm(way(view)));
        terms.term("near", "{×reward_near}1/(1 + d²)", weight).number(near);
    }
    fn ends(&self, view: &View, ends: &mut Ends) {
        ends.when("crash", "z < 0.2 m", view.drone(0).position[2].lt(0.2));
    }
    fn metrics(&self, view: &View, out: &mut Writer) {
        out.metric("distance", "m", safe::norm(way(view)));
    }
    fn success(&self, view: &View) -> TraceMask {
        safe::squared_norm(way(view)).lt(0.01)
    }
    fn success_rule(&self) -> Success { Success::below("distance", 0.1) }
    fn ideal(&self, start: &mut Start<'_>) {
        set_beacon(start, [0.0, 0.0, 2.0]);
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn beacon(config: &EnvConfig) -> Result<Env> {
    let settings: BeaconSettings = config.settings()?;
    Env::of(Beacon { robot: config.single_robot(&settings.vehicle)?, settings }, "Beacon", config)
}

fn main() -> Result<()> {
    for finding in check_env(&beacon, &EnvConfig::default())? {
        println!("{:<75} {}", finding.claim, finding.objection.as_deref().unwrap_or("holds"));
    }
    Ok(())
}
