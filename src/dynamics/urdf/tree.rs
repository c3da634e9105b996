//! Links and joints as a tree: one root, no link with two parents, no cycle, every name known and unique.

use super::diagnose::{Lines, place};
use super::fault::{clean, fault, few};
use super::options::ImportOptions;
use base::error::{Error, Result, suggestion};
use roxmltree::{Document, Node};
use std::collections::{HashMap, VecDeque};

/// A link as written.
pub(super) struct LinkSite {
    pub name: String,
    pub line: u32,
    /// Index into [`Tree::joints`]; `None` for the root.
    pub joint: Option<usize>,
}

/// A joint as written; `parent` and `child` index [`Tree::links`].
pub(super) struct JointSite {
    pub name: String,
    pub line: u32,
    pub parent: usize,
    pub child: usize,
    pub kind: String,
}

impl JointSite {
    pub fn is_fixed(&self) -> bool {
        self.kind == "fixed"
    }
}

/// The kinematic tree.
pub(super) struct Tree {
    pub links: Vec<LinkSite>,
    pub joints: Vec<JointSite>,
    /// Every link once, parents before children; the root first.
    pub order: Vec<usize>,
}

const KINDS: [&str; 7] = ["fixed", "revolute", "continuous", "prismatic", "floating", "planar", "spherical"];

/// Reads the tree of a document that [`super::diagnose::check`] has passed.
pub(super) fn read(document: &Document, file: &str, options: &ImportOptions) -> Result<Tree> {
    let robot = document.root_element();
    let of = |tag: &'static str| robot.children().filter(move |n| n.is_element() && n.tag_name().name() == tag);
    let bodies = of("link").count();
    if bodies > options.limits.bodies {
        return Err(Error::limit(
            format!("{file}: number of links"),
            bodies,
            options.limits.bodies,
            "Merge links that move together, or raise InputLimits::bodies.",
        ));
    }
    if bodies == 0 {
        return Err(fault(file, place(robot), "there is no <link>", "Add at least the airframe as a <link>."));
    }
    let lines = Lines::new(document);
    let mut links = Vec::new();
    let mut names = HashMap::new();
    for node in of("link") {
        let name = node.attribute("name").unwrap_or_default();
        if names.insert(name, links.len()).is_some() {
            return Err(fault(file, place(node), format!("a second link is called '{}'", clean(name)), "Rename one."));
        }
        links.push(LinkSite { name: name.to_string(), line: lines.of(node), joint: None });
    }
    let joints = joints(of("joint"), (file, &lines), &names, &mut links)?;
    let order = order(file, &links, &joints)?;
    Ok(Tree { links, joints, order })
}

fn joints<'a, 'b: 'a>(
    nodes: impl Iterator<Item = Node<'a, 'b>>,
    (file, lines): (&str, &Lines),
    names: &HashMap<&str, usize>,
    links: &mut [LinkSite],
) -> Result<Vec<JointSite>> {
    let mut joints: Vec<JointSite> = Vec::new();
    let mut taken = HashMap::new();
    let mut mimics = Vec::new();
    for node in nodes {
        let name = node.attribute("name").unwrap_or_default();
        if taken.insert(name, joints.len()).is_some() {
            return Err(fault(file, place(node), format!("a second joint is called '{}'", clean(name)), "Rename one."));
        }
        let kind = node.attribute("type").unwrap_or_default();
        if !KINDS.contains(&kind) {
            let rule = format!("joint type '{}' is unknown", clean(kind));
            return Err(fault(file, place(node), rule, format!("Use one of {}.", KINDS.join(", "))));
        }
        let parent = end(node, "parent", file, names)?;
        let child = end(node, "child", file, names)?;
        if kind != "fixed" {
            check_axis(node, file)?;
        }
        mimics.extend(node.children().filter(|n| n.has_tag_name("mimic")));
        attach(node, file, links, &joints, child)?;
        joints.push(JointSite { name: name.to_string(), line: lines.of(node), parent, child, kind: kind.to_string() });
    }
    let lost = |n: &&Node| n.attribute("joint").is_some_and(|j| !taken.contains_key(j));
    match mimics.iter().find(lost) {
        None => Ok(joints),
        Some(n) => {
            let rule = format!("it mimics joint '{}', which does not exist", clean(n.attribute("joint").unwrap_or("")));
            Err(fault(file, place(*n), rule, "Name a joint of this file."))
        }
    }
}

