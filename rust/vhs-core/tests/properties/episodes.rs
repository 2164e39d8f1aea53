//! The episode buffer against lists of episodes that own their frames.

use std::fs;

use proptest::prelude::*;
use vhs_core::batch::Layout;
use vhs_core::episodes::{EpisodeBuffer, Steps};
use vhs_core::error::Error;
use vhs_core::outcome::Outcome;

use crate::support::naive::Episodes;
use crate::support::{FRAME_BYTES, FrameSource, scratch, small_config};

/// One call, with arguments in range; whether it is allowed depends on the state it meets.
#[derive(Clone, Debug)]
enum Call {
    Begin {
        stream: usize,
        goal: i64,
        interaction: i64,
    },
    Append {
        streams: Vec<usize>,
        action: i64,
        reward: f32,
    },
    Finish {
        stream: usize,
        outcome: Outcome,
    },
    Abort {
        stream: usize,
    },
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    let begin =
        (0..3_usize, 0..5_i64, 0..3_i64).prop_map(|(stream, goal, interaction)| Call::Begin {
            stream,
            goal,
            interaction,
        });
    let append = (
        prop::collection::vec(0..3_usize, 1..4),
        0..6_i64,
        -1.0..1.0_f32,
    )
        .prop_map(|(streams, action, reward)| Call::Append {
            streams,
            action,
            reward,
        });
    let finish = (0..3_usize, prop::sample::select(&Outcome::ALL[..]))
        .prop_map(|(stream, outcome)| Call::Finish { stream, outcome });
    let abort = (0..3_usize).prop_map(|stream| Call::Abort { stream });
    prop::collection::vec(
        prop_oneof![3 => begin, 8 => append, 3 => finish, 1 => abort],
        1..120,
    )
}

/// The structure under test and its reference, driven by the same calls.
pub(crate) struct Pair {
    pub(crate) buffer: EpisodeBuffer,
    pub(crate) naive: Episodes,
    frames: FrameSource,
}

impl Pair {
    pub(crate) fn new(frame_stack: usize, capacity_steps: usize) -> Self {
        let config = small_config(frame_stack, capacity_steps);
        let buffer = EpisodeBuffer::new(config.clone()).expect("a valid configuration");
        Self {
            buffer,
            naive: Episodes::new(config),
            frames: FrameSource::default(),
        }
    }

    pub(crate) fn begin(&mut self, stream: usize, goal: i64, interaction: i64) {
        let frame = self.frames.next();
        let result = self.buffer.begin(number(stream), &frame, goal, interaction);
        assert_eq!(
            result.is_ok(),
            self.naive.begin(stream, frame, goal, interaction),
            "{result:?}"
        );
    }

    pub(crate) fn append(&mut self, streams: &[usize], action: i64, reward: f32) {
        let mut steps = Vec::new();
        for &stream in streams {
            steps.push((stream, action, reward, 2.0 * reward, self.frames.next()));
        }
        let numbers: Vec<i64> = streams.iter().map(|&stream| number(stream)).collect();
        let result = self.buffer.append(Steps {
            streams: &numbers,
            actions: &vec![action; streams.len()],
            rewards: &vec![reward; streams.len()],
            values: &vec![2.0 * reward; streams.len()],
            frames: &steps
                .iter()
                .flat_map(|step| step.4.clone())
                .collect::<Vec<_>>(),
            ..Steps::default()
        });
        assert_eq!(result.is_ok(), self.naive.append(&steps), "{result:?}");
    }

    pub(crate) fn finish(&mut self, stream: usize, outcome: Outcome) {
        let result = self.buffer.finish(number(stream), outcome);
        assert_eq!(result.ok(), self.naive.finish(stream, outcome));
    }

    fn abort(&mut self, stream: usize) {
        let result = self.buffer.abort(number(stream));
        assert_eq!(result.is_ok(), self.naive.abort(stream), "{result:?}");
    }

    fn call(&mut self, call: &Call) {
        match call {
            Call::Begin {
                stream,
                goal,
                interaction,
            } => self.begin(*stream, *goal, *interaction),
            Call::Append {
                streams,
                action,
                reward,
            } => self.append(streams, *action, *reward),
            Call::Finish { stream, outcome } => self.finish(*stream, *outcome),
            Call::Abort { stream } => self.abort(*stream),
        }
    }

    /// Everything that can be read is what the reference holds.
    fn check(&self) {
        assert_eq!(self.buffer.num_steps(), self.naive.steps());
        assert!(self.buffer.num_steps() <= self.buffer.config().capacity_steps);
        let ids: Vec<i64> = self.buffer.ids().collect();
        assert_eq!(ids, self.naive.ids());
        for (stream, episode) in self.naive.open.iter().enumerate() {
            let observed = self.buffer.observe(&[number(stream)]);
            let observed = observed.ok().map(|bytes| bytes.to_vec());
            let stack = self.naive.config.frame_stack;
            assert_eq!(
                observed,
                episode
                    .as_ref()
                    .map(|episode| episode.final_observation(stack))
            );
        }
        if ids.is_empty() {
            return;
        }
        let (observations, mut index) = self.naive.gather(&ids);
        let batch = self.buffer.gather(&ids).expect("stored ids");
        assert_eq!(batch.observations, observations);
        index.ends.clone_from(&batch.index.ends);
        assert_eq!(batch.index, index);
    }
}

