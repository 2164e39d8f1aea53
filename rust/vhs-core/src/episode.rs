//! One episode, the step that extends it, and the sizes that bound both.
//!
//! Plain data: the rules of when a step may be appended are in `episodes`.

#[cfg(doc)]
use crate::episodes::EpisodeBuffer;
use crate::error::{self, Result, check_range};
use crate::goals::image_bytes;
use crate::outcome::Outcome;

/// The most streams, goals, interactions, stacked frames or steps of an episode.
const MAX_COUNT: usize = 1 << 20;

/// What an [`EpisodeBuffer`] is built from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodeConfig {
    /// Shape of one frame, uint8.
    pub frame_shape: Vec<usize>,
    /// Environments that feed the buffer at the same time.
    pub num_streams: usize,
    /// Steps after which no more can be appended to an episode.
    pub max_episode_steps: usize,
    /// Steps kept over all episodes; at least `num_streams * max_episode_steps`, for open episodes
    /// are never evicted.
    pub capacity_steps: usize,
    /// Frames in one observation.
    pub frame_stack: usize,
    /// Goal classes.
    pub num_goals: usize,
    /// Interactions; 0 where the task has none, and interaction 0 stands for none.
    pub num_interactions: usize,
    /// The action that does interaction 0; the actions below it are moves, those from it on the
    /// interactions.
    pub first_interaction_action: usize,
    /// Seed of [`EpisodeBuffer::sample`] and of the relabelling done with it.
    pub seed: u64,
}

impl EpisodeConfig {
    pub(crate) fn check(&self) -> Result<()> {
        image_bytes("frame_shape", &self.frame_shape)?;
        check_range("num_streams", self.num_streams, 1, MAX_COUNT)?;
        check_range("max_episode_steps", self.max_episode_steps, 1, MAX_COUNT)?;
        check_range("frame_stack", self.frame_stack, 1, MAX_COUNT)?;
        check_range("num_goals", self.num_goals, 1, MAX_COUNT)?;
        check_range("num_interactions", self.num_interactions, 0, MAX_COUNT)?;
        check_range(
            "first_interaction_action",
            self.first_interaction_action,
            0,
            MAX_COUNT,
        )?;
        check_range("actions", self.num_actions(), 1, 2 * MAX_COUNT)?;
        // Two frames a step at most: the shortest episode has one step and two frames.
        error::product(
            "capacity_steps",
            &[self.capacity_steps, 2, self.frame_bytes(), self.frame_stack],
        )?;
        check_range(
            "capacity_steps",
            self.capacity_steps,
            self.num_streams.saturating_mul(self.max_episode_steps),
            usize::MAX,
        )
    }

    /// Actions there are: moves and interactions.
    #[must_use]
    pub const fn num_actions(&self) -> usize {
        self.first_interaction_action + self.num_interactions
    }

    pub(crate) fn frame_bytes(&self) -> usize {
        self.frame_shape.iter().product()
    }
}

/// One episode, open or finished.
#[derive(Debug)]
pub struct Episode {
    pub(crate) goal: i64,
    pub(crate) interaction: i64,
    pub(crate) outcome: Outcome,
    pub(crate) actions: Vec<i64>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) values: Vec<f32>,
    /// Slots of frames 0..=T in the slab.
    pub(crate) frames: Vec<usize>,
}

#[expect(
    clippy::len_without_is_empty,
    reason = "a finished episode has at least one step"
)]
impl Episode {
    /// An open episode whose first frame lies in this slot.
    pub(crate) fn new(goal: i64, interaction: i64, first: usize) -> Self {
        Self {
            goal,
            interaction,
            // Until `finish` says otherwise; nobody reads it before.
            outcome: Outcome::Timeout,
            actions: Vec::new(),
            rewards: Vec::new(),
            values: Vec::new(),
            frames: vec![first],
        }
    }

    /// Steps taken: T.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.actions.len()
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

    /// Actions `a_0 ..= a_(T-1)`; the last one led to the final observation.
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

/// One step of several streams, as parallel arrays of the same length.
#[derive(Clone, Copy, Debug)]
pub struct Steps<'a> {
    /// Streams, each at most once.
    pub streams: &'a [i64],
    /// The action taken at the newest frame of each stream.
    pub actions: &'a [i64],
    /// The action's reward.
    pub rewards: &'a [f32],
    /// The critic's value when acting.
    pub values: &'a [f32],
    /// The next frames, one after the other.
    pub frames: &'a [u8],
}
