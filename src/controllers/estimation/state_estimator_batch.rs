//! Many filters of the same sensors side by side, in lanes: for batches of environments.
//!
//! A [`StateEstimator`](super::StateEstimator) goes back for what comes late; lanes cannot, as each would go elsewhere. Here the filter stands
//! as far behind the present as the latest reading is late, where all of a sample is known, and the estimate goes on from there by what
//! the inertial unit has read since. Where nothing is late both are the same.

use super::aiding::Agreement;
use super::innovations::{InertialSample, InnovationRecord, Trust};
use super::navigation_state::{ERRORS, NAVIGATION, NavigationState, begin_anew};
use super::sensor_filter::SensorFilter;
use super::state_estimator::StateEstimatorSettings;
use autodiff::columns::{LINE, Lines};
use autodiff::native::{Executable, Place, RowLayout, Rows, Work};
use autodiff::{Array, Program, Recording};
use base::error::{Error, Result};
use dynamics::Frame;
use dynamics::sensors::SensorConfig;
use std::sync::Arc;

/// Filters over readings, each of a body of its own.
///
/// Every step, [`tell`](Self::tell) those that go on what was read, then [`advance`](Self::advance).
#[derive(Debug, Clone)]
pub struct StateEstimatorBatch {
    shared: Arc<Shared>,
    lines: Vec<Filters>,
    n: usize,
    work: Scratch,
    records: Vec<InnovationRecord>,
    saturated: u64,
    begun_anew: u64,
}

/// What all filters share.
#[derive(Debug)]
struct Shared {
    filter: SensorFilter,
    settings: StateEstimatorSettings,
    dt: f64,
    /// Steps that the filter stands behind.
    late: usize,
    /// Numbers of all readings.
    width: usize,
    prediction: Executable<[f64; LINE]>,
    corrections: Vec<Executable<[f64; LINE]>>,
    /// The mean alone, a sample further.
    onward: Executable<[f64; LINE]>,
}

/// Eight filters.
#[derive(Debug, Clone)]
struct Filters {
    /// Flat states, where all is known.
    state: Lines,
    /// What the mean has come to by now, as far as [`NAVIGATION`].
    ahead: Lines,
    own: [Own; LINE],
}

/// What one filter keeps beside its state.
#[derive(Debug, Clone, PartialEq, Default)]
struct Own {
    /// Steps of its sensors so far.
    step: u64,
    /// The first step whose sample tells of its body.
    first: u64,
    /// Whether it was told what is read in the coming step.
    is_told: bool,
    /// Whether more than the unit's samples changed its state.
    is_changed: bool,
    /// The last readings, step k in slot k modulo their number.
    readings: Vec<f64>,
    /// The last samples of the unit, likewise by step.
    inertial: Vec<InertialSample>,
    trust: Vec<Trust>,
}

#[derive(Debug, Clone)]
struct Scratch {
    prediction: Work<[f64; LINE]>,
    corrections: Vec<Work<[f64; LINE]>>,
    onward: Work<[f64; LINE]>,
    /// Inputs of a program, and what it tells.
    input: Lines,
    before: Lines,
    /// One state.
    flat: Vec<f64>,
}

/// Latest reading, steps: every filter keeps as many.
const MOST_LATE: u64 = 1000;
/// Sums of means and variances above this are looked into.
const SUSPECT: f64 = 1e8;
/// Inputs of a program beside the state: a sample, or a reading with gate and fading; ν² and whether it is taken in.
const INPUTS: usize = 8;
const TOLD: usize = 6;

