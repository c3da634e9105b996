//! Sizes of any magnitude give an error or something small. This profile panics where a product wraps.

use crate::count;
use omnidrones::dynamics::{Fleet, Physics, World, vehicles};
use omnidrones::error::Result;
use omnidrones::parallel::Threads;
use omnidrones::rl::actor_critic::ActorCritic;
use omnidrones::rl::apg::{Apg, ApgConfig};
use omnidrones::rl::checkpoint::Tensors;
use omnidrones::rl::dagger::{Dagger, DaggerConfig};
use omnidrones::rl::dqn::{Dqn, DqnConfig};
use omnidrones::rl::nn::{Activation, Conv, Filter, Gru, Init, Layers, Mlp, Network, Pool, Set};
use omnidrones::rl::planner::{Planner, PlannerConfig};
use omnidrones::rl::ppo::{Ppo, PpoConfig};
use omnidrones::rl::replay::ReplayConfig;
use omnidrones::rl::sac::SacConfig;
use omnidrones::rl::shac::{Shac, ShacConfig};
use omnidrones::rng::{Purpose, Stream};
use omnidrones::tasks::{ActionSpace, Autoreset, Delay, Env, EnvConfig, ObservationTransform};

/// Bytes that a batch may take.
const LIMIT: u64 = 1 << 22;

/// Sizes of one case: 2^x with x uniform from 0 to a most of its own, so that all of them may be within their limits and their
/// product not; and the largest there are.
struct Sizes(Stream, f64);

impl Sizes {
    fn new(case: u64) -> Self {
        let mut stream = Stream::new(84, case, 0, Purpose::user(84));
        let most = stream.uniform(0.0, 64.0);
        Self(stream, most)
    }

    fn next(&mut self) -> usize {
        match self.0.below(20) {
            0 => usize::MAX - self.0.below(3) as usize,
            1 => 1 << self.0.below(64),
            _ => self.0.uniform(0.0, self.1).exp2() as usize,
        }
    }

    fn hidden(&mut self) -> Layers {
        Layers { hidden: (0..self.0.below(4)).map(|_| self.next()).collect(), ..Layers::default() }
    }

    fn env(&mut self) -> EnvConfig {
        let mut config = EnvConfig { n_env: self.next(), memory_limit: LIMIT, ..EnvConfig::default() };
        let horizon = self.next().min(i64::MAX as usize) as i64;
        config.task.insert("horizon".into(), horizon.into());
        match self.0.below(5) {
            0 => config.delay = Delay { min: self.next(), max: self.next() },
            1 => config.observation = (0..3).map(|_| ObservationTransform::History { steps: self.next() }).collect(),
            2 => config.actions = ActionSpace::MultiDiscrete { levels: self.next() },
            3 => (config.substeps, config.control_rate) = (self.next(), self.next()),
            _ => (config.first_environment, config.seed) = (self.next() as u64, self.next() as u64),
        }
        config
    }
}

/// What one call does with sizes of any magnitude.
type Attempt = fn(&mut Sizes) -> Result<()>;

/// Refuses before it builds anything.
const FAST: [(&str, Attempt); 7] = [
    ("World", |s| {
        let vehicle = vehicles::by_name("hummingbird")?;
        World::with_memory_limit(&vehicle, Physics::default(), s.next(), LIMIT).map(drop)
    }),
    ("Fleet", |s| Fleet::copies(&vehicles::by_name("crazyflie")?, s.next(), Physics::default(), None).map(drop)),
    ("Mlp", |s| Mlp::new(s.next(), &s.hidden(), s.next(), Activation::Tanh).map(drop)),
    ("Gru", |s| Gru::new(s.next(), s.next()).map(|own| assert!(own.n_activation() > 0))),
    ("Conv", |s| {
        let image = [s.next(), s.next(), s.next()];
        let filters = [(); 2].map(|()| Filter { channels: s.next(), kernel: s.next(), stride: s.next() });
        let (elu, init) = (Activation::Elu, Init::default());
        let over = Conv::over(image, &filters, elu, init);
        let own = over.or_else(|_| Conv::along(image[0], image[1], &filters[..1], elu, init))?;
        assert!(own.n_activation() >= own.n_output() && own.n_parameter() > 0);
        Ok(())
    }),
    ("Set", |s| {
        let phi = Mlp::new(s.next(), &s.hidden(), s.next(), Activation::Tanh)?;
        Set::new(s.next(), phi, Pool::Mean).map(|own| assert!(own.n_activation() > 0))
    }),
    ("Tensors", |s| {
        let shape: Vec<usize> = (0..s.0.below(5)).map(|_| s.next()).collect();
        Tensors::new().insert("x", &shape, vec![0_f32; s.0.below(10) as usize])
    }),
];

