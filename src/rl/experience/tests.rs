use super::*;
use crate::nn::{Activation, Layers, Mlp};
use crate::replay::{Next, Precision};
use crate::shards::shards;

struct Never;

impl Explore for Never {
    fn act(&self, _: &[f32], _: usize, _: &mut Memory, _: &mut Streams<'_>, _: &mut [f32]) {
        panic!("nothing is learnt from yet");
    }
}

#[test]
fn agents_of_an_environment_hold_numbers_of_their_own_in_every_step_of_an_update() {
    let (seed, update, n) = (3, 8, 5);
    let streams = Streams { own: &mut [], n_agent: 4, seed, update, first_environment: 10 };
    let of = |agent: usize| {
        let mut held = streams.held(agent, n);
        (0..n).map(|_| held.normal()).collect::<Vec<f64>>()
    };
    for environment in 0..2 {
        let mut whole = Stream::new(seed, 10 + environment, update, Purpose::EXPLORATION);
        let whole: Vec<f64> = (0..4 * n).map(|_| whole.normal()).collect();
        let agents = 4 * environment as usize..4 * environment as usize + 4;
        assert_eq!(agents.clone().flat_map(of).collect::<Vec<f64>>(), whole);
        assert_eq!(agents.flat_map(of).collect::<Vec<f64>>(), whole, "again");
    }
}

/// 160 steps of 12 environments, with actions drawn evenly; observations are normalised and cut at `clip`.
fn flown(clip: Option<f64>) -> Experience {
    let mut env: EnvConfig = toml::from_str("n_env = 12\nstagger = true\ntask.horizon = 30").unwrap();
    env.observation.extend(clip.map(|clip| ObservationTransform::Normalise { clip }));
    let shards = shards(&|own| Env::make("Hover", own), &env, 5).unwrap();
    let spec = shards[0].env.spec().clone();
    let actor = Mlp::new(spec.n_observation, &Layers::default(), 4, Activation::Tanh).unwrap();
    let config = ReplayConfig { capacity: 2000, learning_starts: 1999, ..ReplayConfig::default() };
    let mut own = Experience::new(shards, &actor, (&config, 0.99), Widths::of(&spec, false)).unwrap();
    for update in 0..20 {
        own.fly(&Threads::new(1).unwrap(), 8, (update, 0.0), &Never).unwrap();
    }
    own
}

/// Mean and deviation were last taken at 1536 rows of 1920: what came behind is of their scale too. They do not depend on
/// where numbers are cut.
#[test]
fn what_is_kept_has_the_scale_of_what_is_seen() {
    let (raw, scaled) = (flown(None), flown(Some(1e9)));
    let known = scaled.env().statistics();
    assert_eq!(known, flown(Some(0.5)).env().statistics());
    assert_eq!(known.count, 1536.0);
    assert!(!scaled.measures(6143.0, 0.1) && scaled.measures(6144.0, 0.1) && !scaled.measures(6144.0, 0.5));
    let n = known.mean.len();
    let (mut worst, mut lasts) = (0.0_f64, 0);
    let mut compare = |x: &[f32], y: &[f32]| {
        for (k, (x, y)) in x.iter().zip(y).enumerate() {
            let std = (known.variance[k % n] + VARIANCE_FLOOR).sqrt();
            let wanted = (f64::from(*x) - known.mean[k % n]) / std;
            // rounding is that of the number itself
            let unit = 1.0 + f64::from(x.abs()) / std;
            worst = worst.max((wanted - f64::from(*y)).abs() / unit);
        }
    };
    for (raw, scaled) in raw.workers.iter().zip(&scaled.workers) {
        let (raw, scaled) = (&raw.ring, &scaled.ring);
        compare(raw.observations(), scaled.observations());
        for slot in 0..raw.kept() {
            for env in 0..raw.n_env() {
                let [x, y] = [raw, scaled].map(|ring| ring.path(slot, env, 1, 1.0, &mut [0.0]));
                assert_eq!(x, y);
                if let Next::Aside(_) = x.next {
                    let (mut then, mut now) = (vec![0.0; n], vec![0.0; n]);
                    raw.next(x.next, env, &(0..1), &mut then);
                    scaled.next(y.next, env, &(0..1), &mut now);
                    compare(&then, &now);
                    lasts += 1;
                }
            }
        }
    }
    println!("{worst:e}, {lasts} last observations");
    assert!(worst < 1e-5 && lasts > 0, "{worst:e}, {lasts} last observations");
}

/// Twelve environments of a task, 160 steps of each kept as `config` says; or none yet.
fn keeping(task: &str, config: &ReplayConfig, flies: bool) -> Experience {
    let env: EnvConfig = toml::from_str("n_env = 12\nstagger = true\ntask.horizon = 30").unwrap();
    let shards = shards(&|own| Env::make(task, own), &env, 5).unwrap();
    let spec = shards[0].env.spec().clone();
    let actor = Mlp::new(spec.n_observation, &Layers::default(), 4, Activation::Tanh).unwrap();
    let mut own = Experience::new(shards, &actor, (config, 0.99), Widths::of(&spec, false)).unwrap();
    for update in 0..if flies { 20 } else { 0 } {
        own.fly(&Threads::new(1).unwrap(), 8, (update, 0.0), &Never).unwrap();
    }
    own
}

/// Rows drawn for gradient step 0.
fn drawn(own: &Experience, rows: usize, progress: f64) -> Vec<ReplayBlock> {
    let mut blocks = ReplayBlock::cut(own.widths, rows, false);
    blocks.iter_mut().enumerate().for_each(|(k, block)| own.gather(block, (0, k), progress));
    blocks
}

