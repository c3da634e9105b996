//! Calls in any order, with any numbers: a batch on a device tells what a batch on the host tells.

use super::{alike, difference, emulated};
use crate::{Device, DeviceAdjoint, DeviceEnv, DeviceRows, DeviceTape};
use base::error::Result;
use tasks::env::{Adjoint, Cotangents, SweepOptions, Tape};
use tasks::{ActionSpace, Buffers, Env, EnvConfig};

/// Steps of a tape.
const HORIZON: usize = 5;

/// What is asked for in one order on both.
struct Beside {
    own: DeviceEnv,
    host: Env,
    told: Buffers,
    actions: Vec<f32>,
    tapes: Option<(DeviceTape, Tape, DeviceAdjoint, Adjoint)>,
    saved: Option<Vec<u8>>,
    state: u64,
}

impl Beside {
    fn new(task: &str, config: &EnvConfig, device: &Device, salt: u64) -> Result<Self> {
        let (mut own, mut host) = (DeviceEnv::make(task, config, device)?, Env::make(task, config)?);
        let mut told = Buffers::new(host.spec());
        host.reset(None, None, &mut told.out())?;
        own.reset(None, None)?;
        let is_smooth = config.actions == ActionSpace::Continuous;
        let tapes = if is_smooth {
            Some((own.tape(HORIZON)?, host.tape(HORIZON)?, own.adjoint(true)?, host.adjoint(true)?))
        } else {
            None
        };
        let actions = vec![0.0; config.n_env * host.spec().n_agent * host.spec().action.len()];
        let state = salt.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        Ok(Self { own, host, told, actions, tapes, saved: None, state })
    }

    /// Xorshift (Marsaglia 2003).
    fn next(&mut self) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        self.state
    }

    fn call(&mut self) -> Result<()> {
        let n = self.host.spec().n_env;
        match self.next() % 24 {
            0 | 1 => {
                let which: Vec<bool> = (0..n).map(|_| self.next().is_multiple_of(3)).collect();
                let seeds: Vec<u64> = (0..n).map(|_| self.next()).collect();
                let seeds = (self.next().is_multiple_of(2)).then_some(&seeds[..]);
                self.host.reset(Some(&which), seeds, &mut self.told.out())?;
                self.own.reset(Some(&which), seeds)?;
            }
            2 => {
                let share = (self.next() % 5) as f64 / 4.0;
                self.host.set_difficulty(share)?;
                self.own.set_difficulty(share)?;
            }
            3 => {
                self.host.observe(&mut self.told.out())?;
                self.own.observe()?;
            }
            4 => {
                self.host.update_normaliser();
                self.own.update_normaliser()?;
            }
            5 => {
                let collects = self.next().is_multiple_of(2);
                self.host.set_collecting(collects);
                self.own.set_collecting(collects);
            }
            6 => self.saved = Some(self.host.save()),
            7 => {
                if let Some(bytes) = &self.saved {
                    self.host.load(bytes)?;
                    self.own.load(bytes)?;
                    self.host.observe(&mut self.told.out())?;
                }
            }
            8 => {
                let (i, k) = (self.next() as usize % n, self.next() as usize);
                let mut state = self.host.state(i)?;
                let k = k % 3;
                state[k] += 0.25;
                self.host.set_state(i, &state)?;
                self.own.set_state(i, &state)?;
            }
            9 => {
                let which: Vec<u8> = (0..n).map(|_| u8::from(self.next().is_multiple_of(3))).collect();
                let marked: Vec<bool> = which.iter().map(|own| *own == 1).collect();
                let flags =
                    DeviceRows::flags_of_other(self.own.device().kind(), which.as_ptr() as u64, vec![n], vec![1]);
                let seeds: Vec<u64> = (0..n).map(|_| self.next()).collect();
                let seeds = (self.next().is_multiple_of(2)).then_some(&seeds[..]);
                self.host.reset(Some(&marked), seeds, &mut self.told.out())?;
                self.own.reset_on(&flags, seeds)?;
            }
            10 => {
                self.own.step(&self.actions)?;
                self.own.step_again()?;
                for _ in 0..2 {
                    self.host.step(&self.actions, &mut self.told.out())?;
                }
            }
            11 => {
                let k = (self.next() % 3) as usize;
                self.own.step(&self.actions)?;
                self.host.step(&self.actions, &mut self.told.out())?;
                match self.own.graph(k) {
                    Ok(graph) => {
                        for _ in 0..2 {
                            self.own.replay(&graph)?;
                        }
                        for _ in 0..2 * k {
                            self.host.step(&self.actions, &mut self.told.out())?;
                        }
                    }
                    Err(why) => assert!(why.to_string().contains("task of a graph"), "{why}"),
                }
            }
            _ => self.step()?,
        }
        Ok(())
    }

    fn step(&mut self) -> Result<()> {
        let draw = self.next();
        self.host.sample(draw, &mut self.actions);
        for k in 0..self.actions.len() {
            match self.next() % 60 {
                0 => self.actions[k] = f32::NAN,
                1 => self.actions[k] = f32::INFINITY,
                2 => self.actions[k] = f32::NEG_INFINITY,
                3 => self.actions[k] = 3.4e38,
                4 => self.actions[k] = -1e30,
                5 => self.actions[k] = 1e-42,
                6 => self.actions[k] = -0.0,
                7 => self.actions[k] += 0.5,
                _ => {}
            }
        }
        let is_recorded = !self.next().is_multiple_of(3);
        match &mut self.tapes {
            Some((own, host, ..)) if is_recorded && own.len() < HORIZON => {
                self.host.step_recorded(&self.actions, &mut self.told.out(), host)?;
                self.own.step_recorded(&self.actions, own)
            }
            _ => {
                self.host.step(&self.actions, &mut self.told.out())?;
                self.own.step(&self.actions)
            }
        }
    }

    /// What differs between the two, also in the gradients of a full tape.
    fn difference(&mut self) -> Result<Option<String>> {
        let n = self.host.spec().n_env;
        let told = difference(&self.own.buffers()?, &self.told, &vec![true; n]);
        if told.is_some() {
            return Ok(told);
        }
        let Some((tape, host_tape, adjoint, on_host)) = self.tapes.as_mut().filter(|own| own.0.len() == HORIZON) else {
            return Ok(None);
        };
        let options = SweepOptions { decay: 0.97, clip: 20.0 };
        let (mut sweep, mut host_sweep) = (adjoint.sweep(options)?, on_host.sweep(options));
        let p = adjoint.layout().clone();
        let seeds = |each: usize, salt: usize| -> Vec<f32> {
            (0..n * each).map(|k| ((k * 7 + salt) % 13) as f32 / 13.0 - 0.4).collect()
        };
        let (seen, central, carried) = (p.observation.len(), p.central.len(), p.n_carried());
        let [observation, final_observation] = [1, 2].map(|salt| seeds(seen, salt));
        let [central, final_central] = [3, 7].map(|salt| seeds(central, salt));
        let (final_carried, reward, loss) = (seeds(carried, 4), seeds(1, 5), seeds(1, 6));
        let up = Cotangents {
            observation: &observation,
            final_observation: &final_observation,
            central: &central,
            final_central: &final_central,
            final_carried: &final_carried,
            reward: &reward,
            loss: &loss,
        };
        let (mut a, mut b) = (vec![0.0; n * p.action.len()], vec![0.0; n * p.action.len()]);
        for t in (0..HORIZON).rev() {
            if t == 2 {
                sweep.add_carried(&final_carried)?;
                host_sweep.add_carried(&final_carried)?;
            }
            sweep.pull(tape, t, &up, &mut a)?;
            host_sweep.pull(host_tape, t, &up, &mut b)?;
            if let Some(k) = alike(&a, &b) {
                return Ok(Some(format!("gradient of step {t} [{k}]: {} and {}", a[k], b[k])));
            }
            if let Some(k) = alike(&sweep.carried()?, &host_sweep.carried()) {
                return Ok(Some(format!("carried into step {t} [{k}]")));
            }
        }
        let parameters = alike(&sweep.parameters()?, &host_sweep.parameters());
        let is_dropped_alike = sweep.dropped()? == host_sweep.dropped();
        tape.clear();
        host_tape.clear();
        Ok(parameters
            .map(|k| format!("parameters [{k}]"))
            .or_else(|| (!is_dropped_alike).then(|| "how many were dropped".into())))
    }
}

