//! Keeps channels of dictionaries in memory from the first question on, up to a limit, and drops the least recently used.
//!
//! Questions under way keep their channels. A dictionary below the limit is read as a whole, so that its next question
//! waits for nothing; from a larger one, each question reads only its own channels.

use std::sync::{Arc, Mutex, PoisonError};

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_fit::{DictionaryBuilder, FitChannel, FitDictionary};
use optics_model::{Grid, scene};
use tokio::task::JoinSet;

use super::asked_grid::AskedGrid;
use super::records::ended_early;
use super::{FarmError, Result, blocking};
use crate::store::{Damaged, Store};

/// A dictionary with its own boards, or over others.
#[derive(Debug, Clone, PartialEq)]
struct DictionaryOver {
    id: DictionaryId,
    boards: Vec<scene::Channel>,
}

#[derive(Debug)]
pub(super) struct FitCache {
    /// Bytes of all channels together.
    limit: usize,
    kept: Mutex<Kept>,
    /// Held while a dictionary is read: two at a time would not be read sooner, but need room for both.
    reading: tokio::sync::Mutex<()>,
}

#[derive(Debug, Default)]
struct Kept {
    /// Most recently used last.
    channels: Vec<Channel>,
    /// Number of times that records have changed: channels that were read meanwhile may hold the old records.
    forgotten: u64,
}

#[derive(Debug)]
struct Channel {
    of: DictionaryOver,
    index: usize,
    bytes: usize,
    loaded: FitChannel,
}

