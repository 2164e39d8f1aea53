//! From a geom to what is drawn of it: its solids with their scales, and how its texture lies on them.

use crate::assets::{
    BOTTOM, CONE, CUBOID, CYLINDER, LINE, LINE_BOX, SPHERE, Scene, TOP, TRIANGLE, TUBE, mesh_solid,
};
use crate::math::{V3, dot};
use crate::scene::{Geom, Heads, Shape, Soft, TextureUse};
use crate::solid::Solid;
use crate::texture::TextureKind;

/// Cells along an infinite plane, and the most along a finite one (MuJoCo's `mjMAXPLANEGRID`).
const PLANE_CELLS: u32 = 200;

/// One solid of a geom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) geom: usize,
    pub(crate) solid: usize,
    /// Metres per unit of the solid; negative ones turn it around.
    pub(crate) scale: V3,
    /// Shift along the geom's z axis, in metres.
    pub(crate) shift: f32,
    /// No corner is farther than this from the shifted origin, in metres.
    pub(crate) radius: f32,
}

/// Texture coordinates of a geom, decided once.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Mapping {
    /// No texture.
    None,
    /// Coordinates of the surface times `scale` plus `offset`.
    Surface { scale: [f32; 2], offset: [f32; 2] },
    /// Coordinates from the position in the unit frame: `0.5 * scale * (x, -y) - 0.5`.
    Projected { scale: [f32; 2] },
    /// Direction into a cube texture: the position in the unit frame times this.
    Cube { scale: V3 },
}

/// Appends the parts of geom number `geom`; `own` is the solid that is its alone, for shapes that have one, and how
/// far that reaches.
pub(crate) fn push_parts(
    parts: &mut Vec<Part>,
    scene: &Scene,
    geom: usize,
    shape: Shape,
    own: (usize, f32),
) {
    let part = |solid: usize, scale: V3, shift: f32, radius: f32| Part {
        geom,
        solid,
        scale,
        shift,
        radius,
    };
    let length = |v: V3| dot(v, v).sqrt();
    let whole = |solid: usize| part(solid, [1.0; 3], 0.0, scene.solids[solid].radius);
    match shape {
        Shape::Plane { .. } | Shape::Soft { .. } => parts.push(part(own.0, [1.0; 3], 0.0, own.1)),
        Shape::Mesh { mesh, .. } => parts.push(whole(mesh_solid(mesh))),
        Shape::HeightField { field, .. } => parts.push(whole(scene.height_field_solid(field))),
        Shape::Sphere { radius } => parts.push(part(SPHERE, [radius; 3], 0.0, radius)),
        Shape::Ellipsoid { radii: r } => {
            parts.push(part(SPHERE, r, 0.0, r[0].max(r[1]).max(r[2])));
        }
        Shape::Cylinder {
            radius: r,
            half_length: l,
        } => parts.push(part(CYLINDER, [r, r, l], 0.0, r.hypot(l))),
        Shape::Tube {
            radius: r,
            half_length: l,
        } => parts.push(part(TUBE, [r, r, l], 0.0, r.hypot(l))),
        Shape::Box { half_size: h } => parts.push(part(CUBOID, h, 0.0, length(h))),
        Shape::Capsule {
            radius: r,
            half_length: l,
        } => parts.extend([
            part(TUBE, [r, r, l], 0.0, r.hypot(l)),
            part(TOP, [r; 3], l, r),
            part(BOTTOM, [r; 3], -l, r),
        ]),
        Shape::Arrow { size, heads } => {
            let pieces = arrow(size, heads);
            let all = pieces.map(|(solid, scale, shift)| part(solid, scale, shift, length(scale)));
            parts.extend(all.into_iter().filter(|p| p.scale != [0.0; 3]));
        }
        Shape::Triangle { sides: [a, b] } => {
            parts.push(part(TRIANGLE, [a, b, 1.0], 0.0, a.hypot(b)));
        }
        Shape::Line { length: l, .. } => parts.push(part(LINE, [1.0, 1.0, l], 0.0, l.abs())),
        Shape::LineBox { half_size: h, .. } => parts.push(part(LINE_BOX, h, 0.0, length(h))),
    }
}

/// Shaft and heads of an arrow as MuJoCo scales them: solid, scale and shift; what is missing has scale 0.
fn arrow([x, y, length]: V3, heads: Heads) -> [(usize, V3, f32); 3] {
    const WIDE: f32 = 1.75;
    let sixth = length / 6.0;
    let head = (CONE, [WIDE * x, WIDE * y, sixth], 2.0 * sixth);
    let shaft = (CYLINDER, [x, y, sixth], sixth);
    match heads {
        Heads::One => [shaft, head, (CONE, [0.0; 3], 0.0)],
        Heads::Narrow => [
            shaft,
            (CONE, [x, y, sixth], 2.0 * sixth),
            (CONE, [0.0; 3], 0.0),
        ],
        Heads::Two => [
            (TUBE, [x, y, 2.0 * sixth], 0.0),
            (CONE, [WIDE * x, -WIDE * y, -sixth], -2.0 * sixth),
            head,
        ],
    }
}

/// Sizes of a plane that make another solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlaneSizes {
    half_size: [f64; 2],
    spacing: f64,
    repeat: Option<[f32; 2]>,
}

impl PlaneSizes {
    pub(crate) fn of(half_size: [f64; 2], spacing: f64, texture: Option<TextureUse>) -> Self {
        Self {
            half_size,
            spacing,
            repeat: texture.map(|t| t.repeat),
        }
    }

