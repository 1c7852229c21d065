//! The coordinator's access file.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use secrecy::{ExposeSecret as _, SecretString};
use serde::Deserialize;
use subtle::{ConditionallySelectable as _, ConstantTimeEq as _};
use tonic::transport::{Certificate, Identity, Server, ServerTlsConfig};

use crate::error::{AccessError, root_cause};
use crate::{HANDSHAKE, Role, TOKEN_BYTES, file, pem, token_hash};

/// Tokens are compared with all entries at every call.
const MOST_TOKENS: usize = 1000;
/// Names stand in every line of the log.
const LONGEST_NAME: usize = 64;

/// The coordinator's certificate, and whom it lets in.
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
/// A client's certificate says that it belongs to the farm; what it may do, its token alone says.
#[derive(Debug)]
pub struct CoordinatorAccess {
    path: PathBuf,
    certificate: String,
    key: SecretString,
    client_ca: Option<String>,
    tokens: Vec<Token>,
}

#[derive(Debug)]
struct Token {
    role: Role,
    name: String,
    hash: blake3::Hash,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenTable {
    role: Role,
    name: String,
    blake3: String,
}

impl CoordinatorAccess {
    /// Reads and checks a file, down to the key's belonging to the certificate.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        let fields: CoordinatorFields = file::read_secret(path, "the coordinator's file")?;
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
            tokens: tokens(fields.tokens).map_err(|(field, problem)| wrong(&field, problem))?,
        };
        access.check_tls()?;
        Ok(access)
    }

    /// Whether clients must show a certificate.
    pub fn is_mutual(&self) -> bool {
        self.client_ca.is_some()
    }

    /// For `Server::tls_config`.
    pub fn server_tls(&self) -> ServerTlsConfig {
        let identity = Identity::from_pem(&self.certificate, self.key.expose_secret());
        let tls = ServerTlsConfig::new().identity(identity).timeout(HANDSHAKE);
        match &self.client_ca {
            Some(authority) => tls.client_ca_root(Certificate::from_pem(authority)),
            None => tls,
        }
    }

    /// Role and name that belong to a token. Takes the same time wherever the token differs from those in the file, and
    /// whichever of them it is.
    pub fn role_of(&self, presented: &str) -> Option<(Role, &str)> {
        if !TOKEN_BYTES.contains(&presented.len()) {
            return None;
        }
        let presented = token_hash(presented);
        // Counted from 1; 0 is none.
        let mut found = 0_u32;
        for (number, token) in (1_u32..).zip(&self.tokens) {
            let equal = token.hash.as_bytes().as_slice().ct_eq(presented.as_bytes());
            found.conditional_assign(&number, equal);
        }
        let token = self.tokens.get(found.checked_sub(1)? as usize)?;
        Some((token.role, &token.name))
    }

    /// How many tokens there are of a role.
    pub fn tokens_of(&self, role: Role) -> usize {
        self.tokens.iter().filter(|token| token.role == role).count()
    }

    fn check_tls(&self) -> Result<(), AccessError> {
        let tried = Server::builder().tls_config(self.server_tls());
        tried.map(drop).map_err(|error| AccessError::Content {
            path: self.path.clone(),
            problem: format!("certificate, key and client_ca cannot be used: {}", root_cause(&error)),
        })
    }
}

/// The checked entries, or a field and what is wrong with it.
fn tokens(tables: Vec<TokenTable>) -> Result<Vec<Token>, (String, String)> {
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
    Ok(tokens)
}