/// Schaul et al. 2016, section 3.4: a row weighs (n p/Σ p)^−β. At β = 1 that makes up for how often it is drawn: weighted means over
/// what is drawn are those over all that is kept.
#[test]
fn rows_that_are_drawn_more_often_weigh_as_much_less() {
    let prior = ReplayConfig { priority: 1.0, beta: 0.4, capacity: 2000, learning_starts: 1999, ..Default::default() };
    let mut own = keeping("Hover", &prior, true);
    let known = own.priorities.clone().unwrap();
    let ids: Vec<u32> =
        (0..2100).filter(|id| *id < known.save().len() - 1 && known.get(*id) > 0.0).map(|id| id as u32).collect();
    assert_eq!(ids.len(), 160 * 12);
    let surprise = |id: u32| 1.0 + (id % 7) as f32;
    let mut rest = &ids[..];
    let mut told = ReplayBlock::cut(own.widths, ids.len(), false);
    for block in &mut told {
        let (now, later) = rest.split_at(block.rows);
        block.ids.copy_from_slice(now);
        block.error.iter_mut().zip(now).for_each(|(error, id)| *error = surprise(*id));
        rest = later;
    }
    own.rank(told.iter());
    let total: f64 = ids.iter().map(|id| f64::from(surprise(*id)) + 1e-6).sum();
    let mut worst = 0.0_f64;
    for progress in [0.0, 0.5, 1.0] {
        for block in drawn(&own, 500, progress) {
            for (id, weight) in block.ids.iter().zip(&block.weight) {
                let share = (f64::from(surprise(*id)) + 1e-6) * ids.len() as f64 / total;
                let wanted = share.powf(-(0.4 + 0.6 * progress));
                worst = worst.max((f64::from(*weight) / wanted - 1.0).abs());
            }
        }
    }
    println!("{worst:.1e}");
    assert!(worst < 1e-6, "{worst:e}"); // measured 6e-8
    let (mut mean, mut plain, rows) = (0.0, 0.0, 100_000);
    for block in drawn(&own, rows, 1.0) {
        for (id, weight) in block.ids.iter().zip(&block.weight) {
            let x = f64::from(surprise(*id)) / rows as f64;
            (mean, plain) = (mean + f64::from(*weight) * x, plain + x);
        }
    }
    let wanted = ids.iter().map(|id| f64::from(surprise(*id))).sum::<f64>() / ids.len() as f64;
    println!("{mean} of {wanted}, unweighted {plain}");
    assert!((mean - wanted).abs() < 0.02 && plain > wanted + 0.8, "{mean} {wanted} {plain}"); // measured 3.9974 twice, and 4.9989
}

/// From the same starts: what was kept as bytes is what it was behind a save, and so is what is drawn of it.
#[test]
fn beams_kept_as_bytes_are_the_same_bytes_behind_a_save() {
    let config = ReplayConfig { capacity: 2000, learning_starts: 1999, images: Precision::U8, ..Default::default() };
    let flown = keeping("Forest", &config, true);
    let mut saved = Tensors::new();
    flown.save(&mut saved).unwrap();
    let mut resumed = keeping("Forest", &config, false);
    resumed.load(&saved).unwrap();
    for (was, is) in drawn(&flown, 500, 0.0).iter().zip(&drawn(&resumed, 500, 0.0)) {
        assert_eq!((&was.ids, &was.observation, &was.next), (&is.ids, &is.observation, &is.next));
        assert_eq!((&was.action, &was.reward, &was.discount), (&is.action, &is.reward, &is.discount));
    }
    let mut again = Tensors::new();
    resumed.save(&mut again).unwrap();
    assert!(again == saved);
    let exact = ReplayConfig { images: Precision::F32, ..config };
    let told = keeping("Forest", &exact, false).load(&saved).unwrap_err().to_string();
    assert!(told.contains("replay"), "{told}");
}

/// What a flight among trees showed, from the same starts: beams as bytes are off by half a step, all else is the same.
#[test]
fn beams_kept_as_bytes_are_off_by_half_a_step() {
    let of = |images| {
        let config = ReplayConfig { capacity: 2000, learning_starts: 1999, images, ..ReplayConfig::default() };
        let own = keeping("Forest", &config, true);
        (own.env().spec().clone(), drawn(&own, 500, 0.0))
    };
    let ((spec, exact), (_, bytes)) = (of(Precision::F32), of(Precision::U8));
    let (code, n) = (ReplayCode::of(&spec, Precision::U8).unwrap(), spec.n_observation);
    assert!(2 * code.bytes() < 4 * n, "{} bytes of {}", code.bytes(), 4 * n);
    let half = spec.observation.iter().flat_map(|field| {
        let half = if field.is_of_rays() { (field.high - field.low) / 510.0 } else { 0.0 };
        vec![half as f32; field.size]
    });
    let half: Vec<f32> = half.collect();
    let mut differ = 0;
    for (exact, bytes) in exact.iter().zip(&bytes) {
        assert_eq!((&exact.action, &exact.reward, &exact.ids), (&bytes.action, &bytes.reward, &bytes.ids));
        for (x, y) in [(&exact.observation, &bytes.observation), (&exact.next, &bytes.next)] {
            for (k, (x, y)) in x.iter().zip(y).enumerate() {
                assert!((x - y).abs() <= 1.0001 * half[k % n], "number {}: {x} {y}", k % n);
                differ += usize::from(x != y);
            }
        }
    }
    assert!(differ > 1000, "{differ} of them differ");
}
