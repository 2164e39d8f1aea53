//! Hindsight relabelling: what a failed episode reached is taken as what it was told to reach.
//!
//! The one place with the rule (paper, section 4.2; Andrychowicz et al. 2017, strategy "final"): an
//! episode whose outcome is eligible is relabelled with the given probability. Its goal becomes its
//! own final observation `o_T`, its interaction the one its last action did. Timeouts are not
//! relabelled by default: they end anywhere, not at an object. Where it is known that an episode reached
//! something on its way, it can be cut there ([`EpisodeEnd::cut`]). Only row numbers are computed here; no image
//! is copied.

use crate::outcome::{Outcome, OutcomeSet};
use vhs_base::check::check_fraction;
use vhs_base::error::Result;
use vhs_base::rng::Rng;

/// What relabelling needs to know of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeEnd {
    /// How it ended.
    pub outcome: Outcome,
    /// The instructed interaction.
    pub interaction: i64,
    /// The interaction that the last action did; None where it was a move.
    pub done: Option<i64>,
    /// Row of the final observation `o_T` in the batch.
    pub final_row: i64,
    /// Steps to that observation: T. With 0 the episode reached nothing, and is not relabelled.
    pub steps: i64,
}

impl EpisodeEnd {
    /// The same episode as if it had ended after `steps` of its own, with an action that did `done`.
    #[must_use]
    pub const fn cut(self, steps: i64, done: Option<i64>) -> Self {
        Self {
            done,
            final_row: self.final_row - self.steps + steps,
            steps,
            ..self
        }
    }
}

/// Which episodes are relabelled.
///
/// ```
/// use vhs_core::outcome::Outcome;
/// use vhs_core::relabel::{EpisodeEnd, Rule};
/// use vhs_core::rng::Rng;
/// let rule = Rule::new([Outcome::Failure].into_iter().collect(), 1.0)?;
/// let end = |outcome, done, final_row| EpisodeEnd { outcome, interaction: 0, done, final_row, steps: 8 };
/// let episodes = [end(Outcome::Failure, Some(2), 8), end(Outcome::Timeout, None, 20)];
/// let hindsight = rule.relabel(&episodes, &mut Rng::new(0));
/// assert_eq!(hindsight.selected, [true, false]);
/// assert_eq!(hindsight.goal_rows, [8, 20]);
/// // The failure did interaction 2; the timeout keeps what it was told.
/// assert_eq!(hindsight.interactions, [2, 0]);
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    on: OutcomeSet,
    /// In 0..=1.
    probability: f64,
}

/// The new goals of a batch of episodes, as row numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hindsight {
    /// Whether each episode is relabelled.
    pub selected: Vec<bool>,
    /// Row of each episode's `o_T` in the batch; the new goal where selected.
    pub goal_rows: Vec<i64>,
    /// The interaction of each episode's last action where selected and the action is one, else the
    /// instructed one.
    pub interactions: Vec<i64>,
    /// Steps of each episode to the row of `goal_rows`.
    pub lengths: Vec<i64>,
}

impl Rule {
    /// Relabels episodes whose outcome is in `on`, each with `probability`.
    ///
    /// # Errors
    /// [`vhs_base::error::Error::Argument`] for a probability outside 0..=1.
    pub fn new(on: OutcomeSet, probability: f64) -> Result<Self> {
        check_fraction("probability", probability)?;
        Ok(Self { on, probability })
    }

    /// Chooses and relabels. Draws once an episode, eligible or not: an episode's fate depends on
    /// its place alone.
    #[must_use]
    pub fn relabel(&self, episodes: &[EpisodeEnd], rng: &mut Rng) -> Hindsight {
        let mut hindsight = Hindsight::default();
        for episode in episodes {
            let is_eligible = episode.steps > 0 && self.on.contains(episode.outcome);
            let selected = rng.chance(self.probability) && is_eligible;
            hindsight.selected.push(selected);
            hindsight.goal_rows.push(episode.final_row);
            hindsight.lengths.push(episode.steps);
            hindsight.interactions.push(
                episode
                    .done
                    .filter(|_| selected)
                    .unwrap_or(episode.interaction),
            );
        }
        hindsight
    }
}
