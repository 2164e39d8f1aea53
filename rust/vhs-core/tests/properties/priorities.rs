//! Prioritised draws and sums of several steps, against lists and loops.

use std::collections::BTreeMap;
use std::fs;

use proptest::prelude::*;
use vhs_core::config::Backing;
use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
use vhs_core::error::Error;
use vhs_core::outcome::Outcome;
use vhs_core::reward::SparseReward;
use vhs_core::rng::Rng;
use vhs_core::strategy::{self, HindsightRule, Share};
use vhs_core::transitions::{TransitionBatch, TransitionDraw};

use crate::support::{FrameSource, scratch};

const LONGEST: usize = 6;

/// A buffer, and beside each stored step its priority.
struct Pair {
    buffer: EpisodeBuffer,
    priorities: BTreeMap<(i64, i64), f32>,
    largest: f32,
    frames: FrameSource,
    lengths: Vec<usize>,
}

fn number(index: usize) -> i64 {
    index.try_into().expect("small")
}

impl Pair {
    fn new(exponent: Option<f64>, capacity_steps: usize) -> Self {
        let buffer = EpisodeBuffer::new(EpisodeConfig {
            frame_shape: vec![6],
            max_episode_steps: LONGEST,
            capacity_steps,
            priority_exponent: exponent,
            ..EpisodeConfig::default()
        });
        Self {
            buffer: buffer.expect("valid sizes"),
            priorities: BTreeMap::new(),
            largest: 1.0,
            frames: FrameSource::default(),
            lengths: Vec::new(),
        }
    }

    fn record(&mut self, length: usize, terminated: bool) {
        let first = self.frames.next();
        self.buffer.begin(0, &first, 0, 0).expect("an idle stream");
        for step in 0..length {
            let steps = Steps {
                streams: &[0],
                actions: &[0],
                rewards: &[reward(self.lengths.len(), step)],
                values: &[0.0],
                frames: &self.frames.next(),
                ..Steps::default()
            };
            self.buffer.append(steps).expect("an open episode");
        }
        let id = self.buffer.finish_with(0, Outcome::Failure, terminated);
        let id = id.expect("an open episode");
        self.lengths.push(length);
        for step in 0..length {
            self.priorities.insert((id, number(step)), self.largest);
        }
        let stored: Vec<i64> = self.buffer.ids().collect();
        self.priorities.retain(|(id, _), _| stored.contains(id));
    }

    fn update(&mut self, updates: &[(prop::sample::Index, f32)]) {
        let places: Vec<_> = self.priorities.keys().copied().collect();
        let chosen: Vec<_> = updates
            .iter()
            .map(|(index, _)| *index.get(&places))
            .collect();
        let (ids, steps): (Vec<i64>, Vec<i64>) = chosen.iter().copied().unzip();
        let priorities: Vec<f32> = updates.iter().map(|&(_, priority)| priority).collect();
        let result = self.buffer.update_priorities(&ids, &steps, &priorities);
        result.expect("stored steps");
        for (place, priority) in chosen.into_iter().zip(priorities) {
            self.priorities.insert(place, priority);
            self.largest = self.largest.max(priority);
        }
    }
}

fn reward(episode: usize, step: usize) -> f32 {
    let all = u8::try_from((episode * 7 + step * 3) % 50).expect("small");
    f32::from(all) / 8.0 - 2.0
}

fn prioritised(n: usize) -> TransitionDraw<'static> {
    TransitionDraw {
        n,
        beta: Some(1.0),
        ..TransitionDraw::default()
    }
}

fn places(batch: &TransitionBatch) -> Vec<(i64, i64)> {
    let goals = &batch.index.goals;
    let ids = goals.ids.iter().copied();
    ids.zip(goals.steps.iter().copied()).collect()
}

#[derive(Clone, Debug)]
enum Call {
    Record(usize),
    Update(Vec<(prop::sample::Index, f32)>),
}

