//! Drawing steps of finished episodes, each with its goal: what transitions and windows have in common.
//!
//! Every stored step of a finished episode is equally likely; windows are drawn in `windows`. A draw costs a search in a compact list of one
//! number an episode, so it stays flat as the buffer grows.

use crate::buffer::config::GoalKind;
use crate::buffer::episode::Episode;
use crate::buffer::episodes::EpisodeBuffer;
use crate::hindsight::strategy::{HindsightRule, Strategy};
use crate::labels::label_of;
use vhs_base::check::{self, check_range};
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

/// A drawn step and its goal. Valid as long as the buffer is not written to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pick {
    /// Place among the finished episodes.
    pub(crate) episode: usize,
    /// The step, in 0..T.
    pub(crate) step: usize,
    pub(crate) goal: Goal,
}

/// The goal of a row.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Goal {
    /// What the episode was told.
    Told,
    /// What observation `step` of an episode reached.
    Hindsight { episode: usize, step: usize },
}

/// What each row says about its goal, beside the goal itself. n rows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GoalIndex {
    /// Id of the episode that each row is from, `[n]`.
    pub ids: Vec<i64>,
    /// Its step, `[n]`.
    pub steps: Vec<i64>,
    /// Whether each row is relabelled, `[n]`.
    pub relabelled: Vec<bool>,
    /// Episode that the new goal is from, `[n]`; the row's own where it is not relabelled.
    pub goal_ids: Vec<i64>,
    /// Number of the observation that is the new goal, `[n]`; -1 where the row is not relabelled.
    pub goal_steps: Vec<i64>,
    /// Instructed goal class, `[n]`.
    pub labels: Vec<i64>,
    /// The interaction done on reaching the new goal, `[n]`; the instructed one where the row is not
    /// relabelled or the action was a move.
    pub interactions: Vec<i64>,
}

impl EpisodeBuffer {
    /// Refuses to draw nothing, or from nothing.
    pub(crate) fn check_drawable(&self, n: usize) -> Result<()> {
        check_range("n", n, 1, usize::MAX)?;
        if self.finished.is_empty() {
            return Err(Error::Empty {
                place: "EpisodeBuffer".into(),
                item: "finished episode",
            });
        }
        Ok(())
    }

    /// Draws `n` steps by a function, which gives places among the finished episodes and their steps, and their
    /// goals. Draws a row: the step; where a probability is given, one number; where the row is relabelled by a
    /// strategy with a choice, the choice.
    pub(crate) fn draw_by(
        &self,
        n: usize,
        rule: Option<&HindsightRule>,
        rng: &mut Rng,
        mut draw_step: impl FnMut(&mut Rng) -> (usize, usize),
    ) -> Result<Vec<Pick>> {
        let mut picks = check::with_room("sample", n)?;
        for row in 0..n {
            let (episode, step) = draw_step(rng);
            let outcome = self.finished[episode].outcome;
            let goal = match rule {
                Some(rule) if rule.selects(row, outcome, rng) => {
                    self.draw_goal(rule.strategy(), episode, step, rng)
                }
                _ => Goal::Told,
            };
            picks.push(Pick {
                episode,
                step,
                goal,
            });
        }
        Ok(picks)
    }

    /// A step of a finished episode, all equally likely.
    pub(crate) fn draw_step(&self, rng: &mut Rng) -> (usize, usize) {
        let before = self.steps_before.front().copied().unwrap_or_default();
        let stored = usize::try_from(self.finished_steps - before).unwrap_or(usize::MAX);
        self.place_of(before + rng.below(stored) as u64)
    }

    /// Place of an episode and step, of the step with this number among all that ever finished.
    pub(crate) fn place_of(&self, number: u64) -> (usize, usize) {
        let episode = self.steps_before.partition_point(|&first| first <= number) - 1;
        let step = usize::try_from(number - self.steps_before[episode]).unwrap_or_default();
        (episode, step)
    }

    fn draw_goal(&self, strategy: Strategy, episode: usize, step: usize, rng: &mut Rng) -> Goal {
        let last = self.finished[episode].len();
        let (episode, step) = match strategy {
            Strategy::Final => (episode, last),
            Strategy::Future => (episode, step + 1 + rng.below(last - step)),
            Strategy::Episode => (episode, 1 + rng.below(last)),
            Strategy::Random => {
                let (episode, step) = self.draw_step(rng);
                (episode, step + 1)
            }
        };
        Goal::Hindsight { episode, step }
    }

