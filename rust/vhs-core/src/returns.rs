//! Monte-Carlo returns: `R_t = r_t + gamma R_(t+1)`, with `R_T = 0` after the last step (paper,
//! section 3.1).

use crate::labels::class_of;
use vhs_base::check::{self, check_finite, check_fraction, check_shape};
use vhs_base::error::{Error, Result};

/// Discounted returns of padded episodes, `[B, T]` like `rewards`; zero after each episode's end.
///
/// `lengths` holds the steps of each episode, in `0..=T`; sums are kept in double precision.
///
/// ```
/// use vhs_core::returns::discounted_returns;
/// let returns = discounted_returns(&[1.0, 2.0, 9.0], 3, &[2], 0.5)?;
/// assert_eq!(returns, [2.0, 2.0, 0.0]); // 1 + 0.5 * 2, then 2, then padding
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::Shape`] where `rewards` is not B rows of `longest`, [`Error::Label`] for a length above
/// `longest`, [`Error::NonFinite`] for a reward inside an episode, [`Error::Argument`] for a
/// `gamma` outside 0..=1.
pub fn discounted_returns(
    rewards: &[f32],
    longest: usize,
    lengths: &[i64],
    gamma: f64,
) -> Result<Vec<f32>> {
    let mut out = check::with_room("discounted_returns", rewards.len())?;
    out.resize(rewards.len(), 0.0);
    discounted_returns_into(rewards, longest, lengths, gamma, &mut out)?;
    Ok(out)
}

/// As [`discounted_returns`], into memory of the caller, of the length of `rewards`.
///
/// # Errors
/// As [`discounted_returns`], and [`Error::Shape`] for an `out` of another length.
pub fn discounted_returns_into(
    rewards: &[f32],
    longest: usize,
    lengths: &[i64],
    gamma: f64,
    out: &mut [f32],
) -> Result<()> {
    let cells = check::product("lengths", &[lengths.len(), longest])?;
    check_shape("rewards", &[cells], &[rewards.len()])?;
    check_shape("out", &[cells], &[out.len()])?;
    check_fraction("gamma", gamma)?;
    check_episodes(rewards, longest, lengths)?;
    for ((out, rewards), &length) in out
        .chunks_mut(longest.max(1))
        .zip(rewards.chunks(longest.max(1)))
        .zip(lengths)
    {
        accumulate(rewards, class_of(length), gamma, out);
    }
    Ok(())
}

fn check_episodes(rewards: &[f32], longest: usize, lengths: &[i64]) -> Result<()> {
    check::check_labels("lengths", lengths, longest + 1)?;
    for (row, (rewards, &length)) in rewards.chunks(longest.max(1)).zip(lengths).enumerate() {
        check_finite("rewards", &rewards[..class_of(length)]).map_err(|error| match error {
            Error::NonFinite { field, index, got } => Error::NonFinite {
                field,
                index: row * longest + index,
                got,
            },
            other => other,
        })?;
    }
    Ok(())
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a rounding to f32 is meant"
)]
fn accumulate(rewards: &[f32], length: usize, gamma: f64, out: &mut [f32]) {
    out[length..].fill(0.0);
    let mut future = 0.0;
    for (out, &reward) in out[..length].iter_mut().zip(&rewards[..length]).rev() {
        future = f64::from(reward) + gamma * future;
        *out = future as f32;
    }
}
