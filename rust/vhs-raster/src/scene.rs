//! What there is to draw: shapes, surfaces, lights, sky.
//!
//! Plain data from the caller. What stays from frame to frame goes into a [`crate::Scene`], what may change into a
//! [`crate::View`].

use crate::texture::Texture;

/// How finely curved and flat surfaces are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tessellation {
    /// Sides of a circle, at least 3.
    pub slices: usize,
    /// Bands from pole to pole of a sphere, or from end to end of a cylinder; at least 2.
    pub stacks: usize,
    /// Cells along each side of a box, at least 1.
    pub quads: usize,
}

impl Default for Tessellation {
    /// MuJoCo's defaults.
    fn default() -> Self {
        Self {
            slices: 28,
            stacks: 16,
            quads: 4,
        }
    }
}

/// Triangles given by the caller, in metres in the frame of their geom, counter-clockwise seen from outside.
#[derive(Debug, Clone, Default)]
pub struct MeshData {
    /// Corners.
    pub vertices: Vec<[f32; 3]>,
    /// Normals, of length 1.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates; empty when the mesh has none.
    pub uv: Vec<[f32; 2]>,
    /// Triangles as indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
    /// The same corners as indices into `normals`.
    pub face_normals: Vec<[u32; 3]>,
    /// The same corners as indices into `uv`; empty when the mesh has no texture coordinates.
    pub face_uv: Vec<[u32; 3]>,
}

/// Heights over a grid, in metres.
#[derive(Debug, Clone, Default)]
pub struct HeightField {
    /// Rows of the grid, along y; at least 2.
    pub rows: usize,
    /// Columns of the grid, along x; at least 2.
    pub columns: usize,
    /// Half sizes along x and y, largest height, and depth of the base below height 0.
    pub size: [f32; 4],
    /// Heights in 0..=1, row by row.
    pub heights: Vec<f32>,
}

/// A surface that bends: corners and normals are those of one moment, in metres in the world.
#[derive(Debug, Clone, Default)]
pub struct Soft {
    /// Corners.
    pub vertices: Vec<[f32; 3]>,
    /// A normal at each corner.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates at each corner; empty when the surface has none.
    pub uv: Vec<[f32; 2]>,
    /// Triangles as indices into `vertices`, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
}

/// Heads of an arrow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heads {
    /// A wide one at its end.
    One,
    /// One as wide as the shaft.
    Narrow,
    /// Wide ones at both ends.
    Two,
}

/// Form of a geom; sizes in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// The rectangle with these half sizes around the origin, normal z; 0 means endless along that axis.
    /// Lighting is evaluated on a grid with lines `spacing` apart.
    Plane {
        /// Half sizes along x and y; 0 is endless.
        half_size: [f64; 2],
        /// Half the distance between grid lines.
        spacing: f64,
    },
    /// A ball.
    Sphere {
        /// Its radius.
        radius: f32,
    },
    /// A cylinder along z closed by half balls.
    Capsule {
        /// Radius of the cylinder and of the half balls.
        radius: f32,
        /// Half the length of the cylinder alone.
        half_length: f32,
    },
    /// A ball scaled along its axes.
    Ellipsoid {
        /// The three radii.
        radii: [f32; 3],
    },
    /// A cylinder along z with flat ends.
    Cylinder {
        /// Its radius.
        radius: f32,
        /// Half its length.
        half_length: f32,
    },
    /// A cylinder along z without its ends.
    Tube {
        /// Its radius.
        radius: f32,
        /// Half its length.
        half_length: f32,
    },
    /// A cuboid.
    Box {
        /// Its half sizes.
        half_size: [f32; 3],
    },
    /// Triangles from the scene's table.
    Mesh {
        /// Index into [`SceneSpec::meshes`].
        mesh: usize,
        /// Half sizes of the box around it; only the scaling of textures without coordinates needs them.
        half_size: [f32; 3],
    },
    /// Heights from the scene's table.
    HeightField {
        /// Index into [`SceneSpec::height_fields`].
        field: usize,
        /// Half sizes along x and y, and its height; only the scaling of textures needs them.
        half_size: [f32; 3],
    },
    /// A surface that bends, from the view's table; its pose is ignored.
    Soft {
        /// Index into the softs of [`crate::View::set_geoms`].
        soft: usize,
        /// Scales of textures without coordinates.
        size: [f32; 3],
    },
    /// An arrow along z from the origin.
    Arrow {
        /// Half axes of its shaft along x and y, and its length.
        size: [f32; 3],
        /// Its heads.
        heads: Heads,
    },
    /// The triangle from the origin along x and y, seen from both sides.
    Triangle {
        /// Lengths of its two sides.
        sides: [f32; 2],
    },
    /// A line along z from the origin, of the same width wherever it is.
    Line {
        /// Width in pixels.
        width: f32,
        /// Length.
        length: f32,
    },
    /// The edges of a cuboid as lines.
    LineBox {
        /// Half sizes of the cuboid.
        half_size: [f32; 3],
        /// Width of its lines in pixels.
        width: f32,
    },
}

