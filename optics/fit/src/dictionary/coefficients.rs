//! Holds records as coefficients in a basis of profiles, from which predictions are summed: they are a sixth of the numbers.
//!
//! The basis is nearly that of the largest principal components of the records, each over its size. One multiplication with
//! their second moments turns the span of a few records into nearly that of the components (Halko, Martinsson and Tropp
//! 2011, "Finding structure with randomness").

use std::sync::OnceLock;

use crate::bases::orthonormal;
use crate::dictionary::records::Records;
use crate::dictionary::sum::{dot, dots};
use crate::dictionary::wide::wide;

/// Number of profiles in the basis.
const DIRECTIONS: usize = 64;
/// Number of records, at even distances, from which the basis is computed.
const SAMPLES: usize = 1024;

/// Number of pixels that are summed at a time: as many as vector registers hold.
const BLOCK: usize = 8;

/// The records of a channel in an orthonormal basis.
#[derive(Debug)]
pub(crate) struct Coefficients {
    pixels: usize,
    basis: Vec<Vec<f64>>,
    /// The basis as `[block of pixels][direction]`; zeros fill the last block.
    blocks: Vec<[f64; BLOCK]>,
    /// By record, computed when they are needed first.
    rows: Vec<OnceLock<Box<[f32]>>>,
}

impl Coefficients {
    pub(crate) fn of(records: &Records) -> Self {
        let count = records.grid().record_count();
        let sampled = (0..count).step_by(count.div_ceil(SAMPLES));
        let samples: Vec<Vec<f64>> = sampled.map(|record| over_size(profile(records, record))).collect();
        let most = DIRECTIONS.min(records.pixels());
        let pixels = records.pixels();
        let every = vec![1.0; pixels];
        let first = samples.iter().step_by(samples.len().div_ceil(most)).cloned().collect();
        let first = orthonormal(first, &every);
        let mut sums = vec![vec![0.0; pixels]; first.len()];
        let mut along = Vec::new();
        for sample in &samples {
            along.clear();
            wide(
                #[inline(always)]
                || {
                    describe(&first, sample, |c| along.push(c));
                    for (sum, c) in sums.iter_mut().zip(&along) {
                        sum.iter_mut().zip(sample).for_each(|(sum, v)| *sum += c * v);
                    }
                },
            );
        }
        let basis = orthonormal(sums, &every);
        let at = |direction: &[f64], pixel: usize| direction.get(pixel).copied().unwrap_or(0.0);
        let block = |first: usize| {
            basis.iter().map(move |direction| std::array::from_fn(|i| at(direction, first + i)))
        };
        let blocks = (0..pixels).step_by(BLOCK).flat_map(block).collect();
        let rows = (0..count).map(|_| OnceLock::new()).collect();
        Self { pixels, basis, blocks, rows }
    }

    /// Bytes of a grid's records in one channel.
    pub(crate) fn bytes_of(grid: &optics_model::Grid) -> usize {
        grid.record_count().saturating_mul(DIRECTIONS * size_of::<f32>() + size_of::<OnceLock<Box<[f32]>>>())
    }

    /// Number of coefficients.
    pub(crate) fn count(&self) -> usize {
        self.basis.len()
    }

    /// The coefficients of a record.
    pub(crate) fn row(&self, records: &Records, record: usize) -> &[f32] {
        self.rows[record].get_or_init(|| {
            let mut row = Vec::with_capacity(self.count());
            let values = profile(records, record);
            wide(
                #[inline(always)]
                || describe(&self.basis, &values, |c| row.push(c as f32)),
            );
            row.into()
        })
    }

