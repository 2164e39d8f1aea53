//! Buffers that stay on the disk: a folder that a process may leave at any moment, and another one goes on with.
//!
//! | file | content |
//! |---|---|
//! | `frames`, `goals`, `field-1`, ... | records under the numbers of frames, mapped: what memory would hold |
//! | `journal` | what the buffer was built from, then each episode that finished or left |
//! | `lock` | held while a process uses the folder |
//!
//! Nothing is copied when a folder is reopened. A process that is killed leaves all that it stored, for the system has
//! it: a record is written to the journal before a finished episode counts, and before the places of one that left are
//! used again. Open episodes are lost. A power cut may lose what the system had not written yet; checksums tell.

mod record;

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use self::record::{read_episode, write_episode};
use crate::buffer::config::{Backing, EpisodeConfig};
use crate::buffer::episode::Episode;
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::file::header::{self, Counters};
use crate::buffer::file::read_head;
use crate::outcome::Outcome;
use crate::storage::checksum::Checksum;
use crate::storage::files::{Reader, io_error};
use crate::storage::journal::{self, Journal};
use crate::storage::slab::Source;
use vhs_base::error::{Error, Result};
use vhs_base::interrupt;
use vhs_base::rng::Rng;

/// Kinds of entries: an episode that finished, and how many of the oldest left.
const FINISHED: u8 = 1;
const LEFT: u8 = 2;

impl EpisodeBuffer {
    /// An empty buffer that stays in this folder, which is made, or is empty.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::new`]; [`Error::Argument`] for a folder that has a buffer, or that another process uses.
    ///
    /// # Safety
    /// As long as the buffer lives, nobody else changes the files of the folder.
    pub unsafe fn keep(config: EpisodeConfig, folder: &Path) -> Result<Self> {
        config.check()?;
        fs::create_dir_all(folder).map_err(|source| io_error(folder, "create", source))?;
        let lock = lock(folder)?;
        let path = folder.join("journal");
        if path.exists() {
            return Err(Error::Argument {
                field: "backing",
                expected: "a folder without a buffer (`reopen` goes on with one)".into(),
                got: folder.display().to_string(),
            });
        }
        let mut buffer = with_files(config, folder)?;
        buffer.journal = Some(Journal::create(lock, path, &buffer.head()?)?);
        Ok(buffer)
    }

    /// Goes on with the buffer of a folder: its finished episodes under their ids, streams idle. A part of a last
    /// entry that a kill left is cut off. Drawing begins from another state of the generator, which follows from the
    /// seed and the episodes so far, and priorities begin anew.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Memory`], [`Error::Damaged`] for a journal that was altered; where `is_checked`, also for
    /// frames that are not those of their episode, unless they are of the newest ones alone, which are dropped then.
    ///
    /// # Safety
    /// As for [`EpisodeBuffer::keep`].
    pub unsafe fn reopen(folder: &Path, is_checked: bool) -> Result<Self> {
        let path = folder.join("journal");
        // Asked for first: a folder of something else stays as it is.
        drop(Reader::open(&path)?);
        let lock = lock(folder)?;
        let mut reader = Reader::open(&path)?;
        let (config, counters) = read_head(&mut reader)?;
        reader.expect_checksum("checksum of the header")?;
        let mut buffer = with_files(config, folder)?;
        [buffer.next_id, buffer.finished_steps] = counters;
        let whole = buffer.read_entries(&mut reader)?;
        reader.number(
            "steps",
            buffer.steps as u64,
            0,
            buffer.config.capacity_steps,
        )?;
        buffer.own_slots(&path)?;
        let dropped = if is_checked {
            buffer.check_frames(&path)?
        } else {
            0
        };
        let seed = buffer.config.seed.wrapping_add(buffer.next_id);
        buffer.rng = Rng::new(seed);
        let first = buffer.first_number();
        let stored = usize::try_from(buffer.finished_steps - first).unwrap_or(usize::MAX);
        if let Some(priorities) = &mut buffer.priorities {
            priorities.reserve(first, stored)?;
            priorities.add(first, stored);
        }
        buffer.journal = Some(Journal::reopen(lock, path, whole)?);
        if dropped > 0 {
            buffer.rewrite_journal()?;
        }
        Ok(buffer)
    }

    /// Forgets all finished episodes, as if newer ones had taken their room; open ones go on, ids count on.
    ///
    /// # Errors
    /// [`Error::Io`] where the buffer stays on the disk and its journal cannot be written.
    pub fn clear(&mut self) -> Result<()> {
        self.evict(self.finished.len())
    }

    /// Writes a finished episode to the journal, where there is one, before it counts.
    pub(crate) fn note_finished(
        &mut self,
        stream: usize,
        outcome: Outcome,
        is_terminated: bool,
    ) -> Result<()> {
        if self.journal.is_none() {
            return Ok(());
        }
        let Some(mut episode) = self.open[stream].take() else {
            return Ok(());
        };
        (episode.outcome, episode.is_terminated) = (outcome, is_terminated);
        episode.checksum = self.checksum_of(&episode);
        let journal = self.journal.as_mut();
        let noted = journal.map_or(Ok(()), |journal| {
            journal.put(FINISHED, &write_episode(&episode))
        });
        self.open[stream] = Some(episode);
        noted
    }

    /// Writes to the journal, where there is one, that so many of the oldest episodes leave, before they do.
    pub(crate) fn note_left(&mut self, count: usize) -> Result<()> {
        let journal = self.journal.as_mut();
        journal.map_or(Ok(()), |journal| {
            journal.put(LEFT, &(count as u64).to_le_bytes())
        })
    }

