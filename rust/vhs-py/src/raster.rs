//! `vhs._core.RasterCanvas`: the software renderer for Python.
//!
//! Borrow, check, call, map errors. A canvas keeps handles to the arrays of the simulation it draws, so that a frame
//! costs few calls; drawing happens without the interpreter lock.

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]
#![allow(clippy::doc_markdown, reason = "MuJoCo is a name, not code")]

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{PyReadonlyArray2, PyReadwriteArrayDyn};
use pyo3::prelude::*;
use vhs_raster::{
    Antialias, Camera, Canvas, Error, Geom, Layout, Lens, Light, Result, Soft, View, draw_all,
};

use crate::error::{protocol, raster_to_py as to_py};
use crate::raster_arrays::{gaps, indices, rows};
use crate::raster_feed::{Feed, Gaze, Handle, Poses};
use crate::raster_records::{Flex, Softs};
use crate::raster_scene::RasterScene;
use crate::raster_source::RasterSource;

/// Most threads of one call; each has a canvas of its own.
const MOST_THREADS: usize = 256;

/// What one frame needs besides the scene.
struct State {
    view: View,
    canvas: Canvas,
    feed: Option<Feed>,
    poses: Poses,
    softs: Softs,
    geoms: Vec<Geom>,
    lights: Vec<Light>,
    /// Canvases of threads.
    helpers: Vec<Canvas>,
}

/// What ends a batch early.
struct Failure(PyErr);

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self(to_py(error))
    }
}

/// Vertices, normals, texture coordinates and faces of a surface that bends.
type Surface<'py> = (
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, i32>,
);

/// Surface, balls, and ends of tubes of a flexible body.
type FlexParts<'py> = (
    Option<usize>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray2<'py, f32>,
);

#[doc = stub!("RasterCanvas")]
// A picture of fixed size that draws one scene.
#[pyclass(module = "vhs._core", frozen)]
pub(crate) struct RasterCanvas {
    source: Py<RasterSource>,
    state: Mutex<State>,
    antialias: Antialias,
}

impl RasterCanvas {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic while drawing leaves stale pixels, which the next frame overwrites.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws what `prepare(0)`, `prepare(1)`, ... have this canvas read, on some threads without the interpreter lock.
    fn drawn_together<T: Send>(
        &self,
        (count, prepare): (usize, &Bound<'_, PyAny>),
        threads: usize,
        out: &mut [T],
        draw: impl Fn(&mut Canvas, &View, &mut [T]) -> Result<()> + Sync,
    ) -> PyResult<()> {
        let mut helpers = std::mem::take(&mut self.lock().helpers);
        let (height, width) = self.lock().canvas.size();
        let threads = threads.clamp(1, MOST_THREADS);
        while helpers.len() < threads {
            helpers.push(Canvas::new(height, width, self.antialias).map_err(to_py)?);
        }
        let view = |number| {
            prepare.call1((number,))?;
            Ok(self.lock().view.clone())
        };
        let detached = |work: &mut (dyn FnMut() + Send)| prepare.py().detach(work);
        let draw = |canvas: &mut Canvas, view: &View, out: &mut [T]| Ok(draw(canvas, view, out)?);
        let result = draw_all(&mut helpers[..threads], (count, out), view, detached, draw);
        self.lock().helpers = helpers;
        result.map_err(|Failure(error)| error)
    }

    /// Draws without the interpreter lock.
    fn drawn(
        &self,
        py: Python<'_>,
        draw: impl FnOnce(&mut Canvas, &View) -> Result<()> + Send,
    ) -> PyResult<()> {
        py.detach(|| {
            let mut state = self.lock();
            let State { view, canvas, .. } = &mut *state;
            draw(canvas, view)
        })
        .map_err(to_py)
    }
}

#[pymethods]
impl RasterCanvas {
    #[new]
    fn new(
        scene: &RasterScene,
        source: Py<RasterSource>,
        height: usize,
        width: usize,
        antialias: u8,
    ) -> PyResult<Self> {
        let scene = scene.finished()?;
        let antialias = match antialias {
            0 => Antialias::Off,
            1 => Antialias::Multisample,
            _ => Antialias::Supersample,
        };
        let canvas = Canvas::new(height, width, antialias).map_err(to_py)?;
        let camera = Camera {
            position: [0.0; 3],
            forward: [1.0, 0.0, 0.0],
            up: [0.0, 0.0, 1.0],
            lens: Lens::Angle { fovy: 45.0 },
            near: 0.01,
            far: 100.0,
        };
        let state = State {
            view: View::new(scene, camera).map_err(to_py)?,
            canvas,
            feed: None,
            poses: Poses::default(),
            softs: Softs::default(),
            geoms: Vec::new(),
            lights: Vec::new(),
            helpers: Vec::new(),
        };
        Ok(Self {
            source,
            state: Mutex::new(state),
            antialias,
        })
    }

    #[doc = stub!("RasterCanvas.bind")]
    fn bind(
        &self,
        geom_xpos: Handle,
        geom_xmat: Handle,
        site_xpos: Handle,
        site_xmat: Handle,
        cam_xpos: Handle,
        cam_xmat: Handle,
    ) {
        let feed = Feed {
            geom_xpos,
            geom_xmat,
            site_xpos,
            site_xmat,
            cam_xpos,
            cam_xmat,
        };
        self.lock().feed = Some(feed);
    }

