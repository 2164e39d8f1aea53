//! Both ends against a naive model on random operations: asks, steps, answers, deaths and ghosts, in one thread.
#![cfg(not(loom))]
#![allow(
    clippy::unwrap_used,
    clippy::cast_ptr_alignment,
    reason = "a panic is how a test fails; payloads are 64-byte aligned"
)]

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use proptest::prelude::*;
use vhs_rollout::flags::{ENDED, FAILED, NOTICE, TERMINATED};
use vhs_rollout::layout::Shape;
use vhs_rollout::learner::{Fate, Learner, Waited};
use vhs_rollout::mapping::Mapping;
use vhs_rollout::slot::{Answer, Command};
use vhs_rollout::worker::{Task, Worker};

const WORKERS: usize = 2;
const EACH: usize = 3;
const ENVS: usize = WORKERS * EACH;

#[derive(Clone, Copy, Debug)]
enum Operation {
    Ask(usize),
    Next(usize),
    /// Worker, which of its claimed environments, flags.
    Commit(usize, usize, u32),
    Take,
    TakeNotices,
    Kill(usize),
}

fn operations() -> impl Strategy<Value = Vec<Operation>> {
    let flags = prop_oneof![Just(0), Just(TERMINATED), Just(FAILED)];
    let one = prop_oneof![
        6 => (0..ENVS + 1).prop_map(Operation::Ask),
        6 => (0..WORKERS).prop_map(Operation::Next),
        6 => (0..WORKERS, 0..EACH, flags).prop_map(|(w, n, f)| Operation::Commit(w, n, f)),
        3 => Just(Operation::Take),
        2 => Just(Operation::TakeNotices),
        1 => (0..WORKERS).prop_map(Operation::Kill),
    ];
    prop::collection::vec(one, 1..200)
}

/// What the model believes of one environment; the token names the command.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Belief {
    Held,
    Asked(i64),
    Stepping(i64),
    Ready(i64, u32),
}

/// Vectors and for-loops.
struct Model {
    beliefs: [Belief; ENVS],
    /// Commands each worker has not claimed yet, oldest first.
    queues: [VecDeque<usize>; WORKERS],
    /// Environments each worker has claimed.
    claimed: [Vec<usize>; WORKERS],
    token: i64,
    /// Commands ever given to each environment.
    asked: [u32; ENVS],
}

struct Pair {
    learner: Learner,
    workers: Vec<Worker>,
    mapping: Arc<Mapping>,
    model: Model,
}

impl Pair {
    fn new() -> Self {
        let shape = Shape {
            num_workers: WORKERS,
            envs_per_worker: EACH,
            action_bytes: 8,
            observation_bytes: 16,
            blob_bytes: 0,
        };
        let mapping = Arc::new(Mapping::create(shape).unwrap());
        let workers = (0..WORKERS).map(|number| worker(&mapping, number));
        Self {
            learner: Learner::new(Arc::clone(&mapping)).unwrap(),
            workers: workers.collect(),
            mapping,
            model: Model {
                beliefs: [Belief::Held; ENVS],
                queues: Default::default(),
                claimed: Default::default(),
                token: 0,
                asked: [0; ENVS],
            },
        }
    }

    fn apply(&mut self, operation: Operation) {
        match operation {
            Operation::Ask(env) => self.ask(env),
            Operation::Next(worker) => self.next(worker),
            Operation::Commit(worker, place, flags) => self.commit(worker, place, flags),
            Operation::Take => self.take(),
            Operation::TakeNotices => self.take_notices(),
            Operation::Kill(worker) => self.kill(worker),
        }
    }

    fn ask(&mut self, env: usize) {
        self.model.token += 1;
        let token = self.model.token;
        let command = Command {
            version: token,
            ..Command::default()
        };
        let is_held = self.model.beliefs.get(env) == Some(&Belief::Held);
        let writable = self.learner.writable(env);
        assert_eq!(writable.is_ok(), is_held);
        if let Ok(payload) = writable {
            // SAFETY: the environment is held, and eight bytes are its action.
            unsafe { payload.cast::<i64>().write(token) };
        }
        assert_eq!(self.learner.ask(env, &command).is_ok(), is_held);
        self.learner.strike();
        if is_held {
            self.model.asked[env] += 1;
            assert_eq!(self.mapping.slot(env).sequence(), self.model.asked[env]);
            self.model.beliefs[env] = Belief::Asked(token);
            self.model.queues[env / EACH].push_back(env);
        }
    }

    fn next(&mut self, worker: usize) {
        let task = self.workers[worker].next(Duration::ZERO);
        let Some(env) = self.model.queues[worker].pop_front() else {
            assert_eq!(task, Task::Nothing);
            return;
        };
        let Belief::Asked(token) = self.model.beliefs[env] else {
            panic!("the model's queue holds asked environments");
        };
        let Task::Command(local, command) = task else {
            panic!("expected environment {env}, found {task:?}");
        };
        assert_eq!((local, command.version), (env % EACH, token));
        // SAFETY: the worker has claimed the slot.
        assert_eq!(unsafe { self.action(env) }, token);
        self.model.beliefs[env] = Belief::Stepping(token);
        self.model.claimed[worker].push(env);
    }

