//! Encodes, decodes and checks records as bytes, the form in which they are sent and stored.
//!
//! In a record, for each channel: radiance factor, then ∂/∂α and ∂/∂σ_t if the job requests derivatives; of each of these
//! the values of all pixels as 32-bit floats, little endian, then their standard errors (`std_errors`) in two bytes and
//! one for each pixel. Up to physics version 5 these were floats, too. Such records are read; [`Layout`] distinguishes
//! them.

pub(crate) mod std_errors;

use std::ops::Range;

use bytes::Bytes;

use crate::Digest;
use crate::invalid::{Invalid, Result, each};
use crate::job::JobSpec;
use crate::profile::{Derivatives, Estimate, Profile, Record, RecordShape};

/// Bytes of a number.
const NUMBER: usize = size_of::<f32>();

/// Encoding of the standard errors in a record's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// One byte each.
    Bytes,
    /// As 32-bit floats: up to physics version 5.
    Floats,
}

impl Layout {
    /// Bytes of a record.
    pub fn record_bytes(self, shape: RecordShape) -> usize {
        shape.channels * shape.estimates() * self.estimate_bytes(shape.pixels)
    }

    /// The layout in which a record takes this many bytes, if there is one.
    pub fn of_record(bytes: usize, shape: RecordShape) -> Option<Self> {
        [Self::Bytes, Self::Floats].into_iter().find(|layout| layout.record_bytes(shape) == bytes)
    }

    fn estimate_bytes(self, pixels: usize) -> usize {
        let of_errors = match self {
            Self::Bytes => std_errors::size(pixels),
            Self::Floats => pixels * NUMBER,
        };
        pixels * NUMBER + of_errors
    }

    /// The bytes of each estimate's values and standard errors.
    fn estimates(self, record: &[u8], pixels: usize) -> impl Iterator<Item = (&[u8], &[u8])> {
        record.chunks_exact(self.estimate_bytes(pixels)).map(move |e| e.split_at(pixels * NUMBER))
    }

    fn std_errors(self, bytes: &[u8]) -> Result<Vec<f32>> {
        match self {
            Self::Bytes => std_errors::read(bytes),
            Self::Floats => Ok(numbers(bytes).collect()),
        }
    }

    fn are_std_errors_sound(self, bytes: &[u8]) -> bool {
        match self {
            Self::Bytes => std_errors::is_sound(bytes),
            Self::Floats => numbers(bytes).fold(true, |right, v| right & (0.0..=f32::MAX).contains(&v)),
        }
    }
}

impl RecordShape {
    /// Bytes of one record, as it is packed today.
    pub fn bytes(self) -> usize {
        Layout::Bytes.record_bytes(self)
    }
}

/// All records of a job, one after the other in their order. They are checked, and cheap to copy.
#[derive(Debug, Clone, PartialEq)]
pub struct PackedRecords {
    first: usize,
    shape: RecordShape,
    layout: Layout,
    bytes: Bytes,
}

impl PackedRecords {
    /// Bytes that a job's records take.
    pub fn bytes_of(job: &JobSpec) -> usize {
        job.albedo().len() * RecordShape::of_job(job).bytes()
    }

    /// The records of a job from their bytes, as a worker sends them; refused if they are too many or too few, or if a
    /// value is not finite or a standard error is impossible.
    pub fn new(job: &JobSpec, bytes: Bytes) -> Result<Self> {
        Self::in_layout(Layout::Bytes, job, bytes)
    }

    /// The records of a job from stored bytes, written by this program or an older one.
    pub fn in_layout(layout: Layout, job: &JobSpec, bytes: Bytes) -> Result<Self> {
        let (shape, first) = (RecordShape::of_job(job), job.first_record());
        let size = layout.record_bytes(shape);
        let wanted = job.albedo().len() * size;
        if bytes.len() != wanted {
            let allowed = format!("{wanted} are needed, for {} records", job.albedo().len());
            return Err(Invalid::new("records", format_args!("{} bytes", bytes.len()), allowed));
        }
        for (index, record) in (first..).zip(bytes.chunks_exact(size)) {
            check(record, shape, layout).map_err(|error| error.within(format!("record {index}")))?;
        }
        Ok(Self { first, shape, layout, bytes })
    }

