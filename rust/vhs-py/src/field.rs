//! `vhs.Field`, and the arrays of fields: those that a call hands over, those of a batch.

use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyMapping, PyTuple};
use vhs_base::error::Error;
use vhs_core::config::{EpisodeConfig, Field as Named, Per};
use vhs_core::item::Item;
use vhs_core::pool::Bytes;

use crate::arrays::{shape, slice, type_name};
use crate::bytes::{bytes_of, item, item_name, pooled};
use crate::error::{dtype, to_py};

#[doc = stub!("Field")]
#[pyclass(frozen, eq, hash, module = "vhs._core")]
#[derive(Clone, PartialEq, Eq, Hash)]
pub(crate) struct Field {
    sizes: Vec<usize>,
    item: Item,
    per: Per,
    #[doc = stub!("Field.stacked")]
    #[pyo3(get)]
    stacked: bool,
}

#[pymethods]
impl Field {
    #[new]
    #[pyo3(signature = (shape=None, dtype=None, per="observation", stacked=false),
           text_signature = "(shape=(), dtype='float32', per='observation', stacked=False)")]
    fn new(
        shape: Option<&Bound<'_, PyAny>>,
        dtype: Option<&Bound<'_, PyAny>>,
        per: &str,
        stacked: bool,
    ) -> PyResult<Self> {
        let per = match per {
            "observation" => Per::Observation,
            "step" => Per::Step,
            _ => {
                return Err(to_py(Error::Argument {
                    field: "per",
                    expected: "\"observation\", \"step\"".into(),
                    got: format!("\"{per}\""),
                }));
            }
        };
        Ok(Self {
            sizes: shape.map_or(Ok(Vec::new()), |sizes| self::shape("shape", sizes))?,
            item: dtype.map_or(Ok(Item::F32), |dtype| item("dtype", dtype))?,
            per,
            stacked,
        })
    }

    #[doc = stub!("Field.shape")]
    #[getter]
    fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.sizes)
    }

    #[doc = stub!("Field.dtype")]
    #[getter]
    fn dtype<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("numpy")?
            .call_method1("dtype", (item_name(self.item),))
    }

    #[doc = stub!("Field.per")]
    #[getter]
    const fn per(&self) -> &'static str {
        match self.per {
            Per::Observation => "observation",
            Per::Step => "step",
        }
    }

    fn __getnewargs__(&self) -> (Vec<usize>, &'static str, &'static str, bool) {
        let sizes = self.sizes.clone();
        (sizes, item_name(self.item), self.per(), self.stacked)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (shape, dtype, per) = (self.shape(py)?, item_name(self.item), self.per());
        let stacked = if self.stacked { "True" } else { "False" };
        Ok(format!(
            "Field({shape}, '{dtype}', per='{per}', stacked={stacked})"
        ))
    }
}

/// The fields of the constructor's argument, in its order.
pub(crate) fn named(argument: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Named>> {
    let Some(argument) = argument else {
        return Ok(Vec::new());
    };
    let expected = "a mapping of names to vhs.Field, such as {\"compass\": Field((2,))}";
    let Ok(mapping) = argument.cast::<PyMapping>() else {
        return Err(dtype("fields", expected, &type_name(argument)));
    };
    let one = |pair: PyResult<Bound<'_, PyAny>>| {
        let (name, field): (Bound<'_, PyAny>, Bound<'_, PyAny>) = pair?.extract()?;
        let got = || format!("{}: {}", type_name(&name), type_name(&field));
        let (Ok(name), Ok(field)) = (name.extract::<String>(), field.cast::<Field>()) else {
            return Err(dtype("fields", expected, &got()));
        };
        let field = field.get();
        Ok(Named {
            name,
            shape: field.sizes.clone(),
            item: field.item,
            per: field.per,
            is_stacked: field.stacked,
        })
    };
    mapping.items()?.try_iter()?.map(one).collect()
}

/// The fields of a buffer as a new dictionary.
pub(crate) fn declared<'py>(py: Python<'py>, fields: &[Named]) -> PyResult<Bound<'py, PyDict>> {
    let declared = PyDict::new(py);
    for field in fields {
        let Named {
            shape, item, per, ..
        } = field.clone();
        let (sizes, stacked) = (shape, field.is_stacked);
        let value = Field {
            sizes,
            item,
            per,
            stacked,
        };
        declared.set_item(&field.name, value)?;
    }
    Ok(declared)
}

