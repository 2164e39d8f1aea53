//! Processes by descriptor: a pidfd means one process for good, where a number may be given to another.

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::path::PathBuf;
use std::sync::Once;
use std::time::Duration;

use vhs_base::error::{Error, Result};

use crate::mapping::checked;
use crate::sync::{AtomicU32, Ordering};

/// A descriptor of a process, readable once it has ended.
///
/// # Errors
/// [`Error::Io`] when no process has this number or the system refuses a descriptor.
pub fn open_process(pid: i32) -> Result<OwnedFd> {
    // SAFETY: the call takes plain numbers.
    let number = unsafe { libc::syscall(libc::SYS_pidfd_open, pid, 0) };
    let number = checked(libc::c_int::try_from(number).unwrap_or(-1));
    let number = number.map_err(|error| refused("open", pid, error))?;
    // SAFETY: the descriptor is new, ours alone.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}

fn refused(call: &'static str, pid: i32, source: io::Error) -> Error {
    let needs = "Linux 5.3 or newer, where no sandbox forbids pidfd_open";
    Error::Io {
        path: PathBuf::from(format!("pidfd of process {pid} ({needs})")),
        call,
        source,
    }
}

/// How many forks lie between this process and the one that asked first: another number in every fork, for the price of
/// a load where a process's number costs a system call. What is owned by one process remembers it.
#[must_use]
pub fn forks() -> u32 {
    static FORKS: AtomicU32 = AtomicU32::new(0);
    static ASKED: Once = Once::new();
    extern "C" fn count() {
        FORKS.fetch_add(1, Ordering::Relaxed);
    }
    ASKED.call_once(|| {
        // SAFETY: the handler stays loaded as long as the process; it runs in a child, where it may do nothing but what a
        // signal handler may, such as to add to an atomic. A refusal, for want of memory, would only cost the warning.
        unsafe {
            libc::pthread_atfork(None, None, Some(count));
        }
    });
    FORKS.load(Ordering::Relaxed)
}

/// Sends a signal; a process that has ended meanwhile needs none.
pub(crate) fn signal_process(process: &OwnedFd, signal: i32) {
    // SAFETY: plain numbers; no siginfo is passed.
    unsafe {
        let none = std::ptr::null::<libc::siginfo_t>();
        libc::syscall(
            libc::SYS_pidfd_send_signal,
            process.as_raw_fd(),
            signal,
            none,
            0,
        );
    }
}

/// Which descriptors are readable, after waiting for one of them for at most `limit`.
pub(crate) fn poll_readable(descriptors: &[RawFd], limit: Duration) -> Vec<bool> {
    let mut polls: Vec<libc::pollfd> = descriptors
        .iter()
        .map(|&fd| libc::pollfd {
            fd,
            events: libc::POLLIN,
            revents: 0,
        })
        .collect();
    let millis = libc::c_int::try_from(limit.as_millis()).unwrap_or(libc::c_int::MAX);
    // SAFETY: the array is valid and as long as told. An error, such as a signal, leaves nothing readable.
    unsafe {
        libc::poll(polls.as_mut_ptr(), polls.len() as libc::nfds_t, millis);
    }
    polls.iter().map(|poll| poll.revents != 0).collect()
}

/// This thread's tie to one core, which can be loosened: on a core that a foreign process keeps busy, a thread that is
/// tied to it waits for whole time slices while others stand free.
#[derive(Debug)]
pub(crate) struct Pin {
    home: libc::cpu_set_t,
    everywhere: libc::cpu_set_t,
    is_home: bool,
}

impl Pin {
    /// A tie to core `cpu`, still loose; `None` where the thread may not run there.
    pub(crate) fn new(cpu: usize) -> Option<Self> {
        // SAFETY: a set of cores is an array of bits, so zeros are one; the calls stay within its size, and `CPU_SET`
        // panics for a number beyond it.
        unsafe {
            let mut everywhere: libc::cpu_set_t = std::mem::zeroed();
            let size = size_of::<libc::cpu_set_t>();
            checked(libc::sched_getaffinity(0, size, &raw mut everywhere)).ok()?;
            if cpu >= size * 8 || !libc::CPU_ISSET(cpu, &everywhere) {
                return None;
            }
            let mut home: libc::cpu_set_t = std::mem::zeroed();
            libc::CPU_SET(cpu, &mut home);
            Some(Self {
                home,
                everywhere,
                is_home: false,
            })
        }
    }

    /// Ties the thread to its core, or lets it run wherever it could before.
    pub(crate) fn set(&mut self, is_home: bool) {
        if self.is_home == is_home {
            return;
        }
        let cores = if is_home {
            &self.home
        } else {
            &self.everywhere
        };
        // SAFETY: the set is valid and of the size told. A refusal leaves the thread where it is, which is no harm.
        unsafe {
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), cores);
        }
        self.is_home = is_home;
    }
}

/// Makes this process end when the process `parent` ends, however that happens, even in the middle of a step.
///
/// A thread waits for it. Where `by_signal`, the kernel is asked too; it means the *thread* that started this process, so
/// ask for it only where that thread lives as long as its process.
///
/// # Errors
/// [`Error::Io`] when `parent` has ended already or the system refuses.
pub fn end_with(parent: i32, by_signal: bool) -> Result<()> {
    let process = open_process(parent)?;
    if by_signal {
        // SAFETY: plain numbers.
        let asked = unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL as libc::c_ulong) };
        checked(asked).map_err(|error| refused("end with", parent, error))?;
    }
    // Checked after both, so that a parent that ended between is not missed.
    // SAFETY: the call cannot fail.
    if unsafe { libc::getppid() } != parent {
        let gone = io::Error::from_raw_os_error(libc::ESRCH);
        return Err(refused("end with", parent, gone));
    }
    let watcher = std::thread::Builder::new()
        .name("vhs-rollout-parent".into())
        .spawn(move || {
            while !poll_readable(&[process.as_raw_fd()], Duration::MAX)[0] {}
            // SAFETY: ends this process at once, without destructors: nobody is left to use what they would save.
            unsafe { libc::_exit(1) };
        });
    watcher
        .map(drop)
        .map_err(|error| refused("wait for", parent, error))
}
