//! Discounted returns against their definition as a sum.

use proptest::prelude::*;
use vhs_core::returns::{discounted_returns, discounted_returns_into};

use crate::support::naive;

proptest! {
    #[test]
    fn returns_are_the_discounted_sums(
        rows in prop::collection::vec((prop::collection::vec(-10.0..10.0_f32, 7), 0..=7_i64), 0..6),
        gamma in 0.0..=1.0_f64,
    ) {
        let rewards: Vec<f32> = rows.iter().flat_map(|(rewards, _)| rewards.clone()).collect();
        let lengths: Vec<i64> = rows.iter().map(|(_, length)| *length).collect();
        let found = discounted_returns(&rewards, 7, &lengths, gamma).expect("valid episodes");
        let expected = naive::returns(&rewards, 7, &lengths, gamma);
        prop_assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            prop_assert!((f64::from(*found) - expected).abs() < 1e-5 * (1.0 + expected.abs()));
        }
    }
}

#[test]
fn padding_is_neither_read_nor_kept() {
    let returns =
        discounted_returns(&[1.0, f32::NAN], 2, &[1], 0.9).expect("NaN lies after the end");
    assert_eq!(returns, [1.0, 0.0]);
}

#[test]
fn what_was_in_the_callers_memory_is_gone() {
    let mut out = [9.0; 3];
    discounted_returns_into(&[1.0, 1.0, 1.0], 3, &[1], 0.9, &mut out).expect("a valid episode");
    assert_eq!(out.to_vec(), [1.0, 0.0, 0.0]);
}
