//! The goal store `D_g` (paper, section 3.2): for each goal class a ring of final observations of
//! successful episodes.
//!
//! Invariants: an image enters under the class that was *instructed*, never under that of a wrongly
//! reached object (the agent does not know it); a full ring overwrites its oldest image; memory is
//! allocated as the rings fill.

use std::collections::HashMap;

use crate::buffer::episodes::EpisodeBuffer;
use crate::item::{Item, volume};
use crate::labels::{MAX_CLASSES, class_of};
use crate::outcome::Outcome;
use crate::storage::slab::{Slab, Source};
use crate::storage::stacking::interleave;
use vhs_base::check::{self, check_labels, check_range, check_shape};
use vhs_base::error::{Error, Result};
use vhs_base::fork;
use vhs_base::rng::Rng;

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
    pub(crate) rings: Vec<Ring>,
    pub(crate) rng: Rng,
    /// Saves under way.
    pub(crate) stashes: Vec<Stash>,
}

/// Images that a save under way may still want, and that were overwritten since it began.
#[derive(Debug)]
pub(crate) struct Stash {
    /// Tells the saves of a store apart.
    pub(crate) number: u64,
    /// Of the process that began it: in a forked copy nobody ends it.
    pub(crate) lineage: u64,
    /// By class and slot.
    pub(crate) images: HashMap<(usize, usize), Box<[u8]>>,
}

/// The images of one class.
#[derive(Debug)]
pub(crate) struct Ring {
    pub(crate) images: Slab,
    /// Where the next image goes, in 0..capacity; the oldest image once the ring is full.
    pub(crate) next: usize,
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
        let image_bytes = volume("observation_shape", shape)?;
        check::product(
            "capacity_per_class",
            &[num_classes, capacity_per_class, image_bytes],
        )?;
        let rings = (0..num_classes)
            .map(|_| Ring {
                images: Slab::new(image_bytes, capacity_per_class, Source::Memory),
                next: 0,
            })
            .collect();
        Ok(Self {
            shape: shape.to_vec(),
            image_bytes,
            capacity: capacity_per_class,
            rings,
            rng: Rng::new(seed),
            stashes: Vec::new(),
        })
    }

    /// Stores a copy of `image` under `label`, over the oldest image of that class where it is
    /// full.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Label`], or [`Error::Memory`]; the store is then unchanged.
    pub fn push(&mut self, image: &[u8], label: i64) -> Result<()> {
        check_shape("observation", &[self.image_bytes], &[image.len()])?;
        check_labels("label", &[label], self.rings.len())?;
        self.put(class_of(label), image)
    }

    /// Stores the final observation of each *successful* episode among `ids` under its instructed
    /// goal.
    ///
    /// Other episodes are skipped: what a failed episode reached is not known to the agent. Returns
    /// how many were stored.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Argument`] where an observation of the buffer is not an image of
    /// this store, [`Error::Label`] where a goal is not a class, [`Error::Evicted`],
    /// [`Error::UnknownEpisode`] or [`Error::Memory`]; the store is then unchanged.
    pub fn collect(&mut self, buffer: &EpisodeBuffer, ids: &[i64]) -> Result<usize> {
        check_shape(
            "buffer observations",
            &self.shape,
            &buffer.observation_shape(),
        )?;
        if buffer.config().frame_item != Item::U8 {
            return Err(Error::Argument {
                field: "buffer",
                expected: "observations of unsigned bytes, as images are".into(),
                got: format!("{:?}", buffer.config().frame_item),
            });
        }
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
        self.reserve(&goals)?;
        let mut image = vec![0; self.image_bytes];
        for (episode, &goal) in successes.iter().zip(&goals) {
            buffer.write_observation(episode, episode.len(), &mut image);
            self.put(class_of(goal), &image)?;
        }
        Ok(successes.len())
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

    /// The generator behind `sample`, to be saved and restored.
    pub const fn rng_mut(&mut self) -> &mut Rng {
        &mut self.rng
    }

    /// The same store, its images, where they were stored as stacks of frames, [S, H, W, C], as the channels of
    /// one picture each, [H, W, S * C]: for a buffer that stacks so. Images of another number of axes stay.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn into_channels(mut self) -> Result<Self> {
        let &[stack, height, width, colours] = &self.shape[..] else {
            return Ok(self);
        };
        let mut picture = check::with_room("GoalStore", self.image_bytes)?;
        picture.resize(self.image_bytes, 0);
        for ring in &mut self.rings {
            for slot in 0..ring.images.len() {
                let frames = ring.images.get(slot).chunks_exact(height * width * colours);
                interleave(frames, colours, &mut picture);
                ring.images.put(slot, &picture)?;
            }
        }
        self.shape = vec![height, width, stack * colours];
        Ok(self)
    }

    pub(crate) const fn image_bytes(&self) -> usize {
        self.image_bytes
    }

    /// Makes room for one more image of each of these classes, so that storing them cannot fail
    /// half-way.
    fn reserve(&mut self, labels: &[i64]) -> Result<()> {
        let mut wanted = vec![0_usize; self.rings.len()];
        for &label in labels {
            wanted[class_of(label)] += 1;
        }
        for (ring, wanted) in self.rings.iter_mut().zip(wanted) {
            ring.images
                .reserve(wanted.min(self.capacity - ring.images.len()))?;
        }
        Ok(())
    }

    fn put(&mut self, class: usize, image: &[u8]) -> Result<()> {
        let ring = &mut self.rings[class];
        if !self.stashes.is_empty() && ring.next < ring.images.len() {
            self.stashes
                .retain(|stash| stash.lineage == fork::lineage());
            for stash in &mut self.stashes {
                let kept = stash.images.entry((class, ring.next));
                kept.or_insert_with(|| ring.images.get(ring.next).into());
            }
        }
        ring.images.put(ring.next, image)?;
        ring.next = (ring.next + 1) % self.capacity;
        Ok(())
    }
}
