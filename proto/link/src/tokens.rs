//! Checks tokens against the hashes of those that are accepted.

use std::collections::HashSet;

use serde::Deserialize;
use subtle::{ConditionallySelectable as _, ConstantTimeEq as _};

use crate::{Role, TOKEN_BYTES, token_hash};

/// Largest number of tokens, since each call compares its token with all entries.
const MOST_TOKENS: usize = 1000;
/// Longest name, since names appear in every line of the log.
const LONGEST_NAME: usize = 64;

/// The tokens that a coordinator accepts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tokens(Vec<AcceptedToken>);

#[derive(Debug, Clone, PartialEq, Eq)]
struct AcceptedToken {
    role: Role,
    name: String,
    hash: blake3::Hash,
}

/// An entry of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TokenTable {
    role: Role,
    name: String,
    blake3: String,
}

impl Tokens {
    /// The role and the name of a token. The duration depends neither on where the token differs from the accepted
    /// ones, nor on which of them it equals.
    pub fn role_of(&self, presented: &str) -> Option<(Role, &str)> {
        if !TOKEN_BYTES.contains(&presented.len()) {
            return None;
        }
        let presented = token_hash(presented);
        // Counted from 1; 0 is none.
        let mut found = 0_u32;
        for (number, token) in (1_u32..).zip(&self.0) {
            let equal = token.hash.as_bytes().as_slice().ct_eq(presented.as_bytes());
            found.conditional_assign(&number, equal);
        }
        let token = self.0.get(found.checked_sub(1)? as usize)?;
        Some((token.role, &token.name))
    }

    /// Whether the token with this hash has this role.
    pub fn have(&self, hash: &blake3::Hash, role: Role) -> bool {
        self.0.iter().any(|token| token.hash == *hash && token.role == role)
    }

    /// Roles and names, in their order.
    pub fn names(&self) -> impl Iterator<Item = (Role, &str)> {
        self.0.iter().map(|token| (token.role, token.name.as_str()))
    }
}

/// Whether a token may have this name.
pub fn is_token_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
    (1..=LONGEST_NAME).contains(&name.len()) && name.chars().all(allowed)
}

/// The checked entries, or a field and its error.
pub(crate) fn checked(tables: Vec<TokenTable>) -> Result<Tokens, (String, String)> {
    if !(1..=MOST_TOKENS).contains(&tables.len()) {
        return Err((
            "token".to_owned(),
            format!("must have 1 to {MOST_TOKENS} entries, not {}", tables.len()),
        ));
    }
    let mut seen = HashSet::new();
    let mut tokens = Vec::with_capacity(tables.len());
    for (index, table) in tables.into_iter().enumerate() {
        let token = token(table).map_err(|(field, problem)| (format!("token[{index}].{field}"), problem))?;
        if !seen.insert(*token.hash.as_bytes()) {
            return Err((format!("token[{index}].blake3"), "stands twice: whose token is it?".to_owned()));
        }
        tokens.push(token);
    }
    Ok(Tokens(tokens))
}

fn token(table: TokenTable) -> Result<AcceptedToken, (&'static str, String)> {
    if !is_token_name(&table.name) {
        let problem =
            format!("= {:?} must be 1 to {LONGEST_NAME} letters, digits, '_', '.' or '-'", table.name);
        return Err(("name", problem));
    }
    // The given text is not shown: it may be the token itself.
    let hash = blake3::Hash::from_hex(&table.blake3)
        .map_err(|_| ("blake3", "must be the token's BLAKE3 hash: 64 hexadecimal digits".to_owned()))?;
    Ok(AcceptedToken { role: table.role, name: table.name, hash })
}
