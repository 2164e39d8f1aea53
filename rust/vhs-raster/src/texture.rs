//! Textures: mipmaps made once, trilinear look-ups that use whole numbers.
//!
//! Owns the texels of every level. Filtering follows OpenGL's `LINEAR_MIPMAP_LINEAR` (specification 4.6
//! compatibility profile, section 8.14): 2d textures repeat, cube faces clamp to their own edge. Weights have 8
//! bits and colours are blended as integers, so that a look-up cannot depend on the width of a vector unit.

use crate::error::{Error, Result};
use crate::lanes::Machine;

/// One of the two kinds of texture a scene can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextureKind {
    /// A picture addressed by two coordinates that repeat with period 1.
    Flat,
    /// Six square pictures, one under the other, in the order +x, -x, +y, -y, +z, -z; or one for all sides.
    Cube,
}

/// Most levels a picture of at most 16384 texels a side can have.
const MOST_LEVELS: usize = 15;

/// Texel colours in pairs of 16-bit lanes: `(red, blue)` and `(green, alpha)`.
#[derive(Clone, Copy)]
struct Texels<M: Machine> {
    red_blue: M::I,
    green_alpha: M::I,
}

/// A texture with all its levels: for each face the picture and its smaller copies, one after the other, row-major
/// RGBA, 8 bits a channel, red in the low byte.
///
/// Every level has a border of one texel that holds what a look-up across its edge finds: the texels of the opposite
/// edge where the texture repeats, those of the same edge where it does not.
#[derive(Debug, Clone)]
pub struct Texture {
    kind: TextureKind,
    /// Size of one face at level 0, in texels.
    width: u32,
    height: u32,
    levels: u32,
    /// Where each level starts within a face, its border included.
    starts: [u32; MOST_LEVELS],
    /// From one face to the next; 0 when all sides of a cube share one.
    face_step: u32,
    texels: Vec<u32>,
}

impl<M: Machine> Texels<M> {
    /// Four neighbouring texels of each lane, weighted with 256ths that add up to 256.
    #[inline(always)]
    fn weighted(taps: [M::I; 4], weights: [M::I; 4]) -> Self {
        let pair = M::int(0x00ff_00ff);
        let (mut red_blue, mut green_alpha) = (M::int(0x0080_0080), M::int(0x0080_0080));
        for k in 0..4 {
            // The weight in both halves, so that one multiplication serves two channels.
            let weight = M::or(weights[k], M::left(weights[k], 16));
            red_blue = M::plus(red_blue, M::times_pairs(M::and(taps[k], pair), weight));
            green_alpha = M::plus(
                green_alpha,
                M::times_pairs(M::and(M::right(taps[k], 8), pair), weight),
            );
        }
        Self {
            red_blue: M::and(M::right(red_blue, 8), pair),
            green_alpha: M::and(M::right(green_alpha, 8), pair),
        }
    }

    /// Blend with weight `w` in 0..=256 for `other`.
    #[inline(always)]
    fn blended(self, other: Self, w: M::I) -> Self {
        let pair = M::int(0x00ff_00ff);
        let w = M::or(w, M::left(w, 16));
        let rest = M::minus(M::int(0x0100_0100), w);
        let half = M::int(0x0080_0080);
        let red_blue = M::plus(
            M::times_pairs(self.red_blue, rest),
            M::times_pairs(other.red_blue, w),
        );
        let green_alpha = M::plus(
            M::times_pairs(self.green_alpha, rest),
            M::times_pairs(other.green_alpha, w),
        );
        Self {
            red_blue: M::and(M::right(M::plus(red_blue, half), 8), pair),
            green_alpha: M::and(M::right(M::plus(green_alpha, half), 8), pair),
        }
    }

    /// Red, green, blue and alpha, each in 0..=255.
    #[inline(always)]
    fn channels(&self) -> [M::F; 4] {
        let low = M::int(0xffff);
        [
            M::from_int(M::and(self.red_blue, low)),
            M::from_int(M::and(self.green_alpha, low)),
            M::from_int(M::right(self.red_blue, 16)),
            M::from_int(M::right(self.green_alpha, 16)),
        ]
    }
}

