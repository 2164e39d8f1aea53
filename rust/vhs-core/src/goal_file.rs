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

use std::path::Path;

use crate::error::{Error, Result, product};
use crate::files::{ALIGNMENT, MAX_DIMENSIONS, MAX_SIZE, Reader, Writer};
use crate::goals::{GoalStore, MAX_CLASSES};
use crate::rng::Rng;

const MAGIC: [u8; 8] = *b"vhsgoals";
const VERSION: u32 = 1;
/// Bytes before the image shape.
const FIXED: usize = 64;

/// Writes a store.
pub(crate) fn write(store: &GoalStore, file: &mut Writer<'_>) -> Result<()> {
    let dimensions = u64::from(dimensions(store)?);
    file.put(&MAGIC)?;
    file.put_words([u64::from(VERSION) | dimensions << 32])?;
    file.put_words([
        store.num_classes() as u64,
        store.capacity_per_class() as u64,
    ])?;
    file.put_words(store.rng.state())?;
    file.put_words(store.shape().iter().map(|&size| size as u64))?;
    for ring in &store.rings {
        file.put_words([ring.images.len() as u64, ring.next as u64])?;
    }
    file.put_checksum()?;
    file.put_padding()?;
    let mut pieces = store.rings.iter().flat_map(|ring| ring.images.pieces());
    pieces.try_for_each(|piece| file.put(piece))?;
    file.put_checksum()
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
        let dimensions = reader.first(MAGIC, VERSION)?;
        let fixed = reader.words(FIXED / 8 - 2)?;
        let dimensions = reader.number("image dimensions", dimensions, 1, MAX_DIMENSIONS)?;
        let classes = reader.number("classes", fixed[0], 1, MAX_CLASSES)?;
        let capacity = reader.number("capacity of a class", fixed[1], 1, MAX_SIZE)?;
        let variable = reader.words(dimensions + 2 * classes)?;
        reader.expect_checksum("checksum of the header")?;
        let (sizes, places) = variable.split_at(dimensions);
        let state = [fixed[2], fixed[3], fixed[4], fixed[5]];
        let header = Self {
            shape: shape(reader, sizes)?,
            capacity,
            rng: Rng::from_state(state)
                .ok_or_else(|| reader.damaged("generator state", "one that is not zero", "0"))?,
            rings: rings(reader, places, capacity)?,
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
        reader.expect_length(images.and_then(|images| images.checked_add(images_start + 8)))
    }
}

fn shape(reader: &Reader<'_>, words: &[u64]) -> Result<Vec<usize>> {
    words
        .iter()
        .map(|&size| reader.number("image shape", size, 1, MAX_SIZE))
        .collect()
}

fn rings(reader: &Reader<'_>, words: &[u64], capacity: usize) -> Result<Vec<(usize, usize)>> {
    let pairs = words.as_chunks().0.iter();
    pairs
        .map(|&[count, next]| ring(reader, count, next, capacity))
        .collect()
}

/// A ring that is not full goes on after its last image; a full one anywhere.
fn ring(reader: &Reader<'_>, count: u64, next: u64, capacity: usize) -> Result<(usize, usize)> {
    let count = reader.number("images of a class", count, 0, capacity)?;
    let (low, high) = if count < capacity {
        (count, count)
    } else {
        (0, capacity - 1)
    };
    Ok((
        count,
        reader.number("next slot of a class", next, low, high)?,
    ))
}

#[cfg(test)]
mod tests;
