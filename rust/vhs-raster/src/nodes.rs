//! Light on faces: computed at the nodes of the tessellation, interpolated between them.
//!
//! Owns the parts as they stand in a frame, and the cache of their lit nodes. Gouraud shading as in OpenGL's fixed-function pipeline; a node is lit when the first
//! visible sample asks for it, once a frame.

use crate::lanes::{MOST_LANES, Machine};
use crate::light::Lamps;
use crate::math::{V3, add, mul3, normalize, scale, sub, times};
use crate::scene::Surface;
use crate::solid::{Face, Nodes, Solid};
use crate::view::View;

/// What a part of the frame is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// A geom by number.
    Geom(usize),
    /// A geom whose colour no light changes.
    Unlit(usize),
    /// The sky around everything.
    Sky,
    /// The belt over the horizon.
    Haze,
}

/// A part as it stands in this frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placed {
    pub(crate) role: Role,
    /// Number of its solid, see [`View::solid`].
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
pub(crate) enum Light {
    /// The same everywhere.
    Even(V3),
    /// Affine between the three corners of a triangle: at its first, and what each side adds.
    Corners([V3; 3]),
    /// By the face's own nodes.
    Nodes,
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

/// What lights the faces of a frame.
pub(crate) struct Lighter<'a> {
    pub(crate) view: &'a View,
    pub(crate) lamps: &'a Lamps,
    pub(crate) placed: &'a [Placed],
    pub(crate) nodes: &'a mut NodeCache,
}

impl Lighter<'_> {
    pub(crate) fn light_of(
        &mut self,
        part: &Placed,
        surface: &Surface,
        solid: &Solid,
        face: u32,
    ) -> Light {
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
            Nodes::Slice { c, .. } if self.lamps.is_even(surface) => {
                Light::Even(self.lit(part, surface, solid, *c))
            }
            _ => Light::Nodes,
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
        let position = add(
            mul3(&part.rotation, times(n.position, part.scale)),
            part.position,
        );
        let bent = [
            n.normal[0] / part.scale[0],
            n.normal[1] / part.scale[1],
            n.normal[2] / part.scale[2],
        ];
        let normal = normalize(mul3(&part.rotation, bent));
        let colour = self.lamps.colour(position, normal, surface);
        self.nodes.colours[slot] = colour;
        self.nodes.frame_of[slot] = self.nodes.frame;
        colour
    }

    #[inline(never)]
    pub(crate) fn light_by_nodes(
        &mut self,
        (part, face): (u32, u32),
        lanes: usize,
        [s, t]: &[[f32; MOST_LANES]; 2],
        rgb: &mut [[f32; MOST_LANES]; 3],
    ) {
        for i in 0..lanes {
            let colour = self.between_nodes((part, face), s[i], t[i]);
            (0..3).for_each(|k| rgb[k][i] = colour[k]);
        }
    }

    /// Light at coordinates `(s, t)` of a face with nodes.
    fn between_nodes(&mut self, (part, face): (u32, u32), s: f32, t: f32) -> V3 {
        let part = self.placed[part as usize];
        let Role::Geom(geom) = part.role else {
            return [0.0; 3];
        };
        let view = self.view;
        let surface = &view.geoms[geom].geom.surface;
        let solid = view.solid(part.solid);
        let face = &solid.faces[face as usize - solid.triangles.len()];
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
        Nodes::Grid {
            s: lines_s,
            t: lines_t,
            base,
            step_s,
            step_t,
        } => {
            let ((i, a), (j, b)) = (lines_s.find(s), lines_t.find(t));
            #[expect(clippy::cast_possible_truncation, reason = "grids have few lines")]
            let low = base + i as u32 * step_s + j as u32 * step_t;
            let (right, up) = (low + step_s, low + step_t);
            if a + b <= 1.0 {
                ([low, right, up], [a, b])
            } else {
                ([right + step_t, up, right], [1.0 - a, 1.0 - b])
            }
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
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_sign_loss,
        reason = "few rings, not negative"
    )]
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

/// One channel of light on a triangle at coordinates `(s, t)`.
#[inline(always)]
pub(crate) fn between<M: Machine>(
    [first, a, b]: &[V3; 3],
    channel: usize,
    s: M::F,
    t: M::F,
) -> M::F {
    let sides = M::mul_then_add(s, M::float(a[channel]), M::mul(t, M::float(b[channel])));
    M::unit(M::add(M::float(first[channel]), sides))
}