/// Builds environments first.
const SLOW: [(&str, Attempt); 9] = [
    ("Env", |s| Env::make("Hover", &s.env()).map(drop)),
    ("Tape", |s| {
        Env::make("Hover", &EnvConfig { memory_limit: LIMIT, ..EnvConfig::default() })?.tape(s.next()).map(drop)
    }),
    ("Planner", |s| {
        let twin = Env::make("Hover", &EnvConfig { autoreset: Autoreset::Disabled, ..s.env() })?;
        Planner::new(twin, PlannerConfig { horizon: s.next(), ..PlannerConfig::default() }).map(drop)
    }),
    ("Apg", |s| {
        let (n_env, shard, horizon, network) = (s.next(), s.next(), s.next(), s.hidden());
        let config = ApgConfig { n_env, shard, horizon, network, ..ApgConfig::default() };
        Apg::new("Hover", &s.env(), config, 1, Threads::default()).map(drop)
    }),
    ("Shac", |s| {
        let (n_env, shard, horizon, minibatches, critic) = (s.next(), s.next(), s.next(), s.next(), s.hidden());
        let config = ShacConfig { n_env, shard, horizon, minibatches, critic, ..ShacConfig::default() };
        Shac::new("Hover", &s.env(), config, 1, Threads::default()).map(drop)
    }),
    ("Ppo", |s| {
        let (n_env, shard, steps, minibatches, network) = (s.next(), s.next(), s.next(), s.next(), s.hidden());
        let config = PpoConfig { n_env, shard, steps, minibatches, network, ..PpoConfig::default() };
        Ppo::new("Hover", &s.env(), config, 1, Threads::default()).map(drop)
    }),
    ("Dagger", |s| {
        let (n_env, shard, steps, minibatches, network) = (s.next(), s.next(), s.next(), s.next(), s.hidden());
        let config = DaggerConfig { n_env, shard, steps, minibatches, network, ..DaggerConfig::default() };
        Dagger::with(&|own| Env::make("Hover", own), &s.env(), config, 1, Threads::default()).map(drop)
    }),
    ("Sac", |s| {
        let (n_env, shard, steps, batch, network) = (s.next(), s.next(), s.next(), s.next(), s.hidden());
        let replay = ReplayConfig { capacity: s.next(), learning_starts: 1, ..ReplayConfig::default() };
        let config = SacConfig { n_env, shard, steps, batch, network, replay, ..SacConfig::default() };
        ActorCritic::with(&|own| Env::make("Hover", own), &s.env(), config, 1, Threads::default()).map(drop)
    }),
    ("Dqn", |s| {
        let (n_env, shard, steps, batch, network) = (s.next(), s.next(), s.next(), s.next(), s.hidden());
        let replay = ReplayConfig { capacity: s.next(), learning_starts: 1, ..ReplayConfig::default() };
        let config = DqnConfig { n_env, shard, steps, batch, network, replay, ..DqnConfig::default() };
        Dqn::with(&|own| Env::make("Hover", own), &s.env(), config, 1, Threads::default()).map(drop)
    }),
];

fn attempts(all: &[(&str, Attempt)], cases: u64) {
    for (name, attempt) in all {
        let taken = (0..cases).filter(|case| attempt(&mut Sizes::new(*case)).is_ok()).count();
        println!("{name}: {taken} of {cases} taken");
        assert!(taken < cases as usize, "{name} takes everything");
    }
}

#[test]
fn no_product_of_sizes_wraps() {
    attempts(&FAST, 10_000);
    attempts(&SLOW, 100);
}

#[test]
#[ignore = "SIZES=10000 cargo test --test tasks sizes -- --ignored --nocapture: half an hour"]
fn no_product_of_ten_thousand_sizes_wraps_where_environments_are_built() {
    attempts(&SLOW, count("SIZES", 10_000));
}
