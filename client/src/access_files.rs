//! Creates access files: an authority for the farm, a certificate for the coordinator, and a token for each role.
//!
//! The authority's private key is discarded after signing. It cannot be stolen, and no certificate can be added later:
//! for another host name, or when a member's certificate must be revoked, a new set is created and distributed. Tokens
//! are only entries in the coordinator's file, which [`members`] adds and removes.

pub mod members;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::{self, OpenOptions, Permissions};
use std::io::{self, Write as _};
use std::net::IpAddr;
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use farm_link::{Role, sync_folder, token_hash};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

use farm_lab::whole_file::folder_of;

/// Validity of certificates: ten years.
const VALID: Duration = Duration::days(3653);
/// Certificates are valid from before their creation, since other machines' clocks may be behind.
const BACKDATED: Duration = Duration::days(1);
/// Names of the coordinator on its machine.
const OWN_NAMES: [&str; 3] = ["localhost", "127.0.0.1", "::1"];
/// Comment above the tokens in the coordinator's file.
const TOKENS_HEAD: &str = "
# Its members: `farmctl access add` and `farmctl access revoke`, or by hand, with the hash of a random token
# (`printf %s TOKEN | b3sum`). A running coordinator reads it again.
";

#[derive(Debug, thiserror::Error)]
pub enum CreateError {
    #[error("no host is named: give the name or address by which others reach the coordinator")]
    NoHost,
    #[error("host {0:?} must be a DNS name or an IP address, without scheme and port")]
    Host(String),
    #[error("port must be 1 to 65535, not 0")]
    Port,
    #[error("time {0} s since 1970 is beyond the calendar: is the clock right?")]
    Time(i64),
    #[error("{} exists, and access files are never overwritten: name another folder, or remove it", .0.display())]
    Exists(PathBuf),
    #[error("{doing} {}: {source}", .path.display())]
    File { doing: &'static str, path: PathBuf, source: io::Error },
    #[error("making certificates: {0}")]
    Certificate(#[from] rcgen::Error),
    #[error("the operating system gives no random numbers: {0}")]
    Random(getrandom::Error),
}

/// The files of a new set, and the URL and validity of its certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Created {
    /// The coordinator's file.
    pub coordinator: PathBuf,
    /// The files of the roles.
    pub members: Vec<(Role, PathBuf)>,
    /// The URL in these files, that of the first host.
    pub server: String,
    pub valid_until_unix_s: i64,
}

/// Creates the folder `dir` (mode 0700) with `coordinator.toml`, `worker.toml`, `client.toml` and `admin.toml` (mode
/// 0600), all or none. The coordinator's certificate is valid for `hosts` and for its own machine; the URL in the files
/// is that of the first host. With `mutual`, clients get certificates and the coordinator requires them.
pub fn create(
    dir: &Path,
    hosts: &[String],
    port: u16,
    mutual: bool,
    now_unix_s: i64,
) -> Result<Created, CreateError> {
    // Checked first, before anything is created; the final rename never replaces a folder with content.
    if fs::symlink_metadata(dir).is_ok() {
        return Err(CreateError::Exists(dir.to_owned()));
    }
    let names = certificate_names(hosts)?;
    let server = server_url(hosts, port)?;
    let validity = Validity::from(now_unix_s)?;
    let authority = Authority::make(validity)?;
    let files = file_texts(&authority, &names, &server, mutual)?;
    write_folder(dir, &files)?;
    Ok(Created {
        coordinator: dir.join("coordinator.toml"),
        members: Role::ALL.map(|role| (role, dir.join(format!("{role}.toml")))).to_vec(),
        server,
        valid_until_unix_s: validity.end.unix_timestamp(),
    })
}

fn certificate_names(hosts: &[String]) -> Result<Vec<String>, CreateError> {
    if let Some(host) = hosts.iter().find(|host| !is_host(host)) {
        return Err(CreateError::Host(host.clone()));
    }
    let mut seen = BTreeSet::new();
    let all = hosts.iter().map(String::as_str).chain(OWN_NAMES);
    Ok(all.filter(|name| seen.insert(name.to_ascii_lowercase())).map(str::to_owned).collect())
}

fn is_host(host: &str) -> bool {
    let is_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
            && !label.starts_with('-')
            && !label.ends_with('-')
    };
    // Digits and dots that are no address are a mistyped address.
    let is_name = host.len() <= 253
        && host.split('.').all(is_label)
        && !host.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    host.parse::<IpAddr>().is_ok() || is_name
}

fn server_url(hosts: &[String], port: u16) -> Result<String, CreateError> {
    let first = hosts.first().ok_or(CreateError::NoHost)?;
    match (first.parse::<IpAddr>(), port) {
        (_, 0) => Err(CreateError::Port),
        (Ok(IpAddr::V6(address)), _) => Ok(format!("https://[{address}]:{port}")),
        _ => Ok(format!("https://{first}:{port}")),
    }
}

#[derive(Debug, Clone, Copy)]
struct Validity {
    start: OffsetDateTime,
    end: OffsetDateTime,
}

impl Validity {
    fn from(now_unix_s: i64) -> Result<Self, CreateError> {
        let now = OffsetDateTime::from_unix_timestamp(now_unix_s).ok();
        let both = now.and_then(|now| Some((now.checked_sub(BACKDATED)?, now.checked_add(VALID)?)));
        let (start, end) = both.ok_or(CreateError::Time(now_unix_s))?;
        Ok(Self { start, end })
    }
}

/// Signs certificates; its key exists only in memory.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    certificate_pem: String,
    validity: Validity,
}

