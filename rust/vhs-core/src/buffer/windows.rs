//! Windows of consecutive steps with burn-in, for recurrent off-policy learners (Kapturowski et al. 2019,
//! "Recurrent Experience Replay in Distributed Reinforcement Learning", section 3).
//!
//! A window has up to `length` learned steps, and before them up to `burn_in` that warm a recurrent state. An episode
//! of T steps has T + length - 1 windows: those at its ends begin before it or end after it, and keep the steps that
//! there are. All windows of all episodes are equally likely, so that every stored step is learned from as often as
//! any other. Where only full windows are wanted, an episode has T - length + 1, and none where it is shorter; then
//! steps at the ends of an episode come less often. A window's steps are left-aligned and padded with zeros to W = `burn_in` + `length`, its observations to W + 1.
//! It never leaves its episode and has one goal.

use std::ops::Range;

use crate::buffer::episode::Episode;
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::{Field, Per};
use crate::buffer::layer::Layer;
use crate::buffer::picks::{GoalIndex, Pick};
use crate::buffer::transitions::{check_new, replace_ends, replace_rewards};
use crate::hindsight::reward::SparseReward;
use crate::hindsight::strategy::HindsightRule;
use crate::labels::label_of;
use crate::storage::pool::Bytes;
use vhs_base::check::{check_range, check_shape, product, with_room};
use vhs_base::error::{Error, Result};
use vhs_base::interrupt;
use vhs_base::rng::Rng;

/// Steps of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowShape {
    /// Learned steps at most, at least 1.
    pub length: usize,
    /// Steps before them at most.
    pub burn_in: usize,
    /// Whether only windows with `length` learned steps are drawn.
    pub is_strict: bool,
}

/// Learned steps of a drawn window.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// Place among the finished episodes.
    episode: usize,
    first: usize,
    end: usize,
}

impl WindowShape {
    /// W: steps of a full window.
    #[must_use]
    pub const fn steps(&self) -> usize {
        self.length + self.burn_in
    }
}

/// Everything of a batch of windows but its images and goals. n windows of W steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WindowIndex {
    /// Where each is from, and its goal, `[n]` each; `steps` is the first step of the window.
    pub goals: GoalIndex,
    /// Steps before the first learned one, `[n]`.
    pub burn_in: Vec<i64>,
    /// Steps of each window, burn-in included, `[n]`.
    pub lengths: Vec<i64>,
    /// Numbered actions, `[n, W]`; empty where actions are continuous.
    pub actions: Vec<i64>,
    /// Continuous actions, `[n, W, action_dim]`; empty where actions are numbered.
    pub vectors: Vec<f32>,
    /// Rewards, `[n, W]`: by the reward rule where relabelled, else as recorded.
    pub rewards: Vec<f32>,
    /// Critic values when acting, `[n, W]`.
    pub values: Vec<f32>,
    /// Whether the task ended with a step, `[n, W]`.
    pub terminated: Vec<bool>,
    /// Whether a limit cut the episode off after a step, `[n, W]`.
    pub truncated: Vec<bool>,
    /// True for learned steps, `[n, W]`: not for burn-in and not after the end.
    pub mask: Vec<bool>,
}

/// A batch with its images and goals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WindowBatch {
    /// Observations, `[n, W + 1, *observation_shape]`.
    pub observations: Bytes,
    /// One goal a window, `[n, *goal]`: as in [`crate::transitions::TransitionBatch`].
    pub goals: Bytes,
    /// Goal vectors reached by each observation, `[n, W + 1, *goal]`; empty where observations are what is
    /// reached.
    pub achieved_goals: Bytes,
    /// Each field: of observations `[n, W + 1, *row_shape]`, of steps `[n, W, *shape]`.
    pub fields: Vec<Bytes>,
    /// Everything else.
    pub index: WindowIndex,
}

impl EpisodeBuffer {
    /// Draws `n` windows, with replacement, and relabels them where a rule is given.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_transitions`], [`vhs_base::error::Error::Argument`] for a window without
    /// learned steps, and [`vhs_base::error::Error::Empty`] where full windows are wanted and every episode is shorter.
    pub fn sample_windows(
        &mut self,
        n: usize,
        shape: WindowShape,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
    ) -> Result<WindowBatch> {
        self.with_rng(|buffer, rng| buffer.sample_windows_with(n, shape, rule, reward, rng))
    }

    /// As [`EpisodeBuffer::sample_windows`], drawing from a generator of the caller.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_windows`].
    pub fn sample_windows_with(
        &self,
        n: usize,
        shape: WindowShape,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
        rng: &mut Rng,
    ) -> Result<WindowBatch> {
        let sizes = self.window_sizes(n, shape, rule)?;
        let mut observations = Bytes::take("sample", sizes[0])?;
        let index = self.sample_windows_into(n, shape, rule, reward, rng, &mut observations)?;
        Ok(WindowBatch {
            observations,
            ..index
        })
    }

