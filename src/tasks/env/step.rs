//! The order of a step, written once: sixty-four environments in lanes (`stepper`) and one environment over any scalar
//! (`transition`) go through it.

use super::core::Core;

/// What is done in each phase of a step.
pub(crate) trait Phases {
    /// Commands, clipped and delayed; keeps the rotor speeds for the views behind the step.
    fn command(&mut self);
    /// Where all bodies are now.
    fn frames(&mut self);
    /// Disturbances of the coming step, from the view before it.
    fn disturb(&mut self);
    /// Computation `k` of the controllers.
    fn steer(&mut self, k: usize);
    /// The physics that follow it.
    fn physics(&mut self);
    /// The state at rest stands in where physics gave up.
    fn contain(&mut self) {}
    /// What sensors read behind the physics.
    fn sense(&mut self) {}
    /// Time, task state, reward, ends.
    fn evaluate_step(&mut self);
    /// The reward was for the old goal, the next action is for the new one.
    fn change_goals(&mut self);
    /// Observations before the transforms, and central states.
    fn observe(&mut self);
    /// Observations as they leave.
    fn transform(&mut self);
}

/// One step.
pub(crate) fn step(core: &Core, phases: &mut impl Phases) {
    let (disturbs, steers) = (!core.disturbance_rows.is_empty(), core.control.needs_frames());
    phases.command();
    if disturbs || steers {
        phases.frames();
    }
    if disturbs {
        phases.disturb();
    }
    for k in 0..core.control.steps {
        if k > 0 && steers {
            phases.frames();
        }
        phases.steer(k);
        phases.physics();
    }
    phases.contain();
    phases.frames();
    phases.sense();
    phases.evaluate_step();
    phases.change_goals();
    phases.observe();
    phases.transform();
}
