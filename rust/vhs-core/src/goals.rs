//! The goal store `D_g` (paper, section 3.2): for each goal class a ring of final observations of successful episodes.
//!
//! Invariants: an image enters under the class that was *instructed*, never under that of a wrongly reached object
//! (the agent does not know it); a full ring overwrites its oldest image; memory is allocated as the rings fill.

use crate::episodes::EpisodeBuffer;
use crate::error::{self, Error, Result, check_labels, check_range, check_shape};
use crate::outcome::Outcome;
use crate::rng::Rng;
use crate::slab::{Slab, copy_parts};

/// The most classes a store or a prototype table can have; a sample walks over all of them.
pub const MAX_CLASSES: usize = 1 << 20;

/// How [`GoalStore::sample`] spreads its draws over the classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Balance {
    /// As equal as can be over the classes that hold an image, in random order.
    Classes,
    /// Uniform over all stored images.
    Images,
}

/// Images of achieved goals by class; see the module documentation.
///
/// ```
/// use vhs_core::goals::{Balance, GoalStore};
/// let mut store = GoalStore::new(2, &[2, 2], 100, 0)?;
/// store.push(&[1, 2, 3, 4], 0)?;
/// store.push(&[5, 6, 7, 8], 1)?;
/// let (images, labels) = store.sample(4, Balance::Classes)?;
/// assert_eq!(images.len(), 16);
/// assert_eq!(labels.iter().filter(|&&label| label == 0).count(), 2);
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Debug)]
pub struct GoalStore {
    shape: Vec<usize>,
    /// Bytes of one image: the product of `shape`.
    image_bytes: usize,
    /// Images a class holds at most, at least 1.
    capacity: usize,
    rings: Vec<Ring>,
    rng: Rng,
}

/// The images of one class.
#[derive(Debug)]
pub(crate) struct Ring {
    pub(crate) images: Slab,
    /// Where the next image goes, in 0..capacity; the oldest image once the ring is full.
    pub(crate) next: usize,
}

/// A drawn image.
#[derive(Clone, Copy, Debug)]
struct Pick {
    class: usize,
    slot: usize,
}

impl GoalStore {
    /// An empty store; `shape` is that of one image, uint8.
    ///
    /// # Errors
    /// [`Error::Argument`] for a size of zero or sizes whose product no memory can hold.
    pub fn new(
        num_classes: usize,
        shape: &[usize],
        capacity_per_class: usize,
        seed: u64,
    ) -> Result<Self> {
        check_range("num_classes", num_classes, 1, MAX_CLASSES)?;
        check_range("capacity_per_class", capacity_per_class, 1, usize::MAX)?;
        let image_bytes = image_bytes("observation_shape", shape)?;
        error::product(
            "capacity_per_class",
            &[num_classes, capacity_per_class, image_bytes],
        )?;
        let rings = (0..num_classes)
            .map(|_| Ring {
                images: Slab::new(image_bytes),
                next: 0,
            })
            .collect();
        Ok(Self {
            shape: shape.to_vec(),
            image_bytes,
            capacity: capacity_per_class,
            rings,
            rng: Rng::new(seed),
        })
    }

    /// Stores a copy of `image` under `label`, over the oldest image of that class where it is full.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Label`], or [`Error::Memory`]; the store is then unchanged.
    pub fn push(&mut self, image: &[u8], label: i64) -> Result<()> {
        check_shape("observation", &[self.image_bytes], &[image.len()])?;
        check_labels("label", &[label], self.rings.len())?;
        self.put(class_of(label), std::iter::once(image))
    }

