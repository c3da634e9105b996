//! A teacher that is trained first, and its student, as a stranger meets them.

use crate::command::{exits, json, temporary};

#[test]
fn a_student_is_trained_behind_its_teacher_and_goes_on_and_takes_one_that_is_there() {
    let folder = temporary();
    let folder = folder.path();
    let plain = ["--set", "evaluate.envs=8", "--no-plots", "--no-baseline"];
    let rma = [&["train", "HoverRand", "--algo", "rma", "--updates", "1"], &plain[..]].concat();
    let first = json(folder, &[&rma[..], &["--out", "first", "--set", "from_settings.apg.updates=2"]].concat());
    let longer = json(folder, &["train", "HoverRand", "--resume", "--updates", "2", "--out", "first", "--no-plots"]);
    assert_eq!((&first["updates"], &longer["updates"]), (&1.into(), &2.into()));
    let (page, _) = exits(0, folder, &[&rma[..], &["--out", "second", "--set", "from=first/from"]].concat());
    assert!(page.contains("The recipe trains for 150 updates: a first look, behind 1."), "{page}");
    let (told, _) = exits(0, folder, &["eval", "second", "--envs", "4", "--no-plots"]);
    assert!(told.contains("success"), "{told}");
}
