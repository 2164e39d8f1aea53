//! What several threads use, and forked children of this process: one rule for every object that draws.
//!
//! An object is locked with a pass in hand, so that a fork finds it unlocked and whole; and before anything else its
//! generator becomes one of the process that uses it: a forked child draws batches of its own.

use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use vhs_base::fork;
use vhs_base::rng::Rng;
use vhs_core::goals::GoalStore;
use vhs_core::prototypes::Prototypes;

/// What has a generator.
pub(crate) trait Draws {
    fn rng_mut(&mut self) -> &mut Rng;
}

impl Draws for Rng {
    fn rng_mut(&mut self) -> &mut Rng {
        self
    }
}

impl Draws for GoalStore {
    fn rng_mut(&mut self) -> &mut Rng {
        self.rng_mut()
    }
}

impl Draws for Prototypes {
    fn rng_mut(&mut self) -> &mut Rng {
        self.rng_mut()
    }
}

/// See the module documentation.
pub(crate) struct Shared<T> {
    /// The object, and the lineage that its generator belongs to.
    inner: Mutex<(T, u64)>,
}

impl<T: Draws + Send> Shared<T> {
    pub(crate) fn new(object: T) -> Self {
        Self {
            inner: Mutex::new((object, fork::lineage())),
        }
    }

    /// Runs `work` on the object, which nobody else uses meanwhile. For moments only where the interpreter is held.
    pub(crate) fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        let _pass = fork::enter();
        // A poisoned lock only says that some call panicked; the next call's own checks are what counts.
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let (object, lineage) = &mut *inner;
        object.rng_mut().own(lineage);
        work(object)
    }

    /// As `with`, with the interpreter released first: no thread ever waits for the lock while it keeps others
    /// from running Python.
    pub(crate) fn detached<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut T) -> R + Send,
    ) -> R {
        py.detach(|| self.with(work))
    }
}
