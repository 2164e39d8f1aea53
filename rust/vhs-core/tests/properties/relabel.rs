//! The hindsight rule on batches of real buffers.

use proptest::prelude::*;
use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Steps};
use vhs_core::outcome::{Outcome, OutcomeSet};
use vhs_core::relabel::{EpisodeEnd, Rule};
use vhs_core::rng::Rng;

use crate::episodes::Pair;

fn failures() -> OutcomeSet {
    [Outcome::Failure].into_iter().collect()
}

proptest! {
    /// A relabelled goal is the final observation of the same episode, its interaction that of the
    /// last action; the others keep what they were told. Buffers wrap and evict on the way.
    #[test]
    fn goals_are_the_final_observation_of_the_same_episode(
        episodes in prop::collection::vec((0..3_usize, 1..5_usize, 0..6_i64, 0..3_usize, 0..3_i64), 1..30),
        probability in 0.0..=1.0_f64,
        on in prop::collection::vec(0..3_usize, 0..3),
        seed: u64,
    ) {
        let mut pair = Pair::new(2, 14);
        for &(stream, length, last_action, outcome, interaction) in &episodes {
            pair.begin(stream, 0, interaction);
            (1..length).for_each(|_| pair.append(&[stream], 0, 0.0));
            pair.append(&[stream], last_action, -1.0);
            pair.finish(stream, Outcome::ALL[outcome]);
        }
        let on: OutcomeSet = on.into_iter().map(|outcome| Outcome::ALL[outcome]).collect();
        let ids = pair.naive.ids();
        let batch = pair.buffer.gather(&ids).expect("stored ids");
        let rule = Rule::new(on, probability).expect("a probability");
        let hindsight = rule.relabel(&batch.index.ends, &mut Rng::new(seed));
        for (place, &id) in ids.iter().enumerate() {
            let episode = pair.naive.episode(id);
            let row = usize::try_from(hindsight.goal_rows[place]).expect("a row");
            prop_assert_eq!(&batch.observations[12 * row..12 * (row + 1)], episode.final_observation(2));
            let last = episode.actions[episode.actions.len() - 1];
            let selected = hindsight.selected[place];
            prop_assert!(!selected || on.contains(episode.outcome));
            let did_one = selected && last >= 3;
            let expected = if did_one { last - 3 } else { episode.interaction };
            prop_assert_eq!(hindsight.interactions[place], expected);
        }
    }

    /// With probability 1 exactly the eligible episodes are relabelled, with 0 none.
    #[test]
    fn the_extremes_are_exact(outcomes in prop::collection::vec(0..3_usize, 1..50), seed: u64) {
        let ends = ends(&outcomes);
        let always = Rule::new(failures(), 1.0).expect("a probability");
        let never = Rule::new(failures(), 0.0).expect("a probability");
        let expected: Vec<bool> = outcomes.iter().map(|&outcome| outcome == 1).collect();
        prop_assert_eq!(always.relabel(&ends, &mut Rng::new(seed)).selected, expected);
        prop_assert!(!never.relabel(&ends, &mut Rng::new(seed)).selected.contains(&true));
    }

    /// What happens to one episode does not depend on how the others ended.
    #[test]
    fn an_episodes_fate_depends_on_its_place_alone(
        outcomes in prop::collection::vec(0..3_usize, 2..20), seed: u64
    ) {
        let rule = Rule::new(failures(), 0.5).expect("a probability");
        let all_failed = rule.relabel(&ends(&vec![1; outcomes.len()]), &mut Rng::new(seed));
        let mixed = rule.relabel(&ends(&outcomes), &mut Rng::new(seed));
        for (place, &outcome) in outcomes.iter().enumerate() {
            prop_assert_eq!(mixed.selected[place], outcome == 1 && all_failed.selected[place]);
        }
    }
}

fn ends(outcomes: &[usize]) -> Vec<EpisodeEnd> {
    let end = |&outcome| EpisodeEnd {
        outcome: Outcome::ALL[outcome],
        interaction: 0,
        done: None,
        final_row: 0,
        steps: 1,
    };
    outcomes.iter().map(end).collect()
}

#[test]
fn the_measured_rate_is_the_probability() {
    const DRAWS: u32 = 100_000;
    let ends = ends(&vec![1; DRAWS as usize]);
    for (seed, probability) in [(0, 0.05), (1, 0.4), (2, 0.5), (3, 0.8), (4, 0.99)] {
        let rule = Rule::new(failures(), probability).expect("a probability");
        let selected = rule.relabel(&ends, &mut Rng::new(seed)).selected;
        let count: u32 = selected.iter().map(|&selected| u32::from(selected)).sum();
        // Five standard deviations of a binomial: chance alone fails this once in 1.7 million
        // seeds.
        let bound = 5.0 * (f64::from(DRAWS) * probability * (1.0 - probability)).sqrt();
        let expected = f64::from(DRAWS) * probability;
        assert!(
            (f64::from(count) - expected).abs() < bound,
            "{count} of {DRAWS} at {probability}"
        );
    }
}

#[test]
fn sampling_with_a_rule_relabels_the_sampled_episodes() {
    let mut pair = Pair::new(2, 12);
    for (outcome, action) in [(Outcome::Failure, 5), (Outcome::Timeout, 4)] {
        pair.begin(0, 1, 0);
        pair.append(&[0], action, 0.0);
        pair.finish(0, outcome);
    }
    let rule = Rule::new(failures(), 1.0).expect("a probability");
    let (batch, hindsight) = pair
        .buffer
        .sample(50, Some(&rule))
        .expect("episodes are stored");
    let hindsight = hindsight.expect("a rule was given");
    for (place, &id) in batch.index.ids.iter().enumerate() {
        assert_eq!(hindsight.selected[place], id == 0);
        assert_eq!(hindsight.interactions[place], if id == 0 { 2 } else { 0 });
    }
}

fn two_moves_and_two_interactions(interactions: &[(i64, i64)]) -> EpisodeConfig {
    EpisodeConfig {
        max_episode_steps: 1,
        capacity_steps: 2,
        num_actions: Some(4),
        num_interactions: 2,
        interactions: interactions.iter().copied().collect(),
        ..EpisodeConfig::default()
    }
}

#[test]
fn interactions_are_those_that_the_configuration_names() {
    let config = two_moves_and_two_interactions(&[(2, 0), (3, 1)]);
    let mut buffer = EpisodeBuffer::new(config).expect("a valid configuration");
    for action in [2, 3] {
        buffer.begin(0, &[0], 0, 0).expect("an idle stream");
        let steps = Steps {
            streams: &[0],
            actions: &[action],
            rewards: &[0.0],
            values: &[0.0],
            frames: &[0],
            ..Steps::default()
        };
        buffer.append(steps).expect("an open episode");
        buffer.finish(0, Outcome::Failure).expect("a step");
    }
    let batch = buffer.gather(&[0, 1]).expect("stored ids");
    let rule = Rule::new(failures(), 1.0).expect("a probability");
    let hindsight = rule.relabel(&batch.index.ends, &mut Rng::new(0));
    assert_eq!(hindsight.interactions, [0, 1]);
}

#[test]
fn several_interactions_that_no_action_does_are_refused() {
    for wrong in [&[][..], &[(4, 0)], &[(3, 2)], &[(3, -1)], &[(-1, 0)]] {
        let error = EpisodeBuffer::new(two_moves_and_two_interactions(wrong)).expect_err("a guess");
        let message = error.to_string();
        assert!(message.starts_with("`interactions`: expected"), "{message}");
    }
}
