//! `vhs._core.RolloutLearner` and `RolloutWorker`: the two ends of a pool, for `vhs.rollout` alone.

use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use numpy::{PyArrayDescrMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use vhs_core::error::Error;
use vhs_rollout::batch::Leaf;
use vhs_rollout::layout::{Layout, Shape};
use vhs_rollout::learner::Waited;
use vhs_rollout::mapping::Mapping;
use vhs_rollout::pool::{Pool, Rows};
use vhs_rollout::process;
use vhs_rollout::slot::Answer;
use vhs_rollout::watch::Watch;
use vhs_rollout::worker::{Task, Worker};

use crate::arrays::{check_vector, checked, exclusive, integer_vec, integers, slice};
use crate::error::{layout, to_py};

/// The five sizes of a pool, in the order of `Shape`'s fields.
type Sizes = (usize, usize, usize, usize, usize);
/// Offset and size of a part of an observation.
type Part = (usize, usize);
/// Offset in the payload, bytes a row, and the rows: an array of whatever type, contiguous.
type ActionPart<'py> = (usize, usize, Bound<'py, PyUntypedArray>);

fn shape(sizes: Sizes) -> Shape {
    Shape {
        num_workers: sizes.0,
        envs_per_worker: sizes.1,
        action_bytes: sizes.2,
        observation_bytes: sizes.3,
        blob_bytes: sizes.4,
    }
}

