//! A record's profiles as bytes: 32-bit floats, little endian, in the order that the schema tells.

use farm_proto::profile::RecordShape;
use farm_proto::{Derivatives, Estimate, Profile, Record};

pub(super) fn encode(record: &Record) -> Vec<u8> {
    let estimates = || record.profiles.iter().flat_map(Profile::estimates);
    let mut bytes = Vec::with_capacity(estimates().map(|e| 8 * e.values().len()).sum());
    record.profiles.iter().for_each(|profile| profile.extend_le_bytes(&mut bytes));
    bytes
}

/// The profiles, or why the bytes are none.
pub(super) fn decode(bytes: &[u8], shape: RecordShape) -> Result<Vec<Profile>, String> {
    let estimates = if shape.derivatives { 3 } else { 1 };
    let expected = shape.channels * estimates * 2 * shape.pixels * size_of::<f32>();
    if bytes.len() != expected {
        return Err(format!("{} bytes instead of {expected}", bytes.len()));
    }
    let floats = |chunk: &[u8]| {
        chunk.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes"))).collect::<Vec<_>>()
    };
    let mut parts = bytes.chunks_exact(2 * shape.pixels * size_of::<f32>()).map(|chunk| {
        let (values, errors) = chunk.split_at(chunk.len() / 2);
        Estimate::new(floats(values), floats(errors)).map_err(|e| e.to_string())
    });
    let mut next = || parts.next().expect("the length was checked");
    (0..shape.channels)
        .map(|_| {
            let radiance_factor = next()?;
            let derivatives = if shape.derivatives {
                Some(Derivatives { albedo: next()?, sigma_t: next()? })
            } else {
                None
            };
            Ok(Profile { radiance_factor, derivatives })
        })
        .collect()
}
