//! How long to yield before sleeping.
//!
//! A yield costs a microsecond and hands the core to whoever has work, which with more processes than cores is exactly
//! what is wanted; falling asleep and being woken costs 10 to 50. But a yield to a foreign process that never yields back
//! costs its whole time slice, milliseconds, where a sleeper would have been woken at once. So: a bounded time of yields,
//! ended by the first that took too long, and after a wait that yielding did not end, several waits without any.

use std::thread;
use std::time::{Duration, Instant};

use crate::bell::{Bell, Count};

/// Time to spend yielding before the first sleep of a wait.
const PATIENCE: Duration = Duration::from_micros(100);
/// A yield this long went to somebody who computes: not worth repeating.
const SLOW_YIELD: Duration = Duration::from_micros(150);
/// Most waits in a row that sleep at once after yields that were in vain.
const MAX_PENANCE: u32 = 64;

/// One waiter's memory of how its waits ended.
#[derive(Debug, Default)]
pub(crate) struct Waiter {
    /// Waits still to begin with sleep.
    penance: u32,
    /// How many more after the next vain one, doubling up to [`MAX_PENANCE`].
    next_penance: u32,
}

/// A wait under way.
#[derive(Debug)]
pub(crate) struct Wait {
    began: Instant,
    may_yield: bool,
}

impl Waiter {
    pub(crate) fn begin(&mut self) -> Wait {
        let may_yield = self.penance == 0;
        self.penance = self.penance.saturating_sub(1);
        Wait {
            began: Instant::now(),
            may_yield,
        }
    }

    /// Lets time pass: one yield, or one sleep until the bell reaches `target` or `limit` is over.
    pub(crate) fn pass(&mut self, wait: &mut Wait, bell: &Bell, target: Count, limit: Duration) {
        if !wait.may_yield {
            bell.sleep_until(target, limit);
            return;
        }
        let before = wait.began.elapsed();
        thread::yield_now();
        let after = wait.began.elapsed();
        if after > PATIENCE || after.saturating_sub(before) > SLOW_YIELD {
            wait.may_yield = false;
            self.next_penance = (self.next_penance * 2).clamp(1, MAX_PENANCE);
            self.penance = self.next_penance;
        }
    }

    /// What was waited for has come.
    pub(crate) fn end(&mut self, wait: &Wait) {
        if wait.may_yield {
            self.next_penance = 0;
        }
    }
}