    /// The profiles with these coefficients.
    pub(crate) fn profiles<const N: usize>(&self, coefficients: [&[f64]; N]) -> [Vec<f64>; N] {
        let mut profiles = std::array::from_fn(|_| Vec::with_capacity(self.pixels.next_multiple_of(BLOCK)));
        wide(
            #[inline(always)]
            || {
                for block in self.blocks.chunks_exact(self.count().max(1)) {
                    let mut sums = [[0.0; BLOCK]; N];
                    for (d, direction) in block.iter().enumerate() {
                        for (sum, c) in sums.iter_mut().zip(&coefficients) {
                            for p in 0..BLOCK {
                                sum[p] += c[d] * direction[p];
                            }
                        }
                    }
                    profiles.iter_mut().zip(&sums).for_each(|(profile, sum)| profile.extend_from_slice(sum));
                }
            },
        );
        for profile in &mut profiles {
            profile.resize(self.pixels, 0.0);
        }
        profiles
    }
}

fn profile(records: &Records, record: usize) -> Vec<f64> {
    records.values(record, 0..records.pixels()).iter().map(|v| f64::from(*v)).collect()
}

/// A profile over its root sum of squares, so that dark records are described as well as bright ones.
fn over_size(mut values: Vec<f64>) -> Vec<f64> {
    let size = dot(&values, &values).sqrt();
    if size > 0.0 {
        for v in &mut values {
            *v /= size;
        }
    }
    values
}

/// The coefficients of a profile in an orthonormal basis, in order.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn describe(basis: &[Vec<f64>], values: &[f64], mut add: impl FnMut(f64)) {
    let (fours, others) = basis.as_chunks::<4>();
    for four in fours {
        dots(values, four.each_ref().map(Vec::as_slice)).into_iter().for_each(&mut add);
    }
    for direction in others {
        add(dot(values, direction));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use optics_model::grid::{Axes, NoiseLevel};
    use optics_model::job::JobSpec;
    use optics_model::{Grid, PackedRecords, Scene};
    use optics_tracer::trace;

    use crate::DictionaryBuilder;

    /// Records by walks alone differ from their profiles in the basis by less than a fifth of their noise, and mostly far
    /// less.
    #[test]
    fn basis_leaves_less_than_the_noise() {
        let scene = Scene::paper();
        let scene = scene.clone().with_channels(scene.channels()[..1].to_vec()).unwrap();
        let paper = Grid::paper().axes().clone();
        let every = |axis: &[f64], n: usize| axis.iter().step_by(n).copied().collect();
        let axes = Axes { sigma_t_per_mm: every(&paper.sigma_t_per_mm, 6), g: every(&paper.g, 5), ..paper };
        let grid = Grid::new(scene, axes, NoiseLevel::Paper, 1, false).unwrap();
        let mut builder = DictionaryBuilder::new(grid.clone());
        let mut noise = Vec::new();
        for job in (0..grid.job_count()).map(|job| JobSpec::of(&grid, job)) {
            let records = trace(&job, &AtomicBool::new(false)).unwrap();
            noise.extend(
                records.iter().map(|record| record.profiles[0].radiance_factor.std_errors().to_vec()),
            );
            builder.add(&PackedRecords::pack(&job, &records));
        }
        let dictionary = builder.build();
        let (records, found) = (dictionary.records(0), dictionary.coefficients(0));
        let mut left: Vec<f64> = Vec::new();
        for (index, errors) in noise.iter().enumerate() {
            let row: Vec<f64> = found.row(records, index).iter().map(|c| f64::from(*c)).collect();
            let [profile] = found.profiles([&row]);
            let values = records.values(index, 0..records.pixels());
            let square = |((p, v), s): ((&f64, &f32), &f32)| ((p - f64::from(*v)) / f64::from(*s)).powi(2);
            let squares = profile.iter().zip(&*values).zip(errors).map(square).sum::<f64>();
            left.push((squares / profile.len() as f64).sqrt());
        }
        left.sort_by(f64::total_cmp);
        let [median, most] = [left[left.len() / 2], left[left.len() - 1]];
        assert!(median < 0.02 && most < 0.2, "{median} {most}");
    }
}
