//! The head of an episode buffer file: what the buffer was built from, its counters and its generator.

mod fields;

use crate::buffer::config::{EpisodeConfig, GoalKind, Stacking};
use crate::buffer::episodes::EpisodeBuffer;
use crate::buffer::field::Field;
use crate::buffer::priorities::Priorities;
use crate::item::Item;
use crate::labels::{class_of, label_of};
use crate::storage::files::{ALIGNMENT, MAX_DIMENSIONS, MAX_SIZE, Reader};
use crate::storage::saves::push_words;
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

const MAGIC: [u8; 8] = *b"vhsepiso";
const VERSION: u32 = 4;
/// Words between the version and the frame shape: in version 4, in 3, and before.
const FIXED: [usize; 3] = [24, 20, 19];
/// Stands for an exponent of priorities where there are none: no number.
const NO_EXPONENT: u64 = u64::MAX;
/// Types of elements that versions before 3 know.
const ITEMS_BEFORE: u64 = 6;
/// Counters stay below this, so that whatever is added to a loaded buffer fits them.
const MAX_COUNTER: u64 = 1 << 62;
/// The most actions or interactions that a list of them is made for.
const MAX_LABELS: usize = 1 << 20;

/// What a head says of the episodes that come after it.
pub(crate) struct Counters {
    /// The id that the next episode gets.
    pub(crate) next_id: u64,
    /// Steps of all that ever finished.
    pub(crate) finished_steps: u64,
    pub(crate) episodes: usize,
    /// Of these episodes.
    pub(crate) steps: usize,
}

/// Everything before the episodes.
pub(crate) fn write(buffer: &EpisodeBuffer, rng: &Rng, counters: &Counters) -> Result<Vec<u8>> {
    let config = &buffer.config;
    let (kind, item, shape) = match &config.goal_kind {
        GoalKind::Labels => (0, 0, &[][..]),
        GoalKind::Observations => (1, 0, &[][..]),
        GoalKind::Vectors { shape, item } => (2, *item as u64, &shape[..]),
    };
    let shapes = [
        ("frame_shape", &config.frame_shape[..]),
        ("goal_shape", shape),
    ];
    let fields = config
        .fields
        .iter()
        .map(|field| ("fields", &field.shape[..]));
    for (field, shape) in shapes.into_iter().chain(fields) {
        if shape.len() > MAX_DIMENSIONS {
            return Err(Error::Argument {
                field,
                expected: format!("at most {MAX_DIMENSIONS} dimensions in a file"),
                got: shape.len().to_string(),
            });
        }
    }
    let (frame, stacking) = (config.frame_item as u64, config.stacking as u64);
    let kinds = kind | item << 8 | frame << 16 | stacking << 24 | (shape.len() as u64) << 32;
    let mut head = MAGIC.to_vec();
    let mut put = |words: &[u64]| push_words(&mut head, words.iter().copied());
    let version = u64::from(VERSION) | (config.frame_shape.len() as u64) << 32;
    put(&[version, kinds]);
    put(&sizes(config).map(|size| size as u64));
    put(&[config.seed]);
    put(&rng.state());
    put(&[counters.next_id, counters.finished_steps]);
    put(&[counters.episodes as u64, counters.steps as u64]);
    put(&[
        config.first_action.cast_unsigned(),
        config.fields.len() as u64,
    ]);
    let exponent = config.priority_exponent.map_or(NO_EXPONENT, f64::to_bits);
    let priorities = buffer.priorities.as_ref();
    let largest = priorities.map_or(0.0, |priorities| priorities.largest);
    let leaves = priorities.map_or(0, Priorities::leaves);
    put(&[exponent, largest.to_bits(), leaves as u64]);
    let shapes = config.frame_shape.iter().chain(shape);
    push_words(&mut head, shapes.map(|&size| size as u64));
    let pairs = config.interactions.iter();
    push_words(
        &mut head,
        pairs.flat_map(|(&action, &interaction)| [action, interaction].map(i64::cast_unsigned)),
    );
    config
        .fields
        .iter()
        .for_each(|field| fields::write(field, &mut head));
    Ok(head)
}

/// The sizes of a configuration, in the order of the file; 0 actions stand for any number of them.
fn sizes(config: &EpisodeConfig) -> [usize; 9] {
    [
        config.num_streams,
        config.max_episode_steps,
        config.capacity_steps,
        config.frame_stack,
        config.num_goals,
        config.num_interactions,
        config.num_actions.unwrap_or_default(),
        config.action_dim,
        config.interactions.len(),
    ]
}

