//! What only the coordinator can know or make, since it is keyed by a secret of its database: which results are checked,
//! the tokens of leases, and what a worker says to be taken for itself.
//!
//! All are functions of what they are about, so that nothing of them needs to be stored: after a restart the same
//! results are drawn, and leases that were given out before are told from such that never were.

use farm_proto::ids::{Token, WorkerId};
use farm_proto::lease::LeaseKey;
use optics_model::Digest;

use super::PartId;
use crate::stored::Secret;

#[derive(Debug, Clone, Copy)]
pub(super) struct Seal(pub Secret);

impl Seal {
    /// Whether a result is among the share that is checked: as good as chance for whoever does not know the secret, so that
    /// nobody can compute wrongly until it is not drawn.
    pub fn draws(&self, part: PartId, result: Digest, share: f64) -> bool {
        let mut hasher = self.hasher("draw");
        write_part(&mut hasher, part);
        hasher.update(result.as_bytes());
        let drawn = u32::from_le_bytes(first_bytes(&hasher));
        f64::from(drawn) < share * 2.0_f64.powi(32)
    }

    /// The token of a lease that is given to whoever has shown the access token of this name; `nonce` makes it another
    /// one each time.
    pub fn token(&self, key: &LeaseKey, nonce: u64, holder: &str) -> Token {
        Token(u128::from(nonce) << 64 | u128::from(self.mark(key, nonce, holder)))
    }

    /// Whether a lease with this key was given to whoever has shown the access token of this name, lately or long ago.
    pub fn gave(&self, key: &LeaseKey, holder: &str) -> bool {
        let nonce = (key.token.0 >> 64) as u64;
        self.token(key, nonce, holder) == key.token
    }

    /// What a worker calls itself in its calls: its id, which everybody may read, and what it alone is told.
    pub fn pass(&self, id: &WorkerId) -> String {
        format!("{id}.{}", self.proof(id).to_hex())
    }

    /// Whose pass this is; none if it was not made here.
    pub fn bearer(&self, pass: &str) -> Option<WorkerId> {
        let (id, proof) = pass.rsplit_once('.')?;
        let id = WorkerId(id.to_owned());
        // Compared in constant time.
        (blake3::Hash::from_hex(proof).ok()? == self.proof(&id)).then_some(id)
    }

    fn proof(&self, id: &WorkerId) -> blake3::Hash {
        self.hasher("worker").update(id.0.as_bytes()).finalize()
    }

    fn mark(&self, key: &LeaseKey, nonce: u64, holder: &str) -> u64 {
        let mut hasher = self.hasher("lease");
        write_part(&mut hasher, PartId::from(key));
        hasher.update(&key.attempt.to_le_bytes());
        hasher.update(&nonce.to_le_bytes());
        // Last, since its length is not told.
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

    const SEAL: Seal = Seal(Secret([1; 32]));

    fn part(job: u32) -> PartId {
        PartId { dictionary: DictionaryId(1), job, part: 0 }
    }

    fn digest(number: u32) -> Digest {
        Digest::of_bytes(&number.to_le_bytes())
    }

    #[test]
    fn the_share_that_is_checked_is_as_large_as_it_should_be() {
        let drawn = |share| (0..20_000).filter(|i| SEAL.draws(part(0), digest(*i), share)).count();
        assert_eq!((drawn(0.0), drawn(1.0)), (0, 20_000));
        // Three standard deviations.
        assert!(drawn(0.01).abs_diff(200) < 43, "{}", drawn(0.01));
    }

    /// Which results are checked cannot be predicted without the secret, nor from the draws of another job.
    #[test]
    fn draws_are_independent_of_other_secrets_and_jobs() {
        let other = Seal(Secret([2; 32]));
        let differ = |a: &dyn Fn(u32) -> bool, b: &dyn Fn(u32) -> bool| {
            let unequal = (0..20_000).filter(|i| a(*i) != b(*i)).count();
            // Independent draws of one half differ in one half: five standard deviations.
            assert!(unequal.abs_diff(10_000) < 354, "{unequal}");
        };
        let own = |i| SEAL.draws(part(0), digest(i), 0.5);
        differ(&own, &|i| other.draws(part(0), digest(i), 0.5));
        differ(&own, &|i| SEAL.draws(part(1), digest(i), 0.5));
    }

    #[test]
    fn a_pass_is_that_of_one_worker_and_cannot_be_made_from_its_id() {
        let [a, b] = ["a.1", "b"].map(|id| WorkerId(id.to_owned()));
        let pass = SEAL.pass(&a);
        assert_eq!(SEAL.bearer(&pass), Some(a.clone()));
        assert_eq!(Seal(Secret([2; 32])).bearer(&pass), None);
        let of_b = SEAL.pass(&b);
        let proof = of_b.split_once('.').unwrap().1;
        for forged in ["a.1".to_owned(), format!("a.1.{proof}"), "a.1.".to_owned(), String::new()] {
            assert_eq!(SEAL.bearer(&forged), None, "{forged}");
        }
    }

    #[test]
    fn a_token_holds_for_its_lease_and_its_holder_alone() {
        let bare = LeaseKey { dictionary: DictionaryId(1), job: 2, attempt: 3, token: Token(0), part: 4 };
        let key = LeaseKey { token: SEAL.token(&bare, 7, "a"), ..bare };
        assert!(SEAL.gave(&key, "a"));
        assert!(!SEAL.gave(&key, "b") && !Seal(Secret([2; 32])).gave(&key, "a") && !SEAL.gave(&bare, "a"));
        let others = [
            LeaseKey { dictionary: DictionaryId(2), ..key },
            LeaseKey { job: 3, ..key },
            LeaseKey { attempt: 4, ..key },
            LeaseKey { part: 5, ..key },
            LeaseKey { token: Token(key.token.0 ^ 1), ..key },
            LeaseKey { token: Token(key.token.0 ^ 1 << 100), ..key },
        ];
        for other in others {
            assert!(!SEAL.gave(&other, "a"), "{other:?}");
        }
    }
}
