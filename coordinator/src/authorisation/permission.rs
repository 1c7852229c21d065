//! Decides which calls are admitted, by their method and the caller's role.

use std::net::SocketAddr;

use farm_link::{Role, Tokens, token_hash};
use http::header::AUTHORIZATION;
use http::{Extensions, HeaderMap, Request};
use tonic::Status;
use tonic::body::Body;
use tonic::transport::server::TlsConnectInfo;

use crate::actor::Actor;
use crate::connections::{Peer, network};
use crate::gate::Gate;
use crate::stored::Machine;

/// The caller, by its token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    name: String,
    role: Role,
    /// Hash of the token.
    hash: blake3::Hash,
}

impl Caller {
    /// The token's name in the coordinator's access file.
    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn role(&self) -> Role {
        self.role
    }

    /// Role and name, by which messages distinguish two tokens: a name alone may occur twice.
    pub(super) fn label(&self) -> String {
        format!("{} {}", self.role, self.name)
    }

    pub(super) fn hash(&self) -> blake3::Hash {
        self.hash
    }
}

/// The caller, by its token and its address.
pub(crate) fn actor(extensions: &Extensions) -> Actor {
    let token = extensions.get::<Caller>().map(|caller| (caller.role, caller.name.clone()));
    let address = remote(extensions).map(|address| address.ip().to_canonical().to_string());
    Actor { token, address: address.unwrap_or_default() }
}

/// The name of the coordinator's own user, in logs and events.
const OWN_USER: &str = "local";

