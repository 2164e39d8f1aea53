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
use crate::labels::{class_of, label_of};
use crate::storage::pool::Bytes;
use vhs_base::check::{check_finite, check_fraction, check_range, check_shape, product};
use vhs_base::error::{Error, Result};
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
    /// Rewards, `[n]`: by the reward rule where relabelled, else as recorded; discounted sums of several steps'.
    pub rewards: Vec<f32>,
    /// Whether the task ended with the last of a row's steps, `[n]`: by the reward rule where relabelled.
    pub terminated: Vec<bool>,
    /// Whether a limit cut the episode off after that step, `[n]`.
    pub truncated: Vec<bool>,
    /// Steps that each row's reward is summed over, `[n]`: m. Empty where there is no gamma: it is 1.
    pub lengths: Vec<i64>,
    /// gamma^m, which what is expected after those steps is worth, `[n]`; empty where there is no gamma.
    pub discounts: Vec<f32>,
    /// What undoes the priorities, `[n]`; empty where all steps were equally likely.
    pub weights: Vec<f32>,
    /// Each field, `[n, *row_shape]`: of `o_t`, or of the step.
    pub fields: Vec<Bytes>,
    /// Each field of observations of `o_(t+m)`, `[n, *row_shape]`; empty for those of steps.
    pub next_fields: Vec<Bytes>,
}

/// What is to be drawn.
#[derive(Clone, Copy, Debug)]
pub struct TransitionDraw<'a> {
    /// Transitions, at least 1.
    pub n: usize,
    /// How they are relabelled.
    pub rule: Option<&'a HindsightRule>,
    /// How relabelled ones are rewarded; None: they keep what was recorded.
    pub reward: Option<&'a SparseReward>,
    /// Steps that a reward is summed over at most, at least 1: fewer where the episode or, under the goal of its
    /// row, the task ends before.
    pub n_step: usize,
    /// Discount of a step, in 0..=1; needed above one step.
    pub gamma: Option<f64>,
    /// None: all steps are equally likely. Some: in proportion to their priorities, of which weights undo so much,
    /// in 0..=1.
    pub beta: Option<f64>,
}

impl Default for TransitionDraw<'_> {
    /// One step, as it was recorded.
    fn default() -> Self {
        Self {
            n: 1,
            rule: None,
            reward: None,
            n_step: 1,
            gamma: None,
            beta: None,
        }
    }
}

impl TransitionDraw<'_> {
    fn check(&self) -> Result<()> {
        check_range("n_step", self.n_step, 1, 1 << 20)?;
        check_fraction("gamma", self.gamma.unwrap_or_default())?;
        if self.n_step > 1 && self.gamma.is_none() {
            return Err(Error::Argument {
                field: "gamma",
                expected: "a discount in 0..=1 beside n_step".into(),
                got: "none".into(),
            });
        }
        check_fraction("beta", self.beta.unwrap_or_default())?;
        self.reward.map_or(Ok(()), SparseReward::check)
    }
}

