//! Colours of visible samples: the second pass.
//!
//! Lighting is computed at the nodes of the tessellation and interpolated between them (Gouraud), because that is
//! what MuJoCo's OpenGL renderer shows; a node is lit when the first visible sample asks for it. Textures are
//! looked up for every sample, in perspective.

use crate::cover::{Drawn, LANES};
use crate::light::Lamps;
use crate::math::{V3, add, mul3, normalize, scale, sub, times};
use crate::scene::{Mapping, Scene, Surface};
use crate::solid::{Face, Nodes, Solid};
use crate::texture::{Floats, Ints, Machine, Texture};

/// What a part of the frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// A geom by number.
    Geom(usize),
    /// The sky around everything.
    Sky,
    /// The belt over the horizon.
    Haze,
}

/// A part as it stands in this frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placed {
    pub(crate) role: Role,
    /// Index into the scene's solids.
    pub(crate) solid: usize,
    pub(crate) scale: V3,
    pub(crate) rotation: [f32; 9],
    pub(crate) position: V3,
    /// First of its nodes in the cache of lit colours.
    pub(crate) first_node: u32,
    /// Opacity: the geom's, or a plane's seen from behind.
    pub(crate) alpha: f32,
}

/// Light on a face.
#[derive(Debug, Clone, Copy)]
enum Light {
    /// The same everywhere.
    Even(V3),
    /// Affine between the three corners of a triangle: at its first, and what each side adds.
    Corners([V3; 3]),
    /// By the face's own nodes.
    Nodes,
}

/// Texture on a face; each row times `(x, y, 1)` is a coordinate over W.
#[derive(Debug, Clone, Copy)]
enum Paint {
    None,
    Flat { texture: usize, rows: [V3; 2] },
    Cube { texture: usize, rows: [V3; 3] },
    /// Haze: the coordinate is its opacity.
    Opacity { row: V3 },
}

/// A visible face, prepared when its first sample is shaded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ready {
    whole: V3,
    along: [V3; 2],
    light: Light,
    paint: Paint,
    part: u32,
    face: u32,
    alpha: f32,
}

/// Lit colours of nodes, valid for one frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct NodeCache {
    colours: Vec<V3>,
    frame_of: Vec<u32>,
    frame: u32,
}

impl NodeCache {
    /// Forgets all colours.
    pub(crate) fn start_frame(&mut self) {
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            self.frame_of.fill(0);
            self.frame = 1;
        }
    }

    /// Makes room for `len` nodes.
    pub(crate) fn reserve(&mut self, len: usize) {
        if self.colours.len() < len {
            self.colours.resize(len, [0.0; 3]);
            self.frame_of.resize(len, 0);
        }
    }
}

/// Everything shading reads.
pub(crate) struct Shader<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) lamps: &'a Lamps,
    pub(crate) placed: &'a [Placed],
    pub(crate) nodes: &'a mut NodeCache,
}

/// Samples of one face.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Batch {
    /// Position in the picture, relative to its middle, y upwards. Lanes without use repeat another one.
    pub(crate) x: Floats,
    /// See `x`.
    pub(crate) y: Floats,
}

/// Colours of a batch: red, green, blue and opacity in 0..=1, channel by channel.
pub(crate) type Colours = [Floats; 4];

/// A row times `(x, y, 1)`, for all lanes.
#[inline(always)]
fn along(row: V3, batch: &Batch) -> Floats {
    let mut out = [0.0; LANES];
    for i in 0..LANES {
        out[i] = row[0] * batch.x[i] + row[1] * batch.y[i] + row[2];
    }
    out
}

/// Colours as bytes, rounded: red in the low byte, opacity left out.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "colours are in 0..=1")]
pub(crate) fn packed(c: &Colours) -> Ints {
    let byte = |v: f32| (v * 255.0 + 0.5) as i32 as u32;
    let mut out = [0; LANES];
    for i in 0..LANES {
        out[i] = byte(c[0][i]) | byte(c[1][i]) << 8 | byte(c[2][i]) << 16;
    }
    out
}

