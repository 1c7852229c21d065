//! Reads the access file of a worker, a client or an admin.

use std::path::{Path, PathBuf};

use secrecy::{ExposeSecret as _, SecretString};
use serde::Deserialize;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};

use crate::endpoint::{Bearer, checked_endpoint};
use crate::error::{AccessError, root_cause};
use crate::handshake::{Credentials, Handshake};
use crate::{HANDSHAKE, Role, TOKEN_BYTES, file, pem};

/// A coordinator's address, its certificates, and the token to present.
///
/// ```toml
/// role = "worker"                      # or "client", "admin"
/// server = "https://farm.example.org:7700"
/// token = "…"
/// ca_certificate = '''-----BEGIN CERTIFICATE----- …'''
/// # Only if the coordinator asks for certificates (mutual TLS):
/// certificate = '''-----BEGIN CERTIFICATE----- …'''
/// key = '''-----BEGIN PRIVATE KEY----- …'''
/// # Only if the coordinator's certificate has another name than the URL:
/// server_name = "farm.example.org"
/// ```
#[derive(Debug, Clone)]
pub struct ClientAccess {
    path: PathBuf,
    fields: ClientFields,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClientFields {
    role: Role,
    server: String,
    ca_certificate: String,
    token: SecretString,
    certificate: Option<String>,
    key: Option<SecretString>,
    server_name: Option<String>,
}

impl ClientAccess {
    /// Reads and checks a file, so that its contents are usable.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        let fields = file::read_secret(path, "the file of a worker, a client or an admin")?;
        let access = Self { path: path.to_owned(), fields };
        access.check_fields()?;
        access.endpoint(None)?;
        Ok(access)
    }

    pub fn role(&self) -> Role {
        self.fields.role
    }

    /// The coordinator's URL.
    pub fn server(&self) -> &str {
        &self.fields.server
    }

    /// Adds the token to calls.
    pub fn bearer(&self) -> Bearer {
        Bearer::of(self.fields.token.expose_secret())
    }

    /// The coordinator, or the one at `override_url`, with encryption. Without it others could read the token: on the
    /// network, or on loopback by listening on a port that is free.
    pub fn endpoint(&self, override_url: Option<&str>) -> Result<Endpoint, AccessError> {
        let url = override_url.unwrap_or(&self.fields.server);
        let (endpoint, security) = checked_endpoint(url)?;
        if security.encrypted {
            return endpoint.tls_config(self.tls()).map_err(|error| self.unusable(&error));
        }
        let problem = "is not encrypted, so that others could read the token: it must begin with https://";
        Err(AccessError::Url { url: url.to_owned(), problem: problem.to_owned() })
    }

    /// A handshake like that of an endpoint of this file; None if the endpoint has none.
    pub(crate) fn handshake(&self, endpoint: &Endpoint) -> Option<Handshake> {
        let fields = &self.fields;
        let key = fields.key.as_ref().map(SecretString::expose_secret);
        let identity = fields.certificate.as_deref().zip(key);
        let server_name = fields.server_name.as_deref();
        let credentials = Credentials { authority: &fields.ca_certificate, identity, server_name };
        let uri = endpoint.uri();
        (uri.scheme_str() == Some("https")).then(|| Handshake::new(uri, credentials))?
    }

    fn tls(&self) -> ClientTlsConfig {
        let authority = Certificate::from_pem(&self.fields.ca_certificate);
        let mut tls = ClientTlsConfig::new().ca_certificate(authority).timeout(HANDSHAKE);
        if let (Some(certificate), Some(key)) = (&self.fields.certificate, &self.fields.key) {
            tls = tls.identity(Identity::from_pem(certificate, key.expose_secret()));
        }
        match &self.fields.server_name {
            Some(name) => tls.domain_name(name),
            None => tls,
        }
    }

    fn check_fields(&self) -> Result<(), AccessError> {
        let fields = &self.fields;
        let wrong = |field, problem| self.wrong(field, problem);
        pem::check_certificates(&fields.ca_certificate).map_err(|p| wrong("ca_certificate", p))?;
        check_token(fields.token.expose_secret()).map_err(|p| wrong("token", p))?;
        match (&fields.certificate, &fields.key) {
            (Some(certificate), Some(key)) => {
                pem::check_certificates(certificate).map_err(|p| wrong("certificate", p))?;
                pem::check_key(key.expose_secret()).map_err(|p| wrong("key", p))
            }
            (Some(_), None) => Err(wrong("key", "is missing: a certificate needs its key".to_owned())),
            (None, Some(_)) => {
                Err(wrong("certificate", "is missing: a key needs its certificate".to_owned()))
            }
            (None, None) => Ok(()),
        }
    }

