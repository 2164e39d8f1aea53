//! Hindsight storage for reinforcement learning from images.
//!
//! Plain Rust, no Python: the crate behind the package `vhs`, and usable without it. Begin with
//! [`episodes::EpisodeBuffer`], [`goals::GoalStore`] and the programs in `examples/`.
//!
//! | module | owns |
//! |---|---|
//! | [`outcome`], [`item`] | how an episode ended; types of elements |
//! | [`storage`] | bytes: records, pooled results, files |
//! | [`hindsight`] | the rules: which rows are relabelled, from where, how they are rewarded |
//! | [`buffer`] | whole episodes, each frame once; batches, transitions and windows of them |
//! | [`goals`] | images of achieved goals by class, and prototypes |
//! | [`returns`], [`egomotion`] | discounted returns; where an episode's end lay at each of its steps |
//! | [`error`], [`rng`] | what the crates share, from `vhs-base` |
//!
//! Each row uses only those above it. What is used most has a short path: `vhs_core::episodes`.
#![deny(missing_docs)]

pub mod buffer;
pub mod egomotion;
pub mod goals;
pub mod hindsight;
pub mod item;
pub mod outcome;
pub mod returns;
pub mod storage;

mod labels;

pub use buffer::{batch, config, picks, transitions, windows};
pub use goals::prototypes;
pub use hindsight::{reward, rule as relabel, strategy};
pub use storage::pool;
pub use vhs_base::{error, rng};

/// The buffer, what it is built from and what goes into it.
pub mod episodes {
    pub use crate::buffer::config::{Backing, EpisodeConfig, GoalKind};
    pub use crate::buffer::episode::{Episode, Opening, Steps};
    pub use crate::buffer::episodes::EpisodeBuffer;
    pub use crate::item::Item;
}
