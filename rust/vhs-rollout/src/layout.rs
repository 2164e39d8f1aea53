//! Where everything lies in the shared mapping.
//!
//! Header, the learner's bell, one post a worker, one slot an environment, then payloads (action, observation, final
//! observation; 64-byte aligned), then blobs for pickled things. Blobs are large and mostly untouched: the mapping is
//! sparse, and pages that nobody writes cost nothing.
//!
//! Every process computes the layout from the same [`Shape`], which the header repeats as a check.

use vhs_base::error::{Error, Result};

use crate::bell::Bell;
use crate::ring::Ring;
use crate::slot::Slot;
use crate::sync::{AtomicU32, AtomicU64, Line};

/// Places in a ring: an environment has at most one command or answer under way, so a ring never fills.
pub const MAX_ENVS_PER_WORKER: usize = 256;
/// Indices of environments are 32 bits wide and a bell counts 2^30 strokes; nobody comes near.
pub const MAX_WORKERS: usize = 4096;

/// First word of the mapping: "vhs roll" as bytes, in the machine's order.
pub(crate) const MAGIC: u64 = 0x6C6C_6F72_2073_6876;
/// Changed with every change of the layout: both ends of a mapping must be of one build.
pub(crate) const VERSION: u64 = 3;

const PAGE: usize = 4096;

/// Sizes that fix a layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Worker processes, at least 1.
    pub num_workers: usize,
    /// Environments that each worker steps, at least 1.
    pub envs_per_worker: usize,
    /// Size of one action, in bytes.
    pub action_bytes: usize,
    /// Size of one observation, in bytes.
    pub observation_bytes: usize,
    /// Room for pickled infos, options and errors of one environment, in bytes.
    pub blob_bytes: usize,
}

impl Shape {
    /// All environments of all workers.
    #[must_use]
    pub const fn num_envs(&self) -> usize {
        self.num_workers * self.envs_per_worker
    }

    pub(crate) const fn words(&self) -> [u64; 5] {
        [
            self.num_workers as u64,
            self.envs_per_worker as u64,
            self.action_bytes as u64,
            self.observation_bytes as u64,
            self.blob_bytes as u64,
        ]
    }
}

/// First page of the mapping.
#[repr(C)]
#[derive(Debug)]
pub(crate) struct Header {
    pub(crate) magic: AtomicU64,
    pub(crate) version: AtomicU64,
    /// [`Shape::words`].
    pub(crate) shape: [AtomicU64; 5],
    /// Not 0 once the memory has a learner.
    pub(crate) claimed: AtomicU32,
    /// Not 0 where commands have a limit, so that clocks are needed.
    pub(crate) has_limit: AtomicU32,
    /// Not 0 once the pool is closing: workers leave.
    pub(crate) closing: Line<AtomicU32>,
    /// Not 0 while the supervisor has news: the learner stops waiting.
    pub(crate) alarmed: Line<AtomicU32>,
    /// Struck once an answer; the learner's.
    pub(crate) bell: Bell,
}

/// What learner, supervisor and one worker share beside the slots.
#[repr(C, align(128))]
#[derive(Debug)]
pub(crate) struct Post {
    /// Struck once a batch of commands; the worker's.
    pub(crate) bell: Bell,
    /// Environments with a command, pushed by the learner.
    pub(crate) commands: Ring<MAX_ENVS_PER_WORKER>,
    /// Environments with an answer, pushed by the worker.
    pub(crate) answers: Ring<MAX_ENVS_PER_WORKER>,
    /// The worker's incarnation, written by the supervisor before it starts.
    pub(crate) epoch: Line<AtomicU32>,
    /// When the present step must be done, in ns of the monotonic clock; 0 while nothing runs. Written by the worker.
    pub(crate) deadline_ns: AtomicU64,
    /// When the worker last had nothing more to do than to take the next command, in ns; written by the worker.
    pub(crate) done_ns: AtomicU64,
    /// When the learner last asked, in ns: a worker that never takes the command never starts a clock of its own.
    pub(crate) asked_ns: AtomicU64,
}

impl Post {
    /// Whether a command waits for its answer.
    pub(crate) fn is_asked(&self) -> bool {
        // In this order: an answer that comes between the two can only hide a command, for as long as one look.
        let answers = self.answers.pushed();
        self.commands.pushed() != answers
    }
}

/// Offsets into the mapping, in bytes from its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// What it was computed from.
    pub shape: Shape,
    pub(crate) posts: usize,
    pub(crate) slots: usize,
    /// First payload.
    pub payloads: usize,
    /// From one payload to the next.
    pub payload_stride: usize,
    /// From a payload's start, where the action lies, to its observation.
    pub observation: usize,
    /// From a payload's start to its final observation.
    pub final_observation: usize,
    /// First blob.
    pub blobs: usize,
    /// From one blob to the next.
    pub blob_stride: usize,
    /// Size of the mapping.
    pub total: usize,
}

impl Layout {
    /// The layout of a shape.
    ///
    /// # Errors
    /// [`Error::Argument`] for a size out of range or a total that no mapping can have.
    pub fn new(shape: Shape) -> Result<Self> {
        check("num_workers", shape.num_workers, MAX_WORKERS)?;
        check(
            "envs_per_worker",
            shape.envs_per_worker,
            MAX_ENVS_PER_WORKER,
        )?;
        Self::computed(shape).ok_or_else(|| Error::Argument {
            field: "observation_bytes",
            expected: "sizes whose total fits a mapping".into(),
            got: format!("{shape:?}"),
        })
    }

    /// `None` where a sum overflows.
    fn computed(shape: Shape) -> Option<Self> {
        let limit = isize::MAX.unsigned_abs();
        let posts = aligned(size_of::<Header>(), PAGE)?;
        let slots = posts.checked_add(shape.num_workers.checked_mul(size_of::<Post>())?)?;
        let slot_bytes = shape.num_envs().checked_mul(size_of::<Slot>())?;
        let payloads = aligned(slots.checked_add(slot_bytes)?, PAGE)?;
        let observation = aligned(shape.action_bytes, 64)?;
        let one = aligned(shape.observation_bytes, 64)?;
        let final_observation = observation.checked_add(one)?;
        let payload_stride = final_observation.checked_add(one)?;
        let payload_bytes = shape.num_envs().checked_mul(payload_stride)?;
        let blobs = aligned(payloads.checked_add(payload_bytes)?, PAGE)?;
        let blob_stride = aligned(shape.blob_bytes, PAGE)?;
        let total = blobs.checked_add(shape.num_envs().checked_mul(blob_stride)?)?;
        (total <= limit).then_some(Self {
            shape,
            posts,
            slots,
            payloads,
            payload_stride,
            observation,
            final_observation,
            blobs,
            blob_stride,
            total,
        })
    }

    /// The worker that steps an environment.
    #[must_use]
    pub const fn worker_of(&self, env: usize) -> usize {
        env / self.shape.envs_per_worker
    }
}

fn aligned(size: usize, step: usize) -> Option<usize> {
    size.checked_next_multiple_of(step)
}

fn check(field: &'static str, got: usize, limit: usize) -> Result<()> {
    if (1..=limit).contains(&got) {
        return Ok(());
    }
    Err(Error::Argument {
        field,
        expected: format!("a number in 1..={limit}"),
        got: got.to_string(),
    })
}
