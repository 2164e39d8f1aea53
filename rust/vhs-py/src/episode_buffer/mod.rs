//! The buffer behind `vhs.EpisodeBuffer`: its locks, and the process that it belongs to.

mod arguments;
mod draws;
mod methods;
mod properties;

use std::path::Path;
use std::sync::{PoisonError, RwLock};

use pyo3::prelude::*;
use vhs_base::error::{Error, Result};
use vhs_base::fork;
use vhs_base::rng::Rng;
use vhs_core::config::Stacking;
use vhs_core::episodes::{self as core, Backing, EpisodeConfig, GoalKind, Item};

use crate::arrays::{checked, integer_vec};
use crate::error::to_py;
use crate::interrupt::copying;
use crate::shared::Shared;

/// Frames of at most so many bytes are copied without giving the interpreter away: some microseconds.
const BRIEF: usize = 1 << 16;

#[doc = stub!("EpisodeBuffer")]
// Readers work side by side; whoever writes works alone. The generator has a lock of its own, held for a
// moment, and always taken last.
#[pyclass(frozen, weakref, module = "vhs._core")]
pub(crate) struct EpisodeBuffer {
    inner: RwLock<core::EpisodeBuffer>,
    pub(crate) rng: Shared<Rng>,
    /// What the buffer was built from: fixed, so reading it needs no lock.
    config: EpisodeConfig,
    #[doc = stub!("EpisodeBuffer.num_streams")]
    #[pyo3(get)]
    num_streams: usize,
    #[doc = stub!("EpisodeBuffer.max_episode_steps")]
    #[pyo3(get)]
    max_episode_steps: usize,
    #[doc = stub!("EpisodeBuffer.capacity_steps")]
    #[pyo3(get)]
    capacity_steps: usize,
    #[doc = stub!("EpisodeBuffer.frame_stack")]
    #[pyo3(get)]
    frame_stack: usize,
    #[doc = stub!("EpisodeBuffer.num_goals")]
    #[pyo3(get)]
    num_goals: usize,
    #[doc = stub!("EpisodeBuffer.num_actions")]
    #[pyo3(get)]
    num_actions: Option<usize>,
    #[doc = stub!("EpisodeBuffer.num_interactions")]
    #[pyo3(get)]
    num_interactions: usize,
    #[doc = stub!("EpisodeBuffer.action_dim")]
    #[pyo3(get)]
    action_dim: usize,
    /// Process and lineage that made it, where frames lie in a scratch file: a fork would share that memory.
    owner: Option<(u32, u64)>,
}

impl From<core::EpisodeBuffer> for EpisodeBuffer {
    fn from(mut buffer: core::EpisodeBuffer) -> Self {
        let config = buffer.config().clone();
        Self {
            num_streams: config.num_streams,
            max_episode_steps: config.max_episode_steps,
            capacity_steps: config.capacity_steps,
            frame_stack: config.frame_stack,
            num_goals: config.num_goals,
            num_actions: config.num_actions,
            num_interactions: config.num_interactions,
            action_dim: config.action_dim,
            owner: matches!(config.backing, Backing::Scratch(_) | Backing::Kept(_))
                .then(|| (std::process::id(), fork::lineage())),
            config,
            rng: Shared::new(buffer.rng_mut().clone()),
            inner: RwLock::new(buffer),
        }
    }
}

impl EpisodeBuffer {
    /// A call of the core that only reads, for callers that have released the interpreter already.
    pub(crate) fn with_core<R>(
        &self,
        call: impl FnOnce(&core::EpisodeBuffer) -> Result<R>,
    ) -> Result<R> {
        self.check_process()?;
        self.with_locked(call)
    }

