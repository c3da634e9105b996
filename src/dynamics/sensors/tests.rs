use super::cast::RayScene;
use super::presets::preset;
use super::*;
use crate::Frame;
use crate::spatial::{add, cross, exponential, from_euler, rotate, rotate_back};

const G: f64 = 9.81;
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

fn frame(position: [f64; 3], velocity: [f64; 3], attitude: [f64; 4], angular_velocity: [f64; 3]) -> Frame<f64> {
    Frame { position, velocity, attitude, angular_velocity }
}

fn resting(position: [f64; 3], attitude: [f64; 4]) -> GroundTruth {
    GroundTruth::at(&frame(position, [0.0; 3], attitude, [0.0; 3]), [0.0; 3], [0.0; 3], G)
}

fn made(config: &SensorConfig, dt: f64) -> Sensor {
    Sensor::new(config, dt, &["drone".to_string()]).unwrap()
}

fn ideal(kind: &str) -> SensorConfig {
    SensorConfig::new(kind, SensorKind::by_name(kind).unwrap().ideal())
}

fn gyroscope(error: ErrorModel) -> SensorConfig {
    SensorConfig::new("imu", SensorModel::Imu(Imu { gyroscope: error, ..Imu::default() }))
}

fn of_toml(text: &str) -> std::result::Result<SensorConfig, toml::de::Error> {
    toml::from_str(text)
}

/// Reads where nothing is in sight.
trait Blind<T: ?Sized> {
    fn read(&mut self, truth: &T) -> &[f64];
}

impl Blind<GroundTruth> for Sensor {
    fn read(&mut self, truth: &GroundTruth) -> &[f64] {
        self.step(truth, &mut SensorContext::new(&mut RayScene::default(), &[], &mut RayScratch::default()))
    }
}

impl Blind<[GroundTruth]> for SensorSet {
    fn read(&mut self, truths: &[GroundTruth]) -> &[f64] {
        self.step(truths, &mut SensorContext::new(&mut RayScene::default(), &[], &mut RayScratch::default()))
    }
}

/// Any motion, for tests of what does not depend on it.
fn wandering(k: u64) -> GroundTruth {
    let t = 0.002 * k as f64;
    let attitude = from_euler(0.2 * t.sin(), 0.3 * (2.0 * t).sin(), t);
    let frame = frame([t.sin(), t.cos(), 1.0 + 0.3 * t.sin()], [t.cos(), -t.sin(), 0.1], attitude, [0.1, 0.2 * t, 0.3]);
    GroundTruth::at(&frame, [t.sin(), 0.2, 0.0], [0.1, 0.0, t.cos()], G)
}

/// The three axes of a resting gyroscope, `n` samples every `dt` seconds.
fn gyroscope_at_rest(error: ErrorModel, dt: f64, n: usize) -> [Vec<f64>; 3] {
    let mut sensor = made(&gyroscope(error), dt);
    sensor.reset(3, 1, 4);
    let truth = resting([0.0; 3], UPRIGHT);
    let mut axes = [const { Vec::new() }; 3];
    for _ in 0..n {
        let reading = sensor.read(&truth);
        for (axis, values) in axes.iter_mut().enumerate() {
            values.push(reading[3 + axis]);
        }
    }
    axes
}

/// Allan deviation over clusters of `m` samples: √(½ mean (ȳ⁺ − ȳ)²), of all axes together.
fn allan_deviation(axes: &[Vec<f64>], m: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for values in axes {
        let means: Vec<f64> = values.chunks_exact(m).map(|c| c.iter().sum::<f64>() / m as f64).collect();
        for pair in means.windows(2) {
            sum += (pair[1] - pair[0]).powi(2);
            count += 1.0;
        }
    }
    (0.5 * sum / count).sqrt()
}

#[test]
fn white_noise_has_the_allan_deviation_of_its_density_and_the_slope_of_minus_one_half() {
    let (sigma, dt) = (2.44e-4, 0.01);
    let axes = gyroscope_at_rest(ErrorModel { density: PerAxis::Same(sigma), ..ErrorModel::default() }, dt, 200_000);
    let levels: Vec<f64> = [1, 10, 100].iter().map(|m| allan_deviation(&axes, *m)).collect();
    for (m, level) in [1.0, 10.0, 100.0].into_iter().zip(&levels) {
        let ratio = level / (sigma / (m * dt).sqrt());
        println!("white noise, T = {} s: Allan deviation over σ/√T {ratio:.4}", m * dt);
        assert!((ratio - 1.0).abs() < 0.05, "{m}: {ratio}"); // 1.0005, 1.0013, 1.0049
    }
    let slope = (levels[2] / levels[0]).log10() / 2.0;
    println!("slope {slope:.4}");
    assert!((slope + 0.5).abs() < 0.02, "{slope}"); // −0.4990
}

