//! Textures: mipmaps made once, trilinear look-ups that use whole numbers.
//!
//! Owns the texels of every level. Filtering follows OpenGL's `LINEAR_MIPMAP_LINEAR` (specification 4.6
//! compatibility profile, section 8.14): 2d textures repeat, cube faces clamp to their own edge. Weights have 8
//! bits and colours are blended as integers, so that a look-up cannot depend on the width of a vector unit.

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

/// One picture: row-major RGBA, 8 bits a channel, red in the low byte.
#[derive(Debug, Clone)]
pub(crate) struct Level {
    width: i32,
    height: i32,
    texels: Vec<u32>,
}

/// A texture with all its levels.
#[derive(Debug, Clone)]
pub struct Texture {
    kind: TextureKind,
    /// `faces[f][l]`: level `l` of face `f`; a flat texture has one face.
    faces: Vec<Vec<Level>>,
    /// For a cube, which entry of `faces` serves each of its six sides.
    side: [usize; 6],
}

/// Spreads the four bytes of a texel over four 16-bit lanes, so that one multiplication scales them all.
#[inline(always)]
fn spread(texel: u32) -> u64 {
    (u64::from(texel) | (u64::from(texel) << 24)) & LANES
}

const LANES: u64 = 0x00ff_00ff_00ff_00ff;
const HALF: u64 = 0x0080_0080_0080_0080;

/// Blend of `a` and `b` with weight `w` in 0..=256 for `b`; lanes never carry: 255 * 256 + 128 < 2^16.
#[inline(always)]
fn blend(a: u64, b: u64, w: u64) -> u64 {
    ((a * (256 - w) + b * w + HALF) >> 8) & LANES
}

/// The lanes of `spread`, back as red, green, blue, alpha in 0..=255.
#[inline(always)]
#[expect(clippy::cast_precision_loss, reason = "each lane holds 8 bits")]
fn unpack(lanes: u64) -> [f32; 4] {
    [
        (lanes & 0xff) as f32,
        ((lanes >> 32) & 0xff) as f32,
        ((lanes >> 16) & 0xff) as f32,
        ((lanes >> 48) & 0xff) as f32,
    ]
}

impl Level {
    /// Bilinear look-up; `u`, `v` in texels times 256, texel centres at odd multiples of 128.
    #[inline(always)]
    fn bilinear<const REPEAT: bool>(&self, u: i32, v: i32) -> u64 {
        let (x, y) = (u - 128, v - 128);
        let (x0, y0) = (x >> 8, y >> 8);
        #[expect(clippy::cast_sign_loss, reason = "masked to 8 bits")]
        let (wx, wy) = ((x & 255) as u64, (y & 255) as u64);
        let (x0, x1) = Self::pair::<REPEAT>(x0, self.width);
        let (y0, y1) = Self::pair::<REPEAT>(y0, self.height);
        #[expect(clippy::cast_sign_loss, reason = "wrapped or clamped to the picture")]
        let (r0, r1) = ((y0 * self.width) as usize, (y1 * self.width) as usize);
        #[expect(clippy::cast_sign_loss, reason = "wrapped or clamped to the picture")]
        let (x0, x1) = (x0 as usize, x1 as usize);
        let top = blend(spread(self.texels[r0 + x0]), spread(self.texels[r0 + x1]), wx);
        let bottom = blend(spread(self.texels[r1 + x0]), spread(self.texels[r1 + x1]), wx);
        blend(top, bottom, wy)
    }

    /// The two neighbouring texel numbers, kept inside `0..n`; `i` is in `-1..=n`.
    #[inline(always)]
    fn pair<const REPEAT: bool>(i: i32, n: i32) -> (i32, i32) {
        if REPEAT {
            let low = if i < 0 {
                i + n
            } else if i >= n {
                i - n
            } else {
                i
            };
            (low, if low + 1 == n { 0 } else { low + 1 })
        } else {
            (i.clamp(0, n - 1), (i + 1).clamp(0, n - 1))
        }
    }

