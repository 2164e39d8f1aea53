//! Everything may be sent to, and shared between, threads; readers may draw side by side.

use std::thread;

use vhs_core::episodes::EpisodeBuffer;
use vhs_core::goals::GoalStore;
use vhs_core::outcome::Outcome;
use vhs_core::pool::Bytes;
use vhs_core::prototypes::Prototypes;
use vhs_core::reward::SparseReward;
use vhs_core::rng::Rng;
use vhs_core::strategy::{HindsightRule, Share, Strategy};
use vhs_core::transitions::TransitionDraw;

use crate::episodes::Pair;

const fn is_shareable<T: Send + Sync>() {}

/// Does not compile where one of them is not.
const _: () = {
    is_shareable::<EpisodeBuffer>();
    is_shareable::<GoalStore>();
    is_shareable::<Prototypes>();
    is_shareable::<Bytes>();
    is_shareable::<Rng>();
};

#[test]
fn readers_side_by_side_draw_what_each_would_draw_alone() {
    let mut pair = Pair::new(2, 12);
    for _ in 0..4 {
        pair.begin(0, 1, 1);
        pair.append(&[0], 4, 0.5);
        pair.append(&[0], 2, 0.5);
        pair.finish(0, Outcome::Failure);
    }
    let (buffer, rewards) = (&pair.buffer, SparseReward::default());
    let rule = HindsightRule::new(Strategy::Random, Share::Probability(0.5)).expect("valid");
    let query = TransitionDraw {
        n: 16,
        rule: Some(&rule),
        reward: Some(&rewards),
        ..TransitionDraw::default()
    };
    let draw = |seed| {
        let mut rng = Rng::new(seed);
        let batches = (0..20).map(|_| buffer.sample_transitions_with(&query, &mut rng));
        batches
            .collect::<Result<Vec<_>, _>>()
            .expect("episodes are stored")
    };
    let alone: Vec<_> = (0..4).map(draw).collect();
    let together: Vec<_> = thread::scope(|scope| {
        let readers: Vec<_> = (0..4).map(|seed| scope.spawn(move || draw(seed))).collect();
        let results = readers.into_iter().map(thread::ScopedJoinHandle::join);
        results.map(|result| result.expect("no panic")).collect()
    });
    assert_eq!(alone, together);
}

#[test]
fn what_a_function_gives_is_taken_whole_or_not_at_all() {
    let mut pair = Pair::new(2, 12);
    pair.begin(0, 1, 1);
    pair.append(&[0], 4, 0.5);
    pair.finish(0, Outcome::Failure);
    let rule = HindsightRule::new(Strategy::Final, Share::Probability(1.0)).expect("valid");
    let draw = TransitionDraw {
        n: 2,
        rule: Some(&rule),
        ..TransitionDraw::default()
    };
    let batch = pair.buffer.sample_transitions_with(&draw, &mut Rng::new(0));
    let mut index = batch.expect("an episode is stored").index;
    let before = index.clone();
    assert!(index.set_relabelled(&[7.0; 2], Some(&[true])).is_err());
    assert!(
        index
            .set_relabelled(&[f32::NAN; 2], Some(&[true; 2]))
            .is_err()
    );
    assert_eq!(index, before);
    index
        .set_relabelled(&[7.0; 2], Some(&[true; 2]))
        .expect("two of each");
    assert_eq!(
        (index.rewards, index.terminated),
        (vec![7.0; 2], vec![true; 2])
    );
}
