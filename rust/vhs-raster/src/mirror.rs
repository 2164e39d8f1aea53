//! The mirror of a scene: the first plane or box that reflects, as MuJoCo has it.
//!
//! What it shows is the scene through a mirrored projection, nearer to the camera than the mirror cut off. Depth is
//! linear across the picture, so that the cut is one more linear limit.

use crate::camera::{Projection, dot64};
use crate::frame::mirror_of;
use crate::math::V3;
use crate::scene::Shape;
use crate::view::View;

/// What mirrors in a view.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mirror {
    /// Number of the geom.
    pub(crate) geom: usize,
    /// Face of its solid that mirrors; only a box has others.
    pub(crate) face: u32,
    /// Share of light that it mirrors.
    pub(crate) reflectance: f32,
    point: [f64; 3],
    normal: [f64; 3],
}

impl Mirror {
    /// The mirror of a view, if one is seen from its front.
    pub(crate) fn of(view: &View) -> Option<Self> {
        if !view.effects.has_reflections {
            return None;
        }
        let number = mirror_of(view)?;
        let geom = &view.geoms[number].geom;
        let r = &geom.rotation;
        let normal = [r[2], r[5], r[8]];
        let height = match geom.shape {
            Shape::Box { half_size } => f64::from(half_size[2]),
            _ => 0.0,
        };
        let point = [0, 1, 2].map(|k| geom.position[k] + height * normal[k]);
        let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - point[k]);
        (dot64(to_eye, normal) > 0.0).then_some(Self {
            geom: number,
            // The first face of a cuboid is its upper side.
            face: 0,
            reflectance: geom.surface.reflectance,
            point,
            normal,
        })
    }

    /// The camera's map with the world mirrored, and the depth of the mirror across the picture.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the picture is drawn in f32"
    )]
    pub(crate) fn projection(&self, projection: &Projection) -> (Projection, V3) {
        let n = self.normal;
        let turn = |v: [f64; 3]| {
            let along = 2.0 * dot64(v, n);
            [0, 1, 2].map(|k| v[k] - along * n[k])
        };
        let way = [0, 1, 2].map(|k| projection.origin[k] - self.point[k]);
        let turned = turn(way);
        let origin = [0, 1, 2].map(|k| self.point[k] + turned[k]);
        let height = -dot64(way, n);
        let rays = projection.rays();
        let slopes = [0, 1, 2].map(|k| (0..3).map(|i| n[i] * rays[i][k]).sum::<f64>());
        let depth = if projection.depth_row.is_some() {
            [
                -slopes[0] / slopes[2],
                -slopes[1] / slopes[2],
                height / slopes[2],
            ]
        } else {
            slopes.map(|slope| slope / height)
        };
        (projection.turned(turn, origin), depth.map(|d| d as f32))
    }
}
