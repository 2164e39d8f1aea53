//! Buffers that stay on the disk: the same as those in memory, however often they are left and reopened.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use vhs_core::config::{Field, Per};
use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, GoalKind, Item, Opening, Steps};
use vhs_core::error::{Error, Result};
use vhs_core::outcome::Outcome;

use crate::support::scratch;

const LONGEST: usize = 4;

fn config() -> EpisodeConfig {
    EpisodeConfig {
        frame_shape: vec![6],
        frame_stack: 2,
        num_streams: 2,
        max_episode_steps: LONGEST,
        capacity_steps: 14,
        num_goals: 5,
        goal_kind: GoalKind::Vectors {
            shape: vec![3],
            item: Item::I16,
        },
        fields: vec![Field {
            name: "skill".into(),
            shape: vec![],
            item: Item::U32,
            per: Per::Step,
            is_stacked: false,
        }],
        priority_exponent: Some(0.5),
        ..EpisodeConfig::default()
    }
}

fn keep(folder: &Path) -> Result<EpisodeBuffer> {
    // SAFETY: the folder is this test's own.
    unsafe { EpisodeBuffer::keep(config(), folder) }
}

fn reopen(folder: &Path) -> Result<EpisodeBuffer> {
    // SAFETY: the folder is this test's own, and changes only while no buffer has it.
    unsafe { EpisodeBuffer::reopen(folder, true) }
}

/// What goes into a buffer follows from a number.
struct Numbers(u32);

impl Numbers {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        self.0 += 1;
        let all = self.0.to_le_bytes();
        std::array::from_fn(|place| all.get(place).copied().unwrap_or(7))
    }

    fn record(&mut self, buffers: &mut [&mut EpisodeBuffer], stream: i64, length: usize) {
        let (frame, told, reached) = (self.bytes::<6>(), self.bytes::<6>(), self.bytes::<6>());
        for buffer in &mut *buffers {
            let opening = Opening {
                frame: &frame,
                goal: 3,
                desired: &told,
                achieved: &reached,
                fields: &[&[]],
                ..Opening::default()
            };
            buffer.begin_with(stream, opening).expect("an idle stream");
        }
        for _ in 0..length {
            let (frame, reached, skill) = (self.bytes::<6>(), self.bytes::<6>(), self.bytes::<4>());
            for buffer in &mut *buffers {
                let steps = Steps {
                    streams: &[stream],
                    actions: &[i64::from(self.0)],
                    rewards: &[0.5],
                    values: &[-0.5],
                    frames: &frame,
                    achieved: &reached,
                    fields: &[&skill],
                    ..Steps::default()
                };
                buffer.append(steps).expect("an open episode");
            }
        }
    }

    fn finish(buffers: &mut [&mut EpisodeBuffer], stream: i64) {
        for buffer in buffers {
            let finished = buffer.finish_with(stream, Outcome::Timeout, true);
            finished.expect("an episode of some steps");
        }
    }
}

fn assert_same(kept: &EpisodeBuffer, memory: &EpisodeBuffer) {
    let ids: Vec<i64> = memory.ids().collect();
    assert_eq!(kept.ids().collect::<Vec<_>>(), ids);
    if !ids.is_empty() {
        assert_eq!(
            kept.gather(&ids).expect("stored"),
            memory.gather(&ids).expect("stored")
        );
    }
}

