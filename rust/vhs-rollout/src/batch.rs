//! Batches: one block of the caller's memory with a column for each field of an answer.
//!
//! The block has room for all environments. Its layout is fixed at the start, so that a caller can make its arrays once a
//! block and recycle blocks: fresh memory is 10 to 15 times slower to fill than warm memory. Observations are copied here
//! from their slots, the second and last copy of their way.

use vhs_base::check::check_shape;
use vhs_base::error::{Error, Result};

use crate::flags::{FINAL, FIRST, NOTABLE, TERMINATED, TRUNCATED};
use crate::layout::Layout;
use crate::slot::Answer;

const ALIGNMENT: usize = 64;

/// A part of every observation with an array of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// From the start of an observation, in bytes.
    pub offset: usize,
    /// Size in one observation, in bytes.
    pub bytes: usize,
}

/// Offsets of the columns in a block, in bytes; each column has room for `rows` rows and is 64-byte aligned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BatchLayout {
    /// Rows that a block has room for.
    pub rows: usize,
    /// Environment, i64.
    pub env_ids: usize,
    /// Reward, f64.
    pub rewards: usize,
    /// Policy version of the action, i64.
    pub versions: usize,
    /// Seed of the running episode, u64.
    pub seeds: usize,
    /// Steps taken in the episode, i64.
    pub steps: usize,
    /// Length of the pickled part, i64.
    pub blob_bytes: usize,
    /// Bits of [`crate::flags`], u32.
    pub flags: usize,
    /// bool.
    pub terminated: usize,
    /// bool.
    pub truncated: usize,
    /// bool.
    pub first: usize,
    /// Rows that have a final observation, i64, in the order of those.
    pub final_rows: usize,
    /// Observations, a column a leaf.
    pub observations: Vec<usize>,
    /// Final observations, a column a leaf.
    pub finals: Vec<usize>,
    /// Size of a block.
    pub total: usize,
    leaves: Vec<Leaf>,
}

impl BatchLayout {
    /// The layout for all environments of `layout`.
    ///
    /// # Errors
    /// [`Error::Argument`] for a leaf outside the observation.
    pub fn new(layout: &Layout, leaves: Vec<Leaf>) -> Result<Self> {
        let limit = layout.shape.observation_bytes;
        for leaf in &leaves {
            let end = leaf.offset.checked_add(leaf.bytes);
            if end.is_none_or(|end| end > limit) {
                return Err(Error::Argument {
                    field: "leaves",
                    expected: format!("parts of an observation of {limit} bytes"),
                    got: format!("{leaf:?}"),
                });
            }
        }
        let rows = layout.shape.num_envs();
        let mut total = 0;
        let mut column = |bytes: usize| {
            let offset = total;
            total += (rows * bytes).next_multiple_of(ALIGNMENT);
            offset
        };
        Ok(Self {
            rows,
            env_ids: column(8),
            rewards: column(8),
            versions: column(8),
            seeds: column(8),
            steps: column(8),
            blob_bytes: column(8),
            flags: column(4),
            terminated: column(1),
            truncated: column(1),
            first: column(1),
            final_rows: column(8),
            observations: leaves.iter().map(|leaf| column(leaf.bytes)).collect(),
            finals: leaves.iter().map(|leaf| column(leaf.bytes)).collect(),
            total,
            leaves,
        })
    }
}

/// How much of a block is filled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Rows with an answer.
    pub rows: usize,
    /// Rows among them with a final observation.
    pub finals: usize,
    /// Rows among them with bits of [`NOTABLE`].
    pub notable: usize,
}

/// A block being filled.
#[derive(Debug)]
pub(crate) struct Block<'a> {
    layout: &'a BatchLayout,
    bytes: &'a mut [u8],
    pub(crate) filled: Filled,
}

impl<'a> Block<'a> {
    /// Refuses memory of another size than the layout's.
    pub(crate) fn new(layout: &'a BatchLayout, bytes: &'a mut [u8]) -> Result<Self> {
        check_shape("block", &[layout.total], &[bytes.len()])?;
        Ok(Self {
            layout,
            bytes,
            filled: Filled::default(),
        })
    }

    /// Appends an answer whose observations lie at `observation` and `last`.
    ///
    /// # Safety
    /// Both point to an observation of the layout's size that nobody writes meanwhile.
    pub(crate) unsafe fn push(
        &mut self,
        env: usize,
        answer: &Answer,
        observation: *const u8,
        last: *const u8,
    ) {
        let (layout, row, flags) = (self.layout, self.filled.rows, answer.flags);
        self.put(layout.env_ids, row, (env as u64).to_ne_bytes());
        self.put(layout.rewards, row, answer.reward.to_ne_bytes());
        self.put(layout.versions, row, answer.version.to_ne_bytes());
        self.put(layout.seeds, row, answer.seed.to_ne_bytes());
        self.put(layout.steps, row, u64::from(answer.step).to_ne_bytes());
        let blob_bytes = u64::from(answer.blob_bytes);
        self.put(layout.blob_bytes, row, blob_bytes.to_ne_bytes());
        self.put(layout.flags, row, flags.to_ne_bytes());
        self.put(layout.terminated, row, [u8::from(flags & TERMINATED != 0)]);
        self.put(layout.truncated, row, [u8::from(flags & TRUNCATED != 0)]);
        self.put(layout.first, row, [u8::from(flags & FIRST != 0)]);
        // SAFETY: the caller's promise.
        unsafe { self.copy(&layout.observations, row, observation) };
        if flags & FINAL != 0 {
            self.put(
                layout.final_rows,
                self.filled.finals,
                (row as u64).to_ne_bytes(),
            );
            // SAFETY: the caller's promise.
            unsafe { self.copy(&layout.finals, self.filled.finals, last) };
            self.filled.finals += 1;
        }
        self.filled.notable += usize::from(flags & NOTABLE != 0);
        self.filled.rows += 1;
    }

    fn put<const N: usize>(&mut self, column: usize, row: usize, value: [u8; N]) {
        let start = column + row * N;
        self.bytes[start..start + N].copy_from_slice(&value);
    }

    /// # Safety
    /// `observation` points to an observation of the layout's size that nobody writes meanwhile.
    unsafe fn copy(&mut self, columns: &[usize], row: usize, observation: *const u8) {
        for (leaf, column) in self.layout.leaves.iter().zip(columns) {
            let start = column + row * leaf.bytes;
            let target = &mut self.bytes[start..start + leaf.bytes];
            // SAFETY: the leaf lies within the observation, as `BatchLayout::new` checked; the target is ours.
            let source =
                unsafe { std::slice::from_raw_parts(observation.add(leaf.offset), leaf.bytes) };
            target.copy_from_slice(source);
        }
    }
}
