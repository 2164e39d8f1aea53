//! Textures: mipmaps made once, trilinear look-ups that use whole numbers.
//!
//! Owns the texels of every level. Filtering follows OpenGL's `LINEAR_MIPMAP_LINEAR` (specification 4.6
//! compatibility profile, section 8.14): 2d textures repeat, cube faces clamp to their own edge. Weights have 8
//! bits and colours are blended as integers, so that a look-up cannot depend on the width of a vector unit.

use crate::cover::LANES;
use crate::error::{Error, Result};
use crate::math::{V3, floor_i32, log2_rough};

/// One of the two kinds of texture a scene can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextureKind {
    /// A picture addressed by two coordinates that repeat with period 1.
    Flat,
    /// Six square pictures, one under the other, in the order +x, -x, +y, -y, +z, -z; or one for all sides.
    Cube,
}

/// Numbers handled together; see [`crate::cover::LANES`].
pub(crate) type Ints = [u32; LANES];
pub(crate) type Floats = [f32; LANES];

/// How a machine reads eight places of a table at once. Every implementation returns the same numbers.
pub(crate) trait Machine {
    /// `table[at[i]]` for each lane; places past the end read the last entry.
    fn look_up(table: &[u32], at: &Ints) -> Ints;
}

/// Any machine.
pub(crate) struct Plain;

impl Machine for Plain {
    #[inline(always)]
    fn look_up(table: &[u32], at: &Ints) -> Ints {
        let last = table.len() - 1;
        at.map(|i| table[(i as usize).min(last)])
    }
}

/// A machine that has been found to have AVX2.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Machine for Avx2 {
    #[inline(always)]
    #[expect(clippy::cast_possible_wrap, clippy::cast_possible_truncation, reason = "tables are below 2^31 long")]
    fn look_up(table: &[u32], at: &Ints) -> Ints {
        use std::arch::x86_64::{__m256i, _mm256_i32gather_epi32};
        let last = (table.len() - 1) as u32;
        let at = at.map(|i| i.min(last));
        // SAFETY: every index was limited to the table, whose length fits in i32, and arrays of eight u32 and
        // `__m256i` have the same size and no invalid values. Only functions that require AVX2 use this type.
        unsafe {
            let at = std::mem::transmute::<Ints, __m256i>(at);
            std::mem::transmute::<__m256i, Ints>(_mm256_i32gather_epi32::<4>(table.as_ptr().cast(), at))
        }
    }
}

/// Texel colours in pairs of 16-bit lanes: `(red, blue)` and `(green, alpha)`.
#[derive(Debug, Clone, Copy)]
struct Texels {
    red_blue: Ints,
    green_alpha: Ints,
}

const PAIR: u32 = 0x00ff_00ff;
const HALF: u32 = 0x0080_0080;

/// Most levels a picture of at most 16384 texels a side can have.
const MOST_LEVELS: usize = 15;

/// One picture and its smaller copies, one after the other: row-major RGBA, 8 bits a channel, red in the low byte.
#[derive(Debug, Clone)]
struct Pyramid {
    width: u32,
    height: u32,
    levels: u32,
    /// Where each level starts in `texels`.
    starts: [u32; MOST_LEVELS],
    texels: Vec<u32>,
}

/// A texture with all its levels.
#[derive(Debug, Clone)]
pub struct Texture {
    kind: TextureKind,
    /// A flat texture has one face.
    faces: Vec<Pyramid>,
    /// For a cube, which entry of `faces` serves each of its six sides.
    side: [usize; 6],
}

impl Texels {
    /// Four neighbouring texels of each lane, weighted with 256ths that add up to 256.
    #[inline(always)]
    fn weighted(taps: [Ints; 4], weights: [Ints; 4]) -> Self {
        let (mut red_blue, mut green_alpha) = ([HALF; LANES], [HALF; LANES]);
        for (tap, weight) in taps.iter().zip(&weights) {
            for i in 0..LANES {
                red_blue[i] = red_blue[i].wrapping_add((tap[i] & PAIR).wrapping_mul(weight[i]));
                green_alpha[i] = green_alpha[i].wrapping_add(((tap[i] >> 8) & PAIR).wrapping_mul(weight[i]));
            }
        }
        Self { red_blue: red_blue.map(|x| (x >> 8) & PAIR), green_alpha: green_alpha.map(|x| (x >> 8) & PAIR) }
    }

