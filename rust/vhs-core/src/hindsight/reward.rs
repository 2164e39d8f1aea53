//! The built-in sparse rule: a step is rewarded where what it reached is the goal.
//!
//! What a user's own reward function would say is not known here; the binding calls it on whole batches.

use vhs_base::error::{Error, Result};

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
