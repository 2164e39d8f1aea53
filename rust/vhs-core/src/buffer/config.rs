//! What an episode buffer is built from: sizes, element types, and what a goal is.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use crate::buffer::field::check_fields;
pub use crate::buffer::field::{Field, Per};
pub use crate::item::Item;
use crate::item::volume;
use crate::labels::{class_of, label_of};
use crate::storage::memory::scratch_file;
use crate::storage::slab::Source;
pub use crate::storage::stacking::Stacking;
use vhs_base::check::{self, check_labels, check_range};
use vhs_base::error::{Error, Result};

/// The most streams, goals, interactions, stacked frames or steps of an episode.
const MAX_COUNT: usize = 1 << 20;

/// What an episode is told to reach, and what counts as reached.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum GoalKind {
    /// Told: a class number. Reached: the observation itself.
    #[default]
    Labels,
    /// Told: an observation, given when the episode begins. Reached: the observation itself.
    Observations,
    /// Told: a vector. Reached: a vector that comes beside every frame, as in goal-conditioned environments
    /// with `achieved_goal` and `desired_goal`.
    Vectors {
        /// Shape of a goal, each size at least 1.
        shape: Vec<usize>,
        /// Type of its elements.
        item: Item,
    },
}

/// Where frames lie.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Backing {
    /// Memory.
    #[default]
    Memory,
    /// A scratch file at this path, which may be larger than memory. It must not exist yet, and it vanishes
    /// with the buffer, however the process ends: [`EpisodeBuffer::save`](super::episodes::EpisodeBuffer::save) is what keeps episodes.
    Scratch(PathBuf),
    /// Memory, where each frame is compressed (LZ4) without loss: smaller, and slower to draw.
    Packed,
    /// Files in this folder, which stay: [`EpisodeBuffer::keep`](super::episodes::EpisodeBuffer::keep) and
    /// [`EpisodeBuffer::reopen`](super::episodes::EpisodeBuffer::reopen) make such buffers.
    Kept(PathBuf),
}

impl Backing {
    /// Where records of this name lie: fields in scratch files beside that of the frames, goals in memory.
    pub(super) fn source(&self, name: &str) -> Result<Source> {
        let mut path = match (self, name) {
            (Backing::Packed, "frames") => return Ok(Source::Packed),
            (Backing::Memory | Backing::Packed, _) | (Backing::Scratch(_), "goals") => {
                return Ok(Source::Memory);
            }
            (Backing::Scratch(path), _) => path.clone(),
            (Backing::Kept(folder), _) => {
                return Err(Error::Argument {
                    field: "backing",
                    expected: "a buffer that stays to be made by `keep` or `reopen`".into(),
                    got: folder.display().to_string(),
                });
            }
        };
        if name != "frames" {
            path.as_mut_os_string().push(format!(".{name}"));
        }
        match scratch_file(&path) {
            Ok(file) => Ok(Source::File(Arc::new(file))),
            Err(source) => Err(Error::Io {
                path,
                call: "create",
                source,
            }),
        }
    }
}

/// What an [`EpisodeBuffer`](super::episodes::EpisodeBuffer) is built from.
///
/// `EpisodeConfig { frame_shape, ..EpisodeConfig::default() }` is the way to make one: fields may be added.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeConfig {
    /// Shape of one frame.
    pub frame_shape: Vec<usize>,
    /// Type of its elements; uint8 for images.
    pub frame_item: Item,
    /// Environments that feed the buffer at the same time.
    pub num_streams: usize,
    /// Steps after which no more can be appended to an episode.
    pub max_episode_steps: usize,
    /// Steps kept over all episodes; at least `num_streams * max_episode_steps`, for open episodes
    /// are never evicted.
    pub capacity_steps: usize,
    /// Frames in one observation.
    pub frame_stack: usize,
    /// How they lie in it.
    pub stacking: Stacking,
    /// What a goal is.
    pub goal_kind: GoalKind,
    /// Further arrays of observations and steps.
    pub fields: Vec<Field>,
    /// Goal classes.
    pub num_goals: usize,
    /// Numbered actions; None: any of the 2^20 numbers from `first_action` on is one.
    pub num_actions: Option<usize>,
    /// The smallest numbered action, as an environment counts them.
    pub first_action: i64,
    /// Interactions; 0 where the task has none, and interaction 0 stands for none.
    pub num_interactions: usize,
    /// The interaction that each action does; an action that is not among them is a move. Needed where there
    /// is more than one interaction and actions are numbered.
    pub interactions: BTreeMap<i64, i64>,
    /// Numbers in a continuous action; 0 where actions are numbered.
    pub action_dim: usize,
    /// alpha of prioritised draws, in 0..=1: a step is drawn with the odds of its priority to this power. None: no
    /// step has a priority.
    pub priority_exponent: Option<f64>,
    /// Seed of [`EpisodeBuffer::sample`](super::episodes::EpisodeBuffer::sample) and of the relabelling done with it.
    pub seed: u64,
    /// Where frames lie.
    pub backing: Backing,
}