    /// Blend with weight `w` in 0..=256 for `other`.
    #[inline(always)]
    fn blended(self, other: Self, w: &Ints) -> Self {
        // Lanes borrow from each other in between, but modulo 2^32 the sum is that of two products that fit.
        let mix = |a: u32, b: u32, w: u32| {
            ((a << 8).wrapping_add(b.wrapping_sub(a).wrapping_mul(w)).wrapping_add(HALF) >> 8) & PAIR
        };
        let (mut red_blue, mut green_alpha) = ([0; LANES], [0; LANES]);
        for i in 0..LANES {
            red_blue[i] = mix(self.red_blue[i], other.red_blue[i], w[i]);
            green_alpha[i] = mix(self.green_alpha[i], other.green_alpha[i], w[i]);
        }
        Self { red_blue, green_alpha }
    }

    /// Red, green, blue and alpha, each in 0..=255.
    #[inline(always)]
    #[expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "each lane holds 8 bits")]
    fn channels(&self) -> [Floats; 4] {
        // Converted as i32, for which vector units have an instruction.
        [
            self.red_blue.map(|x| (x & 0xff) as i32 as f32),
            self.green_alpha.map(|x| (x & 0xff) as i32 as f32),
            self.red_blue.map(|x| (x >> 16) as i32 as f32),
            self.green_alpha.map(|x| (x >> 16) as i32 as f32),
        ]
    }
}

impl Pyramid {
    /// A picture of `width * height` texels and all its smaller copies, down to a single texel.
    fn new(width: u32, height: u32, texels: Vec<u32>) -> Self {
        let mut pyramid = Self { width, height, levels: 1, starts: [0; MOST_LEVELS], texels };
        while pyramid.size(pyramid.levels - 1) != (1, 1) {
            let start = pyramid.texels.len();
            let (w, h) = pyramid.size(pyramid.levels);
            for y in 0..h {
                for x in 0..w {
                    let texel = pyramid.halved(pyramid.levels - 1, (x, y), (w, h));
                    pyramid.texels.push(texel);
                }
            }
            pyramid.starts[pyramid.levels as usize] = u32::try_from(start).unwrap_or(u32::MAX);
            pyramid.levels += 1;
        }
        pyramid
    }

    /// Width and height of a level.
    fn size(&self, level: u32) -> (u32, u32) {
        ((self.width >> level).max(1), (self.height >> level).max(1))
    }

