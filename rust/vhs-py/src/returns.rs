//! `vhs.discounted_returns`.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use vhs_base::check::check_shape;
use vhs_core::returns as core;

use crate::arrays::{checked, filled, integer_vec, reals, slice};

#[doc = stub!("discounted_returns")]
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
    let fresh = || {
        let returns = py.detach(|| core::discounted_returns(rewards, longest, &lengths, gamma));
        Ok((checked(returns)?, ()))
    };
    let into = |out: &mut [f32]| {
        checked(py.detach(|| core::discounted_returns_into(rewards, longest, &lengths, gamma, out)))
    };
    Ok(filled(py, out, &shape, fresh, into)?.0)
}
