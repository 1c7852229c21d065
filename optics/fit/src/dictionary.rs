//! Stores a dictionary in memory for comparison: channel by channel, so that a question loads only the channels that it
//! needs.

pub(crate) mod axes;
pub(crate) mod base_spread;
mod channel;
pub(crate) mod coefficients;
pub(crate) mod gradient;
pub(crate) mod records;
pub(crate) mod responses;
pub(crate) mod sketch;
pub(crate) mod sum;
pub(crate) mod view;
pub(crate) mod wide;

use std::borrow::Cow;
use std::sync::Arc;

use optics_model::profile::RecordShape;
use optics_model::{Grid, PackedRecords};
use rayon::prelude::*;

use crate::stop::{Stop, Stopped};
use channel::ChannelRecords;
use coefficients::Coefficients;
use records::Records;
use responses::{ResponseRecords, VariedRecords};
use sum::add_multiple;
use view::{View, ViewKey};
use wide::wide;

/// Collects the records of jobs, which may come in any order.
#[derive(Debug)]
pub struct DictionaryBuilder {
    /// The grid of the records that are added.
    stored: Arc<Grid>,
    /// The grid of the dictionary that is built: the same, or over other boards.
    grid: Arc<Grid>,
    /// Weights of the stored channels in each collected one, where boards are interpolated.
    weights: Vec<Vec<f64>>,
    /// The collected channels, each with its index among the scene's.
    channels: Vec<(usize, Records, Option<VariedRecords>)>,
    /// Whether each record was added.
    present: Vec<bool>,
}

impl DictionaryBuilder {
    /// A builder for all channels of the grid's scene.
    pub fn new(grid: Grid) -> Self {
        let channels = 0..grid.scene().channels().len();
        Self::of_channels(Arc::new(grid), channels)
    }

    /// A builder for some channels of the grid's scene, by their indices.
    pub fn of_channels(grid: Arc<Grid>, channels: impl IntoIterator<Item = usize>) -> Self {
        let seen: Vec<usize> = grid.scene().seen_channels().collect();
        let varied = |index| seen.contains(&index).then(|| VariedRecords::new(grid.clone()));
        let channel = |index| (index, Records::new(grid.clone()), varied(index));
        let channels = channels.into_iter().map(channel).collect();
        let present = vec![false; grid.stored_records()];
        Self { stored: grid.clone(), grid, weights: Vec::new(), channels, present }
    }

    /// A builder for some channels of a grid over other boards, from records of a grid for all boards.
    pub fn over_boards(
        stored: Arc<Grid>,
        grid: &Arc<Grid>,
        channels: impl IntoIterator<Item = usize>,
    ) -> Self {
        let builder = Self::of_channels(grid.clone(), channels);
        let weights = |(index, ..): &(usize, _, _)| grid.scene().channels()[*index].board_weights();
        Self { weights: builder.channels.iter().map(weights).collect(), stored, ..builder }
    }

    /// A builder that rounds all values, as for a large dictionary.
    #[cfg(test)]
    pub(crate) fn rounded(grid: &Grid) -> Self {
        let mut builder = Self::new(grid.clone());
        for (_, records, _) in &mut builder.channels {
            *records = Records::kept(builder.grid.clone(), false);
        }
        builder
    }

    /// Adds the records of a job.
    ///
    /// # Panics
    /// If a record does not have the grid's shape or a number of the grid, or was added before.
    pub fn add(&mut self, records: &PackedRecords) {
        self.add_all(std::slice::from_ref(records));
    }

    /// Adds the records of some jobs: many at a time are faster.
    ///
    /// # Panics
    /// If a record does not have the grid's shape or a number of the grid, or was added before.
    pub fn add_all(&mut self, jobs: &[PackedRecords]) {
        for records in jobs {
            assert_eq!(records.shape(), RecordShape::of(&self.stored), "the records have the grid's shape");
            for number in records.numbers() {
                let before = std::mem::replace(&mut self.present[number], true);
                assert!(!before, "record {number} comes once");
            }
        }
        if self.weights.is_empty() {
            self.add_as_stored(jobs);
        } else {
            for records in jobs {
                self.add_over_boards(records);
            }
        }
    }

    fn add_as_stored(&mut self, jobs: &[PackedRecords]) {
        let nominal = self.grid.record_count();
        self.channels.par_iter_mut().for_each(|(index, channel, varied)| {
            let numbered =
                jobs.iter().flat_map(|records| records.numbers().map(move |number| (records, number)));
            for (records, number) in numbered {
                let values = records.radiance_factors(number, *index);
                match varied {
                    _ if number < nominal => channel.set(number, values),
                    Some(varied) => varied.set(number, values),
                    None => {}
                }
            }
        });
    }

    fn add_over_boards(&mut self, records: &PackedRecords) {
        let nominal = self.grid.record_count();
        let boards: Vec<Vec<Vec<f32>>> = records
            .numbers()
            .map(|number| {
                let boards = 0..self.stored.scene().channels().len();
                boards.map(|board| records.radiance_factors(number, board).collect()).collect()
            })
            .collect();
        let weighted = self.channels.par_iter_mut().zip(&self.weights);
        weighted.for_each(|((_, channel, varied), weights)| {
            for (number, boards) in records.numbers().zip(&boards) {
                match varied {
                    _ if number < nominal => channel.set(number, over_board(boards, weights).into_iter()),
                    Some(varied) => varied.set(number, over_board(boards, weights).into_iter()),
                    None => {}
                }
            }
        });
    }

