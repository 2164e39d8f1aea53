//! An episode as words: in a journal, beside the records that its frames lie in.

use crate::buffer::config::EpisodeConfig;
use crate::buffer::episode::{Episode, Opening};
use crate::buffer::file::header::{number, word};
use crate::buffer::file::{TERMINATED, check_episode};
use crate::outcome::Outcome;
use crate::storage::saves::push_words;
use vhs_base::check::check_range;
use vhs_base::error::{Error, Result};

/// Goal, interaction, end, steps, checksum of the frames; their places; actions; the goal told, continuous actions,
/// rewards, values; zeros up to a whole word.
pub(super) fn write_episode(episode: &Episode) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(48 + 32 * episode.frames.len() + episode.desired.len());
    let ended = episode.outcome as u64 + if episode.is_terminated { TERMINATED } else { 0 };
    let (goal, interaction) = (word(episode.goal), word(episode.interaction));
    let steps = episode.len() as u64;
    push_words(
        &mut bytes,
        [goal, interaction, ended, steps, episode.checksum],
    );
    push_words(&mut bytes, episode.frames.iter().map(|&slot| slot as u64));
    push_words(
        &mut bytes,
        episode.actions.iter().map(|&action| action.cast_unsigned()),
    );
    bytes.extend(&episode.desired);
    for numbers in [&episode.vectors, &episode.rewards, &episode.values] {
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    }
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

/// What `write_episode` wrote, checked as `begin`, `append` and `finish` would have.
pub(super) fn read_episode(config: &EpisodeConfig, bytes: &[u8]) -> Result<Episode> {
    let mut content = Content(bytes);
    let [goal, interaction, ended, steps, checksum] = content.words::<5>()?;
    let length = usize::try_from(steps).unwrap_or(usize::MAX);
    check_range("steps of an episode", length, 1, config.max_episode_steps)?;
    let opening = Opening {
        goal: number(goal),
        interaction: number(interaction),
        ..Opening::default()
    };
    let mut episode = Episode::new(&opening, 0, 0);
    episode.outcome = Outcome::from_code(number(ended & (TERMINATED - 1)))?;
    episode.is_terminated = ended & TERMINATED != 0;
    episode.checksum = checksum;
    let slots = content.many(length + 1, u64::from_le_bytes)?;
    episode.frames = slots
        .into_iter()
        .map(|slot| usize::try_from(slot).unwrap_or(usize::MAX - 1))
        .collect();
    if config.action_dim == 0 {
        episode.actions = content.many(length, i64::from_le_bytes)?;
    }
    episode.desired = content.bytes(config.desired_bytes())?.into();
    episode.vectors = content.many(length * config.action_dim, f32::from_le_bytes)?;
    episode.rewards = content.many(length, f32::from_le_bytes)?;
    episode.values = content.many(length, f32::from_le_bytes)?;
    check_episode(config, &episode)?;
    Ok(episode)
}

/// Bytes that are read from the front.
struct Content<'a>(&'a [u8]);

impl<'a> Content<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
        let Some((taken, rest)) = self.0.split_at_checked(count) else {
            return Err(Error::Argument {
                field: "entry",
                expected: format!("{count} more bytes"),
                got: self.0.len().to_string(),
            });
        };
        self.0 = rest;
        Ok(taken)
    }

    fn many<T, const N: usize>(&mut self, count: usize, of: fn([u8; N]) -> T) -> Result<Vec<T>> {
        let bytes = self.bytes(count.saturating_mul(N))?;
        Ok(bytes.as_chunks().0.iter().map(|&bytes| of(bytes)).collect())
    }

    fn words<const N: usize>(&mut self) -> Result<[u64; N]> {
        let words = self.many(N, u64::from_le_bytes)?;
        Ok(std::array::from_fn(|place| words[place]))
    }
}
