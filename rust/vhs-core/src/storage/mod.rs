//! Bytes: where records lie, how they are copied, and how files of them are read and written.

pub(crate) mod checksum;
pub(crate) mod files;
pub(crate) mod journal;
pub(crate) mod memory;
pub(crate) mod packed;
pub mod pool;
pub(crate) mod saves;
pub(crate) mod slab;
pub(crate) mod stacking;
