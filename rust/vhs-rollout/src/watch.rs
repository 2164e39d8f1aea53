//! The supervisor's ears: a thread of the learner's process that hears deaths and ends steps that overrun.
//!
//! It sleeps in `poll` on a pidfd a worker, so a death is heard at once and costs nothing until then. It reclaims nothing:
//! it notes the death, rings the learner, and the learner's own thread does the rest.
//!
//! An overdue worker first gets the signal upon which it writes down its Python stack, then SIGKILL.

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use vhs_base::error::{Error, Result};

use crate::clock::monotonic_ns;
use crate::layout::Post;
use crate::mapping::{Mapping, checked};
use crate::process::{open_process, poll_readable, signal_process};
use crate::sync::Ordering;
use crate::worker::nanos;

/// Time for an overdue worker to write its stack down.
const LAST_WORDS: Duration = Duration::from_millis(100);
/// How often deadlines are looked at, as a share of the time allowed and as bounds.
const LOOKS_PER_LIMIT: u32 = 8;
const SHORTEST_LOOK: Duration = Duration::from_millis(5);
const LONGEST_LOOK: Duration = Duration::from_millis(250);

/// How a worker ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Death {
    /// Which worker.
    pub worker: usize,
    /// It was killed because a command took longer than allowed.
    pub was_overdue: bool,
}

#[derive(Debug)]
struct Watched {
    worker: usize,
    process: OwnedFd,
    /// When it gets SIGKILL, in ns of the monotonic clock, once it is overdue.
    kill_at_ns: Option<u64>,
}

#[derive(Debug, Default)]
struct Ledger {
    watched: Vec<Watched>,
    deaths: Vec<Death>,
    is_over: bool,
}

/// The listening thread; it ends with this value.
#[derive(Debug)]
pub struct Watch {
    ledger: Arc<Mutex<Ledger>>,
    nudge: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
    mapping: Arc<Mapping>,
    /// The process that the thread lives in: a fork has this value but not the thread.
    owner: u32,
}

struct Listener {
    ledger: Arc<Mutex<Ledger>>,
    nudge: Arc<OwnedFd>,
    mapping: Arc<Mapping>,
    limit: Option<Duration>,
    dump_signal: i32,
}

impl Watch {
    /// Starts to listen, to nobody yet.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses a descriptor or a thread, and where it could not listen to anybody.
    pub fn start(mapping: Arc<Mapping>, limit: Option<Duration>, dump_signal: i32) -> Result<Self> {
        // Before there is a process that would have to be ended again.
        drop(open_process(std::process::id().cast_signed())?);
        let ledger = Arc::new(Mutex::new(Ledger::default()));
        // SAFETY: a new descriptor, ours alone.
        let nudge = unsafe {
            let flags = libc::EFD_CLOEXEC | libc::EFD_NONBLOCK;
            OwnedFd::from_raw_fd(checked(libc::eventfd(0, flags)).map_err(refused)?)
        };
        let nudge = Arc::new(nudge);
        let has_limit = u32::from(limit.is_some());
        mapping
            .header()
            .has_limit
            .store(has_limit, Ordering::Relaxed);
        let listener = Listener {
            ledger: Arc::clone(&ledger),
            nudge: Arc::clone(&nudge),
            mapping: Arc::clone(&mapping),
            limit,
            dump_signal,
        };
        let thread = std::thread::Builder::new()
            .name("vhs-rollout-watch".into())
            .spawn(move || listener.listen())
            .map_err(refused)?;
        Ok(Self {
            ledger,
            nudge,
            thread: Some(thread),
            mapping,
            owner: std::process::id(),
        })
    }

    /// Listens to the process that now is this worker; its parent must not have reaped it.
    ///
    /// # Errors
    /// [`Error::Io`] when no such process exists or the system refuses a descriptor.
    pub fn add(&self, worker: usize, pid: i32) -> Result<()> {
        let process = open_process(pid)?;
        self.locked().watched.push(Watched {
            worker,
            process,
            kill_at_ns: None,
        });
        self.nudge().map_err(refused)
    }

    /// The deaths since the last call.
    #[must_use]
    pub fn take_deaths(&self) -> Vec<Death> {
        let mut ledger = self.locked();
        self.mapping.header().alarmed.0.store(0, Ordering::Release);
        std::mem::take(&mut ledger.deaths)
    }

