//! What is made once, when it is first asked for.

use std::sync::OnceLock;

/// What `cell` holds, or what `make` makes for it. Nobody waits for another thread that makes it: in a process made by `fork` that
/// thread may not be there. Two may make it then, and one of both is kept.
pub fn made_once<T>(cell: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    if let Some(made) = cell.get() {
        return made;
    }
    let made = make();
    cell.get_or_init(|| made)
}
