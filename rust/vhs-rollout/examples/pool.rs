//! A pool from plain Rust: walkers on a line in worker threads, stepped by a learner that takes whoever is ready first.
//!
//! Workers may as well be processes: each opens the descriptor of [`Mapping::memory`] with [`Mapping::open`].
//!
//! Run with `cargo run --release -p vhs-rollout --example pool`.

use std::io::{self, Write};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use vhs_base::error::Result;
use vhs_rollout::batch::Leaf;
use vhs_rollout::flags::{BEGIN, FINAL, FIRST, STEP, TERMINATED};
use vhs_rollout::layout::Shape;
use vhs_rollout::learner::Waited;
use vhs_rollout::mapping::Mapping;
use vhs_rollout::pool::{Pool, Rows};
use vhs_rollout::slot::{Answer, Command};
use vhs_rollout::worker::{Task, Worker};

/// An action is a way to go, an observation a place, both one number.
const SHAPE: Shape = Shape {
    num_workers: 2,
    envs_per_worker: 4,
    action_bytes: 8,
    observation_bytes: 8,
    blob_bytes: 0,
};
/// Where an episode ends.
const GOAL: i64 = 10;
/// How long to wait before looking whether anything else is to be done.
const SOON: Duration = Duration::from_millis(100);

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let mapping = Arc::new(Mapping::create(SHAPE)?);
    let place = Leaf {
        offset: 0,
        bytes: 8,
    };
    let mut pool = Pool::new(Arc::clone(&mapping), vec![place], Some(0))?;
    thread::scope(|scope| {
        for number in 0..SHAPE.num_workers {
            let mapping = &mapping;
            scope.spawn(move || work(mapping, number));
        }
        let learned = learn(&mut pool);
        pool.close(); // also after an error: the workers leave
        learned
    })?;
    let stats = pool.stats();
    writeln!(
        io::stdout(),
        "{} episodes, {} steps",
        stats.episodes,
        stats.steps
    )?;
    Ok(())
}

/// Steps every walker towards its goal until 1,000 episodes have ended.
fn learn(pool: &mut Pool) -> Result<()> {
    let mut block = vec![0; pool.batch().total];
    let mut envs: Vec<i64> = (0_i64..).take(SHAPE.num_envs()).collect();
    pool.send(&envs, &[], BEGIN, 0, &[])?;
    while pool.stats().episodes < 1000 {
        if pool.wait(4, SOON) != Waited::Ready {
            continue; // a place to look after signals and dead workers
        }
        let filled = pool.fill(&mut block)?;
        envs = column(&block, pool.batch().env_ids, filled.rows);
        let places = column(&block, pool.batch().observations[0], filled.rows);
        let ways = places.iter().map(|place| (GOAL - place).signum());
        let bytes: Vec<u8> = ways.flat_map(i64::to_ne_bytes).collect();
        let actions = Rows {
            offset: 0,
            row_bytes: 8,
            bytes: &bytes,
        };
        pool.send(&envs, &[actions], STEP, 0, &[])?;
    }
    Ok(())
}

/// The first `rows` numbers of a column of a block.
fn column(block: &[u8], offset: usize, rows: usize) -> Vec<i64> {
    let (numbers, _) = block[offset..][..8 * rows].as_chunks();
    numbers
        .iter()
        .map(|bytes| i64::from_ne_bytes(*bytes))
        .collect()
}

/// Is a worker until the pool closes.
fn work(mapping: &Arc<Mapping>, number: usize) -> Result<()> {
    let mut worker = Worker::new(Arc::clone(mapping), number, None)?;
    let mut places = [0; SHAPE.envs_per_worker];
    loop {
        match worker.next(SOON) {
            Task::Command(local, command) => {
                let env = number * SHAPE.envs_per_worker + local;
                let answer = step(mapping, env, &mut places[local], &command);
                worker.commit(local, &answer)?;
            }
            Task::Nothing => {}
            Task::Leave => return Ok(()),
        }
    }
}

/// Takes the action in the payload and writes what it shows; the next episode begins where one ends.
fn step(mapping: &Mapping, env: usize, place: &mut i64, command: &Command) -> Answer {
    let (payload, layout) = (mapping.payload(env).cast::<i64>(), mapping.layout());
    let mut answer = Answer {
        version: command.version,
        ..Answer::default()
    };
    // SAFETY: the slot is claimed, so its payload is this worker's; the three parts lie within it, 64-byte aligned.
    unsafe {
        if command.code == BEGIN {
            *place = 0;
            answer.flags = FIRST;
        } else {
            *place += payload.read();
        }
        if *place == GOAL {
            payload.byte_add(layout.final_observation).write(*place);
            *place = 0;
            answer.flags = TERMINATED | FINAL | FIRST;
            answer.reward = 1.0;
        }
        payload.byte_add(layout.observation).write(*place);
    }
    answer
}