#[test]
fn a_walking_bias_has_the_allan_deviation_of_its_figure_and_the_slope_of_one_half() {
    let (sigma, dt) = (1.44e-5, 0.01);
    let axes = gyroscope_at_rest(ErrorModel { bias_walk: PerAxis::Same(sigma), ..ErrorModel::default() }, dt, 400_000);
    let sizes = [10, 30, 100];
    let levels: Vec<f64> = sizes.iter().map(|m| allan_deviation(&axes, *m)).collect();
    for (m, level) in sizes.into_iter().zip(&levels) {
        let time = m as f64 * dt;
        let ratio = level / (sigma * (time / 3.0).sqrt());
        println!("walk, T = {time} s: Allan deviation over σ_b √(T/3) {ratio:.4}");
        assert!((ratio - 1.0).abs() < 0.05, "{m}: {ratio}"); // 1.0010, 0.9978, 0.9890
    }
    let slope = (levels[2] / levels[0]).log10();
    println!("slope {slope:.4}");
    assert!((slope - 0.5).abs() < 0.02, "{slope}"); // 0.4948
}

#[test]
fn noise_and_bias_do_not_depend_on_the_rate_at_which_they_are_sampled() {
    let error = ErrorModel { density: PerAxis::Same(1e-3), bias_walk: PerAxis::Same(1e-3), ..ErrorModel::default() };
    let level = |dt: f64| allan_deviation(&gyroscope_at_rest(error, dt, (4000.0 / dt) as usize), (1.0 / dt) as usize);
    let [slow, fast] = [0.1, 0.01].map(level);
    println!("Allan deviation over 1 s at 10 Hz {slow:.3e}, at 100 Hz {fast:.3e}");
    // walks of 10 and of 100 steps within the second: 1 + 1/(2 m²) of the level
    assert!((slow / fast - 1.0).abs() < 0.04, "{}", slow / fast); // 0.991
}

#[test]
fn a_gauss_markov_bias_keeps_its_variance_and_forgets_over_its_correlation_time() {
    let (time, spread, dt) = (2.0, 0.3, 0.05);
    let error = ErrorModel {
        bias_start: PerAxis::Same(spread),
        bias_walk: PerAxis::Same(spread * (2.0_f64 / time).sqrt()),
        bias_time: Some(time),
        ..ErrorModel::default()
    };
    let axes = gyroscope_at_rest(error, dt, 400_000);
    let lag = (time / dt) as usize;
    let (mut variance, mut covariance, mut n) = (0.0, 0.0, 0.0);
    for values in &axes {
        for pair in values.windows(lag + 1) {
            variance += pair[0] * pair[0];
            covariance += pair[0] * pair[lag];
            n += 1.0;
        }
    }
    let (deviation, correlation) = ((variance / n).sqrt(), covariance / variance);
    println!("deviation over that given {:.4}, correlation after τ {correlation:.4}", deviation / spread);
    assert!((deviation / spread - 1.0).abs() < 0.03, "{deviation}"); // 0.9951
    assert!((correlation - (-1.0_f64).exp()).abs() < 0.02, "{correlation}"); // 0.3613 of 0.3679
}

#[test]
fn biases_scales_and_misalignments_are_drawn_per_episode_with_the_spreads_given() {
    let error = ErrorModel {
        bias_start: PerAxis::Each([0.1, 0.2, 0.3]),
        scale: 0.01,
        misalignment: 0.02,
        ..ErrorModel::default()
    };
    let mut sensor = made(&gyroscope(error), 0.01);
    let n = 4000;
    let (mut bias, mut mixed) = ([0.0; 3], [0.0; 3]);
    for episode in 0..n {
        let mut read = |rate: [f64; 3]| -> [f64; 3] {
            sensor.reset(1, 0, episode);
            let moving = frame([0.0; 3], [0.0; 3], UPRIGHT, rate);
            sensor.read(&GroundTruth::at(&moving, [0.0; 3], [0.0; 3], G))[3..].try_into().unwrap()
        };
        let (still, turning) = (read([0.0; 3]), read([1.0, 0.0, 0.0]));
        for k in 0..3 {
            bias[k] += still[k].powi(2) / n as f64;
            mixed[k] += (turning[k] - still[k] - if k == 0 { 1.0 } else { 0.0 }).powi(2) / n as f64;
        }
    }
    for (got, want) in bias.into_iter().chain(mixed).zip([0.1, 0.2, 0.3, 0.01, 0.02, 0.02]) {
        println!("spread {:.4} of {want}", got.sqrt());
        assert!((got.sqrt() / want - 1.0).abs() < 0.05, "{} of {want}", got.sqrt()); // 2 % at most
    }
}

#[test]
fn an_imu_at_rest_reads_gravity_upwards_and_no_rate() {
    let mut sensor = made(&ideal("imu"), 0.002);
    assert_eq!(sensor.read(&resting([1.0, 2.0, 3.0], UPRIGHT)), [0.0, 0.0, G, 0.0, 0.0, 0.0]);
    // on its side: body y points down, so that it reads −g along it
    let reading = sensor.read(&resting([0.0; 3], from_euler(-0.5 * std::f64::consts::PI, 0.0, 0.0))).to_vec();
    assert!((reading[1] + G).abs() < 1e-12 && reading[2].abs() < 1e-12, "{reading:?}");
    // and through a mount that is turned by a quarter about x: its z is body −y
    let turned = SensorConfig { rotation: from_euler(0.5 * std::f64::consts::PI, 0.0, 0.0), ..ideal("imu") };
    let reading = made(&turned, 0.002).read(&resting([0.0; 3], UPRIGHT)).to_vec();
    assert!((reading[1] - G).abs() < 1e-12 && reading[2].abs() < 1e-12, "{reading:?}");
}

