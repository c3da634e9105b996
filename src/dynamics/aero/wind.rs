//! Wind as a velocity of the air in the world: still, constant, sinusoidal, Dryden gusts, or a function of time of one's own.
//!
//! [`Wind`] is configuration; [`WindState`] samples it, with its own memory and random stream, so a wind depends on
//! (configuration, stream, sequence of time steps) and nothing else, and can be saved in mid-gust.

use autodiff::{Recording, Trace};
use base::error::{Error, Result, finite};
use rng::Stream;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Most harmonics of a [`Sinusoid`].
pub(crate) const MAX_HARMONICS: usize = 1024;
/// Metres in a foot.
const FOOT: f64 = 0.3048;
/// The low-altitude form is stated for 10 to 1000 ft; heights outside are held at its ends.
const HEIGHT_RANGE: (f64, f64) = (10.0 * FOOT, 1000.0 * FOOT);

/// Which wind blows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Wind {
    /// None.
    #[default]
    Calm,
    /// The same velocity always.
    Constant {
        /// World, m/s.
        velocity: [f64; 3],
    },
    /// A sum of harmonics per axis.
    Sinusoid(Sinusoid),
    /// A mean wind with turbulence.
    Dryden(Dryden),
    /// Of your own: a value in a program, never in a file.
    #[serde(skip)]
    Own(WrittenWind),
}

/// A wind that is data: a closure, called once with a time that records. Two are equal if they are the same value.
#[derive(Clone)]
pub struct WrittenWind(Arc<Recording>);

impl WrittenWind {
    /// Records `wind`: from the time, s, to the velocity of the air, world, m/s.
    ///
    /// # Errors
    /// That of `wind`; [`Error::Value`] for numbers that it kept from another recording.
    pub fn new<E: From<Error>>(
        wind: impl FnOnce(Trace) -> std::result::Result<[Trace; 3], E>,
    ) -> std::result::Result<Self, E> {
        let mut failed = None;
        let recording = Recording::as_written(1, |time| match wind(time[0]) {
            Ok(velocity) if velocity.iter().all(|number| number.is_live()) => velocity.to_vec(),
            Ok(_) => {
                let remedy = "Compute it of the time that the function is given.";
                failed = Some(Error::value("a number of a wind", "of another recording", "of this one", remedy).into());
                Vec::new()
            }
            Err(error) => {
                failed = Some(error);
                Vec::new()
            }
        });
        failed.map_or(Ok(Self(Arc::new(recording))), Err)
    }

    fn velocity(&self, time: f64) -> [f64; 3] {
        let mut velocity = [0.0; 3];
        self.0.evaluate(&[time], &mut velocity);
        velocity
    }
}

impl PartialEq for WrittenWind {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl fmt::Debug for WrittenWind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "WrittenWind({} operations)", self.0.n_operation())
    }
}

/// v(t) = mean + amplitude ∘ Σ_j sin(ω_j t), axis by axis.
///
/// The shape of the wind in OmniDrones' Track task, which applies it as a force per mass; here it is a velocity of the
/// air, so the drag decides the force. A vehicle model without drag feels no wind.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sinusoid {
    /// World, m/s.
    pub mean: [f64; 3],
    /// Of every harmonic, per world axis, m/s.
    pub amplitude: [f64; 3],
    /// ω_j of the world axes x, y, z, rad/s; negative ones run backwards.
    pub frequencies: Vec<[f64; 3]>,
}

impl Sinusoid {
    /// Track's draw: 8 harmonics, frequencies N(0, 1) rad/s, one amplitude U(0, `largest_amplitude`) (m/s) for all axes, no mean.
    pub fn random(largest_amplitude: f64, stream: &mut Stream) -> Self {
        let amplitude = [stream.uniform(0.0, largest_amplitude); 3];
        let mut frequencies = vec![[0.0; 3]; 8];
        for frequency in frequencies.iter_mut().flatten() {
            *frequency = stream.normal();
        }
        Self { mean: [0.0; 3], amplitude, frequencies }
    }

