//! A scene checked and cut into solids.
//!
//! [`Scene`] is immutable, so threads may share it; what moves is in [`crate::View`].

use crate::error::{Error, Result};
use crate::math::{V3, dot, times};
use crate::scene::{Geom, LightKind, MeshData, SceneSpec, Shape, TextureUse};
use crate::solid::Solid;
use crate::texture::TextureKind;

/// Cells along an infinite plane, and the most along a finite one (MuJoCo's `mjMAXPLANEGRID`).
const PLANE_CELLS: u32 = 200;

/// One solid of a geom.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) geom: usize,
    pub(crate) solid: usize,
    /// Metres per unit of the solid.
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

/// A scene ready to be drawn.
#[derive(Debug)]
pub struct Scene {
    pub(crate) spec: SceneSpec,
    pub(crate) solids: Vec<Solid>,
    /// Parts in drawing order.
    pub(crate) parts: Vec<Part>,
    /// For each geom how its texture lies on it.
    pub(crate) mapping: Vec<Mapping>,
    /// For each geom the step by which an endless plane follows the camera, 0 where it ends.
    pub(crate) plane_step: Vec<[f64; 2]>,
    /// Solid of the sky's cylinder.
    pub(crate) sky_solid: usize,
    /// Solid of the haze, if there is any.
    pub(crate) haze_solid: Option<usize>,
}

/// Solids by number; the common ones come first.
const SPHERE: usize = 0;
const TUBE: usize = 1;
const TOP: usize = 2;
const BOTTOM: usize = 3;
const CYLINDER: usize = 4;
const CUBOID: usize = 5;
const MESHES: usize = 6;

impl Scene {
    /// Checks the scene and cuts its solids.
    ///
    /// # Errors
    /// [`Error::Index`] for an index past a table's end, [`Error::NotFinite`] and [`Error::Range`] for numbers
    /// without meaning, [`Error::Unsupported`] for a cube texture on a mesh with texture coordinates.
    pub fn new(spec: SceneSpec) -> Result<Self> {
        check(&spec)?;
        let t = spec.tessellation;
        let mut solids = vec![
            Solid::sphere(t),
            Solid::tube(t),
            Solid::dome(1.0, t),
            Solid::dome(-1.0, t),
            Solid::cylinder(t),
            Solid::cuboid(t.quads),
        ];
        debug_assert_eq!(solids.len(), MESHES);
        solids.extend(spec.meshes.iter().map(Solid::mesh));
        let mut parts = Vec::new();
        let mut plane_step = Vec::new();
        for (g, geom) in spec.geoms.iter().enumerate() {
            let mut step = [0.0; 2];
            if let Shape::Plane { half_size, spacing } = geom.shape {
                let (solid, s) = plane_solid(half_size, spacing, geom.surface.texture, spec.far);
                solids.push(solid);
                step = s;
            }
            plane_step.push(step);
            for (solid, scale, shift) in parts_of(geom.shape, solids.len() - 1) {
                let radius = solids[solid]
                    .positions
                    .iter()
                    .map(|&p| dot(times(p, scale), times(p, scale)).sqrt())
                    .fold(0.0, f32::max);
                parts.push(Part {
                    geom: g,
                    solid,
                    scale,
                    shift,
                    radius,
                });
            }
        }
        // OpenGL draws the mirror first; where two surfaces lie in one plane the later one is seen.
        let mirror = spec.geoms.iter().position(|g| g.surface.is_mirror);
        parts.sort_by_key(|p| Some(p.geom) != mirror);
        let mapping = spec
            .geoms
            .iter()
            .map(|g| mapping_of(g, &spec))
            .collect::<Result<_>>()?;
        let haze_solid = spec.haze.map(|haze| {
            solids.push(Solid::belt(t.slices, haze.proportion));
            solids.len() - 1
        });
        Ok(Self {
            spec,
            solids,
            parts,
            mapping,
            plane_step,
            sky_solid: CYLINDER,
            haze_solid,
        })
    }

    /// Number of geoms.
    #[must_use]
    pub fn geom_count(&self) -> usize {
        self.spec.geoms.len()
    }

    /// Colour of the haze, in 0..=1 as OpenGL clamps it; black without haze.
    pub(crate) fn haze_colour(&self) -> V3 {
        let rgb = self.spec.haze.map_or([0.0; 3], |haze| haze.rgb);
        rgb.map(|c| c.clamp(0.0, 1.0))
    }

