//! Colours for the picture: walks the visible faces row by row and shades them in batches.
//!
//! The inner loops are written once over arrays of [`LANES`] numbers and compiled for every kind of machine that is
//! told apart here; vector units change how many of them are done at once, never what comes out.

use crate::cover::{Cover, LANES, NOTHING, middle};
use crate::shade::{Batch, Ready, Shader, packed};
use crate::texture::{Machine, Plain};

/// One face in one pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fragment {
    pub(crate) face: u32,
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// In how many of the pixel's samples it is seen.
    pub(crate) weight: u8,
}

/// The picture's colours, one a pixel: red in the low byte. Rows have [`LANES`] spare places at their end, so that a
/// batch can always be written whole.
#[derive(Debug, Clone)]
pub(crate) struct Colours {
    pub(crate) stride: usize,
    pub(crate) pixels: Vec<u32>,
}

impl Colours {
    pub(crate) fn new(height: usize, width: usize) -> Self {
        let stride = width + LANES;
        Self { stride, pixels: vec![0; stride * height] }
    }
}

/// What this machine can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Kind {
    /// The best kind that this machine is.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self::Avx2;
        }
        Self::Plain
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
    pub(crate) drawn: &'a [crate::cover::Drawn],
    /// For each drawn face its place in `ready`, or [`NOTHING`].
    pub(crate) ready_at: &'a mut Vec<u32>,
    pub(crate) ready: &'a mut Vec<Ready>,
    /// Faces in pixels that show several of them.
    pub(crate) edges: &'a mut Vec<Fragment>,
}

