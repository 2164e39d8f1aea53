//! Episode buffers as files: written atomically, read back bit for bit, generator included.
//!
//! Invariant: a file under the chosen name is always whole, the old one or the new one.
//!
//! Little-endian words of 8 bytes, version 4, for E finished episodes of S steps in all:
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `vhsepiso` |
//! | 4, 4 | version; dimensions of a frame, D |
//! | 24 x 8 | see `header` |
//! | D x 8, G x 8 | frame shape; shape of a goal vector |
//! | I x (8, 8) | actions, each with the interaction that it does |
//! | | fields, see `header/fields` |
//! | E x 4 x 8 | goal class; interaction; outcome, plus 256 where terminated; steps |
//! | S x 8 | numbered actions, or nothing |
//! | S x A x 4 | continuous actions of A numbers, or nothing |
//! | S x 4, S x 4 | rewards; values |
//! | S x 8 | odds of steps to be drawn, where they have priorities |
//! | 8 | checksum of all bytes above |
//! | | zeros up to a multiple of 4096 |
//! | E x, (S + E) x | goals told; goal vectors reached; each where the buffer has them |
//! | (S + E) x | of each field, under its frame; zeros for a field of steps under the first frame of an episode |
//! | 8 | checksum of the goals and fields |
//! | (S + E) x | frames, episode by episode |
//! | 8 | checksum of the frames |
//!
//! Version 3 has 20 words there and no fields. Version 2 has 19, without the number of the first action, and fewer
//! types of elements. Version 1 has no list of actions either: a number says from which action on they are the interactions.

pub(crate) mod header;

use std::path::Path;

use self::header::{Counters, Header, lie, number, word};
use crate::buffer::config::{Backing, EpisodeConfig};
use crate::buffer::episode::{Episode, Opening};
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::Field;
use crate::outcome::Outcome;
use crate::storage::files::{MAX_SIZE, Reader};
use crate::storage::saves::{Writer, push_words, put_records, replace};
use crate::storage::slab::Slab;
use vhs_base::check::{check_finite, check_labels};
#[cfg(doc)]
use vhs_base::error::Error;
use vhs_base::error::Result;
use vhs_base::rng::Rng;

/// Set in an episode's third word where its last step ended the task.
pub(crate) const TERMINATED: u64 = 256;

impl EpisodeBuffer {
    /// Writes the finished episodes and the generator to `path`, as a goal store is: to a temporary file
    /// beside it, synced, then renamed over it.
    ///
    /// Open episodes are not part of the file: they belong to environments that are running now. A loaded
    /// buffer has idle streams.
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions, [`Error::Io`]; the file at `path` is then
    /// as it was, or new and whole where only its directory could not be synced.
    pub fn save(&self, path: &Path) -> Result<()> {
        Saving::new(self, &self.rng)?.write(path, |read| read(self))
    }

    /// Begins a save of what is finished now and of this generator, during which the buffer may be used: frames
    /// of episodes that are evicted meanwhile stay until [`EpisodeBuffer::end_save`], which must follow.
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions; then no end need follow.
    pub fn begin_save(&mut self, rng: &Rng) -> Result<Saving> {
        let saving = Saving::new(self, rng)?;
        self.hold_slots();
        Ok(saving)
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
        read(path, &Loading::Read(backing))
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
        read(path, &Loading::Map)
    }

    /// Compares every checksum of a saved buffer, without keeping frames in memory.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Damaged`].
    pub fn verify(path: &Path) -> Result<()> {
        verify(path)
    }
}

/// A save under way: all that it writes but the frames and the goals reached, which it reads from the buffer
/// piece by piece while others use that.
#[derive(Debug)]
pub struct Saving {
    /// Everything up to the first checksum.
    head: Vec<u8>,
    /// The goals that episodes were told.
    told: Vec<u8>,
    /// Slots of the frames, in the order of the file.
    slots: Vec<usize>,
    frame_bytes: usize,
    vector_bytes: Option<usize>,
    /// Of each field.
    field_bytes: Vec<usize>,
}

