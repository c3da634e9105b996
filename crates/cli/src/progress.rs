//! Progress on standard error: only when that is a terminal and the user did not ask for JSON.

use super::table::columns;
use indicatif::{HumanCount, ProgressBar, ProgressState, ProgressStyle};
use std::io::IsTerminal;

/// Least length of a bar, characters.
const LEAST_BAR: usize = 10;
/// Between two figures of a message.
const BETWEEN: &str = " · ";
/// Columns of a terminal below which the rate is left out.
const WIDE: usize = 110;
/// Most characters of the rate and of the time left, with what is around them.
const RATE: usize = 11;
const LEFT: usize = 10;

/// A bar over `total` steps with rate and time left; hidden when `quiet` or when standard error is no terminal.
pub fn bar(total: u64, what: &str, quiet: bool) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(total);
    // The templates are constants: should indicatif refuse one, its own style serves.
    if let Ok(style) = ProgressStyle::with_template(template(columns())) {
        bar.set_style(style.with_key("rate", rate).progress_chars("━╸─"));
    }
    say(&bar, what);
    bar
}

fn template(columns: usize) -> &'static str {
    if columns < WIDE {
        "{msg} {wide_bar:.cyan/dim} {human_pos}/{human_len}  {eta} left"
    } else {
        "{msg:<22} {wide_bar:.cyan/dim} {human_pos}/{human_len}  {rate}  {eta} left"
    }
}

/// Says how it goes: as many of the message's figures as leave room for the bar, the first ones first.
pub fn say(bar: &ProgressBar, message: &str) {
    if !bar.is_hidden() {
        bar.set_message(fitting(message, room(columns(), bar.length().unwrap_or(0))));
    }
}

/// What is left for the message beside a bar of `total` steps.
fn room(columns: usize, total: u64) -> usize {
    let count = HumanCount(total).to_string().len();
    let rate = if columns < WIDE { 0 } else { RATE };
    columns.saturating_sub(LEAST_BAR + 2 * count + 3 + rate + LEFT)
}

/// The leading figures of a message that fit into so many characters; the first is cut if it does not.
fn fitting(message: &str, room: usize) -> String {
    let mut ends = message.match_indices(BETWEEN).map(|(at, _)| at).chain([message.len()]);
    let fits = |end: &usize| message[..*end].chars().count() <= room;
    match ends.by_ref().take_while(fits).last() {
        Some(end) => message[..end].to_string(),
        None => message.chars().take(room.saturating_sub(1)).chain(['…']).collect(),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    const MESSAGE: &str = "return 412 · success 98 % · 3.12 M steps/s · fly 36 % sweep 61 %";

    #[test]
    fn figures_that_leave_no_room_for_the_bar_are_left_out_from_the_end() {
        assert_eq!(fitting(MESSAGE, 100), MESSAGE);
        assert_eq!(fitting(MESSAGE, 50), "return 412 · success 98 % · 3.12 M steps/s");
        assert_eq!(fitting(MESSAGE, 10), "return 412");
        assert_eq!(fitting(MESSAGE, 5), "retu…");
        assert_eq!(fitting("", 0), "");
    }

    #[test]
    fn a_terminal_of_eighty_columns_shows_return_and_success_and_a_bar_of_ten() {
        for total in [1, 800, 20_000] {
            let told = fitting(MESSAGE, room(80, total));
            let around = 2 * HumanCount(total).to_string().len() + " / 59m left  ".len();
            assert!(told.starts_with("return 412 · success 98 %"), "{told}");
            assert!(told.chars().count() + around + LEAST_BAR <= 80, "{told}");
        }
        assert_eq!(room(20, 800), 0);
    }
}
