//! Long calls that can be stopped between two pieces of their work.
//!
//! Whoever runs a call on a thread of its own says so with [`watched`]; the call asks [`check`] between pieces of
//! some milliseconds at most. On any other thread nothing is ever stopped.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

thread_local! {
    static STOP: RefCell<Option<Arc<AtomicBool>>> = const { RefCell::new(None) };
}

/// Runs `work`, whose checks fail once `stop` is true.
pub fn watched<R>(stop: Arc<AtomicBool>, work: impl FnOnce() -> R) -> R {
    let before = STOP.replace(Some(stop));
    let result = work();
    STOP.set(before);
    result
}

/// Goes on, unless the call is to stop.
///
/// # Errors
/// [`Error::Interrupted`].
pub fn check() -> Result<()> {
    // Relaxed: nothing else is read because of it.
    let is_over = STOP.with_borrow(|stop| {
        stop.as_ref()
            .is_some_and(|stop| stop.load(Ordering::Relaxed))
    });
    if is_over {
        return Err(Error::Interrupted);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_watched_call_is_stopped() {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = watched(stop.clone(), || {
            let before = check();
            stop.store(true, Ordering::Relaxed);
            (before.is_ok(), check().is_err())
        });
        assert_eq!(stopped, (true, true));
        assert!(check().is_ok());
    }
}
