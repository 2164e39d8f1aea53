//! From parts to faces: places every part in front of the camera and hands its faces to a sink.
//!
//! Owns the lists that one frame fills. Order as in MuJoCo's `mjr_render`: opaque parts, then the sky; transparent
//! parts are set aside for blending.

use crate::cover::{Corner, Cover, Drawn, NOTHING, Outline, Window, facing, outline};
use crate::fill::Fragment;
use crate::math::mul3;
use crate::prepare::{Part, Scene};
use crate::scene::Shape;
use crate::shade::{Placed, Ready, Role};
use crate::solid::Nodes;
use crate::view::{Projection, View, dot64};

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
    fn cover(&self) -> &Cover;
    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize);
}

/// Into depth and face numbers.
pub(crate) struct Into<'a>(pub(crate) &'a mut Cover);

impl Sink for Into<'_> {
    fn cover(&self) -> &Cover {
        self.0
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
    fn cover(&self) -> &Cover {
        self.cover
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
pub(crate) fn is_seen_from_behind(scene: &Scene, view: &View, part: &Part) -> bool {
    let pose = &view.poses[part.geom];
    let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - pose.position[k]);
    let axis = [pose.rotation[2], pose.rotation[5], pose.rotation[8]];
    matches!(scene.spec.geoms[part.geom].shape, Shape::Plane { .. }) && dot64(to_eye, axis) < 0.0
}

/// Where the solid's origin is: shifted along the geom's axis, and for an endless plane below the camera.
pub(crate) fn origin_of(scene: &Scene, view: &View, part: &Part) -> [f64; 3] {
    let pose = &view.poses[part.geom];
    let r = &pose.rotation;
    let mut at = pose.position;
    for k in 0..3 {
        at[k] += f64::from(part.shift) * r[3 * k + 2];
    }
    for (axis, step) in scene.plane_step[part.geom]
        .iter()
        .enumerate()
        .filter(|s| *s.1 > 0.0)
    {
        let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - pose.position[k]);
        let along = dot64(to_eye, [r[axis], r[3 + axis], r[6 + axis]]);
        // Whole repetitions of the texture, so that it seems to stand still.
        let moved = 2.0 * step * libm::round(0.5 * along / step);
        for k in 0..3 {
            at[k] += moved * r[3 * k + axis];
        }
    }
    at
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
    pub(crate) fn draw_opaque(
        &mut self,
        scene: &Scene,
        view: &View,
        projection: &Projection,
        cover: &mut Cover,
    ) {
        for part in &scene.parts {
            let alpha = scene.spec.geoms[part.geom].surface.rgba[3];
            if !view.is_visible[part.geom] || alpha == 0.0 {
                continue;
            }
            if alpha < OPAQUE || is_seen_from_behind(scene, view, part) {
                self.glass
                    .push((glass_distance(scene, view, part.geom), *part));
            } else {
                self.draw_geom_part(scene, view, projection, part, 1.0, false, &mut Into(cover));
            }
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one step of drawing, called from two places"
    )]
    pub(crate) fn draw_geom_part(
        &mut self,
        scene: &Scene,
        view: &View,
        projection: &Projection,
        part: &Part,
        alpha: f32,
        is_inverted: bool,
        sink: &mut impl Sink,
    ) {
        let position = origin_of(scene, view, part);
        let place = (
            Role::Geom(part.geom),
            part,
            position,
            &view.poses[part.geom].rotation,
        );
        self.draw_part(scene, projection, place, alpha, is_inverted, sink);
    }

    /// Draws the sky's cylinder around the camera, seen from inside.
    pub(crate) fn draw_sky(
        &mut self,
        scene: &Scene,
        view: &View,
        projection: &Projection,
        cover: &mut Cover,
    ) {
        if scene.spec.sky.is_none() {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let reach = (SKY_REACH * scene.spec.far) as f32;
        let upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let part = Part {
            geom: 0,
            solid: scene.sky_solid,
            scale: [reach; 3],
            shift: 0.0,
            radius: f32::INFINITY,
        };
        let place = (Role::Sky, &part, view.camera.position, &upright);
        self.draw_part(scene, projection, place, 1.0, true, &mut Into(cover));
    }

    /// Projects a part and hands its faces to `sink`.
    pub(crate) fn draw_part(
        &mut self,
        scene: &Scene,
        projection: &Projection,
        (role, part, position, rotation): (Role, &Part, [f64; 3], &[f64; 9]),
        alpha: f32,
        is_inverted: bool,
        sink: &mut impl Sink,
    ) {
        if !projection.may_see(position, part.radius) {
            return;
        }
        let solid = &scene.solids[part.solid];
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
    }

    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "solids have far fewer than 2^32 faces"
    )]
    fn draw_face<const N: usize>(
        &mut self,
        corners: &[u32; N],
        (part, face): (u32, usize),
        is_inverted: bool,
        near: f32,
        sink: &mut impl Sink,
    ) {
        let corners = corners.map(|c| self.corners[c as usize]);
        let Some(front) = facing(&corners, is_inverted) else {
            return;
        };
        let Some(window) = sink.cover().window(&corners, near) else {
            return;
        };
        let (shape, drawn) = outline(&corners, front, is_inverted);
        sink.face(&shape, window, self.drawn.len());
        self.drawn.push(Drawn {
            part,
            face: face as u32,
            ..drawn
        });
    }
}

/// Distance by which transparent geoms are sorted: to the near side of the ball around them; planes come last.
#[expect(clippy::cast_possible_truncation, reason = "only an order")]
pub(crate) fn glass_distance(scene: &Scene, view: &View, geom: usize) -> f32 {
    if matches!(scene.spec.geoms[geom].shape, Shape::Plane { .. }) {
        return 1e10;
    }
    let radius = scene
        .parts
        .iter()
        .filter(|p| p.geom == geom)
        .map(|p| p.radius + p.shift.abs())
        .fold(0.0, f32::max);
    let way = [0, 1, 2].map(|k| view.poses[geom].position[k] - view.camera.position[k]);
    dot64(way, way).sqrt() as f32 - radius
}
