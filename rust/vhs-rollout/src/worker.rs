//! The worker's end: takes commands, steps, answers. One per worker process.

use std::sync::Arc;
use std::time::Duration;

use vhs_base::error::{Error, Result};

use crate::clock::monotonic_ns;
use crate::layout::Post;
use crate::mapping::Mapping;
use crate::process::Pin;
use crate::ring::{Consumer, Producer};
use crate::slot::{Answer, Command, Epoch, State};
use crate::sync::Ordering;
use crate::wait::Waiter;

/// What [`Worker::next`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// A command for one of this worker's environments, counted from 0 within the worker; its slot is claimed.
    Command(usize, Command),
    /// The pool is closing.
    Leave,
    /// Nothing came; look after signals and call again.
    Nothing,
}

/// One incarnation of a worker.
#[derive(Debug)]
pub struct Worker {
    mapping: Arc<Mapping>,
    number: usize,
    first_env: usize,
    epoch: Epoch,
    commands: Consumer,
    answers: Producer,
    waiter: Waiter,
    /// Time allowed for one command; `None` is no limit.
    limit: Option<Duration>,
    /// A core of its own, as long as no foreign process crowds it.
    pin: Option<Pin>,
    /// Waits since something may have started that would inherit the tie.
    untied_waits: u32,
}

/// Waits before a worker is tied to its core: environments start their threads and programs in their first steps.
const WARM_UP: u32 = 100;

impl Worker {
    /// Takes up the post that the supervisor prepared.
    ///
    /// # Errors
    /// [`Error::Argument`] for a worker that does not exist.
    pub fn new(mapping: Arc<Mapping>, worker: usize, limit: Option<Duration>) -> Result<Self> {
        let shape = mapping.layout().shape;
        if worker >= shape.num_workers {
            return Err(Error::Argument {
                field: "worker",
                expected: format!("a number below {}", shape.num_workers),
                got: worker.to_string(),
            });
        }
        let post = mapping.post(worker);
        let epoch = Epoch::new(post.epoch.0.load(Ordering::Acquire));
        rest(post, limit.is_some());
        Ok(Self {
            first_env: worker * shape.envs_per_worker,
            mapping,
            number: worker,
            epoch,
            commands: Consumer::default(),
            answers: Producer::default(),
            waiter: Waiter::default(),
            limit,
            pin: None,
            untied_waits: 0,
        })
    }

    /// Ties this thread to a core before long, except while a foreign process keeps that core busy.
    pub fn pin(&mut self, cpu: usize) {
        self.pin = Pin::new(cpu);
    }

    /// Lets this thread run anywhere for a while: what it starts now inherits where it may run.
    pub fn untie(&mut self) {
        self.untied_waits = 0;
        if let Some(pin) = &mut self.pin {
            pin.set(false);
        }
    }

    /// This worker's incarnation.
    #[must_use]
    pub const fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// The next command, waiting for it for about `limit`.
    pub fn next(&mut self, limit: Duration) -> Task {
        if let Some(task) = self.poll() {
            return task;
        }
        let mapping = Arc::clone(&self.mapping);
        let post = mapping.post(self.number);
        let mut wait = self.waiter.begin();
        if let Some(pin) = &mut self.pin {
            self.untied_waits = self.untied_waits.saturating_add(1);
            pin.set(self.untied_waits > WARM_UP && !self.waiter.is_crowded());
        }
        let until_ns = monotonic_ns().saturating_add(nanos(limit));
        loop {
            // The count is read before the rings: a command that comes between the two makes the sleep end at once.
            let count = post.bell.count();
            if mapping.is_closing() {
                return Task::Leave;
            }
            if let Some(task) = self.poll() {
                self.waiter.end(&wait);
                return task;
            }
            let left_ns = until_ns.saturating_sub(monotonic_ns());
            if left_ns == 0 {
                return Task::Nothing;
            }
            let left = Duration::from_nanos(left_ns);
            self.waiter.pass(&mut wait, &post.bell, count.plus(1), left);
        }
    }

    /// Allows the command under way this much more time, counted from now: making an environment takes longer than a
    /// step.
    pub fn allow(&self, extra: Duration) {
        self.set_deadline(monotonic_ns().saturating_add(nanos(extra)));
    }

    /// Answers the claimed command of environment `local` and hands the slot over.
    ///
    /// # Errors
    /// [`Error::Protocol`] when this worker does not hold the slot.
    pub fn commit(&mut self, local: usize, answer: &Answer) -> Result<()> {
        let env = self.env(local)?;
        let mapping = &self.mapping;
        let post = mapping.post(self.number);
        let done = mapping.slot(env).commit(self.epoch, answer);
        done.map_err(|found| refused("commit", env, State::Stepping, found))?;
        rest(post, self.limit.is_some());
        let is_pushed = self.answers.push(&post.answers, index(env));
        debug_assert!(is_pushed, "at most one answer an environment is under way");
        mapping.header().bell.strike();
        Ok(())
    }

    /// The next command, if it has come already.
    pub fn poll(&mut self) -> Option<Task> {
        let ring = &self.mapping.post(self.number).commands;
        while let Some(env) = self.commands.pop(ring) {
            let env = env as usize;
            let Some(local) = self.local(env) else {
                continue;
            };
            // A command that cannot be claimed was meant for an earlier incarnation.
            if let Ok(command) = self.mapping.slot(env).claim(self.epoch) {
                if let Some(limit) = self.limit {
                    self.set_deadline(monotonic_ns().saturating_add(nanos(limit)));
                }
                return Some(Task::Command(local, command));
            }
        }
        None
    }

    fn set_deadline(&self, deadline_ns: u64) {
        let post = self.mapping.post(self.number);
        post.deadline_ns.store(deadline_ns, Ordering::Relaxed);
    }

    fn env(&self, local: usize) -> Result<usize> {
        let limit = self.mapping.layout().shape.envs_per_worker;
        if local < limit {
            return Ok(self.first_env + local);
        }
        Err(Error::Argument {
            field: "env",
            expected: format!("a number below {limit}"),
            got: local.to_string(),
        })
    }

    fn local(&self, env: usize) -> Option<usize> {
        let limit = self.mapping.layout().shape.envs_per_worker;
        env.checked_sub(self.first_env)
            .filter(|&local| local < limit)
    }
}

/// The worker is done with what it did: its clock stops, and the one of the command that it is to take next starts.
fn rest(post: &Post, has_limit: bool) {
    if has_limit {
        post.done_ns.store(monotonic_ns(), Ordering::Relaxed);
    }
    // Release: who sees the zero sees since when.
    post.deadline_ns.store(0, Ordering::Release);
}

pub(crate) fn refused(call: &'static str, env: usize, expected: State, found: State) -> Error {
    Error::Protocol {
        call,
        stream: env,
        expected: name(expected),
        found: name(found),
    }
}

pub(crate) fn index(env: usize) -> u32 {
    u32::try_from(env).unwrap_or(u32::MAX)
}

pub(crate) fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

const fn name(state: State) -> &'static str {
    match state {
        State::Held => "an environment that waits for a command",
        State::Asked => "a command under way",
        State::Stepping => "a step under way",
        State::Ready => "an answer that nobody has taken",
    }
}
