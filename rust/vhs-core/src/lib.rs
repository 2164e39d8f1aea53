//! Hindsight storage for reinforcement learning from images.
//!
//! Plain Rust, no Python: the crate behind the package `vhs`, and usable without it.
//!
//! | module | owns |
//! |---|---|
//! | [`goals`] | images of achieved goals by class, sampled in balanced batches |
//! | [`prototypes`] | one mean feature vector a goal class |
//! | [`episodes`], [`batch`] | whole episodes of many environments, each frame stored once |
//! | [`relabel`] | the hindsight rule |
//! | [`returns`] | discounted returns |
//! | [`persist`] | the goal store as a file |
//! | [`rng`], [`outcome`], [`error`] | what all of them share |
#![deny(missing_docs)]

pub mod batch;
pub mod episodes;
pub mod error;
pub mod goals;
pub mod outcome;
pub mod persist;
pub mod prototypes;
pub mod relabel;
pub mod returns;
pub mod rng;

mod checksum;
mod episode;
mod goal_file;
mod sampling;
mod slab;
