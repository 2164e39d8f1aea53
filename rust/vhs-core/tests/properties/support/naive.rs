//! References that are too simple to be wrong: vectors and loops, no rings, no slots, no reuse.

use vhs_core::batch::BatchIndex;
use vhs_core::episodes::EpisodeConfig;
use vhs_core::outcome::Outcome;

/// An episode that owns every frame.
#[derive(Clone, Debug)]
pub(crate) struct Episode {
    pub(crate) id: i64,
    pub(crate) goal: i64,
    pub(crate) interaction: i64,
    pub(crate) outcome: Outcome,
    pub(crate) actions: Vec<i64>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) values: Vec<f32>,
    pub(crate) frames: Vec<Vec<u8>>,
}

impl Episode {
    /// Observation t: the last `stack` frames up to frame t, the first one repeated.
    pub(crate) fn observation(&self, t: usize, stack: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        for back in (0..stack).rev() {
            // No frame comes before the first.
            bytes.extend(&self.frames[t.saturating_sub(back)]);
        }
        bytes
    }

    pub(crate) fn final_observation(&self, stack: usize) -> Vec<u8> {
        self.observation(self.actions.len(), stack)
    }
}

/// The episode buffer.
pub(crate) struct Episodes {
    pub(crate) config: EpisodeConfig,
    pub(crate) open: Vec<Option<Episode>>,
    pub(crate) finished: Vec<Episode>,
    pub(crate) next_id: i64,
}

impl Episodes {
    pub(crate) fn new(config: EpisodeConfig) -> Self {
        let open = vec![None; config.num_streams];
        Self {
            config,
            open,
            finished: Vec::new(),
            next_id: 0,
        }
    }

    pub(crate) fn steps(&self) -> usize {
        let mut steps = 0;
        for episode in self.finished.iter().chain(self.open.iter().flatten()) {
            steps += episode.actions.len();
        }
        steps
    }

    pub(crate) fn begin(
        &mut self,
        stream: usize,
        frame: Vec<u8>,
        goal: i64,
        interaction: i64,
    ) -> bool {
        if self.open[stream].is_some() {
            return false;
        }
        self.open[stream] = Some(Episode {
            id: -1,
            goal,
            interaction,
            outcome: Outcome::Timeout,
            actions: Vec::new(),
            rewards: Vec::new(),
            values: Vec::new(),
            frames: vec![frame],
        });
        true
    }

    /// One step for each of these streams, or for none of them.
    pub(crate) fn append(&mut self, steps: &[(usize, i64, f32, f32, Vec<u8>)]) -> bool {
        for (place, (stream, ..)) in steps.iter().enumerate() {
            let Some(episode) = &self.open[*stream] else {
                return false;
            };
            let twice = steps[..place].iter().any(|(other, ..)| other == stream);
            if twice || episode.actions.len() == self.config.max_episode_steps {
                return false;
            }
        }
        while self.steps() + steps.len() > self.config.capacity_steps {
            self.finished.remove(0);
        }
        for (stream, action, reward, value, frame) in steps {
            let episode = self.open[*stream].as_mut().expect("checked above");
            episode.actions.push(*action);
            episode.rewards.push(*reward);
            episode.values.push(*value);
            episode.frames.push(frame.clone());
        }
        true
    }

    pub(crate) fn finish(&mut self, stream: usize, outcome: Outcome) -> Option<i64> {
        if self.open[stream].as_ref()?.actions.is_empty() {
            return None;
        }
        let mut episode = self.open[stream].take()?;
        episode.id = self.next_id;
        episode.outcome = outcome;
        self.finished.push(episode);
        self.next_id += 1;
        Some(self.next_id - 1)
    }

    pub(crate) fn abort(&mut self, stream: usize) -> bool {
        self.open[stream].take().is_some()
    }

    pub(crate) fn ids(&self) -> Vec<i64> {
        self.finished.iter().map(|episode| episode.id).collect()
    }

    pub(crate) fn episode(&self, id: i64) -> &Episode {
        self.finished
            .iter()
            .find(|episode| episode.id == id)
            .expect("a stored id")
    }

    /// Observations and the padded arrays, cell by cell.
    pub(crate) fn gather(&self, ids: &[i64]) -> (Vec<u8>, BatchIndex) {
        let mut index = BatchIndex::default();
        let mut observations = Vec::new();
        for &id in ids {
            index.longest = index.longest.max(self.episode(id).actions.len());
        }
        for &id in ids {
            let episode = self.episode(id);
            let length = episode.actions.len();
            index.ids.push(id);
            index.offsets.push(index.rows.try_into().expect("small"));
            index.lengths.push(length.try_into().expect("small"));
            index.goals.push(episode.goal);
            index.interactions.push(episode.interaction);
            index.outcomes.push(episode.outcome as u8);
            index.terminated.push(episode.outcome != Outcome::Timeout);
            for t in 0..index.longest {
                index.mask.push(t < length);
                index
                    .actions
                    .push(if t < length { episode.actions[t] } else { 0 });
                index
                    .rewards
                    .push(if t < length { episode.rewards[t] } else { 0.0 });
                index
                    .values
                    .push(if t < length { episode.values[t] } else { 0.0 });
            }
            for t in 0..=length {
                observations.extend(episode.observation(t, self.config.frame_stack));
                index.rows += 1;
            }
        }
        (observations, index)
    }
}

/// The goal store: for each class a list, oldest first.
pub(crate) struct Goals {
    pub(crate) classes: Vec<Vec<Vec<u8>>>,
    pub(crate) capacity: usize,
}

impl Goals {
    pub(crate) fn new(classes: usize, capacity: usize) -> Self {
        Self {
            classes: vec![Vec::new(); classes],
            capacity,
        }
    }

    pub(crate) fn push(&mut self, image: Vec<u8>, class: usize) {
        self.classes[class].push(image);
        if self.classes[class].len() > self.capacity {
            self.classes[class].remove(0);
        }
    }
}

/// Each return as its own sum, from the definition.
pub(crate) fn returns(rewards: &[f32], longest: usize, lengths: &[i64], gamma: f64) -> Vec<f64> {
    let mut returns = Vec::new();
    for (row, &length) in lengths.iter().enumerate() {
        let length = usize::try_from(length).expect("a length");
        for t in 0..longest {
            let mut sum = 0.0;
            for later in t..length {
                let power = i32::try_from(later - t).expect("small");
                sum += gamma.powi(power) * f64::from(rewards[row * longest + later]);
            }
            returns.push(sum);
        }
    }
    returns
}

/// One prototype update, class by class.
pub(crate) fn update(
    table: &mut [Vec<f64>],
    seen: &mut [bool],
    momentum: f64,
    batch: &[(usize, Vec<f32>)],
) {
    for class in 0..table.len() {
        let rows: Vec<_> = batch.iter().filter(|(label, _)| *label == class).collect();
        if rows.is_empty() {
            continue;
        }
        for place in 0..table[class].len() {
            let mut mean = 0.0;
            for (_, row) in &rows {
                mean += f64::from(row[place]);
            }
            mean /= f64::from(u32::try_from(rows.len()).expect("small"));
            let past = if seen[class] { momentum } else { 0.0 };
            table[class][place] = past * table[class][place] + (1.0 - past) * mean;
        }
        seen[class] = true;
    }
}
