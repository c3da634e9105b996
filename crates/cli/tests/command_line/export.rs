//! `export`: what is written for a flight computer, and what is refused.

use crate::command::{command, exits, json, size, temporary};
use std::path::Path;
use std::process::Command;

fn has_compiler() -> bool {
    let found = Command::new("cc").arg("--version").output().is_ok_and(|output| output.status.success());
    if !found {
        println!("no C compiler here: --check is left out");
    }
    found
}

/// A run of Hover that has learnt nothing.
fn train(folder: &Path, more: &[&str]) {
    let tiny = ["train", "Hover", "--updates", "1", "--envs", "8", "--horizon", "20", "--no-plots", "--no-baseline"];
    let less = ["--set", "evaluate={every=0,envs=8}", "--out", "run"];
    exits(0, folder, &[&tiny[..], &less, more].concat());
}

#[test]
fn one_of_each_kind_is_written_told_and_good() {
    let folder = temporary();
    let folder = folder.path();
    for (line, name, function) in [
        ("hummingbird", "hummingbird", "hummingbird_step"),
        ("payload --dt 0.004", "payload", "payload_step"),
        ("cascade --vehicle hummingbird --filters low_pass:80", "hummingbird_cascade", "hummingbird_cascade_tick"),
        ("lqi --vehicle iris --precision double --name hold", "hold", "hold_tick"),
        ("Hover --set horizon=100", "hover", "hover_judge"),
        ("lemniscate", "lemniscate", "lemniscate_target"),
    ] {
        let mut words: Vec<&str> = ["export", "c"].into_iter().chain(line.split(' ')).collect();
        if has_compiler() {
            words.push("--check");
        }
        let told = json(folder, &words);
        let functions: Vec<&str> =
            told["functions"].as_array().expect("functions").iter().filter_map(|own| own["name"].as_str()).collect();
        assert!(told["name"] == name && functions.contains(&function), "{told}");
        assert!(told["check"].is_null() || told["check"]["good"] == true, "{}", told["check"]);
        for ending in [".h", ".c", "_test.c", ".md"] {
            assert!(size(folder, &format!("out/c/{name}{ending}")) > 100, "{name}{ending}");
        }
    }
    // files say what they are
    std::fs::write(folder.join("ring.toml"), "kind = 'circle'\nradius = 2.5\n").expect("written");
    let told = json(folder, &["export", "c", "ring.toml", "--name", "ring"]);
    assert!(told["title"].as_str().is_some_and(|title| title.contains("circle")), "{told}");
    let page = std::fs::read_to_string(folder.join("out/c/hummingbird.md")).expect("written");
    assert!(page.contains("| `void hummingbird_step(const float state[17]"), "{page}");
}

#[test]
fn a_policy_leaves_as_c_and_as_onnx() {
    let folder = temporary();
    let folder = folder.path();
    train(folder, &["--set", "observation=[{kind='history',steps=3},{kind='normalise'}]"]);
    let check = if has_compiler() { &["--check"][..] } else { &[] };
    let told = json(folder, &[&["export", "c", "run", "--out", "c"][..], check].concat());
    assert!(told["name"] == "hover_policy" && told["table_bytes"].as_u64() > Some(1000), "{told}");
    let header = std::fs::read_to_string(folder.join("c/hover_policy.h")).expect("written");
    let step = "int hover_policy_step(hover_policy_memory *memory, const float state[17], const float goal[3], float action[4]);";
    assert!(header.contains(step), "{header}");

    let told = json(folder, &["export", "onnx", "run", "--out", "hover.onnx"]);
    assert!(told["bytes"].as_u64() == Some(size(folder, "hover.onnx")) && told["memory"] == 0, "{told}");
    let bytes = std::fs::read(folder.join("hover.onnx")).expect("written");
    assert!([&b"observation"[..], b"action"].iter().all(|name| bytes.windows(name.len()).any(|own| own == *name)));
    let (_, err) = exits(2, folder, &["export", "onnx", "run", "--out", "hover.onnx"]);
    assert!(err.contains("hover.onnx") && err.contains("--force"), "{err}");
    exits(0, folder, &["export", "onnx", "run", "--out", "hover.onnx", "--force"]);
}

