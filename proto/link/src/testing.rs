//! Certificates and files for tests.

use std::io::Write as _;
use std::path::Path;
use std::sync::LazyLock;

use rcgen::{CertificateParams, KeyPair};

use crate::error::AccessError;

pub(crate) const TOKEN: &str = "0123456789abcdef0123456789abcdef";

struct Pair {
    certificate: String,
    key: String,
}

fn pair() -> Pair {
    let key = KeyPair::generate().unwrap();
    let params = CertificateParams::new(["localhost".to_owned()]).unwrap();
    Pair { certificate: params.self_signed(&key).unwrap().pem(), key: key.serialize_pem() }
}

static AUTHORITY: LazyLock<Pair> = LazyLock::new(pair);
static MEMBER: LazyLock<Pair> = LazyLock::new(pair);

/// A certificate without its key.
pub(crate) fn ca() -> &'static str {
    &AUTHORITY.certificate
}

pub(crate) fn certificate() -> &'static str {
    &MEMBER.certificate
}

/// The key of [`certificate`].
pub(crate) fn key() -> &'static str {
    &MEMBER.key
}

/// A file that only its owner can open.
pub(crate) fn private_file(text: &str) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    file
}

/// The certificate and key of a file, as its lines.
pub(crate) fn identity() -> String {
    format!("certificate = '''\n{}'''\nkey = '''\n{}'''\n", certificate(), key())
}

/// Each text is refused with an error that contains the expected part and no token.
pub(crate) fn refuses<T>(
    read: impl Fn(&Path) -> Result<T, AccessError>,
    cases: impl IntoIterator<Item = (String, impl AsRef<str>)>,
) {
    for (text, expected) in cases {
        let Err(error) = read(private_file(&text).path()) else { panic!("{text} is read") };
        let (error, expected) = (error.to_string(), expected.as_ref());
        assert!(error.contains(expected) && !error.contains(TOKEN), "{expected:?} is not in {error:?}");
    }
}