#[test]
fn falling_freely_an_accelerometer_reads_nothing() {
    let mut sensor = made(&SensorConfig { position: [0.1, 0.2, 0.3], ..ideal("imu") }, 0.01);
    let at = |v: f64| frame([0.0; 3], [1.0, 0.0, v], from_euler(0.4, 0.2, 1.0), [0.0; 3]);
    let reading = sensor.read(&GroundTruth::between(&at(0.0), &at(-G * 0.01), 0.01, G)).to_vec();
    assert!(reading.iter().all(|x| x.abs() < 1e-12), "{reading:?}");
}

/// A body that turns about an axis through a point of the world, beginning at `rate` (rad/s) and gaining `gain` (rad/s²): after t.
fn spinning(axis: [f64; 3], centre: [f64; 3], rate: f64, gain: f64, t: f64) -> Frame<f64> {
    let angle = rate * t + 0.5 * gain * t * t;
    let attitude = exponential(axis.map(|a| a * angle));
    let spin = axis.map(|a| a * (rate + gain * t));
    let position = rotate(attitude, centre);
    frame(position, cross(spin, position), attitude, spin)
}

#[test]
fn on_a_spinning_arm_an_accelerometer_reads_the_closed_form() {
    let (axis, r, dt) = ([0.0, 0.0, 1.0], [0.3, -0.2, 0.1], 1e-3);
    let mut worst = 0.0_f64;
    for (centre, rate, gain) in [([0.0; 3], 30.0, 0.0), ([0.0; 3], 5.0, 40.0), ([0.5, 0.0, 0.0], 3.0, 0.0)] {
        let mut sensor = made(&SensorConfig { position: r, ..ideal("imu") }, dt);
        for k in 1..500 {
            let t = k as f64 * dt;
            let [before, after] = [t - dt, t].map(|t| spinning(axis, centre, rate, gain, t));
            let read = sensor.read(&GroundTruth::between(&before, &after, dt, G)).to_vec();
            // all in body axes, where the place is constant; of the middle of the step
            let (place, w) = (add(centre, r), rate + gain * (t - 0.5 * dt));
            let want = [-w * w * place[0] - gain * place[1], -w * w * place[1] + gain * place[0], G];
            let size = want.iter().map(|x| x * x).sum::<f64>().sqrt();
            for (got, want) in read.iter().zip(want) {
                worst = worst.max((got - want).abs() / size);
            }
        }
    }
    println!("largest error on a spinning arm, relative: {worst:.2e}");
    assert!(worst < 1e-6, "{worst:e}"); // 1.4e-7: an arm whose origin moves, sinc of half the turn in a step
}

#[test]
fn a_first_reading_is_that_of_the_dynamics_and_a_mean_one_turns_with_the_body() {
    // a thrust fixed in a body that turns: what it reads is that thrust, also along x and y
    let (dt, rate, thrust) = (2e-3, 3.0, 12.0);
    let mut sensor = made(&ideal("imu"), dt);
    let (mut v, mut worst) = ([0.0; 3], 0.0_f64);
    let attitude = |t: f64| exponential([0.0, rate * t, 0.0]);
    for k in 0..500 {
        let t = k as f64 * dt;
        let frame_at = |v, t| frame([0.0; 3], v, attitude(t), [0.0, rate, 0.0]);
        let before = frame_at(v, t);
        // ∫ R e_z dt of a turn about y, exactly
        let (from, to) = (rate * t, rate * (t + dt));
        let impulse = [thrust * (from.cos() - to.cos()) / rate, 0.0, thrust * (to.sin() - from.sin()) / rate - G * dt];
        v = add(v, impulse);
        let after = frame_at(v, t + dt);
        if k == 0 {
            let read = sensor.read(&GroundTruth::ahead(&before, &after, dt, G)).to_vec();
            assert!((read[2] - thrust).abs() < 0.1 && read[0].abs() < 0.1, "{read:?}");
        }
        let read = sensor.read(&GroundTruth::between(&before, &after, dt, G)).to_vec();
        for (got, want) in read.iter().zip([0.0, 0.0, thrust]) {
            worst = worst.max((got - want).abs());
        }
    }
    println!("largest error of a turning thrust: {worst:.2e} m/s²");
    assert!(worst < 1e-4, "{worst:e}"); // 1.8e-5
}

/// What is read of a position that tells the step, and whether it is new.
fn delayed(every: u64, latency: u64, steps: u64) -> (Vec<f64>, Vec<bool>) {
    let config = SensorConfig { every: Some(every), latency: Some(latency), ..ideal("gnss") };
    let mut sensor = made(&config, 0.01);
    (0..steps).map(|k| (sensor.read(&resting([k as f64, 0.0, 0.0], UPRIGHT))[0], sensor.is_new())).unzip()
}

#[test]
fn rate_and_latency_are_exact_to_the_step() {
    for (every, latency) in [(1, 0), (4, 0), (1, 3), (4, 1), (4, 4), (4, 9), (5, 23), (100, 7)] {
        let (read, new) = delayed(every, latency, 400);
        for k in 0..400_u64 {
            let want = k.saturating_sub(latency) / every * every;
            assert_eq!(read[k as usize], want as f64, "every {every}, latency {latency}, step {k}");
            let arrives = k == 0 || k > latency && (k - latency) % every == 0;
            assert_eq!(new[k as usize], arrives, "every {every}, latency {latency}, step {k}");
        }
    }
}