    /// Stores the final observation of each *successful* episode among `ids` under its instructed goal.
    ///
    /// Other episodes are skipped: what a failed episode reached is not known to the agent. Returns how many were stored.
    ///
    /// # Errors
    /// [`Error::Shape`] where an observation of the buffer is not an image of this store, [`Error::Label`] where a goal
    /// is not a class, [`Error::Evicted`] or [`Error::UnknownEpisode`]; the store is then unchanged.
    pub fn collect(&mut self, buffer: &EpisodeBuffer, ids: &[i64]) -> Result<usize> {
        check_shape(
            "buffer observations",
            &self.shape,
            &buffer.observation_shape(),
        )?;
        let episodes: Vec<_> = ids
            .iter()
            .map(|&id| buffer.episode(id))
            .collect::<Result<_>>()?;
        let successes: Vec<_> = episodes
            .into_iter()
            .filter(|e| e.outcome() == Outcome::Success)
            .collect();
        let goals: Vec<i64> = successes.iter().map(|episode| episode.goal()).collect();
        check_labels("goal", &goals, self.rings.len())?;
        for (episode, &goal) in successes.iter().zip(&goals) {
            self.put(
                class_of(goal),
                buffer.observation_frames(episode, episode.len()),
            )?;
        }
        Ok(successes.len())
    }

    /// Draws `n` images with replacement: their bytes one after the other, and their classes.
    ///
    /// # Errors
    /// [`Error::Empty`] where the store is, [`Error::Argument`] for `n = 0`, [`Error::Memory`].
    pub fn sample(&mut self, n: usize, balance: Balance) -> Result<(Vec<u8>, Vec<i64>)> {
        let mut images = self.room_for(n)?;
        let picks = self.draw(n, balance)?;
        picks
            .iter()
            .for_each(|&pick| images.extend_from_slice(self.image(pick)));
        Ok((
            images,
            picks.iter().map(|pick| label_of(pick.class)).collect(),
        ))
    }

    /// As [`GoalStore::sample`], into memory of the caller: `n` images' bytes.
    ///
    /// # Errors
    /// As [`GoalStore::sample`], and [`Error::Shape`] where `out` is not `n` images long.
    pub fn sample_into(&mut self, n: usize, balance: Balance, out: &mut [u8]) -> Result<Vec<i64>> {
        self.check_out(n, out)?;
        let picks = self.draw(n, balance)?;
        copy_parts(picks.iter().map(|&pick| self.image(pick)), out);
        Ok(picks.iter().map(|pick| label_of(pick.class)).collect())
    }

    /// Draws `n` images of one class with replacement: their bytes one after the other.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Empty`] where the class is, [`Error::Argument`] for `n = 0`, [`Error::Memory`].
    pub fn sample_class(&mut self, label: i64, n: usize) -> Result<Vec<u8>> {
        let mut images = self.room_for(n)?;
        let picks = self.draw_class(label, n)?;
        picks
            .iter()
            .for_each(|&pick| images.extend_from_slice(self.image(pick)));
        Ok(images)
    }

    /// As [`GoalStore::sample_class`], into memory of the caller: `n` images' bytes.
    ///
    /// # Errors
    /// As [`GoalStore::sample_class`], and [`Error::Shape`] where `out` is not `n` images long.
    pub fn sample_class_into(&mut self, label: i64, n: usize, out: &mut [u8]) -> Result<()> {
        self.check_out(n, out)?;
        let picks = self.draw_class(label, n)?;
        copy_parts(picks.iter().map(|&pick| self.image(pick)), out);
        Ok(())
    }

    /// Images stored of each class.
    pub fn counts(&self) -> impl Iterator<Item = usize> {
        self.rings.iter().map(|ring| ring.images.len())
    }

    /// Images stored in all.
    #[must_use]
    pub fn len(&self) -> usize {
        self.counts().sum()
    }

    /// Whether no image is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Goal classes, stored or not.
    #[must_use]
    pub const fn num_classes(&self) -> usize {
        self.rings.len()
    }

    /// Images that a class holds at most.
    #[must_use]
    pub const fn capacity_per_class(&self) -> usize {
        self.capacity
    }

    /// Shape of one image.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Bytes set aside for images; grows as the rings fill.
    #[must_use]
    pub fn allocated_bytes(&self) -> usize {
        self.rings
            .iter()
            .map(|ring| ring.images.allocated_bytes())
            .sum()
    }

    pub(crate) const fn image_bytes(&self) -> usize {
        self.image_bytes
    }

    pub(crate) const fn rng(&self) -> &Rng {
        &self.rng
    }

    pub(crate) fn rng_mut(&mut self) -> &mut Rng {
        &mut self.rng
    }

    pub(crate) fn rings(&self) -> &[Ring] {
        &self.rings
    }

