//! Episodes of many environments at once, each frame stored once although observations stack
//! several.
//!
//! A stream (one environment) goes Idle -> `begin` -> Open -> `append`* -> `finish` or `abort` ->
//! Idle. An episode of T steps has frames 0..=T; observation t stacks frames t - k + 1 ..= t, and
//! repeats frame 0 where that would reach before the episode (paper, appendix, "Implementation
//! Details": a stack of two frames), so no observation ever crosses an episode border.
//!
//! Invariants: a frame belongs to exactly one episode; finished episodes have consecutive ids,
//! given in the order of `finish`, and leave oldest first when room is needed; open episodes are
//! never evicted; stored bytes never change.

use std::collections::VecDeque;

use crate::buffer::config::EpisodeConfig;
use crate::buffer::episode::{Episode, Opening, Steps};
use crate::buffer::field::{Field, Per};
use crate::buffer::layer::Layer;
use crate::buffer::priorities::Priorities;
use crate::labels::class_of;
use crate::outcome::Outcome;
use crate::storage::journal::Journal;
use crate::storage::slab::{Slab, Source};
use vhs_base::check::check_labels;
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

/// See the module documentation.
///
/// ```
/// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
/// use vhs_core::outcome::Outcome;
/// let mut buffer = EpisodeBuffer::new(EpisodeConfig {
///     frame_shape: vec![2], num_streams: 1, max_episode_steps: 20, capacity_steps: 100,
///     frame_stack: 2, num_goals: 5, num_interactions: 1, ..EpisodeConfig::default()
/// })?;
/// buffer.begin(0, &[10, 11], 4, 0)?;
/// let (streams, actions, rewards, values) = (&[0], &[3], &[-1.0], &[0.5]);
/// buffer.append(Steps { streams, actions, rewards, values, frames: &[20, 21], ..Steps::default() })?;
/// let id = buffer.finish(0, Outcome::Failure)?;
/// let batch = buffer.gather(&[id])?;
/// assert_eq!(batch.observations, [10, 11, 10, 11, 10, 11, 20, 21]); // o_0 repeats frame 0
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Debug)]
pub struct EpisodeBuffer {
    pub(crate) config: EpisodeConfig,
    pub(crate) slab: Slab,
    /// Goal vectors reached, under the numbers of their frames; empty where goals are not vectors.
    pub(crate) achieved: Slab,
    /// Beside each field of the configuration what is stored of it, under the numbers of frames.
    pub(crate) fields: Vec<Slab>,
    /// Slots of the slab that no episode owns.
    pub(crate) free: Vec<usize>,
    /// Slots that no episode owns any more, and that a save under way may still read.
    pub(super) retired: Vec<usize>,
    /// Saves under way, and the lineage of the process that began them: in a forked copy nobody ends them.
    pub(super) saves: (u64, usize),
    /// One place a stream; None while it is idle. Boxed, so that a million idle streams cost little.
    pub(crate) open: Vec<Option<Box<Episode>>>,
    /// Finished episodes, oldest first.
    pub(crate) finished: VecDeque<Episode>,
    /// Beside each finished episode, the steps of all that finished before it, evicted ones included: a
    /// transition is found in this compact list without a walk over the episodes.
    pub(crate) steps_before: VecDeque<u64>,
    /// Steps of all episodes that ever finished.
    pub(crate) finished_steps: u64,
    /// The id that the next finished episode gets.
    pub(crate) next_id: u64,
    /// Steps stored, finished and open.
    pub(crate) steps: usize,
    /// Of finished steps, where they have any.
    pub(crate) priorities: Option<Priorities>,
    /// Where the buffer stays on the disk.
    pub(crate) journal: Option<Journal>,
    pub(crate) rng: Rng,
}

impl EpisodeBuffer {
    /// An empty buffer.
    ///
    /// # Errors
    /// [`Error::Argument`] for a size out of range or sizes whose product no memory can hold; [`Error::Io`]
    /// where the scratch file cannot be made.
    pub fn new(config: EpisodeConfig) -> Result<Self> {
        config.check()?;
        let backing = config.backing.clone();
        Self::with_sources(config, |name| backing.source(name))
    }

