//! Batches of single transitions with hindsight goals, for off-policy learners.
//!
//! A transition is never stored: it is two neighbouring observations of an episode, stacked on the way out, so
//! a frame that several transitions show is still stored once.

use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::{Field, Per};
use crate::buffer::layer::Layer;
use crate::buffer::picks::{Goal, GoalIndex, Pick};
use crate::hindsight::reward::SparseReward;
use crate::hindsight::strategy::HindsightRule;
use crate::storage::pool::Bytes;
use vhs_base::check::{check_finite, check_shape, product};
use vhs_base::error::Result;
use vhs_base::interrupt;
use vhs_base::rng::Rng;

/// Everything of a batch but its images and goals: what is small. n transitions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransitionIndex {
    /// Where each is from, and its goal, `[n]` each.
    pub goals: GoalIndex,
    /// Numbered actions, `[n]`; empty where actions are continuous.
    pub actions: Vec<i64>,
    /// Continuous actions, `[n, action_dim]`; empty where actions are numbered.
    pub vectors: Vec<f32>,
    /// Rewards, `[n]`: by the reward rule where relabelled, else as recorded.
    pub rewards: Vec<f32>,
    /// Whether the task ended with this step, `[n]`: by the reward rule where relabelled.
    pub terminated: Vec<bool>,
    /// Whether a limit cut the episode off after this step, `[n]`.
    pub truncated: Vec<bool>,
    /// Each field, `[n, *row_shape]`: of `o_t`, or of the step.
    pub fields: Vec<Bytes>,
    /// Each field of observations of `o_(t+1)`, `[n, *row_shape]`; empty for those of steps.
    pub next_fields: Vec<Bytes>,
}

/// A batch with its images and goals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransitionBatch {
    /// Observations `o_t`, `[n, *observation_shape]`.
    pub observations: Bytes,
    /// Observations `o_(t+1)`, of the same shape.
    pub next_observations: Bytes,
    /// Goals, `[n, *goal]`: zeros where a row's goal is a class number alone; empty where all are.
    pub goals: Bytes,
    /// Goal vectors reached by `o_(t+1)`, `[n, *goal]`; empty where observations are what is reached.
    pub achieved_goals: Bytes,
    /// Goal vectors reached by `o_t`, `[n, *goal]`; empty where observations are what is reached.
    pub previous_achieved_goals: Bytes,
    /// Everything else.
    pub index: TransitionIndex,
}

/// Memory of the caller for the large parts of a batch, each exactly as long as the part.
#[derive(Debug)]
pub struct TransitionOut<'a> {
    /// For `observations`.
    pub observations: &'a mut [u8],
    /// For `next_observations`.
    pub next_observations: &'a mut [u8],
    /// For `goals`.
    pub goals: &'a mut [u8],
    /// For `achieved_goals`.
    pub achieved_goals: &'a mut [u8],
    /// For `previous_achieved_goals`.
    pub previous_achieved_goals: &'a mut [u8],
}

/// Bytes of the large parts of a batch of `n`, in the order of [`TransitionOut`].
pub type TransitionSizes = [usize; 5];

