//! How an episode ended, in the same words everywhere: core, Python, configuration and
//! `info["outcome"]`.

use vhs_base::error::{Error, Result};

/// How an episode ended. The numbers are those of the Python `vhs.Outcome`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Outcome {
    /// The instructed object was reached and the instructed interaction done.
    Success = 0,
    /// A wrong object or a wrong interaction ended the episode.
    Failure = 1,
    /// The time ran out.
    Timeout = 2,
}

impl Outcome {
    /// Every outcome, in the order of its number.
    pub const ALL: [Self; 3] = [Self::Success, Self::Failure, Self::Timeout];

    /// The word used in Python and in configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure => "failure",
            Self::Timeout => "timeout",
        }
    }

    /// The outcome with this name.
    ///
    /// # Errors
    /// [`Error::Argument`] for any other word.
    pub fn from_name(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|outcome| outcome.name() == name);
        known.ok_or_else(|| unknown(format!("\"{name}\"")))
    }

    /// The outcome with this number.
    ///
    /// # Errors
    /// [`Error::Argument`] for any other number.
    pub fn from_code(code: i64) -> Result<Self> {
        let known = Self::ALL
            .into_iter()
            .find(|&outcome| i64::from(outcome as u8) == code);
        known.ok_or_else(|| unknown(code.to_string()))
    }
}

fn unknown(got: String) -> Error {
    let words: Vec<_> = Outcome::ALL
        .iter()
        .map(|o| format!("\"{}\" ({})", o.name(), *o as u8))
        .collect();
    Error::Argument {
        field: "outcome",
        expected: words.join(", "),
        got,
    }
}

/// A set of outcomes: those whose episodes are relabelled.
///
/// ```
/// use vhs_core::outcome::{Outcome, OutcomeSet};
/// let on: OutcomeSet = [Outcome::Failure].into_iter().collect();
/// assert!(on.contains(Outcome::Failure) && !on.contains(Outcome::Timeout));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutcomeSet(u8);

impl OutcomeSet {
    /// Whether the outcome is a member.
    #[must_use]
    pub const fn contains(self, outcome: Outcome) -> bool {
        self.0 & (1 << outcome as u8) != 0
    }
}

impl FromIterator<Outcome> for OutcomeSet {
    fn from_iter<I: IntoIterator<Item = Outcome>>(outcomes: I) -> Self {
        Self(
            outcomes
                .into_iter()
                .fold(0, |set, outcome| set | (1 << outcome as u8)),
        )
    }
}
