//! Posts events that people wait for to a URL. A bounded queue keeps a slow receiver from delaying the farm; deliveries that
//! fail for a passing reason are repeated.

use std::time::Duration;

use serde_json::json;
use tokio::sync::mpsc;
use ureq::Agent;
use ureq::http::Uri;

use crate::store::StoredEvent;

/// The events that are posted: ends of dictionaries, and failures that need a person.
const KINDS: [&str; 4] = ["DONE", "ENDED", "RESULTS_DIFFER", "BACKUP_FAILED"];
/// Events that may wait; more are dropped, and logged.
const QUEUE: usize = 100;
/// Longest duration of one delivery.
const PATIENCE: Duration = Duration::from_secs(10);
/// Deliveries of one event, and the pause after the first; each further pause is twice as long.
const ATTEMPTS: u32 = 8;
const PAUSE: Duration = Duration::from_secs(1);

/// A receiver of events.
#[derive(Debug)]
pub(super) struct Webhook {
    queue: mpsc::Sender<StoredEvent>,
}

impl Webhook {
    pub(super) fn start(url: Uri) -> Self {
        Self::with_pause(url, PAUSE)
    }

    fn with_pause(url: Uri, pause: Duration) -> Self {
        let (queue, events) = mpsc::channel(QUEUE);
        tokio::spawn(deliver_all(url, events, pause));
        Self { queue }
    }

    /// Queues an event if it is one of those that are posted.
    pub(super) fn post(&self, event: &StoredEvent) {
        if KINDS.contains(&event.kind.as_str()) && self.queue.try_send(event.clone()).is_err() {
            tracing::warn!(kind = event.kind, "too many events wait for the webhook: this one is not posted");
        }
    }
}

async fn deliver_all(url: Uri, mut events: mpsc::Receiver<StoredEvent>, pause: Duration) {
    let agent = agent();
    // The URL may contain a secret, so logs have its host only.
    let host = url.host().unwrap_or_default().to_owned();
    while let Some(event) = events.recv().await {
        let body = body(&event);
        let mut pause = pause;
        for attempt in 1..=ATTEMPTS {
            let (agent, url, body) = (agent.clone(), url.clone(), body.clone());
            let Ok(sent) = tokio::task::spawn_blocking(move || deliver(&agent, &url, &body)).await else {
                return;
            };
            match sent {
                Ok(()) => break,
                Err(error) if attempt < ATTEMPTS && passes(&error) => {
                    tokio::time::sleep(pause).await;
                    pause *= 2;
                }
                Err(error) => {
                    tracing::warn!(%host, kind = event.kind, attempt, error = %named(&error), "an event was not posted");
                    break;
                }
            }
        }
    }
}

fn agent() -> Agent {
    Agent::config_builder().timeout_global(Some(PATIENCE)).max_redirects(0).build().into()
}

/// Posts a body. A redirection is no delivery: it is not followed.
fn deliver(agent: &Agent, url: &Uri, body: &str) -> Result<(), ureq::Error> {
    let status = agent.post(url).content_type("application/json").send(body)?.status();
    if status.is_success() { Ok(()) } else { Err(ureq::Error::StatusCode(status.as_u16())) }
}

/// Whether a later attempt may succeed.
fn passes(error: &ureq::Error) -> bool {
    match error {
        ureq::Error::StatusCode(code) => *code >= 500 || [408, 425, 429].contains(code),
        ureq::Error::BadUri(_) | ureq::Error::RequireHttpsOnly(_) => false,
        _ => true,
    }
}

/// The error without the URL.
fn named(error: &ureq::Error) -> String {
    match error {
        ureq::Error::StatusCode(code @ 300..400) => {
            format!("HTTP status {code}, a redirection: give the URL to which it leads")
        }
        ureq::Error::StatusCode(code) => format!("HTTP status {code}"),
        ureq::Error::Io(error) => error.to_string(),
        ureq::Error::Timeout(_) => format!("no answer within {} s", PATIENCE.as_secs()),
        _ => "the receiver cannot be reached".to_owned(),
    }
}

