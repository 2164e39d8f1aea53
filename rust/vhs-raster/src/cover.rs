//! Which face is seen at each sample: the first of two passes.
//!
//! Faces are rasterised in homogeneous coordinates (Olano and Greer, "Triangle scan conversion using 2D
//! homogeneous coordinates", 1997): a corner is `(X, Y, W)`, an edge is the cross product of two corners, and a
//! sample `(x, y)` is inside when its product with every edge is positive. Nothing is ever clipped: what is behind
//! the camera or nearer than the near plane fails a comparison at the sample. Two faces that share an edge compute
//! it from the same corners in opposite order; a cross product then changes its sign exactly, so no sample between
//! them is lost or drawn twice.
//!
//! This pass writes depth and face number only. Colours come later, once per visible sample ([`crate::shade`]).

use crate::lanes::{Kind, MOST_LANES, Machine, Plain};
use crate::math::{V3, add, cross, dot, scale, sub};

/// Face number of the background.
pub(crate) const NOTHING: u32 = u32::MAX;

/// Faces with more columns than this are drawn with the widest lanes there are.
#[cfg(target_arch = "x86_64")]
const WIDE: usize = 24;

/// Position of a sample within its pixel, relative to the middle, y upwards.
pub(crate) type Offset = [f32; 2];

/// A projected corner.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Corner {
    /// `(X, Y, W)`.
    pub(crate) p: V3,
    /// `Z`: 1 for perspective.
    pub(crate) z: f32,
    /// `X / W`, `Y / W`; without meaning unless `is_ahead`.
    pub(crate) at: [f32; 2],
    /// Whether W reaches the near plane.
    pub(crate) is_ahead: bool,
}

/// A face that passed culling: what the second pass needs to know of it.
///
/// With `d = (x, y, 1)`: `W' = 1 / (whole . d)` is the W of the surface at that sample, and `(along[i] . d) * W'`
/// are the face's own coordinates, 0 at its first corner and 1 at the ends of its two sides.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drawn {
    pub(crate) whole: V3,
    pub(crate) along: [V3; 2],
    /// `Z / W` across the picture.
    pub(crate) depth: V3,
    /// Index into the frame's list of parts.
    pub(crate) part: u32,
    /// Number of the face in its solid: triangles first, then larger faces.
    pub(crate) face: u32,
}

/// Rectangle of pixels, ends excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) x0: usize,
    pub(crate) x1: usize,
    pub(crate) y0: usize,
    pub(crate) y1: usize,
}

/// A face ready to be compared with samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outline<const N: usize> {
    /// Inside is where all these are positive, or zero for edges that own their samples.
    edges: [V3; N],
    /// Smallest accepted value: 0 where samples on the edge belong to this face.
    least: [f32; N],
    /// `Z / W` across the picture.
    pub(crate) depth: V3,
}

/// Depth and face number of every sample.
#[derive(Debug, Clone)]
pub(crate) struct Cover {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Samples from one row to the next.
    pub(crate) stride: usize,
    /// Samples of a pixel.
    pub(crate) offsets: Vec<Offset>,
    /// Layer by layer, one for each sample of a pixel.
    pub(crate) depth: Vec<f32>,
    /// The same for face numbers.
    pub(crate) face: Vec<u32>,
    /// x of the middle of each pixel, padding included.
    columns: Vec<f32>,
    /// `Z / W` of the near plane.
    pub(crate) nearest: f32,
    /// `Z / W` across the picture of a plane that cuts off what is nearer.
    pub(crate) limit: Option<V3>,
    /// What this machine can do.
    pub(crate) kind: Kind,
}

/// Middle of pixel `i` of `n`, relative to the middle of the picture.
#[expect(
    clippy::cast_precision_loss,
    reason = "pictures are far smaller than 2^24"
)]
pub(crate) fn middle(i: usize, n: usize) -> f32 {
    i as f32 + 0.5 - 0.5 * n as f32
}

