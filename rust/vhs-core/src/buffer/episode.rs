//! One episode, how it opens, and the step that extends it.
//!
//! Plain data, and what of it does not fit a buffer; when a step may be appended is said in `episodes`.

use crate::buffer::config::EpisodeConfig;
use crate::buffer::field::{Per, check_given};
use crate::outcome::Outcome;
use vhs_base::check::{self, check_finite, check_labels, check_shape};
use vhs_base::error::{Error, Result};

/// One episode, open or finished.
#[derive(Debug)]
pub struct Episode {
    pub(crate) goal: i64,
    pub(crate) interaction: i64,
    pub(crate) outcome: Outcome,
    pub(crate) is_terminated: bool,
    /// The goal it was told, empty where that is a class number alone.
    pub(crate) desired: Box<[u8]>,
    /// Numbered actions; empty where actions are continuous.
    pub(crate) actions: Vec<i64>,
    /// Continuous actions one after the other; empty where actions are numbered.
    pub(crate) vectors: Vec<f32>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) values: Vec<f32>,
    /// Slots of frames 0..=T in the slab.
    pub(crate) frames: Vec<usize>,
    /// Of all that lies in these slots, where the buffer stays on the disk.
    pub(crate) checksum: u64,
}

impl Episode {
    /// An open episode whose first frame lies in this slot, and which will have at most so many steps.
    pub(crate) fn new(opening: &Opening<'_>, first: usize, most_steps: usize) -> Self {
        // Room for a usual episode from the start: growing step by step costs more than the steps.
        let steps = most_steps.min(32);
        let mut frames = Vec::with_capacity(steps + 1);
        frames.push(first);
        Self {
            goal: opening.goal,
            interaction: opening.interaction,
            // Until `finish` says otherwise; nobody reads them before.
            outcome: Outcome::Timeout,
            is_terminated: false,
            desired: opening.desired.into(),
            actions: Vec::with_capacity(steps),
            vectors: Vec::new(),
            rewards: Vec::with_capacity(steps),
            values: Vec::with_capacity(steps),
            frames,
            checksum: 0,
        }
    }

    /// Steps taken: T.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.rewards.len()
    }

    /// Whether the episode has no step yet; a finished one has.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }

    /// The instructed goal class.
    #[must_use]
    pub const fn goal(&self) -> i64 {
        self.goal
    }

    /// The instructed interaction.
    #[must_use]
    pub const fn interaction(&self) -> i64 {
        self.interaction
    }

    /// How the episode ended.
    #[must_use]
    pub const fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// Whether its last step ended the task; false where it was cut off, as by a time limit.
    #[must_use]
    pub const fn is_terminated(&self) -> bool {
        self.is_terminated
    }

    /// The goal it was told, as bytes; empty where that is a class number alone.
    #[must_use]
    pub fn desired(&self) -> &[u8] {
        &self.desired
    }

    /// Continuous actions one after the other; empty where actions are numbered.
    #[must_use]
    pub fn action_vectors(&self) -> &[f32] {
        &self.vectors
    }

    /// Numbered actions `a_0 ..= a_(T-1)`; the last one led to the final observation.
    #[must_use]
    pub fn actions(&self) -> &[i64] {
        &self.actions
    }

    /// Rewards of the actions.
    #[must_use]
    pub fn rewards(&self) -> &[f32] {
        &self.rewards
    }

    /// The critic's value when each action was chosen.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }
}

/// How an episode begins.
#[derive(Clone, Copy, Debug, Default)]
pub struct Opening<'a> {
    /// The first frame.
    pub frame: &'a [u8],
    /// The instructed goal class.
    pub goal: i64,
    /// The instructed interaction.
    pub interaction: i64,
    /// The goal it is told: a vector or an observation; empty where that is a class number alone.
    pub desired: &'a [u8],
    /// The goal vector reached at the first frame; empty where goals are not vectors.
    pub achieved: &'a [u8],
    /// The first of each field, in the order of the configuration; empty for those of steps.
    pub fields: &'a [&'a [u8]],
}

impl Opening<'_> {
    /// Refuses what does not fit a buffer of this configuration.
    pub(crate) fn check(&self, config: &EpisodeConfig) -> Result<()> {
        let vector_bytes = config.vector_bytes().unwrap_or_default();
        check_shape("frame", &[config.frame_bytes()], &[self.frame.len()])?;
        check_shape(
            "desired_goal",
            &[config.desired_bytes()],
            &[self.desired.len()],
        )?;
        check_shape("achieved_goal", &[vector_bytes], &[self.achieved.len()])?;
        check_given(&config.fields, self.fields, 1, |field| {
            field.per == Per::Observation
        })?;
        check_labels("goal", &[self.goal], config.num_goals)?;
        let interactions = config.num_interactions.max(1);
        check_labels("interaction", &[self.interaction], interactions)
    }
}

/// One step of several streams, as parallel arrays of the same length.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steps<'a> {
    /// Streams, each at most once.
    pub streams: &'a [i64],
    /// The action taken at the newest frame of each stream; empty where actions are continuous.
    pub actions: &'a [i64],
    /// Continuous actions one after the other; empty where actions are numbered.
    pub vectors: &'a [f32],
    /// The action's reward.
    pub rewards: &'a [f32],
    /// The critic's value when acting.
    pub values: &'a [f32],
    /// The next frames, one after the other.
    pub frames: &'a [u8],
    /// The goal vectors reached at the next frames; empty where goals are not vectors.
    pub achieved: &'a [u8],
    /// Each field one after the other, in the order of the configuration: those of observations at the next
    /// frames, those of steps.
    pub fields: &'a [&'a [u8]],
}

impl Steps<'_> {
    /// Refuses what does not fit a buffer of this configuration.
    pub(crate) fn check(&self, config: &EpisodeConfig) -> Result<()> {
        let n = self.streams.len();
        let dim = config.action_dim;
        let numbered = if dim == 0 { n } else { 0 };
        check_shape("actions", &[numbered], &[self.actions.len()])?;
        check_shape("actions", &[n * dim], &[self.vectors.len()])?;
        check_shape("rewards", &[n], &[self.rewards.len()])?;
        check_shape("values", &[n], &[self.values.len()])?;
        check_shape(
            "frames",
            &[check::product("frames", &[n, config.frame_bytes()])?],
            &[self.frames.len()],
        )?;
        let vector_bytes = config.vector_bytes().unwrap_or_default();
        check_shape(
            "achieved_goals",
            &[n * vector_bytes],
            &[self.achieved.len()],
        )?;
        check_given(&config.fields, self.fields, n, |_| true)?;
        check_labels("streams", self.streams, config.num_streams)?;
        config.check_actions("actions", self.actions)?;
        check_finite("actions", self.vectors)?;
        check_finite("rewards", self.rewards)?;
        check_finite("values", self.values)?;
        check_distinct(self.streams)
    }
}

/// Refuses a stream that comes twice: which of its two steps came first would be a guess.
fn check_distinct(streams: &[i64]) -> Result<()> {
    if streams.len() < 2 {
        return Ok(());
    }
    let mut sorted = streams.to_vec();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        None => Ok(()),
        Some(pair) => {
            let (expected, got) = (
                "each stream at most once".into(),
                format!("stream {} twice", pair[0]),
            );
            Err(Error::Argument {
                field: "streams",
                expected,
                got,
            })
        }
    }
}