#[test]
fn a_file_of_others_is_kept_and_one_of_omnidrones_replaced() {
    let folder = temporary();
    let folder = folder.path();
    let line = ["export", "c", "crazyflie", "--out", "firmware"];
    exits(0, folder, &line);
    exits(0, folder, &line);
    std::fs::write(folder.join("firmware/crazyflie.c"), "int mine;\n").expect("written");
    let (_, err) = exits(2, folder, &line);
    assert!(err.contains("crazyflie.c', which omnidrones did not write"), "{err}");
    let kept = std::fs::read_to_string(folder.join("firmware/crazyflie.c")).expect("there");
    assert_eq!(kept, "int mine;\n");
    exits(0, folder, &[&line[..], &["--force"]].concat());
    let (_, err) = exits(2, folder, &["export", "c", "lemniscate", "--name", "crazyflie", "--out", "firmware"]);
    assert!(
        err.contains("already that of one step of 0.002 s of 'crazyflie'") && err.contains("another name"),
        "{err}"
    );
    let header = std::fs::read_to_string(folder.join("firmware/crazyflie.h")).expect("there");
    assert!(header.contains("Made from: omnidrones export c crazyflie --out firmware"), "{header}");
}

#[test]
fn what_cannot_be_exported_is_refused_by_name_with_a_reason() {
    let folder = temporary();
    for (line, words) in [
        ("hoover", "no model, controller, policy, task or reference is called 'hoover' (did you mean 'Hover'?)"),
        ("mpc --vehicle firefly", "controller 'mpc' is a plan, whose solver takes as many steps as it needs"),
        ("fault_tolerant --vehicle firefly", "changes its allocation when it is told of a failure"),
        ("lqr --vehicle payload", "a feedback that reads the reference seconds ahead"),
        ("transport", "the name of a model and a controller"),
        ("cascade", "Say what it flies: --vehicle hummingbird"),
        ("cascade --vehicle payload", "one rigid vehicle"),
        ("hummingbird --gains derived", "--gains is given with a model"),
        ("lemniscate --dt 0.01", "an option of controller, model, task"),
        ("Hover --rates 500,250,100", "--rates is given with a task"),
        ("hummingbird --name 9lives", "name of the module is '9lives'"),
        ("hummingbird --name bird_test", "not _test behind them"),
        ("hummingbird --seed 3", "--seed is given with a model"),
        ("hummingbird --randomise mass:0.8:1.2", "--randomise is given with a model"),
        ("no/such/run --kind policy", "which does not exist"),
        ("no/such/run", "which does not exist"),
        ("no/such/run --kind controller", "no controller is called 'no/such/run'"),
        ("Hover --set n_drone=3", "n_drone"),
        ("cascade --vehicle hummingbird --rates 300,250,100", "500"),
    ] {
        let words_of: Vec<&str> = ["export", "c"].into_iter().chain(line.split(' ')).collect();
        let (_, err) = exits(2, folder.path(), &words_of);
        assert!(err.contains(words), "{line}: {err}");
    }
    assert!(!folder.path().join("out").exists(), "nothing is written");
    let (_, err) = exits(2, folder.path(), &["export", "onnx", "nowhere"]);
    assert!(err.contains("'nowhere', which does not exist"), "{err}");
}

#[test]
fn a_check_without_a_compiler_or_with_a_bad_one_does_not_pass() {
    let folder = temporary();
    let run = |compiler: &str| {
        let mut own = command(folder.path(), &["export", "c", "lemniscate", "--check"]);
        let output = own.env("CC", compiler).output().expect("the binary starts");
        let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("UTF-8"));
        (output.status.code(), out + &err)
    };
    let (code, said) = run("no-such-compiler");
    assert!(code == Some(2) && said.contains("C compiler of --check is 'no-such-compiler'"), "{said}");
    if cfg!(unix) {
        // starts, and compiles nothing
        let (code, said) = run("true");
        assert!(code != Some(0), "{said}");
    }
}
