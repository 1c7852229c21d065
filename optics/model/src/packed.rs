//! Records as bytes: what goes over the wire and what is stored.
//!
//! 32-bit floats, little endian. In a record, for each channel: radiance factor, then ∂/∂α and ∂/∂σ_t if the job asks for
//! derivatives; of each of these the values of all pixels, then their standard errors.

use std::ops::Range;

use bytes::Bytes;

use crate::Digest;
use crate::invalid::{Invalid, Result, each};
use crate::job::JobSpec;
use crate::profile::{Derivatives, Estimate, Profile, Record, RecordShape};

/// Bytes of a number.
const NUMBER: usize = size_of::<f32>();

/// All records of a job, one after the other in their order. They are checked, and cheap to copy.
#[derive(Debug, Clone, PartialEq)]
pub struct PackedRecords {
    first: usize,
    shape: RecordShape,
    bytes: Bytes,
}

impl PackedRecords {
    /// Bytes that a job's records take.
    pub fn bytes_of(job: &JobSpec) -> usize {
        job.albedo().len() * RecordShape::of_job(job).bytes()
    }

    /// The records of a job from their bytes; refused if they are too many or too few, or if a value is not finite or a
    /// standard error negative.
    pub fn new(job: &JobSpec, bytes: Bytes) -> Result<Self> {
        let (shape, first) = (RecordShape::of_job(job), job.first_record());
        let wanted = Self::bytes_of(job);
        if bytes.len() != wanted {
            let allowed = format!("{wanted} are needed, for {} records", job.albedo().len());
            return Err(Invalid::new("records", format_args!("{} bytes", bytes.len()), allowed));
        }
        for (index, record) in (first..).zip(bytes.chunks_exact(shape.bytes())) {
            check(record, shape).map_err(|error| error.within(format!("record {index}")))?;
        }
        Ok(Self { first, shape, bytes })
    }

    /// The records of a job that has been traced.
    ///
    /// # Panics
    /// If they are not the job's: of other numbers, too few or too many, or of another shape.
    pub fn pack(job: &JobSpec, records: &[Record]) -> Self {
        let (shape, first) = (RecordShape::of_job(job), job.first_record());
        assert_eq!(records.len(), job.albedo().len(), "there is a record for each albedo");
        let mut bytes = Vec::with_capacity(Self::bytes_of(job));
        for (index, record) in (first..).zip(records) {
            assert!(record.index == index && shape.check(record).is_ok(), "record {index} is the job's");
            record.extend_le_bytes(&mut bytes);
        }
        Self { first, shape, bytes: bytes.into() }
    }

    pub fn unpack(&self) -> Vec<Record> {
        self.numbers().map(|number| self.record(number)).collect()
    }

    /// The numbers that the records have in the grid.
    pub fn numbers(&self) -> Range<usize> {
        self.first..self.first + self.bytes.len() / self.shape.bytes()
    }

    pub fn shape(&self) -> RecordShape {
        self.shape
    }

    /// The record of a number, unpacked.
    ///
    /// # Panics
    /// If it is none of these.
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
        let start = channel * self.shape.bytes() / channels;
        numbers(&self.bytes_of_record(number)[start..start + pixels * NUMBER])
    }

    /// The bytes of each record, in their order.
    pub fn each(&self) -> impl Iterator<Item = Bytes> {
        let size = self.shape.bytes();
        (0..self.bytes.len()).step_by(size).map(move |start| self.bytes.slice(start..start + size))
    }

    /// All bytes.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// The same as [`Digest::of_records`] has for the records.
    pub fn digest(&self) -> Digest {
        Digest::of_packed(self.first, &self.bytes, self.shape.bytes())
    }

    fn bytes_of_record(&self, number: usize) -> &[u8] {
        assert!(self.numbers().contains(&number), "record {number} is one of {:?}", self.numbers());
        let size = self.shape.bytes();
        &self.bytes[(number - self.first) * size..][..size]
    }
}

impl Record {
    /// Appends all numbers, in the order that this module tells.
    pub fn extend_le_bytes(&self, bytes: &mut Vec<u8>) {
        let estimates = self.profiles.iter().flat_map(Profile::estimates);
        for numbers in estimates.flat_map(|e| [e.values(), e.std_errors()]) {
            let start = bytes.len();
            bytes.resize(start + size_of_val(numbers), 0);
            for (place, number) in bytes[start..].chunks_exact_mut(NUMBER).zip(numbers) {
                place.copy_from_slice(&number.to_le_bytes());
            }
        }
    }

