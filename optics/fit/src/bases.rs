//! Constructs orthonormal functions over nodes, and contrasts of nodes that vanish for polynomials.
//!
//! Local models are fitted in bases of such functions; the scatter of a smooth quantity about polynomials is its noise.

/// Highest degree of the polynomials.
const DEGREE: usize = 3;

/// Norm of a term's component orthogonal to the terms before it, as a share of the term's own, below which it is rounding
/// error.
const NOTHING: f64 = 1e-11;

/// Functions that span the terms and are orthonormal over the window's nodes under their weights. Each is given by its
/// values at the nodes and then at any further places. Orthogonalised twice, since terms are nearly linearly dependent
/// where a window is narrow.
pub(crate) fn orthonormal(terms: Vec<Vec<f64>>, window: &[f64]) -> Vec<Vec<f64>> {
    let product =
        |a: &[f64], b: &[f64]| -> f64 { window.iter().zip(a).zip(b).map(|((w, a), b)| w * a * b).sum() };
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(terms.len());
    for mut values in terms {
        let size = product(&values, &values).sqrt();
        for _ in 0..2 {
            for other in &basis {
                let along = product(&values, other);
                values.iter_mut().zip(other).for_each(|(v, o)| *v -= along * o);
            }
        }
        let left = product(&values, &values).sqrt();
        if left > NOTHING * size {
            for v in &mut values {
                *v /= left;
            }
            basis.push(values);
        }
    }
    basis
}

/// Weights of nodes, of unit length and orthogonal to each other and to polynomials up to the degree [`DEGREE`], or a
/// lower one where nodes are few; none for one node.
pub(crate) fn contrasts(x: &[f64]) -> Vec<Vec<f64>> {
    let n = x.len();
    if n < 2 {
        return Vec::new();
    }
    let middle = x.iter().sum::<f64>() / n as f64;
    let powers = (n - 1).min(DEGREE + 1);
    let monomials = (0..powers).map(|p| x.iter().map(|x| (x - middle).powi(p as i32)).collect());
    let units = (0..n).map(|i| (0..n).map(|k| if i == k { 1.0 } else { 0.0 }).collect());
    let mut basis = orthonormal(monomials.chain(units).collect(), &vec![1.0; n]);
    basis.drain(..powers);
    basis.truncate(n - powers);
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Contrasts vanish for polynomials up to the stated degree, and are orthonormal.
    #[test]
    fn contrasts_are_blind_to_polynomials() {
        for n in 1..8 {
            let x: Vec<f64> = (0..n).map(|i| libm::log1p(f64::from(i) + 0.1 * f64::from(i % 3))).collect();
            let found = contrasts(&x);
            let powers = (n as usize).saturating_sub(1).min(DEGREE + 1);
            assert_eq!(found.len(), if n == 1 { 0 } else { n as usize - powers });
            for (i, contrast) in found.iter().enumerate() {
                for power in 0..powers {
                    let sum: f64 = contrast.iter().zip(&x).map(|(c, x)| c * x.powi(power as i32)).sum();
                    assert!(sum.abs() < 1e-9, "{n} nodes, x^{power}: {sum}");
                }
                for (k, other) in found.iter().enumerate() {
                    let product: f64 = contrast.iter().zip(other).map(|(a, b)| a * b).sum();
                    let expected = if i == k { 1.0 } else { 0.0 };
                    assert!((product - expected).abs() < 1e-9, "{n} nodes: {product}");
                }
            }
        }
    }
}
