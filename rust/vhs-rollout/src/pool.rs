//! The learner's pool: batches out, actions in, and what is known of each environment's episodes.
//!
//! Invariants: every command carries the seed of the episode that would begin if the present one ended; an answer that
//! follows a lost episode says so ([`CUT`]); a refused call has changed nothing; what is under way is counted where it
//! changes, so that no caller that is interrupted between two calls counts wrongly.

use std::sync::Arc;
use std::time::Duration;

use vhs_base::check::check_shape;
use vhs_base::error::{Error, Result};
use vhs_base::rng::Rng;

use crate::batch::{BatchLayout, Block, Filled, Leaf};
use crate::flags::{BEGIN, CALLED, CUT, ENDED, FAILED, FIRST, QUARANTINED};
use crate::learner::{Fate, Learner, Waited};
use crate::mapping::Mapping;
use crate::slot::{Answer, Command};
use crate::worker::index;

/// What the learner knows of one environment.
#[derive(Clone, Debug, Default)]
struct Env {
    /// An episode has begun and has neither ended nor been cut.
    is_running: bool,
    /// An episode was lost and the learner has not been told yet.
    is_cut: bool,
    /// The worker died after the answer that is still to be delivered.
    is_orphaned: bool,
    /// Episodes begun.
    episodes: u64,
    next_seed: Option<u64>,
    /// Last call that named this environment, to find one named twice.
    named_by: u64,
}

/// Counters of a pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Steps delivered.
    pub steps: u64,
    /// Episodes that ended and were delivered.
    pub episodes: u64,
    /// Episodes dropped because their worker died, they raised or they were quarantined.
    pub cut_episodes: u64,
    /// Episodes among those that showed a NaN.
    pub quarantined_episodes: u64,
    /// Incarnations of workers after their first.
    pub restarts: u64,
}

/// Rows of one array that go into the payloads of environments with a command.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// From the payload's start, in bytes.
    pub offset: usize,
    /// Size of a row.
    pub row_bytes: usize,
    /// All rows, one an environment.
    pub bytes: &'a [u8],
}

/// One learner's pool.
#[derive(Debug)]
pub struct Pool {
    learner: Learner,
    batch: BatchLayout,
    envs: Vec<Env>,
    /// From which seeds of episodes follow, if they are seeded.
    seed: Option<u64>,
    calls: u64,
    stats: Stats,
    /// Commands whose answers have not been filled into a block or taken as a notice.
    under_way: usize,
    /// What was filled last, and for whom.
    last: Option<(u64, Filled)>,
}

impl Pool {
    /// The one pool of fresh memory.
    ///
    /// # Errors
    /// [`Error::Argument`] for a leaf outside the observation, or memory that has a learner.
    pub fn new(mapping: Arc<Mapping>, leaves: Vec<Leaf>, seed: Option<u64>) -> Result<Self> {
        let batch = BatchLayout::new(mapping.layout(), leaves)?;
        let num_envs = mapping.layout().shape.num_envs();
        let mut pool = Self {
            learner: Learner::new(mapping)?,
            batch,
            envs: vec![Env::default(); num_envs],
            seed,
            calls: 0,
            stats: Stats::default(),
            under_way: 0,
            last: None,
        };
        for env in 0..num_envs {
            pool.envs[env].next_seed = pool.seed_by_rule(env);
        }
        Ok(pool)
    }

    /// The layout of the blocks that [`Pool::fill`] takes.
    #[must_use]
    pub const fn batch(&self) -> &BatchLayout {
        &self.batch
    }

    /// Counters so far.
    #[must_use]
    pub const fn stats(&self) -> Stats {
        self.stats
    }

    /// The shared memory.
    #[must_use]
    pub const fn mapping(&self) -> &Arc<Mapping> {
        self.learner.mapping()
    }