/// Runs `work` on what the mutex guards, with the interpreter released first: no thread ever waits
/// for the lock while it keeps others from running Python.
fn detached<T, R>(py: Python<'_>, shared: &Mutex<T>, work: impl FnOnce(&mut T) -> R + Send) -> R
where
    T: Send,
    R: Send,
{
    // A poisoned lock only says that some call panicked; the next call's own checks are what
    // counts.
    py.detach(|| work(&mut shared.lock().unwrap_or_else(PoisonError::into_inner)))
}

/// Where payloads and blobs lie; see the stub.
fn offsets(layout: &Layout) -> Vec<usize> {
    vec![
        layout.payloads,
        layout.payload_stride,
        layout.observation,
        layout.final_observation,
        layout.blobs,
        layout.blob_stride,
        layout.total,
    ]
}

/// Seconds as a duration; negative and NaN are 0, too large is a year.
fn duration(seconds: f64) -> Duration {
    const YEAR_S: f64 = 3e7;
    if seconds > 0.0 {
        Duration::from_secs_f64(seconds.min(YEAR_S))
    } else {
        Duration::ZERO
    }
}

/// The bytes of an action's array, where they lie.
fn rows_of<'a>(part: &'a ActionPart<'_>) -> PyResult<Rows<'a>> {
    let (offset, row_bytes, array) = part;
    if !array.is_c_contiguous() {
        return Err(layout("actions", "a C-contiguous array", "one with gaps"));
    }
    // SAFETY: a contiguous array has so many bytes behind its pointer. They are read while the interpreter is held, whose
    // lock the module asks for on every build of Python, so no Python code changes or frees them meanwhile.
    let bytes = unsafe {
        let data = (*array.as_array_ptr()).fields.data.cast::<u8>();
        std::slice::from_raw_parts(data, array.len() * array.dtype().itemsize())
    };
    Ok(Rows {
        offset: *offset,
        row_bytes: *row_bytes,
        bytes,
    })
}

/// Runs short work on what the mutex guards without letting the interpreter go, unless another thread has the lock.
fn attached<T, R>(py: Python<'_>, shared: &Mutex<T>, work: impl FnOnce(&mut T) -> R) -> R
where
    T: Send,
{
    loop {
        match shared.try_lock() {
            Ok(mut guard) => return work(&mut guard),
            Err(TryLockError::Poisoned(error)) => return work(&mut error.into_inner()),
            // The other thread waits in `recv`; wait for it without the interpreter, which it may want.
            Err(TryLockError::WouldBlock) => detached(py, shared, |_| ()),
        }
    }
}

#[doc = stub!("RolloutLearner")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct RolloutLearner {
    pool: Mutex<Pool>,
    watch: Mutex<Option<Watch>>,
    mapping: Arc<Mapping>,
    block_bytes: usize,
    /// The process that made it, by number and by its forks: a fork shares the memory, and would drive the same workers.
    owner: u32,
    forks: u32,
}

impl RolloutLearner {
    /// Refuses a forked copy. Asked before any lock, which another thread may have held when the process was forked.
    fn check_process(&self) -> PyResult<()> {
        if process::forks() == self.forks {
            return Ok(());
        }
        let here = std::process::id();
        Err(to_py(Error::Argument {
            field: "pool",
            expected: format!(
                "a pool to be used by the process that made it, {}",
                self.owner
            ),
            got: format!("process {here}, forked from it"),
        }))
    }

    fn pool<R: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Pool) -> R + Send,
    ) -> PyResult<R> {
        self.check_process()?;
        Ok(detached(py, &self.pool, work))
    }

    /// As `pool`, for what neither waits nor takes long.
    fn pool_now<R>(&self, py: Python<'_>, work: impl FnOnce(&mut Pool) -> R) -> PyResult<R> {
        self.check_process()?;
        Ok(attached(py, &self.pool, work))
    }

    fn watch(&self) -> PyResult<MutexGuard<'_, Option<Watch>>> {
        self.check_process()?;
        Ok(self.watch.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[pymethods]
impl RolloutLearner {
    #[new]
    #[pyo3(signature = (sizes, leaves, seed, deadline_s, dump_signal))]
    fn new(
        sizes: Sizes,
        leaves: Vec<Part>,
        seed: Option<u64>,
        deadline_s: Option<f64>,
        dump_signal: i32,
    ) -> PyResult<Self> {
        let mapping = Arc::new(checked(Mapping::create(shape(sizes)))?);
        let leaves = leaves.into_iter();
        let leaves = leaves
            .map(|(offset, bytes)| Leaf { offset, bytes })
            .collect();
        let pool = checked(Pool::new(Arc::clone(&mapping), leaves, seed))?;
        let limit = deadline_s.map(duration);
        let watch = checked(Watch::start(Arc::clone(&mapping), limit, dump_signal))?;
        Ok(Self {
            owner: std::process::id(),
            forks: process::forks(),
            block_bytes: pool.batch().total,
            pool: Mutex::new(pool),
            watch: Mutex::new(Some(watch)),
            mapping,
        })
    }

    #[doc = stub!("RolloutLearner.memory")]
    #[getter]
    fn memory(&self) -> i32 {
        self.mapping.memory().as_raw_fd()
    }

    #[getter]
    fn offsets(&self) -> Vec<usize> {
        offsets(self.mapping.layout())
    }

    #[doc = stub!("RolloutLearner.block_bytes")]
    #[getter]
    fn block_bytes(&self) -> usize {
        self.block_bytes
    }

    #[doc = stub!("RolloutLearner.columns")]
    #[getter]
    fn columns(&self, py: Python<'_>) -> PyResult<(Vec<usize>, Vec<usize>, Vec<usize>)> {
        self.pool(py, |pool| {
            let batch = pool.batch();
            let scalars = vec![
                batch.env_ids,
                batch.rewards,
                batch.versions,
                batch.seeds,
                batch.steps,
                batch.blob_bytes,
                batch.flags,
                batch.terminated,
                batch.truncated,
                batch.first,
                batch.final_rows,
            ];
            (scalars, batch.observations.clone(), batch.finals.clone())
        })
    }

    #[doc = stub!("RolloutLearner.send")]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "extracted arguments are owned"
    )]
    fn send(
        &self,
        py: Python<'_>,
        env_ids: &Bound<'_, PyAny>,
        actions: Vec<ActionPart<'_>>,
        code: u32,
        version: i64,
        blobs: Vec<PyBackedBytes>,
    ) -> PyResult<()> {
        let envs = integers("env_ids", env_ids)?;
        check_vector("env_ids", envs.shape())?;
        let envs = slice(&envs).to_vec();
        let blobs: Vec<&[u8]> = blobs.iter().map(|blob| &**blob).collect();
        // Nothing here waits or takes long, so the interpreter is kept, and with it the actions as they are: they are
        // looked at once the lock is had, for waiting for it lets the interpreter go.
        self.pool_now(py, |pool| {
            let rows: Vec<Rows<'_>> = actions.iter().map(rows_of).collect::<PyResult<_>>()?;
            checked(pool.send(&envs, &rows, code, version, &blobs))
        })?
    }

    #[doc = stub!("RolloutLearner.check_held")]
    fn check_held(&self, py: Python<'_>, env_ids: &Bound<'_, PyAny>) -> PyResult<()> {
        let envs = integer_vec("env_ids", env_ids)?;
        checked(self.pool_now(py, |pool| pool.check_held(&envs))?)
    }

    #[doc = stub!("RolloutLearner.under_way")]
    fn under_way(&self, py: Python<'_>, ticket: u64) -> PyResult<usize> {
        self.pool_now(py, |pool| pool.under_way(ticket))
    }

    #[doc = stub!("RolloutLearner.is_filled")]
    fn is_filled(&self, py: Python<'_>, ticket: u64) -> PyResult<bool> {
        self.pool_now(py, |pool| pool.filled_for(ticket).is_some())
    }

    #[doc = stub!("RolloutLearner.has_news")]
    fn has_news(&self, py: Python<'_>) -> PyResult<bool> {
        self.pool_now(py, |pool| pool.has_news())
    }

    #[doc = stub!("RolloutLearner.wait")]
    fn wait(&self, py: Python<'_>, wanted: usize, limit_s: f64) -> PyResult<bool> {
        let limit = duration(limit_s);
        Ok(self.pool(py, |pool| pool.wait(wanted, limit))? == Waited::Ready)
    }

    #[doc = stub!("RolloutLearner.recv")]
    fn recv(
        &self,
        py: Python<'_>,
        block: &Bound<'_, PyAny>,
        ticket: u64,
        wanted: Option<usize>,
        limit_s: f64,
    ) -> PyResult<Option<(usize, usize, usize)>> {
        // First of all: in a fork, the parent's other thread may have been about to fill the block.
        self.check_process()?;
        let mut block = exclusive::<u8>(block, &[self.block_bytes])?;
        let (bytes, limit) = (block.as_slice_mut()?, duration(limit_s));
        let filled = self.pool(py, |pool| pool.receive(bytes, ticket, wanted, limit))?;
        Ok(checked(filled)?.map(|filled| (filled.rows, filled.finals, filled.notable)))
    }

    #[expect(
        clippy::needless_pass_by_value,
        reason = "extracted arguments are owned"
    )]
    fn seed_next(
        &self,
        py: Python<'_>,
        env_ids: &Bound<'_, PyAny>,
        seeds: Vec<Option<u64>>,
    ) -> PyResult<()> {
        let envs = integer_vec("env_ids", env_ids)?;
        checked(self.pool(py, |pool| pool.seed_next(&envs, &seeds))?)
    }

    fn reseed(&self, py: Python<'_>, seed: Option<u64>) -> PyResult<()> {
        self.pool(py, |pool| pool.reseed(seed))
    }

    fn expect_start(&self, py: Python<'_>, worker: usize, limit_s: f64) -> PyResult<()> {
        let limit = duration(limit_s);
        self.pool(py, |pool| pool.expect_start(worker, limit))
    }

    #[doc = stub!("RolloutLearner.listen_to")]
    fn listen_to(&self, worker: usize, pid: i32) -> PyResult<()> {
        let watch = self.watch()?;
        watch
            .as_ref()
            .map_or(Ok(()), |watch| checked(watch.add(worker, pid)))
    }

    #[doc = stub!("RolloutLearner.take_deaths")]
    fn take_deaths(&self) -> PyResult<Vec<(usize, bool)>> {
        let watch = self.watch()?;
        let deaths = watch.as_ref().map(Watch::take_deaths).unwrap_or_default();
        let deaths = deaths.into_iter();
        Ok(deaths
            .map(|death| (death.worker, death.was_overdue))
            .collect())
    }

    #[doc = stub!("RolloutLearner.take_notices")]
    fn take_notices(&self, py: Python<'_>) -> PyResult<Vec<(usize, u32, u32)>> {
        let notices = self.pool(py, Pool::take_notices)?.into_iter();
        Ok(notices
            .map(|(env, answer)| (env, answer.flags, answer.blob_bytes))
            .collect())
    }

    #[doc = stub!("RolloutLearner.reclaim")]
    fn reclaim(&self, py: Python<'_>, worker: usize, again: bool) -> PyResult<(Vec<i64>, bool)> {
        self.pool(py, |pool| {
            let has_answered = pool.has_answered(worker);
            // SAFETY: `vhs.rollout` calls this for deaths that `take_deaths` told, of processes that it has joined.
            let lost = unsafe { pool.reclaim(worker, again) };
            Ok((checked(lost)?, has_answered))
        })?
    }

    #[doc = stub!("RolloutLearner.stats")]
    #[getter]
    fn stats(&self, py: Python<'_>) -> PyResult<(u64, u64, u64, u64, u64)> {
        let stats = self.pool(py, |pool| pool.stats())?;
        Ok((
            stats.steps,
            stats.episodes,
            stats.cut_episodes,
            stats.quarantined_episodes,
            stats.restarts,
        ))
    }

    #[doc = stub!("RolloutLearner.close")]
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.check_process()?;
        // Without the pool's lock, which a `recv` of another thread holds for as long as it waits.
        self.mapping.close();
        // Workers that leave now are no deaths to hear of; the drop waits for the thread, which may want the interpreter.
        let watch = py.detach(|| self.watch().map(|mut watch| watch.take()))?;
        py.detach(|| drop(watch));
        Ok(())
    }

    #[doc = stub!("RolloutLearner.free")]
    fn free(&self) {
        self.mapping.free();
    }
}

