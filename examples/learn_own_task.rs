//! A task of one's own, learnt: climb two metres and stay. `cargo run --release --example learn_own_task`

use omnidrones::autodiff::{Pen, Scalar, safe};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::Learner;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::tasks::reward::{bell, smooth_norm};
use omnidrones::tasks::{End, Ends, Env, EnvConfig, Rig, Sheet, Slice, Start, Task, Term, View};

struct Climb {
    rig: Rig,
}

/// Height still to go, m.
fn left<S: Scalar>(view: &View<'_, S>) -> S {
    S::constant(2.0) - view.drone(0).position[2]
}

impl Task for Climb {
    fn rig(&self) -> &Rig {
        &self.rig
    }
    fn horizon(&self) -> usize {
        200
    }
    fn sheet(&self) -> Sheet {
        let observation = vec![Slice::new("left", 1, "m", "2 − z"), Slice::new("motion", 9, "SI", "v, u, ω")];
        Sheet {
            observation,
            central: Vec::new(),
            reward: vec![Term::smooth("near", "1/(1 + left²)", 1.0)],
            ends: vec![End::new("fast", "|v| > 5 m/s")],
            metrics: Vec::new(),
            goal: Vec::new(),
            memo: Vec::new(),
            settings: Vec::new(),
        }
    }
    fn start(&self, start: &mut Start<'_>) {
        let position = start.position([0.0, 0.0, 0.5], [0.0, 0.0, 1.5]);
        start.place(0, position, [1.0, 0.0, 0.0, 0.0]);
    }
    fn observe<S: Scalar>(&self, view: &View<'_, S>, _: usize, out: &mut Pen<'_, S>) {
        out.number(left(view));
        let drone = view.drone(0);
        out.array(drone.velocity);
        out.array(drone.up());
        out.array(drone.angular_velocity);
    }
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        terms.number(bell(1.0, left(view).square()));
    }
    fn ends<S: Scalar>(&self, view: &View<'_, S>, ends: &mut Ends<'_, S>) {
        ends.when(S::constant(25.0).lt(safe::squared_norm(view.drone(0).velocity)));
    }
    fn metrics<S: Scalar>(&self, _: &View<'_, S>, _: &mut Pen<'_, S>) {}
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        left(view).abs().lt(S::constant(0.1))
    }
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        let drone = view.drone(0);
        let restless = safe::squared_norm(drone.velocity) + safe::squared_norm(drone.angular_velocity);
        smooth_norm([left(view)], 0.1) + S::constant(0.02) * restless
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn main() -> Result<()> {
    let make = |config: &EnvConfig| Env::of(Climb { rig: config.single_rig("hummingbird")? }, "Climb", config);
    let config = ApgConfig { updates: 400, ..ApgConfig::default() };
    let mut apg =
        Apg::with(&make, &EnvConfig { stagger: true, ..EnvConfig::default() }, config, 1, Threads::default())?;
    let losses = (0..400).map(|_| Ok(apg.update()?.loss)).collect::<Result<Vec<_>>>()?;
    println!("loss of a step: {:.3} before, {:.3} after {} updates", losses[0], losses[399], apg.n_update());
    assert!(losses[399] < 0.5 * losses[0]);
    Ok(())
}
