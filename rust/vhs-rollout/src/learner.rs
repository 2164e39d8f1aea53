//! The learner's end: asks, waits, gathers, and takes the slots of the dead. One per pool.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use vhs_base::error::{Error, Result};

use crate::clock::monotonic_ns;
use crate::flags::NOTICE;
use crate::mapping::Mapping;
use crate::ring::{Consumer, Producer};
use crate::slot::{Answer, Command, Epoch, State};
use crate::sync::Ordering;
use crate::wait::{Wait, Waiter};
use crate::worker::{index, nanos, refused};

/// What [`Learner::wait`] came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited {
    /// As many answers as wanted lie ready.
    Ready,
    /// Time is over, a notice came, or an alarm rang; look after them and after signals, and call again.
    Paused,
    /// The pool was closed meanwhile, by another thread.
    Closed,
}

/// What a death meant for one environment of the dead worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The learner holds it: the next command goes to the new incarnation.
    Held,
    /// Its command or its answer is lost; it must be asked anew.
    Cut,
    /// Its answer was complete and worth keeping, and will still be delivered.
    Kept,
}

/// One worker as the learner sees it.
#[derive(Debug, Default)]
struct Line {
    commands: Producer,
    answers: Consumer,
    epoch: Epoch,
    /// Commands pushed since the worker's bell was last struck.
    unstruck: bool,
    /// This incarnation has answered something.
    has_answered: bool,
}

/// The one learner of a pool.
#[derive(Debug)]
pub struct Learner {
    mapping: Arc<Mapping>,
    workers: Vec<Line>,
    /// Environments whose answers were found and not yet taken, oldest first.
    inbox: VecDeque<u32>,
    /// Those whose answers are notices, which no batch takes.
    notices: VecDeque<u32>,
    waiter: Waiter,
    wait: Option<Wait>,
}

impl Learner {
    /// The one learner of fresh memory.
    ///
    /// # Errors
    /// [`Error::Argument`] where the memory has, or had, another: two would write into the same payloads.
    pub fn new(mapping: Arc<Mapping>) -> Result<Self> {
        // Relaxed: only who comes first matters, nothing was written before that the other would read.
        if mapping.header().claimed.swap(1, Ordering::Relaxed) != 0 {
            return Err(Error::Argument {
                field: "mapping",
                expected: "memory without a learner".into(),
                got: "memory that has one".into(),
            });
        }
        let shape = mapping.layout().shape;
        let workers = (0..shape.num_workers).map(|_| Line::default()).collect();
        Ok(Self {
            mapping,
            workers,
            inbox: VecDeque::with_capacity(shape.num_envs()),
            notices: VecDeque::new(),
            waiter: Waiter::default(),
            wait: None,
        })
    }

    /// The shared memory.
    #[must_use]
    pub const fn mapping(&self) -> &Arc<Mapping> {
        &self.mapping
    }

    /// Where to write what goes with the next command: the payload of a held environment.
    ///
    /// # Errors
    /// [`Error::Protocol`] when the environment is not held, [`Error::Label`] when it does not exist.
    pub fn writable(&self, env: usize) -> Result<*mut u8> {
        self.check(env)?;
        match self.mapping.slot(env).state() {
            State::Held => Ok(self.mapping.payload(env).as_ptr()),
            found => Err(refused("send", env, State::Held, found)),
        }
    }

    /// Gives a command to an environment that is held. It is under way once [`Learner::strike`] is called.
    ///
    /// # Errors
    /// [`Error::Protocol`] when the environment is not held, [`Error::Label`] when it does not exist.
    pub fn ask(&mut self, env: usize, command: &Command) -> Result<()> {
        self.check(env)?;
        let asked = self.mapping.slot(env).ask(command);
        asked.map_err(|found| refused("send", env, State::Held, found))?;
        let worker = self.mapping.layout().worker_of(env);
        let (line, post) = (&mut self.workers[worker], self.mapping.post(worker));
        let has_limit = self.mapping.header().has_limit.load(Ordering::Relaxed) != 0;
        if has_limit && !line.unstruck {
            // Before the push, whose Release shows it to the supervisor: no command is older than its time.
            post.asked_ns.store(monotonic_ns(), Ordering::Relaxed);
        }
        let is_pushed = line.commands.push(&post.commands, index(env));
        debug_assert!(is_pushed, "at most one command an environment is under way");
        line.unstruck = true;
        Ok(())
    }

    /// Wakes the workers that were given commands: one stroke each, however many commands.
    pub fn strike(&mut self) {
        for (worker, line) in self.workers.iter_mut().enumerate() {
            if std::mem::take(&mut line.unstruck) {
                self.mapping.post(worker).bell.strike();
            }
        }
    }

    /// Whether a death or a notice waits to be seen to.
    #[must_use]
    pub fn has_news(&self) -> bool {
        !self.notices.is_empty() || self.mapping.header().alarmed.0.load(Ordering::Acquire) != 0
    }

    /// How many answers lie ready for a batch, after a look at every ring.
    pub fn poll(&mut self) -> usize {
        let envs = self.mapping.layout().shape.num_envs();
        for (worker, line) in self.workers.iter_mut().enumerate() {
            let ring = &self.mapping.post(worker).answers;
            while let Some(env) = line.answers.pop(ring) {
                // Anything else was written by a process that does not keep to the protocol.
                if (env as usize) >= envs {
                    continue;
                }
                // The answer's flags came with the index: the worker pushed it after its commit.
                line.has_answered = true;
                if self.mapping.slot(env as usize).flags() & NOTICE == 0 {
                    self.inbox.push_back(env);
                } else {
                    self.notices.push_back(env);
                }
            }
        }
        self.inbox.len()
    }

