//! What may change from frame to frame: geoms, lights, the camera, and what is switched on.
//!
//! Poses come in f64 and are taken relative to the camera before they are rounded to f32, so that a scene far
//! from its origin loses nothing.

use std::sync::Arc;

use crate::assets::{Scene, below, finite};
use crate::camera::{Camera, Lens, Projection, check_camera};
use crate::error::{Error, Result, check_len};
use crate::math::V3;
use crate::parts::{Mapping, Part, PlaneSizes, brings_uv, mapping_of, nominal_size, push_parts};
use crate::scene::{Fog, Geom, Light, LightKind, Shape, Soft};
use crate::solid::Solid;
use crate::texture::TextureKind;

/// What is shown besides geoms.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "five switches that do not depend on each other"
)]
pub struct Effects {
    /// The scene's sky, if it has one.
    pub has_sky: bool,
    /// The scene's haze; only where there is a sky.
    pub has_haze: bool,
    /// Shadows of the lights that cast them; without, such lights shine through everything.
    pub has_shadows: bool,
    /// What the first geom that can mirrors.
    pub has_reflections: bool,
    /// The scene's fog, if it has one.
    pub has_fog: bool,
}

impl Default for Effects {
    fn default() -> Self {
        Self {
            has_sky: true,
            has_haze: true,
            has_shadows: true,
            has_reflections: true,
            has_fog: false,
        }
    }
}

/// A geom with what was decided for it once.
#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub(crate) geom: Geom,
    pub(crate) mapping: Mapping,
    /// Step by which an endless plane follows the camera, 0 where it ends.
    pub(crate) step: [f64; 2],
}

/// One moment of a scene, seen by one camera.
#[derive(Debug, Clone)]
pub struct View {
    pub(crate) scene: Arc<Scene>,
    pub(crate) geoms: Vec<Shown>,
    /// Parts in drawing order.
    pub(crate) parts: Vec<Part>,
    pub(crate) lights: Vec<Light>,
    pub(crate) camera: Camera,
    pub(crate) effects: Effects,
    /// Planes, kept from frame to frame as long as they have these sizes.
    planes: Vec<(PlaneSizes, Arc<Solid>, [f64; 2])>,
    /// Solids of this view alone: planes and softs.
    own: Vec<Arc<Solid>>,
}

impl View {
    /// A view of `scene` without geoms and lights.
    ///
    /// # Errors
    /// As [`View::set_camera`].
    pub fn new(scene: Arc<Scene>, camera: Camera) -> Result<Self> {
        check_camera(&camera)?;
        Ok(Self {
            scene,
            geoms: Vec::new(),
            parts: Vec::new(),
            lights: Vec::new(),
            camera,
            effects: Effects::default(),
            planes: Vec::new(),
            own: Vec::new(),
        })
    }

    /// Says what is drawn: `geoms` in this order, and the bending surfaces that they point at.
    ///
    /// # Errors
    /// [`Error::Index`] for an index past a table's end, [`Error::NotFinite`] for NaN or infinity, [`Error::Length`] for
    /// tables of a soft that do not fit together. Then nothing changes.
    pub fn set_geoms(&mut self, geoms: &[Geom], softs: &[Soft]) -> Result<()> {
        for soft in softs {
            check_soft(soft)?;
        }
        for (g, geom) in geoms.iter().enumerate() {
            self.check_geom(g, geom, softs.len())?;
        }
        self.own.clear();
        self.own
            .extend(softs.iter().map(|soft| Arc::new(Solid::soft(soft))));
        self.geoms.clear();
        self.parts.clear();
        let old = std::mem::take(&mut self.planes);
        let mut flat = self.last_flat_texture(geoms);
        for (g, &geom) in geoms.iter().enumerate() {
            let mut geom = geom;
            let brings_uv = brings_uv(&self.scene, geom.shape, softs);
            if let Some(used) = &mut geom.surface.texture {
                if self.is_flat(used.texture) {
                    flat = Some(used.texture);
                } else if brings_uv {
                    // OpenGL cannot bind a cube where a flat texture is asked for: the last flat one stays.
                    used.texture = flat.unwrap_or(used.texture);
                }
            }
            let (own, step) = self.own_solid(&geom, &old);
            let radius = self.own.get(own).map_or(0.0, |solid| solid.radius);
            let number = self.scene.solids.len() + own;
            push_parts(
                &mut self.parts,
                &self.scene,
                g,
                geom.shape,
                (number, radius),
            );
            let mapping = mapping_of(&self.scene, &geom, brings_uv);
            self.geoms.push(Shown {
                geom,
                mapping,
                step,
            });
        }
        Ok(())
    }

    fn is_flat(&self, texture: usize) -> bool {
        self.scene.textures[texture].kind() == TextureKind::Flat
    }

    /// The flat texture that was used last before a frame of these geoms: in the frame before, or when it was loaded.
    fn last_flat_texture(&self, geoms: &[Geom]) -> Option<usize> {
        let used = geoms.iter().rev().filter_map(|g| g.surface.texture);
        let used = used.map(|used| used.texture).find(|&t| self.is_flat(t));
        used.or_else(|| (0..self.scene.textures.len()).rfind(|&t| self.is_flat(t)))
    }

