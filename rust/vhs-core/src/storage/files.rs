//! Reading and writing files of ours: checksums, sizes that are never trusted, atomic replacement.
//!
//! A reader trusts nothing: sizes are checked against each other and against the length of the file
//! before memory is taken, so a damaged or hostile file costs an error and no more memory than its
//! own length.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::storage::checksum::Checksum;
use crate::storage::memory::Block;
use crate::storage::slab::{Slab, Source};
use vhs_base::check::with_room;
use vhs_base::error::{Error, Result};
use vhs_base::interrupt;

/// Records begin at a multiple of this, the page size of most machines.
pub(crate) const ALIGNMENT: usize = 4096;
/// As many as a numpy array can have.
pub(crate) const MAX_DIMENSIONS: usize = 64;
/// No size in memory can be larger.
pub(crate) const MAX_SIZE: usize = isize::MAX.unsigned_abs();
/// Bytes read or written at once, unless one record is larger.
const READ_BYTES: usize = 1 << 20;
/// Bytes written between two looks whether to go on, and brought to the disk.
const SYNC_BYTES: usize = 16 << 20;
/// Bytes of a file's name that its temporary name repeats; systems allow 255 in all.
const NAME_BYTES: usize = 200;
/// Links from one to the next, after which they are taken for a circle, as Linux does.
const MAX_LINKS: usize = 40;

/// A file being read, with the checksum of what has been read since it was last compared.
pub(crate) struct Reader<'a> {
    file: File,
    path: &'a Path,
    /// Length of the whole file, in bytes.
    length: u64,
    checksum: Checksum,
}

impl<'a> Reader<'a> {
    pub(crate) fn open(path: &'a Path) -> Result<Self> {
        let opened = regular(path).and_then(|_| {
            let file = File::open(path)?;
            Ok((file.metadata()?.len(), file))
        });
        let (length, file) = opened.map_err(|source| io_error(path, "open", source))?;
        Ok(Self {
            file,
            path,
            length,
            checksum: Checksum::new(),
        })
    }

    /// Fills the slice.
    pub(crate) fn read(&mut self, bytes: &mut [u8]) -> Result<()> {
        bytes
            .chunks_mut(READ_BYTES)
            .try_for_each(|piece| self.read_piece(piece))
    }

    fn read_piece(&mut self, bytes: &mut [u8]) -> Result<()> {
        interrupt::check()?;
        self.file
            .read_exact(bytes)
            .map_err(|source| match source.kind() {
                io::ErrorKind::UnexpectedEof => {
                    let found = format!("an end at byte {}", self.length);
                    self.damaged("length in bytes", "a whole file", &found)
                }
                _ => io_error(self.path, "read", source),
            })?;
        self.checksum.update(bytes);
        Ok(())
    }