/// How a texture lies on a geom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    /// Index into [`SceneSpec::textures`].
    pub texture: usize,
    /// Repetitions along the two axes; for flat textures.
    pub repeat: [f32; 2],
    /// Whether repetitions count per metre instead of per object.
    pub uniform: bool,
}

/// Colour and gloss, as in OpenGL's fixed-function lighting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Red, green, blue, alpha, each in 0..=1. Alpha below 0.995 makes the geom transparent; 0 hides it.
    pub rgba: [f32; 4],
    /// Light the surface sends out by itself, as a share of its colour.
    pub emission: f32,
    /// Strength of highlights.
    pub specular: f32,
    /// Sharpness of highlights, 0..=1; the exponent is 128 times it.
    pub shininess: f32,
    /// Share of light that a plane or the upper side of a box mirrors; only the first such geom is a mirror.
    pub reflectance: f32,
    /// Texture, if any; its colour multiplies the lit one.
    pub texture: Option<TextureUse>,
}

impl Default for Surface {
    fn default() -> Self {
        Self {
            rgba: [0.5, 0.5, 0.5, 1.0],
            emission: 0.0,
            specular: 0.5,
            shininess: 0.5,
            reflectance: 0.0,
            texture: None,
        }
    }
}

/// One thing that is drawn, and where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geom {
    /// Its form.
    pub shape: Shape,
    /// Its surface.
    pub surface: Surface,
    /// Where its origin is, metres in the world.
    pub position: [f64; 3],
    /// Rotation `world_from_geom`, row by row.
    pub rotation: [f64; 9],
    /// Two numbers that a segmentation image shows for it; without them distances leave it out as well.
    pub tag: Option<[i32; 2]>,
    /// Whether it keeps light from others.
    pub casts_shadow: bool,
}

impl Geom {
    /// A geom of this form at the origin, with the default surface and tag `[0, 0]`.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            surface: Surface::default(),
            position: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            tag: Some([0, 0]),
            casts_shadow: true,
        }
    }
}

/// Where the rays of a light come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// Parallel rays.
    Directional,
    /// A cone of rays from a point.
    Spot {
        /// Constant, linear and quadratic decrease with distance (per metre, per square metre).
        attenuation: [f32; 3],
        /// Decrease towards the rim: power of the cosine.
        exponent: f32,
        /// Half angle of the cone in degrees, 0 to 90; any other means all directions alike, whatever the exponent.
        cutoff: f32,
    },
}

/// A light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Rays.
    pub kind: LightKind,
    /// Light that reaches every surface.
    pub ambient: [f32; 3],
    /// Light by the angle to the surface.
    pub diffuse: [f32; 3],
    /// Light of highlights.
    pub specular: [f32; 3],
    /// Where it is, metres in the world.
    pub position: [f32; 3],
    /// Direction of its rays, of any length.
    pub direction: [f32; 3],
    /// Whether it sits at the camera and shines along its gaze; its own pose is then ignored.
    pub is_headlight: bool,
    /// Whether geoms in its way keep it off.
    pub casts_shadow: bool,
}

/// A coloured belt over the horizon of the first endless plane; drawn only where there is a sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Haze {
    /// Red, green, blue in 0..=1.
    pub rgb: [f32; 3],
    /// Width of the belt relative to the distance of the horizon.
    pub proportion: f32,
}

/// Fog that grows evenly with the distance along the gaze.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fog {
    /// Red, green, blue in 0..=1.
    pub rgb: [f32; 3],
    /// Where it starts, in metres.
    pub start: f32,
    /// Where it hides everything, in metres.
    pub end: f32,
}

/// What limits shadows, as MuJoCo's shadow maps do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shadows {
    /// Texels along each side of a map; below 4 there are no shadows.
    pub size: usize,
    /// Half the side of the square around a directional light in which there are shadows, in metres.
    pub clip: f32,
    /// Share of a spot's cone in which there are shadows.
    pub scale: f32,
}

impl Default for Shadows {
    /// MuJoCo's defaults, for a scene of extent 1.
    fn default() -> Self {
        Self {
            size: 4096,
            clip: 1.0,
            scale: 0.6,
        }
    }
}

/// What stays the same from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct SceneSpec {
    /// Fineness of solids.
    pub tessellation: Tessellation,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Meshes.
    pub meshes: Vec<MeshData>,
    /// Height fields.
    pub height_fields: Vec<HeightField>,
    /// Cube texture of the sky, if any.
    pub sky: Option<usize>,
    /// Haze, if any.
    pub haze: Option<Haze>,
    /// Limits of shadows.
    pub shadows: Shadows,
    /// Fog, if any; a view says whether it is shown.
    pub fog: Option<Fog>,
    /// Distance of the far clipping plane in metres; endless planes and the sky end there.
    pub far: f64,
}