#[doc = stub!("RolloutWorker")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct RolloutWorker {
    worker: Mutex<Worker>,
    mapping: Arc<Mapping>,
}

#[pymethods]
impl RolloutWorker {
    #[new]
    fn new(
        memory: i32,
        sizes: Sizes,
        worker: usize,
        deadline_s: Option<f64>,
        cpu: Option<usize>,
    ) -> PyResult<Self> {
        // SAFETY: the descriptor is borrowed for the duplication alone, and a wrong number is an error of that call.
        let memory: OwnedFd = unsafe { BorrowedFd::borrow_raw(memory) }.try_clone_to_owned()?;
        let mapping = Arc::new(checked(Mapping::open(memory, shape(sizes)))?);
        let limit = deadline_s.map(duration);
        let mut end = checked(Worker::new(Arc::clone(&mapping), worker, limit))?;
        if let Some(cpu) = cpu {
            end.pin(cpu);
        }
        Ok(Self {
            worker: Mutex::new(end),
            mapping,
        })
    }

    #[getter]
    fn offsets(&self) -> Vec<usize> {
        offsets(self.mapping.layout())
    }

    #[doc = stub!("RolloutWorker.epoch")]
    #[getter]
    fn epoch(&self, py: Python<'_>) -> u32 {
        detached(py, &self.worker, |worker| worker.epoch().number())
    }