    /// Compares the checksum of what was read with the one that comes next, and starts a new one.
    pub(crate) fn expect_checksum(&mut self, field: &'static str) -> Result<()> {
        let computed = self.checksum.value();
        let stored = self.words(1)?[0];
        self.checksum = Checksum::new();
        #[allow(
            unexpected_cfgs,
            reason = "set by cargo-fuzz, which cannot guess checksums"
        )]
        if cfg!(fuzzing) {
            return Ok(());
        }
        self.expect(
            field,
            &format!("{computed:016x}"),
            &format!("{stored:016x}"),
        )
    }

    /// The first two words, the same in every file of a kind: its name, its version, from 1 to the newest,
    /// and one more number; the last two are returned.
    pub(crate) fn first(&mut self, magic: [u8; 8], newest: u32) -> Result<(u64, u64)> {
        let mut bytes = [0; 8];
        self.read(&mut bytes)?;
        let found = bytes.escape_ascii().to_string();
        self.expect("first bytes", &magic.escape_ascii().to_string(), &found)?;
        let word = self.words(1)?[0];
        let version = word & u64::from(u32::MAX);
        if !(1..=u64::from(newest)).contains(&version) {
            let expected = format!("one in 1..={newest}");
            return Err(self.damaged("version", &expected, &version.to_string()));
        }
        Ok((version, word >> 32))
    }

    /// Reads so many bytes into new memory, if the file is long enough to hold them.
    pub(crate) fn bytes(&mut self, count: usize) -> Result<Vec<u8>> {
        if count as u64 > self.length {
            let found = format!("{count} bytes");
            return Err(self.damaged("length in bytes", "parts within the file", &found));
        }
        let mut bytes = with_room("load", count)?;
        bytes.resize(count, 0);
        self.read(&mut bytes)?;
        Ok(bytes)
    }

    /// Takes in what is not to be kept, for its checksum.
    pub(crate) fn skim(&mut self, count: usize) -> Result<()> {
        let mut buffer = vec![0; READ_BYTES.min(count)];
        let mut left = count;
        while left > 0 {
            let taken = left.min(buffer.len());
            self.read(&mut buffer[..taken])?;
            left -= taken;
        }
        Ok(())
    }

    /// Reads so many records into a slab, a piece at a time.
    pub(crate) fn records(&mut self, slab: &mut Slab, record: usize, count: usize) -> Result<()> {
        let at_once = (READ_BYTES / record).max(1).min(count);
        let mut buffer = with_room("load", at_once * record)?;
        buffer.resize(at_once * record, 0);
        let end = slab.len() + count;
        while slab.len() < end {
            let bytes = &mut buffer[..at_once.min(end - slab.len()) * record];
            self.read(bytes)?;
            for bytes in bytes.chunks_exact(record) {
                slab.put(slab.len(), bytes)?;
            }
        }
        Ok(())
    }

    /// Maps so many records, unread, and moves on behind them.
    pub(crate) fn mapped(&mut self, record: usize, count: usize, capacity: usize) -> Result<Slab> {
        if count == 0 {
            return Ok(Slab::new(record, capacity, Source::Memory));
        }
        let start = self.position()?;
        let offset = usize::try_from(start).unwrap_or(usize::MAX);
        let block = Block::of_saved(&self.file, offset, record * count);
        let block = block.map_err(|source| io_error(self.path, "map", source))?;
        let end = start + (record * count) as u64;
        io::Seek::seek(&mut self.file, io::SeekFrom::Start(end))
            .map_err(|source| io_error(self.path, "read", source))?;
        Ok(Slab::mapped(record, capacity, block, count))
    }

    /// Compares the length that the header promises with that of the file.
    pub(crate) fn expect_length(&self, expected: Option<usize>) -> Result<()> {
        let Some(expected) = expected else {
            return Err(self.damaged("sizes", "a product that fits memory", "one that does not"));
        };
        self.expect(
            "length in bytes",
            &expected.to_string(),
            &self.length.to_string(),
        )
    }

    /// Reads so many 64-bit words, if the file is long enough to hold them.
    pub(crate) fn words(&mut self, count: usize) -> Result<Vec<u64>> {
        if (count as u64).saturating_mul(8) > self.length {
            return Err(self.damaged("header", "one within the file", &format!("{count} words")));
        }
        let mut bytes = vec![0; count * 8];
        self.read(&mut bytes)?;
        Ok(bytes
            .as_chunks()
            .0
            .iter()
            .map(|&word| u64::from_le_bytes(word))
            .collect())
    }

    /// Reads the zeros before the images, at most a page, and leaves the checksum to the images.
    pub(crate) fn padding(&mut self, images_start: usize) -> Result<()> {
        let mut bytes = [0; ALIGNMENT];
        // The padding ends where the images start; what lies before it has been read.
        let header = usize::try_from(self.position()?).unwrap_or(images_start);
        let length = images_start.checked_sub(header).unwrap_or(usize::MAX);
        let Some(bytes) = bytes.get_mut(..length) else {
            let expected = format!("an end at most a page before byte {images_start}");
            return Err(self.damaged("header", &expected, &header.to_string()));
        };
        self.read(bytes)?;
        self.checksum = Checksum::new();
        let found = bytes.iter().copied().max().unwrap_or_default();
        self.expect("padding", "0", &found.to_string())
    }

    pub(crate) fn position(&mut self) -> Result<u64> {
        io::Seek::stream_position(&mut self.file)
            .map_err(|source| io_error(self.path, "read", source))
    }

    pub(crate) fn number(
        &self,
        field: &'static str,
        found: u64,
        low: usize,
        high: usize,
    ) -> Result<usize> {
        let number = usize::try_from(found)
            .ok()
            .filter(|number| (low..=high).contains(number));
        number.ok_or_else(|| {
            self.damaged(
                field,
                &format!("a number in {low}..={high}"),
                &found.to_string(),
            )
        })
    }

    pub(crate) fn expect(&self, field: &'static str, expected: &str, found: &str) -> Result<()> {
        if expected == found {
            return Ok(());
        }
        Err(self.damaged(field, expected, found))
    }

    pub(crate) fn damaged(&self, field: &'static str, expected: &str, found: &str) -> Error {
        let path = self.path.to_path_buf();
        Error::Damaged {
            path,
            field,
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// An error of the operating system, with the file and what was attempted.
pub(crate) fn io_error(path: &Path, call: &'static str, source: io::Error) -> Error {
    Error::Io {
        path: PathBuf::from(path),
        call,
        source,
    }
}

/// Bytes of records read under one lock: readers and writers of what is saved wait no longer than for these.
const PIECE_BYTES: usize = 1 << 20;

/// Writes records piece by piece: `read` is asked for those of each piece, to be put one after the other.
pub(crate) fn put_records<R>(
    file: &mut Writer<'_>,
    record_bytes: usize,
    records: &[R],
    mut read: impl FnMut(&[R], &mut Vec<u8>),
) -> Result<()> {
    let at_once = (PIECE_BYTES / record_bytes).max(1);
    let mut bytes = with_room("save", at_once.min(records.len()) * record_bytes)?;
    for piece in records.chunks(at_once) {
        bytes.clear();
        read(piece, &mut bytes);
        file.put(&bytes)?;
    }
    Ok(())
}

/// Adds little-endian words.
pub(crate) fn push_words(bytes: &mut Vec<u8>, words: impl IntoIterator<Item = u64>) {
    words
        .into_iter()
        .for_each(|word| bytes.extend(word.to_le_bytes()));
}

/// A file being written, with the checksum of what was written since the last one.
pub(crate) struct Writer<'a> {
    file: BufWriter<File>,
    path: &'a Path,
    checksum: Checksum,
    /// Bytes written so far.
    written: usize,
    /// Of them, those that were on the disk when it was last asked.
    synced: usize,
}

impl Writer<'_> {
    pub(crate) fn put(&mut self, bytes: &[u8]) -> Result<()> {
        bytes
            .chunks(READ_BYTES)
            .try_for_each(|piece| self.put_piece(piece))
    }

    fn put_piece(&mut self, bytes: &[u8]) -> Result<()> {
        self.checksum.update(bytes);
        self.written += bytes.len();
        let done = self.file.write_all(bytes);
        done.map_err(|source| io_error(self.path, "write", source))?;
        if self.written - self.synced < SYNC_BYTES {
            return Ok(());
        }
        // Asked for again and again: a sync of gigabytes at the end would hear nothing for as long as it takes.
        interrupt::check()?;
        self.synced = self.written;
        let synced = self.file.get_ref().sync_data();
        synced.map_err(|source| io_error(self.path, "sync", source))
    }

    /// Writes the checksum of what was written since the last one.
    pub(crate) fn put_checksum(&mut self) -> Result<()> {
        let value = self.checksum.value();
        self.put(&value.to_le_bytes())?;
        self.checksum = Checksum::new();
        Ok(())
    }

    /// Writes zeros up to the next page, which no checksum covers: a reader compares them.
    pub(crate) fn put_padding(&mut self) -> Result<()> {
        let zeros = self.written.next_multiple_of(ALIGNMENT) - self.written;
        self.put(&[0; ALIGNMENT][..zeros])?;
        self.checksum = Checksum::new();
        Ok(())
    }
}

