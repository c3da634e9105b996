//! What is seen, in groups: which numbers belong together, how they lie, where they stand.
//!
//! Groups are names for columns of arrays that are there, so those who read whole rows need not know them.

use super::env::Spec;
use super::observation::ObservationTransform;
use super::task_spec::{Field, FieldLayout, total};
use base::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What the numbers of a group are, and in which array they stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GroupKind {
    /// What an agent sees, in a row of the observation.
    Actor,
    /// What critics may see, in a row of the central state.
    Critic,
    /// What policies do not see, in a row of the privileged numbers.
    Privileged,
    /// Pixels, in a row of the observation.
    Image,
    /// Distances along beams, in a row of the observation.
    Lidar,
}

/// How a number is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Dtype {
    /// Single precision.
    F32,
}

/// Numbers that belong together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Group {
    /// `actor`, `critic`, `privileged`, `history`, `past`, `parameters`, or the field's.
    pub name: String,
    /// What they are.
    pub kind: GroupKind,
    /// Axes from the slowest to the fastest: `[n]`, `[steps, n]`, `[height, width, channels]`.
    pub shape: Vec<usize>,
    /// How a number is kept.
    pub dtype: Dtype,
    /// Columns of the array of the kind.
    pub columns: Range<usize>,
}

impl Group {
    fn new(name: &str, kind: GroupKind, shape: Vec<usize>, first: usize) -> Self {
        let n: usize = shape.iter().product();
        Self { name: name.into(), kind, shape, dtype: Dtype::F32, columns: first..first + n }
    }

    /// Of a field whose columns begin at `first`.
    fn of_field(field: &Field, first: usize) -> Self {
        let kind = match field.layout {
            FieldLayout::Image { .. } => GroupKind::Image,
            FieldLayout::Lidar { .. } => GroupKind::Lidar,
            FieldLayout::Vector | FieldLayout::Members { .. } => GroupKind::Actor,
        };
        Self::new(&field.name, kind, field.layout.shape(field.size), first)
    }
}

impl Spec {
    /// All of them: `actor` is the whole observation of an agent, `critic` the central state and `privileged` the numbers
    /// that differ between environments, where there are any; `history` is the block `[steps, n]` of a stage of that name,
    /// newest first, and `past` what it holds beside the newest; `parameters` is what a stage `privileged` shows; images and
    /// lidars go by the names of their fields.
    pub fn groups(&self) -> Vec<Group> {
        let mut groups = vec![Group::new("actor", GroupKind::Actor, vec![self.n_observation], 0)];
        for (name, kind, n) in [
            ("critic", GroupKind::Critic, self.n_central),
            ("privileged", GroupKind::Privileged, self.privileged.len()),
        ] {
            if n > 0 {
                groups.push(Group::new(name, kind, vec![n], 0));
            }
        }
        let Stages { history, parameters } = self.stages();
        if let Some([steps, n]) = history {
            groups.push(Group::new("history", GroupKind::Actor, vec![steps, n], 0));
            groups.push(Group::new("past", GroupKind::Actor, vec![steps - 1, n], n));
        }
        groups.extend(parameters.map(|own| Group::new("parameters", GroupKind::Actor, vec![own.len()], own.start)));
        groups.extend(self.fields().filter(|own| matches!(own.kind, GroupKind::Image | GroupKind::Lidar)));
        groups
    }

    /// The group of that name, or the field of the observation.
    ///
    /// # Errors
    /// [`Error::Unknown`] with the nearest; [`Error::Value`] for a group that is empty.
    pub fn group(&self, name: &str) -> Result<Group> {
        let all = || self.groups().into_iter().chain(self.fields());
        all().find(|own| own.name == name).ok_or_else(|| match name {
            "parameters" => Error::value(
                "group 'parameters'",
                "empty",
                "numbers that differ between environments, and a stage `privileged` that shows them",
                "Draw some (randomise = [{ what = 'mass', range = [0.7, 1.3] }]), or take HoverRand or TrackRand.",
            ),
            "history" | "past" => Error::value(
                format!("group '{name}'"),
                "empty",
                "what a stage `history` keeps",
                "Add it: observation = [{ kind = 'history', steps = 8 }].",
            ),
            _ => Error::Unknown {
                kind: "group of the observation",
                name: name.into(),
                known: all().map(|own| own.name).collect(),
            },
        })
    }

    /// Every field of the observation.
    fn fields(&self) -> impl Iterator<Item = Group> {
        let first = |k: usize| total(&self.observation[..k]);
        self.observation.iter().enumerate().map(move |(k, field)| Group::of_field(field, first(k)))
    }

    /// Where the last stages of a kind stand: what stages behind one add stands behind its block.
    fn stages(&self) -> Stages {
        let (mut n, mut found) = (self.n_observation, Stages::default());
        for stage in self.config.observation.iter().rev() {
            match stage {
                ObservationTransform::History { steps } => {
                    found.history = Some([*steps, n / (*steps).max(1)]);
                    break;
                }
                ObservationTransform::Privileged {} => {
                    let first = n.saturating_sub(self.privileged.len());
                    found.parameters = found.parameters.or((first < n).then_some(first..n));
                    n = first;
                }
                ObservationTransform::Estimate { .. }
                | ObservationTransform::Noise { .. }
                | ObservationTransform::Normalise { .. } => (),
            }
        }
        found
    }
}

/// What stages made of an observation.
#[derive(Default)]
struct Stages {
    /// Steps and numbers of each.
    history: Option<[usize; 2]>,
    /// Columns of what a stage `privileged` shows.
    parameters: Option<Range<usize>>,
}