fn token(table: TokenTable) -> Result<Token, (&'static str, String)> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
    if !(1..=LONGEST_NAME).contains(&table.name.len()) || !table.name.chars().all(allowed) {
        let problem =
            format!("= {:?} must be 1 to {LONGEST_NAME} letters, digits, '_', '.' or '-'", table.name);
        return Err(("name", problem));
    }
    // What was given is not shown: it may be the token itself.
    let hash = blake3::Hash::from_hex(&table.blake3)
        .map_err(|_| ("blake3", "must be the token's BLAKE3 hash: 64 hexadecimal digits".to_owned()))?;
    Ok(Token { role: table.role, name: table.name, hash })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{TOKEN, ca, certificate, key, private_file};

    fn entry(role: &str, name: &str, token: &str) -> String {
        format!("[[token]]\nrole = \"{role}\"\nname = \"{name}\"\nblake3 = \"{}\"\n", token_hash(token))
    }

    fn content(more: &str) -> String {
        format!("certificate = '''\n{}'''\nkey = '''\n{}'''\n{more}", certificate(), key())
    }

    fn read(text: &str) -> Result<CoordinatorAccess, String> {
        let file = private_file(text);
        CoordinatorAccess::read(file.path()).map_err(|error| error.to_string())
    }

    fn other(n: u8) -> String {
        format!("{n:032}")
    }

    #[test]
    fn a_token_has_the_role_and_the_name_of_its_entry_and_others_have_none() {
        let entries =
            [entry("worker", "a", &other(1)), entry("client", "b", TOKEN), entry("admin", "c", &other(2))];
        let access = read(&content(&entries.concat())).unwrap();
        assert_eq!(access.role_of(&other(1)), Some((Role::Worker, "a")));
        assert_eq!(access.role_of(TOKEN), Some((Role::Client, "b")));
        assert_eq!(access.role_of(&other(2)), Some((Role::Admin, "c")));
        assert_eq!(access.role_of(&other(3)), None);
        assert_eq!(access.role_of(""), None);
        assert_eq!(access.role_of(&TOKEN[1..]), None);
        assert_eq!(access.role_of(token_hash(TOKEN).to_hex().as_str()), None, "a hash lets nobody in");
        assert!(!format!("{access:?}").contains("PRIVATE KEY"));
        assert!(!access.is_mutual());
    }

    #[test]
    fn errors_name_the_field_and_no_secret() {
        let good = entry("worker", "a", TOKEN);
        let cases = [
            (content(""), "token must have 1 to 1000 entries, not 0"),
            (content(&good.replace("\"a\"", "\"a b\"")), "token[0].name = \"a b\" must be 1 to 64"),
            (content(&good.replace("\"a\"", "\"\"")), "token[0].name"),
            (content(&format!("{good}{good}")), "token[1].blake3 stands twice"),
            (content(&good).replace(token_hash(TOKEN).to_hex().as_str(), TOKEN), "token[0].blake3 must be"),
            (content(&good).replace("blake3", "token"), "unknown field `token`"),
            (content(&good).replace("\"worker\"", "\"boss\""), "expected one of `worker`, `client`, `admin`"),
            (content(&good).replace("BEGIN CERT", "BEGIN CART"), "certificate must hold a certificate"),
            (content(&good).replace("BEGIN PRIVATE", "BEGIN PUBLIC"), "key must hold"),
            (content(&format!("client_ca = \"none\"\n{good}")), "client_ca must hold a certificate"),
            (content(&good).replace(certificate(), ca()), "certificate, key and client_ca cannot be used"),
        ];
        for (text, expected) in cases {
            let error = read(&text).unwrap_err();
            assert!(error.contains(expected), "{expected:?} is not in {error:?}");
            assert!(!error.contains(TOKEN), "{error}");
        }
    }

    #[test]
    fn with_a_client_ca_it_is_mutual() {
        let more = format!("client_ca = '''\n{}'''\n{}", ca(), entry("worker", "a", TOKEN));
        assert!(read(&content(&more)).unwrap().is_mutual());
    }

    #[test]
    fn files_that_others_can_open_are_refused_with_the_remedy() {
        use std::os::unix::fs::PermissionsExt as _;
        let file = private_file(&content(&entry("worker", "a", TOKEN)));
        for (mode, refused) in [(0o600, false), (0o440, false), (0o640, false), (0o644, true), (0o602, true)]
        {
            std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(mode)).unwrap();
            match CoordinatorAccess::read(file.path()) {
                Ok(_) => assert!(!refused, "{mode:o}"),
                Err(error) => {
                    assert!(refused, "{error}");
                    let error = error.to_string();
                    assert!(error.contains(&format!("mode {mode:04o}")), "{error}");
                    assert!(error.contains(&format!("`chmod 600 {}`", file.path().display())), "{error}");
                }
            }
        }
        let missing = CoordinatorAccess::read(Path::new("/nowhere/access.toml")).unwrap_err().to_string();
        assert!(missing.contains("/nowhere/access.toml"), "{missing}");
        assert!(
            CoordinatorAccess::read(&std::env::temp_dir()).unwrap_err().to_string().contains("regular file")
        );
    }
}
