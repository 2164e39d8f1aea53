//! Batches of whole episodes, ready for a learner: packed observations, padded steps and a mask.
//!
//! Observations are packed, episode by episode `o_0 ..= o_T`, because padding images would waste
//! memory and time; the small per-step arrays are padded with zeros to the longest episode.

use crate::episodes::{Episode, EpisodeBuffer};
use crate::error::{self, Error, Result, check_range, check_shape};
use crate::goals::label_of;
use crate::relabel::{EpisodeEnd, Hindsight, Rule};
use crate::slab::copy_parts;

/// Everything of a batch but its images. B episodes, T steps in the longest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BatchIndex {
    /// Id of each episode, `[B]`.
    pub ids: Vec<i64>,
    /// Row of each episode's `o_0`, `[B]`.
    pub offsets: Vec<i64>,
    /// Steps of each episode, `[B]`.
    pub lengths: Vec<i64>,
    /// Instructed goal class, `[B]`.
    pub goals: Vec<i64>,
    /// Instructed interaction, `[B]`.
    pub interactions: Vec<i64>,
    /// Number of the outcome, `[B]`.
    pub outcomes: Vec<u8>,
    /// Steps of the longest episode: T.
    pub longest: usize,
    /// Rows of observations: the sum of all `lengths + 1`.
    pub rows: usize,
    /// Actions, `[B, T]`, zero after the end.
    pub actions: Vec<i64>,
    /// Rewards, `[B, T]`, zero after the end.
    pub rewards: Vec<f32>,
    /// Critic values when acting, `[B, T]`, zero after the end.
    pub values: Vec<f32>,
    /// True inside the episode, `[B, T]`.
    pub mask: Vec<bool>,
    /// What relabelling needs, `[B]`.
    pub ends: Vec<EpisodeEnd>,
}

/// A batch with its images.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Stacked observations, `[rows, frame_stack, *frame_shape]`, packed.
    pub observations: Vec<u8>,
    /// Everything else.
    pub index: BatchIndex,
}

impl BatchIndex {
    /// An index with zeroed steps, which `add` fills episode by episode.
    fn with_room(episodes: &[&Episode]) -> Result<Self> {
        let longest = episodes
            .iter()
            .map(|episode| episode.len())
            .max()
            .unwrap_or_default();
        let cells =
            error::product("ids", &[episodes.len(), longest, size_of::<i64>()])? / size_of::<i64>();
        let mut actions = error::with_room("gather", cells)?;
        actions.resize(cells, 0);
        let (rewards, values, mask) = (vec![0.0; cells], vec![0.0; cells], vec![false; cells]);
        Ok(Self {
            longest,
            actions,
            rewards,
            values,
            mask,
            ..Self::default()
        })
    }

    fn add(&mut self, id: i64, episode: &Episode) {
        let (row, length) = (self.rows, episode.len());
        let start = self.ids.len() * self.longest;
        let steps = start..start + length;
        self.actions[steps.clone()].copy_from_slice(episode.actions());
        self.rewards[steps.clone()].copy_from_slice(episode.rewards());
        self.values[steps.clone()].copy_from_slice(episode.values());
        self.mask[steps].fill(true);
        self.ids.push(id);
        self.offsets.push(label_of(row));
        self.lengths.push(label_of(length));
        self.goals.push(episode.goal());
        self.interactions.push(episode.interaction());
        self.outcomes.push(episode.outcome() as u8);
        self.ends.push(EpisodeEnd {
            outcome: episode.outcome(),
            interaction: episode.interaction(),
            last_action: episode.actions().last().copied().unwrap_or_default(),
            final_row: label_of(row + length),
        });
        self.rows = row + length + 1;
    }
}

impl EpisodeBuffer {
    /// Copies the episodes into a new batch. An id may come more than once.
    ///
    /// # Errors
    /// [`Error::Evicted`], [`Error::UnknownEpisode`], [`Error::Argument`] for no id,
    /// [`Error::Memory`].
    pub fn gather(&self, ids: &[i64]) -> Result<Batch> {
        let (episodes, index) = self.index(ids)?;
        let bytes = error::product("ids", &[index.rows, self.observation_bytes()])?;
        let mut observations = error::with_room("gather", bytes)?;
        self.packed(&episodes)
            .for_each(|frame| observations.extend_from_slice(frame));
        Ok(Batch {
            observations,
            index,
        })
    }

    /// As [`EpisodeBuffer::gather`], with the observations written over the beginning of `out`.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::gather`], and [`Error::Shape`] where `out` has fewer bytes than the
    /// batch needs.
    pub fn gather_into(&self, ids: &[i64], out: &mut [u8]) -> Result<BatchIndex> {
        let (episodes, index) = self.index(ids)?;
        let row_bytes = self.observation_bytes();
        let bytes = error::product("ids", &[index.rows, row_bytes])?;
        if out.len() < bytes {
            check_shape(
                "out",
                &[index.rows, row_bytes],
                &[out.len() / row_bytes, row_bytes],
            )?;
        }
        copy_parts(self.packed(&episodes), out);
        Ok(index)
    }