impl Shared {
    /// As [`SensorFilter::new`]; [`Error::Limit`] where a recording is too large.
    fn new(configs: &[SensorConfig], settings: &StateEstimatorSettings, dt: f64, gravity: f64) -> Result<Self> {
        settings.validate()?;
        let filter = SensorFilter::new(configs, dt)?;
        filter.check(MOST_LATE)?;
        let n_flat = filter.n_flat();
        let rows = |array: u8, n: usize| (0..n as u32).map(move |row| Place { array, row });
        let compiled = |recording: &Recording, n_input: usize, results: Vec<Place>| {
            let arguments = rows(0, n_flat).chain(rows(1, n_input)).collect();
            Executable::new(&Program::compile(recording)?, RowLayout::new(arguments, results)?)
        };
        let prediction = compiled(&filter.recorded_prediction(gravity), INPUTS, rows(0, n_flat).collect())?;
        let corrections = filter.aids.iter().map(|own| {
            let told = rows(1, TOLD + 2).skip(TOLD);
            let n = own.aid.kind.n_reading() + 2;
            compiled(&filter.recorded_correction(&own.aid), n, rows(0, n_flat).chain(told).collect())
        });
        let n_mean = NAVIGATION + filter.n_bias();
        let onward = Recording::of(n_mean + 6, |z| {
            let mut all = z[..n_mean].to_vec();
            all.resize(n_flat, autodiff::Trace::from(0.0));
            all.extend_from_slice(&z[n_mean..]);
            all.extend([autodiff::Trace::from(0.0); 2]);
            filter.further(&all, gravity)[..NAVIGATION].to_vec()
        });
        let arguments = rows(0, n_mean).chain(rows(1, 6)).collect();
        let layout = RowLayout::new(arguments, rows(0, NAVIGATION).collect())?;
        let late = filter.aids.iter().map(|own| own.schedule.latency).max().unwrap_or(0).max(filter.inertial.latency);
        Ok(Self {
            corrections: corrections.collect::<Result<Vec<_>>>()?,
            prediction,
            onward: Executable::new(&Program::compile(&onward)?, layout)?,
            late: late as usize,
            width: configs.iter().map(|config| config.model.channels().len()).sum(),
            settings: *settings,
            dt,
            filter,
        })
    }

    fn scratch(&self) -> Scratch {
        Scratch {
            prediction: self.prediction.work(),
            corrections: self.corrections.iter().map(Executable::work).collect(),
            onward: self.onward.work(),
            input: Lines::zeros(INPUTS),
            before: Lines::zeros(self.filter.n_flat()),
            flat: vec![0.0; self.filter.n_flat()],
        }
    }
}

impl StateEstimatorBatch {
    /// `n` filters for these sensors in steps of `dt` seconds under `gravity` (m/s², along −z).
    ///
    /// # Errors
    /// As [`StateEstimator::new`](super::StateEstimator::new); [`Error::Value`] for none.
    pub fn new(
        configs: &[SensorConfig],
        settings: &StateEstimatorSettings,
        [dt, gravity]: [f64; 2],
        n: usize,
    ) -> Result<Self> {
        if n == 0 {
            return Err(Error::value("number of estimators", n, "1 or more", "Leave the batch out."));
        }
        let shared = Shared::new(configs, settings, dt, gravity)?;
        let slots = shared.late + 1;
        let own = Own {
            readings: vec![0.0; slots * shared.width],
            inertial: vec![InertialSample::default(); slots],
            trust: vec![Trust::default(); shared.filter.aids.len()],
            ..Own::default()
        };
        let line = Filters {
            state: Lines::zeros(shared.filter.n_flat()),
            ahead: Lines::zeros(NAVIGATION + shared.filter.n_bias()),
            own: std::array::from_fn(|_| own.clone()),
        };
        let mut batch = Self {
            records: shared.filter.aids.iter().map(InnovationRecord::of).collect(),
            work: shared.scratch(),
            lines: vec![line; n.div_ceil(LINE)],
            n,
            saturated: 0,
            begun_anew: 0,
            shared: Arc::new(shared),
        };
        let level = [1.0, 0.0, 0.0, 0.0];
        let still = Frame { position: [0.0; 3], velocity: [0.0; 3], attitude: level, angular_velocity: [0.0; 3] };
        (0..batch.lines.len() * LINE).for_each(|i| batch.begin_lane(i, &still));
        Ok(batch)
    }