impl Saving {
    fn new(buffer: &EpisodeBuffer, rng: &Rng) -> Result<Self> {
        let steps = buffer.finished.iter().map(Episode::len).sum();
        let counters = Counters {
            next_id: buffer.next_id,
            finished_steps: buffer.finished_steps,
            episodes: buffer.finished.len(),
            steps,
        };
        let mut head = header::write(buffer, rng, &counters)?;
        let episodes = || buffer.finished.iter();
        for episode in episodes() {
            let ended = episode.outcome as u64 + if episode.is_terminated { TERMINATED } else { 0 };
            let (goal, interaction) = (word(episode.goal), word(episode.interaction));
            push_words(&mut head, [goal, interaction, ended, episode.len() as u64]);
        }
        for episode in episodes() {
            push_words(
                &mut head,
                episode.actions.iter().map(|&a| a.cast_unsigned()),
            );
        }
        for numbers in [
            |episode: &'_ Episode| &episode.vectors[..],
            |episode: &'_ Episode| &episode.rewards[..],
            |episode: &'_ Episode| &episode.values[..],
        ] as [fn(&Episode) -> &[f32]; 3]
        {
            let numbers = episodes().flat_map(numbers);
            numbers.for_each(|number| head.extend(number.to_le_bytes()));
        }
        if let Some(priorities) = &buffer.priorities {
            let numbers = buffer.first_number()..buffer.finished_steps;
            push_words(
                &mut head,
                numbers.map(|number| priorities.odds(number).to_bits()),
            );
        }
        Ok(Self {
            head,
            told: episodes()
                .flat_map(|episode| episode.desired.iter().copied())
                .collect(),
            slots: episodes()
                .flat_map(|episode| episode.frames.iter().copied())
                .collect(),
            frame_bytes: buffer.config.frame_bytes(),
            vector_bytes: buffer.config.vector_bytes(),
            field_bytes: buffer.config.fields.iter().map(Field::bytes).collect(),
        })
    }

    /// Writes the file, as [`EpisodeBuffer::save`] does. `with_buffer` hands the buffer that began this to a
    /// function, for a piece at a time.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Interrupted`] where the call is to stop.
    pub fn write(
        &self,
        path: &Path,
        with_buffer: impl Fn(&mut dyn FnMut(&EpisodeBuffer)),
    ) -> Result<()> {
        let put = |file: &mut Writer<'_>, bytes, slab: &dyn Fn(&EpisodeBuffer) -> &Slab| {
            put_records(file, bytes, &self.slots, |slots, out| {
                with_buffer(&mut |buffer| {
                    let slab = slab(buffer);
                    for &slot in slots {
                        slab.append_to(slot, out);
                    }
                });
            })
        };
        replace(path, |file| {
            file.put(&self.head)?;
            file.put_checksum()?;
            file.put_padding()?;
            file.put(&self.told)?;
            if let Some(bytes) = self.vector_bytes {
                put(file, bytes, &|buffer| &buffer.achieved)?;
            }
            for (number, &bytes) in self.field_bytes.iter().enumerate() {
                put(file, bytes, &|buffer| &buffer.fields[number])?;
            }
            file.put_checksum()?;
            put(file, self.frame_bytes, &|buffer| &buffer.slab)?;
            file.put_checksum()
        })
    }
}

/// How a file is read.
#[derive(PartialEq, Eq)]
enum Loading {
    /// All of it, now, every checksum compared.
    Read(Backing),
    /// Frames stay in the file until they are asked for, and are not checked.
    Map,
}

/// Reads a buffer.
fn read(path: &Path, loading: &Loading) -> Result<EpisodeBuffer> {
    let mut reader = Reader::open(path)?;
    let (mut buffer, header) = read_steps(&mut reader, loading)?;
    let (rows, frame_bytes) = (header.rows(), header.config.frame_bytes());
    if *loading == Loading::Map {
        let most = 2 * header.config.capacity_steps + header.config.num_streams;
        buffer.slab = reader.mapped(frame_bytes, rows, most)?;
        return Ok(buffer);
    }
    reader.records(&mut buffer.slab, frame_bytes, rows)?;
    reader.expect_checksum("checksum of the frames")?;
    Ok(buffer)
}

/// Reads a buffer, but takes its frames in only for their checksum.
fn verify(path: &Path) -> Result<()> {
    let mut reader = Reader::open(path)?;
    let (_, header) = read_steps(&mut reader, &Loading::Map)?;
    // The length of the file, which holds so many bytes, was compared before.
    reader.skim(header.rows() * header.config.frame_bytes())?;
    reader.expect_checksum("checksum of the frames")
}

/// Everything but the frames.
fn read_steps(reader: &mut Reader<'_>, loading: &Loading) -> Result<(EpisodeBuffer, Header)> {
    let header = Header::read(reader)?;
    header.check_length(reader)?;
    let mut config = header.config.clone();
    if let Loading::Read(backing) = loading {
        config.backing = backing.clone();
    }
    let episodes = read_episodes(reader, &header)?;
    let odds = read_odds(reader, &header)?;
    reader.expect_checksum("checksum of the header")?;
    reader.padding(header.bytes().unwrap_or(MAX_SIZE).next_multiple_of(4096))?;
    let mut buffer = EpisodeBuffer::new(config)?;
    buffer.rng = header.rng.clone();
    buffer.next_id = header.next_id;
    buffer.finished_steps = header.finished_steps - header.steps as u64;
    buffer.steps = header.steps;
    for mut episode in episodes {
        episode.desired = reader.bytes(header.config.desired_bytes())?.into();
        buffer.steps_before.push_back(buffer.finished_steps);
        buffer.finished_steps += episode.len() as u64;
        buffer.finished.push_back(episode);
    }
    let first = buffer.first_number();
    if let Some(priorities) = &mut buffer.priorities {
        priorities.restore(header.largest, header.leaves, first, &odds)?;
    }
    if let Some(bytes) = header.config.vector_bytes() {
        reader.records(&mut buffer.achieved, bytes, header.rows())?;
    }
    for (slab, field) in buffer.fields.iter_mut().zip(&header.config.fields) {
        reader.records(slab, field.bytes(), header.rows())?;
    }
    reader.expect_checksum("checksum of the goals and fields")?;
    Ok((buffer, header))
}

