//! The methods of `vhs.EpisodeBuffer`: arguments in, a call of the core, arrays out; `properties` has what it says of
//! itself.

use std::path::PathBuf;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use vhs_base::error::Error;
use vhs_core::episodes::{self as core, Backing, EpisodeConfig, Item, Opening, Steps};
use vhs_core::transitions::TransitionDraw;
use vhs_core::windows::WindowShape;

use super::arguments::{
    Actions, backing, check_n_step, folder, goal_bytes, goal_kind, interactions, layout,
};
use super::{EpisodeBuffer, stacking};
use crate::arrays::{
    checked, integer, integer_vec, into_array, real_vec, rows, seed, shape, size, slice,
};
use crate::batch::EpisodeBatch;
use crate::bytes::{filled_bytes, item};
use crate::error::to_py;
use crate::field::{self, Given};
use crate::hindsight::{Reward, hindsight_rule, refuse_without_strategy};
use crate::interrupt::interruptible;
use crate::relabel::{outcome, rule};
use crate::transitions::{TransitionBatch, WindowBatch};

#[pymethods]
impl EpisodeBuffer {
    #[new]
    #[pyo3(signature = (frame_shape, *, num_streams, max_episode_steps, capacity_steps, frame_stack=None,
                        stacking="frames", num_goals=None, num_actions=None, first_action=None,
                        interactions=None, num_interactions=None, dtype=None, goals="labels", goal_shape=None, goal_dtype=None,
                        fields=None, action_dim=None, priority_exponent=None, backing=None, persistent=false, seed=None),
           text_signature = "(frame_shape, *, num_streams, max_episode_steps, capacity_steps, frame_stack=2, \
                             stacking='frames', num_goals=1, num_actions=None, first_action=0, \
                             interactions=None, num_interactions=None, dtype='uint8', goals='labels', goal_shape=None, \
                             goal_dtype=None, fields=None, action_dim=0, priority_exponent=None, backing='memory', persistent=False, seed=0)")]
    #[expect(
        clippy::too_many_arguments,
        reason = "keyword arguments in Python; one struct from here on"
    )]
    fn new(
        frame_shape: &Bound<'_, PyAny>,
        num_streams: &Bound<'_, PyAny>,
        max_episode_steps: &Bound<'_, PyAny>,
        capacity_steps: &Bound<'_, PyAny>,
        frame_stack: Option<&Bound<'_, PyAny>>,
        stacking: &str,
        num_goals: Option<&Bound<'_, PyAny>>,
        num_actions: Option<&Bound<'_, PyAny>>,
        first_action: Option<&Bound<'_, PyAny>>,
        interactions: Option<&Bound<'_, PyAny>>,
        num_interactions: Option<&Bound<'_, PyAny>>,
        dtype: Option<&Bound<'_, PyAny>>,
        goals: &str,
        goal_shape: Option<&Bound<'_, PyAny>>,
        goal_dtype: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyAny>>,
        action_dim: Option<&Bound<'_, PyAny>>,
        priority_exponent: Option<f64>,
        backing: Option<&Bound<'_, PyAny>>,
        persistent: bool,
        seed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let or = |default: usize, field, argument: Option<&Bound<'_, PyAny>>| {
            argument.map_or(Ok(default), |argument| size(field, argument))
        };
        let (num_interactions, interactions) = self::interactions(interactions, num_interactions)?;
        let folder = persistent.then(|| folder(backing)).transpose()?;
        let backing = if persistent { None } else { backing };
        let config = EpisodeConfig {
            frame_shape: shape("frame_shape", frame_shape)?,
            frame_item: dtype.map_or(Ok(Item::U8), |dtype| item("dtype", dtype))?,
            num_streams: size("num_streams", num_streams)?,
            max_episode_steps: size("max_episode_steps", max_episode_steps)?,
            capacity_steps: size("capacity_steps", capacity_steps)?,
            frame_stack: or(2, "frame_stack", frame_stack)?,
            stacking: self::stacking(stacking)?,
            goal_kind: goal_kind(goals, goal_shape, goal_dtype)?,
            fields: field::named(fields)?,
            num_goals: or(1, "num_goals", num_goals)?,
            num_actions: num_actions
                .map(|number| size("num_actions", number))
                .transpose()?,
            first_action: first_action.map_or(Ok(0), |first| integer("first_action", first))?,
            num_interactions,
            interactions,
            action_dim: or(0, "action_dim", action_dim)?,
            priority_exponent,
            seed: seed.map_or(Ok(0), self::seed)?,
            backing: self::backing(backing)?,
        };
        let made = match folder {
            None => core::EpisodeBuffer::new(config),
            // SAFETY: the stub passes the condition on to the caller.
            Some(folder) => unsafe { core::EpisodeBuffer::keep(config, &folder) },
        };
        checked(made).map(Self::from)
    }

    #[doc = stub!("EpisodeBuffer.begin")]
    #[pyo3(signature = (stream, frame, goal=None, interaction=None, *, desired_goal=None, achieved_goal=None,
                        fields=None),
           text_signature = "($self, stream, frame, goal=0, interaction=0, *, desired_goal=None, \
                             achieved_goal=None, fields=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn begin(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        frame: &Bound<'_, PyAny>,
        goal: Option<&Bound<'_, PyAny>>,
        interaction: Option<&Bound<'_, PyAny>>,
        desired_goal: Option<&Bound<'_, PyAny>>,
        achieved_goal: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let (stream, frame) = (
            integer("stream", stream)?,
            self.frames("frame", frame, &[])?,
        );
        let desired = self.desired_as_bytes("desired_goal", desired_goal, &[])?;
        let achieved = self.achieved_as_bytes("achieved_goal", achieved_goal, &[])?;
        let fields = Given::take(&self.config().fields, fields, &[], false)?;
        let opening = Opening {
            frame: slice(&frame),
            goal: goal.map_or(Ok(0), |goal| integer("goal", goal))?,
            interaction: interaction.map_or(Ok(0), |number| integer("interaction", number))?,
            desired: goal_bytes(desired.as_ref()),
            achieved: goal_bytes(achieved.as_ref()),
            fields: &fields.slices(),
        };
        self.write_briefly(py, |buffer| buffer.begin_with(stream, opening))
    }

    #[doc = stub!("EpisodeBuffer.append")]
    #[pyo3(signature = (stream, action, reward, value, frame, *, achieved_goal=None, fields=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn append(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        action: &Bound<'_, PyAny>,
        reward: f32,
        value: Option<f32>,
        frame: &Bound<'_, PyAny>,
        achieved_goal: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let stream = integer("stream", stream)?;
        let action = match self.config().action_dim {
            0 => Actions::Number([integer("action", action)?]),
            _ => self.actions(action, &[])?,
        };
        let frame = self.frames("frame", frame, &[])?;
        let achieved = self.achieved_as_bytes("achieved_goal", achieved_goal, &[])?;
        let fields = Given::take(&self.config().fields, fields, &[], true)?;
        let (actions, vectors) = action.parts();
        let steps = Steps {
            streams: &[stream],
            actions,
            vectors,
            rewards: &[reward],
            values: &[value.unwrap_or_default()],
            frames: slice(&frame),
            achieved: goal_bytes(achieved.as_ref()),
            fields: &fields.slices(),
        };
        self.write_briefly(py, |buffer| buffer.append(steps))
    }

    #[doc = stub!("EpisodeBuffer.append_batch")]
    #[pyo3(signature = (streams, actions, rewards, values, frames, *, achieved_goals=None, fields=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn append_batch(
        &self,
        py: Python<'_>,
        streams: &Bound<'_, PyAny>,
        actions: &Bound<'_, PyAny>,
        rewards: &Bound<'_, PyAny>,
        values: Option<&Bound<'_, PyAny>>,
        frames: &Bound<'_, PyAny>,
        achieved_goals: Option<&Bound<'_, PyAny>>,
        fields: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let streams = integer_vec("streams", streams)?;
        let n = [streams.len()];
        let actions = self.actions(actions, &n)?;
        let rewards = real_vec("rewards", rewards)?;
        let zeros = || Ok(vec![0.0; streams.len()]);
        let values = values.map_or_else(zeros, |values| real_vec("values", values))?;
        let frames = self.frames("frames", frames, &n)?;
        let achieved = self.achieved_as_bytes("achieved_goals", achieved_goals, &n)?;
        let fields = Given::take(&self.config().fields, fields, &n, true)?;
        let (actions, vectors) = actions.parts();
        let steps = Steps {
            streams: &streams,
            actions,
            vectors,
            rewards: &rewards,
            values: &values,
            frames: slice(&frames),
            achieved: goal_bytes(achieved.as_ref()),
            fields: &fields.slices(),
        };
        self.write(py, |buffer| buffer.append(steps))
    }

    #[doc = stub!("EpisodeBuffer.finish")]
    #[pyo3(signature = (stream, outcome, terminated=None))]
    fn finish(
        &self,
        py: Python<'_>,
        stream: &Bound<'_, PyAny>,
        outcome: &Bound<'_, PyAny>,
        terminated: Option<bool>,
    ) -> PyResult<i64> {
        let (stream, outcome) = (integer("stream", stream)?, self::outcome(outcome)?);
        self.write_briefly(py, |buffer| match terminated {
            None => buffer.finish(stream, outcome),
            Some(terminated) => buffer.finish_with(stream, outcome, terminated),
        })
    }

    #[doc = stub!("EpisodeBuffer.abort")]
    fn abort(&self, py: Python<'_>, stream: &Bound<'_, PyAny>) -> PyResult<()> {
        let stream = integer("stream", stream)?;
        self.write(py, |buffer| buffer.abort(stream))
    }

    #[doc = stub!("EpisodeBuffer.collect")]
    #[pyo3(signature = (buffer, ids, *, steps=None, stream=None),
           text_signature = "($self, buffer, ids, *, steps=None, stream=0)")]
    fn collect<'py>(
        &self,
        py: Python<'py>,
        buffer: &Bound<'py, Self>,
        ids: &Bound<'py, PyAny>,
        steps: Option<&Bound<'py, PyAny>>,
        stream: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let ids = integer_vec("ids", ids)?;
        let steps = steps.map(|steps| integer_vec("steps", steps)).transpose()?;
        let stream = stream.map_or(Ok(0), |stream| integer("stream", stream))?;
        let copied = self.write_reading(py, buffer.get(), |buffer, other| {
            buffer.collect(stream, other, &ids, steps.as_deref())
        })?;
        let shape = [copied.len()];
        into_array(py, copied, &shape)
    }

    #[doc = stub!("EpisodeBuffer.observe")]
    #[pyo3(signature = (streams=None, *, out=None))]
    fn observe<'py>(
        &self,
        py: Python<'py>,
        streams: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let streams = self.all_streams(streams)?;
        let fresh = || self.read(py, |buffer| Ok((buffer.observe(&streams)?, ())));
        let into = |out: &mut [u8]| self.read(py, |buffer| buffer.observe_into(&streams, out));
        let shape = rows(streams.len(), &self.config().observation_shape());
        Ok(filled_bytes(py, out, self.config().frame_item, &shape, fresh, into)?.0)
    }

    #[doc = stub!("EpisodeBuffer.observe_fields")]
    #[pyo3(signature = (streams=None))]
    fn observe_fields(
        &self,
        py: Python<'_>,
        streams: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyDict>> {
        let streams = self.all_streams(streams)?;
        let parts = self.read(py, |buffer| buffer.observe_fields(&streams))?;
        field::arrays(py, self.config(), parts, &[streams.len()], None)
    }

    #[doc = stub!("EpisodeBuffer.gather")]
    #[pyo3(signature = (ids, *, also=None, padded=false, out=None))]
    fn gather<'py>(
        &self,
        py: Python<'py>,
        ids: &Bound<'py, PyAny>,
        also: Option<(Bound<'py, Self>, Bound<'py, PyAny>)>,
        padded: bool,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<EpisodeBatch> {
        let ids = integer_vec("ids", ids)?;
        let taken = |(buffer, ids): (Bound<'py, Self>, Bound<'py, PyAny>)| {
            Ok::<_, PyErr>((buffer, integer_vec("also", &ids)?))
        };
        let also = also.map(taken).transpose()?;
        let also = also.as_ref().map(|(buffer, ids)| (buffer.get(), &ids[..]));
        self.gather_batch(py, &ids, also, out, layout(padded))
    }

    #[doc = stub!("EpisodeBuffer.sample_ids")]
    fn sample_ids<'py>(
        &self,
        py: Python<'py>,
        n: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let ids = self.sample_some_ids(size("n", n)?)?;
        let shape = [ids.len()];
        into_array(py, ids, &shape)
    }

    #[doc = stub!("EpisodeBuffer.sample_episodes")]
    #[pyo3(signature = (n, relabel=None, probability=None, on=None, *, padded=false, out=None),
           text_signature = "($self, n, relabel=None, probability=1.0, on=None, *, padded=False, out=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn sample_episodes(
        &self,
        py: Python<'_>,
        n: &Bound<'_, PyAny>,
        relabel: Option<&str>,
        probability: Option<f64>,
        on: Option<&Bound<'_, PyAny>>,
        padded: bool,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<EpisodeBatch> {
        if relabel.is_none() {
            refuse_without_strategy(&[
                ("probability", probability.is_some()),
                ("on", on.is_some()),
            ])?;
        }
        let probability = probability.unwrap_or(1.0);
        let rule = relabel.map(|strategy| rule(strategy, on, probability));
        let rule = rule.transpose()?;
        self.sample_batch(py, size("n", n)?, rule.as_ref(), layout(padded), out)
    }

    #[doc = stub!("EpisodeBuffer.sample_transitions")]
    #[pyo3(signature = (n, relabel=None, *, probability=None, ratio=None, on=None, reward=None, out=None,
                        n_step=None, gamma=None, beta=None),
           text_signature = "($self, n, relabel=None, *, probability=None, ratio=None, on=None, reward=None, \
                             out=None, n_step=1, gamma=None, beta=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn sample_transitions(
        &self,
        py: Python<'_>,
        n: &Bound<'_, PyAny>,
        relabel: Option<&str>,
        probability: Option<f64>,
        ratio: Option<&Bound<'_, PyAny>>,
        on: Option<&Bound<'_, PyAny>>,
        reward: Option<&Bound<'_, PyAny>>,
        out: Option<&Bound<'_, PyDict>>,
        n_step: Option<&Bound<'_, PyAny>>,
        gamma: Option<f64>,
        beta: Option<f64>,
    ) -> PyResult<TransitionBatch> {
        let rule = hindsight_rule(relabel, probability, ratio, on, reward)?;
        let reward = Reward::from_argument(reward)?;
        let draw = TransitionDraw {
            n: size("n", n)?,
            rule: rule.as_ref(),
            reward: reward.sparse(),
            n_step: n_step.map_or(Ok(1), |steps| size("n_step", steps))?,
            gamma,
            beta,
        };
        if draw.n_step > 1 {
            check_n_step(&reward)?;
        }
        self.transitions(py, &draw, &reward, out)
    }

    #[doc = stub!("EpisodeBuffer.update_priorities")]
    fn update_priorities(
        &self,
        py: Python<'_>,
        ids: &Bound<'_, PyAny>,
        steps: &Bound<'_, PyAny>,
        priorities: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let (ids, steps) = (integer_vec("ids", ids)?, integer_vec("steps", steps)?);
        let priorities = real_vec("priorities", priorities)?;
        self.write(py, |buffer| {
            buffer.update_priorities(&ids, &steps, &priorities)
        })
    }

    #[doc = stub!("EpisodeBuffer.sample_windows")]
    #[pyo3(signature = (n, length, burn_in=None, relabel=None, *, probability=None, ratio=None, on=None,
                        reward=None, out=None, strict=false),
           text_signature = "($self, n, length, burn_in=0, relabel=None, *, probability=None, ratio=None, \
                             on=None, reward=None, out=None, strict=False)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn sample_windows(
        &self,
        py: Python<'_>,
        n: &Bound<'_, PyAny>,
        length: &Bound<'_, PyAny>,
        burn_in: Option<&Bound<'_, PyAny>>,
        relabel: Option<&str>,
        probability: Option<f64>,
        ratio: Option<&Bound<'_, PyAny>>,
        on: Option<&Bound<'_, PyAny>>,
        reward: Option<&Bound<'_, PyAny>>,
        out: Option<&Bound<'_, PyAny>>,
        strict: bool,
    ) -> PyResult<WindowBatch> {
        let rule = hindsight_rule(relabel, probability, ratio, on, reward)?;
        let reward = Reward::from_argument(reward)?;
        let window = WindowShape {
            length: size("length", length)?,
            burn_in: burn_in.map_or(Ok(0), |burn_in| size("burn_in", burn_in))?,
            is_strict: strict,
        };
        self.windows(py, size("n", n)?, window, rule.as_ref(), &reward, out)
    }

    #[doc = stub!("EpisodeBuffer.clear")]
    fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.write(py, core::EpisodeBuffer::clear)
    }

    #[doc = stub!("EpisodeBuffer.reopen")]
    #[staticmethod]
    #[pyo3(signature = (path, *, check=true), text_signature = "(path, *, check=True)")]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn reopen(py: Python<'_>, path: PathBuf, check: bool) -> PyResult<Self> {
        // SAFETY: the stub passes the condition on to the caller.
        let reopened = interruptible(py, || unsafe { core::EpisodeBuffer::reopen(&path, check) });
        reopened.map(Self::from)
    }

    #[doc = stub!("EpisodeBuffer.save")]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        interruptible(py, || self.save_to(&path))
    }

    #[doc = stub!("EpisodeBuffer.load")]
    #[staticmethod]
    #[pyo3(signature = (path, *, mmap=false, backing=None),
           text_signature = "(path, *, mmap=False, backing='memory')")]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        mmap: bool,
        backing: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let backing = self::backing(backing)?;
        if mmap && backing != Backing::Memory {
            return Err(to_py(Error::Argument {
                field: "backing",
                expected: "\"memory\" where mmap is true".into(),
                got: "another".into(),
            }));
        }
        let loaded = interruptible(py, || {
            if mmap {
                // SAFETY: the stub passes the condition on to the caller.
                unsafe { core::EpisodeBuffer::map(&path) }
            } else {
                core::EpisodeBuffer::load(&path, backing)
            }
        });
        loaded.map(Self::from)
    }

    #[doc = stub!("EpisodeBuffer.verify")]
    #[staticmethod]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "made from a Python path for this call"
    )]
    fn verify(py: Python<'_>, path: PathBuf) -> PyResult<()> {
        interruptible(py, || core::EpisodeBuffer::verify(&path))
    }
}