impl Shader<'_> {
    /// Prepares a face.
    pub(crate) fn ready(&mut self, drawn: &Drawn) -> Ready {
        let part = self.placed[drawn.part as usize];
        let solid = &self.scene.solids[part.solid];
        let (light, alpha) = match part.role {
            Role::Sky => (Light::Even([1.0; 3]), 1.0),
            Role::Haze => (Light::Even(self.scene.spec.haze.map_or([0.0; 3], |h| h.rgb)), 1.0),
            Role::Geom(g) => (self.light_of(&part, &self.scene.spec.geoms[g].surface, solid, drawn.face), part.alpha),
        };
        let paint = self.paint_of(&part, solid, drawn);
        let Drawn { whole, along, part, face } = *drawn;
        Ready { whole, along, light, paint, part, face, alpha }
    }

    fn light_of(&mut self, part: &Placed, surface: &Surface, solid: &Solid, face: u32) -> Light {
        let face = face as usize;
        if let Some(nodes) = solid.triangle_nodes.get(face) {
            let [a, b, c] = nodes.map(|n| self.lit(part, surface, solid, n));
            return Light::Corners([a, sub(b, a), sub(c, a)]);
        }
        match &solid.faces[face - solid.triangles.len()].nodes {
            Nodes::Grid { base, step_s, .. } if self.lamps.is_even(surface) => {
                // Tubes turn from one side of the face to the other; all other grids are flat.
                let [a, b] = [*base, base + step_s].map(|n| self.lit(part, surface, solid, n));
                if a == b { Light::Even(a) } else { Light::Nodes }
            }
            Nodes::Slice { c, .. } if self.lamps.is_even(surface) => Light::Even(self.lit(part, surface, solid, *c)),
            _ => Light::Nodes,
        }
    }

    fn paint_of(&self, part: &Placed, solid: &Solid, drawn: &Drawn) -> Paint {
        let row = |v: [f32; 3]| {
            let sides = add(scale(drawn.along[0], v[1] - v[0]), scale(drawn.along[1], v[2] - v[0]));
            add(scale(drawn.whole, v[0]), sides)
        };
        let rows_of = |p: [V3; 3], axis: usize, k: f32| row(p.map(|p| k * p[axis]));
        let geom = match part.role {
            Role::Haze => return Paint::Opacity { row: row(uv_of(solid, drawn.face).map(|t| t[0])) },
            Role::Sky => {
                let p = frame_of(solid, drawn.face);
                let texture = self.scene.spec.sky.unwrap_or(0);
                return Paint::Cube { texture, rows: [rows_of(p, 0, 1.0), rows_of(p, 2, 1.0), rows_of(p, 1, -1.0)] };
            }
            Role::Geom(g) => g,
        };
        let Some(used) = self.scene.spec.geoms[geom].surface.texture else {
            return Paint::None;
        };
        let texture = used.texture;
        match self.scene.mapping[geom] {
            Mapping::None => Paint::None,
            Mapping::Surface { scale, offset } => {
                let uv = uv_of(solid, drawn.face);
                let rows = [0, 1].map(|k| row(uv.map(|t| t[k] * scale[k] + offset[k])));
                Paint::Flat { texture, rows }
            }
            Mapping::Projected { scale } => {
                let p = frame_of(solid, drawn.face);
                let s = row(p.map(|p| 0.5 * scale[0] * p[0] - 0.5));
                let t = row(p.map(|p| -0.5 * scale[1] * p[1] - 0.5));
                Paint::Flat { texture, rows: [s, t] }
            }
            Mapping::Cube { scale } => {
                let p = frame_of(solid, drawn.face);
                Paint::Cube { texture, rows: [0, 1, 2].map(|k| rows_of(p, k, scale[k])) }
            }
        }
    }

    /// Colour of a node, lit on first use.
    #[inline(always)]
    fn lit(&mut self, part: &Placed, surface: &Surface, solid: &Solid, node: u32) -> V3 {
        let slot = (part.first_node + node) as usize;
        if self.nodes.frame_of[slot] == self.nodes.frame {
            return self.nodes.colours[slot];
        }
        let n = &solid.nodes[node as usize];
        let position = add(mul3(&part.rotation, times(n.position, part.scale)), part.position);
        let bent = [n.normal[0] / part.scale[0], n.normal[1] / part.scale[1], n.normal[2] / part.scale[2]];
        let normal = normalize(mul3(&part.rotation, bent));
        let colour = self.lamps.colour(position, normal, surface);
        self.nodes.colours[slot] = colour;
        self.nodes.frame_of[slot] = self.nodes.frame;
        colour
    }

    /// Colours of a batch of samples of one face.
    #[inline(always)]
    pub(crate) fn shade<M: Machine>(&mut self, ready: &Ready, batch: &Batch) -> Colours {
        let w = along(ready.whole, batch).map(|q| 1.0 / q);
        let mut out = [[0.0; LANES], [0.0; LANES], [0.0; LANES], [ready.alpha; LANES]];
        match ready.light {
            Light::Even(colour) => (0..3).for_each(|k| out[k] = [colour[k]; LANES]),
            Light::Corners([first, a, b]) => {
                let (s, t) = (along(ready.along[0], batch), along(ready.along[1], batch));
                for k in 0..3 {
                    for i in 0..LANES {
                        out[k][i] = (first[k] + (s[i] * a[k] + t[i] * b[k]) * w[i]).clamp(0.0, 1.0);
                    }
                }
            }
            Light::Nodes => self.light_by_nodes(ready, batch, &w, &mut out),
        }
        match ready.paint {
            Paint::None => {}
            Paint::Flat { texture, rows } => {
                paint_flat::<M>(&self.scene.spec.textures[texture], ready.whole, rows, batch, &w, &mut out);
            }
            Paint::Cube { texture, rows } => {
                paint_cube::<M>(&self.scene.spec.textures[texture], ready.whole, rows, batch, &w, &mut out);
            }
            Paint::Opacity { row } => {
                let opacity = along(row, batch);
                for i in 0..LANES {
                    out[3][i] = (opacity[i] * w[i]).clamp(0.0, 1.0);
                }
            }
        }
        out
    }

    #[inline(never)]
    fn light_by_nodes(&mut self, ready: &Ready, batch: &Batch, w: &Floats, out: &mut Colours) {
        let (s, t) = (along(ready.along[0], batch), along(ready.along[1], batch));
        for i in 0..LANES {
            let colour = self.between_nodes(ready, s[i] * w[i], t[i] * w[i]);
            for k in 0..3 {
                out[k][i] = colour[k];
            }
        }
    }

    /// Light at coordinates `(s, t)` of a face with nodes.
    fn between_nodes(&mut self, ready: &Ready, s: f32, t: f32) -> V3 {
        let part = self.placed[ready.part as usize];
        let Role::Geom(geom) = part.role else {
            return [0.0; 3];
        };
        let surface = &self.scene.spec.geoms[geom].surface;
        let solid = &self.scene.solids[part.solid];
        let face = &solid.faces[ready.face as usize - solid.triangles.len()];
        let (nodes, [a, b]) = triangle_at(face, s, t);
        let [c0, c1, c2] = nodes.map(|n| self.lit(&part, surface, solid, n));
        let mut colour = add(c0, add(scale(sub(c1, c0), a), scale(sub(c2, c0), b)));
        for c in &mut colour {
            *c = c.clamp(0.0, 1.0);
        }
        colour
    }
}

