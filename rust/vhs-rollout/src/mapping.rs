//! The mapping: one memfd that learner and workers share, and the typed views of it.
//!
//! A memfd has no name, so nothing is left behind however the processes end. It is sealed against shrinking, and only
//! sealed memory is opened: no process can make another fault.
//!
//! Invariant behind every `unsafe` here: the region is as large as its [`Layout`] says, lives as long as the [`Mapping`],
//! begins as zeros (valid for every shared type: they consist of atomics) and its control part is only ever used through
//! atomics. Payload bytes have no such types; who may touch them is the slot's state to say.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::path::PathBuf;
use std::ptr::{self, NonNull};

use vhs_base::error::{Error, Result};

use crate::layout::{Header, Layout, MAGIC, Post, Shape, VERSION};
use crate::slot::Slot;
use crate::sync::Ordering;

/// The size stays what it is.
const SEALS: libc::c_int = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL;

/// A process's view of the shared memory.
#[derive(Debug)]
pub struct Mapping {
    base: NonNull<u8>,
    layout: Layout,
    memory: OwnedFd,
}

// SAFETY: the region stays mapped until the drop, the control part consists of atomics, and payload bytes are only
// reached through methods that are unsafe to call or check the slot's state.
unsafe impl Send for Mapping {}
// SAFETY: as for Send.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// New shared memory, all zero but the header.
    ///
    /// # Errors
    /// [`Error::Argument`] for an impossible shape, [`Error::Io`] when the system refuses.
    pub fn create(shape: Shape) -> Result<Self> {
        let layout = Layout::new(shape)?;
        let memory = new_memory(layout.total).map_err(|error| refused("create", error))?;
        let mapping = Self::map(memory, layout)?;
        let header = mapping.header();
        header.version.store(VERSION, Ordering::Relaxed);
        for (word, value) in header.shape.iter().zip(shape.words()) {
            word.store(value, Ordering::Relaxed);
        }
        header.magic.store(MAGIC, Ordering::Release);
        Ok(mapping)
    }

    /// The memory that another process created.
    ///
    /// # Errors
    /// [`Error::Damaged`] when it was made for another shape or by another build, [`Error::Io`] when the system refuses.
    pub fn open(memory: OwnedFd, shape: Shape) -> Result<Self> {
        let layout = Layout::new(shape)?;
        let seals = seals(memory.as_fd()).map_err(|error| refused("read the seals of", error))?;
        if seals & SEALS != SEALS {
            return Err(damaged("seals", &SEALS.to_string(), &seals.to_string()));
        }
        let size = size_of_memory(memory.as_fd()).map_err(|error| refused("read", error))?;
        expect("size", layout.total as u64, size)?;
        let mapping = Self::map(memory, layout)?;
        let header = mapping.header();
        expect("magic", MAGIC, header.magic.load(Ordering::Acquire))?;
        expect("version", VERSION, header.version.load(Ordering::Relaxed))?;
        for (word, value) in header.shape.iter().zip(shape.words()) {
            expect("shape", value, word.load(Ordering::Relaxed))?;
        }
        Ok(mapping)
    }

    /// Offsets and sizes.
    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The memory's file descriptor, to be handed to a worker.
    #[must_use]
    pub fn memory(&self) -> BorrowedFd<'_> {
        self.memory.as_fd()
    }

    /// The slot of an environment.
    ///
    /// # Panics
    /// For an environment that does not exist.
    #[must_use]
    pub fn slot(&self, env: usize) -> &Slot {
        assert!(env < self.layout.shape.num_envs(), "environment {env}");
        // SAFETY: in bounds by the assertion and the layout, aligned since `slots` and the size are multiples of 128.
        unsafe { &*self.at::<Slot>(self.layout.slots).add(env) }
    }

    /// Start of an environment's payload, `payload_stride` bytes.
    ///
    /// # Panics
    /// For an environment that does not exist.
    #[must_use]
    pub fn payload(&self, env: usize) -> NonNull<u8> {
        assert!(env < self.layout.shape.num_envs(), "environment {env}");
        let offset = self.layout.payloads + env * self.layout.payload_stride;
        // SAFETY: in bounds by the assertion and the layout.
        unsafe { self.base.add(offset) }
    }

    /// Start of an environment's blob, `blob_stride` bytes; as with the payload, the slot's state says whose it is.
    ///
    /// # Panics
    /// For an environment that does not exist.
    #[must_use]
    pub fn blob(&self, env: usize) -> NonNull<u8> {
        assert!(env < self.layout.shape.num_envs(), "environment {env}");
        let offset = self.layout.blobs + env * self.layout.blob_stride;
        // SAFETY: in bounds by the assertion and the layout.
        unsafe { self.base.add(offset) }
    }

    pub(crate) fn header(&self) -> &Header {
        // SAFETY: the header lies at the start of the region, which is page-aligned.
        unsafe { &*self.at::<Header>(0) }
    }

    pub(crate) fn post(&self, worker: usize) -> &Post {
        assert!(worker < self.layout.shape.num_workers, "worker {worker}");
        // SAFETY: in bounds by the assertion and the layout, aligned since `posts` and the size are multiples of 128.
        unsafe { &*self.at::<Post>(self.layout.posts).add(worker) }
    }

    /// Whether [`Mapping::close`] was called.
    #[must_use]
    pub fn is_closing(&self) -> bool {
        self.header().closing.0.load(Ordering::Acquire) != 0
    }

    /// Tells every worker to leave and the learner to wait no longer. Any thread may: nobody's lock is needed.
    pub fn close(&self) {
        self.header().closing.0.store(1, Ordering::Release);
        for worker in 0..self.layout.shape.num_workers {
            self.post(worker).bell.alarm();
        }
        self.header().bell.alarm();
    }

    /// Gives the memory of payloads and blobs back: they are zeros from then on. Once the workers are gone.
    pub fn free(&self) {
        let (start, end) = (self.layout.payloads, self.layout.total);
        let mode = libc::FALLOC_FL_PUNCH_HOLE | libc::FALLOC_FL_KEEP_SIZE;
        let (Ok(start), Ok(length)) = (start.try_into(), (end - start).try_into()) else {
            return;
        };
        // SAFETY: the call only concerns the descriptor, which is open; a hole reads as zeros, valid for bytes. A refusal
        // leaves the memory until the mapping goes, which is no harm.
        unsafe {
            libc::fallocate(self.memory.as_raw_fd(), mode, start, length);
        }
    }

    fn at<T>(&self, offset: usize) -> *const T {
        self.base.as_ptr().wrapping_add(offset).cast()
    }

    fn map(memory: OwnedFd, layout: Layout) -> Result<Self> {
        let access = libc::PROT_READ | libc::PROT_WRITE;
        // SAFETY: a fresh mapping at an address of the kernel's choice touches no memory of ours.
        let base = unsafe {
            libc::mmap(
                ptr::null_mut(),
                layout.total,
                access,
                libc::MAP_SHARED,
                memory.as_raw_fd(),
                0,
            )
        };
        let base = NonNull::new(base.cast::<u8>()).filter(|_| base != libc::MAP_FAILED);
        let base = base.ok_or_else(|| refused("map", io::Error::last_os_error()))?;
        Ok(Self {
            base,
            layout,
            memory,
        })
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the region was mapped by `map` with this size, and no borrow of it outlives `self`.
        unsafe {
            libc::munmap(self.base.as_ptr().cast(), self.layout.total);
        }
    }
}

