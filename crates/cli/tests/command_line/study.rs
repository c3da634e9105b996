//! `study` as a stranger meets it: made in parts, told as a whole.

use crate::command::{exits, json, temporary, widest};
use serde_json::Value;

#[test]
fn a_study_is_made_in_parts_and_its_report_tells_all_that_is_there() {
    let folder = temporary();
    let study = |words: &[&str]| {
        json(folder.path(), &[&["study", "paper", "--budget", "0.001", "--format", "svg"], words].concat())
    };
    let trained = |told: &Value| {
        let rows = told["rows"].as_array().expect("rows").iter();
        rows.filter(|row| !row["runs"].as_array().expect("runs").is_empty()).cloned().collect::<Vec<_>>()
    };
    study(&["--tasks", "Hover", "--algos", "ppo", "--seeds", "2"]);
    let told = study(&["--tasks", "hover", "--algos", "dqn", "--seeds", "2"]);
    let named = trained(&told).iter().map(|row| (row["algorithm"].clone(), row["setting"].clone())).collect::<Vec<_>>();
    let by = |algorithm: &str, setting: &str| (Value::from(algorithm), Value::from(setting));
    assert_eq!(
        named,
        [
            by("ppo", ""),
            by("dqn", "joint"),
            by("dqn", "apart"),
            by("ppo", "rate"),
            by("ppo", "attitude"),
            by("ppo", "velocity")
        ]
    );
    assert!(
        trained(&told).iter().all(|row| row["runs"][1]["seed"] == 1 && row["share_of_controller"]["mean"].is_number())
    );
    let again = study(&["--no-train", "--seeds", "2"]);
    assert_eq!(trained(&again), trained(&told), "nothing is trained, and nothing is lost");
    let claims = told["claims"].as_array().expect("claims");
    let undecided = |claim: &Value| claim["verdict"].as_str().is_some_and(|verdict| verdict.starts_with("not decided"));
    assert!(claims.iter().filter(|claim| undecided(claim)).count() == claims.len(), "{claims:?}");
    let read = |name: &str| std::fs::read_to_string(folder.path().join("runs/study-paper").join(name)).expect(name);
    let (markdown, html) = (read("study.md"), read("study.html"));
    assert!(markdown.contains("| Hover | dqn, joint |") && markdown.contains("(curves.svg)"), "{markdown}");
    assert!(html.contains("<td>dqn, joint</td>") && html.contains("<svg") && read("curves.svg").contains("dqn, joint"));
    let (page, _) = exits(0, folder.path(), &["study", "paper", "--budget", "0.001", "--no-train", "--seeds", "2"]);
    assert!(page.contains("dqn, joint") && widest(&page) <= 160, "{page}");
    for (words, says) in [
        (&["studies"][..], "paper"),
        (&["paper", "--tasks", "Hovr"], "'Hover'"),
        (&["paper", "--budget", "0"], "budget"),
    ] {
        let (_, error) = exits(2, folder.path(), &[&["study"], words].concat());
        assert!(error.contains(says), "{error}");
    }
}
