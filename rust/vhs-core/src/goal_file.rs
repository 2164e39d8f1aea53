//! The bytes of a goal store file: what `persist` writes and reads.
//!
//! Little-endian layout, version 1, for C classes of images with D dimensions:
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `vhsgoals` |
//! | 4, 4 | version; D |
//! | 8, 8 | C; capacity of a class |
//! | 4 x 8 | generator state |
//! | D x 8 | image shape |
//! | C x (8, 8) | images of the class; where its next image goes |
//! | 8 | checksum of all bytes above |
//! | | zeros up to a multiple of 4096, so that the images can be mapped |
//! | | images, class by class, in the order of their slots |
//! | 8 | checksum of the images |
//!
//! A reader trusts nothing: sizes are checked against each other and against the length of the file
//! before memory is taken, so a damaged or hostile file costs an error and no more memory than its
//! own length.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::checksum::Checksum;
use crate::error::{Error, Result, product};
use crate::goals::{GoalStore, MAX_CLASSES};
use crate::rng::Rng;

const MAGIC: &[u8; 8] = b"vhsgoals";
const VERSION: u32 = 1;
/// Bytes before the image shape.
const FIXED: usize = 64;
/// Images begin at a multiple of this, the page size of most machines.
const ALIGNMENT: usize = 4096;
/// As many as a numpy array can have.
const MAX_DIMENSIONS: usize = 64;
/// No size in memory can be larger.
const MAX_SIZE: usize = isize::MAX.unsigned_abs();

/// The header of a store, padded: everything before its images.
pub(crate) fn encode(store: &GoalStore) -> Result<Vec<u8>> {
    let mut header = MAGIC.to_vec();
    header.extend(VERSION.to_le_bytes());
    header.extend(dimensions(store)?.to_le_bytes());
    let mut put = |number: u64| header.extend(number.to_le_bytes());
    put(store.num_classes() as u64);
    put(store.capacity_per_class() as u64);
    store.rng.state().into_iter().for_each(&mut put);
    store.shape().iter().for_each(|&size| put(size as u64));
    for ring in &store.rings {
        put(ring.images.len() as u64);
        put(ring.next as u64);
    }
    header.extend(Checksum::of(&header).to_le_bytes());
    header.resize(header.len().next_multiple_of(ALIGNMENT), 0);
    Ok(header)
}

/// Refuses to write what could not be read back.
fn dimensions(store: &GoalStore) -> Result<u32> {
    let found = store.shape().len();
    let allowed = u32::try_from(found)
        .ok()
        .filter(|_| found <= MAX_DIMENSIONS);
    allowed.ok_or_else(|| Error::Argument {
        field: "observation_shape",
        expected: format!("at most {MAX_DIMENSIONS} dimensions in a file"),
        got: found.to_string(),
    })
}

/// A file's header, checked.
pub(crate) struct Header {
    shape: Vec<usize>,
    capacity: usize,
    rng: Rng,
    /// Images of each class, and where its next one goes.
    pub(crate) rings: Vec<(usize, usize)>,
}

