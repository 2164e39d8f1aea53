//! Rings of indices: one process pushes, one pops, nobody waits.
//!
//! Source: Lamport's single-producer single-consumer queue, with each end's copy of the other's counter as in `rtrb`: an
//! end reads the shared counter, and so takes the cache line from the other core, only when its copy says full or empty.
//!
//! Invariant: `head <= tail <= head + N` in wrapping arithmetic. The items are atomics, so a misused ring can give wrong
//! indices but never undefined behaviour; whoever pops an index still has to claim its slot.

use crate::sync::{AtomicU32, Line, Ordering};

/// A ring for at most `N` indices, a power of two.
#[repr(C)]
#[derive(Debug)]
pub struct Ring<const N: usize> {
    /// Indices ever pushed, wrapping; written by the producer alone.
    tail: Line<AtomicU32>,
    /// Indices ever popped, wrapping; written by the consumer alone.
    head: Line<AtomicU32>,
    items: [AtomicU32; N],
}

/// The pushing end's own knowledge; there must be one at a time.
#[derive(Debug, Default)]
pub struct Producer {
    tail: u32,
    /// Never ahead of the shared `head`: the ring may look fuller than it is, never emptier.
    head_seen: u32,
}

/// The popping end's own knowledge; there must be one at a time.
#[derive(Debug, Default)]
pub struct Consumer {
    head: u32,
    /// Never ahead of the shared `tail`: the ring may look emptier than it is, never fuller.
    tail_seen: u32,
}

impl<const N: usize> Ring<N> {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "checked to be at most 2^31"
    )]
    const SIZE: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 31, "N: a power of two");
        N as u32
    };

    /// An empty ring.
    #[must_use]
    pub fn new() -> Self {
        Self {
            tail: Line(AtomicU32::new(0)),
            head: Line(AtomicU32::new(0)),
            items: std::array::from_fn(|_| AtomicU32::new(0)),
        }
    }

    /// Empties the ring for two new ends. Only for who knows that no end is in use: the supervisor, after a death.
    pub fn clear(&self) -> (Producer, Consumer) {
        self.tail.0.store(0, Ordering::Relaxed);
        self.head.0.store(0, Ordering::Relaxed);
        (Producer::default(), Consumer::default())
    }

    /// Indices ever pushed since the ring was last empty and new, wrapping.
    #[must_use]
    pub fn pushed(&self) -> u32 {
        // Acquire: what the producer wrote before the push is seen with it.
        self.tail.0.load(Ordering::Acquire)
    }

    fn item(&self, counter: u32) -> &AtomicU32 {
        &self.items[(counter & (Self::SIZE - 1)) as usize]
    }
}

impl<const N: usize> Default for Ring<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl Producer {
    /// Puts an index in; false, with nothing changed, when the ring is full.
    pub fn push<const N: usize>(&mut self, ring: &Ring<N>, index: u32) -> bool {
        if self.tail.wrapping_sub(self.head_seen) == Ring::<N>::SIZE {
            // Acquire: the consumer has read the item that is about to be overwritten.
            self.head_seen = ring.head.0.load(Ordering::Acquire);
            if self.tail.wrapping_sub(self.head_seen) == Ring::<N>::SIZE {
                return false;
            }
        }
        ring.item(self.tail).store(index, Ordering::Relaxed);
        self.tail = self.tail.wrapping_add(1);
        // Release: who sees the new tail sees the item, and all that was written before the push.
        ring.tail.0.store(self.tail, Ordering::Release);
        true
    }
}

impl Consumer {
    /// Takes the oldest index out; `None` when the ring is empty.
    pub fn pop<const N: usize>(&mut self, ring: &Ring<N>) -> Option<u32> {
        if self.head == self.tail_seen {
            // Acquire: pairs with the Release of `push`.
            self.tail_seen = ring.tail.0.load(Ordering::Acquire);
            if self.head == self.tail_seen {
                return None;
            }
        }
        let index = ring.item(self.head).load(Ordering::Relaxed);
        self.head = self.head.wrapping_add(1);
        // Release: the item has been read before its place is given back.
        ring.head.0.store(self.head, Ordering::Release);
        Some(index)
    }
}
