//! Parts and joints as a tree, or an error that names what is not one.

use super::joint_spec::{JointKind, JointSpec, Servo, WORLD};
use super::{Assembly, Solid};
use base::error::{Error, Result, finite};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Most parts of one assembly.
pub const MAX_PARTS: usize = 4096;

/// The tree of an assembly.
#[derive(Debug)]
pub(super) struct Tree {
    /// Per part its joint, `None` for the floating root.
    pub carrier: Vec<Option<usize>>,
    /// Per joint its parent part, `None` for the world, and its child.
    pub ends: Vec<(Option<usize>, usize)>,
    /// Every part once, parents before children, depth first.
    pub order: Vec<usize>,
}

/// Checks names, numbers and shape of the graph.
pub(super) fn connect(assembly: &Assembly) -> Result<Tree> {
    check_names(assembly)?;
    for (name, solid) in &assembly.parts {
        check_part(assembly, name, solid)?;
    }
    assembly.joins.iter().try_for_each(|join| check_join(assembly, join))?;
    let ends = ends(assembly)?;
    let carrier = carriers(assembly, &ends)?;
    no_cycle(assembly, &carrier, &ends)?;
    one_root(assembly, &carrier)?;
    Ok(Tree { order: order(&carrier, &ends), carrier, ends })
}

fn check_names(assembly: &Assembly) -> Result<()> {
    let n = assembly.parts.len();
    if n == 0 || n > MAX_PARTS {
        let what = format!("{}: number of parts", assembly.label());
        return Err(Error::limit(what, n, format!("1 to {MAX_PARTS}"), "Add the parts that move."));
    }
    let parts = assembly.parts.iter().map(|(name, _)| name.as_str());
    for (kind, names) in
        [("part", parts.collect::<Vec<_>>()), ("joint", assembly.joins.iter().map(|j| j.name.as_str()).collect())]
    {
        let mut seen = BTreeSet::new();
        for name in names {
            if name.is_empty() || (kind == "part" && name == WORLD) {
                let what = format!("{}: name of a {kind}", assembly.label());
                return Err(Error::value(what, format!("'{name}'"), "neither empty nor 'world'", "Rename it."));
            }
            if !seen.insert(name) {
                let what = format!("{}: {kind} '{name}'", assembly.label());
                return Err(Error::value(what, "there twice", "there once", "Rename one of them."));
            }
        }
    }
    Ok(())
}

fn check_part(assembly: &Assembly, name: &str, solid: &Solid) -> Result<()> {
    solid.validate(&format!("{}: part '{name}'", assembly.label()))
}

fn check_join(assembly: &Assembly, join: &JointSpec) -> Result<()> {
    let at = |what: &str| format!("{}: joint '{}': {what}", assembly.label(), join.name);
    join.at.validate(&at("place in the parent"))?;
    join.child_at.validate(&at("place in the child"))?;
    let axes: &[(&str, [f64; 3])] = match &join.kind {
        JointKind::Fixed | JointKind::Floating | JointKind::Ball => &[],
        JointKind::Revolute(axis) | JointKind::Prismatic(axis) => &[("axis", *axis)],
        JointKind::Universal(first, second) => &[("first axis", *first), ("second axis", *second)],
    };
    for (what, axis) in axes {
        finite(&at(what), axis)?;
        if Vector3::from(*axis).norm() < 1e-9 {
            let remedy = "Give the direction the joint moves along: [0, 0, 1] is up.";
            return Err(Error::value(at(what), format!("{axis:?}"), "longer than 1e-9", remedy));
        }
    }
    if let JointKind::Universal(first, second) = join.kind {
        let sine = Vector3::from(first).normalize().cross(&Vector3::from(second).normalize()).norm();
        if sine < 1e-3 {
            let remedy = "Use one hinge, or axes across each other.";
            return Err(Error::value(at("second axis"), format!("{second:?}"), "across the first", remedy));
        }
    }
    if join.kind == JointKind::Floating && join.parent != WORLD {
        let remedy = "Only the world lets a part float: leave the joint out, or give the part a model of its own.";
        return Err(Error::value(at("parent"), format!("'{}'", join.parent), "'world' of a floating joint", remedy));
    }
    if !matches!(join.kind, JointKind::Revolute(_) | JointKind::Prismatic(_) | JointKind::Universal(..)) {
        for (what, given) in [("range", join.stops.is_some()), ("servo", join.servo.is_some())] {
            if given {
                let remedy = "Use hinges where a range or a motor matters.";
                return Err(Error::value(at(what), "given", "absent on a fixed, floating or ball joint", remedy));
            }
        }
    }
    check_servo(assembly, join)
}