impl Header {
    /// Reads up to the first image.
    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let fixed = reader.fixed()?;
        let dimensions = reader.number("image dimensions", fixed[1] >> 32, 1, MAX_DIMENSIONS)?;
        let classes = reader.number("classes", fixed[2], 1, MAX_CLASSES)?;
        let capacity = reader.number("capacity of a class", fixed[3], 1, MAX_SIZE)?;
        let variable = reader.words(dimensions + 2 * classes)?;
        reader.expect_checksum("checksum of the header")?;
        let (shape, rings) = variable.split_at(dimensions);
        let state = [fixed[4], fixed[5], fixed[6], fixed[7]];
        let header = Self {
            shape: reader.shape(shape)?,
            capacity,
            rng: Rng::from_state(state)
                .ok_or_else(|| reader.damaged("generator state", "one that is not zero", "0"))?,
            rings: reader.rings(rings, capacity)?,
        };
        let images_start = (FIXED + 8 * (variable.len() + 1)).next_multiple_of(ALIGNMENT);
        header.check_length(reader, images_start)?;
        reader.padding(images_start)?;
        Ok(header)
    }

    /// An empty store of the file's sizes and generator.
    pub(crate) fn store(&self, path: &Path) -> Result<GoalStore> {
        let store = GoalStore::new(self.rings.len(), &self.shape, self.capacity, 0);
        let mut store = store.map_err(|error| Error::Damaged {
            path: path.to_path_buf(),
            field: "sizes",
            expected: "those of a goal store".into(),
            found: error.to_string(),
        })?;
        store.rng = self.rng.clone();
        Ok(store)
    }

    /// The images that the header promises must be exactly what the file has left.
    fn check_length(&self, reader: &Reader<'_>, images_start: usize) -> Result<()> {
        let count = self
            .rings
            .iter()
            .try_fold(0_usize, |sum, ring| sum.checked_add(ring.0));
        let sizes = count.map(|count| [self.shape.as_slice(), &[count]].concat());
        let images = sizes.and_then(|sizes| product("images", &sizes).ok());
        let Some(expected) = images.and_then(|images| images.checked_add(images_start + 8)) else {
            let found = format!("images of {:?}", self.shape);
            return Err(reader.damaged("sizes", "a product that fits memory", &found));
        };
        reader.expect(
            "length in bytes",
            &expected.to_string(),
            &reader.length.to_string(),
        )
    }
}

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
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (length, file) = opened.map_err(|source| io_error(path, "open", source))?;
        Ok(Self {
            file,
            path,
            length,
            checksum: Checksum::new(),
        })
    }

    pub(crate) fn read(&mut self, bytes: &mut [u8]) -> Result<()> {
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
        self.expect(
            field,
            &format!("{computed:016x}"),
            &format!("{stored:016x}"),
        )
    }

    /// The first words: the same in every file of this version.
    fn fixed(&mut self) -> Result<[u64; FIXED / 8]> {
        let mut bytes = [0; FIXED];
        self.read(&mut bytes)?;
        let magic = bytes[..8].escape_ascii().to_string();
        self.expect("first bytes", &MAGIC.escape_ascii().to_string(), &magic)?;
        let mut words = [0; FIXED / 8];
        for (word, &bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u64::from_le_bytes(bytes);
        }
        let version = words[1] & u64::from(u32::MAX);
        self.expect("version", &VERSION.to_string(), &version.to_string())?;
        Ok(words)
    }

    /// Reads so many 64-bit words, if the file is long enough to hold them.
    fn words(&mut self, count: usize) -> Result<Vec<u64>> {
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
    fn padding(&mut self, images_start: usize) -> Result<()> {
        let mut bytes = [0; ALIGNMENT];
        // The padding ends where the images start; what lies before it has been read.
        let header = usize::try_from(self.position()?).unwrap_or(images_start);
        let bytes = &mut bytes[..images_start - header];
        self.read(bytes)?;
        self.checksum = Checksum::new();
        let found = bytes.iter().copied().max().unwrap_or_default();
        self.expect("padding", "0", &found.to_string())
    }

    fn position(&mut self) -> Result<u64> {
        io::Seek::stream_position(&mut self.file)
            .map_err(|source| io_error(self.path, "read", source))
    }

    fn shape(&self, words: &[u64]) -> Result<Vec<usize>> {
        words
            .iter()
            .map(|&size| self.number("image shape", size, 1, MAX_SIZE))
            .collect()
    }

    fn rings(&self, words: &[u64], capacity: usize) -> Result<Vec<(usize, usize)>> {
        let pairs = words.as_chunks().0.iter();
        pairs
            .map(|&[count, next]| self.ring(count, next, capacity))
            .collect()
    }

    /// A ring that is not full goes on after its last image; a full one anywhere.
    fn ring(&self, count: u64, next: u64, capacity: usize) -> Result<(usize, usize)> {
        let count = self.number("images of a class", count, 0, capacity)?;
        let (low, high) = if count < capacity {
            (count, count)
        } else {
            (0, capacity - 1)
        };
        Ok((count, self.number("next slot of a class", next, low, high)?))
    }

    fn number(&self, field: &'static str, found: u64, low: usize, high: usize) -> Result<usize> {
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

    fn expect(&self, field: &'static str, expected: &str, found: &str) -> Result<()> {
        if expected == found {
            return Ok(());
        }
        Err(self.damaged(field, expected, found))
    }

    fn damaged(&self, field: &'static str, expected: &str, found: &str) -> Error {
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

#[cfg(test)]
mod tests;
