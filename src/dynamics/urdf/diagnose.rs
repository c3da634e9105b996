//! The text against the schema: what is missing, doubled, not a number, or unknown, each with its line.
//!
//! urdf-rs drops unknown elements, skips words that are not numbers (`xyz="0 x 0 0"` reads as three zeros) and fills
//! in what is missing. So the file is judged here, on the plain XML tree, before urdf-rs reads it.

use super::Warning;
use super::fault::{clean, fault};
use super::input_limits::InputLimits;
use super::options::ImportOptions;
use super::schema::{self, Kind, LARGEST, Rule, Times};
use base::error::{Error, Result};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Parses the fenced text.
pub(super) fn parse<'a>(text: &'a str, file: &str) -> Result<Document<'a>> {
    let options = roxmltree::ParsingOptions { allow_dtd: false, ..Default::default() };
    Document::parse_with_options(text, options).map_err(|e| {
        let place = format!("line {}", e.pos().row);
        fault(file, place, format!("it is not well-formed XML ({})", clean_long(&e.to_string())), "Correct the markup.")
    })
}

fn clean_long(text: &str) -> String {
    text.chars().take(300).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// `line 12, <mass> of link 'base'`.
pub(super) fn place(node: Node) -> String {
    format!("line {}, {}", line(node), element(node))
}

/// 1-based line of an element; reads the text up to it, so it is for errors (one per import).
fn line(node: Node) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// Lines of many elements, from one pass over the text.
pub(super) struct Lines(Vec<usize>);

impl Lines {
    pub fn new(document: &Document) -> Self {
        Self(document.input_text().bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i).collect())
    }

    /// 1-based line of an element.
    pub fn of(&self, node: Node) -> u32 {
        let breaks = self.0.partition_point(|i| *i < node.range().start);
        u32::try_from(breaks + 1).unwrap_or(u32::MAX)
    }
}

fn element(node: Node) -> String {
    let tag = node.tag_name().name();
    let owner =
        node.ancestors().find(|n| matches!(n.tag_name().name(), "link" | "joint") && n.attribute("name").is_some());
    match owner.and_then(|n| Some((n, n.attribute("name")?))) {
        Some((owner, name)) if owner == node => format!("{tag} '{}'", clean(name)),
        Some((owner, name)) => format!("<{}> of {} '{}'", clean(tag), owner.tag_name().name(), clean(name)),
        None => format!("<{}>", clean(tag)),
    }
}

/// Checks the whole document; the first defect is the error, oddities are the warnings.
pub(super) fn check(document: &Document, file: &str, options: &ImportOptions) -> Result<Vec<Warning>> {
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        let rule = format!("the root element is <{}>", clean(root.tag_name().name()));
        return Err(fault(file, place(root), rule, "A URDF's root element is <robot name=\"…\">."));
    }
    let mut diagnosis = Diagnosis { file, options, kinds: BTreeMap::new(), lines: Lines::new(document) };
    let mut stack = vec![root];
    while let Some(node) = stack.pop() {
        if let Some(rule) = schema::find(node.tag_name().name()) {
            diagnosis.attributes(node, rule)?;
            diagnosis.children(node, rule, &mut stack)?;
        }
    }
    Ok(diagnosis.warnings())
}

/// Kinds of oddities that are told apart.
const MOST_KINDS: usize = 64;

/// First line, count, rule and remedy of one kind of oddity.
struct Oddity {
    line: u32,
    count: usize,
    rule: String,
    remedy: &'static str,
}

struct Diagnosis<'a> {
    file: &'a str,
    options: &'a ImportOptions,
    kinds: BTreeMap<String, Oddity>,
    lines: Lines,
}