#[test]
fn rates_and_delays_in_si_units_are_whole_numbers_of_steps() {
    let steps = |rate: Option<f64>, delay: Option<f64>, dt: f64| {
        Sensor::new(&SensorConfig { rate, delay, ..ideal("imu") }, dt, &["drone".into()])
            .map(|s| (s.every(), s.latency()))
    };
    assert_eq!(steps(Some(5.0), Some(0.12), 0.002).unwrap(), (100, 60));
    assert_eq!(steps(Some(5.0), Some(0.12), 0.016).unwrap(), (13, 8));
    assert_eq!(steps(Some(500.0), Some(0.0), 0.002).unwrap(), (1, 0));
    let error = steps(Some(500.0), None, 0.016).unwrap_err().to_string();
    assert!(error.contains("500 Hz") && error.contains("every"), "{error}");
}

#[test]
fn readings_are_clipped_and_are_multiples_of_the_least_significant_bit() {
    let error = ErrorModel {
        density: PerAxis::Same(0.02),
        limits: Some([-1.0, 2.0]),
        resolution: 0.125,
        ..ErrorModel::default()
    };
    let mut sensor = made(&gyroscope(error), 0.01);
    let mut seen = [false; 2];
    for k in 0..2000 {
        let rate = 4.0 * (0.01 * f64::from(k)).sin();
        let moving = frame([0.0; 3], [0.0; 3], UPRIGHT, [rate, 0.1, 0.0]);
        let reading = sensor.read(&GroundTruth::at(&moving, [0.0; 3], [0.0; 3], G));
        let x = reading[3];
        assert!((-1.0..=2.0).contains(&x) && (x / 0.125).fract() == 0.0, "{x}");
        assert!((-1.0..=2.0).contains(&rate) || x == rate.clamp(-1.0, 2.0) || (rate - x).abs() < 1.5, "{rate}: {x}");
        seen = [seen[0] || x == -1.0, seen[1] || x == 2.0];
    }
    assert_eq!(seen, [true; 2]);
    // without noise, the nearest multiple
    let mut sensor = made(&gyroscope(ErrorModel { density: PerAxis::Same(0.0), ..error }), 0.01);
    let moving = frame([0.0; 3], [0.0; 3], UPRIGHT, [0.19, -0.07, 9.0]);
    assert_eq!(sensor.read(&GroundTruth::at(&moving, [0.0; 3], [0.0; 3], G))[3..], [0.25, -0.125, 2.0]);
}

#[test]
fn a_saved_sensor_goes_on_with_the_same_bits() {
    let text = presets::REGISTRY.iter().map(|p| SensorConfig {
        latency: Some(7),
        delay: None,
        ..SensorConfig::of_preset(p.kind.to_string() + p.name, p)
    });
    let configs: Vec<SensorConfig> = text.collect();
    let new = || SensorSet::new(&configs, 0.002, &["drone".to_string()]).unwrap();
    let mut sensors = new();
    sensors.reset(u64::MAX - 3, 1 << 40, 12);
    for at in [0, 1, 13, 1000] {
        for k in 0..at {
            sensors.read(&[wandering(k)]);
        }
        let mut saved = vec![0.0; sensors.n_saved()];
        sensors.save(&mut saved);
        let mut other = new();
        other.restore(&saved).unwrap();
        let mut ahead = sensors.clone();
        for k in at..at + 500 {
            let (a, b) = (ahead.read(&[wandering(k)]).to_vec(), other.read(&[wandering(k)]).to_vec());
            assert!(
                a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits()),
                "saved after {at}, step {k}: {a:?} {b:?}"
            );
        }
    }
    let mut saved = vec![0.0; sensors.n_saved()];
    sensors.save(&mut saved);
    assert!(sensors.restore(&saved[1..]).unwrap_err().is_value());
    saved[0] = 0.5;
    assert!(sensors.restore(&saved).unwrap_err().to_string().contains("whole number"));
}

#[test]
fn readings_depend_on_seed_environment_episode_and_name_and_on_nothing_else() {
    let configs: Vec<SensorConfig> =
        presets::REGISTRY.iter().map(|p| SensorConfig::of_preset(p.name.to_string() + p.kind, p)).collect();
    let run = |configs: &[SensorConfig], [seed, environment, episode]: [u64; 3]| -> Vec<Vec<u64>> {
        let mut sensors = SensorSet::new(configs, 0.002, &["drone".to_string()]).unwrap();
        // what was before does not matter
        sensors.reset(99, 99, 99);
        sensors.read(&[wandering(5)]);
        sensors.reset(seed, environment, episode);
        let mut all = vec![Vec::new(); configs.len()];
        for k in 0..300 {
            sensors.read(&[wandering(k)]);
            for (own, sensor) in all.iter_mut().zip(sensors.sensors()) {
                own.extend(sensor.reading().iter().map(|x| x.to_bits()));
            }
        }
        all
    };
    let base = run(&configs, [1, 2, 3]);
    assert_eq!(base, run(&configs, [1, 2, 3]));
    // in threads of their own, in another order
    let mut reversed = configs.clone();
    reversed.reverse();
    let threads: Vec<Vec<Vec<u64>>> = std::thread::scope(|s| {
        let both = [0, 1].map(|_| s.spawn(|| run(&reversed, [1, 2, 3])));
        both.into_iter().map(|t| t.join().unwrap()).collect()
    });
    for mut all in threads {
        all.reverse();
        assert_eq!(base, all);
    }
    for other in [[2, 2, 3], [1, 3, 3], [1, 2, 4]] {
        let own = run(&configs, other);
        // in an empty world what looks sees nothing, with any noise
        let looks = |config: &SensorConfig| matches!(config.model, SensorModel::Lidar(_) | SensorModel::Camera(_));
        let mut pairs = configs.iter().zip(own.iter().zip(&base));
        assert!(pairs.all(|(config, (a, b))| looks(config) || a != b), "{other:?}");
    }
    let mut renamed = configs[..1].to_vec();
    renamed[0].name.push('2');
    assert!(run(&renamed, [1, 2, 3])[0] != base[0]);
}