impl Cover {
    pub(crate) fn new(height: usize, width: usize, offsets: &[Offset], kind: Kind) -> Self {
        // A run of lanes may start at any pixel, so that rows have spare places at their end.
        let stride = width + MOST_LANES;
        let len = stride * height * offsets.len();
        Self {
            width,
            height,
            stride,
            offsets: offsets.to_vec(),
            depth: vec![0.0; len],
            face: vec![NOTHING; len],
            columns: (0..stride).map(|i| middle(i, width)).collect(),
            nearest: 0.0,
            limit: None,
            kind,
        }
    }

    /// Empties the picture; depth starts at the far plane.
    pub(crate) fn clear(&mut self, range: (f32, f32)) {
        self.depth.fill(range.0);
        self.face.fill(NOTHING);
        self.nearest = range.1;
    }

    /// Samples in one layer.
    pub(crate) fn layer(&self) -> usize {
        self.stride * self.height
    }

    /// Pixels that a face with these corners can touch; `None` when there are none.
    pub(crate) fn window<const N: usize>(
        &self,
        corners: &[Corner; N],
        near: f32,
    ) -> Option<Window> {
        let (low, high) = window_around(corners, near)?;
        self.pixels(low, high)
    }

    /// Pixels with a sample in the rectangle `low..=high` (y upwards), a little widened against rounding.
    #[inline(always)]
    pub(crate) fn pixels(&self, low: [f32; 2], high: [f32; 2]) -> Option<Window> {
        #[expect(
            clippy::cast_precision_loss,
            reason = "pictures are far smaller than 2^24"
        )]
        let (w, h) = (self.width as f32, self.height as f32);
        // Samples lie within half a pixel of the middle; with a single one it is the middle itself.
        let reach = if self.offsets.len() == 1 { 0.49 } else { 0.01 };
        let first = |v: f32, n: f32| (v + 0.5 * n + reach).clamp(0.0, n);
        let last = |v: f32, n: f32| (v + 0.5 * n + 1.0 - reach).clamp(0.0, n);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the picture"
        )]
        let window = Window {
            x0: first(low[0], w) as usize,
            x1: last(high[0], w) as usize,
            y0: first(-high[1], h) as usize,
            y1: last(-low[1], h) as usize,
        };
        (window.x0 < window.x1 && window.y0 < window.y1).then_some(window)
    }

    /// Draws a face into depth and face numbers.
    #[inline(always)]
    pub(crate) fn draw<const N: usize>(
        &mut self,
        outline: &Outline<N>,
        window: Window,
        number: u32,
    ) {
        match self.kind {
            Kind::Plain => self.draw_either::<Plain, N>(outline, window, number),
            #[cfg(target_arch = "x86_64")]
            // In small faces sixteen lanes would mostly be idle.
            // SAFETY: `Kind::Avx512` is only made by `detect`, after it found AVX-512.
            Kind::Avx512 if window.x1 - window.x0 > WIDE => unsafe {
                self.draw_avx512(outline, window, number);
            },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: both kinds are only made by `detect`, after it found what AVX2 needs; AVX-512 includes it.
            Kind::Avx2 | Kind::Avx512 => unsafe { self.draw_avx2(outline, window, number) },
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn draw_avx2<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: u32) {
        self.draw_either::<crate::lanes::Avx2, N>(outline, window, number);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq")]
    fn draw_avx512<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: u32) {
        self.draw_either::<crate::lanes::Avx512, N>(outline, window, number);
    }

    #[inline(always)]
    fn draw_either<M: Machine, const N: usize>(
        &mut self,
        outline: &Outline<N>,
        window: Window,
        number: u32,
    ) {
        if self.limit.is_some() {
            self.draw_lanes::<M, N, true>(outline, window, number);
        } else {
            self.draw_lanes::<M, N, false>(outline, window, number);
        }
    }

    #[inline(always)]
    fn draw_lanes<M: Machine, const N: usize, const CUT: bool>(
        &mut self,
        outline: &Outline<N>,
        window: Window,
        number: u32,
    ) {
        let (layer, len) = (
            self.layer(),
            (window.x1 - window.x0).next_multiple_of(M::LANES),
        );
        let (nearest, number) = (M::float(self.nearest), M::int(number.cast_signed()));
        let columns = &self.columns[window.x0..window.x0 + len];
        let limit = self.limit.unwrap_or_default();
        for (s, &[ox, oy]) in self.offsets.iter().enumerate() {
            for y in window.y0..window.y1 {
                let height = oy - middle(y, self.height);
                let row = outline.row(height);
                let cut = limit[1] * height + limit[2];
                let start = s * layer + y * self.stride + window.x0;
                let depth = self.depth[start..start + len].chunks_exact_mut(M::LANES);
                let face = self.face[start..start + len].chunks_exact_mut(M::LANES);
                let columns = columns.chunks_exact(M::LANES);
                for ((depth, face), columns) in depth.zip(face).zip(columns) {
                    let x = M::add(M::load(columns), M::float(ox));
                    let z =
                        M::mul_then_add(M::float(row.depth_slope), x, M::float(row.depth_constant));
                    let old = M::load(depth);
                    let mut is_seen = M::and(M::at_least(z, old), M::at_least(nearest, z));
                    if CUT {
                        let most = M::mul_then_add(M::float(limit[0]), x, M::float(cut));
                        is_seen = M::and(is_seen, M::at_least(most, z));
                    }
                    for k in 0..N {
                        let e =
                            M::mul_then_add(M::float(row.slope[k]), x, M::float(row.constant[k]));
                        is_seen = M::and(is_seen, M::at_least(e, M::float(row.least[k])));
                    }
                    if M::any(is_seen) {
                        M::store(M::choose(is_seen, z, old), depth);
                        M::store_ints(M::choose_ints(is_seen, number, M::load_ints(face)), face);
                    }
                }
            }
        }
    }

    /// Calls `each(pixel, mask)` for every pixel in which the face passes the depth test; depth stays as it is.
    pub(crate) fn visit<const N: usize>(
        &self,
        outline: &Outline<N>,
        window: Window,
        mut each: impl FnMut(usize, usize, u8),
    ) {
        let layer = self.layer();
        for y in window.y0..window.y1 {
            for x in window.x0..window.x1 {
                let mut mask = 0;
                for (s, &[ox, oy]) in self.offsets.iter().enumerate() {
                    let (across, height) = (self.columns[x] + ox, oy - middle(y, self.height));
                    let z = outline.at(across, height);
                    let nearest = self.limit.map_or(self.nearest, |cut| {
                        self.nearest
                            .min(cut[0] * across + (cut[1] * height + cut[2]))
                    });
                    let passes = z.is_some_and(|z| {
                        z <= nearest && z >= self.depth[s * layer + y * self.stride + x]
                    });
                    mask |= u8::from(passes) << s;
                }
                if mask != 0 {
                    each(x, y, mask);
                }
            }
        }
    }
}

