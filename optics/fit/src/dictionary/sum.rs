//! Sums over pixels in double precision, in an order that is the same on every machine.

/// Partial sums that run side by side; the compiler keeps them in vectors.
const LANES: usize = 8;

/// Σ f(a_i, b_i). The terms i, i + 8, i + 16, … form one partial sum each; these are added up pairwise.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn striped<A: Into<f64> + Copy, B: Into<f64> + Copy>(a: &[A], b: &[B], f: impl Fn(f64, f64) -> f64) -> f64 {
    debug_assert_eq!(a.len(), b.len());
    let mut sums = [0.0; LANES];
    let (a_chunks, a_rest) = a.as_chunks::<LANES>();
    let (b_chunks, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a_chunks.iter().zip(b_chunks) {
        for i in 0..LANES {
            sums[i] += f(a[i].into(), b[i].into());
        }
    }
    for (i, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        sums[i] += f((*a).into(), (*b).into());
    }
    of_lanes(sums)
}

#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn of_lanes([a, b, c, d, e, f, g, h]: [f64; LANES]) -> f64 {
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

/// Adds a multiple of values.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn add_multiple<T: Into<f64> + Copy>(sum: &mut [f64], weight: f64, values: &[T]) {
    sum.iter_mut().zip(values).for_each(|(s, v)| *s += weight * (*v).into());
}

/// Root mean square of a_i − b_i.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn rms_difference(a: &[f64], b: &[f32]) -> f64 {
    (striped(a, b, |a, b| (a - b) * (a - b)) / a.len() as f64).sqrt()
}

/// Mean of a_i b_i.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn mean_product(a: &[f64], b: &[f32]) -> f64 {
    striped(a, b, |a, b| a * b) / a.len() as f64
}

/// Mean of a_i².
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn mean_square<A: Into<f64> + Copy>(a: &[A]) -> f64 {
    striped(a, a, |a, b| a * b) / a.len() as f64
}

/// Mean of a_i.
pub(crate) fn mean(a: &[f32]) -> f64 {
    a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64
}

/// Root mean square.
pub(crate) fn rms(a: &[f64]) -> f64 {
    mean_square(a).sqrt()
}

/// Σ a_i b_i.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    striped(a, b, |a, b| a * b)
}

/// Σ a_i b_i with each of `N` b. The sums run side by side, since a single one mostly waits for its last addition.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn dots<const N: usize>(a: &[f64], b: [&[f64]; N]) -> [f64; N] {
    let whole = a.len() / LANES * LANES;
    let mut sums = [[0.0; LANES]; N];
    for at in (0..whole).step_by(LANES) {
        let a: &[f64; LANES] = a[at..].first_chunk().expect("it is whole");
        for (sums, b) in sums.iter_mut().zip(b) {
            let b: &[f64; LANES] = b[at..].first_chunk().expect("all are as long as `a`");
            for i in 0..LANES {
                sums[i] += a[i] * b[i];
            }
        }
    }
    for (sums, b) in sums.iter_mut().zip(b) {
        for (i, (a, b)) in a[whole..].iter().zip(&b[whole..]).enumerate() {
            sums[i] += a * b;
        }
    }
    sums.map(of_lanes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums over stripes include every term once.
    #[test]
    fn striped_sums_include_every_term_once() {
        for n in [1, 7, 8, 9, 31] {
            let a: Vec<f64> = (0..n).map(f64::from).collect();
            let b: Vec<f32> = (0..n).map(|i| 2.0 * i as f32 + 1.0).collect();
            let plain = |f: &dyn Fn(f64, f64) -> f64| {
                a.iter().zip(&b).map(|(a, b)| f(*a, f64::from(*b))).sum::<f64>() / f64::from(n)
            };
            assert_eq!(mean_product(&a, &b), plain(&|a, b| a * b));
            assert_eq!(mean_square(&b), plain(&|_, b| b * b));
            assert_eq!(rms_difference(&a, &b), plain(&|a, b| (a - b).powi(2)).sqrt());
            let twice: Vec<f64> = a.iter().map(|a| 2.0 * a).collect();
            assert_eq!(dots(&a, [&a, &twice]), [dot(&a, &a), dot(&a, &twice)]);
        }
    }
}
