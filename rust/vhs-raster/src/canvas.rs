//! The picture: draws a view of a scene and hands out colours, distances or tags.
//!
//! A canvas owns every buffer that drawing needs and reuses them, so a frame allocates nothing once warm. Order of
//! drawing as in MuJoCo's `mjr_render`: opaque parts, sky, haze, then transparent parts front to back and once more
//! back to front.

use crate::cover::{Corner, Cover, Drawn, NOTHING, Offset, Outline, Window, middle, outline};
use crate::error::{Error, Result};
use crate::light::Lamps;
use crate::math::{V3, mul3};
use crate::scene::{Part, Scene, Shape};
use crate::shade::{Batch, NodeCache, Placed, Ready, Role, Shader};
use crate::solid::Nodes;
use crate::view::{Projection, View, dot64};
use crate::cover::LANES;

/// How edges are smoothed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Antialias {
    /// One sample a pixel.
    #[default]
    Off,
    /// Four samples of coverage and depth a pixel, one colour for each face in it: OpenGL's multisampling.
    Multisample,
    /// Four full samples a pixel on a 2x2 grid: textures are smoothed as well as edges.
    Supersample,
}

/// Order of the channels in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Layout {
    /// `[height, width, 3]`.
    #[default]
    Interleaved,
    /// `[3, height, width]`.
    Planar,
}

/// Sample places of common drivers for four samples: a square grid, turned.
const TURNED_GRID: [Offset; 4] = [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];
const MIDDLE: [Offset; 1] = [[0.0, 0.0]];

/// From this opacity on a geom counts as opaque.
const OPAQUE: f32 = 0.995;

/// The sky's cylinder, relative to the far plane: its corners must stay inside.
const SKY_REACH: f64 = 0.7;

/// A picture of fixed size with all its scratch memory.
#[derive(Debug)]
pub struct Canvas {
    height: usize,
    width: usize,
    antialias: Antialias,
    cover: Cover,
    /// One sample a pixel, for distances and tags.
    plain: Option<Box<Cover>>,
    frame: Frame,
    /// Colours, pixel by pixel, sample by sample: red, green, blue from the low byte up.
    colours: Vec<u32>,
    lamps: Lamps,
    nodes: NodeCache,
}

/// Lists that one frame fills.
#[derive(Debug, Default)]
struct Frame {
    placed: Vec<Placed>,
    drawn: Vec<Drawn>,
    corners: Vec<Corner>,
    /// For each drawn face its place in `ready`, or [`NOTHING`].
    ready_at: Vec<u32>,
    ready: Vec<Ready>,
    /// Nodes handed out so far.
    nodes: usize,
    /// Transparent parts with their distance.
    glass: Vec<(f32, Part)>,
}

/// One visible face in one pixel.
#[derive(Debug, Clone, Copy)]
struct Fragment {
    face: u32,
    x: u16,
    y: u16,
    /// Which samples of the pixel show it.
    mask: u8,
}

impl Canvas {
    /// A canvas of `height` by `width` pixels.
    ///
    /// # Errors
    /// [`Error::Range`] unless both are in 1..=8192.
    pub fn new(height: usize, width: usize, antialias: Antialias) -> Result<Self> {
        for (what, n) in [("picture height", height), ("picture width", width)] {
            if !(1..=8192).contains(&n) {
                return Err(Error::Range { what, expected: "1 to 8192", got: n.to_string() });
            }
        }
        let (h, w, offsets): (_, _, &[Offset]) = match antialias {
            Antialias::Off => (height, width, &MIDDLE),
            Antialias::Multisample => (height, width, &TURNED_GRID),
            Antialias::Supersample => (2 * height, 2 * width, &MIDDLE),
        };
        Ok(Self {
            height,
            width,
            antialias,
            cover: Cover::new(h, w, offsets),
            plain: None,
            frame: Frame::default(),
            colours: vec![0; h * w * offsets.len()],
            lamps: Lamps::default(),
            nodes: NodeCache::default(),
        })
    }

