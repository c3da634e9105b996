//! Laws that are data fly, bear, learn and scatter as those that they were recorded from.

use super::*;
use crate::cascade::Rates;
use crate::cascade_law::CascadeLaw;
use crate::closed_loop::{ClosedLoop, ExogenousInputs};
use crate::design::{AnalysisPoint, LoopModel};
use crate::filter::FilterSettings;
use crate::formation::FormationLaw;
use crate::hover_feedback::{HoverFeedback, HoverWeights};
use crate::indi::IndiLaw;
use crate::law::LawController;
use crate::monte_carlo::{MonteCarlo, MonteCarloDraw, MonteCarloResult};
use crate::reference::{Hover, Reference};
use crate::start::start_on;
use crate::{FlightPlan, fly};
use autodiff::trace::is_recording;
use autodiff::{Gradient, Objective, Rollout};
use base::parallel::Threads;
use dynamics::{Disturbance, Effects, Physics, configurations, vehicles};
use rng::Stream;

const RATES: Rates = Rates { rate: 500.0, attitude: 250.0, velocity: 50.0 };

fn plant_of(name: &str) -> Plant {
    Plant::of_vehicle(&vehicles::by_name(name).unwrap(), Physics::default()).unwrap()
}

fn cascade(plant: &Plant, rates: &Rates) -> CascadeLaw {
    let Plant::Rigid(own) = plant else { panic!("a vehicle") };
    CascadeLaw::new(own.vehicle(), plant.physics(), &own.vehicle().gains(), rates).unwrap()
}

fn recorded<L: ControlLaw>(plant: &Plant, law: L) -> RecordedLaw {
    RecordedLaw::of(Arc::new(law), plant, &[]).unwrap()
}

/// How far it is off, squared, and what the root turns at.
struct Off;

impl Objective for Off {
    fn stage<S: Scalar>(&self, x: &[S], u: &[S], _: &[S]) -> S {
        (0..3).fold(S::zero(), |sum, k| sum + (x[k] - u[k]).square() + x[10 + k].square())
    }
}

fn gradient<L: ControlLaw>(plant: &Plant, law: L) -> (f64, Gradient) {
    let closed = ClosedLoop::new(plant.clone(), LawController::of(law)).unwrap().with_physics().with_gains();
    let goal = Reference::by_name("lemniscate").unwrap();
    let mut start = closed.initial_state(&start_on(closed.plant(), closed.controller(), &goal).unwrap());
    start[0] += 0.2;
    let mut inputs = vec![0.0; 40 * closed.n_input()];
    for (k, row) in inputs.chunks_exact_mut(closed.n_input()).enumerate() {
        closed.write_input(k as u64, Target::level(&goal), &Disturbance::none(), row);
    }
    let theta = closed.parameters();
    Rollout::new(closed, Off).unwrap().gradient(&start, &inputs, &theta)
}

fn scattered<L: ControlLaw>(plant: &Plant, law: L) -> (usize, Vec<MonteCarloResult>) {
    let closed =
        ClosedLoop::new(plant.clone(), LawController::of(law)).unwrap().with_latency(2).unwrap().with_physics();
    let goal = Reference::by_name("circle").unwrap();
    let start = start_on(closed.plant(), closed.controller(), &goal).unwrap();
    let draw = |stream: &mut Stream, own: &mut MonteCarloDraw| {
        own.start[0] += stream.uniform(-0.5, 0.5);
        own.parameters.iter_mut().take(1).for_each(|mass| *mass *= stream.uniform(0.8, 1.2));
    };
    let many = MonteCarlo::new(&closed).unwrap();
    let flown = many.fly(Target::level(&goal), &start, (70, 150), &draw, &Threads::new(1).unwrap());
    (many.len(), flown.unwrap())
}

fn margins<L: ControlLaw>(plant: &Plant, law: L) -> [f64; 4] {
    let closed = ClosedLoop::new(plant.clone(), LawController::of(law)).unwrap();
    let here = Reference::Hover(Hover { position: [0.0; 3], yaw: 0.0 });
    let start = start_on(plant, closed.controller(), &here).unwrap();
    let model = LoopModel::new(closed, Target::level(&here), &Disturbance::none(), &start).unwrap();
    let one = model.margins(AnalysisPoint::Measurement(7)).unwrap();
    [one.gain_up, one.phase, one.delay, one.disk.alpha]
}

/// Flights to the bit, gradients, and in lanes the same program.
fn agrees<L: ControlLaw + Clone>(plant: &Plant, law: L, plan: &FlightPlan) {
    let data = recorded(plant, law.clone());
    let flown = [
        fly(plant, &mut LawController::of(law.clone()), plan, &mut |_| {}).unwrap(),
        fly(plant, &mut LawController::of(data.clone()), plan, &mut |_| {}).unwrap(),
    ];
    assert!(flown[0].diverged_at.is_none() && flown[0].states == flown[1].states, "{}", law.name());
    assert_eq!(flown[0].log, flown[1].log);
    let (cost, by) = gradient(plant, data.clone());
    assert_eq!((cost, &by), (gradient(plant, law.clone()).0, &gradient(plant, law.clone()).1), "{}", law.name());
    assert!(cost.is_finite() && by.state.iter().any(|g| *g != 0.0));
    if law.is_batched() {
        let own = scattered(plant, law.clone());
        assert!(own.1.iter().all(|row| row.lost_at.is_none()));
        assert_eq!(scattered(plant, data), own, "{}", law.name());
    }
}

