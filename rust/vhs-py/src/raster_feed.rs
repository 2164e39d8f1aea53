//! What a canvas reads of a simulation at every frame: poses, lights and cameras, from the arrays it was bound to.

use numpy::PyArrayMethods;
use pyo3::prelude::*;
use vhs_raster::{Error, View};

use crate::error::raster_to_py as to_py;
use crate::raster::gaps;

/// Where a camera is: position, gaze and up vector.
pub(crate) type Gaze = [[f64; 3]; 3];

/// An array of the simulation, kept alive.
pub(crate) type Handle = Py<numpy::PyArrayDyn<f64>>;

/// Arrays of one simulation, read at every frame.
pub(crate) struct Feed {
    pub(crate) geom_xpos: Handle,
    pub(crate) geom_xmat: Handle,
    pub(crate) site_xpos: Handle,
    pub(crate) site_xmat: Handle,
    pub(crate) light_xpos: Handle,
    pub(crate) light_xdir: Handle,
    pub(crate) cam_xpos: Handle,
    pub(crate) cam_xmat: Handle,
}

impl Feed {
    /// Where geoms and sites are now.
    pub(crate) fn read_poses(&self, py: Python<'_>, view: &mut View, geoms: usize) -> PyResult<()> {
        let (position, rotation) = (
            self.geom_xpos.bind(py).readonly(),
            self.geom_xmat.bind(py).readonly(),
        );
        view.set_poses(
            0,
            position.as_slice().map_err(gaps("position"))?,
            rotation.as_slice().map_err(gaps("rotation"))?,
        )
        .map_err(to_py)?;
        let (position, rotation) = (
            self.site_xpos.bind(py).readonly(),
            self.site_xmat.bind(py).readonly(),
        );
        view.set_poses(
            geoms,
            position.as_slice().map_err(gaps("position"))?,
            rotation.as_slice().map_err(gaps("rotation"))?,
        )
        .map_err(to_py)
    }

    /// Where the lights of the simulation are now.
    pub(crate) fn read_lights(
        &self,
        py: Python<'_>,
        view: &mut View,
        lights: &[Option<usize>],
    ) -> PyResult<()> {
        let (position, direction) = (
            self.light_xpos.bind(py).readonly(),
            self.light_xdir.bind(py).readonly(),
        );
        let (position, direction) = (
            position.as_slice().map_err(gaps("position"))?,
            direction.as_slice().map_err(gaps("direction"))?,
        );
        for (index, light) in lights.iter().enumerate() {
            if let Some(light) = light {
                let (at, towards) = (three(position, *light)?, three(direction, *light)?);
                view.set_light(index, true, at, towards).map_err(to_py)?;
            }
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

/// Row `index` of an array with three columns.
fn three(values: &[f64], index: usize) -> PyResult<[f64; 3]> {
    values
        .as_chunks::<3>()
        .0
        .get(index)
        .copied()
        .ok_or_else(|| {
            to_py(Error::Index {
                what: "row of the simulation",
                index,
                len: values.len() / 3,
            })
        })
}
