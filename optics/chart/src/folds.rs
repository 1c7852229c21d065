//! Cross-validation: what the stacks of a tenth of a chart should show by the other nine tenths.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::forward::{PatchValues, looks};
use crate::problem::{ChartEquations, FEWEST_HELD_OUT, Problem, add};

/// Parts of a chart.
const FOLDS: usize = 10;
/// Patches below which one step is not enough.
const SMALL: usize = 100;

/// Values of all patches, each from the fit without its fold: one step from the fit of all, and more in small charts.
/// Empty with few stacks; None if the others do not determine a fit.
pub(crate) fn held_out(problem: &Problem, at: &DVector<f64>, normal: &ChartEquations) -> Option<PatchValues> {
    let count = problem.chart.patches.len();
    let Some(folds) = folds(problem) else { return Some(Vec::new()) };
    let one = |fold: &Vec<usize>| {
        let (mut matrix, mut gradient) = (normal.matrix.clone(), normal.gradient.clone());
        for patch in fold {
            let (places, slopes, residual) = &normal.parts[*patch];
            add(&mut matrix, &mut gradient, places, slopes, residual, -1.0);
        }
        let (_, step) = problem.solved(matrix, gradient, at, 0.0)?;
        let to = problem.limited(at + step);
        let to = if count < SMALL { problem.refitted(fold, to) } else { to };
        let values = problem.values(&to, &looks(problem.chart, fold, true));
        let expected = |patch: &usize| problem.observed(&problem.chart.patches[*patch], &values[*patch], &to);
        Some(fold.iter().map(|patch| (*patch, expected(patch))).collect::<Vec<_>>())
    };
    let found: Vec<_> = folds.par_iter().map(one).collect::<Option<_>>()?;
    let mut all = vec![Vec::new(); count];
    found.into_iter().flatten().for_each(|(patch, expected)| all[patch] = expected);
    Some(all)
}

/// Tenths of the patches. Those of one stack are in one of them, for each shows what the others are. None with few stacks.
fn folds(problem: &Problem) -> Option<Vec<Vec<usize>>> {
    let patches = &problem.chart.patches;
    let mut stacks: Vec<Vec<usize>> = Vec::new();
    let mut known: std::collections::HashMap<Vec<(usize, u64)>, usize> = std::collections::HashMap::new();
    for (i, patch) in patches.iter().enumerate() {
        let key = patch.slabs.iter().map(|(material, mm)| (*material, mm.to_bits())).collect();
        let stack = *known.entry(key).or_insert_with(|| {
            stacks.push(Vec::new());
            stacks.len() - 1
        });
        stacks[stack].push(i);
    }
    if stacks.len() < FEWEST_HELD_OUT {
        return None;
    }
    stacks.sort_by_key(|stack| scattered(stack[0] as u64));
    let fold = |fold: usize| stacks.iter().skip(fold).step_by(FOLDS).flatten().copied().collect();
    Some((0..FOLDS).map(fold).collect())
}

/// The number `i` of an order that has nothing to do with that of patches, and is the same everywhere: splitmix64 (Steele,
/// Lea and Flood 2014).
pub fn scattered(i: u64) -> u64 {
    let mut z = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