    /// The next smaller level: each texel is a linear look-up at its scaled centre (a 2x2 mean for even sizes).
    fn halved(&self) -> Level {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut texels = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let u = (2 * x + 1) * self.width * 128 / width;
                let v = (2 * y + 1) * self.height * 128 / height;
                let lanes = self.bilinear::<false>(u, v);
                let c = [lanes & 0xff, (lanes >> 32) & 0xff, (lanes >> 16) & 0xff, (lanes >> 48) & 0xff];
                #[expect(clippy::cast_possible_truncation, reason = "each lane holds 8 bits")]
                texels.push((c[0] | c[1] << 8 | c[2] << 16 | c[3] << 24) as u32);
            }
        }
        Level { width, height, texels }
    }

    /// This level and every smaller one down to a single texel.
    fn pyramid(self) -> Vec<Level> {
        let mut levels = vec![self];
        while let Some(last) = levels.last() {
            if last.width == 1 && last.height == 1 {
                break;
            }
            let next = last.halved();
            levels.push(next);
        }
        levels
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
            i32::try_from(n).ok().filter(|&n| n <= 16_384).ok_or_else(|| Error::Range {
                what: "texture size",
                expected: "at most 16384",
                got: n.to_string(),
            })
        };
        let (w, h) = (size(width)?, size(rows)?);
        let faces = data
            .chunks_exact(width * rows * channels)
            .map(|face| Level { width: w, height: h, texels: face.chunks_exact(channels).map(pack).collect() }.pyramid())
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
    pub(crate) fn size(&self) -> (f32, f32) {
        let level = &self.faces[0][0];
        #[expect(clippy::cast_precision_loss, reason = "at most 16384")]
        let size = (level.width as f32, level.height as f32);
        size
    }

    /// Colour of a flat texture at `(u, v)`; `rho2` is the squared size of a pixel in finest texels.
    #[inline(always)]
    pub(crate) fn flat(&self, u: f32, v: f32, rho2: f32) -> [f32; 4] {
        #[expect(clippy::cast_precision_loss, reason = "only the fraction is kept")]
        let (u, v) = ((u - floor_i32(u) as f32).clamp(0.0, 1.0), (v - floor_i32(v) as f32).clamp(0.0, 1.0));
        unpack(trilinear::<true>(&self.faces[0], u, v, rho2))
    }

    /// Colour of a cube texture in `direction`, of which `dx` and `dy` are the changes from pixel to pixel.
    pub(crate) fn cube(&self, direction: V3, dx: V3, dy: V3) -> [f32; 4] {
        let (side, s, t, m) = side_of(direction);
        let face = &self.faces[self.side[side]];
        let pick = |d: V3| (s.1 * d[s.0], t.1 * d[t.0], m.1 * d[m.0]);
        let (sc, tc, ma) = pick(direction);
        let r = 1.0 / ma;
        let (u, v) = (sc * r, tc * r);
        let slope = |d: V3| {
            let (ds, dt, dm) = pick(d);
            let (du, dv) = ((ds - u * dm) * r, (dt - v * dm) * r);
            du * du + dv * dv
        };
        let half = 0.5 * self.size().0;
        let rho2 = slope(dx).max(slope(dy)) * half * half;
        unpack(trilinear::<false>(face, (0.5 * (u + 1.0)).clamp(0.0, 1.0), (0.5 * (v + 1.0)).clamp(0.0, 1.0), rho2))
    }
}

/// Which component of a direction plays a part, and its sign there.
type Signed = (usize, f32);

/// Side of the cube that a direction meets, and which components are its s, t and depth (OpenGL, table 8.19).
#[inline(always)]
fn side_of(d: V3) -> (usize, Signed, Signed, Signed) {
    let a = [d[0].abs(), d[1].abs(), d[2].abs()];
    if a[0] >= a[1] && a[0] >= a[2] {
        if d[0] >= 0.0 {
            (0, (2, -1.0), (1, -1.0), (0, 1.0))
        } else {
            (1, (2, 1.0), (1, -1.0), (0, -1.0))
        }
    } else if a[1] >= a[2] {
        if d[1] >= 0.0 {
            (2, (0, 1.0), (2, 1.0), (1, 1.0))
        } else {
            (3, (0, 1.0), (2, -1.0), (1, -1.0))
        }
    } else if d[2] >= 0.0 {
        (4, (0, 1.0), (1, -1.0), (2, 1.0))
    } else {
        (5, (0, -1.0), (1, -1.0), (2, -1.0))
    }
}

/// Trilinear look-up at `u`, `v` in 0..=1.
#[inline(always)]
fn trilinear<const REPEAT: bool>(levels: &[Level], u: f32, v: f32, rho2: f32) -> u64 {
    let look = |level: &Level| {
        #[expect(clippy::cast_precision_loss, reason = "at most 16384")]
        let (w, h) = (level.width as f32, level.height as f32);
        level.bilinear::<REPEAT>(floor_i32(u * w * 256.0), floor_i32(v * h * 256.0))
    };
    if rho2.partial_cmp(&1.0) != Some(std::cmp::Ordering::Greater) {
        return look(&levels[0]);
    }
    let lod = 0.5 * log2_rough(rho2);
    let whole = floor_i32(lod);
    #[expect(clippy::cast_sign_loss, reason = "rho2 above 1 gives a lod of at least 0")]
    let fine = whole as usize;
    if fine + 1 >= levels.len() {
        return look(&levels[levels.len() - 1]);
    }
    #[expect(clippy::cast_precision_loss, clippy::cast_sign_loss, clippy::cast_possible_truncation)]
    let w = ((lod - whole as f32) * 256.0) as u64;
    blend(look(&levels[fine]), look(&levels[fine + 1]), w)
}

/// Three or four bytes as one texel; without a fourth it is opaque.
fn pack(bytes: &[u8]) -> u32 {
    let alpha = bytes.get(3).copied().unwrap_or(255);
    u32::from_le_bytes([bytes[0], bytes[1], bytes[2], alpha])
}