    /// An empty buffer whose records lie where a function says: "frames", "goals", "field-1" and so on.
    pub(crate) fn with_sources(
        config: EpisodeConfig,
        source: impl Fn(&str) -> Result<Source>,
    ) -> Result<Self> {
        // Every step adds a frame, and every episode, of at least one step unless it is open, one more.
        let most = 2 * config.capacity_steps + config.num_streams;
        let slab = Slab::new(config.frame_bytes(), most, source("frames")?);
        let fields = config.fields.iter().zip(1..).map(|(field, number)| {
            let source = source(&format!("field-{number}"))?;
            Ok(Slab::new(field.bytes(), most, source))
        });
        let fields = fields.collect::<Result<_>>()?;
        let open = std::iter::repeat_with(|| None)
            .take(config.num_streams)
            .collect();
        let rng = Rng::new(config.seed);
        let exponent = config.priority_exponent;
        let priorities = exponent.map(Priorities::new);
        Ok(Self {
            slab,
            achieved: match config.vector_bytes() {
                Some(bytes) => Slab::new(bytes, most, source("goals")?),
                None => Slab::new(1, most, Source::Memory),
            },
            fields,
            free: Vec::new(),
            retired: Vec::new(),
            saves: (0, 0),
            open,
            finished: VecDeque::new(),
            steps_before: VecDeque::new(),
            finished_steps: 0,
            next_id: 0,
            steps: 0,
            priorities,
            journal: None,
            rng,
            config,
        })
    }

    /// Opens an episode with its first frame, instructed goal class and interaction.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::begin_with`].
    pub fn begin(&mut self, stream: i64, frame: &[u8], goal: i64, interaction: i64) -> Result<()> {
        self.begin_with(
            stream,
            Opening {
                frame,
                goal,
                interaction,
                ..Opening::default()
            },
        )
    }

    /// Opens an episode, of whatever kind of goal.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Shape`], [`Error::Protocol`] where an episode is open already,
    /// [`Error::Memory`], [`Error::Io`] where the file behind the buffer cannot grow.
    pub fn begin_with(&mut self, stream: i64, opening: Opening<'_>) -> Result<()> {
        let stream = self.stream(stream)?;
        opening.check(&self.config)?;
        if self.open[stream].is_some() {
            let (expected, found) = ("a stream between episodes", "an open episode");
            return Err(Error::Protocol {
                call: "begin",
                stream,
                expected,
                found,
            });
        }
        self.reserve(1)?;
        let first = self.store(opening.frame, opening.achieved)?;
        for (number, &bytes) in opening.fields.iter().enumerate() {
            match self.config.fields[number].per {
                Per::Observation => self.fields[number].put(first, bytes)?,
                // No step led to it: a place without a value keeps the numbers the same.
                Per::Step => self.fields[number].put_zeros(first)?,
            }
        }
        self.open[stream] = Some(Box::new(Episode::new(
            &opening,
            first,
            self.config.max_episode_steps,
        )));
        Ok(())
    }

    /// Appends one step to each of several open episodes, evicting the oldest finished ones where
    /// room is needed.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Label`], [`Error::NonFinite`], [`Error::Protocol`] where a stream
    /// is idle, [`Error::TooManySteps`], [`Error::Argument`] where a stream comes twice,
    /// [`Error::Memory`], [`Error::Io`] where the file behind the buffer cannot grow; then nothing is
    /// appended to any stream.
    pub fn append(&mut self, steps: Steps<'_>) -> Result<()> {
        steps.check(&self.config)?;
        let mut streams = steps.streams.iter();
        streams.try_for_each(|&stream| self.check_appendable(class_of(stream)))?;
        // Before anything changes: from here on every frame has a slot.
        self.reserve(steps.streams.len())?;
        self.evict_for(steps.streams.len())?;
        let (frame_bytes, dim) = (self.config.frame_bytes(), self.config.action_dim);
        let vector_bytes = self.config.vector_bytes().unwrap_or_default();
        for (row, &stream) in steps.streams.iter().enumerate() {
            let frame = &steps.frames[row * frame_bytes..][..frame_bytes];
            let slot = self.store(frame, &steps.achieved[row * vector_bytes..][..vector_bytes])?;
            for (slab, bytes) in self.fields.iter_mut().zip(steps.fields) {
                let size = bytes.len() / steps.streams.len();
                slab.put(slot, &bytes[row * size..][..size])?;
            }
            let Some(episode) = &mut self.open[class_of(stream)] else {
                continue;
            };
            if dim == 0 {
                episode.actions.push(steps.actions[row]);
            }
            episode.vectors.extend(&steps.vectors[row * dim..][..dim]);
            episode.rewards.push(steps.rewards[row]);
            episode.values.push(steps.values[row]);
            episode.frames.push(slot);
            self.steps += 1;
        }
        Ok(())
    }