impl Diagnosis<'_> {
    /// Counts an oddity of one kind; the first occurrence (documents are walked in order) gives line and rule.
    fn odd(&mut self, node: Node, kind: String, rule: impl Into<String>, remedy: &'static str) {
        let full = self.kinds.len() >= MOST_KINDS && !self.kinds.contains_key(&kind);
        let kind = if full { "further elements".to_string() } else { kind };
        let line = self.lines.of(node);
        let oddity = self.kinds.entry(kind).or_insert_with(|| Oddity {
            line,
            count: 0,
            rule: if full { "odd in other ways".into() } else { rule.into() },
            remedy: if full { "Correct the ones above first." } else { remedy },
        });
        oddity.count += 1;
    }

    fn fault(&self, node: Node, rule: impl Into<String>, remedy: impl Into<String>) -> Error {
        fault(self.file, place(node), rule, remedy)
    }

    fn attributes(&mut self, node: Node, rule: &'static Rule) -> Result<()> {
        for (name, _, required) in rule.attributes {
            if *required && node.attribute(*name).is_none() {
                return Err(self.fault(node, format!("attribute '{name}' is missing"), format!("Add {name}=\"…\".")));
            }
        }
        for attribute in node.attributes() {
            let name = attribute.name();
            match rule.attributes.iter().find(|row| row.0 == name) {
                _ if rule.element == "properties" => {}
                Some((_, kind, _)) => self.content(node, name, attribute.value(), *kind)?,
                None => {
                    let kind = format!("<{} {}>", rule.element, clean(name));
                    self.odd(node, kind, "unknown attribute", "It is ignored: remove it, or check its spelling.");
                }
            }
        }
        self.particulars(node)
    }

    fn content(&mut self, node: Node, name: &str, value: &str, kind: Kind) -> Result<()> {
        match kind {
            Kind::Text => {
                if is_xacro(value) {
                    let rule = format!("{name} '{}' holds an expression that nobody expanded", clean(value));
                    self.odd(node, "xacro".into(), rule, "It is taken as it stands: run xacro, and import its output.");
                }
                text(self.file, node, name, value, &self.options.limits)
            }
            Kind::Numbers(count) => {
                let numbers = numbers(self.file, node, name, value, count)?;
                match numbers.iter().find(|x| x.abs() > LARGEST) {
                    None => Ok(()),
                    Some(x) => Err(Error::limit(
                        format!("{}: {}: {name}", self.file, place(node)),
                        format!("{x:e}"),
                        format!("±{LARGEST:e}"),
                        "Nothing that flies is as large: check the units (m, kg, kg m², rad).",
                    )),
                }
            }
            Kind::Loose => numbers(self.file, node, name, value, 1).map(drop),
        }
    }

    /// What the table cannot say: angles in degrees, transposed products of inertia, mesh paths.
    fn particulars(&mut self, node: Node) -> Result<()> {
        let degrees = |v: &str| v.split_whitespace().filter_map(|w| w.parse().ok()).any(|x: f64| x.abs() > TAU);
        if node.attribute("rpy").is_some_and(degrees) {
            let value = clean(node.attribute("rpy").unwrap_or_default());
            self.odd(
                node,
                "<origin rpy>".into(),
                format!("an angle beyond 2π ('{value}')"),
                "URDF angles are radians: \
                     if these are degrees, convert them. Read as radians.",
            );
        }
        for (transposed, own) in [("iyx", "ixy"), ("izx", "ixz"), ("izy", "iyz")] {
            let number = |name| node.attribute(name).and_then(|v| v.trim().parse::<f64>().ok());
            if let (Some(a), Some(b)) = (number(transposed), number(own))
                && a != b
            {
                let rule = format!("inertia is not symmetric: {transposed} = {a}, but {own} = {b}");
                return Err(self.fault(node, rule, format!("Remove {transposed}, or make both equal.")));
            }
        }
        let tag = node.tag_name().name();
        if matches!(tag, "calibration" | "safety_controller") {
            let remedy = "Its content has no effect here.";
            self.odd(node, format!("<{tag}> in <joint>"), "this element is not used by the import", remedy);
        }
        self.versioned(node)?;
        match node.attribute("filename") {
            Some(path) if matches!(node.tag_name().name(), "mesh" | "texture") => self.path(node, path),
            _ => Ok(()),
        }
    }

    /// What depends on the version of the format.
    fn versioned(&mut self, node: Node) -> Result<()> {
        let version = version(node.document().root_element());
        if node.has_tag_name("limit") && version < (1, 2) && node.attribute("velocity").is_none() {
            let rule = "attribute 'velocity' is missing (it may be left out from version 1.2 on)";
            return Err(self.fault(node, rule, "Add velocity=\"…\"."));
        }
        if node.attribute("quat_xyzw").is_some() && version < (1, 1) {
            let rule = "quat_xyzw is read only from version 1.1 on";
            let remedy = "It is ignored: write rpy, or <robot version=\"1.1\" …>.";
            self.odd(node, "<origin quat_xyzw>".into(), rule, remedy);
        }
        Ok(())
    }

    fn path(&mut self, node: Node, path: &str) -> Result<()> {
        let leaves = |p: &str| p.split(['/', '\\']).any(|part| part == "..");
        let kind = |what: &str| format!("<{}> {what}", node.tag_name().name());
        if let Some((package, rest)) = path.strip_prefix("package://").map(|p| p.split_once('/').unwrap_or((p, ""))) {
            let known = self.options.packages.contains_key(package);
            if !known {
                let rule = format!("'package://{}' is not resolved", clean(package));
                self.odd(
                    node,
                    kind(&format!("package://{}", clean(package))),
                    rule,
                    "Meshes are not needed to fly; --package NAME=DIR (ImportOptions::packages) silences this.",
                );
            } else if leaves(rest) {
                let rule = format!("the path '{}' leaves its package", clean(path));
                self.odd(node, kind("filename"), rule, "It is not opened: move the mesh into the package.");
            }
        } else if path.contains("://") || path.starts_with(['/', '\\']) || path.get(1..2) == Some(":") || leaves(path) {
            let rule = format!("the path '{}' lies outside the file's folder", clean(path));
            self.odd(node, kind("filename"), rule, "It is not opened: move the mesh beside the URDF.");
        }
        Ok(())
    }

    fn children<'a, 'b>(
        &mut self,
        node: Node<'a, 'b>,
        rule: &'static Rule,
        stack: &mut Vec<Node<'a, 'b>>,
    ) -> Result<()> {
        let mut counts = vec![0usize; rule.children.len()];
        let first = stack.len();
        for child in node.children().filter(Node::is_element) {
            let tag = child.tag_name();
            if tag.namespace().is_some_and(|space| space.contains("xacro")) {
                let remedy = "Run xacro yourself and import its output: an import starts no process.";
                return Err(self.fault(child, format!("xacro:{} is not expanded", clean(tag.name())), remedy));
            }
            let row = rule.children.iter().zip(&mut counts).find(|((name, _), _)| *name == tag.name());
            match row {
                Some(((name, Times::Unused), _)) => self.odd(
                    child,
                    format!("<{name}> in <{}>", rule.element),
                    "this element is not used by the import",
                    "Its content has no effect here.",
                ),
                Some(_) if tag.namespace().is_some() => {
                    return Err(self.fault(child, "a URDF element in a foreign namespace", "Remove the xmlns."));
                }
                Some(((name, times), count)) => {
                    *count += 1;
                    if *count > 1 && *times != Times::Many {
                        let rule = format!("a second <{name}> in one <{}>", rule.element);
                        return Err(self.fault(child, rule, "Keep one of them."));
                    }
                    stack.push(child);
                }
                None => self.odd(
                    child,
                    format!("<{}> in <{}>", clean(tag.name()), rule.element),
                    "unknown element",
                    "It is ignored with its content: remove it, or check its spelling.",
                ),
            }
        }
        stack.get_mut(first..).unwrap_or_default().reverse();
        self.required(node, rule, &counts)
    }

    fn required(&self, node: Node, rule: &'static Rule, counts: &[usize]) -> Result<()> {
        let missing =
            rule.children.iter().zip(counts).find(|((_, times), count)| *times == Times::Once && **count == 0);
        if let Some(((name, _), _)) = missing {
            return Err(self.fault(node, format!("<{name}> is missing"), format!("Add <{name} …/> inside it.")));
        }
        if rule.element == "geometry" && counts.iter().sum::<usize>() != 1 {
            let rule = format!("it holds {} shapes, but it must hold one", counts.iter().sum::<usize>());
            return Err(self.fault(node, rule, "Use one of box, cylinder, capsule, sphere, mesh."));
        }
        Ok(())
    }

    fn warnings(self) -> Vec<Warning> {
        let file = self.file;
        let mut warnings: Vec<Warning> = self
            .kinds
            .into_iter()
            .map(|(element, odd)| Warning {
                file: file.to_string(),
                line: Some(odd.line),
                element,
                rule: if odd.count == 1 { odd.rule } else { format!("{}, {} times", odd.rule, odd.count) },
                remedy: odd.remedy.to_string(),
            })
            .collect();
        warnings.sort_by_key(|w| w.line);
        warnings
    }
}