const CASES: [(&str, &str); 12] = [
    ("Hover", "n_env = 1"),
    ("Hover", "n_env = 64\nautoreset = 'next_step'\ntruncate_after = 4"),
    ("Hover", "n_env = 65\nautoreset = 'disabled'\ntruncate_after = 8"),
    (
        "TrackRand",
        "n_env = 65\nstagger = true\ntruncate_after = 6\ndelay = { min = 0, max = 3 }\nobservation = [{ kind = 'normalise', \
         clip = 3.0 }, { kind = 'noise', std = 0.05 }, { kind = 'history', steps = 3 }]",
    ),
    (
        "GateSwitch",
        "n_env = 65\neasier = 0.5\nautoreset = 'next_step'\ntruncate_after = 30\nobservation = [{ kind = 'history', steps = 2 }, \
         { kind = 'normalise', clip = 3.0 }]",
    ),
    (
        "Spread",
        "n_env = 64\nautoreset = 'disabled'\ntruncate_after = 20\nobservation = [{ kind = 'noise', std = 0.05 }]",
    ),
    (
        "Hover",
        "n_env = 65\ncontrol = 'rate'\nactions = { kind = 'discrete', levels = 3 }\ndelay = { min = 1, max = 3 }\ntruncate_after = 9",
    ),
    (
        "HoverRand",
        "n_env = 3\nactions = { kind = 'multi_discrete', levels = 5 }\nobservation = [{ kind = 'privileged' }]",
    ),
    ("Pinball", "n_env = 65\ntruncate_after = 12\nbounds = { rate = 5.0 }"),
    ("Formation", "n_env = 65\ntruncate_after = 6\nobservation = [{ kind = 'normalise', clip = 3.0 }]"),
    ("Formation", "n_env = 65\nautoreset = 'disabled'\ntruncate_after = 6"),
    ("InvPendulumTrack", "n_env = 33\nbounds = { rate = 8.0 }\neasier = 0.3\ntruncate_after = 1"),
];

/// `CALLS` is how many calls there are of each, 60 by default.
#[test]
fn calls_in_any_order_tell_what_the_host_tells() -> Result<()> {
    let Some(device) = emulated() else { return Ok(()) };
    let n_call = std::env::var("CALLS").ok().and_then(|own| own.parse().ok()).unwrap_or(60);
    for (task, text) in CASES {
        let config = EnvConfig::from_toml(&format!("{text}\nseed = 11"), "text")?;
        for salt in 1..=(n_call / 150).max(1) {
            let mut both = Beside::new(task, &config, &device, salt)?;
            for call in 0..n_call {
                both.call()?;
                assert_eq!(both.difference()?, None, "{task}, {text}, salt {salt}: call {call}");
            }
        }
    }
    Ok(())
}
