//! Between continuous and sampled systems.

use super::state_space::{StateSpace, blocks};
use base::error::{Error, Result};
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// How inputs pass from one sample to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Constant over a sample: exact for what a computer commands.
    Zero,
    /// Tustin's s = 2/dt · (z − 1)/(z + 1): the frequency response is kept, ω bent to 2/dt · tan(ω dt/2).
    Tustin,
}

impl StateSpace {
    /// A continuous system seen every `dt` seconds.
    ///
    /// # Errors
    /// [`Error::Value`] for a system that is sampled already, a `dt` that is not positive, or with [`Hold::Tustin`] a pole
    /// at 2/dt.
    pub fn sampled(&self, dt: f64, hold: Hold) -> Result<Self> {
        if self.dt().is_some() {
            let remedy = "Make it continuous first.";
            return Err(Error::value("the system", "sampled", "continuous", remedy));
        }
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(Error::value("dt", dt, "> 0 s", "Give the time between two samples."));
        }
        let (n, m) = (self.n_state(), self.n_input());
        match hold {
            Hold::Zero => {
                let (below, corner) = (DMatrix::zeros(m, n), DMatrix::zeros(m, m));
                let whole = (blocks(self.a(), self.b(), &below, &corner) * dt).exp();
                let (a, b) = (whole.view((0, 0), (n, n)).into_owned(), whole.view((0, n), (n, m)).into_owned());
                self.with(a, b, self.c().clone(), self.d().clone(), Some(dt))
            }
            Hold::Tustin => {
                let half = self.a() * (dt / 2.0);
                let eye = DMatrix::identity(n, n);
                let back = inverse(&eye - &half, "a pole at 2/dt")?;
                let (b, c) = (&back * self.b() * dt, self.c() * &back);
                let d = self.d() + &c * self.b() * (dt / 2.0);
                self.with(back * (eye + half), b, c, d, Some(dt))
            }
        }
    }

    /// The continuous system whose [Tustin](Hold::Tustin) equivalent this is: stable where this is stable, the same largest
    /// gain, the same margins, at frequencies bent to 2/dt · tan(ω dt/2). Without a sample time the system itself.
    ///
    /// # Errors
    /// [`Error::Value`] for a pole at −1.
    pub fn continuous(&self) -> Result<Self> {
        let Some(dt) = self.dt() else { return Ok(self.clone()) };
        let n = self.n_state();
        let eye = DMatrix::identity(n, n);
        let back = inverse(self.a() + &eye, "a pole at −1")?;
        let a = (self.a() - eye) * &back * (2.0 / dt);
        let (b, c) = (&back * self.b() * (2.0 / dt), self.c() * &back * 2.0);
        let d = self.d() - self.c() * &back * self.b();
        self.with(a, b, c, d, None)
    }

    /// The frequency of this system that [`continuous`](Self::continuous) shows at `omega`, rad/s.
    pub fn unbent(&self, omega: f64) -> f64 {
        self.dt().map_or(omega, |dt| 2.0 / dt * (omega * dt / 2.0).atan())
    }

    /// The highest frequency that samples can tell, π/dt; infinite without samples.
    pub fn nyquist(&self) -> f64 {
        self.dt().map_or(f64::INFINITY, |dt| PI / dt)
    }
}

fn inverse(matrix: DMatrix<f64>, what: &str) -> Result<DMatrix<f64>> {
    let remedy = "Choose another sample time, or take the mode out.";
    let inverse = matrix.try_inverse().filter(|m| m.iter().all(|v| v.is_finite()));
    inverse.ok_or_else(|| Error::value("Tustin's substitution", format!("undone by {what}"), "invertible", remedy))
}
