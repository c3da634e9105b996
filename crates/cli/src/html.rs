//! A page for a browser or a printer, one file that asks no other file for anything and has no scripts but those of pages within; and
//! a page as Markdown.

use super::page::{Block, Fact, Page};
use super::table::{Align, Table};
use super::words::shown;
use std::fmt::Write;

/// Looks: dark text on white in one column, tables that stay whole on a printed page.
const STYLE: &str = "\
body{font:14px/1.45 system-ui,sans-serif;color:#212529;background:#fff;max-width:1000px;margin:2em auto;padding:0 1em}\
h1{font-size:1.6em;margin:0}h2{font-size:1.15em;margin:1.8em 0 .5em;border-bottom:1px solid #dee2e6}\
p{margin:.4em 0}h1,h2,h3,p{overflow-wrap:anywhere}.remark,td.note{color:#5b6168}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
td,th{padding:.15em .9em .15em 0;text-align:left;vertical-align:top}th{border-bottom:1px solid #adb5bd}\
td{white-space:nowrap}td.note,td:last-child:not(.r){white-space:normal}.r{text-align:right}.wide{overflow-x:auto;max-width:100%}figure{margin:1em 0}svg{max-width:100%;height:auto}\
h3{font-size:1em;margin:1.2em 0 .3em}pre{background:#f6f8fa;padding:.6em .9em;overflow-x:auto}summary{cursor:pointer}\
iframe{display:block;width:100%;height:560px;border:1px solid #dee2e6;border-radius:6px}\
@media(max-width:600px){.facts tr{display:grid;grid-template-columns:8.5em 1fr}.facts td{white-space:normal;overflow-wrap:anywhere}.facts .note{grid-column:2}}\
@media print{body{margin:0;max-width:none;font-size:11px}table,figure{break-inside:avoid}h2{break-after:avoid}iframe{display:none}}";

/// A page as a file for a browser; its first title is that of the file.
pub fn html(page: &Page) -> String {
    let (mut body, mut title) = (String::new(), String::new());
    for block in &page.blocks {
        let _ = match block {
            Block::Title(name, remark) => {
                title = escaped(name);
                writeln!(body, "<h1>{title}</h1>\n<p class=\"remark\">{}</p>", escaped(remark))
            }
            Block::Heading(name) => writeln!(body, "<h2>{}</h2>", escaped(name)),
            Block::Subheading(name) => writeln!(body, "<h3>{}</h3>", escaped(name)),
            // indented as text
            Block::Line(text) | Block::Prose(text) => writeln!(body, "<p>{}</p>", by_lines(text.trim(), escaped)),
            Block::Notes(word, texts) => {
                texts.iter().try_for_each(|text| writeln!(body, "<p>{} {}</p>", escaped(word), escaped(text)))
            }
            Block::Facts(facts) => {
                let rows: String = facts.iter().map(fact).collect();
                writeln!(body, "<div class=\"wide\"><table class=\"facts\">\n{rows}</table></div>")
            }
            Block::Table(own) => table(&mut body, own),
            Block::Figure(svg, _) => writeln!(body, "<figure>{}</figure>", svg.trim()),
            Block::Folded(summary, text) => {
                let text: String = text.lines().map(|line| escaped(line) + "\n").collect();
                writeln!(body, "<details><summary>{}</summary><pre>{text}</pre></details>", escaped(summary))
            }
            Block::Within(title, page) => {
                let (title, page) = (escaped(title), page.replace('&', "&amp;").replace('"', "&quot;"));
                let allowed = "sandbox=\"allow-scripts\" allow=\"fullscreen\" loading=\"lazy\"";
                writeln!(body, "<iframe {allowed} title=\"{title}\" srcdoc=\"{page}\"></iframe>")
            }
        };
    }
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n{body}</body>\n</html>\n"
    )
}

fn fact(fact: &Fact) -> String {
    let [name, value, note] = fact.parts().map(escaped);
    format!("<tr><td>{name}</td><td>{value}</td><td class=\"note\">{note}</td></tr>\n")
}

fn table(body: &mut String, table: &Table) -> std::fmt::Result {
    let row = |kind: &str, cells: &mut dyn Iterator<Item = &String>| {
        let class = |align: Align| if align == Align::Right { " class=\"r\"" } else { "" };
        let cell = |(cell, (_, align)): (&String, &(String, Align))| {
            format!("<{kind}{}>{}</{kind}>", class(*align), escaped(cell))
        };
        format!("<tr>{}</tr>\n", cells.zip(table.columns()).map(cell).collect::<String>())
    };
    let head = row("th", &mut table.columns().iter().map(|(name, _)| name));
    let rows: String = table.rows().iter().map(|cells| row("td", &mut cells.iter())).collect();
    writeln!(body, "<div class=\"wide\"><table>\n{head}{rows}</table></div>")
}

/// A page as Markdown, whose drawings are files beside it.
pub fn markdown(page: &Page) -> String {
    let (mut text, mut title) = (String::new(), String::new());
    for block in &page.blocks {
        if !text.is_empty() {
            text.push('\n');
        }
        let _ = match block {
            Block::Title(name, remark) => {
                title = plain(name);
                writeln!(text, "# {title}\n\n{}", plain(remark))
            }
            Block::Heading(name) => writeln!(text, "## {}", plain(name)),
            Block::Subheading(name) => writeln!(text, "### {}", plain(name)),
            Block::Line(line) | Block::Prose(line) => writeln!(text, "{}", by_lines(line.trim(), plain)),
            Block::Notes(word, texts) => {
                texts.iter().try_for_each(|line| writeln!(text, "- {} {}", plain(word), plain(line)))
            }
            Block::Facts(facts) => facts.iter().map(Fact::parts).try_for_each(|[name, value, note]| {
                writeln!(text, "- {}: {} {}", plain(name), plain(value), plain(note))
            }),
            Block::Table(own) => bars(&mut text, own),
            Block::Figure(_, file) => writeln!(text, "![{title}]({file})"),
            // for a browser alone
            Block::Folded(..) | Block::Within(..) => Ok(()),
        };
    }
    text
}

fn bars(text: &mut String, table: &Table) -> std::fmt::Result {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let rule = |align: &Align| if *align == Align::Right { "--:" } else { "---" };
    *text += &line(table.columns().iter().map(|(name, _)| plain(name)).collect());
    *text += &line(table.columns().iter().map(|(_, align)| rule(align).into()).collect());
    table.rows().iter().for_each(|row| *text += &line(row.iter().map(|cell| plain(cell)).collect()));
    Ok(())
}

/// Line by line.
fn by_lines(text: &str, as_shown: fn(&str) -> String) -> String {
    text.split('\n').map(as_shown).collect::<Vec<_>>().join("\n")
}

/// Without what Markdown would read as more than text.
fn plain(text: &str) -> String {
    shown(text).replace('|', "\\|").replace('<', "&lt;")
}

/// A text in which a browser finds no marks: names come from files of anybody.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in shown(text).chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_is_a_mark() {
        let evil = "<script>&\"'";
        let table = Table::new(&format!("{evil} | >b")).filled([[evil, "2"]]);
        let mut page = Page::new();
        page.title(evil, evil).heading(evil).line(evil).facts(vec![Fact::new(evil, evil).note(evil)]).table(table);
        page.subheading(evil).folded(evil, evil);
        let text = html(&page);
        assert!(!text.contains("<script") && text.matches("&lt;script&gt;&amp;&quot;&#39;").count() == 13, "{text}");
        assert!(text.contains("<td class=\"r\">2</td>"));
    }

    #[test]
    fn a_page_within_ends_where_it_ends_and_stands_in_a_sandbox() {
        let mut page = Page::new();
        page.title("a", "b").within("c", "<p title=\"x\">&amp;</p>\"><script>out</script>".into());
        let text = html(&page);
        let (_, rest) = text.split_once("srcdoc=\"").unwrap();
        let (within, after) = rest.split_once('"').unwrap();
        assert_eq!(
            within.replace("&quot;", "\"").replace("&amp;", "&"),
            "<p title=\"x\">&amp;</p>\"><script>out</script>"
        );
        assert!(after.starts_with("></iframe>") && text.contains("sandbox=\"allow-scripts\""));
    }

    #[test]
    fn both_writings_hold_every_part_and_neither_takes_text_for_marks() {
        let table = Table::new("task | >success").filled([["a|b", "<1 %"]]);
        let mut page = Page::new();
        page.title("Title", "remark").heading("Part").line("A line.").table(table);
        page.blocks.push(Block::Figure("<svg></svg>".into(), "curves.svg".into()));
        assert_eq!(
            markdown(&page),
            "# Title\n\nremark\n\n## Part\n\nA line.\n\n| task | success |\n| --- | --: |\n| a\\|b | &lt;1 % |\n\n![Title](curves.svg)\n"
        );
        for part in ["<h1>Title</h1>", "<h2>Part</h2>", "<p>A line.</p>", "&lt;1 %", "<svg></svg>"] {
            assert!(html(&page).contains(part), "{part}: {}", html(&page));
        }
    }
}
