//! Dead reckoning against walks that are simulated forwards, in a world of their own.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;
use vhs_core::egomotion::{Walks, egomotion};
use vhs_core::error::Error;

const LONGEST: usize = 7;

/// x and y in metres, yaw in radians.
type Pose = (f64, f64, f64);

/// Every pose of a walk from (x, y, yaw), the last one included.
fn walked(start: Pose, moves: &[f32], actions: &[(usize, bool)]) -> Vec<Pose> {
    let mut poses = vec![start];
    for &(action, blocked) in actions {
        let (x, y, yaw) = poses[poses.len() - 1];
        let [forward, left, turn] = [0, 1, 2].map(|part| f64::from(moves[3 * action + part]));
        let free = f64::from(u8::from(!blocked));
        poses.push((
            x + free * (forward * yaw.cos() - left * yaw.sin()),
            y + free * (forward * yaw.sin() + left * yaw.cos()),
            yaw + turn,
        ));
    }
    poses
}

proptest! {
    /// From the pose of each step, walking its distance along its bearing leads to what lies ahead of the end.
    #[test]
    fn every_step_points_at_the_same_place(
        moves in prop::collection::vec((-1.0..1.0_f32, -1.0..1.0_f32, -3.0..3.0_f32), 4),
        walks in prop::collection::vec(prop::collection::vec((0..4_usize, any::<bool>()), 0..=LONGEST), 0..5),
        (x, y, yaw) in (-3.0..3.0_f64, -3.0..3.0_f64, -PI..PI),
        ahead_m in 0.0..2.0_f64,
    ) {
        let moves: Vec<f32> = moves.iter().flat_map(|&(forward, left, turn)| [forward, left, turn]).collect();
        // Numbers that must not be read lie after each end.
        let mut actions = vec![-1; walks.len() * LONGEST];
        let mut blocked = vec![true; walks.len() * LONGEST];
        for (row, walk) in walks.iter().enumerate() {
            for (step, &(action, is_blocked)) in walk.iter().enumerate() {
                actions[row * LONGEST + step] = i64::try_from(action).expect("small");
                blocked[row * LONGEST + step] = is_blocked;
            }
        }
        let lengths: Vec<i64> = walks.iter().map(|walk| i64::try_from(walk.len()).expect("small")).collect();
        let padded = Walks { actions: &actions, blocked: &blocked, lengths: &lengths, longest: LONGEST };
        let found = egomotion(padded, &moves, ahead_m).expect("valid walks");
        for (row, walk) in walks.iter().enumerate() {
            let poses = walked((x, y, yaw), &moves, walk);
            let end = poses[poses.len() - 1];
            let target = (end.0 + ahead_m * end.2.cos(), end.1 + ahead_m * end.2.sin());
            for (step, &(x, y, yaw)) in poses[..walk.len()].iter().enumerate() {
                let bearing = f64::from(found.bearing_rad[row * LONGEST + step]);
                let distance = f64::from(found.distance_m[row * LONGEST + step]);
                prop_assert!((-PI - 1e-6..=PI + 1e-6).contains(&bearing));
                let there = (x + distance * (yaw + bearing).cos(), y + distance * (yaw + bearing).sin());
                prop_assert!((there.0 - target.0).hypot(there.1 - target.1) < 1e-4);
            }
            let after = row * LONGEST + walk.len()..(row + 1) * LONGEST;
            for numbers in [&found.bearing_rad[after.clone()], &found.distance_m[after]] {
                prop_assert!(numbers.iter().all(|number| number.to_bits() == 0));
            }
        }
    }

    /// Turning round on the spot brings the end back where it was.
    #[test]
    fn a_full_circle_changes_nothing(parts in 1..9_u8, ahead_m in 0.1..2.0_f64) {
        #[expect(clippy::cast_possible_truncation, reason = "moves are f32")]
        let turn = (TAU / f64::from(parts)) as f32;
        let count = usize::from(parts);
        let walks = Walks {
            actions: &vec![0; count],
            blocked: &vec![false; count],
            lengths: &[i64::from(parts)],
            longest: count,
        };
        let found = egomotion(walks, &[0.0, 0.0, turn], ahead_m).expect("a valid walk");
        prop_assert!(found.bearing_rad[0].abs() < 1e-5);
        prop_assert!((f64::from(found.distance_m[0]) - ahead_m).abs() < 1e-5);
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let walks = |actions: &'static [i64], blocked, lengths| Walks {
        actions,
        blocked,
        lengths,
        longest: 2,
    };
    let good = walks(&[0, 1], &[false; 2], &[2]);
    let moves = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let refused = [
        egomotion(walks(&[0], &[false; 2], &[2]), &moves, 0.0),
        egomotion(walks(&[0, 1], &[false], &[2]), &moves, 0.0),
        egomotion(good, &moves[..5], 0.0),
    ];
    for error in refused {
        assert!(matches!(error, Err(Error::Shape { .. })), "{error:?}");
    }
    let beyond = egomotion(walks(&[0, 2], &[false; 2], &[2]), &moves, 0.0);
    assert!(
        matches!(
            beyond,
            Err(Error::Label {
                field: "actions",
                index: 1,
                limit: 2,
                got: 2
            })
        ),
        "{beyond:?}"
    );
    let long = egomotion(walks(&[0, 1], &[false; 2], &[3]), &moves, 0.0);
    assert!(
        matches!(
            long,
            Err(Error::Label {
                field: "lengths",
                ..
            })
        ),
        "{long:?}"
    );
    let nan = egomotion(good, &[1.0, f32::NAN, 0.0, 0.0, 0.0, 1.0], 0.0);
    assert!(
        matches!(
            nan,
            Err(Error::NonFinite {
                field: "moves",
                index: 1,
                ..
            })
        ),
        "{nan:?}"
    );
    for ahead_m in [-1.0, f64::NAN, f64::INFINITY] {
        let error = egomotion(good, &moves, ahead_m).expect_err("no distance");
        assert!(
            error.to_string().starts_with("`ahead_m`: expected"),
            "{error}"
        );
    }
}