    /// Draws ids of `n` finished episodes, uniformly and with replacement.
    ///
    /// # Errors
    /// [`Error::Empty`] where no finished episode is stored, [`Error::Argument`] for `n = 0`,
    /// [`Error::Memory`].
    pub fn draw_ids(&mut self, n: usize) -> Result<Vec<i64>> {
        check_range("n", n, 1, usize::MAX)?;
        if self.is_empty() {
            return Err(Error::Empty {
                place: "EpisodeBuffer".into(),
                item: "finished episode",
            });
        }
        let (first, count) = (self.ids().next().unwrap_or_default(), self.len());
        let mut ids = error::with_room("sample_episodes", n)?;
        ids.extend((0..n).map(|_| first + label_of(self.rng_mut().below(count))));
        Ok(ids)
    }

    /// Draws `n` finished episodes, uniformly and with replacement, and relabels them where a rule
    /// is given.
    ///
    /// The draws come from the buffer's own generator: first the episodes, then one draw an episode
    /// for the rule.
    ///
    /// ```
    /// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
    /// use vhs_core::outcome::Outcome;
    /// use vhs_core::relabel::Rule;
    /// # let mut buffer = EpisodeBuffer::new(EpisodeConfig {
    /// #     frame_shape: vec![2], num_streams: 1, max_episode_steps: 20, capacity_steps: 100,
    /// #     frame_stack: 2, num_goals: 5, num_interactions: 3, first_interaction_action: 3, seed: 0,
    /// # })?;
    /// buffer.begin(0, &[10, 11], 4, 0)?; // goal 4, interaction 0
    /// let (streams, actions, rewards, values) = (&[0], &[5], &[-1.0], &[0.5]);
    /// buffer.append(Steps { streams, actions, rewards, values, frames: &[20, 21] })?;
    /// buffer.finish(0, Outcome::Failure)?;
    ///
    /// let rule = Rule::new([Outcome::Failure].into_iter().collect(), 1.0, 3)?;
    /// let (batch, hindsight) = buffer.sample(1, Some(&rule))?;
    /// let hindsight = hindsight.expect("a rule was given");
    /// // The goal is now the final observation, row 1 of the batch, and action 5 did interaction 2.
    /// assert_eq!((hindsight.goal_rows[0], hindsight.interactions[0]), (1, 2));
    /// assert_eq!(batch.observations[4..], [10, 11, 20, 21]);
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`EpisodeBuffer::draw_ids`] and [`EpisodeBuffer::gather`].
    pub fn sample(&mut self, n: usize, rule: Option<&Rule>) -> Result<(Batch, Option<Hindsight>)> {
        let ids = self.draw_ids(n)?;
        let batch = self.gather(&ids)?;
        let hindsight = rule.map(|rule| rule.relabel(&batch.index.ends, self.rng_mut()));
        Ok((batch, hindsight))
    }

    /// The newest stacked observation of each of these streams, for acting.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Protocol`] where a stream has no open episode, [`Error::Memory`].
    pub fn observe(&self, streams: &[i64]) -> Result<Vec<u8>> {
        let episodes = self.observed(streams)?;
        let bytes = error::product("streams", &[episodes.len(), self.observation_bytes()])?;
        let mut observations = error::with_room("observe", bytes)?;
        self.newest(&episodes)
            .for_each(|frame| observations.extend_from_slice(frame));
        Ok(observations)
    }

    /// As [`EpisodeBuffer::observe`], into memory of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::observe`], and [`Error::Shape`] where `out` is not as long as the
    /// observations.
    pub fn observe_into(&self, streams: &[i64], out: &mut [u8]) -> Result<()> {
        let episodes = self.observed(streams)?;
        let bytes = error::product("streams", &[episodes.len(), self.observation_bytes()])?;
        check_shape("out", &[bytes], &[out.len()])?;
        copy_parts(self.newest(&episodes), out);
        Ok(())
    }

    fn index(&self, ids: &[i64]) -> Result<(Vec<&Episode>, BatchIndex)> {
        check_range("ids", ids.len(), 1, usize::MAX)?;
        let episodes: Vec<_> = ids
            .iter()
            .map(|&id| self.episode(id))
            .collect::<Result<_>>()?;
        let mut index = BatchIndex::with_room(&episodes)?;
        ids.iter()
            .zip(&episodes)
            .for_each(|(&id, episode)| index.add(id, episode));
        Ok((episodes, index))
    }

    /// Every frame of every observation of the episodes, in the order of a batch.
    fn packed<'a>(&'a self, episodes: &'a [&Episode]) -> impl Iterator<Item = &'a [u8]> {
        let observations = episodes
            .iter()
            .flat_map(|episode| (0..=episode.len()).map(move |t| (episode, t)));
        observations.flat_map(|(episode, t)| self.observation_frames(episode, t))
    }

    fn observed(&self, streams: &[i64]) -> Result<Vec<&Episode>> {
        streams
            .iter()
            .map(|&stream| self.opened("observe", self.stream(stream)?))
            .collect()
    }

    fn newest<'a>(&'a self, episodes: &'a [&Episode]) -> impl Iterator<Item = &'a [u8]> {
        episodes
            .iter()
            .flat_map(|episode| self.observation_frames(episode, episode.len()))
    }
}
