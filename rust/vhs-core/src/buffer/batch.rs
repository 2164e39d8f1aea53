//! Batches of whole episodes, ready for a learner: observations, padded steps and a mask.
//!
//! Observations are packed by default, episode by episode `o_0 ..= o_T`, because padding images wastes
//! memory and time; [`Layout::Padded`] is for learners that want a rectangle. The small per-step arrays are
//! always padded with zeros to the longest episode.

use crate::buffer::collect::check_same_kind;
use crate::buffer::config::EpisodeConfig;
use crate::buffer::episode::Episode;
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::{Field, Per};
use crate::buffer::layer::Layer;
use crate::hindsight::rule::{EpisodeEnd, Hindsight, Rule};
use crate::labels::{class_of, label_of};
use crate::storage::pool::Bytes;
use crate::storage::slab::copy_parts;
use vhs_base::check::{self, check_range, check_shape};
use vhs_base::error::{Error, Result};
use vhs_base::interrupt;
use vhs_base::rng::Rng;

/// A finished episode and the buffer that holds it.
type Held<'a> = (&'a EpisodeBuffer, &'a Episode);

/// How observations lie in a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// One episode after the other, without gaps.
    #[default]
    Packed,
    /// `[B, T + 1]` observations, zeros after the end of an episode.
    Padded,
}

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
    /// Rows of observations: the sum of all `lengths + 1`, or `B * (T + 1)` where padded.
    pub rows: usize,
    /// Numbered actions, `[B, T]`, zero after the end; empty where actions are continuous.
    pub actions: Vec<i64>,
    /// Continuous actions, `[B, T, action_dim]`, zero after the end; empty where actions are numbered.
    pub vectors: Vec<f32>,
    /// Whether each episode's last step ended the task, `[B]`.
    pub terminated: Vec<bool>,
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
    /// Observations, `[rows, *observation_shape]`, packed.
    pub observations: Bytes,
    /// The goals that episodes were told, `[B, *goal]`; empty where those are class numbers alone.
    pub desired_goals: Bytes,
    /// Goal vectors reached by each observation, laid out as these; empty where observations are what is
    /// reached.
    pub achieved_goals: Bytes,
    /// Each field: of observations laid out as these, `[rows, *row_shape]`; of steps `[B, T, *shape]`, zero
    /// after the end.
    pub fields: Vec<Bytes>,
    /// Everything else.
    pub index: BatchIndex,
}

impl BatchIndex {
    /// An index with zeroed steps, which `add` fills episode by episode.
    fn with_room(episodes: &[Held<'_>], action_dim: usize) -> Result<Self> {
        let longest = episodes
            .iter()
            .map(|(_, episode)| episode.len())
            .max()
            .unwrap_or_default();
        let wide = action_dim.max(1);
        let bytes = check::product("ids", &[episodes.len(), longest, wide, size_of::<i64>()])?;
        let cells = bytes / wide / size_of::<i64>();
        let numbered = if action_dim == 0 { cells } else { 0 };
        let mut actions = check::with_room("gather", numbered)?;
        actions.resize(numbered, 0);
        let mut vectors = check::with_room("gather", cells * action_dim)?;
        vectors.resize(cells * action_dim, 0.0);
        let (rewards, values, mask) = (vec![0.0; cells], vec![0.0; cells], vec![false; cells]);
        Ok(Self {
            longest,
            actions,
            vectors,
            rewards,
            values,
            mask,
            ..Self::default()
        })
    }

    fn add(&mut self, id: i64, episode: &Episode, layout: Layout, config: &EpisodeConfig) {
        let (row, length, dim) = (self.rows, episode.len(), config.action_dim);
        let start = self.ids.len() * self.longest;
        let steps = start..start + length;
        if dim == 0 {
            self.actions[steps.clone()].copy_from_slice(episode.actions());
        }
        self.vectors[steps.start * dim..steps.end * dim].copy_from_slice(episode.action_vectors());
        self.rewards[steps.clone()].copy_from_slice(episode.rewards());
        self.values[steps.clone()].copy_from_slice(episode.values());
        self.mask[steps].fill(true);
        self.ids.push(id);
        self.offsets.push(label_of(row));
        self.lengths.push(label_of(length));
        self.goals.push(episode.goal());
        self.interactions.push(episode.interaction());
        self.outcomes.push(episode.outcome() as u8);
        self.terminated.push(episode.is_terminated());
        self.ends.push(EpisodeEnd {
            outcome: episode.outcome(),
            interaction: episode.interaction(),
            // A continuous action does none.
            done: config.interaction_of(episode.actions().last()),
            final_row: label_of(row + length),
            steps: label_of(length),
        });
        self.rows += match layout {
            Layout::Packed => length + 1,
            Layout::Padded => self.longest + 1,
        };
    }
}

impl EpisodeBuffer {
    /// Copies the episodes into a new batch, packed. An id may come more than once.
    ///
    /// # Errors
    /// [`Error::Evicted`], [`Error::UnknownEpisode`], [`Error::Argument`] for no id,
    /// [`Error::Memory`].
    pub fn gather(&self, ids: &[i64]) -> Result<Batch> {
        self.gather_as(ids, Layout::Packed)
    }

