//! Records of evaluations.

use omnidrones::tasks::{Env, EnvConfig, Record, Spread};

#[test]
fn a_spread_is_that_of_its_numbers_in_any_order() {
    let spread = Spread::of(&mut [10.0, 0.0, 5.0, 1.0, 9.0, 2.0, 8.0, 3.0, 7.0, 4.0, 6.0]);
    assert_eq!((spread.mean, spread.low, spread.median, spread.high), (5.0, 1.0, 5.0, 9.0));
    assert!(Spread::of(&mut []).median.is_nan());
    assert_eq!(Spread::of(&mut [3.0]), Spread { mean: 3.0, low: 3.0, median: 3.0, high: 3.0 });
}

#[test]
fn an_episode_or_a_column_that_there_is_not_is_no_panic() {
    let env = Env::make("Hover", &EnvConfig { n_env: 3, ..EnvConfig::default() }).unwrap();
    let record = Record::new(&env, 1);
    assert_eq!(record.why(2).unwrap(), "time");
    assert!(record.why(3).unwrap_err().to_string().starts_with("environment is 3, but it must be < 3."));
    assert!(record.ended(env.spec().info.len()).is_empty());
}