    /// Fixes the seeds of the episodes that the environments begin next; `None` leaves them to their own generators.
    ///
    /// # Errors
    /// [`Error::Label`] for an environment that does not exist, [`Error::Argument`] for one named twice.
    pub fn seed_next(&mut self, envs: &[i64], seeds: &[Option<u64>]) -> Result<()> {
        check_shape("seeds", &[envs.len()], &[seeds.len()])?;
        self.check(envs)?;
        for (&env, &seed) in envs.iter().zip(seeds) {
            self.env_mut(env).next_seed = seed;
        }
        Ok(())
    }

    /// Sets the rule for seeds: episode `n` of environment `e` gets a seed that follows from `seed`, `e` and `n`.
    pub fn reseed(&mut self, seed: Option<u64>) {
        self.seed = seed;
        for env in 0..self.envs.len() {
            self.envs[env].episodes = 0;
            self.envs[env].next_seed = self.seed_by_rule(env);
        }
    }

    /// Refuses environments that cannot be given a command now.
    ///
    /// # Errors
    /// [`Error::Label`] for one that does not exist, [`Error::Argument`] for one named twice, [`Error::Protocol`] for
    /// one that already has a command.
    pub fn check_held(&mut self, envs: &[i64]) -> Result<()> {
        self.check(envs)?;
        for &env in envs {
            self.learner.writable(place(env))?;
        }
        Ok(())
    }