/// The link that `<parent>` or `<child>` of a joint names.
fn end(joint: Node, tag: &str, file: &str, names: &HashMap<&str, usize>) -> Result<usize> {
    let node = joint.children().find(|n| n.has_tag_name(tag)).unwrap_or(joint);
    let link = node.attribute("link").unwrap_or_default();
    names.get(link).copied().ok_or_else(|| {
        let mut known: Vec<String> = names.keys().map(|s| s.to_string()).collect();
        known.sort();
        let near = suggestion(link, &known);
        let rule = format!("the {tag} link '{}' does not exist{}", clean(link), clean(&near));
        fault(file, place(node), rule, "Correct the name, or add the link.")
    })
}

/// Records that `joint` carries `child`, which may have no other parent.
fn attach(joint: Node, file: &str, links: &mut [LinkSite], joints: &[JointSite], child: usize) -> Result<()> {
    let Some(link) = links.get_mut(child) else { return Ok(()) };
    if let Some(other) = link.joint.and_then(|i| joints.get(i)) {
        let rule =
            format!("link '{}' has two parents: joint '{}' carries it too", clean(&link.name), clean(&other.name));
        return Err(fault(
            file,
            place(joint),
            rule,
            "A link hangs on one joint: remove the other, or rename the child.",
        ));
    }
    link.joint = Some(joints.len());
    Ok(())
}

fn check_axis(joint: Node, file: &str) -> Result<()> {
    let Some(node) = joint.children().find(|n| n.has_tag_name("axis")) else { return Ok(()) };
    let xyz = super::diagnose::numbers(file, node, "xyz", node.attribute("xyz").unwrap_or_default(), 3)?;
    if xyz.iter().map(|x| x * x).sum::<f64>().sqrt() > 1e-9 {
        return Ok(());
    }
    let value = clean(node.attribute("xyz").unwrap_or_default());
    Err(fault(file, place(node), format!("the axis '{value}' has no direction"), "Give it a length: \"0 0 1\" is up."))
}

/// Breadth first from the only root.
fn order(file: &str, links: &[LinkSite], joints: &[JointSite]) -> Result<Vec<usize>> {
    let roots: Vec<usize> = (0..links.len()).filter(|i| links.get(*i).is_some_and(|l| l.joint.is_none())).collect();
    let name = |i: usize| links.get(i).map_or("", |l| l.name.as_str());
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); links.len()];
    for joint in joints {
        if let Some(list) = children.get_mut(joint.parent) {
            list.push(joint.child);
        }
    }
    let mut order = Vec::with_capacity(links.len());
    let mut reached = vec![false; links.len()];
    let mut queue: VecDeque<usize> = roots.iter().copied().collect();
    while let Some(i) = queue.pop_front() {
        order.push(i);
        if let Some(flag) = reached.get_mut(i) {
            *flag = true;
        }
        queue.extend(children.get(i).into_iter().flatten());
    }
    if order.len() < links.len() {
        let lost = reached.iter().position(|r| !r).unwrap_or(0);
        let line = links.get(lost).map_or(0, |l| l.line);
        let rule = format!("link '{}' hangs on itself through its joints (a cycle)", clean(name(lost)));
        return Err(fault(
            file,
            format!("line {line}, link '{}'", clean(name(lost))),
            rule,
            "Remove a joint of the cycle.",
        ));
    }
    if let [_, second, ..] = roots.as_slice() {
        let all: Vec<&str> = roots.iter().map(|i| name(*i)).collect();
        let line = links.get(*second).map_or(0, |l| l.line);
        let place = format!("line {line}, link '{}'", clean(name(*second)));
        let rule = format!("there are {} roots ({}), but a vehicle has one", all.len(), few(&all));
        return Err(fault(file, place, rule, "Join the links with fixed joints."));
    }
    Ok(order)
}
