//! Who stands in a light's way: shadows as MuJoCo's shadow maps show them, without the maps.
//!
//! A map has millions of texels, and a picture looks at few of them. So the order is turned around: visible samples
//! are placed in the light's picture, at the middles of the texels that OpenGL would look up, and every face that the
//! light sees is compared with the samples in its way (Aila and Laine, "Alias-free shadow maps", 2004). The answer is
//! that of a map of the same size, offsets against self-shadowing included.

use std::ops::Range;

use crate::camera::{Camera, Lens, Projection};
use crate::cover::{Corner, Outline, Window, window_around};
use crate::frame::{Frame, Sink};
use crate::math::V3;
use crate::paint::Sample;
use crate::scene::{Light, LightKind, Shadows};
use crate::view::View;

/// Offset of depths in a map: in largest slopes across a texel, and in steps of a depth buffer of 24 bits.
const OFFSET_SLOPES: f32 = 1.5;
const OFFSET_STEPS: f32 = 4.0 / 16_777_216.0;
/// Widest angle of a light's picture, in degrees.
const WIDEST: f64 = 160.0;
/// Samples that a bin holds on average.
const IN_A_BIN: usize = 16;
/// Most bins along each side.
const MOST_BINS: usize = 256;

/// The picture that a light sees.
struct Lamp {
    projection: Projection,
    /// Depth in a map, 1 near and 0 far, is `scale * (Z / W) + constant`.
    scale: f32,
    constant: f32,
    /// Texels along each side of the map.
    size: f32,
}

impl Lamp {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "pictures are f32, and maps have at most 16384 texels a side"
    )]
    fn new(light: &Light, settings: Shadows, camera: &Camera) -> Self {
        let forward = light.direction.map(f64::from);
        let lens = match light.kind {
            LightKind::Directional => Lens::Parallel {
                height: 2.0 * f64::from(settings.clip),
            },
            LightKind::Spot { cutoff, .. } => Lens::Angle {
                fovy: (2.0 * f64::from(cutoff) * f64::from(settings.scale)).clamp(1e-3, WIDEST),
            },
        };
        let eye = Camera {
            position: light.position.map(f64::from),
            forward,
            up: across(forward),
            lens,
            near: camera.near,
            far: camera.far,
        };
        let (near, far) = (f64::from(camera.near), f64::from(camera.far));
        let (scale, constant) = match lens {
            Lens::Parallel { .. } => (1.0 / (far - near), far / (far - near)),
            _ => (near * far / (far - near), -near / (far - near)),
        };
        // The outermost texels stay empty, so that no shadow goes on past the map's edge.
        let inner = settings.size - 2;
        Self {
            projection: Projection::new(&eye, inner, inner),
            scale: scale as f32,
            constant: constant as f32,
            size: settings.size as f32,
        }
    }
}

/// Some vector across another, as MuJoCo picks it.
fn across(v: [f64; 3]) -> [f64; 3] {
    let first = [0.0, -v[2], v[1]];
    if first.iter().map(|x| x * x).sum::<f64>() > 0.01 {
        first
    } else {
        [-v[2], 0.0, v[0]]
    }
}

/// Which of some samples a light does not reach.
#[derive(Debug, Default)]
pub(crate) struct Shade {
    /// One for each sample.
    pub(crate) is_dark: Vec<bool>,
    points: Points,
}

/// Samples in the light's picture, bin by bin.
#[derive(Debug, Default)]
struct Points {
    /// Place, and depth in the map.
    at: Vec<[f32; 3]>,
    /// Number of the sample.
    number: Vec<u32>,
    is_dark: Vec<bool>,
    /// First point of each bin, row by row, and the end.
    starts: Vec<u32>,
    columns: usize,
    rows: usize,
    /// Corners of all points, and bins for a texel.
    low: [f32; 2],
    high: [f32; 2],
    per_texel: [f32; 2],
    /// Places before they are sorted.
    unsorted: Vec<([f32; 3], u32)>,
}

impl Shade {
    /// Finds out for `samples`, as seen through `projection`.
    pub(crate) fn find(
        &mut self,
        view: &View,
        light: &Light,
        projection: &Projection,
        samples: &[Sample],
        frame: &mut Frame,
    ) {
        self.is_dark.clear();
        self.is_dark.resize(samples.len(), false);
        let lamp = Lamp::new(light, view.scene.shadows, &view.camera);
        self.points.place(&lamp, projection, samples);
        if self.points.unsorted.is_empty() {
            return;
        }
        self.points.sort();
        let mut caster = Caster {
            points: &mut self.points,
            scale: lamp.scale,
            constant: lamp.constant,
        };
        frame.cast(view, &lamp.projection, &mut caster);
        for (&number, &is_dark) in self.points.number.iter().zip(&self.points.is_dark) {
            self.is_dark[number as usize] = is_dark;
        }
    }
}