/// A file's header, checked against itself and the length of the file.
pub(super) struct Header {
    version: u64,
    pub(super) config: EpisodeConfig,
    pub(super) rng: Rng,
    pub(super) next_id: u64,
    pub(super) finished_steps: u64,
    /// E.
    pub(super) episodes: usize,
    /// S.
    pub(super) steps: usize,
    /// The largest odds that a step ever had, where there are priorities.
    pub(super) largest: f64,
    /// Leaves of the tree of priorities.
    pub(super) leaves: usize,
}

impl Header {
    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let (version, dimensions) = reader.first(MAGIC, VERSION)?;
        let fixed = reader.words(fixed_words(version))?;
        let (kinds, rest) = (fixed[0], &fixed[1..]);
        let frame = reader.number("frame dimensions", dimensions, 1, MAX_DIMENSIONS)?;
        let most = if kinds & 255 == 2 { MAX_DIMENSIONS } else { 0 };
        let goal = reader.number("goal dimensions", kinds >> 32, 0, most)?;
        let shapes = reader.words(frame + goal)?;
        let mut shapes = shapes
            .iter()
            .map(|&size| reader.number("shape", size, 1, MAX_SIZE))
            .collect::<Result<Vec<_>>>()?;
        let goal_shape = shapes.split_off(frame);
        let mut config = config(reader, version, kinds, &rest[..10], [shapes, goal_shape])?;
        config.first_action = rest.get(18).map_or(0, |first| first.cast_signed());
        let mut config = match version {
            1 => with_interactions_from(reader, config, rest[6], rest[8])?,
            _ => with_interactions(reader, config, rest[6], rest[8])?,
        };
        let count = rest.get(19).copied().unwrap_or_default();
        config.fields = fields::read(reader, count)?;
        let exponent = rest.get(20).filter(|&&word| word != NO_EXPONENT);
        config.priority_exponent = exponent.copied().map(f64::from_bits);
        config.check().map_err(|error| lie(reader, &error))?;
        let state = [rest[10], rest[11], rest[12], rest[13]];
        let zero = || reader.damaged("generator state", "one that is not zero", "0");
        let header = Self {
            version,
            config,
            rng: Rng::from_state(state).ok_or_else(zero)?,
            next_id: rest[14],
            finished_steps: rest[15],
            episodes: reader.number("episodes", rest[16], 0, MAX_SIZE)?,
            steps: reader.number("steps", rest[17], 0, MAX_SIZE)?,
            largest: rest.get(21).copied().map_or(0.0, f64::from_bits),
            leaves: reader.number("leaves", rest.get(22).copied().unwrap_or(0), 0, MAX_SIZE)?,
        };
        header.check_counters(reader)?;
        Ok(header)
    }

    fn check_counters(&self, reader: &Reader<'_>) -> Result<()> {
        let range = self.episodes as u64..=MAX_COUNTER;
        if !range.contains(&self.next_id) {
            let expected = format!("a number in {range:?}");
            return Err(reader.damaged("next id", &expected, &self.next_id.to_string()));
        }
        let held = self.steps <= self.config.capacity_steps
            && self.steps >= self.episodes
            && (self.steps as u64..=MAX_COUNTER).contains(&self.finished_steps);
        if !held {
            let found = format!("{} in {} episodes", self.steps, self.episodes);
            return Err(reader.damaged("steps", "what the buffer can hold", &found));
        }
        Ok(())
    }

    /// Before memory is taken: all sizes together must be those of the file.
    pub(super) fn check_length(&self, reader: &Reader<'_>) -> Result<()> {
        let padded = self.bytes().and_then(|bytes| {
            let padded = bytes.checked_next_multiple_of(ALIGNMENT)?;
            padded.checked_add(self.beside_bytes()?)?.checked_add(16)
        });
        let frames = self.rows().checked_mul(self.config.frame_bytes());
        reader.expect_length(frames.and_then(|frames| frames.checked_add(padded?)))
    }

    /// Bytes before the padding.
    pub(super) fn bytes(&self) -> Option<usize> {
        let config = &self.config;
        let goal = match &config.goal_kind {
            GoalKind::Vectors { shape, .. } => shape.len(),
            _ => 0,
        };
        let pairs = if self.version == 1 {
            0
        } else {
            config.interactions.len()
        };
        let fields: usize = config.fields.iter().map(fields::words).sum();
        let shapes = config.frame_shape.len() + goal;
        let words = 2 + fixed_words(self.version) + shapes + 2 * pairs + fields + 1;
        let action = match config.action_dim {
            0 => 8,
            dim => 4 * dim,
        };
        let step = 8 + action + config.priority_exponent.map_or(0, |_| 8);
        let episodes = self.episodes.checked_mul(32)?;
        let steps = self.steps.checked_mul(step)?;
        (8 * words).checked_add(episodes)?.checked_add(steps)
    }

    /// Bytes of goals and fields.
    fn beside_bytes(&self) -> Option<usize> {
        let told = self.episodes.checked_mul(self.config.desired_bytes())?;
        let reached = self.config.vector_bytes().unwrap_or_default();
        let mut fields = self.config.fields.iter().map(Field::bytes);
        let row = fields.try_fold(reached, usize::checked_add)?;
        told.checked_add(self.rows().checked_mul(row)?)
    }

    /// Frames: one more in each episode than steps. Both are below 2^63.
    pub(super) const fn rows(&self) -> usize {
        self.steps + self.episodes
    }
}

