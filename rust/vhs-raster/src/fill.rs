//! Colours for the picture: walks the visible faces row by row and has their samples shaded in runs.

use crate::cover::{Cover, Drawn, NOTHING, middle};
use crate::lanes::{FEWEST_LANES, Kind, MOST_LANES};
use crate::paint::{Places, Sample};
use crate::shade::{Ready, Run, Shader, shade_run};

/// One face in one pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fragment {
    pub(crate) face: u32,
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// In how many of the pixel's samples it is seen.
    pub(crate) weight: u8,
}

/// The picture's colours, one a pixel: red in the low byte. Rows have [`MOST_LANES`] spare places at their end, so that a
/// batch can always be written whole.
#[derive(Debug, Clone)]
pub(crate) struct Colours {
    pub(crate) stride: usize,
    pub(crate) pixels: Vec<u32>,
}

impl Colours {
    pub(crate) fn new(height: usize, width: usize) -> Self {
        let stride = width + MOST_LANES;
        Self {
            stride,
            pixels: vec![0; stride * height],
        }
    }

    /// Adds other colours, each channel up to white.
    pub(crate) fn add(&mut self, other: &Self) {
        for (to, from) in self.pixels.iter_mut().zip(&other.pixels) {
            let (a, b) = (to.to_le_bytes(), from.to_le_bytes());
            *to = u32::from_le_bytes([0, 1, 2, 3].map(|k| a[k].saturating_add(b[k])));
        }
    }
}

/// What is to be coloured.
pub(crate) enum Job<'a> {
    /// Every sample that shows a face.
    Visible,
    /// These, blended over what is there, in this order.
    Over(&'a [Fragment]),
}

/// Marks a pixel that holds a sum of four colours in lanes of ten bits.
const SUM: u32 = 1 << 31;

/// One colouring of the picture.
pub(crate) struct Fill<'a> {
    pub(crate) cover: &'a Cover,
    pub(crate) colours: &'a mut Colours,
    pub(crate) shader: Shader<'a>,
    pub(crate) kind: Kind,
    pub(crate) drawn: &'a [Drawn],
    /// For each drawn face its place in `ready`, or [`NOTHING`].
    pub(crate) ready_at: &'a mut Vec<u32>,
    pub(crate) ready: &'a mut Vec<Ready>,
    /// Faces in pixels that show several of them.
    pub(crate) edges: &'a mut Vec<Fragment>,
    pub(crate) scratch: &'a mut Scratch,
    /// Which visible samples stay black, in the order of [`collect`].
    pub(crate) dark: Option<&'a [bool]>,
    /// How many of them have been coloured.
    pub(crate) done: usize,
}

/// Notes all visible samples, in the order in which they are coloured; `edges` are those of the last colouring.
pub(crate) fn collect(
    cover: &Cover,
    drawn: &[Drawn],
    edges: &[Fragment],
    samples: &mut Vec<Sample>,
) {
    samples.clear();
    let (layer, count) = (cover.layer(), cover.offsets.len());
    let mut push = |face: u32, x: usize, y: usize| {
        samples.push(Sample {
            depth: drawn[face as usize].depth,
            at: [middle(x, cover.width), -middle(y, cover.height)],
        });
    };
    for y in 0..cover.height {
        for x in 0..cover.width {
            let at = y * cover.stride + x;
            let face = cover.face[at];
            let is_whole = (1..count).all(|s| cover.face[s * layer + at] == face);
            if is_whole && face != NOTHING {
                push(face, x, y);
            }
        }
    }
    if count > 1 {
        for edge in edges.iter().filter(|edge| edge.face != NOTHING) {
            push(edge.face, edge.x.into(), edge.y.into());
        }
    }
}

/// Blackens colours whose samples are dark, and steps past them.
fn darken(dark: Option<&[bool]>, done: &mut usize, colours: &mut [u32]) {
    if let Some(dark) = dark {
        for (colour, &is_dark) in colours.iter_mut().zip(&dark[*done..]) {
            if is_dark {
                *colour = 0;
            }
        }
        *done += colours.len();
    }
}

/// Reused memory of a run of samples.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scratch {
    x: Vec<f32>,
    y: Vec<f32>,
    opacity: Vec<f32>,
    packed: Vec<u32>,
}

