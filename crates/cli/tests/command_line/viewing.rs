//! Flights as pages: `replay`, `view`, and the pages that other commands write.

use crate::command::{exits, json, size, temporary};
use std::net::{Ipv4Addr, TcpListener};

/// Largest page without its flights, bytes.
const PAGE: u64 = 900_000;

#[test]
fn two_flights_are_replayed_beside_each_other_from_one_file() {
    let folder = temporary();
    let folder = folder.path();
    let words = ["replay", "Hover", "DragonHover", "--envs", "2", "--horizon", "30", "--out", "seen/page.html"];
    let told = json(folder, &words);
    let flights = told["flights"].as_array().expect("flights");
    let tasks: Vec<&str> = flights.iter().filter_map(|f| f["task"].as_str()).collect();
    assert_eq!((tasks, &flights[0]["frames"]), (vec!["Hover", "DragonHover"], &30.into()));
    let bytes = size(folder, "seen/page.html");
    assert!(bytes > 100_000 && bytes < PAGE && told["bytes"] == bytes, "{bytes}: {told}");
    let (_, err) = exits(2, folder, &words);
    assert!(err.contains("which exists") && err.contains("--force"), "{err}");
    exits(0, folder, &[&words[..], &["--force"]].concat());
}

#[test]
fn other_commands_write_the_page_when_they_are_asked() {
    let folder = temporary();
    let folder = folder.path();
    let fly = ["fly", "firefly", "--reference", "hover", "--duration", "2", "--fail", "1", "--at", "1", "--no-plots"];
    exits(0, folder, &fly);
    assert_eq!(size(folder, "out/firefly/replay.html"), 0);
    exits(0, folder, &[&fly[..], &["--replay"]].concat());
    let page = std::fs::read_to_string(folder.join("out/firefly/replay.html")).expect("written");
    assert!(page.contains("rotor_1 is lost at 1 s"));
    exits(0, folder, &["fly", "payload", "--drop=0.2", "--duration", "0.5", "--replay", "--no-plots"]);
    assert!(size(folder, "out/payload/replay.html") > 100_000);
    exits(0, folder, &["rollout", "Hover", "--envs", "2", "--horizon", "5", "--replay", "--no-plots"]);
    assert!(size(folder, "out/Hover/replay.html") > 100_000);
}

#[test]
fn a_live_page_ends_with_its_command_and_takes_no_port_of_others() {
    let folder = temporary();
    let words = ["view", "Hover", "--envs", "1", "--horizon", "10", "--duration", "0.4"];
    let told = json(folder.path(), &words);
    let address = told["address"].as_str().expect("an address").to_string();
    assert!(address.starts_with("http://127.0.0.1:"), "{address}");
    // ten steps of 16 ms a round, in real time
    let (rounds, frames) = (told["rounds"].as_u64().expect("n"), told["frames"].as_u64().expect("n"));
    assert!((1..=4).contains(&rounds) && frames <= 10 * rounds && frames > 0, "{told}");
    let port: u16 = address.trim_end_matches('/').rsplit(':').next().and_then(|p| p.parse().ok()).expect("a port");
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).expect("its port is free again");
    let (_, err) = exits(2, folder.path(), &[&words[..], &["--port", &port.to_string()]].concat());
    assert!(err.contains("port is") && err.contains("free"), "{err}");
    drop(taken);
}

#[test]
fn what_cannot_be_shown_is_refused() {
    let folder = temporary();
    for (words, told) in [
        (&["replay", "nowhere"][..], "'nowhere', which does not exist"),
        (&["replay", "Hover", "--out", "page.txt"], "a name that ends in .html"),
        (&["replay", "Hover", "--envs", "17"], "envs is 17"),
        (&["view", "Hover", "--envs", "0"], "envs is 0"),
        (&["view", "Hover", "--duration", "-1"], "--duration is -1"),
        (&["rollout", "--all", "--replay"], "cannot be used with"),
    ] {
        let (_, err) = exits(2, folder.path(), words);
        assert!(err.contains(told), "{words:?}: {err}");
    }
}
