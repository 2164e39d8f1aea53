//! What the tests share: the naive references and small helpers.

pub(crate) mod naive;

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use vhs_core::episodes::EpisodeConfig;

/// Bytes of one test frame.
pub(crate) const FRAME_BYTES: usize = 6;

/// A buffer configuration small enough that eviction, wraps and full episodes all happen often.
pub(crate) fn small_config(frame_stack: usize, capacity_steps: usize) -> EpisodeConfig {
    EpisodeConfig {
        frame_shape: vec![3, 2],
        num_streams: 3,
        max_episode_steps: 4,
        capacity_steps,
        frame_stack,
        num_goals: 5,
        num_interactions: 3,
        num_actions: Some(6),
        interactions: [(3, 0), (4, 1), (5, 2)].into(),
        seed: 11,
        ..EpisodeConfig::default()
    }
}

/// Frames that are all different: equal bytes mean the same frame.
#[derive(Default)]
pub(crate) struct FrameSource(u32);

impl FrameSource {
    pub(crate) fn next(&mut self) -> Vec<u8> {
        self.0 += 1;
        let mut frame = self.0.to_le_bytes().to_vec();
        frame.resize(FRAME_BYTES, 7);
        frame
    }
}

/// A path under the build directory that no other test uses.
pub(crate) fn scratch(name: &str) -> PathBuf {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let folder = format!("{name}-{}-{number}", std::process::id());
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(folder);
    std::fs::create_dir_all(&folder).expect("a scratch folder under the build directory");
    folder
}
