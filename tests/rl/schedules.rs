//! Schedules: closed forms, texts, refusals.

use omnidrones::rl::schedule::Schedule;
use serde::{Deserialize, Serialize};

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct File {
    rate: Schedule,
}

fn read(text: &str) -> std::result::Result<Schedule, String> {
    toml::from_str::<File>(&format!("rate = {text}")).map(|f| f.rate).map_err(|e| e.to_string())
}

const KINDS: [&str; 3] = ["linear", "cosine", "exponential"];

#[test]
fn a_bare_number_is_constant() {
    for (text, value) in [("0.001", 0.001), ("3", 3.0), ("-2e-3", -0.002)] {
        let schedule = read(text).unwrap();
        assert_eq!(schedule, Schedule::constant(value));
        assert!([-1.0, 0.0, 0.3, 1.0, 2.0, f64::NAN].iter().all(|p| schedule.at(*p) == value));
    }
    assert_eq!(serde_json::from_str::<Schedule>("3").unwrap(), 3.0.into());
}

#[test]
fn every_kind_begins_and_ends_at_its_numbers_to_the_bit() {
    for kind in KINDS {
        let schedule = read(&format!("{{ kind = '{kind}', from = 0.01, to = 1e-4 }}")).unwrap();
        assert_eq!((schedule.at(0.0), schedule.at(1.0)), (0.01, 1e-4), "{kind}");
        assert_eq!((schedule.at(f64::NAN), schedule.at(-1.0), schedule.at(7.0)), (0.01, 0.01, 1e-4), "{kind}");
        let falls = (0..100).all(|k| schedule.at(f64::from(k) / 100.0) > schedule.at(f64::from(k + 1) / 100.0));
        assert!(falls, "{kind}");
    }
}

#[test]
fn a_quarter_of_the_way_has_the_closed_forms_number() {
    let at = |kind: &str| read(&format!("{{ kind = '{kind}', from = 16, to = 1 }}")).unwrap().at(0.25);
    let cosine = 1.0 + 15.0 * (1.0 + 0.5_f64.sqrt()) / 2.0;
    for (kind, want) in KINDS.iter().zip([12.25, cosine, 8.0]) {
        assert!((at(kind) - want).abs() < 1e-14, "{kind}: {} {want}", at(kind)); // 0
    }
}

#[test]
fn a_warm_up_rises_from_zero_and_the_kind_takes_what_is_left() {
    for kind in KINDS {
        let plain = read(&format!("{{ kind = '{kind}', from = 4, to = 1 }}")).unwrap();
        let warm = read(&format!("{{ kind = '{kind}', from = 4, to = 1, warm_up = 0.2 }}")).unwrap();
        assert_eq!((warm.at(0.0), warm.at(0.05), warm.at(0.2), warm.at(1.0)), (0.0, 1.0, 4.0, 1.0), "{kind}");
        assert!((warm.at(0.6) - plain.at(0.5)).abs() < 1e-14, "{kind}");
        assert!((warm.at(0.2 - 1e-12) - 4.0).abs() < 1e-10, "{kind}: a jump");
    }
    let constant = read("{ kind = 'constant', value = 2, warm_up = 0.5 }").unwrap();
    assert_eq!([0.0, 0.25, 0.5, 1.0].map(|p| constant.at(p)), [0.0, 1.0, 2.0, 2.0]);
}

#[test]
fn schedules_survive_their_own_text() {
    for text in [
        "0.5",
        "{ kind = 'constant', value = 2.0, warm_up = 0.5 }",
        "{ kind = 'linear', from = 1.0, to = 0.0 }",
        "{ kind = 'cosine', from = 1.0, to = 0.0, warm_up = 0.1 }",
        "{ kind = 'exponential', from = 1.0, to = 0.5 }",
    ] {
        let file = File { rate: read(text).unwrap() };
        let toml = toml::to_string(&file).unwrap();
        assert_eq!(toml::from_str::<File>(&toml).unwrap(), file, "{toml}");
        let json = serde_json::to_string(&file).unwrap();
        assert_eq!(serde_json::from_str::<File>(&json).unwrap(), file, "{json}");
    }
    assert_eq!(toml::to_string(&File { rate: 0.5.into() }).unwrap(), "rate = 0.5\n");
}

#[test]
fn texts_that_are_no_schedule_say_what_one_is() {
    for (text, told) in [
        ("'fast'", "a number or a table such as { kind = \"linear\""),
        ("{ kind = 'step', from = 1, to = 0 }", "unknown variant `step`, expected one of `constant`"),
        ("{ kind = 'linear', from = 1 }", "missing field `to`"),
        ("{ kind = 'linear', from = 1, to = 0, warmup = 0.1 }", "unknown field `warmup`, expected one of"),
        ("{ from = 1, to = 0 }", "missing field `kind`"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.contains(told), "{text}: {error}");
    }
}

#[test]
fn numbers_that_cannot_be_meant_are_named() {
    let told = |text: &str| read(text).unwrap().validate("rate").unwrap_err().to_string();
    assert!(told("nan").starts_with("rate: value is NaN, but it must be a finite number"));
    assert!(told("{ kind = 'linear', from = 1, to = inf }").starts_with("rate: to is inf"));
    let text = told("{ kind = 'exponential', from = 1, to = 0 }");
    assert!(text.starts_with("rate: to is 0, but it must be > 0") && text.contains("linear"), "{text}");
    for warm_up in ["1", "-0.1", "nan"] {
        let text = told(&format!("{{ kind = 'cosine', from = 1, to = 0, warm_up = {warm_up} }}"));
        assert!(text.starts_with("rate: warm_up is") && text.contains("in [0, 1)"), "{text}");
    }
    read("{ kind = 'cosine', from = 1, to = -1, warm_up = 0.99 }").unwrap().validate("rate").unwrap();
}
