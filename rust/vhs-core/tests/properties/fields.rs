//! Fields beside the frames, against a formula: what each holds follows from its number, its episode and its frame.

use std::fs;

use proptest::prelude::*;
use vhs_core::batch::Layout;
use vhs_core::config::{Backing, Field, Per, Stacking};
use vhs_core::episodes::{EpisodeBuffer, EpisodeConfig, Item, Opening, Steps};
use vhs_core::outcome::Outcome;
use vhs_core::windows::WindowShape;

use crate::support::scratch;

const LONGEST: usize = 5;

/// One of observations as they are, one that is stacked, one of steps, and a number alone.
fn fields() -> Vec<Field> {
    let field = |name: &str, shape: &[usize], item, per, is_stacked| Field {
        name: name.into(),
        shape: shape.into(),
        item,
        per,
        is_stacked,
    };
    vec![
        field("compass", &[2], Item::F32, Per::Observation, false),
        field("depth", &[2, 3], Item::U8, Per::Observation, true),
        field("logits", &[3], Item::I16, Per::Step, false),
        field("skill", &[], Item::I64, Per::Step, false),
    ]
}

/// What a field holds under frame `t` of an episode: bytes that no other place has.
fn bytes(number: usize, episode: usize, t: usize) -> Vec<u8> {
    let first = u64::try_from((number * 1000 + episode) * 100 + t).expect("small");
    let words = (first * 17..).flat_map(u64::to_le_bytes);
    words.take(fields()[number].bytes()).collect()
}

/// The row of observation `t`.
fn row(number: usize, episode: usize, t: usize, stack: usize, stacking: Stacking) -> Vec<u8> {
    if !fields()[number].is_stacked {
        return bytes(number, episode, t);
    }
    let frames: Vec<_> = (0..stack)
        .rev()
        .map(|back| bytes(number, episode, t.saturating_sub(back)))
        .collect();
    match stacking {
        Stacking::Frames => frames.concat(),
        // Pixels of three bytes.
        Stacking::Channels => (0..2)
            .flat_map(|p| {
                frames
                    .iter()
                    .flat_map(move |f| f[3 * p..3 * p + 3].to_vec())
            })
            .collect(),
    }
}

/// What `begin` (of frame 0) or `append` is handed.
fn given(episode: usize, t: usize) -> Vec<Vec<u8>> {
    let one = |(number, field): (usize, &Field)| match (field.per, t) {
        (Per::Step, 0) => Vec::new(),
        _ => bytes(number, episode, t),
    };
    fields().iter().enumerate().map(one).collect()
}

fn slices(owned: &[Vec<u8>]) -> Vec<&[u8]> {
    owned.iter().map(Vec::as_slice).collect()
}

fn step(buffer: &mut EpisodeBuffer, episode: usize, t: usize) {
    let fields = given(episode, t);
    let steps = Steps {
        streams: &[0],
        actions: &[0],
        rewards: &[0.0],
        values: &[0.0],
        frames: &[1],
        fields: &slices(&fields),
        ..Steps::default()
    };
    buffer.append(steps).expect("an open episode");
}

fn begin(buffer: &mut EpisodeBuffer, episode: usize) {
    let fields = given(episode, 0);
    let opening = Opening {
        frame: &[0],
        fields: &slices(&fields),
        ..Opening::default()
    };
    buffer.begin_with(0, opening).expect("an idle stream");
}

fn recorded(
    lengths: &[usize],
    stack: usize,
    stacking: Stacking,
    backing: Backing,
) -> EpisodeBuffer {
    let mut buffer = EpisodeBuffer::new(EpisodeConfig {
        frame_stack: stack,
        stacking,
        fields: fields(),
        max_episode_steps: LONGEST,
        capacity_steps: 12,
        backing,
        ..EpisodeConfig::default()
    })
    .expect("valid sizes");
    for (episode, &length) in lengths.iter().enumerate() {
        begin(&mut buffer, episode);
        (1..=length).for_each(|t| step(&mut buffer, episode, t));
        buffer.finish(0, Outcome::Failure).expect("an open episode");
    }
    buffer
}

fn index(number: i64) -> usize {
    usize::try_from(number).expect("an index")
}

