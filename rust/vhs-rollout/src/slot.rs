//! Slots: one an environment, whose bytes belong to exactly one process at a time.
//!
//! Life of a slot: Held (learner) -> Asked (in the command ring) -> Stepping (worker) -> Ready (in the ready ring) -> Held.
//! Whoever made the transition into Held or Stepping may touch the slot's bytes, nobody else. The state lies in one word
//! together with the sequence number of the command and the epoch of the worker, its how-manieth incarnation: a command
//! or an answer of an earlier incarnation does not match and is ignored.
//!
//! After a death, and only then, the supervisor takes the slot from whatever state it is in ([`Slot::reclaim`]).
//!
//! The fields beside the word are atomics used with Relaxed: the word's Release and Acquire order them.

use crate::sync::{AtomicU32, AtomicU64, Ordering};

/// Where a slot is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// The learner's: it may read the last answer and write the next command.
    Held = 0,
    /// A command lies in it; nobody touches its bytes.
    Asked = 1,
    /// The worker's: it steps the environment and writes the answer.
    Stepping = 2,
    /// An answer lies in it; nobody touches its bytes.
    Ready = 3,
}

/// Incarnation of a worker, in 0..2^24, wrapping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Epoch(u32);

impl Epoch {
    const LIMIT: u32 = 1 << 24;

    /// The epoch of this number, modulo 2^24.
    #[must_use]
    pub const fn new(number: u32) -> Self {
        Self(number % Self::LIMIT)
    }

    /// The next incarnation.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::new(self.0 + 1)
    }

    /// The number.
    #[must_use]
    pub const fn number(self) -> u32 {
        self.0
    }
}

/// Contents of a slot's word: state in bits 0..8, sequence in 8..40, epoch in 40..64.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Word {
    state: State,
    sequence: u32,
    epoch: Epoch,
}

impl Word {
    const fn pack(self) -> u64 {
        self.state as u64 | (self.sequence as u64) << 8 | (self.epoch.0 as u64) << 40
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "the fields are cut out of the word"
    )]
    const fn unpack(word: u64) -> Self {
        let state = match word & 0xFF {
            0 => State::Held,
            1 => State::Asked,
            2 => State::Stepping,
            _ => State::Ready,
        };
        let (sequence, epoch) = ((word >> 8) as u32, Epoch((word >> 40) as u32));
        Self {
            state,
            sequence,
            epoch,
        }
    }
}

/// What the learner asks of an environment; the action's bytes lie in the slot's payload.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Command {
    /// What to do; the meaning of the bits is the binding's.
    pub code: u32,
    /// Which policy chose the action.
    pub version: i64,
    /// Seed of the next episode that begins, if it is to be seeded.
    pub next_seed: Option<u64>,
    /// Length of the pickled part in the slot's blob, in bytes.
    pub blob_bytes: u32,
}

/// What an environment answers; observations lie in the slot's payload.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answer {
    /// What happened; the meaning of the bits is the binding's.
    pub flags: u32,
    /// Reward of the step, in the environment's scale; 0 for a beginning.
    pub reward: f64,
    /// Steps taken in the episode that the answer's step belongs to.
    pub step: u32,
    /// Seed of the episode that runs after this answer; 0 when unseeded.
    pub seed: u64,
    /// Length of the pickled part in the slot's blob, in bytes.
    pub blob_bytes: u32,
    /// Which policy chose the action: the command's, given back.
    pub version: i64,
}

/// The shared part of one environment, two cache lines; the payload lies elsewhere in the mapping.
#[repr(C, align(128))]
#[derive(Debug)]
pub struct Slot {
    word: AtomicU64,
    version: AtomicU64,
    next_seed: AtomicU64,
    reward_bits: AtomicU64,
    seed: AtomicU64,
    has_next_seed: AtomicU32,
    code: AtomicU32,
    blob_bytes: AtomicU32,
    flags: AtomicU32,
    step: AtomicU32,
}

/// A call that the slot's state does not allow: the state found.
pub type Refused = State;

impl Slot {
    /// A slot held by the learner, for a worker's first incarnation.
    #[must_use]
    pub fn new() -> Self {
        Self {
            word: AtomicU64::new(0),
            version: AtomicU64::new(0),
            next_seed: AtomicU64::new(0),
            reward_bits: AtomicU64::new(0),
            seed: AtomicU64::new(0),
            has_next_seed: AtomicU32::new(0),
            code: AtomicU32::new(0),
            blob_bytes: AtomicU32::new(0),
            flags: AtomicU32::new(0),
            step: AtomicU32::new(0),
        }
    }

    /// The present state.
    #[must_use]
    pub fn state(&self) -> State {
        self.load().state
    }

    /// Commands ever asked of this slot, wrapping.
    #[must_use]
    pub fn sequence(&self) -> u32 {
        self.load().sequence
    }

