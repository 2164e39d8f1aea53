//! How long to yield before sleeping.
//!
//! A yield costs a microsecond and hands the core to whoever has work, which with more processes than cores is exactly
//! what is wanted; falling asleep and being woken costs 10 to 50. But a yield to a process that computes and never yields
//! back costs its whole time slice, milliseconds, where a sleeper would have been woken at once. So yields are bounded in
//! time, and two things turn them off for a while: one that took too long (somebody computes: off for a time, doubling
//! while that goes on), and a wait that they did not end (what is waited for takes long: off for some waits, doubling).

use std::thread;
use std::time::Duration;

use crate::bell::{Bell, Count};
use crate::clock::monotonic_ns;

/// Time to spend yielding before the first sleep of a wait, in ns.
const PATIENCE_NS: u64 = 100_000;
/// A yield this long went to somebody who computes, in ns; one to a few waiting processes takes a tenth of it.
const SLOW_YIELD_NS: u64 = 300_000;
/// Time without yields after a slow one, in ns: at first, and at most. A slice of 3 ms lost in 2 s is nothing.
const SHORTEST_BAN_NS: u64 = 50_000_000;
const LONGEST_BAN_NS: u64 = 2_000_000_000;
/// Most waits in a row without yields after yields that were in vain.
const MOST_SKIPPED: u32 = 64;

/// One waiter's memory of how its waits ended.
#[derive(Debug, Default)]
pub(crate) struct Waiter {
    /// No yields before this time of the monotonic clock, in ns.
    banned_until_ns: u64,
    /// How long the last ban was, in ns.
    ban_ns: u64,
    /// Waits still to begin with sleep.
    skip: u32,
    /// How many there were after the last wait that yields did not end.
    last_skip: u32,
}

/// A wait under way.
#[derive(Debug)]
pub(crate) struct Wait {
    began_ns: u64,
    may_yield: bool,
    has_yielded: bool,
}

impl Waiter {
    pub(crate) fn begin(&mut self) -> Wait {
        let began_ns = monotonic_ns();
        let may_yield = self.skip == 0 && began_ns >= self.banned_until_ns;
        self.skip = self.skip.saturating_sub(1);
        Wait {
            began_ns,
            may_yield,
            has_yielded: false,
        }
    }

    /// Lets time pass: one yield, or one sleep until the bell reaches `target` or `limit` is over.
    pub(crate) fn pass(&mut self, wait: &mut Wait, bell: &Bell, target: Count, limit: Duration) {
        if !wait.may_yield {
            bell.sleep_until(target, limit);
            return;
        }
        let before_ns = monotonic_ns();
        thread::yield_now();
        let after_ns = monotonic_ns();
        wait.has_yielded = true;
        if after_ns - before_ns > SLOW_YIELD_NS {
            wait.may_yield = false;
            self.ban(after_ns);
        } else if after_ns - wait.began_ns > PATIENCE_NS {
            wait.may_yield = false;
            self.last_skip = (self.last_skip * 2).clamp(1, MOST_SKIPPED);
            self.skip = self.last_skip;
        }
    }

    /// Whether a foreign process keeps this thread's core busy, as far as its yields tell.
    pub(crate) fn is_crowded(&self) -> bool {
        self.ban_ns != 0 && monotonic_ns() < self.banned_until_ns
    }

    /// What was waited for has come.
    pub(crate) fn end(&mut self, wait: &Wait) {
        if wait.may_yield && wait.has_yielded {
            self.last_skip = 0;
        }
    }

    /// Turns yields off: for twice as long as the last time, unless that was long ago.
    fn ban(&mut self, now_ns: u64) {
        let is_again = now_ns - self.banned_until_ns < self.ban_ns;
        let ban_ns = if is_again { self.ban_ns * 2 } else { 0 };
        self.ban_ns = ban_ns.clamp(SHORTEST_BAN_NS, LONGEST_BAN_NS);
        self.banned_until_ns = now_ns + self.ban_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bans_double_while_slow_yields_go_on_and_start_over_after_a_pause() {
        let mut waiter = Waiter::default();
        let mut now_ns = 10 * LONGEST_BAN_NS;
        let mut bans = Vec::new();
        for _ in 0..8 {
            waiter.ban(now_ns);
            bans.push(waiter.ban_ns);
            now_ns = waiter.banned_until_ns + 1_000_000;
        }
        assert_eq!(bans[..3], [50_000_000, 100_000_000, 200_000_000]);
        assert_eq!(bans[7], LONGEST_BAN_NS);
        waiter.ban(now_ns + 2 * LONGEST_BAN_NS);
        assert_eq!(waiter.ban_ns, SHORTEST_BAN_NS);
    }

    #[test]
    fn a_banned_wait_sleeps_at_once() {
        let mut waiter = Waiter::default();
        waiter.ban(monotonic_ns());
        assert!(!waiter.begin().may_yield);
    }
}
