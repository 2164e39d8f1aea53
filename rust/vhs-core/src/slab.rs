//! Fixed-size byte records in memory that grows as it fills and never moves a full chunk.
//!
//! Records are numbered 0..len. Chunks are about a megabyte: small enough that a nearly empty
//! structure stays small, large enough that a full one is a handful of allocations.

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

    /// Makes room for `count` more records, so that as many `put`s after the last cannot fail.
    pub(crate) fn reserve(&mut self, count: usize) -> Result<()> {
        let end = self.len + count;
        for index in self.len / self.per_chunk..end.div_ceil(self.per_chunk) {
            let records = (end - index * self.per_chunk).min(self.per_chunk);
            self.reserve_chunk(index, records * self.record_bytes)?;
        }
        Ok(())
    }

    /// Makes the chunk, where it is missing, and lets it hold `bytes` in all.
    fn reserve_chunk(&mut self, index: usize, bytes: usize) -> Result<()> {
        if index == self.chunks.len() {
            self.chunks
                .try_reserve(1)
                .map_err(|_| memory(size_of::<Vec<u8>>()))?;
            self.chunks.push(Vec::new());
        }
        let chunk = &mut self.chunks[index];
        if chunk.capacity() < bytes {
            // Doubling inside the chunk keeps a structure of many small, nearly empty slabs small.
            let limit = self.per_chunk * self.record_bytes;
            let wanted = (2 * chunk.capacity()).clamp(bytes, limit) - chunk.len();
            chunk
                .try_reserve_exact(wanted)
                .map_err(|_| memory(wanted))?;
        }
        Ok(())
    }

    /// Writes a record from its parts, over the one at `index` or, where `index` is `len`, after
    /// the last.
    ///
    /// The parts must add up to one record.
    pub(crate) fn put<'a>(
        &mut self,
        index: usize,
        parts: impl Iterator<Item = &'a [u8]>,
    ) -> Result<()> {
        if index == self.len {
            self.reserve(1)?;
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
