//! `vhs._core.RasterScene`: textures, meshes and height fields on their way from a model to the renderer.

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use numpy::{PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vhs_raster::{
    Fog, Haze, HeightField, MeshData, Scene, SceneSpec, Shadows, Tessellation, Texture, TextureKind,
};

use crate::error::{raster_to_py as to_py, shape};
use crate::raster_arrays::{gaps, indices, rows};

#[doc = stub!("RasterScene")]
// A scene while it is being collected.
#[pyclass(module = "vhs._core", frozen)]
pub(crate) struct RasterScene {
    collected: Mutex<Collected>,
}

struct Collected {
    spec: SceneSpec,
    /// The scene of `spec`, once it was asked for.
    scene: Option<Arc<Scene>>,
}

impl RasterScene {
    fn lock(&self) -> MutexGuard<'_, Collected> {
        self.collected
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes what was collected; canvases that have the scene keep it as it was.
    fn change<T>(&self, change: impl FnOnce(&mut SceneSpec) -> T) -> T {
        let mut collected = self.lock();
        collected.scene = None;
        change(&mut collected.spec)
    }

    /// The scene as it is now, checked and cut; the same for all until something is added.
    pub(crate) fn finished(&self) -> PyResult<Arc<Scene>> {
        let mut collected = self.lock();
        if let Some(scene) = &collected.scene {
            return Ok(scene.clone());
        }
        let scene = Arc::new(Scene::new(collected.spec.clone()).map_err(to_py)?);
        collected.scene = Some(scene.clone());
        Ok(scene)
    }
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
        let spec = SceneSpec {
            tessellation,
            far,
            ..SceneSpec::default()
        };
        Self {
            collected: Mutex::new(Collected { spec, scene: None }),
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
        let bytes = data.as_slice().map_err(gaps("texture"))?;
        let texture = Texture::new(kind, width, height, channels, bytes).map_err(to_py)?;
        Ok(self.change(|spec| {
            spec.textures.push(texture);
            spec.textures.len() - 1
        }))
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
        Ok(self.change(|spec| {
            spec.meshes.push(mesh);
            spec.meshes.len() - 1
        }))
    }

    #[doc = stub!("RasterScene.add_height_field")]
    fn add_height_field(
        &self,
        size: [f32; 4],
        heights: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<usize> {
        let field = HeightField {
            rows: heights.shape()[0],
            columns: heights.shape()[1],
            size,
            heights: heights.as_slice().map_err(gaps("heights"))?.to_vec(),
        };
        Ok(self.change(|spec| {
            spec.height_fields.push(field);
            spec.height_fields.len() - 1
        }))
    }

    #[doc = stub!("RasterScene.set_shadows")]
    fn set_shadows(&self, size: usize, clip: f32, scale: f32) {
        self.change(|spec| spec.shadows = Shadows { size, clip, scale });
    }

    #[doc = stub!("RasterScene.set_fog")]
    fn set_fog(&self, rgb: [f32; 3], start: f32, end: f32) {
        self.change(|spec| spec.fog = Some(Fog { rgb, start, end }));
    }

    #[doc = stub!("RasterScene.set_sky")]
    fn set_sky(&self, texture: usize, haze_rgb: [f32; 3], haze_proportion: f32) {
        let haze = Haze {
            rgb: haze_rgb,
            proportion: haze_proportion,
        };
        self.change(|spec| (spec.sky, spec.haze) = (Some(texture), Some(haze)));
    }
}
