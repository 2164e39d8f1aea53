//! Any bytes as a goal store file: an error or a store that works, never a panic or a large allocation.
#![no_main]

#[path = "../support.rs"]
mod support;

use libfuzzer_sys::fuzz_target;
use vhs_core::goals::{Balance, GoalStore};

fuzz_target!(|data: &[u8]| {
    let file = support::file(data);
    let verified = GoalStore::verify(&file.path);
    let loaded = GoalStore::load(&file.path);
    assert_eq!(verified.is_ok(), loaded.is_ok(), "{verified:?}");
    // SAFETY: the file is this call's own, and `save` below puts another in its place.
    let mapped = unsafe { GoalStore::map(&file.path) };
    for mut store in loaded.into_iter().chain(mapped) {
        if !store.is_empty() {
            store.sample(3, Balance::Classes).expect("images to draw");
        }
        // An empty store may be of images that no memory holds: only a sane one gets another.
        let bytes: usize = store.shape().iter().product();
        if bytes < 1 << 20 {
            store.push(&vec![1; bytes], 0).expect("room for one image");
        }
        store.save(&file.path).expect("a writable folder");
    }
});
