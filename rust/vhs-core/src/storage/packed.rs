//! Records that are compressed one by one, without loss: LZ4 blocks, each on the heap.
//!
//! Equal records have equal blocks, so that they are compared as they lie. One that does not become smaller is stored
//! as it is.

use lz4_flex::block::{compress_into, decompress_into, get_maximum_output_size};

/// See the module documentation.
#[derive(Debug, Default)]
pub(crate) struct Packed {
    blocks: Vec<Box<[u8]>>,
    /// Bytes of all blocks.
    bytes: usize,
    /// Where a record is compressed before its size is known.
    room: Vec<u8>,
}

impl Packed {
    /// Bytes set aside.
    pub(crate) const fn allocated_bytes(&self) -> usize {
        self.bytes + self.blocks.capacity() * size_of::<Box<[u8]>>()
    }

    /// The block of a record: the record itself where that is as long.
    pub(crate) fn block(&self, index: usize) -> &[u8] {
        &self.blocks[index]
    }

    /// Writes a record, as long as `out`.
    pub(crate) fn read(&self, index: usize, out: &mut [u8]) {
        let block = self.block(index);
        if block.len() == out.len() {
            out.copy_from_slice(block);
            return;
        }
        let unpacked = decompress_into(block, out);
        debug_assert_eq!(unpacked.ok(), Some(out.len()), "what `put` packed");
    }

    /// Puts a record over the one at `index`, or after the last.
    pub(crate) fn put(&mut self, index: usize, record: &[u8]) {
        self.room.resize(get_maximum_output_size(record.len()), 0);
        let packed = compress_into(record, &mut self.room).unwrap_or(record.len());
        let block = if packed < record.len() {
            &self.room[..packed]
        } else {
            record
        };
        self.bytes += block.len();
        let block = block.into();
        match self.blocks.get_mut(index) {
            Some(old) => self.bytes -= std::mem::replace(old, block).len(),
            None => self.blocks.push(block),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_as_they_were() {
        let noise = (0..400_u32).map(|n| n.wrapping_mul(2_654_435_761).to_le_bytes()[3]);
        let records: [Vec<u8>; 4] = [
            vec![7; 400],
            (0..=255).cycle().take(400).collect(),
            noise.collect(),
            vec![7; 400],
        ];
        let mut packed = Packed::default();
        for (index, record) in records.iter().enumerate() {
            packed.put(index, record);
        }
        assert!(packed.block(0).len() < 40, "{:?}", packed.block(0));
        assert_eq!(packed.block(2), records[2]);
        assert_eq!(packed.block(3), packed.block(0));
        packed.put(0, &records[1]);
        let mut out = vec![0; 400];
        for (index, record) in [&records[1], &records[1], &records[2], &records[3]]
            .into_iter()
            .enumerate()
        {
            packed.read(index, &mut out);
            assert_eq!(&out, record);
        }
        let bytes = (0..4).map(|index| packed.block(index).len()).sum::<usize>();
        assert_eq!(packed.bytes, bytes);
    }
}