    pub(crate) fn rings_mut(&mut self) -> &mut [Ring] {
        &mut self.rings
    }

    fn put<'a>(&mut self, class: usize, parts: impl Iterator<Item = &'a [u8]>) -> Result<()> {
        let ring = &mut self.rings[class];
        ring.images.put(ring.next, parts)?;
        ring.next = (ring.next + 1) % self.capacity;
        Ok(())
    }

    fn image(&self, pick: Pick) -> &[u8] {
        self.rings[pick.class].images.get(pick.slot)
    }

    /// Memory for `n` images. Comes before any draw, so that a refused size leaves the generator where it was.
    fn room_for(&self, n: usize) -> Result<Vec<u8>> {
        error::with_room("sample", error::product("n", &[n, self.image_bytes])?)
    }

    fn check_out(&self, n: usize, out: &[u8]) -> Result<()> {
        check_shape(
            "out",
            &[error::product("n", &[n, self.image_bytes])?],
            &[out.len()],
        )
    }

    fn draw(&mut self, n: usize, balance: Balance) -> Result<Vec<Pick>> {
        check_range("n", n, 1, usize::MAX)?;
        if self.is_empty() {
            return Err(Error::Empty {
                place: "GoalStore".into(),
                item: "image",
            });
        }
        match balance {
            Balance::Classes => self.draw_balanced(n),
            Balance::Images => self.draw_uniform(n),
        }
    }

    fn draw_balanced(&mut self, n: usize) -> Result<Vec<Pick>> {
        let mut filled: Vec<usize> = (0..self.rings.len())
            .filter(|&c| self.rings[c].images.len() > 0)
            .collect();
        // In random order, so that the draws left over by the division fall on random classes.
        self.rng.shuffle(&mut filled);
        let mut picks = error::with_room("sample", n)?;
        picks.extend(
            filled
                .iter()
                .cycle()
                .take(n)
                .map(|&class| Pick { class, slot: 0 }),
        );
        self.rng.shuffle(&mut picks);
        for pick in &mut picks {
            pick.slot = self.rng.below(self.rings[pick.class].images.len());
        }
        Ok(picks)
    }

    fn draw_uniform(&mut self, n: usize) -> Result<Vec<Pick>> {
        // ends[c] = images in classes 0..=c: the class of a number is the first whose end lies above it.
        let ends: Vec<usize> = self
            .counts()
            .scan(0, |end, count| {
                *end += count;
                Some(*end)
            })
            .collect();
        let total = self.len();
        let mut picks = error::with_room("sample", n)?;
        for _ in 0..n {
            let number = self.rng.below(total);
            let class = ends.partition_point(|&end| end <= number);
            let slot = number - (ends[class] - self.rings[class].images.len());
            picks.push(Pick { class, slot });
        }
        Ok(picks)
    }

    fn draw_class(&mut self, label: i64, n: usize) -> Result<Vec<Pick>> {
        check_range("n", n, 1, usize::MAX)?;
        check_labels("label", &[label], self.rings.len())?;
        let class = class_of(label);
        let count = self.rings[class].images.len();
        if count == 0 {
            return Err(Error::Empty {
                place: format!("GoalStore class {label}"),
                item: "image",
            });
        }
        let mut picks = error::with_room("sample", n)?;
        picks.extend((0..n).map(|_| Pick {
            class,
            slot: self.rng.below(count),
        }));
        Ok(picks)
    }
}

/// Bytes of one uint8 image; refuses shapes without content.
pub(crate) fn image_bytes(field: &'static str, shape: &[usize]) -> Result<usize> {
    if shape.is_empty() || shape.contains(&0) {
        let expected = "one or more sizes, each at least 1".into();
        return Err(Error::Argument {
            field,
            expected,
            got: format!("{shape:?}"),
        });
    }
    error::product(field, shape)
}

/// A label that has passed `check_labels`, as an index.
pub(crate) fn class_of(label: i64) -> usize {
    usize::try_from(label).unwrap_or(usize::MAX)
}

/// A class below `MAX_CLASSES`, as a label.
pub(crate) fn label_of(class: usize) -> i64 {
    i64::try_from(class).unwrap_or(i64::MAX)
}