    /// Writes rows into the payloads of held environments and blobs into theirs, gives each the command, and wakes their
    /// workers. There is a blob for each environment, one for all, or none.
    ///
    /// # Errors
    /// As [`Pool::check_held`]; [`Error::Argument`] or [`Error::Shape`] for rows or blobs that do not fit.
    pub fn send(
        &mut self,
        envs: &[i64],
        rows: &[Rows<'_>],
        code: u32,
        version: i64,
        blobs: &[&[u8]],
    ) -> Result<()> {
        self.check_held(envs)?;
        self.check_rows(envs.len(), rows)?;
        self.check_blobs(envs.len(), blobs)?;
        for (row, &env) in envs.iter().enumerate() {
            let payload = self.learner.writable(place(env))?;
            for part in rows {
                let source = &part.bytes[row * part.row_bytes..][..part.row_bytes];
                // SAFETY: `check_rows` made sure that the part lies within the payload, and the environment is held, so
                // its payload is the learner's.
                unsafe {
                    let target = payload.add(part.offset);
                    std::ptr::copy_nonoverlapping(source.as_ptr(), target, source.len());
                }
            }
            let blob = match blobs {
                [] => &[],
                [one] => *one,
                each => each[row],
            };
            // SAFETY: `check_blobs` made sure that it fits, and the blob too is the learner's while the slot is held.
            unsafe {
                let target = self.mapping().blob(place(env)).as_ptr();
                std::ptr::copy_nonoverlapping(blob.as_ptr(), target, blob.len());
            }
            self.ask(env, code, version, index(blob.len()))?;
        }
        self.learner.strike();
        Ok(())
    }

    /// Waits until `wanted` answers lie ready, for about `limit`.
    pub fn wait(&mut self, wanted: usize, limit: Duration) -> Waited {
        self.learner.wait(wanted, limit)
    }

    /// Waits and fills, once a ticket: a caller that did not get to see the result, because a signal came between, calls
    /// again with the ticket and the block of that call and is told again. Without a number it waits for all that are under
    /// way. `None` as for [`Waited::Paused`], and at once where so many are not under way.
    ///
    /// # Errors
    /// As [`Pool::fill`].
    pub fn receive(
        &mut self,
        block: &mut [u8],
        ticket: u64,
        wanted: Option<usize>,
        limit: Duration,
    ) -> Result<Option<Filled>> {
        if let Some(filled) = self.filled_for(ticket) {
            return Ok(Some(filled));
        }
        let wanted = wanted.unwrap_or(self.under_way);
        if !(1..=self.under_way).contains(&wanted) {
            return Ok(None);
        }
        if self.wait(wanted, limit) != Waited::Ready {
            return Ok(None);
        }
        let filled = self.fill(block)?;
        self.last = Some((ticket, filled));
        Ok(Some(filled))
    }

    /// What [`Pool::receive`] filled for this ticket.
    #[must_use]
    pub fn filled_for(&self, ticket: u64) -> Option<Filled> {
        let last = self.last.filter(|(whose, _)| *whose == ticket);
        last.map(|(_, filled)| filled)
    }

    /// Commands whose answers have not been received; those that were filled for `ticket` have not been either.
    #[must_use]
    pub fn under_way(&self, ticket: u64) -> usize {
        self.under_way + self.filled_for(ticket).map_or(0, |filled| filled.rows)
    }

    /// Whether a death or a notice waits to be seen to.
    #[must_use]
    pub fn has_news(&self) -> bool {
        self.learner.has_news()
    }

    /// Moves the answers that lie ready into a block.
    ///
    /// # Errors
    /// [`Error::Shape`] for a block of another size than [`BatchLayout::total`].
    pub fn fill(&mut self, block: &mut [u8]) -> Result<Filled> {
        let mut block = Block::new(&self.batch, block)?;
        let layout = self.learner.mapping().layout();
        let (observation, last) = (layout.observation, layout.final_observation);
        let mut begun = Vec::new();
        let (envs, stats) = (&mut self.envs, &mut self.stats);
        self.learner.take(|env, answer, payload| {
            let mut answer = *answer;
            answer.flags |= note(&mut envs[env], stats, answer.flags);
            if answer.flags & FIRST != 0 {
                begun.push(env);
            }
            // SAFETY: both observations lie within the payload, which is the learner's once the answer is taken.
            unsafe { block.push(env, &answer, payload.add(observation), payload.add(last)) };
        });
        let filled = block.filled;
        self.under_way -= filled.rows;
        for env in begun {
            self.envs[env].episodes += 1;
            self.envs[env].next_seed = self.seed_by_rule(env);
        }
        Ok(filled)
    }

    /// Takes the notices that lie ready: environments that failed or answered a call.
    pub fn take_notices(&mut self) -> Vec<(usize, Answer)> {
        let notices = self.learner.take_notices();
        self.under_way -= notices.len();
        for (env, answer) in &notices {
            note(&mut self.envs[*env], &mut self.stats, answer.flags);
        }
        notices
    }

    /// Whether the present incarnation of a worker has answered anything.
    #[must_use]
    pub fn has_answered(&self, worker: usize) -> bool {
        self.learner.has_answered(worker)
    }

    /// Prepares a dead worker's environments for its next incarnation and tells whose command or answer is lost. Those
    /// are asked to begin an episode where `again` says so, and have no command under way otherwise.
    ///
    /// # Errors
    /// None that [`Pool::send`] does not have; all these environments are held.
    ///
    /// # Safety
    /// The worker is dead, as for [`Learner::reclaim`].
    pub unsafe fn reclaim(&mut self, worker: usize, again: bool) -> Result<Vec<i64>> {
        let first = worker * self.mapping().layout().shape.envs_per_worker;
        // SAFETY: the caller knows that the worker is dead.
        let fates = unsafe { self.learner.reclaim(worker, |flags| flags & ENDED != 0) };
        self.stats.restarts += 1;
        let mut cut = Vec::new();
        for (local, fate) in fates.into_iter().enumerate() {
            let env = &mut self.envs[first + local];
            if fate == Fate::Kept {
                env.is_orphaned = true;
            } else {
                cut_episode(env, &mut self.stats);
            }
            if fate == Fate::Cut {
                cut.push(i64::try_from(first + local).unwrap_or(i64::MAX));
            }
        }
        self.under_way -= cut.len();
        if again {
            self.send(&cut, &[], BEGIN, 0, &[])?;
        }
        Ok(cut)
    }

    /// Gives a worker that is about to start until `limit` from now to take up its post.
    pub fn expect_start(&self, worker: usize, limit: Duration) {
        self.learner.expect_start(worker, limit);
    }

    /// Tells every worker to leave.
    pub fn close(&self) {
        self.mapping().close();
    }

    fn ask(&mut self, env: i64, code: u32, version: i64, blob_bytes: u32) -> Result<()> {
        let next_seed = self.env_mut(env).next_seed;
        let command = Command {
            code,
            version,
            next_seed,
            blob_bytes,
        };
        self.learner.ask(place(env), &command)?;
        self.under_way += 1;
        Ok(())
    }

    /// The seed of an environment's next episode: independent for each pair, the same for any number of workers.
    fn seed_by_rule(&self, env: usize) -> Option<u64> {
        let mixed = Rng::new(self.seed?).next_u64() ^ env as u64;
        let mixed = Rng::new(mixed).next_u64() ^ self.envs[env].episodes;
        // 31 bits: what the oldest generators that environments use take, and every integer type on the way.
        Some(Rng::new(mixed).next_u64() >> 33)
    }

    fn env_mut(&mut self, env: i64) -> &mut Env {
        &mut self.envs[place(env)]
    }

    /// Refuses environments that do not exist or are named twice.
    fn check(&mut self, envs: &[i64]) -> Result<()> {
        self.calls += 1;
        let limit = self.envs.len();
        for (index, &got) in envs.iter().enumerate() {
            let env = usize::try_from(got)
                .ok()
                .and_then(|env| self.envs.get_mut(env));
            let Some(env) = env else {
                return Err(Error::Label {
                    field: "env_ids",
                    index,
                    limit,
                    got,
                });
            };
            if std::mem::replace(&mut env.named_by, self.calls) == self.calls {
                return Err(Error::Argument {
                    field: "env_ids",
                    expected: "every environment at most once".into(),
                    got: format!("environment {got} twice"),
                });
            }
        }
        Ok(())
    }

    fn check_blobs(&self, count: usize, blobs: &[&[u8]]) -> Result<()> {
        if blobs.len() > 1 {
            check_shape("blobs", &[count], &[blobs.len()])?;
        }
        let limit = self.mapping().layout().shape.blob_bytes;
        let largest = blobs.iter().map(|blob| blob.len()).max().unwrap_or(0);
        if largest <= limit && u32::try_from(largest).is_ok() {
            return Ok(());
        }
        Err(Error::Argument {
            field: "info_bytes",
            expected: format!("at least the {largest} bytes that a command needs"),
            got: limit.to_string(),
        })
    }

    fn check_rows(&self, count: usize, rows: &[Rows<'_>]) -> Result<()> {
        let limit = self.mapping().layout().payload_stride;
        for part in rows {
            let bytes = count.saturating_mul(part.row_bytes);
            check_shape("actions", &[bytes], &[part.bytes.len()])?;
            let end = part.offset.checked_add(part.row_bytes);
            if end.is_none_or(|end| end > limit) {
                return Err(Error::Argument {
                    field: "actions",
                    expected: format!("a part of a payload of {limit} bytes"),
                    got: format!("{} bytes at {}", part.row_bytes, part.offset),
                });
            }
        }
        Ok(())
    }
}

/// Counts an answer and returns the bits that the learner's knowledge adds to it.
fn note(env: &mut Env, stats: &mut Stats, flags: u32) -> u32 {
    if flags & CALLED != 0 {
        return 0;
    }
    if flags & (CUT | FAILED) != 0 {
        stats.quarantined_episodes += u64::from(flags & QUARANTINED != 0);
        cut_episode(env, stats);
    }
    if flags & FAILED != 0 {
        return 0;
    }
    let (is_first, has_ended) = (flags & FIRST != 0, flags & ENDED != 0);
    // A first observation without an end before it belongs to no step.
    stats.steps += u64::from(has_ended || !is_first);
    stats.episodes += u64::from(has_ended);
    env.is_running = is_first || (env.is_running && !has_ended);
    // A cut is told with the next episode's first observation.
    let told = if is_first && std::mem::take(&mut env.is_cut) {
        CUT
    } else {
        0
    };
    if std::mem::take(&mut env.is_orphaned) {
        cut_episode(env, stats);
    }
    told
}

/// The running episode, if there is one, is lost.
fn cut_episode(env: &mut Env, stats: &mut Stats) {
    if std::mem::take(&mut env.is_running) {
        env.is_cut = true;
        stats.cut_episodes += 1;
    }
}

fn place(env: i64) -> usize {
    usize::try_from(env).unwrap_or(usize::MAX)
}
