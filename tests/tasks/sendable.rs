//! What a host language holds may move between its threads and be shared by them.

use omnidrones::autodiff::Program;
use omnidrones::dynamics::Fleet;
use omnidrones::dynamics::batch::World;
use omnidrones::rl::{Learner, Policy, Trainer};
use omnidrones::tasks::{Adjoint, Baseline, Buffers, Env, SingleEnv, Sweep, Tape};

fn sends<T: Send>() {}
fn shares<T: Send + Sync>() {}

#[test]
fn the_large_types_may_be_sent_to_other_threads() {
    sends::<Baseline>();
    shares::<(Env, Buffers, SingleEnv, Tape, Adjoint, Sweep)>();
    shares::<(Policy, Trainer, Box<dyn Learner>)>();
    shares::<(World, Fleet, Program)>();
}
