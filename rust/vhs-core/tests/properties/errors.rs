//! Every variant is raised through the public API, and its message is spelled out here once.

use std::path::Path;

use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
use vhs_core::error::Error;
use vhs_core::goals::{Balance, GoalStore};
use vhs_core::outcome::Outcome;
use vhs_core::returns::discounted_returns;

/// The name of a variant.
fn variant(error: &Error) -> String {
    let shown = format!("{error:?}");
    let end = shown.find(' ').unwrap_or(shown.len());
    shown[..end].into()
}

/// Every variant; `vhs-base` does not compile with one that is not listed.
const VARIANTS: [&str; 13] = [
    "Shape",
    "Argument",
    "Label",
    "NonFinite",
    "Empty",
    "Protocol",
    "TooManySteps",
    "Evicted",
    "UnknownEpisode",
    "Memory",
    "Io",
    "Interrupted",
    "Damaged",
];

/// A buffer of one stream and two steps that has evicted episode 0 and holds episode 1, full.
fn used_buffer() -> EpisodeBuffer {
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        frame_shape: vec![1],
        num_streams: 1,
        max_episode_steps: 2,
        capacity_steps: 2,
        frame_stack: 2,
        num_goals: 1,
        num_interactions: 1,
        seed: 0,
        ..EpisodeConfig::default()
    })
    .expect("valid sizes");
    for _ in 0..2 {
        buffer.begin(0, &[0], 0, 0).expect("an idle stream");
        append(&mut buffer).expect("an open episode");
        append(&mut buffer).expect("an open episode");
        buffer.finish(0, Outcome::Failure).expect("an open episode");
    }
    buffer
}

fn append(buffer: &mut EpisodeBuffer) -> vhs_core::error::Result<()> {
    let (streams, actions, rewards, values) = (&[0], &[0], &[0.0], &[0.0]);
    buffer.append(Steps {
        streams,
        actions,
        rewards,
        values,
        frames: &[0],
        ..Steps::default()
    })
}

fn store() -> GoalStore {
    GoalStore::new(2, &[3], 1, 0).expect("valid sizes")
}

fn too_many_steps() -> Error {
    let mut buffer = used_buffer();
    buffer.begin(0, &[0], 0, 0).expect("an idle stream");
    append(&mut buffer).expect("an open episode");
    append(&mut buffer).expect("an open episode");
    append(&mut buffer).expect_err("a third step")
}

fn out_of_memory() -> Error {
    let mut store = GoalStore::new(1, &[1], 1, 0).expect("valid sizes");
    store.push(&[0], 0).expect("a valid image");
    store
        .sample(1 << 60, Balance::Images)
        .expect_err("more than any machine has")
}

fn damaged() -> Error {
    let path = std::env::temp_dir().join(format!("vhs-not-a-store-{}", std::process::id()));
    std::fs::write(&path, [b'x'; 64]).expect("a writable folder");
    let error = GoalStore::load(&path).expect_err("not a goal store");
    std::fs::remove_file(&path).expect("our own file");
    error
}

fn interrupted() -> Error {
    let stop = std::sync::Arc::new(true.into());
    vhs_base::interrupt::watched(stop, || {
        used_buffer()
            .gather(&[1])
            .expect_err("a call that is to stop")
    })
}

fn cases() -> Vec<(Error, &'static str)> {
    vec![
        (
            store().push(&[0; 4], 0).expect_err("four bytes"),
            "`observation`: expected shape [3], got [4]",
        ),
        (
            GoalStore::new(0, &[3], 1, 0).expect_err("no classes"),
            "`num_classes`: expected a number in 1..=1048576, got 0",
        ),
        (
            store().push(&[0; 3], -1).expect_err("a negative label"),
            "`label`: expected a number in 0..2, got -1 at index 0",
        ),
        (
            discounted_returns(&[0.0, f32::NAN], 2, &[2], 0.9).expect_err("a NaN"),
            "`rewards`: expected a finite number, got NaN at index 1",
        ),
        (
            store().sample_class(1, 1).expect_err("an empty class"),
            "GoalStore class 1: expected at least one image, found none",
        ),
        (
            used_buffer()
                .finish(0, Outcome::Failure)
                .expect_err("an idle stream"),
            "`finish` on stream 0: expected an open episode, found none: `begin` opens one",
        ),
        (
            too_many_steps(),
            "`append` on stream 0: expected at most 2 steps in an episode, found one more",
        ),
        (
            used_buffer().gather(&[0]).expect_err("an evicted episode"),
            "episode 0: expected an id of 1 or later, found one already evicted",
        ),
        (
            used_buffer().gather(&[2]).expect_err("an id never given"),
            "episode 2: expected an id below 2, found one never given",
        ),
        (
            out_of_memory(),
            "sample: expected room for 1152921504606846976 more bytes, found too little memory",
        ),
        (
            GoalStore::load(Path::new("/no/such/file")).expect_err("a missing file"),
            "/no/such/file: expected to open it, found: No such file or directory (os error 2)",
        ),
        (interrupted(), "expected to go on, found a request to stop"),
        (
            damaged(),
            "`first bytes`: expected vhsgoals, found xxxxxxxx",
        ),
    ]
}

#[test]
fn every_variant_has_a_message_with_expected_and_found() {
    let mut raised = Vec::new();
    for (error, message) in cases() {
        assert!(error.to_string().ends_with(message), "{error}\n{message}");
        assert!(message.contains("expected"), "{message}");
        raised.push(variant(&error));
    }
    assert_eq!(raised, VARIANTS);
}
