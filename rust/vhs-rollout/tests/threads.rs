//! Real threads on one mapping: every answer belongs to its command, and every byte is whole. `make tsan` runs this too.
#![cfg(not(loom))]
#![allow(
    clippy::unwrap_used,
    clippy::cast_ptr_alignment,
    reason = "a panic is how a test fails; payloads are 64-byte aligned"
)]

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use vhs_rollout::layout::Shape;
use vhs_rollout::learner::{Learner, Waited};
use vhs_rollout::mapping::Mapping;
use vhs_rollout::slot::{Answer, Command};
use vhs_rollout::worker::{Task, Worker};

const WORDS: usize = 64;
const SOON: Duration = Duration::from_millis(20);
/// No wait here takes so long but one whose wake was lost.
const STALLED: Duration = Duration::from_secs(60);

fn shape(num_workers: usize, envs_per_worker: usize) -> Shape {
    Shape {
        num_workers,
        envs_per_worker,
        action_bytes: 8,
        observation_bytes: WORDS * 8,
        blob_bytes: 0,
    }
}

/// Fills every observation with the action plus one.
fn work(mapping: &Arc<Mapping>, number: usize) {
    let mut worker = Worker::new(Arc::clone(mapping), number, None).unwrap();
    let layout = *mapping.layout();
    loop {
        match worker.next(STALLED) {
            Task::Leave => return,
            Task::Nothing => panic!("worker {number} was not woken"),
            Task::Command(local, command) => {
                let env = number * layout.shape.envs_per_worker + local;
                let payload = mapping.payload(env);
                // SAFETY: the slot is claimed, and both parts lie within its payload.
                unsafe {
                    let action = payload.cast::<u64>().read();
                    let observation = payload.add(layout.observation).cast::<u64>();
                    for word in 0..WORDS {
                        observation.add(word).write(action + 1);
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

/// Steps every environment `steps` times, `wanted` answers at a time, and checks each answer.
fn learn(learner: &mut Learner, steps: u64, wanted: usize) {
    let mapping = Arc::clone(learner.mapping());
    let (envs, offset) = (
        mapping.layout().shape.num_envs(),
        mapping.layout().observation,
    );
    let mut taken = vec![0_u64; envs];
    let ask = |learner: &mut Learner, env: usize, step: u64| {
        let payload = learner.writable(env).unwrap();
        // SAFETY: the environment is held.
        unsafe { payload.cast::<u64>().write(step * 1000 + env as u64) };
        let command = Command {
            version: step.cast_signed(),
            ..Command::default()
        };
        learner.ask(env, &command).unwrap();
    };
    for env in 0..envs {
        ask(learner, env, 0);
    }
    learner.strike();
    let mut left = envs;
    while left > 0 {
        let end = learner.wait(wanted.min(left), STALLED);
        assert_eq!(end, Waited::Ready, "the learner was not woken");
        let mut answered = Vec::new();
        learner.take(|env, answer, payload| {
            let step = taken[env];
            assert_eq!(answer.version, step.cast_signed());
            for word in 0..WORDS {
                // SAFETY: the answer was taken, so the payload is the learner's.
                let found = unsafe { payload.add(offset).cast::<u64>().add(word).read() };
                assert_eq!(found, step * 1000 + env as u64 + 1, "torn at word {word}");
            }
            answered.push(env);
        });
        for env in answered {
            taken[env] += 1;
            if taken[env] < steps {
                ask(learner, env, taken[env]);
            } else {
                left -= 1;
            }
        }
        learner.strike();
    }
}

fn stress(num_workers: usize, envs_per_worker: usize, wanted: usize, steps: u64) {
    let mapping = Arc::new(Mapping::create(shape(num_workers, envs_per_worker)).unwrap());
    let mut learner = Learner::new(Arc::clone(&mapping)).unwrap();
    thread::scope(|scope| {
        for number in 0..num_workers {
            let mapping = &mapping;
            scope.spawn(move || work(mapping, number));
        }
        learn(&mut learner, steps, wanted);
        learner.mapping().close();
    });
}

#[test]
fn first_ready_loses_and_tears_nothing() {
    stress(4, 3, 1, 3_000);
}

#[test]
fn lock_step_loses_and_tears_nothing() {
    stress(3, 2, 6, 3_000);
}

#[test]
fn a_pair_that_passes_one_environment_to_and_fro_never_stalls() {
    stress(1, 1, 1, 20_000);
}

#[test]
fn a_waiting_worker_leaves_when_the_pool_closes() {
    let mapping = Arc::new(Mapping::create(shape(1, 1)).unwrap());
    let learner = Learner::new(Arc::clone(&mapping)).unwrap();
    let theirs = Arc::clone(&mapping);
    let worker = thread::spawn(move || {
        let mut worker = Worker::new(theirs, 0, None).unwrap();
        worker.next(Duration::from_secs(30))
    });
    thread::sleep(SOON);
    learner.mapping().close();
    assert_eq!(worker.join().unwrap(), Task::Leave);
}
