//! Batches out of `vhs.EpisodeBuffer`: what its methods share.
//!
//! Every sampling call takes one number from the buffer's generator, under a lock held for that moment only,
//! and draws from a generator of its own that starts there: readers copy side by side, and the same calls in
//! the same order give the same batches. A call that is refused gives the number back.

use numpy::PyReadwriteArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};
use vhs_base::rng::Rng;
use vhs_core::batch::{Batch, Layout};
use vhs_core::item::Item;
use vhs_core::pool::Bytes;
use vhs_core::relabel::{Hindsight, Rule};
use vhs_core::strategy::HindsightRule;
use vhs_core::transitions::{TransitionDraw, TransitionOut};
use vhs_core::windows::{WindowIndex, WindowShape};

use crate::arrays::checked;
use crate::batch::EpisodeBatch;
use crate::bytes::{out_bytes, out_rows, pooled};
use crate::episode_buffer::EpisodeBuffer;
use crate::error::dtype;
use crate::field;
use crate::hindsight::Reward;
use crate::transitions::{TransitionBatch, WindowBatch};

/// A caller's `out` array, or None where there is none under this name.
type Room<'py> = Option<PyReadwriteArrayDyn<'py, u8>>;

impl EpisodeBuffer {
    /// Runs `sample` with a generator of its own.
    fn with_rng<R>(&self, sample: impl FnOnce(&mut Rng) -> PyResult<R>) -> PyResult<R> {
        let (before, after, mut own) = self.rng.with(|shared| {
            let before = shared.clone();
            let own = shared.split();
            (before, shared.clone(), own)
        });
        sample(&mut own).inspect_err(|_| {
            // Unless another call has moved on since: then the number is lost.
            self.rng.with(|shared| {
                if *shared == after {
                    *shared = before;
                }
            });
        })
    }

    /// Bytes of the observations of so many episodes at most.
    fn most_bytes(&self, episodes: usize) -> usize {
        let config = self.config();
        let rows = episodes.saturating_mul(config.max_episode_steps + 1);
        rows.saturating_mul(config.observation_bytes())
    }

    pub(crate) fn gather_batch(
        &self,
        py: Python<'_>,
        ids: &[i64],
        also: Option<(&Self, &[i64])>,
        out: Option<&Bound<'_, PyAny>>,
        layout: Layout,
    ) -> PyResult<EpisodeBatch> {
        let (other, more) = also.unzip();
        let bytes = self.most_bytes(ids.len() + more.map_or(0, <[i64]>::len));
        let Some(out) = out else {
            let batch = self.copy_with(py, bytes, other, |buffer, other| {
                buffer.gather_with(ids, other.zip(more), layout)
            })?;
            return self.batch(py, batch, None, None, layout);
        };
        let mut room = self.episode_room(out)?;
        let room = room.as_slice_mut()?;
        let batch = self.copy_with(py, bytes, other, |buffer, other| {
            buffer.gather_into(ids, other.zip(more), layout, room)
        })?;
        self.batch(py, batch, None, Some(out), layout)
    }

    pub(crate) fn sample_some_ids(&self, n: usize) -> PyResult<Vec<i64>> {
        self.with_rng(|rng| checked(self.with_core(|buffer| buffer.draw_ids_with(n, rng))))
    }