/// The head of a journal: what its buffer was built from, the next id and the steps of all that finished.
pub(crate) fn read_head(reader: &mut Reader<'_>) -> Result<(EpisodeConfig, [u64; 2])> {
    let header = Header::read(reader)?;
    Ok((header.config, [header.next_id, header.finished_steps]))
}

fn read_episodes(reader: &mut Reader<'_>, header: &Header) -> Result<Vec<Episode>> {
    let config = &header.config;
    let words = reader.words(4 * header.episodes)?;
    let mut episodes = Vec::new();
    let (mut rows, mut steps) = (0, 0_usize);
    for &[goal, interaction, ended, length] in words.as_chunks().0 {
        let length = reader.number("steps of an episode", length, 1, config.max_episode_steps)?;
        // Compared before an episode takes memory for its frames: together they fit the file.
        steps = steps.saturating_add(length);
        if steps > header.steps {
            break;
        }
        let opening = Opening {
            goal: number(goal),
            interaction: number(interaction),
            ..Opening::default()
        };
        let mut episode = Episode::new(&opening, rows, 0);
        episode.outcome = Outcome::from_code(number(ended & (TERMINATED - 1)))
            .map_err(|error| lie(reader, &error))?;
        reader.number("end of an episode", ended >> 8, 0, 1)?;
        episode.is_terminated = ended & TERMINATED != 0;
        episode.frames = (rows..=rows + length).collect();
        rows += length + 1;
        episodes.push(episode);
    }
    reader.expect("steps", &header.steps.to_string(), &steps.to_string())?;
    read_arrays(reader, config, &mut episodes)?;
    for episode in &episodes {
        check_episode(config, episode).map_err(|error| lie(reader, &error))?;
    }
    Ok(episodes)
}

fn read_arrays(
    reader: &mut Reader<'_>,
    config: &EpisodeConfig,
    episodes: &mut [Episode],
) -> Result<()> {
    let dim = config.action_dim;
    if dim == 0 {
        for episode in &mut *episodes {
            let actions = reader.words(episode.frames.len() - 1)?;
            episode.actions = actions.into_iter().map(u64::cast_signed).collect();
        }
    }
    for episode in &mut *episodes {
        episode.vectors = reals(reader, dim * (episode.frames.len() - 1))?;
    }
    for episode in &mut *episodes {
        episode.rewards = reals(reader, episode.frames.len() - 1)?;
    }
    for episode in &mut *episodes {
        episode.values = reals(reader, episode.frames.len() - 1)?;
    }
    Ok(())
}

/// The odds of each step, where steps have priorities.
fn read_odds(reader: &mut Reader<'_>, header: &Header) -> Result<Vec<f64>> {
    if header.config.priority_exponent.is_none() {
        return Ok(Vec::new());
    }
    if header.leaves < header.steps || (header.leaves > 0 && !header.leaves.is_power_of_two()) {
        let expected = format!("a power of two of at least {}", header.steps);
        return Err(reader.damaged("leaves", &expected, &header.leaves.to_string()));
    }
    let words = reader.words(header.steps)?;
    let odds: Vec<f64> = words.into_iter().map(f64::from_bits).collect();
    let largest = header.largest;
    let can_be = |odds: &f64| *odds > 0.0 && *odds <= largest && largest.is_finite();
    if let Some(wrong) = odds.iter().chain([&largest]).find(|&odds| !can_be(odds)) {
        let expected = format!("numbers above 0, at most {largest}");
        return Err(reader.damaged("priorities", &expected, &wrong.to_string()));
    }
    Ok(odds)
}

fn reals(reader: &mut Reader<'_>, count: usize) -> Result<Vec<f32>> {
    let bytes = reader.bytes(4 * count)?;
    let words = bytes.as_chunks().0.iter();
    Ok(words.map(|&word| f32::from_le_bytes(word)).collect())
}

/// What `begin` and `append` would have refused.
pub(crate) fn check_episode(config: &EpisodeConfig, episode: &Episode) -> Result<()> {
    check_labels("goal", &[episode.goal], config.num_goals)?;
    let interactions = config.num_interactions.max(1);
    check_labels("interaction", &[episode.interaction], interactions)?;
    config.check_actions("actions", &episode.actions)?;
    check_finite("actions", &episode.vectors)?;
    check_finite("rewards", &episode.rewards)?;
    check_finite("values", &episode.values)
}

#[cfg(test)]
mod tests;
