#![no_main]
//! A checkpoint that was forged: lengths, hashes and the seal are right, so that what stands behind them is reached. An error, or
//! tensors.

use libfuzzer_sys::fuzz_target;
use omnidrones::rl::checkpoint::Checkpoint;
use serde_json::json;
use sha2::{Digest, Sha256};
use std::fmt::Write;

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

// policy, state and what else the manifest says, behind two bytes each that tell where they end
fuzz_target!(|data: &[u8]| {
    let Some((ends, data)) = data.split_first_chunk::<4>() else { return };
    let end = |k: usize| usize::from(u16::from_le_bytes([ends[k], ends[k + 1]])).min(data.len());
    let (policy, data) = data.split_at(end(0));
    let (state, extra) = data.split_at(end(2).min(data.len()));
    let entry = |bytes: &[u8]| json!({ "bytes": bytes.len(), "sha256": hash(bytes) });
    let mut manifest = json!({
        "format": 1, "version": "0.1.0", "instructions": "avx2", "algorithm": "ppo", "task": "Hover", "spec_hash": "0000000000000000",
        "config": "", "seed": 0, "update": 1, "env_steps": 0, "seconds": 0.0, "extra": {},
        "files": { "policy": entry(policy), "state": entry(state) },
    });
    if let (Some(all), Ok(changes)) = (manifest.as_object_mut(), serde_json::from_slice::<serde_json::Map<_, _>>(extra)) {
        all.extend(changes);
    }
    let Ok(text) = serde_json::to_string_pretty(&manifest) else { return };
    let body = text.trim_end_matches("\n}");
    let sealed = format!("{body},\n  \"sha256\": \"{}\"\n}}\n", hash(body.as_bytes()));
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    for (name, bytes) in [("policy.safetensors", policy), ("state.safetensors", state), ("manifest.json", sealed.as_bytes())] {
        std::fs::write(folder.path().join(name), bytes).expect("room for a file");
    }
    let _ = Checkpoint::load(folder.path());
});
