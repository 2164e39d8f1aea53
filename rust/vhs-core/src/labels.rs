//! Class, action and row numbers: i64 outside of the crate, the integer of array users, and indices within.

/// The most classes a store or a prototype table can have; a sample walks over all of them.
pub const MAX_CLASSES: usize = 1 << 20;

/// A label that has passed `check_labels`, as an index.
pub(crate) fn class_of(label: i64) -> usize {
    usize::try_from(label).unwrap_or(usize::MAX)
}

/// An index as a label.
pub(crate) fn label_of(class: usize) -> i64 {
    i64::try_from(class).unwrap_or(i64::MAX)
}