/// Words between the version and the frame shape.
const fn fixed_words(version: u64) -> usize {
    match version {
        4.. => FIXED[0],
        3 => FIXED[1],
        _ => FIXED[2],
    }
}

/// The type of elements that the last byte of a word stands for, where so many types are known.
fn item(reader: &Reader<'_>, field: &'static str, word: u64, known: u64) -> Result<Item> {
    let number = word & 255;
    let found = Item::ALL.into_iter().find(|&item| item as u64 == number);
    found
        .filter(|_| number < known)
        .ok_or_else(|| reader.damaged(field, "a known type", &number.to_string()))
}

/// Everything of a configuration but its actions, interactions and fields.
fn config(
    reader: &Reader<'_>,
    version: u64,
    kinds: u64,
    numbers: &[u64],
    [frame_shape, shape]: [Vec<usize>; 2],
) -> Result<EpisodeConfig> {
    let known = if version < 3 {
        ITEMS_BEFORE
    } else {
        Item::ALL.len() as u64
    };
    let item = |field, number| item(reader, field, number, known);
    let size = |place: usize| reader.number("sizes", numbers[place], 0, MAX_SIZE);
    let goal_kind = match kinds & 255 {
        0 => GoalKind::Labels,
        1 => GoalKind::Observations,
        2 => GoalKind::Vectors {
            shape,
            item: item("goal type", kinds >> 8)?,
        },
        other => return Err(reader.damaged("kind of goal", "0, 1 or 2", &other.to_string())),
    };
    let stacking = match kinds >> 24 & 255 {
        0 => Stacking::Frames,
        1 => Stacking::Channels,
        other => return Err(reader.damaged("stacking", "0 or 1", &other.to_string())),
    };
    Ok(EpisodeConfig {
        frame_shape,
        frame_item: item("frame type", kinds >> 16)?,
        num_streams: size(0)?,
        max_episode_steps: size(1)?,
        capacity_steps: size(2)?,
        frame_stack: size(3)?,
        stacking,
        num_goals: size(4)?,
        num_interactions: size(5)?,
        action_dim: size(7)?,
        goal_kind,
        seed: numbers[9],
        ..EpisodeConfig::default()
    })
}

/// Actions and interactions as version 1 says them: those from `first` on do interactions 0, 1 and so on.
fn with_interactions_from(
    reader: &Reader<'_>,
    mut config: EpisodeConfig,
    first: u64,
    reserved: u64,
) -> Result<EpisodeConfig> {
    reader.expect("reserved", "0", &reserved.to_string())?;
    let first = reader.number("first interaction", first, 0, MAX_LABELS)?;
    reader.number("sizes", config.num_interactions as u64, 0, MAX_LABELS)?;
    if config.action_dim == 0 {
        config.num_actions = Some(first + config.num_interactions);
        let pairs = (label_of(first)..).zip(0..label_of(config.num_interactions));
        config.interactions = pairs.collect();
    }
    Ok(config)
}

/// Actions and interactions as the newest version says them.
fn with_interactions(
    reader: &mut Reader<'_>,
    mut config: EpisodeConfig,
    actions: u64,
    pairs: u64,
) -> Result<EpisodeConfig> {
    let actions = reader.number("sizes", actions, 0, MAX_SIZE)?;
    let pairs = reader.number("interactions", pairs, 0, MAX_LABELS)?;
    config.num_actions = (actions > 0).then_some(actions);
    let words = reader.words(2 * pairs)?;
    let each = words.as_chunks().0.iter();
    config.interactions = each
        .map(|&[action, interaction]| (action.cast_signed(), interaction.cast_signed()))
        .collect();
    // An action that came twice would leave fewer: what is read again would not be what was read.
    let found = config.interactions.len().to_string();
    reader.expect("interactions", &pairs.to_string(), &found)?;
    Ok(config)
}

/// The error of a file whose checksum is right and whose numbers are not.
pub(crate) fn lie(reader: &Reader<'_>, error: &Error) -> Error {
    reader.damaged("contents", "those of an episode buffer", &error.to_string())
}

/// Non-negative numbers are stored as they are; no other passes the checks.
pub(crate) fn word(number: i64) -> u64 {
    class_of(number) as u64
}

pub(crate) fn number(word: u64) -> i64 {
    usize::try_from(word).map_or(-1, label_of)
}
