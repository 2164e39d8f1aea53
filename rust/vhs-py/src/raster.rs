//! `vhs._core.RasterCanvas`: the software renderer for Python.
//!
//! Borrow, check, call, map errors. A canvas keeps handles to the arrays of the simulation it draws, so that a frame
//! costs one call; drawing happens without the interpreter lock.

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]
#![allow(clippy::doc_markdown, reason = "MuJoCo is a name, not code")]

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{PyReadonlyArray2, PyReadonlyArrayDyn, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vhs_raster::{
    Antialias, Camera, Canvas, Error, Geom, Haze, Layout, Lens, Light, LightKind, MeshData, Scene,
    SceneSpec, Shape, Surface, Tessellation, Texture, TextureKind, TextureUse, View,
};

use crate::arrays::bools;
use crate::error::{layout, protocol, raster_to_py as to_py, shape};
use crate::raster_feed::{Feed, Gaze, Handle};

/// The error for an array that has gaps between its rows.
pub(crate) fn gaps(field: &'static str) -> impl Fn(numpy::AsSliceError) -> PyErr {
    move |_| layout(field, "a C-contiguous array", "one with strides")
}

/// Rows of `N` numbers from an array whose last axis has that length.
fn rows<T: numpy::Element + Copy, const N: usize>(
    field: &'static str,
    array: &PyReadonlyArray2<'_, T>,
) -> PyResult<Vec<[T; N]>> {
    let (rows, rest) = array.as_slice().map_err(gaps(field))?.as_chunks::<N>();
    if array.shape()[1] != N || !rest.is_empty() {
        return Err(shape(field, &format!("[n, {N}]"), array.shape()));
    }
    Ok(rows.to_vec())
}

/// Indices as MuJoCo stores them: i32, never negative here.
fn indices(field: &'static str, array: &PyReadonlyArray2<'_, i32>) -> PyResult<Vec<[u32; 3]>> {
    let corners = rows::<i32, 3>(field, array)?;
    if let Some(negative) = corners.iter().flatten().find(|&&i| i < 0) {
        return Err(to_py(Error::Range {
            what: field,
            expected: "indices of at least 0",
            got: negative.to_string(),
        }));
    }
    Ok(corners.iter().map(|c| c.map(i32::cast_unsigned)).collect())
}

/// `None` for -1, the index otherwise.
fn optional(index: i32) -> Option<usize> {
    usize::try_from(index).ok()
}

#[doc = stub!("RasterScene")]
// A scene while it is being collected, then ready to be drawn.
#[pyclass(module = "vhs._core", frozen)]
pub struct RasterScene {
    spec: Mutex<SceneSpec>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic while drawing leaves stale pixels, which the next frame overwrites.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl RasterScene {
    #[new]
    fn new(slices: usize, stacks: usize, quads: usize, far: f64) -> Self {
        let tessellation = Tessellation {
            slices,
            stacks,
            quads,
        };
        Self {
            spec: Mutex::new(SceneSpec {
                tessellation,
                far,
                ..SceneSpec::default()
            }),
        }
    }

    #[doc = stub!("RasterScene.add_texture")]
    fn add_texture(&self, is_cube: bool, data: PyReadonlyArrayDyn<'_, u8>) -> PyResult<usize> {
        let &[height, width, channels] = data.shape() else {
            return Err(shape("texture", "[height, width, channels]", data.shape()));
        };
        let kind = if is_cube {
            TextureKind::Cube
        } else {
            TextureKind::Flat
        };
        let texture = Texture::new(
            kind,
            width,
            height,
            channels,
            data.as_slice().map_err(gaps("texture"))?,
        )
        .map_err(to_py)?;
        let mut spec = lock(&self.spec);
        spec.textures.push(texture);
        Ok(spec.textures.len() - 1)
    }

    #[doc = stub!("RasterScene.add_mesh")]
    fn add_mesh(
        &self,
        vertices: PyReadonlyArray2<'_, f32>,
        normals: PyReadonlyArray2<'_, f32>,
        uv: PyReadonlyArray2<'_, f32>,
        faces: PyReadonlyArray2<'_, i32>,
        face_normals: PyReadonlyArray2<'_, i32>,
        face_uv: PyReadonlyArray2<'_, i32>,
    ) -> PyResult<usize> {
        let mesh = MeshData {
            vertices: rows("vertices", &vertices)?,
            normals: rows("normals", &normals)?,
            uv: rows("uv", &uv)?,
            faces: indices("faces", &faces)?,
            face_normals: indices("face_normals", &face_normals)?,
            face_uv: indices("face_uv", &face_uv)?,
        };
        let mut spec = lock(&self.spec);
        spec.meshes.push(mesh);
        Ok(spec.meshes.len() - 1)
    }

    #[doc = stub!("RasterScene.add_geom")]
    #[allow(
        clippy::too_many_arguments,
        reason = "one keyword a field, called from one place"
    )]
    #[pyo3(signature = (*, kind, size, mesh, rgba, gloss, is_mirror, texture, repeat, is_uniform, tag))]
    fn add_geom(
        &self,
        kind: i32,
        size: [f64; 3],
        mesh: i32,
        rgba: [f32; 4],
        gloss: [f32; 3],
        is_mirror: bool,
        texture: i32,
        repeat: [f32; 2],
        is_uniform: bool,
        tag: [i32; 2],
    ) -> PyResult<()> {
        let texture = optional(texture).map(|texture| TextureUse {
            texture,
            repeat,
            uniform: is_uniform,
        });
        let [emission, specular, shininess] = gloss;
        let surface = Surface {
            rgba,
            emission,
            specular,
            shininess,
            is_mirror,
            texture,
        };
        lock(&self.spec).geoms.push(Geom {
            shape: shape_of(kind, size, mesh)?,
            surface,
            tag,
        });
        Ok(())
    }

    #[doc = stub!("RasterScene.add_light")]
    fn add_light(&self, colours: [[f32; 3]; 3], spot: Option<[f32; 5]>, is_headlight: bool) {
        let [ambient, diffuse, specular] = colours;
        let kind = spot.map_or(LightKind::Directional, |s| LightKind::Spot {
            attenuation: [s[0], s[1], s[2]],
            exponent: s[3],
            cutoff: s[4],
        });
        lock(&self.spec).lights.push(Light {
            kind,
            ambient,
            diffuse,
            specular,
            is_headlight,
        });
    }

    #[doc = stub!("RasterScene.set_sky")]
    fn set_sky(&self, texture: usize, haze_rgb: [f32; 3], haze_proportion: f32) {
        let mut spec = lock(&self.spec);
        spec.sky = Some(texture);
        spec.haze = Some(Haze {
            rgb: haze_rgb,
            proportion: haze_proportion,
        });
    }
}

