//! Draws in proportion to priorities (Schaul et al. 2016, "Prioritized Experience Replay", section 3.3).

use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::priorities::Priorities;
use crate::labels::class_of;
use vhs_base::check::{check_finite, check_fraction, check_shape};
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

impl EpisodeBuffer {
    /// Gives steps of finished episodes new priorities: `priorities[i]` to step `steps[i]` of episode `ids[i]`. Where
    /// a step comes twice the last one counts; steps of episodes that were evicted meanwhile are passed over.
    ///
    /// # Errors
    /// [`Error::Argument`] for a buffer without priorities, or one that is not above 0; [`Error::NonFinite`],
    /// [`Error::Shape`], [`Error::UnknownEpisode`], [`Error::Label`] for a step that its episode does not have.
    pub fn update_priorities(
        &mut self,
        ids: &[i64],
        steps: &[i64],
        priorities: &[f32],
    ) -> Result<()> {
        self.priorities()?;
        check_shape("steps", &[ids.len()], &[steps.len()])?;
        check_shape("priorities", &[ids.len()], &[priorities.len()])?;
        check_finite("priorities", priorities)?;
        if let Some(index) = priorities.iter().position(|&priority| priority <= 0.0) {
            return Err(Error::Argument {
                field: "priorities",
                expected: "numbers above 0 (errors may be 0: add a small number)".into(),
                got: format!("{} at index {index}", priorities[index]),
            });
        }
        let mut numbers = Vec::with_capacity(ids.len());
        for (index, (&id, &step)) in ids.iter().zip(steps).enumerate() {
            numbers.push(self.step_number(id, step, index)?);
        }
        if let Some(tree) = &mut self.priorities {
            for (number, &priority) in numbers.into_iter().zip(priorities) {
                if let Some(number) = number {
                    tree.set(number, priority);
                }
            }
        }
        Ok(())
    }

    /// The number of a step among all that ever finished; None where its episode was evicted.
    fn step_number(&self, id: i64, step: i64, index: usize) -> Result<Option<u64>> {
        let episode = match self.episode(id) {
            Err(Error::Evicted { .. }) => return Ok(None),
            found => found?,
        };
        if class_of(step) >= episode.len() {
            return Err(Error::Label {
                field: "steps",
                index,
                limit: episode.len(),
                got: step,
            });
        }
        let place = class_of(id - self.first_id());
        Ok(Some(self.steps_before[place] + class_of(step) as u64))
    }

    pub(crate) fn priorities(&self) -> Result<&Priorities> {
        self.priorities.as_ref().ok_or_else(|| Error::Argument {
            field: "priority_exponent",
            expected: "a number when the buffer is made, for what needs priorities".into(),
            got: "none".into(),
        })
    }

    /// A step of a finished episode, in proportion to its priority: place of the episode, and the step.
    pub(crate) fn draw_by_priority(
        &self,
        priorities: &Priorities,
        rng: &mut Rng,
    ) -> (usize, usize) {
        let number = priorities.find(rng.unit(), self.first_number());
        self.place_of(number)
    }

    /// (N P)^-beta of each drawn step over the largest of them, where P are its odds among N stored ones: what undoes
    /// so much of the priorities in an expectation.
    pub(crate) fn importance(
        &self,
        picks: impl Iterator<Item = (usize, usize)>,
        beta: f64,
    ) -> Result<Vec<f32>> {
        check_fraction("beta", beta)?;
        let priorities = self.priorities()?;
        let odds =
            picks.map(|(episode, step)| priorities.odds(self.steps_before[episode] + step as u64));
        let odds: Vec<f64> = odds.collect();
        // N and the sum of all odds are the same in every row: the largest weight is that of the smallest odds.
        let least = odds.iter().copied().fold(f64::INFINITY, f64::min);
        let weights = odds.into_iter().map(|odds| (least / odds).powf(beta));
        #[expect(clippy::cast_possible_truncation, reason = "a number in 0..=1")]
        Ok(weights.map(|weight| weight as f32).collect())
    }
}