    /// The records of a job that has been traced. Standard errors are rounded, as those of traced records already are.
    ///
    /// # Panics
    /// If the records are not the job's: other numbers, too few or too many, or another shape.
    pub fn pack(job: &JobSpec, records: &[Record]) -> Self {
        let (shape, first) = (RecordShape::of_job(job), job.first_record());
        assert_eq!(records.len(), job.albedo().len(), "there is a record for each albedo");
        let mut bytes = Vec::with_capacity(Self::bytes_of(job));
        for (index, record) in (first..).zip(records) {
            assert!(record.index == index && shape.check(record).is_ok(), "record {index} is the job's");
            record.extend_le_bytes(&mut bytes);
        }
        Self { first, shape, layout: Layout::Bytes, bytes: bytes.into() }
    }

    pub fn unpack(&self) -> Vec<Record> {
        self.numbers().map(|number| self.record(number)).collect()
    }

    /// The numbers that the records have in the grid.
    pub fn numbers(&self) -> Range<usize> {
        self.first..self.first + self.bytes.len() / self.record_bytes()
    }

    pub fn shape(&self) -> RecordShape {
        self.shape
    }

    /// Unpacks the record with this number.
    ///
    /// # Panics
    /// If there is no such record.
    pub fn record(&self, number: usize) -> Record {
        Record::from_le_bytes(number, self.bytes_of_record(number), self.shape)
            .expect("the records were checked")
    }

    /// Radiance factors of all pixels in one channel of a record.
    ///
    /// # Panics
    /// If there is no such record or channel.
    pub fn radiance_factors(&self, number: usize, channel: usize) -> impl ExactSizeIterator<Item = f32> {
        let RecordShape { channels, pixels, .. } = self.shape;
        assert!(channel < channels, "channel {channel} is one of {channels}");
        let start = channel * self.record_bytes() / channels;
        numbers(&self.bytes_of_record(number)[start..start + pixels * NUMBER])
    }

    /// The bytes of each record, in their order.
    pub fn each(&self) -> impl Iterator<Item = Bytes> {
        let size = self.record_bytes();
        (0..self.bytes.len()).step_by(size).map(move |start| self.bytes.slice(start..start + size))
    }

    /// All bytes.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// The digest that [`Digest::of_records`] returns for the unpacked records.
    pub fn digest(&self) -> Digest {
        Digest::of_packed(self.first, &self.bytes, self.record_bytes())
    }

    fn record_bytes(&self) -> usize {
        self.layout.record_bytes(self.shape)
    }

    fn bytes_of_record(&self, number: usize) -> &[u8] {
        assert!(self.numbers().contains(&number), "record {number} is one of {:?}", self.numbers());
        let size = self.record_bytes();
        &self.bytes[(number - self.first) * size..][..size]
    }
}

impl Record {
    /// Appends all numbers, in the order of this module's header.
    pub fn extend_le_bytes(&self, bytes: &mut Vec<u8>) {
        for estimate in self.profiles.iter().flat_map(Profile::estimates) {
            let start = bytes.len();
            bytes.resize(start + size_of_val(estimate.values()), 0);
            for (place, number) in bytes[start..].chunks_exact_mut(NUMBER).zip(estimate.values()) {
                place.copy_from_slice(&number.to_le_bytes());
            }
            std_errors::extend(estimate.std_errors(), bytes);
        }
    }