#[test]
fn motion_capture_loses_the_share_given_in_runs_of_the_length_given_and_holds_the_last_pose() {
    let model =
        SensorModel::MotionCapture(MotionCapture { dropout: 0.1, dropout_time: 0.05, ..MotionCapture::default() });
    let mut sensor = made(&SensorConfig::new("room", model), 0.01);
    let n = 200_000;
    let (mut lost, mut runs, mut held) = (0.0, 0.0, [0.0; 8]);
    for k in 0..n {
        let reading: [f64; 8] = sensor.read(&resting([f64::from(k), 0.0, 0.0], UPRIGHT)).try_into().unwrap();
        if reading[7] == 0.0 {
            lost += 1.0;
            runs += held[7];
            assert_eq!(reading[..7], held[..7]);
        } else {
            assert_eq!(reading[0], f64::from(k));
        }
        held = reading;
    }
    let (share, length) = (lost / f64::from(n), lost / runs);
    println!("dropouts: share {share:.4} of 0.1, runs of {length:.3} samples of 5");
    assert!((share / 0.1 - 1.0).abs() < 0.1 && (length / 5.0 - 1.0).abs() < 0.1, "{share}, {length}"); // 0.0998, 4.95
}

#[test]
fn motion_capture_turns_by_its_error_about_mount_axes() {
    let error = ErrorModel { deviation: PerAxis::Each([0.01, 0.02, 0.03]), ..ErrorModel::default() };
    let model = SensorModel::MotionCapture(MotionCapture { attitude_error: error, ..MotionCapture::default() });
    let mut sensor = made(&SensorConfig::new("room", model), 0.01);
    let q = from_euler(0.3, -0.4, 2.9);
    let mut square = [0.0; 3];
    for _ in 0..20_000 {
        let reading = sensor.read(&resting([0.0; 3], q)).to_vec();
        assert!(reading[3] >= 0.0);
        // rotated back by the truth, a small rotation remains: twice its vector part, with the sign of w
        let [w, x, y, z] = crate::spatial::multiply([q[0], -q[1], -q[2], -q[3]], reading[3..7].try_into().unwrap());
        for (sum, part) in square.iter_mut().zip([x, y, z]) {
            *sum += (2.0 * part * w.signum()).powi(2) / 20_000.0;
        }
    }
    for (got, want) in square.into_iter().zip([0.01, 0.02, 0.03]) {
        assert!((got.sqrt() / want - 1.0).abs() < 0.03, "{} of {want}", got.sqrt());
    }
}

#[test]
fn a_barometer_reads_the_standard_atmosphere_and_drifts() {
    let model = SensorModel::Barometer(Barometer { altitude: 488.0, drift: 2.0, ..Barometer::default() });
    let mut sensor = made(&SensorConfig { every: Some(2), ..SensorConfig::new("baro", model) }, 0.5);
    for k in 0..5_i32 {
        let read = sensor.read(&resting([0.0, 0.0, 12.0], UPRIGHT))[0];
        let want = 101_325.0 * (1.0 - 0.0065 * 500.0 / 288.0_f64).powf(5.256) + 2.0 * f64::from(k / 2);
        assert!((read - want).abs() < 1e-9, "{read} {want}");
    }
    // ISA tables: 95 461 Pa at 500 m, with 288.15 K
    let read = made(
        &SensorConfig::new("b", SensorModel::Barometer(Barometer { altitude: 500.0, ..Barometer::default() })),
        1.0,
    )
    .read(&resting([0.0; 3], UPRIGHT))[0];
    println!("pressure at 500 m {read:.1} Pa");
    assert!((read - 95_461.0).abs() < 5.0, "{read}"); // 95 457.7
    // above the air and far below the sea nothing breaks
    for z in [1e6, -1e4, f64::NAN] {
        let read = made(&ideal("barometer"), 1.0).read(&resting([0.0, 0.0, z], UPRIGHT))[0];
        assert!(read >= 0.0 && read.is_finite() || z.is_nan(), "{read}");
    }
}

