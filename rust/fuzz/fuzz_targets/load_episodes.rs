//! Any bytes as an episode buffer file: an error or a buffer that works, never a panic or a large allocation.
#![no_main]

#[path = "../support.rs"]
mod support;

use libfuzzer_sys::fuzz_target;
use vhs_core::config::{Backing, GoalKind, Per};
use vhs_core::episodes::{EpisodeBuffer, Opening, Steps};
use vhs_core::outcome::Outcome;
use vhs_core::reward::SparseReward;
use vhs_core::rng::Rng;
use vhs_core::strategy::{HindsightRule, Share, Strategy};
use vhs_core::transitions::TransitionDraw;
use vhs_core::windows::WindowShape;

/// One more episode of one step, whatever counters the file had.
fn play(buffer: &mut EpisodeBuffer) {
    let config = buffer.config();
    let goal = vec![0; config.goal_bytes()];
    let (desired, achieved): (&[u8], &[u8]) = match config.goal_kind {
        GoalKind::Labels => (&[], &[]),
        GoalKind::Observations => (&goal, &[]),
        GoalKind::Vectors { .. } => (&goal, &goal),
    };
    let frame = vec![0; config.frame_bytes()];
    let (actions, vectors) = match config.action_dim {
        0 => (vec![config.first_action], Vec::new()),
        dim => (Vec::new(), vec![0.0; dim]),
    };
    let of_steps: Vec<_> = config.fields.iter().map(|field| vec![0; field.bytes()]).collect();
    let of_steps: Vec<_> = of_steps.iter().map(Vec::as_slice).collect();
    let per = config.fields.iter().map(|field| field.per);
    let first: Vec<_> = per
        .zip(&of_steps)
        .map(|(per, &zeros)| match per {
            Per::Observation => zeros,
            Per::Step => &[],
        })
        .collect();
    let opening = Opening {
        frame: &frame,
        desired,
        achieved,
        fields: &first,
        ..Opening::default()
    };
    let steps = Steps {
        streams: &[0],
        actions: &actions,
        vectors: &vectors,
        rewards: &[0.0],
        values: &[0.0],
        frames: &frame,
        achieved,
        fields: &of_steps,
    };
    buffer.begin_with(0, opening).expect("an idle stream");
    buffer.append(steps).expect("an open episode");
    buffer
        .finish(0, Outcome::Failure)
        .expect("an episode of one step");
}

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
        let config = buffer.config();
        let fields = config.fields.iter().map(|field| field.bytes() * config.frame_stack);
        let step = config.observation_bytes()
            + config.goal_bytes()
            + 8 * config.action_dim
            + fields.sum::<usize>();
        if step * 100 < 1 << 24 {
            play(&mut buffer);
            let reward = SparseReward::default();
            buffer.sample(2, None).expect("episodes to draw");
            buffer
                .sample_transitions(4, Some(&rule), Some(&reward))
                .expect("steps to draw");
            let draw = TransitionDraw {
                n: 4,
                rule: Some(&rule),
                reward: Some(&reward),
                n_step: 3,
                gamma: Some(0.9),
                beta: buffer.config().priority_exponent.map(|_| 0.5),
            };
            buffer
                .sample_transitions_with(&draw, &mut Rng::new(0))
                .expect("steps to draw");
            let shape = WindowShape {
                length: 2,
                burn_in: 1,
                is_strict: false,
            };
            buffer
                .sample_windows(3, shape, Some(&rule), None)
                .expect("steps to draw");
        }
        buffer.save(&file.path).expect("a writable folder");
    }
});
