//! Tessellated solids in their own unit frame, prepared once.
//!
//! The vertices, the order of corners and the texture coordinates are those of MuJoCo's OpenGL renderer
//! (`render_context.c`), so that shading between vertices and outlines agree with it. One thing differs: a flat
//! face that it cuts into a grid of quads stays **one** face here. The grid only matters to lighting, which is
//! interpolated between its nodes; [`Face`] keeps the grid and shading finds the node by coordinate. A cylinder
//! thus costs 84 faces instead of 1,800 triangles, an infinite plane one instead of 80,000.
//!
//! Corners run counter-clockwise seen from outside.

use crate::math::{V3, add, cross, dot, normalize, scale};
use std::f64::consts::PI;

/// Positions of grid lines along one side of a face, in 0..=1: the first and the last cell may be narrower.
#[derive(Debug, Clone)]
pub(crate) struct Lines {
    /// All lines, from 0 to 1.
    pub(crate) at: Vec<f32>,
    /// Inverse width of an inner cell.
    per_step: f32,
}

impl Lines {
    /// `cells` cells of equal width.
    pub(crate) fn even(cells: usize) -> Self {
        Self::new((0..=cells).map(|i| ratio(i, cells)).collect())
    }

    /// Lines at the given places; all cells but the first and last must be equally wide.
    pub(crate) fn new(at: Vec<f32>) -> Self {
        let step = if at.len() > 3 {
            (at[at.len() - 2] - at[1]) / ratio(at.len() - 3, 1)
        } else {
            1.0
        };
        Self {
            at,
            per_step: 1.0 / step,
        }
    }

    /// Number of cells.
    pub(crate) fn cells(&self) -> usize {
        self.at.len() - 1
    }

    /// The cell that holds `x`, and how far into it `x` lies (0..=1 inside).
    #[inline(always)]
    pub(crate) fn find(&self, x: f32) -> (usize, f32) {
        let last = self.cells() - 1;
        let guess = crate::math::floor_i32((x - self.at[1]) * self.per_step)
            .saturating_add(1)
            .max(0);
        #[expect(clippy::cast_sign_loss, reason = "not below 0")]
        let cell = (guess as usize).min(last);
        let (low, high) = (self.at[cell], self.at[cell + 1]);
        (
            cell,
            if high > low {
                (x - low) / (high - low)
            } else {
                0.0
            },
        )
    }
}

/// How lighting is looked up inside a flat face.
#[derive(Debug, Clone)]
pub(crate) enum Nodes {
    /// A parallelogram with a grid: node `(i, j)` is `base + i * step_s + j * step_t`.
    Grid {
        s: Lines,
        t: Lines,
        base: u32,
        step_s: u32,
        step_t: u32,
    },
    /// A slice of a disk in `rings` rings: ring `k` has its nodes at `a + k - 1` and `b + k - 1`, the centre at `c`.
    Slice {
        rings: usize,
        a: u32,
        b: u32,
        c: u32,
    },
}

/// A flat face larger than a triangle of the tessellation.
#[derive(Debug, Clone)]
pub(crate) struct Face {
    /// Corners: four of a parallelogram, or centre and two rim points (then the fourth repeats the third).
    pub(crate) corners: [u32; 4],
    /// Texture coordinates at the first, second and last distinct corner; they are affine on the face.
    pub(crate) uv: [[f32; 2]; 3],
    /// Its lighting nodes.
    pub(crate) nodes: Nodes,
}

/// A vertex as lighting sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub(crate) position: V3,
    pub(crate) normal: V3,
}

/// A surface made of triangles and larger flat faces.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solid {
    /// Corners, shared between neighbours so that outlines have no gaps.
    pub(crate) positions: Vec<V3>,
    /// Triangles: indices into `positions`.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// For each triangle its indices into `nodes` and `uv`.
    pub(crate) triangle_nodes: Vec<[u32; 3]>,
    /// Larger faces.
    pub(crate) faces: Vec<Face>,
    /// Lines: indices into `positions`.
    pub(crate) segments: Vec<[u32; 2]>,
    /// Vertices for lighting.
    pub(crate) nodes: Vec<Node>,
    /// Texture coordinates of the nodes; empty when the surface has none.
    pub(crate) uv: Vec<[f32; 2]>,
    /// Largest distance of a corner from the origin, by axis-wise scaling still an upper bound.
    pub(crate) radius: f32,
}

