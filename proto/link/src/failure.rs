//! Explains in plain words why a coordinator does not answer.

use std::error::Error;
use std::io;

use rustls::{CertificateError, Error as TlsError};

use crate::alert::refusal;
use crate::error::root_cause;

/// The transport's messages for the answer of a program that does not speak HTTP/2 without encryption.
const NOT_HTTP2: [&str; 2] = ["frame with invalid size", "frame received is malformed"];

/// tonic's messages for an answer by HTTP/2 that is a page and no gRPC message, as from the port of the page or of the
/// metrics.
const NO_MESSAGE: [&str; 2] = ["invalid compression flag", "grpc-status header missing"];

/// hyper's message for a connection whose peer answers no ping.
const SILENT: &str = "keep-alive timed out";

/// The reason why the coordinator at a URL does not answer, and the remedy; None for a failure of another kind.
pub fn failure(error: &(dyn Error + 'static), url: &str) -> Option<String> {
    if refusal(error).is_some() {
        return None;
    }
    let text = root_cause(error);
    let mut chain = std::iter::successors(Some(error), |&cause| cause.source());
    if chain.any(|cause| cause.to_string().contains(SILENT)) {
        return Some(
            "it takes connections and does not answer: was farm-coordinator stopped (SIGSTOP, a machine asleep), or is it \
             overloaded?"
                .to_owned(),
        );
    }
    if NO_MESSAGE.iter().any(|no_message| text.contains(no_message)) {
        return Some(
            "what answers there is no coordinator but a web server: is this the port of `farmctl web`, of --metrics, or of \
             a proxy that does not pass gRPC on? The coordinator's is the one of --listen, 7700 if it was not given"
                .to_owned(),
        );
    }
    let mut causes = std::iter::successors(Some(error), |&cause| cause.source());
    let known = causes.find_map(|cause| {
        let io = cause.downcast_ref::<io::Error>();
        let tls = io.and_then(io::Error::get_ref).and_then(|inner| inner.downcast_ref::<TlsError>());
        match (tls.or_else(|| cause.downcast_ref()), io) {
            (Some(tls), _) => of_encryption(tls),
            (None, Some(io)) => of_connection(io, url),
            (None, None) => None,
        }
    });
    known.or_else(|| {
        let cause = root_cause(error);
        if cause.contains("failed to lookup address") {
            let host = host(url);
            return Some(format!("no machine is known by the name {host}: is it spelt rightly? ({cause})"));
        }
        NOT_HTTP2.iter().any(|text| cause.contains(text)).then(|| of_other_language(url))
    })
}

/// Whether the same call may succeed later.
pub fn is_passing(status: &tonic::Status) -> bool {
    use tonic::Code;
    matches!(
        status.code(),
        Code::Unavailable
            | Code::DeadlineExceeded
            | Code::Aborted
            | Code::Cancelled
            | Code::Internal
            | Code::ResourceExhausted
            | Code::Unknown
    )
}

fn of_connection(error: &io::Error, url: &str) -> Option<String> {
    use io::ErrorKind;
    let text = match error.kind() {
        ErrorKind::ConnectionRefused => {
            "nothing listens there (connection refused): does farm-coordinator run, and is the port the right one?"
                .to_owned()
        }
        ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => {
            format!("no way leads to {}: is the machine up, and this one on its network? ({error})", host(url))
        }
        ErrorKind::TimedOut => {
            format!("{} is silent: is the machine up, does a firewall keep the port? ({error})", host(url))
        }
        ErrorKind::ConnectionReset
        | ErrorKind::ConnectionAborted
        | ErrorKind::BrokenPipe
        | ErrorKind::UnexpectedEof => {
            let hint = if is_plain(url) { ", or it listens for https:// and wants an access file" } else { "" };
            format!("the connection was cut ({error}): the coordinator may have ended{hint}")
        }
        // The port is another user's: the message comes from this crate.
        ErrorKind::PermissionDenied if error.get_ref().is_some() => error.to_string(),
        _ => return None,
    };
    Some(text)
}

fn of_encryption(error: &TlsError) -> Option<String> {
    let text = match error {
        TlsError::InvalidCertificate(problem) => of_certificate(problem),
        TlsError::InvalidMessage(_) => {
            "what answers there is not encrypted: if the coordinator runs without an access file its URL begins with \
             http://, otherwise another program has this port"
                .to_owned()
        }
        _ => return None,
    };
    Some(text)
}

fn of_certificate(problem: &CertificateError) -> String {
    match problem {
        CertificateError::UnknownIssuer | CertificateError::BadSignature => {
            "its certificate is not of the authority that this access file knows: is this the access file of that \
             coordinator? (Files that `farmctl access create` made at another time do not fit.)"
                .to_owned()
        }
        CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
            "its certificate has expired: make new access files with `farmctl access create`, or set this machine's clock"
                .to_owned()
        }
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            "its certificate is not valid yet: is the clock of this machine right, and that of the one that made it?"
                .to_owned()
        }
        CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => format!(
            "its certificate is for another host: use the name that `farmctl access create --host` was given, or \
             write it as `server_name` into the access file ({problem})"
        ),
        other => format!("its certificate is not accepted: {other}"),
    }
}

