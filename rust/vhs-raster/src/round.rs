//! Round solids: tubes, disks, cylinders, domes and balls of radius 1.
//!
//! Corner order and texture coordinates as in MuJoCo's `render_context.c`; see [`crate::solid`].

use std::f64::consts::PI;

use crate::math::{V3, add, normalize};
use crate::scene::Tessellation;
use crate::solid::{Face, Lines, Node, Nodes, Solid, index, ratio, turn};

impl Solid {
    /// The open cylinder of radius 1 from z = -1 to z = 1.
    fn push_tube(&mut self, t: Tessellation) {
        let base = index(self.positions.len());
        let node_base = index(self.nodes.len());
        for j in 0..=t.slices {
            let (c, s) = turn(j % t.slices, t.slices);
            self.positions.extend([[c, s, -1.0], [c, s, 1.0]]);
            for k in 0..=t.stacks {
                self.nodes.push(Node {
                    position: [c, s, 2.0 * ratio(k, t.stacks) - 1.0],
                    normal: [c, s, 0.0],
                });
            }
        }
        for j in 0..t.slices {
            let at = |j: usize, top: u32| base + 2 * index(j) + top;
            let (u0, u1) = (ratio(j, t.slices), ratio(j + 1, t.slices));
            let nodes = Nodes::Grid {
                s: Lines::even(1),
                t: Lines::even(t.stacks),
                base: node_base + index(j * (t.stacks + 1)),
                step_s: index(t.stacks + 1),
                step_t: 1,
            };
            self.faces.push(Face {
                corners: [at(j, 0), at(j + 1, 0), at(j + 1, 1), at(j, 1)],
                uv: [[u0, 1.0], [u1, 1.0], [u0, 0.0]],
                nodes,
            });
        }
    }

    /// The disk of radius 1 at height `z`, facing up for `z > 0` and down otherwise.
    fn push_disk(&mut self, z: f32, slices: usize, rings: usize) {
        let normal = [0.0, 0.0, z.signum()];
        let base = index(self.positions.len());
        let node_base = index(self.nodes.len());
        self.positions.push([0.0, 0.0, z]);
        self.nodes.push(Node {
            position: [0.0, 0.0, z],
            normal,
        });
        for j in 0..slices {
            let (c, s) = turn(j, slices);
            self.positions.push([c, s, z]);
            for k in 1..=rings {
                let r = ratio(k, rings);
                self.nodes.push(Node {
                    position: [c * r, s * r, z],
                    normal,
                });
            }
        }
        let uv_of = |p: V3| [0.5 + 0.5 * p[0], 0.5 + 0.5 * p[1]];
        for j in 0..slices {
            let (mut a, mut b) = (j, (j + 1) % slices);
            if z < 0.0 {
                std::mem::swap(&mut a, &mut b);
            }
            let corner = |i: usize| base + 1 + index(i);
            let node = |i: usize| node_base + 1 + index(i * rings);
            let (pa, pb) = (
                self.positions[corner(a) as usize],
                self.positions[corner(b) as usize],
            );
            self.faces.push(Face {
                corners: [base, corner(a), corner(b), corner(b)],
                uv: [[0.5, 0.5], uv_of(pa), uv_of(pb)],
                nodes: Nodes::Slice {
                    rings,
                    a: node(a),
                    b: node(b),
                    c: node_base,
                },
            });
        }
    }

    /// A tube of radius 1 from -1 to 1 without ends.
    pub(crate) fn tube(t: Tessellation) -> Self {
        let mut solid = Self::default();
        solid.push_tube(t);
        solid.finished()
    }

    /// A cylinder of radius 1 from -1 to 1 with its ends.
    pub(crate) fn cylinder(t: Tessellation) -> Self {
        let mut solid = Self::default();
        solid.push_disk(-1.0, t.slices, t.stacks / 2);
        solid.push_tube(t);
        solid.push_disk(1.0, t.slices, t.stacks / 2);
        solid.finished()
    }

