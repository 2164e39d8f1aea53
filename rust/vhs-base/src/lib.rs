//! What the crates of vhs share: one error, the checks that raise it, one seeded generator.
//!
//! | module | owns |
//! |---|---|
//! | [`error`] | everything that a call can refuse |
//! | [`check`] | the checks of arguments that several calls make |
//! | [`rng`] | the generator whose output is part of the file formats |
#![deny(missing_docs)]

pub mod check;
pub mod error;
pub mod rng;
