//! `vhs.relabel` and the `vhs.Hindsight` it returns.

use std::sync::{Mutex, PoisonError};

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyString;
use vhs_base::error::Error;
use vhs_base::rng::Rng as CoreRng;
use vhs_core::outcome::{Outcome, OutcomeSet};
use vhs_core::relabel as core;

use crate::arrays::{checked, integer, into_array, seed, type_name};
use crate::batch::EpisodeBatch;
use crate::error::{dtype, to_py};
use crate::rng::Rng;

#[doc = stub!("Hindsight")]
#[pyclass(frozen, get_all, module = "vhs._core")]
pub(crate) struct Hindsight {
    #[doc = stub!("Hindsight.selected")]
    selected: Py<PyArrayDyn<bool>>,
    #[doc = stub!("Hindsight.goal_rows")]
    goal_rows: Py<PyArrayDyn<i64>>,
    #[doc = stub!("Hindsight.interactions")]
    interactions: Py<PyArrayDyn<i64>>,
}

impl Hindsight {
    pub(crate) fn from_core(py: Python<'_>, hindsight: core::Hindsight) -> PyResult<Self> {
        let shape = [hindsight.selected.len()];
        Ok(Self {
            selected: into_array(py, hindsight.selected, &shape)?.unbind(),
            goal_rows: into_array(py, hindsight.goal_rows, &shape)?.unbind(),
            interactions: into_array(py, hindsight.interactions, &shape)?.unbind(),
        })
    }
}

#[doc = stub!("relabel")]
// Chooses the episodes of a batch that are relabelled, and their new goals.
#[pyfunction]
#[pyo3(signature = (batch, *, rng, strategy="final", on=None, probability=0.8))]
pub(crate) fn relabel(
    py: Python<'_>,
    batch: &EpisodeBatch,
    rng: &Bound<'_, PyAny>,
    strategy: &str,
    on: Option<&Bound<'_, PyAny>>,
    probability: f64,
) -> PyResult<Hindsight> {
    let rule = rule(strategy, on, probability, batch.first_interaction_action)?;
    let Ok(shared) = rng.cast::<Rng>() else {
        return Hindsight::from_core(py, rule.relabel(&batch.ends, &mut CoreRng::new(seed(rng)?)));
    };
    let shared: &Mutex<CoreRng> = &shared.get().inner;
    let hindsight = py.detach(|| {
        rule.relabel(
            &batch.ends,
            &mut shared.lock().unwrap_or_else(PoisonError::into_inner),
        )
    });
    Hindsight::from_core(py, hindsight)
}

/// The rule that Python arguments describe.
pub(crate) fn rule(
    strategy: &str,
    on: Option<&Bound<'_, PyAny>>,
    probability: f64,
    first_interaction_action: i64,
) -> PyResult<core::Rule> {
    if strategy != "final" {
        let got = format!("\"{strategy}\"");
        return Err(to_py(Error::Argument {
            field: "strategy",
            expected: "\"final\"".into(),
            got,
        }));
    }
    let on = on.map_or_else(|| Ok([Outcome::Failure].into_iter().collect()), outcomes)?;
    checked(core::Rule::new(on, probability, first_interaction_action))
}

/// An outcome from its name or its number.
pub(crate) fn outcome(argument: &Bound<'_, PyAny>) -> PyResult<Outcome> {
    if let Ok(name) = argument.cast::<PyString>() {
        return checked(Outcome::from_name(&name.to_cow()?));
    }
    checked(Outcome::from_code(integer("outcome", argument)?))
}

/// A set of outcomes from a sequence of names or numbers.
pub(crate) fn outcomes(argument: &Bound<'_, PyAny>) -> PyResult<OutcomeSet> {
    // A bare word is a sequence of letters to Python: refused, so that on="failure" is not a
    // puzzle.
    match argument.try_iter() {
        Ok(items) if !argument.is_instance_of::<PyString>() => {
            items.map(|item| outcome(&item?)).collect()
        }
        _ => Err(dtype(
            "on",
            "a sequence of outcomes, such as (\"failure\",)",
            &type_name(argument),
        )),
    }
}