    pub(crate) fn sample_batch(
        &self,
        py: Python<'_>,
        n: usize,
        rule: Option<&Rule>,
        layout: Layout,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<EpisodeBatch> {
        let bytes = self.most_bytes(n);
        self.with_rng(|rng| {
            let Some(out) = out else {
                let sampled =
                    self.copy(py, bytes, |buffer| buffer.sample_with(n, rule, layout, rng))?;
                return self.batch(py, sampled.0, sampled.1, None, layout);
            };
            let mut room = self.episode_room(out)?;
            let room = room.as_slice_mut()?;
            let batch = self.copy(py, bytes, |buffer| {
                let ids = buffer.draw_ids_with(n, rng)?;
                buffer.gather_into(&ids, None, layout, room)
            })?;
            let hindsight = rule.map(|rule| rule.relabel(&batch.index.ends, rng));
            self.batch(py, batch, hindsight, Some(out), layout)
        })
    }

    /// The `out` of whole episodes: rows of observations.
    fn episode_room<'py>(&self, out: &Bound<'py, PyAny>) -> PyResult<PyReadwriteArrayDyn<'py, u8>> {
        let config = self.config();
        out_rows(out, config.frame_item, &config.observation_shape())
    }

    /// A batch of the core as arrays. Observations that were written to `out` are a view of its first rows.
    fn batch(
        &self,
        py: Python<'_>,
        batch: Batch,
        hindsight: Option<Hindsight>,
        out: Option<&Bound<'_, PyAny>>,
        layout: Layout,
    ) -> PyResult<EpisodeBatch> {
        let config = self.config();
        let (count, rows) = (batch.index.ids.len(), batch.index.rows);
        let leading = match layout {
            Layout::Packed => vec![rows],
            Layout::Padded => vec![count, rows / count.max(1)],
        };
        let shape = [&leading[..], &config.observation_shape()].concat();
        let observations = match out {
            None => pooled(py, batch.observations, config.frame_item, &shape)?,
            Some(out) => {
                let used = out.get_item(PySlice::new(py, 0, isize::try_from(rows)?, 1))?;
                used.call_method1("reshape", (shape,))?
            }
        };
        let (goal, item) = self.goal_array();
        let desired = part(
            py,
            batch.desired_goals,
            item,
            &[&[count], &goal[..]].concat(),
        )?;
        let achieved = part(
            py,
            batch.achieved_goals,
            item,
            &[&leading[..], &goal].concat(),
        )?;
        let large = [Some(observations), desired, achieved];
        let steps = [count, batch.index.longest];
        let fields = field::arrays(py, config, batch.fields, &leading, Some(&steps))?;
        EpisodeBatch::from_core(py, large, fields, batch.index, hindsight, config)
    }

    pub(crate) fn transitions(
        &self,
        py: Python<'_>,
        draw: &TransitionDraw<'_>,
        reward: &Reward<'_>,
        out: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<TransitionBatch> {
        self.with_rng(|rng| {
            let (config, n) = (self.config(), draw.n);
            let sizes = self.read(py, |buffer| buffer.transition_sizes(n, draw.rule))?;
            let (goal, item) = self.goal_array();
            let (image, goal) = (
                [&[n], &config.observation_shape()[..]].concat(),
                [&[n], &goal[..]].concat(),
            );
            let parts = [
                ("observations", config.frame_item, &image),
                ("next_observations", config.frame_item, &image),
                ("goals", item, &goal),
                ("achieved_goals", item, &goal),
                ("previous_achieved_goals", item, &goal),
            ];
            check_names(out, &parts.map(|part| part.0))?;
            let mut memory = Memory::take(out, &parts, sizes)?;
            let mut index = {
                let [
                    observations,
                    next_observations,
                    goals,
                    achieved_goals,
                    previous_achieved_goals,
                ] = memory.slices()?;
                let rows = TransitionOut {
                    observations,
                    next_observations,
                    goals,
                    achieved_goals,
                    previous_achieved_goals,
                };
                self.copy(py, sizes.iter().sum(), |buffer| {
                    buffer.sample_transitions_into(draw, rng, rows)
                })?
            };
            let large = memory.arrays(py, out, &parts)?;
            if index.goals.relabelled.contains(&true)
                && let Some(goals) = &large[2]
            {
                let achieved = large[3].as_ref().or(large[1].as_ref()).unwrap_or(goals);
                let steps = || (index.goals.ids.clone(), index.goals.steps.clone());
                if let Some((rewards, terminated)) = reward.judge(achieved, goals, &[n], steps)? {
                    checked(index.set_relabelled(&rewards, terminated.as_deref()))?;
                }
            }
            let parts = std::mem::take(&mut index.fields);
            let fields = field::arrays(py, config, parts, &[n], Some(&[n]))?;
            let parts = std::mem::take(&mut index.next_fields);
            let next_fields = field::arrays(py, config, parts, &[n], None)?;
            let fields = [fields, next_fields];
            TransitionBatch::from_core(py, large, fields, index, config.action_dim)
        })
    }

    pub(crate) fn windows(
        &self,
        py: Python<'_>,
        n: usize,
        window: WindowShape,
        rule: Option<&HindsightRule>,
        reward: &Reward<'_>,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<WindowBatch> {
        self.with_rng(|rng| {
            let config = self.config();
            let shape = [&[n, window.steps() + 1], &config.observation_shape()[..]].concat();
            let (goal, item) = self.goal_array();
            let sparse = reward.sparse();
            let bytes = self.read(py, |buffer| buffer.window_sizes(n, window, rule))?[0];
            let (observations, batch) = match out {
                None => {
                    let mut batch = self.copy(py, bytes, |buffer| {
                        buffer.sample_windows_with(n, window, rule, sparse, rng)
                    })?;
                    let observations = std::mem::take(&mut batch.observations);
                    (pooled(py, observations, config.frame_item, &shape)?, batch)
                }
                Some(out) => {
                    let mut room = out_bytes(out, config.frame_item, &shape)?;
                    let room = room.as_slice_mut()?;
                    let batch = self.copy(py, bytes, |buffer| {
                        buffer.sample_windows_into(n, window, rule, sparse, rng, room)
                    })?;
                    (out.clone(), batch)
                }
            };
            let mut index = batch.index;
            let goals = part(py, batch.goals, item, &[&[n], &goal[..]].concat())?;
            let reached = [&[n, window.steps() + 1], &goal[..]].concat();
            let achieved = part(py, batch.achieved_goals, item, &reached)?;
            if index.goals.relabelled.contains(&true)
                && let (Reward::Function(_), Some(goals)) = (reward, &goals)
            {
                let (achieved, goals) =
                    step_goals(achieved.as_ref().unwrap_or(&observations), goals)?;
                let cells = [n, window.steps()];
                let steps = || steps_of(&index, window.steps());
                if let Some((rewards, terminated)) =
                    reward.judge(&achieved, &goals, &cells, steps)?
                {
                    checked(index.set_relabelled(&rewards, terminated.as_deref()))?;
                }
            }
            let large = [Some(observations), None, goals, achieved, None];
            let (rows, steps) = ([n, window.steps() + 1], [n, window.steps()]);
            let fields = field::arrays(py, config, batch.fields, &rows, Some(&steps))?;
            WindowBatch::from_core(py, large, fields, index, config.action_dim)
        })
    }
}

