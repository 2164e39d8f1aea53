//! Memory for results, used again and again.
//!
//! Fresh memory is many times slower to fill than memory that was filled before, because the kernel clears
//! every page first. Batches therefore come as [`Bytes`], whose memory returns to a pool on drop and is
//! handed out again, aligned, and in huge pages where it is large. The pool keeps at most [`POOL_BYTES`] of
//! free memory.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

use crate::storage::memory::{Block, HUGE_PAGE};
use vhs_base::error::{Error, Result};
use vhs_base::fork;

/// Free memory that the pool keeps at most, in bytes.
pub const POOL_BYTES: usize = 512 << 20;
/// Smaller results come from the heap, whose allocator recycles them well.
const SMALL: usize = 64 << 10;
/// Smaller results take as much as they need, in steps of [`SMALL`]; larger ones come in huge pages.
const LARGE: usize = HUGE_PAGE / 2;

/// Blocks that nobody uses, the one that was used last at the end. Locked with a pass, so that a fork finds it free.
static FREE: Mutex<Vec<Block>> = Mutex::new(Vec::new());

/// Bytes of a batch: a slice that owns pooled memory.
///
/// ```
/// use vhs_core::pool::Bytes;
/// let mut bytes = Bytes::take("example", 1 << 20)?;
/// bytes.fill(7);
/// let address = bytes.as_ptr();
/// drop(bytes);
/// let again = Bytes::take("example", 1 << 20)?;
/// assert_eq!(again.as_ptr(), address); // the same memory: warm
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Debug)]
pub struct Bytes {
    /// None only while it is being dropped.
    block: Option<Block>,
    len: usize,
}

impl Bytes {
    /// Memory of `len` bytes with unspecified content, to be overwritten.
    ///
    /// # Errors
    /// [`Error::Memory`] under the name `place`.
    pub fn take(place: &'static str, len: usize) -> Result<Self> {
        let refused = || Error::Memory { place, bytes: len };
        if len < SMALL {
            return Ok(Self::from(vec![0; len]));
        }
        let step = if len < LARGE { SMALL } else { HUGE_PAGE };
        let bytes = len.checked_next_multiple_of(step).ok_or_else(refused)?;
        let block = match recycled(bytes) {
            Some(block) => block,
            None => Block::anonymous(bytes).map_err(|_| refused())?,
        };
        Ok(Self {
            block: Some(block),
            len,
        })
    }
}

/// The smallest free block that is large enough without being twice as large.
fn recycled(bytes: usize) -> Option<Block> {
    let _pass = fork::enter();
    let mut free = FREE.lock().unwrap_or_else(PoisonError::into_inner);
    let fits = |block: &&Block| (bytes..2 * bytes).contains(&block.bytes().len());
    let best = free
        .iter()
        .filter(fits)
        .map(|block| block.bytes().len())
        .min()?;
    let place = free.iter().rposition(|block| block.bytes().len() == best)?;
    Some(free.remove(place))
}

impl Drop for Bytes {
    fn drop(&mut self) {
        let Some(block @ Block::Mapped(_)) = self.block.take() else {
            return;
        };
        let _pass = fork::enter();
        let mut free = FREE.lock().unwrap_or_else(PoisonError::into_inner);
        free.push(block);
        let mut kept: usize = free.iter().map(|block| block.bytes().len()).sum();
        while kept > POOL_BYTES {
            kept -= free.remove(0).bytes().len();
        }
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.block
            .as_ref()
            .map_or(&[], |block| &block.bytes()[..self.len])
    }
}

impl DerefMut for Bytes {
    fn deref_mut(&mut self) -> &mut [u8] {
        let len = self.len;
        self.block
            .as_mut()
            .map_or(&mut [], |block| &mut block.bytes_mut()[..len])
    }
}

impl From<Vec<u8>> for Bytes {
    fn from(items: Vec<u8>) -> Self {
        let len = items.len();
        Self {
            block: Some(Block::Heap(items)),
            len,
        }
    }
}

impl Default for Bytes {
    fn default() -> Self {
        Self::from(Vec::new())
    }
}

impl Clone for Bytes {
    fn clone(&self) -> Self {
        let Ok(mut copy) = Self::take("clone", self.len) else {
            return Self::from(self.to_vec());
        };
        copy.copy_from_slice(self);
        copy
    }
}

impl<T: AsRef<[u8]> + ?Sized> PartialEq<T> for Bytes {
    fn eq(&self, other: &T) -> bool {
        **self == *other.as_ref()
    }
}

impl AsRef<[u8]> for Bytes {
    fn as_ref(&self) -> &[u8] {
        self
    }
}
