//! The shared memory and the pool refuse what they must, and change nothing by it.
#![cfg(not(loom))]
#![allow(
    clippy::unwrap_used,
    clippy::cast_ptr_alignment,
    reason = "a panic is how a test fails; payloads are 64-byte aligned"
)]

use std::os::fd::{AsFd, AsRawFd};
use std::sync::Arc;
use std::time::Duration;

use vhs_base::error::Error;
use vhs_rollout::batch::Leaf;
use vhs_rollout::flags::{BEGIN, CALL, CUT, FIRST, STEP};
use vhs_rollout::layout::{Layout, MAX_ENVS_PER_WORKER, Shape};
use vhs_rollout::mapping::Mapping;
use vhs_rollout::pool::{Pool, Rows, Stats};
use vhs_rollout::slot::Answer;
use vhs_rollout::worker::{Task, Worker};

const SHAPE: Shape = Shape {
    num_workers: 1,
    envs_per_worker: 2,
    action_bytes: 4,
    observation_bytes: 100,
    blob_bytes: 10,
};

fn pool(seed: Option<u64>) -> Pool {
    let mapping = Arc::new(Mapping::create(SHAPE).unwrap());
    let leaf = Leaf {
        offset: 0,
        bytes: 100,
    };
    Pool::new(mapping, vec![leaf], seed).unwrap()
}

#[test]
fn memory_has_one_learner_for_good() {
    let first = pool(None);
    let mapping = Arc::clone(first.mapping());
    for _ in 0..2 {
        let second = Pool::new(Arc::clone(&mapping), Vec::new(), None);
        assert!(matches!(
            second,
            Err(Error::Argument {
                field: "mapping",
                ..
            })
        ));
    }
    drop(first);
    assert!(Pool::new(mapping, Vec::new(), None).is_err());
}

#[test]
fn sizes_out_of_range_are_refused() {
    for wrong in [
        Shape {
            num_workers: 0,
            ..SHAPE
        },
        Shape {
            envs_per_worker: MAX_ENVS_PER_WORKER + 1,
            ..SHAPE
        },
        Shape {
            observation_bytes: usize::MAX / 2,
            ..SHAPE
        },
    ] {
        assert!(matches!(Layout::new(wrong), Err(Error::Argument { .. })));
    }
}

#[test]
fn parts_do_not_overlap_and_payloads_are_aligned() {
    let layout = Layout::new(SHAPE).unwrap();
    assert_eq!(layout.payload_stride, 64 + 128 + 128);
    assert_eq!(layout.payloads % 64, 0);
    assert!(layout.payloads + 2 * layout.payload_stride <= layout.blobs);
    assert_eq!(layout.blobs + 2 * layout.blob_stride, layout.total);
}

#[test]
fn memory_of_another_shape_is_refused() {
    let mapping = Mapping::create(SHAPE).unwrap();
    let memory = || mapping.memory().as_fd().try_clone_to_owned().unwrap();
    assert!(Mapping::open(memory(), SHAPE).is_ok());
    let other = Shape {
        observation_bytes: 101,
        ..SHAPE
    };
    let error = Mapping::open(memory(), other).unwrap_err();
    assert!(
        error.to_string().contains("expected 101, found 100"),
        "{error}"
    );
    let larger = Shape {
        num_workers: 2,
        ..SHAPE
    };
    assert!(matches!(
        Mapping::open(memory(), larger),
        Err(Error::Damaged { .. })
    ));
}

#[test]
fn memory_that_somebody_could_cut_short_is_refused() {
    let mapping = Mapping::create(SHAPE).unwrap();
    let whole = std::fs::read(format!("/proc/self/fd/{}", mapping.memory().as_raw_fd())).unwrap();
    let path = std::env::temp_dir().join(format!("vhs-unsealed-{}", std::process::id()));
    std::fs::write(&path, whole).unwrap();
    let file = std::fs::File::options()
        .read(true)
        .write(true)
        .open(&path)
        .unwrap();
    std::fs::remove_file(&path).unwrap();
    let refused = Mapping::open(file.into(), SHAPE);
    // In a file system in memory it has seals, but not these.
    assert!(
        matches!(refused, Err(Error::Io { .. } | Error::Damaged { .. })),
        "{refused:?}"
    );
}

