//! Hostile files: every checksum is right, but the numbers lie.

use std::fs;
use std::path::PathBuf;

use crate::goals::store::GoalStore;
use crate::storage::checksum::Checksum;
use vhs_base::error::Error;

/// Where the header of a store with two classes of [2, 3] images ends: 64 fixed bytes, then words.
const HEADER_END: usize = 64 + 8 * (2 + 2 * 2);

fn saved() -> (PathBuf, Vec<u8>) {
    let name = format!(
        "vhs-hostile-{}-{:?}",
        std::process::id(),
        std::thread::current().id()
    );
    let path = std::env::temp_dir().join(name);
    let mut store = GoalStore::new(2, &[2, 3], 4, 0).expect("valid sizes");
    store.push(&[7; 6], 1).expect("a valid image");
    store.save(&path).expect("a writable folder");
    let bytes = fs::read(&path).expect("what was just saved");
    (path, bytes)
}

/// The error of a file whose word at `offset` is replaced, its header checksum made right again.
fn load_with(offset: usize, word: u64) -> Error {
    let (path, mut bytes) = saved();
    bytes[offset..offset + 8].copy_from_slice(&word.to_le_bytes());
    let checksum = Checksum::of(&bytes[..HEADER_END]);
    bytes[HEADER_END..HEADER_END + 8].copy_from_slice(&checksum.to_le_bytes());
    fs::write(&path, bytes).expect("a writable folder");
    let result = GoalStore::load(&path);
    fs::remove_file(&path).expect("our own file");
    result.expect_err("a file that lies")
}

fn assert_damaged(offset: usize, word: u64, expected: &str) {
    let error = load_with(offset, word);
    assert!(matches!(error, Error::Damaged { .. }), "{error}");
    assert!(error.to_string().contains(expected), "{error}");
}

#[test]
fn the_tampered_copy_itself_is_readable() {
    let (path, bytes) = saved();
    assert_eq!(GoalStore::load(&path).expect("an intact file").len(), 1);
    let capacity = u64::from_le_bytes(bytes[24..32].try_into().expect("eight bytes"));
    assert_eq!(capacity, 4, "the offsets of these tests match the layout");
    fs::remove_file(path).expect("our own file");
}

#[test]
fn sizes_that_no_memory_holds_are_refused_before_memory_is_taken() {
    assert_damaged(64, 1 << 62, "`sizes`: expected a product that fits memory");
    assert_damaged(
        64,
        u64::MAX,
        "`image shape`: expected a number in 1..=9223372036854775807",
    );
    assert_damaged(64, 0, "`image shape`: expected a number in 1..=");
    assert_damaged(16, u64::MAX, "`classes`: expected a number in 1..=1048576");
    assert_damaged(16, 1 << 20, "`header`: expected one within the file");
    assert_damaged(24, 1 << 62, "`sizes`: expected those of a goal store");
}

#[test]
fn rings_that_contradict_themselves_are_refused() {
    // Words of the rings: (count, next) of class 0 at 80, of class 1 at 96.
    assert_damaged(
        80,
        5,
        "`images of a class`: expected a number in 0..=4, found 5",
    );
    assert_damaged(
        88,
        3,
        "`next slot of a class`: expected a number in 0..=0, found 3",
    );
    assert_damaged(
        80,
        1,
        "`next slot of a class`: expected a number in 1..=1, found 0",
    );
    assert_damaged(
        96,
        0,
        "`next slot of a class`: expected a number in 0..=0, found 1",
    );
}

#[test]
fn other_kinds_of_files_are_named() {
    assert_damaged(0, 0, "`first bytes`: expected vhsgoals, found \\x00");
    assert_damaged(
        8,
        (2 << 32) | 9,
        "`version`: expected one in 1..=1, found 9",
    );
    assert_damaged(
        8,
        (65 << 32) | 1,
        "`image dimensions`: expected a number in 1..=64, found 65",
    );
}

#[test]
fn a_generator_that_only_yields_zero_is_refused() {
    let (path, mut bytes) = saved();
    bytes[32..64].fill(0);
    let checksum = Checksum::of(&bytes[..HEADER_END]);
    bytes[HEADER_END..HEADER_END + 8].copy_from_slice(&checksum.to_le_bytes());
    fs::write(&path, bytes).expect("a writable folder");
    let error = GoalStore::load(&path).expect_err("a dead generator");
    assert!(error.to_string().contains("`generator state`"), "{error}");
    fs::remove_file(path).expect("our own file");
}
