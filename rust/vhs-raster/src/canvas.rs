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
use crate::mirror::Mirror;
use crate::nodes::{Lighter, NodeCache, Role};
use crate::output::{Layout, write_out};
use crate::paint::Sample;
use crate::parts::Part;
use crate::scene::{Geom, Shape};
use crate::shade::Shader;
use crate::shadow::Shade;
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
    /// What a mirror shows.
    mirrored: Option<Box<Canvas>>,
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
        let drawn = match antialias {
            Antialias::Off | Antialias::Multisample => (height, width),
            Antialias::Supersample => (2 * height, 2 * width),
        };
        let kind = Kind::detect();
        Ok(Self::of_size((height, width), drawn, antialias, kind))
    }

    /// A canvas that draws a picture of the second size for one of the first.
    fn of_size(
        (height, width): (usize, usize),
        (h, w): (usize, usize),
        antialias: Antialias,
        kind: Kind,
    ) -> Self {
        let offsets: &[Offset] = match antialias {
            Antialias::Multisample => &TURNED_GRID,
            Antialias::Off | Antialias::Supersample => &MIDDLE,
        };
        Self {
            height,
            width,
            antialias,
            kind,
            cover: Cover::new(h, w, offsets, kind),
            plain: None,
            frame: Frame::default(),
            colours: Colours::new(h, w),
            added: None,
            mirrored: None,
            samples: Vec::new(),
            shade: Shade::default(),
            lamps: Lamps::default(),
            nodes: NodeCache::default(),
            scratch: Scratch::default(),
        }
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
        if let Some(mirror) = Mirror::of(view) {
            self.add_reflection(view, &projection, &mirror);
        }
        self.add_lights_with_shadows(view, &projection);
        self.blend_haze(view, &projection);
        self.blend_glass(view, &projection, false);
        let is_halved = self.antialias == Antialias::Supersample;
        write_out(&self.colours, self.width, is_halved, layout, out);
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

    /// Adds what a mirror shows to the samples in which it is seen.
    fn add_reflection(&mut self, view: &View, projection: &Projection, mirror: &Mirror) {
        let mut mirrored = self.mirrored.take().unwrap_or_else(|| {
            let (height, width) = (self.cover.height, self.cover.width);
            Box::new(Self::of_size(
                (self.height, self.width),
                (height, width),
                self.antialias,
                self.kind,
            ))
        });
        mirrored.draw_mirrored(view, projection, mirror);
        let placed = &self.frame.placed;
        let mirrors = |face: u32| {
            let Some(drawn) = self.frame.drawn.get(face as usize) else {
                return false;
            };
            let is_its = placed[drawn.part as usize].role == Role::Geom(mirror.geom);
            is_its && drawn.face == mirror.face
        };
        let (cover, layer) = (&self.cover, self.cover.layer());
        let samples = cover.offsets.len();
        for y in 0..cover.height {
            for x in 0..cover.width {
                let at = y * cover.stride + x;
                let seen = (0..samples)
                    .filter(|s| mirrors(cover.face[s * layer + at]))
                    .count();
                if seen > 0 {
                    let from = y * self.colours.stride + x;
                    let more = mirrored.colours.pixels[from].to_le_bytes();
                    let own = &mut self.colours.pixels[from];
                    let sum = own.to_le_bytes();
                    *own = u32::from_le_bytes([0, 1, 2, 3].map(|k| {
                        let part = usize::from(more[k]) * seen / samples;
                        sum[k].saturating_add(u8::try_from(part).unwrap_or(u8::MAX))
                    }));
                }
            }
        }
        self.mirrored = Some(mirrored);
    }

    /// Draws what a mirror shows, without shadows.
    fn draw_mirrored(&mut self, view: &View, projection: &Projection, mirror: &Mirror) {
        let (projection, limit) = mirror.projection(projection);
        self.lamps.update(view, &projection, Choice::All);
        self.lamps.set_tint(mirror.reflectance);
        self.nodes.start_frame();
        self.frame.clear();
        self.cover.clear(projection.depth_range);
        self.cover.limit = Some(limit);
        self.frame
            .draw_mirrored(view, &projection, mirror.geom, &mut self.cover);
        self.fill(view, false);
        self.blend_glass(view, &projection, true);
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
    ///
    /// In a mirror what is in front is behind.
    fn blend_glass(&mut self, view: &View, projection: &Projection, is_mirrored: bool) {
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
                let is_inverted = is_behind != is_mirrored;
                frame.draw_geom_part(view, projection, part, alpha, is_inverted, list);
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
}
