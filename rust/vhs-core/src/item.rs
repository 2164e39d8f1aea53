//! Elements of frames, images and goal vectors: their types, and how many a shape has.

use vhs_base::check;
use vhs_base::error::{Error, Result};

/// The type of the elements of frames or goal vectors. The numbers are those of the file format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
}

impl Item {
    /// Every type, in the order of its number.
    pub const ALL: [Self; 6] = [
        Self::U8,
        Self::I8,
        Self::I32,
        Self::I64,
        Self::F32,
        Self::F64,
    ];

    /// Bytes of one element.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::I32 | Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
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
            Self::U8 => number(bytes, |[byte]| f64::from(byte)),
            Self::I8 => number(bytes, |bytes| f64::from(i8::from_ne_bytes(bytes))),
            Self::I32 => number(bytes, |bytes| f64::from(i32::from_ne_bytes(bytes))),
            Self::I64 => number(bytes, |bytes| i64::from_ne_bytes(bytes) as f64),
            Self::F32 => number(bytes, |bytes| f64::from(f32::from_ne_bytes(bytes))),
            Self::F64 => number(bytes, f64::from_ne_bytes),
        }
    }
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
