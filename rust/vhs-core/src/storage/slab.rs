//! Fixed-size byte records in memory that grows as it fills and never moves a full block.
//!
//! Records are numbered 0..len. The first ones lie in a *start* block: about a megabyte of heap that doubles
//! as it fills, so that a structure of many small, nearly empty slabs stays small; or the mapped records of a
//! loaded file. The others lie in mapped *chunks* in huge pages, or in a scratch file.

use std::fs::File;
use std::io;
use std::sync::Arc;

use crate::storage::memory::{Block, HUGE_PAGE};
use crate::storage::packed::Packed;
use vhs_base::error::{Error, Result};

/// Bytes of the start block of a slab in memory, unless one record is larger.
const START_BYTES: usize = 1 << 20;
/// Bytes of a chunk, unless one record is larger. Large, for each is a mapping and systems allow some 65,000.
const CHUNK_BYTES: usize = 32 << 20;

/// Where chunks come from.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    Memory,
    /// A file that nothing else writes to, cut into chunks.
    File(Arc<File>),
    /// Memory, where each record is compressed.
    Packed,
}

/// See the module documentation.
#[derive(Debug)]
pub(crate) struct Slab {
    /// Bytes of one record, at least 1.
    record_bytes: usize,
    start: Block,
    /// Records that the start block can hold.
    start_records: usize,
    /// Bytes of a chunk: a multiple of a huge page.
    chunk_bytes: usize,
    /// Records in a chunk, at least 1.
    per_chunk: usize,
    chunks: Vec<Block>,
    /// Records stored.
    len: usize,
    source: Source,
    /// Where records lie that are compressed, in place of blocks.
    packed: Option<Packed>,
}

impl Slab {
    /// An empty slab that will hold at most `capacity` records.
    pub(crate) fn new(record_bytes: usize, capacity: usize, source: Source) -> Self {
        let start_records = match source {
            Source::Memory | Source::Packed => (START_BYTES / record_bytes).max(1),
            Source::File(_) => 0,
        };
        Self::with_start(
            record_bytes,
            capacity,
            source,
            Block::Heap(Vec::new()),
            start_records,
        )
    }

    /// A slab whose first `count` records lie in a mapped part of a file already.
    pub(crate) fn mapped(record_bytes: usize, capacity: usize, start: Block, count: usize) -> Self {
        let mut slab = Self::with_start(record_bytes, capacity, Source::Memory, start, count);
        slab.len = count;
        slab
    }

