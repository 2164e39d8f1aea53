//! Goal prototypes `p^x` (paper, section 4.1, equation 4): for each class the mean feature of its
//! goal images.
//!
//! The default is a running mean, `p := m p + (1 - m) mean(batch)`, over features that the
//! contrastive loss computes anyway; `m = 0` is the paper's exact mean of the batch. A class that
//! has never been seen has no prototype: `embed` answers with a fresh N(0, 1) vector, redrawn on
//! each call.

use crate::labels::{MAX_CLASSES, class_of};
use vhs_base::check::{self, check_finite, check_fraction, check_labels, check_range, check_shape};
#[cfg(doc)]
use vhs_base::error::Error;
use vhs_base::error::Result;
use vhs_base::rng::Rng;

/// A table of one vector a class; see the module documentation.
///
/// ```
/// use vhs_core::prototypes::Prototypes;
/// let mut prototypes = Prototypes::new(2, 3, 0.9, 0)?;
/// prototypes.update(&[1.0, 2.0, 3.0, 3.0, 2.0, 1.0], &[1, 1])?;
/// assert_eq!(prototypes.embed(&[1])?, [2.0, 2.0, 2.0]);
/// assert_eq!(prototypes.seen(), [false, true]);
/// # Ok::<(), vhs_core::error::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Prototypes {
    dim: usize,
    /// Weight of the past, in 0..=1.
    momentum: f64,
    /// `[num_classes, dim]`; zero where a class has not been seen.
    table: Vec<f32>,
    seen: Vec<bool>,
    rng: Rng,
}

impl Prototypes {
    /// A table in which no class has been seen.
    ///
    /// # Errors
    /// [`Error::Argument`] for a size out of range or a momentum outside 0..=1, [`Error::Memory`].
    pub fn new(num_classes: usize, dim: usize, momentum: f64, seed: u64) -> Result<Self> {
        check_range("num_classes", num_classes, 1, MAX_CLASSES)?;
        check_range("dim", dim, 1, usize::MAX)?;
        check_fraction("momentum", momentum)?;
        let cells =
            check::product("dim", &[num_classes, dim, size_of::<f64>()])? / size_of::<f64>();
        let mut table = check::with_room("Prototypes", cells)?;
        table.resize(cells, 0.0);
        Ok(Self {
            dim,
            momentum,
            table,
            seen: vec![false; num_classes],
            rng: Rng::new(seed),
        })
    }

    /// Moves the prototype of each class in the batch towards the mean of its features; the first
    /// batch sets it.
    ///
    /// `features` holds one row of `dim` numbers a label.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Label`], [`Error::NonFinite`]; the table is then unchanged.
    pub fn update(&mut self, features: &[f32], labels: &[i64]) -> Result<()> {
        check_shape(
            "features",
            &[check::product("labels", &[labels.len(), self.dim])?],
            &[features.len()],
        )?;
        check_labels("labels", labels, self.seen.len())?;
        let (sums, counts) = self.sums(features, labels);
        // Numbers of single precision cannot overflow a sum in double precision: the sums are finite where all
        // features are, and they are far fewer.
        if !sums.iter().all(|sum| sum.is_finite()) {
            check_finite("features", features)?;
        }
        for (class, &count) in counts.iter().enumerate().filter(|&(_, &count)| count > 0.0) {
            let rows = class * self.dim..(class + 1) * self.dim;
            let past = if self.seen[class] { self.momentum } else { 0.0 };
            mix(&mut self.table[rows.clone()], &sums[rows], past, count);
            self.seen[class] = true;
        }
        Ok(())
    }

    /// One row of `dim` numbers a label: the prototype, or a fresh N(0, 1) vector where the class
    /// was never seen.
    ///
    /// # Errors
    /// [`Error::Label`], [`Error::Memory`].
    pub fn embed(&mut self, labels: &[i64]) -> Result<Vec<f32>> {
        let cells = check::product("labels", &[labels.len(), self.dim, size_of::<f32>()])?
            / size_of::<f32>();
        let mut out = check::with_room("embed", cells)?;
        out.resize(cells, 0.0);
        self.embed_into(labels, &mut out)?;
        Ok(out)
    }

    /// As [`Prototypes::embed`], into memory of the caller.
    ///
    /// # Errors
    /// As [`Prototypes::embed`], and [`Error::Shape`] where `out` is not one row a label.
    pub fn embed_into(&mut self, labels: &[i64], out: &mut [f32]) -> Result<()> {
        check_labels("labels", labels, self.seen.len())?;
        check_shape(
            "out",
            &[check::product("labels", &[labels.len(), self.dim])?],
            &[out.len()],
        )?;
        for (&label, out) in labels.iter().zip(out.chunks_exact_mut(self.dim)) {
            let class = class_of(label);
            if self.seen[class] {
                out.copy_from_slice(&self.table[class * self.dim..(class + 1) * self.dim]);
            } else {
                self.rng.fill_normal(out);
            }
        }
        Ok(())
    }

