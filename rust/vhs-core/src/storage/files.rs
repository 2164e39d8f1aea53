//! Reading files of ours: checksums, and sizes that are never trusted.
//!
//! A reader trusts nothing: sizes are checked against each other and against the length of the file
//! before memory is taken, so a damaged or hostile file costs an error and no more memory than its
//! own length.

use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

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
pub(crate) const READ_BYTES: usize = 1 << 20;

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

    /// Bytes that are not read yet.
    pub(crate) fn left(&mut self) -> Result<u64> {
        Ok(self.length.saturating_sub(self.position()?))
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

/// What is said of a file, which must be one: reading another kind could wait for ever, or never end.
pub(crate) fn regular(path: &Path) -> io::Result<Metadata> {
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
