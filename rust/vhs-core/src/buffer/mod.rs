//! Whole episodes of many environments, and what a learner takes out of them.

pub mod batch;
mod collect;
pub mod config;
pub mod episode;
pub mod episodes;
pub mod field;
pub mod picks;
mod priorities;
mod prioritised;
pub mod transitions;
pub mod windows;

mod file;
mod kept;
mod layer;
mod room;
