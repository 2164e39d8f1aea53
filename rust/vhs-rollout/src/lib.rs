//! A lock-free scheduler of environments in worker processes, over one shared mapping.
//!
//! One learner asks, many workers step. Indices travel in single-producer rings, observations lie in fixed slots, and a
//! process that has nothing to do yields for a while and then sleeps. `docs/rollout.md` tells how a slot lives.
//!
//! | module | owns |
//! |---|---|
//! | [`slot`] | who may touch an environment's bytes |
//! | [`ring`] | indices from one process to another |
//! | [`bell`] | sleeping and waking |
//! | [`layout`], [`mapping`] | the shared memory |
//! | [`learner`], [`worker`] | the two ends |
//! | [`pool`], [`batch`], [`flags`] | episodes, seeds and batches on the learner's end |
//! | [`watch`], [`process`] | deaths, deadlines, orphans |
//! | [`sync`], [`clock`] | the doors to atomics and time |
#![deny(missing_docs)]

#[cfg(not(target_os = "linux"))]
compile_error!(
    "vhs-rollout needs Linux: its processes meet in a memfd, sleep on futexes and are watched by pidfds"
);

pub mod bell;
pub mod ring;
pub mod slot;
pub mod sync;

#[cfg(not(loom))]
pub mod batch;
#[cfg(not(loom))]
pub mod clock;
#[cfg(not(loom))]
pub mod flags;
#[cfg(not(loom))]
pub mod layout;
#[cfg(not(loom))]
pub mod learner;
#[cfg(not(loom))]
pub mod mapping;
#[cfg(not(loom))]
pub mod pool;
#[cfg(not(loom))]
pub mod process;
#[cfg(not(loom))]
mod wait;
#[cfg(not(loom))]
pub mod watch;
#[cfg(not(loom))]
pub mod worker;