    /// As [`EpisodeBuffer::sample_windows_with`], with the observations written into memory of the caller;
    /// those of the result are empty.
    ///
    /// # Errors
    /// As [`EpisodeBuffer::sample_windows`], and [`vhs_base::error::Error::Shape`] where `observations` is not as
    /// long as the batch needs.
    pub fn sample_windows_into(
        &self,
        n: usize,
        shape: WindowShape,
        rule: Option<&HindsightRule>,
        reward: Option<&SparseReward>,
        rng: &mut Rng,
        observations: &mut [u8],
    ) -> Result<WindowBatch> {
        reward.map_or(Ok(()), SparseReward::check)?;
        let sizes = self.window_sizes(n, shape, rule)?;
        check_shape("out", &[sizes[0]], &[observations.len()])?;
        let mut batch = WindowBatch {
            goals: Bytes::take("sample", sizes[1])?,
            achieved_goals: Bytes::take("sample", sizes[2])?,
            ..WindowBatch::default()
        };
        let (picks, ends) = self.draw_windows(n, shape, rule, rng)?;
        let windows = || {
            let first = |pick: &Pick| pick.step.saturating_sub(shape.burn_in);
            picks
                .iter()
                .zip(&ends)
                .map(move |(pick, &end)| (pick, first(pick)..end))
        };
        batch.index = self.window_index(&picks, windows(), shape, reward);
        let rows = shape.steps() + 1;
        for (place, (pick, steps)) in windows().enumerate() {
            interrupt::check()?;
            let (row, image) = (self.observation_bytes(), rows * self.observation_bytes());
            let out = &mut observations[place * image..][..image];
            self.write_rows_of(pick, &steps, row, out, Self::write_observation);
            let goal = sizes[1] / n;
            if goal > 0 {
                self.write_goal(pick, &mut batch.goals[place * goal..][..goal]);
            }
            let reached = sizes[2] / n;
            if reached > 0 {
                let out = &mut batch.achieved_goals[place * reached..][..reached];
                self.write_rows_of(pick, &steps, reached / rows, out, Self::write_reached);
            }
        }
        batch.fields = self.window_fields(&windows(), n, shape.steps())?;
        Ok(batch)
    }

