//! Goal stores as files: written atomically, read back bit for bit, generator included.
//!
//! Invariant: a file under the chosen name is always whole, the old one or the new one.
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

use std::collections::HashMap;
use std::path::Path;

use crate::goals::store::{GoalStore, Stash};
use crate::labels::MAX_CLASSES;
use crate::storage::files::{
    ALIGNMENT, MAX_DIMENSIONS, MAX_SIZE, Reader, push_words, put_records, replace,
};
use vhs_base::check::product;
use vhs_base::error::{Error, Result};
use vhs_base::fork;
use vhs_base::rng::Rng;

const MAGIC: [u8; 8] = *b"vhsgoals";
const VERSION: u32 = 1;
/// Bytes before the image shape.
const FIXED: usize = 64;

/// Smaller classes are read instead of mapped: systems allow a process some 65,000 mappings.
const MIN_MAPPED: usize = 1 << 16;

impl GoalStore {
    /// Writes the store to `path`: to a temporary file beside it, synced, then renamed over it.
    ///
    /// A reader, or a machine that loses power, sees the old file or the new one, never half of
    /// either. The images are written from where they lie; no second copy is made.
    ///
    /// ```
    /// use vhs_core::goals::{Balance, GoalStore};
    /// let mut store = GoalStore::new(5, &[2, 84, 84, 3], 2000, 0)?;
    /// store.push(&vec![7; 2 * 84 * 84 * 3], 3)?;
    /// let path = std::env::temp_dir().join("documented.goals");
    /// store.save(&path)?;
    /// let mut loaded = GoalStore::load(&path)?;
    /// let batch = loaded.sample(8, Balance::Images)?;
    /// assert_eq!(batch, store.sample(8, Balance::Images)?); // the generator is part of the file
    /// # std::fs::remove_file(&path).expect("our own file");
    /// # Ok::<(), vhs_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions, [`Error::Io`]; the file at `path` is then
    /// as it was, or new and whole where only its directory could not be synced.
    pub fn save(&self, path: &Path) -> Result<()> {
        Saving::new(self, None)?.write(path, |read| read(self))
    }

    /// Begins a save of what is stored now, during which the store may be used: images that are overwritten
    /// meanwhile are kept until [`GoalStore::end_save`], which must follow.
    ///
    /// # Errors
    /// [`Error::Argument`] for a shape of more than 64 dimensions; then no end need follow.
    pub fn begin_save(&mut self) -> Result<Saving> {
        let newest = self.stashes.last().map_or(0, |stash| stash.number);
        let saving = Saving::new(self, Some(newest + 1))?;
        self.stashes.push(Stash {
            number: newest + 1,
            lineage: fork::lineage(),
            images: HashMap::new(),
        });
        Ok(saving)
    }

    /// Ends what [`GoalStore::begin_save`] began.
    pub fn end_save(&mut self, saving: &Saving) {
        self.stashes
            .retain(|stash| Some(stash.number) != saving.stash);
    }

    /// Reads a store that `save` wrote: contents, order of overwriting and generator.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Memory`], and [`Error::Damaged`] for a file of another kind or
    /// version, cut short or altered.
    pub fn load(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let mut store = header.store(path)?;
        let record = store.image_bytes();
        for (ring, &(count, next)) in store.rings.iter_mut().zip(&header.rings) {
            reader.records(&mut ring.images, record, count)?;
            ring.next = next;
        }
        reader.expect_checksum("checksum of the images")?;
        Ok(store)
    }