/// Rectangle around a face in the picture; `None` when all of it is nearer than the near plane.
#[inline(always)]
pub(crate) fn window_around<const N: usize>(
    corners: &[Corner; N],
    near: f32,
) -> Option<([f32; 2], [f32; 2])> {
    if !corners.iter().all(|c| c.is_ahead) {
        return ahead_of_near(corners, near);
    }
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for k in 0..2 {
        for c in corners {
            low[k] = low[k].min(c.at[k]);
            high[k] = high[k].max(c.at[k]);
        }
    }
    Some((low, high))
}

/// Rectangle around the part of a face that lies beyond the near plane; generous, for it only bounds the search.
fn ahead_of_near<const N: usize>(corners: &[Corner; N], near: f32) -> Option<([f32; 2], [f32; 2])> {
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    let mut grow = |p: V3| {
        for k in 0..2 {
            let v = p[k] / p[2];
            // Rounding at the crossing is relative to coordinates that may be thousands of pixels.
            let slack = 0.01 + 1e-3 * v.abs();
            low[k] = low[k].min(v - slack);
            high[k] = high[k].max(v + slack);
        }
    };
    for i in 0..N {
        let (a, b) = (&corners[i], &corners[(i + 1) % N]);
        if a.is_ahead {
            grow(a.p);
        }
        if a.is_ahead != b.is_ahead {
            let t = (near - a.p[2]) / (b.p[2] - a.p[2]);
            let mut p = add(a.p, scale(sub(b.p, a.p), t));
            p[2] = near;
            grow(p);
        }
    }
    (low[0] <= high[0]).then_some((low, high))
}

