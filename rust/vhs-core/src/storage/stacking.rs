//! Stacked frames as the channels of one picture: the layout in which convolutions read them.

/// How the frames of an observation lie in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Stacking {
    /// One frame after the other, oldest first: `[frame_stack, *frame_shape]`.
    #[default]
    Frames = 0,
    /// As the channels of one picture: of each pixel the oldest frame's channels first, so that frames of
    /// `[H, W, C]` make an observation of `[H, W, frame_stack * C]`.
    Channels = 1,
}

impl Stacking {
    /// Shape of so many stacked arrays of this shape.
    pub(crate) fn of_shape(self, shape: &[usize], stack: usize) -> Vec<usize> {
        match (self, shape) {
            (Self::Channels, [sizes @ .., channels]) => [sizes, &[stack * channels]].concat(),
            _ => [&[stack], shape].concat(),
        }
    }
}

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

/// Two frames of three colours, the usual case: four pixels of both at once, by words.
fn two_of_three(first: &[u8], second: &[u8], out: &mut [u8]) {
    let (firsts, first_rest) = first.as_chunks::<12>();
    let (seconds, second_rest) = second.as_chunks::<12>();
    let (cells, rest) = out.as_chunks_mut::<24>();
    for ((first, second), cells) in firsts.iter().zip(seconds).zip(cells) {
        let (first, second) = (four_pixels(first), four_pixels(second));
        // Six bytes each.
        let cell = |pixel: usize| first[pixel] | second[pixel] << 24;
        let words = [
            cell(0) | cell(1) << 48,
            cell(1) >> 16 | cell(2) << 32,
            cell(2) >> 32 | cell(3) << 16,
        ];
        for (out, word) in cells.as_chunks_mut::<8>().0.iter_mut().zip(words) {
            *out = word.to_le_bytes();
        }
    }
    if !rest.is_empty() {
        spread::<3>([first_rest, second_rest].into_iter(), rest);
    }
}

/// Four pixels of three bytes, a word each.
#[inline]
fn four_pixels(bytes: &[u8; 12]) -> [u64; 4] {
    const PIXEL: u64 = 0xFF_FFFF;
    let word = |start: usize| {
        let mut word = [0; 8];
        word.copy_from_slice(&bytes[start..start + 8]);
        u64::from_le_bytes(word)
    };
    let (low, high) = (word(0), word(4));
    [
        low & PIXEL,
        low >> 24 & PIXEL,
        high >> 16 & PIXEL,
        high >> 40,
    ]
}