#[test]
fn a_refused_send_changes_nothing() {
    let mut pool = pool(None);
    let action = [1, 2, 3, 4, 5, 6, 7, 8];
    let rows = |bytes| Rows {
        offset: 0,
        row_bytes: 4,
        bytes,
    };
    let refused = [
        pool.send(&[0, 2], &[rows(&action)], STEP, 0, &[])
            .unwrap_err(),
        pool.send(&[0, 0], &[rows(&action)], STEP, 0, &[])
            .unwrap_err(),
        pool.send(&[0, 1], &[rows(&action[..4])], STEP, 0, &[])
            .unwrap_err(),
        pool.send(&[0], &[], BEGIN, 0, &[&[0; 11]]).unwrap_err(),
        pool.send(&[0], &[], BEGIN, 0, &[&[0], &[1]]).unwrap_err(),
        pool.check_held(&[0, 2]).unwrap_err(),
    ];
    let kinds = refused.map(|error| match error {
        Error::Label { .. } => 'l',
        Error::Argument { .. } => 'a',
        Error::Shape { .. } => 's',
        _ => '?',
    });
    assert_eq!(kinds, ['l', 'a', 's', 'a', 's', 'l']);
    assert_eq!(pool.under_way(0), 0);
    pool.send(&[0, 1], &[rows(&action)], STEP, 0, &[]).unwrap();
    let again = pool.send(&[1], &[rows(&action[..4])], STEP, 0, &[]);
    assert!(matches!(again, Err(Error::Protocol { stream: 1, .. })));
}

#[test]
fn a_block_of_another_size_is_refused() {
    let mut pool = pool(None);
    let total = pool.batch().total;
    assert!(matches!(
        pool.fill(&mut vec![0; total - 1]),
        Err(Error::Shape { .. })
    ));
    assert_eq!(pool.fill(&mut vec![0; total]).unwrap().rows, 0);
}

/// Answers every command that lies ready with these flags.
fn answer(worker: &mut Worker, flags: u32) -> Vec<Option<u64>> {
    let mut seeds = Vec::new();
    while let Task::Command(local, command) = worker.next(Duration::ZERO) {
        seeds.push(command.next_seed);
        let answer = Answer {
            flags,
            seed: command.next_seed.unwrap_or_default(),
            ..Answer::default()
        };
        worker.commit(local, &answer).unwrap();
    }
    seeds
}

#[test]
fn seeds_follow_from_environment_and_episode_alone() {
    let (mut one, mut other) = (pool(Some(3)), pool(Some(3)));
    let mut seeds = Vec::new();
    for pool in [&mut one, &mut other] {
        let mut worker = Worker::new(Arc::clone(pool.mapping()), 0, None).unwrap();
        let mut block = vec![0; pool.batch().total];
        let mut begin = |pool: &mut Pool, env| {
            pool.send(&[env], &[], BEGIN, 0, &[]).unwrap();
            let seeds = answer(&mut worker, FIRST);
            pool.wait(1, Duration::ZERO);
            pool.fill(&mut block).unwrap();
            seeds[0].unwrap()
        };
        // The second pool begins them in another order.
        if seeds.is_empty() {
            seeds = [0, 0, 1].map(|env| begin(pool, env)).to_vec();
        } else {
            let [c, a, b] = [1, 0, 0].map(|env| begin(pool, env));
            assert_eq!(seeds, [a, b, c]);
        }
    }
    assert!(seeds.iter().all(|&seed| seed < 1 << 31));
    assert!(seeds[0] != seeds[1] && seeds[0] != seeds[2] && seeds[1] != seeds[2]);
}