/// Requirements of paths that begin with these. The first match counts, and paths without one are for admins.
const RULES: [(&str, Needed); 5] = [
    ("/grpc.health.v1.Health/", Needed::Nothing),
    ("/grpc.reflection.", Needed::Nothing),
    ("/farm.v1.Leases/", Needed::OneOf(&[Role::Worker, Role::Admin])),
    ("/farm.v1.Admin/", Needed::OneOf(&[Role::Admin])),
    ("/farm.v1.", Needed::OneOf(&[Role::Client, Role::Admin])),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Needed {
    Nothing,
    OneOf(&'static [Role]),
}

fn needed(path: &str) -> Needed {
    let rule = RULES.iter().find(|(prefix, _)| path.starts_with(prefix));
    rule.map_or(Needed::OneOf(&[Role::Admin]), |&(_, needed)| needed)
}

/// The basis on which a call is admitted.
#[derive(Debug)]
pub(super) struct Admitted {
    pub caller: Option<Caller>,
    /// Whether the call has no token, and needs none although others do.
    pub is_open: bool,
}

impl Admitted {
    fn by(caller: Option<Caller>) -> Self {
        Self { is_open: caller.is_none(), caller }
    }
}

/// The basis on which a call is admitted, or the reason for its refusal.
pub(super) fn admit(gate: &Gate, request: &Request<Body>) -> Result<Admitted, Status> {
    let path = request.uri().path();
    match gate {
        Gate::Everybody => Ok(Admitted { caller: None, is_open: false }),
        Gate::OwnUser => admit_own_user(gate, path, request.extensions()),
        Gate::File(access) => admit_token(gate, &access.tokens(), path, request.headers()),
    }
}

/// Admits programs of the coordinator's own user, which connect to its Unix socket.
fn admit_own_user(gate: &Gate, path: &str, extensions: &Extensions) -> Result<Admitted, Status> {
    let is_own = connection(extensions).is_some_and(|peer| peer.connection.is_own_user);
    let caller =
        is_own.then(|| Caller { name: OWN_USER.to_owned(), role: Role::Admin, hash: token_hash("") });
    if caller.is_none() && needed(path) != Needed::Nothing {
        return Err(Status::unauthenticated(gate.advice()));
    }
    Ok(Admitted::by(caller))
}

fn admit_token(gate: &Gate, tokens: &Tokens, path: &str, headers: &HeaderMap) -> Result<Admitted, Status> {
    let token = bearer_token(headers);
    let known = token.and_then(|token| Some((token, tokens.role_of(token)?)));
    let caller =
        known.map(|(token, (role, name))| Caller { name: name.to_owned(), role, hash: token_hash(token) });
    let Needed::OneOf(roles) = needed(path) else { return Ok(Admitted::by(caller)) };
    let wanted = roles.iter().map(|role| role.as_str()).collect::<Vec<_>>().join(" or ");
    let why = match &caller {
        Some(caller) if roles.contains(&caller.role) => return Ok(Admitted::by(Some(caller.clone()))),
        Some(Caller { name, role, .. }) => {
            return Err(Status::permission_denied(format!(
                "this call needs a token of role {wanted}, and the one given ({name}) has role {role}"
            )));
        }
        None if token.is_none() => "there is none",
        None => "this coordinator does not know the one given",
    };
    let advice = gate.advice();
    Err(Status::unauthenticated(format!("this call needs a token of role {wanted}, and {why}: {advice}")))
}

/// The status that ends a call whose caller is no longer admitted.
pub(super) fn revoked(caller: &Caller) -> Status {
    let Caller { name, .. } = caller;
    Status::unauthenticated(format!("the token of this call ({name}) was revoked"))
}

/// The token in `authorization: Bearer TOKEN`.
fn bearer_token(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim_start())
}

/// Address of the other end of a call's connection, for the log.
pub(super) fn peer(extensions: &Extensions) -> Option<String> {
    remote(extensions).map(|address| address.to_string())
}

fn remote(extensions: &Extensions) -> Option<SocketAddr> {
    connection(extensions)?.tcp.remote_addr()
}

/// The connection of a call.
pub(super) fn connection(extensions: &Extensions) -> Option<&Peer> {
    let encrypted = || extensions.get::<TlsConnectInfo<Peer>>().map(TlsConnectInfo::get_ref);
    extensions.get::<Peer>().or_else(encrypted)
}

/// The machine at the other end of a call's connection, identified by token and address.
pub(crate) fn machine(extensions: &Extensions) -> Machine {
    let token = extensions.get::<Caller>().map(Caller::name).unwrap_or_default().to_owned();
    let address = remote(extensions).map_or_else(String::new, |address| network(address.ip()));
    Machine { token, address, host: String::new() }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tonic::transport::server::TcpConnectInfo;

    use super::*;
    use crate::connections::OpenConnection;

    /// Each path is for its roles, and an unknown one for administrators only.
    #[test]
    fn unknown_paths_are_for_admins_only() {
        let cases: [(&str, &[Role]); 9] = [
            ("/farm.v1.Leases/Acquire", &[Role::Worker, Role::Admin]),
            ("/farm.v1.Admin/Drain", &[Role::Admin]),
            ("/farm.v1.Fits/Fit", &[Role::Client, Role::Admin]),
            ("/farm.v1.LeasesOfMine/X", &[Role::Client, Role::Admin]),
            ("/farm.v2.Fits/Fit", &[Role::Admin]),
            ("//farm.v1.Fits/Fit", &[Role::Admin]),
            ("/grpc.health.v1.HealthX/Check", &[Role::Admin]),
            ("/", &[Role::Admin]),
            ("", &[Role::Admin]),
        ];
        for (path, roles) in cases {
            assert_eq!(needed(path), Needed::OneOf(roles), "{path}");
        }
        assert_eq!(needed("/grpc.health.v1.Health/Watch"), Needed::Nothing);
        let reflection = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
        assert_eq!(needed(reflection), Needed::Nothing);
    }

    /// The port does not count. Mapped IPv4 addresses are IPv4, and an IPv6 address counts by its /64, except for
    /// loopback.
    #[test]
    fn machines_are_distinguished_by_normalised_address() {
        for (address, expected) in [
            ("10.0.0.7:1", "10.0.0.7"),
            ("[::ffff:10.0.0.7]:2", "10.0.0.7"),
            ("[2001:db8:1:2:3:4:5:6]:3", "2001:db8:1:2::/64"),
            ("[::1]:3", "::1"),
        ] {
            let tcp = TcpConnectInfo { local_addr: None, remote_addr: Some(address.parse().unwrap()) };
            let mut extensions = Extensions::new();
            extensions
                .insert(Peer { tcp, connection: Arc::new(OpenConnection::new(String::new(), false, true)) });
            assert_eq!(machine(&extensions).address, expected);
        }
        assert_eq!(machine(&Extensions::new()), Machine::default());
    }

    /// A token is read from a bearer header and nothing else.
    #[test]
    fn tokens_come_from_bearer_headers_only() {
        let token = |value: &str| {
            let headers = HeaderMap::from_iter([(AUTHORIZATION, value.parse().unwrap())]);
            bearer_token(&headers).map(str::to_owned)
        };
        let cases = [("Bearer abc", Some("abc")), ("bearer  abc", Some("abc")), ("abc", None), ("", None)];
        for (value, expected) in cases.into_iter().chain([("Basic abc", None), ("Bearer", None)]) {
            assert_eq!(token(value).as_deref(), expected, "{value:?}");
        }
        assert_eq!(bearer_token(&HeaderMap::new()), None);
    }
}