pub(crate) fn number(stream: usize) -> i64 {
    i64::try_from(stream).expect("small")
}

proptest! {
    /// Stored bytes never change, no observation crosses an episode border or a reused slot,
    /// eviction takes the oldest finished episode first, and a refused call changes nothing.
    #[test]
    fn every_read_equals_the_reference_after_every_call(
        calls in calls(), frame_stack in 1..4_usize, spare in 0..9_usize
    ) {
        let mut pair = Pair::new(frame_stack, 12 + spare);
        for call in &calls {
            pair.call(call);
            pair.check();
        }
    }

    /// What a save writes is what was there when it began, however the buffer is used until it ends; and what is
    /// read meanwhile and afterwards is right.
    #[test]
    fn a_buffer_is_saved_as_it_was_when_the_save_began(
        before in calls(), meanwhile in calls(), after in calls()
    ) {
        let folder = scratch("meanwhile");
        let (path, whole) = (folder.join("buffer"), folder.join("whole"));
        let mut pair = Pair::new(2, 14);
        for call in &before {
            pair.call(call);
        }
        pair.buffer.save(&whole).expect("a writable folder");
        let rng = pair.buffer.rng_mut().clone();
        let saving = pair.buffer.begin_save(&rng).expect("few dimensions");
        for call in &meanwhile {
            pair.call(call);
            pair.check();
        }
        saving.write(&path, |read| read(&pair.buffer)).expect("a writable folder");
        pair.buffer.end_save();
        prop_assert_eq!(fs::read(&path).expect("a file"), fs::read(&whole).expect("a file"));
        for call in &after {
            pair.call(call);
            pair.check();
        }
        fs::remove_dir_all(folder).expect("our own folder");
    }

    /// An evicted id is an error of its own kind, never the bytes of a newer episode.
    #[test]
    fn evicted_episodes_are_never_read(calls in calls()) {
        let mut pair = Pair::new(2, 12);
        for call in &calls {
            pair.call(call);
            let stored = pair.naive.ids();
            for id in 0..pair.naive.next_id {
                let read = pair.buffer.gather(&[id]);
                let is_evicted = matches!(read, Err(Error::Evicted { .. }));
                prop_assert_eq!(is_evicted, !stored.contains(&id));
            }
            let future = pair.buffer.gather(&[pair.naive.next_id]);
            let is_unknown = matches!(future, Err(Error::UnknownEpisode { .. }));
            prop_assert!(is_unknown);
            if !stored.is_empty() {
                let drawn = pair.buffer.draw_ids(30).expect("episodes are stored");
                prop_assert!(drawn.iter().all(|id| stored.contains(id)));
            }
        }
    }

    /// The same seed and the same calls draw the same episodes.
    #[test]
    fn same_seed_same_batches(calls in calls()) {
        let (mut a, mut b) = (Pair::new(2, 30), Pair::new(2, 30));
        for call in &calls {
            a.call(call);
            b.call(call);
            if !a.buffer.is_empty() {
                prop_assert_eq!(a.buffer.sample(4, None).ok(), b.buffer.sample(4, None).ok());
            }
        }
    }
}

#[test]
fn gather_into_writes_the_beginning_of_a_larger_array() {
    let mut pair = Pair::new(2, 12);
    pair.begin(0, 1, 1);
    pair.append(&[0], 4, 0.5);
    pair.finish(0, Outcome::Success);
    let mut out = vec![99; 5 * 2 * FRAME_BYTES];
    let index = pair
        .buffer
        .gather_into(&[0], None, Layout::Packed, &mut out)
        .expect("a stored id");
    let batch = pair.buffer.gather(&[0]).expect("a stored id");
    assert_eq!(index.index, batch.index);
    let (written, rest) = out.split_at(batch.observations.len());
    assert_eq!(batch.observations, written);
    assert!(
        rest.iter().all(|&byte| byte == 99),
        "bytes after the batch were touched"
    );
}

#[test]
fn draws_reach_every_episode_about_equally_often() {
    let mut pair = Pair::new(2, 12);
    for _ in 0..4 {
        pair.begin(0, 1, 1);
        pair.append(&[0], 4, 0.5);
        pair.finish(0, Outcome::Failure);
    }
    let mut counts = [0_i32; 4];
    for id in pair.buffer.draw_ids(40_000).expect("episodes are stored") {
        counts[usize::try_from(id).expect("an id")] += 1;
    }
    // 10,000 expected each, standard deviation 87: six of them.
    assert!(
        counts.iter().all(|count| (count - 10_000).abs() < 520),
        "{counts:?}"
    );
}

#[test]
fn memory_grows_with_what_is_stored_and_is_used_again() {
    let mut pair = Pair::new(2, 12);
    assert_eq!(pair.buffer.allocated_bytes(), 0);
    for round in 0..200 {
        pair.begin(round % 3, 1, 1);
        for _ in 0..4 {
            pair.append(&[round % 3], 0, 0.0);
        }
        pair.finish(round % 3, Outcome::Timeout);
    }
    // 12 steps in 3 episodes are 15 frames; doubling leaves at most as much again.
    assert!(
        pair.buffer.allocated_bytes() <= 2 * 20 * FRAME_BYTES,
        "{}",
        pair.buffer.allocated_bytes()
    );
}