    /// Filters.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Never: there is one at least.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// What they know of the sensors.
    pub fn filter(&self) -> &SensorFilter {
        &self.shared.filter
    }

    /// Steps that [`state`](Self::state) stands behind the last one told.
    pub fn late(&self) -> usize {
        self.shared.late
    }

    /// Filter `i` begins where its body is known to be, to the deviations of the settings: pose and velocities in the world. Its sensors
    /// begin too.
    ///
    /// # Panics
    /// If there is no such filter.
    pub fn begin(&mut self, i: usize, known: &Frame<f64>) {
        assert!(i < self.n, "filter {i} of {}", self.n);
        self.begin_lane(i, known);
        let own = &mut self.lines[i / LINE].own[i % LINE];
        (own.step, own.first) = (0, 0);
    }

    /// As [`begin`](Self::begin) for a body that was moved after its last step, whose sensors go on: what was sampled before tells nothing
    /// of it.
    ///
    /// # Panics
    /// If there is no such filter.
    pub fn begin_amid(&mut self, i: usize, known: &Frame<f64>) {
        assert!(i < self.n, "filter {i} of {}", self.n);
        self.begin_lane(i, known);
        let own = &mut self.lines[i / LINE].own[i % LINE];
        own.first = own.step;
    }

    fn begin_lane(&mut self, i: usize, known: &Frame<f64>) {
        let Self { shared, lines, work: Scratch { flat, .. }, .. } = self;
        shared.filter.begin(known, &shared.settings, flat);
        let (line, lane) = (&mut lines[i / LINE], i % LINE);
        line.state.iter_mut().zip(&*flat).for_each(|(row, x)| row[lane] = *x);
        line.ahead.iter_mut().zip(&*flat).for_each(|(row, x)| row[lane] = *x);
        let own = &mut line.own[lane];
        (own.is_told, own.is_changed) = (false, true);
        own.trust.fill(Trust::default());
    }

    /// What the sensors of body `i` read in this step.
    ///
    /// # Panics
    /// If there is no such filter, or for fewer readings than the sensors have.
    pub fn tell(&mut self, i: usize, readings: &[f64]) {
        assert!(i < self.n, "filter {i} of {}", self.n);
        let shared = &*self.shared;
        let own = &mut self.lines[i / LINE].own[i % LINE];
        let slots = shared.late + 1;
        let slot = (own.step % slots as u64) as usize;
        // what is no number is beyond all that is taken in, and can be saved
        let kept = own.readings[slot * shared.width..][..shared.width].iter_mut();
        kept.zip(&readings[..shared.width]).for_each(|(kept, x)| *kept = if x.is_finite() { *x } else { f64::MAX });
        if shared.filter.inertial.sampled(own.step).is_some() {
            let before =
                if own.step == 0 { InertialSample::default() } else { own.inertial[(slot + slots - 1) % slots] };
            let read = readings.array(shared.filter.inertial.first);
            own.inertial[slot] = InertialSample::new(read, &before, &shared.filter, &shared.settings);
            self.saturated += u64::from(own.inertial[slot].is_saturated());
        } else {
            // as good as the last: what is held
            own.inertial[slot] = own.inertial[(slot + slots - 1) % slots];
        }
        own.is_told = true;
    }

    /// All filters that were told what is read go a step further.
    pub fn advance(&mut self) {
        let Self { shared, lines, work, records, begun_anew, .. } = self;
        for line in lines {
            if line.own.iter().any(|own| own.is_told) {
                line.predict(shared, work);
                (0..shared.filter.aids.len()).for_each(|aid| line.correct(shared, work, aid, &mut records[aid]));
                *begun_anew += line.check(shared);
                line.go_on(shared, work);
                for own in line.own.iter_mut().filter(|own| own.is_told) {
                    (own.is_told, own.step) = (false, own.step + 1);
                }
            }
        }
    }

    /// What the estimate of body `i` has come to by now: pose and velocities in the world.
    ///
    /// # Panics
    /// If there is no such filter.
    pub fn estimate(&self, i: usize) -> Frame<f64> {
        let (ahead, lane) = (&self.lines[i / LINE].ahead, i % LINE);
        self.shared.filter.body(&NavigationState::mean(|k| ahead[k][lane]))
    }