/// Writes a file to a temporary one beside it, synced, then renamed over it.
///
/// A reader, or a machine that loses power, sees the old file or the new one, never half of either. A symbolic
/// link stays, and the file that it leads to is replaced; the new file has the mode of the old one, and its owner
/// where the system allows that. Whatever is no file (a device, a pipe, a directory) is refused.
pub(crate) fn replace(
    path: &Path,
    write: impl FnOnce(&mut Writer<'_>) -> Result<()>,
) -> Result<()> {
    let target = behind_links(path).map_err(|source| io_error(path, "write", source))?;
    let path = &target;
    let old = match regular(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        found => Some(found.map_err(|source| io_error(path, "write", source))?),
    };
    // Opened first, so that a directory that cannot be synced refuses before anything is written.
    let directory = open_directory(path)?;
    let (file, temporary) = temporary_beside(path)?;
    let looks = old.map_or(Ok(()), |old| look_like(&file, &old));
    let looks = looks.map_err(|source| io_error(&temporary, "write", source));
    let renamed = looks.and_then(|()| write_whole(file, &temporary, write));
    let renamed = renamed.and_then(|()| {
        let rename = fs::rename(&temporary, path);
        rename.map_err(|source| io_error(path, "rename a temporary file to", source))
    });
    if renamed.is_err() {
        // The first error is the one to report; a file that stays behind is only litter.
        let _ = fs::remove_file(&temporary);
    }
    renamed.and_then(|()| directory.map_or(Ok(()), |directory| sync_directory(path, &directory)))
}

/// What is said of a file, which must be one: reading another kind could wait for ever, or never end.
fn regular(path: &Path) -> io::Result<Metadata> {
    let found = fs::metadata(path)?;
    if found.is_dir() {
        return Err(io::Error::from_raw_os_error(libc::EISDIR));
    }
    if !found.is_file() {
        let message = "something that is no file, such as a device or a pipe";
        return Err(io::Error::new(ErrorKind::InvalidInput, message));
    }
    Ok(found)
}

/// The path itself or, where it is a symbolic link, the one that it leads to in the end, there or not.
fn behind_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        match fs::symlink_metadata(&path) {
            Ok(found) if found.is_symlink() => {
                let target = fs::read_link(&path)?;
                path = path.parent().unwrap_or(Path::new("")).join(target);
            }
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => return Ok(path),
        }
    }
    Err(io::Error::from_raw_os_error(libc::ELOOP))
}

