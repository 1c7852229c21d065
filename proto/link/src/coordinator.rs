//! Reads the coordinator's access file.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use secrecy::{ExposeSecret as _, SecretString};
use serde::Deserialize;
use tokio::sync::watch;
use tonic::transport::{Certificate, Identity, Server, ServerTlsConfig};

use crate::error::{AccessError, root_cause};
use crate::tokens::{self, TokenTable, Tokens};
use crate::{HANDSHAKE, Role, file, pem};

/// The coordinator's certificate, and the tokens that it accepts.
///
/// ```toml
/// certificate = '''-----BEGIN CERTIFICATE----- …'''
/// key = '''-----BEGIN PRIVATE KEY----- …'''
/// # Only for mutual TLS: clients must have a certificate of this authority, besides a token.
/// client_ca = '''-----BEGIN CERTIFICATE----- …'''
///
/// [[token]]                            # any number of them
/// role = "worker"                      # or "client", "admin"
/// name = "cluster-a"                   # for the log
/// blake3 = "…"                         # BLAKE3 of the token, in hexadecimal
/// ```
///
/// A client's certificate proves that it belongs to the farm; its role depends on its token alone.
#[derive(Debug)]
pub struct CoordinatorAccess {
    path: PathBuf,
    certificate: String,
    key: SecretString,
    client_ca: Option<String>,
    tokens: watch::Sender<Arc<Tokens>>,
    /// Digest of the file when it was last read. Times and sizes do not suffice: they can be set, and be the same.
    digest: Mutex<Option<blake3::Hash>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CoordinatorFields {
    certificate: String,
    key: SecretString,
    client_ca: Option<String>,
    #[serde(rename = "token", default)]
    tokens: Vec<TokenTable>,
}

impl CoordinatorAccess {
    /// Reads and checks a file, including that the key belongs to the certificate.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        // Computed first, so that a file that changes meanwhile is read again.
        let digest = file::digest(path);
        let (fields, tokens) = read_fields(path)?;
        let wrong = |field: &str, problem| AccessError::Field {
            path: path.to_owned(),
            field: field.to_owned(),
            problem,
        };
        pem::check_certificates(&fields.certificate).map_err(|p| wrong("certificate", p))?;
        pem::check_key(fields.key.expose_secret()).map_err(|p| wrong("key", p))?;
        if let Some(authority) = &fields.client_ca {
            pem::check_certificates(authority).map_err(|p| wrong("client_ca", p))?;
        }
        let access = Self {
            path: path.to_owned(),
            certificate: fields.certificate,
            key: fields.key,
            client_ca: fields.client_ca,
            tokens: watch::Sender::new(Arc::new(tokens)),
            digest: Mutex::new(digest),
        };
        access.check_tls()?;
        Ok(access)
    }

    /// Whether clients must present a certificate.
    pub fn is_mutual(&self) -> bool {
        self.client_ca.is_some()
    }

    /// The settings for `Server::tls_config`.
    pub fn server_tls(&self) -> ServerTlsConfig {
        let identity = Identity::from_pem(&self.certificate, self.key.expose_secret());
        let tls = ServerTlsConfig::new().identity(identity).timeout(HANDSHAKE);
        match &self.client_ca {
            Some(authority) => tls.client_ca_root(Certificate::from_pem(authority)),
            None => tls,
        }
    }

    /// The tokens that it accepts now.
    pub fn tokens(&self) -> Arc<Tokens> {
        self.tokens.borrow().clone()
    }

    /// Ends when a token is not accepted for a role, or not any more.
    pub async fn revoked(&self, token: blake3::Hash, role: Role) {
        // The tokens exist as long as this does, so that the wait has no other end.
        let _ = self.tokens.subscribe().wait_for(|tokens| !tokens.have(&token, role)).await;
    }

