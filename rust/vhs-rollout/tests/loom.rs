//! Models of the lock-free parts: every interleaving of a few steps, races left open.
//!
//! Run by `make loom`: `RUSTFLAGS="--cfg loom" cargo test -p vhs-rollout --test loom --release`. Loom checks Acquire and
//! Release but not load buffering; the stress tests run the same code on real threads and processes.
#![cfg(loom)]
#![allow(clippy::unwrap_used, reason = "a panic is how a model fails")]

use std::time::Duration;

use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU32, Ordering};
use loom::thread;
use vhs_rollout::bell::Bell;
use vhs_rollout::ring::{Consumer, Producer, Ring};
use vhs_rollout::slot::{Answer, Command, Epoch, Slot, State};

/// A sleep without an end: a lost wake is a deadlock, which loom reports.
const FOR_EVER: Duration = Duration::MAX;

/// Bytes that only the holder of a slot may touch: loom panics when two do.
struct Payload(UnsafeCell<u64>);

// SAFETY: that nobody else touches it is what the models check.
unsafe impl Sync for Payload {}

impl Payload {
    fn new() -> Self {
        Self(UnsafeCell::new(0))
    }

    fn write(&self, value: u64) {
        // SAFETY: loom checks that nobody else holds it.
        self.0.with_mut(|place| unsafe { *place = value });
    }

    fn read(&self) -> u64 {
        // SAFETY: loom checks that nobody writes it.
        self.0.with(|place| unsafe { *place })
    }
}

/// `model` with at most three preemptions: beyond that nothing new has ever been found, and it takes hours.
fn explore(model: impl Fn() + Send + Sync + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(3);
    builder.check(model);
}