/// One row of samples of an outline.
struct Row<const N: usize> {
    slope: [f32; N],
    constant: [f32; N],
    least: [f32; N],
    depth_slope: f32,
    depth_constant: f32,
}

impl<const N: usize> Outline<N> {
    /// Depth at a place, if it is inside.
    #[inline(always)]
    pub(crate) fn at(&self, x: f32, y: f32) -> Option<f32> {
        self.row(y).at(x)
    }

    /// All functions along a row at height `y`.
    #[inline(always)]
    fn row(&self, y: f32) -> Row<N> {
        Row {
            slope: self.edges.map(|e| e[0]),
            constant: self.edges.map(|e| e[1] * y + e[2]),
            least: self.least,
            depth_slope: self.depth[0],
            depth_constant: self.depth[1] * y + self.depth[2],
        }
    }
}

impl<const N: usize> Row<N> {
    /// Depth at `x`, if it is inside.
    #[inline(always)]
    fn at(&self, x: f32) -> Option<f32> {
        let is_inside = (0..N).all(|k| self.slope[k] * x + self.constant[k] >= self.least[k]);
        is_inside.then_some(self.depth_slope * x + self.depth_constant)
    }
}

/// Normal and volume of a triangle (`N` 3) or parallelogram (`N` 4), if it faces the camera and has an area: the
/// cross product of its two sides, and its product with the first corner.
///
/// `is_inverted` takes the back for the front.
#[inline(always)]
pub(crate) fn facing<const N: usize>(
    corners: &[Corner; N],
    is_inverted: bool,
) -> Option<(V3, f32)> {
    let p0 = corners[0].p;
    let normal = cross(sub(corners[1].p, p0), sub(corners[N - 1].p, p0));
    let volume = dot(p0, normal);
    // Written so that NaN fails.
    let is_front = if is_inverted {
        volume < 0.0
    } else {
        volume > 0.0
    };
    is_front.then_some((normal, volume))
}

/// Prepares a face for drawing, from what [`facing`] found.
#[inline(always)]
pub(crate) fn outline<const N: usize>(
    corners: &[Corner; N],
    (normal, volume): (V3, f32),
    is_inverted: bool,
) -> (Outline<N>, Drawn) {
    let p0 = corners[0].p;
    let inverse = 1.0 / volume;
    let whole = scale(normal, inverse);
    let (a, b) = (sub(corners[1].p, p0), sub(corners[N - 1].p, p0));
    let along = [scale(cross(b, p0), inverse), scale(cross(p0, a), inverse)];
    let mut edges = [[0.0; 3]; N];
    let mut least = [0.0; N];
    for k in 0..N {
        let e = cross(corners[k].p, corners[(k + 1) % N].p);
        let e = if is_inverted { scale(e, -1.0) } else { e };
        // Samples exactly on an edge belong to the face on its right, or below it where it is level.
        let owns = e[0] > 0.0 || (e[0] == 0.0 && e[1] < 0.0);
        edges[k] = e;
        least[k] = if owns { 0.0 } else { f32::from_bits(1) };
    }
    let z = [
        corners[0].z,
        corners[1].z - corners[0].z,
        corners[N - 1].z - corners[0].z,
    ];
    let depth = if z[1] == 0.0 && z[2] == 0.0 && z[0] == 1.0 {
        whole
    } else {
        add(
            scale(whole, z[0]),
            add(scale(along[0], z[1]), scale(along[1], z[2])),
        )
    };
    (
        Outline {
            edges,
            least,
            depth,
        },
        Drawn {
            whole,
            along,
            depth,
            part: 0,
            face: 0,
        },
    )
}
