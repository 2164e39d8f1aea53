//! A saved goal store comes back bit for bit, and no damaged file comes back at all.

use std::fs;

use proptest::prelude::*;
use vhs_core::error::Error;
use vhs_core::goals::{Balance, GoalStore};

use crate::support::{FrameSource, scratch};

fn filled(pushes: &[usize], capacity: usize) -> GoalStore {
    let mut store = GoalStore::new(4, &[2, 3], capacity, 9).expect("valid sizes");
    let mut frames = FrameSource::default();
    for &class in pushes {
        store
            .push(&frames.next(), class.try_into().expect("small"))
            .expect("a valid image");
    }
    store
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The loaded store draws the same batches, and still does after further pushes: contents,
    /// generator and the place where each ring goes on are all restored.
    #[test]
    fn a_loaded_store_goes_on_alike(
        before in prop::collection::vec(0..4_usize, 0..40),
        after in prop::collection::vec(0..4_usize, 1..20),
        capacity in 1..9_usize,
    ) {
        let mut saved = filled(&before, capacity);
        let folder = scratch("alike");
        let path = folder.join("store.goals");
        saved.save(&path).expect("a writable folder");
        let mut loaded = GoalStore::load(&path).expect("what was just saved");
        let mut frames = FrameSource::default();
        for class in after {
            let image = frames.next();
            for store in [&mut saved, &mut loaded] {
                store.push(&image, class.try_into().expect("small")).expect("a valid image");
            }
            prop_assert_eq!(saved.counts().collect::<Vec<_>>(), loaded.counts().collect::<Vec<_>>());
            let (left, right) = (saved.sample(20, Balance::Images), loaded.sample(20, Balance::Images));
            prop_assert_eq!(left.ok(), right.ok());
        }
        fs::remove_dir_all(folder).expect("our own folder");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// What a save writes is what was there when it began, however the store is used until it ends; two saves
    /// at once do not disturb each other.
    #[test]
    fn a_store_is_saved_as_it_was_when_the_save_began(
        before in prop::collection::vec(0..4_usize, 0..40),
        between in prop::collection::vec(0..4_usize, 0..20),
        after in prop::collection::vec(0..4_usize, 0..20),
        capacity in 1..9_usize,
    ) {
        let folder = scratch("meanwhile");
        let (path, whole) = (folder.join("store.goals"), folder.join("whole.goals"));
        let mut store = filled(&before, capacity);
        let mut frames = FrameSource::default();
        let mut push = |store: &mut GoalStore, classes: &[usize]| for &class in classes {
            store.push(&frames.next(), class.try_into().expect("small")).expect("a valid image");
        };
        store.save(&whole).expect("a writable folder");
        let first = fs::read(&whole).expect("what was just saved");
        let one = store.begin_save().expect("few dimensions");
        push(&mut store, &between);
        store.save(&whole).expect("a writable folder");
        let second = fs::read(&whole).expect("what was just saved");
        let two = store.begin_save().expect("few dimensions");
        push(&mut store, &after);
        for (saving, expected) in [(one, first), (two, second)] {
            saving.write(&path, |read| read(&store)).expect("a writable folder");
            store.end_save(&saving);
            prop_assert_eq!(fs::read(&path).expect("what was just saved"), expected);
        }
        fs::remove_dir_all(folder).expect("our own folder");
    }
}

#[test]
fn one_changed_byte_anywhere_is_noticed() {
    let folder = scratch("flip");
    let path = folder.join("store.goals");
    filled(&[0, 1, 1, 3], 8)
        .save(&path)
        .expect("a writable folder");
    let whole = fs::read(&path).expect("what was just saved");
    for place in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[place] ^= 0x10;
        fs::write(&path, &damaged).expect("a writable folder");
        let result = GoalStore::load(&path);
        assert!(
            matches!(result, Err(Error::Damaged { .. })),
            "byte {place}: {result:?}"
        );
    }
    fs::remove_dir_all(folder).expect("our own folder");
}

#[test]
fn a_file_of_another_length_is_noticed() {
    let folder = scratch("length");
    let path = folder.join("store.goals");
    filled(&[0, 1, 1, 3], 8)
        .save(&path)
        .expect("a writable folder");
    let mut bytes = fs::read(&path).expect("what was just saved");
    bytes.push(0);
    while bytes.pop().is_some() {
        fs::write(&path, [&bytes[..], &[1]].concat()).expect("a writable folder");
        let longer = GoalStore::load(&path);
        assert!(
            matches!(longer, Err(Error::Damaged { .. })),
            "{} bytes: {longer:?}",
            bytes.len() + 1
        );
    }
    fs::remove_dir_all(folder).expect("our own folder");
}

#[test]
fn a_failed_save_leaves_the_old_file_and_no_litter() {
    let folder = scratch("failed");
    let blocked = folder.join("a-folder");
    fs::create_dir(&blocked).expect("a writable folder");
    let result = filled(&[0], 8).save(&blocked);
    assert!(matches!(result, Err(Error::Io { .. })), "{result:?}");
    let left: Vec<_> = fs::read_dir(&folder).expect("our own folder").collect();
    assert_eq!(left.len(), 1, "only the folder itself is left: {left:?}");
    fs::remove_dir_all(folder).expect("our own folder");
}

#[test]
fn a_missing_file_is_an_error_of_the_system() {
    let result = GoalStore::load(&scratch("missing").join("store.goals"));
    assert!(
        matches!(result, Err(Error::Io { call: "open", .. })),
        "{result:?}"
    );
}
