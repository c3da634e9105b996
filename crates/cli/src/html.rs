//! A page for a browser or a printer: one file that asks no other file for anything, and has no scripts but those of pages within.

use super::page::{Fact, shown};
use super::table::{Align, Table};
use std::fmt::Write;

/// Looks: dark text on white in one column, tables that stay whole on a printed page.
const STYLE: &str = "\
body{font:14px/1.45 system-ui,sans-serif;color:#212529;background:#fff;max-width:1000px;margin:2em auto;padding:0 1em}\
h1{font-size:1.6em;margin:0}h2{font-size:1.15em;margin:1.8em 0 .5em;border-bottom:1px solid #dee2e6}\
p{margin:.4em 0}.remark,td.note{color:#5b6168}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
td,th{padding:.15em .9em .15em 0;text-align:left;vertical-align:top}th{border-bottom:1px solid #adb5bd}\
td{white-space:nowrap}td.note,td:last-child:not(.r){white-space:normal}.r{text-align:right}.wide{overflow-x:auto}figure{margin:1em 0}svg{max-width:100%;height:auto}\
h3{font-size:1em;margin:1.2em 0 .3em}pre{background:#f6f8fa;padding:.6em .9em;overflow-x:auto}summary{cursor:pointer}\
iframe{display:block;width:100%;height:560px;border:1px solid #dee2e6;border-radius:6px}\
@media print{body{margin:0;max-width:none;font-size:11px}table,figure{break-inside:avoid}h2{break-after:avoid}iframe{display:none}}";

/// A page that is filled from above.
pub struct Html {
    title: String,
    body: String,
}

impl Html {
    /// With a title, and a remark below it.
    pub fn new(title: &str, remark: &str) -> Self {
        let (title, remark) = (escaped(title), escaped(remark));
        Self { body: format!("<h1>{title}</h1>\n<p class=\"remark\">{remark}</p>\n"), title }
    }

    /// A heading.
    pub fn heading(&mut self, name: &str) -> &mut Self {
        let _ = writeln!(self.body, "<h2>{}</h2>", escaped(name));
        self
    }

    /// A paragraph.
    pub fn line(&mut self, text: &str) -> &mut Self {
        let _ = writeln!(self.body, "<p>{}</p>", escaped(text));
        self
    }

    /// Names, values and remarks in three columns.
    pub fn facts(&mut self, facts: &[Fact]) -> &mut Self {
        self.body += "<table>\n";
        for fact in facts {
            let [name, value, note] = fact.parts().map(escaped);
            let _ = writeln!(self.body, "<tr><td>{name}</td><td>{value}</td><td class=\"note\">{note}</td></tr>");
        }
        self.body += "</table>\n";
        self
    }

    /// A table.
    pub fn table(&mut self, table: &Table) -> &mut Self {
        let class = |align: Align| if align == Align::Right { " class=\"r\"" } else { "" };
        self.body += "<div class=\"wide\"><table>\n<tr>";
        for (name, align) in table.columns() {
            let _ = write!(self.body, "<th{}>{}</th>", class(*align), escaped(name));
        }
        self.body += "</tr>\n";
        for row in table.rows() {
            self.body += "<tr>";
            for (cell, (_, align)) in row.iter().zip(table.columns()) {
                let _ = write!(self.body, "<td{}>{}</td>", class(*align), escaped(cell));
            }
            self.body += "</tr>\n";
        }
        self.body += "</table></div>\n";
        self
    }

    /// A drawing: an SVG document as [`Figure::svg`](omnidrones_plot::Figure::svg) makes it, which escapes its own texts.
    pub fn figure(&mut self, svg: &str) -> &mut Self {
        let _ = writeln!(self.body, "<figure>{}</figure>", svg.trim());
        self
    }

    /// A heading of less weight.
    pub fn subheading(&mut self, name: &str) -> &mut Self {
        let _ = writeln!(self.body, "<h3>{}</h3>", escaped(name));
        self
    }

    /// A text of a file as it is, folded away behind a word.
    pub fn folded(&mut self, summary: &str, text: &str) -> &mut Self {
        let text: String = text.lines().map(|line| escaped(line) + "\n").collect();
        let _ = writeln!(self.body, "<details><summary>{}</summary><pre>{text}</pre></details>", escaped(summary));
        self
    }

    /// Another whole page within this one, whose scripts see nothing of it.
    pub fn within(&mut self, title: &str, page: &str) -> &mut Self {
        let (title, page) = (escaped(title), page.replace('&', "&amp;").replace('"', "&quot;"));
        let _ = writeln!(
            self.body,
            "<iframe sandbox=\"allow-scripts\" allow=\"fullscreen\" loading=\"lazy\" title=\"{title}\" srcdoc=\"{page}\"></iframe>"
        );
        self
    }

    /// The whole file.
    pub fn finish(&self) -> String {
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width\">\n<title>{}</title>\n<style>{STYLE}</style>\n</head>\n\
             <body>\n{}</body>\n</html>\n",
            self.title, self.body
        )
    }
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
        let mut table = Table::new(&[(evil, Align::Left), ("b", Align::Right)]);
        table.row([evil, "2"]);
        let mut page = Html::new(evil, evil);
        page.heading(evil).line(evil).facts(&[Fact::new(evil, evil).note(evil)]).table(&table);
        page.subheading(evil).folded(evil, evil);
        let text = page.finish();
        assert!(!text.contains("<script") && text.matches("&lt;script&gt;&amp;&quot;&#39;").count() == 13, "{text}");
        assert!(text.contains("<td class=\"r\">2</td>"));
    }

    #[test]
    fn a_page_within_ends_where_it_ends_and_stands_in_a_sandbox() {
        let mut page = Html::new("a", "b");
        page.within("c", "<p title=\"x\">&amp;</p>\"><script>out</script>");
        let text = page.finish();
        let (_, rest) = text.split_once("srcdoc=\"").unwrap();
        let (within, after) = rest.split_once('"').unwrap();
        assert_eq!(
            within.replace("&quot;", "\"").replace("&amp;", "&"),
            "<p title=\"x\">&amp;</p>\"><script>out</script>"
        );
        assert!(after.starts_with("></iframe>") && text.contains("sandbox=\"allow-scripts\""));
    }
}
