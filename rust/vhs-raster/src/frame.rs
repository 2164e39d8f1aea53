//! From parts to faces: places every part in front of the camera and hands its faces to a sink.
//!
//! Owns the lists that one frame fills. Order as in MuJoCo's `mjr_render`: opaque parts, then the sky; transparent
//! parts are set aside for blending.

use crate::assets::CYLINDER;
use crate::camera::{Projection, dot64};
use crate::cover::{Corner, Cover, Drawn, NOTHING, Outline, Window, facing, outline};
use crate::fill::Fragment;
use crate::math::{add, mul3, scale, sub};
use crate::nodes::{Placed, Role};
use crate::parts::Part;
use crate::scene::Shape;
use crate::shade::Ready;
use crate::solid::Nodes;
use crate::view::View;

/// From this opacity on a geom counts as opaque.
const OPAQUE: f32 = 0.995;

/// The sky's cylinder, relative to the far plane: its corners must stay inside.
pub(crate) const SKY_REACH: f64 = 0.7;

/// Lists that one frame fills.
#[derive(Debug, Default)]
pub(crate) struct Frame {
    pub(crate) placed: Vec<Placed>,
    pub(crate) drawn: Vec<Drawn>,
    corners: Vec<Corner>,
    /// For each drawn face its place in `ready`, or [`NOTHING`].
    pub(crate) ready_at: Vec<u32>,
    pub(crate) ready: Vec<Ready>,
    /// Nodes handed out so far.
    pub(crate) nodes: usize,
    /// Transparent parts with their distance.
    pub(crate) glass: Vec<(f32, Part)>,
    /// Faces in pixels that show several of them.
    pub(crate) edges: Vec<Fragment>,
    /// Fragments of a transparent part.
    pub(crate) fragments: Vec<Fragment>,
}

/// Where faces go once they are projected.
pub(crate) trait Sink {
    /// What of the sink a face with these corners can touch; `None` when there is nothing.
    fn window<const N: usize>(&self, corners: &[Corner; N], near: f32) -> Option<Window>;
    /// Whether pixels have several samples.
    fn is_smooth(&self) -> bool;
    /// Whether faces are taken from either side.
    fn sees_both_sides(&self) -> bool {
        false
    }
    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize);
}

/// Into depth and face numbers.
pub(crate) struct Into<'a>(pub(crate) &'a mut Cover);

impl Sink for Into<'_> {
    #[inline(always)]
    fn window<const N: usize>(&self, corners: &[Corner; N], near: f32) -> Option<Window> {
        self.0.window(corners, near)
    }

    fn is_smooth(&self) -> bool {
        self.0.offsets.len() > 1
    }

    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize) {
        self.0
            .draw(outline, window, u32::try_from(number).unwrap_or(NOTHING));
    }
}

/// Into a list of fragments, in drawing order.
pub(crate) struct Listed<'a> {
    pub(crate) cover: &'a Cover,
    pub(crate) fragments: &'a mut Vec<Fragment>,
}

impl Sink for Listed<'_> {
    #[inline(always)]
    fn window<const N: usize>(&self, corners: &[Corner; N], near: f32) -> Option<Window> {
        self.cover.window(corners, near)
    }

    fn is_smooth(&self) -> bool {
        self.cover.offsets.len() > 1
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "pictures have at most 16384 rows and columns"
    )]
    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize) {
        let face = u32::try_from(number).unwrap_or(NOTHING);
        let fragments = &mut *self.fragments;
        self.cover.visit(outline, window, |x, y, mask| {
            fragments.push(Fragment {
                face,
                x: x as u16,
                y: y as u16,
                weight: mask.count_ones() as u8,
            });
        });
    }
}

/// Whether the camera is on the far side of a plane.
pub(crate) fn is_seen_from_behind(view: &View, part: &Part) -> bool {
    let geom = &view.geoms[part.geom].geom;
    let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - geom.position[k]);
    let axis = [geom.rotation[2], geom.rotation[5], geom.rotation[8]];
    matches!(geom.shape, Shape::Plane { .. }) && dot64(to_eye, axis) < 0.0
}

