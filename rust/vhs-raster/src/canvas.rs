//! The picture: draws a view of a scene and hands out colours, distances or tags.
//!
//! A canvas owns every buffer that drawing needs and reuses them, so a frame allocates nothing once warm.

use crate::camera::{Projection, dot64};
use crate::cover::{Cover, NOTHING, Offset};
use crate::error::{Error, Result, check_len};
use crate::fill::{Colours, Fill, Job, Scratch, collect};
use crate::frame::{Frame, Listed, SKY_REACH, is_seen_from_behind};
use crate::lanes::Kind;
use crate::light::{Choice, Lamps, MOST_LIGHTS};
use crate::nodes::{Lighter, NodeCache, Role};
use crate::parts::Part;
use crate::scene::{Geom, Shape};
use crate::shade::Shader;
use crate::shadow::{Sample, Shade};
use crate::view::{Effects, Shown, View};

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
const TURNED_GRID: [Offset; 4] = [
    [-0.125, -0.375],
    [0.375, -0.125],
    [-0.375, 0.125],
    [0.125, 0.375],
];
const MIDDLE: [Offset; 1] = [[0.0, 0.0]];

/// Opacity of a plane seen from behind, relative to its own.
const BEHIND: f32 = 0.3;

/// A picture of fixed size with all its scratch memory.
#[derive(Debug)]
pub struct Canvas {
    height: usize,
    width: usize,
    antialias: Antialias,
    kind: Kind,
    cover: Cover,
    /// One sample a pixel, for distances and tags.
    plain: Option<Box<Cover>>,
    frame: Frame,
    colours: Colours,
    /// What one light with shadows adds to them.
    added: Option<Box<Colours>>,
    samples: Vec<Sample>,
    shade: Shade,
    lamps: Lamps,
    nodes: NodeCache,
    scratch: Scratch,
}

impl Canvas {
    /// A canvas of `height` by `width` pixels.
    ///
    /// # Errors
    /// [`Error::Range`] unless both are in 1..=8192.
    pub fn new(height: usize, width: usize, antialias: Antialias) -> Result<Self> {
        for (what, n) in [("picture height", height), ("picture width", width)] {
            if !(1..=8192).contains(&n) {
                return Err(Error::Range {
                    what,
                    expected: "1 to 8192",
                    got: n.to_string(),
                });
            }
        }
        let (h, w, offsets): (_, _, &[Offset]) = match antialias {
            Antialias::Off => (height, width, &MIDDLE),
            Antialias::Multisample => (height, width, &TURNED_GRID),
            Antialias::Supersample => (2 * height, 2 * width, &MIDDLE),
        };
        let kind = Kind::detect();
        Ok(Self {
            height,
            width,
            antialias,
            kind,
            cover: Cover::new(h, w, offsets, kind),
            plain: None,
            frame: Frame::default(),
            colours: Colours::new(h, w),
            added: None,
            samples: Vec::new(),
            shade: Shade::default(),
            lamps: Lamps::default(),
            nodes: NodeCache::default(),
            scratch: Scratch::default(),
        })
    }

