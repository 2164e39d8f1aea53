//! The camera and its map from the world to the picture.

use crate::error::{Error, Result};
use crate::math::V3;

/// A camera in the world, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Where it is.
    pub position: [f64; 3],
    /// Where it looks.
    pub forward: [f64; 3],
    /// What is up in the picture; only its part across `forward` counts.
    pub up: [f64; 3],
    /// What it sees.
    pub lens: Lens,
    /// Nothing nearer than this is drawn.
    pub near: f32,
    /// Nothing farther than this is drawn.
    pub far: f32,
}

/// Mapping from a camera's view to its picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// Perspective with square pixels, from the full vertical angle in degrees.
    Angle {
        /// Vertical field of view in degrees.
        fovy: f64,
    },
    /// Perspective from distances on the image plane at distance 1: below, above, left, right of the axis.
    Frustum {
        /// Extent below the axis.
        bottom: f64,
        /// Extent above the axis.
        top: f64,
        /// Extent left of the axis.
        left: f64,
        /// Extent right of the axis.
        right: f64,
    },
    /// Parallel projection of this height in metres, square pixels.
    Parallel {
        /// Height of the picture in metres.
        height: f64,
    },
}

impl Camera {
    /// Position, gaze and up vector of a camera that circles a point: `azimuth` and `elevation` of its gaze in degrees.
    #[must_use]
    pub fn orbit(look_at: [f64; 3], distance: f64, azimuth: f64, elevation: f64) -> [[f64; 3]; 3] {
        let (a, e) = (azimuth.to_radians(), elevation.to_radians());
        let (ca, sa, ce, se) = (libm::cos(a), libm::sin(a), libm::cos(e), libm::sin(e));
        let forward = [ce * ca, ce * sa, se];
        let position = [0, 1, 2].map(|k| look_at[k] - distance * forward[k]);
        [position, forward, [-se * ca, -se * sa, ce]]
    }
}

/// The camera as a linear map from the world to the picture.
///
/// A point goes to `(X, Y, W, Z)`: its pixel is `(X / W, Y / W)`, measured from the middle of the picture with y
/// upwards, and `Z / W` grows towards the camera and is linear across the picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Projection {
    /// Rows of the map for X, Y, W; world axes.
    pub(crate) rows: [[f64; 3]; 3],
    /// Constant terms of X, Y, W.
    pub(crate) constant: [f64; 3],
    /// Z is 1 for perspective; else it is this row.
    pub(crate) depth_row: Option<[f64; 3]>,
    /// Where the camera is.
    pub(crate) origin: [f64; 3],
    /// `Z / W` of the far and of the near plane.
    pub(crate) depth_range: (f32, f32),
    /// Smallest W that is in view.
    pub(crate) near: f32,
    /// Gaze, of length 1.
    pub(crate) forward: V3,
    /// Planes around the view, normals of length 1 pointing inwards.
    sides: [([f64; 3], f64); 6],
}

fn cross64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit64(a: [f64; 3]) -> [f64; 3] {
    let length = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt();
    if length < 1e-10 {
        [0.0, 0.0, 1.0]
    } else {
        a.map(|x| x / length)
    }
}

/// Inverse of a matrix, given by its rows.
fn inverse([a, b, c]: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let columns = [cross64(b, c), cross64(c, a), cross64(a, b)];
    let determinant = dot64(a, columns[0]);
    [0, 1, 2].map(|i| [0, 1, 2].map(|k| columns[k][i] / determinant))
}