    fn velocity(&self, time: f64) -> [f64; 3] {
        let mut velocity = self.mean;
        for harmonic in &self.frequencies {
            for (axis, v) in velocity.iter_mut().enumerate() {
                *v += self.amplitude[axis] * (harmonic[axis] * time).sin();
            }
        }
        velocity
    }
}

/// Dryden turbulence, low-altitude form of MIL-F-8785C (1980), around a mean wind.
///
/// With h in feet and W₂₀ the wind at 20 ft: σ_w = 0.1 W₂₀, σ_u = σ_v = σ_w/(0.177 + 0.000823 h)^0.4, L_w = h,
/// L_u = L_v = h/(0.177 + 0.000823 h)^1.2. Gust u is along the horizontal mean wind (world x without one), w up, v
/// completes the frame. The gust field is frozen and crossed at `airspeed` V, so with T = L/V unit white noise passes
/// H_u = σ_u √(2T)/(1 + Ts) and H_v,w = σ √T (1 + √3 Ts)/(1 + Ts)².
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dryden {
    /// Mean wind, world, m/s.
    pub mean: [f64; 3],
    /// W₂₀, wind speed at 20 ft = 6.1 m, m/s: 7.7 light, 15 moderate, 23 severe turbulence in the standard.
    pub wind_at_20_feet: f64,
    /// Above ground, m; held within 3.048 to 304.8.
    pub height: f64,
    /// V at which gusts pass the vehicle, m/s, > 0: its typical speed through the air. A hovering vehicle is crossed by
    /// the mean wind.
    pub airspeed: f64,
}

impl Dryden {
    /// (σ_u, σ_v, σ_w), m/s.
    pub fn intensity(&self) -> [f64; 3] {
        let vertical = 0.1 * self.wind_at_20_feet;
        let horizontal = vertical / self.height_term().powf(0.4);
        [horizontal, horizontal, vertical]
    }

    /// (L_u, L_v, L_w), m.
    pub fn length(&self) -> [f64; 3] {
        let horizontal = self.held_height() / self.height_term().powf(1.2);
        [horizontal, horizontal, self.held_height()]
    }

    fn held_height(&self) -> f64 {
        self.height.clamp(HEIGHT_RANGE.0, HEIGHT_RANGE.1)
    }

    fn height_term(&self) -> f64 {
        0.177 + 0.000823 * self.held_height() / FOOT
    }
}

impl Wind {
    /// Checks that every number is finite and physical.
    ///
    /// # Errors
    /// [`Error::Value`] for a number that is not finite, `wind_at_20_feet` < 0 or `airspeed` < 0.01 m/s; [`Error::Limit`] for more
    /// than 1024 harmonics.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Calm => Ok(()),
            Self::Constant { velocity } => finite("wind: velocity", velocity),
            Self::Sinusoid(s) => {
                finite("wind: mean", &s.mean)?;
                finite("wind: amplitude", &s.amplitude)?;
                if s.frequencies.len() > MAX_HARMONICS {
                    let remedy = "Eight are enough for a wind that does not repeat.";
                    return Err(Error::limit("wind: number of harmonics", s.frequencies.len(), MAX_HARMONICS, remedy));
                }
                s.frequencies.iter().try_for_each(|f| finite("wind: frequencies", f))
            }
            Self::Dryden(d) => {
                finite("wind: mean", &d.mean)?;
                finite("wind: wind_at_20_feet", &[d.wind_at_20_feet])?;
                finite("wind: height", &[d.height])?;
                finite("wind: airspeed", &[d.airspeed])?;
                if d.wind_at_20_feet < 0.0 {
                    let remedy = "It is a speed; the direction is that of the mean wind.";
                    return Err(Error::value("wind: wind_at_20_feet", d.wind_at_20_feet, "≥ 0 m/s", remedy));
                }
                if d.airspeed < 0.01 {
                    let remedy = "Gusts that never pass have no spectrum in time: give a typical speed, 1 m/s or more.";
                    return Err(Error::value("wind: airspeed", d.airspeed, "≥ 0.01 m/s", remedy));
                }
                Ok(())
            }
            Self::Own(own) => {
                [0.0, 0.37, 1.0, 10.0].iter().try_for_each(|t| finite(&format!("wind at {t} s"), &own.velocity(*t)))
            }
        }
    }
}

