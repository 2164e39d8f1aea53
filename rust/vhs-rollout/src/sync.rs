//! The one door to atomics and to sleeping: loom's in a model (`--cfg loom`), the machine's otherwise.
//!
//! Nothing else in this crate names an atomic type, so that the models in `tests/loom.rs` run the very code that the
//! processes run. Orderings are Relaxed, Acquire, Release and `AcqRel` alone: loom does not model `SeqCst`.

#[cfg(loom)]
pub use loom::sync::atomic::{AtomicU32, AtomicU64, Ordering};
#[cfg(not(loom))]
pub use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

pub use futex::Parking;

/// A value alone on its cache lines: two of 64 bytes, since the hardware fetches them in pairs.
#[repr(C, align(128))]
#[derive(Debug, Default)]
pub struct Line<T>(pub T);

#[cfg(not(loom))]
mod futex {
    use std::ptr;
    use std::time::Duration;

    use super::AtomicU32;

    /// Where a sleeper lies: the kernel's queue of the word itself, so nothing is stored here.
    #[repr(C)]
    #[derive(Debug, Default)]
    pub struct Parking;

    impl Parking {
        /// Sleeps while `word` holds `expected`, at most for `limit`; may return early for no reason.
        ///
        /// The operation is not the PRIVATE one: sleeper and waker are different processes that map the same page.
        pub fn wait(&self, word: &AtomicU32, expected: u32, limit: Duration) {
            let limit = libc::timespec {
                tv_sec: libc::time_t::try_from(limit.as_secs()).unwrap_or(libc::time_t::MAX),
                tv_nsec: libc::c_long::from(limit.subsec_nanos()),
            };
            // SAFETY: the word outlives the call, the kernel only reads it, and `limit` is a valid relative time. Every
            // result means "look again": woken, changed before sleeping, timed out or interrupted by a signal.
            unsafe {
                libc::syscall(
                    libc::SYS_futex,
                    word.as_ptr(),
                    libc::FUTEX_WAIT,
                    expected,
                    &raw const limit,
                    ptr::null::<u32>(),
                    0,
                );
            }
        }

        /// Wakes the sleeper on `word`, if there is one.
        pub fn wake(&self, word: &AtomicU32) {
            // SAFETY: waking only takes the address as the name of a queue.
            unsafe {
                libc::syscall(libc::SYS_futex, word.as_ptr(), libc::FUTEX_WAKE, 1);
            }
        }
    }
}

#[cfg(loom)]
mod futex {
    use std::time::Duration;

    use loom::sync::{Condvar, Mutex};

    use super::{AtomicU32, Ordering};

    /// A futex in a model: the kernel's queue lock and its queue.
    #[derive(Debug, Default)]
    pub struct Parking {
        queue_lock: Mutex<()>,
        queue: Condvar,
    }

    impl Parking {
        /// As the real one, but without a limit: a lost wake must show as a deadlock.
        pub fn wait(&self, word: &AtomicU32, expected: u32, _limit: Duration) {
            let guard = self.queue_lock.lock().expect("no model panics here");
            // The kernel compares under its queue lock and never sees a stale word: a read-modify-write is like that.
            if word.fetch_add(0, Ordering::AcqRel) == expected {
                drop(self.queue.wait(guard));
            }
        }

        /// As the real one.
        pub fn wake(&self, _word: &AtomicU32) {
            let _guard = self.queue_lock.lock().expect("no model panics here");
            self.queue.notify_one();
        }
    }
}