    /// Height and width in pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.height, self.width)
    }

    /// Draws with the instructions of another kind of machine, to compare.
    #[cfg(test)]
    pub(crate) fn use_kind(&mut self, kind: Kind) {
        self.kind = kind;
        self.cover.kind = kind;
    }

    /// Draws colours into `out`, three bytes a pixel, top row first.
    ///
    /// # Errors
    /// [`Error::Length`] when `out` has not `3 * height * width` bytes.
    pub fn draw(&mut self, view: &View, layout: Layout, out: &mut [u8]) -> Result<()> {
        check_len("picture bytes", 3 * self.height * self.width, out.len())?;
        let projection = view.projection(self.cover.height, self.cover.width);
        self.lamps.update(view, &projection, Choice::Shadowless);
        self.nodes.start_frame();
        self.frame.clear();
        self.cover.clear(projection.depth_range);
        let (frame, cover) = (&mut self.frame, &mut self.cover);
        frame.draw_opaque(view, &projection, cover);
        frame.draw_sky(view, &projection, cover);
        self.fill(view, false);
        self.add_lights_with_shadows(view, &projection);
        self.blend_haze(view, &projection);
        self.blend_glass(view, &projection);
        self.write_out(layout, out);
        Ok(())
    }

    /// Writes the distance of every pixel along the camera's gaze in metres; the far plane where there is nothing.
    ///
    /// Transparent geoms count as solid, the sky as nothing.
    ///
    /// # Errors
    /// [`Error::Length`] when `out` has not `height * width` values.
    pub fn draw_depth(&mut self, view: &View, out: &mut [f32]) -> Result<()> {
        check_len("depth values", self.height * self.width, out.len())?;
        let projection = self.draw_solid(view);
        let cover = self.plain_cover();
        for (row, line) in out
            .chunks_exact_mut(cover.width)
            .zip(cover.depth.chunks_exact(cover.stride))
        {
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
    pub fn draw_tags(&mut self, view: &View, out: &mut [i32]) -> Result<()> {
        check_len(
            "segmentation values",
            2 * self.height * self.width,
            out.len(),
        )?;
        self.draw_solid(view);
        let tag_of = |part: u32| match self.frame.placed[part as usize].role {
            Role::Geom(geom) | Role::Unlit(geom) => view.geoms[geom].geom.tag.unwrap_or([-1, -1]),
            Role::Sky | Role::Haze => [-1, -1],
        };
        let cover = self.plain_cover();
        for (row, line) in out
            .chunks_exact_mut(2 * cover.width)
            .zip(cover.face.chunks_exact(cover.stride))
        {
            for (to, &face) in row.chunks_exact_mut(2).zip(line) {
                let tag = if face == NOTHING {
                    [-1, -1]
                } else {
                    tag_of(self.frame.drawn[face as usize].part)
                };
                to.copy_from_slice(&tag);
            }
        }
        Ok(())
    }

    /// The buffers with one sample a pixel.
    fn plain_cover(&self) -> &Cover {
        self.plain.as_deref().unwrap_or(&self.cover)
    }

    /// Draws every geom with a tag as if it were opaque, one sample a pixel, without a sky.
    fn draw_solid(&mut self, view: &View) -> Projection {
        let projection = view.projection(self.height, self.width);
        let cover = if self.antialias == Antialias::Off {
            &mut self.cover
        } else {
            self.plain.get_or_insert_with(|| {
                Box::new(Cover::new(self.height, self.width, &MIDDLE, self.kind))
            })
        };
        self.frame.clear();
        cover.clear(projection.depth_range);
        self.frame.draw_tagged(view, &projection, cover);
        projection
    }

    /// Adds the light of all that cast shadows, one after the other.
    fn add_lights_with_shadows(&mut self, view: &View, projection: &Projection) {
        let lights = view.lights.iter().take(MOST_LIGHTS).enumerate();
        let mut is_first = true;
        for (number, light) in lights.filter(|(_, light)| view.has_shadow(light)) {
            if std::mem::take(&mut is_first) {
                let frame = &self.frame;
                collect(&self.cover, &frame.drawn, &frame.edges, &mut self.samples);
            }
            self.shade
                .find(view, light, projection, &self.samples, &mut self.frame);
            self.relight(view, projection, Choice::One(number));
            let (height, width) = (self.cover.height, self.cover.width);
            let added = self.added.take();
            let mut added = added.unwrap_or_else(|| Box::new(Colours::new(height, width)));
            std::mem::swap(&mut self.colours, &mut added);
            self.fill_with(view, false, true);
            std::mem::swap(&mut self.colours, &mut added);
            self.colours.add(&added);
            self.added = Some(added);
        }
        if !is_first {
            // What is transparent gets all lights and no shadows.
            self.relight(view, projection, Choice::All);
        }
    }

    /// Chooses other lights, and forgets what the last ones lit.
    fn relight(&mut self, view: &View, projection: &Projection, choice: Choice) {
        self.lamps.update(view, projection, choice);
        self.nodes.start_frame();
        self.frame.ready_at.clear();
        self.frame.ready.clear();
    }

    /// Colours every visible sample, or blends the listed fragments over the picture.
    fn fill(&mut self, view: &View, is_blending: bool) {
        self.fill_with(view, is_blending, false);
    }

    /// The same; visible samples that `shade` found dark stay black if `has_shade`.
    fn fill_with(&mut self, view: &View, is_blending: bool, has_shade: bool) {
        let frame = &mut self.frame;
        self.nodes.reserve(frame.nodes);
        let lighter = Lighter {
            view,
            lamps: &self.lamps,
            placed: &frame.placed,
            nodes: &mut self.nodes,
        };
        let shader = Shader { lighter };
        let mut fill = Fill {
            cover: &self.cover,
            colours: &mut self.colours,
            shader,
            drawn: &frame.drawn,
            ready_at: &mut frame.ready_at,
            ready: &mut frame.ready,
            edges: &mut frame.edges,
            scratch: &mut self.scratch,
            kind: self.kind,
            dark: has_shade.then_some(&self.shade.is_dark[..]),
            done: 0,
        };
        let job = if is_blending {
            Job::Over(&frame.fragments)
        } else {
            Job::Visible
        };
        fill.run(&job);
    }

    /// Lays the belt over the horizon of the first endless plane.
    fn blend_haze(&mut self, view: &View, projection: &Projection) {
        let Effects {
            has_sky, has_haze, ..
        } = view.effects;
        let (Some(solid), Some(_)) = (view.scene.haze_solid, view.scene.sky) else {
            return;
        };
        let is_endless = |shown: &&Shown| matches!(shown.geom.shape, Shape::Plane { half_size, .. } if half_size == [0.0, 0.0]);
        let Some(plane) = view.geoms.iter().find(is_endless) else {
            return;
        };
        let Geom {
            position, rotation, ..
        } = &plane.geom;
        let axis = [rotation[2], rotation[5], rotation[8]];
        let from_plane = [0, 1, 2].map(|k| view.camera.position[k] - position[k]);
        let height = dot64(from_plane, axis);
        if height < 0.0 || !has_sky || !has_haze {
            return;
        }
        let foot = [0, 1, 2].map(|k| view.camera.position[k] - height * axis[k]);
        #[expect(clippy::cast_possible_truncation, reason = "vertices are f32")]
        let (reach, height) = ((SKY_REACH * view.scene.far) as f32, height as f32);
        let part = Part {
            geom: 0,
            solid,
            scale: [reach, reach, height],
            shift: 0.0,
            radius: f32::INFINITY,
        };
        self.blend(view, |frame, list| {
            let haze = (Role::Haze, &part, foot, rotation);
            frame.draw_part(view, projection, haze, 1.0, true, list);
        });
    }

    /// Blends transparent parts front to back and once more back to front, as MuJoCo does.
    fn blend_glass(&mut self, view: &View, projection: &Projection) {
        if self.frame.glass.is_empty() {
            return;
        }
        let mut glass = std::mem::take(&mut self.frame.glass);
        glass.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The parts of one geom are equally far and stay together, in the same order both times.
        let groups: Vec<&[(f32, Part)]> = glass.chunk_by(|a, b| a.1.geom == b.1.geom).collect();
        for (_, part) in groups.iter().chain(groups.iter().rev()).copied().flatten() {
            let is_behind = is_seen_from_behind(view, part);
            let own = view.geoms[part.geom].geom.surface.rgba[3];
            let alpha = own * if is_behind { BEHIND } else { 1.0 };
            self.blend(view, |frame, list| {
                frame.draw_geom_part(view, projection, part, alpha, is_behind, list);
            });
        }
        self.frame.glass = glass;
    }

    /// Blends what `draw` lists over the colours so far, without touching depth.
    fn blend(&mut self, view: &View, draw: impl FnOnce(&mut Frame, &mut Listed<'_>)) {
        let mut fragments = std::mem::take(&mut self.frame.fragments);
        fragments.clear();
        let mut list = Listed {
            cover: &self.cover,
            fragments: &mut fragments,
        };
        draw(&mut self.frame, &mut list);
        self.frame.fragments = fragments;
        self.fill(view, true);
    }

    /// Writes the colours as the caller wants them.
    fn write_out(&self, layout: Layout, out: &mut [u8]) {
        let n = self.height * self.width;
        for y in 0..self.height {
            let from = y * self.width;
            match layout {
                Layout::Interleaved => {
                    self.each_in_row(y, &mut out[3 * from..3 * (from + self.width)]);
                }
                Layout::Planar => {
                    for x in 0..self.width {
                        let [r, g, b, _] = self.colour_at(x, y).to_le_bytes();
                        (out[from + x], out[n + from + x], out[2 * n + from + x]) = (r, g, b);
                    }
                }
            }
        }
    }

    /// Writes one row with its channels side by side.
    fn each_in_row(&self, y: usize, row: &mut [u8]) {
        if self.antialias == Antialias::Supersample {
            for (x, to) in row.chunks_exact_mut(3).enumerate() {
                to.copy_from_slice(&self.colour_at(x, y).to_le_bytes()[..3]);
            }
            return;
        }
        let start = y * self.colours.stride;
        let pixels = &self.colours.pixels[start..start + self.width];
        let (fours, rest) = pixels.as_chunks::<4>();
        let (twelves, tail) = row.split_at_mut(12 * fours.len());
        for (to, &[a, b, c, d]) in twelves.chunks_exact_mut(12).zip(fours) {
            to[..4].copy_from_slice(&(a | b << 24).to_le_bytes());
            to[4..8].copy_from_slice(&(b >> 8 | c << 16).to_le_bytes());
            to[8..].copy_from_slice(&(c >> 16 | d << 8).to_le_bytes());
        }
        for (to, colour) in tail.chunks_exact_mut(3).zip(rest) {
            to.copy_from_slice(&colour.to_le_bytes()[..3]);
        }
    }

    /// Colour of a pixel, the mean of four samples when supersampling.
    fn colour_at(&self, x: usize, y: usize) -> u32 {
        let Colours { stride, pixels } = &self.colours;
        if self.antialias != Antialias::Supersample {
            return pixels[y * stride + x];
        }
        let (top, bottom) = (2 * y * stride + 2 * x, (2 * y + 1) * stride + 2 * x);
        let four = [
            pixels[top],
            pixels[top + 1],
            pixels[bottom],
            pixels[bottom + 1],
        ];
        // Every other channel has room for the sum of four.
        let sum =
            |shift: u32| four.iter().map(|c| c >> shift & 0x00ff_00ff).sum::<u32>() + 0x0002_0002;
        (sum(0) >> 2 & 0x00ff_00ff) | (sum(8) >> 2 & 0x00ff_00ff) << 8
    }
}