    /// The words beside each row.
    pub(crate) fn goal_index(&self, picks: &[Pick]) -> GoalIndex {
        let mut index = GoalIndex::default();
        for pick in picks {
            let episode = &self.finished[pick.episode];
            let id = self.id_at(pick.episode);
            let (is_relabelled, goal_id, goal_step, interaction) = match pick.goal {
                Goal::Told => (false, id, -1, episode.interaction),
                Goal::Hindsight {
                    episode: from,
                    step,
                } => {
                    let interaction = self.interaction_before(from, step, episode.interaction);
                    (true, self.id_at(from), label_of(step), interaction)
                }
            };
            index.ids.push(id);
            index.steps.push(label_of(pick.step));
            index.relabelled.push(is_relabelled);
            index.goal_ids.push(goal_id);
            index.goal_steps.push(goal_step);
            index.labels.push(episode.goal);
            index.interactions.push(interaction);
        }
        index
    }

    /// The interaction that the action before observation `step` did, or `told` where it was a move.
    fn interaction_before(&self, episode: usize, step: usize, told: i64) -> i64 {
        let action = self.finished[episode].actions.get(step - 1);
        self.config.interaction_of(action).unwrap_or(told)
    }

    /// Writes what observation `step` of an episode reached.
    pub(crate) fn write_reached(&self, episode: &Episode, step: usize, out: &mut [u8]) {
        if self.config.vector_bytes().is_some() {
            out.copy_from_slice(self.achieved.get(episode.frames[step]));
        } else {
            self.write_observation(episode, step, out);
        }
    }

    /// Id of the finished episode at a place.
    pub(crate) fn id_at(&self, place: usize) -> i64 {
        self.first_id().saturating_add(label_of(place))
    }

    /// Bytes of a row's goal in a batch: none where goals are class numbers and nothing is relabelled.
    pub(crate) fn row_goal_bytes(&self, rule: Option<&HindsightRule>) -> usize {
        if self.config.desired_bytes() == 0 && rule.is_none() {
            return 0;
        }
        self.config.goal_bytes()
    }

    /// Writes the goal of a row, zeros where it is a class number alone.
    pub(crate) fn write_goal(&self, pick: &Pick, out: &mut [u8]) {
        match pick.goal {
            Goal::Told => match &self.finished[pick.episode].desired[..] {
                [] => out.fill(0),
                desired => out.copy_from_slice(desired),
            },
            Goal::Hindsight { episode, step } => {
                self.write_reached(&self.finished[episode], step, out);
            }
        }
    }

    /// Whether the observation after a step has reached the goal of its row.
    pub(crate) fn is_reached(&self, pick: &Pick, step: usize, tolerance: f64) -> bool {
        let own = &self.finished[pick.episode];
        match (pick.goal, self.config.vector_bytes()) {
            (Goal::Told, _) if own.desired.is_empty() => false,
            (Goal::Hindsight { episode, step: at }, _)
                if (episode, at) == (pick.episode, step + 1) =>
            {
                true
            }
            (Goal::Hindsight { episode, step: at }, None) => self
                .frames()
                .records(own, step + 1)
                .eq(self.frames().records(&self.finished[episode], at)),
            (Goal::Told, None) => self.shows(own, step + 1, &own.desired),
            (goal, Some(_)) => {
                let told = match goal {
                    Goal::Told => &own.desired[..],
                    Goal::Hindsight { episode, step } => {
                        self.achieved.get(self.finished[episode].frames[step])
                    }
                };
                self.are_near(self.achieved.get(own.frames[step + 1]), told, tolerance)
            }
        }
    }

    /// Whether observation `t` of an episode is this picture.
    fn shows(&self, episode: &Episode, t: usize, picture: &[u8]) -> bool {
        let mut seen = vec![0; picture.len()];
        self.write_observation(episode, t, &mut seen);
        seen == picture
    }

    /// Whether two goal vectors are the same, or at most so far apart.
    fn are_near(&self, here: &[u8], there: &[u8], tolerance: f64) -> bool {
        match self.config.goal_kind {
            GoalKind::Vectors { item, .. } if tolerance > 0.0 => {
                item.squared_distance(here, there).sqrt() <= tolerance
            }
            _ => here == there,
        }
    }
}