pub(crate) fn dot64(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Projection {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "the picture is drawn in f32"
    )]
    pub(crate) fn new(camera: &Camera, height: usize, width: usize) -> Self {
        let forward = unit64(camera.forward);
        let right = unit64(cross64(forward, camera.up));
        let up = unit64(cross64(right, forward));
        let (h, w) = (0.5 * height as f64, 0.5 * width as f64);
        let aspect = w / h;
        let combine = |kx: f64, a: [f64; 3], k: f64| [0, 1, 2].map(|i| kx * a[i] + k * forward[i]);
        let (rows, constant, depth_row, depth_range) = match camera.lens {
            Lens::Angle { .. } | Lens::Frustum { .. } => {
                let (b, t, l, r) = match camera.lens {
                    Lens::Frustum {
                        bottom,
                        top,
                        left,
                        right,
                    } => (-bottom, top, -left, right),
                    Lens::Angle { fovy } => {
                        let t = libm::tan(0.5 * fovy.to_radians());
                        (-t, t, -t * aspect, t * aspect)
                    }
                    Lens::Parallel { .. } => (-1.0, 1.0, -1.0, 1.0),
                };
                let x = combine(2.0 * w / (r - l), right, -w * (r + l) / (r - l));
                let y = combine(2.0 * h / (t - b), up, -h * (t + b) / (t - b));
                (
                    [x, y, forward],
                    [0.0; 3],
                    None,
                    (1.0 / camera.far, 1.0 / camera.near),
                )
            }
            Lens::Parallel { height } => {
                let k = 2.0 * h / height;
                let range = (-camera.far, -camera.near);
                (
                    [right.map(|v| k * v), up.map(|v| k * v), [0.0; 3]],
                    [0.0, 0.0, 1.0],
                    Some(forward.map(|v| -v)),
                    range,
                )
            }
        };
        let near = if depth_row.is_none() {
            camera.near
        } else {
            0.0
        };
        // Inside means |X| <= w W and |Y| <= h W, and a distance between near and far.
        let side = |axis: usize, sign: f64, reach: f64| {
            let normal = [0, 1, 2].map(|i| sign * rows[axis][i] + reach * rows[2][i]);
            let length = dot64(normal, normal).sqrt();
            (
                normal.map(|v| v / length),
                (sign * constant[axis] + reach * constant[2]) / length,
            )
        };
        let sides = [
            side(0, 1.0, w),
            side(0, -1.0, w),
            side(1, 1.0, h),
            side(1, -1.0, h),
            (forward, -f64::from(camera.near)),
            (forward.map(|v| -v), f64::from(camera.far)),
        ];
        let forward = forward.map(|v| v as f32);
        Self {
            rows,
            constant,
            depth_row,
            origin: camera.position,
            depth_range,
            near,
            forward,
            sides,
        }
    }

    /// Map from a solid's unit frame to the picture: matrix, constant, and the row of Z with its constant.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the picture is drawn in f32"
    )]
    pub(crate) fn of_part(
        &self,
        position: [f64; 3],
        r: &[f64; 9],
        scale: V3,
    ) -> ([f32; 9], V3, [f32; 4]) {
        let from_camera = [0, 1, 2].map(|k| position[k] - self.origin[k]);
        let through = |row: &[f64; 3]| {
            [0, 1, 2].map(|k| {
                ((row[0] * r[k] + row[1] * r[3 + k] + row[2] * r[6 + k]) * f64::from(scale[k]))
                    as f32
            })
        };
        let [a, b, c] = [0, 1, 2].map(|i| through(&self.rows[i]));
        let constant =
            [0, 1, 2].map(|i| (dot64(self.rows[i], from_camera) + self.constant[i]) as f32);
        let depth = self.depth_row.map_or([0.0, 0.0, 0.0, 1.0], |row| {
            let v = through(&row);
            [v[0], v[1], v[2], dot64(row, from_camera) as f32]
        });
        (
            [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]],
            constant,
            depth,
        )
    }

    /// From a ray, see [`Projection::of_rays`], to its way in the world.
    pub(crate) fn rays(&self) -> [[f64; 3]; 3] {
        let last = self.depth_row.unwrap_or(self.rows[2]);
        inverse([self.rows[0], self.rows[1], last])
    }

    /// The same map after every direction was turned, seen from another place.
    pub(crate) fn turned(&self, turn: impl Fn([f64; 3]) -> [f64; 3], origin: [f64; 3]) -> Self {
        Self {
            rows: self.rows.map(&turn),
            depth_row: self.depth_row.map(&turn),
            sides: self
                .sides
                .map(|(normal, constant)| (turn(normal), constant)),
            origin,
            ..*self
        }
    }

    /// Map from another camera's rays to this picture: matrix, constant, and the row of Z with its constant.
    ///
    /// A ray of a perspective is `(x, y, 1)`, to be multiplied by W; one of a parallel projection `(x, y, Z / W)`.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the picture is drawn in f32"
    )]
    pub(crate) fn of_rays(&self, other: &Self) -> ([f32; 9], V3, Option<[f32; 4]>) {
        let rays = other.rays();
        let through = |row: &[f64; 3]| {
            [0, 1, 2]
                .map(|k| (row[0] * rays[0][k] + row[1] * rays[1][k] + row[2] * rays[2][k]) as f32)
        };
        let way = [0, 1, 2].map(|k| other.origin[k] - self.origin[k]);
        let [a, b, c] = [0, 1, 2].map(|i| through(&self.rows[i]));
        let constant = [0, 1, 2].map(|i| (dot64(self.rows[i], way) + self.constant[i]) as f32);
        let depth = self.depth_row.map(|row| {
            let v = through(&row);
            [v[0], v[1], v[2], dot64(row, way) as f32]
        });
        (
            [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]],
            constant,
            depth,
        )
    }

    /// Where the camera is.
    #[expect(clippy::cast_possible_truncation, reason = "lighting is f32")]
    pub(crate) fn eye(&self) -> V3 {
        self.origin.map(|x| x as f32)
    }

    /// Whether a ball can touch the picture.
    pub(crate) fn may_see(&self, position: [f64; 3], radius: f32) -> bool {
        let from_camera = [0, 1, 2].map(|k| position[k] - self.origin[k]);
        let reach = f64::from(radius);
        self.sides
            .iter()
            .all(|(normal, constant)| dot64(*normal, from_camera) + constant >= -reach)
    }

    /// Distance along the gaze from a value of the depth buffer.
    pub(crate) fn distance(&self, depth: f32) -> f32 {
        if self.depth_row.is_some() {
            -depth
        } else {
            1.0 / depth
        }
    }
}