/// Episode and step of every cell of windows of so many steps; -1 beyond the end.
fn steps_of(index: &WindowIndex, width: usize) -> (Vec<i64>, Vec<i64>) {
    let (mut ids, mut steps) = (Vec::new(), Vec::new());
    let windows = index.goals.ids.iter().zip(&index.goals.steps);
    for ((&id, &first), &length) in windows.zip(&index.lengths) {
        for cell in (0..).take(width) {
            ids.push(id);
            steps.push(if cell < length { first + cell } else { -1 });
        }
    }
    (ids, steps)
}

/// What a reward function is asked about windows: what each step reached, and the window's goal beside each.
fn step_goals<'py>(
    achieved: &Bound<'py, PyAny>,
    goals: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let py = achieved.py();
    let all = PySlice::full(py);
    let after = PySlice::new(py, 1, isize::MAX, 1);
    let achieved = achieved.get_item((&all, after))?;
    let beside = goals.get_item((&all, py.None()))?;
    let numpy = py.import("numpy")?;
    let goals = numpy.call_method1("broadcast_to", (beside, achieved.getattr("shape")?))?;
    Ok((achieved, goals))
}

/// Pooled memory as an array; None where there is none.
fn part<'py>(
    py: Python<'py>,
    bytes: Bytes,
    item: Item,
    shape: &[usize],
) -> PyResult<Option<Bound<'py, PyAny>>> {
    if bytes.is_empty() {
        return Ok(None);
    }
    pooled(py, bytes, item, shape).map(Some)
}

/// Refuses a name in `out` that no part of the batch has.
fn check_names(out: Option<&Bound<'_, PyDict>>, names: &[&str]) -> PyResult<()> {
    let Some(out) = out else {
        return Ok(());
    };
    for name in out.keys() {
        let name: String = name.extract()?;
        if !names.contains(&name.as_str()) {
            let expected = format!("arrays named among {}", names.join(", "));
            return Err(dtype("out", &expected, &format!("\"{name}\"")));
        }
    }
    Ok(())
}

/// The large parts of a batch: in memory of the caller where `out` has them, else in pooled memory.
struct Memory<'py> {
    rooms: [Room<'py>; 5],
    fresh: [Bytes; 5],
}

impl<'py> Memory<'py> {
    fn take(
        out: Option<&Bound<'py, PyDict>>,
        parts: &[(&str, Item, &Vec<usize>); 5],
        sizes: [usize; 5],
    ) -> PyResult<Self> {
        let mut memory = Self {
            rooms: [const { None }; 5],
            fresh: Default::default(),
        };
        for (place, &(name, item, shape)) in parts.iter().enumerate() {
            let given = out.map(|out| out.get_item(name)).transpose()?.flatten();
            match given {
                Some(array) => memory.rooms[place] = Some(out_bytes(&array, item, shape)?),
                None => memory.fresh[place] = checked(Bytes::take("sample", sizes[place]))?,
            }
        }
        Ok(memory)
    }

    fn slices(&mut self) -> PyResult<[&mut [u8]; 5]> {
        let mut slices: [&mut [u8]; 5] = Default::default();
        for ((slice, room), fresh) in slices.iter_mut().zip(&mut self.rooms).zip(&mut self.fresh) {
            *slice = match room {
                Some(room) => room.as_slice_mut()?,
                None => fresh,
            };
        }
        Ok(slices)
    }

    fn arrays(
        self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyDict>>,
        parts: &[(&str, Item, &Vec<usize>); 5],
    ) -> PyResult<[Option<Bound<'py, PyAny>>; 5]> {
        // Rewards are asked for next, by a function that may want to read these arrays.
        drop(self.rooms);
        let mut arrays = [const { None }; 5];
        for ((array, bytes), &(name, item, shape)) in arrays.iter_mut().zip(self.fresh).zip(parts) {
            *array = match out.map(|out| out.get_item(name)).transpose()?.flatten() {
                Some(given) => Some(given),
                None => part(py, bytes, item, shape)?,
            };
        }
        Ok(arrays)
    }
}
