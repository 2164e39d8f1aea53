//! A lock-free scheduler of environments in worker processes, over one shared mapping.
//!
//! One learner asks, many workers step. Indices travel in single-producer rings, observations lie in fixed slots, and a
//! process that has nothing to do yields for a while and then sleeps. `docs/reference/rollout.md` tells how a slot lives.
//!
//! A learner makes a [`mapping::Mapping`] and a [`pool::Pool`] on it; each worker, a thread or a process, takes up its
//! post with a [`worker::Worker`]. One round of both, which `examples/pool.rs` makes a whole program of:
//!
//! ```
//! use std::{sync::Arc, time::Duration};
//! use vhs_rollout::{batch::Leaf, flags, layout::Shape, learner::Waited, mapping::Mapping, pool::Pool};
//! use vhs_rollout::{slot::Answer, worker::{Task, Worker}};
//!
//! let (num_workers, envs_per_worker) = (1, 1);
//! let (action_bytes, observation_bytes, blob_bytes) = (8, 8, 0);
//! let shape = Shape { num_workers, envs_per_worker, action_bytes, observation_bytes, blob_bytes };
//! let mapping = Arc::new(Mapping::create(shape)?);
//! let mut pool = Pool::new(Arc::clone(&mapping), vec![Leaf { offset: 0, bytes: 8 }], None)?;
//! pool.send(&[0], &[], flags::BEGIN, 0, &[])?; // a reset; a step is `STEP`, with its actions as `Rows`
//!
//! let soon = Duration::from_secs(10);
//! let mut worker = Worker::new(mapping, 0, None)?;
//! if let Task::Command(env, _) = worker.next(soon) {
//!     // Here it would write the observation into `mapping.payload(env)`.
//!     worker.commit(env, &Answer { flags: flags::FIRST, ..Answer::default() })?;
//! }
//!
//! assert_eq!(pool.wait(1, soon), Waited::Ready); // `Paused`: time is over, or a worker wants attention
//! let mut block = vec![0; pool.batch().total]; // the columns of `batch::BatchLayout`
//! assert_eq!(pool.fill(&mut block)?.rows, 1);
//! # Ok::<(), vhs_base::error::Error>(())
//! ```
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
