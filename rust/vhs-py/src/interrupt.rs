//! Long calls that hear Ctrl-C: they run on a thread of their own, while the caller's listens.

use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use vhs_base::error::Result;
use vhs_base::interrupt;

use crate::arrays::checked;

/// How long a signal waits to be heard.
const SLICE: Duration = Duration::from_millis(20);
/// Copies of fewer bytes are over sooner.
const LONG_BYTES: usize = 128 << 20;

/// Runs a call of the core that may take seconds, with the interpreter released. Where a signal's handler raises,
/// as that of Ctrl-C does, the call is stopped between two pieces of its work, and the handler's exception is the
/// result.
pub(crate) fn interruptible<R: Send>(
    py: Python<'_>,
    call: impl FnOnce() -> Result<R> + Send,
) -> PyResult<R> {
    let (stop, is_over) = (Arc::new(AtomicBool::new(false)), AtomicBool::new(false));
    let caller = thread::current();
    thread::scope(|scope| {
        let (stopped, is_over) = (stop.clone(), &is_over);
        let worker = thread::Builder::new().spawn_scoped(scope, move || {
            // Also where the call panics: whoever waits hears of it.
            let _last = OnDrop(|| {
                is_over.store(true, Ordering::Release);
                caller.unpark();
            });
            interrupt::watched(stopped, call)
        })?;
        let mut heard = Ok(());
        while !is_over.load(Ordering::Acquire) {
            py.detach(|| thread::park_timeout(SLICE));
            if heard.is_ok() {
                heard = py.check_signals();
                // Relaxed: nothing else is read because of it.
                stop.store(heard.is_err(), Ordering::Relaxed);
            }
        }
        let result = py.detach(|| worker.join());
        heard?;
        checked(result.unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

/// As `interruptible` where so many bytes take long to copy, else on this thread.
pub(crate) fn copying<R: Send>(
    py: Python<'_>,
    bytes: usize,
    call: impl FnOnce() -> Result<R> + Send,
) -> PyResult<R> {
    if bytes < LONG_BYTES {
        return checked(py.detach(call));
    }
    interruptible(py, call)
}

/// Calls its function when it goes.
struct OnDrop<F: FnMut()>(F);

impl<F: FnMut()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}
