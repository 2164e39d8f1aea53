//! Arguments of `vhs.EpisodeBuffer`: frames, goals and actions as the core wants them.

use std::collections::BTreeMap;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyMapping, PyString};
use vhs_base::check::check_shape;
use vhs_base::error::Error;
use vhs_core::batch::Layout;
use vhs_core::config::{Backing, GoalKind};
use vhs_core::item::Item;

use crate::arrays::{checked, integer, integer_vec, reals, shape, size, slice, type_name};
use crate::bytes::{bytes_of, item};
use crate::episode_buffer::EpisodeBuffer;
use crate::error::{dtype, to_py};
use crate::hindsight::Reward;

impl EpisodeBuffer {
    /// Frames as bytes: `count` of them, or one without a leading dimension.
    pub(super) fn frames<'py>(
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
    pub(super) fn desired_as_bytes<'py>(
        &self,
        field: &'static str,
        goals: Option<&Bound<'py, PyAny>>,
        count: &[usize],
    ) -> PyResult<Option<PyReadonlyArrayDyn<'py, u8>>> {
        let is_wanted = self.config().goal_kind != GoalKind::Labels;
        self.goals_as_bytes(field, goals, count, is_wanted)
    }

    /// The goals reached, as bytes; None where those are observations.
    pub(super) fn achieved_as_bytes<'py>(
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
        let (goal, item) = self.goal_array();
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
    pub(super) fn actions(&self, actions: &Bound<'_, PyAny>, count: &[usize]) -> PyResult<Actions> {
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
pub(super) enum Actions {
    Number([i64; 1]),
    Numbered(Vec<i64>),
    Continuous(Vec<f32>),
}

impl Actions {
    pub(super) fn parts(&self) -> (&[i64], &[f32]) {
        match self {
            Self::Number(number) => (number, &[]),
            Self::Numbered(numbers) => (numbers, &[]),
            Self::Continuous(vectors) => (&[], vectors),
        }
    }
}

/// The bytes of goals that may be missing.
pub(super) fn goal_bytes<'a>(goals: Option<&'a PyReadonlyArrayDyn<'_, u8>>) -> &'a [u8] {
    goals.map_or(&[], |goals| slice(goals))
}

/// What goals are, from the arguments of the constructor.
pub(super) fn goal_kind(
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

/// What `interactions` and the two counts beside it say: how many interactions, and which action does which.
pub(super) fn interactions(
    mapping: Option<&Bound<'_, PyAny>>,
    count: Option<&Bound<'_, PyAny>>,
) -> PyResult<(usize, BTreeMap<i64, i64>)> {
    let mut pairs = BTreeMap::new();
    if let Some(mapping) = mapping {
        let Ok(mapping) = mapping.cast::<PyMapping>() else {
            let expected = "a mapping of actions to interactions, such as {3: 0}";
            return Err(dtype("interactions", expected, &type_name(mapping)));
        };
        for pair in mapping.items()?.try_iter()? {
            let (action, interaction): (Bound<'_, PyAny>, Bound<'_, PyAny>) = pair?.extract()?;
            let number = |argument| integer("interactions", argument);
            pairs.insert(number(&action)?, number(&interaction)?);
        }
    }
    let Some(count) = count else {
        // One more than the largest; what is negative is refused with the buffer's other settings.
        let most = pairs
            .values()
            .max()
            .map_or(0, |&most| most.saturating_add(1));
        return Ok((usize::try_from(most).unwrap_or_default(), pairs));
    };
    Ok((size("num_interactions", count)?, pairs))
}

/// Memory, compressed or not, or the scratch file at a path. A scratch file loses its name at once, so a bare
/// word is no file but a slip: "Memory", "zstd".
pub(super) fn backing(argument: Option<&Bound<'_, PyAny>>) -> PyResult<Backing> {
    let Some(argument) = argument else {
        return Ok(Backing::Memory);
    };
    if let Ok(word) = argument.cast::<PyString>() {
        match &*word.to_cow()? {
            "memory" => return Ok(Backing::Memory),
            "lz4" => return Ok(Backing::Packed),
            other if !other.contains(['.', '/', MAIN_SEPARATOR]) => {
                return Err(to_py(Error::Argument {
                    field: "backing",
                    expected:
                        "\"memory\", \"lz4\" or the path of a scratch file, such as \"./scratch\""
                            .into(),
                    got: format!("\"{other}\""),
                }));
            }
            _ => {}
        }
    }
    Ok(Backing::Scratch(argument.extract::<PathBuf>()?))
}

/// The folder of a buffer that stays on the disk; any word but those for memory is one.
pub(super) fn folder(argument: Option<&Bound<'_, PyAny>>) -> PyResult<PathBuf> {
    let path = match argument {
        Some(argument) => argument.extract::<PathBuf>()?,
        None => "memory".into(),
    };
    let is_word = argument.is_none_or(PyAnyMethods::is_instance_of::<PyString>);
    if is_word && [Path::new("memory"), Path::new("lz4")].contains(&&*path) {
        return Err(to_py(Error::Argument {
            field: "backing",
            expected: "a folder where persistent is true".into(),
            got: format!("\"{}\"", path.display()),
        }));
    }
    Ok(path)
}

/// Refuses sums of several steps whose rewards only a function knows.
pub(super) fn check_n_step(reward: &Reward<'_>) -> PyResult<()> {
    match reward {
        Reward::Sparse(_) => Ok(()),
        Reward::Function(_) => Err(to_py(Error::Argument {
            field: "reward",
            expected: "a vhs.SparseReward where n_step is above 1".into(),
            got: "a function".into(),
        })),
    }
}

/// One dense rectangle, or one episode after the other.
pub(super) const fn layout(padded: bool) -> Layout {
    if padded {
        Layout::Padded
    } else {
        Layout::Packed
    }
}
