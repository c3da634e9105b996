//! The columns of information that an environment tells: all, or those that its configuration names.

use super::block::{EnvBlock, Sizes, episode_state, signal};
use super::layout::EnvLayout;
use super::programs::{KEPT, WORK};
use super::spec::{Column, Info};
use crate::task_spec::TaskSpec;
use autodiff::lanes::gather_rows;
use autodiff::native::Place;
use autodiff::program::BLOCK;
use base::error::{Error, Result};

/// Where a number is told from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    /// Row of the episode state.
    Episode(usize),
    /// Row of the signals.
    Signal(usize),
    /// Number among the task's metrics.
    Metric(usize),
}

impl Source {
    fn of(column: Column) -> Self {
        match column {
            Column::Return => Self::Episode(episode_state::RETURN),
            Column::Length => Self::Episode(episode_state::STEP),
            Column::Clipped => Self::Episode(episode_state::CLIPPED),
            Column::Reason => Self::Episode(episode_state::REASON),
            Column::Success => Self::Signal(signal::SUCCESS),
            Column::Loss => Self::Signal(signal::LOSS),
        }
    }

    /// Its row of [`KEPT`] or of [`WORK`].
    fn place(self, layout: &EnvLayout) -> Place {
        let (array, row) = match self {
            Self::Episode(k) => (KEPT, layout.kept.episode_state.range().start + k),
            Self::Signal(k) => (WORK, layout.work.signals.range().start + k),
            Self::Metric(k) => (WORK, layout.work.metrics.range().start + k),
        };
        Place { array, row: row as u32 }
    }

    /// Whether nobody but the caller reads it.
    fn is_for_the_caller(self) -> bool {
        !matches!(self, Self::Episode(episode_state::STEP | episode_state::REASON))
    }
}

/// Columns in the order of all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct InfoColumns {
    chosen: Vec<(Info, Source)>,
    left_out: Vec<Source>,
    /// Of those that are chosen.
    places: Vec<Place>,
}

impl InfoColumns {
    /// The columns of these names, or all.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a name that none has.
    pub(crate) fn of(names: Option<&[String]>, own: &TaskSpec) -> Result<Self> {
        let info = |name: String, unit: &str, meaning: &str| Info { name, unit: unit.into(), meaning: meaning.into() };
        let mut all: Vec<(Info, Source)> =
            Column::ALL.into_iter().map(|column| (column.info(), Source::of(column))).collect();
        all.extend(own.reward.iter().enumerate().map(|(k, term)| {
            (info(term.column(), "-", "sum of this term"), Source::Episode(episode_state::TERMS + k))
        }));
        let metrics = own.metrics.iter().enumerate();
        all.extend(metrics.map(|(k, m)| (info(m.name.clone(), &m.unit, "now"), Source::Metric(k))));
        let Some(names) = names else {
            return Ok(Self { chosen: all, left_out: Vec::new(), places: Vec::new() });
        };
        if let Some(name) = names.iter().find(|name| all.iter().all(|(info, _)| info.name != **name)) {
            let known = all.into_iter().map(|(info, _)| info.name).collect();
            return Err(Error::Unknown { kind: "column of the information", name: name.clone(), known });
        }
        let (chosen, left_out): (Vec<_>, Vec<_>) = all.into_iter().partition(|(info, _)| names.contains(&info.name));
        let left_out = left_out.into_iter().map(|(_, source)| source).collect();
        Ok(Self { chosen, left_out, places: Vec::new() })
    }

    /// Where all lies as the layout says.
    pub(crate) fn placed(mut self, layout: &EnvLayout) -> Self {
        self.places = self.chosen.iter().map(|(_, source)| source.place(layout)).collect();
        self
    }

    /// Whether that is all there are.
    pub(crate) fn is_all(&self) -> bool {
        self.left_out.is_empty()
    }

    /// Where each is told from.
    pub(crate) fn places(&self) -> &[Place] {
        &self.places
    }

    pub(crate) fn len(&self) -> usize {
        self.chosen.len()
    }

    /// What they are.
    pub(crate) fn infos(&self) -> Vec<Info> {
        self.chosen.iter().map(|(info, _)| info.clone()).collect()
    }

    /// Rows that no step needs to write.
    pub(crate) fn left_out(&self, s: &Sizes, layout: &EnvLayout) -> Vec<Place> {
        let held =
            (s.hold > 0 && self.left_out.contains(&Source::of(Column::Success))).then(|| Source::Episode(s.held_row()));
        let own = self.left_out.iter().copied().filter(|source| source.is_for_the_caller());
        own.chain(held).map(|source| source.place(layout)).collect()
    }

    /// Numbers of a block, row by row; nothing where the rows were left out.
    pub(crate) fn write(&self, block: &EnvBlock, work: &[[f32; BLOCK]], rows: &mut [f32]) {
        let column = |k: usize| {
            let Place { array, row } = self.places[k];
            &(if array == WORK { work } else { &block.kept })[row as usize]
        };
        gather_rows(self.places.len(), column, block.plant.occupied, rows);
    }
}