/// Shape from MuJoCo's type number (`mjtGeom`) and sizes.
#[expect(clippy::cast_possible_truncation, reason = "pictures are drawn in f32")]
fn shape_of(kind: i32, size: [f64; 3], mesh: i32) -> PyResult<Shape> {
    let small = size.map(|x| x as f32);
    let [radius, half_length, _] = small;
    Ok(match (kind, optional(mesh)) {
        (0, _) => Shape::Plane {
            half_size: [size[0].max(0.0), size[1].max(0.0)],
            spacing: size[2],
        },
        (2, _) => Shape::Sphere { radius },
        (3, _) => Shape::Capsule {
            radius,
            half_length,
        },
        (4, _) => Shape::Ellipsoid { radii: small },
        (5, _) => Shape::Cylinder {
            radius,
            half_length,
        },
        (6, _) => Shape::Box { half_size: small },
        (7 | 8, Some(mesh)) => Shape::Mesh {
            mesh,
            half_size: small,
        },
        _ => {
            return Err(to_py(Error::Unsupported {
                what: format!("geom type {kind}"),
            }));
        }
    })
}

/// What one frame needs besides the scene.
struct State {
    view: View,
    canvas: Canvas,
    feed: Option<Feed>,
    /// For each light of the scene, which light of the simulation it is; `None` for the headlight.
    lights: Vec<Option<usize>>,
}

#[doc = stub!("RasterCanvas")]
// A picture of fixed size that draws one scene.
#[pyclass(module = "vhs._core", frozen)]
pub struct RasterCanvas {
    scene: Scene,
    geoms: usize,
    state: Mutex<State>,
}

