//! `vhs.Prototypes`.

use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vhs_base::check::check_shape;
use vhs_base::error::Result;
use vhs_core::prototypes as core;

use crate::arrays::{
    bools, checked, exact, filled, integer_vec, into_array, reals, rng_from_state, seed, size,
    slice,
};
use crate::shared::Shared;

#[doc = stub!("Prototypes")]
#[pyclass(frozen, module = "vhs._core")]
pub(crate) struct Prototypes {
    inner: Shared<core::Prototypes>,
    num_classes: usize,
    dim: usize,
}

impl Prototypes {
    /// A call of the core, with the interpreter released.
    fn run<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut core::Prototypes) -> Result<R> + Send,
    ) -> PyResult<R> {
        checked(self.inner.detached(py, call))
    }
}

#[pymethods]
impl Prototypes {
    #[new]
    #[pyo3(signature = (num_classes, dim, momentum=0.9, seed=None),
           text_signature = "(num_classes, dim, momentum=0.9, seed=0)")]
    fn new(
        num_classes: &Bound<'_, PyAny>,
        dim: &Bound<'_, PyAny>,
        momentum: f64,
        seed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (num_classes, dim) = (size("num_classes", num_classes)?, size("dim", dim)?);
        let seed = seed.map_or(Ok(0), self::seed)?;
        let inner = Shared::new(checked(core::Prototypes::new(
            num_classes,
            dim,
            momentum,
            seed,
        ))?);
        Ok(Self {
            inner,
            num_classes,
            dim,
        })
    }

    #[doc = stub!("Prototypes.update")]
    fn update(
        &self,
        py: Python<'_>,
        features: &Bound<'_, PyAny>,
        labels: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (features, labels) = (reals("features", features)?, integer_vec("labels", labels)?);
        checked(check_shape(
            "features",
            &[labels.len(), self.dim],
            features.shape(),
        ))?;
        let features = slice(&features);
        self.run(py, |table| table.update(features, &labels))
    }

    #[doc = stub!("Prototypes.embed")]
    #[pyo3(signature = (labels, *, out=None))]
    fn embed<'py>(
        &self,
        py: Python<'py>,
        labels: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let labels = integer_vec("labels", labels)?;
        let fresh = || self.run(py, |table| Ok((table.embed(&labels)?, ())));
        let into = |out: &mut [f32]| self.run(py, |table| table.embed_into(&labels, out));
        Ok(filled(py, out, &[labels.len(), self.dim], fresh, into)?.0)
    }

    #[doc = stub!("Prototypes.state_dict")]
    fn state_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let copy = self.inner.detached(py, |table| table.clone());
        let state = PyDict::new(py);
        state.set_item(
            "table",
            into_array(py, copy.table().to_vec(), &[self.num_classes, self.dim])?,
        )?;
        state.set_item(
            "seen",
            into_array(py, copy.seen().to_vec(), &[self.num_classes])?,
        )?;
        state.set_item("rng", into_array(py, copy.rng().state().to_vec(), &[4])?)?;
        Ok(state)
    }

    #[doc = stub!("Prototypes.load_state_dict")]
    fn load_state_dict(&self, py: Python<'_>, state: &Bound<'_, PyAny>) -> PyResult<()> {
        let table = exact::<f32>("table", &state.get_item("table")?)?;
        checked(check_shape(
            "table",
            &[self.num_classes, self.dim],
            table.shape(),
        ))?;
        let seen = bools("seen", &state.get_item("seen")?, &[self.num_classes])?;
        let rng = rng_from_state("rng", &state.get_item("rng")?)?;
        let table = slice(&table);
        checked(
            self.inner
                .detached(py, |prototypes| prototypes.restore(table, &seen, rng)),
        )
    }

    #[doc = stub!("Prototypes.table")]
    #[getter]
    fn table<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let table = self
            .inner
            .detached(py, |prototypes| prototypes.table().to_vec());
        into_array(py, table, &[self.num_classes, self.dim])
    }

    #[doc = stub!("Prototypes.seen")]
    #[getter]
    fn seen<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let seen = self
            .inner
            .detached(py, |prototypes| prototypes.seen().to_vec());
        into_array(py, seen, &[self.num_classes])
    }

    #[doc = stub!("Prototypes.num_classes")]
    #[getter]
    fn num_classes(&self) -> usize {
        self.num_classes
    }

    #[doc = stub!("Prototypes.dim")]
    #[getter]
    fn dim(&self) -> usize {
        self.dim
    }

    #[doc = stub!("Prototypes.momentum")]
    #[getter]
    fn momentum(&self, py: Python<'_>) -> f64 {
        self.inner.detached(py, |prototypes| prototypes.momentum())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let seen = self.inner.detached(py, |prototypes| {
            prototypes.seen().iter().filter(|&&seen| seen).count()
        });
        format!(
            "Prototypes(num_classes={}, dim={}, seen={seen})",
            self.num_classes, self.dim
        )
    }
}