/// A wind that blows: configuration, time, filter memory and random stream.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WindState {
    wind: Wind,
    time: f64,
    /// Filter states of u, v, w in units of their standard deviation; u uses the first of its pair.
    filters: [[f64; 2]; 3],
    stream: Stream,
}

impl WindState {
    /// The wind at time 0. Gusts start in their stationary distribution: there is no calm before the first gust.
    ///
    /// # Errors
    /// As [`Wind::validate`].
    pub fn new(wind: Wind, mut stream: Stream) -> Result<Self> {
        wind.validate()?;
        let mut filters = [[0.0; 2]; 3];
        if matches!(wind, Wind::Dryden(_)) {
            filters[0][0] = stream.normal();
            for filter in &mut filters[1..] {
                *filter = correlated(STATIONARY, [stream.normal(), stream.normal()]);
            }
        }
        Ok(Self { wind, time: 0.0, filters, stream })
    }

    /// Advances by `dt` ≥ 0 seconds and returns the velocity of the air then, world, m/s.
    ///
    /// The filters are stepped exactly for noise of any `dt`: variance and autocorrelation of the samples are those of
    /// the continuous process, whatever the step.
    pub fn sample(&mut self, dt: f64) -> [f64; 3] {
        self.time += dt;
        if let Wind::Dryden(dryden) = &self.wind {
            let rate = dryden.length().map(|length| dt * dryden.airspeed / length);
            self.filters[0][0] = step_first(self.filters[0][0], rate[0], self.stream.normal());
            for (filter, rate) in self.filters.iter_mut().zip(rate).skip(1) {
                let noise = [self.stream.normal(), self.stream.normal()];
                *filter = step_second(*filter, rate, noise);
            }
        }
        self.velocity()
    }

    /// The velocity of the air now, world, m/s; does not advance.
    pub fn velocity(&self) -> [f64; 3] {
        match &self.wind {
            Wind::Calm => [0.0; 3],
            Wind::Constant { velocity } => *velocity,
            Wind::Sinusoid(sinusoid) => sinusoid.velocity(self.time),
            Wind::Own(own) => own.velocity(self.time),
            Wind::Dryden(dryden) => {
                let s = dryden.intensity();
                let [u, v, w] =
                    [s[0] * self.filters[0][0], s[1] * output(self.filters[1]), s[2] * output(self.filters[2])];
                let [x, y, _] = dryden.mean;
                let speed = x.hypot(y);
                let (c, s) = if speed > 0.0 { (x / speed, y / speed) } else { (1.0, 0.0) };
                [dryden.mean[0] + c * u - s * v, dryden.mean[1] + s * u + c * v, dryden.mean[2] + w]
            }
        }
    }

    /// Seconds since the start.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// What was configured.
    pub fn wind(&self) -> &Wind {
        &self.wind
    }
}

// The filters in time θ = t/T, unit white noise w, output of unit variance.
//
// u: x' = −x + √2 w, so over a step h: x⁺ = e^{−h} x + √(1 − e^{−2h}) n.
//
// v, w: (1 + √3 s)/(1 + s)² = √3/(1 + s) + (1 − √3)/(1 + s)², so with x₁' = −x₁ + w, x₂' = −x₂ + x₁ the output is
// √3 x₁ + (1 − √3) x₂. Stationary covariance P = [½ ¼; ¼ ¼] (from AP + PAᵀ + BBᵀ = 0), output variance
// 3/2 + √3(1 − √3)/2 + (1 − √3)²/4 = 1. Over a step h: x⁺ = e^{−h} [1 0; h 1] x + noise of covariance
// Q = ∫₀ʰ e^{−2s} [1 s; s s²] ds.

/// P as (p₁₁, p₁₂, p₂₂).
const STATIONARY: [f64; 3] = [0.5, 0.25, 0.25];

/// √3 x₁ + (1 − √3) x₂.
fn output(x: [f64; 2]) -> f64 {
    let root = 3.0_f64.sqrt();
    root * x[0] + (1.0 - root) * x[1]
}

fn step_first(x: f64, h: f64, noise: f64) -> f64 {
    (-h).exp() * x + (-(-2.0 * h).exp_m1()).sqrt() * noise
}

