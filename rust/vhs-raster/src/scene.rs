//! What there is to draw: shapes, surfaces, lights, sky; everything that does not move.
//!
//! Plain data from the caller; [`crate::Scene`] is made from it.

use crate::solid::Tessellation;
use crate::texture::Texture;

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
    /// Whether MuJoCo would mirror the scene in it; here it only decides who is drawn first.
    pub is_mirror: bool,
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
            is_mirror: false,
            texture: None,
        }
    }
}

/// One thing that is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geom {
    /// Its form.
    pub shape: Shape,
    /// Its surface.
    pub surface: Surface,
    /// Two numbers that a segmentation image shows for it.
    pub tag: [i32; 2],
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
        /// Half angle of the cone in degrees; 180 means all directions.
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
    /// Whether it sits at the camera and shines along its gaze; its pose in a view is then ignored.
    pub is_headlight: bool,
}

/// A coloured belt over the horizon of the first endless plane; drawn only where there is a sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Haze {
    /// Red, green, blue in 0..=1.
    pub rgb: [f32; 3],
    /// Width of the belt relative to the distance of the horizon.
    pub proportion: f32,
}

/// A whole scene as plain data.
#[derive(Debug, Clone, Default)]
pub struct SceneSpec {
    /// Fineness of solids.
    pub tessellation: Tessellation,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Meshes.
    pub meshes: Vec<MeshData>,
    /// What is drawn, in this order.
    pub geoms: Vec<Geom>,
    /// Lights; OpenGL knows eight, and so only the first eight shine.
    pub lights: Vec<Light>,
    /// Cube texture of the sky, if any.
    pub sky: Option<usize>,
    /// Haze, if any.
    pub haze: Option<Haze>,
    /// Distance of the far clipping plane in metres; endless planes and the sky end there.
    pub far: f64,
}
