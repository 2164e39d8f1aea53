//! Hostile files: every checksum is right, but the numbers lie.

use std::fs;
use std::path::PathBuf;

use crate::buffer::config::{Backing, EpisodeConfig};
use crate::buffer::episode::Steps;
use crate::buffer::episodes::EpisodeBuffer;
use crate::outcome::Outcome;
use crate::storage::checksum::Checksum;
use vhs_base::error::Error;

// Where things lie in a file of two episodes, of two steps and of one, with frames of [2, 3] bytes.
const KINDS: usize = 16;
const SIZES: usize = 24;
const GENERATOR: usize = 104;
const NEXT_ID: usize = 136;
const FINISHED_STEPS: usize = 144;
const NUM_EPISODES: usize = 152;
const NUM_STEPS: usize = 160;
const SHAPE: usize = 208;
/// The one action that does an interaction, and which.
const INTERACTIONS: usize = 224;
/// Goal, interaction, end and steps of each.
const EPISODES: usize = 240;
const ACTIONS: usize = EPISODES + 2 * 32;
const REWARDS: usize = ACTIONS + 3 * 8;
const HEADER_END: usize = REWARDS + 2 * 3 * 4;

fn record(buffer: &mut EpisodeBuffer, length: usize, outcome: Outcome) {
    buffer.begin(0, &[7; 6], 4, 0).expect("an idle stream");
    for _ in 0..length {
        let (streams, actions, rewards, values) = (&[0], &[3], &[-1.0], &[0.5]);
        let steps = Steps {
            streams,
            actions,
            rewards,
            values,
            frames: &[8; 6],
            ..Steps::default()
        };
        buffer.append(steps).expect("an open episode");
    }
    buffer.finish(0, outcome).expect("an episode of some steps");
}

fn saved() -> (PathBuf, Vec<u8>) {
    let name = format!(
        "vhs-hostile-episodes-{}-{:?}",
        std::process::id(),
        std::thread::current().id()
    );
    let path = std::env::temp_dir().join(name);
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        frame_shape: vec![2, 3],
        max_episode_steps: 4,
        capacity_steps: 8,
        num_goals: 5,
        num_actions: Some(4),
        num_interactions: 1,
        interactions: [(3, 0)].into(),
        ..EpisodeConfig::default()
    })
    .expect("valid sizes");
    record(&mut buffer, 2, Outcome::Failure);
    record(&mut buffer, 1, Outcome::Success);
    buffer.save(&path).expect("a writable folder");
    let bytes = fs::read(&path).expect("what was just saved");
    (path, bytes)
}

/// The error of a file in which `bytes` replace those at `offset`, its header checksum made right again.
fn load_with(offset: usize, lie: &[u8]) -> Error {
    let (path, mut bytes) = saved();
    bytes[offset..offset + lie.len()].copy_from_slice(lie);
    let checksum = Checksum::of(&bytes[..HEADER_END]);
    bytes[HEADER_END..HEADER_END + 8].copy_from_slice(&checksum.to_le_bytes());
    fs::write(&path, bytes).expect("a writable folder");
    let result = EpisodeBuffer::load(&path, Backing::Memory);
    let verified = EpisodeBuffer::verify(&path).expect_err("a file that lies");
    fs::remove_file(&path).expect("our own file");
    let error = result.expect_err("a file that lies");
    assert_eq!(
        error.to_string(),
        verified.to_string(),
        "both read the same header"
    );
    error
}

fn assert_damaged(offset: usize, word: u64, expected: &str) {
    let error = load_with(offset, &word.to_le_bytes());
    assert!(matches!(error, Error::Damaged { .. }), "{error}");
    assert!(error.to_string().contains(expected), "{error}");
}

#[test]
fn the_tampered_copy_itself_is_readable() {
    let (path, bytes) = saved();
    let checksum = Checksum::of(&bytes[..HEADER_END]).to_le_bytes();
    assert_eq!(bytes[HEADER_END..HEADER_END + 8], checksum, "the layout");
    let buffer = EpisodeBuffer::load(&path, Backing::Memory).expect("an intact file");
    assert_eq!(buffer.len(), 2);
    fs::remove_file(path).expect("our own file");
}

#[test]
fn other_kinds_of_files_are_named() {
    assert_damaged(0, 0, "`first bytes`: expected vhsepiso, found \\x00");
    assert_damaged(
        8,
        (2 << 32) | 9,
        "`version`: expected one in 1..=4, found 9",
    );
    assert_damaged(
        8,
        (65 << 32) | 1,
        "`frame dimensions`: expected a number in 1..=64, found 65",
    );
    assert_damaged(KINDS, 3, "`kind of goal`: expected 0, 1 or 2, found 3");
    assert_damaged(KINDS, 200 << 16, "`frame type`: expected a known type");
    assert_damaged(
        KINDS,
        2 << 32,
        "`goal dimensions`: expected a number in 0..=0, found 2",
    );
}