    /// Reads the file's tokens again, if it has changed since it was last read. Returns whether the tokens have
    /// changed. A file that cannot be used changes nothing, and is an error as long as it is so. Certificates are not
    /// read again: connections that were made with them are open.
    pub fn refresh(&self) -> Result<bool, AccessError> {
        // Computed first, so that a file that changes meanwhile is read again; kept only once the file was read.
        let digest = file::digest(&self.path);
        let last = &mut *self.digest.lock().unwrap_or_else(PoisonError::into_inner);
        if digest.is_some() && *last == digest {
            return Ok(false);
        }
        let tokens = Arc::new(read_fields(&self.path)?.1);
        *last = digest;
        Ok(self.tokens.send_if_modified(|current| {
            let has_changed = *current != tokens;
            *current = tokens;
            has_changed
        }))
    }

    fn check_tls(&self) -> Result<(), AccessError> {
        let tried = Server::builder().tls_config(self.server_tls());
        tried.map(drop).map_err(|error| AccessError::Content {
            path: self.path.clone(),
            problem: format!("certificate, key and client_ca cannot be used: {}", root_cause(&error)),
        })
    }
}

/// The file's fields, and its checked tokens.
fn read_fields(path: &Path) -> Result<(CoordinatorFields, Tokens), AccessError> {
    let mut fields: CoordinatorFields = file::read_secret(path, "the coordinator's file")?;
    let tokens = tokens::checked(std::mem::take(&mut fields.tokens))
        .map_err(|(field, problem)| AccessError::Field { path: path.to_owned(), field, problem })?;
    Ok((fields, tokens))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{TOKEN, ca, certificate, identity, private_file, refuses};
    use crate::{Role, token_hash};

    fn entry(role: &str, name: &str, token: &str) -> String {
        format!("[[token]]\nrole = \"{role}\"\nname = \"{name}\"\nblake3 = \"{}\"\n", token_hash(token))
    }

    fn content(more: &str) -> String {
        identity() + more
    }

    fn other(n: u8) -> String {
        format!("{n:032}")
    }

    /// Other tokens have no role or name, nor does a token's hash. With a client CA in the file, TLS is mutual.
    #[test]
    fn token_has_role_and_name() {
        let entries =
            [entry("worker", "a", &other(1)), entry("client", "b", TOKEN), entry("admin", "c", &other(2))];
        let entries = entries.concat();
        let access = CoordinatorAccess::read(private_file(&content(&entries)).path()).unwrap();
        let hash = token_hash(TOKEN).to_hex();
        for (token, expected) in [
            (other(1).as_str(), Some((Role::Worker, "a"))),
            (TOKEN, Some((Role::Client, "b"))),
            (&other(2), Some((Role::Admin, "c"))),
            (&other(3), None),
            ("", None),
            (&TOKEN[1..], None),
            (&hash, None),
        ] {
            assert_eq!(access.tokens().role_of(token), expected, "{token}");
        }
        assert!(!format!("{access:?}").contains("PRIVATE KEY"));
        let mutual = content(&format!("client_ca = '''\n{}'''\n{entries}", ca()));
        assert!(CoordinatorAccess::read(private_file(&mutual).path()).unwrap().is_mutual());
        assert!(!access.is_mutual());
    }

    #[test]
    fn errors_name_the_field_and_no_secret() {
        let good = entry("worker", "a", TOKEN);
        let changed = |from: &str, to: &str| content(&good).replace(from, to);
        let hash = token_hash(TOKEN).to_hex();
        refuses(
            CoordinatorAccess::read,
            [
                (content(""), "token must have 1 to 1000 entries, not 0"),
                (changed("\"a\"", "\"a b\""), "token[0].name = \"a b\" must be 1 to 64"),
                (changed("\"a\"", "\"\""), "token[0].name"),
                (content(&format!("{good}{good}")), "token[1].blake3 stands twice"),
                (changed(&hash, TOKEN), "token[0].blake3 must be"),
                (changed("blake3", "token"), "unknown field `token`"),
                (changed("\"worker\"", "\"boss\""), "expected one of `worker`, `client`, `admin`"),
                (changed("BEGIN CERT", "BEGIN CART"), "certificate must hold a certificate"),
                (changed("BEGIN PRIVATE", "BEGIN PUBLIC"), "key must hold"),
                (content(&format!("client_ca = \"none\"\n{good}")), "client_ca must hold a certificate"),
                (changed(certificate(), ca()), "certificate, key and client_ca cannot be used"),
            ],
        );
    }

    /// Tokens are read again when the file has changed, even if its size and times are the same.
    #[test]
    fn tokens_are_reloaded_when_the_file_changes() {
        let (first, second) = (entry("worker", "a", TOKEN), entry("client", "b", &other(1)));
        let file = private_file(&content(&first));
        let access = CoordinatorAccess::read(file.path()).unwrap();
        assert!(!access.refresh().unwrap());
        let names =
            || [TOKEN, &other(1)].map(|t| access.tokens().role_of(t).map_or("", |(_, name)| name).to_owned());
        std::fs::write(file.path(), content(&format!("{first}{second}"))).unwrap();
        assert!(access.refresh().unwrap());
        assert_eq!(names(), ["a", "b"]);
        // A file that is no access file changes nothing, and is an error as long as it is there.
        std::fs::write(file.path(), "half a fi").unwrap();
        assert!(access.refresh().is_err() && access.refresh().is_err());
        assert_eq!(names(), ["a", "b"]);
        std::fs::write(file.path(), content(&second)).unwrap();
        assert!(access.refresh().unwrap());
        assert_eq!(names(), ["", "b"]);
        let before = std::fs::metadata(file.path()).unwrap().modified().unwrap();
        std::fs::write(file.path(), content(&entry("client", "c", &other(1)))).unwrap();
        file.as_file().set_modified(before).unwrap();
        assert!(access.refresh().unwrap());
        assert_eq!(names(), ["", "c"]);
    }

    /// A file that was refused for its mode is read once the mode is right: a revoked token does not stay.
    #[tokio::test]
    async fn revocation_counts_once_the_mode_is_right() {
        use std::os::unix::fs::PermissionsExt as _;
        let (first, second) = (entry("worker", "a", TOKEN), entry("client", "b", &other(1)));
        let file = private_file(&content(&format!("{first}{second}")));
        let mode =
            |mode| std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(mode)).unwrap();
        let access = CoordinatorAccess::read(file.path()).unwrap();
        let revoked = access.revoked(token_hash(TOKEN), Role::Worker);
        mode(0o644);
        std::fs::write(file.path(), content(&second)).unwrap();
        assert!((0..3).all(|_| access.refresh().is_err()), "the error is repeated");
        mode(0o600);
        assert!(access.refresh().unwrap() && !access.refresh().unwrap());
        assert_eq!(access.tokens().role_of(TOKEN), None);
        revoked.await;
    }

    /// Files that other users can open are refused, with the remedy.
    #[test]
    fn files_open_to_others_are_refused() {
        use std::os::unix::fs::PermissionsExt as _;
        let file = private_file(&content(&entry("worker", "a", TOKEN)));
        for (mode, refused) in [(0o600, false), (0o440, false), (0o640, false), (0o644, true), (0o602, true)]
        {
            std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(mode)).unwrap();
            let error = CoordinatorAccess::read(file.path()).err().map(|error| error.to_string());
            let remedy = format!("`chmod 600 {}`", file.path().display());
            let named =
                |error: &String| error.contains(&format!("mode {mode:04o}")) && error.contains(&remedy);
            assert_eq!(error.as_ref().map(named), refused.then_some(true), "{mode:o}: {error:?}");
        }
        for (path, reason) in [("/nowhere/access.toml", "/nowhere/access.toml"), ("/tmp", "regular file")] {
            let error = CoordinatorAccess::read(Path::new(path)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