/// Appends a picture of `width * height` texels and its smaller copies, each with its border; returns where each level
/// starts, counted from the first, and how many there are.
fn push_levels(
    texels: &mut Vec<u32>,
    kind: TextureKind,
    mut picture: Vec<u32>,
    (width, height): (u32, u32),
) -> ([u32; MOST_LEVELS], u32) {
    let (base, mut starts, mut levels) = (texels.len(), [0; MOST_LEVELS], 0);
    loop {
        let size = |level: u32| ((width >> level).max(1), (height >> level).max(1));
        starts[levels as usize] = u32::try_from(texels.len() - base).unwrap_or(u32::MAX);
        push_with_border(texels, kind, &picture, size(levels).0 as usize);
        if size(levels) == (1, 1) {
            return (starts, levels + 1);
        }
        let (fine, (w, h)) = (size(levels), size(levels + 1));
        let places = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
        picture = places
            .map(|at| halved(&picture, fine, at, (w, h)))
            .collect();
        levels += 1;
    }
}

/// Appends a picture with one texel more on every side.
fn push_with_border(texels: &mut Vec<u32>, kind: TextureKind, picture: &[u32], width: usize) {
    let last = picture.len() / width - 1;
    let before = |last: usize| if kind == TextureKind::Flat { last } else { 0 };
    let behind = |last: usize| if kind == TextureKind::Flat { 0 } else { last };
    for y in [before(last)]
        .into_iter()
        .chain(0..=last)
        .chain([behind(last)])
    {
        let row = &picture[y * width..(y + 1) * width];
        texels.push(row[before(width - 1)]);
        texels.extend_from_slice(row);
        texels.push(row[behind(width - 1)]);
    }
}

/// Texels of a texture with one face of this size, borders included, are at most this many.
fn most_texels(width: usize, height: usize) -> usize {
    (0..MOST_LEVELS)
        .map(|level| ((width >> level) + 3) * ((height >> level) + 3))
        .sum()
}

/// Texel `(x, y)` of a copy of size `(w, h)`: a linear look-up at its scaled centre, for even sizes a mean of four.
fn halved(
    fine: &[u32],
    (fine_w, fine_h): (u32, u32),
    (x, y): (u32, u32),
    (w, h): (u32, u32),
) -> u32 {
    let place = |i: u32, fine: u32, coarse: u32| {
        let wide = u64::from(2 * i + 1) * u64::from(fine) * 128 / u64::from(coarse);
        let at = u32::try_from(wide).unwrap_or(u32::MAX) - 128;
        (at >> 8, ((at >> 8) + 1).min(fine - 1), at & 255)
    };
    let ((x0, x1, wx), (y0, y1, wy)) = (place(x, fine_w, w), place(y, fine_h, h));
    let at = |x: u32, y: u32| fine[(y * fine_w + x) as usize].to_le_bytes();
    let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
    let mix = |a: u32, b: u32, w: u32| a * (256 - w) + b * w;
    let channel = |k: usize| {
        let top = mix(a[k].into(), b[k].into(), wx);
        let bottom = mix(c[k].into(), d[k].into(), wx);
        #[expect(clippy::cast_possible_truncation, reason = "a mean of bytes is a byte")]
        let mean = ((mix(top, bottom, wy) + 32_768) >> 16) as u8;
        mean
    };
    u32::from_le_bytes([0, 1, 2, 3].map(channel))
}

/// The first of the two texels around a coordinate in 0..=1, counted from the border, and the weight of the second in
/// 256ths.
#[inline(always)]
fn neighbours<M: Machine>(t: M::F, n: M::I) -> (M::I, M::I) {
    // Not negative, so cutting off the fraction is rounding down; texel centres are at odd multiples of 128.
    let at = M::plus(
        M::truncate(M::mul(t, M::from_int(M::left(n, 8)))),
        M::int(128),
    );
    (M::right(at, 8), M::and(at, M::int(255)))
}

