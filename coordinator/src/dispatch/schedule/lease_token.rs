//! Issues and verifies the tokens of leases. A token proves that this coordinator granted the lease, before or after a
//! restart, to the holder of one access token.

use farm_proto::ids::Token;
use farm_proto::lease::LeaseKey;

use crate::dispatch::mac::{first_bytes, hasher, write_part};
use crate::dispatch::part::PartId;
use crate::stored::Secret;

/// The token of a lease for the holder of the access token of this name. `nonce` makes each token unique.
pub(super) fn issue(secret: &Secret, key: &LeaseKey, nonce: u64, holder: &str) -> Token {
    Token(u128::from(nonce) << 64 | u128::from(mac(secret, key, nonce, holder)))
}

/// Whether the token of a lease was issued here to the holder of the access token of this name, at any time.
pub(super) fn verify(secret: &Secret, key: &LeaseKey, holder: &str) -> bool {
    let nonce = (key.token.0 >> 64) as u64;
    issue(secret, key, nonce, holder) == key.token
}

fn mac(secret: &Secret, key: &LeaseKey, nonce: u64, holder: &str) -> u64 {
    let mut hasher = hasher(secret, "lease");
    write_part(&mut hasher, PartId::from(key));
    hasher.update(&key.attempt.to_le_bytes());
    hasher.update(&nonce.to_le_bytes());
    // Last, since its length is not part of the message.
    hasher.update(holder.as_bytes());
    u64::from_le_bytes(first_bytes(&hasher))
}

#[cfg(test)]
mod tests {
    use farm_proto::ids::DictionaryId;

    use super::*;

    const SECRET: Secret = Secret([1; 32]);

    /// A lease token is valid for its lease and its holder only.
    #[test]
    fn lease_token_binds_lease_and_holder() {
        let bare = LeaseKey { dictionary: DictionaryId(1), job: 2, attempt: 3, token: Token(0), part: 4 };
        let key = LeaseKey { token: issue(&SECRET, &bare, 7, "a"), ..bare };
        assert!(verify(&SECRET, &key, "a"));
        assert!(
            !verify(&SECRET, &key, "b")
                && !verify(&Secret([2; 32]), &key, "a")
                && !verify(&SECRET, &bare, "a")
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
            assert!(!verify(&SECRET, &other, "a"), "{other:?}");
        }
    }
}