/// The event as `farmctl events --json` prints it, without its number, which it does not have yet; `text` is for receivers
/// that show one line.
fn body(event: &StoredEvent) -> String {
    let StoredEvent { unix_ms, kind, dictionary, job, worker, message, actor, id: _ } = event;
    let filled = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    let about = filled(dictionary).map(|name| format!("dictionary {name}: ")).unwrap_or_default();
    let what = kind.to_lowercase().replace('_', " ");
    let more = filled(message).map(|message| format!(", {message}")).unwrap_or_default();
    let data = json!({
        "unix_ms": unix_ms,
        "kind": kind,
        "dictionary": filled(dictionary),
        "job": job,
        "worker": filled(worker),
        "message": message,
        "actor": filled(actor),
    });
    json!({"api": "farmctl/1", "kind": "event", "data": data, "text": format!("{about}{what}{more}")})
        .to_string()
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Read as _, Write as _};
    use std::net::TcpListener;

    use super::*;

    fn event(kind: &str) -> StoredEvent {
        StoredEvent {
            id: 0,
            unix_ms: 7,
            kind: kind.to_owned(),
            dictionary: "paper".to_owned(),
            job: None,
            worker: String::new(),
            message: "34276 records".to_owned(),
            actor: String::new(),
        }
    }

    fn hooked() -> (TcpListener, Webhook) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/hook", listener.local_addr().unwrap()).parse().unwrap();
        (listener, Webhook::with_pause(url, Duration::from_millis(1)))
    }

    /// Answers requests one after the other with these status lines, an empty one by cutting the connection; returns the
    /// bodies.
    fn receiver(listener: TcpListener, answers: Vec<&'static str>) -> std::thread::JoinHandle<Vec<String>> {
        std::thread::spawn(move || {
            let answer = |status: &str| {
                let (mut stream, _) = listener.accept().unwrap();
                let mut reader = BufReader::new(stream.try_clone().unwrap());
                let headers: Vec<String> = reader
                    .by_ref()
                    .lines()
                    .map_while(|line| line.ok().filter(|line| !line.is_empty()))
                    .collect();
                let length =
                    |line: &String| line.to_lowercase().strip_prefix("content-length: ")?.parse().ok();
                let mut body = vec![0; headers.iter().find_map(length).unwrap()];
                reader.read_exact(&mut body).unwrap();
                if !status.is_empty() {
                    write!(stream, "HTTP/1.1 {status}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
                        .unwrap();
                }
                String::from_utf8(body).unwrap()
            };
            answers.into_iter().map(answer).collect()
        })
    }

    /// A delivery is repeated after a server's error and a lost connection, and not after a refusal; other events are not
    /// posted.
    #[tokio::test]
    async fn deliveries_are_repeated_for_passing_errors() {
        let (listener, webhook) = hooked();
        let answers = vec!["503 Busy", "", "200 OK", "404 Not Found", "204 No Content"];
        let receiver = receiver(listener, answers);
        for kind in ["DONE", "WORKER_JOINED", "ENDED", "BACKUP_FAILED"] {
            webhook.post(&event(kind));
        }
        let bodies = tokio::task::spawn_blocking(move || receiver.join().unwrap()).await.unwrap();
        let bodies: Vec<serde_json::Value> =
            bodies.iter().map(|b| serde_json::from_str(b).unwrap()).collect();
        let kinds: Vec<_> = bodies.iter().map(|body| &body["data"]["kind"]).collect();
        assert_eq!(kinds, ["DONE", "DONE", "DONE", "ENDED", "BACKUP_FAILED"]);
        assert_eq!(bodies[0]["text"], "dictionary paper: done, 34276 records");
        assert_eq!(bodies[0]["data"]["worker"], serde_json::Value::Null);
    }

    /// A redirection is a failure that a later attempt does not mend, and its message says what to do.
    #[test]
    fn redirections_are_no_deliveries() {
        for status in ["301 Moved", "302 Found", "303 See Other", "307 Temporary", "308 Permanent"] {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let url = format!("http://{}/", listener.local_addr().unwrap()).parse().unwrap();
            let receiver = receiver(listener, vec![status]);
            let error = deliver(&agent(), &url, "{}").unwrap_err();
            assert!(!passes(&error) && named(&error).contains("give the URL to which it leads"), "{error}");
            receiver.join().unwrap();
        }
    }

    /// Events beyond the queue are dropped without a wait.
    #[tokio::test]
    async fn full_queue_drops_events() {
        let (_listener, webhook) = hooked();
        for _ in 0..=2 * QUEUE {
            webhook.post(&event("DONE"));
        }
        assert_eq!(webhook.queue.capacity(), 0);
    }
}
