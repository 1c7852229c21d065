//! Issues and verifies the tokens of workers. A worker's public id, with a code keyed by the secret, authenticates it in
//! its calls.

use farm_proto::ids::WorkerId;

use crate::dispatch::mac::hasher;
use crate::stored::Secret;

/// The token that authenticates a worker in its calls: its public id and the keyed code of the id.
pub(super) fn issue(secret: &Secret, id: &WorkerId) -> String {
    format!("{id}.{}", mac(secret, id).to_hex())
}

/// The worker of a token; none if the token was not issued here.
pub(super) fn verify(secret: &Secret, token: &str) -> Option<WorkerId> {
    let (id, code) = token.rsplit_once('.')?;
    let id = WorkerId(id.to_owned());
    // Compared in constant time.
    (blake3::Hash::from_hex(code).ok()? == mac(secret, &id)).then_some(id)
}

fn mac(secret: &Secret, id: &WorkerId) -> blake3::Hash {
    hasher(secret, "worker").update(id.0.as_bytes()).finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: Secret = Secret([1; 32]);

    /// A worker token cannot be made from the worker's id without the secret.
    #[test]
    fn worker_token_needs_the_secret() {
        let [a, b] = ["a.1", "b"].map(|id| WorkerId(id.to_owned()));
        let token = issue(&SECRET, &a);
        assert_eq!(verify(&SECRET, &token), Some(a.clone()));
        assert_eq!(verify(&Secret([2; 32]), &token), None);
        let of_b = issue(&SECRET, &b);
        let mac = of_b.split_once('.').unwrap().1;
        for forged in ["a.1".to_owned(), format!("a.1.{mac}"), "a.1.".to_owned(), String::new()] {
            assert_eq!(verify(&SECRET, &forged), None, "{forged}");
        }
    }
}
