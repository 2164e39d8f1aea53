//! `vhs.relabel`, and the words of its arguments.

use pyo3::prelude::*;
use pyo3::types::PyString;
use vhs_base::error::Error;
use vhs_base::rng::Rng as CoreRng;
use vhs_core::outcome::{Outcome, OutcomeSet};
use vhs_core::relabel as core;

use crate::arrays::{checked, integer, seed, type_name};
use crate::batch::{EpisodeBatch, Hindsight};
use crate::error::{dtype, to_py};
use crate::rng::Rng;

#[doc = stub!("relabel")]
// Chooses the episodes of a batch that are relabelled, and their new goals.
#[pyfunction]
#[pyo3(signature = (batch, *, rng, strategy="final", on=None, probability=0.8, ends=None))]
pub(crate) fn relabel(
    py: Python<'_>,
    batch: &EpisodeBatch,
    rng: &Bound<'_, PyAny>,
    strategy: &str,
    on: Option<&Bound<'_, PyAny>>,
    probability: f64,
    ends: Option<&Bound<'_, PyAny>>,
) -> PyResult<Hindsight> {
    let rule = rule(strategy, on, probability)?;
    let ends = ends.map_or_else(|| Ok(batch.ends.clone()), |ends| batch.ends_at(ends))?;
    let Ok(shared) = rng.cast::<Rng>() else {
        return Hindsight::from_core(py, rule.relabel(&ends, &mut CoreRng::new(seed(rng)?)));
    };
    let shared = &shared.get().inner;
    let hindsight = shared.detached(py, |rng| rule.relabel(&ends, rng));
    Hindsight::from_core(py, hindsight)
}

/// The rule that Python arguments describe.
pub(crate) fn rule(
    strategy: &str,
    on: Option<&Bound<'_, PyAny>>,
    probability: f64,
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
    checked(core::Rule::new(on, probability))
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