    /// Half of the sphere of radius 1: the upper one for `sign` 1, the lower one for -1, in `bands` bands whose
    /// texture height runs from `v_equator` to `v_pole`.
    fn push_dome(&mut self, sign: f64, slices: usize, bands: usize, v_equator: f32, v_pole: f32) {
        let base = index(self.positions.len());
        let node_base = index(self.nodes.len());
        for i in 0..bands {
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let elevation = sign * 0.5 * PI * i as f64 / bands as f64;
            #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
            let (r, z) = (libm::cos(elevation) as f32, libm::sin(elevation) as f32);
            let v = v_equator + (v_pole - v_equator) * ratio(i, bands);
            for j in 0..=slices {
                let (c, s) = turn(j % slices, slices);
                let p = [c * r, s * r, z];
                if j < slices {
                    self.positions.push(p);
                }
                self.nodes.push(Node {
                    position: p,
                    normal: p,
                });
                self.uv.push([ratio(j, slices), v]);
            }
        }
        let corner = |i: usize, j: usize| base + index(i * slices + j % slices);
        let node = |i: usize, j: usize| node_base + index(i * (slices + 1) + j);
        let mut push = |mut p: [u32; 3], mut n: [u32; 3]| {
            if sign < 0.0 {
                p.reverse();
                n.reverse();
            }
            self.triangles.push(p);
            self.triangle_nodes.push(n);
        };
        for i in 0..bands - 1 {
            for j in 0..slices {
                let p = [
                    corner(i, j),
                    corner(i, j + 1),
                    corner(i + 1, j + 1),
                    corner(i + 1, j),
                ];
                let n = [
                    node(i, j),
                    node(i, j + 1),
                    node(i + 1, j + 1),
                    node(i + 1, j),
                ];
                // OpenGL cuts a quad from its second to its fourth corner. The lower half lists its corners
                // backwards, from the fourth, so there the cut joins the first and the third.
                if sign > 0.0 {
                    push([p[0], p[1], p[3]], [n[0], n[1], n[3]]);
                    push([p[1], p[2], p[3]], [n[1], n[2], n[3]]);
                } else {
                    push([p[0], p[2], p[3]], [n[0], n[2], n[3]]);
                    push([p[0], p[1], p[2]], [n[0], n[1], n[2]]);
                }
            }
        }
        self.push_pole(sign, slices, (base, node_base), bands - 1, v_pole);
    }

    /// Closes a dome at its pole, above the last ring of corners and nodes.
    fn push_pole(&mut self, sign: f64, slices: usize, base: (u32, u32), ring: usize, v_pole: f32) {
        #[expect(clippy::cast_possible_truncation, reason = "plus or minus one")]
        let p = [0.0, 0.0, sign as f32];
        let top = index(self.positions.len());
        self.positions.push(p);
        for j in 0..slices {
            let tip = index(self.nodes.len());
            self.nodes.push(Node {
                position: p,
                normal: p,
            });
            self.uv
                .push([0.5 * (ratio(j, slices) + ratio(j + 1, slices)), v_pole]);
            let corner = |j: usize| base.0 + index(ring * slices + j % slices);
            let node = |j: usize| base.1 + index(ring * (slices + 1) + j);
            let (mut c, mut n) = ([corner(j), corner(j + 1), top], [node(j), node(j + 1), tip]);
            if sign < 0.0 {
                c.reverse();
                n.reverse();
            }
            self.triangles.push(c);
            self.triangle_nodes.push(n);
        }
    }

    /// The sphere of radius 1.
    pub(crate) fn sphere(t: Tessellation) -> Self {
        let mut solid = Self::default();
        solid.push_dome(-1.0, t.slices, (t.stacks / 2).max(1), 0.5, 1.0);
        solid.push_dome(1.0, t.slices, (t.stacks / 2).max(1), 0.5, 0.0);
        solid.weld();
        solid.finished()
    }

    /// The half sphere that closes a capsule at its upper (`sign` 1) or lower (-1) end.
    pub(crate) fn dome(sign: f64, t: Tessellation) -> Self {
        let mut solid = Self::default();
        let (v_equator, v_pole) = if sign > 0.0 { (1.0, 0.0) } else { (0.0, 1.0) };
        solid.push_dome(sign, t.slices, (t.stacks / 2).max(1), v_equator, v_pole);
        solid.finished()
    }

    /// The cone without a base, of radius 1 at z = 0 and with its tip at z = 1.
    pub(crate) fn cone(t: Tessellation) -> Self {
        let mut solid = Self::default();
        let lean = std::f32::consts::FRAC_1_SQRT_2;
        for ring in 1..=t.stacks {
            let r = ratio(ring, t.stacks);
            for j in 0..=t.slices {
                let (c, s) = turn(j % t.slices, t.slices);
                let position = [c * r, s * r, 1.0 - r];
                solid.positions.push(position);
                solid.nodes.push(Node {
                    position,
                    normal: [c * lean, s * lean, lean],
                });
                solid.uv.push([ratio(j, t.slices), r]);
            }
        }
        let at = |ring: usize, j: usize| index((ring - 1) * (t.slices + 1) + j);
        for j in 0..t.slices {
            let (n1, n2) = (
                solid.nodes[at(1, j) as usize].normal,
                solid.nodes[at(1, j + 1) as usize].normal,
            );
            let tip = index(solid.nodes.len());
            solid.positions.push([0.0, 0.0, 1.0]);
            solid.nodes.push(Node {
                position: [0.0, 0.0, 1.0],
                normal: normalize(add(n1, n2)),
            });
            let middle = 0.5 * (ratio(j, t.slices) + ratio(j + 1, t.slices));
            solid.uv.push([middle, 0.0]);
            solid.triangles.push([at(1, j), at(1, j + 1), tip]);
            for ring in 1..t.stacks {
                let [a, b] = [at(ring + 1, j), at(ring + 1, j + 1)];
                let [c, d] = [at(ring, j + 1), at(ring, j)];
                solid.triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
        solid.triangle_nodes.clone_from(&solid.triangles);
        solid.weld();
        solid.finished()
    }
}