#[expect(
    clippy::cast_precision_loss,
    reason = "counts of a tessellation are far below 2^24"
)]
pub(crate) fn ratio(a: usize, b: usize) -> f32 {
    a as f32 / b as f32
}

/// Cosine and sine of `part / whole` of a turn.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "small counts; vertices are f32"
)]
pub(crate) fn turn(part: usize, whole: usize) -> (f32, f32) {
    let angle = 2.0 * PI * part as f64 / whole as f64;
    (libm::cos(angle) as f32, libm::sin(angle) as f32)
}

pub(crate) fn index(i: usize) -> u32 {
    u32::try_from(i).unwrap_or(u32::MAX)
}

impl Solid {
    pub(crate) fn finished(mut self) -> Self {
        self.radius = self
            .positions
            .iter()
            .map(|&p| dot(p, p).sqrt())
            .fold(0.0, f32::max);
        self
    }

    /// Adds a parallelogram with a grid: `corner` and its two sides, in counter-clockwise order.
    fn push_grid(
        &mut self,
        corner: V3,
        along_s: V3,
        along_t: V3,
        lines: (Lines, Lines),
        uv: [[f32; 2]; 3],
    ) {
        let (s, t) = lines;
        let first = index(self.positions.len());
        let opposite = add(add(corner, along_s), along_t);
        self.positions
            .extend([corner, add(corner, along_s), opposite, add(corner, along_t)]);
        let base = index(self.nodes.len());
        let normal = normalize(cross(along_s, along_t));
        for &b in &t.at {
            for &a in &s.at {
                let position = add(corner, add(scale(along_s, a), scale(along_t, b)));
                self.nodes.push(Node { position, normal });
            }
        }
        let corners = [first, first + 1, first + 2, first + 3];
        let step_t = index(s.at.len());
        self.faces.push(Face {
            corners,
            uv,
            nodes: Nodes::Grid {
                s,
                t,
                base,
                step_s: 1,
                step_t,
            },
        });
    }

    /// A plane through the origin with normal z, from its grid lines along x and y and its texture coordinates
    /// at the lower left, lower right and upper left corner.
    pub(crate) fn plane(x: &[f64], y: &[f64], uv: [[f32; 2]; 3]) -> Self {
        let mut solid = Self::default();
        let (x0, x1) = (x[0], x[x.len() - 1]);
        let (y0, y1) = (y[0], y[y.len() - 1]);
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let lines = |l: &[f64], low: f64, high: f64| {
            Lines::new(
                l.iter()
                    .map(|v| ((v - low) / (high - low)) as f32)
                    .collect(),
            )
        };
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let (corner, width, height) = (
            [x0 as f32, y0 as f32, 0.0],
            (x1 - x0) as f32,
            (y1 - y0) as f32,
        );
        solid.push_grid(
            corner,
            [width, 0.0, 0.0],
            [0.0, height, 0.0],
            (lines(x, x0, x1), lines(y, y0, y1)),
            uv,
        );
        solid.finished()
    }

