//! Gains of any law that is data, tuned as those of a cascade are: see [`tune`](mod@super::tune).

use super::gain_evaluation::{GainEvaluation, along_with, elsewhere_of};
use super::loop_model::{AnalysisPoint, LoopMargins, LoopModel};
use super::trim::{TrimTarget, trim};
use super::tune::{Descent, Iteration, Training};
use super::tune_plan::TunePlan;
use super::tuned_loop::MeanSquaredError;
use crate::closed_loop::ClosedLoop;
use crate::controller::Target;
use crate::law::{ControlLaw, LawController};
use crate::reference::{Hover, Reference};
use crate::written_law::WrittenLaw;
use autodiff::batch_rollout::BatchRollout;
use base::error::{Error, Result};
use base::parallel::Threads;
use dynamics::{Disturbance, Physics, Plant, Vehicle};
use serde::Serialize;
use std::ops::ControlFlow;

/// What tuning a law came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawTuning {
    /// The best gains, by name.
    pub gains: Vec<(String, f64)>,
    /// The descent.
    pub history: Vec<Iteration>,
    /// Held-out flights along the references that were tuned on, with the gains it started from and with the best.
    pub flights: [GainEvaluation; 2],
    /// Where they were not tuned: another reference, commands 10 ms later, plants that are not as believed.
    pub elsewhere: [GainEvaluation; 2],
    /// Margins of all commands at hover; `None` for a law that does not come to rest there.
    pub margins: [Option<LoopMargins>; 2],
}