#[test]
fn a_magnetometer_reads_the_field_along_its_axes_plus_hard_iron() {
    let field = [20e-6, 1e-6, -40e-6];
    let error = ErrorModel { offset: PerAxis::Each([1e-6, 2e-6, 3e-6]), ..ErrorModel::default() };
    let q = from_euler(0.3, -0.2, 1.1);
    let rotation = from_euler(0.0, 0.0, 0.5);
    let config =
        SensorConfig { rotation, ..SensorConfig::new("mag", SensorModel::Magnetometer(Magnetometer { field, error })) };
    let read = made(&config, 0.01).read(&resting([0.0; 3], q)).to_vec();
    let want = add(rotate_back(rotation, rotate_back(q, field)), [1e-6, 2e-6, 3e-6]);
    for (got, want) in read.iter().zip(want) {
        assert!((got - want).abs() < 1e-18, "{got:e} {want:e}");
    }
}

#[test]
fn an_antenna_on_a_mast_moves_with_its_lever() {
    let q = from_euler(0.1, 0.2, 0.3);
    let spin = [0.4, -0.5, 2.0];
    let mut sensor = made(&SensorConfig { position: [0.1, 0.0, 0.4], ..ideal("gnss") }, 0.01);
    let truth = GroundTruth::at(&frame([1.0, 2.0, 3.0], [0.5, 0.0, -0.1], q, spin), [0.0; 3], [0.0; 3], G);
    let read = sensor.read(&truth).to_vec();
    let lever = rotate(q, [0.1, 0.0, 0.4]);
    let want = [add([1.0, 2.0, 3.0], lever), add([0.5, 0.0, -0.1], cross(spin, lever))].concat();
    for (got, want) in read.iter().zip(want) {
        assert!((got - want).abs() < 1e-12, "{got} {want}");
    }
}

#[test]
fn position_errors_of_a_receiver_keep_their_spread_from_the_start_on() {
    let config = SensorConfig::of_preset("gnss", preset("gnss", "single_point").unwrap());
    let mut sensor = made(&config, 0.2);
    for late in [0, 300] {
        let mut square = [0.0; 3];
        for episode in 0..2000 {
            sensor.reset(1, 0, episode);
            for _ in 0..late {
                sensor.read(&resting([0.0; 3], UPRIGHT));
            }
            let read = sensor.read(&resting([0.0; 3], UPRIGHT));
            for k in 0..3 {
                square[k] += read[k] * read[k] / 2000.0;
            }
        }
        let spread = square.map(f64::sqrt);
        println!("position errors after {} s: {spread:.3?} m", 0.2 * f64::from(late));
        assert!(spread.iter().zip([1.0, 1.0, 2.0]).all(|(got, want)| (got / want - 1.0).abs() < 0.06), "{spread:?}"); // 1.3 %
    }
}

#[test]
fn a_range_finder_reads_the_closed_form_over_level_ground() {
    let model =
        |cone: f64| SensorModel::Range(Range { ground: 0.5, cone, nearest: 0.1, farthest: 4.0, ..Range::default() });
    let read = |cone: f64, z: f64, tilt: f64| -> [f64; 2] {
        made(&SensorConfig::new("down", model(cone)), 0.01)
            .read(&resting([0.0, 0.0, z], from_euler(0.0, tilt, 0.7)))
            .try_into()
            .unwrap()
    };
    let [d, valid] = read(0.0, 2.0, 0.4);
    assert!((d - 1.5 / 0.4_f64.cos()).abs() < 1e-12 && valid == 1.0);
    // a cone of ±0.3 rad sees the ground 0.1 rad from the vertical
    assert!((read(0.6, 2.0, 0.4)[0] - 1.5 / 0.1_f64.cos()).abs() < 1e-9);
    assert!((read(1.0, 2.0, 0.4)[0] - 1.5).abs() < 1e-9);
    for (z, tilt) in [(5.0, 0.0), (0.55, 0.0), (2.0, 1.6), (2.0, 3.0), (0.4, 0.0)] {
        assert_eq!(read(0.0, z, tilt), [4.0, 0.0], "{z} m, {tilt} rad");
    }
}

#[test]
fn a_range_finder_s_noise_grows_as_given() {
    let config = SensorConfig::of_preset("tof", preset("range", "vl53l1x").unwrap());
    for (d, want) in
        [(1.0, 0.0025 * (1.0 + 80_f64.powf(-1.0))), (2.5, 0.005), (3.5, 0.0025 * (1.0 + 80_f64.powf(1.0 / 1.5)))]
    {
        let mut sensor = made(&config, 0.02);
        let square: f64 = (0..20_000).map(|_| (sensor.read(&resting([0.0, 0.0, d], UPRIGHT))[0] - d).powi(2)).sum();
        let deviation = (square / 20_000.0).sqrt();
        println!("range noise at {d} m: {:.2} mm of {:.2}", 1e3 * deviation, 1e3 * want);
        // readings in mm add 0.29 mm, in squares
        assert!((deviation / want.hypot(1e-3 / 12_f64.sqrt()) - 1.0).abs() < 0.03, "{deviation} {want}"); // 2.55, 5.00, 48.9 mm
    }
}

