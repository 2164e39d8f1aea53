//! Arguments of `vhs.EpisodeBuffer`: frames, goals and actions as the core wants them.

use std::path::PathBuf;

use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use vhs_core::batch::Layout;
use vhs_core::config::{Backing, GoalKind, Item};
use vhs_core::error::{Error, check_shape};

use crate::arrays::{checked, integers, reals, shape, slice};
use crate::bytes::{bytes_of, item};
use crate::episodes::EpisodeBuffer;
use crate::error::to_py;
use crate::sampling::goal_array;

impl EpisodeBuffer {
    /// Frames as bytes: `count` of them, or one without a leading dimension.
    pub(crate) fn frames<'py>(
        &self,
        field: &'static str,
        frames: &Bound<'py, PyAny>,
        count: &[usize],
    ) -> PyResult<PyReadonlyArrayDyn<'py, u8>> {
        let item = self.config().frame_item;
        match count {
            // One frame a step is the usual way: it costs no allocation.
            [] => bytes_of(field, frames, item, &self.config().frame_shape),
            _ => bytes_of(
                field,
                frames,
                item,
                &[count, &self.config().frame_shape].concat(),
            ),
        }
    }

    /// Goals as bytes; None where none was given.
    pub(crate) fn goals_as_bytes<'py>(
        &self,
        field: &'static str,
        goals: Option<&Bound<'py, PyAny>>,
        count: &[usize],
    ) -> PyResult<Option<PyReadonlyArrayDyn<'py, u8>>> {
        let Some(goals) = goals else {
            return Ok(None);
        };
        let (goal, item) = goal_array(self.config());
        bytes_of(field, goals, item, &[count, &goal].concat()).map(Some)
    }

    /// Actions of `count` steps: numbers, or vectors.
    pub(crate) fn actions<'py>(
        &self,
        actions: &Bound<'py, PyAny>,
        count: &[usize],
    ) -> PyResult<Actions<'py>> {
        let dim = self.config().action_dim;
        if dim == 0 {
            return integers("actions", actions).map(Actions::Numbered);
        }
        let vectors = reals("actions", actions)?;
        checked(check_shape(
            "actions",
            &[count, &[dim]].concat(),
            vectors.shape(),
        ))?;
        Ok(Actions::Continuous(vectors))
    }
}

/// The actions of a step or several.
pub(crate) enum Actions<'py> {
    Number([i64; 1]),
    Numbered(PyReadonlyArrayDyn<'py, i64>),
    Continuous(PyReadonlyArrayDyn<'py, f32>),
}

impl Actions<'_> {
    pub(crate) fn parts(&self) -> (&[i64], &[f32]) {
        match self {
            Self::Number(number) => (number, &[]),
            Self::Numbered(numbers) => (slice(numbers), &[]),
            Self::Continuous(vectors) => (&[], slice(vectors)),
        }
    }
}

/// The bytes of goals that may be missing.
pub(crate) fn goal_bytes<'a>(goals: Option<&'a PyReadonlyArrayDyn<'_, u8>>) -> &'a [u8] {
    goals.map_or(&[], |goals| slice(goals))
}

/// What goals are, from the arguments of the constructor.
pub(crate) fn goal_kind(
    goals: &str,
    goal_shape: Option<&Bound<'_, PyAny>>,
    goal_dtype: Option<&Bound<'_, PyAny>>,
) -> PyResult<GoalKind> {
    let given = goal_shape.is_some() || goal_dtype.is_some();
    match goals {
        "labels" if !given => Ok(GoalKind::Labels),
        "observations" if !given => Ok(GoalKind::Observations),
        "vectors" if goal_shape.is_some() => Ok(GoalKind::Vectors {
            shape: goal_shape.map_or(Ok(Vec::new()), |sizes| shape("goal_shape", sizes))?,
            item: goal_dtype.map_or(Ok(Item::F32), |dtype| item("goal_dtype", dtype))?,
        }),
        "labels" | "observations" | "vectors" => Err(to_py(Error::Argument {
            field: "goal_shape",
            expected: "a shape where goals are \"vectors\", and only there".into(),
            got: format!("goals=\"{goals}\""),
        })),
        _ => Err(to_py(Error::Argument {
            field: "goals",
            expected: "\"labels\", \"observations\", \"vectors\"".into(),
            got: format!("\"{goals}\""),
        })),
    }
}

/// Memory, or the scratch file at a path.
pub(crate) fn backing(argument: Option<&Bound<'_, PyAny>>) -> PyResult<Backing> {
    let Some(argument) = argument else {
        return Ok(Backing::Memory);
    };
    if let Ok(word) = argument.cast::<PyString>()
        && word.to_cow()? == "memory"
    {
        return Ok(Backing::Memory);
    }
    Ok(Backing::Scratch(argument.extract::<PathBuf>()?))
}

/// One dense rectangle, or one episode after the other.
pub(crate) const fn layout(padded: bool) -> Layout {
    if padded {
        Layout::Padded
    } else {
        Layout::Packed
    }
}
