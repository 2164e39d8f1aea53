//! Fixed-size byte records in memory that grows as it fills and never moves a full chunk.
//!
//! Records are numbered 0..len. Chunks are about a megabyte: small enough that a nearly empty structure stays small,
//! large enough that a full one is a handful of allocations.

use crate::error::{Error, Result};

/// Bytes in a chunk, unless one record is larger.
const CHUNK_BYTES: usize = 1 << 20;

/// See the module documentation.
#[derive(Debug)]
pub(crate) struct Slab {
    /// Bytes of one record, at least 1.
    record_bytes: usize,
    /// Records in a full chunk, at least 1.
    per_chunk: usize,
    /// All chunks but the last are full.
    chunks: Vec<Vec<u8>>,
    /// Records stored.
    len: usize,
}

impl Slab {
    pub(crate) fn new(record_bytes: usize) -> Self {
        let per_chunk = (CHUNK_BYTES / record_bytes).max(1);
        Self {
            record_bytes,
            per_chunk,
            chunks: Vec::new(),
            len: 0,
        }
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// Bytes set aside for records.
    pub(crate) fn allocated_bytes(&self) -> usize {
        self.chunks.iter().map(Vec::capacity).sum()
    }

    /// The bytes of record `index`, which must be below `len`.
    pub(crate) fn get(&self, index: usize) -> &[u8] {
        let start = index % self.per_chunk * self.record_bytes;
        &self.chunks[index / self.per_chunk][start..start + self.record_bytes]
    }

    /// Makes room for one more record, so that the next `put` at `len` cannot fail.
    pub(crate) fn reserve_one(&mut self) -> Result<()> {
        if self.len.is_multiple_of(self.per_chunk) && self.chunks.len() == self.len / self.per_chunk
        {
            self.chunks
                .try_reserve(1)
                .map_err(|_| memory(size_of::<Vec<u8>>()))?;
            self.chunks.push(Vec::new());
        }
        let (limit, record) = (self.per_chunk * self.record_bytes, self.record_bytes);
        let Some(chunk) = self.chunks.last_mut() else {
            return Ok(());
        };
        if chunk.capacity() - chunk.len() < record {
            // Doubling inside the chunk keeps a structure of many small, nearly empty slabs small.
            let wanted = (2 * chunk.len()).clamp(chunk.len() + record, limit) - chunk.len();
            chunk
                .try_reserve_exact(wanted)
                .map_err(|_| memory(wanted))?;
        }
        Ok(())
    }

    /// Writes a record from its parts, over the one at `index` or, where `index` is `len`, after the last.
    ///
    /// The parts must add up to one record.
    pub(crate) fn put<'a>(
        &mut self,
        index: usize,
        parts: impl Iterator<Item = &'a [u8]>,
    ) -> Result<()> {
        if index == self.len {
            self.reserve_one()?;
            let chunk = &mut self.chunks[index / self.per_chunk];
            parts.for_each(|part| chunk.extend_from_slice(part));
            self.len += 1;
        } else {
            let start = index % self.per_chunk * self.record_bytes;
            let record = &mut self.chunks[index / self.per_chunk][start..start + self.record_bytes];
            copy_parts(parts, record);
        }
        Ok(())
    }

    /// The stored bytes in order of their number, in pieces of at most a chunk.
    pub(crate) fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        self.chunks.iter().map(Vec::as_slice)
    }
}

/// Copies the parts one after the other; together they must be as long as `out`, or shorter.
pub(crate) fn copy_parts<'a>(parts: impl Iterator<Item = &'a [u8]>, mut out: &mut [u8]) {
    for part in parts {
        let (here, rest) = out.split_at_mut(part.len());
        here.copy_from_slice(part);
        out = rest;
    }
}

fn memory(bytes: usize) -> Error {
    Error::Memory {
        place: "image storage",
        bytes,
    }
}
