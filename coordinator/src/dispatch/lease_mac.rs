//! Message authentication codes, keyed by a secret of the database: the tokens of leases and of workers, and the choice
//! of results to verify.
//!
//! They are functions of their subject and the secret, so none of them is stored. After a restart the same results are
//! sampled, and the tokens that were issued before still verify.

use farm_proto::ids::{Token, WorkerId};
use farm_proto::lease::LeaseKey;
use optics_model::Digest;

use super::PartId;
use crate::stored::Secret;

#[derive(Debug, Clone, Copy)]
pub(super) struct LeaseMac(pub Secret);

impl LeaseMac {
    /// Whether a result is in the sampled share that is verified. Unpredictable without the secret, so a worker cannot
    /// know which of its results will be verified.
    pub fn is_sampled(&self, part: PartId, result: Digest, share: f64) -> bool {
        let mut hasher = self.hasher("draw");
        write_part(&mut hasher, part);
        hasher.update(result.as_bytes());
        let sample = u32::from_le_bytes(first_bytes(&hasher));
        f64::from(sample) < share * 2.0_f64.powi(32)
    }

    /// The token of a lease for the holder of the access token of this name. `nonce` makes each token unique.
    pub fn token(&self, key: &LeaseKey, nonce: u64, holder: &str) -> Token {
        Token(u128::from(nonce) << 64 | u128::from(self.lease_mac(key, nonce, holder)))
    }

    /// Whether the token of a lease was issued here to the holder of the access token of this name, at any time.
    pub fn verify(&self, key: &LeaseKey, holder: &str) -> bool {
        let nonce = (key.token.0 >> 64) as u64;
        self.token(key, nonce, holder) == key.token
    }

    /// The token that authenticates a worker in its calls: its public id and the code of that.
    pub fn worker_token(&self, id: &WorkerId) -> String {
        format!("{id}.{}", self.worker_mac(id).to_hex())
    }

    /// The worker of a token; none if the token was not issued here.
    pub fn verify_worker(&self, token: &str) -> Option<WorkerId> {
        let (id, mac) = token.rsplit_once('.')?;
        let id = WorkerId(id.to_owned());
        // Compared in constant time.
        (blake3::Hash::from_hex(mac).ok()? == self.worker_mac(&id)).then_some(id)
    }

    fn worker_mac(&self, id: &WorkerId) -> blake3::Hash {
        self.hasher("worker").update(id.0.as_bytes()).finalize()
    }

    fn lease_mac(&self, key: &LeaseKey, nonce: u64, holder: &str) -> u64 {
        let mut hasher = self.hasher("lease");
        write_part(&mut hasher, PartId::from(key));
        hasher.update(&key.attempt.to_le_bytes());
        hasher.update(&nonce.to_le_bytes());
        // Last, since its length is not part of the message.
        hasher.update(holder.as_bytes());
        u64::from_le_bytes(first_bytes(&hasher))
    }

    fn hasher(&self, what: &str) -> blake3::Hasher {
        let Secret(key) = &self.0;
        let mut hasher = blake3::Hasher::new_keyed(key);
        hasher.update(what.as_bytes());
        hasher
    }
}

fn write_part(hasher: &mut blake3::Hasher, part: PartId) {
    hasher.update(&part.dictionary.0.to_le_bytes());
    hasher.update(&part.job.to_le_bytes());
    hasher.update(&part.part.to_le_bytes());
}

fn first_bytes<const N: usize>(hasher: &blake3::Hasher) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.copy_from_slice(&hasher.finalize().as_bytes()[..N]);
    bytes
}

#[cfg(test)]
mod tests {
    use farm_proto::ids::DictionaryId;

    use super::*;

    const MAC: LeaseMac = LeaseMac(Secret([1; 32]));

    fn part(job: u32) -> PartId {
        PartId { dictionary: DictionaryId(1), job, part: 0 }
    }

    fn digest(number: u32) -> Digest {
        Digest::of_bytes(&number.to_le_bytes())
    }

    #[test]
    fn the_sampled_share_has_the_size_asked_for() {
        let sampled = |share| (0..20_000).filter(|i| MAC.is_sampled(part(0), digest(*i), share)).count();
        assert_eq!((sampled(0.0), sampled(1.0)), (0, 20_000));
        // Three standard deviations.
        assert!(sampled(0.01).abs_diff(200) < 43, "{}", sampled(0.01));
    }

    /// Which results are checked cannot be predicted without the secret, nor from the draws of another job.
    #[test]
    fn samples_depend_on_the_secret_and_the_job() {
        let other = LeaseMac(Secret([2; 32]));
        let differ = |a: &dyn Fn(u32) -> bool, b: &dyn Fn(u32) -> bool| {
            let unequal = (0..20_000).filter(|i| a(*i) != b(*i)).count();
            // Independent draws of one half differ in one half: five standard deviations.
            assert!(unequal.abs_diff(10_000) < 354, "{unequal}");
        };
        let own = |i| MAC.is_sampled(part(0), digest(i), 0.5);
        differ(&own, &|i| other.is_sampled(part(0), digest(i), 0.5));
        differ(&own, &|i| MAC.is_sampled(part(1), digest(i), 0.5));
    }

    #[test]
    fn a_worker_token_cannot_be_made_from_the_id() {
        let [a, b] = ["a.1", "b"].map(|id| WorkerId(id.to_owned()));
        let token = MAC.worker_token(&a);
        assert_eq!(MAC.verify_worker(&token), Some(a.clone()));
        assert_eq!(LeaseMac(Secret([2; 32])).verify_worker(&token), None);
        let of_b = MAC.worker_token(&b);
        let mac = of_b.split_once('.').unwrap().1;
        for forged in ["a.1".to_owned(), format!("a.1.{mac}"), "a.1.".to_owned(), String::new()] {
            assert_eq!(MAC.verify_worker(&forged), None, "{forged}");
        }
    }

    #[test]
    fn a_token_holds_for_its_lease_and_its_holder_alone() {
        let bare = LeaseKey { dictionary: DictionaryId(1), job: 2, attempt: 3, token: Token(0), part: 4 };
        let key = LeaseKey { token: MAC.token(&bare, 7, "a"), ..bare };
        assert!(MAC.verify(&key, "a"));
        assert!(
            !MAC.verify(&key, "b") && !LeaseMac(Secret([2; 32])).verify(&key, "a") && !MAC.verify(&bare, "a")
        );
        let others = [
            LeaseKey { dictionary: DictionaryId(2), ..key },
            LeaseKey { job: 3, ..key },
            LeaseKey { attempt: 4, ..key },
            LeaseKey { part: 5, ..key },
            LeaseKey { token: Token(key.token.0 ^ 1), ..key },
            LeaseKey { token: Token(key.token.0 ^ 1 << 100), ..key },
        ];
        for other in others {
            assert!(!MAC.verify(&other, "a"), "{other:?}");
        }
    }
}