fn calls() -> impl Strategy<Value = Vec<Call>> {
    let update = prop::collection::vec((any::<prop::sample::Index>(), 0.001..50.0_f32), 1..6);
    prop::collection::vec(
        prop_oneof![2 => (1..=LONGEST).prop_map(Call::Record), 1 => update.prop_map(Call::Update)],
        1..40,
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With an exponent of 1 and a beta of 1, a weight times its priority is the same in every row.
    #[test]
    fn draws_follow_the_priorities_of_the_steps_that_are_stored(
        calls in calls(), capacity in LONGEST..40_usize, exponent in prop::sample::select(vec![0.0, 0.5, 1.0]),
    ) {
        let mut pair = Pair::new(Some(exponent), capacity);
        pair.record(1, true);
        for call in calls {
            match call {
                Call::Record(length) => pair.record(length, true),
                Call::Update(updates) => pair.update(&updates),
            }
            let batch = pair.buffer.sample_transitions_with(&prioritised(30), &mut Rng::new(1));
            let batch = batch.expect("a step");
            let odds = |place| f64::from(pair.priorities[&place]).powf(exponent);
            let least = places(&batch).into_iter().map(odds).fold(f64::INFINITY, f64::min);
            for (place, &weight) in places(&batch).into_iter().zip(&batch.index.weights) {
                prop_assert!((f64::from(weight) * odds(place) / least - 1.0).abs() < 1e-6);
            }
        }
        // One step has all the odds: it is the one that is drawn, before a save and after.
        let last = *pair.priorities.keys().next_back().expect("a step");
        let folder = scratch("priorities");
        pair.buffer.update_priorities(&[last.0], &[last.1], &[1e30]).expect("stored");
        pair.buffer.save(&folder.join("saved")).expect("a writable folder");
        let mut loaded = EpisodeBuffer::load(&folder.join("saved"), Backing::Memory).expect("just saved");
        for buffer in [&mut pair.buffer, &mut loaded] {
            if exponent > 0.0 {
                let batch = buffer.sample_transitions_with(&prioritised(50), &mut Rng::new(3));
                prop_assert_eq!(places(&batch.expect("a step")), vec![last; 50]);
            }
            // A new step is as likely as that one.
            buffer.begin(0, &[0; 6], 0, 0).expect("an idle stream");
            let steps = Steps {
                streams: &[0], actions: &[0], rewards: &[0.0], values: &[0.0], frames: &[1; 6], ..Steps::default()
            };
            buffer.append(steps).expect("an open episode");
            buffer.finish(0, Outcome::Success).expect("one step");
        }
        let draw = |buffer: &EpisodeBuffer| {
            buffer.sample_transitions_with(&prioritised(50), &mut Rng::new(3)).expect("a step")
        };
        prop_assert_eq!(draw(&loaded), draw(&pair.buffer));
        fs::remove_dir_all(folder).expect("our own folder");
    }

    #[test]
    fn sums_of_steps_end_where_the_episode_or_the_task_does(
        lengths in prop::collection::vec((1..=LONGEST, any::<bool>()), 1..9), n_step in 1..8_usize,
        gamma in 0.0..=1.0_f64, terminates in any::<bool>(), beta in prop::option::of(0.0..=1.0_f64),
    ) {
        let mut pair = Pair::new(Some(0.7), 30);
        for &(length, terminated) in &lengths {
            pair.record(length, terminated);
        }
        let rule = HindsightRule::new(strategy::Strategy::Future, Share::Ratio(1)).expect("a ratio");
        let sparse = SparseReward { terminates, ..SparseReward::default() };
        let draw = TransitionDraw {
            n: 40, rule: Some(&rule), reward: Some(&sparse), n_step, gamma: Some(gamma), beta,
        };
        let batch = pair.buffer.sample_transitions_with(&draw, &mut Rng::new(5)).expect("steps");
        let index = &batch.index;
        for (row, (id, t)) in places(&batch).into_iter().enumerate() {
            let episode = usize::try_from(id).expect("an id");
            let (length, ended) = lengths[episode];
            let t = usize::try_from(t).expect("a step");
            let (mut sum, mut discount, mut steps) = (0.0, 1.0, 0);
            let (mut terminated, mut truncated) = (false, false);
            while steps < n_step && !terminated && !truncated {
                let step = t + steps;
                let is_last = step + 1 == length;
                let reached = index.goals.goal_steps[row] == number(step + 1);
                let one = match (index.goals.relabelled[row], reached) {
                    (false, _) => reward(episode, step),
                    (true, true) => 0.0,
                    (true, false) => -1.0,
                };
                terminated = if index.goals.relabelled[row] { reached && terminates } else { is_last && ended };
                truncated = is_last && !terminated;
                sum += discount * f64::from(one);
                discount *= gamma;
                steps += 1;
            }
            prop_assert!((f64::from(index.rewards[row]) - sum).abs() < 1e-5);
            prop_assert!((f64::from(index.discounts[row]) - discount).abs() < 1e-6);
            prop_assert_eq!(index.lengths[row], number(steps));
            prop_assert_eq!((index.terminated[row], index.truncated[row]), (terminated, truncated));
            // The observation after the last of them; frames say which they are.
            let whole = pair.buffer.gather(&[id]).expect("stored");
            prop_assert_eq!(&batch.next_observations[row * 6..][..6], &whole.observations[(t + steps) * 6..][..6]);
            prop_assert_eq!(&batch.observations[row * 6..][..6], &whole.observations[t * 6..][..6]);
        }
    }
}

#[test]
fn draws_are_in_proportion() {
    let mut pair = Pair::new(Some(0.5), 10);
    pair.record(3, true);
    let updated = pair
        .buffer
        .update_priorities(&[0, 0, 0], &[0, 1, 2], &[1.0, 16.0, 0.25]);
    updated.expect("stored steps");
    let draw = TransitionDraw {
        beta: Some(0.5),
        ..prioritised(11_000)
    };
    let batch = pair.buffer.sample_transitions_with(&draw, &mut Rng::new(0));
    let batch = batch.expect("steps");
    // Odds 1, 4 and 1/2 of 5.5.
    for (step, expected) in [(0, 2000.0), (1, 8000.0), (2, 1000.0_f64)] {
        let found = places(&batch)
            .iter()
            .filter(|place| place.1 == step)
            .count();
        let found = f64::from(u32::try_from(found).expect("small"));
        assert!(
            (found - expected).abs() < 6.0 * expected.sqrt(),
            "{step}: {found}"
        );
    }
    let weight = |step| {
        let row = places(&batch).iter().position(|place| place.1 == step);
        batch.index.weights[row.expect("a drawn step")]
    };
    assert!((weight(0) - 0.5_f32.sqrt()).abs() < 1e-6);
    assert!((weight(1) - 0.125_f32.sqrt()).abs() < 1e-6);
    assert!((weight(2) - 1.0).abs() < 1e-6);
}

#[test]
fn priorities_that_are_none_are_refused_and_nothing_changes() {
    let mut pair = Pair::new(Some(1.0), 12);
    for _ in 0..4 {
        pair.record(4, true);
    }
    let draw =
        |buffer: &EpisodeBuffer| buffer.sample_transitions_with(&prioritised(99), &mut Rng::new(0));
    let before = draw(&pair.buffer).expect("steps");
    let (first, two) = (&[1_i64, 1][..], &[0_i64, 1][..]);
    for (ids, steps, priorities, expected) in [
        (
            first,
            two,
            &[1.0, 0.0][..],
            "numbers above 0 (errors may be 0: add a small number), got 0 at index 1",
        ),
        (first, two, &[-1.0, 1.0], "got -1 at index 0"),
        (
            first,
            two,
            &[9.0, f32::NAN],
            "expected a finite number, got NaN at index 1",
        ),
        (
            first,
            two,
            &[9.0],
            "`priorities`: expected shape [2], got [1]",
        ),
        (
            first,
            &two[..1],
            &[9.0, 9.0],
            "`steps`: expected shape [2], got [1]",
        ),
        (
            first,
            &[0, 4],
            &[9.0, 9.0],
            "`steps`: expected a number in 0..4, got 4 at index 1",
        ),
        (
            &[1, 4],
            two,
            &[9.0, 9.0],
            "episode 4: expected an id below 4",
        ),
    ] {
        let refused = pair.buffer.update_priorities(ids, steps, priorities);
        let error = refused.expect_err("what is no priority");
        assert!(error.to_string().contains(expected), "{error}");
    }
    assert_eq!(draw(&pair.buffer).expect("steps"), before);
    // Of an evicted episode, with one that is not.
    pair.buffer
        .update_priorities(&[0, 3], &[0, 0], &[9.0, 1e9])
        .expect("one of them is stored");
    let after = draw(&pair.buffer).expect("steps");
    assert_eq!(places(&after), vec![(3, 0); 99]);
}

#[test]
fn what_needs_priorities_says_so() {
    let mut pair = Pair::new(None, 12);
    pair.record(2, true);
    let told = "`priority_exponent`: expected a number when the buffer is made";
    let draw = prioritised(1);
    let error = pair.buffer.sample_transitions_with(&draw, &mut Rng::new(0));
    assert!(error.expect_err("no priorities").to_string().contains(told));
    let error = pair.buffer.update_priorities(&[0], &[0], &[1.0]);
    assert!(error.expect_err("no priorities").to_string().contains(told));
    for (draw, expected) in [
        (
            TransitionDraw {
                n_step: 0,
                ..TransitionDraw::default()
            },
            "`n_step`",
        ),
        (
            TransitionDraw {
                gamma: Some(f64::NAN),
                ..TransitionDraw::default()
            },
            "`gamma`",
        ),
        (
            TransitionDraw {
                beta: Some(2.0),
                ..TransitionDraw::default()
            },
            "`beta`",
        ),
    ] {
        let error = pair.buffer.sample_transitions_with(&draw, &mut Rng::new(0));
        let error = error.expect_err("out of range");
        assert!(matches!(error, Error::Argument { .. }) && error.to_string().contains(expected));
    }
    let wrong = EpisodeConfig {
        priority_exponent: Some(-0.1),
        ..EpisodeConfig::default()
    };
    let error = EpisodeBuffer::new(wrong).expect_err("a negative exponent");
    assert!(
        error
            .to_string()
            .contains("`priority_exponent`: expected a number in 0..=1, got -0.1")
    );
}
