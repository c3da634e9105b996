//! Logs that other programs read: trajectories of episodes and flights as CSV, NPZ and MCAP.

use crate::command::{exits, json, temporary};
use std::path::Path;
use std::process::Command;

/// What Python prints of a script, if there is one with these packages: `OMNIDRONES_PYTHON` or `python3`.
fn python(folder: &Path, packages: &str, script: &str) -> Option<String> {
    let name = std::env::var("OMNIDRONES_PYTHON").unwrap_or_else(|_| "python3".into());
    let run = |script: &str| Command::new(&name).args(["-c", script]).current_dir(folder).output();
    if !run(&format!("import {packages}")).is_ok_and(|output| output.status.success()) {
        eprintln!(
            "NOT RUN: no {name} with {packages} on this machine (pip install, or OMNIDRONES_PYTHON=/path/to/python)"
        );
        return None;
    }
    let output = run(script).expect("it has just started");
    let [out, err] = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{script}\n{out}\n{err}");
    Some(out)
}

/// Rows of a CSV file by the names of their columns.
fn table(path: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let mut reader = csv::Reader::from_path(path).expect("written");
    let cells = |record: &csv::StringRecord| record.iter().map(String::from).collect::<Vec<String>>();
    let header = cells(reader.headers().expect("a header"));
    (header, reader.records().map(|record| cells(&record.expect("a record"))).collect())
}

