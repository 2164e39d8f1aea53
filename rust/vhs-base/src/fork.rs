//! Forks: what a forked child may trust, and which draws are its own.
//!
//! A child has copies of all locks as they were at the fork, and none of the threads that would give them back.
//! Whoever takes a lock therefore holds a [`Pass`] meanwhile, and a fork waits until no other thread has one:
//! what a child finds is whole and unlocked. Nobody waits for anything outside of this process, the interpreter's
//! lock included, while holding one.
//!
//! A process has a *lineage*, 0 until it forks: that of a child follows from its parent's and from how many
//! children its parent had before. A generator that was made under another lineage is re-keyed by the present
//! one before it draws ([`Rng::own`](crate::rng::Rng::own)), so that no two processes draw the same, and the same
//! program draws the same again.

use std::cell::Cell;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::SeqCst};
use std::thread;
use std::time::Duration;

/// How long a fork and those that wait for it sleep between looks.
const PAUSE: Duration = Duration::from_micros(20);

/// Threads with a pass.
static ACTIVE: AtomicUsize = AtomicUsize::new(0);
/// Whether a fork is under way: no new pass is given.
static CLOSED: AtomicBool = AtomicBool::new(false);
static LINEAGE: AtomicU64 = AtomicU64::new(0);

thread_local! {
    static HAS_PASS: Cell<bool> = const { Cell::new(false) };
}

/// While it lives no other thread forks this process. It stays on its thread.
#[derive(Debug)]
#[must_use = "a fork is held back as long as it lives"]
pub struct Pass {
    /// Whether it is the thread's first: passes nest.
    is_outer: bool,
    on_one_thread: PhantomData<*const ()>,
}

/// Waits for a fork that is under way, and holds back the next.
pub fn enter() -> Pass {
    watch_forks();
    let is_outer = !HAS_PASS.replace(true);
    // Sequentially consistent, as in `before`: one of the two sees the other.
    while is_outer && !counted() {
        thread::sleep(PAUSE);
    }
    Pass {
        is_outer,
        on_one_thread: PhantomData,
    }
}

/// Counts a thread in, unless a fork is under way.
fn counted() -> bool {
    ACTIVE.fetch_add(1, SeqCst);
    let is_open = !CLOSED.load(SeqCst);
    if !is_open {
        ACTIVE.fetch_sub(1, SeqCst);
    }
    is_open
}

impl Drop for Pass {
    fn drop(&mut self) {
        if self.is_outer {
            HAS_PASS.set(false);
            ACTIVE.fetch_sub(1, SeqCst);
        }
    }
}

/// The lineage of this process; see the module documentation.
#[must_use]
pub fn lineage() -> u64 {
    watch_forks();
    LINEAGE.load(SeqCst)
}

#[cfg(unix)]
use at_fork::watch_forks;

#[cfg(not(unix))]
fn watch_forks() {}

/// What is done around a fork.
#[cfg(unix)]
mod at_fork {
    use std::sync::Once;
    use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
    use std::thread;

    use super::{ACTIVE, CLOSED, HAS_PASS, LINEAGE, PAUSE};

    /// Forks of this process so far.
    static FORKS: AtomicU64 = AtomicU64::new(0);

    /// That of the `number`th child of a process.
    pub(super) const fn child_of(lineage: u64, number: u64) -> u64 {
        // The finaliser of SplitMix64, over both.
        let mut z = lineage.rotate_left(32) ^ number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) | 1
    }

    pub(super) fn watch_forks() {
        static WATCHED: Once = Once::new();
        WATCHED.call_once(|| {
            // SAFETY: the functions have the signature asked for, live as long as the program, and do what is allowed
            // at a fork: the last one, in the child, touches atomics alone.
            unsafe { libc::pthread_atfork(Some(before), Some(after), Some(in_child)) };
        });
    }

    /// Passes of the forking thread itself, which cannot be waited for.
    pub(super) fn own() -> usize {
        usize::from(HAS_PASS.get())
    }

    extern "C" fn before() {
        while CLOSED.swap(true, SeqCst) {
            thread::sleep(PAUSE); // another thread forks
        }
        FORKS.fetch_add(1, SeqCst);
        while ACTIVE.load(SeqCst) > own() {
            thread::sleep(PAUSE);
        }
    }

    extern "C" fn after() {
        CLOSED.store(false, SeqCst);
    }

    extern "C" fn in_child() {
        // A thread that looked in and went away again may have been counted.
        ACTIVE.store(own(), SeqCst);
        LINEAGE.store(child_of(LINEAGE.load(SeqCst), FORKS.load(SeqCst)), SeqCst);
        FORKS.store(0, SeqCst);
        CLOSED.store(false, SeqCst);
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::at_fork::{child_of, own};
    use super::*;

    #[test]
    fn children_and_their_children_differ() {
        let mut seen = std::collections::BTreeSet::from([0]);
        for first in 1..50 {
            let child = child_of(0, first);
            assert!(seen.insert(child));
            for second in 1..50 {
                assert!(seen.insert(child_of(child, second)));
            }
        }
    }

    #[test]
    fn passes_nest() {
        let outer = enter();
        drop(enter());
        assert_eq!(own(), 1);
        drop(outer);
        assert_eq!(own(), 0);
    }

    /// A fork waits for who has a pass, and its child finds nobody inside and a lineage of its own.
    #[test]
    fn a_fork_waits_and_a_child_starts_clean() {
        use std::sync::Mutex;
        static LOCK: Mutex<u64> = Mutex::new(0);
        assert_eq!(lineage(), 0);
        let is_over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                while !is_over.load(SeqCst) {
                    let _pass = enter();
                    let mut count = LOCK.lock().expect("never poisoned");
                    *count += 1;
                    thread::sleep(Duration::from_micros(200));
                    *count += 1;
                }
            });
            let mut failed = 0;
            for _ in 0..50 {
                // SAFETY: the child does no more than take the lock, which is what is tested, and leave.
                let child = unsafe { libc::fork() };
                if child == 0 {
                    let is_whole = LOCK.try_lock().is_ok_and(|count| *count % 2 == 0);
                    let is_right = is_whole && ACTIVE.load(SeqCst) == 0 && lineage() != 0;
                    // SAFETY: leaves without destructors, which would be those of threads that are not here.
                    unsafe { libc::_exit(i32::from(!is_right)) };
                }
                let mut status = 0;
                // SAFETY: the child is ours, and the status has room.
                unsafe { libc::waitpid(child, &raw mut status, 0) };
                failed += i32::from(status != 0);
            }
            is_over.store(true, SeqCst);
            assert_eq!(failed, 0);
        });
        assert_eq!(lineage(), 0, "a parent stays what it was");
    }
}
