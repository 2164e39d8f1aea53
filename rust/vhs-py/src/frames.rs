//! `vhs.stack_channels`.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use vhs_core::item::Item;
use vhs_core::pool::Bytes;
use vhs_core::storage::stacking as core;

use crate::arrays::{checked, exact, slice};
use crate::bytes::filled_bytes;
use crate::error::axes;

#[doc = stub!("stack_channels")]
#[pyfunction]
#[pyo3(signature = (observations, *, out=None))]
pub(crate) fn stack_channels<'py>(
    py: Python<'py>,
    observations: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let observations = exact::<u8>("observations", observations)?;
    let &[count, stack, height, width, colours] = observations.shape() else {
        let expected = "[N, stack, height, width, colours]";
        return Err(axes("observations", expected, observations.shape()));
    };
    // An empty array may have axes whose product overflows; the core refuses that.
    let shape = [count, stack, height.saturating_mul(width), colours];
    let from = slice(&observations);
    let into = |out: &mut [u8]| checked(py.detach(|| core::stack_channels(from, shape, out)));
    let fresh = || {
        let mut bytes = checked(Bytes::take("stack_channels", from.len()))?;
        into(&mut bytes)?;
        Ok((bytes, ()))
    };
    let stacked = [count, height, width, stack.saturating_mul(colours)];
    Ok(filled_bytes(py, out, Item::U8, &stacked, fresh, into)?.0)
}