    /// Closes the open episode of a stream and returns its id. Its newest frame becomes the final
    /// observation. A timeout counts as cut off, any other outcome as terminated.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::finish_with`].
    pub fn finish(&mut self, stream: i64, outcome: Outcome) -> Result<i64> {
        self.finish_with(stream, outcome, outcome != Outcome::Timeout)
    }

    /// As [`EpisodeBuffer::finish`], for tasks that say apart from the outcome whether the last step ended
    /// the task or a limit cut it off.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Protocol`] where no episode is open or the open one has no step
    /// yet, [`Error::Memory`].
    pub fn finish_with(
        &mut self,
        stream: i64,
        outcome: Outcome,
        is_terminated: bool,
    ) -> Result<i64> {
        let stream = self.stream(stream)?;
        if self.opened("finish", stream)?.is_empty() {
            let (expected, found) = (
                "an open episode with at least one step",
                "one without a step",
            );
            return Err(Error::Protocol {
                call: "finish",
                stream,
                expected,
                found,
            });
        }
        self.reserve_priorities(stream)?;
        self.compact()?;
        self.note_finished(stream, outcome, is_terminated)?;
        if let Some(mut episode) = self.open[stream].take() {
            episode.outcome = outcome;
            episode.is_terminated = is_terminated;
            self.steps_before.push_back(self.finished_steps);
            if let Some(priorities) = &mut self.priorities {
                priorities.add(self.finished_steps, episode.len());
            }
            self.finished_steps += episode.len() as u64;
            self.finished.push_back(*episode);
            self.next_id += 1;
        }
        Ok(public_id(self.next_id - 1))
    }

    /// Drops the open episode of a stream, as after a crashed environment.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Protocol`] where no episode is open.
    pub fn abort(&mut self, stream: i64) -> Result<()> {
        let stream = self.stream(stream)?;
        self.opened("abort", stream)?;
        if let Some(episode) = self.open[stream].take() {
            self.release(*episode);
        }
        Ok(())
    }

    /// A finished, stored episode.
    ///
    /// # Errors
    /// [`Error::Evicted`] or [`Error::UnknownEpisode`].
    pub fn episode(&self, id: i64) -> Result<&Episode> {
        let unknown = Error::UnknownEpisode {
            id,
            next: self.next_id,
        };
        let Ok(id) = u64::try_from(id) else {
            return Err(unknown);
        };
        if id >= self.next_id {
            return Err(unknown);
        }
        let oldest = self.next_id - self.finished.len() as u64;
        let place = id
            .checked_sub(oldest)
            .and_then(|place| usize::try_from(place).ok());
        place
            .and_then(|place| self.finished.get(place))
            .ok_or(Error::Evicted { id, oldest })
    }

    /// Ids of the finished episodes that are stored, oldest first.
    pub fn ids(&self) -> impl Iterator<Item = i64> + use<> {
        self.first_id()..public_id(self.next_id)
    }

    /// The open episode of each stream, None where it is idle.
    pub fn open_episodes(&self) -> impl Iterator<Item = Option<&Episode>> {
        self.open.iter().map(Option::as_deref)
    }

    /// Finished episodes stored.
    #[must_use]
    pub fn len(&self) -> usize {
        self.finished.len()
    }

