//! The room of a buffer's records: which places are free, and who leaves when there are too many.

use crate::buffer::episode::Episode;
use crate::buffer::episodes::EpisodeBuffer;
use vhs_base::error::Result;
use vhs_base::fork;

impl EpisodeBuffer {
    /// Evicts the oldest finished episodes until `n` more steps fit.
    pub(super) fn evict_for(&mut self, n: usize) -> Result<()> {
        let (mut count, mut steps) = (0, self.steps + n);
        // Open episodes alone always fit (checked when built), so there are enough to evict.
        while steps > self.config.capacity_steps && count < self.finished.len() {
            steps -= self.finished[count].len();
            count += 1;
        }
        self.evict(count)
    }

    /// Evicts so many of the oldest finished episodes.
    pub(crate) fn evict(&mut self, count: usize) -> Result<()> {
        if count == 0 {
            return Ok(());
        }
        self.note_left(count)?;
        for _ in 0..count {
            let Some(oldest) = self.finished.pop_front() else {
                break;
            };
            let first = self.steps_before.pop_front();
            if let (Some(first), Some(priorities)) = (first, &mut self.priorities) {
                priorities.remove(first, oldest.len());
            }
            self.release(oldest);
        }
        Ok(())
    }

    pub(crate) fn release(&mut self, episode: Episode) {
        self.steps -= episode.len();
        // In reverse: slots are taken from the end, and memory likes to be written in its own order.
        self.retired.extend(episode.frames.into_iter().rev());
        self.free_retired();
    }

    /// Keeps the slots of whatever is evicted from being used again, until [`EpisodeBuffer::end_save`].
    pub(crate) fn hold_slots(&mut self) {
        let here = fork::lineage();
        if self.saves.0 != here {
            self.saves = (here, 0);
        }
        self.saves.1 += 1;
    }

    /// Ends what [`EpisodeBuffer::begin_save`] began.
    pub fn end_save(&mut self) {
        self.saves.1 = self.saves.1.saturating_sub(1);
        self.free_retired();
    }

    pub(super) fn free_retired(&mut self) {
        if self.saves.1 == 0 || self.saves.0 != fork::lineage() {
            self.free.append(&mut self.retired);
        }
    }

    /// Makes room for the priorities of the steps of a stream's open episode.
    pub(super) fn reserve_priorities(&mut self, stream: usize) -> Result<()> {
        let steps = self.opened("finish", stream)?.len();
        let first = self.first_number();
        let stored = usize::try_from(self.finished_steps - first).unwrap_or(usize::MAX);
        match &mut self.priorities {
            None => Ok(()),
            Some(priorities) => priorities.reserve(first, stored + steps),
        }
    }

    /// The number of the oldest stored step among all that ever finished.
    pub(crate) fn first_number(&self) -> u64 {
        let oldest = self.steps_before.front();
        oldest.copied().unwrap_or(self.finished_steps)
    }

    /// Makes room for `n` more frames and their goal vectors.
    pub(super) fn reserve(&mut self, n: usize) -> Result<()> {
        let beyond = n.saturating_sub(self.free.len());
        self.slab.reserve(beyond)?;
        if self.config.vector_bytes().is_some() {
            self.achieved.reserve(beyond)?;
        }
        self.fields
            .iter_mut()
            .try_for_each(|slab| slab.reserve(beyond))
    }

    /// Copies a frame, and its goal vector where there is one, into a slot that no episode owns.
    pub(super) fn store(&mut self, frame: &[u8], achieved: &[u8]) -> Result<usize> {
        let slot = self.free.pop().unwrap_or(self.slab.len());
        self.slab.put(slot, frame)?;
        if !achieved.is_empty() {
            self.achieved.put(slot, achieved)?;
        }
        Ok(slot)
    }
}
