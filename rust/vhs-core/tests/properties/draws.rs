//! The numbers behind sampling are part of the output: those of Python, and those of every version.

use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
use vhs_core::outcome::Outcome;
use vhs_core::relabel::Rule;
use vhs_core::strategy::{HindsightRule, Share, Strategy};
use vhs_core::windows::WindowShape;

/// Six failures of 1, 2, 3, 4, 1 and 2 steps: as in `tests/core/test_draws.py`.
fn filled() -> EpisodeBuffer {
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        max_episode_steps: 5,
        capacity_steps: 50,
        seed: 7,
        ..EpisodeConfig::default()
    })
    .expect("valid sizes");
    for number in 0..6 {
        buffer.begin(0, &[0], 0, 0).expect("an idle stream");
        for _ in 0..=number % 4 {
            let (streams, actions, rewards, values) = (&[0], &[0], &[0.0], &[0.0]);
            let steps = Steps {
                streams,
                actions,
                rewards,
                values,
                frames: &[0],
                ..Steps::default()
            };
            buffer.append(steps).expect("an open episode");
        }
        buffer.finish(0, Outcome::Failure).expect("some steps");
    }
    buffer
}

#[test]
fn the_same_seed_draws_the_same_as_from_python() {
    let mut buffer = filled();
    let rule = HindsightRule::new(Strategy::Future, Share::Probability(0.5)).expect("valid");
    let batch = buffer.sample_transitions(8, Some(&rule), None);
    let goals = batch.expect("episodes are stored").index.goals;
    assert_eq!(goals.ids, [5, 3, 3, 0, 1, 4, 3, 0]);
    assert_eq!(goals.steps, [0, 2, 3, 0, 0, 0, 1, 0]);
    assert_eq!(goals.goal_steps, [-1, -1, 4, 1, -1, -1, 3, -1]);

    let rule = Rule::new([Outcome::Failure].into_iter().collect(), 0.5).expect("valid");
    let (batch, hindsight) = buffer.sample(6, Some(&rule)).expect("episodes are stored");
    assert_eq!(batch.index.ids, [2, 4, 5, 2, 1, 2]);
    let selected = hindsight.expect("a rule was given").selected;
    assert_eq!(selected, [true, false, false, false, true, true]);

    let rule = HindsightRule::new(Strategy::Random, Share::Ratio(1)).expect("valid");
    let shape = WindowShape {
        length: 2,
        burn_in: 1,
        is_strict: false,
    };
    let batch = buffer.sample_windows(4, shape, Some(&rule), None);
    let goals = batch.expect("episodes are stored").index.goals;
    assert_eq!(goals.ids, [4, 4, 3, 4]);
    assert_eq!(goals.steps, [0, 0, 0, 0]);
    assert_eq!(goals.goal_ids, [4, 2, 3, 3]);
    assert_eq!(goals.goal_steps, [-1, 3, -1, 3]);
    let state = [
        14_083_743_595_286_522_908,
        9_232_919_180_395_065_440,
        14_602_620_075_285_058_684,
        17_561_433_964_684_381_176,
    ];
    assert_eq!(buffer.rng_mut().state(), state);
}

#[test]
fn a_refused_call_gives_its_number_back() {
    let mut buffer = filled();
    let state = buffer.rng_mut().state();
    assert!(buffer.sample_transitions(0, None, None).is_err());
    assert!(buffer.draw_ids(0).is_err());
    assert_eq!(buffer.rng_mut().state(), state);
}
