//! Reads the machine's clocks and its randomness.

use std::time::Duration;

use farm_proto::ids::Token;

use crate::dispatch::TokenSource;
use crate::stored::Secret;

/// Reads the machine's clocks.
#[derive(Debug, Clone)]
pub struct Clock {
    start: std::time::Instant,
}

impl Clock {
    #[expect(clippy::disallowed_methods, reason = "this is where the ambient clock enters")]
    pub fn start() -> Self {
        Self { start: std::time::Instant::now() }
    }

    /// Monotonic time since the start, by which leases are measured.
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// Wall-clock time, for people.
    #[expect(clippy::disallowed_methods, reason = "this is where the ambient clock enters")]
    pub fn unix_ms() -> u64 {
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        since.map_or(0, |d| d.as_millis() as u64)
    }
}

/// 128 random bits in hexadecimal: worker ids.
///
/// # Panics
/// If the operating system provides no randomness.
pub fn random_token() -> String {
    format!("{:032x}", random())
}

/// Random bytes that keep something secret for as long as a database is in use.
///
/// # Panics
/// If the operating system provides no randomness.
pub fn random_secret() -> Secret {
    let mut bytes = [0_u8; 32];
    getrandom::fill(&mut bytes).expect("the operating system gives random numbers");
    Secret(bytes)
}

fn random() -> u128 {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).expect("the operating system gives random numbers");
    u128::from_be_bytes(bytes)
}

/// The operating system's randomness.
#[derive(Debug, Clone, Copy)]
pub struct Random;

impl TokenSource for Random {
    fn token(&mut self) -> Token {
        // 0 is not a valid token.
        Token(random().max(1))
    }
}