    /// Waits until `wanted` answers lie ready for a batch, for about `limit`.
    pub fn wait(&mut self, wanted: usize, limit: Duration) -> Waited {
        let mapping = Arc::clone(&self.mapping);
        // A learner that never has to wait hears of the dead all the same.
        let is_quiet = mapping.header().alarmed.0.load(Ordering::Acquire) == 0;
        if is_quiet && self.poll() >= wanted && self.notices.is_empty() {
            return Waited::Ready;
        }
        let bell = &mapping.header().bell;
        let mut wait = self.wait.take().unwrap_or_else(|| self.waiter.begin());
        let until_ns = monotonic_ns().saturating_add(nanos(limit));
        loop {
            // The count is read before the rings: an answer that comes between the two makes the sleep end at once.
            let count = bell.count();
            if mapping.is_closing() {
                return Waited::Closed;
            }
            if mapping.header().alarmed.0.load(Ordering::Acquire) != 0 {
                self.wait = Some(wait);
                return Waited::Paused;
            }
            let found = self.poll();
            if !self.notices.is_empty() {
                self.wait = Some(wait);
                return Waited::Paused;
            }
            if found >= wanted {
                self.waiter.end(&wait);
                return Waited::Ready;
            }
            let left_ns = until_ns.saturating_sub(monotonic_ns());
            if left_ns == 0 {
                self.wait = Some(wait);
                return Waited::Paused;
            }
            let target = count.plus(index(wanted - found));
            self.waiter
                .pass(&mut wait, bell, target, Duration::from_nanos(left_ns));
        }
    }

    /// Takes the answers that lie ready, in the order of their environments, each with the environment's payload.
    pub fn take(&mut self, mut receive: impl FnMut(usize, &Answer, *const u8)) {
        let mut inbox = std::mem::take(&mut self.inbox);
        inbox.make_contiguous().sort_unstable();
        for env in inbox.drain(..) {
            let env = env as usize;
            if let Some(answer) = self.take_one(env) {
                receive(env, &answer, self.mapping.payload(env).as_ptr());
            }
        }
        self.inbox = inbox;
    }

    /// Takes the notices, in the order in which they came.
    pub fn take_notices(&mut self) -> Vec<(usize, Answer)> {
        let envs = std::mem::take(&mut self.notices);
        let notices = envs.into_iter().map(|env| env as usize);
        notices
            .filter_map(|env| Some((env, self.take_one(env)?)))
            .collect()
    }

    /// An answer that cannot be taken is one that a reclaimed slot no longer has.
    fn take_one(&self, env: usize) -> Option<Answer> {
        let epoch = self.workers[self.mapping.layout().worker_of(env)].epoch;
        self.mapping.slot(env).take(epoch).ok()
    }

    /// Whether the present incarnation of a worker has answered anything.
    #[must_use]
    pub fn has_answered(&self, worker: usize) -> bool {
        self.workers[worker].has_answered
    }

    /// Prepares a worker's post and slots for its next incarnation.
    ///
    /// `keep` says by its flags whether a complete answer is worth delivering although its environment is gone.
    ///
    /// # Safety
    /// The present incarnation is dead: it would go on writing into payloads that are then the learner's.
    pub unsafe fn reclaim(&mut self, worker: usize, keep: impl Fn(u32) -> bool) -> Vec<Fate> {
        let per_worker = self.mapping.layout().shape.envs_per_worker;
        let first = worker * per_worker;
        let epoch = self.workers[worker].epoch.next();
        for list in [&mut self.inbox, &mut self.notices] {
            list.retain(|&env| self.mapping.layout().worker_of(env as usize) != worker);
        }
        let mut fates = Vec::with_capacity(per_worker);
        for env in first..first + per_worker {
            let slot = self.mapping.slot(env);
            // SAFETY: the caller knows that the worker is dead.
            let fate = match unsafe { slot.reclaim(epoch, &keep) } {
                State::Held => Fate::Held,
                State::Ready if slot.state() == State::Ready => Fate::Kept,
                _ => Fate::Cut,
            };
            if fate == Fate::Kept {
                self.inbox.push_back(index(env));
            }
            fates.push(fate);
        }
        let post = self.mapping.post(worker);
        let (commands, _) = post.commands.clear();
        let (_, answers) = post.answers.clear();
        post.bell.clear();
        post.deadline_ns.store(0, Ordering::Relaxed);
        post.epoch.0.store(epoch.number(), Ordering::Release);
        self.workers[worker] = Line {
            commands,
            answers,
            epoch,
            unstruck: false,
            has_answered: false,
        };
        fates
    }

    /// Gives a worker that is about to start until `limit` from now to take up its post.
    pub fn expect_start(&self, worker: usize, limit: Duration) {
        let deadline_ns = monotonic_ns().saturating_add(nanos(limit));
        let post = self.mapping.post(worker);
        post.deadline_ns.store(deadline_ns, Ordering::Relaxed);
    }

    fn check(&self, env: usize) -> Result<()> {
        let limit = self.mapping.layout().shape.num_envs();
        if env < limit {
            return Ok(());
        }
        Err(Error::Label {
            field: "env_ids",
            index: 0,
            limit,
            got: i64::try_from(env).unwrap_or(i64::MAX),
        })
    }
}
