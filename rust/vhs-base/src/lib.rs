//! What the crates of vhs share: one error, the checks that raise it, one seeded generator, and what holds when a
//! process forks or a call is to stop.
//!
//! | module | owns |
//! |---|---|
//! | [`error`] | everything that a call can refuse |
//! | [`check`] | the checks of arguments that several calls make |
//! | [`rng`] | the generator whose output is part of the file formats |
//! | [`fork`] | locks and generators across a fork |
//! | [`interrupt`] | long calls that can be stopped |
#![deny(missing_docs)]

pub mod check;
pub mod error;
pub mod fork;
pub mod interrupt;
pub mod rng;
