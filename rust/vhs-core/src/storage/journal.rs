//! Append-only files: a head with its checksum, then entries.
//!
//! An entry is a word, its kind and the words of its content; that word inverted; the content; a checksum of all three.
//! What ends in the middle of an entry, or in zeros, was cut by a kill or a power cut, and is cut off; any other wrong
//! byte is damage.

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::storage::checksum::Checksum;
use crate::storage::files::{Reader, io_error};
use crate::storage::saves::{push_words, replace};
use vhs_base::error::Result;

/// A journal shorter than this is left as it is.
const SHORT: u64 = 16 << 20;
/// Bytes of an entry without content.
const FRAME: u64 = 24;

/// A kind, and content of whole words.
pub(crate) type Entry = (u8, Vec<u8>);

/// A journal that is written to.
#[derive(Debug)]
pub(crate) struct Journal {
    file: File,
    path: PathBuf,
    /// Bytes of whole entries: the file ends there.
    length: u64,
    /// Held as long as the journal is.
    _lock: File,
}

impl Journal {
    /// A new one, in place of whatever there is.
    pub(crate) fn create(lock: File, path: PathBuf, head: &[u8]) -> Result<Self> {
        write(&path, head, std::iter::empty())?;
        Self::of(lock, path, None)
    }

    /// One that was read, up to where its entries are whole; the rest is cut off.
    pub(crate) fn reopen(lock: File, path: PathBuf, whole: u64) -> Result<Self> {
        Self::of(lock, path, Some(whole))
    }

    fn of(lock: File, path: PathBuf, whole: Option<u64>) -> Result<Self> {
        let (file, length) = open(&path, whole)?;
        Ok(Self {
            file,
            path,
            length,
            _lock: lock,
        })
    }

    /// Adds an entry; where that fails the journal is what it was.
    pub(crate) fn put(&mut self, kind: u8, content: &[u8]) -> Result<()> {
        let bytes = entry(kind, content);
        let end = SeekFrom::Start(self.length);
        let sought = self.file.seek(end);
        let written = sought.and_then(|_| self.file.write_all(&bytes));
        if let Err(source) = written {
            // What was written of it is cut; where that fails too, it is a torn tail for whoever reopens it.
            let _ = self.file.set_len(self.length);
            return Err(io_error(&self.path, "write", source));
        }
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// Whether most of it is of no use any more, where so many bytes are.
    pub(crate) const fn is_long(&self, live: usize) -> bool {
        self.length > SHORT && self.length > 4 * live as u64
    }

    /// Writes it anew: atomically, as a save is.
    pub(crate) fn rewrite(
        &mut self,
        head: &[u8],
        entries: impl Iterator<Item = Entry>,
    ) -> Result<()> {
        write(&self.path, head, entries)?;
        (self.file, self.length) = open(&self.path, None)?;
        Ok(())
    }
}

/// The file to be written to, cut at `whole`, and its length.
fn open(path: &Path, whole: Option<u64>) -> Result<(File, u64)> {
    let opened = File::options().write(true).open(path).and_then(|file| {
        if let Some(whole) = whole {
            file.set_len(whole)?;
        }
        let length = file.metadata()?.len();
        Ok((file, length))
    });
    opened.map_err(|source| io_error(path, "open", source))
}

fn write(path: &Path, head: &[u8], mut entries: impl Iterator<Item = Entry>) -> Result<()> {
    replace(path, |file| {
        file.put(head)?;
        file.put_checksum()?;
        entries.try_for_each(|(kind, content)| file.put(&entry(kind, &content)))
    })
}

fn entry(kind: u8, content: &[u8]) -> Vec<u8> {
    let first = u64::from(kind) | (content.len() as u64 / 8) << 8;
    let mut bytes = Vec::with_capacity(content.len() + 24);
    push_words(&mut bytes, [first, !first]);
    bytes.extend(content);
    let sum = checksum(&bytes);
    push_words(&mut bytes, [sum]);
    bytes
}

fn checksum(bytes: &[u8]) -> u64 {
    let mut checksum = Checksum::new();
    checksum.update(bytes);
    checksum.value()
}

/// The next whole entry; None where there is none, or a part of one.
pub(crate) fn next(reader: &mut Reader<'_>) -> Result<Option<Entry>> {
    let left = reader.left()?;
    if left < FRAME {
        return Ok(None);
    }
    let words = reader.words(2)?;
    let (first, count) = (words[0], (words[0] >> 8).saturating_mul(8));
    if words == [0, 0] {
        // The system may have made the file longer before it wrote what is there.
        return nothing_but_zeros(reader);
    }
    if words[1] != !first {
        return Err(reader.damaged("entry", "a word and its inverse", &format!("{words:x?}")));
    }
    if count > left - FRAME {
        return Ok(None);
    }
    let content = reader.bytes(usize::try_from(count).unwrap_or(usize::MAX))?;
    let stored = reader.words(1)?[0];
    let head: Vec<u8> = words.into_iter().flat_map(u64::to_le_bytes).collect();
    if checksum(&[&head[..], &content].concat()) == stored {
        return Ok(Some((first.to_le_bytes()[0], content)));
    }
    if reader.left()? == 0 {
        return Ok(None);
    }
    Err(reader.damaged("checksum of an entry", "that of what it holds", "another"))
}

fn nothing_but_zeros(reader: &mut Reader<'_>) -> Result<Option<Entry>> {
    let left = usize::try_from(reader.left()?).unwrap_or(usize::MAX);
    let most = reader.bytes(left)?.into_iter().max().unwrap_or_default();
    reader.expect("end", "0", &most.to_string())?;
    Ok(None)
}