impl Fill<'_> {
    /// Does a job.
    pub(crate) fn run(&mut self, job: &Job<'_>) {
        self.ready_at.resize(self.drawn.len(), NOTHING);
        match job {
            Job::Visible if self.cover.offsets.len() == 1 => self.single(),
            Job::Visible => self.several(),
            Job::Over(fragments) => self.over(fragments),
        }
    }

    /// Number of the prepared form of a face.
    fn ready(&mut self, face: u32) -> usize {
        let slot = &mut self.ready_at[face as usize];
        if *slot == NOTHING {
            *slot = u32::try_from(self.ready.len()).unwrap_or(NOTHING);
            self.ready
                .push(self.shader.ready(&self.drawn[face as usize]));
        }
        *slot as usize
    }

    /// Colours pixels with one sample each.
    fn single(&mut self) {
        let cover = self.cover;
        for y in 0..cover.height {
            let faces = &cover.face[y * cover.stride..y * cover.stride + cover.width];
            let mut x = 0;
            while x < faces.len() {
                let face = faces[x];
                let end = faces[x..]
                    .iter()
                    .position(|&f| f != face)
                    .map_or(faces.len(), |n| x + n);
                self.span(face, y, x, end);
                x = end;
            }
        }
    }

    /// Colours pixels with several samples each: whole ones at once, the others by the share of each face.
    fn several(&mut self) {
        let cover = self.cover;
        let (layer, samples) = (cover.layer(), cover.offsets.len());
        self.edges.clear();
        for y in 0..cover.height {
            let start = y * cover.stride;
            let rows: [&[u32]; 4] = [0, 1, 2, 3].map(|s| {
                let from = (s % samples) * layer + start;
                &cover.face[from..from + cover.width]
            });
            let whole = |x: usize| {
                let face = rows[0][x];
                (rows[1][x] == face && rows[2][x] == face && rows[3][x] == face).then_some(face)
            };
            let mut x = 0;
            while x < cover.width {
                let Some(face) = whole(x) else {
                    self.push_edge(rows.map(|row| row[x]), x, y);
                    x += 1;
                    continue;
                };
                let mut end = x + 1;
                while end < cover.width && whole(end) == Some(face) {
                    end += 1;
                }
                self.span(face, y, x, end);
                x = end;
            }
        }
        self.edges.sort_unstable_by_key(|f| (f.face, f.y, f.x));
        let edges = std::mem::take(self.edges);
        for f in &edges {
            self.colours.pixels[usize::from(f.y) * self.colours.stride + usize::from(f.x)] = SUM;
        }
        self.share(&edges);
        for f in &edges {
            let pixel =
                &mut self.colours.pixels[usize::from(f.y) * self.colours.stride + usize::from(f.x)];
            if *pixel & SUM != 0 {
                let mean = |shift: u32| ((*pixel >> shift & 0x3ff) + 2) >> 2;
                *pixel = mean(0) | mean(10) << 8 | mean(20) << 16;
            }
        }
        *self.edges = edges;
    }

    /// Notes the faces of a pixel that shows several.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "pictures have at most 16384 rows and columns"
    )]
    fn push_edge(&mut self, faces: [u32; 4], x: usize, y: usize) {
        for (i, &face) in faces.iter().enumerate() {
            if !faces[..i].contains(&face) {
                let weight = faces.iter().filter(|&&f| f == face).count() as u8;
                self.edges.push(Fragment {
                    face,
                    x: x as u16,
                    y: y as u16,
                    weight,
                });
            }
        }
    }

    /// Colours pixels `from..to` of a row, which all show one face.
    fn span(&mut self, face: u32, y: usize, from: usize, to: usize) {
        let start = y * self.colours.stride;
        if face == NOTHING {
            self.colours.pixels[start + from..start + to].fill(0);
            return;
        }
        let ready = self.ready(face);
        let places = Places::Row {
            x: middle(from, self.cover.width),
            y: -middle(y, self.cover.height),
        };
        // Samples past the end are overwritten by the next span, or land in the spare places of the row.
        let len = (to - from).next_multiple_of(FEWEST_LANES);
        let colours = &mut self.colours.pixels[start + from..start + from + len];
        let mut run = Run {
            places,
            colours,
            opacity: None,
        };
        shade_run(self.kind, &mut self.shader, &self.ready[ready], &mut run);
        let own = &mut self.colours.pixels[start + from..start + to];
        darken(self.dark, &mut self.done, own);
    }

    /// Shades fragments of one face into `scratch`.
    fn shade_fragments(&mut self, run: &[Fragment]) {
        let ready = self.ready(run[0].face);
        let Scratch {
            x,
            y,
            opacity,
            packed,
        } = &mut *self.scratch;
        let len = run.len().next_multiple_of(FEWEST_LANES);
        x.clear();
        y.clear();
        x.extend(
            run.iter()
                .map(|f| middle(usize::from(f.x), self.cover.width)),
        );
        y.extend(
            run.iter()
                .map(|f| -middle(usize::from(f.y), self.cover.height)),
        );
        x.resize(len, x[0]);
        y.resize(len, y[0]);
        packed.resize(len, 0);
        opacity.resize(len, 0.0);
        let mut run = Run {
            places: Places::Anywhere { x, y },
            colours: packed,
            opacity: Some(opacity),
        };
        shade_run(self.kind, &mut self.shader, &self.ready[ready], &mut run);
    }

    /// Adds each fragment to the sum of its pixel; the weights of a pixel add up to four.
    fn share(&mut self, fragments: &[Fragment]) {
        for run in fragments.chunk_by(|a, b| a.face == b.face) {
            if run[0].face == NOTHING {
                continue;
            }
            self.shade_fragments(run);
            let own = &mut self.scratch.packed[..run.len()];
            darken(self.dark, &mut self.done, own);
            for (f, colour) in run.iter().zip(&self.scratch.packed) {
                let at = usize::from(f.y) * self.colours.stride + usize::from(f.x);
                let lanes = colour & 0xff | (colour & 0xff00) << 2 | (colour & 0x00ff_0000) << 4;
                self.colours.pixels[at] += lanes * u32::from(f.weight);
            }
        }
    }

    /// Blends fragments over the picture.
    fn over(&mut self, fragments: &[Fragment]) {
        #[expect(clippy::cast_precision_loss, reason = "1 or 4")]
        let part = 1.0 / self.cover.offsets.len() as f32;
        for run in fragments.chunk_by(|a, b| a.face == b.face) {
            self.shade_fragments(run);
            for (i, f) in run.iter().enumerate() {
                let pixel = &mut self.colours.pixels
                    [usize::from(f.y) * self.colours.stride + usize::from(f.x)];
                let alpha = self.scratch.opacity[i] * f32::from(f.weight) * part;
                let (above, below) = (self.scratch.packed[i].to_le_bytes(), pixel.to_le_bytes());
                let mixed = [0, 1, 2].map(|k| {
                    let value = f32::from(above[k]) * alpha + f32::from(below[k]) * (1.0 - alpha);
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "saturates"
                    )]
                    let byte = (value + 0.5) as u8;
                    byte
                });
                *pixel = u32::from_le_bytes([mixed[0], mixed[1], mixed[2], 0]);
            }
        }
    }
}
