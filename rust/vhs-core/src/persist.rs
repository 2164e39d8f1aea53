//! Goal stores and episode buffers as files: written atomically, read back bit for bit, generator included.
//!
//! Invariant: a file under the chosen name is always whole, the old one or the new one. The layouts are in
//! `goal_file` and `episode_file`.

use std::path::Path;

use crate::config::Backing;
use crate::episode_file::{self, Loading};
use crate::episodes::EpisodeBuffer;
#[cfg(doc)]
use crate::error::Error;
use crate::error::Result;
use crate::files::{Reader, replace};
use crate::goal_file::{self, Header};
use crate::goals::GoalStore;

impl GoalStore {
    /// Writes the store to `path`: to a temporary file beside it, synced, then renamed over it.
    ///
    /// A reader, or a machine that loses power, sees the old file or the new one, never half of
    /// either. The images are written from where they lie; no second copy is made.
    ///
    /// ```
    /// use vhs_core::goals::{Balance, GoalStore};
    /// let mut store = GoalStore::new(5, &[2, 84, 84, 3], 2000, 0)?;
    /// store.push(&vec![7; 2 * 84 * 84 * 3], 3)?;
    /// let path = std::env::temp_dir().join("documented.goals");
    /// store.save(&path)?;
    /// let mut loaded = GoalStore::load(&path)?;
    /// let batch = loaded.sample(8, Balance::Images)?;
    /// assert_eq!(batch, store.sample(8, Balance::Images)?); // the generator is part of the file
    /// # std::fs::remove_file(&path).expect("our own file");
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions, [`Error::Io`]; the file at `path` is then
    /// as it was, or new and whole where only its directory could not be synced.
    pub fn save(&self, path: &Path) -> Result<()> {
        replace(path, |file| goal_file::write(self, file))
    }

    /// Reads a store that `save` wrote: contents, order of overwriting and generator.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Memory`], and [`Error::Damaged`] for a file of another kind or
    /// version, cut short or altered.
    pub fn load(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let mut store = header.store(path)?;
        let record = store.image_bytes();
        for (ring, &(count, next)) in store.rings.iter_mut().zip(&header.rings) {
            reader.records(&mut ring.images, record, count)?;
            ring.next = next;
        }
        reader.expect_checksum("checksum of the images")?;
        Ok(store)
    }

    /// As [`GoalStore::load`], at once: images stay in the file until they are first drawn, and are not
    /// checked; [`GoalStore::verify`] does that. New images go to memory, never to the file.
    ///
    /// # Errors
    /// As [`GoalStore::load`], except that altered images go unnoticed.
    ///
    /// # Safety
    /// As long as the store lives nobody edits the file in place or cuts it short, which `save` never does.
    pub unsafe fn map(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let mut store = header.store(path)?;
        let (record, capacity) = (store.image_bytes(), store.capacity_per_class());
        for (ring, &(count, next)) in store.rings.iter_mut().zip(&header.rings) {
            if record * count < MIN_MAPPED {
                reader.records(&mut ring.images, record, count)?;
            } else {
                ring.images = reader.mapped(record, count, capacity)?;
            }
            ring.next = next;
        }
        Ok(store)
    }

    /// Compares every checksum of a saved store, without keeping anything in memory.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Damaged`].
    pub fn verify(path: &Path) -> Result<()> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let images: usize = header.rings.iter().map(|ring| ring.0).sum();
        reader.skim(images * header.store(path)?.image_bytes())?;
        reader.expect_checksum("checksum of the images")
    }
}

/// Smaller classes are read instead of mapped: systems allow a process some 65,000 mappings.
const MIN_MAPPED: usize = 1 << 16;

impl EpisodeBuffer {
    /// Writes the finished episodes and the generator to `path`, as [`GoalStore::save`] does.
    ///
    /// Open episodes are not part of the file: they belong to environments that are running now. A loaded
    /// buffer has idle streams.
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions, [`Error::Io`]; the file at `path` is then
    /// as it was, or new and whole where only its directory could not be synced.
    pub fn save(&self, path: &Path) -> Result<()> {
        replace(path, |file| episode_file::write(self, file))
    }

    /// Reads a buffer that `save` wrote: episodes, their ids, and the generator.
    ///
    /// ```
    /// use vhs_core::config::Backing;
    /// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
    /// use vhs_core::outcome::Outcome;
    /// # let mut buffer = EpisodeBuffer::new(EpisodeConfig {
    /// #     frame_shape: vec![2], max_episode_steps: 20, capacity_steps: 100, ..EpisodeConfig::default()
    /// # })?;
    /// # buffer.begin(0, &[10, 11], 0, 0)?;
    /// # let (streams, actions, rewards, values) = (&[0], &[2], &[-1.0], &[0.5]);
    /// # buffer.append(Steps { streams, actions, rewards, values, frames: &[20, 21], ..Steps::default() })?;
    /// # buffer.finish(0, Outcome::Failure)?;
    /// let path = std::env::temp_dir().join("documented.episodes");
    /// buffer.save(&path)?;
    /// let mut loaded = EpisodeBuffer::load(&path, Backing::Memory)?;
    /// assert_eq!(loaded.sample(4, None)?, buffer.sample(4, None)?);
    /// # std::fs::remove_file(&path).expect("our own file");
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Memory`], and [`Error::Damaged`] for a file of another kind or
    /// version, cut short or altered.
    pub fn load(path: &Path, backing: Backing) -> Result<Self> {
        episode_file::read(path, &Loading::Read(backing))
    }

    /// As [`EpisodeBuffer::load`] into memory, at once: frames stay in the file until they are first drawn,
    /// and are not checked; [`EpisodeBuffer::verify`] does that. New frames go to memory, never to the file.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::load`], except that altered frames go unnoticed.
    ///
    /// # Safety
    /// As long as the buffer lives nobody edits the file in place or cuts it short, which `save` never does.
    pub unsafe fn map(path: &Path) -> Result<Self> {
        episode_file::read(path, &Loading::Map)
    }

    /// Compares every checksum of a saved buffer, without keeping frames in memory.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Damaged`].
    pub fn verify(path: &Path) -> Result<()> {
        episode_file::verify(path)
    }
}
