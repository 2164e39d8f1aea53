//! Everything that the crates can refuse, in one enum.
//!
//! Invariant: a call that returns an error because of its input has changed nothing. Every message
//! names what was expected and what was found. `vhs-py/src/error.rs` is the only place that maps
//! variants to Python exceptions.

use std::io;
use std::path::PathBuf;

/// What every fallible call returns.
pub type Result<T> = std::result::Result<T, Error>;

/// Everything a call can refuse.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An array does not have the shape that the structure was built for.
    #[error("`{field}`: expected shape {expected:?}, got {got:?}")]
    Shape {
        /// Name of the argument.
        field: &'static str,
        /// Shape the structure was built for.
        expected: Vec<usize>,
        /// Shape that was passed in.
        got: Vec<usize>,
    },
    /// A setting lies outside its range, or a word is not one of those known.
    #[error("`{field}`: expected {expected}, got {got}")]
    Argument {
        /// Name of the argument.
        field: &'static str,
        /// The accepted range or words.
        expected: String,
        /// What was passed in.
        got: String,
    },
    /// A class, goal, interaction, action or stream number is out of range.
    #[error("`{field}`: expected a number in 0..{limit}, got {got} at index {index}")]
    Label {
        /// Name of the argument.
        field: &'static str,
        /// Position in the argument; 0 for a single number.
        index: usize,
        /// One more than the largest accepted number.
        limit: usize,
        /// What was passed in.
        got: i64,
    },
    /// A reward, value or feature is NaN or infinite.
    #[error("`{field}`: expected a finite number, got {got} at index {index}")]
    NonFinite {
        /// Name of the argument.
        field: &'static str,
        /// Position in the argument, counted over the flattened array.
        index: usize,
        /// What was passed in.
        got: f32,
    },
    /// Something was to be sampled from nothing.
    #[error("{place}: expected at least one {item}, found none")]
    Empty {
        /// The structure, and the class where one was named.
        place: String,
        /// What was to be sampled.
        item: &'static str,
    },
    /// A call came in the wrong state of a stream, such as finishing an episode twice.
    #[error("`{call}` on stream {stream}: expected {expected}, found {found}")]
    Protocol {
        /// The refused call.
        call: &'static str,
        /// Stream number.
        stream: usize,
        /// The state in which the call is allowed.
        expected: &'static str,
        /// The state the stream is in.
        found: &'static str,
    },
    /// A step would make an episode longer than the buffer was built for.
    #[error(
        "`append` on stream {stream}: expected at most {limit} steps in an episode, found one more"
    )]
    TooManySteps {
        /// Stream number.
        stream: usize,
        /// `max_episode_steps` of the buffer.
        limit: usize,
    },
    /// The episode was stored once and has made room for newer ones since.
    #[error("episode {id}: expected an id of {oldest} or later, found one already evicted")]
    Evicted {
        /// The id asked for.
        id: u64,
        /// Oldest id that is still stored, or the next one to be given where none is.
        oldest: u64,
    },
    /// No finished episode ever had this id.
    #[error("episode {id}: expected an id below {next}, found one never given")]
    UnknownEpisode {
        /// The id asked for.
        id: i64,
        /// The next id that `finish` will give.
        next: u64,
    },
    /// The allocator refused.
    #[error("{place}: expected room for {bytes} more bytes, found too little memory")]
    Memory {
        /// The structure that wanted to grow.
        place: &'static str,
        /// Size of the refused allocation, in bytes.
        bytes: usize,
    },
    /// The operating system refused to read or write a file.
    #[error("{}: expected to {call} it, found: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted: open, read, write, sync or rename.
        call: &'static str,
        /// The cause.
        source: io::Error,
    },
    /// The call was told to stop, and has changed nothing.
    #[error("expected to go on, found a request to stop")]
    Interrupted,
    /// A file is not one of ours, is cut short or has been altered.
    #[error("{}: `{field}`: expected {expected}, found {found}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Part of the file.
        field: &'static str,
        /// What an intact file has there.
        expected: String,
        /// What this file has there.
        found: String,
    },
}

#[cfg(test)]
mod tests {
    use super::Error;

    /// No wildcard: a new variant does not compile until it is listed here, and then belongs into
    /// `vhs-core/tests/properties/errors.rs`, where each is raised and its message spelled out.
    const fn is_listed(error: &Error) -> bool {
        match error {
            Error::Shape { .. }
            | Error::Argument { .. }
            | Error::Label { .. }
            | Error::NonFinite { .. }
            | Error::Empty { .. }
            | Error::Protocol { .. }
            | Error::TooManySteps { .. }
            | Error::Evicted { .. }
            | Error::UnknownEpisode { .. }
            | Error::Memory { .. }
            | Error::Io { .. }
            | Error::Interrupted
            | Error::Damaged { .. } => true,
        }
    }

    #[test]
    fn the_list_of_variants_is_whole() {
        let error = Error::Memory {
            place: "here",
            bytes: 7,
        };
        assert!(is_listed(&error));
        assert_eq!(
            error.to_string(),
            "here: expected room for 7 more bytes, found too little memory"
        );
    }
}