    /// The state of filter `i` with its covariance, [`late`](Self::late) steps ago.
    ///
    /// # Panics
    /// If there is no such filter.
    pub fn state(&self, i: usize) -> NavigationState<f64> {
        let (state, lane) = (&self.lines[i / LINE].state, i % LINE);
        let flat: Vec<f64> = state.iter().map(|row| row[lane]).collect();
        NavigationState::read(&flat, self.shared.filter.n_bias())
    }

    /// Numbers of a saved filter.
    pub fn n_saved(&self) -> usize {
        let shared = &*self.shared;
        let slots = shared.late + 1;
        shared.filter.n_flat()
            + NAVIGATION
            + shared.filter.n_bias()
            + 3
            + slots * (shared.width + 8)
            + 6 * shared.filter.aids.len()
    }

    /// Writes all that later estimates of filter `i` depend on.
    ///
    /// # Panics
    /// If there is no such filter, or on a slice of another length than [`n_saved`](Self::n_saved).
    pub fn save(&self, i: usize, saved: &mut [f64]) {
        assert!(saved.len() == self.n_saved(), "{} numbers for a filter of {}", saved.len(), self.n_saved());
        let (mut line, mut at) = (self.lines[i / LINE].clone(), 0);
        line.each(i % LINE, &mut |x| {
            saved[at] = *x;
            at += 1;
        });
    }

    /// Filter `i` goes on from a state of [`save`](Self::save), with the same bits.
    ///
    /// # Errors
    /// [`Error::Value`] for another length, numbers that are not finite, and a count of steps that is none; the filter is then as it was.
    ///
    /// # Panics
    /// If there is no such filter.
    pub fn restore(&mut self, i: usize, saved: &[f64]) -> Result<()> {
        let (n, remedy) = (self.n_saved(), "Restore what a filter of the same sensors saved.");
        if saved.len() != n {
            return Err(Error::value("saved filter: length", saved.len(), n.to_string(), remedy));
        }
        if let Some(x) = saved.iter().find(|x| !x.is_finite()) {
            return Err(Error::value("saved filter", x, "finite", remedy));
        }
        let is_count = |x: f64| (0.0..=9_007_199_254_740_992.0).contains(&x) && x.fract() == 0.0;
        if !(is_count(saved[0]) && is_count(saved[1]) && saved[1] <= saved[0]) {
            let value = format!("{}, the first {}", saved[0], saved[1]);
            return Err(Error::value("saved filter: steps", value, "whole numbers, the first no later", remedy));
        }
        let mut at = 0;
        self.lines[i / LINE].each(i % LINE, &mut |x| {
            *x = saved[at];
            at += 1;
        });
        Ok(())
    }

    /// How readings of all filters agreed with what was expected, sensor by sensor, since the batch was made.
    pub fn records(&self) -> &[InnovationRecord] {
        &self.records
    }

    /// Samples of inertial units at a limit or no numbers.
    pub fn saturated(&self) -> u64 {
        self.saturated
    }

    /// As [`StateEstimator::begun_anew`](super::StateEstimator::begun_anew), of all filters.
    pub fn begun_anew(&self) -> u64 {
        self.begun_anew
    }
}

impl Filters {
    /// Visits every number of a lane; steps first.
    fn each(&mut self, lane: usize, visit: &mut dyn FnMut(&mut f64)) {
        let own = &mut self.own[lane];
        let (mut step, mut first) = (own.step as f64, own.first as f64);
        let mut is_changed = f64::from(u8::from(own.is_changed));
        visit(&mut step);
        visit(&mut first);
        visit(&mut is_changed);
        (own.step, own.first, own.is_told) = (step as u64, first as u64, false);
        own.is_changed = is_changed == 1.0;
        self.state.iter_mut().chain(&mut *self.ahead).for_each(|row| visit(&mut row[lane]));
        own.readings.iter_mut().for_each(&mut *visit);
        own.inertial.iter_mut().for_each(|own| own.numbers.iter_mut().chain(&mut own.added).for_each(&mut *visit));
        for own in &mut own.trust {
            [&mut own.left_out_for, &mut own.last_squared].into_iter().chain(&mut own.last).for_each(&mut *visit);
        }
    }

