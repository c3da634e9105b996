//! A teacher that is trained first, and its student, as a stranger meets them.

use crate::command::{exits, json, temporary};

#[test]
fn a_student_is_trained_behind_its_teacher_and_goes_on_and_takes_one_that_is_there() {
    let folder = temporary();
    let folder = folder.path();
    let train = |words: &[&str]| {
        let own = ["train", "HoverRand", "--algo", "rma", "--set", "evaluate.envs=8", "--no-plots", "--no-baseline"];
        json(folder, &[&own[..], words].concat())
    };
    let first = train(&["--updates", "1", "--set", "from_settings.apg.updates=2", "--out", "first"]);
    assert_eq!(first["updates"], 1);
    let longer = json(
        folder,
        &["train", "HoverRand", "--resume", "--updates", "2", "--out", "first", "--no-plots", "--no-baseline"],
    );
    assert_eq!(longer["updates"], 2);
    let second = train(&["--updates", "1", "--set", "from=first/from", "--out", "second"]);
    assert_eq!(second["updates"], 1);
    let (told, _) = exits(0, folder, &["eval", "second", "--envs", "4", "--no-plots"]);
    assert!(told.contains("success"), "{told}");
}