/// The triangle of nodes around `(s, t)`, and the weights of its second and third node.
///
/// OpenGL cuts a quad from its second to its fourth corner.
#[inline(always)]
fn triangle_at(face: &Face, s: f32, t: f32) -> ([u32; 3], [f32; 2]) {
    match &face.nodes {
        Nodes::Grid { s: lines_s, t: lines_t, base, step_s, step_t } => {
            let ((i, a), (j, b)) = (lines_s.find(s), lines_t.find(t));
            #[expect(clippy::cast_possible_truncation, reason = "grids have few lines")]
            let low = base + i as u32 * step_s + j as u32 * step_t;
            let (right, up) = (low + step_s, low + step_t);
            if a + b <= 1.0 { ([low, right, up], [a, b]) } else { ([right + step_t, up, right], [1.0 - a, 1.0 - b]) }
        }
        Nodes::Slice { rings, a, b, c } => slice_triangle(*rings, [*a, *b, *c], s, t),
    }
}

/// The same for a slice of a disk, whose rings are cut from the inner node of `a` to the outer node of `b`.
fn slice_triangle(rings: usize, [a, b, c]: [u32; 3], s: f32, t: f32) -> ([u32; 3], [f32; 2]) {
    #[expect(clippy::cast_precision_loss, reason = "few rings")]
    let (x, y) = (s * rings as f32, t * rings as f32);
    let last = i32::try_from(rings).unwrap_or(i32::MAX) - 1;
    let ring = crate::math::floor_i32(x + y).clamp(0, last);
    if ring == 0 {
        return ([c, a, b], [x, y]);
    }
    #[expect(clippy::cast_precision_loss, clippy::cast_sign_loss, reason = "few rings, not negative")]
    let (k, inner) = (ring as f32, ring as u32 - 1);
    let outer = inner + 1;
    let q = y / (k + 1.0);
    let p = x - k + k * q;
    if p >= 0.0 {
        return ([a + inner, a + outer, b + outer], [p, q]);
    }
    let q = x + y - k;
    ([a + inner, b + inner, b + outer], [(k - x) / k - q, q])
}