/// A batch with its images and goals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransitionBatch {
    /// Observations `o_t`, `[n, *observation_shape]`.
    pub observations: Bytes,
    /// Observations `o_(t+m)` after the steps of each row, of the same shape.
    pub next_observations: Bytes,
    /// Goals, `[n, *goal]`: zeros where a row's goal is a class number alone; empty where all are.
    pub goals: Bytes,
    /// Goal vectors reached by `o_(t+m)`, `[n, *goal]`; empty where observations are what is reached.
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
        let draw = TransitionDraw {
            n,
            rule,
            reward,
            ..TransitionDraw::default()
        };
        self.with_rng(|buffer, rng| buffer.sample_transitions_with(&draw, rng))
    }

    /// As [`EpisodeBuffer::sample_transitions`], with all that can be said of a draw, from a generator of the
    /// caller: several threads may do so at the same time.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_transitions`]; [`vhs_base::error::Error::Argument`] for a number out of range, or a
    /// `beta` where the buffer has no priorities.
    pub fn sample_transitions_with(
        &self,
        draw: &TransitionDraw<'_>,
        rng: &mut Rng,
    ) -> Result<TransitionBatch> {
        let [observations, next_observations, goals, achieved, previous] =
            self.transition_sizes(draw.n, draw.rule)?;
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
        batch.index = self.sample_transitions_into(draw, rng, out)?;
        Ok(batch)
    }

    /// As [`EpisodeBuffer::sample_transitions_with`], into memory of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_transitions_with`], and [`vhs_base::error::Error::Shape`] where a part of `out` is
    /// not as long as [`EpisodeBuffer::transition_sizes`] says.
    pub fn sample_transitions_into(
        &self,
        draw: &TransitionDraw<'_>,
        rng: &mut Rng,
        mut out: TransitionOut<'_>,
    ) -> Result<TransitionIndex> {
        draw.check()?;
        let got = [
            out.observations.len(),
            out.next_observations.len(),
            out.goals.len(),
            out.achieved_goals.len(),
            out.previous_achieved_goals.len(),
        ];
        check_shape("out", &self.transition_sizes(draw.n, draw.rule)?, &got)?;
        let picks = self.draw_transitions(draw, rng)?;
        let mut index = self.transition_index(&picks, draw);
        if let Some(beta) = draw.beta {
            let places = picks.iter().map(|pick| (pick.episode, pick.step));
            index.weights = self.importance(places, beta)?;
        }
        // A step where no gamma makes it a sum of several.
        let length = |place: usize| index.lengths.get(place).map_or(1, |&steps| class_of(steps));
        let next = |place: usize| picks[place].step + length(place);
        self.write_transitions(&picks, &next, &mut out)?;
        let fields = self.pick_fields(&picks, |place, per| match per {
            Per::Observation => Some(picks[place].step),
            // Under the number of the frame that the step led to.
            Per::Step => Some(picks[place].step + 1),
        })?;
        let next_fields = self.pick_fields(&picks, |place, per| match per {
            Per::Observation => Some(next(place)),
            Per::Step => None,
        })?;
        Ok(TransitionIndex {
            fields,
            next_fields,
            ..index
        })
    }

    fn draw_transitions(&self, draw: &TransitionDraw<'_>, rng: &mut Rng) -> Result<Vec<Pick>> {
        self.check_drawable(draw.n)?;
        if draw.beta.is_none() {
            return self.draw_by(draw.n, draw.rule, rng, |rng| self.draw_step(rng));
        }
        let priorities = self.priorities()?;
        self.draw_by(draw.n, draw.rule, rng, |rng| {
            self.draw_by_priority(priorities, rng)
        })
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
    /// `next` says which observation comes after the steps of a row.
    fn write_transitions(
        &self,
        picks: &[Pick],
        next: &impl Fn(usize) -> usize,
        out: &mut TransitionOut<'_>,
    ) -> Result<()> {
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
            let (here, next) = (pick.step, next(place));
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
        row_of: impl Fn(usize, Per) -> Option<usize>,
    ) -> Result<Vec<Bytes>> {
        let copy = |(field, layer): (&Field, Layer<'_>)| {
            let row = field.row_bytes(self.config.frame_stack);
            let rows = picks.iter().enumerate();
            let rows = rows.filter_map(|(place, pick)| Some((pick, row_of(place, field.per)?)));
            let count = rows.clone().count();
            let mut out = Bytes::take("sample", product("n", &[count, row])?)?;
            for ((pick, t), out) in rows.zip(out.chunks_exact_mut(row)) {
                layer.write(&self.finished[pick.episode], t, out);
            }
            Ok(out)
        };
        self.layers().map(copy).collect()
    }

    fn transition_index(&self, picks: &[Pick], draw: &TransitionDraw<'_>) -> TransitionIndex {
        let mut index = TransitionIndex {
            goals: self.goal_index(picks),
            ..TransitionIndex::default()
        };
        let dim = self.config.action_dim;
        for pick in picks {
            let (episode, t) = (&self.finished[pick.episode], pick.step);
            let sum = self.sum_of(pick, draw);
            index.actions.extend(episode.actions.get(t));
            index.vectors.extend(&episode.vectors[t * dim..][..dim]);
            index.rewards.push(sum.reward);
            index.terminated.push(sum.is_terminated);
            index.truncated.push(sum.is_truncated);
            if draw.gamma.is_some() {
                index.lengths.push(label_of(sum.steps));
                index.discounts.push(sum.discount);
            }
        }
        index
    }

    /// The discounted rewards of up to `n_step` steps, none of them after an end.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "rewards are single precision"
    )]
    fn sum_of(&self, pick: &Pick, draw: &TransitionDraw<'_>) -> Sum {
        // Not 0.0, which a reward of -0.0 would not leave as it is.
        let (mut reward, mut discount, mut steps) = (-0.0, 1.0, 0);
        loop {
            let (one, is_terminated, is_truncated) =
                self.consequence(pick, pick.step + steps, draw.reward);
            reward += discount * f64::from(one);
            discount *= draw.gamma.unwrap_or(1.0);
            steps += 1;
            if is_terminated || is_truncated || steps == draw.n_step {
                return Sum {
                    reward: reward as f32,
                    discount: discount as f32,
                    steps,
                    is_terminated,
                    is_truncated,
                };
            }
        }
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

/// What comes of several steps.
struct Sum {
    reward: f32,
    /// What is expected after them is worth so much.
    discount: f32,
    steps: usize,
    is_terminated: bool,
    is_truncated: bool,
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
