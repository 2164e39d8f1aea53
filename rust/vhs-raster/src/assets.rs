//! What stays from frame to frame, checked and cut into solids.
//!
//! [`Scene`] is immutable, so threads may share it; what may change is in [`crate::View`].

use crate::error::{Error, Result, check_len};
use crate::math::V3;
use crate::scene::{Fog, Haze, HeightField, MeshData, SceneSpec, Shadows, Tessellation};
use crate::solid::Solid;
use crate::texture::{Texture, TextureKind};

/// A scene ready to be drawn.
#[derive(Debug)]
pub struct Scene {
    pub(crate) far: f64,
    pub(crate) textures: Vec<Texture>,
    /// The common solids, then meshes, then height fields.
    pub(crate) solids: Vec<Solid>,
    meshes: usize,
    height_fields: usize,
    /// Cube texture of the sky.
    pub(crate) sky: Option<usize>,
    haze: Option<Haze>,
    pub(crate) shadows: Shadows,
    pub(crate) fog: Option<Fog>,
    /// Solid of the haze, if there is any.
    pub(crate) haze_solid: Option<usize>,
}

/// Solids by number; the common ones come first.
pub(crate) const SPHERE: usize = 0;
pub(crate) const TUBE: usize = 1;
pub(crate) const TOP: usize = 2;
pub(crate) const BOTTOM: usize = 3;
/// The sky is one, too.
pub(crate) const CYLINDER: usize = 4;
pub(crate) const CUBOID: usize = 5;
pub(crate) const CONE: usize = 6;
pub(crate) const TRIANGLE: usize = 7;
pub(crate) const LINE: usize = 8;
pub(crate) const LINE_BOX: usize = 9;
const MESHES: usize = 10;

/// Number of a mesh among the solids.
pub(crate) fn mesh_solid(mesh: usize) -> usize {
    MESHES + mesh
}

impl Scene {
    /// Checks the scene and cuts its solids.
    ///
    /// # Errors
    /// [`Error::Index`] for an index past a table's end, [`Error::NotFinite`], [`Error::Length`] and [`Error::Range`]
    /// for numbers without meaning, [`Error::Unsupported`] for a sky that is no cube texture.
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
            Solid::cone(t),
            Solid::triangle(),
            Solid::line(),
            Solid::line_box(),
        ];
        debug_assert_eq!(solids.len(), MESHES);
        solids.extend(spec.meshes.iter().map(Solid::mesh));
        let fields = spec.height_fields.iter();
        solids.extend(fields.map(|field| Solid::height_field(field, t.quads)));
        let haze_solid = spec.haze.map(|haze| {
            solids.push(Solid::belt(t.slices, haze.proportion));
            solids.len() - 1
        });
        Ok(Self {
            far: spec.far,
            textures: spec.textures,
            solids,
            meshes: spec.meshes.len(),
            height_fields: spec.height_fields.len(),
            sky: spec.sky,
            haze: spec.haze,
            shadows: spec.shadows,
            fog: spec.fog,
            haze_solid,
        })
    }

    /// Number of meshes.
    #[must_use]
    pub fn mesh_count(&self) -> usize {
        self.meshes
    }

    /// Number of height fields.
    #[must_use]
    pub fn height_field_count(&self) -> usize {
        self.height_fields
    }

    /// Number of textures.
    #[must_use]
    pub fn texture_count(&self) -> usize {
        self.textures.len()
    }

    /// Number of a height field among the solids.
    pub(crate) fn height_field_solid(&self, field: usize) -> usize {
        MESHES + self.meshes + field
    }

    /// Colour of the haze, in 0..=1 as OpenGL clamps it; black without haze.
    pub(crate) fn haze_colour(&self) -> V3 {
        let rgb = self.haze.map_or([0.0; 3], |haze| haze.rgb);
        rgb.map(|c| c.clamp(0.0, 1.0))
    }
}

/// Refuses rows with NaN or infinity.
pub(crate) fn finite<const N: usize>(what: &'static str, rows: &[[f32; N]]) -> Result<()> {
    match rows
        .iter()
        .position(|row| !row.iter().all(|x| x.is_finite()))
    {
        Some(index) => Err(Error::NotFinite { what, index }),
        None => Ok(()),
    }
}

/// Refuses an index that is not below `len`.
pub(crate) fn below(what: &'static str, index: usize, len: usize) -> Result<()> {
    if index < len {
        Ok(())
    } else {
        Err(Error::Index { what, index, len })
    }
}

/// Everything that must hold before a scene is cut into solids.
fn check(spec: &SceneSpec) -> Result<()> {
    check_tessellation(spec.tessellation)?;
    if !(spec.far.is_finite() && spec.far > 0.0) {
        return Err(Error::Range {
            what: "far plane",
            expected: "above 0",
            got: spec.far.to_string(),
        });
    }
    let Shadows { size, clip, scale } = spec.shadows;
    finite("shadow clip and scale", &[[clip, scale]])?;
    if size > 16_384 || clip <= 0.0 || scale <= 0.0 {
        return Err(Error::Range {
            what: "shadows",
            expected: "at most 16384 texels, a clip and a scale above 0",
            got: format!("{size}, {clip}, {scale}"),
        });
    }
    if let Some(fog) = spec.fog {
        let [red, green, blue] = fog.rgb;
        finite("fog", &[[red, green, blue, fog.start, fog.end]])?;
    }
    for mesh in &spec.meshes {
        check_mesh(mesh)?;
    }
    for field in &spec.height_fields {
        check_height_field(field)?;
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

fn check_tessellation(t: Tessellation) -> Result<()> {
    let fits = (3..=1000).contains(&t.slices)
        && (2..=1000).contains(&t.stacks)
        && (1..=1000).contains(&t.quads);
    if fits {
        return Ok(());
    }
    let got = format!(
        "{} slices, {} stacks, {} quads",
        t.slices, t.stacks, t.quads
    );
    Err(Error::Range {
        what: "tessellation",
        expected: "3, 2, 1 up to 1000 of each",
        got,
    })
}

fn check_height_field(field: &HeightField) -> Result<()> {
    if field.rows < 2 || field.columns < 2 {
        return Err(Error::Range {
            what: "height field",
            expected: "at least 2 rows and 2 columns",
            got: format!("{} and {}", field.rows, field.columns),
        });
    }
    let expected = field.rows * field.columns;
    check_len("heights of a height field", expected, field.heights.len())?;
    finite("height field size", &[field.size])?;
    match field.heights.iter().position(|h| !h.is_finite()) {
        Some(index) => Err(Error::NotFinite {
            what: "height",
            index,
        }),
        None => Ok(()),
    }
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