impl Default for EpisodeConfig {
    /// One stream of single bytes; every size that matters is to be given.
    fn default() -> Self {
        Self {
            frame_shape: vec![1],
            frame_item: Item::U8,
            num_streams: 1,
            max_episode_steps: 1,
            capacity_steps: 1,
            frame_stack: 1,
            stacking: Stacking::Frames,
            goal_kind: GoalKind::Labels,
            fields: Vec::new(),
            num_goals: 1,
            num_actions: None,
            first_action: 0,
            num_interactions: 0,
            interactions: BTreeMap::new(),
            action_dim: 0,
            priority_exponent: None,
            seed: 0,
            backing: Backing::Memory,
        }
    }
}

impl EpisodeConfig {
    pub(crate) fn check(&self) -> Result<()> {
        volume("frame_shape", &self.frame_shape)?;
        if let GoalKind::Vectors { shape, .. } = &self.goal_kind {
            volume("goal_shape", shape)?;
        }
        check_range("num_streams", self.num_streams, 1, MAX_COUNT)?;
        check_range("max_episode_steps", self.max_episode_steps, 1, MAX_COUNT)?;
        check_range("frame_stack", self.frame_stack, 1, MAX_COUNT)?;
        check_fields(&self.fields, self.frame_stack)?;
        check_range("num_goals", self.num_goals, 1, MAX_COUNT)?;
        check_range("num_interactions", self.num_interactions, 0, MAX_COUNT)?;
        check_range("action_dim", self.action_dim, 0, MAX_COUNT)?;
        check_range("num_actions", self.action_limit(), 1, 2 * MAX_COUNT)?;
        self.check_first_action()?;
        let exponent = self.priority_exponent.unwrap_or_default();
        check::check_fraction("priority_exponent", exponent)?;
        self.check_interactions()?;
        self.check_total()?;
        let least = self.num_streams.saturating_mul(self.max_episode_steps);
        if self.capacity_steps >= least {
            return Ok(());
        }
        Err(Error::Argument {
            field: "capacity_steps",
            expected: format!("at least num_streams * max_episode_steps = {least}"),
            got: self.capacity_steps.to_string(),
        })
    }

    /// Everything that is ever multiplied fits memory's addresses. Two frames a step at most: the shortest
    /// episode has one step and two frames.
    fn check_total(&self) -> Result<()> {
        let frame = [
            &self.frame_shape[..],
            &[self.frame_item.bytes(), self.frame_stack],
        ]
        .concat();
        check::product("frame_shape", &frame)?;
        if let GoalKind::Vectors { shape, item } = &self.goal_kind {
            check::product("goal_shape", &[&shape[..], &[item.bytes()]].concat())?;
        }
        let fields = self
            .fields
            .iter()
            .map(|field| Some(field.row_bytes(self.frame_stack)));
        let words = 8 * self.action_dim + 64;
        let parts = [self.observation_bytes(), self.goal_bytes(), words].map(Some);
        let step = parts.into_iter().chain(fields);
        let step = step.reduce(|sum, part| sum?.checked_add(part?)).flatten();
        let Some(step) = step else {
            return Err(Error::Argument {
                field: "frame_shape",
                expected: "a step that fits memory".into(),
                got: format!("{:?}", self.frame_shape),
            });
        };
        check::product("capacity_steps", &[self.capacity_steps, 4, step]).map(drop)
    }

