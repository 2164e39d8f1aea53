//! Stacked frames as the channels of one picture: the layout in which convolutions read them.

/// Interleaves the frames of an observation, `[stack, pixels, pixel]` bytes to `[pixels, stack, pixel]`.
///
/// The frames are as long as each other and together as long as `out`.
pub(crate) fn interleave<'a>(
    mut frames: impl ExactSizeIterator<Item = &'a [u8]>,
    pixel: usize,
    out: &mut [u8],
) {
    let stack = frames.len();
    // A width known at compile time makes a pixel two moves instead of a call.
    match (stack, pixel) {
        (1, _) => frames.for_each(|frame| out.copy_from_slice(frame)),
        (2, 3) => {
            if let (Some(first), Some(second)) = (frames.next(), frames.next()) {
                two_of_three(first, second, out);
            }
        }
        (_, 1) => spread::<1>(frames, out),
        (_, 3) => spread::<3>(frames, out),
        (_, 4) => spread::<4>(frames, out),
        _ => {
            for (index, frame) in frames.enumerate() {
                let cells = out[index * pixel..].chunks_mut(stack * pixel);
                for (pixels, cell) in frame.chunks_exact(pixel).zip(cells) {
                    cell[..pixel].copy_from_slice(pixels);
                }
            }
        }
    }
}

/// Frame by frame, pixels of so many bytes.
fn spread<'a, const PIXEL: usize>(frames: impl ExactSizeIterator<Item = &'a [u8]>, out: &mut [u8]) {
    let cell = frames.len() * PIXEL;
    for (index, frame) in frames.enumerate() {
        let cells = out[index * PIXEL..].chunks_mut(cell);
        for (pixel, cell) in frame.as_chunks::<PIXEL>().0.iter().zip(cells) {
            cell[..PIXEL].copy_from_slice(pixel);
        }
    }
}

/// Pixels that `two_of_three` takes at once: their bytes are whole words.
const AT_ONCE: usize = 8;

/// Two frames of three colours, the usual case: both at once, a pixel of both by one store of eight bytes, of which
/// the next pixel overwrites the last two.
fn two_of_three(first: &[u8], second: &[u8], out: &mut [u8]) {
    let (firsts, first_rest) = first.as_chunks::<{ 3 * AT_ONCE }>();
    let (seconds, second_rest) = second.as_chunks::<{ 3 * AT_ONCE }>();
    let (cells, rest) = out.as_chunks_mut::<{ 6 * AT_ONCE }>();
    for ((a, b), cells) in firsts.iter().zip(seconds).zip(cells) {
        for pixel in 0..AT_ONCE {
            let bytes = (word(a, pixel) & 0xFF_FFFF | word(b, pixel) << 24).to_le_bytes();
            let room = (6 * AT_ONCE - 6 * pixel).min(8);
            cells[6 * pixel..][..room].copy_from_slice(&bytes[..room]);
        }
    }
    if !rest.is_empty() {
        spread::<3>([first_rest, second_rest].into_iter(), rest);
    }
}

/// A word whose lowest three bytes are a pixel.
#[inline]
fn word(pixels: &[u8; 3 * AT_ONCE], pixel: usize) -> u64 {
    // The last word that lies within the pixels serves those behind its start, too.
    let start = (3 * pixel).min(3 * AT_ONCE - 8);
    let mut bytes = [0; 8];
    bytes.copy_from_slice(&pixels[start..start + 8]);
    u64::from_le_bytes(bytes) >> (8 * (3 * pixel - start))
}
