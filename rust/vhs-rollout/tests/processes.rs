//! Real processes on one mapping, killed at random: the rest go on, and no answer is torn or given twice.
//!
//! This test binary is its own worker: it starts itself with the descriptor's path in the environment.
#![cfg(not(loom))]
#![allow(
    clippy::unwrap_used,
    clippy::cast_ptr_alignment,
    reason = "a panic is how a test fails; payloads are 64-byte aligned"
)]

use std::fs::OpenOptions;
use std::os::fd::{AsRawFd, OwnedFd};
use std::process::{Child, Command as Process, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use vhs_base::rng::Rng;
use vhs_rollout::flags::ENDED;
use vhs_rollout::layout::Shape;
use vhs_rollout::learner::{Fate, Learner, Waited};
use vhs_rollout::mapping::Mapping;
use vhs_rollout::slot::{Answer, Command};
use vhs_rollout::watch::Watch;
use vhs_rollout::worker::{Task, Worker};

const MEMORY: &str = "VHS_ROLLOUT_TEST_MEMORY";
const NUMBER: &str = "VHS_ROLLOUT_TEST_NUMBER";
const WORDS: usize = 512;
const SHAPE: Shape = Shape {
    num_workers: 3,
    envs_per_worker: 2,
    action_bytes: 8,
    observation_bytes: WORDS * 8,
    blob_bytes: 0,
};
const KILLS: usize = 50;

/// Not a test: what the processes that the test starts run.
#[test]
#[ignore = "the worker of the test below, which starts it"]
fn worker_process() {
    let Ok(path) = std::env::var(MEMORY) else {
        return;
    };
    let number: usize = std::env::var(NUMBER).unwrap().parse().unwrap();
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .open(path)
        .unwrap();
    let mapping = Arc::new(Mapping::open(OwnedFd::from(file), SHAPE).unwrap());
    let mut worker = Worker::new(Arc::clone(&mapping), number, None).unwrap();
    let layout = *mapping.layout();
    loop {
        match worker.next(Duration::from_secs(1)) {
            // Past the test harness: under ThreadSanitizer, its own threads are reported when it tidies up.
            Task::Leave => std::process::exit(0),
            Task::Nothing => {}
            Task::Command(local, command) => {
                let payload = mapping.payload(number * SHAPE.envs_per_worker + local);
                // SAFETY: the slot is claimed, and both parts lie within its payload.
                unsafe {
                    let action = payload.cast::<u64>().read();
                    let observation = payload.add(layout.observation).cast::<u64>();
                    for word in 0..WORDS {
                        observation.add(word).write(action * 3);
                    }
                }
                let answer = Answer {
                    version: command.version,
                    ..Answer::default()
                };
                worker.commit(local, &answer).unwrap();
            }
        }
    }
}

struct Pool {
    learner: Learner,
    watch: Watch,
    mapping: Arc<Mapping>,
    children: Vec<Child>,
    /// Token of each environment's command.
    tokens: Vec<u64>,
    next_token: u64,
}

impl Pool {
    fn start() -> Self {
        let mapping = Arc::new(Mapping::create(SHAPE).unwrap());
        let mut pool = Self {
            learner: Learner::new(Arc::clone(&mapping)).unwrap(),
            watch: Watch::start(Arc::clone(&mapping), None, 0).unwrap(),
            mapping,
            children: Vec::new(),
            tokens: vec![0; SHAPE.num_envs()],
            next_token: 0,
        };
        for number in 0..SHAPE.num_workers {
            let child = pool.spawn(number);
            pool.children.push(child);
        }
        for env in 0..SHAPE.num_envs() {
            pool.ask(env);
        }
        pool.learner.strike();
        pool
    }

    fn spawn(&self, number: usize) -> Child {
        let memory = self.mapping.memory().as_raw_fd();
        let child = Process::new(std::env::current_exe().unwrap())
            .args(["--exact", "worker_process", "--ignored"])
            .env(MEMORY, format!("/proc/{}/fd/{memory}", std::process::id()))
            .env(NUMBER, number.to_string())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let pid = i32::try_from(child.id()).unwrap();
        self.watch.add(number, pid).unwrap();
        child
    }

    fn ask(&mut self, env: usize) {
        self.next_token += 1;
        self.tokens[env] = self.next_token;
        let payload = self.learner.writable(env).unwrap();
        // SAFETY: the environment is held.
        unsafe { payload.cast::<u64>().write(self.next_token) };
        let command = Command {
            version: self.next_token.cast_signed(),
            ..Command::default()
        };
        self.learner.ask(env, &command).unwrap();
    }

    /// Replaces the dead; returns how many there were.
    fn bury(&mut self) -> usize {
        let deaths = self.watch.take_deaths();
        for death in &deaths {
            self.children[death.worker].wait().unwrap();
            // SAFETY: `wait` has just seen the end of the process.
            let fates = unsafe {
                self.learner
                    .reclaim(death.worker, |flags| flags & ENDED != 0)
            };
            self.children[death.worker] = self.spawn(death.worker);
            for (place, fate) in fates.into_iter().enumerate() {
                if fate == Fate::Cut {
                    self.ask(death.worker * SHAPE.envs_per_worker + place);
                }
            }
        }
        self.learner.strike();
        deaths.len()
    }

    /// Takes what is ready, checks every word, and asks again; returns how many answers there were.
    fn step(&mut self) -> usize {
        if self.learner.wait(1, Duration::from_millis(100)) == Waited::Paused {
            return 0;
        }
        let (offset, tokens) = (self.mapping.layout().observation, &self.tokens);
        let mut answered = Vec::new();
        self.learner.take(|env, answer, payload| {
            assert_eq!(
                answer.version,
                tokens[env].cast_signed(),
                "an answer to another command"
            );
            for word in 0..WORDS {
                // SAFETY: the answer was taken, so the payload is the learner's.
                let found = unsafe { payload.add(offset).cast::<u64>().add(word).read() };
                assert_eq!(found, tokens[env] * 3, "torn at word {word}");
            }
            answered.push(env);
        });
        for &env in &answered {
            self.ask(env);
        }
        self.learner.strike();
        answered.len()
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.learner.mapping().close();
        for child in &mut self.children {
            // A worker that does not leave is a failed test already; here it must only not stay behind.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[test]
fn a_learner_that_never_waits_hears_of_a_death() {
    let mut pool = Pool::start();
    let until = Instant::now() + Duration::from_secs(20);
    while pool.learner.wait(SHAPE.num_envs(), Duration::from_secs(1)) == Waited::Paused {
        assert!(Instant::now() < until, "no answers");
    }
    pool.children[0].kill().unwrap();
    // The answers that lie ready would do for any number of these calls.
    while pool.learner.wait(1, Duration::ZERO) == Waited::Ready {
        assert!(Instant::now() < until, "the death was never told");
    }
    assert_eq!(pool.bury(), 1);
    assert_eq!(pool.learner.wait(1, Duration::ZERO), Waited::Ready);
}

#[test]
fn killed_processes_are_replaced_and_nothing_is_torn_or_doubled() {
    let mut pool = Pool::start();
    let mut chance = Rng::new(7);
    let (mut deaths, mut answers, mut kills) = (0, 0, 0);
    let mut next_kill = Instant::now();
    let until = Instant::now() + Duration::from_secs(100);
    while deaths < KILLS || answers < 20_000 {
        assert!(
            Instant::now() < until,
            "{deaths} deaths and {answers} answers so far"
        );
        if kills < KILLS && kills == deaths && Instant::now() >= next_kill {
            pool.children[chance.below(SHAPE.num_workers)]
                .kill()
                .unwrap();
            kills += 1;
            let pause_us = u64::try_from(chance.below(30_000)).unwrap();
            next_kill = Instant::now() + Duration::from_micros(pause_us);
        }
        deaths += pool.bury();
        answers += pool.step();
    }
    // Every environment still answers.
    let mut silent: Vec<usize> = (0..SHAPE.num_envs()).collect();
    while !silent.is_empty() {
        let before = pool.tokens.clone();
        pool.step();
        silent.retain(|&env| pool.tokens[env] == before[env]);
    }
}

#[test]
fn a_pool_that_closes_is_left_by_its_processes() {
    let mut pool = Pool::start();
    while pool.step() == 0 {}
    pool.learner.mapping().close();
    for child in &mut pool.children {
        assert!(child.wait().unwrap().success());
    }
}
