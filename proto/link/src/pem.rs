//! Checks certificates and keys in PEM.

use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};

/// Checks that a text holds certificates. The error follows the field's name.
pub(crate) fn check_certificates(pem: &str) -> Result<(), String> {
    let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem.as_bytes()).collect();
    match certificates {
        Ok(list) if !list.is_empty() => Ok(()),
        // The parser's own message shows bytes of the text.
        _ => Err("must hold a certificate in PEM: -----BEGIN CERTIFICATE----- …".to_owned()),
    }
}

/// Checks that a text holds a private key. The error does not show it.
pub(crate) fn check_key(pem: &str) -> Result<(), String> {
    match PrivateKeyDer::from_pem_slice(pem.as_bytes()) {
        Ok(_) => Ok(()),
        Err(_) => {
            Err("must hold an unencrypted private key in PEM: -----BEGIN PRIVATE KEY----- …".to_owned())
        }
    }
}