    fn window_fields<'a>(
        &self,
        windows: &(impl Iterator<Item = (&'a Pick, Range<usize>)> + Clone),
        n: usize,
        width: usize,
    ) -> Result<Vec<Bytes>> {
        let copy = |(field, layer): (&Field, Layer<'_>)| {
            let row = field.row_bytes(self.config.frame_stack);
            // What comes with a step lies under the number of the frame that the step led to.
            let (extra, first) = match field.per {
                Per::Observation => (1, 0),
                Per::Step => (0, 1),
            };
            let window = (width + extra) * row;
            let mut out = Bytes::take("sample", product("n", &[n, width + extra, row])?)?;
            for ((pick, steps), out) in windows.clone().zip(out.chunks_exact_mut(window)) {
                let (written, padding) = out.split_at_mut((steps.len() + extra) * row);
                let episode = &self.finished[pick.episode];
                layer.write_all(episode, steps.start + first, row, written);
                padding.fill(0);
            }
            Ok(out)
        };
        self.layers().map(copy).collect()
    }

    /// Bytes of the observations, goals and goal vectors of a batch.
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Argument`] for a window without learned steps, or more than memory can address.
    pub fn window_sizes(
        &self,
        n: usize,
        shape: WindowShape,
        rule: Option<&HindsightRule>,
    ) -> Result<[usize; 3]> {
        check_range("length", shape.length, 1, 1 << 20)?;
        check_range("burn_in", shape.burn_in, 0, 1 << 20)?;
        let rows = shape.steps() + 1;
        let vector = self.config.vector_bytes().unwrap_or_default();
        Ok([
            product("n", &[n, rows, self.observation_bytes()])?,
            product("n", &[n, self.row_goal_bytes(rule)])?,
            product("n", &[n, rows, vector])?,
        ])
    }

    /// Draws `n` windows: their first learned steps with goals, and where the windows end.
    fn draw_windows(
        &self,
        n: usize,
        shape: WindowShape,
        rule: Option<&HindsightRule>,
        rng: &mut Rng,
    ) -> Result<(Vec<Pick>, Vec<usize>)> {
        self.check_drawable(n)?;
        let mut ends = with_room("sample", n)?;
        let mut draw_by = |draw: &dyn Fn(&mut Rng) -> Span| {
            self.draw_by(n, rule, rng, |rng| {
                let span = draw(rng);
                ends.push(span.end);
                (span.episode, span.first)
            })
        };
        let picks = if shape.is_strict {
            let starts = self.full_windows(shape.length)?;
            draw_by(&|rng| Self::draw_full(&starts, shape.length, rng))
        } else {
            draw_by(&|rng| self.draw_span(shape.length, rng))
        };
        Ok((picks?, ends))
    }

    /// A window of some episode, all equally likely.
    fn draw_span(&self, length: usize, rng: &mut Rng) -> Span {
        let before = self.steps_before.front().copied().unwrap_or_default();
        // Windows of all episodes before one: its own first window has this number.
        let windows_before = |episode: usize| {
            let steps = self
                .steps_before
                .get(episode)
                .unwrap_or(&self.finished_steps)
                - before;
            usize::try_from(steps).unwrap_or(usize::MAX) + episode * (length - 1)
        };
        let number = rng.below(windows_before(self.finished.len()));
        let (mut episode, mut beyond) = (0, self.finished.len());
        while beyond - episode > 1 {
            let middle = episode.midpoint(beyond);
            if windows_before(middle) <= number {
                episode = middle;
            } else {
                beyond = middle;
            }
        }
        // The first window has the first step alone, as its last learned one.
        let last = number - windows_before(episode);
        Span {
            episode,
            first: (last + 1).saturating_sub(length),
            end: (last + 1).min(self.finished[episode].len()),
        }
    }

    /// How many full windows all episodes before each have, and all in all.
    fn full_windows(&self, length: usize) -> Result<Vec<usize>> {
        let mut starts = with_room("sample", self.finished.len() + 1)?;
        let mut total = 0;
        starts.push(0);
        for episode in &self.finished {
            total += (episode.len() + 1).saturating_sub(length);
            starts.push(total);
        }
        if total == 0 {
            return Err(Error::Empty {
                place: "EpisodeBuffer".into(),
                item: "finished episode with as many steps as a window",
            });
        }
        Ok(starts)
    }

    fn draw_full(starts: &[usize], length: usize, rng: &mut Rng) -> Span {
        let number = rng.below(starts.last().copied().unwrap_or_default());
        let episode = starts.partition_point(|&start| start <= number) - 1;
        let first = number - starts[episode];
        Span {
            episode,
            first,
            end: first + length,
        }
    }

    /// One row for each observation of a window by `write`, zeros after them.
    fn write_rows_of(
        &self,
        pick: &Pick,
        steps: &Range<usize>,
        row_bytes: usize,
        out: &mut [u8],
        write: impl Fn(&Self, &Episode, usize, &mut [u8]),
    ) {
        let (written, padding) = out.split_at_mut((steps.len() + 1) * row_bytes);
        for (t, row) in (steps.start..).zip(written.chunks_exact_mut(row_bytes)) {
            write(self, &self.finished[pick.episode], t, row);
        }
        padding.fill(0);
    }

    fn window_index<'a>(
        &self,
        picks: &[Pick],
        windows: impl Iterator<Item = (&'a Pick, Range<usize>)>,
        shape: WindowShape,
        reward: Option<&SparseReward>,
    ) -> WindowIndex {
        let mut index = WindowIndex {
            goals: self.goal_index(picks),
            ..WindowIndex::default()
        };
        index.goals.steps.clear();
        let (dim, width) = (self.config.action_dim, shape.steps());
        for (place, (pick, steps)) in windows.enumerate() {
            let episode = &self.finished[pick.episode];
            index.goals.steps.push(label_of(steps.start));
            index.burn_in.push(label_of(pick.step - steps.start));
            index.lengths.push(label_of(steps.len()));
            if dim == 0 {
                index.actions.extend(&episode.actions[steps.clone()]);
                index.actions.resize((place + 1) * width, 0);
            }
            index
                .vectors
                .extend(&episode.vectors[steps.start * dim..steps.end * dim]);
            index.vectors.resize((place + 1) * width * dim, 0.0);
            index.values.extend(&episode.values[steps.clone()]);
            for step in steps {
                let (reward, terminated, truncated) = self.consequence(pick, step, reward);
                index.rewards.push(reward);
                index.terminated.push(terminated);
                index.truncated.push(truncated);
                index.mask.push(step >= pick.step);
            }
            index.pad((place + 1) * width);
        }
        index
    }
}

impl WindowIndex {
    /// Takes the rewards, and whether the task ended, that a function of the caller gave for all `[n, W]`
    /// steps; only those of relabelled windows are changed, and none after the end of a window.
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Shape`] and [`vhs_base::error::Error::NonFinite`].
    pub fn set_relabelled(&mut self, rewards: &[f32], terminated: Option<&[bool]>) -> Result<()> {
        check_new(self.rewards.len(), rewards, terminated)?;
        let width = self.mask.len() / self.lengths.len().max(1);
        let (relabelled, lengths) = (&self.goals.relabelled, &self.lengths);
        let cell = |place: usize| {
            let window = place / width;
            relabelled[window] && label_of(place % width) < lengths[window]
        };
        replace_rewards(&mut self.rewards, rewards, cell);
        replace_ends(&mut self.terminated, &mut self.truncated, terminated, cell);
        Ok(())
    }

    /// Zeros up to the end of a window.
    fn pad(&mut self, cells: usize) {
        self.values.resize(cells, 0.0);
        self.rewards.resize(cells, 0.0);
        self.terminated.resize(cells, false);
        self.truncated.resize(cells, false);
        self.mask.resize(cells, false);
    }
}
