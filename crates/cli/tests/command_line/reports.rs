//! `report`: what was learnt as one page.

use crate::command::{command, exits, json, size, temporary};
use omnidrones::autodiff::instruction_set;
use omnidrones::autodiff::native::instructions;

#[test]
fn a_run_is_told_by_its_settings_curves_table_and_flight() {
    let folder = temporary();
    let folder = folder.path();
    let train = ["--updates", "3", "--envs", "8", "--horizon", "20", "--set", "evaluate.every=1", "--no-plots"];
    exits(0, folder, &[&["train", "Hover", "--out", "a"][..], &train].concat());
    exits(0, folder, &[&["train", "Hover", "--out", "b", "--set", "apg.horizon=16"][..], &train].concat());
    let told = json(folder, &["report", "a"]);
    assert_eq!(told["files"], serde_json::json!(["a/report.html"]));
    let page = std::fs::read_to_string(folder.join("a/report.html")).expect("written");
    for part in [
        "<h2>Run</h2>",
        "<h2>Held-out starts</h2>",
        "<td>policy (update 3)</td>",
        "<td>cascade</td>",
        "<h2>Learning curves</h2>",
        "Success and crashes",
        "<iframe sandbox=\"allow-scripts\"",
        "<h2>In flight</h2>",
        "<td>apg.n_env</td>",
        "the task's recipe",
        "all settings of Hover apg s0",
    ] {
        assert!(page.contains(&part.replace('\'', "&#39;")), "{part}");
    }
    // pages within are quoted: what is not is asked of nobody
    let (own, _) = page.split_once("srcdoc=").expect("a replay");
    for address in ["src=", "href=", "@import", "url(", "<script"] {
        assert!(!own.contains(address), "{address}");
    }
    assert!(told["bytes"] == size(folder, "a/report.html") && size(folder, "a/report.html") < 2_000_000, "{told}");
    exits(0, folder, &["report", "a", "b", "--out", "both.html", "--no-replay", "--no-baseline"]);
    let page = std::fs::read_to_string(folder.join("both.html")).expect("written");
    assert!(page.contains("<td>apg.horizon</td>") && !page.contains("<td>apg.n_env</td>"), "what differs between them");
    assert!(!page.contains("<iframe") && !page.contains("cascade") && page.contains(" beside "));
    let (_, err) = exits(2, folder, &["report", "a", "--out", "both.html"]);
    assert!(err.contains("which exists"), "{err}");
}

#[test]
fn a_run_says_whether_its_recordings_were_machine_code_and_learns_the_same_without() {
    let folder = temporary();
    let folder = folder.path();
    let off = format!("{} (interpreted: switched off by OMNIDRONES_NATIVE=off)", instruction_set());
    let train = ["train", "Hover", "--updates", "2", "--envs", "8", "--set", "evaluate.every=0", "--no-plots"];
    let learnt = [("on", instructions()), ("off", off)].map(|(switch, told)| {
        let arguments = [&train[..], &["--no-baseline", "--out", switch]].concat();
        let output = command(folder, &arguments).env("OMNIDRONES_NATIVE", switch).output().expect("the binary starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let checkpoint = folder.join(switch).join("checkpoints/000000002");
        let manifest = std::fs::read_to_string(checkpoint.join("manifest.json")).expect("written");
        assert!(manifest.contains(&format!("\"instructions\": \"{told}\"")), "{manifest}");
        exits(0, folder, &["report", switch, "--no-replay", "--no-baseline"]);
        let page = std::fs::read_to_string(folder.join(switch).join("report.html")).expect("written");
        assert!(page.contains(&format!("instructions {told}")), "{told}");
        std::fs::read(checkpoint.join("policy.safetensors")).expect("written")
    });
    assert!(learnt[0] == learnt[1], "the bits of the policy");
}

#[test]
fn seeds_searches_and_whole_tables_are_told_as_such() {
    let folder = temporary();
    let folder = folder.path();
    let small = ["--updates", "2", "--envs", "8", "--horizon", "20", "--no-plots"];
    exits(0, folder, &[&["train", "Hover", "--seeds", "2", "--out", "seeds"][..], &small].concat());
    let search = ["train", "Hover", "--search", "apg.horizon=8,16", "--seeds", "1", "--out", "search"];
    exits(0, folder, &[&search[..], &small].concat());
    let all = [
        "train-all",
        "--tasks",
        "Hover",
        "--algo",
        "apg",
        "--seeds",
        "1",
        "--budget",
        "0.002",
        "--no-plots",
        "--out",
        "all",
    ];
    exits(0, folder, &all);
    let told = |words: &[&str]| {
        exits(0, folder, &[&["report"], words, &["--out", "page.html", "--force", "--no-replay"]].concat());
        std::fs::read_to_string(folder.join("page.html")).expect("written")
    };
    let page = told(&["seeds"]);
    assert!(page.contains("Hover: apg, 2 seeds") && page.contains("<td>± 95 %</td>"), "means and intervals");
    let page = told(&["search"]);
    assert!(
        page.contains("apg.horizon=8") && page.contains("<h2>The best: apg.horizon="),
        "candidates by what differs"
    );
    let page = told(&["all"]);
    assert!(page.contains("<h2>Tasks</h2>") && page.contains("hash of settings, task and physics"));
    // rows alone, with our controller flown anew
    std::fs::remove_file(folder.join("all/table.json")).expect("removed");
    let page = told(&["all"]);
    assert!(page.contains("<td>cascade</td>"));
    let page = told(&["all", "seeds"]);
    assert!(page.contains("<h2>Tasks</h2>") && page.contains("Hover: apg, 2 seeds"), "one chapter after the other");
}

#[test]
fn what_is_no_run_is_refused() {
    let folder = temporary();
    std::fs::create_dir(folder.path().join("empty")).expect("made");
    for (words, told) in [
        (&["report", "nowhere"][..], "'nowhere', which does not exist"),
        (&["report", "empty"], "empty"),
        (&["report", "nowhere", "--out", "page.txt"], "a name that ends in .html"),
    ] {
        let (_, err) = exits(2, folder.path(), words);
        assert!(err.contains(told), "{words:?}: {err}");
    }
    std::fs::create_dir(folder.path().join("bad")).expect("made");
    std::fs::write(folder.path().join("bad/seeds.json"), "{").expect("written");
    let (_, err) = exits(2, folder.path(), &["report", "bad"]);
    assert!(err.contains("seeds.json"), "{err}");
}
