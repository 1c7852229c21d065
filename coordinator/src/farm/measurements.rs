//! Keeps measurements: question, answer and grid, with texts for people. Every client may read them; their owner and admins
//! may change them.

use optics_model::{Digest, Invalid};

use super::{Farm, FarmError, Result};
use crate::actor::Actor;
use crate::clock::Clock;
use crate::quota::Limit;
use crate::store::StoredMeasurement;

/// Most measurements of one token, and most bytes of their contents.
const MEASUREMENTS_OF_ONE: u64 = 10_000;
const BYTES_OF_ONE: u64 = 1 << 30;
/// Hexadecimal digits of an id.
const ID_DIGITS: usize = 16;

/// A measurement to be kept.
#[derive(Debug)]
pub(crate) struct NewMeasurement {
    /// The question, with the digest of the grid: a measurement that is kept again replaces the last one.
    pub question: Digest,
    pub title: String,
    pub note: String,
    pub source: String,
    pub command: String,
    pub dictionary: String,
    /// One name per line.
    pub materials: String,
    pub channels: usize,
    pub content: Vec<u8>,
}

impl Farm {
    /// Keeps a measurement durably; returns its id.
    pub(crate) async fn keep_measurement(&self, by: &Actor, new: NewMeasurement) -> Result<String> {
        let owner = by.name().to_owned();
        let id = id_of(&owner, new.question);
        let is_new = self.store.measurement(&id).await?.is_none();
        let (count, bytes) = self.store.measurements_of(&owner).await?;
        let limit = |most| Limit::new(by.key(), most);
        let (more, new_bytes) = (u64::from(is_new), new.content.len() as u64);
        limit(MEASUREMENTS_OF_ONE).check(count, more, "kept measurements", "delete some")?;
        limit(BYTES_OF_ONE).check(bytes, new_bytes, "bytes of kept measurements", "delete some")?;
        self.store.check_room(new_bytes)?;
        let stored = StoredMeasurement {
            number: 0,
            id: id.clone(),
            kept_unix_ms: Clock::unix_ms() as i64,
            owner,
            title: new.title,
            note: new.note,
            source: new.source,
            command: new.command,
            dictionary: new.dictionary,
            materials: new.materials,
            channels: new.channels as i64,
        };
        self.store.keep_measurement(&stored, &new.content).await?;
        Ok(id)
    }

    /// Measurements with smaller numbers than this, the newest first.
    pub(crate) async fn measurements(&self, before: i64, most: u32) -> Result<Vec<StoredMeasurement>> {
        Ok(self.store.measurements_before(before, most).await?)
    }

    /// A measurement and its content.
    pub(crate) async fn measurement(&self, id: &str) -> Result<(StoredMeasurement, Vec<u8>)> {
        self.store.measurement_with_content(id).await?.ok_or_else(|| not_found(id))
    }

    pub(crate) async fn annotate_measurement(
        &self,
        by: &Actor,
        id: &str,
        title: Option<&str>,
        note: Option<&str>,
    ) -> Result<StoredMeasurement> {
        self.check_owner(by, id).await?;
        if title == Some("") {
            return Err(Invalid::new("title", "nothing", "a title is needed").into());
        }
        self.store.annotate_measurement(id, title, note).await?;
        self.summary(id).await
    }

    pub(crate) async fn delete_measurement(&self, by: &Actor, id: &str) -> Result<()> {
        self.check_owner(by, id).await?;
        Ok(self.store.delete_measurement(id).await?)
    }

    async fn summary(&self, id: &str) -> Result<StoredMeasurement> {
        self.store.measurement(id).await?.ok_or_else(|| not_found(id))
    }

    async fn check_owner(&self, by: &Actor, id: &str) -> Result<()> {
        let StoredMeasurement { owner, .. } = self.summary(id).await?;
        if by.may_change(&owner) {
            return Ok(());
        }
        Err(FarmError::OthersMeasurement { id: id.to_owned(), owner })
    }
}

fn not_found(id: &str) -> FarmError {
    // Ids are short; a longer text is not repeated.
    let id = if id.len() <= ID_DIGITS { id } else { "of this id" };
    FarmError::NoMeasurement { id: id.to_owned() }
}

fn id_of(owner: &str, question: Digest) -> String {
    let mut text = Digest::of_bytes(format!("{owner}\n{question}").as_bytes()).to_string();
    text.truncate(ID_DIGITS);
    text
}