/// Gives a new file the owner, where the system allows it, and the mode of an old one.
fn look_like(file: &File, old: &Metadata) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, fchown};
        let new = file.metadata()?;
        if (new.uid(), new.gid()) != (old.uid(), old.gid()) {
            // Refused to all but the superuser and members of the group; the file is then the writer's, as any
            // new one.
            let _ = fchown(file, Some(old.uid()), Some(old.gid()));
        }
    }
    file.set_permissions(old.permissions())
}

/// As much of a name as leaves room for what makes it a temporary one.
fn beginning(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    let fits = |&end: &usize| name.is_char_boundary(end);
    let end = (0..=NAME_BYTES.min(name.len())).rev().find(fits);
    name[..end.unwrap_or_default()].to_string()
}

fn write_whole(
    file: File,
    path: &Path,
    write: impl FnOnce(&mut Writer<'_>) -> Result<()>,
) -> Result<()> {
    let mut writer = Writer {
        file: BufWriter::with_capacity(READ_BYTES, file),
        path,
        checksum: Checksum::new(),
        written: 0,
        synced: 0,
    };
    write(&mut writer)?;
    interrupt::check()?;
    let synced = writer
        .file
        .flush()
        .and_then(|()| writer.file.get_ref().sync_all());
    synced.map_err(|source| io_error(path, "sync", source))
}

/// A new file in the same directory: a rename must not cross file systems.
///
/// The numbers tell the saves of this process apart. A name may be taken all the same, by a save that was killed
/// or one of another machine or container that has this process's number: then the next one is tried.
fn temporary_beside(path: &Path) -> Result<(File, PathBuf)> {
    static SAVES: AtomicU64 = AtomicU64::new(0);
    loop {
        // Relaxed: only the uniqueness of the number matters, not its order with other memory.
        let number = SAVES.fetch_add(1, Ordering::Relaxed);
        let mut name = OsString::from(".");
        name.push(beginning(path.file_name().unwrap_or_default()));
        name.push(format!(".{}-{number}.tmp", std::process::id()));
        let temporary = path.with_file_name(name);
        match File::create_new(&temporary) {
            Ok(file) => return Ok((file, temporary)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(source) => return Err(io_error(&temporary, "write", source)),
        }
    }
}

/// The directory that the file lies in; None where directories cannot be opened as files.
fn open_directory(path: &Path) -> Result<Option<File>> {
    if !cfg!(unix) {
        return Ok(None);
    }
    let parent = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    let directory = parent.unwrap_or(Path::new("."));
    let opened = File::open(directory);
    opened
        .map(Some)
        .map_err(|source| io_error(path, "write", source))
}

/// Makes the rename itself durable, where the file system can.
fn sync_directory(path: &Path, directory: &File) -> Result<()> {
    match directory.sync_all() {
        Err(error)
            if !matches!(
                error.kind(),
                ErrorKind::InvalidInput | ErrorKind::Unsupported
            ) =>
        {
            Err(io_error(path, "sync the directory of", error))
        }
        _ => Ok(()),
    }
}
