//! Dead reckoning: where the end of an episode lay, seen from each of its steps.
//!
//! A pose looks along its own x axis, y is to its left. An action first moves the pose and then turns it, to
//! the left where the angle is positive; what it does is known (`moves`), so the way can be walked backwards
//! from the end. No map and no state of an environment is needed.

use crate::labels::class_of;
use vhs_base::check::{self, check_finite, check_labels, check_shape};
use vhs_base::error::{Error, Result};

/// Numbers of a move: metres forward, metres to the left, radians to the left.
const MOVE: usize = 3;

/// Episodes of numbered actions, padded to `longest` steps.
#[derive(Clone, Copy, Debug)]
pub struct Walks<'a> {
    /// Actions, `[B, longest]`; what lies after an episode's end is not read.
    pub actions: &'a [i64],
    /// Steps that went nowhere, `[B, longest]`: their way is not counted, their turn is.
    pub blocked: &'a [bool],
    /// Steps of each episode, `[B]`, in `0..=longest`.
    pub lengths: &'a [i64],
    /// Steps of a row.
    pub longest: usize,
}

/// Where something lay at the beginning of each step, `[B, longest]`; zero after the end of an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bearings {
    /// Radians in `-pi..=pi`: 0 straight ahead, positive to the left.
    pub bearing_rad: Vec<f32>,
    /// Metres.
    pub distance_m: Vec<f32>,
}

/// Bearing and distance, at each step, of the point `ahead_m` metres in front of an episode's last pose.
///
/// `moves` says what each action does, one after the other: metres forward, metres to the left, then radians
/// to the left.
///
/// ```
/// use std::f32::consts::FRAC_PI_2;
/// use vhs_core::egomotion::{egomotion, Walks};
/// // Action 0 strides a metre, action 1 turns left.
/// let moves = [1.0, 0.0, 0.0, 0.0, 0.0, FRAC_PI_2];
/// let walks = Walks { actions: &[1, 0], blocked: &[false; 2], lengths: &[2], longest: 2 };
/// let found = egomotion(walks, &moves, 0.0)?;
/// assert!((found.bearing_rad[0] - FRAC_PI_2).abs() < 1e-6); // before the turn the end lay to the left
/// assert!((found.distance_m[1] - 1.0).abs() < 1e-6);
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
///
/// # Errors
/// [`Error::Shape`] where an array does not fit `lengths`, [`Error::Label`] for a length above `longest` or an
/// action without a move, [`Error::NonFinite`] for a move, [`Error::Argument`] for an `ahead_m` that is not a
/// finite number of at least 0.
pub fn egomotion(walks: Walks<'_>, moves: &[f32], ahead_m: f64) -> Result<Bearings> {
    walks.check(moves, ahead_m)?;
    let cells = walks.actions.len();
    let mut found = Bearings {
        bearing_rad: check::with_room("egomotion", cells)?,
        distance_m: check::with_room("egomotion", cells)?,
    };
    found.bearing_rad.resize(cells, 0.0);
    found.distance_m.resize(cells, 0.0);
    for (row, &length) in walks.lengths.iter().enumerate() {
        let start = row * walks.longest;
        let steps = start..start + class_of(length);
        let (mut ahead, mut left) = (ahead_m, 0.0);
        for step in steps.rev() {
            let action = MOVE * class_of(walks.actions[step]);
            let way = if walks.blocked[step] {
                [0.0, 0.0]
            } else {
                [moves[action], moves[action + 1]].map(f64::from)
            };
            let (sin, cos) = f64::from(moves[action + 2]).sin_cos();
            (ahead, left) = (
                cos * ahead - sin * left + way[0],
                sin * ahead + cos * left + way[1],
            );
            (found.bearing_rad[step], found.distance_m[step]) = polar(ahead, left);
        }
    }
    Ok(found)
}

impl Walks<'_> {
    fn check(&self, moves: &[f32], ahead_m: f64) -> Result<()> {
        let cells = check::product("lengths", &[self.lengths.len(), self.longest])?;
        check_shape("actions", &[cells], &[self.actions.len()])?;
        check_shape("blocked", &[cells], &[self.blocked.len()])?;
        check_shape(
            "moves",
            &[moves.len() / MOVE, MOVE],
            &[moves.len().div_ceil(MOVE), MOVE],
        )?;
        check_finite("moves", moves)?;
        check_labels("lengths", self.lengths, self.longest + 1)?;
        if !(ahead_m.is_finite() && ahead_m >= 0.0) {
            return Err(Error::Argument {
                field: "ahead_m",
                expected: "a finite number of at least 0".into(),
                got: ahead_m.to_string(),
            });
        }
        for (row, &length) in self.lengths.iter().enumerate() {
            let start = row * self.longest;
            let steps = &self.actions[start..start + class_of(length)];
            check_labels("actions", steps, moves.len() / MOVE).map_err(|error| match error {
                Error::Label {
                    field,
                    index,
                    limit,
                    got,
                } => Error::Label {
                    field,
                    index: start + index,
                    limit,
                    got,
                },
                other => other,
            })?;
        }
        Ok(())
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a rounding to f32 is meant"
)]
fn polar(ahead: f64, left: f64) -> (f32, f32) {
    (left.atan2(ahead) as f32, ahead.hypot(left) as f32)
}