impl Points {
    /// Places samples in the light's picture; what lies outside of it is lit.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "numbers of samples, far fewer than 2^32"
    )]
    fn place(&mut self, lamp: &Lamp, projection: &Projection, samples: &[Sample]) {
        self.unsorted.clear();
        let (matrix, constant, depth_row) = lamp.projection.of_rays(projection);
        let inner = lamp.size - 2.0;
        let along = |row: usize, ray: V3| {
            matrix[3 * row] * ray[0] + matrix[3 * row + 1] * ray[1] + matrix[3 * row + 2] * ray[2]
        };
        for (number, sample) in samples.iter().enumerate() {
            let [x, y] = sample.at;
            let depth = sample.depth[0] * x + sample.depth[1] * y + sample.depth[2];
            let (ray, reach) = if projection.depth_row.is_some() {
                ([x, y, depth], 1.0)
            } else {
                ([x, y, 1.0], 1.0 / depth)
            };
            let p = [0, 1, 2].map(|row| along(row, ray) * reach + constant[row]);
            let z = match depth_row {
                Some(row) => (row[0] * ray[0] + row[1] * ray[1] + row[2] * ray[2]) * reach + row[3],
                None => 1.0,
            };
            if p[2] <= 0.0 {
                continue;
            }
            // The texel that OpenGL looks up, and where its middle is in the map's picture.
            let texel = |v: f32| {
                let t = ((v / p[2] / inner + 0.5) * lamp.size).floor();
                (t, t + 0.5 - 0.5 * lamp.size)
            };
            let ((column, u), (row, v)) = (texel(p[0]), texel(p[1]));
            let is_within = |t: f32| t >= 1.0 && t <= lamp.size - 2.0;
            if is_within(column) && is_within(row) {
                let depth = (lamp.scale * (z / p[2]) + lamp.constant).clamp(0.0, 1.0);
                self.unsorted.push(([u, v, depth], number as u32));
            }
        }
    }

    /// Sorts the points into bins.
    #[expect(clippy::cast_precision_loss, reason = "few bins")]
    fn sort(&mut self) {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for (at, _) in &self.unsorted {
            for k in 0..2 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k]);
            }
        }
        let side = (self.unsorted.len() / IN_A_BIN).isqrt().clamp(1, MOST_BINS);
        (self.columns, self.rows) = (side, side);
        (self.low, self.high) = (low, high);
        self.per_texel = [0, 1].map(|k| side as f32 / (high[k] - low[k] + 1e-3));
        self.starts.clear();
        self.starts.resize(side * side + 1, 0);
        for (at, _) in &self.unsorted {
            let bin = self.bin(*at);
            self.starts[bin + 1] += 1;
        }
        for bin in 0..side * side {
            self.starts[bin + 1] += self.starts[bin];
        }
        let len = self.unsorted.len();
        self.at.resize(len, [0.0; 3]);
        self.number.resize(len, 0);
        self.is_dark.clear();
        self.is_dark.resize(len, false);
        let mut next = self.starts.clone();
        for &(at, number) in &self.unsorted {
            let slot = &mut next[self.bin(at)];
            self.at[*slot as usize] = at;
            self.number[*slot as usize] = number;
            *slot += 1;
        }
    }

    fn bin(&self, at: [f32; 3]) -> usize {
        let [column, row] = [0, 1].map(|k| self.along(k, at[k]));
        row * self.columns + column
    }

    /// Column (`axis` 0) or row of the bins at a place.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the bins"
    )]
    fn along(&self, axis: usize, at: f32) -> usize {
        let most = if axis == 0 { self.columns } else { self.rows };
        (((at - self.low[axis]) * self.per_texel[axis]).max(0.0) as usize).min(most - 1)
    }

    /// Columns or rows between two places.
    fn between(&self, axis: usize, low: f32, high: f32) -> Range<usize> {
        self.along(axis, low)..self.along(axis, high) + 1
    }
}

/// Where the faces go that a light sees.
struct Caster<'a> {
    points: &'a mut Points,
    scale: f32,
    constant: f32,
}

impl Sink for Caster<'_> {
    fn window<const N: usize>(&self, corners: &[Corner; N], near: f32) -> Option<Window> {
        let (low, high) = window_around(corners, near)?;
        let points = &self.points;
        let (low, high) = (low.map(|x| x - 0.01), high.map(|x| x + 0.01));
        if (0..2).any(|k| low[k] > points.high[k] || high[k] < points.low[k]) {
            return None;
        }
        let [columns, rows] = [0, 1].map(|k| points.between(k, low[k], high[k]));
        Some(Window {
            x0: columns.start,
            x1: columns.end,
            y0: rows.start,
            y1: rows.end,
        })
    }

    fn is_smooth(&self) -> bool {
        false
    }

    fn sees_both_sides(&self) -> bool {
        true
    }

    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, _: usize) {
        let points = &mut *self.points;
        let steepest = outline.depth[0].abs().max(outline.depth[1].abs());
        let offset = OFFSET_SLOPES * self.scale * steepest + OFFSET_STEPS;
        for row in window.y0..window.y1 {
            let first = row * points.columns;
            let (start, end) = (
                points.starts[first + window.x0] as usize,
                points.starts[first + window.x1] as usize,
            );
            let dark = &mut points.is_dark[start..end];
            for (at, is_dark) in points.at[start..end].iter().zip(dark) {
                let depth = outline.at(at[0], at[1]);
                let depth = depth.map(|depth| self.scale * depth + self.constant);
                // The map holds what lies between its near and its far plane.
                *is_dark |= depth.is_some_and(|d| (0.0..=1.0).contains(&d) && at[2] < d - offset);
            }
        }
    }
}