/// What a call hands over of each field, in the order of the buffer's.
pub(crate) struct Given<'py>(Vec<Option<PyReadonlyArrayDyn<'py, u8>>>);

impl<'py> Given<'py> {
    /// `count` of each field, or one without a leading dimension, where nothing comes with steps unless `steps`.
    pub(crate) fn take(
        fields: &[Named],
        given: Option<&Bound<'py, PyAny>>,
        count: &[usize],
        steps: bool,
    ) -> PyResult<Self> {
        let wanted = |field: &Named| steps || field.per == Per::Observation;
        let Some(given) = given else {
            return match fields.iter().find(|&field| wanted(field)) {
                None => Ok(Self(fields.iter().map(|_| None).collect())),
                Some(field) => Err(missing(field)),
            };
        };
        let Ok(given) = given.cast::<PyMapping>() else {
            let expected = "a mapping of names to arrays";
            return Err(dtype("fields", expected, &type_name(given)));
        };
        for name in given.keys()?.try_iter()? {
            let name = name?.str()?.to_string();
            if !fields
                .iter()
                .any(|field| wanted(field) && field.name == name)
            {
                return Err(unknown(fields.iter().filter(|&field| wanted(field)), &name));
            }
        }
        let one = |field: &Named| {
            if !wanted(field) {
                return Ok(None);
            }
            if !given.contains(&field.name)? {
                return Err(missing(field));
            }
            array(field, &given.get_item(&field.name)?, count).map(Some)
        };
        fields.iter().map(one).collect::<PyResult<_>>().map(Self)
    }

    pub(crate) fn slices(&self) -> Vec<&[u8]> {
        let arrays = self.0.iter().map(Option::as_ref);
        arrays.map(|array| array.map_or(&[][..], slice)).collect()
    }
}

/// An argument as the bytes of a field; Python's own numbers are taken where the field's type holds them.
fn array<'py>(
    field: &Named,
    argument: &Bound<'py, PyAny>,
    count: &[usize],
) -> PyResult<PyReadonlyArrayDyn<'py, u8>> {
    let name = format!("fields[\"{}\"]", field.name);
    let shape = [count, &field.shape].concat();
    let is_number = argument.is_exact_instance_of::<PyFloat>()
        || argument.is_exact_instance_of::<PyInt>()
        || argument.is_exact_instance_of::<PyBool>();
    if is_number {
        let (numpy, dtype) = (argument.py().import("numpy")?, item_name(field.item));
        let least = numpy.call_method1("min_scalar_type", (argument,))?;
        if numpy.call_method1("can_cast", (least, dtype))?.extract()? {
            let number = numpy.call_method1("asarray", (argument, dtype))?;
            return bytes_of(&name, &number, field.item, &shape);
        }
    }
    bytes_of(&name, argument, field.item, &shape)
}

fn missing(field: &Named) -> PyErr {
    let shape = &field.shape;
    let expected = format!("an array of shape {shape:?} for \"{}\"", field.name);
    to_py(Error::Argument {
        field: "fields",
        expected,
        got: "none".into(),
    })
}

fn unknown<'a>(wanted: impl Iterator<Item = &'a Named>, name: &str) -> PyErr {
    let names: Vec<_> = wanted.map(|field| format!("\"{}\"", field.name)).collect();
    let expected = match names.len() {
        0 => "none".into(),
        _ => format!("{} alone", names.join(", ")),
    };
    to_py(Error::Argument {
        field: "fields",
        expected,
        got: format!("\"{name}\""),
    })
}

/// The fields of a batch by name; `observations` and `steps` are the sizes before those of a row. What comes with
/// steps is left out where `steps` is None.
pub(crate) fn arrays(
    py: Python<'_>,
    config: &EpisodeConfig,
    parts: Vec<Bytes>,
    observations: &[usize],
    steps: Option<&[usize]>,
) -> PyResult<Py<PyDict>> {
    let arrays = PyDict::new(py);
    for (field, bytes) in config.fields.iter().zip(parts) {
        let leading = match field.per {
            Per::Observation => observations,
            Per::Step => match steps {
                Some(steps) => steps,
                None => continue,
            },
        };
        let row = field.row_shape(config.frame_stack, config.stacking);
        let array = pooled(py, bytes, field.item, &[leading, &row].concat())?;
        arrays.set_item(&field.name, array)?;
    }
    Ok(arrays.unbind())
}
