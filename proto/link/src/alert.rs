//! Recognises TLS alerts with which a coordinator closes a connection.

use std::error::Error;

use tonic::Status;

use crate::error::root_cause;

/// The beginning of rustls's message for an alert of the other side. HTTP/2 passes on the text alone.
const ALERT: &str = "received fatal alert: ";
/// Alerts about certificates that were presented. `DecryptError` is the one for a wrong signature: the certificate is
/// of an authority of the right name with another key, as those of other access files are.
const NOT_ACCEPTED: [&str; 8] = [
    "AccessDenied",
    "BadCertificate",
    "CertificateExpired",
    "CertificateRevoked",
    "CertificateUnknown",
    "DecryptError",
    "UnknownCA",
    "UnsupportedCertificate",
];

/// A status with the reason why the coordinator refuses this certificate, or its absence; None if the call failed
/// for another reason. Other calls will fail in the same way, so that it is of no use to try again.
pub fn refusal(error: &dyn Error) -> Option<Status> {
    let cause = root_cause(error);
    let (_, alert) = cause.rsplit_once(ALERT)?;
    let message = match alert {
        "CertificateRequired" => {
            "the coordinator wants to see a certificate, and the access file has none (`certificate` and `key`, made by \
             `farmctl access create --mutual`)"
                .to_owned()
        }
        alert if NOT_ACCEPTED.contains(&alert) => {
            format!("the coordinator does not accept the access file's certificate: {alert}")
        }
        _ => return None,
    };
    Some(Status::unauthenticated(message))
}

#[cfg(test)]
mod tests {
    use std::io;

    use rustls::AlertDescription;

    use super::*;

    /// The refusal for an error with the text that HTTP/2 passes on.
    fn refused(error: &rustls::Error) -> Option<String> {
        let error = io::Error::other(format!("connection error: {error}"));
        refusal(&error).map(|status| status.message().to_owned())
    }

    /// TLS alerts about certificates are explained, others are not.
    #[test]
    fn certificate_alerts_are_explained() {
        use AlertDescription as Alert;
        use rustls::Error::AlertReceived;
        let told = refused(&AlertReceived(Alert::CertificateRequired)).unwrap();
        assert!(told.contains("--mutual"), "{told}");
        // From bad_certificate to certificate_unknown, unknown_ca, access_denied and decrypt_error: RFC 8446, 6.
        for alert in [42, 43, 44, 45, 46, 48, 49, 51].map(Alert::from) {
            let told = refused(&AlertReceived(alert)).unwrap();
            assert!(told.contains("does not accept"), "{told}");
        }
        assert_eq!(refused(&AlertReceived(Alert::InternalError)), None);
        assert_eq!(refused(&rustls::Error::DecryptError), None);
    }
}