    fn wrong(&self, field: &str, problem: String) -> AccessError {
        AccessError::Field { path: self.path.clone(), field: field.to_owned(), problem }
    }

    fn unusable(&self, error: &tonic::transport::Error) -> AccessError {
        let problem = format!("certificate, key and server_name cannot be used: {}", root_cause(error));
        AccessError::Content { path: self.path.clone(), problem }
    }
}

/// The error states the allowed form, and not the given token.
fn check_token(token: &str) -> Result<(), String> {
    if TOKEN_BYTES.contains(&token.len()) && token.bytes().all(|b| b.is_ascii_graphic()) {
        return Ok(());
    }
    let (least, most) = (TOKEN_BYTES.start(), TOKEN_BYTES.end());
    Err(format!("must be {least} to {most} visible ASCII characters without spaces"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{TOKEN, ca, identity, key, private_file, refuses};

    fn content(more: &str) -> String {
        format!(
            "role = \"worker\"\nserver = \"https://farm.example.org:7700\"\ntoken = \"{TOKEN}\"\nca_certificate = '''\n{}'''\n{more}",
            ca()
        )
    }

    fn read(text: &str) -> ClientAccess {
        ClientAccess::read(private_file(text).path()).unwrap()
    }

    /// A whole file is read, and its secrets do not appear in debug output.
    #[test]
    fn secrets_of_a_file_are_not_shown() {
        let access = read(&content(&identity()));
        assert_eq!((access.role(), access.server()), (Role::Worker, "https://farm.example.org:7700"));
        let shown = format!("{access:?} {:?}", access.bearer());
        assert!(!shown.contains(TOKEN) && !shown.contains("PRIVATE KEY"), "{shown}");
    }

    /// Errors name the file, the line and the field, but contain no secret. Tokens that are too short or do not fit into a
    /// header are refused.
    #[test]
    fn errors_name_line_and_field_without_secrets() {
        let file = private_file(&content("colour = \"red\"\n"));
        let error = ClientAccess::read(file.path()).unwrap_err().to_string();
        assert!(error.contains(&file.path().display().to_string()), "{error}");
        let line = content("").lines().count() + 1;
        assert!(error.contains(&format!("line {line}: unknown field `colour`")), "{error}");

        let certificate = format!("certificate = '''\n{}'''\n", ca());
        let changed = |from: &str, to: &str| content("").replace(from, to);
        refuses(
            ClientAccess::read,
            [
                (changed("token =", "tokn ="), "unknown field `tokn`"),
                (changed("token = ", "token : "), "line 3"),
                (changed("\"worker\"", "\"boss\""), "expected one of `worker`, `client`, `admin`"),
                (changed("https://farm", "farm"), "must begin with https:// or http://"),
                (changed("https:", "http:"), "must begin with https://"),
                (changed("BEGIN CERT", "BEGIN CART"), "ca_certificate must hold a certificate"),
                (content(&format!("key = '''\n{}'''\n", key())), "certificate is missing"),
                (content(&certificate), "key is missing"),
                (content(&format!("{certificate}key = \"{TOKEN}\"\n")), "key must hold"),
                (content(&format!("{certificate}key = '''\n{}'''\n", key())), "cannot be used"),
                (content("server_name = \"a b\"\n"), "server_name cannot be used"),
            ],
        );
        let (two, accent, long) = (format!("{TOKEN} {TOKEN}"), TOKEN.replace('0', "é"), "x".repeat(513));
        for token in ["short", &two, &accent, &long] {
            let error =
                ClientAccess::read(private_file(&changed(TOKEN, token)).path()).unwrap_err().to_string();
            assert!(error.contains("token must be 32 to 512") && !error.contains(token), "{error}");
        }
    }

    #[test]
    fn another_url_must_be_encrypted_too() {
        let access = read(&content(""));
        assert!(access.endpoint(Some("https://10.0.0.1:7700")).is_ok());
        for host in ["10.0.0.1", "localhost", "127.0.0.1", "[::1]"] {
            let url = format!("http://{host}:7700");
            let error = access.endpoint(Some(&url)).unwrap_err().to_string();
            assert!(error.contains(&url) && error.contains("not encrypted"), "{error}");
        }
    }
}