#[test]
fn a_cascade_of_several_rates_with_filters_is_the_same_as_data() {
    let (plant, filters) = (plant_of("hummingbird"), FilterSettings::parse_list("low_pass:80,notch:120:20").unwrap());
    let law = cascade(&plant, &RATES).with_filters(&filters).unwrap();
    let plan = FlightPlan { duration: 1.0, rates: RATES, filters, ..FlightPlan::default() };
    agrees(&plant, law.clone(), &plan);
    assert_eq!(margins(&plant, recorded(&plant, law.clone())), margins(&plant, law));
}

#[test]
fn feedback_with_a_rate_and_a_memory_of_its_own_is_the_same_as_data() {
    let plant = plant_of("hummingbird");
    let rates = Rates { rate: 250.0, attitude: 250.0, velocity: 50.0 };
    let plan = FlightPlan { duration: 0.6, rates, ..FlightPlan::default() };
    for law in [HoverFeedback::lqi, HoverFeedback::lqr] {
        let law = law(&plant, &rates, &HoverWeights::default()).unwrap();
        agrees(&plant, law.clone(), &plan);
        assert_eq!(margins(&plant, recorded(&plant, law.clone())), margins(&plant, law));
    }
}

#[test]
fn a_formation_and_a_law_that_calls_a_solver_are_the_same_as_data() {
    let plan = FlightPlan { duration: 0.2, ..FlightPlan::default() };
    let plant = plant_of("hummingbird");
    let Plant::Rigid(own) = &plant else { panic!("a vehicle") };
    let indi = IndiLaw::new(own.vehicle(), plant.physics(), &own.vehicle().gains(), &plan.rates).unwrap();
    agrees(&plant, indi, &plan);
    let plant = Plant::of_model(&configurations::by_name("payload").unwrap(), Physics::default()).unwrap();
    agrees(&plant, FormationLaw::new(plant.tree().unwrap(), None, &plan.rates).unwrap(), &plan);
}

/// The cascade in its own words, by a closure that hands its tick on.
fn written(plant: &Plant, law: &CascadeLaw) -> WrittenLaw {
    let about = LawDescription {
        name: "mine".into(),
        levels: vec![RATES.velocity, RATES.attitude, RATES.rate],
        memory: law.memory(),
        gains: law.parameter_names().into_iter().zip(law.parameters()).collect(),
        ..LawDescription::default()
    };
    WrittenLaw::new(about, plant, |now, memory| {
        let (mut memory, mut commands) = (memory.to_vec(), vec![Trace::zero(); 4]);
        law.tick(now, &mut memory, &mut commands);
        Ok::<_, Error>((memory, commands))
    })
    .unwrap()
}

#[test]
fn a_written_law_with_levels_of_their_own_rates_flies_as_the_law_it_calls() {
    let plant = plant_of("hummingbird");
    let (law, plan) = (cascade(&plant, &RATES), FlightPlan { duration: 1.0, rates: RATES, ..FlightPlan::default() });
    let own = written(&plant, &law);
    assert_eq!((own.name(), own.n_tick(), own.parameter_names()), ("mine", 3, law.parameter_names()));
    let flown = [
        fly(&plant, &mut LawController::of(law.clone()), &plan, &mut |_| {}).unwrap().states,
        fly(&plant, &mut LawController::of(own.clone()), &plan, &mut |_| {}).unwrap().states,
    ];
    assert_eq!(flown[0], flown[1]);
    assert_eq!(scattered(&plant, own.clone()), scattered(&plant, law));
    // other gains are other flights
    let stiffer: Vec<f64> = own.parameters().iter().map(|gain| 1.1 * gain).collect();
    let other = fly(&plant, &mut LawController::of(own.with_gains(&stiffer).unwrap()), &plan, &mut |_| {}).unwrap();
    assert_ne!(other.states, flown[0]);
}