    #[doc = stub!("RasterCanvas.update")]
    #[pyo3(signature = (fixed, gaze, lens, near, far))]
    fn update(
        &self,
        py: Python<'_>,
        fixed: i64,
        gaze: Option<Gaze>,
        lens: Vec<f64>,
        near: f32,
        far: f32,
    ) -> PyResult<()> {
        let mut state = self.lock();
        let state = &mut *state;
        let [position, forward, up] = match (gaze, &state.feed) {
            (Some(gaze), _) => gaze,
            (None, Some(feed)) => feed.gaze_of(py, fixed)?,
            (None, None) => return Err(protocol("update", "a bound simulation", "none")),
        };
        if let Some(feed) = &state.feed {
            feed.read_poses(py, &mut state.poses)?;
        }
        let camera = Camera {
            position,
            forward,
            up,
            lens: lens_of(&lens).map_err(to_py)?,
            near,
            far,
        };
        state.view.set_camera(camera).map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.set_softs")]
    fn set_softs(
        &self,
        surfaces: Vec<Surface<'_>>,
        skins: Vec<usize>,
        flexes: Vec<FlexParts<'_>>,
    ) -> PyResult<()> {
        let surface = |(vertices, normals, uv, faces): Surface<'_>| {
            Ok(Soft {
                vertices: rows("vertices", &vertices)?,
                normals: rows("normals", &normals)?,
                uv: rows("uv", &uv)?,
                faces: indices("faces", &faces)?,
            })
        };
        let flex = |(surface, balls, edges): FlexParts<'_>| {
            let ends: Vec<[f32; 6]> = rows("edges", &edges)?;
            Ok(Flex {
                surface,
                balls: rows("balls", &balls)?,
                edges: (ends.iter())
                    .map(|e| [[e[0], e[1], e[2]], [e[3], e[4], e[5]]])
                    .collect(),
            })
        };
        let softs = Softs {
            surfaces: surfaces.into_iter().map(surface).collect::<PyResult<_>>()?,
            skins,
            flexes: flexes.into_iter().map(flex).collect::<PyResult<_>>()?,
        };
        self.lock().softs = softs;
        Ok(())
    }

    #[doc = stub!("RasterCanvas.take")]
    #[pyo3(signature = (geoms, lights, is_numbered = false))]
    fn take(&self, py: Python<'_>, geoms: usize, lights: usize, is_numbered: bool) -> PyResult<()> {
        let source = self.source.get();
        let effects = source.effects(py, is_numbered)?;
        let mut state = self.lock();
        let state = &mut *state;
        state.geoms.clear();
        state.lights.clear();
        let about = (&state.poses, &state.softs);
        source.read_geoms(py, geoms, about, is_numbered, &mut state.geoms)?;
        source.read_lights(py, lights, &mut state.lights)?;
        let view = &mut state.view;
        view.set_effects(effects);
        view.set_lights(&state.lights).map_err(to_py)?;
        let surfaces = &state.softs.surfaces;
        view.set_geoms(&state.geoms, surfaces).map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.draw")]
    fn draw(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArrayDyn<'_, u8>,
        is_planar: bool,
    ) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        let layout = layout_of(is_planar);
        self.drawn(py, |canvas, view| canvas.draw(view, layout, out))
    }

    #[doc = stub!("RasterCanvas.draw_depth")]
    fn draw_depth(&self, py: Python<'_>, mut out: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        self.drawn(py, |canvas, view| canvas.draw_depth(view, out))
    }

    #[doc = stub!("RasterCanvas.draw_tags")]
    fn draw_tags(&self, py: Python<'_>, mut out: PyReadwriteArrayDyn<'_, i32>) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        self.drawn(py, |canvas, view| canvas.draw_tags(view, out))
    }

    #[doc = stub!("RasterCanvas.draw_all")]
    fn draw_all(
        &self,
        count: usize,
        prepare: &Bound<'_, PyAny>,
        mut out: PyReadwriteArrayDyn<'_, u8>,
        is_planar: bool,
        threads: usize,
    ) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        let layout = layout_of(is_planar);
        self.drawn_together((count, prepare), threads, out, |canvas, view, out| {
            canvas.draw(view, layout, out)
        })
    }

    #[doc = stub!("RasterCanvas.draw_all_depth")]
    fn draw_all_depth(
        &self,
        count: usize,
        prepare: &Bound<'_, PyAny>,
        mut out: PyReadwriteArrayDyn<'_, f32>,
        threads: usize,
    ) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        self.drawn_together((count, prepare), threads, out, Canvas::draw_depth)
    }

    #[doc = stub!("RasterCanvas.draw_all_tags")]
    fn draw_all_tags(
        &self,
        count: usize,
        prepare: &Bound<'_, PyAny>,
        mut out: PyReadwriteArrayDyn<'_, i32>,
        threads: usize,
    ) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        self.drawn_together((count, prepare), threads, out, Canvas::draw_tags)
    }

    #[doc = stub!("RasterCanvas.orbit")]
    #[staticmethod]
    fn orbit(look_at: [f64; 3], distance: f64, azimuth: f64, elevation: f64) -> Gaze {
        Camera::orbit(look_at, distance, azimuth, elevation)
    }
}

fn layout_of(is_planar: bool) -> Layout {
    if is_planar {
        Layout::Planar
    } else {
        Layout::Interleaved
    }
}

/// A lens from its numbers: the angle; the height of a parallel one and a 0; or the four sides.
fn lens_of(lens: &[f64]) -> Result<Lens> {
    match *lens {
        [fovy] => Ok(Lens::Angle { fovy }),
        [height, _] => Ok(Lens::Parallel { height }),
        [bottom, top, left, right] => Ok(Lens::Frustum {
            bottom,
            top,
            left,
            right,
        }),
        _ => Err(Error::Range {
            what: "lens",
            expected: "1, 2 or 4 numbers",
            got: lens.len().to_string(),
        }),
    }
}
