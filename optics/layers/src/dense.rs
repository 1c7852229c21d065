//! Products and solutions of square systems, the same to the last bit on every machine: no operation is fused, and every
//! sum has a fixed order.

use fearless_simd::{Level, dispatch};
use nalgebra::DMatrix;

/// Rows and columns of a product that are summed side by side.
const ROWS: usize = 8;
const COLUMNS: usize = 4;

/// A B.
pub(crate) fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    assert_eq!(a.ncols(), b.nrows(), "shapes of a product agree");
    let mut product = DMatrix::zeros(a.nrows(), b.ncols());
    let shape = [a.nrows(), a.ncols()];
    dispatch!(Level::new(), _simd => multiply(shape, a.as_slice(), b.as_slice(), product.as_mut_slice()));
    product
}

/// A⁻¹ B.
pub(crate) fn solved(mut a: DMatrix<f64>, mut b: DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows();
    assert_eq!([a.ncols(), b.nrows()], [n; 2], "shapes of a system agree");
    dispatch!(Level::new(), _simd => eliminate(n, a.as_mut_slice(), b.as_mut_slice()));
    b
}

#[expect(clippy::inline_always, reason = "is compiled for the instruction set that was chosen at run time")]
#[inline(always)]
fn multiply([rows, inner]: [usize; 2], a: &[f64], b: &[f64], product: &mut [f64]) {
    for (columns, b) in product.chunks_mut(rows * COLUMNS).zip(b.chunks(inner * COLUMNS)) {
        let mut first = 0;
        while first + ROWS <= rows && columns.len() == rows * COLUMNS {
            let mut sums = [[0.0; ROWS]; COLUMNS];
            for k in 0..inner {
                let a: &[f64; ROWS] = a[k * rows + first..][..ROWS].try_into().expect("that many rows");
                for (j, sums) in sums.iter_mut().enumerate() {
                    let factor = b[j * inner + k];
                    for (sum, a) in sums.iter_mut().zip(a) {
                        *sum += a * factor;
                    }
                }
            }
            for (j, sums) in sums.iter().enumerate() {
                columns[j * rows + first..][..ROWS].copy_from_slice(sums);
            }
            first += ROWS;
        }
        for (column, b) in columns.chunks_mut(rows).zip(b.chunks(inner)) {
            for (k, factor) in b.iter().enumerate() {
                let a = &a[k * rows + first..(k + 1) * rows];
                column[first..].iter_mut().zip(a).for_each(|(sum, a)| *sum += a * factor);
            }
        }
    }
}

/// Gaussian elimination with partial pivoting; the right sides become the solutions.
#[expect(clippy::inline_always, reason = "is compiled for the instruction set that was chosen at run time")]
#[inline(always)]
fn eliminate(n: usize, matrix: &mut [f64], sides: &mut [f64]) {
    for k in 0..n {
        let column = &matrix[k * n..(k + 1) * n];
        let pivot = (k..n).fold(k, |best, i| if column[i].abs() > column[best].abs() { i } else { best });
        let (done, rest) = matrix.split_at_mut((k + 1) * n);
        let column = &mut done[k * n..];
        column.swap(k, pivot);
        let inverse = 1.0 / column[k];
        for factor in &mut column[k + 1..] {
            *factor *= inverse;
        }
        for other in rest.chunks_exact_mut(n).chain(sides.chunks_exact_mut(n)) {
            other.swap(k, pivot);
            let by = other[k];
            let below = other[k + 1..].iter_mut().zip(&column[k + 1..]);
            below.for_each(|(v, factor)| *v -= by * factor);
        }
    }
    for side in sides.chunks_exact_mut(n) {
        for k in (0..n).rev() {
            let column = &matrix[k * n..(k + 1) * n];
            let value = side[k] / column[k];
            side[k] = value;
            side[..k].iter_mut().zip(&column[..k]).for_each(|(v, above)| *v -= value * above);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Products and solutions are those of the library, also where rows are no multiple of the vectors.
    #[test]
    fn products_and_solutions_agree_with_the_library() {
        for n in [1, 7, 8, 45] {
            let number = |i: usize, j: usize| libm::sin((i * 31 + j * 17) as f64) / n as f64;
            let [a, b] = [0, 1000].map(|seed| DMatrix::from_fn(n, n, |i, j| number(i + seed, j)));
            assert!((product(&a, &b) - &a * &b).abs().max() < 1e-14);
            let system = DMatrix::identity(n, n) - &a;
            let expected = system.clone().lu().solve(&b).unwrap();
            assert!((solved(system, b) - expected).abs().max() < 1e-12, "{n}");
        }
    }

    /// Vectors of any width give the same bits.
    #[test]
    fn all_vector_widths_give_the_same_bits() {
        let n = 45;
        let [a, b] =
            [0, 7].map(|seed| DMatrix::from_fn(n, n, |i, j| libm::sin((seed + i * 31 + j * 17) as f64)));
        let (mut narrow, mut left) = (DMatrix::zeros(n, n), a.clone());
        dispatch!(Level::baseline(), _simd => multiply([n, n], a.as_slice(), b.as_slice(), narrow.as_mut_slice()));
        assert_eq!(narrow, product(&a, &b));
        let mut solution = b.clone();
        dispatch!(Level::baseline(), _simd => eliminate(n, left.as_mut_slice(), solution.as_mut_slice()));
        assert_eq!(solution, solved(a, b));
    }
}
