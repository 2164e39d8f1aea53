//! Stacked frames as channels, against an index for every byte.

use proptest::prelude::*;
use vhs_core::storage::stacking::stack_channels;

proptest! {
    #[test]
    fn every_byte_lands_where_its_index_says(
        count in 0usize..4, stack in 1usize..4, pixels in 1usize..9, colours in 1usize..6,
        seed in any::<u8>(),
    ) {
        let bytes = count * stack * pixels * colours;
        let source: Vec<u8> = (0u8..=255)
            .cycle()
            .map(|byte| byte.wrapping_mul(31).wrapping_add(seed))
            .take(bytes)
            .collect();
        let mut out = vec![0; bytes];
        stack_channels(&source, [count, stack, pixels, colours], &mut out).expect("a fitting shape");
        for n in 0..count { for s in 0..stack { for p in 0..pixels { for c in 0..colours {
            let from = ((n * stack + s) * pixels + p) * colours + c;
            let to = ((n * pixels + p) * stack + s) * colours + c;
            prop_assert_eq!(out[to], source[from]);
        }}}}
    }
}

#[test]
fn lengths_that_do_not_fit_are_refused() {
    let mut out = [0; 6];
    assert!(stack_channels(&[0; 5], [1, 2, 3, 1], &mut out).is_err());
    assert!(stack_channels(&[0; 6], [1, 2, 3, 1], &mut out[..5]).is_err());
    assert!(stack_channels(&[0; 6], [usize::MAX, 2, 3, 1], &mut out).is_err());
}