    /// As [`EpisodeBuffer::gather`], in a layout of choice.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::gather`].
    pub fn gather_as(&self, ids: &[i64], layout: Layout) -> Result<Batch> {
        self.gather_with(ids, None, layout)
    }

    /// As [`EpisodeBuffer::gather_as`], followed by episodes of another buffer of the same kind.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::gather`], and [`Error::Argument`] for a buffer of another kind.
    pub fn gather_with(
        &self,
        ids: &[i64],
        also: Option<(&Self, &[i64])>,
        layout: Layout,
    ) -> Result<Batch> {
        let (episodes, index) = self.index(ids, also, layout)?;
        let bytes = check::product("ids", &[index.rows, self.observation_bytes()])?;
        let mut observations = Bytes::take("gather", bytes)?;
        self.write_packed(
            &episodes,
            &index,
            self.observation_bytes(),
            &mut observations,
        )?;
        self.with_parts(&episodes, index, observations)
    }

    /// As [`EpisodeBuffer::gather_with`], with the observations written over the beginning of `out`; those of
    /// the result are empty.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::gather`], and [`Error::Shape`] where `out` has fewer bytes than the
    /// batch needs.
    pub fn gather_into(
        &self,
        ids: &[i64],
        also: Option<(&Self, &[i64])>,
        layout: Layout,
        out: &mut [u8],
    ) -> Result<Batch> {
        let (episodes, index) = self.index(ids, also, layout)?;
        let row_bytes = self.observation_bytes();
        let bytes = check::product("ids", &[index.rows, row_bytes])?;
        if out.len() < bytes {
            check_shape(
                "out",
                &[index.rows, row_bytes],
                &[out.len() / row_bytes, row_bytes],
            )?;
        }
        self.write_packed(&episodes, &index, row_bytes, &mut out[..bytes])?;
        self.with_parts(&episodes, index, Bytes::default())
    }

