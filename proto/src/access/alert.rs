//! What a coordinator says in ending a TLS connection.

use std::error::Error;

use tonic::Status;

use super::error::root_cause;

/// How rustls words what the other side ended a connection with. HTTP/2 passes on the words alone.
const ALERT: &str = "received fatal alert: ";
/// Alerts about certificates that were shown.
const NOT_ACCEPTED: [&str; 7] = [
    "AccessDenied",
    "BadCertificate",
    "CertificateExpired",
    "CertificateRevoked",
    "CertificateUnknown",
    "UnknownCA",
    "UnsupportedCertificate",
];

/// A status that tells why the coordinator does not talk to who has this certificate, or none; None if that is not why
/// the call failed. Other calls will fail in the same way, so that it is of no use to try again.
pub(super) fn refusal(error: &dyn Error) -> Option<Status> {
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

    use super::*;

    fn refused(words: &str) -> Option<String> {
        let error = io::Error::other(words.to_owned());
        refusal(&error).map(|status| status.message().to_owned())
    }

    #[test]
    fn alerts_about_certificates_are_told_and_others_are_not() {
        let told = refused("connection error: received fatal alert: CertificateRequired").unwrap();
        assert!(told.contains("--mutual"), "{told}");
        assert!(refused("received fatal alert: UnknownCA").unwrap().ends_with("UnknownCA"));
        assert_eq!(refused("received fatal alert: InternalError"), None);
        assert_eq!(refused("connection reset by peer"), None);
    }
}
