//! Fields in the head of a file: each a word of its type, what it comes with, its stack and dimensions; the bytes of
//! its name; its shape; its name, filled up to whole words by zeros.

use super::item;
use crate::buffer::field::{Field, MAX_FIELDS, MAX_NAME, Per};
use crate::item::Item;
use crate::storage::files::{MAX_DIMENSIONS, MAX_SIZE, Reader};
use crate::storage::saves::push_words;
use vhs_base::error::Result;

/// Words that a field takes.
pub(super) const fn words(field: &Field) -> usize {
    2 + field.shape.len() + field.name.len().div_ceil(8)
}

pub(super) fn write(field: &Field, head: &mut Vec<u8>) {
    let (item, per) = (field.item as u64, field.per as u64);
    let kinds = item | per << 8 | u64::from(field.is_stacked) << 16;
    let dimensions = field.shape.len() as u64;
    push_words(head, [kinds | dimensions << 32, field.name.len() as u64]);
    push_words(head, field.shape.iter().map(|&size| size as u64));
    head.extend(field.name.as_bytes());
    head.resize(head.len().next_multiple_of(8), 0);
}

pub(super) fn read(reader: &mut Reader<'_>, count: u64) -> Result<Vec<Field>> {
    let count = reader.number("fields", count, 0, MAX_FIELDS)?;
    (0..count).map(|_| read_one(reader)).collect()
}

fn read_one(reader: &mut Reader<'_>) -> Result<Field> {
    let first = reader.words(2)?;
    let (kinds, length) = (first[0], first[1]);
    let dimensions = reader.number("dimensions of a field", kinds >> 32, 0, MAX_DIMENSIONS)?;
    let length = reader.number("name of a field", length, 1, MAX_NAME)?;
    let sizes = reader.words(dimensions)?;
    let shape = sizes
        .iter()
        .map(|&size| reader.number("shape of a field", size, 1, MAX_SIZE))
        .collect::<Result<_>>()?;
    let mut name = reader.bytes(length.next_multiple_of(8))?;
    let filling = name.split_off(length).into_iter().max().unwrap_or_default();
    reader.expect("padding", "0", &filling.to_string())?;
    let name = String::from_utf8(name)
        .map_err(|error| reader.damaged("name of a field", "text", &error.to_string()))?;
    let per = match reader.number("what a field comes with", kinds >> 8 & 255, 0, 1)? {
        0 => Per::Observation,
        _ => Per::Step,
    };
    Ok(Field {
        name,
        shape,
        item: item(reader, "type of a field", kinds, Item::ALL.len() as u64)?,
        per,
        is_stacked: reader.number("stack of a field", kinds >> 16 & 0xFFFF, 0, 1)? == 1,
    })
}