    /// Whether no finished episode is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.finished.is_empty()
    }

    /// Steps stored, of finished and open episodes.
    #[must_use]
    pub const fn num_steps(&self) -> usize {
        self.steps
    }

    /// Bytes set aside for frames, goal vectors, fields and priorities; grows as the buffer fills.
    #[must_use]
    pub fn allocated_bytes(&self) -> usize {
        let slabs = [&self.slab, &self.achieved].into_iter().chain(&self.fields);
        let priorities = self.priorities.as_ref();
        slabs.map(Slab::allocated_bytes).sum::<usize>()
            + priorities.map_or(0, Priorities::allocated_bytes)
    }

    /// What the buffer was built from.
    #[must_use]
    pub const fn config(&self) -> &EpisodeConfig {
        &self.config
    }

    /// The generator behind `sample`, to be saved and restored.
    pub const fn rng_mut(&mut self) -> &mut Rng {
        &mut self.rng
    }

    /// Shape of one observation: as [`Stacking`](super::config::Stacking) says.
    #[must_use]
    pub fn observation_shape(&self) -> Vec<usize> {
        self.config.observation_shape()
    }

    /// Runs a sampling call with a generator of its own, which starts at one number of the buffer's. A call
    /// that is refused gives the number back.
    pub(crate) fn with_rng<R>(
        &mut self,
        sample: impl FnOnce(&Self, &mut Rng) -> Result<R>,
    ) -> Result<R> {
        let before = self.rng.clone();
        let mut own = self.rng.split();
        let sampled = sample(self, &mut own);
        if sampled.is_err() {
            self.rng = before;
        }
        sampled
    }

    pub(crate) fn observation_bytes(&self) -> usize {
        self.config.observation_bytes()
    }

    /// The frames, as observations are made of them.
    #[inline]
    pub(crate) fn frames(&self) -> Layer<'_> {
        Layer {
            slab: &self.slab,
            stack: self.config.frame_stack,
            stacking: self.config.stacking,
            shape: &self.config.frame_shape,
            item: self.config.frame_item,
        }
    }

    /// Each field with what is stored of it.
    pub(crate) fn layers(&self) -> impl ExactSizeIterator<Item = (&Field, Layer<'_>)> {
        let fields = self.config.fields.iter().enumerate();
        fields.map(|(number, field)| (field, self.layer(number)))
    }

    /// What is stored of the field of this number.
    pub(crate) fn layer(&self, number: usize) -> Layer<'_> {
        let field = &self.config.fields[number];
        Layer {
            slab: &self.fields[number],
            stack: if field.is_stacked {
                self.config.frame_stack
            } else {
                1
            },
            stacking: self.config.stacking,
            shape: &field.shape,
            item: field.item,
        }
    }

    /// Writes observation `t` of an episode, its frames stacked as configured.
    pub(crate) fn write_observation(&self, episode: &Episode, t: usize, out: &mut [u8]) {
        self.frames().write(episode, t, out);
    }

    /// The open episode of a stream, or the error that the call on an idle stream deserves.
    pub(crate) fn opened(&self, call: &'static str, stream: usize) -> Result<&Episode> {
        let (expected, found) = ("an open episode", "none: `begin` opens one");
        self.open[stream].as_deref().ok_or(Error::Protocol {
            call,
            stream,
            expected,
            found,
        })
    }

    /// A stream number as an index.
    pub(crate) fn stream(&self, stream: i64) -> Result<usize> {
        check_labels("stream", &[stream], self.open.len())?;
        Ok(class_of(stream))
    }

    /// Id of the oldest finished episode, or the next one to be given where none is stored.
    pub(crate) fn first_id(&self) -> i64 {
        public_id(self.next_id - self.finished.len() as u64)
    }

    fn check_appendable(&self, stream: usize) -> Result<()> {
        let limit = self.config.max_episode_steps;
        if self.opened("append", stream)?.len() >= limit {
            return Err(Error::TooManySteps { stream, limit });
        }
        Ok(())
    }
}

/// Ids are counted up from 0 and leave the crate as i64, the integer of array users.
fn public_id(id: u64) -> i64 {
    i64::try_from(id).unwrap_or(i64::MAX)
}