    /// The step whose sample the filter of a lane comes to now, if any.
    fn reached(own: &Own, shared: &Shared) -> Option<u64> {
        own.step.checked_sub(shared.late as u64).filter(|at| own.is_told && *at >= own.first)
    }

    /// The sample that was read at step `k`.
    fn inertial<'a>(own: &'a Own, shared: &Shared, k: u64) -> &'a InertialSample {
        &own.inertial[(k % (shared.late as u64 + 1)) as usize]
    }

    fn predict(&mut self, shared: &Shared, work: &mut Scratch) {
        let inertial = &shared.filter.inertial;
        let (mut due, mut is_begun) = ([false; LINE], [false; LINE]);
        for (lane, own) in self.own.iter().enumerate() {
            let Some(at) = Self::reached(own, shared).filter(|at| at.is_multiple_of(inertial.every)) else { continue };
            let sample = Self::inertial(own, shared, at + inertial.latency);
            if at == 0 {
                // begun where it is known: its sample says how it turns
                (0..3).for_each(|k| self.state[10 + k][lane] = sample.numbers[3 + k]);
                is_begun[lane] = true;
                continue;
            }
            due[lane] = true;
            let numbers = sample.numbers.iter().chain(&sample.added);
            work.input.iter_mut().zip(numbers).for_each(|(row, x)| row[lane] = *x);
        }
        self.own.iter_mut().zip(is_begun).for_each(|(own, is_begun)| own.is_changed = is_begun);
        let Scratch { prediction, input, before, .. } = work;
        run(&shared.prediction, prediction, [&mut self.state, input], before, &due);
    }

    fn correct(&mut self, shared: &Shared, work: &mut Scratch, aid: usize, record: &mut InnovationRecord) {
        let known = &shared.filter.aids[aid];
        let schedule = &known.schedule;
        let n = known.aid.kind.n_reading();
        let period = schedule.every as f64 * shared.dt;
        let mut asked = [false; LINE];
        for lane in 0..LINE {
            // nothing is within a gate of zero
            work.input[n][lane] = 0.0;
            work.input[n + 1][lane] = 1.0;
            let Some(at) = Self::reached(&self.own[lane], shared).filter(|at| at.is_multiple_of(schedule.every)) else {
                continue;
            };
            let believed = (&shared.settings, self.largest_variance(shared, lane));
            let own = &mut self.own[lane];
            let slot = ((at + schedule.latency) % (shared.late as u64 + 1)) as usize;
            let read = &own.readings[slot * shared.width + schedule.first..];
            let Some((numbers, wanted)) = own.trust[aid].ask(known, believed, read, record) else { continue };
            asked[lane] = true;
            let inputs = numbers[..n].iter().chain(&wanted);
            work.input.iter_mut().zip(inputs).for_each(|(row, x)| row[lane] = *x);
        }
        if asked == [false; LINE] {
            return;
        }
        let mut arrays = [Rows::Write(&mut self.state), Rows::Write(&mut work.input)];
        let ran = shared.corrections[aid].run(&mut work.corrections[aid], &mut arrays, LINE);
        ran.expect("rows of the filters");
        for lane in (0..LINE).filter(|lane| asked[*lane]) {
            let [squared, is_taken] = [work.input[TOLD][lane], work.input[TOLD + 1][lane]];
            self.own[lane].is_changed |= is_taken == 1.0;
            self.own[lane].trust[aid].count(Agreement { squared, is_taken }, period, record);
        }
    }

    /// Begins anew where nothing is known any more; how many.
    fn check(&mut self, shared: &Shared) -> u64 {
        let (mean, n) = (NAVIGATION + shared.filter.n_bias(), shared.filter.n_error());
        let (mut largest, mut least) = ([0.0; LINE], [0.0; LINE]);
        for row in &self.state[..mean] {
            // a sum with what is no number is none
            (0..LINE).for_each(|lane| largest[lane] += row[lane].abs());
        }
        for i in 0..n {
            let row = &self.state[mean + i * (n + 1)];
            (0..LINE).for_each(|lane| {
                largest[lane] += row[lane];
                least[lane] = f64::min(least[lane], row[lane]);
            });
        }
        let mut n_anew = 0;
        for lane in (0..LINE).filter(|lane| !(0.0..SUSPECT).contains(&largest[*lane]) || least[*lane] < 0.0) {
            let mut flat: Vec<f64> = self.state.iter().map(|row| row[lane]).collect();
            if begin_anew(&mut flat, &shared.filter.bias_start) {
                self.state.iter_mut().zip(&flat).for_each(|(row, x)| row[lane] = *x);
                self.own[lane].is_changed = true;
                n_anew += 1;
            }
        }
        n_anew
    }

    /// The mean at present. Where nothing was taken in, that is the last one a sample further: the way from the filter's state is the same.
    fn go_on(&mut self, shared: &Shared, work: &mut Scratch) {
        let inertial = &shared.filter.inertial;
        let is_anew = |own: &Own| shared.late == 0 || inertial.latency > 0 || own.is_changed;
        // what it began with is known of the step before its first sample, or of that itself
        let behind = |own: &Own| (own.step - own.first.saturating_sub(1)).min(shared.late as u64);
        let mut first = shared.late as u64;
        for (lane, own) in self.own.iter().enumerate().filter(|(_, own)| own.is_told) {
            if is_anew(own) {
                self.ahead.iter_mut().zip(&*self.state).for_each(|(ahead, x)| ahead[lane] = x[lane]);
            }
            first = first.min(if is_anew(own) { 1 } else { behind(own) });
        }
        for further in first.max(1)..=shared.late as u64 {
            let mut due = [false; LINE];
            for (lane, own) in self.own.iter().enumerate().filter(|(_, own)| own.is_told) {
                let at = own.step - behind(own) + further;
                let is_due = further <= behind(own) && at.is_multiple_of(inertial.every);
                if !is_due || further < behind(own) && !is_anew(own) {
                    continue;
                }
                due[lane] = true;
                // what is not read yet goes on as what was read last
                let sample = Self::inertial(own, shared, (at + inertial.latency).min(own.step));
                work.input.iter_mut().zip(&sample.numbers).for_each(|(row, x)| row[lane] = *x);
            }
            let Scratch { onward, input, before, .. } = work;
            run(&shared.onward, onward, [&mut self.ahead, input], before, &due);
        }
        self.own.iter_mut().for_each(|own| own.is_changed = false);
    }

    fn largest_variance(&self, shared: &Shared, lane: usize) -> f64 {
        let (first, n) = (NAVIGATION + shared.filter.n_bias(), ERRORS + shared.filter.n_bias());
        (0..n).map(|i| self.state[first + i * (n + 1)][lane]).fold(f64::MIN_POSITIVE, f64::max)
    }
}

/// Runs a program over the lanes that are due; the others keep what they have.
fn run(
    program: &Executable<[f64; LINE]>,
    work: &mut Work<[f64; LINE]>,
    [state, input]: [&mut Lines; 2],
    before: &mut Lines,
    due: &[bool; LINE],
) {
    if *due == [false; LINE] {
        return;
    }
    let is_all = *due == [true; LINE];
    if !is_all {
        before[..state.len()].copy_from_slice(state);
    }
    let mut arrays = [Rows::Write(state), Rows::Read(input)];
    program.run(work, &mut arrays, LINE).expect("rows of the filters");
    if !is_all {
        for (row, before) in state.iter_mut().zip(&**before) {
            (0..LINE).filter(|lane| !due[*lane]).for_each(|lane| row[lane] = before[lane]);
        }
    }
}