    /// As [`GoalStore::load`], at once: images stay in the file until they are first drawn, and are not
    /// checked; [`GoalStore::verify`] does that. New images go to memory, never to the file.
    ///
    /// # Errors
    /// As [`GoalStore::load`], except that altered images go unnoticed.
    ///
    /// # Safety
    /// As long as the store lives nobody edits the file in place or cuts it short, which `save` never does.
    pub unsafe fn map(path: &Path) -> Result<Self> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let mut store = header.store(path)?;
        let (record, capacity) = (store.image_bytes(), store.capacity_per_class());
        for (ring, &(count, next)) in store.rings.iter_mut().zip(&header.rings) {
            if record * count < MIN_MAPPED {
                reader.records(&mut ring.images, record, count)?;
            } else {
                ring.images = reader.mapped(record, count, capacity)?;
            }
            ring.next = next;
        }
        Ok(store)
    }

    /// Compares every checksum of a saved store, without keeping anything in memory.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Damaged`].
    pub fn verify(path: &Path) -> Result<()> {
        let mut reader = Reader::open(path)?;
        let header = Header::read(&mut reader)?;
        let images: usize = header.rings.iter().map(|ring| ring.0).sum();
        reader.skim(images * header.store(path)?.image_bytes())?;
        reader.expect_checksum("checksum of the images")
    }
}

/// A save under way: all that it writes but the images, which it reads from the store piece by piece while others
/// use that.
#[derive(Debug)]
pub struct Saving {
    /// None where nobody can change the store meanwhile.
    stash: Option<u64>,
    /// Everything up to the first checksum.
    head: Vec<u8>,
    /// Classes and slots of the images, in the order of the file.
    places: Vec<(usize, usize)>,
    image_bytes: usize,
}

impl Saving {
    fn new(store: &GoalStore, stash: Option<u64>) -> Result<Self> {
        let dimensions = u64::from(dimensions(store)?);
        let mut head = MAGIC.to_vec();
        let sizes = [
            store.num_classes() as u64,
            store.capacity_per_class() as u64,
        ];
        push_words(&mut head, [u64::from(VERSION) | dimensions << 32]);
        push_words(&mut head, sizes);
        push_words(&mut head, store.rng.state());
        push_words(&mut head, store.shape().iter().map(|&size| size as u64));
        let rings = store.rings.iter();
        push_words(
            &mut head,
            rings.flat_map(|ring| [ring.images.len() as u64, ring.next as u64]),
        );
        let places = store.counts().enumerate();
        Ok(Self {
            stash,
            head,
            places: places
                .flat_map(|(class, count)| (0..count).map(move |slot| (class, slot)))
                .collect(),
            image_bytes: store.image_bytes(),
        })
    }

    /// Writes the file, as [`GoalStore::save`] does. `with_store` hands the store that began this to a function,
    /// for a piece at a time.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Interrupted`] where the call is to stop.
    pub fn write(
        &self,
        path: &Path,
        with_store: impl Fn(&mut dyn FnMut(&GoalStore)),
    ) -> Result<()> {
        replace(path, |file| {
            file.put(&self.head)?;
            file.put_checksum()?;
            file.put_padding()?;
            put_records(file, self.image_bytes, &self.places, |places, out| {
                with_store(&mut |store| {
                    let images = places.iter().map(|&place| self.image(store, place));
                    images.for_each(|image| out.extend_from_slice(image));
                });
            })?;
            file.put_checksum()
        })
    }

    /// An image as it was when the save began.
    fn image<'a>(&self, store: &'a GoalStore, (class, slot): (usize, usize)) -> &'a [u8] {
        let stash = store
            .stashes
            .iter()
            .find(|stash| Some(stash.number) == self.stash);
        let kept = stash.and_then(|stash| stash.images.get(&(class, slot)));
        match kept {
            Some(image) => image,
            None => store.rings[class].images.get(slot),
        }
    }
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
struct Header {
    shape: Vec<usize>,
    capacity: usize,
    rng: Rng,
    /// Images of each class, and where its next one goes.
    rings: Vec<(usize, usize)>,
}

impl Header {
    /// Reads up to the first image.
    fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let (_, dimensions) = reader.first(MAGIC, VERSION)?;
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
    fn store(&self, path: &Path) -> Result<GoalStore> {
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
