//! What settings mean, from the documentation beside their fields: said once, read by people and printed into files.

/// The first sentence beside each field of `pub struct NAME` in `source`, by the field's name.
pub fn fields(source: &str, name: &str) -> Vec<(String, String)> {
    let head = format!("pub struct {name} {{");
    let body = source.split_once(&head).map_or("", |(_, rest)| rest);
    let (mut all, mut words) = (Vec::new(), String::new());
    for line in body.lines().map(str::trim).take_while(|line| *line != "}") {
        if let Some(text) = line.strip_prefix("///") {
            words.push_str(text);
        } else if let Some((field, _)) = line.strip_prefix("pub ").and_then(|rest| rest.split_once(':')) {
            all.push((field.to_string(), sentence(&std::mem::take(&mut words))));
        }
    }
    all
}

/// Up to its first full stop, without marks of code and links.
fn sentence(text: &str) -> String {
    let text = text.trim();
    // authors and others are no end
    let ends = text.match_indices(". ").map(|(at, _)| at).find(|at| !text[..*at].ends_with("et al"));
    let text = &text[..ends.unwrap_or(text.len())];
    let linked = text
        .split("](")
        .enumerate()
        .map(|(i, part)| if i == 0 { part } else { part.split_once(')').map_or(part, |(_, rest)| rest) });
    linked.collect::<String>().trim_end_matches('.').replace(['`', '[', ']'], "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_sentence_beside_a_field_is_its_meaning() {
        let source = "pub struct A {\n    /// Share of `x`, up to\n    /// [`MAX`]. More.\n    #[serde(default)]\n    pub a: f64,\n}\npub struct B {\n    /// No.\n    pub b: f64,\n}";
        assert_eq!(fields(source, "A"), [("a".to_string(), "Share of x, up to MAX".to_string())]);
        let source = "pub struct A {\n    /// As (Lowe et al. 2017) has it. More.\n    pub a: f64,\n}";
        assert_eq!(fields(source, "A")[0].1, "As (Lowe et al. 2017) has it");
    }
}