#[pymethods]
impl RasterCanvas {
    #[new]
    fn new(
        scene: &RasterScene,
        geoms: usize,
        lights: Vec<i32>,
        height: usize,
        width: usize,
        antialias: u8,
    ) -> PyResult<Self> {
        let scene = Scene::new(lock(&scene.spec).clone()).map_err(to_py)?;
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
        let view = View::new(&scene, camera).map_err(to_py)?;
        let lights = lights.into_iter().map(optional).collect();
        Ok(Self {
            scene,
            geoms,
            state: Mutex::new(State {
                view,
                canvas,
                feed: None,
                lights,
            }),
        })
    }

    #[doc = stub!("RasterCanvas.bind")]
    #[allow(
        clippy::too_many_arguments,
        reason = "one array a field, called from one place"
    )]
    fn bind(
        &self,
        geom_xpos: Handle,
        geom_xmat: Handle,
        site_xpos: Handle,
        site_xmat: Handle,
        light_xpos: Handle,
        light_xdir: Handle,
        cam_xpos: Handle,
        cam_xmat: Handle,
    ) {
        let feed = Feed {
            geom_xpos,
            geom_xmat,
            site_xpos,
            site_xmat,
            light_xpos,
            light_xdir,
            cam_xpos,
            cam_xmat,
        };
        lock(&self.state).feed = Some(feed);
    }

    #[doc = stub!("RasterCanvas.set_visible")]
    fn set_visible(&self, is_visible: &Bound<'_, PyAny>) -> PyResult<()> {
        let is_visible = bools("is_visible", is_visible, &[self.scene.geom_count()])?;
        let mut state = lock(&self.state);
        state.view.set_visible(&is_visible).map_err(to_py)
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
        let mut state = lock(&self.state);
        let state = &mut *state;
        let feed = state
            .feed
            .as_ref()
            .ok_or_else(|| protocol("update", "a bound simulation", "none"))?;
        let view = &mut state.view;
        feed.read_poses(py, view, self.geoms)?;
        feed.read_lights(py, view, &state.lights)?;
        let [position, forward, up] = match gaze {
            Some(gaze) => gaze,
            None => feed.gaze_of(py, fixed)?,
        };
        let lens = match lens[..] {
            [fovy] => Lens::Angle { fovy },
            [height, _] => Lens::Parallel { height },
            [bottom, top, left, right] => Lens::Frustum {
                bottom,
                top,
                left,
                right,
            },
            _ => {
                return Err(to_py(Error::Range {
                    what: "lens",
                    expected: "1, 2 or 4 numbers",
                    got: lens.len().to_string(),
                }));
            }
        };
        view.set_camera(Camera {
            position,
            forward,
            up,
            lens,
            near,
            far,
        })
        .map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.draw")]
    fn draw(
        &self,
        py: Python<'_>,
        mut out: PyReadwriteArrayDyn<'_, u8>,
        is_planar: bool,
    ) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        let layout = if is_planar {
            Layout::Planar
        } else {
            Layout::Interleaved
        };
        py.detach(|| {
            let mut state = lock(&self.state);
            let State { view, canvas, .. } = &mut *state;
            canvas.draw(&self.scene, view, layout, out)
        })
        .map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.draw_depth")]
    fn draw_depth(&self, py: Python<'_>, mut out: PyReadwriteArrayDyn<'_, f32>) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        py.detach(|| {
            let mut state = lock(&self.state);
            let State { view, canvas, .. } = &mut *state;
            canvas.draw_depth(&self.scene, view, out)
        })
        .map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.draw_tags")]
    fn draw_tags(&self, py: Python<'_>, mut out: PyReadwriteArrayDyn<'_, i32>) -> PyResult<()> {
        let out = out.as_slice_mut().map_err(gaps("out"))?;
        py.detach(|| {
            let mut state = lock(&self.state);
            let State { view, canvas, .. } = &mut *state;
            canvas.draw_tags(&self.scene, view, out)
        })
        .map_err(to_py)
    }

    #[doc = stub!("RasterCanvas.orbit")]
    #[staticmethod]
    fn orbit(look_at: [f64; 3], distance: f64, azimuth: f64, elevation: f64) -> Gaze {
        Camera::orbit(look_at, distance, azimuth, elevation)
    }
}