impl EpisodeBuffer {
    /// Draws `n` transitions of finished episodes, uniformly and with replacement, and relabels them where a
    /// rule is given. Relabelled ones are rewarded by `reward`; without one they keep what was recorded, for
    /// the caller to compute anew.
    ///
    /// ```
    /// use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
    /// use vhs_core::outcome::Outcome;
    /// use vhs_core::reward::SparseReward;
    /// use vhs_core::strategy::{HindsightRule, Share, Strategy};
    /// # let mut buffer = EpisodeBuffer::new(EpisodeConfig {
    /// #     frame_shape: vec![2], max_episode_steps: 20, capacity_steps: 100, ..EpisodeConfig::default()
    /// # })?;
    /// buffer.begin(0, &[10, 11], 0, 0)?;
    /// let (streams, actions, rewards, values) = (&[0], &[2], &[-1.0], &[0.5]);
    /// buffer.append(Steps { streams, actions, rewards, values, frames: &[20, 21], ..Steps::default() })?;
    /// buffer.finish(0, Outcome::Failure)?;
    ///
    /// let rule = HindsightRule::new(Strategy::Final, Share::Probability(1.0))?;
    /// let batch = buffer.sample_transitions(1, Some(&rule), Some(&SparseReward::default()))?;
    /// // The transition has reached its new goal.
    /// assert_eq!(batch.next_observations, batch.goals);
    /// assert_eq!((batch.index.rewards[0], batch.index.terminated[0]), (0.0, true));
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Empty`] where no finished episode is stored,
    /// [`vhs_base::error::Error::Argument`] for `n = 0` or a wrong reward, [`vhs_base::error::Error::Memory`].
    pub fn sample_transitions(
        &mut self,
        n: usize,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
    ) -> Result<TransitionBatch> {
        self.with_rng(|buffer, rng| buffer.sample_transitions_with(n, rule, reward, rng))
    }

    /// As [`EpisodeBuffer::sample_transitions`], drawing from a generator of the caller: several threads may
    /// do so at the same time.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_transitions`].
    pub fn sample_transitions_with(
        &self,
        n: usize,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
        rng: &mut Rng,
    ) -> Result<TransitionBatch> {
        let [observations, next_observations, goals, achieved, previous] =
            self.transition_sizes(n, rule)?;
        let mut batch = TransitionBatch {
            observations: Bytes::take("sample", observations)?,
            next_observations: Bytes::take("sample", next_observations)?,
            goals: Bytes::take("sample", goals)?,
            achieved_goals: Bytes::take("sample", achieved)?,
            previous_achieved_goals: Bytes::take("sample", previous)?,
            ..TransitionBatch::default()
        };
        let out = TransitionOut {
            observations: &mut batch.observations,
            next_observations: &mut batch.next_observations,
            goals: &mut batch.goals,
            achieved_goals: &mut batch.achieved_goals,
            previous_achieved_goals: &mut batch.previous_achieved_goals,
        };
        batch.index = self.sample_transitions_into(n, rule, reward, rng, out)?;
        Ok(batch)
    }

    /// As [`EpisodeBuffer::sample_transitions_with`], into memory of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_transitions`], and [`vhs_base::error::Error::Shape`] where a part of `out` is
    /// not as long as [`EpisodeBuffer::transition_sizes`] says.
    pub fn sample_transitions_into(
        &self,
        n: usize,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
        rng: &mut Rng,
        mut out: TransitionOut<'_>,
    ) -> Result<TransitionIndex> {
        reward.map_or(Ok(()), SparseReward::check)?;
        let got = [
            out.observations.len(),
            out.next_observations.len(),
            out.goals.len(),
            out.achieved_goals.len(),
            out.previous_achieved_goals.len(),
        ];
        check_shape("out", &self.transition_sizes(n, rule)?, &got)?;
        let picks = self.draw(n, rule, rng)?;
        self.write_transitions(&picks, &mut out)?;
        let mut index = self.transition_index(&picks, reward);
        index.fields = self.pick_fields(&picks, |pick, per| match per {
            Per::Observation => Some(pick.step),
            // Under the number of the frame that the step led to.
            Per::Step => Some(pick.step + 1),
        })?;
        index.next_fields = self.pick_fields(&picks, |pick, per| match per {
            Per::Observation => Some(pick.step + 1),
            Per::Step => None,
        })?;
        Ok(index)
    }

    /// Bytes of the large parts of a batch of `n` transitions.
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Argument`] for more than memory can address.
    pub fn transition_sizes(
        &self,
        n: usize,
        rule: Option<&HindsightRule>,
    ) -> Result<TransitionSizes> {
        let images = product("n", &[n, self.observation_bytes()])?;
        let goals = product("n", &[n, self.row_goal_bytes(rule)])?;
        let achieved = product("n", &[n, self.config.vector_bytes().unwrap_or_default()])?;
        Ok([images, images, goals, achieved, achieved])
    }

    /// Row by row: the frames that the three images of a row share are still in the cache then.
    fn write_transitions(&self, picks: &[Pick], out: &mut TransitionOut<'_>) -> Result<()> {
        let n = picks.len();
        let row = |bytes: usize, place: usize| place * (bytes / n)..(place + 1) * (bytes / n);
        let (images, goals, achieved) = (
            out.observations.len(),
            out.goals.len(),
            out.achieved_goals.len(),
        );
        for (place, pick) in picks.iter().enumerate() {
            interrupt::check()?;
            let episode = &self.finished[pick.episode];
            let (here, next) = (pick.step, pick.step + 1);
            self.write_observation(episode, here, &mut out.observations[row(images, place)]);
            self.write_observation(
                episode,
                next,
                &mut out.next_observations[row(images, place)],
            );
            if goals > 0 {
                self.write_goal(pick, &mut out.goals[row(goals, place)]);
            }
            if achieved > 0 {
                let row = row(achieved, place);
                self.write_reached(episode, next, &mut out.achieved_goals[row.clone()]);
                self.write_reached(episode, here, &mut out.previous_achieved_goals[row]);
            }
        }
        Ok(())
    }

    /// Each field at the rows that a function says, none of those for which it says None.
    fn pick_fields(
        &self,
        picks: &[Pick],
        row_of: impl Fn(&Pick, Per) -> Option<usize>,
    ) -> Result<Vec<Bytes>> {
        let copy = |(field, layer): (&Field, Layer<'_>)| {
            let row = field.row_bytes(self.config.frame_stack);
            let rows = picks
                .iter()
                .filter_map(|pick| Some((pick, row_of(pick, field.per)?)));
            let count = rows.clone().count();
            let mut out = Bytes::take("sample", product("n", &[count, row])?)?;
            for ((pick, t), out) in rows.zip(out.chunks_exact_mut(row)) {
                layer.write(&self.finished[pick.episode], t, out);
            }
            Ok(out)
        };
        self.layers().map(copy).collect()
    }

    fn transition_index(&self, picks: &[Pick], reward: Option<&SparseReward>) -> TransitionIndex {
        let mut index = TransitionIndex {
            goals: self.goal_index(picks),
            ..TransitionIndex::default()
        };
        let dim = self.config.action_dim;
        for pick in picks {
            let (episode, t) = (&self.finished[pick.episode], pick.step);
            let (reward, terminated, truncated) = self.consequence(pick, t, reward);
            index.actions.extend(episode.actions.get(t));
            index.vectors.extend(&episode.vectors[t * dim..][..dim]);
            index.rewards.push(reward);
            index.terminated.push(terminated);
            index.truncated.push(truncated);
        }
        index
    }

    /// Reward, terminated and truncated of a step under the goal of its row.
    pub(crate) fn consequence(
        &self,
        pick: &Pick,
        step: usize,
        rule: Option<&SparseReward>,
    ) -> (f32, bool, bool) {
        let episode = &self.finished[pick.episode];
        let is_last = step + 1 == episode.len();
        let ended = (
            is_last && episode.is_terminated,
            is_last && !episode.is_terminated,
        );
        match (pick.goal, rule) {
            (Goal::Told, _) | (_, None) => (episode.rewards[step], ended.0, ended.1),
            (_, Some(rule)) if self.is_reached(pick, step, rule.tolerance) => {
                // A step that ends the task is not cut off, even where a limit came at the same time.
                let terminated = rule.terminates;
                (rule.reached, terminated, is_last && !terminated)
            }
            // The environment ended the episode for the old goal's sake: under the new one it was cut off.
            (_, Some(rule)) => (rule.otherwise, false, is_last),
        }
    }
}

impl TransitionIndex {
    /// Takes the rewards, and whether the task ended, that a function of the caller gave for all `n` rows;
    /// only relabelled rows are changed.
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Shape`] and [`vhs_base::error::Error::NonFinite`].
    pub fn set_relabelled(&mut self, rewards: &[f32], terminated: Option<&[bool]>) -> Result<()> {
        check_new(self.rewards.len(), rewards, terminated)?;
        let relabelled = &self.goals.relabelled;
        let row = |place: usize| relabelled[place];
        replace_rewards(&mut self.rewards, rewards, row);
        replace_ends(&mut self.terminated, &mut self.truncated, terminated, row);
        Ok(())
    }
}

/// Checks what a caller's function gave for `len` steps, before any of it is taken.
pub(crate) fn check_new(len: usize, rewards: &[f32], terminated: Option<&[bool]>) -> Result<()> {
    check_shape("reward", &[len], &[rewards.len()])?;
    check_finite("reward", rewards)?;
    terminated.map_or(Ok(()), |ends| {
        check_shape("terminated", &[len], &[ends.len()])
    })
}

/// Puts the new rewards where `is_new` says so.
pub(crate) fn replace_rewards(old: &mut [f32], new: &[f32], is_new: impl Fn(usize) -> bool) {
    for (place, (old, &new)) in old.iter_mut().zip(new).enumerate() {
        if is_new(place) {
            *old = new;
        }
    }
}

/// Puts the new ends where `is_new` says so. What was the end of an episode stays one: it is cut off where it
/// is not terminated.
pub(crate) fn replace_ends(
    terminated: &mut [bool],
    truncated: &mut [bool],
    new: Option<&[bool]>,
    is_new: impl Fn(usize) -> bool,
) {
    for (place, &new) in new.unwrap_or_default().iter().enumerate() {
        if is_new(place) {
            truncated[place] = (truncated[place] || terminated[place]) && !new;
            terminated[place] = new;
        }
    }
}