/// Position in the solid's unit frame at the first corner of a face and at the ends of its two sides.
fn frame_of(solid: &Solid, face: u32) -> [V3; 3] {
    let face = face as usize;
    let corners = match solid.triangles.get(face) {
        Some(corners) => *corners,
        None => {
            let c = solid.faces[face - solid.triangles.len()].corners;
            [c[0], c[1], c[3]]
        }
    };
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

/// Multiplies colours by a flat texture.
#[inline(always)]
fn paint_flat<M: Machine>(
    texture: &Texture,
    whole: V3,
    rows: [V3; 2],
    batch: &Batch,
    w: &Floats,
    out: &mut Colours,
) {
    let size = [texture.size().0, texture.size().1];
    let (mut u, mut v) = (along(rows[0], batch), along(rows[1], batch));
    // Of u = (a . d) / (b . d), the slope along x is (a_x (b . d) - b_x (a . d)) / (b . d)^2; the terms with x cancel
    // in its numerator, which leaves the last two components of a cross product. The same goes for y.
    let mut steepest = [0.0_f32; LANES];
    for (axis, other, across) in [(0, 1, &batch.y), (1, 0, &batch.x)] {
        let slope = |k: usize| {
            let row = scale(rows[k], size[k]);
            (row[axis] * whole[other] - row[other] * whole[axis], row[axis] * whole[2] - row[2] * whole[axis])
        };
        let ((u1, u0), (v1, v0)) = (slope(0), slope(1));
        for i in 0..LANES {
            let (du, dv) = (u1 * across[i] + u0, v1 * across[i] + v0);
            steepest[i] = steepest[i].max(du * du + dv * dv);
        }
    }
    let mut rho2 = [0.0; LANES];
    for i in 0..LANES {
        let w2 = w[i] * w[i];
        rho2[i] = steepest[i] * (w2 * w2);
        u[i] *= w[i];
        v[i] *= w[i];
    }
    multiply(out, &texture.flat::<M>(&u, &v, &rho2));
}

/// Multiplies colours by a cube texture.
#[inline(always)]
fn paint_cube<M: Machine>(
    texture: &Texture,
    whole: V3,
    rows: [V3; 3],
    batch: &Batch,
    w: &Floats,
    out: &mut Colours,
) {
    let mut direction = rows.map(|row| along(row, batch));
    let (mut dx, mut dy) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    for k in 0..3 {
        for i in 0..LANES {
            direction[k][i] *= w[i];
            dx[k][i] = (rows[k][0] - direction[k][i] * whole[0]) * w[i];
            dy[k][i] = (rows[k][1] - direction[k][i] * whole[1]) * w[i];
        }
    }
    multiply(out, &texture.cube::<M>(&direction, &dx, &dy));
}

/// Multiplies colours in 0..=1 by texels in 0..=255.
#[inline(always)]
fn multiply(out: &mut Colours, texels: &[Floats; 4]) {
    for k in 0..4 {
        for i in 0..LANES {
            out[k][i] *= texels[k][i] * (1.0 / 255.0);
        }
    }
}
