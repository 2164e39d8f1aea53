//! Solids from the caller's numbers: meshes, height fields, and surfaces that bend.

use std::collections::HashMap;

use crate::math::{V3, cross, dot, normalize, sub};
use crate::scene::{HeightField, MeshData, Soft};
use crate::solid::{Node, Solid, index, ratio};

impl Solid {
    /// Triangles with a normal and, if any, a texture coordinate at each of their corners.
    ///
    /// As in MuJoCo's renderer, a mesh without texture coordinates shows its face normal wherever the vertex
    /// normal leans away from it (cosine below 0.8): hard edges stay hard.
    pub(crate) fn mesh(mesh: &MeshData) -> Self {
        let mut solid = Self {
            positions: mesh.vertices.clone(),
            ..Self::default()
        };
        let mut known = HashMap::new();
        for (f, corners) in mesh.faces.iter().enumerate() {
            let p = corners.map(|c| mesh.vertices[c as usize]);
            let flat = normalize(cross(sub(p[1], p[0]), sub(p[2], p[0])));
            let mut nodes = [0; 3];
            for k in 0..3 {
                let mut normal = mesh.normals[mesh.face_normals[f][k] as usize];
                let uv = mesh.face_uv.get(f).map(|t| mesh.uv[t[k] as usize]);
                if uv.is_none() && dot(normal, flat) < 0.8 {
                    normal = flat;
                }
                let key = (
                    corners[k],
                    normal.map(f32::to_bits),
                    uv.map(|c| c.map(f32::to_bits)),
                );
                nodes[k] = *known.entry(key).or_insert_with(|| {
                    solid.nodes.push(Node {
                        position: p[k],
                        normal,
                    });
                    solid.uv.extend(uv);
                    index(solid.nodes.len() - 1)
                });
            }
            solid.triangles.push(*corners);
            solid.triangle_nodes.push(nodes);
        }
        solid.weld();
        solid.finished()
    }

    /// A surface that bends, as it is at this moment.
    pub(crate) fn soft(soft: &Soft) -> Self {
        let corners = soft.vertices.iter().zip(&soft.normals);
        let nodes = corners.map(|(&position, &normal)| Node { position, normal });
        Self {
            positions: soft.vertices.clone(),
            triangles: soft.faces.clone(),
            triangle_nodes: soft.faces.clone(),
            nodes: nodes.collect(),
            uv: soft.uv.clone(),
            ..Self::default()
        }
        .finished()
    }

    /// The top of a height field, its four sides and its bottom, each triangle with a normal of its own.
    pub(crate) fn height_field(field: &HeightField, quads: usize) -> Self {
        let mut solid = Self::default();
        let [half_x, half_y, top, depth] = field.size;
        let (rows, columns) = (field.rows, field.columns);
        let x = |c: usize| half_x * (2.0 * ratio(c, columns - 1) - 1.0);
        let y = |r: usize| half_y * (2.0 * ratio(r, rows - 1) - 1.0);
        let high = |c: usize, r: usize| [x(c), y(r), field.heights[r * columns + c] * top];
        let low = |c: usize, r: usize| [x(c), y(r), -depth];
        for r in 0..rows - 1 {
            for c in 0..columns - 1 {
                let (a, b) = (high(c, r), high(c + 1, r));
                let (d, e) = (high(c, r + 1), high(c + 1, r + 1));
                solid.push_flat(&[d, a, e]);
                solid.push_flat(&[a, b, e]);
            }
            let (end, s) = (columns - 1, r + 1);
            solid.push_quad([low(0, s), low(0, r), high(0, r), high(0, s)]);
            solid.push_quad([low(end, r), low(end, s), high(end, s), high(end, r)]);
        }
        for c in 0..columns - 1 {
            let (end, d) = (rows - 1, c + 1);
            solid.push_quad([low(c, 0), low(d, 0), high(d, 0), high(c, 0)]);
            solid.push_quad([low(d, end), low(c, end), high(c, end), high(d, end)]);
        }
        let floor = |c: usize, r: usize| {
            let (s, t) = (2.0 * ratio(c, quads) - 1.0, 2.0 * ratio(r, quads) - 1.0);
            [half_x * s, half_y * t, -depth]
        };
        for r in 0..quads {
            for c in 0..quads {
                let (s, d) = (r + 1, c + 1);
                solid.push_quad([floor(c, r), floor(c, s), floor(d, s), floor(d, r)]);
            }
        }
        solid.weld();
        solid.finished()
    }

    /// Adds two triangles, cut from the second to the fourth corner as OpenGL does.
    fn push_quad(&mut self, [a, b, c, d]: [V3; 4]) {
        self.push_flat(&[a, b, d]);
        self.push_flat(&[b, c, d]);
    }

    /// Adds a triangle with its own normal.
    fn push_flat(&mut self, p: &[V3; 3]) {
        let normal = normalize(cross(sub(p[1], p[0]), sub(p[2], p[0])));
        let (corner, node) = (index(self.positions.len()), index(self.nodes.len()));
        self.positions.extend(p);
        let nodes = p.iter().map(|&position| Node { position, normal });
        self.nodes.extend(nodes);
        self.triangles.push([corner, corner + 1, corner + 2]);
        self.triangle_nodes.push([node, node + 1, node + 2]);
    }
}