    /// Height and width in pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.height, self.width)
    }

    /// Draws colours into `out`, three bytes a pixel, top row first.
    ///
    /// # Errors
    /// [`Error::Length`] when `out` has not `3 * height * width` bytes.
    pub fn draw(&mut self, scene: &Scene, view: &View, layout: Layout, out: &mut [u8]) -> Result<()> {
        check_len("picture bytes", 3 * self.height * self.width, out.len())?;
        let projection = view.projection(self.cover.height, self.cover.width);
        self.lamps.update(scene, view, &projection);
        self.nodes.start_frame();
        self.frame.clear();
        self.cover.clear(projection.depth_range);
        self.frame.draw_opaque(scene, view, &projection, &mut self.cover);
        self.frame.draw_sky(scene, view, &projection, &mut self.cover);
        self.shade_visible(scene);
        self.blend_haze(scene, view, &projection);
        self.blend_glass(scene, view, &projection);
        self.resolve(layout, out);
        Ok(())
    }

    /// Writes the distance of every pixel along the camera's gaze in metres; the far plane where there is nothing.
    ///
    /// Transparent geoms count as solid, the sky as nothing.
    ///
    /// # Errors
    /// [`Error::Length`] when `out` has not `height * width` values.
    pub fn draw_depth(&mut self, scene: &Scene, view: &View, out: &mut [f32]) -> Result<()> {
        check_len("depth values", self.height * self.width, out.len())?;
        let projection = self.draw_solid(scene, view);
        let cover = self.plain_cover();
        for (row, line) in out.chunks_exact_mut(cover.width).zip(cover.depth.chunks_exact(cover.stride)) {
            for (to, &depth) in row.iter_mut().zip(line) {
                *to = projection.distance(depth);
            }
        }
        Ok(())
    }

    /// Writes the two numbers of the geom in every pixel; -1, -1 where there is none.
    ///
    /// # Errors
    /// [`Error::Length`] when `out` has not `2 * height * width` values.
    pub fn draw_tags(&mut self, scene: &Scene, view: &View, out: &mut [i32]) -> Result<()> {
        check_len("segmentation values", 2 * self.height * self.width, out.len())?;
        self.draw_solid(scene, view);
        let tags: Vec<[i32; 2]> = (self.frame.placed.iter())
            .map(|p| if let Role::Geom(g) = p.role { scene.spec.geoms[g].tag } else { [-1, -1] })
            .collect();
        let cover = self.plain_cover();
        for (row, line) in out.chunks_exact_mut(2 * cover.width).zip(cover.face.chunks_exact(cover.stride)) {
            for (to, &face) in row.chunks_exact_mut(2).zip(line) {
                let tag = self.frame.drawn.get(face as usize).map_or([-1, -1], |d| tags[d.part as usize]);
                to.copy_from_slice(&tag);
            }
        }
        Ok(())
    }

    fn plain_cover(&self) -> &Cover {
        self.plain.as_deref().unwrap_or(&self.cover)
    }

    /// Draws every geom as if it were opaque, one sample a pixel, without a sky.
    fn draw_solid(&mut self, scene: &Scene, view: &View) -> Projection {
        let projection = view.projection(self.height, self.width);
        let cover = if self.antialias == Antialias::Off {
            &mut self.cover
        } else {
            self.plain.get_or_insert_with(|| Box::new(Cover::new(self.height, self.width, &MIDDLE)))
        };
        self.frame.clear();
        cover.clear(projection.depth_range);
        self.frame.draw_opaque(scene, view, &projection, cover);
        let glass = std::mem::take(&mut self.frame.glass);
        for (_, part) in &glass {
            let is_inverted = is_seen_from_behind(scene, view, part);
            self.frame.draw_geom_part(scene, view, &projection, part, 1.0, is_inverted, &mut Into(cover));
        }
        self.frame.glass = glass;
        projection
    }

    /// Shades every sample that shows a face.
    fn shade_visible(&mut self, scene: &Scene) {
        self.nodes.reserve(self.frame.nodes);
        let frame = &mut self.frame;
        frame.ready_at.clear();
        frame.ready_at.resize(frame.drawn.len(), NOTHING);
        frame.ready.clear();
        let mut shader =
            Shader { scene, lamps: &self.lamps, placed: &frame.placed, nodes: &mut self.nodes };
        let samples = self.cover.offsets.len();
        let (cover, colours) = (&self.cover, &mut self.colours);
        let mut fragments: Vec<Fragment> = Vec::new();
        for y in 0..cover.height {
            fragments.clear();
            collect_row(cover, y, &mut fragments);
            for run in fragments.chunk_by(|a, b| a.face == b.face) {
                if run[0].face == NOTHING {
                    for f in run {
                        store(colours, samples, pixel(cover, f), f.mask, 0);
                    }
                    continue;
                }
                let slot = &mut frame.ready_at[run[0].face as usize];
                if *slot == NOTHING {
                    *slot = u32::try_from(frame.ready.len()).unwrap_or(NOTHING);
                    frame.ready.push(shader.ready(&frame.drawn[run[0].face as usize]));
                }
                let ready = frame.ready[*slot as usize];
                for few in run.chunks(LANES) {
                    let shades = shader.shade(&ready, &batch(cover, few));
                    for (i, f) in few.iter().enumerate() {
                        let colour = pack([shades[0][i], shades[1][i], shades[2][i]]);
                        store(colours, samples, pixel(cover, f), f.mask, colour);
                    }
                }
            }
        }
    }

    /// Lays the belt over the horizon of the first endless plane.
    fn blend_haze(&mut self, scene: &Scene, view: &View, projection: &Projection) {
        let (Some(solid), Some(_)) = (scene.haze_solid, scene.spec.sky) else {
            return;
        };
        let endless = (0..scene.geom_count()).find(|&g| {
            view.is_visible[g] && matches!(scene.spec.geoms[g].shape, Shape::Plane { half_size: [0.0, 0.0], .. })
        });
        let Some(geom) = endless else {
            return;
        };
        let pose = &view.poses[geom];
        let axis = [pose.rotation[2], pose.rotation[5], pose.rotation[8]];
        let reach = SKY_REACH * scene.spec.far;
        let height = dot64([0, 1, 2].map(|k| view.camera.position[k] - pose.position[k]), axis);
        if height < 0.0 {
            return;
        }
        let position = [0, 1, 2].map(|k| view.camera.position[k] - height * axis[k]);
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let scale = [reach as f32, reach as f32, height as f32];
        let part = Part { geom: 0, solid, scale, shift: 0.0, radius: f32::INFINITY };
        self.blend(scene, projection, (Role::Haze, &part, position, &pose.rotation), 1.0, true);
    }

    /// Blends transparent parts in both orders, as MuJoCo does.
    fn blend_glass(&mut self, scene: &Scene, view: &View, projection: &Projection) {
        if self.frame.glass.is_empty() {
            return;
        }
        let mut glass = std::mem::take(&mut self.frame.glass);
        glass.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Solids of one geom stay in their order in both passes.
        let geoms: Vec<usize> = {
            let mut order: Vec<usize> = glass.iter().map(|g| g.1.geom).collect();
            order.dedup();
            order
        };
        for &geom in geoms.iter().chain(geoms.iter().rev()) {
            for (_, part) in glass.iter().filter(|g| g.1.geom == geom) {
                let is_behind = is_seen_from_behind(scene, view, part);
                let alpha = scene.spec.geoms[geom].surface.rgba[3] * if is_behind { 0.3 } else { 1.0 };
                let position = origin_of(scene, view, part);
                let rotation = view.poses[geom].rotation;
                self.blend(scene, projection, (Role::Geom(geom), part, position, &rotation), alpha, is_behind);
            }
        }
        self.frame.glass = glass;
    }

    /// Blends one part over the colours so far, without touching depth.
    fn blend(
        &mut self,
        scene: &Scene,
        projection: &Projection,
        (role, part, position, rotation): (Role, &Part, [f64; 3], &[f64; 9]),
        alpha: f32,
        is_inverted: bool,
    ) {
        let mut list = Listed { cover: &self.cover, fragments: Vec::new(), first: self.frame.drawn.len() };
        self.frame.draw_part(scene, projection, (role, part, position, rotation), alpha, is_inverted, &mut list);
        let fragments = list.fragments;
        self.nodes.reserve(self.frame.nodes);
        let frame = &self.frame;
        let mut shader =
            Shader { scene, lamps: &self.lamps, placed: &frame.placed, nodes: &mut self.nodes };
        let samples = self.cover.offsets.len();
        for run in fragments.chunk_by(|a, b| a.face == b.face) {
            let ready = shader.ready(&frame.drawn[run[0].face as usize]);
            for few in run.chunks(LANES) {
                let shades = shader.shade(&ready, &batch(&self.cover, few));
                for (i, f) in few.iter().enumerate() {
                    let first = pixel(&self.cover, f) * samples;
                    for s in (0..samples).filter(|s| f.mask >> s & 1 == 1) {
                        let below = unpack(self.colours[first + s]);
                        let a = shades[3][i];
                        self.colours[first + s] = pack([0, 1, 2].map(|k| shades[k][i] * a + below[k] * (1.0 - a)));
                    }
                }
            }
        }
    }

    /// Averages the samples of each pixel and writes it out.
    fn resolve(&self, layout: Layout, out: &mut [u8]) {
        let n = self.height * self.width;
        for y in 0..self.height {
            for x in 0..self.width {
                let colour = self.mean_of(x, y);
                let i = y * self.width + x;
                match layout {
                    Layout::Interleaved => out[3 * i..3 * i + 3].copy_from_slice(&colour),
                    Layout::Planar => (0..3).for_each(|k| out[k * n + i] = colour[k]),
                }
            }
        }
    }

    /// Mean colour of a pixel's samples, rounded.
    fn mean_of(&self, x: usize, y: usize) -> [u8; 3] {
        let four = match self.antialias {
            Antialias::Off => {
                let [r, g, b, _] = self.colours[y * self.width + x].to_le_bytes();
                return [r, g, b];
            }
            Antialias::Multisample => {
                let i = 4 * (y * self.width + x);
                [self.colours[i], self.colours[i + 1], self.colours[i + 2], self.colours[i + 3]]
            }
            Antialias::Supersample => {
                let i = 2 * (2 * y * self.width + x);
                let below = i + 2 * self.width;
                [self.colours[i], self.colours[i + 1], self.colours[below], self.colours[below + 1]]
            }
        };
        let mut sum = [2_u16; 3];
        for colour in four {
            let bytes = colour.to_le_bytes();
            for k in 0..3 {
                sum[k] += u16::from(bytes[k]);
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of bytes is a byte")]
        let mean = sum.map(|s| (s >> 2) as u8);
        mean
    }
}

fn check_len(what: &'static str, expected: usize, got: usize) -> Result<()> {
    if expected == got { Ok(()) } else { Err(Error::Length { what, expected, got }) }
}

fn pixel(cover: &Cover, f: &Fragment) -> usize {
    usize::from(f.y) * cover.width + usize::from(f.x)
}

/// Three channels in 0..=1 as bytes, rounded.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates to a byte")]
fn pack(c: V3) -> u32 {
    let [r, g, b] = c.map(|v| (v * 255.0 + 0.5) as u8);
    u32::from_le_bytes([r, g, b, 255])
}

fn unpack(colour: u32) -> V3 {
    let [r, g, b, _] = colour.to_le_bytes();
    [r, g, b].map(|v| f32::from(v) * (1.0 / 255.0))
}

/// Writes a colour to the samples of a pixel that the mask names.
#[inline(always)]
fn store(colours: &mut [u32], samples: usize, pixel: usize, mask: u8, colour: u32) {
    let first = pixel * samples;
    for s in 0..samples {
        if mask >> s & 1 == 1 {
            colours[first + s] = colour;
        }
    }
}

/// The faces of one row of pixels, each once a pixel.
fn collect_row(cover: &Cover, y: usize, fragments: &mut Vec<Fragment>) {
    let (samples, layer) = (cover.offsets.len(), cover.layer());
    #[expect(clippy::cast_possible_truncation, reason = "pictures have at most 16384 rows and columns")]
    for x in 0..cover.width {
        let mut left = (1_u8 << samples) - 1;
        while left != 0 {
            let face = cover.face[left.trailing_zeros() as usize * layer + y * cover.stride + x];
            let mut mask = 0;
            for s in 0..samples {
                mask |= u8::from(cover.face[s * layer + y * cover.stride + x] == face) << s;
            }
            mask &= left;
            left &= !mask;
            fragments.push(Fragment { face, x: x as u16, y: y as u16, mask });
        }
    }
}

fn batch(cover: &Cover, few: &[Fragment]) -> Batch {
    let mut batch = Batch { x: [0.0; LANES], y: [0.0; LANES], len: few.len() };
    for i in 0..LANES {
        let f = &few[i.min(few.len() - 1)];
        batch.x[i] = middle(usize::from(f.x), cover.width);
        batch.y[i] = -middle(usize::from(f.y), cover.height);
    }
    batch
}

/// Where faces go once they are projected.
trait Sink {
    fn cover(&self) -> &Cover;
    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize);
}