#[test]
fn optical_flow_is_how_the_point_below_moves_through_the_picture() {
    let (dt, p, v, q) = (1e-6, [0.3, -0.2, 1.7], [0.8, -0.5, 0.3], from_euler(0.3, -0.2, 0.9));
    let spin = [0.4, 0.7, -1.1];
    let mut sensor = made(&ideal("flow"), dt);
    let truth = GroundTruth::at(&frame(p, v, q, rotate(q, spin)), [0.0; 3], [0.0; 3], G);
    let read = sensor.read(&truth).to_vec();
    // the point of the ground on the axis, and where it is seen a moment later: its slope x/d, y/d
    let axis = rotate(q, [0.0, 0.0, -1.0]);
    let d = -p[2] / axis[2];
    let ground = add(p, axis.map(|a| a * d));
    let later_p = add(p, v.map(|v| v * dt));
    let later_q = crate::spatial::multiply(q, exponential(spin.map(|w| w * dt)));
    let seen = rotate_back(later_q, [0, 1, 2].map(|k| ground[k] - later_p[k]));
    let gain = 35.0 / 0.717;
    for k in 0..2 {
        // the ground moves one way, the sensor counts its own motion: the other way
        let want = -gain * seen[k] / -seen[2];
        assert!((read[k] - want).abs() < 1e-5 * want.abs(), "{} {want}", read[k]);
    }
    assert_eq!(read[2], 1.0);
    let near = resting([0.0, 0.0, 0.07], UPRIGHT);
    assert_eq!(made(&ideal("flow"), dt).read(&near), [0.0; 3]);
}

#[test]
fn every_preset_of_the_registry_validates_reads_finite_numbers_and_survives_a_file() {
    for preset in presets::REGISTRY {
        let config = SensorConfig::of_preset("part", preset);
        assert_eq!(config.model.kind(), preset.kind, "{}", preset.name);
        for dt in [0.001, 0.002, 0.004] {
            let mut sensor = made(&config, dt);
            sensor.reset(1, 2, 3);
            for k in 0..200 {
                let reading = sensor.read(&wandering(k));
                assert!(reading.iter().all(|x| x.is_finite()), "{}: {reading:?}", preset.name);
            }
        }
        let text = toml::to_string(&SensorFile { sensor: vec![config.clone()] }).unwrap();
        let back: SensorFile = toml::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}\n{text}", preset.name));
        assert_eq!(back.sensor, std::slice::from_ref(&config), "{text}");
        let json = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<SensorConfig>(&json).unwrap(), config);
        let own: Vec<_> = presets::REGISTRY.iter().filter(|p| (p.name, p.kind) == (preset.name, preset.kind)).collect();
        assert!(own.len() == 1 && !preset.source.is_empty());
    }
}

#[test]
fn a_table_goes_over_its_preset_key_by_key() {
    let text = "name = 'a'\nkind = 'imu'\npreset = 'bmi088'\non = 'drone'\nposition = [0.1, 0, 0]\nevery = 2\n\
                [accelerometer]\ndensity = 5e-3\n[gyroscope]\nlimits = [-8.7, 8.7]\nbias_time = inf";
    let config = of_toml(text).unwrap();
    let SensorModel::Imu(imu) = &config.model else { panic!("{config:?}") };
    assert_eq!(imu.accelerometer.density, PerAxis::Same(5e-3));
    assert_eq!(imu.accelerometer.bias_walk, PerAxis::Same(1.36e-3));
    assert_eq!((imu.gyroscope.limits, imu.gyroscope.density), (Some([-8.7, 8.7]), PerAxis::Same(2.44e-4)));
    assert_eq!((config.every, config.position), (Some(2), [0.1, 0.0, 0.0]));
    // steps stand for the preset's hertz
    let config = of_toml("name = 'a'\nkind = 'gnss'\npreset = 'single_point'\nevery = 3\nlatency = 0").unwrap();
    assert_eq!((config.every, config.rate, config.latency, config.delay), (Some(3), None, Some(0), None));
    let short = SensorConfig::parse_list("imu:bmi088, gnss").unwrap();
    assert_eq!((short[0].name.as_str(), short[1].name.as_str()), ("imu", "gnss"));
}