    /// Describes all records, so that the first question is as fast as the others. Gradients are computed at the first
    /// question that needs them.
    ///
    /// # Panics
    /// If records are missing.
    pub fn build(self) -> FitDictionary {
        assert!(self.present.iter().all(|present| *present), "every record has come");
        let described = |(index, records, varied): (usize, Records, Option<VariedRecords>)| {
            let seen = varied.is_some();
            let responses = varied.map(|varied| varied.responses(&records, index));
            let channel = ChannelRecords::new(records, responses);
            if seen {
                channel.whole_view();
            }
            (index, FitChannel(Arc::new(channel)))
        };
        let channels = self.channels.into_par_iter().map(described).collect::<Vec<_>>();
        FitDictionary::of_channels(self.grid, channels)
    }
}

/// The profile over another board: a weighted sum of those over a dictionary's boards.
fn over_board(boards: &[Vec<f32>], weights: &[f64]) -> Vec<f32> {
    let mut sums = vec![0.0; boards[0].len()];
    wide(
        #[inline(always)]
        || {
            for (board, weight) in boards.iter().zip(weights) {
                add_multiple(&mut sums, *weight, board);
            }
        },
    );
    // Interpolation leaves rounding errors where all boards are dark.
    sums.iter().map(|sum| sum.max(0.0) as f32).collect()
}

/// One channel of a dictionary in memory; cheap to copy.
#[derive(Debug, Clone)]
pub struct FitChannel(Arc<ChannelRecords>);

impl FitChannel {
    /// Maximum bytes of a channel of a grid: values and coefficients; and unless it is one under a darker white reference,
    /// responses, and descriptions (in small dictionaries gradients, too) for the whole profiles and for one other range of
    /// pixels.
    pub fn bytes_of(grid: &Grid, channel: usize) -> usize {
        let is_seen = grid.scene().seen_channels().any(|seen| seen == channel);
        let beyond = || responses::bytes_of(grid).saturating_add(2 * view::bytes_of(grid));
        let beyond = if is_seen { beyond() } else { 0 };
        let of_records = records::bytes_of(grid).saturating_add(Coefficients::bytes_of(grid));
        of_records.saturating_add(beyond)
    }
}

/// Channels of a dictionary: all, or those that a question needs.
#[derive(Debug)]
pub struct FitDictionary {
    grid: Arc<Grid>,
    channels: Vec<Option<FitChannel>>,
    /// Stops the current question.
    pub(crate) stop: Stop,
}

impl FitDictionary {
    /// A dictionary of the given channels of a grid's scene, with their indices.
    pub fn of_channels(grid: Arc<Grid>, given: impl IntoIterator<Item = (usize, FitChannel)>) -> Self {
        let mut channels = vec![None; grid.scene().channels().len()];
        for (index, channel) in given {
            channels[index] = Some(channel);
        }
        Self { grid, channels, stop: Stop::default() }
    }

    /// Answers a question, unless it is stopped before. A stopped question ends within milliseconds, or once a view or
    /// its gradients, if they are under construction, are complete.
    pub fn ask<T>(mut self, stop: &Stop, question: impl FnOnce(&Self) -> T) -> Result<T, Stopped> {
        self.stop = stop.clone();
        stop.guard(|| question(&self))
    }

    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The loaded channels, with their indices.
    pub fn channels(&self) -> impl Iterator<Item = (usize, &FitChannel)> {
        self.channels.iter().enumerate().filter_map(|(index, channel)| Some((index, channel.as_ref()?)))
    }

    /// Radiance factors of a record in one channel. Those of a dictionary of more than 512 MiB are rounded, by about
    /// √(v m)/65,535 at most, where m is the record's maximum.
    ///
    /// # Panics
    /// If the channel is not loaded.
    pub fn values(&self, record: usize, channel: usize) -> Cow<'_, [f32]> {
        let records = self.records(channel);
        records.values(record, 0..records.pixels())
    }

    /// None for a channel under a darker white reference, which is not compared with photographs.
    pub(crate) fn responses(&self, channel: usize) -> Option<&ResponseRecords> {
        self.channel(channel).responses()
    }

    pub(crate) fn records(&self, channel: usize) -> &Records {
        self.channel(channel).records()
    }

    /// The records as coefficients in a basis, for predictions.
    pub(crate) fn coefficients(&self, channel: usize) -> &Coefficients {
        self.channel(channel).coefficients()
    }

    /// The view over all pixels, which stays cached.
    pub(crate) fn whole_view(&self, channel: usize) -> Arc<View> {
        self.channel(channel).whole_view()
    }

    /// The view of a key, made if it is not cached.
    pub(crate) fn view(&self, channel: usize, key: &ViewKey) -> Arc<View> {
        self.stop.check();
        self.channel(channel).view(key)
    }

    fn channel(&self, index: usize) -> &ChannelRecords {
        &self.channels[index].as_ref().expect("a question's channels are there").0
    }
}
