//! Arguments of `vhs.EpisodeBuffer`: frames, goals and actions as the core wants them.

use std::path::PathBuf;

use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use vhs_base::check::check_shape;
use vhs_base::error::Error;
use vhs_core::batch::Layout;
use vhs_core::config::{Backing, GoalKind};
use vhs_core::item::Item;

use crate::arrays::{checked, integer_vec, reals, shape, size, slice};
use crate::bytes::{bytes_of, item};
use crate::episode_buffer::EpisodeBuffer;
use crate::error::{dtype, to_py};
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

    /// The goals that episodes are told, as bytes; None where those are labels.
    pub(crate) fn desired_as_bytes<'py>(
        &self,
        field: &'static str,
        goals: Option<&Bound<'py, PyAny>>,
        count: &[usize],
    ) -> PyResult<Option<PyReadonlyArrayDyn<'py, u8>>> {
        let is_wanted = self.config().goal_kind != GoalKind::Labels;
        self.goals_as_bytes(field, goals, count, is_wanted)
    }

    /// The goals reached, as bytes; None where those are observations.
    pub(crate) fn achieved_as_bytes<'py>(
        &self,
        field: &'static str,
        goals: Option<&Bound<'py, PyAny>>,
        count: &[usize],
    ) -> PyResult<Option<PyReadonlyArrayDyn<'py, u8>>> {
        let is_wanted = matches!(self.config().goal_kind, GoalKind::Vectors { .. });
        self.goals_as_bytes(field, goals, count, is_wanted)
    }

    fn goals_as_bytes<'py>(
        &self,
        field: &'static str,
        goals: Option<&Bound<'py, PyAny>>,
        count: &[usize],
        is_wanted: bool,
    ) -> PyResult<Option<PyReadonlyArrayDyn<'py, u8>>> {
        let (goal, item) = goal_array(self.config());
        let shape = [count, &goal].concat();
        match goals {
            Some(goals) if is_wanted => bytes_of(field, goals, item, &shape).map(Some),
            None if is_wanted => {
                let expected = format!("an array of shape {shape:?}");
                Err(dtype(field, &expected, "None"))
            }
            Some(_) => Err(to_py(Error::Argument {
                field,
                expected: format!("None where goals are {:?}", self.goal_word()),
                got: "an array".into(),
            })),
            None => Ok(None),
        }
    }

    /// Actions of `count` steps: numbers, or vectors.
    ///
    /// Copies: what is checked is what is stored, whatever another thread does to the caller's array meanwhile.
    pub(crate) fn actions(&self, actions: &Bound<'_, PyAny>, count: &[usize]) -> PyResult<Actions> {
        let dim = self.config().action_dim;
        if dim == 0 {
            return integer_vec("actions", actions).map(Actions::Numbered);
        }
        let vectors = reals("actions", actions)?;
        checked(check_shape(
            "actions",
            &[count, &[dim]].concat(),
            vectors.shape(),
        ))?;
        Ok(Actions::Continuous(slice(&vectors).to_vec()))
    }
}

/// The actions of a step or several.
pub(crate) enum Actions {
    Number([i64; 1]),
    Numbered(Vec<i64>),
    Continuous(Vec<f32>),
}

impl Actions {
    pub(crate) fn parts(&self) -> (&[i64], &[f32]) {
        match self {
            Self::Number(number) => (number, &[]),
            Self::Numbered(numbers) => (numbers, &[]),
            Self::Continuous(vectors) => (&[], vectors),
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

/// The number of moves, the actions before the first interaction: as given, or of so many actions in all.
pub(crate) fn moves(
    first_interaction_action: Option<&Bound<'_, PyAny>>,
    num_actions: Option<&Bound<'_, PyAny>>,
    num_interactions: usize,
) -> PyResult<usize> {
    let first = first_interaction_action
        .map(|first| size("first_interaction_action", first))
        .transpose()?;
    let Some(num_actions) = num_actions else {
        return Ok(first.unwrap_or(3));
    };
    let all = size("num_actions", num_actions)?;
    let moves = all.checked_sub(num_interactions);
    let expected = match (first, moves) {
        (None, Some(moves)) => return Ok(moves),
        (None, None) => format!("at least num_interactions = {num_interactions}"),
        (Some(_), _) => "either it or first_interaction_action".into(),
    };
    Err(to_py(Error::Argument {
        field: "num_actions",
        expected,
        got: first.map_or_else(|| all.to_string(), |_| "both".into()),
    }))
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