/// A certificate and its key, as text.
struct Identity {
    certificate_pem: String,
    key_pem: String,
}

impl Authority {
    fn make(validity: Validity) -> Result<Self, CreateError> {
        let key = KeyPair::generate()?;
        // A unique name, so that a mixture of two sets is recognisable.
        let mut params = params(&format!("farm authority {}", &random_hex()?[..8]), vec![], validity)?;
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let certificate_pem = params.self_signed(&key)?.pem();
        Ok(Self { issuer: Issuer::new(params, key), certificate_pem, validity })
    }

    fn sign(
        &self,
        common_name: &str,
        names: Vec<String>,
        usage: ExtendedKeyUsagePurpose,
    ) -> Result<Identity, CreateError> {
        let key = KeyPair::generate()?;
        let mut params = params(common_name, names, self.validity)?;
        params.is_ca = IsCa::ExplicitNoCa;
        params.use_authority_key_identifier_extension = true;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![usage];
        let certificate_pem = params.signed_by(&key, &self.issuer)?.pem();
        Ok(Identity { certificate_pem, key_pem: key.serialize_pem() })
    }
}

fn params(
    common_name: &str,
    names: Vec<String>,
    validity: Validity,
) -> Result<CertificateParams, rcgen::Error> {
    // Distinguishes names from addresses.
    let mut params = CertificateParams::new(names)?;
    params.distinguished_name.push(DnType::CommonName, common_name);
    params.not_before = validity.start;
    params.not_after = validity.end;
    Ok(params)
}

/// 256 random bits.
fn random_hex() -> Result<String, CreateError> {
    let mut bytes = [0_u8; 32];
    getrandom::fill(&mut bytes).map_err(CreateError::Random)?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

/// Names and contents of the files.
fn file_texts(
    authority: &Authority,
    names: &[String],
    server: &str,
    mutual: bool,
) -> Result<Vec<(String, String)>, CreateError> {
    let identity = authority.sign("farm coordinator", names.to_vec(), ExtendedKeyUsagePurpose::ServerAuth)?;
    let mut coordinator = coordinator_head(names);
    put_identity(&mut coordinator, &identity);
    if mutual {
        coordinator.push_str("# Clients must have a certificate of this authority, besides a token.\n");
        put_text(&mut coordinator, "client_ca", &authority.certificate_pem);
    }
    coordinator.push_str(TOKENS_HEAD);
    let mut files = Vec::new();
    for role in Role::ALL {
        let token = random_hex()?;
        let mut text = member_head(role);
        let _ = write!(text, "role = \"{role}\"\nserver = \"{server}\"\ntoken = \"{token}\"\n");
        put_text(&mut text, "ca_certificate", &authority.certificate_pem);
        if mutual {
            let usage = ExtendedKeyUsagePurpose::ClientAuth;
            put_identity(&mut text, &authority.sign(&format!("farm {role}"), vec![], usage)?);
        }
        files.push((format!("{role}.toml"), text));
        let hash = token_hash(&token);
        let _ =
            write!(coordinator, "\n[[token]]\nrole = \"{role}\"\nname = \"{role}\"\nblake3 = \"{hash}\"\n");
    }
    files.push(("coordinator.toml".to_owned(), coordinator));
    Ok(files)
}

fn coordinator_head(names: &[String]) -> String {
    format!(
        "# The coordinator's access file: `farm-coordinator --access FILE`. Secret; for its machine only.\n\
         # Its certificate holds for: {}.\n",
        names.join(", ")
    )
}

fn member_head(role: Role) -> String {
    let whom = match role {
        Role::Worker => {
            "# A worker's access file: `farm-worker --access FILE`. Secret; for the machines that compute.\n\
             # It lets its holder take jobs and deliver their records."
        }
        Role::Client => {
            "# A client's access file: `farmctl --access FILE`. Secret; for the people who use the farm.\n\
             # It lets its holder submit grids, read records and ask for fits."
        }
        Role::Admin => {
            "# An admin's access file: `farmctl --access FILE`. Secret; for those who look after the farm.\n\
             # It lets its holder do everything."
        }
    };
    format!("{whom}\n")
}

fn put_identity(text: &mut String, identity: &Identity) {
    put_text(text, "certificate", &identity.certificate_pem);
    put_text(text, "key", &identity.key_pem);
}

fn put_text(text: &mut String, field: &str, value: &str) {
    let _ = write!(text, "{field} = '''\n{}\n'''\n", value.trim_end());
}

/// Writes the folder under a temporary name, syncs it to the disk, and renames it.
fn write_folder(dir: &Path, files: &[(String, String)]) -> Result<(), CreateError> {
    let parent = folder_of(dir);
    let failed = |doing, path: &Path| {
        let path = path.to_owned();
        move |source| CreateError::File { doing, path, source }
    };
    let draft = tempfile::Builder::new()
        .prefix(".farm-access-")
        .permissions(Permissions::from_mode(0o700))
        .tempdir_in(parent)
        .map_err(failed("making a folder in", parent))?;
    for (name, text) in files {
        let path = draft.path().join(name);
        write_secret(&path, text).map_err(failed("writing", &path))?;
    }
    sync_folder(draft.path()).map_err(failed("writing", draft.path()))?;
    fs::rename(draft.path(), dir).map_err(failed("making", dir))?;
    // The draft was renamed and must not be removed.
    let _ = draft.keep();
    sync_folder(parent).map_err(failed("writing", parent))
}

fn write_secret(path: &Path, text: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

#[cfg(test)]
mod tests;
