//! Prototypes against means taken class by class in double precision.

use proptest::prelude::*;
use vhs_core::prototypes::Prototypes;
use vhs_core::rng::Rng;

use crate::support::naive;

const DIM: usize = 3;

fn batches() -> impl Strategy<Value = Vec<Vec<(usize, Vec<f32>)>>> {
    let row = (0..4_usize, prop::collection::vec(-2.0..2.0_f32, DIM));
    prop::collection::vec(prop::collection::vec(row, 0..9), 1..6)
}

fn update(prototypes: &mut Prototypes, batch: &[(usize, Vec<f32>)]) {
    let features: Vec<f32> = batch.iter().flat_map(|(_, row)| row.clone()).collect();
    let labels: Vec<i64> = batch
        .iter()
        .map(|(label, _)| i64::try_from(*label).expect("small"))
        .collect();
    prototypes
        .update(&features, &labels)
        .expect("a valid batch");
}

proptest! {
    #[test]
    fn the_table_is_the_running_mean(batches in batches(), momentum in 0.0..=1.0_f64) {
        let mut prototypes = Prototypes::new(4, DIM, momentum, 0).expect("valid sizes");
        let (mut table, mut seen) = (vec![vec![0.0; DIM]; 4], vec![false; 4]);
        for batch in &batches {
            update(&mut prototypes, batch);
            naive::update(&mut table, &mut seen, momentum, batch);
            prop_assert_eq!(prototypes.seen(), &seen[..]);
            for (found, expected) in prototypes.table().iter().zip(table.iter().flatten()) {
                // The table rounds to single precision after each batch.
                prop_assert!((f64::from(*found) - expected).abs() < 2e-6, "{} {}", found, expected);
            }
        }
    }

    #[test]
    fn seen_classes_embed_as_their_row_and_others_as_noise(batches in batches(), seed: u64) {
        let mut prototypes = Prototypes::new(4, DIM, 0.5, seed).expect("valid sizes");
        for batch in &batches {
            update(&mut prototypes, batch);
        }
        let (first, second) = (prototypes.embed(&[0, 1, 2, 3]), prototypes.embed(&[0, 1, 2, 3]));
        let (first, second) = (first.expect("valid labels"), second.expect("valid labels"));
        for class in 0..4 {
            let rows = class * DIM..(class + 1) * DIM;
            prop_assert_eq!(first[rows.clone()] == second[rows.clone()], prototypes.seen()[class]);
            if prototypes.seen()[class] {
                prop_assert_eq!(&first[rows.clone()], &prototypes.table()[rows]);
            }
        }
    }

    /// A restored table goes on exactly as the one it was taken from.
    #[test]
    fn a_restored_table_goes_on_alike(batches in batches(), seed: u64) {
        let mut prototypes = Prototypes::new(4, DIM, 0.9, seed).expect("valid sizes");
        for batch in &batches {
            update(&mut prototypes, batch);
        }
        prototypes.embed(&[0, 3]).expect("valid labels");
        let mut other = Prototypes::new(4, DIM, 0.9, seed ^ 1).expect("valid sizes");
        let rng = Rng::from_state(prototypes.rng().state()).expect("a state");
        other.restore(prototypes.table(), prototypes.seen(), rng).expect("the same sizes");
        prop_assert_eq!(other.embed(&[0, 1, 2, 3]).ok(), prototypes.embed(&[0, 1, 2, 3]).ok());
    }
}

#[test]
fn momentum_zero_is_the_exact_mean_of_the_last_batch() {
    let mut prototypes = Prototypes::new(1, 1, 0.0, 0).expect("valid sizes");
    prototypes.update(&[100.0], &[0]).expect("a valid batch");
    prototypes
        .update(&[1.0, 2.0, 6.0], &[0, 0, 0])
        .expect("a valid batch");
    assert_eq!(prototypes.table(), [3.0]);
}