/// Every sampler of a buffer gives what the formula says.
fn check(buffer: &mut EpisodeBuffer, lengths: &[usize]) {
    let (stack, stacking) = (buffer.config().frame_stack, buffer.config().stacking);
    let ids: Vec<i64> = buffer.ids().collect();
    let row = |number, episode, t| row(number, index(episode), t, stack, stacking);
    for layout in [Layout::Packed, Layout::Padded] {
        let batch = buffer.gather_as(&ids, layout).expect("stored");
        let longest = batch.index.longest;
        for (number, field) in fields().iter().enumerate() {
            let size = row(number, 0, 0).len();
            let mut expected = Vec::new();
            for &id in &ids {
                let length = lengths[index(id)];
                let rows = match field.per {
                    Per::Observation if layout == Layout::Packed => length + 1,
                    Per::Observation => longest + 1,
                    Per::Step => longest,
                };
                let first = usize::from(field.per == Per::Step);
                (first..=length).for_each(|t| expected.extend(row(number, id, t)));
                let padding = (rows + first).saturating_sub(length + 1) * size;
                expected.resize(expected.len() + padding, 0);
            }
            assert_eq!(batch.fields[number], expected, "{} {layout:?}", field.name);
        }
    }
    let batch = buffer.sample_transitions(20, None, None).expect("stored");
    for (number, field) in fields().iter().enumerate() {
        let places = || batch.index.goals.ids.iter().zip(&batch.index.goals.steps);
        let at = |beyond| -> Vec<u8> {
            let rows = places().map(|(&id, &step)| row(number, id, index(step) + beyond));
            rows.flatten().collect()
        };
        let (here, next) = match field.per {
            Per::Observation => (at(0), at(1)),
            Per::Step => (at(1), Vec::new()),
        };
        assert_eq!(batch.index.fields[number], here, "{}", field.name);
        assert_eq!(batch.index.next_fields[number], next, "{}", field.name);
    }
    let shape = WindowShape {
        length: 3,
        burn_in: 2,
        is_strict: false,
    };
    let batch = buffer
        .sample_windows(20, shape, None, None)
        .expect("stored");
    for (number, field) in fields().iter().enumerate() {
        let first = usize::from(field.per == Per::Step);
        let (size, mut expected) = (row(number, 0, 0).len(), Vec::new());
        for (place, &id) in batch.index.goals.ids.iter().enumerate() {
            let start = index(batch.index.goals.steps[place]);
            let end = start + index(batch.index.lengths[place]);
            (start + first..=end).for_each(|t| expected.extend(row(number, id, t)));
            expected.resize((place + 1) * (shape.steps() + 1 - first) * size, 0);
        }
        assert_eq!(batch.fields[number], expected, "{}", field.name);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_sampler_gives_every_field(
        lengths in prop::collection::vec(1..=LONGEST, 1..9), stack in 1..4_usize, channels in any::<bool>(),
    ) {
        let stacking = if channels { Stacking::Channels } else { Stacking::Frames };
        let folder = scratch("fields");
        let backing = Backing::Scratch(folder.join("frames"));
        let mut on_disk = recorded(&lengths, stack, stacking, backing);
        let mut buffer = recorded(&lengths, stack, stacking, Backing::Memory);
        buffer.save(&folder.join("saved")).expect("a writable folder");
        let mut loaded = EpisodeBuffer::load(&folder.join("saved"), Backing::Memory).expect("just saved");
        prop_assert_eq!(loaded.config(), buffer.config());
        // SAFETY: nobody edits the file of this test.
        let mut mapped = unsafe { EpisodeBuffer::map(&folder.join("saved")) }.expect("just saved");
        let mut packed = recorded(&lengths, stack, stacking, Backing::Packed);
        let mut unpacked = EpisodeBuffer::load(&folder.join("saved"), Backing::Packed).expect("just saved");
        for buffer in [&mut buffer, &mut loaded, &mut mapped, &mut on_disk, &mut packed, &mut unpacked] {
            check(buffer, &lengths);
            // It goes on: slots of evicted episodes are used again.
            let mut more = lengths.clone();
            for episode in lengths.len()..lengths.len() + 6 {
                begin(buffer, episode);
                (1..=2).for_each(|t| step(buffer, episode, t));
                let seen = buffer.observe_fields(&[0]).expect("an open episode");
                prop_assert_eq!(&seen[0], &bytes(0, episode, 2));
                prop_assert_eq!(&seen[1], &row(1, episode, 2, stack, stacking));
                prop_assert!(seen[2].is_empty() && seen[3].is_empty());
                buffer.finish(0, Outcome::Success).expect("two steps");
                more.push(2);
            }
            check(buffer, &more);
        }
        fs::remove_dir_all(folder).expect("our own folder");
    }
}

#[test]
fn fields_that_do_not_fit_are_refused_and_nothing_changes() {
    let mut buffer = recorded(&[2], 1, Stacking::Frames, Backing::Memory);
    begin(&mut buffer, 1);
    let fields = given(1, 1);
    let mut short = fields.clone();
    short[2].pop();
    for (fields, expected) in [
        (
            &fields[..3],
            "`fields`: expected bytes of 4 fields, got those of 3",
        ),
        (&short[..], "`fields`: expected 6 bytes of `logits`, got 5"),
    ] {
        let steps = Steps {
            streams: &[0],
            actions: &[0],
            rewards: &[0.0],
            values: &[0.0],
            frames: &[1],
            fields: &slices(fields),
            ..Steps::default()
        };
        let error = buffer.append(steps).expect_err("one that does not fit");
        assert_eq!(error.to_string(), expected);
    }
    assert_eq!(buffer.num_steps(), 2);
    step(&mut buffer, 1, 1);
    buffer.finish(0, Outcome::Failure).expect("one step");
    check(&mut buffer, &[2, 1]);
}

#[test]
fn a_wrong_schema_is_refused() {
    let [compass, ..] = &fields()[..] else {
        panic!("the first of four");
    };
    let named = |name: &str| Field {
        name: name.into(),
        ..compass.clone()
    };
    let empty = Field {
        shape: vec![2, 0],
        ..compass.clone()
    };
    let stacked = Field {
        per: Per::Step,
        is_stacked: true,
        ..compass.clone()
    };
    let huge = Field {
        shape: vec![1 << 62],
        ..compass.clone()
    };
    for (fields, expected) in [
        (
            vec![named("a"), named("a")],
            "each name once, got `a` twice",
        ),
        (vec![named("")], "expected a number in 1..=1024, got 0"),
        (vec![empty], "sizes of at least 1 for `compass`, got [2, 0]"),
        (vec![stacked], "no stack of what comes with steps"),
        (vec![huge], "a total of at most"),
    ] {
        let config = EpisodeConfig {
            fields,
            ..EpisodeConfig::default()
        };
        let error = EpisodeBuffer::new(config).expect_err("a wrong schema");
        assert!(error.to_string().contains(expected), "{error}");
    }
}
