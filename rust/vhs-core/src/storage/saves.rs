//! Writing files of ours: checksums, records piece by piece, atomic replacement of what lies behind a path.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::storage::checksum::Checksum;
use crate::storage::files::{ALIGNMENT, READ_BYTES, io_error, regular};
use vhs_base::check::with_room;
use vhs_base::error::Result;
use vhs_base::interrupt;

/// Bytes written between two looks whether to go on, and brought to the disk.
const SYNC_BYTES: usize = 16 << 20;
/// Bytes of a file's name that its temporary name repeats; systems allow 255 in all.
const NAME_BYTES: usize = 200;
/// Links from one to the next, after which they are taken for a circle, as Linux does.
const MAX_LINKS: usize = 40;
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
