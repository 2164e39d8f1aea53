//! `vhs._core.RasterScene`: textures, meshes and height fields on their way from a model to the renderer.

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]

use std::sync::{Mutex, MutexGuard, PoisonError};

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
pub struct RasterScene {
    spec: Mutex<SceneSpec>,
}

impl RasterScene {
    fn lock(&self) -> MutexGuard<'_, SceneSpec> {
        self.spec.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The scene as it is now, checked and cut.
    pub(crate) fn finished(&self) -> PyResult<Scene> {
        Scene::new(self.lock().clone()).map_err(to_py)
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
        let bytes = data.as_slice().map_err(gaps("texture"))?;
        let texture = Texture::new(kind, width, height, channels, bytes).map_err(to_py)?;
        let mut spec = self.lock();
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
        let mut spec = self.lock();
        spec.meshes.push(mesh);
        Ok(spec.meshes.len() - 1)
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
        let mut spec = self.lock();
        spec.height_fields.push(field);
        Ok(spec.height_fields.len() - 1)
    }

    #[doc = stub!("RasterScene.set_shadows")]
    fn set_shadows(&self, size: usize, clip: f32, scale: f32) {
        self.lock().shadows = Shadows { size, clip, scale };
    }

    #[doc = stub!("RasterScene.set_fog")]
    fn set_fog(&self, rgb: [f32; 3], start: f32, end: f32) {
        self.lock().fog = Some(Fog { rgb, start, end });
    }

    #[doc = stub!("RasterScene.set_sky")]
    fn set_sky(&self, texture: usize, haze_rgb: [f32; 3], haze_proportion: f32) {
        let mut spec = self.lock();
        spec.sky = Some(texture);
        spec.haze = Some(Haze {
            rgb: haze_rgb,
            proportion: haze_proportion,
        });
    }
}