    fn with_start(
        record_bytes: usize,
        capacity: usize,
        source: Source,
        start: Block,
        start_records: usize,
    ) -> Self {
        let beyond = capacity.saturating_sub(start_records);
        let wanted = beyond.saturating_mul(record_bytes).min(CHUNK_BYTES);
        let chunk_bytes = wanted
            .max(record_bytes)
            .checked_next_multiple_of(HUGE_PAGE)
            .unwrap_or(record_bytes);
        Self {
            record_bytes,
            start,
            start_records,
            chunk_bytes,
            per_chunk: chunk_bytes / record_bytes,
            chunks: Vec::new(),
            len: 0,
            packed: matches!(source, Source::Packed).then(Packed::default),
            source,
        }
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// Bytes set aside for records: those of the heap, and the pages of chunks that are in use.
    pub(crate) fn allocated_bytes(&self) -> usize {
        if let Some(packed) = &self.packed {
            return packed.allocated_bytes();
        }
        let start = match &self.start {
            Block::Heap(items) => items.capacity(),
            Block::Mapped(map) => map.len(),
        };
        let chunks = (0..self.chunks.len()).map(|chunk| {
            let used = self.chunk_len(chunk) * self.record_bytes;
            used.next_multiple_of(HUGE_PAGE).min(self.chunk_bytes)
        });
        start + chunks.sum::<usize>()
    }

    /// The bytes of record `index`, which must be below `len`; as they lie where they are compressed.
    pub(crate) fn get(&self, index: usize) -> &[u8] {
        if let Some(packed) = &self.packed {
            return packed.block(index);
        }
        let (block, start) = match self.place(index) {
            (None, start) => (&self.start, start),
            (Some(chunk), start) => (&self.chunks[chunk], start),
        };
        &block.bytes()[start..start + self.record_bytes]
    }

    /// Whether records must be read, as `get` gives them compressed.
    pub(crate) const fn is_packed(&self) -> bool {
        self.packed.is_some()
    }

    /// Writes record `index`, which must be below `len`.
    pub(crate) fn read(&self, index: usize, out: &mut [u8]) {
        match &self.packed {
            Some(packed) => packed.read(index, out),
            None => out.copy_from_slice(self.get(index)),
        }
    }

    /// Adds record `index` to the end of `out`.
    pub(crate) fn append_to(&self, index: usize, out: &mut Vec<u8>) {
        if !self.is_packed() {
            return out.extend_from_slice(self.get(index));
        }
        let start = out.len();
        out.resize(start + self.record_bytes, 0);
        self.read(index, &mut out[start..]);
    }

    /// Makes room for `count` more records, so that as many `put`s after the last cannot fail.
    pub(crate) fn reserve(&mut self, count: usize) -> Result<()> {
        if self.is_packed() {
            return Ok(());
        }
        let end = self.len + count;
        self.reserve_start(end.min(self.start_records))?;
        let chunks = end
            .saturating_sub(self.start_records)
            .div_ceil(self.per_chunk);
        while self.chunks.len() < chunks {
            let chunk = self.new_chunk().map_err(|source| self.refused(source))?;
            self.chunks.push(chunk);
        }
        Ok(())
    }

    /// Writes a record over the one at `index` or, where `index` is `len`, after the last.
    pub(crate) fn put(&mut self, index: usize, record: &[u8]) -> Result<()> {
        if let Some(packed) = &mut self.packed {
            packed.put(index, record);
            self.len = self.len.max(index + 1);
            return Ok(());
        }
        if index == self.len {
            self.reserve(1)?;
        }
        let (chunk, start) = self.place(index);
        let block = match chunk {
            None => &mut self.start,
            Some(chunk) => &mut self.chunks[chunk],
        };
        match block {
            Block::Heap(items) if index == self.len => items.extend_from_slice(record),
            block => {
                block.bytes_mut()[start..start + self.record_bytes].copy_from_slice(record);
            }
        }
        self.len = self.len.max(index + 1);
        Ok(())
    }

    /// As `put`, of a record of zeros.
    pub(crate) fn put_zeros(&mut self, index: usize) -> Result<()> {
        self.put(index, &vec![0; self.record_bytes])
    }

    /// How many records the file behind it may hold as it is.
    pub(crate) fn records_in_file(&self) -> usize {
        let Source::File(file) = &self.source else {
            return 0;
        };
        let bytes = file.metadata().map_or(0, |found| found.len());
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        bytes / self.chunk_bytes * self.per_chunk
    }

    /// Takes the first records as the file behind it has them.
    pub(crate) fn restore(&mut self, records: usize) -> Result<()> {
        self.reserve(records)?;
        self.len = records;
        Ok(())
    }

    /// Chunk (None: the start block) and first byte of a record.
    const fn place(&self, index: usize) -> (Option<usize>, usize) {
        match index.checked_sub(self.start_records) {
            None => (None, index * self.record_bytes),
            Some(index) => (
                Some(index / self.per_chunk),
                index % self.per_chunk * self.record_bytes,
            ),
        }
    }

    /// Records stored in a chunk.
    fn chunk_len(&self, chunk: usize) -> usize {
        let before = self.start_records + chunk * self.per_chunk;
        self.len.saturating_sub(before).min(self.per_chunk)
    }

    /// Lets the start block hold `records` in all.
    fn reserve_start(&mut self, records: usize) -> Result<()> {
        let (bytes, limit) = (
            records * self.record_bytes,
            self.start_records * self.record_bytes,
        );
        let Block::Heap(items) = &mut self.start else {
            return Ok(());
        };
        if items.capacity() < bytes {
            let wanted = (2 * items.capacity()).clamp(bytes, limit) - items.len();
            items
                .try_reserve_exact(wanted)
                .map_err(|_| memory(wanted))?;
        }
        Ok(())
    }

    fn new_chunk(&self) -> io::Result<Block> {
        match &self.source {
            Source::Memory | Source::Packed => Block::anonymous(self.chunk_bytes),
            Source::File(file) => {
                Block::of_own(file, self.chunks.len() * self.chunk_bytes, self.chunk_bytes)
            }
        }
    }

    fn refused(&self, source: io::Error) -> Error {
        match self.source {
            Source::Memory | Source::Packed => memory(self.chunk_bytes),
            Source::File(_) => Error::Io {
                path: "the backing file".into(),
                call: "grow",
                source,
            },
        }
    }
}

/// Copies the parts one after the other; together they must be as long as `out`, or shorter.
///
/// Plain copies: stores that bypass the cache were measured at 0.93 of them on the same bytes.
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