/// The `version` attribute of `<robot>`; 1.0 where it is absent or odd, as urdfdom reads it.
fn version(robot: Node) -> (u32, u32) {
    let parts = robot.attribute("version").and_then(|v| v.trim().split_once('.'));
    parts.and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?))).unwrap_or((1, 0))
}

/// Checks a name or path for length and emptiness.
fn text(file: &str, node: Node, name: &str, value: &str, limits: &InputLimits) -> Result<()> {
    if value.len() > limits.name_bytes {
        return Err(Error::limit(
            format!("{file}: line {}, <{}>: length of {name}", line(node), node.tag_name().name()),
            format!("{} bytes", value.len()),
            format!("{} bytes", limits.name_bytes),
            "Shorten the name, or raise InputLimits::name_bytes.",
        ));
    }
    let needed = matches!(node.tag_name().name(), "link" | "joint" | "parent" | "child") && name != "type";
    if needed && value.trim() != value {
        let rule = format!("{name} '{}' has blanks at its ends", clean(value));
        return Err(fault(file, place(node), rule, "Remove the blanks."));
    }
    if needed && value.is_empty() {
        return Err(fault(file, place(node), format!("{name} is empty"), "Give it a name."));
    }
    Ok(())
}

/// Whether a text holds what xacro would have replaced.
fn is_xacro(text: &str) -> bool {
    text.contains("${") || text.contains("$(")
}

