//! The goal store as a file: written atomically, read back bit for bit, generator included.
//!
//! Invariant: a file under the chosen name is always whole, the old one or the new one. The layout
//! is in `goal_file`.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::checksum::Checksum;
#[cfg(doc)]
use crate::error::Error;
use crate::error::Result;
use crate::goal_file::{Header, Reader, encode, io_error};
use crate::goals::GoalStore;

/// Bytes read at once, unless one image is larger.
const READ_BYTES: usize = 1 << 20;

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
    /// [`Error::Io`]; the file at `path` is then as it was.
    pub fn save(&self, path: &Path) -> Result<()> {
        let temporary = temporary_beside(path);
        let renamed = self.write_to(&temporary).and_then(|()| {
            let rename = fs::rename(&temporary, path);
            rename.map_err(|source| io_error(path, "rename a temporary file to", source))
        });
        if renamed.is_err() {
            // The first error is the one to report; a file that stays behind is only litter.
            let _ = fs::remove_file(&temporary);
        }
        renamed.and_then(|()| sync_directory(path))
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
        for (class, &(count, next)) in header.rings.iter().enumerate() {
            store.fill(class, count, next, &mut reader)?;
        }
        reader.expect_checksum("checksum of the images")?;
        Ok(store)
    }

    fn write_to(&self, path: &Path) -> Result<()> {
        let header = encode(self)?;
        let failed = |source| io_error(path, "write", source);
        let mut file = File::create_new(path).map_err(failed)?;
        file.write_all(&header).map_err(failed)?;
        let mut checksum = Checksum::new();
        for piece in self.rings.iter().flat_map(|ring| ring.images.pieces()) {
            checksum.update(piece);
            file.write_all(piece).map_err(failed)?;
        }
        file.write_all(&checksum.value().to_le_bytes())
            .map_err(failed)?;
        file.sync_all()
            .map_err(|source| io_error(path, "sync", source))
    }

    fn fill(
        &mut self,
        class: usize,
        count: usize,
        next: usize,
        reader: &mut Reader<'_>,
    ) -> Result<()> {
        let record = self.image_bytes();
        let at_once = (READ_BYTES / record).max(1).min(count);
        let mut buffer = vec![0; at_once * record];
        let ring = &mut self.rings[class];
        while ring.images.len() < count {
            let images = at_once.min(count - ring.images.len());
            let bytes = &mut buffer[..images * record];
            reader.read(bytes)?;
            for image in bytes.chunks_exact(record) {
                ring.images.put(ring.images.len(), std::iter::once(image))?;
            }
        }
        ring.next = next;
        Ok(())
    }
}

/// A name in the same directory (a rename must not cross file systems) that no other save uses.
fn temporary_beside(path: &Path) -> PathBuf {
    static SAVES: AtomicU64 = AtomicU64::new(0);
    // Relaxed: only the uniqueness of the number matters, not its order with other memory.
    let number = SAVES.fetch_add(1, Ordering::Relaxed);
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}-{number}.tmp", std::process::id()));
    path.with_file_name(name)
}

/// Makes the rename itself durable. Only Unix can open a directory as a file.
fn sync_directory(path: &Path) -> Result<()> {
    if cfg!(unix) {
        let parent = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty());
        let directory = parent.unwrap_or(Path::new("."));
        let synced = File::open(directory).and_then(|directory| directory.sync_all());
        synced.map_err(|source| io_error(directory, "sync", source))?;
    }
    Ok(())
}
