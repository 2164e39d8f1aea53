//! Blocks of bytes that records lie in: heap, huge pages, or pages of a file.
//!
//! Large blocks are anonymous mappings that ask the kernel for huge pages: with small ones every image costs
//! address translations, measured at 10 % of the copy. Pages are backed when they are first written, so a
//! mapping costs nothing until it is used. The `unsafe` of this crate is in this file, but for one call in
//! `prototypes`.

use std::fs::File;
use std::io;

use memmap2::{MmapMut, MmapOptions};

/// The size of a huge page on most machines; chunks of frames and large results are multiples of it.
pub(crate) const HUGE_PAGE: usize = 2 << 20;

/// Bytes that are writable and initialised throughout, except that a heap block grows as it is written.
#[derive(Debug)]
pub(crate) enum Block {
    /// Grows up to its limit; moves when it does.
    Heap(Vec<u8>),
    /// Never moves.
    Mapped(MmapMut),
}

impl Block {
    /// Zeroed memory of `bytes`, in huge pages where the system has them and they would be full.
    pub(crate) fn anonymous(bytes: usize) -> io::Result<Self> {
        let map = MmapMut::map_anon(bytes)?;
        // Advice may be refused (a kernel without huge pages); small pages are only slower.
        #[cfg(target_os = "linux")]
        if bytes >= HUGE_PAGE {
            let _ = map.advise(memmap2::Advice::HugePage);
        }
        Ok(Self::Mapped(map))
    }

    /// A part of a file of ours that no other block covers; the file is made longer where needed.
    pub(crate) fn of_own(file: &File, offset: usize, bytes: usize) -> io::Result<Self> {
        allocate(file, offset, bytes)?;
        let mut options = MmapOptions::new();
        options.offset(offset as u64).len(bytes);
        // SAFETY: the file is ours alone. Either `scratch_file` made it and it has no name any more, so no other
        // process can change or shorten it under the mapping, or the caller of `keep` or `reopen` promised that nobody
        // does. A forked copy of this process could, and whoever forks must not use it (`vhs-py` refuses to).
        unsafe { options.map_mut(file) }.map(Self::Mapped)
    }

    /// A part of a saved file: read from it page by page, written to private memory.
    pub(crate) fn of_saved(file: &File, offset: usize, bytes: usize) -> io::Result<Self> {
        let mut options = MmapOptions::new();
        options.offset(offset as u64).len(bytes);
        // SAFETY: `save` never writes to an existing file, it renames a new one over the name; the bytes under
        // this mapping change only where someone edits the file in place, which the caller of `map` promised not to happen.
        unsafe { options.map_copy(file) }.map(Self::Mapped)
    }

    /// Bytes that the block holds at present.
    pub(crate) fn bytes(&self) -> &[u8] {
        match self {
            Self::Heap(items) => items,
            Self::Mapped(map) => map,
        }
    }

    /// As `bytes`, to be written.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Self::Heap(items) => items,
            Self::Mapped(map) => map,
        }
    }
}

/// A new file at `path` that vanishes with the process, however that ends: its name is removed at once.
pub(crate) fn scratch_file(path: &std::path::Path) -> io::Result<File> {
    let file = File::options()
        .read(true)
        .write(true)
        .create_new(true)
        .open(path)?;
    if cfg!(unix) {
        std::fs::remove_file(path)?;
    }
    Ok(file)
}

/// Takes room on the disk now: a full disk is an error here, and would be a fatal signal at the first write.
#[cfg(target_os = "linux")]
fn allocate(file: &File, offset: usize, bytes: usize) -> io::Result<()> {
    use std::os::fd::AsRawFd;
    let too_large = |_| io::Error::from(io::ErrorKind::FileTooLarge);
    let (offset, bytes) = (
        i64::try_from(offset).map_err(too_large)?,
        i64::try_from(bytes).map_err(too_large)?,
    );
    loop {
        // SAFETY: a system call on a descriptor that `file` keeps open; it touches no memory of ours.
        match unsafe { libc::posix_fallocate(file.as_raw_fd(), offset, bytes) } {
            0 => return Ok(()),
            libc::EINTR => {} // on tmpfs a signal interrupts it
            number => return Err(io::Error::from_raw_os_error(number)),
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn allocate(file: &File, offset: usize, bytes: usize) -> io::Result<()> {
    file.set_len((offset + bytes) as u64)
}