    /// Writes the journal anew where most of it tells of what has left.
    pub(crate) fn compact(&mut self) -> Result<()> {
        let step = 64 + 4 * self.config.action_dim;
        let live = self.steps * step + self.finished.len() * self.config.desired_bytes();
        match &self.journal {
            Some(journal) if journal.is_long(live) => self.rewrite_journal(),
            _ => Ok(()),
        }
    }

    fn rewrite_journal(&mut self) -> Result<()> {
        let head = self.head()?;
        let episodes = self.finished.iter();
        let entries = episodes.map(|episode| (FINISHED, write_episode(episode)));
        match &mut self.journal {
            None => Ok(()),
            Some(journal) => journal.rewrite(&head, entries),
        }
    }

    /// The head of a journal whose first entry is the oldest stored episode.
    fn head(&self) -> Result<Vec<u8>> {
        let counters = Counters {
            next_id: self.first_id().unsigned_abs(),
            finished_steps: self.first_number(),
            episodes: 0,
            steps: 0,
        };
        header::write(self, &self.rng, &counters)
    }

    /// Takes in the entries of a journal; returns where the last whole one ends.
    fn read_entries(&mut self, reader: &mut Reader<'_>) -> Result<u64> {
        loop {
            let whole = reader.position()?;
            match journal::next(reader)? {
                None => return Ok(whole),
                Some((FINISHED, content)) => {
                    let episode = read_episode(&self.config, &content);
                    self.take_in(episode.map_err(|error| header::lie(reader, &error))?);
                }
                Some((LEFT, content)) => {
                    let (words, _) = content.as_chunks();
                    let count = words.first().copied().map_or(u64::MAX, u64::from_le_bytes);
                    self.forget(reader.number("episodes that left", count, 0, self.len())?);
                }
                Some((kind, _)) => {
                    return Err(reader.damaged("kind of entry", "1 or 2", &kind.to_string()));
                }
            }
        }
    }

    /// Checksum of all that lies under the frames of an episode.
    fn checksum_of(&self, episode: &Episode) -> u64 {
        let mut checksum = Checksum::new();
        let vectors = self.config.vector_bytes().map(|_| &self.achieved);
        for slab in [&self.slab].into_iter().chain(vectors).chain(&self.fields) {
            let records = episode.frames.iter().map(|&slot| slab.get(slot));
            records.for_each(|record| checksum.update(record));
        }
        checksum.value()
    }

    /// Counts a finished episode that a journal tells of.
    fn take_in(&mut self, episode: Episode) {
        self.steps += episode.len();
        self.steps_before.push_back(self.finished_steps);
        self.finished_steps += episode.len() as u64;
        self.finished.push_back(episode);
        self.next_id += 1;
    }

    /// Drops so many of the oldest episodes, whose places are nobody's yet.
    fn forget(&mut self, count: usize) {
        for _ in 0..count {
            self.steps_before.pop_front();
            let left = self.finished.pop_front();
            self.steps -= left.map_or(0, |episode| episode.len());
        }
    }

    /// Opens the files as far as the stored episodes need them, and frees the places between.
    fn own_slots(&mut self, path: &Path) -> Result<()> {
        let slots = || self.finished.iter().flat_map(|episode| &episode.frames);
        let used: HashSet<usize> = slots().copied().collect();
        let end = used.iter().max().map_or(0, |&most| most + 1);
        if used.len() != slots().count() || end > self.slab.records_in_file() {
            return Err(damaged(path, "places of frames in the files", "others"));
        }
        let slabs = [&mut self.slab].into_iter().chain(&mut self.fields);
        for slab in slabs.chain(self.config.vector_bytes().map(|_| &mut self.achieved)) {
            slab.restore(end)?;
        }
        self.free = (0..end).rev().filter(|slot| !used.contains(slot)).collect();
        Ok(())
    }

    /// Drops the newest episodes whose frames are not what they were, as a power cut leaves them, and says how many; refuses others.
    fn check_frames(&mut self, path: &Path) -> Result<usize> {
        let mut newest = self.finished.len();
        for place in (0..self.finished.len()).rev() {
            interrupt::check()?;
            let episode = &self.finished[place];
            if self.checksum_of(episode) == episode.checksum {
                continue;
            }
            if place + 1 < newest {
                let id = self.id_at(place);
                return Err(damaged(
                    path,
                    "the frames that were stored",
                    &format!("others in episode {id}"),
                ));
            }
            newest = place;
        }
        let dropped = self.finished.split_off(newest);
        self.steps_before.truncate(newest);
        let count = dropped.len();
        for episode in dropped {
            self.finished_steps -= episode.len() as u64;
            self.next_id -= 1;
            self.release(episode);
        }
        Ok(count)
    }
}

/// A buffer whose records lie in the files of a folder.
fn with_files(mut config: EpisodeConfig, folder: &Path) -> Result<EpisodeBuffer> {
    let open = |name: &str| {
        let path = folder.join(name);
        let file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path);
        let file = file.map_err(|source| io_error(&path, "open", source))?;
        Ok(Source::File(Arc::new(file)))
    };
    config.backing = Backing::Kept(folder.into());
    EpisodeBuffer::with_sources(config, open)
}

fn damaged(path: &Path, expected: &str, found: &str) -> Error {
    Error::Damaged {
        path: path.into(),
        field: "episodes",
        expected: expected.into(),
        found: found.into(),
    }
}

/// Takes the folder for this process.
fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path);
    let file = file.map_err(|source| io_error(&path, "open", source))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::Argument {
            field: "backing",
            expected: "a folder that no other buffer uses".into(),
            got: folder.display().to_string(),
        }),
        Err(fs::TryLockError::Error(source)) => Err(io_error(&path, "lock", source)),
    }
}
