//! Stores L of a quantity at all nodes: as profiles, or as multiples of the few profiles that span them.

use crate::dictionary::sum::add_multiple;
use crate::dictionary::wide::wide;

/// L of a quantity.
#[derive(Debug)]
pub(crate) enum LinearResponse {
    /// `[row][pixel]`.
    Rows { values: Vec<f32>, pixels: usize },
    /// `[row][profile]`: where noise is reduced, all L lie in the span of few profiles.
    Span { weights: Vec<f32>, profiles: Vec<Vec<f64>> },
    /// One value in all pixels of all rows.
    Even { value: f64, pixels: usize },
}

impl LinearResponse {
    /// Several weighted sums of rows at once: `rows` are their numbers with a weight for each sum.
    pub(crate) fn sums<const N: usize>(&self, rows: &[(usize, [f64; N])]) -> [Vec<f64>; N] {
        match self {
            Self::Rows { values, pixels } => added(rows, *pixels, values),
            Self::Span { weights, profiles } => {
                added(rows, profiles.len(), weights).map(|of_profiles| spanned(&of_profiles, profiles))
            }
            Self::Even { value, pixels } => {
                let sum = |n: usize| rows.iter().map(|(_, weights)| weights[n]).sum::<f64>();
                std::array::from_fn(|n| vec![value * sum(n); *pixels])
            }
        }
    }
}

fn added<const N: usize>(rows: &[(usize, [f64; N])], width: usize, values: &[f32]) -> [Vec<f64>; N] {
    let mut sums = std::array::from_fn(|_| vec![0.0; width]);
    wide(
        #[inline(always)]
        || {
            for (row, weights) in rows {
                let row = &values[row * width..][..width];
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    add_multiple(sum, *weight, row);
                }
            }
        },
    );
    sums
}

fn spanned(weights: &[f64], profiles: &[Vec<f64>]) -> Vec<f64> {
    let mut sum = vec![0.0; profiles.first().map_or(0, Vec::len)];
    wide(
        #[inline(always)]
        || {
            for (weight, profile) in weights.iter().zip(profiles) {
                add_multiple(&mut sum, *weight, profile);
            }
        },
    );
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows give the same sums in both forms.
    #[test]
    fn forms_of_responses_have_the_same_sums() {
        let profiles = vec![vec![1.0, 2.0, 3.0], vec![0.0, -1.0, 0.5]];
        let weights = vec![1.0_f32, 0.0, 2.0, -1.0];
        let values = vec![1.0, 2.0, 3.0, 2.0, 5.0, 5.5];
        let forms = [LinearResponse::Rows { values, pixels: 3 }, LinearResponse::Span { weights, profiles }];
        for form in &forms {
            let sums = form.sums(&[(0, [1.0, 0.5]), (1, [-1.0, 2.0])]);
            assert_eq!(sums, [vec![-1.0, -3.0, -2.5], vec![4.5, 11.0, 12.5]]);
        }
    }
}
