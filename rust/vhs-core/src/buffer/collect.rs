//! Finished episodes of one buffer into another: what is worth keeping out of what streams by.

use crate::buffer::config::EpisodeConfig;
use crate::buffer::episode::{Episode, Opening, Steps};
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::Per;
use crate::labels::class_of;
use crate::storage::slab::Slab;
use vhs_base::check::check_shape;
use vhs_base::error::{Error, Result};

impl EpisodeBuffer {
    /// Copies finished episodes of another buffer, each as far as its first `steps`, into this one, through
    /// `stream`, which must be between episodes. The oldest leave where room is needed, as with `append`. An
    /// episode that is cut counts as cut off, with the outcome it had.
    ///
    /// Returns their ids here, in the same order.
    ///
    /// # Errors
    /// [`Error::Argument`] where the two do not hold the same kind of episodes, [`Error::Evicted`] or
    /// [`Error::UnknownEpisode`] of the other, [`Error::Shape`] or [`Error::Argument`] for `steps` that do not fit
    /// the episodes, [`Error::TooManySteps`], [`Error::Protocol`] where an episode is open; then nothing is
    /// copied. [`Error::Memory`], [`Error::Io`] where this buffer cannot grow; then those before are.
    ///
    /// ```
    /// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
    /// use vhs_core::outcome::Outcome;
    /// let config = EpisodeConfig { max_episode_steps: 5, capacity_steps: 9, ..EpisodeConfig::default() };
    /// let (mut lived, mut kept) = (EpisodeBuffer::new(config.clone())?, EpisodeBuffer::new(config)?);
    /// lived.begin(0, &[10], 0, 0)?;
    /// for frame in [11, 12] {
    ///     let (streams, actions, rewards, values) = (&[0], &[3], &[-1.0], &[0.5]);
    ///     lived.append(Steps { streams, actions, rewards, values, frames: &[frame], ..Steps::default() })?;
    /// }
    /// let id = lived.finish(0, Outcome::Failure)?;
    /// let ids = kept.collect(0, &lived, &[id], Some(&[1]))?;
    /// assert_eq!(kept.gather(&ids)?.observations, [10, 11]);
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    pub fn collect(
        &mut self,
        stream: i64,
        other: &Self,
        ids: &[i64],
        steps: Option<&[i64]>,
    ) -> Result<Vec<i64>> {
        check_same_kind(&self.config, &other.config)?;
        let place = self.stream(stream)?;
        if self.open[place].is_some() {
            return Err(Error::Protocol {
                call: "collect",
                stream: place,
                expected: "a stream between episodes",
                found: "an open episode",
            });
        }
        let found = ids.iter().map(|&id| other.episode(id));
        let episodes = found.collect::<Result<Vec<_>>>()?;
        let lengths = self.lengths(place, &episodes, steps)?;
        let mut room = Records::default();
        let pairs = episodes.into_iter().zip(lengths);
        pairs
            .map(|(episode, length)| {
                let copied = self.copy(stream, other, episode, length, &mut room);
                if copied.is_err() && self.open[place].is_some() {
                    self.abort(stream)?;
                }
                copied
            })
            .collect()
    }

    /// How many steps of each episode are copied.
    fn lengths(
        &self,
        stream: usize,
        episodes: &[&Episode],
        steps: Option<&[i64]>,
    ) -> Result<Vec<usize>> {
        let whole = episodes.iter().map(|episode| episode.len());
        let lengths: Vec<usize> = match steps {
            None => whole.collect(),
            Some(steps) => {
                check_shape("steps", &[episodes.len()], &[steps.len()])?;
                for (&count, whole) in steps.iter().zip(whole) {
                    if count < 1 || class_of(count) > whole {
                        return Err(Error::Argument {
                            field: "steps",
                            expected: format!("1 to {whole} of an episode of {whole} steps"),
                            got: count.to_string(),
                        });
                    }
                }
                steps.iter().map(|&count| class_of(count)).collect()
            }
        };
        let limit = self.config.max_episode_steps;
        if lengths.iter().any(|&length| length > limit) {
            return Err(Error::TooManySteps { stream, limit });
        }
        Ok(lengths)
    }

    fn copy(
        &mut self,
        stream: i64,
        other: &Self,
        episode: &Episode,
        length: usize,
        room: &mut Records,
    ) -> Result<i64> {
        room.read(other, episode.frames[0]);
        let first: Vec<&[u8]> = other
            .config
            .fields
            .iter()
            .zip(&room.fields)
            .map(|(field, bytes)| match field.per {
                Per::Observation => &bytes[..],
                Per::Step => &[],
            })
            .collect();
        self.begin_with(
            stream,
            Opening {
                frame: &room.frame,
                goal: episode.goal,
                interaction: episode.interaction,
                desired: &episode.desired,
                achieved: &room.achieved,
                fields: &first,
            },
        )?;
        let dim = self.config.action_dim;
        for step in 0..length {
            room.read(other, episode.frames[step + 1]);
            let fields: Vec<&[u8]> = room.fields.iter().map(Vec::as_slice).collect();
            self.append(Steps {
                streams: &[stream],
                actions: episode.actions.get(step..=step).unwrap_or_default(),
                vectors: &episode.vectors[step * dim..][..dim],
                rewards: &episode.rewards[step..=step],
                values: &episode.values[step..=step],
                frames: &room.frame,
                achieved: &room.achieved,
                fields: &fields,
            })?;
        }
        let is_terminated = episode.is_terminated && length == episode.len();
        self.finish_with(stream, episode.outcome, is_terminated)
    }
}

/// What lies under the number of a frame, unpacked.
#[derive(Default)]
struct Records {
    frame: Vec<u8>,
    achieved: Vec<u8>,
    fields: Vec<Vec<u8>>,
}

impl Records {
    fn read(&mut self, buffer: &EpisodeBuffer, slot: usize) {
        let read = |slab: &Slab, bytes: &mut Vec<u8>| {
            bytes.clear();
            slab.append_to(slot, bytes);
        };
        read(&buffer.slab, &mut self.frame);
        if buffer.config.vector_bytes().is_some() {
            read(&buffer.achieved, &mut self.achieved);
        }
        self.fields.resize_with(buffer.fields.len(), Vec::new);
        for (slab, bytes) in buffer.fields.iter().zip(&mut self.fields) {
            read(slab, bytes);
        }
    }
}

/// Refuses a buffer whose episodes are of another kind.
pub(super) fn check_same_kind(here: &EpisodeConfig, there: &EpisodeConfig) -> Result<()> {
    let is_same = [
        ("frame_shape", here.frame_shape == there.frame_shape),
        ("dtype", here.frame_item == there.frame_item),
        ("frame_stack", here.frame_stack == there.frame_stack),
        ("stacking", here.stacking == there.stacking),
        ("goals", here.goal_kind == there.goal_kind),
        ("fields", here.fields == there.fields),
        ("num_goals", here.num_goals == there.num_goals),
        ("num_actions", here.num_actions == there.num_actions),
        ("first_action", here.first_action == there.first_action),
        ("action_dim", here.action_dim == there.action_dim),
        (
            "interactions",
            (here.num_interactions, &here.interactions)
                == (there.num_interactions, &there.interactions),
        ),
    ];
    match is_same.into_iter().find(|(_, is_same)| !is_same) {
        None => Ok(()),
        Some((name, _)) => Err(Error::Argument {
            field: "buffer",
            expected: "one of the same kind of episodes".into(),
            got: format!("another `{name}`"),
        }),
    }
}
