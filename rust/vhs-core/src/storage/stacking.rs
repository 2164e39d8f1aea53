//! Stacked frames as the channels of one picture: the layout in which convolutions read them.

use vhs_base::check::{self, check_shape};
use vhs_base::error::Result;

/// Interleaves the frames of observations, `[N, stack, pixels, colours]` to `[N, pixels, stack * colours]`.
///
/// `shape` is `[N, stack, pixels, colours]`; `out` has as many bytes as `observations`.
///
/// ```
/// use vhs_core::frames::stack_channels;
/// let mut out = [0; 6];
/// // One observation of two frames of three grey pixels.
/// stack_channels(&[1, 2, 3, 7, 8, 9], [1, 2, 3, 1], &mut out)?;
/// assert_eq!(out, [1, 7, 2, 8, 3, 9]);
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
///
/// # Errors
/// [`vhs_base::error::Error::Shape`] where a length does not fit `shape`.
pub fn stack_channels(observations: &[u8], shape: [usize; 4], out: &mut [u8]) -> Result<()> {
    let bytes = check::product("observations", &shape)?;
    check_shape("observations", &[bytes], &[observations.len()])?;
    check_shape("out", &[bytes], &[out.len()])?;
    let [_, stack, pixels, colours] = shape;
    // A width known at compile time makes a pixel two moves instead of a call.
    match colours {
        1 => interleave(observations, stack, pixels, Width::<1>, out),
        3 => interleave(observations, stack, pixels, Width::<3>, out),
        4 => interleave(observations, stack, pixels, Width::<4>, out),
        _ => interleave(observations, stack, pixels, colours, out),
    }
    Ok(())
}

/// Bytes a pixel, known when compiling or not.
trait Colours: Copy {
    fn bytes(self) -> usize;
}

#[derive(Clone, Copy)]
struct Width<const N: usize>;

impl<const N: usize> Colours for Width<N> {
    #[inline]
    fn bytes(self) -> usize {
        N
    }
}

impl Colours for usize {
    #[inline]
    fn bytes(self) -> usize {
        self
    }
}

#[inline]
fn interleave<C: Colours>(source: &[u8], stack: usize, pixels: usize, colours: C, out: &mut [u8]) {
    let colours = colours.bytes();
    let (frame_bytes, cell_bytes) = (pixels * colours, stack * colours);
    if source.is_empty() {
        return;
    }
    for (frames, picture) in source
        .chunks_exact(stack * frame_bytes)
        .zip(out.chunks_exact_mut(stack * frame_bytes))
    {
        for (index, frame) in frames.chunks_exact(frame_bytes).enumerate() {
            let cells = picture[index * colours..].chunks_mut(cell_bytes);
            for (pixel, cell) in frame.chunks_exact(colours).zip(cells) {
                cell[..colours].copy_from_slice(pixel);
            }
        }
    }
}