    /// Adds the goals that episodes were told, those that vectors say were reached, and the fields.
    fn with_parts(
        &self,
        episodes: &[Held<'_>],
        index: BatchIndex,
        observations: Bytes,
    ) -> Result<Batch> {
        let desired = check::product("ids", &[episodes.len(), self.config.desired_bytes()])?;
        let mut desired_goals = Bytes::take("gather", desired)?;
        copy_parts(
            episodes.iter().map(|(_, episode)| episode.desired()),
            &mut desired_goals,
        );
        let vector = self.config.vector_bytes().unwrap_or_default();
        let reached = check::product("ids", &[index.rows, vector])?;
        let mut achieved_goals = Bytes::take("gather", reached)?;
        if vector > 0 {
            self.write_rows(&index, vector, &mut achieved_goals, |place, out| {
                let (buffer, episode) = episodes[place];
                for (t, row) in out.chunks_exact_mut(vector).enumerate() {
                    buffer.write_reached(episode, t, row);
                }
            })?;
        }
        Ok(Batch {
            observations,
            desired_goals,
            achieved_goals,
            fields: self.gather_fields(episodes, &index)?,
            index,
        })
    }

    fn gather_fields(&self, episodes: &[Held<'_>], index: &BatchIndex) -> Result<Vec<Bytes>> {
        let gather = |(number, field): (usize, &Field)| {
            let row = field.row_bytes(self.config.frame_stack);
            let rows = match field.per {
                Per::Observation => index.rows,
                Per::Step => episodes.len() * index.longest,
            };
            let mut out = Bytes::take("gather", check::product("ids", &[rows, row])?)?;
            match field.per {
                Per::Observation => self.write_rows(index, row, &mut out, |place, out| {
                    let (buffer, episode) = episodes[place];
                    buffer.layer(number).write_all(episode, 0, row, out);
                })?,
                Per::Step => {
                    let cells = out.chunks_exact_mut(index.longest * row);
                    for ((buffer, episode), cells) in episodes.iter().zip(cells) {
                        let (steps, padding) = cells.split_at_mut(episode.len() * row);
                        buffer.layer(number).write_all(episode, 1, row, steps);
                        padding.fill(0);
                    }
                }
            }
            Ok(out)
        };
        self.config.fields.iter().enumerate().map(gather).collect()
    }

    /// Every frame of every observation of the episodes.
    fn write_packed(
        &self,
        episodes: &[Held<'_>],
        index: &BatchIndex,
        row_bytes: usize,
        out: &mut [u8],
    ) -> Result<()> {
        self.write_rows(index, row_bytes, out, |place, out| {
            let (buffer, episode) = episodes[place];
            buffer.frames().write_all(episode, 0, row_bytes, out);
        })
    }

    /// Hands the rows of each episode to `write`, and zeros those between episodes.
    #[expect(clippy::unused_self, reason = "reads as a step of the two above")]
    fn write_rows(
        &self,
        index: &BatchIndex,
        row_bytes: usize,
        mut out: &mut [u8],
        write: impl Fn(usize, &mut [u8]),
    ) -> Result<()> {
        for (place, &length) in index.lengths.iter().enumerate() {
            let next = index.offsets.get(place + 1);
            let end = next.map_or(index.rows, |&row| class_of(row));
            let (rows, rest) = out.split_at_mut((end - class_of(index.offsets[place])) * row_bytes);
            let (used, padding) = rows.split_at_mut((class_of(length) + 1) * row_bytes);
            interrupt::check()?;
            write(place, used);
            padding.fill(0);
            out = rest;
        }
        Ok(())
    }

    /// Draws ids of `n` finished episodes, uniformly and with replacement.
    ///
    /// # Errors
    /// [`Error::Empty`] where no finished episode is stored, [`Error::Argument`] for `n = 0`,
    /// [`Error::Memory`].
    pub fn draw_ids(&mut self, n: usize) -> Result<Vec<i64>> {
        self.with_rng(|buffer, rng| buffer.draw_ids_with(n, rng))
    }

    /// As [`EpisodeBuffer::draw_ids`], from a generator of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::draw_ids`].
    pub fn draw_ids_with(&self, n: usize, rng: &mut Rng) -> Result<Vec<i64>> {
        check_range("n", n, 1, usize::MAX)?;
        if self.is_empty() {
            return Err(Error::Empty {
                place: "EpisodeBuffer".into(),
                item: "finished episode",
            });
        }
        let (first, count) = (self.first_id(), self.len());
        let mut ids = check::with_room("sample_episodes", n)?;
        ids.extend((0..n).map(|_| first + label_of(rng.below(count))));
        Ok(ids)
    }

    /// Draws `n` finished episodes, uniformly and with replacement, and relabels them where a rule
    /// is given.
    ///
    /// The draws start at one number of the buffer's generator: first the episodes, then one draw an
    /// episode for the rule.
    ///
    /// ```
    /// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
    /// use vhs_core::outcome::Outcome;
    /// use vhs_core::relabel::Rule;
    /// # let mut buffer = EpisodeBuffer::new(EpisodeConfig {
    /// #     frame_shape: vec![2], max_episode_steps: 20, capacity_steps: 100, frame_stack: 2, num_goals: 5,
    /// #     num_interactions: 3, interactions: [(3, 0), (4, 1), (5, 2)].into(), ..EpisodeConfig::default()
    /// # })?;
    /// buffer.begin(0, &[10, 11], 4, 0)?; // goal 4, interaction 0
    /// let (streams, actions, rewards, values) = (&[0], &[5], &[-1.0], &[0.5]);
    /// buffer.append(Steps { streams, actions, rewards, values, frames: &[20, 21], ..Steps::default() })?;
    /// buffer.finish(0, Outcome::Failure)?;
    ///
    /// let rule = Rule::new([Outcome::Failure].into_iter().collect(), 1.0)?;
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
        self.with_rng(|buffer, rng| buffer.sample_with(n, rule, Layout::Packed, rng))
    }

    /// As [`EpisodeBuffer::sample`], in a layout of choice and from a generator of the caller: several threads
    /// may do so at the same time.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample`].
    pub fn sample_with(
        &self,
        n: usize,
        rule: Option<&Rule>,
        layout: Layout,
        rng: &mut Rng,
    ) -> Result<(Batch, Option<Hindsight>)> {
        let ids = self.draw_ids_with(n, rng)?;
        let batch = self.gather_as(&ids, layout)?;
        let hindsight = rule.map(|rule| rule.relabel(&batch.index.ends, rng));
        Ok((batch, hindsight))
    }

    /// The newest stacked observation of each of these streams, for acting.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Protocol`] where a stream has no open episode, [`Error::Memory`].
    pub fn observe(&self, streams: &[i64]) -> Result<Bytes> {
        let episodes = self.observed(streams)?;
        let bytes = check::product("streams", &[episodes.len(), self.observation_bytes()])?;
        let mut observations = Bytes::take("observe", bytes)?;
        self.write_newest(&episodes, &mut observations);
        Ok(observations)
    }

    /// As [`EpisodeBuffer::observe`], into memory of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::observe`], and [`Error::Shape`] where `out` is not as long as the
    /// observations.
    pub fn observe_into(&self, streams: &[i64], out: &mut [u8]) -> Result<()> {
        let episodes = self.observed(streams)?;
        let bytes = check::product("streams", &[episodes.len(), self.observation_bytes()])?;
        check_shape("out", &[bytes], &[out.len()])?;
        self.write_newest(&episodes, out);
        Ok(())
    }

    /// Each field of the newest observation of these streams; empty for those of steps.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::observe`].
    pub fn observe_fields(&self, streams: &[i64]) -> Result<Vec<Bytes>> {
        let episodes = self.observed(streams)?;
        let newest = |(field, layer): (&Field, Layer<'_>)| {
            let row = field.row_bytes(self.config.frame_stack);
            let rows = if field.per == Per::Step {
                0
            } else {
                episodes.len()
            };
            let mut out = Bytes::take("observe", check::product("streams", &[rows, row])?)?;
            for (episode, out) in episodes.iter().zip(out.chunks_exact_mut(row)) {
                layer.write(episode, episode.len(), out);
            }
            Ok(out)
        };
        self.layers().map(newest).collect()
    }

    fn index<'a>(
        &'a self,
        ids: &[i64],
        also: Option<(&'a Self, &[i64])>,
        layout: Layout,
    ) -> Result<(Vec<Held<'a>>, BatchIndex)> {
        check_range("ids", ids.len(), 1, usize::MAX)?;
        if let Some((other, _)) = also {
            check_same_kind(&self.config, &other.config)?;
        }
        let others = also.map(|(other, ids)| ids.iter().map(move |&id| (other, id)));
        let all = ids.iter().map(|&id| (self, id));
        let all: Vec<_> = all.chain(others.into_iter().flatten()).collect();
        let held = all
            .iter()
            .map(|&(buffer, id)| Ok((buffer, buffer.episode(id)?)));
        let episodes = held.collect::<Result<Vec<_>>>()?;
        let mut index = BatchIndex::with_room(&episodes, self.config.action_dim)?;
        for (&(_, id), (_, episode)) in all.iter().zip(&episodes) {
            index.add(id, episode, layout, &self.config);
        }
        Ok((episodes, index))
    }

    fn observed(&self, streams: &[i64]) -> Result<Vec<&Episode>> {
        streams
            .iter()
            .map(|&stream| self.opened("observe", self.stream(stream)?))
            .collect()
    }

    fn write_newest(&self, episodes: &[&Episode], out: &mut [u8]) {
        let rows = out.chunks_exact_mut(self.observation_bytes());
        for (episode, row) in episodes.iter().zip(rows) {
            self.write_observation(episode, episode.len(), row);
        }
    }
}