/// Reads exactly `count` finite numbers from an attribute.
pub(super) fn numbers(file: &str, node: Node, name: &str, value: &str, count: usize) -> Result<Vec<f64>> {
    let mut numbers = Vec::with_capacity(count);
    for word in value.split_whitespace().take(count + 1) {
        match word.parse::<f64>() {
            Ok(x) if x.is_finite() => numbers.push(x),
            Ok(x) => {
                let remedy = "Write a finite number in SI units.";
                return Err(fault(file, place(node), format!("{name} is {x}, but it must be finite"), remedy));
            }
            Err(_) => {
                let rule = format!("{name} holds '{}', which is not a number", clean(word));
                return Err(fault(file, place(node), rule, plain_numbers(value, count)));
            }
        }
    }
    if numbers.len() == count {
        return Ok(numbers);
    }
    let rule = format!("{name}=\"{}\" must hold {count} number{}", clean(value), if count == 1 { "" } else { "s" });
    Err(fault(file, place(node), rule, "Correct the count."))
}

/// How to write `count` numbers, for whoever wrote `value`.
fn plain_numbers(value: &str, count: usize) -> &'static str {
    let read = |points: &str, blanks: &[char]| {
        let text = value.replace(blanks, " ").replace(points, ".");
        let mut words = text.split_whitespace();
        words.by_ref().take(count).filter(|word| word.parse::<f64>().is_ok()).count() == count && words.next().is_none()
    };
    if is_xacro(value) {
        "It is an expression of xacro, which nobody expanded: run xacro, and import its output. Write plain numbers."
    } else if read(".", &[',', ';']) {
        "Write plain numbers, separated by blanks, not by commas or semicolons."
    } else if read(",", &[';']) {
        "Write plain numbers, with a decimal point, not a comma, and separated by blanks."
    } else {
        "Write plain numbers, separated by blanks."
    }
}