fn step_second(x: [f64; 2], h: f64, noise: [f64; 2]) -> [f64; 2] {
    let decay = (-h).exp();
    let kick = correlated(step_covariance(h), noise);
    [decay * x[0] + kick[0], decay * (x[1] + h * x[0]) + kick[1]]
}

/// (q₁₁, q₁₂, q₂₂) of a step h ≥ 0.
fn step_covariance(h: f64) -> [f64; 3] {
    if h > 0.5 {
        let e = (-2.0 * h).exp();
        return [0.5 * (1.0 - e), 0.25 - e * (0.25 + 0.5 * h), 0.25 - e * (0.25 + 0.5 * h * (1.0 + h))];
    }
    // the closed form cancels to nothing for small h (q₂₂ ≈ h³/3): ∫₀ʰ sⁿ e^{−2s} ds = Σ_k (−2)ᵏ h^{n+k+1}/(k!(n+k+1));
    // with 2h ≤ 1 the twentieth term is below 1e-19 of the first
    let mut q = [0.0; 3];
    let mut term = 1.0;
    for k in 0..20 {
        for (n, q) in q.iter_mut().enumerate() {
            *q += term / (n + k + 1) as f64;
        }
        term *= -2.0 * h / (k + 1) as f64;
    }
    [q[0] * h, q[1] * h * h, q[2] * h * h * h]
}

