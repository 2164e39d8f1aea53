//! The goal store as a file: written atomically, read back bit for bit, generator included.
//!
//! Little-endian layout, version 1:
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `vhsgoals` |
//! | 4, 4 | version; number of image dimensions D |
//! | 8, 8 | number of classes C; capacity of a class |
//! | 4 x 8 | generator state |
//! | D x 8 | image shape |
//! | C x (8, 8) | images of the class; where its next image goes |
//! | 8 | checksum of all bytes above |
//! | | zeros up to a multiple of 4096, so that the images can be mapped |
//! | | images, class by class, in the order of their slots |
//! | 8 | checksum of the images |
//!
//! A reader trusts nothing: sizes are checked against each other and against the length of the file before memory is
//! taken, so a damaged or hostile file costs an error and no more memory than its own length.

use std::fs::{self, File};
use std::io::{self, Read, Write};
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
/// Bytes read at once, unless one image is larger.
const READ_BYTES: usize = 1 << 20;

impl GoalStore {
    /// Writes the store to `path`: to a temporary file beside it, synced, then renamed over it.
    ///
    /// A reader, or a machine that loses power, sees the old file or the new one, never half of either. The images are
    /// written from where they lie; no second copy is made.
    ///
    /// # Errors
    /// [`Error::Io`]; the file at `path` is then as it was.
    pub fn save(&self, path: &Path) -> Result<()> {
        let temporary = temporary_beside(path);
        let written = self.write_to(&temporary).and_then(|()| {
            fs::rename(&temporary, path)
                .map_err(|source| io_error(path, "rename a temporary file to", source))?;
            sync_directory(path)
        });
        if written.is_err() {
            // The first error is the one to report; a temporary file that cannot be removed either is only litter.
            let _ = fs::remove_file(&temporary);
        }
        written
    }

    /// Reads a store that `save` wrote, with its contents, its order of overwriting and its generator.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Damaged`] for a file of another kind or version, cut short or altered, [`Error::Memory`].
    pub fn load(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|source| io_error(path, "open", source))?;
        let length = file
            .metadata()
            .map_err(|source| io_error(path, "open", source))?
            .len();
        let mut reader = Reader {
            file,
            path,
            length,
            checksum: Checksum::new(),
        };
        let header = Header::read(&mut reader)?;
        let mut store = header.empty_store(path)?;
        reader.checksum = Checksum::new();
        for (class, &(count, next)) in header.rings.iter().enumerate() {
            store.fill(class, count, next, &mut reader)?;
        }
        reader.expect_checksum("checksum of the images")?;
        Ok(store)
    }

    fn write_to(&self, path: &Path) -> Result<()> {
        let failed = |source| io_error(path, "write", source);
        let mut file = File::options()
            .write(true)
            .create_new(true)
            .open(path)
            .map_err(failed)?;
        file.write_all(&self.header()).map_err(failed)?;
        let mut checksum = Checksum::new();
        for piece in self.rings().iter().flat_map(|ring| ring.images.pieces()) {
            checksum.update(piece);
            file.write_all(piece).map_err(failed)?;
        }
        file.write_all(&checksum.value().to_le_bytes())
            .map_err(failed)?;
        file.sync_all()
            .map_err(|source| io_error(path, "sync", source))
    }

    fn header(&self) -> Vec<u8> {
        let mut header = MAGIC.to_vec();
        header.extend(VERSION.to_le_bytes());
        // At most MAX_DIMENSIONS in any file that can be read back; more would be refused there.
        header.extend(
            u32::try_from(self.shape().len())
                .unwrap_or(u32::MAX)
                .to_le_bytes(),
        );
        let mut put = |number: u64| header.extend(number.to_le_bytes());
        put(self.num_classes() as u64);
        put(self.capacity_per_class() as u64);
        self.rng().state().into_iter().for_each(&mut put);
        self.shape().iter().for_each(|&size| put(size as u64));
        for ring in self.rings() {
            put(ring.images.len() as u64);
            put(ring.next as u64);
        }
        header.extend(Checksum::of(&header).to_le_bytes());
        header.resize(header.len().next_multiple_of(ALIGNMENT), 0);
        header
    }

    fn fill(
        &mut self,
        class: usize,
        count: usize,
        next: usize,
        reader: &mut Reader<'_>,
    ) -> Result<()> {
        let record = self.image_bytes();
        let mut buffer = vec![0; (READ_BYTES / record).max(1).min(count) * record];
        let ring = &mut self.rings_mut()[class];
        let mut slot = 0;
        while slot < count {
            let images = (buffer.len() / record).min(count - slot);
            let bytes = &mut buffer[..images * record];
            reader.read(bytes)?;
            for image in bytes.chunks_exact(record) {
                ring.images.put(slot, std::iter::once(image))?;
                slot += 1;
            }
        }
        ring.next = next;
        Ok(())
    }
}

/// The numbers before the images, checked.
struct Header {
    shape: Vec<usize>,
    capacity: usize,
    rng: Rng,
    /// Images of each class, and where its next one goes.
    rings: Vec<(usize, usize)>,
}

