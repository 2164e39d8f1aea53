//! `vhs._core.RasterSource`: where a renderer finds what MuJoCo wants to have drawn, anew at every frame.

#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]
#![allow(clippy::doc_markdown, reason = "MuJoCo is a name, not code")]

use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vhs_raster::{Effects, Error, Geom, Light};

use crate::error::{raster_to_py as to_py, shape};
use crate::raster_arrays::gaps;
use crate::raster_feed::Poses;
use crate::raster_records::{
    Context, GEOM_FIELDS, LIGHT_FIELDS, Places, Softs, read_geoms, read_lights,
};

/// Flags of `mjvScene` by number (`mjtRndFlag`).
const FLAG_SHADOW: usize = 0;
const FLAG_WIREFRAME: usize = 1;
const FLAG_REFLECTION: usize = 2;
const FLAG_ADDITIVE: usize = 3;
const FLAG_SKYBOX: usize = 4;
const FLAG_FOG: usize = 5;
const FLAG_HAZE: usize = 6;
const FLAG_SEGMENT: usize = 8;
const FLAG_CULL_FACE: usize = 10;

/// Column of `mat_texid` with the texture that gives the colour.
const ROLE_RGB: usize = 1;

/// Records of a list in `mjvScene`: bytes [most, stride], and where in each record the fields lie.
struct Records<const N: usize> {
    bytes: Py<PyArrayDyn<u8>>,
    places: Places<N>,
}

#[doc = stub!("RasterSource")]
#[pyclass(module = "vhs._core", frozen)]
pub(crate) struct RasterSource {
    geoms: Records<GEOM_FIELDS>,
    lights: Records<LIGHT_FIELDS>,
    flags: Py<PyArrayDyn<u8>>,
    geom_size: Py<PyArrayDyn<f64>>,
    mat_texid: Py<PyArrayDyn<i32>>,
    mat_texuniform: Py<PyArrayDyn<u8>>,
    mat_texrepeat: Py<PyArrayDyn<f32>>,
    textures: Vec<Option<usize>>,
    meshes: Vec<[usize; 2]>,
    line_width: f32,
}

#[pymethods]
impl RasterSource {
    #[new]
    #[allow(
        clippy::too_many_arguments,
        clippy::large_types_passed_by_value,
        reason = "one keyword a field, called from one place"
    )]
    #[pyo3(signature = (*, geoms, geom_places, lights, light_places, flags, geom_size, mat_texid, mat_texuniform,
        mat_texrepeat, textures, meshes, line_width))]
    fn new(
        geoms: Py<PyArrayDyn<u8>>,
        geom_places: [Option<usize>; GEOM_FIELDS],
        lights: Py<PyArrayDyn<u8>>,
        light_places: [Option<usize>; LIGHT_FIELDS],
        flags: Py<PyArrayDyn<u8>>,
        geom_size: Py<PyArrayDyn<f64>>,
        mat_texid: Py<PyArrayDyn<i32>>,
        mat_texuniform: Py<PyArrayDyn<u8>>,
        mat_texrepeat: Py<PyArrayDyn<f32>>,
        textures: Vec<Option<usize>>,
        meshes: Vec<[usize; 2]>,
        line_width: f32,
    ) -> Self {
        Self {
            geoms: Records {
                bytes: geoms,
                places: geom_places,
            },
            lights: Records {
                bytes: lights,
                places: light_places,
            },
            flags,
            geom_size,
            mat_texid,
            mat_texuniform,
            mat_texrepeat,
            textures,
            meshes,
            line_width,
        }
    }
}

impl RasterSource {
    /// Appends the first `count` geoms.
    pub(crate) fn read_geoms(
        &self,
        py: Python<'_>,
        count: usize,
        (poses, softs): (&Poses, &Softs),
        is_numbered: bool,
        geoms: &mut Vec<Geom>,
    ) -> PyResult<()> {
        let size = self.geom_size.bind(py).readonly();
        let texid = self.mat_texid.bind(py).readonly();
        let uniform = self.mat_texuniform.bind(py).readonly();
        let repeat = self.mat_texrepeat.bind(py).readonly();
        let roles = texid.shape().get(1).copied().unwrap_or(1).max(1);
        let of_roles = texid.as_slice().map_err(gaps("mat_texid"))?;
        let colours = of_roles.chunks_exact(roles);
        let material_texture: Vec<i32> = colours
            .map(|row| row.get(ROLE_RGB).copied().unwrap_or(-1))
            .collect();
        let context = Context {
            poses,
            geom_size: size.as_slice().map_err(gaps("geom_size"))?,
            material_texture: &material_texture,
            material_uniform: uniform.as_slice().map_err(gaps("mat_texuniform"))?,
            material_repeat: repeat.as_slice().map_err(gaps("mat_texrepeat"))?,
            textures: &self.textures,
            meshes: &self.meshes,
            line_width: self.line_width,
            softs,
            is_numbered,
        };
        let Records { bytes, places } = &self.geoms;
        with_first(py, bytes, count, |records, stride| {
            read_geoms(records, stride, places, &context, geoms).map_err(to_py)
        })
    }

    /// Appends the first `count` lights.
    pub(crate) fn read_lights(
        &self,
        py: Python<'_>,
        count: usize,
        lights: &mut Vec<Light>,
    ) -> PyResult<()> {
        let Records { bytes, places } = &self.lights;
        with_first(py, bytes, count, |records, stride| {
            read_lights(records, stride, places, lights);
            Ok(())
        })
    }

    /// What is switched on, by the flags of the scene.
    pub(crate) fn effects(&self, py: Python<'_>, is_numbered: bool) -> PyResult<Effects> {
        let flags = self.flags.bind(py).readonly();
        let flags = flags.as_slice().map_err(gaps("flags"))?;
        let is_on = |flag: usize| flags.get(flag).is_some_and(|&flag| flag != 0);
        let refused = [
            ("a wireframe", is_on(FLAG_WIREFRAME)),
            ("additive transparency", is_on(FLAG_ADDITIVE)),
            (
                "segmentation by flags (enable_segmentation_rendering() gives it)",
                is_on(FLAG_SEGMENT) && !is_numbered,
            ),
            (
                "faces seen from behind (mjRND_CULL_FACE off)",
                // Older versions of MuJoCo lack this flag and never draw them.
                flags.len() > FLAG_CULL_FACE && !is_on(FLAG_CULL_FACE),
            ),
        ];
        if let Some((what, _)) = refused.into_iter().find(|(_, is_wanted)| *is_wanted) {
            return Err(to_py(Error::Unsupported { what: what.into() }));
        }
        Ok(Effects {
            has_sky: is_on(FLAG_SKYBOX),
            has_haze: is_on(FLAG_HAZE),
            has_shadows: is_on(FLAG_SHADOW),
            has_fog: is_on(FLAG_FOG),
            has_reflections: is_on(FLAG_REFLECTION),
        })
    }
}

/// Hands the first `count` records and the length of each to `read`.
fn with_first<T>(
    py: Python<'_>,
    records: &Py<PyArrayDyn<u8>>,
    count: usize,
    read: impl FnOnce(&[u8], usize) -> PyResult<T>,
) -> PyResult<T> {
    let records = records.bind(py).readonly();
    let &[most, stride] = records.shape() else {
        return Err(shape("records", "[n, bytes]", records.shape()));
    };
    if count > most || stride == 0 {
        return Err(shape(
            "records",
            &format!("[{count}, bytes]"),
            records.shape(),
        ));
    }
    let bytes = records.as_slice().map_err(gaps("records"))?;
    read(&bytes[..count * stride], stride)
}