    /// The record that [`Self::extend_le_bytes`] wrote; refused if the bytes cannot be one of this shape.
    pub fn from_le_bytes(index: usize, bytes: &[u8], shape: RecordShape) -> Result<Self> {
        if bytes.len() != shape.bytes() {
            let allowed = format!("{} are needed", shape.bytes());
            return Err(Invalid::new("record", format_args!("{} bytes", bytes.len()), allowed));
        }
        let mut estimates = bytes.chunks_exact(2 * shape.pixels * NUMBER).map(|estimate| {
            let (values, std_errors) = estimate.split_at(estimate.len() / 2);
            Estimate::new(numbers(values).collect(), numbers(std_errors).collect())
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

/// Refuses a record with numbers that no walks can come to. Without a way out of its loops, so that they run in vectors:
/// every number of every record passes here.
fn check(record: &[u8], shape: RecordShape) -> Result<()> {
    let mut right = true;
    for estimate in record.chunks_exact(2 * shape.pixels * NUMBER) {
        let (values, std_errors) = estimate.split_at(estimate.len() / 2);
        right &= numbers(values).fold(true, |right, v| right & v.is_finite());
        right &= numbers(std_errors).fold(true, |right, v| right & (0.0..=f32::MAX).contains(&v));
    }
    // Which number is wrong is found at leisure.
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

    /// Every number another.
    fn records(job: &JobSpec) -> Vec<Record> {
        let shape = RecordShape::of_job(job);
        let mut count = 0.0_f32;
        let mut estimate = || {
            let mut numbers = || (0..shape.pixels).map(|_| (count += 1.0, count).1).collect::<Vec<_>>();
            Estimate::new(numbers(), numbers()).unwrap()
        };
        let mut profile = || Profile {
            radiance_factor: estimate(),
            derivatives: shape.derivatives.then(|| Derivatives { albedo: estimate(), sigma_t: estimate() }),
        };
        let mut record = |index| Record { index, profiles: (0..shape.channels).map(|_| profile()).collect() };
        vec![record(7), record(8)]
    }

    #[test]
    fn records_survive_their_packing_and_have_the_same_digest() {
        for derivatives in [false, true] {
            let job = job(derivatives);
            let records = records(&job);
            let packed = PackedRecords::pack(&job, &records);
            assert_eq!(packed.unpack(), records);
            assert_eq!(packed.digest(), Digest::of_records(&records));
            assert_eq!(PackedRecords::new(&job, packed.bytes().clone()).unwrap(), packed);
            let each: Vec<u8> = packed.each().flatten().collect();
            assert_eq!(each, packed.bytes()[..]);
        }
    }

    #[test]
    fn one_record_and_one_channel_are_found_among_the_bytes() {
        for derivatives in [false, true] {
            let job = job(derivatives);
            let records = records(&job);
            let packed = PackedRecords::pack(&job, &records);
            assert_eq!(packed.numbers(), 7..9);
            assert_eq!(packed.shape(), RecordShape::of_job(&job));
            for (number, record) in (7..).zip(&records) {
                assert_eq!(packed.record(number), *record);
                for (channel, profile) in record.profiles.iter().enumerate() {
                    let values: Vec<f32> = packed.radiance_factors(number, channel).collect();
                    assert_eq!(values, profile.radiance_factor.values());
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "record 9 is one of 7..9")]
    fn a_record_of_another_job_is_not_read() {
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

    #[test]
    fn a_number_that_cannot_be_is_named() {
        let job = job(false);
        let good = PackedRecords::pack(&job, &records(&job));
        let pixels = job.scene().sensor().pixels();
        let with = |place: usize, number: f32| {
            let mut bytes = good.bytes().to_vec();
            bytes[NUMBER * place..][..NUMBER].copy_from_slice(&number.to_le_bytes());
            PackedRecords::new(&job, bytes.into())
        };
        let field = |place, number| with(place, number).unwrap_err().field().to_owned();
        let of_second = 6 * pixels;
        assert_eq!(field(3, f32::NAN), "record 7.profiles[0].radiance_factor.values[3]");
        assert_eq!(field(of_second + pixels + 5, -0.5), "record 8.profiles[0].radiance_factor.std_errors[5]");
        assert_eq!(
            field(of_second + pixels, f32::INFINITY),
            "record 8.profiles[0].radiance_factor.std_errors[0]"
        );
        assert!(with(0, -1.0).is_ok(), "radiance factors may be below zero");
    }

    #[test]
    fn bytes_of_another_number_of_records_are_refused() {
        let job = job(true);
        let bytes = PackedRecords::pack(&job, &records(&job)).bytes().slice(4..);
        let error = PackedRecords::new(&job, bytes).unwrap_err();
        assert_eq!(error.field(), "records");
        assert!(error.to_string().contains("for 2 records"), "{error}");
    }
}