    #[doc = stub!("RolloutWorker.next")]
    fn next(&self, py: Python<'_>, limit_s: f64) -> (i64, u32, i64, Option<u64>, u32) {
        // A command that has come already is worth no release of the interpreter.
        let task = attached(py, &self.worker, Worker::poll).unwrap_or_else(|| {
            let limit = duration(limit_s);
            detached(py, &self.worker, |worker| worker.next(limit))
        });
        match task {
            Task::Command(env, command) => (
                i64::try_from(env).unwrap_or(i64::MAX),
                command.code,
                command.version,
                command.next_seed,
                command.blob_bytes,
            ),
            Task::Nothing => (-1, 0, 0, None, 0),
            Task::Leave => (-2, 0, 0, None, 0),
        }
    }

    #[doc = stub!("RolloutWorker.untie")]
    fn untie(&self, py: Python<'_>) {
        attached(py, &self.worker, Worker::untie);
    }

    #[doc = stub!("RolloutWorker.allow")]
    fn allow(&self, py: Python<'_>, extra_s: f64) {
        let extra = duration(extra_s);
        detached(py, &self.worker, |worker| worker.allow(extra));
    }

    #[doc = stub!("RolloutWorker.commit")]
    #[expect(
        clippy::too_many_arguments,
        reason = "one positional call a step is the cheapest"
    )]
    fn commit(
        &self,
        py: Python<'_>,
        env: usize,
        flags: u32,
        reward: f64,
        step: u32,
        seed: u64,
        blob_bytes: u32,
        version: i64,
    ) -> PyResult<()> {
        let answer = Answer {
            flags,
            reward,
            step,
            seed,
            blob_bytes,
            version,
        };
        checked(attached(py, &self.worker, |worker| {
            worker.commit(env, &answer)
        }))
    }

    #[doc = stub!("RolloutWorker.end_with")]
    #[staticmethod]
    fn end_with(parent: i32, by_signal: bool) -> PyResult<()> {
        checked(process::end_with(parent, by_signal))
    }
}
