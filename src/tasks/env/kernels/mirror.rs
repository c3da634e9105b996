//! Environments to a device and back: the rows of all blocks, one behind the other.

use crate::env::Env;
use crate::env::block::EnvBlock;
use crate::env::stepper::Stepper;
use autodiff::program::BLOCK;

/// What environments are, as a device holds it: a row of each number, `stride` apart, environments in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EnvRows {
    /// From a row to the next: environments, rounded up to whole blocks.
    pub stride: usize,
    /// State, input, whether it is alive.
    pub plant: Vec<f32>,
    /// What is kept beside.
    pub kept: Vec<f32>,
    /// Of the model, where numbers vary.
    pub model: Vec<f32>,
    /// Of each.
    pub seed: Vec<u64>,
    /// Of each.
    pub episode: Vec<u64>,
    /// Whether each has begun an episode.
    pub started: Vec<bool>,
    /// Of each block: how many observations were seen, then sums and sums of squares, number by number.
    pub sums: Vec<f64>,
}

/// Rows of `n` numbers of blocks as rows of all environments.
fn spread<'a>(blocks: &'a [EnvBlock], n: usize, of: impl Fn(&'a EnvBlock) -> &'a [[f32; BLOCK]]) -> Vec<f32> {
    let rows = (0..n).flat_map(|k| blocks.iter().map(move |block| (k, block)));
    rows.flat_map(|(k, block)| of(block)[k].iter().copied()).collect()
}

/// Back.
fn gather(rows: &[f32], stride: usize, i: usize, block: &mut [[f32; BLOCK]]) {
    for (own, row) in block.iter_mut().zip(rows.chunks_exact(stride)) {
        own.copy_from_slice(&row[i * BLOCK..][..BLOCK]);
    }
}

impl Env {
    /// What the environments are now.
    #[doc(hidden)]
    pub fn rows(&self) -> EnvRows {
        let (core, blocks) = (&self.core, &self.blocks[..]);
        let n_number = blocks.first().and_then(|block| block.plant.numbers.as_ref()).map_or(0, |rows| rows.len());
        let sums =
            |block: &EnvBlock| std::iter::once(block.count).chain(block.sums.iter().flatten().copied()).collect();
        EnvRows {
            stride: blocks.len() * BLOCK,
            plant: spread(blocks, core.plant.n_row(), |block| &block.plant.rows),
            kept: spread(blocks, core.layout.kept.count, |block| &block.kept),
            model: spread(blocks, n_number, |block| block.plant.numbers.as_ref().map_or(&[][..], |rows| rows)),
            seed: blocks.iter().flat_map(|block| block.seed).collect(),
            episode: blocks.iter().flat_map(|block| block.episode).collect(),
            started: blocks.iter().flat_map(|block| (0..BLOCK).map(|lane| block.started >> lane & 1 == 1)).collect(),
            sums: blocks.iter().flat_map::<Vec<f64>, _>(sums).collect(),
        }
    }

    /// Lets the environments be what a device made of them. What broke where one diverged it does not tell.
    ///
    /// # Panics
    /// For rows of other environments.
    #[doc(hidden)]
    pub fn set_rows(&mut self, rows: &EnvRows) {
        let stride = rows.stride;
        assert_eq!(stride, self.blocks.len() * BLOCK, "rows of these environments");
        for (i, block) in self.blocks.iter_mut().enumerate() {
            gather(&rows.plant, stride, i, &mut block.plant.rows);
            gather(&rows.kept, stride, i, &mut block.kept);
            if let Some(numbers) = &mut block.plant.numbers {
                gather(&rows.model, stride, i, numbers);
            }
            block.seed.copy_from_slice(&rows.seed[i * BLOCK..][..BLOCK]);
            block.episode.copy_from_slice(&rows.episode[i * BLOCK..][..BLOCK]);
            let started = rows.started[i * BLOCK..].iter().take(BLOCK).zip(0..);
            block.started = started.fold(0, |mask, (own, lane)| mask | u64::from(*own) << lane);
            block.moved = u64::MAX;
            block.broken = [None; BLOCK];
            let width = 1 + 2 * block.sums.len();
            if let Some([count, sums @ ..]) = rows.sums.get(i * width..(i + 1) * width) {
                block.count = *count;
                block.sums.as_flattened_mut().copy_from_slice(sums);
            }
        }
    }

    /// What all environments share, as steps read it.
    #[doc(hidden)]
    pub fn shared_numbers(&self) -> Vec<f32> {
        self.core.shared.iter().map(|row| row[0]).collect()
    }

    /// Share of what makes episodes hard.
    #[doc(hidden)]
    pub fn difficulty(&self) -> f64 {
        self.core.difficulty
    }

    /// Whether steps collect statistics.
    #[doc(hidden)]
    pub fn is_collecting(&self) -> bool {
        self.core.collects
    }

    /// What the host drafts of an environment, where its next episode begins or an event happens: for the rows of
    /// [`EnvKernels::draft`](super::EnvKernels::draft). Nothing where episodes begin on the device.
    #[doc(hidden)]
    pub fn drafted(&mut self, environment: usize, is_event: bool) -> Vec<f32> {
        let (core, i, lane) = (&self.core, environment / BLOCK, environment % BLOCK);
        let Some(host) = core.task.start_on_host() else { return Vec::new() };
        let mut work = core.workspace();
        let block = &mut self.blocks[i];
        let episode = block.episode[lane];
        if !is_event {
            block.episode[lane] = episode.wrapping_add(1);
        }
        let mut stepper = Stepper::new(core, block, &mut work, i * BLOCK, &[]);
        if is_event {
            stepper.event_on_host(host, lane);
        } else {
            stepper.start_on_host(host, lane);
        }
        self.blocks[i].episode[lane] = episode;
        core.layout.work.draws.of(&work.rows).iter().map(|row| row[lane]).collect()
    }
}