    /// Runs `work` beside other readers, with a pass in hand: a fork finds nothing locked.
    fn with_locked<R>(&self, work: impl FnOnce(&core::EpisodeBuffer) -> R) -> R {
        let _pass = fork::enter();
        // A poisoned lock only says that some call panicked; the next call's own checks are what counts.
        work(&self.inner.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// As `with_locked`, alone.
    fn with_locked_alone<R>(&self, work: impl FnOnce(&mut core::EpisodeBuffer) -> R) -> R {
        let _pass = fork::enter();
        work(&mut self.inner.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// A save that locks the buffer for moments only.
    fn save_to(&self, path: &Path) -> Result<()> {
        self.check_process()?;
        let saving = self.with_locked_alone(|buffer| {
            let rng = self.rng.with(|rng| rng.clone());
            buffer.begin_save(&rng)
        })?;
        let saved = saving.write(path, |read| self.with_locked(|buffer| read(buffer)));
        self.with_locked_alone(core::EpisodeBuffer::end_save);
        saved
    }

    /// Refuses a forked copy of a buffer on disk: both processes would write the same frames.
    fn check_process(&self) -> Result<()> {
        let Some((owner, _)) = self.owner.filter(|&owner| owner.1 != fork::lineage()) else {
            return Ok(());
        };
        Err(Error::Argument {
            field: "backing",
            expected: format!("a buffer on disk to be used by the process that made it, {owner}"),
            got: format!("process {}, forked from it", std::process::id()),
        })
    }

    pub(crate) const fn goal_word(&self) -> &'static str {
        match self.config.goal_kind {
            GoalKind::Labels => "labels",
            GoalKind::Observations => "observations",
            GoalKind::Vectors { .. } => "vectors",
        }
    }

    pub(crate) const fn stacking_word(&self) -> &'static str {
        match self.config.stacking {
            Stacking::Frames => "frames",
            Stacking::Channels => "channels",
        }
    }

    /// Shape and type of a goal as an array.
    pub(crate) fn goal_array(&self) -> (Vec<usize>, Item) {
        match &self.config.goal_kind {
            GoalKind::Vectors { shape, item } => (shape.clone(), *item),
            _ => (self.config.observation_shape(), self.config.frame_item),
        }
    }

    pub(crate) const fn config(&self) -> &EpisodeConfig {
        &self.config
    }

    /// Reads what lies in memory beside the frames, with the interpreter released.
    pub(crate) fn with_buffer<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&core::EpisodeBuffer) -> R + Send,
    ) -> R {
        py.detach(|| self.with_locked(work))
    }

    /// A call of the core that only reads, with the interpreter released.
    pub(crate) fn read<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        checked(py.detach(|| self.with_core(call)))
    }

    /// A call of the core that writes, with the interpreter released.
    pub(crate) fn write<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        checked(self.check_process())?;
        checked(py.detach(|| self.with_locked_alone(call)))
    }

    /// Whether this buffer is locked before another where a call needs both: of two calls with the same two
    /// buffers neither then waits in a circle.
    fn is_before(&self, other: &Self) -> PyResult<bool> {
        let (here, there) = (std::ptr::from_ref(self), std::ptr::from_ref(other));
        if here != there {
            return Ok(here < there);
        }
        Err(to_py(Error::Argument {
            field: "buffer",
            expected: "another buffer".into(),
            got: "this one".into(),
        }))
    }

    /// As `copy`, for a call that may read another buffer too.
    pub(crate) fn copy_with<R: Send>(
        &self,
        py: Python<'_>,
        bytes: usize,
        other: Option<&Self>,
        call: impl FnOnce(&core::EpisodeBuffer, Option<&core::EpisodeBuffer>) -> Result<R> + Send,
    ) -> PyResult<R> {
        let Some(other) = other else {
            return self.copy(py, bytes, |mine| call(mine, None));
        };
        if self.is_before(other)? {
            return self.copy(py, bytes, |mine| {
                other.with_core(|theirs| call(mine, Some(theirs)))
            });
        }
        other.copy(py, bytes, |theirs| {
            self.with_core(|mine| call(mine, Some(theirs)))
        })
    }

    /// A call of the core that writes this buffer and reads another, with the interpreter released.
    pub(crate) fn write_reading<R: Send>(
        &self,
        py: Python<'_>,
        other: &Self,
        call: impl FnOnce(&mut core::EpisodeBuffer, &core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        if self.is_before(other)? {
            return self.write(py, |mine| other.with_core(|theirs| call(mine, theirs)));
        }
        other.read(py, |theirs| {
            self.check_process()?;
            self.with_locked_alone(|mine| call(mine, theirs))
        })
    }

    /// As `read`, for a call that copies so many bytes.
    pub(crate) fn copy<R: Send>(
        &self,
        py: Python<'_>,
        bytes: usize,
        call: impl FnOnce(&core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        copying(py, bytes, || self.with_core(call))
    }

    /// As `write`, for calls that copy a frame or less: where nobody else uses the buffer, giving the interpreter
    /// away and taking it back would cost more than it frees. Nobody waits for a lock with it in hand.
    pub(crate) fn write_briefly<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut core::EpisodeBuffer) -> Result<R> + Send,
    ) -> PyResult<R> {
        if self.config.frame_bytes() <= BRIEF {
            let _pass = fork::enter();
            if let Ok(mut buffer) = self.inner.try_write() {
                return checked(self.check_process().and_then(|()| call(&mut buffer)));
            }
        }
        self.write(py, call)
    }

    /// The streams of an argument; None means all.
    pub(crate) fn all_streams(&self, streams: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<i64>> {
        let all = || Ok((0..).take(self.config.num_streams).collect());
        streams.map_or_else(all, |streams| integer_vec("streams", streams))
    }
}

/// How the frames of an observation lie in it, from its word.
pub(crate) fn stacking(word: &str) -> PyResult<Stacking> {
    match word {
        "frames" => Ok(Stacking::Frames),
        "channels" => Ok(Stacking::Channels),
        _ => Err(to_py(Error::Argument {
            field: "stacking",
            expected: "\"frames\", \"channels\"".into(),
            got: format!("\"{word}\""),
        })),
    }
}
