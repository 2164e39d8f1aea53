//! Which goal a transition or a window gets in hindsight (Andrychowicz et al. 2017, "Hindsight Experience
//! Replay", section 4.5).
//!
//! A goal is named by an episode and the number of an observation in it: `final` is the last one, `future`
//! one that comes after the transition, `episode` any but the first of the same episode, `random` any but the
//! first of any episode. Only numbers are drawn here; no goal is copied.

use crate::outcome::{Outcome, OutcomeSet};
use vhs_base::check::{check_fraction, check_range};
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

/// Where a hindsight goal is taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// The last observation of the same episode.
    Final,
    /// An observation of the same episode after the transition began, all equally likely.
    Future,
    /// An observation of the same episode but its first, all equally likely.
    Episode,
    /// An observation of any stored episode but its first, all equally likely.
    Random,
}

impl Strategy {
    /// Every strategy.
    pub const ALL: [Self; 4] = [Self::Final, Self::Future, Self::Episode, Self::Random];

    /// The word used in Python and in configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Final => "final",
            Self::Future => "future",
            Self::Episode => "episode",
            Self::Random => "random",
        }
    }

    /// The strategy with this name.
    ///
    /// # Errors
    /// [`Error::Argument`] for any other word.
    pub fn from_name(name: &str) -> Result<Self> {
        let known = Self::ALL
            .into_iter()
            .find(|strategy| strategy.name() == name);
        known.ok_or_else(|| Error::Argument {
            field: "strategy",
            expected: Self::ALL
                .map(|known| format!("\"{}\"", known.name()))
                .join(", "),
            got: format!("\"{name}\""),
        })
    }
}

/// How many of the eligible rows are relabelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Share {
    /// Each with this probability, in 0..=1.
    Probability(f64),
    /// k of every k + 1, by their place in the batch: rows whose number is not a multiple of k + 1.
    Ratio(usize),
}

/// Which transitions or windows are relabelled, and from where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HindsightRule {
    strategy: Strategy,
    share: Share,
    on: OutcomeSet,
}

impl HindsightRule {
    /// Relabels this share of the transitions of all episodes.
    ///
    /// # Errors
    /// [`Error::Argument`] for a probability outside 0..=1 or a ratio above 2^20.
    pub fn new(strategy: Strategy, share: Share) -> Result<Self> {
        match share {
            Share::Probability(probability) => check_fraction("probability", probability)?,
            Share::Ratio(ratio) => check_range("ratio", ratio, 0, 1 << 20)?,
        }
        Ok(Self {
            strategy,
            share,
            on: Outcome::ALL.into_iter().collect(),
        })
    }

    /// Where goals come from.
    #[must_use]
    pub const fn strategy(&self) -> Strategy {
        self.strategy
    }

    /// How many rows are relabelled.
    #[must_use]
    pub const fn share(&self) -> Share {
        self.share
    }

    /// Outcomes whose episodes are eligible.
    #[must_use]
    pub const fn outcomes(&self) -> OutcomeSet {
        self.on
    }

    /// Relabels only where the episode ended in one of these outcomes.
    #[must_use]
    pub const fn on(mut self, outcomes: OutcomeSet) -> Self {
        self.on = outcomes;
        self
    }

    /// Whether row `row` of a batch, from an episode with this outcome, is relabelled. A probability draws
    /// once a row, eligible or not: the stream of numbers does not depend on outcomes.
    pub(crate) fn selects(&self, row: usize, outcome: Outcome, rng: &mut Rng) -> bool {
        let chosen = match self.share {
            Share::Probability(probability) => rng.chance(probability),
            Share::Ratio(ratio) => !row.is_multiple_of(ratio + 1),
        };
        chosen && self.on.contains(outcome)
    }
}
