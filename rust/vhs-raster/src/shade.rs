//! Colours of visible samples: the second pass.
//!
//! Light comes interpolated from [`crate::nodes`], because that is what MuJoCo's OpenGL renderer shows. Textures are
//! looked up for every sample, in perspective.

use std::ops::Range;

use crate::cover::Drawn;
use crate::lanes::{Kind, MOST_LANES, Machine, Plain};
use crate::math::{V3, add, scale};
use crate::nodes::{Light, Lighter, Placed, Role, between};
use crate::paint::{Batch, Places, along, paint_cube, paint_flat, slope_of};
use crate::parts::Mapping;
use crate::scene::Fog;
use crate::solid::Solid;
use crate::texture::Texture;

/// Texture on a face; each row times `(x, y, 1)` is a coordinate over W.
#[derive(Debug, Clone, Copy)]
enum Paint {
    None,
    /// Slopes of both coordinates along x and along y, see [`slope_of`].
    Flat {
        texture: usize,
        rows: [V3; 2],
        slopes: [[f32; 2]; 4],
    },
    Cube {
        texture: usize,
        rows: [V3; 3],
    },
    /// Haze: the coordinate is its opacity.
    Opacity {
        row: V3,
    },
}

/// A visible face, prepared when its first sample is shaded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ready {
    whole: V3,
    along: [V3; 2],
    depth: V3,
    light: Light,
    paint: Paint,
    pub(crate) part: u32,
    pub(crate) face: u32,
    alpha: f32,
}

/// Everything shading reads.
pub(crate) struct Shader<'a> {
    pub(crate) lighter: Lighter<'a>,
}

/// Room for the colours of a run of samples: bytes, red in the low one, and their opacity if it is wanted.
///
/// All lengths are multiples of [`FEWEST_LANES`].
pub(crate) struct Run<'a> {
    pub(crate) places: Places<'a>,
    pub(crate) colours: &'a mut [u32],
    pub(crate) opacity: Option<&'a mut [f32]>,
}

