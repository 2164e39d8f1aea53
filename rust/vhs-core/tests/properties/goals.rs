//! The goal store against plain lists.

use std::collections::BTreeMap;

use proptest::prelude::*;
use vhs_core::goals::{Balance, GoalStore};
use vhs_core::outcome::Outcome;

use crate::episodes::Pair;
use crate::support::FrameSource;
use crate::support::naive::Goals;

const CLASSES: usize = 4;

fn filled(pushes: &[usize], capacity: usize, seed: u64) -> (GoalStore, Goals) {
    let mut store = GoalStore::new(CLASSES, &[6], capacity, seed).expect("valid sizes");
    let (mut naive, mut frames) = (Goals::new(CLASSES, capacity), FrameSource::default());
    for &class in pushes {
        let image = frames.next();
        store
            .push(&image, class.try_into().expect("small"))
            .expect("a valid image");
        naive.push(image, class);
    }
    (store, naive)
}

/// All images of a class that so many draws find that a stored one missing has probability below
/// 1e-20.
fn contents(store: &mut GoalStore, class: usize, count: usize) -> Vec<Vec<u8>> {
    let label = class.try_into().expect("small");
    let images = store
        .sample_class(label, 60 * count)
        .expect("a class with images");
    let mut images: Vec<Vec<u8>> = images.chunks(6).map(<[u8]>::to_vec).collect();
    images.sort();
    images.dedup();
    images
}

proptest! {
    /// After any pushes a class holds exactly its newest images, byte for byte, up to its capacity.
    #[test]
    fn a_class_holds_its_newest_images(
        pushes in prop::collection::vec(0..CLASSES, 1..60), capacity in 1..9_usize
    ) {
        let (mut store, naive) = filled(&pushes, capacity, 5);
        let counts: Vec<usize> = store.counts().collect();
        for (class, images) in naive.classes.iter().enumerate() {
            prop_assert_eq!(counts[class], images.len());
            if !images.is_empty() {
                let mut expected = images.clone();
                expected.sort();
                prop_assert_eq!(contents(&mut store, class, images.len()), expected);
            }
        }
    }

    /// A balanced batch has n images, each of the class its label says, and class counts that
    /// differ by at most one.
    #[test]
    fn balanced_batches_are_as_equal_as_can_be(
        pushes in prop::collection::vec(0..CLASSES, 1..30), n in 1..40_usize, seed: u64
    ) {
        let (mut store, naive) = filled(&pushes, 8, seed);
        let (images, labels) = store.sample(n, Balance::Classes).expect("images are stored");
        prop_assert_eq!((images.len(), labels.len()), (6 * n, n));
        let mut drawn = BTreeMap::new();
        for (image, &label) in images.chunks(6).zip(&labels) {
            let class = usize::try_from(label).expect("a label");
            prop_assert!(naive.classes[class].contains(&image.to_vec()));
            *drawn.entry(class).or_insert(0_usize) += 1;
        }
        let filled = naive.classes.iter().filter(|images| !images.is_empty()).count();
        for class in (0..CLASSES).filter(|&class| !naive.classes[class].is_empty()) {
            let count = drawn.get(&class).copied().unwrap_or(0);
            prop_assert!(count == n / filled || count == n / filled + 1, "{:?}", drawn);
        }
    }

    /// The same seed and pushes give the same batches, into new memory or the caller's.
    #[test]
    fn same_seed_same_batches(pushes in prop::collection::vec(0..CLASSES, 1..30), seed: u64, n in 1..20_usize) {
        let (mut a, _) = filled(&pushes, 8, seed);
        let (mut b, _) = filled(&pushes, 8, seed);
        for balance in [Balance::Classes, Balance::Images] {
            let (images, labels) = a.sample(n, balance).expect("images are stored");
            let mut out = vec![0; 6 * n];
            prop_assert_eq!(b.sample_into(n, balance, &mut out).expect("images are stored"), labels);
            prop_assert_eq!(images, out);
        }
    }

    /// `collect` stores the final observation of successes under the instructed goal, and nothing
    /// else.
    #[test]
    fn labels_of_wrongly_reached_objects_never_enter(
        episodes in prop::collection::vec((0..CLASSES, 1..5_usize, 0..3_usize), 1..12)
    ) {
        let (mut pair, mut naive) = (Pair::new(2, 60), Goals::new(CLASSES, 50));
        for &(goal, length, outcome) in &episodes {
            pair.begin(0, goal.try_into().expect("small"), 0);
            (0..length).for_each(|_| pair.append(&[0], 5, 0.0));
            pair.finish(0, Outcome::ALL[outcome]);
        }
        for episode in pair.naive.finished.iter().filter(|e| e.outcome == Outcome::Success) {
            naive.push(episode.final_observation(2), episode.goal.try_into().expect("a goal"));
        }
        let mut store = GoalStore::new(CLASSES, &[2, 3, 2], 50, 0).expect("valid sizes");
        let ids = pair.naive.ids();
        let stored = store.collect(&pair.buffer, &ids).expect("stored ids");
        prop_assert_eq!(stored, naive.classes.iter().map(Vec::len).sum::<usize>());
        for (class, images) in naive.classes.iter().enumerate().filter(|(_, images)| !images.is_empty()) {
            let label = class.try_into().expect("small");
            let drawn = store.sample_class(label, 60 * images.len()).expect("a class with images");
            prop_assert!(drawn.chunks(12).all(|image| images.contains(&image.to_vec())));
            prop_assert!(images.iter().all(|image| drawn.chunks(12).any(|drawn| drawn == image)));
        }
    }
}

#[test]
fn uniform_batches_follow_the_counts() {
    let (mut store, _) = filled(&[0, 0, 0, 2], 8, 1);
    let (_, labels) = store
        .sample(40_000, Balance::Images)
        .expect("images are stored");
    let zeros = labels.iter().filter(|&&label| label == 0).count();
    // 30,000 expected, standard deviation 87: six of them.
    assert!(zeros.abs_diff(30_000) < 520, "{zeros}");
    assert!(labels.iter().all(|label| [0, 2].contains(label)));
}

#[test]
fn the_rest_of_a_division_falls_on_random_classes() {
    let (mut store, _) = filled(&[0, 1, 2, 3], 8, 1);
    let mut counts = [0_i32; CLASSES];
    for _ in 0..40_000 {
        let (_, labels) = store
            .sample(1, Balance::Classes)
            .expect("images are stored");
        counts[usize::try_from(labels[0]).expect("a label")] += 1;
    }
    assert!(
        counts.iter().all(|count| (count - 10_000).abs() < 520),
        "{counts:?}"
    );
}

#[test]
fn balanced_batches_come_in_random_order() {
    let (mut store, _) = filled(&[0, 1], 8, 1);
    let (_, labels) = store
        .sample(400, Balance::Classes)
        .expect("images are stored");
    let changes = labels.windows(2).filter(|pair| pair[0] != pair[1]).count();
    // 200 expected, standard deviation 10: six of them. Classes in turn would give 399, in blocks 1.
    assert!(changes.abs_diff(200) < 60, "{changes}");
}

#[test]
fn memory_grows_with_the_rings() {
    let mut store = GoalStore::new(5, &[1000], 1 << 30, 0).expect("sizes that fit");
    assert_eq!(store.allocated_bytes(), 0);
    (0..3000).for_each(|_| store.push(&[1; 1000], 0).expect("a valid image"));
    assert!(
        store.allocated_bytes() < 5_000_000,
        "{}",
        store.allocated_bytes()
    );
}