#[test]
fn a_tick_as_a_program_has_the_bits_of_a_tick_node_by_node() {
    let plant = plant_of("firefly");
    let data = recorded(&plant, cascade(&plant, &RATES));
    let (mut fast, mut row) = (data.compiled().unwrap(), vec![0.0; data.n_target()]);
    let start = plant.hover_state().unwrap();
    let mut memories = [data.memory(), data.memory()];
    for k in 0..40u64 {
        let mut ticks = vec![0.0; data.n_tick()];
        data.write_ticks(k, &mut ticks);
        data.write_target(Target::level(&Reference::by_name("lemniscate").unwrap()), 0.1 * k as f64, &mut row);
        let state: Vec<f64> =
            start.iter().enumerate().map(|(i, x)| x + 0.3 * ((i as f64 + 1.3) * k as f64).sin()).collect();
        let now = LawInput { state: &state, target: &row, ticks: &ticks, parameters: &[] };
        let mut commands = [vec![0.0; plant.n_input()], vec![0.0; plant.n_input()]];
        data.tick(&now, &mut memories[0], &mut commands[0]);
        fast.tick(&now, &mut memories[1], &mut commands[1]);
        let bits = |numbers: &[f64]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!((bits(&commands[0]), bits(&memories[0])), (bits(&commands[1]), bits(&memories[1])), "tick {k}");
    }
}

#[test]
fn a_plant_of_other_sizes_is_refused_and_one_with_wind_is_not() {
    let plant = plant_of("hummingbird");
    let data = || LawController::of(recorded(&plant, cascade(&plant, &Rates::default())));
    let refused = ClosedLoop::new(plant_of("firefly"), data()).unwrap_err().to_string();
    let told = ["firefly", "'cascade'", "19 numbers of state and 6 commands", "17 numbers of state and 4 commands"];
    assert!(told.iter().all(|part| refused.contains(part)), "{refused}");
    let effects = Effects { disturbance: true, ..Effects::default() };
    let windy = Physics { effects, ..Physics::default() };
    let plant = Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), windy).unwrap();
    let mut closed = ClosedLoop::new(plant, data()).unwrap();
    let (x, mut next) = (closed.plant().hover_state().unwrap(), vec![0.0; 17]);
    let hover = Reference::by_name("hover").unwrap();
    closed.advance(&x, Target::level(&hover), &ExogenousInputs::none(), &mut next).unwrap();
    assert!((next[2] - x[2]).abs() < 1e-3);
}

#[test]
fn an_error_of_the_writer_is_handed_on_and_nothing_is_left_recording() {
    /// Of a caller.
    #[derive(Debug, PartialEq)]
    enum Own {
        Theirs(&'static str),
        Ours(String),
    }
    impl From<Error> for Own {
        fn from(error: Error) -> Self {
            Self::Ours(error.to_string())
        }
    }
    let plant = plant_of("hummingbird");
    let about = || LawDescription { name: "mine".into(), memory: vec![0.0; 2], ..LawDescription::default() };
    let theirs = WrittenLaw::new(about(), &plant, |_, _| Err(Own::Theirs("a typing error"))).unwrap_err();
    assert_eq!(theirs, Own::Theirs("a typing error"));
    assert!(!is_recording());
    let ours = |memory: usize, commands: usize| {
        let made = WrittenLaw::new(about(), &plant, |_, _| {
            Ok::<_, Own>((vec![Trace::zero(); memory], vec![Trace::zero(); commands]))
        });
        made.map(|_| ()).map_err(|error| if let Own::Ours(text) = error { text } else { panic!("ours") })
    };
    assert!(ours(2, 4).is_ok() && !is_recording());
    assert!(ours(3, 4).unwrap_err().contains("memory of a tick is 3"));
    assert!(ours(2, 6).unwrap_err().contains("4 of 'hummingbird'"));
    let mut kept = None;
    WrittenLaw::new(about(), &plant, |now, memory| {
        kept = Some(now.state[0]);
        Ok::<_, Error>((memory.to_vec(), vec![Trace::zero(); 4]))
    })
    .unwrap();
    let stale = WrittenLaw::new(about(), &plant, |_, memory| Ok::<_, Error>((memory.to_vec(), vec![kept.unwrap(); 4])));
    assert!(stale.unwrap_err().to_string().contains("of another recording"));
}

#[test]
fn what_cannot_be_meant_is_refused_by_name() {
    let plant = plant_of("hummingbird");
    let refused = |about: LawDescription| {
        let made =
            WrittenLaw::new(about, &plant, |_, memory| Ok::<_, Error>((memory.to_vec(), vec![Trace::zero(); 4])));
        made.unwrap_err().to_string()
    };
    let about = || LawDescription { name: "mine".into(), ..LawDescription::default() };
    let gains = |own: &[(&str, f64)]| own.iter().map(|(name, x)| (name.to_string(), *x)).collect::<Vec<_>>();
    let twice = LawDescription { gains: gains(&[("k", 1.0), ("k", 2.0)]), ..about() };
    assert!(refused(twice).contains("name of gain 1"));
    assert!(refused(LawDescription { gains: gains(&[("k", f64::NAN)]), ..about() }).contains("gain 'k'"));
    assert!(refused(LawDescription { memory: vec![0.0, f64::INFINITY], ..about() }).contains("memory[1]"));
    let uneven = refused(LawDescription { rate: Some(250.0), levels: vec![100.0], ..about() });
    assert!(uneven.contains("100 Hz") && uneven.contains("250"), "{uneven}");
}
