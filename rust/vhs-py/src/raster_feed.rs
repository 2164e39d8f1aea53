//! What a canvas reads of a simulation at every update: exact poses and cameras, from the arrays it was bound to.

use numpy::PyArrayMethods;
use pyo3::prelude::*;
use vhs_raster::Error;

use crate::error::{raster_to_py as to_py, shape};
use crate::raster_arrays::gaps;

/// Where a camera is: position, gaze and up vector.
pub(crate) type Gaze = [[f64; 3]; 3];

/// An array of the simulation, kept alive.
pub(crate) type Handle = Py<numpy::PyArrayDyn<f64>>;

/// Object types that have poses here (`mjtObj`).
const OBJECT_GEOM: i32 = 5;
const OBJECT_SITE: i32 = 6;

/// Positions [n, 3] and rotations [n, 9] of geoms and sites at the last update.
#[derive(Default)]
pub(crate) struct Poses {
    geoms: [Vec<f64>; 2],
    sites: [Vec<f64>; 2],
}

impl Poses {
    /// Position and rotation of an object, number and type, if it has them.
    pub(crate) fn of(&self, [number, kind]: [i32; 2]) -> Option<([f64; 3], [f64; 9])> {
        let [positions, rotations] = match kind {
            OBJECT_GEOM => &self.geoms,
            OBJECT_SITE => &self.sites,
            _ => return None,
        };
        let number = usize::try_from(number).ok()?;
        let position = *positions.as_chunks::<3>().0.get(number)?;
        Some((position, *rotations.as_chunks::<9>().0.get(number)?))
    }
}

/// Arrays of one simulation, read at every update.
pub(crate) struct Feed {
    pub(crate) geom_xpos: Handle,
    pub(crate) geom_xmat: Handle,
    pub(crate) site_xpos: Handle,
    pub(crate) site_xmat: Handle,
    pub(crate) cam_xpos: Handle,
    pub(crate) cam_xmat: Handle,
}

impl Feed {
    /// Copies where geoms and sites are now.
    ///
    /// # Errors
    /// `NonFiniteError` for NaN or infinity, `ShapeError` for arrays that do not fit together; then nothing changes.
    pub(crate) fn read_poses(&self, py: Python<'_>, poses: &mut Poses) -> PyResult<()> {
        let geom = [&self.geom_xpos, &self.geom_xmat].map(|array| array.bind(py).readonly());
        let site = [&self.site_xpos, &self.site_xmat].map(|array| array.bind(py).readonly());
        let [geom_at, geom_turned] = &geom;
        let [site_at, site_turned] = &site;
        let slice = |array| numpy::PyReadonlyArrayDyn::as_slice(array).map_err(gaps("pose"));
        let geom = [slice(geom_at)?, slice(geom_turned)?];
        let site = [slice(site_at)?, slice(site_turned)?];
        check("pose of geom", geom)?;
        check("pose of site", site)?;
        for (to, from) in poses.geoms.iter_mut().zip(geom) {
            from.clone_into(to);
        }
        for (to, from) in poses.sites.iter_mut().zip(site) {
            from.clone_into(to);
        }
        Ok(())
    }

    /// Where one of its cameras is now.
    pub(crate) fn gaze_of(&self, py: Python<'_>, camera: i64) -> PyResult<Gaze> {
        let camera = usize::try_from(camera).map_err(|_| {
            to_py(Error::Range {
                what: "camera",
                expected: "a number of at least 0, or a gaze",
                got: camera.to_string(),
            })
        })?;
        let (position, rotation) = (
            self.cam_xpos.bind(py).readonly(),
            self.cam_xmat.bind(py).readonly(),
        );
        let position = three(position.as_slice().map_err(gaps("position"))?, camera)?;
        let rotation = rotation.as_slice().map_err(gaps("rotation"))?;
        let [x, y, z] = [
            three(rotation, 3 * camera)?,
            three(rotation, 3 * camera + 1)?,
            three(rotation, 3 * camera + 2)?,
        ];
        Ok([position, [-x[2], -y[2], -z[2]], [x[1], y[1], z[1]]])
    }
}

/// Refuses poses that are nowhere.
fn check(what: &'static str, [positions, rotations]: [&[f64]; 2]) -> PyResult<()> {
    let n = positions.len() / 3;
    if positions.len() != 3 * n || rotations.len() != 9 * n {
        let found = [positions.len(), rotations.len()];
        return Err(shape(what, "[n, 3] and [n, 9]", &found));
    }
    // A product with 0 is 0 for finite numbers only, and adding up needs no branch per number.
    let all = positions.iter().chain(rotations);
    if all.map(|x| x * 0.0).sum::<f64>() == 0.0 {
        return Ok(());
    }
    let is_bad = |i: &usize| {
        let mut own = positions[3 * i..3 * i + 3]
            .iter()
            .chain(&rotations[9 * i..9 * i + 9]);
        own.any(|x| !x.is_finite())
    };
    let index = (0..n).find(is_bad).unwrap_or(0);
    Err(to_py(Error::NotFinite { what, index }))
}

/// Row `index` of an array with three columns.
fn three(values: &[f64], index: usize) -> PyResult<[f64; 3]> {
    let rows = values.as_chunks::<3>().0;
    rows.get(index).copied().ok_or_else(|| {
        to_py(Error::Index {
            what: "row of the simulation",
            index,
            len: rows.len(),
        })
    })
}