impl Header {
    fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let mut fixed = [0; FIXED];
        reader.read(&mut fixed)?;
        reader.expect(
            "first bytes",
            &format!("{:?}", MAGIC.as_slice()),
            format!("{:?}", &fixed[..8]),
        )?;
        let words: Vec<u64> = fixed
            .as_chunks::<8>()
            .0
            .iter()
            .map(|&word| u64::from_le_bytes(word))
            .collect();
        let (version, dimensions) = (words[1] & u64::from(u32::MAX), words[1] >> 32);
        reader.expect("version", &VERSION.to_string(), version.to_string())?;
        let dimensions = reader.number("image dimensions", dimensions, 1, MAX_DIMENSIONS)?;
        let classes = reader.number("classes", words[2], 1, MAX_CLASSES)?;
        let capacity = reader.number(
            "capacity of a class",
            words[3],
            1,
            isize::MAX.unsigned_abs(),
        )?;
        let variable = reader.words(dimensions + 2 * classes)?;
        reader.expect_checksum("checksum of the header")?;
        let padding = (FIXED + 8 * (variable.len() + 1)).next_multiple_of(ALIGNMENT)
            - FIXED
            - 8 * (variable.len() + 1);
        reader.read(&mut vec![0; padding])?;

        let (shape, rings) = variable.split_at(dimensions);
        let shape: Vec<usize> = shape
            .iter()
            .map(|&size| reader.number("image shape", size, 1, isize::MAX.unsigned_abs()))
            .collect::<Result<_>>()?;
        let rings: Vec<_> = rings
            .as_chunks::<2>()
            .0
            .iter()
            .map(|&[count, next]| reader.ring(count, next, capacity))
            .collect::<Result<_>>()?;
        let state = [words[4], words[5], words[6], words[7]];
        let rng = Rng::from_state(state)
            .ok_or_else(|| reader.damaged("generator state", "not all zero", "zero"))?;
        let header = Self {
            shape,
            capacity,
            rng,
            rings,
        };
        header.check_length(reader, FIXED + 8 * (variable.len() + 1) + padding)?;
        Ok(header)
    }

    /// The images that the header promises must be exactly what the file has left.
    fn check_length(&self, reader: &Reader<'_>, header_bytes: usize) -> Result<()> {
        let count = self
            .rings
            .iter()
            .try_fold(0_usize, |sum, ring| sum.checked_add(ring.0));
        let sizes = count.map(|count| [self.shape.as_slice(), &[count]].concat());
        let images = sizes.and_then(|sizes| product("images", &sizes).ok());
        let expected = images.and_then(|images| images.checked_add(header_bytes + 8));
        let Some(expected) = expected else {
            return Err(reader.damaged(
                "sizes",
                "a product that fits memory",
                &format!("{:?}", self.shape),
            ));
        };
        reader.expect(
            "length in bytes",
            &expected.to_string(),
            reader.length.to_string(),
        )
    }

    fn empty_store(&self, path: &Path) -> Result<GoalStore> {
        let store = GoalStore::new(self.rings.len(), &self.shape, self.capacity, 0);
        let mut store = store.map_err(|error| Error::Damaged {
            path: path.to_path_buf(),
            field: "sizes",
            expected: "those of a goal store".into(),
            found: error.to_string(),
        })?;
        *store.rng_mut() = self.rng.clone();
        Ok(store)
    }
}

/// A file being read, with the checksum of what has been read since it was last reset.
struct Reader<'a> {
    file: File,
    path: &'a Path,
    /// Length of the whole file, in bytes.
    length: u64,
    checksum: Checksum,
}

impl Reader<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<()> {
        self.file
            .read_exact(bytes)
            .map_err(|source| match source.kind() {
                io::ErrorKind::UnexpectedEof => self.damaged(
                    "length",
                    "a whole file",
                    &format!("an end at {} bytes", self.length),
                ),
                _ => io_error(self.path, "read", source),
            })?;
        self.checksum.update(bytes);
        Ok(())
    }

    /// Reads so many 64-bit words, if the file is long enough to hold them.
    fn words(&mut self, count: usize) -> Result<Vec<u64>> {
        if (count as u64) * 8 > self.length {
            return Err(self.damaged("header", "one within the file", &format!("{count} words")));
        }
        let mut bytes = vec![0; count * 8];
        self.read(&mut bytes)?;
        Ok(bytes
            .as_chunks::<8>()
            .0
            .iter()
            .map(|&word| u64::from_le_bytes(word))
            .collect())
    }

    fn expect_checksum(&mut self, field: &'static str) -> Result<()> {
        let computed = self.checksum.value();
        let stored = self.words(1)?[0];
        self.expect(field, &format!("{computed:016x}"), format!("{stored:016x}"))
    }

    fn expect(&self, field: &'static str, expected: &str, found: String) -> Result<()> {
        if expected == found {
            return Ok(());
        }
        Err(self.damaged(field, expected, &found))
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

    fn damaged(&self, field: &'static str, expected: &str, found: &str) -> Error {
        Error::Damaged {
            path: self.path.to_path_buf(),
            field,
            expected: expected.into(),
            found: found.into(),
        }
    }
}

/// A name in the same directory (a rename must not cross file systems) that no other save uses at the same time.
fn temporary_beside(path: &Path) -> PathBuf {
    use std::sync::atomic::{AtomicU64, Ordering};
    static SAVES: AtomicU64 = AtomicU64::new(0);
    // Relaxed: only the uniqueness of the number matters, not its order with other memory.
    let number = SAVES.fetch_add(1, Ordering::Relaxed);
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}-{number}.tmp", std::process::id()));
    path.with_file_name(name)
}

/// Makes the rename itself durable. Only Unix can open a directory as a file.
fn sync_directory(path: &Path) -> Result<()> {
    if cfg!(unix) {
        let directory = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let synced = File::open(directory).and_then(|directory| directory.sync_all());
        synced.map_err(|source| io_error(directory, "sync", source))?;
    }
    Ok(())
}

fn io_error(path: &Path, call: &'static str, source: io::Error) -> Error {
    Error::Io {
        path: path.to_path_buf(),
        call,
        source,
    }
}
