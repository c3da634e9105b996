//! A task of one's own, learnt: climb two metres and stay. Ten lines of goal, reward and loss; lanes, gradients, learners
//! come with it.
//!
//! `cargo run --release --example learn_own_task`

use omnidrones::autodiff::{Pen, Scalar};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::Learner;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::tasks::reward::bell;
use omnidrones::tasks::{Ends, Env, EnvConfig, Rig, Sheet, Slice, Start, Task, Term, View};

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
        let observation = vec![Slice::new("left", 1, "m", "2 − z"), Slice::new("motion", 6, "m/s, -", "v, u")];
        let reward = vec![Term::smooth("near", "1/(1 + left²)", 1.0)];
        Sheet {
            observation,
            central: Vec::new(),
            reward,
            ends: Vec::new(),
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
        let drone = view.drone(0);
        out.number(left(view));
        out.array(drone.velocity);
        out.array(drone.up());
    }
    fn reward<S: Scalar>(&self, view: &View<'_, S>, terms: &mut Pen<'_, S>) {
        terms.number(bell(1.0, left(view).square()));
    }
    fn ends<S: Scalar>(&self, _: &View<'_, S>, _: &mut Ends<'_, S>) {}
    fn metrics<S: Scalar>(&self, _: &View<'_, S>, _: &mut Pen<'_, S>) {}
    fn success<S: Scalar>(&self, view: &View<'_, S>) -> S::Mask {
        left(view).abs().lt(S::constant(0.1))
    }
    fn loss<S: Scalar>(&self, view: &View<'_, S>) -> S {
        left(view).square() + S::constant(0.1) * view.drone(0).velocity[2].square()
    }
    fn ideal(&self, start: &mut Start<'_>) {
        start.place(0, [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0]);
    }
}

fn main() -> Result<()> {
    let make = |config: &EnvConfig| Env::of(Climb { rig: config.single_rig("hummingbird")? }, "Climb", config);
    let config = ApgConfig { updates: 200, ..ApgConfig::default() };
    let mut apg =
        Apg::with(&make, &EnvConfig { stagger: true, ..EnvConfig::default() }, config, 1, Threads::default())?;
    let losses = (0..200).map(|_| Ok(apg.update()?.loss)).collect::<Result<Vec<_>>>()?;
    let (first, last) = (losses[0], losses[199]);
    println!("loss of a step: {first:.3} before, {last:.3} after {} updates", apg.n_update());
    assert!(last < 0.5 * first);
    Ok(())
}