fn of_other_language(url: &str) -> String {
    if is_plain(url) {
        "what answers there is no coordinator without encryption: if it is one with access files, name yours with \
         --access FILE and let the URL begin with https://; otherwise another program has this port"
    } else {
        "what answers there is no coordinator: another program has this port"
    }
    .to_owned()
}

fn is_plain(url: &str) -> bool {
    url.starts_with("http://")
}

fn host(url: &str) -> &str {
    let rest = url.split_once("://").map_or(url, |(_, rest)| rest).trim_end_matches('/');
    rest.rsplit_once(':').map_or(rest, |(host, _)| host)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(error: impl Error + Send + Sync + 'static) -> Option<String> {
        let transport: Box<dyn Error + Send + Sync> = Box::new(io::Error::other(error));
        failure(&*transport, "http://farm:7700").or_else(|| {
            let status = tonic::Status::from_error(transport);
            failure(&status, "http://farm:7700")
        })
    }

    /// Every cause of a failed connection is explained, with the remedy; answers of web servers and silence as such.
    #[test]
    fn every_cause_names_a_remedy() {
        for (kind, expected) in [
            (io::ErrorKind::ConnectionRefused, "nothing listens there"),
            (io::ErrorKind::HostUnreachable, "no way leads to farm"),
            (io::ErrorKind::TimedOut, "farm is silent"),
            (io::ErrorKind::ConnectionReset, "listens for https://"),
        ] {
            let text = failure(&io::Error::from(kind), "http://farm:7700").unwrap();
            assert!(text.contains(expected), "{text}");
        }
        for (error, expected) in [
            (CertificateError::UnknownIssuer, "not of the authority"),
            (CertificateError::Expired, "has expired"),
            (CertificateError::NotValidYet, "not valid yet"),
            (CertificateError::NotValidForName, "for another host"),
            (CertificateError::Revoked, "not accepted"),
        ] {
            let error = io::Error::new(io::ErrorKind::InvalidData, TlsError::InvalidCertificate(error));
            let text = failure(&error, "https://farm:7700").unwrap();
            assert!(text.contains(expected), "{text}");
        }
        let text = message(io::Error::other("connection error detected: frame with invalid size")).unwrap();
        assert!(text.contains("--access FILE"), "{text}");
        let lookup = io::Error::other("failed to lookup address information: Name or service not known");
        assert!(message(lookup).unwrap().contains("by the name farm:"));
        let page =
            "protocol error: received message with invalid compression flag: 60 (valid flags are 0 and 1)";
        let missing = "grpc-status header missing, mapped from HTTP status code 404";
        let silent = "http2 error: keep-alive timed out: operation timed out";
        for (status, expected) in [
            (tonic::Status::internal(page), "the port of `farmctl web`"),
            (tonic::Status::unknown(missing), "--metrics"),
            (tonic::Status::unavailable(silent), "SIGSTOP"),
        ] {
            assert!(failure(&status, "http://farm:7780").unwrap().contains(expected), "{status}");
        }
        // Failures with another reason are not explained here.
        assert_eq!(failure(&tonic::Status::not_found("dictionary x"), "http://farm:7700"), None);
        assert_eq!(message(io::Error::other("received fatal alert: CertificateRequired")), None);
    }
}