fn new_memory(bytes: usize) -> io::Result<OwnedFd> {
    let flags = libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING;
    // SAFETY: the name is a terminated string; the descriptor is new and ours alone.
    let memory = unsafe {
        let number = checked(libc::memfd_create(c"vhs-rollout".as_ptr(), flags))?;
        OwnedFd::from_raw_fd(number)
    };
    let size = libc::off_t::try_from(bytes).map_err(io::Error::other)?;
    // SAFETY: both calls only concern the descriptor, which is open.
    unsafe {
        checked(libc::ftruncate(memory.as_raw_fd(), size))?;
        checked(libc::fcntl(memory.as_raw_fd(), libc::F_ADD_SEALS, SEALS))?;
    }
    Ok(memory)
}

/// The seals that a descriptor has; an error for one that cannot have any, such as that of an ordinary file.
fn seals(memory: BorrowedFd<'_>) -> io::Result<libc::c_int> {
    // SAFETY: the call only concerns the descriptor, which is open.
    checked(unsafe { libc::fcntl(memory.as_raw_fd(), libc::F_GET_SEALS) })
}

fn size_of_memory(memory: BorrowedFd<'_>) -> io::Result<u64> {
    let file = std::fs::File::from(memory.try_clone_to_owned()?);
    Ok(file.metadata()?.len())
}

pub(crate) fn checked(result: libc::c_int) -> io::Result<libc::c_int> {
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(result)
}

fn refused(call: &'static str, source: io::Error) -> Error {
    Error::Io {
        path: PathBuf::from("shared memory of the rollout pool"),
        call,
        source,
    }
}

fn expect(field: &'static str, expected: u64, found: u64) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    Err(damaged(field, &expected.to_string(), &found.to_string()))
}

fn damaged(field: &'static str, expected: &str, found: &str) -> Error {
    Error::Damaged {
        path: PathBuf::from("shared memory of the rollout pool"),
        field,
        expected: expected.into(),
        found: found.into(),
    }
}
