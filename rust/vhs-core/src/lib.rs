//! Hindsight storage for reinforcement learning from images.
//!
//! Plain Rust, no Python: the crate behind the package `vhs`, and usable without it. Begin with
//! [`episodes::EpisodeBuffer`], [`goals::GoalStore`] and the programs in `examples/`.
//!
//! | module | owns |
//! |---|---|
//! | [`goals`] | images of achieved goals by class, sampled in balanced batches |
//! | [`prototypes`] | one mean feature vector a goal class |
//! | [`episodes`], [`config`] | whole episodes of many environments, each frame stored once |
//! | [`batch`], [`windows`], [`transitions`] | what a learner takes out: whole episodes, parts of them, single steps |
//! | [`relabel`] | the hindsight rule for whole episodes |
//! | [`strategy`], [`reward`], [`picks`] | hindsight goals of transitions and windows, and their rewards |
//! | [`returns`] | discounted returns |
//! | [`frames`] | stacked frames as the channels of one picture |
//! | [`persist`] | stores and buffers as files |
//! | [`pool`] | memory of results, used again |
//! | [`rng`], [`outcome`], [`error`] | what all of them share |
#![deny(missing_docs)]

pub mod batch;
pub mod config;
pub mod episodes;
pub mod error;
pub mod frames;
pub mod goals;
pub mod outcome;
pub mod persist;
pub mod picks;
pub mod pool;
pub mod prototypes;
pub mod relabel;
pub mod returns;
pub mod reward;
pub mod rng;
pub mod strategy;
pub mod transitions;
pub mod windows;

mod checksum;
mod episode;
mod episode_file;
mod files;
mod goal_file;
mod memory;
mod sampling;
mod slab;
