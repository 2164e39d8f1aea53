//! Drawing images from a goal store: balanced over the classes, uniform, or from one class.
//!
//! All draws are with replacement and come from the store's own generator, in an order that is part
//! of its output: the same seed and the same calls give the same batches. Sizes are checked before
//! the first draw, so that a refused call leaves the generator where it was.

use crate::goals::store::GoalStore;
use crate::labels::{class_of, label_of};
use crate::storage::pool::Bytes;
use crate::storage::slab::copy_parts;
use vhs_base::check::{self, check_labels, check_range, check_shape};
use vhs_base::error::{Error, Result};

/// How [`GoalStore::sample`] spreads its draws over the classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Balance {
    /// As equal as can be over the classes that hold an image, in random order.
    Classes,
    /// Uniform over all stored images.
    Images,
}

/// A drawn image.
#[derive(Clone, Copy, Debug)]
struct Pick {
    class: usize,
    slot: usize,
}

impl GoalStore {
    /// Draws `n` images with replacement: their bytes one after the other, and their classes.
    ///
    /// # Errors
    /// [`Error::Empty`] where the store is, [`Error::Argument`] for `n = 0`, [`Error::Memory`].
    pub fn sample(&mut self, n: usize, balance: Balance) -> Result<(Bytes, Vec<i64>)> {
        let mut images = self.room_for(n)?;
        let picks = self.draw(n, balance)?;
        copy_parts(picks.iter().map(|&pick| self.image(pick)), &mut images);
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
    /// [`Error::Label`], [`Error::Empty`] where the class is, [`Error::Argument`] for `n = 0`,
    /// [`Error::Memory`].
    pub fn sample_class(&mut self, label: i64, n: usize) -> Result<Bytes> {
        let mut images = self.room_for(n)?;
        let picks = self.draw_class(label, n)?;
        copy_parts(picks.iter().map(|&pick| self.image(pick)), &mut images);
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

    fn image(&self, pick: Pick) -> &[u8] {
        self.rings[pick.class].images.get(pick.slot)
    }

    /// Memory for `n` images. Comes before any draw, so that a refused size leaves the generator
    /// where it was.
    fn room_for(&self, n: usize) -> Result<Bytes> {
        Bytes::take("sample", check::product("n", &[n, self.image_bytes()])?)
    }

    fn check_out(&self, n: usize, out: &[u8]) -> Result<()> {
        check_shape(
            "out",
            &[check::product("n", &[n, self.image_bytes()])?],
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
        let mut picks = check::with_room("sample", n)?;
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
        // ends[c] = images in classes 0..=c: the class of a number is the first whose end lies
        // above it.
        let ends: Vec<usize> = self
            .counts()
            .scan(0, |end, count| {
                *end += count;
                Some(*end)
            })
            .collect();
        let total = self.len();
        let mut picks = check::with_room("sample", n)?;
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
        let mut picks = check::with_room("sample", n)?;
        picks.extend((0..n).map(|_| Pick {
            class,
            slot: self.rng.below(count),
        }));
        Ok(picks)
    }
}