impl FitCache {
    /// A cache of at most `bytes` bytes.
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, kept: Mutex::default(), reading: tokio::sync::Mutex::default() }
    }

    /// A dictionary with at least the given channels.
    pub(super) async fn get(
        &self,
        store: &Store,
        (name, id): (&DictionaryName, DictionaryId),
        asked: &AskedGrid,
        channels: &[usize],
    ) -> Result<FitDictionary> {
        let (grid, key) = (&asked.grid, DictionaryOver { id, boards: asked.boards().to_vec() });
        if let Some(found) = self.find(&key, grid, channels) {
            return Ok(found);
        }
        let bytes = |channels: &[usize]| {
            let each = channels.iter().map(|index| FitChannel::bytes_of(grid, *index));
            each.fold(0, usize::saturating_add)
        };
        let needed = bytes(channels);
        if needed > self.limit {
            return Err(FarmError::TooLarge {
                name: name.clone(),
                channels: channels.len(),
                mib: needed.div_ceil(MIB),
                limit_mib: self.limit / MIB,
            });
        }
        let one_reader = self.reading.lock().await;
        if let Some(found) = self.find(&key, grid, channels) {
            return Ok(found);
        }
        let all: Vec<usize> = (0..grid.scene().channels().len()).collect();
        let wanted = if bytes(&all) <= self.limit { &all } else { channels };
        let (here, forgotten) = self.make_room(&key, wanted, bytes(wanted));
        let is_here = |index: &usize| here.iter().any(|(other, _)| other == index);
        let lacking: Vec<usize> = wanted.iter().filter(|index| !is_here(index)).copied().collect();
        let read = load_channels(store, name, id, asked, &lacking).await?;
        self.keep(&key, grid, &read, forgotten);
        drop(one_reader);
        let read = read.channels().map(|(index, channel)| (index, channel.clone()));
        Ok(FitDictionary::of_channels(grid.clone(), here.into_iter().chain(read)))
    }

    /// Drops a dictionary whose records have changed.
    pub(super) fn forget(&self, id: DictionaryId) {
        let mut kept = self.lock();
        kept.forgotten += 1;
        kept.channels.retain(|channel| channel.of.id != id);
    }

    /// The dictionary with these channels, if all of them are in memory.
    fn find(&self, key: &DictionaryOver, grid: &Arc<Grid>, channels: &[usize]) -> Option<FitDictionary> {
        let mut kept = self.lock();
        let is_asked = |channel: &Channel| channel.of == *key && channels.contains(&channel.index);
        let (asked, mut others): (Vec<_>, Vec<_>) =
            std::mem::take(&mut kept.channels).into_iter().partition(is_asked);
        let found = (asked.len() == channels.len()).then(|| {
            let asked = asked.iter().map(|channel| (channel.index, channel.loaded.clone()));
            FitDictionary::of_channels(grid.clone(), asked)
        });
        others.extend(asked);
        kept.channels = others;
        found
    }

    /// Drops other channels until there is room for the requested ones. Returns those of them that are in memory,
    /// and the number of times that records have changed.
    fn make_room(
        &self,
        key: &DictionaryOver,
        wanted: &[usize],
        needed: usize,
    ) -> (Vec<(usize, FitChannel)>, u64) {
        let mut kept = self.lock();
        let is_wanted = |channel: &Channel| channel.of == *key && wanted.contains(&channel.index);
        let (wanted_here, mut others): (Vec<_>, Vec<_>) =
            std::mem::take(&mut kept.channels).into_iter().partition(is_wanted);
        while others.iter().map(|channel| channel.bytes).sum::<usize>() + needed > self.limit {
            others.remove(0);
        }
        let here = wanted_here.iter().map(|channel| (channel.index, channel.loaded.clone())).collect();
        others.extend(wanted_here);
        kept.channels = others;
        (here, kept.forgotten)
    }

    /// Keeps the channels that were read, unless records have changed since.
    fn keep(&self, key: &DictionaryOver, grid: &Grid, read: &FitDictionary, forgotten: u64) {
        let mut kept = self.lock();
        if kept.forgotten == forgotten {
            let channel = |(index, loaded): (usize, &FitChannel)| Channel {
                of: key.clone(),
                index,
                bytes: FitChannel::bytes_of(grid, index),
                loaded: loaded.clone(),
            };
            kept.channels.extend(read.channels().map(channel));
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

const MIB: usize = 1 << 20;
/// Parts of a dictionary that are read side by side: half of the connections that read, so that others get through.
const READERS: usize = 2;
/// Bytes of a part; tests read each job by itself.
const PART_BYTES: usize = if cfg!(test) { 0 } else { 8 << 20 };

/// Reads a complete dictionary into memory, and compares its records with their digests.
pub async fn load_dictionary(
    store: &Store,
    name: &DictionaryName,
    id: DictionaryId,
    grid: &Arc<Grid>,
) -> Result<FitDictionary> {
    let all: Vec<usize> = (0..grid.scene().channels().len()).collect();
    let asked = AskedGrid { stored: grid.clone(), grid: grid.clone() };
    load_channels(store, name, id, &asked, &all).await
}

/// Reads some channels of a complete dictionary into memory, and compares its records with their digests.
async fn load_channels(
    store: &Store,
    name: &DictionaryName,
    id: DictionaryId,
    asked: &AskedGrid,
    channels: &[usize],
) -> Result<FitDictionary> {
    let grid = &asked.stored;
    let jobs = grid.job_count();
    let part = (PART_BYTES / (grid.albedo().len() * grid.record_bytes())).clamp(1, 1024);
    let mut parts = (0..jobs).step_by(part).map(|first| first..(first + part).min(jobs));
    let mut reading = JoinSet::new();
    let mut read_next = |reading: &mut JoinSet<_>| {
        if let Some(range) = parts.next() {
            let (store, grid) = (store.clone(), grid.clone());
            reading.spawn(async move { store.all_jobs(id, &grid, range).await });
        }
    };
    (0..READERS).for_each(|_| read_next(&mut reading));
    let channels = channels.iter().copied();
    let mut builder = if asked.is_over_others() {
        DictionaryBuilder::over_boards(grid.clone(), &asked.grid, channels)
    } else {
        DictionaryBuilder::of_channels(grid.clone(), channels)
    };
    while let Some(read) = reading.join_next().await {
        read_next(&mut reading);
        let damaged = |Damaged { job, what }| FarmError::Damaged { name: name.clone(), job, what };
        let found = read.map_err(|error| ended_early(&error))??.into_iter();
        let intact = found.map(|found| Ok(found.map_err(damaged)?.records)).collect::<Result<Vec<_>>>()?;
        builder.add_all(&intact);
    }
    Ok(blocking(move || builder.build()).await)
}
