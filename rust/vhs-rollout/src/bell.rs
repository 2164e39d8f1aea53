//! Bells: how one process sleeps until others have something for it, without a lost wake and without `SeqCst`.
//!
//! One word holds a count of strokes and a flag, "asleep". A striker adds a stroke, a sleeper sets the flag, and both are
//! read-modify-writes of the same word: whichever comes second sees the first. So either the striker sees the flag and
//! wakes, or the sleeper sees the stroke (and, by Acquire, all that was published before it) and stays awake. The futex
//! compares the whole word, which closes the gap between setting the flag and falling asleep.
//!
//! The sleeper also says at which count it wants to be woken: a learner that waits for 64 environments is not woken 64
//! times. What must wake it whatever it waits for is an alarm, a flag of its own: as a mere stroke it could fall between
//! the owner's last look and its sleep, and be slept over.

use std::time::Duration;

use crate::sync::{AtomicU32, Ordering, Parking};

/// The word's lowest bit: its owner sleeps, or is about to.
const ASLEEP: u32 = 1;
/// The second bit: something happened that ends the next sleep, or the present one, at once.
const ALARM: u32 = 2;
/// One stroke; the count is the upper 30 bits, wrapping.
const STROKE: u32 = 4;

/// A bell with one owner, who sleeps, and any number of strikers.
#[repr(C, align(128))]
#[derive(Debug, Default)]
pub struct Bell {
    word: AtomicU32,
    /// Count at which the sleeper wants to be woken; valid while ASLEEP is set, in units of the word.
    wake_at: AtomicU32,
    parking: Parking,
}

/// A count of strokes, to be compared by [`Bell::sleep_until`] alone: it wraps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count(u32);

impl Count {
    /// The count after `strokes` more; less than 2^29, so that wrapping cannot confuse.
    #[must_use]
    pub const fn plus(self, strokes: u32) -> Self {
        Self(self.0.wrapping_add(strokes.wrapping_mul(STROKE)))
    }

    const fn has_reached(self, target: Self) -> bool {
        self.0.wrapping_sub(target.0) < u32::MAX / 2
    }

    const fn of(word: u32) -> Self {
        Self(word & !(ASLEEP | ALARM))
    }
}

impl Bell {
    /// A silent bell.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The strokes so far. Acquire: what was published before them is visible.
    #[must_use]
    pub fn count(&self) -> Count {
        Count::of(self.word.load(Ordering::Acquire))
    }

    /// One stroke, after something was published; wakes the owner if it sleeps and wants no more than this.
    pub fn strike(&self) {
        // Release publishes what the owner will look for; Acquire shows the `wake_at` that came with the flag.
        let before = self.word.fetch_add(STROKE, Ordering::AcqRel);
        if before & ASLEEP == 0 {
            return;
        }
        let target = Count(self.wake_at.load(Ordering::Relaxed));
        if Count::of(before).plus(1).has_reached(target) {
            self.rouse();
        }
    }

    /// Ends the owner's present or next sleep, after something was published that it must see: a death, an end.
    pub fn alarm(&self) {
        self.word.fetch_or(ALARM, Ordering::AcqRel);
        // Whatever the flag says: a striker may have died after it took the flag and before it woke the sleeper.
        self.parking.wake(&self.word);
    }

    /// Sleeps until the count reaches `target`, an alarm, or `limit`; may wake early for no reason. The owner's call.
    pub fn sleep_until(&self, target: Count, limit: Duration) {
        self.wake_at.store(target.0, Ordering::Relaxed);
        let word = self.word.fetch_or(ASLEEP, Ordering::AcqRel) | ASLEEP;
        if word & ALARM == 0 && !Count::of(word).has_reached(target) {
            self.parking.wait(&self.word, word, limit);
        }
        // Takes an alarm with it: the owner looks for its cause next, and Acquire shows that.
        self.word.fetch_and(!(ASLEEP | ALARM), Ordering::AcqRel);
    }

    /// Silences the bell for a new owner. Only for who knows that the old one is dead, perhaps in its sleep.
    pub fn clear(&self) {
        self.word.fetch_and(!(ASLEEP | ALARM), Ordering::AcqRel);
    }

    /// Takes the flag and wakes. Of several strikers only the one that takes the flag pays for the system call.
    fn rouse(&self) {
        if self.word.fetch_and(!ASLEEP, Ordering::AcqRel) & ASLEEP != 0 {
            self.parking.wake(&self.word);
        }
    }
}