    /// Replaces table, seen classes and generator by those of another run, as when it is resumed.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`]; nothing is then replaced.
    pub fn restore(&mut self, table: &[f32], seen: &[bool], rng: Rng) -> Result<()> {
        check_shape("table", &[self.table.len()], &[table.len()])?;
        check_shape("seen", &[self.seen.len()], &[seen.len()])?;
        check_finite("table", table)?;
        self.table.copy_from_slice(table);
        self.seen.copy_from_slice(seen);
        self.rng = rng;
        Ok(())
    }

    /// Prototypes, `[num_classes, dim]`; zero where a class was never seen.
    #[must_use]
    pub fn table(&self) -> &[f32] {
        &self.table
    }

    /// Whether each class has a prototype.
    #[must_use]
    pub fn seen(&self) -> &[bool] {
        &self.seen
    }

    /// Goal classes.
    #[must_use]
    pub const fn num_classes(&self) -> usize {
        self.seen.len()
    }

    /// Numbers in one prototype.
    #[must_use]
    pub const fn dim(&self) -> usize {
        self.dim
    }

    /// Weight of the past in `update`.
    #[must_use]
    pub const fn momentum(&self) -> f64 {
        self.momentum
    }

    /// The generator behind `embed`, to be changed.
    pub const fn rng_mut(&mut self) -> &mut Rng {
        &mut self.rng
    }

    /// The generator behind `embed`.
    #[must_use]
    pub const fn rng(&self) -> &Rng {
        &self.rng
    }

    /// Sum of the features of each class, in double precision, and how many there were.
    fn sums(&self, features: &[f32], labels: &[i64]) -> (Vec<f64>, Vec<f64>) {
        let mut sums = vec![0.0; self.table.len()];
        let mut counts = vec![0.0; self.seen.len()];
        for &label in labels {
            counts[class_of(label)] += 1.0;
        }
        add_rows(&mut sums, features, labels, self.dim);
        (sums, counts)
    }
}

/// `row := past * row + (1 - past) * sum / count`.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a rounding to f32 is meant"
)]
fn mix(row: &mut [f32], sums: &[f64], past: f64, count: f64) {
    for (value, sum) in row.iter_mut().zip(sums) {
        *value = (past * f64::from(*value) + (1.0 - past) * sum / count) as f32;
    }
}

/// Adds each row of features to the sums of its class.
fn add_rows(sums: &mut [f64], features: &[f32], labels: &[i64], dim: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has what the function was compiled for; nothing else is asked of a caller.
        return unsafe { add_rows_avx2(sums, features, labels, dim) };
    }
    add_rows_plainly(sums, features, labels, dim);
}

/// The same code for processors with wide registers. Without fused operations it gives the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn add_rows_avx2(sums: &mut [f64], features: &[f32], labels: &[i64], dim: usize) {
    add_rows_plainly(sums, features, labels, dim);
}

#[inline(always)]
#[expect(
    clippy::inline_always,
    reason = "compiled anew for each kind of processor"
)]
fn add_rows_plainly(sums: &mut [f64], features: &[f32], labels: &[i64], dim: usize) {
    let mut order: Vec<usize> = (0..labels.len()).collect();
    order.sort_by_key(|&row| labels[row]); // stable: a class keeps the order of its rows
    for rows in order.chunk_by(|&a, &b| labels[a] == labels[b]) {
        let class = class_of(labels[rows[0]]);
        let sums = &mut sums[class * dim..(class + 1) * dim];
        let row = |row: usize| &features[row * dim..(row + 1) * dim];
        // Four rows at once: a sum is loaded and stored a quarter as often, and still added to in their order.
        let (quads, rest) = rows.as_chunks();
        for &[a, b, c, d] in quads {
            let parts = row(a).iter().zip(row(b)).zip(row(c).iter().zip(row(d)));
            for (sum, ((&a, &b), (&c, &d))) in sums.iter_mut().zip(parts) {
                *sum = *sum + f64::from(a) + f64::from(b) + f64::from(c) + f64::from(d);
            }
        }
        for &last in rest {
            for (sum, &feature) in sums.iter_mut().zip(row(last)) {
                *sum += f64::from(feature);
            }
        }
    }
}
