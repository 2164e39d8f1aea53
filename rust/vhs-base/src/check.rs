//! Checks of arguments that several calls make. Each accepts what is right and names what is not.

use crate::error::{Error, Result};

/// Accepts `got` when it is exactly `expected`.
///
/// # Errors
/// [`Error::Shape`] otherwise.
pub fn check_shape(field: &'static str, expected: &[usize], got: &[usize]) -> Result<()> {
    if expected == got {
        return Ok(());
    }
    Err(Error::Shape {
        field,
        expected: expected.to_vec(),
        got: got.to_vec(),
    })
}

/// Accepts a number in `low..=high`.
///
/// # Errors
/// [`Error::Argument`] otherwise.
pub fn check_range(field: &'static str, got: usize, low: usize, high: usize) -> Result<()> {
    if (low..=high).contains(&got) {
        return Ok(());
    }
    let expected = format!("a number in {low}..={high}");
    Err(Error::Argument {
        field,
        expected,
        got: got.to_string(),
    })
}

/// Accepts a probability or a fraction: a number in 0..=1, not NaN.
///
/// # Errors
/// [`Error::Argument`] otherwise.
pub fn check_fraction(field: &'static str, got: f64) -> Result<()> {
    if (0.0..=1.0).contains(&got) {
        return Ok(());
    }
    Err(Error::Argument {
        field,
        expected: "a number in 0..=1".into(),
        got: got.to_string(),
    })
}

/// Accepts numbers in `0..limit`.
///
/// # Errors
/// [`Error::Label`] names the first that is not.
pub fn check_labels(field: &'static str, labels: &[i64], limit: usize) -> Result<()> {
    let bad = |&got: &i64| usize::try_from(got).map_or(true, |label| label >= limit);
    match labels.iter().position(bad) {
        None => Ok(()),
        Some(index) => Err(Error::Label {
            field,
            index,
            limit,
            got: labels[index],
        }),
    }
}

/// Accepts finite numbers.
///
/// # Errors
/// [`Error::NonFinite`] names the first that is not.
pub fn check_finite(field: &'static str, numbers: &[f32]) -> Result<()> {
    // One pass without an early exit: it vectorises, and the search for the culprit runs only after
    // a hit.
    if numbers
        .iter()
        .fold(true, |all, number| all & number.is_finite())
    {
        return Ok(());
    }
    let index = numbers
        .iter()
        .position(|number| !number.is_finite())
        .unwrap_or_default();
    Err(Error::NonFinite {
        field,
        index,
        got: numbers[index],
    })
}

/// Multiplies sizes, refusing a product that no allocation can have.
///
/// # Errors
/// [`Error::Argument`] where it has more bytes than memory can address.
pub fn product(field: &'static str, sizes: &[usize]) -> Result<usize> {
    let limit = isize::MAX.unsigned_abs();
    let total = sizes
        .iter()
        .try_fold(1_usize, |total, &size| total.checked_mul(size));
    total.filter(|&total| total <= limit).ok_or_else(|| {
        let factors: Vec<String> = sizes.iter().map(ToString::to_string).collect();
        let expected = format!("a total of at most {limit} bytes");
        Error::Argument {
            field,
            expected,
            got: factors.join(" * "),
        }
    })
}

/// An empty vector with room for exactly `len` items.
///
/// # Errors
/// [`Error::Memory`] under the name `place`.
pub fn with_room<T>(place: &'static str, len: usize) -> Result<Vec<T>> {
    let mut items = Vec::new();
    let bytes = len.saturating_mul(size_of::<T>());
    items
        .try_reserve_exact(len)
        .map_err(|_| Error::Memory { place, bytes })?;
    Ok(items)
}
