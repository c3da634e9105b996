//! A task of one's own: fly to a beacon that is drawn anew in every episode; and the check of all that learners rely on.
//!
//! `cargo run --release --example own_task`

use omnidrones::autodiff::{Pen, Scalar, safe};
use omnidrones::dynamics::spatial::sub;
use omnidrones::error::Result;
use omnidrones::tasks::{End, Ends, Env, EnvConfig, Metric, Rig, Sheet, Slice, Start, Task, Term, View, check_env};
use omnidrones::tasks::{reward::bell, suite::drone_slices, task::ANY_YAW};

struct Beacon(Rig);

/// From the drone to the beacon, m, world.
#[inline(always)]
fn way<S: Scalar>(view: &View<'_, S>) -> [S; 3] {
    sub(view.goal.array(0), view.drone(0).position)
}

#[rustfmt::skip]
impl Task for Beacon {
    fn rig(&self) -> &Rig { &self.0 }
    fn horizon(&self) -> usize { 100 }
    fn sheet(&self) -> Sheet {
        let mut observation = vec![Slice::new("way", 3, "m, world", "to the beacon")];
        observation.extend(drone_slices(self.0.drone()));
        Sheet {
            observation, central: vec![], memo: vec![], settings: vec![],
            reward: vec![Term::smooth("near", "1/(1 + d²)", 1.0)],
            ends: vec![End::new("crash", "z < 0.2 m")],
            metrics: vec![Metric { name: "distance", unit: "m" }],
            goal: vec![Slice::new("beacon", 3, "m, world", "where it stands")],
        }
    }
    fn start(&self, start: &mut Start<'_>) {
        let beacon = [-2.0, -2.0, 1.0].map(|low| start.task.uniform(low, low + 4.0));
        start.goal.copy_from_slice(&beacon);
        let attitude = start.attitude(0.3, ANY_YAW);
        start.place(0, [0.0, 0.0, 2.0], attitude);
    }
    #[inline(always)] fn observe<S: Scalar>(&self, view: &View<'_, S>, _agent: usize, out: &mut Pen<'_, S>) {
        out.array(way(view));
        view.observe_drone(0, out);
    }
    #[inline(always)] fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        terms.number(bell(1.0, safe::squared_norm(way(view))));
    }
    #[inline(always)] fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(view.drone(0).position[2].lt(S::constant(0.2)));
    }
    #[inline(always)] fn metrics<S: Scalar>(&self, view: &View<'_, S>, out: &mut Pen<'_, S>) {
        out.number(safe::norm(way(view)));
    }
    #[inline(always)] fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        safe::squared_norm(way(view)).lt(S::constant(0.01))
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.goal.copy_from_slice(&[0.0, 0.0, 2.0]);
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn main() -> Result<()> {
    let make = |config: &EnvConfig| Env::of(Beacon(config.single_rig("crazyflie")?), "Beacon", config);
    for finding in check_env(&make, &EnvConfig::default())? {
        println!("{:<75} {}", finding.claim, finding.objection.as_deref().unwrap_or("holds"));
    }
    Ok(())
}
