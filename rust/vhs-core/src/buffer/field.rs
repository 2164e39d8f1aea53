//! Further arrays beside the frames of a buffer: what each is, and what may be given of it.

use crate::item::Item;
use crate::storage::stacking::Stacking;
use vhs_base::check::{check_range, product};
use vhs_base::error::{Error, Result};

/// The most fields of a buffer.
pub(crate) const MAX_FIELDS: usize = 1 << 10;
/// The most bytes of a field's name.
pub(crate) const MAX_NAME: usize = 1 << 10;

/// What a field comes with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Per {
    /// Every observation, the first one of an episode and the final one too: T + 1 an episode.
    #[default]
    Observation = 0,
    /// Every action: T an episode.
    Step = 1,
}

/// One more array of every observation or step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// What it is called in batches.
    pub name: String,
    /// Its shape, each size at least 1; empty: one number.
    pub shape: Vec<usize>,
    /// Type of its elements.
    pub item: Item,
    /// What it comes with.
    pub per: Per,
    /// Whether an observation has that of each of its stacked frames, as it has the frames, or the newest alone.
    pub is_stacked: bool,
}

impl Field {
    /// Bytes of what is stored at once.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.shape.iter().product::<usize>() * self.item.bytes()
    }

    /// Shape of a row of a batch, where observations stack so many frames in such a way.
    #[must_use]
    pub fn row_shape(&self, frame_stack: usize, stacking: Stacking) -> Vec<usize> {
        if self.is_stacked {
            stacking.of_shape(&self.shape, frame_stack)
        } else {
            self.shape.clone()
        }
    }

    /// Bytes of a row of a batch.
    pub(crate) fn row_bytes(&self, frame_stack: usize) -> usize {
        self.bytes() * if self.is_stacked { frame_stack } else { 1 }
    }

    /// Refuses what cannot be stored.
    pub(crate) fn check(&self, frame_stack: usize) -> Result<()> {
        check_range("bytes of a field's name", self.name.len(), 1, MAX_NAME)?;
        let wrong = |expected: &str, got: String| {
            Err(Error::Argument {
                field: "fields",
                expected: format!("{expected} for `{}`", self.name),
                got,
            })
        };
        if self.shape.contains(&0) {
            return wrong("sizes of at least 1", format!("{:?}", self.shape));
        }
        if self.is_stacked && self.per == Per::Step {
            return wrong(
                "no stack of what comes with steps",
                "a stacked field".into(),
            );
        }
        product(
            "fields",
            &[&self.shape[..], &[self.item.bytes(), frame_stack, 4]].concat(),
        )
        .map(drop)
    }
}

/// Refuses fields that come twice, are too many, or cannot be stored.
pub(crate) fn check_fields(fields: &[Field], frame_stack: usize) -> Result<()> {
    check_range("fields", fields.len(), 0, MAX_FIELDS)?;
    for (place, field) in fields.iter().enumerate() {
        field.check(frame_stack)?;
        if fields[..place].iter().any(|other| other.name == field.name) {
            return Err(Error::Argument {
                field: "fields",
                expected: "each name once".into(),
                got: format!("`{}` twice", field.name),
            });
        }
    }
    Ok(())
}

/// Refuses bytes that are not those of `n` of each field, but none of those that `is_given` leaves out.
pub(crate) fn check_given(
    fields: &[Field],
    given: &[&[u8]],
    n: usize,
    is_given: impl Fn(&Field) -> bool,
) -> Result<()> {
    let wrong = |expected, got| {
        let field = "fields";
        Err(Error::Argument {
            field,
            expected,
            got,
        })
    };
    if given.len() != fields.len() {
        let expected = format!("bytes of {} fields", fields.len());
        return wrong(expected, format!("those of {}", given.len()));
    }
    for (field, bytes) in fields.iter().zip(given) {
        let expected = if is_given(field) {
            n * field.bytes()
        } else {
            0
        };
        if bytes.len() != expected {
            let expected = format!("{expected} bytes of `{}`", field.name);
            return wrong(expected, bytes.len().to_string());
        }
    }
    Ok(())
}