#[test]
fn episodes_are_kept_step_by_step_and_their_rewards_sum_to_their_returns() {
    let folder = temporary();
    let words = [
        "rollout",
        "Hover",
        "--envs",
        "5",
        "--horizon",
        "12",
        "--csv",
        "--trajectories",
        "3",
        "--no-plots",
        "--out",
        "a",
    ];
    exits(0, folder.path(), &words);
    let (header, rows) = table(&folder.path().join("a/trajectories.csv"));
    let at = |name: &str| header.iter().position(|own| own == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
    assert_eq!(rows.len(), 3 * 13, "three episodes of twelve steps, each with what it ended in");
    let number = |row: &[String], name: &str| row[at(name)].parse::<f64>().expect("a number");
    let (episodes, returns) = table(&folder.path().join("a/episodes.csv"));
    let told = episodes.iter().position(|name| name == "return [-]").expect("a return");
    for (i, steps) in rows.chunks(13).enumerate() {
        let sum: f64 = steps[..12].iter().map(|row| number(row, "reward [-]")).sum();
        let own: f64 = returns[i][told].parse().expect("a number");
        assert!((sum - own).abs() < 1e-4 * own.abs().max(1.0), "episode {i}: {sum} against {own}");
        assert_eq!(steps[12][at("reward [-]")], "", "no reward behind the last step");
        assert_eq!((&steps[11][at("truncated [-]")], &steps[11][at("terminated [-]")]), (&"1".into(), &"0".into()));
        // p' = v but for the way within a step: what stands in a row belongs together
        let (p, v) = ("state.position_x [m]", "state.velocity_x [m/s]");
        let moved = number(&steps[12], p) - number(&steps[0], p);
        let mean: f64 = (0..12).map(|t| 0.5 * 0.016 * (number(&steps[t], v) + number(&steps[t + 1], v))).sum();
        assert!((moved - mean).abs() < 1e-3 + 0.01 * moved.abs(), "episode {i}: {moved} against {mean}");
    }
    let (_, err) =
        exits(2, folder.path(), &["rollout", "Hover", "--csv", "--trajectories", "100000", "--envs", "100000"]);
    assert!(err.contains("--trajectories is 100000") && err.contains("Keep fewer"), "{err}");
}

#[test]
fn numpy_and_pandas_read_what_was_flown() {
    let folder = temporary();
    let rollout =
        ["rollout", "Formation", "--envs", "3", "--horizon", "9", "--csv", "--npz", "--no-plots", "--out", "a"];
    exits(0, folder.path(), &rollout);
    let sensors = "imu,camera:diffphysdrone,lidar:omnidrones";
    let fly = ["fly", "payload", "--duration", "1", "--csv", "--npz", "--sensors", sensors, "--no-plots", "--out", "b"];
    exits(0, folder.path(), &fly);
    let script = r#"
import numpy as np, pandas as pd
z, t = np.load("a/trajectories.npz"), pd.read_csv("a/trajectories.csv")
e, n = 3, z["length"].sum()
assert str(z["task"]) == "Formation" and float(z["dt"]) == 0.016
a, s = z["observation"].shape[1], z["state"].shape[1]
assert z["state"].shape == (n, s) and z["final_state"].shape == (e, s) and len(z["state_columns"]) == s
assert z["action"].shape == (n, a, len(z["action_columns"])) and z["reward"].shape == (n, a)
assert z["observation"].shape == (n, a, len(z["observation_columns"])) and z["final_observation"].shape[:2] == (e, a)
assert z["info"].shape == (n, len(z["info_columns"]))
assert z["terminated"].dtype == bool and (z["terminated"] | z["truncated"]).sum() == e
assert z["episode"].dtype == np.int64 and (np.bincount(z["episode"]) == z["length"]).all()
last = np.cumsum(z["length"]) - 1
assert (z["terminated"] | z["truncated"])[last].all()
steps = t[t["reward [-]"].notna()]
assert len(steps) == n and len(t) == n + e
for k, name in enumerate(z["state_columns"]):
    assert np.array_equal(steps["state." + name].to_numpy(np.float32), z["state"][:, k]), name
for agent in range(a):
    for k, name in enumerate(z["action_columns"]):
        assert np.array_equal(steps[f"action.{agent}.{name}"].to_numpy(np.float32), z["action"][:, agent, k]), name
f, g = np.load("b/flight.npz"), pd.read_csv("b/flight.csv")
assert f["time"].shape == (501,) and f["state"].shape == (501, len(f["state_columns"]))
for k, axis in enumerate("xyz"):
    assert np.array_equal(g[f"position_{axis} [m]"], f["position"][:, k])
assert [g[name].to_numpy().shape for name in f["sensors_columns"]] == [(501,)] * f["sensors"].shape[1]
for name in ("sensor_camera", "sensor_lidar"):
    rows = pd.read_csv(f"b/{name}.csv")
    assert np.array_equal(rows["time [s]"], f[name + "_time"]) and f[name].ndim >= 3
    assert np.array_equal(rows.to_numpy()[:, 1:], f[name].reshape(len(rows), -1))
    assert not any(n.startswith(name[7:]) for n in g.columns)
for k, name in enumerate(f["rotor_names"]):
    assert np.array_equal(g[f"thrust_{k} [N]"], f["thrust"][:, k])
print("read")
"#;
    if let Some(out) = python(folder.path(), "numpy, pandas", script) {
        assert_eq!(out.trim(), "read");
    }
}

#[test]
fn what_is_kept_is_asked_for() {
    let folder = temporary();
    let words = ["rollout", "Hover", "--envs", "2", "--horizon", "3", "--no-plots", "--out", "a"];
    let told = json(folder.path(), &[&words[..], &["--npz"]].concat());
    assert_eq!(told["files"], serde_json::json!(["a/trajectories.npz"]));
    let (_, err) = exits(2, folder.path(), &["rollout", "--all", "--npz"]);
    assert!(err.contains("cannot be used with"), "{err}");
    let (_, err) = exits(2, folder.path(), &["fly", "payload", "--drop", "--npz"]);
    assert!(err.contains("cannot be used with"), "{err}");
}

#[cfg(not(feature = "mcap"))]
#[test]
fn logs_for_foxglove_are_told_not_to_be_there() {
    eprintln!("NOT RUN: MCAP (cargo test -p omnidrones-cli --features mcap --test command_line logs)");
    let folder = temporary();
    for words in [&["fly", "iris", "--mcap"][..], &["rollout", "Hover", "--envs", "2", "--horizon", "3", "--mcap"]] {
        let (_, err) = exits(2, folder.path(), words);
        assert!(err.contains("--mcap is given") && err.contains("--features mcap"), "{err}");
        let (help, _) = exits(0, folder.path(), &[words[0], "--help"]);
        assert!(!help.contains("--mcap\n"), "{help}");
    }
}

#[cfg(feature = "mcap")]
#[test]
fn the_package_mcap_reads_frames_shapes_and_steps() {
    let folder = temporary();
    let fly = [
        "fly",
        "firefly",
        "--fail",
        "1",
        "--at",
        "0.5",
        "--duration",
        "1",
        "--csv",
        "--mcap",
        "--no-plots",
        "--out",
        "a",
    ];
    exits(0, folder.path(), &fly);
    let rollout =
        ["rollout", "TransportHover", "--envs", "2", "--horizon", "8", "--mcap", "--npz", "--no-plots", "--out", "b"];
    exits(0, folder.path(), &rollout);
    let script = r#"
import csv, math, numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
def read(path):
    reader = make_reader(open(path, "rb"), validate_crcs=True, decoder_factories=[DecoderFactory()])
    topics = {}
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        topics.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded, channel.metadata))
    assert sum(map(len, topics.values())) == reader.get_summary().statistics.message_count
    return topics