    /// Decodes a record in either layout; refused if the bytes cannot be a record of this shape.
    pub fn from_le_bytes(index: usize, bytes: &[u8], shape: RecordShape) -> Result<Self> {
        let Some(layout) = Layout::of_record(bytes.len(), shape) else {
            let allowed = format!("{} are needed", shape.bytes());
            return Err(Invalid::new("record", format_args!("{} bytes", bytes.len()), allowed));
        };
        let mut estimates = layout.estimates(bytes, shape.pixels).map(|(values, std_errors)| {
            Estimate::new(numbers(values).collect(), layout.std_errors(std_errors)?)
        });
        let mut next = |field| estimates.next().expect("the length was checked").map_err(|e| e.within(field));
        let mut profile = || -> Result<Profile> {
            let radiance_factor = next("radiance_factor")?;
            let derivatives = if shape.derivatives {
                Some(Derivatives { albedo: next("d_albedo")?, sigma_t: next("d_sigma_t")? })
            } else {
                None
            };
            Ok(Profile { radiance_factor, derivatives })
        };
        Ok(Self { index, profiles: each("profiles", 0..shape.channels, |_| profile())? })
    }
}

fn numbers(bytes: &[u8]) -> impl ExactSizeIterator<Item = f32> {
    bytes.chunks_exact(NUMBER).map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes")))
}

