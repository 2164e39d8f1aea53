//! Any bytes as an episode buffer file: an error or a buffer that works, never a panic or a large allocation.
#![no_main]

#[path = "../support.rs"]
mod support;

use libfuzzer_sys::fuzz_target;
use vhs_core::config::Backing;
use vhs_core::episodes::EpisodeBuffer;
use vhs_core::reward::SparseReward;
use vhs_core::strategy::{HindsightRule, Share, Strategy};
use vhs_core::windows::WindowShape;

fuzz_target!(|data: &[u8]| {
    let file = support::file(data);
    let verified = EpisodeBuffer::verify(&file.path);
    let loaded = EpisodeBuffer::load(&file.path, Backing::Memory);
    assert_eq!(verified.is_ok(), loaded.is_ok(), "{verified:?}");
    // SAFETY: the file is this call's own, and `save` below puts another in its place.
    let mapped = unsafe { EpisodeBuffer::map(&file.path) };
    let rule = HindsightRule::new(Strategy::Random, Share::Ratio(3)).expect("a valid ratio");
    for mut buffer in loaded.into_iter().chain(mapped) {
        // A stack may be a million frames high: only what a sane batch costs is asked for.
        let small = buffer.config().observation_bytes() * 100 < 1 << 24;
        if !buffer.is_empty() && small {
            let reward = SparseReward::default();
            buffer.sample(2, None).expect("episodes to draw");
            buffer
                .sample_transitions(4, Some(&rule), Some(&reward))
                .expect("steps to draw");
            let shape = WindowShape {
                length: 2,
                burn_in: 1,
            };
            buffer
                .sample_windows(3, shape, Some(&rule), None)
                .expect("steps to draw");
        }
        buffer.save(&file.path).expect("a writable folder");
    }
});