    /// The box from -1 to 1 on all axes.
    pub(crate) fn cuboid(quads: usize) -> Self {
        let mut solid = Self::default();
        // Axes of the normal, of s and of t, and the sign of the normal. Where t runs downwards the corners stay
        // counter-clockwise and v still depends on the height alone.
        for (normal, s, t, upward_sign) in [(2, 0, 1, 1.0), (0, 1, 2, 1.0), (1, 0, 2, -1.0)] {
            for sign in [1.0, -1.0_f32] {
                let up = sign * upward_sign;
                let (mut corner, mut along_s, mut along_t) = ([-1.0; 3], [0.0; 3], [0.0; 3]);
                corner[normal] = sign;
                corner[t] = -up;
                along_s[s] = 2.0;
                along_t[t] = 2.0 * up;
                let v0 = 0.5 + 0.5 * up;
                let uv = [[0.0, v0], [1.0, v0], [0.0, 1.0 - v0]];
                solid.push_grid(
                    corner,
                    along_s,
                    along_t,
                    (Lines::even(quads), Lines::even(quads)),
                    uv,
                );
            }
        }
        solid.finished()
    }

    /// The belt of haze: a cone from height 0 to 1 that narrows to radius `1 - proportion` at its foot. Its first
    /// texture coordinate is its opacity, 1 along the line where sky and ground would meet (MuJoCo's `haze`).
    pub(crate) fn belt(slices: usize, proportion: f32) -> Self {
        let mut solid = Self::default();
        let r = f64::from(proportion);
        let alpha = libm::atan2(1.0, r);
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let middle = (libm::sqrt(0.5) * r * libm::sin(alpha) / libm::sin(0.75 * PI - alpha)) as f32;
        for (h, opacity) in [(0.0, 0.0), (middle, 1.0), (1.0, 0.0)] {
            let radius = 1.0 - proportion * (1.0 - h);
            for j in 0..slices {
                let (c, s) = turn(j, slices);
                let position = [c * radius, s * radius, h];
                solid.positions.push(position);
                solid.nodes.push(Node {
                    position,
                    normal: [0.0, 0.0, 1.0],
                });
                solid.uv.push([opacity, 0.0]);
            }
        }
        for band in 0..2 {
            for j in 0..slices {
                let at = |up: usize, j: usize| index((band + up) * slices + j % slices);
                let (a, b, c, d) = (at(0, j), at(0, j + 1), at(1, j + 1), at(1, j));
                solid.triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
        solid.triangle_nodes.clone_from(&solid.triangles);
        solid.finished()
    }

    /// Two sides of length 1 along x and y.
    pub(crate) fn triangle() -> Self {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let normal = [0.0, 0.0, 1.0];
        let nodes = positions.iter();
        Self {
            nodes: nodes.map(|&position| Node { position, normal }).collect(),
            uv: vec![[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            triangle_nodes: vec![[0, 1, 2]],
            positions,
            ..Self::default()
        }
        .finished()
    }

    /// A line of length 1 along z.
    pub(crate) fn line() -> Self {
        Self {
            positions: vec![[0.0; 3], [0.0, 0.0, 1.0]],
            segments: vec![[0, 1]],
            ..Self::default()
        }
        .finished()
    }

    /// The edges of the box from -1 to 1 on all axes.
    pub(crate) fn line_box() -> Self {
        let sign = |i: u32, k: u32| if i >> k & 1 == 1 { 1.0 } else { -1.0 };
        let ends = |i: u32| (0..3).map(move |k| [i, i | 1 << k]).filter(|[a, b]| a != b);
        Self {
            positions: (0..8).map(|i| [0, 1, 2].map(|k| sign(i, k))).collect(),
            segments: (0..8).flat_map(ends).collect(),
            ..Self::default()
        }
        .finished()
    }

    /// Makes corners at the same place one corner: fewer to transform, and edges that meet exactly.
    pub(crate) fn weld(&mut self) {
        let mut known = std::collections::HashMap::new();
        let mut kept = Vec::new();
        let moved: Vec<u32> = self
            .positions
            .iter()
            .map(|p| {
                // Adding 0 turns -0 into 0, which is the same place.
                *known
                    .entry(p.map(|x| (x + 0.0).to_bits()))
                    .or_insert_with(|| {
                        kept.push(*p);
                        index(kept.len() - 1)
                    })
            })
            .collect();
        self.positions = kept;
        for corner in self.triangles.iter_mut().flatten() {
            *corner = moved[*corner as usize];
        }
    }
}