    fn commit(&mut self, worker: usize, place: usize, flags: u32) {
        let env = worker * EACH + place;
        let answer = Answer {
            flags,
            version: self.model.token,
            ..Answer::default()
        };
        let is_mine = self.model.claimed[worker].contains(&env);
        if is_mine {
            // SAFETY: the worker has claimed the slot; the observation lies behind the action.
            unsafe { self.observation(env).write(self.action(env) * 2) };
        }
        let done = self.workers[worker].commit(place, &answer);
        assert_eq!(done.is_ok(), is_mine);
        if let Belief::Stepping(token) = self.model.beliefs[env] {
            self.model.claimed[worker].retain(|&other| other != env);
            self.model.beliefs[env] = Belief::Ready(token, flags);
        }
    }

    fn take(&mut self) {
        let expected = self.ready(|flags| flags & NOTICE == 0);
        // A notice pauses a wait, whatever lies ready beside it.
        if self.ready(|flags| flags & NOTICE != 0).is_empty() {
            let waited = self.learner.wait(expected.len(), Duration::ZERO);
            assert_eq!(waited, Waited::Ready);
        }
        assert_eq!(self.learner.poll(), expected.len());
        let mut found = Vec::new();
        let offset = self.mapping.layout().observation;
        self.learner.take(|env, answer, payload| {
            // SAFETY: the answer was taken, so the payload is the learner's.
            let doubled = unsafe { payload.add(offset).cast::<i64>().read() };
            found.push((env, doubled / 2, answer.flags));
        });
        assert_eq!(found, expected);
        for (env, ..) in found {
            self.model.beliefs[env] = Belief::Held;
        }
    }

    fn take_notices(&mut self) {
        let expected = self.ready(|flags| flags & NOTICE != 0);
        self.learner.poll();
        let mut found: Vec<_> = self.learner.take_notices();
        found.sort_unstable_by_key(|(env, _)| *env);
        let envs: Vec<_> = found.iter().map(|(env, _)| *env).collect();
        assert_eq!(
            envs,
            expected.iter().map(|(env, ..)| *env).collect::<Vec<_>>()
        );
        for env in envs {
            self.model.beliefs[env] = Belief::Held;
        }
    }

    fn kill(&mut self, number: usize) {
        // SAFETY: the worker is an object of this thread, and what is left of it below only claims and commits.
        let fates = unsafe { self.learner.reclaim(number, |flags| flags & ENDED != 0) };
        let mut ghost = std::mem::replace(&mut self.workers[number], worker(&self.mapping, number));
        for (place, fate) in fates.into_iter().enumerate() {
            let env = number * EACH + place;
            let belief = &mut self.model.beliefs[env];
            let expected = match *belief {
                Belief::Held => Fate::Held,
                Belief::Ready(_, flags) if flags & ENDED != 0 => Fate::Kept,
                _ => Fate::Cut,
            };
            assert_eq!(fate, expected);
            if expected == Fate::Cut {
                *belief = Belief::Held;
            }
            // Whatever the dead one held, it can no longer answer.
            assert!(ghost.commit(place, &Answer::default()).is_err());
        }
        assert_eq!(self.workers[number].epoch(), ghost.epoch().next());
        self.model.queues[number].clear();
        self.model.claimed[number].clear();
    }

    fn ready(&self, wanted: impl Fn(u32) -> bool) -> Vec<(usize, i64, u32)> {
        let beliefs = self.model.beliefs.iter().enumerate();
        beliefs
            .filter_map(|(env, belief)| match *belief {
                Belief::Ready(token, flags) if wanted(flags) => Some((env, token, flags)),
                _ => None,
            })
            .collect()
    }

    unsafe fn action(&self, env: usize) -> i64 {
        // SAFETY: the caller holds the slot.
        unsafe { self.mapping.payload(env).cast::<i64>().read() }
    }

    unsafe fn observation(&self, env: usize) -> *mut i64 {
        let offset = self.mapping.layout().observation;
        // SAFETY: the offset lies within the payload.
        unsafe { self.mapping.payload(env).add(offset).cast().as_ptr() }
    }
}

fn worker(mapping: &Arc<Mapping>, number: usize) -> Worker {
    Worker::new(Arc::clone(mapping), number, None).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if cfg!(miri) { 4 } else { 512 }))]

    #[test]
    fn both_ends_do_what_the_model_does(operations in operations()) {
        let mut pair = Pair::new();
        for operation in operations {
            pair.apply(operation);
        }
    }
}

#[test]
fn a_command_left_by_a_dead_worker_is_not_stepped_by_the_next() {
    let mut pair = Pair::new();
    for operation in [Operation::Ask(0), Operation::Kill(0), Operation::Next(0)] {
        pair.apply(operation);
    }
}