    /// Number of the solid that is this geom's alone within `own`, and the step by which it follows the camera.
    fn own_solid(
        &mut self,
        geom: &Geom,
        old: &[(PlaneSizes, Arc<Solid>, [f64; 2])],
    ) -> (usize, [f64; 2]) {
        let (half_size, spacing) = match geom.shape {
            Shape::Plane { half_size, spacing } => (half_size, spacing),
            Shape::Soft { soft, .. } => return (soft, [0.0; 2]),
            _ => return (0, [0.0; 2]),
        };
        let sizes = PlaneSizes::of(half_size, spacing, geom.surface.texture);
        let known = old.iter().chain(&self.planes).find(|p| p.0 == sizes);
        let plane = known.cloned().unwrap_or_else(|| {
            let (solid, step) = sizes.solid(self.scene.far);
            (sizes, Arc::new(solid), step)
        });
        let step = plane.2;
        self.own.push(plane.1.clone());
        self.planes.push(plane);
        (self.own.len() - 1, step)
    }

    /// Says what shines; OpenGL knows eight lights, and so only the first eight do.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for NaN or infinity; then nothing changes.
    pub fn set_lights(&mut self, lights: &[Light]) -> Result<()> {
        for (index, light) in lights.iter().enumerate() {
            let spot = match light.kind {
                LightKind::Directional => [0.0; 5],
                LightKind::Spot {
                    attenuation: [constant, linear, quadratic],
                    exponent,
                    cutoff,
                } => [constant, linear, quadratic, exponent, cutoff],
            };
            let vectors = [
                light.ambient,
                light.diffuse,
                light.specular,
                light.position,
                light.direction,
            ];
            if !vectors.iter().flatten().chain(&spot).all(|x| x.is_finite()) {
                return Err(Error::NotFinite {
                    what: "light",
                    index,
                });
            }
        }
        self.lights.clear();
        self.lights.extend_from_slice(lights);
        Ok(())
    }

    /// Places the camera.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::Range`] for a camera that sees nothing; then nothing changes.
    pub fn set_camera(&mut self, camera: Camera) -> Result<()> {
        check_camera(&camera)?;
        self.camera = camera;
        Ok(())
    }

    /// Says what is shown besides geoms.
    pub fn set_effects(&mut self, effects: Effects) {
        self.effects = effects;
    }

    /// Whether a light is kept off by what is in its way.
    pub(crate) fn has_shadow(&self, light: &Light) -> bool {
        self.effects.has_shadows && self.scene.shadows.size >= 4 && light.casts_shadow
    }

    /// The fog that is shown, and whether distances are those of a parallel projection.
    pub(crate) fn fog(&self) -> Option<(Fog, bool)> {
        let fog = self.scene.fog.filter(|_| self.effects.has_fog)?;
        Some((fog, matches!(self.camera.lens, Lens::Parallel { .. })))
    }

    /// A solid by the number that a part has for it.
    pub(crate) fn solid(&self, number: usize) -> &Solid {
        let shared = &self.scene.solids;
        if number < shared.len() {
            &shared[number]
        } else {
            &self.own[number - shared.len()]
        }
    }

    pub(crate) fn projection(&self, height: usize, width: usize) -> Projection {
        Projection::new(&self.camera, height, width)
    }

    /// Where the camera is, and where a light at it shines.
    #[expect(clippy::cast_possible_truncation, reason = "lighting is f32")]
    pub(crate) fn eye(&self) -> V3 {
        self.camera.position.map(|x| x as f32)
    }

    /// Refuses a geom that points past a table's end or is nowhere.
    fn check_geom(&self, index: usize, geom: &Geom, softs: usize) -> Result<()> {
        let s = geom.surface;
        let [r, g, b, a] = s.rgba;
        let gloss = [s.emission, s.specular, s.shininess, s.reflectance];
        // A product with 0 is 0 for finite numbers only, and adding up needs no branch per number.
        let pose = geom.position.iter().chain(&geom.rotation);
        let other = [r, g, b, a]
            .into_iter()
            .chain(gloss)
            .chain(nominal_size(geom.shape));
        let what = if pose.map(|x| x * 0.0).sum::<f64>() != 0.0 {
            Some("pose of geom")
        } else if other.map(|x| x * 0.0).sum::<f32>() != 0.0 {
            Some("surface or size of geom")
        } else {
            None
        };
        if let Some(what) = what {
            return Err(Error::NotFinite { what, index });
        }
        if let Some(texture) = s.texture {
            below("texture", texture.texture, self.scene.textures.len())?;
            if !texture.repeat.iter().all(|x| x.is_finite()) {
                let what = "texture repetitions of geom";
                return Err(Error::NotFinite { what, index });
            }
        }
        match geom.shape {
            Shape::Mesh { mesh, .. } => below("mesh", mesh, self.scene.mesh_count()),
            Shape::HeightField { field, .. } => {
                below("height field", field, self.scene.height_field_count())
            }
            Shape::Soft { soft, .. } => below("soft", soft, softs),
            _ => Ok(()),
        }
    }
}

/// Refuses softs whose tables do not fit together.
fn check_soft(soft: &Soft) -> Result<()> {
    let corners = soft.vertices.len();
    check_len("normals of a soft", corners, soft.normals.len())?;
    if !soft.uv.is_empty() {
        check_len("texture coordinates of a soft", corners, soft.uv.len())?;
    }
    finite("soft vertex", &soft.vertices)?;
    finite("soft normal", &soft.normals)?;
    finite("soft texture coordinate", &soft.uv)?;
    for &corner in soft.faces.iter().flatten() {
        below("soft vertex", corner as usize, corners)?;
    }
    Ok(())
}