/// Refuses a record with numbers that walks cannot produce. The loops have no early exit, so that they are vectorised:
/// every number of every record is checked here.
fn check(record: &[u8], shape: RecordShape, layout: Layout) -> Result<()> {
    let mut right = true;
    for (values, std_errors) in layout.estimates(record, shape.pixels) {
        right &= numbers(values).fold(true, |right, v| right & v.is_finite());
        right &= layout.are_std_errors_sound(std_errors);
    }
    // Only a bad record is decoded, to locate the wrong number.
    if right { Ok(()) } else { Record::from_le_bytes(0, record, shape).map(drop) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Walks;
    use crate::medium::TransportPoint;
    use crate::scene::Scene;

    fn job(derivatives: bool) -> JobSpec {
        let point = TransportPoint::new(1.0, 0.0, 1.0, 1.5).unwrap();
        let walks = Walks::new(5000).unwrap();
        let job = JobSpec::new(Scene::paper(), point, vec![0.5, 0.9], walks, 1, derivatives).unwrap();
        job.numbered_from(7)
    }

    /// Records of consecutive numbers, the standard errors rounded.
    fn records(job: &JobSpec) -> Vec<Record> {
        let shape = RecordShape::of_job(job);
        let mut count = 0.0_f32;
        let mut estimate = || {
            let mut numbers = || (0..shape.pixels).map(|_| (count += 1.0, count).1).collect::<Vec<_>>();
            let (values, mut std_errors) = (numbers(), numbers());
            std_errors::round(&mut std_errors);
            Estimate::new(values, std_errors).unwrap()
        };
        let mut profile = || Profile {
            radiance_factor: estimate(),
            derivatives: shape.derivatives.then(|| Derivatives { albedo: estimate(), sigma_t: estimate() }),
        };
        let mut record = |index| Record { index, profiles: (0..shape.channels).map(|_| profile()).collect() };
        vec![record(7), record(8)]
    }

    /// Records are unchanged after packing, whole or one channel of one of them, and have the same digest.
    #[test]
    fn packed_records_keep_their_digest() {
        for derivatives in [false, true] {
            let job = job(derivatives);
            let records = records(&job);
            let packed = PackedRecords::pack(&job, &records);
            assert_eq!(packed.unpack(), records);
            assert_eq!(packed.digest(), Digest::of_records(&records));
            assert_eq!(PackedRecords::new(&job, packed.bytes().clone()).unwrap(), packed);
            assert_eq!(packed.each().flatten().collect::<Vec<u8>>(), packed.bytes()[..]);
            assert_eq!((packed.numbers(), packed.shape()), (7..9, RecordShape::of_job(&job)));
            for (number, record) in (7..).zip(&records) {
                assert_eq!(packed.record(number), *record);
                for (channel, profile) in record.profiles.iter().enumerate() {
                    let values: Vec<f32> = packed.radiance_factors(number, channel).collect();
                    assert_eq!(values, profile.radiance_factor.values());
                }
            }
        }
    }

    /// Reading a record that belongs to another job panics.
    #[test]
    #[should_panic(expected = "record 9 is one of 7..9")]
    fn record_of_another_job_is_not_read() {
        let job = job(false);
        let _ = PackedRecords::pack(&job, &records(&job)).record(9);
    }

    #[test]
    #[should_panic(expected = "record 7 is the job's")]
    fn records_in_another_order_are_not_packed() {
        let job = job(false);
        let mut swapped = records(&job);
        swapped.swap(0, 1);
        let _ = PackedRecords::pack(&job, &swapped);
    }

    /// The bytes of records as programs up to physics version 5 wrote them.
    fn with_floats(records: &[Record]) -> Vec<u8> {
        let estimates = records.iter().flat_map(|r| &r.profiles).flat_map(Profile::estimates);
        let numbers = estimates.flat_map(|e| [e.values(), e.std_errors()]).flatten();
        numbers.flat_map(|number| number.to_le_bytes()).collect()
    }

    /// Records whose standard errors are floats are read.
    #[test]
    fn float_errors_are_still_read() {
        for derivatives in [false, true] {
            let job = job(derivatives);
            let mut records = records(&job);
            // An error that a byte would round.
            let profile = &mut records[1].profiles[2];
            let values = profile.radiance_factor.values().to_vec();
            let errors = (0..values.len()).map(|pixel| 1.0 + pixel as f32 / 1024.0).collect();
            profile.radiance_factor = Estimate::new(values, errors).unwrap();
            let bytes = Bytes::from(with_floats(&records));
            assert!(PackedRecords::new(&job, bytes.clone()).is_err(), "no worker sends this");
            let packed = PackedRecords::in_layout(Layout::Floats, &job, bytes.clone()).unwrap();
            assert_eq!((packed.unpack(), packed.numbers()), (records.clone(), 7..9));
            let values: Vec<f32> = packed.radiance_factors(8, 2).collect();
            assert_eq!(values, records[1].profiles[2].radiance_factor.values());
            let shape = packed.shape();
            assert_eq!(Layout::of_record(bytes.len() / 2, shape), Some(Layout::Floats));
            assert_eq!(Layout::of_record(shape.bytes(), shape), Some(Layout::Bytes));
            assert_eq!(Layout::of_record(shape.bytes() - 1, shape), None);
        }
    }

    /// An impossible number in packed records is refused, and the error names its place.
    #[test]
    fn impossible_number_is_named() {
        let job = job(false);
        let good = PackedRecords::pack(&job, &records(&job));
        let pixels = job.scene().sensor().pixels();
        let with = |mut bytes: Vec<u8>, layout, place: usize, number: &[u8]| {
            bytes[place..][..number.len()].copy_from_slice(number);
            let read = PackedRecords::in_layout(layout, &job, bytes.into());
            read.map(drop).map_err(|error| error.field().to_owned())
        };
        let second = RecordShape::of_job(&job).bytes() + pixels * NUMBER;
        let of_second = "record 8.profiles[0].radiance_factor.std_errors";
        for (place, number, field) in [
            (3 * NUMBER, &f32::NAN.to_le_bytes()[..], "record 7.profiles[0].radiance_factor.values[3]"),
            (second, &[0x80, 0x7f], of_second),
        ] {
            let found = with(good.bytes().to_vec(), Layout::Bytes, place, number);
            assert_eq!(found.unwrap_err(), field);
        }
        let negative = with(good.bytes().to_vec(), Layout::Bytes, 0, &(-1.0_f32).to_le_bytes());
        assert_eq!(negative, Ok(()), "radiance factors may be below zero");
        for (pixel, number) in [(5, -0.5_f32), (0, f32::INFINITY)] {
            let place = (7 * pixels + pixel) * NUMBER;
            let found = with(with_floats(&good.unpack()), Layout::Floats, place, &number.to_le_bytes());
            assert_eq!(found.unwrap_err(), format!("{of_second}[{pixel}]"));
        }
    }

    /// Bytes for another number of records are refused.
    #[test]
    fn wrong_byte_count_is_refused() {
        let job = job(true);
        let bytes = PackedRecords::pack(&job, &records(&job)).bytes().slice(4..);
        let error = PackedRecords::new(&job, bytes).unwrap_err();
        assert_eq!(error.field(), "records");
        assert!(error.to_string().contains("for 2 records"), "{error}");
    }
}