/// What [`Model::new`](crate::tree::Model::new) cannot see any more.
fn check_servo(assembly: &Assembly, join: &JointSpec) -> Result<()> {
    let at = |what: &str| format!("{}: joint '{}': {what}", assembly.label(), join.name);
    let max_torque = match join.servo {
        None => return Ok(()),
        Some(Servo::Rate { time_constant, max_torque, .. }) => {
            if !(1e-6..=1e6).contains(&time_constant) {
                let remedy = "Give the lag of the real servo.";
                return Err(Error::value(at("servo: time_constant"), time_constant, "between 1e-6 and 1e6 s", remedy));
            }
            max_torque
        }
        Some(Servo::Position { max_torque, .. }) => max_torque,
    };
    if max_torque > 0.0 && max_torque.is_finite() {
        return Ok(());
    }
    let remedy = "Every servo has a limit: give the largest torque of the real one.";
    Err(Error::value(at("servo: max_torque"), max_torque, "> 0 and finite", remedy))
}

fn ends(assembly: &Assembly) -> Result<Vec<(Option<usize>, usize)>> {
    let mut ends = Vec::with_capacity(assembly.joins.len());
    for join in &assembly.joins {
        let parent = if join.parent == WORLD { None } else { Some(assembly.number(&join.parent)?) };
        ends.push((parent, assembly.number(&join.child)?));
    }
    Ok(ends)
}

/// The joint that carries each part.
fn carriers(assembly: &Assembly, ends: &[(Option<usize>, usize)]) -> Result<Vec<Option<usize>>> {
    let mut carrier: Vec<Option<usize>> = vec![None; assembly.parts.len()];
    for (number, (_, child)) in ends.iter().enumerate() {
        if let Some(first) = carrier[*child] {
            let [first, second] = [first, number].map(|j| &assembly.joins[j].name);
            let what = format!("{}: part '{}'", assembly.label(), assembly.parts[*child].0);
            let value = format!("carried by the joints '{first}' and '{second}'");
            let remedy = "Two carriers close a loop, which a tree has none of: remove one, or swap parent and child.";
            return Err(Error::value(what, value, "the child of one joint", remedy));
        }
        carrier[*child] = Some(number);
    }
    Ok(carrier)
}

/// Every part leads to the world or to a root by its parents.
fn no_cycle(assembly: &Assembly, carrier: &[Option<usize>], ends: &[(Option<usize>, usize)]) -> Result<()> {
    let parent = |part: usize| carrier[part].and_then(|j| ends[j].0);
    for start in 0..carrier.len() {
        let mut at = Some(start);
        let mut steps = 0;
        while let Some(part) = at {
            if steps > carrier.len() {
                // after that many steps the walk is on the cycle itself
                let mut names = vec![assembly.parts[part].0.as_str()];
                let mut next = parent(part);
                while let Some(p) = next.filter(|p| *p != part) {
                    names.push(&assembly.parts[p].0);
                    next = parent(p);
                }
                let what = format!("{}: part '{}'", assembly.label(), names[0]);
                let value = format!("its own ancestor (cycle {})", names.join(" < "));
                return Err(Error::value(what, value, "below other parts only", "Remove a joint of the cycle."));
            }
            (at, steps) = (parent(part), steps + 1);
        }
    }
    Ok(())
}

/// One floating part, or a joint to the world under everything.
fn one_root(assembly: &Assembly, carrier: &[Option<usize>]) -> Result<()> {
    let name = |part: usize| assembly.parts[part].0.as_str();
    let roots: Vec<usize> = (0..carrier.len()).filter(|part| carrier[*part].is_none()).collect();
    let grounded = assembly.joins.iter().find(|j| j.parent == WORLD);
    let (lost, other) = match (roots.as_slice(), grounded) {
        ([lost, ..], Some(join)) => (*lost, format!("'{}' is held by the world", join.child)),
        ([first, lost, ..], None) => (*lost, format!("'{}' is a root already", name(*first))),
        _ => return Ok(()),
    };
    let what = format!("{}: part '{}'", assembly.label(), name(lost));
    let remedy = "Join it to the others, or float both on 'world'.";
    Err(Error::value(what, "a root without joint", format!("joined, since {other}"), remedy))
}

/// Depth first, children in the order of their joints.
fn order(carrier: &[Option<usize>], ends: &[(Option<usize>, usize)]) -> Vec<usize> {
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); carrier.len()];
    let mut roots: Vec<usize> = (0..carrier.len()).filter(|part| carrier[*part].is_none()).collect();
    for (parent, child) in ends {
        match parent {
            Some(parent) => children[*parent].push(*child),
            None => roots.push(*child),
        }
    }
    let mut order = Vec::with_capacity(carrier.len());
    let mut stack: Vec<usize> = roots.into_iter().rev().collect();
    while let Some(part) = stack.pop() {
        order.push(part);
        stack.extend(children[part].iter().rev());
    }
    order
}
