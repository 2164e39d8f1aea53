//! Vectors, and the few functions whose last bit must not depend on the machine.
//!
//! Invariant: plain f32 and f64 operations in a fixed order. IEEE 754 defines add, multiply, divide and
//! square root to the last bit; the platform's `powf` and `sin` are not, so they are not used.

/// A vector of three f32.
pub(crate) type V3 = [f32; 3];

/// Sum.
#[inline(always)]
pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference.
#[inline(always)]
pub(crate) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Product with a number.
#[inline(always)]
pub(crate) fn scale(a: V3, k: f32) -> V3 {
    [a[0] * k, a[1] * k, a[2] * k]
}

/// Product, component by component.
#[inline(always)]
pub(crate) fn times(a: V3, b: V3) -> V3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

/// Inner product.
#[inline(always)]
pub(crate) fn dot(a: V3, b: V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product; swapping the arguments negates it exactly, on which watertight edges rely.
#[inline(always)]
pub(crate) fn cross(a: V3, b: V3) -> V3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The vector at length 1; a zero vector points along z.
#[inline(always)]
pub(crate) fn normalize(a: V3) -> V3 {
    let length = dot(a, a).sqrt();
    if length < 1e-10 {
        [0.0, 0.0, 1.0]
    } else {
        scale(a, 1.0 / length)
    }
}

/// Row-major 3x3 matrix times vector.
#[inline(always)]
pub(crate) fn mul3(m: &[f32; 9], v: V3) -> V3 {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
        m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
    ]
}

/// Largest integer not above `x`, as i32; without a call where the machine lacks a rounding instruction.
#[inline(always)]
pub(crate) fn floor_i32(x: f32) -> i32 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "saturation is wanted for huge values"
    )]
    let truncated = x as i32;
    #[expect(
        clippy::cast_precision_loss,
        reason = "values are below 2^24 wherever the result is used"
    )]
    let whole = truncated as f32;
    truncated - i32::from(whole > x)
}

/// `base` to the power `exponent`, for `base` in 0..=1 and `exponent >= 0`, by the same steps everywhere.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounding to f32; small whole exponents"
)]
pub(crate) fn pow_unit(base: f32, exponent: f32) -> f32 {
    let whole = exponent as u32;
    #[expect(
        clippy::cast_precision_loss,
        clippy::float_cmp,
        reason = "exact for small whole numbers"
    )]
    let is_whole = whole <= 1024 && whole as f32 == exponent;
    if !is_whole {
        return libm::pow(f64::from(base), f64::from(exponent)) as f32;
    }
    // Squaring takes a tenth of the time, and shininess is mostly a multiple of 1/128.
    let (mut result, mut square, mut left) = (1.0_f64, f64::from(base), whole);
    while left != 0 {
        if left & 1 == 1 {
            result *= square;
        }
        square *= square;
        left >>= 1;
    }
    result as f32
}
