//! From colours to the caller's bytes.

use crate::fill::Colours;

/// Order of the channels in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Layout {
    /// `[height, width, 3]`.
    #[default]
    Interleaved,
    /// `[3, height, width]`.
    Planar,
}

/// Writes pictures of `width` pixels a row; `is_halved` when four colours make a pixel.
pub(crate) fn write_out(
    colours: &Colours,
    width: usize,
    is_halved: bool,
    layout: Layout,
    out: &mut [u8],
) {
    let n = out.len() / 3;
    for (y, from) in (0..n).step_by(width).enumerate() {
        match layout {
            Layout::Interleaved if is_halved => {
                let row = &mut out[3 * from..3 * (from + width)];
                for (x, to) in row.chunks_exact_mut(3).enumerate() {
                    to.copy_from_slice(&colour_at(colours, is_halved, x, y).to_le_bytes()[..3]);
                }
            }
            Layout::Interleaved => {
                let start = y * colours.stride;
                let pixels = &colours.pixels[start..start + width];
                write_row(pixels, &mut out[3 * from..3 * (from + width)]);
            }
            Layout::Planar => {
                for x in 0..width {
                    let [r, g, b, _] = colour_at(colours, is_halved, x, y).to_le_bytes();
                    (out[from + x], out[n + from + x], out[2 * n + from + x]) = (r, g, b);
                }
            }
        }
    }
}

/// Writes one row with its channels side by side.
fn write_row(pixels: &[u32], row: &mut [u8]) {
    let (fours, rest) = pixels.as_chunks::<4>();
    let (twelves, tail) = row.split_at_mut(12 * fours.len());
    for (to, &[a, b, c, d]) in twelves.chunks_exact_mut(12).zip(fours) {
        to[..4].copy_from_slice(&(a | b << 24).to_le_bytes());
        to[4..8].copy_from_slice(&(b >> 8 | c << 16).to_le_bytes());
        to[8..].copy_from_slice(&(c >> 16 | d << 8).to_le_bytes());
    }
    for (to, colour) in tail.chunks_exact_mut(3).zip(rest) {
        to.copy_from_slice(&colour.to_le_bytes()[..3]);
    }
}

/// Colour of a pixel, the mean of four where they make one.
fn colour_at(colours: &Colours, is_halved: bool, x: usize, y: usize) -> u32 {
    let Colours { stride, pixels } = colours;
    if !is_halved {
        return pixels[y * stride + x];
    }
    let (top, bottom) = (2 * y * stride + 2 * x, (2 * y + 1) * stride + 2 * x);
    let four = [
        pixels[top],
        pixels[top + 1],
        pixels[bottom],
        pixels[bottom + 1],
    ];
    // Every other channel has room for the sum of four.
    let sum = |shift: u32| four.iter().map(|c| c >> shift & 0x00ff_00ff).sum::<u32>() + 0x0002_0002;
    (sum(0) >> 2 & 0x00ff_00ff) | (sum(8) >> 2 & 0x00ff_00ff) << 8
}