    /// Held -> Asked, by the learner, which has written the payload before.
    ///
    /// # Errors
    /// The state, when the slot is not held.
    pub fn ask(&self, command: &Command) -> Result<(), Refused> {
        let word = self.load();
        if word.state != State::Held {
            return Err(word.state);
        }
        self.code.store(command.code, Ordering::Relaxed);
        self.version
            .store(command.version.cast_unsigned(), Ordering::Relaxed);
        self.next_seed
            .store(command.next_seed.unwrap_or_default(), Ordering::Relaxed);
        self.has_next_seed
            .store(u32::from(command.next_seed.is_some()), Ordering::Relaxed);
        self.blob_bytes.store(command.blob_bytes, Ordering::Relaxed);
        let asked = Word {
            state: State::Asked,
            sequence: word.sequence.wrapping_add(1),
            ..word
        };
        // A plain store will do: out of Held, only the learner moves. Release: the worker's claim must see the command.
        self.word.store(asked.pack(), Ordering::Release);
        Ok(())
    }

    /// Asked -> Stepping, by the worker of this epoch.
    ///
    /// # Errors
    /// The state, when nothing is asked or another epoch's worker is meant.
    pub fn claim(&self, epoch: Epoch) -> Result<Command, Refused> {
        // Acquire: pairs with the Release of `ask`.
        self.advance(epoch, State::Asked, State::Stepping, Ordering::Acquire)?;
        let seed = self.next_seed.load(Ordering::Relaxed);
        let has_seed = self.has_next_seed.load(Ordering::Relaxed) != 0;
        Ok(Command {
            code: self.code.load(Ordering::Relaxed),
            version: self.version.load(Ordering::Relaxed).cast_signed(),
            next_seed: has_seed.then_some(seed),
            blob_bytes: self.blob_bytes.load(Ordering::Relaxed),
        })
    }

    /// Stepping -> Ready, by the worker that claimed, which has written the payload before.
    ///
    /// # Errors
    /// The state, when this worker does not hold the slot.
    pub fn commit(&self, epoch: Epoch, answer: &Answer) -> Result<(), Refused> {
        let word = self.load();
        if word.state != State::Stepping || word.epoch != epoch {
            return Err(word.state);
        }
        self.flags.store(answer.flags, Ordering::Relaxed);
        self.reward_bits
            .store(answer.reward.to_bits(), Ordering::Relaxed);
        self.step.store(answer.step, Ordering::Relaxed);
        self.seed.store(answer.seed, Ordering::Relaxed);
        self.blob_bytes.store(answer.blob_bytes, Ordering::Relaxed);
        // Release: the learner's take must see answer and payload.
        self.advance(epoch, State::Stepping, State::Ready, Ordering::Release)
    }

    /// Ready -> Held, by the learner.
    ///
    /// # Errors
    /// The state, when no answer of this epoch lies in the slot.
    pub fn take(&self, epoch: Epoch) -> Result<Answer, Refused> {
        // Acquire: pairs with the Release of `commit`.
        self.advance(epoch, State::Ready, State::Held, Ordering::Acquire)?;
        Ok(Answer {
            flags: self.flags.load(Ordering::Relaxed),
            reward: f64::from_bits(self.reward_bits.load(Ordering::Relaxed)),
            step: self.step.load(Ordering::Relaxed),
            seed: self.seed.load(Ordering::Relaxed),
            blob_bytes: self.blob_bytes.load(Ordering::Relaxed),
            version: self.version.load(Ordering::Relaxed).cast_signed(),
        })
    }

    /// Flags of an answer that lies in the slot or has just been taken out of it.
    #[must_use]
    pub fn flags(&self) -> u32 {
        self.flags.load(Ordering::Relaxed)
    }

    /// Gives the slot to the worker's next incarnation, whatever its state, and tells that state.
    ///
    /// An answer stays Ready if `keep` says so of its flags, everything else becomes Held.
    ///
    /// # Safety
    /// The worker is dead, and only its supervisor calls this: nobody else moves the word meanwhile, or writes into a
    /// payload that is the learner's from then on.
    pub unsafe fn reclaim(&self, epoch: Epoch, keep: impl FnOnce(u32) -> bool) -> State {
        // Acquire: an answer that the dead worker committed is seen whole.
        let word = Word::unpack(self.word.load(Ordering::Acquire));
        let is_kept = word.state == State::Ready && keep(self.flags());
        let state = if is_kept { State::Ready } else { State::Held };
        let reclaimed = Word {
            state,
            epoch,
            ..word
        };
        self.word.store(reclaimed.pack(), Ordering::Release);
        word.state
    }

    fn load(&self) -> Word {
        Word::unpack(self.word.load(Ordering::Relaxed))
    }

    fn advance(
        &self,
        epoch: Epoch,
        from: State,
        to: State,
        success: Ordering,
    ) -> Result<(), Refused> {
        let word = self.load();
        if word.state != from || word.epoch != epoch {
            return Err(word.state);
        }
        let next = Word { state: to, ..word };
        // Compare-and-exchange although one process alone makes each transition: of two that claim wrongly, one loses.
        self.word
            .compare_exchange(word.pack(), next.pack(), success, Ordering::Relaxed)
            .map(drop)
            .map_err(|found| Word::unpack(found).state)
    }
}

impl Default for Slot {
    fn default() -> Self {
        Self::new()
    }
}