const UPRIGHT: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Where the solid is and how it is turned: shifted along the geom's axis, and for an endless plane below the camera.
pub(crate) fn pose_of<'a>(view: &'a View, part: &Part) -> ([f64; 3], &'a [f64; 9]) {
    let shown = &view.geoms[part.geom];
    let geom = &shown.geom;
    if matches!(geom.shape, Shape::Soft { .. }) {
        return ([0.0; 3], &UPRIGHT);
    }
    let r = &geom.rotation;
    let mut at = geom.position;
    for k in 0..3 {
        at[k] += f64::from(part.shift) * r[3 * k + 2];
    }
    for (axis, step) in shown.step.iter().enumerate().filter(|s| *s.1 > 0.0) {
        let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - geom.position[k]);
        let along = dot64(to_eye, [r[axis], r[3 + axis], r[6 + axis]]);
        // Whole repetitions of the texture, so that it seems to stand still.
        let moved = 2.0 * step * libm::round(0.5 * along / step);
        for k in 0..3 {
            at[k] += moved * r[3 * k + axis];
        }
    }
    (at, r)
}

/// Whether a part is blended over what is behind it.
fn is_glass(view: &View, part: &Part) -> bool {
    view.geoms[part.geom].geom.surface.rgba[3] < OPAQUE || is_seen_from_behind(view, part)
}

/// The geom that mirrors: the first opaque plane or box that can.
pub(crate) fn mirror_of(view: &View) -> Option<usize> {
    let mirrors = |part: &&Part| {
        let geom = &view.geoms[part.geom].geom;
        let is_flat = matches!(geom.shape, Shape::Plane { .. } | Shape::Box { .. });
        is_flat && geom.surface.reflectance > 0.0 && !is_glass(view, part)
    };
    view.parts.iter().find(mirrors).map(|part| part.geom)
}

impl Frame {
    pub(crate) fn clear(&mut self) {
        self.placed.clear();
        self.drawn.clear();
        self.ready_at.clear();
        self.ready.clear();
        self.glass.clear();
        self.nodes = 0;
    }

    /// Draws all opaque parts and sets the transparent ones aside.
    pub(crate) fn draw_opaque(&mut self, view: &View, projection: &Projection, cover: &mut Cover) {
        let mirror = mirror_of(view);
        for part in &view.parts {
            if is_glass(view, part) {
                self.glass.push((glass_distance(view, part.geom), *part));
            }
        }
        // OpenGL draws the mirror first; where two surfaces lie in one plane the later one is seen.
        for is_mirror in [true, false] {
            let these = |part: &&Part| (Some(part.geom) == mirror) == is_mirror;
            for part in view.parts.iter().filter(these) {
                if !is_glass(view, part) {
                    self.draw_geom_part(view, projection, part, 1.0, false, &mut Into(cover));
                }
            }
        }
    }

    /// Draws all opaque parts but those of a mirror as the mirror shows them, and sets the transparent ones aside.
    pub(crate) fn draw_mirrored(
        &mut self,
        view: &View,
        projection: &Projection,
        mirror: usize,
        cover: &mut Cover,
    ) {
        for part in view.parts.iter().filter(|part| part.geom != mirror) {
            if is_glass(view, part) {
                self.glass.push((glass_distance(view, part.geom), *part));
            } else {
                self.draw_geom_part(view, projection, part, 1.0, true, &mut Into(cover));
            }
        }
    }

    /// Draws all parts with a tag as if they were opaque.
    pub(crate) fn draw_tagged(&mut self, view: &View, projection: &Projection, cover: &mut Cover) {
        for part in &view.parts {
            if view.geoms[part.geom].geom.tag.is_some() {
                let is_inverted = is_seen_from_behind(view, part);
                self.draw_geom_part(view, projection, part, 1.0, is_inverted, &mut Into(cover));
            }
        }
    }

    /// Hands all faces that keep light from others to `sink`; the frame stays as it is.
    pub(crate) fn cast(&mut self, view: &View, projection: &Projection, sink: &mut impl Sink) {
        let (placed, drawn, nodes) = (self.placed.len(), self.drawn.len(), self.nodes);
        for part in &view.parts {
            if view.geoms[part.geom].geom.casts_shadow {
                self.draw_geom_part(view, projection, part, 1.0, false, sink);
            }
        }
        self.placed.truncate(placed);
        self.drawn.truncate(drawn);
        self.nodes = nodes;
    }

