//! What commands ask and answers say: codes and bits that learner and workers agree on.

/// Take the action in the payload; begins an episode instead where none runs.
pub const STEP: u32 = 0;
/// Begin an episode now, with the options in the blob, if any.
pub const BEGIN: u32 = 1;
/// Call a method of the environment: its pickled name and arguments lie in the blob.
pub const CALL: u32 = 2;

/// The episode ended in a terminal state of the task.
pub const TERMINATED: u32 = 1;
/// The episode was ended for another reason, such as its length.
pub const TRUNCATED: u32 = 1 << 1;
/// The observation is the first of an episode.
pub const FIRST: u32 = 1 << 2;
/// The payload's final observation is that of the episode that ended.
pub const FINAL: u32 = 1 << 3;
/// The episode that ran before this answer was cut: its worker died, it raised or it was quarantined. It is to be dropped.
pub const CUT: u32 = 1 << 4;
/// The episode showed a NaN and was ended by the worker; always with [`CUT`].
pub const QUARANTINED: u32 = 1 << 5;
/// The environment raised; the pickled error lies in the blob.
pub const FAILED: u32 = 1 << 6;
/// The blob holds pickled infos or the result of a call.
pub const BLOB: u32 = 1 << 7;
/// The answer is the result of a [`CALL`]; no step was taken.
pub const CALLED: u32 = 1 << 8;
/// An observation was found outside its space, of those that are looked at.
pub const OUTSIDE: u32 = 1 << 9;

/// The bits of an answer that is not a row of a batch but a notice: somebody has to see to it first.
pub const NOTICE: u32 = FAILED | CALLED;
/// The bits of an answer that ends an episode regularly.
pub const ENDED: u32 = TERMINATED | TRUNCATED;
/// The bits that a reader has to look at one row after another.
pub const NOTABLE: u32 = CUT | QUARANTINED | BLOB | OUTSIDE;