/// Binary logarithm of a normal positive number; see [`crate::math`] for why it is not the platform's.
///
/// log2(1 + m) = m + m (1 - m) r(m) is exact at both ends, so that the result has no jumps; r is a least-squares fit
/// that leaves an error of 2e-5.
#[inline(always)]
fn log2<M: Machine>(x: M::F) -> M::F {
    let bits = M::bits(x);
    let exponent = M::from_int(M::minus(M::right(bits, 23), M::int(127)));
    let mantissa = M::from_bits(M::or(
        M::and(bits, M::int(0x007f_ffff)),
        M::int(0x3f80_0000),
    ));
    let m = M::sub(mantissa, M::float(1.0));
    let mut r = M::float(-0.044_423_59);
    for c in [0.147_508_23, -0.266_877_04, 0.441_899_33] {
        r = M::mul_then_add(r, m, M::float(c));
    }
    let bend = M::mul(M::mul(m, M::sub(M::float(1.0), m)), r);
    M::add(exponent, M::add(m, bend))
}

impl Texture {
    /// A texture from `data`, row-major with `channels` (3 or 4) bytes a texel, first row first.
    ///
    /// A cube takes either one square picture for all sides or six stacked ones (`height == 6 * width`).
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Range`] when the sizes do not fit together.
    pub fn new(
        kind: TextureKind,
        width: usize,
        height: usize,
        channels: usize,
        data: &[u8],
    ) -> Result<Self> {
        if !(3..=4).contains(&channels) {
            return Err(Error::Range {
                what: "texture channels",
                expected: "3 or 4",
                got: channels.to_string(),
            });
        }
        let expected = width * height * channels;
        if data.len() != expected || expected == 0 {
            return Err(Error::Length {
                what: "texture bytes",
                expected,
                got: data.len(),
            });
        }
        let stacked = kind == TextureKind::Cube && height != width;
        if stacked && height != 6 * width {
            return Err(Error::Range {
                what: "cube texture height",
                expected: "the width, or six times the width",
                got: format!("{height} for width {width}"),
            });
        }
        let rows = if stacked { width } else { height };
        let size = |n: usize| {
            u32::try_from(n)
                .ok()
                .filter(|&n| n <= 16_384)
                .ok_or_else(|| Error::Range {
                    what: "texture size",
                    expected: "at most 16384",
                    got: n.to_string(),
                })
        };
        let (w, h) = (size(width)?, size(rows)?);
        let faces = if stacked { 6 } else { 1 };
        if faces * most_texels(width, rows) > i32::MAX as usize {
            return Err(Error::Range {
                what: "texture size",
                expected: "fewer than 2^31 texels",
                got: format!("{width} by {height}"),
            });
        }
        let mut texture = Self {
            kind,
            width: w,
            height: h,
            levels: 1,
            starts: [0; MOST_LEVELS],
            face_step: 0,
            texels: Vec::new(),
        };
        for face in data.chunks_exact(width * rows * channels) {
            let picture = face.chunks_exact(channels).map(pack).collect();
            (texture.starts, texture.levels) =
                push_levels(&mut texture.texels, kind, picture, (w, h));
        }
        if stacked {
            texture.face_step = u32::try_from(texture.texels.len() / 6).unwrap_or(u32::MAX);
        }
        Ok(texture)
    }

    /// Flat or cube.
    #[must_use]
    pub fn kind(&self) -> TextureKind {
        self.kind
    }

    /// Width and height of the finest level, in texels.
    #[expect(clippy::cast_precision_loss, reason = "at most 16384")]
    pub(crate) fn size(&self) -> (f32, f32) {
        (self.width as f32, self.height as f32)
    }

    /// Colours of a flat texture at `(u, v)`, 0..=255; `rho2` is the squared size of a pixel in finest texels.
    #[inline(always)]
    pub(crate) fn flat<M: Machine>(&self, u: M::F, v: M::F, rho2: M::F) -> [M::F; 4] {
        let (u, v) = (
            M::unit(M::sub(u, M::floor(u))),
            M::unit(M::sub(v, M::floor(v))),
        );
        self.trilinear::<M>(M::int(0), u, v, rho2)
    }

    /// Colours of a cube texture in direction `d`, 0..=255; `dx` and `dy` are its changes from pixel to pixel.
    #[inline(always)]
    pub(crate) fn cube<M: Machine>(&self, d: [M::F; 3], dx: [M::F; 3], dy: [M::F; 3]) -> [M::F; 4] {
        let side = Side::<M>::of(d);
        let (s, t, m) = side.pick(d);
        let inverse = M::div(M::float(1.0), m);
        let (a, b) = (M::mul(s, inverse), M::mul(t, inverse));
        let half = M::float(0.5);
        let reach = M::mul(inverse, M::float(0.5 * self.size().0));
        let rho2 = M::max(
            side.steepness(dx, a, b, reach),
            side.steepness(dy, a, b, reach),
        );
        let (u, v) = (
            M::unit(M::mul_then_add(a, half, half)),
            M::unit(M::mul_then_add(b, half, half)),
        );
        self.trilinear::<M>(side.start(self.face_step), u, v, rho2)
    }

    /// Trilinear look-up in the face that starts at `base`, at `u`, `v` in 0..=1.
    #[inline(always)]
    #[expect(clippy::cast_possible_wrap, reason = "at most 15 levels")]
    fn trilinear<M: Machine>(&self, base: M::I, u: M::F, v: M::F, rho2: M::F) -> [M::F; 4] {
        let size = (M::int(self.width as i32), M::int(self.height as i32));
        let one = M::float(1.0);
        if !M::any_above(rho2, one) {
            return self.bilinear::<M>(base, size, u, v).channels();
        }
        // Level zero for everything magnified; NaN has been turned into it as well.
        let last = M::int(self.levels as i32 - 1);
        let lod = M::min(
            M::mul(M::float(0.5), log2::<M>(M::max(rho2, one))),
            M::from_int(last),
        );
        let fine = M::truncate(lod);
        let weight = M::truncate(M::mul(M::sub(lod, M::from_int(fine)), M::float(256.0)));
        let coarse = M::smaller(M::plus(fine, M::int(1)), last);
        let near = self.at_level::<M>(base, fine, u, v);
        near.blended(self.at_level::<M>(base, coarse, u, v), weight)
            .channels()
    }

    /// Bilinear look-up in one level for each lane, of the face that starts at `base`.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        reason = "sizes and levels are small"
    )]
    fn at_level<M: Machine>(&self, base: M::I, level: M::I, u: M::F, v: M::F) -> Texels<M> {
        // Neighbouring samples mostly agree on the level, and then its numbers need no look-up.
        if let Some(level) = M::common(level) {
            let start = M::plus(
                base,
                M::int(self.starts[level as usize % MOST_LEVELS] as i32),
            );
            let size = (
                (self.width >> level).max(1) as i32,
                (self.height >> level).max(1) as i32,
            );
            return self.bilinear::<M>(start, (M::int(size.0), M::int(size.1)), u, v);
        }
        let start = M::plus(base, M::look_up(&self.starts, level));
        let width = M::larger(M::right_by(M::int(self.width as i32), level), M::int(1));
        let height = M::larger(M::right_by(M::int(self.height as i32), level), M::int(1));
        self.bilinear::<M>(start, (width, height), u, v)
    }

    /// Bilinear look-up in the picture of size `(w, h)` that starts at `start`.
    #[inline(always)]
    fn bilinear<M: Machine>(
        &self,
        start: M::I,
        (w, h): (M::I, M::I),
        u: M::F,
        v: M::F,
    ) -> Texels<M> {
        let ((x, wx), (y, wy)) = (neighbours::<M>(u, w), neighbours::<M>(v, h));
        let stride = M::plus(w, M::int(2));
        let top = M::plus(start, M::plus(M::times_small(y, stride), x));
        let both = M::right(M::plus(M::times_small(wx, wy), M::int(128)), 8);
        let (right, down) = (M::minus(wx, both), M::minus(wy, both));
        let rest = M::minus(M::minus(M::int(256), wx), down);
        let [a, b] = M::look_up_pairs(&self.texels, top);
        let [c, d] = M::look_up_pairs(&self.texels, M::plus(top, stride));
        let taps = [a, b, c, d];
        Texels::weighted(taps, [rest, right, down, both])
    }
}

/// Which side of the cube each lane meets: axis as masks, and the sign along it (OpenGL, table 8.19).
struct Side<M: Machine> {
    is_x: M::I,
    is_y: M::I,
    /// The sign bit of the direction along its axis.
    sign: M::I,
}

impl<M: Machine> Side<M> {
    #[inline(always)]
    fn of(d: [M::F; 3]) -> Self {
        let sign_bit = M::int(i32::MIN);
        let x = M::from_bits(M::without(sign_bit, M::bits(d[0])));
        let y = M::from_bits(M::without(sign_bit, M::bits(d[1])));
        let z = M::from_bits(M::without(sign_bit, M::bits(d[2])));
        // Ties go to x, then to y.
        let is_x = M::without(M::or(M::above(y, x), M::above(z, x)), M::int(-1));
        let is_y = M::without(M::or(is_x, M::above(z, y)), M::int(-1));
        let along = M::choose(is_x, d[0], M::choose(is_y, d[1], d[2]));
        Self {
            is_x,
            is_y,
            sign: M::and(M::bits(along), sign_bit),
        }
    }

    /// The components of a direction that are s, t and depth on this side.
    #[inline(always)]
    fn pick(&self, d: [M::F; 3]) -> (M::F, M::F, M::F) {
        let minus = M::xor(self.sign, M::int(i32::MIN));
        let s = M::choose(
            self.is_x,
            flipped::<M>(d[2], minus),
            M::choose(self.is_y, d[0], flipped::<M>(d[0], self.sign)),
        );
        let t = M::choose(
            self.is_y,
            flipped::<M>(d[2], self.sign),
            flipped::<M>(d[1], M::int(i32::MIN)),
        );
        let along = M::choose(self.is_x, d[0], M::choose(self.is_y, d[1], d[2]));
        (s, t, flipped::<M>(along, self.sign))
    }

    /// Squared slope of s / depth and t / depth, which are `a` and `b`, for a change `d` of the direction.
    #[inline(always)]
    fn steepness(&self, d: [M::F; 3], a: M::F, b: M::F, reach: M::F) -> M::F {
        let (ds, dt, dm) = self.pick(d);
        let du = M::mul(M::sub(ds, M::mul(a, dm)), reach);
        let dv = M::mul(M::sub(dt, M::mul(b, dm)), reach);
        M::add(M::mul(du, du), M::mul(dv, dv))
    }

    /// Where the side's face starts: its number (+x, -x, +y, -y, +z, -z) times `step`.
    #[inline(always)]
    #[expect(clippy::cast_possible_wrap, reason = "textures are shorter than 2^31")]
    fn start(&self, step: u32) -> M::I {
        let step = step as i32;
        let from_axis = M::without(
            self.is_x,
            M::or(
                M::and(self.is_y, M::int(2 * step)),
                M::without(self.is_y, M::int(4 * step)),
            ),
        );
        M::plus(
            from_axis,
            M::and(M::right_signed(self.sign, 31), M::int(step)),
        )
    }
}

/// A number with another sign where `sign` has its highest bit.
#[inline(always)]
fn flipped<M: Machine>(v: M::F, sign: M::I) -> M::F {
    M::from_bits(M::xor(M::bits(v), sign))
}

/// Three or four bytes as one texel; without a fourth it is opaque.
fn pack(bytes: &[u8]) -> u32 {
    let alpha = bytes.get(3).copied().unwrap_or(255);
    u32::from_le_bytes([bytes[0], bytes[1], bytes[2], alpha])
}