/// Colours samples of one face.
pub(crate) fn shade_run(kind: Kind, shader: &mut Shader<'_>, ready: &Ready, run: &mut Run<'_>) {
    let len = run.colours.len();
    match kind {
        Kind::Plain => shader.run::<Plain>(ready, run, 0..len),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Kind::Avx2` is only made by `detect`, after it found AVX2.
        Kind::Avx2 => unsafe { run_avx2(shader, ready, run, 0..len) },
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512 => {
            // Many runs are shorter than sixteen samples: eight lanes do what is left over.
            let most = len / MOST_LANES * MOST_LANES;
            // SAFETY: `Kind::Avx512` is only made by `detect`, after it found AVX-512, which includes AVX2.
            unsafe {
                run_avx512(shader, ready, run, 0..most);
                run_avx2(shader, ready, run, most..len);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2(shader: &mut Shader<'_>, ready: &Ready, run: &mut Run<'_>, samples: Range<usize>) {
    shader.run::<crate::lanes::Avx2>(ready, run, samples);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq")]
fn run_avx512(shader: &mut Shader<'_>, ready: &Ready, run: &mut Run<'_>, samples: Range<usize>) {
    shader.run::<crate::lanes::Avx512>(ready, run, samples);
}

/// Colours of a batch: red, green, blue and opacity in 0..=1.
type Colours<M> = [<M as Machine>::F; 4];

/// Colours as bytes, rounded: red in the low byte, opacity left out.
#[inline(always)]
fn packed<M: Machine>(c: &Colours<M>) -> M::I {
    let green_blue = M::or(M::left(byte::<M>(c[1]), 8), M::left(byte::<M>(c[2]), 16));
    M::or(byte::<M>(c[0]), green_blue)
}

/// A colour in 0..=1 as 0..=255, rounded.
#[inline(always)]
fn byte<M: Machine>(v: M::F) -> M::I {
    M::truncate(M::mul_then_add(v, M::float(255.0), M::float(0.5)))
}

impl Shader<'_> {
    /// Prepares a face.
    pub(crate) fn ready(&mut self, drawn: &Drawn) -> Ready {
        let view = self.lighter.view;
        let part = self.lighter.placed[drawn.part as usize];
        let solid = view.solid(part.solid);
        let surface = |g: usize| &view.geoms[g].geom.surface;
        let (light, alpha) = match part.role {
            // A further light adds nothing to the sky.
            Role::Sky if self.lighter.lamps.is_addition() => (Light::Even([0.0; 3]), 1.0),
            Role::Sky => (Light::Even([1.0; 3]), 1.0),
            Role::Haze => (Light::Even(view.scene.haze_colour()), 1.0),
            Role::Unlit(g) => {
                let tint = self.lighter.lamps.tint();
                let [r, g, b, _] = surface(g).rgba.map(|c| (tint * c).clamp(0.0, 1.0));
                (Light::Even([r, g, b]), part.alpha)
            }
            Role::Geom(g) => {
                let lighter = &mut self.lighter;
                let light = lighter.light_of(&part, surface(g), solid, drawn.face);
                (light, part.alpha)
            }
        };
        let paint = self.paint_of(&part, solid, drawn);
        let Drawn {
            whole,
            along,
            depth,
            part,
            face,
        } = *drawn;
        Ready {
            whole,
            along,
            depth,
            light,
            paint,
            part,
            face,
            alpha,
        }
    }

    fn paint_of(&self, part: &Placed, solid: &Solid, drawn: &Drawn) -> Paint {
        let row = |v: [f32; 3]| {
            let sides = add(
                scale(drawn.along[0], v[1] - v[0]),
                scale(drawn.along[1], v[2] - v[0]),
            );
            add(scale(drawn.whole, v[0]), sides)
        };
        let rows_of = |p: [V3; 3], axis: usize, k: f32| row(p.map(|p| k * p[axis]));
        let geom = match part.role {
            Role::Haze => {
                return Paint::Opacity {
                    row: row(uv_of(solid, drawn.face).map(|t| t[0])),
                };
            }
            Role::Sky => {
                let p = frame_of(solid, drawn.face);
                let texture = self.lighter.view.scene.sky.unwrap_or(0);
                return Paint::Cube {
                    texture,
                    rows: [rows_of(p, 0, 1.0), rows_of(p, 2, 1.0), rows_of(p, 1, -1.0)],
                };
            }
            Role::Unlit(_) => return Paint::None,
            Role::Geom(g) => &self.lighter.view.geoms[g],
        };
        let Some(used) = geom.geom.surface.texture else {
            return Paint::None;
        };
        let texture = used.texture;
        match geom.mapping {
            Mapping::None => Paint::None,
            Mapping::Surface { scale, offset } => {
                let uv = uv_of(solid, drawn.face);
                let rows = [0, 1].map(|k| row(uv.map(|t| t[k] * scale[k] + offset[k])));
                self.flat(texture, rows, drawn.whole)
            }
            Mapping::Projected { scale } => {
                let p = frame_of(solid, drawn.face);
                let s = row(p.map(|p| 0.5 * scale[0] * p[0] - 0.5));
                let t = row(p.map(|p| -0.5 * scale[1] * p[1] - 0.5));
                self.flat(texture, [s, t], drawn.whole)
            }
            Mapping::Cube { scale } => {
                let p = frame_of(solid, drawn.face);
                Paint::Cube {
                    texture,
                    rows: [0, 1, 2].map(|k| rows_of(p, k, scale[k])),
                }
            }
        }
    }

    fn texture(&self, number: usize) -> &Texture {
        &self.lighter.view.scene.textures[number]
    }

    fn flat(&self, texture: usize, rows: [V3; 2], whole: V3) -> Paint {
        let size = self.texture(texture).size();
        let (u, v) = (scale(rows[0], size.0), scale(rows[1], size.1));
        let slopes = [
            slope_of(u, whole, 0),
            slope_of(v, whole, 0),
            slope_of(u, whole, 1),
            slope_of(v, whole, 1),
        ];
        Paint::Flat {
            texture,
            rows,
            slopes,
        }
    }

    /// Colours some of a run's samples, a whole number of batches.
    #[inline(always)]
    fn run<M: Machine>(&mut self, ready: &Ready, run: &mut Run<'_>, samples: Range<usize>) {
        let fog = self.lighter.view.fog();
        for first in samples.step_by(M::LANES) {
            let batch = run.places.batch(first);
            let mut colours = self.shade::<M>(ready, &batch);
            if let Some(fog) = fog {
                self.fog::<M>(ready, &batch, fog, &mut colours);
            }
            M::store_ints(packed::<M>(&colours), &mut run.colours[first..]);
            if let Some(opacity) = run.opacity.as_mut() {
                M::store(colours[3], &mut opacity[first..]);
            }
        }
    }

    /// Lays fog over colours; over what is added to others, black.
    #[inline(always)]
    fn fog<M: Machine>(
        &self,
        ready: &Ready,
        batch: &Batch<M>,
        (fog, is_parallel): (Fog, bool),
        colours: &mut Colours<M>,
    ) {
        let depth = along(ready.depth, batch);
        let distance = if is_parallel {
            M::sub(M::float(0.0), depth)
        } else {
            M::div(M::float(1.0), depth)
        };
        let reach = M::float(1.0 / (fog.end - fog.start).max(1e-6));
        let clear = M::unit(M::mul(M::sub(M::float(fog.end), distance), reach));
        for (colour, fog) in colours.iter_mut().zip(fog.rgb) {
            let is_addition = self.lighter.lamps.is_addition();
            let fog = M::float(if is_addition {
                0.0
            } else {
                fog.clamp(0.0, 1.0)
            });
            *colour = M::mul_then_add(clear, M::sub(*colour, fog), fog);
        }
    }

    /// Colours of a batch of samples of one face.
    #[inline(always)]
    fn shade<M: Machine>(&mut self, ready: &Ready, batch: &Batch<M>) -> Colours<M> {
        let w = M::div(M::float(1.0), along(ready.whole, batch));
        let (mut red, mut green, mut blue) = match ready.light {
            Light::Even([r, g, b]) => (M::float(r), M::float(g), M::float(b)),
            Light::Corners(corners) => {
                let s = M::mul(along(ready.along[0], batch), w);
                let t = M::mul(along(ready.along[1], batch), w);
                (
                    between::<M>(&corners, 0, s, t),
                    between::<M>(&corners, 1, s, t),
                    between::<M>(&corners, 2, s, t),
                )
            }
            Light::Nodes => {
                let s = M::mul(along(ready.along[0], batch), w);
                let t = M::mul(along(ready.along[1], batch), w);
                let (mut places, mut rgb) = ([[0.0; MOST_LANES]; 2], [[0.0; MOST_LANES]; 3]);
                M::store(s, &mut places[0]);
                M::store(t, &mut places[1]);
                self.lighter
                    .light_by_nodes((ready.part, ready.face), M::LANES, &places, &mut rgb);
                (M::load(&rgb[0]), M::load(&rgb[1]), M::load(&rgb[2]))
            }
        };
        let mut opacity = M::float(ready.alpha);
        let texels = match ready.paint {
            Paint::None => return [red, green, blue, opacity],
            Paint::Opacity { row } => {
                return [red, green, blue, M::unit(M::mul(along(row, batch), w))];
            }
            Paint::Flat {
                texture,
                rows,
                slopes,
            } => paint_flat::<M>(self.texture(texture), rows, slopes, batch, w),
            Paint::Cube { texture, rows } => {
                paint_cube::<M>(self.texture(texture), ready.whole, rows, batch, w)
            }
        };
        let byte = M::float(1.0 / 255.0);
        red = M::mul(red, M::mul(texels[0], byte));
        green = M::mul(green, M::mul(texels[1], byte));
        blue = M::mul(blue, M::mul(texels[2], byte));
        opacity = M::mul(opacity, M::mul(texels[3], byte));
        [red, green, blue, opacity]
    }
}

/// Position in the solid's unit frame at the first corner of a face and at the ends of its two sides.
fn frame_of(solid: &Solid, face: u32) -> [V3; 3] {
    let face = face as usize;
    let corners = solid.triangles.get(face).copied().unwrap_or_else(|| {
        let c = solid.faces[face - solid.triangles.len()].corners;
        [c[0], c[1], c[3]]
    });
    corners.map(|c| solid.positions[c as usize])
}

/// Texture coordinates at the same three places.
fn uv_of(solid: &Solid, face: u32) -> [[f32; 2]; 3] {
    let face = face as usize;
    match solid.triangle_nodes.get(face) {
        Some(nodes) => nodes.map(|n| solid.uv[n as usize]),
        None => solid.faces[face - solid.triangles.len()].uv,
    }
}