/// Does a job with the instructions of a kind of machine.
pub(crate) fn run(kind: Kind, fill: &mut Fill<'_>, job: &Job<'_>) {
    fill.ready_at.resize(fill.drawn.len(), NOTHING);
    match kind {
        Kind::Plain => fill.run::<Plain>(job),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Kind::Avx2` is only made by `detect`, after it found AVX2.
        Kind::Avx2 => unsafe { run_avx2(fill, job) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2(fill: &mut Fill<'_>, job: &Job<'_>) {
    fill.run::<crate::texture::Avx2>(job);
}

impl Fill<'_> {
    #[inline(always)]
    fn run<M: Machine>(&mut self, job: &Job<'_>) {
        match job {
            Job::Visible if self.cover.offsets.len() == 1 => self.single::<M>(),
            Job::Visible => self.several::<M>(),
            Job::Over(fragments) => self.over::<M>(fragments),
        }
    }

    /// The prepared form of a face.
    #[inline(always)]
    fn ready(&mut self, face: u32) -> Ready {
        let slot = &mut self.ready_at[face as usize];
        if *slot == NOTHING {
            *slot = u32::try_from(self.ready.len()).unwrap_or(NOTHING);
            self.ready.push(self.shader.ready(&self.drawn[face as usize]));
        }
        self.ready[*slot as usize]
    }

    /// Colours pixels with one sample each.
    #[inline(always)]
    fn single<M: Machine>(&mut self) {
        let cover = self.cover;
        for y in 0..cover.height {
            let faces = &cover.face[y * cover.stride..y * cover.stride + cover.width];
            let mut x = 0;
            while x < faces.len() {
                let face = faces[x];
                let end = faces[x..].iter().position(|&f| f != face).map_or(faces.len(), |n| x + n);
                self.span::<M>(face, y, x, end);
                x = end;
            }
        }
    }

    /// Colours pixels with several samples each: whole ones at once, the others by the share of each face.
    #[inline(always)]
    fn several<M: Machine>(&mut self) {
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
                self.span::<M>(face, y, x, end);
                x = end;
            }
        }
        self.edges.sort_unstable_by_key(|f| (f.face, f.y, f.x));
        let edges = std::mem::take(self.edges);
        for f in &edges {
            self.colours.pixels[usize::from(f.y) * self.colours.stride + usize::from(f.x)] = SUM;
        }
        self.share::<M>(&edges);
        for f in &edges {
            let pixel = &mut self.colours.pixels[usize::from(f.y) * self.colours.stride + usize::from(f.x)];
            if *pixel & SUM != 0 {
                let mean = |shift: u32| ((*pixel >> shift & 0x3ff) + 2) >> 2;
                *pixel = mean(0) | mean(10) << 8 | mean(20) << 16;
            }
        }
        *self.edges = edges;
    }

    /// Notes the faces of a pixel that shows several.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "pictures have at most 16384 rows and columns")]
    fn push_edge(&mut self, faces: [u32; 4], x: usize, y: usize) {
        for (i, &face) in faces.iter().enumerate() {
            if !faces[..i].contains(&face) {
                let weight = faces.iter().filter(|&&f| f == face).count() as u8;
                self.edges.push(Fragment { face, x: x as u16, y: y as u16, weight });
            }
        }
    }

    /// Colours pixels `from..to` of a row, which all show one face.
    #[inline(always)]
    fn span<M: Machine>(&mut self, face: u32, y: usize, from: usize, to: usize) {
        let start = y * self.colours.stride;
        if face == NOTHING {
            self.colours.pixels[start + from..start + to].fill(0);
            return;
        }
        let ready = self.ready(face);
        let height = -middle(y, self.cover.height);
        let mut batch = Batch { x: [0.0; LANES], y: [height; LANES] };
        for x in (from..to).step_by(LANES) {
            let first = middle(x, self.cover.width);
            for i in 0..LANES {
                #[expect(clippy::cast_precision_loss, reason = "below eight")]
                let step = i as f32;
                batch.x[i] = first + step;
            }
            let colours = packed(&self.shader.shade::<M>(&ready, &batch));
            // Lanes past the end are overwritten by the next span, or land in the spare places of the row.
            self.colours.pixels[start + x..start + x + LANES].copy_from_slice(&colours);
        }
    }

    /// Adds each fragment to the sum of its pixel; the weights of a pixel add up to four.
    #[inline(always)]
    fn share<M: Machine>(&mut self, fragments: &[Fragment]) {
        for run in fragments.chunk_by(|a, b| a.face == b.face) {
            if run[0].face == NOTHING {
                continue;
            }
            let ready = self.ready(run[0].face);
            for few in run.chunks(LANES) {
                let colours = packed(&self.shader.shade::<M>(&ready, &self.batch(few)));
                for (f, colour) in few.iter().zip(colours) {
                    let at = usize::from(f.y) * self.colours.stride + usize::from(f.x);
                    let lanes = colour & 0xff | (colour & 0xff00) << 2 | (colour & 0x00ff_0000) << 4;
                    self.colours.pixels[at] += lanes * u32::from(f.weight);
                }
            }
        }
    }

    /// Blends fragments over the picture.
    #[inline(always)]
    fn over<M: Machine>(&mut self, fragments: &[Fragment]) {
        #[expect(clippy::cast_precision_loss, reason = "1 or 4")]
        let part = 1.0 / self.cover.offsets.len() as f32;
        for run in fragments.chunk_by(|a, b| a.face == b.face) {
            let ready = self.ready(run[0].face);
            for few in run.chunks(LANES) {
                let shades = self.shader.shade::<M>(&ready, &self.batch(few));
                for (i, f) in few.iter().enumerate() {
                    let pixel = &mut self.colours.pixels[usize::from(f.y) * self.colours.stride + usize::from(f.x)];
                    let alpha = shades[3][i] * f32::from(f.weight) * part;
                    let below = pixel.to_le_bytes();
                    let mixed = [0, 1, 2].map(|k| {
                        let value = shades[k][i] * alpha * 255.0 + f32::from(below[k]) * (1.0 - alpha);
                        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
                        let byte = (value + 0.5) as u8;
                        byte
                    });
                    *pixel = u32::from_le_bytes([mixed[0], mixed[1], mixed[2], 0]);
                }
            }
        }
    }

    #[inline(always)]
    fn batch(&self, few: &[Fragment]) -> Batch {
        let mut batch = Batch { x: [0.0; LANES], y: [0.0; LANES] };
        for i in 0..LANES {
            let f = &few[i.min(few.len() - 1)];
            batch.x[i] = middle(usize::from(f.x), self.cover.width);
            batch.y[i] = -middle(usize::from(f.y), self.cover.height);
        }
        batch
    }
}