/// Refuses a camera that sees nothing.
pub(crate) fn check_camera(camera: &Camera) -> Result<()> {
    let ends = [f64::from(camera.near), f64::from(camera.far)];
    let lens = match camera.lens {
        Lens::Angle { fovy } => [fovy, 1.0, 1.0, 1.0],
        Lens::Frustum {
            bottom,
            top,
            left,
            right,
        } => [bottom, top, left, right],
        Lens::Parallel { height } => [height, 1.0, 1.0, 1.0],
    };
    let mut numbers = camera
        .position
        .iter()
        .chain(&camera.forward)
        .chain(&camera.up)
        .chain(&ends)
        .chain(&lens);
    if !numbers.all(|x| x.is_finite()) {
        return Err(Error::NotFinite {
            what: "camera",
            index: 0,
        });
    }
    let is_open = match camera.lens {
        Lens::Angle { fovy } => fovy > 0.0 && fovy < 180.0,
        Lens::Frustum {
            bottom,
            top,
            left,
            right,
        } => top + bottom > 0.0 && left + right > 0.0,
        Lens::Parallel { height } => height > 0.0,
    };
    if !is_open || camera.near <= 0.0 || camera.far <= camera.near {
        let got = format!(
            "{:?}, near {}, far {}",
            camera.lens, camera.near, camera.far
        );
        return Err(Error::Range {
            what: "camera",
            expected: "an open lens and 0 < near < far",
            got,
        });
    }
    Ok(())
}
