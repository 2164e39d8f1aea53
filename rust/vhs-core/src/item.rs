//! Elements of frames, images and goal vectors: their types, and how many a shape has.

use vhs_base::check;
use vhs_base::error::{Error, Result};

/// The type of the elements of frames or goal vectors. The numbers are those of the file format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
#[non_exhaustive]
pub enum Item {
    /// Unsigned bytes: images.
    #[default]
    U8 = 0,
    /// Signed bytes.
    I8 = 1,
    /// 32-bit integers.
    I32 = 2,
    /// 64-bit integers.
    I64 = 3,
    /// Single precision.
    F32 = 4,
    /// Double precision.
    F64 = 5,
    /// Unsigned 16-bit integers, as of depth cameras.
    U16 = 6,
    /// 16-bit integers.
    I16 = 7,
    /// Unsigned 32-bit integers.
    U32 = 8,
    /// Unsigned 64-bit integers.
    U64 = 9,
    /// Half precision.
    F16 = 10,
    /// Truth values, a byte each.
    Bool = 11,
}

impl Item {
    /// Every type, in the order of its number.
    pub const ALL: [Self; 12] = [
        Self::U8,
        Self::I8,
        Self::I32,
        Self::I64,
        Self::F32,
        Self::F64,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::U64,
        Self::F16,
        Self::Bool,
    ];

    /// Bytes of one element.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 | Self::Bool => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Sum of the squared differences of two arrays of this type, of the same length.
    pub(crate) fn squared_distance(self, here: &[u8], there: &[u8]) -> f64 {
        let pairs = here
            .chunks_exact(self.bytes())
            .zip(there.chunks_exact(self.bytes()));
        pairs
            .map(|(here, there)| (self.read(here) - self.read(there)).powi(2))
            .sum()
    }

    /// An element, from its native bytes, as a double. Bytes of another length give 0.
    #[expect(
        clippy::cast_precision_loss,
        reason = "distances of goals need no 64-bit integers exactly"
    )]
    fn read(self, bytes: &[u8]) -> f64 {
        match self {
            Self::U8 | Self::Bool => number(bytes, |[byte]| f64::from(byte)),
            Self::I8 => number(bytes, |bytes| f64::from(i8::from_ne_bytes(bytes))),
            Self::I32 => number(bytes, |bytes| f64::from(i32::from_ne_bytes(bytes))),
            Self::I64 => number(bytes, |bytes| i64::from_ne_bytes(bytes) as f64),
            Self::F32 => number(bytes, |bytes| f64::from(f32::from_ne_bytes(bytes))),
            Self::F64 => number(bytes, f64::from_ne_bytes),
            Self::U16 => number(bytes, |bytes| f64::from(u16::from_ne_bytes(bytes))),
            Self::I16 => number(bytes, |bytes| f64::from(i16::from_ne_bytes(bytes))),
            Self::U32 => number(bytes, |bytes| f64::from(u32::from_ne_bytes(bytes))),
            Self::U64 => number(bytes, |bytes| u64::from_ne_bytes(bytes) as f64),
            Self::F16 => number(bytes, |bytes| half(u16::from_ne_bytes(bytes))),
        }
    }
}

/// The value of a number in half precision (IEEE 754 binary16), from its bits.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2.0_f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2.0_f64.powi(exponent - 25),
    };
    if bits >> 15 == 0 { size } else { -size }
}

fn number<const N: usize>(bytes: &[u8], read: impl Fn([u8; N]) -> f64) -> f64 {
    bytes.try_into().map_or(0.0, read)
}

/// Elements of an array of this shape; refuses shapes without content.
pub(crate) fn volume(field: &'static str, shape: &[usize]) -> Result<usize> {
    if shape.is_empty() || shape.contains(&0) {
        let expected = "one or more sizes, each at least 1".into();
        return Err(Error::Argument {
            field,
            expected,
            got: format!("{shape:?}"),
        });
    }
    check::product(field, shape)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_is_read_to_its_value() {
        let known = [
            (0x0000, 0.0),
            (0x3C00, 1.0),
            (0xC000, -2.0),
            (0x7BFF, 65504.0),
            (0x0001, 2.0_f64.powi(-24)),
            (0x0400, 2.0_f64.powi(-14)),
            (0x3555, 0.333_251_953_125),
            (0xFC00, f64::NEG_INFINITY),
        ];
        for (bits, value) in known {
            assert_eq!(half(bits).to_bits(), f64::to_bits(value), "{bits:x}");
        }
        assert!(half(0x7E00).is_nan());
    }

    #[test]
    fn distances_are_those_of_the_numbers() {
        for item in Item::ALL {
            let (one, zero) = match item {
                Item::F16 => (0x3C00_u16.to_ne_bytes().to_vec(), vec![0; 2]),
                Item::F32 => (1.0_f32.to_ne_bytes().to_vec(), vec![0; 4]),
                Item::F64 => (1.0_f64.to_ne_bytes().to_vec(), vec![0; 8]),
                _ => {
                    let mut one = vec![0; item.bytes()];
                    let place = if cfg!(target_endian = "little") {
                        0
                    } else {
                        item.bytes() - 1
                    };
                    one[place] = 1;
                    (one, vec![0; item.bytes()])
                }
            };
            assert!(
                (item.squared_distance(&one, &zero) - 1.0).abs() < 1e-12,
                "{item:?}"
            );
        }
    }
}
