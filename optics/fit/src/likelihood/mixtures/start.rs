//! Computes the start of the descent over inks from linear equations, which the media that were measured one by one give.
//!
//! Each measured mixture determines σ_s (1 − g) and σ_a of its own medium, which are invariant under similarity, with
//! their errors. Both are sums over the inks, so the inks follow by linear least squares, none being negative.

use nalgebra::{DMatrix, DVector};

/// Number of Gauss–Seidel sweeps; each lowers the sum of squares.
const SWEEPS: usize = 2000;
/// Least relative error of a measured medium, since mixing is never exact.
const MIXING: f64 = 0.01;

/// One equation: Σ fraction · unknown = value.
#[derive(Debug, Clone)]
pub(super) struct Equation {
    /// By ink.
    pub fractions: Vec<f64>,
    pub value: f64,
    pub std_error: f64,
}

/// The unknowns of least squares, none negative. `usual` is the value of an unknown that the equations do not determine.
pub(super) fn solve(equations: &[Equation], inks: usize, usual: f64) -> Vec<f64> {
    let mut normal = DMatrix::identity(inks, inks) * (1e-6 / (usual * usual));
    let mut right = DVector::from_element(inks, 1e-6 / usual);
    for Equation { fractions, value, std_error } in equations {
        let weight = 1.0 / (std_error.powi(2) + (MIXING * value).powi(2)).max(f64::MIN_POSITIVE);
        for i in 0..inks {
            right[i] += weight * fractions[i] * value;
            for j in 0..inks {
                normal[(i, j)] += weight * fractions[i] * fractions[j];
            }
        }
    }
    let mut found = vec![usual; inks];
    for _ in 0..SWEEPS {
        for i in 0..inks {
            let others: f64 = (0..inks).filter(|j| *j != i).map(|j| normal[(i, j)] * found[j]).sum();
            found[i] = ((right[i] - others) / normal[(i, i)]).max(0.0);
        }
    }
    found
}

/// Number of inks that the fractions of some materials distinguish.
pub(super) fn rank(fractions: &[Vec<f64>], inks: usize) -> usize {
    DMatrix::from_fn(fractions.len(), inks, |i, j| fractions[i][j]).rank(1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn equation(fractions: &[f64], value: f64, std_error: f64) -> Equation {
        Equation { fractions: fractions.to_vec(), value, std_error }
    }

    #[test]
    fn inks_follow_from_their_mixtures() {
        // The second ink by itself is hardly determined.
        let equations = [
            equation(&[1.0, 0.0], 6.0, 0.01),
            equation(&[0.0, 1.0], 30.0, 1e4),
            equation(&[0.75, 0.25], 6.5, 0.01),
        ];
        let found = solve(&equations, 2, 1.0);
        assert!((found[0] - 6.0).abs() < 0.05 && (found[1] - 8.0).abs() < 0.4, "{found:?}");
    }

    /// No ink is negative, and an ink that the equations do not determine has the usual value.
    #[test]
    fn no_ink_is_negative() {
        let equations = [equation(&[1.0, 0.0, 0.0], 6.0, 0.01), equation(&[0.5, 0.5, 0.0], 2.9, 0.01)];
        let found = solve(&equations, 3, 2.0);
        assert!(found[1] == 0.0 && (found[2] - 2.0).abs() < 1e-9, "{found:?}");
    }

    /// Mixtures with the same fractions do not separate their inks.
    #[test]
    fn similar_mixtures_do_not_separate_inks() {
        assert_eq!(rank(&[vec![0.5, 0.5], vec![0.5, 0.5]], 2), 1);
        assert_eq!(rank(&[vec![0.5, 0.5], vec![0.25, 0.75]], 2), 2);
        assert_eq!(rank(&[vec![0.5, 0.5]], 2), 1);
    }
}
