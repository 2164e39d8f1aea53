//! The built-in sparse rule: a step is rewarded where what it reached is the goal.
//!
//! What a user's own reward function would say is not known here; the binding calls it on whole batches.

use crate::config::{GoalKind, Item};
use crate::episodes::EpisodeBuffer;
use crate::error::{Error, Result};
use crate::picks::{Goal, Pick};

/// Rewards of relabelled steps.
///
/// ```
/// use vhs_core::reward::SparseReward;
/// let rule = SparseReward { tolerance: 0.05, ..SparseReward::default() };
/// assert_eq!((rule.reached, rule.otherwise), (0.0, -1.0));
/// rule.check()?;
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SparseReward {
    /// Reward of a step that reaches the goal.
    pub reached: f32,
    /// Reward of any other step.
    pub otherwise: f32,
    /// Largest Euclidean distance that counts as reached, for goal vectors; 0: the same bytes.
    pub tolerance: f64,
    /// Whether a step that reaches the goal ends the episode.
    pub terminates: bool,
}

impl Default for SparseReward {
    /// 0 where the goal is reached, -1 elsewhere; reaching ends the episode.
    fn default() -> Self {
        Self {
            reached: 0.0,
            otherwise: -1.0,
            tolerance: 0.0,
            terminates: true,
        }
    }
}

impl SparseReward {
    /// Refuses numbers that make no reward.
    ///
    /// # Errors
    /// [`Error::Argument`] for rewards that are not finite, or a tolerance that is negative or NaN.
    pub fn check(&self) -> Result<()> {
        let wrong = |field, expected: &str, got: String| {
            let expected = expected.into();
            Err(Error::Argument {
                field,
                expected,
                got,
            })
        };
        if !self.reached.is_finite() || !self.otherwise.is_finite() {
            let got = format!("{} and {}", self.reached, self.otherwise);
            return wrong("reward", "finite numbers", got);
        }
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return wrong(
                "tolerance",
                "a distance of 0 or more",
                self.tolerance.to_string(),
            );
        }
        Ok(())
    }
}

impl EpisodeBuffer {
    /// Whether the observation after a step has reached the goal of its row.
    pub(crate) fn is_reached(&self, pick: &Pick, step: usize, tolerance: f64) -> bool {
        let episode = &self.finished[pick.episode];
        if let Goal::Hindsight { episode, step: at } = pick.goal
            && (episode, at) == (pick.episode, step + 1)
        {
            return true;
        }
        let reached = self.goal_parts(episode, step + 1);
        match (&self.config.goal_kind, self.told_parts(pick)) {
            (_, None) => false,
            (GoalKind::Vectors { item, .. }, Some(told)) if tolerance > 0.0 => {
                let squares = reached
                    .zip(told)
                    .map(|(here, there)| squared_distance(*item, here, there));
                squares.sum::<f64>().sqrt() <= tolerance
            }
            (_, Some(told)) => reached.eq(told),
        }
    }
}

fn squared_distance(item: Item, here: &[u8], there: &[u8]) -> f64 {
    let here = here.chunks_exact(item.bytes());
    let pairs = here.zip(there.chunks_exact(item.bytes()));
    pairs
        .map(|(here, there)| (item.read(here) - item.read(there)).powi(2))
        .sum()
}
