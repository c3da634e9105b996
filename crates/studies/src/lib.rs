//! Published comparisons made again: what they compare, how it is flown, and what their statements come to. The command line
//! trains and tells them (`omnidrones study`, `omnidrones benchmark`).
//!
//! | file | idea |
//! |---|---|
//! | [`plan`] | rows of tasks by algorithms that a study trains, and statements that they bear on |
//! | [`verdict`] | whether a statement holds |
//! | [`ellipse_study`] | controllers on the 144 ellipses of a published comparison |

#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod ellipse_study;
pub mod plan;
pub mod verdict;
