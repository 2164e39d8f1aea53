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
    let draw = |seed| {
        let mut rng = Rng::new(seed);
        let batches = (0..20)
            .map(|_| buffer.sample_transitions_with(16, Some(&rule), Some(&rewards), &mut rng));
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