#[derive(Clone, Debug)]
enum Call {
    Record(usize),
    Leave,
    Clear,
    Reopen,
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    let record = (1..=LONGEST).prop_map(Call::Record);
    prop::collection::vec(
        prop_oneof![8 => record, 1 => Just(Call::Leave), 1 => Just(Call::Clear), 2 => Just(Call::Reopen)],
        1..30,
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn a_reopened_buffer_is_what_it_was(calls in calls()) {
        let folder = scratch("kept");
        let mut kept = keep(&folder).expect("an empty folder");
        let mut memory = EpisodeBuffer::new(config()).expect("valid sizes");
        let mut numbers = Numbers(0);
        for call in calls {
            match call {
                Call::Record(length) => {
                    numbers.record(&mut [&mut kept, &mut memory], 0, length);
                    Numbers::finish(&mut [&mut kept, &mut memory], 0);
                }
                // An episode that is open when the process leaves is lost.
                Call::Leave => {
                    numbers.record(&mut [&mut kept, &mut memory], 1, 2);
                    memory.abort(1).expect("an open episode");
                    drop(kept);
                    kept = reopen(&folder).expect("what was left");
                }
                Call::Clear => {
                    kept.clear().expect("a writable folder");
                    memory.clear().expect("memory");
                }
                Call::Reopen => {
                    drop(kept);
                    kept = reopen(&folder).expect("what was left");
                }
            }
            assert_same(&kept, &memory);
            prop_assert_eq!(kept.num_steps(), memory.num_steps());
        }
        drop(kept);
        fs::remove_dir_all(folder).expect("our own folder");
    }
}

/// A folder with episodes 0, 1 and 2.
fn left(folder: &Path) -> EpisodeBuffer {
    let mut kept = keep(folder).expect("an empty folder");
    let mut memory = EpisodeBuffer::new(config()).expect("valid sizes");
    let mut numbers = Numbers(0);
    for length in [1, 3, 2] {
        numbers.record(&mut [&mut kept, &mut memory], 0, length);
        Numbers::finish(&mut [&mut kept, &mut memory], 0);
    }
    memory
}

#[test]
fn a_journal_that_ends_anywhere_keeps_whole_episodes() {
    let folder = scratch("torn");
    let memory = left(&folder);
    let path = folder.join("journal");
    let whole = fs::read(&path).expect("our own file");
    let mut found = Vec::new();
    for length in (0..whole.len()).rev() {
        for tail in [&[][..], &[0; 40]] {
            fs::write(&path, [&whole[..length], tail].concat()).expect("our own file");
            match reopen(&folder) {
                Ok(buffer) => {
                    let ids: Vec<i64> = buffer.ids().collect();
                    if !ids.is_empty() {
                        assert_eq!(
                            buffer.gather(&ids).expect("stored"),
                            memory.gather(&ids).expect("stored")
                        );
                    }
                    found.push(ids.len());
                }
                // Of the head, or an entry whose end is zeros: a kill leaves none.
                Err(error) => assert!(matches!(error, Error::Damaged { .. }), "{error}"),
            }
        }
    }
    found.dedup();
    assert_eq!(found.first(), Some(&2), "{found:?}");
    assert!(found.contains(&1) && found.contains(&0) && !found.contains(&3));
    fs::remove_dir_all(folder).expect("our own folder");
}

#[test]
fn a_changed_byte_is_noticed_unless_it_is_of_the_newest_episode() {
    let folder = scratch("flipped");
    left(&folder);
    let path = folder.join("journal");
    let whole = fs::read(&path).expect("our own file");
    for place in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[place] ^= 0x10;
        fs::write(&path, damaged).expect("our own file");
        match reopen(&folder) {
            Ok(buffer) => assert_eq!(buffer.len(), 2, "byte {place}"),
            Err(error) => assert!(matches!(error, Error::Damaged { .. }), "{error}"),
        }
    }
    fs::remove_dir_all(folder).expect("our own folder");
}

#[test]
fn frames_that_were_altered_are_noticed_and_the_newest_dropped() {
    for name in ["frames", "goals", "field-1"] {
        let folder = scratch("altered");
        let memory = left(&folder);
        let (path, size) = (folder.join(name), if name == "field-1" { 4 } else { 6 });
        let mut bytes = fs::read(&path).expect("our own file");
        // Frame 8 is the last one of the newest episode, frame 3 one of the second.
        bytes[8 * size] ^= 1;
        fs::write(&path, &bytes).expect("our own file");
        let mut kept = reopen(&folder).expect("all but the newest");
        assert_eq!(kept.ids().collect::<Vec<_>>(), [0, 1], "{name}");
        assert_eq!(
            kept.gather(&[0, 1]).expect("stored"),
            memory.gather(&[0, 1]).expect("stored")
        );
        Numbers(50).record(&mut [&mut kept], 0, 4);
        Numbers::finish(&mut [&mut kept], 0);
        drop(kept);
        assert_eq!(
            reopen(&folder)
                .expect("three episodes")
                .ids()
                .collect::<Vec<_>>(),
            [0, 1, 2]
        );
        let mut bytes = fs::read(&path).expect("our own file");
        bytes[3 * size] ^= 1;
        fs::write(&path, &bytes).expect("our own file");
        let error = reopen(&folder).expect_err("an episode that was altered");
        assert!(error.to_string().contains("others in episode 1"), "{error}");
        fs::remove_dir_all(folder).expect("our own folder");
    }
}

#[test]
fn a_folder_is_one_buffers() {
    let folder = scratch("one");
    let kept = keep(&folder).expect("an empty folder");
    for refused in [keep(&folder), reopen(&folder)] {
        let error = refused.expect_err("a folder in use").to_string();
        assert!(
            error.contains("expected a folder that no other buffer uses"),
            "{error}"
        );
    }
    drop(kept);
    let error = keep(&folder)
        .expect_err("a folder with a buffer")
        .to_string();
    assert!(
        error.contains("expected a folder without a buffer"),
        "{error}"
    );
    reopen(&folder).expect("an empty buffer");
    let missing = reopen(&folder.join("missing"));
    assert!(
        matches!(missing, Err(Error::Io { call: "open", .. })),
        "{missing:?}"
    );
    fs::remove_dir_all(folder).expect("our own folder");
}