    /// Draws one part of a geom.
    pub(crate) fn draw_geom_part(
        &mut self,
        view: &View,
        projection: &Projection,
        part: &Part,
        alpha: f32,
        is_inverted: bool,
        sink: &mut impl Sink,
    ) {
        let (position, rotation) = pose_of(view, part);
        let role = match view.geoms[part.geom].geom.shape {
            Shape::Line { .. } | Shape::LineBox { .. } => Role::Unlit(part.geom),
            _ => Role::Geom(part.geom),
        };
        let place = (role, part, position, rotation);
        self.draw_part(view, projection, place, alpha, is_inverted, sink);
        if matches!(view.geoms[part.geom].geom.shape, Shape::Triangle { .. }) {
            self.draw_part(view, projection, place, alpha, !is_inverted, sink);
        }
    }

    /// Draws the sky's cylinder around the camera, seen from inside.
    pub(crate) fn draw_sky(&mut self, view: &View, projection: &Projection, cover: &mut Cover) {
        if view.scene.sky.is_none() || !view.effects.has_sky {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let reach = (SKY_REACH * view.scene.far) as f32;
        let part = Part {
            geom: 0,
            solid: CYLINDER,
            scale: [reach; 3],
            shift: 0.0,
            radius: f32::INFINITY,
        };
        let place = (Role::Sky, &part, view.camera.position, &UPRIGHT);
        self.draw_part(view, projection, place, 1.0, true, &mut Into(cover));
    }

    /// Projects a part and hands its faces to `sink`.
    pub(crate) fn draw_part(
        &mut self,
        view: &View,
        projection: &Projection,
        (role, part, position, rotation): (Role, &Part, [f64; 3], &[f64; 9]),
        alpha: f32,
        is_inverted: bool,
        sink: &mut impl Sink,
    ) {
        if !projection.may_see(position, part.radius) {
            return;
        }
        let solid = view.solid(part.solid);
        let number = u32::try_from(self.placed.len()).unwrap_or(NOTHING);
        #[expect(clippy::cast_possible_truncation, reason = "shading is f32")]
        self.placed.push(Placed {
            role,
            solid: part.solid,
            scale: part.scale,
            rotation: rotation.map(|x| x as f32),
            position: position.map(|x| x as f32),
            first_node: self.nodes as u32,
            alpha,
        });
        self.nodes += solid.nodes.len();
        self.corners.clear();
        let (matrix, constant, depth_row) = projection.of_part(position, rotation, part.scale);
        self.corners.extend(solid.positions.iter().map(|&p| {
            let v = mul3(&matrix, p);
            let v = [v[0] + constant[0], v[1] + constant[1], v[2] + constant[2]];
            let z = depth_row[0] * p[0] + depth_row[1] * p[1] + depth_row[2] * p[2] + depth_row[3];
            let w = 1.0 / v[2];
            Corner {
                p: v,
                z,
                at: [v[0] * w, v[1] * w],
                is_ahead: v[2] >= projection.near,
            }
        }));
        for (face, corners) in solid.triangles.iter().enumerate() {
            self.draw_face(corners, (number, face), is_inverted, projection.near, sink);
        }
        for (face, large) in solid.faces.iter().enumerate() {
            let face = (number, face + solid.triangles.len());
            let [a, b, c, d] = large.corners;
            match large.nodes {
                Nodes::Grid { .. } => {
                    self.draw_face(&[a, b, c, d], face, is_inverted, projection.near, sink);
                }
                Nodes::Slice { .. } => {
                    self.draw_face(&[a, b, c], face, is_inverted, projection.near, sink);
                }
            }
        }
        let half_width = line_width(view, role) / 2.0;
        for (segment, ends) in solid.segments.iter().enumerate() {
            let face = solid.triangles.len() + solid.faces.len() + segment;
            let ends = ends.map(|c| self.corners[c as usize]);
            self.draw_segment(ends, half_width, (number, face), projection.near, sink);
        }
    }

    /// Draws a line as the rectangle that it is in the picture.
    fn draw_segment(
        &mut self,
        ends: [Corner; 2],
        half_width: f32,
        face: (u32, usize),
        near: f32,
        sink: &mut impl Sink,
    ) {
        let Some([a, b]) = ahead(ends, near) else {
            return;
        };
        let way = [b.at[0] - a.at[0], b.at[1] - a.at[1]];
        let length = way[0].hypot(way[1]);
        if length.is_nan() || length <= 0.0 {
            return;
        }
        // With one sample a pixel OpenGL widens lines along the axis that they cross, by whole pixels.
        let across = if sink.is_smooth() {
            [-way[1], way[0]].map(|x| x * half_width / length)
        } else {
            let half = 0.5 * (2.0 * half_width).round().max(1.0);
            if way[0].abs() >= way[1].abs() {
                [0.0, half]
            } else {
                [half, 0.0]
            }
        };
        let beside = |c: &Corner, k: f32| {
            let [x, y] = across.map(|x| k * x);
            let at = [c.at[0] + x, c.at[1] + y];
            let p = [c.p[0] + x * c.p[2], c.p[1] + y * c.p[2], c.p[2]];
            Corner { p, at, ..*c }
        };
        let corners = [
            beside(&a, -1.0),
            beside(&b, -1.0),
            beside(&b, 1.0),
            beside(&a, 1.0),
        ];
        for is_inverted in [false, true] {
            self.draw_corners(&corners, face, is_inverted, near, sink);
        }
    }

    #[inline(always)]
    fn draw_face<const N: usize>(
        &mut self,
        corners: &[u32; N],
        face: (u32, usize),
        is_inverted: bool,
        near: f32,
        sink: &mut impl Sink,
    ) {
        let corners = corners.map(|c| self.corners[c as usize]);
        self.draw_corners(&corners, face, is_inverted, near, sink);
    }

    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "solids have far fewer than 2^32 faces"
    )]
    fn draw_corners<const N: usize>(
        &mut self,
        corners: &[Corner; N],
        (part, face): (u32, usize),
        is_inverted: bool,
        near: f32,
        sink: &mut impl Sink,
    ) {
        let (front, is_inverted) = match facing(corners, is_inverted) {
            Some(front) => (front, is_inverted),
            None if sink.sees_both_sides() => match facing(corners, !is_inverted) {
                Some(back) => (back, !is_inverted),
                None => return,
            },
            None => return,
        };
        let Some(window) = sink.window(corners, near) else {
            return;
        };
        let (shape, drawn) = outline(corners, front, is_inverted);
        sink.face(&shape, window, self.drawn.len());
        self.drawn.push(Drawn {
            part,
            face: face as u32,
            ..drawn
        });
    }
}

