//! The episode buffer from plain Rust: record a failure, and learn from it as if what it reached had been its goal.
//!
//! Run with `cargo run --release -p vhs-core --example episodes`.

use std::io::{self, Write};

use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
use vhs_core::outcome::Outcome;
use vhs_core::relabel::Rule;
use vhs_core::reward::SparseReward;
use vhs_core::rng::Rng;
use vhs_core::strategy::{HindsightRule, Share, Strategy};

/// Bytes of one 8x8 RGB frame.
const FRAME: usize = 8 * 8 * 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut out = io::stdout();
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        frame_shape: vec![8, 8, 3],
        frame_stack: 2,
        max_episode_steps: 20,
        capacity_steps: 1000,
        num_goals: 5,
        ..EpisodeConfig::default()
    })?;

    // Told to reach goal 2, it fails after three steps. Frame t is all t.
    buffer.begin(0, &[0; FRAME], 2, 0)?;
    for t in 1..=3 {
        let (streams, actions, rewards, values) = (&[0], &[1], &[-0.01], &[0.0]);
        buffer.append(Steps {
            streams,
            actions,
            rewards,
            values,
            frames: &[t; FRAME],
            ..Steps::default()
        })?;
    }
    let id = buffer.finish(0, Outcome::Failure)?;

    // Whole episodes: the new goal is the number of a row of the batch, no image is copied.
    let batch = buffer.gather(&[id])?;
    let rule = Rule::new([Outcome::Failure].into_iter().collect(), 1.0)?;
    let hindsight = rule.relabel(&batch.index.ends, &mut Rng::new(0));
    let (rows, goal) = (batch.index.rows, hindsight.goal_rows[0]);
    writeln!(
        out,
        "episode: {rows} observations of 2 frames, the new goal is row {goal}"
    )?;

    // Single steps: each with a goal that a later observation of its episode reached.
    let rule = HindsightRule::new(Strategy::Future, Share::Ratio(4))?;
    let steps = buffer.sample_transitions(10, Some(&rule), Some(&SparseReward::default()))?;
    let index = &steps.index;
    for row in 0..10 {
        let (t, goal, reward) = (
            index.goals.steps[row],
            index.goals.goal_steps[row],
            index.rewards[row],
        );
        if index.goals.relabelled[row] {
            writeln!(out, "step {t}: goal is observation {goal}, reward {reward}")?;
        } else {
            writeln!(out, "step {t}: goal as told, reward {reward}")?;
        }
    }
    Ok(())
}
