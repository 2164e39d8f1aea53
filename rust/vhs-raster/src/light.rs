//! Light on one vertex: OpenGL's fixed-function model (specification 4.6 compatibility profile, section 12.2.1)
//! with a local viewer, one-sided, highlights added before the texture, as MuJoCo sets it up.

use crate::camera::Projection;
use crate::math::{V3, add, dot, normalize, pow_unit, scale, sub, times};
use crate::scene::{Light, LightKind, Surface};
use crate::view::View;

/// OpenGL's fixed pipeline knows this many lights.
pub(crate) const MOST_LIGHTS: usize = 8;

/// Ambient light of a scene without any light.
const DARK_AMBIENT: f32 = 0.3;

/// A light that shines in this view.
#[derive(Debug, Clone, Copy)]
struct Lamp {
    light: Light,
    /// Direction of its rays, of length 1.
    direction: V3,
    /// Cosine of the half angle of its cone; below -1 when it shines all around.
    cos_cutoff: f32,
}

/// All lights of a view.
#[derive(Debug, Clone, Default)]
pub(crate) struct Lamps {
    lit: Vec<Lamp>,
    eye: V3,
    /// Light that is there without lamps.
    ambient: f32,
    /// Whether no lamp's effect depends on where a surface is, highlights apart.
    is_parallel: bool,
    /// Whether any lamp makes highlights.
    has_highlights: bool,
    /// Whether this light is added to a picture that has the surfaces' own.
    is_addition: bool,
    /// Share of their colour that surfaces show.
    tint: f32,
}

/// Which lights of a view shine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Choice {
    All,
    /// Those without shadows.
    Shadowless,
    /// One by number, added to what others have lit.
    One(usize),
}

impl Lamps {
    /// Collects the lights of `view`, reusing memory.
    pub(crate) fn update(&mut self, view: &View, projection: &Projection, choice: Choice) {
        self.eye = projection.eye();
        self.tint = 1.0;
        self.lit.clear();
        for (number, light) in view.lights.iter().take(MOST_LIGHTS).enumerate() {
            let is_chosen = match choice {
                Choice::All => true,
                Choice::Shadowless => !view.has_shadow(light),
                Choice::One(chosen) => number == chosen,
            };
            if !is_chosen {
                continue;
            }
            let mut light = *light;
            if light.is_headlight {
                (light.position, light.direction) = (view.eye(), normalize(projection.forward));
            }
            self.lit.push(Lamp::new(light));
        }
        self.is_addition = matches!(choice, Choice::One(_));
        self.ambient = if view.lights.is_empty() {
            DARK_AMBIENT
        } else {
            0.0
        };
        self.is_parallel = self
            .lit
            .iter()
            .all(|l| l.light.kind == LightKind::Directional);
        self.has_highlights = self.lit.iter().any(|l| l.light.specular != [0.0; 3]);
    }

    /// Whether every point of a flat face with this surface gets the same light.
    pub(crate) fn is_even(&self, surface: &Surface) -> bool {
        self.is_parallel && (!self.has_highlights || surface.specular == 0.0)
    }

    /// Has surfaces show only a share of their colour.
    pub(crate) fn set_tint(&mut self, tint: f32) {
        self.tint = tint;
    }

    /// Share of their colour that surfaces show.
    pub(crate) fn tint(&self) -> f32 {
        self.tint
    }

    /// Whether this light is added to a picture that has the surfaces' own.
    pub(crate) fn is_addition(&self) -> bool {
        self.is_addition
    }

    /// Colour of a vertex, each channel in 0..=1.
    pub(crate) fn colour(&self, position: V3, normal: V3, surface: &Surface) -> V3 {
        let base = [surface.rgba[0], surface.rgba[1], surface.rgba[2]];
        let base = scale(base, self.tint);
        let to_eye = normalize(sub(self.eye, position));
        let mut sum = if self.is_addition {
            [0.0; 3]
        } else {
            scale(base, surface.emission + self.ambient)
        };
        for lamp in &self.lit {
            sum = add(sum, lamp.on(position, normal, to_eye, base, surface));
        }
        sum.map(|c| c.clamp(0.0, 1.0))
    }
}

impl Lamp {
    fn new(light: Light) -> Self {
        let cos_cutoff = match light.kind {
            // OpenGL takes no other angle: such a light shines to all sides, and evenly.
            LightKind::Spot { cutoff, .. } if (0.0..=90.0).contains(&cutoff) => {
                cosine_of_degrees(cutoff)
            }
            _ => -2.0,
        };
        Self {
            direction: normalize(light.direction),
            light,
            cos_cutoff,
        }
    }

    fn on(&self, position: V3, normal: V3, to_eye: V3, base: V3, surface: &Surface) -> V3 {
        let (to_light, strength) = self.strength(position);
        if strength == 0.0 {
            return [0.0; 3];
        }
        let mut sum = times(self.light.ambient, base);
        let facing = dot(normal, to_light);
        if facing > 0.0 {
            sum = add(sum, scale(times(self.light.diffuse, base), facing));
            if surface.specular > 0.0 && self.light.specular != [0.0; 3] {
                let halfway = normalize(add(to_light, to_eye));
                let gloss = pow_unit(
                    dot(normal, halfway).clamp(0.0, 1.0),
                    128.0 * surface.shininess,
                );
                sum = add(sum, scale(self.light.specular, gloss * surface.specular));
            }
        }
        scale(sum, strength)
    }

    /// Direction towards the light, and what share of it arrives.
    fn strength(&self, position: V3) -> (V3, f32) {
        let LightKind::Spot {
            attenuation,
            exponent,
            ..
        } = self.light.kind
        else {
            return (scale(self.direction, -1.0), 1.0);
        };
        let way = sub(self.light.position, position);
        let distance = dot(way, way).sqrt();
        let to_light = normalize(way);
        let along = -dot(to_light, self.direction);
        if along < self.cos_cutoff {
            return (to_light, 0.0);
        }
        let fall = attenuation[0] + distance * (attenuation[1] + distance * attenuation[2]);
        let cone = if self.cos_cutoff < -1.0 {
            1.0
        } else {
            pow_unit(along.clamp(0.0, 1.0), exponent)
        };
        // Finite also where the light does not fall off to begin with and touches the surface: no light times it is
        // then no light, as it is not for infinity.
        (to_light, (cone / fall).min(f32::MAX))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "lighting is f32")]
fn cosine_of_degrees(angle: f32) -> f32 {
    libm::cos(f64::from(angle).to_radians()) as f32
}