/// Into depth and face numbers.
struct Into<'a>(&'a mut Cover);

impl Sink for Into<'_> {
    fn cover(&self) -> &Cover {
        self.0
    }

    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize) {
        self.0.draw(outline, window, u32::try_from(number).unwrap_or(NOTHING));
    }
}

/// Into a list of fragments, in drawing order.
struct Listed<'a> {
    cover: &'a Cover,
    fragments: Vec<Fragment>,
    first: usize,
}

impl Sink for Listed<'_> {
    fn cover(&self) -> &Cover {
        self.cover
    }

    #[expect(clippy::cast_possible_truncation, reason = "pictures have at most 16384 rows and columns")]
    fn face<const N: usize>(&mut self, outline: &Outline<N>, window: Window, number: usize) {
        debug_assert!(number >= self.first);
        let face = u32::try_from(number).unwrap_or(NOTHING);
        let fragments = &mut self.fragments;
        self.cover.visit(outline, window, |x, y, mask| {
            fragments.push(Fragment { face, x: x as u16, y: y as u16, mask });
        });
    }
}

/// Whether the camera is on the far side of a plane.
fn is_seen_from_behind(scene: &Scene, view: &View, part: &Part) -> bool {
    let pose = &view.poses[part.geom];
    let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - pose.position[k]);
    let axis = [pose.rotation[2], pose.rotation[5], pose.rotation[8]];
    matches!(scene.spec.geoms[part.geom].shape, Shape::Plane { .. }) && dot64(to_eye, axis) < 0.0
}

