//! Selects the results that the coordinator computes once more: a share of them, sampled by a keyed hash.

use optics_model::Digest;

use crate::dispatch::mac::{first_bytes, hasher, write_part};
use crate::dispatch::part::PartId;
use crate::stored::Secret;

/// The place of a result in the sampled share, which the lowest numbers fill; none if it is not sampled. Unpredictable
/// without the secret, so a worker cannot predict which of its results will be verified.
pub(super) fn rank(secret: &Secret, part: PartId, result: Digest, share: f64) -> Option<u32> {
    let mut hasher = hasher(secret, "draw");
    write_part(&mut hasher, part);
    hasher.update(result.as_bytes());
    let rank = u32::from_le_bytes(first_bytes(&hasher));
    (f64::from(rank) < share * 2.0_f64.powi(32)).then_some(rank)
}

#[cfg(test)]
mod tests {
    use farm_proto::ids::DictionaryId;

    use super::*;

    const SECRET: Secret = Secret([1; 32]);

    fn part(job: u32) -> PartId {
        PartId { dictionary: DictionaryId(1), job, part: 0 }
    }

    fn digest(number: u32) -> Digest {
        Digest::of_bytes(&number.to_le_bytes())
    }

    /// The share of sampled results is the one that was requested.
    #[test]
    fn sampled_share_has_the_requested_size() {
        let is_sampled = |i, share| rank(&SECRET, part(0), digest(i), share).is_some();
        let sampled = |share| (0..20_000).filter(|i| is_sampled(*i, share)).count();
        assert_eq!((sampled(0.0), sampled(1.0)), (0, 20_000));
        // Three standard deviations.
        assert!(sampled(0.01).abs_diff(200) < 43, "{}", sampled(0.01));
    }

    /// Which results are checked cannot be predicted without the secret, nor from the samples of another job.
    #[test]
    fn samples_depend_on_secret_and_job() {
        let differ = |a: &dyn Fn(u32) -> bool, b: &dyn Fn(u32) -> bool| {
            let unequal = (0..20_000).filter(|i| a(*i) != b(*i)).count();
            // Independent samples of one half differ in one half: five standard deviations.
            assert!(unequal.abs_diff(10_000) < 354, "{unequal}");
        };
        let is_sampled = |secret, part, i| rank(secret, part, digest(i), 0.5).is_some();
        let own = |i| is_sampled(&SECRET, part(0), i);
        differ(&own, &|i| is_sampled(&Secret([2; 32]), part(0), i));
        differ(&own, &|i| is_sampled(&SECRET, part(1), i));
    }
}