/// Tunes all gains of a law that flies a vehicle, from its nominal ones; `watch` sees each step, and may break behind it: the best
/// gains so far are then judged. Of the plan, `rates` play no part: a law has its own.
///
/// # Errors
/// [`Error::Value`] or [`Error::Limit`] if vehicle or plan are not valid, for a law without gains or with one that is not positive, since
/// steps are relative, and for a plan with margins, which are asked of cascades alone.
pub fn tune_law(
    vehicle: &Vehicle,
    law: &WrittenLaw,
    plan: &TunePlan,
    watch: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<LawTuning> {
    if plan.margins.is_some() {
        let remedy = "Leave them out: the margins before and after are told beside the gains.";
        return Err(Error::value("plan.margins", "given", "none, of a law of one's own", remedy));
    }
    let gains = &law.about().gains;
    if gains.is_empty() {
        let what = format!("controller '{}': gains", law.name());
        return Err(Error::value(what, "none", "1 or more to tune", "Name the numbers that may change."));
    }
    if let Some((name, value)) = gains.iter().find(|(_, value)| *value <= 0.0) {
        let remedy = "Steps are relative: begin at a small gain, and write its sign into the law.";
        return Err(Error::value(format!("gain '{name}'"), value, "> 0", remedy));
    }
    let threads = Threads::default();
    let training = Training::new(vehicle, law.clone(), plan)?;
    let batch = BatchRollout::new(&training.system, &MeanSquaredError::over(plan.n_step()?))?;
    let theta = gains.iter().map(|(_, gain)| gain.ln()).collect();
    let mut descent = Descent::new(theta, plan.learning_rate, plan.iterations);
    for iteration in 0..plan.iterations {
        let (rmse, gradient) = training.cost(&batch, &descent.theta, &threads)?;
        let gradient_norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let step = Iteration { iteration, rmse, gradient_norm };
        let stopped = watch(&step).is_break();
        descent.step(step, &gradient);
        if stopped {
            break;
        }
    }
    let best: Vec<f64> = descent.best.iter().map(|log| log.exp()).collect();
    let tuned = law.clone().with_gains(&best)?;
    let both = [law, &tuned];
    let flown = |law: &WrittenLaw| -> Result<GainEvaluation> {
        let n = plan.references().count();
        let each = (0..n).map(|of| along_with(vehicle, law, plan, of)).collect::<Result<Vec<_>>>()?;
        Ok(GainEvaluation::together(each.iter()))
    };
    let other = |law: &WrittenLaw| {
        let plant = Plant::of_vehicle(vehicle, plan.physics)?;
        elsewhere_of(vehicle, ClosedLoop::new(plant, LawController::of(law.clone()))?, plan)
    };
    let [before, after] = both.map(flown);
    let [there, there_after] = both.map(other);
    Ok(LawTuning {
        gains: tuned.about().gains.clone(),
        history: descent.history,
        flights: [before?, after?],
        elsewhere: [there?, there_after?],
        margins: both.map(|law| margins_of_law(vehicle, law, &plan.physics, plan.latency).ok()),
    })
}

/// Margins of all commands of a law that holds a vehicle at hover.
fn margins_of_law(vehicle: &Vehicle, law: &WrittenLaw, physics: &Physics, latency: usize) -> Result<LoopMargins> {
    let plant = Plant::of_vehicle(vehicle, *physics)?;
    let start = trim(&plant, &TrimTarget::hover())?.state;
    let there = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let closed = ClosedLoop::new(plant, LawController::of(law.clone()))?.with_latency(latency)?;
    LoopModel::new(closed, Target::level(&there), &Disturbance::none(), &start)?.margins(AnalysisPoint::Commands)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade_law::CascadeLaw;
    use crate::design::tune;
    use crate::written_law::LawDescription;
    use autodiff::{Scalar, Trace};
    use dynamics::vehicles;

    fn written(vehicle: &Vehicle, plan: &TunePlan, change: impl FnOnce(&mut LawDescription)) -> WrittenLaw {
        let law = CascadeLaw::new(vehicle, &plan.physics, &vehicle.gains(), &plan.rates).unwrap();
        let mut about = LawDescription {
            name: "mine".into(),
            levels: vec![plan.rates.velocity, plan.rates.attitude, plan.rates.rate],
            memory: law.memory(),
            gains: law.parameter_names().into_iter().zip(law.parameters()).collect(),
            ..LawDescription::default()
        };
        change(&mut about);
        let plant = Plant::of_vehicle(vehicle, plan.physics).unwrap();
        WrittenLaw::new(about, &plant, |now, memory| {
            let (mut memory, mut commands) = (memory.to_vec(), vec![Trace::zero(); 4]);
            law.tick(now, &mut memory, &mut commands);
            Ok::<_, Error>((memory, commands))
        })
        .unwrap()
    }

    #[test]
    fn a_cascade_as_data_is_tuned_to_the_gains_of_the_cascade() {
        let vehicle = vehicles::by_name("hummingbird").unwrap();
        let plan = TunePlan { n_start: 8, n_held_out: 6, duration: 1.0, iterations: 3, ..TunePlan::default() };
        let plan = TunePlan { plant_spread: 0.2, ..plan };
        let go = &mut |_: &Iteration| ControlFlow::Continue(());
        let own = tune_law(&vehicle, &written(&vehicle, &plan, |_| {}), &plan, go).unwrap();
        let known = tune(&vehicle, &vehicle.gains(), &plan, go).unwrap();
        assert_eq!(own.history, known.history);
        assert_eq!(own.gains.iter().map(|(_, gain)| *gain).collect::<Vec<_>>(), known.gains.flat());
        assert_eq!((own.flights, own.elsewhere[1]), ([known.before, known.after], known.elsewhere_after));
        let margins = own.margins.map(|margins| margins.unwrap().disk.alpha);
        let apart = (0..2).map(|k| (margins[k] - known.margins[k].disk.alpha).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-6 && margins[0] > 0.1, "{margins:?}");
    }

    #[test]
    fn a_law_whose_gains_cannot_change_by_steps_is_refused() {
        let (vehicle, plan) = (vehicles::by_name("hummingbird").unwrap(), TunePlan::default());
        let refused = |plan: &TunePlan, change: &dyn Fn(&mut LawDescription)| {
            let law = written(&vehicle, &TunePlan::default(), change);
            tune_law(&vehicle, &law, plan, &mut |_| ControlFlow::Break(())).unwrap_err().to_string()
        };
        assert!(refused(&plan, &|about| about.gains[3].1 = -1.0).contains("gains.velocity_x"));
        let gated = TunePlan { margins: Some(Default::default()), ..TunePlan::default() };
        assert!(refused(&gated, &|_| {}).contains("plan.margins"));
    }
}