#[test]
fn a_ring_of_one_gives_every_index_once_and_in_order() {
    explore(|| {
        let ring = Arc::new(Ring::<1>::new());
        let theirs = Arc::clone(&ring);
        let pusher = thread::spawn(move || {
            let mut end = Producer::default();
            for index in 1..=2 {
                while !end.push(&theirs, index) {
                    thread::yield_now();
                }
            }
        });
        let mut end = Consumer::default();
        for expected in 1..=2 {
            let index = loop {
                match end.pop(&ring) {
                    Some(index) => break index,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(index, expected);
        }
        pusher.join().unwrap();
        assert_eq!(end.pop(&ring), None);
    });
}

#[test]
fn what_was_written_before_a_push_is_seen_after_the_pop() {
    explore(|| {
        let shared = Arc::new((Ring::<2>::new(), Payload::new()));
        let theirs = Arc::clone(&shared);
        let pusher = thread::spawn(move || {
            theirs.1.write(42);
            assert!(Producer::default().push(&theirs.0, 7));
        });
        // No other synchronisation: the pop may come first, and then it must find nothing.
        if let Some(index) = Consumer::default().pop(&shared.0) {
            assert_eq!((index, shared.1.read()), (7, 42));
        }
        pusher.join().unwrap();
    });
}

#[test]
fn a_slot_goes_round_and_its_bytes_have_one_holder() {
    explore(|| {
        let shared = Arc::new((Slot::new(), Payload::new()));
        let theirs = Arc::clone(&shared);
        let worker = thread::spawn(move || {
            let epoch = Epoch::default();
            let command = loop {
                match theirs.0.claim(epoch) {
                    Ok(command) => break command,
                    Err(_) => thread::yield_now(),
                }
            };
            let action = theirs.1.read();
            theirs.1.write(action + 1);
            let answer = Answer {
                version: command.version,
                reward: 0.5,
                ..Answer::default()
            };
            theirs.0.commit(epoch, &answer).unwrap();
        });
        shared.1.write(10);
        let command = Command {
            version: 3,
            ..Command::default()
        };
        shared.0.ask(&command).unwrap();
        let answer = loop {
            match shared.0.take(Epoch::default()) {
                Ok(answer) => break answer,
                Err(_) => thread::yield_now(),
            }
        };
        assert_eq!((answer.version, answer.reward), (3, 0.5));
        assert_eq!(shared.1.read(), 11);
        worker.join().unwrap();
    });
}

#[test]
fn of_two_that_claim_one_slot_one_gets_it() {
    explore(|| {
        let shared = Arc::new((Slot::new(), Payload::new()));
        shared.0.ask(&Command::default()).unwrap();
        let claim = |shared: &(Slot, Payload), mark| {
            let is_mine = shared.0.claim(Epoch::default()).is_ok();
            if is_mine {
                shared.1.write(mark);
            }
            is_mine
        };
        let theirs = Arc::clone(&shared);
        let other = thread::spawn(move || claim(&theirs, 1));
        let here = claim(&shared, 2);
        let there = other.join().unwrap();
        assert!(here ^ there, "held by both or refused to both");
    });
}

#[test]
fn a_worker_of_an_old_epoch_gets_nothing_of_the_new() {
    explore(|| {
        let slot = Arc::new(Slot::new());
        let new = Epoch::default().next();
        slot.ask(&Command::default()).unwrap();
        // SAFETY: the ghost below writes no payload.
        let state = unsafe { slot.reclaim(new, |_| false) };
        assert_eq!(state, State::Asked);
        let theirs = Arc::clone(&slot);
        // What the dead incarnation left behind in a store buffer, as it were: it acts after the reclaim.
        let ghost = thread::spawn(move || {
            let answer = Answer::default();
            (
                theirs.claim(Epoch::default()).is_ok(),
                theirs.commit(Epoch::default(), &answer).is_ok(),
            )
        });
        slot.ask(&Command::default()).unwrap();
        let is_claimed = slot.claim(new).is_ok();
        assert_eq!(ghost.join().unwrap(), (false, false));
        assert!(is_claimed);
        slot.commit(new, &Answer::default()).unwrap();
        slot.take(new).unwrap();
    });
}

#[test]
fn a_sleeper_is_never_forgotten() {
    explore(|| {
        let shared = Arc::new((Bell::new(), AtomicU32::new(0)));
        let theirs = Arc::clone(&shared);
        let striker = thread::spawn(move || {
            theirs.1.store(1, Ordering::Relaxed);
            theirs.0.strike();
        });
        loop {
            let count = shared.0.count();
            if shared.1.load(Ordering::Relaxed) == 1 {
                break;
            }
            shared.0.sleep_until(count.plus(1), FOR_EVER);
        }
        striker.join().unwrap();
    });
}

#[test]
fn a_sleeper_that_waits_for_two_is_woken_by_the_second_of_two_strikers() {
    explore(|| {
        let shared = Arc::new((Bell::new(), [AtomicU32::new(0), AtomicU32::new(0)]));
        let strikers: Vec<_> = (0..2)
            .map(|place| {
                let theirs = Arc::clone(&shared);
                thread::spawn(move || {
                    theirs.1[place].store(1, Ordering::Relaxed);
                    theirs.0.strike();
                })
            })
            .collect();
        loop {
            let count = shared.0.count();
            let found = shared.1.each_ref().map(|mark| mark.load(Ordering::Relaxed));
            let missing = 2 - found.iter().sum::<u32>();
            if missing == 0 {
                break;
            }
            shared.0.sleep_until(count.plus(missing), FOR_EVER);
        }
        for striker in strikers {
            striker.join().unwrap();
        }
    });
}

#[test]
fn an_alarm_wakes_a_sleeper_whatever_it_waits_for() {
    explore(|| {
        let shared = Arc::new((Bell::new(), AtomicU32::new(0)));
        let theirs = Arc::clone(&shared);
        let supervisor = thread::spawn(move || {
            theirs.1.store(1, Ordering::Release);
            theirs.0.alarm();
        });
        loop {
            let count = shared.0.count();
            if shared.1.load(Ordering::Acquire) == 1 {
                break;
            }
            shared.0.sleep_until(count.plus(100), FOR_EVER);
        }
        supervisor.join().unwrap();
    });
}

#[test]
fn a_step_goes_there_and_back_with_both_ends_asleep() {
    // Everything together: the learner's strike races with the worker's falling asleep, and the other way round.
    explore(|| {
        let shared = Arc::new((
            (Slot::new(), Payload::new()),
            (Ring::<1>::new(), Bell::new()),
            (Ring::<1>::new(), Bell::new()),
        ));
        let theirs = Arc::clone(&shared);
        let worker = thread::spawn(move || {
            let ((slot, payload), (commands, bell), (answers, learner)) = &*theirs;
            let mut end = Consumer::default();
            let env = loop {
                let count = bell.count();
                match end.pop(commands) {
                    Some(env) => break env,
                    None => bell.sleep_until(count.plus(1), FOR_EVER),
                }
            };
            slot.claim(Epoch::default()).unwrap();
            payload.write(payload.read() + 1);
            slot.commit(Epoch::default(), &Answer::default()).unwrap();
            assert!(Producer::default().push(answers, env));
            learner.strike();
        });
        let ((slot, payload), (commands, bell), (answers, learner)) = &*shared;
        payload.write(1);
        slot.ask(&Command::default()).unwrap();
        assert!(Producer::default().push(commands, 5));
        bell.strike();
        let mut end = Consumer::default();
        let env = loop {
            let count = learner.count();
            match end.pop(answers) {
                Some(env) => break env,
                None => learner.sleep_until(count.plus(1), FOR_EVER),
            }
        };
        slot.take(Epoch::default()).unwrap();
        assert_eq!((env, payload.read()), (5, 2));
        worker.join().unwrap();
    });
}
