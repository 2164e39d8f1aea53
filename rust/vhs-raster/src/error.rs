//! Everything the renderer can refuse.

/// Why a scene, a pose or an output array was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An array does not have the length that its meaning asks for.
    #[error("{what}: expected {expected} values, got {got}")]
    Length {
        /// What the array holds.
        what: &'static str,
        /// Length that was needed.
        expected: usize,
        /// Length that was given.
        got: usize,
    },
    /// A number is NaN or infinite where a picture needs a finite one.
    #[error("{what} {index}: expected finite numbers, got NaN or infinity")]
    NotFinite {
        /// What the number belongs to.
        what: &'static str,
        /// Which one of them, counted from 0.
        index: usize,
    },
    /// An index points past the end of its table.
    #[error("{what} index {index}: expected less than {len}")]
    Index {
        /// What is being pointed at.
        what: &'static str,
        /// The index that was given.
        index: usize,
        /// Length of the table.
        len: usize,
    },
    /// A value lies outside the range it may have.
    #[error("{what}: expected {expected}, got {got}")]
    Range {
        /// What the value is.
        what: &'static str,
        /// The range, in words.
        expected: &'static str,
        /// The value, as text.
        got: String,
    },
    /// The scene asks for something this renderer does not draw.
    #[error("not drawn by this renderer: {what}")]
    Unsupported {
        /// The thing that is not drawn.
        what: String,
    },
}

/// Short for a result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Checks the length of an array.
pub(crate) fn check_len(what: &'static str, expected: usize, got: usize) -> Result<()> {
    if expected == got {
        Ok(())
    } else {
        Err(Error::Length {
            what,
            expected,
            got,
        })
    }
}
