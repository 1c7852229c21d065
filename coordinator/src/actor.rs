//! Identifies the callers that request changes, by token and address.

use std::fmt;

use farm_link::Role;

/// A caller that requests a change, by its token and the other end of its connection.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Actor {
    /// Role and name of the token; None if no token is needed.
    pub token: Option<(Role, String)>,
    /// Empty if unknown.
    pub address: String,
}

impl Actor {
    /// The name under which it owns the dictionaries that it submits.
    pub fn name(&self) -> &str {
        self.token.as_ref().map_or("", |(_, name)| name)
    }

    /// The key under which it is limited, whatever its role.
    pub fn key(&self) -> &str {
        if self.name().is_empty() { "callers without a token" } else { self.name() }
    }

    /// The name under which limits per token apply to it. Empty for admins, to whom only the limits of all calls apply,
    /// and if there are no tokens.
    pub fn shares_as(&self) -> &str {
        match &self.token {
            None | Some((Role::Admin, _)) => "",
            Some((_, name)) => name,
        }
    }

    /// Whether it may change the dictionaries of an owner: clients only their own, admins all. Without tokens, every
    /// caller may.
    pub fn may_change(&self, owner: &str) -> bool {
        match &self.token {
            None | Some((Role::Admin, _)) => true,
            Some((_, name)) => name == owner,
        }
    }
}

/// Writes the form in events: `alice at 10.0.0.7`.
impl fmt::Display for Actor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let between = if self.name().is_empty() || self.address.is_empty() { "" } else { " at " };
        write!(f, "{}{between}{}", self.name(), self.address)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A client may change its own dictionaries only, an administrator may change all.
    #[test]
    fn clients_change_only_their_own_dictionaries() {
        let actor = |role| Actor { token: Some((role, "alice".to_owned())), address: "10.0.0.7".to_owned() };
        assert!(actor(Role::Client).may_change("alice"));
        assert!(!actor(Role::Client).may_change("bob") && !actor(Role::Client).may_change(""));
        assert!(actor(Role::Admin).may_change("bob") && Actor::default().may_change("bob"));
        assert_eq!(actor(Role::Client).shares_as(), "alice");
        assert_eq!((actor(Role::Admin).shares_as(), Actor::default().shares_as()), ("", ""));
        assert_eq!(actor(Role::Client).to_string(), "alice at 10.0.0.7");
        assert_eq!(Actor { address: "::1".to_owned(), ..Actor::default() }.to_string(), "::1");
    }
}