own, rows = read("a/flight.mcap"), list(csv.DictReader(open("a/flight.csv")))
steps = own["/firefly/step"]
assert len(steps) == len(rows) == 501
for (_, at, step, units), row in zip(steps, rows):
    assert abs(1e-9 * at - float(row["time [s]"])) < 1e-9
    assert step.position_x == float(row["position_x [m]"]) and step.thrust_5 == float(row["thrust_5 [N]"])
assert steps[0][3]["position_x"] == "m" and steps[0][3]["angular_velocity_x"] == "rad/s"
frames = [m for _, _, m, _ in own["/tf"]]
assert frames[0].transforms[0].parent_frame_id == "world" and frames[0].transforms[0].child_frame_id == "firefly"
for frame, (_, _, step, _) in zip(frames[1:], steps):
    (body,) = frame.transforms
    assert body.child_frame_id == "firefly/firefly" and body.parent_frame_id == "firefly"
    assert body.translation.x == step.position_x and body.rotation.w == step.attitude_w
scene = own["/scene"][0][2]
assert own["/scene"][0][0] == "foxglove.SceneUpdate" and len(scene.entities[0].cylinders) == 6
assert scene.entities[0].frame_locked and scene.entities[0].frame_id == "firefly/firefly"
assert own["/firefly/target"][0][0] == "foxglove.PoseInFrame"
assert "is lost at 0.5 s" in own["/log"][0][2].message and own["/log"][0][1] == 500_000_000
team, kept = read("b/trajectories.mcap"), np.load("b/trajectories.npz")
for e in range(2):
    steps = team[f"/episode_{e}/step"]
    assert len(steps) == kept["length"][e] == 8
    assert [m.reward for _, _, m, _ in steps] == [float(r) for r in kept["reward"][kept["episode"] == e, 0]]
assert max(len(e.cubes) for e in team["/scene"][0][2].entities) >= 1
try:
    import foxglove_schemas_protobuf.SceneUpdate_pb2 as s, foxglove_schemas_protobuf.FrameTransforms_pb2 as t
    import foxglove_schemas_protobuf.PoseInFrame_pb2 as p, foxglove_schemas_protobuf.Log_pb2 as l
except ImportError:
    print("without Foxglove's own schemas")
else:
    def shape(d): return sorted((f.name, f.number, f.type, f.is_repeated) for f in d.fields)
    def walk(a, b, seen):
        if a.full_name in seen: return
        seen.add(a.full_name)
        assert a.full_name == b.full_name and shape(a) == shape(b), (a.full_name, shape(a), shape(b))
        for f in a.fields:
            if f.message_type: walk(f.message_type, b.fields_by_name[f.name].message_type, seen)
            if f.enum_type: assert [(v.name, v.number) for v in f.enum_type.values] == [(v.name, v.number) for v in b.fields_by_name[f.name].enum_type.values]
    seen = set()
    for topic, theirs in [("/scene", s.SceneUpdate), ("/tf", t.FrameTransforms), ("/firefly/target", p.PoseInFrame), ("/log", l.Log)]:
        walk(own[topic][0][2].DESCRIPTOR, theirs.DESCRIPTOR, seen)
    print("as Foxglove's own schemas:", len(seen))
"#;
    if let Some(out) = python(folder.path(), "mcap, mcap_protobuf, numpy", script) {
        println!("{out}");
        assert!(out.contains("Foxglove's own schemas"), "{out}");
    }
}
