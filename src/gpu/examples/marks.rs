//! What a card does, task by task: bits beside the CPU's, and steps and gradients per second.
//!
//! ```sh
//! marks compile sm_90            # kernels of all tasks into $OMNIDRONES_KERNELS, where there is NVRTC and no card
//! marks run cuda [SECONDS [TASK…]]    # the marks; `emulated` runs the same on the host
//! ```

use base::error::{Error, Result};
use omnidrones_gpu::{Device, DeviceEnv};
use std::time::Instant;
use tasks::env::{Cotangents, SweepOptions};
use tasks::{Buffers, Env, EnvConfig};

/// Steps, and how many lie between two comparisons.
const STEPS: u64 = 1000;
const EACH: u64 = 50;
/// Of each comparison.
const BESIDE: usize = 512;

fn main() {
    if let Err(error) = told() {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

fn told() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        #[cfg(feature = "cuda")]
        ["compile", target] => compile(target),
        ["run", device] => run(&Device::new(device.parse()?)?, 0.5, &[]),
        ["run", device, seconds, ref tasks @ ..] => {
            run(&Device::new(device.parse()?)?, seconds.parse().unwrap_or(0.5), tasks)
        }
        _ => {
            println!("marks compile sm_90 | marks run cuda [SECONDS [TASK…]]");
            std::process::exit(2);
        }
    }
}

/// The tasks that a device runs.
fn tasks_of_device() -> impl Iterator<Item = &'static str> {
    let runs = |task: &&str| Env::make(task, &EnvConfig::default()).is_ok_and(|env| env.kernels().is_ok());
    tasks::registry::names().into_iter().filter(runs)
}

#[cfg(feature = "cuda")]
fn compile(target: &str) -> Result<()> {
    let mut all = 0;
    for task in tasks_of_device() {
        let begin = Instant::now();
        let bytes = DeviceEnv::compile_for(&Env::make(task, &EnvConfig::default())?, target)?;
        all += bytes;
        println!("{task:<24} {:>9} bytes {:>6.1} s", bytes, begin.elapsed().as_secs_f64());
    }
    println!("{all} bytes for {target}");
    Ok(())
}

fn run(device: &Device, seconds: f64, chosen: &[&str]) -> Result<()> {
    println!("{}: {}", device.kind(), device.name());
    println!("{:<24} {:>10} {:>14} {:>14} {:>14}", "task", "bits off", "steps/s", "at batch", "gradients/s");
    for task in tasks_of_device().filter(|task| chosen.is_empty() || chosen.contains(task)) {
        let off = bits_off(task, device)?;
        let (rate, batch) = fastest(task, device, seconds)?;
        let gradients = gradients(task, device, seconds)?;
        println!("{task:<24} {off:>10} {rate:>14.3e} {batch:>14} {gradients:>14.3e}");
    }
    Ok(())
}

/// Numbers that differ from the CPU's in [`STEPS`] steps, restarts included; what they are shows in all that comes later.
fn bits_off(task: &str, device: &Device) -> Result<usize> {
    let config = EnvConfig { n_env: BESIDE, ..EnvConfig::default() };
    let (mut own, mut host) = (DeviceEnv::make(task, &config, device)?, Env::make(task, &config)?);
    let mut buffers = Buffers::new(host.spec());
    host.reset(None, None, &mut buffers.out())?;
    own.reset(None, None)?;
    let mut actions = vec![0.0; BESIDE * host.spec().n_agent * host.spec().action.len()];
    let differ = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    let mut off = 0;
    for t in 1..=STEPS {
        host.sample(t / 10, &mut actions);
        host.step(&actions, &mut buffers.out())?;
        own.step(&actions)?;
        if t % EACH == 0 {
            let told = own.buffers()?;
            off += differ(&told.observation, &buffers.observation)
                + differ(&told.central, &buffers.central)
                + differ(&told.reward, &buffers.reward)
                + differ(&told.info, &buffers.info)
                + usize::from(told.terminated != buffers.terminated)
                + usize::from(told.truncated != buffers.truncated);
        }
    }
    Ok(off)
}

/// Whole steps per second, with observations, rewards and restarts, of the best batch.
fn fastest(task: &str, device: &Device, seconds: f64) -> Result<(f64, usize)> {
    let mut best = (0.0, 0);
    for n_env in [4096, 65_536, 1 << 20] {
        let config = EnvConfig { n_env, memory_limit: 1 << 36, ..EnvConfig::default() };
        let mut env = match DeviceEnv::make(task, &config, device) {
            Ok(env) => env,
            Err(Error::Limit { .. }) => break,
            Err(error) => return Err(error),
        };
        env.reset(None, None)?;
        let (begin, mut n) = (Instant::now(), 0);
        // warm
        env.step_again()?;
        device.synchronise()?;
        let mut taken = begin.elapsed().as_secs_f64();
        if taken < seconds {
            let begin = Instant::now();
            while begin.elapsed().as_secs_f64() < seconds {
                for _ in 0..10 {
                    env.step_again()?;
                }
                n += 10;
                device.synchronise()?;
            }
            taken = begin.elapsed().as_secs_f64();
        } else {
            n = 1;
        }
        let rate = n as f64 * n_env as f64 / taken;
        if rate > best.0 {
            best = (rate, n_env);
        }
        if taken > 4.0 * seconds {
            break;
        }
    }
    Ok(best)
}

/// Steps per second that are pulled back, of a batch of 16 384.
fn gradients(task: &str, device: &Device, seconds: f64) -> Result<f64> {
    let n_env = 16_384;
    let mut env = DeviceEnv::make(task, &EnvConfig { n_env, ..EnvConfig::default() }, device)?;
    env.reset(None, None)?;
    let mut tape = env.tape(4)?;
    let n = n_env * env.spec().n_agent * env.spec().action.len();
    for _ in 0..4 {
        env.step_recorded(&vec![0.0; n], &mut tape)?;
    }
    let mut sweep = env.adjoint(true)?.sweep(SweepOptions::default())?;
    let loss = vec![1.0; n_env];
    let mut action = vec![0.0; n_env * env.spec().n_agent * env.spec().commands.len()];
    sweep.pull(&tape, 3, &Cotangents { loss: &loss, ..Cotangents::default() }, &mut action)?;
    let (begin, mut pulled) = (Instant::now(), 0);
    while begin.elapsed().as_secs_f64() < seconds {
        sweep.restart()?;
        for t in (0..4).rev() {
            sweep.pull_again(&tape, t)?;
        }
        device.synchronise()?;
        pulled += 4;
    }
    Ok(f64::from(pulled) * n_env as f64 / begin.elapsed().as_secs_f64())
}