    /// Nothing is guessed: which of several interactions an episode ended with follows from its last action alone.
    fn check_interactions(&self) -> Result<()> {
        let refused = |expected: String, got: String| {
            let field = "interactions";
            Err(Error::Argument {
                field,
                expected,
                got,
            })
        };
        if self.action_dim > 0 && !self.interactions.is_empty() {
            return refused("none where actions are continuous".into(), "some".into());
        }
        if self.action_dim == 0 && self.num_interactions > 1 && self.interactions.is_empty() {
            let expected = format!(
                "which action does which of num_interactions = {}",
                self.num_interactions
            );
            return refused(expected, "none".into());
        }
        for (&action, &interaction) in &self.interactions {
            if !self.is_action(action) || class_of(interaction) >= self.num_interactions {
                let (first, interactions) = (self.first_action, self.num_interactions);
                let actions = first + label_of(self.action_limit());
                let expected = format!(
                    "actions in {first}..{actions} that do interactions in 0..{interactions}"
                );
                return refused(
                    expected,
                    format!("action {action}, interaction {interaction}"),
                );
            }
        }
        Ok(())
    }

    /// How many numbers an action can be.
    pub(crate) fn action_limit(&self) -> usize {
        self.num_actions.unwrap_or(MAX_COUNT)
    }

    fn is_action(&self, number: i64) -> bool {
        class_of(number.saturating_sub(self.first_action)) < self.action_limit()
    }

    /// Accepts numbered actions.
    pub(crate) fn check_actions(&self, field: &'static str, actions: &[i64]) -> Result<()> {
        let Some(index) = actions.iter().position(|&action| !self.is_action(action)) else {
            return Ok(());
        };
        if self.first_action == 0 {
            return check_labels(field, actions, self.action_limit());
        }
        let (first, count) = (self.first_action, label_of(self.action_limit()));
        Err(Error::Argument {
            field,
            expected: format!("numbers in {first}..{}", first + count),
            got: format!("{} at index {index}", actions[index]),
        })
    }

    fn check_first_action(&self) -> Result<()> {
        let most = label_of(MAX_COUNT);
        if (-most..=most).contains(&self.first_action) {
            return Ok(());
        }
        Err(Error::Argument {
            field: "first_action",
            expected: format!("a number in {}..={most}", -most),
            got: self.first_action.to_string(),
        })
    }

    /// The interaction that an action did; None where it was a move.
    pub(crate) fn interaction_of(&self, action: Option<&i64>) -> Option<i64> {
        self.interactions.get(action?).copied()
    }

    /// Shape of one observation: as `stacking` says.
    #[must_use]
    pub fn observation_shape(&self) -> Vec<usize> {
        self.stacking.of_shape(&self.frame_shape, self.frame_stack)
    }

    /// Bytes of one frame.
    #[must_use]
    pub fn frame_bytes(&self) -> usize {
        self.frame_shape.iter().product::<usize>() * self.frame_item.bytes()
    }

    /// Bytes of one observation: of its stacked frames.
    #[must_use]
    pub fn observation_bytes(&self) -> usize {
        self.frame_stack * self.frame_bytes()
    }

    /// Bytes of what counts as reached at a frame: a goal vector or an observation.
    #[must_use]
    pub fn goal_bytes(&self) -> usize {
        self.vector_bytes().unwrap_or(self.observation_bytes())
    }

    /// Bytes of a goal vector, where goals are vectors.
    pub(crate) fn vector_bytes(&self) -> Option<usize> {
        match &self.goal_kind {
            GoalKind::Vectors { shape, item } => {
                Some(shape.iter().product::<usize>() * item.bytes())
            }
            _ => None,
        }
    }

    /// Bytes of the goal that an episode is told, beside its class number.
    pub(crate) fn desired_bytes(&self) -> usize {
        match self.goal_kind {
            GoalKind::Labels => 0,
            _ => self.goal_bytes(),
        }
    }
}