#[test]
fn what_no_sensor_has_is_refused_with_value_limit_and_remedy() {
    let refused = |text: &str, words: &[&str]| {
        let said = match of_toml(text) {
            Err(error) => error.to_string(),
            Ok(config) => {
                Sensor::new(&config, 0.002, &["drone".into(), "arm".into()]).map(|_| ()).expect_err(text).to_string()
            }
        };
        assert!(words.iter().all(|word| said.contains(word)), "{text}: {said}");
    };
    refused("name = 'a'\nkind = 'imi'", &["kind of sensor", "'imi'", "did you mean 'imu'"]);
    refused("name = 'a'\nkind = 'imu'\npreset = 'bmi880'", &["bmi880", "bmi088"]);
    refused("name = 'a'\nkind = 'imu'\npreset = 'px4'", &["px4", "bmi088"]);
    refused("name = 'a'", &["kind"]);
    refused("kind = 'imu'", &["name"]);
    refused("name = 'a'\nkind = 'imu'\nlatencyy = 1", &["latencyy", "Did you mean `latency`?"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\ndensitty = 1", &["densitty", "Did you mean `density`?"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\ndensity = 'much'", &["expected a number, or three"]);
    refused("name = 'a'\nkind = 'imu'\non = 'drome'", &["body", "'drome'", "drone, arm"]);
    refused("name = 'a, b'\nkind = 'imu'", &["'a, b'", "columns"]);
    refused("name = 'a'\nkind = 'imu'\nevery = 0", &["every", "0", "1 to"]);
    refused("name = 'a'\nkind = 'imu'\nevery = 2\nrate = 100.0", &["every and rate", "both"]);
    refused("name = 'a'\nkind = 'imu'\nlatency = 2\ndelay = 0.1", &["latency and delay", "both"]);
    refused("name = 'a'\nkind = 'imu'\nrate = -1.0", &["rate", "-1", "> 0"]);
    refused("name = 'a'\nkind = 'imu'\nrate = 1e9", &["rate", "every"]);
    refused("name = 'a'\nkind = 'imu'\nlatency = 900000", &["latency", "900000", "steps"]);
    refused("name = 'a'\nkind = 'imu'\ndelay = nan", &["delay", "NaN", "finite"]);
    refused("name = 'a'\nkind = 'imu'\nposition = [1e5, 0, 0]", &["position", "100000"]);
    refused("name = 'a'\nkind = 'imu'\nposition = [nan, 0, 0]", &["position", "NaN"]);
    refused("name = 'a'\nkind = 'imu'\nrotation = [1, 1, 0, 0]", &["rotation", "1.41", "length"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\nlimits = [1, -1]", &["limits", "low < high"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\nlimits = [nan, 1]", &["limits", "low < high"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\nbias_time = 0", &["bias_time", "> 0"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\nscale = 3", &["scale", "3"]);
    refused("name = 'a'\nkind = 'imu'\n[gyroscope]\ndensity = [1, -1, 1]", &["density", "-1"]);
    refused("name = 'a'\nkind = 'barometer'\n[error]\ndensity = [1, 1, 1]", &["density", "three numbers", "one"]);
    refused("name = 'a'\nkind = 'motion_capture'\ndropout = 0.9", &["dropout", "0.9"]);
    refused("name = 'a'\nkind = 'range'\nnearest = 5.0\nfarthest = 4.0", &["farthest", "nearest"]);
    refused("name = 'a'\nkind = 'range'\ngrowth = { from = 2, until = 1, factor = 80 }", &["until", "growth"]);
    refused("name = 'a'\nkind = 'flow'\naperture = 0.0", &["aperture"]);
    let of_file = |text: &str| SensorFile::of(text.parse().unwrap(), "s.toml").map(|file| file.sensor.len());
    assert_eq!(of_file("[[sensor]]\nname = 'a'\nkind = 'imu'\n[[sensor]]\nname = 'b'\nkind = 'gnss'").unwrap(), 2);
    let said = of_file("[[sensor]]\nname = 'a'\nkind = 'imu'\nlatencyy = 2").unwrap_err().to_string();
    assert!(
        said.starts_with("s.toml: [[sensor]] 'a': latencyy") && said.ends_with("Did you mean `latency`?"),
        "{said}"
    );
    assert!(of_file("[[sensors]]\nname = 'a'").unwrap_err().to_string().contains("`sensor`"));
    assert!(of_file("sensor = 3").unwrap_err().is_format());
    let twice = [ideal("imu"), ideal("imu")];
    let said = SensorSet::new(&twice, 0.002, &["drone".into()]).unwrap_err().to_string();
    assert!(said.contains("'imu' twice"), "{said}");
    assert!(SensorSet::new(&twice[..1], f64::NAN, &["drone".into()]).unwrap_err().is_value());
    assert!(SensorSet::new(&twice[..1], 0.002, &[]).unwrap_err().is_unknown_name());
}

#[test]
fn a_truth_that_is_no_number_spoils_its_readings_alone() {
    let configs: Vec<SensorConfig> = presets::REGISTRY
        .iter()
        .map(|p| SensorConfig {
            every: Some(1),
            rate: None,
            latency: Some(0),
            delay: None,
            ..SensorConfig::of_preset(p.name.to_string() + p.kind, p)
        })
        .collect();
    let mut sensors = SensorSet::new(&configs, 0.002, &["drone".into()]).unwrap();
    let mut broken = wandering(1);
    (broken.position, broken.velocity, broken.mean_acceleration) = ([f64::NAN; 3], [f64::INFINITY; 3], [f64::NAN; 3]);
    sensors.read(&[broken]);
    assert!(sensors.read(&[wandering(2)]).iter().all(|x| x.is_finite()));
}

#[test]
fn every_setting_kind_and_preset_stands_in_the_document() {
    let text = include_str!("../../../docs/sensors.md");
    let said = |word: &str| assert!(text.contains(&format!("`{word}`")), "docs/sensors.md does not tell `{word}`");
    settings::COMMON.iter().for_each(|key| said(key));
    presets::REGISTRY.iter().for_each(|preset| said(preset.name));
    for kind in KINDS {
        said(kind.name);
        kind.ideal().table().keys().for_each(|key| said(key));
        kind.optional.iter().for_each(|key| said(key));
        let numbered = |c: char| c.is_ascii_digit() || c == '_';
        for (name, _) in kind.ideal().channels() {
            said(name.trim_end_matches(['x', 'y', 'z', 'w']).trim_end_matches(numbered));
        }
    }
    for (file, name) in [
        (include_str!("chain.rs"), "ErrorModel"),
        (include_str!("range_flow.rs"), "NoiseGrowth"),
        (include_str!("camera.rs"), "Stereo"),
    ] {
        let fields = base::documented::fields(file, name);
        assert!(!fields.is_empty(), "{name} is not where it is looked for");
        fields.iter().for_each(|(key, _)| said(key));
    }
}