    /// Texel `(x, y)` of the level after `level`, which has size `(w, h)`: a linear look-up at its scaled centre,
    /// which for even sizes is the mean of four.
    fn halved(&self, level: u32, (x, y): (u32, u32), (w, h): (u32, u32)) -> u32 {
        let (fine_w, fine_h) = self.size(level);
        let place = |i: u32, fine: u32, coarse: u32| {
            let wide = u64::from(2 * i + 1) * u64::from(fine) * 128 / u64::from(coarse);
            let at = u32::try_from(wide).unwrap_or(u32::MAX) - 128;
            (at >> 8, ((at >> 8) + 1).min(fine - 1), at & 255)
        };
        let ((x0, x1, wx), (y0, y1, wy)) = (place(x, fine_w, w), place(y, fine_h, h));
        let at = |x: u32, y: u32| self.texels[(self.starts[level as usize] + y * fine_w + x) as usize].to_le_bytes();
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

    /// Bilinear look-up in one level per lane at `u`, `v` in 0..=1.
    #[inline(always)]
    fn bilinear<M: Machine, const REPEAT: bool>(&self, level: &Ints, u: &Floats, v: &Floats) -> Texels {
        let start = if level.iter().all(|&l| l == 0) { [0; LANES] } else { M::look_up(&self.starts, level) };
        let (mut at, mut weights) = ([[0; LANES]; 4], [[0; LANES]; 4]);
        for i in 0..LANES {
            let (w, h) = ((self.width >> level[i]).max(1), (self.height >> level[i]).max(1));
            let (x0, x1, wx) = neighbours::<REPEAT>(u[i], w);
            let (y0, y1, wy) = neighbours::<REPEAT>(v[i], h);
            let (r0, r1) = (start[i] + y0 * w, start[i] + y1 * w);
            at[0][i] = r0 + x0;
            at[1][i] = r0 + x1;
            at[2][i] = r1 + x0;
            at[3][i] = r1 + x1;
            let both = (wx * wy + 128) >> 8;
            weights[3][i] = both;
            weights[2][i] = wy - both;
            weights[1][i] = wx - both;
            weights[0][i] = 256 + both - wx - wy;
        }
        Texels::weighted(at.map(|a| M::look_up(&self.texels, &a)), weights)
    }

    /// Trilinear look-up; `rho2` is the squared size of a pixel in finest texels.
    #[inline(always)]
    fn trilinear<M: Machine, const REPEAT: bool>(&self, u: &Floats, v: &Floats, rho2: &Floats) -> [Floats; 4] {
        if rho2.iter().fold(true, |all, &r| all & (r <= 1.0)) {
            return self.bilinear::<M, REPEAT>(&[0; LANES], u, v).channels();
        }
        let (mut fine, mut coarse, mut weight) = ([0; LANES], [0; LANES], [0; LANES]);
        #[expect(clippy::cast_precision_loss, reason = "few levels")]
        let last = (self.levels - 1) as i32 as f32;
        for i in 0..LANES {
            // Level zero for everything magnified, and for NaN.
            let lod = (0.5 * log2_rough(if rho2[i] > 1.0 { rho2[i] } else { 1.0 })).clamp(0.0, last);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 14")]
            let whole = lod as i32 as u32;
            fine[i] = whole;
            coarse[i] = (whole + 1).min(self.levels - 1);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
            #[expect(clippy::cast_possible_wrap, reason = "a fraction in 256ths")]
            let fraction = ((lod - whole as i32 as f32) * 256.0) as i32 as u32;
            weight[i] = fraction;
        }
        let near = self.bilinear::<M, REPEAT>(&fine, u, v);
        near.blended(self.bilinear::<M, REPEAT>(&coarse, u, v), &weight).channels()
    }
}

/// The two texels around a coordinate in 0..=1, and the weight of the second in 256ths.
#[inline(always)]
#[expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, clippy::cast_sign_loss, reason = "sizes fit in i32")]
#[expect(clippy::cast_possible_truncation, reason = "coordinates are at most 2^22")]
fn neighbours<const REPEAT: bool>(t: f32, n: u32) -> (u32, u32, u32) {
    let n = n as i32;
    // Not negative, so cutting off the fraction is rounding down; texel centres are at odd multiples of 128.
    let at = (t * (256 * n) as f32) as i32 - 128;
    let (low, weight) = (at >> 8, (at & 255) as u32);
    let high = low + 1;
    if REPEAT {
        let wrapped = if low < 0 { n - 1 } else { low };
        (wrapped as u32, (if high == n { 0 } else { high }) as u32, weight)
    } else {
        (low.max(0) as u32, high.min(n - 1) as u32, weight)
    }
}

impl Texture {
    /// A texture from `data`, row-major with `channels` (3 or 4) bytes a texel, first row first.
    ///
    /// A cube takes either one square picture for all sides or six stacked ones (`height == 6 * width`).
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Range`] when the sizes do not fit together.
    pub fn new(kind: TextureKind, width: usize, height: usize, channels: usize, data: &[u8]) -> Result<Self> {
        if !(3..=4).contains(&channels) {
            return Err(Error::Range {
                what: "texture channels",
                expected: "3 or 4",
                got: channels.to_string(),
            });
        }
        let expected = width * height * channels;
        if data.len() != expected || expected == 0 {
            return Err(Error::Length { what: "texture bytes", expected, got: data.len() });
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
            u32::try_from(n).ok().filter(|&n| n <= 16_384).ok_or_else(|| Error::Range {
                what: "texture size",
                expected: "at most 16384",
                got: n.to_string(),
            })
        };
        let (w, h) = (size(width)?, size(rows)?);
        let faces = data
            .chunks_exact(width * rows * channels)
            .map(|face| Pyramid::new(w, h, face.chunks_exact(channels).map(pack).collect()))
            .collect();
        let side = if stacked { [0, 1, 2, 3, 4, 5] } else { [0; 6] };
        Ok(Self { kind, faces, side })
    }

    /// Flat or cube.
    #[must_use]
    pub fn kind(&self) -> TextureKind {
        self.kind
    }

    /// Width and height of the finest level, in texels.
    #[expect(clippy::cast_precision_loss, reason = "at most 16384")]
    pub(crate) fn size(&self) -> (f32, f32) {
        (self.faces[0].width as f32, self.faces[0].height as f32)
    }

    /// Colours of a flat texture at `(u, v)`, 0..=255; `rho2` is the squared size of a pixel in finest texels.
    #[inline(always)]
    pub(crate) fn flat<M: Machine>(&self, u: &Floats, v: &Floats, rho2: &Floats) -> [Floats; 4] {
        self.faces[0].trilinear::<M, true>(&u.map(fraction), &v.map(fraction), rho2)
    }

    /// Colours of a cube texture in `direction`, 0..=255; `dx` and `dy` are its changes from pixel to pixel.
    #[inline(always)]
    pub(crate) fn cube<M: Machine>(&self, direction: &[Floats; 3], dx: &[Floats; 3], dy: &[Floats; 3]) -> [Floats; 4] {
        let mut sides = [0; LANES];
        for i in 0..LANES {
            sides[i] = side_of([direction[0][i], direction[1][i], direction[2][i]]);
        }
        let mut out = self.one_side::<M>(sides[0], direction, dx, dy);
        // Neighbouring samples nearly always meet the same side.
        for first in 1..LANES {
            if !sides[..first].contains(&sides[first]) {
                let other = self.one_side::<M>(sides[first], direction, dx, dy);
                for i in (0..LANES).filter(|&i| sides[i] == sides[first]) {
                    (0..4).for_each(|k| out[k][i] = other[k][i]);
                }
            }
        }
        out
    }

    /// Colours of lanes that all meet side `side`.
    #[inline(always)]
    fn one_side<M: Machine>(&self, side: usize, d: &[Floats; 3], dx: &[Floats; 3], dy: &[Floats; 3]) -> [Floats; 4] {
        let [s, t, m] = SIDES[side];
        let half = 0.5 * self.size().0;
        let (mut u, mut v, mut rho2) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let pick = |d: &[Floats; 3]| (s.1 * d[s.0][i], t.1 * d[t.0][i], m.1 * d[m.0][i]);
            let (sc, tc, ma) = pick(d);
            let r = 1.0 / ma;
            let (a, b) = (sc * r, tc * r);
            let slope = |d: &[Floats; 3]| {
                let (ds, dt, dm) = pick(d);
                let (du, dv) = ((ds - a * dm) * r * half, (dt - b * dm) * r * half);
                du * du + dv * dv
            };
            rho2[i] = slope(dx).max(slope(dy));
            u[i] = (0.5 * (a + 1.0)).clamp(0.0, 1.0);
            v[i] = (0.5 * (b + 1.0)).clamp(0.0, 1.0);
        }
        self.faces[self.side[side]].trilinear::<M, false>(&u, &v, &rho2)
    }
}

/// The part after the point, in 0..=1.
#[inline(always)]
#[expect(clippy::cast_precision_loss, reason = "only the fraction is kept")]
fn fraction(x: f32) -> f32 {
    (x - floor_i32(x) as f32).clamp(0.0, 1.0)
}

/// Which component of a direction plays a part, and its sign there.
type Signed = (usize, f32);

/// For each side of the cube which components are its s, t and depth (OpenGL, table 8.19).
const SIDES: [[Signed; 3]; 6] = [
    [(2, -1.0), (1, -1.0), (0, 1.0)],
    [(2, 1.0), (1, -1.0), (0, -1.0)],
    [(0, 1.0), (2, 1.0), (1, 1.0)],
    [(0, 1.0), (2, -1.0), (1, -1.0)],
    [(0, 1.0), (1, -1.0), (2, 1.0)],
    [(0, -1.0), (1, -1.0), (2, -1.0)],
];

/// Side of the cube that a direction meets.
#[inline(always)]
fn side_of(d: V3) -> usize {
    let a = [d[0].abs(), d[1].abs(), d[2].abs()];
    let axis = if a[0] >= a[1] && a[0] >= a[2] {
        0
    } else if a[1] >= a[2] {
        1
    } else {
        2
    };
    2 * axis + usize::from(d[axis] < 0.0)
}

/// Three or four bytes as one texel; without a fourth it is opaque.
fn pack(bytes: &[u8]) -> u32 {
    let alpha = bytes.get(3).copied().unwrap_or(255);
    u32::from_le_bytes([bytes[0], bytes[1], bytes[2], alpha])
}