    fn locked(&self) -> MutexGuard<'_, Ledger> {
        lock(&self.ledger)
    }

    fn nudge(&self) -> io::Result<()> {
        // SAFETY: writes 8 bytes from a valid local, as an eventfd wants them.
        let written = unsafe {
            let one = 1_u64;
            libc::write(self.nudge.as_raw_fd(), (&raw const one).cast(), 8)
        };
        checked(libc::c_int::try_from(written).unwrap_or(8)).map(drop)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        if self.owner != std::process::id() {
            return;
        }
        self.locked().is_over = true;
        // Without a nudge the thread would sleep on; then it is better left alone than waited for.
        if self.nudge().is_ok()
            && let Some(thread) = self.thread.take()
        {
            drop(thread.join());
        }
    }
}

impl Listener {
    fn listen(self) {
        loop {
            let mut descriptors = vec![self.nudge.as_raw_fd()];
            {
                let ledger = lock(&self.ledger);
                if ledger.is_over {
                    return;
                }
                descriptors.extend(ledger.watched.iter().map(|one| one.process.as_raw_fd()));
            }
            let readable = poll_readable(&descriptors, self.look());
            if readable.first().copied().unwrap_or(false) {
                self.drain();
            }
            self.attend(&readable[1..]);
        }
    }

    /// How long to sleep at most: without a limit for commands, starting and making an environment still have one.
    fn look(&self) -> Duration {
        let share = self.limit.map(|limit| limit / LOOKS_PER_LIMIT);
        share.map_or(LONGEST_LOOK, |share| {
            share.clamp(SHORTEST_LOOK, LONGEST_LOOK)
        })
    }

    /// Notes the dead, `is_dead` telling who of the first watched is, and sees to the overdue.
    fn attend(&self, is_dead: &[bool]) {
        let mut ledger = lock(&self.ledger);
        // From the back, since removal moves what follows. Only this thread removes, and additions come at the end.
        for index in (0..is_dead.len()).rev().filter(|&index| is_dead[index]) {
            let gone = ledger.watched.remove(index);
            ledger.deaths.push(Death {
                worker: gone.worker,
                was_overdue: gone.kill_at_ns.is_some(),
            });
        }
        for one in &mut ledger.watched {
            self.see_to(one);
        }
        if !ledger.deaths.is_empty() {
            let header = self.mapping.header();
            if header.alarmed.0.swap(1, Ordering::AcqRel) == 0 {
                header.bell.alarm();
            }
        }
    }

    fn see_to(&self, one: &mut Watched) {
        let now_ns = monotonic_ns();
        let post = self.mapping.post(one.worker);
        if let Some(kill_at_ns) = one.kill_at_ns {
            if now_ns >= kill_at_ns {
                signal_process(&one.process, libc::SIGKILL);
            }
            return;
        }
        if self.is_overdue(post, now_ns) {
            signal_process(&one.process, self.dump_signal);
            one.kill_at_ns = Some(now_ns + nanos(LAST_WORDS));
        }
    }

    /// Whether a worker's command, or its start, takes longer than allowed, or a command is not even taken.
    fn is_overdue(&self, post: &Post, now_ns: u64) -> bool {
        // Acquire: with a zero comes since when the worker rests.
        let deadline_ns = post.deadline_ns.load(Ordering::Acquire);
        if deadline_ns != 0 {
            return now_ns > deadline_ns;
        }
        let Some(limit) = self.limit.filter(|_| post.is_asked()) else {
            return false;
        };
        let done_ns = post.done_ns.load(Ordering::Relaxed);
        let since_ns = done_ns.max(post.asked_ns.load(Ordering::Relaxed));
        now_ns > since_ns.saturating_add(nanos(limit))
    }

    fn drain(&self) {
        let mut count = 0_u64;
        // SAFETY: reads 8 bytes into a valid local, as an eventfd gives them.
        unsafe {
            libc::read(self.nudge.as_raw_fd(), (&raw mut count).cast(), 8);
        }
    }
}

fn refused(source: io::Error) -> Error {
    Error::Io {
        path: PathBuf::from("the thread that hears of dead workers"),
        call: "start or wake",
        source,
    }
}

/// A poisoned lock only says that a thread panicked; the ledger is valid between any two statements.
fn lock(ledger: &Mutex<Ledger>) -> MutexGuard<'_, Ledger> {
    ledger.lock().unwrap_or_else(PoisonError::into_inner)
}
