//! The HTML file: script, styles and flights in one, so that it opens from a disk without a network.

use super::recording::Recording;
use omnidrones::internals::steers;
use serde_json::Value;

const PAGE: &str = include_str!("../web/page.html");
const STYLE: &str = include_str!("../web/style.css");
const SCRIPT: &str = include_str!("../web/viewer.js");

/// One or several flights, beside each other under one clock.
pub fn page(title: &str, flights: &[Recording]) -> String {
    let flights: Vec<Value> = flights.iter().map(Recording::to_json).collect();
    filled(title, &Value::from(flights), "'none'")
}

/// The page that asks its server for flights.
pub(crate) fn live_page() -> String {
    filled("omnidrones: live", &Value::Array(Vec::new()), "'self'")
}

/// `connect` is what the page's policy lets it ask.
fn filled(title: &str, flights: &Value, connect: &str) -> String {
    let mut page = String::with_capacity(PAGE.len() + STYLE.len() + SCRIPT.len() + 65_536);
    let mut rest = PAGE;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").unwrap_or(("", after));
        page += before;
        match name {
            "title" => page += &escaped(title),
            "connect" => page += connect,
            "style" => page += STYLE,
            "flights" => page += &data(flights),
            "script" => page += SCRIPT,
            _ => {}
        }
        rest = after;
    }
    page + rest
}

/// JSON in which a browser finds no end of its element: names come from files of anybody.
fn data(value: &Value) -> String {
    let text: String = value.to_string().chars().map(|c| if steers(c) { '·' } else { c }).collect();
    text.replace('<', "\\u003c")
}

fn escaped(text: &str) -> String {
    let text: String = text.chars().map(|c| if steers(c) { '·' } else { c }).collect();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_ends_the_data_and_nothing_is_left_to_fill_in() {
        let evil = "</script><script>alert(1)</script>{{script}}";
        let recording = Recording::new(evil, 0.02, Vec::new(), Vec::new());
        let html = page(evil, &[recording]);
        assert_eq!(html.matches("</script").count(), 2, "the data and the script end once each");
        assert!(html.contains("\\u003c/script>") && !html.contains("alert(1)</script"));
        assert!(html.starts_with("<!DOCTYPE html>") && html.trim_end().ends_with("</html>"));
    }

    #[test]
    fn the_page_names_no_address() {
        let html = page("empty", &[]);
        for address in ["src=\"http", "href=\"http", "@import", "url(http"] {
            assert!(!html.contains(address), "{address}");
        }
        assert!(html.contains("default-src 'none'") && html.contains("connect-src 'none'"));
        assert!(html.len() < 900_000, "{} bytes", html.len());
    }
}