    /// The solid, and the step by which the plane follows the camera along each axis; 0 where it ends.
    pub(crate) fn solid(self, far: f64) -> (Solid, [f64; 2]) {
        let half = self.half_size;
        let repeat = |k: usize| self.repeat.map(|r| r[k]);
        let (x, step_x) = plane_lines(half[0], self.spacing, repeat(0), far);
        let (y, step_y) = plane_lines(half[1], self.spacing, repeat(1), far);
        let (last_x, last_y) = (x[x.len() - 1], y[y.len() - 1]);
        // A side that ends carries 0..1; an endless one counts half metres.
        let u = |v: f64| {
            if half[0] > 0.0 {
                (v + half[0]) / (2.0 * half[0])
            } else {
                0.5 * v
            }
        };
        let w = |v: f64| {
            if half[1] > 0.0 {
                1.0 - (v + half[1]) / (2.0 * half[1])
            } else {
                -0.5 * v
            }
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "texture coordinates are f32"
        )]
        let uv = |a: f64, b: f64| [u(a) as f32, w(b) as f32];
        let corners = [uv(x[0], y[0]), uv(last_x, y[0]), uv(x[0], last_y)];
        (Solid::plane(&x, &y, corners), [step_x, step_y])
    }
}

/// Grid lines of a plane along one axis, as MuJoCo lays them, and the step by which it follows the camera.
fn plane_lines(half: f64, spacing: f64, repeat: Option<f32>, far: f64) -> (Vec<f64>, f64) {
    let most = f64::from(PLANE_CELLS);
    if half > 0.0 {
        let step = spacing.max(half / (most - 2.0));
        let mut inner = (half / step).floor();
        inner -= inner % 2.0;
        let pad = half - inner * step;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most 198"
        )]
        let inner = inner as u32;
        let mut lines = vec![-half];
        lines.extend((0..=inner).map(|i| -half + pad + 2.0 * step * f64::from(i)));
        lines.push(half);
        return (lines, 0.0);
    }
    let step = match repeat {
        Some(r) if r > 0.0 => 2.0 / f64::from(r),
        _ => 2.1 * far / (most - 2.0),
    };
    let d = (2.1 * far + 2.0 * step) / most;
    let lines = (0..=PLANE_CELLS)
        .map(|i| d * f64::from(i) - d * f64::from(PLANE_CELLS / 2))
        .collect();
    (lines, step)
}

/// Sizes that scale textures: MuJoCo's `mjvGeom.size`.
pub(crate) fn nominal_size(shape: Shape) -> V3 {
    match shape {
        #[expect(clippy::cast_possible_truncation, reason = "texture scales are f32")]
        Shape::Plane { half_size, spacing } => {
            [half_size[0] as f32, half_size[1] as f32, spacing as f32]
        }
        Shape::Sphere { radius } => [radius; 3],
        Shape::Capsule {
            radius,
            half_length,
        }
        | Shape::Tube {
            radius,
            half_length,
        }
        | Shape::Cylinder {
            radius,
            half_length,
        } => [radius, radius, half_length],
        Shape::Ellipsoid { radii: size } | Shape::Arrow { size, .. } | Shape::Soft { size, .. } => {
            size
        }
        Shape::Box { half_size }
        | Shape::Mesh { half_size, .. }
        | Shape::HeightField { half_size, .. }
        | Shape::LineBox { half_size, .. } => half_size,
        Shape::Triangle { sides } => [sides[0], sides[1], 0.0],
        Shape::Line { width, length } => [width, 0.0, length],
    }
}

/// Whether a geom comes with texture coordinates that ask for a flat texture; `softs` says so of bending surfaces.
pub(crate) fn brings_uv(scene: &Scene, shape: Shape, softs: &[Soft]) -> bool {
    match shape {
        Shape::Mesh { mesh, .. } => !scene.solids[mesh_solid(mesh)].uv.is_empty(),
        Shape::Soft { soft, .. } => !softs[soft].uv.is_empty(),
        _ => false,
    }
}

/// How the texture of a geom lies on it (MuJoCo's `settexture`), for a geom that [`brings_uv`] or does not.
pub(crate) fn mapping_of(scene: &Scene, geom: &Geom, brings_uv: bool) -> Mapping {
    let Some(texture) = geom.surface.texture else {
        return Mapping::None;
    };
    let size = nominal_size(geom.shape);
    let is_cube = scene.textures[texture.texture].kind() == TextureKind::Cube;
    let is_bare = matches!(
        geom.shape,
        Shape::Mesh { .. } | Shape::Soft { .. } | Shape::HeightField { .. }
    );
    let has_uv = brings_uv || (!is_bare && !is_cube);
    if is_cube && brings_uv {
        return Mapping::None;
    }
    if is_cube {
        return Mapping::Cube {
            scale: if texture.uniform { size } else { [1.0; 3] },
        };
    }
    let is_scaled = !matches!(geom.shape, Shape::Soft { .. });
    let mut scale = texture.repeat;
    for k in 0..2 {
        if has_uv {
            scale[k] = if scale[k] > 0.0 { scale[k] } else { 1.0 };
        } else if size[k] > 0.0 && is_scaled {
            scale[k] /= size[k];
        }
        if texture.uniform && size[k] > 0.0 {
            scale[k] *= size[k];
        }
    }
    if !has_uv {
        return Mapping::Projected { scale };
    }
    let is_endless = matches!(geom.shape, Shape::Plane { half_size, .. } if half_size[0] <= 0.0 || half_size[1] <= 0.0);
    Mapping::Surface {
        scale,
        offset: if is_endless { [-0.5; 2] } else { [0.0; 2] },
    }
}