    /// Number of lights, headlight included.
    #[must_use]
    pub fn light_count(&self) -> usize {
        self.spec.lights.len()
    }
}

/// The solids of a shape with their scale and shift.
fn parts_of(shape: Shape, newest: usize) -> Vec<(usize, V3, f32)> {
    match shape {
        Shape::Plane { .. } => vec![(newest, [1.0; 3], 0.0)],
        Shape::Sphere { radius } => vec![(SPHERE, [radius; 3], 0.0)],
        Shape::Ellipsoid { radii } => vec![(SPHERE, radii, 0.0)],
        Shape::Cylinder {
            radius,
            half_length,
        } => vec![(CYLINDER, [radius, radius, half_length], 0.0)],
        Shape::Box { half_size } => vec![(CUBOID, half_size, 0.0)],
        Shape::Mesh { mesh, .. } => vec![(MESHES + mesh, [1.0; 3], 0.0)],
        Shape::Capsule {
            radius,
            half_length,
        } => vec![
            (TUBE, [radius, radius, half_length], 0.0),
            (TOP, [radius; 3], half_length),
            (BOTTOM, [radius; 3], -half_length),
        ],
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

/// The solid of a plane, and its following steps.
fn plane_solid(
    half: [f64; 2],
    spacing: f64,
    texture: Option<TextureUse>,
    far: f64,
) -> (Solid, [f64; 2]) {
    let repeat = |k: usize| texture.map(|t| t.repeat[k]);
    let (x, step_x) = plane_lines(half[0], spacing, repeat(0), far);
    let (y, step_y) = plane_lines(half[1], spacing, repeat(1), far);
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
    let solid = Solid::plane(&x, &y, [uv(x[0], y[0]), uv(last_x, y[0]), uv(x[0], last_y)]);
    (solid, [step_x, step_y])
}

/// Sizes that scale textures: MuJoCo's `mjvGeom.size`.
fn nominal_size(shape: Shape) -> V3 {
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
        | Shape::Cylinder {
            radius,
            half_length,
        } => [radius, radius, half_length],
        Shape::Ellipsoid { radii } => radii,
        Shape::Box { half_size } | Shape::Mesh { half_size, .. } => half_size,
    }
}

/// How the texture of a geom lies on it (MuJoCo's `settexture`).
fn mapping_of(geom: &Geom, spec: &SceneSpec) -> Result<Mapping> {
    let Some(texture) = geom.surface.texture else {
        return Ok(Mapping::None);
    };
    let size = nominal_size(geom.shape);
    let is_cube = spec.textures[texture.texture].kind() == TextureKind::Cube;
    let has_uv = match geom.shape {
        Shape::Mesh { mesh, .. } => !spec.meshes[mesh].uv.is_empty(),
        _ => !is_cube,
    };
    if is_cube && has_uv {
        return Err(Error::Unsupported {
            what: "a cube texture on a mesh with texture coordinates".into(),
        });
    }
    if is_cube {
        return Ok(Mapping::Cube {
            scale: if texture.uniform { size } else { [1.0; 3] },
        });
    }
    let mut scale = texture.repeat;
    for k in 0..2 {
        if has_uv {
            scale[k] = if scale[k] > 0.0 { scale[k] } else { 1.0 };
        } else if size[k] > 0.0 {
            scale[k] /= size[k];
        }
        if texture.uniform && size[k] > 0.0 {
            scale[k] *= size[k];
        }
    }
    if !has_uv {
        return Ok(Mapping::Projected { scale });
    }
    let is_endless = matches!(geom.shape, Shape::Plane { half_size, .. } if half_size[0] <= 0.0 || half_size[1] <= 0.0);
    Ok(Mapping::Surface {
        scale,
        offset: if is_endless { [-0.5; 2] } else { [0.0; 2] },
    })
}

/// Refuses rows with NaN or infinity.
fn finite<const N: usize>(what: &'static str, rows: &[[f32; N]]) -> Result<()> {
    match rows
        .iter()
        .position(|row| !row.iter().all(|x| x.is_finite()))
    {
        Some(index) => Err(Error::NotFinite { what, index }),
        None => Ok(()),
    }
}

/// Refuses an index that is not below `len`.
fn below(what: &'static str, index: usize, len: usize) -> Result<()> {
    if index < len {
        Ok(())
    } else {
        Err(Error::Index { what, index, len })
    }
}

/// Everything that must hold before a scene is cut into solids.
fn check(spec: &SceneSpec) -> Result<()> {
    let t = spec.tessellation;
    let fits = (3..=1000).contains(&t.slices)
        && (2..=1000).contains(&t.stacks)
        && (1..=1000).contains(&t.quads);
    if !fits {
        let got = format!(
            "{} slices, {} stacks, {} quads",
            t.slices, t.stacks, t.quads
        );
        return Err(Error::Range {
            what: "tessellation",
            expected: "3, 2, 1 up to 1000 of each",
            got,
        });
    }
    if !(spec.far.is_finite() && spec.far > 0.0) {
        return Err(Error::Range {
            what: "far plane",
            expected: "above 0",
            got: spec.far.to_string(),
        });
    }
    for mesh in &spec.meshes {
        check_mesh(mesh)?;
    }
    for (g, geom) in spec.geoms.iter().enumerate() {
        let s = geom.surface;
        let numbers = [
            s.rgba[0],
            s.rgba[1],
            s.rgba[2],
            s.rgba[3],
            s.emission,
            s.specular,
            s.shininess,
        ];
        let sizes = nominal_size(geom.shape);
        if !numbers.iter().chain(&sizes).all(|x| x.is_finite()) {
            return Err(Error::NotFinite {
                what: "surface or size of geom",
                index: g,
            });
        }
        if let Some(texture) = s.texture {
            below("texture", texture.texture, spec.textures.len())?;
            if !texture.repeat.iter().all(|x| x.is_finite()) {
                return Err(Error::NotFinite {
                    what: "texture repetitions of geom",
                    index: g,
                });
            }
        }
        if let Shape::Mesh { mesh, .. } = geom.shape {
            below("mesh", mesh, spec.meshes.len())?;
        }
    }
    for (index, light) in spec.lights.iter().enumerate() {
        let spot = match light.kind {
            LightKind::Directional => [0.0; 5],
            LightKind::Spot {
                attenuation: [constant, linear, quadratic],
                exponent,
                cutoff,
            } => [constant, linear, quadratic, exponent, cutoff],
        };
        let colours = [light.ambient, light.diffuse, light.specular];
        if !colours.iter().flatten().chain(&spot).all(|x| x.is_finite()) {
            return Err(Error::NotFinite {
                what: "light",
                index,
            });
        }
    }
    if let Some(haze) = spec.haze {
        let [red, green, blue] = haze.rgb;
        finite("haze", &[[red, green, blue, haze.proportion]])?;
    }
    if let Some(sky) = spec.sky {
        below("sky texture", sky, spec.textures.len())?;
        if spec.textures[sky].kind() != TextureKind::Cube {
            return Err(Error::Unsupported {
                what: "a sky that is not a cube texture".into(),
            });
        }
    }
    Ok(())
}

/// Refuses meshes whose tables do not fit together.
fn check_mesh(mesh: &MeshData) -> Result<()> {
    finite("mesh vertex", &mesh.vertices)?;
    finite("mesh normal", &mesh.normals)?;
    finite("mesh texture coordinate", &mesh.uv)?;
    let expected = mesh.faces.len();
    if mesh.face_normals.len() != expected {
        return Err(Error::Length {
            what: "mesh face normals",
            expected,
            got: mesh.face_normals.len(),
        });
    }
    let uv_expected = if mesh.uv.is_empty() { 0 } else { expected };
    if mesh.face_uv.len() != uv_expected {
        return Err(Error::Length {
            what: "mesh face texture",
            expected: uv_expected,
            got: mesh.face_uv.len(),
        });
    }
    let tables = [
        ("mesh vertex", &mesh.faces, mesh.vertices.len()),
        ("mesh normal", &mesh.face_normals, mesh.normals.len()),
        ("mesh texture coordinate", &mesh.face_uv, mesh.uv.len()),
    ];
    for (what, corners, len) in tables {
        for &corner in corners.iter().flatten() {
            below(what, corner as usize, len)?;
        }
    }
    Ok(())
}
