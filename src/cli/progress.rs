//! Progress on standard error: only when that is a terminal and the user did not ask for JSON.

use indicatif::{HumanCount, ProgressBar, ProgressState, ProgressStyle};
use std::io::IsTerminal;

/// A bar over `total` steps with rate and time left; hidden when `quiet` or when standard error is no terminal.
pub fn bar(total: u64, what: &str, quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(total);
    let template = "{msg:<22} {wide_bar:.cyan/dim} {human_pos}/{human_len}  {rate}  {eta} left";
    // The template is a constant: should indicatif refuse it, its own style serves.
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.with_key("rate", rate).progress_chars("━╸─"));
    }
    bar.set_message(what.to_string());
    bar
}

/// Steps per second without the decimals of a stopwatch.
fn rate(state: &ProgressState, out: &mut dyn std::fmt::Write) {
    let rate = state.per_sec();
    let _ = if rate < 10.0 { write!(out, "{rate:.1}/s") } else { write!(out, "{}/s", HumanCount(rate as u64)) };
}

/// A spinner for work of unknown length; hidden like [`bar`].
pub fn spinner(what: &str, quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let spinner = ProgressBar::new_spinner();
    spinner.set_message(what.to_string());
    spinner.enable_steady_tick(std::time::Duration::from_millis(120));
    spinner
}