/// Where the solid's origin is: shifted along the geom's axis, and for an endless plane below the camera.
fn origin_of(scene: &Scene, view: &View, part: &Part) -> [f64; 3] {
    let pose = &view.poses[part.geom];
    let r = &pose.rotation;
    let mut at = pose.position;
    for k in 0..3 {
        at[k] += f64::from(part.shift) * r[3 * k + 2];
    }
    for (axis, step) in scene.plane_step[part.geom].iter().enumerate().filter(|s| *s.1 > 0.0) {
        let to_eye = [0, 1, 2].map(|k| view.camera.position[k] - pose.position[k]);
        let along = dot64(to_eye, [r[axis], r[3 + axis], r[6 + axis]]);
        // Whole repetitions of the texture, so that it seems to stand still.
        let moved = 2.0 * step * libm::floor(0.5 * along / step + 0.5);
        for k in 0..3 {
            at[k] += moved * r[3 * k + axis];
        }
    }
    at
}

impl Frame {
    fn clear(&mut self) {
        self.placed.clear();
        self.drawn.clear();
        self.glass.clear();
        self.nodes = 0;
    }

    /// Draws all opaque parts and sets the transparent ones aside.
    fn draw_opaque(&mut self, scene: &Scene, view: &View, projection: &Projection, cover: &mut Cover) {
        for part in &scene.parts {
            let alpha = scene.spec.geoms[part.geom].surface.rgba[3];
            if !view.is_visible[part.geom] || alpha == 0.0 {
                continue;
            }
            if alpha < OPAQUE || is_seen_from_behind(scene, view, part) {
                self.glass.push((glass_distance(scene, view, part.geom), *part));
            } else {
                self.draw_geom_part(scene, view, projection, part, 1.0, false, &mut Into(cover));
            }
        }
    }