/// Two independent normals to the covariance (q₁₁, q₁₂, q₂₂), by its Cholesky factor; zero covariance gives zero.
fn correlated(q: [f64; 3], noise: [f64; 2]) -> [f64; 2] {
    let l11 = q[0].max(0.0).sqrt();
    let l21 = if l11 > 0.0 { q[1] / l11 } else { 0.0 };
    let l22 = (q[2] - l21 * l21).max(0.0).sqrt();
    [l11 * noise[0], l21 * noise[0] + l22 * noise[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::Scalar;
    use rng::Purpose;

    fn stream(environment: u64) -> Stream {
        Stream::new(11, environment, 0, Purpose::WIND)
    }

    /// Low and fast, so that the longest correlation time (L_u/V = 1.4 s) fits often into a run.
    const GUSTS: Dryden = Dryden { mean: [3.0, 4.0, 0.0], wind_at_20_feet: 10.0, height: 3.048, airspeed: 20.0 };

    #[test]
    fn a_wind_of_ones_own_blows_as_it_was_written() {
        let own = |t: Trace| Ok::<_, Error>([2.0 + t.sin_cos().0, 0.5 * t, Trace::zero()]);
        let mut state = WindState::new(Wind::Own(WrittenWind::new(own).unwrap()), stream(0)).unwrap();
        for k in 1..50 {
            let time = state.time() + 0.1;
            assert_eq!(state.sample(0.1), [2.0 + time.sin(), 0.5 * time, 0.0], "step {k}");
        }
        let failed = WrittenWind::new(|_| Err::<[Trace; 3], _>(Error::value("it", 1, "2", "")));
        assert!(failed.unwrap_err().to_string().starts_with("it is 1"));
        let wild = Wind::Own(WrittenWind::new(|t: Trace| Ok::<_, Error>([t.recip(), t, t])).unwrap());
        assert!(wild.validate().unwrap_err().to_string().contains("wind at 0 s"));
    }

    /// Gusts in their own frame, in units of σ, every `dt`.
    fn gusts(dryden: Dryden, dt: f64, n: usize) -> Vec<[f64; 3]> {
        let mut state = WindState::new(Wind::Dryden(dryden), stream(0)).unwrap();
        let (s, [x, y, z]) = (dryden.intensity(), dryden.mean);
        let (c, d) = (x / x.hypot(y), y / x.hypot(y));
        (0..n)
            .map(|_| {
                let v = state.sample(dt);
                let e = [v[0] - x, v[1] - y, v[2] - z];
                [(c * e[0] + d * e[1]) / s[0], (c * e[1] - d * e[0]) / s[1], e[2] / s[2]]
            })
            .collect()
    }

    #[test]
    fn intensities_and_lengths_are_those_of_the_standard() {
        // h = 100 ft: 0.177 + 0.0823 = 0.2593; σ_u = 1/0.2593^0.4, L_u = 100 ft/0.2593^1.2
        let d = Dryden { height: 30.48, ..GUSTS };
        let (s, l) = (d.intensity(), d.length());
        assert!((s[2] - 1.0).abs() < 1e-12 && (s[0] - 1.715849).abs() < 1e-5 && s[0] == s[1], "{s:?}");
        assert!((l[2] - 30.48).abs() < 1e-12 && (l[0] - 153.9756).abs() < 1e-2 && l[0] == l[1], "{l:?}");
        // at 1000 ft turbulence is isotropic: the height term is 1
        let high = Dryden { height: 5000.0, ..GUSTS };
        assert!((high.intensity()[0] - 1.0).abs() < 1e-12 && (high.length()[0] - 304.8).abs() < 1e-9);
    }

    #[test]
    fn variance_of_the_samples_is_sigma_squared_for_fine_and_coarse_steps() {
        for (dt, n) in [(0.002, 4_000_000), (0.02, 400_000)] {
            let gusts = gusts(GUSTS, dt, n);
            for axis in 0..3 {
                let variance = gusts.iter().map(|g| g[axis] * g[axis]).sum::<f64>() / n as f64;
                // 1.001, 0.992, 1.002 for 2 ms; 1.003, 0.977, 1.005 for 20 ms
                assert!((variance - 1.0).abs() < 0.05, "dt {dt}, axis {axis}: {variance} σ²");
            }
        }
    }

    #[test]
    fn autocorrelation_of_the_samples_is_that_of_the_dryden_spectra() {
        let (dt, n) = (0.02, 400_000);
        let gusts = gusts(GUSTS, dt, n);
        for (axis, length) in GUSTS.length().into_iter().enumerate() {
            let time = length / GUSTS.airspeed;
            for fraction in [0.25, 0.5, 1.0, 2.0, 3.0] {
                let lag = (fraction * time / dt).round() as usize;
                let x = lag as f64 * dt / time;
                let mean = (0..n - lag).map(|i| gusts[i][axis] * gusts[i + lag][axis]).sum::<f64>() / (n - lag) as f64;
                // Fourier transforms of the spectra: e^{−x} along, (1 − x/2) e^{−x} across; largest difference 0.023
                let want = if axis == 0 { (-x).exp() } else { (1.0 - 0.5 * x) * (-x).exp() };
                assert!((mean - want).abs() < 0.05, "axis {axis}, lag {x} T: {mean} against {want}");
            }
        }
    }

    #[test]
    fn one_long_step_has_exactly_the_law_of_many_short_ones() {
        for h in [1e-8_f64, 1e-4, 0.01, 0.3, 0.49, 0.51, 2.0, 40.0] {
            // Φ P Φᵀ + Q = P: the stationary covariance is kept
            let (e, q) = ((-2.0 * h).exp(), step_covariance(h));
            let [p11, p12, p22] = STATIONARY;
            let kept = [e * p11 + q[0], e * (p12 + h * p11) + q[1], e * (p22 + 2.0 * h * p12 + h * h * p11) + q[2]];
            for k in 0..3 {
                // largest difference 6e-17
                assert!((kept[k] - STATIONARY[k]).abs() < 1e-15, "h {h}: {kept:?}");
            }
            // two halves make a whole: Q(h) = Φ(h/2) Q(h/2) Φ(h/2)ᵀ + Q(h/2), relative to each entry
            let (f, r, g) = ((-h).exp(), step_covariance(0.5 * h), 0.5 * h);
            let two =
                [f * r[0] + r[0], f * (r[1] + g * r[0]) + r[1], f * (r[2] + 2.0 * g * r[1] + g * g * r[0]) + r[2]];
            for k in 0..3 {
                // largest relative difference 4.4e-16
                assert!((two[k] - q[k]).abs() < 1e-13 * q[k], "h {h}: {two:?} against {q:?}");
            }
            // and the Cholesky factor exists: q₁₁ q₂₂ − q₁₂² ≈ h⁴/12 for small h
            assert!(q[0] * q[2] - q[1] * q[1] > 0.0, "h {h}: {q:?}");
        }
    }

    #[test]
    fn the_first_sample_is_as_gusty_as_the_later_ones() {
        let n = 4000;
        let mut square = [0.0; 3];
        for environment in 0..n {
            let calm = Dryden { mean: [0.0; 3], ..GUSTS };
            let v = WindState::new(Wind::Dryden(calm), stream(environment)).unwrap().velocity();
            for axis in 0..3 {
                square[axis] += (v[axis] / calm.intensity()[axis]).powi(2) / n as f64;
            }
        }
        // four standard deviations of a variance from 4000 draws: 4 √(2/4000) = 0.09
        assert!(square.iter().all(|s| (s - 1.0).abs() < 0.09), "{square:?}");
    }

    #[test]
    fn a_saved_wind_blows_on_with_the_same_bits() {
        let mut state = WindState::new(Wind::Dryden(GUSTS), stream(3)).unwrap();
        for _ in 0..10 {
            state.sample(0.01);
        }
        let mut back: WindState = serde_json::from_str(&serde_json::to_string(&state).unwrap()).unwrap();
        for _ in 0..100 {
            assert_eq!(back.sample(0.004).map(f64::to_bits), state.sample(0.004).map(f64::to_bits));
        }
    }

    #[test]
    fn simple_winds_are_their_formulas() {
        assert_eq!(WindState::new(Wind::Calm, stream(0)).unwrap().sample(0.1), [0.0; 3]);
        let constant = Wind::Constant { velocity: [1.0, -2.0, 0.5] };
        assert_eq!(WindState::new(constant, stream(0)).unwrap().sample(0.1), [1.0, -2.0, 0.5]);
        let two = Sinusoid {
            mean: [1.0, 0.0, 0.0],
            amplitude: [2.0, 1.0, 0.0],
            frequencies: vec![[1.0, 2.0, 3.0], [0.5, -1.0, 3.0]],
        };
        let mut state = WindState::new(Wind::Sinusoid(two), stream(0)).unwrap();
        assert_eq!(state.velocity(), [1.0, 0.0, 0.0]);
        let v = state.sample(0.7);
        let want = [1.0 + 2.0 * (0.7_f64.sin() + 0.35_f64.sin()), 1.4_f64.sin() - 0.7_f64.sin(), 0.0];
        for k in 0..3 {
            assert!((v[k] - want[k]).abs() < 1e-15, "{v:?} against {want:?}");
        }
        assert_eq!(state.time(), 0.7);
    }

    #[test]
    fn a_drawn_sinusoid_has_eight_harmonics_and_one_amplitude() {
        let s = Sinusoid::random(2.0, &mut stream(1));
        assert_eq!(s.frequencies.len(), 8);
        assert!(s.amplitude[0] > 0.0 && s.amplitude[0] < 2.0 && s.amplitude == [s.amplitude[0]; 3]);
        assert_eq!(s, Sinusoid::random(2.0, &mut stream(1)));
        assert_ne!(s, Sinusoid::random(2.0, &mut stream(2)));
    }

    #[test]
    fn every_wind_comes_back_from_toml_and_wrong_ones_are_refused() {
        let winds = [
            Wind::Calm,
            Wind::Constant { velocity: [1.0, 0.1, 0.0] },
            Wind::Sinusoid(Sinusoid::random(1.0, &mut stream(0))),
            Wind::Dryden(GUSTS),
        ];
        for wind in winds {
            let text = toml::to_string(&wind).unwrap();
            assert_eq!(toml::from_str::<Wind>(&text).unwrap(), wind, "{text}");
        }
        for bad in [
            Wind::Constant { velocity: [f64::NAN, 0.0, 0.0] },
            Wind::Dryden(Dryden { airspeed: 0.0, ..GUSTS }),
            Wind::Dryden(Dryden { wind_at_20_feet: -1.0, ..GUSTS }),
            Wind::Sinusoid(Sinusoid { frequencies: vec![[0.0; 3]; 2000], ..Sinusoid::default() }),
        ] {
            assert!(WindState::new(bad, stream(0)).is_err());
        }
        assert!(toml::from_str::<Wind>("kind = 'constant'\nvelocity = [0, 0, 0]\nspeed = 1").is_err());
    }
}
