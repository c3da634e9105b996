//! The steady filter about hover against the one whose covariance goes along, against prompt readings, and in flight.

use super::*;
use crate::estimation::{EstimatorSettings, KalmanFilter};
use dynamics::{Physics, vehicles};
use rng::{Purpose, Stream};

const DT: f64 = 0.002;

fn hummingbird() -> Plant {
    Plant::of_vehicle(&vehicles::by_name("hummingbird").unwrap(), Physics { dt: DT, ..Physics::default() }).unwrap()
}

fn sensors(list: &str) -> Vec<SensorConfig> {
    SensorConfig::parse_list(list).unwrap()
}

fn timed(own: &mut SensorConfig, every: u64, latency: u64) {
    (own.every, own.rate, own.latency, own.delay) = (Some(every), None, Some(latency), None);
}

#[test]
fn gains_of_several_rates_are_those_that_a_covariance_that_goes_along_comes_to() {
    let plant = hummingbird();
    let mut list = sensors("imu:bmi088,motion_capture:optical,barometer:px4");
    timed(&mut list[1], 5, 0);
    timed(&mut list[2], 4, 0);
    let filter = HoverKalman::new(&plant, &list, &HoverKalmanSettings::default()).unwrap();
    assert_eq!(filter.period(), 20);
    let n = filter.a.nrows();
    let mut along = KalmanFilter::new(DVector::zeros(n), DMatrix::identity(n, n)).unwrap();
    let nothing = DVector::zeros(filter.b.ncols());
    let mut worst: f64 = 0.0;
    for k in 0..2000 {
        for own in filter.told.iter().filter(|own| own.is_due(k)) {
            let d = DMatrix::zeros(own.n(), nothing.len());
            let expected = &own.rows * &along.state;
            let told = along.correct([&own.rows, &d], &nothing, &expected, &own.variance).unwrap();
            if k >= 1900 {
                let own = &own.weights[own.place(k)];
                worst = worst.max((&told.covariance * own - DMatrix::identity(own.nrows(), own.nrows())).amax());
            }
        }
        if k >= 1900 {
            let own = along.covariance.view((0, 0), (9, 9)).into_owned();
            worst = worst.max((&filter.known[k % 20] - &own).amax() / own.amax());
        }
        along.predict([&filter.a, &filter.b], &nothing, &filter.process);
    }
    println!("covariances and innovations of a period off by {worst:.1e}");
    assert!(worst < 1e-6);
}

#[test]
fn what_is_late_is_taken_in_where_it_belongs() {
    const LATE: usize = 12;
    let of = |latency: u64| {
        let mut list = sensors("imu:bmi088,motion_capture:optical");
        timed(&mut list[1], 5, latency);
        let mut own = HoverKalman::new(&hummingbird(), &list, &HoverKalmanSettings::default()).unwrap();
        let mut start = own.hover.clone();
        // on a heading of its own
        let turned = multiply(about_vertical(1.2), start[..].array(6));
        start[6..10].copy_from_slice(&turned);
        own.begin(&start);
        own
    };
    let (mut late, mut prompt) = (of(LATE as u64), of(0));
    let mut draw = Stream::new(2, 0, 0, Purpose::TASK);
    let half = 0.6_f64;
    let told: Vec<[f64; 8]> = (0..400)
        .map(|_| {
            let mut noise = || 1e-3 * draw.normal();
            [noise(), noise(), noise(), half.cos(), noise(), noise(), half.sin(), 1.0]
        })
        .collect();
    for k in 0..400 {
        let felt: [f64; 6] = std::array::from_fn(|i| if i == 2 { 9.81 } else { 0.01 * draw.normal() });
        // nothing is told beyond the last sample that came late
        let now = if k + LATE < 400 { told[k / 5 * 5] } else { [0.0; 8] };
        prompt.step(&[&felt[..], &now].concat());
        let behind = if k < LATE { told[0] } else { told[(k - LATE) / 5 * 5] };
        late.step(&[&felt[..], &behind].concat());
        let command: Vec<f64> = prompt.trimmed.iter().map(|u| u + 0.01 * draw.normal()).collect();
        prompt.apply(&command);
        late.apply(&command);
    }
    let off = late.state().iter().zip(prompt.state()).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
    // of the last samples nothing is told yet
    let [less, more] =
        [&late, &prompt].map(|own| own.known.iter().map(|p| p.view((6, 6), (3, 3)).trace()).sum::<f64>());
    println!("late and prompt estimates off by {off:.1e}; variance of the attitude {less:.2e} and {more:.2e} rad²");
    assert!(off < 1e-10 && less > 1.05 * more);
}

#[test]
fn an_estimate_is_the_same_whichever_way_it_heads() {
    let list = sensors("imu:bmi088,motion_capture:optical");
    let flown = |psi: f64| {
        let mut own = HoverKalman::new(&hummingbird(), &list, &HoverKalmanSettings::default()).unwrap();
        let mut start = own.hover.clone();
        let turned_by = |state: &mut [f64]| {
            let attitude = multiply(about_vertical(psi), state.array(6));
            state[6..10].copy_from_slice(&attitude);
        };
        turned_by(&mut start);
        own.begin(&start);
        let mut draw = Stream::new(4, 0, 0, Purpose::TASK);
        for _ in 0..300 {
            let noise: [f64; 6] = std::array::from_fn(|_| 0.01 * draw.normal());
            let place = turned([noise[0], noise[1], noise[2]], psi);
            let small = dynamics::spatial::exponential([noise[3], noise[4], noise[5]]);
            let q = multiply(about_vertical(psi), small);
            let felt = [0.0, 0.0, 9.81, noise[3], noise[4], noise[5]];
            own.step(&[&felt[..], &place, &q, &[1.0]].concat());
            let command: Vec<f64> = own.trimmed.iter().map(|u| u + noise[0]).collect();
            own.apply(&command);
        }
        let mut state = own.state().to_vec();
        for first in [0, 3] {
            let back = turned(state[first..].array(0), -psi);
            state[first..first + 3].copy_from_slice(&back);
        }
        let back = multiply(about_vertical(-psi), state[..].array(6));
        state[6..10].copy_from_slice(&back);
        state
    };
    let (along, across) = (flown(0.0), flown(2.3));
    let off = along.iter().zip(&across).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
    println!("estimates off by {off:.1e}");
    assert!(off < 1e-9);
}

#[test]
fn what_no_steady_filter_can_do_is_refused_by_name() {
    let plant = hummingbird();
    let mut odd = sensors("imu:bmi088,motion_capture:optical,barometer:px4");
    timed(&mut odd[1], 97, 0);
    timed(&mut odd[2], 89, 0);
    for (list, words) in [
        (sensors("imu:bmi088,barometer:px4"), "seen by an output"),
        (sensors("imu,motion_capture:optical"), "sensor 'imu': noise"),
        (sensors("lidar"), "none that it takes in"),
        (odd, "8633"),
    ] {
        let error = HoverKalman::new(&plant, &list, &HoverKalmanSettings::default()).unwrap_err().to_string();
        println!("{error}");
        assert!(error.contains(words), "{error}");
    }
    let settings = HoverKalmanSettings { acceleration: 0.0, ..Default::default() };
    assert!(EstimatorSettings::Kalman(settings).validate().unwrap_err().to_string().contains("acceleration"));
    // no inertial unit is needed
    assert!(HoverKalman::new(&plant, &sensors("motion_capture:optical"), &HoverKalmanSettings::default()).is_ok());
}
