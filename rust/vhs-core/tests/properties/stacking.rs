//! Frames stacked as channels, against an index for every byte of those stacked one after the other.

use proptest::prelude::*;
use vhs_core::config::Stacking;
use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, GoalKind, Item, Opening, Steps};
use vhs_core::goals::GoalStore;
use vhs_core::outcome::Outcome;
use vhs_core::reward::SparseReward;
use vhs_core::strategy::{self, HindsightRule, Share};
use vhs_core::windows::WindowShape;

/// Stack, pixels, channels of a pixel, and the type of a channel.
type Sizes = (usize, usize, usize, Item);

fn config((stack, pixels, channels, item): Sizes, stacking: Stacking) -> EpisodeConfig {
    EpisodeConfig {
        frame_shape: vec![pixels, channels],
        frame_item: item,
        frame_stack: stack,
        stacking,
        goal_kind: GoalKind::Observations,
        max_episode_steps: 5,
        capacity_steps: 40,
        ..EpisodeConfig::default()
    }
}

/// Observations `[n, stack, pixels, pixel]` as `[n, pixels, stack, pixel]`, byte by byte.
fn interleaved(bytes: &[u8], (stack, pixels, channels, item): Sizes) -> Vec<u8> {
    let pixel = channels * item.bytes();
    let mut out = vec![0; bytes.len()];
    for (place, &byte) in bytes.iter().enumerate() {
        let (rest, b) = (place / pixel, place % pixel);
        let (rest, p) = (rest / pixels, rest % pixels);
        let (n, s) = (rest / stack, rest % stack);
        out[((n * pixels + p) * stack + s) * pixel + b] = byte;
    }
    out
}

/// Three episodes, one of them still open; each is told what it sees after its second step.
fn recorded(sizes: Sizes, stacking: Stacking, seed: u8) -> EpisodeBuffer {
    let config = config(sizes, stacking);
    let bytes = config.frame_bytes();
    let mut buffer = EpisodeBuffer::new(config).expect("valid sizes");
    let frame = |t: usize| -> Vec<u8> {
        let bytes = (t * bytes..(t + 1) * bytes).map(|place| place.to_le_bytes()[0]);
        bytes.map(|byte| byte.wrapping_mul(31) ^ seed).collect()
    };
    let stack = sizes.0;
    for first in [0, 10, 20] {
        let told: Vec<u8> = (0..stack)
            .flat_map(|i| frame(first + (3 + i).saturating_sub(stack)))
            .collect();
        let told = match stacking {
            Stacking::Frames => told,
            Stacking::Channels => interleaved(&told, sizes),
        };
        let opening = Opening {
            frame: &frame(first),
            desired: &told,
            ..Opening::default()
        };
        buffer.begin_with(0, opening).expect("an idle stream");
        for t in 1..=4 {
            let steps = Steps {
                streams: &[0],
                actions: &[0],
                rewards: &[-1.0],
                values: &[0.0],
                frames: &frame(first + t),
                ..Steps::default()
            };
            buffer.append(steps).expect("an open episode");
        }
        if first < 20 {
            buffer.finish(0, Outcome::Success).expect("four steps");
        }
    }
    buffer
}

fn sizes() -> impl Strategy<Value = Sizes> {
    let item = prop::sample::select(vec![Item::U8, Item::F32]);
    (1..4_usize, 1..30_usize, 1..6_usize, item)
}

proptest! {
    #[test]
    fn whatever_leaves_a_buffer_is_the_same_but_for_the_order_of_its_bytes(
        sizes in sizes(), seed in any::<u8>(),
    ) {
        let mut frames = recorded(sizes, Stacking::Frames, seed);
        let mut channels = recorded(sizes, Stacking::Channels, seed);
        let same = |frames: &[u8], channels: &[u8]| interleaved(frames, sizes) == channels;
        let seen = (frames.observe(&[0]).expect("open"), channels.observe(&[0]).expect("open"));
        prop_assert!(same(&seen.0, &seen.1));
        let one = frames.gather(&[0, 1]).expect("stored");
        let two = channels.gather(&[0, 1]).expect("stored");
        prop_assert!(same(&one.observations, &two.observations));
        prop_assert!(same(&one.desired_goals, &two.desired_goals));
        prop_assert_eq!(one.index, two.index);

        let rule = HindsightRule::new(strategy::Strategy::Random, Share::Ratio(1)).expect("a ratio");
        let reward = SparseReward::default();
        let one = frames.sample_transitions(20, Some(&rule), Some(&reward)).expect("stored");
        let two = channels.sample_transitions(20, Some(&rule), Some(&reward)).expect("stored");
        prop_assert!(same(&one.observations, &two.observations));
        prop_assert!(same(&one.next_observations, &two.next_observations));
        prop_assert!(same(&one.goals, &two.goals));
        prop_assert_eq!(one.index, two.index);

        let shape = WindowShape { length: 3, burn_in: 1, is_strict: false };
        let one = frames.sample_windows(9, shape, Some(&rule), Some(&reward)).expect("stored");
        let two = channels.sample_windows(9, shape, Some(&rule), Some(&reward)).expect("stored");
        prop_assert!(same(&one.observations, &two.observations));
        prop_assert!(same(&one.goals, &two.goals));
        prop_assert_eq!(one.index, two.index);
    }

    #[test]
    fn a_store_of_stacks_becomes_one_of_pictures(
        stack in 1..4_usize, colours in 1..5_usize, width in 1..20_usize, seed in any::<u8>(),
    ) {
        let sizes = (stack, 2 * width, colours, Item::U8);
        let shape = [stack, 2, width, colours];
        let bytes: usize = shape.iter().product();
        let mut store = GoalStore::new(2, &shape, 3, 5).expect("valid sizes");
        for number in 0..5_usize {
            let image: Vec<u8> = (0..bytes)
                .map(|place| (number * bytes + place).to_le_bytes()[0] ^ seed)
                .collect();
            store.push(&image, i64::from(number % 3 == 0)).expect("a valid image");
        }
        let folder = crate::support::scratch("pictures");
        store.save(&folder.join("store")).expect("a writable folder");
        let mut again = GoalStore::load(&folder.join("store")).expect("what was saved");
        let ahead = store.sample_class(1, 9).expect("stored");
        again = again.into_channels().expect("room for an image");
        prop_assert_eq!(again.shape(), &[2, width, stack * colours][..]);
        prop_assert_eq!(interleaved(&ahead, sizes), again.sample_class(1, 9).expect("stored").to_vec());
        std::fs::remove_dir_all(folder).expect("our own folder");
    }
}

#[test]
fn the_newest_frame_comes_last_of_each_pixel() {
    let sizes = (2, 3, 1, Item::U8);
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        goal_kind: GoalKind::Labels,
        ..config(sizes, Stacking::Channels)
    })
    .expect("valid sizes");
    buffer.begin(0, &[1, 2, 3], 0, 0).expect("an idle stream");
    let steps = Steps {
        streams: &[0],
        actions: &[0],
        rewards: &[0.0],
        values: &[0.0],
        frames: &[7, 8, 9],
        ..Steps::default()
    };
    buffer.append(steps).expect("an open episode");
    assert_eq!(buffer.observe(&[0]).expect("open")[..], [1, 7, 2, 8, 3, 9]);
    assert_eq!(buffer.observation_shape(), [3, 2]);
}
