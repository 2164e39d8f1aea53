//! Rows of batches out of records: one record a frame, several stacked in a row.
//!
//! Everything lies under the number of a frame: a field of observations under that of its own frame, a field of
//! steps under that of the frame which the step led to.

use crate::buffer::episode::Episode;
use crate::item::Item;
use crate::storage::slab::{Slab, copy_parts};
use crate::storage::stacking::{Stacking, interleave};

/// Records under the numbers of frames, and how the row of an observation is made of them.
#[derive(Clone, Copy)]
pub(crate) struct Layer<'a> {
    pub(crate) slab: &'a Slab,
    /// Records of a row.
    pub(crate) stack: usize,
    pub(crate) stacking: Stacking,
    /// Shape of a record, and the type of its elements.
    pub(crate) shape: &'a [usize],
    pub(crate) item: Item,
}

impl<'a> Layer<'a> {
    /// The records of row `t` of an episode, oldest first, as they lie: equal ones are equal, compressed or not.
    #[inline]
    pub(crate) fn records(
        self,
        episode: &'a Episode,
        t: usize,
    ) -> impl ExactSizeIterator<Item = &'a [u8]> {
        let stack = self.stack;
        // Frame t - (stack - 1 - i), held at 0: before the first frame there is only the first
        // frame.
        (0..stack).map(move |i| {
            let frame = (t + i + 1).saturating_sub(stack);
            self.slab.get(episode.frames[frame])
        })
    }

    /// Writes row `t` of an episode.
    #[inline]
    pub(crate) fn write(self, episode: &'a Episode, t: usize, out: &mut [u8]) {
        if self.slab.is_packed() {
            return self.unpack(episode, t, out);
        }
        let records = self.records(episode, t);
        match self.stacking {
            Stacking::Frames => copy_parts(records, out),
            Stacking::Channels => {
                let channels = self.shape.last().copied().unwrap_or(1);
                interleave(records, channels * self.item.bytes(), out);
            }
        }
    }

    /// As `write`, of records that are compressed.
    fn unpack(self, episode: &Episode, t: usize, out: &mut [u8]) {
        let record = out.len() / self.stack;
        let mut room = match self.stacking {
            Stacking::Channels if self.stack > 1 => vec![0; out.len()],
            _ => Vec::new(),
        };
        let target = if room.is_empty() {
            &mut *out
        } else {
            &mut room[..]
        };
        for (i, part) in target.chunks_exact_mut(record).enumerate() {
            let frame = (t + i + 1).saturating_sub(self.stack);
            self.slab.read(episode.frames[frame], part);
        }
        if !room.is_empty() {
            let channels = self.shape.last().copied().unwrap_or(1);
            interleave(room.chunks_exact(record), channels * self.item.bytes(), out);
        }
    }

    /// Writes the rows of an episode from `first` on, as many as fill `out`.
    pub(crate) fn write_all(self, episode: &'a Episode, first: usize, row: usize, out: &mut [u8]) {
        for (t, out) in (first..).zip(out.chunks_exact_mut(row)) {
            self.write(episode, t, out);
        }
    }
}
