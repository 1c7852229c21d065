//! Identifies each call by a request id, by which the logs of both sides can be matched.

use std::fmt;

use http::{HeaderMap, HeaderName, HeaderValue};

use crate::clock::random_token;

const HEADER: HeaderName = HeaderName::from_static("x-request-id");
const LONGEST: usize = 64;

/// The request id of a call: the caller's own, or a random one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestId(String);

impl RequestId {
    /// Takes `x-request-id` if it is 1 to 64 letters, digits, `_`, `.` or `-`: nothing that could forge a line of a log.
    pub(super) fn of(headers: &HeaderMap) -> Self {
        let given = headers.get(HEADER).and_then(|value| value.to_str().ok());
        let allowed = |b: u8| b.is_ascii_alphanumeric() || b"_.-".contains(&b);
        match given {
            Some(id) if (1..=LONGEST).contains(&id.len()) && id.bytes().all(allowed) => Self(id.to_owned()),
            _ => Self(random_token()),
        }
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }

    pub(super) fn put_into(&self, headers: &mut HeaderMap) {
        if let Ok(value) = HeaderValue::from_str(&self.0) {
            headers.insert(HEADER, value);
        }
    }
}

impl fmt::Display for RequestId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(given: &str) -> RequestId {
        RequestId::of(&HeaderMap::from_iter([(HEADER, HeaderValue::from_bytes(given.as_bytes()).unwrap())]))
    }

    /// The request id of a caller is used if it is short and has only harmless characters.
    #[test]
    fn harmless_request_ids_are_taken_over() {
        let longest = "x".repeat(64);
        for given in ["a", "Run_1.2-3", &longest] {
            assert_eq!(of(given).as_str(), given);
        }
        let too_long = "x".repeat(65);
        for given in ["", "a b", "a=b", "ä", "\"", &too_long] {
            let id = of(given);
            assert!(id.as_str() != given && id.as_str().len() == 32, "{id}");
        }
        assert_ne!(RequestId::of(&HeaderMap::new()), RequestId::of(&HeaderMap::new()));
    }
}
