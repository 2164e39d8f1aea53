//! `vhs.discounted_returns`.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use vhs_core::error::check_shape;
use vhs_core::returns as core;

use crate::arrays::{checked, exclusive, integer_vec, into_array, reals, slice};

/// Monte-Carlo returns of padded episodes; see the stub for its documentation.
#[pyfunction]
#[pyo3(signature = (rewards, lengths, gamma, *, out=None))]
pub(crate) fn discounted_returns<'py>(
    py: Python<'py>,
    rewards: &Bound<'py, PyAny>,
    lengths: &Bound<'py, PyAny>,
    gamma: f64,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (rewards, lengths) = (reals("rewards", rewards)?, integer_vec("lengths", lengths)?);
    let longest = rewards.shape().get(1).copied().unwrap_or(1);
    let shape = [lengths.len(), longest];
    checked(check_shape("rewards", &shape, rewards.shape()))?;
    let rewards = slice(&rewards);
    let Some(out) = out else {
        let returns =
            checked(py.detach(|| core::discounted_returns(rewards, longest, &lengths, gamma)))?;
        return Ok(into_array(py, returns, &shape)?.into_any());
    };
    let mut returns = exclusive::<f32>(out, &shape)?;
    let returns = returns.as_slice_mut()?;
    checked(
        py.detach(|| core::discounted_returns_into(rewards, longest, &lengths, gamma, returns)),
    )?;
    Ok(out.clone())
}