    #[expect(clippy::too_many_arguments, reason = "one step of drawing, called from two places")]
    fn draw_geom_part(
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
        let place = (Role::Geom(part.geom), part, position, &view.poses[part.geom].rotation);
        self.draw_part(scene, projection, place, alpha, is_inverted, sink);
    }

    /// Draws the sky's cylinder around the camera, seen from inside.
    fn draw_sky(&mut self, scene: &Scene, view: &View, projection: &Projection, cover: &mut Cover) {
        if scene.spec.sky.is_none() {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let reach = (SKY_REACH * scene.spec.far) as f32;
        let upright = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let part = Part { geom: 0, solid: scene.sky_solid, scale: [reach; 3], shift: 0.0, radius: f32::INFINITY };
        let place = (Role::Sky, &part, view.camera.position, &upright);
        self.draw_part(scene, projection, place, 1.0, true, &mut Into(cover));
    }

    /// Projects a part and hands its faces to `sink`.
    fn draw_part(
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
            Corner { p: v, z, at: [v[0] * w, v[1] * w], is_ahead: v[2] >= projection.near }
        }));
        for (face, corners) in solid.triangles.iter().enumerate() {
            self.draw_face(corners, (number, face), is_inverted, projection.near, sink);
        }
        for (face, large) in solid.faces.iter().enumerate() {
            let face = (number, face + solid.triangles.len());
            let [a, b, c, d] = large.corners;
            match large.nodes {
                Nodes::Grid { .. } => self.draw_face(&[a, b, c, d], face, is_inverted, projection.near, sink),
                Nodes::Slice { .. } => self.draw_face(&[a, b, c], face, is_inverted, projection.near, sink),
            }
        }
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "solids have far fewer than 2^32 faces")]
    fn draw_face<const N: usize>(
        &mut self,
        corners: &[u32; N],
        (part, face): (u32, usize),
        is_inverted: bool,
        near: f32,
        sink: &mut impl Sink,
    ) {
        let corners = corners.map(|c| self.corners[c as usize]);
        let Some((shape, drawn)) = outline(&corners, is_inverted) else {
            return;
        };
        let Some(window) = sink.cover().window(&corners, near) else {
            return;
        };
        sink.face(&shape, window, self.drawn.len());
        self.drawn.push(Drawn { part, face: face as u32, ..drawn });
    }
}

/// Distance by which transparent geoms are sorted: to the near side of the ball around them; planes come last.
#[expect(clippy::cast_possible_truncation, reason = "only an order")]
fn glass_distance(scene: &Scene, view: &View, geom: usize) -> f32 {
    if matches!(scene.spec.geoms[geom].shape, Shape::Plane { .. }) {
        return 1e10;
    }
    let radius = scene.parts.iter().filter(|p| p.geom == geom).map(|p| p.radius + p.shift.abs()).fold(0.0, f32::max);
    let way = [0, 1, 2].map(|k| view.poses[geom].position[k] - view.camera.position[k]);
    dot64(way, way).sqrt() as f32 - radius
}