#[test]
fn a_cut_episode_is_counted_once_and_told_with_the_next_first_observation() {
    let mut pool = pool(Some(1));
    let mut block = vec![0; pool.batch().total];
    let mut worker = Worker::new(Arc::clone(pool.mapping()), 0, None).unwrap();
    pool.send(&[0, 1], &[], BEGIN, 0, &[]).unwrap();
    answer(&mut worker, FIRST);
    pool.wait(2, Duration::ZERO);
    assert_eq!(pool.fill(&mut block).unwrap().notable, 0);
    pool.send(&[1], &[], STEP, 0, &[]).unwrap();
    // Environment 0 is held, 1 has a command: both lose their episodes, the command must be given again.
    // SAFETY: the worker is replaced before it does anything more.
    assert_eq!(unsafe { pool.reclaim(0, true) }.unwrap(), [1]);
    let mut worker = Worker::new(Arc::clone(pool.mapping()), 0, None).unwrap();
    assert_eq!(pool.under_way(0), 1);
    pool.send(&[0], &[], BEGIN, 0, &[]).unwrap();
    answer(&mut worker, FIRST);
    pool.wait(2, Duration::ZERO);
    let filled = pool.fill(&mut block).unwrap();
    assert_eq!((filled.rows, filled.notable), (2, 2));
    let flags = &block[pool.batch().flags..][..8];
    assert_eq!(flags, [FIRST | CUT; 2].map(u32::to_ne_bytes).concat());
    let expected = Stats {
        cut_episodes: 2,
        restarts: 1,
        ..Stats::default()
    };
    assert_eq!(pool.stats(), expected);
}

#[test]
fn what_a_dead_worker_owed_is_under_way_no_more_unless_it_is_asked_again() {
    let mut pool = pool(None);
    pool.send(&[0, 1], &[], CALL, 0, &[&[1], &[2]]).unwrap();
    assert_eq!(pool.under_way(0), 2);
    // SAFETY: nobody is this worker.
    assert_eq!(unsafe { pool.reclaim(0, false) }.unwrap(), [0, 1]);
    assert_eq!(pool.under_way(0), 0);
}

#[test]
fn each_environment_gets_its_own_blob_or_all_the_same() {
    for (blobs, expected) in [
        (&[&[1_u8, 2][..], &[3]][..], [2, 1]),
        (&[&[4, 5, 6]], [3, 3]),
        (&[], [0, 0]),
    ] {
        let mut pool = pool(None);
        pool.send(&[0, 1], &[], BEGIN, 0, blobs).unwrap();
        let mut worker = Worker::new(Arc::clone(pool.mapping()), 0, None).unwrap();
        for (env, bytes) in expected.into_iter().enumerate() {
            let Task::Command(local, command) = worker.next(Duration::ZERO) else {
                panic!("expected a command");
            };
            assert_eq!((local, command.blob_bytes), (env, bytes));
            // SAFETY: the worker has claimed the slot, and the blob has room for so many bytes.
            let found = unsafe { pool.mapping().blob(env).cast::<u8>().as_ref() };
            let first = blobs.get(env).or_else(|| blobs.first());
            assert!(first.is_none_or(|blob| blob[0] == *found));
        }
    }
}

#[test]
fn a_batch_is_told_again_until_the_next_ticket() {
    let mut pool = pool(None);
    let mut block = vec![0; pool.batch().total];
    let mut worker = Worker::new(Arc::clone(pool.mapping()), 0, None).unwrap();
    pool.send(&[0, 1], &[], BEGIN, 0, &[]).unwrap();
    answer(&mut worker, FIRST);
    let filled = pool
        .receive(&mut block, 7, Some(2), Duration::ZERO)
        .unwrap();
    assert_eq!(filled.map(|filled| filled.rows), Some(2));
    assert_eq!((pool.under_way(7), pool.under_way(8)), (2, 0));
    let kept = block.clone();
    let now = Duration::ZERO;
    assert_eq!(pool.receive(&mut block, 7, None, now).unwrap(), filled);
    assert_eq!(block, kept);
    assert_eq!(pool.receive(&mut block, 8, None, now).unwrap(), None);
    assert_eq!(pool.receive(&mut block, 8, Some(1), now).unwrap(), None);
}
