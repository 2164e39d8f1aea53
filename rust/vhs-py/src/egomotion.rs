//! `vhs.egomotion`.

use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vhs_base::check::check_shape;
use vhs_core::egomotion::{self as core, Walks};

use crate::arrays::{bools, checked, integer_array, integer_vec, into_array, reals, slice};

type Floats<'py> = Bound<'py, PyArrayDyn<f32>>;

#[doc = stub!("egomotion")]
#[pyfunction]
#[pyo3(signature = (actions, blocked, lengths, moves, *, ahead_m=0.0))]
pub(crate) fn egomotion<'py>(
    py: Python<'py>,
    actions: &Bound<'py, PyAny>,
    blocked: &Bound<'py, PyAny>,
    lengths: &Bound<'py, PyAny>,
    moves: &Bound<'py, PyAny>,
    ahead_m: f64,
) -> PyResult<(Floats<'py>, Floats<'py>)> {
    let (actions, lengths) = (
        integer_array("actions", actions)?,
        integer_vec("lengths", lengths)?,
    );
    let longest = actions.shape().get(1).copied().unwrap_or(1);
    let shape = [lengths.len(), longest];
    checked(check_shape("actions", &shape, actions.shape()))?;
    let (blocked, moves) = (bools("blocked", blocked, &shape)?, reals("moves", moves)?);
    checked(check_shape(
        "moves",
        &[moves.shape().first().copied().unwrap_or(1), 3],
        moves.shape(),
    ))?;
    let (actions, moves) = (slice(&actions), slice(&moves));
    let walks = Walks {
        actions,
        blocked: &blocked,
        lengths: &lengths,
        longest,
    };
    let found = checked(py.detach(|| core::egomotion(walks, moves, ahead_m)))?;
    Ok((
        into_array(py, found.bearing_rad, &shape)?,
        into_array(py, found.distance_m, &shape)?,
    ))
}
