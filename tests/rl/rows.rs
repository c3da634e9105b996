//! Rows that `train-all` kept and the documents tell: of recipes, tasks and physics as they are.

use omnidrones::autodiff::instruction_set;
use omnidrones::rl::TrainConfig;
use omnidrones::rl::runs::fingerprint;
use std::path::Path;

#[test]
fn rows_that_are_kept_are_of_the_recipes_of_today() {
    if !["avx512", "avx2", "neon"].contains(&instruction_set()) {
        println!("not run: {} rounds twice where the rows' processors fuse", instruction_set());
        return;
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/rows");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut stale = Vec::new();
    let mut n = 0;
    for path in files {
        let row: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let text = |key: &str| row[key].as_str().unwrap().to_string();
        let config = TrainConfig::for_task(&text("task"), Some(&text("algorithm")), None).unwrap();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let own = format!("{}-{}-u{}", text("task"), text("algorithm"), config.updates());
        if name != own || text("hash") != fingerprint(&config).unwrap() {
            stale.push(name);
        }
        n += 1;
    }
    assert!(n >= 30 && stale.is_empty(), "{n} rows, stale: {stale:?}");
}
