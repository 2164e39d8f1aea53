//! Where the samples of a face are, and what its texture shows there.

use crate::lanes::{MOST_LANES, Machine};
use crate::math::V3;
use crate::texture::Texture;

/// Where samples are in the picture, relative to its middle, y upwards.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Places<'a> {
    /// Pixel after pixel from `(x, y)` to the right.
    Row { x: f32, y: f32 },
    /// One by one.
    Anywhere { x: &'a [f32], y: &'a [f32] },
}

/// A visible sample: the depth plane of its face, and where it is in the camera's picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) depth: V3,
    pub(crate) at: [f32; 2],
}

/// Distance of each lane from the first.
const STEPS: [f32; MOST_LANES] = [
    0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0,
];

/// A few samples of one face.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Batch<M: Machine> {
    pub(crate) x: M::F,
    pub(crate) y: M::F,
}

impl Places<'_> {
    /// Samples from number `first` on.
    #[inline(always)]
    pub(crate) fn batch<M: Machine>(&self, first: usize) -> Batch<M> {
        match self {
            Places::Row { x, y } => {
                #[expect(
                    clippy::cast_precision_loss,
                    reason = "pictures are far smaller than 2^24"
                )]
                let start = M::float(x + first as f32);
                Batch {
                    x: M::add(start, M::load(&STEPS)),
                    y: M::float(*y),
                }
            }
            Places::Anywhere { x, y } => Batch {
                x: M::load(&x[first..]),
                y: M::load(&y[first..]),
            },
        }
    }
}

/// A row times `(x, y, 1)`.
#[inline(always)]
pub(crate) fn along<M: Machine>(row: V3, batch: &Batch<M>) -> M::F {
    let start = M::mul_then_add(M::float(row[1]), batch.y, M::float(row[2]));
    M::mul_then_add(M::float(row[0]), batch.x, start)
}

/// Colours of a flat texture, 0..=255.
#[inline(always)]
pub(crate) fn paint_flat<M: Machine>(
    texture: &Texture,
    rows: [V3; 2],
    [u_x, v_x, u_y, v_y]: [[f32; 2]; 4],
    batch: &Batch<M>,
    w: M::F,
) -> [M::F; 4] {
    let along_x = M::add(squared::<M>(u_x, batch.y), squared::<M>(v_x, batch.y));
    let along_y = M::add(squared::<M>(u_y, batch.x), squared::<M>(v_y, batch.x));
    let w2 = M::mul(w, w);
    let rho2 = M::mul(M::max(along_x, along_y), M::mul(w2, w2));
    texture.flat::<M>(
        M::mul(along(rows[0], batch), w),
        M::mul(along(rows[1], batch), w),
        rho2,
    )
}

/// Square of `slope[0] * at + slope[1]`.
#[inline(always)]
fn squared<M: Machine>(slope: [f32; 2], at: M::F) -> M::F {
    let value = M::mul_then_add(M::float(slope[0]), at, M::float(slope[1]));
    M::mul(value, value)
}

/// Slope of a coordinate along axis 0 or 1 of the picture, over W squared, as a linear function of the other axis.
///
/// Of u = (a . d) / (b . d), the slope along x is (a_x (b . d) - b_x (a . d)) / (b . d)^2; the terms with x cancel in
/// its numerator, which leaves two components of a cross product. The same goes for y.
pub(crate) fn slope_of(row: V3, whole: V3, axis: usize) -> [f32; 2] {
    let other = 1 - axis;
    [
        row[axis] * whole[other] - row[other] * whole[axis],
        row[axis] * whole[2] - row[2] * whole[axis],
    ]
}

/// Colours of a cube texture, 0..=255.
#[inline(always)]
pub(crate) fn paint_cube<M: Machine>(
    texture: &Texture,
    whole: V3,
    rows: [V3; 3],
    batch: &Batch<M>,
    w: M::F,
) -> [M::F; 4] {
    let d = [
        M::mul(along(rows[0], batch), w),
        M::mul(along(rows[1], batch), w),
        M::mul(along(rows[2], batch), w),
    ];
    texture.cube::<M>(
        d,
        slopes::<M>(rows, d, whole, w, 0),
        slopes::<M>(rows, d, whole, w, 1),
    )
}

/// Change of a direction along one axis of the picture.
#[inline(always)]
fn slopes<M: Machine>(rows: [V3; 3], d: [M::F; 3], whole: V3, w: M::F, axis: usize) -> [M::F; 3] {
    let change = M::float(whole[axis]);
    [
        M::mul(M::sub(M::float(rows[0][axis]), M::mul(d[0], change)), w),
        M::mul(M::sub(M::float(rows[1][axis]), M::mul(d[1], change)), w),
        M::mul(M::sub(M::float(rows[2][axis]), M::mul(d[2], change)), w),
    ]
}