/// Width of a geom's lines in pixels; 0 for all that has none.
fn line_width(view: &View, role: Role) -> f32 {
    let Role::Unlit(geom) = role else {
        return 0.0;
    };
    match view.geoms[geom].geom.shape {
        Shape::Line { width, .. } | Shape::LineBox { width, .. } => width,
        _ => 0.0,
    }
}

/// The part of a line that lies beyond the near plane.
fn ahead([a, b]: [Corner; 2], near: f32) -> Option<[Corner; 2]> {
    let cut = |from: &Corner, to: &Corner| {
        let t = (near - from.p[2]) / (to.p[2] - from.p[2]);
        let mut p = add(from.p, scale(sub(to.p, from.p), t));
        p[2] = near;
        Corner {
            p,
            z: from.z + t * (to.z - from.z),
            at: [p[0] / near, p[1] / near],
            is_ahead: true,
        }
    };
    match (a.is_ahead, b.is_ahead) {
        (true, true) => Some([a, b]),
        (true, false) => Some([a, cut(&a, &b)]),
        (false, true) => Some([cut(&b, &a), b]),
        (false, false) => None,
    }
}

/// Distance by which transparent geoms are sorted: to the near side of the ball around them; planes come last.
#[expect(clippy::cast_possible_truncation, reason = "only an order")]
fn glass_distance(view: &View, geom: usize) -> f32 {
    let shown = &view.geoms[geom].geom;
    if matches!(shown.shape, Shape::Plane { .. }) {
        return 1e10;
    }
    let parts = view.parts.iter().filter(|p| p.geom == geom);
    let radius = parts.map(|p| p.radius + p.shift.abs()).fold(0.0, f32::max);
    let way = [0, 1, 2].map(|k| shown.position[k] - view.camera.position[k]);
    dot64(way, way).sqrt() as f32 - radius
}