#[test]
fn sizes_that_no_memory_holds_are_refused_before_memory_is_taken() {
    assert_damaged(SHAPE, u64::MAX, "`shape`: expected a number in 1..=");
    assert_damaged(SHAPE, 1 << 62, "`contents`: expected those of an episode");
    assert_damaged(SIZES + 16, u64::MAX, "`sizes`: expected a number in 0..=");
    assert_damaged(SIZES + 16, 1 << 62, "`contents`: expected those of");
    assert_damaged(NUM_EPISODES, 1 << 62, "`next id`: expected a number in");
    assert_damaged(NUM_STEPS, 9, "`steps`: expected what the buffer can hold");
    assert_damaged(NUM_STEPS, 2, "`length in bytes`: expected");
}

#[test]
fn counters_that_contradict_the_episodes_are_refused() {
    assert_damaged(NEXT_ID, 1, "`next id`: expected a number in 2..=");
    for most in [u64::MAX, i64::MAX.unsigned_abs()] {
        assert_damaged(NEXT_ID, most, "`next id`: expected a number in 2..=");
        assert_damaged(FINISHED_STEPS, most, "`steps`: expected what the buffer");
    }
    assert_damaged(FINISHED_STEPS, 2, "`steps`: expected what the buffer");
    assert_damaged(EPISODES + 24, 1, "`steps`: expected 3, found 2");
    assert_damaged(EPISODES + 24, 3, "`steps`: expected 3, found 4");
    for steps in [0, 5] {
        assert_damaged(
            EPISODES + 24,
            steps,
            "`steps of an episode`: expected a number in 1..=4",
        );
    }
}

#[test]
fn episodes_that_could_not_have_been_recorded_are_refused() {
    assert_damaged(EPISODES, 5, "`contents`: expected those of");
    assert_damaged(EPISODES, u64::MAX, "`contents`: expected those of");
    assert_damaged(EPISODES + 8, 1, "`contents`: expected those of");
    assert_damaged(EPISODES + 16, 3, "`contents`: expected those of");
    assert_damaged(
        EPISODES + 16,
        2 << 8,
        "`end of an episode`: expected a number in 0..=1, found 2",
    );
    assert_damaged(ACTIONS, 4, "`contents`: expected those of");
    for place in 0..6 {
        let error = load_with(REWARDS + 4 * place, &f32::NAN.to_le_bytes());
        assert!(matches!(error, Error::Damaged { .. }), "{error}");
        assert!(error.to_string().contains("finite"), "{error}");
    }
}

#[test]
fn interactions_that_no_action_can_do_are_refused() {
    let lie = "`contents`: expected those of";
    assert_damaged(INTERACTIONS, 4, lie); // of four actions
    assert_damaged(INTERACTIONS + 8, 1, lie); // of one interaction
    assert_damaged(INTERACTIONS + 8, u64::MAX, lie);
    assert_damaged(SIZES + 64, 1 << 62, "`interactions`: expected a number in");
    assert_damaged(SIZES + 64, 0, "`steps of an episode`: expected a number in");
    assert_damaged(SIZES + 40, 0, lie); // of none
    assert_damaged(KINDS, 2 << 24, "`stacking`: expected 0 or 1, found 2");
}

#[test]
fn a_generator_that_only_yields_zero_is_refused() {
    let error = load_with(GENERATOR, &[0; 32]);
    assert!(error.to_string().contains("`generator state`"), "{error}");
}

#[test]
fn the_largest_counters_that_load_leave_room_for_more_episodes() {
    let (path, mut bytes) = saved();
    for counter in [NEXT_ID, FINISHED_STEPS] {
        bytes[counter..counter + 8].copy_from_slice(&(1_u64 << 62).to_le_bytes());
    }
    let checksum = Checksum::of(&bytes[..HEADER_END]);
    bytes[HEADER_END..HEADER_END + 8].copy_from_slice(&checksum.to_le_bytes());
    fs::write(&path, bytes).expect("a writable folder");
    let mut buffer = EpisodeBuffer::load(&path, Backing::Memory).expect("counters in range");
    fs::remove_file(&path).expect("our own file");
    record(&mut buffer, 2, Outcome::Failure);
    let ids: Vec<i64> = buffer.ids().collect();
    assert_eq!(
        ids.last().copied(),
        Some(1 << 62),
        "of the newest of {ids:?}"
    );
    let (batch, _) = buffer.sample(4, None).expect("episodes to draw");
    assert!(batch.index.ids.iter().all(|id| ids.contains(id)));
}
